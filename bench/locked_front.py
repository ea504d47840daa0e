"""`python -m bench.locked_front ARM`: a ROS process that takes its goals as rclpy does, for comparison."""

import sys

from rosfront.__main__ import main


def withhold() -> None:
    """Nothing but rclpy's own way is to be had in this process."""
    from rosfront import action
    from rosfront.goal_requests import Unavailable

    def unavailable() -> None:
        raise Unavailable("for comparison")

    action.GoalFunctions = unavailable  # type: ignore[assignment,misc]


if __name__ == "__main__":
    withhold()
    sys.exit(main())
