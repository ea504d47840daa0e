"""Settings of drives read, compared and written, against simulated drives in virtual time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from virtual import VirtualArm

from config.errors import ConfigError
from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives import zdt_protocol as protocol
from rtloop.offline.settings.compare import Verdict, as_json
from rtloop.offline.settings.session import NotWritten, Session
from rtloop.offline.settings.zdt import report_of, wanted_block
from rtloop.offline.settings.zdt_talk import Reading
from shm.words import Mode
from sim import faults
from sim.drives.zdt_settings import Settings

BLOCK_ANSWER = bytes.fromhex(
    "42 21 15 19 02 02 02 00 10 01 00 03 E8 0B B8 0F A0 05 07 01 00 01 01 00 28 09 60 0F A0 00 01 6B"
)
"""The five packets of the facts' example (zdt-emm-v5.md 5), joined behind one function byte."""

WANTED = {"current_ma": 2500, "stall_protection": True, "stall_rpm": 40, "watchdog_ms": 1000}


def wanting(bus: dict[str, Any] | None = None, **drive: Any) -> ArmConfig:
    """episode1 whose drives are wanted so; the bus is a USB device, so that characters take no time."""
    arm = load_arm("episode1", overrides={"bus": {"serial_baud": "cdc", **(bus or {})}})
    values = arm.model_dump(exclude_unset=True)
    for joint in values["joints"]:
        joint["drive"].update(drive)
    return ArmConfig.model_validate(values)


def at_rest(arm: ArmConfig, found: Sequence[Any] = (), **options: Any) -> tuple[VirtualArm, Session]:
    """An arm that stands, and a session with it after its first reading."""
    virtual = VirtualArm(arm, faults=found, **options)
    virtual.front_alive = False
    session = Session(arm, virtual.port, lambda: virtual.now_ns, virtual.cycle)
    virtual.cycles(3)
    session.read()
    return virtual, session


def settings_of(virtual: VirtualArm, joint: int) -> Settings:
    assert virtual.sim is not None
    return virtual.sim.drives[joint].settings


def after_power_cycle(virtual: VirtualArm, joint: int) -> Settings:
    """What a drive has in its flash."""
    assert virtual.sim is not None
    drive = virtual.sim.drives[joint]
    drive.power_off(virtual.sim.now_ns)
    drive.power_on(virtual.sim.now_ns)
    return drive.settings


def verdicts(session: Session, joint: int = 0) -> dict[str, Verdict]:
    return {setting.name: setting.verdict for setting in session.reports[joint].settings}


# --- bytes ----------------------------------------------------------------------------------------------


def test_the_block_of_the_facts():
    block = protocol.block_of(BLOCK_ANSWER)
    assert block is not None
    assert (block.motor_type, block.microsteps, block.open_loop_ma, block.current_ma) == (0x19, 16, 1000, 3000)
    assert (block.max_mv, block.uart_code, block.bitrate, block.address) == (4000, 5, 500_000, 1)
    assert (block.checksum, block.response, block.stall_mode) == (0, 1, 1)
    assert (block.stall_rpm, block.stall_current_ma, block.stall_time_ms, block.reach_window) == (40, 2400, 4000, 1)


def test_a_block_is_written_with_address_and_screen_as_zero():
    block = protocol.block_of(BLOCK_ANSWER)
    assert block is not None
    expected = "48 D1 {} 19 02 02 02 00 10 01 00 03 E8 0B B8 0F A0 05 07 00 00 01 01 00 28 09 60 0F A0 00 01 6B"
    assert protocol.write_block(block, store=False) == bytes.fromhex(expected.format("00"))
    assert protocol.write_block(block, store=True) == bytes.fromhex(expected.format("01"))


def test_periodic_reports_of_the_facts():
    """`11 18 info ms16`, there `11 18 3A 00 0A 6B` for the status every 10 ms; 0 stops."""
    assert protocol.report_position(10) == bytes.fromhex("11 18 36 00 0A 6B")
    assert protocol.report_position(0) == bytes.fromhex("11 18 36 00 00 6B")
    assert (bytes.fromhex("11 02 6B"), bytes.fromhex("11 6B")) == protocol.REPORT_ACCEPTED


