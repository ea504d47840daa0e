"""The shaft of a servo drive: a load that a law moves in small fixed steps, with its history.

Every `STEP_NS` the law that is in charge says how fast the shaft turns during the next step, from where it is and how
fast it was. Between two steps the speed is constant, so the position is continuous and linear in pieces, as
`sim.truth` expects, and what is read between two steps is exact. A shaft at rest costs nothing until somebody asks
something else of it.

Positions are revolutions of what the drive counts, speeds revolutions per second, torques N·m, times ns.

Laws: `Hold`, `Limp`, `Led` (a hand turns it), `Plan` (a trapezoid to a target, retargeted at any time), `Spin` (a
speed, by a ramp), `Torque` (stiffness, damping and torque on the load's inertia, as MIT mode), `Cascade` (position
loop around a velocity loop, with feed-forward) and `Interpolation` (straight lines between targets that come at a
beat). A drive's file may add its own.

Not modelled: gravity, elasticity, backlash, cogging and saturation of the current loop beyond a torque limit. Friction
is a constant torque against the motion; loops with an integrator (`Cascade`, `Plan`, `Spin`, `Interpolation`) are taken
to compensate it.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from typing import Protocol

import numpy as np

from sim.drives.ramp import NEVER
from sim.drives.shaft import Reals, Times

STEP_NS = 250_000
"""Period of the drive's loop: 4 kHz; real ones run at 1 to 20."""
STEP_S = STEP_NS * 1e-9
HISTORY_LENGTH = 1 << 19
"""Changes of speed remembered at least: two minutes of ceaseless acceleration, 12 MB a drive."""
AT_REST_TURNS, AT_REST_TURNS_S = 1e-9, 1e-7
"""Nearer to its goal and slower than this a shaft stands."""
TURN_RAD = 2.0 * math.pi


class Load:
    """What a servo moves.

    Attributes:
        inertia_kg_m2: of motor and load, as the drive's shaft feels it.
        friction_nm: torque that resists every motion.
        torque_nm: most the motor can do.
    """

    def __init__(self, inertia_kg_m2: float = 1e-3, friction_nm: float = 0.02, torque_nm: float = 10.0) -> None:
        self.inertia_kg_m2 = inertia_kg_m2
        self.friction_nm = friction_nm
        self.torque_nm = torque_nm

    def gain(self, torque_nm: float) -> float:
        """Speed that a torque adds in one step [rev/s]."""
        return torque_nm / self.inertia_kg_m2 * STEP_S / TURN_RAD

    def driven(self, speed: float, torque_nm: float) -> float:
        """Speed after one step with this torque, which is cut to what the motor can do."""
        return speed + self.gain(_within(torque_nm, self.torque_nm))

    def dragged(self, speed: float) -> float:
        """What friction leaves of a speed after one step; it never turns it round."""
        return _towards(0.0, speed, self.gain(self.friction_nm))


class Law(Protocol):
    """What decides how a shaft moves."""

    @property
    def rests(self) -> bool:
        """Whether a shaft that it left standing stays so until the law is changed."""

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """Speed [rev/s] in the step that begins at `time_ns`, from the position and speed at its beginning."""


class Hold:
    """Stand still, at once."""

    rests = True

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """None."""
        return 0.0


class Limp:
    """Coast until friction has stopped it."""

    rests = True

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """What friction leaves."""
        return load.dragged(speed)


class Led(Limp):
    """Be turned by a hand with a speed [rev/s], limp as it is."""

    def __init__(self, turns_s: float) -> None:
        self.turns_s = turns_s
        self.rests = turns_s == 0.0

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """The hand's."""
        return self.turns_s


class Spin:
    """Turn with a speed [rev/s], reached by a ramp [rev/s²]."""

    def __init__(self, target: float, ramp: float) -> None:
        self.target = target
        self.ramp = ramp

    @property
    def rests(self) -> bool:
        """Whether it stands."""
        return self.target == 0.0

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """One step up or down the ramp."""
        return _towards(self.target, speed, self.ramp * STEP_S)


