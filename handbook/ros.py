# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The page of what an arm's node offers to ROS, from a real node, so that names, types and QoS are those it has."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from config.loader import load_arm
from handbook.markdown import block, code, page, table

if TYPE_CHECKING:
    from config.schema import ArmConfig

MEANINGS = {
    "~/follow_joint_trajectory": "move along a trajectory",
    "angle_mode": "all joints to motor-side angles, together",
    "move_xyz_rotation": "the flange to a pose, the joints together",
    "linear_move": "the flange to a pose in a straight line",
    "gripper_controller/gripper_cmd": "the gripper to an angle, with at most an effort",
    "gripper_controller/parallel_gripper_cmd": "the same with the newer type: a position by the joint's name",
    "/joint_states": "measured position, velocity and effort",
    "/dynamic_joint_states": "the same with what is commanded, drive status, age, temperature, supply",
    "/diagnostics": "arm, bus, cycle, joints and this process, once a second",
    "~/controller_state": "commanded and measured at the instant of measurement, and the difference",
    "motor_angles": "angles on the motor side (degrees from the homing stop)",
    "~/joint_trajectory": "a stream of points without an answer, as from MoveIt Servo",
    "~/speed_scaling_input": "how fast goals are run, 0 to 1",
    "~/clear_fault": "clears a latched fault and brings the drives up again",
    "~/disable": "lets the drives go limp, out of service",
    "~/enable": "brings limp drives up again",
    "~/free": "lets the drives go limp, to lead the arm by hand",
    "~/hold": "stops the arm on its path and keeps the goal",
    "~/home": "joints find their stops: the arm moves",
    "~/query_state": "position, velocity and acceleration of the trajectory at a moment",
    "~/resume": "lets a held goal go on, or a stopped arm take goals again",
    "~/stop": "ends every goal; none begins before `~/resume`",
    "gripper_control": "opens or closes the gripper",
    "servo_gripper": "the gripper to an angle",
    "gripper_controller/home": "the gripper finds its stop: it moves",
    "read_motor_angles": "what `motor_angles` said last",
    "set_free_mode": "`~/free` with true, `~/enable` with false",
}
"""One line each; a name that no node offers, or one without a line here, fails when the page is made."""
INTERFACES = Path(__file__).parents[1] / "rtarm_interfaces" / "robot_arm_interfaces"
ROS_OWN = re.compile(
    r"^(/rosout|/parameter_events|.*/(get|set|list|describe)_\w*parameter\w*|.*/_action/.*|.*/get_type_description)$"
)
PATIENCE_S = 10.0
NOBODYS = "handbook"
"""Name of the arm that is served: none that runs."""
INTRODUCTION = """\
What the node of an arm offers; `~/` stands for its name, `/episode_arm_controller` unless the arm file says
otherwise. Those of the full node are there for six joints, those of the gripper where the arm file has one. [ROS
interfaces](../guides/ros-interfaces.md) says what each does case by case, [full node](../guides/full-node.md) and
[gripper](../hardware/gripper.md) the same of theirs."""


class Offer(NamedTuple):
    """A name that a node offers."""

    name: str
    type: str
    qos: str = ""


class Offers(NamedTuple):
    """Everything that a node offers beside what each ROS node has."""

    actions: list[Offer]
    published: list[Offer]
    heard: list[Offer]
    services: list[Offer]


def build() -> str:
    """The page. Starts a node, which nobody else sees."""
    arm = load_arm("mock", overrides={"name": NOBODYS, "gripper": {"hook": "simulated"}})
    offers = offered(arm)
    named = {offer.name for kind in offers for offer in kind}
    assert named == MEANINGS.keys(), f"MEANINGS and the node differ: {sorted(named ^ MEANINGS.keys())}"
    return page(
        "ROS names",
        INTRODUCTION,
        *(
            part
            for title, kind in zip(TITLES, offers, strict=True)
            for part in (f"## {title}", table(HEADS, rows(kind)))
        ),
        "## Parameters",
        "Defaults are those of the arm file `mock`; the last sentence says when a value may be changed.",
        table(("name", "type", "default", "range", "meaning"), parameters(arm)),
        "## Types of robot_arm_interfaces",
        *(
            part
            for path in definitions()
            for part in (f"### {path.stem}", block(path.read_text(encoding="utf-8"), "text"))
        ),
    )


TITLES = ("Actions", "Topics it publishes", "Topics it listens to", "Services")
HEADS = ("name", "type", "QoS", "meaning")


def rows(offers: list[Offer]) -> Iterator[tuple[str, ...]]:
    for offer in sorted(offers):
        yield code(offer.name), code(offer.type), offer.qos, MEANINGS[offer.name]


def definitions() -> list[Path]:
    """The files of our own messages, services and actions."""
    return sorted(path for path in INTERFACES.rglob("*") if path.suffix in {".action", ".msg", ".srv"})


def offered(arm: ArmConfig) -> Offers:
    """What the node of an arm offers."""
    with node_of(arm) as node:
        return offers_of(node)


