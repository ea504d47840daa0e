"""Velocities at waypoints that came without any: monotone cubic slopes.

Straight lines between waypoints ask for a jump of velocity at each of them. The slopes here make a cubic
through the same positions that keeps the shape of the data: between two waypoints it never leaves the interval
of their positions, so a joint limit that the waypoints respect is respected in between. The rule is the weighted
harmonic mean of the neighbouring secants (F. N. Fritsch and J. Butland, "A method for constructing local
monotone piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5, 1984), with rest at both ends.
"""

import numpy as np


def monotone(times_s: np.ndarray, positions_rad: np.ndarray) -> np.ndarray:
    """Slopes (rad/s) at every waypoint, zero at the first and the last.

    `times_s` (n,) rises strictly, `positions_rad` is (n, joints); the result has the shape of the positions.
    """
    slopes = np.zeros_like(positions_rad, dtype=float)
    if len(times_s) < 3:
        return slopes
    durations = np.diff(times_s)[:, np.newaxis]
    secants = np.diff(positions_rad, axis=0) / durations
    before, after = secants[:-1], secants[1:]
    weight_before = durations[:-1] + 2.0 * durations[1:]
    weight_after = 2.0 * durations[:-1] + durations[1:]
    same_way = np.sign(before) * np.sign(after) > 0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mean = (weight_before + weight_after) / (weight_before / before + weight_after / after)
    slopes[1:-1] = np.where(same_way, mean, 0.0)
    return slopes
