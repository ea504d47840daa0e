"""What a cycle's cost grows with: joints, waypoints, its own histograms, other arms on the machine.

The first three are computing time in virtual time, without a system call, as in bench_cycle.py; sizes alternate, so
that a noisy neighbour hits all alike, and medians are compared. The last one is real control processes on mock wires at
1 kHz: one to four of them, the others stopped meanwhile, in alternating slices, with slices of cyclictest alone.
"""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cyclictest
import numpy as np
import pytest
import yaml
from many_cycles import HEARTBEAT, Recording, RecordingArm, swing
from virtual import VirtualArm

from compilation.jit import jit
from config.budget import check_budget
from config.loader import ARMS_FOLDER, load_arm
from config.schema import ArmConfig
from rtloop.cycle import step
from rtloop.process.run import monotonic_ns, record
from rtloop.trajectory.phases import running_goal
from shm.atomics import store_relaxed
from shm.errors import RingFull
from shm.histogram import upper_ns
from shm.layout import MAX_JOINTS
from shm.words import Entry, Outcome

PERCENTS = (50, 99, 99.9)
NS = 1_000_000_000


# --- joints ---------------------------------------------------------------------------------------------

JOINTS = (1, 2, 4, 6, 8, 16, MAX_JOINTS)
JOINTS_HZ = 20
"""What a bus carries the most joints with; the cost of a cycle does not depend on its rate."""
JOINTS_ROUNDS = 15


def arm_of(joints: int, drives: str, folder: Path) -> ArmConfig:
    """An arm of so many joints, those of episode1 in turn, with `zdt` or `mock` drives."""
    values = yaml.safe_load((ARMS_FOLDER / ("episode1.yaml" if drives == "zdt" else "mock.yaml")).read_text("utf-8"))
    values.pop("kinematics", None)  # of six joints, as the place to go after homing
    values.get("homing", {}).pop("then", None)
    rows = [dict(values["joints"][i % len(values["joints"])]) for i in range(joints)]
    for i, row in enumerate(rows):
        row["name"] = f"joint{i + 1}"
        row["drive"] = {**row["drive"], **({"address": i + 1} if drives == "zdt" else {})}
    values |= {"name": f"{drives}{joints}", "joints": rows}
    values["control"]["rate_hz"] = JOINTS_HZ
    if drives == "zdt":
        values["bus"]["serial_baud"] = "cdc"
    path = folder / f"{values['name']}.yaml"
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    arm = load_arm(path)
    check_budget(arm)
    return arm


def recorded_swing(arm: RecordingArm) -> Recording:
    """All joints to and fro, for eight seconds."""
    if arm.sim is not None:
        arm.sim.adapter._depth = 4 * MAX_JOINTS  # the usual 64 frames are those of a cycle of 21 drives
    assert arm.bring_up().failure is None
    t = np.arange(81) * 0.1
    w = 2 * np.pi / 4.0
    shape = 0.05 * np.stack([1 - np.cos(w * t), w * np.sin(w * t), w * w * np.cos(w * t)], axis=-1)
    shape[-1, 1:] = 0.0
    joints = np.repeat(shape[:, None, :], len(arm.arm.joints), axis=1)
    joints[:, :, 0] += arm.loop[0]["axes"]["commanded"]["next_position_rad"][: len(arm.arm.joints)]
    return Recording(arm, arm.send_goal((t * 1e9).astype(int), joints))


@pytest.mark.parametrize("drives", ["zdt", "mock"])
def test_joints(benchmark, report, tmp_path, drives):
    counts = JOINTS if drives == "mock" else JOINTS[:-1]  # a serial adapter does not hold back the frames of more
    recordings = {count: recorded_swing(RecordingArm(arm_of(count, drives, tmp_path))) for count in counts}
    cost_us: dict[int, list[float]] = {count: [] for count in counts}

    def play_all():
        for count, recording in recordings.items():
            cost_us[count].append(recording.median_us())

    benchmark.pedantic(play_all, rounds=JOINTS_ROUNDS)
    for recording in recordings.values():
        assert recording.arm.outcome(recording.goal) == Outcome.SUCCEEDED
        recording.arm.close()
    medians = np.array([np.median(cost_us[count]) for count in counts])
    slope, base = np.polyfit(counts, medians, 1)
    off = medians / (base + slope * np.array(counts)) - 1
    benchmark.extra_info.update(
        {"p50_us": {count: cost_us[count] for count in counts}, "us_a_joint": slope, "us_without_joints": base}
    )
    report(f"a cycle of {drives} joints executing a goal", f"p50, median of {JOINTS_ROUNDS} rounds (least to most)")
    for count, median, away in zip(counts, medians, off, strict=True):
        report(
            f"  {count} {'joint' if count == 1 else 'joints'}",
            f"{median:.2f} ({min(cost_us[count]):.2f} to {max(cost_us[count]):.2f}) µs, {away:+.0%} of the line",
        )
    steps = np.diff(medians) / np.diff(counts)
    report(
        "  line through all (aim: linear)",
        f"{base:.2f} µs + {slope:.3f} µs a joint; from size to size {', '.join(f'{one:.3f}' for one in steps)}",
    )


