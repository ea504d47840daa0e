"""Which cycles are late, and which text of the trace tells of them: with cycles and a trace that are made up."""

from __future__ import annotations

import io
import os
import re
import time

import numpy as np
import pytest
from rich.console import Console
from written_arm import PERIOD_NS, WrittenArm

from rtarm.console.chinese import WHY_LATE
from rtarm.why_late import watch
from rtarm.why_late.causes import Cause
from rtarm.why_late.divide import (
    BEFORE_US,
    BEHIND_US,
    DEBUGGER,
    HELD_BACK,
    NO_PRIORITY,
    SAME,
    SLOW_FAULT,
    STOPPER,
    Segment,
)
from rtarm.why_late.hints import counted
from rtarm.why_late.report import NAMES, Tally, causes_of, names_told, render, report_of
from rtarm.why_late.watch import MOST_A_LOOK, ArmCycles, Cycle, Late, Watcher, cpu_of, cycle_thread

MS = 1_000_000
BOUND_NS = MS // 10


class Cycles:
    """A source whose cycles are given to it."""

    period_ns = 5 * MS

    def __init__(self, *cycles: Cycle) -> None:
        self.cycles = list(cycles)

    def new(self) -> list[Cycle]:
        found, self.cycles = self.cycles, []
        return found


def ago(ms: float) -> int:
    return time.monotonic_ns() - round(ms * MS)


def slept_and_ran(asleep_ns: int, woken_ns: int, runs_ns: int) -> str:
    """The trace of a thread 10 that nothing but a late timer keeps from running on processor 1."""

    def line(time_ns: int, task: str, text: str) -> str:
        return f" {task} [001] d..2. {time_ns // 10**9}.{time_ns // 1000 % 10**6:06}: {text}\n"

    idle = "prev_comm=swapper/1 prev_pid=0 prev_prio=120 prev_state=R"
    return "".join(
        (
            line(
                asleep_ns,
                "cycle-10",
                "sched_switch: prev_comm=cycle prev_pid=10 prev_prio=19 prev_state=S ==> next_comm=swapper/1 "
                "next_pid=0 next_prio=120",
            ),
            line(woken_ns, "<idle>-0", "local_timer_entry: vector=236"),
            line(woken_ns, "<idle>-0", "hrtimer_expire_entry: hrtimer=1 function=hrtimer_wakeup now=1"),
            line(woken_ns, "<idle>-0", "sched_waking: comm=cycle pid=10 prio=19 target_cpu=001"),
            line(woken_ns, "<idle>-0", "hrtimer_expire_exit: hrtimer=1"),
            line(woken_ns, "<idle>-0", "local_timer_exit: vector=236"),
            line(runs_ns, "<idle>-0", f"sched_switch: {idle} ==> next_comm=cycle next_pid=10 next_prio=19"),
        )
    )


