"""Making the next setpoint: along the path, standing, braking joint by joint, or where the drives came to rest."""

import math

from compilation.jit import jit
from rtloop.commands.orders import sync_setpoint
from rtloop.memory.axis import FAMILY_MOCK
from rtloop.memory.modes import is_disabled
from rtloop.memory.state import Loop
from rtloop.safety import setpoint_check
from rtloop.safety.faults import path_is_trusted, stop_each_joint
from rtloop.trajectory.clock import advance_clock, along
from rtloop.trajectory.limits import clamped_rad, hardest_rad_s2, stopping_distance_rad
from rtloop.trajectory.path import find_waypoint, sample
from rtloop.trajectory.phases import runs
from shm.layout import StateFile
from shm.words import Unreferenced

STILL_SHARE = 0.002
STILL_COUNTS = 3.0
"""Below this share of its highest velocity, or this many encoder counts a cycle, a joint stands after a gap."""


@jit
def move(loop: Loop, shared: StateFile) -> None:
    """Make the next setpoint; one that breaks a limit is replaced by braking from the present one."""
    motion = loop.motion
    if motion.resync_ns != 0:
        hold_measured(loop)
        return
    if is_disabled(loop.mode):
        follow_by_hand(loop)
        return
    if motion.per_joint_stop == 0:
        if runs(loop):
            follow_path(loop)
        else:
            hold(loop)
        if not setpoint_check.check_next_setpoint(loop, shared) and path_is_trusted(loop.fault.code):
            stop_each_joint(loop)
    if motion.per_joint_stop == 1:
        brake_each_joint(loop)


@jit
def hold(loop: Loop) -> None:
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        axis.commanded.next_position_rad = axis.commanded.position_rad
        axis.commanded.next_velocity_rad_s = 0.0
        axis.commanded.next_acceleration_rad_s2 = 0.0


@jit
def follow_by_hand(loop: Loop) -> None:
    """Limp joints are commanded to be where they are, so that nothing pulls when the drives are enabled again."""
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        if axis.reference.referenced == 1 and axis.measured.readings > 0:
            axis.commanded.position_rad = axis.measured.position_rad
            axis.tracking.reference_rad, axis.tracking.reference_velocity_rad_s = (
                axis.measured.position_rad,
                axis.measured.velocity_rad_s,
            )
            axis.commanded.difference_velocity_rad_s = axis.tracking.error_acceleration_rad_s2 = 0.0
    hold(loop)


@jit
def hold_measured(loop: Loop) -> None:
    """Command where the drives really are, once they stand: they braked by themselves while the loop was away.

    Until then no motion frame leaves, since the last commanded positions lie behind them. After `drives_patience_ns`
    they stand, whatever their readings look like.
    """
    motion = loop.motion
    hold(loop)
    for joint in range(loop.params.joint_count):
        axis, row = loop.axes[joint], loop.joints[joint]
        if axis.reference.referenced == 1 and row.family != FAMILY_MOCK:
            dither = STILL_COUNTS * row.reading_step_rad / (loop.params.period_ns * 1e-9)
            still = abs(axis.measured.velocity_rad_s) < max(STILL_SHARE * row.max_velocity_rad_s, dither)
            seen = axis.measured.time_ns >= motion.resync_ns + 2 * loop.params.period_ns
            if not (seen and still) and loop.timing.now_ns - motion.resync_ns < loop.params.drives_patience_ns:
                return
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        if axis.reference.referenced == 1:
            sync_setpoint(loop, joint, axis.measured.position_rad, Unreferenced.REFERENCED)
    motion.resync_ns = 0
    motion.per_joint_stop = 0


@jit
def follow_path(loop: Loop) -> None:
    """Advance the clock by a period at its rate and sample the path there."""
    goals, clock = loop.goals, loop.clock
    advance_clock(loop)
    running = loop.paths[goals.active]
    running.segment = find_waypoint(loop, goals.active, clock.time_s, running.segment)
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        p, v, a = sample(loop, goals.active, joint, clock.time_s, running.segment)
        axis.commanded.next_position_rad = p
        axis.commanded.next_velocity_rad_s, axis.commanded.next_acceleration_rad_s2 = along(
            clock.rate, clock.slope, v, a
        )


@jit
def brake_each_joint(loop: Loop) -> None:
    """Every joint comes to rest by itself with the braking acceleration: for when the path is not trusted.

    From the velocity between its last two setpoints, not from what the path claimed it to be; and harder, by as much as
    the last line of defence lets pass, where it would leave its position limits otherwise.
    """
    period_s = loop.params.period_ns * 1e-9
    for joint in range(loop.params.joint_count):
        axis, row = loop.axes[joint], loop.joints[joint]
        commanded = axis.commanded
        v = commanded.difference_velocity_rad_s
        braking = loop.params.braking_factor * row.max_acceleration_rad_s2
        stop = commanded.position_rad + stopping_distance_rad(v, braking, period_s)
        if stop != clamped_rad(row, stop):
            braking = hardest_rad_s2(loop, joint)
        most = braking * period_s
        slower = 0.0 if abs(v) <= most else v - math.copysign(most, v)
        commanded.next_position_rad = commanded.position_rad + slower * period_s
        commanded.next_velocity_rad_s = slower
        commanded.next_acceleration_rad_s2 = (slower - v) / period_s if slower != 0.0 else 0.0
