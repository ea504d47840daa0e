# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The node's services: what operators ask of the arm besides goals.

Each Trigger is answered when the requested state is reached or cannot be reached any more; meanwhile the executor
serves other clients. This needs a reentrant callback group: in the node's default group the next cancel would wait
behind a hold that is not answered yet.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from control_msgs.srv import QueryTrajectoryState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from config.stopping import Patience
from rosfront.plan import NS
from rosfront.refusals import GoalRefused
from rosfront.serving import Serving
from rosfront.verdict import Names, fault_of
from sentences.told import reasons_unreferenced, unreferenced_sentences
from shm.client import CommandWriter
from shm.snapshot import Snapshot
from shm.words import DriveStatus, Fault, Mode, Phase, Request

RELEASE_PATIENCE_S = 5.0
RESUME_PATIENCE_S = 2.0
HOMING_PATIENCE_S = 3600.0
CLOSING = "The ROS process was stopped before the control process had answered: look at `rtarm status`."


class Reply(NamedTuple):
    """The answer of a Trigger service."""

    success: bool
    message: str


Judge = Callable[[Snapshot], Reply | None]
"""Returns the reply that a snapshot decides; None while it is not decided."""


@dataclass(frozen=True)
class Order:
    """A service and what it asks the control process for: a request, or a store by the command writer."""

    name: str
    ask: Request | Callable[[CommandWriter], None]
    patience_s: float
    judge: Callable[[Snapshot | None, Names], Judge]
    """Makes the judge from the last snapshot before the request and the names of joints and buses."""
    answer_now: Callable[[Snapshot, Names], Reply | None] = lambda before, names: None
    """The reply when there is nothing to ask the control process for; else None."""


def _fault(snapshot: Snapshot, names: Names) -> Reply | None:
    return Reply(False, fault_of(snapshot, names)) if snapshot["mode"] == Mode.FAULT else None


def _unreferenced(snapshot: Snapshot, names: Names) -> list[str]:
    return unreferenced_sentences(reasons_unreferenced(snapshot, names.joints))


def _holds(snapshot: Snapshot, names: Names, begin: str) -> Reply | None:
    doing = {Mode.HOLDING: "the arm holds where it stands", Mode.EXECUTING: "a goal is running"}
    mode = snapshot["mode"]
    if mode not in doing:
        return None
    return Reply(True, " ".join([f"{begin}; {doing[Mode(mode)]}.", *_unreferenced(snapshot, names)]))


def _enabled(before: Snapshot | None, names: Names) -> Judge:
    return lambda now: _fault(now, names) or _holds(now, names, "The drives are enabled")


def _not_with_a_fault(before: Snapshot, names: Names) -> Reply | None:
    fault = _fault(before, names)
    if fault is None:
        return None
    return Reply(False, f"A fault is latched; clear it first, which enables the drives too. {fault.message}")


def _cleared(before: Snapshot | None, names: Names) -> Judge:
    latched_ns = None if before is None else before["fault_ns"]

    def judge(now: Snapshot) -> Reply | None:
        again = _fault(now, names)
        if again is None:
            return _holds(now, names, "The fault is cleared")
        if now["fault_ns"] == latched_ns:
            return None  # bring-up has not begun yet
        return Reply(False, f"The fault was cleared and came back. {again.message}")

    return judge


def _nothing_to_clear(before: Snapshot, names: Names) -> Reply | None:
    if before["fault"] != Fault.NONE:
        return None
    return Reply(True, "No fault is latched, so there is nothing to clear.")


def _limp(mode: Mode, words: str) -> Callable[[Snapshot | None, Names], Judge]:
    def judge_of(before: Snapshot | None, names: Names) -> Judge:
        def judge(now: Snapshot) -> Reply | None:
            limp = not np.any(now["joints"]["drive_status"][: len(names.joints)] & DriveStatus.ENABLED)
            return _fault(now, names) or (Reply(True, words) if limp and now["mode"] == mode else None)

        return judge

    return judge_of


def _held(before: Snapshot | None, names: Names) -> Judge:
    def judge(now: Snapshot) -> Reply | None:
        fault = _fault(now, names)
        if fault is not None:
            return fault
        if not now["held"] or _moves(now):
            return None
        if now["goal_id"] == 0:
            return Reply(True, "The arm stands and takes no goals before ~/resume.")
        if now["goal_phase"] != Phase.PAUSED:
            return None
        return Reply(True, "The arm stands on its path; its goal goes on with ~/resume or ends with a cancel.")

    return judge


def _moves(snapshot: Snapshot) -> bool:
    referencing = snapshot["mode"] == Mode.REFERENCING
    return referencing or bool(np.any(snapshot["joints"]["commanded_velocity_rad_s"]))


def _homed(before: Snapshot | None, names: Names) -> Judge:
    def judge(now: Snapshot) -> Reply | None:
        fault = _fault(now, names)
        if fault is not None or now["mode"] == Mode.REFERENCING:
            return fault
        lost = _unreferenced(now, names)
        return Reply(not lost, " ".join(lost) or "Homed; the arm holds where it stands.")

    return judge


