"""Polynomial segments between two waypoints: coefficients and evaluation.

Every segment is six coefficients c0…c5 of p(t) = c0 + c1 t + … + c5 t⁵, t in seconds from the segment's
start, whatever its order: the lower orders leave the upper coefficients at zero. All functions are leaves
on scalars or arrays of one shape (numba compiles them, numpy broadcasts them) and allocate nothing on
scalars. Units: rad, rad/s, rad/s², s.

The formulas are the Hermite interpolation conditions solved by hand: the polynomial of least degree with
the given position (and velocity, and acceleration) at t = 0 and t = duration.
"""

from typing import Any

Number = Any  # float in jitted code, float or array in numpy


def linear(p0: Number, p1: Number, duration_s: Number) -> tuple[Number, ...]:
    """Coefficients of the straight line from p0 to p1; duration_s > 0."""
    zero = p0 * 0.0
    return p0, (p1 - p0) / duration_s, zero, zero, zero, zero


def cubic(p0: Number, v0: Number, p1: Number, v1: Number, duration_s: Number) -> tuple[Number, ...]:
    """Coefficients of the cubic with the given positions and velocities at both ends; duration_s > 0."""
    zero = p0 * 0.0
    slope = (p1 - p0) / duration_s
    c2 = (3.0 * slope - 2.0 * v0 - v1) / duration_s
    c3 = (v0 + v1 - 2.0 * slope) / (duration_s * duration_s)
    return p0, v0, c2, c3, zero, zero


def quintic(
    p0: Number, v0: Number, a0: Number, p1: Number, v1: Number, a1: Number, duration_s: Number
) -> tuple[Number, ...]:
    """Coefficients of the quintic with given position, velocity, acceleration at both ends; duration_s > 0."""
    t = duration_s
    distance = p1 - p0 - (v0 + 0.5 * a0 * t) * t  # what constant initial acceleration leaves to be covered
    speed = (v1 - v0 - a0 * t) * t
    bend = (a1 - a0) * t * t
    t3 = t * t * t
    c3 = (10.0 * distance - 4.0 * speed + 0.5 * bend) / t3
    c4 = (-15.0 * distance + 7.0 * speed - bend) / (t3 * t)
    c5 = (6.0 * distance - 3.0 * speed + 0.5 * bend) / (t3 * t * t)
    return p0, v0, 0.5 * a0, c3, c4, c5


def evaluate(
    c0: Number, c1: Number, c2: Number, c3: Number, c4: Number, c5: Number, t: Number
) -> tuple[Number, Number, Number]:
    """Position, velocity and acceleration of a segment at time t from its start."""
    position = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
    velocity = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
    acceleration = 2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
    return position, velocity, acceleration


def decay(position: Number, velocity: Number, acceleration: Number, duration_s: Number) -> tuple[Number, ...]:
    """The quintic that starts at the given offset and is exactly nothing (and at rest) after duration_s.

    A plan plus such an offset starts where the arm is commanded and ends on the plan: the blend.
    """
    t = duration_s
    c3 = -(10.0 * position + (6.0 * velocity + 1.5 * acceleration * t) * t) / (t * t * t)
    c4 = (15.0 * position + (8.0 * velocity + 1.5 * acceleration * t) * t) / (t * t * t * t)
    c5 = -(6.0 * position + (3.0 * velocity + 0.5 * acceleration * t) * t) / (t * t * t * t * t)
    return position, velocity, 0.5 * acceleration, c3, c4, c5


def fade(acceleration: Number, duration_s: Number, t: Number) -> tuple[Number, Number, Number]:
    """Position, velocity, acceleration of an offset whose acceleration fades from a given value, 0 ≤ t ≤ duration.

    acceleration · (1 - t/T)², integrated twice from its end, so that everything vanishes at T. A difference
    in acceleration alone would make `decay` overshoot by a third; faded quickly first, what it leaves in
    velocity and position is small and can decay slowly.
    """
    left = 1.0 - t / duration_s
    square = left * left
    return (
        acceleration * duration_s * duration_s / 12.0 * square * square,
        -acceleration * duration_s / 3.0 * square * left,
        acceleration * square,
    )
