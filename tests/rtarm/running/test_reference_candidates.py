"""`rtarm reference --all`: what is shown, what is asked, and what is asked of the control process."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import pytest
from typer.testing import Result
from written_arm import JOINTS, WrittenArm

from rtarm.console.errors import Refusal
from rtarm.console.person import Quit, Terminal
from rtarm.running import referencing
from rtloop.kept.reference_store import COUNTS_FROM_NOWHERE
from shm.layout import REQUEST_SLOTS
from shm.words import Answer, Fault, Mode, Request, Unreferenced

Rtarm = Callable[..., Result]

ANGLES_DEG = (20.0, -35.5)


class ControlProcess:
    """Takes joints to stand where they read, as the real one does, and notes what it was asked for."""

    def __init__(self, arm: WrittenArm) -> None:
        self.arm = arm
        self.asked: list[str] = []
        arm.rows["measured_position_rad"] = [math.radians(angle) for angle in ANGLES_DEG]
        arm.publish()

    def lose(self, *reasons: Unreferenced) -> None:
        self.arm.rows["referenced"] = [reason == Unreferenced.REFERENCED for reason in reasons]
        self.arm.rows["unreferenced_reason"] = reasons
        self.arm.publish()

    def __call__(self, arm: WrittenArm, kind: int) -> int:
        assert kind == Request.REFERENCE
        request = arm.command["requests"][(int(arm.command["requests_written"][0]) - 1) % REQUEST_SLOTS]
        assert math.isnan(request["value"])
        joint = int(request["joint_mask"]).bit_length() - 1
        assert int(request["joint_mask"]) == 1 << joint
        self.asked.append(JOINTS[joint])
        return self.answer(joint)

    def answer(self, joint: int) -> int:
        if int(self.arm.rows["unreferenced_reason"][joint]) in COUNTS_FROM_NOWHERE:
            return Answer.REFUSED_VALUE
        self.arm.rows["referenced"][joint] = 1
        return Answer.DONE


@pytest.fixture
def control(arm: WrittenArm) -> ControlProcess:
    return ControlProcess(arm)


@pytest.fixture
def questions(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a person at a terminal is asked, who always says yes."""
    asked: list[str] = []

    def answer(_: Terminal, question: str) -> str:
        asked.append(question)
        return "y"

    monkeypatch.setattr(Terminal, "answer", answer)
    return asked


def test_the_angles_are_shown_and_taken_after_one_question(
    control: ControlProcess, rtarm: Rtarm, questions: list[str]
) -> None:
    control.lose(Unreferenced.SILENT, Unreferenced.MOVED)
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all")
    assert result.exit_code == 0, result.output
    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    assert "shoulder 20.00 The drive of shoulder was silent for too long" in lines
    assert "elbow -35.50 elbow does not stand where it stood when rtarm was ended" in lines
    assert lines[-1] == "Taken: shoulder 20.00°, elbow -35.50°."
    assert questions == ["Look at the arm: do they stand there (shoulder, elbow)? [y/N, q ends]"]
    assert control.asked == ["shoulder", "elbow"]


@pytest.mark.parametrize("answer", ["", "n", "maybe", None])
def test_nothing_is_taken_that_nobody_agreed_to(
    control: ControlProcess, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch, answer: str | None
) -> None:
    def answers(_: Terminal, __: str) -> str:
        if answer is None:
            raise Quit("the input ended")
        return answer

    monkeypatch.setattr(Terminal, "answer", answers)
    control.lose(Unreferenced.SILENT, Unreferenced.SILENT)
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all")
    assert result.exit_code == 1
    assert "Nothing was done" in result.stderr
    assert control.asked == []


@pytest.mark.parametrize("elbow", [Unreferenced.REFERENCED, Unreferenced.SILENT, Unreferenced.POWER_LOST])
@pytest.mark.parametrize("shoulder", Unreferenced)
def test_whatever_the_reasons_only_what_may_stand_there_is_taken_and_the_rest_is_told(
    control: ControlProcess, rtarm: Rtarm, shoulder: Unreferenced, elbow: Unreferenced
) -> None:
    control.lose(shoulder, elbow)
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all", "--yes")
    reasons = dict(zip(JOINTS, (shoulder, elbow), strict=True))
    lost = [joint for joint, why in reasons.items() if why != Unreferenced.REFERENCED]
    assert control.asked == [joint for joint in lost if reasons[joint] in referencing.MAY_STAND_WHERE_READ]
    left = [joint for joint in lost if joint not in control.asked]
    assert (result.exit_code == 0) == (not left), result.output
    assert control.arm.rows["referenced"].tolist() == [joint not in left for joint in JOINTS]
    for joint in JOINTS:
        assert (f"{joint}=DEGREES" in result.stderr) == (joint in left)
        assert (f"{joint} - " in " ".join(result.stdout.split())) == (joint in left)


def test_a_count_from_nowhere_is_never_offered() -> None:
    assert not COUNTS_FROM_NOWHERE & referencing.MAY_STAND_WHERE_READ


def test_of_an_arm_that_counts_from_nowhere_nobody_is_asked_and_the_next_commands_are_told(
    control: ControlProcess, rtarm: Rtarm, questions: list[str]
) -> None:
    control.arm.state["limits"]["joints"]["homes"][1] = 1
    control.lose(Unreferenced.POWER_LOST, Unreferenced.NOT_HOMED)
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all")
    assert (result.exit_code, questions, control.asked) == (1, [], [])
    assert result.stderr == (
        "The count of shoulder, elbow is no angle: `rtarm home elbow`, or `rtarm reference shoulder=DEGREES "
        "elbow=DEGREES` if you can tell the angle.\n"
    )


