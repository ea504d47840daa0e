"""The trajectory as the loop runs it: sampling, the clock's rate, and the way onto a new path.

A *path* is a window of knots plus, at its beginning, a blend: a polynomial of path time that starts as the
difference between where the arm is commanded and where the plan begins, and decays to nothing. The arm
follows path(clock) = plan(clock) + blend(clock); whatever slows it down (cancel, pause, starvation …) only
changes the clock's rate, so it stays on that path.

Two decisions cost more than a cycle's ordinary work, and both are made the same way: candidates from quick
to slow are sampled at a fixed number of instants, and the first that keeps the limits is taken. They are
made once per goal and once per change of the wanted rate.
"""

from typing import Any

from motion import scaling, segment
from rtloop.state import BLEND_SAMPLES, WINDOW_KNOTS
from shm.jit import jit

Loop = Any  # record of dtype rtloop.state.LOOP

linear = jit(segment.linear)
cubic = jit(segment.cubic)
quintic = jit(segment.quintic)
evaluate = jit(segment.evaluate)
decay = jit(segment.decay)
fade = jit(segment.fade)
ramp = jit(scaling.ramp)
along = jit(scaling.along)

BLENDS_S = (0.3, 0.6, 1.2, 2.4)
FADE_S = 0.02
FADE_PERIODS = 3
"""A difference in acceleration fades within this time, at least so many periods."""
ENTRY_RATES = (1.0, 0.5, 0.25)
STOP_FRACTIONS = (0.04, 0.06, 0.08, 0.12, 0.16, 0.25, 0.33, 0.5, 0.7, 1.0)
IMPOSSIBLE = 1e9
NO_PATH = 100.0
RESERVE_PERIODS = 3.0
BESIDE_RAD = 1e-9
SLOWEST_ENTRY = 0.02
"""A path is laid for at least this rate, since a blend for next to none would last for ever."""
PLAN_SHARE = 0.35
"""What a blend or a ramp may add, as a share of the limit, where the plan alone already asks for much."""
HEADROOM = 0.9
"""Candidates are sampled, so they stay this far below the bound at which the last defence would stop the arm."""


@jit
def slot(path_index: int, knot: int) -> int:
    """Place of a path's knot in the two windows."""
    return path_index * WINDOW_KNOTS + (knot & (WINDOW_KNOTS - 1))


@jit
def in_goal(loop: Loop, path_index: int, joint: int) -> bool:
    return (loop.paths[path_index].joint_mask >> joint) & 1 == 1


@jit
def end_s(loop: Loop, path_index: int) -> float:
    """Path time of the newest knot."""
    taken = loop.paths[path_index].taken
    if taken == 0:
        return 0.0
    return loop.knots[slot(path_index, taken - 1)].time_ns * 1e-9


@jit
def find_knot(loop: Loop, path_index: int, clock_s: float, first: int) -> int:
    """The knot at the start of the segment that contains clock_s, searched forward from `first`."""
    last = loop.paths[path_index].taken - 1
    knot = first
    while knot < last and loop.knots[slot(path_index, knot + 1)].time_ns * 1e-9 <= clock_s:
        knot += 1
    return knot


