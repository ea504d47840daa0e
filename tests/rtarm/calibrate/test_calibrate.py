"""`rtarm calibrate`: its arithmetic, its words, the arm file it writes, and whole joints in virtual time."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrating_person import CalibratingPerson
from depth import examples
from hypothesis import Phase, assume, example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from typer.testing import Result
from virtual import START_NS, VirtualArm
from written_arm import WrittenArm

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION as TURN
from config.loader import ARMS_FOLDER, load_arm
from config.schema import ArmConfig
from rtarm.calibrate.angles import (
    FIRST_MOTOR_DEG,
    MOST_JOINT_DEG,
    nudges,
    ratio_found,
    zero_deg,
)
from rtarm.calibrate.drives import OfflineDrive
from rtarm.calibrate.guide import Guide, Values
from rtarm.calibrate.words import positive_in_words
from rtarm.console.errors import Refusal
from rtarm.console.person import Quit, agrees, number
from rtloop.drives.power import Marks
from rtloop.offline.calibration.session import MOST_RPM, MOST_TURNS, DriveState, Session
from sim.arm import SimulatedArm

# --- arithmetic -------------------------------------------------------------------------------------------------


@given(st.floats(0.01, 1000), st.floats(0.01, 3000))
def test_every_nudge_is_short_and_slow(ratio: float, motor_rpm: float) -> None:
    moves = nudges(ratio, motor_rpm)
    assert moves
    assert moves[0].motor_deg <= FIRST_MOTOR_DEG + 0.01
    assert [move.turns for move in moves] == sorted(move.turns for move in moves)
    for move in moves:
        assert 0 <= move.turns <= MOST_TURNS * 1.0001 and 1 <= move.rpm <= MOST_RPM
        assert move.rpm <= max(1, motor_rpm)
        assert move.motor_deg - MOST_JOINT_DEG * ratio <= 0.01


@given(st.integers(1, 200), st.floats(20, 360), st.floats(-0.99, 0.99), st.floats(0.5, 300))
@example(25, 90.0, 0.99, 20.0)
def test_a_ratio_is_found_or_said_to_be_unknown_but_never_taken_for_another(
    ratio: int, angle_deg: float, misread_deg: float, in_file: float
) -> None:
    """Whatever a person misreads within a degree, the true ratio is within the uncertainty that is told."""
    found = ratio_found(angle_deg / 360 * ratio, angle_deg + misread_deg, in_file)
    if math.isnan(found.measured):
        assert angle_deg + misread_deg < 20
        return
    assert abs(found.measured - ratio) <= found.uncertainty * 1.001 + 1e-3
    if found.suggestion is not None and found.suggestion != in_file:
        assert found.suggestion == ratio
    assert (found.too_small_for is None) or found.suggestion is None


def test_ratios_of_the_arm_at_ninety_degrees() -> None:
    for ratio in (25, 20, 10, 4, 1):
        found = ratio_found(ratio / 4, 90.5, in_file=7.3)
        assert found.suggestion == ratio


@pytest.mark.parametrize(
    ("angle_deg", "turns", "sentence"),
    [(10, 1.0, "is too small to tell a ratio"), (45, 24.5 / 8, "24 fits as well as 25: turn the joint by 51° or more")],
)
def test_an_angle_too_small_to_tell(angle_deg: float, turns: float, sentence: str) -> None:
    found = ratio_found(turns, angle_deg, in_file=3)
    assert found.suggestion is None
    assert sentence in str(found.too_small_for)


def test_a_ratio_that_is_no_whole_number_is_left_to_the_person() -> None:
    found = ratio_found(2.5 / 4, 90, in_file=4)
    assert found.suggestion is None and found.too_small_for is None
    assert found.measured == pytest.approx(2.5, abs=1e-3)


@given(st.sampled_from((1, -1)), st.floats(0.5, 100), st.floats(-180, 180), st.floats(-300, 300))
def test_the_zero_is_that_of_the_arm_file(direction: int, ratio: float, stands_at_deg: float, true_zero: float) -> None:
    """joint = direction * m - zero_deg (config.joint), with m the motor's turns * 360 / ratio."""
    m = direction * (stands_at_deg + true_zero)
    assert zero_deg(m * ratio / 360, ratio, direction, stands_at_deg) == pytest.approx(
        true_zero, abs=0.02 + 0.006 / ratio
    )


# --- words ----------------------------------------------------------------------------------------------------


