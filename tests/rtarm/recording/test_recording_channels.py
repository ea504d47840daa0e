"""What a recording says to programs of others: read with their readers, none of ours."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from virtual import VirtualArm, recorded_goal

from rtarm.recording import mcap_reader, mcap_writer
from rtarm.recording.mcap_format import Reason
from rtarm.recording.plot import plot
from rtarm.recording.statistics import Seconds
from shm.recording import Recording, read_recording
from sim.faults import PowerLoss

NOW = Reason("asked", "Asked for by a person.")
GOAL = "large"
EPOCH_NS = 1_700_000_000_000_000_000
LAYOUT = Path(__file__).resolve().parents[3] / "docs" / "foxglove" / "rtarm.json"
PICTURES = os.environ.get("RTARM_PICTURES")
"""A folder that gets the pictures of the documentation."""


@pytest.fixture(scope="module")
def paused() -> Recording:
    """A goal that a person pauses and lets go on, and that a drive's loss of power ends."""
    arm = VirtualArm("episode1", start_rad=recorded_goal(GOAL)["joints"][0, :, 0])
    arm.memory["timing"]["epoch_offset_ns"] = EPOCH_NS
    assert arm.bring_up().failure is None
    arm.play(GOAL)
    arm.cycles(60)
    arm.writer.hold()
    arm.cycles(60)
    arm.writer.resume()
    arm.cycles(90)
    arm.sim.inject(PowerLoss("joint2", at_s=0.0, off_s=60.0), since_ns=arm.now_ns)
    arm.end_of(1)
    arm.cycles(60)
    found = read_recording(arm.state, arm.command)
    arm.close()
    return found


@pytest.fixture(scope="module")
def a_file(paused: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "paused.mcap"
    mcap_writer.write(paused, NOW, path)
    return path


def messages(path: Path) -> Iterator[tuple[Any, str, int, dict[str, Any]]]:
    """Schema, topic, time and content of every message, as the MCAP library reads them."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None and (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
            yield schema, channel.topic, message.log_time, json.loads(message.data)


def test_every_message_keeps_its_schema_and_bears_its_time(a_file: Path) -> None:
    validators: dict[int, Draft202012Validator] = {}
    counted: dict[str, int] = defaultdict(int)
    for schema, topic, log_time, content in messages(a_file):
        if schema.id not in validators:
            described = json.loads(schema.data)
            Draft202012Validator.check_schema(described)
            strict = {**described, "required": list(described["properties"]), "additionalProperties": False}
            validators[schema.id] = Draft202012Validator(strict)
        validators[schema.id].validate(content)
        counted[topic] += 1
        assert EPOCH_NS <= log_time < EPOCH_NS + 3_600_000_000_000, topic
        assert log_time - content.get("monotonic_ns", log_time - EPOCH_NS) == EPOCH_NS or "joints/" in topic, topic
    assert {"/rtarm/commands", "/rtarm/statistics", "/rtarm/state", "/rtarm/events", "/rtarm/frames"} <= set(counted)


def test_commands_say_what_was_asked_and_what_became_of_it(a_file: Path) -> None:
    found = [content for _, topic, _, content in messages(a_file) if topic == "/rtarm/commands"]
    told = [(one["what"], one["number"], one["name"], one["answer"]) for one in found]
    asked = [
        ("goal", 1, "trajectory", None),
        ("request", None, "hold", None),
        ("request", None, "resume", None),
        ("result", 1, None, "fault"),
    ]
    assert told == asked
    (goal,) = (one for one in found if one["what"] == "goal")
    assert goal["joints"] == [f"joint{number}" for number in range(1, 7)]
    (result,) = (one for one in found if one["what"] == "result")
    assert result["sentence"].startswith("The control process latched a fault")


def test_statistics_sum_up_each_second(paused: Recording, a_file: Path) -> None:
    records = paused.records
    found = [content for _, topic, _, content in messages(a_file) if topic == "/rtarm/statistics"]
    assert sum(one["cycles"] for one in found) == len(records)
    seconds = records["monotonic_ns"] // 1_000_000_000
    assert len(found) == len(np.unique(seconds))
    second = found[1]
    inside = records[seconds == second["monotonic_ns"] // 1_000_000_000]
    before = records[records["number"] == inside["number"][0] - 1][0]
    span_s = (inside["monotonic_ns"][-1] - before["monotonic_ns"]) * 1e-9
    assert second["cycles_per_s"] == pytest.approx(1e9 / paused.period_ns, rel=1e-6)
    assert second["lateness_max_us"] == inside["lateness_ns"].max() * 1e-3
    bits = int(inside["bits_on_bus"][-1] - before["bits_on_bus"])
    assert second["bus_load"] == pytest.approx(bits / span_s / paused.buses[0].bitrate)
    assert 0.0 < second["bus_load"] < 1.0
    sent = int(inside["frames_sent"][-1] - before["frames_sent"])
    assert second["frames_sent_per_s"] == pytest.approx(sent / span_s)
    assert sum(one["stale_reads"] for one in found[1:]) > 0  # of the drive that was lost


@pytest.mark.parametrize("size", [1, 7, 119, 1000])
def test_statistics_are_the_same_however_the_cycles_come(paused: Recording, size: int) -> None:
    def told(size: int) -> list[Any]:
        seconds = Seconds(paused.buses[0].bitrate)
        records = paused.records
        pieces = [records[at : at + size] for at in range(0, len(records), size)]
        return [one for piece in pieces for one in seconds.add(piece)] + list(seconds.rest())

    assert told(size) == told(len(paused.records))


def test_statistics_of_a_gap_say_how_much_is_missing(paused: Recording) -> None:
    seconds = Seconds(paused.buses[0].bitrate)
    kept = np.delete(paused.records, slice(130, 140))
    found = [*seconds.add(kept), *seconds.rest()]
    assert sum(one.content["cycles_not_recorded"] for one in found) == 10


def paths_of(layout: Any) -> Iterator[str]:
    """Every message path and topic that a Foxglove layout names."""
    for name, value in layout.items() if isinstance(layout, dict) else enumerate(layout):
        if isinstance(value, (dict, list)):
            yield from paths_of(value)
        elif name in ("value", "topicPath", "topicToRender"):
            yield value


def test_every_path_of_the_foxglove_layout_is_in_a_recording(a_file: Path) -> None:
    known: dict[str, dict[str, Any]] = {topic: content for _, topic, _, content in messages(a_file)}
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    paths = list(paths_of(layout["configById"]))
    assert len(paths) > 20
    for path in paths:
        topic, _, word = path.partition(".")
        assert topic in known, path
        assert not word or word in known[topic], path

    def panels(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])


def test_what_we_read_back_is_the_same_with_the_new_channels(paused: Recording, a_file: Path) -> None:
    loaded = mcap_reader.read(a_file)
    assert loaded.damage == ""
    assert loaded.recording.records["number"].tolist() == paused.records["number"].tolist()
    assert loaded.recording.events.tobytes() == paused.events.tobytes()


@pytest.mark.skipif(PICTURES is None, reason="only with RTARM_PICTURES=docs/pictures")
def test_the_documentations_picture(a_file: Path) -> None:
    assert PICTURES is not None
    target = Path(PICTURES) / "plot.png"
    target.unlink(missing_ok=True)
    plot(a_file, target)
