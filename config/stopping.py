"""How long an arm takes to stop at most, and how long whoever waits for that waits.

Both follow from the joint that is slowest to brake. Every wait for an arm that may be braking is in `Patience`, so
that no process is ended, and no goal given up, while its arm still stops as it should.
"""

from dataclasses import dataclass

LONGEST_ALLOWED_S = 60.0
"""No arm may take longer: the way of that stop must be known ahead, and what ends programs waits no longer."""
STEEPEST = 5.3
"""Duration of the stop that fits beside the hardest plan, in V / A; largest 6 x (1 - x) / (1 - (1 - PLAN_SHARE) s²)."""


def longest_stop_s(slowest_s: float) -> float:
    """Duration (s) within which every stop ends, whatever the arm is doing.

    `slowest_s` is the largest ratio of velocity limit V to acceleration limit A of the joints. A plan at V that uses
    all but PLAN_SHARE of A (`motion.stopping`) leaves the stop nothing else at first; at the rate s = 1 - 3x² + 2x³ it
    needs s² of its own share only, so A (1 - (1 - PLAN_SHARE) s²) is left for V · 6 x (1 - x) / T. A tenth more covers
    velocities within the velocity margin. Stops that may brake harder are shorter, and so are those that drives make
    by themselves when they hear nothing more (`silence_brake_factor`).
    """
    return 1.1 * STEEPEST * slowest_s


@dataclass(frozen=True)
class Patience:
    """How long each who waits for an arm to stop waits (s): the longest stop, and what else there is to do meanwhile.

    Who ends another waits longer than the other one waits itself.
    """

    longest_stop_s: float

    @property
    def shutdown_s(self) -> float:
        """The control process that is to end, for its arm."""
        return self.longest_stop_s + 1.0

    @property
    def drives_s(self) -> float:
        """The control process, for drives that brake by themselves; their readings go on dithering for a while."""
        return max(self.longest_stop_s + 1.0, 3.0)

    @property
    def goals_s(self) -> float:
        """The ROS process that is to end, for the goals that it has canceled."""
        return self.longest_stop_s + 1.5

    @property
    def canceled_s(self) -> float:
        """A program that has canceled its goal, for the result."""
        return self.longest_stop_s + 3.0

    @property
    def ros_process_s(self) -> float:
        """The launcher, for the ROS process to end, parking apart; then it is killed."""
        return self.longest_stop_s + 5.0

    @property
    def control_process_s(self) -> float:
        """The launcher, for the control process to end, which may have to end a homing run; then it is killed."""
        return self.longest_stop_s + 8.0

    @property
    def person_s(self) -> float:
        """A person, for an arm that was told to stop or hold, or whose goal was canceled; then something is wrong."""
        return self.longest_stop_s + 8.0

    @property
    def bring_up_s(self) -> float:
        """A person, for drives to be brought up, which may still brake by themselves."""
        return self.longest_stop_s + 28.0