def test_fast_position_of_the_facts():
    """`F1 03 20 64 00 00 6B` is 800 rpm, acc 100, mode 00; ours is mode 01. `FC 00 00 0C 80 6B` is 3200 pulses."""
    assert protocol.fast_setup(800, 100) == bytes.fromhex("F1 03 20 64 01 00 6B")
    assert protocol.fast_target(3200) == bytes.fromhex("FC 00 00 0C 80 6B")
    assert protocol.fast_target(-3200) == bytes.fromhex("FC FF FF F3 80 6B")


def test_the_watchdog_of_the_facts():
    assert protocol.write_watchdog(5000, store=True) == bytes.fromhex("68 38 01 00 00 13 88 6B")


@pytest.mark.parametrize(
    ("answer", "text", "newer", "known"),
    [
        ("1F 7D 6F 6B", "1.2.5", False, True),
        ("1F 00 C8 00 6F 6B", "2.0.0", True, True),
        ("1F 01 2C 00 6F 6B", "3.0.0", True, False),
    ],
)
def test_versions(answer: str, text: str, newer: bool, known: bool):
    version = protocol.version_of(bytes.fromhex(answer))
    assert version is not None
    assert (str(version), version.hardware, version.newer, version.known) == (text, 111, newer, known)


def test_the_homing_parameters_of_the_facts():
    found = protocol.homing_of(bytes.fromhex("22 00 00 00 1E 00 00 27 10 01 2C 03 20 00 3C 00 6B"))
    assert found == protocol.HomingParameters(0, 0, 30, 10_000, 300, 800, 60, 0)


def test_signed_numbers_of_the_facts():
    assert protocol.signed_of(bytes.fromhex("35 01 05 DC 6B"), protocol.ASK_SPEED, 2) == -1500
    assert protocol.signed_of(bytes.fromhex("36 01 00 01 00 00 6B"), protocol.ASK_POSITION, 4) == -65536
    assert protocol.number_of(bytes.fromhex("24 5C 6A 6B"), protocol.ASK_SUPPLY, 2) == 23_658


@given(st.binary(max_size=40))
def test_any_answer_is_understood_or_not_understood(answer: bytes):
    for read in (protocol.block_of, protocol.homing_of, protocol.version_of):
        read(answer or None)
    protocol.signed_of(answer or None, protocol.ASK_POSITION, 4)


@given(st.binary(min_size=28, max_size=28))
def test_any_block_is_written_as_it_was_read(data: bytes):
    block = protocol.block_of(b"\x42\x21\x15" + data + b"\x6b")
    assert block is not None
    sent = bytearray(data)
    sent[7] = sent[16] = 0  # screen and address
    assert protocol.write_block(block, store=False) == b"\x48\xd1\x00" + sent + b"\x6b"


@given(st.binary(min_size=17, max_size=17), st.binary(min_size=10, max_size=10))
def test_a_block_changes_only_where_the_file_and_the_drive_differ(before: bytes, after: bytes):
    block = protocol.block_of(b"\x42\x21\x15" + before + b"\x00" + after + b"\x6b")  # with the checksum 6B
    found = Reading(protocol.Version(200, 111, newer=True), block, flags=1, rpm=0, position_counts=0)
    report = report_of(wanting({"acknowledge": True}, **WANTED), 0, found)
    assert block is not None and report.left_alone == []
    changed = asdict(wanted_block(block, report.to_write))
    fields = {"response": "response", "current_ma": "current_ma", "stall_protection": "stall_mode"}
    fields |= {"stall_rpm": "stall_rpm", "microsteps": "microstep_code"}
    assert {name for name, value in asdict(block).items() if changed[name] != value} == {
        fields[setting.name] for setting in report.to_write
    }
    assert (changed["current_ma"], changed["stall_mode"], changed["stall_rpm"], changed["response"]) == (2500, 1, 40, 1)


