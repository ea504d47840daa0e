"""An axis of an ODrive with firmware 0.5.6 or 0.6 on CAN (CANSimple), from its frames to its shaft.

Written from other-drives.md and from reading firmware 0.5.6 (can_simple.cpp and axis.cpp in odriverobotics/ODrive); of
0.6, whose source was not to be found, from can_simple_messages.hpp and odrive_enums.h in odriverobotics/ros_odrive.
[inf] marks what none of them says and is assumed here: a host should not depend on it.

Modelled:
- Identifiers: standard, node << 5 | command. Other nodes and extended frames meet silence. Reads are asked by a remote
  frame of any length or by a data frame without data, and answered with 8 bytes on the same identifier; the
  controller's error (1D) is told to any frame. [inf] A write that is too short, or with a number that is not finite, a
  limit that is not positive, changes nothing (the firmware takes whatever its buffer holds).
- By itself: heartbeats, and encoder estimates where they are on. What finds the queue full is lost.
- Until the loop has been closed once since power came, 0.5.6 tells estimates (09) of 0.0 and 0.0; its count (0A) is
  true all the time. [inf] 0.6 tells true estimates all the time.
- 0.6 tells its version (00); errors and why the loop was opened (03), both the same here; in heartbeats one word of
  errors and, beside the state, what became of the state asked for last. Errors are of the axis, without parts.
- States: idle (1), full calibration (3, seen as 4 and then 7, which turns the shaft a little to and fro), closed loop
  (8). A state that it cannot take, with an error standing, not calibrated, or unknown, is error bit 0, and idle; with
  0.6 it is no error but a procedure result [inf: which, and that it stays idle]. Taking closed loop in position control
  makes the present position the target [inf: of 0.6].
- Position control with passthrough or trapezoids, velocity control with passthrough or a ramp, torque control; other
  combinations are an error of the controller as soon as the loop is closed. Limits, gains, trajectory limits.
- Errors: emergency stop, watchdog (fed by every frame for this node), and those that `protect` makes; any lets the
  shaft go. Clearing does not close the loop again.
- An incremental encoder counts from 0 where it stands when power comes; an absolute one goes on. The count can be set
  (19); what the loop was told stays, so that a closed one goes there by the new count.
- [inf] Inputs are forgotten when the loop is closed; rebooting (16) takes no time.

Not modelled: start-up settings, anticogging, inertia feed-forward, sensorless running, voltages of inputs, input
filters and the other input modes, overspeed, end stops, homing, and that a host's write could be an answer to another;
of 0.6 addresses (06), parameters (04, 05), temperatures (15), setting the position (19) and torques (1C).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

from config.drives.odrive import OdriveDrive as OdriveConfig
from sim.bus import Frame
from sim.drives.conversation import ServoDrive
from sim.drives.drive import Cause, Mounting
from sim.drives.servo import TURN_RAD, Cascade, Law, Limp, Load, Plan, Spin, Torque

COMMAND_BITS, NODE_BITS = 5, 6
MILLISECOND = 1_000_000

UNDEFINED, IDLE, FULL_CALIBRATION, MOTOR_CALIBRATION, OFFSET_CALIBRATION, CLOSED_LOOP = 0, 1, 3, 4, 7, 8
POSITION_CONTROL, PASSTHROUGH = 3, 1
"""Control modes: 1 torque, 2 velocity, 3 position. Input modes: 1 passthrough, 2 ramp, 5 trapezoid."""

Firmware = Literal["0.5.6", "0.6"]


class Errors(NamedTuple):
    """Bits of the axis' error; 0.5.6 has one for what went wrong in a part, whose own error says what."""

    spinout: int
    current: int
    temperature: int
    bad_modes: int
    watchdog: int
    estop: int


INVALID_STATE, MOTOR_FAILED, CONTROLLER_FAILED, ESTOP_REQUESTED = 1 << 0, 1 << 6, 1 << 9, 1 << 14
"""Bits of 0.5.6."""
ERRORS: dict[Firmware, Errors] = {
    "0.5.6": Errors(CONTROLLER_FAILED, MOTOR_FAILED, 1 << 18, CONTROLLER_FAILED, 1 << 11, ESTOP_REQUESTED),
    "0.6": Errors(1 << 26, 1 << 12, 1 << 13, 1 << 4, 1 << 24, 1 << 25),
}
CURRENT_LIMIT_VIOLATION = 0x1000
"""Bit of the motor's error."""
INVALID_INPUT_MODE, SPINOUT_DETECTED = 0x02, 0x80
"""Bits of the controller's error."""

