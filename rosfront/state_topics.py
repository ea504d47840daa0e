# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""Messages on the arm's state: /joint_states, ~/controller_state, /dynamic_joint_states, and the action's feedback.

All are filled into messages that were serialised once. `rosfront.joint_states` publishes the first; the next two are
filled only while they have subscribers.
"""

from collections.abc import Callable, Sequence
from functools import partial

from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import DynamicJointState, InterfaceValue, JointTrajectoryControllerState
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectoryPoint

from config.schema import ArmConfig
from rosfront.message_bytes import Instant, MessageBytes, finite
from rosfront.plan import NS
from shm.snapshot import Snapshot

STATE_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Matches reliable and sensor-data subscribers alike (MoveIt, RViz; facts: moveit-client, section 4)."""
INTERFACES = (
    "position",
    "velocity",
    "effort",
    "commanded_position",
    "commanded_velocity",
    "commanded_acceleration",
    "drive_status",
    "referenced",
    "reading_age",
    "drive_temperature",
    "drive_voltage",
)
"""Of each joint in /dynamic_joint_states; the age is in seconds, the others are as in shared memory (°C, V, NaN for
none)."""
LISTENERS_EVERY_S = 0.25
_GOAL_PLACE = bytes(range(0xF0, 0x100))
"""Placeholder for a goal's id while the offsets in a message are searched; these bytes never occur in UTF-8."""


def _header(arm: ArmConfig, stamp: Instant) -> Header:
    return Header(stamp=Time(sec=stamp[0], nanosec=stamp[1]), frame_id=arm.front.frame_id)


def _names(arm: ArmConfig) -> list[str]:
    return [joint.name for joint in arm.joints]


def joint_state_bytes(arm: ArmConfig, *more: str) -> MessageBytes:
    """sensor_msgs/JointState of the arm's joints and of `more`; rows: position, velocity, effort."""
    names = [*_names(arm), *more]

    def serialised(times: Sequence[Instant], rows: Sequence[list[float]]) -> bytes:
        position, velocity, effort = rows
        message = JointState(
            header=_header(arm, times[0]), name=names, position=position, velocity=velocity, effort=effort
        )
        return bytes(serialize_message(message))

    return MessageBytes(serialised, 1, [len(names)] * 3)


def position_bytes(arm: ArmConfig) -> MessageBytes:
    """sensor_msgs/JointState with positions only and an empty frame_id."""

    def serialised(times: Sequence[Instant], rows: Sequence[list[float]]) -> bytes:
        (stamp,), (position,) = times, rows
        header = Header(stamp=Time(sec=stamp[0], nanosec=stamp[1]))
        return bytes(serialize_message(JointState(header=header, name=_names(arm), position=position)))

    return MessageBytes(serialised, 1, [len(arm.joints)])


def controller_state_bytes(arm: ArmConfig) -> MessageBytes:
    """control_msgs/JointTrajectoryControllerState.

    Times: stamp, time from start of the reference, of the feedback. Rows: reference position, velocity and
    acceleration; feedback position and velocity; error of both; output position; the speed scaling factor alone.
    """

    def serialised(times: Sequence[Instant], rows: Sequence[list[float]]) -> bytes:
        stamp, reference_time, feedback_time = times
        positions, velocities, accelerations, found, moving, off, off_moving, output, (factor,) = rows
        message = JointTrajectoryControllerState(
            header=_header(arm, stamp),
            joint_names=_names(arm),
            reference=JointTrajectoryPoint(
                positions=positions,
                velocities=velocities,
                accelerations=accelerations,
                time_from_start=Duration(sec=reference_time[0], nanosec=reference_time[1]),
            ),
            feedback=JointTrajectoryPoint(
                positions=found,
                velocities=moving,
                time_from_start=Duration(sec=feedback_time[0], nanosec=feedback_time[1]),
            ),
            error=JointTrajectoryPoint(positions=off, velocities=off_moving),
            output=JointTrajectoryPoint(positions=output),
            speed_scaling_factor=factor,
        )
        return bytes(serialize_message(message))

    return MessageBytes(serialised, 3, [len(arm.joints)] * 8 + [1])


