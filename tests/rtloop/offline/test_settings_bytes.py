"""Bytes of the questions of `rtarm drives`, against those of the makers: `settings` in `tests/golden/FAMILY.yaml`.

A vector has the `row` of the family's table (or `store`, its hook), what is asked (null: nothing, it listens) and heard
in turn (`talk`), and what that tells; with `writes` it is the row's write of that value.
"""

from __future__ import annotations

import json
from importlib import import_module
from typing import Any

import pytest
from codec_rig import JOINT, arm_of, families, frame_of, golden, text_of
from hypothesis import given, settings
from hypothesis import strategies as st

from rtloop.offline.settings.compare import Verdict, as_json, compared
from rtloop.offline.settings.table import Reading, Row, Table, Whose, told
from rtloop.service.conversation import Part
from rtloop.service.port import Frame

ASKED = [family for family in families() if "settings" in golden(family)]
TABLES = [family for family in families() if family != "zdt"]
"""A ZDT drive's settings are a block, and have tests of their own."""


def table_of(family: str) -> Table:
    found: Table = import_module(f"rtloop.offline.settings.{family}").TABLE
    return found


def row_of(family: str, name: str) -> Row:
    return next(row for row in table_of(family).rows if row.name == name)


def whose_of(family: str, joint: str | None = None) -> Whose:
    joints = golden(family)["joints"]
    values = dict(joints[joint] if joint else next(iter(joints.values())))
    return Whose(arm_of(values.pop("drive"), **{**JOINT, **values}), 0)


def vectors() -> list[Any]:
    return [
        pytest.param(family, vector, id=f"{family} {vector['row']} {vector.get('what', vector['talk'][0][0])}")
        for family in ASKED
        for vector in golden(family)["settings"]
    ]


def part_of(family: str, vector: dict[str, Any]) -> Part[Any]:
    whose, table = whose_of(family, vector.get("joint")), table_of(family)
    if vector["row"] == "store":
        assert table.store is not None
        return table.store(whose)
    row = row_of(family, vector["row"])
    if "writes" in vector:
        assert row.write is not None
        return row.write(whose, vector["writes"])
    assert row.read is not None
    return told(row.read(whose))


@pytest.mark.parametrize(("family", "vector"), vectors())
def test_a_setting_is_asked_and_told(family: str, vector: dict[str, Any]) -> None:
    assert set(vector) <= {"from", "what", "row", "joint", "talk", "tells", "writes"}
    assert vector["from"] in golden(family)["sources"] and ("writes" in vector) != ("tells" in vector)
    part, ended = part_of(family, vector), None
    question = next(part)
    for sent, heard in vector["talk"]:
        assert ended is None, f"it says {sent} no more"
        packets = [frame for frame, _ in question.packets(first=True)]
        assert [text_of(f.id, f.kind, f.data, len(f.data)) for f in packets] == (
            [] if sent is None else [sent_text(sent)]
        )
        answers = [question.receive(frame_of(text)[0], True) for text in heard]
        try:
            question = part.send(next((answer for answer in answers if answer is not None), None))
        except StopIteration as end:
            ended = end
    while ended is None:
        assert not question.packets(first=True), "it asks for more"  # it may wait, though
        try:
            question = part.send(None)
        except StopIteration as end:
            ended = end
    if "tells" in vector:
        assert ended.value == vector["tells"]


def sent_text(text: str) -> str:
    frame, length = frame_of(text)
    return text_of(frame.id, frame.kind, frame.data, length)


@pytest.mark.parametrize("family", TABLES)
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_any_answers_at_all_end_in_a_report(family: str, data: st.DataObject) -> None:
    """Bytes of the right identifiers but of any content and length; nothing raises, and what is shown can be shown."""
    whose, table, found = whose_of(family), table_of(family), Reading()
    identifiers = [frame_of(text)[0] for text in heard_of(family)]
    part, answer = table.read(whose.arm, 0, found), None
    for _ in range(1_000):
        try:
            question = part.send(answer)
        except StopIteration:
            break
        sent = [frame for frame, _ in question.packets(first=True)]
        head = data.draw(st.sampled_from([b"", *(frame.data[:4] for frame in sent)]))
        frame = data.draw(st.sampled_from(identifiers))
        heard = Frame(frame.id, (head + data.draw(st.binary(max_size=8)))[:8], kind=frame.kind)
        found.note_question(question)
        found.note_frame(heard)
        answer = question.receive(heard, True)
    else:
        pytest.fail("it asks on and on")
    report = table.report_of(whose.arm, 0, found)
    assert report.answers == (found.state is not None)
    assert json.loads(json.dumps(as_json(report), allow_nan=False))["joint"] == "joint1"


def heard_of(family: str) -> list[str]:
    """Frames that a drive of the family sends."""
    talked = [text for vector in golden(family).get("settings", ()) for _, heard in vector["talk"] for text in heard]
    return talked or [text for vector in golden(family)["vectors"] for text in vector.get("hears", ())]


@pytest.mark.parametrize("family", TABLES)
def test_rows_have_names_of_their_own_and_their_place(family: str) -> None:
    rows = table_of(family).rows
    assert len({row.name for row in rows}) == len(rows)
    assert all(row.where and (row.read is not None or row.write is None) for row in rows)


@given(st.floats(1e-3, 1e6), st.floats(-1e-5, 1e-5))
def test_a_rounded_fraction_is_the_same(value: float, off: float) -> None:
    assert compared("x", value, value * (1.0 + off)).verdict is Verdict.SAME
    assert compared("x", value, value * 1.001).verdict is Verdict.DIFFERS
