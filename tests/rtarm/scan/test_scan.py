"""`rtarm scan`: machines that are folders, buses in virtual time, and once a real pseudo-terminal."""

from __future__ import annotations

import io
import json
import os
import socket
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import yaml
from fake_machine import Content, can_link, place
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from stack import Stack, run_rtarm
from typer.testing import Result

from config.errors import ConfigError
from config.loader import load_arm
from rtarm.console.errors import Refusal
from rtarm.doctor.machine import Machine
from rtarm.scan import adapters, search
from rtarm.scan.overheard import drive_of
from rtarm.scan.proposal import proposal
from rtarm.scan.questions import BY_NAME, EVERYBODY, NAMED, Question
from rtarm.scan.run import _try_link, scan
from rtarm.scan.search import BITRATES, LONGEST_S, Outcome, search_link, search_slcan
from rtarm.scan.show import render
from rtarm.scan.wires import CanWire, Frame, SlcanWire, frame_of, standard_frame_of
from rtloop.wire.refusal import WireRefused
from rtloop.wire.tty import open_port
from sim import faults
from sim.arm import SimulatedArm
from sim.drives.vesc import VescDrive

USB = "/sys/devices/pci0000:00/usb1"
READS = {0x1F, 0x42, 0x3A}


class VirtualPort:
    """The serial port of a simulated arm, in virtual time."""

    def __init__(self, sim: SimulatedArm) -> None:
        self.sim = sim
        self.written = b""

    def write(self, data: bytes) -> None:
        self.written += data
        self.sim.feed(self.sim.now_ns, data)

    def read(self, patience_s: float) -> bytes:
        until_ns = self.sim.now_ns + max(round(patience_s * 1e9), 1)
        while True:
            due_ns = self.sim.next_due_ns()
            at_ns = until_ns if due_ns is None else min(max(due_ns, self.sim.now_ns + 1), until_ns)
            data = self.sim.collect(at_ns)
            if data or at_ns >= until_ns:
                return data

    def now_s(self) -> float:
        return self.sim.now_ns * 1e-9

    @property
    def functions(self) -> set[int]:
        """Function bytes of every frame to ZDT drives that was written."""
        lines = self.written.split(b"\r")
        return {int(line[10:12], 16) for line in lines if line[:1] == b"T" and line[1:7] != b"0000FD"}  # to RobStrides


def bus(found: list[Any] | None = None, bitrate: int = 500_000, **options: Any) -> VirtualPort:
    overrides = {"bus": {"bitrate": bitrate, "serial_baud": "cdc"}, "control": {"rate_hz": 10}}
    return VirtualPort(SimulatedArm(load_arm("episode1", overrides=overrides), faults=found or [], **options))


def searched(port: VirtualPort) -> Outcome:
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire)
    assert port.now_s() < LONGEST_S + 15.0
    assert port.functions <= READS
    assert not any(drive.moving for drive in port.sim.drives)
    return outcome


def shown(outcome: Outcome) -> str:
    """What a person reads of it, in one line."""
    text = io.StringIO()
    adapter = {"channel": "/dev/ttyACM0", "what": "adapter", "usb": None, "not_tried": None, "serial_baud": "cdc"}
    report = {"adapters": [{**adapter, "outcome": asdict(outcome)}], "notes": [], "proposal": None}
    Console(file=text, width=100).print(render(report))
    return " ".join(text.getvalue().split())


# --- lines and frames -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"T12ABCDEF2AA55", Frame(0x12ABCDEF, b"\xaa\x55")),  # can-adapters.md 1
        (b"T000001003367D6B", Frame(0x100, b"\x36\x7d\x6b")),
        (b"T0000010021F6B1234", Frame(0x100, b"\x1f\x6b")),  # with a time stamp
        (b"\x07T0000010021F6B", Frame(0x100, b"\x1f\x6b")),  # behind a refusal
        (b"t4563112233", None),
        (b"T0000010031F6B", None),
        (b"T00000100", None),
        (b"T000001009" + b"00" * 9, None),
        (b"TFFFFFFFF0", None),
        (b"Z", None),
        (b"", None),
    ],
)
def test_lines(line: bytes, frame: Frame | None) -> None:
    assert frame_of(line) == frame


@given(st.binary(max_size=40))
def test_any_line_is_a_frame_or_none(line: bytes) -> None:
    frame = frame_of(line)
    assert frame is None or (frame.id <= 0x1FFFFFFF and len(frame.data) <= 8)


