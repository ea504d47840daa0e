"""The trajectory as the loop runs it: sampling, the clock's rate, and the way onto a new path.

A *path* is a window of knots plus, at its beginning, a blend: a polynomial of path time that starts as the
difference between where the arm is commanded and where the plan begins, and decays to nothing. The arm
follows path(clock) = plan(clock) + blend(clock); whatever slows it down (cancel, pause, starvation …) only
changes the clock's rate, so it stays on that path.

Two decisions cost more than a cycle's ordinary work, and both are made the same way: candidates from quick
to slow are sampled at a fixed number of instants, and the first that keeps the limits is taken. They are
made once per goal and once per change of the wanted rate.
"""

import math
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
STREAM_BLENDS_S = (0.1, 0.2, 0.4, 0.8)
"""A blend of T follows points without a time 0.6 T behind, so a stream gets the shortest one the limits allow."""
FADE_S = 0.02
FADE_PERIODS = 3
"""A difference in acceleration fades within this time, at least so many periods."""
ENTRY_RATES = (1.0, 0.5, 0.25)
STOP_FRACTIONS = (0.04, 0.06, 0.08, 0.12, 0.16, 0.25, 0.33, 0.5, 0.7, 1.0)
STOP_LENGTHENING = 1.6
IMPOSSIBLE = 1e9
NO_PATH = 100.0
RESERVE_PERIODS = 3.0
BESIDE_RAD = 1e-9
SLOWEST_ENTRY_IN_MOTION = 0.2
SLOWEST_ENTRY = 0.02
"""A path is laid for at least such a rate, since a blend for next to none would last for ever."""
PLAN_SHARE = 0.35
"""What a blend or a ramp may add, as a share of the limit, where the plan alone already asks for much."""
REST_RAD_S = 1e-3
"""A last point that is slower is meant to be at rest: planners leave residues."""
ARRIVED_S = 1e-6
ARRIVAL_SHARE = 0.25
"""Getting to the full rate and back to rest takes less path time than this share of the longest stop."""
HEADROOM = 0.9
"""Candidates are sampled, so they stay this far below the bound at which the last defence would stop the arm."""
SPEED_HEADROOM = 0.99
"""The same of the speed, which changes less between two samples."""


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

    Before the first knot the plan stands at it, after the newest it stands there; a stream runs on straight.
    """
    if not in_goal(loop, path_index, joint):
        return loop.paths[path_index].blends[joint].held_rad, 0.0, 0.0
    start = loop.knots[slot(path_index, knot)]
    a = start.joints[joint]
    start_s = start.time_ns * 1e-9
    if knot >= loop.paths[path_index].taken - 1 or clock_s < start_s:
        runs_on = loop.paths[path_index].stream == 1 and loop.paths[path_index].ends_moving == 1
        if runs_on and clock_s >= start_s:
            return straight_on(loop, a, clock_s - start_s)
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
def straight_on(loop: Loop, last: Any, t: float) -> tuple[float, float, float]:
    """Beyond the last point of a stream, t ≥ 0 s after it: its acceleration fades, its velocity stays."""
    fade_s = fade_duration_s(loop)
    p, v, a = fade(last.acceleration_rad_s2, fade_s, min(t, fade_s))
    p0, v0, _ = fade(last.acceleration_rad_s2, fade_s, 0.0)
    return last.position_rad - p0 + (last.velocity_rad_s - v0) * t + p, last.velocity_rad_s - v0 + v, a


@jit
def fade_duration_s(loop: Loop) -> float:
    return max(FADE_S, FADE_PERIODS * loop.params.period_ns * 1e-9)


@jit
def blend(loop: Loop, path_index: int, joint: int, clock_s: float) -> tuple[float, float, float]:
    """The offset from the plan at a path time."""
    t = clock_s - loop.paths[path_index].entry_s
    if t >= loop.paths[path_index].blend_s:
        return 0.0, 0.0, 0.0
    b = loop.paths[path_index].blends[joint]
    p, v, a = evaluate(b.c0, b.c1, b.c2, b.c3, b.c4, b.c5, t)
    fade_s = loop.paths[path_index].fade_s
    if t < fade_s:
        fp, fv, fa = fade(b.faded, fade_s, t)
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
    goes_on = goes_on_past_end(loop, active)
    highest_rate = max(core.rate, target, core.rate_target) + 1e-6
    for i in range(1, BLEND_SAMPLES + 1):
        rate, slope, advance = ramp(core.rate, core.slope, target, duration_s, duration_s * i / BLEND_SAMPLES)
        clock_s = core.clock_s + advance
        if rate < -1e-9 or rate > highest_rate:
            return IMPOSSIBLE
        if clock_s > known_s and not goes_on:
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
    cycle. From a steady rate a stop is begun at once, as gently as can be.
    """
    core = loop.core
    if target == core.rate_target:
        return
    duration_s, strain = ramp_duration(loop, target)
    if duration_s <= 0.0 or (strain > 1.0 and core.ramp_s > 0.0):
        return
    core.arriving = 0
    begin_ramp(loop, target, duration_s)


