"""Writes a goal into the setpoint ring, a part at a time.

The control process enters a trajectory when it knows enough of it to stop on. Waypoints beyond the horizon stay in this
process, so that a newer goal never waits behind thousands of old waypoints and a trajectory of any length needs the
same memory. When the ring is full the rest waits for the next call.
"""

import numpy as np

from config.schema import ArmConfig
from motion.stopping import way_s
from rosfront.plan import NS, GoalPlan
from shm.client import CommandWriter
from shm.errors import RingFull

SPARE_S = 1.0
"""Margin of the horizon beyond all that may be needed."""
HELD_BACK_NS = 3_000_000_000
"""Nothing is written of a goal that starts further ahead, so that its waypoints are not in the way of other goals."""
WAYPOINTS_A_CALL = 256  # bounds the time for which a call blocks its thread, about 2 ms


def horizon_s(arm: ArmConfig) -> float:
    """How far ahead of the trajectory clock waypoints are written (s).

    When this process falls silent, the arm goes on for `front_timeout_s`. The longest stop must then still be known to
    its end, because a stop on less path is harder than the limits allow.
    """
    return way_s(arm.longest_stop_s) + arm.limits.front_timeout_s + SPARE_S


class Streamer:
    """One goal on its way into the ring: BEGIN, its waypoints, END."""

    def __init__(self, goal_id: int, plan: GoalPlan, epoch: int, horizon_s: float) -> None:
        """`epoch` is that of the control process when the goal arrived."""
        self.goal_id = goal_id
        self._epoch = epoch
        self._horizon_ns = horizon_s * NS
        self._plan = plan
        self.begun = False
        self._next = 0
        self.done = False

    def is_held_back(self, now_ns: int) -> bool:
        """Whether the goal's start is so far ahead that nothing of it is written yet."""
        return not self.begun and self._plan.start_ns > now_ns + HELD_BACK_NS

    def due_ns(self, now_ns: int) -> int:
        """Time along the trajectory (ns) at which the goal would be entered now."""
        return max(now_ns - self._plan.start_ns, 0) if self._plan.start_ns else 0

    def pump(self, writer: CommandWriter, consumed: int, clock_ns: float) -> None:
        """Write what is due: up to the horizon ahead of the trajectory clock (ns), as far as the ring has room.

        `consumed` is the number of records the control process has taken.
        """
        plan = self._plan
        clock_ns = max(clock_ns, plan.entry_ns)  # a goal that is entered midway does not begin at 0
        try:
            if not self.begun:
                writer.announce(self.goal_id)
                writer.begin(
                    self.goal_id,
                    start_ns=plan.start_ns,
                    joint_mask=plan.joint_mask,
                    goal_time_s=plan.terms.goal_time_s,
                    entry=plan.entry,
                    epoch=self._epoch,
                    tolerances=plan.terms.path_tolerances,
                    consumed=consumed,
                )
                self.begun = True
            due = int(np.searchsorted(plan.times_ns, clock_ns + self._horizon_ns, side="right")) + 1
            last = min(due, len(plan.times_ns), self._next + WAYPOINTS_A_CALL)
            while self._next < last:
                at = self._next
                time_ns, order = int(plan.times_ns[at]), int(plan.orders[at])
                writer.waypoint(self.goal_id, time_ns, order, plan.joints[at], consumed)
                self._next = at + 1
            if self._next == len(plan.times_ns) and not self.done:
                writer.end(self.goal_id, plan.terms.goal_tolerances, consumed)
                self.done = True
        except RingFull:
            return
