"""The life of a goal in the loop: how it enters, how fast its clock runs, how it ends."""

from typing import Any

from motion.stopping import ORDERLY
from rtloop import guard, intake
from rtloop.ahead import LOOKS_A_CYCLE
from rtloop.arrival import has_arrived, rate_that_settles, rate_with_room_to_arrive, slow_down_to_arrive
from rtloop.clock import must_brake_for_lack_of_path, set_rate, steer_rate
from rtloop.entry import (
    NO_WAY,
    ON_ITS_WAY,
    asked_rate,
    due_s,
    enter,
    entry_distance,
    has_bridge,
    rate_while_blending,
)
from rtloop.events import set_result
from rtloop.modes import change_mode
from rtloop.path import end_s, goes_on_past_end, in_goal
from shm.jit import jit
from shm.words import Fault, Mode, Outcome

Loop = Any  # record of dtype rtloop.state.LOOP
Shared = Any  # record of dtype shm.layout.STATE

STARVED_FOR_NS = 500_000_000


@jit
def enter_newer_goal(loop: Loop, shared: Shared) -> None:
    """Let a newer goal take over once enough of it is here, it is due, and a bounded way onto it exists."""
    core = loop.core
    if core.incoming_goal == 0 or core.rebase_ns != 0:
        return
    outcome, value, limit = why_not_to_wait(loop)
    if outcome != Outcome.NONE:
        refuse_incoming(loop, shared, outcome, -1, value, limit)
        return
    if not intake.incoming_is_ready(loop) or loop.paths[core.incoming_path].start_ns > core.now_ns:
        return  # what runs may run until then
    entry_s = due_s(loop, core.incoming_path)
    if not has_bridge(loop, core.incoming_path, entry_s) and refused_as_too_far(loop, shared, entry_s):
        return
    if has_been_ended(core.ending) and not guard.at_rest(loop):
        return  # a stop that was asked for is finished first
    if core.mode != Mode.HOLDING and core.mode != Mode.EXECUTING and core.mode != Mode.STOPPING:
        return
    if core.speed_scale <= 0.0:
        core.incoming_waits = 1  # time stands still: nothing starts
        return
    found = enter(loop, core.incoming_path, entry_s)
    if found == ON_ITS_WAY:
        start_incoming(loop, shared)
    if found != NO_WAY:
        return
    # the run-up of a stream lies where the arm should be
    if loop.paths[core.incoming_path].stream == 1 and refused_as_too_far(loop, shared, entry_s):
        return
    if guard.at_rest(loop):
        refuse_incoming(loop, shared, Outcome.REFUSED_LIMITS, -1, 0.0, 0.0)
    else:
        core.incoming_waits = 1


@jit
def why_not_to_wait(loop: Loop) -> tuple[int, float, float]:
    """Outcome, value and limit of a newer goal for which there is no point in waiting any more; NONE otherwise."""
    core = loop.core
    if core.closing == 1:
        return Outcome.SHUTDOWN, 0.0, 0.0
    if front_is_lost(loop):  # a goal that waits for its start must not outlive who sent it
        return Outcome.FRONT_LOST, loop.core.front_age_ns * 1e-9, loop.params.front_timeout_ns * 1e-9
    if not intake.incoming_is_ready(loop) and core.now_ns - core.incoming_ns > STARVED_FOR_NS:
        return Outcome.STARVED, 0.0, 0.0
    return Outcome.NONE, 0.0, 0.0


@jit
def refused_as_too_far(loop: Loop, shared: Shared, entry_s: float) -> bool:
    """Refuse the newer goal if the place where it would be entered is not where the arm is."""
    joint, distance = entry_distance(loop, loop.core.incoming_path, entry_s)
    tolerance = loop.params.start_tolerance_rad
    if distance <= tolerance:
        return False
    refuse_incoming(loop, shared, Outcome.REFUSED_START, joint, distance, tolerance)
    return True


@jit
def refuse_incoming(loop: Loop, shared: Shared, outcome: int, joint: int, value: float, limit: float) -> None:
    core = loop.core
    set_result(loop, shared, core.incoming_goal, outcome, joint, value, limit)
    core.incoming_goal = 0
    core.incoming_waits = 0


@jit
def start_incoming(loop: Loop, shared: Shared) -> None:
    core = loop.core
    if core.goal_id != 0:
        outcome = core.ending if has_been_ended(core.ending) else Outcome.REPLACED
        set_result(loop, shared, core.goal_id, outcome, core.ending_joint, core.ending_value, core.ending_limit)
    core.goal_id = core.incoming_goal
    core.incoming_goal = 0
    core.incoming_waits = 0
    core.ending = Outcome.NONE
    core.ending_joint = -1
    core.starving = core.arriving = 0
    core.settle_ns = 0
    core.motion_started = 1
    change_mode(loop, shared, Mode.EXECUTING)