def test_frames_of_a_can_interface() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        wire = CanWire.__new__(CanWire)
        wire._socket = ours
        wire.send(Frame(0x100, b"\x1f\x6b"))
        assert theirs.recv(16) == bytes.fromhex("00010080 02000000 1F6B000000000000")
        theirs.send(bytes.fromhex("00010080 06000000 1F00C8006F6B0000"))
        theirs.send(bytes.fromhex("00010000 02000000 1F6B000000000000"))  # a standard frame
        theirs.send(bytes.fromhex("04000020 08000000 0000000000000000"))  # an error frame
        theirs.send(bytes.fromhex("01070000 01000000 0500000000000000"))
        theirs.send(bytes.fromhex("01070040 01000000 0500000000000000"))  # a remote frame
        wire.foreign, wire.standard = 0, deque()
        assert wire.receive(0.05) == [Frame(0x100, bytes.fromhex("1F00C8006F6B"))]
        assert wire.foreign == 3
        assert list(wire.standard) == [Frame(0x100, b"\x1f\x6b", False), Frame(0x701, b"\x05", False)]


# --- searching ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", ["lawicel", "canable"])
@pytest.mark.parametrize("bitrate", BITRATES)
def test_the_bit_rate_and_every_drive_are_found(bitrate: int, dialect: Any) -> None:
    outcome = searched(bus(bitrate=bitrate, dialect=dialect))
    assert outcome.bitrate == bitrate
    assert outcome.asked == list(BITRATES[: BITRATES.index(bitrate) + 1])
    assert [drive.address for drive in outcome.drives] == [1, 2, 3, 4, 5, 6]
    for drive in outcome.drives:
        found = (drive.firmware, drive.known, drive.microsteps, drive.response, drive.current_ma)
        assert found == ("2.0.0", True, 16, "receive", 3000)
        assert (drive.protected, drive.power_lost, drive.notes) == (False, False, [])


def test_listening_comes_before_asking() -> None:
    port = bus()
    searched(port)
    assert port.written.index(b"L\r") < port.written.index(b"O\r") < port.written.index(b"T")
    assert port.written.rindex(b"L\r") < port.written.index(b"T")


def test_nobody_answers() -> None:
    outcome = searched(bus([faults.Silent(f"joint{n}", 0.0) for n in range(1, 7)]))
    assert (outcome.bitrate, outcome.drives, outcome.asked) == (None, [], list(BITRATES))
    assert outcome.notes == [search.NEVER_TRIED]


def test_one_drive_is_missing_and_old_firmware_is_read() -> None:
    outcome = searched(bus([faults.Silent("joint3", 0.0)], firmware="old", homed=False))
    assert [drive.address for drive in outcome.drives] == [1, 2, 4, 5, 6]
    assert {drive.firmware for drive in outcome.drives} == {"1.2.5"}


def test_two_drives_of_one_address() -> None:
    outcome = searched(bus([faults.SameAddress("joint6", 0.0)]))
    drive = outcome.drives[-1]
    assert "More than one drive answers at address 6" in drive.notes[0]


def test_six_drives_as_they_leave_the_factory() -> None:
    """All of them have address 1, the most usual bus of all."""
    port = bus()
    for drive in port.sim.drives[1:]:
        drive.unplug(0)
    for _ in range(5):
        port.sim._add_drive(port.sim.drives[0], 0)
    outcome = searched(port)
    assert [drive.address for drive in outcome.drives] == [1]
    assert "More than one drive answers at address 1" in outcome.drives[0].notes[0]


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (faults.WrongChecksums(1.0, joint="joint2"), "uses another checksum"),
        (faults.ForeignFirmware("joint2"), "it may run X firmware"),
    ],
)
def test_a_drive_that_speaks_another_language(fault: Any, sentence: str) -> None:
    outcome = searched(bus([fault]))
    notes = {drive.address: drive.notes for drive in outcome.drives}
    assert sentence in notes[2][0] and not any(notes[address] for address in (1, 3, 4, 5, 6))


def test_a_drive_in_protection_and_one_that_has_lost_power() -> None:
    outcome = searched(bus([faults.Protection("joint2", 0.0), faults.PowerLoss("joint3", 0.0, 0.001)]))
    assert [drive.protected for drive in outcome.drives] == [False, True, False, False, False, False]
    assert [drive.power_lost for drive in outcome.drives] == [False, False, True, False, False, False]


def test_a_bus_that_is_in_use_is_not_spoken_on() -> None:
    port = bus()
    port.sim.drives[3].receive(0, _report_every_10_ms(4))
    outcome = searched(port)
    assert (outcome.bitrate, outcome.asked, outcome.drives) == (500_000, [], [])
    assert "(addresses 4)" in outcome.notes[0]
    assert "end that program or, where none runs, switch the drives off and on" in outcome.notes[0]
    assert port.functions == set()


class Overheard(VirtualPort):
    """A bus on which another machine speaks, every 10 ms from the first moment."""

    line = b""

    def read(self, patience_s: float) -> bytes:
        data = super().read(min(patience_s, 0.01))
        return data + self.line if self.sim.adapter._listen_only else data


