"""The families of simulated drives as their makers' manuals let a host speak with them: a row for each.

Bytes stand here as the manuals print them or are put together by hand, never by the codecs of the control process:
the simulated drives judge those, and this judges the simulated drives.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from drive_bench import DriveBench, text

from sim.bus import Frame
from sim.drives import damiao, myactuator, odrive, robstride, vesc
from sim.drives.cia402 import Cia402Drive
from sim.drives.drive import Drive
from sim.drives.mks import MksDrive
from sim.drives.ramp import GRAINS_PER_REVOLUTION
from sim.drives.servo import Load
from sim.drives.zdt import ZdtDrive
from sim.drives.zdt_settings import Settings as ZdtSettings

TOP = 1.0
"""Speed at which the rows' targets are gone to [rev/s]."""
SILENCE_MS = 100
"""Silence of the host that those watchdogs bear that are set."""
TURN_RAD = 2.0 * math.pi

LOAD = Load(1e-3, 0.1, 10.0)
"""What servos move that are not tuned to another load."""
COASTS = LOAD.friction_nm / LOAD.inertia_kg_m2 / TURN_RAD
STEPPER_COASTS = 1000 / 60
"""A stepper that is let go loses 1 rpm a millisecond [rev/s²]."""

Frames = tuple[str, ...]
Ask = tuple[str, Callable[[bytes], float]]
"""A request, and the number in the data of its answer."""


@dataclass(frozen=True)
class Family:
    """One drive of a family, by its number on the bus; what a row does not say is as below."""

    arm: str  # an arm file whose first joint has such a drive with number 1
    make: Callable[..., Drive]  # a drive that stands at some turns and counts them; has options beside that
    mounted: dict[str, str] = field(default_factory=dict, kw_only=True)  # options of a `Mounting` that make it this one
    where_mounted: Ask | None = field(default=None, kw_only=True)  # its `where` then, if that comes round each turn
    enable: Callable[[float], Frames]  # lets it hold where it stands, which is told it [rev]
    go: Callable[[float], Frames]  # sends it to where it counts so much [rev], with `TOP`
    stop: Frames  # brakes it, and it goes on holding
    let_go: Frames  # disables it
    clear: Frames  # clears its errors
    where: Ask  # asks for its position [rev]
    status: Callable[[DriveBench], str]  # asks how it is, in words of its own
    says: dict[str, str]  # those words, see `words`
    silent: Frames = ()  # what it answers to what is no request
    sealed: Callable[[Frame], Frame] = lambda whole: whole  # puts a checksum where its protocol has one
    mailboxes: int | None = 16  # answers that wait at most; None for as many as it is asked for
    within: float = 1e-6  # how near to its target it ends [rev]
    climbs: float | None = None  # its ramp [rev/s²], if it has one
    brakes_s: float = 0.1  # most time that it takes from `TOP` to rest
    coasts: float = COASTS  # how fast it loses speed when it is let go [rev/s²]
    overshoots: float = 0.0  # how far it may go beyond its target [rev]; its speed is then its own, too
    holds_at_power: bool = False  # whether it holds its shaft when power comes
    obeys_limp: bool = False  # whether a target enables it
    keeps_target: bool = False  # whether it goes where it was told before it was enabled
    knows_its_angle: dict[str, bool] | None = field(default_factory=lambda: {"absolute": True})  # options, if it can
    boots_ms: float = 0.0  # time until it hears after power has come
    clears_ms: float = 0.0  # time that clearing an error takes
    ends_by_itself: Frames = ()  # causes whose error ends with them
    watched: dict[str, float] = field(default_factory=dict)  # options that set its watchdog
    watch: Frames = ()  # frames that set it
    feed: str = ""  # a frame that satisfies it; none where there is no watchdog
    feeds_not: str = ""  # one for this drive that does not
    reals: bool = False  # whether its targets are floating-point numbers
    zero: Frames = ()  # makes it count 0 where it stands, if it can
    zeroes_ms: float = 0.0  # time that takes
    volts: Ask | None = None  # asks for its supply [V], if that can be set
    celsius: Ask | None = None  # asks for its temperature [°C], if that can be set
    volatile: Frames = ()  # a write, a read, and the answer to that before the write: what power makes it forget
    renumber: str = ""  # makes it number 2, if it can

    @property
    def commands(self) -> Frames:
        """What a drive obeys that is sent to a turn's way off."""
        return (*self.enable(0.0), *self.go(1.0), *self.stop, *self.let_go, *self.clear)


