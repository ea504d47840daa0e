"""RobStride motors and the Xiaomi CyberGear: brushless motors with gear and encoder, on extended CAN identifiers."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, extended
from config.section import refuse

CONTROL, WRITE, READ, ENABLE, STOP = 1, 18, 17, 3, 4
"""Types of frames that a motor hears: bits 24 to 28 of an identifier."""
TYPE_BIT = 24
FIELD_STEPS = 0xFFFF
"""Steps of a field between the ends of its range (16 bits)."""


class RobstrideDrive(Drive):
    """One RobStride motor or CyberGear. A motor turn is a turn of its output shaft: its own gear is not counted."""

    family: Literal["robstride"] = Field(description="Drive family.")
    motor_id: int = Field(
        ge=1, le=0xFE, description="CAN ID of the motor (1 to 254; CyberGears come with 127, RobStrides with 1)."
    )
    host_id: int = Field(
        default=0xFD, ge=0, le=0xFF, description="CAN ID that rtarm takes for itself (0 to 255); no motor may have it."
    )
    mode: Literal["control", "position", "csp"] = Field(
        default="control",
        description="control: it follows each set-point with stiffness kp and damping kd; position: a CyberGear goes "
        "to targets with its own position loop and a speed limit (run mode 1), as csp does on RobStrides (run mode 5).",
    )
    kp: float | None = Field(
        default=None,
        gt=0,
        le=1e5,
        description="Stiffness in mode control (N·m/rad at its output shaft): a load of 1 N·m bends the joint by 1/kp.",
    )
    kd: float | None = Field(
        default=None, gt=0, le=1e4, description="Damping in mode control (N·m·s/rad at its output shaft)."
    )
    position_gain_1_s: float | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="Gain of the motor's own position loop in modes position and csp (1/s; parameter 701E, 30 as "
        "CyberGears come), which bring-up sets in its volatile memory.",
    )
    position_range_rad: float = Field(
        default=4 * math.pi,
        gt=0,
        le=1e3,
        description="What the position field of its frames reaches, either way (rad).",
    )
    velocity_range_rad_s: float = Field(
        default=30.0,
        gt=0,
        le=1e3,
        description="What the velocity field reaches, either way (rad/s): CyberGear 30, RobStride 00 33, 01 and 02 44, "
        "03 20, 04 15, EL05 50.",
    )
    torque_range_nm: float = Field(
        default=12.0,
        gt=0,
        le=1e4,
        description="What the torque field reaches, either way (N·m): CyberGear 12, RobStride 00 14, 01 and 02 17, "
        "03 60, 04 120, EL05 6.",
    )
    kp_range: float = Field(
        default=500.0,
        gt=0,
        le=1e5,
        description="What the stiffness field reaches (N·m/rad): 500, and 5000 with RobStride 03 and 04.",
    )
    kd_range: float = Field(
        default=5.0,
        gt=0,
        le=1e4,
        description="What the damping field reaches (N·m·s/rad): 5, and 100 with RobStride 03 and 04.",
    )
    encoder: Literal["incremental", "absolute"] = Field(
        default="incremental",
        description="absolute: its position means an angle as soon as it has power, within one turn; incremental: a "
        "person says where the joint stands, with `rtarm reference`.",
    )
    called: ClassVar[str] = "a RobStride drive"
    number_field: ClassVar[str] = "motor_id"

    @model_validator(mode="after")
    def _gains_belong_to_the_mode(self) -> RobstrideDrive:
        for field, most in (("kp", self.kp_range), ("kd", self.kd_range)):
            gain: float | None = getattr(self, field)
            if self.mode == "control" and gain is None:
                raise refuse(
                    field,
                    f"{field} is missing, but in mode control the motor holds its joint with kp and kd: give both, for "
                    "instance kp 50 and kd 2 for a small arm, or set mode to position.",
                )
            if self.mode != "control" and gain is not None:
                raise refuse(
                    field,
                    f"{field} is {gain:g}, but in mode {self.mode} the motor uses gains of its own: remove {field}, or "
                    "set mode to control.",
                )
            if gain is not None and gain > most:
                raise refuse(
                    field,
                    f"{field} is {gain:g}, but its field reaches to {most:g}: choose less, or give the motor's own "
                    f"{field}_range.",
                )
        if self.mode == "control" and self.position_gain_1_s is not None:
            raise refuse(
                "position_gain_1_s",
                f"position_gain_1_s is {self.position_gain_1_s:g}, but in mode control the motor's position loop is "
                "not used: remove it, or set mode to position.",
            )
        return self

    @model_validator(mode="after")
    def _is_not_its_host(self) -> RobstrideDrive:
        if self.motor_id == self.host_id:
            raise refuse(
                "host_id",
                f"host_id is {self.host_id}, which is the motor's own motor_id; give the host an ID that no motor has, "
                "such as 253.",
            )
        return self

    @property
    def number(self) -> int:
        """Its CAN ID."""
        return self.motor_id

    @property
    def knows_its_angle(self) -> bool:
        """With an encoder that sees its output shaft."""
        return self.encoder == "absolute"

    @property
    def within_a_turn(self) -> str | None:
        """After power came RobStrides count 0 to 2π, or ±π where zero_sta is 1 (their manuals of 2026, 4.2.2)."""
        if not self.knows_its_angle:
            return None
        return (
            "after power came RobStrides count from 0 to 2π, or from -π to π where their parameter 7029 (zero_sta) is "
            "1: set that with the maker's program and save it, or move the motor's zero and zero_deg so that the whole "
            "range is counted"
        )

    @property
    def highest_motor_rpm(self) -> float:
        """What the velocity field reaches."""
        return self.velocity_range_rad_s * 60.0 / (2.0 * math.pi)

    @property
    def command_steps_per_revolution(self) -> float:
        """Those of the position field: what is commanded finer than it is measured would not be seen."""
        return FIELD_STEPS * math.pi / self.position_range_rad

    @property
    def highest_turns(self) -> float:
        """What the position field reaches."""
        return self.position_range_rad / (2.0 * math.pi)

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """Type << 24 | flags << 16 | whose << 8 | for whom, whatever the flags are.

        It says types 0 and 2, and 17 and 21, to its host; the CyberGear's manual has 21 (a fault) the other way round.
        Of what it hears, what rtarm says is named; it answers type 0 too, which frames of ZDT drives may look like.
        """
        to_host, to_motor = self.motor_id << 8 | self.host_id, self.host_id << 8 | self.motor_id
        heard = tuple(
            extended(kind << TYPE_BIT | self.motor_id, mask=0x1F0000FF, from_drive=False)
            for kind in (CONTROL, ENABLE, STOP, READ, WRITE)
        )
        return (
            extended(to_host, mask=0x1D00FFFF, from_drive=True),
            extended(0x11 << TYPE_BIT | to_host, mask=0x1B00FFFF, from_drive=True),
            extended(0x15 << TYPE_BIT | to_motor, mask=0x1F00FFFF, from_drive=True),
            *heard,
        )

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """A set-point; or a speed limit, answered like everything, and a target."""
        if self.mode == "control":
            return (CycleFrames("RobStride set-point", 1, 8, from_host=True),)
        return (
            CycleFrames("RobStride speed limit and target", 2, 8, from_host=True),
            CycleFrames("RobStride feedback on the speed limit", 1, 8, from_host=False),
        )

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Its feedback, which answers each command; one that is not led is asked by a frame as long."""
        return (CycleFrames("RobStride feedback", 1, 8, from_host=False),)

    def in_turn(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Bus voltage, or what makes one that is not led say how it is."""
        return (
            CycleFrames("RobStride question", 1, 8, from_host=True),
            CycleFrames("RobStride answer", 1, 8, from_host=False),
        )