MOTOR_CALIBRATION_NS = 1_500_000_000
CALIBRATION_TURNS, CALIBRATION_TURNS_S = 8.0 / 7.0, 2.0 / 7.0
"""How far and how fast the shaft turns to find the encoder's offset: 16 pi at 4 pi rad/s electrically, 7 pole pairs."""
CALIBRATION_RAMP = 10.0
"""[rev/s²] [inf]."""

VELOCITY_BANDWIDTH_S, HEADROOM = 150.0, 1.2
"""How its owner tuned its velocity loop [1/s], and its velocity limit beside the joint's [inf]."""
WINDING_OHM, BOARD_W = 0.05, 1.2
"""What makes the current of its supply plausible [inf]."""

_TWO_FLOATS = struct.Struct("<ff")
_POSITION = struct.Struct("<fhh")
_TWO_WORDS = struct.Struct("<II")
_WORD = struct.Struct("<I")
SUCCESS, BUSY, DISARMED, INVALID_PROCEDURE, NOT_CALIBRATED = 0, 1, 3, 13, 14
"""What 0.6 says became of the state that it was asked for last."""
VERSION = bytes((2, 4, 4, 58, 0, 6, 10, 0))
"""What 0.6 answers to 00: protocol, hardware 4.4.58 [inf], firmware 0.6.10, released."""

_COUNT = struct.Struct("<i")
_COUNTS = struct.Struct("<ii")
_FLOAT = struct.Struct("<f")
_LONG = struct.Struct("<Q")
_HEARTBEAT = struct.Struct("<I4B")
"""Error, state, flags of motor, encoder and controller; of 0.6 error, state, procedure result, trajectory done, 0."""


@dataclass
class Settings:
    """What it keeps in flash, as its owner tuned it.

    Attributes:
        node_id: on the bus, 0 to 63.
        firmware: of the board.
        encoder_cpr: counts of its encoder for a turn.
        absolute: whether the encoder knows its angle when power comes.
        calibrated: whether it may close its loop after power has come.
        heartbeat_ms, estimates_ms: periods; 0 for none.
        watchdog_s: silence after which it lets go; 0 for never.
        control_mode, input_mode: as in 0B.
        top: velocity limit [rev/s].
        ampere: current limit.
        nm_per_ampere: the motor's torque constant.
        position_gain: 1/s.
        velocity_gain: N·m/(rev/s).
        ramp: of velocity control with a ramp [rev/s²].
        trajectory_top, trajectory_up, trajectory_down: of trapezoids [rev/s, rev/s²].
    """

    node_id: int = 0
    firmware: Firmware = "0.5.6"
    encoder_cpr: int = 8192
    absolute: bool = False
    calibrated: bool = True
    heartbeat_ms: int = 100
    estimates_ms: int = 10
    watchdog_s: float = 0.0
    control_mode: int = POSITION_CONTROL
    input_mode: int = PASSTHROUGH
    top: float = 2.0
    ampere: float = 10.0
    nm_per_ampere: float = 0.04
    position_gain: float = 20.0
    velocity_gain: float = 0.16
    ramp: float = 1.0
    trajectory_top: float = 2.0
    trajectory_up: float = 0.5
    trajectory_down: float = 0.5


