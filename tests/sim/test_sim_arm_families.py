"""The simulated arm with drives of each family behind an adapter: truth, what can go wrong with them, and mixed buses.

Their frames are those of the rows in `simulated_families`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import MISSING, fields

import numpy as np
import pytest
from drive_bench import frame, text
from sim_host import MILLISECOND, START_NS, Host, read
from simulated_families import Family, FamilyBench, cia402, cybergear, damiao_mit, mks, myactuators, odrives, zdt

from config.drives.odrive import OdriveDrive as OdriveConfig
from config.loader import load_arm
from config.schema import ArmConfig
from config.serial_adapters import SLCAN_BITRATES
from sim import faults as wrong
from sim.arm import SimulatedArm
from sim.bus import Frame
from sim.drives.odrive import OdriveDrive
from sim.drives.zdt import ZdtDrive

AT_S = 0.1
OF_ZDT_ALONE = [
    *(wrong.Refusing, wrong.CountSlip, wrong.CountWrap, wrong.KeepsSettings, wrong.ForeignFirmware),
    *(wrong.WrongChecksums, wrong.WrongValues),
]
MAKES = (zdt, mks, odrives, damiao_mit, cia402, myactuators, cybergear)
START_RAD = [0.1, -0.2, 0.3, 0.4, -0.5, 0.6]
CDC = {"bus": {"serial_baud": "cdc"}}

Make = Callable[[int], Family]
Broken = Callable[..., "Talker"]


class Talker(Host):
    """A host that speaks with drives of any family, number 1 and up."""

    def __init__(self, make: Make, arm: ArmConfig, *faults: wrong.Fault, **options: object) -> None:
        super().__init__(SimulatedArm(arm, start_ns=START_NS, faults=faults, **options))
        self.make = make
        self.say(f"{SLCAN_BITRATES[arm.bus.bitrate]}\rO\r".encode())
        self.wait(1)

    def tell(self, *texts: str) -> None:
        """Send frames as the rows have them."""
        for sent in map(frame, texts):
            kind = "tTrR"[sent.extended + 2 * sent.remote]
            ident = f"{sent.can_id:08X}" if sent.extended else f"{sent.can_id:03X}"
            self.say(f"{kind}{ident}{len(sent.data)}{sent.data.hex().upper()}\r".encode())

    def wait(self, milliseconds: float) -> list[str]:
        """Frames that come meanwhile, as the rows have them; halves of lines are left out."""
        return [text(whole) for whole in map(received, super().wait(milliseconds)) if whole is not None]

    def answers(self, number: int, milliseconds: float = 3.0) -> list[float]:
        """What a drive's answers to the question where it is say [rev]."""
        family = self.make(number)
        request, decoded = family.where
        head, _, data = FamilyBench(family).ask(request)[0].partition("# ")
        heard = [one.split("# ") for one in self.wait(milliseconds)]
        return [decoded(bytes.fromhex(said)) for of, said in heard if of == head and len(said) == len(data)]

    def where(self, number: int) -> float | None:
        """Where a drive says that it is, if it answers within 3 ms."""
        self.tell(self.make(number).where[0])
        answers = self.answers(number)
        return answers[-1] if answers else None

    def status(self, number: int) -> str:
        """How a drive says that it is."""
        return self.make(number).status(OneDrive(self, number))

    def enable(self, *numbers: int) -> None:
        """Let drives hold where they are."""
        for number in numbers:
            here = self.where(number)
            assert here is not None
            self.tell(*self.make(number).enable(here))
            self.wait(5)


class OneDrive:
    """What a row asks of a bench, over the bus."""

    def __init__(self, host: Talker, number: int) -> None:
        self.host, self.owns = host, host.arm.drives[number - 1].owns

    def ask(self, request: str) -> list[str]:
        self.host.tell(request)
        return self.wait(3.0)

    def wait(self, milliseconds: float) -> list[str]:
        return [said for said in self.host.wait(milliseconds) if self.owns(frame(said))]


def received(line: str) -> Frame | None:
    """The frame of an adapter's line; None for what is none."""
    digits = {"t": 3, "T": 8}.get(line[:1])
    if digits is None or not re.fullmatch(f"[0-9A-F]{{{digits}}}[0-8]([0-9A-F]{{2}})*", line[1:]):
        return None
    return Frame(int(line[1 : 1 + digits], 16), bytes.fromhex(line[2 + digits :]), line[0] == "T")