@jit
def begin_ramp(loop: Loop, target: float, duration_s: float) -> None:
    core = loop.core
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


# --- the end of a path --------------------------------------------------------------------------------


@jit
def leaves_a_joint_moving(loop: Loop, path_index: int) -> bool:
    """Whether the newest knot of a path leaves a joint of its goal in motion."""
    path = loop.paths[path_index]
    if path.taken == 0:
        return False
    last = loop.knots[slot(path_index, path.taken - 1)]
    for joint in range(loop.params.joint_count):
        if in_goal(loop, path_index, joint) and abs(last.joints[joint].velocity_rad_s) > REST_RAD_S:
            return True
    return False


@jit
def goes_on_past_end(loop: Loop, path_index: int) -> bool:
    """Whether the clock may pass the last knot: the plan then stands there, or runs on straight as a stream's."""
    path = loop.paths[path_index]
    return path.ended == 1 and (path.stream == 1 or path.ends_moving == 0)


@jit
def slow_down_to_arrive(loop: Loop) -> None:
    """Begin the ramp that ends at rest exactly where the path does, as late as the limits allow.

    Along a ramp from rate s with slope u to zero within T the clock advances T (s / 2 + u T / 12), so the path that
    is left decides T; it begins when T is longer than the shortest stop by no more than two cycles make of it.
    """
    core = loop.core
    left_s = end_s(loop, core.active) - core.clock_s
    if left_s <= ARRIVED_S and core.rate == 0.0:
        core.arriving = 1
    if core.rate_target == 0.0 or core.rate <= 0.0 or left_s <= 0.0:
        return
    if left_s > 0.5 * core.rate * loop.params.longest_stop_s:
        return
    discriminant = 0.25 * core.rate * core.rate + core.slope * left_s / 3.0
    if discriminant < 0.0:
        return  # a rate that falls so steeply stops before the end; it is about to turn
    shortest_s, _ = ramp_duration(loop, 0.0)
    duration_s = 2.0 * left_s / (0.5 * core.rate + math.sqrt(discriminant))
    if duration_s <= shortest_s + 4.0 * loop.params.period_ns * 1e-9:
        core.arriving = 1
        begin_ramp(loop, 0.0, duration_s)


@jit
def rate_with_room_to_arrive(loop: Loop, wanted: float) -> float:
    """The rate that may be sped up to when the path ends soon, and at rest: what is left must do for both ramps."""
    core = loop.core
    left_s = end_s(loop, core.active) - core.clock_s
    return min(wanted, max(core.rate_target, left_s / (ARRIVAL_SHARE * loop.params.longest_stop_s)))


@jit
def has_arrived(loop: Loop) -> bool:
    """Whether the ramp that ends where the path does is over; puts the clock right there."""
    core = loop.core
    if core.arriving == 0 or core.ramp_s > 0.0 or core.rate > 0.0:
        return False
    left_s = end_s(loop, core.active) - core.clock_s
    if abs(left_s) > ARRIVED_S:
        core.arriving = 0  # it was turned round on the way
        return False
    core.clock_s = end_s(loop, core.active)
    return True


# --- the way onto a path ------------------------------------------------------------------------------


@jit
def due_s(loop: Loop, path_index: int) -> float:
    """Path time at which a path would be entered now: its beginning, or where its start time says it is due."""
    path = loop.paths[path_index]
    if path.start_ns == 0:
        return 0.0
    due = max((loop.core.now_ns - path.start_ns) * 1e-9, 0.0)
    return min(due, end_s(loop, path_index)) if path.ended == 1 else due


@jit
def has_bridge(loop: Loop, path_index: int, entry_s: float) -> bool:
    """Whether the first knot of the goal is still ahead, and the way to it begins where the arm is commanded."""
    path = loop.paths[path_index]
    return path.bridge == 1 and path.taken > 1 and entry_s < loop.knots[slot(path_index, 1)].time_ns * 1e-9


