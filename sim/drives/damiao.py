"""A Damiao motor on CAN, from its frames to its shaft.

Written from other-drives.md, from damiao-motor 1.0.6 (frames, table of registers, table of models) and from what people
found out about the firmware (umeow0716/damiao_firmware on GitHub: whom it hears, what feeds the alarm, what FB does);
[inf] marks what none of them says and is assumed here: a host should not depend on it.

Modelled:
- Identifiers: standard. It hears every one whose lowest byte is its ID: its number (mode 1, MIT), 100, 200 and 300
  (hex) more (modes 2 to 4), and answers the others and those of another mode with feedback alone. Commands of seven FF
  count on all of them. Registers are on 7FF with its ID in front; all it says comes on its master ID. Other IDs,
  extended and remote frames, wrong lengths [inf] meet silence. Both IDs change as soon as their registers are written.
- Every command is answered with feedback. Its first byte is `ID | status << 4` with nothing cut off the ID (that
  firmware, can_protocol.c), so an ID of 16 or more spoils the status.
- Registers: read, write, store (a limp motor's), ask for feedback; a write is answered with what then stands there. A
  value out of its range, or of a read-only register, changes nothing; an unknown register meets silence.
- Velocities come in four bytes or eight, all else in eight.
- Modes: MIT (stiffness, damping, torque), position-velocity (`planning`), velocity (by the ramps of a trapezoid),
  force-position (as position-velocity; the share of current caps the torque).
- Position-velocity (`planning`) is one of two laws. "ramp", as the makers' manuals tell it of dual-encoder motors: a
  trapezoid by ACC and DEC (rad/s²), no faster than told and than MAX_SPD. "gain", as that firmware has it
  (app/src/motor_control.c and can_protocol.c): the rotor's speed (rad/s) is KP_APR × what the output shaft lacks (rad),
  no faster than told × GR, and changes by ACC and DEC at most in a millisecond: rad/s² are practically no ramp there.
  [inf] A number that is not finite changes nothing; a speed of 0 stops by the ramp and stays.
- Enabling begins without stiffness, or with a speed of 0, as disabling and another mode do: what was told is forgotten.
  With `keeps_targets` it is not, and a motor that is enabled goes where it was told last [inf].
- The alarm (TIMEOUT) lets an enabled motor go that has heard no command for so long; frames on 7FF are none.
- Errors let the shaft go, stand in the status, and end by FB, which lets a sound motor go too. Setting zero (FE) lasts,
  and counts from where it stands.
- What was written is lost with the power unless stored. An absolute encoder sees one turn of the output shaft: after
  power comes it counts within half a turn of zero. Without it the motor counts from 0 where it stands then [inf].

Not modelled: serial port, discovery and firmware frames, CAN FD, calibration, loops as tuned (KP_ASR …), bit rate
register, over- and under-voltage by the supply.
"""

from __future__ import annotations

import math
import struct
from typing import Literal

from config.drives.damiao import HIGHEST_KD, HIGHEST_KP, REGISTERS_ID, Ranges
from config.drives.damiao import DamiaoDrive as DamiaoConfig
from sim.bus import Frame
from sim.drives.conversation import ServoDrive
from sim.drives.drive import Cause, Mounting
from sim.drives.servo import STEP_S, TURN_RAD, Law, Limp, Load, Plan, Spin, Torque

READ, WRITE, STORE, FEEDBACK = 0x33, 0x55, 0xAA, 0xCC
ENABLE, DISABLE, ZERO, CLEAR = 0xFC, 0xFD, 0xFE, 0xFB
"""Last byte of a command whose other bytes are FF."""
LIMP, ENABLED, OVER_CURRENT, ROTOR_HOT, LOST_COMMUNICATION, OVERLOAD = 0x0, 0x1, 0xA, 0xC, 0xD, 0xE
"""Status codes."""
MIT, POSITION_VELOCITY, VELOCITY, FORCE_POSITION = 1, 2, 3, 4
"""Modes; each has an identifier 100 (hex) above the one before."""

ACC, DEC, MAX_SPD, MST_ID, ESC_ID, TIMEOUT, CTRL_MODE = 4, 5, 6, 7, 8, 9, 10
GR, PMAX, VMAX, TMAX, KP_APR = 20, 21, 22, 23, 27
TIMEOUT_UNIT_NS = 50_000
HIGHEST_ID = 0x7FF

