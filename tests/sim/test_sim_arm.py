"""The simulated arm as a whole: bytes in, bytes out, truth, and faults, in virtual time."""

from __future__ import annotations

import pytest
from sim_host import MILLISECOND, START_NS, Host, connect, line, move, read

from config.loader import load_arm
from sim.arm import SimulatedArm
from sim.bus import Frame, frame_bits
from sim.drives.ramp import GRAINS_PER_REVOLUTION
from sim.faults import (
    CorruptBytes,
    LostReplies,
    OpenRefused,
    PowerLoss,
    Silent,
    Stall,
    parse_fault,
)


@pytest.fixture(scope="module")
def episode1():
    return load_arm("episode1", overrides={"bus": {"serial_baud": "cdc"}})


@pytest.fixture
def host(episode1):
    return connect(SimulatedArm(episode1, start_ns=START_NS))


def test_a_homed_arm_stands_at_joint_zero(host, episode1):
    turns = (12.5, 5.0, 5.764, 0.833, 1.222, 0.083)  # motor turns at the zero pose, episode1-arm.md
    for index, expected in enumerate(turns):
        counts = host.position(index + 1)
        assert counts is not None
        assert counts / 65536 == pytest.approx(expected, abs=6e-4)
        pulse_rad = episode1.joints[index].command_pulse_rad
        assert abs(host.arm.true_position_rad(index, host.now_ns)) <= pulse_rad / 2
    assert host.arm.drives[0].status_byte == 0x03


def test_an_answer_takes_bus_time_and_processing(host):
    request, answer = Frame(0x100, b"\x36\x6b"), Frame(0x100, bytes.fromhex("36 00 00 0C 80 00 6B"))
    bus_ns = (frame_bits(request) + frame_bits(answer) - 6) * 2000
    sent_ns = host.now_ns
    host.say(read(1))
    due_ns = None
    for _ in range(20):
        due_ns = host.arm.next_due_ns()
        if due_ns is None or b"T" in host.arm.collect(due_ns):
            break
    assert due_ns is not None
    assert 200_000 <= due_ns - sent_ns - bus_ns <= 400_000
    assert host.arm.next_due_ns() is None


def test_asking_when_never_hides_bytes(host):
    """Collecting only when told gives the same bytes at the same times as looking every 10 us."""
    eager, lazy = host.arm, connect(SimulatedArm(host.arm.config, start_ns=START_NS)).arm
    request = b"".join(read(address) for address in range(1, 7)) + line(3, b"\x43\x7a\x6b")
    start_ns = host.now_ns
    eager.feed(start_ns, request)
    lazy.feed(start_ns, request)
    seen = []
    for now_ns in range(start_ns, start_ns + 20 * MILLISECOND, 10_000):
        if data := eager.collect(now_ns):
            seen.append((now_ns, data))
    told = []
    while (due_ns := lazy.next_due_ns()) is not None:
        assert due_ns >= lazy.now_ns
        if data := lazy.collect(due_ns):
            told.append((due_ns, data))
    assert b"".join(data for _, data in told) == b"".join(data for _, data in seen)
    for (exact_ns, data), (rounded_ns, same) in zip(told, seen, strict=True):
        assert data == same
        assert 0 <= rounded_ns - exact_ns < 10_000


def test_a_cycle_of_episode1_loads_the_bus_as_the_facts_say(host):
    """Six FD, six readings and a status: below the worst case of 3,450 bits, above the bare frames."""
    before_ns = host.arm.bus.busy_ns
    for drive in host.arm.drives:
        host.say(line(drive.settings.address, b"\xfe\x98\x00\x6b"))
    host.wait(10)
    before_ns = host.arm.bus.busy_ns
    host.say(b"".join(move(a, 40_000, 100, 215) + read(a) for a in range(1, 7)) + read(1, 0x3A))
    assert len(host.frames(20)) == 6 + 6 + 1
    bits = (host.arm.bus.busy_ns - before_ns) / 2000
    assert 6 * (131 + 107 + 91 + 83 + 123) < bits < 6 * (290 + 110 + 100 + 150) + 210


def test_serial_time_delays_and_limits(episode1):
    slow = episode1.on_every_bus(serial_baud=115200)
    host = connect(SimulatedArm(slow))
    host.say(read(1))
    host.wait(2.0)  # 15 characters out, 25 characters back: 3.5 ms
    assert not host.frames(0)
    assert len(host.frames(3)) == 1


def test_a_flooded_buffer_overflows(host):
    host.say(read(1) * 100)
    answers = host.wait(100)
    assert "".join(answers).count("\x07") == 100 - 64
    assert host.arm.adapter.lost_frames == 36


def test_time_does_not_run_backwards(host):
    with pytest.raises(ValueError, match="backwards"):
        host.arm.collect(host.now_ns - 1)


def test_only_zdt_drives_and_one_position_a_joint(episode1):
    with pytest.raises(ValueError, match="mock"):
        SimulatedArm(load_arm("mock"))
    with pytest.raises(ValueError, match="5 joint positions"):
        SimulatedArm(episode1, joint_position_rad=[0.0] * 5)


def test_homing_run_finds_the_stop_of_every_joint(episode1):
    host = connect(SimulatedArm(episode1, homed=False, joint_position_rad=[-3.0, -1.4, -1.3, 0, -1.5, 0]))
    assert host.position(1) == 0
    host.say(b"".join(line(a, b"\x9a\x02\x00\x6b") for a in range(1, 7)))
    host.wait(30_000)
    for address in range(1, 7):
        assert host.position(address) == 0
        joint = episode1.joints[address - 1]
        truly = host.arm.true_position_rad(address - 1, host.now_ns)
        assert truly == pytest.approx(joint.lower_rad, abs=1e-9)
    assert host.arm.drives[0].homing_byte == 0x03


# --- faults ---------------------------------------------------------------------------------------------


def test_refused_opening(episode1):
    host = Host(SimulatedArm(episode1, faults=[OpenRefused()]))
    host.say(b"S6\rO\r")
    assert "\x07" in host.arm.collect(host.now_ns).decode()


def test_corrupt_bytes(episode1):
    host = connect(SimulatedArm(episode1, faults=[CorruptBytes(0.05, at_s=0.1)]))
    assert all(host.position(1) is not None for _ in range(20))
    host.wait(100)
    assert not all(host.position(1) is not None for _ in range(20))


def test_fault_of_an_unknown_joint(episode1):
    with pytest.raises(ValueError, match="no joint 'elbow'"):
        SimulatedArm(episode1, faults=[Stall("elbow", 0.0)])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("silent:joint=joint2,at_s=3", Silent("joint2", 3.0)),
        ("power-loss:joint=joint1,at_s=2,off_s=0.25", PowerLoss("joint1", 2.0, 0.25)),
        ("open-refused", OpenRefused()),
        ("lost-replies:share=0.1", LostReplies(0.1)),
    ],
)
def test_faults_as_written(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("explosion", "there is no fault 'explosion'"),
        ("silent:when=3", "knows no field 'when'"),
        ("silent:at_s=3", "needs joint"),
        ("stall:joint=joint1,at_s=soon", "must be a number"),
    ],
)
def test_faults_badly_written(text, sentence):
    with pytest.raises(ValueError, match=sentence):
        parse_fault(text)


def test_a_stop_is_where_the_lower_limit_is(episode1):
    arm = SimulatedArm(episode1)
    assert [drive.shaft.low for drive in arm.drives] == [0] * 6
    assert arm.drives[0].shaft.position_at(0) == 12.5 * GRAINS_PER_REVOLUTION
