"""The motor of a stepper drive: a ramp, the shaft that follows it, and what stands in its way.

It lives through its events in order, so what a drive does at one of them (a stall that has lasted, a switch that has
been reached) happens at its very instant. Positions are in grains and speeds in rpm, see `sim.drives.ramp`.
"""

from __future__ import annotations

from collections.abc import Callable

from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER, Ramp
from sim.drives.shaft import Shaft

COAST_TICK_NS = 1_000_000
"""A shaft that is let go loses 1 rpm a millisecond [inf]."""
STALL_MARGIN = GRAINS_PER_REVOLUTION // 200
"""Error of a blocked shaft that counts as full current: one full step [grains]."""

Event = Callable[[], None]


class Stepper:
    """One motor with its drive's ramp.

    Args:
        start_ns: when it begins.
        position: where it stands [grains].
        lag_s: time constant with which the shaft follows the ramp [s].
        stood: called when the ramp has come to its end.
        stalled: called when a stall has lasted for `stall_ns`.
        reached: called when the ramp passes `mark`.

    Attributes:
        shaft, ramp: what moves; commands go to the ramp by way of this.
        stall_ns: how long a stall lasts before `stalled` is called; 0 for never [ns].
        mark: a position to watch for, None for none [grains].
    """

    def __init__(
        self, start_ns: int, position: int, *, lag_s: float, stood: Event, stalled: Event, reached: Event
    ) -> None:
        self.shaft = Shaft(start_ns, position, lag_s)
        self.ramp = Ramp(start_ns, position, self.shaft.follow)
        self.stall_ns = 0
        self.mark: int | None = None
        self._now_ns = start_ns
        self._pressed = False
        self._contact_ns = self._stalled_ns = NEVER
        self._stood, self._stalled, self._reached = stood, stalled, reached

    @property
    def now_ns(self) -> int:
        """The time it has lived up to."""
        return self._now_ns

    @property
    def position(self) -> int:
        """Where the shaft is [grains]."""
        return self.shaft.position_at(self._now_ns)

    @property
    def target(self) -> int:
        """Where it goes, or is told to be while it turns with a speed [grains]."""
        return self.ramp.position if self.ramp.target is None else self.ramp.target

    @property
    def error(self) -> int:
        """How far the shaft is behind the ramp [grains]."""
        return self.ramp.position - self.position

    @property
    def moving(self) -> bool:
        """Whether the ramp has not come to its end."""
        return not self.ramp.idle

    @property
    def event_ns(self) -> int:
        """When something happens next, if nothing is told it [ns]."""
        return min(self.ramp.event_ns, self._contact_ns, self._stalled_ns, self._mark_ns())

    def advance(self, now_ns: int) -> None:
        """Live up to `now_ns`; a time already lived changes nothing."""
        now_ns = max(now_ns, self._now_ns)
        while (event_ns := self.event_ns) <= now_ns:
            self._now_ns = event_ns
            moved, stalled, reached = self.ramp.event_ns, self._stalled_ns, self._mark_ns()
            self.ramp.advance(event_ns)
            if moved == event_ns and self.ramp.idle:
                self._stood()
            if stalled == event_ns:
                self._stalled_ns = NEVER
                self._stalled()
            if reached == event_ns:
                self.mark = None
                self._reached()
            self._watch_contact()
        self.ramp.advance(now_ns)
        self.shaft.settle(now_ns)
        self._now_ns = now_ns

    def seek(self, target: int, rpm: int, tick_ns: int) -> None:
        """Go to a target [grains] with at most that speed, changing it by 1 rpm a tick."""
        self.ramp.seek(target, rpm, tick_ns)
        if self.ramp.idle:
            self._stood()
        self._watch_contact()

    def run(self, rpm: int, tick_ns: int) -> None:
        """Change to a signed speed and keep it."""
        self.ramp.run(rpm, tick_ns)
        self._watch_contact()

    def hold(self) -> None:
        """Stand still where the shaft is, at once."""
        self.mark = None
        self.ramp.place(self.shaft.place(self._now_ns))
        self._watch_contact()

    def release(self) -> None:
        """Let go of the shaft, which coasts to a stand."""
        self.mark = None
        if self._pressed:
            self.hold()
        else:
            self.run(0, COAST_TICK_NS)

    def lead(self, rpm: int) -> None:
        """Have the released shaft turned by a hand; at a stop the hand goes on from there."""
        if self._pressed:
            self.hold()
        self.run(rpm, 0)

    def block(self) -> None:
        """Hold the shaft where it is."""
        self.shaft.block(self._now_ns)
        self._watch_contact()

    def _mark_ns(self) -> int:
        """When the ramp passes the mark."""
        if self.mark is None or self.ramp.speed_rpm == 0:
            return NEVER
        way, speed = self.mark - self.ramp.position, self.ramp.speed_rpm
        return self.ramp.time_ns + -(-abs(way) // abs(speed)) if way * speed > 0 else NEVER

    def _watch_contact(self) -> None:
        """Notice a shaft that begins or ceases to be pushed against something."""
        ramp = self.ramp
        pressed = self.shaft.pressed(ramp.position, ramp.speed_rpm, STALL_MARGIN)
        if pressed != self._pressed:
            self._pressed = pressed
            self._stalled_ns = self._now_ns + self.stall_ns if pressed and self.stall_ns else NEVER
        self._contact_ns = self.shaft.contact_ns(ramp.time_ns, ramp.position, ramp.speed_rpm, STALL_MARGIN)
