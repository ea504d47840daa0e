"""The bench test of a drive that its ordinary control process leads, in virtual time: what is planted is found."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from led_rig import LedArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.commissioning import led_checks
from rtarm.commissioning.led_checks import LedBench, checks_of, judge_answers, way_of
from rtarm.led.joint import alone
from rtloop.kept.commissioned import PowerProof
from rtloop.offline.commissioning.finding import Finding, Verdict
from shm.words import Mode, Request
from sim import faults
from sim.drives.servo import Hold

ARMS = (
    *("odrive6", "mks6", "damiao6", "damiao6_pv", "robstride6", "robstride6_position", "myactuator6", "cia402_6"),
    "vesc6",
)
TELL_THAT_THEY_ARE_LIMP = [name for name in ARMS if name != "vesc6"]
OFF_MIDDLE_DEG = 15.0
OBEY_LIMP = (("myactuator6", "limp"), ("vesc6", "limp"))
PROVING = ("damiao6", "damiao6_pv", "robstride6", "robstride6_position", "myactuator6", "cia402_6")
Plant = Callable[[Any], None]


def one_joint(name: str, encoder: str | None = None, joint: int = 1) -> ArmConfig:
    """A joint of an arm alone."""
    values = alone(load_arm(name), joint)
    if encoder is not None:
        values["joints"][0]["drive"]["encoder"] = encoder
    return ArmConfig.model_validate(values)


BENCHES: list[Bench] = []


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    while BENCHES:
        BENCHES.pop().close()


class Bench(LedArm):
    """The control process of such an arm, supervised, and a person who does what is asked."""

    def __init__(
        self, arm: ArmConfig, plant: Plant = lambda _: None, really: ArmConfig | None = None, **place: Any
    ) -> None:
        """`really` is what the drive is, where the arm file says something else."""
        middle_deg = (arm.joints[0].lower_deg + arm.joints[0].upper_deg) / 2.0
        start_rad = [math.radians(place.get("start_deg", middle_deg + OFF_MIDDLE_DEG))]
        super().__init__(arm, start_rad, really, homed=really is not None or "homed" in place)
        BENCHES.append(self)
        plant(self.drive)
        self.supervise()
        self.asked: list[str] = []
        self.questions: list[str] = []
        self.no: tuple[str, ...] = ()
        """Words of the questions that the person does not say y to."""
        self.switches = self.clamps = True
        self.bench = LedBench(self.led, self.hear, self.agree)

    def hear(self, line: str) -> None:
        self.asked.append(line)
        assert self.sim is not None
        name = self.arm.joints[0].name
        if "Switch the power" in line and self.switches:
            self.sim.inject(faults.PowerLoss(name, 0.5, 4.0), self.sim.now_ns)
        if "Pull the CAN plug" in line and self.switches:
            self.sim.inject(faults.Silent(name, 0.5, 4.0), self.sim.now_ns)

    def agree(self, question: str) -> bool:
        self.questions.append(question)
        return not any(words in question for words in self.no)

    def check(self, name: str, sign: int = 1) -> Finding:
        check = next(check for check in checks_of(self.arm) if check.name == name)
        if name != "stall" or not self.clamps:
            return self.bench.check(check, sign)[0]
        shaft = self.drive.shaft
        low, high = shaft.low, shaft.high
        self.drive.block_shaft(self.now_ns)
        found = self.bench.check(check, sign)[0]
        shaft.low, shaft.high = low, high
        return found

    def all(self) -> dict[str, Finding]:
        return {check.name: self.check(check.name) for check in checks_of(self.arm)}


@pytest.mark.parametrize("name", ARMS)
def test_an_honest_drive_is_as_documented(name: str) -> None:
    rig = Bench(one_joint(name))
    found = rig.all()
    assert not [finding.came for finding in found.values() if finding.verdict != Verdict.AS_DOCUMENTED]
    assert rig.bench.power_proof == (PowerProof.NONE if name == "mks6" else PowerProof.ABSOLUTE)
    assert rig.bench.absolute == (name != "mks6")


@pytest.mark.parametrize("name", PROVING)
def test_an_honest_drive_that_counts_from_where_power_came_proves_its_power(name: str) -> None:
    rig = Bench(one_joint(name, "incremental"))
    found = rig.all()
    assert not [finding.came for finding in found.values() if finding.verdict != Verdict.AS_DOCUMENTED]
    assert rig.bench.power_proof == PowerProof.CANARY
    assert found["unplugged"].came.startswith("its angle was kept")
    assert found["power cycle"].came.startswith("its angle was lost")


def test_an_odrive_that_counts_from_where_power_came_proves_nothing() -> None:
    rig = Bench(one_joint("odrive6", "incremental"))
    for name in ("unplugged", "power cycle"):
        found = rig.check(name)
        assert found.verdict == Verdict.AS_DOCUMENTED and found.came.startswith("its angle was lost")
    assert rig.bench.power_proof == PowerProof.NONE


def slow(drive: Any) -> None:
    drive.reply_delay_ns = (3_500_000, 3_600_000)


@pytest.mark.parametrize("name", ARMS)
def test_a_drive_that_answers_late_is_found(name: str) -> None:
    assert Bench(one_joint(name), slow).check("reply delay").verdict == Verdict.DIFFERS


def lets_go_in_silence(drive: Any, after_ns: int = 500_000_000) -> None:
    """Its watchdog is on, and nobody can turn it off."""
    took, lived = drive.take, drive.advance
    heard_ns = [0]

    def take(frame: Any) -> None:
        heard_ns[0] = drive._now_ns
        took(frame)

    def advance(now_ns: int) -> None:
        lived(now_ns)
        if drive.enabled and heard_ns[0] and now_ns - heard_ns[0] > after_ns:
            drive.release()

    drive.take, drive.advance = take, advance


@pytest.mark.parametrize("name", TELL_THAT_THEY_ARE_LIMP)
def test_a_drive_that_lets_go_in_silence_is_found(name: str) -> None:
    found = Bench(one_joint(name), lets_go_in_silence).check("silence")
    assert found.verdict == Verdict.DIFFERS and "let the joint go" in found.came


@pytest.mark.parametrize("name", TELL_THAT_THEY_ARE_LIMP)
def test_what_was_found_limp_is_neither_enabled_nor_turned_back_without_a_yes(name: str) -> None:
    rig = Bench(one_joint(name), lets_go_in_silence)
    rig.no = ("is limp", "Shall joint2 turn back")
    limp_at: list[float] = []
    lived = rig.pass_time

    def pass_time() -> None:
        lived()
        if not rig.drive.enabled:
            limp_at.append(rig.true_deg())

    rig.bench.led._pass_time = pass_time
    assert rig.check("silence").verdict == Verdict.DIFFERS and rig.bench.brakes_in_silence is False
    assert not rig.drive.enabled and len([words for words in rig.questions if "is limp" in words]) == 1
    rig.no = ("turn back",)
    assert rig.check("reply delay").verdict != Verdict.NOT_TRIED and rig.drive.enabled
    assert rig.true_deg() == pytest.approx(limp_at[0], abs=0.5)


def test_a_joint_that_sank_turns_back_after_a_question_that_says_from_where_to_where() -> None:
    rig = Bench(one_joint("damiao6"), lets_go_in_silence)
    began_deg, sunk = rig.true_deg(), False
    lived = rig.pass_time

    def pass_time() -> None:
        nonlocal sunk
        lived()
        if not rig.drive.enabled and not sunk and not rig._stands_still:  # by 20°
            sunk = rig.true_deg() < began_deg - 20.0
            rig.drive.lead(rig.now_ns, 0.0 if sunk else -80.0 / 360.0 * rig.arm.joints[0].ratio)

    rig.bench.led._pass_time = pass_time
    rig.check("silence")
    back = [words for words in rig.questions if "turn back" in words]
    assert sunk and len(back) == 1 and f"to {began_deg:.1f}°, where it began" in back[0]
    assert rig.true_deg() == pytest.approx(began_deg, abs=0.5)


def test_a_protection_that_trips_at_the_clamp_is_cleared_after_a_yes_alone() -> None:
    rig = Bench(one_joint("damiao6"))
    assert rig.sim is not None
    rig.no = ("Shall that be cleared",)
    rig.sim.inject(faults.Protection("joint2", 0.5), rig.sim.now_ns)
    found = rig.check("stall")
    assert found.verdict == Verdict.AS_DOCUMENTED and not rig.drive.enabled
    assert [words for words in rig.questions if "joint2 is limp, and is enabled where it stands" in words]


@pytest.mark.parametrize(
    ("name", "kind"),
    [(name, kind) for name in ARMS for kind in ("silent", "limp") if (name, kind) not in OBEY_LIMP],
)
def test_a_stall_that_something_else_ended_is_none(name: str, kind: str) -> None:
    """A motor that is let go is not, where its next target enables it."""
    rig = Bench(one_joint(name))
    assert rig.sim is not None
    fault = faults.Silent("joint2", 0.3, 1.5) if kind == "silent" else faults.Disabled("joint2", 0.3)
    rig.sim.inject(fault, rig.sim.now_ns)
    found = rig.check("stall")
    assert found.verdict == (Verdict.NOT_TRIED if kind == "silent" else Verdict.DIFFERS), found.came


def refuses_targets_in_motion(drive: Any) -> None:
    """As old firmware does."""
    drive._retargets = False


def keeps_its_first_target(drive: Any) -> None:
    """What comes in motion changes nothing."""
    move = drive._move
    drive._move = lambda *what: drive.shaft.law if abs(drive.shaft.speed) > 1e-3 else move(*what)


@pytest.mark.parametrize(
    ("name", "planted"), [("mks6", refuses_targets_in_motion), ("damiao6_pv", keeps_its_first_target)]
)
def test_a_drive_that_takes_no_target_in_motion_is_found(name: str, planted: Plant) -> None:
    found = Bench(one_joint(name), planted).check("retarget")
    assert found.verdict == Verdict.DIFFERS and found.figures["slow_share"] > 0.2


def test_near_a_limit_the_other_way_is_named() -> None:
    arm = one_joint("damiao6")
    rig = Bench(arm, start_deg=arm.joints[0].upper_deg - 5.0, homed=True)
    for name in ("retarget", "silence", "power cycle"):
        found = rig.check(name)
        assert found.verdict == Verdict.NOT_TRIED and "beyond its limits" in found.came and "(`o`)" in found.came
    assert rig.check("retarget", -1).verdict == Verdict.AS_DOCUMENTED


def test_what_a_person_stops_is_not_tried_and_the_next_check_is_judged_after_a_yes() -> None:
    rig = Bench(one_joint("damiao6"))
    lived, ends_ns = rig.pass_time, rig.now_ns + 1_000_000_000

    def pass_time() -> None:
        lived()
        if rig.now_ns > ends_ns:
            rig.bench.led._pass_time = lived
            rig.writer.stop()

    rig.bench.led._pass_time = pass_time
    stopped = rig.check("retarget")
    assert stopped.verdict == Verdict.NOT_TRIED and stopped.came
    rig.no = ("A person has stopped",)
    assert rig.check("silence").verdict == Verdict.NOT_TRIED
    rig.no = ()
    assert rig.check("silence").verdict == Verdict.AS_DOCUMENTED


@pytest.mark.parametrize("kind", ["silent", "power"])
def test_a_silence_amid_a_move_says_nothing_of_its_targets(kind: str) -> None:
    rig = Bench(one_joint("damiao6"))
    assert rig.sim is not None
    fault = faults.Silent("joint2", 1.0, 2.0) if kind == "silent" else faults.PowerLoss("joint2", 1.0, 2.0)
    rig.sim.inject(fault, rig.sim.now_ns)
    found = rig.check("retarget")
    assert found.verdict == Verdict.NOT_TRIED and found.came


@pytest.mark.parametrize("encoder", ["absolute", "incremental"])
@pytest.mark.parametrize("name", [name for name in PROVING if name != "myactuator6"])  # a stop enables that again
def test_a_watchdog_that_lets_go_later_than_the_silence_is_found_without_its_plug(name: str, encoder: str) -> None:
    rig = Bench(one_joint(name, encoder), lambda drive: lets_go_in_silence(drive, 2_000_000_000))
    assert rig.check("silence").verdict == Verdict.AS_DOCUMENTED
    found = rig.check("unplugged")
    assert found.verdict == Verdict.DIFFERS and "was limp when it was back" in found.came
    assert rig.bench.brakes_in_silence is False
    assert rig.bench.power_proof is (None if encoder == "absolute" else PowerProof.NONE)


def test_a_plug_that_is_said_to_be_back_and_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(led_checks, "SWITCH_PATIENCE_S", 3.0)
    rig = Bench(one_joint("damiao6"))
    assert rig.sim is not None
    rig.switches = False
    rig.sim.inject(faults.Silent("joint2", 0.5, 60.0), rig.sim.now_ns)
    found = rig.check("unplugged")
    assert found.verdict == Verdict.NOT_TRIED and found.came == "it has not answered for 3 s since your y"
    assert rig.bench.power_proof is None


def test_a_power_cycle_that_the_person_does_not_vouch_for_is_none() -> None:
    rig = Bench(one_joint("damiao6"))
    rig.no = ("Was it dark",)
    found = rig.check("power cycle")
    assert found.verdict == Verdict.NOT_TRIED and found.came.startswith("it fell silent, but not as it was asked for")


@pytest.mark.parametrize("name", ["mks6", "damiao6_pv", "myactuator6"])
def test_how_hard_it_brakes_is_told_by_its_own_encoder(name: str) -> None:
    rig = Bench(one_joint(name))
    ramp = math.degrees(rig.arm.joints[0].max_acceleration_rad_s2 * rig.arm.limits.silence_brake_factor)
    assert rig.check("silence").figures["braked_deg_s2"] == pytest.approx(ramp, rel=0.3)


@pytest.mark.parametrize(("name", "promised"), [("damiao6_pv", True), ("robstride6_position", False)])
def test_one_that_stands_far_sooner_than_its_ramp_is_found(name: str, promised: bool) -> None:
    """A family that brakes by itself in another way just gets the number."""
    rig = Bench(one_joint(name))
    lived = rig.pass_time

    def pass_time() -> None:
        lived()
        if rig._stands_still:
            rig.drive.advance(rig.now_ns)
            rig.drive.shaft.obey(Hold())

    rig.bench.led._pass_time = pass_time
    found = rig.check("silence")
    assert (found.verdict == Verdict.DIFFERS) == promised
    assert "°/s² by its own encoder" in found.came and found.figures["braked_deg_s2"] > 200.0


def test_answers_are_judged_by_the_bring_up() -> None:
    assert judge_answers(["Set."], "").verdict == Verdict.AS_DOCUMENTED
    refused = judge_answers(["The drive is another."], "The drive is another.")
    assert refused.verdict == Verdict.DIFFERS and refused.came == "The drive is another."


def arms_itself(drive: Any) -> None:
    drive.arms_itself = True


@pytest.mark.parametrize("name", ["cia402_6", "damiao6", "robstride6"])
def test_a_drive_that_power_arms_proves_nothing(name: str) -> None:
    rig = Bench(one_joint(name, "incremental"), arms_itself)
    found = rig.check("power cycle")
    assert found.verdict == Verdict.DIFFERS and rig.bench.power_proof == PowerProof.NONE
    assert found.came.startswith("its angle was kept")


def test_a_fault_that_somebody_else_clears_is_no_angle_that_was_lost() -> None:
    rig = Bench(one_joint("damiao6", "incremental"), arms_itself)

    def agrees(question: str) -> bool:
        if "Shall that be cleared" in question:
            rig.until(lambda: rig.sim is not None and rig.drive.powered)
            rig.cycles(round(0.6e9 / rig.period_ns))
            rig.request(Request.CLEAR_FAULT)
            while rig.memory["mode"] != Mode.BRINGING_UP:
                rig.pass_time()
        return True

    rig.bench._agrees = agrees
    found = rig.check("power cycle")
    assert found.verdict == Verdict.DIFFERS and found.came.startswith("its angle was kept")


@pytest.mark.parametrize("kind", ["absent", "stuck"])
def test_a_motor_without_a_true_uptime_proves_nothing(kind: str) -> None:
    rig = Bench(one_joint("myactuator6", "incremental"), lambda drive: setattr(drive, "uptime", kind))
    found = rig.check("unplugged")
    assert found.verdict == Verdict.DIFFERS and found.came.startswith("its angle was lost")
    assert (rig.bench.power_proof, rig.bench.power) == (PowerProof.NONE, found.came)
    cycled = rig.check("power cycle")
    assert cycled.came.startswith("its angle was lost") and cycled.came != found.came
    assert (rig.bench.power_proof, rig.bench.power) == (PowerProof.NONE, found.came)


def test_a_silence_of_a_joint_that_does_not_move_is_none() -> None:
    rig = Bench(one_joint("damiao6"))
    rig.drive.block_shaft(rig.now_ns)
    assert rig.check("silence").verdict == Verdict.NOT_TRIED


def stopped_amid_a_move(rig: Bench) -> None:
    """By a person, before the silence begins."""
    lived, began_deg = rig.pass_time, rig.true_deg()

    def pass_time() -> None:
        lived()
        if abs(rig.true_deg() - began_deg) > 3.0:
            rig.bench.led._pass_time = lived
            rig.writer.stop()

    rig.bench.led._pass_time = pass_time


def not_heard_in_time(rig: Bench) -> None:
    """It answers right after nobody waits for that any more."""
    says_nothing = rig.bench.led.say_nothing
    setattr(rig.bench.led, "say_nothing", lambda seconds: (says_nothing(seconds)[0], None))  # noqa: B010 (for mypy)


@pytest.mark.parametrize(
    ("befalls", "came"),
    [(stopped_amid_a_move, "it did not move when the silence began"), (not_heard_in_time, "it answers no more")],
)
def test_a_silence_that_tells_nothing_ends_where_it_began(befalls: Callable[[Bench], None], came: str) -> None:
    rig = Bench(one_joint("damiao6"))
    began_deg = rig.true_deg()
    befalls(rig)
    assert rig.check("silence").came.startswith(came)
    assert rig.true_deg() == pytest.approx(began_deg, abs=0.5)


def sinks(rig: Bench, by_deg: float) -> None:
    """As long as it has no power, in the hand of the person."""
    assert rig.sim is not None
    turns = by_deg / 360.0 * rig.arm.joints[0].ratio
    lived, led_ns = rig.pass_time, [0, 0]

    def pass_time() -> None:
        lived()
        if not rig.drive.powered and not led_ns[0]:
            led_ns[0] = rig.now_ns
            rig.drive.lead(rig.now_ns, turns)
        elif led_ns[0] and not led_ns[1] and rig.now_ns - led_ns[0] >= 1_000_000_000:
            led_ns[1] = rig.now_ns
            rig.drive.lead(rig.now_ns, 0.0)

    rig.bench.led._pass_time = pass_time


@pytest.mark.parametrize("stayed", [True, False])
def test_a_joint_that_sank_in_a_hand_makes_no_encoder_false(stayed: bool) -> None:
    """A y to both angles does."""
    rig = Bench(one_joint("damiao6"))
    sinks(rig, -5.0)
    rig.no = () if stayed else ("Did the joint itself stay",)
    found = rig.check("power cycle")
    asked = next(words for words in rig.questions if "Did the joint itself stay" in words)
    assert found.verdict == (Verdict.DIFFERS if stayed else Verdict.NOT_TRIED), found.came
    assert rig.bench.power_proof is (PowerProof.NONE if stayed else None)
    after_deg, before_deg = (float(words.rpartition(" ")[2]) for words in asked.split("°")[:2])
    assert after_deg - before_deg == pytest.approx(-5.0, abs=0.5)


@pytest.mark.parametrize("encoder", ["absolute", "incremental"])
def test_a_joint_that_sank_beyond_its_limits_proves_nothing_and_disproves_nothing(encoder: str) -> None:
    arm = one_joint("damiao6", encoder)
    rig = Bench(arm, start_deg=arm.joints[0].upper_deg - 20.0, homed=True)
    sinks(rig, 15.0)
    rig.check("power cycle")
    if encoder == "absolute":
        assert "outside its limits" in rig.bench.found["power cycle"].came
        assert rig.bench.found["power cycle"].verdict == Verdict.NOT_TRIED and rig.bench.power_proof is None
    else:  # it counts from where power came
        assert rig.bench.power_proof == PowerProof.CANARY


def test_a_fault_is_not_cleared_without_a_yes() -> None:
    rig = Bench(one_joint("damiao6"))
    rig.bench._agrees = lambda question: False
    rig.drive.disable(rig.now_ns)
    rig.until(lambda: rig.memory["mode"] == Mode.FAULT)
    assert rig.check("retarget").verdict == Verdict.NOT_TRIED
    assert not rig.drive.enabled


def test_a_joint_outside_its_limits_is_not_moved() -> None:
    arm = one_joint("damiao6")
    rig = Bench(arm, start_deg=arm.joints[0].upper_deg + 10.0, homed=True)
    found = rig.check("retarget")
    assert found.verdict == Verdict.NOT_TRIED and "outside its limits" in found.came


@pytest.mark.parametrize("name", PROVING)
def test_an_encoder_that_does_not_know_its_angle_is_found(name: str) -> None:
    rig = Bench(one_joint(name, "absolute"), really=one_joint(name, "incremental"))
    found = rig.check("power cycle")
    assert found.verdict == Verdict.DIFFERS and rig.bench.power_proof == PowerProof.NONE
    assert found.figures["away_deg"] > 10.0


@pytest.mark.parametrize("name", ARMS)
def test_a_drive_that_does_not_follow_is_found(name: str) -> None:
    rig = Bench(one_joint(name))
    rig.drive.block_shaft(rig.now_ns)
    found = rig.check("retarget")
    assert found.verdict == Verdict.DIFFERS and "joint2" in found.came


def test_a_clamp_that_gives_way_is_no_stall() -> None:
    rig = Bench(one_joint("odrive6"))
    rig.clamps = False
    found = rig.check("stall")
    assert found.verdict == Verdict.NOT_TRIED and "the clamp gave way" in found.came


def test_power_that_stays_on_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(led_checks, "SWITCH_PATIENCE_S", 3.0)
    rig = Bench(one_joint("damiao6"))
    rig.switches = False
    found = rig.check("power cycle")
    assert found.verdict == Verdict.NOT_TRIED and found.came == "its power was not switched off"
    assert rig.bench.power_proof is None
    assert rig.check("unplugged").came == "its plug was not pulled"


@pytest.mark.parametrize("name", ["odrive6", "mks6", "damiao6"])
@pytest.mark.parametrize("sign", [1, -1])
def test_no_move_is_farther_than_was_told(name: str, sign: int) -> None:
    rig = Bench(one_joint(name))
    assert rig.sim is not None
    began_rad = rig.sim.true_position_rad(0, rig.now_ns)
    farthest = 0.0
    lived = rig.pass_time

    def pass_time() -> None:
        nonlocal farthest
        lived()
        farthest = max(farthest, abs(rig.sim.true_position_rad(0, rig.now_ns) - began_rad))

    rig.bench.led._pass_time = pass_time
    for check in ("retarget", "silence"):
        rig.check(check, sign)
    assert farthest == pytest.approx(way_of(rig.arm), rel=0.02)
    assert rig.sim.true_position_rad(0, rig.now_ns) == pytest.approx(began_rad, abs=0.002)
