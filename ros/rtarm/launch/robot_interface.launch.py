"""Starts rtarm for one arm: its control process and the node that MoveIt sends goals to.

Example: `ros2 launch rtarm robot_interface.launch.py usb_index:=1 init_mode:=1`
"""

import re

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

AS_IN_THE_ARM_FILE = "; empty: as in the arm file"

ARGUMENTS = (
    DeclareLaunchArgument("arm", default_value="episode1", description="name of an arm, or path of an arm file"),
    DeclareLaunchArgument("sim", default_value="false", description="true simulates the drives, without hardware"),
    DeclareLaunchArgument(
        "usb_index", default_value="", description=f"n means the adapter /dev/ttyUSBn{AS_IN_THE_ARM_FILE}"
    ),
    DeclareLaunchArgument("channel", default_value="", description=f"device of the adapter{AS_IN_THE_ARM_FILE}"),
    DeclareLaunchArgument(
        "init_mode",
        default_value="",
        description=f"1 takes over the present pose, 0 homes{AS_IN_THE_ARM_FILE}",
    ),
)
TEXTS = ("arm", "channel")
TRUTH = {"true": True, "false": False}


def generate_launch_description():
    """The arguments, and the node with those that were given."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=robot_interface)])


def robot_interface(context):
    """The node; parameters that were left empty are not given, so that the arm file decides."""
    given = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    parameters = {name: value if name in TEXTS else typed(value) for name, value in given.items() if value}
    return [
        Node(
            package="rtarm",
            executable="robot_interface",
            output="screen",
            parameters=[parameters],
            # An arm is stopped on its path (within 60 s), or parked (parking.timeout_s: 300 s at most), before its
            # processes end; what comes earlier is a second signal, which ends the parking.
            sigterm_timeout="450",
            sigkill_timeout="20",
            on_exit=Shutdown(reason="rtarm has ended, and with it what the others work with"),
        )
    ]


def typed(text):
    """A whole number or a truth value as what it is; anything else stays a text, which rtarm refuses in a sentence."""
    return int(text) if re.fullmatch(r"-?(0|[1-9][0-9]*)", text) else TRUTH.get(text.lower(), text)