# --- waypoints ----------------------------------------------------------------------------------------------

WAYPOINTS = (10, 100, 1000, 10_000, 100_000, 1_000_000)
FEWEST_CYCLES = 5000
BATCH = 500


@jit
def timed_cycles(
    loop: Any, shared: Any, start_ns: int, heartbeat: int, clock: int, durations_ns: np.ndarray, goal: int
) -> int:
    """One cycle after the other; the time of each `step` that executes `goal`, -1 for others. The last one's time."""
    now_ns = start_ns
    for i in range(len(durations_ns)):
        now_ns += loop.params.period_ns
        store_relaxed(heartbeat, now_ns)
        before_ns = monotonic_ns(clock)
        step(loop, shared, now_ns)
        durations_ns[i] = monotonic_ns(clock) - before_ns if running_goal(loop) == goal else -1
        loop.buses[0].outgoing.length = 0
    return now_ns


def waypoints_of(count: int, period_s: float, home: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Times (ns) and joints (6, 3) of `count` waypoints, one a cycle: all joints to and fro, at rest at both ends."""
    end_s = (count - 1) * period_s
    w = 2 * np.pi * max(1, round(end_s / 4.0)) / end_s
    size = min(0.05, 0.3 / w**2)
    joints = np.zeros((6, 3))
    for number in range(count):
        phase = w * number * period_s
        moves = number < count - 1
        joints[:, 0] = home + size * (1 - np.cos(phase))
        joints[:, 1] = size * w * np.sin(phase) * moves
        joints[:, 2] = size * w * w * np.cos(phase)
        yield round(number * period_s * NS), joints


def play_waypoints(arm: VirtualArm, count: int, kept: np.ndarray) -> int:
    """Execute a goal of so many waypoints, fed as the ring has room.

    The computing time (ns) of each cycle that executed it goes to `kept`, which is long enough; how many there were.
    """
    clock, durations, filled = np.zeros(2, np.int64), np.zeros(BATCH, np.int64), 0
    home = arm.loop[0]["axes"]["commanded"]["next_position_rad"][:6].copy()
    goal, none, consumed = arm.writer.announced_goal + 1, np.zeros((6, 3)), arm.reader.setpoints_consumed
    arm.writer.announce(goal)
    arm.writer.begin(
        goal,
        start_ns=0,
        joint_mask=63,
        goal_time_s=0.4,
        entry=Entry(0),
        epoch=int(arm.memory["goals"]["epoch"]),
        tolerances=none,
        consumed=consumed(),
    )

    def cycles() -> None:
        nonlocal filled
        arm.now_ns = timed_cycles(
            arm.loop[0],
            arm.state.array[0],
            arm.now_ns,
            arm.command.address + HEARTBEAT,
            clock.ctypes.data,
            durations,
            goal,
        )
        executing = durations[durations >= 0]
        kept[filled : filled + len(executing)] = executing
        filled += len(executing)

    def write(record_: Any) -> None:
        while True:
            try:
                return record_()
            except RingFull:
                cycles()

    for at_ns, joints in waypoints_of(count, arm.period_ns / NS, home):
        write(lambda at_ns=at_ns, joints=joints: arm.writer.waypoint(goal, at_ns, 5, joints, consumed()))
    write(lambda: arm.writer.end(goal, none, consumed()))
    while arm.outcome(goal) == Outcome.NONE:
        cycles()
    assert arm.outcome(goal) == Outcome.SUCCEEDED
    return filled


def resident_kb() -> int:
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024


@pytest.mark.timeout(300)
def test_waypoints(benchmark, report):
    """A cycle of a long goal takes in as many waypoints as it uses up; a short one's are all taken at its beginning."""
    arm = VirtualArm("mock")
    assert arm.bring_up().failure is None
    kept = np.ones(WAYPOINTS[-1] + 10 * BATCH, np.int64)  # touched: what grows afterwards is not this
    play_waypoints(arm, FEWEST_CYCLES, kept)
    found: dict[int, np.ndarray] = {}
    resident: dict[int, tuple[int, int]] = {}

    def play():
        for count in WAYPOINTS:
            before, filled = resident_kb(), 0
            for _ in range(max(1, FEWEST_CYCLES // count)):
                filled += play_waypoints(arm, count, kept[filled:])
            resident[count] = before, resident_kb()
            found[count] = kept[:filled].copy()

    benchmark.pedantic(play, rounds=1)
    arm.close()
    report(
        "a cycle of 6 mock joints, one waypoint a cycle",
        "computing time over the whole goal, resident memory before, after",
    )
    for count, durations in found.items():
        p50, p99, p999 = np.percentile(durations, PERCENTS) / 1000
        benchmark.extra_info[f"{count}"] = {
            "cycles": len(durations),
            "p50_us": p50,
            "p99_us": p99,
            "p99_9_us": p999,
            "resident_kb": resident[count],
        }
        before, after = resident[count]
        report(
            f"  {count:,} waypoints",
            f"p50 {p50:.2f}, p99 {p99:.2f}, p99.9 {p999:.2f} µs ({len(durations)} cycles); {before} → {after} kB",
        )
    tenth = len(found[WAYPOINTS[-1]]) // 10
    first, last = (float(np.median(part)) / 1000 for part in np.split(found[WAYPOINTS[-1]], [tenth, 9 * tenth])[::2])
    benchmark.extra_info["longest"] = {"first_tenth_us": first, "last_tenth_us": last}
    report("  first and last tenth of the longest", f"p50 {first:.2f} and {last:.2f} µs")


# --- histograms -----------------------------------------------------------------------------------------

RECORDS, BLOCKS, BLOCK = 10_000, 100, 200


@jit
def record_many(histogram: Any, values_ns: np.ndarray) -> None:
    for value_ns in values_ns:
        record(histogram, value_ns)


@jit
def cycles_recorded(
    loop: Any, shared: Any, start_ns: int, heartbeat: int, clock: int, values_ns: np.ndarray, recording: int
) -> int:
    """One cycle a value; each value goes to both histograms, or to none. How long all that took."""
    now_ns = start_ns
    before_ns = monotonic_ns(clock)
    for value_ns in values_ns:
        now_ns += loop.params.period_ns
        store_relaxed(heartbeat, now_ns)
        if recording == 1:
            record(shared.lateness, value_ns)
        step(loop, shared, now_ns)
        loop.buses[0].outgoing.length = 0
        if recording == 1:
            record(shared.cycle_time, value_ns)
    return monotonic_ns(clock) - before_ns


def latenesses(count: int) -> np.ndarray:
    """Durations such as a cycle's, ns."""
    return np.random.default_rng(0).lognormal(np.log(15_000), 0.7, count).astype(np.int64)


def test_histograms(benchmark, report):
    arm = VirtualArm("mock")
    assert arm.bring_up().failure is None
    swing(arm, duration_s=(2 * BLOCKS + 10) * BLOCK / 100, spacing_s=0.2)
    clock, values, took = np.zeros(2, np.int64), latenesses(BLOCK), {0: [], 1: []}

    def block(recording: int) -> int:
        took_ns = cycles_recorded(
            arm.loop[0],
            arm.state.array[0],
            arm.now_ns,
            arm.command.address + HEARTBEAT,
            clock.ctypes.data,
            values,
            recording,
        )
        arm.now_ns += BLOCK * arm.period_ns
        return took_ns

    for recording in (0, 1):
        block(recording)
    for turn in range(2 * BLOCKS):
        took[turn % 2].append(block(turn % 2) / BLOCK)
    many = latenesses(RECORDS)
    record_many(arm.state.array[0]["lateness"], many)
    benchmark(record_many, arm.state.array[0]["lateness"], many)
    arm.close()
    alone_ns = benchmark.stats.stats.median / RECORDS * 1e9
    without, with_them = (float(np.median(took[recording])) for recording in (0, 1))
    ratios = np.array(took[1]) / np.array(took[0])
    benchmark.extra_info.update(record_ns=alone_ns, cycle_without_ns=without, cycle_with_ns=with_them)
    report("one duration counted in a histogram", f"{alone_ns:.1f} ns; a cycle counts two")
    report(
        "  a cycle of 6 mock joints without, with both",
        f"{without:.0f}, {with_them:.0f} ns; ratio {np.median(ratios):.3f} "
        f"({np.percentile(ratios, 25):.3f} to {np.percentile(ratios, 75):.3f}, {BLOCKS} pairs of {BLOCK} cycles)",
    )


# --- arms -----------------------------------------------------------------------------------------------

ARMS, ARMS_HZ, ARMS_ROUNDS = 4, 1000.0, 4
SLICE_S, SETTLE_S = 3, 0.5


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(300)
def test_arms(benchmark, report, tmp_path):
    pytest.importorskip("rclpy")
    pytest.importorskip("control_msgs")
    from live import Usage, live

    from rtarm.running.tracking import Window

    late: dict[int, list[np.ndarray]] = {count: [] for count in range(ARMS + 1)}
    share: dict[int, list[float]] = {count: [] for count in range(ARMS + 1)}
    missed = dict.fromkeys(range(ARMS + 1), 0)

    def slice_with(stacks: list) -> None:
        time.sleep(SETTLE_S)
        windows = [Window(stack.reader) for stack in stacks]
        before, begun = [Usage(stack.loop).processor_s for stack in stacks], time.monotonic()
        time.sleep(SLICE_S)
        passed = time.monotonic() - begun
        for stack, window, used in zip(stacks, windows, before, strict=True):
            histogram = window.histogram("lateness")
            buckets = np.flatnonzero(histogram["buckets"])
            values = [upper_ns(int(bucket)) / 1000 for bucket in buckets]
            late[len(stacks)].append(np.stack([values, histogram["buckets"][buckets]], axis=1))
            share[len(stacks)].append(100 * (Usage(stack.loop).processor_s - used) / passed)
            missed[len(stacks)] += int(window.counters()[0]["overruns"])

    def measure():
        with ExitStack() as everything:
            stacks = []
            for number in range(ARMS):
                folder = tmp_path / str(number)
                folder.mkdir()
                stacks.append(everything.enter_context(live(folder, mock_hz=ARMS_HZ, front=False)))
            for _ in range(ARMS_ROUNDS):
                for stack in stacks:
                    stack.loop.process.send_signal(signal.SIGSTOP)
                if cyclictest.installed():
                    alone = cyclictest.Cyclictest(priority=80, period_us=round(1e6 / ARMS_HZ), seconds=SLICE_S)
                    alone.end()
                    late[0].append(alone.late_us)
                for count in range(1, ARMS + 1):
                    stacks[count - 1].loop.process.send_signal(signal.SIGCONT)
                    slice_with(stacks[:count])

    benchmark.pedantic(measure, rounds=1)
    report(
        f"arms at {ARMS_HZ:g} Hz, mock wire, {os.cpu_count()} processors: lateness of all",
        f"{ARMS_ROUNDS} slices of {SLICE_S} s each",
    )
    if not late[0]:
        report("  cyclictest", cyclictest.ABSENT)
    for count, tables in late.items():
        if not tables:
            continue
        figures = cyclictest.percentiles_us(np.concatenate(tables), *PERCENTS)
        tails = [cyclictest.percentiles_us(table, 99.9)["p99.9"] for table in tables]
        cycles = round(sum(table[:, 1].sum() for table in tables))
        words = ", ".join(f"{name} {value:.0f}" for name, value in figures.items())
        benchmark.extra_info[f"{count} arms"] = {**figures, "p99_9_of_slices": tails, "core_percent": share[count]}
        used = f"; {np.mean(share[count]):.1f} % of a core each; {missed[count]} cycles missed" if count else ""
        report(
            f"  {count} {'arm' if count == 1 else 'arms'}" if count else "  cyclictest alone, same priority",
            f"{words} µs ({cycles}); p99.9 of single slices {min(tails):.0f} to {max(tails):.0f}{used}",
        )
