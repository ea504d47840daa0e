"""A transcript in a small file, every bit of it: what is kept of a word is how far it lies off what was to be expected.

Setpoints are polynomials of time, so most of a float is known from the ones before it; measured velocities are known
from the positions and times beside them. What remains goes byte by byte, the highest first, into one LZMA stream.
"""

import json
import lzma
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from transcripts.tape import Transcript

FOLDER = Path(__file__).parent / "data"
SUFFIX = ".transcript"
FORMAT = 1
FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "lc": 0, "lp": 0, "pb": 0}]
EXTRAPOLATIONS: tuple[tuple[int, ...], ...] = (
    *((), (1,), (2, -1), (3, -3, 1), (4, -6, 4, -1), (5, -10, 10, -5, 1)),
    (6, -15, 20, -15, 6, -1),
)
"""Weights of the values before, the last one first, of a polynomial of order 0 … 5; none: every value is new."""
SLOPES = {
    "measured_velocity_rad_s": "measured_position_rad",
    "reference_velocity_rad_s": "reference_position_rad",
}
"""Words that often are how fast another one changed between two readings."""
Words = dict[str, np.ndarray]


def write(path: Path, transcript: Transcript) -> None:
    """Write a transcript; raises ValueError for one that broke off."""
    if transcript.broke_off:
        raise ValueError(f"{path.stem} broke off after {len(transcript.sent)} cycles: {transcript.broke_off}")
    path.write_bytes(lzma.compress(_packed(transcript), lzma.FORMAT_XZ, filters=FILTERS))


def read(path: Path) -> Transcript:
    """Read a transcript; raises ValueError for one of another format."""
    return _unpacked(lzma.decompress(path.read_bytes()))


def _packed(transcript: Transcript) -> bytes:
    words = {**transcript.words, "(kept)": transcript.kept, "(sent)": np.array([len(data) for data in transcript.sent])}
    columns, residues = [], []
    for name, values in words.items():
        how, residue = _best(name, values, words, transcript.joints)
        columns.append([name, values.dtype.str, len(values), how])
        residues.append(residue)
    head = {
        "format": FORMAT,
        "place": transcript.place,
        "joints": transcript.joints,
        "columns": columns,
        "told": [[cycle, table, _plain(row)] for cycle, table, row in transcript.told],
    }
    planes = b"".join(residue.astype(">u8").view(np.uint8).reshape(-1, 8).T.tobytes() for residue in residues)
    return json.dumps(head).encode() + b"\n" + planes + _interwoven(transcript.sent)


def _unpacked(data: bytes) -> Transcript:
    line, _, rest = data.partition(b"\n")
    head = json.loads(line)
    if head["format"] != FORMAT:
        raise ValueError(f"This transcript has format {head['format']}, not {FORMAT}: record it anew.")
    off, alike, at = {}, defaultdict(list), 0
    for name, kind, count, how in head["columns"]:
        planes = np.frombuffer(rest, np.uint8, 8 * count, at).reshape(8, count)
        off[name] = _unfolded(np.ascontiguousarray(planes.T).view(">u8").reshape(-1).astype(np.uint64))
        alike[how if isinstance(how, str) else (how, kind, count)].append(name)
        at += 8 * count
    words: Words = {}
    for how in sorted(alike, key=_turn):
        names = alike[how]
        if isinstance(how, tuple):
            rows = _continued(np.array([off[name] for name in names]), how[0], np.dtype(how[1]))
            words |= zip(names, rows, strict=True)
            continue
        for name in names:
            words[name] = _restored(name, off[name], how, words, head["joints"])
    words = {name: words[name] for name, *_ in head["columns"]}
    kept, lengths = words.pop("(kept)"), words.pop("(sent)")
    sent = _unwoven(rest[at:], lengths)
    told = [(cycle, table, _numbers(row)) for cycle, table, row in head["told"]]
    return Transcript(head["joints"], words, kept, sent, told, head["place"])


def _interwoven(sent: list[bytes]) -> bytes:
    """Of what has the same length, the first byte of each cycle, then the second of each: they differ least."""
    blocks = []
    for length in sorted({len(data) for data in sent}):
        alike = b"".join(data for data in sent if len(data) == length)
        blocks.append(np.frombuffer(alike, np.uint8).reshape(-1, length).T.tobytes() if length else b"")
    return b"".join(blocks)


