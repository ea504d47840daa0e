"""`rtarm top`: what it sees, how it draws that into any terminal, and how it gives the terminal back."""

from __future__ import annotations

import contextlib
import fcntl
import io
import math
import os
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console
from stack import Process
from written_arm import JOINTS, WrittenArm

from rtarm.console.errors import Refusal
from rtarm.top import watch as watching
from rtarm.top.events import Happening, happening
from rtarm.top.picture import TIMING_COLUMNS, Picture, bars, fitting, joint_columns, share
from rtarm.top.terminal import run
from rtarm.top.watch import BINS, HAPPENINGS, RECENT_S, Because, Look, Timing, Watch, Why, spectrum
from shm import files, histogram, layout
from shm.errors import NotRunning
from shm.recording import newest_events
from shm.words import Answer, Event, Fault, Mode, Outcome, Phase, Request, Unreferenced

PATIENCE_S = 60.0


def drawn(look: Look, width: int, height: int) -> list[str]:
    """The lines of the picture, without colours."""
    console = Console(file=io.StringIO(), width=width, height=height, color_system=None, legacy_windows=False)
    console.print(Picture(look), end="")
    return console.file.getvalue().splitlines()


def told(arm: WrittenArm, kind: Event, joint: int = -1, code: int = 0, value: float = 0.0, limit: float = 0.0) -> None:
    """Append to the arm's event ring."""
    written = int(arm.state["events_written"][0])
    slot = arm.state["events"][written % layout.EVENT_SLOTS]
    slot["monotonic_ns"], slot["kind"], slot["joint"], slot["code"] = time.monotonic_ns(), kind, joint, code
    slot["value"], slot["limit"] = value, limit
    arm.state["events_written"][0] = written + 1


def took(arm: WrittenArm, name: str, *values_ns: int) -> None:
    """Count durations in one of the arm's histograms."""
    record = arm.state[name]
    for value_ns in values_ns:
        record["buckets"][histogram.bucket(value_ns)] += 1
        record["count"] += 1
        record["max_ns"] = max(int(record["max_ns"]), value_ns)


@pytest.fixture
def watch(arm: WrittenArm) -> Iterator[Watch]:
    watch = Watch(arm.name)
    yield watch
    watch.close()


# --- events ---------------------------------------------------------------------------------------------


def event(kind: int, joint: int = -1, code: int = 0, value: float = 0.0, limit: float = 0.0) -> np.void:
    return np.array([(1, kind, joint, code, value, limit, 0, 0)], layout.Event.dtype)[0]


@pytest.mark.parametrize(
    ("record", "sentence"),
    [
        (event(Event.MODE, code=Mode.BRINGING_UP), "Mode: bringing up."),
        (event(Event.GOAL, code=12), "Goal 12 was announced."),
        (event(Event.REQUEST, code=Answer.DONE, value=7.0), "Request 7: Done."),
        (
            event(Event.REQUEST, code=Answer.DONE, value=7.0, limit=Request.HOME),
            "Request 7 (home): Done.",
        ),
        (event(Event.FAULT, 1, Fault.FOLLOWING_ERROR, 0.15, 0.1), "elbow was 0.1500 rad from where"),
        (
            event(Event.RESULT, 0, Outcome.SUCCEEDED, 0.001, 0.01),
            "Goal reached: the largest error is 0.0010 rad, of sh",
        ),
        (event(Event.OVERRUN, -1, 0, 0.3, 0.1), "The control cycle was away for 0.300 s and the drives look ahead"),
        (event(Event.REFERENCE, 0, Unreferenced.POWER_LOST), "The drive of shoulder may have lost power"),
        (event(99), "Unknown event 99"),
        (
            event(Event.RESULT, -1, Outcome.REFUSED_MODE, math.nan),
            "The control process takes no goals while it is in unknown mode nan",
        ),
    ],
    ids=lambda value: value.split()[0] if isinstance(value, str) else "",
)
def test_each_event_has_its_sentence(record: np.void, sentence: str) -> None:
    assert happening(record, JOINTS).sentence.startswith(sentence)


