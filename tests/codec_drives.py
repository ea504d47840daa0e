"""What drives of each family make of a command, and how they say where they are: from the protocols' notes alone.

Angles, speeds and torques are those of the drive's own shaft.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

TURN = 2 * math.pi
RPM = TURN / 60
DEGREE = math.radians(1)


class Command(NamedTuple):
    """Where to (rad) and how fast: at most, or as the motion goes on; NaN where that is not said (rad/s)."""

    rad: float
    rad_s: float = math.nan


class Said(NamedTuple):
    """Frames, and what exactly they say: a field holds no more."""

    frames: tuple[str, ...]
    rad: float
    rad_s: float = math.nan
    nm: float = math.nan
    celsius: float = math.nan


@dataclass(frozen=True)
class Drive:
    """A drive of address 1 in `tests/golden`.

    Attributes:
        reads: the data of the frames that lead it.
        says: its angle, speed, torque and temperature.
        is_position: whether a frame with its identifiers (data frames; identifier, data) tells its angle.
        gears: three ratios that suit it.
        off_rad: by how much an angle in a command may be off.
        step_rad_s: of the speed in a command.
        plans: it goes to its target by itself, at the speed that it is told at most.
        rounds: speeds are whole numbers of its step.
        acc: byte of a command that holds its ramp, 0 for none.
        loop_s: its own position loop slows down so many seconds before the target.
        comes_round: its angles come round each turn of its shaft, in commands and readings.
        is_asked: for its angle, which comes by itself otherwise.
    """

    reads: Callable[[list[bytes]], Command]
    says: Callable[[float, float, float, int], Said]
    is_position: Callable[[int, bytes], bool]
    gears: tuple[float, float, float]
    off_rad: float
    step_rad_s: float = math.nan
    plans: bool = False
    rounds: bool = False
    acc: int = 0
    loop_s: float = 0.0
    comes_round: bool = False
    is_asked: bool = True


def hexed(identifier: str, data: bytes) -> str:
    return f"{identifier}# {data.hex(' ').upper()}"


def of_field(code: int, bits: int, most: float) -> float:
    return code * 2 * most / ((1 << bits) - 1) - most


def coded(value: float, bits: int, most: float) -> tuple[int, float]:
    """A field, and the number that it holds."""
    code = round((min(max(value, -most), most) + most) / (2 * most) * ((1 << bits) - 1))
    return code, of_field(code, bits, most)


def finite(*values: float) -> bool:
    return all(map(math.isfinite, values))


# --- ZDT: FD direction rpm16 acc pulses32 mode sync 6B, in two packets; 36 sign counts32 6B


def zdt_reads(frames: list[bytes]) -> Command:
    first, second = frames
    whole = first + second[1:]
    assert (len(first), len(second)) == (8, 5) and first[0] == second[0] == 0xFD
    assert whole[1] in (0, 1) and whole[9:] == b"\x01\x00\x6b"  # absolute, at once
    pulses = int.from_bytes(whole[5:9], "big") * (-1 if whole[1] else 1)
    return Command(pulses / 3200 * TURN, int.from_bytes(whole[2:4], "big") * RPM)


def zdt_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    counts = round(rad / TURN * 65536)
    data = bytes((0x36, counts < 0)) + abs(counts).to_bytes(4, "big") + b"\x6b"
    return Said((hexed("00000100", data),), counts / 65536 * TURN)


def zdt_is_position(identifier: int, data: bytes) -> bool:
    return identifier == 0x100 and len(data) == 7 and data[0] == 0x36 and data[1] <= 1 and data[6] == 0x6B


# --- MKS: F5 rpm16 acc counts24 sum; 31 counts48 sum


def mks_sum(data: bytes) -> int:
    return (1 + sum(data)) & 0xFF


def mks_reads(frames: list[bytes]) -> Command:
    (data,) = frames
    assert len(data) == 8 and data[0] == 0xF5 and data[7] == mks_sum(data[:7])
    counts = int.from_bytes(data[4:7], "big", signed=True)
    return Command(counts / 16384 * TURN, int.from_bytes(data[1:3], "big") * RPM)


def mks_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    counts = round(rad / TURN * 16384)
    data = b"\x31" + counts.to_bytes(6, "big", signed=True)
    return Said((hexed("001", data + bytes((mks_sum(data),))),), counts / 16384 * TURN)


def mks_is_position(identifier: int, data: bytes) -> bool:
    return identifier == 1 and len(data) == 8 and data[0] == 0x31 and data[7] == mks_sum(data[:7])


# --- ODrive: 0C float turns, int16 0.001 turns/s, int16 torque; 09 float turns, turns/s; 14 float currents (A)


def odrive_reads(frames: list[bytes]) -> Command:
    turns, milliturns_s, torque = struct.unpack("<fhh", *frames)
    assert torque == 0
    return Command(turns * TURN, milliturns_s / 1000 * TURN)


def odrive_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    estimates, currents = struct.pack("<ff", rad / TURN, rad_s / TURN), struct.pack("<ff", 99.0, nm / 0.08)
    turns, turns_s = struct.unpack("<ff", estimates)
    closed = hexed("021", struct.pack("<IB", 0, 8) + bytes(3))  # without that zeros would be no position
    frames = (closed, hexed("029", estimates), hexed("034", currents))
    return Said(frames, turns * TURN, turns_s * TURN, struct.unpack("<ff", currents)[1] * 0.08)


def odrive_is_position(identifier: int, data: bytes) -> bool:
    # zeros are what 0.5.6 says before its first closed loop
    return identifier == 0x029 and len(data) == 8 and any(data) and finite(*struct.unpack("<ff", data))


# --- Damiao: rad16 rad_s12 kp12 kd12 nm12, or two floats; status4 id4 rad16 rad_s12 nm12 celsius8 celsius8


def damiao_mit_reads(frames: list[bytes]) -> Command:
    packed = int.from_bytes(*frames, "big")
    assert (packed >> 24 & 0xFFF, packed >> 12 & 0xFFF) == (200 * 4095 // 500, 4 * 4095 // 5)
    return Command(of_field(packed >> 48, 16, 12.5), of_field(packed >> 36 & 0xFFF, 12, 10.0))


def two_floats(frames: list[bytes]) -> Command:
    return Command(*struct.unpack("<ff", *frames))


def damiao_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    (place, rad), (speed, rad_s), (torque, nm) = coded(rad, 16, 12.5), coded(rad_s, 12, 10.0), coded(nm, 12, 28.0)
    data = b"\x11" + (place << 24 | speed << 12 | torque).to_bytes(5, "big") + bytes((0, abs(celsius)))
    return Said((hexed("011", data),), rad, rad_s, nm, abs(celsius))


def damiao_is_position(identifier: int, data: bytes) -> bool:
    """Not an answer about a register: motor, 0, and whether it was read, written or stored."""
    of_register = data[:2] == b"\x01\x00" and data[2:3] in (b"\x33", b"\x55", b"\xaa")
    return identifier == 0x011 and len(data) == 8 and data[0] & 15 == 1 and not of_register


# --- RobStride: rad16 rad_s16 kp16 kd16, or parameters 7017 and 7016; type 2: rad16 rad_s16 nm16 0.1 °C


def robstride_control_reads(frames: list[bytes]) -> Command:
    rad, rad_s, stiffness, damping = struct.unpack(">HHHH", *frames)
    assert (stiffness, damping) == (30 * 65535 // 500, 65535 // 5)
    return Command(of_field(rad, 16, 2 * TURN), of_field(rad_s, 16, 30.0))


def robstride_position_reads(frames: list[bytes]) -> Command:
    (speed, rad_s), (target, rad) = (struct.unpack("<Hxxf", data) for data in frames)
    assert (speed, target) == (0x7017, 0x7016)
    return Command(rad, rad_s)


def robstride_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    (place, rad), (speed, rad_s), (torque, nm) = coded(rad, 16, 2 * TURN), coded(rad_s, 16, 30.0), coded(nm, 16, 12.0)
    data = struct.pack(">HHHh", place, speed, torque, celsius * 7)
    return Said((hexed("028001AA", data),), rad, rad_s, nm, celsius * 0.7)


def robstride_is_position(identifier: int, data: bytes) -> bool:
    if len(data) != 8 or identifier & 0xFFFF != 0x01AA:
        return False
    index, value = struct.unpack("<Hxxf", data)
    kind, faults = identifier >> 24, identifier >> 16 & 0xFF
    return kind == 2 or (kind == 17 and faults == 0 and index == 0x7019 and finite(value))


# --- MyActuator: A4 0 dps16 0.01° of 32 bits; 92 0.01°; A4 °C8 0.01 A16 dps16 degrees16


def myactuator_reads(frames: list[bytes]) -> Command:
    command, nothing, dps, angle = struct.unpack("<BBHi", *frames)
    assert (command, nothing) == (0xA4, 0)
    return Command(angle / 100 * DEGREE, dps * DEGREE)


def myactuator_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    angle, dps, current = round(rad / DEGREE * 100), round(rad_s / DEGREE), round(nm / 2.0 * 100)
    feedback = struct.pack("<Bbhhh", 0xA4, celsius, current, dps, 0)
    frames = (hexed("241", struct.pack("<Bxxxi", 0x92, angle)), hexed("241", feedback))
    return Said(frames, angle / 100 * DEGREE, dps * DEGREE, current / 100 * 2.0, celsius)


def myactuator_is_position(identifier: int, data: bytes) -> bool:
    return identifier == 0x241 and len(data) == 8 and data[0] == 0x92


# --- CiA 402: controlword16 counts32; statusword16 counts32 0.001 of the rated torque16


def cia402_reads(frames: list[bytes]) -> Command:
    controlword, counts = struct.unpack("<Hi", *frames)
    assert controlword == 0x0F
    return Command(counts / 131_072 * TURN)


def cia402_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    counts, thousandths = round(rad / TURN * 131_072), max(min(round(nm / 0.32 * 1000), 32767), -32768)
    data = struct.pack("<Hih", 0x1637, counts, thousandths)
    return Said((hexed("181", data),), counts / 131_072 * TURN, nm=thousandths / 1000 * 0.32)


def cia402_is_position(identifier: int, data: bytes) -> bool:
    return identifier == 0x181 and len(data) == 8


# --- VESC: 4 1e-6 degrees of 32 bits, big-endian; 16 0.1 °C16 0.1 °C16 0.1 A16 degrees/50 of 16 bits


def vesc_reads(frames: list[bytes]) -> Command:
    (millionths,) = struct.unpack(">i", *frames)
    assert 0 <= millionths <= 360_000_000
    return Command(millionths / 1e6 * DEGREE)


def vesc_says(rad: float, rad_s: float, nm: float, celsius: int) -> Said:
    fiftieths = round(rad / DEGREE * 50)
    data = struct.pack(">hhhh", celsius * 10 - 1, celsius * 10, -7, fiftieths % 18_000)
    return Said((hexed("00001001", data),), fiftieths / 50 * DEGREE, celsius=celsius)


def vesc_is_position(identifier: int, data: bytes) -> bool:
    return identifier == 0x1001 and len(data) == 8 and int.from_bytes(data[6:], "big") <= 18_000


STEPPER, DIRECT, ANY = (1.0, 20.0, 50.0), (0.5, 1.0, 2.0), (0.5, 2.0, 50.0)
DRIVES: dict[tuple[str, str], Drive] = {
    ("zdt", "usual"): Drive(zdt_reads, zdt_says, zdt_is_position, STEPPER, TURN / 6400, RPM, True, True, acc=4),
    ("mks", "usual"): Drive(mks_reads, mks_says, mks_is_position, STEPPER, TURN / 32768, RPM, True, True, acc=3),
    ("odrive", "usual"): Drive(odrive_reads, odrive_says, odrive_is_position, ANY, 2e-5, TURN / 1000),
    ("damiao", "mit"): Drive(damiao_mit_reads, damiao_says, damiao_is_position, DIRECT, 25 / 65535, 20 / 4095),
    ("damiao", "position_velocity"): Drive(two_floats, damiao_says, damiao_is_position, DIRECT, 1e-6, 1e-6, True),
    ("robstride", "control"): Drive(
        robstride_control_reads, robstride_says, robstride_is_position, DIRECT, 4 * TURN / 65535, 60 / 65535
    ),
    ("robstride", "position"): Drive(
        robstride_position_reads, robstride_says, robstride_is_position, DIRECT, 1e-6, 1e-6, True, loop_s=1 / 30
    ),
    ("myactuator", "usual"): Drive(
        myactuator_reads, myactuator_says, myactuator_is_position, ANY, DEGREE / 200, DEGREE, True, True
    ),
    ("vesc", "usual"): Drive(
        vesc_reads, vesc_says, vesc_is_position, (0.25, 0.5, 1.0), 1e-6 * DEGREE, comes_round=True, is_asked=False
    ),
    ("cia402", "usual"): Drive(cia402_reads, cia402_says, cia402_is_position, ANY, TURN / 262_144),
}
"""By family and joint in its file."""
