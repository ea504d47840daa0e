"""The last line of defence: what is about to be commanded, and what was measured, against the limits.

A next setpoint that breaks a limit is never sent: the fault is latched first and the arm brakes from the
last good one.
"""

import math

from compilation.jit import jit
from config.frames import ADAPTER_FRAMES
from motion import limits
from rtloop.memory import status as status_bits
from rtloop.memory.axis import FAMILY_MOCK, FRESH_READINGS, Commanded
from rtloop.memory.events import record_event
from rtloop.memory.modes import is_limp
from rtloop.memory.state import Loop, Shared
from rtloop.safety import references, silence
from rtloop.safety.agreed import agreed_error_rad, agreed_error_rad_s, agreed_error_rad_s2
from rtloop.safety.faults import latch_fault
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from rtloop.trajectory.limits import at_rest, band, first_broken, hardest_rad_s2, highest_rad_s
from rtloop.trajectory.path import in_goal
from rtloop.trajectory.phases import slow_down, stop_running
from shm.words import Event, Fault, Mode, Outcome, Phase, Slowed, Unreferenced

_LATE_DRIVE = int(Slowed.LATE_DRIVE)

STATUSES_TO_BELIEVE = 2
REFUSALS_TO_BELIEVE = 2
STOP_FRAMES = 3
PROBES = 10
"""Drives are asked so often, each time one of them, between the last frame anybody heard and the latched fault."""
HAND_SHARE = 2.0
"""A limp joint led by hand may move at this many times its highest velocity."""
BESIDE_RAD = 1e-9
"""What the arithmetic of a stop may put a joint beyond its limit."""

absolute_makes_good = jit(references.absolute_makes_good)


@jit
def check_next_setpoint(loop: Loop, shared: Shared) -> bool:
    """Whether every joint's next setpoint is finite and inside its limits; latches the first that is not.

    Velocity and acceleration are differences of the positions themselves, not of what the sampler claims. A setpoint
    from which the joint could not be stopped inside its position limits any more, with all the acceleration that may
    be commanded, breaks them too: whatever followed would.
    """
    params = loop.params
    period_s = params.period_ns * 1e-9
    for joint in range(params.joint_count):
        row, axis = loop.joints[joint], loop.axes[joint]
        commanded = axis.commanded
        p = commanded.next_position_rad
        if not math.isfinite(setpoint_sum(commanded)):
            latch_fault(loop, shared, Fault.NOT_FINITE, joint, setpoint_sum(commanded), 0.0)
            return False
        velocity = (p - commanded.position_rad) / period_s
        acceleration = (velocity - commanded.difference_velocity_rad_s) / period_s
        max_velocity, max_acceleration = highest_rad_s(loop, joint), hardest_rad_s2(loop, joint)
        low, high = band(row.lower_rad, row.upper_rad, row.slack_rad)
        broken = first_broken(
            p,
            velocity,
            acceleration,
            min(low, commanded.position_rad),  # a joint that was found outside may move in
            max(high, commanded.position_rad),
            max_velocity,
            # one step of a position in double precision, differenced twice, is not an acceleration
            max_acceleration + 1e-15 / (period_s * period_s),
        )
        if broken == limits.POSITION:
            latch_fault(loop, shared, Fault.POSITION_LIMIT, joint, p, low if p < low else high)
            return False
        stop = p + way_to_rest(velocity, max_acceleration, period_s)
        if (velocity > 0.0 and stop > high + BESIDE_RAD) or (velocity < 0.0 and stop < low - BESIDE_RAD):
            latch_fault(loop, shared, Fault.POSITION_LIMIT, joint, stop, low if velocity < 0.0 else high)
            return False
        if broken == limits.VELOCITY:
            latch_fault(loop, shared, Fault.VELOCITY_LIMIT, joint, velocity, max_velocity)
            return False
        if broken == limits.ACCELERATION:
            latch_fault(loop, shared, Fault.ACCELERATION_LIMIT, joint, acceleration, max_acceleration)
            return False
    return True


@jit
def setpoint_sum(commanded: Commanded) -> float:
    """Finite only where all of the next setpoint is, since no sum with what is not finite is."""
    return float(commanded.next_position_rad + commanded.next_velocity_rad_s + commanded.next_acceleration_rad_s2)


