"""Recordings of arms of several buses: each frame says its bus, and whose it is."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from recorded import loaded
from two_buses import NAMES, divided
from virtual import VirtualArm, recording_of

from rtarm.recording import mcap_format, mcap_reader, mcap_writer
from rtarm.recording.mcap_format import Reason
from rtarm.recording.mcap_reader import _frames_of, _identifiers_of
from rtarm.recording.playback import Playback
from rtarm.recording.story import tell
from rtloop.offline.commissioning.finding import frames_of
from rtloop.wire import received
from shm import layout
from shm.recording import BUS_MASK, BUS_SHIFT, EXTENDED, LENGTH_SHIFT, REMOTE, SENT, Recording

NOW = Reason("asked", "Asked for by a person.")


@pytest.fixture(scope="module", params=["episode1", "odrive6", "mks6"])
def recording(request: pytest.FixtureRequest) -> Recording:
    """An arm whose second wire is gone in the end."""
    arm = VirtualArm.brought_up(divided(request.param))
    arm.cycles(60)
    received.close(arm.loop[0]["buses"][1], 5)
    arm.cycles(60)
    return recording_of(arm)


@pytest.fixture(scope="module")
def path(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("buses") / "recorded.mcap"
    mcap_writer.write(recording, NOW, path)
    return path


def messages(path: Path, topic: str) -> list[dict[str, Any]]:
    with path.open("rb") as file:
        return [json.loads(message.data) for _, _, message in make_reader(file).iter_messages([topic])]


def test_a_frame_is_of_the_joint_on_its_bus(recording: Recording, path: Path) -> None:
    """On both buses the same identifiers are used, for other joints."""
    on = {NAMES[0]: set(recording.joints[:3]), NAMES[1]: set(recording.joints[3:])}
    frames = messages(path, mcap_format.FRAMES)
    for name, joints in on.items():
        assert {frame["joint"] for frame in frames if frame["bus"] == name} - {None} == joints
    identifiers = [{frame["id"] for frame in frames if frame["bus"] == name and frame["joint"]} for name in NAMES]
    assert identifiers[0] & identifiers[1]


def test_what_is_read_back_is_what_was_written(recording: Recording, path: Path) -> None:
    found = mcap_reader.read(path).recording
    assert (found.buses, found.bus_names) == (recording.buses, NAMES)
    order = np.argsort(recording.frames["monotonic_ns"], kind="stable")
    for word in ("monotonic_ns", "head", "data"):
        assert found.frames[word].tolist() == recording.frames[word][order].tolist(), word
    assert found.identifiers.tolist() == recording.identifiers.tolist()
    assert set((found.frames["head"] >> BUS_SHIFT & BUS_MASK).tolist()) == {0, 1}
    assert {frame.bus for frame in frames_of(found.frames[:200])} == {0, 1}


def test_a_story_names_the_bus(recording: Recording) -> None:
    story = tell(recording, NOW)
    assert any(sentence.startswith(f"Bus {NAMES[1]}: The CAN adapter is gone") for sentence in story.verdict)
    assert any(line.sentence.startswith(f"Bus {NAMES[1]}: ") for line in story.lines)


def test_played_back_the_load_is_that_of_all_buses_together(recording: Recording) -> None:
    look = Playback(recording, 1000.0).look()
    assert look.recent is not None and "buses" not in look.recent
    assert look.report is not None and 0.0 <= look.report["bus"]["load"] < 1.0


def test_an_arm_of_one_bus_writes_what_it_always_wrote(tmp_path: Path) -> None:
    arm = VirtualArm.brought_up("episode1")
    arm.cycles(5)
    path = tmp_path / "one.mcap"
    mcap_writer.write(recording_of(arm), NOW, path)
    assert all("bus" not in frame for frame in messages(path, mcap_format.FRAMES))
    with path.open("rb") as file:
        about = next(one.metadata for one in make_reader(file).iter_metadata() if one.name == mcap_format.METADATA)
    assert "buses" not in about and about["bitrate"] == "500000"
    assert all(len(row) == 4 for row in json.loads(about["identifiers"]))


def test_identifiers_of_before_are_on_the_first_bus() -> None:
    found = _identifiers_of([[0x100, 0xFF00, 1, 2]], 6, 1)
    assert found[0].tolist() == (0x100, 0xFF00, 1, 2, 0)
    with pytest.raises(ValueError, match="on no bus"):
        _identifiers_of([[0x100, 0xFF00, 1, 2, 1]], 6, 1)


EMPTY = loaded().recording
HEADS = st.builds(
    lambda identifier, length, marks, bus: identifier | length << LENGTH_SHIFT | sum(marks) | bus << BUS_SHIFT,
    st.integers(0, 0x1FFFFFFF),
    st.integers(0, 8),
    st.sets(st.sampled_from([EXTENDED, SENT, REMOTE])),
    st.integers(0, layout.MAX_BUSES - 1),
)


@given(heads=st.lists(HEADS, min_size=1, max_size=20))
def test_any_frame_of_any_bus_survives_the_file(heads: list[int]) -> None:
    frames = np.zeros(len(heads), layout.BusFrame.dtype)
    frames["monotonic_ns"], frames["head"] = np.arange(len(heads)) + 1, heads
    buses = [f"bus{number}" for number in range(layout.MAX_BUSES)]
    recording = replace(EMPTY, frames=frames, buses=tuple(EMPTY.buses[0]._replace(name=name) for name in buses))
    rows = [content for _, _, _, content in mcap_writer._frames(recording)]
    assert _frames_of(buses, json.loads(json.dumps(rows)))["head"].tolist() == heads
