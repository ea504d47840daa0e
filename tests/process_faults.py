"""Trials in which a process of an arm dies, freezes or runs out of something at a random moment of a running goal.

A trial ends with what was seen: reaction times, and sentences about everything that must never happen.
"""

from __future__ import annotations

import contextlib
import os
import re
import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from fault_rig import END_S, READY_S, WAYPOINTS, Hang, Rig, Sent, age_s, alive, full, processor_s, wait
from machine_witness import Stalls
from observer import (
    command_violations,
    frames_sent,
    motion_after,
    motion_violations,
    stands_since_ns,
    stopped_joints,
)

from rtarm.launch.launcher import STEADY_AFTER_S
from shm.files import DIRECTORY
from shm.words import Mode
from sim.truth import load_truth

NS = 10**9
MARGIN_S = 6.0
"""After the planned end of a goal, or of the fault: by then its result is there."""
LONGEST_STOP_S = 2.0
FRONT_TIMEOUT_S = 0.5
STANDS_WITHIN_S = LONGEST_STOP_S + FRONT_TIMEOUT_S + 0.5
POLL_S = 0.002
MANY_WAYPOINTS = 20_000
TARGETS = ("loop", "front", "launcher", "sim")


Fault = Callable[[Rig, int], contextlib.AbstractContextManager[str]]
"""Hurts a process for as long as it is entered; says what it did."""


def by_signal(number: int) -> Fault:
    @contextmanager
    def hurt(rig: Rig, pid: int) -> Iterator[str]:
        os.kill(pid, number)
        yield signal.Signals(number).name

    return hurt


def frozen(least_s: float, most_s: float) -> Fault:
    @contextmanager
    def hurt(rig: Rig, pid: int) -> Iterator[str]:
        seconds = least_s * (most_s / least_s) ** rig.random.uniform()
        os.kill(pid, signal.SIGSTOP)
        try:
            time.sleep(seconds)  # the fault itself
        finally:
            os.kill(pid, signal.SIGCONT)
        yield f"SIGSTOP for {seconds * 1e3:.0f} ms"

    return hurt


def limited(now: Callable[[int], dict[int, int]]) -> Fault:
    """Let a process have no more of something than it has now: soft limits by resource."""

    @contextmanager
    def hurt(rig: Rig, pid: int) -> Iterator[str]:
        limits = now(pid)
        before = {kind: resource.prlimit(pid, kind) for kind in limits}
        for kind, value in limits.items():
            resource.prlimit(pid, kind, (value, before[kind][1]))
        try:
            yield f"limited to {', '.join(map(str, limits.values()))}"
        finally:
            with contextlib.suppress(ProcessLookupError):
                for kind, limit in before.items():
                    resource.prlimit(pid, kind, limit)

    return hurt


def _memory(pid: int) -> dict[int, int]:
    """Neither new mappings nor more use of reserved ones, as malloc's arenas are."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    words = {name: value.split() for name, value in (line.split(":", 1) for line in lines)}
    return {resource.RLIMIT_AS: 1024 * int(words["VmSize"][0]), resource.RLIMIT_DATA: 1024 * int(words["VmData"][0])}


def _descriptors(pid: int) -> dict[int, int]:
    return {resource.RLIMIT_NOFILE: max(int(entry) for entry in os.listdir(f"/proc/{pid}/fd")) + 1}


def filled(folder: Callable[[Rig], Path]) -> Fault:
    @contextmanager
    def hurt(rig: Rig, pid: int) -> Iterator[str]:
        with full(folder(rig)):
            yield "filled to the last block"

    return hurt


FAULTS: dict[str, Fault] = {
    "kill -9": by_signal(signal.SIGKILL),
    "SIGTERM": by_signal(signal.SIGTERM),
    "SIGINT": by_signal(signal.SIGINT),
    "SIGSTOP 10–90 ms": frozen(0.010, 0.090),
    "SIGSTOP 0.1–1 s": frozen(0.100, 1.0),
    "SIGSTOP 1–10 s": frozen(1.0, 10.0),
    "no memory": limited(_memory),
    "no file grows": limited(lambda pid: {resource.RLIMIT_FSIZE: 0}),
    "no descriptors": limited(_descriptors),
}
SHARED: dict[str, Fault] = {
    "full disk": filled(lambda rig: Path(os.environ["HOME"])),
    "full /dev/shm": filled(lambda rig: DIRECTORY),
}
"""What every process of the arm meets at once; only where both file systems are the trials' own."""
ENDS = {"kill -9", "SIGTERM", "SIGINT"}
LASTS = {name for name in FAULTS if name.startswith("no ")} | set(SHARED)
"""A second goal is sent while these last."""


