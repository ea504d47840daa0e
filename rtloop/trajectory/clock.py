"""The trajectory clock: how fast the arm runs along its path.

Whatever slows the arm down (cancel, pause, speed scale, starvation …) only lowers the clock's rate, so the arm stays
on its path. A change of rate is a ramp, chosen once when another rate is wanted: ramps from short to long are sampled
at a fixed number of instants, and the first that keeps the limits is taken. Where the path may bend between those
instants, setpoints are looked at too. A cycle may not look at all of them: what is left is looked at in the cycles
that follow, while the ramp runs, and a gentler one begins as soon as a setpoint ahead would break a limit.
"""

import math

from compilation.jit import jit
from motion import scaling, stopping
from motion.stopping import PLAN_SHARE, STOP_FRACTIONS
from rtloop.memory.motion import BLEND_SAMPLES
from rtloop.memory.state import Loop
from rtloop.trajectory.ahead import look_from, look_from_here, may_look, next_keeps_limits
from rtloop.trajectory.path import end_s, find_waypoint, goes_on_past_end, sample

ramp = jit(scaling.ramp)
along = jit(scaling.along)
way_s = jit(stopping.way_s)

IMPOSSIBLE = 1e9
NO_PATH = 100.0
BREAKS_A_LIMIT = 10.0
"""Added to the strain of a ramp that the last line of defence would not let pass."""
UNPROVEN = 2.0
"""Added to that of one to a higher rate when the cycle may not look at all its setpoints."""
RESERVE_PERIODS = 3.0
ROUNDING = 1.0 + 1e-9
HEADROOM = 0.9
"""Candidates are sampled, so they stay this far below the bound at which the last defence would stop the arm."""


@jit
def advance_clock(loop: Loop) -> None:
    """Move the trajectory clock by one period at the present rate, along the running ramp if there is one."""
    clock = loop.clock
    period_s = loop.params.period_ns * 1e-9
    if clock.ramp_s <= 0.0:
        clock.time_s += clock.rate * period_s
        return
    before_s = clock.ramp_elapsed_s
    after_s = min(before_s + period_s, clock.ramp_s)
    _, _, advance_before = ramp(clock.rate_start, clock.slope_start, clock.rate_target, clock.ramp_s, before_s)
    rate, slope, advance_after = ramp(clock.rate_start, clock.slope_start, clock.rate_target, clock.ramp_s, after_s)
    clock.time_s += advance_after - advance_before
    clock.ramp_elapsed_s = after_s
    clock.ramp_judged = max(clock.ramp_judged - 1, 0)
    clock.rate, clock.slope = rate, slope
    if after_s >= clock.ramp_s:
        clock.time_s += clock.rate_target * (before_s + period_s - after_s)
        clock.rate, clock.slope, clock.ramp_s = clock.rate_target, 0.0, 0.0


@jit
def allowed_acceleration(loop: Loop, joint: int, planned_rad_s2: float, factor: float, share: float) -> float:
    """What a change of rate or a blend may bring the joint's acceleration to (rad/s²).

    `factor` times its limit, `share` of it more than the plan where that asks for as much, and what it has already.
    """
    limit = loop.joints[joint].max_acceleration_rad_s2
    beside_plan = min(abs(planned_rad_s2) + share * limit, HEADROOM * loop.params.acceleration_margin * limit)
    return max(factor * limit, beside_plan, ROUNDING * abs(loop.axes[joint].commanded.acceleration_rad_s2))


