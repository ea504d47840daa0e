"""What the buses brought: bytes to frames, frames to the measured state of the joints.

A reading is stamped with the time at which the encoder was read (the arrival of its bytes less the way back) and
compared with what was commanded at that very instant.
"""

from compilation.jit import jit
from rtloop.drives import families
from rtloop.memory.link import GRIPPER, NOBODY, RX_CHUNKS, WIRE_MOCK, Bus
from rtloop.memory.recorder import marks_of, record_frame
from rtloop.memory.state import HISTORY_SLOTS, Loop
from rtloop.safety import monitor, silence
from rtloop.safety.faults import latch_fault
from rtloop.service import rings
from rtloop.wire import can_errors, outgoing, received, wires
from rtloop.wire.counted import count_error_frame, count_received
from rtloop.wire.found import CONTROLLER_ERROR, FRAME, NOTHING
from rtloop.wire.outgoing import frame_bits
from shm.layout import MAX_JOINTS, StateFile
from shm.words import BusState, Fault, Mode

_ACTIVE = int(BusState.ACTIVE)  # numba compares no members of an enumeration with whole numbers

SHORTEST_SHARE = 0.25
"""Two readings nearer than this share of a period give no velocity."""
ENETDOWN = 100
SMOOTHING_S = 0.1
"""One encoder count differenced twice is more than most acceleration limits; over this time it averages out."""


@jit
def take_what_the_bus_brought(loop: Loop, shared: StateFile) -> None:
    """Decode every byte that has come since the last cycle into measured state."""
    if loop.buses[0].interface == WIRE_MOCK:  # then there is no other
        return
    for number in range(loop.params.bus_count):
        take_bytes(loop, shared, loop.buses[number])
    take_positions(loop, shared)
    lost = 0
    for number in range(loop.params.bus_count):
        bus = loop.buses[number]
        lost += received.lost(bus)
        outgoing.take_back(shared, bus, received.unsent(bus))
        silence.follow(loop, shared, bus)
        error = received.closed(bus) - 1
        if error >= 0:
            bus.transmit_inhibited = 1
            if loop.mode != Mode.OFFLINE:
                fault = Fault.LINK_DOWN if error == ENETDOWN else Fault.WIRE
                latch_fault(loop, shared, fault, -1, float(error), float(bus.number))
    shared.counters.receive_overflows = lost


@jit
def take_bytes(loop: Loop, shared: StateFile, bus: Bus) -> None:
    """What has come on one bus."""
    parser = bus.parser
    chunks = received.chunks_arrived(bus)
    while parser.chunks_taken < chunks:
        chunk = bus.received.chunks[parser.chunks_taken & (RX_CHUNKS - 1)]
        time_ns, end = chunk.time_ns, chunk.end
        shared.counters.bytes_received += end - parser.bytes_taken
        take_frames(loop, shared, bus, end, time_ns)
        parser.chunks_taken += 1
    received.taken(bus, parser.bytes_taken, parser.chunks_taken)


@jit
def take_frames(loop: Loop, shared: StateFile, bus: Bus, end: int, time_ns: int) -> None:
    """The frames that end before `end`."""
    found = FRAME
    while found != NOTHING:
        found, frame_id, kind, length, data = wires.next_frame(bus, shared, end)
        if found == FRAME:
            take_frame(loop, shared, bus, frame_id, kind, length, data, time_ns)
        elif found == CONTROLLER_ERROR:
            take_error(loop, shared, bus, frame_id, data)


@jit
def take_error(loop: Loop, shared: StateFile, bus: Bus, error_class: int, data: int) -> None:
    """The state that the bus controller reports. Only bus-off is a fault by itself: nothing leaves any more.

    What the kernel held back at bus-off is dropped there; from here on nothing but readings may be asked for.
    """
    count_error_frame(shared, bus, can_errors.unacknowledged(error_class, data))
    state = can_errors.state_after(shared.buses[bus.number].bus_state, error_class, data)
    show_state(loop, shared, bus, state)
    if state == BusState.BUS_OFF and bus.transmit_inhibited == 0:
        bus.transmit_inhibited = 1
        latch_fault(loop, shared, Fault.BUS_OFF, -1, float(error_class), float(bus.number))


@jit
def show_state(loop: Loop, shared: StateFile, bus: Bus, state: int) -> None:
    """Show the state of a bus, and the worst of the arm's buses."""
    shared.buses[bus.number].bus_state = state
    worst = _ACTIVE
    for number in range(loop.params.bus_count):
        worst = max(worst, shared.buses[number].bus_state)
    shared.counters.bus_state = worst


