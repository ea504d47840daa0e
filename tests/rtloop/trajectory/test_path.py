"""Paths: where in its window of waypoints a path time lies, what the plan is there, and how a blend leads onto it."""

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BPoly

from config.loader import load_arm
from rtloop.memory.motion import WINDOW_WAYPOINTS
from rtloop.process.initial_state import new_loop
from rtloop.trajectory import entry, path

LOOP = new_loop(load_arm("mock"), 0, 0)
WAYPOINTS = st.lists(st.integers(1, 10**9), min_size=1, max_size=40).map(np.cumsum)


def waypoint_of(times_ns: NDArray[np.int64], clock_s: float, first: int) -> int:
    """The last waypoint that is not after clock_s, or the first one."""
    return max(first, int(np.searchsorted(times_ns * 1e-9, clock_s, side="right")) - 1)


@settings(deadline=None, max_examples=examples(300))
@given(WAYPOINTS, st.integers(0, 10**7), st.integers(0, 1), st.data())
def test_the_segment_that_contains_a_path_time_is_found(
    times_ns: NDArray[np.int64], dropped: int, index: int, data: st.DataObject
) -> None:
    """Wherever in the window, whose older waypoints are gone, and also exactly at a waypoint."""
    numbers = dropped + np.arange(len(times_ns))
    LOOP[0]["waypoints"]["time_ns"][index * WINDOW_WAYPOINTS + numbers % WINDOW_WAYPOINTS] = times_ns
    LOOP[0]["paths"][index]["taken"] = numbers[-1] + 1
    first = data.draw(st.integers(0, len(times_ns) - 1))
    clock_s = data.draw(st.sampled_from(list(times_ns * 1e-9)) | st.floats(0.0, 50.0))
    found = path.find_waypoint(LOOP[0], index, clock_s, int(numbers[first]))
    assert found - dropped == waypoint_of(times_ns, clock_s, first)


# --- the plan and the blend -------------------------------------------------------------------------------------

ORDERS = {1: 1, 3: 2, 5: 3}
"""How many of position, velocity and acceleration a segment of each order takes from its ends."""


class Way:
    """A random path of a few waypoints, whose window begins anew among them, for all joints but the last."""

    def __init__(self, seed: int, order: int, *, stream: bool = False, ends_moving: bool = False) -> None:
        random = np.random.default_rng(seed)
        self.loop = new_loop(load_arm("mock"), 0, 0)[0]
        self.index = int(random.integers(2))
        self.first = WINDOW_WAYPOINTS * 3 - 2
        self.times_s = np.cumsum(np.round(random.uniform(0.1, 1.0, 6), 3))
        self.joints = random.normal(size=(6, 6, 3))
        self.path = self.loop["paths"][self.index]
        self.path["taken"], self.path["joint_mask"] = self.first + 6, 0b011111
        self.path["stream"], self.path["ends_moving"], self.path["ended"] = stream, ends_moving, 1
        for number in range(6):
            waypoint = self.loop["waypoints"][path.slot(self.index, self.first + number)]
            waypoint["time_ns"], waypoint["order"] = round(self.times_s[number] * 1e9), order
            for word, column in zip(("position_rad", "velocity_rad_s", "acceleration_rad_s2"), range(3), strict=True):
                waypoint["joints"][word][:6] = self.joints[number, :, column]
        for joint in range(6):
            self.path["blends"][joint]["held_rad"] = 0.25 * joint
        for word, value in zip(
            ("position_rad", "velocity_rad_s", "acceleration_rad_s2"), random.normal(size=3), strict=True
        ):
            self.loop["axes"]["commanded"][word][:6] = value * np.arange(1.0, 7.0)

    def plan(self, joint: int, clock_s: float) -> tuple[float, float, float]:
        waypoint = path.find_waypoint(self.loop, self.index, clock_s, self.first)
        return path.plan(self.loop, self.index, joint, clock_s, waypoint)

    def sample(self, joint: int, clock_s: float) -> tuple[float, float, float]:
        waypoint = path.find_waypoint(self.loop, self.index, clock_s, self.first)
        return path.sample(self.loop, self.index, joint, clock_s, waypoint)

    def commanded(self, joint: int) -> tuple[float, float, float]:
        now = self.loop["axes"][joint]["commanded"]
        return float(now["position_rad"]), float(now["velocity_rad_s"]), float(now["acceleration_rad_s2"])


