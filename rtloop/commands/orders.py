"""Orders of the conversation in ordinary Python: how bring-up tells the cycle where the joints stand."""

import math
from typing import Any

from rtloop.commands import intake
from rtloop.commands.people import raise_epoch
from rtloop.memory.events import record_event
from rtloop.memory.modes import change_mode
from rtloop.memory.state import HISTORY_SLOTS, NOT_LED
from rtloop.safety.faults import latch_fault
from rtloop.safety.guard import outlives_a_clear
from rtloop.service import port, rings
from shm.jit import jit
from shm.layout import MAX_JOINTS
from shm.words import Answer, BusState, Event, Fault, Mode, Outcome, Request, Unreferenced

POSE_DUE_NS = 120_000_000_000
"""A ROS process that begins later than that after homing at the start finds an arm that nobody expects to move."""

Loop = Any  # record of dtype rtloop.memory.state.LOOP
Shared = Any  # record of dtype shm.layout.STATE


@jit
def take_service_orders(loop: Loop, shared: Shared) -> None:
    """Obey bring-up's decisions up to the next frame it wants sent (frames leave in `encode`)."""
    core = loop.core
    while rings.inbox(loop) > 0:
        order = loop.service_in.records[rings.inbox_slot(loop)]
        if order.kind == port.SEND:
            break
        if order.kind == port.BRING_UP_BEGINS:
            begin_bring_up(loop, shared)
            core.healed_ns = core.now_ns if order.code == 1 else 0
            if order.code == 1:
                record_event(loop, shared, Event.HEALED, -1, 0, 0.0, 0.0)
        elif order.kind == port.ADOPT:
            if core.mode == Mode.BRINGING_UP or core.mode == Mode.REFERENCING:
                adopt(loop, order.joint, order.value, order.code)
        elif order.kind == port.POWER_KEPT:
            forgive_silence(loop, order.joint)
        elif order.kind == port.FAST_READY:
            loop.axes[order.joint].fast_ready = 1
        elif order.kind == port.HOLDS_STALLED:
            loop.axes[order.joint].holds_stalled = 1
        elif order.kind == port.BRING_UP_DONE:
            if core.mode == Mode.BRINGING_UP:
                raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
                change_mode(loop, shared, Mode.HOLDING)
        elif order.kind == port.COUNT_FROM:
            if core.mode == Mode.REFERENCING:
                count_from(loop, order.joint, order.value, order.code)
        elif order.kind == port.REFERENCING:
            core.referencing_joint = order.joint
            loop.axes[order.joint].fast_ready = 0  # until its drive has been seen to take FC as absolute again
            if order.code == 1 and core.mode == Mode.REFERENCING:
                forget_count(loop, order.joint)
        elif order.kind == port.HOME_ALL:
            if intake.begin_referencing(loop, shared, Request.HOME, 0, 0.0) == Answer.DONE:
                core.pose_due_ns = 1
        elif order.kind == port.REFERENCING_DONE:
            core.referencing_joint = -1
            if core.mode == Mode.REFERENCING:
                raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
                change_mode(loop, shared, Mode.HOLDING)
            if core.pose_due_ns != 0:
                core.pose_due_ns = core.now_ns + POSE_DUE_NS
        elif order.kind == port.BRING_UP_FAILED:
            latch_fault(loop, shared, order.code, order.joint, order.value, 0.0)
        rings.inbox_done(loop)


@jit
def begin_bring_up(loop: Loop, shared: Shared) -> None:
    """Forget the fault, but no reason for which a reference was lost; no motion frame leaves until a goal runs."""
    core = loop.core
    if not change_mode(loop, shared, Mode.BRINGING_UP):
        return
    if core.fault == Fault.COMMAND_RING:
        intake.leave_corrupt_records(loop)
    core.fault = Fault.NONE
    core.fault_joint = -1
    core.fault_value = core.fault_limit = 0.0
    core.fault_silent = core.fault_evidence = 0
    core.own_brake = core.slowed = core.rebase_ns = 0
    core.motion_started = core.silenced = core.rested = 0
    core.bring_up_asked = core.release_asked = core.home_asked = core.reference_asked = 0
    core.referencing_joint = -1
    core.unheeded_since_ns = 0
    shared.counters.bus_state = BusState.ACTIVE  # until the controller says otherwise
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        axis.referenced = 0
        if not outlives_a_clear(loop, joint):
            axis.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP
        axis.readings = axis.status_readings = axis.bad_statuses = axis.doubted = axis.refusals = 0
        axis.lag_ns = axis.fast_ready = axis.holds_stalled = 0
        axis.status = axis.firmware = 0
        axis.unanswered_since_ns = 0
        axis.status_ns = core.now_ns
        axis.told_velocity_rad_s = axis.effort_nm = axis.temperature_c = axis.voltage_v = math.nan


@jit
def forgive_silence(loop: Loop, joint: int) -> None:
    """A drive that had power all along went on counting: that nobody heard it says nothing against its angle."""
    axis = loop.axes[joint]
    if axis.unreferenced_reason == Unreferenced.SILENT:
        axis.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP


@jit
def forget_count(loop: Loop, joint: int) -> None:
    """The drive sets its count anew, at a place of its own choice; what made it doubtful before still does."""
    axis = loop.axes[joint]
    axis.referenced = axis.power_loss_known = 0
    if axis.unreferenced_reason != Unreferenced.POWER_LOST:
        axis.unreferenced_reason = Unreferenced.NOT_HOMED


@jit
def count_from(loop: Loop, joint: int, zero_rad: float, power_loss_known: int) -> None:
    """The joint's count means an angle again: no reading of before is compared with those that follow."""
    axis = loop.axes[joint]
    loop.joints[joint].zero_rad = zero_rad
    axis.power_loss_known = power_loss_known
    axis.referenced = 0  # until it is told where the joint stands
    axis.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP
    axis.readings = axis.bad_statuses = axis.doubted = axis.refusals = axis.lag_ns = 0


@jit
def adopt(loop: Loop, joint: int, position_rad: float, reason: int) -> None:
    """The joint stands here; it is commanded to stay."""
    axis = loop.axes[joint]
    axis.position_rad = axis.next_position_rad = position_rad
    axis.velocity_rad_s = axis.next_velocity_rad_s = 0.0
    axis.acceleration_rad_s2 = axis.next_acceleration_rad_s2 = 0.0
    axis.difference_velocity_rad_s = 0.0
    axis.rpm_remainder = axis.fast_offset_rad = 0.0
    axis.led_cycle = NOT_LED
    for slot in range(HISTORY_SLOTS):
        loop.history_rad[slot * MAX_JOINTS + joint] = position_rad
    axis.reference_rad, axis.reference_velocity_rad_s = position_rad, 0.0
    if axis.readings == 0:
        axis.measured_rad = position_rad
        axis.measured_ns = loop.core.now_ns
    axis.slip_rad = axis.lag_rad = axis.error_before_rad = axis.velocity_error_before_rad_s = 0.0
    axis.error_acceleration_rad_s2 = axis.error_acceleration_before_rad_s2 = 0.0
    if reason == Unreferenced.POWER_LOST or not outlives_a_clear(loop, joint):
        axis.unreferenced_reason = reason
    axis.referenced = 1 if axis.unreferenced_reason == Unreferenced.REFERENCED else 0
    if axis.referenced == 1:  # any other is stopped before it is led again
        axis.stop_frames_due = 0
