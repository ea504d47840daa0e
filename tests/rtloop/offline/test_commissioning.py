"""The bench test of one drive, beside simulated drives in virtual time: what is planted is found, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mixed_arm import mixed
from virtual import VirtualArm

from config.loader import load_arm
from config.ramp import nearest_usable_acceleration_rad_s2
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives import zdt_talk
from rtloop.drives.power import Marks
from rtloop.drives.zdt_ask import Ask
from rtloop.kept.commissioned import PowerProof
from rtloop.offline.calibration.session import NotDone
from rtloop.offline.calibration.zdt import Drive
from rtloop.offline.commissioning import zdt_checks
from rtloop.offline.commissioning import zdt_talk as zdt_talk_of_the_bench
from rtloop.offline.commissioning.finding import Finding, Verdict, braking_rev_s2
from rtloop.offline.commissioning.session import Bench, checks_of
from rtloop.offline.commissioning.zdt_talk import Ran, trial_of
from rtloop.service.conversation import DialogueFailed
from shm.recording import now_at, read_on
from shm.words import Unreferenced
from sim import faults

NAMES = [check.name for check in checks_of(load_arm("episode1"), 0)]


class Trial:
    """An arm nobody has brought up, a person who does what is asked, and one drive's checks."""

    def __init__(self, joint: int = 0, plant: Callable[[Any], None] = lambda _: None, **options: Any) -> None:
        self.joint = joint
        self.virtual = VirtualArm(load_arm("episode1"), **options)
        self.virtual.front_alive = False
        self.virtual.cycles(3)
        assert self.virtual.sim is not None
        self.sim = self.virtual.sim
        self.drive: Any = self.sim.drives[joint]
        plant(self.drive)
        self._since = now_at(self.virtual.state)
        self.told: list[str] = []
        self.lost: dict[int, Unreferenced | None] = {}
        self.switches = True
        self.bench = Bench(
            self.virtual.arm,
            self.virtual.port,
            clock_ns=lambda: self.virtual.now_ns,
            pause=self.virtual.cycle,
            rest=self.virtual.cycle,
            tell=self._hear,
            keep_lost=self.lost.__setitem__,
            marks=Marks(),
            recorded=self._recorded,
        )
        self.bench.read()

    def _recorded(self) -> np.ndarray:
        recording, self._since = read_on(self.virtual.state, self._since)
        return recording.frames

    def _hear(self, line: str) -> None:
        self.told.append(line)
        if "Switch the power" in line and self.switches:
            name = self.virtual.arm.joints[self.joint].name
            self.sim.inject(faults.PowerLoss(name, 0.5, 4.0), self.sim.now_ns)

    def check(self, name: str, sign: int = 1) -> list[Finding]:
        if name != "stall":
            return self.bench.check(name, self.joint, sign)
        shaft, low, high = self.drive.shaft, self.drive.shaft.low, self.drive.shaft.high
        self.drive.block_shaft(self.sim.now_ns)
        found = self.bench.check(name, self.joint, sign)
        shaft.low, shaft.high = low, high
        return found

    def all(self) -> dict[str, Finding]:
        return {finding.check: finding for name in NAMES for finding in self.check(name)}


def differing(found: dict[str, Finding]) -> set[str]:
    return {name for name, finding in found.items() if finding.verdict == Verdict.DIFFERS}


@pytest.mark.parametrize("joint", [0, 3, 5])
def test_an_honest_drive_is_as_documented(joint: int) -> None:
    trial = Trial(joint)
    found = trial.all()
    assert {finding.verdict for finding in found.values()} == {Verdict.AS_DOCUMENTED}
    record = trial.bench.record(joint)
    assert record.power_proof == PowerProof.FLAG and record.heals
    assert record.power == "read 0 before, seen 1 after the power cycle, cleared, read 0"
    assert record.fast_targets and record.reports and record.retargets
    assert trial.lost == {joint: Unreferenced.POWER_LOST}


def test_a_drive_of_older_firmware_is_as_documented_and_has_the_canary() -> None:
    trial = Trial(firmware="old")
    found = trial.all()
    not_tried = {name for name, finding in found.items() if finding.verdict == Verdict.NOT_TRIED}
    assert differing(found) == set() and not_tried == {"fast targets", "reports"}
    record = trial.bench.record(0)
    assert record.power_proof == PowerProof.CANARY and record.heals and record.fast_targets is None
    assert "firmware 1.2.5" in found["answers"].came and record.firmware == "1.2.5"


def plant(**values: Any) -> Callable[[Any], None]:
    """A drive with other attributes."""
    return lambda drive: [setattr(drive, name, value) for name, value in values.items()]


