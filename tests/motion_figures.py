"""Figures of true motion, computed from the simulated drives' own history and from nothing of ours.

A drive changes its speed in whole rpm, so its velocity is a staircase: an acceleration only has meaning over
a window. `accelerations` differences velocity averages of adjoining windows, which is the slope of the least
squares line through the position of a double window up to a constant factor near one.
"""

import numpy as np

STEP_NS = 500_000
WINDOW_S = 0.020


def sampled_truth(sim, joint: int, start_ns: int, end_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """times_ns, position_rad, velocity_rad_s every half millisecond."""
    times_ns = np.arange(start_ns, end_ns, STEP_NS)
    position_rad, velocity_rad_s = sim.truth(joint, times_ns)
    return times_ns, position_rad, velocity_rad_s


def accelerations(position_rad: np.ndarray, window_s: float = WINDOW_S) -> np.ndarray:
    """Acceleration over two adjoining windows: (mean velocity of the later - of the earlier) / window."""
    width = round(window_s * 1e9 / STEP_NS)
    mean_velocity = (position_rad[width:] - position_rad[:-width]) / window_s
    return (mean_velocity[width:] - mean_velocity[:-width]) / window_s


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