@contextmanager
def node_of(arm: ArmConfig) -> Iterator[Any]:
    """The node of an arm, which runs for a moment, without a control process."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    from rosfront.node import FrontNode
    from rosfront.program import start_ros

    start_ros([])
    executor = SingleThreadedExecutor()
    front = FrontNode(arm, executor)
    serving = threading.Thread(target=front.spin)
    serving.start()
    try:
        yield front.node
    finally:
        front.close(1.0)
        serving.join()
        executor.shutdown()
        front.node.destroy_node()
        rclpy.shutdown()


def offers_of(node: Any) -> Offers:
    """What a node offers, as rclpy lists it."""
    own = node.get_fully_qualified_name()

    def offers(found: Any, name: str, kind: str) -> list[Offer]:
        return sorted(
            {
                Offer(short(getattr(one, name), own), type_name(getattr(one, kind)), qos_words(one))
                for one in found
                if not ROS_OWN.match(getattr(one, name))
            }
        )

    return Offers(
        actions=sorted(Offer(short(name, own), kind) for name, (kind, *_) in actions_of(node)),
        published=offers(node.publishers, "topic_name", "msg_type"),
        heard=offers(node.subscriptions, "topic_name", "msg_type"),
        services=offers(node.services, "service_name", "srv_type"),
    )


def actions_of(node: Any) -> list[tuple[str, list[str]]]:
    """Names and types of a node's actions; rclpy keeps no list of them, and the middleware's may be a moment late."""
    from rclpy.action.graph import get_action_server_names_and_types_by_node
    from rclpy.action.server import ActionServer

    servers = sum(isinstance(waitable, ActionServer) for waitable in node.waitables)
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        found: list[tuple[str, list[str]]] = get_action_server_names_and_types_by_node(
            node, node.get_name(), node.get_namespace()
        )
        if len(found) == servers:
            return found
        time.sleep(0.01)
    raise AssertionError(f"the middleware does not know all {servers} actions of {node.get_name()}")


def short(name: str, own: str) -> str:
    """A name as the documentation writes it: ~/ for the node's, without / what is relative to its namespace."""
    if name.startswith(f"{own}/"):
        return "~" + name.removeprefix(own)
    return name if name in MEANINGS else name.lstrip("/")


def type_name(kind: type) -> str:
    """package/kind/Name of a message, service or action."""
    package, below, *_ = kind.__module__.split(".")
    return f"{package}/{below}/{kind.__name__}"


def qos_words(one: Any) -> str:
    """Reliability, durability and depth of a publisher or subscription; a service has none worth telling."""
    profile = getattr(one, "qos_profile", None)
    if profile is None or hasattr(one, "srv_type"):
        return ""
    return (
        f"{profile.reliability.name.lower()}, {profile.durability.name.lower().replace('_', ' ')}, last {profile.depth}"
    )


def parameters(arm: ArmConfig) -> Iterator[tuple[str, ...]]:
    """A row a parameter; those of the first joint stand for all."""
    from rosfront.parameters import rules

    first, *others = (joint.name for joint in arm.joints)
    for rule in rules(arm):
        if any(f".{name}." in rule.name for name in others):
            continue
        allowed = f"{rule.lowest:g} to {rule.highest:g}" if isinstance(rule.default, float) else ""
        meaning = f"{rule.description} {rule.change.value}".replace(first, "JOINT")
        default = (
            ""
            if rule.default == NOBODYS
            else str(rule.default).lower()
            if isinstance(rule.default, bool)
            else str(rule.default)
        )
        yield (
            code(rule.name.replace(f".{first}.", ".JOINT.")),
            TYPES[type(rule.default)],
            code(default),
            allowed,
            meaning,
        )


TYPES = {str: "string", bool: "bool", int: "integer", float: "double", list: "string[]"}


def stable() -> list[str]:
    """What is offered as lines of names and types, with the parameters and the fields of our own types."""
    from rosfront.state_topics import INTERFACES

    arm = load_arm("mock", overrides={"name": NOBODYS, "gripper": {"hook": "simulated"}})
    kinds = zip(("action", "topic published", "topic listened to", "service"), offered(arm), strict=True)
    offers = [f"{kind} {offer.name} {offer.type}" for kind, found in kinds for offer in found]
    taken = [f"parameter {name.strip('`')}: {kind}" for name, kind, *_ in parameters(arm)]
    told = [f"/dynamic_joint_states: {name}" for name in INTERFACES]
    return [*offers, *taken, *told, *(field for path in definitions() for field in fields_of(path))]


PARTS = {".msg": ("",), ".srv": ("request ", "response "), ".action": ("goal ", "result ", "feedback ")}


def fields_of(path: Path) -> Iterator[str]:
    """The fields of a type, each with the part it is in."""
    parts = path.read_text(encoding="utf-8").split("---\n")
    for part, text in zip(PARTS[path.suffix], parts, strict=True):
        yield from (f"{path.stem} {part}{line}" for line in text.splitlines() if line and not line.startswith("#"))
