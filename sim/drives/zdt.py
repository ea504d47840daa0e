"""A ZDT Emm_V5 closed-loop stepper on CAN, from its frames to its shaft.

Written from the facts about the real drive (zdt-emm-v5.md; section numbers below are its). [inf] marks
what those facts leave open and what is assumed here; a host should not depend on it.

Modelled:
- Framing (1): extended data frames, address and packet number in the identifier, requests and replies
  split behind the function byte, checksum 6B. A packet out of order, a wrong length, argument or
  checksum, or an unknown function is answered `00 EE 6B` and changes nothing. [inf] A new first packet
  abandons an unfinished request (one `00 EE 6B`) and is itself taken.
- Standard frames, remote frames and other addresses meet silence; broadcasts are obeyed silently, but
  address 1 answers `FF 66`, and new firmware answers `15`.
- Answers (2) in all five response modes. [inf] They concern the motion and homing commands, refusals
  (`E2`) included; reads, settings and format errors are answered in every mode.
- Motion (3, 9): F3, F6, FD, FE, FF and, on new firmware, F1 and FC; the ramp of `ramp.py`; relative,
  absolute and measured-relative targets; retargeting in mid-move (`retarget="reject"` refuses it with E2
  as old firmware may); synchronous start, one buffered command a drive, the latest wins.
- Homing (4): to the single-turn zero (modes 00, 01), to a mechanical stop (02), abort, failure by
  time-out, parameters. [inf] It moves without a ramp, the place of the stop becomes zero without
  backing off, motion commands meanwhile get E2, except FE, which ends it as failed.
- Reads (5), settings (6) in flash and in volatile memory, zeroing, protection and its clearing, power
  loss, watchdog, periodic reports (one period for each kind of report).
- Stall (9.6): a blocked shaft stands while the ramp goes on; 1.8 degrees of error count as full current
  [inf], which after the stall time trips the protection, if it is on.
- Time: a request acts when its last frame has ended, and a read tells the state of that moment [inf];
  the answer is ready 0.2 to 0.4 ms later and then waits for the bus.

Assumed besides [inf]: FC obeys mode and speed of the last F1, and is refused (E2) before the first; a
speed of 0 does not move; FE and enabling make the present position the target; releasing in motion
coasts, losing 1 rpm a millisecond; `32` reads the commanded target in pulses; position readings are
rounded down to whole encoder counts; an error is the ramp minus the shaft.

Not modelled: load, inertia and belt (the shaft is the ramp, or follows it with a first-order lag),
other checksums, multi-motor `AA`, X firmware, limit switches (homing mode 03 runs until its time-out),
temperature and current (only the trip they cause, and that while they last it cannot be cleared [inf]),
the En and Dir inputs, calibration, factory reset, PID and all other settings not listed here (answered
`00 EE 6B`); the wire's bit rate never changes.
"""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from sim.bus import Frame, Outbox
from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER, Ramp
from sim.drives.shaft import Shaft

COUNTS_PER_REVOLUTION = 65536
CHECKSUM = 0x6B
DONE, NOTHING_TO_DO, REFUSED, COMPLETE = 0x02, 0x12, 0xE2, 0x9F
FORMAT_ERROR = b"\x00\xee\x6b"

RAMP_STEP_NS = 50_000
PULL_RPM = 300
"""At which a drive that pulls does, at once: nobody has measured it."""
COAST_TICK_NS = 1_000_000
STALL_MARGIN = GRAINS_PER_REVOLUTION // 200
"""Error of a blocked shaft that counts as full current: one full step [grains]."""

_SETTINGS = struct.Struct(">8B3H6B4H")
_HOMING = struct.Struct(">BBHIHHHB")
_POSITION = struct.Struct(">BHBIBB")
_VELOCITY = struct.Struct(">BHBB")
_FAST = struct.Struct(">HBBB")


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


