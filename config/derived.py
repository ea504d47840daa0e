"""Figures that follow from a joint's configuration: ramps, braking, coast, and the table of them all."""

from __future__ import annotations

import math
from dataclasses import dataclass

from config.joint import JointConfig
from config.ramp import coast_rad, nearest_silence_byte, ramp_rad_s2, smallest_acc_byte, stop_time_s
from config.schema import ArmConfig
from config.sections import LimitsConfig

LEAD_PERIODS = 1.0
"""Periods of motion by which a target sent with FD leads the next setpoint, braking distance apart; with FC none.

A drive that hears nothing more therefore goes on for one period to the next setpoint, for this lead, and then brakes.
"""


def acc_byte(joint: JointConfig) -> int:
    """The smallest acc byte with which a stepper's joint reaches its acceleration limit."""
    found = smallest_acc_byte(joint.ratio, joint.max_acceleration_rad_s2)
    if found is None:
        raise ValueError(f"no acc byte lets {joint.name} reach {joint.max_acceleration_rad_s2:g} rad/s²")
    return found


def silence_acc_byte(joint: JointConfig, limits: LimitsConfig) -> int:
    """The acc byte each motion frame of a stepper's joint carries, so that silence is a controlled stop.

    With it the drive, when it hears nothing more, brakes by itself at 1.5 to 2 times the joint's
    acceleration limit, nearest to `limits.silence_brake_factor`. The schema has made sure that it exists.
    """
    found = nearest_silence_byte(joint.ratio, joint.max_acceleration_rad_s2, limits.silence_brake_factor)
    if found is None:
        raise ValueError(f"no acc byte brakes {joint.name} between 1.5 and 2 times its acceleration limit")
    return found


def braking_deceleration_rad_s2(joint: JointConfig, acc_byte: int) -> float:
    """Deceleration of the joint when its stepper drive ramps down with this acc byte (rad/s²)."""
    return ramp_rad_s2(joint.ratio, acc_byte)


@dataclass(frozen=True)
class SilenceStop:
    """What a drive with a ramp of its own does at full speed when it hears nothing more, from the last frame on."""

    acc_byte: int | None
    """None where its ramp is no byte of a command but is set in it, in whatever unit it has."""
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
    """None for a drive without a ramp of its own: it stops at the last set-point that it heard."""


def derived_table(arm: ArmConfig) -> list[DerivedJoint]:
    """The derived figures of every joint, in the order of the arm file."""
    return [_derive(joint, arm) for joint in arm.joints]


def _derive(joint: JointConfig, arm: ArmConfig) -> DerivedJoint:
    has_ramp = joint.drive.stepper_ramp
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
        silence=_silence_stop(joint, arm) if joint.drive.plans_its_motion else None,
    )


def _silence_stop(joint: JointConfig, arm: ArmConfig) -> SilenceStop:
    byte = silence_acc_byte(joint, arm.limits) if joint.drive.stepper_ramp else None
    goes_on_s = (1.0 if arm.bus.fast_targets else 1.0 + LEAD_PERIODS) * arm.control.period_ns * 1e-9
    if byte is not None:
        deceleration = braking_deceleration_rad_s2(joint, byte)
    else:
        deceleration = arm.limits.silence_brake_factor * joint.max_acceleration_rad_s2
    return SilenceStop(
        acc_byte=byte,
        deceleration_rad_s2=deceleration,
        factor=deceleration / joint.max_acceleration_rad_s2,
        coast_deg=math.degrees(
            joint.max_velocity_rad_s * goes_on_s + coast_rad(joint.max_velocity_rad_s, deceleration)
        ),
        stop_time_s=goes_on_s + stop_time_s(joint.max_velocity_rad_s, deceleration),
    )
