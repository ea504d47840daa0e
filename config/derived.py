"""Figures that follow from a joint's configuration: ramps, braking, coast, and the table of them all.

The ramp of a ZDT drive is one byte: the speed changes by 1 rpm every (256 - acc) * 50 µs, that is by
20000 / (256 - acc) motor rpm per second; acc 0 means no ramp (ZDT Emm_V5 manual, command FD).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the schema checks its joints with these functions, so it is imported for types only
    from config.joint import JointConfig
    from config.schema import ArmConfig, LimitsConfig

RAMP_RPM_S = 20_000.0
"""Ramp of acc byte 255, in motor rpm per second; every smaller byte is a whole fraction of it."""

ACC_BYTES = range(1, 256)
"""Bytes that ask for a ramp; 0 would ask for none."""

SILENCE_FACTOR_RANGE = (1.5, 2.0)
"""Braking of a drive that hears nothing more, as multiples of its joint's acceleration limit."""

LEAD_PERIODS = 1.0
"""Periods of motion by which a target sent with FD leads the next setpoint, braking distance apart; with FC none.

A drive that hears nothing more therefore goes on for one period to the next setpoint, for this lead, and then brakes.
"""

_RAD_S_PER_RPM = 2.0 * math.pi / 60.0


def ramp_rpm_s(acc_byte: int) -> float:
    """Ramp of a ZDT drive for an acc byte of 1 to 255, in motor rpm per second."""
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


def acc_byte(joint: JointConfig) -> int:
    """The smallest acc byte with which a ZDT joint reaches its acceleration limit."""
    found = smallest_acc_byte(joint.ratio, joint.max_acceleration_rad_s2)
    if found is None:
        raise ValueError(f"no acc byte lets {joint.name} reach {joint.max_acceleration_rad_s2:g} rad/s²")
    return found


def silence_acc_byte(joint: JointConfig, limits: LimitsConfig) -> int:
    """The acc byte each motion frame of a ZDT joint carries, so that silence is a controlled stop.

    With it the drive, when it hears nothing more, brakes by itself at 1.5 to 2 times the joint's
    acceleration limit, nearest to `limits.silence_brake_factor`. The schema has made sure that it exists.
    """
    found = nearest_silence_byte(joint.ratio, joint.max_acceleration_rad_s2, limits.silence_brake_factor)
    if found is None:
        raise ValueError(f"no acc byte brakes {joint.name} between 1.5 and 2 times its acceleration limit")
    return found


def braking_deceleration_rad_s2(joint: JointConfig, acc_byte: int) -> float:
    """Deceleration of the joint when its ZDT drive ramps down with this acc byte (rad/s²)."""
    return ramp_rad_s2(joint.ratio, acc_byte)


def coast_rad(velocity_rad_s: float, deceleration_rad_s2: float) -> float:
    """Way from this velocity to standstill at constant deceleration: v² / 2a (rad)."""
    return velocity_rad_s * velocity_rad_s / (2.0 * deceleration_rad_s2)


def stop_time_s(velocity_rad_s: float, deceleration_rad_s2: float) -> float:
    """Time from this velocity to standstill at constant deceleration: v / a (s)."""
    return abs(velocity_rad_s) / deceleration_rad_s2


@dataclass(frozen=True)
class SilenceStop:
    """What a ZDT drive does at full speed when it hears nothing more, from the last frame it heard."""

    acc_byte: int
    deceleration_rad_s2: float
    factor: float
    """Deceleration as a multiple of the joint's acceleration limit."""
    coast_deg: float
    stop_time_s: float


@dataclass(frozen=True)
class DerivedJoint:
    """One row of the derived table: everything that follows from a joint's entry in the arm file."""

    name: str
    lower_deg: float
    upper_deg: float
    lower_rad: float
    upper_rad: float
    max_velocity_rad_s: float
    max_velocity_deg_s: float
    max_acceleration_rad_s2: float
    command_pulses_per_rad: float
    encoder_counts_per_rad: float
    command_pulse_deg: float
    encoder_count_deg: float
    acc_byte: int | None
    """Smallest byte that reaches the acceleration limit; None for a drive without a ramp byte."""
    silence: SilenceStop | None
    """None for a drive that has no ramp of its own (mock)."""


def derived_table(arm: ArmConfig) -> list[DerivedJoint]:
    """The derived figures of every joint, in the order of the arm file."""
    return [_derive(joint, arm) for joint in arm.joints]


def _derive(joint: JointConfig, arm: ArmConfig) -> DerivedJoint:
    has_ramp = joint.drive.family == "zdt"
    return DerivedJoint(
        name=joint.name,
        lower_deg=joint.lower_deg,
        upper_deg=joint.upper_deg,
        lower_rad=joint.lower_rad,
        upper_rad=joint.upper_rad,
        max_velocity_rad_s=joint.max_velocity_rad_s,
        max_velocity_deg_s=math.degrees(joint.max_velocity_rad_s),
        max_acceleration_rad_s2=joint.max_acceleration_rad_s2,
        command_pulses_per_rad=joint.command_pulses_per_rad,
        encoder_counts_per_rad=joint.encoder_counts_per_rad,
        command_pulse_deg=math.degrees(joint.command_pulse_rad),
        encoder_count_deg=math.degrees(joint.encoder_count_rad),
        acc_byte=acc_byte(joint) if has_ramp else None,
        silence=_silence_stop(joint, arm) if has_ramp else None,
    )


def _silence_stop(joint: JointConfig, arm: ArmConfig) -> SilenceStop:
    byte = silence_acc_byte(joint, arm.limits)
    goes_on_s = (1.0 if arm.bus.fast_targets else 1.0 + LEAD_PERIODS) * arm.control.period_ns * 1e-9
    deceleration = braking_deceleration_rad_s2(joint, byte)
    return SilenceStop(
        acc_byte=byte,
        deceleration_rad_s2=deceleration,
        factor=deceleration / joint.max_acceleration_rad_s2,
        coast_deg=math.degrees(
            joint.max_velocity_rad_s * goes_on_s + coast_rad(joint.max_velocity_rad_s, deceleration)
        ),
        stop_time_s=goes_on_s + stop_time_s(joint.max_velocity_rad_s, deceleration),
    )