def tells_a_shorter_stall_time(drive: Any) -> None:
    """It trips later than its configuration says."""
    drive._read_settings = lambda: b"\x42\x21\x15" + replace(drive.settings, stall_ms=1000).pack()


def restarts_its_ramp(drive: Any) -> None:
    """It takes each new target from standstill."""
    move = drive._move

    def from_rest(*arguments: int) -> int:
        drive._ramp.place(drive._ramp.position)
        return int(move(*arguments))

    drive._move = from_rest


FLAG, VOLATILE = "power flag", "volatile settings"
PLANTED = {
    "flag absent": (plant(power_flag="absent"), {FLAG}, "seen 0 after the power cycle", PowerProof.CANARY),
    "flag 0 at boot": (plant(power_flag="unset"), {FLAG}, "seen 0 after the power cycle", PowerProof.CANARY),
    "flag stuck": (plant(power_flag="stuck"), {FLAG}, "cleared, read 1", PowerProof.CANARY),
    "not volatile": (plant(stores_everything=True), {VOLATILE}, "time-out still there", PowerProof.FLAG),
    "no proof at all": (
        plant(stores_everything=True, power_flag="stuck"),
        {FLAG, VOLATILE},
        "cleared, read 1",
        PowerProof.NONE,
    ),
    "ramp twice as hard": (plant(ramp_steepness=2), {"silence"}, "× the documented ramp", PowerProof.FLAG),
    "slow replies": (
        plant(reply_delay_ns=(5_200_000, 5_400_000)),
        {"reply delay"},
        "beside the wires 5.",
        PowerProof.FLAG,
    ),
    "FC is relative": (plant(fast_is_relative=True), {"fast targets"}, "for amounts to go", PowerProof.FLAG),
    "reports at half the rate": (plant(report_clock=2.0), {"reports"}, "although it was told", PowerProof.FLAG),
    "another block": (plant(foreign=True), {"answers"}, "configuration (42)", PowerProof.FLAG),
    "ramp from rest": (restarts_its_ramp, {"retarget"}, "never slower than", PowerProof.FLAG),
    "stalls too long": (tells_a_shorter_stall_time, {"stall"}, "after 3.5 s", PowerProof.FLAG),
}


@pytest.mark.parametrize("name", PLANTED)
def test_what_is_planted_is_found_named_and_withheld(name: str) -> None:
    planted, wanted, words, proof = PLANTED[name]
    trial = Trial(plant=planted)
    found = trial.all()
    assert differing(found) == wanted
    assert words in found[next(iter(sorted(wanted)))].came
    record = trial.bench.record(0)
    assert record.power_proof == proof
    assert record.heals == (proof != PowerProof.NONE and not {"silence", "retarget"} & wanted)
    assert record.fast_targets == ("fast targets" not in wanted) and record.reports == ("reports" not in wanted)


def test_firmware_that_refuses_a_new_target_in_motion_is_found() -> None:
    trial = Trial(retarget="reject")
    found = trial.all()
    assert differing(found) == {"retarget"}
    assert "it refused the second target (E2) and stood after 225° of 375°" in found["retarget"].came
    assert trial.bench.record(0).retargets is False


def test_a_motor_that_refuses_every_motion_is_found() -> None:
    trial = Trial(plant=plant(refuses=True))
    assert trial.check("silence")[0].verdict == Verdict.DIFFERS
    assert trial.check("retarget")[0].verdict == Verdict.DIFFERS


@pytest.mark.parametrize("way", [1, -1])
def test_every_move_goes_the_way_that_was_asked_for_and_comes_back(way: int) -> None:
    trial = Trial(2)
    for name in ("silence", "retarget"):
        start = trial.drive.position_counts
        before_ns = trial.sim.now_ns
        assert trial.check(name, way)[0].good
        changes = trial.drive.shaft.changes_ns()
        turns, rpm = trial.drive.shaft.history(changes[changes > before_ns])
        limit = trial_of(trial.virtual.arm, 2)
        reach = (turns - trial.drive.shaft.past(before_ns)[0]) * way
        assert np.max(reach) == pytest.approx(limit.turns, abs=2e-3) and np.min(reach) > -2e-3
        assert np.max(np.abs(rpm)) <= limit.rpm
        assert abs(trial.drive.position_counts - start) <= 200


