"""The frames of a cycle: motion first, then questions for readings, then those of service dialogues."""

from compilation.jit import jit
from rtloop.drives import families
from rtloop.memory import status as status_bits
from rtloop.memory.modes import is_disabled
from rtloop.memory.state import Loop
from rtloop.memory.updates import stop_left
from rtloop.safety import transmission
from rtloop.service import port, rings
from rtloop.wire import outgoing, received
from rtloop.wire.outgoing import frame_bits
from shm.layout import StateFile
from shm.words import Mode


@jit
def encode(loop: Loop, shared: StateFile) -> None:
    """Put this cycle's frames into the transmit buffer: motion first, then readings, then service."""
    params = loop.params
    outgoing.begin(loop, shared)
    if received.closed(loop) != 0:
        say_nothing(loop)
        return
    leaves = transmission.frames_may_leave(loop)
    leads = leaves and transmission.drives_are_led(loop)
    transmission.stop_displaced_drives(loop)
    for joint in range(params.joint_count):
        axis = loop.axes[joint]
        if not families.is_on_the_bus(loop, joint):
            mirror(loop, joint)
        elif axis.sent.stop_frames_due > 0:
            if families.stop(loop, joint, shared):
                stop_left(axis)  # comes back if the wire does not take it
        elif leads and transmission.may_be_led(loop, joint):
            families.lead(loop, joint, shared)
    if loop.mode != Mode.OFFLINE and leaves:
        ask(loop, shared)
    elif loop.mode != Mode.OFFLINE:
        probe(loop, shared)
    send_service_frames(loop, shared)
    if loop.outgoing.length > 0:
        loop.quiet.spoke_ns = loop.timing.now_ns


@jit
def say_nothing(loop: Loop) -> None:
    """The wire is gone: drives are silent from now on, and waiting frames of service dialogues are dropped."""
    for joint in range(loop.params.joint_count):
        if families.is_on_the_bus(loop, joint) and loop.axes[joint].reply.unanswered_since_ns == 0:
            loop.axes[joint].reply.unanswered_since_ns = loop.timing.now_ns
    while rings.inbox(loop) > 0 and loop.service_in.records[rings.inbox_slot(loop)].kind == port.SEND:
        rings.inbox_done(loop)


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
def ask(loop: Loop, shared: StateFile) -> None:
    """Ask every drive that does not report its position for it, and one of them in turn for its status."""
    bus, params = loop.bus, loop.params
    for joint in range(params.joint_count):
        if families.is_on_the_bus(loop, joint):
            axis = loop.axes[joint]
            if params.reported == 0 or transmission.report_is_asked_for(loop, joint):
                families.ask_position(loop, joint, shared)
            if axis.reply.unanswered_since_ns == 0:
                axis.reply.unanswered_since_ns = loop.timing.now_ns
    bus.status_turn = (bus.status_turn + 1) % params.joint_count
    if families.is_on_the_bus(loop, bus.status_turn):
        families.ask_status(loop, bus.status_turn, shared)
        if bus.unacknowledged_since_ns == 0:
            bus.unacknowledged_since_ns = loop.timing.now_ns


@jit
def probe(loop: Loop, shared: StateFile) -> None:
    """Ask one drive in turn, now and then, whether anybody is there again: what is asked now only queues up."""
    bus, params = loop.bus, loop.params
    if not transmission.may_probe(loop):
        return
    bus.probed_ns = loop.timing.now_ns
    bus.probe_turn = (bus.probe_turn + 1) % params.joint_count
    if families.is_on_the_bus(loop, bus.probe_turn):
        families.ask_position(loop, bus.probe_turn, shared)


@jit
def send_service_frames(loop: Loop, shared: StateFile) -> None:
    """Send frames of service dialogues in the bus time that this cycle leaves; packets of one command together."""
    bus = loop.bus
    spare = loop.params.service_bits - loop.outgoing.bits
    bus.service_credit_bits = min(bus.service_credit_bits + spare, loop.params.service_bits)
    while rings.inbox(loop) > 0 and bus.service_credit_bits > 0:
        if loop.service_in.records[rings.inbox_slot(loop)].kind != port.SEND:
            break
        packets = rings.command_length(loop)
        if packets == 0 or not outgoing.has_room(loop, packets):
            break
        for _ in range(packets):
            order = loop.service_in.records[rings.inbox_slot(loop)]
            joint = order.joint
            stops = joint if joint >= 0 and families.is_stop(loop, joint, order.id, order.payload) else -1
            outgoing.send(loop, shared, order.id, order.frame_kind, order.length, order.payload, order.joined, stops)
            if joint >= 0:
                families.note_what_was_said(loop, joint, order.id, order.payload)
            bus.service_credit_bits -= frame_bits(order.frame_kind, order.length)
            rings.inbox_done(loop)
