"""`python trial.py PRIORITY BYTES [CPU]`: what the control process will ask for, and what is granted of it, as JSON.

A process of its own, so that nothing of the trial lasts; it imports only what a bare interpreter has.
"""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import sys

_MLOCK_ONFAULT = 1  # counted against the limit, without using memory
_DMA_LATENCY = "/dev/cpu_dma_latency"


def try_scheduling(priority: int) -> dict[str, object]:
    """Ask for SCHED_FIFO, read back what was obtained, and give it back at once."""
    refusal = None
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as problem:
        refusal = problem.strerror
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    obtained = {"fifo": policy == os.SCHED_FIFO, "priority": os.sched_getparam(0).sched_priority}
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return {**obtained, "scheduling_refusal": refusal}


def try_locking(size: int) -> dict[str, object]:
    """Lock `size` bytes of memory."""
    libc = ctypes.CDLL(None, use_errno=True)
    try:
        reserved = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as problem:
        return {"locked": False, "lock_refusal": problem.strerror}
    first = ctypes.c_char.from_buffer(reserved)
    if libc.mlock2(ctypes.byref(first), ctypes.c_size_t(size), _MLOCK_ONFAULT) != 0:
        return {"locked": False, "lock_refusal": os.strerror(ctypes.get_errno())}
    with open("/proc/self/status", encoding="ascii", errors="replace") as status:
        locked_kib = next((int(line.split()[1]) for line in status if line.startswith("VmLck:")), 0)
    return {"locked": locked_kib * 1024 >= size, "lock_refusal": None}


def try_processor(cpu: int | None = None) -> dict[str, object]:
    """Move to the processor, if one is named; isolated ones are not in the mask, but may be asked for."""
    try:
        os.sched_setaffinity(0, os.sched_getaffinity(0) if cpu is None else {cpu})
    except OSError as problem:
        return {"cpu_refusal": problem.strerror}
    return {"cpu_refusal": None}


def try_dma_latency() -> dict[str, object]:
    """Open what keeps processors from deep sleep; nothing is asked of it."""
    try:
        os.close(os.open(_DMA_LATENCY, os.O_WRONLY | os.O_CLOEXEC))
    except OSError as problem:
        return {"latency_refusal": problem.strerror}
    return {"latency_refusal": None}


if __name__ == "__main__":
    wanted_priority, wanted_bytes, *wanted_cpu = (int(argument) for argument in sys.argv[1:])
    granted = try_scheduling(wanted_priority) | try_processor(*wanted_cpu) | try_dma_latency()
    print(json.dumps(granted | try_locking(wanted_bytes)))