@jit
def take_frame(
    loop: Loop, shared: StateFile, bus: Bus, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """A frame from a drive: into the axis it belongs to, and to the conversation that may wait for it.

    Adapters may echo what they send. A question is never as long as its answer and no answer begins as a command does,
    so an echo means nothing here.
    """
    count_received(shared, bus, frame_bits(kind, length))
    record_frame(loop, shared, bus.number, time_ns, frame_id, marks_of(kind), length, data)
    joint = whose(loop, bus, frame_id, kind)
    if joint == NOBODY:
        return
    bus.unheard_frames = 0
    bus.quiet.heard_ns = time_ns
    rings.hand_out(loop, joint, frame_id, kind, length, data, time_ns)
    if joint != GRIPPER:
        families.receive(loop, joint, shared, frame_id, kind, length, data, time_ns)


@jit
def whose(loop: Loop, bus: Bus, frame_id: int, kind: int) -> int:
    """The joint whose drive sends such a frame on a bus, GRIPPER or NOBODY."""
    for number in range(loop.params.listener_count):
        listener = loop.listeners[number]
        if (frame_id ^ listener.match) & listener.mask == 0 and kind == listener.kind and listener.bus == bus.number:
            return int(listener.joint)
    return NOBODY


@jit
def take_positions(loop: Loop, shared: StateFile) -> None:
    """Measure every joint by the last position that came from its drive since the last cycle."""
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        reply = axis.reply
        if reply.is_new == 1:
            reply.is_new = 0
            take_position(loop, shared, joint, reply.position_rad, max(reply.time_ns, axis.measured.time_ns))
            reply.has_report = 0


@jit
def take_position(loop: Loop, shared: StateFile, joint: int, position_rad: float, read_ns: int) -> None:
    axis, params = loop.axes[joint], loop.params
    measured, tracking = axis.measured, axis.tracking
    reference_rad = commanded_at(loop, joint, read_ns)
    if not monitor.plausible(loop, shared, joint, position_rad, read_ns, reference_rad):
        return
    waited_ns = read_ns - axis.reply.unanswered_since_ns if axis.reply.unanswered_since_ns != 0 else 0
    if params.reported == 1:
        waited_ns = read_ns - measured.time_ns if measured.readings > 0 else 0
    monitor.stop_if_it_was_away(loop, joint, waited_ns)
    if params.reported == 0 or axis.reply.has_report == 1:  # an answer holds a position, but is no report
        axis.reply.unanswered_since_ns = 0
    # an answer does not name its question: it may be as old as the oldest one
    tracking.lag_ns = max(waited_ns - params.reading_ns, tracking.lag_ns - (read_ns - measured.time_ns), 0)
    tracking.lag_rad = (
        abs(reference_rad - commanded_at(loop, joint, read_ns - tracking.lag_ns)) if tracking.lag_ns > 0 else 0.0
    )
    tracking.error_before_rad = tracking.reference_rad - measured.position_rad
    tracking.velocity_error_before_rad_s = tracking.reference_velocity_rad_s - measured.velocity_rad_s
    tracking.error_acceleration_before_rad_s2 = tracking.error_acceleration_rad_s2
    since_s = (read_ns - measured.time_ns) * 1e-9
    if measured.readings > 0 and since_s > SHORTEST_SHARE * params.period_ns * 1e-9:
        measured.velocity_rad_s = (position_rad - measured.position_rad) / since_s
        tracking.reference_velocity_rad_s = (reference_rad - tracking.reference_rad) / since_s
        velocity_error = tracking.reference_velocity_rad_s - measured.velocity_rad_s
        change = (velocity_error - tracking.velocity_error_before_rad_s) / since_s
        share = since_s / (since_s + SMOOTHING_S)
        tracking.error_acceleration_rad_s2 += share * (change - tracking.error_acceleration_rad_s2)
    measured.position_rad = position_rad
    tracking.reference_rad = reference_rad
    measured.time_ns = read_ns
    measured.readings += 1


@jit
def commanded_at(loop: Loop, joint: int, time_ns: int) -> float:
    """Commanded position at an instant of the recent past, between the cycles' own."""
    timing, axis = loop.timing, loop.axes[joint]
    newest = loop.history.next - 1
    later_ns = timing.now_ns + loop.params.period_ns
    later = axis.commanded.next_position_rad
    if timing.cycle == loop.published.cycle + 1:  # this cycle's next setpoint is not made yet
        later_ns = timing.now_ns
        later = axis.commanded.position_rad
    for back in range(min(HISTORY_SLOTS, loop.history.next)):
        slot = (newest - back) & (HISTORY_SLOTS - 1)
        at_ns: int = loop.history.time_ns[slot]
        here: float = loop.history.position_rad[slot * MAX_JOINTS + joint]
        if at_ns <= time_ns:
            if later_ns <= at_ns or time_ns >= later_ns:
                return later
            share = (time_ns - at_ns) / (later_ns - at_ns)
            return here + share * (later - here)
        later_ns, later = at_ns, here
    return later
