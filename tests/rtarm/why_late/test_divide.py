"""Where a thread's time goes: known events give known causes, and any events give segments that fit together."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pytest
from depth import examples
from dividing import divide
from hypothesis import given, settings
from hypothesis import strategies as st

from rtarm.why_late.causes import Cause
from rtarm.why_late.divide import FAULT_NS, HELD_BACK, STILL_NS, Segment, stood_still
from rtarm.why_late.events import (
    Enter,
    Event,
    Exit,
    Fault,
    Lost,
    Moved,
    Sent,
    Signal,
    Switch,
    Task,
    Woken,
    Work,
)

US = 1000
US_NAME = "cycle"
CYCLE = Task(US_NAME, 10, 19)
"""Real-time priority 80."""
IDLE = Task("swapper/1", 0, 120)
HOG = Task("hog", 20, 4)
CALM = Task("calm", 30, 120)
TIMER = Enter("local_timer", "local_timer", hard=True)
CALLBACK = Enter("hrtimer", "hrtimer_wakeup", hard=True, timer=True)


def at(time_us: float, task: Task, what: object, cpu: int = 1) -> Event:
    return Event(round(time_us * US), cpu, task, what)  # type: ignore[arg-type]


def asleep(task: Task = IDLE, time_us: float = 0.0) -> list[Event]:
    """The cycle goes to sleep, and a task runs."""
    return [at(time_us, CYCLE, Switch(CYCLE, "S", task))]


def fired(time_us: float, task: Task = IDLE) -> list[Event]:
    """Its timer wakes it, in 4 µs."""
    return [
        at(time_us, task, TIMER),
        at(time_us + 1, task, CALLBACK),
        at(time_us + 2, task, Woken(10, 1)),
        at(time_us + 3, task, Exit("hrtimer")),
        at(time_us + 4, task, Exit("local_timer")),
    ]


def runs(time_us: float, task: Task = IDLE, state: str = "R") -> list[Event]:
    return [at(time_us, task, Switch(task, state, CYCLE))]


def divided(events: Sequence[Event], start_us: float, end_us: float) -> list[tuple[float, Cause, str]]:
    """Length in µs, cause and name of each segment."""
    segments = divide(events, 10, round(start_us * US), round(end_us * US))
    return [(segment.length_ns / US, segment.cause, segment.who) for segment in segments]


# --- known scripts ------------------------------------------------------------------------------------------


def test_a_timer_that_is_late_out_of_idle() -> None:
    assert divided([*asleep(), *fired(150), *runs(160)], 100, 165) == [
        (50, Cause.TIMER_IDLE, ""),
        (1, Cause.INTERRUPT, "local_timer"),
        (2, Cause.INTERRUPT, "local_timer: hrtimer_wakeup"),
        (1, Cause.INTERRUPT, "local_timer"),
        (6, Cause.IDLE_EXIT, ""),
        (5, Cause.OWN, ""),
    ]


def test_a_timer_that_does_not_fire_while_a_task_runs() -> None:
    assert divided([*asleep(CALM), *fired(150, CALM), *runs(160, CALM)], 100, 150) == [(50, Cause.MASKED, "calm 30")]


def test_a_timer_that_does_not_fire_in_a_softirq() -> None:
    events = [*asleep(CALM), at(90, CALM, Enter("softirq 9", "RCU", hard=False)), *fired(150, CALM)]
    assert divided(events, 100, 150) == [(50, Cause.MASKED, "softirq RCU")]


def test_another_interrupt_before_the_timer() -> None:
    events = [
        *asleep(),
        at(95, IDLE, Enter("irq 36", "virtio1-req.0 (irq 36)", hard=True)),
        at(140, IDLE, Exit("irq 36")),
        *fired(141),
    ]
    assert divided(events, 100, 141)[0] == (40, Cause.INTERRUPT, "virtio1-req.0 (irq 36)")


def test_callbacks_of_other_timers_in_the_same_interrupt() -> None:
    events = [*asleep(), at(99, IDLE, TIMER)]
    for number in range(10):
        events.append(at(100 + 10 * number, IDLE, Enter("hrtimer", "timerfd_tmrproc", hard=True, timer=True)))
        events.append(at(110 + 10 * number, IDLE, Exit("hrtimer")))
    events += [*fired(200)[1:], *runs(206)]
    assert divided(events, 100, 200) == [(100, Cause.INTERRUPT, "local_timer: timerfd_tmrproc")]


def test_the_interrupt_of_another_processor_is_none_of_ours() -> None:
    events = [*asleep(), at(99, CALM, TIMER, cpu=0), *fired(150)]
    assert divided(events, 100, 150) == [(50, Cause.TIMER_IDLE, "")]


def test_who_asked_for_an_interrupt() -> None:
    events = [
        *asleep(),
        at(80, CALM, Sent(frozenset([1])), cpu=0),
        at(90, IDLE, Enter("call_function", "call_function", hard=True)),
        at(150, IDLE, Exit("call_function")),
        *fired(151),
    ]
    assert divided(events, 100, 150) == [(50, Cause.INTERRUPT, "call_function from calm 30")]


def test_a_task_of_higher_priority() -> None:
    events = [*asleep(HOG), *fired(100, HOG), *runs(3000, HOG, "S")]
    assert divided(events, 104, 3000) == [(2896, Cause.TASK, "hog 20 (real-time 95: before us)")]


@pytest.mark.parametrize(
    ("task", "prio", "why"),
    [
        (CALM, 19, "calm 30 (nice 0: behind us, but could not be interrupted at once)"),
        (HOG, 4, "hog 20 (real-time 95: same as ours, and came first)"),
        (Task("dl", 60, -1), 19, "dl 60 (deadline: before us)"),
        (CALM, 120, "calm 30 (nice 0: we have no real-time priority)"),
        (Task("migration/1", 18, 0), 19, "migration/1 18: the kernel's stopper, before all others"),
    ],
)
def test_why_another_task_could_run(task: Task, prio: int, why: str) -> None:
    cycle = CYCLE._replace(prio=prio)
    other = [at(0, cycle, Switch(cycle, "S", IDLE)), at(50, IDLE, Switch(IDLE, "R", task))]
    assert divided([*other, *fired(100, task), *runs(150, task)], 104, 150) == [(46, Cause.TASK, why)]


def test_what_a_worker_of_the_kernel_was_doing() -> None:
    worker = Task("kworker/1:0", 40, 120)
    events = [*asleep(worker), at(50, worker, Work("psi_avgs_work")), *fired(100, worker), *runs(150, worker)]
    assert divided(events, 104, 150)[0][2].startswith("kworker/1:0 40, psi_avgs_work (nice 0")


def test_a_softirq_that_the_cycle_waits_for() -> None:
    events = [
        *asleep(),
        *fired(100),
        at(104, IDLE, Enter("softirq 3", "NET_RX", hard=False)),
        at(180, IDLE, Exit("softirq 3")),
    ]
    assert divided([*events, *runs(181)], 104, 181) == [(76, Cause.SOFTIRQ, "NET_RX"), (1, Cause.IDLE_EXIT, "")]


def test_moved_to_another_processor() -> None:
    other = Task("swapper/0", 0, 120)
    events = [*asleep(CALM), *fired(100, CALM), at(103, CALM, Moved(10, 0)), at(105, other, Woken(10, 0), cpu=0)]
    events += [at(50, CALM, Switch(CALM, "R", other), cpu=0), at(150, other, Switch(other, "R", CYCLE), cpu=0)]
    events.sort(key=lambda event: event.time_ns)
    assert divided(events, 105, 150) == [(45, Cause.MIGRATION, "")]


def test_stopped_by_a_signal() -> None:
    shell = Task("bash", 50)
    events = [
        *asleep(),
        at(50, shell, Signal(19, 9), cpu=0),
        at(52, shell, Woken(10, 1), cpu=0),
        *runs(60),
        at(65, CYCLE, Switch(CYCLE, "T", IDLE)),
        at(20_000, shell, Woken(10, 1), cpu=0),
        *runs(20_010),
    ]
    assert divided(events, 100, 20_015) == [
        (19_900, Cause.STOPPED, "SIGSTOP from bash 50"),
        (10, Cause.IDLE_EXIT, ""),
        (5, Cause.OWN, ""),
    ]


def test_our_own_work_and_what_interrupts_it() -> None:
    events = [
        *runs(0),
        at(100, CYCLE, TIMER),
        at(110, CYCLE, Exit("local_timer")),
        at(150, CYCLE, Switch(CYCLE, "R", HOG)),
    ]
    assert divided([*events, *runs(200, HOG, "S")], 50, 250) == [
        (50, Cause.OWN, ""),
        (10, Cause.INTERRUPT, "local_timer"),
        (40, Cause.OWN, ""),
        (50, Cause.TASK, "hog 20 (real-time 95: before us)"),
        (50, Cause.OWN, ""),
    ]


def test_page_faults_last_until_the_next_event_and_not_for_long() -> None:
    events = [*runs(0), at(100, CYCLE, Fault()), at(105, CYCLE, Fault()), at(200, CYCLE, Switch(CYCLE, "S", IDLE))]
    assert [found[:2] for found in divided(events, 90, 200)] == [
        (10, Cause.OWN),
        (5 + FAULT_NS / US, Cause.PAGE_FAULT),
        (95 - FAULT_NS / US, Cause.UNKNOWN),
    ]


def test_a_page_that_comes_from_the_disk() -> None:
    events = [*runs(0), at(100, CYCLE, Fault()), at(105, CYCLE, Switch(CYCLE, "D", IDLE))]
    events.append(at(900, IDLE, Woken(10, 1))._replace(bare=True))
    assert divided([*events, *runs(905)], 100, 900) == [(800, Cause.PAGE_FAULT, "")]


def test_a_wait_for_something_else_than_a_timer() -> None:
    woken = at(300, CALM, Woken(10, 1), cpu=0)
    events = [*runs(0), at(100, CYCLE, Switch(CYCLE, "S", IDLE)), woken._replace(bare=True), *runs(310)]
    assert divided(events, 100, 300) == [(200, Cause.BLOCKED, "")]
    events[2] = woken  # in an interrupt of a processor that is not traced, which may have been the timer's
    assert divided(events, 100, 300) == [(200, Cause.UNKNOWN, "")]
    events[2:2] = [at(290, CALM, Enter("irq 5", "disk", hard=True), cpu=0)]
    assert divided(events, 100, 300) == [(200, Cause.BLOCKED, "")]


def test_what_was_not_seen_is_unknown() -> None:
    assert divided([], 0, 100) == [(100, Cause.UNKNOWN, "")]
    assert divided([*runs(60)], 0, 100) == [(60, Cause.UNKNOWN, ""), (40, Cause.OWN, "")]
    assert divided([*asleep()], 10, 100) == [(90, Cause.UNKNOWN, "")]  # nobody was seen to wake it
    lost = [*runs(0), at(40, CYCLE, Lost()), at(70, CALM, Exit("softirq 1"))]
    assert divided(lost, 0, 100) == [(40, Cause.OWN, ""), (60, Cause.UNKNOWN, "")]


def test_a_switch_from_idle_that_the_kernel_does_not_tell() -> None:
    """The hog is seen first where the timer interrupts it, and its priority where it leaves."""
    events = [*asleep(), at(90, IDLE, TIMER), at(95, IDLE, Exit("local_timer")), *fired(100, HOG._replace(prio=None))]
    assert divided([*events, *runs(3000, HOG, "S")], 98, 3000) == [
        (2, Cause.MASKED, "hog 20"),
        (1, Cause.INTERRUPT, "local_timer"),
        (2, Cause.INTERRUPT, "local_timer: hrtimer_wakeup"),
        (1, Cause.INTERRUPT, "local_timer"),
        (2896, Cause.TASK, "hog 20 (real-time 95: before us)"),
    ]


def test_the_cycle_leaves_idle_and_the_kernel_does_not_tell() -> None:
    events = [*asleep(), *fired(100), at(2000, CYCLE, Switch(CYCLE, "S", IDLE))]
    assert divided(events, 104, 110) == [(6, Cause.IDLE_EXIT, "")]
    (segment,) = divide(events, 10, 110_000, 2_000_000, runs=True)
    assert segment == Segment(110_000, 2_000_000, Cause.OWN)


def test_a_timer_of_another_wait_is_no_late_one() -> None:
    """A wait for the wire that ends by its time limit, in the cycle's work or in that of the one before."""
    events = [*runs(0), at(100, CYCLE, Switch(CYCLE, "S", IDLE)), *fired(1100), *runs(1105)]
    (*_, wait) = divide(events, 10, 50_000, 1_100_000, runs=True)
    assert wait == Segment(100_000, 1_100_000, Cause.BLOCKED)
    assert divided(events, 50, 1100)[-1] == (1000, Cause.BLOCKED, "")
    assert divided(events, 101, 1100) == [(999, Cause.TIMER_IDLE, "")]
    assert divide(events, 10, 101_000, 1_100_000, slept_by_ns=0) == [Segment(101_000, 1_100_000, Cause.BLOCKED)]


