"""An MKS SERVO42D or SERVO57D on CAN, from its frames to its shaft.

Written from other-drives.md and the maker's CAN manuals V1.0.6 and V1.0.9; [inf] marks what they leave open and what is
assumed here: a host should not depend on it.

Modelled:
- Framing: standard data frames on its CanID, answers on the same; the last byte is the sum of the identifier and all
  bytes before it. [inf] What is too long or short, ends in another byte or is unknown meets silence. Broadcasts (0) and
  its group are obeyed without an answer. An argument out of range is answered with 0 and changes nothing.
- Answers (8C): motion commands are answered where `respond` is on; their end (2, or 3 at a limit) is told where
  `active` is on too. [inf] All else is answered in any case.
- Motion: F4, F5, F6, FD, FE with the ramp of `ramp.py`; a speed of 0 is a stop, by the ramp or (acc 0) at once; F7
  stops at once. F5 retargets in mid-move (`retargets` False refuses that, as firmware before V1.0.5 may). [inf] The
  others do too; relative targets count from the last one; whatever stops keeps holding. Commands need a bus work mode
  (82: 3 to 5), an enabled motor, no tripped protection and no homing run, or are answered with 0.
- Counting anti-clockwise (the manuals disagree), 16384 to the turn, rounded down.
- Homing (90, 94, 91): to a switch, left first where it is closed already, or to a mechanical stop, away from it by the
  offset; [inf] without a ramp; zero is where it ends. F7 ends a run as failed. Zero where it stands (92).
- Limit (90): with it on, the switch stops every motion towards it, at once. Only the one at IN_1.
- Stall (3E): [inf] 1.8 degrees of error for a second; told until 3D, whether or not the protection (88) is on (V1.0.9).
  With it the shaft is let go until 3D and F3.
- Settings of one or several bytes, in flash at once; `00` reads them, and answers FF FF for what it does not know.
- Version (40, V1.0.9): calibrated and board in a byte, then the firmware's version, [inf] in three bytes.
- Power: [inf] it boots with a loose shaft, counting from 0 where that stands.
- 80 [inf] takes two seconds and turns nothing. 41 [inf] reboots at once.

Not modelled: restoring defaults (3F), outputs, zero mode (9A) beyond its bytes, keys and display, current, the error
count of 9D, synchronous motion, reports and heartbeat of V1.0.9; bit rate and microsteps other than 16 to 64 (which
would change what a speed means).
"""

from __future__ import annotations

from collections.abc import Callable

from config.drives.mks import MksDrive as MksConfig
from sim.bus import Frame
from sim.drives.conversation import BusDrive
from sim.drives.drive import Cause, Mounting
from sim.drives.mks_settings import FACTORY, HIGHEST
from sim.drives.ramp import GRAINS_PER_REVOLUTION
from sim.drives.shaft import Shaft
from sim.drives.stepper import Stepper

COUNTS_PER_REVOLUTION = 16_384
ERROR_STEPS_PER_REVOLUTION = 51_200
FULL_STEPS_PER_REVOLUTION = 200
RAMP_STEP_NS = 50_000
HIGHEST_RPM = {3: 400, 4: 1500, 5: 3000}
"""Of the work modes that heed the bus: open loop, closed loop, FOC."""
SR_VFOC = 5
CALIBRATION_NS = 2_000_000_000
COLLISION_NS = 100_000_000
"""How long a homing run pushes against a stop [inf]."""
STALL_NS = 1_000_000_000
SWITCH_BEFORE_STOP = GRAINS_PER_REVOLUTION // 50
"""How far before a joint's mechanical stop the switch of its drive closes [inf] [grains]."""
SWITCH_TRAVEL = GRAINS_PER_REVOLUTION // 200
"""How far a switch has to be left until it opens [inf] [grains]."""

VERSION = bytes((0x12, 1, 0, 9))
"""Calibrated, S42D_CAN, firmware 1.0.9."""

FAILED, DONE, COMPLETE, LIMITED = 0, 1, 2, 3
"""Results: refused, taken (or begun), ended, stopped by a limit."""
STANDS, FASTER, SLOWER, EVEN, HOMING, CALIBRATING = 1, 2, 3, 4, 5, 6
"""Answers to F1."""

MOTION_BYTES = {0xF4: 6, 0xF5: 6, 0xF6: 3, 0xFD: 6, 0xFE: 6}
"""Bytes between the code of a motion command and its checksum."""


def checksum(can_id: int, data: bytes) -> int:
    """The last byte of a frame whose others are `data`."""
    return (can_id + sum(data)) & 0xFF


