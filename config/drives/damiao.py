"""Damiao motors (DM4310, DM4340 …): brushless motors with gear, mostly with an encoder at the output shaft."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field, field_validator, model_validator

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, standard
from config.section import refuse

REGISTERS_ID = 0x7FF
"""All Damiao drives hear questions about registers there; whose it is stands in the first two bytes."""
COMMAND_MASK = 0xFF
"""A motor hears its number, and 100, 200 and 300 (hexadecimal) more, one for each of its modes. It compares the lowest
byte alone and answers the others too, as people found in its firmware (umeow0716/damiao_firmware on GitHub)."""
POSITION_VELOCITY_OFFSET = 0x100
HIGHEST_ID = 15
"""A motor tells its ID and its status in one byte, `CAN_ID | status << 4`, and cuts nothing off its ID
(umeow0716/damiao_firmware on GitHub): from 16 on the ID's upper bits would be read as a status."""
HIGHEST_KP, HIGHEST_KD = 500.0, 5.0
POSITION_STEPS = 0xFFFF
"""Steps of the position field between the ends of its range (16 bits)."""


class Ranges(NamedTuple):
    """What the fields of commands and feedback reach, either way: position, velocity, torque of the output shaft."""

    rad: float
    rad_s: float
    nm: float


MODELS = {
    "DM3507": Ranges(12.566, 50.0, 5.0),
    "DM4310": Ranges(12.5, 30.0, 10.0),
    "DM4310P": Ranges(12.5, 50.0, 10.0),
    "DM4340": Ranges(12.5, 10.0, 28.0),
    "DM4340P": Ranges(12.5, 10.0, 28.0),
    "DM6006": Ranges(12.5, 45.0, 20.0),
    "DM8006": Ranges(12.5, 45.0, 40.0),
    "DM8009": Ranges(12.5, 45.0, 54.0),
    "DM10010L": Ranges(12.5, 25.0, 200.0),
    "DM10010": Ranges(12.5, 20.0, 200.0),
}
"""As the motors come (damiao-motor 1.0.6, its table of limits); revisions differ, so bring-up compares."""
Model = Literal["DM3507", "DM4310", "DM4310P", "DM4340", "DM4340P", "DM6006", "DM8006", "DM8009", "DM10010L", "DM10010"]
RangeField = Annotated[float | None, Field(default=None, gt=0.0, le=1e4)]


