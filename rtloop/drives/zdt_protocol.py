"""A ZDT (Emm_V5) drive as ordinary Python sees it: requests, answers and commands as bytes (zdt-emm-v5.md, 2 to 6).

This file holds what service dialogues and the cycle send, and nothing else: auto-run, calibration, factory reset, loop
mode and address are not part of it. Frames are extended, id = address << 8 | packet, big-endian, and end in 6B.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, fields, replace

from config.drives.zdt import FULL_STEPS_PER_REVOLUTION
from rtloop.drives.numbers import Number, Values, packed
from rtloop.memory import status as status_bits

ASK_FIRMWARE = b"\x1f\x6b"
ASK_TRIP = b"\x13\x6b"
ASK_HOMING = b"\x22\x6b"
ASK_SUPPLY = b"\x24\x6b"
ASK_WATCHDOG = b"\x16\x6b"
ASK_CURRENT = b"\x27\x6b"
ASK_SPEED = b"\x35\x6b"
ASK_TARGET = b"\x33\x6b"
ASK_POSITION = b"\x36\x6b"
ASK_STATUS = b"\x3a\x6b"
ASK_HOMING_STATUS = b"\x3b\x6b"
ASK_BLOCK = b"\x42\x6c\x6b"

ENABLE = b"\xf3\xab\x01\x00\x6b"
RELEASE = b"\xf3\xab\x00\x00\x6b"
STOP = b"\xfe\x98\x00\x6b"
CLEAR_PROTECTION = b"\x0e\x52\x6b"
CLEAR_POWER_LOST = b"\x50\x00\x6b"
HOME_BY_COLLISION = b"\x9a\x02\x00\x6b"
"""Begins a homing run to the stop, which ends at count 0."""
END_HOMING = b"\x9c\x48\x6b"

ENABLED, REACHED, STALLED, PROTECTED, POWER_LOST = 0x01, 0x02, 0x04, 0x08, 0x80
"""Flags of `3A`."""
STATUS_MEANINGS = (
    (ENABLED, status_bits.ENABLED),
    (REACHED, status_bits.REACHED),
    (STALLED, status_bits.STALLED),
    (PROTECTED, status_bits.PROTECTED),
    (POWER_LOST, status_bits.POWER_LOST),
)
"""The same in common bits."""
HOMING, HOMING_FAILED, TOO_HOT, TOO_MUCH_CURRENT = 0x04, 0x08, 0x10, 0x20
"""Flags of `3B`; the last two give the cause of a tripped protection, where a stall has no flag."""
CAUSE_MEANINGS = ((TOO_HOT, status_bits.OVER_TEMPERATURE), (TOO_MUCH_CURRENT, status_bits.OVER_CURRENT))

FUNCTION = Number(0, 1)
"""Of every packet, in both directions."""

# of an acknowledgement or refusal, and of the answers to 3A and 3B
CODE, CODE_END = Number(1, 1), Number(2, 1)
ACCEPTED, REFUSALS = 0x02, (0xE2, 0xEE)
"""Codes; the second refusal is that it was not understood."""

# of the answer to 36
COUNTS_SIGN, COUNTS, COUNTS_END = Number(1, 1), Number(2, 4, big_endian=True), Number(6, 1)
"""65536 a turn, with a sign of its own: 0 or 1."""

# of FD, in its two packets as one
MOVE = 0xFD
MOVE_SIGN, MOVE_RPM, MOVE_ACC = Number(1, 1), Number(2, 2, big_endian=True), Number(4, 1)
MOVE_PULSES = Number(5, 4, big_endian=True)
MOVE_MODE, ABSOLUTE, MOVE_END = Number(9, 1), 1, Number(11, 1)
MOVE_BYTES = 12

# of FC
FAST_MOVE = 0xFC
FAST_PULSES, FAST_END = Number(1, 4, signed=True, big_endian=True), Number(5, 1)
FAST_BYTES = 6

HIGHEST_RPM = 3000
"""Highest speed in a motion command, whatever the firmware (zdt-emm-v5.md 3)."""
GENTLEST_RAMP = 1
"""Ramp byte of 1 rpm every 12.75 ms, the slowest ramp there is; 0 would be no ramp."""

CHECKSUM = 0x6B
KNOWN_FIRMWARE = range(100, 300)
"""Emm_V5 versions 1.0.0 to 2.9.9, which share the configuration block (V1.0.7 and V2.0.0 were tried by others)."""

FAST_FIRMWARE = 200
"""The first version that knows `F1` and `FC`."""

CAN_BITRATES = (10_000, 20_000, 50_000, 83_333, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates (bit/s) by their code in the drive's menu."""

