"""`python -m rosfront ARM [--ros-args …]`: serve one arm to ROS 2 until SIGTERM or SIGINT.

Prints `ready …` on standard output once goals can be sent. Exit codes: 0 after an orderly end, 1 when the arm
cannot be served (one sentence on standard error says why), 2 for a wrong command line.
"""

import os
import signal

for _number in (signal.SIGTERM, signal.SIGINT):
    # Until `EndSignal` replaces this handler there is nothing to clean up, and an exception may be lost in an import.
    signal.signal(_number, lambda *_: os._exit(0))

import argparse
import sys
from typing import TYPE_CHECKING

from config.errors import ConfigError
from config.loader import load_arm, parse_overrides
from config.schema import ArmConfig
from rosfront.link import Link, attach
from rosfront.program import CannotServe, EndSignal, needs_ros, serve, split_arguments
from shm.errors import NotRunning, SharedMemoryError

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor

    from rosfront.node import FrontNode


def main(arguments: list[str] | None = None) -> int:
    """Run the front; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m rosfront",
        description="Serve an arm to ROS 2.",
        epilog="What is meant for ROS follows --ros-args.",
    )
    parser.add_argument("arm", metavar="ARM", help="name of an arm, or path of an arm file")
    parser.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change a setting of the arm"
    )
    own, ros_arguments = split_arguments(sys.argv[1:] if arguments is None else arguments)
    options = parser.parse_args(own)
    end = EndSignal()
    try:
        arm = load_arm(options.arm, overrides=parse_overrides(options.set))
        link = _attach_now(arm)

        def front(executor: "SingleThreadedExecutor") -> "FrontNode":
            with needs_ros():
                from rosfront.node import FrontNode
            return FrontNode(arm, executor, link)

        serve(front, ros_arguments, arm, end)
    except (ConfigError, SharedMemoryError, CannotServe) as problem:
        print(problem, file=sys.stderr)
        return 1
    return 0


def _attach_now(arm: ArmConfig) -> Link | None:
    """Attach to the control process; None while it is not running. Raises what else `attach` raises."""
    try:
        return attach(arm)
    except NotRunning:
        return None


if __name__ == "__main__":
    sys.exit(main())
