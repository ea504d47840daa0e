"""Watching the drives: following error, silence, the status they report, and whether a reading is plausible."""

from compilation.jit import jit
from rtloop.memory import status as status_bits
from rtloop.memory.axis import FAMILY_MOCK, FRESH_READINGS
from rtloop.memory.buses import bus_of
from rtloop.memory.modes import is_disabled
from rtloop.memory.state import Loop
from rtloop.memory.updates import owe_stop
from rtloop.safety import silence
from rtloop.safety.faults import latch_fault
from rtloop.safety.outlier_filter import filtered_error_rad, filtered_error_rad_s, filtered_error_rad_s2
from rtloop.safety.references import lose_reference, outlives_a_clear
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from rtloop.trajectory.path import in_goal
from rtloop.trajectory.phases import slow_down, stop_running
from shm.layout import StateFile
from shm.words import Fault, Mode, Outcome, Phase, Slowed, Unreferenced

_LATE_DRIVE = int(Slowed.LATE_DRIVE)

STATUSES_TO_BELIEVE = 2
REFUSALS_TO_BELIEVE = 2
HAND_SHARE = 2.0
"""A disabled joint that is led by hand may move at this many times its highest velocity."""


@jit
def check_measured(loop: Loop, shared: StateFile) -> None:
    """Check following error, the age of the readings, and the status that the drives report.

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
        if axis.checks.bad_statuses >= STATUSES_TO_BELIEVE and not disabled_on_purpose(loop, drive.status):
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
        error = filtered_error_rad(axis)
        judge_way(loop, joint)
        if (
            loop.motion.started == 1
            and loop.motion.resync_ns == 0
            and (abs(error) > params.following_error_rad + axis.tracking.slip_rad + axis.tracking.lag_rad)
        ):
            latch_fault(loop, shared, Fault.FOLLOWING_ERROR, joint, error, params.following_error_rad)


@jit
def latch_silence(loop: Loop, shared: StateFile, joint: int, age_ns: int) -> None:
    """Latch the fault of a drive that is silent, which names no joint where all drives are."""
    silent, all_silent = 0, True
    for other in range(loop.params.joint_count):
        if silent_ns(loop, other) > loop.params.stale_brake_ns:
            silent |= 1 << other
        elif loop.joints[other].family != FAMILY_MOCK:
            all_silent = False
    named = -1 if all_silent else joint
    value, limit = age_ns * 1e-9, loop.params.stale_fault_ns * 1e-9
    evidence = silence.evidence(loop, shared, bus_of(loop, joint))
    if all_silent:
        for number in range(loop.params.bus_count):
            evidence |= silence.evidence(loop, shared, loop.buses[number])
    latch_fault(loop, shared, Fault.STALE_READING, named, value, limit, silent, evidence)


@jit
def disabled_on_purpose(loop: Loop, status: int) -> bool:
    """Whether all that is wrong with a drive is that it holds nothing, as it was commanded."""
    return is_disabled(loop.mode) and status & (status_bits.PROTECTED | status_bits.POWER_LOST) == 0


@jit
def judge_way(loop: Loop, joint: int) -> None:
    """End a goal whose joint is too far from its setpoint; once the last point is commanded its end is judged."""
    axis, running = loop.axes[joint], loop.paths[loop.goals.active]
    on_its_way = running.phase == Phase.RUNNING or (running.phase == Phase.PAUSED and running.settle_start_ns == 0)
    if not on_its_way or not in_goal(loop, loop.goals.active, joint):
        return
    allowed = running.tolerances[joint]
    error = filtered_error_rad(axis)
    velocity_error, acceleration_error = filtered_error_rad_s(axis), filtered_error_rad_s2(axis)
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
def take_refusal(loop: Loop, joint: int) -> None:
    """Its drive has refused to move."""
    loop.axes[joint].checks.refusals += 1


@jit
def knows_where_it_stands(loop: Loop, joint: int) -> bool:
    """Whether the last reading is the present position, so that the drive can be commanded to stay there.

    A follower of set-points that receives no more of them stands at its last one. A reading that is old, garbled or
    counted from another zero would move it away from there.
    """
    axis = loop.axes[joint]
    if axis.measured.readings == 0 or axis.checks.suspect == 1:
        return False
    return bool(loop.timing.now_ns - axis.measured.time_ns <= FRESH_READINGS * loop.params.reading_ns)


@jit
def stop_if_it_was_away(loop: Loop, joint: int, waited_ns: int) -> None:
    """A drive that answers again after it lost its reference may have missed its stop command, whatever the mode.

    A bring-up that was requested meanwhile has forgotten how long that was: then its first reading counts.
    """
    axis = loop.axes[joint]
    lost = loop.mode == Mode.FAULT or outlives_a_clear(loop, joint)
    away = axis.measured.readings == 0 or waited_ns > loop.params.stale_fault_ns
    if axis.reference.referenced == 0 and lost and away:
        owe_stop(axis)


@jit
def plausible(
    loop: Loop, shared: StateFile, joint: int, position_rad: float, read_ns: int, reference_rad: float
) -> bool:
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
def stays_disabled(loop: Loop, joint: int) -> bool:
    """Whether a drive was let go before a fault was latched: it holds nothing until it is brought up again."""
    status = loop.axes[joint].drive.status
    answered = status & status_bits.ANSWERED != 0
    return bool(loop.mode == Mode.FAULT and answered and status & status_bits.ENABLED == 0)


@jit
def possible_rad(loop: Loop, joint: int, since_ns: int) -> float:
    """How far a joint may have moved since its last reading beside what was commanded.

    By what the error adds to its speed, by what it ran on while the loop was away, and from where it was if that
    reading was late; a disabled one as fast as a hand can lead it.
    """
    axis, row = loop.axes[joint], loop.joints[joint]
    by_hand = is_disabled(loop.mode) or stays_disabled(loop, joint)
    speed_rad_s = row.max_velocity_rad_s * (HAND_SHARE if by_hand else ERROR_SPEED_SHARE)
    possible = (
        loop.params.position_jump_rad
        + speed_rad_s * max(since_ns, 0) * 1e-9
        + axis.tracking.slip_rad
        + axis.tracking.lag_rad
    )
    return float(possible)


@jit
def silent_ns(loop: Loop, joint: int) -> int:
    """For how long an expected frame of a drive is missing (ns), 0 if none is expected.

    Reports come whether or not the drives receive anything; only answers prove that they do, and each cycle expects
    one from some drive. While there is none the drives are as good as silent.
    """
    axis = loop.axes[joint]
    age_ns = loop.timing.now_ns - axis.reply.unanswered_since_ns if axis.reply.unanswered_since_ns != 0 else 0
    unacknowledged_since_ns = bus_of(loop, joint).unacknowledged_since_ns
    if loop.params.reported == 1 and unacknowledged_since_ns != 0:
        age_ns = max(age_ns, loop.timing.now_ns - unacknowledged_since_ns)
    return int(age_ns)
