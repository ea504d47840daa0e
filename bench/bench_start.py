"""From the command to the first cycle and to `ready`, and what the control process then holds.

Starts of a mock arm and of episode1 behind the simulated adapter alternate. Everything is compiled beforehand. The
first cycle's time is what the state file says: planned time of a cycle less the periods since the first one.
"""

import json
import os
import re
import secrets
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from stack import ROOT, Stack

from config.loader import ARMS_FOLDER
from shm.client import StateReader
from shm.files import DIRECTORY, open_state

STARTS = 15
QUIET_S = 10.0
LARGEST = 6
NS = 1_000_000_000

PROBE = """
import os, signal, sys, time
marks = {"interpreter": time.monotonic_ns()}
def mark(what):
    marks[what] = time.monotonic_ns()
import rtloop.__main__
from rtloop.process import program
mark("imports")
"""
"""What follows is the program's own way (`rtloop.__main__.main`), with a look at the clock in between."""
PROBE += """
import json
from config.loader import load_arm
from rtloop.process import compiled, control_process
from compilation import cache
from shm.client import StateReader
from shm.files import open_state
arm = load_arm(sys.argv[1])
mark("arm file")
cache.key()
mark("hash of sources")
cycle = compiled.load()
mark("compiled cycle")
control = control_process.ControlProcess(arm, cycle, program.tell, control_process.StopAsked([signal.SIGTERM]))
mark("memory files, wire, locking")
def ready():
    now_ns = time.monotonic_ns()
    reader = StateReader(open_state(arm.name))
    snapshot = reader.snapshot()
    done = snapshot["cycle"] - 1 + int(reader.memory.record["counters"]["overruns"])
    marks["threads, first cycle"] = snapshot["monotonic_ns"] - done * arm.control.period_ns
    marks["bring-up"] = now_ns
    os.kill(os.getpid(), signal.SIGTERM)
control.serve(ready)
print(json.dumps(marks))
"""


@pytest.fixture(scope="module")
def arms(tmp_path_factory) -> Iterator[dict[str, Stack]]:
    """A mock arm, and episode1 with its simulated adapter running; their control processes are the tests' own."""
    subprocess.run([sys.executable, "-m", "rtloop.warm"], check=True)
    stacks = {}
    for what in ("mock", "episode1"):
        stack = stacks[what] = Stack(f"b{secrets.token_hex(4)}", tmp_path_factory.mktemp(what))
        if what == "mock":
            values = yaml.safe_load((ARMS_FOLDER / "mock.yaml").read_text(encoding="utf-8"))
            values["name"] = stack.name
            stack.arm_file.write_text(yaml.safe_dump(values), encoding="utf-8")
        else:
            stack.start_sim()
    yield stacks
    for stack in stacks.values():
        stack.close()
        assert not list(DIRECTORY.glob(f"rtarm.{stack.name}.*"))


def start(stack: Stack) -> tuple[float, float]:
    """Seconds from the command to the first cycle and to `ready`, of a control process that then ends."""
    began_ns = time.monotonic_ns()
    process = stack.start_loop()
    ready_ns = time.monotonic_ns()
    reader = StateReader(open_state(stack.name))
    snapshot, record = reader.snapshot(), reader.memory.record
    done = snapshot["cycle"] - 1 + int(record["counters"]["overruns"])
    first_ns = snapshot["monotonic_ns"] - done * int(record["header"]["period_ns"])
    reader.close()
    process.close()
    assert process.code() == 0, process.text
    return (first_ns - began_ns) / NS, (ready_ns - began_ns) / NS


def parts(stack: Stack) -> dict[str, float]:
    """Milliseconds of each part of a start."""
    began_ns = time.monotonic_ns()
    command = [sys.executable, "-c", PROBE, str(stack.arm_file)]
    environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    printed = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout
    times = list(json.loads(printed.splitlines()[-1]).items())
    ends = [began_ns, *(at for _, at in times)]
    return {what: (at - before) / 1e6 for (what, at), before in zip(times, ends, strict=False)}


