"""ODrive with CANSimple (firmware 0.5.6 and 0.6): brushless motors, each axis with an identifier of its own."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, PeriodicFrames, standard

NODE_BIT, COMMAND_MASK = 5, 0x1F
"""An identifier is node << 5 | command."""


class OdriveDrive(Drive):
    """One axis of an ODrive, led by position with velocity ahead of it (passthrough)."""

    family: Literal["odrive"] = Field(description="Drive family.")
    node_id: int = Field(ge=0, le=0x3F, description="Node set in the drive (axis.config.can.node_id, 0 to 63).")
    encoder_cpr: int = Field(
        default=8192, ge=1, le=1 << 24, description="Counts of its encoder for one motor turn: how finely it measures."
    )
    encoder: Literal["incremental", "absolute"] = Field(
        default="incremental",
        description="absolute: its position means an angle as soon as it has power; incremental: a person says where "
        "the joint stands, with `rtarm reference`.",
    )
    heartbeat_ms: int = Field(
        default=100,
        ge=1,
        le=1000,
        description="Time between two heartbeats as set in the drive (axis.config.can.heartbeat_rate_ms; "
        "heartbeat_msg_rate_ms with firmware 0.6); three in a row that are missing are a fault.",
    )
    estimates_ms: int = Field(
        default=10,
        ge=0,
        le=60_000,
        description="Time between two positions that the drive sends by itself (axis.config.can.encoder_rate_ms; "
        "encoder_msg_rate_ms with firmware 0.6), 0 for none. rtarm asks for them in every cycle; set 0 here and in the "
        "drive to spare the bus.",
    )
    nm_per_ampere: float | None = Field(
        default=None,
        gt=0,
        le=1e3,
        description="The motor's torque for one ampere (N·m/A); with it effort is measured, left out it is NaN.",
    )
    called: ClassVar[str] = "an ODrive axis"
    number_field: ClassVar[str] = "node_id"
    highest_motor_rpm: ClassVar[float] = 60_000.0

    @property
    def number(self) -> int:
        """Its node."""
        return self.node_id

    @property
    def knows_its_angle(self) -> bool:
        """With an absolute encoder."""
        return self.encoder == "absolute"

    @property
    def command_steps_per_revolution(self) -> float:
        """Turns go out and come back as floating-point numbers; the encoder is coarser."""
        return self.encoder_cpr

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """All commands of its node: requests and answers share them."""
        return (standard(self.node_id << NODE_BIT, mask=0x3F << NODE_BIT, from_drive=True),)

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Position with velocity ahead (0C)."""
        return (CycleFrames("ODrive position command", 1, 8, from_host=True, extended=False),)

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """The encoder's estimates (09), by remote request."""
        return (
            CycleFrames("ODrive estimates request", 1, 0, from_host=True, extended=False, remote=True),
            CycleFrames("ODrive estimates", 1, 8, from_host=False, extended=False),
        )

    def in_turn(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Bus voltage (17) or motor current (14), by remote request."""
        return (
            CycleFrames("ODrive measurement request", 1, 0, from_host=True, extended=False, remote=True),
            CycleFrames("ODrive measurement", 1, 8, from_host=False, extended=False),
        )

    def by_itself(self) -> tuple[PeriodicFrames, ...]:
        """Heartbeats, and estimates where they are on."""
        heartbeat = CycleFrames("ODrive heartbeat", 1, 8, from_host=False, extended=False)
        estimates = CycleFrames("ODrive estimates unasked", 1, 8, from_host=False, extended=False)
        found = [PeriodicFrames(heartbeat, 1000.0 / self.heartbeat_ms)]
        if self.estimates_ms:
            found.append(PeriodicFrames(estimates, 1000.0 / self.estimates_ms))
        return tuple(found)
