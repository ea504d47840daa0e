"""Requests from the front and from `rtarm`: copied out of the command file, checked, answered."""

import math

from compilation.jit import jit
from rtloop.commands.setpoint_reader import CYCLES_TO_BECOME_VISIBLE
from rtloop.memory.buses import bus_of
from rtloop.memory.events import answer_request
from rtloop.memory.link import GRIPPER
from rtloop.memory.modes import change_mode, is_disabled
from rtloop.memory.state import Loop
from rtloop.safety.faults import latch_fault
from rtloop.trajectory.limits import at_rest
from rtloop.trajectory.phases import raise_epoch, runs, waits
from rtloop.wire import received
from shm import layout
from shm.atomics import load_acquire, store_release
from shm.layout import StateFile
from shm.record import offset_of
from shm.seqlock import copy_words, crc32_at
from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced

REQUESTS_A_CYCLE = 4

_REQUESTS_WRITTEN = offset_of(layout.CommandFile, "requests_written")
_REQUESTS = offset_of(layout.CommandFile, "requests")
_REQUEST_BYTES = layout.Request.dtype.itemsize
_CONSUMED_REQUESTS = offset_of(layout.StateFile, "consumed", "requests")
_SCRATCH_REQUEST = offset_of(Loop, "scratch_request")


@jit
def take_requests(loop: Loop, shared: StateFile) -> None:
    """Take and answer a bounded batch of requests."""
    front = loop.front
    command = loop.params.command_address
    if command == 0:
        return
    # pairs with `CommandWriter.request`, plain stores: number and CRC tell whether the record is there
    written = load_acquire(command + _REQUESTS_WRITTEN)
    waiting = written - front.requests_taken
    if waiting < 0 or waiting > layout.REQUEST_SLOTS:
        latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(waiting), float(layout.REQUEST_SLOTS))
        front.requests_taken = written
        waiting = 0
    scratch = loop.params.address + _SCRATCH_REQUEST
    for _ in range(min(waiting, REQUESTS_A_CYCLE)):
        source = command + _REQUESTS + (front.requests_taken & (layout.REQUEST_SLOTS - 1)) * _REQUEST_BYTES
        copy_words(scratch, source, _REQUEST_BYTES // 8)
        request = loop.scratch_request
        if request.crc != crc32_at(scratch + 8, _REQUEST_BYTES // 8 - 1) or (
            request.sequence != front.requests_taken + 1
        ):
            front.request_waits += 1
            if front.request_waits > CYCLES_TO_BECOME_VISIBLE:
                latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(front.requests_taken), 0.0)
                front.requests_taken = written
                front.request_waits = 0
            break
        front.request_waits = 0
        front.requests_taken += 1
        answer_request(loop, shared, request.sequence, request.kind, _obey(loop, shared))
    # pairs with `StateReader.requests_consumed`, a plain load: what is overwritten too early fails its CRC
    store_release(loop.params.state_address + _CONSUMED_REQUESTS, front.requests_taken)


@jit
def _obey(loop: Loop, shared: StateFile) -> int:
    dialogue, request = loop.dialogue, loop.scratch_request
    kind = request.kind
    if request.epoch != loop.goals.epoch and (
        kind == Request.HOME or kind == Request.GRIP or kind == Request.GRIP_HOME
    ):
        return Answer.REFUSED_OUTDATED
    if kind == Request.GRIP or kind == Request.GRIP_STOP or kind == Request.GRIP_HOME:
        return _pass_to_gripper(loop)
    dialogue.pose_due_ns = 0
    if kind == Request.CLEAR_FAULT:
        if loop.mode != Mode.FAULT:
            return Answer.REFUSED_MODE
        if lacks_a_wire(loop):
            return Answer.REFUSED_WIRE
        if runs(loop) or not at_rest(loop):
            return Answer.REFUSED_MOVING
        dialogue.bring_up_asked = 1
        return Answer.DONE
    if kind == Request.ENABLE:
        if not is_disabled(loop.mode):
            return Answer.DONE if loop.mode == Mode.HOLDING or loop.mode == Mode.EXECUTING else Answer.REFUSED_MODE
        dialogue.bring_up_asked = 1
        dialogue.release_asked = 0
        return Answer.DONE
    if kind == Request.DISABLE or kind == Request.FREE:
        return _disable(loop, shared, Mode.DISABLED if kind == Request.DISABLE else Mode.FREE)
    if kind == Request.HOME_STOP:
        if loop.mode != Mode.REFERENCING:
            return Answer.REFUSED_MODE
        dialogue.referencing_ends = 1
        return Answer.DONE
    if kind == Request.HOME or kind == Request.REFERENCE:
        return begin_referencing(loop, shared, kind, request.joint_mask, request.value)
    return Answer.REFUSED_UNKNOWN