@jit
def entry_distance(loop: Loop, path_index: int, entry_s: float) -> tuple[int, float]:
    """The joint that is farthest from the plan where it would be entered, and how far (rad)."""
    worst_joint, worst = -1, 0.0
    first = 0 if has_bridge(loop, path_index, entry_s) else loop.paths[path_index].bridge
    knot = find_knot(loop, path_index, entry_s, first)
    for joint in range(loop.params.joint_count):
        if in_goal(loop, path_index, joint):
            p, _, _ = plan(loop, path_index, joint, entry_s, knot)
            distance = abs(p - loop.axes[joint].position_rad)
            if distance >= worst:
                worst_joint, worst = joint, distance
    return worst_joint, worst


@jit
def lay_bridge(loop: Loop, path_index: int, rate: float, entry_s: float) -> None:
    """Let the path begin at the commanded state, so that its first segment is the way to the goal's first point."""
    first = loop.knots[slot(path_index, 0)]
    first.time_ns = round(entry_s * 1e9)
    for joint in range(loop.params.joint_count):
        axis, row = loop.axes[joint], first.joints[joint]
        row.position_rad = axis.position_rad
        row.velocity_rad_s = axis.velocity_rad_s / rate
        row.acceleration_rad_s2 = axis.acceleration_rad_s2 / (rate * rate)


@jit
def lay_run_up(loop: Loop, path_index: int, entry_s: float) -> None:
    """Let the path begin on the straight line that leads through the first point at its velocity.

    The points of a stream may lie only milliseconds ahead, too near to be reached exactly: what is between the
    arm and this line is then left to the blend.
    """
    first, second = loop.knots[slot(path_index, 0)], loop.knots[slot(path_index, 1)]
    first.time_ns = round(entry_s * 1e9)
    ahead_s = (second.time_ns - first.time_ns) * 1e-9
    for joint in range(loop.params.joint_count):
        row, target = first.joints[joint], second.joints[joint]
        row.position_rad = target.position_rad - target.velocity_rad_s * ahead_s
        row.velocity_rad_s = target.velocity_rad_s
        row.acceleration_rad_s2 = 0.0


@jit
def lay_blend(loop: Loop, path_index: int, rate: float, entry_s: float, duration_s: float) -> None:
    """Make the path start exactly at the commanded state when it is entered at `rate`."""
    path = loop.paths[path_index]
    path.entry_s = entry_s
    path.blend_s = duration_s
    path.fade_s = rate * fade_duration_s(loop)
    knot = find_knot(loop, path_index, entry_s, 0)
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        v, a = axis.velocity_rad_s / rate, axis.acceleration_rad_s2 / (rate * rate)
        b = path.blends[joint]
        if not in_goal(loop, path_index, joint):
            # comes to rest half a blend's way ahead
            b.held_rad = axis.position_rad + 0.5 * v * duration_s
        p0, v0, a0 = plan(loop, path_index, joint, entry_s, knot)
        b.faded = a - a0
        fp, fv, _ = fade(b.faded, path.fade_s, 0.0)
        b.c0, b.c1, b.c2, b.c3, b.c4, b.c5 = decay(axis.position_rad - p0 - fp, v - v0 - fv, 0.0, duration_s)


@jit
def stop_reach_s(loop: Loop, path_index: int) -> float:
    """Path time beyond the end of a stream at which the arm stands if nothing newer comes; 0 for other goals.

    A stop of duration T takes T / 2 of path time and pushes with 1.5 v / T at the most; the candidate that is taken is
    up to STOP_LENGTHENING times the shortest possible.
    """
    path = loop.paths[path_index]
    if path.stream == 0 or path.ends_moving == 0:
        return 0.0
    last = loop.knots[slot(path_index, path.taken - 1)]
    shortest_s = 0.0
    for joint in range(loop.params.joint_count):
        if in_goal(loop, path_index, joint):
            braking = loop.params.braking_factor * loop.joints[joint].max_acceleration_rad_s2
            shortest_s = max(shortest_s, 1.5 * abs(last.joints[joint].velocity_rad_s) / braking)
    return 0.5 * STOP_LENGTHENING * shortest_s + 2.0 * loop.params.period_ns * 1e-9


