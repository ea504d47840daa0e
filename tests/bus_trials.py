"""Trials of bus faults in virtual time: a fault at a random moment of a random goal, judged by true motion.

`make bus-trials` runs many of each, on every processor, and prints the table of docs/safety.md;
`tests/rtloop/test_bus_fault_trials.py` runs a sample. A trial is a function of its fault and its seed.
"""

import argparse
import math
import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from observer import (
    command_violations,
    frames_sent,
    motion_after,
    motion_frames,
    motion_violations,
    stands_since_ns,
    truth_of,
)
from virtual import VirtualArm, recorded_goal

from config.joint import JointConfig
from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.wire import received
from shm.sentences import fault_sentence, outcome_sentence, unreferenced_sentence
from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced
from sim import faults as wrong
from sim.babble import Babbler
from sim.drives.zdt import ZdtDrive
from sim.pty import PACKET_NS

GOALS = ("large", "scale_1_0", "scale_0_5", "cartesian", "single_joint", "sweep", "sweep", "sweep")
"""Recorded goals of up to four seconds, and one in which every joint moves near its limits at once."""
SWEEP_S = 1.5
TTY_BYTES = 4096
"""What the kernel keeps for a serial port that takes nothing."""
STANDING_S = 0.5
PATIENCE_S = 12.0
GOES_ON = Fault.NONE

Inject = Callable[[np.random.Generator, str], Sequence[wrong.Fault]]
Mend = Callable[["TrialArm", int], None]