@jit
def may_be_sent(loop: Loop, shared: Shared, joint: int, position: float, velocity: float = 0.0) -> bool:
    """The last check before a family makes a frame of what leads its drive, in whatever unit.

    What makes that of a setpoint (errors, ramps, bounds) comes after `check_next_setpoint`, and most frames hold whole
    numbers, among which nothing says "no number". An infinite setpoint that a bound has made finite is refused too. The
    joint is told to stop then, whatever fault is latched already, and the others brake by themselves.
    """
    axis = loop.axes[joint]
    total = setpoint_sum(axis.commanded) + position + velocity
    if math.isfinite(total):
        return True
    latch_fault(loop, shared, Fault.NOT_FINITE, joint, total, 0.0)
    loop.motion.per_joint_stop = 1
    axis.sent.stop_frames_due = STOP_FRAMES
    return False


@jit
def way_to_rest(velocity_rad_s: float, braking_rad_s2: float, period_s: float) -> float:
    """How far the setpoints of a joint still go (rad, signed) when each period takes as much velocity as can be.

    `velocity_rad_s` is that between the last two of them. What such a step leaves of the way is just what this says
    of the velocity that is left: a joint that can stop in time still can in the next cycle.
    """
    step = braking_rad_s2 * period_s
    steps = math.floor(abs(velocity_rad_s) / step)
    return math.copysign(steps * (abs(velocity_rad_s) - 0.5 * step * (steps + 1)) * period_s, velocity_rad_s)


@jit
def check_measured(loop: Loop, shared: Shared) -> None:
    """Following error, the age ladder's upper rung, and what the drives say of themselves.

    A drive that ran on while the loop was away is not to blame for the distance (`slip_rad`): the error share
    in the speed field takes it back at the rate at which that allowance decays.
    """
    params = loop.params
    slow_down(loop, _LATE_DRIVE, False)
    for joint in range(params.joint_count):
        axis = loop.axes[joint]
        drive = axis.drive
        if axis.reference.referenced == 0:
            continue
        age_ns = silent_ns(loop, joint)
        if age_ns > params.stale_brake_ns:
            slow_down(loop, _LATE_DRIVE, True)
            shared.counters.stale_reads += 1
        if age_ns > params.stale_fault_ns:
            lose_reference(loop, shared, joint, Unreferenced.SILENT)
            latch_silence(loop, shared, joint, age_ns)
            continue
        if axis.checks.bad_statuses >= STATUSES_TO_BELIEVE and not let_go_on_purpose(loop, drive.status):
            if drive.status & status_bits.POWER_LOST:
                lose_reference(loop, shared, joint, Unreferenced.POWER_LOST)
                latch_fault(loop, shared, Fault.REFERENCE_LOST, joint, 0.0, 0.0)
                continue
            latch_fault(loop, shared, Fault.DRIVE_FAULT, joint, float(drive.status), 0.0)
        timeout_ns = loop.joints[joint].status_timeout_ns
        if timeout_ns > 0 and loop.timing.now_ns - drive.status_ns > timeout_ns:
            drive.status |= status_bits.COMMUNICATION
            latch_fault(loop, shared, Fault.DRIVE_FAULT, joint, float(drive.status), 0.0)
        if axis.checks.refusals >= REFUSALS_TO_BELIEVE:
            latch_fault(loop, shared, Fault.DRIVE_FAULT, joint, float(drive.status), 0.0)
        error = agreed_error_rad(axis)
        judge_way(loop, joint)
        if (
            loop.motion.started == 1
            and loop.motion.resync_ns == 0
            and (abs(error) > params.following_error_rad + axis.tracking.slip_rad + axis.tracking.lag_rad)
        ):
            latch_fault(loop, shared, Fault.FOLLOWING_ERROR, joint, error, params.following_error_rad)


