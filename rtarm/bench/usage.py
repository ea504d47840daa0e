"""What a process was really given and has used, as the kernel tells it."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

DMA_LATENCY = "/dev/cpu_dma_latency"
_POLICIES = {os.SCHED_FIFO: "fifo", os.SCHED_RR: "rr"}


def processor_ns(pids: Sequence[int]) -> int:
    """Processor time that the processes, all threads included, have used so far (ns)."""
    # The kernel's clock of another process has the complement of its pid above three bits; 2: scheduled time.
    return sum(round(time.clock_gettime((~pid << 3) | 2) * 1e9) for pid in pids)


def obtained(pid: int) -> dict[str, Any]:
    """The scheduling of a process' most urgent thread, and what else it holds against being late.

    Keys as in `rtarm status --json`: policy, priority, memory_locked, cpu, dma_latency_held.
    """
    threads = [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]
    priority, thread = max((_priority(thread), thread) for thread in threads)
    allowed = os.sched_getaffinity(thread)
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    locked = next((line.split()[1] for line in status.splitlines() if line.startswith("VmLck:")), "0")
    return {
        "policy": _POLICIES.get(os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK, "other"),
        "priority": priority,
        "memory_locked": locked != "0",
        "cpu": next(iter(allowed)) if len(allowed) == 1 else None,
        "dma_latency_held": _holds(pid, DMA_LATENCY),
    }


def give_priority(pid: int, priority: int) -> None:
    """SCHED_FIFO for all threads of a process, where that is permitted; `obtained` says whether it was."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(priority))


def _priority(thread: int) -> int:
    try:
        return os.sched_getparam(thread).sched_priority
    except OSError:  # it ended between the listing and the look
        return -1


def _holds(pid: int, path: str) -> bool:
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            if os.readlink(descriptor) == path:
                return True
        except OSError:
            continue
    return False
