"""The life of a goal in the loop: how it enters, how fast its clock runs, how it ends."""

from compilation.jit import jit
from motion.stopping import ORDERLY
from rtloop.memory.modes import change_mode
from rtloop.memory.motion import WINDOW_WAYPOINTS
from rtloop.memory.state import Loop
from rtloop.trajectory.ahead import LOOKS_A_CYCLE
from rtloop.trajectory.arrival import has_arrived, rate_that_settles, rate_with_room_to_arrive, slow_down_to_arrive
from rtloop.trajectory.clock import must_brake_for_lack_of_path, set_rate, steer_rate, way_s
from rtloop.trajectory.entry import (
    NO_WAY,
    ON_ITS_WAY,
    asked_rate,
    due_s,
    enter,
    entry_distance,
    has_approach,
    rate_while_blending,
)
from rtloop.trajectory.limits import at_rest
from rtloop.trajectory.path import end_s, goes_on_past_end, in_goal
from rtloop.trajectory.phases import (
    change_phase,
    end_goal,
    end_waiting,
    incoming,
    runs,
    slow_down,
    stop_running,
    stops_for_good,
    tell_why_it_stops,
    waits,
)
from shm.layout import StateFile
from shm.words import Mode, Outcome, Phase, Slowed

_LATE_DRIVE, _STARVING, _MAKING_WAY = int(Slowed.LATE_DRIVE), int(Slowed.STARVING), int(Slowed.MAKING_WAY)

STARVED_FOR_NS = 500_000_000
COVER_S = 1.0
"""A new path may be entered when this much of it is known, and the way of the longest stop, or all of it."""


@jit
def enter_newer_goal(loop: Loop, shared: StateFile) -> None:
    """Let a newer goal take over once enough of it is here, it is due, and a bounded way onto it exists."""
    goals, newer = loop.goals, incoming(loop)
    if not waits(loop) or loop.motion.resync_ns != 0:
        return
    outcome, value, limit = why_not_to_wait(loop)
    if outcome != Outcome.NONE:
        end_waiting(loop, shared, outcome, -1, value, limit)
        return
    if not incoming_is_ready(loop) or loop.paths[newer].start_ns > loop.timing.now_ns:
        return  # what runs may run until then
    entry_s = due_s(loop, newer)
    path = loop.paths[newer]
    if (path.met == 0 or loop.operator.speed_scale <= 0.0) and not has_approach(loop, newer, entry_s):
        if refused_as_too_far(loop, shared, entry_s):
            return
        # To find a way, or to stop first, takes the arm along its old path away from there, for no longer than a stop:
        # that is the way back. A clock that people have stopped is another matter.
        path.met = 1 if path.start_ns == 0 else 0
    if stops_for_good(loop, goals.active) and not at_rest(loop):
        return  # a stop that was asked for is finished first
    if loop.mode != Mode.HOLDING and loop.mode != Mode.EXECUTING and loop.mode != Mode.STOPPING:
        return
    if loop.operator.speed_scale <= 0.0:
        slow_down(loop, _MAKING_WAY, True)  # time stands still: nothing starts
        return
    found = enter(loop, newer, entry_s)
    if found == ON_ITS_WAY:
        start_incoming(loop, shared)
    if found != NO_WAY:
        return
    # the run-up of a stream lies where the arm should be
    if loop.paths[newer].stream == 1 and refused_as_too_far(loop, shared, entry_s):
        return
    if at_rest(loop):
        end_waiting(loop, shared, Outcome.REFUSED_LIMITS, -1, 0.0, 0.0)
    else:
        slow_down(loop, _MAKING_WAY, True)


@jit
def incoming_is_ready(loop: Loop) -> bool:
    """Whether enough of the newer goal is here to enter it where it is due."""
    path = loop.paths[incoming(loop)]
    if path.taken <= path.approach:
        return False  # not one waypoint of its own
    cover_s = max(COVER_S, way_s(loop.params.longest_stop_s))
    return path.ended == 1 or path.taken >= WINDOW_WAYPOINTS - 1 or known_s(loop) >= cover_s