@jit
def latch_silence(loop: Loop, shared: Shared, joint: int, age_ns: int) -> None:
    """Latch the fault of a drive that is silent, which names no joint where all drives are."""
    silent, all_silent = 0, True
    for other in range(loop.params.joint_count):
        if silent_ns(loop, other) > loop.params.stale_brake_ns:
            silent |= 1 << other
        elif loop.joints[other].family != FAMILY_MOCK:
            all_silent = False
    named = -1 if all_silent else joint
    value, limit = age_ns * 1e-9, loop.params.stale_fault_ns * 1e-9
    latch_fault(loop, shared, Fault.STALE_READING, named, value, limit, silent, silence.evidence(loop, shared))


@jit
def let_go_on_purpose(loop: Loop, status: int) -> bool:
    """Whether all that is wrong with a drive is that it holds nothing, as it was told."""
    return is_limp(loop.mode) and status & (status_bits.PROTECTED | status_bits.POWER_LOST) == 0


@jit
def judge_way(loop: Loop, joint: int) -> None:
    """End a goal whose joint is too far from its setpoint; once the last point is commanded its end is judged."""
    axis, running = loop.axes[joint], loop.paths[loop.goals.active]
    on_its_way = running.phase == Phase.RUNNING or (running.phase == Phase.PAUSED and running.settle_ns == 0)
    if not on_its_way or not in_goal(loop, loop.goals.active, joint):
        return
    allowed = running.tolerances[joint]
    error = agreed_error_rad(axis)
    velocity_error, acceleration_error = agreed_error_rad_s(axis), agreed_error_rad_s2(axis)
    if (
        allowed.position_rad > 0.0
        and abs(error) > allowed.position_rad + axis.tracking.slip_rad + axis.tracking.lag_rad
    ):
        stop_running(loop, Outcome.PATH_TOLERANCE, joint, error, allowed.position_rad)
    elif allowed.velocity_rad_s > 0.0 and abs(velocity_error) > allowed.velocity_rad_s:
        stop_running(loop, Outcome.PATH_VELOCITY, joint, velocity_error, allowed.velocity_rad_s)
    elif allowed.acceleration_rad_s2 > 0.0 and abs(acceleration_error) > allowed.acceleration_rad_s2:
        stop_running(loop, Outcome.PATH_ACCELERATION, joint, acceleration_error, allowed.acceleration_rad_s2)


@jit
def take_status(loop: Loop, joint: int, status: int) -> None:
    """Believe a bad status when it comes twice: the serial line has no checksum, one garbled digit is enough."""
    axis = loop.axes[joint]
    if axis.reference.power_loss_known == 1:
        status &= ~status_bits.POWER_LOST
    axis.drive.status = status | status_bits.ANSWERED
    axis.drive.status_ns = loop.timing.now_ns
    axis.drive.status_readings += 1
    bad = status & (status_bits.PROTECTED | status_bits.POWER_LOST) != 0 or status & status_bits.ENABLED == 0
    axis.checks.bad_statuses = axis.checks.bad_statuses + 1 if bad else 0
    if not bad:
        axis.checks.refusals = 0


@jit
def knows_where_it_stands(loop: Loop, joint: int) -> bool:
    """Whether the last reading tells where the joint is now, so that its drive can be told to stay there.

    A follower of set-points that hears no more of them stands at its last one; an old or garbled reading, or one that
    was counted from another zero, would move it away from there.
    """
    axis = loop.axes[joint]
    if axis.measured.readings == 0 or axis.checks.suspect == 1:
        return False
    return bool(loop.timing.now_ns - axis.measured.time_ns <= FRESH_READINGS * loop.params.reading_ns)


@jit
def lose_reference(loop: Loop, shared: Shared, joint: int, reason: int) -> None:
    """The drive's count means nothing any more: stop command, then no motion frame until it is referenced."""
    axis = loop.axes[joint]
    reference = axis.reference
    if reference.referenced == 1:
        record_event(loop, shared, Event.REFERENCE, joint, reason, 0.0, 0.0)
        reference.lost_at_rad = axis.measured.position_rad
    reference.referenced = reference.power_loss_known = axis.sent.fast_ready = 0
    reference.unreferenced_reason = reason
    axis.sent.stop_frames_due = STOP_FRAMES


