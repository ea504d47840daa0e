"""What the full node's actions ask for: taken as it is meant, refused with a sentence that names the field."""

import math
from dataclasses import replace

import numpy as np
import plain_messages
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from config.kinematics import flange_pose
from config.loader import load_arm
from rosfront.full_node.asked import SLOWEST_RATIO, Moves, position_and_rotation, step_of
from rosfront.refusals import GoalRefused
from rosfront.settings import Settings

ARM = load_arm("episode1")
SETTINGS = Settings.of(ARM)
MOVES = Moves(ARM)
ZERO_DEG = [180.0, 90.0, 83.0, 30.0, 110.0, 30.0]
DEMO = ([260.0, 0.0, 200.0], [180.0, 0.0, 90.0])


def present(angles_deg=(0.0,) * 6, standing=True):
    return plain_messages.present(np.radians(angles_deg), standing=standing)


def refused(ask, *arguments, at=None):
    with pytest.raises(GoalRefused) as reason:
        ask(*arguments, at or present(), SETTINGS)
    assert "\n" not in reason.value.sentence
    return reason.value.sentence


def test_the_home_of_the_facts_is_every_joint_at_zero():
    """Facts: motor-side degrees [180, 90, 83, 30, 110, 30]."""
    start = present((10, -20, 30, 40, -50, 60))
    move = MOVES.to_angles(ZERO_DEG, 1.0, start, SETTINGS)
    assert move.target_rad == pytest.approx(np.zeros(6), abs=1e-12)
    assert MOVES.motor_deg(np.zeros(6)) == ZERO_DEG
    half = MOVES.to_angles(ZERO_DEG, 0.5, start, SETTINGS)
    assert move.plan.duration_s < half.plan.duration_s < 2 * move.plan.duration_s


def test_a_ratio_above_one_is_full_speed_and_says_so():
    start = present((10, 0, 0, 0, 0, 0))
    move = MOVES.to_angles(ZERO_DEG, 7.0, start, SETTINGS)
    assert move.plan.duration_s == MOVES.to_angles(ZERO_DEG, 1.0, start, SETTINGS).plan.duration_s
    assert move.note == "speed_ratio 7 was taken for 1, which is full speed."


@pytest.mark.parametrize("ratio", [0.0, -1.0, math.nan, -math.inf, 1e-300, 1e-12, 9.99e-4])
def test_a_ratio_that_is_no_speed_is_refused(ratio):
    for sentence in (refused(MOVES.to_angles, ZERO_DEG, ratio), refused(MOVES.to_pose, *DEMO, "xyz", ratio)):
        assert sentence.startswith(f"speed_ratio is {ratio:g}; allowed is")


def test_the_slowest_ratio_is_a_move_of_hours():
    plan = MOVES.to_angles([0.0, *ZERO_DEG[1:]], SLOWEST_RATIO, present((140, 0, 0, 0, 0, 0)), SETTINGS).plan
    assert 3 * 3600 < plan.duration_s < 4 * 3600


@pytest.mark.parametrize(("index", "value"), [(0, 320.2), (0, -0.2), (1, 181.0), (4, 1e300), (5, 320.3)])
def test_an_angle_outside_the_limits_is_refused_in_the_words_of_the_asker(index, value):
    angles = list(ZERO_DEG)
    angles[index] = value
    sentence = refused(MOVES.to_angles, angles, 1.0)
    assert sentence.startswith(f"angles[{index}] is {value:g}°; joint{index + 1} goes from 0° to ")


def test_the_limits_themselves_are_allowed():
    lowest, highest = [0.0] * 6, [320.0, 180.0, 163.0, 300.0, 220.0, 320.0]
    for angles in (lowest, highest):
        assert MOVES.motor_deg(MOVES.to_angles(angles, 1.0, present(), SETTINGS).target_rad) == pytest.approx(angles)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_refused(bad):
    assert refused(MOVES.to_angles, [0, 0, bad, 0, 0, 0], 1.0).startswith(f"angles[2] is {bad:g}, and all numbers must")
    assert refused(MOVES.to_pose, [bad, 0, 0], DEMO[1], "xyz", 1.0).startswith("position[0] is ")
    assert refused(MOVES.straight_to, DEMO[0], [0, bad, 0], "", 0.0).startswith("rotation[1] is ")
    assert refused(MOVES.straight_to, *DEMO, "xyz", bad).startswith("step_size is ")