class FamilyBench(DriveBench):
    """A drive of a family on a table."""

    def __init__(self, family: Family, turns: float = 0.0, **options: object) -> None:
        super().__init__(family.make(turns, **options))
        self.family = family

    def number(self, ask: Ask) -> float:
        """A number that it is asked for."""
        request, decoded = ask
        (answer,) = self.ask(request)
        return decoded(bytes.fromhex(answer.partition("# ")[2]))

    @property
    def where(self) -> float:
        """Where it says that it is [rev]."""
        return self.number(self.family.where)

    @property
    def rests(self) -> bool:
        """Whether its shaft does not turn, but for what is left of a loop that comes nearer and nearer."""
        return abs(self.turns_s) < 1e-6

    @property
    def status(self) -> str:
        """How it says that it is."""
        return self.family.status(self)

    def enable(self) -> FamilyBench:
        """Let it hold where it stands."""
        self.tell(*self.family.enable(self.where))
        self.heard()
        return self

    def restart(self, off_ms: float = 500.0) -> FamilyBench:
        """Take its power, and give it again until it hears."""
        return super().restart(off_ms).after(self.family.boots_ms)


def answered(*requests: str) -> Callable[[DriveBench], str]:
    """A status that is the second byte of each answer."""

    def status(bench: DriveBench) -> str:
        return " ".join(bench.ask(request)[0].partition("# ")[2][3:5] for request in requests)

    return status


def words(*said: str) -> dict[str, str]:
    """What a status is while the drive is limp, holds, had each error, got its power, and had a silent host."""
    return dict(zip(("limp", "holding", "stall", "temperature", "current", "power", "silence"), said, strict=False))


def floats(*values: float) -> str:
    """Numbers as little-endian singles, in hexadecimal."""
    return struct.pack(f"<{len(values)}f", *values).hex(" ")


def word(value: int, size: int = 4) -> str:
    """A whole number with its sign, little-endian, in hexadecimal."""
    return value.to_bytes(size, "little", signed=True).hex(" ")


def zdt(node: int, firmware: str = "new") -> Family:
    """Emm_V5 (the maker's manuals V1.0.3 and V1.0.5): 3200 pulses and 65536 counts to the turn."""
    head = f"{node << 8:08X}#"

    def go(turns: float) -> Frames:
        # 60 rpm, 246: 1 rpm in 10 steps of 50 us; absolute, at once.
        sign, pulses = int(turns < 0), f"{abs(round(turns * 3200)):08X}"
        return f"{head} FD {sign:02X} 00 3C F6 {pulses[:6]}", f"{node << 8 | 1:08X}# FD {pulses[6:]} 01 00 6B"

    def make(turns: float, **options: object) -> Drive:
        return ZdtDrive(ZdtSettings(address=node), position_pulses=round(turns * 3200), firmware=firmware, **options)

    new = firmware == "new"
    return Family(
        arm="episode1",
        make=make,
        enable=lambda here: (f"{head} F3 AB 01 00 6B",),
        go=go,
        stop=(f"{head} FE 98 00 6B",),
        let_go=(f"{head} F3 AB 00 00 6B",),
        clear=(f"{head} 0E 52 6B",),
        where=(f"{head} 36 6B", lambda data: (-1) ** data[1] * int.from_bytes(data[2:6], "big") / 65536),
        status=answered(f"{head} 3A 6B", f"{head} 3B 6B"),
        says=words("02 03", "03 03", "0D 03", "0B 13", "0B 23", "83 03" if new else "03 03", "03 03"),
        silent=(f"{head} 00 EE 6B",),
        sealed=lambda whole: whole._replace(data=whole.data[:-1] + b"\x6b"),
        climbs=20_000 / 10 / 60,
        brakes_s=0.0,
        coasts=STEPPER_COASTS,
        mailboxes=None,
        holds_at_power=True,
        knows_its_angle=None,
        watch=(f"{head} 68 38 00 00 00 00 64 6B",) if new else (),
        feed=f"{head} 3A 6B" if new else "",
        zero=(f"{head} 0A 6D 6B",),
        volatile=(f"{head} 68 38 00 00 00 13 88 6B", f"{head} 16 6B", f"{head} 16 00 00 00 00 6B") if new else (),
        renumber=f"{head} AE 4B 00 02 6B",
    )