@jit
def plan(loop: Loop, path_index: int, joint: int, clock_s: float, knot: int) -> tuple[float, float, float]:
    """Position and its first two derivatives by path time of the plan alone; `knot` from find_knot.

    Before the first knot the plan stands at it, after the newest it stands there.
    """
    if not in_goal(loop, path_index, joint):
        return loop.paths[path_index].blends[joint].held_rad, 0.0, 0.0
    start = loop.knots[slot(path_index, knot)]
    a = start.joints[joint]
    start_s = start.time_ns * 1e-9
    if knot >= loop.paths[path_index].taken - 1 or clock_s < start_s:
        return a.position_rad, 0.0, 0.0
    end = loop.knots[slot(path_index, knot + 1)]
    b = end.joints[joint]
    duration_s = (end.time_ns - start.time_ns) * 1e-9
    if end.order == 5:
        c0, c1, c2, c3, c4, c5 = quintic(
            a.position_rad,
            a.velocity_rad_s,
            a.acceleration_rad_s2,
            b.position_rad,
            b.velocity_rad_s,
            b.acceleration_rad_s2,
            duration_s,
        )
    elif end.order == 3:
        c0, c1, c2, c3, c4, c5 = cubic(a.position_rad, a.velocity_rad_s, b.position_rad, b.velocity_rad_s, duration_s)
    else:
        c0, c1, c2, c3, c4, c5 = linear(a.position_rad, b.position_rad, duration_s)
    return evaluate(c0, c1, c2, c3, c4, c5, clock_s - start_s)


@jit
def blend(loop: Loop, path_index: int, joint: int, clock_s: float) -> tuple[float, float, float]:
    """The offset from the plan at a path time."""
    if clock_s >= loop.paths[path_index].blend_s:
        return 0.0, 0.0, 0.0
    b = loop.paths[path_index].blends[joint]
    p, v, a = evaluate(b.c0, b.c1, b.c2, b.c3, b.c4, b.c5, clock_s)
    fade_s = loop.paths[path_index].fade_s
    if clock_s < fade_s:
        fp, fv, fa = fade(b.faded, fade_s, clock_s)
        return p + fp, v + fv, a + fa
    return p, v, a


@jit
def path(loop: Loop, path_index: int, joint: int, clock_s: float, knot: int) -> tuple[float, float, float]:
    """Plan plus blend: position and its first two derivatives by path time."""
    p, v, a = plan(loop, path_index, joint, clock_s, knot)
    bp, bv, ba = blend(loop, path_index, joint, clock_s)
    return p + bp, v + bv, a + ba


# --- the clock's rate ---------------------------------------------------------------------------------


@jit
def advance_clock(loop: Loop) -> None:
    """Move the trajectory clock by one period at the present rate, along the running ramp if there is one."""
    core = loop.core
    period_s = loop.params.period_ns * 1e-9
    if core.ramp_s <= 0.0:
        core.clock_s += core.rate * period_s
        return
    before_s = core.ramp_elapsed_s
    after_s = min(before_s + period_s, core.ramp_s)
    _, _, advance_before = ramp(core.rate_start, core.slope_start, core.rate_target, core.ramp_s, before_s)
    rate, slope, advance_after = ramp(core.rate_start, core.slope_start, core.rate_target, core.ramp_s, after_s)
    core.clock_s += advance_after - advance_before
    core.ramp_elapsed_s = after_s
    core.rate, core.slope = rate, slope
    if after_s >= core.ramp_s:
        core.clock_s += core.rate_target * (before_s + period_s - after_s)
        core.rate, core.slope, core.ramp_s = core.rate_target, 0.0, 0.0


@jit
def allowed_acceleration(loop: Loop, joint: int, planned_rad_s2: float) -> float:
    """What a change of rate or a blend may bring the joint's acceleration to (rad/s²)."""
    limit = loop.joints[joint].max_acceleration_rad_s2
    return max(
        loop.params.braking_factor * limit,
        min(abs(planned_rad_s2) + PLAN_SHARE * limit, HEADROOM * loop.params.acceleration_margin * limit),
    )