@jit
def finish_goal(loop: Loop, shared: Shared) -> None:
    """No goal runs any more."""
    core = loop.core
    core.goal_id = 0
    core.ending = Outcome.NONE
    core.ending_joint = -1
    core.ending_value = core.ending_limit = 0.0
    core.starving = core.arriving = 0
    core.settle_ns = 0
    set_rate(loop, 1.0)
    if core.mode == Mode.EXECUTING or core.mode == Mode.STOPPING:
        change_mode(loop, shared, Mode.HOLDING)


@jit
def front_is_lost(loop: Loop) -> bool:
    return loop.params.command_address != 0 and loop.core.front_age_ns > loop.params.front_timeout_ns


@jit
def steer(loop: Loop, shared: Shared) -> None:
    """Decide how fast the trajectory clock should run, and begin stops that nobody asked for."""
    core = loop.core
    core.looks_left = LOOKS_A_CYCLE
    if core.goal_id == 0:
        return
    if core.ending == Outcome.NONE:
        if front_is_lost(loop):
            core.ending = Outcome.FRONT_LOST
            core.ending_value = loop.core.front_age_ns * 1e-9
            core.ending_limit = loop.params.front_timeout_ns * 1e-9
        elif core.closing == 1:
            core.ending = Outcome.SHUTDOWN
    judge_supply(loop)
    if core.ending == Outcome.NONE and has_run_dry(loop):
        core.ending = Outcome.RAN_DRY
    if is_told_at_once(core.ending):
        set_result(loop, shared, core.goal_id, core.ending, core.ending_joint, core.ending_value, core.ending_limit)
    if core.own_brake == 1:
        return
    stop = (
        core.ending != Outcome.NONE
        or core.held == 1
        or core.stale == 1
        or core.starving == 1
        or core.incoming_waits == 1
        or core.fault != Fault.NONE
    )
    if has_been_ended(core.ending) and core.mode == Mode.EXECUTING:
        change_mode(loop, shared, Mode.STOPPING)
    running = loop.paths[core.active]
    must_arrive = running.ended == 1 and not goes_on_past_end(loop, core.active)
    runs_on = running.stream == 1 and (running.ended == 0 or running.ends_moving == 1)
    if stop:
        steer_rate(loop, 0.0, loop.params.braking_factor if is_urgent(loop) else ORDERLY)
    elif core.arriving == 0:
        wanted = rate_while_blending(loop, asked_rate(loop, core.active))
        if must_arrive:
            wanted = rate_with_room_to_arrive(loop, wanted)
        elif runs_on:
            wanted = rate_that_settles(loop, wanted)
        steer_rate(loop, wanted, ORDERLY)
    if must_arrive:
        slow_down_to_arrive(loop)


@jit
def is_urgent(loop: Loop) -> bool:
    """Whether a stop may use the braking factor: a person's, that of a fault, and when a process or a drive fails.

    What belongs to ordinary operation (cancel, hold, a newer goal, the end of a stream) keeps the limits.
    """
    core = loop.core
    stopped = core.held == 1 and core.stop_ns > core.resume_ns  # also a goal that its client has canceled before
    if stopped or core.fault != Fault.NONE or core.stale == 1 or core.starving == 1:
        return True
    return not (core.ending == Outcome.NONE or core.ending == Outcome.CANCELED or core.ending == Outcome.RAN_DRY)


@jit
def has_run_dry(loop: Loop) -> bool:
    """Whether a stream's last point is passed in motion and nothing newer has taken over."""
    core = loop.core
    return (
        loop.paths[core.active].stream == 1
        and core.held == 0
        and loop.paths[core.active].ends_moving == 1
        and core.clock_s >= end_s(loop, core.active)
    )


@jit
def has_been_ended(ending: int) -> bool:
    """Whether a goal stops for good; one that ran dry goes on with the next message of its stream."""
    return ending != Outcome.NONE and ending != Outcome.RAN_DRY


@jit
def is_told_at_once(outcome: int) -> bool:
    """Whether the goal's client hears of its end while the arm still stops; a cancel ends when the arm stands."""
    return not (
        outcome == Outcome.NONE
        or outcome == Outcome.CANCELED
        or outcome == Outcome.STOPPED
        or outcome == Outcome.RAN_DRY
    )


