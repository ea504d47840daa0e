"""What all tests share: a ROS domain and arm names of their own, and proof that nothing is left behind."""

from __future__ import annotations

import itertools
import os
import secrets
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from rosfront.transport import FAST_DDS, choose_udp
from rtarm.own_domain import own_domain, ports_of

_SESSION = secrets.token_hex(4)
_ARM_PREFIX = f"t{_SESSION}_"
_ARM_NUMBERS = itertools.count()
_MARKER = "RTARM_TEST_SESSION"
_LEAVE_TAKING_S = 2.0
_STATE_HOME = Path(tempfile.gettempdir(), f"rtarm-test-{_SESSION}")
_CLAIM = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
"""Has a port of this session's ROS domain, so that no other session chooses it before this one starts a ROS process."""


def pytest_configure() -> None:
    """Keep this session's ROS traffic on this machine and apart from others', before rclpy is imported.

    And no example of a property is too slow, as in CI: hypothesis would else fail those of a busy machine after 0.2 s.
    """
    settings.register_profile("untimed", settings.default, deadline=None)
    settings.load_profile("untimed")
    os.environ.update(own_domain())
    _CLAIM.bind(("127.0.0.1", ports_of(int(os.environ["ROS_DOMAIN_ID"]))[-1]))
    choose_udp(os.environ, os.environ.get("RMW_IMPLEMENTATION") or FAST_DDS)
    os.environ[_MARKER] = _SESSION
    os.environ["XDG_STATE_HOME"] = str(_STATE_HOME)  # recordings of faults


def pytest_unconfigure() -> None:
    """Leave the domain to the next session."""
    _CLAIM.close()


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


@pytest.fixture(scope="session", autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """Fail the session if it leaves a memory file or a process; what is just ending gets a moment."""
    yield
    deadline = time.monotonic() + _LEAVE_TAKING_S
    while processes_left() and time.monotonic() < deadline:
        time.sleep(0.01)
    shutil.rmtree(_STATE_HOME, ignore_errors=True)
    assert not processes_left(), "processes left by the tests"
    assert not memory_files_left(), "memory files left by the tests"


@pytest.fixture(scope="module", autouse=True)
def priority_stays(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a module that changes the priority of this process, which all that the next ones start would inherit."""
    before = _priority()
    yield
    assert _priority() == before, (
        f"{request.node.name} left the process of the tests at {_priority()} instead of {before}: "
        "what needs another priority has a process or a thread of its own."
    )


def _priority() -> str:
    """Of the thread that runs the tests."""
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    return f"nice {os.getpriority(os.PRIO_PROCESS, 0)}, scheduling policy {policy}, priority {priority}"


@pytest.fixture(scope="session")
def new_arm_name() -> Callable[[], str]:
    """Makes arm names that nobody else uses, for fixtures that outlive a test."""
    return lambda: f"{_ARM_PREFIX}{next(_ARM_NUMBERS)}"


@pytest.fixture
def arm_name(new_arm_name: Callable[[], str]) -> str:
    """An arm name that no other test and no other session uses, so that memory files never meet."""
    return new_arm_name()
