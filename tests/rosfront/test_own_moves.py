"""Moves that the arm file asks for: when they give way to what people ask for, and what they say then."""

import threading

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from front_stage import SlowJudge, goal, serving_alone
from ros_client import SUCCEEDED
from waiting import until

from config.homing import HomingConfig, ParkingConfig, PoseMove
from rosfront import own_moves
from rosfront.own_moves import OwnMoves

POSE_DEG = [5.0] * 6


@pytest.fixture
def told():
    return []


def moves_of(front, told):
    """The moves of the front's arm, were this pose in its file; what is put is done at once."""
    sections = {"homing": HomingConfig(then=PoseMove(joints_deg=POSE_DEG))}
    return OwnMoves(front.arm.model_copy(update=sections), front.serving, lambda work: work(), told.append)


def homed(loop):
    """What a front sees after a homing run at the start."""
    snapshot = loop.snapshot
    snapshot["pose_due"] = 1
    return snapshot


def test_a_goal_that_begins_while_the_pose_is_planned_comes_instead(arm_name, told, monkeypatch):
    with serving_alone(arm_name) as (loop, front, client, _):
        judge = SlowJudge(monkeypatch, own_moves, "plan_move")
        moves = moves_of(front, told)
        thread = threading.Thread(target=moves.look, args=(homed(loop),))
        thread.start()
        until(judge.judging.is_set, "the pose being planned")
        handle = client.send(goal(seconds=1.0))
        until(lambda: loop.active != 0, "the goal")
        judge.pass_on.set()
        thread.join(20.0)
        assert client.result(handle)[0] == SUCCEEDED
        assert [sentence.partition(": ")[2][:8] for sentence in told] == ["Replaced"]
        assert len({goal_id for goal_id, _ in loop.records}) == 1


def test_whoever_asks_for_something_else_while_the_pose_is_planned_gets_no_move(arm_name, told, monkeypatch):
    with serving_alone(arm_name) as (loop, front, _, _):
        judge = SlowJudge(monkeypatch, own_moves, "plan_move")
        thread = threading.Thread(target=moves_of(front, told).look, args=(homed(loop),))
        thread.start()
        until(judge.judging.is_set, "the pose being planned")
        loop.snapshot["pose_due"] = 0  # `rtarm hold`, say
        until(lambda: not front.serving.newest()["pose_due"], "that it is seen")
        judge.pass_on.set()
        thread.join(20.0)
        assert front.serving.idle and not loop.records and not told


@pytest.mark.parametrize(
    ("factor", "said"), [(0.0, "never end at the speed scaling factor of 0 "), (0.001, "s at the speed scaling factor")]
)
def test_parking_that_is_slowed_beyond_its_time_is_not_begun(arm_name, told, factor, said):
    with serving_alone(arm_name) as (loop, front, _, _):
        loop.snapshot["speed_scale_asked"] = factor
        parking = ParkingConfig(joints_deg=POSE_DEG, speed_ratio=1.0, timeout_s=20.0)
        until(lambda: front.serving.newest()["speed_scale_asked"] == factor, "that it is seen")
        assert not moves_of(front, told).park(parking, lambda: None)
        assert len(told) == 1 and told[0].startswith("Not parked: It would") and said in told[0]
        assert front.serving.idle and not loop.records
