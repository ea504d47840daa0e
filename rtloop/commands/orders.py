"""Orders of the dialogues in ordinary Python: how bring-up sets where the joints are commanded to be."""

import math

from compilation.jit import jit
from rtloop.commands import request_reader, setpoint_reader
from rtloop.memory.axis import NOT_LED
from rtloop.memory.events import record_event
from rtloop.memory.modes import change_mode
from rtloop.memory.state import HISTORY_SLOTS, Loop, Shared
from rtloop.safety.faults import forget_fault, latch_fault
from rtloop.safety.monitor import outlives_a_clear
from rtloop.service import port, rings
from rtloop.trajectory.phases import raise_epoch, slow_down
from shm.layout import MAX_JOINTS
from shm.words import Answer, BusState, Event, Fault, Mode, Outcome, Request, Unreferenced

_ANY_REASON = -1

POSE_DUE_NS = 120_000_000_000
"""A ROS process that starts later than that after homing at the start does not move the arm to its pose."""


@jit
def take_service_orders(loop: Loop, shared: Shared) -> None:
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
            forgive_silence(loop, order.joint)
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
                forget_count(loop, order.joint)
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
def begin_bring_up(loop: Loop, shared: Shared) -> None:
    """Forget the fault, but no reason for which a reference was lost; no motion frame leaves until a goal runs."""
    motion, dialogue = loop.motion, loop.dialogue
    if not change_mode(loop, shared, Mode.BRINGING_UP):
        return
    if loop.fault.code == Fault.COMMAND_RING:
        setpoint_reader.leave_corrupt_records(loop)
    forget_fault(loop)
    slow_down(loop, _ANY_REASON, False)
    motion.per_joint_stop = motion.resync_ns = motion.started = motion.rested = 0
    loop.bus.transmit_inhibited = 0
    dialogue.bring_up_asked = dialogue.release_asked = dialogue.home_asked = dialogue.reference_asked = 0
    dialogue.referencing_joint = -1
    loop.bus.unacknowledged_since_ns = 0
    shared.counters.bus_state = BusState.ACTIVE  # until the controller says otherwise
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        drive, checks = axis.drive, axis.checks
        axis.reference.referenced = 0
        if not outlives_a_clear(loop, joint):
            axis.reference.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP
        axis.measured.readings = drive.status_readings = 0
        checks.bad_statuses = checks.suspect = checks.refusals = 0
        axis.tracking.lag_ns = axis.sent.fast_ready = axis.reply.unanswered_since_ns = 0
        drive.holds_stalled = drive.status = drive.firmware = 0
        drive.status_ns = loop.timing.now_ns
        drive.velocity_rad_s = drive.effort_nm = drive.temperature_c = drive.voltage_v = math.nan


@jit
def forgive_silence(loop: Loop, joint: int) -> None:
    """A drive that had power all along went on counting: its silence costs no angle."""
    axis = loop.axes[joint]
    if axis.reference.unreferenced_reason == Unreferenced.SILENT:
        axis.reference.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP


@jit
def forget_count(loop: Loop, joint: int) -> None:
    """The drive sets its count anew, at a place of its own choice; an earlier loss of power still counts."""
    axis = loop.axes[joint]
    axis.reference.referenced = axis.reference.power_loss_known = 0
    if axis.reference.unreferenced_reason != Unreferenced.POWER_LOST:
        axis.reference.unreferenced_reason = Unreferenced.NOT_HOMED


@jit
def count_from(loop: Loop, joint: int, zero_rad: float, power_loss_known: int) -> None:
    """The joint's count means an angle again: no reading of before is compared with those that follow."""
    axis = loop.axes[joint]
    loop.joints[joint].zero_rad = zero_rad
    axis.reference.power_loss_known = power_loss_known
    axis.reference.referenced = 0  # until the position of the joint is set
    axis.reference.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP
    axis.measured.readings = axis.tracking.lag_ns = 0
    axis.checks.bad_statuses = axis.checks.suspect = axis.checks.refusals = 0


@jit
def sync_setpoint(loop: Loop, joint: int, position_rad: float, reason: int) -> None:
    """The joint stands here; it is commanded to stay."""
    axis = loop.axes[joint]
    commanded, tracking = axis.commanded, axis.tracking
    commanded.position_rad = commanded.next_position_rad = position_rad
    commanded.velocity_rad_s = commanded.next_velocity_rad_s = 0.0
    commanded.acceleration_rad_s2 = commanded.next_acceleration_rad_s2 = 0.0
    commanded.difference_velocity_rad_s = 0.0
    axis.sent.rpm_remainder = axis.sent.fast_offset_rad = 0.0
    axis.sent.led_cycle = NOT_LED
    for slot in range(HISTORY_SLOTS):
        loop.history.position_rad[slot * MAX_JOINTS + joint] = position_rad
    tracking.reference_rad, tracking.reference_velocity_rad_s = position_rad, 0.0
    if axis.measured.readings == 0:
        axis.measured.position_rad = position_rad
        axis.measured.time_ns = loop.timing.now_ns
    tracking.slip_rad = tracking.lag_rad = tracking.error_before_rad = tracking.velocity_error_before_rad_s = 0.0
    tracking.error_acceleration_rad_s2 = tracking.error_acceleration_before_rad_s2 = 0.0
    if reason == Unreferenced.POWER_LOST or not outlives_a_clear(loop, joint):
        axis.reference.unreferenced_reason = reason
    axis.reference.referenced = 1 if axis.reference.unreferenced_reason == Unreferenced.REFERENCED else 0
    if axis.reference.referenced == 1:  # any other is stopped before it is led again
        axis.sent.stop_frames_due = 0
