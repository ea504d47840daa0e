"""Asking the system for punctuality, reading back what was really given, and saying so.

Each step may be refused (no CAP_SYS_NICE, RLIMIT_RTPRIO or RLIMIT_MEMLOCK 0, a container) or be lost
silently, so each is read back; what was not obtained is one sentence, and fatal only where the arm's
configuration requires it.
"""

import ctypes
import os
import struct
from dataclasses import dataclass, field

from config.schema import RealtimeConfig

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_DMA_LATENCY = "/dev/cpu_dma_latency"


@dataclass
class Obtained:
    """What the cycle really runs with."""

    policy: int = 0
    priority: int = 0
    memory_locked: bool = False
    cpu: int = -1
    dma_latency_fd: int = -1
    complaints: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        policy = {os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}.get(self.policy, "SCHED_OTHER")
        parts = [f"{policy} {self.priority}" if self.priority else policy]
        parts.append("memory locked" if self.memory_locked else "memory not locked")
        if self.cpu >= 0:
            parts.append(f"CPU {self.cpu}")
        parts.append("cpu_dma_latency 0" if self.dma_latency_fd >= 0 else "cpu_dma_latency not held")
        return ", ".join(parts)


def prepare_process() -> Obtained:
    """What concerns the whole process: locked memory, no deep sleep of the processors."""
    obtained = Obtained()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0:
        obtained.memory_locked = True
    else:
        obtained.complaints.append(
            f"Memory is not locked ({os.strerror(ctypes.get_errno())}): page faults may delay cycles; raise "
            "RLIMIT_MEMLOCK (`ulimit -l unlimited`, or LimitMEMLOCK=infinity in a systemd unit)."
        )
    try:
        obtained.dma_latency_fd = os.open(_DMA_LATENCY, os.O_WRONLY | os.O_CLOEXEC)
        os.write(obtained.dma_latency_fd, struct.pack("i", 0))
    except OSError as problem:
        if obtained.dma_latency_fd >= 0:
            os.close(obtained.dma_latency_fd)
            obtained.dma_latency_fd = -1
        obtained.complaints.append(
            f"{_DMA_LATENCY} cannot be held at 0 ({problem.strerror}): processors may sleep deeply between cycles; run "
            "as root or allow that file."
        )
    return obtained


def prepare_thread(wanted: RealtimeConfig, obtained: Obtained, *, below: int = 0) -> None:
    """What concerns the calling thread: real-time priority (`below` the configured one) and its CPU."""
    priority = max(wanted.priority - below, 1)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as problem:
        if below == 0:
            obtained.complaints.append(
                f"No real-time priority ({problem.strerror}): cycles will be late whenever the machine is busy; run as "
                "root, or give the user RLIMIT_RTPRIO (`@realtime - rtprio 90` in /etc/security/limits.d)."
            )
    if wanted.cpu is not None:
        try:
            os.sched_setaffinity(0, {wanted.cpu})
        except OSError as problem:
            if below == 0:
                obtained.complaints.append(
                    f"CPU {wanted.cpu} cannot be used ({problem.strerror}): this process may run on "
                    f"{sorted(os.sched_getaffinity(0))}; change realtime.cpu."
                )
    if below == 0:
        obtained.policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        obtained.priority = os.sched_getparam(0).sched_priority
        allowed = os.sched_getaffinity(0)
        obtained.cpu = next(iter(allowed)) if len(allowed) == 1 else -1
