"""What all tests share: a ROS domain and arm names of their own, and proof that nothing is left behind."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

_SESSION = secrets.token_hex(4)
_ARM_PREFIX = f"t{_SESSION}_"
_ARM_NUMBERS = itertools.count()
_MARKER = "RTARM_TEST_SESSION"
_LEAVE_TAKING_S = 2.0
_STATE_HOME = Path(tempfile.gettempdir(), f"rtarm-test-{_SESSION}")


def pytest_configure() -> None:
    """Keep this session's ROS traffic on this machine and apart from others', before rclpy is imported."""
    # Domains above 101 use ports that Linux may hand out to anybody.
    os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().randrange(1, 102))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ[_MARKER] = _SESSION
    os.environ["XDG_STATE_HOME"] = str(_STATE_HOME)  # recordings of faults


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests with real processes get three more tries: a stall of a shared machine ends a goal, and rightly so.

    What must hold whatever the machine does is proven in virtual time, where nothing is tried twice; and here too it
    is final when the observer finds it broken (`observer.judge`).
    """
    for item in items:
        if item.get_closest_marker("process"):
            item.add_marker(pytest.mark.flaky(reruns=3, reruns_delay=2, rerun_except=["Violation"]))


def memory_files_left() -> list[Path]:
    """Shared-memory files of this session's arms."""
    return sorted(Path("/dev/shm").glob(f"rtarm.{_ARM_PREFIX}*"))


def processes_left() -> list[str]:
    """Pid and command of what was started during this session and still runs, orphans included."""
    left = []
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            environment = (process / "environ").read_bytes()
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
        except OSError:  # it ended between the listing and the look, or is somebody else's
            continue
        marked = f"{_MARKER}={_SESSION}".encode() in environment.split(b"\0")
        # multiprocessing keeps one helper per parent, which ends with it.
        if marked and "multiprocessing.resource_tracker" not in command:
            left.append(f"{process.name} {command}")
    return left


def middleware_files() -> set[Path]:
    """Fast DDS segments: a process killed by a test leaves them, and the middleware does not sweep them up."""
    return {path for mark in ("fastrtps_*", "sem.fastrtps_*") for path in Path("/dev/shm").glob(mark)}


def files_in_use() -> set[str]:
    """Shared-memory files that another process maps or holds open (Fast DDS does not map its lock files)."""
    used: set[str] = set()
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue  # what this process still uses, it does not need any more
        with contextlib.suppress(OSError):
            used |= {line.split()[-1] for line in (process / "maps").read_text().splitlines() if "/dev/shm/" in line}
            used |= {os.readlink(descriptor) for descriptor in (process / "fd").iterdir()}
    return used


def sweep_middleware_files(before: set[Path]) -> None:
    """Remove segments that came during this session and that no other process uses."""
    used = files_in_use()
    for path in middleware_files() - before:
        if str(path) not in used:
            path.unlink(missing_ok=True)


@pytest.fixture(scope="session", autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """Fail the session if it leaves a memory file or a process; what is just ending gets a moment."""
    before = middleware_files()
    yield
    deadline = time.monotonic() + _LEAVE_TAKING_S
    while processes_left() and time.monotonic() < deadline:
        time.sleep(0.01)
    sweep_middleware_files(before)
    shutil.rmtree(_STATE_HOME, ignore_errors=True)
    assert not processes_left(), "processes left by the tests"
    assert not memory_files_left(), "memory files left by the tests"


@pytest.fixture(scope="session")
def new_arm_name() -> Callable[[], str]:
    """Makes arm names that nobody else uses, for fixtures that outlive a test."""
    return lambda: f"{_ARM_PREFIX}{next(_ARM_NUMBERS)}"


@pytest.fixture
def arm_name(new_arm_name: Callable[[], str]) -> str:
    """An arm name that no other test and no other session uses, so that memory files never meet."""
    return new_arm_name()