def mks(node: int) -> Family:
    """SERVO42D (the maker's manual V1.0.6): 16384 counts to the turn, the last byte is the sum of all before it."""

    def told(*data: int) -> str:
        return text(sealed(Frame(node, bytes((*data, 0)), extended=False)))

    def sealed(whole: Frame) -> Frame:
        *data, _ = whole.data or b"\0"
        return whole._replace(data=bytes((*data, (whole.can_id + sum(data)) & 0xFF)))

    def make(turns: float, **options: object) -> Drive:
        settings = {0x82: b"\x05", 0x8B: node.to_bytes(2, "big")}
        return MksDrive(settings, position=round(turns * GRAINS_PER_REVOLUTION), **options)

    return Family(
        arm="mks6",
        make=make,
        enable=lambda here: (told(0xF3, 1),),
        go=lambda turns: (told(0xF5, 0, 60, 246, *round(turns * 16384).to_bytes(3, "big", signed=True)),),
        stop=(told(0xF7),),
        let_go=(told(0xF3, 0),),
        clear=(told(0x3D),),
        where=(told(0x31), lambda data: int.from_bytes(data[1:7], "big", signed=True) / 16384),
        status=answered(told(0x3A), told(0x3E)),
        says=words("00 00", "01 00", "00 01", "00 01", "00 01", "00 00"),
        sealed=sealed,
        climbs=20_000 / 10 / 60,
        brakes_s=0.0,
        coasts=STEPPER_COASTS,
        knows_its_angle=None,
        zero=(told(0x92),),
        renumber=told(0x8B, 0, 2),
    )


