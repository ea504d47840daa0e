# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The ROS node: the action, what stands beside it, and the publisher's thread.

One single-threaded executor serves all of them; its callbacks never wait, and goals are judged in another thread. A
goal awaits a future, which the publisher's thread fulfils when the control process has decided the goal: an idle or
executing arm costs the executor nothing, because nothing wakes it (a timer at the rate of /joint_states would cost
several per cent of a processor, facts: ros-from-wheels).
"""

from typing import Any

import numpy as np
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
from rosfront.intake import ConsideredGoal, Intake, PendingGoal
from rosfront.joint_states import Pulse
from rosfront.link import Link
from rosfront.parameters import INITIAL_SCALE, CheckedNode
from rosfront.plan import NS, GoalPlan
from rosfront.refusals import GoalRefused, NotServing
from rosfront.services import Services
from rosfront.serving import CLOSING, NEVER_BEGUN, Serving
from rosfront.state_topics import STATE_QOS, Feedback, Progress, StateTopics, joint_state_bytes
from rosfront.verdict import Status, Verdict

ACTION = "~/follow_joint_trajectory"
HELD = "Ended by ~/hold before it could begin; it did not move the arm: send it again when the arm may move."
_NOT_SERVING = verdicts.refused(NotServing(CLOSING))


class FrontNode:
    """The node, its action server and the publisher's thread; `spin` serves until `close`."""

    def __init__(self, arm: ArmConfig, executor: SingleThreadedExecutor, link: Link | None = None) -> None:
        """Raises rosfront.parameters.BadParameter when a parameter given at the start cannot be taken."""
        self.arm = arm
        self.serving = Serving(arm)
        self.node = CheckedNode(arm, self.serving)
        self._executor = executor
        self._pending: dict[bytes, PendingGoal] = {}
        self._considered: set[ConsideredGoal] = set()
        self._intake = Intake()
        self._feedback_ns = 0
        self._last_cycle = 0
        self._progress = Progress()
        self._services = Services(self.node, executor, self.serving, self._end_unbegun)
        self._goals = GoalServer(
            self.node,
            executor,
            ACTION,
            run=self._run,
            accepted=self._accepted,
            cancel=self._cancel,
            consider=self._consider,
            idle=lambda: self._services.idle,
        )
        initial_factor = float(self.node.get_parameter(INITIAL_SCALE).value)
        self._inputs = Inputs(self.node, executor, self.serving, self._goals.counts, initial_factor)
        self._feedback = Feedback(self.node, ACTION, arm, self._progress)
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
        self._intake.start()
        self._inputs.start()
        self.pulse.start()

    # --- goals, in the executor's thread ---

    def spin(self) -> None:
        """Serve; returns after `close`, when every client has its result or its answer."""
        self._goals.spin()

    def announce(self) -> None:
        """Print `ready` once: the server is up and the control process is there."""
        self.serving.ever_attached.wait()
        print(f"ready {self.node.get_fully_qualified_name()}/follow_joint_trajectory", flush=True)

    def _plan(self, goal: Any) -> GoalPlan:
        """Judge a goal; raises GoalRefused."""
        return plan_goal(goal, self.arm, self.serving.present(), self.serving.settings)

    async def _consider(self, goal: Any) -> GoalResponse:
        """Accept every goal, so that a bad one can be told why; `strict_reject` rejects bad ones instead."""
        if not self.arm.trajectory.strict_reject:
            return GoalResponse.ACCEPT
        considered = ConsideredGoal(self._executor.wake)

        def judge() -> None:
            if considered.ended.done():
                return
            try:
                self._plan(goal)
            except GoalRefused as reason:
                considered.end(reason)
            except Exception as problem:
                considered.fail(problem)
            else:
                considered.end(None)

        self._considered.add(considered)
        self._intake.put(judge)
        if self._goals.closing:
            considered.end(NotServing(CLOSING))
        try:
            reason: GoalRefused | None = await considered.ended
        finally:
            self._considered.discard(considered)
        if reason is None:
            return GoalResponse.ACCEPT
        self.node.get_logger().warning(f"Goal rejected: {reason.sentence}")
        return GoalResponse.REJECT

    def _accepted(self, handle: ServerGoalHandle) -> None:
        key = bytes(handle.goal_id.uuid)
        goal = self._pending[key] = PendingGoal(self._executor.wake, self.serving.turn())
        self._intake.put(lambda: self._begin(goal, handle.request, key))
        if self._goals.closing:
            goal.execution_or_end(_NOT_SERVING)

    async def _run(self, handle: ServerGoalHandle) -> Verdict:
        key = bytes(handle.goal_id.uuid)
        goal = self._pending[key]
        try:
            verdict: Verdict = await goal.ended
        finally:
            del self._pending[key]
        if verdict.status is not Status.CANCELED or handle.is_cancel_requested:
            return verdict
        rest = verdict.sentence.removeprefix("Canceled: ")
        if goal.held:
            return verdicts.aborted(HELD if verdict.sentence == NEVER_BEGUN else f"Ended by ~/hold: {rest}")
        if self._goals.closing:
            return verdicts.aborted(f"The ROS process was stopped: {rest}")
        return verdict

    def _begin(self, goal: PendingGoal, message: Any, key: bytes) -> None:
        """Judge a goal and hand it on; in the intake's thread."""
        if goal.ended.done():
            return
        try:
            plan = self._plan(message)
            goal.begin(lambda: self.serving.start(plan, goal.end, key, goal.turn))
        except GoalRefused as reason:
            goal.end(verdicts.refused(reason))
        except Exception as problem:
            goal.fail(problem)

    def _cancel(self, handle: ServerGoalHandle) -> None:
        """The arm then stops on its path."""
        goal = self._pending.get(bytes(handle.goal_id.uuid))
        if goal is not None:
            self._stop(goal)

    def _stop(self, goal: PendingGoal) -> None:
        execution = goal.execution_or_end(Verdict(Status.CANCELED, 0, NEVER_BEGUN))
        if execution is not None:
            self.serving.cancel(execution)

    def _end_unbegun(self) -> list[Future]:
        """End what would move an arm that holds, for a hold; returns futures that are done when it is so."""
        for considered in self._considered:
            considered.end(NotServing(HELD))
        goals = [goal for goal in self._pending.values() if not goal.ended.done()]
        for goal in goals:
            goal.held = True
            self._stop(goal)
        return [goal.ended for goal in goals]

    # --- every snapshot, in the publisher's thread ---

    def _look(self, snapshot: np.ndarray, stamp_ns: int, fresh: bool) -> None:
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
        every_ns = NS / self.serving.settings.feedback_hz
        if execution.action_goal and now_ns - self._feedback_ns >= every_ns - self.arm.control.period_ns // 2:
            self._feedback_ns = now_ns
            self._feedback.publish(execution.action_goal, snapshot, stamp_ns)

    def _tell_factor(self, snapshot: np.ndarray) -> None:
        """Tell a control process that is new to this node how fast it is to be, unless somebody has told it already."""
        is_new = self._last_cycle == 0 or int(snapshot["cycle"]) < self._last_cycle
        if is_new and snapshot["speed_scale_asked"] == 1.0:
            self._inputs.ask_factor()

    # --- the end ---

    def close(self, patience_s: float) -> None:
        """Stop a running goal on its path, tell its client, and end; call from a thread of neither kind.

        Returns when the thread in `spin` has left it, after `patience_s` and `RESULT_GRACE_S` at the latest.
        """
        self._goals.closing = True
        for considered in list(self._considered):
            considered.end(NotServing(CLOSING))
        for goal in list(self._pending.values()):
            goal.execution_or_end(_NOT_SERVING)
        self.serving.close()
        self._services.close()
        self._goals.leave(
            patience_s, lambda: self.serving.lost("The ROS process was stopped before the arm had come to rest.")
        )
        self._inputs.stop()
        self._intake.stop()
        self.pulse.stop()
