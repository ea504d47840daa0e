"""A recording out of an MCAP file, whole or damaged (`mcap_format` says what stands in it)."""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np

from config.errors import legible
from rtarm.console.errors import Refusal
from rtarm.recording.mcap_format import (
    BATCH,
    CYCLE_WORDS,
    EVENT_WORDS,
    EVENTS,
    FORMAT,
    FRAMES,
    JOINT_MESSAGE,
    JOINT_WORDS,
    JOINTS,
    JSON,
    LATER_CYCLE_WORDS,
    LATER_EVENT_WORDS,
    LATER_JOINT_WORDS,
    LIBRARY,
    LIMITS,
    LONGEST_NAME,
    LONGEST_RECORD,
    LONGEST_SENTENCE,
    MAGIC,
    METADATA,
    NAMED,
    STATE,
    STATE_MESSAGE,
    TIMING,
    Loaded,
    Reason,
    Step,
    library_of,
)
from shm import layout
from shm.files import Bus
from shm.recording import BUS_SHIFT, EXTENDED, LENGTH_SHIFT, REMOTE, SENT, Recording, record_dtype
from shm.words import Slowed


def read(path: Path, step: Step = lambda _: None) -> Loaded:
    """Read a file; of one that is damaged, what can be read. `step` is told how much of it is read, 0…1.

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
            return _read(path, file, step)
    except FileNotFoundError:
        raise Refusal(f"{path} is not there: name a file that is, or none, which takes the newest recording.") from None
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
            parts.append("it ends too early, as if it had been cut off or were still being written")
        return "; ".join(parts)


def _read(path: Path, file: IO[bytes], step: Step) -> Loaded:
    library = library_of(file)
    damage = _Damage()
    records = _whole_records(file, damage, step)
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


def _whole_records(file: IO[bytes], damage: _Damage, step: Step) -> Iterator[Any]:
    """A file's records one by one, those of chunks too, and before each chunk None; what is spoilt is left out."""
    from mcap.records import Chunk, Footer
    from mcap.stream_reader import StreamReader, breakup_chunk

    size = max(os.fstat(file.fileno()).st_size, 1)
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
        step(file.tell() / size)
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
    """Messages of a channel as an array, made of a batch at a time: as Python's objects all would take gigabytes.

    A batch is one JSON text, which is read in half the time that its messages take one by one.
    """

    def __init__(self, made: Callable[[list[dict[str, Any]]], np.ndarray]) -> None:
        self._made = made
        self._pending: list[bytes] = []
        self._parts: list[np.ndarray] = []

    def add(self, message: bytes) -> None:
        self._pending.append(message)
        if len(self._pending) == BATCH:
            self._take()

    def array(self) -> np.ndarray:
        self._take()
        return np.concatenate(self._parts)

    def _take(self) -> None:
        rows = json.loads(b"[%b]" % b",".join(self._pending))
        if len(rows) != len(self._pending):
            raise ValueError("a message that is no JSON object")
        self._parts.append(self._made(rows))
        self._pending = []


