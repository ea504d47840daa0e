"""The first difference of two transcripts, in words.

On the processor and with the libraries of the recording everything is exact. Elsewhere floats may round differently, so
those within `TOLERANCE` pass; and since what follows from a float (a pulse, a decision, a cycle more or less) may then
differ too, what differs after such a float is UNSURE and no failure. What differs before any float does, is one.
"""

import platform
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import version

import llvmlite.binding as llvm
import numpy as np
from wires import WIRES

from sim.bus import Frame
from transcripts.tape import Entry, Transcript
from transcripts.words import LATER, meaning

TOLERANCE = 1e-9
"""Share of a float (or of 1, for smaller ones) by which it may differ elsewhere than where it was recorded."""
LIBRARIES = ("numpy", "numba", "llvmlite")


class Verdict(Enum):
    """What a comparison comes to."""

    SAME = "same"
    DIFFERS = "differs"
    UNSURE = "unsure"


@dataclass(frozen=True)
class Finding:
    """The verdict on a scenario, and the sentence that says why."""

    scenario: str
    verdict: Verdict
    sentence: str = ""


@dataclass(frozen=True)
class _Difference:
    cycle: int
    sentence: str


def this_place() -> dict[str, str]:
    """What decides how floats are rounded, and which random numbers a seed makes."""
    place = {
        "processor": f"{platform.machine()} {llvm.get_host_cpu_name()}",
        "C library": " ".join(platform.libc_ver()),
        "Python": platform.python_version().rpartition(".")[0],
    }
    return place | {name: version(name) for name in LIBRARIES}


def compare(scenario: str, was: Transcript, now: Transcript, *, exact: bool = False) -> Finding:
    """Hold what a scenario shows now, with every word of every cycle, against its recording.

    With `exact` no float may differ, wherever the recording was made.
    """
    if not now.sent:
        return Finding(scenario, Verdict.DIFFERS, f"{scenario} broke off before its first cycle: {now.broke_off}")
    elsewhere = "; ".join(
        f"{name} {was.place.get(name, 'unknown')}, here {value}"
        for name, value in now.place.items()
        if was.place.get(name) != value
    )
    tolerance = TOLERANCE if elsewhere and not exact else 0.0
    differences, rounded = _word_differences(was, now, tolerance)
    differences += _told_difference(was.told, now.told, tolerance)
    differences += _sent_difference(was.sent, now.sent)
    differences += _end_difference(was, now)
    if not differences:
        return Finding(scenario, Verdict.SAME)
    first = min(differences, key=lambda difference: difference.cycle)
    also = sum(difference.cycle == first.cycle for difference in differences) - 1
    sentence = f"{scenario}, {_when(first.cycle, was, now)}: {first.sentence}"
    if also:
        sentence += f" ({also} more in this cycle)"
    if rounded is not None and rounded.cycle <= first.cycle and not now.broke_off:
        return Finding(
            scenario,
            Verdict.UNSURE,
            f"{sentence}; it may come of rounding, since {_when(rounded.cycle, was, now)} {rounded.sentence}, and the "
            f"recording was made elsewhere ({elsewhere})",
        )
    return Finding(scenario, Verdict.DIFFERS, sentence)


def _when(cycle: int, was: Transcript, now: Transcript) -> str:
    times_ns = max((was.words["monotonic_ns"], now.words["monotonic_ns"]), key=len)
    after_s = (times_ns[min(cycle, len(times_ns) - 1)] - times_ns[0]) * 1e-9
    return f"cycle {cycle} ({after_s:.3f} s)"


# --- words -----------------------------------------------------------------------------------------------------


def _word_differences(
    was: Transcript, now: Transcript, tolerance: float
) -> tuple[list[_Difference], _Difference | None]:
    """The first difference of each word, and the first float that only rounding tells apart."""
    found, rounded = [], []
    lacking = {name: np.zeros(len(was.sent), np.int64) for name in LATER & now.words.keys()}
    recorded = lacking | was.words
    found += [_Difference(0, f"{_spelled(name)} is new") for name in sorted(now.words.keys() - recorded.keys())]
    every = np.arange(len(was.sent))
    for name, values in recorded.items():
        cycles = every if len(values) == len(every) else was.kept
        cycles = cycles[cycles < len(now.sent)]
        if name not in now.words:
            found.append(_Difference(0, f"there is no {_spelled(name)} any more"))
            continue
        old, new = values[: len(cycles)], now.words[name][cycles]
        if old.dtype != new.dtype:
            found.append(_Difference(0, f"{_spelled(name)} was of type {old.dtype}, is {new.dtype}"))
            continue
        differs = old.view(np.int64) != new.view(np.int64)
        if tolerance and old.dtype.kind == "f":
            near = differs & np.isclose(new, old, tolerance, tolerance, equal_nan=True)
            rounded += [_Difference(int(cycles[i]), _changed(name, old[i], new[i])) for i in np.flatnonzero(near)[:1]]
            differs &= ~near
        for i in np.flatnonzero(differs)[:1]:
            found.append(_Difference(int(cycles[i]), _changed(name, old[i], new[i]) + _since(cycles, i)))
    return found, min(rounded, key=lambda difference: difference.cycle, default=None)


