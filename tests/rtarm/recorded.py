"""A recording of an arm that no control process leads: everything that a file of it has, without a motion."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from written_arm import JOINTS, PERIOD_NS

from rtarm.recording import mcap_writer
from rtarm.recording.mcap_format import Loaded, Reason
from shm import layout
from shm.files import Bus
from shm.recording import Recording, record_dtype
from shm.words import Event, Fault, Mode

START_NS = 1_000_000_000
REASON = Reason("fault", "A wire was pulled.")
ONE_BUS = (Bus("", 500_000),)
TWO_BUSES = (Bus("upper", 500_000), Bus("lower", 1_000_000))


def loaded(buses: tuple[Bus, ...] = ONE_BUS) -> Loaded:
    """Three cycles, in the last of which a fault is latched."""
    records = np.zeros(3, record_dtype(len(JOINTS)))
    records["number"] = records["cycle"] = np.arange(1, 4)
    records["monotonic_ns"] = START_NS + PERIOD_NS * np.arange(3)
    records["mode"] = Mode.HOLDING, Mode.HOLDING, Mode.FAULT
    records["fault"][2], records["fault_ns"][2] = Fault.WIRE, records["monotonic_ns"][2]
    events = np.zeros(1, layout.Event.dtype)
    events["kind"], events["code"], events["monotonic_ns"] = Event.FAULT, Fault.WIRE, records["monotonic_ns"][2]
    recording = Recording(
        arm="recorded",
        joints=JOINTS,
        arm_hash=7,
        pid=1,
        period_ns=PERIOD_NS,
        buses=buses,
        records=records,
        frames=np.zeros(0, layout.BusFrame.dtype),
        events=events,
        limits=np.zeros((), layout.Limits.dtype),
        identifiers=np.zeros(0, layout.Identifiers.dtype),
        scheduling=np.zeros((), layout.Scheduling.dtype),
        lateness=np.zeros((), layout.Histogram.dtype),
        cycle_time=np.zeros((), layout.Histogram.dtype),
    )
    return Loaded(recording, REASON, "")


@contextmanager
def a_recording(buses: tuple[Bus, ...] = ONE_BUS) -> Iterator[Path]:
    """The same as a file, for a while."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "recorded.mcap")
        mcap_writer.write(loaded(buses).recording, REASON, path)
        yield path
