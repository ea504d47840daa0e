"""Planted causes are found, in the kernel's own trace and beside a real control process; and the command around it."""

from __future__ import annotations

import json
import mmap
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from planted_trials import CPU, Lines, Trial, impossible, mock_arm, planted_in_arm, planted_in_loop
from stack import ROOT, Stack
from typer.testing import Result
from waiting import until
from written_arm import WrittenArm

from rtarm.running.status import open_running
from rtarm.why_late import hints, tracefs
from rtarm.why_late import live as live_room
from rtarm.why_late.causes import MEANINGS, WORDS, Cause
from rtarm.why_late.hints import Hints, counted
from rtarm.why_late.live import live
from rtarm.why_late.tracefs import NotTraced, place, traced
from rtarm.why_late.watch import cpu_of

PLANTS, PAGES = 12, 4000
CYCLES = 200
"""Of so many some wake up 10 µs late."""
LEAST = 6
"""A machine that is busy with other things makes some plants late or empty."""

possible = pytest.mark.skipif(bool(impossible()), reason=impossible())


def judge(trial: Trial) -> None:
    """Nothing is taken for another cause. How many are known depends on what else runs: `bench/bench_why_late.py`."""
    wrong = [late for late in trial.planted if late.cause not in (Cause.UNKNOWN, trial.expected)]
    assert len(trial.planted) >= LEAST
    assert [late.cause for late in wrong] == []
    assert trial.right > 0, trial.found()


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with mock_arm(tmp_path_factory.mktemp("why_late")) as started:
        yield started


@possible
@pytest.mark.process
@pytest.mark.parametrize("cause", ["hog", "flood", "packets", "stop"])
def test_what_is_planted_beside_an_arm_is_found(stack: Stack, cause: str) -> None:
    judge(planted_in_arm(stack, cause, PLANTS))


@possible
@pytest.mark.process
def test_planted_page_faults_are_found() -> None:
    judge(planted_in_loop(PLANTS))