@pytest.mark.parametrize(
    ("line", "busy"),
    [
        (b"t4563112233\r", True),  # can-adapters.md 1
        (b"R000007FF0\r", True),
        (b"r1230\r", True),
        (b"t45F\r", False),
        (b"z\r", False),
        (b"V1013\r", False),
    ],
)
def test_a_bus_of_other_machines_is_not_spoken_on(line: bytes, busy: bool) -> None:
    """Frames with standard identifiers, and remote frames: no drive sends them, and somebody does."""
    port = Overheard(bus().sim)
    port.line = line
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire)
    assert (outcome.asked == [], port.functions == set()) == (busy, busy)
    assert ("belongs to something else" in " ".join(outcome.notes)) == busy


def test_frames_of_other_families_have_no_address_of_a_zdt_drive() -> None:
    port = Overheard(bus().sim)
    port.line = b"T028001AA88A2F7FFF7FFF0131\r"  # facts/other-drives.md, RobStride: feedback
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire)
    assert outcome.asked == [] and "Frames were heard before anybody was asked: another" in outcome.notes[0]


def test_a_can_interface_of_other_machines_is_not_spoken_on() -> None:
    wire = VirtualCan()
    wire.foreign = 5
    outcome = search_link(wire, 500_000)
    assert (outcome.drives, outcome.asked, wire.sent) == ([], [], [])


@pytest.mark.parametrize(
    ("line", "family", "number", "state"),
    [
        (b"t02180000000008000000", "odrive", 1, "closed loop"),  # facts/other-drives.md, ODrive: 01 heartbeat
        (b"t7E184000000001000000", "odrive", 63, "error 0x40"),
        (b"t04180000000003000000", "odrive", 2, "axis state 3"),
        (b"t701105", "cia402", 1, "operational"),  # CiA 301, heartbeat: 700 + node
        (b"t77F17F", "cia402", 127, "pre-operational"),
        (b"t701100", "cia402", 1, "boot-up"),
    ],
)
def test_heartbeats_are_known_for_what_they_are(line: bytes, family: str, number: int, state: str) -> None:
    frame = standard_frame_of(line)
    assert frame is not None
    found = drive_of(frame)
    assert found is not None and (found.family, found.number, found.state) == (family, number, state)


@pytest.mark.parametrize(
    "line",
    [
        b"t0227000000000800000000",  # ODrive's e-stop
        b"t0217000000000800",  # too short
        b"t02180000000020000000",  # no state of an axis
        b"t700105",  # the node 0
        b"t780105",
        b"t701142",  # no state of a node
        b"t70120505",
        b"T00000021800000000080000000",
    ],
)
def test_what_is_no_heartbeat_is_nobodys(line: bytes) -> None:
    frame = standard_frame_of(line)
    assert frame is None or drive_of(frame) is None


@given(st.integers(0, 0x1FFF), st.binary(max_size=8), st.booleans())
def test_any_frame_is_a_drives_or_nobodys(identifier: int, data: bytes, extended: bool) -> None:
    found = drive_of(Frame(identifier, data, extended))
    assert found is None or found.number in range(253 if extended else 128)


def test_a_status_of_a_vesc_is_known_and_no_packet_of_a_zdt_drive_is_one() -> None:
    status = Frame(0x1001, bytes.fromhex("011AFC99000018F5"))  # tests/golden/vesc.yaml, captured
    found = drive_of(status)
    assert found is not None and (found.family, found.number, found.state) == ("vesc", 1, "power stage at 28 °C")
    configuration = bytes.fromhex("42 21 15 19 02 02 02 00")  # the beginning of one in facts/zdt-emm-v5.md
    for other in (
        Frame(0x1001, configuration),
        Frame(0x1001, status.data[:7]),
        Frame(0x10FE, status.data),  # RobStride motor 16 to anybody
        Frame(0x1001, status.data[:6] + b"\xff\xff"),
    ):
        assert drive_of(other) is None


@pytest.mark.parametrize(
    ("arm", "family", "called", "field"),
    [("odrive6", "odrive", "ODrive axis", "node_id"), ("vesc6", "vesc", "VESC", "controller_id")],
)
def test_drives_that_speak_by_themselves_are_overheard_and_nobody_is_asked(
    arm: str, family: str, called: str, field: str
) -> None:
    port = VirtualPort(SimulatedArm(load_arm(arm)))
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire)
    assert (outcome.bitrate, outcome.asked, outcome.drives) == (1_000_000, [], [])
    assert [(drive.family, drive.number) for drive in outcome.overheard] == [(family, n) for n in range(1, 7)]
    assert port.functions == set() and b"t" not in port.written.lower().replace(b"\r", b"")
    entry = {"outcome": asdict(outcome), "serial_baud": "cdc", "interface": "slcan", "channel": "/dev/ttyACM0"}
    assert "6 drives speak by themselves at 1000000 bit/s" in shown(outcome) and called in shown(outcome)
    proposed = yaml.safe_load(proposal(entry))
    assert [joint["drive"] for joint in proposed["joints"]] == [
        {"family": family, field: number} for number in range(1, 7)
    ]