@given(
    st.integers(-3, 12),
    st.integers(-3, 40),
    st.integers(-(2**63), 2**63 - 1) | st.integers(-2, 30),
    st.floats(),
    st.floats(),
)
def test_whatever_stands_in_the_ring_there_are_words_for_it(
    kind: int, joint: int, code: int, value: float, limit: float
) -> None:
    sentence = happening(event(kind, joint, code, value, limit), JOINTS).sentence
    assert sentence.endswith(".") and "{" not in sentence


@given(st.integers(0, 3 * layout.EVENT_SLOTS), st.integers(1, layout.EVENT_SLOTS // 2), st.integers(0, 2000))
def test_the_newest_events_are_whole_and_in_order(written: int, count: int, meanwhile: int) -> None:
    numbers = np.arange(max(0, written - layout.EVENT_SLOTS), written)
    ring = np.zeros(layout.EVENT_SLOTS, layout.Event.dtype)
    ring["code"][numbers % layout.EVENT_SLOTS] = numbers
    heads = iter(([written], [written + meanwhile]))

    class Record:
        """A file whose control process writes on while it is read."""

        def __getitem__(self, name: str) -> Any:
            return next(heads) if name == "events_written" else ring

    found = newest_events(Record(), count)["code"].tolist()  # type: ignore[arg-type]
    intact = [
        number
        for number in range(max(0, written - count), written)
        if number > written + meanwhile - layout.EVENT_SLOTS
    ]
    assert found == intact


# --- the last seconds -----------------------------------------------------------------------------------


durations = st.lists(st.integers(0, 10**9), max_size=30)


@settings(max_examples=examples(30))
@given(before=durations, after=durations)
def test_the_last_seconds_are_the_difference_of_two_histograms(before: list[int], after: list[int]) -> None:
    arm = WrittenArm(f"top_{os.getpid()}")
    try:
        took(arm, "lateness", *before)
        watch = Watch(arm.name)
        watch.look()
        took(arm, "lateness", *after)
        recent, all_along = watch.look().timings[:2]
        watch.close()
    finally:
        arm.files.remove()
    for timing, values in ((recent, after), (all_along, [*before, *after])):
        assert timing.figures["count"] == sum(timing.spectrum) == len(values)
        if values:
            exact_us = np.percentile(values, 50.0, method="inverted_cdf") * 1e-3
            assert exact_us <= timing.figures["p50"] <= exact_us * 1.032
            assert timing.figures["max"] == pytest.approx(max(values) * 1e-3, rel=0.032)


def test_what_is_older_than_the_last_seconds_leaves_them(
    arm: WrittenArm, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = time.monotonic()

    def after(seconds: float) -> Look:
        monkeypatch.setattr(watching.time, "monotonic", lambda: now_s + seconds)
        return watch.look()

    after(0.0)
    arm.state["counters"]["overruns"] = 3
    took(arm, "lateness", 5_000_000)
    look = after(1.0)
    assert (look.recent["overruns"], look.timings[0].figures["count"]) == (3, 1)
    after(RECENT_S + 0.5)
    look = after(RECENT_S + 1.5)
    assert (look.recent["overruns"], look.timings[0].figures["count"]) == (0, 0)
    assert (look.report["overruns"], look.timings[1].figures["count"]) == (3, 1)


@pytest.mark.parametrize(
    ("value_ns", "where"), [(300, 0), (1_300, 1), (13_000, 5), (130_000, 9), (1_300_000, 13), (2**40, BINS - 1)]
)
def test_a_spectrum_has_four_bins_a_decade(value_ns: int, where: int) -> None:
    buckets = np.zeros(layout.HISTOGRAM_BUCKETS, np.int64)
    buckets[histogram.bucket(value_ns)] = 1
    assert spectrum(buckets) == tuple(int(index == where) for index in range(BINS))


@given(st.lists(st.integers(0, 2**40), max_size=BINS))
def test_every_value_is_seen_in_the_bars_and_more_are_never_lower(counts: list[int]) -> None:
    shown = bars(counts)
    assert len(shown) == len(counts)
    for count, bar in zip(counts, shown, strict=True):
        assert (bar == " ") == (count == 0)
        assert all(bar >= other for fewer, other in zip(counts, shown, strict=True) if fewer <= count)


# --- what it sees ---------------------------------------------------------------------------------------


def test_an_executing_arm(arm: WrittenArm, watch: Watch) -> None:
    arm.snapshot["mode"], arm.snapshot["goal_id"] = Mode.EXECUTING, 9
    arm.snapshot["goal_phase"], arm.snapshot["trajectory_clock_ns"] = Phase.RUNNING, 1.5e9
    arm.snapshot["trajectory_end_ns"] = 4_000_000_000
    arm.rows["measured_position_rad"] = math.radians(30.0)
    arm.rows["reference_position_rad"] = math.radians(29.5)
    arm.publish()
    told(arm, Event.MODE, code=Mode.EXECUTING)
    with arm.served():
        text = "\n".join(drawn(watch.look(), 100, 30))
    assert f"{arm.name}: executing, healthy" in text
    assert "9 running, 1.50 of 4.00 s; speed scale 1.00" in text
    assert re.search(r"shoulder +30\.000 +0\.000 +0\.00 +0\.5000 +\d+\.\d +yes", text)
    assert "Mode: executing." in text
    assert f"ROS      pid {os.getpid()}, alive" in text


def test_a_faulted_arm_says_why_and_since_when(arm: WrittenArm, watch: Watch) -> None:
    arm.snapshot["mode"], arm.snapshot["fault"] = Mode.FAULT, Fault.FOLLOWING_ERROR
    arm.snapshot["fault_joint"], arm.snapshot["fault_value"], arm.snapshot["fault_limit"] = 1, 0.15, 0.1
    arm.publish()
    told(arm, Event.FAULT, 1, Fault.FOLLOWING_ERROR, 0.15, 0.1)
    lines = drawn(watch.look(), 200, 40)
    assert lines[0].startswith(f"{arm.name}: fault, not fit to move")
    assert lines[1].startswith("- elbow was 0.1500 rad from where it was commanded")
    assert any(re.match(r"\d\d:\d\d:\d\d\.\d\d\d  elbow was 0\.1500 rad", line) for line in lines)


def test_a_limp_arm_without_a_front(arm: WrittenArm, watch: Watch) -> None:
    arm.snapshot["mode"] = Mode.FREE
    arm.rows["referenced"][1] = 0
    arm.rows["unreferenced_reason"][1] = Unreferenced.SILENT
    arm.publish()
    text = "\n".join(drawn(watch.look(), 200, 40))
    assert "The drives are limp (free)" in text
    assert "The drive of elbow was silent for too long" in text
    assert re.search(r"elbow .* NO", text)
    assert "ROS      no process serves the arm" in text


def test_a_dead_arm_keeps_its_last_figures_and_what_happened(arm: WrittenArm, watch: Watch) -> None:
    watch.look()
    arm.state["counters"]["cycles"] = 4711
    told(arm, Event.FAULT, 0, Fault.DRIVE_FAULT)
    fcntl.flock(arm.files.state.fd, fcntl.LOCK_UN)  # as by kill -9, after its last words
    for _ in range(2):
        text = "\n".join(drawn(watch.look(), 200, 40))
        assert f"{arm.name}: waiting" in text
        assert "is gone without an orderly end: start it again with" in text
        assert "4711 at 100 Hz" in text
        assert "The drive of shoulder reports a fault of its own" in text
        assert "has ended." in text


def test_another_control_process_is_followed(arm: WrittenArm, watch: Watch) -> None:
    told(arm, Event.GOAL, code=5)
    watch.look()
    arm.files.remove()
    assert "start it with `rtarm up" in str(watch.look().trouble)
    again = WrittenArm(arm.name)
    try:
        look = watch.look()
        assert look.trouble is None
        assert [one.sentence for one in look.happenings] == [
            f"Another control process runs (pid {os.getpid()}).",
            f"The control process (pid {os.getpid()}) has ended.",
            "Goal 5 was announced.",
        ]
        assert look.timings[0].span == "last 1 s"
    finally:
        again.files.remove()


def test_a_control_process_before_its_first_cycle(arm: WrittenArm) -> None:
    arm.state["snapshot_sequence"][0] = 0
    watch = Watch(arm.name)
    assert "has not run a cycle yet" in "\n".join(drawn(watch.look(), 80, 24))
    arm.publish()
    assert watch.look().trouble is None
    watch.close()


def test_a_control_process_that_died_while_writing(arm: WrittenArm, watch: Watch) -> None:
    watch.look()
    arm.state["snapshot_sequence"][0] += 1
    look = watch.look()
    assert "No consistent snapshot" in str(look.trouble)
    assert look.report is not None
    arm.state["snapshot_sequence"][0] += 1
    assert watch.look().trouble is None


def test_one_that_was_killed_while_writing_is_followed_too(arm: WrittenArm, watch: Watch) -> None:
    watch.look()
    arm.state["snapshot_sequence"][0] += 1
    fcntl.flock(arm.files.state.fd, fcntl.LOCK_UN)
    assert "is gone without an orderly end" in str(watch.look().trouble)
    again = WrittenArm(arm.name)
    try:
        assert watch.look().trouble is None
    finally:
        again.files.remove()
        files.DIRECTORY.joinpath(f"rtarm.{arm.name}.state.prev").unlink()


def test_a_front_that_comes_and_goes(arm: WrittenArm, watch: Watch) -> None:
    watch.look()
    with arm.served():
        watch.look()
    assert [one.sentence for one in watch.look().happenings] == [
        f"The ROS process (pid {os.getpid()}) no longer serves the arm.",
        f"A ROS process serves the arm (pid {os.getpid()}).",
    ]


def test_an_arm_that_does_not_run_is_refused(arm_name: str) -> None:
    with pytest.raises(NotRunning, match="start it with `rtarm up` and the name"):
        Watch(arm_name)


def test_without_a_terminal_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(Refusal, match="use `rtarm status --json`"):
        run("episode1")


# --- how it is drawn ------------------------------------------------------------------------------------


def percentiles(p50: float = 1.0) -> dict[str, Any]:
    return {"p50": p50, "p99": 2 * p50, "p99_9": 3 * p50, "max": 4 * p50, "count": 10}


def bus(load: float | None = 0.5, **trouble: int) -> dict[str, Any]:
    return {"load": load, **dict.fromkeys(("frames_tx", "frames_rx", *layout.BUS_TROUBLE), 0), **trouble}


def report(joints: list[str], **more: Any) -> dict[str, Any]:
    """A report as `status` makes it."""
    return {
        "arm": "arm",
        "mode": "executing",
        "healthy": True,
        "problems": [],
        "fault": None,
        "goal": {"id": 3, "phase": "running", "clock_s": 1.0, "duration_s": 2.5},
        "last_result": None,
        "speed_scale": 0.5,
        "rate_hz": 120.0,
        "uptime_s": 75.0,
        "cycles": 9000,
        "overruns": 2,
        "loop": {"pid": 11},
        "front": {"pid": 12, "heartbeat_age_ms": 4.0},
        "scheduling": {
            "policy": "fifo",
            "priority": 80,
            "memory_locked": True,
            "cpu": None,
            "dma_latency_held": True,
        },
        "bus": bus(frames_tx=500_000, frames_rx=400_000, wire_errors=2),
        "joints": [
            {
                "name": name,
                "position_rad": math.radians(10.0),
                "commanded_rad": math.radians(10.1),
                "velocity_rad_s": math.radians(-4.0),
                "error_rad": math.radians(0.0123),
                "age_ms": 3.0,
                "referenced": True,
                "unreferenced": None,
                "effort_nm": None,
                "temperature_c": None,
                "voltage_v": None,
                "drive": ["enabled", "answered"],
                "drive_trouble": [],
            }
            for name in joints
        ],
        **more,
    }


SPECTRUM = (0, 0, 0, 0, 1, 10, 100, 1000, *[0] * (BINS - 8))


def look(found: dict[str, Any], happenings: list[Happening], trouble: str | None = None) -> Look:
    timings = [
        Timing(what, span, percentiles(10.0), SPECTRUM)
        for what in ("lateness", "cycle")
        for span in ("last 10 s", "all along")
    ]
    recent = {"cycles": 1200, "overruns": 1, "bus": bus(0.8, frames_tx=20_000, frames_rx=8_000)}
    return Look("arm", found, recent, 10.0, timings, happenings, 0, trouble)


def test_the_picture_in_a_terminal_of_80_by_24() -> None:
    found = report([f"joint{number}" for number in range(1, 4)])
    at_ns = 1_700_000_000_250_000_000
    clock = time.strftime("%H:%M:%S", time.localtime(at_ns // 10**9)) + ".250"
    happened = [Happening(at_ns, "Mode: executing.")]
    assert [line.rstrip() for line in drawn(look(found, happened), 80, 24)] == [
        "arm: executing, healthy                                                   q ends",
        "goal     3 running, 1.00 of 2.50 s; speed scale 0.50",
        "cycles   9000 at 120 Hz, 2 overruns (1 in the last 10 s)",
        "bus      load 80.0%, 2000 frames/s sent, 800 received, 2 wire errors",
        "ROS      pid 12, alive 4 ms ago",
        "control  pid 11, up 1 min 15 s, SCHED_FIFO 80, memory locked, any CPU, CPU",
        "         latency held low",
        "joint  measured ° commanded °      °/s   error °    age ms referenced",
        "joint1     10.000      10.100    -4.00    0.0123       3.0        yes",
        "joint2     10.000      10.100    -4.00    0.0123       3.0        yes",
        "joint3     10.000      10.100    -4.00    0.0123       3.0        yes",
        "µs                     p50     p99    p99.9       max  1   10  100 1ms 10ms",
        "lateness last 10 s    10.0    20.0     30.0      40.0     ▁▃▆█",
        "lateness all along    10.0    20.0     30.0      40.0     ▁▃▆█",
        "cycle last 10 s       10.0    20.0     30.0      40.0     ▁▃▆█",
        "cycle all along       10.0    20.0     30.0      40.0     ▁▃▆█",
        f"{clock}  Mode: executing.",
    ]


def test_why_cycles_were_late_stands_below_how_late_they_were() -> None:
    found = look(report(["joint1"]), [Happening(0, "Mode: executing.")])
    causes = (
        Because("interrupt", "local_timer", 0.756, 12, 1834.4),
        Because("interrupts off, or the machine stood still", "python 10163", 0.2, 0, None),
        Because("unknown", "", 0.044, 1, 120.0),
    )
    lines = [line.rstrip() for line in drawn(replace(found, why=Why(causes)), 80, 24)]
    at = lines.index("late because                                            share  chiefly  worst µs")
    assert lines[at - 1].startswith("cycle all along")
    assert lines[at + 1 : at + 4] == [
        "interrupt, local_timer                                    76%       12      1834",
        "interrupts off, or the machine stood still, python 10…    20%        0         -",
        "unknown                                                    4%        1       120",
    ]
    assert lines[at + 4].endswith("Mode: executing.")
    assert not any("late because" in line for line in drawn(found, 80, 24))
    hint = "Trace events cannot be read here without permission: try again as root, with `sudo`."
    told = " ".join(line.strip() for line in drawn(replace(found, why=Why((), hint)), 80, 24))
    assert f"late because: {hint}" in told and "chiefly" not in told


def test_a_look_has_what_is_told_of_late_cycles(arm: WrittenArm) -> None:
    told = Why((), "None.")
    with contextlib.closing(Watch(arm.name, why=lambda: told)) as watch:
        assert watch.look().why is told
    with contextlib.closing(Watch(arm.name)) as watch:
        assert watch.look().why is None


def test_many_joints_in_a_small_terminal() -> None:
    found = report([f"joint{number}" for number in range(1, 33)])
    lines = drawn(look(found, [Happening(0, "Mode: executing.")]), 100, 24)
    assert len(lines) == 24
    assert any(re.match(r"… \d+ more: make the terminal higher", line) for line in lines)
    assert lines[-1].endswith("Mode: executing.")
    assert sum("joint" in line for line in drawn(look(found, []), 100, 60)) == 33


def test_what_is_left_out_in_a_narrow_terminal() -> None:
    assert [column.heading for column in fitting(joint_columns([]), 28)] == ["measured °", "error °"]
    assert [column.heading for column in fitting(TIMING_COLUMNS, 36)] == ["p50", "p99", "p99.9", "max"]
    columns = joint_columns([])
    assert fitting(columns, 200) == columns


def test_what_some_drives_measure_has_columns_where_there_is_room() -> None:
    found = report(["joint1", "joint2"])
    found["joints"][1] |= {"effort_nm": 1.5, "temperature_c": 41.2}
    one, two = (line for line in drawn(look(found, []), 120, 24) if line.startswith("joint") and "°" not in line)
    assert one.split()[-2:] == ["-", "-"] and two.split()[-3:] == ["yes", "1.50", "41"]
    head = next(line for line in drawn(look(found, []), 120, 24) if line.startswith("joint "))
    assert head.split()[-2:] == ["Nm", "°C"] and "V" not in head.split()
    assert not any("°C" in line for line in drawn(look(found, []), 80, 24))


def test_what_is_wrong_with_a_drive_stands_beside_its_joint() -> None:
    found = report(["joint1", "joint2"])
    found["joints"][1]["drive_trouble"] = ["protected", "over-current", "over-temperature"]
    lines = drawn(look(found, []), 120, 24)
    assert any(line.startswith("joint2") and line.rstrip().endswith(" protected, over-current…") for line in lines)
    assert any("drive says" in line for line in lines)


texts = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=64)
figures = st.none() | st.floats(-1e9, 1e9)
wanted = st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20)).map(sorted), max_size=6)


@given(st.integers(0, 60), wanted)
def test_room_is_shared_out_and_never_exceeded(room: int, wants: list[tuple[int, int]]) -> None:
    given_lines = share(room, wants)
    assert sum(given_lines) == min(room, sum(most for _, most in wants))
    for index, ((least, most), got) in enumerate(zip(wants, given_lines, strict=True)):
        assert got <= most
        if got < least:  # then whoever is less important got nothing
            assert not any(given_lines[index + 1 :])


@settings(max_examples=examples(60), deadline=None)
@given(
    width=st.integers(40, 200),
    height=st.integers(4, 70),
    mode=st.sampled_from([mode.name.lower() for mode in Mode]),
    names=st.lists(texts, min_size=1, max_size=32),
    figure=figures,
    problems=st.lists(texts.map(lambda text: f"{text} is wrong."), max_size=4),
    sentences=st.lists(texts, max_size=70),
    trouble=st.none() | texts,
    no_report=st.booleans(),
    because=st.none()
    | st.lists(st.builds(Because, texts, texts, st.floats(0, 1), st.integers(0), figures), max_size=5),
)
def test_the_picture_fits_every_terminal(
    width: int,
    height: int,
    mode: str,
    names: list[str],
    figure: float | None,
    problems: list[str],
    sentences: list[str],
    trouble: str | None,
    no_report: bool,
    because: list[Because] | None,
) -> None:
    found = report(names, mode=mode, healthy=not problems, problems=problems)
    for joint in found["joints"]:
        joint.update(position_rad=figure, error_rad=figure, age_ms=figure, referenced=figure is not None)
    seen = look(found, [Happening(number, sentence) for number, sentence in enumerate(sentences)], trouble)
    if because is not None:
        seen = replace(seen, why=Why(because, "" if because else "It is not known."))
    if no_report:
        seen = Look("arm", trouble="It has not run a cycle yet.", happenings=seen.happenings)
    lines = drawn(seen, width, height)
    assert 0 < len(lines) <= height
    assert all(cell_len(line) <= width for line in lines)
    first = "waiting" if seen.trouble is not None else mode.replace("_", " ")
    assert lines[0].startswith(f"arm: {first}")


# --- in a terminal --------------------------------------------------------------------------------------

CHILD = """
import os, sys
terminal = os.open(sys.argv[1], os.O_RDWR)  # a session leader's first terminal becomes its controlling one
for fd in (0, 1):
    os.dup2(terminal, fd)
os.close(terminal)
from rtarm.top.terminal import run
run(sys.argv[2])
"""
ESCAPE = re.compile(rb"\x1b(\[[0-?]*[ -/]*[@-~]|[@-Z\\-_])")
SHOW_CURSOR, LEAVE_SCREEN = b"\x1b[?25h", b"\x1b[?1049l"
LINE_MODE = 3  # index of the local modes in what tcgetattr returns


class Terminal:
    """A pseudo-terminal with `rtarm top` in it."""

    def __init__(self, arm: str, columns: int = 120, lines: int = 40) -> None:
        self.master, self.slave = os.openpty()
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self.before = termios.tcgetattr(self.slave)
        self.shown = b""
        self.seen = 0
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD, os.ttyname(self.slave), arm],
            cwd=Path(__file__).resolve().parents[3],
            env={name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}
            | {"TERM": "xterm-256color"},
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    def until(self, text: str) -> None:
        """Wait until something is drawn that has not been waited for yet."""
        deadline = time.monotonic() + PATIENCE_S
        while text not in (shown := ESCAPE.sub(b"", self.shown[self.seen :]).decode(errors="ignore")):
            assert self.process.poll() is None, self.process.stderr.read().decode()
            assert time.monotonic() < deadline, f"{text!r} never came: {shown[-4000:]}"
            self.read(0.1)
        self.seen = len(self.shown)

    def read(self, seconds: float) -> bool:
        """Take what is drawn within so many seconds; False when nothing is."""
        if not select.select([self.master], [], [], seconds)[0]:
            return False
        self.shown += os.read(self.master, 65536)
        return True

    def press(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def code(self) -> int:
        """The exit code, once it has ended; what it drew last has been read."""
        deadline = time.monotonic() + PATIENCE_S
        while self.process.poll() is None:
            assert time.monotonic() < deadline
            self.read(0.01)
        os.write(self.slave, b"the end")  # what was drawn comes in pieces, by a worker of the kernel
        while b"the end" not in self.shown:
            assert self.read(PATIENCE_S)
        return self.process.returncode

    @property
    def is_as_before(self) -> bool:
        """Whether line modes, cursor and screen are as they were."""
        last = self.shown.rindex(LEAVE_SCREEN)
        restored = SHOW_CURSOR in self.shown and b"\x1b[?1049h" not in self.shown[last:]
        return restored and termios.tcgetattr(self.slave) == self.before

    def hang_up(self) -> None:
        """Close the terminal."""
        for fd in (self.slave, self.master):
            if fd >= 0:
                os.close(fd)
        self.slave = self.master = -1

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stderr.close()
        self.hang_up()


@pytest.fixture
def open_terminal() -> Iterator[Callable[..., Terminal]]:
    opened: list[Terminal] = []

    def start(*arguments: Any) -> Terminal:
        opened.append(Terminal(*arguments))
        return opened[-1]

    yield start
    for terminal in opened:
        terminal.close()


@pytest.mark.process
@pytest.mark.parametrize(
    "end",
    [b"q", b"Q", b"\x03", b"\x04", signal.SIGTERM, signal.SIGHUP, signal.SIGINT],
    ids=["q", "Q", "Ctrl-C", "Ctrl-D", "TERM", "HUP", "INT"],
)
def test_every_end_gives_the_terminal_back(
    end: bytes | signal.Signals, arm: WrittenArm, open_terminal: Callable[..., Terminal]
) -> None:
    terminal = open_terminal(arm.name)
    terminal.until(f"{arm.name}: holding")
    assert not termios.tcgetattr(terminal.slave)[LINE_MODE] & (termios.ICANON | termios.ECHO)
    if isinstance(end, bytes):
        terminal.press(end)
    else:
        terminal.process.send_signal(end)
    assert terminal.code() == 0
    assert terminal.is_as_before


@pytest.mark.process
def test_other_keys_do_nothing_and_it_goes_on_drawing(arm: WrittenArm, open_terminal: Callable[..., Terminal]) -> None:
    terminal = open_terminal(arm.name, 60, 12)
    terminal.until("holding")
    terminal.press(b"x\x1b[A\n")
    arm.snapshot["mode"] = Mode.EXECUTING
    arm.publish()
    terminal.until("executing")
    terminal.press(b"q")
    assert terminal.code() == 0


@pytest.mark.process
def test_it_can_be_suspended(arm: WrittenArm, open_terminal: Callable[..., Terminal]) -> None:
    terminal = open_terminal(arm.name)
    terminal.until("holding")
    terminal.press(b"\x1a")
    while LEAVE_SCREEN not in terminal.shown:
        terminal.read(0.1)
    _, status = os.waitpid(terminal.process.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status)
    assert terminal.is_as_before
    terminal.seen = len(terminal.shown)
    terminal.process.send_signal(signal.SIGCONT)
    terminal.until("holding")
    terminal.press(b"q")
    assert terminal.code() == 0
    assert terminal.is_as_before


@pytest.mark.process
def test_a_terminal_that_is_closed_ends_it(arm: WrittenArm, open_terminal: Callable[..., Terminal]) -> None:
    terminal = open_terminal(arm.name)
    terminal.until("holding")
    terminal.hang_up()
    assert terminal.process.wait(PATIENCE_S) == 0
    assert terminal.process.stderr.read() == b""


@pytest.mark.process
def test_a_control_process_that_is_killed_and_started_again(
    mock_file: Path, arm_name: str, open_terminal: Callable[..., Terminal]
) -> None:
    loops = [Process("rtloop", str(mock_file))]
    try:
        loops[0].line_with("ready")
        terminal = open_terminal(arm_name)
        terminal.until(f"{arm_name}: holding")
        loops[0].process.kill()
        terminal.until("is gone without an orderly end: start it again with")
        terminal.until(f"The control process (pid {loops[0].process.pid}) has ended.")
        loops.append(Process("rtloop", str(mock_file)))
        terminal.until(f"{arm_name}: holding")
        terminal.until(f"Another control process runs (pid {loops[1].process.pid}).")
        terminal.press(b"q")
        assert terminal.code() == 0
        assert terminal.is_as_before
    finally:
        for loop in loops:
            loop.close()
        for left in files.DIRECTORY.glob(f"rtarm.{arm_name}.*"):  # of the one that was killed
            left.unlink()


def test_no_more_happenings_are_kept_than_are_shown(arm: WrittenArm, watch: Watch) -> None:
    for number in range(3 * HAPPENINGS):
        told(arm, Event.GOAL, code=number)
    shown = [one.sentence for one in watch.look().happenings]
    newest = 3 * HAPPENINGS - 1
    assert shown == [f"Goal {number} was announced." for number in range(newest, newest - HAPPENINGS, -1)]