def _stopped(before: Snapshot | None, names: Names) -> Judge:
    stops = 0 if before is None else before["stops"]

    def judge(now: Snapshot) -> Reply | None:
        if now["fault"] == Fault.HOMING:  # a drive in its homing run may still be moving
            return _fault(now, names)
        if now["stops"] == stops or _moves(now) or now["goal_id"] != 0:
            return None
        return Reply(True, "The arm stands and takes no goals before ~/resume.")

    return judge


def _resumed(before: Snapshot | None, names: Names) -> Judge:
    paused = before is not None and before["goal_phase"] == Phase.PAUSED
    goal = before["goal_id"] if before is not None and paused else 0

    def judge(now: Snapshot) -> Reply | None:
        if now["held"]:
            return None
        if before is not None and not before["held"]:
            return Reply(True, "The arm is not held.")
        return Reply(
            True, "The goal goes on." if goal != 0 and goal == now["goal_id"] else "The arm takes goals again."
        )

    return judge


def orders(patience: Patience) -> tuple[Order, ...]:
    """The Trigger services of an arm."""
    return (
        Order("enable", Request.ENABLE, patience.bring_up_s, _enabled, _not_with_a_fault),
        Order(
            "disable",
            Request.DISABLE,
            RELEASE_PATIENCE_S,
            _limp(Mode.DISABLED, "The drives are limp and the arm is out of service until ~/enable."),
        ),
        Order(
            "free",
            Request.FREE,
            RELEASE_PATIENCE_S,
            _limp(Mode.FREE, "The drives are limp and the arm can be led by hand until ~/enable."),
        ),
        Order("home", Request.HOME, HOMING_PATIENCE_S, _homed, _not_with_a_fault),
        Order("stop", CommandWriter.stop, patience.person_s, _stopped),
        Order("hold", CommandWriter.hold, patience.person_s, _held),
        Order("resume", CommandWriter.resume, RESUME_PATIENCE_S, _resumed),
        Order("clear_fault", Request.CLEAR_FAULT, patience.bring_up_s, _cleared, _nothing_to_clear),
    )


class Services:
    """The services of one node."""

    def __init__(self, node: Node, executor: Executor, serving: Serving) -> None:
        self._executor = executor
        self._serving = serving
        self._waiting: set[Future] = set()
        self._closing = False
        group = ReentrantCallbackGroup()
        self._orders = {order.name: order for order in orders(serving.arm.patience)}
        for order in self._orders.values():
            node.create_service(Trigger, f"~/{order.name}", self._handler(self._ask, order), callback_group=group)
        node.create_service(QueryTrajectoryState, "~/query_state", self._query, callback_group=group)

    @property
    def idle(self) -> bool:
        """Whether no client waits for an answer."""
        return not self._waiting

    async def ask(self, name: str) -> Reply:
        """Do what the service ~/`name` does; returns its reply."""
        return await self._ask(self._orders[name])

    def close(self) -> None:
        """Answer all waiting clients, and later ones at once."""
        self._closing = True
        for future in list(self._waiting):
            self._fulfil(future, Reply(False, CLOSING))

    def _handler(self, ask: Callable[..., Awaitable[Reply]], *order: Order) -> Callable[[Any, Any], Awaitable[Any]]:
        async def handle(_request: Any, response: Any) -> Any:
            response.success, response.message = await ask(*order)
            return response

        return handle

    async def _ask(self, order: Order) -> Reply:
        before, names = self._serving.newest(), self._serving.names
        known = None if before is None else order.answer_now(before, names)
        if known is not None:
            return known
        judge = order.judge(before, names)
        decided: list[Reply] = []

        def until(snapshot: Snapshot) -> bool:
            reply = judge(snapshot)
            if reply is not None:
                decided.append(reply)
            return reply is not None

        def on_reply(done: bool, sentence: str) -> None:
            self._fulfil(answered, decided[-1] if done else Reply(False, sentence))

        answered: Future = Future()
        self._waiting.add(answered)
        try:
            if isinstance(order.ask, Request):
                self._serving.request(order.ask, on_reply, until=until, patience_s=order.patience_s)
            else:
                self._serving.command(order.ask, on_reply, until=until, patience_s=order.patience_s)
            if self._closing:  # since before this request was in the set
                self._fulfil(answered, Reply(False, CLOSING))
            reply: Reply = await answered
        finally:
            self._waiting.discard(answered)
        return reply

    def _fulfil(self, future: Future, reply: Reply) -> None:
        """Answer once; the first thread to call decides the reply."""
        if not future.done():
            future.set_result(reply)
            self._executor.wake()

    def _query(self, request: Any, response: Any) -> Any:
        try:
            sample = self._serving.sample(request.time.sec * NS + request.time.nanosec)
        except GoalRefused as reason:
            response.success, response.message = False, reason.sentence
            return response
        response.success = True
        response.name = self._serving.joints
        response.position = sample.position_rad.tolist()
        response.velocity = sample.velocity_rad_s.tolist()
        response.acceleration = sample.acceleration_rad_s2.tolist()
        return response
