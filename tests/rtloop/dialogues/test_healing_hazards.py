"""What could hurt where an arm clears its own fault: "Going on after a stall" in docs/explanation/safety.md."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from mixed_arm import ODRIVE, ZDT, arm_of
from observer import frames_sent, motion_frames
from test_healing import ALL, drive_of, healed, silence, still_faulted, wait
from virtual import VirtualArm

from config.joint import JointConfig
from config.loader import load_arm
from rtloop.dialogues.healing import DECIDED_WITHIN_NS, REST_NS, Healing
from rtloop.drives import myactuator_setup, zdt_protocol
from rtloop.wire import received
from shm.words import Answer, BusState, Fault, Mode, Outcome, Request, Unreferenced
from sim.faults import ReceiveStall, Silent

MKS = {"family": "mks"}
KNOWN_WITHIN_RAD = 0.01
STATUS = zdt_protocol.ASK_STATUS[0]


@pytest.fixture
def moving() -> Iterator[VirtualArm]:
    """An arm amid a goal, which may go on by itself."""
    arm = VirtualArm.amid("scale_1_0", 60)
    arm.heal_by_itself()
    yield arm
    arm.close()


def goes_silent(arm: VirtualArm) -> None:
    """All plugs are out, and that has been found."""
    for joint in ALL:
        drive_of(arm, joint).unplug(arm.now_ns)
    arm.until(lambda: still_faulted(arm))


def is_heard(arm: VirtualArm) -> None:
    for joint in ALL:
        drive_of(arm, joint).plug_in(arm.now_ns)


def asks_for_power(arm: VirtualArm) -> bool:
    return arm._healing_talk is not None and still_faulted(arm)


def push(arm: VirtualArm, joint: int, rad: float) -> None:
    """The joint reads so much further; slowly enough, it is no jump."""
    drive_of(arm, joint).count_shift += round(rad * float(arm.loop[0]["joints"][joint]["reading_per_rad"]))


def nothing_moved(arm: VirtualArm, since: int) -> bool:
    return not any(motion_frames(frames_sent(arm.sent[since:]), joint + 1, 0) for joint in ALL)


# --- a person


@pytest.mark.parametrize("person", [VirtualArm.stop, VirtualArm.hold])
@pytest.mark.parametrize("when", [still_faulted, asks_for_power, lambda arm: arm.memory["mode"] == Mode.BRINGING_UP])
def test_a_persons_stop_holds_the_arm_at_whatever_moment(
    moving: VirtualArm, person: Callable[[VirtualArm], None], when: Callable[[VirtualArm], bool]
) -> None:
    goes_silent(moving)
    is_heard(moving)
    moving.until(lambda: when(moving))
    person(moving)
    wait(moving, 2.0)
    assert moving.memory["operator"]["held"] == 1
    assert moving.end_of(moving.send_shift(0.01)) == Outcome.REFUSED_HELD


@pytest.mark.parametrize("request_", [Request.DISABLE, Request.FREE, Request.HOME, Request.REFERENCE])
def test_what_a_person_asks_of_an_arm_in_its_fault_is_refused_and_not_done_later(
    moving: VirtualArm, request_: Request
) -> None:
    goes_silent(moving)
    options = {"joint_mask": 1} if request_ in (Request.HOME, Request.REFERENCE) else {}
    assert moving.ask(request_, **options) not in (Answer.DONE, Answer.NONE)
    is_heard(moving)
    moving.until(lambda: healed(moving), at_most_s=3.0)
    memory = moving.memory
    assert (
        not memory["dialogue"]["release_asked"]
        and not memory["dialogue"]["home_asked"]
        and not memory["dialogue"]["reference_asked"]
    )


def test_an_arm_that_was_to_be_let_go_does_not_hold_again() -> None:
    """The drives never heard it; the person who has asked for it must not meet an arm that takes goals."""
    arm = VirtualArm.brought_up("episode1")
    arm.heal_by_itself()
    healing, arm.healing = arm.healing, None  # one conversation at a time, as in the control process
    assert isinstance(healing, Healing)
    for joint in ALL:
        drive_of(arm, joint).unplug(arm.now_ns)
    assert arm.ask(Request.DISABLE) == Answer.DONE
    release = arm.release()
    assert release.failure is not None and still_faulted(arm)
    assert not healing.succeeded(release, arm.now_ns)
    arm.healing = healing
    is_heard(arm)
    wait(arm)
    assert still_faulted(arm)
    arm.close()


@pytest.mark.parametrize("request_", [Request.HOME, Request.REFERENCE])
def test_what_a_person_asked_for_and_the_silence_has_ended_keeps_the_fault(request_: Request) -> None:
    """A person who says that a joint stands elsewhere must not meet an arm that goes on with the old angle."""
    arm = VirtualArm.brought_up("episode1")
    arm.heal_by_itself()
    healing, arm.healing = arm.healing, None
    assert isinstance(healing, Healing)
    assert arm.ask(request_, joint_mask=0b10, value=0.5) == Answer.DONE
    goes_silent(arm)
    talk = arm.reference()
    is_heard(arm)
    assert not healing.succeeded(talk, arm.now_ns)
    arm.healing = healing
    since = len(arm.sent)
    wait(arm)
    assert arm.memory["mode"] == Mode.FAULT
    assert nothing_moved(arm, since)
    arm.close()


def test_an_arm_that_hangs_limp_is_not_enabled() -> None:
    arm = VirtualArm.brought_up("episode1")
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release().failure is None
    arm.heal_by_itself()
    silence(arm)
    wait(arm)
    assert arm.memory["mode"] == Mode.FAULT
    assert not any(drive_of(arm, joint).enabled for joint in ALL)
    arm.close()


# --- a drive


def stalls(arm: VirtualArm) -> None:
    drive = drive_of(arm, 2)
    drive._reads[STATUS] = lambda: bytes((STATUS, drive.status_byte | 0x04))


def is_off_for_a_moment(arm: VirtualArm) -> None:
    """Shorter than the silence, so that it answers at the same moment as the others."""
    drive_of(arm, 4).power_off(arm.now_ns)
    arm.cycle()
    drive_of(arm, 4).power_on(arm.now_ns)


def lost_its_angle_before(arm: VirtualArm) -> None:
    """In an earlier silence, without a proof; that it can give one for this silence says nothing of that one."""
    arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] = Unreferenced.POSITION_JUMP


@pytest.mark.parametrize("what", [stalls, is_off_for_a_moment, lost_its_angle_before])
def test_a_drive_with_whom_anything_is_wrong_keeps_the_fault(
    moving: VirtualArm, what: Callable[[VirtualArm], None]
) -> None:
    goes_silent(moving)
    what(moving)
    moving.cycles(10)
    is_heard(moving)
    wait(moving)
    assert still_faulted(moving)


@pytest.mark.parametrize("late_s", [1.0, 5.0])
def test_a_drive_is_waited_for_that_has_not_told_yet_that_it_holds(moving: VirtualArm, late_s: float) -> None:
    """What it said before it stood counts for nothing: it may have gone limp since."""
    goes_silent(moving)
    is_heard(moving)
    while moving.now_ns < int(moving.memory["fault"]["latched_ns"]) + late_s * 1e9:
        moving.loop[0]["axes"][2]["drive"]["status_ns"] = int(moving.memory["fault"]["latched_ns"])
        moving.cycle()
        assert moving._healing_talk is None
    wait(moving, 2.0)
    assert healed(moving) == (late_s * 1e9 < DECIDED_WITHIN_NS)


def test_a_joint_that_kept_its_reference_and_was_pushed_away_keeps_the_fault(moving: VirtualArm) -> None:
    """It fell silent later than the others and was back in time; no following error is latched beside another fault."""
    for joint in set(ALL) - {3}:
        drive_of(moving, joint).unplug(moving.now_ns)
    moving.cycles(5)
    drive_of(moving, 3).unplug(moving.now_ns)
    moving.until(lambda: still_faulted(moving))
    is_heard(moving)
    assert moving.memory["fault"]["joint"] == -1
    for _ in range(30):
        push(moving, 3, 0.01)
        moving.cycle()
    assert moving.loop[0]["axes"][3]["reference"]["referenced"] == 1
    wait(moving)
    assert still_faulted(moving)


def test_a_joint_that_moves_is_waited_for(moving: VirtualArm) -> None:
    """Each time it moves its rest begins anew, and nothing is asked before."""
    goes_silent(moving)
    is_heard(moving)
    for _ in range(16):
        push(moving, 2, 0.01)
        moving.cycles(round(0.9 * REST_NS / moving.period_ns))
        push(moving, 2, -0.01)
        moved_ns = moving.now_ns
        moving.cycles(round(0.9 * REST_NS / moving.period_ns))
        assert not asks_for_power(moving)
    moving.until(lambda: asks_for_power(moving), at_most_s=1.0)
    assert moving.now_ns - moved_ns >= REST_NS
    moving.until(lambda: healed(moving), at_most_s=1.0)


def moves_on(arm: VirtualArm) -> None:
    push(arm, 2, 0.02)


def is_to_end(arm: VirtualArm) -> None:
    arm.memory["motion"]["closing"] = 1


def is_let_go(arm: VirtualArm) -> None:
    drive_of(arm, 2).disable(arm.now_ns)


def loses_its_angle(arm: VirtualArm) -> None:
    arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] = Unreferenced.POSITION_JUMP


@pytest.mark.parametrize("what", [moves_on, is_to_end, is_let_go, loses_its_angle])
def test_what_happens_while_the_drives_are_asked_for_their_power_counts(
    moving: VirtualArm, what: Callable[[VirtualArm], None]
) -> None:
    goes_silent(moving)
    is_heard(moving)
    moving.until(lambda: asks_for_power(moving))
    what(moving)
    # until the drive has told of it: its status is asked for in turn
    heal, moving.healing = moving.healing, None
    talk = moving._healing_talk
    assert talk is not None and heal is not None
    moving.until(lambda: talk.poll(moving.now_ns))
    moving.cycles(8)
    assert not heal.succeeded(talk, moving.now_ns)


# --- the wire


def test_a_controller_that_left_the_bus_under_the_fault_keeps_it(moving: VirtualArm) -> None:
    """Bus-off by itself would wait for a person, too; only the first fault stands in the snapshot."""
    goes_silent(moving)
    moving.memory["buses"][0]["transmit_inhibited"] = 1  # what `rtloop.bus.measured.take_error` does with it
    moving.state.record["counters"]["bus_state"] = BusState.BUS_OFF
    is_heard(moving)
    wait(moving)
    assert still_faulted(moving)


def test_a_wire_that_went_under_the_fault_keeps_it(moving: VirtualArm) -> None:
    goes_silent(moving)
    received.close(moving.loop[0]["buses"][0], 5)
    moving.cycles(20)
    moving.loop[0]["buses"][0]["received"]["arrived"]["closed"] = 0  # plugged in again
    is_heard(moving)
    wait(moving)
    assert still_faulted(moving)


def test_no_answer_of_before_is_taken_for_a_new_one(moving: VirtualArm) -> None:
    """What waited in the adapter comes at once: as long as it waited, an answer may be that old."""
    stall_ns = 400_000_000
    assert moving.sim is not None
    moving.sim.inject(ReceiveStall(0.0, stall_ns * 1e-9), moving.now_ns)
    began_ns = moving.now_ns
    moving.until(lambda: still_faulted(moving))
    moving.until(lambda: asks_for_power(moving))
    assert moving.now_ns - began_ns >= 2 * stall_ns - 100_000_000 + REST_NS


def test_a_second_silence_is_waited_out(moving: VirtualArm) -> None:
    """A loose plug: it is asked for power once, and not amid a silence."""
    silence(moving, 0.3)
    moving.cycles(3)  # the first answers tell how old they may be
    moving.until(lambda: int(max(moving.loop[0]["axes"]["tracking"]["lag_ns"][:6])) == 0)
    moving.cycles(round(0.55 * REST_NS / moving.period_ns))
    silence(moving, 0.7)
    moving.until(lambda: healed(moving), at_most_s=3.0)


def test_silences_that_go_on_keep_the_fault(moving: VirtualArm) -> None:
    """Though each is short, and the drives were heard in time."""
    silence(moving, 0.3)
    while moving.now_ns < int(moving.memory["fault"]["latched_ns"]) + DECIDED_WITHIN_NS + 200_000_000:
        moving.cycles(round(0.1e9 / moving.period_ns))
        silence(moving, 0.3)
    wait(moving)
    assert still_faulted(moving)


@pytest.mark.parametrize("restored", ["a mark that is found again", "a silence of more than a second"])
def test_it_is_tried_once(moving: VirtualArm, restored: str) -> None:
    goes_silent(moving)
    mark, moving.marks[2] = moving.marks[2], None
    if "silence" in restored:
        moving.marks[2] = mark
        wait(moving, 1.5)
    is_heard(moving)
    wait(moving, 1.5)
    moving.marks[2] = mark
    wait(moving)
    assert still_faulted(moving)


def test_the_next_fault_at_the_same_place_needs_a_rest_of_its_own(moving: VirtualArm) -> None:
    silence(moving)
    moving.until(lambda: healed(moving), at_most_s=3.0)
    healing, moving.healing = moving.healing, None  # the process is kept from looking meanwhile
    assert healing is not None
    wait(moving, 1.0)
    silence(moving, 0.15)
    wait(moving, 1.0)
    assert still_faulted(moving)
    assert healing.begin(moving.now_ns) is None


def test_it_stands_by_what_is_commanded_too() -> None:
    """The drives have stopped where they were heard again; what leads them has not come to rest yet."""
    quick = load_arm("episode1")
    slow = quick.joints[0].model_copy(update={"max_acceleration_rad_s2": 0.3})
    config = quick.model_copy(update={"joints": [slow, *quick.joints[1:]]})
    arm = VirtualArm.brought_up(config, start_rad=[0.0, -0.5, 0.5, 0.5, 0.0, 0.5])
    arm.heal_by_itself()
    arm.send_shift(0.4, 3.5)
    wait(arm, 1.75)
    silence(arm, 0.15)
    arm.until(lambda: asks_for_power(arm), at_most_s=4.0)
    assert not np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][:6])
    arm.close()


# --- what would act at once


def test_no_goal_of_before_or_of_the_fault_begins(moving: VirtualArm) -> None:
    epoch = int(moving.memory["goals"]["epoch"])
    goes_silent(moving)
    in_fault = moving.send_shift(0.02)
    assert moving.end_of(in_fault) == Outcome.REFUSED_MODE
    fault_epoch = int(moving.memory["goals"]["epoch"])
    is_heard(moving)
    moving.until(lambda: healed(moving), at_most_s=3.0)
    since = len(moving.sent)
    for before in (epoch, fault_epoch):
        assert moving.end_of(moving.send_shift(0.02, epoch=before)) == Outcome.REFUSED_OUTDATED
    assert moving.memory["dialogue"]["pose_due_ns"] == 0
    assert nothing_moved(moving, since)


def test_a_corrupt_ring_is_a_fault_again_after_it(moving: VirtualArm) -> None:
    """Only the first fault stands; what lasts is latched as soon as that is gone."""
    goes_silent(moving)
    moving.command.record["setpoints_written"][0] += 100
    is_heard(moving)
    moving.until(lambda: moving.memory["fault"]["code"] == Fault.COMMAND_RING, at_most_s=4.0)
    wait(moving)
    assert (moving.memory["mode"], moving.memory["fault"]["code"]) == (Mode.FAULT, Fault.COMMAND_RING)


def test_no_other_fault_is_cleared() -> None:
    arm = VirtualArm.brought_up("episode1")
    arm.heal_by_itself()
    arm.command.record["setpoints_written"][0] += 100
    wait(arm, 2.0)
    assert (arm.memory["mode"], arm.memory["fault"]["code"]) == (Mode.FAULT, Fault.COMMAND_RING)
    arm.close()


def test_silence_amid_its_own_bring_up_is_a_fault_that_stays(moving: VirtualArm) -> None:
    silence(moving)
    moving.until(lambda: moving.memory["mode"] == Mode.BRINGING_UP, at_most_s=3.0)
    silence(moving, 1.0)
    wait(moving)
    assert moving.memory["mode"] == Mode.FAULT


def test_a_machine_that_was_away_as_well_moves_nothing(moving: VirtualArm) -> None:
    """Suspended amid the silence, the clock's gap and the silence come together."""
    for joint in ALL:
        drive_of(moving, joint).unplug(moving.now_ns)
    moving.cycles(5)
    moving.suspend(0.5)
    moving.cycles(20)
    since = len(moving.sent)
    is_heard(moving)
    wait(moving)
    assert nothing_moved(moving, since)
    assert moving.sim is not None
    for joint in ALL:
        axis = moving.loop[0]["axes"][joint]
        true_rad = moving.sim.true_position_rad(joint, moving.sim.now_ns)
        assert (
            not axis["reference"]["referenced"] or abs(axis["measured"]["position_rad"] - true_rad) < KNOWN_WITHIN_RAD
        )


