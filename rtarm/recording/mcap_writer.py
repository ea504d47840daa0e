"""A recording into an MCAP file (`mcap_format` says what stands in it)."""

from __future__ import annotations

import errno
import heapq
import json
import math
import os
import stat
import struct
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np

from rtarm.console.errors import Refusal
from rtarm.recording import commands, statistics
from rtarm.recording.commands import Commands
from rtarm.recording.mcap_format import (
    BATCH,
    CHUNK_BYTES,
    COMMANDS,
    CYCLE_WORDS,
    EVENT_WORDS,
    EVENTS,
    FORMAT,
    FRAMES,
    JOINT_WORDS,
    JOINTS,
    JSON,
    LIBRARY,
    LIMITS,
    METADATA,
    NAMED,
    STATE,
    STATISTICS,
    TIMING,
    Reason,
    Step,
    library_of,
)
from rtarm.recording.statistics import Figures, Seconds
from rtarm.running.status import key
from rtarm.top.events import BAD, ODD, happening
from sentences.drive_words import words_of
from shm import layout
from shm.recording import (
    BUS_MASK,
    BUS_SHIFT,
    EXTENDED,
    IDENTIFIER_MASK,
    LENGTH_MASK,
    LENGTH_SHIFT,
    REMOTE,
    SENT,
    Recording,
)
from shm.words import Slowed

ASIDE_PREFIX, ASIDE_SUFFIX = ".rtarm-", ".new"
"""What a file is called until it is whole."""

_LEVEL_INFO, _LEVEL_WARNING, _LEVEL_ERROR = 2, 3, 4
"""Levels of foxglove.Log."""
DIFFERENT = 1024
"""Sets of bits whose words are remembered: they hardly ever change from cycle to cycle."""
_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


_Message = tuple[int, int, str, dict[str, Any]]
"""CLOCK_MONOTONIC, ROS time, channel, content."""


class NotWritten(Refusal):
    """A recording could not be written."""


def write(recording: Recording, reason: Reason, path: Path, step: Step = lambda _: None) -> None:
    """Write a file that only this user may read, whole or not at all, in place of nothing but an older recording.

    Raises:
        NotWritten: with the sentence for people.
    """
    try:
        check_target(path)
        if len(recording.records) == 0:
            raise NotWritten(
                f"The control process of {recording.arm} has not run a cycle, so there is nothing to record."
            )
        fd, aside = new_aside(path)
        try:
            with open(fd, "wb") as file:
                _write(recording, reason, file, step)
            os.replace(aside, path)
        finally:
            Path(aside).unlink(missing_ok=True)
    except OSError as problem:
        remedy = "free some space there" if is_full(problem) else "give a file in a folder that you may write to"
        raise NotWritten(f"The recording {path} cannot be written ({problem.strerror}): {remedy}.") from problem


def is_full(problem: OSError) -> bool:
    """Whether there was no room."""
    return problem.errno in (errno.ENOSPC, errno.EDQUOT)


def new_aside(path: Path) -> tuple[int, str]:
    """A new open file beside where a recording is to be, of mode 0600, which follows no link; and its name."""
    _make_folder(path.parent)
    return tempfile.mkstemp(ASIDE_SUFFIX, ASIDE_PREFIX, path.parent)


