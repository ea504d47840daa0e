"""The long run: does the cycle fault, allocate, wait or miss anything once it is warm, and whose fault was it?

RTARM_STEADY_S says for how many seconds each of the two arms is watched (60; what is published took 600): a mock arm at
1 kHz, and the simulated arm behind its pseudo-terminal at 200 Hz. A client has goals executed, one after the other.
Control process, front and all else are ours and as they always are, only that the cycle is bound to one processor,
which cyclictest and a witness of ours (bench/witness.py) share with it, one priority below.

A missed cycle counts as explained when the witness, which needs nothing of ours, overslept by half a period or more at
that very moment. It would also oversleep if the cycle itself used the processor for so long, so it is said how many
cycles took half a period from wake-up to the end of their write: each may be our own doing, or a stall in its midst.
Beside it stands at how many of the missed cycles cyclictest overslept, too. That no cycle allocates is proven in
tests/rtloop/test_no_interpreter.py.
"""

import os
import threading
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import cyclictest
import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from live import FASTEST_BUS, LiveStack, Usage, commanded_rad, goal_to, in_words, live
from ros_client import SUCCEEDED
from stack import Process

from rtarm.running.requests import clear_fault
from rtarm.running.tracking import Window
from rtarm.why_late.watch import stolen_ns
from shm.histogram import percentiles_ns, upper_ns
from shm.words import Mode

STEADY_S = int(os.environ.get("RTARM_STEADY_S", "60"))
WARM_S = 10.0
GOAL_S = 5.0
AWAY_RAD = 0.2
PATIENCE_S = 30.0
PERCENTS = (50, 99, 99.9, 99.99)
JOINT_STATES_HZ = 100
COUNTS = ("minor_faults", "major_faults", "involuntary", "voluntary")


def threads_of(process: Process) -> dict[int, dict[str, int]]:
    """What the kernel has counted of each thread, by its id; `priority` is 0 for those without a real-time one."""
    found = {}
    for task in Path(f"/proc/{process.process.pid}/task").iterdir():
        stat = (task / "stat").read_text().rpartition(")")[2].split()
        status = dict(line.split(":", 1) for line in (task / "status").read_text().splitlines())
        found[int(task.name)] = {
            "priority": int(stat[37]),
            "minor_faults": int(stat[7]),
            "major_faults": int(stat[9]),
            "involuntary": int(status["nonvoluntary_ctxt_switches"]),
            "voluntary": int(status["voluntary_ctxt_switches"]),
        }
    return found


def counted(before: dict, after: dict, chosen: list[int]) -> dict[str, int]:
    """What was counted of some threads between two looks."""
    return {name: sum(after[task][name] - before[task][name] for task in chosen) for name in COUNTS}


class Player:
    """A client that sends one goal after the other, to and fro, and asks nothing else of the machine."""

    def __init__(self, stack: LiveStack) -> None:
        self.ended: Counter[str] = Counter()
        """What goals ended with; an empty string for success."""
        self._stack, self._home = stack, commanded_rad(stack)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def _wait(self, future):
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(PATIENCE_S), "the front does not answer"
        return future.result()

    def _play(self) -> None:
        turn = 0
        while not self._stop.is_set():
            goal = goal_to(self._home - (turn % 2 == 0) * AWAY_RAD, GOAL_S)
            handle = self._wait(self._stack.client.action.send_goal_async(goal))
            answer = self._wait(handle.get_result_async())
            self.ended["" if answer.status == SUCCEEDED else answer.result.error_string] += 1
            if self._stack.reader.snapshot()["mode"] == Mode.FAULT:
                clear_fault(self._stack.name)
            turn += 1


def overlapping(missed: np.ndarray, late: np.ndarray, slack_ns: int) -> np.ndarray:
    """Which missed cycles fall into an interval of `late`, (n, 2); the look before may already be in the stall."""
    return np.array(
        [bool(np.any((late[:, 1] > row["since_ns"] - slack_ns) & (late[:, 0] < row["until_ns"]))) for row in missed],
        bool,
    )