# --- other arms


def silent_arm(arm: VirtualArm) -> None:
    """All drives are silent for 0.3 s, and all is waited for."""
    arm.heal_by_itself()
    assert arm.sim is not None
    for joint in arm.arm.joints:
        arm.sim.inject(Silent(joint.name, 0.0, 0.3), arm.sim.now_ns)
    wait(arm, 5.0)


@pytest.mark.parametrize(
    ("drives", "goes_on"),
    [
        ([ZDT] * 2, True),
        ([ZDT], False),
        ([ZDT, ODRIVE], True),
        ([ZDT, MKS], False),
    ],
)
def test_an_arm_of_drives_that_prove_their_power_or_need_not(drives: list[dict[str, Any]], goes_on: bool) -> None:
    number = {"zdt": "address", "mks": "can_id", "odrive": "node_id"}
    config = arm_of([{**drive, number[drive["family"]]: n} for n, drive in enumerate(drives, 1)], rate_hz=100)
    arm = VirtualArm.brought_up(config)
    silent_arm(arm)
    assert (arm.memory["mode"] == Mode.HOLDING) == goes_on
    assert goes_on or arm.memory["fault"]["code"] == Fault.STALE_READING
    arm.close()


@pytest.mark.parametrize("powerless", [False, True])
def test_drives_that_report_their_positions(powerless: bool) -> None:
    arm = VirtualArm.brought_up(load_arm("episode1", overrides={"bus": {"positions": "reported"}}))
    arm.heal_by_itself()
    goes_silent(arm)
    if powerless:
        is_off_for_a_moment(arm)
    is_heard(arm)
    wait(arm)
    assert healed(arm) != powerless
    assert powerless == still_faulted(arm)
    arm.close()


