"""Cases 73 to 95: configuration, activation, holding, replacement, and what drives and people do meanwhile."""

from math import pi

import numpy as np
import pytest
import yaml
from stage import ABORTED, ARM_FILE, CANCELED, START, SUCCEEDED, away, upstream_arm
from trajectory_messages import goal, point, tolerance, trajectory

from config.errors import ConfigError
from config.loader import load_arm
from shm.words import Mode, Request

ZERO = (0.0, 0.0, 0.0)


@pytest.fixture
def write_arm(tmp_path):
    """The arm file with changes, as a path."""

    def write(change):
        values = yaml.safe_load(ARM_FILE.read_text(encoding="utf-8"))
        change(values)
        path = tmp_path / "changed.yaml"
        path.write_text(yaml.safe_dump(values), encoding="utf-8")
        return path

    return write


def refusal(path) -> str:
    with pytest.raises(ConfigError) as refused:
        load_arm(path)
    return str(refused.value)


@pytest.mark.upstream(
    73,
    "different",
    why="Joints come from the arm file; a bad one is refused with its line, and every joint needs limits.",
)
def test_a_bad_description_ends_the_start(write_arm, tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("joints: [", encoding="utf-8")
    assert "is not valid YAML" in refusal(broken)
    assert "upper_deg" in refusal(write_arm(lambda arm: arm["joints"][1].pop("upper_deg")))


@pytest.mark.upstream(
    74,
    "different",
    why="The joints that are commanded are those of the arm file; there is no second list that could disagree.",
)
def test_command_joints_are_the_joints(write_arm):
    sentence = refusal(write_arm(lambda arm: arm.update(command_joints=["a", "b"])))
    assert "command_joints is not a field" in sentence
    assert "name a is used by" in refusal(write_arm(lambda arm: arm["joints"][1].update(name="a")))


@pytest.mark.upstream(
    75,
    "different",
    why="Drives are told positions and measure position; what does not fit the bus or is unknown is refused by name.",
)
def test_forbidden_combinations(write_arm):
    def velocity_drive(arm):
        arm["joints"][0]["drive"] = {"family": "velocity"}

    def mock_bus(arm):
        arm["bus"] = {"interface": "mock"}

    assert "command_interfaces is not a field" in refusal(
        write_arm(lambda arm: arm.update(command_interfaces=["effort"]))
    )
    assert "velocity" in refusal(write_arm(velocity_drive))
    assert "interface mock reaches no drives" in refusal(write_arm(mock_bus))


@pytest.mark.upstream(76, "same")
@pytest.mark.parametrize("drives", ["mock", "zdt"])
def test_an_arm_that_is_brought_up_holds_where_it_stands(stage_for, drives):
    stage = stage_for(drives)
    assert stage.commanded == pytest.approx(START, abs=1e-3)
    stage.assert_stands(1.0)
    assert stage.measured == pytest.approx(stage.commanded, abs=1e-3)
    assert stage.mode is Mode.HOLDING and int(stage.arm.memory["motion"]["started"]) == 0


@pytest.mark.upstream(77, "same")
@pytest.mark.parametrize("kind", [Request.DISABLE, Request.FREE])
def test_drives_that_were_let_go_hold_where_they_are_enabled_again(stage_for, kind):
    stage = stage_for("zdt")
    assert stage.finish(goal(point(0.5, away(0.2)))).outcome == (SUCCEEDED, 0)
    stage.run(0.2)
    done, sentence = stage.ask(kind)
    assert done, sentence
    stage.arm.release()
    stage.run(2.0)
    refused = stage.finish(goal(point(1.0, START)))
    assert refused.outcome == (ABORTED, -1) and "takes no goals while it is" in refused.sentence
    stood = stage.measured
    done, sentence = stage.ask(Request.ENABLE)
    assert done, sentence
    stage.bring_up()
    stage.assert_stands()
    assert stage.commanded == pytest.approx(stood, abs=1e-3)
    assert stage.commanded == pytest.approx(away(0.2), abs=1e-3)
    assert stage.finish(goal(point(1.0, START))).outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(80, "same")
def test_changed_constraints_count_from_the_next_goal(stage_for):
    stage = stage_for()
    first = stage.send(goal(point(0.5, away(0.1))))
    stage.run(0.1)
    before = stage.path_tolerances.tolist()
    stage.configure(path_tolerance_rad=(0.2, 0.3, 0.4), goal_tolerance_rad=(0.5, 0.6, 0.7), goal_time_s=1.5)
    stage.run(0.1)
    assert stage.path_tolerances.tolist() == before
    stage.until(lambda: first.ended)
    second = stage.send(goal(point(0.5, START)))
    stage.run(0.1)
    assert stage.path_tolerances[:, 0].tolist() == [0.2, 0.3, 0.4]
    assert stage.goal_tolerances[:, 0].tolist() == [0.5, 0.6, 0.7]
    assert float(stage.path["goal_time_s"]) == 1.5
    stage.until(lambda: second.ended)


@pytest.mark.upstream(
    81,
    "different",
    why="There is no cmd_timeout to configure: no command outlives its trajectory in motion, so nothing has to expire.",
)
def test_there_is_no_command_timeout():
    with pytest.raises(ConfigError, match="cmd_timeout is not a field"):
        upstream_arm(trajectory={"cmd_timeout": 3.0})


@pytest.mark.upstream(82, "same")
def test_the_last_point_is_held_for_ever(stage_for):
    stage = stage_for()
    stage.finish(goal(point(0.5, away(0.2))))
    stage.assert_stands(10.0)
    stage.arm.front_alive = False
    stage.assert_stands(10.0)
    assert stage.commanded == pytest.approx(away(0.2), abs=1e-9)


@pytest.mark.upstream(
    83,
    "different",
    why="No timeout is needed: a stream that ends in motion comes to rest in a straight line, and the arm holds.",
)
def test_what_ends_in_motion_comes_to_rest(stage_for):
    stage = stage_for(gentle=True)
    sent = stage.publish(trajectory(point(0.5, away(0.1), [0.5, 0.5, 0.5])))
    stage.until(lambda: sent.ended, 3.0)
    assert sent.outcome == (ABORTED, -1) and "The next point of the stream did not come in time" in sent.sentence
    moved = stage.commanded - START
    assert moved == pytest.approx([moved[0]] * 3, abs=1e-9) and moved[0] > 0.1
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(
    84, "different", why="No joint is continuous, so no error is ever wrapped: it is the way the joint has to go."
)
def test_errors_are_not_wrapped(stage_for):
    stage = stage_for(start=ZERO)
    sent = stage.send(goal(point(10.0, [2 * pi, 2 * pi, 2 * pi])))
    stage.run(0.1)
    stage.cancel(sent)
    stage.until(lambda: sent.ended)
    assert sent.outcome == (CANCELED, 0)
    assert 6.0 < float(sent.sentence.split(" rad from its target")[0].split()[-1]) < 2 * pi


@pytest.mark.upstream(85, "same")
def test_a_partial_goal_after_a_reached_one_moves_only_its_joint(stage_for):
    stage = stage_for()
    stage.finish(goal(point(0.5, away(0.2))))
    begun = len(stage.setpoints)
    assert stage.finish(goal(point(0.5, [2.0]), names="b")).outcome == (SUCCEEDED, 0)
    assert stage.commanded == pytest.approx([START[0] + 0.2, 2.0, START[2] + 0.2], abs=1e-9)
    assert np.ptp(stage.command_since(begun)[:, [0, 2]], axis=0).max() < 1e-12


@pytest.mark.upstream(86, "same")
def test_a_trajectory_wholly_in_the_past_leaves_the_running_one_alone(stage_for):
    stage = stage_for()
    running = stage.send(goal(point(1.0, away(0.2))))
    stage.run(0.5)
    late = trajectory(point(0.25, ZERO), stamp_ns=stage.epoch_ns - 1_000_000_000)
    assert stage.publish(late).outcome == (ABORTED, -3)
    assert stage.finish(goal(*late.points, stamp_ns=stage.epoch_ns - 1_000_000_000)).outcome == (ABORTED, -3)
    stage.until(lambda: running.ended)
    assert running.outcome == (SUCCEEDED, 0)
    assert stage.commanded == pytest.approx(away(0.2), abs=1e-9)


@pytest.mark.upstream(
    87, "better", why="A new trajectory always begins where the arm is commanded, so the command never falls back."
)
@pytest.mark.upstream(88, "same")
def test_a_new_trajectory_begins_at_the_command_and_not_at_the_measured_state(stage_for):
    stage = stage_for("zdt", gentle=True)
    stage.hold_shafts("a")
    off = [tolerance("a", -1.0)]
    ahead = stage.finish(goal(point(1.0, away(0.3)), path=off, time_s=0.05))
    assert ahead.outcome == (ABORTED, -5)
    assert stage.commanded[0] - stage.measured[0] == pytest.approx(0.3, abs=1e-3)
    begun = len(stage.setpoints)
    sent = stage.send(goal(point(1.0, away(0.4)), path=off, time_s=0.05))
    stage.run(0.5)
    command = stage.command_since(begun)[:, 0]
    assert command[0] >= START[0] + 0.3 - 1e-9
    assert (np.diff(command) >= -1e-12).all() and command[-1] > START[0] + 0.33
    stage.until(lambda: sent.ended)
    stage.assert_never_stepped()


@pytest.mark.upstream([89, 90], "same")
def test_the_command_begins_at_the_drives_own_target(stage_for):
    """89: there is no older command, so what the drives report is used; 90: what they were told last is kept."""
    stage = stage_for("zdt")
    for joint, drive in enumerate(stage.arm.sim.drives):
        config = stage.arm.arm.joints[joint]
        told = config.direction * drive.target_counts / config.encoder_counts_per_rad - config.zero_rad
        assert stage.commanded[joint] == pytest.approx(told, abs=1e-12)
        assert told == pytest.approx(START[joint], abs=1e-3)
    assert np.isfinite(stage.commanded).all() and not stage.velocity.any()


@pytest.mark.upstream(
    91, "different", why="There is no such parameter: the drive's own target is used, the one value that moves nothing."
)
def test_measured_positions_are_not_taken_for_commands(stage_for):
    stage = stage_for("zdt")
    assert stage.finish(goal(point(0.5, away(0.1)))).outcome == (SUCCEEDED, 0)
    stage.run(0.2)
    before = stage.commanded
    assert stage.ask(Request.DISABLE)[0]
    stage.arm.release()
    assert stage.ask(Request.ENABLE)[0]
    stage.bring_up()
    assert stage.commanded == pytest.approx(before, abs=1e-3)
    stage.assert_stands()


@pytest.mark.upstream(
    92,
    "better",
    why="Stops on its path from where it is commanded and holds there, without a step to the measured state.",
)
def test_a_stuck_arm_ends_a_topic_trajectory(stage_for):
    stage = stage_for("zdt")
    stage.configure(path_tolerance_rad=(1e-4,) * 3)
    stage.hold_shafts()
    sent = stage.publish(trajectory(point(0.0, START), point(0.25, away(0.1))))
    stage.until(lambda: sent.ended)
    assert sent.outcome == (ABORTED, -4) and "0.0001 rad are allowed" in sent.sentence
    stage.until(lambda: stage.mode is Mode.HOLDING)
    assert (np.abs(stage.commanded - START) < 0.1).all()
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(
    93,
    "better",
    why="Holds the last point, to which the command has come without a step, whatever the measured state does.",
)
def test_a_topic_trajectory_that_does_not_arrive(stage_for):
    stage = stage_for("zdt", lag_s=0.5)
    stage.configure(path_tolerance_rad=(0.0,) * 3, goal_tolerance_rad=(0.1,) * 3, goal_time_s=0.1)
    sent = stage.publish(trajectory(point(0.3, away(0.4))))
    stage.until(lambda: sent.ended)
    assert sent.outcome == (ABORTED, -5) and "rad are allowed" in sent.sentence
    behind = stage.measured
    assert (behind < np.array(START) + 0.3).all()
    stage.assert_stands(3.0)
    assert stage.commanded == pytest.approx(away(0.4), abs=1e-6)
    assert (stage.measured > behind + 0.09).all(), "the state has moved on, the command has not"
    stage.assert_never_stepped()


@pytest.mark.upstream(
    94,
    "different",
    why="As upstream, but above 1 is refused too, and no drive has a speed scaling of its own that could win.",
)
def test_speed_scaling(stage_for):
    stage = stage_for(gentle=True)
    assert stage.snapshot["speed_scale_asked"] == 1.0
    for factor in (0.765, 0.0):
        assert stage.ask(Request.SPEED_SCALE, factor)[0]
        assert stage.snapshot["speed_scale_asked"] == factor
    for factor in (-0.12, 1.5, float("nan"), float("inf")):
        stage.ask(Request.SPEED_SCALE, factor)
        assert stage.snapshot["speed_scale_asked"] == 0.0
    sent = stage.send(goal(point(1.0, away(0.2))))
    stage.assert_stands(1.0)
    assert not sent.ended
    stage.ask(Request.SPEED_SCALE, 1.0)
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    95,
    "better",
    why="All joints stop together on the path within their limits; upstream stops each by itself, off the path.",
)
@pytest.mark.parametrize("velocities", [(0.2, 0.2, 0.2), (-0.2, -0.2, -0.2), (0.2, -0.1, 0.0)])
def test_how_far_a_stop_goes(stage_for, velocities):
    stage = stage_for(gentle=True)
    ways = np.array(velocities)
    steady = [point(s, np.array(START) + ways * (s - 0.25), ways) for s in (0.5, 1.0, 2.0)]
    sent = stage.send(goal(*steady, point(2.5, np.array(START) + ways * 2.0, ZERO)))
    stage.run(1.0)
    before = stage.commanded
    assert stage.velocity == pytest.approx(velocities, abs=1e-6)
    stage.cancel(sent)
    stage.until(lambda: sent.ended)
    assert sent.outcome == (CANCELED, 0) and not stage.velocity.any()
    stopped_in = stage.commanded - before
    assert stopped_in == pytest.approx(ways / ways[0] * stopped_in[0], abs=1e-9)
    # v² / 2d = 0.002 rad is the least; the ramp begins and ends gently, and the request takes a cycle
    assert 0.002 < abs(stopped_in[0]) < 0.012
    stage.assert_never_stepped()