def odrives(node: int) -> Family:
    """ODrive 0.5.6 (its CANSimple page): trapezoids, by a heartbeat every 100 ms; positions are revolutions.

    Where it is its count says (0A): its estimates say nothing before its loop was closed.
    """

    def head(command: int) -> str:
        return f"{node << 5 | command:03X}#"

    def make(turns: float, *, seed: int = 0, **options: object) -> Drive:
        settings = odrive.Settings(node_id=node, heartbeat_ms=100, estimates_ms=0, top=20.0, ramp=20.0, **options)
        return odrive.OdriveDrive(settings, turns=turns, load=LOAD, seed=seed)

    def beat(bench: DriveBench) -> str:
        beats = [said for said in bench.wait(100) if said.startswith(head(0x01))]
        error, state, motor, _, controller = struct.unpack("<I4B", bytes.fromhex(beats[-1][5:]))
        # Without bit 0: a state was asked for that it cannot take, as one is while there is an error.
        return f"{error & ~1:X} {state} {motor:02X} {controller:02X}"

    return Family(
        arm="odrive6",
        make=make,
        enable=lambda here: (
            f"{head(0x0B)} 03 00 00 00 05 00 00 00",
            f"{head(0x11)} {floats(TOP)}",
            f"{head(0x12)} {floats(20.0, 20.0)}",
            f"{head(0x07)} 08 00 00 00",
        ),
        go=lambda turns: (f"{head(0x0B)} 03 00 00 00 05 00 00 00", f"{head(0x0C)} {floats(turns)} 00 00 00 00"),
        stop=(f"{head(0x0B)} 02 00 00 00 02 00 00 00", f"{head(0x0D)} {floats(0.0, 0.0)}"),
        let_go=(f"{head(0x07)} 01 00 00 00",),
        clear=(f"{head(0x18)}",),
        where=(f"{head(0x0A)} remote", lambda data: struct.unpack("<ii", data)[0] / 8192),
        status=beat,
        says=words("0 1 00 80", "0 8 00 80", "200 1 00 81", "40000 1 00 80", "40 1 01 80", "0 1 00 80", "800 1 00 80"),
        climbs=20.0,
        watched={"watchdog_s": SILENCE_MS * 1e-3},
        reals=True,
        feed=f"{head(0x01)}",
        zero=(f"{head(0x19)} 00 00 00 00",),
        volts=(f"{head(0x17)} remote", lambda data: struct.unpack("<ff", data)[0]),
        renumber=f"{head(0x06)} 02 00 00 00",
    )


def odrives_0_6(node: int) -> Family:
    """The same with firmware 0.6 (can_simple_messages.hpp and odrive_enums.h in odriverobotics/ros_odrive)."""
    older = odrives(node)

    def beat(bench: DriveBench) -> str:
        beats = [said for said in bench.wait(100) if said.startswith(f"{node << 5 | 0x01:03X}#")]
        error, state, _, done, nothing = struct.unpack("<I4B", bytes.fromhex(beats[-1][5:]))
        return f"{error:X} {state} {done} {nothing}"

    return replace(
        older,
        make=partial(older.make, firmware="0.6"),
        mounted={"odrive_firmware": "0.6"},
        where=(f"{node << 5 | 0x09:03X}# remote", lambda data: struct.unpack("<ff", data)[0]),
        status=beat,
        says=words("0 1 1 0", "0 8 1 0", "4000000 1 1 0", "2000 1 1 0", "1000 1 1 0", "0 1 1 0", "1000000 1 1 0"),
        zero=(),
        renumber="",
    )


def _damiao(node: int, mode: int, **row: object) -> Family:
    """What its modes share: the ends of commands (FC, FD, FE, FB), and registers on 7FF."""

    def state(last: int) -> Frames:
        return (f"{node:03X}# FF FF FF FF FF FF FF {last:02X}",)

    def register(number: int) -> Ask:
        return f"7FF# {node:02X} 00 33 {number:02X} 00 00 00 00", lambda data: struct.unpack("<f", data[4:])[0]

    def make(turns: float, *, seed: int = 0, absolute: bool = False, timeout: int = 0) -> Drive:
        held = {damiao.CTRL_MODE: mode, damiao.ESC_ID: node, damiao.MST_ID: 0x10 + node, damiao.TIMEOUT: timeout}
        held |= {damiao.VMAX: 10.0, damiao.TMAX: 28.0}
        return damiao.DamiaoDrive(held, absolute=absolute, turns=turns, load=LOAD, seed=seed)

    request, decoded = register(81)
    how = f"7FF# {node:02X} 00 CC 00"
    return Family(
        make=make,
        enable=lambda here: state(0xFC),
        let_go=state(0xFD),
        clear=state(0xFB),
        where=(request, lambda data: decoded(data) / TURN_RAD),
        status=lambda bench: bench.ask(how)[0][5:7],
        says=words(*(f"{code}{node}" for code in "01ECA0D")),
        watched={"timeout": SILENCE_MS * 20},
        feed=state(0xFC)[0],
        feeds_not=how,
        zero=state(0xFE),
        volts=register(60),
        celsius=register(62),
        volatile=(
            f"7FF# {node:02X} 00 55 04 {floats(3.0)}",
            f"7FF# {node:02X} 00 33 04 00 00 00 00",
            f"{0x10 + node:03X}# {node:02X} 00 33 04 00 00 A0 41",
        ),
        renumber=f"7FF# {node:02X} 00 55 08 02 00 00 00",
        **row,
    )


