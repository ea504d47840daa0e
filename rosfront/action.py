# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""An action server, whatever carries its goals out: each goal ends once, and its client gets the result.

A goal is a coroutine in the executor's thread. At shutdown rclpy's `Executor.shutdown` frees what a spinning executor
still uses. So the executor's thread first leaves `spin` by itself, but not before every client of an accepted goal has
been given its result.
"""

import math
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Generator
from dataclasses import replace
from functools import partial
from types import coroutine
from typing import Any

import numpy as np
from action_msgs.msg import GoalInfo, GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action.server import ActionServer, CancelResponse, GoalEvent, GoalResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from rosfront.diagnostics import Counts
from rosfront.goal_requests import GoalFunctions, GoalRequest, GoalRequests, Unavailable
from rosfront.refusals import INVALID_GOAL
from rosfront.serving import Arrival
from rosfront.verdict import Status, Verdict

RESULT_KEPT_S = 60
"""How long a result can be asked for; clients ask at once, and rclpy keeps a goal as long as its result."""
RESULT_GRACE_S = 1.0
"""At shutdown a result that its client has not asked for yet is kept for so long."""
LEAVE_EVERY_S = 0.02
ANSWER_TRIES = 30
"""A client can discover the server before the server discovers where to send answers to that client, by a heartbeat of
discovery or more. In rmw_fastrtps each try waits a tenth of a second for that, so these are three seconds. Other
clients are served between two tries."""
LOCKED = (
    "This ROS installation does not let goals be taken as bytes ({}): while a goal of many points is received, nothing "
    "else of this process moves, and one of some 100,000 points may end the goal that runs. Send goals of fewer "
    "points, or use a ROS installation that rtarm is tested with."
)
NOT_TOLD = "This goal was not begun, since its client could not be told that it was accepted ({}): send it again."


@coroutine
def _next_turn() -> Generator[None, None, None]:
    """Let the executor serve others before it resumes the task that awaits this."""
    yield


@coroutine
def _rest_of(begun: Coroutine[Any, Any, None]) -> Generator[Any, Any, None]:
    """Run the rest of a coroutine that has begun and waits for something, which `await` does not accept."""
    waiting = True
    while waiting:
        yield
        waiting = _goes_on(begun)


def _goes_on(begun: Coroutine[Any, Any, None]) -> bool:
    """Run a coroutine until it waits; returns whether it waits, and did not end."""
    try:
        begun.send(None)
    except StopIteration:
        return False
    return True


class _TellingServer(ActionServer):
    """An action server that also reports each result it has sent, and in which nothing waits for a considered goal.

    A request for the result of a goal that it does not have is answered by `of_unknown` with the status UNKNOWN.
    """

    def __init__(
        self,
        executor: Executor,
        on_sent: Callable[[bytes], None],
        of_unknown: Any,
        *arguments: Any,
        **options: Any,
    ) -> None:
        super().__init__(*arguments, **options)
        self._executor = executor
        self._on_sent = on_sent
        self._of_unknown = of_unknown
        self._answering = 0
        self._leaving = False

    @property
    def idle(self) -> bool:
        """Whether no goal is on its way here from the middleware, or waits until its acceptance has been sent."""
        return not self._answering

    def stop(self) -> None:
        """Take no further goal."""
        self._leaving = True

    def is_ready(self, wait_set: Any) -> bool:
        super().is_ready(wait_set)
        self._is_goal_request_ready = self._is_goal_request_ready and not self._leaving
        return self._has_something

    @property
    def _has_something(self) -> bool:
        """Whether something is ready to be taken."""
        return any(
            (
                self._is_goal_request_ready,
                self._is_cancel_request_ready,
                self._is_result_request_ready,
                self._is_goal_expired,
            )
        )

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Handle a cancel without awaiting the consideration of a goal that was taken with it, unlike rclpy.

        A goal that need not be considered is still accepted first, so that a cancel of all goals includes it.
        """
        others = {kind: taken for kind, taken in taken_data.items() if kind != "goal"}
        goal = super().execute({kind: taken for kind, taken in taken_data.items() if kind == "goal"})
        waits = _goes_on(goal)
        await super().execute(others)
        if waits:
            await _rest_of(goal)

    async def _execute_goal_request(self, taken: Any) -> None:
        header, request = taken
        answer = partial(self._handle.send_goal_response, header)
        await self._take_in(bytes(request.goal_id.uuid), request.goal, answer)

    async def _take_in(self, goal_id: bytes, goal: Any, answer: Callable[[Any], object]) -> None:
        """Accept or reject a goal and answer its client, with retries; rclpy answers once, received or not.

        `goal` is passed to `goal_callback`; `answer` raises RuntimeError when the client cannot be reached.
        """
        info = GoalInfo()
        info.goal_id.uuid = np.frombuffer(goal_id, np.uint8)
        with self._lock:
            known = self._handle.goal_exists(info)
        handle = None
        if not known and await self._goal_callback(goal) is GoalResponse.ACCEPT:
            info.stamp = self._node.get_clock().now().to_msg()
            try:
                with self._lock:
                    handle = ServerGoalHandle(self, info, goal)
            except RuntimeError as problem:
                self._logger.error(f"A goal is not taken, since another with its id was accepted meanwhile: {problem}.")
            else:
                self._goal_handles[goal_id] = handle
                result = self._result_futures[goal_id] = Future()
                self.add_future(result)
        response = self._action_type.Impl.SendGoalService.Response(accepted=handle is not None, stamp=info.stamp)
        try:
            await self._answer(answer, response)
        except RuntimeError as problem:
            self._logger.warning(f"The answer to a goal was not sent, so the goal is not begun: {problem}.")
            if handle is not None:
                handle._goal_request = None
                if not handle.is_cancel_requested:
                    handle._update_state(GoalEvent.EXECUTE)  # rcl aborts only what executes or is being canceled
                handle._update_state(GoalEvent.ABORT)
                result.set_result(self._never_begun(str(problem)))
            return
        if handle is None:
            return
        if self._was_canceled(goal) and not handle.is_cancel_requested:
            handle._update_state(GoalEvent.CANCEL_GOAL)
        self._handle.publish_status()
        self._handle_accepted_callback(handle)

    async def _answer(self, answer: Callable[[Any], object], response: Any) -> None:
        """Answer until the client is reached; raises RuntimeError when it was not in `ANSWER_TRIES` tries."""
        self._answering += 1
        try:
            for tries_left in reversed(range(ANSWER_TRIES)):
                try:
                    answer(response)
                    return
                except RuntimeError:
                    if not tries_left:
                        raise
                    self._executor.wake()
                    await _next_turn()
        finally:
            self._answering -= 1

    def _was_canceled(self, _: Any) -> bool:
        """Whether a goal was canceled before it was taken."""
        return False

    def _never_begun(self, why: str) -> Any:
        """The answer to a request for the result of a goal whose acceptance could not be sent."""
        result = self._action_type.Result()
        if isinstance(result, FollowJointTrajectory.Result):
            result.error_code, result.error_string = INVALID_GOAL, NOT_TOLD.format(why)
        return self._action_type.Impl.GetResultService.Response(status=GoalStatus.STATUS_ABORTED, result=result)

    async def _execute_get_result_request(self, request_header_and_message: tuple[Any, Any]) -> None:
        header, request = request_header_and_message
        if bytes(request.goal_id.uuid) in self._goal_handles:
            await super()._execute_get_result_request(request_header_and_message)
        else:
            unknown = self._action_type.Impl.GetResultService.Response(status=GoalStatus.STATUS_UNKNOWN)
            unknown.result = self._of_unknown
            try:
                self._handle.send_result_response(header, unknown)
            except RuntimeError as problem:  # the client is not known to the middleware yet, or no more
                self._logger.warning(f"Who asked for the result of an unknown goal was not answered: {problem}.")

    def _send_result_response(self, request_header: Any, future: Future) -> None:
        super()._send_result_response(request_header, future)
        for goal, result in self._result_futures.items():
            if result is future:
                self._on_sent(goal)


