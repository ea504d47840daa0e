"""The ramp of a stepper drive (ZDT, MKS), which is one byte, and what follows from it alone.

The speed changes by 1 rpm every (256 - acc) * 50 µs, that is by 20000 / (256 - acc) motor rpm per second; acc 0 means
no ramp (ZDT Emm_V5 manual, command FD; MKS SERVO42D/57D_CAN manual V1.0.6, 6.1).
"""

from __future__ import annotations

import math
from functools import lru_cache

RAMP_RPM_S = 20_000.0
"""Ramp of acc byte 255, in motor rpm per second; every smaller byte is a whole fraction of it."""

ACC_BYTES = range(1, 256)
"""Bytes that ask for a ramp; 0 would ask for none."""

SILENCE_FACTOR_RANGE = (1.5, 2.0)
"""Braking of a drive that hears nothing more, as multiples of its joint's acceleration limit."""

_RAD_S_PER_RPM = 2.0 * math.pi / 60.0


def ramp_rpm_s(acc_byte: int) -> float:
    """Ramp of the drive for an acc byte of 1 to 255, in motor rpm per second."""
    if acc_byte not in ACC_BYTES:
        raise ValueError(f"acc byte is {acc_byte}; a ramp needs 1 to 255")
    return RAMP_RPM_S / (256 - acc_byte)


def ramp_rad_s2(ratio: float, acc_byte: int) -> float:
    """The same ramp as the joint sees it, in rad/s²; `ratio` is motor turns per joint turn."""
    return ramp_rpm_s(acc_byte) * _RAD_S_PER_RPM / ratio


def smallest_acc_byte(ratio: float, acceleration_rad_s2: float) -> int | None:
    """The gentlest acc byte whose ramp reaches the acceleration, or None when even 255 does not."""
    for acc_byte in ACC_BYTES:
        if ramp_rad_s2(ratio, acc_byte) >= acceleration_rad_s2:
            return acc_byte
    return None


@lru_cache(maxsize=256)
def nearest_silence_byte(ratio: float, acceleration_rad_s2: float, factor: float) -> int | None:
    """The acc byte that brakes nearest to `factor` times the acceleration limit.

    None when no byte brakes between 1.5 and 2 times the limit: the drive's steps are too coarse for very
    high limits and its gentlest ramp too steep for very low ones.
    """
    lowest, highest = SILENCE_FACTOR_RANGE
    best: int | None = None
    best_distance = math.inf
    for acc_byte in ACC_BYTES:
        reached = ramp_rad_s2(ratio, acc_byte) / acceleration_rad_s2
        if lowest <= reached <= highest and abs(reached - factor) < best_distance:
            best, best_distance = acc_byte, abs(reached - factor)
    return best


def nearest_usable_acceleration_rad_s2(ratio: float, acceleration_rad_s2: float) -> float:
    """The acceleration limit nearest to the given one for which a silence byte exists (rad/s²)."""
    lowest, highest = SILENCE_FACTOR_RANGE
    best = math.inf
    for acc_byte in ACC_BYTES:
        ramp = ramp_rad_s2(ratio, acc_byte)
        usable = min(max(acceleration_rad_s2, ramp / highest), ramp / lowest)
        if abs(usable - acceleration_rad_s2) < abs(best - acceleration_rad_s2):
            best = usable
    return best


def coast_rad(velocity_rad_s: float, deceleration_rad_s2: float) -> float:
    """Way from this velocity to standstill at constant deceleration: v² / 2a (rad)."""
    return velocity_rad_s * velocity_rad_s / (2.0 * deceleration_rad_s2)


def stop_time_s(velocity_rad_s: float, deceleration_rad_s2: float) -> float:
    """Time from this velocity to standstill at constant deceleration: v / a (s)."""
    return abs(velocity_rad_s) / deceleration_rad_s2