@pytest.fixture(params=MAKES, ids=lambda make: make.__name__)
def make(request: pytest.FixtureRequest) -> Make:
    """Each family in turn."""
    return request.param


@pytest.fixture
def arm(make: Make) -> ArmConfig:
    """An arm of it."""
    return load_arm(make(1).arm, overrides=CDC)


@pytest.fixture
def broken(make: Make, arm: ArmConfig) -> Broken:
    """A host of six drives that hold, with a fault that has just begun."""

    def make_host(*faults: wrong.Fault) -> Talker:
        host = Talker(make, arm, *faults)
        host.enable(1, 2, 3)
        assert host.now_ns < START_NS + AT_S * 1e9
        host.wait((START_NS - host.now_ns) * 1e-6 + AT_S * 1e3 + 1)
        return host

    return make_host


# --- truth ----------------------------------------------------------------------------------------------


def test_a_drive_tells_and_truth_knows_where_the_joint_stands(make: Make, arm: ArmConfig) -> None:
    host = Talker(make, arm, joint_position_rad=START_RAD)
    for index, (joint, position_rad) in enumerate(zip(arm.joints, START_RAD, strict=True)):
        true_rad = host.arm.true_position_rad(index, START_NS)
        assert true_rad == pytest.approx(position_rad, abs=joint.command_pulse_rad if make is zdt else 1e-9)
        turns = host.where(index + 1)
        assert turns is not None
        said_rad = joint.direction * turns * 2 * math.pi / joint.ratio - joint.zero_rad
        assert said_rad == pytest.approx(true_rad, abs=1.01 * joint.encoder_count_rad + 1e-6)


@pytest.mark.parametrize("direction", [1, -1])
def test_truth_follows_a_joint_either_way_round(make: Make, arm: ArmConfig, direction: int) -> None:
    joints = [arm.joints[0].model_copy(update={"direction": direction}), *arm.joints[1:]]
    host = Talker(make, arm.model_copy(update={"joints": joints}))
    host.enable(1)
    before, before_rad = host.where(1), host.arm.true_position_rad(0, host.now_ns)
    assert before is not None
    host.tell(*make(1).go(before + 0.5))
    host.wait(5000)
    away_rad = direction * 0.5 * 2 * math.pi / joints[0].ratio
    within_rad = (make(1).within + 2e-4) * 2 * math.pi / joints[0].ratio
    assert host.arm.true_position_rad(0, host.now_ns) - before_rad == pytest.approx(away_rad, abs=within_rad)
    times_ns = host.arm.truth_changes(0)
    position_rad, velocity_rad_s = host.arm.truth(0, times_ns)
    assert np.allclose(np.diff(position_rad), velocity_rad_s[:-1] * np.diff(times_ns) * 1e-9, atol=1e-12)
    fastest = int(np.argmax(np.abs(velocity_rad_s)))
    assert host.arm.true_velocity_rad_s(0, int(times_ns[fastest])) * direction > 0.0
    assert host.arm.true_position_rad(0, int(times_ns[fastest])) == pytest.approx(position_rad[fastest])
    assert times_ns[-1] == host.now_ns


def test_an_arm_that_was_just_switched_on_counts_from_where_it_stands(make: Make, arm: ArmConfig) -> None:
    host = Talker(make, arm, homed=False, joint_position_rad=[0.3] * 6)
    assert host.arm.true_position_rad(0, host.now_ns) == pytest.approx(0.3, abs=1e-3)
    knows = make(1).knows_its_angle is not None
    turns = arm.joints[0].direction * (0.3 + arm.joints[0].zero_rad) * arm.joints[0].ratio / 2 / math.pi
    assert host.where(1) == pytest.approx(turns if knows else 0.0, abs=2e-4)


# --- faults ---------------------------------------------------------------------------------------------


