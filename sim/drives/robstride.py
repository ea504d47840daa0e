"""A RobStride motor or Xiaomi CyberGear on CAN, from its frames to its shaft.

Written from other-drives.md, the CyberGear's manual (belovictor/cybergear-docs) and, for RobStrides, the maker's
RobStride/Python_Sample (run modes) and manuals of 2026 (RobStride/Product_Information: counting); [inf] marks what none
of them says and is assumed here: a host should not depend on it.

Modelled:
- Identifiers: extended, type << 24 | data16 << 8 | for whom. Get id (0), set-point with gains (1), feedback (2), enable
  (3), stop and clear (4), set zero (6), set id (7), read (17) and write (18) a parameter, fault (21), save (22). [inf]
  Frames that are not of 8 bytes change nothing and meet silence; a fault is said once, to the host that spoke last,
  with the motor in bits 8 to 15 as in feedback. A parameter that it does not know RobStrides answer with a 1 in bits 16
  to 23; [inf] CyberGears are silent.
- Type 22 lets RobStrides store their parameters (01 to 08 in its bytes), and sets the bit rate of CyberGears (byte 0,
  from the next power on), which is only noted here.
- States: reset and run. A motor with a fault does not run. [inf] Its run mode is changed while it is stopped only. What
  it was told last stays when it is stopped, so that enabling it again would act on that; power makes it forget.
- Run modes: 0 set-points with gains, 1 its own position loop within a speed limit (CyberGear) or a trapezoid with a
  ramp of its own (RobStrides), 5 the former on RobStrides, 2 speed, 3 current.
- Numbers of 16 bits are cut off to whole steps; positions beyond the range stay at its end, those that RobStrides tell
  go on at its other end. Parameter 7019 goes on in both.
- The encoder counts from 0 where it stands when power comes, or goes on, if it is absolute; that of RobStrides within a
  turn, 0 to 2π or -π to π as zero_sta (7029) says, which is read only here. Zero is set where it stands; [inf] what it
  was told stays, and then means the new count.

Not modelled: calibration, bit rates, timeouts, filters, the question for its version (type 4), reports by itself.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from config.drives.robstride import RobstrideDrive as RobstrideConfig
from sim.bus import Frame
from sim.drives.conversation import ServoDrive
from sim.drives.drive import Cause, Mounting
from sim.drives.servo import TURN_RAD, Cascade, Law, Limp, Load, Plan, Torque

TYPE_BIT, MODE_BIT, FAULT_BIT = 24, 22, 16
GET_ID, CONTROL, FEEDBACK, ENABLE, STOP, SET_ZERO, SET_ID, READ, WRITE, FAULT, SAVE = (
    0,
    1,
    2,
    3,
    4,
    6,
    7,
    17,
    18,
    21,
    22,
)
RESET, RUN = 0, 2
ANYBODY = 0xFE
"""For whom a motor says its id."""
RUN_MODE, LIMIT_TORQUE, CAN_TIMEOUT, ZERO_STA, ADD_OFFSET = 0x7005, 0x700B, 0x7028, 0x7029, 0x702B
STORED = (LIMIT_TORQUE, 0x7017, 0x7018, 0x701E, 0x7024, 0x7025)
"""Parameters that have a place in its flash (manuals of RobStrides, 3.3.3: 2007, 2018, 2019, 2016, 201F, 2020)."""
SAVE_DATA = b"\x01\x02\x03\x04\x05\x06\x07\x08"
NOT_READ = 1
"""In bits 16 to 23 of the answer to a question for a parameter."""
UNDER_VOLTAGE, OVER_CURRENT, OVER_TEMPERATURE, STALL = 1, 2, 4, 16
"""Bits of its faults in feedback."""
FAULT_WORDS = {STALL: 0x0100, OVER_TEMPERATURE: 0x0001, OVER_CURRENT: 0x10000}
"""What type 21 says of them: overload, temperature, current of phase A."""
STEPS = 0xFFFF
VELOCITY_BANDWIDTH_S = 150.0
"""Of its velocity loop [1/s] [inf]."""
NM_PER_AMPERE = 0.5
"""[inf]"""
UNIQUE = b"rtarmsim"

_SET_POINT = struct.Struct(">HHHH")


def usual_parameters() -> dict[int, float]:
    """What its parameters are when power comes, as CyberGears have them; [inf] for 7024 and 7025 (RobStrides)."""
    return {
        RUN_MODE: 0.0,
        0x7006: 0.0,
        0x700A: 0.0,
        0x700B: math.inf,
        0x7016: 0.0,
        0x7017: 2.0,
        0x7018: 23.0,
        0x701E: 30.0,
        0x7024: 10.0,
        0x7025: 10.0,
    }


@dataclass(frozen=True)
class Settings:
    """How it is built, and how its owner set it.

    Attributes:
        motor_id: on the bus.
        robstride: whether its run modes and its counting are those of RobStrides.
        absolute: whether its encoder knows its angle when power comes.
        zero_sta: 0 for a count of 0 to 2π when power comes, 1 for one of -π to π, of RobStrides with such an encoder.
        can_timeout: silence after which it stops (50 µs), of RobStrides; 0 for never.
        position_rad, velocity_rad_s, torque_nm, kp, kd: what the fields of its frames reach.
        velocity_gain: of its velocity loop [N·m/(rev/s)].
    """

    motor_id: int = 127
    robstride: bool = False
    absolute: bool = False
    zero_sta: Literal[0, 1] = 0
    can_timeout: int = 0
    position_rad: float = 4 * math.pi
    velocity_rad_s: float = 30.0
    torque_nm: float = 12.0
    kp: float = 500.0
    kd: float = 5.0
    velocity_gain: float = 1.0


class RobstrideDrive(ServoDrive):
    """One motor: a node of the bus with a shaft.

    Args:
        settings: how it is built and set.
        start_ns, turns, counted, load, seed: see `ServoDrive`.

    Attributes:
        settings: as they are now.
        parameters: as type 17 reads them, what is measured apart.
        state: reset or run.
        faults: bits of its feedback.
        bitrate_code: what type 22 has set the bit rate of a CyberGear to; None where it has not.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        *,
        start_ns: int = 0,
        turns: float = 0.0,
        counted: float | None = None,
        load: Load | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(start_ns=start_ns, turns=turns, counted=counted, load=load, seed=seed)
        self.settings = settings or Settings()
        self._strongest_nm = self.shaft.load.torque_nm
        self._host_id = 0xFD
        self._flash: dict[int, float] = {}
        self.bitrate_code: int | None = None
        self._does: dict[int, Callable[[int, bytes], None]] = {
            GET_ID: lambda data16, data: self._tell_id(),
            CONTROL: self._control,
            ENABLE: self._enable,
            STOP: self._stop,
            SET_ZERO: self._set_zero,
            SET_ID: self._set_id,
            READ: self._read,
            WRITE: self._write,
            SAVE: self._save,
        }
        self._begin()

    @classmethod
    def mounted(cls, mounting: Mounting) -> RobstrideDrive:
        """The motor of a joint, its loops tuned to its load, and zero_sta set so that it counts the joint's range."""
        config, load, joint = mounting.joint.drive, mounting.load, mounting.joint
        counts_below_zero = min(mounting.turns(joint.lower_rad), mounting.turns(joint.upper_rad)) < 0.0
        assert isinstance(config, RobstrideConfig)
        settings = Settings(
            motor_id=config.motor_id,
            robstride=config.mode == "csp",
            absolute=config.encoder == "absolute",
            zero_sta=1 if counts_below_zero else 0,
            position_rad=config.position_range_rad,
            velocity_rad_s=config.velocity_range_rad_s,
            torque_nm=config.torque_range_nm,
            kp=config.kp_range,
            kd=config.kd_range,
            velocity_gain=VELOCITY_BANDWIDTH_S * load.inertia_kg_m2 * TURN_RAD,
        )
        turns = mounting.turns(mounting.position_rad)
        counted = turns if mounting.homed or settings.absolute else 0.0
        return cls(settings, start_ns=mounting.start_ns, turns=turns, counted=counted, load=load, seed=mounting.seed)

    # -- as others know it ---------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is for it or from it."""
        if not frame.extended:
            return False
        kind, of, to = frame.can_id >> TYPE_BIT, frame.can_id >> 8 & 0xFF, frame.can_id & 0xFF
        motor = self.settings.motor_id
        return (kind in self._does and to == motor) or (kind in (GET_ID, FEEDBACK, READ, FAULT) and of == motor)

    def state_frame(self, now_ns: int) -> Frame:
        """The feedback it would give at `now_ns`."""
        self.advance(now_ns)
        return self._feedback()

    def twin(self, now_ns: int, seed: int) -> RobstrideDrive:
        """Another motor with its id, from `now_ns` on, which counts from zero."""
        return RobstrideDrive(self.settings, start_ns=now_ns, seed=seed)

    # -- what happens to it --------------------------------------------------------------------------

    def boot(self) -> None:
        """Stopped, with usual parameters; an encoder that is not absolute begins to count, that of RobStrides folds."""
        if not self.settings.absolute:
            self.origin += self.counted
        elif self.settings.robstride:
            self.origin += math.floor(self.counted + 0.5 * self.settings.zero_sta)
        self._begin()
        if self.arms_itself:
            self._run()

    def _begin(self) -> None:
        self.parameters = usual_parameters() | self._flash
        self.faults = 0
        self._set_point = Torque()
        self._limit_torque()
        self.release()

    def release(self) -> None:
        """Stop, as with type 4."""
        self.state = RESET
        self.enabled = False
        self.shaft.obey(Limp())

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Stop with a fault, and say so."""
        self.advance(now_ns)
        fault = {"stall": STALL, "temperature": OVER_TEMPERATURE, "current": OVER_CURRENT}[cause]
        self.faults |= fault
        self.release()
        self.say(self._frame(FAULT, struct.pack("<II", FAULT_WORDS[fault], 0)))

    # -- the host's side -----------------------------------------------------------------------------

    def concerns(self, frame: Frame) -> bool:
        """Whether it is a whole one of a kind it knows, for it."""
        whole = frame.extended and not frame.remote and len(frame.data) == 8
        return whole and frame.can_id & 0xFF == self.settings.motor_id and frame.can_id >> TYPE_BIT in self._does

    def take(self, frame: Frame) -> None:
        """Obey a frame for it."""
        kind = frame.can_id >> TYPE_BIT
        data16 = frame.can_id >> 8 & 0xFFFF
        if kind != CONTROL:
            self._host_id = data16 & 0xFF
        self._does[kind](data16, frame.data)

    def _frame(self, kind: int, data: bytes, flags: int = 0, whom: int | None = None) -> Frame:
        whom = self._host_id if whom is None else whom
        return Frame(kind << TYPE_BIT | flags << FAULT_BIT | self.settings.motor_id << 8 | whom, data)

    def _tell_id(self) -> None:
        self.reply(self._frame(GET_ID, UNIQUE, whom=ANYBODY))

    def _feedback(self) -> Frame:
        settings = self.settings
        position = self.counted * TURN_RAD
        if settings.robstride:
            position -= 2.0 * settings.position_rad * round(position / (2.0 * settings.position_rad))
        measured = (
            _code(position, settings.position_rad),
            _code(self.shaft.speed * TURN_RAD, settings.velocity_rad_s),
            _code(self.shaft.torque_nm, settings.torque_nm),
            round(self.celsius * 10.0) & 0xFFFF,
        )
        return self._frame(FEEDBACK, _SET_POINT.pack(*measured), self.state << MODE_BIT - FAULT_BIT | self.faults)

    def _control(self, data16: int, data: bytes) -> None:
        settings = self.settings
        position, velocity, kp, kd = _SET_POINT.unpack(data)
        self._set_point = Torque(
            _number(position, settings.position_rad),
            _number(velocity, settings.velocity_rad_s),
            kp / STEPS * settings.kp,
            kd / STEPS * settings.kd,
            _number(data16, settings.torque_nm),
        )
        self._lead()
        self.reply(self._feedback())

    def _enable(self, data16: int, data: bytes) -> None:
        if not self.faults:
            self._run()
        self.reply(self._feedback())

    def _run(self) -> None:
        self.state = RUN
        self.enabled = True
        self._lead()

    def _stop(self, data16: int, data: bytes) -> None:
        self.release()
        if data[0] == 1 and not self.cause_lasts:
            self.faults = 0
        self.reply(self._feedback())

    def _set_zero(self, data16: int, data: bytes) -> None:
        if data[0] == 1:
            self.origin += self.counted
            self._lead()
        self.reply(self._feedback())

    def _set_id(self, data16: int, data: bytes) -> None:
        self.settings = replace(self.settings, motor_id=data16 >> 8)
        self._tell_id()

    def _read(self, data16: int, data: bytes) -> None:
        index = int.from_bytes(data[:2], "little")
        settings = self.settings
        measured = {
            0x7019: self.counted * TURN_RAD,
            0x701B: self.shaft.speed * TURN_RAD,
            0x701C: self.supply_v,
            LIMIT_TORQUE: min(self.parameters[LIMIT_TORQUE], settings.torque_nm),
        }
        whole = {RUN_MODE: int(self.parameters[RUN_MODE])}
        if settings.robstride:
            whole |= {ZERO_STA: settings.zero_sta, CAN_TIMEOUT: settings.can_timeout}
            measured[ADD_OFFSET] = 0.0
        head = struct.pack("<Hxx", index)
        if index in whole:
            self.reply(self._frame(READ, head + struct.pack("<I", whole[index])))
        elif index in measured or index in self.parameters:
            self.reply(self._frame(READ, head + struct.pack("<f", {**self.parameters, **measured}[index])))
        elif settings.robstride:
            self.reply(self._frame(READ, head + bytes(4), NOT_READ))

    def _write(self, data16: int, data: bytes) -> None:
        index = int.from_bytes(data[:2], "little")
        if index == RUN_MODE:
            if self.state == RESET and data[4] in ((0, 1, 2, 3, 5) if self.settings.robstride else (0, 1, 2, 3)):
                self.parameters[RUN_MODE] = data[4]
        elif index in self.parameters:
            value = float(struct.unpack("<f", data[4:])[0])
            if math.isfinite(value):
                self.parameters[index] = value
                self._limit_torque()
                self._lead()
        self.reply(self._feedback())

    def _save(self, data16: int, data: bytes) -> None:
        if not self.settings.robstride:
            self.bitrate_code = data[0]
        elif data == SAVE_DATA:
            self._flash = {index: self.parameters[index] for index in STORED}
        self.reply(self._feedback())

    # -- its shaft -----------------------------------------------------------------------------------

    def _limit_torque(self) -> None:
        self.shaft.load.torque_nm = min(max(self.parameters[0x700B], 0.0), self._strongest_nm)

    def _lead(self) -> None:
        """Let the shaft do what it was told last."""
        if self.state == RUN:
            self.shaft.obey(self._law())

    def _law(self) -> Law:
        parameters, gain = self.parameters, self.settings.velocity_gain
        target = self.origin + parameters[0x7016] / TURN_RAD
        match int(parameters[RUN_MODE]):
            case 1 if self.settings.robstride:
                return Plan(target, abs(parameters[0x7024]) / TURN_RAD, abs(parameters[0x7025]) / TURN_RAD)
            case 1 | 5:
                return Cascade(target, parameters[0x701E], gain, abs(parameters[0x7017]) / TURN_RAD)
            case 2:
                law = Cascade(0.0, None, gain, self.settings.velocity_rad_s / TURN_RAD)
                law.speed_ahead = parameters[0x700A] / TURN_RAD
                return law
            case 3:
                return Torque(torque_nm=parameters[0x7006] * NM_PER_AMPERE)
        told = self._set_point
        here = told.position_rad + self.origin * TURN_RAD
        return Torque(here, told.speed_rad_s, told.kp, told.kd, told.torque_nm)


def _code(value: float, most: float) -> int:
    """A number within ±most as 16 bits, cut off to a whole step."""
    return int((min(max(value, -most), most) + most) / (2.0 * most) * STEPS)


def _number(code: int, most: float) -> float:
    return code / STEPS * 2.0 * most - most
