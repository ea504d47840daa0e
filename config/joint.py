"""The joints' section of an arm file: a joint, and the drive that moves it."""

from __future__ import annotations

import math
from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from config.drives.cia402 import Cia402Drive
from config.drives.damiao import DamiaoDrive
from config.drives.mks import MksDrive
from config.drives.mock import MockDrive
from config.drives.myactuator import MyactuatorDrive
from config.drives.odrive import OdriveDrive
from config.drives.robstride import RobstrideDrive
from config.drives.vesc import VescDrive
from config.drives.zdt import ZdtDrive
from config.section import NoBool, Section, refuse, refuse_name

Drives = (
    ZdtDrive
    | OdriveDrive
    | MksDrive
    | DamiaoDrive
    | Cia402Drive
    | RobstrideDrive
    | MyactuatorDrive
    | VescDrive
    | MockDrive
)
"""One line a family. Its name is that of its files: config/drives/, rtloop/drives/ and sim/drives/ have one of it."""
DriveConfig = Annotated[Drives, Field(discriminator="family")]
FAMILIES: tuple[str, ...] = tuple(
    sorted((get_args(kind.model_fields["family"].annotation)[0] for kind in get_args(Drives)), key="mock".__ne__)
)
"""Their names; the first is no drive at all."""


class JointConfig(Section):
    """One joint: its drive, its gear and its limits."""

    name: str = Field(
        pattern=r"^[A-Za-z_][A-Za-z0-9_./-]{0,62}$",
        description="Joint name exactly as in the URDF: a letter or _, then letters, digits, _, ., / and -, at most "
        "63.",
    )
    drive: DriveConfig = Field(description="The drive that moves the joint.")
    bus: str | None = Field(
        default=None, description="Name of the bus that its drive is on; needed where the arm has several."
    )
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
        le=60_000,
        description="Highest motor speed (rpm), at most 3000 with a stepper; with the ratio it gives the joint's "
        "highest velocity.",
    )
    max_acceleration_rad_s2: float = Field(
        ge=1e-4,
        le=1e5,
        description="Acceleration limit of the joint (rad/s²); with motor_rpm it must let the arm stop within 60 s.",
    )

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
    def range_turns(self) -> float:
        """Motor turns from its lowest to its highest angle."""
        return (self.upper_deg - self.lower_deg) * self.ratio / 360.0

    @property
    def knows_its_angle(self) -> bool:
        """Whether what its drive counts means an angle of the joint as soon as it has power, wherever that stands."""
        return self.drive.knows_its_angle_within(self.range_turns)

    @property
    def slowness_s(self) -> float:
        """Time from rest to the highest velocity with the limit of acceleration (s)."""
        return self.max_velocity_rad_s / self.max_acceleration_rad_s2

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
        """Steps of a position command for one radian of the joint; a stepper's are pulses."""
        return self.drive.command_steps_per_revolution * self.ratio / (2.0 * math.pi)

    @property
    def encoder_counts_per_rad(self) -> float:
        """Steps of a position reading for one radian of the joint; an encoder's are counts."""
        return self.drive.reading_steps_per_revolution * self.ratio / (2.0 * math.pi)

    @property
    def command_pulse_rad(self) -> float:
        """Joint angle of one step of a command (rad)."""
        return 1.0 / self.command_pulses_per_rad

    @property
    def encoder_count_rad(self) -> float:
        """Joint angle of one step of a reading (rad)."""
        return 1.0 / self.encoder_counts_per_rad

    @property
    def slack_rad(self) -> float:
        """What rounding to steps may put a joint that stands at its limit beyond it (rad): one commanded, one read."""
        return self.command_pulse_rad + self.encoder_count_rad