class Plan:
    """Go to a target by a trapezoid of speed; target and limits may be changed in mid-move.

    What cannot be done in time any more is done as well as the deceleration allows: a target too close is overrun
    and come back to, a speed above a new limit is left by the deceleration.

    Attributes:
        target: where to [rev].
        top: highest speed [rev/s], above 0.
        acceleration, deceleration: [rev/s²], above 0.
    """

    def __init__(self, target: float, top: float, acceleration: float, deceleration: float | None = None) -> None:
        self.target = target
        self.top = top
        self.acceleration = acceleration
        self.deceleration = acceleration if deceleration is None else deceleration
        self.rests = False

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """The highest speed from which it can still come down to stand on the target, step by step."""
        self.rests = False
        way = self.target - position
        if abs(way) < AT_REST_TURNS and abs(speed) <= self.deceleration * STEP_S:
            self.rests = True
            return 0.0
        # Reckoned in the direction of the target.
        sign = 1.0 if way > 0.0 or (way == 0.0 and speed > 0.0) else -1.0
        way, speed = abs(way), speed * sign
        down = self.deceleration * STEP_S
        if speed < 0.0:
            return sign * min(speed + down, 0.0)
        # Slowing by `down` a step, and standing after n more, covers (n + 1) * (v - n * down / 2) steps of way.
        steps = max(math.ceil((math.sqrt(1.0 + 8.0 * way / (down * STEP_S)) - 1.0) / 2.0), 1)
        safe = way / (steps * STEP_S) + (steps - 1) * down / 2.0
        wanted = min(self.top, safe)
        if wanted >= speed:
            return sign * min(wanted, speed + self.acceleration * STEP_S)
        return sign * max(wanted, speed - down)


class Torque:
    """Stiffness, damping and a torque on the load: kp (p_des - p) + kd (v_des - v) + t, in radians at the shaft.

    Solved implicitly, so that no gain makes the step unstable.

    Attributes:
        position_rad, speed_rad_s, torque_nm: what is asked for.
        kp, kd: N·m/rad and N·m·s/rad.
        made_nm: what the motor made of it in the last step.
    """

    rests = True

    def __init__(
        self,
        position_rad: float = 0.0,
        speed_rad_s: float = 0.0,
        kp: float = 0.0,
        kd: float = 0.0,
        torque_nm: float = 0.0,
    ) -> None:
        self.position_rad = position_rad
        self.speed_rad_s = speed_rad_s
        self.kp = kp
        self.kd = kd
        self.torque_nm = torque_nm
        self.made_nm = 0.0

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """Speed after a step of this torque and of friction."""
        rate = STEP_S / load.inertia_kg_m2
        drag = rate * load.friction_nm
        now_rad_s = speed * TURN_RAD
        asked_nm = self.kp * (self.position_rad - position * TURN_RAD) + self.kd * self.speed_rad_s + self.torque_nm
        fading = self.kd + self.kp * STEP_S
        next_rad_s = _towards(0.0, now_rad_s + rate * asked_nm, drag) / (1.0 + rate * fading)
        made_nm = asked_nm - fading * next_rad_s
        if abs(made_nm) > load.torque_nm:
            made_nm = math.copysign(load.torque_nm, made_nm)
            next_rad_s = _towards(0.0, now_rad_s + rate * made_nm, drag)
        self.made_nm = made_nm
        return next_rad_s / TURN_RAD


class Cascade:
    """A position loop around a velocity loop, with feed-forward.

    Velocity asked for: `speed_ahead` + position_gain (target - position), within the limit; torque: velocity_gain
    (velocity asked for - velocity) + `torque_ahead`. Without a position gain it is a velocity loop.

    Attributes:
        target, speed_ahead, torque_ahead: rev, rev/s, N·m.
        position_gain: 1/s; None for a velocity loop.
        velocity_gain: N·m/(rev/s).
        top: highest velocity asked for [rev/s].
    """

    def __init__(self, target: float, position_gain: float | None, velocity_gain: float, top: float) -> None:
        self.target = target
        self.speed_ahead = self.torque_ahead = 0.0
        self.position_gain = position_gain
        self.velocity_gain = velocity_gain
        self.top = top
        self.rests = False

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """Speed after a step of the torque it asks for."""
        way = self.target - position if self.position_gain is not None else 0.0
        asked = _within(self.speed_ahead + (self.position_gain or 0.0) * way, self.top)
        still = self.speed_ahead == self.torque_ahead == 0.0
        if still and abs(way) < AT_REST_TURNS and abs(speed) < AT_REST_TURNS_S:
            self.rests = True
            return 0.0
        self.rests = False
        rate = load.gain(1.0)
        wanted = (speed + rate * (self.velocity_gain * asked + self.torque_ahead)) / (1.0 + rate * self.velocity_gain)
        return load.driven(speed, (wanted - speed) / rate)