# --- reading --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("interface", ["slcan", "socketcan"])
def test_every_drive_is_read_and_nothing_moves(interface: str):
    bus = {"interface": interface, **({"channel": "can0"} if interface == "socketcan" else {})}
    virtual, session = at_rest(load_arm("episode1", overrides={"bus": bus}))
    assert virtual.sim is not None
    assert all(report.agrees for report in session.reports.values()) is False  # acknowledgements are still on
    for joint, report in session.reports.items():
        assert (report.answers, report.firmware, report.hardware, report.supply_v) == (True, "2.0.0", 111, 12.0)
        assert report.homing is not None and report.homing["mode"] == "stop"
        assert report.trip == {"temperature_c": 100, "current_ma": 6600, "time_ms": 1000}
        found = {setting.name: setting.found for setting in report.settings}
        assert (found["address"], found["bitrate"], found["microsteps"]) == (joint + 1, 500_000, 16)
        assert [setting.name for setting in report.to_write] == ["response"]
    assert virtual.memory["mode"] == Mode.OFFLINE
    assert all(not drive.moving and drive.enabled for drive in virtual.sim.drives)
    virtual.sim.run_until(virtual.now_ns + 1)
    assert all(len(drive.shaft.changes_ns()) == 1 for drive in virtual.sim.drives)


@pytest.mark.parametrize("rate_hz", [10, 20, 120])
@pytest.mark.parametrize("phase_ms", [0, 1, 30])
def test_answers_are_waited_for_as_long_as_cycles_last(rate_hz: int, phase_ms: int):
    """Between two cycles ordinary Python looks every 4 ms, as the control process does."""
    virtual = VirtualArm(load_arm("episode1", overrides={"control": {"rate_hz": rate_hz}}))
    virtual.cycles(3)
    now_ns = [virtual.now_ns + phase_ms * 1_000_000]

    def pause() -> None:
        now_ns[0] += 4_000_000
        while virtual.now_ns + virtual.period_ns <= now_ns[0]:
            virtual.cycle()

    session = Session(virtual.arm, virtual.port, lambda: now_ns[0], pause)
    session.read()
    assert all(report.answers for report in session.reports.values())


def test_what_the_file_does_not_name_is_only_shown():
    _, session = at_rest(wanting())
    named = {name for name, verdict in verdicts(session).items() if verdict != Verdict.NOT_NAMED}
    assert named == {"address", "bitrate", "checksum", "microsteps", "response"}


def test_what_the_file_names_is_compared():
    _, session = at_rest(wanting({"acknowledge": True}, firmware="2.0.0", **WANTED))
    assert {name for name, verdict in verdicts(session).items() if verdict == Verdict.DIFFERS} == {
        "current_ma",
        "watchdog_ms",
    }
    assert verdicts(session)["firmware"] == verdicts(session)["stall_protection"] == Verdict.SAME
    assert as_json(session.reports[0])["to_write"] == ["current_ma", "watchdog_ms"]


def test_old_firmware_has_no_watchdog_and_is_told_so():
    _, session = at_rest(wanting(firmware="2.0.0", watchdog_ms=1000), firmware="old")
    report = session.reports[0]
    assert (report.firmware, report.left_alone) == ("1.2.5", [])
    assert verdicts(session)["firmware"] == Verdict.DIFFERS
    assert verdicts(session)["watchdog_ms"] == Verdict.UNKNOWN
    assert any("has no watchdog" in note for note in report.notes)
    assert "watchdog_ms" not in [setting.name for setting in report.to_write]
    assert not report.agrees


def test_no_drive_answers():
    found = [faults.Silent(f"joint{n}", 0.0) for n in range(1, 7)]
    _, session = at_rest(wanting(), found)
    for joint, report in session.reports.items():
        assert not report.answers and not report.agrees
        assert f"(address {joint + 1}) does not answer" in report.left_alone[0]
        assert "500000 bit/s" in report.left_alone[0]


LEFT_ALONE = {
    "missing": (faults.Silent("joint2", 0.0), "does not answer"),
    "another checksum": (faults.WrongChecksums(1.0, joint="joint2"), "another checksum than 6B"),
    "X firmware": (faults.ForeignFirmware("joint2"), "37 bytes and 24 fields"),
    "in protection": (faults.Protection("joint2", 0.0), "is in protection (stall)"),
    "too hot": (faults.Protection("joint2", 0.0, cause="temperature"), "is in protection (over-temperature)"),
}


@pytest.mark.parametrize(("fault", "sentence"), LEFT_ALONE.values(), ids=LEFT_ALONE)
def test_a_drive_that_is_not_understood_is_told_and_left_alone(fault: Any, sentence: str):
    virtual, session = at_rest(wanting(current_ma=2500), [fault])
    assert [sentence in reason for reason in session.reports[1].left_alone] == [True]
    assert session.reports[1].to_write == []
    had = settings_of(virtual, 1)
    written = session.write(store=False)
    assert written.failure is None
    assert written.joints == ["joint1", "joint3", "joint4", "joint5", "joint6"]
    assert settings_of(virtual, 1) == had


