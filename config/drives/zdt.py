"""ZDT closed-loop steppers with Emm_V5 firmware."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, extended
from config.section import refuse

ENCODER_COUNTS_PER_REVOLUTION = 65_536
"""Counts a motor revolution in the positions a ZDT drive reports (Emm_V5, command 36)."""

FULL_STEPS_PER_REVOLUTION = 200
"""Steps a revolution of a 1.8° motor; a command pulse is one microstep of these."""

SHORTEST_WATCHDOG_MS = 300
"""Three times the silence after which the control process latches a fault of its own."""


def zdt_identifiers(address: int) -> tuple[Identifiers, ...]:
    """Identifiers of a drive: address << 8 | number of the packet."""
    return (extended(address << 8, mask=0x1FFFFF00, from_drive=True),)


class ZdtDrive(Drive):
    """A ZDT closed-loop stepper with Emm_V5 firmware on the CAN bus."""

    family: Literal["zdt"] = Field(description="Drive family.")
    counts_on: ClassVar[bool] = True
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

    called: ClassVar[str] = "a ZDT drive"
    highest_motor_rpm: ClassVar[float] = 3000.0
    stepper_ramp: ClassVar[bool] = True

    @property
    def number(self) -> int:
        """Its address."""
        return self.address

    @property
    def plans_its_motion(self) -> bool:
        """Always."""
        return True

    @property
    def command_steps_per_revolution(self) -> int:
        """Pulses of a position command for one motor turn."""
        return self.microsteps * FULL_STEPS_PER_REVOLUTION

    @property
    def reading_steps_per_revolution(self) -> int:
        """Encoder counts for one motor turn."""
        return ENCODER_COUNTS_PER_REVOLUTION

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """The packets of its address: requests and answers share them."""
        return zdt_identifiers(self.address)

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """A target: FD has 13 bytes and goes out as frames of 8 and 5 bytes, FC has 6; 3 acknowledge either."""
        commands: tuple[CycleFrames, ...] = (
            CycleFrames("position command, first part", 1, 8, from_host=True),
            CycleFrames("position command, second part", 1, 5, from_host=True),
        )
        if bus.fast_targets:
            commands = (CycleFrames("position command", 1, 6, from_host=True),)
        acknowledgements = (CycleFrames("command acknowledged", 1, 3, from_host=False),) if bus.acknowledge else ()
        return (*commands, *acknowledgements)

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """The position (36), 2 bytes out and 7 back.

        Reported positions come unasked, with the same 7 bytes and at the drives' own clocks; their period is longer
        than a cycle (`ControlConfig.report_period_ms`), so one of each drive is the most that a cycle meets.
        """
        requests = () if bus.reported else (CycleFrames("position request", 1, 2, from_host=True),)
        told = "position report" if bus.reported else "position reply"
        return (*requests, CycleFrames(told, 1, 7, from_host=False))

    def in_turn(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """The status (3A), 2 bytes out and 3 back."""
        return (
            CycleFrames("status request", 1, 2, from_host=True),
            CycleFrames("status reply", 1, 3, from_host=False),
        )