@dataclass
class Trial:
    """What is done to whom, and what was seen; times from the fault, or from the moment at which a stop was pressed."""

    fault: str
    target: str
    launched: bool
    number: int = 0
    what: str = ""
    outcome: str = ""
    stands_ms: float | None = None
    told_ms: float | None = None
    accepted_ms: float | None = None
    back_ms: float | None = None
    shortest_ms: float | None = None
    stalls: Stalls | None = None
    steps: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    server_died: bool = False
    act: Callable[[Rig, Trial], None] | None = None
    """What is done where it is no fault of this table."""

    @property
    def how(self) -> str:
        """Whether the launcher runs the arm's processes."""
        return "up" if self.launched else "bare"


def all_kinds(*, shared: bool) -> list[Trial]:
    """One trial of each kind."""
    kinds = [Trial(fault, target, True) for target in TARGETS for fault in FAULTS]
    kinds += [Trial(fault, target, False) for target in ("loop", "front") for fault in FAULTS]
    kinds += [Trial("kill -9, a client asks again", "front", True, act=_ask_again)]
    return kinds + [Trial(fault, "all", True) for fault in SHARED if shared]


def run(rig: Rig, trial: Trial) -> Trial:
    """Carry a trial out and leave the arm in service, if it can be brought there."""
    if rig.launched != trial.launched:
        trial.violations += rig.stop_control() if rig.pid("loop") else []
        rig.launched = trial.launched
        rig.note_dead_servers()
    try:
        rig.make_ready()
        (trial.act or _act)(rig, trial)
    except (Hang, AssertionError) as problem:
        words = str(problem)
        said = rig.launcher.said() if rig.launcher else "".join(p.said() for p in (rig.loop, rig.front))
        trial.violations.append(f"hang: {words if len(words) < 500 else words[:150] + ' … ' + words[-300:]}")
        trial.violations[-1] += f"\n{said[-2000:]}"
    return trial


def _act(rig: Rig, trial: Trial) -> None:
    sent, began_ns = rig.moving_goal(0.8, trial.notes, trial.steps)
    pids = {target: rig.pid(target) for target in TARGETS}
    if not pids["loop"] or not pids["front"]:
        trial.violations.append(f"not everything runs: {pids}")
    hurt_ns = time.monotonic_ns()
    fault = FAULTS.get(trial.fault) or SHARED[trial.fault]
    with fault(rig, pids.get(trial.target, 0)) as trial.what:
        over_ns = time.monotonic_ns()
        _await_end(rig, trial, sent, pids)
        if trial.fault in LASTS and all(alive(pid) for pid in pids.values() if pid):
            _second_goal(rig, trial)
    if trial.fault in LASTS:
        over_ns = time.monotonic_ns()
    _judge_motion(rig, trial, sent, began_ns, hurt_ns, over_ns)
    _judge_processes(rig, trial, pids)
    _way_back(rig, trial, over_ns)