def as_they_come(arm: str, **overrides: Any) -> VirtualPort:
    """The bus of an arm whose VESCs send nothing by themselves."""
    sim = SimulatedArm(load_arm(arm, overrides=overrides))
    for drive in sim.drives:
        if isinstance(drive, VescDrive):
            drive.settings.position_hz = drive.settings.others_hz = 0
            drive.boot()
    return VirtualPort(sim)


def found_in(arm: str, family: str | None = None, **overrides: Any) -> tuple[VirtualPort, Outcome]:
    """What a scan finds of an arm of another family."""
    port = as_they_come(arm, **overrides)
    wire = SlcanWire(port)
    wire.greet()
    return port, search_slcan(wire, family)


NAMED_ONLY = {"myactuator6": "myactuator", "mks6": "mks", "damiao6": "damiao", "cia402_6": "cia402", "vesc6": "vesc"}


@pytest.mark.parametrize(("arm", "family"), [("robstride6", None), ("robstride6", "robstride"), *NAMED_ONLY.items()])
def test_drives_of_other_families_answer_and_their_arm_file_is_proposed(arm: str, family: str | None) -> None:
    config = load_arm(arm)
    _, outcome = found_in(arm, family)
    assert outcome.bitrate == config.bus.bitrate and outcome.drives == []
    drives = [joint.drive for joint in config.joints]
    assert [(one.family, one.number) for one in outcome.answered] == [(drive.family, drive.number) for drive in drives]
    entry = {"outcome": asdict(outcome), "serial_baud": "cdc", "interface": "slcan", "channel": "/dev/ttyACM0"}
    for joint, drive in zip(yaml.safe_load(proposal(entry))["joints"], drives, strict=True):
        given = joint["drive"]
        assert given.pop("family") == drive.family and given
        assert all(getattr(drive, name) == value for name, value in given.items())


FLEETING = {"outbox", "wake_ns", "_timers", "_now_ns", "_replied_ns", "_random", "_step_ns", "_last_step", "_idle"}
FLEETING |= {"stall_ns", "_reads", "_commands"}
"""What time changes of a simulated drive, and of its shaft, that nobody speaks to; tables that are made when read."""


def state_of(thing: Any, depth: int = 3) -> Any:
    """All that a question could change of a simulated drive, down to its shaft."""
    inner = getattr(thing, "__dict__", None)
    if not inner or callable(thing) or depth == 0:
        return repr(thing)
    return {name: state_of(value, depth - 1) for name, value in inner.items() if name not in FLEETING}


def wire_to(port: VirtualPort, bitrate: int) -> SlcanWire:
    wire = SlcanWire(port)
    assert wire.open(bitrate, listen_only=False)
    return wire


@pytest.mark.parametrize(
    ("arm", "frame"),
    [
        ("episode1", Frame(0x100, bytes.fromhex("F3AB00006B"))),  # let go; facts/zdt-emm-v5.md
        ("mks6", Frame(1, bytes.fromhex("F300F4"), False)),  # let go; facts/other-drives.md, as those that follow
        ("damiao6", Frame(1, bytes.fromhex("FFFFFFFFFFFFFFFC"), False)),
        ("odrive6", Frame(0x22, b"", False)),  # stop
        ("cia402_6", Frame(0x601, bytes.fromhex("2B17100064000000"), False)),  # heartbeat
        ("robstride6", Frame(0x0300AA01, bytes(8))),
        ("myactuator6", Frame(0x141, bytes.fromhex("A200000010270000"), False)),
        ("vesc6", Frame(0x401, bytes.fromhex("055D4A80"))),  # a position; tests/golden/vesc.yaml
    ],
)
def test_a_command_is_seen_in_the_state_of_a_drive(arm: str, frame: Frame) -> None:
    """Or else the tests below would prove nothing."""
    config = load_arm(arm)
    port = VirtualPort(SimulatedArm(config))
    wire = wire_to(port, config.bus.bitrate)
    before = state_of(port.sim.drives[0])
    wire.receive(0.1)
    assert state_of(port.sim.drives[0]) == before
    wire.send(frame)
    wire.receive(0.1)
    assert state_of(port.sim.drives[0]) != before


def test_what_everybody_is_asked_has_extended_identifiers_of_type_0() -> None:
    """Others than ZDT and RobStride drives hear standard ones; see `rtarm.scan.questions`."""
    frames = [frame for question in EVERYBODY for frame in question.frames]
    assert frames and all(frame.extended and frame.id < 0x10000 and not any(frame.data) for frame in frames)


FAMILIES = ("episode1", "mks6", "damiao6", "odrive6", "cia402_6", "robstride6", "myactuator6", "vesc6")
HEARD_BY = [(question, arm) for question in EVERYBODY for arm in FAMILIES]
HEARD_BY += [(question, arm) for question in NAMED for arm, family in NAMED_ONLY.items() if family == question.family]


