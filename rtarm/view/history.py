"""The last seconds as the plots draw them: one column for each tenth of a second, in which nothing late is lost."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from rtarm.recording.story import UNLED

COLUMN_NS = 100_000_000
COLUMNS = 300
"""Half a minute."""


class Column(NamedTuple):
    """A tenth of a second: the last angles in it (rad), and the worst error (rad) and lateness (s)."""

    number: int
    commanded_rad: np.ndarray
    measured_rad: np.ndarray
    error_rad: np.ndarray
    lateness_s: float


class Curves(NamedTuple):
    """What is drawn: seconds before now (n), angles and errors (n, joints) in degrees, lateness (n) in µs."""

    times_s: np.ndarray
    commanded_deg: np.ndarray
    measured_deg: np.ndarray
    error_deg: np.ndarray
    lateness_us: np.ndarray


class History:
    """The newest `COLUMNS` columns, made of cycles as they come."""

    def __init__(self, joint_count: int) -> None:
        self._joint_count = joint_count
        self._columns: deque[Column] = deque(maxlen=COLUMNS)

    def add(self, records: np.ndarray) -> None:
        """Take further cycles (dtype `shm.recording.record_dtype`), oldest first."""
        if len(records) == 0:
            return
        numbers = records["monotonic_ns"] // COLUMN_NS
        for part in np.split(records, np.flatnonzero(np.diff(numbers)) + 1):
            column = column_of(part)
            if self._columns and self._columns[-1].number > column.number:  # a replay that began anew
                self._columns.clear()
            if self._columns and self._columns[-1].number == column.number:
                column = joined(self._columns.pop(), column)
            self._columns.append(column)

    def curves(self) -> Curves:
        """What there is of the last seconds; a gap in time stays one."""
        columns, none = list(self._columns), np.zeros((0, self._joint_count))
        numbers = np.array([column.number for column in columns], dtype=np.int64)
        newest = numbers[-1] if len(numbers) else 0

        def degrees(rows: list[np.ndarray]) -> np.ndarray:
            return np.degrees(np.stack(rows)) if rows else none

        return Curves(
            times_s=(numbers - newest) * COLUMN_NS * 1e-9,
            commanded_deg=degrees([column.commanded_rad for column in columns]),
            measured_deg=degrees([column.measured_rad for column in columns]),
            error_deg=degrees([column.error_rad for column in columns]),
            lateness_us=np.array([column.lateness_s for column in columns]) * 1e6,
        )


def column_of(records: np.ndarray) -> Column:
    """Some cycles of one tenth of a second."""
    joints = records["joints"]
    read = joints["measured_ns"] != 0
    led = ~np.isin(records["mode"], UNLED)
    errors = np.where(read & led[:, None], joints["measured_position_rad"] - joints["reference_position_rad"], 0.0)
    worst = np.abs(np.nan_to_num(errors)).argmax(axis=0)
    last = joints[-1]
    return Column(
        int(records[-1]["monotonic_ns"] // COLUMN_NS),
        last["commanded_position_rad"],
        np.where(read[-1], last["measured_position_rad"], np.nan),
        np.take_along_axis(errors, worst[None], axis=0)[0],
        max(0.0, float(records["lateness_ns"].max()) * 1e-9),
    )


def joined(one: Column, later: Column) -> Column:
    """Two parts of one column."""
    worse = np.abs(np.nan_to_num(one.error_rad)) > np.abs(np.nan_to_num(later.error_rad))
    return later._replace(
        error_rad=np.where(worse, one.error_rad, later.error_rad), lateness_s=max(one.lateness_s, later.lateness_s)
    )