def _changed(name: str, old: np.generic, new: np.generic) -> str:
    return f"{_spelled(name)} was {meaning(name, old.item())}, is {meaning(name, new.item())}"


def _since(cycles: np.ndarray, i: int) -> str:
    """Since when at the earliest a word may differ that is not kept in every cycle."""
    before = int(cycles[i - 1]) if i else int(cycles[i]) - 1
    return f" (it was last kept in cycle {before}, and the same there)" if cycles[i] - before > 1 else ""


def _spelled(name: str) -> str:
    owner, _, word = name.rpartition(".")
    return f"{owner}'s {word}" if owner else word


# --- what was told ---------------------------------------------------------------------------------------------


def _told_difference(was: list[Entry], now: list[Entry], tolerance: float) -> list[_Difference]:
    """The first event, result or answer that is another one, is gone, or is new."""
    for old, new in zip(was, now, strict=False):
        if old[:2] == new[:2]:
            before = dict.fromkeys(LATER & new[2].keys(), 0) | old[2]
            changed = [name for name in before if not _equal(before[name], new[2][name], tolerance)]
            if changed:
                shown = ", ".join(
                    f"{name} was {meaning(name, before[name], before)}, is {meaning(name, new[2][name], new[2])}"
                    for name in changed
                )
                return [_Difference(old[0], f"of the {_entry(old)} {shown}")]
        elif old[0] <= new[0]:
            return [_Difference(old[0], f"the {_entry(old)} is missing")]
        else:
            return [_Difference(new[0], f"the {_entry(new)} is new")]
    return [
        *[_Difference(entry[0], f"the {_entry(entry)} is missing") for entry in was[len(now) :][:1]],
        *[_Difference(entry[0], f"the {_entry(entry)} is new") for entry in now[len(was) :][:1]],
    ]


def _equal(old: float, new: float, tolerance: float) -> bool:
    if tolerance and isinstance(old, float) and np.isclose(new, old, tolerance, tolerance, equal_nan=True):
        return True
    return repr(old) == repr(new)


def _entry(entry: Entry) -> str:
    _, table, row = entry
    return f"{table} {{{', '.join(f'{name}: {meaning(name, value, row)}' for name, value in row.items())}}}"


# --- what was transmitted --------------------------------------------------------------------------------------


def _sent_difference(was: list[bytes], now: list[bytes]) -> list[_Difference]:
    for cycle, (old, new) in enumerate(zip(was, now, strict=False)):
        if old != new:
            return [_Difference(cycle, _bytes_sentence(old, new))]
    return []


def _bytes_sentence(old: bytes, new: bytes) -> str:
    before, after = _frames(old), _frames(new)
    if before is None or after is None:
        at = next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new)))
        return f"the bytes sent from byte {at} on were {old[at : at + 24].hex(' ')}, are {new[at : at + 24].hex(' ')}"
    order = "the frames are sent in another order: " if sorted(before) == sorted(after) else ""
    for number, (one, other) in enumerate(zip(before, after, strict=False), 1):
        if one != other:
            same = one.can_id == other.can_id
            where = f"frame {number}, to 0x{one.can_id:x}," if same else f"frame {number}"
            return f"{order}{where} was {_frame(one, same)}, is {_frame(other, same)}"
    longer, word = (before, "missing") if len(before) > len(after) else (after, "new")
    return f"frame {min(len(before), len(after)) + 1}, {_frame(longer[min(len(before), len(after))])}, is {word}"


def _frames(data: bytes) -> list[Frame] | None:
    """The frames in what was sent, as the first wire reads them that can; None where none can."""
    for wire in WIRES:
        try:
            return wire.read(data)
        except Exception:  # that wire's reader finds no frame here
            continue
    return None


def _frame(frame: Frame, bare: bool = False) -> str:
    content = frame.data.hex(" ") or "empty"
    return content if bare else f"0x{frame.can_id:x}: {content}"


# --- the end ---------------------------------------------------------------------------------------------------


def _end_difference(was: Transcript, now: Transcript) -> list[_Difference]:
    end = min(len(was.sent), len(now.sent))
    if now.broke_off:
        return [_Difference(len(now.sent), f"the scenario broke off: {now.broke_off}")]
    if len(was.sent) != len(now.sent):
        return [_Difference(end, f"the scenario took {len(was.sent)} cycles, takes {len(now.sent)}")]
    return []
