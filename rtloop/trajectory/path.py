"""A path of the arm: the plan in its window of waypoints, and the blend at its beginning.

The blend is a polynomial of path time that starts as the difference between where the arm is commanded and where
the plan begins, and decays to nothing. The arm follows plan(clock) + blend(clock), sampled here at whatever time the
trajectory clock shows (`rtloop.trajectory.clock`). How a blend is chosen is told in `rtloop.trajectory.entry`.
"""

from compilation.jit import jit
from motion import segment, stopping
from rtloop.memory.motion import WINDOW_WAYPOINTS
from rtloop.memory.state import Loop
from shm.layout import SetpointJoint

linear = jit(segment.linear)
cubic = jit(segment.cubic)
quintic = jit(segment.quintic)
evaluate = jit(segment.evaluate)
fade = jit(segment.fade)
fade_duration_s = jit(stopping.fade_duration_s)
line_beyond = jit(stopping.line_beyond)

REST_RAD_S = 1e-3
"""A last point that is slower is meant to be at rest: planners leave residues."""


@jit
def slot(path_index: int, waypoint: int) -> int:
    """Place of a path's waypoint in the two windows."""
    return path_index * WINDOW_WAYPOINTS + (waypoint & (WINDOW_WAYPOINTS - 1))


@jit
def in_goal(loop: Loop, path_index: int, joint: int) -> bool:
    return (loop.paths[path_index].joint_mask >> joint) & 1 == 1


@jit
def end_s(loop: Loop, path_index: int) -> float:
    """Path time of the newest waypoint."""
    taken = loop.paths[path_index].taken
    if taken == 0:
        return 0.0
    return loop.waypoints[slot(path_index, taken - 1)].time_ns * 1e-9


@jit
def leaves_a_joint_moving(loop: Loop, path_index: int) -> bool:
    """Whether the newest waypoint of a path leaves a joint of its goal in motion."""
    path = loop.paths[path_index]
    if path.taken == 0:
        return False
    last = loop.waypoints[slot(path_index, path.taken - 1)]
    for joint in range(loop.params.joint_count):
        if in_goal(loop, path_index, joint) and abs(last.joints[joint].velocity_rad_s) > REST_RAD_S:
            return True
    return False


@jit
def goes_on_past_end(loop: Loop, path_index: int) -> bool:
    """Whether the clock may pass the last waypoint: the plan then stands there, or runs on straight as a stream's."""
    path = loop.paths[path_index]
    return path.ended == 1 and (path.stream == 1 or path.ends_moving == 0)


@jit
def runs_on(loop: Loop, path_index: int) -> bool:
    """Whether the plan runs on straight beyond its newest waypoint: a stream's does that ends in motion."""
    path = loop.paths[path_index]
    return path.stream == 1 and path.ends_moving == 1


@jit
def is_reached(loop: Loop, path_index: int, waypoint: int, clock_s: float) -> bool:
    """Whether a path has the waypoint already and the clock has come to it."""
    if waypoint >= loop.paths[path_index].taken:
        return False
    return bool(loop.waypoints[slot(path_index, waypoint)].time_ns * 1e-9 <= clock_s)


@jit
def find_waypoint(loop: Loop, path_index: int, clock_s: float, first: int) -> int:
    """The waypoint at the start of the segment that contains clock_s, searched forward from `first`.

    The steps double until they go too far and are halved from there, for a window holds thousands of waypoints and the
    one in question is mostly among the next.
    """
    waypoint, step = first, 1
    while is_reached(loop, path_index, waypoint + step, clock_s):
        waypoint += step
        step *= 2
    while step > 1:
        step //= 2
        if is_reached(loop, path_index, waypoint + step, clock_s):
            waypoint += step
    return waypoint


@jit
def plan(loop: Loop, path_index: int, joint: int, clock_s: float, waypoint: int) -> tuple[float, float, float]:
    """Position and its first two derivatives by path time of the plan alone; `waypoint` from find_waypoint.

    Before the first waypoint the plan stands at it, after the newest it stands there; a stream runs on straight.
    """
    if not in_goal(loop, path_index, joint):
        return loop.paths[path_index].blends[joint].held_rad, 0.0, 0.0
    start = loop.waypoints[slot(path_index, waypoint)]
    a = start.joints[joint]
    start_s = start.time_ns * 1e-9
    if waypoint >= loop.paths[path_index].taken - 1 or clock_s < start_s:
        if runs_on(loop, path_index) and clock_s >= start_s:
            return straight_on(loop, a, clock_s - start_s)
        return a.position_rad, 0.0, 0.0
    c0, c1, c2, c3, c4, c5 = plan_coefficients(loop, path_index, joint, waypoint)
    return evaluate(c0, c1, c2, c3, c4, c5, clock_s - start_s)


@jit
def plan_coefficients(loop: Loop, path_index: int, joint: int, waypoint: int) -> tuple[float, ...]:
    """The polynomial of the plan between a waypoint and the next one, in time since the waypoint (`motion.segment`)."""
    start, end = loop.waypoints[slot(path_index, waypoint)], loop.waypoints[slot(path_index, waypoint + 1)]
    a, b = start.joints[joint], end.joints[joint]
    duration_s = (end.time_ns - start.time_ns) * 1e-9
    if end.order == 5:
        return quintic(
            a.position_rad,
            a.velocity_rad_s,
            a.acceleration_rad_s2,
            b.position_rad,
            b.velocity_rad_s,
            b.acceleration_rad_s2,
            duration_s,
        )
    if end.order == 3:
        return cubic(a.position_rad, a.velocity_rad_s, b.position_rad, b.velocity_rad_s, duration_s)
    return linear(a.position_rad, b.position_rad, duration_s)


@jit
def straight_on(loop: Loop, last: SetpointJoint, t: float) -> tuple[float, float, float]:
    """Beyond the last point of a stream, t ≥ 0 s after it: its acceleration fades, its velocity stays."""
    fade_s = fade_duration_s(loop.params.period_ns * 1e-9)
    p, v, a = fade(last.acceleration_rad_s2, fade_s, min(t, fade_s))
    p0, v0 = line_beyond(last.position_rad, last.velocity_rad_s, last.acceleration_rad_s2, fade_s)
    return p0 + v0 * t + p, v0 + v, a


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
def sample(loop: Loop, path_index: int, joint: int, clock_s: float, waypoint: int) -> tuple[float, float, float]:
    """Plan plus blend: position and its first two derivatives by path time."""
    p, v, a = plan(loop, path_index, joint, clock_s, waypoint)
    bp, bv, ba = blend(loop, path_index, joint, clock_s)
    return p + bp, v + bv, a + ba
