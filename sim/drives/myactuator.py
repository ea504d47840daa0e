"""A MyActuator RMD motor on CAN, from its frames to its shaft.

Written from other-drives.md, drives-checked.md, the maker's Motor Motion Protocol V4.2 and V4.3 and the tests of
2b-t/myactuator_rmd; [inf] marks what none of them says and is assumed here: a host should not depend on it.

Modelled:
- Identifiers: standard, 140 + ID or 280 (all motors) in, 240 + ID out, 8 bytes. [inf] Anything else, and commands that
  are not modelled, change nothing and meet silence.
- A4 goes to an absolute target by a trapezoid with the ramps of 43, indexes 0 and 1, or by a loop within its speed
  where the acceleration is 0 (which 43 does not take [inf]); a new target is taken in mid-move. A8 likewise from where
  it is, A2 speed, A1 current, 81 no speed. [inf] 81 brakes with index 3; a speed of 0 in A4 is no limit.
- 80 shuts down; a motor with a brake is locked then, another one is loose. Motion commands release the brake, 77 and
  78 move it; what 9A says of it is the last command to it, with or without a brake.
- Errors: any shuts down, and no motion command is obeyed meanwhile. Stall, over-current and those of the encoder stay
  until a restart (76), 1.1 s of silence; the others end with their cause. [inf] It answers motion commands as always.
- B3: silence for longer than that shuts down, and the next frame ends that. Zero (64) counts after a restart. Ramps,
  zero and B3 are kept in its ROM.
- B1 tells the time since power came or it was restarted (ms), in 32 bits that begin anew.
- An encoder that is not absolute counts from 0 where it stands when power comes or it is restarted.

Not modelled: gains (30 to 32), function control (20), reports (B6), bit rates, setting the ID, single-turn commands.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from config.drives.myactuator import ALL_MOTORS, RAMP_RANGE_DPS_S, REPLY, REQUEST
from config.drives.myactuator import MyactuatorDrive as MyactuatorConfig
from sim.bus import Frame
from sim.drives.conversation import ServoDrive
from sim.drives.drive import Cause, Mounting
from sim.drives.servo import TURN_RAD, Cascade, Hold, Law, Limp, Load, Plan, Spin, Torque

STALL, LOW_VOLTAGE, OVER_CURRENT, OVER_TEMPERATURE = 0x0002, 0x0004, 0x0010, 0x1000
ENCODER_CALIBRATION, ENCODER_DATA = 0x2000, 0x4000
UNTIL_RESTART = STALL | OVER_CURRENT | ENCODER_CALIBRATION | ENCODER_DATA
STEPS_PER_TURN, DEGREES = 36_000, 360.0
UNLIMITED_DPS = 32_767
RESTART_NS = 1_100_000_000
"""Of silence after 76 (drives-checked.md, D6)."""
TRACKING_GAIN_S, VELOCITY_BANDWIDTH_S = 20.0, 150.0
"""Of its loops [1/s] [inf]."""
OFF, CURRENT, SPEED, POSITION = 0, 1, 2, 3
"""What 70 says; [inf] 0 where it is shut down."""
MODEL, BUILT = b"X8S2V10", 20220206
UP_BEFORE_NS = 60_000_000_000
"""For how long a motor has had power when it begins to exist."""
STUCK_UPTIME_MS = 90_000_000
UptimeKind = Literal["right", "absent", "stuck"]


@dataclass
class Settings:
    """How it is built, and what is in its ROM.

    Attributes:
        motor_id: on the bus.
        absolute: whether its encoder knows its angle when power comes.
        brake: whether it has one.
        nm_per_ampere: of its output shaft.
        ramps_dps_s: of position planning (up, down) and speed planning (up, down).
        timeout_ms: silence after which it shuts down; 0 for never.
        velocity_gain: of its velocity loop [N·m/(rev/s)].
    """

    motor_id: int = 1
    absolute: bool = False
    brake: bool = False
    nm_per_ampere: float = 1.0
    ramps_dps_s: list[int] = field(default_factory=lambda: [10_000] * 4)
    timeout_ms: int = 0
    velocity_gain: float = 1.0


class MyactuatorDrive(ServoDrive):
    """One motor: a node of the bus with a shaft.

    Args:
        settings: how it is built and set.
        start_ns, turns, counted, load, seed: see `ServoDrive`.

    Attributes:
        settings: as they are now.
        error: bits of 9A.
        mode: as 70 says it.
        brake_released: the last command to its brake.
        rom_writes: how often its ROM was written.
        uptime: whether B1 is "right", not answered ("absent"), or always the same number ("stuck").
        clock: what its clock makes of a second (s).
        up_since_ns: when power came, or it was restarted.
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
        self.rom_writes = self.error = 0
        self.uptime: UptimeKind = "right"
        self.clock = 1.0
        self._zero_turns = 0.0
        self._does: dict[int, Callable[[bytes], bytes | None]] = {
            0x42: self._read_ramp,
            0x43: self._write_ramp,
            0x64: self._set_zero,
            0x70: lambda data: bytes((0x70, 0, 0, 0, 0, 0, 0, self.mode)),
            0x76: self._restart,
            0x77: lambda data: self._set_brake(data, released=True),
            0x78: lambda data: self._set_brake(data, released=False),
            0x80: self._shut_down,
            0x81: self._stop,
            0x92: lambda data: struct.pack("<Bxxxi", 0x92, self._angle()),
            0x9A: self._status,
            0x9C: self._feedback,
            0xA1: self._current,
            0xA2: self._speed,
            0xA4: self._target,
            0xA8: self._target,
            0xB1: self._tell_uptime,
            0xB2: lambda data: struct.pack("<BxxxI", 0xB2, BUILT),
            0xB3: self._set_timeout,
            0xB5: lambda data: bytes((0xB5, *MODEL)),
        }
        self._begin()
        self.up_since_ns = start_ns - UP_BEFORE_NS

    @classmethod
    def mounted(cls, mounting: Mounting) -> MyactuatorDrive:
        """The motor of a joint, with the ramps that it comes with."""
        config, load = mounting.joint.drive, mounting.load
        assert isinstance(config, MyactuatorConfig)
        settings = Settings(
            motor_id=config.motor_id,
            absolute=config.encoder == "absolute",
            nm_per_ampere=config.nm_per_ampere or Settings.nm_per_ampere,
            velocity_gain=VELOCITY_BANDWIDTH_S * load.inertia_kg_m2 * TURN_RAD,
        )
        turns = mounting.turns(mounting.position_rad)
        counted = turns if mounting.homed or settings.absolute else 0.0
        return cls(settings, start_ns=mounting.start_ns, turns=turns, counted=counted, load=load, seed=mounting.seed)

    # -- as others know it ---------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is for it or from it."""
        motor = self.settings.motor_id
        return not frame.extended and frame.can_id in (REQUEST + motor, REPLY + motor, ALL_MOTORS)

    def state_frame(self, now_ns: int) -> Frame:
        """The angle it would tell at `now_ns`."""
        self.advance(now_ns)
        return self._frame(struct.pack("<Bxxxi", 0x92, self._angle()))

    def twin(self, now_ns: int, seed: int) -> MyactuatorDrive:
        """Another motor with its ID, from `now_ns` on, which counts from zero."""
        return MyactuatorDrive(Settings(motor_id=self.settings.motor_id), start_ns=now_ns, seed=seed)

    # -- what happens to it --------------------------------------------------------------------------

    def boot(self) -> None:
        """Shut down, with the settings of its ROM; an encoder that is not absolute begins to count."""
        self.origin += self._zero_turns if self.settings.absolute else self.counted
        self._begin()

    def _begin(self) -> None:
        self._zero_turns = 0.0
        self.up_since_ns = self._now_ns
        self.error = self.error if self.cause_lasts else 0
        self.release()
        self._feed_timeout()

    def release(self) -> None:
        """Shut down, as with 80."""
        self.mode = OFF
        self.enabled = False
        self.brake_released = False
        self.shaft.obey(Hold() if self.settings.brake else Limp())

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Shut down with an error."""
        self.advance(now_ns)
        self.error |= {"stall": STALL, "temperature": OVER_TEMPERATURE, "current": OVER_CURRENT}[cause]
        self.release()

    # -- the host's side -----------------------------------------------------------------------------

    def concerns(self, frame: Frame) -> bool:
        """Whether it is a whole request, of it or of all."""
        whole = not frame.extended and not frame.remote and len(frame.data) == 8
        return whole and frame.can_id in (REQUEST + self.settings.motor_id, ALL_MOTORS)

    def take(self, frame: Frame) -> None:
        """Obey a frame for it."""
        self._feed_timeout()
        if not self.cause_lasts:
            self.error &= UNTIL_RESTART
        does = self._does.get(frame.data[0])
        answer = does(frame.data) if does is not None else None
        if answer is not None:
            self.reply(self._frame(answer))

    def _frame(self, data: bytes) -> Frame:
        return Frame(REPLY + self.settings.motor_id, data, extended=False)

    def _feed_timeout(self) -> None:
        self.cancel("timeout")
        if self.settings.timeout_ms > 0:
            self.after("timeout", self.settings.timeout_ms * 1_000_000, self.release)

    def _angle(self) -> int:
        return _signed(round(self.counted * STEPS_PER_TURN), 32)

    def _status(self, data: bytes) -> bytes:
        volts = round(self.supply_v * 10.0)
        return struct.pack("<BbxBHH", 0x9A, round(self.celsius), self.brake_released, volts, self.error)

    def _feedback(self, data: bytes) -> bytes:
        ampere = self.shaft.torque_nm / self.settings.nm_per_ampere
        return struct.pack(
            "<Bbhhh",
            data[0],
            round(self.celsius),
            max(-32_768, min(32_767, round(ampere * 100.0))),
            max(-32_768, min(32_767, round(self.shaft.speed * DEGREES))),
            _signed(round(self.counted * DEGREES), 16),
        )

    def _tell_uptime(self, data: bytes) -> bytes | None:
        if self.uptime == "absent":
            return None
        up_ms = int((self._now_ns - self.up_since_ns) * self.clock) // 1_000_000
        return struct.pack("<BxxxI", 0xB1, STUCK_UPTIME_MS if self.uptime == "stuck" else up_ms % (1 << 32))

    def _read_ramp(self, data: bytes) -> bytes | None:
        if data[1] >= len(self.settings.ramps_dps_s):
            return None
        return struct.pack("<BBxxI", 0x42, data[1], self.settings.ramps_dps_s[data[1]])

    def _write_ramp(self, data: bytes) -> bytes:
        ramp = int.from_bytes(data[4:], "little")
        if data[1] < len(self.settings.ramps_dps_s) and RAMP_RANGE_DPS_S[0] <= ramp <= RAMP_RANGE_DPS_S[1]:
            self.settings.ramps_dps_s[data[1]] = ramp
            self.rom_writes += 1
        return data

    def _set_zero(self, data: bytes) -> bytes:
        self._zero_turns = self.counted
        self.rom_writes += 1
        return struct.pack("<Bxxxi", 0x64, _signed(round(self.counted * STEPS_PER_TURN), 32))

    def _set_timeout(self, data: bytes) -> bytes:
        self.settings.timeout_ms = int.from_bytes(data[4:], "little")
        self.rom_writes += 1
        self._feed_timeout()
        return data

    def _restart(self, data: bytes) -> None:
        self.release()
        self.listening = False
        self.after("restart", RESTART_NS, self._restarted)

    def _restarted(self) -> None:
        self.listening = self.connected and self.powered
        self.boot()

    # -- motion --------------------------------------------------------------------------------------

    def _set_brake(self, data: bytes, *, released: bool) -> bytes:
        self.brake_released = released
        if self.settings.brake and not released:
            self.mode = OFF
            self.enabled = False
            self.shaft.obey(Hold())
        elif self.settings.brake and self.mode == OFF:
            self.shaft.obey(Limp())
        return data

    def _shut_down(self, data: bytes) -> bytes:
        self.release()
        return data

    def _run(self, mode: int, law: Law) -> None:
        if self.error:
            return
        self.mode = mode
        self.enabled = self.brake_released = True
        self.shaft.obey(law)

    def _stop(self, data: bytes) -> bytes:
        if self.mode != OFF:
            self._run(SPEED, Spin(0.0, self.settings.ramps_dps_s[3] / DEGREES))
        return data

    def _current(self, data: bytes) -> bytes:
        ampere = struct.unpack_from("<h", data, 4)[0] / 100.0
        if self.brake_released:
            self._run(CURRENT, Torque(torque_nm=ampere * self.settings.nm_per_ampere))
        return self._feedback(data)

    def _speed(self, data: bytes) -> bytes:
        speed = struct.unpack_from("<i", data, 4)[0] / STEPS_PER_TURN
        self._run(SPEED, Spin(speed, self.settings.ramps_dps_s[2] / DEGREES))
        return self._feedback(data)

    def _target(self, data: bytes) -> bytes:
        most, angle = struct.unpack_from("<Hi", data, 2)
        turns = angle / STEPS_PER_TURN + (self.counted if data[0] == 0xA8 else 0.0)
        top = (most or UNLIMITED_DPS) / DEGREES
        up, down = (ramp / DEGREES for ramp in self.settings.ramps_dps_s[:2])
        law = self.shaft.law
        if up == 0.0:
            law = Cascade(self.origin + turns, TRACKING_GAIN_S, self.settings.velocity_gain, top)
        elif isinstance(law, Plan):
            law.target, law.top, law.acceleration, law.deceleration = self.origin + turns, top, up, down or up
        else:
            law = Plan(self.origin + turns, top, up, down or up)
        self._run(POSITION, law)
        return self._feedback(data)


def _signed(value: int, bits: int) -> int:
    half = 1 << bits - 1
    return (value + half) % (2 * half) - half