class ZdtDrive:
    """One drive: a node of the bus with a shaft.

    Args:
        settings: configuration in flash, the CAN address among it.
        start_ns: when it begins to exist; the first time it may be told.
        position_pulses: where its shaft stands and what it counts there.
        homed: whether it was referenced since power-up: power-lost flag cleared. Otherwise it counts
            from zero where it stands, with the flag set.
        firmware: "new" (V2.0.0) or "old" (V5.0 manual: none of the newer functions).
        retarget: whether a position command is taken in mid-move.
        enabling: what a drive that is enabled again does: hold where its shaft is, or pull it to the target of before.
        lag_s: time constant of the shaft behind the ramp [s].
        seed: of the jitter of its answers.

    Attributes:
        outbox: frames it wants to send.
        wake_ns: when it next does something that the bus could notice.
        shaft: its true motion.
        reply_delay_ns: least and greatest time from a request to its answer.
        reply_loss: share of its answers that never leave it.
        wrong_checksums: share of its answers that end in another byte.
        wrong_values: share of its position answers that are wrong, and by how many counts at most.
        refuses: whether it refuses every motion command.
        keeps_settings: whether it says that it took new settings, and keeps its own.
        foreign: whether its configuration block is longer, as that of another firmware [inf].
        causes: why its protection tripped, as bits of `3B` (4 over-temperature, 5 over-current; a stall has none).
        cause_lasts: whether that cause is still there, so that the protection cannot be cleared.
        count_shift: what its count reads beside what it is [counts].
        connected: whether its CAN plug is in.
        listening, address: what the bus asks; see `sim.bus.Node`.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        *,
        start_ns: int = 0,
        position_pulses: int = 0,
        homed: bool = True,
        homing: Homing | None = None,
        firmware: Literal["new", "old"] = "new",
        retarget: Literal["accept", "reject"] = "accept",
        enabling: Literal["hold", "pull"] = "hold",
        lag_s: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.settings = self._flash = settings or Settings()
        self.homing = self._homing_flash = homing or Homing()
        self.outbox: Outbox = deque()
        self.wake_ns = NEVER
        self.listening = True
        self.address: int | None = self.settings.address
        self.reply_delay_ns = (200_000, 400_000)
        self.reply_loss = 0.0
        self.wrong_checksums = 0.0
        self.wrong_values = (0.0, 0)
        self.refuses = False
        self.keeps_settings = False
        self.foreign = False
        self.causes = 0
        self.cause_lasts = False
        self.count_shift = 0
        self.connected = True
        self.powered = True
        self.enabled = True
        self.protected = False
        self.power_lost = not homed
        self._new = firmware == "new"
        self._max_rpm = 6000 if self._new else 3000
        self._retarget = retarget
        self._pulls = enabling == "pull"
        self._left: int | None = None  # its target when it was disabled
        self._random = random.Random(seed)
        self._now_ns = start_ns
        self._replied_ns = start_ns
        start = self._grains(position_pulses)
        self.shaft = Shaft(start_ns, start, lag_s)
        self._lag_ns = lag_s * 1e9
        self._ramp = Ramp(start_ns, start, self.shaft.follow)
        self._origin = 0 if homed else start
        self._single_turn_zero = 0
        self._single_turn_zero_flash = 0
        self._partial: tuple[int, bytearray, int] | None = None
        self._buffered: Callable[[], int] | None = None
        self._fast: tuple[int, int, int] | None = None
        self._finishing = 0
        self._finish_ns = NEVER
        self._stalled = False
        self._contact_ns = NEVER
        self._trip_ns = NEVER
        self._homing_failed = False
        self._homing_mode: int | None = None
        self._homing_end_ns = NEVER
        self._found_ns = NEVER
        self._watchdog_ns = 0
        self._watchdog_flash_ns = 0
        self._bark_ns = NEVER
        self._reports: dict[int, tuple[int, int]] = {}
        self._reads, self._commands = _tables(self)

    # -- the bus's side ------------------------------------------------------------------------------

    def receive(self, now_ns: int, frame: Frame) -> None:
        """Take a frame that ended at `now_ns` from the bus."""
        target = frame.can_id >> 8
        if not frame.extended or frame.remote or target not in (0, self.settings.address):
            return
        self.advance(now_ns)
        packet, data = frame.can_id & 0xFF, frame.data
        broadcast = target == 0
        if self._partial is not None:
            origin, gathered, expected = self._partial
            if origin == target and packet == expected and data and data[0] == gathered[0]:
                gathered += data[1:]
                length = self._request_length(gathered[0])
                if len(gathered) < length and len(data) == 8:
                    self._partial = (target, gathered, packet + 1)
                    return
                self._partial = None
                self._request(bytes(gathered), broadcast)
                return
            self._partial = None
            self._refuse_format(origin == 0)
            if packet != 0:
                return
        if packet == 0 and len(data) == 8 and self._request_length(data[0]) > 8:
            self._partial = (target, bytearray(data), 1)
        elif packet == 0:
            self._request(data, broadcast)
        else:
            self._refuse_format(broadcast)

    def sent(self, now_ns: int, frame: Frame) -> None:
        """Nothing to do: an answer that left is forgotten."""

    def wake(self, now_ns: int) -> None:
        """Do what is due at `now_ns`: finish moves, send reports."""
        self.advance(now_ns)
        for info, (due_ns, period_ns) in list(self._reports.items()):
            if due_ns <= now_ns:
                self._reports[info] = (due_ns + period_ns, period_ns)
                self._send(self._reads[info]() + bytes((CHECKSUM,)), now_ns)
        self._schedule()

    # -- time and what goes wrong --------------------------------------------------------------------

    def advance(self, now_ns: int) -> None:
        """Live up to `now_ns`; a time already lived changes nothing."""
        ramp = self._ramp
        now_ns = max(now_ns, self._now_ns)
        while True:
            event_ns = min(
                ramp.event_ns, self._contact_ns, self._trip_ns, self._homing_end_ns, self._found_ns,
                self._bark_ns, self._finish_ns,
            )  # fmt: skip
            if event_ns > now_ns:
                break
            self._now_ns = event_ns
            if event_ns == ramp.event_ns:
                ramp.advance(event_ns)
                if ramp.idle:
                    self._stood_still()
            else:
                ramp.advance(event_ns)
                self._happen(event_ns)
            self._watch_contact()
        ramp.advance(now_ns)
        self.shaft.settle(now_ns)
        self._now_ns = now_ns

    def power_off(self, now_ns: int) -> None:
        """Lose the supply: silence, a loose shaft, and everything volatile forgotten (9.8)."""
        self.advance(now_ns)
        self.powered = self.listening = False
        self.outbox.clear()
        self._partial = None
        self._buffered = None
        self._fast = None
        self._reports.clear()
        self._release()
        self._schedule()

    def power_on(self, now_ns: int) -> None:
        """Boot: flash settings, enabled, counting from zero where the shaft is, flag 7 set."""
        self.advance(now_ns)
        self.powered = True
        self.listening = self.connected
        self.settings, self.homing = self._flash, self._homing_flash
        self.address = self.settings.address
        self._single_turn_zero = self._single_turn_zero_flash
        self._hold()
        self._origin = self._ramp.position
        self.enabled, self.protected, self.power_lost = True, False, True
        self.causes = self.count_shift = 0
        self._homing_failed = False
        self._watchdog_ns = self._watchdog_flash_ns
        self._feed_watchdog()
        if self.homing.at_power_up:
            self._home(self.homing.mode)
        self._watch_contact()
        self._schedule()

    def unplug(self, now_ns: int) -> None:
        """Lose the CAN cable: it hears nothing, says nothing, and goes on with what it was told."""
        self.advance(now_ns)
        self.connected = self.listening = False
        self.outbox.clear()
        self._partial = None

    def plug_in(self, now_ns: int) -> None:
        """Get the CAN cable back."""
        self.advance(now_ns)
        self.connected = True
        self.listening = self.powered

    def block_shaft(self, now_ns: int) -> None:
        """Hold the shaft where it is from `now_ns` on."""
        self.advance(now_ns)
        self.shaft.block(now_ns)
        self._watch_contact()

    def trip(self, now_ns: int, causes: int) -> None:
        """Trip the protection, which lets the shaft go; `causes` are the bits of `3B` that then stand."""
        self.advance(now_ns)
        self.causes |= causes
        self.protected = True
        self._release()
        self._schedule()

    def disable(self, now_ns: int) -> None:
        """Be let go by somebody, not over the bus."""
        self.advance(now_ns)
        self.enabled = False
        self._release()
        self._schedule()

    def slip(self, now_ns: int, counts: int) -> None:
        """Count so many counts more from now on; neither shaft nor ramp notices."""
        self.advance(now_ns)
        self._origin -= counts * GRAINS_PER_REVOLUTION // COUNTS_PER_REVOLUTION

    # -- what its registers say ----------------------------------------------------------------------

    @property
    def position_counts(self) -> int:
        """Encoder position since zero [65536 to the revolution], as `36` reads it."""
        return self._counts(self.shaft.position_at(self._now_ns) - self._origin) + self.count_shift

    @property
    def target_counts(self) -> int:
        """Commanded target [65536 to the revolution], as `33` reads it."""
        return self._counts(self._target - self._origin)

    @property
    def moving(self) -> bool:
        """Whether the ramp has not come to its end."""
        return not self._ramp.idle

    @property
    def reached(self) -> bool:
        """Whether the ramp ended and the shaft is inside the window around it."""
        return self._ramp.idle and abs(self._error) <= self._window

    @property
    def stalled(self) -> bool:
        """Whether the shaft is blocked and pushed against now."""
        return self._stalled

    @property
    def homing_now(self) -> bool:
        """Whether a homing run is under way."""
        return self._homing_mode is not None

    @property
    def status_byte(self) -> int:
        """The flags of `3A`."""
        flags = self.enabled | self.reached << 1 | self._stalled << 2 | self.protected << 3
        return flags | self.power_lost << 7 if self._new else flags

    @property
    def homing_byte(self) -> int:
        """The flags of `3B`: encoder and calibration ready, homing, homing failed, too hot, too much current."""
        return 0b11 | self.homing_now << 2 | self._homing_failed << 3 | self.causes

    @property
    def _target(self) -> int:
        target = self._ramp.target
        return self._ramp.position if target is None else target

    @property
    def _error(self) -> int:
        return self._ramp.position - self.shaft.position_at(self._now_ns)

    @property
    def _window(self) -> int:
        return self.settings.reach_window * GRAINS_PER_REVOLUTION // 3600

    def _grains(self, pulses: int) -> int:
        per_revolution = self.settings.pulses_per_revolution
        return (2 * pulses * GRAINS_PER_REVOLUTION + per_revolution) // (2 * per_revolution)

    @staticmethod
    def _counts(grains: int) -> int:
        return grains * COUNTS_PER_REVOLUTION // GRAINS_PER_REVOLUTION

    # -- requests and answers ------------------------------------------------------------------------

    def _request_length(self, function: int) -> int:
        if function in self._reads:
            return 3 if function in _READ_ARGUMENT else 2
        command = self._commands.get(function)
        return command.length if command else 0

    def _request(self, request: bytes, broadcast: bool) -> None:
        """Carry out one complete request and answer it."""
        function = request[0] if request else 0
        command = self._commands.get(function)
        if len(request) < 2 or request[-1] != CHECKSUM or len(request) != self._request_length(function):
            self._refuse_format(broadcast)
        elif command is None:
            argument = _READ_ARGUMENT.get(function)
            if argument is not None and request[1] != argument:
                self._refuse_format(broadcast)
                return
            self._feed_watchdog()
            if not broadcast or function == 0x15:
                self._reply(self._reads[function]())
        elif command.argument is not None and request[1] != command.argument:
            self._refuse_format(broadcast)
        else:
            self._feed_watchdog()
            code = command.act(request[1:-1] if command.argument is None else request[2:-1])
            self._watch_contact()
            response = self.settings.response
            told = not command.motion or (response in (1, 3) or (response == 4 and not command.moves))
            if told and (not broadcast or (function == 0xFF and self.settings.address == 1)):
                self._reply(bytes((function, code)))
            self._schedule()

    def _refuse_format(self, broadcast: bool) -> None:
        if not broadcast:
            self._send(FORMAT_ERROR, self._ready_ns())

    def _reply(self, body: bytes) -> None:
        self._send(body + bytes((CHECKSUM,)), self._ready_ns())

    def _ready_ns(self) -> int:
        least, greatest = self.reply_delay_ns
        return self._now_ns + least + int((greatest - least) * self._random.random())

    def _send(self, message: bytes, ready_ns: int) -> None:
        """Queue a message, in several packets if it is long."""
        if not self.connected or (self.reply_loss and self._random.random() < self.reply_loss):
            return
        if self.wrong_checksums and self._random.random() < self.wrong_checksums:
            message = message[:-1] + bytes((self._random.choice([b for b in range(256) if b != CHECKSUM]),))
        ready_ns = self._replied_ns = max(ready_ns, self._replied_ns)
        base = self.settings.address << 8
        if len(message) <= 8:
            self.outbox.append((ready_ns, Frame(base, message)))
            return
        for packet, start in enumerate(range(1, len(message), 7)):
            part = message[:1] + message[start : start + 7]
            self.outbox.append((ready_ns, Frame(base | packet, part)))

    # -- motion --------------------------------------------------------------------------------------

    @property
    def _able(self) -> bool:
        return self.enabled and not self.protected and not self.refuses and self._homing_mode is None

    @staticmethod
    def _tick_ns(acc: int) -> int:
        return (256 - acc) * RAMP_STEP_NS if acc else 0

    def _now_or_synced(self, sync: int, action: Callable[[], int]) -> int:
        if sync > 1:
            return REFUSED
        if sync:
            self._buffered = action
            return DONE
        return action()

    def _move(self, function: int, offset: int, base: int, rpm: int, acc: int) -> int:
        """Go `offset` grains from zero (base 1), the last target (0) or the measured position (2)."""
        if not self._able or (self._retarget == "reject" and self.moving):
            return REFUSED
        start = (self._target, self._origin, self.shaft.position_at(self._now_ns))[base]
        self._ramp.seek(start + offset, min(rpm, self._max_rpm), self._tick_ns(acc))
        self._finishing = function if self.settings.response >= 2 else 0
        self._finish_ns = NEVER
        if self._ramp.idle:
            self._stood_still()
        return DONE

    def _run(self, rpm: int, acc: int) -> int:
        if not self._able:
            return REFUSED
        self._finishing = 0
        self._ramp.run(rpm, self._tick_ns(acc))
        return DONE

    def _hold(self) -> None:
        """Stand still where the shaft is: end of every motion, homing included."""
        self._end_homing()
        self._finishing = 0
        self._finish_ns = NEVER
        self._ramp.place(self.shaft.place(self._now_ns))
        self._watch_contact()

    def _release(self) -> None:
        """Let go of the shaft, which coasts to a stand."""
        self._end_homing()
        self._finishing = 0
        self._finish_ns = NEVER
        self._bark_ns = NEVER
        if self._stalled:
            self._ramp.place(self.shaft.place(self._now_ns))
        else:
            self._ramp.run(0, COAST_TICK_NS)
        self._watch_contact()

    def _stood_still(self) -> None:
        """The ramp has ended: a position move is complete once the shaft is inside the window."""
        if self._homing_mode is not None:
            if abs(self._error) <= self._window:
                self._home_found()
        elif self._finishing:
            behind = abs(self._error)
            if behind <= self._window:
                self._finish_ns = self._now_ns
            elif self._lag_ns and not self._stalled:
                window = max(self._window, 1)
                self._finish_ns = self._now_ns + math.ceil(self._lag_ns * math.log(behind / window))

    def _watch_contact(self) -> None:
        """Notice a shaft that begins or ceases to be pushed against a stop."""
        ramp = self._ramp
        stalled = self.shaft.pressed(ramp.position, ramp.speed_rpm, STALL_MARGIN)
        if stalled != self._stalled:
            self._stalled = stalled
            self._trip_ns = self._found_ns = NEVER
            if stalled and self._homing_mode == 2:
                self._found_ns = self._now_ns + self.homing.collision_ms * 1_000_000
            elif stalled and self._homing_mode is None and self.settings.stall_mode and self.enabled:
                self._trip_ns = self._now_ns + self.settings.stall_ms * 1_000_000
        self._contact_ns = self.shaft.contact_ns(ramp.time_ns, ramp.position, ramp.speed_rpm, STALL_MARGIN)

    def _happen(self, now_ns: int) -> None:
        """What is due besides the ramp's own steps."""
        if self._trip_ns <= now_ns:
            self._trip_ns = NEVER
            self.protected = True
            self._release()
            if self.settings.stall_mode == 2:
                self._origin = self._ramp.position
        elif self._found_ns <= now_ns:
            self._home_found()
        elif self._homing_end_ns <= now_ns:
            self._hold()
            self._homing_failed = True
        elif self._bark_ns <= now_ns:
            self._bark_ns = NEVER
            self._hold()
        elif self._finish_ns <= now_ns:
            self._finish_ns = NEVER
            self._complete(self._finishing)

    def _complete(self, function: int) -> None:
        self._finishing = 0
        self._reply(bytes((function, COMPLETE)))

    def _schedule(self) -> None:
        """Work out when the bus may next hear of this drive without asking."""
        if not self.powered:
            self.wake_ns = NEVER
            return
        wake_ns = min((due_ns for due_ns, _ in self._reports.values()), default=NEVER)
        if self._finishing or (self._homing_mode is not None and self.settings.response in (2, 3)):
            wake_ns = min(
                wake_ns, self._ramp.event_ns, self._contact_ns, self._found_ns, self._homing_end_ns,
                self._finish_ns,
            )  # fmt: skip
        self.wake_ns = wake_ns

    def _feed_watchdog(self) -> None:
        self._bark_ns = self._now_ns + self._watchdog_ns if self._watchdog_ns else NEVER

    # -- homing --------------------------------------------------------------------------------------

    def _home(self, mode: int) -> int:
        if mode > 3 or not self._able:
            return REFUSED
        sign = -1 if self.homing.direction else 1
        rpm = min(self.homing.rpm, self._max_rpm)
        if mode <= 1:
            gap = (self._single_turn_zero - self._ramp.position) % GRAINS_PER_REVOLUTION
            if min(gap, GRAINS_PER_REVOLUTION - gap) * COUNTS_PER_REVOLUTION < GRAINS_PER_REVOLUTION:
                return NOTHING_TO_DO
            back = gap > GRAINS_PER_REVOLUTION // 2 if mode == 0 else sign < 0
            gap -= GRAINS_PER_REVOLUTION if back else 0
            self._ramp.seek(self._ramp.position + gap, rpm, 0)
        else:
            self._ramp.run(sign * rpm, 0)
        self._finishing = 0
        self._homing_failed = False
        self._homing_mode = mode
        self._homing_end_ns = self._now_ns + self.homing.timeout_ms * 1_000_000
        return DONE

    def _home_found(self) -> None:
        """The run has ended where zero is to be."""
        self._hold()
        self._origin = self._ramp.position
        if self.settings.response in (2, 3):
            self._complete(0x9A)

    def _end_homing(self) -> None:
        self._homing_mode = None
        self._homing_end_ns = self._found_ns = NEVER

    # -- commands: each takes its arguments and returns the code of its answer -----------------------

    def _do_enable(self, arguments: bytes) -> int:
        enable, sync = arguments
        if enable > 1:
            return REFUSED

        def action() -> int:
            if not enable:
                if self.enabled:
                    self._left = self._target
                self.enabled = False
                self._release()
            elif not self.enabled:
                self.enabled = True
                self._hold()
                if self._pulls and self._left is not None:
                    self._ramp.seek(self._left, PULL_RPM, 0)
            return DONE

        return self._now_or_synced(sync, action)

    def _do_velocity(self, arguments: bytes) -> int:
        direction, rpm, acc, sync = _VELOCITY.unpack(arguments)
        if direction > 1 or not self._able:
            return REFUSED
        signed = min(rpm, self._max_rpm) * (-1 if direction else 1)
        return self._now_or_synced(sync, lambda: self._run(signed, acc))

    def _do_position(self, arguments: bytes) -> int:
        direction, rpm, acc, pulses, mode, sync = _POSITION.unpack(arguments)
        if direction > 1 or mode > (2 if self._new else 1) or not self._able:
            return REFUSED
        offset = self._grains(-pulses if direction else pulses)
        if sync:
            return self._now_or_synced(sync, lambda: self._move(0xFD, offset, mode, rpm, acc))
        return self._move(0xFD, offset, mode, rpm, acc)

    def _do_fast_setup(self, arguments: bytes) -> int:
        rpm, acc, mode, sync = _FAST.unpack(arguments)
        if mode > 2:
            return REFUSED

        def action() -> int:
            self._fast = (rpm, acc, mode)
            return DONE

        return self._now_or_synced(sync, action)

    def _do_fast_position(self, arguments: bytes) -> int:
        if self._fast is None:
            return REFUSED
        rpm, acc, mode = self._fast
        return self._move(0xFC, self._grains(int.from_bytes(arguments, "big", signed=True)), mode, rpm, acc)

    def _do_stop(self, arguments: bytes) -> int:
        def action() -> int:
            if self.powered and self.enabled and not self.protected:
                failed = self.homing_now
                self._hold()
                self._homing_failed |= failed
            return DONE

        return self._now_or_synced(arguments[0], action)

    def _do_trigger(self, _: bytes) -> int:
        action, self._buffered = self._buffered, None
        if action is not None:
            action()
        return DONE

    def _do_set_single_turn_zero(self, arguments: bytes) -> int:
        self._single_turn_zero = self._ramp.position % GRAINS_PER_REVOLUTION
        if arguments[0]:
            self._single_turn_zero_flash = self._single_turn_zero
        return DONE

    def _do_home(self, arguments: bytes) -> int:
        mode, sync = arguments
        if mode > 3 or not self._able:
            return REFUSED
        return self._now_or_synced(sync, lambda: self._home(mode))

    def _do_abort_homing(self, _: bytes) -> int:
        if not self.homing_now:
            return REFUSED
        self._hold()
        return DONE

    def _do_write_homing(self, arguments: bytes) -> int:
        homing = Homing.unpack(arguments[1:])
        if homing.mode > 3 or homing.direction > 1 or homing.at_power_up > 1:
            return REFUSED
        self.homing = homing
        if arguments[0]:
            self._homing_flash = homing
        return DONE

    def _do_zero(self, _: bytes) -> int:
        self._hold()
        self._origin = self._ramp.position
        return DONE

    def _do_clear_protection(self, _: bytes) -> int:
        if not self.protected or self.cause_lasts:
            return REFUSED
        self.protected = False
        self.causes = 0
        self._hold()
        return DONE

    def _do_clear_power_lost(self, _: bytes) -> int:
        self.power_lost = False
        return DONE

    def _do_write_settings(self, arguments: bytes) -> int:
        """The address and screen bytes are sent as 0 and stay what they are (6)."""
        new = Settings.unpack(arguments[1:])
        return self._store(arguments[0], replace(new, address=0, screen_off=0))

    def _do_microstep(self, arguments: bytes) -> int:
        return self._store(arguments[0], replace(self.settings, microstep=arguments[1]))

    def _do_address(self, arguments: bytes) -> int:
        store, address = arguments
        if address == 0:
            return REFUSED
        self.settings = replace(self.settings, address=address)
        self.address = address
        if store:
            self._flash = replace(self._flash, address=address)
        return DONE

    def _do_open_current(self, arguments: bytes) -> int:
        current_ma = int.from_bytes(arguments[1:], "big")
        return self._store(arguments[0], replace(self.settings, open_loop_ma=current_ma))

    def _do_closed_current(self, arguments: bytes) -> int:
        current_ma = int.from_bytes(arguments[1:], "big")
        return self._store(arguments[0], replace(self.settings, closed_loop_ma=current_ma))

    def _do_loop_mode(self, arguments: bytes) -> int:
        return DONE if arguments[1] in ((0, 1) if self._new else (1, 2)) else REFUSED

    def _store(self, store: int, new: Settings) -> int:
        if not new.valid:
            return REFUSED
        if self.keeps_settings:
            return DONE
        self.settings = replace(new, address=self.settings.address, screen_off=self.settings.screen_off)
        if store:
            self._flash = self.settings
        return DONE

    def _do_watchdog(self, arguments: bytes) -> int:
        self._watchdog_ns = int.from_bytes(arguments[1:], "big") * 1_000_000
        if arguments[0]:
            self._watchdog_flash_ns = self._watchdog_ns
        self._feed_watchdog()
        return DONE

    def _do_report(self, arguments: bytes) -> int:
        info = arguments[0]
        period_ns = int.from_bytes(arguments[1:], "big") * 1_000_000
        if info not in self._reads or info in _READ_ARGUMENT:
            return REFUSED
        self._reports.pop(info, None)
        if period_ns:
            self._reports[info] = (self._now_ns + period_ns, period_ns)
        return DONE

    # -- reads: each returns its answer without the checksum -----------------------------------------

    def _signed(self, function: int, value: int, size: int) -> bytes:
        magnitude = min(abs(value), (1 << 8 * size) - 1)
        return bytes((function, value < 0)) + magnitude.to_bytes(size, "big")

    def _speed(self) -> int:
        return round(self.shaft.speed_at(self._now_ns))

    def _current_ma(self) -> int:
        return self.settings.closed_loop_ma if self._stalled else 627

    def _encoder(self) -> int:
        return self._counts(self.shaft.position_at(self._now_ns)) % COUNTS_PER_REVOLUTION

    def position_answer(self) -> bytes:
        """What it would now answer to `36 6B`."""
        return self._signed(0x36, self.position_counts, 4) + bytes((CHECKSUM,))

    def _read_position(self) -> bytes:
        share, most = self.wrong_values
        wrong = round(self._random.uniform(-most, most)) if share and self._random.random() < share else 0
        return self._signed(0x36, self.position_counts + wrong, 4)

    def _read_version(self) -> bytes:
        return struct.pack(">BHH", 0x1F, 200, 111) if self._new else b"\x1f\x7d\x6f"

    def _read_settings(self) -> bytes:
        if self.foreign:
            return b"\x42\x25\x18" + self.settings.pack() + bytes(4)
        return b"\x42\x21\x15" + self.settings.pack()

    def _read_pid(self) -> bytes:
        return struct.pack(">BIII", 0x21, *((18000, 10, 18000) if self._new else (62000, 100, 62000)))

    def _read_everything(self) -> bytes:
        return (
            b"\x43\x1f\x09"
            + struct.pack(">HHH", SUPPLY_MV, self._current_ma(), self._encoder())
            + self._signed(0, self.target_counts, 4)[1:]
            + self._signed(0, self._speed(), 2)[1:]
            + self._signed(0, self.position_counts, 4)[1:]
            + self._signed(0, self._counts(self._error), 4)[1:]
            + bytes((self.homing_byte, self.status_byte))
        )

    def _pulses(self) -> int:
        per_revolution = self.settings.pulses_per_revolution
        grains = self._target - self._origin
        return (2 * grains * per_revolution + GRAINS_PER_REVOLUTION) // (2 * GRAINS_PER_REVOLUTION)