def feedback_bytes(arm: ArmConfig, goal: bytes) -> MessageBytes:
    """The action's feedback message about one goal, given by its id of 16 bytes.

    Times: stamp, time from start of desired, of actual. Rows: desired position, velocity and acceleration;
    actual position and velocity; error of both.
    """

    def serialised(times: Sequence[Instant], rows: Sequence[list[float]]) -> bytes:
        stamp, desired_time, actual_time = times
        positions, velocities, accelerations, found, moving, off, off_moving = rows
        feedback = FollowJointTrajectory.Feedback(
            header=_header(arm, stamp),
            joint_names=_names(arm),
            desired=JointTrajectoryPoint(
                positions=positions,
                velocities=velocities,
                accelerations=accelerations,
                time_from_start=Duration(sec=desired_time[0], nanosec=desired_time[1]),
            ),
            actual=JointTrajectoryPoint(
                positions=found,
                velocities=moving,
                time_from_start=Duration(sec=actual_time[0], nanosec=actual_time[1]),
            ),
            error=JointTrajectoryPoint(positions=off, velocities=off_moving),
        )
        message = FollowJointTrajectory.Impl.FeedbackMessage(feedback=feedback)
        message.goal_id.uuid = list(_GOAL_PLACE)
        return bytes(serialize_message(message))

    found = MessageBytes(serialised, 3, [len(arm.joints)] * 7)
    found.replace(_GOAL_PLACE, goal)
    return found


def dynamic_joint_state_bytes(arm: ArmConfig) -> MessageBytes:
    """control_msgs/DynamicJointState; one row per joint, its values in the order of `INTERFACES`."""

    def serialised(times: Sequence[Instant], rows: Sequence[list[float]]) -> bytes:
        message = DynamicJointState(
            header=_header(arm, times[0]),
            joint_names=_names(arm),
            interface_values=[InterfaceValue(interface_names=list(INTERFACES), values=row) for row in rows],
        )
        return bytes(serialize_message(message))

    return MessageBytes(serialised, 1, [len(INTERFACES)] * len(arm.joints))


def differences(wanted: Sequence[float], found: Sequence[float]) -> list[float]:
    """wanted - found, one by one."""
    return [a - b for a, b in zip(wanted, found, strict=True)]


class Progress:
    """How long the goal has been running in wall-clock time, however the speed scale slows its trajectory clock."""

    def __init__(self) -> None:
        self._goal = 0
        self._begun_ns = 0
        self.ns = 0
        """Time (ns) of the running goal, else of the last one."""

    def look(self, snapshot: Snapshot) -> None:
        """Update `ns` from a new snapshot of a running goal."""
        goal, now_ns = snapshot["goal_id"], snapshot["monotonic_ns"]
        if goal != self._goal:
            self._goal = goal
            self._begun_ns = now_ns - along_ns(snapshot)
        self.ns = now_ns - self._begun_ns


def along_ns(snapshot: Snapshot) -> int:
    """Time along the trajectory (ns), which the speed scale slows down; 0 before the start."""
    return max(0, int(snapshot["trajectory_clock_ns"]))