@jit
def judge_supply(loop: Loop) -> None:
    """Whether the front keeps up: brake while there is path to brake on, end the goal if nothing comes."""
    core = loop.core
    starves = core.own_brake == 0 and must_brake_for_lack_of_path(loop, core.starving == 1)
    if not starves:
        core.starving = 0
    elif core.starving == 0:
        core.starving = 1
        core.starving_ns = core.now_ns
    elif core.now_ns - core.starving_ns > STARVED_FOR_NS and core.ending == Outcome.NONE:
        core.ending = Outcome.STARVED


@jit
def judge_goal(loop: Loop, shared: Shared) -> None:
    """Decide a goal whose motion is over: arrived and inside its tolerances, or stopped as asked."""
    core = loop.core
    if core.goal_id == 0:
        return
    if core.own_brake == 1:
        if guard.at_rest(loop):
            finish_goal(loop, shared)
        return
    if core.ending != Outcome.NONE or core.fault != Fault.NONE:
        if core.rate == 0.0 and core.ramp_s == 0.0 and guard.at_rest(loop):
            set_result(
                loop,
                shared,
                core.goal_id,
                core.ending,
                core.ending_joint,
                core.ending_value,
                core.ending_limit,
            )
            finish_goal(loop, shared)
        return
    running = loop.paths[core.active]
    if goes_on_past_end(loop, core.active):
        if core.clock_s < max(end_s(loop, core.active), running.entry_s + running.blend_s):
            return
    elif not has_arrived(loop):
        return
    if core.settle_ns == 0:
        core.settle_ns = core.now_ns + loop.params.period_ns  # when the last point is the commanded one
        return
    judge_arrival(loop, shared)


@jit
def judge_arrival(loop: Loop, shared: Shared) -> None:
    """Success once every joint was measured, at rest on the last point, inside its tolerances; patience ends."""
    core = loop.core
    if core.held == 1:
        core.settle_ns += loop.params.period_ns  # the time to arrive does not run
        return
    running = loop.paths[core.active]
    joint, ratio = worst_of_goal(loop, POSITION)
    fast_joint, fast_ratio = worst_of_goal(loop, VELOCITY)
    rough_joint, rough_ratio = worst_of_goal(loop, ACCELERATION)
    within = max(ratio, fast_ratio, rough_ratio) <= 1.0
    value, limit = goal_error(loop, joint, POSITION)
    if within and everything_is_measured(loop):
        set_result(loop, shared, core.goal_id, Outcome.SUCCEEDED, joint, value, limit)
        finish_goal(loop, shared)
    elif running.goal_time_s > 0.0 and (core.now_ns - core.settle_ns) * 1e-9 > running.goal_time_s:
        outcome = Outcome.GOAL_TOLERANCE
        if ratio <= 1.0 and fast_ratio > 1.0:
            outcome, joint = Outcome.GOAL_VELOCITY, fast_joint
            value, limit = goal_error(loop, joint, VELOCITY)
        elif ratio <= 1.0 and rough_ratio > 1.0:
            outcome, joint = Outcome.GOAL_ACCELERATION, rough_joint
            value, limit = goal_error(loop, joint, ACCELERATION)
        set_result(loop, shared, core.goal_id, outcome, joint, value, limit)
        finish_goal(loop, shared)


POSITION = 0
VELOCITY = 1
ACCELERATION = 2


@jit
def goal_error(loop: Loop, joint: int, quantity: int) -> tuple[float, float]:
    """A joint's error at the end of its goal and what is allowed, 0 = anything."""
    axis, allowed = loop.axes[joint], loop.paths[loop.core.active].goal_tolerances[joint]
    if quantity == POSITION:
        return axis.position_rad - axis.measured_rad, allowed.position_rad
    if quantity == VELOCITY:
        return axis.measured_velocity_rad_s, allowed.velocity_rad_s
    return axis.error_acceleration_rad_s2, allowed.acceleration_rad_s2


@jit
def worst_of_goal(loop: Loop, quantity: int) -> tuple[int, float]:
    """The joint of the goal whose error is the largest share of what is allowed, and that share."""
    worst_joint, worst = -1, -1.0
    for joint in range(loop.params.joint_count):
        if in_goal(loop, loop.core.active, joint):
            error, allowed = goal_error(loop, joint, quantity)
            ratio = abs(error) / allowed if allowed > 0.0 else 0.0
            if ratio > worst:
                worst_joint, worst = joint, ratio
    return worst_joint, worst


@jit
def everything_is_measured(loop: Loop) -> bool:
    """Whether every joint of the goal was measured since its last point is the commanded one."""
    core = loop.core
    for joint in range(loop.params.joint_count):
        if in_goal(loop, core.active, joint) and loop.axes[joint].measured_ns < core.settle_ns:
            return False
    return True