class MksDrive(BusDrive):
    """One drive: a node of the bus with a shaft.

    Args:
        settings: what differs from the factory's settings.
        start_ns: when it begins to exist; the first time it may be told.
        position: where its shaft stands [grains], see `sim.drives.ramp`.
        counted: whether it counts there what the arm sees; otherwise it was just switched on and counts 0.
        retargets: whether a position command is taken in mid-move.
        lag_s: time constant of the shaft behind the ramp [s].
        seed: of the jitter of its answers.

    Attributes:
        settings: by their code, as they are in flash.
        stepper: what moves.
        origin: where its shaft stands when it counts 0 [grains].
        switch: where the switch at IN_1 closes [grains] and on which side of that (1 or -1) it is closed; None without.
        stalled: whether it has stalled, as 3E says it.
        protected: whether its protection has tripped.
    """

    def __init__(
        self,
        settings: dict[int, bytes] | None = None,
        *,
        start_ns: int = 0,
        position: int = 0,
        counted: bool = True,
        retargets: bool = True,
        lag_s: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__(start_ns=start_ns, seed=seed)
        self.settings = FACTORY | (settings or {})
        self.stepper = Stepper(
            start_ns, position, lag_s=lag_s, stood=self._stood, stalled=self._stalled, reached=self._reached
        )
        self.origin = 0 if counted else position
        self.switch: tuple[int, int] | None = None
        self.stalled = self.protected = False
        self._retargets = retargets
        self._tick_ns = 0
        self._finishing = 0
        self._ends: list[bytes] | None = None  # told once what is obeyed just now has been answered
        self._run = ""  # what a homing run does now: leave, search, return; nothing otherwise
        self._home_result = 0
        self._calibrating = False
        self._limited = False
        self._reads: dict[int, Callable[[], bytes]] = {
            0x30: self._count_with_carry,
            0x31: lambda: self.count.to_bytes(6, "big", signed=True),
            0x32: lambda: self.stepper.ramp.speed_rpm.to_bytes(2, "big", signed=True),
            0x33: self._pulses,
            0x34: lambda: bytes((self._port,)),
            0x35: lambda: self._counts(self.stepper.position).to_bytes(6, "big", signed=True),
            0x39: self._angle_error,
            0x3A: lambda: bytes((self.enabled,)),
            0x3B: lambda: bytes((0 if self._run else self._home_result,)),
            0x3D: self._clear_protection,
            0x3E: lambda: bytes((self.stalled,)),
            0x40: lambda: VERSION,
            0x41: self._restart,
            0x92: self._set_zero,
            0xF1: lambda: bytes((self.state,)),
            0xF7: self._emergency_stop,
        }

    @classmethod
    def mounted(cls, mounting: Mounting) -> MksDrive:
        """The drive of a joint, enabled and protected, with a stop at the joint's lower limit and a switch before that.

        It homes towards the stop, without the switch.
        """
        joint = mounting.joint
        assert isinstance(joint.drive, MksConfig)
        rates = {125_000: 0, 250_000: 1, 500_000: 2, 1_000_000: 3}
        drive = cls(
            {
                0x82: bytes((SR_VFOC,)),
                0x88: b"\x01",
                0x8A: bytes((rates.get(mounting.bitrate, 2),)),
                0x8B: joint.drive.can_id.to_bytes(2, "big"),
                0x90: bytes((0, joint.direction < 0, 0, 60, 0, 1)),
                0x94: bytes((0, 0, 0, 0, 3, 32)),
            },
            start_ns=mounting.start_ns,
            position=round(mounting.turns(mounting.position_rad) * GRAINS_PER_REVOLUTION),
            counted=mounting.homed,
            retargets=mounting.retarget == "accept",
            lag_s=mounting.lag_s,
            seed=mounting.seed,
        )
        drive.enabled = True
        stop = round(mounting.turns(joint.lower_rad) * GRAINS_PER_REVOLUTION)
        drive.switch = (stop + joint.direction * SWITCH_BEFORE_STOP, -joint.direction)
        if joint.direction > 0:
            drive.shaft.low = stop
        else:
            drive.shaft.high = stop
        return drive

    # -- what it is ----------------------------------------------------------------------------------

    @property
    def shaft(self) -> Shaft:
        """Its true motion."""
        return self.stepper.shaft

    @property
    def can_id(self) -> int:
        """Its own identifier."""
        return int.from_bytes(self.settings[0x8B], "big")

    @property
    def count(self) -> int:
        """What it counts, as `31` reads it."""
        return self._counts(self.stepper.position - self.origin)

    @property
    def state(self) -> int:
        """What `F1` reads."""
        ramp = self.stepper.ramp
        if self._calibrating:
            return CALIBRATING
        if self._mode not in HIGHEST_RPM:
            return FAILED
        if self._run:
            return HOMING
        if not self.stepper.moving:
            return STANDS
        change = abs(ramp.next_rpm) - abs(ramp.speed_rpm)
        return FASTER if change > 0 else SLOWER if change < 0 and ramp.event_ns - ramp.time_ns < self._tick_ns else EVEN

    @property
    def switched(self) -> bool:
        """Whether the switch at IN_1 is closed."""
        return self.switch is not None and (self.stepper.position - self.switch[0]) * self.switch[1] >= 0

    @property
    def _mode(self) -> int:
        return self.settings[0x82][0]

    @property
    def _able(self) -> bool:
        return self._mode in HIGHEST_RPM and self.enabled and not (self.protected or self._run or self._calibrating)

    @property
    def _port(self) -> int:
        """Bits of `34`; an open input is pulled high."""
        closed_level = self.settings[0x90][0]
        return (closed_level if self.switched else 1 - closed_level) | 0b0110

    @staticmethod
    def _counts(grains: int) -> int:
        return grains * COUNTS_PER_REVOLUTION // GRAINS_PER_REVOLUTION

    # -- the bus's side ------------------------------------------------------------------------------

    def concerns(self, frame: Frame) -> bool:
        """Whether it is for it, for its group or for everybody."""
        group = int.from_bytes(self.settings[0x8D], "big")
        return not frame.extended and not frame.remote and frame.can_id in (0, self.can_id, group)

    def take(self, frame: Frame) -> None:
        """Obey a frame that is for it, and answer one that is for it alone."""
        data = frame.data
        if len(data) < 2 or data[-1] != checksum(frame.can_id, data[:-1]):
            return
        own_id, code = self.can_id, data[0]
        self._ends = []
        answer = self._obey(code, data[1:-1])
        if answer is not None and frame.can_id == own_id and (code not in MOTION_BYTES or self._responds):
            self._answer(answer, own_id)
        for end in self._ends:
            self._answer(end, own_id)
        self._ends = None
        self._schedule()

    def _obey(self, code: int, arguments: bytes) -> bytes | None:
        """Do what is asked; the answer without its checksum."""
        if code == 0x00 and len(arguments) == 1:
            return bytes((arguments[0],)) + self.settings.get(arguments[0], b"\xff\xff")
        if code in self._reads and not arguments:
            return bytes((code,)) + self._reads[code]()
        if len(arguments) == MOTION_BYTES.get(code):
            return bytes((code, self._move(code, arguments)))
        if code == 0x91 and arguments in (b"", b"\x00"):
            return bytes((code, self._home()))
        if code == 0xF3 and len(arguments) == 1:
            return bytes((code, self._enable(arguments[0])))
        if code == 0x80 and arguments == b"\x00":
            return bytes((code, self._calibrate()))
        if code == 0xFF and arguments in (b"\xc8", b"\xca"):
            return bytes((code, DONE))
        if code in self.settings and len(arguments) == len(self.settings[code]):
            return bytes((code, self._set(code, arguments)))
        return None

    def _answer(self, answer: bytes, can_id: int) -> None:
        self.reply(Frame(can_id, answer + bytes((checksum(can_id, answer),)), extended=False))

    @property
    def _responds(self) -> bool:
        return self.settings[0x8C][0] == 1

    def _tell_end(self, code: int, result: int) -> None:
        """Tell that what was begun has come to its end, where it does so by itself."""
        if not self._responds or self.settings[0x8C][1] == 0:
            return
        if self._ends is not None:
            self._ends.append(bytes((code, result)))
        else:
            self._now_ns = max(self._now_ns, self.stepper.now_ns)
            self._answer(bytes((code, result)), self.can_id)

    def _schedule(self) -> None:
        super()._schedule()
        if self.powered and (self._finishing or self._run):
            self.wake_ns = min(self.wake_ns, self.stepper.event_ns)

    # -- reads ---------------------------------------------------------------------------------------

    def _count_with_carry(self) -> bytes:
        turns, rest = divmod(self.count, COUNTS_PER_REVOLUTION)
        return turns.to_bytes(4, "big", signed=True) + rest.to_bytes(2, "big")

    def _pulses(self) -> bytes:
        pulses = (self.stepper.target - self.origin) * self._pulses_per_revolution // GRAINS_PER_REVOLUTION
        return (pulses & 0xFFFFFFFF).to_bytes(4, "big")

    def _angle_error(self) -> bytes:
        error = self.stepper.error * ERROR_STEPS_PER_REVOLUTION // GRAINS_PER_REVOLUTION
        return (error & 0xFFFFFFFF).to_bytes(4, "big")

    @property
    def _pulses_per_revolution(self) -> int:
        return FULL_STEPS_PER_REVOLUTION * (self.settings[0x84][0] or 256)

    # -- commands ------------------------------------------------------------------------------------

    def _set(self, code: int, arguments: bytes) -> int:
        highest = HIGHEST.get(code, arguments)
        out_of_range = any(value > most for value, most in zip(arguments, highest, strict=True))
        if out_of_range or (code == 0x8B and not any(arguments)):
            return FAILED
        if code == 0x82 and self.stepper.moving:
            self._hold()
        self.settings[code] = arguments
        return DONE

    def _enable(self, wanted: int) -> int:
        if wanted > 1 or self._mode not in HIGHEST_RPM or (wanted and self.protected):
            return FAILED
        if not wanted:
            self.release()
        elif not self.enabled:
            self.enabled = True
            self._hold()
        return DONE

    def _calibrate(self) -> int:
        self._hold()
        self._calibrating = True

        def end() -> None:
            self._calibrating = False
            self._tell_end(0x80, 1)

        self.after("calibration", CALIBRATION_NS, end)
        return 0

    def _clear_protection(self) -> bytes:
        self.protected = self.protected and self.cause_lasts
        self.stalled = self.protected
        return bytes((FAILED if self.protected else DONE,))

    def _restart(self) -> bytes:
        self.boot()
        return bytes((DONE,))

    def _set_zero(self) -> bytes:
        self.origin = self.stepper.ramp.position if self.enabled else self.stepper.position
        return bytes((DONE,))

    def _emergency_stop(self) -> bytes:
        self._hold()
        return bytes((DONE,))

    # -- motion --------------------------------------------------------------------------------------

    def _move(self, code: int, arguments: bytes) -> int:
        if not self._able:
            return FAILED
        by_direction = code in (0xF6, 0xFD)
        rpm = min(int.from_bytes(arguments[:2], "big") & (0x0FFF if by_direction else 0xFFFF), HIGHEST_RPM[self._mode])
        sign = -1 if by_direction and arguments[0] & 0x80 else 1
        self._tick_ns = (256 - arguments[2]) * RAMP_STEP_NS if arguments[2] else 0
        if rpm == 0:
            return self._stop(code)
        if self.stepper.moving and not self._retargets:
            return FAILED
        target = None if code == 0xF6 else self._target(code, sign, arguments[3:])
        towards = sign if target is None else 1 if target > self.stepper.ramp.position else -1
        if self._limit_on and self.switch is not None and towards == self.switch[1]:
            if self.switched:
                return LIMITED
            self.stepper.mark, self._limited = self.switch[0], True
        else:
            self.stepper.mark, self._limited = None, False
        self._finishing = code
        if target is None:
            self._finishing = 0
            self.stepper.run(sign * rpm, self._tick_ns)
        else:
            self.stepper.seek(target, rpm, self._tick_ns)
        return DONE

    def _stop(self, code: int) -> int:
        self._finishing = code
        if self._tick_ns == 0:
            self.stepper.hold()
        else:
            self.stepper.run(0, self._tick_ns)
        if not self.stepper.moving:
            self._stood()
        return DONE

    def _target(self, code: int, sign: int, field: bytes) -> int:
        """Where a position command goes [grains]."""
        way = int.from_bytes(field, "big", signed=code != 0xFD) * sign
        steps = COUNTS_PER_REVOLUTION if code in (0xF4, 0xF5) else self._pulses_per_revolution
        base = self.origin if code in (0xF5, 0xFE) else self.stepper.target
        return base - (-way * GRAINS_PER_REVOLUTION // steps)  # up, as counts are rounded down

    @property
    def _limit_on(self) -> bool:
        return self.settings[0x90][4] == 1

    def _hold(self) -> None:
        """Stand still where the shaft is: end of every motion, homing included."""
        if self._run:
            self._end_run(FAILED)
        self._finishing = 0
        self.stepper.hold()

    def _stood(self) -> None:
        """The ramp has come to its end."""
        if self._run == "return":
            self._zero_found()
        elif self._finishing:
            code, self._finishing = self._finishing, 0
            self._tell_end(code, COMPLETE)

    def _reached(self) -> None:
        """The switch closes, or opens."""
        if self._run == "leave":
            self._search()
        elif self._run == "search":
            self.stepper.hold()
            self._zero_found()
        elif self._limited:
            code = self._finishing
            self._hold()
            if code:
                self._tell_end(code, LIMITED)

    def _stalled(self) -> None:
        """It has pushed in vain for a while."""
        if self._run == "search":
            self.stepper.hold()
            offset = int.from_bytes(self.settings[0x94][:4], "big", signed=True)
            self._run = "return"
            way = offset * GRAINS_PER_REVOLUTION // COUNTS_PER_REVOLUTION
            self.stepper.seek(self.stepper.position - self._home_sign * way, self._home_rpm, 0)
        elif not self._run:
            self.stalled = True
            if self.settings[0x88][0]:
                self.trip()

    def trip(self) -> None:
        """Let the shaft go, because the protection says so."""
        self.stalled = self.protected = True
        self.release()

    # -- homing --------------------------------------------------------------------------------------

    @property
    def _home_sign(self) -> int:
        return 1 if self.settings[0x90][1] else -1

    @property
    def _home_rpm(self) -> int:
        return max(int.from_bytes(self.settings[0x90][2:4], "big"), 1)

    def _home(self) -> int:
        if not self._able:
            return FAILED
        self._finishing = 0
        self._home_result = 0
        if self.settings[0x90][5] == 0 and self.switched:
            assert self.switch is not None
            self._run = "leave"
            self.stepper.mark = self.switch[0] - self.switch[1] * SWITCH_TRAVEL
            self.stepper.run(-self._home_sign * self._home_rpm, 0)
        else:
            self._search()
        return DONE

    def _search(self) -> None:
        self._run = "search"
        by_switch = self.settings[0x90][5] == 0
        self.stepper.mark = self.switch[0] if by_switch and self.switch is not None else None
        self.stepper.stall_ns = 0 if by_switch else COLLISION_NS
        self.stepper.run(self._home_sign * self._home_rpm, 0)

    def _zero_found(self) -> None:
        self.origin = self.stepper.ramp.position
        self._end_run(COMPLETE)

    def _end_run(self, result: int) -> None:
        self._run = ""
        self._home_result = 1 if result == COMPLETE else 2
        self._tell_end(0x91, result)

    # -- time and what goes wrong --------------------------------------------------------------------

    def advance(self, now_ns: int) -> None:
        """Live up to `now_ns`; a time already lived changes nothing."""
        if not self._run:
            self.stepper.stall_ns = STALL_NS if self.enabled else 0
        self.stepper.advance(now_ns)
        self._now_ns = max(self._now_ns, now_ns)

    def boot(self) -> None:
        """Loose, counting from 0 where it stands."""
        self.release()
        self.stepper.hold()
        self.origin = self.stepper.ramp.position
        self.stalled = self.protected = self._calibrating = False
        self._home_result = 0

    def loosen(self) -> None:
        """Coast; what was under way is forgotten."""
        self._run, self._finishing = "", 0
        self.stepper.release()

    def release(self) -> None:
        """Let the shaft go, which coasts to a stand."""
        if self._run:
            self._end_run(FAILED)
        self.enabled = False
        self._finishing = 0
        self.stepper.release()
        self._schedule()

    @property
    def limp(self) -> bool:
        """Whether nothing but friction holds its shaft."""
        return not self.enabled

    def lead(self, now_ns: int, turns_s: float) -> None:
        """Have its limp shaft turned by a hand [rev/s]."""
        self.advance(now_ns)
        self.stepper.lead(round(turns_s * 60.0))

    def block_shaft(self, now_ns: int) -> None:
        """Hold the shaft where it is from `now_ns` on."""
        self.advance(now_ns)
        self.stepper.block()

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Trip the protection; it does not tell why."""
        self.advance(now_ns)
        self.trip()

    # -- as others know it ---------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is of its conversation with the host."""
        return not frame.extended and frame.can_id == self.can_id

    def state_frame(self, now_ns: int) -> Frame:
        """The position it would answer at `now_ns`."""
        self.advance(now_ns)
        answer = b"\x31" + self._reads[0x31]()
        return Frame(self.can_id, answer + bytes((checksum(self.can_id, answer),)), extended=False)

    def twin(self, now_ns: int, seed: int) -> MksDrive:
        """Another drive with its CanID, from `now_ns` on, which counts from zero."""
        return MksDrive(dict(self.settings), start_ns=now_ns, seed=seed)