@jit
def stop_if_it_was_away(loop: Loop, joint: int, waited_ns: int) -> None:
    """A drive that is heard again after it lost its reference may not have heard its stop command, whatever the mode.

    A bring-up that somebody has asked for meanwhile has forgotten how long the drive was away: then its first reading.
    """
    axis = loop.axes[joint]
    lost = loop.mode == Mode.FAULT or outlives_a_clear(loop, joint)
    away = axis.measured.readings == 0 or waited_ns > loop.params.stale_fault_ns
    if axis.reference.referenced == 0 and lost and away:
        axis.sent.stop_frames_due = STOP_FRAMES


@jit
def outlives_a_clear(loop: Loop, joint: int) -> bool:
    """Whether a joint stays unreferenced although the drive looks sound again: clearing a fault never references."""
    reason = loop.axes[joint].reference.unreferenced_reason
    if reason == Unreferenced.POSITION_JUMP or reason == Unreferenced.NOT_HOMED or reason == Unreferenced.INCREMENTAL:
        return True
    return bool(absolute_makes_good(reason) and loop.joints[joint].knows_its_angle == 0)


@jit
def believable(loop: Loop, shared: Shared, joint: int, position_rad: float, read_ns: int, reference_rad: float) -> bool:
    """Whether a reading, of the instant at which `reference_rad` was commanded, can have come about by motion.

    One that cannot is put aside and answers no question; when the next one agrees with it, the drive's count has
    truly jumped, unless both go on from the reading before the last: then it was the last one that was garbled.
    """
    axis = loop.axes[joint]
    checks = axis.checks
    jump, moved_rad = position_rad - axis.measured.position_rad, reference_rad - axis.tracking.reference_rad
    possible = possible_rad(loop, joint, read_ns - axis.measured.time_ns)
    as_commanded = min(moved_rad, 0.0) - possible <= jump <= max(moved_rad, 0.0) + possible
    if axis.measured.readings == 0 or axis.reference.referenced == 0 or as_commanded:
        checks.suspect = 0
        return True
    if checks.suspect == 1 and abs(position_rad - checks.suspect_rad) <= abs(moved_rad) + possible:
        checks.suspect = 0
        if abs(reference_rad - position_rad - axis.tracking.error_before_rad) <= loop.params.position_jump_rad:
            return True
        lose_reference(loop, shared, joint, Unreferenced.POSITION_JUMP)
        latch_fault(loop, shared, Fault.REFERENCE_LOST, joint, jump, loop.params.position_jump_rad)
        return True
    checks.suspect = 1
    checks.suspect_rad = position_rad
    return False


@jit
def stays_limp(loop: Loop, joint: int) -> bool:
    """Whether a drive was let go before a fault was latched: it holds nothing until it is brought up again."""
    status = loop.axes[joint].drive.status
    answered = status & status_bits.ANSWERED != 0
    return bool(loop.mode == Mode.FAULT and answered and status & status_bits.ENABLED == 0)


@jit
def possible_rad(loop: Loop, joint: int, since_ns: int) -> float:
    """How far a joint may have moved since its last reading beside what was commanded.

    By what the error adds to its speed, by what it ran on while the loop was away, and from where it was if that
    reading was late; a limp one as fast as a hand can lead it.
    """
    axis, row = loop.axes[joint], loop.joints[joint]
    by_hand = is_limp(loop.mode) or stays_limp(loop, joint)
    speed_rad_s = row.max_velocity_rad_s * (HAND_SHARE if by_hand else ERROR_SPEED_SHARE)
    possible = (
        loop.params.position_jump_rad
        + speed_rad_s * max(since_ns, 0) * 1e-9
        + axis.tracking.slip_rad
        + axis.tracking.lag_rad
    )
    return float(possible)


@jit
def may_be_led(loop: Loop, joint: int) -> bool:
    """Whether a drive gets motion frames: not while it is in doubt what it would make of them.

    One that does not answer may have been switched off and on, and then counts from somewhere else; what is sent into
    a blocked wire besides arrives when the arm has long been stopped. Without frames a drive brakes by itself.
    """
    axis = loop.axes[joint]
    if axis.reference.referenced == 0 or axis.checks.bad_statuses > 0 or axis.checks.suspect == 1:
        return False
    if loop.params.fast_targets == 1 and axis.sent.fast_ready == 0:
        return False
    return bool(silent_ns(loop, joint) <= loop.params.stale_brake_ns)