def test_a_timer_that_a_softirq_calls() -> None:
    events = [
        *asleep(CALM),
        *fired(50, CALM),
        at(60, CALM, Enter("softirq 8", "HRTIMER", hard=False)),
        at(61, CALM, Enter("hrtimer", "slow", hard=False, timer=True)),
        at(90, CALM, Exit("softirq 8")),
    ]
    assert divided(events, 54, 90) == [
        (6, Cause.TASK, "calm 30 (nice 0: behind us, but could not be interrupted at once)"),
        (1, Cause.SOFTIRQ, "HRTIMER"),
        (29, Cause.SOFTIRQ, "slow"),
    ]


def test_the_end_of_a_timer_need_not_be_told() -> None:
    events = [event for event in [*asleep(), *fired(100), *runs(110)] if event.what != Exit("hrtimer")]
    assert divided(events, 100, 110) == [
        (1, Cause.INTERRUPT, "local_timer"),
        (3, Cause.INTERRUPT, "local_timer: hrtimer_wakeup"),
        (6, Cause.IDLE_EXIT, ""),
    ]
    many = [at(99, IDLE, TIMER), *(at(100 + number, IDLE, CALLBACK) for number in range(50))]
    assert divided([*asleep(), *many, *fired(150)[2:]], 100, 150) == [
        (50, Cause.INTERRUPT, "local_timer: hrtimer_wakeup")
    ]