def test_which_way_is_positive_in_words() -> None:
    """Beside the facts' flange table (episode1-arm.md 7): u1 moves it left, u2 forward and down, u3 and u5 down."""
    arm = load_arm("episode1")
    words = [positive_in_words(arm, joint) for joint in range(6)]
    assert "pointing up;" in words[0] and words[0].endswith("the flange then goes left.")
    assert "pointing left;" in words[1] and words[1].endswith("the flange then goes forward and down.")
    assert "pointing left;" in words[2] and words[2].endswith("the flange then goes down.")
    assert "pointing forward;" in words[3] and "flange" not in words[3]
    assert "pointing left;" in words[4] and words[4].endswith("the flange then goes down.")
    assert "pointing forward;" in words[5] and "flange" not in words[5]


def test_without_a_geometry_the_robot_model_says_which_way_is_positive() -> None:
    arm = load_arm("episode1").model_copy(update={"kinematics": None})
    assert "robot model (URDF)" in positive_in_words(arm, 0)


# --- whole joints, in virtual time ------------------------------------------------------------------------------


def with_joint(values: Values, joint: int, stop_deg: float | None = None) -> ArmConfig:
    """episode1 with other values of one joint, at a slow rate, which a calibration does not mind.

    A simulated joint has its homing stop at its lower limit.
    """
    fields = load_arm("episode1").model_dump(exclude_unset=True)
    fields["control"]["rate_hz"] = 25
    fields["joints"][joint].update(vars(values))
    fields["joints"][joint]["max_acceleration_rad_s2"] = 40.0 / values.ratio  # one that drives have a ramp for
    if stop_deg is not None:
        fields["joints"][joint].update(lower_deg=stop_deg, upper_deg=stop_deg + 355)
    return ArmConfig.model_validate(fields)


class Scene(CalibratingPerson):
    """An arm whose file says other things of a joint than are so, and a person who sees what truly happens."""

    def __init__(self, truth: Values, in_file: Values, joint: int = 0, *, by: str = "h", **options: Any) -> None:
        super().__init__(self, by)
        self.arm = with_joint(in_file, joint)
        self.joint = joint
        self.virtual = VirtualArm(self.arm)
        true_arm = with_joint(truth, joint, stop_deg=-truth.zero_deg)
        self.sim = SimulatedArm(true_arm, start_ns=START_NS, joint_position_rad=[0.6] * 6, **options)
        self.sim.feed(START_NS, b"C\rS6\rO\r")
        self.virtual.sim = self.sim
        self.virtual.front_alive = False
        self.virtual.cycles(2)
        self.session = Session(
            self.arm,
            self.virtual.port,
            clock_ns=lambda: self.virtual.now_ns,
            pause=self.virtual.cycle,
            rest=self.virtual.cycle,
            tell=lambda _: None,
            keep_lost=lambda _joint, _reason: None,
            marks=Marks(),
        )
        self.session.read()
        config = self.arm.joints[joint].drive
        drive = OfflineDrive(joint, config, self.session.found[joint].homing_rpm, self._order)
        self.guide = Guide(self.arm, joint, drive, self, self._require)

    def _order(self, line: str) -> DriveState:
        word, *numbers = line.split()
        dialogue: Callable[..., DriveState] = getattr(self.session, {"release": "let_go"}.get(word, word))
        return dialogue(*map(int, numbers))

    def _require(self, changes: Mapping[str, float]) -> None:
        values = self.arm.model_dump()
        values["joints"][self.joint].update(changes)
        values["joints"][self.joint]["max_acceleration_rad_s2"] = 40.0 / self.guide.values.ratio  # see with_joint
        try:
            ArmConfig.model_validate(values)
        except ValidationError as error:
            raise Refusal(str(error)) from None

    @property
    def here_deg(self) -> float:
        """Where the joint truly is."""
        self.sim.run_until(max(self.virtual.now_ns, self.sim.now_ns))
        return math.degrees(self.sim.true_position_rad(self.joint, self.sim.now_ns))

    def by_hand(self, to_deg: float) -> None:
        """The person turns the limp joint."""
        drive = self.sim.drives[self.joint]
        assert not drive.enabled
        config = self.sim.config.joints[self.joint]
        drive.advance(self.sim.now_ns)
        turned = config.direction * math.radians(to_deg - self.here_deg) * config.command_pulses_per_rad
        drive._ramp.place(drive._ramp.position + drive._grains(round(turned)))

    @property
    def true_ratio(self) -> float:
        return self.sim.config.joints[self.joint].ratio


