"""Trials of a person's stop in virtual time: at a random moment, whatever clients, streams and floods go on sending.

`make stop-trials` runs many beside each of the senders, on every processor, and prints the table of
docs/explanation/testing.md; `tests/rtloop/commands/test_stop_trials.py` runs a sample. A trial is a function of its
sender and its seed. Nobody resumes the arm before the trial has been judged, so nothing may move after the stop's
bound.
"""

import argparse
import math
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field

import numpy as np
from bus_trials import TrialArm
from observer import command_violations, frames_sent, motion_after, motion_violations, stands_since_ns, truth_of
from random_ways import random_box_pose, random_way, shortest_stop_s
from servo import Servo, SinglePoints, waves
from virtual import VirtualArm

from config.loader import load_arm
from shm.errors import RingFull
from shm.files import producers_lock
from shm.words import Fault, Mode, Outcome, Request
from sim.arm import SimulatedArm

NS = 10**9
EARLIEST_S, LATEST_S = 0.2, 2.0
"""Of the moment of the stop, after the senders have begun."""
STANDS_S = 0.5
"""After the stop's bound nothing moves for so long, while everybody goes on sending."""
FOLLOWS_S = 0.5
"""A drive stands on its target within this time."""
SHORTEST_GOAL_S, LONGEST_GOAL_S = 0.6, 3.0
FLOOD = 16
"""Speed scales and cancels in each cycle, about 1.9 kHz."""
PAUSE_CYCLES = 100
"""Between two looks at a ring that was full."""
UNENDED_CANCELS = 8
"""Of goal numbers around the newest one: a flood seldom hits the goal that runs."""


class Client:
    """Sends goals, each from where the arm is commanded to be, the next one when the last has ended, however it did."""

    def __init__(self, arm: VirtualArm, random: np.random.Generator) -> None:
        self.arm, self.random = arm, random
        self.goal = 0
        self.sent = np.zeros(0), np.zeros((0, 0, 0))

    def turn(self) -> None:
        """What is sent before the arm's next cycle."""
        if self.has_ended():
            self.send()

    def has_ended(self) -> bool:
        return self.goal == 0 or self.arm.outcome(self.goal) != Outcome.NONE

    def here(self) -> np.ndarray:
        """Where the arm is commanded to be, (joints,)."""
        here: np.ndarray = self.arm.loop[0]["axes"]["commanded"]["position_rad"][: len(self.arm.arm.joints)].copy()
        return here

    def send(self, start_ns: int = 0, origin: np.ndarray | None = None, moving: float = 0.0) -> tuple[int, np.ndarray]:
        """Send a quintic: how long it takes [ns], and where it ends.

        `origin`: where it begins; `moving`: the share of the arm's velocity with which it does.
        """
        origin = self.here() if origin is None else origin
        seconds = self.random.uniform(SHORTEST_GOAL_S, LONGEST_GOAL_S)
        joints = np.zeros((2, len(origin), 3))
        joints[:, :, 0] = origin, origin + random_way(self.arm.arm.joints, origin, seconds, self.random)
        joints[0, :, 1] = moving * self.arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][: len(origin)]
        self.sent = np.array([0, round(seconds * NS)]), joints
        self.goal = self.arm.send_goal(*self.sent, start_ns=start_ns)
        return round(seconds * NS), joints[1, :, 0]


class Retrying(Client):
    """What did not succeed is sent again at once: the same goal, or a plan from where the arm is by then."""

    def turn(self) -> None:
        if self.goal != 0 and self.arm.outcome(self.goal) not in (Outcome.NONE, Outcome.SUCCEEDED):
            if self.random.random() < 0.5:
                self.goal = self.arm.send_goal(*self.sent)
            else:
                self.send()
        super().turn()