class TrialArm(VirtualArm):
    """An arm behind a USB adapter, whose serial port can stop taking characters, or be pulled out."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._waiting = b""
        self._unplugged = False
        super().__init__(*arguments, **options)

    def cycle(self, periods: int = 1) -> None:
        assert self.sim is not None
        if self._waiting and self.sim.adapter.takes_characters and not self._unplugged:
            self.sim.feed(self.sim.now_ns, self._waiting)
            self._waiting = b""
        super().cycle(periods)

    def listen(self, until_ns: int) -> None:
        assert self.sim is not None
        while self.sim.now_ns < until_ns:
            at_ns = min(self.sim.now_ns + PACKET_NS, until_ns)
            data = self.sim.collect(at_ns)
            if data and not self._unplugged:
                received.push(self.loop[0], at_ns, np.frombuffer(data, np.uint8), len(data))

    def write(self, data: bytes) -> None:
        assert self.sim is not None
        if self._unplugged:
            self.taken(0)
        elif self.sim.adapter.takes_characters:
            super().write(data)
        else:
            taken = data[: TTY_BYTES - len(self._waiting)]
            self._waiting += taken
            self.sent.append((self.now_ns, taken))
            self.taken(len(taken))

    def unplug(self) -> None:
        """Pull the adapter out: the reader notices, and nothing reaches the drives any more."""
        self._unplugged = True
        received.close(self.loop[0], 5)


@dataclass(frozen=True)
class BusFault:
    """One row: what goes wrong, and what may come of it.

    Attributes:
        inject: the faults of the simulated arm, times counted from the trial's moment; by random numbers and a joint.
        latched: what may be latched; GOES_ON among them if the goal may end by itself.
        mend: takes the cause away; None where it goes away by itself.
        unplugs: the adapter is pulled out, and stays out.
        throws: the joint's own drive fails, so that its acceleration is not ours.
        drifts: the joint's own drive no longer does what the bus says, so none of its motion is judged.
        loses: the joint must not be referenced afterwards, whatever was latched.
        blind_rad: nothing is expected of a joint that stands nearer than this to where its drive counts from.
        options, overrides: of the simulated arm, and of the arm's file.
        backlog: what was on its way when the way was blocked still arrives when it is free.
    """

    name: str
    inject: Inject
    latched: frozenset[Fault]
    mend: Mend | None = None
    unplugs: bool = False
    throws: bool = False
    drifts: bool = False
    loses: bool = False
    backlog: bool = False
    blind_rad: float = 0.0
    options: dict[str, Any] = field(default_factory=dict)
    overrides: dict[str, dict[str, object]] = field(default_factory=dict)


@dataclass
class Found:
    """What a trial showed; times from the physical fault."""

    fault: str
    seed: int
    moved: bool = False
    latched: str = ""
    outcome: str = ""
    reaction_ms: float = math.nan
    latched_ms: float = math.nan
    stands_ms: float = math.nan
    sentences: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)


def run_trial(fault: BusFault, seed: int) -> Found:
    """One fault at a random moment of a random goal, its judgement, and the way back."""
    random = np.random.default_rng([seed, sum(fault.name.encode())])
    name = GOALS[random.integers(len(GOALS))]
    config = load_arm("episode1", overrides=fault.overrides)
    times_ns, joints = sweep(config, random) if name == "sweep" else recorded_goal(name).values()
    arm = TrialArm(config, start_rad=joints[0, :, 0], seed=seed, **fault.options)
    found = Found(fault.name, seed)
    try:
        assert arm.bring_up().failure is None
        _Trial(fault, arm, found, random).run(times_ns, joints)
    finally:
        arm.close()
    return found


def sweep(arm: ArmConfig, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """times_ns (2,), joints (2, n, 3): every joint as far as its limits let it come in SWEEP_S, in either direction."""
    ends = np.zeros((2, len(arm.joints), 3))
    for index, joint in enumerate(arm.joints):
        # a quintic from rest to rest peaks at 1.875 d / T and 5.77 d / T²
        way_rad = 0.97 * min(
            joint.upper_rad - joint.lower_rad,
            joint.max_velocity_rad_s * SWEEP_S / 1.875,
            joint.max_acceleration_rad_s2 * SWEEP_S * SWEEP_S / 5.774,
        )
        low_rad = random.uniform(joint.lower_rad, joint.upper_rad - way_rad)
        ends[:, index, 0] = low_rad, low_rad + way_rad
        if random.random() < 0.5:
            ends[:, index, 0] = ends[::-1, index, 0]
    return np.array([0, round(SWEEP_S * 1e9)]), ends


class _Trial:
    def __init__(self, fault: BusFault, arm: TrialArm, found: Found, random: np.random.Generator) -> None:
        assert arm.sim is not None
        self.fault, self.arm, self.sim, self.found, self.random = fault, arm, arm.sim, found, random
        self.joint = int(random.integers(len(arm.arm.joints)))
        self.began_ns = self.fault_ns = 0
        self.blind = False
        self.periods = range(0)

    @property
    def config(self) -> JointConfig:
        return self.arm.arm.joints[self.joint]

    def wrong(self, sentence: str) -> None:
        self.found.violations.append(sentence)

    def run(self, times_ns: np.ndarray, joints: np.ndarray) -> None:
        arm, found = self.arm, self.found
        self.began_ns = arm.now_ns
        goal = arm.send_goal(times_ns, joints)
        arm.cycles(int(self.random.integers(2, times_ns[-1] // arm.period_ns)))
        self.break_it()
        self.let_it_end(goal)
        arm.cycles(round(STANDING_S * 1e9 / arm.period_ns))
        self.judge(goal)
        if arm.core["mode"] == Mode.FAULT and not self.fault.unplugs:
            self.come_back()
        elif found.outcome == Outcome.SUCCEEDED.name and not self.fault.unplugs:
            if self.fault.mend is not None:
                self.fault.mend(arm, self.joint)
            self.move_again(Outcome.SUCCEEDED)

    def break_it(self) -> None:
        arm = self.arm
        within_ns = int(self.random.integers(0, arm.period_ns))
        self.fault_ns = arm.now_ns + within_ns
        away_rad = abs(float(arm.loop[0]["axes"][self.joint]["measured_rad"]) + self.config.zero_rad)
        self.blind = away_rad < self.fault.blind_rad
        for fault in self.fault.inject(self.random, self.config.name):
            self.sim.inject(fault, self.fault_ns)
        if self.fault.unplugs:
            arm.unplug()
            self.fault_ns = arm.now_ns

    def let_it_end(self, goal: int) -> None:
        """Cycle until goal and motion are over, and note when the loop reacts."""
        arm, found, core = self.arm, self.found, self.arm.core
        until_ns = arm.now_ns + round(PATIENCE_S * 1e9)
        axes = arm.loop[0]["axes"]
        while arm.now_ns < until_ns:
            arm.cycle()
            since_ms = (arm.now_ns - self.fault_ns) * 1e-6
            if math.isnan(found.reaction_ms) and (core["stale"] or core["fault"]) and since_ms >= 0.0:
                found.reaction_ms = since_ms
            if core["fault"] and not found.latched:
                found.latched, found.latched_ms = Fault(int(core["fault"])).name, since_ms
            if arm.outcome(goal) != Outcome.NONE and core["goal_id"] == 0 and not np.any(axes["velocity_rad_s"]):
                break
        else:
            self.wrong(f"the goal has no end after {PATIENCE_S:g} s")

    def judge(self, goal: int) -> None:
        arm, found, fault = self.arm, self.found, self.fault
        truth = truth_of(self.sim)
        name = self.config.name
        outcome = Outcome(arm.outcome(goal))
        found.outcome = outcome.name
        latched = Fault(int(arm.core["fault"]))
        if latched not in fault.latched and not self.blind:
            self.wrong(f"latched {latched.name}, which this fault does not explain")
        if latched == Fault.NONE and outcome == Outcome.FAULT:
            self.wrong(f"the goal ended as {outcome.name} while {latched.name} was latched")
        judged = {key: value for key, value in truth.items() if not (fault.drifts and key == name)}
        config = arm.arm.model_copy(update={"joints": [j for j in arm.arm.joints if j.name in judged]})
        thrown = {name} if fault.throws else set()
        thrown |= {arm.arm.joints[j].name for j in range(6) if arm.loop[0]["axes"][j]["stop_frames_due"] > 0}
        thrown |= self.stopped()
        found.violations += motion_violations(config, judged, self.began_ns, arm.now_ns, thrown=thrown)
        frames = frames_sent(arm.sent)
        found.violations += command_violations(arm.arm, frames)
        found.violations += self.led_after_its_stop(frames)
        if latched != Fault.NONE:
            self.judge_standstill(truth, judged)
            self.judge_sentence(latched)
        if fault.loses and not self.blind and arm.loop[0]["axes"][self.joint]["referenced"]:
            self.wrong(f"{name} is still referenced")

    def stopped(self) -> set[str]:
        """Joints whose drives got a stop command: it stops them at once."""
        stops = {frame.drive for frame in frames_sent(self.arm.sent) if frame.data[:2] == b"\xfe\x98"}
        return {joint.name for joint in self.arm.arm.joints if joint.drive.address in stops}  # type: ignore[union-attr]

    def judge_standstill(self, truth: Any, judged: Any) -> None:
        arm, found = self.arm, self.found
        end_ns = arm.now_ns
        stood_ns = stands_since_ns(judged, end_ns)
        moving = any(abs(float(motion.velocity_at(np.array([self.fault_ns]))[0])) > 0.0 for motion in judged.values())
        found.moved = moving
        if moving and not self.fault.backlog:
            found.stands_ms = max(stood_ns - self.fault_ns, 0) * 1e-6
        found.violations += motion_after(judged, end_ns - 100_000_000, end_ns)

    def judge_sentence(self, latched: Fault) -> None:
        core = self.arm.core
        joint = int(core["fault_joint"])
        named = self.arm.arm.joints[joint].name if joint >= 0 else ""
        sentence = fault_sentence(latched, named, float(core["fault_value"]), float(core["fault_limit"]))
        self.found.sentences.append(sentence)
        if named not in sentence or "{" in sentence or "nan" in sentence:
            self.wrong(f"the sentence is {sentence!r}")

    def led_after_its_stop(self, frames: Any) -> list[str]:
        """Motion frames to a drive after its stop command: there must be none before it is referenced again."""
        found = []
        for joint in self.arm.arm.joints:
            address = joint.drive.address  # type: ignore[union-attr]
            stops = [f.time_ns for f in frames if f.drive == address and f.data[:2] == b"\xfe\x98"]
            if stops and motion_frames(frames, address, stops[0] - 1):
                found.append(f"{joint.name} was led after its stop command")
        return found

    # --- the way back

    def come_back(self) -> None:
        arm, fault = self.arm, self.fault
        before = arm.loop[0]["axes"]["unreferenced_reason"][:6].copy()
        since = len(arm.sent)
        if fault.mend is not None:
            told = self.clear()  # the cause is still there
            if told:
                self.found.sentences.append(told)
            arm.cycles(round(0.5e9 / arm.period_ns))
            fault.mend(arm, self.joint)
            arm.cycles(30)
        for _ in range(3):
            if arm.core["mode"] == Mode.FAULT:
                self.clear()
        if arm.core["mode"] != Mode.HOLDING:
            self.wrong(
                f"after the clear the arm is {Mode(int(arm.core['mode'])).name}, {Fault(int(arm.core['fault'])).name}"
            )
            return
        for joint in range(6):
            lasting = before[joint] in (Unreferenced.POWER_LOST, Unreferenced.POSITION_JUMP, Unreferenced.SILENT)
            if lasting and arm.loop[0]["axes"][joint]["referenced"]:
                self.wrong(f"the clear referenced {arm.arm.joints[joint].name}")
        if motion_frames(frames_sent(arm.sent[since:]), self.config.drive.address, 0):  # type: ignore[union-attr]
            self.wrong("the clear moved the arm")
        sound = bool(np.all(arm.loop[0]["axes"]["referenced"][:6]))
        self.move_again(Outcome.SUCCEEDED if sound else Outcome.REFUSED_UNREFERENCED)

    def clear(self) -> str:
        """Ask for a clear; the sentence with which it failed, if it did."""
        arm = self.arm
        sequence = arm.writer.request(Request.CLEAR_FAULT)
        arm.cycle()
        answer = arm.reader.snapshot()["answers"][sequence % 16]["answer"]
        if answer != Answer.DONE:
            self.wrong(f"the clear was answered {Answer(int(answer)).name}")
            return ""
        arm.core["bring_up_asked"] = 0
        failure = arm.bring_up(clears_protection=True).failure
        return "" if failure is None else str(failure)

    def move_again(self, wanted: Outcome) -> None:
        """A small goal from where the arm stands, towards the middle of every joint."""
        arm = self.arm
        here = arm.loop[0]["axes"]["position_rad"][:6].copy()
        there = np.array(
            [
                p + math.copysign(0.01, (j.lower_rad + j.upper_rad) / 2 - p)
                for p, j in zip(here, arm.arm.joints, strict=True)
            ]
        )
        joints = np.zeros((2, 6, 3))
        joints[0, :, 0], joints[1, :, 0] = here, there
        goal = arm.send_goal(np.array([0, 500_000_000]), joints)
        try:
            arm.until(lambda: arm.outcome(goal) != Outcome.NONE, at_most_s=5.0)
        except AssertionError:
            self.wrong("the goal afterwards never ends")
            return
        outcome = Outcome(arm.outcome(goal))
        if outcome != wanted:
            result = arm.result(goal)
            sentence = outcome_sentence(
                outcome, str(int(result["joint"])), float(result["value"]), float(result["limit"])
            )
            latched = Fault(int(arm.core["fault"])).name
            self.wrong(f"the goal afterwards ended as {outcome.name} ({sentence} {latched}), not {wanted.name}")
        elif wanted == Outcome.REFUSED_UNREFERENCED:
            joint = int(arm.result(goal)["joint"])
            reason = int(arm.loop[0]["axes"][joint]["unreferenced_reason"])
            self.found.sentences.append(unreferenced_sentence(reason, arm.arm.joints[joint].name))


# --- the faults


def _now(kind: Callable[..., wrong.Fault], **fixed: Any) -> Inject:
    """A fault of the chosen joint, from the trial's moment on."""
    return lambda _, joint: [kind(joint=joint, at_s=0.0, **fixed)]


