# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The node's input topics: streamed trajectories and the speed scaling factor."""

from typing import Any

from control_msgs.msg import SpeedScalingFactor
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from rosfront.apart import SubscriptionApart
from rosfront.diagnostics import Counts
from rosfront.goal import most_points
from rosfront.plan import GoalPlan
from rosfront.refusals import GoalRefused, Unreadable, angle
from rosfront.serving import Serving
from rosfront.shaper import largest_lag
from rosfront.trajectory_bytes import Trajectory, parse
from rosfront.verdict import Verdict
from shm.words import Outcome

WARN_EVERY_S = 1.0
DEPTH = 10
LONGEST_STOP_S = 0.2
"""How long `stop` waits; a message that takes longer to check is left to a thread that ends with the process."""
_NO_COMPLAINTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""No warning about an incompatible publisher: one of the two subscriptions is expected not to match it."""
_USUAL_ENDS = (Outcome.NONE, Outcome.SUCCEEDED, Outcome.REPLACED, Outcome.RAN_DRY)


def _qos(durability: DurabilityPolicy, depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


def read(data: bytes, most_points: int) -> Trajectory | JointTrajectory:
    """Read a serialised message, by rclpy where `parse` cannot; raises TooManyPoints, TooMuchBeside, Unreadable."""
    found = parse(data, most_points)
    if found is not None:
        return found
    try:
        message: JointTrajectory = deserialize_message(data, JointTrajectory)
    except RuntimeError as problem:  # the base of rclpy's own exceptions, which are private
        raise Unreadable(len(data)) from problem
    return message


class Inputs:
    """~/joint_trajectory, which is received in a thread of its own, and ~/speed_scaling_input.

    A volatile subscription matches every publisher but does not get what a transient-local publisher sent before. A
    transient-local subscription does, but matches no volatile publisher such as `ros2 topic pub`. So the factor has one
    subscription of each kind, and a message that reaches both counts once.
    """

    def __init__(self, node: Node, executor: Executor, serving: Serving, counts: Counts, factor: float) -> None:
        """`factor`: the initial speed scaling factor."""
        self._log = node.get_logger()
        self._serving = serving
        self._counts = counts
        self.factor = factor
        """The factor asked for last, whether or not there was a control process to take it."""
        self._factor_stamp_ns = 0
        volatile = DurabilityPolicy.VOLATILE
        self._streams = SubscriptionApart(
            node, executor, JointTrajectory, "~/joint_trajectory", _qos(volatile, DEPTH), self._stream
        )
        for durability in (volatile, DurabilityPolicy.TRANSIENT_LOCAL):
            node.create_subscription(
                SpeedScalingFactor,
                "~/speed_scaling_input",
                self._scale,  # type: ignore[arg-type]  # rclpy also calls callbacks that want the message's info
                _qos(durability, 1),
                event_callbacks=_NO_COMPLAINTS,
            )

    def start(self) -> None:
        """Start to receive streams."""
        self._streams.start()

    def stop(self) -> None:
        """Stop receiving streams; returns within `LONGEST_STOP_S`."""
        self._streams.stop(LONGEST_STOP_S)

    def _stream(self, data: bytes) -> None:
        try:
            plan = self._serving.stream(read(data, most_points(self._serving.arm)), self._on_verdict)
        except GoalRefused as reason:
            self._counts.messages_refused += 1
            self._log.warning(f"Trajectory message dropped: {reason.sentence}", throttle_duration_sec=WARN_EVERY_S)
        else:
            self._counts.messages_taken += 1
            if plan.reason is not None:
                self._tell_lag(plan, plan.reason)

    def _tell_lag(self, plan: GoalPlan, reason: GoalRefused) -> None:
        """Count and log a message that asks for more than the limits allow, and is followed as closely as they do."""
        joint, lag_rad = largest_lag(plan)
        self._counts.messages_shaped += 1
        self._counts.largest_lag_rad = max(self._counts.largest_lag_rad, round(lag_rad, 6))
        self._log.warning(
            f"Trajectory message followed with a lag, as closely as the limits allow: {self._serving.joints[joint]} is "
            f"{angle(lag_rad)} behind at the most. {reason.sentence}",
            throttle_duration_sec=WARN_EVERY_S,
        )

    def _on_verdict(self, verdict: Verdict) -> None:
        """Log an unusual end. Streamed motion usually ends by being replaced or by an underrun."""
        if verdict.outcome not in _USUAL_ENDS:
            self._log.warning(f"Streamed motion stopped: {verdict.sentence}", throttle_duration_sec=WARN_EVERY_S)

    def _scale(self, message: Any, info: dict[str, Any]) -> None:
        stamp_ns = int(info["source_timestamp"])
        if stamp_ns == self._factor_stamp_ns:
            return
        self._factor_stamp_ns = stamp_ns
        factor = float(message.factor)
        if 0.0 <= factor <= 1.0:
            self.factor = factor
            self.ask_factor()
            return
        self._log.warning(
            f"The speed scaling factor {factor:g} is ignored; allowed are 0 to 1, as trajectories are checked at the "
            "speed they ask for: send one of those.",
            throttle_duration_sec=WARN_EVERY_S,
        )

    def ask_factor(self) -> None:
        """Send the factor to the control process; may be called from any thread."""
        self._serving.command(lambda writer: writer.scale(self.factor), self._on_reply)

    def _on_reply(self, done: bool, sentence: str) -> None:
        if not done:
            self._log.warning(f"The speed scaling factor was not taken: {sentence}", throttle_duration_sec=WARN_EVERY_S)
