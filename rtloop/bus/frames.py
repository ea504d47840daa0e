"""The frames of a cycle: motion first, then readings, then what conversations want to say."""

from typing import Any

from rtloop.drives import families
from rtloop.memory import status as status_bits
from rtloop.memory.modes import is_limp
from rtloop.safety import guard
from rtloop.service import port, rings
from rtloop.wire import outgoing, received
from rtloop.wire.outgoing import frame_bits
from shm.jit import jit
from shm.words import Mode

Loop = Any  # record of dtype rtloop.memory.state.LOOP
Shared = Any  # record of dtype shm.layout.STATE


@jit
def encode(loop: Loop, shared: Shared) -> None:
    """Put this cycle's frames into the transmit buffer: motion first, then readings, then service."""
    core, params = loop.core, loop.params
    core.tx_bits = 0
    outgoing.begin(loop, shared)
    if received.closed(loop) != 0:
        say_nothing(loop)
        return
    heard = guard.somebody_listens(loop)
    leads = heard and guard.drives_are_led(loop)
    guard.stop_who_is_elsewhere(loop)
    for joint in range(params.joint_count):
        axis = loop.axes[joint]
        if not families.is_on_the_bus(loop, joint):
            mirror(loop, joint)
        elif axis.stop_frames_due > 0:
            if families.stop(loop, joint, shared):
                axis.stop_frames_due -= 1  # comes back if the wire does not take it
        elif leads and guard.may_be_led(loop, joint):
            families.lead(loop, joint, shared)
    if core.mode != Mode.OFFLINE and heard:
        ask(loop, shared)
    elif core.mode != Mode.OFFLINE:
        probe(loop, shared)
    send_service_frames(loop, shared)
    if core.tx_length > 0:
        loop.quiet.spoke_ns = core.now_ns


@jit
def say_nothing(loop: Loop) -> None:
    """The wire is gone: drives are silent from now on, and what conversations wanted to say is not said later."""
    for joint in range(loop.params.joint_count):
        if families.is_on_the_bus(loop, joint) and loop.axes[joint].unanswered_since_ns == 0:
            loop.axes[joint].unanswered_since_ns = loop.core.now_ns
    while rings.inbox(loop) > 0 and loop.service_in.records[rings.inbox_slot(loop)].kind == port.SEND:
        rings.inbox_done(loop)


@jit
def mirror(loop: Loop, joint: int) -> None:
    """A mock drive: what is commanded is measured, at this very instant."""
    axis = loop.axes[joint]
    axis.measured_rad = axis.reference_rad = axis.position_rad
    axis.measured_velocity_rad_s = axis.reference_velocity_rad_s = axis.velocity_rad_s
    axis.measured_ns = loop.core.now_ns
    axis.readings += 1
    enabled = 0 if is_limp(loop.core.mode) else status_bits.ENABLED
    axis.status = enabled | status_bits.REACHED | status_bits.ANSWERED


@jit
def ask(loop: Loop, shared: Shared) -> None:
    """Ask every drive that does not report its position for it, and one of them in turn for its status."""
    core, params = loop.core, loop.params
    for joint in range(params.joint_count):
        if families.is_on_the_bus(loop, joint):
            axis = loop.axes[joint]
            if params.reported == 0 or guard.report_is_asked_for(loop, joint):
                families.ask_position(loop, joint, shared)
            if axis.unanswered_since_ns == 0:
                axis.unanswered_since_ns = core.now_ns
    core.status_turn = (core.status_turn + 1) % params.joint_count
    if families.is_on_the_bus(loop, core.status_turn):
        families.ask_status(loop, core.status_turn, shared)
        if core.unheeded_since_ns == 0:
            core.unheeded_since_ns = core.now_ns


@jit
def probe(loop: Loop, shared: Shared) -> None:
    """Ask one drive in turn, now and then, whether anybody is there again: what is asked now only queues up."""
    core, params = loop.core, loop.params
    if not guard.may_probe(loop):
        return
    core.probed_ns = core.now_ns
    core.probe_turn = (core.probe_turn + 1) % params.joint_count
    if families.is_on_the_bus(loop, core.probe_turn):
        families.ask_position(loop, core.probe_turn, shared)


@jit
def send_service_frames(loop: Loop, shared: Shared) -> None:
    """Send what conversations want to say in the bus time this cycle leaves; packets of one command together."""
    core = loop.core
    spare = loop.params.service_bits - core.tx_bits
    core.service_credit_bits = min(core.service_credit_bits + spare, loop.params.service_bits)
    while rings.inbox(loop) > 0 and core.service_credit_bits > 0:
        if loop.service_in.records[rings.inbox_slot(loop)].kind != port.SEND:
            break
        packets = rings.command_length(loop)
        if packets == 0 or not outgoing.has_room(loop, packets):
            break
        for _ in range(packets):
            order = loop.service_in.records[rings.inbox_slot(loop)]
            joint = order.joint
            stops = joint if joint >= 0 and families.is_stop(loop, joint, order.id, order.data) else -1
            outgoing.send(loop, shared, order.id, order.frame_kind, order.length, order.data, order.joined, stops)
            if joint >= 0:
                families.note_what_was_said(loop, joint, order.id, order.data)
            core.service_credit_bits -= frame_bits(order.frame_kind, order.length)
            rings.inbox_done(loop)
