# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The ROS parameters that say which arm is started and how: given to `robot_interface`, shown by the arm's node.

`python -m rosfront.start_parameters [--ros-args …]` prints, as one JSON object, every parameter that a command line
gives to the arm's node under any of its names. The launcher runs it, so that the launcher itself needs no ROS.
"""

import json
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rosfront.program import CannotServe, needs_ros, split_arguments, start_ros

if TYPE_CHECKING:
    from config.schema import ArmConfig

DEFAULT_ARM = "episode1"
NODE_NAMES = ("robot_interface", "robot_interface_full", "robot_interface_node")
"""Names that a parameter or launch file may use for the arm's node, besides the controller's own name."""
ANY_OTHER_NODE = "any_other_node"
NO_USB_INDEX = -1

JOINT_STATES, MOTOR_ANGLES = "joint_states", "motor_angles"
PUBLISH_MODES = (JOINT_STATES, MOTOR_ANGLES)

START: dict[str, tuple[type, str]] = {
    "arm": (str, "The arm."),
    "sim": (bool, "Whether the drives are simulated."),
    "usb_index": (
        int,
        "The adapter as n of /dev/ttyUSB<n> or can<n>; -1 where it is named by its channel alone.",
    ),
    "channel": (str, "Device of the CAN adapter, or name of the CAN interface."),
    "init_mode": (int, "What bring-up did: 1 took over the pose the arm stood in, 0 is homing."),
    "interpolation_factor": (int, "Points put between each two given ones, if interpolation_method is linear."),
    "publish_mode": (str, "What is published of the joints' positions."),
}
"""Name, type and description of each; the running node shows the descriptions."""

_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text", list: "a list of texts"}


class BadParameter(CannotServe):
    """A parameter's value cannot be taken; the text is one sentence."""


def require_kind(name: str, value: Any, kind: type) -> None:
    """Raise BadParameter when a parameter's value is of another kind."""
    if type(value) is not kind:
        raise BadParameter(f"Parameter {name} is {value!r}, and it must be {_KINDS[kind]}: give such a value.")


def facts(arm: "ArmConfig") -> dict[str, Any]:
    """The start parameters of a loaded arm; its configuration does not tell whether it is simulated.

    With several buses no number stands for their adapters, and the channel is all of theirs.
    """
    usb_index = arm.bus.usb_index if len(arm.buses) == 1 else None
    return {
        "arm": arm.name,
        "sim": False,
        "usb_index": NO_USB_INDEX if usb_index is None else usb_index,
        "channel": ", ".join(bus.resolved_channel for bus in arm.buses),
        "init_mode": arm.control.init_mode,
        "interpolation_factor": arm.trajectory.interpolation_factor,
        "publish_mode": JOINT_STATES,
    }


def read_given(ros_arguments: Sequence[str]) -> dict[str, Any]:
    """The parameters that ROS arguments give to the arm's node, as ROS itself parses them.

    They depend on the node's name and namespace, and ROS gives them only to a node. So this function makes a node
    for each name, in a context of its own. A parameter for one of the names takes precedence over the same
    parameter for all nodes. Raises CannotServe when ROS does not understand the arguments.
    """
    with needs_ros():
        from rclpy.context import Context
        from rclpy.node import Node
    context = Context()
    start_ros(ros_arguments, context)
    nodes = []  # kept to the end: with its last node the middleware would leave the network, to join it anew

    def given_to(name: str) -> dict[str, Any]:
        node = Node(name, context=context, enable_rosout=False, start_parameter_services=False)
        nodes.append(node)
        return {name: parameter.value for name, parameter in node._parameter_overrides.items()}

    try:
        to_all = given_to(ANY_OTHER_NODE)
        merged = dict(to_all)

        def add(name: str) -> None:
            merged.update({key: value for key, value in given_to(name).items() if value != to_all.get(key)})

        for name in NODE_NAMES:
            add(name)
        controller = _controller_name(merged.get("arm", DEFAULT_ARM))
        if controller is not None:
            add(controller)
        return merged
    finally:
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()


def _controller_name(arm: Any) -> str | None:
    from config.errors import ConfigError
    from config.loader import load_arm

    try:
        return load_arm(arm).front.controller_name if isinstance(arm, str) else None
    except ConfigError:
        return None  # the program that starts the arm says why


def main() -> int:
    """Print the given parameters for the launcher; returns the exit code."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"  # these nodes need no discovery
    _, ros_arguments = split_arguments(sys.argv[1:])
    try:
        given = read_given(ros_arguments)
    except CannotServe as problem:
        print(problem, file=sys.stderr)
        return 1
    print(json.dumps(given, default=list))  # rclpy gives lists of numbers as arrays
    return 0


if __name__ == "__main__":
    sys.exit(main())
