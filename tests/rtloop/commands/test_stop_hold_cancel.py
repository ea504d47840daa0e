"""Stop, hold, resume, speed scale and cancels: each is the newest of its kind, and none is lost or comes too late."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from rtloop.safety.faults import latch_fault
from shm import layout
from shm.errors import RingFull
from shm.recording import newest_events
from shm.words import Answer, Event, Fault, Mode, Outcome, Phase, Request

NS = 1_000_000_000


@pytest.fixture
def arm() -> VirtualArm:
    return new_arm()


def new_arm(name: str = "mock") -> VirtualArm:
    return VirtualArm.brought_up(name)


def moves(arm: VirtualArm) -> bool:
    return bool(np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"]))


def stands_for(arm: VirtualArm, seconds: float) -> None:
    stood_rad = arm.loop[0]["axes"]["commanded"]["position_rad"].copy()
    for _ in range(round(seconds * NS / arm.period_ns)):
        arm.cycle()
        assert (arm.loop[0]["axes"]["commanded"]["position_rad"] == stood_rad).all()


def let_go(request: Request) -> Callable[[VirtualArm], None]:
    def let_go_and_enable(arm: VirtualArm) -> None:
        assert arm.ask(request) == Answer.DONE
        arm.release()
        assert arm.ask(Request.ENABLE) == Answer.DONE
        assert arm.bring_up().failure is None

    return let_go_and_enable


def home(arm: VirtualArm) -> None:
    assert arm.ask(Request.HOME, joint_mask=1) == Answer.DONE
    arm.reference()


def stop_and_resume(arm: VirtualArm) -> None:
    arm.stop()
    arm.resume()


def hold_and_resume(arm: VirtualArm) -> None:
    arm.hold()
    arm.resume()


@pytest.mark.parametrize(
    "what",
    [stop_and_resume, hold_and_resume, let_go(Request.DISABLE), let_go(Request.FREE), home],
    ids=["stop", "hold", "disable", "free", "home"],
)
def test_a_goal_that_arrived_before_it_never_begins(what: Callable[[VirtualArm], None]) -> None:
    """Its client's process had kept it back, because it was to begin later or the ring was full."""
    arm = new_arm("episode1")
    arrived = int(arm.memory["goals"]["epoch"])
    what(arm)
    assert arm.memory["mode"] == Mode.HOLDING
    goal = arm.send_shift(epoch=arrived)
    assert arm.end_of(goal) == Outcome.REFUSED_OUTDATED
    stands_for(arm, 0.5)
    assert arm.end_of(arm.send_shift()) == Outcome.SUCCEEDED
    arm.close()


def test_what_waits_in_another_process_is_outdated_as_soon_as_the_arm_is_stopped_let_go_homed_or_at_fault() -> None:
    """That process ends it by the snapshot's epoch, whatever the arm does next."""
    arm = new_arm("episode1")

    def rises_by(happens: Callable[[], object]) -> None:
        before = arm.reader.snapshot()["epoch"]
        happens()
        arm.cycle()
        assert arm.reader.snapshot()["epoch"] > before

    for command in (arm.stop, arm.resume, arm.hold, arm.resume):
        rises_by(command)
    for request in (Request.DISABLE, Request.FREE):
        rises_by(functools.partial(arm.ask, request))
        arm.release()
        assert arm.ask(Request.ENABLE) == Answer.DONE
        rises_by(arm.bring_up)
    rises_by(lambda: arm.ask(Request.HOME, joint_mask=1))
    rises_by(arm.reference)
    rises_by(lambda: fault(arm))
    arm.close()


@pytest.mark.parametrize("what", ["stop", "hold"])
def test_a_goal_that_waits_for_its_start_ends_with_a_stop_and_a_hold(arm: VirtualArm, what: str) -> None:
    waiting = arm.send_shift(start_ns=arm.now_ns + NS)
    arm.cycles(10)
    assert arm.reader.snapshot()["goal_phase"] == Phase.WAITING
    getattr(arm, what)()
    assert arm.outcome(waiting) == Outcome.REFUSED_HELD
    arm.resume()
    stands_for(arm, 2.0)


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside a goal that runs"])
def test_a_goal_that_waits_for_its_start_ends_when_the_loop_was_away(arm: VirtualArm, beside: bool) -> None:
    """The machine was suspended: what was meant for an hour ago moves nothing."""
    if beside:
        arm.send_shift(0.2)
        arm.cycles(60)
    waiting = arm.send_shift(start_ns=arm.now_ns + 2 * NS)
    arm.cycles(10)
    arm.suspend(3600.0)
    arm.cycle()
    assert arm.outcome(waiting) == Outcome.REFUSED_OUTDATED
    arm.until(lambda: not moves(arm))
    stands_for(arm, 3.0)