RESPONSES = ("none", "receive", "reached", "both", "other")
"""When the drive answers motion commands, by code."""
RESPONSE_NONE, RESPONSE_RECEIVE = 0, 1
CHECKSUMS = ("6B", "XOR", "CRC-8", "Modbus")
"""Checksum modes by code; only the first is supported here. [The last is in the menus of newer drives.]"""
STALL_MODES = ("off", "on", "on, then zero")
"""Stall protection by code; the last also sets the position to zero after a stall."""
HOMING_MODES = ("nearest", "one way", "stop", "switch", "absolute", "power-off")
"""How a drive homes, by code: to its single-turn zero the nearest or one way, to a stop without a sensor, to a limit
switch, to its absolute zero, to where it was when it lost power."""

BLOCK_HEAD = bytes((33, 21))
"""Byte count and field count of the supported configuration block."""
BLOCK_PACKETS = 5
_BLOCK = struct.Struct(">8B3H6B4H")
_HOMING = struct.Struct(">BBHIHHHB")
HOMING_PACKETS = 3
_TRIP = struct.Struct(">3H")


def trip_cause(homing_flags: int) -> tuple[str, str]:
    """Why a protection has tripped, by the flags of `3B`, and what the operator can do about it."""
    if homing_flags & TOO_HOT:
        return "over-temperature", "let the drive cool"
    if homing_flags & TOO_MUCH_CURRENT:
        return "over-current", "find what draws it"
    return "stall", "free what blocks the joint"


@dataclass(frozen=True)
class Block:
    """The configuration block of `42 6C` and `48 D1`: its fields in their order on the wire."""

    motor_type: int
    pulse_port: int
    comms_port: int
    en_level: int
    dir_level: int
    microstep_code: int
    interpolation: int
    screen_off: int
    open_loop_ma: int
    current_ma: int
    max_mv: int
    uart_code: int
    can_code: int
    address: int
    checksum: int
    response: int
    stall_mode: int
    stall_rpm: int
    stall_current_ma: int
    stall_time_ms: int
    reach_window: int

    @property
    def microsteps(self) -> int:
        """Microsteps a full step; the drive's 0 means 256."""
        return self.microstep_code or 256

    @property
    def bitrate(self) -> int | None:
        """CAN bit rate set in the menu (bit/s); None for an unknown code."""
        return CAN_BITRATES[self.can_code] if self.can_code < len(CAN_BITRATES) else None

    @property
    def full_steps(self) -> int | None:
        """Full steps a turn of the motor type that is set: 0x19 has 1.8 degrees a step, 0x32 0.9; None for another."""
        return {0x19: FULL_STEPS_PER_REVOLUTION, 0x32: 2 * FULL_STEPS_PER_REVOLUTION}.get(self.motor_type)


def block_of(answer: bytes | None) -> Block | None:
    """The block in a whole answer to `42 6C`, packets joined; None if it is not of the supported kind."""
    if answer is None or len(answer) != 4 + _BLOCK.size or answer[:1] + answer[1:3] != b"\x42" + BLOCK_HEAD:
        return None
    return Block(*_BLOCK.unpack(answer[3:-1]))


def write_block(block: Block, *, store: bool) -> bytes:
    """The command that writes a block; address and screen byte are sent as 0, which leaves them as they are.

    `store`: to flash, not to volatile memory only.
    """
    sent = replace(block, address=0, screen_off=0)
    data = _BLOCK.pack(*(getattr(sent, field.name) for field in fields(Block)))
    return b"\x48\xd1" + bytes((store,)) + data + bytes((CHECKSUM,))


def go_to(pulses: int, *, rpm: int, acc: int) -> bytes:
    """The command `FD`: go to an absolute position (pulses) at once, with a motor speed and a ramp byte."""
    target: Values = {MOVE_SIGN: pulses < 0, MOVE_RPM: rpm, MOVE_ACC: acc, MOVE_PULSES: abs(pulses)}
    return packed({FUNCTION: MOVE, **target, MOVE_MODE: ABSOLUTE, MOVE_END: CHECKSUM}, MOVE_BYTES)


def limit_current(current_ma: int) -> bytes:
    """The command `45 66`: limit the motor current in closed loop, in volatile memory."""
    return struct.pack(">BBBHB", 0x45, 0x66, 0, current_ma, CHECKSUM)


def write_watchdog(timeout_ms: int, *, store: bool) -> bytes:
    """The command that sets the watchdog's time (ms); 0 turns it off."""
    return b"\x68\x38" + bytes((store,)) + timeout_ms.to_bytes(4, "big") + bytes((CHECKSUM,))


