"""What everybody may see: the snapshot, published at the end of each cycle, and kept by the flight recorder."""

import math

from compilation.jit import jit
from rtloop.memory.recorder import record_cycle
from rtloop.memory.state import Loop
from rtloop.trajectory.path import end_s
from rtloop.trajectory.phases import incoming, running_goal, runs
from shm import layout
from shm.layout import StateFile
from shm.record import offset_of
from shm.seqlock import crc32_at, publish

_SNAPSHOT = offset_of(Loop, "snapshot")
_DECISION_WORDS = offset_of(layout.Snapshot, "cycle") // 8 - 1  # results and answers, behind the CRC
_SNAPSHOT_HEAD_WORDS = offset_of(layout.Snapshot, "joints") // 8
_SNAPSHOT_JOINT_WORDS = layout.Joint.dtype.itemsize // 8
_SHARED_SEQUENCE = offset_of(layout.StateFile, "snapshot_sequence")
_SHARED_SNAPSHOT = offset_of(layout.StateFile, "snapshot")


@jit
def phase_of(loop: Loop) -> int:
    """That of the goal that runs, else of the one that waits."""
    return int(loop.paths[loop.goals.active if runs(loop) else incoming(loop)].phase)


@jit
def publish_snapshot(loop: Loop, shared: StateFile) -> None:
    """Publish the snapshot."""
    published, timing, fault, clock = loop.published, loop.timing, loop.fault, loop.clock
    operator, params, snapshot = loop.operator, loop.params, loop.snapshot
    published.cycle = timing.cycle
    snapshot.cycle = timing.cycle
    snapshot.monotonic_ns = timing.now_ns
    snapshot.epoch_ns = timing.now_ns + timing.epoch_offset_ns
    snapshot.mode = loop.mode
    snapshot.fault = fault.code
    snapshot.fault_joint = fault.joint
    snapshot.fault_value = fault.value
    snapshot.fault_limit = fault.limit
    snapshot.fault_ns = fault.latched_ns
    snapshot.fault_silent = fault.silent
    snapshot.fault_evidence = fault.evidence
    snapshot.goal_id = running_goal(loop)
    snapshot.goal_phase = phase_of(loop)
    snapshot.trajectory_clock_ns = clock.time_s * 1e9
    running = loop.paths[loop.goals.active]
    snapshot.trajectory_end_ns = int(end_s(loop, loop.goals.active) * 1e9) if running.ended == 1 else -1
    snapshot.speed_scale = clock.rate
    snapshot.speed_scale_target = clock.rate_target
    snapshot.speed_scale_asked = operator.speed_scale
    snapshot.motion_started = loop.motion.started
    snapshot.referencing_joint = loop.dialogue.referencing_joint
    snapshot.pose_due = 1 if timing.now_ns < loop.dialogue.pose_due_ns else 0
    snapshot.held = operator.held
    snapshot.stops = operator.stops
    snapshot.epoch = loop.goals.epoch
    for joint in range(params.joint_count):
        axis, shown = loop.axes[joint], snapshot.joints[joint]
        drive = axis.drive
        shown.commanded_position_rad = axis.commanded.position_rad
        shown.commanded_velocity_rad_s = axis.commanded.velocity_rad_s
        shown.commanded_acceleration_rad_s2 = axis.commanded.acceleration_rad_s2
        shown.measured_position_rad = axis.measured.position_rad
        told = drive.velocity_rad_s
        shown.measured_velocity_rad_s = told if math.isfinite(told) else axis.measured.velocity_rad_s
        shown.measured_effort = drive.effort_nm
        shown.drive_temperature_c = drive.temperature_c
        shown.drive_voltage_v = drive.voltage_v
        shown.measured_ns = axis.measured.time_ns
        shown.reference_position_rad = axis.tracking.reference_rad
        shown.reference_velocity_rad_s = axis.tracking.reference_velocity_rad_s
        shown.drive_status = drive.status
        shown.referenced = axis.reference.referenced
        shown.unreferenced_reason = axis.reference.unreferenced_reason
    words = _SNAPSHOT_HEAD_WORDS + params.joint_count * _SNAPSHOT_JOINT_WORDS
    source = params.address + _SNAPSHOT
    if published.decisions_shown == 0:
        published.decisions_crc = crc32_at(source + 8, _DECISION_WORDS)
    changing = 1 + _DECISION_WORDS
    snapshot.crc = crc32_at(source + 8 * changing, words - changing, published.decisions_crc)
    standing = _DECISION_WORDS if published.decisions_shown == 1 else 0
    publish(params.state_address + _SHARED_SEQUENCE, params.state_address + _SHARED_SNAPSHOT, source, words, standing)
    published.decisions_shown = 1
    record_cycle(loop, shared)
