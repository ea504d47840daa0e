"""Goals between the action server and the control process, without any ROS in it.

Several threads call it. The goal worker's and the executor's start and cancel goals. The publisher's, which sees every
snapshot first, feeds the ring and finds out how goals end. The owner of a goal gets its verdict through `on_verdict`,
exactly once, from the publisher's thread or, at shutdown, from the thread that calls `lost`.
"""

import itertools
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from config.schema import ArmConfig
from rosfront.goal import plan_stream
from rosfront.link import Link
from rosfront.path import PlannedPath
from rosfront.plan import NS, GoalPlan, Present, Sample
from rosfront.refusals import INVALID_GOAL, NotServing, Overtaken
from rosfront.settings import Settings
from rosfront.streamer import Streamer, horizon_s
from rosfront.verdict import Names, Status, Verdict, aborted, fault_of, final_error, judge, with_final_error
from sentences.told import answer_sentence, outcome_sentence, reasons_unreferenced, unreferenced_sentences
from shm.client import GOALS_AHEAD, CommandWriter
from shm.errors import RingFull, TornRead
from shm.files import start_command
from shm.gripper import read_gripper
from shm.snapshot import Snapshot
from shm.words import Answer, Mode, Outcome, Request

STALLED_NS = 400_000_000
"""A control process whose snapshots are older counts as hung: goals are refused and running ones aborted."""
PAUSE_NS = 100_000_000
"""When the publisher's thread has seen no snapshot for so long, this process stood still."""
FAULT_PATIENCE_NS = 500_000_000
"""A goal that a control process in fault has not decided by then never will be; it is aborted."""
NEVER_BEGUN = "Canceled before it was begun; the arm was not moved."
CLOSING = "The ROS process is shutting down and takes no goals: start it again."
_TAKES_GOALS = (Mode.HOLDING, Mode.EXECUTING, Mode.STOPPING)


class Arrival(NamedTuple):
    """When a goal or a stream arrived."""

    turn: int
    """Its place in the order of arrival."""
    epoch: int
    """The control process' epoch at the arrival. When the epoch has risen since, the goal or stream is not begun."""


@dataclass
class Execution:
    """A goal that was handed to the control process and is not decided yet."""

    goal_id: int
    plan: GoalPlan
    on_verdict: Callable[[Verdict], None]
    action_goal: bytes = b""
    """Its id as an action goal; empty for a stream or a move that the arm file asks for."""
    epoch: int = 0
    """The control process' epoch when it arrived."""
    never_begun: bool = False
    """Canceled before anything of it was written for the control process."""
    fault_since_ns: int = 0

    @property
    def target_rad(self) -> np.ndarray:
        """Positions of the joints at the end, (joints,)."""
        target: np.ndarray = self.plan.joints[-1, :, 0]
        return target


@dataclass
class _Request:
    """A request whose answer, or whose effect, has not been seen yet."""

    sequence: int
    """0 for a store, which gets no answer."""
    on_reply: Callable[[bool, str], None]
    until: Callable[[Snapshot], bool] | None
    too_late_ns: int
    patience_s: float
    answered: bool = False


