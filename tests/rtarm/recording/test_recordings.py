"""Recordings: written, read back the same, told, drawn, played, and refused with a sentence when they are none."""

from __future__ import annotations

import asyncio
import io
import json
import os
import random
import signal
import stat
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_chinese import english_in
from mcap.reader import make_reader
from mcap.writer import Writer
from mixed_arm import mixed
from rich.cells import cell_len
from rich.console import Console
from typer.testing import Result
from virtual import VirtualArm, recorded_goal, recording_of
from written_arm import WrittenArm

from config.loader import load_arm
from rtarm.console.errors import Refusal
from rtarm.console.reporter import Reporter
from rtarm.launch import launcher
from rtarm.launch.plan import Plan
from rtarm.recording import __main__ as writer_process
from rtarm.recording import after_fault, folder, make, mcap_format, mcap_reader, mcap_writer, story
from rtarm.recording.after_fault import FaultRecorder
from rtarm.recording.chart import Series, chart
from rtarm.recording.explain import explanation
from rtarm.recording.mcap_format import Reason
from rtarm.recording.mcap_writer import NotWritten
from rtarm.recording.playback import Playback
from rtarm.top.picture import Picture
from rtloop.wire.slcan import BEL
from shm import files, layout
from shm.files import Bus
from shm.recording import Recording
from shm.words import BusState, DriveStatus, Event, Fault, Mode, Outcome
from sim.faults import PowerLoss, Stall

Rtarm = Callable[..., Result]

NOW = Reason("asked", "Asked for by a person.")
GOAL = "large"
EPOCH_NS = 1_700_000_000_000_000_000


def executing(cycles: int = 120) -> VirtualArm:
    """The arm amid a recorded goal."""
    arm = VirtualArm("episode1", start_rad=recorded_goal(GOAL)["joints"][0, :, 0])
    arm.memory["timing"]["epoch_offset_ns"] = EPOCH_NS
    assert arm.bring_up().failure is None
    arm.play(GOAL)
    arm.cycles(cycles)
    return arm


