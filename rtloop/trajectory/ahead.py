"""Looking ahead: whether setpoints yet to come keep the limits by which the last line of defence will judge them.

Plan plus blend is one polynomial from waypoint to waypoint, and at a steady rate the defence's differences of
setpoints are means of its derivatives: over a span in which bounds of the derivatives keep the limits, no setpoint
can break them, whatever its phase. Elsewhere, above all where points are closer than a cycle, the setpoints are made
one by one as they will be commanded. `search.checks_left` bounds what a cycle may look at; what it does not suffice
for is not proven.
"""

import math

from compilation.jit import jit
from motion import segment
from rtloop.memory.motion import BLEND_SAMPLES
from rtloop.memory.state import Loop
from rtloop.trajectory.limits import hardest_rad_s2, highest_rad_s, keeps_room
from rtloop.trajectory.path import (
    end_s,
    fade,
    find_waypoint,
    goes_on_past_end,
    in_goal,
    plan,
    plan_coefficients,
    runs_on,
    sample,
    slot,
)

evaluate = jit(segment.evaluate)

LOOKS_A_CYCLE = 400
"""Spans and setpoints, of all joints at once, that a search for a way or a ramp may look at in one cycle."""
CYCLES_AFTER_BLEND = 2


@jit
def may_look(loop: Loop) -> bool:
    """Take one look from what the cycle may look at; False, and `search.checks_left` -1, when none is left."""
    loop.search.checks_left = max(loop.search.checks_left - 1, -1)
    return bool(loop.search.checks_left >= 0)


@jit
def look_from_here(loop: Loop) -> None:
    """Let the setpoint that is judged next be the one after the commanded one."""
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        axis.ahead.position_rad, axis.ahead.velocity_rad_s = (
            axis.commanded.position_rad,
            axis.commanded.difference_velocity_rad_s,
        )


@jit
def look_from(loop: Loop, path_index: int, clock_s: float, step_s: float, first: int) -> None:
    """Let the setpoint that is judged next be the one after that of a path time, at a steady step of the clock.

    `first` is a waypoint before it.
    """
    period_s = loop.params.period_ns * 1e-9
    before = find_waypoint(loop, path_index, clock_s - step_s, first)
    waypoint = find_waypoint(loop, path_index, clock_s, before)
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        p0, _, _ = sample(loop, path_index, joint, clock_s - step_s, before)
        p, _, _ = sample(loop, path_index, joint, clock_s, waypoint)
        axis.ahead.position_rad, axis.ahead.velocity_rad_s = p, (p - p0) / period_s


@jit
def next_keeps_limits(loop: Loop, path_index: int, clock_s: float, waypoint: int) -> bool:
    """Whether the next setpoint, at a path time, keeps velocity and acceleration after the one looked at before."""
    period_s = loop.params.period_ns * 1e-9
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        p, _, _ = sample(loop, path_index, joint, clock_s, waypoint)
        v = (p - axis.ahead.position_rad) / period_s
        a = (v - axis.ahead.velocity_rad_s) / period_s
        if not (abs(v) <= highest_rad_s(loop, joint) and abs(a) <= hardest_rad_s2(loop, joint)):
            return False  # or not a number
        axis.ahead.position_rad, axis.ahead.velocity_rad_s = p, v
    return True


@jit
def leaves_room(loop: Loop, path_index: int, clock_s: float) -> bool:
    """Whether every joint could be stopped inside its limits from the setpoint looked at last, at a path time.

    Behind the end of a stream there is room: its last point was judged by the way on which the arm stops there.
    """
    if runs_on(loop, path_index) and clock_s > end_s(loop, path_index):
        return True
    for joint in range(loop.params.joint_count):
        p, v = loop.axes[joint].ahead.position_rad, loop.axes[joint].ahead.velocity_rad_s
        if not keeps_room(loop, joint, p, p, v, v):
            return False
    return True


