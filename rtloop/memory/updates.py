"""A part's own functions: they set many of its fields at once, or count in one, for whoever has cause to."""

import math

from compilation.jit import jit
from rtloop.memory.axis import NOT_LED, STOP_FRAMES, Axis
from rtloop.memory.motion import Motion
from rtloop.memory.state import HISTORY_SLOTS, History
from shm.layout import MAX_JOINTS


@jit
def forget_motion(motion: Motion) -> None:
    """Nothing has been led since the drives were brought up."""
    motion.per_joint_stop = motion.resync_ns = motion.started = motion.rested = 0


@jit
def forget_readings(axis: Axis) -> None:
    """No reading of before is compared with those that follow."""
    axis.measured.readings = axis.tracking.lag_ns = 0
    axis.checks.bad_statuses = axis.checks.suspect = axis.checks.refusals = 0


@jit
def forget_drive(axis: Axis, now_ns: int) -> None:
    """Nothing counts that its drive has said so far: it is brought up anew."""
    drive = axis.drive
    forget_readings(axis)
    axis.reply.unanswered_since_ns = 0
    axis.sent.fast_ready = 0
    drive.status_readings = drive.holds_stalled = drive.status = drive.firmware = 0
    drive.status_ns = now_ns
    drive.velocity_rad_s = drive.effort_nm = drive.temperature_c = drive.voltage_v = math.nan


@jit
def stand(axis: Axis, position_rad: float, now_ns: int) -> None:
    """The joint stands here and is commanded to stay; nothing is left of how it came here."""
    commanded, tracking, sent = axis.commanded, axis.tracking, axis.sent
    commanded.position_rad = commanded.next_position_rad = position_rad
    commanded.velocity_rad_s = commanded.next_velocity_rad_s = 0.0
    commanded.acceleration_rad_s2 = commanded.next_acceleration_rad_s2 = 0.0
    commanded.difference_velocity_rad_s = 0.0
    sent.rpm_remainder = sent.fast_offset_rad = 0.0
    sent.led_cycle = NOT_LED
    tracking.reference_rad, tracking.reference_velocity_rad_s = position_rad, 0.0
    tracking.slip_rad = tracking.lag_rad = tracking.error_before_rad = tracking.velocity_error_before_rad_s = 0.0
    tracking.error_acceleration_rad_s2 = tracking.error_acceleration_before_rad_s2 = 0.0
    if axis.measured.readings == 0:
        axis.measured.position_rad = position_rad
        axis.measured.time_ns = now_ns


@jit
def owe_stop(axis: Axis) -> None:
    """Its drive is to be told to stay where it is, whatever it was told before."""
    axis.sent.stop_frames_due = STOP_FRAMES


@jit
def owe_no_stop(axis: Axis) -> None:
    """It is led again."""
    axis.sent.stop_frames_due = 0


@jit
def stop_left(axis: Axis) -> None:
    """One stop frame has been handed to the wire."""
    axis.sent.stop_frames_due -= 1


@jit
def stop_came_back(axis: Axis) -> None:
    """The wire did not take a stop frame."""
    axis.sent.stop_frames_due += 1


@jit
def stood(history: History, joint: int, position_rad: float) -> None:
    """As far as it is remembered, the joint was commanded to stand here."""
    for slot in range(HISTORY_SLOTS):
        history.position_rad[slot * MAX_JOINTS + joint] = position_rad
