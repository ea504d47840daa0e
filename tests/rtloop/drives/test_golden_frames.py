"""Golden frames of every family, in both directions: data, `tests/golden/FAMILY.yaml`, and one runner for them all.

A file has
- `sources`: where its frames come from, by the names that `from` uses;
- `joints`: a drive's section each, and what its joint has beside `codec_rig.JOINT`; a vector is of the first unless it
  says `joint`;
- `within`: how much a number may differ, where that is not its last bits;
- `vectors`, each of one kind, and `what` it is where that is not plain:
  - `does`: what the cycle asks of a family (lead, stop, ask_position, ask_status), in what state (`at`) and in which
    `turn` of the questions, with the `frames` that makes; how many `questions` for the position are open then, and how
    many where a conversation has said the same (`noted`); whether the last frame is a stop command (`is_stop`);
  - `packs`: one of the family's functions, its arguments (`of`, after a `row` with some settings) and the `bytes`;
  - `hears`: frames, one after the other (`each`: frames, each of them alone), and all that they tell (`tells`) or
    some of it (`has`): position, velocity, effort, temperature, voltage, status, error_code, refusals, drive_errors;
- `ignored`: frames of which none tells anything of the first joint;
- `settings`: what `rtarm drives` asks, see `test_settings_bytes.py`.
"""

import math
from typing import Any

import pytest
from codec_rig import Rig, data_of, families, frame_of, golden, meant, text_of, word

from rtloop.memory import status
from rtloop.memory.frame_words import EXTENDED, REMOTE
from shm.words import Unreferenced

KINDS = {"does": {"at", "turn", "frames", "questions", "noted", "is_stop"}, "packs": {"row", "of", "bytes"}}
KINDS |= {"hears": {"tells", "has"}, "each": {"tells", "has"}}
"""What a vector of a kind may have, beside `from`, `what` and `joint`."""
BAD = status.PROTECTED | status.POWER_LOST


def vectors(*kinds: str) -> list[Any]:
    """Those of all families that are of one of these kinds."""
    return [
        pytest.param(family, vector, id=f"{family} {vector.get('what') or vector.get('frames') or vector[kind]}")
        for family in families()
        for vector in spread(golden(family)["vectors"])
        for kind in kinds
        if kind in vector
    ]