def test_what_was_lost_is_unknown_from_the_last_event_before_it() -> None:
    """The hog was the last that was seen; what ran then, and in which interrupt, is not known."""
    events = [*asleep(HOG), at(200, HOG, Lost()), at(500, HOG, Exit("hrtimer")), *fired(600, HOG)[1:]]
    assert {cause for _, cause, _ in divided(events, 200, 600)} == {Cause.UNKNOWN}
    bare = [*events, at(605, HOG, Work(""))._replace(bare=True)]
    assert divided(bare, 605, 610) == [(5, Cause.TASK, "hog 20 (real-time 95: before us)")]


def test_who_waits_may_have_been_moved_to_where_events_were_lost() -> None:
    events = [*asleep(HOG), *fired(100, HOG), at(150, HOG, Lost(), cpu=0), *runs(300, HOG)]
    assert [found[:2] for found in divided(events, 104, 300)] == [(46, Cause.TASK), (150, Cause.UNKNOWN)]


def test_an_event_of_another_processor_says_nothing_of_what_that_is_in() -> None:
    """Nothing but signals and wake-ups may be traced there; so the one that it is moved to is not known."""
    events = [*asleep(CALM), at(50, HOG, Signal(19, 9), cpu=0), *fired(100, CALM), at(110, CALM, Moved(10, 0))]
    assert divided(events, 110, 200) == [(90, Cause.UNKNOWN, "")]