class _UnlockedServer(_TellingServer):
    """A server of follow_joint_trajectory that takes goals as bytes, outside the executor's thread.

    The request of each goal is then a GoalRequest.
    """

    def __init__(
        self,
        functions: GoalFunctions,
        arrival: Callable[[], Arrival],
        executor: Executor,
        *arguments: Any,
        **options: Any,
    ) -> None:
        """`arrival` returns the arrival of what comes now."""
        super().__init__(executor, *arguments, **options)
        self._arrival = arrival
        self._all_canceled = -1
        """The turn of the last cancel of all goals."""
        self._requests = GoalRequests(functions, self._handle, executor, arrival, self._logger.error)
        self._requests.start()

    @property
    def idle(self) -> bool:
        return self._leaving or (super().idle and self._requests.idle)

    def stop(self) -> None:
        super().stop()
        self._requests.stop()

    def is_ready(self, wait_set: Any) -> bool:
        super().is_ready(wait_set)
        if self._is_goal_request_ready:
            self._requests.find()
        self._is_goal_request_ready = self._requests.taken and not self._leaving
        return self._has_something

    def take_data(self) -> dict[str, Any]:
        goal = {"goal": self._requests.pop()} if self._is_goal_request_ready else {}
        self._is_goal_request_ready = False  # so that rclpy does not take it
        others: dict[str, Any] = super().take_data()
        return goal | others

    async def _execute_goal_request(self, request: GoalRequest) -> None:
        await self._take_in(request.goal_id, request, partial(self._requests.answer, request))

    def _was_canceled(self, goal: GoalRequest) -> bool:
        return goal.arrival.turn < self._all_canceled

    async def _execute_cancel_request(self, taken: tuple[Any, Any]) -> None:
        if _is_of_all(taken[1].goal_info):
            self._all_canceled = self._arrival().turn  # includes goals that are still being taken or considered
        await super()._execute_cancel_request(taken)

    async def _execute_goal(self, execute_callback: Any, goal_handle: ServerGoalHandle) -> None:
        await super()._execute_goal(execute_callback, goal_handle)
        goal_handle._goal_request = None  # many bytes, which would be kept as long as the result


