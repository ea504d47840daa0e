"""A recording as an MCAP file: JSON messages with their schemas, which Foxglove plots, and back again.

Channels: `/rtarm/state` and `/rtarm/joints/<joint>` in every cycle, of which they carry the `number`, `/rtarm/events`
with their sentences (as a log), `/rtarm/frames` of the bus. Times are those of ROS; what the motion is timed by stands
in `monotonic_ns` of the state. What else is known of the arm leads the file as metadata, so that one that was cut off
can still be told, and a file of others' is known before it is read to its end.
"""

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from config.errors import legible
from rtarm.errors import Refusal
from rtarm.status import key
from rtarm.top.events import BAD, ODD, happening
from shm import layout
from shm.recording import (
    EXTENDED,
    IDENTIFIER_MASK,
    LENGTH_MASK,
    LENGTH_SHIFT,
    SENT,
    Recording,
    record_dtype,
)
from shm.words import BusState, Fault, Mode, Outcome, Phase, Slowed, Unreferenced

MAGIC = b"\x89MCAP0\r\n"
FORMAT = "1"
METADATA, LIMITS, TIMING = "rtarm", "rtarm.limits", "rtarm.timing"
STATE, JOINTS, EVENTS, FRAMES = "/rtarm/state", "/rtarm/joints/", "/rtarm/events", "/rtarm/frames"
LIBRARY = "rtarm "
"""So begins what our files say that they were written by."""
JSON = "json"
CHUNK_BYTES = 256 << 10
"""So much is lost at most around a spoilt byte."""
LONGEST_RECORD = 64 << 20
"""Bytes; one of ours has hardly more than a chunk, even where another tool has packed it anew."""
LONGEST_NAME, LONGEST_SENTENCE = 64, 1000
"""Characters of what a file may say to people."""
ASIDE_PREFIX, ASIDE_SUFFIX = ".rtarm-", ".new"
"""What a file is called until it is whole."""

BATCH = 1000
_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode

_NAMED: dict[str, type[IntEnum]] = {
    "mode": Mode,
    "fault": Fault,
    "goal_phase": Phase,
    "ending": Outcome,
    "unreferenced_reason": Unreferenced,
    "bus_state": BusState,
}
"""Numbers that stand in the file by name."""
_SUMS = ("crc", "decisions_crc")
_CYCLE_WORDS = [name for name in layout.RECORD.names or () if name not in (*_SUMS, "joints")]
_JOINT_WORDS = list(layout.JOINT.names or ())
_EVENT_WORDS = list(layout.EVENT.names or ())
_STATE = np.dtype([(name, layout.RECORD[name]) for name in _CYCLE_WORDS])
_JOINT = np.dtype([("number", np.int64), *((name, layout.JOINT[name]) for name in _JOINT_WORDS)])
"""A message of a cycle's state and of a joint in it, as numbers."""
_LEVEL_INFO, _LEVEL_WARNING, _LEVEL_ERROR = 2, 3, 4
"""Levels of foxglove.Log."""


class Reason(NamedTuple):
    """Why a recording was written: a word, and a sentence."""

    word: str
    sentence: str


class Loaded(NamedTuple):
    """A recording out of a file, why it was written, and what is wrong with the file ("" if nothing)."""

    recording: Recording
    reason: Reason
    damage: str


class NotWritten(Refusal):
    """A recording could not be written."""


# --- writing ----------------------------------------------------------------------------------------------


def write(recording: Recording, reason: Reason, path: Path) -> None:
    """Write a file that only this user may read, whole or not at all, in place of nothing but an older recording.

    Raises:
        NotWritten: with the sentence for people.
    """
    try:
        _check_target(path)
        if len(recording.records) == 0:
            raise NotWritten(
                f"The control process of {recording.arm} has not run a cycle, so there is nothing to record."
            )
        _make_folder(path.parent)
        fd, aside = tempfile.mkstemp(ASIDE_SUFFIX, ASIDE_PREFIX, path.parent)  # new, of mode 0600, follows no link
        try:
            with open(fd, "wb") as file:
                _write(recording, reason, file)
            os.replace(aside, path)
        finally:
            Path(aside).unlink(missing_ok=True)
    except OSError as problem:
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT)
        remedy = "free some space there" if full else "give a file in a folder that you may write to"
        raise NotWritten(f"The recording {path} cannot be written ({problem.strerror}): {remedy}.") from problem


