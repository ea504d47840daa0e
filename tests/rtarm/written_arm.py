"""Memory files of an arm that no control process writes: a test says what stands in them."""

from __future__ import annotations

import os
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from shm import files, layout
from shm.record import offset_of
from shm.words import Mode, Request

JOINTS = ("shoulder", "elbow")
PERIOD_NS = 10_000_000


class WrittenArm:
    """Both files of a two-joint arm, held as its control process would; `publish` shows a snapshot."""

    def __init__(self, name: str, buses: tuple[files.Bus, ...] = (files.Bus("", 500_000),)) -> None:
        self.name = name
        identity = files.Identity(name, JOINTS, arm_hash=7, period_ns=PERIOD_NS, buses=buses)
        self.files = files.create(identity)
        self.state = self.files.state.record
        self.command = self.files.command.record
        self.snapshot = np.zeros(1, layout.Snapshot.dtype)[0]
        self.snapshot["mode"] = Mode.HOLDING
        self.snapshot["speed_scale"] = 1.0
        self.rows = self.snapshot["joints"][: len(JOINTS)]
        self.rows["referenced"] = 1
        for word in ("measured_effort", "drive_temperature_c", "drive_voltage_v"):
            self.rows[word] = np.nan
        self.state["counters"]["cycles"] = 1234
        self.state["scheduling"]["cpu"] = -1
        self.state["scheduling"]["thread_id"] = os.getpid()
        self.publish()

    def publish(self, read: bool = True) -> None:
        """Another cycle: the snapshot with check sum and time, joints read a moment before or never."""
        now_ns = time.monotonic_ns()
        self.snapshot["cycle"] += 1
        self.snapshot["monotonic_ns"] = now_ns
        self.rows["measured_ns"] = now_ns - 1_000_000 if read else 0
        used = layout.used_bytes(layout.Snapshot, len(JOINTS))
        body = self.snapshot.tobytes()[8:used]
        at = offset_of(layout.StateFile, "snapshot")
        self.state["snapshot_sequence"][0] += 1
        target = self.files.state.array.view(np.uint8)
        target[at : at + used] = np.frombuffer(zlib.crc32(body).to_bytes(8, "little") + body, np.uint8)
        self.state["snapshot_sequence"][0] += 1

    @contextmanager
    def served(self) -> Iterator[None]:
        """With a living front."""
        front = files.own_command(self.name, 7)
        front.record["heartbeat_ns"][0] = time.monotonic_ns()
        try:
            yield
        finally:
            front.close()

    @contextmanager
    def answering(self, obey: Callable[[WrittenArm, int], int]) -> Iterator[None]:
        """With a thread that answers requests with what `obey(arm, kind)` returns, and publishes.

        It hears of stops, holds and resumes too, which are answered by what the snapshot shows.
        """
        ended = threading.Event()

        def live() -> None:
            taken = 0
            heard = dict.fromkeys(("stop_ns", "hold_ns", "resume_ns"), 0)
            while not ended.wait(0.001):
                for name, kind in zip(heard, (Request.STOP, Request.HOLD, Request.RESUME), strict=True):
                    before, heard[name] = heard[name], int(self.command[name][0])
                    if heard[name] != before:
                        self.snapshot["stops"] += kind == Request.STOP
                        self.snapshot["held"] = kind != Request.RESUME
                        obey(self, kind)
                while taken < int(self.command["requests_written"][0]):
                    request = self.command["requests"][taken % layout.REQUEST_SLOTS]
                    taken += 1
                    answer = obey(self, int(request["kind"]))
                    slot = self.snapshot["answers"][taken % layout.ANSWER_SLOTS]
                    slot["sequence"], slot["answer"] = taken, answer
                self.state["consumed"]["requests"] = taken
                self.publish()

        thread = threading.Thread(target=live)
        self.publish()  # what a test has set before: whoever looks first must see it
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