def damiao_position_velocity(node: int) -> Family:
    """A DM4340 that goes to targets by trapezoids (damiao-motor 1.0.6)."""

    def go(turns: float, turns_s: float = TOP) -> Frames:
        return (f"{0x100 + node:03X}# {floats(turns * TURN_RAD, turns_s * TURN_RAD)}",)

    # Ramps of 20 rad/s².
    row = {"climbs": 20.0 / TURN_RAD, "brakes_s": 0.4, "within": 1e-5, "reals": True}
    return _damiao(node, 2, arm="damiao6_pv", go=go, stop=go(0.0, 0.0), **row)


def damiao_mit(node: int) -> Family:
    """The same led by stiffness and damping: kp 10 and kd 2, and damping of 5 alone for a stop."""

    def go(turns: float) -> Frames:
        code = round((turns * TURN_RAD + 12.5) * 65535 / 25.0)
        return (f"{node:03X}# {code >> 8:02X} {code & 0xFF:02X} 7F F0 51 66 67 FF",)

    # What friction and the steps of torque and speed leave of 10 N·m/rad, and a step of the position.
    within = ((LOAD.friction_nm + 28.0 / 4095 + 2.0 * 10.0 / 4095) / 10.0 + 25.0 / 65535) / TURN_RAD
    stop = (f"{node:03X}# 7F FF 7F F0 00 FF F7 FF",)
    return _damiao(node, 1, arm="damiao6", go=go, stop=stop, within=within, overshoots=0.02)


def cia402(node: int) -> Family:
    """CiA 402 in profile position by SDO alone: 131072 counts to the turn."""
    counts, sdo = 131_072, f"{0x600 + node:03X}#"

    def put(index: int, value: int, size: int) -> str:
        command = {1: "2F", 2: "2B", 4: "23"}[size]
        return f"{sdo} {command} {index & 0xFF:02X} {index >> 8:02X} 00 {word(value, size)}" + " 00" * (4 - size)

    def get(index: int) -> str:
        return f"{sdo} 40 {index & 0xFF:02X} {index >> 8:02X} 00 00 00 00 00"

    def control(*words: int) -> Frames:
        return tuple(put(0x6040, one, 2) for one in words)

    def make(turns: float, **options: object) -> Drive:
        return Cia402Drive(node, counts=counts, turns=turns, load=LOAD, **options)

    def status(bench: DriveBench) -> str:
        state, error = (bytes.fromhex(bench.ask(get(index))[0][5:])[4:6] for index in (0x6041, 0x603F))
        return f"{state[0] & 0x6F:02X} {int.from_bytes(error, 'little'):04X}"

    speeds = tuple(put(index, value * counts, 4) for index, value in ((0x6081, 1), (0x6083, 20), (0x6084, 20)))
    return Family(
        arm="cia402_6",
        make=make,
        enable=lambda here: (put(0x6060, 1, 1), *speeds, *control(0x06, 0x07, 0x0F)),
        go=lambda turns: (*control(0x0F), put(0x607A, round(turns * counts), 4), *control(0x1F)),
        stop=control(0x10F),
        let_go=control(0x00),
        clear=control(0x00, 0x80),
        where=(get(0x6064), lambda data: int.from_bytes(data[4:], "little", signed=True) / counts),
        status=status,
        says=words("40 0000", "27 0000", "08 7121", "08 4310", "08 2310", "40 0000", "08 8100"),
        climbs=20.0,
        boots_ms=200,
        # The host's heartbeat, number 7F, is awaited in operation, from its first one on.
        watch=(f"000# 01 {node:02X}", f"{sdo} 23 16 10 01 {word(SILENCE_MS, 2)} 7F 00", "77F# 05"),
        feed="77F# 05",
        feeds_not=get(0x6041),
        volatile=(put(0x6081, 5, 4), get(0x6081), f"{0x580 + node:03X}# 43 81 60 00 00 00 14 00"),
    )