seeds = st.integers(0, 10_000)
relaxed = settings(deadline=None, max_examples=examples(60))


@relaxed
@given(seeds, st.sampled_from(list(ORDERS)), st.floats(0.001, 0.999))
def test_a_plan_goes_through_its_waypoints_as_scipys_polynomials_do(seed: int, order: int, share: float) -> None:
    way, kept = Way(seed, order), ORDERS[order]
    clock_s = float(way.times_s[0] + share * (way.times_s[-1] - way.times_s[0]))
    for joint in range(5):
        reference = BPoly.from_derivatives(way.times_s, way.joints[:, joint, :kept])
        expected = [float(reference(clock_s, number)) for number in range(3)]
        assert way.plan(joint, clock_s) == pytest.approx(expected, abs=1e-6 * (1.0 + np.abs(expected).max()))
    assert way.plan(5, clock_s) == (1.25, 0.0, 0.0), "a joint outside the goal"


@pytest.mark.parametrize("order", ORDERS)
def test_a_plan_stands_before_its_first_waypoint_and_after_its_last(order: int) -> None:
    way = Way(1, order, stream=True)
    for joint in range(5):
        assert way.plan(joint, float(way.times_s[0]) - 1e-6) == (way.joints[0, joint, 0], 0.0, 0.0)
        assert way.plan(joint, float(way.times_s[-1]) + 1e-6) == (way.joints[-1, joint, 0], 0.0, 0.0)


@pytest.mark.parametrize("after_s", [0.0, 0.01, 0.03, 0.5])
def test_a_stream_runs_on_straight_when_its_acceleration_has_faded(after_s: float) -> None:
    """Within three cycles of 10 ms, as acceleration · (1 - t / T)²; what is left is a third of it in velocity."""
    way = Way(1, 3, stream=True, ends_moving=True)
    left = max(1.0 - after_s / 0.03, 0.0)
    for joint in range(5):
        p, v, a = way.joints[-1, joint]
        velocity = v + a * 0.03 / 3.0 * (1.0 - left**3)
        position = p + v * after_s + a * (0.03 / 3.0 * after_s - 0.03**2 / 12.0 * (1.0 - left**4))
        expected = (position, velocity, a * left**2)
        assert way.plan(joint, float(way.times_s[-1]) + after_s) == pytest.approx(expected, abs=1e-6)
        assert way.plan(joint, float(way.times_s[0]) - 0.1) == (way.joints[0, joint, 0], 0.0, 0.0), "not before"


@pytest.mark.parametrize(
    ("stream", "ends_moving", "ended", "expected"),
    [(0, 0, 1, 1), (0, 1, 1, 0), (1, 1, 1, 1), (1, 0, 1, 1), (1, 1, 0, 0)],
)
def test_which_ends_are_passed(stream: int, ends_moving: int, ended: int, expected: int) -> None:
    way = Way(1, 3, stream=bool(stream), ends_moving=bool(ends_moving))
    way.path["ended"] = ended
    assert path.goes_on_past_end(way.loop, way.index) == expected


def test_what_a_path_without_waypoints_and_one_at_rest_are() -> None:
    way = Way(1, 3)
    assert path.end_s(way.loop, way.index) == pytest.approx(way.times_s[-1], abs=1e-12)
    assert path.leaves_a_joint_moving(way.loop, way.index)
    last = way.loop["waypoints"][path.slot(way.index, way.first + 5)]["joints"]["velocity_rad_s"]
    last[:5], last[5] = path.REST_RAD_S, 1.0  # the sixth is none of the goal's
    assert not path.leaves_a_joint_moving(way.loop, way.index)
    last[2] = -1.001 * path.REST_RAD_S
    assert path.leaves_a_joint_moving(way.loop, way.index)
    way.path["taken"] = 0
    assert path.end_s(way.loop, way.index) == 0.0
    assert not path.leaves_a_joint_moving(way.loop, way.index)