def spread(vectors: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """With one vector for each frame of an `each`."""
    alone = [[{**vector, "hears": [frame]} for frame in vector.get("each", ())] or [vector] for vector in vectors]
    return [vector for some in alone for vector in some]


def rig_of(family: str, vector: dict[str, Any]) -> Rig:
    assert vector["from"] in golden(family)["sources"]
    return Rig.named(family, vector.get("joint"))


def put(rig: Rig, at: dict[str, Any]) -> None:
    """Bring the joint into the state of a vector."""
    at = {name.replace("_deg", "_rad"): math.radians(value) if "_deg" in name else value for name, value in at.items()}
    rig.stands(at.pop("position_rad", 0.0), at.pop("velocity_rad_s", 0.0))
    rig.axis["reference"]["unreferenced_reason"] = Unreferenced[at.pop("unreferenced", "REFERENCED")]
    rig.axis["drive"]["status"] = sum(getattr(status, word.upper()) for word in at.pop("status", ()))
    if "measured_rad" in at:
        rig.axis["measured"]["position_rad"], rig.axis["measured"]["readings"] = at.pop("measured_rad"), 1
    assert not at


@pytest.mark.parametrize("family", families())
def test_files_have_only_what_is_tried(family: str) -> None:
    assert set(golden(family)) <= {"sources", "joints", "within", "vectors", "ignored", "settings"}
    for vector in golden(family)["vectors"]:
        (kind,) = KINDS.keys() & vector
        assert set(vector) <= {kind, "from", "what", "joint"} | KINDS[kind], vector
        assert kind in ("does", "packs") or len({"tells", "has"} & set(vector)) == 1, vector


@pytest.mark.parametrize(("family", "vector"), vectors("does"))
def test_what_is_said(family: str, vector: dict[str, Any]) -> None:
    rig, does = rig_of(family, vector), vector["does"]
    put(rig, dict(vector.get("at", {})))
    rig.record["timing"]["cycle"] += vector.get("turn", 0)
    sent = rig.sends(does)
    assert sent == [text_of_vector(text) for text in vector["frames"]]
    assert rig.axis["reply"]["questions"] == vector.get("questions", int(does == "ask_position"))
    last = len(sent) - 1
    stops = [int(rig.record["buses"][0]["outgoing"]["stops"][number]) for number in range(len(sent))]
    assert stops == [0 if does == "stop" and number == last else -1 for number in range(len(sent))]
    if does == "lead":
        assert [int(rig.record["buses"][0]["outgoing"]["joined"][number]) for number in range(len(sent))] == [
            1
        ] * last + [0]


@pytest.mark.parametrize(("family", "vector"), vectors("does"))
def test_what_a_conversation_says_is_noted(family: str, vector: dict[str, Any]) -> None:
    rig, does = rig_of(family, vector), vector["does"]
    frames = [frame_of(text)[0] for text in vector["frames"]]
    for frame in frames:
        rig.codec.note_what_was_said(rig.record, 0, frame.id, word(frame.data))
    assert rig.axis["reply"]["questions"] == vector.get("noted", vector.get("questions", int(does == "ask_position")))
    stops = [bool(rig.codec.is_stop(rig.record, 0, frame.id, word(frame.data))) for frame in frames]
    assert stops == [vector.get("is_stop", False) and frame == frames[-1] for frame in frames]


def text_of_vector(text: str) -> str:
    frame, length = frame_of(text)
    return text_of(frame.id, frame.kind, frame.data, length)


@pytest.mark.parametrize(("family", "vector"), vectors("packs"))
def test_numbers_are_packed(family: str, vector: dict[str, Any]) -> None:
    rig = rig_of(family, vector)
    for name, value in vector.get("row", {}).items():
        rig.row[name] = value
    first = (rig.row,) if "row" in vector else ()
    found = getattr(rig.codec, vector["packs"])(*first, *vector["of"])
    packed = [data_of(value) for value in (found if isinstance(found, tuple) else (found,))]
    assert packed == [bytes.fromhex(text).ljust(8, b"\0") for text in vector["bytes"]]


@pytest.mark.parametrize(("family", "vector"), vectors("hears"))
def test_what_is_heard(family: str, vector: dict[str, Any]) -> None:
    rig = rig_of(family, vector)
    told = rig.hears(*vector["hears"])
    expected = meant(vector.get("tells", vector.get("has")), rig.config)
    bad_statuses = told.pop("bad_statuses", 0)
    if "status" in expected:
        found = told["status"]
        assert bool(bad_statuses) == bool(found & BAD or not found & status.ENABLED)
    else:
        assert not bad_statuses
    assert set(told) == set(expected) if "tells" in vector else set(told) > set(expected)
    for name, value in expected.items():
        within = golden(family).get("within", {}).get(name, 1e-12)
        assert told[name] == pytest.approx(value, rel=1e-12, abs=within), name


@pytest.mark.parametrize("family", families())
def test_what_only_resembles_an_answer_changes_nothing(family: str) -> None:
    for text in golden(family)["ignored"]:
        rig = Rig.named(family)
        before = rig.axis.tobytes()
        assert rig.hears(text) == {}, text
        assert rig.axis.tobytes() == before, text


@pytest.mark.parametrize(("family", "vector"), vectors("hears"))
def test_frames_of_another_length_or_kind_tell_nothing(family: str, vector: dict[str, Any]) -> None:
    """Cut anywhere, longer by a byte, with the other width of identifier, or as a question for that many bytes."""
    frame, length = frame_of(vector["hears"][0])
    others = [(frame.id, frame.data[:cut], frame.kind, cut) for cut in range(length)]
    if length < 8:
        others.append((frame.id, frame.data + b"\0", frame.kind, length + 1))
    for kind in (frame.kind ^ EXTENDED, frame.kind | REMOTE):
        others.append((frame.id, frame.data, kind, length))
    for frame_id, data, kind, size in others:
        rig = rig_of(family, vector)
        before = rig.axis.tobytes()
        rig.takes(frame_id, data, kind, size)
        assert rig.axis.tobytes() == before, (data.hex(), kind, size)


def test_frames_are_read_and_written_as_can_utils_does() -> None:
    for text in ("123#", "00000123# 01 02", "7FF#R8", "00000123#R0"):
        assert text_of_vector(text) == text
    assert word(b"\x01\x02") == 0x201
