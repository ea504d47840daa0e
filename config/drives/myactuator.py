"""MyActuator RMD motors (protocol V3 and V4): brushless motors with gear and encoder, on standard identifiers."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, standard

REQUEST, REPLY = 0x140, 0x240
"""Identifiers of motor 0."""
ALL_MOTORS, SET_ID, MOTION_MODE = 0x280, 0x300, 0x400
"""What motors hear beside that: all of them; whoever has its ID set; motion mode, from protocol V4 on."""
HIGHEST_ID = 32
STEPS_PER_REVOLUTION = 36_000
"""Angles are hundredths of a degree."""
RAMP_RANGE_DPS_S = (100, 60_000)
"""Least and most that 43 takes (degrees/s²)."""
HIGHEST_DPS = 32_767
"""What a feedback can say; a command could say twice that."""


class MyactuatorDrive(Drive):
    """One MyActuator RMD motor. A motor turn is a turn of its output shaft: its own gear is not counted."""

    family: Literal["myactuator"] = Field(description="Drive family.")
    motor_id: int = Field(
        ge=1, le=HIGHEST_ID, description="ID of the motor (1 to 32), as set with the maker's program."
    )
    encoder: Literal["incremental", "absolute"] = Field(
        default="incremental",
        description="absolute: its angle is right as soon as it has power, because a second encoder sees its output "
        "shaft, or because it saves its turns; incremental: a person says where the joint stands, with `rtarm "
        "reference`. As they come, motors count within one turn of the motor after power was off.",
    )
    nm_per_ampere: float | None = Field(
        default=None,
        gt=0,
        le=1e3,
        description="Torque of its output shaft for one ampere (N·m/A); with it effort is measured, else it is NaN.",
    )
    called: ClassVar[str] = "a MyActuator drive"
    number_field: ClassVar[str] = "motor_id"

    @property
    def number(self) -> int:
        """Its ID."""
        return self.motor_id

    @property
    def knows_its_angle(self) -> bool:
        """With an encoder at its output shaft, or saved turns."""
        return self.encoder == "absolute"

    @property
    def plans_its_motion(self) -> bool:
        """Always."""
        return True

    @property
    def ramp_range_rad_s2(self) -> tuple[float, float]:
        """What it can be set to."""
        return math.radians(RAMP_RANGE_DPS_S[0]), math.radians(RAMP_RANGE_DPS_S[1])

    @property
    def highest_motor_rpm(self) -> float:
        """What its feedback can say."""
        return HIGHEST_DPS / 6.0

    @property
    def command_steps_per_revolution(self) -> float:
        """Hundredths of a degree, out and back."""
        return STEPS_PER_REVOLUTION

    @property
    def highest_turns(self) -> float:
        """Angles have 32 bits."""
        return 0x7FFFFFFF / STEPS_PER_REVOLUTION

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """240 + ID is what it says, 140 + ID what it hears; and what other motors hear as well, or by other means."""
        return (
            standard(REPLY + self.motor_id, from_drive=True),
            standard(REQUEST + self.motor_id, from_drive=False),
            standard(MOTION_MODE + self.motor_id, from_drive=False),
            standard(ALL_MOTORS, from_drive=False, shared=True),
            standard(SET_ID, from_drive=False, shared=True),
        )

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """A target (A4), answered with all but a fine position."""
        return (
            CycleFrames("MyActuator target", 1, 8, from_host=True, extended=False),
            CycleFrames("MyActuator feedback", 1, 8, from_host=False, extended=False),
        )

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Its angle (92), since the feedback has whole degrees."""
        return (
            CycleFrames("MyActuator angle request", 1, 8, from_host=True, extended=False),
            CycleFrames("MyActuator angle", 1, 8, from_host=False, extended=False),
        )

    def in_turn(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Errors, voltage and temperature (9A); of one that is not led its feedback (9C) in turn with them."""
        return (
            CycleFrames("MyActuator status request", 1, 8, from_host=True, extended=False),
            CycleFrames("MyActuator status", 1, 8, from_host=False, extended=False),
        )
