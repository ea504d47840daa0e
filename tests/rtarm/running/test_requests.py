"""`rtarm stop` and `rtarm clear-fault` against memory files that a test answers."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable

import pytest
from typer.testing import Result
from written_arm import WrittenArm

from config.stopping import Patience
from rtarm.console.errors import ExitCode
from rtarm.running import requests
from shm.words import Answer, Fault, Mode, Phase, Request, Unreferenced

Rtarm = Callable[..., Result]


def moving(arm: WrittenArm) -> None:
    arm.snapshot["mode"], arm.snapshot["goal_id"] = Mode.EXECUTING, 3
    arm.rows["commanded_velocity_rad_s"][0] = 0.2


def test_stop_waits_until_the_arm_stands_and_needs_no_front(arm: WrittenArm, rtarm: Rtarm) -> None:
    moving(arm)
    braking = 0

    def obey(arm: WrittenArm, kind: int) -> int:
        nonlocal braking
        assert kind == Request.STOP
        arm.snapshot["mode"] = Mode.STOPPING
        braking = 30
        return Answer.DONE

    publish = arm.publish

    def brake() -> None:
        nonlocal braking
        if braking:
            braking -= 1
            if braking == 0:
                arm.snapshot["mode"], arm.snapshot["goal_id"] = Mode.HOLDING, 0
                arm.rows["commanded_velocity_rad_s"] = 0.0
        publish()

    arm.publish = brake  # type: ignore[method-assign]
    with arm.answering(obey):
        result = rtarm("stop", arm.name)
        assert arm.snapshot["mode"] == Mode.HOLDING  # it came back no earlier
    said = "stopped on its path and stands; its goal has ended. It takes no goals before `rtarm resume`."
    assert (result.exit_code, result.stdout) == (0, f"Arm {arm.name} {said}\n")


def test_stop_of_a_standing_arm_says_so(arm: WrittenArm, rtarm: Rtarm) -> None:
    with arm.answering(lambda _arm, _kind: Answer.DONE):
        result = rtarm("stop", arm.name)
    assert (result.exit_code, result.stdout) == (
        0,
        f"Arm {arm.name} stands; no goal was running. It takes no goals before `rtarm resume`.\n",
    )


@pytest.mark.parametrize(("again", "word"), [(requests.stop_again, "stop_ns"), (requests.hold_again, "hold_ns")])
def test_a_stop_or_hold_while_an_earlier_one_waits_is_asked_for_as_well(
    arm: WrittenArm, again: Callable[[str], None], word: str
) -> None:
    before_ns = 0
    for _ in range(3):
        again(arm.name)
        asked_ns = int(arm.command[word][0])
        assert asked_ns > before_ns
        before_ns = asked_ns


def test_a_hold_from_which_somebody_resumes_the_arm_is_no_alarm(
    arm: WrittenArm, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Patience, "person_s", 30.0)
    moving(arm)
    publish, looks = arm.publish, 0

    def resume_soon() -> None:
        nonlocal looks
        looks += 1
        arm.snapshot["held"] = looks < 30
        publish()

    arm.publish = resume_soon  # type: ignore[method-assign]
    with arm.answering(lambda _arm, _kind: Answer.DONE):
        result = rtarm("hold", arm.name)
    assert (result.exit_code, result.stderr) == (1, f"Arm {arm.name} was resumed before it stood.\n")


@pytest.mark.parametrize(
    ("held", "phase", "said"),
    [
        (0, Phase.RUNNING, "Arm {} is not held: goals and streams may begin."),
        (1, Phase.PAUSED, "The goal of {} goes on."),
        (1, Phase.NONE, "Arm {} takes goals again."),
    ],
)
def test_resume_says_what_it_has_done(arm: WrittenArm, rtarm: Rtarm, held: int, phase: Phase, said: str) -> None:
    arm.snapshot["held"], arm.snapshot["goal_phase"] = held, phase
    arm.publish()
    with arm.answering(lambda _arm, _kind: Answer.DONE):
        result = rtarm("resume", arm.name)
    assert (result.exit_code, result.stdout) == (0, said.format(arm.name) + "\n")


def test_stop_gives_up_on_a_control_process_that_hangs(
    arm: WrittenArm, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests, "ANSWER_PATIENCE_S", 0.05)
    result = rtarm("stop", arm.name)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "has not answered for 0.05 s, so it hangs" in result.stderr


def test_stop_gives_up_on_an_arm_that_goes_on_moving(
    arm: WrittenArm, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Patience, "person_s", property(lambda its: its.longest_stop_s + 0.05))
    arm.state["limits"]["longest_stop_s"] = 0.15
    moving(arm)
    with arm.answering(lambda _arm, _kind: Answer.DONE):
        result = rtarm("stop", arm.name)
    assert result.exit_code == 1
    assert "still moves 0.2 s after the stop was accepted: use the emergency stop" in result.stderr


def test_stop_notices_the_end_of_the_control_process(arm: WrittenArm, rtarm: Rtarm) -> None:
    moving(arm)

    def obey(arm: WrittenArm, _kind: int) -> int:
        fcntl.flock(arm.files.state.fd, fcntl.LOCK_UN)  # as by kill -9: the lock falls, the file stays
        return Answer.DONE

    with arm.answering(obey):
        result = rtarm("stop", arm.name)
    assert result.exit_code == ExitCode.LOOP_DIED
    assert "has died; the drives stop by themselves, but a homing run goes on" in result.stderr


def test_stop_tells_an_orderly_end_from_a_death(arm: WrittenArm, rtarm: Rtarm) -> None:
    moving(arm)

    def obey(arm: WrittenArm, _kind: int) -> int:
        os.unlink(arm.files.state.path)
        fcntl.flock(arm.files.state.fd, fcntl.LOCK_UN)
        return Answer.DONE

    with arm.answering(obey):
        result = rtarm("stop", arm.name)
    assert result.exit_code == ExitCode.REFUSED
    assert "has ended in order, so the arm stands: start it again with" in result.stderr


def faulty(arm: WrittenArm) -> None:
    arm.snapshot["mode"], arm.snapshot["fault"] = Mode.FAULT, Fault.STALE_READING
    arm.snapshot["fault_joint"], arm.snapshot["fault_value"], arm.snapshot["fault_limit"] = 0, 0.2, 0.1
    arm.snapshot["fault_ns"] = 1000
    arm.publish()


def test_clear_fault_without_a_fault(arm: WrittenArm, rtarm: Rtarm) -> None:
    result = rtarm("clear-fault", arm.name)
    assert result.exit_code == 0
    assert "has no latched fault, so there is nothing to clear" in result.stdout


def test_clear_fault_waits_for_the_drives_and_names_lost_references(arm: WrittenArm, rtarm: Rtarm) -> None:
    faulty(arm)

    def obey(arm: WrittenArm, kind: int) -> int:
        assert kind == Request.CLEAR_FAULT
        arm.snapshot["mode"], arm.snapshot["fault"] = Mode.HOLDING, Fault.NONE
        arm.rows["referenced"][1] = 0
        arm.rows["unreferenced_reason"][1] = Unreferenced.SILENT
        return Answer.DONE

    with arm.answering(obey):
        result = rtarm("clear-fault", arm.name)
    assert result.exit_code == 0
    assert f"The fault is cleared; arm {arm.name} holds where it stands." in result.stdout
    assert "The drive of elbow was silent for too long" in result.stdout


def test_a_fault_that_comes_back_is_said(arm: WrittenArm, rtarm: Rtarm) -> None:
    faulty(arm)

    def obey(arm: WrittenArm, _kind: int) -> int:
        arm.snapshot["fault"], arm.snapshot["fault_ns"] = Fault.WIRE, 2000
        return Answer.DONE

    with arm.answering(obey):
        result = rtarm("clear-fault", arm.name)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "The fault was cleared and came back. The CAN adapter is gone or refuses" in result.stderr


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (Answer.REFUSED_MODE, "is being cleared already: wait until `rtarm status` says holding, or fault again."),
        (
            Answer.REFUSED_MOVING,
            "braking after the fault, which takes 1.5 s at most: wait until it stands, then",
        ),
        (Answer.REFUSED_WIRE, "The CAN adapter is not there"),
    ],
)
def test_a_refused_clear_says_what_to_wait_for(arm: WrittenArm, rtarm: Rtarm, answer: Answer, said: str) -> None:
    arm.state["limits"]["longest_stop_s"] = 1.5
    faulty(arm)
    with arm.answering(lambda _arm, _kind: answer):
        result = rtarm("clear-fault", arm.name)
    assert result.exit_code == 1
    assert said in result.stderr


def homed(arm: WrittenArm, rtarm: Rtarm, *joints: str) -> Result:
    """`rtarm home` of an arm whose control process has nothing to do for it, or ends it at once."""
    with arm.answering(lambda _arm, _kind: Answer.DONE):
        return rtarm("home", *joints, "--arm", arm.name)


def test_joints_whose_drives_know_their_angle_need_no_homing(arm: WrittenArm, rtarm: Rtarm) -> None:
    for named in ((), ("elbow",), ("shoulder", "elbow")):
        result = homed(arm, rtarm, *named)
        assert (result.exit_code, result.stdout.strip()) == (
            0,
            f"Arm {arm.name} holds where it stands; no drive of these joints finds a stop.",
        )
    arm.rows["referenced"][1] = 0
    arm.rows["unreferenced_reason"][1] = Unreferenced.INCREMENTAL
    result = homed(arm, rtarm, "elbow")
    assert (
        result.exit_code == 1
        and "elbow has no homing run: say where the joint stands with `rtarm reference elbow=DEGREES`" in result.stderr
    )


def test_a_run_that_never_began_is_told_of_joints_that_home(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.state["limits"]["joints"]["homes"][0] = 1
    assert homed(arm, rtarm, "elbow").exit_code == 0
    result = homed(arm, rtarm, "shoulder", "elbow")
    assert result.exit_code == 1
    assert "ended before it had come to the end with shoulder." in result.output


def test_nothing_is_referenced_amid_a_fault_and_the_fault_is_said(arm: WrittenArm, rtarm: Rtarm) -> None:
    faulty(arm)

    def asked(_arm: WrittenArm, _kind: int) -> int:
        raise AssertionError("a request was made")

    with arm.answering(asked):
        result = rtarm("reference", "shoulder", "--arm", arm.name)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "A fault is latched, clear it first: shoulder has given no believable answer" in result.stderr
