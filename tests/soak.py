"""`make soak MINUTES=60`: random goals with random faults for hours, and a report of what grew and what went wrong.

The whole arm as real processes under `rtarm up`. Somebody sends goals, recorded ones too, cancels, replaces, holds,
streams, changes the speed; drives fall silent, replies get lost, bytes change, the front is killed, processes freeze;
what latches a fault is cleared as a person would. An observer outside judges every moment of true motion and every
command on the wire. Exits with 1 on a violation, a hang, or something that grows.
"""

from __future__ import annotations

import argparse
import math
import os
import secrets
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import guardian
import numpy as np
from process_trials import begin_again, own_ros_domain, small_home
from random_ways import shortest_quintic_s

BETWEEN_FAULTS_S = 15.0
BETWEEN_FRONT_KILLS_S = 400.0
SAMPLE_EVERY_S = 5.0
WARM_UP_S = 150.0
"""Of each process' life, which no slope is taken of: what is used for the first time stays in memory, and the simulated
arm fills its own (`fault_rig.WINDOW_S`)."""
BLOCKS = 10
FEWEST_LIVES, FEWEST_SAMPLES = 4, 4
"""Of processes that are started again and again, for a slope of all of them together."""
SHORT_LIVES_MAY = 2.0
"""Times as much as a long one: they still use things for the first time."""
BOUNDS_PER_HOUR = {"own_mb": 6.0, "files": 4.0, "threads": 2.0}
"""What may grow: a slope is a leak when the lower end of its 95 % interval lies above."""
SHM_BOUND_MB_PER_HOUR = 6.0
STREAM_HZ, STREAM_S = 50.0, 2.0
LONGEST_WAIT_S = 15.0
AGAIN_NS = 100_000_000
"""Judged once more: an acceleration needs a moment on either side."""
TARGETS = ("sim", "loop", "front", "launcher")


@dataclass
class Sample:
    """What the processes held at a moment, and how late cycles were since the sample before."""

    at_s: float
    of: dict[str, dict[str, float]]
    shm_mb: float
    lateness_us: tuple[float, float, float]
    cycles: int
    missed: int


@dataclass
class Record:
    """All that a soak has seen."""

    results: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    ways_back: Counter[str] = field(default_factory=Counter)
    samples: list[Sample] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)