@jit
def lacks_a_wire(loop: Loop) -> bool:
    """Whether the wire of one of the arm's buses is gone."""
    for number in range(loop.params.bus_count):
        bus = loop.buses[number]
        if received.closed(bus) != 0:
            return True
    return False


@jit
def _pass_to_gripper(loop: Loop) -> int:
    """Leave a request for the gripper's conversation, whatever the arm is doing: a newer one replaces an older one."""
    gripper, params, request = loop.gripper, loop.params, loop.scratch_request
    if params.has_gripper == 0:
        return Answer.REFUSED_UNKNOWN
    if loop.mode == Mode.OFFLINE:
        return Answer.REFUSED_MODE
    if received.closed(bus_of(loop, GRIPPER)) != 0:
        return Answer.REFUSED_WIRE
    if loop.operator.held == 1 and request.kind != Request.GRIP_STOP:
        return Answer.REFUSED_HELD
    if request.kind == Request.GRIP:
        inside = request.value >= params.gripper_lower_rad and request.value <= params.gripper_upper_rad
        if not (inside and request.most_effort >= 0.0 and math.isfinite(request.most_effort)):
            return Answer.REFUSED_VALUE
    gripper.kind = request.kind
    gripper.position_rad = request.value
    gripper.effort = request.most_effort
    gripper.sequence = request.sequence  # the last: the other thread looks for it
    return Answer.DONE


@jit
def _disable(loop: Loop, shared: StateFile, mode: int) -> int:
    """Disable the drives of a standing arm; nothing else ever does."""
    if loop.mode == mode:
        return Answer.DONE
    if loop.mode == Mode.EXECUTING or loop.mode == Mode.STOPPING or waits(loop) or loop.motion.resync_ns != 0:
        return Answer.REFUSED_MOVING
    if loop.dialogue.bring_up_asked == 1:
        return Answer.REFUSED_MODE
    disabled_already = is_disabled(loop.mode)
    if not change_mode(loop, shared, mode):
        return Answer.REFUSED_MODE
    raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
    loop.motion.started = 0
    if not disabled_already:
        loop.dialogue.release_asked = 1
    return Answer.DONE


@jit
def begin_referencing(loop: Loop, shared: StateFile, kind: int, joint_mask: int, angle_rad: float) -> int:
    """Begin to home joints of a standing arm, or to set their angles as requested."""
    dialogue, count = loop.dialogue, loop.params.joint_count
    if kind == Request.HOME and loop.operator.held == 1:
        return Answer.REFUSED_HELD
    if joint_mask == 0 and kind == Request.HOME:
        joint_mask = loop.params.homing_mask
    if joint_mask <= 0 or joint_mask >> count != 0 or math.isinf(angle_rad):
        return Answer.REFUSED_VALUE
    for joint in range(count):
        if (joint_mask >> joint) & 1 and kind == Request.REFERENCE and not _may_stand_at(loop, joint, angle_rad):
            return Answer.REFUSED_VALUE
    if loop.mode == Mode.EXECUTING or loop.mode == Mode.STOPPING or waits(loop) or loop.motion.resync_ns != 0:
        return Answer.REFUSED_MOVING
    if dialogue.bring_up_asked == 1 or not change_mode(loop, shared, Mode.REFERENCING):
        return Answer.REFUSED_MODE
    raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
    dialogue.referencing_ends = 0
    for joint in range(count):
        if (joint_mask >> joint) & 1:
            loop.axes[joint].asked_rad = angle_rad
    dialogue.home_asked = joint_mask if kind == Request.HOME else 0  # the last: the other thread looks for them
    dialogue.reference_asked = joint_mask if kind == Request.REFERENCE else 0
    return Answer.DONE


@jit
def _may_stand_at(loop: Loop, joint: int, angle_rad: float) -> bool:
    """Whether a joint may be set to an angle: inside its limits, or NaN (its own count) where that is trusted."""
    if math.isnan(angle_rad):
        reason = loop.axes[joint].reference.unreferenced_reason
        return bool(reason != Unreferenced.POWER_LOST and reason != Unreferenced.NOT_HOMED)
    row = loop.joints[joint]
    return bool(row.lower_rad <= angle_rad <= row.upper_rad)
