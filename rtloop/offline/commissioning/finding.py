"""Results of checks, and the arithmetic of checks for all families: pure functions of recorded frames."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from config.joint import JointConfig
from shm.recording import BUS_MASK, BUS_SHIFT, IDENTIFIER_MASK, LENGTH_MASK, LENGTH_SHIFT, SENT

LATE_S = 2e-3
"""Allowed delay besides the time on the wires: a USB adapter transfers once a millisecond, in each direction."""
LEAST_ANSWERS = 10
LEAST_READINGS = 3
"""Readings of a braking motor that it takes to compute its deceleration."""
RAMP_RANGE = (0.75, 1.33)
"""Allowed ratio of the measured ramp to the commanded one; readings are up to a few milliseconds old."""


class Verdict(StrEnum):
    """Result of a check."""

    AS_DOCUMENTED = "as documented"
    DIFFERS = "differs"
    NOT_TRIED = "not tried"


@dataclass(frozen=True)
class Finding:
    """One check: what was asked of the drive, what the manual says, what the drive did."""

    check: str
    asked: str
    documented: str
    came: str
    verdict: Verdict
    figures: dict[str, float] = field(default_factory=dict)
    """Measured values by their names, which end in the unit."""

    @property
    def good(self) -> bool | None:
        """Whether the drive is as documented; None if that was not tried."""
        return None if self.verdict == Verdict.NOT_TRIED else self.verdict == Verdict.AS_DOCUMENTED


@dataclass(frozen=True)
class Check:
    """One step of a bench test."""

    name: str
    explains: str
    """What the check does, and what the operator must take care of before."""
    question: str
    ask: Callable[..., list[Finding]]
    """A function of the bench, a joint's number, and 1 or -1 for the direction in which the motor turns."""
    moves: bool = False


def verdict_of(as_documented: bool) -> Verdict:
    """The verdict of a check that was carried out."""
    return Verdict.AS_DOCUMENTED if as_documented else Verdict.DIFFERS


def beyond_limits(joint: JointConfig, here_deg: float, there_deg: float) -> str:
    """The sentence that says why a joint is not turned to an angle beyond its limits."""
    return (
        f"{joint.name} stands at {here_deg:.1f}° and would turn to {there_deg:.1f}°, beyond its limits "
        f"{joint.lower_deg:g}° to {joint.upper_deg:g}°: turn it the other way (`o`)."
    )


class Said(NamedTuple):
    """A recorded frame."""

    time_ns: int
    id: int
    data: bytes
    sent: bool
    """True: the host sent it in the cycle of `time_ns`; False: it arrived at `time_ns`."""
    bus: int
    """Number of the bus it was on."""


def frames_of(recorded: np.ndarray) -> list[Said]:
    """Decode recorded frames (`shm.layout.BusFrame`)."""
    return [
        Said(
            int(row["monotonic_ns"]),
            int(row["head"]) & IDENTIFIER_MASK,
            int(row["data"]).to_bytes(8, "little", signed=True)[: int(row["head"]) >> LENGTH_SHIFT & LENGTH_MASK],
            bool(int(row["head"]) & SENT),
            int(row["head"]) >> BUS_SHIFT & BUS_MASK,
        )
        for row in recorded
    ]


def reply_delays_s(
    frames: Sequence[Said], is_question: Callable[[Said], bool], is_answer: Callable[[Said], bool]
) -> list[float]:
    """Time (s) from each answered question to its answer; if it was asked twice, from the second time."""
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
    """Compare delays with `wire_s`, the time of question and answer on the wires, plus rtarm's figure `reckoned_s`."""
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
"""Rows of time (s) and position (revolutions), both from the beginning of a move, positive in its direction."""


def braking_rev_s2(samples: Samples, way_rev: float, told_rev_s2: float, speed_rev_s: float) -> float | None:
    """Deceleration (rev/s²) of a motor at the end of a move of `way_rev`; None if there are too few readings.

    It is fitted to the last half of the expected braking distance. With a constant deceleration a, the remaining
    distance at a time t before the end is a/2 t², so its square root falls along a line.
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