@pytest.mark.parametrize(("question", "arm"), HEARD_BY, ids=lambda one: getattr(one, "family", one))
def test_a_question_changes_nothing_of_any_drive(question: Question, arm: str) -> None:
    """Drives that have just got power; those that are asked by name only hear their own family's question."""
    config = load_arm(arm)
    family = config.joints[0].drive.family
    port = as_they_come(arm)
    wire = wire_to(port, config.bus.bitrate)
    before = [state_of(drive) for drive in port.sim.drives]
    heard = search.ask_family(wire, question, config.bus.bitrate, acknowledged=True)
    assert [state_of(drive) for drive in port.sim.drives] == before
    assert {drive.family for drive in heard} == ({family} if question.family == family else set())


@pytest.mark.parametrize(
    ("arm", "numbers"),
    [
        ("episode1", {"address": 253}),  # to which RobStride's question looks as if it were addressed
        ("robstride6", {"motor_id": 0xFE}),
        ("mks6", {"can_id": 0x100}),  # the question to ZDT drive 1 has these bits, in an extended identifier
        ("odrive6", {"node_id": 8}),
        ("vesc6", {"controller_id": 31}),  # the function of a ZDT question
    ],
)
def test_no_number_makes_a_question_to_everybody_a_command(arm: str, numbers: dict[str, int]) -> None:
    config = load_arm(arm)
    first = config.joints[0]
    drive = first.drive.model_copy(update=numbers)
    joints = (first.model_copy(update={"drive": drive}), *config.joints[1:])
    port = VirtualPort(SimulatedArm(config.model_copy(update={"joints": joints})))
    wire = wire_to(port, config.bus.bitrate)
    before = state_of(port.sim.drives[0])
    for question in EVERYBODY:
        search.ask_family(wire, question, config.bus.bitrate, acknowledged=True)
    search.ask_zdt(wire, config.bus.bitrate, port.now_s() + LONGEST_S)
    assert state_of(port.sim.drives[0]) == before


@pytest.mark.parametrize("arm", NAMED_ONLY)
def test_who_must_be_named_is_not_asked_otherwise(arm: str) -> None:
    port, outcome = found_in(arm)
    assert not outcome.answered
    asked = {frame for line in port.written.split(b"\r") if (frame := standard_frame_of(line)) is not None}
    assert asked == set()
    assert "MyActuator, MKS, Damiao and silent VESC and CANopen drives are asked with --family only" in shown(outcome)


@pytest.mark.parametrize("family", ["myactuator", "mks", "damiao", "cia402", "vesc", "robstride", "zdt"])
def test_who_is_named_is_asked_alone_at_rates_that_it_can_have(family: str) -> None:
    port = bus([faults.Silent(f"joint{n}", 0.0) for n in range(1, 7)])
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire, family)
    lines = [line for line in port.written.split(b"\r") if line[:1] in (b"T", b"t")]
    asked = {frame for line in lines if (frame := frame_of(line) or standard_frame_of(line)) is not None}
    if family == "zdt":
        assert outcome.asked == list(BITRATES) and port.functions == {0x1F} and len(asked) == 255
    else:
        assert set(outcome.asked) == BY_NAME[family].bitrates and asked == set(BY_NAME[family].frames)
    assert f"no drive of family {family} answers" in shown(outcome) and "nobody else was asked" in shown(outcome)


@pytest.mark.parametrize("family", ["mks", None])
def test_where_nobody_acknowledges_few_questions_are_asked(family: str | None) -> None:
    """Another bit rate than the drives have: the adapter tells that nobody has acknowledged."""
    port, outcome = found_in("mks6", family, bus={"bitrate": 125_000})
    sent = port.written.split(b"O\r")[1:]  # at each rate
    assert [rate for rate in outcome.asked if rate != 125_000] and len(sent) == len(outcome.asked)
    for rate, lines in zip(outcome.asked, sent, strict=True):
        questions = len([line for line in lines.split(b"\r") if line[:1] in (b"T", b"t")])
        assert (questions <= 2 * search.SURELY_HEARD + 1) == (rate != 125_000)
    assert len(outcome.answered) == (6 if family else 0)


def test_an_interface_of_a_rate_that_the_family_cannot_have_is_not_asked() -> None:
    with pytest.raises(WireRefused, match="runs at 800000 bit/s, to which mks drives cannot be set"):
        _try_link(adapters.Adapter("can0", "socketcan", "CAN interface", bitrate=800_000), "mks")


def test_two_motors_of_one_number() -> None:
    config = load_arm("robstride6")
    port = VirtualPort(SimulatedArm(config, faults=[faults.SameAddress("joint6", 0.0)]))
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire)
    assert [drive.number for drive in outcome.answered] == [1, 2, 3, 4, 5, 6]
    [note] = [note for note in outcome.notes if "More than one" in note]
    assert "More than one RobStride motor answers at number 6: unplug all but one" in note


class Echoing(VirtualPort):
    """An adapter that says what it has sent as well."""

    echo = b""

    def write(self, data: bytes) -> None:
        super().write(data)
        self.echo += data if data[:1] in (b"T", b"t") else b""

    def read(self, patience_s: float) -> bytes:
        data, self.echo = self.echo, b""
        return data + super().read(patience_s)


