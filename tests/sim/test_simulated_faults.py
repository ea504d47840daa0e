"""Each fault of the simulated arm does what its description says, and nothing before its time."""

from __future__ import annotations

from dataclasses import MISSING, fields

import pytest
from sim_host import MILLISECOND, START_NS, Host, connect, move, read

from config.loader import load_arm
from sim import faults as wrong
from sim.arm import SimulatedArm

AT_S = 0.1


@pytest.fixture(scope="module")
def episode1():
    return load_arm("episode1", overrides={"bus": {"serial_baud": "cdc"}})


@pytest.fixture
def broken(episode1):
    """Makes a host of an arm with a fault that begins when it is used first."""

    def make(*faults: wrong.Fault) -> Host:
        host = connect(SimulatedArm(episode1, start_ns=START_NS, faults=faults))
        assert host.position(1) is not None  # the fault has not begun
        host.wait(AT_S * 1e3)
        return host

    return make


def test_every_fault_can_be_written_on_the_command_line(episode1):
    with_gripper = load_arm("episode1", overrides={"gripper": {"hook": "servo", "servo": {"address": 7}}})
    for name, kind in wrong.FAULTS.items():
        needed = [field.name for field in fields(kind) if field.default is MISSING]
        values = {field: "joint2" if field == "joint" else "0.5" for field in needed}
        fault = wrong.parse_fault(f"{name}:" + ",".join(f"{key}={value}" for key, value in values.items()))
        SimulatedArm(with_gripper, faults=[fault])
        if not isinstance(fault, wrong.Thing):
            SimulatedArm(episode1, faults=[fault])


def test_nothing_stands_between_the_fingers_of_an_arm_without_a_gripper(episode1):
    with pytest.raises(ValueError, match="no fault this arm can have"):
        SimulatedArm(episode1, faults=[wrong.Thing(0.5, 40.0)])


def test_a_cause_is_one_of_those_there_are():
    assert wrong.parse_fault("protection:joint=joint1,at_s=1,cause=current") == wrong.Protection(
        "joint1", 1.0, cause="current"
    )
    with pytest.raises(ValueError, match="must be one of stall, temperature, current"):
        wrong.parse_fault("protection:joint=joint1,at_s=1,cause=bees")


def test_replies_come_twice(broken):
    host = broken(wrong.DuplicateReplies(1.0, gap_s=0.001, at_s=AT_S))
    host.say(read(1))
    first, second = host.frames(3)
    assert first == second


def test_a_late_reply_is_overtaken(broken):
    host = broken(wrong.LateReplies(1.0, late_s=0.005, at_s=AT_S, joint="joint1"))
    host.say(read(1) + read(2))
    assert [text[:9] for text in host.frames(10)] == ["T00000200", "T00000100"]


@pytest.mark.parametrize("rest_s", [None, 0.004])
def test_lines_break_off(broken, rest_s):
    host = broken(wrong.CutLines(1.0, rest_s=rest_s, at_s=AT_S))
    host.say(read(1))
    host.now_ns += 2 * MILLISECOND
    begun = host.arm.collect(host.now_ns).replace(b"Z\r", b"")
    assert 0 < len(begun) < 25
    assert b"\r" not in begun
    host.now_ns += 10 * MILLISECOND
    rest = host.arm.collect(host.now_ns)
    assert rest == b"" if rest_s is None else len(begun + rest) == 25


def test_checksums_and_values_are_wrong(broken):
    host = broken(
        wrong.WrongChecksums(1.0, at_s=AT_S, joint="joint1"), wrong.WrongValues(1.0, 2.0, at_s=AT_S, joint="joint2")
    )
    host.say(read(1))
    (answer,) = host.frames(2)
    assert not answer.endswith("6B")
    counts = {host.position(2) for _ in range(20)}
    true = host.position(3)
    assert len(counts) > 10
    assert all(abs(count - 5.0 * 65536) <= 2.0 / 360 * 20 * 65536 + 1 for count in counts)
    assert host.position(3) == true


def test_nobody_is_heard_beside_the_highest_priority(broken):
    host = broken(wrong.Babble(AT_S, until_s=AT_S + 0.05))
    host.say(read(1))
    heard = host.wait(20)
    assert len(heard) > 100
    assert not [text for text in heard if text.startswith("T")]
    host.wait(40)
    assert host.position(2) is not None
    assert len(host.wait(5)) == 0


def test_a_babbling_drive_repeats_its_position(broken):
    host = broken(wrong.Babble(AT_S, joint="joint3"))
    texts = host.frames(10)
    assert len(texts) > 20
    (babble,) = set(texts) - {"T00000300300EE6B"}  # the drive takes them for bad requests
    assert babble.startswith("T0000030073600")
    assert host.position(1) is not None  # a higher priority


def test_a_stalled_adapter_keeps_some_frames_and_says_them_at_once(broken):
    host = broken(wrong.ReceiveStall(AT_S, stall_s=0.05, depth=3))
    host.say(b"".join(read(1 + index % 6) for index in range(6)))
    assert host.frames(40) == []
    texts = host.frames(20)
    assert len(texts) == 3
    assert host.arm.adapter.lost_receptions == 3
    host.say(b"F\r")
    assert "F01" in host.wait(1)


def test_a_small_transmit_buffer_overflows_while_it_is_small(broken):
    host = broken(wrong.TransmitOverflow(2, AT_S, until_s=AT_S + 0.02))
    host.say(read(1) * 6)
    assert len(host.frames(5)) < 6
    assert host.arm.adapter.lost_frames > 0
    host.wait(20)
    host.say(read(1) * 6)
    assert len(host.frames(20)) == 6


def test_bels_are_frames_that_were_not_sent(broken):
    host = broken(wrong.Bels(0.5, at_s=AT_S))
    answered = []
    for _ in range(100):
        host.say(read(1))
        host.now_ns += 2 * MILLISECOND
        said = host.arm.collect(host.now_ns)
        answered.append(b"T00000100" in said)
        assert (b"\x07" in said) != answered[-1]
    assert 20 < sum(answered) < 80


def test_a_blocked_adapter_takes_characters_again(broken):
    host = broken(wrong.SerialBlocked(AT_S, until_s=AT_S + 0.02))
    assert not host.arm.adapter.takes_characters
    host.wait(20)
    assert host.arm.adapter.takes_characters


def test_a_refusing_drive_finishes_what_it_was_told(broken):
    host = broken(wrong.Refusing("joint2", AT_S + 0.05, until_s=AT_S + 5))
    host.say(move(2, 16000 + 3200, 60))
    host.wait(60)
    host.say(move(2, 0, 60))
    host.wait(2000)
    assert host.arm.true_position_rad(1, host.now_ns) == pytest.approx(2 * 3.14159265 / 20, abs=1e-4)
    assert host.arm.drives[1].status_byte & 1 == 1


def test_a_count_slips_or_wraps_and_the_shaft_does_not(broken):
    host = broken(wrong.CountSlip("joint1", AT_S, deg=36.0), wrong.CountWrap("joint2", AT_S))
    assert host.position(1) == pytest.approx((12.5 + 2.5) * 65536, abs=2)
    assert host.position(2) == 5 * 65536 - 2**32
    for joint in range(2):
        assert abs(host.arm.true_position_rad(joint, host.now_ns)) < 1e-3


def test_two_drives_of_one_address_take_each_others_answers_for_bad_requests(broken):
    host = broken(wrong.SameAddress("joint2", AT_S))
    host.say(read(2))
    first, second, *refusals = host.frames(20)
    assert first != second
    assert len(refusals) > 20
    assert set(refusals) == {"T00000200300EE6B"}