def test_an_arm_that_lacks_nothing_is_left_alone(control: ControlProcess, rtarm: Rtarm, questions: list[str]) -> None:
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all")
    assert (result.exit_code, questions, control.asked) == (0, [], [])
    assert result.stdout == f"All joints of arm {control.arm.name} are referenced.\n"


def test_a_drive_that_was_never_read_stands_nowhere(control: ControlProcess) -> None:
    control.lose(Unreferenced.SILENT, Unreferenced.SILENT)
    control.arm.publish(read=False)
    assert [reading.stands_deg for reading in referencing.readings(control.arm.name)] == [None, None]


def test_a_refusal_of_the_control_process_is_told_of_its_joint_and_the_others_are_taken(
    control: ControlProcess, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    control.lose(Unreferenced.SILENT, Unreferenced.SILENT)
    usual = control.answer
    monkeypatch.setattr(control, "answer", lambda joint: Answer.REFUSED_MOVING if joint == 0 else usual(joint))
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all", "--yes")
    assert (result.exit_code, control.asked) == (1, ["shoulder", "elbow"])
    taken, refused = result.stderr.splitlines()
    assert taken == "Taken: elbow -35.50°."
    assert refused.startswith("shoulder was not taken: The arm is moving")


def test_a_fault_amid_it_is_told_and_nothing_more_is_tried(
    control: ControlProcess, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    control.lose(Unreferenced.SILENT, Unreferenced.SILENT)

    def fail(joint: int) -> int:
        control.arm.snapshot["mode"], control.arm.snapshot["fault"] = Mode.FAULT, Fault.HOMING
        control.arm.snapshot["fault_joint"] = joint
        return Answer.DONE

    monkeypatch.setattr(control, "answer", fail)
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all", "--yes")
    assert (result.exit_code, control.asked) == (1, ["shoulder"])
    refused, after = result.stderr.splitlines()
    assert refused.startswith("shoulder was not taken: shoulder was not homed")
    assert after == "elbow was not tried after that."


def test_what_is_taken_is_what_was_seen(control: ControlProcess) -> None:
    """Between the question and its answer lies as long as somebody likes."""
    arm = control.arm
    control.lose(Unreferenced.SILENT, Unreferenced.SILENT)
    shown = referencing.readings(arm.name)
    arm.rows["measured_position_rad"][0] += math.radians(referencing.AS_SHOWN_DEG + 0.1)
    control.lose(Unreferenced.SILENT, Unreferenced.POWER_LOST)
    with arm.answering(control), pytest.raises(Refusal) as refusal:
        referencing.take(arm.name, shown)
    moved, lost = refusal.value.sentence.splitlines()
    assert moved.startswith("shoulder was not taken: it reads 20.60°, and read 20.00° when you were asked")
    assert lost == "elbow was not taken: The drive of elbow may have lost power."
    assert control.asked == []


def test_what_somebody_else_has_referenced_meanwhile_is_left_alone(control: ControlProcess) -> None:
    control.lose(Unreferenced.SILENT, Unreferenced.SILENT)
    shown = referencing.readings(control.arm.name)
    control.lose(Unreferenced.REFERENCED, Unreferenced.SILENT)
    with control.arm.answering(control):
        assert referencing.take(control.arm.name, shown) == "Taken: elbow -35.50°."
        assert "are referenced" in referencing.take(control.arm.name, shown)
    assert control.asked == ["elbow"]


@pytest.mark.parametrize(
    ("mode", "fault", "said"),
    [
        (
            Mode.FAULT,
            Fault.STALE_READING,
            "A fault is latched, clear it first: shoulder has given no believable answer",
        ),
        (Mode.FREE, Fault.NONE, "cannot do this in its present mode"),
    ],
)
def test_nobody_is_asked_for_what_cannot_be_taken_now(
    control: ControlProcess, rtarm: Rtarm, questions: list[str], mode: Mode, fault: Fault, said: str
) -> None:
    control.arm.snapshot["mode"], control.arm.snapshot["fault"] = mode, fault
    control.lose(Unreferenced.SILENT, Unreferenced.SILENT)
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all")
    assert (result.exit_code, questions, control.asked) == (1, [], [])
    assert said in result.stderr


def test_a_script_says_that_somebody_has_looked(control: ControlProcess, rtarm: Rtarm) -> None:
    control.lose(Unreferenced.SILENT, Unreferenced.REFERENCED)
    with control.arm.answering(control):
        result = rtarm("reference", "--arm", control.arm.name, "--all")
    assert (result.exit_code, control.asked) == (1, [])
    assert "give --yes in a script" in result.stderr


def test_who_wants_json_is_asked_nothing_in_between(
    control: ControlProcess, rtarm: Rtarm, questions: list[str]
) -> None:
    control.lose(Unreferenced.SILENT, Unreferenced.REFERENCED)
    with control.arm.answering(control):
        unseen = rtarm("reference", "--arm", control.arm.name, "--all", "--json")
        assert (unseen.exit_code, control.asked, questions) == (1, [], [])
        assert "give --yes" in json.loads(unseen.stdout)["problems"][0]
        result = rtarm("reference", "--arm", control.arm.name, "--all", "--yes", "--json")
    assert json.loads(result.stdout) == {"arm": control.arm.name, "done": True, "said": "Taken: shoulder 20.00°."}
    assert questions == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "Name the joints"),
        (("shoulder", "--all"), "one of the two"),
        (("shoulder", "--yes"), "--yes answers what --all asks"),
    ],
)
def test_words_that_mean_nothing_together_are_refused(
    control: ControlProcess, rtarm: Rtarm, words: tuple[str, ...], said: str
) -> None:
    result = rtarm("reference", *words)
    assert result.exit_code == 1
    assert said in result.stderr