@pytest.mark.parametrize("powerless", [False, True])
def test_motors_that_a_target_would_enable(powerless: bool) -> None:
    """Their encoders know their angles, so it is not for these that they prove their power."""
    arm = VirtualArm.brought_up("myactuator6")
    arm.heal_by_itself()
    assert arm.sim is not None
    motors: list[Any] = arm.sim.drives
    for motor in motors:
        motor.unplug(arm.now_ns)
    arm.until(lambda: still_faulted(arm))
    if powerless:
        motors[4].power_off(arm.now_ns)
        arm.cycle()
        motors[4].power_on(arm.now_ns)
    for motor in motors:
        motor.plug_in(arm.now_ns)
    wait(arm)
    assert healed(arm) != powerless
    assert [motor.enabled for motor in motors] == [motor is not motors[4] or not powerless for motor in motors]
    arm.close()


@pytest.mark.parametrize("seconds", [3.0, 30.0])
def test_motors_whose_uptime_proves_nothing_any_more_keep_their_fault(seconds: float) -> None:
    """They had been on for 0.2 s at the last bring-up, which proves something for 63 times as long."""
    arm = VirtualArm("myactuator6")
    assert arm.sim is not None
    motors: list[Any] = arm.sim.drives
    for motor in motors:
        motor.up_since_ns = arm.now_ns - 100_000_000
    assert arm.bring_up().failure is None
    arm.heal_by_itself()
    wait(arm, seconds)
    for motor in motors:
        motor.unplug(arm.now_ns)
    arm.until(lambda: still_faulted(arm))
    for motor in motors:
        motor.plug_in(arm.now_ns)
    wait(arm)
    assert healed(arm) == (seconds < 6.0) and still_faulted(arm) == (seconds > 6.0)
    assert all(motor.enabled for motor in motors)
    if still_faulted(arm):
        arm.clear_fault()  # a person's, who may enable what holds nothing
    assert healed(arm)
    arm.close()


def test_a_bring_up_that_nobody_has_asked_for_asks_a_motor_for_its_power_before_it_would_stop_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm = VirtualArm.brought_up("myactuator6")
    arm.marks[4] = None
    at_rest = myactuator_setup._at_rest

    def at_rest_of_others(joint: int, config: JointConfig) -> Any:
        assert joint != 4
        return at_rest(joint, config)

    monkeypatch.setattr(myactuator_setup, "_at_rest", at_rest_of_others)
    failure = arm.next_process().bring_up(heals=True).failure
    assert failure is not None and "joint5 does not prove that it had power all the time" in str(failure)
    arm.close()


def test_an_arm_whose_bring_up_tries_targets_does_not_go_on_by_itself() -> None:
    arm = VirtualArm.brought_up(load_arm("episode1", overrides={"bus": {"position_command": "FC"}}))
    arm.heal_by_itself()
    goes_silent(arm)
    is_heard(arm)
    wait(arm)
    assert still_faulted(arm)
    arm.close()