@given(
    ratio=st.floats(0.5, 200), range_deg=st.floats(1, 600), motor_rpm=st.floats(1, 3000), factor=st.floats(1.0, 100.0)
)
def test_no_move_is_long_or_fast(ratio: float, range_deg: float, motor_rpm: float, factor: float) -> None:
    """Whatever the arm file says: no farther than 15° of the joint, two turns, a quarter of its range; 60 rpm."""
    arm = load_arm("episode1")
    joint = arm.joints[0].model_copy(
        update={
            "ratio": ratio,
            "lower_deg": 0.0,
            "upper_deg": range_deg,
            "motor_rpm": motor_rpm,
            "max_acceleration_rad_s2": nearest_usable_acceleration_rad_s2(ratio, factor * 40.0 / ratio),
        }
    )
    move = trial_of(arm.model_copy(update={"joints": [joint, *arm.joints[1:]]}), 0)
    assert move.turns <= 2.001 and move.turns * 360 / ratio <= min(15.0, range_deg / 4) + 0.01
    assert 1 <= move.rpm <= max(1.0, min(60.0, motor_rpm))
    assert 1 <= move.acc_byte <= 255


class Cut(Exception):
    """The person wants no more."""


def cut_after(trial: Trial, seconds: float) -> None:
    """Let the person want no more after so long."""
    ends_ns = trial.virtual.now_ns + round(seconds * 1e9)

    def pause() -> None:
        trial.virtual.cycle()
        if trial.virtual.now_ns > ends_ns:
            raise Cut

    trial.bench._pause = pause


@pytest.mark.parametrize("name", ["silence", "retarget", "stall"])
@pytest.mark.parametrize("after_s", [0.4, 1.0, 2.6])
def test_whatever_ends_a_move_early_stops_it(name: str, after_s: float) -> None:
    trial = Trial()
    cut_after(trial, after_s)
    with pytest.raises(Cut):
        trial.check(name)
    trial.virtual.cycles(5)
    stood = trial.drive.position_counts
    trial.virtual.cycles(240)
    assert trial.drive.position_counts == stood and not trial.drive.moving


@pytest.mark.parametrize(("after_s", "switches"), [(0.3, True), (2.0, True), (2.0, False)])
def test_whatever_ends_a_power_cycle_early_puts_back_what_was_changed(after_s: float, switches: bool) -> None:
    trial = Trial()
    trial.switches = switches
    before = trial.drive.settings, trial.drive.homing
    cut_after(trial, after_s)
    with suppress(Cut):  # one that is dark meanwhile is told of
        trial.check("power cycle")
    trial.virtual.cycles(600)  # it has power again
    assert (trial.drive.settings, trial.drive.homing) == before


@pytest.mark.parametrize("name", ["silence", "retarget", "stall"])
def test_a_joint_whose_angle_is_known_is_not_turned_beyond_its_limits(name: str) -> None:
    upper_rad = load_arm("episode1").joints[0].upper_rad
    trial = Trial(start_rad=[upper_rad - 0.005, 0.0, 0.0, 0.0, 0.0, 0.0])
    stood = trial.drive.position_counts
    sign = 1 if load_arm("episode1").joints[0].direction > 0 else -1
    refused = trial.check(name, sign)[0]
    assert refused.verdict == Verdict.NOT_TRIED and "beyond its limits" in refused.came and "(`o`)" in refused.came
    assert trial.drive.position_counts == stood
    assert trial.check(name, -sign)[0].verdict == Verdict.AS_DOCUMENTED