class OdriveDrive(ServoDrive):
    """One axis: a node of the bus with a shaft.

    Args:
        settings: what it keeps in flash.
        start_ns, turns, counted, load, seed: see `ServoDrive`.

    Attributes:
        settings: as they are now; power brings back what was in flash, but the node.
        state: of the axis, as heartbeats say it.
        result: what became of the state asked for last, as those of 0.6 say it.
        axis_error, motor_error, controller_error: as they are read; 0.6 has the first alone.
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
        self._flash = settings or Settings()
        self._strongest_nm = self.shaft.load.torque_nm
        self._writes: dict[int, tuple[struct.Struct, Callable[..., None]]] = {
            0x06: (_WORD, self._set_node),
            0x07: (_WORD, self._request_state),
            0x0B: (_TWO_WORDS, self._set_modes),
            0x0C: (_POSITION, self._set_position),
            0x0D: (_TWO_FLOATS, self._set_velocity),
            0x0E: (_FLOAT, self._set_torque),
            0x0F: (_TWO_FLOATS, self._set_limits),
            0x11: (_FLOAT, self._set_trajectory_top),
            0x12: (_TWO_FLOATS, self._set_trajectory_ramps),
            0x19: (_COUNT, self._set_count),
            0x1A: (_FLOAT, self._set_position_gain),
            0x1B: (_TWO_FLOATS, self._set_velocity_gains),
        }
        self._reads: dict[int, Callable[[], bytes]] = {
            0x03: lambda: _LONG.pack(self.motor_error),
            0x04: lambda: _LONG.pack(0),
            0x05: lambda: _LONG.pack(0),
            0x09: self._estimates,
            0x0A: self._counts,
            0x14: self._currents,
            0x15: lambda: _TWO_FLOATS.pack(0.0, 0.0),
            0x17: self._supply,
            0x1D: lambda: _LONG.pack(self.controller_error),
        }
        if self._flash.firmware == "0.6":
            for changed in (0x06, 0x19):
                del self._writes[changed]
            for gone in (0x04, 0x05, 0x0A, 0x15, 0x1D):
                del self._reads[gone]
            self._reads[0x00] = lambda: VERSION
            self._reads[0x03] = lambda: _TWO_WORDS.pack(self.axis_error, self.axis_error)
        self._begin()

    @classmethod
    def mounted(cls, mounting: Mounting) -> OdriveDrive:
        """The axis of a joint, tuned to its load and limits."""
        joint, load = mounting.joint, mounting.load
        config = joint.drive
        assert isinstance(config, OdriveConfig)
        nm_per_ampere = config.nm_per_ampere or Settings.nm_per_ampere
        settings = Settings(
            node_id=config.node_id,
            firmware=mounting.odrive_firmware,
            encoder_cpr=config.encoder_cpr,
            absolute=config.encoder == "absolute",
            heartbeat_ms=config.heartbeat_ms,
            estimates_ms=config.estimates_ms,
            top=HEADROOM * joint.motor_rpm / 60.0,
            ampere=load.torque_nm / nm_per_ampere,
            nm_per_ampere=nm_per_ampere,
            velocity_gain=VELOCITY_BANDWIDTH_S * load.inertia_kg_m2 * TURN_RAD,
        )
        turns = mounting.turns(mounting.position_rad)
        counted = turns if mounting.homed or settings.absolute else 0.0
        return cls(settings, start_ns=mounting.start_ns, turns=turns, counted=counted, load=load, seed=mounting.seed)

    # -- as others know it ---------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is of its node."""
        return not frame.extended and frame.can_id >> COMMAND_BITS == self.settings.node_id

    def state_frame(self, now_ns: int) -> Frame:
        """The estimates it would send at `now_ns`."""
        self.advance(now_ns)
        return self._frame(0x09, self._estimates())

    def twin(self, now_ns: int, seed: int) -> OdriveDrive:
        """Another axis with its node, from `now_ns` on, which counts from zero."""
        return OdriveDrive(replace(self.settings), start_ns=now_ns, seed=seed)

    # -- what happens to it --------------------------------------------------------------------------

    def boot(self) -> None:
        """Idle, with the settings of its flash; an incremental encoder begins to count."""
        if not self._flash.absolute:
            self.origin += self.counted
        self._begin()

    def _begin(self) -> None:
        self.settings = replace(self._flash)
        self.axis_error = self.motor_error = self.controller_error = 0
        self.result = SUCCESS
        self._errors = ERRORS[self.settings.firmware]
        self._knows_estimates = self.settings.firmware == "0.6"
        self._input = (0.0, 0.0, 0.0)
        self._limit_torque()
        self._idle()
        self.every("heartbeat", self.settings.heartbeat_ms * MILLISECOND, self._beat)
        self.every("estimates", self.settings.estimates_ms * MILLISECOND, self._tell_estimates)
        self._feed_watchdog()

    def release(self) -> None:
        """Idle, as when somebody asked for it over USB."""
        self._idle()

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Fail: a stalled controller, a hot motor, or too much current in it."""
        self.advance(now_ns)
        match cause:
            case "stall":
                self.controller_error |= SPINOUT_DETECTED
                self._fail(self._errors.spinout)
            case "temperature":
                self._fail(self._errors.temperature)
            case "current":
                self.motor_error |= CURRENT_LIMIT_VIOLATION
                self._fail(self._errors.current)

    def _fail(self, error: int) -> None:
        self.axis_error |= error
        self.result = DISARMED
        self._idle()

    def _idle(self) -> None:
        self.state = IDLE
        self.enabled = False
        self.cancel("calibration")
        self.shaft.obey(Limp())

    # -- the host's side -----------------------------------------------------------------------------

    def concerns(self, frame: Frame) -> bool:
        """Whether it is of its node."""
        return self.owns(frame)

    def take(self, frame: Frame) -> None:
        """Obey a frame for its node."""
        self._feed_watchdog()
        command = frame.can_id & ((1 << COMMAND_BITS) - 1)
        if command in self._reads:
            if frame.remote or not frame.data or command == 0x1D:
                self.reply(self._frame(command, self._reads[command]()))
        elif command == 0x02:
            self._fail(self._errors.estop)
        elif command == 0x16:
            self.boot()
        elif command == 0x18:
            self._clear_errors()
        elif command in self._writes and not frame.remote:
            layout, write = self._writes[command]
            if len(frame.data) >= layout.size:
                write(*layout.unpack_from(frame.data))

    def _frame(self, command: int, data: bytes) -> Frame:
        return Frame(self.settings.node_id << COMMAND_BITS | command, data, extended=False)

    def _beat(self) -> None:
        done = self._trajectory_done()
        flags = [self.motor_error != 0, 0, (self.controller_error != 0) | done << 7]
        if self.settings.firmware == "0.6":
            flags = [self.result, done, 0]
        self.say(self._frame(0x01, _HEARTBEAT.pack(self.axis_error, self.state, *flags)))

    def _tell_estimates(self) -> None:
        self.say(self._frame(0x09, self._estimates()))

    def _trajectory_done(self) -> bool:
        return not (isinstance(self.shaft.law, Plan) and not self.shaft.law.rests)

    def _estimates(self) -> bytes:
        cpr = self.settings.encoder_cpr
        if not self._knows_estimates:
            return _TWO_FLOATS.pack(0.0, 0.0)
        return _TWO_FLOATS.pack(round(self.counted * cpr) / cpr, self.shaft.speed)

    def _counts(self) -> bytes:
        count, cpr = round(self.counted * self.settings.encoder_cpr), self.settings.encoder_cpr
        return _COUNTS.pack((count + (1 << 31)) % (1 << 32) - (1 << 31), count % cpr)

    def _currents(self) -> bytes:
        ampere = self.shaft.torque_nm / self.settings.nm_per_ampere
        return _TWO_FLOATS.pack(ampere, ampere)

    def _supply(self) -> bytes:
        ampere = self.shaft.torque_nm / self.settings.nm_per_ampere
        watt = self.shaft.torque_nm * self.shaft.speed * TURN_RAD + WINDING_OHM * ampere * ampere + BOARD_W
        return _TWO_FLOATS.pack(self.supply_v, watt / self.supply_v)

    def _feed_watchdog(self) -> None:
        if self.settings.watchdog_s > 0.0:
            self.after("watchdog", round(self.settings.watchdog_s * 1e9), lambda: self._fail(self._errors.watchdog))

    def _clear_errors(self) -> None:
        if not self.cause_lasts:
            self.axis_error = self.motor_error = self.controller_error = 0

    # -- states --------------------------------------------------------------------------------------

    def _request_state(self, state: int) -> None:
        if state == IDLE:
            self.result = SUCCESS
            self._idle()
        elif state == FULL_CALIBRATION and not self.axis_error:
            self.result = BUSY
            self._idle()
            self.state = MOTOR_CALIBRATION
            self.after("calibration", MOTOR_CALIBRATION_NS, lambda: self._find_offset(CALIBRATION_TURNS))
        elif state == CLOSED_LOOP and not self.axis_error and self.settings.calibrated:
            self._close_loop()
        elif state != UNDEFINED and self.settings.firmware == "0.6":
            known = state in (FULL_CALIBRATION, CLOSED_LOOP)
            self.result = NOT_CALIBRATED if known and not self.axis_error else INVALID_PROCEDURE
            self._idle()
        elif state != UNDEFINED:
            self._fail(INVALID_STATE)

    def _find_offset(self, way: float) -> None:
        """Turn the shaft there, and then back, and be calibrated."""
        self.state = OFFSET_CALIBRATION
        here = self.shaft.position_at(self._now_ns)
        self.shaft.obey(Plan(here + way, CALIBRATION_TURNS_S, CALIBRATION_RAMP))
        takes_ns = round((CALIBRATION_TURNS / CALIBRATION_TURNS_S + 0.1) * 1e9)
        self.after("calibration", takes_ns, partial(self._find_offset, -way) if way > 0.0 else self._calibrated)

    def _calibrated(self) -> None:
        self.settings.calibrated = True
        self.result = SUCCESS
        self._idle()

    def _close_loop(self) -> None:
        self.cancel("calibration")
        self.state = CLOSED_LOOP
        self.result = BUSY
        self.enabled = self._knows_estimates = True
        self._input = (self.counted, 0.0, 0.0)
        self._lead()

    def _lead(self) -> None:
        """Let the shaft do what modes and inputs say."""
        if self.state != CLOSED_LOOP:
            return
        law = self._law()
        if law is None:
            self.controller_error |= INVALID_INPUT_MODE
            self._fail(self._errors.bad_modes)
        else:
            self.shaft.obey(law)

    def _law(self) -> Law | None:
        settings = self.settings
        position, speed, torque_nm = self._input
        match settings.control_mode, settings.input_mode:
            case (3, 1):
                law = Cascade(self.origin + position, settings.position_gain, settings.velocity_gain, settings.top)
                law.speed_ahead, law.torque_ahead = speed, torque_nm
                return law
            case (3, 5):
                top = min(settings.trajectory_top, settings.top)
                return Plan(self.origin + position, top, settings.trajectory_up, settings.trajectory_down)
            case (2, 1):
                law = Cascade(0.0, None, settings.velocity_gain, settings.top)
                law.speed_ahead, law.torque_ahead = speed, torque_nm
                return law
            case (2, 2):
                return Spin(max(-settings.top, min(settings.top, speed)), settings.ramp)
            case (1, 1):
                return Torque(torque_nm=torque_nm)
        return None

    # -- writes --------------------------------------------------------------------------------------

    def _set_node(self, node_id: int) -> None:
        if node_id < 1 << NODE_BITS:
            self.settings.node_id = self._flash.node_id = node_id

    def _set_modes(self, control: int, given: int) -> None:
        self.settings.control_mode, self.settings.input_mode = control, given
        self._lead()

    def _set_position(self, position: float, speed: int, torque: int) -> None:
        if math.isfinite(position):
            self._input = (position, speed * 1e-3, torque * 1e-3)
            if self.settings.control_mode == POSITION_CONTROL:
                self._lead()

    def _set_velocity(self, speed: float, torque_nm: float) -> None:
        if math.isfinite(speed) and math.isfinite(torque_nm):
            self._input = (self._input[0], speed, torque_nm)
            self._lead()

    def _set_torque(self, torque_nm: float) -> None:
        if math.isfinite(torque_nm):
            self._input = (*self._input[:2], torque_nm)
            self._lead()

    def _set_limits(self, top: float, ampere: float) -> None:
        if _positive(top, ampere):
            self.settings.top, self.settings.ampere = top, ampere
            self._limit_torque()
            self._lead()

    def _limit_torque(self) -> None:
        self.shaft.load.torque_nm = min(self.settings.ampere * self.settings.nm_per_ampere, self._strongest_nm)

    def _set_trajectory_top(self, top: float) -> None:
        if _positive(top):
            self.settings.trajectory_top = top

    def _set_trajectory_ramps(self, up: float, down: float) -> None:
        if _positive(up, down):
            self.settings.trajectory_up, self.settings.trajectory_down = up, down

    def _set_count(self, count: int) -> None:
        self.origin = self.shaft.position_at(self._now_ns) - count / self.settings.encoder_cpr
        self._lead()

    def _set_position_gain(self, gain: float) -> None:
        if _positive(gain):
            self.settings.position_gain = gain
            self._lead()

    def _set_velocity_gains(self, gain: float, integrator: float) -> None:
        if _positive(gain) and math.isfinite(integrator):
            self.settings.velocity_gain = gain
            self._lead()


def _positive(*values: float) -> bool:
    return all(math.isfinite(value) and value > 0.0 for value in values)