@jit
def span_end_s(loop: Loop, path_index: int, from_s: float, waypoint: int) -> float:
    """Path time up to which plan plus blend is one polynomial from `from_s` on, and a short part of the blend."""
    path = loop.paths[path_index]
    until_s = min(from_s + path.blend_s / BLEND_SAMPLES, path.entry_s + path.blend_s)
    if from_s < path.entry_s + path.fade_s:
        until_s = min(until_s, path.entry_s + path.fade_s)
    if waypoint < path.taken - 1:
        until_s = min(until_s, loop.waypoints[slot(path_index, waypoint + 1)].time_ns * 1e-9)
    return until_s


@jit
def span_keeps_limits(loop: Loop, path_index: int, rate: float, from_s: float, until_s: float, waypoint: int) -> bool:
    """Whether no setpoint in the span can break a limit at a steady rate, wherever in the span it lies.

    A polynomial of degree 5, its velocity and its acceleration lie between their Bézier points, which follow from the
    derivatives at both ends of the span.
    """
    path = loop.paths[path_index]
    start_s = loop.waypoints[slot(path_index, waypoint)].time_ns * 1e-9
    if from_s < start_s:
        return False
    if waypoint < path.taken - 1:
        if loop.waypoints[slot(path_index, waypoint + 1)].order == 1:
            return False  # the velocity jumps at the ends of a straight line
    elif runs_on(loop, path_index):
        return False
    last = loop.waypoints[slot(path_index, path.taken - 1)]
    stands = not runs_on(loop, path_index) and until_s >= last.time_ns * 1e-9
    period_s = loop.params.period_ns * 1e-9
    h = until_s - from_s
    for joint in range(loop.params.joint_count):
        if waypoint < path.taken - 1 and in_goal(loop, path_index, joint):
            c0, c1, c2, c3, c4, c5 = plan_coefficients(loop, path_index, joint, waypoint)
            p0, v0, a0 = evaluate(c0, c1, c2, c3, c4, c5, from_s - start_s)
            p1, v1, a1 = evaluate(c0, c1, c2, c3, c4, c5, until_s - start_s)
            j0, j1 = jerk(c3, c4, c5, from_s - start_s), jerk(c3, c4, c5, until_s - start_s)
        else:
            p0, v0, a0 = plan(loop, path_index, joint, from_s, waypoint)
            p1, v1, a1 = p0, v0, a0
            j0, j1 = 0.0, 0.0
        bp0, bv0, ba0, bj0 = blend_motion(loop, path_index, joint, from_s, from_s)
        bp1, bv1, ba1, bj1 = blend_motion(loop, path_index, joint, until_s, from_s)
        p0, v0, a0, j0 = p0 + bp0, v0 + bv0, a0 + ba0, j0 + bj0
        p1, v1, a1, j1 = p1 + bp1, v1 + bv1, a1 + ba1, j1 + bj1
        w1, w2, w3 = v0 + 0.25 * a0 * h, v0 + (0.5 * a0 + j0 * h / 12.0) * h, v1 - 0.25 * a1 * h
        slowest, fastest = rate * min(v0, w1, w2, w3, v1), rate * max(v0, w1, w2, w3, v1)
        hardest = rate * rate * max(abs(a0), abs(a0 + j0 * h / 3.0), abs(a1 - j1 * h / 3.0), abs(a1))
        if stands and in_goal(loop, path_index, joint):
            hardest += rate * abs(last.joints[joint].velocity_rad_s) / period_s  # a residue, which ends at once
        if not (max(-slowest, fastest) <= highest_rad_s(loop, joint) and hardest <= hardest_rad_s2(loop, joint)):
            return False
        q1, q2 = p0 + 0.2 * v0 * h, p0 + (0.4 * v0 + 0.05 * a0 * h) * h
        q3, q4 = p1 - (0.4 * v1 - 0.05 * a1 * h) * h, p1 - 0.2 * v1 * h
        lowest, highest = min(p0, q1, q2, q3, q4, p1), max(p0, q1, q2, q3, q4, p1)
        if not keeps_room(loop, joint, lowest, highest, slowest, fastest):
            return False
    return True


@jit
def jerk(c3: float, c4: float, c5: float, t: float) -> float:
    """Third derivative of a segment at time t from its start."""
    return 6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5)


