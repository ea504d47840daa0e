"""What a person has stopped stays at rest until a person resumes, whatever clients and streams go on sending."""

import math

import numpy as np
import pytest
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from servo import Servo, SinglePoints, waves
from virtual import VirtualArm

from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced

trials = settings(max_examples=examples(12), deadline=None, suppress_health_check=[HealthCheck.too_slow])
JOINT1 = 1


def new_arm(name: str = "mock") -> VirtualArm:
    arm = VirtualArm.brought_up(name)
    return arm


def moves(arm: VirtualArm) -> bool:
    return bool(np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"]))


@trials
@given(
    seed=st.integers(0, 1000),
    rate_hz=st.sampled_from([50.0, 100.0, 200.0]),
    single=st.booleans(),
    stopped_after_cycles=st.integers(1, 250),
    offset=st.integers(0, 9),
)
def test_a_streamed_arm_stops_and_stays_while_its_sender_goes_on(
    seed: int, rate_hz: float, single: bool, stopped_after_cycles: int, offset: int
) -> None:
    """Message N+1 stood in the ring before STOPPING was entered, and replaced what STOP had ended."""
    arm = new_arm()
    way = waves(arm, 0.5, seed)
    sender = SinglePoints(arm, way, rate_hz, velocities=True) if single else Servo(arm, way, rate_hz)
    sender.run((stopped_after_cycles * arm.period_ns + offset * sender.period_ns / 10) * 1e-9)
    arm.writer.stop()
    sender.run(float(arm.loop[0]["params"]["longest_stop_s"]))
    assert not moves(arm) and arm.running_goal == 0 and arm.memory["mode"] == Mode.HOLDING
    stood_rad = arm.loop[0]["axes"]["commanded"]["position_rad"].copy()
    sender.run(1.0)
    assert (arm.loop[0]["axes"]["commanded"]["position_rad"] == stood_rad).all()
    snapshot = arm.reader.snapshot()
    newest = snapshot["results"][snapshot["results"]["goal_id"].argmax()]
    assert (newest["goal_id"], newest["outcome"]) == (arm.writer.announced_goal, Outcome.REFUSED_HELD)
    assert arm.memory["fault"]["code"] == Fault.NONE and snapshot["held"] == 1
    arm.close()


def test_a_client_that_sends_its_goal_again_moves_nothing_before_a_resume() -> None:
    arm = new_arm()
    goal = arm.send_shift(0.2)
    arm.cycles(40)
    arm.stop()
    assert arm.end_of(goal) == Outcome.STOPPED
    arm.until(lambda: arm.running_goal == 0)
    stood_rad = arm.loop[0]["axes"]["commanded"]["position_rad"].copy()
    for _ in range(5):
        assert arm.end_of(arm.send_shift()) == Outcome.REFUSED_HELD
    assert (arm.loop[0]["axes"]["commanded"]["position_rad"] == stood_rad).all()
    arm.resume()
    assert arm.reader.snapshot()["held"] == 0
    assert arm.end_of(arm.send_shift()) == Outcome.SUCCEEDED
    arm.close()


def test_a_stop_reaches_the_goals_that_have_not_begun() -> None:
    arm = new_arm()
    waiting = arm.send_shift(start_ns=arm.now_ns + 10**9)
    arm.cycles(10)
    arm.stop()
    assert arm.outcome(waiting) == Outcome.REFUSED_HELD
    later = arm.send_shift(start_ns=arm.now_ns + 10**9)
    assert arm.end_of(later) == Outcome.REFUSED_HELD
    arm.cycles(300)
    assert not np.any(arm.loop[0]["axes"]["commanded"]["position_rad"])
    arm.close()


def test_a_stop_ends_a_paused_goal_and_the_resume_after_it_revives_nothing() -> None:
    arm = new_arm()
    goal = arm.send_shift(0.2)
    arm.cycles(40)
    arm.hold()
    arm.until(lambda: not moves(arm))
    arm.stop()
    arm.resume()
    assert arm.end_of(goal) == Outcome.STOPPED
    stood_rad = arm.loop[0]["axes"]["commanded"]["position_rad"].copy()
    arm.cycles(100)
    assert (arm.loop[0]["axes"]["commanded"]["position_rad"] == stood_rad).all()
    arm.close()


def test_a_stopped_arm_is_not_homed_and_may_be_told_where_it_stands() -> None:
    arm = new_arm("episode1")
    arm.stop()
    assert arm.ask(Request.HOME, joint_mask=JOINT1) == Answer.REFUSED_HELD
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT1, value=math.nan) == Answer.DONE
    assert arm.reference().failure is None
    assert arm.loop[0]["axes"][0]["reference"]["unreferenced_reason"] == Unreferenced.REFERENCED
    arm.resume()
    assert arm.ask(Request.HOME, joint_mask=JOINT1) == Answer.DONE
    arm.close()


def test_a_stop_outlasts_limp_drives_and_a_cleared_fault() -> None:
    arm = new_arm("episode1")
    assert arm.ask(Request.DISABLE) == Answer.DONE
    arm.release()
    arm.stop()
    assert arm.ask(Request.ENABLE) == Answer.DONE
    assert arm.bring_up().failure is None
    assert arm.end_of(arm.send_shift()) == Outcome.REFUSED_HELD
    arm.command.record["setpoints_written"][0] += 1 << 40
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.command.record["setpoints_written"][0] -= 1 << 40
    assert arm.clear_fault().failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    assert arm.end_of(arm.send_shift()) == Outcome.REFUSED_HELD
    arm.close()


@pytest.mark.parametrize("cycles_between", [0, 1, 3])
def test_what_follows_a_cancel_begins_only_at_rest(cycles_between: int) -> None:
    """A goal that lay in the ring when the cancel came used to replace what the cancel had ended, at full speed."""
    arm = new_arm()
    first = arm.send_shift(0.06)  # so slow that the arm stands near enough for the second one
    arm.cycles(100)
    speed_rad_s = abs(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"]).max()
    arm.writer.cancel(first)
    arm.cycles(cycles_between)
    second = arm.send_shift()
    arm.until(lambda: arm.running_goal == second or arm.outcome(second) != Outcome.NONE)
    assert arm.outcome(first) == Outcome.CANCELED
    assert abs(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"]).max() < 0.01 * speed_rad_s
    arm.close()
