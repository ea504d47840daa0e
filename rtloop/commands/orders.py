"""Orders of the dialogues in ordinary Python: how bring-up sets where the joints are commanded to be."""

from compilation.jit import jit
from rtloop.commands import request_reader, setpoint_reader
from rtloop.memory.events import record_event
from rtloop.memory.modes import change_mode
from rtloop.memory.state import Loop
from rtloop.memory.updates import forget_drive, forget_motion, forget_readings, stand, stood
from rtloop.safety import references
from rtloop.safety.faults import forget_fault, latch_fault
from rtloop.service import port, rings
from rtloop.trajectory.phases import raise_epoch, slow_down
from shm.layout import StateFile
from shm.words import Answer, BusState, Event, Fault, Mode, Outcome, Request

_ANY_REASON = -1

POSE_DUE_NS = 120_000_000_000
"""A ROS process that starts later than that after homing at the start does not move the arm to its pose."""


@jit
def take_service_orders(loop: Loop, shared: StateFile) -> None:
    """Obey bring-up's decisions up to the next frame it wants sent (frames leave in `encode`)."""
    dialogue = loop.dialogue
    while rings.inbox(loop) > 0:
        order = loop.service_in.records[rings.inbox_slot(loop)]
        if order.kind == port.SEND:
            break
        if order.kind == port.BRING_UP_BEGINS:
            begin_bring_up(loop, shared)
            dialogue.healed_ns = loop.timing.now_ns if order.code == 1 else 0
            if order.code == 1:
                record_event(loop, shared, Event.HEALED, -1, 0, 0.0, 0.0)
        elif order.kind == port.SYNC_SETPOINT:
            if loop.mode == Mode.BRINGING_UP or loop.mode == Mode.REFERENCING:
                sync_setpoint(loop, order.joint, order.value, order.code)
        elif order.kind == port.POWER_KEPT:
            references.forgive_silence(loop, order.joint)
        elif order.kind == port.FAST_READY:
            loop.axes[order.joint].sent.fast_ready = 1
        elif order.kind == port.HOLDS_STALLED:
            loop.axes[order.joint].drive.holds_stalled = 1
        elif order.kind == port.BRING_UP_DONE:
            if loop.mode == Mode.BRINGING_UP:
                raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
                change_mode(loop, shared, Mode.HOLDING)
        elif order.kind == port.COUNT_FROM:
            if loop.mode == Mode.REFERENCING:
                count_from(loop, order.joint, order.value, order.code)
        elif order.kind == port.REFERENCING:
            dialogue.referencing_joint = order.joint
            loop.axes[order.joint].sent.fast_ready = 0  # until its drive has been seen to take FC as absolute again
            if order.code == 1 and loop.mode == Mode.REFERENCING:
                references.forget_count(loop, order.joint)
        elif order.kind == port.HOME_ALL:
            if request_reader.begin_referencing(loop, shared, Request.HOME, 0, 0.0) == Answer.DONE:
                dialogue.pose_due_ns = 1
        elif order.kind == port.REFERENCING_DONE:
            dialogue.referencing_joint = -1
            if loop.mode == Mode.REFERENCING:
                raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
                change_mode(loop, shared, Mode.HOLDING)
            if dialogue.pose_due_ns != 0:
                dialogue.pose_due_ns = loop.timing.now_ns + POSE_DUE_NS
        elif order.kind == port.BRING_UP_FAILED:
            latch_fault(loop, shared, order.code, order.joint, order.value, 0.0)
        rings.inbox_done(loop)


@jit
def begin_bring_up(loop: Loop, shared: StateFile) -> None:
    """Forget the fault, but no reason for which a reference was lost; no motion frame leaves until a goal runs."""
    dialogue = loop.dialogue
    if not change_mode(loop, shared, Mode.BRINGING_UP):
        return
    if loop.fault.code == Fault.COMMAND_RING:
        setpoint_reader.leave_corrupt_records(loop)
    forget_fault(loop)
    slow_down(loop, _ANY_REASON, False)
    forget_motion(loop.motion)
    dialogue.bring_up_asked = dialogue.release_asked = dialogue.home_asked = dialogue.reference_asked = 0
    dialogue.referencing_joint = -1
    for number in range(loop.params.bus_count):
        bus = loop.buses[number]
        bus.transmit_inhibited = bus.unacknowledged_since_ns = 0
        shared.buses[number].bus_state = BusState.ACTIVE  # until the controller says otherwise
    shared.counters.bus_state = BusState.ACTIVE
    for joint in range(loop.params.joint_count):
        references.await_bring_up(loop, joint)
        forget_drive(loop.axes[joint], loop.timing.now_ns)


@jit
def count_from(loop: Loop, joint: int, zero_rad: float, power_loss_known: int) -> None:
    """The joint's count means an angle again: no reading of before is compared with those that follow."""
    loop.joints[joint].zero_rad = zero_rad
    references.take_count(loop, joint, power_loss_known)
    forget_readings(loop.axes[joint])


@jit
def sync_setpoint(loop: Loop, joint: int, position_rad: float, reason: int) -> None:
    """The joint stands here; it is commanded to stay."""
    stand(loop.axes[joint], position_rad, loop.timing.now_ns)
    stood(loop.history, joint, position_rad)
    references.refer(loop, joint, reason)