@possible
@pytest.mark.process
def test_the_command_tells_of_an_arm_and_ends_early(stack: Stack, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "rtarm", "why-late", stack.name, "--json", "--bound-us", "10"]
    process = subprocess.Popen(
        [*command, "--plot", str(tmp_path / "causes.svg")], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    instance = place() / "instances" / f"rtarm-{process.pid}"
    until(instance.is_dir)
    seen = int(stack.reader.snapshot()["cycle"])
    until(lambda: int(stack.reader.snapshot()["cycle"]) > seen + CYCLES)
    process.send_signal(signal.SIGINT)
    report = json.loads(process.communicate(timeout=60.0)[0])
    assert process.returncode == 0
    assert report["traced"] and report["late"] > 0 and report["hints"] == []
    assert sum(one["share"] for one in report["causes"]) == pytest.approx(1.0)
    assert {one["cause"] for one in report["causes"]} != {"unknown"}
    assert (tmp_path / "causes.svg").stat().st_size > 1000
    assert not instance.exists()


@possible
@pytest.mark.process
def test_what_late_cycles_waited_for_is_told_while_the_arm_runs(stack: Stack) -> None:
    header = stack.reader.memory.record["header"]
    due_ns = int(stack.reader.snapshot()["monotonic_ns"])
    with live(stack.name) as told:
        until(lambda: any((place() / "instances").glob(f"rtarm-{os.getpid()}")))
        hog = Lines("hog", due_ns, int(header["period_ns"]), PLANTS, cpu=CPU)
        try:
            until(lambda: any(f" {hog.process.pid} (" in one.who for one in told().causes))
        finally:
            hog.close()
        causes, hint = told()
        assert hint == "" and all(0 <= one.share <= 1 for one in causes)
    assert not any((place() / "instances").glob(f"rtarm-{os.getpid()}"))


@pytest.mark.usefixtures("nowhere")
def test_without_a_trace_there_is_one_hint(arm: WrittenArm) -> None:
    with live(arm.name) as told:
        until(lambda: "mount -t tracefs" in told().hint)
        assert told().causes == ()
    with live(arm.name, "zh") as told:
        until(lambda: "这里无法读取跟踪事件" in told().hint)


def test_an_arm_that_ends_is_waited_for(arm_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(live_room, "AGAIN_S", 0.01)
    monkeypatch.setattr(live_room, "open_running", lambda name: asked.append(name) or open_running(name))
    with live(arm_name) as told:
        until(lambda: len(asked) > 2)
        assert told() == ((), "Since this began no cycle was later than 100 µs.")


@possible
@pytest.mark.process
def test_an_instance_goes_with_its_user_and_one_that_was_killed_at_the_next_start() -> None:
    instances = place() / "instances"
    script = "import os, time; from rtarm.why_late.tracefs import traced\nwith traced(os.getpid()): time.sleep(60)"
    killed = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT)
    left = instances / f"rtarm-{killed.pid}"
    last = left / "events/signal/signal_generate/enable"
    until(lambda: last.exists() and last.read_text().startswith("1"))
    before = {name: (place() / name).read_text() for name in ("tracing_on", "set_event", "trace_clock")}
    with traced(os.getpid()) as trace:
        assert left.exists()  # that of another one who lives
        with pytest.raises(NotTraced, match="already"), traced(os.getpid()):
            pass
        until(lambda: "sched_switch" in trace.read())
    killed.kill()
    killed.wait()
    assert left.exists()
    with pytest.raises(ZeroDivisionError), traced(os.getpid()):
        assert not left.exists()
        raise ZeroDivisionError
    assert not (instances / f"rtarm-{os.getpid()}").exists()
    assert {name: (place() / name).read_text() for name in before} == before


# --- without permission, and other refusals -----------------------------------------------------------------


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A machine without tracefs."""
    monkeypatch.setattr(tracefs, "PLACES", (tmp_path / "tracing", tmp_path / "debug"))


@pytest.mark.usefixtures("nowhere")
def test_without_a_trace_hints_are_given(arm: WrittenArm, rtarm: Callable[..., Result]) -> None:
    result = rtarm("why-late", arm.name, "--seconds", "0.5", "--json")
    report = json.loads(result.output)
    assert (result.exit_code, report["traced"], report["causes"]) == (0, False, [])
    assert "mount -t tracefs" in report["notes"][0]
    assert "none later than 100 µs" in rtarm("why-late", arm.name, "--seconds", "0.5").output


@pytest.mark.usefixtures("nowhere")
def test_notes_are_in_the_language_asked_for(arm: WrittenArm, rtarm: Callable[..., Result]) -> None:
    told = rtarm("why-late", arm.name, "--seconds", "0.5", "--language", "zh").output
    assert "没有一个晚于 100 µs" in told and "没有它们就不知道原因" in told
    assert "Without them" in rtarm("why-late", arm.name, "--seconds", "0.5", "--json", "--language", "zh").output


def test_a_place_that_may_not_be_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tracefs, "PLACES", (tmp_path / "nowhere", tmp_path))
    monkeypatch.setattr(tracefs, "_pid_namespace", lambda: tracefs.FIRST_PID_NAMESPACE)
    (tmp_path / "instances").mkdir()
    assert place() == tmp_path
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(NotTraced, match="as root"):
        place()


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder like tracefs, which keeps what is written to it."""
    monkeypatch.setattr(tracefs, "PLACES", (tmp_path,))
    monkeypatch.setattr(tracefs, "_pid_namespace", lambda: tracefs.FIRST_PID_NAMESPACE)
    folder = tmp_path / "instances" / f"rtarm-{os.getpid()}"
    for event in ("sched/sched_switch", "sched/sched_waking", "timer/hrtimer_expire_entry", "signal/signal_generate"):
        (folder / "events" / event).mkdir(parents=True)
    for cpu in os.sched_getaffinity(0):
        (folder / "per_cpu" / f"cpu{cpu}").mkdir(parents=True)
    os.mkfifo(folder / "trace_pipe")
    monkeypatch.setattr(tracefs, "_opened", lambda where: os.open(where / "trace_pipe", os.O_RDONLY | os.O_NONBLOCK))
    return folder


def test_a_pinned_thread_has_its_processor_traced_alone(written: Path) -> None:
    allowed = os.sched_getaffinity(0)
    events = written / "events"

    def filters() -> list[str]:
        return [(events / name / "filter").read_text() for name in ("sched/sched_switch", "sched/sched_waking")]

    try:
        os.sched_setaffinity(0, {min(allowed)})
        with traced(os.getpid()) as trace:
            assert filters() == [f"CPU == {min(allowed)}", f"pid == {os.getpid()}"]
            own = os.getpid()
            stops = (events / "signal/signal_generate/filter").read_text()
            assert stops == f"sig >= 19 && sig <= 22 && (pid == {own} || pid == {own})"
            assert trace.read() == ""  # an end, as of a ring that is turned off, is no reason to read on
            if len(allowed) > 1:
                os.sched_setaffinity(0, allowed)
                trace.read()
                assert filters()[0] == "0"
    finally:
        os.sched_setaffinity(0, allowed)


def test_a_processor_whose_timers_expire_elsewhere_is_not_traced_alone(
    written: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    allowed = os.sched_getaffinity(0)
    monkeypatch.setattr(tracefs, "WITHOUT_TICK", tmp_path / "nohz_full")
    try:
        os.sched_setaffinity(0, {min(allowed)})
        for listed, wanted in (("(null)", f"CPU == {min(allowed)}"), ("", f"CPU == {min(allowed)}"), ("0-63,70", "0")):
            (tmp_path / "nohz_full").write_text(f"{listed}\n")
            with traced(os.getpid()):
                assert (written / "events/sched/sched_switch/filter").read_text() == wanted
    finally:
        os.sched_setaffinity(0, allowed)


def test_what_the_kernel_lacks_or_refuses_is_named(written: Path) -> None:
    (written / "events/timer/hrtimer_expire_entry").rmdir()
    with pytest.raises(NotTraced, match="no event timer/hrtimer_expire_entry"), traced(os.getpid()):
        pass
    (written / "trace_clock").unlink()
    (written / "trace_clock").mkdir()
    with pytest.raises(NotTraced, match=r"trace_clock refuses it \(Is a directory\)"), traced(os.getpid()):
        pass


@pytest.mark.usefixtures("written")
def test_a_container_that_counts_processes_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracefs, "_pid_namespace", lambda: 1)
    with pytest.raises(NotTraced, match="--pid=host"):
        place()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--seconds", "0.1"), "`--seconds` is 0.1, allowed are 0.5 to 86400 s"),
        (("--seconds", "nan"), "`--seconds` is nan"),
        (("--bound-us", "1"), "`--bound-us` is 1, allowed are 10 to 1e+06 µs"),
        (("--plot", "x.txt"), "x.txt is no name of a picture"),
        (("--plot", "nowhere/x.svg"), "name a file in a folder that exists"),
    ],
)
def test_what_is_refused(rtarm: Callable[..., Result], arm: WrittenArm, options: tuple[str, str], said: str) -> None:
    result = rtarm("why-late", arm.name, *options)
    assert (result.exit_code, result.stdout) == (1, "")
    assert said in result.stderr


