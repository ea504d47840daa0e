"""What moves inside a ZDT Emm_V5: ramp, shaft, homing, protection and watchdog, without its bus.

The model is described in `sim.drives.zdt`; section numbers are those of zdt-emm-v5.md.
"""

from __future__ import annotations

import math
import random
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Literal

from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER, Ramp
from sim.drives.shaft import Shaft
from sim.drives.zdt_settings import Homing, Settings

PowerFlag = Literal["right", "absent", "unset", "stuck"]

COUNTS_PER_REVOLUTION = 65536
DONE, NOTHING_TO_DO, REFUSED, COMPLETE = 0x02, 0x12, 0xE2, 0x9F
"""Codes of answers: taken, already there, refused, and arrived."""

RAMP_STEP_NS = 50_000
COAST_TICK_NS = 1_000_000
STALL_MARGIN = GRAINS_PER_REVOLUTION // 200
"""Error of a blocked shaft that counts as full current: one full step [grains]."""


class Motion(ABC):
    """The state of one drive and how time moves it; arguments and attributes as in `sim.drives.zdt.ZdtDrive`."""

    def __init__(
        self,
        settings: Settings,
        homing: Homing,
        *,
        start_ns: int,
        position_pulses: int,
        homed: bool,
        firmware: Literal["new", "old"],
        retarget: Literal["accept", "reject"],
        enabling: Literal["hold", "pull"],
        lag_s: float,
        seed: int,
    ) -> None:
        self.settings = self._flash = settings
        self.homing = self._homing_flash = homing
        self.address: int | None = self.settings.address
        self.wrong_values = (0.0, 0)
        self.refuses = False
        self.report_clock = 1.0
        self.fast_is_relative = False
        self.keeps_settings = False
        self.stores_everything = False
        self.unknown: frozenset[int] = frozenset()
        self.power_flag: PowerFlag = "right"
        self.ramp_steepness = 1
        self.foreign = False
        self.causes = 0
        self.cause_lasts = False
        self.count_shift = 0
        self.powered = True
        self.power_losses = 0
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
        start = self._grains(position_pulses)
        self.shaft = Shaft(start_ns, start, lag_s)
        self._lag_ns = lag_s * 1e9
        self._ramp = Ramp(start_ns, start, self.shaft.follow)
        self._origin = 0 if homed else start
        self._single_turn_zero = 0
        self._single_turn_zero_flash = 0
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

    # -- time ----------------------------------------------------------------------------------------

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

    def block_shaft(self, now_ns: int) -> None:
        """Hold the shaft where it is from `now_ns` on."""
        self.advance(now_ns)
        self.shaft.block(now_ns)
        self._watch_contact()

    @property
    def limp(self) -> bool:
        """Whether nothing but friction holds its shaft."""
        return not self.enabled or self.protected or not self.powered

    def lead(self, now_ns: int, turns_s: float) -> None:
        """Have its limp shaft turned by a hand [rev/s]; at a stop the hand goes on from there."""
        self.advance(now_ns)
        if self._stalled:
            self._ramp.place(self.shaft.place(now_ns))
        self._ramp.run(round(turns_s * 60.0), 0)
        self._watch_contact()

    def let_stop(self, now_ns: int, low: int, high: int) -> None:
        """From `now_ns` on something solid stands there on either side of the shaft [grains]."""
        self.advance(now_ns)
        self.shaft.let_stop(now_ns, low, high)
        self._watch_contact()

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
        """The flags of `3A`; a stall that has tripped the protection goes on being told until that is cleared."""
        stalled = self._stalled or (self.protected and not self.causes)
        flags = self.enabled | (self.reached and not stalled) << 1 | stalled << 2 | self.protected << 3
        return flags | self._tells_power_lost << 7

    @property
    def _tells_power_lost(self) -> bool:
        return self._new and (self.power_flag == "stuck" or (self.power_lost and self.power_flag != "absent"))

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

    # -- motion --------------------------------------------------------------------------------------

    @property
    def _able(self) -> bool:
        return self.enabled and not self.protected and not self.refuses and self._homing_mode is None

    def _tick_ns(self, acc: int) -> int:
        return (256 - acc) * RAMP_STEP_NS // self.ramp_steepness if acc else 0

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

    @abstractmethod
    def _complete(self, function: int) -> None:
        """A move or a homing run has come to its end: say so."""

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
