"""Starts the node that prints trajectories and then pretends that the arm is where they end.

Example: `ros2 launch rtarm trajectory_printer.launch.py language:=en`
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    """The argument and the node."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "language", default_value="zh", choices=["zh", "en"], description="language of what is printed"
            ),
            Node(
                package="rtarm",
                executable="trajectory_printer",
                output="screen",
                arguments=["--language", LaunchConfiguration("language")],
            ),
        ]
    )
