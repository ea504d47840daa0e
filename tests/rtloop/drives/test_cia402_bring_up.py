"""Bring-up of CiA 402 drives: what is written, what is never let go, and what people are told."""

from collections.abc import Callable

import numpy as np
import pytest
from bring_up_rig import way
from motion_figures import sampled_truth
from virtual import VirtualArm

from config.loader import load_arm
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from shm.words import Answer, Mode, Request
from sim.drives import canopen, cia402
from sim.drives.cia402 import Cia402Drive
from sim.faults import Protection, Silent

JOINT = 1
"""The joint whose drive is broken."""


def an_arm(**options: object) -> VirtualArm:
    return VirtualArm("cia402_6", **options)


def holding_arm() -> VirtualArm:
    """An arm that holds, and a control process that knows nothing of it, as after a restart."""
    before = an_arm()
    assert before.bring_up().failure is None, before.told
    arm = an_arm()
    arm.sim, arm.now_ns = before.sim, before.now_ns
    before.close()
    return arm


def drive_of(arm: VirtualArm, joint: int = JOINT) -> Cia402Drive:
    drive = arm.sim.drives[joint]
    assert isinstance(drive, Cia402Drive)
    return drive


def told(arm: VirtualArm) -> list[tuple[int, bytes]]:
    """Every frame that was sent since the last look: identifier, bytes."""
    lines = b"".join(data for _, data in arm.sent).split(b"\r")
    arm.sent.clear()
    return [(int(line[1:4], 16), bytes.fromhex(line[5:].decode())) for line in lines if line[:1] == b"t"]


def stood(arm: VirtualArm, since_ns: int) -> bool:
    """Whether no shaft has moved by more than a count, to which the place of each is rounded."""
    return all(way(arm, joint, since_ns) <= config.encoder_count_rad for joint, config in enumerate(arm.arm.joints))


def powers_during(arm: VirtualArm, talk: Callable[[], object]) -> set[int]:
    """The power states that the broken joint's drive goes through meanwhile."""
    drive, seen = drive_of(arm), set()
    go = drive._go

    def watched(power: int) -> None:
        seen.add(power)
        go(power)

    drive._go = watched
    talk()
    drive._go = go
    return seen


def test_drives_that_were_just_switched_on_are_set_up_as_the_facts_say() -> None:
    arm = an_arm()
    assert arm.bring_up().failure is None, arm.told
    mine = [data for frame_id, data in told(arm) if frame_id == 0x601]
    wrote = [data for data in mine if data[0] in (0x23, 0x27, 0x2B, 0x2F)]
    mapped = [data for data in wrote if data[2] in (0x14, 0x16) and data[1] == 0]
    assert [data.hex(" ").upper() for data in mapped] == [
        "23 00 14 01 01 02 00 80",
        "2F 00 14 02 01 00 00 00",
        "2F 00 16 00 00 00 00 00",
        "23 00 16 01 10 00 40 60",
        "23 00 16 02 20 00 7A 60",
        "2F 00 16 00 02 00 00 00",
        "23 00 14 01 01 02 00 00",
    ]
    words = [int.from_bytes(data[4:6], "little") for data in wrote if data[1:3] == b"\x40\x60"]
    assert words == [0x06, 0x07, 0x0F]
    order = [data[1:3].hex() for data in wrote if data[1:3] in (b"\x60\x60", b"\x7a\x60", b"\x40\x60")]
    assert order == ["7a60", "6060", "4060", "4060", "7a60", "4060"], "its target is where it stands before it holds"
    drive = drive_of(arm, 0)
    assert drive.power == cia402.OPERATION_ENABLED and drive.state == canopen.OPERATIONAL
    assert [drive.number(0x60C2, sub) for sub in (1, 2)] == [4, -3]
    assert (drive.number(0x1017), drive.number(0x6007), drive.number(0x6060)) == (100, 0, cia402.CSP)
    assert drive.number(0x607A) == round(drive.counted * drive.counts)
    assert [pdo.valid for pdo in drive._receive + drive._transmit] == [True, False, False, False] * 2
    arm.close()


