"""`rtarm why-late`: are planted causes found, and what does watching cost the cycle?

Causes are planted as tests/planted_trials.py says. RTARM_WHY_LATE_PLANTS says how often each is (60); with
RTARM_WHY_LATE_LOAD=1 the machine is kept busy meanwhile, as `rtarm bench` does. The cost: slices
without and with a watcher, in turn, at 200 Hz and 1 kHz, as `slices` says; RTARM_WHY_LATE_PAIRS says how many (10).
"""

import os
import subprocess
import sys
import time

import pytest
from planted_trials import EXPECTED, impossible, mock_arm, planted_in_arm, planted_in_loop
from slices import SLICE_S, compare, slice_of, under_load

from rtarm.bench.load import described
from rtarm.why_late.causes import Cause

PLANTS = int(os.environ.get("RTARM_WHY_LATE_PLANTS", "60"))
LOADED = os.environ.get("RTARM_WHY_LATE_LOAD", "0") == "1"
PAIRS = int(os.environ.get("RTARM_WHY_LATE_PAIRS", "10"))
BOUND_US = 100
WARM_S = 2.0

pytestmark = pytest.mark.skipif(bool(impossible()), reason=impossible())


@pytest.mark.timeout(900)
def test_planted_causes(report, tmp_path):
    # the load is there before the cycle has a processor, so that it uses all of them
    trials = under_load(tmp_path, lambda: all_planted(tmp_path), wanted=LOADED)
    report(f"planted {PLANTS} times each", described() if LOADED else "no load of ours")
    columns = [cause for cause in Cause if any(cause in trial.found() for trial in trials)]
    for trial in trials:
        found = ", ".join(f"{cause.value} {trial.found()[cause]}" for cause in columns if trial.found()[cause])
        report(f"{trial.cause}: {len(trial.planted)} late, {trial.right} right, {trial.unknown} unknown", found)
        others = ", ".join(f"{late.cause.value} {late.length_ns / 1000:.0f} µs" for late in trial.others[:8])
        report(f"  late beside it, not planted: {len(trial.others)}", others)


def all_planted(folder):
    """Every cause in turn."""
    with mock_arm(folder) as stack:
        trials = [planted_in_arm(stack, cause, PLANTS) for cause in EXPECTED if cause != "pages"]
        return [*trials, planted_in_loop(PLANTS)]


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(900)
@pytest.mark.parametrize("rate_hz", [200.0, 1000.0])
def test_cost(benchmark, report, tmp_path, rate_hz):
    def measure():
        with mock_arm(tmp_path, rate_hz) as stack:
            alone, watched = [slice_of(stack)], []
            for number in range(PAIRS):
                watched.append((number, watched_slice(stack)))
                alone.append(slice_of(stack))
            return alone, watched

    alone, watched = benchmark.pedantic(measure, rounds=1)
    report(f"{rate_hz:.0f} Hz mock arm: with / without rtarm why-late", f"{PAIRS} pairs of {SLICE_S:g} s")
    benchmark.extra_info.update(compare(report, alone, watched))


def watched_slice(stack):
    """A slice beside a command that has begun to watch, and watches for longer."""
    command = [sys.executable, "-m", "rtarm", "why-late", stack.name, "--bound-us", str(BOUND_US), "--json"]
    process = subprocess.Popen([*command, "--seconds", "600"], stdout=subprocess.DEVNULL)
    try:
        time.sleep(WARM_S)
        return slice_of(stack)
    finally:
        process.terminate()
        assert process.wait(30.0) == 0