@pytest.mark.parametrize("question", [*EVERYBODY, *NAMED], ids=lambda one: one.family)
def test_an_echo_is_no_answer(question: Question) -> None:
    port = Echoing(bus([faults.Silent(f"joint{n}", 0.0) for n in range(1, 7)]).sim)
    assert search.ask_family(wire_to(port, 500_000), question, 500_000, acknowledged=True) == []


class WithVesc(VirtualPort):
    """A bus with a VESC of number 0 (vedderb/bldc, comm_can.c): it answers command 17, and would obey others."""

    answer = b""

    def write(self, data: bytes) -> None:
        super().write(data)
        if data[:9] == b"T00001100":
            self.answer = b"T000012%s20000\r" % data[10:12]

    def read(self, patience_s: float) -> bytes:
        data = super().read(patience_s)
        answer, self.answer = self.answer, b""
        return data + answer


def test_a_vesc_to_which_questions_would_be_commands_is_asked_its_ping_alone() -> None:
    port = WithVesc(bus().sim)
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire)
    frames = [frame for line in port.written.split(b"\r") if (frame := frame_of(line)) is not None]
    assert frames == [Frame(17 << 8, b"\x1f\x6b")]
    assert (outcome.bitrate, outcome.drives, outcome.answered) == (500_000, [], [])
    assert "A VESC of number 0 answers" in shown(outcome) and ": adapter in use" in shown(outcome)


def test_a_family_that_is_not_asked_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match="Drives of family odrive are not asked: name zdt, robstride"):
        scan(machine(tmp_path, {}), [], family="odrive")


class OneHeartbeat(VirtualPort):
    """A bus at 1 Mbit/s on which a single ODrive speaks, once while it is listened there."""

    said = False

    def read(self, patience_s: float) -> bytes:
        data = super().read(min(patience_s, 0.01))
        if data or self.said or not self.sim.adapter._listen_only or b"S8\r" not in self.written:
            return data  # the adapter's own answers come first
        self.said = True
        return data + b"t0A180000000001000000\r"


def test_a_single_heartbeat_is_a_drives() -> None:
    port = OneHeartbeat(bus().sim)
    wire = SlcanWire(port)
    wire.greet()
    outcome = search_slcan(wire)
    assert (outcome.bitrate, outcome.asked, port.functions) == (1_000_000, [], set())
    assert [(drive.number, drive.state) for drive in outcome.overheard] == [(5, "idle")]


def test_an_adapter_that_cannot_merely_listen_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = SlcanWire.open
    monkeypatch.setattr(
        SlcanWire, "open", lambda wire, rate, *, listen_only: not listen_only and opened(wire, rate, listen_only=False)
    )
    outcome = searched(bus())
    assert len(outcome.drives) == 6 and outcome.notes == [search.UNHEARD]


@pytest.mark.parametrize("seed", range(5))
def test_a_drive_is_found_although_answers_are_lost(seed: int) -> None:
    outcome = searched(bus([faults.LostReplies(share=0.2)], seed=seed))
    assert [drive.address for drive in outcome.drives] == [1, 2, 3, 4, 5, 6]
    assert not any("More than one" in note for drive in outcome.drives for note in drive.notes)


def test_a_configuration_that_does_not_come_through_is_no_other_firmware() -> None:
    port = bus()
    drive = port.sim.drives[2]
    read = drive._reads[0x42]
    drive._reads[0x42] = lambda: read()[:-7]  # its last packet never arrives
    outcome = searched(port)
    assert ["did not come through" in note for note in outcome.drives[2].notes] == [True]
    assert all(not drive.notes for drive in outcome.drives if drive.address != 3)


def _report_every_10_ms(address: int) -> Any:
    from sim.bus import Frame as BusFrame

    return BusFrame(address << 8, bytes.fromhex("11 18 36 00 0A 6B"))


def test_an_adapter_that_does_not_open_its_channel() -> None:
    outcome = searched(bus([faults.OpenRefused()]))
    assert outcome.asked == outcome.listened == []
    assert len(outcome.notes) == len(BITRATES) + 1 and "refuses that rate, or to open" in outcome.notes[0]


def test_a_search_ends_at_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "LONGEST_S", 3.0)
    outcome = searched(bus([faults.Silent(f"joint{n}", 0.0) for n in range(1, 7)], dialect="canable"))
    assert outcome.asked != list(BITRATES)
    assert "10000 bit/s: 3 s were over" in outcome.notes[0]