class Soak:
    """One soak of a rig that is in service; `evidence` is a folder for the true motion around each violation."""

    def __init__(self, rig: Any, record: Record, evidence: Path | None = None) -> None:
        from control_msgs.msg import SpeedScalingFactor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from trajectory_msgs.msg import JointTrajectory

        self.rig, self.record, self.random = rig, record, rig.random
        self._evidence = evidence
        node = rig.user.node
        lasting = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._scale = node.create_publisher(SpeedScalingFactor, f"/{rig.user.controller}/speed_scaling_input", lasting)
        self._stream = node.create_publisher(JointTrajectory, f"/{rig.user.controller}/joint_trajectory", 1)
        self._judged_ns = time.monotonic_ns()
        self._began_s = time.monotonic()
        self._before: dict[str, Any] = {}
        self._next_fault_s = self._began_s + BETWEEN_FAULTS_S
        self._next_kill_s = self._began_s + BETWEEN_FRONT_KILLS_S

    def run(self, seconds: float) -> None:
        """Soak; raises Hang."""
        sampled_s = 0.0
        actions = (
            self._to_the_end,
            self._recorded,
            self._canceled,
            self._replaced,
            self._held,
            self._slower,
            self._streamed,
        )
        while time.monotonic() - self._began_s < seconds:
            guardian.doing(f"{time.monotonic() - self._began_s:.0f} s into the soak")
            self.record.ways_back.update(self.rig.make_ready())
            action: Callable[[], None] = actions[
                self.random.choice(len(actions), p=(0.3, 0.1, 0.15, 0.15, 0.1, 0.1, 0.1))
            ]
            action()
            if time.monotonic() - sampled_s > SAMPLE_EVERY_S:
                sampled_s = time.monotonic()
                self._judge()
                self._sample()

    # --- what people do

    def _follow(self, sent: Any, name: str) -> None:
        """Wait for a result, or for the end of who would give it; faults come meanwhile."""
        from fault_rig import Hang, alive
        from process_faults import kind_of

        front = self.rig.pid("front")
        deadline_s = time.monotonic() + sent.duration_s * 4 + LONGEST_WAIT_S
        while not sent.ended.wait(0.005):
            if time.monotonic() > self._next_fault_s:
                self._hurt()
            if not alive(front):
                self.rig.note_dead_servers()
                self.record.results[f"{name}: server gone"] += 1
                return
            if time.monotonic() > deadline_s:
                raise Hang(f"{name}: no result")
        self.record.results[f"{name}: {'succeeded' if sent.succeeded else kind_of(sent.words)}"] += 1

    def _part(self, sent: Any) -> None:
        """A random part of a goal's time."""
        sent.ended.wait(self.random.uniform(0.1, 0.8) * sent.duration_s)

    def _to_the_end(self) -> None:
        self._follow(self.rig.send(self.rig.goal()), "goal")

    def _recorded(self) -> None:
        from fault_rig import quintic_goal
        from ros_client import GOALS, recorded

        names = sorted(path.stem for path in GOALS.glob("*.json") if "0_1" not in path.stem)
        goal = recorded(names[self.random.integers(len(names))])
        here = self.rig.commanded_rad()
        way = np.array(goal.trajectory.points[0].positions) - here
        seconds = shortest_quintic_s(self.rig.arm.joints, way)
        self._follow(
            self.rig.send(quintic_goal(list(goal.trajectory.joint_names), here, way, seconds)),
            "to a recorded goal's beginning",
        )
        if np.abs(self.rig.commanded_rad() - goal.trajectory.points[0].positions).max() < 1e-3 and not self._faulted():
            self._follow(self.rig.send(goal), "recorded goal")

    def _canceled(self) -> None:
        sent = self.rig.send(self.rig.goal())
        self._part(sent)
        if sent.handle is not None:
            sent.handle.cancel_goal_async()
        self._follow(sent, "canceled goal")

    def _replaced(self) -> None:
        first = self.rig.send(self.rig.goal())
        self._part(first)
        if self._faulted():
            return self._follow(first, "replaced goal")
        second = self.rig.send(self.rig.goal(shortest_s=2.0))
        self._follow(first, "replaced goal")
        return self._follow(second, "replacing goal")

    def _held(self) -> None:
        sent = self.rig.send(self.rig.goal())
        self._part(sent)
        self.record.results[f"~/hold: {self.rig.user.order('hold') or 'done'}"] += 1
        time.sleep(self.random.uniform(0.0, 0.5))  # held for a moment
        self.record.results[f"~/resume: {self.rig.user.order('resume') or 'done'}"] += 1
        self._follow(sent, "held goal")

    def _slower(self) -> None:
        from control_msgs.msg import SpeedScalingFactor

        sent = self.rig.send(self.rig.goal())
        for factor in (self.random.uniform(0.3, 1.0), self.random.uniform(0.3, 1.0), 1.0):
            self._part(sent)
            self._scale.publish(SpeedScalingFactor(factor=float(factor)))
        self._follow(sent, "slowed goal")

    def _streamed(self) -> None:
        """Single points along a slow wave, as fast as Servo sends them; the stream simply ends."""
        from builtin_interfaces.msg import Duration
        from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

        home, names = self.rig.commanded_rad(), [joint.name for joint in self.rig.arm.joints]
        towards = np.where(home > np.array([(j.lower_rad + j.upper_rad) / 2 for j in self.rig.arm.joints]), -1.0, 1.0)
        began_s, omega = time.monotonic(), math.pi
        while (t := time.monotonic() - began_s) < STREAM_S:
            ahead = t + 0.1
            position = home + towards * 0.05 * (1 - math.cos(omega * ahead))
            velocity = towards * 0.05 * omega * math.sin(omega * ahead)
            point = JointTrajectoryPoint(
                positions=position.tolist(), velocities=velocity.tolist(), time_from_start=Duration(nanosec=100_000_000)
            )
            self._stream.publish(JointTrajectory(joint_names=names, points=[point]))
            time.sleep(1.0 / STREAM_HZ)
        self.record.results["stream: sent"] += 1

    def _faulted(self) -> bool:
        from shm.words import Mode

        return self.rig.mode() in (Mode.FAULT, Mode.OFFLINE)

    # --- what happens to it

    def _hurt(self) -> None:
        self._next_fault_s = time.monotonic() + self.random.exponential(BETWEEN_FAULTS_S)
        joint = self.rig.arm.joints[self.random.integers(len(self.rig.arm.joints))].name
        kinds = {
            "drive silent for 5–60 ms": lambda: self._tell(
                f"silent:joint={joint},at_s=0,until_s={self.random.uniform(0.005, 0.06):.4f}"
            ),
            "2 % of replies lost for 1 s": lambda: self._tell("lost-replies:share=0.02", "lost-replies:share=0,at_s=1"),
            "1 bit in 1000 bytes changed for 1 s": lambda: self._tell(
                "corrupt-bytes:share=0.001", "corrupt-bytes:share=0,at_s=1"
            ),
            "SIGSTOP of the adapter for 2–20 ms": lambda: self._freeze("sim", 0.002, 0.020),
            "SIGSTOP of the loop for 10–60 ms": lambda: self._freeze("loop", 0.010, 0.060),
            "SIGSTOP of the loop for 0.2–2 s": lambda: self._freeze("loop", 0.2, 2.0),
            "SIGSTOP of the front for 0.01–2 s": lambda: self._freeze("front", 0.010, 2.0),
            "SIGSTOP of the launcher for 0.01–2 s": lambda: self._freeze("launcher", 0.010, 2.0),
        }
        if time.monotonic() > self._next_kill_s:
            self._next_kill_s = time.monotonic() + BETWEEN_FRONT_KILLS_S
            self.record.faults["kill -9 of the front"] += 1
            os.kill(self.rig.pid("front"), signal.SIGKILL)
            return
        name = list(kinds)[self.random.integers(len(kinds))]
        self.record.faults[name] += 1
        kinds[name]()

    def _tell(self, *faults: str) -> None:
        for fault in faults:
            self.rig.befall(fault)

    def _freeze(self, target: str, least_s: float, most_s: float) -> None:
        from process_faults import frozen

        pid = self.rig.pid(target)
        if pid:
            with frozen(least_s, most_s)(self.rig, pid):
                pass

    # --- what is seen

    def _judge(self) -> None:
        """All true motion and every frame since the last time."""
        from fault_rig import WINDOW_S
        from observer import command_violations, frames_sent, motion_violations, stopped_joints

        truth = self.rig.truth()
        now_ns = min(int(joint.times_ns[-1]) for joint in truth.values())
        since_ns, remembered_ns = self._judged_ns - AGAIN_NS, now_ns - round(WINDOW_S * 1e9)
        found = []
        if since_ns < remembered_ns:  # what lies before looks like a standstill, and the way into motion like a jump
            found.append(f"{(remembered_ns - since_ns) * 1e-9:.0f} s are forgotten and were never judged")
            since_ns = remembered_ns
        # The wire's pieces may end amid a command: the one that is not whole yet is judged the next time.
        frames = frames_sent([piece for piece in self.rig.wire() if piece[0] >= since_ns])
        thrown = stopped_joints(self.rig.arm, frames)
        found += motion_violations(self.rig.arm, truth, since_ns, now_ns, thrown=thrown)
        found += command_violations(self.rig.arm, frames)
        at_s = time.monotonic() - self._began_s
        if found and self._evidence is not None:
            shutil.copy(self.rig.truth_file, self._evidence / f"violation-{at_s:.0f}.npz")
        self.record.violations += [f"at {at_s:.0f} s: {sentence}" for sentence in found]
        self._judged_ns = now_ns

    def _sample(self) -> None:
        from shm.histogram import percentiles_ns

        reader = self.rig.reader()
        if reader is None:
            return
        record = reader.memory.record
        pid = self.rig.pid("loop")
        now = {
            "lateness": record["lateness"].copy(),
            "cycles": int(record["counters"]["cycles"]),
            "overruns": int(record["counters"]["overruns"]),
        }
        since = now["lateness"].copy()
        before = self._before if self._before.get("pid") == pid else None
        if before:
            since["buckets"] = now["lateness"]["buckets"] - before["lateness"]["buckets"]
        p50, p99, p100 = (value / 1e3 for value in percentiles_ns(since, (50, 99, 100)))
        self.record.samples.append(
            Sample(
                time.monotonic() - self._began_s,
                {target: held(self.rig.pid(target)) for target in TARGETS if self.rig.pid(target)},
                shm_mb(),
                (p50, p99, p100),
                now["cycles"] - (before["cycles"] if before else 0),
                now["overruns"] - (before["overruns"] if before else 0),
            )
        )
        self._before = {**now, "pid": pid}


