"""Nemo N23: a brushless motor with an encoder that knows its angle over many turns."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, standard

REQUEST, ANSWER = 0x100, 0x180
"""What it hears and says: one of them + its address."""
COUNTS_PER_TURN = 65_536


class NemoDrive(Drive):
    """One Nemo motor, which follows set-points."""

    family: Literal["nemo"] = Field(description="Drive family.")
    address: int = Field(ge=1, le=63, description="Set with its rotary switches (1 to 63).")
    called: ClassVar[str] = "a Nemo drive"
    highest_motor_rpm: ClassVar[float] = 3000.0
    command_steps_per_revolution: ClassVar[float] = COUNTS_PER_TURN
    knows_its_angle: ClassVar[bool] = True

    @property
    def number(self) -> int:
        """Its address."""
        return self.address

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """One for requests, one for answers."""
        return (
            standard(REQUEST + self.address, from_drive=False),
            standard(ANSWER + self.address, from_drive=True),
        )

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """A set-point, or a question as long."""
        return (CycleFrames("Nemo request", 1, 8, from_host=True, extended=False),)

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """The answer to either."""
        return (CycleFrames("Nemo answer", 1, 8, from_host=False, extended=False),)
