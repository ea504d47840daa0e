"""Goals on their way to the control process and back, without ROS: a stand-in loop stepped by hand."""

import time
from dataclasses import replace

import numpy as np
import pytest
from fake_loop import FakeLoop

from config.loader import load_arm
from rosfront import serving
from rosfront.link import attach
from rosfront.plan import GoalPlan, Terms
from rosfront.refusals import NotServing, Overtaken
from rosfront.serving import Serving
from rosfront.streamer import horizon_s
from rosfront.verdict import Status
from sentences.told import outcome_sentence
from shm import layout
from shm.errors import AlreadyHeld, NotRunning, WrongArm
from shm.words import Entry, Fault, Mode, Outcome, Setpoint

MS = 1_000_000


class Stage:
    """A serving front and a loop whose cycles the test runs."""

    def __init__(self, name):
        self.arm = load_arm("mock", overrides={"name": name})
        self.loop = FakeLoop(self.arm)
        self.now_ns = time.monotonic_ns()
        self.step()
        self.link = attach(self.arm)
        self.serving = Serving(self.arm)
        self.serving.attached(self.link)
        self.verdicts = {}

    def step(self, count=1, look=True):
        for _ in range(count):
            self.now_ns += self.loop.period_ns
            self.loop.cycle(self.now_ns)
            if look and hasattr(self, "serving"):
                self.look()

    def look(self):
        self.serving.look(self.link.reader.snapshot())

    def start(self, name, plan):
        return self.serving.start(plan, lambda verdict: self.verdicts.setdefault(name, []).append(verdict))

    def verdict(self, name):
        assert len(self.verdicts[name]) == 1
        return self.verdicts[name][0]

    def close(self):
        self.link.close()
        self.loop.files.remove()


@pytest.fixture
def stage(arm_name):
    stage = Stage(arm_name)
    yield stage
    stage.close()


def plan(seconds=0.5, spacing_ns=100 * MS, to_rad=0.1):
    times = np.arange(0, int(seconds * 1e9) + 1, spacing_ns)
    joints = np.zeros((len(times), 6, 3))
    joints[:, :, 0] = np.linspace(0.0, to_rad, len(times))[:, np.newaxis]
    terms = Terms(np.full((6, 3), 0.1), np.full((6, 3), 0.1), 0.4)
    origin = np.zeros((6, 3))
    return GoalPlan(times, np.full(len(times), 3), joints, 0b111111, terms, 0, 0, Entry(0), origin)


def test_a_goal_arrives_whole_and_succeeds(stage):
    stage.start("a", plan())
    stage.step(70)
    verdict = stage.verdict("a")
    assert verdict.status is Status.SUCCEEDED and verdict.code == 0
    assert verdict.sentence == "Goal reached: the largest error is 0.0000 rad, of joint1; 0.0100 rad are allowed."
    kinds = [kind for _, kind in stage.loop.records]
    assert kinds == [Setpoint.BEGIN, *[Setpoint.WAYPOINT] * 6, Setpoint.END]
    assert stage.serving.idle


def test_goal_numbers_rise_above_everything_the_loop_knows(stage):
    stage.loop.decide(41, Outcome.SUCCEEDED)
    stage.step()
    assert stage.start("a", plan()).goal_id == 42
    stage.loop.snapshot["goal_id"] = 50
    stage.loop.active, stage.loop.goals[50] = 50, {"begin": None, "times": [], "points": [], "ended": False}
    stage.loop.follow = lambda now_ns: None
    stage.step()
    assert stage.start("b", plan()).goal_id == 51


def test_a_long_goal_keeps_seconds_ahead_of_the_clock_and_no_more(stage):
    execution = stage.start("a", plan(seconds=20, spacing_ns=10 * MS))
    stage.step(10)
    goal = stage.loop.goals[execution.goal_id]
    ahead = []
    for _ in range(1800):
        stage.step()
        if not goal["ended"]:
            ahead.append((goal["times"][-1] - stage.loop.snapshot["trajectory_clock_ns"]) / 1e9)
    assert np.allclose(ahead, horizon_s(stage.serving.arm), atol=0.1)
    assert goal["ended"]