def move_to(pulses: int, rpm: int, ramp: int) -> bytes:
    """The command `go_to` for a motor that turns alone: ramp byte 1 to 255 (1 the gentlest); raises ValueError."""
    if not 1 <= rpm <= HIGHEST_RPM or not 1 <= ramp <= 255 or abs(pulses) >= 1 << 32:
        raise ValueError(f"no drive is sent to {pulses} pulses at {rpm} rpm with ramp {ramp}")
    return go_to(pulses, rpm=rpm, acc=ramp)


def fast_setup(rpm: int, acc_byte: int) -> bytes:
    """The command `F1`: set speed and ramp for the targets that `FC` sends, and make them absolute (mode 01)."""
    return b"\xf1" + rpm.to_bytes(2, "big") + bytes((acc_byte, 1, 0, CHECKSUM))


def fast_target(pulses: int) -> bytes:
    """The command `FC`: go to a target (pulses) as `F1` has set it up."""
    return packed({FUNCTION: FAST_MOVE, FAST_PULSES: pulses, FAST_END: CHECKSUM}, FAST_BYTES)


def report_position(period_ms: int) -> bytes:
    """The command that lets a drive send the answer to `36` by itself every `period_ms` from now on; 0 ends that.

    The setting is lost with the power: the command has no byte for flash. Only drives of the X42S generation know it
    (6).
    """
    return b"\x11\x18" + ASK_POSITION[:1] + period_ms.to_bytes(2, "big") + bytes((CHECKSUM,))


REPORT_ACCEPTED = (b"\x11\x02\x6b", b"\x11\x6b")
"""Acknowledgements of `report_position`: the one that hardware sends, and the one in a manual."""


@dataclass(frozen=True)
class HomingParameters:
    """The homing parameters of `22`."""

    mode: int
    direction: int
    rpm: int
    timeout_ms: int
    collision_rpm: int
    collision_ma: int
    collision_ms: int
    at_power_up: int


def write_homing(parameters: HomingParameters) -> bytes:
    """The command that sets the homing parameters, in volatile memory."""
    data = _HOMING.pack(*(getattr(parameters, field.name) for field in fields(HomingParameters)))
    return b"\x4c\xae\x00" + data + bytes((CHECKSUM,))


def homing_of(answer: bytes | None) -> HomingParameters | None:
    """The parameters in a whole answer to `22`, packets joined; None for any other answer."""
    if answer is None or len(answer) != 2 + _HOMING.size or answer[0] != ASK_HOMING[0]:
        return None
    return HomingParameters(*_HOMING.unpack(answer[1:-1]))


@dataclass(frozen=True)
class Trip:
    """When a drive's protection trips: above a temperature, or above a current for some time."""

    temperature_c: int
    current_ma: int
    time_ms: int


def trip_of(answer: bytes | None) -> Trip | None:
    """The limits in an answer to `13`, whose fields are assumed to be those of the command that sets them, `D3 56`.

    None for any other answer.
    """
    if answer is None or len(answer) != 2 + _TRIP.size or answer[0] != ASK_TRIP[0]:
        return None
    return Trip(*_TRIP.unpack(answer[1:-1]))


@dataclass(frozen=True)
class Version:
    """Firmware and hardware version of a drive; `newer`: the drive's generation sends two bytes for each."""

    firmware: int
    hardware: int
    newer: bool

    def __str__(self) -> str:
        """The firmware version as it is usually written: 200 is 2.0.0."""
        return f"{self.firmware // 100}.{self.firmware // 10 % 10}.{self.firmware % 10}"

    @property
    def known(self) -> bool:
        """Whether drives with this firmware have the supported configuration block."""
        return self.firmware in KNOWN_FIRMWARE


def version_of(answer: bytes | None) -> Version | None:
    """The version in an answer to `1F`, one byte each on old drives, two on new ones; None for any other answer."""
    if answer is None or answer[0] != ASK_FIRMWARE[0] or len(answer) not in (4, 6):
        return None
    if len(answer) == 4:
        return Version(answer[1], answer[2], newer=False)
    firmware, hardware = struct.unpack(">HH", answer[1:5])
    return Version(firmware, hardware, newer=True)


def number_of(answer: bytes | None, question: bytes, size: int) -> int | None:
    """An unsigned number of `size` bytes behind the function byte; None for any other answer."""
    if answer is None or len(answer) != size + 2 or answer[0] != question[0]:
        return None
    return int.from_bytes(answer[1:-1], "big")


def signed_of(answer: bytes | None, question: bytes, size: int) -> int | None:
    """A number of `size` bytes behind the function byte and a sign byte; None for any other answer."""
    if answer is None or len(answer) != size + 3 or answer[0] != question[0] or answer[1] > 1:
        return None
    magnitude = int.from_bytes(answer[2:-1], "big")
    return -magnitude if answer[1] else magnitude
