"""Arriving: how the clock comes to rest exactly where a path ends that still moves at its last point.

Such an end is not passed: the rate is lowered in time, by the ramp that uses up just the path that is left.
"""

import math

from compilation.jit import jit
from motion.stopping import ORDERLY
from rtloop.memory.state import Loop
from rtloop.trajectory.clock import begin_ramp, ramp_duration
from rtloop.trajectory.path import end_s

ARRIVED_S = 1e-6
ARRIVAL_SHARE = 0.25
"""Getting to the full rate and back to rest takes less path time than this share of the longest stop."""
SLOW_RATE = 0.25
"""A stop from less than that, even while it rises, reaches less far than one from the full rate."""


@jit
def slow_down_to_arrive(loop: Loop) -> None:
    """Begin the ramp that ends at rest exactly where the path does, as late as the limits allow.

    Along a ramp from rate s with slope u to zero within T the clock advances T (s / 2 + u T / 12), so the path that
    is left decides T; it begins when T is longer than the shortest stop by no more than two cycles make of it.
    """
    goals, clock = loop.goals, loop.clock
    left_s = end_s(loop, goals.active) - clock.time_s
    if left_s <= ARRIVED_S and clock.rate == 0.0:
        goals.arriving = 1
    if clock.rate_target == 0.0 or clock.rate <= 0.0 or left_s <= 0.0:
        return
    if left_s > 0.5 * clock.rate * loop.params.longest_stop_s:
        return
    discriminant = 0.25 * clock.rate * clock.rate + clock.slope * left_s / 3.0
    if discriminant < 0.0:
        return  # a rate that falls so steeply stops before the end; it is about to turn
    shortest_s, _ = ramp_duration(loop, 0.0, ORDERLY)
    duration_s = 2.0 * left_s / (0.5 * clock.rate + math.sqrt(discriminant))
    if duration_s <= shortest_s + 4.0 * loop.params.period_ns * 1e-9:
        goals.arriving = 1
        begin_ramp(loop, 0.0, duration_s, ORDERLY)


@jit
def rate_with_room_to_arrive(loop: Loop, wanted: float) -> float:
    """The rate that may be sped up to when the path ends soon, and at rest: what is left must do for both ramps."""
    left_s = end_s(loop, loop.goals.active) - loop.clock.time_s
    return min(wanted, max(loop.clock.rate_target, left_s / (ARRIVAL_SHARE * loop.params.longest_stop_s)))


@jit
def rate_that_settles(loop: Loop, wanted: float) -> float:
    """The rate that may be sped up to on a stream that may run out in motion: it must be steady before the end.

    From a rate that still rises a stop reaches farther than from the same one when it is steady, and how far it may
    reach was judged for a steady one. SLOW_RATE is always allowed, so that a stream held near its end goes on.
    """
    clock = loop.clock
    if wanted <= clock.rate_target:
        return wanted
    duration_s, _ = ramp_duration(loop, wanted, ORDERLY)
    advance_s = duration_s * (0.5 * (clock.rate + wanted) + clock.slope * duration_s / 12.0)
    if clock.time_s + advance_s <= end_s(loop, loop.goals.active):
        return wanted
    return max(clock.rate_target, min(wanted, SLOW_RATE))


@jit
def has_arrived(loop: Loop) -> bool:
    """Whether the ramp that ends where the path does is over; puts the clock right there."""
    goals, clock = loop.goals, loop.clock
    if goals.arriving == 0 or clock.ramp_s > 0.0 or clock.rate > 0.0:
        return False
    left_s = end_s(loop, goals.active) - clock.time_s
    if abs(left_s) > ARRIVED_S:
        goals.arriving = 0  # it was turned round on the way
        return False
    clock.time_s = end_s(loop, goals.active)
    return True
