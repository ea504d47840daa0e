"""The page of the words in shared memory, from the table that both processes are built from."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum, IntFlag
from inspect import getdoc, getmembers, getsource, isclass

import numpy as np

from handbook.markdown import code, page, table
from shm import layout, words
from shm.record import Record, offset_of

FILES = {
    "state": (layout.StateFile, "the control process"),
    "command": (layout.CommandFile, "the ROS process; requests also whoever holds the producers' lock"),
}
TYPES = {"i8": "int64", "f8": "float64", "u1": "uint8"}
INTRODUCTION = f"""\
An arm has two files: `/dev/shm/rtarm.<arm>.state`, which the control process alone writes, and
`/dev/shm/rtarm.<arm>.command`, which the ROS process writes (and, for requests, any command that holds the producers'
lock). Every field is a multiple of 8 bytes, little-endian, 8-byte aligned. A hash of these tables stands in both
headers, so that processes built from different ones refuse each other. There is room for {layout.MAX_JOINTS} joints;
records with joints end with the last one in use. [Memory order](../explanation/memory-order.md) says why no reader is
misled, [architecture](../explanation/architecture.md) what the files are for."""


def build() -> str:
    """The page."""
    parts = [INTRODUCTION]
    for record in layout.TABLES:
        parts += [f"## {title(record)}", written_by(record), table(HEADS, rows(record))]
    parts.append("## Numbers by name")
    for kind in enumerations():
        parts += [
            f"### {kind.__name__}",
            (getdoc(kind) or "").split("\n")[0],
            table(("number", "name", ""), members(kind)),
        ]
    return page("Memory words", *parts)


HEADS = ("word", "type", "offset", "unit", "meaning")


def title(record: type[Record]) -> str:
    """A table's name."""
    return (getdoc(record) or "").split("\n")[0].removesuffix(".")


def rows(record: type[Record]) -> Iterator[tuple[str, ...]]:
    """A row a word; padding has no meaning and is left out."""
    for name, word in record.words.items():
        if name not in {"padding", "reserved"}:
            yield code(name), type_of(record.dtype[name]), str(offset_of(record, name)), *word


def type_of(kind: np.dtype) -> str:
    """A field's type as people read it: int64, or a record and how many of it."""
    many = "".join(f" × {count}" for count in kind.shape)
    if kind.base.names is None:
        return TYPES[kind.base.str[1:]] + many
    name = next(title(record) for record in layout.TABLES if record.dtype == kind.base)
    return name[0].lower() + name[1:] + many


def written_by(record: type[Record]) -> str:
    """Who writes a record, by the file that holds it."""
    writers = [who for file, who in FILES.values() if record is file or holds(file.dtype, record.dtype)]
    if record in (layout.CycleRecord, layout.BusFrame):
        writers = [FILES["state"][1]]
    if record is layout.Begin:
        writers = [FILES["command"][1]]
    return f"Written by {', or '.join(writers)}; {record.dtype.itemsize} bytes."


def holds(outer: np.dtype, record: np.dtype) -> bool:
    """Whether a record is somewhere inside another."""
    kinds = [kind[0].base for kind in (outer.fields or {}).values()]
    return any(kind == record or holds(kind, record) for kind in kinds)


def enumerations() -> list[type[IntEnum] | type[IntFlag]]:
    """The enumerations of the words, in the order of their file."""
    kinds = [
        k for _, k in getmembers(words, isclass) if issubclass(k, IntEnum | IntFlag) and k.__module__ == words.__name__
    ]
    source = getsource(words)
    return sorted(kinds, key=lambda kind: source.index(f"class {kind.__name__}("))


def members(kind: type[IntEnum] | type[IntFlag]) -> Iterator[tuple[str, str, str]]:
    """Number, name and comment of each member."""
    said = dict(line.split("#", 1) for line in getsource(kind).splitlines() if "#" in line and " = " in line)
    comments = {line.split("=")[0].strip(): comment.strip() for line, comment in said.items()}
    for name, member in kind.__members__.items():
        yield str(member.value), code(name), comments.get(name, "")