def test_who_asked_for_an_interrupt_is_forgotten_soon() -> None:
    events = [
        *asleep(),
        at(80, CALM, Sent(frozenset([1])), cpu=0),
        at(2000, IDLE, Enter("irq_work", "irq_work", hard=True)),
        at(2050, IDLE, Exit("irq_work")),
        *fired(2060),
    ]
    assert divided(events, 2000, 2050) == [(50, Cause.INTERRUPT, "irq_work")]


def test_a_ready_thread_beside_an_idle_processor_is_held_back() -> None:
    events = [*runs(0), at(100, CYCLE, Switch(CYCLE, "R", IDLE)), *runs(50_000)]
    assert divided(events, 100, 50_000) == [(49_900, Cause.UNKNOWN, HELD_BACK)]


# --- stolen time --------------------------------------------------------------------------------------------


def test_only_the_hosts_own_count_tells_of_a_stolen_processor() -> None:
    late = [Segment(0, 8_000_000, Cause.TIMER_IDLE), Segment(8_000_000, 8_004_000, Cause.INTERRUPT, "local_timer")]
    assert stood_still(late, 0) == late
    assert stood_still(late, 10_000_000)[0].cause is Cause.STOOD_STILL
    assert stood_still(late, 10_000_000)[1:] == late[1:]
    hog = [Segment(0, 8_000_000, Cause.TASK, "hog 20")]
    assert stood_still(hog, 10_000_000) == hog  # it ran: who knows for how long
    short = [Segment(0, STILL_NS - 1, Cause.MASKED, "calm 30")]
    assert stood_still(short, 10_000_000) == short