def held(pid: int) -> dict[str, float]:
    """What a process holds, as the kernel tells it."""
    try:
        memory = dict(line.split()[:2] for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:])
        status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        return {
            "pid": pid,
            "own_mb": int(memory["Private_Dirty:"]) / 1024,  # what others share changes with them
            "pss_mb": int(memory["Pss:"]) / 1024,
            "rss_mb": int(memory["Rss:"]) / 1024,
            "files": len(os.listdir(f"/proc/{pid}/fd")),
            "threads": int(status["Threads"]),
        }
    except OSError:
        return {}


def shm_mb() -> float:
    """What /dev/shm holds."""
    status = os.statvfs("/dev/shm")
    return (status.f_blocks - status.f_bfree) * status.f_frsize / 2**20


def slope_per_hour(times_s: Sequence[float], values: Sequence[float]) -> tuple[float, float] | None:
    """Least-squares slope of the lowest of each block and half its 95 % interval; None for too little.

    Blocks, since neighbouring samples are not independent of each other; the lowest, since what is given back in
    between does not leak: a simulated arm that writes its truth down holds 10 MB more for a while.
    """
    from scipy.stats import linregress, t

    if len(times_s) < 3 * BLOCKS:
        return None
    at = [float(np.mean(block)) / 3600 for block in np.array_split(np.array(times_s), BLOCKS)]
    lowest = [float(np.min(block)) for block in np.array_split(np.array(values), BLOCKS)]
    fit = linregress(at, lowest)
    return float(fit.slope), float(np.nan_to_num(fit.stderr) * t.ppf(0.975, BLOCKS - 2))