class Serving:
    """The goals and requests of one arm."""

    def __init__(self, arm: ArmConfig) -> None:
        self.arm = arm
        self.joints = [joint.name for joint in arm.joints]
        self.names = Names(self.joints, arm.bus_names)
        self._lock = threading.Lock()
        self._link: Link | None = None
        self._absence = f"The control process of arm '{arm.name}' is not running: start it with {_start_command(arm)}."
        self._undecided: dict[int, Execution] = {}
        self._newest_goal = 0  # never used twice: the control process remembers a cancel that comes before its goal
        self._turns = itertools.count()
        self._newest_turn = -1
        self._epoch = 0
        """The epoch that the publisher's thread has seen last, at `_looked_ns`."""
        self._looked_ns = 0
        self._streams: dict[int, Streamer] = {}  # by goal: those that are not in the ring completely
        self._requests: list[_Request] = []
        self.settings = Settings.of(arm)
        self.other_server = ""
        """A sentence that says who else serves the arm's action and what to do; empty for no other."""
        self._closing = False
        self.ever_attached = threading.Event()

    # --- from the publisher's thread ---

    def attached(self, link: Link) -> None:
        """Use these files of the control process from now on; goals can be handed on."""
        with self._lock:
            self._link = link
            with suppress(TornRead):  # the next `look` sets them
                self._epoch, self._looked_ns = link.reader.snapshot()["epoch"], time.monotonic_ns()
        self.ever_attached.set()

    def lost(self, reason: str) -> None:
        """The control process is gone, hangs or has not begun: abort goals with the `reason` and refuse later ones."""
        with self._lock:
            ended = list(self._undecided.values())
            if self._link is not None:
                for execution in ended:  # if it only hangs, it must not go on with them later
                    if self._is_begun(execution):
                        self._link.writer.cancel(execution.goal_id)
            self._link, self._absence = None, reason
            self._streams.clear()
            self._undecided.clear()
            requests, self._requests = self._requests, []
        for execution in ended:
            execution.on_verdict(aborted(reason))
        for request in requests:
            request.on_reply(False, reason)

    def look(self, snapshot: Snapshot) -> Execution | None:
        """Feed the ring, hand out the verdicts and replies of a snapshot; returns the execution that moves the arm."""
        self._epoch, self._looked_ns = snapshot["epoch"], time.monotonic_ns()
        if not self._undecided and not self._requests:
            return None  # without the lock: a goal or request that is added now is handled with the next snapshot
        verdicts: list[tuple[Execution, Verdict]] = []
        replies: list[tuple[_Request, bool, str]] = []
        with self._lock:
            link = self._link
            if link is None:
                return None
            replies = self._answered(snapshot)
            moving = self._undecided.get(snapshot["goal_id"])
            self._pump(link, snapshot["goal_id"], snapshot["trajectory_clock_ns"])
            for execution in list(self._undecided.values()):
                verdict = self._decide(execution, snapshot)
                if verdict is not None:
                    del self._undecided[execution.goal_id]
                    verdicts.append((execution, verdict))
                    self._streams.pop(execution.goal_id, None)
        for execution, verdict in verdicts:
            execution.on_verdict(verdict)
        for request, done, sentence in replies:
            request.on_reply(done, sentence)
        return moving

    def _answered(self, snapshot: Snapshot) -> list[tuple[_Request, bool, str]]:
        """Remove the requests that are done, refused or too late; returns them with their replies."""
        replies: list[tuple[_Request, bool, str]] = []
        for request in list(self._requests):
            answer = snapshot.find("answers", "sequence", request.sequence) if request.sequence else None
            if answer is not None and int(answer["answer"]) != Answer.DONE:
                replies.append((request, False, answer_sentence(int(answer["answer"]))))
            elif (answer is not None or request.answered) and (request.until is None or request.until(snapshot)):
                replies.append((request, True, answer_sentence(Answer.DONE)))
            elif snapshot["monotonic_ns"] > request.too_late_ns:
                replies.append((request, False, f"Not within {request.patience_s:g} s: see `rtarm status`."))
            elif answer is not None:
                request.answered = True  # later answers overwrite this one
                continue
            else:
                continue
            self._requests.remove(request)
        return replies

    def _pump(self, link: Link, running_goal: int, clock_ns: float) -> None:
        """Write what is due of every undecided goal: the running one goes on until a newer one has been entered."""
        now_ns = time.monotonic_ns()
        for goal_id, stream in list(self._streams.items()):
            if stream.is_held_back(now_ns):
                continue
            at_ns = clock_ns if goal_id == running_goal else stream.due_ns(now_ns)
            stream.pump(link.writer, link.reader.setpoints_consumed(), at_ns)
            if stream.done:
                del self._streams[goal_id]

    def _decide(self, execution: Execution, snapshot: Snapshot) -> Verdict | None:
        """The verdict that a snapshot gives on a goal; None while it is undecided."""
        goal_id, running = execution.goal_id, snapshot["goal_id"]
        if execution.never_begun:
            return Verdict(Status.CANCELED, 0, NEVER_BEGUN, Outcome.CANCELED)
        if execution.epoch < snapshot["epoch"] and not self._is_begun(execution):
            return Verdict(Status.ABORTED, INVALID_GOAL, outcome_sentence(why := _why_outdated(snapshot)), why)
        result = snapshot.find("results", "goal_id", goal_id)
        if result is not None:
            return judge(
                int(result["outcome"]),
                int(result["joint"]),
                float(result["value"]),
                float(result["limit"]),
                snapshot,
                execution.target_rad,
                execution.plan.joint_mask,
                self.names,
            )
        # A goal replaced before the loop saw its BEGIN gets no result of its own.
        if running > goal_id or (running != goal_id and _newest_decided(snapshot) > goal_id):
            return with_final_error(
                aborted(outcome_sentence(Outcome.REPLACED)),
                final_error(snapshot, execution.target_rad, execution.plan.joint_mask, self.joints),
            )
        if snapshot["mode"] != Mode.FAULT:
            execution.fault_since_ns = 0
            return None
        now_ns = snapshot["monotonic_ns"]
        execution.fault_since_ns = execution.fault_since_ns or now_ns
        if now_ns - execution.fault_since_ns < FAULT_PATIENCE_NS:
            return None
        return aborted(fault_of(snapshot, self.names))

    # --- from any other thread ---

    def present(self, *, for_own_move: bool = False) -> Present:
        """The arm's commanded state; raises NotServing with the reason when no goal can be taken now.

        Another server of the action is such a reason, since it gets every goal too. `for_own_move` ignores it, since no
        client has sent that move.
        """
        if self.other_server and not for_own_move:
            raise NotServing(self.other_server)
        with self._lock:
            snapshot, awaited = self._snapshot(), bool(self._undecided)
        age_ns = time.monotonic_ns() - snapshot["monotonic_ns"]
        if age_ns > STALLED_NS:
            raise NotServing(hung(self.arm.name, age_ns))
        mode = snapshot["mode"]
        if mode == Mode.FAULT:
            raise NotServing(fault_of(snapshot, self.names))
        if mode not in _TAKES_GOALS:
            raise NotServing(outcome_sentence(Outcome.REFUSED_MODE, value=float(mode)))
        if snapshot["held"]:
            raise NotServing(outcome_sentence(Outcome.REFUSED_HELD))
        rows = snapshot["joints"][: len(self.joints)]
        if lost := reasons_unreferenced(snapshot, self.joints):
            raise NotServing(unreferenced_sentences(lost)[0], joint=next(iter(lost)))
        words = ("commanded_position_rad", "commanded_velocity_rad_s", "commanded_acceleration_rad_s2")
        return Present(
            np.stack([rows[word] for word in words], axis=1),
            mode == Mode.HOLDING,
            snapshot["monotonic_ns"],
            snapshot["epoch_ns"],
            awaited,
        )

    def newest(self) -> Snapshot | None:
        """The newest snapshot; None when there is none to read, or this process is shutting down."""
        try:
            with self._lock:
                return self._snapshot()
        except NotServing:
            return None

    @property
    def absence(self) -> str:
        """A sentence that says why there is no control process; while there is one, the latest such sentence."""
        return self._absence

    def arrival(self) -> Arrival:
        """The arrival of what comes now. After a pause of this process, with the epoch before it: what comes may have
        arrived at any time in the pause."""
        epoch = self._epoch
        if time.monotonic_ns() - self._looked_ns < PAUSE_NS:
            with suppress(NotServing), self._lock:
                epoch = self._snapshot()["epoch"]
        return Arrival(next(self._turns), epoch)

    def refuse_outdated(self, arrival: Arrival) -> None:
        """Raise NotServing when what arrived then may not be begun any more."""
        with self._lock:
            _refuse_outdated(arrival.epoch, self._snapshot())

    def start(
        self,
        plan: GoalPlan,
        on_verdict: Callable[[Verdict], None],
        action_goal: bytes = b"",
        arrival: Arrival | None = None,
    ) -> Execution:
        """Hand a checked goal to the control process, where it replaces an older one.

        `action_goal` is its id as an action goal. `arrival` is when it arrived, None for now: checking takes time, and
        something that arrived later may have begun already (Overtaken). `on_verdict` is called once, later, from
        another thread. Raises NotServing, Overtaken.
        """
        with self._lock:
            snapshot = self._snapshot()
            turn, epoch = (next(self._turns), snapshot["epoch"]) if arrival is None else arrival
            _refuse_outdated(epoch, snapshot)
            if turn < self._newest_turn:
                raise Overtaken
            self._newest_turn = turn
            assert self._link is not None
            writer = self._link.writer
            known = max(snapshot["goal_id"], *snapshot.column("results", "goal_id"), self._newest_goal)
            announced = writer.announced_goal  # in memory that other processes may write to
            self._newest_goal = max(known, announced if announced <= known + GOALS_AHEAD else 0) + 1
            execution = Execution(self._newest_goal, plan, on_verdict, action_goal, epoch)
            self._undecided[execution.goal_id] = execution
            self._streams[execution.goal_id] = Streamer(execution.goal_id, plan, epoch, horizon_s(self.arm))
            writer.beat()
            self._pump(self._link, snapshot["goal_id"], snapshot["trajectory_clock_ns"])
            return execution

    def stream(self, trajectory: object, on_verdict: Callable[[Verdict], None]) -> GoalPlan:
        """Hand a message of `~/joint_trajectory` to the control process; it replaces what runs.

        Returns the plan that follows it. `on_verdict` is called once, later, from another thread. Raises
        GoalRefused.
        """
        arrival = self.arrival()
        with self._lock:
            newest = self._undecided[max(self._undecided)].plan if self._undecided else None
        earlier = newest if newest is not None and newest.stream else None
        plan = plan_stream(trajectory, self.arm, self.present(), self.settings, earlier)
        return self.start(plan, on_verdict, arrival=arrival).plan

    def request(
        self,
        kind: Request,
        on_reply: Callable[[bool, str], None],
        *,
        value: float = 0.0,
        effort: float = 0.0,
        until: Callable[[Snapshot], bool] | None = None,
        patience_s: float = 2.0,
    ) -> int:
        """Ask the control process for something; returns the request's number, 0 when it could not be written.

        `on_reply(done, sentence)` is called once: from another thread when the request is answered and
        `until(snapshot)` holds, or is refused, or takes longer than `patience_s`; at once when it could not be written.
        """
        with self._lock:
            link, absence = self._link, CLOSING if self._closing else self._absence
            if link is not None and not self._closing:
                taken = link.reader.requests_consumed()
                try:
                    epoch = self._snapshot()["epoch"]
                    sequence = link.writer.request(kind, consumed=taken, epoch=epoch, value=value, effort=effort)
                except (RingFull, NotServing) as problem:
                    absence = str(problem)
                else:
                    self._await(sequence, on_reply, until, patience_s)
                    return sequence
        on_reply(False, absence)
        return 0

    def command(
        self,
        store: Callable[[CommandWriter], None],
        on_reply: Callable[[bool, str], None] = lambda done, sentence: None,
        *,
        until: Callable[[Snapshot], bool] = lambda snapshot: True,
        patience_s: float = 2.0,
    ) -> None:
        """Stop, hold, resume or scale the arm by a store of the command writer; replies as `request` does."""
        with self._lock:
            link, absence = self._link, CLOSING if self._closing else self._absence
            if link is not None and not self._closing:
                store(link.writer)
                self._await(0, on_reply, until, patience_s)
                return
        on_reply(False, absence)

    def _await(
        self,
        sequence: int,
        on_reply: Callable[[bool, str], None],
        until: Callable[[Snapshot], bool] | None,
        patience_s: float,
    ) -> None:
        """Have `look` reply when a request is answered (a store is not) and `until` holds; call with the lock."""
        too_late_ns = time.monotonic_ns() + round(patience_s * NS)
        self._requests.append(_Request(sequence, on_reply, until, too_late_ns, patience_s, answered=sequence == 0))

    def gripper(self) -> np.ndarray | None:
        """The newest published state of the gripper on the arm's bus, None before the first; raises NotServing."""
        with self._lock:
            if self._link is None:
                raise NotServing(self._absence)
            return read_gripper(self._link.reader.memory)

    def sample(self, time_epoch_ns: int) -> Sample:
        """The running trajectory's setpoint at a ROS time (ns), at its present speed scale; raises NotServing."""
        with self._lock:
            snapshot = self._snapshot()
            execution = self._undecided.get(snapshot["goal_id"])
        if execution is None:
            raise NotServing("No trajectory is being executed: ask while one is.")
        plan = execution.plan
        ahead_ns = (time_epoch_ns - snapshot["epoch_ns"]) * snapshot["speed_scale"]
        clock_ns = round(snapshot["trajectory_clock_ns"] + ahead_ns)
        last_ns = int(plan.times_ns[-1])
        if not plan.entry_ns <= clock_ns < last_ns:
            raise NotServing(
                f"That is {clock_ns / NS:.3f} s after the start of the trajectory, which runs from "
                f"{plan.entry_ns / NS:.3f} to {last_ns / NS:.3f} s: ask for a time in between."
            )
        path = PlannedPath(plan)
        everything = plan.origin.copy()
        everything[:, 1:] = 0.0
        everything[path.mask] = np.stack(path.at(np.array([clock_ns])), axis=2)[0]
        return Sample(everything[:, 0], everything[:, 1], everything[:, 2])

    def cancel(self, execution: Execution) -> None:
        """Ask for a stop of a goal on its path; the verdict follows as for any other end."""
        with self._lock:
            if self._link is not None and execution.goal_id in self._undecided:
                if self._is_begun(execution):
                    self._link.writer.cancel(execution.goal_id)
                else:
                    execution.never_begun = True
                    self._streams.pop(execution.goal_id, None)

    def close(self) -> None:
        """Take no further goals and cancel the undecided ones."""
        with self._lock:
            self._closing = True
            executions = list(self._undecided.values())
        for execution in executions:
            self.cancel(execution)

    def _is_begun(self, execution: Execution) -> bool:
        """Whether anything of a goal was written for the control process."""
        stream = self._streams.get(execution.goal_id)
        return not execution.never_begun and (stream is None or stream.begun)

    def _snapshot(self) -> Snapshot:
        if self._closing:
            raise NotServing(CLOSING)
        if self._link is None:
            raise NotServing(self._absence)
        try:
            return self._link.reader.snapshot()
        except TornRead as problem:
            raise NotServing(str(problem)) from problem

    @property
    def idle(self) -> bool:
        """Whether no goal is undecided."""
        with self._lock:
            return not self._undecided


