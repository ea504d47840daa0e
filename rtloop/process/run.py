"""The threads of the control process that run without the interpreter: the cycle, and a reader for each wire.

Deadlines are absolute. After an overrun the phase is kept; missed cycles are counted and never made up.
The reader exists because a read of a tty can block for milliseconds even when it is non-blocking (it takes
locks that an ordinary-priority kernel worker may hold). The cycle reads only the ring that the reader fills.
"""

from compilation.jit import jit
from rtloop.bus.measured import show_state
from rtloop.cycle import step
from rtloop.memory.events import record_event
from rtloop.memory.link import CAN_FRAME_BYTES, READ_BYTES, RX_FRAMES, WIRE_SOCKETCAN, Bus
from rtloop.memory.state import Loop
from rtloop.system.libc import (
    CLOCK_BOOTTIME,
    CLOCK_MONOTONIC,
    CLOCK_REALTIME,
    EAGAIN,
    EINTR,
    ENOBUFS,
    MSG_DONTWAIT,
    POLLIN,
    TIMER_ABSTIME,
    clock_gettime,
    clock_nanosleep,
    errno_location,
    load_int32,
    poll,
    read,
    recvmmsg,
    sendmmsg,
    write,
)
from rtloop.wire import outgoing, received, wires
from shm import histogram
from shm.atomics import load_acquire, load_relaxed, store_relaxed, store_release
from shm.layout import Histogram, StateFile
from shm.record import offset_of
from shm.words import BusState, Event

_STOP = offset_of(Loop, "stop")
_WAKE_UP = offset_of(Loop, "wake_up")
_CLOCK = offset_of(Loop, "clock_read")

# of a bus
_TX = offset_of(Bus, "outgoing", "bytes")
_TX_MESSAGES = offset_of(Bus, "outgoing", "messages")
_FD = offset_of(Bus, "wire", "fd")
_FD_IN_USE = offset_of(Bus, "wire", "fd_in_use")
_READER_CLOCK = offset_of(Bus, "received", "arrived", "clock")
_READER_POLL = offset_of(Bus, "reader", "poll")
_READER_BYTES = offset_of(Bus, "reader", "bytes")
_READER_MESSAGES = offset_of(Bus, "reader", "messages")

POLL_MS = 20
"""Timeout of the reader's poll; a reader whose loop has not gone round for several of these was kept from running."""
EPOCH_WITHIN_NS = 20_000
"""Reading clocks three times takes a hundred ns; the rest is for slow clocks."""

bucket = jit(histogram.bucket)


@jit
def clock_ns(clock: int, timespec_address: int) -> int:
    """Read a clock of the system, through a timespec at the given address."""
    clock_gettime(clock, timespec_address)
    return load_relaxed(timespec_address) * 1_000_000_000 + load_relaxed(timespec_address + 8)


@jit
def monotonic_ns(timespec_address: int) -> int:
    """Read CLOCK_MONOTONIC, through a timespec at the given address."""
    return clock_ns(CLOCK_MONOTONIC, timespec_address)


@jit
def suspended_ns(timespec_address: int) -> int:
    """For how long the machine has been suspended since it booted: CLOCK_MONOTONIC stands still while it is.

    With the clocks read in this order, a pause between them can only make the result smaller; the next call corrects
    that.
    """
    boot_ns = clock_ns(CLOCK_BOOTTIME, timespec_address)
    return boot_ns - monotonic_ns(timespec_address)


@jit
def record(durations: Histogram, value_ns: int) -> None:
    """Count a duration in a histogram; a negative one counts as 0."""
    value_ns = max(value_ns, 0)
    durations.buckets[bucket(value_ns)] += 1
    durations.count += 1
    durations.sum_ns += value_ns
    durations.max_ns = max(durations.max_ns, value_ns)


@jit
def sleep_until(loop: Loop, deadline_ns: int) -> None:
    """Sleep to an absolute deadline; signals do not shorten it."""
    wake_up = loop.params.address + _WAKE_UP
    store_relaxed(wake_up, deadline_ns // 1_000_000_000)
    store_relaxed(wake_up + 8, deadline_ns % 1_000_000_000)
    while clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, wake_up, 0) == EINTR:
        pass


@jit
def take_over_wire(loop: Loop, shared: StateFile, bus: Bus) -> int:
    """The descriptor of a bus' wire in this cycle, -1 for none.

    If it is another one than before, frames that wait to be sent and half received ones are dropped.
    """
    base = bus.address
    # pairs with `store_word` of the ordinary thread: the wire is set up before its descriptor is seen
    fd = load_acquire(base + _FD)
    if fd != load_relaxed(base + _FD_IN_USE):
        outgoing.forget(loop, shared, bus)
        wires.forget_half_frames(bus)
        if fd >= 0 and loop.timing.cycle > 0:
            show_state(loop, shared, bus, BusState.ACTIVE)
            record_event(loop, shared, Event.WIRE, -1, bus.number, 0.0, 0.0)
        # pairs with `load_word` of the ordinary thread: the old descriptor is closed after its last use
        store_release(base + _FD_IN_USE, fd)
    return fd