@jit
def ramp_strain(loop: Loop, target: float, duration_s: float, factor: float) -> float:
    """Largest ratio of acceleration to what is allowed along a candidate ramp; ≤ 1 keeps the limits.

    What the plan asks for is taken at the higher of both rates: a stop may push as hard as the plan did without it.

    IMPOSSIBLE for a ramp on which the clock would run backwards or faster than it ever should; NO_PATH and
    more for one that needs path which is not known yet.
    """
    clock = loop.clock
    active = loop.goals.active
    worst = 0.0
    waypoint = loop.paths[active].segment
    known_s = end_s(loop, active)
    goes_on = goes_on_past_end(loop, active)
    highest_rate = max(clock.rate, target, clock.rate_target) + 1e-6
    full = max(clock.rate, target)
    for i in range(1, BLEND_SAMPLES + 1):
        rate, slope, advance = ramp(clock.rate, clock.slope, target, duration_s, duration_s * i / BLEND_SAMPLES)
        clock_s = clock.time_s + advance
        if rate < -1e-9 or rate > highest_rate:
            return IMPOSSIBLE
        if clock_s > known_s and not goes_on:
            worst = max(worst, NO_PATH + clock_s - known_s)
        waypoint = find_waypoint(loop, active, clock_s, waypoint)
        for joint in range(loop.params.joint_count):
            _, v, a = sample(loop, active, joint, clock_s, waypoint)
            _, acceleration = along(rate, slope, v, a)
            allowed = allowed_acceleration(loop, joint, full * full * a, factor, PLAN_SHARE)
            worst = max(worst, abs(acceleration) / allowed)
    return worst


@jit
def is_rough(loop: Loop, duration_s: float) -> bool:
    """Whether the running path may bend between the instants at which a ramp of a duration is sampled."""
    sampled_s = max(duration_s / BLEND_SAMPLES, loop.params.period_ns * 1e-9)
    return bool(loop.paths[loop.goals.active].closest_ns * 1e-9 <= sampled_s)


@jit
def clock_ahead_s(loop: Loop, target: float, duration_s: float, periods: int) -> float:
    """Path time so many periods from now, if the rate goes to `target` within a duration and then stays there."""
    clock = loop.clock
    after_s = periods * loop.params.period_ns * 1e-9
    _, _, advance = ramp(clock.rate, clock.slope, target, duration_s, min(after_s, duration_s))
    return float(clock.time_s + advance + target * max(after_s - duration_s, 0.0))


@jit
def setpoints_to_judge(loop: Loop, duration_s: float) -> int:
    """How many setpoints a ramp decides: those on it, and the one after it, whose differences reach back into it."""
    return math.ceil(duration_s / (loop.params.period_ns * 1e-9)) + 1


@jit
def setpoints_within_limits(loop: Loop, target: float, duration_s: float, known: int) -> int:
    """How many setpoints of a ramp from here keep the limits, one after another; the first `known` of them do.

    When that is not all, the next one breaks a limit, or is not looked at: `search.checks_left` is then -1.
    """
    active = loop.goals.active
    waypoint = loop.paths[active].segment
    look_from_here(loop)
    if known > 0:
        clock_s = clock_ahead_s(loop, target, duration_s, known)
        look_from(loop, active, clock_s, clock_s - clock_ahead_s(loop, target, duration_s, known - 1), waypoint)
    for i in range(known, setpoints_to_judge(loop, duration_s)):
        if not may_look(loop):
            return i
        clock_s = clock_ahead_s(loop, target, duration_s, i + 1)
        waypoint = find_waypoint(loop, active, clock_s, waypoint)
        if not next_keeps_limits(loop, active, clock_s, waypoint):
            return i
    return setpoints_to_judge(loop, duration_s)


@jit
def setpoint_strain(loop: Loop, target: float, duration_s: float) -> float:
    """What the setpoints of a candidate ramp add to its strain: BREAKS_A_LIMIT, UNPROVEN, or nothing.

    When no more may be looked at in this cycle a lower rate is believed to keep the limits, since a stop cannot wait.
    """
    if setpoints_within_limits(loop, target, duration_s, 0) >= setpoints_to_judge(loop, duration_s):
        return 0.0
    if loop.search.checks_left >= 0:
        return BREAKS_A_LIMIT
    return 0.0 if target <= loop.clock.rate else UNPROVEN


@jit
def ramp_duration(loop: Loop, target: float, factor: float, longer_than_s: float = 0.0) -> tuple[float, float]:
    """The shortest candidate beyond `longer_than_s` in which the rate reaches `target` inside the limits.

    Where there is none, that of the least strain.

    `factor` is the share of the acceleration limits that the ramp may use: ORDERLY, or that of an urgent stop.

    Where points are closer than the instants at which a candidate is sampled, its setpoints are looked at too.

    Duration and strain; the duration is 0 if no candidate is possible at all.
    """
    best_s, best_strain = 0.0, IMPOSSIBLE
    for fraction in STOP_FRACTIONS:
        duration_s = fraction * loop.params.longest_stop_s
        if duration_s <= longer_than_s:
            continue
        strain = ramp_strain(loop, target, duration_s, factor)
        if strain < NO_PATH and is_rough(loop, duration_s):
            strain += setpoint_strain(loop, target, duration_s)
        if strain <= 1.0:
            return duration_s, strain
        if strain < best_strain:
            best_strain, best_s = strain, duration_s
    return best_s, best_strain