@pytest.mark.benchmark(group="start")
@pytest.mark.timeout(300)
def test_start_to_first_cycle(benchmark, report, arms):
    seconds: dict[str, list[tuple[float, float]]] = {what: [] for what in arms}
    pieces: dict[str, list[dict[str, float]]] = {what: [] for what in arms}

    def measure() -> None:
        for _ in range(STARTS):
            for what, stack in arms.items():
                seconds[what].append(start(stack))
                pieces[what].append(parts(stack))

    benchmark.pedantic(measure, rounds=1)
    for what in arms:
        first, ready = np.array(seconds[what]).T
        benchmark.extra_info[what] = {"first_cycle_s": first.tolist(), "ready_s": ready.tolist()}
        report(
            f"{what}, {STARTS} starts: command → first cycle (aim ≤ 1 s), → ready",
            f"p50 {np.median(first):.2f}, max {first.max():.2f} s; p50 {np.median(ready):.2f}, max {ready.max():.2f} s",
        )
        medians = {name: float(np.median([piece[name] for piece in pieces[what]])) for name in pieces[what][0]}
        benchmark.extra_info[what]["parts_ms"] = medians
        report("  parts, medians", ", ".join(f"{name} {value:.0f}" for name, value in medians.items()) + " ms")


def mappings(pid: int) -> dict[str, Counter[str]]:
    """kB of each kind (Rss, Private_Dirty …) that a process holds, by file name or kind of mapping."""
    found: dict[str, Counter[str]] = {}
    name = ""
    for line in Path(f"/proc/{pid}/smaps").read_text().splitlines():
        words = line.split()
        if re.match(r"[0-9a-f]+-", line):
            name = Path(words[5]).name if len(words) > 5 else "anonymous"
            name = re.sub(r"^rtarm\.\w+\.", "memory file .", name)
        elif words[-1] == "kB":
            found.setdefault(name, Counter())[words[0].rstrip(":")] += int(words[1])
    return found


def thread_faults(pid: int) -> dict[int, tuple[int, int]]:
    """Minor and major faults of each thread but the main one."""
    found = {}
    for task in map(int, os.listdir(f"/proc/{pid}/task")):
        if task != pid:
            words = Path(f"/proc/{pid}/task/{task}/stat").read_text().rpartition(")")[2].split()
            found[task] = int(words[7]), int(words[9])
    return found


@pytest.mark.benchmark(group="start")
def test_memory_and_page_faults(benchmark, report, arms):
    held: dict[str, dict[str, Counter[str]]] = {}
    faults: dict[str, tuple[int, int]] = {}

    def measure() -> None:
        for what, stack in arms.items():
            process = stack.start_loop()
            pid = process.process.pid
            before = thread_faults(pid)
            time.sleep(QUIET_S)
            after = thread_faults(pid)
            faults[what] = tuple(sum(after[task][kind] - before[task][kind] for task in before) for kind in (0, 1))
            held[what] = mappings(pid)
            process.close()

    benchmark.pedantic(measure, rounds=1)
    in_mb: Callable[[float], str] = lambda kilobytes: f"{kilobytes / 1000:.0f}"  # noqa: E731
    for what, by_name in held.items():
        total = sum(by_name.values(), Counter())
        benchmark.extra_info[what] = {"kB": dict(total), "faults": faults[what]}
        private = total["Private_Dirty"] + total["Private_Clean"]
        report(
            f"{what}: resident; of it this process' own; changed",
            f"{in_mb(total['Rss'])}; {in_mb(private)}; {in_mb(total['Private_Dirty'])} MB",
        )
        largest = sorted(by_name.items(), key=lambda item: -item[1]["Rss"])[:LARGEST]
        report("  largest", ", ".join(f"{name} {in_mb(kinds['Rss'])}" for name, kinds in largest) + " MB")
        report(
            f"  page faults of its threads in {QUIET_S:g} s from `ready`", "{} minor, {} major".format(*faults[what])
        )
