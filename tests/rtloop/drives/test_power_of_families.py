"""Drives of other families than ZDT: what they prove after a silence, and what they do not.

Their counts begin where power came, so a person says each joint's angle in each control process. Whatever an arm goes
through, a joint that is referenced afterwards stands where it reads.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Generator
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual import START_NS, VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives import (
    cia402_protocol,
    cia402_setup,
    damiao_protocol,
    damiao_setup,
    myactuator_setup,
    robstride_protocol,
    robstride_setup,
)
from rtloop.drives.arming import ARMED, Arming, stayed_armed
from rtloop.drives.myactuator_setup import CLOCK_TOLERANCE, Uptime
from rtloop.drives.power import Marks
from rtloop.drives.setup import setup_of
from rtloop.kept.reference_store import OUTLIVES_THE_PROCESS
from rtloop.service.conversation import TRIES, Conversation, Dialogue
from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced
from sim.drives.myactuator import MyactuatorDrive

ARMED_ARMS = ("cia402_6", "damiao6", "damiao6_pv", "robstride6", "robstride6_position")
SELF_ARMING_ARMS = ("cia402_6", "damiao6", "robstride6")
"""Those whose mode is the one that power brings: in another one an armed drive is refused anyhow."""
PROVING_ARMS = ("myactuator6", *ARMED_ARMS)
OTHER_ARMS = ("odrive6", "mks6", "vesc6")
START_RAD = [0.3, -0.2, 0.4, 0.5, -0.6, 0.7]
KNOWN_WITHIN_RAD = 0.01
WAKING_S = 0.6
"""A drive that got power has booted by then."""
ALL = frozenset(range(6))
NONE: frozenset[int] = frozenset()


def arms_itself(drive: object) -> None:
    """Power arms the drive, which no maker's manual says."""
    drive.arms_itself = True


def uptime(kind: str) -> Callable[[MyactuatorDrive], None]:
    return lambda drive: setattr(drive, "uptime", kind)


def clock(rate: float) -> Callable[[MyactuatorDrive], None]:
    return lambda drive: setattr(drive, "clock", rate)


def sound(drive: object) -> None:
    """A drive as its manual has it."""


@dataclass(frozen=True)
class Silence:
    """Some drives' plugs come loose for a while, in which some of them lose their supply."""

    joints: frozenset[int]
    powerless: frozenset[int] = NONE
    seconds: float = 0.3
    late: frozenset[int] = NONE
    """Those whose plugs are still loose when a person clears the fault for the first time."""
    process_dies: bool = False
    garbled: float = 0.0
    """Share of the adapter's bytes in which a bit is flipped while the drives are brought up again."""
    referenced_again: bool = True


def incremental(name: str) -> ArmConfig:
    """The arm with encoders that count from where power came."""
    document = load_arm(name).model_dump(exclude_unset=True)
    for joint in document["joints"]:
        if joint["drive"]["family"] != "mks":
            joint["drive"]["encoder"] = "incremental"
    return ArmConfig.model_validate(document)


def arm_of(name: str, plants: tuple[Callable, ...] = (sound,) * 6) -> VirtualArm:
    """An arm whose drives have just got power, brought up and referenced."""
    arm = VirtualArm(incremental(name), start_rad=START_RAD, homed=False)
    for drive, plant in zip(arm.sim.drives, plants, strict=True):
        plant(drive)
        if plant is arms_itself:
            drive.power_off(START_NS)
            drive.power_on(START_NS)
    arm.cycles(round(WAKING_S * 1e9 / arm.period_ns))
    assert arm.bring_up().failure is None, arm.told
    reference(arm)
    return arm


def reference(arm: VirtualArm) -> None:
    """A person says where the joints stand whose angle is not known."""
    for joint, known in enumerate(referenced(arm)):
        if not known:
            true_rad = arm.sim.true_position_rad(joint, arm.sim.now_ns)
            assert arm.ask(Request.REFERENCE, joint_mask=1 << joint, value=true_rad) == Answer.DONE
            assert arm.reference().failure is None, arm.told
    assert all(referenced(arm))


def referenced(arm: VirtualArm) -> list[bool]:
    return [bool(axis["reference"]["referenced"]) for axis in arm.loop[0]["axes"][:6]]