def test_a_drive_that_holds_is_told_nothing_that_it_knows() -> None:
    """As after a restart of rtarm: no write, no node out of operation, nothing moves."""
    arm = holding_arm()
    drive = drive_of(arm)
    since_ns = arm.sim.now_ns
    drive.objects[0x6007, 0].value = 0
    powers = powers_during(arm, arm.bring_up)
    frames = told(arm)
    assert powers == set() and drive.power == cia402.OPERATION_ENABLED
    assert {data[0] for frame_id, data in frames if frame_id > 0x600} == {0x40}
    assert {data[0] for frame_id, data in frames if frame_id == 0} == {canopen.START}
    assert arm.memory["mode"] == Mode.HOLDING and stood(arm, since_ns)
    arm.close()


@pytest.mark.parametrize("at_lost_connection", [0, 1, 2, 3])
def test_a_drive_that_holds_is_mapped_anew_without_being_let_go(at_lost_connection: int) -> None:
    """Its answers mean something else meanwhile, which must not be taken for positions of the joint."""
    arm = holding_arm()
    drive = drive_of(arm)
    drive.objects[0x6007, 0].value = at_lost_connection
    drive._transmit[0].mapped[1] = 0x60F4_0020
    since_ns = arm.sim.now_ns
    talk = []
    powers = powers_during(arm, lambda: talk.append(arm.bring_up()))
    assert talk[0].failure is None, arm.told
    assert powers == set() and drive.power == cia402.OPERATION_ENABLED
    arm.cycles(40)
    assert arm.memory["mode"] == Mode.HOLDING and stood(arm, since_ns)
    assert drive.number(0x6007) == 0, "it would let go when the host is silent"
    arm.close()


def test_a_drive_that_holds_and_cannot_be_mapped_is_left_holding() -> None:
    arm = holding_arm()
    drive = drive_of(arm)
    drive.remaps_in_operation = False
    drive._transmit[0].mapped[1] = 0x60F4_0020
    failure = arm.bring_up().failure
    assert failure is not None and failure.joint == JOINT
    assert "holds its joint" in str(failure) and "support the arm" in str(failure) and "08000022" in str(failure)
    assert drive.power == cia402.OPERATION_ENABLED
    arm.close()


def test_a_drive_on_its_way_in_another_mode_is_halted_and_then_led() -> None:
    arm = holding_arm()
    drive = drive_of(arm)
    for index, data in (
        (0x6060, b"\x01"),
        (0x607A, (drive.number(0x607A) + 20 * drive.counts).to_bytes(4, "little", signed=True)),
        (0x6040, b"\x1f\x00"),
    ):
        assert drive.put(index, 0, data) == 0
    arm.cycles(50)
    assert drive.shaft.speed != 0.0
    talk = []
    powers = powers_during(arm, lambda: talk.append(arm.bring_up()))
    assert talk[0].failure is None, arm.told
    assert powers <= {cia402.OPERATION_ENABLED} and drive.power == cia402.OPERATION_ENABLED
    since_ns = arm.sim.now_ns
    arm.cycles(50)
    assert (drive.number(0x6060), drive.number(0x6040)) == (cia402.CSP, 0x0F)
    assert stood(arm, since_ns) and abs(drive._error()) <= 1
    arm.close()


def test_a_drive_in_a_quick_stop_that_holds_goes_on_where_it_is() -> None:
    arm = holding_arm()
    drive = drive_of(arm)
    drive.objects[0x605A, 0].value = 6
    assert drive.put(0x6040, 0, b"\x02\x00") == 0
    assert drive.power == cia402.QUICK_STOP
    since_ns = arm.sim.now_ns
    talk = []
    powers = powers_during(arm, lambda: talk.append(arm.bring_up()))
    assert talk[0].failure is None and powers == {cia402.OPERATION_ENABLED} and stood(arm, since_ns)
    arm.close()


def test_a_node_that_was_stopped_is_started() -> None:
    arm = an_arm()
    drive_of(arm).state = canopen.STOPPED
    assert arm.bring_up().failure is None, arm.told
    arm.close()