def check_target(path: Path) -> None:
    """Refuse to write over anything but a recording."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise NotWritten(f"{path} is a folder: name a file in it, such as {path / 'recording.mcap'}.")
    if not stat.S_ISREG(mode):
        raise NotWritten(f"{path} is a link, a device or a pipe, which no recording replaces: name a file.")
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        ours = (library_of(file) or "").startswith(LIBRARY)
    if not ours:
        raise NotWritten(f"{path} is there and no recording of rtarm's, so it is kept: name another file.")


def _make_folder(path: Path) -> None:
    """Make a folder and those above it that are missing, for this user alone."""
    if not path.exists():
        _make_folder(path.parent)
        path.mkdir(0o700, exist_ok=True)


def _write(recording: Recording, reason: Reason, file: IO[bytes], step: Step) -> None:
    growing = Growing(file, recording, reason)
    growing.add(recording, step)
    growing.finish()


class Growing:
    """A recording that is written piece by piece."""

    def __init__(self, file: IO[bytes], first: Recording, reason: Reason) -> None:
        """Write what leads the file; `first` is the first of its pieces."""
        from mcap.writer import CompressionType, Writer

        self._writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=LIBRARY + _version())
        for name, values in _metadata(first, reason).items():
            self._writer.add_metadata(name, values)
        self._channels = {}
        for name, schema_name, schema in _schemas(first.joints, several_buses=len(first.buses) > 1):
            schema_id = self._writer.register_schema(schema_name, "jsonschema", json.dumps(schema).encode())
            self._channels[name] = self._writer.register_channel(name, JSON, schema_id)
        self._seconds = Seconds(first.bitrate)
        self._commands = Commands()

    def add(self, piece: Recording, step: Step = lambda _: None) -> None:
        """Append a piece, which has at least one cycle."""
        start_ns = int(piece.records["monotonic_ns"][0])
        span_ns = max(int(piece.records["monotonic_ns"][-1]) - start_ns, 1)
        messages = (
            _cycles(piece),
            _events(piece),
            _frames(piece),
            _commands(piece, self._commands.add(piece)),
            map(_figures, self._seconds.add(piece.records)),
        )
        for number, message in enumerate(heapq.merge(*messages, key=lambda one: one[0])):
            self._add(message)
            if number % BATCH == 0:
                step(min(max((message[0] - start_ns) / span_ns, 0.0), 1.0))

    def flush(self) -> None:
        """Hand over what was added, so that it can be read whatever comes."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """The end of the file, by which a reader finds its way in it."""
        for figures in self._seconds.rest():
            self._add(_figures(figures))
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _add(self, message: _Message) -> None:
        _, epoch_ns, name, content = message
        data = _encode(content).encode()
        self._writer.add_message(self._channels[name], log_time=epoch_ns, publish_time=epoch_ns, data=data)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("rtarm")
    except PackageNotFoundError:
        return "(not installed)"


def _metadata(recording: Recording, reason: Reason) -> dict[str, dict[str, str]]:
    several_buses = len(recording.buses) > 1
    about = {
        "format": FORMAT,
        "version": _version(),
        "arm": recording.arm,
        "joints": list(recording.joints),
        "rate_hz": 1e9 / recording.period_ns,
        "period_ns": recording.period_ns,
        "bitrate": recording.buses[0].bitrate if recording.buses else 0,
        **({"buses": recording.buses} if several_buses else {}),
        "arm_hash": f"{recording.arm_hash:016x}",
        "pid": recording.pid,
        "lost": recording.lost,
        "written_epoch_ns": time.time_ns(),
        "reason": reason.word,
        "sentence": reason.sentence,
        "identifiers": [row if several_buses else row[:-1] for row in recording.identifiers.tolist()],
        "scheduling": _as_dict(recording.scheduling, skipped=("padding",)),
    }
    limits = _as_dict(recording.limits, skipped=("padding", "joints"))
    rows = {
        name: _as_dict(recording.limits["joints"][index], skipped=("reserved",))
        for index, name in enumerate(recording.joints)
    }
    timing = {name: _histogram(getattr(recording, name)) for name in ("lateness", "cycle_time")}
    return {METADATA: _texts(about), LIMITS: _texts({**limits, "joints": rows}), TIMING: _texts(timing)}


def _texts(values: dict[str, Any]) -> dict[str, str]:
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in values.items()}


def _as_dict(record: Any, skipped: Sequence[str]) -> dict[str, Any]:
    return {name: _plain(record[name].item()) for name in record.dtype.names if name not in skipped}


def _histogram(record: np.ndarray) -> dict[str, Any]:
    buckets = np.asarray(record["buckets"])
    filled = {str(index): int(buckets[index]) for index in np.flatnonzero(buckets)}
    return {**{name: int(record[name]) for name in ("max_ns", "count", "sum_ns")}, "buckets": filled}


def _plain(value: Any) -> Any:
    """A number as JSON has it: what is not finite is null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _schemas(joints: Sequence[str], *, several_buses: bool) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Name of each channel, name of its schema, and the schema."""
    units = layout.CycleRecord.words | layout.Joint.words

    def schema(title: str, dtype: np.dtype, names: Sequence[str], more: dict[str, Any]) -> dict[str, Any]:
        properties = {
            name: {
                "type": "string" if name in NAMED else "integer" if dtype[name].kind == "i" else ["number", "null"],
                "description": " ".join(
                    filter(None, (units[name].meaning, f"({units[name].unit})" * bool(units[name].unit)))
                ),
            }
            for name in names
        }
        return {"title": title, "type": "object", "properties": {**properties, **more}}

    slowed = {"slowed": {"type": "array", "items": {"type": "string"}, "description": units["slowed"].meaning}}
    yield STATE, "rtarm.State", schema("rtarm.State", layout.CycleRecord.dtype, CYCLE_WORDS, slowed)
    derived = {
        "number": {"type": "integer", "description": units["number"].meaning},
        "error_rad": {"type": ["number", "null"], "description": "measured less commanded, of the same instant (rad)"},
        "age_s": {"type": ["number", "null"], "description": "age of the reading in this cycle (s)"},
        "drive_says": {"type": "array", "items": {"type": "string"}, "description": "drive_status in words"},
    }
    for name in joints:
        yield JOINTS + name, "rtarm.Joint", schema("rtarm.Joint", layout.Joint.dtype, JOINT_WORDS, derived)
    text, integer, number = {"type": "string"}, {"type": "integer"}, {"type": ["number", "null"]}
    stamp = {"type": "object", "title": "time", "properties": {"sec": integer, "nsec": integer}}
    log = {"timestamp": stamp, "level": integer, "message": text, "name": text, "file": text, "line": integer}
    own = {
        "monotonic_ns": integer,
        "kind": integer,
        "joint": integer,
        "code": integer,
        "value": number,
        "limit": number,
        "silent": integer,
        "evidence": integer,
    }
    yield EVENTS, "foxglove.Log", {"title": "foxglove.Log", "type": "object", "properties": {**log, **own}}
    frame = {
        "monotonic_ns": integer,
        "sent": {"type": "boolean", "description": "whether the control process sent it; it came otherwise"},
        **({"bus": {**text, "description": "name of the bus it was on"}} if several_buses else {}),
        "joint": {"type": ["string", "null"], "description": "whose drive hears or says its identifier"},
        "id": integer,
        "extended": {"type": "boolean"},
        "remote": {"type": "boolean"},
        "data": {"type": "string", "description": "bytes in hexadecimal"},
    }
    yield FRAMES, "rtarm.Frame", {"title": "rtarm.Frame", "type": "object", "properties": frame}
    for name, title, properties in (
        (COMMANDS, "rtarm.Command", commands.properties()),
        (STATISTICS, "rtarm.Statistics", statistics.properties()),
    ):
        yield name, title, {"title": title, "type": "object", "properties": properties}


def _columns(records: np.ndarray, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Records as dictionaries of plain numbers and names."""
    columns: list[list[Any]] = []
    for name in names:
        values = records[name].tolist()
        kind = NAMED.get(name)
        if kind is not None:
            known = {value: key(kind, value) for value in set(values)}
            values = [known[value] for value in values]
        elif records.dtype[name].kind == "f":
            values = [_plain(value) for value in values]
        columns.append(values)
    for row in zip(*columns, strict=True):
        yield dict(zip(names, row, strict=True))


