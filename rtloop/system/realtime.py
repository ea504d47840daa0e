"""Real-time set-up: requesting it from the system, reading back what was granted, and reporting what was not.

Each step may be refused (no CAP_SYS_NICE, RLIMIT_RTPRIO or RLIMIT_MEMLOCK 0, a container). Policy, priority and CPU may
also be lost silently, so they are read back; locks on memory are judged by the result of their call. What was not
obtained is reported in one message, and is fatal only where the arm's configuration requires it.
"""

import contextlib
import ctypes
import os
import re
import resource
import signal
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from config.sections import RealtimeConfig

THREAD_STACK_BYTES = 512 * 1024
"""Stack size of the cycle's and the reader's thread, all of it locked; their code nests only a few small frames."""

Range = tuple[int, int]
"""Address and size (bytes) of memory of this process."""

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_MADV_NOHUGEPAGE, _MADV_POPULATE_READ, _MADV_POPULATE_WRITE = 15, 22, 23
_PR_SET_TIMERSLACK = 29
_CAP_IPC_LOCK = 14
_OWN_FAULTS = {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT}
_PTHREAD_ATTR_BYTES = 128  # 56 on x86-64, 64 on ARM
_DMA_LATENCY = "/dev/cpu_dma_latency"
_C_LIBRARY = re.compile(r"/(libc|libm|libpthread|ld)(-[^/]*)?\.so[^/]*$")


@dataclass
class Obtained:
    """The real-time settings that the cycle really runs with; `complaints` are messages for the operator."""

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


def prepare_process(used: Iterable[Range]) -> Obtained:
    """Set up the whole process: lock memory, and keep the processors from deep sleep.

    `used` is the memory that the threads of the cycle and the reader touch besides their stacks (`prepare_thread`) and
    the C libraries. It is faulted in and locked now, so that no cycle waits for a page; memory that these threads never
    touch need not be resident.
    """
    obtained = Obtained(memory_locked=True)
    if _may_lock_everything():
        # Ordinary Python's pages stay resident once used, so that it reacts in time to a signal on a full machine.
        # Under a memory lock limit a later allocation would fail instead, or the main thread's stack could not grow.
        _libc().mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT)
    _lock([*used, *_c_libraries()], obtained)
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


def leave_signals_to_main() -> None:
    """Block all signals in the calling thread, since handlers are the main thread's."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals() - _OWN_FAULTS)


def prepare_thread(wanted: RealtimeConfig, obtained: Obtained, *, below: int = 0) -> None:
    """Set up the calling thread: lock its stack, set its real-time priority (`below` the configured one) and its CPU.

    `obtained` gets what was granted and refused. Priority and CPU are noted for the cycle's thread alone (`below` 0).
    """
    leave_signals_to_main()
    _lock([_own_stack()], obtained)
    _libc().prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)  # else, without real-time priority, each wake-up is 50 µs late
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


def prepare_helper(wanted: RealtimeConfig, *, below: int) -> None:
    """Set up a thread of ordinary Python that the cycle's frames pass through: its priority is `below` the cycle's own.

    It does not get the cycle's CPU. A refused priority is not reported, since the cycle's thread has reported it then.
    """
    leave_signals_to_main()
    _libc().prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    with contextlib.suppress(OSError):
        priority = max(wanted.priority - below, 1)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def lock_recorder(rings: Range, obtained: Obtained) -> None:
    """Fault in the flight recorder's rings, and lock them if the memory lock limit has room for them too.

    Each cycle writes to them; they are the largest part of what it touches, and grow with the arm's rate.
    """
    if not _keep(rings) and obtained.memory_locked:
        size_mib, limit_mib = rings[1] / 2**20, resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] / 2**20
        obtained.memory_locked = False
        obtained.complaints.append(
            f"The flight recorder's {size_mib:.0f} MiB are not locked, everything else is: page faults may delay "
            f"cycles on a machine short of memory; raise RLIMIT_MEMLOCK from {limit_mib:.0f} to "
            f"{limit_mib + size_mib:.0f} MiB (`ulimit -l unlimited`, or LimitMEMLOCK=infinity in a systemd unit)."
        )


def _lock(ranges: Iterable[Range], obtained: Obtained) -> None:
    """Fault in and lock memory; what cannot be locked is faulted in all the same, and that is reported once."""
    for wanted in ranges:
        if not _keep(wanted):
            if obtained.memory_locked:
                obtained.complaints.append(
                    f"Memory is not locked ({os.strerror(ctypes.get_errno())}): page faults may delay cycles; raise "
                    "RLIMIT_MEMLOCK to 32 MiB or more (`ulimit -l unlimited`, or LimitMEMLOCK=infinity in a systemd "
                    "unit)."
                )
            obtained.memory_locked = False


def _keep(wanted: Range) -> bool:
    """Fault in and lock memory; False (and errno says why) if it was only faulted in."""
    libc = _libc()
    page = resource.getpagesize()
    address, size = wanted
    first = address // page * page
    start, length = ctypes.c_void_p(first), ctypes.c_size_t(-(-(address + size) // page) * page - first)
    kept: bool = libc.mlock(start, length) == 0
    reason = ctypes.get_errno()
    # MADV_POPULATE_WRITE is refused for memory that may not be written; before Linux 5.14 both are refused.
    if not kept and libc.madvise(start, length, _MADV_POPULATE_WRITE) != 0:
        libc.madvise(start, length, _MADV_POPULATE_READ)
    # If the kernel later merges pages into a huge one, they fault at their next use; existing huge pages stay.
    libc.madvise(start, length, _MADV_NOHUGEPAGE)
    ctypes.set_errno(reason)
    return kept


def _may_lock_everything() -> bool:
    """Whether no later allocation can hit a memory lock limit."""
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return True
    capabilities = re.search(r"^CapEff:\s*(\w+)$", Path("/proc/self/status").read_text(encoding="ascii"), re.M)
    return capabilities is not None and bool(int(capabilities[1], 16) >> _CAP_IPC_LOCK & 1)


def _c_libraries() -> list[Range]:
    """Memory of the C library, libm, libpthread (apart before glibc 2.34) and the loader, whose data others read."""
    found = []
    matched, last_end = False, 0
    for line in Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines():
        area, permissions, _offset, _device, _inode, *name = line.split(maxsplit=5)
        start, end = (int(part, 16) for part in area.split("-"))
        # An area that directly follows and belongs to no file holds the library's zero-initialised variables.
        matched = _C_LIBRARY.search(name[0]) is not None if name else matched and start == last_end
        if matched and permissions[0] == "r":
            found.append((start, end - start))
        last_end = end
    return found


def _own_stack() -> Range:
    """The calling thread's stack; not to be called by the main thread, whose stack grows."""
    libc = _libc()
    attributes = ctypes.create_string_buffer(_PTHREAD_ATTR_BYTES)
    address, size = ctypes.c_void_p(), ctypes.c_size_t()
    libc.pthread_self.restype = ctypes.c_void_p
    libc.pthread_getattr_np(ctypes.c_void_p(libc.pthread_self()), attributes)
    libc.pthread_attr_getstack(attributes, ctypes.byref(address), ctypes.byref(size))
    libc.pthread_attr_destroy(attributes)
    return address.value or 0, size.value


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