@jit
def ramp_strain(loop: Loop, target: float, duration_s: float) -> float:
    """Largest ratio of acceleration to what is allowed along a candidate ramp; ≤ 1 keeps the limits.

    IMPOSSIBLE for a ramp on which the clock would run backwards or faster than it ever should; NO_PATH and
    more for one that needs path which is not known yet.
    """
    core = loop.core
    active = core.active
    worst = 0.0
    knot = loop.paths[active].segment
    known_s = end_s(loop, active)
    ended = loop.paths[active].ended == 1
    highest_rate = max(core.rate, target, core.rate_target) + 1e-6
    for i in range(1, BLEND_SAMPLES + 1):
        rate, slope, advance = ramp(core.rate, core.slope, target, duration_s, duration_s * i / BLEND_SAMPLES)
        clock_s = core.clock_s + advance
        if rate < -1e-9 or rate > highest_rate:
            return IMPOSSIBLE
        if clock_s > known_s and not ended:
            worst = max(worst, NO_PATH + clock_s - known_s)
        knot = find_knot(loop, active, clock_s, knot)
        for joint in range(loop.params.joint_count):
            _, v, a = path(loop, active, joint, clock_s, knot)
            _, acceleration = along(rate, slope, v, a)
            worst = max(worst, abs(acceleration) / allowed_acceleration(loop, joint, rate * rate * a))
    return worst


@jit
def ramp_duration(loop: Loop, target: float) -> tuple[float, float]:
    """The shortest candidate in which the rate reaches `target` inside the limits, else the gentlest.

    Duration and strain; the duration is 0 if no candidate is possible at all.
    """
    best_s, best_strain = 0.0, IMPOSSIBLE
    for fraction in STOP_FRACTIONS:
        duration_s = fraction * loop.params.longest_stop_s
        strain = ramp_strain(loop, target, duration_s)
        if strain <= 1.0:
            return duration_s, strain
        if strain < best_strain:
            best_strain, best_s = strain, duration_s
    return best_s, best_strain


@jit
def steer_rate(loop: Loop, target: float) -> None:
    """Let the rate go to `target`; a ramp that already goes there runs on.

    Turning a ramp round in its steepest part can be impossible, without the clock running backwards or the
    joints being pushed too hard. The running ramp then goes on and the question is asked again in the next
    cycle; a stop that can be begun at all is begun at once, as gently as can be.
    """
    core = loop.core
    if target == core.rate_target:
        return
    duration_s, strain = ramp_duration(loop, target)
    speeds_up_amid_a_ramp = target > core.rate_target and core.ramp_s > 0.0
    if duration_s <= 0.0 or (strain > 1.0 and speeds_up_amid_a_ramp):
        return
    core.rate_target = target
    core.rate_start, core.slope_start = core.rate, core.slope
    core.ramp_s, core.ramp_elapsed_s = duration_s, 0.0


@jit
def set_rate(loop: Loop, rate: float) -> None:
    """Run at a rate from now on, without a ramp: for an arm at rest or a path made for that rate."""
    core = loop.core
    core.rate = core.rate_target = rate
    core.slope = core.ramp_s = 0.0


@jit
def must_brake_for_lack_of_path(loop: Loop, braking_already: bool) -> bool:
    """Whether the knots that are left last no longer than stopping takes, and no END is among them.

    Once braking has begun for that reason it ends only when there is ample path again.
    """
    core = loop.core
    active = core.active
    if loop.paths[active].ended == 1:
        return False
    longest_s = 0.5 * loop.params.longest_stop_s * max(core.rate, core.speed_scale)
    left_s = end_s(loop, active) - core.clock_s - RESERVE_PERIODS * loop.params.period_ns * 1e-9
    if left_s > longest_s:
        return False
    if braking_already or core.rate_target == 0.0:
        return True
    duration_s, _ = ramp_duration(loop, 0.0)
    return left_s <= 0.5 * core.rate * duration_s


# --- the way onto a path ------------------------------------------------------------------------------


@jit
def first_point_distance(loop: Loop, path_index: int) -> tuple[int, float]:
    """The joint that is farthest from the path's first knot, and how far (rad)."""
    worst_joint, worst = -1, 0.0
    first = loop.knots[slot(path_index, 0)]
    for joint in range(loop.params.joint_count):
        if in_goal(loop, path_index, joint):
            distance = abs(first.joints[joint].position_rad - loop.axes[joint].position_rad)
            if distance >= worst:
                worst_joint, worst = joint, distance
    return worst_joint, worst