@relaxed
@given(seeds, st.sampled_from(list(ORDERS)), st.sampled_from([1.0, 0.5, 0.25]), st.sampled_from([0.1, 0.6, 2.4]))
def test_a_blend_leads_from_where_the_arm_is_commanded_onto_the_plan(
    seed: int, order: int, rate: float, duration_s: float
) -> None:
    """In time: velocity over rate, acceleration over its square. Joints of no goal come to rest half a way ahead."""
    way = Way(seed, order)
    way.path["taken"] -= way.first  # a path is entered in its first window
    waypoints = way.loop["waypoints"]
    for number in range(6):
        waypoints[path.slot(way.index, number)] = waypoints[path.slot(way.index, way.first + number)]
    way.first = 0
    entry_s = float(way.times_s[0]) + 0.3 * float(way.times_s[1] - way.times_s[0])
    entry.lay_blend(way.loop, way.index, rate, entry_s, duration_s)
    assert way.path["fade_s"] == pytest.approx(0.03 * rate)
    for joint in range(6):
        p, v, a = way.commanded(joint)
        scale = 1.0 + abs(a) / rate**2 + np.abs(way.plan(joint, entry_s)).max()
        assert way.sample(joint, entry_s) == pytest.approx((p, v / rate, a / rate**2), abs=1e-9 * scale)
        behind_s = entry_s + duration_s + 1e-9
        assert way.sample(joint, behind_s) == way.plan(joint, behind_s)
        just_before = entry_s + duration_s * (1.0 - 1e-9)
        ends = 1e-6 * scale / duration_s**2
        assert way.sample(joint, just_before) == pytest.approx(way.plan(joint, just_before), abs=ends)
        amid = entry_s + 0.7 * way.path["fade_s"]
        before, here, after = (np.array(path.blend(way.loop, way.index, joint, amid + h)) for h in (-1e-5, 0.0, 1e-5))
        assert (after - before)[:2] / 2e-5 == pytest.approx(here[1:], abs=1e-3 * scale / duration_s**2)
    p, v, _ = way.commanded(5)
    assert way.path["blends"][5]["held_rad"] == pytest.approx(p + 0.5 * v / rate * duration_s)


def entered(*, ahead_s: float) -> Way:
    """A path whose first point, its second waypoint, is ahead of where it is entered, at 0.2 s."""
    way = Way(3, 5)
    way.path["taken"], way.path["approach"], way.first = 6, 1, 0
    for number in range(6):
        waypoint = way.loop["waypoints"][path.slot(way.index, number)]
        waypoint["time_ns"], waypoint["order"] = round((0.2 + ahead_s + 0.5 * (number - 1)) * 1e9), 5
        for word, column in zip(("position_rad", "velocity_rad_s", "acceleration_rad_s2"), range(3), strict=True):
            waypoint["joints"][word][:6] = way.joints[number, :, column]
    return way


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_an_approach_begins_where_the_arm_is_commanded(rate: float) -> None:
    way = entered(ahead_s=0.4)
    entry.lay_approach(way.loop, way.index, rate, 0.2)
    assert way.loop["waypoints"][path.slot(way.index, 0)]["time_ns"] == 200_000_000
    for joint in range(5):
        p, v, a = way.commanded(joint)
        assert way.plan(joint, 0.2) == pytest.approx((p, v / rate, a / rate**2))
        assert way.plan(joint, 0.6) == pytest.approx(tuple(way.joints[1, joint]))


def test_a_run_up_is_the_straight_line_through_the_first_point() -> None:
    way = entered(ahead_s=0.4)
    way.loop["waypoints"]["order"] = 3
    entry.lay_run_up(way.loop, way.index, 0.2)
    assert way.loop["waypoints"][path.slot(way.index, 0)]["time_ns"] == 200_000_000
    for joint in range(5):
        p, v, _ = way.joints[1, joint]
        for before_s in (0.399, 0.1):
            expected = (p - v * before_s, v, 0.0)
            assert way.plan(joint, 0.6 - before_s) == pytest.approx(expected, abs=1e-9)
    assert (way.loop["waypoints"]["joints"]["acceleration_rad_s2"][path.slot(way.index, 0)] == 0.0).all()


@pytest.mark.parametrize(
    ("start_s", "ended", "due_s"), [(0.0, 1, 0.0), (4.0, 1, 1.0), (6.0, 1, 0.0), (1.0, 0, 4.0), (1.0, 1, 2.6)]
)
def test_where_a_path_is_entered(start_s: float, ended: int, due_s: float) -> None:
    """At 5 s of the loop's time: no start time, one that is past, one ahead, and beyond the end of 2.6 s."""
    way = entered(ahead_s=0.4)
    way.loop["timing"]["now_ns"] = 5_000_000_000
    way.path["start_ns"], way.path["ended"] = round(start_s * 1e9), ended
    assert entry.due_s(way.loop, way.index) == pytest.approx(due_s)