def test_monitoring_of_the_host_is_taken_back() -> None:
    """Nobody sends what it would wait for; it would fail, and let the joint go."""
    arm = an_arm()
    drive_of(arm).objects[0x1016, 1].value = 0x007F_0064
    assert arm.bring_up().failure is None, arm.told
    assert drive_of(arm).number(0x1016, 1) == 0
    arm.close()


def test_an_error_is_named_and_cleared_only_when_a_person_asks() -> None:
    arm = an_arm(faults=[Protection("joint2", 0.0, cause="temperature")])
    arm.cycles(3)
    failure = arm.bring_up().failure
    assert failure is not None and "over-temperature, error code 4310" in str(failure)
    assert drive_of(arm).power == cia402.FAULT
    assert not [data for frame_id, data in told(arm) if frame_id == 0x602 and data[1:3] == b"\x40\x60"]
    assert arm.bring_up(clears_protection=True).failure is None, arm.told
    assert drive_of(arm).power == cia402.OPERATION_ENABLED
    arm.close()


def refuse(index: int, sub: int = 0) -> Callable[[Cia402Drive], None]:
    def break_it(drive: Cia402Drive) -> None:
        drive.objects[index, sub].write = lambda value: canopen.WRONG_VALUE

    return break_it


def put(index: int, value: int) -> Callable[[Cia402Drive], None]:
    def break_it(drive: Cia402Drive) -> None:
        drive.objects[index, 0].value = value

    return break_it


def ignore(index: int) -> Callable[[Cia402Drive], None]:
    def break_it(drive: Cia402Drive) -> None:
        drive.objects[index, 0].write = lambda value: 0

    return break_it


def be_stuck(drive: Cia402Drive) -> None:
    drive.objects[0x6061, 0].read = lambda: 3


def be_deaf_to_syncs(drive: Cia402Drive) -> None:
    drive._sync = lambda: None


@pytest.mark.parametrize(
    ("break_it", "said"),
    [
        (put(0x1000, 0x0003_0191), ["Node 2", "0x00030191", "0x0192", "node_id"]),
        (put(0x6502, 0x25), ["cannot do cyclic synchronous position", "0x25"]),
        (refuse(0x6060), ["does not take 8 for object 6060:00", "abort code 06090030"]),
        (refuse(0x1600, 1), ["1600:01", "abort code 06090030"]),
        (refuse(0x60C2, 1), ["does not take 4 ms", "control.rate_hz"]),
        (be_stuck, ["stays in mode 3", "6061"]),
        (ignore(0x6040), ["state switch-on disabled", "ready to switch on", "safe torque off"]),
        (be_deaf_to_syncs, ["with each SYNC", "8 bytes", "182"]),
    ],
)
def test_what_hinders_is_said_and_nothing_moves(break_it: Callable[[Cia402Drive], None], said: list[str]) -> None:
    arm = an_arm()
    break_it(drive_of(arm))
    failure = arm.bring_up().failure
    assert failure is not None and failure.joint == JOINT
    for words in (" joint2 ", *said):
        assert words in str(failure), str(failure)
    assert arm.memory["mode"] == Mode.FAULT and stood(arm, arm.sim.start_ns)
    arm.close()


def keep(drive: Cia402Drive) -> None:
    drive.objects[0x6007, 0].writable = False


def have_none(drive: Cia402Drive) -> None:
    for sub in range(3):
        del drive.objects[0x60C2, sub]
    drive._beat_ns = lambda: 4_000_000


@pytest.mark.parametrize(("break_it", "said"), [(keep, "lets the joint go"), (have_none, "targets come every 4 ms")])
def test_what_may_matter_is_told(break_it: Callable[[Cia402Drive], None], said: str) -> None:
    arm = an_arm()
    break_it(drive_of(arm))
    assert arm.bring_up().failure is None
    assert [sentence for sentence in arm.told if "joint2" in sentence and said in sentence]
    arm.close()


