"""The simulated arm with drives that are no ZDT: what is true of them, what can go wrong with them, and mixed buses."""

from __future__ import annotations

import math
import struct
from dataclasses import MISSING, fields

import numpy as np
import pytest
from sim_host import MILLISECOND, START_NS, Host, read

from config.drives.odrive import OdriveDrive as OdriveConfig
from config.loader import load_arm
from config.schema import ArmConfig
from config.serial_adapters import SLCAN_BITRATES
from sim.arm import SimulatedArm
from sim.drives.odrive import CLOSED_LOOP, IDLE, OdriveDrive
from sim.drives.zdt import ZdtDrive
from sim.faults import (
    FAULTS,
    Babble,
    CountSlip,
    CountWrap,
    CutLines,
    Disabled,
    DuplicateReplies,
    Fault,
    ForeignFirmware,
    KeepsSettings,
    LostReplies,
    PowerLoss,
    Protection,
    Refusing,
    SameAddress,
    Silent,
    SlowReplies,
    Stall,
    Thing,
    WrongChecksums,
    WrongValues,
    parse_fault,
)

AT_S = 0.1
OF_ZDT_ALONE = (Refusing, CountSlip, CountWrap, KeepsSettings, ForeignFirmware, WrongChecksums, WrongValues, Thing)


def with_odrives(arm: ArmConfig, *joints: int, **options: object) -> ArmConfig:
    """The arm with ODrives of nodes 1 and up at some of its joints, which send nothing by themselves but heartbeats."""
    changed = [
        joint.model_copy(
            update={"drive": OdriveConfig(family="odrive", node_id=index + 1, **({"estimates_ms": 0} | options))}
        )
        if index in joints
        else joint
        for index, joint in enumerate(arm.joints)
    ]
    return arm.model_copy(update={"joints": changed})


@pytest.fixture(scope="module")
def episode1() -> ArmConfig:
    return load_arm("episode1", overrides={"bus": {"serial_baud": "cdc"}})


@pytest.fixture(scope="module")
def odrives(episode1) -> ArmConfig:
    return with_odrives(episode1, *range(6))


@pytest.fixture(scope="module")
def mixed(episode1) -> ArmConfig:
    """ZDT drives but for an ODrive at joint 2."""
    return with_odrives(episode1, 1)


class Talker(Host):
    """A host that speaks standard frames as well."""

    def send(self, node: int, command: int, data: bytes) -> None:
        self.say(b"t%03X%d%s\r" % (node << 5 | command, len(data), data.hex().upper().encode()))

    def close_loop(self, *nodes: int) -> None:
        for node in nodes:
            self.send(node, 0x07, struct.pack("<I", 8))
        self.wait(5)

    def go(self, node: int, turns: float) -> None:
        self.send(node, 0x0C, struct.pack("<fhh", turns, 0, 0))

    def lines(self, node: int, command: int, milliseconds: float) -> list[bytes]:
        """The data of its frames with this identifier."""
        head = f"t{node << 5 | command:03X}8"
        texts = self.wait(milliseconds)
        return [bytes.fromhex(text[5:21]) for text in texts if text.startswith(head) and len(text) == 21]

    def turns(self, node: int) -> float | None:
        """Where a drive says it is, if it answers within 2 ms."""
        self.say(b"r%03X8\r" % (node << 5 | 0x09))
        answers = self.lines(node, 0x09, 2)
        return struct.unpack("<ff", answers[-1])[0] if answers else None

    def count(self, address: int) -> int | None:
        """Where a ZDT drive says it is."""
        self.say(read(address))
        texts = [text for text in self.wait(4) if text.startswith(f"T{address << 8:08X}7")]
        return int(texts[0][14:22], 16) if texts else None


def talk(arm: ArmConfig, *faults: Fault, **options) -> Talker:
    host = Talker(SimulatedArm(arm, start_ns=START_NS, faults=faults, **options))
    host.say(f"{SLCAN_BITRATES[arm.bus.bitrate]}\rO\r".encode())
    host.wait(1)
    return host


@pytest.fixture
def broken(odrives):
    """A host of six ODrives that hold, with a fault that has just begun."""

    def make(*faults: Fault) -> Talker:
        host = talk(odrives, *faults)
        host.close_loop(*range(1, 7))
        assert host.turns(1) is not None
        host.wait(AT_S * 1e3)
        return host

    return make


# --- truth ----------------------------------------------------------------------------------------------