def _ask_again(rig: Rig, trial: Trial) -> None:
    """The front is killed amid a goal, and a client sends the next one until it is accepted.

    The front has lived for so long that the launcher starts it again at once.
    """
    wait(lambda: age_s(rig.pid("front")) > STEADY_AFTER_S + 1.0, "a front that has lived for a while", READY_S)
    _, began_ns = rig.moving_goal(0.8, trial.notes, trial.steps)
    front = rig.pid("front")
    rig.note_dead_servers()
    hurt_ns = time.monotonic_ns()
    os.kill(front, signal.SIGKILL)
    wait(lambda: not alive(front), "the end of the front", END_S)
    sent = rig.accepted_again()
    trial.what, trial.accepted_ms = "SIGKILL", (time.monotonic_ns() - hurt_ns) / 1e6
    trial.notes.append(f"the new front had used {processor_s(rig.pid('front')):.2f} s of a processor by then")
    if not sent.ended.wait(sent.duration_s + MARGIN_S):
        raise Hang("the goal that was accepted after the kill has no result")
    trial.outcome = "succeeded" if sent.succeeded else kind_of(sent.words)
    truth = rig.standing(STANDS_WITHIN_S)
    now_ns = time.monotonic_ns()
    frames = frames_sent([piece for piece in rig.wire() if piece[0] >= began_ns])
    trial.violations += motion_violations(rig.arm, truth, began_ns, now_ns, thrown=stopped_joints(rig.arm, frames))
    trial.violations += command_violations(rig.arm, frames)
    _way_back(rig, trial, hurt_ns)


def _await_end(rig: Rig, trial: Trial, sent: Sent, pids: dict[str, int]) -> None:
    """Until the goal has a result, or the client's server has ended without giving one."""
    front = pids["front"]
    deadline_s = time.monotonic() + sent.duration_s + MARGIN_S
    while not sent.ended.wait(POLL_S):
        if not alive(front):
            sent.ended.wait(0.2)  # what it said last is still on its way
            break
        if time.monotonic() > deadline_s:
            raise Hang(f"the goal neither ended nor did its server, {trial.what}")
    if trial.fault in ENDS and trial.target == "front":
        wait(lambda: not alive(front), "the end of the front", END_S)
    if not alive(front):
        trial.server_died = True
        rig.note_dead_servers()
    if not sent.ended.is_set():
        trial.outcome = "server gone"
    elif sent.succeeded:
        trial.outcome = "succeeded"
    else:
        trial.outcome = kind_of(sent.words)
        if trial.fault not in ENDS:
            trial.notes.append(sent.words)


def kind_of(words: str) -> str:
    """A result's sentence without what differs from time to time."""
    without = re.sub(r" of arm '\w+'| \(pid \d+\)", "", words)
    return re.split(r"[:;,.|]", re.sub(r"joint\d", "a joint", re.sub(r"-?\d+(\.\d+)?", "…", without)))[0].strip()[:70]


def _second_goal(rig: Rig, trial: Trial) -> None:
    if rig.mode() != Mode.HOLDING:
        return
    front = rig.pid("front")
    waypoints = MANY_WAYPOINTS if "memory" in trial.fault else WAYPOINTS  # judging many takes memory
    sent = rig.user.send(rig.goal(shortest_s=0.8, longest_s=1.0, waypoints=waypoints))
    deadline_s = time.monotonic() + sent.duration_s + MARGIN_S + waypoints * 1e-3
    while not sent.ended.wait(POLL_S):
        if not alive(front):
            trial.server_died = True
            rig.note_dead_servers()
            trial.notes.append("the second goal ended the front")
            return
        if time.monotonic() > deadline_s:
            raise Hang(f"a second goal had no result while {trial.fault} lasted")
    trial.notes.append("second goal " + ("succeeded" if sent.succeeded else sent.words[:80]))


