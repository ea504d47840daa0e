"""The frames of a cycle: motion first, then questions for readings, then those of service dialogues."""

from compilation.jit import jit
from rtloop.drives import families
from rtloop.memory import status as status_bits
from rtloop.memory.buses import bus_of
from rtloop.memory.link import PROBING, SILENT, SPEAKING, Bus
from rtloop.memory.modes import is_disabled
from rtloop.memory.state import Loop
from rtloop.memory.updates import stop_left
from rtloop.safety import transmission
from rtloop.service import port, rings
from rtloop.wire import outgoing
from rtloop.wire.outgoing import frame_bits
from shm.layout import StateFile
from shm.words import Mode


@jit
def encode(loop: Loop, shared: StateFile) -> None:
    """Put this cycle's frames into the transmit buffers: motion first, then readings, then service."""
    params = loop.params
    for number in range(params.bus_count):
        bus = loop.buses[number]
        outgoing.begin(loop, shared, bus)
        bus.speech = transmission.speech(bus)
    leads = transmission.drives_are_led(loop)
    transmission.stop_displaced_drives(loop)
    for joint in range(params.joint_count):
        axis = loop.axes[joint]
        if not families.is_on_the_bus(loop, joint):
            mirror(loop, joint)
        elif bus_of(loop, joint).speech == SILENT:
            if axis.reply.unanswered_since_ns == 0:
                axis.reply.unanswered_since_ns = loop.timing.now_ns  # its wire is gone: it is silent from now on
        elif axis.sent.stop_frames_due > 0:
            if families.stop(loop, joint, shared):
                stop_left(axis)  # comes back if the wire does not take it
        elif leads and transmission.may_be_led(loop, joint):
            families.lead(loop, joint, shared)
    if loop.mode != Mode.OFFLINE:
        for number in range(params.bus_count):
            bus = loop.buses[number]
            if bus.speech == SPEAKING:
                ask(loop, shared, bus)
            elif bus.speech == PROBING:
                probe(loop, shared, bus)
    send_service_frames(loop, shared)
    for number in range(params.bus_count):
        bus = loop.buses[number]
        if bus.speech != SILENT and bus.outgoing.length > 0:
            bus.quiet.spoke_ns = loop.timing.now_ns


@jit
def mirror(loop: Loop, joint: int) -> None:
    """A mock drive: what is commanded is measured, at this very instant."""
    axis = loop.axes[joint]
    axis.measured.position_rad = axis.tracking.reference_rad = axis.commanded.position_rad
    axis.measured.velocity_rad_s = axis.tracking.reference_velocity_rad_s = axis.commanded.velocity_rad_s
    axis.measured.time_ns = loop.timing.now_ns
    axis.measured.readings += 1
    enabled = 0 if is_disabled(loop.mode) else status_bits.ENABLED
    axis.drive.status = enabled | status_bits.REACHED | status_bits.ANSWERED


@jit
def ask(loop: Loop, shared: StateFile, bus: Bus) -> None:
    """Ask every drive of a bus that does not report its position for it, and one of them in turn for its status."""
    params = loop.params
    for joint in range(params.joint_count):
        if loop.joints[joint].bus == bus.number and families.is_on_the_bus(loop, joint):
            axis = loop.axes[joint]
            if params.reported == 0 or transmission.report_is_asked_for(loop, joint):
                families.ask_position(loop, joint, shared)
            if axis.reply.unanswered_since_ns == 0:
                axis.reply.unanswered_since_ns = loop.timing.now_ns
    bus.status_turn = next_turn(loop, bus, bus.status_turn)
    if families.is_on_the_bus(loop, bus.status_turn):
        families.ask_status(loop, bus.status_turn, shared)
        if bus.unacknowledged_since_ns == 0:
            bus.unacknowledged_since_ns = loop.timing.now_ns


@jit
def next_turn(loop: Loop, bus: Bus, turn: int) -> int:
    """The joint of a bus whose turn it is after another's."""
    for _ in range(loop.params.joint_count):
        turn = (turn + 1) % loop.params.joint_count
        if loop.joints[turn].bus == bus.number:
            break
    return turn


@jit
def probe(loop: Loop, shared: StateFile, bus: Bus) -> None:
    """Ask one drive in turn, now and then, whether anybody is there again: what is asked now only queues up."""
    if not transmission.may_probe(loop, bus):
        return
    bus.probed_ns = loop.timing.now_ns
    bus.probe_turn = next_turn(loop, bus, bus.probe_turn)
    if families.is_on_the_bus(loop, bus.probe_turn):
        families.ask_position(loop, bus.probe_turn, shared)


@jit
def send_service_frames(loop: Loop, shared: StateFile) -> None:
    """Send frames of service dialogues in the bus time that this cycle leaves; packets of one command together.

    Those to a wire that is gone are dropped.
    """
    for number in range(loop.params.bus_count):
        bus = loop.buses[number]
        spare = bus.service_bits - bus.outgoing.bits
        bus.service_credit_bits = min(bus.service_credit_bits + spare, bus.service_bits)
    while rings.inbox(loop) > 0:
        first = loop.service_in.records[rings.inbox_slot(loop)]
        if first.kind != port.SEND:
            break
        bus = bus_of(loop, first.joint)
        if bus.speech == SILENT:
            rings.inbox_done(loop)
            continue
        packets = rings.command_length(loop)
        if bus.service_credit_bits <= 0 or packets == 0 or not outgoing.has_room(bus, packets):
            break
        for _ in range(packets):
            order = loop.service_in.records[rings.inbox_slot(loop)]
            joint = order.joint
            stops = joint if joint >= 0 and families.is_stop(loop, joint, order.id, order.payload) else -1
            outgoing.send(
                loop, shared, joint, order.id, order.frame_kind, order.length, order.payload, order.joined, stops
            )
            if joint >= 0:
                families.note_what_was_said(loop, joint, order.id, order.payload)
            bus.service_credit_bits -= frame_bits(order.frame_kind, order.length)
            rings.inbox_done(loop)