def _tables(
    records: Iterator[Any], topics: dict[int, str], joints: Sequence[str], buses: Sequence[str]
) -> dict[str, np.ndarray]:
    """The messages of our channels; those of others in the same file are let be."""
    from mcap.records import Channel, Message

    tables = {STATE: _Table(_states_of), FRAMES: _Table(partial(_frames_of, buses)), EVENTS: _Table(_events_of)}
    tables.update((JOINTS + name, _Table(_joints_of)) for name in joints)
    for record in records:
        if isinstance(record, Channel) and record.message_encoding == JSON:
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            table = tables.get(topics.get(record.channel_id, ""))
            if table is not None:
                table.add(record.data)
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
    buses = _buses_of(about)
    tables = _tables(records, topics, joints, [bus.name for bus in buses])
    recording = Recording(
        arm=legible(about["arm"], LONGEST_NAME),
        joints=tuple(legible(name, LONGEST_NAME) for name in joints),
        arm_hash=int(about["arm_hash"], 16),
        pid=int(about["pid"]),
        period_ns=period_ns,
        buses=buses,
        records=_records(tables[STATE], [tables[JOINTS + name] for name in joints], damage),
        frames=tables[FRAMES],
        events=tables[EVENTS],
        limits=_limits_of(limits, joints),
        identifiers=_identifiers_of(json.loads(about.get("identifiers", "[]")), len(joints), len(buses)),
        scheduling=_filled_one(layout.Scheduling.dtype, json.loads(about["scheduling"])),
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
    for name in CYCLE_WORDS:
        records[name] = states[name]
    for index, row in enumerate(rows):
        for name in JOINT_WORDS:
            records["joints"][name][:, index] = row[name]
    if np.any(np.diff(records["monotonic_ns"]) < 0):
        raise ValueError("cycles that are not in their order")
    return records


def _states_of(rows: list[dict[str, Any]]) -> np.ndarray:
    for row in rows:
        row["slowed"] = sum(Slowed[name.upper()] for name in row["slowed"])
        for name in LATER_CYCLE_WORDS:
            row.setdefault(name, 0)
    return _filled(STATE_MESSAGE, CYCLE_WORDS, rows)


def _joints_of(rows: list[dict[str, Any]]) -> np.ndarray:
    for row in rows:
        for name in LATER_JOINT_WORDS:
            row.setdefault(name, None)
    return _filled(JOINT_MESSAGE, JOINT_MESSAGE.names or (), rows)


def _events_of(rows: list[dict[str, Any]]) -> np.ndarray:
    for row in rows:
        for name in LATER_EVENT_WORDS:
            row.setdefault(name, 0)
    return _filled(layout.Event.dtype, EVENT_WORDS, rows)


def _filled(dtype: np.dtype, names: Sequence[str], rows: list[dict[str, Any]]) -> np.ndarray:
    made = np.zeros(len(rows), dtype)
    _fill(made, names, rows)
    return made


def _fill(records: np.ndarray, names: Sequence[str], rows: list[dict[str, Any]]) -> None:
    for name in names:
        values = [row[name] for row in rows]
        kind = NAMED.get(name)
        if kind is not None and records.dtype[name].kind == "i":
            values = [_number_of(kind, value) if isinstance(value, str) else value for value in values]
        elif records.dtype[name].kind == "f":
            values = [math.nan if value is None else value for value in values]
        records[name] = values


def _number_of(kind: type[IntEnum], name: str) -> int:
    """The number that `rtarm.running.status.key` gave a name."""
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
    made = _filled_one(layout.Limits.dtype, values)
    for index, name in enumerate(joints):
        for word in set(layout.JointLimits.words) & rows[name].keys():  # files of before have one more
            made["joints"][word][index] = math.nan if rows[name][word] is None else rows[name][word]
    return made


def _buses_of(about: Mapping[str, str]) -> tuple[Bus, ...]:
    """An arm of one bus has its bit rate alone, one without a bus a bit rate of 0."""
    rows = json.loads(about.get("buses", "[]"))
    if len(rows) > layout.MAX_BUSES:
        raise ValueError(f"{len(rows)} buses")
    if rows:
        return tuple(Bus(legible(name, LONGEST_NAME), int(bitrate)) for name, bitrate in rows)
    bitrate = int(about["bitrate"])
    return (Bus("", bitrate),) if bitrate else ()


def _identifiers_of(rows: list[list[int]], joint_count: int, bus_count: int) -> np.ndarray:
    """Files of before have none, and their frames say themselves whose they are; or they do not say on which bus."""
    made = np.zeros(len(rows), layout.Identifiers.dtype)
    for number, row in enumerate(rows):
        made[number] = *row, *([0] * (len(layout.Identifiers.words) - len(row)))
    if np.any((made["joint"] < 0) | (made["joint"] >= joint_count)):
        raise ValueError("identifiers of no joint")
    if np.any((made["bus"] < 0) | (made["bus"] >= max(bus_count, 1))):
        raise ValueError("identifiers on no bus")
    return made


def _histogram_of(values: dict[str, Any]) -> np.ndarray:
    buckets = values.pop("buckets", {})
    made = _filled_one(layout.Histogram.dtype, values)
    for index, count in buckets.items():
        made["buckets"][int(index)] = count
    return made


def _frames_of(buses: Sequence[str], rows: list[dict[str, Any]]) -> np.ndarray:
    made = np.zeros(len(rows), layout.BusFrame.dtype)
    data = [bytes.fromhex(row["data"]) for row in rows]
    if (longest := max(map(len, data), default=0)) > 8:
        raise ValueError(f"a frame of {longest} bytes")
    made["monotonic_ns"] = [row["monotonic_ns"] for row in rows]
    made["head"] = [_head_of(buses, row, len(inside)) for row, inside in zip(rows, data, strict=True)]
    made["data"] = np.frombuffer(b"".join(inside.ljust(8, b"\0") for inside in data), "<i8")
    return made


def _head_of(buses: Sequence[str], row: dict[str, Any], length: int) -> int:
    """The word of a frame that has all but its data and time; files of before have no `remote`, one bus no name."""
    marks = (SENT if row["sent"] else 0) | (EXTENDED if row["extended"] else 0) | (REMOTE if row.get("remote") else 0)
    bus = buses.index(row["bus"]) if "bus" in row else 0
    return int(row["id"]) | length << LENGTH_SHIFT | marks | bus << BUS_SHIFT