BITS = st.sampled_from((1, -1))
TRUTHS = st.builds(Values, BITS, st.integers(1, 40).map(float), st.integers(5, 175).map(float))
IN_FILES = st.builds(Values, BITS, st.integers(1, 40).map(float), st.integers(-180, 180).map(float))


@settings(max_examples=examples(12), deadline=None, phases=(Phase.explicit, Phase.generate))
@given(truth=TRUTHS, in_file=IN_FILES, misreads_deg=st.floats(-0.9, 0.9), joint=st.integers(0, 5))
@example(Values(-1, 20.0, 170.0), Values(1, 25.0, 180.0), 0.5, 0)
@example(Values(1, 38.0, 28.0), Values(-1, 1.0, 131.0), 0.72, 3)  # no turn of this ratio is seen
@example(Values(-1, 1.0, 5.0), Values(-1, 17.0, -116.0), 0.0, 3)  # 30° towards a stop that is 39° away
def test_whatever_is_true_is_what_is_found(truth: Values, in_file: Values, misreads_deg: float, joint: int) -> None:
    scene = Scene(truth, in_file, joint, homed=False)
    scene.misreads_deg = misreads_deg
    # the file's own ratio wins where the measurement cannot tell it from the true one
    assume(in_file.ratio == truth.ratio or abs(in_file.ratio - truth.ratio) > 0.1 * truth.ratio)
    scene.guide.go()
    found = scene.guide.values
    assert (found.direction, found.ratio) == (truth.direction, truth.ratio)
    assert found.zero_deg == pytest.approx(truth.zero_deg, abs=0.02)


def test_the_same_by_the_drive_in_small_turns() -> None:
    scene = Scene(Values(-1, 4.0, 112.0), Values(1, 5.0, 90.0), 4, by="d", homed=False)
    scene.guide.go()
    assert (scene.guide.values.direction, scene.guide.values.ratio) == (-1, 4.0)
    assert scene.guide.values.zero_deg == pytest.approx(112.0, abs=0.02)
    jogs = [question for question in scene.asked if question.endswith("Turn it? [y/N, q ends]")]
    assert len(jogs) >= 4
    _, velocity_rad_s = scene.sim.truth(4, scene.sim.drives[4].shaft.changes_ns())
    assert np.max(np.abs(velocity_rad_s)) <= 30 * 2 * math.pi / 60 / 4.0 + 1e-9  # its homing run; else it is slower


def test_a_person_who_ends_it_at_any_question_leaves_the_arm_standing() -> None:
    truth, in_file = Values(-1, 5.0, 110.0), Values(1, 4.0, 90.0)
    whole = Scene(truth, in_file, 4, homed=False)
    whole.guide.go()
    for question in range(len(whole.asked)):
        scene = Scene(truth, in_file, 4, homed=False)
        scene.ends_at = question
        with pytest.raises(Quit):
            scene.guide.go()
        scene.session.close()
        stands_deg = scene.here_deg
        scene.virtual.cycles(25)
        assert scene.here_deg == stands_deg
        assert all(drive.enabled and not drive.moving for drive in scene.sim.drives)


def test_who_says_no_to_everything_moves_nothing_and_changes_nothing() -> None:
    scene = Scene(Values(-1, 5.0, 110.0), Values(1, 4.0, 90.0), 4)
    scene.answer = lambda question: ""  # type: ignore[method-assign]
    scene.guide.go()
    assert scene.guide.values == scene.guide.before
    assert all(len(drive.shaft.changes_ns()) == 1 for drive in scene.sim.drives)
    assert all(drive.enabled for drive in scene.sim.drives)
    assert not scene.sim.drives[4].homing_now


def test_a_zero_needs_a_count_that_means_something() -> None:
    scene = Scene(Values(1, 4.0, 110.0), Values(1, 4.0, 110.0), 4, homed=False)
    given_answer = scene.answer
    scene.answer = lambda question: "n" if "Home joint5 now" in question else given_answer(question)  # type: ignore[method-assign]
    scene.guide.go()
    told = " ".join(scene.told)
    assert "joint5 has lost power since it was homed, so what its drive counts is no angle." in told
    assert "Without a homing run the zero cannot be found." in told
    assert scene.guide.values.zero_deg == 110.0