@jit
def silent_ns(loop: Loop, joint: int) -> int:
    """For how long a drive has told nothing that was expected of it, 0 if it owes nothing.

    Reports come whether or not the drives hear anything; that they do only answers tell, of which each cycle expects
    one from some drive. While there is none the drives are as good as silent.
    """
    axis = loop.axes[joint]
    age_ns = loop.timing.now_ns - axis.reply.unanswered_since_ns if axis.reply.unanswered_since_ns != 0 else 0
    if loop.params.reported == 1 and loop.bus.unacknowledged_since_ns != 0:
        age_ns = max(age_ns, loop.timing.now_ns - loop.bus.unacknowledged_since_ns)
    return int(age_ns)


@jit
def report_is_asked_for(loop: Loop, joint: int) -> bool:
    """Whether a drive that should report, and does not, is asked in this cycle.

    One that has lost power reports nothing any more and would wait for the age ladder with a target that means another
    place; its answer tells at once. Every other cycle, so that asking takes less of the bus than the reports it stands
    in for. What it answers does not make it younger: a drive that has ceased to report ends as a silent one.
    """
    axis = loop.axes[joint]
    overdue = (
        axis.reply.unanswered_since_ns != 0
        and loop.timing.now_ns - axis.reply.unanswered_since_ns >= loop.params.report_overdue_ns
    )
    return bool(overdue and (loop.timing.cycle + joint) & 1 == 0)


@jit
def somebody_listens(loop: Loop) -> bool:
    """Whether this cycle's frames may leave, because a drive was just heard or because there is room for them.

    While no drive acknowledges, an adapter or the system keeps what it is given, and says it to the drives when their
    power returns: they boot enabled, count from zero, and would go to targets that mean something else. So what is
    kept is bounded by what leaves room for each drive's stop command: the last word is a stop.
    """
    joints = loop.params.joint_count
    cycle_frames = 3 * joints + 1
    return loop.bus.unheard_frames == 0 or loop.bus.unheard_frames + cycle_frames + PROBES + joints <= ADAPTER_FRAMES


@jit
def may_probe(loop: Loop) -> bool:
    """Whether it is time to ask a silent bus again, and no stop command could lose its room by that."""
    params = loop.params
    if loop.timing.now_ns - loop.bus.probed_ns < params.stale_fault_ns // PROBES:
        return False
    stops_to_come = 0
    for joint in range(params.joint_count):
        stops_to_come += loop.axes[joint].reference.referenced
    return bool(stops_to_come == 0 or loop.bus.unheard_frames + stops_to_come < ADAPTER_FRAMES)


@jit
def drives_are_led(loop: Loop) -> bool:
    """Whether motion frames leave in this cycle.

    In a latched fault only until the arm stands: what moved it away afterwards must not be followed up, and the
    drives hold their last target by themselves. Drives that were out of reach have come to rest elsewhere.
    """
    if loop.motion.started == 0 or loop.motion.resync_ns != 0 or loop.bus.transmit_inhibited == 1:
        return False
    if loop.mode == Mode.FAULT:
        return not at_rest(loop)
    standing = loop.mode == Mode.HOLDING or loop.mode == Mode.REFERENCING
    return standing or loop.mode == Mode.EXECUTING or loop.mode == Mode.STOPPING


@jit
def stop_who_is_elsewhere(loop: Loop) -> None:
    """Once the arm stands in a latched fault nothing is made up for: a drive that is not where it was led stops there.

    It would go on towards its last target, or push against what holds it.
    """
    motion = loop.motion
    if loop.mode != Mode.FAULT or motion.rested == 1 or loop.bus.transmit_inhibited == 1 or not at_rest(loop):
        return
    motion.rested = 1
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        if (
            motion.started == 1
            and abs(axis.commanded.position_rad - axis.measured.position_rad) > 2.0 * loop.joints[joint].slack_rad
        ):
            axis.sent.stop_frames_due = STOP_FRAMES