def _cycles(recording: Recording) -> Iterator[_Message]:
    """The cycles, a batch at a time: as Python's numbers all of them would take a gigabyte for a large, quick arm."""
    for start in range(0, len(recording.records), BATCH):
        yield from _batch(recording, recording.records[start : start + BATCH])


def _batch(recording: Recording, records: np.ndarray) -> Iterator[_Message]:
    joints = records["joints"]
    errors = (joints["measured_position_rad"] - joints["reference_position_rad"]).tolist()
    ages = np.where(
        joints["measured_ns"] > 0, (records["monotonic_ns"][:, None] - joints["measured_ns"]) * 1e-9, np.nan
    )
    rows = [_columns(joints[:, index], JOINT_WORDS) for index in range(len(recording.joints))]
    for number, state in enumerate(_columns(records, CYCLE_WORDS)):
        at = state["monotonic_ns"], max(state["epoch_ns"], 0)
        state["slowed"] = _reasons(state["slowed"])
        yield *at, STATE, state
        for index, name in enumerate(recording.joints):
            joint = next(rows[index])
            joint["number"] = state["number"]
            joint["error_rad"] = _plain(errors[number][index])
            joint["age_s"] = _plain(float(ages[number, index]))
            joint["drive_says"] = _said(joint["drive_status"])
            yield *at, JOINTS + name, joint