def _check_target(path: Path) -> None:
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
        ours = (_library(file) or "").startswith(LIBRARY)
    if not ours:
        raise NotWritten(f"{path} is there and no recording of rtarm's, so it is kept: name another file.")


def _make_folder(path: Path) -> None:
    """Make a folder and those above it that are missing, for this user alone."""
    if not path.exists():
        _make_folder(path.parent)
        path.mkdir(0o700, exist_ok=True)


def _write(recording: Recording, reason: Reason, file: IO[bytes]) -> None:
    from mcap.writer import CompressionType, Writer

    writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
    writer.start(profile="", library=LIBRARY + _version())
    for name, values in _metadata(recording, reason).items():
        writer.add_metadata(name, values)
    channels = {}
    for name, schema_name, schema in _schemas(recording.joints):
        schema_id = writer.register_schema(schema_name, "jsonschema", json.dumps(schema).encode())
        channels[name] = writer.register_channel(name, JSON, schema_id)
    for message in heapq.merge(*_messages(recording), key=lambda one: one[0]):
        _, epoch_ns, name, content = message
        data = _encode(content).encode()
        writer.add_message(channels[name], log_time=epoch_ns, publish_time=epoch_ns, data=data)
    writer.finish()  # type: ignore[no-untyped-call]


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("rtarm")
    except PackageNotFoundError:
        return "(not installed)"