def test_a_joint_whose_angle_is_not_known_has_no_limits() -> None:
    trial = Trial(homed=False, start_rad=[load_arm("episode1").joints[0].upper_rad, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert all(trial.check("retarget", sign)[0].verdict == Verdict.AS_DOCUMENTED for sign in (1, -1))


def test_a_drive_is_seen_to_stand_and_to_hold_its_joint_at_the_end() -> None:
    trial = Trial()
    trial.bench.checks(0)
    trial.bench.see_it_stand()
    trial.drive.disable(trial.sim.now_ns)
    with pytest.raises(DialogueFailed, match="joint1 is limp"):
        trial.bench.see_it_stand()


def test_a_drive_that_never_held_its_joint_need_only_be_seen_to_stand() -> None:
    trial = Trial(plant=lambda drive: drive.disable(0))
    trial.bench.checks(0)
    trial.bench.see_it_stand()
    trial.bench.hold(0)
    trial.bench.see_it_stand()
    trial.drive.disable(trial.sim.now_ns)
    with pytest.raises(DialogueFailed, match="joint1 is limp"):
        trial.bench.see_it_stand()


def test_what_was_seen_of_a_power_cycle_is_kept_where_nothing_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    def put_back(drive: Drive, _: object) -> Iterator[Ask]:
        yield Ask(protocol.ASK_STATUS, (3,))
        raise drive.fails("It is not put back.")

    monkeypatch.setattr(zdt_talk_of_the_bench, "put_back", put_back)
    trial = Trial(plant=PLANTED["no proof at all"][0])
    found = trial.check("power cycle")
    assert [finding.check for finding in found] == ["power flag", "volatile settings", "put back"]
    assert (found[-1].came, found[-1].verdict) == ("It is not put back.", Verdict.NOT_TRIED)
    record = trial.bench.record(0)
    assert record.power_proof == PowerProof.NONE and "cleared, read 1" in record.power


def test_a_drive_that_keeps_its_power_tells_nothing_of_its_loss() -> None:
    trial = Trial()
    trial.switches = False
    found = trial.check("power cycle")
    assert [finding.verdict for finding in found] == [Verdict.NOT_TRIED, Verdict.NOT_TRIED]
    assert trial.bench.record(0).power_proof is None and trial.lost == {}


def test_a_loss_too_short_to_be_seen_is_not_forgotten() -> None:
    """Its flag is cleared by the check, so what it said must be kept first."""
    trial = Trial()
    trial.switches = False
    trial.sim.inject(faults.PowerLoss("joint1", 1.0, 0.1), trial.sim.now_ns)
    trial.check("power cycle")
    assert trial.lost == {0: Unreferenced.POWER_LOST}


def test_a_flag_that_stands_is_kept_before_it_is_cleared() -> None:
    trial = Trial(homed=False)
    trial.switches = False
    trial.check("power cycle")
    assert not trial.drive.power_lost and trial.lost == {0: Unreferenced.POWER_LOST}


def test_a_clamp_that_gives_way_tells_nothing() -> None:
    trial = Trial()
    finding = trial.bench.check("stall", 0, 1)[0]
    assert finding.verdict == Verdict.NOT_TRIED and "gave way" in finding.came
    assert finding.figures["moved_deg"] < 12.0


def test_what_cannot_be_tried_is_said_and_the_next_check_goes_on() -> None:
    trial = Trial()
    trial.drive.disable(trial.sim.now_ns)
    finding = trial.check("retarget")[0]
    assert finding.verdict == Verdict.NOT_TRIED and "is limp" in finding.came
    assert trial.check("reply delay")[0].good


@given(
    speed=st.floats(0.1, 2.0),
    brakes_s=st.floats(0.12, 1.0),
    each_s=st.floats(0.005, 0.02),
    phase=st.floats(0.0, 1.0),
    harder=st.sampled_from((1.0, 0.5, 2.0, 4.0)),
)
def test_how_hard_a_motor_brakes_is_measured_from_its_own_positions(
    speed: float, brakes_s: float, each_s: float, phase: float, harder: float
) -> None:
    told = speed / brakes_s
    true = told * harder
    way = speed**2 / told * 3.0
    cruise_s = (way - speed**2 / (2 * true)) / speed
    times = np.arange(phase * each_s, cruise_s + speed / true + 0.2, each_s)
    late = np.clip(times - cruise_s, 0.0, speed / true)
    places = speed * np.minimum(times, cruise_s) + speed * late - true / 2 * late**2
    measured = braking_rev_s2(np.column_stack((times, places)), way, told, speed)
    if measured is None:
        assert harder > 1.0 and 0.7 * speed / true < 4 * each_s  # it brakes within less than four readings
    else:
        assert measured / told == pytest.approx(harder, rel=0.2)


def test_a_family_without_checks_says_so() -> None:
    with pytest.raises(NotDone, match="joint2 has an ODrive axis, and there are no checks for its family yet"):
        checks_of(mixed(), 1)
    assert len(checks_of(mixed(), 0)) == len(NAMES)


def test_a_drive_that_lost_its_power_does_not_get_a_mark_of_before_back() -> None:
    """With it the next control process would believe an angle that is gone (`rtloop.drives.power`)."""
    trial = Trial(0)
    mark = trial.bench.have(0, lambda drive: zdt_talk.mark(drive.now_ns()))
    trial.check("power cycle")
    after = trial.bench.have(0, lambda drive: zdt_talk.read_homing())
    assert after is not None and str(after.timeout_ms) != mark


@pytest.mark.parametrize(("left", "good"), [(0.5, True), (1.5, False)])
def test_a_drive_with_a_watchdog_stands_on_its_way(left: float, good: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that was let go, or ran on, stands elsewhere, and does not brake in silence."""
    trial = trial_of(load_arm("episode1"), 0)
    monkeypatch.setattr(zdt_checks, "braking_rev_s2", lambda *_: trial.ramp_rpm_s / 60.0)
    found = zdt_checks.judge_silence(Ran(0, trial.counts, None), np.zeros((0, 2)), trial, left * trial.turns, 300)
    assert (found.verdict == Verdict.AS_DOCUMENTED) == good