def pooled_slope_per_hour(lives: Sequence[tuple[Sequence[float], Sequence[float]]]) -> tuple[float, float] | None:
    """The slope that several lives of a process have in common, each about its own mean, and half its 95 % interval.

    The interval is of the lives (each one independent of the others), not of their samples; None for too few.
    """
    from scipy.stats import t

    if len(lives) < FEWEST_LIVES:
        return None
    centred = [(np.array(at) / 3600 - np.mean(at) / 3600, np.array(values) - np.mean(values)) for at, values in lives]
    weight = sum(float(at @ at) for at, _ in centred)
    slope = sum(float(at @ values) for at, values in centred) / weight
    spread = math.sqrt(sum(float(at @ (values - slope * at)) ** 2 for at, values in centred)) / weight
    return slope, spread * float(t.ppf(0.975, len(lives) - 1))


def lives(samples: Sequence[Sample], target: str) -> list[tuple[int, list[Sample]]]:
    """The samples of each process that served as target, after its warm-up."""
    by_pid: dict[int, list[Sample]] = defaultdict(list)
    for sample in samples:
        if sample.of.get(target):
            by_pid[int(sample.of[target]["pid"])].append(sample)
    return [
        (pid, [sample for sample in found if sample.at_s - found[0].at_s >= WARM_UP_S]) for pid, found in by_pid.items()
    ]


def growth(samples: Sequence[Sample]) -> tuple[list[str], list[str]]:
    """Rows of a table of slopes, and sentences about leaks."""
    rows, leaks = [], []

    def judge(what: str, unit: str, times_s: list[float], values: list[float], bound: float) -> None:
        tell(what, unit, slope_per_hour(times_s, values), values, bound)

    def tell(what: str, unit: str, found: tuple[float, float] | None, values: list[float], bound: float) -> None:
        if found is None:
            return
        slope, half = found
        leak = slope - half > bound
        rows.append(
            f"| {what} | {unit} | {values[0]:.1f} → {values[-1]:.1f} | {slope:+.2f} ± {half:.2f} | {bound:g} | "
            f"{'**grows**' if leak else 'flat'} |"
        )
        if leak:
            leaks.append(f"{what}: {unit} grows by {slope:.2f} ± {half:.2f} an hour, allowed {bound:g}")

    for target in TARGETS:
        for pid, found in lives(samples, target):
            times_s = [sample.at_s for sample in found]
            for unit, bound in BOUNDS_PER_HOUR.items():
                judge(f"{target} ({pid})", unit, times_s, [sample.of[target][unit] for sample in found], bound)
        short = [found for _, found in lives(samples, target) if len(found) >= FEWEST_SAMPLES]
        for unit, bound in BOUNDS_PER_HOUR.items():
            series = [([s.at_s for s in found], [s.of[target][unit] for s in found]) for found in short]
            values = [value for _, of_one in series for value in of_one]
            found_slope = pooled_slope_per_hour(series)
            tell(f"{target} ({len(series)} lives)", unit, found_slope, values, bound * SHORT_LIVES_MAY)
    steady = [sample for sample in samples if sample.at_s > WARM_UP_S]
    judge("/dev/shm", "MB", [s.at_s for s in steady], [s.shm_mb for s in steady], SHM_BOUND_MB_PER_HOUR)
    judge("lateness p99", "µs", [s.at_s for s in steady], [s.lateness_us[1] for s in steady], math.inf)
    return rows, leaks


