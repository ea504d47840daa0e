"""What a ZDT Emm_V5 keeps in flash: its configuration block and its homing parameters (zdt-emm-v5.md, 4 and 6)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

_SETTINGS = struct.Struct(">8B3H6B4H")
_HOMING = struct.Struct(">BBHIHHHB")

CAN_CODES = {
    10_000: 0,
    20_000: 1,
    50_000: 2,
    100_000: 4,
    125_000: 5,
    250_000: 6,
    500_000: 7,
    1_000_000: 9,
}
"""The drive's menu codes for its bit rate (section 1)."""

ARM_HOMING_RPM = 30
ARM_HOMING_TIMEOUT_MS = 120_000


@dataclass(frozen=True)
class Settings:
    """The configuration block of `42 6C` and `48 D1`, 21 fields in their order on the wire."""

    motor_type: int = 0x19
    pulse_port: int = 2
    comms_port: int = 2
    en_level: int = 2
    dir_level: int = 0
    microstep: int = 16
    interpolation: int = 1
    screen_off: int = 0
    open_loop_ma: int = 1000
    closed_loop_ma: int = 3000
    max_mv: int = 4000
    uart_code: int = 5
    can_code: int = 7
    address: int = 1
    checksum_mode: int = 0
    response: int = 1
    stall_mode: int = 1
    stall_rpm: int = 40
    stall_ma: int = 2400
    stall_ms: int = 4000
    reach_window: int = 1

    def pack(self) -> bytes:
        """The 28 data bytes."""
        return _SETTINGS.pack(*self.__dict__.values())

    @classmethod
    def unpack(cls, data: bytes) -> Settings:
        """The block read from 28 data bytes."""
        return cls(*_SETTINGS.unpack(data))

    @property
    def valid(self) -> bool:
        """Whether the drive would accept it; only what is modelled is accepted."""
        return (
            self.motor_type in (0x19, 0x32)
            and self.checksum_mode == 0
            and self.response <= 4
            and self.stall_mode <= 2
            and self.can_code <= 9
        )

    @property
    def pulses_per_revolution(self) -> int:
        """Command pulses in one motor revolution; a microstep field of 0 means 256."""
        return (200 if self.motor_type == 0x19 else 400) * (self.microstep or 256)


@dataclass(frozen=True)
class Homing:
    """The homing parameters of `22` and `4C AE`."""

    mode: int = 0
    direction: int = 0
    rpm: int = 30
    timeout_ms: int = 10_000
    collision_rpm: int = 300
    collision_ma: int = 800
    collision_ms: int = 60
    at_power_up: int = 0

    def pack(self) -> bytes:
        """The 15 data bytes."""
        return _HOMING.pack(*self.__dict__.values())

    @classmethod
    def unpack(cls, data: bytes) -> Homing:
        """The parameters read from 15 data bytes."""
        return cls(*_HOMING.unpack(data))


def homing_towards(direction: int) -> Homing:
    """How the drive of a joint homes: to the mechanical stop at the joint's lower end."""
    return Homing(mode=2, direction=1 if direction > 0 else 0, rpm=ARM_HOMING_RPM, timeout_ms=ARM_HOMING_TIMEOUT_MS)