def test_no_target_enables_a_drive_that_was_let_go() -> None:
    arm = an_arm()
    assert arm.bring_up().failure is None
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release().failure is None
    for joint in range(6):
        drive = drive_of(arm, joint)
        assert drive.power == cia402.SWITCH_ON_DISABLED
        assert drive.put(0x6040, 0, b"\x0f\x00") == 0
        assert drive.power == cia402.SWITCH_ON_DISABLED
    arm.close()


def test_in_silence_drives_hold_where_they_were_told_last() -> None:
    """The control process dies amid a goal: a period of motion further each joint stands, and none is let go."""
    arm = VirtualArm.amid("large", 400, arm="cia402_6")
    last = {frame_id & 0x7F: data for frame_id, data in told(arm) if frame_id & 0x780 == 0x200}
    died_ns = arm.sim.now_ns
    arm.sim.run_until(died_ns + 2_000_000_000)
    for joint, config in enumerate(arm.arm.joints):
        drive = drive_of(arm, joint)
        assert drive.power == cia402.OPERATION_ENABLED
        target = int.from_bytes(last[joint + 1][2:], "little", signed=True)
        assert abs(round(drive.counted * drive.counts) - target) <= 1
        _, position_rad, _ = sampled_truth(arm.sim, joint, died_ns, arm.sim.now_ns)
        way = abs(position_rad - position_rad[0]).max()
        coast = config.max_velocity_rad_s**2 / (2 * config.max_acceleration_rad_s2)
        assert way <= config.max_velocity_rad_s * 2 * arm.period_ns * 1e-9 + coast
    arm.close()


def test_a_drive_that_comes_back_is_stopped_where_it_is() -> None:
    """Away for half a second amid a goal it held its last target; what it hears first is not what was due since."""
    arm = VirtualArm.amid("large", 400, arm="cia402_6")
    arm.sim.inject(Silent("joint2", 0.0, 0.5), since_ns=arm.sim.now_ns)
    arm.cycles(100)
    stood_ns = arm.sim.now_ns
    arm.cycles(200)
    assert way(arm, JOINT, stood_ns) <= 2 * arm.arm.joints[JOINT].encoder_count_rad
    arm.close()


def test_the_example_arm_can_be_slower_and_faster() -> None:
    for rate_hz in (100, 500):
        arm = VirtualArm.brought_up(load_arm("cia402_6", overrides={"control": {"rate_hz": rate_hz}}))
        drive = drive_of(arm, 0)
        assert drive._beat_ns() == arm.period_ns
        arm.close()


def test_a_drive_that_was_not_led_for_a_while_is_not_rushed_to_the_setpoint() -> None:
    """Away for less than what is a fault: the setpoint has gone on, and the drive would be there within a period."""
    arm = VirtualArm.amid("large", 400, arm="cia402_6")
    joint, drive = 3, drive_of(arm, 3)
    since_ns, goes_rad_s = arm.sim.now_ns, abs(arm.loop[0]["axes"][joint]["commanded"]["velocity_rad_s"])
    drive.unplug(since_ns)
    arm.cycles(15)
    drive.plug_in(arm.sim.now_ns)
    arm.cycles(100)
    assert arm.memory["mode"] == Mode.EXECUTING
    _, _, velocity_rad_s = sampled_truth(arm.sim, joint, since_ns, arm.sim.now_ns)
    most = goes_rad_s + ERROR_SPEED_SHARE * arm.arm.joints[joint].max_velocity_rad_s
    assert np.abs(velocity_rad_s).max() <= 1.2 * most
    arm.close()


def test_a_drive_whose_answers_are_lost_stands_at_its_last_target() -> None:
    """It hears, and would jump back to where it was heard of last if that were its stop."""
    arm = VirtualArm.amid("large", 400, arm="cia402_6")
    drive = drive_of(arm, 3)
    drive.reply_loss = 1.0
    arm.sent.clear()
    arm.cycles(200)
    assert arm.memory["mode"] == Mode.FAULT
    targets = [int.from_bytes(data[2:], "little", signed=True) for frame_id, data in told(arm) if frame_id == 0x204]
    assert targets == sorted(targets), "never back"
    assert abs(drive._position() - targets[-1]) <= 1
    arm.close()