def test_a_late_cycle_is_divided_with_what_was_traced_before_and_behind_it() -> None:
    due_ns = ago(40) // 1000 * 1000
    text = slept_and_ran(due_ns - 4 * MS, due_ns + 2 * MS, due_ns + 2 * MS + 5000)
    first, second = text[: len(text) // 2], text[len(text) // 2 :]
    pieces = iter([first, second])
    source = Cycles()
    watcher = Watcher(source, 10, lambda: next(pieces), BOUND_NS)
    watcher.look()
    source.cycles = [Cycle(1, due_ns, due_ns + 2 * MS + 6000, due_ns + 2 * MS + 20_000)]
    watcher.look(settle_ns=0)
    (late,) = watcher.late
    assert (late.cycle, late.woke, late.length_ns) == (1, True, 2 * MS + 6000)
    assert late.by_cause == {Cause.TIMER_IDLE: 2 * MS, Cause.IDLE_EXIT: 5000, Cause.OWN: 1000}
    assert late.cause is Cause.TIMER_IDLE


def test_only_what_is_later_than_the_bound_or_takes_longer_than_usual_is_late() -> None:
    begun_ns = ago(400)
    cycles = [
        Cycle(n, begun_ns + 5 * MS * n, begun_ns + 5 * MS * n + 50_000, begun_ns + 5 * MS * n + 90_000)
        for n in range(50)
    ]
    cycles[20] = cycles[20]._replace(end_ns=cycles[20].woke_ns + 40_000 + BOUND_NS + 1)
    cycles[30] = cycles[30]._replace(woke_ns=cycles[30].due_ns + BOUND_NS + 1, end_ns=None)
    watcher = Watcher(Cycles(*cycles), 10, str, BOUND_NS)
    watcher.look()
    assert [(late.cycle, late.woke, late.cause) for late in watcher.late] == [
        (20, False, Cause.UNKNOWN),
        (30, True, Cause.UNKNOWN),
    ]
    assert (watcher.cycles, watcher.count, watcher.undivided) == (50, 2, 0)


def test_what_has_just_ended_waits_for_the_next_look() -> None:
    due_ns = ago(2)
    watcher = Watcher(Cycles(Cycle(1, due_ns, due_ns + MS, due_ns + MS)), 10, str, BOUND_NS)
    watcher.look()
    assert watcher.count == 0
    watcher.look(settle_ns=0)
    assert watcher.count == 1


def test_a_cycle_waits_for_its_events_to_be_read() -> None:
    """The reader may be behind; but it does not wait for ever."""
    due_ns = ago(60) // 1000 * 1000
    pieces = [
        slept_and_ran(due_ns - 5 * MS, due_ns, due_ns + 5000),
        slept_and_ran(due_ns + 3 * MS, due_ns + 6 * MS, due_ns + 7 * MS),
    ]
    unseen = [Cycle(number, ago(3000), ago(2900), None) for number in (1, 2)]
    source = Cycles(*unseen, Cycle(3, due_ns, due_ns + MS, due_ns + MS + 1000))
    watcher = Watcher(source, 10, lambda: pieces.pop(0), BOUND_NS)
    watcher.look()
    assert (watcher.cycles, watcher.count) == (2, 2)
    watcher.look()
    assert (watcher.cycles, watcher.count) == (3, 3)
    assert watcher.late[-1].by_cause == {Cause.IDLE_EXIT: 5000, Cause.OWN: MS - 5000}


def test_what_was_traced_is_kept_as_long_as_the_cycle_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that stands still for seconds is told from its begin, as far as there is room."""
    begun_ns = ago(9000) // 1000 * 1000
    pieces = [slept_and_ran(begun_ns + n * 100 * MS, begun_ns, begun_ns) for n in range(80)]
    feed = iter(pieces)
    watcher = Watcher(Cycles(Cycle(1, begun_ns, begun_ns, begun_ns)), 10, lambda: next(feed), BOUND_NS)
    for _ in range(40):
        watcher.look()
    assert len(watcher._text) == 40
    monkeypatch.setattr(watch, "MOST_TEXT", 10 * len(pieces[0]))
    for _ in range(40):
        watcher.look()
    assert len(watcher._text) == 10


def test_a_cycle_that_is_due_while_the_one_before_works_does_not_sleep_for_its_timer() -> None:
    due_ns = ago(60) // 1000 * 1000
    text = slept_and_ran(due_ns - 2 * MS, due_ns + 2 * MS, due_ns + 2 * MS)
    early, overran = (Cycle(1, due_ns - 5 * MS, due_ns - 5 * MS, due_ns + end_ns) for end_ns in (-3 * MS, 2 * MS))
    for before, cause in ((early, Cause.TIMER_IDLE), (overran, Cause.BLOCKED)):
        cycles = before, Cycle(2, due_ns, due_ns + 2 * MS, None)
        watcher = Watcher(Cycles(*cycles), 10, lambda: text, BOUND_NS)
        watcher.look(settle_ns=0)
        assert watcher.late[-1].by_cause == {cause: 2 * MS}


def test_the_latest_of_too_many_are_divided_and_the_others_counted() -> None:
    begun_ns = ago(800)
    cycles = [
        Cycle(n, begun_ns + 5 * MS * n, begun_ns + 5 * MS * n + BOUND_NS + 1 + n, None) for n in range(MOST_A_LOOK + 7)
    ]
    watcher = Watcher(Cycles(*cycles), 10, str, BOUND_NS)
    watcher.look()
    assert (watcher.count, watcher.undivided) == (MOST_A_LOOK + 7, 7)
    assert [late.cycle for late in watcher.late] == list(range(7, MOST_A_LOOK + 7))


@pytest.mark.parametrize(("stolen_ms", "cause"), [(10, Cause.STOOD_STILL), (0, Cause.TIMER_IDLE)])
def test_what_the_host_took_around_a_late_cycle(monkeypatch: pytest.MonkeyPatch, stolen_ms: int, cause: Cause) -> None:
    counted = iter([0, 0, stolen_ms * MS])
    monkeypatch.setattr(watch, "stolen_ns", lambda _: next(counted))
    source = Cycles()
    watcher = Watcher(source, 10, lambda: "".join(text), BOUND_NS)
    text = [""]
    watcher.look()
    due_ns = time.monotonic_ns() // 1000 * 1000 + MS
    while time.monotonic_ns() < due_ns + 8 * MS:
        pass
    text[0] = slept_and_ran(due_ns - 2 * MS, due_ns + 7 * MS, due_ns + 7 * MS)
    source.cycles = [Cycle(1, due_ns, due_ns + 7 * MS, due_ns + 7 * MS)]
    watcher.look(settle_ns=0)
    assert watcher.late[0].by_cause == {cause: 7 * MS}


def test_the_count_of_another_processor_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    processors = iter([0, 1])
    monkeypatch.setattr(watch, "cpu_of", lambda _: next(processors))
    monkeypatch.setattr(watch, "stolen_ns", lambda cpu: cpu * 10 * MS)
    due_ns = time.monotonic_ns() // 1000 * 1000 + MS
    source = Cycles(Cycle(1, due_ns, due_ns + 7 * MS, None))
    watcher = Watcher(source, 10, lambda: slept_and_ran(due_ns - 2 * MS, due_ns + 7 * MS, due_ns + 7 * MS), BOUND_NS)
    while time.monotonic_ns() < due_ns + 8 * MS:
        pass
    watcher.look(settle_ns=0)
    assert watcher.late[0].by_cause == {Cause.TIMER_IDLE: 7 * MS}


def test_the_cycles_of_an_arm(arm: WrittenArm) -> None:
    """Due, woken, ended; a cycle that is late by periods moves to the last of them, and its record says so."""
    memory = arm.files.state
    source = ArmCycles(memory)
    assert source.new() == []
    assert source.period_ns == PERIOD_NS
    record = np.zeros(3, [("number", "i8"), ("monotonic_ns", "i8"), ("lateness_ns", "i8"), ("cycle_time_ns", "i8")])
    late_ns = 2 * PERIOD_NS + 5
    record["number"] = 1, 2, 4
    record["monotonic_ns"] = np.array([1, 4, 6]) * PERIOD_NS
    record["lateness_ns"] = 7, late_ns, 0
    record["cycle_time_ns"] = 100, 200, 300
    assert source.taken(record) == [
        Cycle(1, PERIOD_NS, PERIOD_NS + 7, PERIOD_NS + 207),
        Cycle(2, 2 * PERIOD_NS, 2 * PERIOD_NS + late_ns, None),
    ]
    assert source.taken(record[:0]) == []


def test_the_thread_of_the_cycle_is_told_as_long_as_it_is_there(arm: WrittenArm) -> None:
    own = os.getpid()
    arm.state["header"]["pid"] = arm.state["scheduling"]["thread_id"] = own
    assert cycle_thread(arm.files.state) == own
    arm.state["scheduling"]["thread_id"] = 0x7FFFFFFF
    with pytest.raises(OSError):
        cycle_thread(arm.files.state)


def test_the_processor_of_a_thread() -> None:
    assert cpu_of(os.getpid()) in range(os.cpu_count() or 1)
    assert cpu_of(0) == -1


# --- the report ---------------------------------------------------------------------------------------------


def late(*parts: tuple[int, Cause, str], cycle: int = 1) -> Late:
    segments, at_ns = [], 1000
    for length_ns, cause, who in parts:
        segments.append(Segment(at_ns, at_ns + length_ns, cause, who))
        at_ns += length_ns
    return Late.of(cycle, True, segments)


def test_causes_have_shares_names_and_a_worst_example() -> None:
    found = causes_of(
        [
            late((600, Cause.TASK, "hog 2"), (400, Cause.INTERRUPT, "disk")),
            late((800, Cause.TASK, "cat 3"), (200, Cause.OWN, ""), cycle=2),
        ]
    )
    assert [(one["cause"], one["share"], one["cycles"]) for one in found] == [
        ("other_task", 0.7, 2),
        ("interrupt", 0.2, 0),
        ("own_work", 0.1, 0),
    ]
    assert found[0]["mostly"] == [{"who": "cat 3", "us": 0.8}, {"who": "hog 2", "us": 0.6}]
    assert found[0]["worst"]["cycle"] == 1
    assert found[1]["worst"] is None


def test_a_time_line_has_neighbours_of_one_cause_together_and_no_short_ones() -> None:
    one = late((50, Cause.INTERRUPT, "a"), (90, Cause.INTERRUPT, "b"), (1, Cause.OWN, ""), (60, Cause.TASK, "c"))
    assert one.segments == (
        Segment(1000, 1140, Cause.INTERRUPT, "b"),
        Segment(1141, 1201, Cause.TASK, "c"),
    )
    assert one.by_cause == {Cause.INTERRUPT: 140, Cause.OWN: 1, Cause.TASK: 60}


def test_a_flood_of_interrupts_takes_little_room() -> None:
    names = ("local_timer", "local_timer: timerfd_tmrproc")
    one = late(*((1000, Cause.INTERRUPT, names[number % 2]) for number in range(8000)))
    assert one.segments == (Segment(1000, 8_001_000, Cause.INTERRUPT, names[0]),)
    assert one.by_name == {(Cause.INTERRUPT, name): 4_000_000 for name in names}


PHRASES = (STOPPER, BEFORE_US, NO_PRIORITY, SAME, BEHIND_US, HELD_BACK, DEBUGGER, SLOW_FAULT)


@pytest.mark.parametrize("phrase", PHRASES)
def test_what_is_said_of_a_task_has_its_chinese(phrase: str) -> None:
    told = names_told(f"hog 2 (real-time 95: {phrase})", "zh")
    assert told == f"hog 2 (实时 95: {WHY_LATE[phrase]})"


def test_what_is_counted_has_its_chinese() -> None:
    for what in counted(os.getpid(), cpu_of(os.getpid())):
        assert names_told(what, "zh") != what


def test_a_report_in_chinese() -> None:
    console = Console(width=100, file=io.StringIO())
    watcher = Watcher(Cycles(), 10, str, BOUND_NS)
    watcher.late.append(late((600, Cause.TASK, "hog [2] (nice 0: before us)"), (400, Cause.INTERRUPT, "disk")))
    hint = {"what": "page faults", "a_look_with_late_cycles": 2.5, "a_look_without": 0.0}
    console.print(render({**report_of("a", 5.0, 100.0, watcher, []), "undivided": 3, "hints": [hint]}, "zh"))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for part in ("a：5 s 内", "原因", "另一个任务", "hog [2] (nice 0: 先于我们)", "周期 1 晚醒", "3 个延迟", "0  缺页"):
        assert part in text
    words = set(re.findall(r"[a-z]{4,}", text))
    assert words <= {"nice", "disk"}


def test_names_of_days_take_little_room() -> None:
    tally = Tally()
    for number in range(5 * NAMES):
        tally.add(late((600 if number == 7 else 1, Cause.TASK, f"cat {number}"), cycle=number))
    (task,) = tally.causes()
    assert (task["cycles"], task["us"]) == (5 * NAMES, (5 * NAMES + 599) / 1000)
    assert (task["mostly"][0]["who"], task["worst"]["cycle"]) == ("cat 7", 7)
    assert len(tally._names[Cause.TASK]) <= 2 * NAMES


def test_a_report_of_nothing_and_one_of_something() -> None:
    watcher = Watcher(Cycles(), 10, str, BOUND_NS)
    console = Console(width=100, file=io.StringIO())
    console.print(render({**report_of("a", 5.0, 100.0, watcher, ["A note."]), "hints": []}))
    watcher.late.append(late((600, Cause.TASK, "hog [2]"), (400, Cause.INTERRUPT, "disk")))
    hint = {"what": "page faults", "a_look_with_late_cycles": 2.5, "a_look_without": 0.0}
    console.print(render({**report_of("a", 5.0, 100.0, watcher, []), "undivided": 3, "hints": [hint]}))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for part in ("none later than 100 µs", "A note.", "60.0%", "hog [2]", "██", "3 late cycles", "2.5 and 0  page"):
        assert part in text