def _unwoven(blocks: bytes, lengths: np.ndarray) -> list[bytes]:
    sent, at = [b""] * len(lengths), 0
    for length in np.unique(lengths[lengths > 0]):
        alike = np.flatnonzero(lengths == length)
        rows = np.frombuffer(blocks, np.uint8, len(alike) * length, at).reshape(length, -1).T
        for cycle, row in zip(alike, rows, strict=True):
            sent[cycle] = row.tobytes()
        at += len(alike) * int(length)
    return sent


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN and no infinity, and floats are kept to the last bit."""
    return {name: value.hex() if isinstance(value, float) else value for name, value in row.items()}


def _numbers(row: dict[str, Any]) -> dict[str, Any]:
    return {name: float.fromhex(value) if isinstance(value, str) else value for name, value in row.items()}


# --- what is to be expected of a word --------------------------------------------------------------------------


def _turn(how: Any) -> int:
    """Words that are known from others are restored after those."""
    return ("neighbour", "between", "slope").index(how) + 1 if isinstance(how, str) else 0


def _best(name: str, values: np.ndarray, words: Words, joints: list[str]) -> tuple[int | str, np.ndarray]:
    """How a word is best foretold, and what remains."""
    candidates: list[int | str] = [*range(len(EXTRAPOLATIONS) if values.dtype.kind == "f" else 3)]
    candidates += [how for how in ("between", "slope") if _source(name, how) in words]
    found = {how: _folded(_ordered(values) - _ordered(_expected(name, values, how, words))) for how in candidates}
    if beside := _neighbour(name, joints):
        found["neighbour"] = _folded(np.diff(values - words[beside], prepend=0))
    how = min(found, key=lambda how: np.log2(found[how] + 1.0).sum())
    return how, found[how]


def _restored(name: str, off: np.ndarray, how: str, words: Words, joints: list[str]) -> np.ndarray:
    """A word that is known from others, by how far it is off that."""
    if how == "neighbour":
        return words[_neighbour(name, joints)] + np.cumsum(off)
    return _from_ordered(_ordered(_expected(name, np.zeros(len(off)), how, words)) + off, np.dtype(float))


def _continued(off: np.ndarray, order: int, kind: np.dtype) -> np.ndarray:
    """Words (words, n) that go on as an extrapolation of an order says, by how far they are off it."""
    if kind.kind == "i":
        for i in reversed(range(order)):
            off[:, i:] = np.cumsum(off[:, i:], axis=1)
        return off
    if order == 0:
        return _from_ordered(off, kind)
    values, past = np.zeros(off.shape), np.zeros(off.shape)
    for i in range(off.shape[1]):
        expected = _ordered(_finite(_extrapolated(past, order, i, i + 1)))
        values[:, i : i + 1] = _from_ordered(expected + off[:, i : i + 1], kind)
        past[:, i : i + 1] = _finite(values[:, i : i + 1])
    return values


def _expected(name: str, values: np.ndarray, how: int | str, words: Words) -> np.ndarray:
    with np.errstate(all="ignore"):
        if how == "between":
            return _finite(_between(name.partition(".")[0], words))
        if how == "slope":
            return _finite(_slope(words[_source(name, "slope")], words[_beside(name, "measured_ns")]))
        assert isinstance(how, int)
        return _finite(_extrapolated(_finite(values), how, 0, len(values)))


def _extrapolated(values: np.ndarray, order: int, first: int, end: int) -> np.ndarray:
    """What values[..., first:end] should be by those before them; at the beginning the one before."""
    found = np.zeros((*values.shape[:-1], end - first), values.dtype)
    weights = EXTRAPOLATIONS[order]
    if order > 0:
        for i in range(max(first, 1), min(end, len(weights))):
            found[..., i - first] = values[..., i - 1]
    begin = max(first, len(weights))
    if begin < end:
        with np.errstate(all="ignore"):
            for back, weight in enumerate(weights, 1):
                found[..., begin - first :] += weight * values[..., begin - back : end - back]
    return found


def _source(name: str, how: str) -> str:
    """The word from which another one is known; "" where there is none."""
    last = name.rpartition(".")[2]
    if how == "between":
        return _beside(name, "commanded_position_rad") if last == "reference_position_rad" else ""
    return _beside(name, SLOPES[last]) if last in SLOPES else ""


def _neighbour(name: str, joints: list[str]) -> str:
    """The time at which the joint before was read; "" where there is none. All are read one after the other."""
    joint, _, word = name.rpartition(".")
    before = joints.index(joint) - 1 if joint in joints and word == "measured_ns" else -1
    return f"{joints[before]}.{word}" if before >= 0 else ""


def _beside(name: str, word: str) -> str:
    """Another word of the same joint."""
    return f"{name.partition('.')[0]}.{word}"


def _between(joint: str, words: Words) -> np.ndarray:
    """Where a joint was commanded to be when its encoder was read, between two cycles."""
    position, read_ns = words[f"{joint}.commanded_position_rad"], words[f"{joint}.measured_ns"]
    times_ns = words["monotonic_ns"][words["(kept)"]]
    if len(times_ns) < 2 or np.any(np.diff(times_ns) <= 0):
        return np.zeros(len(position))
    at = np.clip(np.searchsorted(times_ns, read_ns, side="right") - 1, 0, len(times_ns) - 2)
    share = (read_ns - times_ns[at]) / (times_ns[at + 1] - times_ns[at])
    return position[at] + share * (position[at + 1] - position[at])


def _slope(position: np.ndarray, read_ns: np.ndarray) -> np.ndarray:
    """Change between two readings; where there is no new reading, that between the two before."""
    found = np.zeros(len(position))
    found[1:] = np.diff(position) / (np.diff(read_ns) * 1e-9)
    newest = np.maximum.accumulate(np.where(np.diff(read_ns, prepend=read_ns[:1]) != 0, np.arange(len(found)), 0))
    return found[newest]


# --- floats as whole numbers that rise with them ----------------------------------------------------------------


def _finite(values: np.ndarray) -> np.ndarray:
    return values if values.dtype.kind == "i" else np.where(np.isfinite(values), values, 0.0)


def _ordered(values: np.ndarray) -> np.ndarray:
    """(n,) int64; neighbouring floats are neighbouring numbers."""
    bits = np.ascontiguousarray(values).view(np.int64)
    return bits if values.dtype.kind == "i" else bits ^ ((bits >> 63) & np.int64(2**63 - 1))


def _from_ordered(numbers: np.ndarray, kind: np.dtype) -> np.ndarray:
    return numbers if kind.kind == "i" else (numbers ^ ((numbers >> 63) & np.int64(2**63 - 1))).view(np.float64)


def _unfolded(residue: np.ndarray) -> np.ndarray:
    return (residue >> np.uint64(1)).view(np.int64) ^ -(residue & np.uint64(1)).view(np.int64)


def _folded(off: np.ndarray) -> np.ndarray:
    """Small numbers of either sign as small ones without, (n,) uint64."""
    return ((off << 1) ^ (off >> 63)).view(np.uint64)