def test_who_contradicts_themselves_is_asked_again() -> None:
    scene = Scene(Values(1, 25.0, 180.0), Values(1, 25.0, 180.0))
    given_answer = scene.answer
    scene.answer = lambda q: "n" if "Was that the opposite way" in q and len(scene.asked) < 8 else given_answer(q)  # type: ignore[method-assign]
    scene.guide._find_direction()
    assert "Then it is not clear yet." in scene.told
    assert scene.guide.values.direction == 1


def test_a_joint_at_its_stop_may_begin_the_other_way() -> None:
    scene = Scene(Values(1, 4.0, 110.0), Values(-1, 4.0, 110.0), 4)
    given_answer = scene.answer
    first = iter(["o"])
    scene.answer = lambda q: next(first, None) or given_answer(q) if "Turn it? [y/N; o" in q else given_answer(q)  # type: ignore[method-assign]
    scene.guide._find_direction()
    moves = [line for line in scene.told if line.endswith("and back again.")]
    assert "turns by +30.0°" in moves[0] and "turns by -30.0°" in moves[1]
    assert scene.guide.values.direction == 1
    velocity_rad_s = scene.sim.truth(4, scene.sim.drives[4].shaft.changes_ns())[1]
    assert velocity_rad_s[velocity_rad_s != 0][0] < 0


def test_who_never_sees_it_move_keeps_the_direction_of_the_file() -> None:
    scene = Scene(Values(-1, 25.0, 180.0), Values(1, 25.0, 180.0))
    given_answer = scene.answer
    scene.answer = lambda q: "u" if "Which way did" in q else given_answer(q)  # type: ignore[method-assign]
    began_deg = scene.here_deg
    scene.guide._find_direction()
    moves = [line for line in scene.told if line.endswith("and back again.")]
    assert ["30.0°" in moves[0], "60.0°" in moves[1], "120.0°" in moves[2], len(moves)] == [True, True, True, 4]
    assert scene.told[-1] == "direction stays 1."
    assert scene.here_deg == pytest.approx(began_deg, abs=0.02)


@pytest.mark.parametrize(
    ("truth", "in_file", "limits", "sentence"),
    [
        (  # as in docs/guides/calibration.md: the stop is farther out than the file says
            Values(1, 4.0, 112.5),
            Values(1, 4.0, 110.0),
            {"lower_deg": -112.5},
            "lower end of joint5, at -112.5°, but lower_deg in the file is -110: a joint that has been homed then "
            "stands outside its limits, and is not believed.",
        ),
        (
            Values(-1, 4.0, 107.5),
            Values(1, 4.0, 110.0),
            {"lower_deg": -107.5},
            "lower end of joint5, at -107.5°, but lower_deg in the file is -110: a goal beyond the stop would press",
        ),
        (Values(1, 4.0, 110.3), Values(-1, 4.0, 110.0), {}, None),
    ],
)
def test_the_limit_at_the_stop_goes_with_the_zero(
    truth: Values, in_file: Values, limits: dict[str, float], sentence: str | None
) -> None:
    scene = Scene(truth, in_file, 4, homed=False)
    scene.guide.go()
    assert scene.guide.limits == pytest.approx(limits, abs=0.02)
    told = " ".join(scene.told)
    assert sentence is None or sentence in re.sub(r"(\.\d)\d*°", r"\1°", told)
    assert ("homing stop is the" in told) == (sentence is not None)
    assert set(scene.guide.changes) - {"direction", "ratio", "zero_deg"} == set(limits)


def test_a_joint_whose_stop_is_its_upper_end_gets_its_upper_limit_there() -> None:
    """Its motor counts up from the stop, and turns it down: at the stop it is at its highest angle."""
    scene = Scene(Values(1, 4.0, 110.0), Values(1, 4.0, 110.0), 4)
    scene.guide.values = Values(-1, 4.0, -100.0)
    scene.guide._match_limit(100 * 4 / 360)  # it stands on its zero mark
    assert scene.guide.limits == {"upper_deg": 100.0}
    assert "the upper end of joint5, at 100°, but upper_deg in the file is 110" in scene.told[0]
    scene.guide.limits = {}
    scene.answer = lambda question: "n"  # type: ignore[method-assign]
    scene.guide._match_limit(100 * 4 / 360)
    assert scene.guide.limits == {}
    assert scene.told[-1] == "upper_deg stays 110: mend it by hand before you move the arm."


