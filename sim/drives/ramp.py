"""The ramp of a stepper drive that changes its speed in whole revolutions per minute.

Everything is an integer. Position is counted in *grains*, 60e9 to the revolution, because then one
rpm is exactly one grain per nanosecond: no move, however many times it is retargeted, collects a
rounding error.

The speed changes by 1 rpm at most once per *tick* (zdt-emm-v5.md section 3: (256 - acc) * 50 us).
The generator climbs only if it could still come down again, one rpm a tick, before the target, and
begins to fall at the last instant from which the steps w-1, w-2 ... 1, one tick each, end on the target.
If a new target makes that impossible, it slows as fast as the tick allows, passes the target,
and comes back through zero. [inf] The tick counter runs on across retargets: a stream of new targets
neither gains nor loses steps by restarting it.

A tick of 0 means no ramp: the speed is there at once, and gone at once.
"""

from __future__ import annotations

from collections.abc import Callable

GRAINS_PER_REVOLUTION = 60_000_000_000
"""Grains in one motor revolution; 1 rpm is 1 grain per nanosecond."""

NEVER = 1 << 62
"""A time that does not come [ns]."""

Recorder = Callable[[int, int, int], None]
"""Called at every change of speed: time [ns], position [grains], new speed [rpm]."""


class Ramp:
    """One speed-stepping set-point generator.

    Call `advance` before every command; commands take effect at the time last advanced to.

    Attributes:
        time_ns: time up to which the ramp has been computed.
        position: position at `time_ns` [grains].
        speed_rpm: signed speed from `time_ns` on [rpm].
        target: where it goes [grains]; None while a speed is asked for instead.
        event_ns: when the speed changes next, `NEVER` if nothing will change it.
    """

    __slots__ = (
        "_arriving",
        "_changed_ns",
        "_goal_rpm",
        "_next_rpm",
        "_record",
        "_tick_ns",
        "event_ns",
        "position",
        "speed_rpm",
        "target",
        "time_ns",
    )

    def __init__(self, time_ns: int, position: int, record: Recorder) -> None:
        self.time_ns = time_ns
        self.position = position
        self.speed_rpm = 0
        self.target: int | None = position
        self.event_ns = NEVER
        self._goal_rpm = 0
        self._tick_ns = 0
        self._changed_ns = time_ns - NEVER
        self._next_rpm = 0
        self._arriving = False
        self._record = record

    @property
    def idle(self) -> bool:
        """Whether it stands and nothing will move it."""
        return self.speed_rpm == 0 and self.event_ns == NEVER

    @property
    def next_rpm(self) -> int:
        """Signed speed after the next change, if there is one [rpm]."""
        return self.speed_rpm if self.event_ns == NEVER else self._next_rpm

    def seek(self, target: int, rpm: int, tick_ns: int) -> None:
        """Go to `target` [grains], never asking for more than `rpm` (>= 0), one rpm per `tick_ns`."""
        self.target = target
        self._goal_rpm = rpm
        self._tick_ns = tick_ns
        self._plan()

    def run(self, rpm: int, tick_ns: int) -> None:
        """Change to the signed speed `rpm` and keep it, one rpm per `tick_ns`."""
        self.target = None
        self._goal_rpm = rpm
        self._tick_ns = tick_ns
        self._plan()

    def place(self, position: int) -> None:
        """Stand still at `position` [grains] at once, with that as target."""
        if self.speed_rpm:
            self._changed_ns = self.time_ns
        self.position = position
        self.target = position
        self.speed_rpm = 0
        self.event_ns = NEVER
        self._record(self.time_ns, position, 0)

    def step(self) -> None:
        """Carry out the next change of speed, at `event_ns`."""
        now = self.event_ns
        if self._arriving:
            assert self.target is not None
            self.position = self.target
        else:
            self.position += self.speed_rpm * (now - self.time_ns)
        self.time_ns = now
        self.speed_rpm = self._next_rpm
        self._changed_ns = now
        self._record(now, self.position, self.speed_rpm)
        self._plan()

    def advance(self, now_ns: int) -> None:
        """Compute the motion up to `now_ns`."""
        while self.event_ns <= now_ns:
            self.step()
        self.position += self.speed_rpm * (now_ns - self.time_ns)
        self.time_ns = now_ns

    def _plan(self) -> None:
        """Decide when the speed changes next, and to what."""
        now = self.time_ns
        speed = self.speed_rpm
        tick = self._tick_ns
        allowed = self._changed_ns + tick
        if allowed < now or tick == 0:
            allowed = now
        self._arriving = False
        self.event_ns = allowed
        if self.target is None:
            self._plan_speed(speed, tick)
            return
        gap = self.target - self.position
        if gap == 0:
            if speed == 0:
                self.event_ns = NEVER
            elif tick == 0 or -1 <= speed <= 1:
                self.event_ns = now
                self._next_rpm = 0
            else:
                self._next_rpm = speed - 1 if speed > 0 else speed + 1
            return
        sign = 1 if gap > 0 else -1
        toward = speed * sign
        left = gap * sign
        limit = self._goal_rpm
        if tick == 0:
            if toward != limit:
                self._next_rpm = limit * sign
            elif toward == 0:
                self.event_ns = NEVER
            else:
                self._arrive(now + (left + toward - 1) // toward)
        elif toward < 0 or (toward < limit and self._may_climb(toward, left, allowed - now)):
            self._next_rpm = speed + sign
        elif toward == 0:
            self.event_ns = NEVER
        else:
            self._next_rpm = speed - sign
            if toward <= limit:
                spare = left - tick * toward * (toward - 1) // 2
                brake = now + spare // toward if spare > 0 else now
                if brake > allowed:
                    self.event_ns = brake
            if toward == 1 and (limit or now + left < allowed):
                self._arrive(now + left)

    def _may_climb(self, toward: int, left: int, wait_ns: int) -> bool:
        """Whether, one rpm faster after `wait_ns`, it could still come down on a target `left` away."""
        steps = (toward + 1) * (toward + 2) // 2
        return toward == 0 or left - toward * wait_ns >= self._tick_ns * steps

    def _plan_speed(self, speed: int, tick: int) -> None:
        goal = self._goal_rpm
        if speed == goal:
            self.event_ns = NEVER
        elif tick == 0:
            self._next_rpm = goal
        else:
            self._next_rpm = speed + 1 if goal > speed else speed - 1

    def _arrive(self, time_ns: int) -> None:
        self._arriving = True
        self.event_ns = time_ns
        self._next_rpm = 0