def test_a_goal_behind_a_full_ring_does_not_begin_after_the_stop(arm: VirtualArm) -> None:
    arm.send_shift(0.2, duration_s=30.0)
    arm.cycles(60)
    arm.pending.clear()
    late = arm.send_shift(-0.2)
    arm.stop()
    assert arm.end_of(late) in (Outcome.REFUSED_HELD, Outcome.REFUSED_OUTDATED)
    arm.until(lambda: not moves(arm))
    arm.resume()
    stands_for(arm, 1.0)


@pytest.mark.parametrize("what", ["stop", "hold"])
def test_a_resume_lifts_what_was_asked_for_before_it_and_nothing_later_though_one_cycle_sees_both(
    arm: VirtualArm, what: str
) -> None:
    arm.writer.resume()
    getattr(arm.writer, what)()
    arm.cycle()
    assert arm.end_of(arm.send_shift()) == Outcome.REFUSED_HELD
    getattr(arm.writer, what)()
    arm.resume()
    assert arm.end_of(arm.send_shift()) == Outcome.SUCCEEDED


def test_nothing_moves_a_held_arm_but_a_resume(arm: VirtualArm) -> None:
    """Hold A, send B, cancel A: B used to begin."""
    first = arm.send_shift(0.2)
    arm.cycles(60)
    arm.hold()
    arm.until(lambda: not moves(arm))
    second = arm.send_shift(-0.1)
    assert arm.end_of(second) == Outcome.REFUSED_HELD
    arm.cancel(first)
    assert arm.end_of(first) == Outcome.CANCELED
    stands_for(arm, 1.0)
    arm.resume()
    stands_for(arm, 1.0)
    assert arm.end_of(arm.send_shift(0.05)) == Outcome.SUCCEEDED


def test_a_goal_that_arrived_while_the_arm_was_held_does_not_begin_by_the_resume(arm: VirtualArm) -> None:
    """Its client's process was still judging an older one."""
    arm.stop()
    arrived = int(arm.memory["goals"]["epoch"])
    arm.resume()
    assert arm.end_of(arm.send_shift(epoch=arrived)) == Outcome.REFUSED_OUTDATED
    stands_for(arm, 0.5)


def test_a_homing_run_that_was_asked_for_before_a_stop_does_not_begin_after_the_resume() -> None:
    arm = new_arm("episode1")
    asked = arm.request(Request.HOME, joint_mask=1)
    arm.writer.stop()
    arm.writer.resume()
    arm.cycle()
    assert arm.memory["mode"] == Mode.HOLDING
    answer = arm.reader.snapshot()["answers"][asked % layout.ANSWER_SLOTS]
    assert answer["answer"] == Answer.REFUSED_OUTDATED
    arm.close()


def test_a_spoilt_word_of_cancels_cancels_nothing(arm: VirtualArm) -> None:
    arm.command.record["canceled_through"][0] = 2**40
    assert arm.end_of(arm.send_shift()) == Outcome.SUCCEEDED


def test_a_held_goal_goes_on_from_where_it_was(arm: VirtualArm) -> None:
    goal = arm.send_shift(0.2)
    arm.cycles(60)
    arm.hold()
    arm.until(lambda: not moves(arm))
    assert arm.reader.snapshot()["goal_phase"] == Phase.PAUSED
    stands_for(arm, 1.0)
    arm.resume()
    assert arm.end_of(goal) == Outcome.SUCCEEDED


def test_a_hold_ends_a_stream_which_keeps_its_own_time(arm: VirtualArm) -> None:
    here = arm.loop[0]["axes"]["commanded"]["position_rad"][:6]
    joints = np.zeros((2, 6, 3))
    joints[:, :, 0] = here, here + 0.2
    joints[1, :, 1] = 0.1
    stream = arm.send_goal(np.array([0, 2 * NS]), joints, stream=True)
    arm.cycles(60)
    assert moves(arm)
    arm.hold()
    assert arm.end_of(stream) == Outcome.STOPPED
    arm.until(lambda: not moves(arm))
    stands_for(arm, 1.0)
    arm.resume()
    stands_for(arm, 1.0)


def test_cancels_get_through_beside_a_flood_and_beside_a_full_ring(arm: VirtualArm) -> None:
    """At 1.9 kHz of speed scales every accepted cancel used to be lost."""
    with pytest.raises(RingFull):
        while True:
            arm.request(Request.REFERENCE)
    for _ in range(12):
        goal = arm.send_shift(0.01)
        arm.cycles(20)
        for number in range(200):
            arm.writer.scale(0.5 + number / 1000)
        arm.writer.cancel(goal)
        assert arm.end_of(goal) == Outcome.CANCELED