def myactuators(node: int) -> Family:
    """RMD V3 (Motor Motion Protocol V4.2): hundredths of a degree, ramps of 10,000 dps/s; a restart clears errors."""

    def told(*data: int) -> str:
        return f"{0x140 + node:03X}# " + bytes(data).ljust(8, b"\0").hex(" ").upper()

    def make(turns: float, *, seed: int = 0, **options: object) -> Drive:
        settings = myactuator.Settings(motor_id=node, **options)
        return myactuator.MyactuatorDrive(settings, turns=turns, load=LOAD, seed=seed)

    def status(bench: DriveBench) -> str:
        mode, how = (bytes.fromhex(bench.ask(told(code))[0][5:]) for code in (0x70, 0x9A))
        return f"{mode[7] > 0:d} {int.from_bytes(how[6:], 'little'):04X}"

    return Family(
        arm="myactuator6",
        make=make,
        enable=lambda here: (told(0xA2),),
        go=lambda turns: (f"{0x140 + node:03X}# A4 00 68 01 {word(round(turns * 36000))}",),
        stop=(told(0x81),),
        let_go=(told(0x80),),
        clear=(told(0x76),),
        where=(told(0x92), lambda data: int.from_bytes(data[4:], "little", signed=True) / 36000),
        status=status,
        says=words("0 0000", "1 0000", "0 0002", "0 1000", "0 0010", "0 0000", "0 0000"),
        within=1e-5,
        climbs=10_000 / 360,
        obeys_limp=True,
        clears_ms=2000,
        ends_by_itself=("temperature",),
        watch=(told(0xB3, 0, 0, 0, SILENCE_MS),),
        feed=told(0x92),
        zero=(told(0x64), told(0x76)),
        zeroes_ms=2000,
        volts=(told(0x9A), lambda data: int.from_bytes(data[4:6], "little") / 10),
        celsius=(told(0x9A), lambda data: data[1]),
    )


def _robstride(node: int, *, planner: bool) -> Family:
    """What both kinds share: their own position control (run mode 1), told by parameters, by host AA."""
    speed = 0x7024 if planner else 0x7017

    def told(kind: int, data: str = "00 00 00 00 00 00 00 00") -> str:
        return f"{kind:02X}00AA{node:02X}# {data}"

    def put(index: int, value: float) -> str:
        return told(0x12, f"{index & 0xFF:02X} {index >> 8:02X} 00 00 {floats(value)}")

    def get(index: int) -> Ask:
        request = told(0x11, f"{index & 0xFF:02X} {index >> 8:02X} 00 00 00 00 00 00")
        return request, lambda data: struct.unpack("<f", data[4:])[0]

    def make(turns: float, *, seed: int = 0, **options: object) -> Drive:
        settings = robstride.Settings(motor_id=node, robstride=planner, **options)
        return robstride.RobstrideDrive(settings, turns=turns, load=LOAD, seed=seed)

    def status(bench: DriveBench) -> str:
        (feedback,) = bench.ask(put(0x7018, 23.0))  # a limit of current, as it was
        flags = int(feedback[2:4], 16)
        return f"{flags >> 6} {flags & 0x3F:02X}"

    def go(turns: float) -> Frames:
        return put(speed, TOP * TURN_RAD), put(0x7016, turns * TURN_RAD)

    request, decoded = get(0x7019)
    return Family(
        arm="robstride6_position",
        make=make,
        # It goes where it was told last, so that comes first.
        enable=lambda here: (told(0x12, "05 70 00 00 01 00 00 00"), *go(here), told(0x03)),
        go=go,
        stop=(put(speed, 0.0),),
        let_go=(told(0x04),),
        clear=(told(0x04, "01 00 00 00 00 00 00 00"),),
        where=(request, lambda data: decoded(data) / TURN_RAD),
        status=status,
        says=words("0 00", "2 00", "0 10", "0 04", "0 02", "0 00"),
        keeps_target=True,
        reals=True,
        climbs=10.0 / TURN_RAD if planner else None,
        brakes_s=0.7 if planner else 0.2,
        zero=(told(0x06, "01 00 00 00 00 00 00 00"),),
        volts=get(0x701C),
        volatile=(put(0x7017, 5.0), get(0x7017)[0], f"1100{node:02X}AA# 17 70 00 00 00 00 00 40"),
        renumber=f"0702AA{node:02X}# 01 00 00 00 00 00 00 00",
    )