# --- any events ---------------------------------------------------------------------------------------------

tasks = st.sampled_from([CYCLE, IDLE, HOG, CALM, Task("lost", -1)])
pids = st.sampled_from([10, 20, 30])
cpus = st.integers(0, 2)
enters = st.sampled_from([TIMER, CALLBACK, Enter("irq 5", "disk", hard=True), Enter("softirq 3", "NET_RX", hard=False)])
whats = st.one_of(
    st.builds(Switch, tasks, st.sampled_from(["R", "R+", "S", "D", "T", "t", "X"]), tasks),
    st.builds(Woken, pids, cpus),
    st.builds(Moved, pids, cpus),
    enters,
    st.sampled_from(["local_timer", "hrtimer", "irq 5", "softirq 3", "never"]).map(Exit),
    st.builds(Fault),
    st.builds(Signal, st.integers(17, 23), pids),
    st.builds(Work, st.sampled_from(["", "flush"])),
    st.frozensets(cpus).map(Sent),
    st.builds(Lost),
)
any_events = st.lists(st.builds(Event, st.integers(0, 100_000), cpus, tasks, whats, st.booleans()), max_size=40).map(
    lambda events: sorted(events, key=lambda event: event.time_ns)
)


@settings(max_examples=examples(500), deadline=None)
@given(any_events, st.integers(0, 100_000), st.integers(0, 60_000), st.integers(0, 10_000_000), st.booleans())
def test_segments_add_up_to_the_interval(
    events: list[Event], start_ns: int, length_ns: int, stolen_ns: int, runs: bool
) -> None:
    segments = divide(events, 10, start_ns, start_ns + length_ns, runs=runs)
    for found in (segments, stood_still(segments, stolen_ns)):
        assert sum(segment.length_ns for segment in found) == length_ns
        assert all(segment.length_ns > 0 for segment in found)
        assert all(one.end_ns == other.start_ns for one, other in pairwise(found))
        assert all((one.cause, one.who) != (other.cause, other.who) for one, other in pairwise(found))
        if found:
            assert (found[0].start_ns, found[-1].end_ns) == (start_ns, start_ns + length_ns)


@settings(max_examples=examples(200), deadline=None)
@given(any_events, st.integers(0, 50_000), st.integers(1, 20_000), st.integers(1, 20_000))
def test_an_interval_in_two_parts_has_the_same_causes(
    events: list[Event], start_ns: int, one_ns: int, two_ns: int
) -> None:
    middle_ns, end_ns = start_ns + one_ns, start_ns + one_ns + two_ns
    whole = divide(events, 10, start_ns, end_ns)
    parts = divide(events, 10, start_ns, middle_ns)
    parts += divide(events, 10, middle_ns, end_ns, slept_by_ns=start_ns)
    for segment in parts:
        assert any(
            whole_one.start_ns <= segment.start_ns
            and segment.end_ns <= whole_one.end_ns
            and whole_one.cause is segment.cause
            for whole_one in whole
        )


def test_nothing_is_said_of_no_time() -> None:
    assert divide(asleep(), 10, 100, 100) == []