class VirtualCan:
    """A CAN interface of a simulated arm, in virtual time."""

    def __init__(self) -> None:
        self.foreign = 0
        self.standard: deque[Frame] = deque()
        overrides = {"bus": {"interface": "socketcan", "channel": "can0"}}
        self.sim = SimulatedArm(load_arm("episode1", overrides=overrides))
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)
        self.sim.feed(self.sim.now_ns, _packed(frame))

    def receive(self, patience_s: float) -> list[Frame]:
        data = self.sim.collect(self.sim.now_ns + round(patience_s * 1e9))
        frames = [data[at : at + 16] for at in range(0, len(data), 16)]
        return [Frame(int.from_bytes(f[:4], "little") & 0x1FFFFFFF, f[8 : 8 + f[4]]) for f in frames]

    def troubled(self) -> bool:
        return False

    def now_s(self) -> float:
        return self.sim.now_ns * 1e-9


def _packed(frame: Frame) -> bytes:
    head = (frame.id | (0x80000000 if frame.extended else 0)).to_bytes(4, "little") + bytes((len(frame.data), 0, 0, 0))
    return head + frame.data.ljust(8, b"\0")


@pytest.mark.parametrize("bitrate", [500_000, None], ids=["told", "virtual"])
def test_a_can_interface_is_asked_at_its_own_bit_rate_only(bitrate: int | None) -> None:
    wire = VirtualCan()
    outcome = search_link(wire, bitrate)
    assert outcome.bitrate == bitrate and len(outcome.drives) == 6
    assert {frame.data[0] for frame in wire.sent if frame.extended and frame.id >> 8 != 0xFD} <= READS


# --- finding adapters -----------------------------------------------------------------------------------


def machine(root: Path, files: dict[str, Content], **parts: Any) -> Machine:
    for name, content in {"/sys/class/net/lo/type": "772", "/proc/1/comm": "init", **files}.items():
        place(root / name.lstrip("/"), content)
    return Machine(root, **{"can_links": lambda: [], **parts})


def serial(name: str, usb: str, at: str = "1-1") -> dict[str, Content]:
    vendor, product = usb.split(":")
    return {
        f"/dev/{name}": "",
        f"{USB}/{at}/idVendor": vendor,
        f"{USB}/{at}/idProduct": product,
        f"{USB}/{at}/{at}:1.0/{name}/uevent": "",
        f"/sys/class/tty/{name}/device": Path(f"../../../devices/pci0000:00/usb1/{at}/{at}:1.0/{name}"),
    }


def can0(**changes: Content) -> dict[str, Content]:
    files: dict[str, Content] = {
        "/sys/class/net/can0/type": "280",
        "/sys/class/net/can0/flags": "0x40081",
        "/sys/class/net/can0/tx_queue_len": "128",
    }
    return files | {f"/sys/class/net/can0/{name}": content for name, content in changes.items()}


RECEIVERS = """
receive list 'rx_all':
  device   can_id   can_mask  function  userdata   matches  ident
   {}     000    00000000  0000000000000000  0000000000000000         5  raw
"""


def test_an_slcan_adapter_is_known_by_its_usb_id_and_named_lastingly(tmp_path: Path) -> None:
    files = serial("ttyACM0", "ad50:60c4") | {"/dev/serial/by-id/usb-CANable-if00": Path("../../ttyACM0")}
    [found] = adapters.adapters(machine(tmp_path, files))
    assert (found.channel, found.usb) == ("/dev/serial/by-id/usb-CANable-if00", "ad50:60c4")
    assert (found.what, found.not_tried, found.is_uart) == ("CANable with SLCAN firmware", None, False)


@pytest.mark.parametrize(
    ("usb", "what"), [("1a86:7523", "CH340 converter"), ("2341:0043", "serial device")], ids=["converter", "Arduino"]
)
def test_what_may_be_anything_is_not_opened(tmp_path: Path, usb: str, what: str) -> None:
    [found] = adapters.adapters(machine(tmp_path, serial("ttyUSB0", usb)))
    assert found.what == what
    assert "`rtarm scan --port /dev/ttyUSB0`" in str(found.not_tried)


def test_a_port_that_is_open_elsewhere_or_not_ours_is_not_opened(tmp_path: Path) -> None:
    files = serial("ttyACM0", "16d0:117e")
    held = files | {"/proc/77/fd/3": tmp_path / "held/dev/ttyACM0"}
    [found] = adapters.adapters(machine(tmp_path / "held", held))
    assert "open in process 77" in str(found.not_tried)
    [found] = adapters.adapters(machine(tmp_path / "closed", files, may_access=lambda _path, _mode: False))
    assert "You may not open it" in str(found.not_tried)


def test_can_interfaces(tmp_path: Path) -> None:
    links = {"can_links": can_link}
    [found] = adapters.adapters(machine(tmp_path / "up", can0(), **links))
    assert (found.channel, found.interface, found.bitrate, found.not_tried) == ("can0", "socketcan", 500_000, None)
    [found] = adapters.adapters(machine(tmp_path / "down", can0(flags="0x40080"), **links))
    assert "sudo ip link set can0 up type can bitrate 500000" in str(found.not_tried)
    used = can0() | {"/proc/net/can/rcvlist_all": RECEIVERS.format("can0")}
    [found] = adapters.adapters(machine(tmp_path / "used", used, **links))
    assert "Another program listens" in str(found.not_tried)
    other = can0() | {"/proc/net/can/rcvlist_all": RECEIVERS.format("can1")}
    [found] = adapters.adapters(machine(tmp_path / "other", other, **links))
    assert found.not_tried is None


