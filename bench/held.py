"""What held the latest bytes of a pseudo-terminal, by the kernel's trace events: who had the processor meanwhile.

The events go into an instance of their own, which is removed: whoever traces something else is not disturbed.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from slices import spread

TRACING = Path("/sys/kernel/tracing")
LATEST = 20
QUEUED, STARTED = "workqueue_queue_work", "workqueue_execute_start"
EVENTS = (
    "sched/sched_switch",
    "sched/sched_wakeup",
    f"workqueue/{QUEUED}",
    f"workqueue/{STARTED}",
)
LINE = re.compile(r"-(\d+) +\[(\d+)\] \S+ +(\d+)\.(\d{6}): (\w+): (.*)")
SWITCH = re.compile(r"prev_comm=([^/:\d]*).* prev_pid=\d+ prev_prio=(\d+) prev_state=")
WOKEN = re.compile(r" pid=(\d+) prio=")
LOWEST_REAL_TIME = 99


def traced(during: Callable[[], Any]) -> tuple[Any, list[tuple[int, int, int, str, str]]]:
    """What it gives, and the events meanwhile: thread, processor, µs of CLOCK_MONOTONIC, name, what it says."""
    instance = TRACING / "instances" / "rtarm-held"
    instance.mkdir()
    try:
        (instance / "trace_clock").write_text("mono")
        (instance / "buffer_size_kb").write_text("32768")
        for event in EVENTS:
            (instance / "events" / event / "enable").write_text("1")
        given = during()
        (instance / "tracing_on").write_text("0")
        with (instance / "trace").open() as lines:
            return given, [
                (int(m[1]), int(m[2]), int(m[3]) * 1_000_000 + int(m[4]), m[5], m[6])
                for m in map(LINE.search, lines)
                if m
            ]
    finally:
        instance.rmdir()


def latest(slice_of: Callable[[], tuple[bool, int, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The latest messages of a slice whose write queued the work, the latest first; none where one cannot trace."""
    if not (TRACING / "events").is_dir():
        return []
    (_, sender, late), events = traced(slice_of)
    messages = late["pseudo-terminal"] / 1000  # µs
    queued = [(us, words.split()[1]) for thread, _, us, name, words in events if name == QUEUED and thread == sender]
    works = {work.removeprefix("struct=") for _, work in queued}
    started = [
        (us, cpu, thread)
        for thread, cpu, us, name, words in events
        if name == STARTED and words.split()[2].rstrip(":") in works
    ]
    ran: dict[int, list[tuple[int, str]]] = defaultdict(list)
    woken: dict[int, list[int]] = defaultdict(list)
    for _, cpu, us, name, words in events:
        if name == "sched_switch" and (switch := SWITCH.match(words)):
            comm, priority = switch.groups()
            ran[cpu].append((us, comm + (" in real time" if int(priority) <= LOWEST_REAL_TIME else "")))
        elif name == "sched_wakeup":
            woken[int(WOKEN.search(words)[1])].append(us)
    found = []
    for sent_us, late_us in sorted(messages.tolist(), key=lambda message: -message[1]):
        queue = bisect_left(queued, (sent_us - 1,))
        if queue == len(queued) or queued[queue][0] > sent_us + late_us:
            continue  # the worker was on its way for an earlier message
        at_us = queued[queue][0]
        start_us, cpu, worker = started[bisect_left(started, (at_us,))]
        wake = bisect_left(woken[worker], at_us)
        wake_us = woken[worker][wake] if wake < len(woken[worker]) else start_us
        found.append(
            {
                "written to read": late_us,
                "written to queued": at_us - sent_us,
                "queued to worker woken": min(wake_us, start_us) - at_us,
                "worker woken to running": max(start_us - wake_us, 0),
                "running to read": sent_us + late_us - start_us,
                "meanwhile": meanwhile(ran[cpu], at_us, start_us),
            }
        )
        if len(found) == LATEST:
            break
    return found


def meanwhile(ran: list[tuple[int, str]], from_us: float, until_us: float) -> dict[str, float]:
    """Who had a processor for how many µs, of what was switched away from there, and when."""
    had: dict[str, float] = defaultdict(float)
    for us, who in ran[bisect_left(ran, (from_us,)) :]:
        had[who] += min(us, until_us) - from_us
        from_us = us
        if us >= until_us:
            break
    return dict(had)


def in_words(found: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Lines for the summary."""
    if not found:
        yield "  what held the latest", f"not known: {TRACING} is not there (as root: mount -t tracefs none {TRACING})"
        return
    yield f"  the {len(found)} latest by the pseudo-terminal, traced", "median (lowest to highest), µs"
    for phase in [name for name in found[0] if name != "meanwhile"]:
        yield f"    {phase}", spread([one[phase] for one in found])
    had: Counter[str] = Counter()  # µs
    for one in found:
        had.update(one["meanwhile"])
    total = sum(had.values()) or 1.0
    yield (
        "    who had the worker's processor meanwhile",
        ", ".join(f"{who} {us / total:.0%}" for who, us in had.most_common(6)),
    )
