"""Settings of the families whose settings are a table, read and written on simulated arms in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from mixed_arm import ODRIVE, ZDT, arm_of
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.offline.settings.compare import Verdict
from rtloop.offline.settings.session import NotWritten, Session
from shm.words import Mode
from sim import faults
from sim.bus import Frame
from sim.drives import damiao
from sim.drives.canopen import NOT_IN_THIS_STATE, WRONG_VALUE


@dataclass(frozen=True)
class Case:
    """An arm of a family, what its drives tell, and a setting of its first joint that differs."""

    arm: str
    tells: dict[str, Any]  # values of the first joint's settings
    drive: dict[str, Any] = field(default_factory=dict)  # put into the section of the first drive
    bus: dict[str, Any] = field(default_factory=dict)
    setting: str = ""  # the one that differs; none where nothing is written
    spoil: Callable[[Any], None] = lambda drive: None  # makes it differ
    has: Callable[[Any], Any] = lambda drive: None  # what the drive has of it now
    had: Any = None
    wants: Any = None
    kept: bool = False
    stubborn: Callable[[Any], None] = lambda drive: None  # lets it keep what it has
    supply_v: float | None = 24.0

    @property
    def config(self) -> ArmConfig:
        values = load_arm(self.arm).model_dump(exclude_unset=True)
        values["joints"][0]["drive"].update(self.drive)
        values["bus"].update(self.bus)
        return ArmConfig.model_validate(values)


def spoil_range(drive: Any) -> None:
    drive.registers[damiao.VMAX] = drive._flash[damiao.VMAX] = 8.0


def lame_ramp(drive: Any) -> None:
    drive._does[0x43] = lambda data: data


def lame_heartbeat(drive: Any) -> None:
    drive.objects[0x1017, 0].write = lambda value: WRONG_VALUE


CASES = {
    "damiao": Case(
        "damiao6",
        {"firmware": 5017, "motor_id": 1, "master_id": 0x11, "bitrate": 1_000_000, "mode": "mit", "gear": 40.0},
        drive={"velocity_range_rad_s": 10.0},
        setting="velocity_range_rad_s",
        spoil=spoil_range,
        has=lambda drive: drive.registers[damiao.VMAX],
        had=8.0,
        wants=10.0,
        stubborn=lambda drive: setattr(drive, "_write", lambda register, data: None),
    ),
    "robstride": Case(
        "robstride6_position",
        {"mode": "control", "current_limit_a": 23.0, "can_timeout_ms": 0.0, "counts_from_power": "0 to 2π"},
        drive={"mode": "csp", "position_gain_1_s": 50.0},
        setting="position_gain_1_s",
        has=lambda drive: drive.parameters[0x701E],
        had=30.0,
        wants=50.0,
        stubborn=lambda drive: drive._does.update({18: lambda data16, data: drive.reply(drive._feedback())}),
    ),
    "myactuator": Case(
        "myactuator6",
        {"firmware": "20220206", "model": "X8S2V10", "brake": "locked", "speed_acceleration_dps_s": 10_000},
        setting="acceleration_dps_s",
        spoil=lambda drive: drive.settings.ramps_dps_s.__setitem__(1, 201),
        has=lambda drive: drive.settings.ramps_dps_s[0],
        had=10_000,
        wants=201,
        kept=True,
        stubborn=lame_ramp,
    ),
    "mks": Case(
        "mks6",
        {"firmware": "1.0.9", "hardware": "S42D_CAN", "mode": "SR_vFOC", "microsteps": 16, "current_ma": 1600},
        bus={"acknowledge": False},
        setting="response",
        has=lambda drive: drive.settings[0x8C],
        had=b"\x01\x01",
        wants=b"\x00\x00",
        kept=True,
        stubborn=lambda drive: setattr(drive, "_set", lambda code, arguments: 0),
        supply_v=None,
    ),
    "cia402": Case(
        "cia402_6",
        {"name": "rtarm simulated CiA 402 servo drive", "csp": True, "profile": 402, "counts_per_revolution": 131072.0},
        drive={"heartbeat_ms": 200},
        setting="heartbeat_ms",
        has=lambda drive: drive.number(0x1017),
        had=0,
        wants=200,
        stubborn=lame_heartbeat,
    ),
    "vesc": Case("vesc6", {"fault": "none", "let_go_by": "nothing", "power_stage_c": 30.0, "motor_c": 30.0}),
    "odrive": Case("odrive6", {"firmware": "0.5", "hardware": None, "axis_state": "idle"}),
}
WRITTEN = [family for family, case in CASES.items() if case.setting]
REMEMBERS = [family for family in WRITTEN if not CASES[family].kept]
"""Families whose drives forget without power what they were not told to store."""


@contextmanager
def at_rest(arm: ArmConfig, case: Case | None = None, found: list[Any] | None = None, **options: Any) -> Iterator[Any]:
    """An arm that nobody has brought up, and a session with it after its first reading."""
    virtual = VirtualArm(arm, faults=found or [], **options)
    assert virtual.sim is not None
    virtual.front_alive = False
    session = Session(arm, virtual.port, lambda: virtual.now_ns, virtual.cycle)
    virtual.cycles(3)
    if case is not None:
        case.spoil(virtual.sim.drives[0])
    session.read()
    yield virtual, virtual.sim.drives, session
    virtual.close()


def repower(virtual: VirtualArm, drive: Any) -> None:
    assert virtual.sim is not None
    drive.power_off(virtual.sim.now_ns)
    drive.power_on(virtual.sim.now_ns)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_drive_is_read_and_nothing_moves_or_changes(case: Case) -> None:
    with at_rest(case.config) as (virtual, drives, session):
        assert sorted(session.reports) == list(range(6))
        enabled = [drive.enabled for drive in drives]
        for joint, report in session.reports.items():
            assert report.answers and report.left_alone == []
            assert (report.address, report.supply_v) == (virtual.arm.joints[joint].drive.number, case.supply_v)
        found = {setting.name: setting.found for setting in session.reports[0].settings}
        assert {name: found[name] for name in case.tells} == case.tells
        assert virtual.memory["mode"] == Mode.OFFLINE
        virtual.sim.run_until(virtual.now_ns + 1)
        assert all(len(drive.shaft.changes_ns()) == 1 for drive in drives)
        assert [drive.enabled for drive in drives] == enabled
        before = [case.has(drive) for drive in drives]
        again = {joint: report.settings for joint, report in session.reports.items()}
        session.read()
        assert {joint: report.settings for joint, report in session.reports.items()} == again
        assert [case.has(drive) for drive in drives] == before
        assert all(getattr(drive, "rom_writes", 0) == 0 for drive in drives)


@pytest.mark.parametrize("family", WRITTEN)
def test_a_setting_that_differs_is_shown_written_and_read_back(family: str) -> None:
    case = CASES[family]
    with at_rest(case.config, case) as (virtual, drives, session):
        first = session.reports[0]
        assert [s.name for s in first.to_write] == [case.setting] and not first.agrees
        assert case.has(drives[0]) == case.had
        if case.kept:
            assert session.write(store=False).joints == [] and case.has(drives[0]) == case.had
            assert session.reports[0].to_write == first.to_write
        told: list[str] = []
        written = session.write(store=case.kept, told=told.append)
        assert (written.failure, written.joints[0], told[0]) == (None, "joint1", "joint1: written and read back")
        assert case.has(drives[0]) == case.wants
        assert session.reports[0].to_write == [] and session.reports[0].agrees
        repower(virtual, drives[0])
        assert case.has(drives[0]) == (case.wants if case.kept else case.had)


@pytest.mark.parametrize("family", REMEMBERS)
def test_stored_settings_outlive_the_power(family: str) -> None:
    case = CASES[family]
    with at_rest(case.config, case) as (virtual, drives, session):
        assert session.write(store=True).failure is None
        repower(virtual, drives[0])
        assert case.has(drives[0]) == case.wants


@pytest.mark.parametrize("family", REMEMBERS)
@pytest.mark.parametrize("late_s", [1.0, 60.0])
def test_a_drive_is_told_to_store_once_however_long_it_takes(family: str, late_s: float) -> None:
    """Flash wears out, and a drive that writes it is busy."""
    is_store: dict[str, Callable[[Frame], bool]] = {
        "cia402": lambda frame: frame.data == b"\x23\x10\x10\x01save",
        "damiao": lambda frame: frame.can_id == 0x7FF and frame.data[2] == damiao.STORE,
        "robstride": lambda frame: frame.can_id >> 24 == 22,
    }
    case = CASES[family]
    with at_rest(case.config, case) as (_, drives, session):
        drive, receive, delay_ns = drives[0], drives[0].receive, drives[0].reply_delay_ns
        stores: list[Frame] = []

        def late(now_ns: int, frame: Frame) -> None:
            if drive.concerns(frame) and is_store[family](frame):
                stores.append(frame)
                drive.reply_delay_ns = (round(late_s * 1e9),) * 2
            receive(now_ns, frame)
            drive.reply_delay_ns = delay_ns

        drive.receive = late
        written = session.write(store=True)
        assert len(stores) == 1
        if late_s < 3.0:
            assert written.failure is None and "joint1" in written.joints
        else:
            assert "does not say that it has stored what it was told" in str(written.failure)


@pytest.mark.parametrize("family", WRITTEN)
def test_a_drive_that_keeps_what_it_has_ends_it(family: str) -> None:
    case = CASES[family]
    with at_rest(case.config, case) as (_, drives, session):
        case.stubborn(drives[0])
        written = session.write(store=True)
        assert written.joints == [] and f"keeps another {case.setting}" in str(written.failure)
        assert "The drive of joint1 (" in str(written.failure) and case.has(drives[0]) == case.had


@pytest.mark.parametrize("family", WRITTEN)
def test_a_drive_that_falls_silent_amid_a_write_is_told(family: str) -> None:
    case = CASES[family]
    with at_rest(case.config, case) as (_, drives, session):
        drive, receive = drives[0], drives[0].receive

        def cut(now_ns: int, frame: Frame) -> None:
            receive(now_ns, frame)
            if case.has(drive) != case.had:
                drive.unplug(now_ns)

        drive.receive = cut
        written = session.write(store=True)
        assert written.joints == [] and "stopped answering" in str(written.failure)
        assert not session.reports[0].answers and session.reports[1].answers
        assert "does not answer" in session.reports[0].left_alone[0]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_silent_drive_and_two_at_one_address_are_told(case: Case) -> None:
    with at_rest(case.config, None, [faults.Silent("joint3", 0.0)]) as (virtual, _, session):
        drive = virtual.arm.joints[2].drive
        report = session.reports[2]
        assert (report.answers, report.settings, report.agrees) == (False, [], False)
        assert f"The drive of joint3 ({drive.number_field} {drive.number}) does not answer" in report.left_alone[0]
        assert f"{virtual.arm.bus.bitrate} bit/s" in report.left_alone[0]
        assert session.reports[1].answers and session.reports[1].left_alone == []


@pytest.mark.parametrize("family", WRITTEN)
def test_two_drives_at_one_address_are_told_and_nobody_is_written_to(family: str) -> None:
    case = CASES[family]
    with at_rest(case.config, case, [faults.SameAddress("joint2", 0.0)]) as (virtual, drives, session):
        drive = virtual.arm.joints[1].drive
        said = f"More than one drive answers at {drive.number_field} {drive.number} of joint2"
        assert said in session.reports[1].left_alone[0]
        with pytest.raises(NotWritten, match="More than one drive answers"):
            session.write(store=True)
        assert case.has(drives[0]) == case.had


@pytest.mark.parametrize("family", WRITTEN)
def test_nothing_is_written_while_a_joint_moves(family: str) -> None:
    case = CASES[family]
    with at_rest(case.config, case) as (virtual, drives, session):
        drives[4].disable(virtual.sim.now_ns)
        drives[4].lead(virtual.sim.now_ns, 0.2)
        with pytest.raises(NotWritten, match="joint5 moves"):
            session.write(store=True)
        assert case.has(drives[0]) == case.had
        assert "moves: settings are only written" in session.reports[4].left_alone[0]


@pytest.mark.parametrize("family", [family for family in CASES if family != "robstride"])
def test_an_error_is_told_and_its_drive_left_alone(family: str) -> None:
    case = CASES[family]
    with at_rest(case.config, case, [faults.Protection("joint1", 0.0)]) as (_, drives, session):
        report = session.reports[0]
        assert "has an error (" in report.left_alone[0] and "rtarm up … --clear-fault" in report.left_alone[0]
        assert report.to_write == [] and case.has(drives[0]) == (case.had if case.setting else None)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_line_that_garbles_answers_ends_in_reports(case: Case) -> None:
    with at_rest(case.config, None, [faults.CorruptBytes(0.02)]) as (_, drives, session):
        before = [case.has(drive) for drive in drives]
        for _ in range(3):
            session.read()
            assert len(session.reports) == 6
        assert [case.has(drive) for drive in drives] == before


# --- of one family


def test_an_enabled_damiao_motor_is_written_to_once_it_is_limp() -> None:
    case = CASES["damiao"]
    with at_rest(case.config, case) as (virtual, drives, session):
        frame = Frame(1, b"\xff" * 7 + b"\xfc", extended=False)
        drives[0].receive(virtual.sim.now_ns, frame)
        session.read()
        assert "is enabled, and is only written to while it is limp" in session.reports[0].left_alone[0]
        assert session.write(store=True).joints == [] and case.has(drives[0]) == case.had
        drives[0].disable(virtual.sim.now_ns)
        session.read()
        assert session.write(store=True).joints == ["joint1"]


def test_a_range_that_only_the_model_says_is_not_written() -> None:
    case = replace(CASES["damiao"], drive={})
    with at_rest(case.config, case) as (_, _, session):
        report = session.reports[0]
        (differs,) = [setting for setting in report.settings if setting.verdict is Verdict.DIFFERS]
        assert (differs.name, differs.wanted, differs.found, differs.writable) == (case.setting, 10.0, 8.0, False)
        assert "name velocity_range_rad_s in the arm file" in report.notes[0] and report.to_write == []


def test_an_alarm_of_a_damiao_motor_is_told() -> None:
    with at_rest(CASES["damiao"].config) as (_, drives, session):
        drives[2].registers[damiao.TIMEOUT] = 10_000
        session.read()
        assert "joint3: its drive lets go when it hears nothing for 500 ms" in session.reports[2].notes[0]


def test_a_cybergear_is_asked_for_no_storing_which_would_set_its_bit_rate() -> None:
    case = replace(CASES["robstride"], drive={"position_gain_1_s": 50.0}, tells={})
    with at_rest(case.config) as (_, drives, session):
        found = {setting.name: setting for setting in session.reports[0].settings}
        assert found["can_timeout_ms"].found is None and not found[case.setting].writable
        assert session.write(store=True).joints == [] and drives[0].bitrate_code is None


@pytest.mark.parametrize("zero_sta", [0, 1])
@pytest.mark.parametrize(("zero_deg", "fits"), [(180.0, 0), (0.0, 1)])
def test_what_a_robstride_counts_from_power_on_must_fit_its_joint(zero_deg: float, fits: int, zero_sta: int) -> None:
    """Its joint goes from -180 to 140 degrees."""
    values = replace(CASES["robstride"], drive={"mode": "csp"}).config.model_dump(exclude_unset=True)
    values["joints"][0]["zero_deg"] = zero_deg
    with at_rest(ArmConfig.model_validate(values)) as (_, drives, session):
        drives[0].settings = replace(drives[0].settings, zero_sta=zero_sta, can_timeout=20_000)
        session.read()
        verdict = Verdict.SAME if zero_sta == fits else Verdict.DIFFERS
        found = {setting.name: setting for setting in session.reports[0].settings}
        assert found["counts_from_power"].verdict is verdict and not found["counts_from_power"].writable
        assert "lets go when it hears nothing for 1000 ms" in session.reports[0].notes[0]


def test_two_mks_drives_of_one_can_id_are_not_asked_for_settings_even_when_they_have_stalled() -> None:
    """The answer of one would set the other."""
    with at_rest(CASES["mks"].config, None, [faults.SameAddress("joint2", 0.0)]) as (_, drives, session):
        asked: list[Frame] = []
        drive, receive = drives[1], drives[1].receive

        def listen(now_ns: int, frame: Frame) -> None:
            if drive.concerns(frame):
                asked.append(frame)
            receive(now_ns, frame)

        drive.receive, drive.stalled = listen, True
        session.read()
        assert "More than one drive answers" in session.reports[1].left_alone[0]
        assert asked and not [frame for frame in asked if frame.data[0] == 0x00]


def test_mks_firmware_that_cannot_be_asked_is_told() -> None:
    with at_rest(CASES["mks"].config) as (_, drives, session):
        obey = drives[0]._obey
        drives[0]._obey = lambda code, arguments: None if code in (0x00, 0x40) else obey(code, arguments)
        session.read()
        report = session.reports[0]
        assert report.answers and report.to_write == []
        assert all(s.verdict in (Verdict.NOT_NAMED, Verdict.UNKNOWN) for s in report.settings)
        assert "does not report its settings, which firmware V1.0.6 and newer does" in report.notes[0]


def test_microsteps_of_mks_that_falsify_speeds_are_told() -> None:
    with at_rest(CASES["mks"].config) as (_, drives, session):
        drives[0].settings[0x84] = b"\x08"
        session.read()
        assert "8 microsteps, with which its speed is not the one it is told" in session.reports[0].notes[0]


def test_a_cia402_drive_that_does_not_store_while_it_holds() -> None:
    case = CASES["cia402"]
    with at_rest(case.config, case) as (virtual, drives, session):
        for word in (b"\x06\0", b"\x07\0", b"\x0f\0"):
            drives[0].receive(virtual.sim.now_ns, Frame(0x601, b"\x2b\x40\x60\0" + word + b"\0\0", extended=False))
        assert drives[0].enabled
        session.read()
        written = session.write(store=True)
        assert "does not store what it was told (object 1010:01): not in the state" in str(written.failure)
        assert NOT_IN_THIS_STATE == 0x0800_0022 and case.has(drives[0]) == case.wants


def test_a_scale_that_the_arm_file_does_not_have_is_told() -> None:
    with at_rest(CASES["cia402"].config) as (_, drives, session):
        drives[0].objects[0x6091, 1].value = 2
        session.read()
        assert "make 65536 counts of a turn of the motor, the arm file 131072" in session.reports[0].notes[0]
        assert session.reports[1].notes == []


def test_odrives_of_both_firmwares_say_what_they_are() -> None:
    with at_rest(CASES["odrive"].config, odrive_firmware="0.6") as (_, _, session):
        report = session.reports[0]
        assert (report.firmware, report.hardware, report.agrees) == ("0.6.10", "4.4.58", True)
        assert "use odrivetool" in report.notes[0]


def test_an_odrive_without_heartbeats_is_told() -> None:
    with at_rest(CASES["odrive"].config) as (_, drives, session):
        drives[0].every("heartbeat", 0, lambda: None)
        session.read()
        assert "joint1: its drive sends no heartbeat" in session.reports[0].notes[1]


def test_families_on_one_bus_are_each_read_by_their_own_table() -> None:
    other = {"family": "robstride", "mode": "csp", "motor_id": 40, "position_gain_1_s": 50.0}
    arm = arm_of([{**ZDT, "address": 1}, {**ODRIVE, "node_id": 9}, other], rate_hz=100)
    with at_rest(arm) as (_, drives, session):
        assert [report.answers for report in session.reports.values()] == [True] * 3
        assert [s.name for s in session.reports[2].to_write] == ["position_gain_1_s"]
        assert session.write(store=False).joints == ["joint3"] and drives[2].parameters[0x701E] == 50.0
