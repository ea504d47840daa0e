"""Whatever is asked of a moving arm, in any order: accelerations stay inside their margins and never step.

On the mock arm, so that the commanded motion is judged to the last digit, for many more cases than the simulated
drives would allow (they have their own in test_true_motion.py).
"""

import numpy as np
import pytest
from commanded import CommandedArm, acceleration_ratios
from depth import examples
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from virtual import recorded_goal

from shm.words import Fault, Outcome

MOVING = ("large", "scale_1_0", "near_limits_high", "around_box", "cartesian", "large_back")
ACCELERATION_RATIO = 1.9
"""Commanded acceleration as a multiple of the limit; 2.0 is the margin of the last line of defence."""
CHANGE_RATIO = 1.3
"""Change of the commanded acceleration from one cycle of 10 ms to the next, likewise: the bound on jerk."""

actions = st.lists(
    st.tuples(
        st.integers(1, 60),
        st.one_of(
            st.sampled_from(["hold", "resume", "back", "again", "stamped", "cancel"]),
            st.floats(0.0, 1.0),
        ),
    ),
    min_size=1,
    max_size=8,
)


class Asked(CommandedArm):
    """A mock arm somewhere in a recorded goal, to be asked for things."""

    def __init__(self, name: str) -> None:
        self.name, self.recorded = name, recorded_goal(name)
        super().__init__("mock", self.recorded["joints"][0, :, 0])
        self.newest = self.play(name)

    def ask(self, action: str | float) -> None:
        """Do what an action of the strategy says."""
        if isinstance(action, float):
            self.writer.scale(action)
        elif action == "hold":
            self.writer.hold()
        elif action == "resume":
            self.writer.resume()
        elif action == "cancel":
            self.writer.cancel_all()
        elif action == "back":
            self.newest = self.send_goal(np.array([self.time_back_ns()]), self.start_again(), approach=True)
        elif action == "stamped":
            joints = self.start_again()
            start_ns = self.now_ns + 200_000_000
            self.newest = self.send_goal(np.array([self.time_back_ns()]), joints, approach=True, start_ns=start_ns)
        elif action == "again" and self.running_goal != 0:
            clock_ns = round(float(self.memory["clock"]["time_s"]) * 1e9)
            self.newest = self.play(self.name, start_ns=self.now_ns - clock_ns)

    def start_again(self) -> np.ndarray:
        joints = self.recorded["joints"][:1].copy()
        joints[:, :, 1:] = 0.0
        return joints

    def time_back_ns(self) -> int:
        here = self.positions[-1]
        speeds = np.array([joint.max_velocity_rad_s for joint in self.arm.joints])
        return int(1e9 * max(0.8, float((2.5 * np.abs(self.recorded["joints"][0, :, 0] - here) / speeds).max())))

    def ratios(self) -> tuple[float, float]:
        """Largest acceleration, and largest change of it in a cycle, as multiples of the limits."""
        acceleration = acceleration_ratios(np.array(self.positions), self)
        return float(np.abs(acceleration).max()), float(np.abs(np.diff(acceleration, axis=0)).max())


@pytest.mark.parametrize("name", MOVING)
def test_an_undisturbed_goal_for_comparison(name: str) -> None:
    arm = Asked(name)
    arm.end_of(arm.newest)
    acceleration, change = arm.ratios()
    assert acceleration <= 1.5 and change <= 1.1
    arm.close()


@settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(MOVING), st.integers(2, 150), actions)
@example("large", 51, [(180, "resume"), (13, "stamped"), (6, 0.0078125)])  # an approach too fast between two samples
@example("large", 101, [(19, 0.0), (11, "stamped"), (10, 0.015625)])  # entered while almost standing: slow for ever
@example("large", 2, [(14, 1.0), (13, 0.0), (15, 1.0), (4, "hold")])  # a ramp turned round in its steepest part
@example("scale_1_0", 21, [(2, "stamped"), (18, 0.5)])  # entered slowly, then sped up
def test_whatever_is_asked_in_motion(name: str, begin: int, asked: list[tuple[int, str | float]]) -> None:
    arm = Asked(name)
    arm.cycles(begin)
    for wait, action in asked:
        arm.ask(action)
        arm.cycles(wait)
    arm.writer.scale(1.0)
    arm.writer.resume()
    arm.end_of(arm.newest, at_most_s=100)
    arm.cycles(5)
    assert arm.memory["fault"]["code"] == Fault.NONE
    # a goal whose time went by while the arm was held may be too far away, or too fast, by now
    refused = (Outcome.REFUSED_START, Outcome.REFUSED_LIMITS, Outcome.REFUSED_HELD)
    assert arm.outcome(arm.newest) in (Outcome.SUCCEEDED, Outcome.CANCELED, *refused)
    acceleration, change = arm.ratios()
    assert acceleration <= ACCELERATION_RATIO
    assert change <= CHANGE_RATIO
    arm.close()