@jit
def known_s(loop: Loop) -> float:
    """Path time of the newer goal that is known beyond the place at which it would be entered now."""
    path_index = incoming(loop)
    return end_s(loop, path_index) - due_s(loop, path_index)


@jit
def why_not_to_wait(loop: Loop) -> tuple[int, float, float]:
    """Outcome, value and limit of a newer goal for which there is no point in waiting any more; NONE otherwise."""
    if loop.motion.closing == 1:
        return Outcome.SHUTDOWN, 0.0, 0.0
    if front_is_lost(loop):  # a goal that waits for its start must not outlive who sent it
        return Outcome.FRONT_LOST, loop.front.age_ns * 1e-9, loop.params.front_timeout_ns * 1e-9
    if not incoming_is_ready(loop) and loop.timing.now_ns - loop.front.incoming_record_ns > STARVED_FOR_NS:
        return Outcome.STARVED, 0.0, 0.0
    return Outcome.NONE, 0.0, 0.0


@jit
def refused_as_too_far(loop: Loop, shared: StateFile, entry_s: float) -> bool:
    """Refuse the newer goal if the place where it would be entered is not where the arm is."""
    joint, distance = entry_distance(loop, incoming(loop), entry_s)
    tolerance = loop.params.start_tolerance_rad
    if distance <= tolerance:
        return False
    end_waiting(loop, shared, Outcome.REFUSED_START, joint, distance, tolerance)
    return True


@jit
def start_incoming(loop: Loop, shared: StateFile) -> None:
    """Let the path that has just become the active one run; the goal of the other is over."""
    goals = loop.goals
    older = loop.paths[incoming(loop)]
    outcome = older.reason if stops_for_good(loop, incoming(loop)) else Outcome.REPLACED
    end_waiting(loop, shared, outcome, older.reason_joint, older.reason_value, older.reason_limit)
    change_phase(loop, goals.active, Phase.RUNNING)
    slow_down(loop, _STARVING, False)
    goals.arriving = 0
    loop.motion.started = 1
    change_mode(loop, shared, Mode.EXECUTING)


@jit
def finish_running(loop: Loop, shared: StateFile, outcome: int, joint: int, value: float, limit: float) -> None:
    """No goal runs any more; the one that did has this outcome, if it was not told another before."""
    goals = loop.goals
    end_goal(loop, shared, goals.active, outcome, joint, value, limit)
    slow_down(loop, _STARVING, False)
    goals.arriving = 0
    set_rate(loop, 1.0)
    if loop.mode == Mode.EXECUTING or loop.mode == Mode.STOPPING:
        change_mode(loop, shared, Mode.HOLDING)


@jit
def finish_stopped(loop: Loop, shared: StateFile) -> None:
    """The arm stands; the goal has the outcome for which it was stopped."""
    running = loop.paths[loop.goals.active]
    joint, value, limit = running.reason_joint, running.reason_value, running.reason_limit
    finish_running(loop, shared, running.reason, joint, value, limit)


@jit
def front_is_lost(loop: Loop) -> bool:
    return loop.params.command_address != 0 and loop.front.age_ns > loop.params.front_timeout_ns