FLOATS = {
    0: 15.0, 1: 0.945, 2: 100.0, 3: 0.98, ACC: 20.0, DEC: -20.0, MAX_SPD: 200.0,
    11: 1e-4, 12: 1.8e-5, 17: 0.85, 18: 3.45e-4, 19: 0.0045, GR: 10.0, PMAX: 12.5, VMAX: 30.0, TMAX: 10.0,
    24: 1000.0, 25: 0.00372, 26: 0.002, KP_APR: 54.0, 28: 0.0, 29: 32.0, 30: 0.95, 31: 4.0, 32: 30.0, 33: 1000.0,
    34: 10.0, 50: 0.0, 51: 0.0, 52: 1.0, 53: 1.0, 54: 0.0, 55: 1.0, 56: 0.0, 59: 10.261, 60: 24.0, 61: 25.0, 62: 30.0,
    63: 0.0, 64: 0.0, 65: 0.0, 80: 0.0, 81: 0.0,
}  # fmt: skip
"""Registers that hold IEEE 754 singles, as a DM4310 comes (the less important ones [inf])."""
WHOLE = {MST_ID: 0, ESC_ID: 1, TIMEOUT: 0, CTRL_MODE: MIT, 13: 0, 14: 5017, 15: 0, 16: 14, 35: 4, 36: 4}
"""Registers that hold whole numbers of 32 bits."""
GEARS = {"DM3507": 7.0, "DM4340": 40.0, "DM4340P": 40.0, "DM6006": 6.0, "DM8006": 6.0, "DM8009": 9.0}
"""Of the models with another one than a DM4310's (the maker's table)."""
READ_ONLY = frozenset((*range(11, 21), 36, *range(50, 82)))
ABOVE_ZERO = frozenset((ACC, MAX_SPD, PMAX, VMAX, TMAX))

BOARD_COOLER_C = 5.0
"""What the power stage is cooler than the motor [inf]."""
_COMMAND_HEAD = b"\xff" * 7
Planning = Literal["ramp", "gain"]


class Gain:
    """Go to a target with a speed in proportion to what is missing; see `planning` above. The speed loop is ideal.

    Attributes:
        target: where to [rev].
        top: highest speed [rev/s].
        gain_1_s: of the speed.
        up, down: how fast the signed speed may grow and fall [rev/s²].
    """

    rests = False

    def __init__(self, target: float, top: float, gain_1_s: float, up: float, down: float) -> None:
        self.target = target
        self.top = top
        self.gain_1_s = gain_1_s
        self.up = up
        self.down = down

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """Speed after a step of the loop's wish, as far as the motor's torque goes."""
        wanted = max(-self.top, min(self.top, self.gain_1_s * (self.target - position)))
        wanted = max(speed - self.down * STEP_S, min(speed + self.up * STEP_S, wanted))
        return load.driven(speed, (wanted - speed) / load.gain(1.0))