def test_an_unknown_order_is_refused():
    assert refused(MOVES.to_pose, *DEMO, "yxz", 1.0) == "ik_mode is 'yxz'; allowed are xyz and zyx: send one of them."
    assert "ik_mode is ''" in refused(MOVES.to_pose, *DEMO, "", 1.0)
    assert r"rotation_mode is '\x1b[31m" in refused(MOVES.straight_to, *DEMO, "\x1b[31m" + "x" * 1000, 0.0)


def test_the_pose_of_the_demo_client():
    move = MOVES.to_pose(*DEMO, "xyz", 1.0, present(), SETTINGS)
    position, rotation = position_and_rotation(flange_pose(ARM.kinematics, move.target_rad), "xyz")
    assert position == pytest.approx(DEMO[0], abs=1e-6)
    assert [abs(rotation[0]), *rotation[1:]] == pytest.approx(DEMO[1], abs=1e-6)


def test_steps_have_the_defaults_of_the_facts():
    assert (step_of(0.0), step_of(-3.0), step_of(5.0), step_of(0.1)) == (8.0, 8.0, 5.0, 0.1)
    assert refused(MOVES.straight_to, *DEMO, "xyz", 0.05).startswith(
        "step_size is 0.05 mm; allowed are 0.1 mm and more"
    )


def test_an_empty_rotation_mode_is_zyx():
    start = present((0, 10, 40, 0, 50, 70))
    position, rotation = position_and_rotation(flange_pose(ARM.kinematics, start.commanded[:, 0]), "zyx")
    move = MOVES.straight_to([position[0], position[1] + 50, position[2]], rotation, "", 0.0, start, SETTINGS)
    assert move.line.turn_rad < 1e-9 and move.line.length_m == pytest.approx(0.05)


def test_finer_steps_make_more_points():
    start = present((0, 10, 40, 0, 50, 70))
    position, rotation = position_and_rotation(flange_pose(ARM.kinematics, start.commanded[:, 0]), "zyx")
    asked = ([position[0], position[1], position[2] - 40], rotation, "zyx")
    coarse, fine = (MOVES.straight_to(*asked, step, start, SETTINGS).plan for step in (8.0, 0.5))
    assert len(fine.times_ns) >= 80 > len(coarse.times_ns)


@pytest.mark.parametrize("words", [{"standing": False}, {"awaited": True}])
def test_an_arm_in_motion_or_about_to_move_takes_no_move(words):
    moving = replace(present(), **words)
    for sentence in (
        refused(MOVES.to_angles, ZERO_DEG, 1.0, at=moving),
        refused(MOVES.to_pose, *DEMO, "xyz", 1.0, at=moving),
        refused(MOVES.straight_to, *DEMO, "xyz", 0.0, at=moving),
    ):
        assert sentence.startswith("The arm is executing another goal")


def test_an_arm_without_geometry_moves_by_angles_only():
    moves = Moves(ARM.model_copy(update={"kinematics": None}))
    moves.to_angles(ZERO_DEG, 1.0, present(), SETTINGS)
    assert "no kinematics section" in refused(moves.to_pose, *DEMO, "xyz", 1.0)
    assert "no kinematics section" in refused(moves.straight_to, *DEMO, "xyz", 0.0)
    assert moves.flange(np.zeros(6)) is None


def test_an_arm_of_another_geometry_is_told_why():
    rows = [row.model_copy(update={"a_mm": 5.0}) for row in ARM.kinematics.dh]
    moves = Moves(ARM.model_copy(update={"kinematics": ARM.kinematics.model_copy(update={"dh": rows})}))
    assert refused(moves.to_pose, *DEMO, "xyz", 1.0).startswith("Row 4 of this arm's kinematics.dh does not fit")


@settings(deadline=None, max_examples=examples(200))
@given(
    st.lists(st.floats(), min_size=3, max_size=3),
    st.lists(st.floats(), min_size=3, max_size=3),
    st.sampled_from(["", "xyz", "zyx", "x"]),
    st.floats(),
)
def test_whatever_is_asked_there_is_a_plan_or_a_sentence(position, rotation, word, number):
    for ask in (MOVES.to_pose, MOVES.straight_to):
        try:
            plan = ask(position, rotation, word, number, present((0, 10, 40, 0, 50, 70)), SETTINGS).plan
        except GoalRefused as reason:
            assert reason.sentence.endswith(".")
        else:
            assert np.isfinite(plan.joints).all()
