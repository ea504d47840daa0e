"""What everybody may see: the snapshot, published at the end of each cycle, and kept by the flight recorder."""

import math
from typing import Any

from rtloop.memory.recorder import record_cycle
from rtloop.memory.state import LOOP, offset_of
from rtloop.trajectory.path import end_s
from rtloop.trajectory.phases import incoming, running_goal, runs
from shm import layout
from shm.jit import jit
from shm.seqlock import crc32_at, publish

Loop = Any  # record of dtype rtloop.memory.state.LOOP
Shared = Any  # record of dtype shm.layout.STATE

_SNAPSHOT = offset_of(LOOP, "snapshot")
_DECISION_WORDS = offset_of(layout.SNAPSHOT, "cycle") // 8 - 1  # results and answers, behind the CRC
_SNAPSHOT_HEAD_WORDS = offset_of(layout.SNAPSHOT, "joints") // 8
_SNAPSHOT_JOINT_WORDS = layout.JOINT.itemsize // 8
_SHARED_SEQUENCE = offset_of(layout.STATE, "snapshot_sequence")
_SHARED_SNAPSHOT = offset_of(layout.STATE, "snapshot")


@jit
def phase_of(loop: Loop) -> int:
    """That of the goal that runs, else of the one that waits."""
    return int(loop.paths[loop.core.active if runs(loop) else incoming(loop)].phase)


@jit
def show(loop: Loop, shared: Shared) -> None:
    """Publish the snapshot."""
    core, params, snapshot = loop.core, loop.params, loop.snapshot
    core.shown_cycle = core.cycle
    snapshot.cycle = core.cycle
    snapshot.monotonic_ns = core.now_ns
    snapshot.epoch_ns = core.now_ns + core.epoch_offset_ns
    snapshot.mode = core.mode
    snapshot.fault = core.fault
    snapshot.fault_joint = core.fault_joint
    snapshot.fault_value = core.fault_value
    snapshot.fault_limit = core.fault_limit
    snapshot.fault_ns = core.fault_ns
    snapshot.fault_silent = core.fault_silent
    snapshot.fault_evidence = core.fault_evidence
    snapshot.goal_id = running_goal(loop)
    snapshot.goal_phase = phase_of(loop)
    snapshot.trajectory_clock_ns = core.clock_s * 1e9
    running = loop.paths[core.active]
    snapshot.trajectory_end_ns = int(end_s(loop, core.active) * 1e9) if running.ended == 1 else -1
    snapshot.speed_scale = core.rate
    snapshot.speed_scale_target = core.rate_target
    snapshot.speed_scale_asked = core.speed_scale
    snapshot.motion_started = core.motion_started
    snapshot.referencing_joint = core.referencing_joint
    snapshot.pose_due = 1 if core.now_ns < core.pose_due_ns else 0
    snapshot.held = core.held
    snapshot.stops = core.stops
    snapshot.epoch = core.epoch
    for joint in range(params.joint_count):
        axis, shown = loop.axes[joint], snapshot.joints[joint]
        shown.commanded_position_rad = axis.position_rad
        shown.commanded_velocity_rad_s = axis.velocity_rad_s
        shown.commanded_acceleration_rad_s2 = axis.acceleration_rad_s2
        shown.measured_position_rad = axis.measured_rad
        told = axis.told_velocity_rad_s
        shown.measured_velocity_rad_s = told if math.isfinite(told) else axis.measured_velocity_rad_s
        shown.measured_effort = axis.effort_nm
        shown.drive_temperature_c = axis.temperature_c
        shown.drive_voltage_v = axis.voltage_v
        shown.measured_ns = axis.measured_ns
        shown.reference_position_rad = axis.reference_rad
        shown.reference_velocity_rad_s = axis.reference_velocity_rad_s
        shown.drive_status = axis.status
        shown.referenced = axis.referenced
        shown.unreferenced_reason = axis.unreferenced_reason
    words = _SNAPSHOT_HEAD_WORDS + params.joint_count * _SNAPSHOT_JOINT_WORDS
    source = params.address + _SNAPSHOT
    if core.decisions_shown == 0:
        core.decisions_crc = crc32_at(source + 8, _DECISION_WORDS)
    changing = 1 + _DECISION_WORDS
    snapshot.crc = crc32_at(source + 8 * changing, words - changing, core.decisions_crc)
    standing = _DECISION_WORDS if core.decisions_shown == 1 else 0
    publish(params.state_address + _SHARED_SEQUENCE, params.state_address + _SHARED_SNAPSHOT, source, words, standing)
    core.decisions_shown = 1
    record_cycle(loop, shared)