@jit
def lay_blend(loop: Loop, path_index: int, rate: float, duration_s: float) -> None:
    """Make the path start exactly at the commanded state when it is run at `rate`."""
    loop.paths[path_index].blend_s = duration_s
    fade_s = rate * max(FADE_S, FADE_PERIODS * loop.params.period_ns * 1e-9)
    loop.paths[path_index].fade_s = fade_s
    bridge = loop.paths[path_index].bridge == 1
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        v, a = axis.velocity_rad_s / rate, axis.acceleration_rad_s2 / (rate * rate)
        first = loop.knots[slot(path_index, 0)].joints[joint]
        b = loop.paths[path_index].blends[joint]
        if not in_goal(loop, path_index, joint):
            # comes to rest half a blend's way ahead
            b.held_rad = axis.position_rad + 0.5 * v * duration_s
        elif bridge:
            first.position_rad, first.velocity_rad_s, first.acceleration_rad_s2 = axis.position_rad, v, a
        p0, v0, a0 = plan(loop, path_index, joint, 0.0, 0)
        b.faded = a - a0
        fp, fv, _ = fade(b.faded, fade_s, 0.0)
        b.c0, b.c1, b.c2, b.c3, b.c4, b.c5 = decay(axis.position_rad - p0 - fp, v - v0 - fv, 0.0, duration_s)


@jit
def entry_strain(loop: Loop, path_index: int, rate: float, duration_s: float) -> float:
    """Largest ratio of velocity or acceleration to its limit on the first stretch of a path; ≤ 1 keeps them."""
    worst = 0.0
    knot = 0
    known_s = end_s(loop, path_index)
    ended = loop.paths[path_index].ended == 1
    for i in range(BLEND_SAMPLES + 1):
        clock_s = duration_s * i / BLEND_SAMPLES
        if clock_s > known_s and not ended:
            return IMPOSSIBLE
        knot = find_knot(loop, path_index, clock_s, knot)
        for joint in range(loop.params.joint_count):
            row = loop.joints[joint]
            _, _, planned = plan(loop, path_index, joint, clock_s, knot)
            p, v, a = path(loop, path_index, joint, clock_s, knot)
            here = loop.axes[joint].position_rad  # a joint that was found outside may move in
            low = min(row.lower_rad - row.slack_rad, here)
            high = max(row.upper_rad + row.slack_rad, here)
            if p < low - BESIDE_RAD or p > high + BESIDE_RAD:
                return IMPOSSIBLE
            speed = rate * abs(v) / (loop.params.velocity_margin * row.max_velocity_rad_s)
            push = rate * rate * abs(a) / allowed_acceleration(loop, joint, rate * rate * planned)
            if not (speed <= IMPOSSIBLE and push <= IMPOSSIBLE):
                return IMPOSSIBLE  # not a number
            worst = max(worst, speed, push)
    return worst


@jit
def enter(loop: Loop, path_index: int) -> bool:
    """Find a bounded way from the commanded state onto a path and lay it; False when there is none.

    Tries the wanted rate before slower ones, and short blends before long ones. On success the path's clock
    stands at zero and runs at `core.entry_share` of the wanted rate until the blend is over.
    """
    core = loop.core
    wanted = max(core.speed_scale, SLOWEST_ENTRY)
    bridge = loop.paths[path_index].bridge == 1
    for slower in ENTRY_RATES:
        rate = wanted * slower
        for blend_s in BLENDS_S:
            duration_s = loop.knots[slot(path_index, 1)].time_ns * 1e-9 if bridge else blend_s
            lay_blend(loop, path_index, rate, duration_s)
            if entry_strain(loop, path_index, rate, duration_s) <= 1.0:
                core.active = path_index
                core.clock_s = 0.0
                core.entry_share = slower
                loop.paths[path_index].segment = 0
                set_rate(loop, rate)
                return True
            if bridge:
                break
    return False