class Interpolation:
    """Follow straight lines between targets: each is reached a beat after it came (cyclic synchronous position).

    Behind the line it is a critically damped loop with the line's speed ahead. Where no target comes the line ends, at
    once: drives that go on for a while are smoother when a target is late, and farther when none comes.

    Attributes:
        acceleration: most it does [rev/s²].
    """

    BANDWIDTH_S = 200.0
    """Of its loop [1/s]."""

    def __init__(self, position: float, acceleration: float) -> None:
        self.acceleration = acceleration
        self.rests = False
        self._from = self._to = position
        self._begin_ns = self._end_ns = 0

    def aim(self, time_ns: int, target: float, beat_ns: int) -> None:
        """A target has come, to be reached a beat later."""
        self._from = self.line(time_ns)[0]
        self._to = target
        self._begin_ns, self._end_ns = time_ns, time_ns + beat_ns
        self.rests = False

    def line(self, time_ns: int) -> tuple[float, float]:
        """Where the line is [rev], and how fast [rev/s]."""
        if time_ns > self._end_ns or self._to == self._from:
            return self._to, 0.0
        way, beat = self._to - self._from, self._end_ns - self._begin_ns
        return self._from + way * (time_ns - self._begin_ns) / beat, way / (beat * 1e-9)

    def speed(self, load: Load, time_ns: int, position: float, speed: float) -> float:
        """Speed after a step of its loop."""
        there, line_speed = self.line(time_ns)
        behind = there - position
        if line_speed == 0.0 and abs(behind) < AT_REST_TURNS and abs(speed) < AT_REST_TURNS_S:
            self.rests = True
            return 0.0
        stiff = self.BANDWIDTH_S * self.BANDWIDTH_S * STEP_S
        damp = 2.0 * self.BANDWIDTH_S * STEP_S
        wanted = (speed + stiff * behind + damp * line_speed) / (1.0 + damp + stiff * STEP_S)
        return _towards(wanted, speed, self.acceleration * STEP_S)


