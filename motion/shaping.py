"""Following a target that may ask for more than the limits allow: as closely as velocity and acceleration permit.

One step of constant acceleration at a time. Seen from the target, a joint that is a gap g behind closes it with the
highest speed w from which it can still brake beside the target, within w² / 2b at the braking b. A small gap takes two
steps, after which position and velocity are the target's. Of the velocity that this wants, the joint gets what the
limits of velocity, position and acceleration leave. Leaf functions that numpy broadcasts; units: rad, rad/s, rad/s², s.
"""

import numpy as np

CLOSING_SHARE = 0.5
"""Share of the acceleration with which a gap is closed; the rest is for the target's own changes of velocity."""

Array = np.ndarray


def fastest_towards(room: Array, velocity: Array, braking: Array, step_s: float) -> Array:
    """Highest velocity after a step from which `braking` ends within `room`, for a joint that has `velocity` now.

    Either at the step's end, v' h / 2 + v'² / 2b ≤ room - v h / 2, or within it, v² / 2 |a| ≤ room. Without room it is
    braked as hard as can be, and not turned round.
    """
    left = room - 0.5 * step_s * velocity
    half = 0.5 * braking * step_s
    at_its_end = np.sqrt(half * half + 2.0 * braking * np.maximum(left, 0.0)) - half
    with np.errstate(divide="ignore", invalid="ignore"):
        within = velocity - step_s * velocity * velocity / (2.0 * room)
    without = np.maximum(velocity - braking * step_s, 0.0)
    fastest: Array = np.where(left >= 0.0, at_its_end, np.where(room > 0.0, within, without))
    return fastest


def next_velocity(
    position: Array,
    velocity: Array,
    target: Array,
    target_velocity: Array,
    limits: tuple[Array, Array, Array, Array],
    step_s: float,
) -> Array:
    """The velocity to have after a step, reached at constant acceleration; target and its velocity are those then.

    `limits`: lower and upper position, velocity, acceleration. All of them are kept by a joint from whose state they
    can be; from any other the acceleration is, and the way back is the shortest.
    """
    lower, upper, fastest, acceleration = limits
    gap = target - position - 0.5 * step_s * (velocity + target_velocity)
    closing = np.minimum(
        fastest_towards(np.abs(gap), np.zeros_like(gap), CLOSING_SHARE * acceleration, step_s), np.abs(gap) / step_s
    )
    wanted = np.clip(target_velocity + np.copysign(closing, gap), -fastest, fastest)
    up = fastest_towards(upper - position, velocity, acceleration, step_s)
    down = fastest_towards(position - lower, -velocity, acceleration, step_s)
    wanted = np.minimum(np.maximum(wanted, -down), up)
    change = acceleration * step_s
    following: Array = np.clip(wanted, velocity - change, velocity + change)
    return following