class Flooding(Client):
    """A client, beside whom others set the speed scale, cancel and ask for this and that as fast as they can."""

    def __init__(self, arm: VirtualArm, random: np.random.Generator) -> None:
        super().__init__(arm, random)
        self._pause_cycles = 0

    def turn(self) -> None:
        super().turn()
        for _ in range(FLOOD):
            self.arm.writer.scale(self.random.uniform(0.2, 1.0))
            self.arm.writer.cancel(max(self.goal - 1 - int(self.random.integers(UNENDED_CANCELS)), 0))
        if self.random.random() < 0.01:
            self.arm.writer.cancel(self.goal)
        self._pause_cycles -= 1
        while self._pause_cycles < 0:
            try:
                self.arm.request(self.random.choice([Request.ENABLE, Request.CLEAR_FAULT, Request.HOME_STOP]))
            except RingFull:
                self._pause_cycles = int(self.random.integers(PAUSE_CYCLES))


class Waiting(Client):
    """Goals that are stamped ahead, each from where the one before it ends."""

    def __init__(self, arm: VirtualArm, random: np.random.Generator) -> None:
        super().__init__(arm, random)
        self._next_ns = self._over_ns = 0
        self._end: np.ndarray | None = None

    def turn(self) -> None:
        now_ns = self.arm.now_ns
        if self.goal != 0 and self.arm.outcome(self.goal) not in (Outcome.NONE, Outcome.SUCCEEDED):
            self._end, self._next_ns = None, 0
        if now_ns < self._next_ns:
            return
        begins_ns = now_ns if self._end is None else max(now_ns, self._over_ns)
        start_ns = begins_ns + round(self.random.uniform(0.0, 1.0) * NS)
        lasts_ns, self._end = self.send(start_ns, self._end)
        self._over_ns = start_ns + lasts_ns
        self._next_ns = start_ns + round(self.random.uniform(0.1, 1.0) * lasts_ns)


class Replacing(Client):
    """Goals that replace each other in motion, planned from where the arm is, at rest or with its velocity."""

    def __init__(self, arm: VirtualArm, random: np.random.Generator) -> None:
        super().__init__(arm, random)
        self._next_ns = 0

    def turn(self) -> None:
        if self.arm.now_ns >= self._next_ns:
            self.send(moving=float(self.random.integers(2)))
            self._next_ns = self.arm.now_ns + round(self.random.uniform(0.03, 0.6) * NS)


def streaming(arm: VirtualArm, random: np.random.Generator) -> Servo:
    """Servo's windows, or points one by one, at 100 Hz."""
    way = waves(arm, random.uniform(0.3, 0.7), int(random.integers(1 << 30)))
    if random.random() < 0.5:
        return Servo(arm, way, 100.0)
    return SinglePoints(arm, way, 100.0, velocities=True)


Sender = Client | Servo
SENDERS: dict[str, Callable[[VirtualArm, np.random.Generator], Sender]] = {
    "a stream at 100 Hz": streaming,
    "a flood of scales, cancels and requests": Flooding,
    "goals that wait for their start": Waiting,
    "goals that replace each other": Replacing,
    "a client that retries": Retrying,
}


@dataclass
class Found:
    """What a trial showed; times from the moment at which the stop was pressed."""

    sender: str
    seed: int
    moved: bool = False
    rest_ms: float = math.nan
    true_rest_ms: float = math.nan
    shortest_ms: float = math.nan
    bound_ms: float = math.nan
    violations: list[str] = field(default_factory=list)


def run_trial(sender: str, seed: int, name: str = "episode1") -> Found:
    """A stop at a random moment beside a sender, its judgement, and a goal after the resume.

    `name`: of the arm; `mock` has no drives, so that its commanded motion alone is judged.
    """
    random = np.random.default_rng([seed, sum(sender.encode())])
    config = load_arm(name)
    start_rad = random_box_pose(config.joints, random)
    has_drives = config.bus.interface != "mock"
    arm = (TrialArm if has_drives else VirtualArm)(config, start_rad=start_rad, seed=seed)
    found = Found(sender, seed)
    try:
        known = {} if has_drives else {"mock_positions_rad": start_rad.tolist()}
        assert arm.bring_up(**known).failure is None
        _Trial(arm, found, random).run(SENDERS[sender](arm, random))
    finally:
        arm.close()
    return found


@contextmanager
def suspended_producer(arm: VirtualArm) -> Iterator[None]:
    """A process that asks something of the arm stands still in the middle of it, and keeps the producers' lock."""
    fd = os.open(f"/proc/self/fd/{arm.command.fd}", os.O_RDWR)
    try:
        with producers_lock(fd):
            yield
    finally:
        os.close(fd)


