# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The ROS node: the action server, what stands beside it, and the publisher's thread.

One single-threaded executor serves all of them; its callbacks never wait. A goal is a coroutine that awaits a
future, which the publisher's thread fulfils when the control process has decided the goal: an idle or
executing arm costs the executor nothing, because nothing wakes it (a timer at the rate of /joint_states would
cost several per cent of a processor, facts: ros-from-wheels).

The end: rclpy's `Executor.shutdown` frees what a spinning executor still uses, so the executor's thread leaves
by itself first, and not before every client that was given a goal has been given its result.
"""

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from sensor_msgs.msg import JointState

from config.schema import ArmConfig
from rosfront import verdict as verdicts
from rosfront.diagnostics import Counts, Diagnostics
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

RESULT_KEPT_S = 60
"""How long a result can be asked for; clients ask at once, and a kept result keeps its whole goal."""
RESULT_GRACE_S = 1.0
"""At the end of this process a result that nobody has asked for yet is kept for so long."""
LEAVE_EVERY_S = 0.02


class _TellingServer(ActionServer):
    """An action server that also says whose result has been sent."""

    def __init__(self, on_sent: Callable[[bytes], None], *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._on_sent = on_sent

    def _send_result_response(self, request_header: Any, future: Future) -> None:
        super()._send_result_response(request_header, future)
        for goal, result in self._result_futures.items():
            if result is future:
                self._on_sent(goal)


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
        self._untold: dict[bytes, float] = {}  # goals whose client has no result yet, and until when that counts
        self._closing = False
        self._has_spun = threading.Event()
        self._counts = Counts()
        self._last_cycle = 0
        self._progress = Progress()
        self._services = Services(self.node, executor, self.serving)
        initial_factor = float(self.node.get_parameter(INITIAL_SCALE).value)
        self._inputs = Inputs(self.node, self.serving, self._counts, initial_factor)
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
                self._counts,
                self.node.create_publisher(DiagnosticArray, "/diagnostics", STATE_QOS),
            ).report,
            self.node.get_logger().info,
            link,
        )
        self._server = _TellingServer(
            self._told,
            self.node,
            FollowJointTrajectory,
            "~/follow_joint_trajectory",
            execute_callback=self._execute,
            goal_callback=self._consider,
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel,
            result_timeout=RESULT_KEPT_S,
        )
        executor.add_node(self.node)
        self.pulse.start()

    # --- goals, in the executor's thread ---

    def spin(self) -> None:
        """Serve; returns after `close`, when every client has its result or its answer."""
        try:
            while not (self._closing and self._services.idle and self._all_told()):
                self._executor.spin_once(LEAVE_EVERY_S if self._closing else None)
        finally:
            self._has_spun.set()

    def _all_told(self) -> bool:
        now_s = time.monotonic()
        return all(until_s < now_s for until_s in self._untold.values())

    def _consider(self, goal: Any) -> GoalResponse:
        """Accept every goal, so that a bad one can be told why; `strict_reject` rejects bad ones instead."""
        if self.arm.trajectory.strict_reject:
            try:
                plan_goal(goal, self.arm, self.serving.present(), self.serving.settings)
            except GoalRefused as reason:
                self.node.get_logger().warning(f"Goal rejected: {reason.sentence}")
                return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _accepted(self, handle: ServerGoalHandle) -> None:
        self._counts.goals_taken += 1
        now_s = time.monotonic()
        self._untold = {goal: until_s for goal, until_s in self._untold.items() if until_s >= now_s}
        self._untold[bytes(handle.goal_id.uuid)] = math.inf
        handle.execute()

    def _told(self, goal: bytes) -> None:
        self._untold.pop(goal, None)

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        """One goal from its acceptance to its single terminal call."""
        try:
            return self._conclude(handle, await self._run(handle))
        finally:
            self._untold[bytes(handle.goal_id.uuid)] = time.monotonic() + RESULT_GRACE_S

    def _conclude(self, handle: ServerGoalHandle, verdict: Verdict) -> Any:
        canceling = handle.is_cancel_requested
        result = FollowJointTrajectory.Result(error_code=verdict.code, error_string=verdict.sentence)
        logger = self.node.get_logger()
        if verdict.status is Status.SUCCEEDED:
            handle.succeed()
            self._counts.goals_succeeded += 1
            logger.info(verdict.sentence)
        elif verdict.status is Status.CANCELED and canceling:
            handle.canceled()
            self._counts.goals_canceled += 1
            logger.info(verdict.sentence)
        else:
            handle.abort()
            self._counts.goals_aborted += 1
            logger.warning(f"Goal aborted: {verdict.sentence}")
            if verdict.status is Status.CANCELED:
                result.error_code = FollowJointTrajectory.Result.INVALID_GOAL
        return result

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
        if self._closing and verdict.status is Status.CANCELED and not handle.is_cancel_requested:
            rest = verdict.sentence.removeprefix("Canceled: ")
            return verdicts.aborted(f"The ROS process was stopped: {rest}")
        return verdict

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """Every cancel is accepted at once; the arm then stops on its path."""
        execution = self._executions.get(bytes(handle.goal_id.uuid))
        if execution is not None:
            self.serving.cancel(execution)
        return CancelResponse.ACCEPT

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
        self._closing = True
        self.serving.close()
        self._services.close()
        self._executor.create_task(lambda: None)  # a turn of `spin`, which may wait for ever
        if not self._has_spun.wait(patience_s):
            self.serving.lost("The ROS process was stopped before the arm had come to rest.")
            self._has_spun.wait()  # every goal is decided, so nothing keeps it
        self.pulse.stop()
