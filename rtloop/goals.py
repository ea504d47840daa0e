"""The life of a goal in the loop: how it enters, how fast its clock runs, how it ends."""

from typing import Any

from rtloop import guard, intake
from rtloop.events import set_result
from rtloop.modes import change_mode
from rtloop.trajectory import (
    end_s,
    enter,
    first_point_distance,
    in_goal,
    must_brake_for_lack_of_path,
    set_rate,
    steer_rate,
)
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
    if not intake.incoming_is_ready(loop):
        if core.now_ns - core.incoming_ns > STARVED_FOR_NS:
            refuse_incoming(loop, shared, Outcome.STARVED, -1, 0.0, 0.0)
        return
    incoming = loop.paths[core.incoming_path]
    if incoming.start_ns > core.now_ns:
        return  # what runs may run until then
    if incoming.bridge == 0:
        joint, distance = first_point_distance(loop, core.incoming_path)
        if distance > loop.params.start_tolerance_rad:
            refuse_incoming(loop, shared, Outcome.REFUSED_START, joint, distance, loop.params.start_tolerance_rad)
            return
    if core.mode == Mode.STOPPING and core.ending != Outcome.NONE and not guard.at_rest(loop):
        return  # a stop that was asked for is finished first
    if core.mode != Mode.HOLDING and core.mode != Mode.EXECUTING and core.mode != Mode.STOPPING:
        return
    if core.speed_scale <= 0.0:
        core.incoming_waits = 1  # paused altogether: nothing starts
        return
    if enter(loop, core.incoming_path):
        start_incoming(loop, shared)
    elif guard.at_rest(loop):
        refuse_incoming(loop, shared, Outcome.REFUSED_LIMITS, -1, 0.0, 0.0)
    else:
        core.incoming_waits = 1


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
        outcome = core.ending if core.ending != Outcome.NONE else Outcome.REPLACED
        set_result(loop, shared, core.goal_id, outcome, core.ending_joint, core.ending_value, core.ending_limit)
    core.goal_id = core.incoming_goal
    core.incoming_goal = 0
    core.incoming_waits = 0
    core.ending = Outcome.NONE
    core.ending_joint = -1
    core.paused = core.starving = 0
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
    core.paused = core.starving = 0
    core.settle_ns = 0
    set_rate(loop, 1.0)
    if core.mode == Mode.EXECUTING or core.mode == Mode.STOPPING:
        change_mode(loop, shared, Mode.HOLDING)


@jit
def steer(loop: Loop, shared: Shared) -> None:
    """Decide how fast the trajectory clock should run, and begin stops that nobody asked for."""
    core = loop.core
    if core.goal_id == 0:
        return
    front_lost = loop.params.command_address != 0 and intake.front_age_ns(loop) > loop.params.front_timeout_ns
    if core.ending == Outcome.NONE:
        if front_lost:
            core.ending = Outcome.FRONT_LOST
            core.ending_value = intake.front_age_ns(loop) * 1e-9
            core.ending_limit = loop.params.front_timeout_ns * 1e-9
        elif core.closing == 1:
            core.ending = Outcome.SHUTDOWN
    judge_supply(loop)
    if core.ending != Outcome.NONE and core.ending != Outcome.CANCELED and core.ending != Outcome.STOPPED:
        set_result(loop, shared, core.goal_id, core.ending, core.ending_joint, core.ending_value, core.ending_limit)
    if core.own_brake == 1:
        return
    stop = (
        core.ending != Outcome.NONE
        or core.paused == 1
        or core.stale == 1
        or core.starving == 1
        or core.incoming_waits == 1
        or core.fault != Fault.NONE
    )
    if core.ending != Outcome.NONE and core.mode == Mode.EXECUTING:
        change_mode(loop, shared, Mode.STOPPING)
    if stop:
        steer_rate(loop, 0.0)
    elif core.clock_s < loop.paths[core.active].blend_s:
        steer_rate(loop, core.entry_share * core.speed_scale)
    else:
        steer_rate(loop, core.speed_scale)


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
    if running.ended == 0 or core.clock_s < max(end_s(loop, core.active), running.blend_s):
        return
    if core.settle_ns == 0:
        core.settle_ns = core.now_ns + loop.params.period_ns  # when the last point is the commanded one
        return
    judge_arrival(loop, shared)


@jit
def judge_arrival(loop: Loop, shared: Shared) -> None:
    core = loop.core
    running = loop.paths[core.active]
    worst_joint, worst, worst_limit, worst_ratio = -1, 0.0, 0.0, -1.0
    arrived = True
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        if not in_goal(loop, core.active, joint):
            continue
        if axis.measured_ns < core.settle_ns:
            arrived = False
        tolerance = running.tolerances[joint]
        error = axis.position_rad - axis.measured_rad
        ratio = abs(error) / tolerance.goal_tolerance_rad if tolerance.goal_tolerance_rad > 0.0 else 0.0
        if ratio > worst_ratio:
            worst_joint, worst, worst_limit, worst_ratio = joint, error, tolerance.goal_tolerance_rad, ratio
        if ratio > 1.0:
            arrived = False
        if tolerance.goal_velocity_rad_s > 0.0 and (abs(axis.measured_velocity_rad_s) > tolerance.goal_velocity_rad_s):
            arrived = False
    if arrived:
        set_result(loop, shared, core.goal_id, Outcome.SUCCEEDED, worst_joint, worst, worst_limit)
        finish_goal(loop, shared)
    elif running.goal_time_s > 0.0 and (core.now_ns - core.settle_ns) * 1e-9 > running.goal_time_s:
        set_result(loop, shared, core.goal_id, Outcome.GOAL_TOLERANCE, worst_joint, worst, worst_limit)
        finish_goal(loop, shared)