def reads_true(arm: VirtualArm) -> bool:
    """Whether every joint that is referenced stands where it reads."""
    read_rad = arm.loop[0]["axes"]["measured"]["position_rad"][:6]
    return all(
        abs(read_rad[joint] - arm.sim.true_position_rad(joint, arm.now_ns)) < KNOWN_WITHIN_RAD
        for joint, known in enumerate(referenced(arm))
        if known
    )


def fall_silent(arm: VirtualArm, silence: Silence) -> None:
    """Let it happen, up to when the drives are heard again."""
    drives = arm.sim.drives
    for joint in silence.joints:
        drives[joint].unplug(arm.now_ns)
    for joint in silence.powerless:
        drives[joint].power_off(arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.cycles(round(silence.seconds * 1e9 / arm.period_ns))
    for joint in silence.powerless:
        drives[joint].power_on(arm.now_ns)
    for joint in silence.joints - silence.late:
        drives[joint].plug_in(arm.now_ns)
    arm.cycles(round(WAKING_S * 1e9 / arm.period_ns))
    if silence.late:
        assert arm.clear_fault().failure is not None
        for joint in silence.late:
            drives[joint].plug_in(arm.now_ns)
        arm.cycles(round(WAKING_S * 1e9 / arm.period_ns))


def endure(arm: VirtualArm, silence: Silence) -> VirtualArm:
    """The arm after the silence and a person's clear, of the same control process or of the next one."""
    fall_silent(arm, silence)
    arm.sim.adapter.corruption = silence.garbled
    if silence.process_dies:
        axes = enumerate(arm.loop[0]["axes"][:6])
        lost = {
            joint: Unreferenced(axis["reference"]["unreferenced_reason"])
            for joint, axis in axes
            if not axis["reference"]["referenced"]
        }
        lost = {joint: why for joint, why in lost.items() if why in OUTLIVES_THE_PROCESS}
        arm = arm.next_process()
        while arm.bring_up(lost_before=lost).failure is not None:
            arm.sim.adapter.corruption = 0.0
            arm = arm.next_process()
    else:
        arm.clear_fault()
    arm.sim.adapter.corruption = 0.0
    arm.cycles(20)
    while arm.memory["mode"] == Mode.FAULT:
        arm.clear_fault()
        arm.cycles(20)
    return arm


@pytest.mark.parametrize("name", PROVING_ARMS)
def test_a_silent_drive_keeps_its_angle_where_it_had_power_and_loses_it_where_it_had_not(name: str) -> None:
    arm = endure(arm_of(name), Silence(ALL, frozenset((1, 4))))
    assert referenced(arm) == [joint not in (1, 4) for joint in range(6)]
    assert reads_true(arm)
    assert any("joint3" in told and "power was there all through the silence" in told for told in arm.told)
    reference(arm)
    assert arm.end_of(arm.send_shift()) == Outcome.SUCCEEDED
    arm = endure(arm, Silence(ALL, frozenset((2,))))  # a mark was given with the reference
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


@pytest.mark.parametrize("name", OTHER_ARMS)
def test_families_without_a_proof_lose_their_angles_in_every_silence(name: str) -> None:
    arm = endure(arm_of(name), Silence(ALL))
    assert not any(referenced(arm))
    arm.close()


@pytest.mark.parametrize("name", PROVING_ARMS)
def test_a_drive_that_lost_power_proves_nothing_when_the_fault_is_cleared_again(name: str) -> None:
    arm = endure(arm_of(name), Silence(frozenset((1, 3)), frozenset((1, 3))))
    arm = endure(arm, Silence(frozenset((0,))))
    assert referenced(arm) == [joint not in (1, 3) for joint in range(6)]
    arm.close()


@pytest.mark.parametrize("name", PROVING_ARMS)
def test_nor_where_the_first_bring_up_after_it_has_failed(name: str) -> None:
    """By then it may have been armed, by a bring-up that came to no verdict."""
    arm = endure(arm_of(name), Silence(frozenset((0, 1, 5)), frozenset((1,)), late=frozenset((5,))))
    known = referenced(arm)
    assert known[0] and known[5] and not known[1]
    assert reads_true(arm)
    arm.close()


@pytest.mark.parametrize("name", PROVING_ARMS)
@pytest.mark.parametrize("also", [0, 3])
def test_a_second_silence_before_the_reference_costs_no_proof_of_later(name: str, also: int) -> None:
    """The mark that the drive of joint1 got when it was armed anew waits for the reference all the same."""
    arm = endure(arm_of(name), Silence(frozenset((0,)), frozenset((0,))))
    arm = endure(arm, Silence(frozenset((also, 2))))
    assert referenced(arm) == [joint != 0 for joint in range(6)]
    reference(arm)
    arm = endure(arm, Silence(frozenset((0,))))
    assert all(referenced(arm))
    arm = endure(arm, Silence(frozenset((0, 1)), frozenset((0,))))
    assert referenced(arm) == [joint != 0 for joint in range(6)]
    arm.close()


@pytest.mark.parametrize("name", [*PROVING_ARMS, *OTHER_ARMS])
def test_a_reference_of_a_drive_that_is_silent_fails_and_ends_nothing(name: str) -> None:
    """A joint without a reference is not watched for silence; what the process took for its own end was its first
    look at a reading that is too old."""
    arm = arm_of(name)
    arm = endure(arm, Silence(frozenset((0,)), frozenset((0,))))
    assert not referenced(arm)[0] and arm.memory["mode"] == Mode.HOLDING
    arm.sim.drives[0].unplug(arm.now_ns)
    arm.cycles(60)
    assert arm.ask(Request.REFERENCE, joint_mask=1, value=0.3) == Answer.DONE
    failure = arm.reference().failure
    assert failure is not None and failure.joint == 0 and "stopped answering" in str(failure)
    arm.until(lambda: arm.memory["fault"]["code"] == Fault.HOMING, at_most_s=1.0)
    arm.close()


@pytest.mark.parametrize("name", PROVING_ARMS)
def test_the_next_process_knows_no_angle_that_a_person_has_said_to_the_last(name: str) -> None:
    arm = endure(arm_of(name), Silence(frozenset((2,)), process_dies=True))
    assert not any(referenced(arm))
    reference(arm)
    arm = endure(arm, Silence(ALL, frozenset((2,))))
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    assert reads_true(arm)
    arm.close()


@pytest.mark.parametrize("name", PROVING_ARMS)
def test_a_drive_whose_mark_was_not_kept_proves_nothing(name: str) -> None:
    arm = arm_of(name)
    arm.marks = Marks()
    arm = endure(arm, Silence(frozenset((2,))))
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


@pytest.mark.parametrize("name", SELF_ARMING_ARMS)
def test_a_drive_that_power_arms_proves_nothing_by_being_armed(name: str) -> None:
    arm = arm_of(name, (arms_itself,) * 3 + (sound,) * 3)
    assert [arm.marks[joint] for joint in range(6)] == [None] * 3 + [ARMED] * 3
    arm = endure(arm, Silence(ALL, frozenset((0, 3))))
    assert referenced(arm) == [False] * 4 + [True] * 2
    arm.close()


@pytest.mark.parametrize("name", ARMED_ARMS)
def test_a_drive_that_was_let_go_proves_nothing(name: str) -> None:
    arm = arm_of(name)
    drive = arm.sim.drives[2]
    drive.unplug(arm.now_ns)
    drive.disable(arm.now_ns)
    arm = endure(arm, Silence(frozenset((2, 3))))
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


@pytest.mark.parametrize("name", ["cia402_6", "damiao6", "myactuator6", "robstride6"])
def test_drives_with_absolute_encoders_are_given_no_mark_unless_a_target_enables_them(name: str) -> None:
    arm = VirtualArm.brought_up(name)
    assert [arm.marks[joint] is not None for joint in range(6)] == [name == "myactuator6"] * 6
    arm.close()


# --- asked apart from a bring-up


class Check(Conversation):
    """Asks the drives for their proof, and does nothing else."""

    def __init__(self, arm: VirtualArm) -> None:
        super().__init__(arm.arm, arm.port, arm.now_ns, fault=Fault.STALE_READING)
        self.marks = arm.marks
        self.proven: dict[int, bool] = {}
        self.begin({joint: self._ask(joint) for joint in range(6)})

    def _ask(self, joint: int) -> Dialogue:
        family: Any = setup_of(self.arm.joints[joint].drive)
        self.proven[joint] = yield from family.kept_power(self, joint)


@pytest.mark.parametrize("name", ["cia402_6", "damiao6", "myactuator6", "robstride6"])
def test_a_proof_is_asked_for_without_changing_anything(name: str) -> None:
    arm = arm_of(name)
    fall_silent(arm, Silence(ALL, frozenset((1,))))
    arm.sim.drives[4].unplug(arm.now_ns)
    before = [arm.marks[joint] for joint in range(6)]
    check = Check(arm)
    arm.until(lambda: check.poll(arm.now_ns))
    assert check.failure is None
    assert check.proven == {joint: joint not in (1, 4) for joint in range(6)}
    assert [arm.marks[joint] for joint in range(6)] == before
    assert arm.memory["mode"] == Mode.FAULT and arm.sim.drives[1].enabled is False
    arm.sim.drives[4].plug_in(arm.now_ns)
    assert arm.clear_fault().failure is None, arm.told
    assert referenced(arm) == [joint != 1 for joint in range(6)]
    arm.close()


# --- answers that are garbled


def end_of(part: Generator) -> Any:
    with pytest.raises(StopIteration) as end:
        next(part)
    return end.value.value


def looks(*answers: bool | None) -> Callable:
    """A drive that says one after the other, whenever it is asked whether it is armed."""
    left = iter(answers)

    def look() -> Generator:
        return next(left)
        yield

    return look


@pytest.mark.parametrize(
    ("answers", "proof"),
    [
        ((True, True), True),
        ((False, True, True), True),
        ((None, True, True), True),
        ((None, None, True, True), True),
        ((True, False, False), False),
        ((False, True, False, False), False),
        ((True, None, False, False), False),
        ((True, False, True, False, True, False), False),
        ((None,) * (TRIES + 1), False),
    ],
)
def test_two_answers_must_agree_that_a_drive_is_armed(answers: tuple[bool | None, ...], proof: bool) -> None:
    host = SimpleNamespace(marks=Marks({0: ARMED}), was_silent=[True])
    assert end_of(stayed_armed(host, 0, looks(*answers))) is proof
    host.marks[0] = None
    assert end_of(stayed_armed(host, 0, looks(*answers))) is False


@pytest.mark.parametrize(
    ("silent", "mark", "seen", "answers", "found"),
    [
        (True, ARMED, False, (True, True), True),
        (True, ARMED, True, (False, False), False),
        (True, ARMED, True, (None,) * (TRIES + 1), True),
        (True, None, False, (), False),
        (False, ARMED, False, (), False),
    ],
)
def test_a_drive_that_may_prove_something_is_not_armed_by_a_garbled_answer(
    silent: bool, mark: str | None, seen: bool, answers: tuple[bool | None, ...], found: bool
) -> None:
    host = SimpleNamespace(marks=Marks({0: mark} if mark else {}), was_silent=[silent])
    assert end_of(Arming(host, 0, looks(*answers)).found(seen)) is found
    assert host.marks[0] == mark


def garble_first(monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str, garbled: Callable) -> None:
    """Spoil the first answer that a function of a bring-up gets of each drive, which its last argument names."""
    true, spoilt = getattr(module, name), set()

    def read(*arguments: Any) -> Generator:
        answer = yield from true(*arguments)
        whose = repr(arguments[-1])
        if whose in spoilt:
            return answer
        spoilt.add(whose)
        return garbled(answer)

    monkeypatch.setattr(module, name, read)


FIRST_LOOKS = {
    "cia402_6": (
        cia402_setup,
        "_sound_state",
        lambda state: cia402_protocol.SWITCH_ON_DISABLED,
        lambda state: cia402_protocol.OPERATION_ENABLED,
    ),
    "damiao6": (
        damiao_setup,
        "_feedback",
        lambda found: found._replace(code=damiao_protocol.LIMP),
        lambda found: found._replace(code=damiao_protocol.ENABLED),
    ),
    "robstride6": (
        robstride_setup,
        "_asked_how_it_is",
        lambda state: state._replace(mode=robstride_protocol.RESET),
        lambda state: state._replace(mode=robstride_protocol.RUN),
    ),
}


@pytest.mark.parametrize("name", FIRST_LOOKS)
def test_a_garbled_answer_costs_no_proof(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    module, function, disarmed, _ = FIRST_LOOKS[name]
    arm = arm_of(name)
    fall_silent(arm, Silence(ALL))
    garble_first(monkeypatch, module, function, disarmed)
    assert arm.clear_fault().failure is None, arm.told
    assert all(referenced(arm))
    arm.close()


@pytest.mark.parametrize("name", FIRST_LOOKS)
def test_a_garbled_answer_is_no_proof(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    module, function, _, armed = FIRST_LOOKS[name]
    arm = arm_of(name)
    fall_silent(arm, Silence(ALL, ALL))
    garble_first(monkeypatch, module, function, armed)
    assert arm.clear_fault().failure is None, arm.told
    assert not any(referenced(arm))
    assert all(drive.enabled for drive in arm.sim.drives)
    arm.close()


# --- a motor's uptime

UP = Uptime("boot", 60_000, 1_000_000_000, 1_010_000_000)


def later(seconds: float, ms: float, boot: str = "boot") -> Uptime:
    asked_ns = UP.heard_ns + round(seconds * 1e9)
    return Uptime(boot, round(ms), asked_ns, asked_ns + 10_000_000)


@pytest.mark.parametrize("rate", [1.0, 1.0 - 0.9 * CLOCK_TOLERANCE, 1.0 + 0.9 * CLOCK_TOLERANCE])
@pytest.mark.parametrize("seconds", [0.3, 60.0, 1500.0])
def test_an_uptime_that_goes_on_as_the_clock_does_is_a_proof(seconds: float, rate: float) -> None:
    assert later(seconds, UP.ms + seconds * 1e3 * rate).proves_power_since(UP)


@given(st.floats(0.0, 1e6), st.floats(0.0, 1.0), st.floats(-CLOCK_TOLERANCE, CLOCK_TOLERANCE))
def test_a_motor_that_began_after_its_mark_has_no_proof(seconds: float, share: float, off: float) -> None:
    """Whatever its mark says, a garbled one too: it is up for no more than the time since."""
    mark = Uptime("boot", round(share * seconds * 1e3), 1_000_000_000, 1_010_000_000)
    reset = later(seconds, (seconds + 0.01) * 1e3 * (1.0 + off))
    assert not reset.proves_power_since(mark)
    assert not later(seconds, share * seconds * 1e3).proves_power_since(UP)


@pytest.mark.parametrize(
    "found",
    [
        later(60.0, UP.ms),
        later(60.0, UP.ms + 50_000),
        later(60.0, UP.ms + 70_000),
        later(60.0, 60_000),
        later(60.0, UP.ms + 60_000, boot="another boot of this machine"),
        later(3600.0 * 24.0, UP.ms + 3600e3 * 24.0),
        later(1.0, (UP.ms + 1000) % 60_500),
    ],
    ids=["stuck", "slow", "fast", "reset", "another boot", "a reset could say that too", "begun anew"],
)
def test_an_uptime_that_proves_nothing(found: Uptime) -> None:
    assert not found.proves_power_since(UP)


@pytest.mark.parametrize("mark", [None, "", "boot 1 2", "boot 1 2 3 4", "boot x 2 3", ARMED])
def test_what_is_no_mark_of_an_uptime_is_none(mark: str | None) -> None:
    assert Uptime.of_mark(mark) is None


def test_a_mark_of_an_uptime_comes_back() -> None:
    assert Uptime.of_mark(UP.mark) == UP


def test_a_mark_of_another_boot_of_this_machine_proves_nothing() -> None:
    arm = arm_of("myactuator6")
    up = Uptime.of_mark(arm.marks[2])
    arm.marks[2] = up._replace(boot="another").mark
    arm = endure(arm, Silence(frozenset((2, 3))))
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


def test_time_in_which_this_machine_was_suspended_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its clock stood still, so a motor that began anew in the meantime looks older than the mark."""
    arm = arm_of("myactuator6")
    up = Uptime.of_mark(arm.marks[2])
    assert up is not None
    for joint in (2, 3):
        arm.sim.drives[joint].unplug(arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    suspended_ns = 100_000_000_000
    monkeypatch.setattr(myactuator_setup, "suspended_ns", lambda: suspended_ns)
    for joint in (0, 1, 3, 4, 5):
        arm.sim.drives[joint].up_since_ns -= suspended_ns
    arm = endure(arm, Silence(frozenset((2, 3))))
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


@pytest.mark.parametrize(
    ("plant", "proves"),
    [
        (uptime("absent"), False),
        (uptime("stuck"), False),
        (clock(0.99), True),
        (clock(1.01), True),
        (clock(0.9), False),
        (clock(1.1), False),
    ],
    ids=["absent", "stuck", "a little slow", "a little fast", "slow", "fast"],
)
def test_what_a_motor_makes_of_its_uptime(monkeypatch: pytest.MonkeyPatch, plant: Callable, proves: bool) -> None:
    """On a machine that was suspended for a while before."""
    monkeypatch.setattr(myactuator_setup, "suspended_ns", lambda: 100_000_000_000)
    arm = arm_of("myactuator6", (plant,) * 3 + (sound,) * 3)
    arm = endure(arm, Silence(ALL, frozenset((0, 5)), seconds=2.0))
    assert referenced(arm) == [False, proves, proves, True, True, False]
    arm.close()


def say_first(drive: MyactuatorDrive, *uptimes_ms: int) -> None:
    """Garble the first uptimes that a motor says."""
    says, left = drive._does[0xB1], list(uptimes_ms)

    def garbled(data: bytes) -> bytes | None:
        return struct.pack("<BxxxI", 0xB1, left.pop(0)) if left else says(data)

    drive._does[0xB1] = garbled


def test_one_uptime_that_is_garbled_neither_proves_nor_costs_a_proof() -> None:
    arm = arm_of("myactuator6")
    fall_silent(arm, Silence(ALL, frozenset((2,))))
    for joint in (2, 3):
        up = Uptime.of_mark(arm.marks[joint])
        asked_in_ms = 15  # as much as another motor's uptime has grown when it is asked
        kept_ms = up.ms + (arm.now_ns - up.heard_ns) // 1_000_000 + asked_in_ms
        say_first(arm.sim.drives[joint], kept_ms if joint == 2 else 7)
    assert arm.clear_fault().failure is None, arm.told
    assert referenced(arm) == [joint != 2 for joint in range(6)]
    arm.close()


def test_a_motor_that_tells_no_uptime_is_asked_as_often_as_any_that_is_silent() -> None:
    arm = VirtualArm(incremental("myactuator6"))
    asked = []
    arm.sim.drives[2]._does[0xB1] = asked.append
    assert arm.bring_up().failure is None, arm.told
    assert len(asked) == TRIES
    arm.close()


def test_a_garbled_uptime_is_no_mark() -> None:
    arm = VirtualArm(incremental("myactuator6"), start_rad=START_RAD, homed=False)
    say_first(arm.sim.drives[2], 7)
    assert arm.bring_up().failure is None, arm.told
    reference(arm)
    arm = endure(arm, Silence(ALL))
    assert all(referenced(arm))
    arm.close()


# --- marks


def test_a_mark_that_waits_for_a_reference_gives_way_to_one_of_later() -> None:
    kept: list[dict[int, str]] = []
    marks = Marks({0: "old"}, lambda marks: kept.append(dict(marks)))
    marks.give_once_referenced(0, "waiting")
    assert marks[0] is None and kept[-1] == {}
    marks[0] = "later"
    marks.referenced(0)
    assert marks[0] == "later"
    marks.give_once_referenced(0, "waiting")
    marks.referenced(0)
    marks.referenced(1)
    assert marks[0] == "waiting" and kept[-1] == {0: "waiting"}


# --- all of it at random

SILENCES = st.builds(
    lambda joints, cut, seconds, late, *rest: Silence(joints, joints & cut, seconds, joints & late, *rest),
    st.frozensets(st.integers(0, 5), min_size=1),
    st.frozensets(st.integers(0, 5)),
    st.floats(0.15, 2.0),
    st.sampled_from([NONE, NONE, frozenset((0, 3)), ALL]),
    st.booleans(),
    st.sampled_from([0.0, 0.0, 0.003, 0.02]),
    st.booleans(),
)
SLIGHTLY_FAST = clock(1.01)
PROVE = (sound, SLIGHTLY_FAST)
PLANTS = dict.fromkeys((*ARMED_ARMS, *OTHER_ARMS), st.just(sound))
PLANTS |= dict.fromkeys(SELF_ARMING_ARMS, st.sampled_from([sound, sound, arms_itself]))
PLANTS["myactuator6"] = st.sampled_from([sound, uptime("stuck"), uptime("absent"), SLIGHTLY_FAST])


@pytest.mark.parametrize("name", [*PROVING_ARMS, *OTHER_ARMS])
@settings(max_examples=6)
@given(data=st.data())
def test_no_angle_is_kept_over_a_loss_of_power_and_none_is_lost_that_is_proven(name: str, data: st.DataObject) -> None:
    plants = data.draw(st.tuples(*[PLANTS[name]] * 6))
    proves = [name in PROVING_ARMS and plant in PROVE for plant in plants]
    arm = arm_of(name, plants)
    known = referenced(arm)
    for silence in data.draw(st.lists(SILENCES, min_size=1, max_size=3)):
        if not any(known[joint] for joint in silence.joints):
            continue  # nobody watches it
        arm = endure(arm, silence)
        kept = referenced(arm)
        may = [was and joint not in silence.powerless for joint, was in enumerate(known)]
        assert all(may[joint] for joint in range(6) if kept[joint])
        assert reads_true(arm)
        if silence.garbled:
            break  # a place that was garbled may have led a joint astray
        if not silence.process_dies:
            must = [may[joint] and proves[joint] for joint in silence.joints]
            assert [kept[joint] for joint in silence.joints] == must
        if silence.referenced_again:
            reference(arm)
        known = referenced(arm)
    arm.close()


S = 1_000_000_000
MARKED = Uptime("boot", 60_000, 100 * S, 100 * S + 1_000_000)


def said(ms: float, after_s: float, boot: str = "boot") -> Uptime:
    """What a motor says of its uptime so long after `MARKED`."""
    return Uptime(boot, round(ms), MARKED.asked_ns + round(after_s * S), MARKED.heard_ns + round(after_s * S))


@given(st.floats(0.5, 1e5), st.floats(0.0, 1.0), st.floats(1.0 - CLOCK_TOLERANCE, 1.0 + CLOCK_TOLERANCE))
def test_a_motor_that_began_anew_is_known_by_its_uptime(after_s: float, share: float, rate: float) -> None:
    up = said(1e3 * after_s * share * rate, after_s)
    assert not up.proves_power_since(MARKED)
    assert up.began_since(MARKED) or up.ms >= MARKED.ms + up.least_ms_since(MARKED)


@given(st.floats(0.5, 1e5), st.floats(1.0 - CLOCK_TOLERANCE, 1.0 + CLOCK_TOLERANCE))
def test_a_motor_that_went_on_did_not_begin_anew(after_s: float, rate: float) -> None:
    assert not said(MARKED.ms + 1e3 * after_s * rate, after_s).began_since(MARKED)


@pytest.mark.parametrize("after_s", [0.5, 10.0, 50.0])
def test_an_uptime_that_stands_still_or_is_slow_says_nothing(after_s: float) -> None:
    assert not said(MARKED.ms, after_s).began_since(MARKED)
    assert not said(MARKED.ms + 0.9e3 * after_s, after_s).began_since(MARKED)
    assert not said(10.0, after_s, boot="another").began_since(MARKED)


def test_an_uptime_that_went_round_says_nothing() -> None:
    marked = MARKED._replace(ms=(1 << 32) - 5_000)
    assert not said(5_000, 10.0).began_since(marked)
    assert said(5_000, 10.0).began_since(MARKED)


def test_an_angle_that_is_said_after_an_unnoticed_loss_of_power_is_kept() -> None:
    """Its mark is no older than the angle."""
    arm = VirtualArm(incremental("myactuator6"), start_rad=START_RAD, homed=False)
    arm.cycles(round(WAKING_S * 1e9 / arm.period_ns))
    assert arm.bring_up().failure is None
    motor = arm.sim.drives[2]
    motor.power_off(arm.now_ns)
    arm.cycles(100)
    motor.power_on(arm.now_ns)
    arm.cycles(150)
    for joint in (0, 1, 3, 4, 5, 2):
        true_rad = arm.sim.true_position_rad(joint, arm.sim.now_ns)
        assert arm.ask(Request.REFERENCE, joint_mask=1 << joint, value=true_rad) == Answer.DONE
        assert arm.reference().failure is None, arm.told
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)  # its motor is off, which counts from now on
    arm.clear_fault()
    assert all(referenced(arm)) and reads_true(arm)
    arm.close()


def test_a_motor_without_a_true_uptime_keeps_its_angle_beside_another_joints_fault() -> None:
    arm = arm_of("myactuator6", (uptime("stuck"), uptime("stuck"), clock(0.9), sound, sound, sound))
    arm.cycles(500)
    arm.sim.drives[5].unplug(arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.sim.drives[5].plug_in(arm.now_ns)
    arm.cycles(100)
    arm.clear_fault()
    assert referenced(arm)[:5] == [True] * 5
    arm.close()