@lru_cache(DIFFERENT)
def _reasons(slowed: int) -> list[str]:
    """Why the arm was slower than asked, by name."""
    return [reason.name.lower() for reason in Slowed if reason.name and slowed & reason]


@lru_cache(DIFFERENT)
def _said(drive_status: int) -> list[str]:
    """What a drive reported of itself, by name."""
    return words_of(drive_status)


def _to_epoch(recording: Recording, monotonic_ns: np.ndarray) -> list[int]:
    """ROS time of instants on CLOCK_MONOTONIC, as the clocks stood in the cycle before each."""
    instants = recording.records["monotonic_ns"]
    at = np.maximum(np.searchsorted(instants, monotonic_ns, side="right") - 1, 0)
    epochs: list[int] = np.maximum(monotonic_ns + (recording.records["epoch_ns"] - instants)[at], 0).tolist()
    return epochs


def _events(recording: Recording) -> Iterator[_Message]:
    epochs = _to_epoch(recording, recording.events["monotonic_ns"])
    for event, epoch_ns in zip(recording.events, epochs, strict=True):
        told = happening(event, recording.joints, buses=recording.bus_names)
        level = {BAD: _LEVEL_ERROR, ODD: _LEVEL_WARNING}.get(told.style, _LEVEL_INFO)
        content = {
            "timestamp": {"sec": epoch_ns // 1_000_000_000, "nsec": epoch_ns % 1_000_000_000},
            "level": level,
            "message": told.sentence,
            "name": recording.arm,
            "file": "",
            "line": 0,
            **{name: _plain(event[name].item()) for name in EVENT_WORDS},
        }
        yield told.monotonic_ns, epoch_ns, EVENTS, content


def _whose(recording: Recording) -> Callable[[int, int, bool], str | None]:
    """Which joint's drive an identifier on a bus belongs to; None for those of nobody, or of several."""
    rows = recording.identifiers.tolist()

    @cache
    def whose(bus: int, identifier: int, extended: bool) -> str | None:
        found = {
            joint
            for match, mask, long, joint, on in rows
            if (identifier ^ match) & mask == 0 and long == extended and on == bus
        }
        return recording.joints[found.pop()] if len(found) == 1 else None

    return whose


def _frames(recording: Recording) -> Iterator[_Message]:
    whose, names = _whose(recording), recording.bus_names
    order = np.argsort(recording.frames["monotonic_ns"], kind="stable")  # what was sent has its cycle's planned time
    frames = recording.frames[order]
    epochs = _to_epoch(recording, frames["monotonic_ns"])
    for (_, monotonic_ns, head, data), epoch_ns in zip(frames.tolist(), epochs, strict=True):
        bus, identifier = head >> BUS_SHIFT & BUS_MASK, head & IDENTIFIER_MASK
        length = min(head >> LENGTH_SHIFT & LENGTH_MASK, 8)
        content = {
            "monotonic_ns": monotonic_ns,
            "sent": bool(head & SENT),
            **({"bus": names[bus]} if bus < len(names) else {}),
            "joint": whose(bus, identifier, bool(head & EXTENDED)),
            "id": identifier,
            "extended": bool(head & EXTENDED),
            "remote": bool(head & REMOTE),
            "data": struct.pack("<q", data)[:length].hex(),
        }
        yield monotonic_ns, epoch_ns, FRAMES, content


def _commands(recording: Recording, found: Sequence[commands.Command]) -> Iterator[_Message]:
    epochs = _to_epoch(recording, np.array([one.monotonic_ns for one in found], np.int64))
    for command, epoch_ns in zip(found, epochs, strict=True):
        yield command.monotonic_ns, epoch_ns, COMMANDS, command.content


def _figures(figures: Figures) -> _Message:
    return figures.monotonic_ns, figures.epoch_ns, STATISTICS, figures.content
