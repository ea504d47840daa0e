"""Files of every version that was kept go on working: the code makes of them what it made of them then."""

from __future__ import annotations

import io
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from keep import KEPT, OWN_ARMS, facts
from rich.console import Console

from config.loader import ARMS_FOLDER
from handbook.stability import listed
from rtarm.recording import mcap_reader
from rtarm.recording.playback import Playback
from rtarm.recording.plot import plot
from rtarm.top.picture import Picture

VERSIONS = sorted(path for path in KEPT.glob("v*") if path.is_dir())
RECORDINGS = [path for version in VERSIONS for path in sorted((version / "recordings").glob("*.mcap"))]
LARGEST_BYTES, LARGEST_VERSION_BYTES = 100_000, 400_000


def test_the_first_version_is_found_with_its_recordings() -> None:
    """Where nothing is found, nothing is tried."""
    first = KEPT / "v0.1.0"
    assert first in VERSIONS
    assert {path.name for path in RECORDINGS if path.parent.parent == first} == {"goal.mcap", "fault.mcap"}


def name_of(path: Path) -> str:
    return path.relative_to(KEPT).as_posix()


def differences(kept: Any, now: Any, place: str = "") -> list[str]:
    """Where what the code makes of something now is not what it made of it then; what is new beside it is no matter."""
    if isinstance(kept, dict) and isinstance(now, dict):
        return [
            line
            for key, value in kept.items()
            for line in (differences(value, now[key], f"{place}/{key}") if key in now else [f"{place}/{key}: gone"])
        ]
    if isinstance(kept, list) and isinstance(now, list) and len(kept) == len(now):
        pairs = enumerate(zip(kept, now, strict=True))
        return [line for number, pair in pairs for line in differences(*pair, f"{place}/{number}")]
    same = now == (pytest.approx(kept, rel=1e-9, abs=1e-12) if isinstance(kept, float) else kept)
    return [] if same else [f"{place}: {kept!r}, now {now!r}"]


@pytest.mark.parametrize("version", VERSIONS, ids=name_of)
def test_the_files_of_a_version_mean_what_they_meant(version: Path) -> None:
    kept = json.loads((version / "facts.json").read_text(encoding="utf-8"))
    found = differences(kept, json.loads(json.dumps(facts(version))))
    assert not found, f"of the files in {name_of(version)}:\n" + "\n".join(found)


@pytest.mark.parametrize("path", RECORDINGS, ids=name_of)
def test_a_recording_is_drawn(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert plot(path, tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("path", RECORDINGS, ids=name_of)
def test_a_recording_is_played_to_its_end(path: Path) -> None:
    recording = mcap_reader.read(path).recording
    span_ns = int(recording.records["monotonic_ns"][-1] - recording.records["monotonic_ns"][0])
    moments_ns = [0, *(round(share * span_ns) for share in (0.0, 0.3, 0.6, 1.0))]
    clock_ns = itertools.chain(moments_ns, itertools.repeat(span_ns))
    replay = Playback(recording, 1.0, lambda: next(clock_ns))
    for _ in range(4):
        drawn = io.StringIO()
        Console(width=120, file=drawn).print(Picture(replay.look()))
        assert all(name in drawn.getvalue() for name in (recording.arm, *recording.joints))
    assert replay.reached() == len(recording.records)
    assert "The recording ends here" in drawn.getvalue()


@pytest.mark.parametrize("version", VERSIONS, ids=name_of)
def test_what_is_kept_is_small(version: Path) -> None:
    sizes = {path: path.stat().st_size for path in version.rglob("*") if path.is_file()}
    assert max(sizes.values()) <= LARGEST_BYTES and sum(sizes.values()) <= LARGEST_VERSION_BYTES


def keys_in(value: Any, place: str = "") -> Iterator[str]:
    """The places of the keys in an arm file, as the list of stable names has them."""
    if isinstance(value, list):
        for inner in value:
            yield from keys_in(inner, f"{place}[]")
    elif isinstance(value, dict):
        if place == "joints[].drive":
            place = f"{place}({value['family']})"
        for key, inner in value.items():
            here = f"{place}.{key}".lstrip(".")
            yield here
            yield from keys_in(inner, here)


def test_the_next_version_keeps_a_file_with_every_key() -> None:
    files = [*ARMS_FOLDER.glob("*.yaml"), *OWN_ARMS.glob("*.yaml")]
    there = {key for path in files for key in keys_in(yaml.safe_load(path.read_text(encoding="utf-8")))}
    there |= {key.replace("bus[].", "bus.") for key in there}  # one bus is written without its list
    missing = sorted(listed("configuration").keys() - there)
    assert not missing, f"no arm file that `make keep` keeps has {missing}: add it to one in tests/kept/arms"


def test_a_difference_is_found() -> None:
    kept = {"a": [1.0, "x"], "b": {"c": None}}
    assert differences(kept, {"a": [1.0 + 1e-13, "x"], "b": {"c": None, "new": 1}}) == []
    assert differences(kept, {"a": [1.1, "y"], "b": {}}) == ["/a/0: 1.0, now 1.1", "/a/1: 'x', now 'y'", "/b/c: gone"]
