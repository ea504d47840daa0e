"""Entering a newer trajectory: the way from where the arm is commanded, at rest or in motion, onto its path.

The way is a blend, or for a goal whose first point is still ahead a segment that leads there. It is chosen once a
goal: rates from the wanted one down, and for each rate blends from short to long, are sampled at a fixed number of
instants, and those that keep the limits there are looked at from waypoint to waypoint or setpoint by setpoint
(`rtloop.trajectory.ahead`). The first that still keeps them is laid. How much of that fits into a cycle is bounded;
the search then goes on in the next one.
"""

from compilation.jit import jit
from motion import segment, stopping
from rtloop.memory.motion import BLEND_SAMPLES
from rtloop.memory.state import Loop
from rtloop.trajectory.ahead import LOOKS_A_CYCLE, blend_keeps_limits, rest_keeps_limits
from rtloop.trajectory.clock import IMPOSSIBLE, allowed_acceleration, set_rate
from rtloop.trajectory.limits import BESIDE_RAD, at_rest, band
from rtloop.trajectory.path import (
    end_s,
    fade,
    fade_duration_s,
    find_waypoint,
    goes_on_past_end,
    in_goal,
    line_beyond,
    plan,
    runs_on,
    sample,
    slot,
)
from rtloop.trajectory.phases import runs

decay = jit(segment.decay)
reach_s = jit(stopping.reach_s)

BLENDS_S = (0.3, 0.6, 1.2, 2.4)
STREAM_BLENDS_S = (0.1, 0.2, 0.4, 0.8)
"""A blend of T follows points without a time 0.6 T behind, so a stream gets the shortest one the limits allow."""
ENTRY_RATES = (1.0, 0.5, 0.25)
WAYS = 1 + len(BLENDS_S)
"""Tried with each rate: the approach segment, and the blends."""
ON_ITS_WAY, NO_WAY, NOT_YET_KNOWN = 0, 1, 2
SLOWEST_ENTRY_IN_MOTION = 0.2
SLOWEST_ENTRY = 0.02
"""A path is laid for at least such a rate, since a blend for next to none would last for ever."""
START_SHARE = 0.35
SPEED_HEADROOM = 0.99
"""Candidates are sampled, so they stay below the speed at which the last defence would stop the arm."""


@jit
def forget_search(loop: Loop) -> None:
    """What was found out about ways is of another goal."""
    loop.search.ways_tried = loop.search.judged = 0


@jit
def due_s(loop: Loop, path_index: int) -> float:
    """Path time at which a path would be entered now: its beginning, or where its start time says it is due."""
    path = loop.paths[path_index]
    if path.start_ns == 0:
        return 0.0
    due = max((loop.timing.now_ns - path.start_ns) * 1e-9, 0.0)
    return min(due, end_s(loop, path_index)) if path.ended == 1 else due


@jit
def asked_rate(loop: Loop, path_index: int) -> float:
    """The rate people asked for; a stream keeps its own time, which nothing but a factor of 0 stops."""
    if loop.paths[path_index].stream == 1 and loop.operator.speed_scale > 0.0:
        return 1.0
    return float(loop.operator.speed_scale)


@jit
def has_approach(loop: Loop, path_index: int, entry_s: float) -> bool:
    """Whether the first waypoint of the goal is still ahead, and the way to it begins where the arm is commanded."""
    path = loop.paths[path_index]
    return path.approach == 1 and path.taken > 1 and entry_s < loop.waypoints[slot(path_index, 1)].time_ns * 1e-9


@jit
def entry_distance(loop: Loop, path_index: int, entry_s: float) -> tuple[int, float]:
    """The joint that is farthest from the plan where it would be entered, and how far (rad)."""
    worst_joint, worst = -1, 0.0
    first = 0 if has_approach(loop, path_index, entry_s) else loop.paths[path_index].approach
    waypoint = find_waypoint(loop, path_index, entry_s, first)
    for joint in range(loop.params.joint_count):
        if in_goal(loop, path_index, joint):
            p, _, _ = plan(loop, path_index, joint, entry_s, waypoint)
            distance = abs(p - loop.axes[joint].commanded.position_rad)
            if distance >= worst:
                worst_joint, worst = joint, distance
    return worst_joint, worst