def test_a_full_ring_waits_and_loses_nothing(stage):
    stage.loop.taking = False
    long = plan(seconds=2, spacing_ns=MS // 4)
    execution = stage.start("a", long)
    stage.step(20)
    assert stage.link.writer.setpoints_written == layout.SETPOINT_SLOTS - 1
    stage.loop.taking = True
    stage.step(300)
    goal = stage.loop.goals[execution.goal_id]
    assert goal["times"] == long.times_ns.tolist() and goal["ended"]
    assert stage.verdict("a").status is Status.SUCCEEDED


def test_a_newer_goal_abandons_the_older_stream_at_once(stage):
    older = stage.start("old", plan(seconds=20, spacing_ns=10 * MS))
    stage.step(20)
    written = stage.link.writer.setpoints_written
    newer = stage.start("new", plan())
    stage.step(80)
    old, new = stage.verdict("old"), stage.verdict("new")
    assert (old.status, old.code) == (Status.ABORTED, -1)
    assert old.sentence.startswith("The goal was replaced by a newer goal, or by a trajectory")
    assert old.sentence.endswith("rad from its target.")
    assert new.status is Status.SUCCEEDED
    assert stage.link.writer.setpoints_written == written + 8
    assert newer.goal_id == older.goal_id + 1


def test_a_goal_the_loop_never_saw_is_replaced_too(stage):
    stage.loop.taking = False
    stage.start("first", plan())
    stage.step(3)
    stage.start("second", plan())
    stage.loop.taking = True
    stage.step(80)
    assert stage.verdict("first").sentence.startswith("The goal was replaced by a newer goal,")
    assert stage.verdict("second").status is Status.SUCCEEDED


def test_the_older_goal_goes_on_when_the_newer_is_refused(stage):
    older = stage.start("old", plan(seconds=1.0))
    stage.step(10)
    newer = stage.start("new", plan())
    stage.loop.goals.pop(newer.goal_id, None)
    stage.loop.decide(newer.goal_id, Outcome.REFUSED_START, 2, 0.2, 0.05)
    stage.loop.taking = False
    stage.step()
    verdict = stage.verdict("new")
    assert (verdict.status, verdict.code) == (Status.ABORTED, -1)
    assert verdict.sentence.startswith("Where it would be entered, the trajectory has joint3 0.2000 rad")
    assert "old" not in stage.verdicts
    stage.step(100)
    assert stage.verdict("old").status is Status.SUCCEEDED
    assert older.goal_id < newer.goal_id


@pytest.mark.parametrize(
    ("outcome", "code", "words"),
    [
        (Outcome.PATH_TOLERANCE, -4, "joint2 was 0.1312 rad from its setpoint and 0.1000 rad are allowed"),
        (
            Outcome.GOAL_TOLERANCE,
            -5,
            "joint2 was 0.1312 rad from its target when the time to arrive was over",
        ),
        (Outcome.STOPPED, -1, "stopped by a person"),
        (Outcome.STARVED, -1, "stopped arriving"),
        (Outcome.FRONT_LOST, -1, "no sign of life for 0.131 s and 0.100 s are allowed"),
        (Outcome.CLOCK_GAP, -1, "was away for 0.131 s"),
        (99, -1, "Unknown outcome 99"),
    ],
)
def test_what_ends_a_goal_reaches_its_client_with_the_final_error(stage, outcome, code, words):
    stage.start("a", plan())
    stage.step(10)
    stage.loop.finish(outcome, joint=1, value=0.1312, limit=0.1)
    stage.step()
    verdict = stage.verdict("a")
    assert (verdict.status, verdict.code) == (Status.ABORTED, code)
    assert words in verdict.sentence and "rad from its target" in verdict.sentence


def test_a_cancel_stops_the_goal(stage):
    execution = stage.start("a", plan())
    stage.step(10)
    stage.serving.cancel(execution)
    stage.step(10)
    verdict = stage.verdict("a")
    assert (verdict.status, verdict.code) == (Status.CANCELED, 0)
    assert verdict.sentence.startswith("Canceled: the arm is at rest and has not left its path; joint1 is")
    stage.loop.command["canceled_goals"] = 0
    stage.serving.cancel(execution)  # too late: nothing more is asked
    assert not stage.loop.is_canceled(execution.goal_id)


def test_a_cancel_that_comes_before_its_goal_is_kept_for_it(stage):
    stage.loop.take_setpoints = lambda: None
    first, second = stage.start("a", plan(seconds=3)), stage.start("b", plan(seconds=3))
    stage.serving.cancel(first)
    stage.serving.cancel(second)
    stage.step(20)
    assert stage.verdicts == {}
    assert stage.loop.is_canceled(first.goal_id) and stage.loop.is_canceled(second.goal_id)
    for execution in (first, second):
        stage.loop.decide(execution.goal_id, Outcome.CANCELED)
    stage.step()
    assert {stage.verdict(name).status for name in "ab"} == {Status.CANCELED}


def test_a_fault_ends_the_goal_with_its_sentence_and_refuses_the_next(stage):
    stage.start("a", plan())
    stage.step(10)
    stage.loop.fault(Fault.FOLLOWING_ERROR, 3, 0.12, 0.1)
    stage.step()
    said = "joint4 was 0.1200 rad from where it was commanded and 0.1000 rad are allowed"
    assert stage.verdict("a").sentence.startswith(said)
    with pytest.raises(NotServing, match=said):
        stage.serving.present()


def test_a_faulted_loop_that_never_takes_a_goal_does_not_leave_it_hanging(stage):
    stage.loop.taking = False
    stage.start("a", plan())
    stage.loop.fault(Fault.COMMAND_RING, -1, 5000.0, 4096.0)
    stage.step(45)
    assert stage.verdicts == {}
    stage.step(10)
    assert stage.verdict("a").sentence.startswith("The command memory holds what cannot be right")


@pytest.mark.parametrize("mode", [Mode.OFFLINE, Mode.BRINGING_UP])
def test_no_goals_before_the_arm_holds(stage, mode):
    stage.loop.snapshot["mode"] = mode
    stage.step()
    with pytest.raises(NotServing, match=f"while it is {mode.name.lower().replace('_', ' ')}"):
        stage.serving.present()


def test_no_goals_while_a_joint_has_no_reference(stage):
    stage.loop.unreference(4)
    stage.step()
    with pytest.raises(NotServing, match="The drive of joint5 may have lost power") as refused:
        stage.serving.present()
    assert refused.value.joint == "joint5"


def test_no_goals_while_the_loop_runs_no_cycles(stage):
    stage.now_ns -= 3_000 * MS
    stage.step()
    with pytest.raises(NotServing, match=r"has run no cycle for [23]\.\d\d s"):
        stage.serving.present()


def test_a_torn_snapshot_refuses_the_goal(stage):
    stage.loop.state["snapshot_sequence"][0] += 1
    with pytest.raises(NotServing, match="No consistent snapshot"):
        stage.serving.present()


def test_a_lost_loop_ends_every_goal_once_and_asks_a_hung_one_to_stop(stage):
    executions = [stage.start("a", plan(seconds=3))]
    stage.step(5)
    executions.append(stage.start("b", plan(seconds=3)))
    stage.serving.lost("Gone.")
    assert [stage.verdict(name).sentence for name in "ab"] == ["Gone.", "Gone."]
    stage.serving.lost("Gone again.")
    stage.look()
    assert len(stage.verdicts["a"]) == 1
    assert all(stage.loop.is_canceled(execution.goal_id) for execution in executions)
    with pytest.raises(NotServing, match="Gone again"):
        stage.start("c", plan())


def test_present_says_where_the_arm_is_commanded(stage):
    stage.loop.rows["commanded_position_rad"] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    stage.step()
    present = stage.serving.present()
    assert present.commanded[:, 0].tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert present.standing
    assert present.monotonic_ns == stage.now_ns


def test_present_knows_of_a_goal_before_the_control_process_does_and_until_its_end(stage):
    stage.step()
    stage.start("a", plan(seconds=0.1))
    present = stage.serving.present()
    assert present.standing and present.awaited
    stage.step(200)
    assert stage.verdict("a").status is Status.SUCCEEDED
    assert stage.serving.present().standing and not stage.serving.present().awaited


def test_one_front_an_arm_and_the_right_arm(stage):
    with pytest.raises(AlreadyHeld, match="Another front already serves"):
        attach(stage.arm)
    with pytest.raises(WrongArm, match="start both from the same arm file"):
        attach(load_arm("mock", overrides={"name": stage.arm.name, "limits": {"start_tolerance_rad": 0.01}}))


def test_the_files_of_a_dead_loop_are_not_attached_to(arm_name):
    arm = load_arm("mock", overrides={"name": arm_name})
    with pytest.raises(NotRunning, match="No control process is running"):
        attach(arm)
    loop = FakeLoop(arm)
    link = attach(arm)
    assert not link.loop_is_gone()
    link.close()
    loop.die()
    with pytest.raises(NotRunning, match="is gone without an orderly end"):
        attach(arm)
    loop.sweep()


# --- goals that start later ---


def later(stage, ahead_s):
    return replace(plan(), start_ns=stage.now_ns + round(ahead_s * 1e9))


def test_a_goal_far_ahead_is_kept_back_until_it_is_nearly_due(stage, monkeypatch):
    """Nothing of it stands in the ring before waypoints that are needed sooner."""
    monkeypatch.setattr(serving.time, "monotonic_ns", lambda: stage.now_ns)
    stage.start("later", later(stage, 5.0))
    stage.step(100)
    assert not stage.loop.records
    stage.step(110)  # 2.9 s before its start
    assert stage.loop.records[0] == (1, Setpoint.BEGIN)
    stage.step(400)
    assert stage.verdict("later").status is Status.SUCCEEDED


def test_a_goal_kept_back_is_canceled_without_the_loop(stage):
    execution = stage.start("later", later(stage, 3600.0))
    stage.step(3)
    stage.serving.cancel(execution)
    stage.step()
    assert stage.verdict("later").status is Status.CANCELED
    assert "before it was begun" in stage.verdict("later").sentence and stage.serving.idle


def test_a_goal_kept_back_is_lost_without_a_word_to_the_loop(stage):
    """A cancel of its number would be remembered, and would meet another goal that got it."""
    execution = stage.start("later", later(stage, 3600.0))
    stage.step(3)
    stage.serving.lost("Gone.")
    assert stage.verdict("later").sentence == "Gone."
    assert not stage.loop.is_canceled(execution.goal_id)


def test_a_number_serves_once(stage):
    """Also when the loop never heard of the goal that had it."""
    first = stage.start("later", later(stage, 3600.0))
    stage.serving.lost("Gone.")
    stage.serving.attached(stage.link)
    second = stage.start("now", plan())
    assert second.goal_id > first.goal_id
    stage.step(80)
    assert stage.verdict("now").status is Status.SUCCEEDED


def test_a_goal_kept_back_is_replaced_by_a_newer_one(stage):
    stage.start("later", later(stage, 3600.0))
    stage.start("now", plan())
    stage.step(80)
    assert stage.verdict("now").status is Status.SUCCEEDED
    assert (stage.verdict("later").status, stage.verdict("later").code) == (Status.ABORTED, -1)


@pytest.mark.parametrize("pauses", [True, False])
def test_what_came_while_the_process_stood_still_counts_as_come_before_the_stop_it_missed(stage, monkeypatch, pauses):
    stage.step()
    stage.loop.command["stop_ns"], stage.loop.command["resume_ns"] = 1, 2
    stage.step(look=False)
    now_ns = stage.serving._looked_ns + (serving.PAUSE_NS if pauses else 0)
    monkeypatch.setattr(serving.time, "monotonic_ns", lambda: now_ns)
    came = stage.serving.arrival()
    monkeypatch.undo()
    stage.look()
    if pauses:
        with pytest.raises(NotServing, match=outcome_sentence(Outcome.REFUSED_OUTDATED)):
            stage.serving.start(plan(), lambda verdict: None, arrival=came)
    else:
        assert stage.serving.start(plan(), lambda verdict: None, arrival=came)


def test_what_comes_before_the_first_look_is_judged_by_the_arm_as_it_is_then(stage):
    """Bring-up has ended meanwhile; the park that somebody asked for at once was refused as older than that."""
    fresh = Serving(stage.arm)
    fresh.attached(stage.link)
    stage.loop.command["stop_ns"], stage.loop.command["resume_ns"] = 1, 2
    stage.step(look=False)
    came = fresh.arrival()
    assert came.epoch == int(stage.link.reader.snapshot()["epoch"]) > 0
    fresh.refuse_outdated(came)


def test_what_came_earlier_does_not_replace_what_has_begun(stage):
    first, second, third = (stage.serving.arrival() for _ in range(3))
    stage.serving.start(plan(seconds=3), lambda verdict: None, arrival=second)
    with pytest.raises(Overtaken, match="Replaced by a newer goal"):
        stage.serving.start(plan(seconds=3), lambda verdict: None, arrival=first)
    newest = stage.serving.start(plan(seconds=3), lambda verdict: None, arrival=third)
    stage.step(5)
    assert stage.loop.active == newest.goal_id
    assert stage.start("now", plan()).goal_id == newest.goal_id + 1
