# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The goals of all actions of an arm from their arrival to their end, whatever they ask for.

Each is checked in the worker's thread, in the order of arrival, and handed to the control process. A newer goal
replaces an older one, of whichever action.
"""

from collections.abc import Callable
from typing import Any

from rclpy.action.server import GoalResponse, ServerGoalHandle
from rclpy.executors import Executor

from rosfront import verdict as verdicts
from rosfront.goal_requests import GoalRequest
from rosfront.goal_worker import ConsideredGoal, GoalWorker, PendingGoal
from rosfront.plan import GoalPlan
from rosfront.refusals import GoalRefused, NotServing
from rosfront.serving import CLOSING, NEVER_BEGUN, Arrival, Serving
from rosfront.verdict import Status, Verdict

_NOT_SERVING = verdicts.refused(NotServing(CLOSING))
_CANCELED = Verdict(Status.CANCELED, 0, NEVER_BEGUN)

Planner = Callable[[], GoalPlan]
"""Checks a goal and translates it into waypoints; raises GoalRefused."""


class ActionGoals:
    """All action goals of one node; `consider`, `accepted`, `run` and `cancel` are called in the executor's thread."""

    def __init__(self, executor: Executor, serving: Serving, warn: Callable[[str], Any]) -> None:
        """`warn` is called with the reason for which a goal was rejected."""
        self._executor = executor
        self._serving = serving
        self._warn = warn
        self._worker = GoalWorker()
        self._pending: dict[bytes, PendingGoal] = {}
        self._considered: set[ConsideredGoal] = set()
        self._closing = False

    def start(self) -> None:
        """Start the thread that checks goals."""
        self._worker.start()

    def stop(self) -> None:
        """End the thread that checks goals, after what was put before."""
        self._worker.stop()

    def put(self, work: Callable[[], None]) -> None:
        """Run `work` in the thread that checks goals, behind those that came before."""
        self._worker.put(work)

    async def consider(self, goal: Any, plan: Planner) -> GoalResponse:
        """Accept every goal, so that the result of a bad one can say why; `strict_reject` rejects bad ones instead."""
        if not self._serving.arm.trajectory.strict_reject:
            return GoalResponse.ACCEPT
        considered, arrival = ConsideredGoal(self._executor.wake), self._arrival(goal)

        def judge() -> None:
            if considered.ended.done():
                return
            try:
                plan()
            except GoalRefused as reason:
                considered.end(reason)
            except Exception as problem:
                considered.fail(problem)
            else:
                considered.end(None)

        self._considered.add(considered)
        self._worker.put(judge)
        if self._closing:
            considered.end(NotServing(CLOSING))
        try:
            reason: GoalRefused | None = await considered.ended
            if reason is None:
                self._serving.refuse_outdated(arrival)
        except NotServing as outdated:
            reason = outdated
        finally:
            self._considered.discard(considered)
        if reason is None:
            return GoalResponse.ACCEPT
        self._warn(f"Goal rejected: {reason.sentence}")
        return GoalResponse.REJECT

    def accepted(self, handle: ServerGoalHandle, plan: Planner) -> None:
        """Queue an accepted goal for its check; `run` awaits its end."""
        key = bytes(handle.goal_id.uuid)
        goal = self._pending[key] = PendingGoal(self._executor.wake, self._arrival(handle.request))
        if handle.is_cancel_requested:
            goal.execution_or_end(_CANCELED)
        self._worker.put(lambda: self._begin(goal, plan, key))
        if self._closing:
            goal.execution_or_end(_NOT_SERVING)

    def _arrival(self, goal: Any) -> Arrival:
        """When a goal has arrived; where that was not noted, now."""
        return goal.arrival if isinstance(goal, GoalRequest) else self._serving.arrival()

    async def run(self, handle: ServerGoalHandle) -> Verdict:
        """Await the end of an accepted goal and return its verdict."""
        key = bytes(handle.goal_id.uuid)
        goal = self._pending[key]
        try:
            verdict: Verdict = await goal.ended
        finally:
            del self._pending[key]
        if verdict.status is not Status.CANCELED or handle.is_cancel_requested:
            return verdict
        rest = verdict.sentence.removeprefix("Canceled: ")
        if self._closing:
            return verdicts.aborted(f"The ROS process was stopped: {rest}")
        return verdict

    def _begin(self, goal: PendingGoal, plan: Planner, key: bytes) -> None:
        """Check a goal and hand it on; in the worker's thread."""
        if goal.ended.done():
            return
        try:
            planned = plan()
            goal.begin(lambda: self._serving.start(planned, goal.end, key, goal.arrival))
        except GoalRefused as reason:
            goal.end(verdicts.refused(reason))
        except Exception as problem:
            goal.fail(problem)

    def cancel(self, handle: ServerGoalHandle) -> None:
        """End a goal that was not handed on yet; otherwise the arm stops on its path."""
        goal = self._pending.get(bytes(handle.goal_id.uuid))
        if goal is None:
            return
        execution = goal.execution_or_end(_CANCELED)
        if execution is not None:
            self._serving.cancel(execution)

    def close(self) -> None:
        """Reject or end what has not begun; from any thread."""
        self._closing = True
        for considered in list(self._considered):
            considered.end(NotServing(CLOSING))
        for goal in list(self._pending.values()):
            goal.execution_or_end(_NOT_SERVING)