@jit
def blend_strain(loop: Loop, path_index: int, rate: float, from_s: float) -> float:
    """Largest ratio of velocity or acceleration to its limit from a path time to the blend's end; ≤ 1 keeps them."""
    entering = loop.paths[path_index]
    until_s = entering.entry_s + entering.blend_s
    worst = 0.0
    knot = 0
    known_s = end_s(loop, path_index)
    goes_on = goes_on_past_end(loop, path_index)
    bridged = has_bridge(loop, path_index, entering.entry_s)
    stands_s = known_s + stop_reach_s(loop, path_index)
    for i in range(BLEND_SAMPLES + 1):
        clock_s = from_s + (until_s - from_s) * i / BLEND_SAMPLES
        if clock_s > known_s and not goes_on:
            return IMPOSSIBLE
        knot = find_knot(loop, path_index, clock_s, knot)
        for joint in range(loop.params.joint_count):
            row = loop.joints[joint]
            _, planned_speed, planned = plan(loop, path_index, joint, clock_s, knot)
            p, v, a = path(loop, path_index, joint, clock_s, knot)
            here = loop.axes[joint].position_rad  # a joint that was found outside may move in
            low = min(row.lower_rad - row.slack_rad, here)
            high = max(row.upper_rad + row.slack_rad, here)
            if clock_s > stands_s and in_goal(loop, path_index, joint):  # the arm will have stopped there
                p += plan(loop, path_index, joint, stands_s, knot)[0] - plan(loop, path_index, joint, clock_s, knot)[0]
            if p < low - BESIDE_RAD or p > high + BESIDE_RAD:
                return IMPOSSIBLE
            fastest = SPEED_HEADROOM * loop.params.velocity_margin * row.max_velocity_rad_s
            if not bridged:
                fastest = max(fastest, abs(planned_speed))  # what the goal's own points ask for was checked exactly
            speed = rate * abs(v) / fastest
            push = rate * rate * abs(a) / allowed_acceleration(loop, joint, rate * rate * planned)
            if not (speed <= IMPOSSIBLE and push <= IMPOSSIBLE):
                return IMPOSSIBLE  # not a number
            worst = max(worst, speed, push)
    return worst


@jit
def asked_rate(loop: Loop, path_index: int) -> float:
    """The rate people asked for; a stream keeps its own time, which nothing but a factor of 0 stops."""
    if loop.paths[path_index].stream == 1 and loop.core.speed_scale > 0.0:
        return 1.0
    return float(loop.core.speed_scale)


@jit
def enter(loop: Loop, path_index: int, entry_s: float) -> bool:
    """Find a bounded way from the commanded state onto a path and lay it; False when there is none.

    The first rate to be tried is the wanted one, or the higher one of a clock that is just slowing down: a blend made
    for a rate far below that of the motion would carry that motion on for ever. Slower ones follow, and longer blends
    after short ones. On success the path's clock stands at `entry_s` and runs at a rate that may differ from the
    wanted one for as long as the blend lasts, see `rate_while_blending`.
    """
    core = loop.core
    wanted = max(asked_rate(loop, path_index), SLOWEST_ENTRY)
    if core.goal_id != 0:
        wanted = max(wanted, core.rate, SLOWEST_ENTRY_IN_MOTION)
    bridged = has_bridge(loop, path_index, entry_s)
    for slower in ENTRY_RATES:
        rate = wanted * slower
        if bridged:
            lay_bridge(loop, path_index, rate, entry_s)
            ahead_s = loop.knots[slot(path_index, 1)].time_ns * 1e-9 - entry_s
            lay_blend(loop, path_index, rate, entry_s, ahead_s)
            if blend_strain(loop, path_index, rate, entry_s) <= 1.0:
                begin_path(loop, path_index, rate)
                return True
            if loop.paths[path_index].stream == 0:
                continue
            lay_run_up(loop, path_index, entry_s)
            if entry_distance(loop, path_index, entry_s)[1] > loop.params.start_tolerance_rad:
                continue
        blends_s = STREAM_BLENDS_S if loop.paths[path_index].stream == 1 else BLENDS_S
        for blend_s in blends_s:
            lay_blend(loop, path_index, rate, entry_s, blend_s)
            if blend_strain(loop, path_index, rate, entry_s) <= 1.0:
                begin_path(loop, path_index, rate)
                return True
    return False


@jit
def rate_while_blending(loop: Loop, wanted: float) -> float:
    """The wanted rate, or that of the entry as long as the rest of the blend would be too fast with more.

    A blend that begins in motion carries the joints' velocity divided by the rate, so it is made for its rate.
    """
    core = loop.core
    entered = loop.paths[core.active]
    blending = core.clock_s < entered.entry_s + entered.blend_s
    if blending and wanted > core.entry_rate and blend_strain(loop, core.active, wanted, core.clock_s) > 1.0:
        return float(core.entry_rate)
    return wanted


@jit
def begin_path(loop: Loop, path_index: int, rate: float) -> None:
    """Run this path from now on, from where it was entered."""
    core = loop.core
    core.active = path_index
    core.clock_s = loop.paths[path_index].entry_s
    core.entry_rate = rate
    core.arriving = 0
    loop.paths[path_index].segment = 0
    set_rate(loop, rate)
