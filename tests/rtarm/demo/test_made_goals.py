"""The demo of an arm that the recorded goals do not fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stack import run_rtarm

from config.loader import ARMS_FOLDER, known_arms, load_arm
from config.schema import ArmConfig
from rtarm.demo.goals import tour
from rtarm.demo.goals.made import SPEED, fits, goals_for, made_for


def four_joints(folder: Path, **changes: Any) -> Path:
    """The file of an arm of four ODrive axes that are called otherwise; `changes` in its second joint."""
    values = yaml.safe_load((ARMS_FOLDER / "odrive6.yaml").read_text(encoding="utf-8"))
    values["name"] = "four"
    values.pop("kinematics", None)
    values["joints"] = values["joints"][:4]
    for joint, name in zip(values["joints"], ("turn", "lift", "reach", "tip"), strict=True):
        joint["name"] = name
    values["joints"][1].update(changes)
    values.pop("homing", None)
    path = folder / "four.yaml"
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    return path


def judge(arm: ArmConfig) -> None:
    """Goals that are made for an arm fit it, follow on each other, and move it."""
    goals = made_for(arm)
    before: Any = goals[-1].document["trajectory"]["points"][-1]["positions"]
    for goal in goals:
        points = goal.document["trajectory"]["points"]
        assert fits(goal, arm)
        assert points[0]["positions"] == pytest.approx(before)
        before = points[-1]["positions"]
        velocities = np.abs([point["velocities"] for point in points])
        accelerations = np.abs([point["accelerations"] for point in points])
        assert (velocities <= SPEED * 1.001 * np.array([joint.max_velocity_rad_s for joint in arm.joints])).all()
        assert (accelerations <= SPEED * 1.001 * np.array([j.max_acceleration_rad_s2 for j in arm.joints])).all()
        assert 0.0 < goal.planned_s < 60.0
        assert velocities.max() > 0.0


@pytest.mark.parametrize("name", sorted(known_arms()))
def test_every_arm_has_goals_that_fit_it(name: str) -> None:
    arm = load_arm(ARMS_FOLDER / f"{name}.yaml")
    judge(arm)
    assert all(fits(goal, arm) for goal in goals_for(arm))


@settings(deadline=None, max_examples=examples(40), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    lower=st.floats(-340.0, 340.0),
    room=st.floats(0.5, 600.0),
    rpm=st.floats(1.0, 100.0),
    acceleration=st.floats(0.1, 20.0),
)
def test_goals_are_made_for_any_limits(
    tmp_path: Path, lower: float, room: float, rpm: float, acceleration: float
) -> None:
    changes = {"motor_rpm": rpm, "max_acceleration_rad_s2": acceleration}
    upper = min(lower + room, 359.0)
    arm = load_arm(four_joints(tmp_path, lower_deg=lower, upper_deg=upper, **changes))
    judge(arm)
    assert [goal.joint_names for goal in goals_for(arm)] == [("turn", "lift", "reach", "tip")] * 4


def test_goals_that_were_recorded_are_played_where_they_fit() -> None:
    assert goals_for(load_arm("episode1")) == tour()


@pytest.mark.process
def test_the_demo_moves_an_arm_of_four_joints_of_other_names(tmp_path: Path) -> None:
    ended = run_rtarm("demo", "--arm", str(four_joints(tmp_path)))
    assert (ended.returncode, "4 of 4 goals succeeded" in ended.stdout) == (0, True), ended.stdout + ended.stderr
    shown = [
        float(line.split(": ")[1].split(" of ")[0]) for line in ended.stdout.splitlines() if " s, joints at " in line
    ]
    assert shown == sorted(shown)  # the progress never goes back
