"""MKS SERVO42D and SERVO57D (Makerbase): closed-loop steppers on CAN."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, standard

COUNTS_PER_REVOLUTION = 16_384
"""Counts a motor revolution, in positions and in targets (manual V1.0.6, commands 31 and F5)."""

FARTHEST_COUNTS = 8_388_607
"""Targets are int24."""


class MksDrive(Drive):
    """A SERVO42D or SERVO57D in the work mode SR_vFOC, led by absolute targets in encoder counts (F5)."""

    family: Literal["mks"] = Field(description="Drive family.")
    can_id: int = Field(ge=1, le=2047, description="CanID set in the drive's menu (1 to 2047).")
    called: ClassVar[str] = "an MKS drive"
    number_field: ClassVar[str] = "can_id"
    highest_motor_rpm: ClassVar[float] = 3000.0
    stepper_ramp: ClassVar[bool] = True

    @property
    def number(self) -> int:
        """Its CanID."""
        return self.can_id

    @property
    def plans_its_motion(self) -> bool:
        """Always."""
        return True

    @property
    def command_steps_per_revolution(self) -> int:
        """Counts of its encoder, whatever its microsteps are."""
        return COUNTS_PER_REVOLUTION

    @property
    def highest_turns(self) -> float:
        """What an int24 reaches."""
        return FARTHEST_COUNTS / COUNTS_PER_REVOLUTION

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """Requests and answers share one."""
        return (standard(self.can_id, from_drive=True),)

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """A target (F5), 8 bytes; 3 acknowledge it."""
        command = CycleFrames("MKS position command", 1, 8, from_host=True, extended=False)
        acknowledged = CycleFrames("MKS command acknowledged", 1, 3, from_host=False, extended=False)
        return (command, acknowledged) if bus.acknowledge else (command,)

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """The position (31), 2 bytes out and 8 back."""
        return (
            CycleFrames("MKS position request", 1, 2, from_host=True, extended=False),
            CycleFrames("MKS position reply", 1, 8, from_host=False, extended=False),
        )

    def in_turn(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Whether it is enabled (3A) or whether its protection has tripped (3E), 2 bytes out and 3 back."""
        return (
            CycleFrames("MKS status request", 1, 2, from_host=True, extended=False),
            CycleFrames("MKS status reply", 1, 3, from_host=False, extended=False),
        )
