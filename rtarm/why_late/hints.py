"""What can be said without trace events: counters of the kernel that rose while cycles were late. Hints, no causes."""

from __future__ import annotations

import contextlib
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from rtarm.why_late.watch import cpu_of, stolen_ns

MOST = 6
STEAL = "ms that the host took (steal)"


class Hints:
    """Sums up what rose between looks, apart for looks with and without a late cycle."""

    def __init__(self, tid: int) -> None:
        self._tid, self._cpu = tid, cpu_of(tid)
        self._last = counted(tid, self._cpu)
        self._risen: dict[bool, dict[str, float]] = {True: defaultdict(float), False: defaultdict(float)}
        self._looks: Counter[bool] = Counter()

    def look(self, *, late: bool) -> None:
        """Take what has risen since the last look, in which cycles were late or not."""
        cpu = cpu_of(self._tid)
        now = counted(self._tid, cpu)
        if cpu != self._cpu:  # the counters of another processor are no continuation of those
            self._last = of_thread(self._tid)
        self._cpu = cpu
        self._looks[late] += 1
        for what, value in now.items():
            self._risen[late][what] += value - self._last.get(what, value)
        self._last = now

    def told(self) -> list[dict[str, Any]]:
        """What rose faster while cycles were late, the most striking first: how much a look, then and otherwise."""
        found = []
        for what in self._risen[True]:
            late, other = (self._risen[key][what] / max(self._looks[key], 1) for key in (True, False))
            if late > 2 * other:
                told = {"what": what, "a_look_with_late_cycles": round(late, 3), "a_look_without": round(other, 3)}
                found.append((late / (other + 0.1), told))
        return [told for _, told in sorted(found, key=lambda one: -one[0])[:MOST]]


def counted(tid: int, cpu: int) -> dict[str, float]:
    """What the kernel has counted of a thread and its processor, as far as it says so."""
    return of_thread(tid) | of_processor(cpu)


def of_thread(tid: int) -> dict[str, float]:
    """The part that is the thread's own, wherever it runs."""
    found: dict[str, float] = {}
    task = Path(f"/proc/{tid}")
    with contextlib.suppress(OSError, IndexError, ValueError):
        found["ms ready and waiting for the processor"] = int((task / "schedstat").read_text().split()[1]) * 1e-6
    with contextlib.suppress(OSError, IndexError, ValueError):
        status = (task / "status").read_text()
        found["times another task took the processor"] = int(
            status.partition("nonvoluntary_ctxt_switches:")[2].split()[0]
        )
    with contextlib.suppress(OSError, IndexError, ValueError):
        stat = (task / "stat").read_text().rpartition(")")[2].split()
        found["page faults"], found["page faults from the disk"] = int(stat[7]), int(stat[9])
    return found


def of_processor(cpu: int) -> dict[str, float]:
    """The part that is the processor's."""
    found = {STEAL: stolen_ns(cpu) * 1e-6}
    with contextlib.suppress(OSError):
        found |= _interrupts(cpu)
    return found


def _interrupts(cpu: int) -> dict[str, float]:
    """Interrupts of a processor by their name."""
    heading, *lines = Path("/proc/interrupts").read_text().splitlines()
    column = heading.split().index(f"CPU{cpu}") if f"CPU{cpu}" in heading.split() else -1
    found: dict[str, float] = {}
    for line in lines:
        name, _, rest = line.partition(":")
        fields = rest.split()
        if 0 <= column < len(fields) and fields[column].isdigit():
            words = " ".join(fields[len(heading.split()) :])
            found[f"interrupts {name.strip()} ({words})" if words else f"interrupts {name.strip()}"] = int(
                fields[column]
            )
    return found
