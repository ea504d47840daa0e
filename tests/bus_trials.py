"""Trials of bus faults in virtual time: a fault at a random moment of a random goal, judged by true motion.

`make bus-trials` runs many of each, on every processor, and prints the table of docs/explanation/safety.md;
`tests/rtloop/safety/test_bus_fault_trials.py` runs a sample. A trial is a function of its fault and its seed.
"""

import argparse
import math
import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from bus_faults import FAULTS, BusFault
from observer import (
    command_violations,
    frames_sent,
    led_after_its_stop,
    motion_after,
    motion_frames,
    motion_violations,
    stands_since_ns,
    stopped_joints,
    truth_of,
)
from virtual import VirtualArm, recorded_goal

from config.joint import JointConfig
from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.wire import received
from sentences.told import latched_sentence, outcome_sentence, unreferenced_sentence
from shm.words import Answer, Fault, Mode, Outcome, Request, Slowed, Unreferenced
from sim.drives.zdt import ZdtDrive
from sim.pty import PACKET_NS

GOALS = ("large", "scale_1_0", "scale_0_5", "cartesian", "single_joint", "sweep", "sweep", "sweep")
"""Recorded goals of up to four seconds, and one in which every joint moves near its limits at once."""
SWEEP_S = 1.5
TTY_BYTES = 4096
"""What the kernel keeps for a serial port that takes nothing."""
STANDING_S = 0.5
PATIENCE_S = 12.0
HEALING_S = 3.0
"""A stall's end, as long again until no answer can be an old one, and a bring-up."""
KNOWN_WITHIN_RAD = 0.01


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
                self.receive(at_ns, data)

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

    def reference_all(self) -> None:
        """A person says where the joints stand whose drives' flags for lost power are stuck."""
        assert self.sim is not None
        for joint in range(len(self.arm.joints)):
            if not self.loop[0]["axes"][joint]["reference"]["referenced"]:
                angle_rad = self.sim.true_position_rad(joint, self.sim.now_ns)
                assert self.ask(Request.REFERENCE, joint_mask=1 << joint, value=angle_rad) == Answer.DONE
                assert self.reference().failure is None
                self.sent.clear()  # no motion was led before, so the stop commands of that end none

    def unplug(self) -> None:
        """Pull the adapter out: the reader notices, and nothing reaches the drives any more."""
        self._unplugged = True
        received.close(self.loop[0]["buses"][0], 5)


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
        for drive in arm.sim.drives if fault.flags and arm.sim is not None else ():
            assert isinstance(drive, ZdtDrive)
            drive.power_flag = fault.flags[random.integers(len(fault.flags))]
        assert arm.bring_up().failure is None
        arm.reference_all()
        if fault.heals:
            arm.heal_by_itself()
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
        arm.cycles(round((HEALING_S if self.fault.heals else STANDING_S) * 1e9 / arm.period_ns))
        self.judge(goal)
        if arm.memory["mode"] == Mode.FAULT and not self.fault.unplugs:
            self.come_back()
        elif found.latched == Fault.STALE_READING.name:  # and healed
            self.judge_references(dict.fromkeys(range(6), Unreferenced.SILENT))
            self.move_again(Outcome.SUCCEEDED)
        elif found.outcome == Outcome.SUCCEEDED.name and not self.fault.unplugs:
            if self.fault.mend is not None:
                self.fault.mend(arm, self.joint)
            self.move_again(Outcome.SUCCEEDED)

    def break_it(self) -> None:
        arm = self.arm
        within_ns = int(self.random.integers(0, arm.period_ns))
        self.fault_ns = arm.now_ns + within_ns
        away_rad = abs(float(arm.loop[0]["axes"][self.joint]["measured"]["position_rad"]) + self.config.zero_rad)
        drive = self.sim.drives[self.joint]
        assert isinstance(drive, ZdtDrive)
        self.blind = self.fault.is_blind(away_rad, drive.power_flag)
        for fault in self.fault.inject(self.random, self.config.name):
            self.sim.inject(fault, self.fault_ns)
        if self.fault.unplugs:
            arm.unplug()
            self.fault_ns = arm.now_ns

    def let_it_end(self, goal: int) -> None:
        """Cycle until goal and motion are over, and note when the loop reacts."""
        arm, found, memory = self.arm, self.found, self.arm.memory
        until_ns = arm.now_ns + round(PATIENCE_S * 1e9)
        axes = arm.loop[0]["axes"]
        while arm.now_ns < until_ns:
            arm.cycle()
            since_ms = (arm.now_ns - self.fault_ns) * 1e-6
            reacts = arm.is_slowed(Slowed.LATE_DRIVE) or memory["fault"]["code"]
            if math.isnan(found.reaction_ms) and reacts and since_ms >= 0.0:
                found.reaction_ms = since_ms
            if memory["fault"]["code"] and not found.latched:
                found.latched, found.latched_ms = Fault(int(memory["fault"]["code"])).name, since_ms
            if (
                arm.outcome(goal) != Outcome.NONE
                and arm.running_goal == 0
                and not np.any(axes["commanded"]["velocity_rad_s"])
            ):
                break
        else:
            self.wrong(f"the goal has no end after {PATIENCE_S:g} s")

    def judge(self, goal: int) -> None:
        arm, found, fault = self.arm, self.found, self.fault
        truth = truth_of(self.sim)
        name = self.config.name
        outcome = Outcome(arm.outcome(goal))
        found.outcome = outcome.name
        latched = Fault[found.latched or Fault.NONE.name]
        if latched not in fault.latched and not self.blind:
            self.wrong(f"latched {latched.name}, which this fault does not explain")
        if latched == Fault.NONE and outcome == Outcome.FAULT:
            self.wrong(f"the goal ended as {outcome.name} while {latched.name} was latched")
        thrown = {name} if fault.throws else set()
        thrown |= {arm.arm.joints[j].name for j in range(6) if arm.loop[0]["axes"][j]["sent"]["stop_frames_due"] > 0}
        frames = frames_sent(arm.sent)
        thrown |= stopped_joints(arm.arm, frames)
        found.violations += motion_violations(arm.arm, truth, self.began_ns, arm.now_ns, thrown=thrown)
        found.violations += command_violations(arm.arm, frames)
        found.violations += led_after_its_stop(arm.arm, frames)
        if latched != Fault.NONE:
            self.judge_standstill(truth)
        if arm.memory["fault"]["code"]:
            self.judge_sentence()
        if fault.heals and latched == Fault.STALE_READING:
            heals, holds = not any(self.lost_power(joint) for joint in range(6)), arm.memory["mode"] == Mode.HOLDING
            if holds and not heals:
                self.wrong("the arm went on although power was lost")
            elif (
                heals and not holds and arm.memory["fault"]["joint"] == -1
            ):  # else some were heard again as it was latched
                self.wrong("the arm did not go on by itself")
        if fault.loses and not self.blind and arm.loop[0]["axes"][self.joint]["reference"]["referenced"]:
            self.wrong(f"{name} is still referenced")

    def judge_standstill(self, truth: Any) -> None:
        arm, found = self.arm, self.found
        end_ns = arm.now_ns
        stood_ns = stands_since_ns(truth, end_ns)
        moving = any(abs(float(motion.velocity_at(np.array([self.fault_ns]))[0])) > 0.0 for motion in truth.values())
        found.moved = moving
        if moving and not self.fault.backlog:
            found.stands_ms = max(stood_ns - self.fault_ns, 0) * 1e-6
        found.violations += motion_after(truth, end_ns - 100_000_000, end_ns)

    def judge_sentence(self) -> None:
        memory = self.arm.memory
        joint = int(memory["fault"]["joint"])
        named = self.arm.arm.joints[joint].name if joint >= 0 else ""
        sentence = latched_sentence(memory["snapshot"], [config.name for config in self.arm.arm.joints])
        self.found.sentences.append(sentence)
        if named not in sentence or "{" in sentence or "nan" in sentence:
            self.wrong(f"the sentence is {sentence!r}")

    # --- the way back

    def come_back(self) -> None:
        arm, fault = self.arm, self.fault
        before = {
            joint: Unreferenced(arm.loop[0]["axes"][joint]["reference"]["unreferenced_reason"]) for joint in range(6)
        }
        since = len(arm.sent)
        if fault.mend is not None:
            told = self.clear()  # the cause is still there
            if told:
                self.found.sentences.append(told)
            arm.cycles(round(0.5e9 / arm.period_ns))
            fault.mend(arm, self.joint)
            arm.cycles(30)
        for _ in range(3):
            if arm.memory["mode"] == Mode.FAULT:
                self.clear()
        if arm.memory["mode"] != Mode.HOLDING:
            self.wrong(
                f"after the clear the arm is {Mode(int(arm.memory['mode'])).name}, "
                f"{Fault(int(arm.memory['fault']['code'])).name}"
            )
            return
        self.judge_references(before)
        if motion_frames(frames_sent(arm.sent[since:]), self.config.drive.address, 0):  # type: ignore[union-attr]
            self.wrong("the clear moved the arm")
        sound = bool(np.all(arm.loop[0]["axes"]["reference"]["referenced"][:6]))
        self.move_again(Outcome.SUCCEEDED if sound else Outcome.REFUSED_UNREFERENCED)

    def judge_references(self, before: Mapping[int, Unreferenced]) -> None:
        """What is referenced stands where it reads; what was silent alone, and kept its power, is referenced."""
        arm = self.arm
        for joint, reason in before.items():
            axis, name = arm.loop[0]["axes"][joint], arm.arm.joints[joint].name
            off_rad = float(axis["measured"]["position_rad"]) - self.sim.true_position_rad(joint, self.sim.now_ns)
            if axis["reference"]["referenced"] and reason in (Unreferenced.POWER_LOST, Unreferenced.POSITION_JUMP):
                self.wrong(f"the clear referenced {name}")
            elif axis["reference"]["referenced"] and abs(off_rad) > KNOWN_WITHIN_RAD:
                self.wrong(f"{name} is referenced, and {off_rad:+.3f} rad from where it reads")
            elif not axis["reference"]["referenced"] and reason == Unreferenced.SILENT and not self.lost_power(joint):
                self.wrong(f"{name} has lost its reference although its drive has kept its power")

    def lost_power(self, joint: int) -> bool:
        """Whether the joint's drive did, or whether its flag says so whatever it did."""
        drive = self.sim.drives[joint]
        return isinstance(drive, ZdtDrive) and (drive.power_losses > 0 or drive.power_flag == "stuck")

    def clear(self) -> str:
        """Ask for a clear; the sentence with which it failed, if it did."""
        arm = self.arm
        sequence = arm.request(Request.CLEAR_FAULT)
        arm.cycle()
        answer = arm.reader.snapshot()["answers"][sequence % 16]["answer"]
        if answer != Answer.DONE:
            self.wrong(f"the clear was answered {Answer(int(answer)).name}")
            return ""
        arm.memory["dialogue"]["bring_up_asked"] = 0
        failure = arm.bring_up(clears_protection=True).failure
        return "" if failure is None else str(failure)

    def move_again(self, wanted: Outcome) -> None:
        """A small goal from where the arm stands, towards the middle of every joint."""
        arm = self.arm
        here = arm.loop[0]["axes"]["commanded"]["position_rad"][:6].copy()
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
            arm.end_of(goal, at_most_s=5.0)
        except AssertionError:
            self.wrong("the goal afterwards never ends")
            return
        outcome = Outcome(arm.outcome(goal))
        if outcome != wanted:
            result = arm.result(goal)
            sentence = outcome_sentence(
                outcome, str(int(result["joint"])), float(result["value"]), float(result["limit"])
            )
            latched = Fault(int(arm.memory["fault"]["code"])).name
            self.wrong(f"the goal afterwards ended as {outcome.name} ({sentence} {latched}), not {wanted.name}")
        elif wanted == Outcome.REFUSED_UNREFERENCED:
            joint = int(arm.result(goal)["joint"])
            reason = int(arm.loop[0]["axes"][joint]["reference"]["unreferenced_reason"])
            self.found.sentences.append(unreferenced_sentence(reason, arm.arm.joints[joint].name))


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
        print(f"No fault's name contains {options.only!r}: see FAULTS in tests/bus_faults.py.", file=sys.stderr)
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
