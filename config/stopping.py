"""How long an arm takes to stop at most, and how long whoever waits for that waits.

Both follow from the joint that is slowest to brake. Every wait for an arm that may be braking is in `Patience`, so
that no process is ended, and no goal given up, while its arm still stops as it should.
"""

from dataclasses import dataclass

LONGEST_ALLOWED_S = 60.0
"""No arm may take longer: the way of that stop must be known ahead, and what ends programs waits no longer."""
STEEPEST = 1.5
"""The rate of the trajectory clock falls with this over the stop's duration at most (`motion.stopping`)."""
GENTLEST_RAMP = 1.5
"""Braking of a drive that hears nothing more, as a multiple of its joint's limit, at least (`silence_brake_factor`)."""


def longest_stop_s(slowest_s: float, braking_factor: float) -> float:
    """Duration (s) within which every stop ends, whatever the arm is doing: on its path, or by its drives' own ramps.

    `slowest_s` is the largest ratio of velocity limit to acceleration limit of the joints. The plan may use the whole
    acceleration limit A at velocity V, so (braking_factor - 1) A is left for V · 1.5 / T; a quarter more covers plans
    that exceed their limits between two points, as real ones do.
    """
    return slowest_s * max(1.25 * STEEPEST / max(braking_factor - 1.0, 0.1), 1.0 / GENTLEST_RAMP)


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