def test_a_cancel_that_overtakes_its_goal_is_kept_for_it(arm: VirtualArm) -> None:
    arm.writer.cancel(1)
    arm.cycles(100)
    assert arm.end_of(arm.send_shift(goal_id=1)) == Outcome.CANCELED
    stands_for(arm, 0.5)


def test_a_new_ros_process_ends_what_the_old_one_left(arm: VirtualArm) -> None:
    waiting = arm.send_shift(start_ns=arm.now_ns + NS)
    arm.cycles(10)
    arm.cancel_all()
    assert arm.outcome(waiting) == Outcome.CANCELED
    assert arm.end_of(arm.send_shift()) == Outcome.SUCCEEDED


def test_a_stop_is_obeyed_in_the_next_cycle_while_somebody_holds_the_lock(arm: VirtualArm) -> None:
    arm.send_shift(0.2)
    arm.cycles(60)
    with arm.writer._threads:
        arm.stop()
    assert arm.memory["operator"]["stops"] == 1 and arm.running["reason"] == Outcome.STOPPED


def send(arm: VirtualArm, **options: object) -> None:
    arm.pending.clear()
    arm.send_shift(0.1, **options)


def enable(arm: VirtualArm) -> None:
    arm.request(Request.CLEAR_FAULT if arm.memory["mode"] == Mode.FAULT else Request.ENABLE)
    arm.cycle()
    if arm.memory["dialogue"]["bring_up_asked"] == 1:
        arm.memory["dialogue"]["bring_up_asked"] = 0
        stood_rad = arm.loop[0]["axes"]["measured"]["position_rad"][: len(arm.arm.joints)]
        arm.bring_up(mock_positions_rad=stood_rad.tolist())  # as the control process does


def fault(arm: VirtualArm) -> None:
    latch_fault(arm.loop[0], arm.state.array[0], Fault.DRIVE_FAULT, 0, 0.0, 0.0)


COMMANDS: dict[str, Callable[[VirtualArm], object]] = {
    "stop": lambda arm: arm.writer.stop(),
    "hold": lambda arm: arm.writer.hold(),
    "resume": lambda arm: arm.writer.resume(),
    "cancel": lambda arm: arm.writer.cancel(arm.writer.announced_goal),
    "slower": lambda arm: arm.writer.scale(0.3),
    "full speed": lambda arm: arm.writer.scale(1.0),
    "goal": send,
    "later goal": lambda arm: send(arm, start_ns=arm.now_ns + NS // 4),
    "old goal": lambda arm: send(arm, epoch=int(arm.memory["goals"]["epoch"]) - 1),
    "stream": functools.partial(send, stream=True),
    "disable": lambda arm: arm.request(Request.DISABLE),
    "free": lambda arm: arm.request(Request.FREE),
    "enable": enable,
    "fault": fault,
}


def watched(arm: VirtualArm, cycles: int) -> None:
    """Run cycles: no arm that stands begins to move while it is held or its drives are limp."""
    for _ in range(cycles):
        moved = moves(arm) or np.any(
            arm.loop[0]["axes"]["commanded"]["next_velocity_rad_s"]
        )  # the next setpoint is decided
        arm.cycle()
        if arm.memory["operator"]["held"] == 1 or arm.memory["mode"] in (Mode.DISABLED, Mode.FREE, Mode.FAULT):
            assert moved or not moves(arm)
        if arm.memory["operator"]["held"] == 1:
            assert arm.waiting_goal == 0


@settings(max_examples=examples(40))
@given(st.lists(st.tuples(st.sampled_from(sorted(COMMANDS)), st.integers(0, 60)), min_size=1, max_size=12))
def test_after_a_stop_the_arm_rests_in_time_and_stays_whatever_else_comes(asked: list[tuple[str, int]]) -> None:
    """From any state; while it is held nothing moves it, and every goal that was taken has one end."""
    arm = new_arm()
    for name, cycles in asked:
        COMMANDS[name](arm)
        watched(arm, cycles)
    arm.stop()
    longest = round(2.0 * NS / arm.period_ns)
    for _ in range(longest):
        arm.cycle()
    assert not moves(arm)
    stood_rad = arm.loop[0]["axes"]["commanded"]["position_rad"].copy()
    for name, cycles in asked:
        if name != "resume":
            COMMANDS[name](arm)
            arm.cycles(cycles)
    assert (arm.loop[0]["axes"]["commanded"]["position_rad"] == stood_rad).all()
    assert arm.running_goal == 0 and arm.waiting_goal == 0
    newest = int(arm.memory["front"]["newest_goal"])
    for goal in range(max(1, newest - layout.RESULT_SLOTS + 1), newest + 1):
        assert arm.outcome(goal) != Outcome.NONE
    told = list(newest_events(arm.state.array[0], layout.EVENT_SLOTS)["kind"])
    assert told.count(Event.RESULT) == told.count(Event.GOAL)
    arm.close()