@pytest.mark.parametrize("told", [None, {}, [1], [{"ifname": "can0"}], [{"ifname": "can0", "linkinfo": {}}]])
def test_an_ip_that_says_little(tmp_path: Path, told: Any) -> None:
    [found] = adapters.adapters(machine(tmp_path, can0(), can_links=lambda: told or []))
    assert found.bitrate is None


def test_an_adapter_whose_driver_is_missing(tmp_path: Path) -> None:
    files: dict[str, Content] = {
        f"{USB}/1-3/idVendor": "1d50",
        f"{USB}/1-3/idProduct": "606f",
        "/sys/bus/usb/devices/1-3": Path("../../../devices/pci0000:00/usb1/1-3"),
    }
    [found] = adapters.adapters(machine(tmp_path, files))
    assert (found.what, found.interface) == ("candleLight adapter", None)
    assert "sudo modprobe gs_usb" in str(found.not_tried)


def test_what_only_python_can_sees_is_told(tmp_path: Path) -> None:
    seen = [
        {"interface": "pcan", "channel": "PCAN_USBBUS1"},
        {"interface": "virtual", "channel": "x"},
        {"interface": "socketcan", "channel": "can0"},
    ]
    report = scan(machine(tmp_path, {}), [], detect=lambda: (seen, None))
    assert [entry["channel"] for entry in report["adapters"]] == ["PCAN_USBBUS1"]
    assert "bus.interface python-can and bus.python_can.interface " in report["adapters"][0]["not_tried"]
    report = scan(machine(tmp_path / "other", {}), [], detect=lambda: ([], "It was not asked."))
    assert (report["adapters"], report["notes"], report["found"]) == ([], ["It was not asked."], False)


def test_python_can_answers_or_it_is_said_why_not() -> None:
    seen, why_not = adapters.seen_by_python_can()
    assert isinstance(seen, list) and (why_not is None or "python-can" in why_not)


@pytest.mark.parametrize("port", ["can7", "/dev/nowhere", "x\0y/", "../\x1b[31m"])
def test_a_port_that_is_not_there_is_refused(tmp_path: Path, port: str) -> None:
    with pytest.raises(Refusal) as refused:
        scan(machine(tmp_path, {}), [port])
    assert "There is no" in refused.value.sentence and refused.value.sentence.isprintable()


# --- the whole command ----------------------------------------------------------------------------------


@pytest.fixture
def simulated(arm_name: str, tmp_path: Path) -> Iterator[Stack]:
    stack = Stack(arm_name, tmp_path)
    stack.start_sim()
    yield stack
    stack.close()


@pytest.mark.process
def test_a_pseudo_terminal_is_scanned_and_a_file_proposed(simulated: Stack, tmp_path: Path) -> None:
    found = run_rtarm("scan", "--port", str(simulated.link), "--json")
    report = json.loads(found.stdout)
    assert (found.returncode, report["found"]) == (0, True)
    [entry] = report["adapters"]
    assert (entry["outcome"]["bitrate"], len(entry["outcome"]["drives"])) == (500_000, 6)
    truth = simulated.truth()
    assert all(len(joint.times_ns) == 0 or not joint.velocity_rad_s.any() for joint in truth.values())

    proposed = tmp_path / "my_arm.yaml"
    proposed.write_text(report["proposal"], encoding="utf-8")
    with pytest.raises(ConfigError, match="ratio"):
        load_arm(proposed)
    values = yaml.safe_load(report["proposal"])
    for joint in values["joints"]:
        joint |= {"ratio": 10, "direction": 1, "zero_deg": 0, "lower_deg": -90, "upper_deg": 90, "motor_rpm": 60}
        joint["max_acceleration_rad_s2"] = 1.0
    proposed.write_text(yaml.safe_dump(values), encoding="utf-8")
    assert load_arm(proposed).bus.resolved_channel == str(simulated.link)

    shown = run_rtarm("scan", "--port", str(simulated.link))
    assert "6 drives answer at 500000 bit/s" in shown.stdout
    assert report["proposal"] in shown.stdout

    fd = open_port(str(simulated.link), "cdc")  # as a control process holds it
    try:
        held = run_rtarm("scan", "--port", str(simulated.link))
    finally:
        os.close(fd)
    said = " ".join(held.stdout.split())  # however long the path is at which lines are folded
    assert held.returncode == 5 and "not tried: " in said and "is in use by another program" in said


def test_what_is_no_serial_port_is_not_tried(rtarm: Callable[..., Result]) -> None:
    result = rtarm("scan", "--port", "/dev/null")
    assert (result.exit_code, "/dev/null is not a serial port" in result.stdout) == (5, True)