@jit
def send_bytes(loop: Loop, shared: StateFile, bus: Bus, fd: int) -> None:
    """Hand a bus' transmit buffer to its wire at once: characters in one write, CAN frames in one batch.

    A batch that the system accepts in part gives no error; if the reason lasts, the next cycle's batch gives it.
    """
    base = bus.address
    if bus.interface == WIRE_SOCKETCAN:
        sent = sendmmsg(fd, base + _TX_MESSAGES, bus.outgoing.frames, MSG_DONTWAIT)
        taken = sent * CAN_FRAME_BYTES
    else:
        sent = write(fd, base + _TX, bus.outgoing.length)
        taken = sent
    if sent < 0:
        error = load_int32(errno_location())
        taken = 0
        if error != EAGAIN and error != ENOBUFS and error != EINTR:
            received.close(bus, error)
            outgoing.forget(loop, shared, bus)
    outgoing.took(loop, shared, bus, taken)


@jit
def send_on_every_wire(loop: Loop, shared: StateFile) -> None:
    """Hand each bus' frames of this cycle to its wire; those of a bus without one are dropped."""
    for number in range(loop.params.bus_count):
        bus = loop.buses[number]
        fd = load_relaxed(bus.address + _FD_IN_USE)
        if fd < 0:
            outgoing.forget(loop, shared, bus)
        elif bus.outgoing.length > 0:
            send_bytes(loop, shared, bus, fd)


@jit
def follow_epoch(loop: Loop, woke_ns: int) -> None:
    """Update the offset of CLOCK_REALTIME to CLOCK_MONOTONIC: the former may have been set since the last cycle.

    Stamps follow the system's clock, motion never does. CLOCK_MONOTONIC is read before and after CLOCK_REALTIME; the
    difference bounds the error of the new offset. If this thread was away in between, the last cycle's offset stays
    unless it is surely wrong.
    """
    clock = loop.params.address + _CLOCK
    epoch_ns = clock_ns(CLOCK_REALTIME, clock)
    after_ns = monotonic_ns(clock)
    offset_ns = epoch_ns - (woke_ns + after_ns) // 2
    doubt_ns = after_ns - woke_ns
    if doubt_ns < EPOCH_WITHIN_NS or abs(offset_ns - loop.timing.epoch_offset_ns) > doubt_ns:
        loop.timing.epoch_offset_ns = offset_ns


@jit
def run(loop: Loop, shared: StateFile) -> None:
    """Run cycles until the stop word is set, on whatever wires are open."""
    params = loop.params
    clock = params.address + _CLOCK
    period_ns = params.period_ns
    deadline_ns = monotonic_ns(clock) + period_ns
    suspended_before_ns = suspended_ns(clock)
    # pairs with `store_word` of the ordinary thread
    while load_acquire(params.address + _STOP) == 0:
        sleep_until(loop, deadline_ns)
        woke_ns = monotonic_ns(clock)
        follow_epoch(loop, woke_ns)
        lateness_ns = woke_ns - deadline_ns
        record(shared.lateness, lateness_ns)
        loop.timing.lateness_ns = lateness_ns
        if lateness_ns >= period_ns:
            missed = lateness_ns // period_ns
            shared.counters.overruns += missed
            deadline_ns += missed * period_ns
        suspended_now_ns = suspended_ns(clock)
        if suspended_now_ns - suspended_before_ns > period_ns:
            loop.timing.suspended_ns = suspended_now_ns - suspended_before_ns
            suspended_before_ns = suspended_now_ns
        for number in range(params.bus_count):
            take_over_wire(loop, shared, loop.buses[number])
        step(loop, shared, deadline_ns)
        send_on_every_wire(loop, shared)
        loop.timing.cycle_time_ns = monotonic_ns(clock) - woke_ns
        record(shared.cycle_time, loop.timing.cycle_time_ns)
        deadline_ns += period_ns


@jit
def read_some(bus: Bus, fd: int) -> int:
    """Read available bytes into the reader's own buffer; returns their number, 0 at the end of a tty, -1 with errno."""
    base = bus.address
    if bus.interface == WIRE_SOCKETCAN:
        frames = recvmmsg(fd, base + _READER_MESSAGES, RX_FRAMES, MSG_DONTWAIT, 0)
        return frames * CAN_FRAME_BYTES if frames > 0 else -1
    return int(read(fd, base + _READER_BYTES, READ_BYTES))


@jit
def read_wire(loop: Loop, bus: Bus) -> None:
    """Fill a bus' receive ring from the wire that is open now, until it is gone or the stop word is set.

    This thread reads CAN frames too, although reads from a socket would not block the cycle: the time at which a
    reading arrived is needed, and the kernel's time stamps are of a clock that can be set.
    """
    base = bus.address
    clock, request = base + _READER_CLOCK, base + _READER_POLL
    # pairs with `store_word` of the ordinary thread: the wire is set up before its descriptor is seen
    fd = load_acquire(base + _FD)
    # pairs with `store_word` of the ordinary thread, and `received.close`
    while load_acquire(loop.params.address + _STOP) == 0 and received.closed(bus) == 0:
        received.awake(bus, monotonic_ns(clock))
        store_relaxed(request, fd | (POLLIN << 32))
        ready = poll(request, 1, POLL_MS)
        if ready == 0:
            continue
        count = read_some(bus, fd) if ready > 0 else -1
        if count > 0:
            received.push(bus, monotonic_ns(clock), bus.reader.bytes, count)
            continue
        error = load_int32(errno_location()) if count < 0 else 0
        if count == 0 or (error != EAGAIN and error != EINTR):
            received.close(bus, error)
            return