def _why_outdated(snapshot: Snapshot) -> Outcome:
    """Why a goal that arrived in an earlier epoch does not begin."""
    return Outcome.REFUSED_HELD if snapshot["held"] else Outcome.REFUSED_OUTDATED


def _refuse_outdated(epoch: int, snapshot: Snapshot) -> None:
    if epoch < snapshot["epoch"]:
        raise NotServing(outcome_sentence(_why_outdated(snapshot)))


def _newest_decided(snapshot: Snapshot) -> int:
    """The highest number of a goal with a result."""
    decided = zip(snapshot.column("results", "goal_id"), snapshot.column("results", "outcome"), strict=True)
    return max((goal_id for goal_id, outcome in decided if outcome != Outcome.NONE), default=0)


def starting(arm: str, pid: int) -> str:
    """The sentence about a control process that has run no cycle yet."""
    return (
        f"The control process of arm '{arm}' (pid {pid}) has not run its first cycle yet, which takes about a "
        "minute after a change, while it compiles: wait for it."
    )


def gone(arm: ArmConfig, pid: int) -> str:
    """The sentence about a control process that has ended."""
    return (
        f"The control process of arm '{arm.name}' (pid {pid}) has ended and the drives stop by themselves: "
        f"find out why, then start it again with {_start_command(arm)}."
    )


def _start_command(arm: ArmConfig) -> str:
    return start_command(arm.name, arm.file_argument, arm.has_options)


def hung(arm: str, age_ns: int) -> str:
    """The sentence about a control process that lives but runs no cycles."""
    return (
        f"The control process of arm '{arm}' has run no cycle for {age_ns / NS:.2f} s: look for what "
        "suspends or overloads it (`rtarm doctor`), or start it again."
    )