def test_a_new_direction_with_the_old_zero_is_warned_of() -> None:
    scene = Scene(Values(-1, 4.0, 110.0), Values(1, 4.0, 110.0), 4)
    given_answer = scene.answer
    scene.answer = lambda q: "" if "How shall" in q else given_answer(q)  # type: ignore[method-assign]
    scene.guide.go()
    assert scene.guide.changes == {"direction": -1}
    assert "zero_deg 110 was not found with these values: it is right only if joint5 is at -110° at" in scene.told[-2]
    here_deg = scene.here_deg
    assert f"would stand at {here_deg:.1f}° now, within its limits of -110° to 110°" in scene.told[-1]


def test_nothing_changed_is_nothing_to_warn_of() -> None:
    scene = Scene(Values(1, 4.0, 110.0), Values(1, 4.0, 110.0), 4)
    given_answer = scene.answer
    scene.answer = lambda q: "" if "How shall" in q else given_answer(q)  # type: ignore[method-assign]
    scene.guide.go()
    assert scene.told[-1] == "zero_deg stays 110."


def test_a_ratio_that_the_file_cannot_have_is_said_before_the_zero() -> None:
    scene = Scene(Values(1, 4.0, 110.0), Values(1, 25.0, 110.0), 4)

    def require(changes: Mapping[str, float]) -> None:
        raise Refusal(f"not valid with ratio {changes['ratio']:g}")

    scene.guide._require = require
    with pytest.raises(Refusal, match="not valid with ratio 4"):
        scene.guide.go()
    assert not any("Zero" in line for line in scene.told)
    assert scene.sim.drives[4].enabled


def test_an_angle_that_no_zero_can_have_is_asked_for_again() -> None:
    scene = Scene(Values(1, 4.0, 110.0), Values(1, 4.0, 110.0), 4, homed=False)
    given_answer = scene.answer
    typed = iter(["-50000", "50000"])
    scene.answer = lambda q: next(typed, None) or given_answer(q) if "At how many degrees" in q else given_answer(q)  # type: ignore[method-assign]
    scene.guide.go()
    assert sum("36000" in line for line in scene.told) == 2
    assert scene.guide.values.zero_deg == pytest.approx(110.0, abs=0.02)


def test_a_motor_that_did_not_turn_tells_no_ratio() -> None:
    """Both marks agreed to without a turn between them, and an angle typed all the same."""
    for turns in (0.0, 0.0001, -0.0137):
        found = ratio_found(turns, 90.0, in_file=25.0)
        assert found.suggestion is None
        assert "tells no ratio" in str(found.too_small_for)
    scene = Scene(Values(1, 4.0, 110.0), Values(1, 4.0, 110.0), 4)
    answers = iter(["d", "y", "y", "90", ""])
    scene.answer = lambda question: next(answers)  # type: ignore[method-assign]
    scene.guide._find_ratio()
    assert scene.guide.values.ratio == 4.0


def test_no_move_is_much_longer_than_those_before_it() -> None:
    """The file takes joint1 for one of ratio 25, and it is one of ratio 1: 15° by the file would be 375° of it."""
    scene = Scene(Values(1, 1.0, 180.0), Values(1, 25.0, 180.0))
    given_answer = scene.answer
    began_deg = scene.here_deg
    jogs = iter([15, 1.2, -15, -1.3, 2.4, 4.8, -1.0, 9.6, 15, -15])

    def answer(question: str) -> str:
        if "Turn it? [y/N; o" in question:
            return ""  # the direction is left out
        if "Degrees to turn" not in question:
            return given_answer(question)
        scene.asked.append(question)
        return f"{next(jogs, '')}"

    scene.answer = answer  # type: ignore[method-assign]
    scene.guide._find_direction()
    scene.guide._jogged_to("its mark")
    refused = [line.split()[0] for line in scene.told if "is no number" in line]
    assert refused == ["15", "-15"]
    most = [question.partition("±")[2].split()[0] for question in scene.asked if "±" in question]
    assert most == ["1.2", "1.2", "2.4", "2.4", "2.6", "4.8", "9.6", "9.6", "15", "15", "15"]
    moves = [float(q.partition(" turns by ")[2].split("°")[0]) for q in scene.asked if " turns by " in q]
    assert moves == [30.0, -32.5, 60.0, 120.0, -25.0, 240.0, 375.0, -375.0]
    assert scene.here_deg - began_deg == pytest.approx(sum(moves), abs=0.5)