def test_two_drives_at_one_address_are_told_and_nobody_is_written_to():
    """They take each other's answers for commands, and talk without end: the others are not heard over them."""
    virtual, session = at_rest(wanting(current_ma=2500), [faults.SameAddress("joint2", 0.0)])
    assert "More than one drive answers at address 2 of joint2" in session.reports[1].left_alone[0]
    assert all("the drives of joint2, which share" in session.reports[j].left_alone[0] for j in (0, 2, 3, 4, 5))
    with pytest.raises(NotWritten, match="More than one drive answers at address 2"):
        session.write(store=False)
    assert all(settings_of(virtual, joint).closed_loop_ma == 3000 for joint in range(6))


def test_a_drive_that_homes_at_power_up_and_one_without_power_are_told():
    virtual, session = at_rest(wanting(), homed=False)
    assert virtual.sim is not None
    drive = virtual.sim.drives[0]
    drive.homing = replace(drive.homing, at_power_up=1)
    session.read()
    notes = " ".join(session.reports[0].notes)
    assert "homes by itself" in notes and "has lost power" in notes


def test_a_motor_of_another_kind_and_microsteps_that_nobody_named_are_told():
    arm = wanting()
    values = arm.model_dump(exclude_unset=True)
    for joint in values["joints"]:
        del joint["drive"]["microsteps"]
    virtual, session = at_rest(ArmConfig.model_validate(values))
    assert virtual.sim is not None
    virtual.sim.drives[0].settings = replace(virtual.sim.drives[0].settings, motor_type=0x32, microstep=32)
    session.read()
    notes = " ".join(session.reports[0].notes)
    assert "another motor than one of 1.8°" in notes and "32 microsteps, the arm file names none" in notes
    assert "microsteps" not in [setting.name for setting in session.reports[0].to_write]