class Servo:
    """One shaft under a law, with its history.

    Call `advance` before the law is changed; what is changed acts from the next step on.

    Args:
        start_ns: beginning of the history.
        position: where it stands [rev].
        load: what it moves.

    Attributes:
        law: what is in charge; `obey` sets it.
        low, high: positions it cannot pass [rev]; None where nothing is in the way.
        pressed_ns: since when it has been pushed against something that does not give way, `NEVER` if it is not.
    """

    def __init__(self, start_ns: int, position: float, load: Load | None = None) -> None:
        self.load = load or Load()
        self.law: Law = Hold()
        self.low: float | None = None
        self.high: float | None = None
        self.pressed_ns = NEVER
        self._step_ns = start_ns
        self._last_step: tuple[Law, float, float, float, float] = (self.law, 0.0, 0.0, 0.0, self.load.torque_nm)
        self._idle = False
        self._from_ns, self._from, self._speed = start_ns, position, 0.0
        self._times = array("q", [start_ns])
        self._positions = array("d", [position])
        self._speeds = array("d", [0.0])

    def obey(self, law: Law) -> None:
        """Let another law be in charge, or the same one again after it was changed."""
        self.law = law
        self._idle = False

    def advance(self, now_ns: int) -> None:
        """Live up to `now_ns`; a time already lived changes nothing."""
        step_ns = self._step_ns
        if step_ns > now_ns:
            return
        if self._idle:
            self._step_ns = step_ns + (now_ns - step_ns) // STEP_NS * STEP_NS + STEP_NS
            return
        law, load = self.law, self.load
        walled = self.low is not None or self.high is not None
        if not walled:
            self.pressed_ns = NEVER
        while step_ns <= now_ns:
            speed = self._speed
            position = self._from + speed * ((step_ns - self._from_ns) * 1e-9)
            wanted = law.speed(load, step_ns, position, speed)
            given = self._give_way(step_ns, position, wanted) if walled else wanted
            if given != speed:
                self._append(step_ns, position, given)
            self._last_step = (law, speed, given, wanted, load.torque_nm)
            step_ns += STEP_NS
            if given == speed == wanted == 0.0 and law.rests:
                self._idle = True
                step_ns += max((now_ns - step_ns) // STEP_NS + 1, 0) * STEP_NS
        self._step_ns = step_ns

    def position_at(self, time_ns: int) -> float:
        """Position at the time last advanced to, or a little later [rev]."""
        return self._from + self._speed * ((time_ns - self._from_ns) * 1e-9)

    @property
    def speed(self) -> float:
        """Speed now [rev/s]."""
        return self._speed

    @property
    def torque_nm(self) -> float:
        """What the motor does now: what accelerates, what friction takes, and all there is against a stop."""
        law, before, given, wanted, most_nm = self._last_step
        if isinstance(law, Torque):
            return law.made_nm
        if given != wanted:
            return math.copysign(most_nm, wanted)
        if isinstance(law, Limp):
            return 0.0
        torque_nm = (given - before) * TURN_RAD * self.load.inertia_kg_m2 / STEP_S
        if given != 0.0:
            torque_nm += math.copysign(self.load.friction_nm, given)
        return _within(torque_nm, most_nm)

    def block(self, time_ns: int) -> None:
        """Jam: from `time_ns` on the shaft cannot move."""
        self.advance(time_ns)
        self.low = self.high = self.position_at(time_ns)
        self._append(time_ns, self.low, 0.0)
        self._idle = False

    # -- history -------------------------------------------------------------------------------------

    def past(self, time_ns: int) -> tuple[float, float]:
        """Position [revolutions] and speed [rpm] at any time of the history."""
        index = max(bisect_right(self._times, time_ns) - 1, 0)
        speed = self._speeds[index]
        return self._positions[index] + speed * ((time_ns - self._times[index]) * 1e-9), speed * 60.0

    def history(self, times_ns: Times) -> tuple[Reals, Reals]:
        """Positions [revolutions] and speeds [rpm] at many times of the history."""
        changes = np.array(self._times)
        index = np.maximum(np.searchsorted(changes, times_ns, side="right") - 1, 0)
        speeds = np.array(self._speeds)[index]
        elapsed_s = (np.asarray(times_ns, dtype=np.int64) - changes[index]) * 1e-9
        return np.array(self._positions)[index] + speeds * elapsed_s, speeds * 60.0

    def changes_ns(self) -> Times:
        """The times at which the speed changed, oldest first."""
        return np.array(self._times)

    def forget_before(self, time_ns: int) -> None:
        """Let the history begin with the stretch of motion that a time lies in."""
        old = bisect_right(self._times, time_ns) - 1
        if old > 0:
            self._forget(old)

    def _give_way(self, time_ns: int, position: float, wanted: float) -> float:
        """The speed that what stands in the way leaves of one."""
        given = wanted
        if self.high is not None and wanted > 0.0:
            given = min(wanted, max(self.high - position, 0.0) / STEP_S)
        elif self.low is not None and wanted < 0.0:
            given = max(wanted, min(self.low - position, 0.0) / STEP_S)
        if given == wanted:
            self.pressed_ns = NEVER
        elif self.pressed_ns == NEVER:
            self.pressed_ns = time_ns
        return given

    def _append(self, time_ns: int, position: float, speed: float) -> None:
        self._from_ns, self._from, self._speed = time_ns, position, speed
        if self._times[-1] == time_ns:
            self._positions[-1], self._speeds[-1] = position, speed
            return
        self._times.append(time_ns)
        self._positions.append(position)
        self._speeds.append(speed)
        if len(self._times) > 2 * HISTORY_LENGTH:
            self._forget(HISTORY_LENGTH)

    def _forget(self, count: int) -> None:
        for column in (self._times, self._positions, self._speeds):
            del column[:count]


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))


def _towards(target: float, value: float, step: float) -> float:
    return min(value + step, target) if value < target else max(value - step, target)