class Feedback:
    """Publishes the feedback on a running goal; used by the publisher's thread alone.

    rclpy makes and converts a deeply nested message each time, which costs more than six /joint_states. So this class
    has a second publisher on the action's feedback topic, of the same type and QoS, and fills the bytes.
    """

    def __init__(self, node: Node, action: str, arm: ArmConfig, progress: Progress) -> None:
        """`action`: the action's name, as its server was given it."""
        self._arm = arm
        self._progress = progress
        self._goal = b""
        self._message: MessageBytes
        self._publisher = node.create_publisher(
            FollowJointTrajectory.Impl.FeedbackMessage, f"{action}/_action/feedback", STATE_QOS
        )

    def publish(self, goal: bytes, snapshot: Snapshot, stamp_ns: int) -> None:
        """Publish desired, actual and error; for each joint all three belong to the instant of its measurement, except
        the acceleration, which is the present one."""
        if goal != self._goal:
            self._goal, self._message = goal, feedback_bytes(self._arm, goal)
        column = partial(snapshot.column, "joints")
        wanted, wanted_velocity = column("reference_position_rad"), column("reference_velocity_rad_s")
        found, velocity = column("measured_position_rad"), column("measured_velocity_rad_s")
        rows = (
            wanted,
            wanted_velocity,
            column("commanded_acceleration_rad_s2"),
            found,
            velocity,
            differences(wanted, found),
            differences(wanted_velocity, velocity),
        )
        self._publisher.publish(self._message.fill((stamp_ns, along_ns(snapshot), self._progress.ns), rows))


class StateTopics:
    """~/controller_state and /dynamic_joint_states; used by the publisher's thread alone."""

    def __init__(self, node: Node, arm: ArmConfig, progress: Progress) -> None:
        self._progress = progress
        self._controller_state = controller_state_bytes(arm)
        self._dynamic = dynamic_joint_state_bytes(arm)
        topics: list[tuple[type, str, Callable[[Snapshot, int], bytes]]] = [
            (JointTrajectoryControllerState, "~/controller_state", self._fill_controller_state),
            (DynamicJointState, "dynamic_joint_states", self._fill_dynamic),
        ]
        self._topics: list[tuple[Publisher, Callable[[Snapshot, int], bytes]]] = [
            (node.create_publisher(kind, name, STATE_QOS), fill) for kind, name, fill in topics
        ]
        self._heard = self._topics[:0]
        rate_hz = NS / (arm.control.period_ns * arm.joint_states_every_cycles)
        self._ask_every = max(1, round(rate_hz * LISTENERS_EVERY_S))
        self._ask_in = 0

    def publish(self, snapshot: Snapshot, stamp_ns: int) -> None:
        """Publish a snapshot, stamped with the time of its newest measurement, on the topics with subscribers."""
        if self._ask_in == 0:
            self._ask_in = self._ask_every
            self._heard = [topic for topic in self._topics if topic[0].get_subscription_count()]
        self._ask_in -= 1
        for publisher, fill in self._heard:
            publisher.publish(fill(snapshot, stamp_ns))

    def _fill_controller_state(self, snapshot: Snapshot, stamp_ns: int) -> bytes:
        """Reference, feedback and error of the instant of measurement; acceleration and output are the present ones."""
        column = partial(snapshot.column, "joints")
        wanted, wanted_velocity = column("reference_position_rad"), column("reference_velocity_rad_s")
        found, velocity = column("measured_position_rad"), finite(column("measured_velocity_rad_s"))
        rows = (
            wanted,
            wanted_velocity,
            column("commanded_acceleration_rad_s2"),
            found,
            velocity,
            differences(wanted, found),
            differences(wanted_velocity, velocity),
            column("commanded_position_rad"),
            (snapshot["speed_scale_asked"],),
        )
        return self._controller_state.fill((stamp_ns, along_ns(snapshot), self._progress.ns), rows)

    def _fill_dynamic(self, snapshot: Snapshot, stamp_ns: int) -> bytes:
        column = partial(snapshot.column, "joints")
        now_ns = snapshot["monotonic_ns"]
        rows = zip(
            column("measured_position_rad"),
            finite(column("measured_velocity_rad_s")),
            column("measured_effort"),
            column("commanded_position_rad"),
            column("commanded_velocity_rad_s"),
            column("commanded_acceleration_rad_s2"),
            column("drive_status"),
            column("referenced"),
            [(now_ns - measured_ns) / NS for measured_ns in column("measured_ns")],
            column("drive_temperature_c"),
            column("drive_voltage_v"),
            strict=True,
        )
        return self._dynamic.fill((stamp_ns,), list(rows))