def test_turns_that_are_no_turns_are_asked_again() -> None:
    scene = Scene(Values(1, 1.0, 30.0), Values(1, 1.0, 30.0), 5)
    jogs = iter(["nan", "16", "-15.1", "up", "1e9", "15", "y"])
    given_answer = scene.answer
    scene.answer = lambda q: next(jogs) if "Degrees to turn" in q else given_answer(q)  # type: ignore[method-assign]
    began_deg = scene.here_deg
    assert scene.guide._jogged_to("its mark") is not None
    assert [line.split()[0] for line in scene.told] == ["nan", "16", "-15.1", "up", "1e9"]
    assert scene.here_deg - began_deg == pytest.approx(15.0, abs=0.12)


def test_a_jog_beyond_the_range_is_not_done_and_the_person_goes_on() -> None:
    scene = Scene(Values(1, 1.0, 30.0), Values(1, 1.0, 30.0), 5)
    scene.session.turn(5, 0, 1)
    scene.session._centre[5] -= round(315 / 360 * TURN)
    jogs = iter(["15", "-15", ""])
    given_answer = scene.answer
    scene.answer = lambda q: next(jogs) if "Degrees to turn" in q else given_answer(q)  # type: ignore[method-assign]
    began_deg = scene.here_deg
    assert scene.guide._jogged_to("its mark") is None
    assert "its range in the arm file, 320° with a ratio of 1" in scene.told[0]
    assert scene.here_deg - began_deg == pytest.approx(-15.0, abs=0.12)


class Lines:
    """A person with prepared lines."""

    def __init__(self, *lines: str) -> None:
        self.lines = list(lines)
        self.told: list[str] = []

    def tell(self, text: str) -> None:
        self.told.append(text)

    def answer(self, question: str) -> str:
        if not self.lines:
            raise Quit("the input ended")
        return self.lines.pop(0)


@pytest.mark.parametrize("answer", ["", "n", "N", "no", "Y E S", "1", "ja", " "])
def test_anything_but_yes_is_no(answer: str) -> None:
    assert not agrees(Lines(answer), "Turn it?")
    assert agrees(Lines("y"), "Turn it?") and agrees(Lines("YES"), "Turn it?")


@pytest.mark.parametrize("answer", ["nan", "inf", "-inf", "1e999", "ninety", "9 0", "0x10"])
def test_what_is_no_number_is_asked_again(answer: str) -> None:
    person = Lines(answer, "90,5°")
    assert number(person, "Degrees?") == 90.5
    assert person.told == [f"{answer!r} is no number."]


# --- the command --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (("--joint", "joint9"), 1, "has no joint 'joint9'; it has joint1, joint2"),
        (("--channel", "/dev/nowhere"), 2, "There is no serial port /dev/nowhere"),
        (("--interface", "socketcan", "--channel", "nocan"), 2, "nocan"),
        (("--interface", "mock"), 1, "interface mock reaches no drives"),
    ],
)
def test_what_cannot_be_is_refused(
    arm_file: Path, rtarm: Callable[..., Result], options: tuple[str, ...], code: int, sentence: str
) -> None:
    before = arm_file.read_bytes()
    result = rtarm("calibrate", str(arm_file), *options)
    assert (result.exit_code, sentence in result.stderr, result.stdout) == (code, True, "")
    assert arm_file.read_bytes() == before


def test_an_arm_that_runs_is_left_alone(arm: WrittenArm, arm_file: Path, rtarm: Callable[..., Result]) -> None:
    result = rtarm("calibrate", str(arm_file))
    assert result.exit_code == 2
    assert "this arm has one already: end that first" in result.stderr


def test_the_packages_own_arms_are_not_written_to(rtarm: Callable[..., Result], tmp_path: Path) -> None:
    result = rtarm("calibrate", "episode1")
    assert (result.exit_code, "-o ./my_episode1.yaml" in result.stderr) == (1, True)
    result = rtarm("calibrate", "mock", "-o", str(tmp_path / "mine.yaml"))
    assert (result.exit_code, "has mock drives and no bus" in result.stderr) == (1, True)
    shutil.copy(ARMS_FOLDER / "episode1.yaml", tmp_path / "mine.yaml")
    result = rtarm("calibrate", "episode1", "-o", str(tmp_path / "mine.yaml"))
    assert (result.exit_code, "is there already" in result.stderr) == (1, True)
