"""A sample of the bus trials with real processes: `make bus-trials-live`.

The faults of `bus_faults`, told to a simulated arm of its own process behind a pseudo-terminal at a random moment of a
random goal, and judged by the observer. Violations are: motion beyond a limit, a fault that stays unnoticed, a goal
without an end, and no way back. What a busy machine adds (a drive that answers too late) is told and no more.
"""

from __future__ import annotations

import argparse
import secrets
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import guardian
import numpy as np
import yaml
from bus_faults import FAULTS, GOES_ON, BusFault, spelled
from observer import (
    command_violations,
    frames_sent,
    led_after_its_stop,
    motion_after,
    motion_violations,
    stands_since_ns,
    stopped_joints,
)
from process_trials import begin_again, own_ros_domain, small_home, spread

from config.loader import load_arm
from rtloop.dialogues.healing import DECIDED_WITHIN_NS
from shm.words import Fault, Mode

STANDS_WITHIN_S = 3.0
"""A stop takes 2 s at most; some faults are noticed after 0.1 s."""
RESULT_WITHIN_S = 6.0
BACKLOG_S = 2.0
"""A babbling node or a blocked port is freed by the end of the simulated arm: nothing waits longer than this."""
STILL_S = 0.3
POLL_S = 0.002


@dataclass
class Seen:
    """What a trial showed; times from the moment at which the simulated arm was told."""

    latched: str = ""
    outcome: str = ""
    latched_ms: float | None = None
    told_ms: float | None = None
    stands_ms: float | None = None
    steps: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def equip(rig: Any, fault: BusFault) -> None:
    """An arm whose drives are sound, as this fault wants it; the control process finds it plugged in again."""
    values = yaml.safe_load(rig.arm_file.read_text(encoding="utf-8"))
    before = yaml.safe_dump(values)
    for section, sound in (("bus", {"acknowledge": False}), ("control", {"rate_hz": 120.0})):
        values[section] = {**values.get(section, {}), **sound, **fault.overrides.get(section, {})}
    if yaml.safe_dump(values) != before and rig.pid("loop"):
        rig.stop_control()
        rig.note_dead_servers()
    rig.arm_file.write_text(yaml.safe_dump(values), encoding="utf-8")
    rig.arm = load_arm(rig.arm_file)
    plug_in(rig, fault)


def plug_in(rig: Any, fault: BusFault) -> None:
    """Take the simulated arm away and start a sound one where it stood."""
    if rig.pid("sim"):
        rig.sim.close()
    rig.start_arm(*(word for name, value in fault.options.items() for word in (f"--{name}", str(value))))


def run(rig: Any, fault: BusFault) -> Seen:
    """One fault at a random moment of a goal, its judgement, and the way back; raises Hang."""
    seen = Seen()
    equip(rig, fault)
    rig.make_ready()
    sent, began_ns = rig.moving_goal(0.7, seen.notes, seen.steps, shortest_s=2.0)
    joint = rig.arm.joints[rig.random.integers(len(rig.arm.joints))]
    away_rad = abs(rig.commanded_rad()[rig.arm.joints.index(joint)] + joint.zero_rad)
    blind = fault.is_blind(away_rad, "right")
    told_ns = time.monotonic_ns()
    for text in map(spelled, fault.inject(rig.random, joint.name)):
        rig.befall(text)
    _await_end(rig, sent, told_ns, seen)
    thrown = {joint.name} if fault.throws else set()
    _judge(rig, fault, began_ns, told_ns, thrown, seen)
    latched = Fault[seen.latched] if seen.latched else GOES_ON
    if latched not in fault.latched:
        sentence = f"latched {latched.name}, which this fault does not explain"
        (seen.notes if latched != GOES_ON or blind else seen.violations).append(sentence)
    _way_back(rig, fault, seen)
    return seen


def _await_end(rig: Any, sent: Any, told_ns: int, seen: Seen) -> None:
    """Until the goal has its result and a fault, if there is one, is latched."""
    from fault_rig import Hang
    from process_faults import kind_of

    deadline_s = time.monotonic() + sent.duration_s + RESULT_WITHIN_S
    while not sent.ended.wait(POLL_S):
        _note_fault(rig, told_ns, seen)
        if time.monotonic() > deadline_s:
            raise Hang("the goal has no result")
    seen.told_ms = (sent.ended_ns - told_ns) / 1e6
    seen.outcome = "succeeded" if sent.succeeded else kind_of(sent.words)
    _note_fault(rig, told_ns, seen)


def _note_fault(rig: Any, told_ns: int, seen: Seen) -> None:
    snapshot = rig.snapshot()
    if seen.latched_ms is None and snapshot is not None and snapshot["fault"] != Fault.NONE:
        seen.latched = Fault(int(snapshot["fault"])).name
        seen.latched_ms = (time.monotonic_ns() - told_ns) / 1e6