@jit
def enter(loop: Loop, path_index: int, entry_s: float) -> int:
    """Find a bounded way from the commanded state onto a path and lay it: ON_ITS_WAY, NO_WAY or NOT_YET_KNOWN.

    The first rate to be tried is the wanted one, or the higher one of a clock that is just slowing down: a blend made
    for a rate far below that of the motion would carry that motion on for ever. Slower ones follow, and longer blends
    after short ones. When the cycle may look at no more setpoints, the search goes on in the next one: for an arm at
    rest where it was, for one in motion with the same way seen from its new state; a way that takes more of them than
    a whole cycle may look at then counts as none. On success the path's clock stands where the way was judged from,
    which is `entry_s` unless that took several cycles, and runs at a rate that may differ from the wanted one for as
    long as the blend lasts, see `rate_while_blending`.
    """
    search = loop.search
    wanted = max(asked_rate(loop, path_index), SLOWEST_ENTRY)
    if runs(loop):
        wanted = max(wanted, loop.clock.rate, SLOWEST_ENTRY_IN_MOTION)
    stays = at_rest(loop)
    search.checks_left = LOOKS_A_CYCLE
    while search.ways_tried < len(ENTRY_RATES) * WAYS:
        rate = wanted * ENTRY_RATES[search.ways_tried // WAYS]
        if stays and search.judged > 0 and search.rate == rate:
            from_s = float(loop.paths[path_index].entry_s)  # what was judged began there
        else:
            from_s, search.judged = entry_s, 0
        search.rate = rate
        duration_s = lay_way(loop, path_index, rate, from_s, search.ways_tried % WAYS)
        if duration_s > 0.0:
            untouched = search.checks_left == LOOKS_A_CYCLE
            if blends_within_limits(loop, path_index, rate, from_s, duration_s):
                search.ways_tried = search.judged = 0
                begin_path(loop, path_index, rate)
                return ON_ITS_WAY
            if search.checks_left < 0:
                search.ways_tried += 1 if untouched and not stays else 0
                return NOT_YET_KNOWN
        search.ways_tried += 1
        search.judged = 0
    search.ways_tried = 0
    return NO_WAY


@jit
def lay_way(loop: Loop, path_index: int, rate: float, entry_s: float, way: int) -> float:
    """Prepare one of the ways that are tried with each rate; path time it takes (s), 0 for one that is not there.

    The first is the approach segment to a point that is still ahead, which spares a goal all others; blends follow.
    """
    stream = loop.paths[path_index].stream == 1
    approached = has_approach(loop, path_index, entry_s)
    if way == 0:
        if not approached:
            return 0.0
        lay_approach(loop, path_index, rate, entry_s)
        return float(loop.waypoints[slot(path_index, 1)].time_ns * 1e-9 - entry_s)
    if approached:
        if not stream:
            return 0.0
        lay_run_up(loop, path_index, entry_s)
        if entry_distance(loop, path_index, entry_s)[1] > loop.params.start_tolerance_rad:
            return 0.0
    return STREAM_BLENDS_S[way - 1] if stream else BLENDS_S[way - 1]


@jit
def blends_within_limits(loop: Loop, path_index: int, rate: float, entry_s: float, duration_s: float) -> bool:
    """Lay a blend and say whether it keeps the limits, as sampled and in each of its setpoints."""
    lay_blend(loop, path_index, rate, entry_s, duration_s)
    return blend_strain(loop, path_index, rate, entry_s) <= 1.0 and blend_keeps_limits(loop, path_index, rate)


@jit
def lay_approach(loop: Loop, path_index: int, rate: float, entry_s: float) -> None:
    """Let the path begin at the commanded state, so that its first segment is the way to the goal's first point."""
    first = loop.waypoints[slot(path_index, 0)]
    first.time_ns = round(entry_s * 1e9)
    for joint in range(loop.params.joint_count):
        axis, row = loop.axes[joint], first.joints[joint]
        row.position_rad = axis.commanded.position_rad
        row.velocity_rad_s = axis.commanded.velocity_rad_s / rate
        row.acceleration_rad_s2 = axis.commanded.acceleration_rad_s2 / (rate * rate)


@jit
def lay_run_up(loop: Loop, path_index: int, entry_s: float) -> None:
    """Let the path begin on the straight line that leads through the first point at its velocity.

    The points of a stream may lie only milliseconds ahead, too near to be reached exactly: what is between the
    arm and this line is then left to the blend.
    """
    first, second = loop.waypoints[slot(path_index, 0)], loop.waypoints[slot(path_index, 1)]
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
    path.from_rest = 1 if at_rest(loop) else 0
    path.fade_s = rate * fade_duration_s(loop.params.period_ns * 1e-9)
    waypoint = find_waypoint(loop, path_index, entry_s, 0)
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        v, a = axis.commanded.velocity_rad_s / rate, axis.commanded.acceleration_rad_s2 / (rate * rate)
        b = path.blends[joint]
        if not in_goal(loop, path_index, joint):
            # comes to rest half a blend's way ahead
            b.held_rad = axis.commanded.position_rad + 0.5 * v * duration_s
        p0, v0, a0 = plan(loop, path_index, joint, entry_s, waypoint)
        b.faded = a - a0
        fp, fv, _ = fade(b.faded, path.fade_s, 0.0)
        b.c0, b.c1, b.c2, b.c3, b.c4, b.c5 = decay(axis.commanded.position_rad - p0 - fp, v - v0 - fv, 0.0, duration_s)


@jit
def share_beside_plan(loop: Loop, path_index: int) -> float:
    """Share of the acceleration limit that a blend may add to a plan that uses all of it.

    A plan that begins with its whole acceleration needs some more from rest, since one cycle is lost.
    """
    return START_SHARE if loop.paths[path_index].from_rest == 1 else stopping.PLAN_SHARE


@jit
def blend_strain(loop: Loop, path_index: int, rate: float, from_s: float) -> float:
    """Largest ratio of velocity or acceleration to its limit from a path time to the blend's end; ≤ 1 keeps them.

    The first ratio above 1 ends the search.
    """
    entering = loop.paths[path_index]
    share = share_beside_plan(loop, path_index)
    until_s = entering.entry_s + entering.blend_s
    worst = 0.0
    waypoint = entering.segment  # the ones before may be overwritten
    known_s = end_s(loop, path_index)
    goes_on = goes_on_past_end(loop, path_index)
    approached = has_approach(loop, path_index, entering.entry_s)
    stands_s = known_s + stop_reach_s(loop, path_index)
    for i in range(BLEND_SAMPLES + 1):
        clock_s = from_s + (until_s - from_s) * i / BLEND_SAMPLES
        if clock_s > known_s and not goes_on:
            return IMPOSSIBLE
        waypoint = find_waypoint(loop, path_index, clock_s, waypoint)
        for joint in range(loop.params.joint_count):
            row = loop.joints[joint]
            _, planned_speed, planned = plan(loop, path_index, joint, clock_s, waypoint)
            p, v, a = sample(loop, path_index, joint, clock_s, waypoint)
            here = loop.axes[joint].commanded.position_rad  # a joint that was found outside may move in
            lowest_rad, highest_rad = band(row.lower_rad, row.upper_rad, row.slack_rad)
            low, high = min(lowest_rad, here), max(highest_rad, here)
            if clock_s > stands_s and in_goal(loop, path_index, joint):  # the arm will have stopped there
                p += (
                    plan(loop, path_index, joint, stands_s, waypoint)[0]
                    - plan(loop, path_index, joint, clock_s, waypoint)[0]
                )
            if p < low - BESIDE_RAD or p > high + BESIDE_RAD:
                return IMPOSSIBLE
            fastest = SPEED_HEADROOM * loop.params.velocity_margin * row.max_velocity_rad_s
            if not approached:
                fastest = max(fastest, abs(planned_speed))  # what the goal's own points ask for was checked exactly
            speed = rate * abs(v) / fastest
            allowed = allowed_acceleration(loop, joint, rate * rate * planned, stopping.ORDERLY, share)
            push = rate * rate * abs(a) / allowed
            if not (speed <= IMPOSSIBLE and push <= IMPOSSIBLE):
                return IMPOSSIBLE  # not a number
            worst = max(worst, speed, push)
        if worst > 1.0:
            return worst
    return worst


@jit
def stop_reach_s(loop: Loop, path_index: int) -> float:
    """Path time beyond the end of a stream at which the arm stands if nothing newer comes; 0 for other goals."""
    path = loop.paths[path_index]
    if not runs_on(loop, path_index):
        return 0.0
    last = loop.waypoints[slot(path_index, path.taken - 1)]
    period_s = loop.params.period_ns * 1e-9
    fade_s = fade_duration_s(period_s)
    to_brake_s = 0.0
    for joint in range(loop.params.joint_count):
        if in_goal(loop, path_index, joint):
            braking = stopping.ORDERLY * loop.joints[joint].max_acceleration_rad_s2
            row = last.joints[joint]
            _, velocity = line_beyond(row.position_rad, row.velocity_rad_s, row.acceleration_rad_s2, fade_s)
            to_brake_s = max(to_brake_s, abs(velocity) / braking)
    return reach_s(to_brake_s, loop.params.longest_stop_s, period_s)


@jit
def begin_path(loop: Loop, path_index: int, rate: float) -> None:
    """Run this path from now on, from where it was entered."""
    goals = loop.goals
    goals.active = path_index
    loop.clock.time_s = loop.paths[path_index].entry_s
    goals.entry_rate = rate
    goals.arriving = 0
    loop.paths[path_index].segment = 0
    set_rate(loop, rate)


@jit
def rate_while_blending(loop: Loop, wanted: float) -> float:
    """The wanted rate, or that of the entry as long as the rest of the blend would be too fast with more.

    A blend that begins in motion carries the joints' velocity divided by the rate, so it is made for its rate.
    """
    goals, clock = loop.goals, loop.clock
    entered = loop.paths[goals.active]
    blending = clock.time_s < entered.entry_s + entered.blend_s
    if not blending or wanted <= goals.entry_rate:
        return wanted
    keeps = blend_strain(loop, goals.active, wanted, clock.time_s) <= 1.0
    if keeps and rest_keeps_limits(loop, goals.active, wanted, clock.time_s):
        return wanted
    return float(goals.entry_rate)