# --- the arm file ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["current_ma", "stall_rpm", "stall_current_ma", "stall_time_ms", "watchdog_ms"])
@pytest.mark.parametrize("value", [-1, 70_000, True, 1.5])
def test_bad_values_are_refused_where_they_stand(tmp_path, field: str, value: Any):
    from config.loader import ARMS_FOLDER

    text = (ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8")
    path = tmp_path / "arm.yaml"
    path.write_text(text.replace("address: 3,", f"address: 3, {field}: {str(value).lower()},"), encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_arm(path)
    assert refused.value.location == f"joints[2].drive.{field}" and refused.value.line
    assert f"{field} of joint3 is " in str(refused.value)


@pytest.mark.parametrize("value", [1, 299])
def test_a_watchdog_that_bites_too_early_is_refused(value: int):
    with pytest.raises(ValueError, match="300 or more, or 0"):
        wanting(watchdog_ms=value)
    assert wanting(watchdog_ms=0) and wanting(watchdog_ms=300)


@pytest.mark.parametrize("value", ["2", "3.0.0", "emm", "2.0.0\n"])
def test_a_firmware_is_a_version(value: str):
    with pytest.raises(ValueError, match="firmware"):
        wanting(firmware=value)


# --- writing --------------------------------------------------------------------------------------------


def test_only_what_is_named_is_written_and_only_to_volatile_memory():
    arm = wanting({"acknowledge": True}, current_ma=2500, stall_protection=False, microsteps=32, watchdog_ms=1500)
    virtual, session = at_rest(arm)
    before = settings_of(virtual, 0)
    written = session.write(store=False)
    assert (written.failure, written.joints) == (None, [joint.name for joint in arm.joints])
    changed = replace(before, closed_loop_ma=2500, stall_mode=0, microstep=32)
    assert settings_of(virtual, 0) == changed
    assert all(report.agrees for report in session.reports.values())
    assert after_power_cycle(virtual, 0) == before
    session.read()
    watchdog = next(s for s in session.reports[0].settings if s.name == "watchdog_ms")
    assert watchdog.found == 0


def test_stored_settings_outlive_the_power():
    virtual, session = at_rest(wanting({"acknowledge": True}, current_ma=2500, watchdog_ms=1500))
    session.write(store=True)
    assert after_power_cycle(virtual, 0).closed_loop_ma == 2500
    session.read()
    assert session.reports[0].agrees


def test_a_command_that_writes_is_sent_once_even_when_its_answer_is_lost():
    virtual, session = at_rest(wanting(current_ma=2500))
    assert virtual.sim is not None
    told: list[int] = []
    drive = virtual.sim.drives[0]
    write = drive._commands[0x48]
    drive._commands[0x48] = replace(write, act=lambda data: (told.append(1), write.act(data), drive_mute(drive))[1])

    def drive_mute(drive: Any) -> None:
        drive.reply_loss = 1.0  # its answer is lost; what is asked again later is answered

    session.read()
    del virtual.sim.drives[1:]
    spoke = session._pause

    def pause() -> None:
        spoke()
        if told and drive.reply_loss:
            drive.reply_loss = 0.0

    session._pause = pause
    assert session.write(store=True).failure is None
    assert told == [1]


def test_nothing_is_written_when_everything_is_as_wanted():
    virtual, session = at_rest(wanting({"acknowledge": True}))
    sent = len(virtual.sent)
    assert session.write(store=True).joints == []
    assert not any(b"48D1" in data for _, data in virtual.sent[sent:])


def test_a_write_that_does_not_stick_ends_it():
    virtual, session = at_rest(wanting(current_ma=2500), [faults.KeepsSettings("joint3")])
    written = session.write(store=False)
    assert written.joints == ["joint1", "joint2"]
    assert written.failure is not None
    assert "The drive of joint3 (address 3) keeps other values than it was told" in written.failure
    assert settings_of(virtual, 3).closed_loop_ma == 3000
    assert not session.reports[2].agrees and session.reports[1].agrees


@pytest.mark.parametrize("finished", range(7))
def test_whoever_asks_for_the_end_gets_it_after_the_drive_that_was_begun(finished: int):
    virtual, session = at_rest(wanting(current_ma=2500))
    told: list[str] = []
    written = session.write(store=True, told=told.append, ends=lambda: len(told) >= finished)
    names = [f"joint{number}" for number in range(1, 7)]
    assert written.joints == names[:finished]
    left = ", ".join(names[finished:])
    assert written.failure == (f"Ended as asked: nothing was written to the drives of {left}." if left else None)
    currents = [after_power_cycle(virtual, joint).closed_loop_ma for joint in range(6)]
    assert currents == [2500] * finished + [3000] * (6 - finished)


def test_a_drive_that_refuses_a_value_ends_it():
    virtual, session = at_rest(wanting(current_ma=2500))
    assert virtual.sim is not None
    command = virtual.sim.drives[0]._commands[0x48]
    virtual.sim.drives[0]._commands[0x48] = replace(command, act=lambda _: 0xE2)
    written = session.write(store=False)
    assert written.joints == [] and "refuses to be written" in str(written.failure)


@pytest.mark.parametrize("packets", range(6))
def test_a_drive_that_loses_its_cable_in_the_middle_of_a_write(packets: int):
    """After any number of the five packets: it has all of the new block or nothing of it, and it is said."""
    virtual, session = at_rest(wanting(current_ma=2500))
    assert virtual.sim is not None
    drive = virtual.sim.drives[0]
    heard, receive = [0], drive.receive

    def cut(now_ns: int, frame: Any) -> None:
        if heard[0] == packets and (packets == 5 or frame.data[:1] == b"\x48"):
            drive.unplug(now_ns)
            return
        if frame.data[:1] == b"\x48":
            heard[0] += 1
        receive(now_ns, frame)

    drive.receive = cut
    written = session.write(store=False)
    assert written.joints == [] and "stopped answering" in str(written.failure)
    had = settings_of(virtual, 0).closed_loop_ma
    assert had == (2500 if packets == 5 else 3000)
    assert settings_of(virtual, 1).closed_loop_ma == 3000
    drive.receive = receive
    drive.plug_in(virtual.sim.now_ns)
    session.read()
    assert session.reports[0].answers
    assert session.write(store=False).failure is None
    assert settings_of(virtual, 0).closed_loop_ma == 2500


def turn(virtual: VirtualArm, joint: int, rpm: int) -> None:
    """Somebody else lets a drive run."""
    from sim.bus import Frame

    assert virtual.sim is not None
    drive = virtual.sim.drives[joint]
    data = b"\xf6\x00" + rpm.to_bytes(2, "big") + b"\x00\x00\x6b"
    drive.receive(virtual.sim.now_ns, Frame(drive.settings.address << 8, data))


def test_nothing_is_written_while_any_joint_moves():
    virtual, session = at_rest(wanting(current_ma=2500))
    turn(virtual, 4, 30)
    with pytest.raises(NotWritten, match="joint5 moves"):
        session.write(store=False)
    assert all(settings_of(virtual, joint).closed_loop_ma == 3000 for joint in range(6))
    assert "turns at 30 rpm" in session.reports[4].left_alone[0]


def test_nothing_is_written_to_an_arm_that_was_led_elsewhere_meanwhile():
    virtual, session = at_rest(wanting(current_ma=2500))
    turn(virtual, 4, 30)
    virtual.cycles(10)
    turn(virtual, 4, 0)
    with pytest.raises(NotWritten, match="joint5 moves"):
        session.write(store=False)


def test_nothing_is_written_when_the_drives_are_not_as_they_were_shown():
    virtual, session = at_rest(wanting(current_ma=2500))
    assert virtual.sim is not None
    virtual.sim.drives[5].settings = replace(virtual.sim.drives[5].settings, closed_loop_ma=2000)
    with pytest.raises(NotWritten, match="differ from what was shown"):
        session.write(store=False)
    assert settings_of(virtual, 0).closed_loop_ma == 3000


def garbled_once(virtual: VirtualArm, joint: int, field: str, value: int, *, after: int = 0) -> None:
    """One answer about its settings, `after` so many true ones, has another value, whatever its drive has."""
    assert virtual.sim is not None
    drive = virtual.sim.drives[joint]
    read, asked = drive._reads[0x42], [0]

    def garbled() -> bytes:
        asked[0] += 1
        settings = drive.settings
        if asked[0] == after + 1:
            drive.settings = replace(settings, **{field: value})
        answer = bytes(read())
        drive.settings = settings
        return answer

    drive._reads[0x42] = garbled


@pytest.mark.parametrize(("field", "value"), [("can_code", 5), ("motor_type", 0x32), ("comms_port", 0)])
def test_a_field_that_is_garbled_in_one_of_two_readings_never_gets_into_the_drive(field: str, value: int):
    """The serial line of an adapter has no checksum, and all fields of a block are written back."""
    virtual, session = at_rest(wanting(current_ma=2500))
    had = settings_of(virtual, 2)
    garbled_once(virtual, 2, field, value)
    with pytest.raises(NotWritten, match="differ from what was shown"):
        session.write(store=True)
    assert after_power_cycle(virtual, 2) == had


@pytest.mark.parametrize("after", range(4))
def test_bring_up_writes_back_what_two_answers_agree_on(after: int):
    virtual = VirtualArm(load_arm("episode1", overrides={"bus": {"serial_baud": "cdc"}}))
    had = settings_of(virtual, 2)
    assert had.response == 1
    garbled_once(virtual, 2, "can_code", 5, after=after)
    virtual.bring_up()
    assert settings_of(virtual, 2) == replace(had, response=0)


def test_bring_up_does_not_write_what_is_told_otherwise_whenever_it_is_asked():
    virtual = VirtualArm(load_arm("episode1", overrides={"bus": {"serial_baud": "cdc"}}))
    assert virtual.sim is not None
    drive = virtual.sim.drives[2]
    had, read, asked = drive.settings, drive._reads[0x42], [0]

    def restless() -> bytes:
        asked[0] += 1
        drive.settings = replace(had, max_mv=asked[0])
        answer = bytes(read())
        drive.settings = had
        return answer

    drive._reads[0x42] = restless
    talk = virtual.bring_up()
    assert "joint3 tells its configuration in another way" in str(talk.failure)
    assert drive.settings == had


def test_nothing_else_than_questions_and_two_commands_is_ever_sent():
    """No motion, no enabling, no calibration, no factory reset, no auto-run, whatever the settings are."""
    virtual, session = at_rest(wanting(current_ma=2500, watchdog_ms=500), [faults.Silent("joint2", 0.0)])
    session.write(store=True)
    lines = b"".join(data for _, data in virtual.sent).split(b"\r")
    functions = {line[10:12] for line in lines if line[:1] == b"T"}
    assert functions <= {b"13", b"1F", b"22", b"24", b"16", b"35", b"36", b"3A", b"3B", b"42", b"48", b"68"}