def test_an_arm_that_does_not_run(rtarm: Callable[..., Result]) -> None:
    result = rtarm("why-late", "nobody", "--json")
    assert result.exit_code == 1
    assert "No control process" in json.loads(result.output)["problems"][0]


def test_hints_are_what_rises_faster_while_cycles_are_late() -> None:
    own = os.getpid()
    assert {"page faults", "ms that the host took (steal)"} <= set(counted(own, cpu_of(own)))
    assert any(what.startswith("interrupts ") for what in counted(own, cpu_of(own)))
    found = Hints(own)
    found.look(late=False)
    with mmap.mmap(-1, PAGES * mmap.PAGESIZE) as fresh:
        fresh.madvise(mmap.MADV_NOHUGEPAGE)
        for page in range(PAGES):
            fresh[page * mmap.PAGESIZE] = 1  # the kernel has to fetch it now
    found.look(late=True)
    found.look(late=False)
    told = {one["what"]: one for one in found.told()}
    assert told["page faults"]["a_look_with_late_cycles"] >= PAGES > told["page faults"]["a_look_without"]


def test_hints_of_another_processor_are_no_rise(monkeypatch: pytest.MonkeyPatch) -> None:
    processors = iter([0, 1, 1])
    monkeypatch.setattr(hints, "cpu_of", lambda _: next(processors))
    monkeypatch.setattr(hints, "of_processor", lambda cpu: {"interrupts": 1000.0 * cpu})
    found = Hints(os.getpid())
    found.look(late=True)
    found.look(late=False)
    assert "interrupts" not in {one["what"] for one in found.told()}


def test_every_cause_has_its_words() -> None:
    assert set(WORDS) == set(MEANINGS) == set(Cause)
