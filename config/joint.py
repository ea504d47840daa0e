"""The joints' section of an arm file: a joint, and the drive that moves it."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from config.section import NoBool, Section, refuse, refuse_name

ENCODER_COUNTS_PER_REVOLUTION = 65_536
"""Counts a motor revolution in the positions a ZDT drive reports (Emm_V5, command 36)."""

FULL_STEPS_PER_REVOLUTION = 200
"""Steps a revolution of a 1.8° motor; a command pulse is one microstep of these."""

SHORTEST_WATCHDOG_MS = 300
"""Three times the silence after which the control process latches a fault of its own."""


class ZdtDrive(Section):
    """A ZDT closed-loop stepper with Emm_V5 firmware on the CAN bus."""

    family: Literal["zdt"] = Field(description="Drive family.")
    address: int = Field(ge=1, le=255, description="Address set in the drive's menu (1 to 255).")
    microsteps: int = Field(
        default=16,
        ge=1,
        le=256,
        description="Microsteps a full step as set in the drive (200 full steps a turn).",
    )
    firmware: str = Field(
        default="auto",
        pattern=r"^(auto|[12]\.[0-9]\.[0-9])$",
        description='Firmware the drive should have, such as "2.0.0"; auto takes any that is known. Compared by '
        "`rtarm drives`, never written.",
    )
    current_ma: int | None = Field(
        default=None,
        ge=100,
        le=6000,
        description="Highest motor current in closed loop (mA). This field and those below are compared by `rtarm "
        "drives` and written only by `rtarm drives --write`; left out, the drive's own value stays.",
    )
    stall_protection: bool | None = Field(
        default=None,
        description="Whether the drive lets go when it is held (true), or keeps pushing (false).",
    )
    stall_rpm: int | None = Field(
        default=None, ge=1, le=3000, description="Motor speed below which the drive may count as stalled (rpm)."
    )
    stall_current_ma: int | None = Field(
        default=None, ge=100, le=6000, description="Current above which the drive may count as stalled (mA)."
    )
    stall_time_ms: int | None = Field(
        default=None, ge=1, le=65_535, description="For how long both must last until the protection trips (ms)."
    )
    watchdog_ms: int | None = Field(
        default=None,
        ge=0,
        le=60_000,
        description="Silence after which the drive stops by itself (ms); 0 turns that off. Only firmware of the X42S "
        "generation has it.",
    )

    @model_validator(mode="after")
    def _watchdog_outlives_a_pause(self) -> ZdtDrive:
        if self.watchdog_ms is not None and 0 < self.watchdog_ms < SHORTEST_WATCHDOG_MS:
            raise refuse(
                "watchdog_ms",
                f"watchdog_ms is {self.watchdog_ms}, but the drive would then stop hard at a pause that is no fault "
                f"yet; choose {SHORTEST_WATCHDOG_MS} or more, or 0 for none.",
            )
        return self

    @property
    def command_pulses_per_revolution(self) -> int:
        """Pulses of a position command for one motor turn."""
        return self.microsteps * FULL_STEPS_PER_REVOLUTION


class MockDrive(Section):
    """No drive: what is commanded is at once measured."""

    family: Literal["mock"] = Field(description="Drive family.")

    @property
    def command_pulses_per_revolution(self) -> int:
        """A mock drive is commanded in the same counts in which it is measured."""
        return ENCODER_COUNTS_PER_REVOLUTION


DriveConfig = Annotated[ZdtDrive | MockDrive, Field(discriminator="family")]


class JointConfig(Section):
    """One joint: its drive, its gear and its limits."""

    name: str = Field(pattern=r"^[A-Za-z_][A-Za-z0-9_./-]{0,62}$", description="Joint name exactly as in the URDF.")
    drive: DriveConfig = Field(description="The drive that moves the joint.")
    ratio: float = Field(ge=1e-3, le=1e6, description="Gear ratio: motor turns for one turn of the joint.")
    direction: Annotated[Literal[1, -1], NoBool] = Field(
        default=1, description="1 when a positive motor angle turns the joint positively, else -1."
    )
    zero_deg: float = Field(
        default=0.0,
        ge=-36_000,
        le=36_000,
        description="Offset of the joint zero (degrees): joint = direction * m - zero_deg, where m is the "
        "motor's turns * 360 / ratio, counted from its homing stop.",
    )
    lower_deg: float = Field(ge=-36_000, le=36_000, description="Lowest joint angle (degrees).")
    upper_deg: float = Field(ge=-36_000, le=36_000, description="Highest joint angle (degrees).")
    motor_rpm: float = Field(
        ge=0.01,
        le=3000,
        description="Highest motor speed (rpm); with the ratio it gives the joint's highest velocity.",
    )
    max_acceleration_rad_s2: float = Field(ge=1e-4, le=1e5, description="Acceleration limit of the joint (rad/s²).")

    @model_validator(mode="after")
    def _name_is_a_name(self) -> JointConfig:
        refuse_name("name", self.name)
        return self

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> JointConfig:
        if self.lower_deg > self.upper_deg:
            raise refuse(
                "lower_deg",
                f"lower_deg of {self.name} is {self.lower_deg:g}, above its upper_deg {self.upper_deg:g}; "
                "the lower limit must be the smaller one: exchange them or correct one.",
            )
        if self.lower_deg == self.upper_deg:
            raise refuse(
                "lower_deg",
                f"lower_deg and upper_deg of {self.name} are both {self.lower_deg:g}, which leaves no room "
                "to move; enter the range the joint really has.",
            )
        return self

    @property
    def max_velocity_rad_s(self) -> float:
        """Highest joint velocity, from the motor's rpm and the ratio (rad/s)."""
        return self.motor_rpm / self.ratio * 2.0 * math.pi / 60.0

    @property
    def lower_rad(self) -> float:
        """Lowest joint angle (rad)."""
        return math.radians(self.lower_deg)

    @property
    def upper_rad(self) -> float:
        """Highest joint angle (rad)."""
        return math.radians(self.upper_deg)

    @property
    def zero_rad(self) -> float:
        """Offset of the joint zero (rad); see `zero_deg`."""
        return math.radians(self.zero_deg)

    @property
    def command_pulses_per_rad(self) -> float:
        """Pulses of a position command for one radian of the joint."""
        return self.drive.command_pulses_per_revolution * self.ratio / (2.0 * math.pi)

    @property
    def encoder_counts_per_rad(self) -> float:
        """Counts of a reported position for one radian of the joint."""
        return ENCODER_COUNTS_PER_REVOLUTION * self.ratio / (2.0 * math.pi)

    @property
    def command_pulse_rad(self) -> float:
        """Joint angle of one command pulse (rad)."""
        return 1.0 / self.command_pulses_per_rad

    @property
    def encoder_count_rad(self) -> float:
        """Joint angle of one encoder count (rad)."""
        return 1.0 / self.encoder_counts_per_rad