class _Trial:
    def __init__(self, arm: VirtualArm, found: Found, random: np.random.Generator) -> None:
        self.arm, self.found, self.random = arm, found, random
        self.ends: dict[int, int] = {}
        self.began_ns = self.pressed_ns = self.rest_ns = arm.now_ns

    def wrong(self, sentence: str) -> None:
        self.found.violations.append(sentence)

    def run(self, sender: Sender) -> None:
        arm = self.arm
        for _ in range(round(self.random.uniform(EARLIEST_S, LATEST_S) * NS / arm.period_ns)):
            self.cycle(sender)
        with suspended_producer(arm) if self.random.random() < 0.5 else nullcontext():
            self.press()
            self.let_it_stop(sender)
        self.judge()
        if arm.sim is not None:
            self.judge_drives(arm.sim)
        self.come_back()

    def cycle(self, sender: Sender) -> None:
        """One cycle, and the ends of goals in it."""
        sender.turn()
        self.arm.cycle()
        results = self.arm.loop[0]["snapshot"]["results"]
        for goal, outcome in zip(results["goal_id"].tolist(), results["outcome"].tolist(), strict=True):
            if outcome != Outcome.NONE and self.ends.setdefault(goal, outcome) != outcome:
                self.wrong(f"goal {goal} ended as {Outcome(self.ends[goal]).name}, then as {Outcome(outcome).name}")

    def press(self) -> None:
        """At any moment between two cycles."""
        arm, found = self.arm, self.found
        velocity_rad_s = arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][: len(arm.arm.joints)]
        found.moved = bool(np.any(velocity_rad_s))
        found.shortest_ms = 1e3 * shortest_stop_s(arm.arm.joints, velocity_rad_s)
        found.bound_ms = 1e3 * float(arm.loop[0]["params"]["longest_stop_s"])
        self.pressed_ns = arm.now_ns + int(self.random.integers(arm.period_ns))
        arm.writer.stop()

    def let_it_stop(self, sender: Sender) -> None:
        """Everybody goes on sending until long after the stop's bound; once the arm stands, nothing begins."""
        arm, found = self.arm, self.found
        bound_ns = self.pressed_ns + round(found.bound_ms * 1e6) + arm.period_ns
        axes, count = arm.loop[0]["axes"], len(arm.arm.joints)
        rested = False
        while arm.now_ns < bound_ns + STANDS_S * NS:
            before_rad = axes["commanded"]["position_rad"][:count].copy()
            self.cycle(sender)
            if (axes["commanded"]["position_rad"][:count] != before_rad).any():
                if rested:
                    self.wrong(f"commanded to move again {(arm.now_ns - self.pressed_ns) * 1e-6:.0f} ms after the stop")
                    return
                self.rest_ns = arm.now_ns
            rested = rested or not np.any(axes["commanded"]["velocity_rad_s"][:count])
        found.rest_ms = max(self.rest_ns - self.pressed_ns, 0) * 1e-6
        if self.rest_ns > bound_ns:
            self.wrong(
                f"commanded motion until {found.rest_ms:.0f} ms after the stop, whose bound is {found.bound_ms:.0f} ms"
            )

    def judge(self) -> None:
        arm, memory = self.arm, self.arm.memory
        if memory["fault"]["code"] != Fault.NONE or memory["mode"] != Mode.HOLDING or memory["operator"]["held"] != 1:
            self.wrong(
                f"after the stop it is {Mode(int(memory['mode'])).name}, {Fault(int(memory['fault']['code'])).name}, "
                f"held {int(memory['operator']['held'])}"
            )
        if outlived := arm.running_goal or arm.waiting_goal:
            self.wrong(f"goal {outlived} outlived the stop")
        if without := set(range(1, arm.writer.announced_goal + 1)) - set(self.ends):
            self.wrong(f"goals without an end: {sorted(without)}")

    def judge_drives(self, sim: SimulatedArm) -> None:
        """What they truly did, and what they were told."""
        arm, found, truth = self.arm, self.found, truth_of(sim)
        found.true_rest_ms = max(stands_since_ns(truth, arm.now_ns) - self.pressed_ns, 0) * 1e-6
        found.violations += motion_violations(arm.arm, truth, self.began_ns, arm.now_ns)
        found.violations += command_violations(arm.arm, frames_sent(arm.sent))
        still_ns = max(self.rest_ns, self.pressed_ns) + round(FOLLOWS_S * NS)
        found.violations += motion_after(truth, still_ns, arm.now_ns)

    def come_back(self) -> None:
        """A resume begins nothing of what was sent before it, and the next goal succeeds."""
        arm = self.arm
        arm.writer.scale(1.0)
        arm.resume()
        stood_rad = arm.loop[0]["axes"]["commanded"]["position_rad"].copy()
        arm.cycles(round(FOLLOWS_S * NS / arm.period_ns))
        if (arm.loop[0]["axes"]["commanded"]["position_rad"] != stood_rad).any():
            self.wrong("the resume moved the arm")
        goal = arm.send_shift(0.01, duration_s=0.3)
        with suppress(AssertionError):
            arm.end_of(goal, at_most_s=2.0)
        if (outcome := Outcome(arm.outcome(goal))) != Outcome.SUCCEEDED:
            self.wrong(f"the goal after the resume ended as {outcome.name}")


