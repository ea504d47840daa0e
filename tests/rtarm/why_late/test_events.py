"""What the kernel writes, recorded on Linux 6.18 (x86-64) and an ARM64 form of it, and what is read of it."""

from __future__ import annotations

import pytest
from depth import examples
from dividing import divide
from hypothesis import given, settings
from hypothesis import strategies as st

from rtarm.why_late.causes import Cause
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
    parse,
    since,
    time_of,
)

LINES = {
    "          python-18064   [001] d..2.  2725.663373: sched_switch: prev_comm=python prev_pid=18064 prev_prio=130 "
    "prev_state=R+ ==> next_comm=cyclictest next_pid=18194 next_prio=19": Switch(
        Task("python", 18064, 130), "R+", Task("cyclictest", 18194, 19)
    ),
    "          <idle>-0       [001] d..2.  2725.663373: sched_switch: prev_comm=swapper/1 prev_pid=0 prev_prio=120 "
    "prev_state=R ==> next_comm=a b-c d next_pid=7 next_prio=-1": Switch(
        Task("swapper/1", 0, 120), "R", Task("a b-c d", 7, -1)
    ),
    "          python-18064   [001] d.h2.  2725.663360: sched_waking: comm=cyclictest pid=18194 prio=19 "
    "target_cpu=001": Woken(18194, 1),
    "          python-18064   [001] dNh3.  2725.663362: sched_wakeup: comm=cyclictest pid=18194 prio=19 "
    "target_cpu=001": Woken(18194, 1),
    "          python-16744   [000] dNs1.  2725.144167: sched_migrate_task: comm=python pid=16822 prio=125 orig_cpu=1 "
    "dest_cpu=0": Moved(16822, 0),
    "          python-18064   [001] d.h..  2725.663359: local_timer_entry: vector=236": Enter(
        "local_timer", "local_timer", hard=True
    ),
    "          python-18064   [001] dNh..  2725.663370: local_timer_exit: vector=236": Exit("local_timer"),
    "          python-18064   [001] d.h..  2725.663360: hrtimer_expire_entry: hrtimer=0000000057389954 "
    "function=hrtimer_wakeup now=2725663359302": Enter("hrtimer", "hrtimer_wakeup", hard=True, timer=True),
    "          python-18064   [001] dNh..  2725.663363: hrtimer_expire_exit: hrtimer=0000000057389954": Exit("hrtimer"),
    "          python-18064   [001] d.h..  2725.582843: irq_handler_entry: irq=36 name=virtio1-req.0": Enter(
        "irq 36", "virtio1-req.0 (irq 36)", hard=True
    ),
    "          python-18064   [001] d.h..  2725.582847: irq_handler_exit: irq=36 ret=handled": Exit("irq 36"),
    "          python-18113   [000] .Ns..  2725.152033: softirq_entry: vec=9 [action=RCU]": Enter(
        "softirq 9", "RCU", hard=False
    ),
    "          python-18113   [000] .Ns..  2725.152040: softirq_exit: vec=9 [action=RCU]": Exit("softirq 9"),
    "            bash-18183   [001] d....  2725.663419: page_fault_user: address=0x55c6a218c0b0 ip=0x55c67459a5eb "
    "error_code=0x7": Fault(),
    "      cyclictest-18192   [000] d....  2725.157092: page_fault_kernel: address=0x7f9ca7733a10 ip=__put_user_4 "
    "error_code=0x3": Fault(),
    "           sleep-18193   [001] dN.2.  2725.662211: signal_generate: sig=19 errno=0 code=0 comm=python pid=18183 "
    "grp=1 res=0": Signal(19, 18183),
    "     kworker/1:0-6449    [001] .....  2725.660129: workqueue_execute_start: work struct 00000000614104ec: "
    "function psi_avgs_work": Work("psi_avgs_work"),
    "     kworker/1:0-6449    [001] .....  2725.660139: workqueue_execute_end: work struct 00000000614104ec: function "
    "psi_avgs_work": Work(""),
    "     migration/0-18      [000] d..5.  2725.160275: ipi_send_cpu: cpu=1 callsite=wakeup_preempt+0x92/0xa0 "
    "callback=0x0": Sent(frozenset([1])),
    "          python-1       [000] d..5.  2725.160275: ipi_send_cpumask: cpumask=00000000,0000000a callsite=f+0x1/0x2 "
    "callback=g+0x0/0x10": Sent(frozenset([1, 3])),
    # as an ARM64 kernel writes what its processors send each other, whose vectors have no events
    "          <idle>-0       [003] d.h1    10.000001: ipi_entry: (Rescheduling interrupts)": Enter(
        "ipi", "Rescheduling interrupts", hard=True
    ),
    "          <idle>-0       [003] d.h1    10.000002: ipi_exit: (Rescheduling interrupts)": Exit("ipi"),
    "            bash-1       [000] d..5.    10.000003: ipi_raise: target_mask=00000000,00000002 (Function call "
    "interrupts)": Sent(frozenset([1])),
    "CPU:1 [LOST 1234 EVENTS]": Lost(),
}
NOTHING = (
    "# tracer: nop",
    "",
    "##### CPU 1 buffer started ####",
    "          python-18064   [001] d.h..  2725.663359: vector_alloc: irq=1 vector=2",
    "          python-18064   [001] d....  2725.663359: sched_switch: prev_comm=python prev_pid=",
    "          python-18064   [001] d....  2725.6",
    "          python-1       [000] d..5.  2725.160275: ipi_send_cpumask: cpumask=1,3-4 callsite=f+0x1/0x2",
    "          python-18064   [001] d....  2725.663359: something_of_tomorrow: what=1",
)