def measure(folder: Path, cpu: int, mock_hz: float | None, settings: dict) -> SimpleNamespace:
    """A steady arm, watched."""
    found = SimpleNamespace(cyclic=None)
    with live(folder, mock_hz=mock_hz, settings=settings) as stack:
        header, scheduling = (stack.reader.memory.record[name] for name in ("header", "scheduling"))
        found.period_ns, priority = int(header["period_ns"]), int(scheduling["priority"])
        if priority < 2:
            pytest.skip("no real-time priority was given to the control process: `rtarm doctor` says why")
        player = Player(stack)
        phase_ns = stack.reader.snapshot()["monotonic_ns"] % found.period_ns + found.period_ns // 4
        witnessed = folder / "witness.npz"
        beside = ["bench.witness", str(stack.reader.memory.path), priority - 1, cpu, found.period_ns // 2]
        witness = Process(*map(str, [*beside, phase_ns % (found.period_ns // 2), STEADY_S + 1, witnessed]))
        closers = [witness.close, player.close]
        try:
            witness.line_with("ready")
            time.sleep(WARM_S)
            witness.say("begin")
            if cyclictest.installed():
                found.cyclic = cyclictest.Cyclictest(
                    priority=priority - 1,
                    period_us=found.period_ns // 1000,
                    seconds=STEADY_S + 1,
                    cpu=cpu,
                    spike_us=found.period_ns // 4000,
                )
                closers.append(found.cyclic.close)
            found.usage, found.threads, stolen = [Usage(stack.loop)], [threads_of(stack.loop)], stolen_ns(cpu)
            window, found.begun_ns = Window(stack.reader), time.monotonic_ns()
            time.sleep(STEADY_S)
            found.usage.append(Usage(stack.loop))
            found.threads.append(threads_of(stack.loop))
            found.stolen_s = (stolen_ns(cpu) - stolen) * 1e-9
            found.counters, found.ended_ns = window.counters()[0], time.monotonic_ns()
            found.histograms = {name: window.histogram(name) for name in ("lateness", "cycle_time")}
            witness.line_with("done")
            if found.cyclic is not None:
                found.cyclic.end()
        finally:
            for close in closers:
                close()
        found.ended = player.ended
        with np.load(witnessed) as file:
            found.missed, found.witness_late_ns = file["missed"], file["late_ns"]
    return found


def of_histogram(histogram: np.void) -> dict[str, float]:
    """Percentiles, µs."""
    values = percentiles_ns(histogram, [*PERCENTS, 100])
    return {n: v / 1000 for n, v in zip([*(f"p{p:g}" for p in PERCENTS), "max"], values, strict=True)}


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(STEADY_S + 180)
@pytest.mark.parametrize("wire", ["mock", "pty"])
def test_steady(benchmark, report, tmp_path, wire):
    cpu = max(os.sched_getaffinity(0))
    rate_hz = 1000.0 if wire == "mock" else 200.0
    settings = {"realtime": {"cpu": cpu}, "front": {"joint_states_hz": JOINT_STATES_HZ}}
    if wire == "pty":
        settings |= {"control": {"rate_hz": rate_hz}, "bus": FASTEST_BUS}
    mock_hz = rate_hz if wire == "mock" else None

    seen = benchmark.pedantic(measure, (tmp_path, cpu, mock_hz, settings), rounds=1)
    before, after = seen.threads
    of_all = sorted(before, key=lambda task: before[task]["priority"])
    cycle, others = of_all[-1], [task for task in of_all[:-1] if task in after]
    counts = {
        "the cycle's thread": counted(before, after, [cycle]),
        "its others": counted(before, after, others),
    }
    missed = seen.missed[(seen.missed["until_ns"] > seen.begun_ns) & (seen.missed["since_ns"] < seen.ended_ns)]
    half_ns = seen.period_ns // 2
    explained = missed["late_ns"] >= half_ns
    long = [count for i, count in enumerate(seen.histograms["cycle_time"]["buckets"]) if upper_ns(i) >= half_ns]
    figures = {
        "cycles": int(seen.counters["cycles"]),
        "missed": int(seen.counters["overruns"]),
        "stalls": len(missed),
        "explained": int(missed["cycles"][explained].sum()),
        "unexplained": max(0, int(seen.counters["overruns"]) - int(missed["cycles"][explained].sum())),
        "long_cycles": int(sum(long)),
    }
    report(
        f"steady at {rate_hz:g} Hz, {wire} wire, {STEADY_S} s on processor {cpu}",
        f"{seen.ended.pop('', 0)} goals succeeded{''.join(f'; {n} ended: {words}' for words, n in seen.ended.items())}",
    )
    for who, numbers in counts.items():
        words = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in numbers.items())
        report(f"  {who} (aim: 0 but voluntary)", words)
    resident, threads, processor = (
        [getattr(usage, name) for usage in seen.usage] for name in ("resident_kb", "threads", "processor_s")
    )
    report(
        "  control process, before → after",
        f"{resident[0]} → {resident[1]} kB resident, {threads[0]} → {threads[1]} threads; "
        f"{100 * (processor[1] - processor[0]) / STEADY_S:.2f} % of a core",
    )
    report(
        "  cycles missed (aim at 200 Hz: 0, or explained)",
        f"{figures['missed']} of {figures['cycles']}, in {figures['stalls']} stalls: {figures['explained']} explained, "
        f"{figures['unexplained']} not; {figures['long_cycles']} cycles took half a period",
    )
    if seen.cyclic is None:
        report("  cyclictest beside it", cyclictest.ABSENT)
    else:
        at_once = overlapping(missed, seen.cyclic.spikes_ns, half_ns)
        figures["cyclictest_too"] = int(missed["cycles"][at_once].sum())
        figures["cyclictest_us"] = cyclictest.percentiles_us(seen.cyclic.late_us, *PERCENTS)
        report("  of them, cyclictest overslept, too", f"{figures['cyclictest_too']}")
        report("  lateness of cyclictest, one priority below", f"{in_words(figures['cyclictest_us'])} µs")
    figures["lateness_us"], figures["cycle_time_us"] = (
        of_histogram(seen.histograms[name]) for name in ("lateness", "cycle_time")
    )
    report("  lateness of the cycle", f"{in_words(figures['lateness_us'])} µs")
    report("  wake-up to the end of its write", f"{in_words(figures['cycle_time_us'])} µs")
    report(
        "  witness late by an eighth, a whole period",
        f"{len(seen.witness_late_ns)}, {np.count_nonzero(seen.witness_late_ns[:, 1] >= seen.period_ns)}; "
        f"processor {cpu} stolen for {seen.stolen_s:.2f} s",
    )
    benchmark.extra_info.update(
        figures,
        counts=counts,
        resident_kb=resident,
        threads=threads,
        ended=dict(seen.ended),
        stalls_ns=[[int(value) for value in row] for row in missed],
    )
