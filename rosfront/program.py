# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""What the programs of this folder share: command line, signals, running an rclpy node, an orderly shutdown."""

import gc
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from config.processors import leave_to_cycle
from config.schema import ArmConfig
from rosfront.transport import choose_udp, may_share_memory

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor

ROS_ARGS, END_OF_ROS_ARGS = "--ros-args", "--"
HIGHEST_DOMAIN = 232
"""Higher ROS domains have no UDP ports."""
SHARED_MEMORY = "/dev/shm"
SHARED_MEMORY_BYTES = 4 << 20
"""Twice what Fast DDS takes of it for one participant. Where a page of it cannot be had, the kernel ends the process
with SIGBUS, which tells the user nothing."""
GIL_SWITCH_S = 0.0005
"""Switch interval of the interpreter: checking a goal delays the publisher's thread by this at most, not by 5 ms."""


class CannotServe(Exception):
    """The program cannot do its work; the text is one sentence."""


class Served(Protocol):
    """What `serve` needs of a node."""

    node: Any

    def spin(self) -> None:
        """Serve in a thread of its own, until `close`."""

    def announce(self) -> None:
        """Announce that goals can be sent. Called before `spin`; must not wait, so a wait needs a thread of its own."""

    def finish(self, end: "EndSignal") -> None:
        """Do what remains to be done before the shutdown; another end signal cuts that short."""

    def close(self, patience_s: float) -> None:
        """End what runs, with `patience_s` for the goals, and make `spin` return."""


class EndSignal:
    """SIGTERM and SIGINT as something to wait for.

    The kernel may deliver a signal to any thread, and a Python handler runs only when the main thread comes back to
    the interpreter. The byte that the interpreter's C handler writes into a pipe arrives in every case.
    """

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait for a signal or a call of `give`, past ones included, `timeout_s` at most; each ends one wait."""
        if select.select([self._read], [], [], timeout_s)[0]:
            os.read(self._read, 1)

    def ignore(self) -> None:
        """Ignore both signals until the process ends."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)

    def give(self) -> None:
        """End one `wait`, as a signal does."""
        os.write(self._write, b"\0")


def split_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split a command line into arguments for the program and for ROS (from --ros-args to --, or the end)."""
    own: list[str] = []
    ros: list[str] = []
    for_ros = False
    for argument in arguments:
        for_ros = for_ros or argument == ROS_ARGS
        if for_ros or argument != END_OF_ROS_ARGS:
            (ros if for_ros else own).append(argument)
        for_ros = for_ros and argument != END_OF_ROS_ARGS
    return own, ros


@contextmanager
def needs_ros() -> Iterator[None]:
    """A context for imports of ROS packages; raises CannotServe where one is missing."""
    try:
        yield
    except ImportError as problem:
        raise CannotServe(
            f"ROS 2 is not usable here ({problem}): source a ROS 2 Jazzy installation that has control_msgs, "
            "or run `make env` for the wheels."
        ) from problem


def start_ros(ros_arguments: Sequence[str], context: Any = None) -> None:
    """Initialise rclpy, with UDP as transport and without its signal handlers.

    Raises CannotServe when ROS is missing or refuses the arguments or the domain, or when /dev/shm is too full.
    """
    with needs_ros():
        import rclpy
        from rclpy.signals import SignalHandlerOptions
        from rclpy.utilities import get_rmw_implementation_identifier
    _check_domain(os.environ.get("ROS_DOMAIN_ID", ""))
    middleware = get_rmw_implementation_identifier()
    choose_udp(os.environ, middleware)
    if may_share_memory(os.environ, middleware):
        _check_room()
    try:
        rclpy.init(args=list(ros_arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as problem:  # the base of rclpy's own exceptions, which are private
        reason = str(problem).removeprefix("failed to initialize rcl: ").partition(", at /")[0]
        raise CannotServe(
            f"ROS does not understand what follows {ROS_ARGS} ({reason.rstrip('.')}): correct it."
        ) from problem


def _check_domain(domain: str) -> None:
    """Raise CannotServe for a domain without ports, since the middleware's own message is not meant for users."""
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= HIGHEST_DOMAIN):
        raise CannotServe(
            f"ROS_DOMAIN_ID is {domain!r}, and allowed are whole numbers from 0 to {HIGHEST_DOMAIN}: correct it, or "
            "unset it for 0."
        )


def _check_room() -> None:
    """Raise CannotServe when /dev/shm is too full; without /dev/shm Fast DDS uses the network."""
    try:
        found = os.statvfs(SHARED_MEMORY)
    except OSError:
        return
    free = found.f_bavail * found.f_frsize
    if found.f_blocks != 0 and free < SHARED_MEMORY_BYTES:  # 0 blocks: a file system without a limit
        raise CannotServe(
            f"{SHARED_MEMORY} has {free >> 10} KiB left, and ROS needs {SHARED_MEMORY_BYTES >> 10} KiB: free some "
            "space there (`ls -l /dev/shm` shows what takes it)."
        )


def serve(
    make: Callable[["SingleThreadedExecutor"], Served], ros_arguments: Sequence[str], arm: ArmConfig, end: EndSignal
) -> None:
    """Make a node and serve until the end signal.

    The arm file sets the range of discovery (`front.discovery`) unless the environment does. Raises CannotServe, and
    the exception that ended any thread: a process that went on without it would look alive and serve no client.
    """
    # Set before rclpy is imported. Unless the arm file says otherwise, only this machine discovers the arm.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", arm.front.discovery.upper())
    leave_to_cycle(arm.realtime.cpu)  # before the middleware, which has threads
    start_ros(ros_arguments)
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.utilities import try_shutdown

    sys.setswitchinterval(GIL_SWITCH_S)
    executor = SingleThreadedExecutor()
    try:
        served = make(executor)
    except CannotServe:
        try_shutdown()
        raise
    failures: list[BaseException] = []

    def carry_out(ended: threading.ExceptHookArgs) -> None:
        failures.append(ended.exc_value or RuntimeError(f"{ended.exc_type.__name__} ended a thread"))
        end.give()

    threading.excepthook = carry_out  # otherwise the program would go on without the thread
    served.announce()
    spinner = threading.Thread(target=served.spin, name="executor", daemon=True)
    spinner.start()
    gc.collect()
    gc.freeze()  # objects alive now stay alive: later collections need not visit them
    end.wait()
    if not failures:
        served.finish(end)
    end.ignore()
    served.close(arm.patience.goals_s)
    spinner.join()
    executor.shutdown()
    served.node.destroy_node()
    try_shutdown()
    if failures:
        raise failures[0]