class DamiaoDrive(ServoDrive):
    """One motor: a node of the bus with a shaft.

    Args:
        registers: those of its flash that differ from `FLOATS` and `WHOLE`.
        absolute: whether an encoder sees its output shaft.
        planning: the law of position-velocity, see above.
        start_ns, turns, counted, load, seed: see `ServoDrive`.

    Attributes:
        registers: what it holds now, by number.
        status: as its feedback says it.
        keeps_targets: whether what it was told last counts when it is enabled.
    """

    def __init__(
        self,
        registers: dict[int, float] | None = None,
        *,
        absolute: bool = True,
        planning: Planning = "ramp",
        start_ns: int = 0,
        turns: float = 0.0,
        counted: float | None = None,
        load: Load | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(start_ns=start_ns, turns=turns, counted=counted, load=load, seed=seed)
        self.keeps_targets = False
        self._absolute = absolute
        self._planning = planning
        self._flash: dict[int, float] = {**FLOATS, **WHOLE, **(registers or {})}
        self._strongest_nm = self.shaft.load.torque_nm
        self._begin()

    @classmethod
    def mounted(cls, mounting: Mounting) -> DamiaoDrive:
        """The motor of a joint, limp as after power has come."""
        joint = mounting.joint
        config = joint.drive
        assert isinstance(config, DamiaoConfig)
        ranges = config.ranges
        registers: dict[int, float] = {
            MST_ID: config.master_id,
            ESC_ID: config.motor_id,
            GR: GEARS.get(config.model, FLOATS[GR]),
            PMAX: ranges.rad,
            VMAX: ranges.rad_s,
            TMAX: ranges.nm,
        }
        turns = mounting.turns(mounting.position_rad)
        absolute = config.encoder == "absolute"
        return cls(
            registers,
            absolute=absolute,
            planning=mounting.planning,
            start_ns=mounting.start_ns,
            turns=turns,
            counted=turns if mounting.homed or absolute else 0.0,
            load=mounting.load,
            seed=mounting.seed,
        )

    # -- as others know it ---------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is told it, about a register of it, or said by it."""
        if frame.extended:
            return False
        if frame.can_id == REGISTERS_ID:
            return frame.data[:2] == self._head
        return frame.can_id == self._master_id or self._mode_of(frame.can_id) is not None

    def state_frame(self, now_ns: int) -> Frame:
        """The feedback it would send at `now_ns`."""
        self.advance(now_ns)
        return self._feedback()

    def twin(self, now_ns: int, seed: int) -> DamiaoDrive:
        """Another motor with its IDs, from `now_ns` on, which counts from zero."""
        return DamiaoDrive(dict(self.registers), planning=self._planning, start_ns=now_ns, seed=seed)

    @property
    def ranges(self) -> Ranges:
        """What the fields of its frames reach."""
        return Ranges(self.registers[PMAX], self.registers[VMAX], self.registers[TMAX])

    @property
    def _motor_id(self) -> int:
        return int(self.registers[ESC_ID])

    @property
    def _master_id(self) -> int:
        return int(self.registers[MST_ID])

    @property
    def _head(self) -> bytes:
        return struct.pack("<H", self._motor_id)

    def _mode_of(self, can_id: int) -> int | None:
        """The mode whose commands come with an identifier (above 4: of none), None where it is not heard."""
        return 1 + (can_id >> 8) if can_id & 0xFF == self._motor_id & 0xFF else None

    # -- what happens to it --------------------------------------------------------------------------

    def boot(self) -> None:
        """Limp, with what was stored; of the turns that were counted only the last one's part is known."""
        self.origin += round(self.counted) if self._absolute else self.counted
        self._begin()
        if self.arms_itself:
            self._enable()

    def _begin(self) -> None:
        self.registers = dict(self._flash)
        self._last: Law | None = None
        self._let_go(LIMP)

    def release(self) -> None:
        """Limp, as when somebody said so in the maker's tool."""
        self._let_go(LIMP)

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Fail: an overload, a hot motor, or too much current in it."""
        self.advance(now_ns)
        self._let_go({"stall": OVERLOAD, "temperature": ROTOR_HOT, "current": OVER_CURRENT}[cause])

    def _let_go(self, status: int) -> None:
        self.status = status
        self.enabled = False
        self.cancel("alarm")
        self.shaft.obey(Limp())

    def _enable(self) -> None:
        if self.status in (LIMP, ENABLED):
            if not self.enabled:
                self.status, self.enabled = ENABLED, True
                self.shaft.obey((self._last if self.keeps_targets else None) or self._without_target())
            self._feed_alarm()

    def _without_target(self) -> Law:
        """What an enabled motor does that was told nothing yet."""
        return Torque() if self.registers[CTRL_MODE] == MIT else Spin(0.0, self._ramp(DEC))

    def _ramp(self, register: int) -> float:
        return abs(self.registers[register]) / TURN_RAD

    def _feed_alarm(self) -> None:
        timeout = int(self.registers[TIMEOUT])
        if timeout and self.enabled:
            self.after("alarm", timeout * TIMEOUT_UNIT_NS, lambda: self._let_go(LOST_COMMUNICATION))
        else:
            self.cancel("alarm")

    # -- the host's side -----------------------------------------------------------------------------

    def concerns(self, frame: Frame) -> bool:
        """Whether it has one of its IDs, or asks for registers of its own."""
        if frame.extended or frame.remote:
            return False
        if frame.can_id == REGISTERS_ID:
            return len(frame.data) >= 4 and frame.data[:2] == self._head
        return self._mode_of(frame.can_id) is not None

    def take(self, frame: Frame) -> None:
        """Obey a frame for its IDs."""
        if frame.can_id == REGISTERS_ID:
            self._take_register(frame.data)
            return
        mode = self._mode_of(frame.can_id)
        if mode is None or len(frame.data) not in (8, 4 if mode == VELOCITY else 8):
            return
        self._feed_alarm()
        if frame.data[:7] == _COMMAND_HEAD and frame.data[7] in (ENABLE, DISABLE, ZERO, CLEAR):
            self._take_state(frame.data[7])
        elif mode == self.registers[CTRL_MODE]:
            self._lead(self._law(mode, frame.data))
        self.reply(self._feedback())

    def _take_state(self, command: int) -> None:
        if command == ENABLE:
            self._enable()
        elif command == DISABLE:
            if self.status == ENABLED:
                self._let_go(LIMP)
        elif command == ZERO:
            self.origin = self.shaft.position_at(self._now_ns)
        elif not self.cause_lasts:
            self._let_go(LIMP)

    def _lead(self, law: Law | None) -> None:
        if law is not None:
            self._last = law
            if self.enabled:
                self.shaft.obey(law)

    def _law(self, mode: int, data: bytes) -> Law | None:
        """What a command asks for; None for one with a number that is none."""
        if mode == MIT:
            return self._impedance(data)
        if mode == FORCE_POSITION:
            rad, speed, share = struct.unpack("<fHH", data)
            return self._move(rad, speed * 0.01, share * 1e-4)
        first, second = struct.unpack("<ff", data.ljust(8, b"\0"))
        if mode == POSITION_VELOCITY:
            return self._move(first, second, 1.0)
        if not math.isfinite(first):
            return None
        most = self.registers[MAX_SPD]
        return Spin(max(-most, min(most, first)) / TURN_RAD, self._ramp(ACC))

    def _impedance(self, data: bytes) -> Law:
        packed = int.from_bytes(data, "big")
        ranges = self.ranges
        return Torque(
            _decoded(packed >> 48, ranges.rad, 16) + self.origin * TURN_RAD,
            _decoded(packed >> 36 & 0xFFF, ranges.rad_s, 12),
            HIGHEST_KP * (packed >> 24 & 0xFFF) / 0xFFF,
            HIGHEST_KD * (packed >> 12 & 0xFFF) / 0xFFF,
            _decoded(packed & 0xFFF, ranges.nm, 12),
        )

    def _move(self, rad: float, rad_s: float, share: float) -> Law | None:
        if not (math.isfinite(rad) and math.isfinite(rad_s)):
            return None
        self.shaft.load.torque_nm = min(share, 1.0) * self._strongest_nm
        top = min(abs(rad_s), self.registers[MAX_SPD]) / TURN_RAD
        if top == 0.0:
            return Spin(0.0, self._ramp(DEC))
        target = self.origin + rad / TURN_RAD
        if self._planning == "gain":
            gear = self.registers[GR]
            up, down = (abs(self.registers[register]) * 1e3 / gear / TURN_RAD for register in (ACC, DEC))
            return Gain(target, abs(rad_s) / TURN_RAD, self.registers[KP_APR] / gear, up, down)
        law = self.shaft.law
        if self.enabled and isinstance(law, Plan):
            law.target, law.top, law.acceleration, law.deceleration = target, top, self._ramp(ACC), self._ramp(DEC)
            return law
        return Plan(target, top, self._ramp(ACC), self._ramp(DEC))

    def _feedback(self) -> Frame:
        ranges = self.ranges
        packed = (self.status << 4 | self._motor_id & 0xFF) << 56
        packed |= _coded(self.counted * TURN_RAD, ranges.rad, 16) << 40
        packed |= _coded(self.shaft.speed * TURN_RAD, ranges.rad_s, 12) << 28
        packed |= _coded(self.shaft.torque_nm, ranges.nm, 12) << 16
        packed |= _byte(self.celsius - BOARD_COOLER_C) << 8 | _byte(self.celsius)
        return Frame(self._master_id, packed.to_bytes(8, "big"), extended=False)

    # -- registers -----------------------------------------------------------------------------------

    def _take_register(self, data: bytes) -> None:
        operation, register = data[2:4]
        if operation == FEEDBACK:
            self.reply(self._feedback())
            return
        if operation == STORE:
            if self.enabled:
                return
            self._flash.update({number: self.registers[number] for number in {*FLOATS, *WHOLE} - READ_ONLY})
            self._answer(data[:4], b"")
            return
        if register not in FLOATS and register not in WHOLE:
            return
        if operation == WRITE and len(data) == 8:
            self._write(register, data[4:])
        elif operation != READ:
            return
        self._answer(data[:4], self._held(register))

    def _answer(self, head: bytes, value: bytes) -> None:
        self.reply(Frame(self._master_id, head + value, extended=False))

    def _held(self, register: int) -> bytes:
        measured = {60: self.supply_v, 61: self.celsius - BOARD_COOLER_C, 62: self.celsius}
        if register in (80, 81):
            return struct.pack("<f", self.counted * TURN_RAD)
        value = measured.get(register, self.registers[register])
        return struct.pack("<I", int(value)) if register in WHOLE else struct.pack("<f", value)

    def _write(self, register: int, data: bytes) -> None:
        if register in WHOLE:
            value: float = int.from_bytes(data, "little")
        else:
            value = struct.unpack("<f", data)[0]
        if register in READ_ONLY or not math.isfinite(value) or not _in_range(register, value):
            return
        self.registers[register] = value
        if register == CTRL_MODE:
            self._last = None
            if self.enabled:
                self.shaft.obey(self._without_target())
        elif register == TIMEOUT:
            self._feed_alarm()


def _in_range(register: int, value: float) -> bool:
    if register == CTRL_MODE:
        return MIT <= value <= FORCE_POSITION
    if register in (MST_ID, ESC_ID):
        return value <= HIGHEST_ID
    return value < 0.0 if register == DEC else value > 0.0 or register not in ABOVE_ZERO


def _coded(value: float, most: float, bits: int) -> int:
    steps = (1 << bits) - 1
    return int((min(max(value, -most), most) + most) * steps / (2.0 * most))


def _decoded(code: int, most: float, bits: int) -> float:
    return code * 2.0 * most / ((1 << bits) - 1) - most


def _byte(value: float) -> int:
    return min(max(round(value), 0), 255)
