"""Every link between a client and the bus, measured in the same run: real processes, the simulated arm behind its PTY.

What each link begins and ends with:

- *due* is the planned time of a cycle, which its snapshot tells. From there to the wake-up and on to the end of the
  write are the control process' own histograms, which hold every cycle. (A missed cycle has no snapshot and sends
  nothing; how long it was missed is in the first of them.) When a cycle's last command has been read by
  the simulated adapter is what the adapter itself notes, so its Python process and the pseudo-terminal count.
- *in the reader thread* is the time that this thread gave to the bytes with which a joint's reading came. Until a cycle
  takes them they wait, up to one period; how long is a matter of when the drives answer.
- *published* is when a compiled onlooker (bench/watch.py) finds the snapshot complete. It runs below the control
  process' priorities, so it is late rather than early.
- *at a subscriber*: the middleware's reception time, and the moment at which a Python callback in this process, which
  does all of the above as well, has the message.
- *send_goal → first changed command*, of short goals before all that: the first that differs by a pulse; the faster the
  cycle, the less a first setpoint moves. bench_goal_latency.py says more.
"""

import random
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from bench_goal_latency import GOAL_S, Goal, first_changed_ns
from bench_joint_states import Listener
from live import (
    FASTEST_BUS,
    NAMES,
    LiveStack,
    Settings,
    commanded_rad,
    goal_to,
    highest_hz,
    in_words,
    live,
    percentiles,
)
from ros_client import SUCCEEDED, until
from watch import Watcher

from config.loader import load_arm
from rtarm.running.tracking import Window
from shm.histogram import percentiles_ns
from shm.words import Fault, Mode

WINDOW_S = 30.0
GOALS = 40
PERCENTS = (50, 99, 99.9)
AWAY_RAD = 0.25
TRIES = 3


class GoalEnded(Exception):
    """The goal whose execution was to be watched ended; the text says with what."""


def epoch_offset_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


def read_by_adapter_ns(commands: np.ndarray, a_due_ns: int, period_ns: int, begun_ns: int, ended_ns: int) -> np.ndarray:
    """From due until the adapter had read the last command, of each cycle between two moments, (cycles,).

    Each cycle sends one command a joint and keeps the phase of all others. Of commands read late, the one of the
    newest cycle that was due is told by time, those before it by counting back.
    """
    times_ns = commands[commands[:, 1] == commands[:, 1].max(), 0]
    times_ns = times_ns[(times_ns > begun_ns) & (times_ns < ended_ns)]
    cycles = (times_ns - a_due_ns) // period_ns
    for i in range(len(cycles) - 2, -1, -1):
        cycles[i] = min(cycles[i], cycles[i + 1] - 1)
    return times_ns - a_due_ns - cycles * period_ns


def of_histogram(window: Window, name: str) -> tuple[int, dict[str, float]]:
    """Count and percentiles (ms) of one of the control process' histograms."""
    histogram = window.histogram(name)
    values = percentiles_ns(histogram, [*PERCENTS, 100])
    return int(histogram["count"]), {
        name: value / 1e6 for name, value in zip([*(f"p{p:g}" for p in PERCENTS), "max"], values, strict=True)
    }


def of_values(values_ns: np.ndarray) -> tuple[int, dict[str, float]]:
    return len(values_ns), percentiles(values_ns / 1e6, *PERCENTS)


def play_goals(stack: LiveStack, period_s: float) -> list[Goal]:
    """Short brisk goals to and fro at random moments of the cycle; those that succeeded."""
    home, goals = commanded_rad(stack), []
    accelerations = np.array([joint.max_acceleration_rad_s2 for joint in load_arm(stack.arm_file).joints])
    for turn in range(GOALS):
        target = home - (0.0 if turn % 2 else accelerations * GOAL_S**2 / 6)
        time.sleep(0.05 + random.random() * 2 * period_s)
        goal = Goal(sent_ns=time.monotonic_ns())
        if stack.client.run(goal_to(target, GOAL_S))[0] == SUCCEEDED:
            goals.append(goal)
    return goals


def still_executing(stack: LiveStack) -> None:
    """Raises GoalEnded when it does not."""
    last = stack.reader.snapshot()
    if last["mode"] != Mode.EXECUTING:
        counters = stack.reader.memory.record["counters"]
        raise GoalEnded(
            f"{Mode(int(last['mode'])).name}, fault {Fault(int(last['fault'])).name}; so far "
            f"{counters['overruns']} cycles missed, {counters['stale_reads']} with a reading too old"
        )


