"""Nothing in the cycle enters the interpreter, allocates, faults a page or waits for the GIL."""

import ctypes
import importlib
import pkgutil
import resource
import shutil
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from compiling import bounds_checked, compile_functions
from many_cycles import Recording, RecordingArm, advance, replay, run_cycles, swing
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher
from numba.core.runtime import _nrt_python, rtsys
from virtual import VirtualArm

import rtloop
import shm
from compilation import cache
from compilation.jit import jit
from config.loader import load_arm
from rtloop import cycle
from rtloop.memory.state import Loop
from rtloop.process import entries
from rtloop.process.run import run
from rtloop.system import realtime
from shm.record import offset_of
from shm.words import Mode, Outcome

ROOT = Path(__file__).resolve().parents[2]
CYCLES = 10_000
TRIES = 3
"""The kernel moves a page now and then, which faults once and is no new page; what is touched for the first time is."""


def dispatchers():
    """Every compiled function that a module of ours holds, with the name under which it is found."""
    found = {}
    for package in (rtloop, shm):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if module.name.endswith(("__main__", ".program")):  # programs: the first thing they do is take the signals
                continue
            for name, value in vars(importlib.import_module(module.name)).items():
                if isinstance(value, CPUDispatcher):
                    found.setdefault(value, f"{module.name}.{name}")
    return found


def reachable(function):
    """The compiled functions that a compiled function may call, itself included."""
    seen, waiting = set(), [function]
    while waiting:
        here = waiting.pop()
        if here in seen:
            continue
        seen.add(here)
        names = here.py_func.__code__.co_names
        held = [here.py_func.__globals__.get(name) for name in names]
        for module in [value for value in held if isinstance(value, type(sys))]:
            held += [getattr(module, name, None) for name in names]
        waiting += [value for value in held if isinstance(value, CPUDispatcher)]
    return seen


@jit
def reference(number: int) -> int:
    """A function compiled the one way, to compare others with."""
    return number


# --- how it is compiled ---------------------------------------------------------------------------------


def test_all_are_compiled_the_one_way():
    found = dispatchers()
    assert len(found) > 80
    for function, name in found.items():
        assert function.targetoptions == reference.targetoptions, name
        assert isinstance(function._cache, FunctionCache), name
    assert reference.targetoptions["nopython"] and reference.targetoptions["nogil"]
    assert not reference.targetoptions.get("fastmath", False)


def test_what_the_cycle_calls_is_compiled_without_the_interpreter():
    compile_functions()
    called = reachable(run)
    assert cycle.step in called and len(called) > 70
    assert called <= set(dispatchers())
    assert len(run.signatures) == 1
    for function in called:
        assert len(function.nopython_signatures) == len(function.signatures)


# --- what it does to memory -----------------------------------------------------------------------------


@pytest.fixture
def swinging():
    """The arm `mock` in the midst of a goal that lasts longer than the test; warmed up."""
    arm = VirtualArm("mock")
    pages = np.frombuffer(arm.state.map, np.uint8)[:: resource.getpagesize()]
    pages[:] = pages.copy()  # in memory, as the control process makes them
    assert arm.bring_up().failure is None
    goal = swing(arm, duration_s=(TRIES * CYCLES + 1000) / 100)
    advance(arm, 200)
    yield arm
    assert (arm.running_goal, arm.memory["mode"]) == (goal, Mode.EXECUTING)
    assert arm.outcome(goal) == Outcome.NONE
    arm.close()


def resident_kb() -> int:
    """How much memory of this process is there, to the page."""
    lines = Path("/proc/self/smaps_rollup").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Rss:"))


def test_ten_thousand_cycles_allocate_nothing_and_fault_no_page(swinging):
    signatures = {function: len(function.signatures) for function in reachable(run_cycles)}
    first = int(swinging.memory["timing"]["cycle"])
    _nrt_python.memsys_enable_stats()
    try:
        advance(swinging, 1)
        resident_kb()
        for tries in range(1, TRIES + 1):
            there_kb = resident_kb()
            before = rtsys.get_allocation_stats(), resource.getrusage(resource.RUSAGE_THREAD)
            advance(swinging, CYCLES)
            after = rtsys.get_allocation_stats(), resource.getrusage(resource.RUSAGE_THREAD)
            assert swinging.memory["timing"]["cycle"] == first + tries * CYCLES + 1
            assert after[0] == before[0]
            if after[1].ru_minflt == before[1].ru_minflt:
                break
            assert resident_kb() == there_kb
    finally:
        _nrt_python.memsys_disable_stats()
    assert after[1].ru_minflt == before[1].ru_minflt
    assert after[1].ru_majflt == before[1].ru_majflt
    assert {function: len(function.signatures) for function in signatures} == signatures