@pytest.mark.parametrize("line", LINES)
def test_a_line_is_an_event(line: str) -> None:
    (event,) = parse([line])
    assert event.what == LINES[line]


def test_whom_a_line_is_about_and_when() -> None:
    line = next(iter(LINES))
    assert next(iter(parse([line])))[:3] == (2_725_663_373_000, 1, Task("python", 18064))
    with_group = line.replace("-18064 ", "-18064 (  18000) ")  # as with the option record-tgid
    assert list(parse([with_group])) == list(parse([line]))
    (bare,) = parse([line])
    assert bare.bare
    assert list(parse([line.replace(" d..2.", "")])) == [bare._replace(bare=False)]  # without the option irq-info
    spaced = line.replace("  python-18064", "a b-c-18064")
    assert next(iter(parse([spaced]))).task == Task("a b-c", 18064)


@pytest.mark.parametrize("line", NOTHING)
def test_what_means_nothing_is_passed_over(line: str) -> None:
    assert list(parse([line])) == []


def test_lost_events_are_missing_behind_the_last_of_their_processor() -> None:
    line, other = next(iter(LINES)), "          <idle>-0       [000] d.h..  2725.700000: local_timer_entry: vector=236"
    lost = [
        event for event in parse([line, other, "CPU:1 [LOST 3 EVENTS]", "CPU:2 [LOST EVENTS]"]) if event.what == Lost()
    ]
    assert lost == [Event(2_725_663_373_000, 1, Task("", -1), Lost()), Event(0, 2, Task("", -1), Lost())]


@pytest.mark.parametrize(
    ("flags", "bare"),
    [
        ("d..2", True),  # 5.15
        ("d..2.", True),  # 5.16 and later
        ("d..2.1.", True),  # PREEMPT_RT, with need-resched-lazy
        ("d...2...", True),
        ("d.h1", False),
        ("dN.H3.1", False),
        ("..s1.", False),
        ("d.Z..", False),
        ("bL...", True),  # 6.13
    ],
)
def test_flags_of_all_kernels(flags: str, bare: bool) -> None:
    (event,) = parse([next(iter(LINES)).replace("d..2.", flags)])
    assert event.bare == bare


@pytest.mark.parametrize(("flags", "hard"), [("d.h..", True), ("dNH2.", True), ("..s1.", False), (".....", False)])
def test_a_timer_that_a_softirq_calls_is_no_interrupt(flags: str, hard: bool) -> None:
    line = f"  ktimers/1-30   [001] {flags}  1.000000: hrtimer_expire_entry: hrtimer=1 function=f now=1"
    (event,) = parse([line])
    assert event.what == Enter("hrtimer", "f", hard=hard, timer=True)


@pytest.mark.parametrize("state", ["S", "D", "R", "R+", "S|K", "D|W", "D|K|N", "T", "t", "I", "P", "X", "Z"])
def test_states_of_all_kernels(state: str) -> None:
    (event,) = parse([next(iter(LINES)).replace("prev_state=R+", f"prev_state={state}")])
    assert event.what == Switch(Task("python", 18064, 130), state, Task("cyclictest", 18194, 19))
    assert divide([event], 18064, event.time_ns, event.time_ns + 1000)  # whatever it is


@pytest.mark.parametrize(
    "name", ["irq/36-eth0-rx-1", "a [001] b", "x-1 (5) [2]", "  ", "a=b pid=3", "kworker/u8:2-ev", "\x85\u2028"]
)
def test_names_of_tasks(name: str) -> None:
    line = (
        f" {name}-7     [001] d..2.  1.000000: sched_switch: prev_comm={name} prev_pid=7 prev_prio=49 prev_state=S ==> "
        f"next_comm={name} next_pid=8 next_prio=120"
    )
    (event,) = parse(f"{line}\n".split("\n"))
    assert event.task.pid == 7
    assert event.what == Switch(Task(name, 7, 49), "S", Task(name, 8, 120))