def test_every_fault_is_one_that_these_drives_can_have_or_is_refused_in_a_sentence(make: Make, arm: ArmConfig) -> None:
    for name, kind in wrong.FAULTS.items():
        needed = [field.name for field in fields(kind) if field.default is MISSING]
        values = ",".join(f"{key}={'joint2' if key == 'joint' else '0.5'}" for key in needed)
        fault = wrong.parse_fault(f"{name}:{values}")
        simulated = SimulatedArm(arm)
        if kind is wrong.Thing or (kind in OF_ZDT_ALONE and make is not zdt):
            with pytest.raises(ValueError, match="no fault this arm can have"):
                simulated.inject(fault)
        else:
            simulated.inject(fault)


def test_a_silent_drive_goes_on_with_what_it_was_told(broken: Broken, make: Make) -> None:
    host = broken(wrong.Silent("joint1", AT_S + 0.2, until_s=AT_S + 3.0))
    before = host.where(1)
    host.tell(*make(1).go(before + 0.1))
    host.wait(250)
    assert host.where(1) is None and host.where(2) is not None
    host.wait(3000)
    assert host.where(1) == pytest.approx(before + 0.1, abs=make(1).within + 1e-3)
    assert host.status(1) == make(1).says["holding"]


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        (wrong.PowerLoss("joint1", AT_S, off_s=0.5), "power"),
        (wrong.Stall("joint1", AT_S), "holding"),
        (wrong.Disabled("joint1", AT_S), "limp"),
        (wrong.Protection("joint1", AT_S, 9.0, "temperature"), "temperature"),
    ],
)
def test_a_fault_strikes_its_joint_and_no_other(broken: Broken, make: Make, fault: wrong.Fault, says: str) -> None:
    host = broken(fault)
    before = [host.arm.true_position_rad(joint, host.now_ns) for joint in range(2)]
    assert (host.where(1) is None) == (says == "power") and host.where(2) is not None
    assert host.arm.drives[0].limp == (says != "holding") and not host.arm.drives[1].limp
    host.wait(500 + make(1).boots_ms)
    assert (host.status(1), host.status(2)) == (make(1).says[says], make(2).says["holding"])
    for number in (1, 2):
        if says == "holding" or number == 2:
            host.tell(*make(number).go(host.where(number) + 0.5))
    host.wait(100)
    assert host.arm.true_position_rad(0, host.now_ns) == pytest.approx(before[0], abs=1e-5)
    assert host.arm.true_position_rad(1, host.now_ns) != pytest.approx(before[1], abs=1e-4)


def test_a_tripped_protection_cannot_be_cleared_before_its_cause_is_gone(broken: Broken, make: Make) -> None:
    family = make(1)
    host = broken(wrong.Protection("joint1", AT_S, until_s=AT_S + 3.0, cause="temperature"))
    for gone, says in ((False, "temperature"), (True, "limp")):
        host.wait(3000 if gone else 0)
        host.tell(*family.clear)
        host.wait(10 + family.clears_ms)
        host.tell(*(family.let_go if gone else ()))
        host.wait(10)
        assert host.status(1) == family.says[says]


def test_slow_and_lost_replies(broken: Broken, make: Make) -> None:
    host = broken(
        wrong.SlowReplies(0.005, at_s=AT_S, joint="joint1"), wrong.LostReplies(0.5, at_s=AT_S, joint="joint2")
    )
    assert host.where(1) is None
    assert len(host.answers(1, 6)) == 1
    answered = sum(host.where(2) is not None for _ in range(100))
    assert 25 < answered < 75
    assert all(host.where(3) is not None for _ in range(50))


def test_two_drives_of_one_number_both_answer(broken: Broken, make: Make) -> None:
    host = broken(wrong.SameAddress("joint2", AT_S))
    true, _ = host.arm.drives[1].shaft.past(host.now_ns)
    host.tell(make(2).where[0])
    assert sorted(host.answers(2)) == pytest.approx(sorted((0.0, true)), abs=2e-4)


def test_a_babbling_drive_repeats_its_position(broken: Broken, make: Make) -> None:
    host = broken(wrong.Babble(AT_S, until_s=AT_S + 0.1, joint="joint3"))
    said = host.wait(10)
    babble = set(said) - {"00000300# 00 EE 6B"}  # a ZDT drive takes it for bad requests
    assert len(said) > 20 and len(babble) == 1
    assert host.arm.drives[2].owns(frame(babble.pop()))
    host.wait(100)
    assert host.where(1) is not None