@jit
def steer(loop: Loop, shared: StateFile) -> None:
    """Decide how fast the trajectory clock should run, and begin the stops that are not commanded."""
    goals = loop.goals
    loop.search.checks_left = LOOKS_A_CYCLE
    if not runs(loop):
        return
    stop_what_cannot_go_on(loop)
    running = loop.paths[goals.active]
    if running.phase == Phase.STOPPING and is_told_at_once(running.reason):
        tell_why_it_stops(loop, shared)
    if loop.motion.per_joint_stop == 1:
        return
    if stops_for_good(loop, goals.active) and loop.mode == Mode.EXECUTING:
        change_mode(loop, shared, Mode.STOPPING)
    must_arrive = running.ended == 1 and not goes_on_past_end(loop, goals.active)
    runs_on = running.stream == 1 and (running.ended == 0 or running.ends_moving == 1)
    if running.phase == Phase.STOPPING or running.phase == Phase.PAUSED or goals.slowed != 0:
        steer_rate(loop, 0.0, loop.params.braking_factor if is_urgent(loop) else ORDERLY)
    elif goals.arriving == 0:
        wanted = rate_while_blending(loop, asked_rate(loop, goals.active))
        if must_arrive:
            wanted = rate_with_room_to_arrive(loop, wanted)
        elif runs_on:
            wanted = rate_that_settles(loop, wanted)
        steer_rate(loop, wanted, ORDERLY)
    if must_arrive:
        slow_down_to_arrive(loop)


@jit
def is_urgent(loop: Loop) -> bool:
    """Whether a stop may use the braking factor: a person's, that of a fault, and whatever else ends a goal.

    What belongs to ordinary operation (cancel, hold, a newer goal, the end of a stream) keeps the limits.
    """
    operator = loop.operator
    # also a goal that its client has canceled before
    stopped = operator.held == 1 and operator.stop_ns > operator.resume_ns
    if stopped or loop.goals.slowed & (_LATE_DRIVE | _STARVING) != 0:
        return True
    running = loop.paths[loop.goals.active]
    orderly = running.reason == Outcome.CANCELED or running.reason == Outcome.RAN_DRY
    return bool(running.phase == Phase.STOPPING and not orderly)


@jit
def stop_what_cannot_go_on(loop: Loop) -> None:
    """Stop a goal whose front is gone, whose points do not come, or that the program does not outlive."""
    if loop.paths[loop.goals.active].phase != Phase.STOPPING:
        if front_is_lost(loop):
            stop_running(loop, Outcome.FRONT_LOST, -1, loop.front.age_ns * 1e-9, loop.params.front_timeout_ns * 1e-9)
        elif loop.motion.closing == 1:
            stop_running(loop, Outcome.SHUTDOWN, -1, 0.0, 0.0)
    judge_supply(loop)
    if loop.paths[loop.goals.active].phase != Phase.STOPPING and has_run_dry(loop):
        stop_running(loop, Outcome.RAN_DRY, -1, 0.0, 0.0)


@jit
def has_run_dry(loop: Loop) -> bool:
    """Whether a stream's last point is passed in motion and nothing newer has taken over."""
    running = loop.paths[loop.goals.active]
    passed = running.ends_moving == 1 and loop.clock.time_s >= end_s(loop, loop.goals.active)
    return bool(running.stream == 1 and running.phase != Phase.PAUSED and passed)


@jit
def is_told_at_once(outcome: int) -> bool:
    """Whether the goal's client hears of its end while the arm still stops; a cancel ends when the arm stands."""
    return not (outcome == Outcome.CANCELED or outcome == Outcome.STOPPED or outcome == Outcome.RAN_DRY)


@jit
def judge_supply(loop: Loop) -> None:
    """Whether the front keeps up: brake while there is path to brake on, end the goal if nothing comes."""
    goals = loop.goals
    starved_before = goals.slowed & _STARVING != 0
    if loop.motion.per_joint_stop == 1 or not must_brake_for_lack_of_path(loop, starved_before):
        slow_down(loop, _STARVING, False)
    elif not starved_before:
        slow_down(loop, _STARVING, True)
        goals.underrun_ns = loop.timing.now_ns
    elif loop.timing.now_ns - goals.underrun_ns > STARVED_FOR_NS and loop.paths[goals.active].phase != Phase.STOPPING:
        stop_running(loop, Outcome.STARVED, -1, 0.0, 0.0)