class DamiaoDrive(Drive):
    """One Damiao motor. A motor turn is a turn of its output shaft: its own gear is not counted."""

    family: Literal["damiao"] = Field(description="Drive family.")
    motor_id: int = Field(
        ge=1,
        le=HIGHEST_ID,
        description="What it hears: its CAN ID, register 8 (ESC_ID); commands use 100 (hex) more too. Its answers have "
        "four bits for it, beside its status.",
    )
    master_id: int = Field(
        ge=1,
        le=0x7FE,
        description="What it says: its master ID, register 7 (MST_ID); every motor needs one of its own (0x11 for "
        "motor 1, 0x12 for motor 2 …).",
    )
    model: Model = Field(description="The motor, which says what the fields of its frames reach.")
    mode: Literal["mit", "position_velocity"] = Field(
        description="mit: it follows each set-point with stiffness kp and damping kd; position_velocity: it goes to "
        "targets with a ramp of its own."
    )
    encoder: Literal["absolute", "incremental"] = Field(
        default="absolute",
        description="absolute: a second encoder sees the output shaft (2EC motors), so its position means an angle as "
        "soon as it has power; incremental: a person says where the joint stands, with `rtarm reference`.",
    )
    kp: float | None = Field(
        default=None,
        ge=1.0,
        le=HIGHEST_KP,
        description="Stiffness in mode mit (N·m/rad at its output shaft): a load of 1 N·m bends the joint by 1/kp.",
    )
    kd: float | None = Field(
        default=None, ge=0.0, le=HIGHEST_KD, description="Damping in mode mit (N·m·s/rad at its output shaft)."
    )
    position_range_rad: RangeField = Field(
        description="What the position field reaches either way (rad), register 21 (PMAX); by default as the model's."
    )
    velocity_range_rad_s: RangeField = Field(
        description="What the velocity field reaches either way (rad/s), register 22 (VMAX); likewise."
    )
    torque_range_nm: RangeField = Field(
        description="What the torque field reaches either way (N·m), register 23 (TMAX); likewise."
    )
    called: ClassVar[str] = "a Damiao drive"
    number_field: ClassVar[str] = "motor_id"

    @field_validator("motor_id", mode="before")
    @classmethod
    def _leaves_room_for_the_status(cls, value: Any) -> Any:
        if type(value) is int and HIGHEST_ID < value <= 0x7FF:
            raise refuse(
                "",
                f"motor_id is {value} ({value:#x}), but must be at least 1 and at most {HIGHEST_ID}: a motor answers "
                "with its ID and its status in one byte, four bits each, so the upper bits of a larger ID would be "
                "taken for a status, and a limp motor for an enabled one; give the motor another CAN ID with the "
                "maker's tool (ESC_ID, register 8), and motor_id the same.",
            )
        return value

    @model_validator(mode="after")
    def _gains_belong_to_the_mode(self) -> DamiaoDrive:
        for field in ("kp", "kd"):
            given = getattr(self, field) is not None
            if self.mode == "mit" and not given:
                raise refuse(
                    field,
                    f"{field} is missing, but in mode mit the drive holds its joint with it: give kp (N·m/rad, 1 to "
                    f"{HIGHEST_KP:g}) and kd (N·m·s/rad, 0 to {HIGHEST_KD:g}), or set mode to position_velocity.",
                )
            if self.mode != "mit" and given:
                raise refuse(
                    field,
                    f"{field} is {getattr(self, field):g}, but in mode position_velocity the drive uses gains of its "
                    f"own: remove {field}, or set mode to mit.",
                )
        return self

    @model_validator(mode="after")
    def _hears_not_itself(self) -> DamiaoDrive:
        said, *heard = self.identifiers
        if any(said.meets(other) for other in heard):
            raise refuse(
                "master_id",
                f"master_id is {self.master_id:#x}, on which the motor with motor_id {self.motor_id:#x} hears "
                "commands: its lowest byte must not be motor_id; set register 7 of the motor, and master_id, to "
                f"another one, such as {self.motor_id + 0x10:#x}.",
            )
        return self

    @property
    def ranges(self) -> Ranges:
        """What the fields of its frames reach."""
        usual = MODELS[self.model]
        return Ranges(
            self.position_range_rad or usual.rad,
            self.velocity_range_rad_s or usual.rad_s,
            self.torque_range_nm or usual.nm,
        )

    @property
    def number(self) -> int:
        """Its motor ID."""
        return self.motor_id

    @property
    def knows_its_angle(self) -> bool:
        """With an encoder at the output shaft, within a turn of it."""
        return self.encoder == "absolute"

    def knows_its_angle_within(self, turns: float) -> bool:
        """After a loss of power it may count a turn elsewhere.

        A joint that turns less than that then reads outside its limits, which bring-up notices.
        """
        return self.knows_its_angle and turns < 1.0

    @property
    def plans_its_motion(self) -> bool:
        """In mode position_velocity."""
        return self.mode == "position_velocity"

    @property
    def highest_motor_rpm(self) -> float:
        """What the velocity field reaches."""
        return self.ranges.rad_s * 60.0 / (2.0 * math.pi)

    @property
    def command_steps_per_revolution(self) -> float:
        """Those of the position field: what is commanded finer than it is measured would not be seen."""
        return POSITION_STEPS * math.pi / self.ranges.rad

    @property
    def highest_turns(self) -> float:
        """What the position field reaches."""
        return self.ranges.rad / (2.0 * math.pi)

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """Its master ID; its number in all its modes; that of everybody's registers."""
        return (
            standard(self.master_id, from_drive=True, field="master_id"),
            standard(self.motor_id, mask=COMMAND_MASK, from_drive=False),
            standard(REGISTERS_ID, from_drive=False, shared=True),
        )

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """A set-point or target; one that is not led is asked for its feedback by a frame as long."""
        return (CycleFrames("Damiao command", 1, 8, from_host=True, extended=False),)

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Its feedback, which answers each command: position, velocity, torque, temperatures and status."""
        return (CycleFrames("Damiao feedback", 1, 8, from_host=False, extended=False),)
