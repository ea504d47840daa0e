"""VESC motor controllers (Trampa, VESC Project and others with that firmware) on extended CAN identifiers."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, PeriodicFrames, extended

PACKET_BIT = 8
"""An identifier is packet << 8 | number of the controller for which it is, or whose status it is."""
PACKETS_MASK = 0x1FFF80FF
"""All packets (below 128) of one number."""
HOST_BIT = 0x80
"""rtarm speaks to controller n as number n + 128, to which that one alone answers."""
HIGHEST_NUMBER = 126
"""255 is for all controllers, and so would be the host of 127."""
STEPS_PER_TURN = 18_000
"""Of a position that it tells; commands are finer."""
MOST_OF_A_TURN = 0.95
"""What a joint's range may be of the turn after which positions begin anew: beyond its end it is still told apart."""


class VescDrive(Drive):
    """One VESC, led by position. A motor turn is a turn of its PID position: what Position Angle Division makes one."""

    family: Literal["vesc"] = Field(description="Drive family.")
    controller_id: int = Field(
        ge=1, le=HIGHEST_NUMBER, description="VESC ID set with VESC Tool (App Settings, General; 1 to 126)."
    )
    encoder: Literal["incremental", "absolute"] = Field(
        default="incremental",
        description="absolute: its position means an angle as soon as it has power, because its encoder does and "
        "Position Angle Division is 1; incremental: a person says where the joint stands, with `rtarm reference`.",
    )
    position_hz: int = Field(
        default=200,
        ge=50,
        le=1000,
        description="How often it sends its position (status 4) by itself: CAN Status Rate 1 of VESC Tool, at least "
        "control.rate_hz.",
    )
    voltage_hz: int = Field(
        default=5,
        ge=0,
        le=100,
        description="How often it sends its supply voltage (status 5): CAN Status Rate 2, 0 for never.",
    )
    called: ClassVar[str] = "a VESC"
    number_field: ClassVar[str] = "controller_id"
    highest_motor_rpm: ClassVar[float] = 3000.0
    command_steps_per_revolution: ClassVar[float] = STEPS_PER_TURN
    most_of_a_turn: ClassVar[float] = MOST_OF_A_TURN

    @property
    def number(self) -> int:
        """Its VESC ID."""
        return self.controller_id

    @property
    def knows_its_angle(self) -> bool:
        """With an absolute encoder."""
        return self.encoder == "absolute"

    @property
    def tells_its_position_hz(self) -> float:
        """As set in the drive."""
        return self.position_hz

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """All packets for it and all status of it, and what it answers to its host."""
        return (
            extended(self.controller_id, mask=PACKETS_MASK, from_drive=True),
            extended(self.controller_id | HOST_BIT, mask=PACKETS_MASK, from_drive=True),
        )

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """A position (4)."""
        return (CycleFrames("VESC position command", 1, 4, from_host=True),)

    def in_turn(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Its fault, or whether its time-out or kill switch has let the motor go (COMM_GET_VALUES_SELECTIVE)."""
        return (
            CycleFrames("VESC question", 1, 7, from_host=True),
            CycleFrames("VESC answer", 1, 8, from_host=False),
        )

    def by_itself(self) -> tuple[PeriodicFrames, ...]:
        """Position and temperatures (status 4), and the supply voltage (status 5)."""
        position = CycleFrames("VESC status 4", 1, 8, from_host=False)
        voltage = CycleFrames("VESC status 5", 1, 8, from_host=False)
        found = [PeriodicFrames(position, self.position_hz)]
        if self.voltage_hz:
            found.append(PeriodicFrames(voltage, self.voltage_hz))
        return tuple(found)
