"""What a check has found, and the arithmetic of checks whatever the family: pure functions of recorded frames."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from config.joint import JointConfig
from shm.recording import IDENTIFIER_MASK, LENGTH_MASK, LENGTH_SHIFT, SENT

LATE_S = 2e-3
"""Beside its time on the wires: a USB adapter hands over once a millisecond, there and back."""
LEAST_ANSWERS = 10
LEAST_READINGS = 3
"""Of a motor that brakes, to tell how hard."""
RAMP_RANGE = (0.75, 1.33)
"""Measured ramp beside the one told, from readings that are up to a few milliseconds old."""


class Verdict(StrEnum):
    """How a check ended."""

    AS_DOCUMENTED = "as documented"
    DIFFERS = "differs"
    NOT_TRIED = "not tried"


@dataclass(frozen=True)
class Finding:
    """One check: what was asked, what the manual says, what came."""

    check: str
    asked: str
    documented: str
    came: str
    verdict: Verdict
    figures: dict[str, float] = field(default_factory=dict)
    """Name with its unit → measured value."""

    @property
    def good(self) -> bool | None:
        """Whether it is as documented; None where that was not tried."""
        return None if self.verdict == Verdict.NOT_TRIED else self.verdict == Verdict.AS_DOCUMENTED


@dataclass(frozen=True)
class Check:
    """One step of a bench test."""

    name: str
    explains: str
    """What it does, and what a person has to see to before."""
    question: str
    ask: Callable[..., list[Finding]]
    """Of the bench (and a joint's number, where it has several), and 1 or -1 for the way the motor turns."""
    moves: bool = False


def verdict_of(as_documented: bool) -> Verdict:
    """Of a check that was tried."""
    return Verdict.AS_DOCUMENTED if as_documented else Verdict.DIFFERS


def beyond_limits(joint: JointConfig, here_deg: float, there_deg: float) -> str:
    """Why a joint is not turned somewhere, a sentence."""
    return (
        f"{joint.name} stands at {here_deg:.1f}° and would turn to {there_deg:.1f}°, beyond its limits "
        f"{joint.lower_deg:g}° to {joint.upper_deg:g}°: turn it the other way (`o`)."
    )


class Said(NamedTuple):
    """A frame of the recording."""

    time_ns: int
    id: int
    data: bytes
    sent: bool
    """By the host, in the cycle of that time; else it has arrived then."""


def frames_of(recorded: np.ndarray) -> list[Said]:
    """Frames of dtype `shm.layout.BUS_FRAME`."""
    return [
        Said(
            int(row["monotonic_ns"]),
            int(row["head"]) & IDENTIFIER_MASK,
            int(row["data"]).to_bytes(8, "little", signed=True)[: int(row["head"]) >> LENGTH_SHIFT & LENGTH_MASK],
            bool(int(row["head"]) & SENT),
        )
        for row in recorded
    ]


def reply_delays_s(
    frames: Sequence[Said], is_question: Callable[[Said], bool], is_answer: Callable[[Said], bool]
) -> list[float]:
    """Time from each question that was answered to its answer; of one that was asked twice, from the second."""
    delays = []
    asked_ns: int | None = None
    for frame in frames:
        if frame.sent and is_question(frame):
            asked_ns = frame.time_ns
        elif not frame.sent and is_answer(frame) and asked_ns is not None:
            delays.append((frame.time_ns - asked_ns) * 1e-9)
            asked_ns = None
    return delays


def judge_reply_delay(delays_s: Sequence[float], wire_s: float, reckoned_s: float) -> Finding:
    """Beside `wire_s`, the time that question and answer take on the wires, and what rtarm reckons with."""
    asked = "its position, over and over"
    documented = (
        f"no figure; rtarm reckons with {reckoned_s * 1e3:.1f} ms beside {wire_s * 1e3:.2f} ms on the wires, and "
        f"bears {LATE_S * 1e3:.0f} ms more"
    )
    if len(delays_s) < LEAST_ANSWERS:
        return Finding("reply delay", asked, documented, f"{len(delays_s)} answers alone", Verdict.DIFFERS)
    median_s, worst_s = statistics.median(delays_s), max(delays_s)
    own_s = median_s - wire_s
    return Finding(
        "reply delay",
        asked,
        documented,
        f"after {median_s * 1e3:.2f} ms (median of {len(delays_s)}), {worst_s * 1e3:.2f} ms at the most; beside the "
        f"wires {own_s * 1e3:.2f} ms",
        verdict_of(own_s <= reckoned_s + LATE_S),
        {"median_ms": median_s * 1e3, "worst_ms": worst_s * 1e3, "wires_ms": wire_s * 1e3, "answers": len(delays_s)},
    )


Samples = NDArray[np.float64]
"""Rows of time (s) and place (revolutions), both counted from the beginning of a move, the way of the move positive."""


def braking_rev_s2(samples: Samples, way_rev: float, told_rev_s2: float, speed_rev_s: float) -> float | None:
    """How hard a motor braked at the end of a move of `way_rev`; None for too few readings.

    Of the last half of the way in which it should brake: with a constant ramp a the rest of the way is a/2 t² before
    its end, so the root of the rest falls along a line.
    """
    rest = way_rev - samples[:, 1]
    brakes = (rest > 1e-4) & (rest <= speed_rev_s**2 / (4.0 * told_rev_s2))
    if np.count_nonzero(brakes) < LEAST_READINGS:
        return None
    slope = float(np.polyfit(samples[brakes, 0], np.sqrt(rest[brakes]), 1)[0])
    return 2.0 * slope * slope


def speeds_rev_s(samples: Samples) -> Samples:
    """Rows of time (s) and mean speed (rev/s) between neighbouring readings."""
    times, places = samples[:, 0], samples[:, 1]
    return np.column_stack(((times[1:] + times[:-1]) / 2.0, np.diff(places) / np.diff(times)))