def _is_of_all(canceled: GoalInfo) -> bool:
    """Whether a cancel means every goal."""
    return not (any(canceled.goal_id.uuid) or canceled.stamp.sec or canceled.stamp.nanosec)


def trajectory_result(_: ServerGoalHandle, verdict: Verdict) -> Any:
    """The result of follow_joint_trajectory for a verdict."""
    return FollowJointTrajectory.Result(error_code=verdict.code, error_string=verdict.sentence)


class GoalServer:
    """The action server and the executor's thread that serves it.

    Each further action of a node has a GoalServer of its own; only the first one's `spin` runs the executor.

    Attributes:
        closing: no goal is begun any more, and `spin` returns as soon as it can; set by the owner or by `leave`.
        counts: how the goals ended.
    """

    def __init__(
        self,
        node: Node,
        executor: SingleThreadedExecutor,
        name: str,
        *,
        run: Callable[[ServerGoalHandle], Awaitable[Verdict]],
        accepted: Callable[[ServerGoalHandle], None] = lambda _: None,
        cancel: Callable[[ServerGoalHandle], None] = lambda _: None,
        consider: Callable[[Any], GoalResponse | Awaitable[GoalResponse]] = lambda _: GoalResponse.ACCEPT,
        idle: Callable[[], bool] = lambda: True,
        kind: type = FollowJointTrajectory,
        result: Callable[[ServerGoalHandle, Verdict], Any] = trajectory_result,
        counts: Counts | None = None,
        of_unknown: Any = None,
        arrival: Callable[[], Arrival] | None = None,
    ) -> None:
        """`run` carries a goal out and returns how it ended; `cancel` is called when a client cancels a goal.

        `accepted` is called with a goal at once, before it is run and before anything else is served. `consider` may
        reject a goal before it is accepted, without a reason for the client. `idle` returns whether nothing else of the
        node keeps the executor's thread. `kind` is the action's type, and `result` makes its result. `counts` are those
        of another server, in which these goals are counted too. `of_unknown` is the result for goals that this server
        does not have, None an empty one. `arrival` returns the arrival of what comes now. If it is given, goals are
        taken as bytes (GoalRequest), and the action must be follow_joint_trajectory.
        """
        self.closing = False
        self.counts = Counts() if counts is None else counts
        self._log = node.get_logger()
        self._executor = executor
        self._run = run
        self._goal_accepted = accepted
        self._cancel = cancel
        self._consider = consider
        self._considering = 0
        self._idle = idle
        self._result = result
        self._untold: dict[bytes, float] = {}  # goals whose client has no result yet, and until when that counts (s)
        self._has_spun = threading.Event()
        self._spins_until_s = math.inf
        make: Callable[..., _TellingServer] = _TellingServer
        if arrival is not None:
            try:
                make = partial(_UnlockedServer, GoalFunctions(), arrival)
            except Unavailable as problem:
                self._log.warning(LOCKED.format(problem))
        self._server = make(
            executor,
            self._told,
            kind.Result() if of_unknown is None else of_unknown,  # type: ignore[attr-defined]  # every action has one
            node,
            kind,
            name,
            callback_group=ReentrantCallbackGroup(),  # a goal being considered delays no cancel
            execute_callback=self._execute,
            goal_callback=self._considered,
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel_asked,
            result_timeout=RESULT_KEPT_S,
        )

    def spin(self) -> None:
        """Serve; returns once it is `closing`, when every client has its result or its answer.

        Clients that go on sending goals cannot keep it from returning for ever (`leave`).
        """
        try:
            while not (self.closing and self._idle() and self.quiet) and time.monotonic() < self._spins_until_s:
                self._executor.spin_once(LEAVE_EVERY_S if self.closing else None)
        finally:
            self._has_spun.set()

    def leave(self, patience_s: float, give_up: Callable[[], None]) -> None:
        """Wait until `spin` has returned; call in another thread.

        If it has not after `patience_s`, `give_up` is called, which must end every goal. No goal is taken from then on,
        and a client that has no result `RESULT_GRACE_S` later gets none.
        """
        self.closing = True
        self._executor.create_task(lambda: None)  # wakes `spin`, which may wait without timeout
        if not self._has_spun.wait(patience_s):
            give_up()
            self._server.stop()
            self._spins_until_s = time.monotonic() + RESULT_GRACE_S
            self._has_spun.wait()
        self._server.stop()

    @property
    def quiet(self) -> bool:
        """Whether no goal is being taken or considered and every client has its result."""
        now_s = time.monotonic()
        told = all(until_s < now_s for until_s in self._untold.values())
        return told and not self._considering and self._server.idle

    async def _considered(self, goal: Any) -> GoalResponse:
        self._considering += 1
        try:
            response = self._consider(goal)
            if not isinstance(response, GoalResponse):
                response = await response
        finally:
            self._considering -= 1
        return response

    def _accepted(self, handle: ServerGoalHandle) -> None:
        self.counts.goals_taken += 1
        now_s = time.monotonic()
        self._untold = {goal: until_s for goal, until_s in self._untold.items() if until_s >= now_s}
        self._untold[bytes(handle.goal_id.uuid)] = math.inf
        self._goal_accepted(handle)
        handle.execute()

    def _told(self, goal: bytes) -> None:
        self._untold.pop(goal, None)

    def _cancel_asked(self, handle: ServerGoalHandle) -> CancelResponse:
        """Every cancel is accepted at once: MoveIt waits for the answer (facts: moveit-client, section 1)."""
        self._cancel(handle)
        return CancelResponse.ACCEPT

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        """Run one goal from its acceptance to its single terminal call."""
        try:
            return self._conclude(handle, await self._run(handle))
        finally:
            self._untold[bytes(handle.goal_id.uuid)] = time.monotonic() + RESULT_GRACE_S

    def _conclude(self, handle: ServerGoalHandle, verdict: Verdict) -> Any:
        canceling = handle.is_cancel_requested
        if verdict.status is Status.SUCCEEDED:
            handle.succeed()
            self.counts.goals_succeeded += 1
            if verdict.sentence:
                self._log.info(verdict.sentence)
        elif verdict.status is Status.CANCELED and canceling:
            handle.canceled()
            self.counts.goals_canceled += 1
            self._log.info(verdict.sentence)
        else:
            handle.abort()
            self.counts.goals_aborted += 1
            self._log.warning(f"Goal aborted: {verdict.sentence}")
            if verdict.status is Status.CANCELED:
                verdict = replace(verdict, code=INVALID_GOAL)
        return self._result(handle, verdict)