def test_a_name_that_the_kernel_has_forgotten_is_taken_from_the_last_switch() -> None:
    lines = [
        "  <...>-7  [001] d..2.  1.000000: sched_switch: prev_comm=cat prev_pid=7 prev_prio=120 prev_state=S ==> "
        "next_comm=hog next_pid=9 next_prio=4",
        "  <...>-9  [001] d.h..  1.000050: local_timer_entry: vector=236",
        "  <...>-11  [000] d.h..  1.000050: local_timer_entry: vector=236",
    ]
    assert [event.task.name for event in parse(lines)] == ["cat", "hog", "<...>"]


@settings(max_examples=examples(300), deadline=None)
@given(st.lists(st.one_of(st.text(max_size=200), st.sampled_from([*LINES, *NOTHING])), max_size=20))
def test_any_text_is_read(lines: list[str]) -> None:
    for event in parse(lines):
        assert event.what is not None


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.tuples(st.integers(0, 50), st.booleans()), max_size=30), st.integers(0, 60))
def test_lines_since_a_moment(times: list[tuple[int, bool]], start_us: int) -> None:
    times.sort()
    lines = []
    for time_us, remark in times:
        lines += ["CPU:1 [LOST 1 EVENTS]"] * remark
        lines.append(f"  a-1  [000] d....  0.{time_us:06}: local_timer_entry: vector=236")
    found = since(lines, start_us * 1000)
    assert [time_of(line) for line in found if time_of(line) is not None] == [
        time_us * 1000 for time_us, _ in times if time_us >= start_us
    ]


def test_a_recorded_wake_up_is_divided(golden_trace: list[str]) -> None:
    """Recorded of `cyclictest` beside a busy process; due 9 µs before the timer, running 7 µs after it."""
    found = divide(list(parse(golden_trace)), 18194, 2_725_663_350_000, 2_725_663_375_500)
    assert [(segment.length_ns, segment.cause, segment.who) for segment in found] == [
        (9000, Cause.MASKED, "busy 18064"),
        (1000, Cause.INTERRUPT, "local_timer"),
        (3000, Cause.INTERRUPT, "local_timer: hrtimer_wakeup"),
        (7000, Cause.INTERRUPT, "local_timer"),
        (3000, Cause.TASK, "busy 18064 (nice 10: behind us, but could not be interrupted at once)"),
        (2500, Cause.OWN, ""),
    ]


@pytest.fixture
def golden_trace() -> list[str]:
    return """\
            busy-18064   [001] d.h2.  2725.662356: sched_waking: comm=cyclictest pid=18194 prio=19 target_cpu=001
            busy-18064   [001] dNh3.  2725.662358: sched_wakeup: comm=cyclictest pid=18194 prio=19 target_cpu=001
            busy-18064   [001] d..2.  2725.662366: sched_switch: prev_comm=busy prev_pid=18064 prev_prio=130 \
prev_state=R ==> next_comm=cyclictest next_pid=18194 next_prio=19
      cyclictest-18194   [001] d..2.  2725.662378: sched_switch: prev_comm=cyclictest prev_pid=18194 prev_prio=19 \
prev_state=S ==> next_comm=busy next_pid=18064 next_prio=130
            busy-18064   [001] d.h..  2725.663359: local_timer_entry: vector=236
            busy-18064   [001] d.h..  2725.663360: hrtimer_expire_entry: hrtimer=0000000057389954 \
function=hrtimer_wakeup now=2725663359302
            busy-18064   [001] d.h2.  2725.663360: sched_waking: comm=cyclictest pid=18194 prio=19 target_cpu=001
            busy-18064   [001] dNh3.  2725.663362: sched_wakeup: comm=cyclictest pid=18194 prio=19 target_cpu=001
            busy-18064   [001] dNh..  2725.663363: hrtimer_expire_exit: hrtimer=0000000057389954
            busy-18064   [001] dNh..  2725.663370: local_timer_exit: vector=236
            busy-18064   [001] d..2.  2725.663373: sched_switch: prev_comm=busy prev_pid=18064 prev_prio=130 \
prev_state=R ==> next_comm=cyclictest next_pid=18194 next_prio=19
      cyclictest-18194   [001] d..2.  2725.663378: sched_switch: prev_comm=cyclictest prev_pid=18194 prev_prio=19 \
prev_state=S ==> next_comm=busy next_pid=18064 next_prio=130
""".splitlines()
