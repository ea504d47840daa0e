"""The limits of a joint as one rule, which is asked before a motion and again while it runs.

The ROS process asks `first_broken` of all points of a trajectory at once, with arrays, and makes a sentence of the
answer. The control process asks it of one trajectory point or setpoint, compiled, and stops. A comparison with NaN is
false, so what is no number is inside no limit. Leaf functions; units: rad, rad/s, rad/s².
"""

from motion.segment import Number

POSITION, VELOCITY, ACCELERATION, NONE = 0, 1, 2, 3
"""What `first_broken` answers."""
ROUNDING = 1e-6
"""Share of a limit by which differences of setpoints may exceed it: they are rounded, and differenced twice."""
ROUNDING_AHEAD = 0.5 * ROUNDING
"""The same where a trajectory is judged before it runs, so that what passes there passes later too."""


def band(lower_rad: Number, upper_rad: Number, slack_rad: Number) -> tuple[Number, Number]:
    """Lowest and highest position that a joint may be told; `slack_rad` is what rounding puts it beyond its limits."""
    return lower_rad - slack_rad, upper_rad + slack_rad


def first_broken(
    position_rad: Number,
    velocity_rad_s: Number,
    acceleration_rad_s2: Number,
    lowest_rad: Number,
    highest_rad: Number,
    max_velocity_rad_s: Number,
    max_acceleration_rad_s2: Number,
) -> Number:
    """The first limit that a motion state of a joint breaks: POSITION, VELOCITY, ACCELERATION or NONE.

    All arguments are scalars, or arrays that broadcast against each other, as does the answer. A value at its limit
    is inside.
    """
    inside = (lowest_rad <= position_rad) & (position_rad <= highest_rad)
    slow = abs(velocity_rad_s) <= max_velocity_rad_s
    gentle = abs(acceleration_rad_s2) <= max_acceleration_rad_s2
    return inside * (1 + slow * (1 + gentle))