def vescs(node: int) -> Family:
    """VESC (comm_can.c and commands.c in vedderb/bldc at b9d287b3), its encoder behind a gear of 16."""
    gear, host = 16, 0x80 + node

    def told(packet: int, number: int) -> str:
        return f"{packet << 8 | node:08X}# {number.to_bytes(4, 'big', signed=True).hex(' ')}"

    def asked(mask: str) -> str:
        return f"{8 << 8 | node:08X}# {host:02X} 00 32 {mask}"

    def make(turns: float, *, seed: int = 0, absolute: bool = False, timeout_ms: int = 0) -> Drive:
        # critically damped at 12 rad/s
        tuned = {"stiffness_nm": 144e-3 * TURN_RAD, "damping_nm_s": 24e-3 * TURN_RAD}
        settings = vesc.Settings(node, absolute, gear, timeout_ms, position_hz=0, others_hz=0, **tuned)
        return vesc.VescDrive(settings, turns=turns, load=LOAD, seed=seed)

    def go(turns: float) -> Frames:
        return (told(4, round(turns / gear % 1.0 * 360e6)),)

    def place(data: bytes, turn: float) -> float:
        return math.remainder(int.from_bytes(data, "big") / 360e5, 1.0) * turn

    def status(bench: DriveBench) -> str:
        return " ".join(bench.ask(asked(mask))[0][-2:] for mask in ("00 00 80 00", "00 20 00 00"))

    return Family(
        arm="vesc6",
        make=make,
        enable=go,
        go=go,
        stop=(told(2, 20_000),),
        let_go=(told(1, 0),),
        clear=(),
        where=(told(56, 0), partial(place, turn=gear)),
        where_mounted=(told(56, 0), partial(place, turn=1)),
        status=status,
        says=words("00 00", "00 00", "1E 00", "06 00", "04 00", "00 00", "00 01"),
        obeys_limp=True,
        overshoots=0.3,
        clears_ms=600,
        ends_by_itself=("stall", "temperature", "current"),
        watched={"timeout_ms": SILENCE_MS},
        feed=f"{8 << 8 | node:08X}# {host:02X} 00 1E",
        feeds_not=asked("00 00 80 00"),
    )


def cybergear(node: int) -> Family:
    """A Xiaomi CyberGear: a position loop within a limit of speed."""
    return _robstride(node, planner=False)


def robstrides(node: int) -> Family:
    """A RobStride: trapezoids with a ramp of 10 rad/s²."""
    return _robstride(node, planner=True)


def zdt_of_old(node: int) -> Family:
    """Emm_V5.0 (manual Rev 1.3): no watchdog, and no flag for lost power."""
    return zdt(node, "old")


FAMILIES = (
    zdt,
    zdt_of_old,
    mks,
    odrives,
    odrives_0_6,
    damiao_position_velocity,
    damiao_mit,
    cia402,
    myactuators,
    cybergear,
    robstrides,
    vescs,
)