# --- many of them


def _run(task: tuple[str, int, str]) -> Found:
    try:
        return run_trial(*task)
    except Exception as problem:  # a trial that breaks down is a finding too
        return Found(*task[:2], violations=[f"{type(problem).__name__}: {problem}"])


def _figures(values: Sequence[float]) -> str:
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return "–"
    return " / ".join(f"{value:.0f}" for value in (*np.percentile(known, (50, 99)), max(known)))


def row(name: str, trials: Sequence[Found]) -> str:
    """A line of the table; times are of those trials in which the arm moved when the stop was pressed."""
    moved = [trial for trial in trials if trial.moved]
    cells = [_figures([getattr(t, of) for t in moved]) for of in ("rest_ms", "true_rest_ms", "shortest_ms")]
    cells.append(_figures([t.rest_ms - t.shortest_ms for t in moved]))
    counts = (len(moved), sum(bool(trial.violations) for trial in trials), len(trials))
    return f"| {' | '.join([name, *cells, *map(str, counts)])} |"


def main() -> int:
    """Run the trials and print the table; the exit code says whether any was violated."""
    parser = argparse.ArgumentParser(prog="stop_trials", description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200, help="beside each sender")
    parser.add_argument("--only", default="", help="senders whose name contains this")
    parser.add_argument("--seed", type=int, default=0, help="of the first trial beside each sender")
    parser.add_argument("--arm", default="episode1", help="mock: commanded motion alone, ten times as fast")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args()
    chosen = [name for name in SENDERS if options.only in name]
    if not chosen:
        print(f"No sender's name contains {options.only!r}: see SENDERS in tests/stop_trials.py.", file=sys.stderr)
        return 2
    tasks = [(name, options.seed + number, options.arm) for name in chosen for number in range(options.trials)]
    began = time.monotonic()
    found: list[Found] = []
    print("Milliseconds from the press: p50 / p99 / max.\n")
    print("| stopped beside | commanded rest | true rest | v / a | commanded rest - v / a | moving | bad | trials |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    with multiprocessing.get_context("spawn").Pool(options.workers) as pool:
        for trial in pool.imap(_run, tasks, chunksize=4):
            found.append(trial)
            for sentence in trial.violations:
                print(f"{trial.sender}, seed {trial.seed}: {sentence}", file=sys.stderr, flush=True)
            if len(found) % options.trials == 0:
                print(row(trial.sender, found[-options.trials :]), flush=True)
    print(row("all", found))
    print(
        "v / a is the shortest stop: what the slowest joint needs, alone at its acceleration limit, from the velocity "
        "commanded at the press. Times are of trials in which the arm was moving then. "
        f"The stop's bound, this arm's longest stop: {max(trial.bound_ms for trial in found):.0f} ms."
    )
    broken = sum(len(trial.violations) for trial in found)
    print(f"{len(tasks)} trials in {time.monotonic() - began:.0f} s, {broken} violations", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
