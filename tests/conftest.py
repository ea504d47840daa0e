"""What all tests share: a ROS domain and arm names of their own, and proof that nothing is left behind."""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
import secrets
import shutil
import signal
import socket
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import leaks
import pytest
import uncompiled  # noqa: F401 - before anything of ours
import verdicts
from carriers import Hurried
from depth import examples
from hypothesis import HealthCheck, settings

from rosfront.transport import FAST_DDS, choose_udp
from rtarm.launch.own_domain import own_domain, ports_of

_SESSION = secrets.token_hex(4)
_ARM_PREFIX = f"t{_SESSION}_"
_ARM_NUMBERS = itertools.count()
_STATE_HOME = Path(tempfile.gettempdir(), f"rtarm-test-{_SESSION}")
_FILE, _BEFORE = pytest.StashKey[Path | None](), pytest.StashKey[leaks.Surroundings]()
_HURRIED = pytest.StashKey[Hurried]()
_CLAIM = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
"""Has a port of this session's ROS domain, so that no other session chooses it before this one starts a ROS process."""


def pytest_configure(config: pytest.Config) -> None:
    """Keep this session's ROS traffic on this machine and apart from others', before rclpy is imported.

    And no example of a property is too slow, as in CI: hypothesis would else fail those of a busy machine after 0.2 s.
    """
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:  # in the background of a shell; what is started inherits it
            signal.signal(number, usual)
    slow = [HealthCheck.too_slow]
    count = examples(settings.default.max_examples)
    settings.register_profile(
        "untimed", settings.default, max_examples=count, deadline=None, suppress_health_check=slow
    )
    settings.load_profile("untimed")
    os.environ.update(own_domain())
    _CLAIM.bind(("127.0.0.1", ports_of(int(os.environ["ROS_DOMAIN_ID"]))[-1]))
    choose_udp(os.environ, os.environ.get("RMW_IMPLEMENTATION") or FAST_DDS)
    os.environ[verdicts.MARKER] = _SESSION
    os.environ["XDG_STATE_HOME"] = str(_STATE_HOME)  # recordings of faults
    config.pluginmanager.register(verdicts)
    if not hasattr(config, "workerinput"):  # once for all workers
        config.stash[_HURRIED] = Hurried()


def pytest_unconfigure(config: pytest.Config) -> None:
    """Leave the domain to the next session, the kernel's threads as they were, and no recording of a fault."""
    if _HURRIED in config.stash:
        config.stash[_HURRIED].close()
    _CLAIM.close()
    shutil.rmtree(_STATE_HOME, ignore_errors=True)


def pytest_collection_finish() -> None:
    """Fast DDS opens three sockets at its first use in a process, which stay: let it before anybody looks."""
    if "rclpy" in sys.modules:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        rclpy.create_node("first", context=context).destroy_node()
        rclpy.shutdown(context=context)


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
        marked = f"{verdicts.MARKER}={_SESSION}".encode() in environment.split(b"\0")
        # multiprocessing keeps one helper per parent, which ends with it.
        if marked and "multiprocessing.resource_tracker" not in command:
            left.append(f"{process.name} {command}")
    return left


def all_left() -> list[str]:
    """Processes and memory files."""
    return [*processes_left(), *map(str, memory_files_left())]


def clear_away() -> None:
    """End what a test has left whose fixtures broke off: it is no test's that comes after it."""
    for line in processes_left():
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(line.split()[0]), signal.SIGKILL)
    for path in memory_files_left():
        path.unlink(missing_ok=True)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Any:
    """Look around before anything of a file of tests is set up.

    And let the collector never again walk what is alive by then, numba above all: that holds the interpreter for up to
    0.4 s, in which a control process played by a thread runs no cycle.
    """
    if item.session.stash.get(_FILE, None) != item.path:
        item.session.stash[_FILE] = item.path
        gc.collect()
        gc.freeze()
        item.session.stash[_BEFORE] = leaks.surroundings(all_left)
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: Any, nextitem: pytest.Item | None) -> Any:
    """Fail a file of tests that changes what the next ones would start from, when all its fixtures have ended."""
    failed = item.stash.get(verdicts.FAILED, False)
    try:
        yield
    finally:
        if failed:
            clear_away()
    if failed:  # what was raised holds what it was about; the file is looked at when a test of it has ended well
        now = leaks.surroundings(all_left)
        item.session.stash[_BEFORE] = item.session.stash[_BEFORE]._replace(descriptors=now.descriptors)
        return
    if nextitem is None or nextitem.path != item.path:
        item.session.stash[_FILE] = None
        item.funcargs.clear()  # what nobody holds any more is closed
        for kept in ("last_exc", "last_value", "last_traceback"):  # with the frames of the test that failed last
            vars(sys).pop(kept, None)
        left = leaks.left_by(item.session.stash[_BEFORE], all_left)
        if left:
            clear_away()
            raise leaks.Left(f"{item.path.name} leaves behind: " + "; ".join(left))


@pytest.fixture(scope="session")
def new_arm_name() -> Callable[[], str]:
    """Makes arm names that nobody else uses, for fixtures that outlive a test."""
    return lambda: f"{_ARM_PREFIX}{next(_ARM_NUMBERS)}"


@pytest.fixture
def arm_name(new_arm_name: Callable[[], str]) -> str:
    """An arm name that no other test and no other session uses, so that memory files never meet."""
    return new_arm_name()