def test_lines_of_one_drive_are_spoilt_and_no_others(broken: Broken, make: Make) -> None:
    host = broken(
        wrong.DuplicateReplies(1.0, at_s=AT_S, joint="joint1"), wrong.CutLines(1.0, at_s=AT_S, joint="joint2")
    )
    host.tell(make(1).where[0])
    assert len(host.answers(1)) == 2
    assert host.where(2) is None
    host.wait(1)
    assert host.where(3) is not None


def test_waking_only_when_told_misses_nothing(make: Make, arm: ArmConfig) -> None:
    """What a server in real time does: it sleeps until `next_due_ns`."""
    slow = [wrong.SlowReplies(0.005, joint=f"joint{number}") for number in range(2, 7)]

    def run(lazily: bool) -> bytes:
        host = Talker(make, arm, *slow)
        host.tell(make(1).where[0], make(2).where[0])
        end_ns = host.now_ns + 200 * MILLISECOND
        said = host.arm.collect(host.now_ns)
        while lazily and (due_ns := host.arm.next_due_ns()) is not None and due_ns <= end_ns:
            assert due_ns > host.arm.now_ns
            assert host.arm.collect(due_ns - 1) == b""
            said += host.arm.collect(due_ns)
        return said + host.arm.collect(end_ns)

    assert run(lazily=True) == run(lazily=False)


# --- mixed buses ----------------------------------------------------------------------------------------


def with_odrives(arm: ArmConfig, *joints: int) -> ArmConfig:
    """The arm with ODrives of nodes 1 and up at some of its joints, which send nothing by themselves but heartbeats."""
    odrive = [OdriveConfig(family="odrive", node_id=index + 1, estimates_ms=0) for index in range(len(arm.joints))]
    changed = [
        joint.model_copy(update={"drive": odrive[index]}) if index in joints else joint
        for index, joint in enumerate(arm.joints)
    ]
    return arm.model_copy(update={"joints": changed})


@pytest.fixture(scope="module")
def mixed() -> ArmConfig:
    """ZDT drives but for an ODrive at joint 2."""
    return with_odrives(load_arm("episode1", overrides=CDC), 1)


def test_faults_of_zdt_drives_strike_those_of_a_mixed_arm(mixed: ArmConfig) -> None:
    SimulatedArm(mixed, faults=[wrong.WrongChecksums(0.5), wrong.CountSlip("joint1", 0.5, 3.0)])
    with pytest.raises(ValueError, match="no fault this arm can have"):
        SimulatedArm(mixed, faults=[wrong.CountSlip("joint2", 0.5, 3.0)])


def test_families_share_a_bus_and_do_not_hear_each_other(mixed: ArmConfig) -> None:
    host = Talker(odrives, mixed)
    assert [type(drive) for drive in host.arm.drives] == [ZdtDrive, OdriveDrive, *[ZdtDrive] * 4]
    assert host.where(2) == pytest.approx(5.0)
    assert host.where(1) is None
    host.make = zdt
    assert host.where(1) == 12.5
    assert host.where(2) is None
    assert sum(said.startswith("041#") for said in host.wait(1000)) == 10


def test_the_same_seed_gives_the_same_bytes_and_another_other_ones(mixed: ArmConfig) -> None:
    def run(seed: int) -> list[list[str]]:
        host = Talker(odrives, mixed, wrong.LostReplies(0.2), wrong.CorruptBytes(0.01), seed=seed)
        host.tell(*odrives(2).enable(0.0))
        texts = []
        for tick in range(50):
            host.tell(*odrives(2).go(5.0 + tick * 0.01), odrives(2).where[0])
            host.say(read(1))
            texts.append(host.wait(3))
        return texts

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_many_drives_of_one_arm_stand_in_one_bus() -> None:
    episode1 = load_arm("episode1", overrides=CDC)
    joints = [episode1.joints[1].model_copy(update={"name": f"j{index}"}) for index in range(32)]
    host = Talker(odrives, with_odrives(episode1.model_copy(update={"joints": joints}), *range(32)))
    assert host.where(32) == pytest.approx(5.0)
    beats = {said[:4] for said in host.wait(100)}
    assert beats == {f"{node << 5 | 1:03X}#" for node in range(1, 33)}
