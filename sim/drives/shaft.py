"""The shaft of a simulated drive: where it truly is, now and at any time before.

It follows the ramp exactly, or with a first-order lag, except where something solid is in the way: a
mechanical stop, or a jam. It then stands while the ramp goes on, and is picked up again when the ramp
comes back. The velocity history is piecewise constant and kept as integers (without lag it is exact).
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER

Times = NDArray[np.int64]
Reals = NDArray[np.float64]

HISTORY_LENGTH = 1 << 20
"""Changes of velocity remembered at least; about an hour of streaming, 32 MB a drive."""


class Shaft:
    """True position of one motor shaft, with its history.

    Args:
        start_ns: beginning of the history.
        position: where it stands [grains].
        lag_s: time constant with which it follows the ramp [s]; 0 follows exactly.

    Attributes:
        low, high: positions it cannot pass [grains]; None where nothing is in the way.
    """

    def __init__(self, start_ns: int, position: int, lag_s: float = 0.0) -> None:
        self.low: int | None = None
        self.high: int | None = None
        self._lag_ns = lag_s * 1e9
        self._ramp_ns = start_ns
        self._ramp_position = position
        self._ramp_rpm = 0
        self._times = array("q", [start_ns])
        self._positions = array("q", [position])
        self._speeds = array("q", [0])
        self._behind = array("d", [0.0])

    def follow(self, time_ns: int, position: int, speed_rpm: int) -> None:
        """Take note of a change of the ramp's speed at `time_ns` (times never decrease)."""
        if self._clear_of_stops(self._ramp_position) and self._clear_of_stops(position):
            self._append(time_ns, position, speed_rpm)
        else:
            self.settle(time_ns)
            held = self._clamp(position)
            blocked = held != position or self._pushing(position, speed_rpm)
            self._append(time_ns, held, 0 if blocked else speed_rpm)
        self._ramp_ns = time_ns
        self._ramp_position = position
        self._ramp_rpm = speed_rpm

    def block(self, time_ns: int) -> None:
        """Jam: from `time_ns` on the shaft cannot move."""
        self.settle(time_ns)
        here = self.target_at(time_ns)
        self.let_stop(time_ns, here, here)

    def let_stop(self, time_ns: int, low: int, high: int) -> None:
        """From `time_ns` on something solid stands there on either side, and nothing else does."""
        self.settle(time_ns)
        self.low, self.high = low, high
        ramp = self._ramp_position + self._ramp_rpm * (time_ns - self._ramp_ns)
        self.follow(time_ns, ramp, self._ramp_rpm)

    def place(self, time_ns: int) -> int:
        """Where a ramp that lost its hold on the shaft must start again [grains]."""
        self.settle(time_ns)
        return self.target_at(time_ns)

    def settle(self, now_ns: int) -> None:
        """Enter the moments at which the present motion touches or leaves a stop, up to `now_ns`."""
        speed = self._ramp_rpm
        if speed == 0:
            return
        start = self._ramp_position
        if self._clear_of_stops(start) and self._clear_of_stops(start + speed * (now_ns - self._ramp_ns)):
            return
        for bound in (self.low, self.high) if speed > 0 else (self.high, self.low):
            if bound is None:
                continue
            way = bound - start
            if way * speed < 0:
                continue
            when = self._ramp_ns + -(-abs(way) // abs(speed))
            if self._times[-1] < when <= now_ns:
                held = self._pushing(bound, speed)
                self._append(when, bound, 0 if held else speed)

    def target_at(self, time_ns: int) -> int:
        """Position without the lag, of the present stretch of motion [grains]."""
        return self._positions[-1] + self._speeds[-1] * (time_ns - self._times[-1])

    def position_at(self, time_ns: int) -> int:
        """Position at a time not before the last change [grains]."""
        self.settle(time_ns)
        if not self._lag_ns:
            return self.target_at(time_ns)
        return self.target_at(time_ns) + round(self._lag(len(self._times) - 1, time_ns)[0])

    def speed_at(self, time_ns: int) -> float:
        """Speed at a time not before the last change [rpm]."""
        self.settle(time_ns)
        if not self._lag_ns:
            return self._speeds[-1]
        return self._speeds[-1] + self._lag(len(self._times) - 1, time_ns)[1]

    def past(self, time_ns: int) -> tuple[float, float]:
        """Position [revolutions] and speed [rpm] at any time of the history."""
        index = max(bisect_right(self._times, time_ns) - 1, 0)
        position = float(self._positions[index] + self._speeds[index] * (time_ns - self._times[index]))
        speed = float(self._speeds[index])
        if self._lag_ns:
            behind, drift = self._lag(index, time_ns)
            position += behind
            speed += drift
        return position / GRAINS_PER_REVOLUTION, speed

    def history(self, times_ns: Times) -> tuple[Reals, Reals]:
        """Positions [revolutions] and speeds [rpm] at many times of the history."""
        changes = np.array(self._times)
        index = np.maximum(np.searchsorted(changes, times_ns, side="right") - 1, 0)
        speeds = np.array(self._speeds)[index]
        elapsed = np.asarray(times_ns, dtype=np.int64) - changes[index]
        positions = (np.array(self._positions)[index] + speeds * elapsed).astype(np.float64)
        real_speeds = speeds.astype(np.float64)
        if self._lag_ns:
            offset = np.array(self._behind)[index] + speeds * self._lag_ns
            fading = np.exp(-elapsed / self._lag_ns)
            positions += offset * fading - speeds * self._lag_ns
            real_speeds -= offset * fading / self._lag_ns
        return positions / GRAINS_PER_REVOLUTION, real_speeds

    def changes_ns(self) -> Times:
        """The times at which the velocity changed, oldest first."""
        return np.array(self._times)

    def forget_before(self, time_ns: int) -> None:
        """Let the history begin with the stretch of motion that a time lies in."""
        old = bisect_right(self._times, time_ns) - 1
        if old > 0:
            self._forget(old)

    def contact_ns(self, now_ns: int, position: int, speed_rpm: int, margin: int) -> int:
        """When a ramp now at `position` [grains] gets `margin` beyond a stop, or comes back from there.

        Returns:
            That time [ns], `NEVER` if its speed leads to neither.
        """
        low, high = self.low, self.high
        if speed_rpm > 0:
            if low is not None and position < low - margin:
                return now_ns - (position - low + margin) // speed_rpm
            if high is not None and position < high + margin:
                return now_ns - (position - high - margin) // speed_rpm
        elif speed_rpm < 0:
            if high is not None and position > high + margin:
                return now_ns - (high + margin - position) // -speed_rpm
            if low is not None and position > low - margin:
                return now_ns - (low - margin - position) // -speed_rpm
        return NEVER

    def pressed(self, position: int, speed_rpm: int, margin: int) -> bool:
        """Whether a ramp at `position` [grains] with this speed is `margin` beyond a stop."""
        beyond = abs(position - self._clamp(position))
        return beyond > margin or (beyond == margin and self._pushing(position, speed_rpm))

    def _clamp(self, position: int) -> int:
        if self.low is not None and position < self.low:
            return self.low
        if self.high is not None and position > self.high:
            return self.high
        return position

    def _clear_of_stops(self, position: int) -> bool:
        return (self.low is None or position > self.low) and (self.high is None or position < self.high)

    def _pushing(self, position: int, speed_rpm: int) -> bool:
        return (speed_rpm < 0 and self.low is not None and position <= self.low) or (
            speed_rpm > 0 and self.high is not None and position >= self.high
        )

    def _lag(self, index: int, time_ns: int) -> tuple[float, float]:
        """How far the lagging shaft is from the given stretch [grains], and its speed beside it [rpm]."""
        if not self._lag_ns:
            return 0.0, 0.0
        steady = self._speeds[index] * self._lag_ns
        fading = math.exp(-(time_ns - self._times[index]) / self._lag_ns)
        offset = (self._behind[index] + steady) * fading
        return offset - steady, -offset / self._lag_ns

    def _append(self, time_ns: int, position: int, speed_rpm: int) -> None:
        if speed_rpm == self._speeds[-1] and position == self.target_at(time_ns):
            return
        behind = 0.0
        if self._lag_ns:
            jump = self.target_at(time_ns) - position
            behind = self._lag(len(self._times) - 1, time_ns)[0] + jump
        if self._times[-1] == time_ns:
            self._positions[-1] = position
            self._speeds[-1] = speed_rpm
            self._behind[-1] = behind
            return
        self._times.append(time_ns)
        self._positions.append(position)
        self._speeds.append(speed_rpm)
        self._behind.append(behind)
        if len(self._times) > 2 * HISTORY_LENGTH:
            self._forget(HISTORY_LENGTH)

    def _forget(self, count: int) -> None:
        for column in (self._times, self._positions, self._speeds, self._behind):
            del column[:count]