def _judge_motion(rig: Rig, trial: Trial, sent: Sent, began_ns: int, hurt_ns: int, over_ns: int) -> None:
    if trial.target == "sim" and trial.fault in ENDS:
        wait(lambda: rig.pid("sim") == 0, "the end of the simulated arm", END_S)
        if trial.fault == "kill -9":
            trial.notes.append("its true motion went with the simulated arm")
            return
        truth = load_truth(rig.truth_file)  # which it wrote at its end
        now_ns = min(int(joint.times_ns[-1]) for joint in truth.values())
    else:
        try:
            rig.standing(STANDS_WITHIN_S)
            time.sleep(0.3)  # in which nothing may begin to move
            truth = rig.truth()
        except AssertionError:
            if trial.target != "sim" or rig.pid("sim") != 0:
                raise
            trial.notes.append("its true motion went with the simulated arm")  # which had no memory to write it down
            return
        now_ns = time.monotonic_ns()
    stood_ns = stands_since_ns(truth, now_ns)
    frames = frames_sent([piece for piece in rig.wire() if piece[0] >= began_ns])
    thrown = stopped_joints(rig.arm, frames)
    if thrown:
        trial.notes.append(f"stop commands to {len(thrown)} drives")
    trial.violations += motion_violations(rig.arm, truth, began_ns, now_ns, thrown=thrown)
    trial.violations += command_violations(rig.arm, frames)
    if trial.outcome == "succeeded" or trial.target == "sim":
        due_ns = max(sent.ended_ns, over_ns)
    else:
        trial.stands_ms = max(0, stood_ns - hurt_ns) / 1e6
        due_ns = max(hurt_ns, over_ns if trial.target == "front" else hurt_ns)
        if sent.ended.is_set():
            trial.told_ms = (sent.ended_ns - hurt_ns) / 1e6
    trial.violations += motion_after(truth, due_ns + round(STANDS_WITHIN_S * NS), now_ns)


def _judge_processes(rig: Rig, trial: Trial, pids: dict[str, int]) -> None:
    """Nothing outlives what it belongs to; what was not hurt to death still lives."""
    ended = trial.fault in ENDS and trial.target in ("launcher", "loop")
    if ended:
        wait(lambda: not alive(pids[trial.target]), f"the end of the {trial.target}", END_S)
    gone = {target for target, pid in pids.items() if pid and not alive(pid)}
    if trial.launched and (ended or {"launcher", "loop"} & gone):
        for target in ("launcher", "loop", "front"):
            wait(lambda p=pids[target]: not alive(p), f"the end of the {target} after the {trial.target}'s", END_S)
        rig.note_dead_servers()
        killed = trial.fault == "kill -9" and trial.target == "loop"
        _judge_files(rig, trial, {"state", "state.prev", "command"} if killed else {"state.prev"})
        _judge_code(rig, trial)
    elif trial.fault not in ENDS and trial.target != "launcher" and gone - {trial.target, "front"}:
        trial.violations.append(f"{', '.join(gone)} ended")
    trial.notes += [f"{target} ended" for target in sorted(gone - {trial.target})]


def _judge_files(rig: Rig, trial: Trial, allowed: set[str]) -> None:
    left = {path.name.removeprefix(f"rtarm.{rig.name}.") for path in DIRECTORY.glob(f"rtarm.{rig.name}.*")}
    if left - allowed:
        trial.violations.append(f"memory files left: {', '.join(sorted(left - allowed))}")


def _judge_code(rig: Rig, trial: Trial) -> None:
    if rig.launcher is None:
        return
    code = rig.launcher.code()
    text = rig.launcher.text
    if trial.target == "launcher":
        expected = {"kill -9": -signal.SIGKILL, "SIGTERM": 0, "SIGINT": 0}.get(trial.fault)
    else:
        expected = 3
    if expected is not None and code != expected:
        trial.violations.append(f"rtarm up ended with {code}, not {expected}: {text[-300:]}")
    if "Traceback" in text:
        trial.violations.append(f"a traceback: {text[text.index('Traceback') :][:1500]}")


def _way_back(rig: Rig, trial: Trial, over_ns: int) -> None:
    """Back into service, and a goal succeeds."""
    trial.steps += rig.make_ready()
    trial.back_ms = (time.monotonic_ns() - over_ns) / 1e6
    trial.violations += rig.goal_succeeds(trial.notes, trial.steps)
