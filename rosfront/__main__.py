# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""`python -m rosfront ARM [--ros-args …]`: serve one arm to ROS 2 until SIGTERM or SIGINT.

Prints `ready …` on standard output once goals can be sent. Exit codes: 0 after an orderly end, 1 when the arm
cannot be served (one sentence on standard error says why), 2 for a wrong command line.
"""

import argparse
import gc
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING

from config.errors import ConfigError
from config.loader import load_arm, parse_overrides
from config.schema import ArmConfig
from rosfront.link import Link, attach
from shm.errors import NotRunning, SharedMemoryError

if TYPE_CHECKING:
    from rosfront.node import FrontNode

LONGEST_STOP_S = 3.5
"""What the arm may take to stop on its path; with what follows it is within the launcher's 5 s."""
GIL_SWITCH_S = 0.0005
"""A goal being checked holds up the publisher's thread for this long at most, instead of 5 ms."""


def main(arguments: list[str] | None = None) -> int:
    """Run the front; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m rosfront", description="Serve an arm to ROS 2.")
    parser.add_argument("arm", metavar="ARM", help="name of an arm, or path of an arm file")
    parser.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change a setting of the arm"
    )
    given = sys.argv[1:] if arguments is None else arguments
    known, ros_arguments = parser.parse_known_args(given)
    if ros_arguments and ros_arguments[0] != "--ros-args":
        parser.error(f"unrecognized argument {ros_arguments[0]}; what is meant for ROS follows --ros-args")
    end = EndSignal()
    try:
        arm = load_arm(known.arm, overrides=parse_overrides(known.set))
        link = _attach_now(arm)
        return _serve(arm, link, ros_arguments, end)
    except (ConfigError, SharedMemoryError, RosMissing) as problem:
        print(problem, file=sys.stderr)
        return 1


class RosMissing(Exception):
    """rclpy or control_msgs cannot be imported."""


class EndSignal:
    """SIGTERM and SIGINT as something to wait for.

    The kernel gives a signal to any thread, and a Python handler runs only when the main thread comes back to
    the interpreter; the byte that the interpreter's C handler writes into a pipe arrives in every case.
    """

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)

    def wait(self) -> None:
        """Until a signal comes or has come, or `give` was called; a later one is ignored to the very end."""
        os.read(self._read, 1)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)

    def give(self) -> None:
        os.write(self._write, b"\0")


def _attach_now(arm: ArmConfig) -> Link | None:
    """The control process, if it runs already; what can never work is raised."""
    try:
        return attach(arm)
    except NotRunning:
        return None


def _serve(arm: ArmConfig, link: Link | None, ros_arguments: list[str], end: EndSignal) -> int:
    # Before rclpy is imported: an arm is a thing of its own machine until its file says otherwise.
    discovery = {"localhost": "LOCALHOST", "subnet": "SUBNET"}[arm.front.discovery]
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", discovery)
    try:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions
        from rclpy.utilities import try_shutdown

        from rosfront.node import FrontNode
        from rosfront.parameters import BadParameter
    except ImportError as problem:
        raise RosMissing(
            f"ROS 2 is not usable here ({problem}): source a ROS 2 Jazzy installation that has control_msgs, "
            "or run `make env` for the wheels."
        ) from problem

    sys.setswitchinterval(GIL_SWITCH_S)
    rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()
    try:
        front = FrontNode(arm, executor, link)
    except BadParameter as problem:
        print(problem, file=sys.stderr)
        try_shutdown()
        return 1
    failures: list[BaseException] = []

    def spin() -> None:
        try:
            front.spin()
        except BaseException as failure:  # a thread's exception is nobody's unless it is carried out
            failures.append(failure)
            end.give()

    spinner = threading.Thread(target=spin, name="executor", daemon=True)
    spinner.start()
    announcer = threading.Thread(target=_announce, args=(front,), name="announcer", daemon=True)
    announcer.start()
    gc.collect()
    gc.freeze()  # what is alive now stays: later collections need not walk through it
    end.wait()
    front.close(LONGEST_STOP_S)
    spinner.join()
    executor.shutdown()
    front.node.destroy_node()
    try_shutdown()
    if failures:
        raise failures[0]
    return 0


def _announce(front: "FrontNode") -> None:
    """Say once that goals can be sent: the server is up and the control process is there."""
    front.serving.ever_attached.wait()
    print(f"ready {front.node.get_fully_qualified_name()}/follow_joint_trajectory", flush=True)


if __name__ == "__main__":
    sys.exit(main())
