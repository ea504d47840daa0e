"""The two threads of the control process that run without the interpreter: the cycle and the wire's reader.

Deadlines are absolute; after an overrun the phase is kept, what was missed is counted and never made up.
The reader exists because a read of a tty can block for milliseconds even when it is non-blocking (it takes
locks that an ordinary-priority kernel worker may hold); the cycle only looks at the ring the reader fills.
"""

from typing import Any

import numpy as np

from rtloop.cycle import step
from rtloop.libc import (
    CLOCK_BOOTTIME,
    CLOCK_MONOTONIC,
    EAGAIN,
    EINTR,
    POLLIN,
    TIMER_ABSTIME,
    clock_gettime,
    clock_nanosleep,
    errno_location,
    load_int32,
    poll,
    read,
    write,
)
from rtloop.state import LOOP, READ_BYTES, offset_of
from rtloop.wire import received
from shm import histogram
from shm.atomics import load_acquire, load_relaxed, store_relaxed
from shm.jit import jit

Loop = Any
Shared = Any

_TX = offset_of(LOOP, "tx")
_STOP = offset_of(LOOP, "stop")
_WAKE_UP = offset_of(LOOP, "wake_up")
_CLOCK = offset_of(LOOP, "clock")
_READER_CLOCK = offset_of(LOOP, "received", "arrived", "clock")

POLL_MS = 100

bucket = jit(histogram.bucket)


@jit
def clock_ns(clock: int, timespec_address: int) -> int:
    """A clock of the system, through a timespec at the given address."""
    clock_gettime(clock, timespec_address)
    return load_relaxed(timespec_address) * 1_000_000_000 + load_relaxed(timespec_address + 8)


@jit
def monotonic_ns(timespec_address: int) -> int:
    """CLOCK_MONOTONIC, through a timespec at the given address."""
    return clock_ns(CLOCK_MONOTONIC, timespec_address)


@jit
def suspended_ns(timespec_address: int) -> int:
    """For how long the machine has been suspended since it was started: CLOCK_MONOTONIC stands still meanwhile.

    In this order a pause between the two looks can only make it less, which the next look makes good.
    """
    boot_ns = clock_ns(CLOCK_BOOTTIME, timespec_address)
    return boot_ns - monotonic_ns(timespec_address)


@jit
def record(histogram_record: Any, value_ns: int) -> None:
    """Count a duration."""
    value_ns = max(value_ns, 0)
    histogram_record.buckets[bucket(value_ns)] += 1
    histogram_record.count += 1
    histogram_record.sum_ns += value_ns
    histogram_record.max_ns = max(histogram_record.max_ns, value_ns)


@jit
def sleep_until(loop: Loop, deadline_ns: int) -> None:
    """Sleep to an absolute deadline; signals do not shorten it."""
    wake_up = loop.params.address + _WAKE_UP
    store_relaxed(wake_up, deadline_ns // 1_000_000_000)
    store_relaxed(wake_up + 8, deadline_ns % 1_000_000_000)
    while clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, wake_up, 0) == EINTR:
        pass


@jit
def send_bytes(loop: Loop, shared: Shared, fd: int, count: int) -> None:
    """Give the transmit buffer to the wire in one write; what it does not take leads the next cycle's."""
    sent = write(fd, loop.params.address + _TX, count)
    if sent < 0:
        error = load_int32(errno_location())
        if error != EAGAIN and error != EINTR:
            received.close(loop, error)
            loop.core.tx_length = 0
        return
    shared.counters.bytes_sent += sent
    left = count - sent
    for i in range(left):
        loop.tx[i] = loop.tx[sent + i]
    loop.core.tx_length = left


@jit
def run(loop: Loop, shared: Shared, fd: int) -> None:
    """Run cycles until the stop word is set; fd < 0 means there is no wire."""
    params = loop.params
    clock = params.address + _CLOCK
    period_ns = params.period_ns
    deadline_ns = monotonic_ns(clock) + period_ns
    suspended_before_ns = suspended_ns(clock)
    while load_acquire(params.address + _STOP) == 0:
        sleep_until(loop, deadline_ns)
        woke_ns = monotonic_ns(clock)
        lateness_ns = woke_ns - deadline_ns
        record(shared.lateness, lateness_ns)
        loop.core.lateness_ns = lateness_ns
        if lateness_ns >= period_ns:
            missed = lateness_ns // period_ns
            shared.counters.overruns += missed
            deadline_ns += missed * period_ns
        suspended_now_ns = suspended_ns(clock)
        if suspended_now_ns - suspended_before_ns > period_ns:
            loop.core.suspended_ns = suspended_now_ns - suspended_before_ns
            suspended_before_ns = suspended_now_ns
        count = step(loop, shared, deadline_ns)
        if count > 0 and fd >= 0:
            send_bytes(loop, shared, fd, count)
        loop.core.cycle_time_ns = monotonic_ns(clock) - woke_ns
        record(shared.cycle_time, loop.core.cycle_time_ns)
        deadline_ns += period_ns


@jit
def read_wire(loop: Loop, fd: int, buffer: np.ndarray, buffer_address: int, request_address: int) -> None:
    """Fill the receive ring from the tty until the stop word is set or the wire is gone.

    `request_address` is that of the one pollfd.
    """
    clock = loop.params.address + _READER_CLOCK
    while load_acquire(loop.params.address + _STOP) == 0:
        store_relaxed(request_address, fd | (POLLIN << 32))
        ready = poll(request_address, 1, POLL_MS)
        if ready == 0:
            continue
        count = read(fd, buffer_address, READ_BYTES) if ready > 0 else -1
        if count > 0:
            received.push(loop, monotonic_ns(clock), buffer, count)
            continue
        error = load_int32(errno_location()) if count < 0 else 0
        if count == 0 or (error != EAGAIN and error != EINTR):
            received.close(loop, error)
            return