def _all(kind: Callable[..., wrong.Fault], **fixed: Any) -> Inject:
    """A fault of no drive, or of all, from the trial's moment on."""
    return lambda _, __: [kind(at_s=0.0, **fixed)]


def _plug_in(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    arm.sim.drives[joint].plug_in(arm.sim.now_ns)


def _inject(*faults: wrong.Fault) -> Mend:
    """Take a cause away by a fault that is none."""

    def mend(arm: TrialArm, _: int) -> None:
        assert arm.sim is not None
        for fault in faults:
            arm.sim.inject(fault, arm.sim.now_ns)

    return mend


def _be_quiet(arm: TrialArm, _: int) -> None:
    assert arm.sim is not None
    for node in arm.sim.bus.nodes:
        if isinstance(node, Babbler):
            node.end(arm.sim.now_ns)


def _unblock(arm: TrialArm, _: int) -> None:
    assert arm.sim is not None
    arm.sim.adapter.takes_characters = True


def _let_refuse_no_more(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    arm.sim.drives[joint].refuses = False


def _let_go_of_shaft(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    shaft = arm.sim.drives[joint].shaft
    shaft.low = shaft.high = None


def _cool(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    arm.sim.drives[joint].cause_lasts = False


def _wait_for_power(arm: TrialArm, _: int) -> None:
    """The cut lasts a second, and drives need a moment to boot."""
    arm.cycles(round(1.5e9 / arm.period_ns))


def _remove_the_other(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    address = arm.sim.drives[joint].settings.address
    for node in arm.sim.bus.nodes:
        if isinstance(node, ZdtDrive) and node.settings.address == address and node is not arm.sim.drives[joint]:
            node.unplug(arm.sim.now_ns)


def _between(random: np.random.Generator, low: float, high: float) -> float:
    return float(random.uniform(low, high))


STALE = frozenset({Fault.STALE_READING})
STALE_OR_NOT = frozenset({Fault.STALE_READING, GOES_ON})
NEVER = frozenset({GOES_ON})
REFERENCE = frozenset({Fault.REFERENCE_LOST})
FOLLOWING = Fault.FOLLOWING_ERROR

FAULTS = (
    BusFault("a drive falls silent", _now(wrong.Silent), STALE, _plug_in, loses=True),
    BusFault(
        "a drive is silent for 30 to 80 ms",
        lambda r, j: [wrong.Silent(j, 0.0, _between(r, 0.03, 0.08))],
        frozenset({GOES_ON, FOLLOWING}),
    ),
    BusFault(
        "10 % of the answers are lost", _all(wrong.LostReplies, share=0.1), NEVER, _inject(wrong.LostReplies(0.0))
    ),
    BusFault(
        "answers up to 5 ms late",
        _all(wrong.SlowReplies, extra_s=0.0, jitter_s=0.005),
        NEVER,
    ),
    BusFault(
        "5 % of the answers 12 ms late, overtaken by others", _all(wrong.LateReplies, share=0.05, late_s=0.012), NEVER
    ),
    BusFault(
        "20 % of the answers twice, up to 9 ms apart",
        lambda r, _: [wrong.DuplicateReplies(0.2, gap_s=_between(r, 0.0, 0.009))],
        NEVER,
    ),
    BusFault(
        "0.1 % of the characters garbled",
        _all(wrong.CorruptBytes, share=0.001),
        NEVER,
        _inject(wrong.CorruptBytes(0.0)),
    ),
    BusFault("2 % of the lines break off, the rest is missing", _all(wrong.CutLines, share=0.02), NEVER),
    BusFault(
        "2 % of the lines break off, the rest comes 2 ms later", _all(wrong.CutLines, share=0.02, rest_s=0.002), NEVER
    ),
    BusFault(
        "10 % of the answers with a wrong checksum",
        _all(wrong.WrongChecksums, share=0.1),
        NEVER,
        _inject(wrong.WrongChecksums(0.0)),
    ),
    BusFault(
        "every answer of a drive with a wrong checksum",
        _now(wrong.WrongChecksums, share=1.0),
        STALE,
        _inject(wrong.WrongChecksums(0.0)),
        loses=True,
    ),
    BusFault(
        "0.1 % of the positions wrong by up to 15°",
        _all(wrong.WrongValues, share=0.001, most_deg=15.0),
        NEVER,
        _inject(wrong.WrongValues(0.0, 0.0)),
    ),
    BusFault("a node babbles with the highest priority", _all(wrong.Babble), STALE, _be_quiet, backlog=True),
    BusFault(
        "a node babbles for 10 to 80 ms",
        lambda r, _: [wrong.Babble(0.0, _between(r, 0.01, 0.08))],
        frozenset({GOES_ON, FOLLOWING}),
        backlog=True,
    ),
    BusFault(
        "a drive babbles its position",
        _now(wrong.Babble),
        frozenset({Fault.STALE_READING, FOLLOWING, GOES_ON}),
        _be_quiet,
    ),
    BusFault(
        "the adapter says nothing for 30 to 90 ms, then all at once",
        lambda r, _: [wrong.ReceiveStall(0.0, _between(r, 0.03, 0.09))],
        frozenset({GOES_ON, FOLLOWING}),
    ),
    BusFault(
        "the adapter says nothing for 0.3 s, then what fits its buffer",
        _all(wrong.ReceiveStall, stall_s=0.3),
        STALE,
        throws=False,
    ),
    BusFault(
        "the adapter's transmit buffer holds 6 frames",
        _all(wrong.TransmitOverflow, depth=6),
        frozenset({Fault.STALE_READING, FOLLOWING, GOES_ON}),
        _inject(wrong.TransmitOverflow(64, 0.0)),
    ),
    BusFault(
        "2 % of the frames refused by the adapter (BEL)", _all(wrong.Bels, share=0.02), NEVER, _inject(wrong.Bels(0.0))
    ),
    BusFault("the serial port takes nothing more", _all(wrong.SerialBlocked), STALE, _unblock, backlog=True),
    BusFault(
        "the serial port takes nothing for 30 to 80 ms",
        lambda r, _: [wrong.SerialBlocked(0.0, _between(r, 0.03, 0.08))],
        frozenset({GOES_ON, FOLLOWING}),
        backlog=True,
    ),
    BusFault("the adapter is pulled out", lambda _, __: [], frozenset({Fault.WIRE}), unplugs=True),
    BusFault("a shaft is held", _now(wrong.Stall), frozenset({FOLLOWING, GOES_ON}), _let_go_of_shaft, throws=True),
    BusFault(
        "a drive trips its stall protection",
        _now(wrong.Protection),
        frozenset({Fault.DRIVE_FAULT, FOLLOWING}),
        throws=True,
    ),
    BusFault(
        "a drive is too hot and trips",
        _now(wrong.Protection, until_s=1e6, cause="temperature"),
        frozenset({Fault.DRIVE_FAULT, FOLLOWING}),
        _cool,
        throws=True,
    ),
    BusFault(
        "a drive draws too much current and trips",
        _now(wrong.Protection, until_s=1e6, cause="current"),
        frozenset({Fault.DRIVE_FAULT, FOLLOWING}),
        _cool,
        throws=True,
    ),
    BusFault("somebody lets a drive go", _now(wrong.Disabled), frozenset({Fault.DRIVE_FAULT, FOLLOWING}), throws=True),
    BusFault(
        "a drive refuses motion (E2), without acknowledgements",
        _now(wrong.Refusing),
        frozenset({FOLLOWING, GOES_ON}),
        _let_refuse_no_more,
    ),
    BusFault(
        "a drive refuses motion (E2), with acknowledgements and 100 Hz",
        _now(wrong.Refusing),
        frozenset({Fault.DRIVE_FAULT, GOES_ON}),
        _let_refuse_no_more,
        overrides={"bus": {"acknowledge": True}, "control": {"rate_hz": 100.0}},
    ),
    BusFault(
        "every position of a drive is nonsense",
        _now(wrong.WrongValues, share=1.0, most_deg=200.0),
        frozenset({Fault.STALE_READING, Fault.REFERENCE_LOST, FOLLOWING}),
        _inject(wrong.WrongValues(0.0, 0.0)),
        loses=True,
    ),
    BusFault(
        "a drive loses power for 10 to 80 ms",
        lambda r, j: [wrong.PowerLoss(j, 0.0, _between(r, 0.01, 0.08))],
        frozenset({Fault.REFERENCE_LOST, Fault.STALE_READING, FOLLOWING}),  # and the flag, a moment later
        throws=True,
        loses=True,
    ),
    BusFault("a drive loses power for 0.5 s", _now(wrong.PowerLoss, off_s=0.5), STALE, throws=True, loses=True),
    BusFault(
        "all drives lose power for 1 s",
        lambda _, __: [wrong.PowerLoss(f"joint{number}", 0.0, 1.0) for number in range(1, 7)],
        STALE,
        _wait_for_power,
        throws=True,
        loses=True,
    ),
    BusFault(
        "old firmware, which has no flag for it, loses power for 10 to 80 ms",
        lambda r, j: [wrong.PowerLoss(j, 0.0, _between(r, 0.01, 0.08))],
        frozenset({Fault.REFERENCE_LOST, Fault.STALE_READING}),
        throws=True,
        loses=True,
        blind_rad=1.0,
        options={"firmware": "old"},
    ),
    BusFault(
        "a count jumps by 20° to 90°",
        lambda r, j: [wrong.CountSlip(j, 0.0, _between(r, 20.0, 90.0) * (1 if r.random() < 0.5 else -1))],
        REFERENCE,
        throws=True,
        loses=True,
    ),
    BusFault("a count passes the end of its 32 bits", _now(wrong.CountWrap), REFERENCE, throws=True, loses=True),
    BusFault(
        "a second drive with the same address",
        _now(wrong.SameAddress),
        frozenset({Fault.STALE_READING, Fault.REFERENCE_LOST, FOLLOWING, GOES_ON}),
        _remove_the_other,
        throws=True,
    ),
)


# --- many of them


def _run(task: tuple[int, int]) -> Found:
    index, seed = task
    try:
        return run_trial(FAULTS[index], seed)
    except Exception as problem:  # a trial that breaks down is a finding too
        return Found(FAULTS[index].name, seed, violations=[f"{type(problem).__name__}: {problem}"])


def _figures(values: Sequence[float]) -> str:
    known = np.array([value for value in values if not math.isnan(value)])
    if not len(known):
        return "–"
    return " / ".join(f"{value:.0f}" for value in (*np.percentile(known, (50, 99)), known.max()))


def _row(name: str, trials: Sequence[Found]) -> str:
    latched = Counter(trial.latched or "–" for trial in trials)
    outcomes = Counter(trial.outcome for trial in trials)
    return " | ".join(
        (
            f"| {name}",
            _figures([trial.reaction_ms for trial in trials]),
            _figures([trial.latched_ms for trial in trials]),
            _figures([trial.stands_ms for trial in trials]),
            ", ".join(f"{key} {count}" for key, count in latched.most_common()),
            ", ".join(f"{key} {count}" for key, count in outcomes.most_common()),
            str(sum(bool(trial.violations) for trial in trials)),
            f"{len(trials)} |",
        )
    )


def main() -> int:
    """Run the trials and print the table; the exit code says whether any was violated."""
    parser = argparse.ArgumentParser(prog="bus_trials", description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=100, help="of each fault")
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--seed", type=int, default=0, help="of the first trial of each fault")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args()
    chosen = [index for index, fault in enumerate(FAULTS) if options.only in fault.name]
    if not chosen:
        print(f"No fault's name contains {options.only!r}: see FAULTS in tests/bus_trials.py.", file=sys.stderr)
        return 2
    tasks = [(index, options.seed + number) for index in chosen for number in range(options.trials)]
    began = time.monotonic()
    found: dict[str, list[Found]] = {f"{index}": [] for index in chosen}
    broken = 0
    print(
        "| fault | reacts (p50 / p99 / max), ms | latched, ms | stands, ms | latched | goal ended as | bad | trials |"
    )
    print("|---|---|---|---|---|---|---|---|", flush=True)
    with multiprocessing.get_context("spawn").Pool(options.workers) as pool:
        for (index, _), trial in zip(tasks, pool.imap(_run, tasks, chunksize=4), strict=True):
            found[str(index)].append(trial)
            for sentence in trial.violations:
                broken += 1
                print(f"{trial.fault}, seed {trial.seed}: {sentence}", file=sys.stderr, flush=True)
            if len(found[str(index)]) == options.trials:
                print(_row(FAULTS[index].name, found[str(index)]), flush=True)
    print(f"{len(tasks)} trials in {time.monotonic() - began:.0f} s, {broken} violations", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