def _metadata(recording: Recording, reason: Reason) -> dict[str, dict[str, str]]:
    about = {
        "format": FORMAT,
        "version": _version(),
        "arm": recording.arm,
        "joints": list(recording.joints),
        "rate_hz": 1e9 / recording.period_ns,
        "period_ns": recording.period_ns,
        "bitrate": recording.bitrate,
        "arm_hash": f"{recording.arm_hash:016x}",
        "pid": recording.pid,
        "lost": recording.lost,
        "written_epoch_ns": time.time_ns(),
        "reason": reason.word,
        "sentence": reason.sentence,
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


def _schemas(joints: Sequence[str]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Name of each channel, name of its schema, and the schema."""
    units = {
        word.name: word for table in ("flight recorder's record of a cycle", "joint") for word in layout.TABLES[table]
    }

    def schema(title: str, dtype: np.dtype, names: Sequence[str], more: dict[str, Any]) -> dict[str, Any]:
        properties = {
            name: {
                "type": "string" if name in _NAMED else "integer" if dtype[name].kind == "i" else ["number", "null"],
                "description": " ".join(
                    filter(None, (units[name].meaning, f"({units[name].unit})" * bool(units[name].unit)))
                ),
            }
            for name in names
        }
        return {"title": title, "type": "object", "properties": {**properties, **more}}

    slowed = {"slowed": {"type": "array", "items": {"type": "string"}, "description": units["slowed"].meaning}}
    yield STATE, "rtarm.State", schema("rtarm.State", layout.RECORD, _CYCLE_WORDS, slowed)
    derived = {
        "number": {"type": "integer", "description": units["number"].meaning},
        "error_rad": {"type": ["number", "null"], "description": "measured less commanded, of the same instant (rad)"},
        "age_s": {"type": ["number", "null"], "description": "age of the reading in this cycle (s)"},
    }
    for name in joints:
        yield JOINTS + name, "rtarm.Joint", schema("rtarm.Joint", layout.JOINT, _JOINT_WORDS, derived)
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
    }
    yield EVENTS, "foxglove.Log", {"title": "foxglove.Log", "type": "object", "properties": {**log, **own}}
    frame = {
        "monotonic_ns": integer,
        "sent": {"type": "boolean", "description": "whether the control process sent it; it came otherwise"},
        "joint": {"type": ["string", "null"], "description": "whose drive has its address"},
        "id": integer,
        "extended": {"type": "boolean"},
        "data": {"type": "string", "description": "bytes in hexadecimal"},
    }
    yield FRAMES, "rtarm.Frame", {"title": "rtarm.Frame", "type": "object", "properties": frame}


_Message = tuple[int, int, str, dict[str, Any]]
"""CLOCK_MONOTONIC, ROS time, channel, content."""


def _messages(recording: Recording) -> tuple[Iterator[_Message], ...]:
    return _cycles(recording), _events(recording), _frames(recording)


def _columns(records: np.ndarray, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Records as dictionaries of plain numbers and names."""
    columns: list[list[Any]] = []
    for name in names:
        values = records[name].tolist()
        kind = _NAMED.get(name)
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
    rows = [_columns(joints[:, index], _JOINT_WORDS) for index in range(len(recording.joints))]
    for number, state in enumerate(_columns(records, _CYCLE_WORDS)):
        at = state["monotonic_ns"], max(state["epoch_ns"], 0)
        bits = state["slowed"]
        state["slowed"] = [reason.name.lower() for reason in Slowed if reason.name and bits & reason]
        yield *at, STATE, state
        for index, name in enumerate(recording.joints):
            joint = next(rows[index])
            joint["number"] = state["number"]
            joint["error_rad"] = _plain(errors[number][index])
            joint["age_s"] = _plain(float(ages[number, index]))
            yield *at, JOINTS + name, joint


def _to_epoch(recording: Recording, monotonic_ns: np.ndarray) -> list[int]:
    """ROS time of instants on CLOCK_MONOTONIC, as the clocks stood in the cycle before each."""
    instants = recording.records["monotonic_ns"]
    at = np.maximum(np.searchsorted(instants, monotonic_ns, side="right") - 1, 0)
    epochs: list[int] = np.maximum(monotonic_ns + (recording.records["epoch_ns"] - instants)[at], 0).tolist()
    return epochs


def _events(recording: Recording) -> Iterator[_Message]:
    epochs = _to_epoch(recording, recording.events["monotonic_ns"])
    for event, epoch_ns in zip(recording.events, epochs, strict=True):
        told = happening(event, recording.joints)
        level = {BAD: _LEVEL_ERROR, ODD: _LEVEL_WARNING}.get(told.style, _LEVEL_INFO)
        content = {
            "timestamp": {"sec": epoch_ns // 1_000_000_000, "nsec": epoch_ns % 1_000_000_000},
            "level": level,
            "message": told.sentence,
            "name": recording.arm,
            "file": "",
            "line": 0,
            **{name: _plain(event[name].item()) for name in _EVENT_WORDS},
        }
        yield told.monotonic_ns, epoch_ns, EVENTS, content


def _frames(recording: Recording) -> Iterator[_Message]:
    addresses = recording.limits["joints"]["drive_address"][: len(recording.joints)].tolist()
    by_address = {address: name for address, name in zip(addresses, recording.joints, strict=True) if address}
    order = np.argsort(recording.frames["monotonic_ns"], kind="stable")  # what was sent has its cycle's planned time
    frames = recording.frames[order]
    epochs = _to_epoch(recording, frames["monotonic_ns"])
    for (_, monotonic_ns, head, data), epoch_ns in zip(frames.tolist(), epochs, strict=True):
        identifier = head & IDENTIFIER_MASK
        length = min(head >> LENGTH_SHIFT & LENGTH_MASK, 8)
        content = {
            "monotonic_ns": monotonic_ns,
            "sent": bool(head & SENT),
            "joint": by_address.get(identifier >> 8) if head & EXTENDED else None,
            "id": identifier,
            "extended": bool(head & EXTENDED),
            "data": struct.pack("<q", data)[:length].hex(),
        }
        yield monotonic_ns, epoch_ns, FRAMES, content


# --- reading ----------------------------------------------------------------------------------------------


def read(path: Path) -> Loaded:
    """Read a file; of one that is damaged, what can be read.

    Raises:
        Refusal: it cannot be opened, or is no recording of ours.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise Refusal(f"{path} is a folder: give one of the .mcap files in it.")
        if not stat.S_ISREG(status.st_mode):  # opening a pipe would wait for its other end
            raise Refusal(f"{path} is no file that holds a recording: give one that ends in .mcap.")
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise Refusal(f"{path} is no MCAP file: give one that `rtarm record` has written.")
            return _read(path, file)
    except FileNotFoundError:
        raise Refusal(f"{path} is not there: `rtarm explain` without a file takes the newest recording.") from None
    except OSError as problem:
        raise Refusal(f"{path} cannot be read ({problem.strerror}): give a file that you may read.") from problem


class _Damage:
    """What was found to be wrong with a file."""

    def __init__(self) -> None:
        self.spoilt = 0
        self.incomplete = 0
        self.ended = False

    def __str__(self) -> str:
        parts = []
        if self.spoilt:
            parts.append(f"{self.spoilt} of its parts {'is' if self.spoilt == 1 else 'are'} spoilt and left out")
        if self.incomplete:
            cycles = "1 cycle is" if self.incomplete == 1 else f"{self.incomplete} cycles are"
            parts.append(f"{cycles} incomplete and left out")
        if not self.ended:
            parts.append("it ends too early, as if it had been cut off")
        return "; ".join(parts)


def _read(path: Path, file: IO[bytes]) -> Loaded:
    library = _library(file)
    damage = _Damage()
    records = _whole_records(file, damage)
    metadata = _head(records)
    if METADATA not in metadata or LIMITS not in metadata:
        if library is None or library.startswith(LIBRARY):
            raise Refusal(f"{path} is damaged so early that nothing of it can be told: what leads the file is missing.")
        raise Refusal(f"{path} is an MCAP file, but no recording of rtarm's: give one that `rtarm record` has written.")
    if metadata[METADATA].get("format") != FORMAT:
        found = legible(metadata[METADATA].get("format", "unknown"), LONGEST_NAME)
        raise Refusal(f"{path} has format {found}, this rtarm reads format {FORMAT}: use the version that wrote it.")
    try:
        recording, reason = _made(metadata, _topics(file), records, damage)
    except OSError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError, IndexError, RecursionError) as problem:
        raise Refusal(
            f"{path} says it is a recording of rtarm's, but its content is not "
            f"({legible(repr(problem), LONGEST_NAME)}): another program wrote or changed it."
        ) from problem
    if len(recording.records) == 0:
        said = str(damage)
        raise Refusal(f"{path} holds no cycle that can be read{f' ({said})' if said else ''}: nothing can be told.")
    return Loaded(recording, reason, str(damage))


def _library(file: IO[bytes]) -> str | None:
    """What an MCAP file says that it was written by; None if that cannot be read."""
    from mcap.records import Header
    from mcap.stream_reader import StreamReader

    file.seek(0)
    try:
        header = next(StreamReader(file, record_size_limit=CHUNK_BYTES).records)
    except OSError:
        raise
    except Exception:  # whatever a parser makes of anything
        return None
    return header.library if isinstance(header, Header) else None


def _topics(file: IO[bytes]) -> dict[int, str]:
    """The channels that a whole file lists at its end, so that they are known if the chunk with them is spoilt."""
    from mcap.reader import SeekingReader

    at = file.tell()
    file.seek(0)
    try:
        summary = SeekingReader(file, record_size_limit=LONGEST_RECORD).get_summary()
    except Exception:  # whatever a parser makes of spoilt bytes
        summary = None
    finally:
        file.seek(at)
    channels = {} if summary is None else summary.channels
    return {number: one.topic for number, one in channels.items() if one.message_encoding == JSON}


def _whole_records(file: IO[bytes], damage: _Damage) -> Iterator[Any]:
    """A file's records one by one, those of chunks too, and before each chunk None; what is spoilt is left out."""
    from mcap.records import Chunk, Footer
    from mcap.stream_reader import StreamReader, breakup_chunk

    file.seek(0)
    records = StreamReader(file, emit_chunks=True, record_size_limit=LONGEST_RECORD).records
    while True:
        try:
            record = next(records, None)
        except OSError:
            raise
        except Exception:  # whatever parsers make of spoilt bytes: from here on nothing can be found any more
            return
        if record is None:
            return
        damage.ended = damage.ended or isinstance(record, Footer)
        if not isinstance(record, Chunk):
            yield record
            continue
        yield None
        try:
            inner = breakup_chunk(record, validate_crc=True)
        except Exception:  # the same, and of decompression; the next chunk may be whole
            damage.spoilt += 1
            continue
        yield from inner


def _head(records: Iterator[Any]) -> dict[str, dict[str, str]]:
    """The metadata before the first chunk or message."""
    from mcap.records import Message, Metadata

    metadata: dict[str, dict[str, str]] = {}
    for record in records:
        if record is None or isinstance(record, Message):
            break
        if isinstance(record, Metadata):
            metadata[record.name] = record.metadata
    return metadata


class _Table:
    """Messages of a channel as an array, made of a batch at a time: as Python's objects all would take gigabytes."""

    def __init__(self, made: Callable[[list[dict[str, Any]]], np.ndarray]) -> None:
        self._made = made
        self._pending: list[dict[str, Any]] = []
        self._parts: list[np.ndarray] = []

    def add(self, row: dict[str, Any]) -> None:
        self._pending.append(row)
        if len(self._pending) == BATCH:
            self._take()

    def array(self) -> np.ndarray:
        self._take()
        return np.concatenate(self._parts)

    def _take(self) -> None:
        self._parts.append(self._made(self._pending))
        self._pending = []


def _tables(records: Iterator[Any], topics: dict[int, str], joints: Sequence[str]) -> dict[str, np.ndarray]:
    """The messages of our channels; those of others in the same file are let be."""
    from mcap.records import Channel, Message

    tables = {STATE: _Table(_states_of), FRAMES: _Table(_frames_of), EVENTS: _Table(_events_of)}
    tables.update((JOINTS + name, _Table(_joints_of)) for name in joints)
    for record in records:
        if isinstance(record, Channel) and record.message_encoding == JSON:
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            table = tables.get(topics.get(record.channel_id, ""))
            if table is not None:
                table.add(json.loads(record.data))
    return {topic: table.array() for topic, table in tables.items()}


def _made(
    metadata: Mapping[str, dict[str, str]], topics: dict[int, str], records: Iterator[Any], damage: _Damage
) -> tuple[Recording, Reason]:
    about, limits, timing = metadata[METADATA], metadata[LIMITS], metadata.get(TIMING, {})
    joints = tuple(str(name) for name in json.loads(about["joints"]))
    if not 0 < len(joints) <= layout.MAX_JOINTS:
        raise ValueError(f"{len(joints)} joints")
    period_ns = int(about["period_ns"])
    if period_ns <= 0:
        raise ValueError(f"a period of {period_ns} ns")
    tables = _tables(records, topics, joints)
    recording = Recording(
        arm=legible(about["arm"], LONGEST_NAME),
        joints=tuple(legible(name, LONGEST_NAME) for name in joints),
        arm_hash=int(about["arm_hash"], 16),
        pid=int(about["pid"]),
        period_ns=period_ns,
        bitrate=int(about["bitrate"]),
        records=_records(tables[STATE], [tables[JOINTS + name] for name in joints], damage),
        frames=tables[FRAMES],
        events=tables[EVENTS],
        limits=_limits_of(limits, joints),
        scheduling=_filled_one(layout.SCHEDULING, json.loads(about["scheduling"])),
        lateness=_histogram_of(json.loads(timing.get("lateness", "{}"))),
        cycle_time=_histogram_of(json.loads(timing.get("cycle_time", "{}"))),
        lost=int(about["lost"]),
    )
    return recording, Reason(legible(about["reason"], LONGEST_NAME), legible(about["sentence"], LONGEST_SENTENCE))


def _records(states: np.ndarray, rows: Sequence[np.ndarray], damage: _Damage) -> np.ndarray:
    """The cycles of which everything is there: a spoilt chunk may begin and end amid a cycle."""
    tables = (states, *rows)
    if any(np.any(np.diff(table["number"]) <= 0) for table in tables):
        raise ValueError("cycles that are not in their order")
    whole = states["number"]
    known = states["number"]
    for table in rows:
        whole = np.intersect1d(whole, table["number"], assume_unique=True)
        known = np.union1d(known, table["number"])
    damage.incomplete = len(known) - len(whole)
    records = np.zeros(len(whole), record_dtype(len(rows)))
    states, *rows = (table[np.searchsorted(table["number"], whole)] for table in tables)
    for name in _CYCLE_WORDS:
        records[name] = states[name]
    for index, row in enumerate(rows):
        for name in _JOINT_WORDS:
            records["joints"][name][:, index] = row[name]
    if np.any(np.diff(records["monotonic_ns"]) < 0):
        raise ValueError("cycles that are not in their order")
    return records


def _states_of(rows: list[dict[str, Any]]) -> np.ndarray:
    for row in rows:
        row["slowed"] = sum(Slowed[name.upper()] for name in row["slowed"])
    return _filled(_STATE, _CYCLE_WORDS, rows)


def _joints_of(rows: list[dict[str, Any]]) -> np.ndarray:
    return _filled(_JOINT, _JOINT.names or (), rows)


def _events_of(rows: list[dict[str, Any]]) -> np.ndarray:
    return _filled(layout.EVENT, _EVENT_WORDS, rows)


def _filled(dtype: np.dtype, names: Sequence[str], rows: list[dict[str, Any]]) -> np.ndarray:
    made = np.zeros(len(rows), dtype)
    _fill(made, names, rows)
    return made


def _fill(records: np.ndarray, names: Sequence[str], rows: list[dict[str, Any]]) -> None:
    for name in names:
        values = [row[name] for row in rows]
        kind = _NAMED.get(name)
        if kind is not None and records.dtype[name].kind == "i":
            values = [_number_of(kind, value) if isinstance(value, str) else value for value in values]
        elif records.dtype[name].kind == "f":
            values = [math.nan if value is None else value for value in values]
        records[name] = values


def _number_of(kind: type[IntEnum], name: str) -> int:
    """The number that `rtarm.status.key` gave a name."""
    number = name.removeprefix("unknown_")
    return int(number) if number != name else int(kind[name.upper()])


def _filled_one(dtype: np.dtype, values: dict[str, Any]) -> np.ndarray:
    made = np.zeros((), dtype)
    for name, value in values.items():
        made[name] = math.nan if value is None else value
    return made


def _limits_of(texts: dict[str, str], joints: Sequence[str]) -> np.ndarray:
    values = {name: json.loads(text) for name, text in texts.items()}
    rows = values.pop("joints")
    made = _filled_one(layout.LIMITS, values)
    for index, name in enumerate(joints):
        for word, value in rows[name].items():
            made["joints"][word][index] = math.nan if value is None else value
    return made


def _histogram_of(values: dict[str, Any]) -> np.ndarray:
    buckets = values.pop("buckets", {})
    made = _filled_one(layout.HISTOGRAM, values)
    for index, count in buckets.items():
        made["buckets"][int(index)] = count
    return made


def _frames_of(rows: list[dict[str, Any]]) -> np.ndarray:
    made = np.zeros(len(rows), layout.BUS_FRAME)
    for frame, row in zip(made, rows, strict=True):
        data = bytes.fromhex(row["data"])
        if len(data) > 8:
            raise ValueError(f"a frame of {len(data)} bytes")
        marks = (SENT if row["sent"] else 0) | (EXTENDED if row["extended"] else 0)
        frame["monotonic_ns"] = row["monotonic_ns"]
        frame["head"] = row["id"] | len(data) << LENGTH_SHIFT | marks
        frame["data"] = int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)
    return made