@jit
def judge_goal(loop: Loop, shared: StateFile) -> None:
    """Decide a goal whose motion is over: arrived and inside its tolerances, or stopped as asked."""
    goals, clock = loop.goals, loop.clock
    if not runs(loop):
        return
    running = loop.paths[goals.active]
    if loop.motion.per_joint_stop == 1 or running.phase == Phase.STOPPING:
        along_path = clock.rate == 0.0 and clock.ramp_s == 0.0
        if (loop.motion.per_joint_stop == 1 or along_path) and at_rest(loop):
            finish_stopped(loop, shared)
        return
    if goes_on_past_end(loop, goals.active):
        if clock.time_s < max(end_s(loop, goals.active), running.entry_s + running.blend_s):
            return
    elif not has_arrived(loop):
        return
    if running.settle_start_ns == 0:
        running.settle_start_ns = loop.timing.now_ns + loop.params.period_ns  # when the last point is the commanded one
        if running.phase != Phase.PAUSED:
            change_phase(loop, goals.active, Phase.SETTLING)
        return
    judge_arrival(loop, shared)


@jit
def judge_arrival(loop: Loop, shared: StateFile) -> None:
    """Success once every joint was measured, at rest on the last point, inside its tolerances; patience ends."""
    running = loop.paths[loop.goals.active]
    if running.phase == Phase.PAUSED:
        running.settle_start_ns += loop.params.period_ns  # the time to arrive does not run
        return
    joint, ratio = worst_of_goal(loop, POSITION)
    fast_joint, fast_ratio = worst_of_goal(loop, VELOCITY)
    rough_joint, rough_ratio = worst_of_goal(loop, ACCELERATION)
    within = max(ratio, fast_ratio, rough_ratio) <= 1.0
    value, limit = goal_error(loop, joint, POSITION)
    if within and everything_is_measured(loop):
        finish_running(loop, shared, Outcome.SUCCEEDED, joint, value, limit)
    elif running.goal_time_s > 0.0 and (loop.timing.now_ns - running.settle_start_ns) * 1e-9 > running.goal_time_s:
        outcome = Outcome.GOAL_TOLERANCE
        if ratio <= 1.0 and fast_ratio > 1.0:
            outcome, joint = Outcome.GOAL_VELOCITY, fast_joint
            value, limit = goal_error(loop, joint, VELOCITY)
        elif ratio <= 1.0 and rough_ratio > 1.0:
            outcome, joint = Outcome.GOAL_ACCELERATION, rough_joint
            value, limit = goal_error(loop, joint, ACCELERATION)
        finish_running(loop, shared, outcome, joint, value, limit)


POSITION = 0
VELOCITY = 1
ACCELERATION = 2


@jit
def goal_error(loop: Loop, joint: int, quantity: int) -> tuple[float, float]:
    """A joint's error at the end of its goal and what is allowed, 0 = anything."""
    axis, allowed = loop.axes[joint], loop.paths[loop.goals.active].goal_tolerances[joint]
    if quantity == POSITION:
        return axis.commanded.position_rad - axis.measured.position_rad, allowed.position_rad
    if quantity == VELOCITY:
        return axis.measured.velocity_rad_s, allowed.velocity_rad_s
    return axis.tracking.error_acceleration_rad_s2, allowed.acceleration_rad_s2


@jit
def worst_of_goal(loop: Loop, quantity: int) -> tuple[int, float]:
    """The joint of the goal whose error is the largest share of what is allowed, and that share."""
    worst_joint, worst = -1, -1.0
    for joint in range(loop.params.joint_count):
        if in_goal(loop, loop.goals.active, joint):
            error, allowed = goal_error(loop, joint, quantity)
            ratio = abs(error) / allowed if allowed > 0.0 else 0.0
            if ratio > worst:
                worst_joint, worst = joint, ratio
    return worst_joint, worst


@jit
def everything_is_measured(loop: Loop) -> bool:
    """Whether every joint of the goal was measured since its last point is the commanded one."""
    active = loop.goals.active
    for joint in range(loop.params.joint_count):
        if in_goal(loop, active, joint) and loop.axes[joint].measured.time_ns < loop.paths[active].settle_start_ns:
            return False
    return True