@jit
def blend_motion(
    loop: Loop, path_index: int, joint: int, clock_s: float, from_s: float
) -> tuple[float, float, float, float]:
    """The blend and its first three derivatives at a path time, as they are in the span that begins at `from_s`."""
    path = loop.paths[path_index]
    if from_s >= path.entry_s + path.blend_s:
        return 0.0, 0.0, 0.0, 0.0
    b = path.blends[joint]
    t = clock_s - path.entry_s
    p, v, a = evaluate(b.c0, b.c1, b.c2, b.c3, b.c4, b.c5, t)
    j = jerk(b.c3, b.c4, b.c5, t)
    if from_s < path.entry_s + path.fade_s:
        fp, fv, fa = fade(b.faded, path.fade_s, t)
        p, v, a, j = p + fp, v + fv, a + fa, j - 2.0 * b.faded / path.fade_s * (1.0 - t / path.fade_s)
    return p, v, a, j


@jit
def blend_keeps_limits(loop: Loop, path_index: int, rate: float) -> bool:
    """Whether the setpoints from the next one to shortly after the blend keep the limits, entered now at `rate`.

    Goes on after the first `loop.search.judged` of them. When no more may be looked at, the answer is no and
    `loop.search.judged`, `loop.search.span_s` say how far it got.
    """
    search, path = loop.search, loop.paths[path_index]
    step_s = rate * loop.params.period_ns * 1e-9
    until_s = path.entry_s + path.blend_s
    count = math.ceil(path.blend_s / step_s) + CYCLES_AFTER_BLEND
    if not goes_on_past_end(loop, path_index):
        count = min(count, math.floor((end_s(loop, path_index) - path.entry_s) / step_s))
    judged = search.judged
    span_waypoint = waypoint = path.segment
    if judged > 0:
        span_s, last = search.span_s, judged
        look_from(loop, path_index, path.entry_s + judged * step_s, step_s, waypoint)
    else:
        span_s, last = path.entry_s, 1  # the first one leaves the old path
        look_from_here(loop)
    first, span_until_s = judged + 1, span_s
    while True:
        last = min(last, count)
        if judged + 1 < first <= last:
            judged = first - 1
            look_from(loop, path_index, path.entry_s + judged * step_s, step_s, waypoint)
        while judged < last:
            if not may_look(loop):
                search.judged, search.span_s = judged, span_s
                return False
            clock_s = path.entry_s + (judged + 1) * step_s
            waypoint = find_waypoint(loop, path_index, clock_s, waypoint)
            if not next_keeps_limits(loop, path_index, clock_s, waypoint):
                return False
            if not leaves_room(loop, path_index, clock_s):
                return False
            judged += 1
        # what comes before the last two setpoints judged is behind us
        span_s = max(span_until_s, path.entry_s + (judged - 1) * step_s)
        if span_s >= until_s or judged >= count:
            return True
        span_waypoint = find_waypoint(loop, path_index, span_s, span_waypoint)
        span_until_s = span_end_s(loop, path_index, span_s, span_waypoint)
        if span_until_s - span_s >= step_s:
            if not may_look(loop):
                search.judged, search.span_s = judged, span_s
                return False
            if span_keeps_limits(loop, path_index, rate, span_s, span_until_s, span_waypoint):
                continue
        # all setpoints whose differences reach into the span
        first = math.floor((span_s - path.entry_s) / step_s) + 1
        last = math.ceil((span_until_s - path.entry_s) / step_s) + 1


@jit
def rest_keeps_limits(loop: Loop, path_index: int, rate: float, from_s: float) -> bool:
    """Whether no setpoint from a path time to the end of the blend can break a limit at a rate, whatever its phase."""
    path = loop.paths[path_index]
    waypoint = path.segment
    while from_s < path.entry_s + path.blend_s:
        waypoint = find_waypoint(loop, path_index, from_s, waypoint)
        until_s = span_end_s(loop, path_index, from_s, waypoint)
        if not may_look(loop) or not span_keeps_limits(loop, path_index, rate, from_s, until_s, waypoint):
            return False
        from_s = until_s
    return True
