"""A VESC in FOC mode with an encoder on CAN, from its frames to its shaft.

Written from reading vedderb/bldc at b9d287b3: comm/comm_can.c (packets), comm/commands.c (COMM_GET_VALUES_SELECTIVE),
timeout.c, motor/mc_interface.c (faults), motor/foc_math.c (the position controller). [inf] marks what is assumed here.

Modelled:
- Identifiers: extended, packet << 8 | id; 255 is for all. Status 1, 4 and 5 by themselves, in two sets with a rate
  each. Status 4 has the position as a whole number of fiftieths of a degree, rounded down.
- Duty, current, current to brake with, speed, position. [inf] A frame that is too short changes nothing (the firmware
  takes whatever its buffer holds).
- A ping (17), the angle of the encoder (56), and commands in a short buffer (8): values by mask (50) where the answer
  fits one frame, alive (30). The number of who asks is in the request.
- The position controller: proportional, and the derivative of the error behind a low pass of some 4.5 ms (1 kHz, 0.2),
  the shorter way round. Its owner has tuned it so, with `P PID Kd Proc` at 0, and an integrator that makes up for
  friction [inf].
- Faults: the motor is let go and commands are ignored until the fault has been over for 0.5 s. After that the next
  command is obeyed.
- The encoder may see the shaft through a gear. What it says of its angle comes round each turn of the encoder.
- The time-out: nothing that moves the motor was heard for so long, then a braking current, 0 as it comes, until
  something is. 0 ms: never. Alive feeds it, too. The kill switch: the same, at once, and commands are ignored.
- An absolute encoder knows its angle when power comes; else the position begins at 0 where it stands [inf].

Not modelled: regenerating, handbrake, long buffers, configurations, detection, second motors, multiturn sensors, the
current that its supply gives, and what a limit of current does but for the torque of the motor.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace

from config.drives.vesc import VescDrive as VescConfig
from sim.bus import Frame
from sim.drives.conversation import ServoDrive
from sim.drives.drive import Cause, Mounting
from sim.drives.servo import AT_REST_TURNS, AT_REST_TURNS_S, STEP_S, TURN_RAD, Law, Limp, Load, Spin, Torque

SET_DUTY, SET_CURRENT, SET_BRAKE, SET_RPM, SET_POS, SHORT_BUFFER = 0, 1, 2, 3, 4, 8
STATUS, STATUS_4, PING, PONG, STATUS_5, ROTOR_POSITION = 9, 16, 17, 18, 27, 56
EVERYBODY = 255
GET_VALUES_SELECTIVE, ALIVE = 50, 30
ABS_OVER_CURRENT, OVER_TEMP_MOTOR, ENCODER_SLIP = 4, 6, 30
FAULT_STOP_NS = 500_000_000
MILLISECOND = 1_000_000
SHORT = 6
"""Bytes of a command that fit into a short buffer."""

STIFFNESS_1_S = 110.0
"""How its owner tuned it: the frequency of the position controller on the load [rad/s] [inf]."""
FILTER_S = 4.5e-3
RAMP, TOP = 50.0, 20.0
"""How fast it reaches a speed [rev/s²], and the highest [rev/s] [inf]."""


@dataclass
class Settings:
    """What it keeps in flash, as its owner set it.

    Attributes:
        controller_id: on the bus.
        absolute: whether its encoder knows its angle when power comes.
        gear: turns of its shaft for one of its encoder.
        timeout_ms: silence after which it lets go; 0 for never.
        position_hz, others_hz: rates of the two sets of status; 0 for none.
        pole_pairs: turns of the field for one of the shaft.
        nm_per_ampere: the motor's torque constant.
        stiffness_nm, damping_nm_s: N·m for a turn that is missing, and for a turn a second.
    """

    controller_id: int = 1
    absolute: bool = True
    gear: float = 1.0
    timeout_ms: int = 0
    position_hz: int = 200
    others_hz: int = 5
    pole_pairs: int = 7
    nm_per_ampere: float = 0.5
    stiffness_nm: float = 100.0
    damping_nm_s: float = 2.0


class PositionController:
    """Proportional and derivative on the error, the shorter way round, behind a low pass.

    Attributes:
        target: where to [rev], in any turn of the encoder.
        turn: of the encoder [rev].
        stiffness_nm, damping_nm_s: see `Settings`.
    """

    def __init__(self, target: float, settings: Settings) -> None:
        self.target = target
        self.turn = settings.gear
        self.stiffness_nm, self.damping_nm_s = settings.stiffness_nm, settings.damping_nm_s
        self.rests = False
        self._before: float | None = None
        self._change = 0.0

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """Speed after a step of its torque."""
        error = (self.target - position + 0.5 * self.turn) % self.turn - 0.5 * self.turn
        change = 0.0 if self._before is None else (error - self._before) / STEP_S
        self._before = error
        self._change += (change - self._change) * STEP_S / FILTER_S
        if abs(error) < AT_REST_TURNS and max(abs(speed), abs(self._change)) < AT_REST_TURNS_S:
            self.rests = True
            return 0.0
        self.rests = False
        return load.driven(speed, self.stiffness_nm * error + self.damping_nm_s * self._change)


class VescDrive(ServoDrive):
    """One VESC: a node of the bus with a shaft.

    Args:
        settings: as it keeps them.
        start_ns, turns, counted, load, seed: see `ServoDrive`.

    Attributes:
        settings: see `Settings`.
        fault: code of its fault, 0 for none.
        timed_out, killed: whether its time-out or its kill switch has let the motor go.
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
        self.fault = 0
        self.timed_out = self.killed = False
        self._begin()

    @classmethod
    def mounted(cls, mounting: Mounting) -> VescDrive:
        """The controller of a joint, tuned to its load, and with the rates that the arm file names."""
        config, load = mounting.joint.drive, mounting.load
        assert isinstance(config, VescConfig)
        inertia = load.inertia_kg_m2 * TURN_RAD
        settings = Settings(
            controller_id=config.controller_id,
            absolute=config.encoder == "absolute",
            position_hz=config.position_hz,
            others_hz=config.voltage_hz,
            stiffness_nm=inertia * STIFFNESS_1_S**2,
            damping_nm_s=inertia * STIFFNESS_1_S * 2.0,
        )
        turns = mounting.turns(mounting.position_rad)
        counted = turns if mounting.homed or settings.absolute else 0.0
        return cls(settings, start_ns=mounting.start_ns, turns=turns, counted=counted, load=load, seed=mounting.seed)

    # -- as others know it ---------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is for it, of its status, or an answer to one who calls himself by its number + 128."""
        return frame.extended and frame.can_id & 0x7F == self.settings.controller_id and frame.can_id >> 16 == 0

    def state_frame(self, now_ns: int) -> Frame:
        """The status 4 that it would send at `now_ns`."""
        self.advance(now_ns)
        return self._frame(STATUS_4, self._status_4())

    def twin(self, now_ns: int, seed: int) -> VescDrive:
        """Another controller with its number, from `now_ns` on, which counts from zero."""
        return VescDrive(replace(self.settings), start_ns=now_ns, seed=seed, counted=0.0)

    # -- what happens to it --------------------------------------------------------------------------

    def boot(self) -> None:
        """Coast; an encoder that is not absolute begins to count."""
        if not self.settings.absolute:
            self.origin += self.counted
        self._begin()

    def _begin(self) -> None:
        self.fault = 0
        self.timed_out = self.killed = False
        self._coast()
        self.every("rate 1", _period_ns(self.settings.position_hz), self._tell_position)
        self.every("rate 2", _period_ns(self.settings.others_hz), self._tell_others)
        self._feed_timeout()

    def release(self) -> None:
        """Coast, as when somebody said so in VESC Tool."""
        self._coast()

    def kill(self, now_ns: int, *, pressed: bool) -> None:
        """Have its kill switch pressed, or released."""
        self.advance(now_ns)
        self.killed = pressed
        if pressed:
            self._coast()

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Fault: a slipping encoder, a hot motor, or too much current in it."""
        self.advance(now_ns)
        self._fail({"stall": ENCODER_SLIP, "temperature": OVER_TEMP_MOTOR, "current": ABS_OVER_CURRENT}[cause])

    def _fail(self, fault: int) -> None:
        self.fault = fault
        self._coast()
        self.after("fault", FAULT_STOP_NS, self._forgive)

    def _forgive(self) -> None:
        """The fault is forgotten, unless its cause is still there: that is the fault again."""
        if self.cause_lasts:
            self._fail(self.fault)
        else:
            self.fault = 0

    def _coast(self) -> None:
        self.enabled = False
        self.shaft.obey(Limp())

    def _feed_timeout(self) -> None:
        self.timed_out = False
        if self.settings.timeout_ms > 0:
            self.after("time-out", self.settings.timeout_ms * MILLISECOND, self._time_out)

    def _time_out(self) -> None:
        self.timed_out = True
        self._coast()

    # -- the host's side -----------------------------------------------------------------------------

    def concerns(self, frame: Frame) -> bool:
        """Whether it is for its number or for all."""
        mine = frame.can_id & 0xFF in (self.settings.controller_id, EVERYBODY)
        return frame.extended and not frame.remote and mine

    def take(self, frame: Frame) -> None:
        """Obey a frame for it."""
        packet = frame.can_id >> 8
        if packet == PING and frame.data:
            pong = bytes((self.settings.controller_id, 0))
            self.reply(Frame(PONG << 8 | frame.data[0], pong, extended=True))
        elif packet == SHORT_BUFFER and len(frame.data) >= 3:
            host, how, command = frame.data[:3]
            answer = self._does(command, frame.data[3:])
            if how == 0 and answer is not None and len(answer) <= SHORT:
                head = bytes((self.settings.controller_id, 1))
                self.reply(Frame(SHORT_BUFFER << 8 | host, head + answer, extended=True))
        elif packet == ROTOR_POSITION:
            self.reply(self._frame(ROTOR_POSITION, struct.pack(">i", int(self._degrees * 1e5))))
        elif packet in (SET_DUTY, SET_CURRENT, SET_BRAKE, SET_RPM, SET_POS) and len(frame.data) >= 4:
            (number,) = struct.unpack(">i", frame.data[:4])
            self._feed_timeout()
            if not self.fault and not self.killed:
                self._obey(packet, number)

    def _obey(self, packet: int, number: int) -> None:
        law = self._law(packet, number)
        if isinstance(law, Limp):
            self._coast()
        else:
            self.enabled = True
            self.shaft.obey(law)

    def _law(self, packet: int, number: int) -> Law:
        settings = self.settings
        if packet == SET_POS:
            target = self.origin + number / 360e6 * settings.gear
            law = self.shaft.law
            if isinstance(law, PositionController):
                law.target = target
                return law
            return PositionController(target, settings)
        if packet == SET_RPM:
            return Spin(_bounded(number / settings.pole_pairs / 60.0), RAMP)
        if packet == SET_CURRENT and number:
            return Torque(torque_nm=number * 1e-3 * settings.nm_per_ampere)
        if packet == SET_BRAKE and number:
            return Spin(0.0, abs(number) * 1e-3 * settings.nm_per_ampere / self.shaft.load.inertia_kg_m2 / TURN_RAD)
        if packet == SET_DUTY:
            return Spin(_bounded(number / 100_000 * TOP), RAMP)
        return Limp()

    def _does(self, command: int, data: bytes) -> bytes | None:
        """What a command is answered with, None for nothing."""
        if command == ALIVE:
            self._feed_timeout()
        if command != GET_VALUES_SELECTIVE or len(data) < 4:
            return None
        (mask,) = struct.unpack(">I", data[:4])
        values = (
            (0, struct.pack(">h", int(self.celsius * 10.0))),
            (1, struct.pack(">h", int(self.celsius * 10.0))),
            (8, struct.pack(">h", int(self.supply_v * 10.0))),
            (15, bytes((self.fault,))),
            (16, struct.pack(">i", int(self._degrees * 1e6))),
            (17, bytes((self.settings.controller_id,))),
            (21, bytes((self.timed_out | self.killed << 1,))),
        )
        return bytes((command,)) + data[:4] + b"".join(value for bit, value in values if mask >> bit & 1)

    # -- its status ----------------------------------------------------------------------------------

    def _frame(self, packet: int, data: bytes) -> Frame:
        return Frame(packet << 8 | self.settings.controller_id, data, extended=True)

    @property
    def _degrees(self) -> float:
        return self.counted / self.settings.gear % 1.0 * 360.0

    def _status_4(self) -> bytes:
        tenths = int(self.celsius * 10.0)
        return struct.pack(">hhhh", tenths, tenths, 0, int(self._degrees * 50.0))

    def _tell_position(self) -> None:
        self.say(self._frame(STATUS_4, self._status_4()))

    def _tell_others(self) -> None:
        watts = self.shaft.torque_nm * self.shaft.speed
        ampere = math.copysign(abs(self.shaft.torque_nm) / self.settings.nm_per_ampere, watts)
        erpm = int(self.shaft.speed * 60.0 * self.settings.pole_pairs)
        self.say(self._frame(STATUS, struct.pack(">ihh", erpm, int(max(min(ampere, 3e3), -3e3) * 10.0), 0)))
        tachometer = round(self.counted * self.settings.pole_pairs * 6)
        self.say(self._frame(STATUS_5, struct.pack(">ihh", tachometer, int(self.supply_v * 10.0), 0)))


def _period_ns(rate_hz: int) -> int:
    return 1_000_000_000 // rate_hz if rate_hz else 0


def _bounded(turns_s: float) -> float:
    return max(-TOP, min(TOP, turns_s))