SUPPLY_MV = 12_000
SUPPLY_MA = 200
TEMPERATURE_C = 25
TRIP_C, TRIP_MA, TRIP_MS = 100, 6600, 1000
"""Heat and current that would trip it; read as they are written (`D3 56`) [inf], which is not modelled."""

_READ_ARGUMENT = {0x43: 0x7A, 0x42: 0x6C}
_NEW_READS = frozenset((0x13, 0x26, 0x39, 0x3C, 0x15, 0x16))
_NEW_COMMANDS = frozenset((0xF1, 0xFC, 0x50, 0x68, 0x11))


@dataclass(frozen=True)
class _Command:
    """How a command looks and what it does.

    Attributes:
        length: of the whole request, function byte to checksum.
        argument: fixed second byte, None where there is none.
        act: called with the bytes between that and the checksum, returns the code of the answer.
        motion: whether the response mode governs its answer.
        moves: whether it is a position move in the sense of response mode 4.
    """

    length: int
    argument: int | None
    act: Callable[[bytes], int]
    motion: bool = False
    moves: bool = False


def _tables(drive: ZdtDrive) -> tuple[dict[int, Callable[[], bytes]], dict[int, _Command]]:
    """The functions this drive knows: reads and commands by function byte."""
    d = drive
    reads: dict[int, Callable[[], bytes]] = {
        0x1F: d._read_version,
        0x13: lambda: struct.pack(">BHHH", 0x13, TRIP_C, TRIP_MA, TRIP_MS),
        0x20: lambda: struct.pack(">BHH", 0x20, 1146, 3368),
        0x21: d._read_pid,
        0x22: lambda: b"\x22" + d.homing.pack(),
        0x24: lambda: struct.pack(">BH", 0x24, SUPPLY_MV),
        0x26: lambda: struct.pack(">BH", 0x26, SUPPLY_MA),
        0x27: lambda: struct.pack(">BH", 0x27, d._current_ma()),
        0x31: lambda: struct.pack(">BH", 0x31, d._encoder()),
        0x32: lambda: d._signed(0x32, d._pulses(), 4),
        0x33: lambda: d._signed(0x33, d.target_counts, 4),
        0x34: lambda: d._signed(0x34, d._counts(d._ramp.position - d._origin), 4),
        0x35: lambda: d._signed(0x35, d._speed(), 2),
        0x36: d._read_position,
        0x37: lambda: d._signed(0x37, d._counts(d._error), 4),
        0x39: lambda: bytes((0x39, 1, TEMPERATURE_C)),
        0x3A: lambda: bytes((0x3A, d.status_byte)),
        0x3B: lambda: bytes((0x3B, d.homing_byte)),
        0x3C: lambda: bytes((0x3C, d.homing_byte, d.status_byte)),
        0x15: lambda: bytes((0x15, d.settings.address)),
        0x16: lambda: struct.pack(">BI", 0x16, d._watchdog_ns // 1_000_000),
        0x42: d._read_settings,
        0x43: d._read_everything,
    }
    commands = {
        0xF3: _Command(5, 0xAB, d._do_enable, motion=True),
        0xF6: _Command(7, None, d._do_velocity, motion=True),
        0xFD: _Command(12, None, d._do_position, motion=True, moves=True),
        0xF1: _Command(7, None, d._do_fast_setup, motion=True),
        0xFC: _Command(6, None, d._do_fast_position, motion=True, moves=True),
        0xFE: _Command(4, 0x98, d._do_stop, motion=True),
        0xFF: _Command(3, 0x66, d._do_trigger, motion=True),
        0x93: _Command(4, 0x88, d._do_set_single_turn_zero),
        0x9A: _Command(4, None, d._do_home, motion=True),
        0x9C: _Command(3, 0x48, d._do_abort_homing, motion=True),
        0x4C: _Command(19, 0xAE, d._do_write_homing),
        0x0A: _Command(3, 0x6D, d._do_zero),
        0x0E: _Command(3, 0x52, d._do_clear_protection),
        0x50: _Command(3, 0x00, d._do_clear_power_lost),
        0x48: _Command(32, 0xD1, d._do_write_settings),
        0x84: _Command(5, 0x8A, d._do_microstep),
        0xAE: _Command(5, 0x4B, d._do_address),
        0x44: _Command(6, 0x33, d._do_open_current),
        0x45: _Command(6, 0x66, d._do_closed_current),
        0x46: _Command(5, 0x69, d._do_loop_mode),
        0x68: _Command(8, 0x38, d._do_watchdog),
        0x11: _Command(6, 0x18, d._do_report),
    }
    if not d._new:
        reads = {function: read for function, read in reads.items() if function not in _NEW_READS}
        commands = {function: act for function, act in commands.items() if function not in _NEW_COMMANDS}
    return reads, commands
