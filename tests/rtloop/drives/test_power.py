"""A drive that proves that it had power keeps its angle through a silence; no other does."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any, get_args

import pytest
from depth import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from rtloop.drives import zdt_protocol as protocol
from rtloop.drives import zdt_talk
from rtloop.drives.power import Marks
from rtloop.kept.reference_store import OUTLIVES_THE_PROCESS
from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced
from sim.drives.zdt import ZdtDrive
from sim.drives.zdt_motion import PowerFlag
from sim.faults import CorruptBytes, PowerLoss, Silent

KNOWN_WITHIN_RAD = 0.01
FLAGS: tuple[PowerFlag, ...] = get_args(PowerFlag)


@dataclass(frozen=True)
class Silence:
    """Some drives' plugs come loose for a while, in which some of them lose their supply."""

    joints: frozenset[int]
    powerless: frozenset[int]
    seconds: float
    process_dies: bool = False
    garbled: float = 0.0
    """Share of the adapter's bytes in which one bit is flipped while the drives are brought up again."""


def drives_of(arm: VirtualArm) -> list[ZdtDrive]:
    assert arm.sim is not None
    return [drive for drive in arm.sim.drives if isinstance(drive, ZdtDrive)]


def endure(arm: VirtualArm, silence: Silence) -> VirtualArm:
    """The arm after the silence and a person's clear, of the same control process or of the next one."""
    drives = drives_of(arm)
    for joint in silence.joints:
        drives[joint].unplug(arm.now_ns)
    for joint in silence.powerless:
        drives[joint].power_off(arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.cycles(round(silence.seconds * 1e9 / arm.period_ns))
    for joint in silence.powerless:
        drives[joint].power_on(arm.now_ns)
    for joint in silence.joints:
        drives[joint].plug_in(arm.now_ns)
    arm.until(lambda: arm.memory["fault"]["latched_ns"] + 500_000_000 < arm.now_ns)
    assert arm.sim is not None
    arm.sim.inject(CorruptBytes(silence.garbled), arm.now_ns)
    if silence.process_dies:
        axes = arm.loop[0]["axes"][: len(drives)]
        lost = {
            n: Unreferenced(axis["reference"]["unreferenced_reason"])
            for n, axis in enumerate(axes)
            if not axis["reference"]["referenced"]
        }
        lost = {n: why for n, why in lost.items() if why in OUTLIVES_THE_PROCESS}
        arm = arm.next_process()
        while arm.bring_up(lost_before=lost).failure is not None:  # garbled beyond understanding
            arm.sim.inject(CorruptBytes(0.0), arm.now_ns)
            arm = arm.next_process()
    else:
        arm.clear_fault()
    arm.sim.inject(CorruptBytes(0.0), arm.now_ns)
    while arm.memory["mode"] == Mode.FAULT:
        arm.clear_fault()
    return arm


def referenced(arm: VirtualArm) -> list[bool]:
    return [bool(axis["reference"]["referenced"]) for axis in arm.loop[0]["axes"][: len(arm.arm.joints)]]


@pytest.mark.parametrize("process_dies", [False, True])
@pytest.mark.parametrize("flag", ["right", "absent", "unset"])
def test_a_silent_drive_keeps_its_angle_where_it_had_power_and_loses_it_where_it_had_not(
    flag: PowerFlag, process_dies: bool
) -> None:
    arm = VirtualArm("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    for drive in drives_of(arm):
        drive.power_flag = flag
    arm.bring_up()
    arm = endure(arm, Silence(frozenset(range(6)), frozenset((1, 4)), 0.4, process_dies))
    assert referenced(arm) == [joint not in (1, 4) for joint in range(6)]
    arm.close()


def test_an_arm_that_was_silent_takes_the_next_goal() -> None:
    arm = VirtualArm.brought_up("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    arm = endure(arm, Silence(frozenset(range(6)), frozenset(), 0.2))
    assert arm.told[-1].startswith("joint1, joint2, joint3, joint4, joint5 and joint6: power was there")
    assert arm.end_of(arm.send_shift()) == Outcome.SUCCEEDED
    arm.close()


def test_old_firmware_without_a_flag_proves_it_too() -> None:
    arm = VirtualArm.brought_up("episode1", firmware="old")
    arm = endure(arm, Silence(frozenset((2, 3)), frozenset((3,)), 0.3))
    assert referenced(arm) == [True, True, True, False, True, True]
    arm.close()


def test_drives_of_which_nobody_can_tell_what_was_found_keep_their_angles_when_it_can_be_told_again() -> None:
    """They get no mark meanwhile, and that of before proves nothing, but is kept."""
    arm = VirtualArm.brought_up("episode1")
    kept = [dict(arm.marks._marks)]
    arm = arm.next_process()
    arm.marks = Marks(kept[-1], lambda marks: kept.append(dict(marks)), range(6))
    before = [drive.homing for drive in drives_of(arm)]
    assert arm.bring_up().failure is None
    assert arm.ask(Request.REFERENCE, joint_mask=1 << 1, value=math.nan) == Answer.DONE
    assert arm.reference().failure is None
    assert [drive.homing for drive in drives_of(arm)] == before
    arm = arm.next_process()
    arm.marks = Marks(kept[-1])
    assert arm.bring_up().failure is None
    assert all(referenced(arm))
    arm.close()


def test_a_mark_that_proves_nothing_speaks_against_an_angle_all_the_same() -> None:
    arm = VirtualArm.brought_up("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    kept = dict(arm.marks._marks)
    arm = arm.next_process()
    arm.marks = Marks(kept, unproven=range(6))
    drives_of(arm)[2].power_flag = "absent"
    arm.sim.inject(PowerLoss("joint3", at_s=0.0, off_s=0.5), since_ns=arm.now_ns)
    arm.now_ns += 1_500_000_000
    assert arm.bring_up().failure is None
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


def test_a_drive_whose_mark_was_not_kept_proves_nothing() -> None:
    arm = VirtualArm.brought_up("episode1")
    arm.marks = Marks()
    arm = endure(arm, Silence(frozenset((2,)), frozenset(), 0.3))
    assert referenced(arm) == [True, True, False, True, True, True]
    arm.close()


def test_an_angle_that_was_lost_is_not_found_again_by_a_later_silence() -> None:
    arm = VirtualArm.brought_up("episode1")
    drives_of(arm)[3].power_flag = "absent"
    arm = endure(arm, Silence(frozenset((3,)), frozenset((3,)), 0.3))
    arm = endure(arm, Silence(frozenset((0,)), frozenset(), 0.3))
    assert referenced(arm) == [True, True, True, False, True, True]
    assert arm.ask(Request.REFERENCE, joint_mask=1 << 3) == Answer.DONE
    assert arm.reference().failure is None
    arm = endure(arm, Silence(frozenset((3,)), frozenset(), 0.3))
    assert all(referenced(arm))
    arm.close()


def lose_power(arm: VirtualArm, joint: int, seconds: float) -> None:
    """A drive without a flag for it loses its supply, too shortly for the age ladder where somebody looks."""
    drive = drives_of(arm)[joint]
    drive.power_off(arm.now_ns)
    arm.cycles(round(seconds * 1e9 / arm.period_ns))
    drive.power_on(arm.now_ns)


@pytest.mark.parametrize("firmware", ["new", "old"])
def test_a_loss_of_power_that_a_bring_up_hides_is_noticed_without_a_flag(firmware: Any) -> None:
    """It begins right before a person's clear, which forgets for how long a drive has been silent."""
    arm = VirtualArm("episode1", firmware=firmware, start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    for drive in drives_of(arm):
        drive.power_flag = "absent"
    arm.bring_up()
    drives_of(arm)[0].trip(arm.now_ns, protocol.STALLED)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    lose_power(arm, 2, 0.05)
    arm.clear_fault()
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    assert arm.loop[0]["axes"][2]["reference"]["unreferenced_reason"] == Unreferenced.POWER_LOST
    assert "joint3 may have lost power" in arm.told[-1]
    arm.close()


@pytest.mark.parametrize("flag", ["absent", "stuck"])
def test_a_count_that_is_another_one_behind_a_clear_is_no_angle_whatever_the_mark_says(flag: PowerFlag) -> None:
    """Neither flag nor mark of this drive tells a loss of power: it stores what it is told for volatile memory."""
    arm = VirtualArm("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    drives_of(arm)[2].power_flag, drives_of(arm)[2].stores_everything = flag, True
    arm.bring_up()
    if flag == "stuck":
        assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=0.4) == Answer.DONE
        assert arm.reference().failure is None
    assert all(referenced(arm))
    drives_of(arm)[0].trip(arm.now_ns, protocol.STALLED)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.sim.inject(PowerLoss("joint3", at_s=0.0, off_s=0.1), since_ns=arm.now_ns)
    arm.cycles(3)
    arm.clear_fault()
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    assert arm.loop[0]["axes"][2]["reference"]["unreferenced_reason"] == Unreferenced.POWER_LOST
    arm.close()


@pytest.mark.parametrize("seconds", [0.5, 2.0])
def test_a_count_that_is_another_one_behind_a_clear_that_failed_is_no_angle_either(seconds: float) -> None:
    """The loss of power that makes the first clear fail; or one behind it, while its joint is held all the same."""
    arm = VirtualArm("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    drive = drives_of(arm)[2]
    drive.power_flag, drive.stores_everything = "absent", True
    arm.bring_up()
    drives_of(arm)[0].trip(arm.now_ns, protocol.STALLED)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    begins_s = 0.0 if seconds < 1.0 else 1.0
    if begins_s:
        drive.unplug(arm.now_ns)
    arm.sim.inject(PowerLoss("joint3", at_s=begins_s, off_s=seconds), since_ns=arm.now_ns)
    arm.cycles(3)
    assert arm.clear_fault().failure is not None
    if begins_s:
        drive.plug_in(arm.now_ns)
    arm.cycles(500)
    assert arm.clear_fault().failure is None
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


def test_a_joint_that_moves_while_it_is_enabled_keeps_its_angle_where_its_drive_proves_its_power() -> None:
    """Its flag told a loss of power, then a person said its angle: from then on its mark speaks for it."""
    arm = VirtualArm.brought_up("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    arm.sim.inject(PowerLoss("joint3", at_s=0.0, off_s=0.5), since_ns=arm.now_ns)
    arm.cycles(300)
    arm.clear_fault()
    assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=0.4) == Answer.DONE
    assert arm.reference().failure is None
    assert arm.ask(Request.FREE) == Answer.DONE
    arm.release()
    before_rad = float(arm.loop[0]["axes"][2]["measured"]["position_rad"])
    drives_of(arm)[2].lead(arm.now_ns, 10.0)  # a hand, until the bring-up has it hold again
    assert arm.ask(Request.ENABLE) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up().failure is None
    assert abs(arm.loop[0]["axes"][2]["measured"]["position_rad"] - before_rad) > 2.0 * arm.arm.limits.position_jump_rad
    assert all(referenced(arm))
    arm.close()


def test_a_joint_that_held_nothing_before_a_clear_may_stand_elsewhere_behind_it() -> None:
    arm = VirtualArm.brought_up("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    drive = drives_of(arm)[2]
    drive.trip(arm.now_ns, protocol.STALLED)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    before_rad = float(arm.loop[0]["axes"][2]["measured"]["position_rad"])
    drive.lead(arm.now_ns, 10.0)  # it falls, until the clear has it hold again
    arm.clear_fault()
    assert abs(arm.loop[0]["axes"][2]["measured"]["position_rad"] - before_rad) > 2.0 * arm.arm.limits.position_jump_rad
    assert all(referenced(arm))
    arm.close()


def test_a_loss_of_power_between_two_processes_is_noticed_without_a_flag_until_an_angle_is_said() -> None:
    arm = VirtualArm("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    for drive in drives_of(arm):
        drive.power_flag = "absent"
    arm.bring_up()
    lose_power(arm, 2, 0.05)
    for _ in range(2):  # a process that is killed before it has kept why changes nothing
        arm = arm.next_process()
        arm.bring_up()
        assert referenced(arm) == [joint != 2 for joint in range(6)]
        assert "joint3: the mark of its drive" in arm.told[-2] and "it lost power, or something else" in arm.told[-2]
    assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=math.nan) == Answer.REFUSED_VALUE
    assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=0.4) == Answer.DONE
    assert arm.reference().failure is None
    assert all(referenced(arm))
    arm = arm.next_process()
    arm.bring_up()
    assert all(referenced(arm))
    arm.close()


@pytest.mark.parametrize("garbled", [False, True])
def test_a_drive_that_does_not_tell_its_mark_any_more_is_brought_up_without_its_angle(
    garbled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that was exchanged for, or has got, firmware that refuses the question (22); or the line garbles it."""
    arm = VirtualArm.brought_up("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    drive = drives_of(arm)[2]
    if garbled:
        others = itertools.count(1)
        monkeypatch.setitem(drive._reads, 0x22, lambda: b"\x22" + replace(drive.homing, timeout_ms=next(others)).pack())
    else:
        drive.unknown = frozenset((0x22,))
    for _ in range(2):  # a process that is killed before it has kept why changes nothing
        arm = arm.next_process()
        assert arm.bring_up().failure is None
        assert referenced(arm) == [joint != 2 for joint in range(6)]
        assert "joint3: its drive, which had a mark, does not tell its homing parameters" in arm.told[-2]
    assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=0.4) == Answer.DONE
    assert arm.reference().failure is None
    arm = arm.next_process()
    assert arm.bring_up().failure is None
    assert all(referenced(arm))
    arm.close()


def test_a_drive_that_is_silent_when_its_mark_is_asked_for_ends_the_bring_up(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = VirtualArm.brought_up("episode1")
    drive = drives_of(arm)[2]

    def goes_silent() -> bytes:
        drive.unplug(arm.now_ns)
        return b""

    arm = arm.next_process()
    monkeypatch.setitem(drive._reads, 0x22, goes_silent)
    failure = arm.bring_up().failure
    assert failure is not None and "joint3 stopped answering while its status was read" in str(failure)
    arm.close()


@pytest.mark.parametrize("seconds", [0.1, 0.8, 1.2])
def test_a_drive_that_is_silent_for_a_moment_when_its_mark_is_asked_for_keeps_its_angle(
    seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = VirtualArm.brought_up("episode1")
    arm = arm.next_process()
    drive = drives_of(arm)[2]
    told, asked = drive._reads[0x22], itertools.count()

    def falls_silent() -> bytes:
        if next(asked) == 0:
            arm.sim.inject(Silent("joint3", at_s=0.0, until_s=seconds), since_ns=arm.now_ns)
        return told()

    monkeypatch.setitem(drive._reads, 0x22, falls_silent)
    assert arm.bring_up().failure is None
    assert all(referenced(arm))
    arm.close()


def test_a_flag_that_is_seen_last_is_not_told_as_a_mark_that_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive without a mark that loses its power right before the last question of its bring-up."""
    arm = VirtualArm("episode1")
    drive = drives_of(arm)[2]
    drive.unknown = frozenset((0x4C,))  # it takes no mark
    target = drive._reads[0x33]

    def loses_power() -> bytes:
        drive.power_lost = True
        return target()

    monkeypatch.setitem(drive._reads, 0x33, loses_power)
    assert arm.bring_up().failure is None
    assert arm.loop[0]["axes"][2]["reference"]["unreferenced_reason"] == Unreferenced.POWER_LOST
    assert not any("mark" in sentence for sentence in arm.told)
    arm.close()


@pytest.mark.parametrize("home", [False, True])
def test_a_mark_that_is_gone_takes_the_angle_before_another_one_takes_its_place(home: bool) -> None:
    """A drive that lost its power unseen, and of whose homing run, or reference, nothing comes."""
    arm = VirtualArm.brought_up("episode1")
    drive = drives_of(arm)[2]
    drive.homing = replace(drive.homing, timeout_ms=10_000)
    if home:
        drive.unknown = frozenset((0x4C,))  # it takes no time-out
        assert arm.ask(Request.HOME, joint_mask=1 << 2) == Answer.DONE
    else:
        drive.unknown = frozenset((0x33,))  # it does not tell its target
        assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=math.nan) == Answer.DONE
    assert arm.reference().failure is not None
    assert arm.lost[2] == Unreferenced.POWER_LOST
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    assert arm.loop[0]["axes"][2]["reference"]["unreferenced_reason"] == Unreferenced.POWER_LOST
    arm.close()


def test_an_angle_said_beside_a_standing_flag_is_lost_with_a_silence() -> None:
    """What the drive stores may outlive its power, too: without the flag nothing is believed."""
    arm = VirtualArm("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    drives_of(arm)[2].power_flag = "stuck"
    drives_of(arm)[2].stores_everything = True
    arm.bring_up()
    assert not referenced(arm)[2]
    assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=0.4) == Answer.DONE
    assert arm.reference().failure is None
    arm = endure(arm, Silence(frozenset(range(6)), frozenset((2,)), 0.3))
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


def test_a_new_mark_does_not_speak_for_the_time_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive that took none when its angle was said, and lost its power before the bring-up that gives it one."""
    arm = VirtualArm("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    drives_of(arm)[2].power_flag = "stuck"
    arm.bring_up()

    def takes_none(now_ns: int) -> Any:
        yield from ()

    with monkeypatch.context() as patched:
        patched.setattr(zdt_talk, "mark", takes_none)
        assert arm.ask(Request.REFERENCE, joint_mask=1 << 2, value=0.4) == Answer.DONE
        assert arm.reference().failure is None
    assert all(referenced(arm)) and arm.marks[2] is None
    drives_of(arm)[0].trip(arm.now_ns, protocol.STALLED)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.sim.inject(PowerLoss("joint3", at_s=0.0, off_s=0.1), since_ns=arm.now_ns)
    arm.cycles(3)
    arm.clear_fault()
    assert not referenced(arm)[2]
    arm.close()


SILENCES = st.builds(
    lambda joints, cut, *rest: Silence(joints, frozenset(joint for joint in joints if joint in cut), *rest),
    st.frozensets(st.integers(0, 5), min_size=1),
    st.frozensets(st.integers(0, 5)),
    st.floats(0.15, 2.0),
    st.booleans(),
    st.sampled_from([0.0, 0.0, 0.003, 0.02]),
)


@settings(max_examples=examples(25))
@given(st.tuples(*[st.sampled_from(FLAGS)] * 6), st.lists(SILENCES, min_size=1, max_size=4))
@example(
    ("absent", "right", "absent", "absent", "absent", "right"),
    [
        Silence(frozenset((0, 2, 3, 4)), frozenset((0, 2, 3, 4)), 0.1640625),
        Silence(frozenset((0, 1, 3)), frozenset((3,)), 2.0),
        Silence(frozenset((5,)), frozenset((5,)), 0.8046875, garbled=0.003),
    ],
)
def test_no_angle_is_kept_over_a_loss_of_power_and_none_is_lost_that_is_proven(
    flags: tuple[PowerFlag, ...], silences: list[Silence]
) -> None:
    arm = VirtualArm("episode1", start_rad=[0.3, -0.2, 0.4, 0.5, -0.6, 0.7])
    for drive, flag in zip(drives_of(arm), flags, strict=True):
        drive.power_flag = flag
    arm.bring_up()
    known = [flag != "stuck" for flag in flags]
    for silence in silences:
        if not any(known[joint] for joint in silence.joints):
            continue  # nobody watches it
        arm = endure(arm, silence)
        known = [was and joint not in silence.powerless for joint, was in enumerate(known)]
        assert arm.memory["fault"]["code"] == Fault.NONE
        kept = referenced(arm)
        assert kept == known or silence.garbled > 0.0  # what is garbled proves nothing
        assert all(known[joint] for joint in range(6) if kept[joint])
        known = kept
    arm.cycles(20)  # the last reading may be one of the garbled line, off by less than a jump
    for joint, angle_rad in enumerate(arm.loop[0]["axes"]["measured"]["position_rad"][:6]):
        assert arm.sim is not None
        if known[joint]:
            assert abs(angle_rad - arm.sim.true_position_rad(joint, arm.now_ns)) < KNOWN_WITHIN_RAD
    arm.close()