@jit
def ramp_breaks_a_limit(loop: Loop) -> bool:
    """Look further along the running ramp: whether a setpoint on it is now known to break a limit."""
    clock = loop.clock
    if not is_rough(loop, clock.ramp_s):
        return False
    left_s = clock.ramp_s - clock.ramp_elapsed_s
    if clock.ramp_judged >= setpoints_to_judge(loop, left_s):
        return False
    clock.ramp_judged = setpoints_within_limits(loop, clock.rate_target, left_s, clock.ramp_judged)
    return bool(clock.ramp_judged < setpoints_to_judge(loop, left_s) and loop.search.checks_left >= 0)


@jit
def steer_rate(loop: Loop, target: float, factor: float) -> None:
    """Let the rate go to `target`; a ramp that already goes there runs on, unless a harder one is there sooner.

    One on which a setpoint is found to break a limit gives way to a longer candidate on which none is known to, if
    there is one; candidates longer than the whole ramp alone are asked, so that this comes to an end.

    Turning a ramp round in its steepest part can be impossible, without the clock running backwards or the
    joints being pushed too hard. The running ramp then goes on and the question is asked again in the next
    cycle. From a steady rate a stop is begun at once, as gently as can be; a higher rate can wait on a rough path.
    """
    clock = loop.clock
    on_its_way = target == clock.rate_target
    if on_its_way and clock.ramp_s <= 0.0:
        return
    if on_its_way and factor <= clock.ramp_factor:
        if ramp_breaks_a_limit(loop):
            duration_s, strain = ramp_duration(loop, target, factor, clock.ramp_s)
            if strain < BREAKS_A_LIMIT:
                begin_ramp(loop, target, duration_s, factor)
        return
    duration_s, strain = ramp_duration(loop, target, factor)
    can_wait = target > clock.rate > 0.0 and is_rough(loop, loop.params.longest_stop_s)
    if duration_s <= 0.0 or (strain > 1.0 and (clock.ramp_s > 0.0 or can_wait)):
        return
    if on_its_way and duration_s >= clock.ramp_s - clock.ramp_elapsed_s:
        return
    loop.goals.arriving = 0
    begin_ramp(loop, target, duration_s, factor)


@jit
def begin_ramp(loop: Loop, target: float, duration_s: float, factor: float) -> None:
    clock = loop.clock
    clock.ramp_factor = factor
    clock.rate_target = target
    clock.rate_start, clock.slope_start = clock.rate, clock.slope
    clock.ramp_s, clock.ramp_elapsed_s, clock.ramp_judged = duration_s, 0.0, 0


@jit
def set_rate(loop: Loop, rate: float) -> None:
    """Run at a rate from now on, without a ramp: for an arm at rest or a path made for that rate."""
    clock = loop.clock
    clock.rate = clock.rate_target = rate
    clock.slope = clock.ramp_s = 0.0


@jit
def must_brake_for_lack_of_path(loop: Loop, braking_already: bool) -> bool:
    """Whether the waypoints that are left last no longer than stopping takes, and no END is among them.

    Once braking has begun for that reason it ends only when there is ample path again.
    """
    clock = loop.clock
    active = loop.goals.active
    if loop.paths[active].ended == 1:
        return False
    longest_s = way_s(loop.params.longest_stop_s) * max(clock.rate, loop.operator.speed_scale)
    left_s = end_s(loop, active) - clock.time_s - RESERVE_PERIODS * loop.params.period_ns * 1e-9
    if left_s > longest_s:
        return False
    if braking_already or clock.rate_target == 0.0:
        return True
    duration_s, _ = ramp_duration(loop, 0.0, loop.params.braking_factor)
    return left_s <= 0.5 * clock.rate * duration_s