def report(record: Record, minutes: float, seed: int, hangs: Sequence[str]) -> tuple[str, bool]:
    """The report in markdown, and whether all is well."""
    rows, leaks = growth(record.samples)
    wrong = [*hangs, *record.violations, *leaks]
    lines = [
        f"# Soak of {minutes:g} minutes, seed {seed}: {'passed' if not wrong else 'FAILED'}",
        "",
        *(f"- {sentence}" for sentence in wrong or ["no violation, no hang, nothing grows"]),
        "",
        "| what | unit | first → last | slope an hour (95 %) | allowed | verdict |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        "| minute | sim MB (own / PSS) | loop MB | front MB | launcher MB | files s/l/f/la | threads s/l/f/la | "
        "/dev/shm MB | lateness p50 / p99 / max µs | cycles | missed |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for chunk in np.array_split(np.array(record.samples, dtype=object), min(20, max(1, len(record.samples)))):
        if not len(chunk):
            continue
        last = chunk[-1]
        held_now = [last.of.get(target) for target in TARGETS]
        memory = [f"{now['own_mb']:.1f} / {now['pss_mb']:.0f}" if now else "–" for now in held_now]
        counts = ["/".join(f"{now[unit]:.0f}" if now else "–" for now in held_now) for unit in ("files", "threads")]
        late = " / ".join(
            f"{value:.0f}"
            for value in (
                np.median([s.lateness_us[0] for s in chunk]),
                np.median([s.lateness_us[1] for s in chunk]),
                max(s.lateness_us[2] for s in chunk),
            )
        )
        cycles, missed = sum(s.cycles for s in chunk), sum(s.missed for s in chunk)
        lines.append(
            f"| {last.at_s / 60:.1f} | {' | '.join([*memory, *counts])} | {last.shm_mb:.1f} | {late} | {cycles} | "
            f"{missed} |"
        )
    for title, counter in (("Results", record.results), ("Faults", record.faults), ("Ways back", record.ways_back)):
        lines += ["", f"{title}: {sum(counter.values())}", ""]
        lines += [f"- {count} × {what}" for what, count in counter.most_common()]
    return "\n".join(lines) + "\n", not wrong


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--report", type=Path, help="file for the report (markdown); beside it, the true motion around each violation"
    )
    options = parser.parse_args(arguments)
    begin_again("soak", arguments)
    own_ros_domain()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    from fault_rig import Hang, Rig

    record, hangs = Record(), []
    with tempfile.TemporaryDirectory(prefix="rtarm-soak-", ignore_cleanup_errors=True) as name, small_home(Path(name)):
        rig = Rig(f"t{secrets.token_hex(4)}", Path(name), np.random.default_rng(options.seed))
        try:
            rig.start_arm()
            rig.make_ready()
            Soak(rig, record, options.report.absolute().parent if options.report else None).run(60.0 * options.minutes)
            guardian.doing("the end of the soak")
            rig.make_ready()
            record.violations += rig.stop_control()
        except (Hang, AssertionError) as problem:
            hangs.append(f"hang: {problem}")
        finally:
            record.violations += rig.end()
    text, well = report(record, options.minutes, options.seed, hangs)
    print(text)
    if options.report is not None:
        options.report.write_text(text, encoding="utf-8")
    return int(not well)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