def measure(folder: Path, rate_hz: float, settings: Settings) -> SimpleNamespace:
    """What one arm, its client and the onlooker saw. Raises GoalEnded when the goal did not last."""
    found = SimpleNamespace()
    with live(folder, settings=settings) as stack:
        found.goals = play_goals(stack, 1 / rate_hz)
        found.heard = Listener(stack.client.node, "joint_states")
        until(lambda: found.heard.heard, "a message")
        watcher = Watcher(stack, round(WINDOW_S * rate_hz))
        stack.client.send(goal_to(commanded_rad(stack) - AWAY_RAD, WINDOW_S + 6.0))
        until(lambda: stack.reader.snapshot()["mode"] != Mode.HOLDING, "motion")
        time.sleep(1.0)
        still_executing(stack)
        offset_ns, found.begun_ns, window = epoch_offset_ns(), time.monotonic_ns(), Window(stack.reader)
        watcher.start()
        found.rows = watcher.rows
        found.ended_ns, found.counters = time.monotonic_ns(), window.counters()[0]
        found.histograms = {name: of_histogram(window, name) for name in ("lateness", "cycle_time")}
        found.offset_ns = (offset_ns + epoch_offset_ns()) // 2
        still_executing(stack)
        time.sleep(0.2)  # the last messages
        found.commands = stack.commands()
    return found


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(400)
@pytest.mark.parametrize("speed", ["120", "highest"])
def test_chain(benchmark, report, tmp_path, speed):
    highest = speed == "highest"
    rate_hz = highest_hz(FASTEST_BUS) if highest else 120.0
    settings = {"control": {"rate_hz": rate_hz}, **({"bus": FASTEST_BUS} if highest else {})}

    ended: list[str] = []

    def measure_patiently() -> SimpleNamespace:
        while True:
            try:
                return measure(tmp_path, rate_hz, settings)
            except GoalEnded as reason:
                ended.append(str(reason))
                if len(ended) == TRIES:
                    raise

    seen = benchmark.pedantic(measure_patiently, rounds=1)
    rows, heard, offset_ns, commands = seen.rows, seen.heard, seen.offset_ns, seen.commands
    arrived_ns = rows["arrived_ns"][:, : len(NAMES)]
    fresh = np.diff(arrived_ns, axis=0, prepend=arrived_ns[:1]) != 0
    due_ns, seen_ns = (np.broadcast_to(rows[name][:, None], fresh.shape) for name in ("due_ns", "seen_ns"))

    row_of = {stamp: row for row, stamp in enumerate(rows["stamp_ns"].tolist())}
    matched = [
        (row_of[stamp], received - offset_ns, called - offset_ns)
        for stamp, received, called in heard.heard
        if stamp in row_of
    ]
    at, received_ns, called_ns = np.array(matched).T
    published_ns = rows["seen_ns"][at]

    links = {
        "due → woke up": seen.histograms["lateness"],
        "woke up → end of the write": seen.histograms["cycle_time"],
        "due → snapshot published": of_values(rows["seen_ns"] - rows["due_ns"]),
        "due → last command read by the adapter": of_values(
            read_by_adapter_ns(commands, int(rows["due_ns"][0]), round(1e9 / rate_hz), seen.begun_ns, seen.ended_ns)
        ),
        "in the reader thread → due cycle": of_values((due_ns - arrived_ns)[fresh]),
        "in the reader thread → snapshot published": of_values((seen_ns - arrived_ns)[fresh]),
        "published → /joint_states received": of_values(received_ns - published_ns),
        "published → /joint_states in a callback": of_values(called_ns - published_ns),
        "send_goal → first changed command": of_values(
            np.array([first_changed_ns(commands, goal) - goal.sent_ns for goal in seen.goals])
        ),
    }
    overruns = int(seen.counters["overruns"])
    report(
        f"the whole chain at {rate_hz:g} Hz, executing {WINDOW_S:g} s",
        f"{overruns} cycles missed, {unseen(rows)} not seen by the onlooker",
    )
    for reason in ended:
        report("  an earlier try, whose goal ended", reason)
    benchmark.extra_info.update(rate_hz=rate_hz, overruns=overruns, unseen_cycles=unseen(rows), ended_before=ended)
    for what, (count, figures) in links.items():
        benchmark.extra_info[what] = {"count": count, **figures}
        report(f"  {what}", f"{in_words(figures, 3)} ms ({count})")


def unseen(rows: np.ndarray) -> int:
    """Cycles that the onlooker missed."""
    return int(rows["cycle"][-1] - rows["cycle"][0]) + 1 - len(rows)