def test_a_drive_tells_and_truth_knows_where_the_joint_stands(odrives):
    start = [0.1, -0.2, 0.3, 0.4, -0.5, 0.6]
    host = talk(odrives, joint_position_rad=start)
    for index, (joint, position_rad) in enumerate(zip(odrives.joints, start, strict=True)):
        assert host.arm.true_position_rad(index, START_NS) == pytest.approx(position_rad, abs=1e-12)
        told = host.turns(index + 1)
        assert told is not None
        count_rad = 2 * math.pi / joint.ratio / 8192
        said_rad = joint.direction * told * 2 * math.pi / joint.ratio - joint.zero_rad
        assert said_rad == pytest.approx(position_rad, abs=0.51 * count_rad + 1e-6)


@pytest.mark.parametrize("direction", [1, -1])
def test_truth_follows_a_joint_either_way_round(odrives, direction):
    joints = [odrives.joints[0].model_copy(update={"direction": direction}), *odrives.joints[1:]]
    host = talk(odrives.model_copy(update={"joints": joints}))
    host.close_loop(1)
    before = host.turns(1)
    host.go(1, before + 0.5)
    host.wait(3000)
    away_rad = direction * 0.5 * 2 * math.pi / joints[0].ratio
    assert host.arm.true_position_rad(0, host.now_ns) == pytest.approx(away_rad, abs=2e-5)
    times_ns = host.arm.truth_changes(0)
    position_rad, velocity_rad_s = host.arm.truth(0, times_ns)
    assert np.allclose(np.diff(position_rad), velocity_rad_s[:-1] * np.diff(times_ns) * 1e-9, atol=1e-12)
    middle_ns = int(times_ns[len(times_ns) // 2])
    assert host.arm.true_velocity_rad_s(0, middle_ns) * direction > 0.0
    assert host.arm.true_position_rad(0, middle_ns) == pytest.approx(position_rad[len(times_ns) // 2])


def test_an_arm_that_was_just_switched_on_counts_from_where_it_stands(episode1):
    arm = with_odrives(with_odrives(episode1, 0, 1), 1, encoder="absolute")
    host = talk(arm, homed=False, joint_position_rad=[0.3] * 6)
    assert host.turns(1) == 0.0
    assert host.turns(2) == pytest.approx((0.3 + arm.joints[1].zero_rad) * arm.joints[1].ratio / 2 / math.pi, abs=1e-4)
    assert host.arm.true_position_rad(0, host.now_ns) == pytest.approx(0.3)


def test_families_share_a_bus_and_do_not_hear_each_other(mixed):
    host = talk(mixed)
    assert [type(drive) for drive in host.arm.drives] == [ZdtDrive, OdriveDrive, *[ZdtDrive] * 4]
    assert host.count(1) == 12.5 * 65536
    assert host.count(2) is None
    assert host.turns(2) == pytest.approx(5.0)
    assert host.turns(1) is None
    assert len(host.lines(2, 0x01, 1000)) == 10


def test_the_same_seed_gives_the_same_bytes_and_another_other_ones(mixed):
    def run(seed: int) -> list[list[str]]:
        host = talk(mixed, LostReplies(0.2), seed=seed)
        host.close_loop(2)
        texts = []
        for tick in range(50):
            host.go(2, 5.0 + tick * 0.01)
            host.say(read(1) + b"r0498\r")
            texts.append(host.wait(3))
        return texts

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_many_drives_of_one_arm_stand_in_one_bus(episode1):
    joints = [episode1.joints[1].model_copy(update={"name": f"j{index}"}) for index in range(32)]
    arm = with_odrives(episode1.model_copy(update={"joints": joints}), *range(32))
    host = talk(arm)
    assert host.turns(32) == pytest.approx(5.0)
    assert sum(len(host.lines(node, 0x01, 100)) for node in range(1, 33)) == 32


# --- faults ---------------------------------------------------------------------------------------------


def test_every_fault_is_one_that_these_drives_can_have_or_is_refused_in_a_sentence(odrives):
    for name, kind in FAULTS.items():
        needed = [field.name for field in fields(kind) if field.default is MISSING]
        fault = parse_fault(f"{name}:" + ",".join(f"{key}={'joint2' if key == 'joint' else '0.5'}" for key in needed))
        arm = SimulatedArm(odrives)
        if kind in OF_ZDT_ALONE:
            with pytest.raises(ValueError, match="no fault this arm can have"):
                arm.inject(fault)
        else:
            arm.inject(fault)


def test_faults_of_zdt_drives_strike_those_of_a_mixed_arm(mixed):
    SimulatedArm(mixed, faults=[WrongChecksums(0.5), CountSlip("joint1", 0.5, 3.0)])
    with pytest.raises(ValueError, match="no fault this arm can have"):
        SimulatedArm(mixed, faults=[CountSlip("joint2", 0.5, 3.0)])


def test_a_silent_drive_goes_on_with_what_it_was_told(broken):
    host = broken(Silent("joint1", AT_S, until_s=AT_S + 1.0))
    assert host.turns(1) is None
    assert host.turns(2) is not None
    host.wait(1000)
    assert host.turns(1) == pytest.approx(12.5)
    assert host.arm.drives[0].state == CLOSED_LOOP


def test_an_answer_that_was_ready_when_the_plug_came_loose_is_never_sent(odrives):
    host = talk(odrives, SlowReplies(0.01, joint="joint1"), Silent("joint1", AT_S, until_s=AT_S + 0.1))
    host.wait(AT_S * 1e3 - 6)
    host.say(b"r0298\r")
    assert host.lines(1, 0x09, 300) == []


def test_a_drive_without_power_is_silent_and_limp_and_forgets(broken):
    host = broken(PowerLoss("joint1", AT_S, off_s=0.5))
    before = host.arm.true_position_rad(0, host.now_ns)
    assert host.turns(1) is None
    assert not host.arm.drives[0].enabled
    host.wait(500)
    assert host.turns(1) == 0.0
    assert host.arm.drives[0].state == IDLE
    assert host.arm.true_position_rad(0, host.now_ns) == before


def test_a_stalled_shaft_stands_and_the_drive_pushes(broken):
    host = broken(Stall("joint1", AT_S))
    before = host.turns(1)
    host.go(1, before + 1.0)
    host.wait(500)
    assert host.turns(1) == before
    assert host.arm.drives[0].shaft.torque_nm > 0.0
    assert host.arm.drives[0].enabled


@pytest.mark.parametrize("fault", [Disabled("joint1", AT_S), Protection("joint1", AT_S, cause="temperature")])
def test_a_drive_that_lets_go_says_so(broken, fault):
    host = broken(fault)
    beats = host.lines(1, 0x01, 100)
    assert beats[-1][4] == IDLE
    assert bool(int.from_bytes(beats[-1][:4], "little")) == isinstance(fault, Protection)


def test_slow_and_lost_replies(broken):
    host = broken(SlowReplies(0.005, at_s=AT_S, joint="joint1"), LostReplies(0.5, at_s=AT_S, joint="joint2"))
    assert host.turns(1) is None
    assert len(host.lines(1, 0x09, 6)) == 1
    answered = sum(host.turns(2) is not None for _ in range(200))
    assert 60 < answered < 140
    assert all(host.turns(3) is not None for _ in range(50))


def test_two_drives_of_one_node_both_answer(broken):
    host = broken(SameAddress("joint2", AT_S))
    host.say(b"r0498\r")
    assert sorted(struct.unpack("<ff", data)[0] for data in host.lines(2, 0x09, 5)) == [0.0, pytest.approx(5.0)]


def test_a_babbling_drive_repeats_its_position(broken):
    host = broken(Babble(AT_S, joint="joint3"))
    answers = host.lines(3, 0x09, 10)
    assert len(answers) > 20
    (turns,) = {struct.unpack("<ff", data)[0] for data in answers}
    assert turns == pytest.approx(5.764, abs=1e-3)
    assert host.turns(1) is not None  # a higher priority


def test_nobody_is_heard_beside_the_highest_priority(broken):
    host = broken(Babble(AT_S, until_s=AT_S + 0.05))
    assert host.turns(1) is None
    host.wait(50)
    assert host.turns(1) is not None


def test_lines_of_one_drive_are_spoilt_and_no_others(broken):
    host = broken(DuplicateReplies(1.0, at_s=AT_S, joint="joint1"), CutLines(1.0, at_s=AT_S, joint="joint2"))
    host.say(b"r0298\r")
    assert len(host.lines(1, 0x09, 3)) == 2
    assert host.turns(2) is None
    host.wait(1)
    assert host.turns(3) is not None


def test_waking_only_when_told_misses_nothing(odrives):
    """What a server in real time does: it sleeps until `next_due_ns`."""
    slow = [SlowReplies(0.005, joint=f"joint{number}") for number in range(2, 7)]

    def run(lazily: bool) -> bytes:
        host = talk(with_odrives(odrives, *range(6), estimates_ms=7), *slow)
        host.say(b"r0298\rr0498\r")
        end_ns = host.now_ns + 200 * MILLISECOND
        said = host.arm.collect(host.now_ns)
        while lazily and (due_ns := host.arm.next_due_ns()) is not None and due_ns <= end_ns:
            assert due_ns > host.arm.now_ns
            assert host.arm.collect(due_ns - 1) == b""
            said += host.arm.collect(due_ns)
        return said + host.arm.collect(end_ns)

    assert run(lazily=True) == run(lazily=False)
