# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The ROS node: the action, what stands beside it, and the publisher's thread.

One single-threaded executor serves all of them; its callbacks never wait. A goal awaits a future, which the
publisher's thread fulfils when the control process has decided the goal: an idle or executing arm costs the executor
nothing, because nothing wakes it (a timer at the rate of /joint_states would cost several per cent of a processor,
facts: ros-from-wheels).
"""

from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action.server import GoalResponse, ServerGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from sensor_msgs.msg import JointState

from config.schema import ArmConfig
from rosfront import verdict as verdicts
from rosfront.action import GoalServer
from rosfront.diagnostics import Diagnostics
from rosfront.goal import plan_goal
from rosfront.inputs import Inputs
from rosfront.joint_states import Pulse
from rosfront.link import Link
from rosfront.parameters import INITIAL_SCALE, CheckedNode
from rosfront.plan import NS
from rosfront.refusals import GoalRefused
from rosfront.services import Services
from rosfront.serving import NEVER_BEGUN, Execution, Serving
from rosfront.state_topics import STATE_QOS, Progress, StateTopics, along_ns, differences, joint_state_bytes
from rosfront.verdict import Status, Verdict


class FrontNode:
    """The node, its action server and the publisher's thread; `spin` serves until `close`."""

    def __init__(self, arm: ArmConfig, executor: SingleThreadedExecutor, link: Link | None = None) -> None:
        """Raises rosfront.parameters.BadParameter when a parameter given at the start cannot be taken."""
        self.arm = arm
        self.serving = Serving(arm)
        self.node = CheckedNode(arm, self.serving)
        self._executor = executor
        self._executions: dict[bytes, Execution] = {}
        self._moving: dict[int, ServerGoalHandle] = {}
        self._feedback_ns = 0
        self._feedback = self._empty_feedback()
        self._last_cycle = 0
        self._progress = Progress()
        self._services = Services(self.node, executor, self.serving)
        self._goals = GoalServer(
            self.node,
            executor,
            "~/follow_joint_trajectory",
            run=self._run,
            cancel=self._cancel,
            consider=self._consider,
            idle=lambda: self._services.idle,
        )
        initial_factor = float(self.node.get_parameter(INITIAL_SCALE).value)
        self._inputs = Inputs(self.node, self.serving, self._goals.counts, initial_factor)
        self._state_topics = StateTopics(self.node, arm, self._progress)
        self.pulse = Pulse(
            arm,
            self.serving,
            joint_state_bytes(arm),
            self.node.create_publisher(JointState, "joint_states", STATE_QOS),
            self._look,
            Diagnostics(
                arm,
                self.serving,
                self._goals.counts,
                self.node.create_publisher(DiagnosticArray, "/diagnostics", STATE_QOS),
            ).report,
            self.node.get_logger().info,
            link,
        )
        executor.add_node(self.node)
        self.pulse.start()

    # --- goals, in the executor's thread ---

    def spin(self) -> None:
        """Serve; returns after `close`, when every client has its result or its answer."""
        self._goals.spin()

    def announce(self) -> None:
        """Print `ready` once: the server is up and the control process is there."""
        self.serving.ever_attached.wait()
        print(f"ready {self.node.get_fully_qualified_name()}/follow_joint_trajectory", flush=True)

    def _consider(self, goal: Any) -> GoalResponse:
        """Accept every goal, so that a bad one can be told why; `strict_reject` rejects bad ones instead."""
        if self.arm.trajectory.strict_reject:
            try:
                plan_goal(goal, self.arm, self.serving.present(), self.serving.settings)
            except GoalRefused as reason:
                self.node.get_logger().warning(f"Goal rejected: {reason.sentence}")
                return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _run(self, handle: ServerGoalHandle) -> Verdict:
        if handle.is_cancel_requested:
            return Verdict(Status.CANCELED, 0, NEVER_BEGUN)
        decided: Future = Future()

        def on_verdict(verdict: Verdict) -> None:
            decided.set_result(verdict)
            self._executor.wake()

        try:
            plan = plan_goal(handle.request, self.arm, self.serving.present(), self.serving.settings)
            execution = self.serving.start(plan, on_verdict)
        except GoalRefused as reason:
            return verdicts.refused(reason)
        key = bytes(handle.goal_id.uuid)
        self._executions[key] = execution
        self._moving[execution.goal_id] = handle
        try:
            verdict: Verdict = await decided
        finally:
            del self._executions[key], self._moving[execution.goal_id]
        if self._goals.closing and verdict.status is Status.CANCELED and not handle.is_cancel_requested:
            rest = verdict.sentence.removeprefix("Canceled: ")
            return verdicts.aborted(f"The ROS process was stopped: {rest}")
        return verdict

    def _cancel(self, handle: ServerGoalHandle) -> None:
        """The arm then stops on its path."""
        execution = self._executions.get(bytes(handle.goal_id.uuid))
        if execution is not None:
            self.serving.cancel(execution)

    # --- every snapshot, in the publisher's thread ---

    def _look(self, snapshot: np.void, stamp_ns: int, fresh: bool) -> None:
        """`fresh`: something has been measured since the last snapshot, so it is worth telling."""
        if self._inputs.factor != 1.0:
            self._tell_factor(snapshot)
        self._last_cycle = int(snapshot["cycle"])
        execution = self.serving.look(snapshot)
        if execution is not None:
            self._progress.look(snapshot)
        if fresh:
            self._state_topics.publish(snapshot, stamp_ns)
        if execution is None:
            return
        now_ns = int(snapshot["monotonic_ns"])
        handle = self._moving.get(execution.goal_id)
        every_ns = NS / self.serving.settings.feedback_hz
        if handle is not None and now_ns - self._feedback_ns >= every_ns - self.arm.control.period_ns // 2:
            self._feedback_ns = now_ns
            self._fill_feedback(snapshot, stamp_ns)
            handle.publish_feedback(self._feedback)

    def _tell_factor(self, snapshot: np.void) -> None:
        """Tell a control process that is new to this node how fast it is to be, unless somebody has told it already."""
        is_new = self._last_cycle == 0 or int(snapshot["cycle"]) < self._last_cycle
        if is_new and snapshot["speed_scale_asked"] == 1.0:
            self._inputs.ask_factor()

    def _empty_feedback(self) -> Any:
        """The feedback message, made once: making one costs as much as sending it."""
        feedback = FollowJointTrajectory.Feedback()
        feedback.header.frame_id = self.arm.front.frame_id
        feedback.joint_names = [joint.name for joint in self.arm.joints]
        return feedback

    def _fill_feedback(self, snapshot: np.void, stamp_ns: int) -> None:
        """Desired, actual and error; for each joint all three belong to the instant of its measurement, but for
        the acceleration, which is that of now."""
        joints = snapshot["joints"][: len(self.arm.joints)]
        feedback = self._feedback
        desired, actual, error = feedback.desired, feedback.actual, feedback.error
        for moment, time_ns in (
            (feedback.header.stamp, stamp_ns),
            (desired.time_from_start, along_ns(snapshot)),
            (actual.time_from_start, self._progress.ns),
        ):
            moment.sec, moment.nanosec = divmod(time_ns, NS)
        desired.positions = wanted = joints["reference_position_rad"].tolist()
        actual.positions = found = joints["measured_position_rad"].tolist()
        error.positions = differences(wanted, found)
        desired.velocities = wanted = joints["reference_velocity_rad_s"].tolist()
        actual.velocities = found = joints["measured_velocity_rad_s"].tolist()
        error.velocities = differences(wanted, found)
        desired.accelerations = joints["commanded_acceleration_rad_s2"].tolist()

    # --- the end ---

    def close(self, patience_s: float) -> None:
        """Stop a running goal on its path, tell its client, and end; call from a thread of neither kind.

        Returns when the thread in `spin` has left it, after `patience_s` and `RESULT_GRACE_S` at the latest.
        """
        self._goals.closing = True
        self.serving.close()
        self._services.close()
        self._goals.leave(
            patience_s, lambda: self.serving.lost("The ROS process was stopped before the arm had come to rest.")
        )
        self.pulse.stop()