def test_a_recorded_goal_on_six_drives_allocates_nothing_and_faults_no_page():
    """The codecs of wire and drives, the way onto the path and the arrival included, which the mock arm lacks."""
    arm = RecordingArm.at_start_of("large")
    recording = Recording(arm, arm.play("large"))
    signatures = {function: len(function.signatures) for function in reachable(replay)}
    _nrt_python.memsys_enable_stats()
    try:
        recording.rewind()
        recording.play()
        recording.rewind()
        before = rtsys.get_allocation_stats(), resource.getrusage(resource.RUSAGE_THREAD)
        sent = recording.play()
        after = rtsys.get_allocation_stats(), resource.getrusage(resource.RUSAGE_THREAD)
    finally:
        _nrt_python.memsys_disable_stats()
    assert arm.outcome(recording.goal) == Outcome.SUCCEEDED
    assert sent > 300 * len(recording.durations_ns)
    assert after[0].alloc - before[0].alloc == 5  # the call from Python holds its five arrays, whatever it does then
    assert after[1].ru_minflt == before[1].ru_minflt
    assert after[1].ru_majflt == before[1].ru_majflt
    assert {function: len(function.signatures) for function in signatures} == signatures
    arm.close()


def test_the_allocation_counter_counts():
    """The proof above is worth something: the same statistics see one array."""
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        make_an_array(np.ones(3))
        assert rtsys.get_allocation_stats().alloc > before.alloc
    finally:
        _nrt_python.memsys_disable_stats()


@jit
def make_an_array(values):
    return (values + 1.0).sum()


# --- what the interpreter does to it --------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.usefixtures("unlocked")
def test_holding_the_gil_for_two_seconds_costs_no_cycle():
    """The real loop in a thread of its own, at 200 Hz, while this one keeps the interpreter to itself.

    A loop that needed the GIL would miss 400 cycles every time. A busy machine without real-time priority may
    cost any program a cycle now and then, so the best of a few windows counts.
    """
    arm = VirtualArm(load_arm("mock", overrides={"control": {"rate_hz": 200}}))
    counters = arm.state.record["counters"]
    sleep_with_gil = ctypes.PyDLL(None).usleep  # a PyDLL keeps the GIL during the call
    missed = []

    def control():
        realtime.prepare_thread(arm.arm.realtime, realtime.Obtained())
        run(arm.loop[0], arm.state.array[0])

    thread = threading.Thread(target=control)
    thread.start()
    try:
        while counters["cycles"] == 0:
            time.sleep(0)
        for _ in range(3):
            cycles, overruns = int(counters["cycles"]), int(counters["overruns"])
            start_ns = time.monotonic_ns()
            for _ in range(4):
                sleep_with_gil(500_000)
            elapsed_ns = time.monotonic_ns() - start_ns
            ran, late = int(counters["cycles"]) - cycles, int(counters["overruns"]) - overruns
            assert ran + late == pytest.approx(elapsed_ns / arm.period_ns, abs=2)  # every period is accounted for
            missed.append(late)
            if late == 0:
                break
    finally:
        entries.store_word(arm.loop.ctypes.data + offset_of(Loop, "stop"), 1)
        thread.join()
        arm.close()
    assert min(missed) == 0, f"cycles missed in windows of two seconds: {missed}"


# --- with bounds checking -------------------------------------------------------------------------------

CHECKED = """
from virtual import VirtualArm

arm = VirtualArm.at_start_of("small")
print(arm.end_of(arm.play("small")).name, int(arm.memory["fault"]["code"]))
arm.close()
"""


@pytest.mark.process
def test_no_index_ever_leaves_its_array(request):
    """A recorded goal in virtual time with numba's bounds checks compiled in.

    Compiles the whole cycle once more (about 30 s); pytest's own cache keeps it until the sources change.
    """
    kept = request.config.cache.mkdir("bounds-checked")
    directory = kept / "rtarm" / cache.folder().name
    for old in kept.glob("rtarm/compiled-*"):
        if old != directory:
            shutil.rmtree(old)
    result = bounds_checked(CHECKED, kept)
    assert (result.stdout.split("\n"), result.returncode) == (["checks bounds", "SUCCEEDED 0", ""], 0), result.stderr