@pytest.fixture(scope="module")
def power_loss() -> Recording:
    """joint2's drive loses its power in motion, after a garbled line that has nothing to do with it."""
    arm = executing()
    arm.receive(arm.now_ns, bytes([BEL]))
    arm.cycles(120)
    arm.sim.inject(PowerLoss("joint2", at_s=0.0, off_s=60.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["fault"]["code"] != Fault.NONE)
    arm.cycles(240)
    return recording_of(arm)


@pytest.fixture(scope="module")
def stalled() -> Recording:
    arm = executing()
    arm.sim.inject(Stall("joint3", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["fault"]["code"] != Fault.NONE)
    arm.cycles(120)
    return recording_of(arm)


@pytest.fixture(scope="module")
def a_file(power_loss: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "power_loss.mcap"
    mcap_writer.write(power_loss, Reason("fault", "joint2 has not answered."), path)
    return path


@pytest.fixture
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where this user's recordings are kept, for one test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return folder.folder()


def bag(path: Path) -> None:
    """As ROS records it: CDR, and messages of which not all can be read."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1000)
        writer.start(profile="ros2", library="libmcap 1.1.0")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"float64[] position")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for number in range(100):
            writer.add_message(channel, number, bytes([0, 1, 0, 0, *range(200)]), number)
        writer.finish()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


# --- the file -----------------------------------------------------------------------------------------------


def test_what_is_read_is_what_was_written(power_loss: Recording, a_file: Path) -> None:
    loaded = mcap_reader.read(a_file)
    assert (loaded.damage, loaded.reason) == ("", Reason("fault", "joint2 has not answered."))
    found = loaded.recording
    for name in ("arm", "joints", "arm_hash", "pid", "period_ns", "buses", "lost"):
        assert getattr(found, name) == getattr(power_loss, name), name
    for name in set(power_loss.records.dtype.names) - {"crc", "decisions_crc"}:  # check sums of the ring itself
        assert found.records[name].tobytes() == power_loss.records[name].tobytes(), name
    for name in ("events", "limits", "identifiers", "scheduling", "lateness", "cycle_time"):
        assert getattr(found, name).tobytes() == getattr(power_loss, name).tobytes(), name
    order = np.argsort(power_loss.frames["monotonic_ns"], kind="stable")
    for name in ("monotonic_ns", "head", "data"):
        assert found.frames[name].tolist() == power_loss.frames[name][order].tolist(), name


def test_a_plain_reader_finds_channels_schemas_and_ros_times(power_loss: Recording, a_file: Path) -> None:
    with a_file.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        topics = {channel.topic: channel for channel in summary.channels.values()}
        joints = {f"/rtarm/joints/{name}" for name in power_loss.joints}
        others = {"/rtarm/events", "/rtarm/frames", "/rtarm/commands", "/rtarm/statistics"}
        assert set(topics) == {"/rtarm/state", *others, *joints}
        assert {channel.message_encoding for channel in topics.values()} == {"json"}
        for schema in summary.schemas.values():
            assert schema.encoding == "jsonschema" and json.loads(schema.data)["type"] == "object"
        counts = {topics[name].id: len(power_loss.records) for name in ("/rtarm/state", *joints)}
        assert summary.statistics.channel_message_counts.items() >= counts.items()
        times = []
        for schema, channel, message in reader.iter_messages(["/rtarm/state", "/rtarm/joints/joint2", "/rtarm/events"]):
            content = json.loads(message.data)
            properties = json.loads(schema.data)["properties"]
            assert set(content) == set(properties), channel.topic
            if channel.topic == "/rtarm/state":
                times.append(message.log_time)
                assert message.log_time == content["epoch_ns"]
        assert times == power_loss.records["epoch_ns"].tolist()
        assert times[0] > EPOCH_NS
        names = {record.name for record in reader.iter_metadata()}
        assert names == {"rtarm", "rtarm.limits", "rtarm.timing"}


def messages(path: Path, topic: str) -> list[dict[str, Any]]:
    with path.open("rb") as file:
        return [json.loads(message.data) for _, _, message in make_reader(file).iter_messages([topic])]


def test_each_frame_is_told_with_the_joint_whose_drive_it_is_of(tmp_path: Path) -> None:
    """ZDT drives and ODrives in turn, whose numbers are the same: 1 << 8 extended, 2 << 5 standard."""
    arm = VirtualArm(mixed())
    assert arm.bring_up().failure is None
    path = tmp_path / "mixed.mcap"
    mcap_writer.write(recording_of(arm), NOW, path)
    frames = messages(path, mcap_format.FRAMES)
    assert {frame["joint"] for frame in frames} == {f"joint{number}" for number in range(1, 7)}
    for frame in frames:
        number = frame["id"] >> 8 if frame["extended"] else frame["id"] >> 5
        assert frame["joint"] == f"joint{number}", frame
    assert {frame["sent"] for frame in frames} == {True, False}


def test_what_nobody_or_more_than_one_drive_owns_is_nobodys(power_loss: Recording, tmp_path: Path) -> None:
    identifiers = power_loss.identifiers.copy()
    identifiers["match"][2] = identifiers["match"][1]
    path = tmp_path / "doubtful.mcap"
    mcap_writer.write(Recording(**{**vars(power_loss), "identifiers": identifiers}), NOW, path)
    assert {frame["joint"] for frame in messages(path, mcap_format.FRAMES)} == {
        None,
        *(name for name in power_loss.joints if name not in ("joint2", "joint3")),
    }


def test_a_file_of_before_is_read_as_one_whose_drives_measured_nothing(
    power_loss: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such files lack words of the joints and the identifiers, and have an address among the limits."""
    records = power_loss.records[:5].copy()
    records["joints"]["drive_temperature_c"] = 40.0
    whole = Recording(**{**vars(power_loss), "records": records})
    path = tmp_path / "before.mcap"
    before = [name for name in mcap_format.JOINT_WORDS if name not in mcap_format.LATER_JOINT_WORDS]
    described = mcap_writer._metadata(whole, NOW)
    limits = json.loads(described["rtarm.limits"]["joints"])
    described["rtarm.limits"]["joints"] = json.dumps(
        {name: {**row, "drive_address": 3} for name, row in limits.items()}
    )
    del described["rtarm"]["identifiers"]
    with monkeypatch.context() as patch:
        patch.setattr(mcap_writer, "JOINT_WORDS", before)
        patch.setattr(mcap_writer, "_metadata", lambda *_: described)
        mcap_writer.write(whole, NOW, path)
    assert "drive_voltage_v" not in messages(path, mcap_format.JOINTS + "joint1")[0]
    loaded = mcap_reader.read(path)
    assert loaded.damage == "" and len(loaded.recording.identifiers) == 0
    found = loaded.recording.records
    for word in mcap_format.LATER_JOINT_WORDS:
        assert np.isnan(found["joints"][word]).all()
    for word in before:
        assert found["joints"][word].tobytes() == records["joints"][word].tobytes(), word
    assert loaded.recording.limits.tobytes() == power_loss.limits.tobytes()


def test_what_a_drive_said_and_had_measured_is_told(power_loss: Recording, tmp_path: Path) -> None:
    records = power_loss.records.copy()
    rows = records["joints"][:, 2]
    said_from = len(records) - 20
    rows["drive_status"][said_from:] |= int(DriveStatus.PROTECTED | DriveStatus.OVER_TEMPERATURE)
    rows["drive_temperature_c"], rows["measured_effort"] = 81.4, -2.5
    recording = Recording(**{**vars(power_loss), "records": records})
    sentences = [line.sentence for line in told(recording).lines if line.joint == 2]
    assert "The drive of joint3 reports that it is too hot (81 °C, -2.50 Nm)." in sentences
    assert any(sentence.startswith("The drive of joint3 reports that it has an error") for sentence in sentences)
    path = tmp_path / "hot.mcap"
    mcap_writer.write(recording, NOW, path)
    last = messages(path, mcap_format.JOINTS + "joint3")[-1]
    assert (last["drive_temperature_c"], last["drive_voltage_v"]) == (81.4, None)
    assert {"enabled", "protected", "over-temperature"} <= set(last["drive_says"])


def test_numbers_that_json_does_not_know_are_null(power_loss: Recording, tmp_path: Path) -> None:
    records = power_loss.records[:3].copy()
    records["joints"]["measured_position_rad"][:, 0] = [np.nan, np.inf, 1.0]
    records["mode"] = [2, 99, 3]
    path = tmp_path / "odd.mcap"
    mcap_writer.write(Recording(**{**vars(power_loss), "records": records}), NOW, path)
    found = mcap_reader.read(path).recording.records
    assert np.isnan(found["joints"]["measured_position_rad"][:2, 0]).all()
    assert found["mode"].tolist() == [2, 99, 3]


def test_a_full_disk_costs_a_sentence_and_leaves_nothing(
    power_loss: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(mcap_writer, "_write", full)
    with pytest.raises(NotWritten, match=r"cannot be written \(No space left on device\): free some space there\.$"):
        mcap_writer.write(power_loss, NOW, tmp_path / "new" / "full.mcap")
    assert list((tmp_path / "new").iterdir()) == []


def test_only_the_newest_are_kept_of_each_arm(power_loss: Recording, state_home: Path) -> None:
    state_home.mkdir(parents=True)
    for number in range(folder.KEPT + 5):
        for arm in ("left", "left_2"):
            path = state_home / f"{arm}-20260101T0000{number:02d}Z-wire.mcap"
            path.touch()
            os.utime(path, (number, number))
    folder.remove_old("left")
    assert len(folder.recordings("left")) == folder.KEPT
    assert len(folder.recordings("left_2")) == folder.KEPT + 5
    assert folder.newest().stat().st_mtime == folder.KEPT + 4
    first, second = folder.new_path("left", "wire"), folder.new_path("left", "wire")
    assert first == second
    first.touch()
    assert folder.new_path("left", "wire") != first


def test_a_recording_is_for_its_user_alone(power_loss: Recording, tmp_path: Path) -> None:
    path = tmp_path / "new" / "below" / "recording.mcap"
    before = os.umask(0)
    try:
        mcap_writer.write(power_loss, NOW, path)
    finally:
        os.umask(before)
    modes = [stat.S_IMODE(one.stat().st_mode) for one in (path, path.parent, path.parent.parent)]
    assert modes == [0o600, 0o700, 0o700]


@pytest.mark.parametrize(
    ("make_it", "said"),
    [
        (os.mkfifo, "is a link, a device or a pipe"),
        (lambda path: path.symlink_to("elsewhere"), "is a link, a device or a pipe"),
        (lambda path: path.symlink_to("/dev/null"), "is a link, a device or a pipe"),
        (lambda path: path.write_text("thesis"), "is there and no recording of rtarm's"),
        (lambda path: path.touch(), "is there and no recording of rtarm's"),
        (bag, "is there and no recording of rtarm's"),
        (lambda path: path.mkdir(), "is a folder: name a file in it"),
    ],
    ids=["pipe", "link", "link to a device", "text", "empty", "bag", "folder"],
)
def test_nothing_but_a_recording_is_replaced(
    power_loss: Recording, tmp_path: Path, make_it: Callable[[Path], None], said: str
) -> None:
    path = tmp_path / "target"
    make_it(path)
    before = path.lstat()
    with pytest.raises(NotWritten) as refused:
        mcap_writer.write(power_loss, NOW, path)
    assert said in refused.value.sentence and "\n" not in refused.value.sentence
    assert [one.name for one in tmp_path.iterdir()] == ["target"]
    assert (path.lstat().st_ino, path.lstat().st_size) == (before.st_ino, before.st_size)


def test_a_device_is_not_replaced(power_loss: Recording) -> None:
    with pytest.raises(NotWritten, match="is a link, a device or a pipe"):
        mcap_writer.write(power_loss, NOW, Path("/dev/null"))
    assert Path("/dev/null").is_char_device()


def test_an_older_recording_is_replaced(power_loss: Recording, a_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "older.mcap"
    path.write_bytes(a_file.read_bytes())
    mcap_writer.write(Recording(**{**vars(power_loss), "records": power_loss.records[:9]}), NOW, path)
    assert len(mcap_reader.read(path).recording.records) == 9


def test_old_recordings_make_room_by_their_bytes_and_what_is_not_ours_stays(
    state_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder, "KEPT_BYTES", 250)
    state_home.mkdir(parents=True)
    names = [f"arm-20260101T00000{number}Z-wire.mcap" for number in range(4)]
    aside, fresh = f"{mcap_writer.ASIDE_PREFIX}abc{mcap_writer.ASIDE_SUFFIX}", f"{mcap_writer.ASIDE_PREFIX}def.new"
    for age, name in enumerate([*reversed(names), "bag.mcap", "arm-notes.mcap", ".other.new", aside]):
        (state_home / name).write_bytes(bytes(100))
        os.utime(state_home / name, (1_000_000 - age, 1_000_000 - age))
    (state_home / fresh).touch()
    folder.remove_old("arm")
    left = {path.name for path in state_home.iterdir()}
    assert left == {*names[2:], "bag.mcap", "arm-notes.mcap", ".other.new", fresh}
    (state_home / names[3]).write_bytes(bytes(300))
    folder.remove_old("arm")
    assert folder.recordings() == [state_home / names[3]]


def test_a_user_without_a_home_is_told_so(rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    result = rtarm("explain")
    assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1)
    assert "has no home folder" in result.stderr and "set HOME or XDG_STATE_HOME" in result.stderr


def test_the_writing_of_a_large_arms_recording_may_take_longer(tmp_path: Path) -> None:
    with (tmp_path / "state").open("wb") as file:
        file.truncate(212 << 20)
        large_s = make.patience_s(file.fileno())
        file.truncate(6 << 20)
        assert 60.0 < make.patience_s(file.fileno()) < 100.0
    assert 600.0 < large_s < 1000.0


@pytest.mark.parametrize("command", ["record", "explain", "replay", "status", "doctor"])
def test_usage_shows_an_optional_argument_in_one_pair_of_brackets(rtarm: Rtarm, command: str) -> None:
    usage = next(line for line in rtarm(command, "--help").stdout.splitlines() if "Usage:" in line)
    assert "[[" not in usage and ("[ARM]" in usage or "[FILE]" in usage)


# --- the story ----------------------------------------------------------------------------------------------


def told(recording: Recording, reason: Reason = NOW) -> story.Story:
    return story.tell(recording, reason)


def test_the_story_of_a_drive_that_loses_its_power(power_loss: Recording) -> None:
    """Golden: what led there names joint2 first, in its order, with its times."""
    found = told(power_loss)
    assert (found.fault, found.joint) == (Fault.STALE_READING, 1)
    assert found.first is not None
    assert (found.first.joint, found.first.sentence) == (1, "joint2 gives no readings from here on.")
    lines = [f"{story.since(line.monotonic_ns, found.zero_ns).strip()} {line.sentence}" for line in found.lines]
    starts = [
        "-2.442 s Mode: bringing up.",
        "-2.117 s Mode: holding.",
        "-2.100 s Goal 1 was announced.",
        "-2.100 s Mode: executing.",
        "-2.100 s Goal 1 moves the arm, 3.80 s long.",
        "-1.100 s 1 garbled line from the adapter, or refusals of it.",
        "joint2 gives no readings from here on.",
        "joint2 is late: its reading is",
        "0 s joint2 has given no believable answer for 0.10",
        "0 s Mode: fault.",
        "0 s The control process latched a fault and stopped the arm",
        "0 s Each joint brakes by itself, since the path cannot be trusted.",
        "No joint is commanded to move any more.",
    ]
    missing = [start for start in starts if not any(start in line for line in lines)]
    assert not missing, "\n".join(lines)
    assert found.verdict[0].startswith("joint2 has given no believable answer for 0.10")
    assert found.verdict[1].startswith("Then each joint braked by itself and came to rest 0.")
    assert found.verdict[-1].startswith("What to do: Check the drive's supply, plug and cable")


def test_a_held_shaft_is_told_by_what_its_drive_said_and_by_the_limit(stalled: Recording) -> None:
    found = told(stalled)
    assert (found.fault, found.joint) == (Fault.FOLLOWING_ERROR, 2)
    signs = [line for line in found.lines if line.sign and line.monotonic_ns < found.zero_ns]
    assert {line.joint for line in signs} == {2}
    assert any("half of the 0.1000 rad" in line.sentence for line in signs)
    assert "and 0.1000 rad are allowed" in found.verdict[0]


def test_a_goal_that_succeeds_has_no_fault_and_no_signs() -> None:
    arm = executing(10)
    assert arm.end_of(1) == Outcome.SUCCEEDED
    found = told(recording_of(arm))
    assert (found.fault, found.first) == (0, None)
    assert not [line for line in found.lines if line.sign]
    assert found.verdict == ["No fault was latched in this recording."]


def test_missed_cycles_a_silent_front_and_requests_are_told() -> None:
    arm = executing()
    arm.cycle(4)
    arm.cycles(30)
    arm.writer.hold()
    arm.cycles(100)
    arm.writer.resume()
    arm.cycles(20)
    arm.front_alive = False
    arm.until(lambda: arm.outcome(1) == Outcome.FRONT_LOST)
    sentences = [line.sentence for line in told(recording_of(arm)).lines]
    for expected in (
        "3 control cycles were missed after this.",
        "A person paused the goal",
        "Hold was asked for by process ",
        "Resume was asked for by process ",
        "The ROS process gives no sign of life",
    ):
        assert any(sentence.startswith(expected) for sentence in sentences), (expected, sentences)
    assert not any("joint" in sentence and "no readings" in sentence for sentence in sentences)


def test_what_the_can_controller_told_is_told(power_loss: Recording) -> None:
    records = power_loss.records.copy()
    records["error_frames"][100:] += 3
    records["unacknowledged"][100:] += 1
    records["bus_state"][100:200] = BusState.PASSIVE
    found = told(Recording(**{**vars(power_loss), "records": records}))
    sentences = [line.sentence for line in found.lines if line.monotonic_ns == records["monotonic_ns"][100]]
    assert sentences == [
        "3 errors that the CAN controller told of.",
        "1 error of the CAN controller because no drive acknowledged a frame.",
        "The CAN controller is passive now.",
    ]
    assert any(line.sentence == "The CAN controller is active now." and not line.sign for line in found.lines)


def blaming_nobody(recording: Recording, fault: Fault, garbled: dict[int, int]) -> Recording:
    """The same with a fault that names no joint, and so many garbled lines so many cycles before it."""
    records = recording.records.copy()
    at = story._latched(records)
    assert at is not None
    records["fault"][at:], records["fault_joint"][at:] = fault, -1
    records["wire_errors"] = 0
    for before, count in garbled.items():
        records["wire_errors"][at - before :] += count
    events = recording.events[recording.events["joint"] < 0]
    return Recording(**{**vars(recording), "records": records, "events": events[events["kind"] != Event.FAULT]})


@pytest.mark.parametrize(
    ("garbled", "first"),
    [
        ({200: 1}, None),  # 1.7 s
        ({}, None),
        ({200: 1, 40: 2}, "2 garbled lines from the adapter"),  # 0.33 s
        ({90: 1, 50: 1, 10: 1}, "3 garbled lines from the adapter, or refusals of it within 0.67 s."),
    ],
    ids=["long ago", "no sign", "long ago and just before", "a burst until just before"],
)
@pytest.mark.parametrize("fault", [Fault.WIRE, Fault.LINK_DOWN])
def test_a_fault_without_a_joint_comes_first_but_for_what_went_wrong_just_before(
    power_loss: Recording, fault: Fault, garbled: dict[int, int], first: str | None
) -> None:
    found = told(blaming_nobody(power_loss, fault, garbled))
    assert (found.fault, found.joint) == (fault, -1)
    assert found.first is not None
    if first is None:
        assert found.first.sentence == found.verdict[0]
    else:
        assert found.first.sentence.startswith(first)


def test_a_homing_run_goes_on_after_a_death(power_loss: Recording) -> None:
    records = power_loss.records[power_loss.records["fault"] == Fault.NONE].copy()
    records["joints"]["commanded_velocity_rad_s"][-1] = 0.0
    records["mode"][-1] = Mode.REFERENCING
    found = told(Recording(**{**vars(power_loss), "records": records}), Reason("death", "It died."))
    assert found.verdict[0].endswith("; a drive amid its homing run goes on.")


@pytest.mark.parametrize(
    ("bitrate", "velocity_rad_s", "then"),
    [
        (500_000, 0.1, "the drives went on for a moment and stopped by themselves."),
        (500_000, 0.0, "no joint was commanded to move then."),
        (0, 0.1, "it had no bus, and so no drives."),
    ],
)
def test_what_the_drives_did_after_a_death_is_said_of_drives_that_moved(
    power_loss: Recording, bitrate: int, velocity_rad_s: float, then: str
) -> None:
    records = power_loss.records[power_loss.records["fault"] == Fault.NONE].copy()
    records["joints"]["commanded_velocity_rad_s"][-1] = [0.0] * 5 + [velocity_rad_s]
    found = told(
        Recording(**{**vars(power_loss), "records": records, "buses": (Bus("", bitrate),) if bitrate else ()}),
        Reason("death", "It died."),
    )
    assert found.verdict[0].endswith(f"(killed, or by a defect); {then}")


def test_a_recording_of_a_death_ends_with_the_last_cycle(power_loss: Recording) -> None:
    alive = power_loss.records["fault"] == Fault.NONE
    found = told(Recording(**{**vars(power_loss), "records": power_loss.records[alive]}), Reason("death", "It died."))
    assert found.lines[-1].sentence == "The last cycle of the control process."
    assert found.zero_ns == found.lines[-1].monotonic_ns
    assert found.verdict[0].startswith("The control process ended without an orderly end")


@pytest.mark.parametrize("width", [40, 80, 200])
def test_an_explanation_fits_its_terminal(a_file: Path, width: int) -> None:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(explanation(a_file))
    text = console.file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert "First of all: joint2" in " ".join(text.split())
    assert "Position of joint2 (rad): · commanded" in text
    assert "┊" in text and "●" in text


@pytest.mark.parametrize("width", [40, 80, 200])
def test_an_explanation_in_chinese_fits_its_terminal_and_has_no_english(a_file: Path, width: int) -> None:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(explanation(a_file, language="zh"))
    text = console.file.getvalue()
    assert max(map(cell_len, text.splitlines())) <= width
    assert english_in(text) == set() and "…" not in text
    once = "".join(text.split())
    assert "最先：joint2从这里开始没有读数。" in once
    assert "joint2已有" in once and "没有给出可信的应答，允许0.100s：检查驱动器的供电、插头和电缆" in once
    assert "怎么处理：检查驱动器的供电、插头和电缆；清除故障。" in once


def test_a_replay_in_chinese_says_so(power_loss: Recording) -> None:
    clock = [0]
    with closing(Playback(power_loss, 1.0, lambda: clock[0], "zh")) as replay:
        clock[0] = 60_000_000_000
        last = replay.look()
    console = Console(file=io.StringIO(), width=100, height=40, color_system=None)
    console.print(Picture(last))
    text = console.file.getvalue()
    assert english_in(text) == set()
    assert "录制到此结束" in text and "episode1：故障，不能运动" in text


@pytest.mark.parametrize("language", ["en", "zh"])
def test_what_programs_read_of_a_recording_is_english(rtarm: Rtarm, a_file: Path, language: str) -> None:
    result = rtarm("explain", str(a_file), "--json", "--language", language)
    assert result.exit_code == 0
    assert json.loads(result.stdout)["first"]["sentence"].startswith("joint2 gives no readings")


def test_a_chart_puts_values_where_they_belong() -> None:
    times = np.array([-1.0, 0.0, 1.0])
    lines = chart([Series("x", times, np.array([0.0, 1.0, np.nan]))], (-1.0, 1.0), 42, 5)
    assert [line.rstrip() for line in lines] == [
        "    1.0500 │              x",
        "           │              ┊",
        "    0.5000 │              ┊",
        "           │              ┊",
        "   -0.0500 │x             ┊",
        "            -1.00 s       0        +1.00 s",
    ]
    assert chart([Series("x", times, np.full(3, np.nan))], (-1.0, 1.0), 42, 5) == []


# --- played back --------------------------------------------------------------------------------------------


def test_a_replay_shows_what_was_to_be_seen_then(power_loss: Recording) -> None:
    clock = [0]
    replay = Playback(power_loss, 0.5, lambda: clock[0])
    first = replay.look().report
    assert first is not None and first["mode"] == "bringing_up"
    clock[0] = 4_000_000_000  # two of its seconds
    look = replay.look()
    assert look.report is not None
    assert (look.report["mode"], look.report["healthy"]) == ("executing", True)
    at = np.searchsorted(power_loss.records["monotonic_ns"], power_loss.records["monotonic_ns"][0] + 2_000_000_000)
    assert look.report["cycles"] in power_loss.records["cycle"][at - 1 : at + 1]
    assert look.recent is not None and look.recent["bus"]["frames_tx"] > 0
    clock[0] = 60_000_000_000
    last = replay.look()
    assert last.report is not None and last.report["fault"]["joint"] == "joint2"
    assert last.report["problems"][0].startswith("The recording ends here, after 4.")
    console = Console(file=io.StringIO(), width=100, height=40, color_system=None)
    console.print(Picture(last))
    text = console.file.getvalue()
    assert "joint2 has given no believable" in text and "episode1: fault, not fit to move" in text
    replay.close()


def test_a_replay_needs_a_terminal_and_a_speed(rtarm: Rtarm, a_file: Path) -> None:
    result = rtarm("replay", str(a_file))
    assert (result.exit_code, "draws on a terminal, and this is not one: use `rtarm explain`" in result.stderr) == (
        1,
        True,
    )
    for speed in ("0", "-1", "nan"):
        result = rtarm("replay", str(a_file), "--speed", speed)
        assert (result.exit_code, "give a factor above 0" in result.stderr) == (1, True)


# --- what is no recording -----------------------------------------------------------------------------------


def cut(path: Path, whole: bytes) -> None:
    path.write_bytes(whole[: len(whole) // 2])


def chunks(whole: bytes) -> list[slice]:
    """Where the chunks of a file lie."""
    summary = make_reader(io.BytesIO(whole)).get_summary()
    assert summary is not None
    return [slice(one.chunk_start_offset, one.chunk_start_offset + one.chunk_length) for one in summary.chunk_indexes]


def spoil_chunk(path: Path, whole: bytes, number: int) -> None:
    damaged = bytearray(whole)
    chunk = chunks(whole)[number]
    damaged[(chunk.start + chunk.stop) // 2] ^= 0xFF
    path.write_bytes(damaged)


def spoil(path: Path, whole: bytes) -> None:
    spoil_chunk(path, whole, len(chunks(whole)) // 2)


@pytest.mark.parametrize(("harm", "said"), [(cut, "cut off"), (spoil, "is spoilt")])
def test_a_damaged_file_is_told_as_far_as_it_can_be_read(
    rtarm: Rtarm, a_file: Path, tmp_path: Path, harm: Callable[[Path, bytes], None], said: str
) -> None:
    path = tmp_path / "damaged.mcap"
    harm(path, a_file.read_bytes())
    loaded = mcap_reader.read(path)
    assert said in loaded.damage
    whole = len(mcap_reader.read(a_file).recording.records)
    assert whole // 4 < len(loaded.recording.records) < whole
    result = rtarm("explain", str(path))
    assert (result.exit_code, "The file is damaged" in result.stdout) == (0, True)


@pytest.mark.parametrize("number", [0, 1, -2])
def test_what_is_left_of_a_file_with_a_spoilt_chunk_stands_in_its_own_cycles(
    power_loss: Recording, a_file: Path, tmp_path: Path, number: int
) -> None:
    """A chunk's borders lie amid cycles, and the first one is where the channels are listed."""
    path = tmp_path / "spoilt.mcap"
    spoil_chunk(path, a_file.read_bytes(), number)
    loaded = mcap_reader.read(path)
    assert "1 of its parts is spoilt" in loaded.damage
    found, whole = loaded.recording.records, power_loss.records
    assert len(whole) // 4 < len(found) < len(whole)
    at = np.searchsorted(whole["number"], found["number"])
    for name in set(whole.dtype.names) - {"crc", "decisions_crc"}:
        assert found[name].tobytes() == whole[name][at].tobytes(), name
    lines = [line.sentence for line in told(loaded.recording).lines]
    within = bool(np.any(np.diff(at) > 1))  # cycles are missing between others, not before the first or after the last
    assert any("missing in the recording" in line for line in lines) == within
    assert within == {0: False, 1: True}.get(number, at[-1] == len(whole) - 1)
    assert not any("missed" in line for line in lines)


def test_cycles_of_which_a_part_is_missing_are_counted(power_loss: Recording, tmp_path: Path) -> None:
    """As chunk borders may do it: the last joint of one cycle and the first of another."""
    path, torn = tmp_path / "whole.mcap", tmp_path / "torn.mcap"
    mcap_writer.write(Recording(**{**vars(power_loss), "records": power_loss.records[:9]}), NOW, path)
    with path.open("rb") as file, torn.open("wb") as other:
        reader = make_reader(file)
        writer = Writer(other)
        writer.start(library=mcap_format.LIBRARY)
        for one in reader.iter_metadata():
            writer.add_metadata(one.name, one.metadata)
        numbers: dict[str, int] = {}
        for _, channel, message in reader.iter_messages():
            numbers.setdefault(channel.topic, writer.register_channel(channel.topic, "json", 0))
            content = json.loads(message.data)
            left_out = (channel.topic, content.get("number")) in (
                ("/rtarm/joints/joint6", power_loss.records["number"][3]),
                ("/rtarm/joints/joint1", power_loss.records["number"][5]),
            )
            if not left_out:
                writer.add_message(numbers[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    loaded = mcap_reader.read(torn)
    assert loaded.damage == "2 cycles are incomplete and left out"
    assert loaded.recording.records["number"].tolist() == np.delete(power_loss.records["number"][:9], [3, 5]).tolist()
    sentences = [line.sentence for line in told(loaded.recording).lines]
    assert sentences.count("1 control cycle is missing in the recording after this.") == 2


def test_a_file_damaged_anywhere_is_told_or_refused(a_file: Path, tmp_path: Path) -> None:
    whole = a_file.read_bytes()
    chance = random.Random(7)
    path = tmp_path / "damaged.mcap"
    for _ in range(20):
        damaged = bytearray(whole)
        for _ in range(chance.choice((1, 1, 30))):
            damaged[chance.randrange(min(len(whole), chance.choice((300, 3000, len(whole)))))] = chance.randrange(256)
        path.write_bytes(damaged[: chance.choice((len(whole), chance.randrange(len(whole))))])
        try:
            loaded = mcap_reader.read(path)
        except Refusal as refusal:
            assert "damaged.mcap" in refusal.sentence
        else:
            told(loaded.recording, loaded.reason)


def foreign(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        channel = writer.register_channel("/rtarm/state", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()


def newer(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("rtarm", {"format": "99"})
        writer.add_metadata("rtarm.limits", {})
        writer.finish()


def pretended(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("rtarm", {"format": "1", "joints": "[]"})
        writer.add_metadata("rtarm.limits", {})
        writer.finish()


def private(path: Path) -> None:
    path.symlink_to("/proc/1/mem" if os.geteuid() else path.name)  # a link to itself cannot be opened even by root


@pytest.mark.parametrize(
    ("make_it", "said"),
    [
        (lambda path: None, "is not there"),
        (lambda path: path.mkdir(), "is a folder: give one of the .mcap files in it"),
        (lambda path: path.write_text("no"), "is no MCAP file"),
        (lambda path: path.write_bytes(b""), "is no MCAP file"),
        (lambda path: path.write_bytes(mcap_format.MAGIC), "is damaged so early"),
        (os.mkfifo, "is no file that holds a recording"),
        (foreign, "is an MCAP file, but no recording of rtarm's"),
        (bag, "is an MCAP file, but no recording of rtarm's"),
        (newer, "has format 99, this rtarm reads format 1"),
        (pretended, "but its content is not"),
        (private, "cannot be read"),
    ],
    ids=[
        "absent",
        "folder",
        "text",
        "empty",
        "only the magic",
        "pipe",
        "foreign",
        "bag",
        "newer",
        "pretended",
        "unreadable",
    ],
)
@pytest.mark.parametrize("command", ["explain", "replay"])
def test_what_is_no_recording_is_refused_with_a_sentence(
    rtarm: Rtarm, tmp_path: Path, command: str, make_it: Callable[[Path], None], said: str
) -> None:
    path = tmp_path / "file.mcap"
    make_it(path)
    result = rtarm(command, str(path))
    assert (result.exit_code, result.stdout) == (1, "")
    assert said in result.stderr and len(result.stderr.splitlines()) == 1, result.stderr


def test_a_bag_of_ros_is_refused_at_its_first_chunk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked: list[object] = []

    def unpack(chunk: object, validate_crc: bool) -> list[object]:
        unpacked.append(chunk)
        return []

    path = tmp_path / "bag.mcap"
    bag(path)
    monkeypatch.setattr("mcap.stream_reader.breakup_chunk", unpack)
    with pytest.raises(Refusal, match="no recording of rtarm's"):
        mcap_reader.read(path)
    assert unpacked == []


def test_what_others_have_added_to_a_recording_is_let_be(power_loss: Recording, tmp_path: Path) -> None:
    path, merged = tmp_path / "whole.mcap", tmp_path / "merged.mcap"
    mcap_writer.write(Recording(**{**vars(power_loss), "records": power_loss.records[:9]}), NOW, path)
    with path.open("rb") as file, merged.open("wb") as other:
        reader = make_reader(file)
        writer = Writer(other)
        writer.start()
        for one in reader.iter_metadata():
            writer.add_metadata(one.name, one.metadata)
        cdr = writer.register_channel("/rtarm/state", "cdr", 0)
        numbers: dict[str, int] = {}
        for _, channel, message in reader.iter_messages():
            numbers.setdefault(channel.topic, writer.register_channel(channel.topic, "json", 0))
            writer.add_message(numbers[channel.topic], message.log_time, message.data, message.publish_time)
            writer.add_message(cdr, message.log_time, b"\0\1\0\0", message.publish_time)
        writer.finish()
    loaded = mcap_reader.read(merged)
    assert (loaded.damage, len(loaded.recording.records)) == ("", 9)


def test_names_in_a_recording_do_not_speak_to_the_terminal(rtarm: Rtarm, power_loss: Recording, tmp_path: Path) -> None:
    names = ("joint1", "\x1b]0;mine\x07\x1b[31mjoint2", *power_loss.joints[2:])
    path = tmp_path / "hostile.mcap"
    mcap_writer.write(Recording(**{**vars(power_loss), "arm": "arm\x1b[2J", "joints": names}), NOW, path)
    result = rtarm("explain", str(path))
    assert result.exit_code == 0
    assert "\x1b" not in result.stdout and "\x07" not in result.stdout
    assert r"\x1b[31mjoint2 has given no believable answer" in result.stdout
    assert r"arm\x1b[2J, " in result.stdout


def test_without_recordings_explain_says_how_to_make_one(rtarm: Rtarm, state_home: Path) -> None:
    result = rtarm("explain")
    assert result.exit_code == 1
    assert f"There is no recording in {state_home}" in result.stderr


def test_the_newest_recording_of_an_arm_is_taken_by_its_name_and_told_with_its_age(
    rtarm: Rtarm, power_loss: Recording, state_home: Path
) -> None:
    left, right = (state_home / f"{arm}-20260101T000000Z-wire.mcap" for arm in ("left", "right"))
    for age_s, path in ((200.0, left), (100.0, right)):
        mcap_writer.write(power_loss, NOW, path)
        os.utime(path, (time.time() - age_s, time.time() - age_s))
    assert rtarm("explain").stderr.startswith(f"{right}, written 1 min 4")
    result = rtarm("explain", "left", "--json")
    assert json.loads(result.stdout)["file"] == str(left)
    assert f"{left}, written 3 min 2" in result.stderr and "being written" not in result.stderr
    (state_home / f"{mcap_writer.ASIDE_PREFIX}1{mcap_writer.ASIDE_SUFFIX}").touch()
    assert "Another recording is being written just now" in rtarm("explain", "left").stderr
    os.utime(state_home / f"{mcap_writer.ASIDE_PREFIX}1{mcap_writer.ASIDE_SUFFIX}", (0.0, 0.0))
    assert "being written" not in rtarm("explain", "left").stderr, "its writer was killed long ago"
    assert rtarm("explain", str(left)).stderr == ""
    missing = rtarm("explain", "middle")
    assert missing.exit_code == 1 and "There is no recording of an arm 'middle' in" in missing.stderr


# --- on demand ----------------------------------------------------------------------------------------------


@pytest.fixture
def dead(arm_name: str) -> Iterator[Path]:
    """What a control process that was killed after some cycles has left behind."""
    arm = VirtualArm("mock")
    assert arm.bring_up().failure is None
    arm.cycles(50)
    header = arm.state.record["header"]
    header["magic"], header["layout_hash"] = layout.MAGIC, layout.layout_hash()
    header["arm_name"] = files.name_bytes((arm_name,), 1)
    path = files.state_path(arm_name)
    path.touch(0o600)
    path.write_bytes(arm.state.map[:])
    arm.close()
    yield path
    for left in files.DIRECTORY.glob(f"rtarm.{arm_name}.*"):
        left.unlink()


@pytest.mark.parametrize("previous", [False, True], ids=["dead", "and followed by another that ended in order"])
def test_what_a_dead_control_process_left_is_recorded(
    rtarm: Rtarm, dead: Path, arm_name: str, state_home: Path, previous: bool
) -> None:
    if previous:
        dead.rename(files.previous_path(arm_name))
    result = rtarm("record", arm_name)
    assert (result.exit_code, result.stderr) == (0, "")
    (path,) = folder.recordings(arm_name)
    assert path == Path(result.stdout.strip()) and path.parent == state_home
    loaded = mcap_reader.read(path)
    assert len(loaded.recording.records) >= 50
    assert loaded.reason.word == make.DEATH
    told = rtarm("explain")
    assert (told.exit_code, "ended without an orderly end" in " ".join(told.stdout.split())) == (0, True)


def test_a_running_arm_is_recorded_where_one_says(rtarm: Rtarm, arm: WrittenArm, tmp_path: Path) -> None:
    result = rtarm("record", arm.name)
    assert (result.exit_code, "has not run a cycle, so there is nothing to record" in result.stderr) == (1, True)
    result = rtarm("record", arm.name, "-o", str(tmp_path))
    assert (result.exit_code, "is a folder: name a file in it" in result.stderr) == (1, True)


def test_an_arm_that_left_nothing_is_said_so(rtarm: Rtarm, arm_name: str) -> None:
    result = rtarm("record", arm_name)
    assert result.exit_code == 1
    assert f"No control process is running for arm '{arm_name}'" in result.stderr


# --- after a fault ------------------------------------------------------------------------------------------


async def latched(arm: WrittenArm, said: list[str]) -> None:
    """Watch an arm until something is said of the fault that it latches."""
    recorder = FaultRecorder(arm.name, said.append)
    watch = asyncio.create_task(recorder.watch())
    await asyncio.sleep(0)  # it has looked at an arm without a fault
    arm.snapshot["fault"], arm.snapshot["fault_ns"] = Fault.WIRE, 5
    arm.publish()
    try:
        while not said:
            assert not watch.done()
            await asyncio.sleep(0.001)
    finally:
        assert not watch.done()
        watch.cancel()
        await recorder.close(died=False)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(after_fault, "POLL_S", 0.001)
    monkeypatch.setattr(after_fault, "AFTERMATH_S", 0.0)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("lacks", "said"),
    [
        (None, "has not run a cycle, so there is nothing to record."),
        (OSError(11, "Resource temporarily unavailable"), "no process could be started for it (Resource temporarily"),
        (MemoryError(), "no process could be started for it (MemoryError)"),
        (RuntimeError("can't start new thread"), "no process could be started for it (can't start new thread)"),
    ],
    ids=["cycles", "processes", "memory", "threads"],
)
def test_a_fault_that_cannot_be_recorded_costs_one_sentence(
    arm: WrittenArm, monkeypatch: pytest.MonkeyPatch, lacks: Exception | None, said: str
) -> None:
    def no_process(*_: object, **__: object) -> None:
        assert lacks is not None
        raise lacks

    if lacks is not None:
        monkeypatch.setattr(subprocess, "Popen", no_process)
    sentences: list[str] = []
    asyncio.run(latched(arm, sentences))
    (sentence,) = sentences
    assert sentence.startswith("not recorded: ") and said in sentence


@pytest.mark.usefixtures("quick")
def test_a_recorder_that_fails_altogether_neither_ends_nor_raises(
    arm: WrittenArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: FaultRecorder) -> int:
        raise MemoryError

    async def watched() -> None:
        recorder = FaultRecorder(arm.name, said.append)
        watch = asyncio.create_task(recorder.watch())
        while not said:
            await asyncio.sleep(0.001)
        assert not watch.done()
        watch.cancel()
        await recorder.close(died=False)
        await recorder.close(died=True)

    said: list[str] = []
    monkeypatch.setattr(FaultRecorder, "_unrecorded_ns", broken)
    asyncio.run(watched())
    assert said == ["faults will not be recorded (MemoryError)", "not recorded (MemoryError)"]


def test_a_recorder_that_ends_does_not_end_the_launcher(
    arm_name: str, mock_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def failing(self: FaultRecorder) -> None:
        raise MemoryError

    async def for_good(*_: object) -> None:
        await asyncio.Event().wait()

    async def watched() -> None:
        plan = Plan(load_arm(str(mock_file)), str(mock_file), {}, simulated=False)
        started = launcher.Launcher(plan, Reporter(Console(file=io.StringIO())))
        started._loop = object()  # type: ignore[assignment]
        watch = asyncio.create_task(started.watch())
        for _ in range(10):
            await asyncio.sleep(0)
        assert not watch.done()
        watch.cancel()

    monkeypatch.setattr(FaultRecorder, "watch", failing)
    monkeypatch.setattr(launcher.Launcher, "_watch_loop", for_good)
    monkeypatch.setattr(launcher.Launcher, "_keep_front", for_good)
    asyncio.run(watched())


@pytest.mark.usefixtures("quick")
def test_the_end_waits_a_moment_for_a_recording_that_is_then_finished_alone(
    arm: WrittenArm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a disk that does not answer: here the process waits for somebody to read its pipe."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    children: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def slow(_: object, **how: Any) -> subprocess.Popen[bytes]:
        children.append(popen(["sh", "-c", f"echo done > {pipe}"], **how))
        return children[-1]

    async def ended() -> None:
        recorder = FaultRecorder(arm.name, said.append)
        watch = asyncio.create_task(recorder.watch())
        await asyncio.sleep(0)
        watch.cancel()
        await recorder.close(died=True)

    said: list[str] = []
    monkeypatch.setattr(subprocess, "Popen", slow)
    monkeypatch.setattr(after_fault, "END_PATIENCE_S", 0.1)
    try:
        asyncio.run(ended())
        assert said[0] == "writing the recording …"
        assert said[1].startswith("the recording is not written after 0.1 s and goes on being written without rtarm")
        (child,) = children
        assert child.poll() is None
        assert pipe.read_text() == "done\n"
        assert child.wait(60.0) == 0
    finally:
        for child in children:
            child.kill()
            child.wait()


def test_the_process_that_writes_has_a_time_after_which_it_ends(
    arm: WrittenArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    left: list[int] = []
    monkeypatch.setattr(os, "nice", lambda _: 0)
    monkeypatch.setattr(writer_process, "record", lambda *_: left.append(signal.alarm(0)))
    fd = os.dup(arm.files.state.fd)
    assert writer_process.main(str(fd), arm.name, "fault") == 0
    os.close(fd)
    assert 59 < left[0] < 100
