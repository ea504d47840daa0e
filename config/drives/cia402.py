"""Servo drives with CANopen's profile CiA 402, in cyclic synchronous position (CSP)."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers, PeriodicFrames, standard

NMT = 0x000
SYNC = 0x080
EMERGENCY, TPDO1, RPDO1 = 0x080, 0x180, 0x200
SDO_REPLY, SDO_REQUEST = 0x580, 0x600
HEARTBEAT = 0x700
"""Bases of CANopen's predefined identifiers (CiA 301), to which a node's number is added; NMT and SYNC are for all."""

RPDO1_BYTES = 6
"""Controlword and target position."""
HIGHEST_COUNT = (1 << 31) - 1
"""Positions are signed 32-bit numbers."""


class Cia402Drive(Drive):
    """A CANopen node with the profile CiA 402, told a target position in every cycle, taken by all on one SYNC."""

    family: Literal["cia402"] = Field(description="Drive family.")
    node_id: int = Field(ge=1, le=127, description="Node number set in the drive (1 to 127).")
    counts_per_revolution: int = Field(
        ge=1,
        le=1 << 30,
        description="Counts of the drive's position (objects 6064 and 607A) for one motor turn, as it is scaled there.",
    )
    encoder: Literal["incremental", "absolute"] = Field(
        default="incremental",
        description="absolute: its position means an angle as soon as it has power; incremental: a person says where "
        "the joint stands, with `rtarm reference`.",
    )
    heartbeat_ms: int = Field(
        default=100,
        ge=10,
        le=10_000,
        description="Time between two heartbeats that the drive is told to send (object 1017).",
    )
    rated_torque_nm: float | None = Field(
        default=None,
        gt=0,
        le=1e5,
        description="The motor's rated torque (N·m, object 6076); with it the drive tells its torque in every cycle "
        "(object 6077) and effort is measured, left out it is NaN.",
    )
    called: ClassVar[str] = "a CiA 402 drive"
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
        """Targets and positions have the same counts."""
        return self.counts_per_revolution

    @property
    def highest_turns(self) -> float | None:
        """What a signed 32-bit number of counts reaches."""
        return HIGHEST_COUNT / self.counts_per_revolution

    @property
    def tpdo1_bytes(self) -> int:
        """Statusword and position, and torque where that is measured."""
        return 6 if self.rated_torque_nm is None else 8

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """What is predefined for its node, and what all nodes hear."""
        said = (EMERGENCY, TPDO1, SDO_REPLY, HEARTBEAT)
        return (
            *(standard(base + self.node_id, from_drive=True) for base in said),
            *(standard(base + self.node_id, from_drive=False) for base in (RPDO1, SDO_REQUEST)),
            *(standard(identifier, from_drive=False, shared=True) for identifier in (NMT, SYNC)),
        )

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Controlword and target, which the next SYNC puts in force."""
        return (CycleFrames("CiA 402 target (RPDO1)", 1, RPDO1_BYTES, from_host=True, extended=False),)

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Statusword and position (and torque) at the SYNC."""
        return (CycleFrames("CiA 402 position (TPDO1)", 1, self.tpdo1_bytes, from_host=False, extended=False),)

    def for_all(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """The SYNC, an empty frame."""
        return (CycleFrames("CANopen SYNC", 1, 0, from_host=True, extended=False),)

    def by_itself(self) -> tuple[PeriodicFrames, ...]:
        """Heartbeats."""
        heartbeat = CycleFrames("CANopen heartbeat", 1, 1, from_host=False, extended=False)
        return (PeriodicFrames(heartbeat, 1000.0 / self.heartbeat_ms),)
