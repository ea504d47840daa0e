"""The motion of a plan between its points."""

import numpy as np

from motion import bounds, segment
from rosfront.plan import NS, GoalPlan


class PlannedPath:
    """The interpolant of a plan, joints of the goal only.

    It includes a goal's approach segment, but not the way to a stream's first point: the control process makes that way
    gentle, whatever the point's time.
    """

    def __init__(self, plan: GoalPlan) -> None:
        self.mask = np.array([bool(plan.joint_mask >> joint & 1) for joint in range(plan.joints.shape[1])])
        waypoints = plan.joints[:, self.mask]
        approached = plan.approach and not plan.stream
        if approached:
            self.times_ns = np.concatenate([[plan.entry_ns], plan.times_ns])
            self.waypoints = np.concatenate([plan.origin[np.newaxis, self.mask], waypoints])
            self.orders = plan.orders
        else:
            self.times_ns, self.waypoints, self.orders = plan.times_ns, waypoints, plan.orders[1:]
        self._stream = plan.stream
        self.shift = int(approached)  # waypoints before the goal's first point

    @property
    def segments(self) -> int:
        return len(self.orders)

    def coefficients(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (6, m, joints) and durations (m, 1) in s of the segments `index` (m,)."""
        duration = ((self.times_ns[index + 1] - self.times_ns[index]) / NS)[:, np.newaxis]
        start, end, order = self.waypoints[index], self.waypoints[index + 1], self.orders[index]
        result = np.zeros((6, *start.shape[:2]))
        kinds = np.unique(order)
        for kind in kinds:
            chosen = order == kind if len(kinds) > 1 else slice(None)  # a copy of everything is expensive
            p0, v0, a0 = start[chosen].transpose(2, 0, 1)
            p1, v1, a1 = end[chosen].transpose(2, 0, 1)
            if kind == 5:
                parts = segment.quintic(p0, v0, a0, p1, v1, a1, duration[chosen])
            elif kind == 3:
                parts = segment.cubic(p0, v0, p1, v1, duration[chosen])
            else:
                parts = segment.linear(p0, p1, duration[chosen])
            for power, part in enumerate(parts):
                result[power, chosen] = part
        return result, duration

    def at(self, times_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration (m, joints) at `times_ns` (m,).

        Before its first and after its last point a goal is at rest, and a stream moves in a straight line.
        """
        within_ns = np.clip(times_ns, self.times_ns[0], self.times_ns[-1])
        if self.segments == 0:
            position, velocity = (np.repeat(self.waypoints[:1, :, column], len(times_ns), axis=0) for column in (0, 1))
            return self._beyond(times_ns, within_ns, position, velocity, np.zeros_like(position))
        index = np.clip(np.searchsorted(self.times_ns, within_ns, side="right") - 1, 0, self.segments - 1)
        coefficients, _ = self.coefficients(index)
        local_s = ((within_ns - self.times_ns[index]) / NS)[:, np.newaxis]
        slope = bounds.derivative(coefficients)
        position, velocity = bounds.value(coefficients, local_s), bounds.value(slope, local_s)
        acceleration = bounds.value(bounds.derivative(slope), local_s)
        return self._beyond(times_ns, within_ns, position, velocity, acceleration)

    def _beyond(
        self,
        times_ns: np.ndarray,
        within_ns: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        acceleration: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same values, corrected at times outside the points."""
        outside = times_ns != within_ns
        acceleration[outside] = 0.0
        if self._stream:
            position += velocity * ((times_ns - within_ns) / NS)[:, np.newaxis]
        else:
            velocity[outside] = 0.0
        return position, velocity, acceleration

    def place(self, time_ns: float) -> str:
        """Words for where a time (ns) of the path is: at which point or between which."""
        after = int(np.searchsorted(self.times_ns, time_ns, side="left"))
        at = f"at {time_ns / NS:.4f} s"
        shift = self.shift
        if after >= len(self.times_ns):
            return f"{at}, after the last point"
        if self.times_ns[after] == time_ns and after >= shift:
            return f"{at}, at point {after - shift}"
        if after <= shift:
            return f"{at}, on the way to point 0"
        return f"{at}, between points {after - 1 - shift} and {after - shift}"