def _await_healing(rig: Any, seen: Seen) -> None:
    """Until the arm has gone on by itself, or will not any more."""
    until_s = time.monotonic() + DECIDED_WITHIN_NS * 1e-9 + 1.0
    while time.monotonic() < until_s:
        if (snapshot := rig.snapshot()) is not None and snapshot["mode"] == Mode.HOLDING:
            seen.steps.append("went on by itself")
            return
        time.sleep(POLL_S)


def _judge(rig: Any, fault: BusFault, began_ns: int, told_ns: int, thrown: set[str], seen: Seen) -> None:
    if fault.backlog:
        time.sleep(BACKLOG_S)  # what waited is still on its way
    if fault.heals and seen.latched:
        _await_healing(rig, seen)
    rig.standing(STANDS_WITHIN_S)
    time.sleep(STILL_S)  # in which nothing may begin to move
    still_ns = time.monotonic_ns() - round(STILL_S * 1e9)
    truth, now_ns = rig.truth(), time.monotonic_ns()
    frames = frames_sent([piece for piece in rig.wire() if piece[0] >= began_ns])
    stopped = stopped_joints(rig.arm, frames)
    seen.violations += motion_violations(rig.arm, truth, began_ns, now_ns, thrown=thrown | stopped)
    seen.violations += command_violations(rig.arm, frames) + led_after_its_stop(rig.arm, frames)
    seen.violations += motion_after(truth, still_ns, now_ns)
    if seen.latched:
        seen.stands_ms = max(0, stands_since_ns(truth, now_ns) - told_ns) / 1e6


def _way_back(rig: Any, fault: BusFault, seen: Seen) -> None:
    """As a person would bring the arm back: the cause mended where it lasts, the fault cleared, a goal succeeds."""
    if fault.mend is not None or fault.loses:
        plug_in(rig, fault)
    seen.violations += rig.goal_succeeds(seen.notes, seen.steps)
    if fault.heals and not fault.loses and any(step.startswith("referenced") for step in seen.steps):
        seen.violations.append("references were lost although every drive had power")


# --- many of them


def row(name: str, trials: Sequence[Seen]) -> str:
    """A line of the report's table."""
    latched = Counter(trial.latched or "–" for trial in trials)
    outcomes = Counter(trial.outcome for trial in trials)
    cells = [
        name,
        ", ".join(f"{key} {count}" for key, count in latched.most_common()),
        ", ".join(f"{key} {count}" for key, count in outcomes.most_common()),
        *(
            spread([value for trial in trials if (value := getattr(trial, figure)) is not None])
            for figure in ("latched_ms", "told_ms", "stands_ms")
        ),
        str(len(trials)),
        str(sum(bool(trial.violations) for trial in trials)),
    ]
    return f"| {' | '.join(cells)} |"


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="live_bus_trials", description=__doc__)
    parser.add_argument("--trials", type=int, default=1, help="of each fault")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", default=[], help="part of a fault's name (may be repeated)")
    options = parser.parse_args(arguments)
    # an adapter that is pulled out is the end of the simulated arm: `process_trials --only "sim:"`
    kinds = [f for f in FAULTS if not f.unplugs and (not options.only or any(part in f.name for part in options.only))]
    if not kinds:
        only = " or ".join(map(repr, options.only))
        print(f"No fault's name contains {only}: see FAULTS in tests/bus_faults.py.", file=sys.stderr)
        return 2
    begin_again("live_bus_trials", arguments)
    own_ros_domain()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    from fault_rig import Hang, Rig

    found: dict[str, list[Seen]] = {kind.name: [] for kind in kinds}
    left: list[str] = []
    prefix = "rtarm-live-"
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name, small_home(Path(name)):
        rig = Rig(f"t{secrets.token_hex(4)}", Path(name), np.random.default_rng(options.seed))
        try:
            rig.start_arm()
            for kind in kinds * options.trials:
                guardian.doing(f"a trial of {kind.name!r}")
                began_s = time.monotonic()
                found[kind.name].append(run(rig, kind))
                print(line(kind.name, found[kind.name][-1], time.monotonic() - began_s), flush=True)
            guardian.doing("the end of the trials")
            left = rig.stop_control()
        except (Hang, AssertionError) as problem:
            said = rig.launcher.said()[-2000:] if rig.launcher else ""
            left = [f"hang in {kind.name!r}: {str(problem)[:500]}\n{said}"]
        finally:
            left += rig.end()
    bad = [f"{name}: {sentence}" for name, trials in found.items() for trial in trials for sentence in trial.violations]
    print("| fault | latched | goal ended as | latched ms | client told ms | stands ms | trials | violations |")
    print("|---|---|---|---|---|---|---|---|")
    print(*(row(name, trials) for name, trials in found.items() if trials), sep="\n")
    print(f"Milliseconds: p50 / p99 / max. Violations: {len(bad) + len(left)}", *bad, *left, sep="\n")
    return int(bool(bad or left))


def line(name: str, seen: Seen, seconds: float) -> str:
    """What is told of a trial as it ends."""
    parts = [name, seen.latched or "–", seen.outcome, *seen.steps, *seen.notes, f"{seconds:.1f} s"]
    return " | ".join(parts) + "".join(f"\n    VIOLATION {sentence}" for sentence in seen.violations)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
