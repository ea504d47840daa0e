"""Hands frames to one simulated drive and takes what it says, in virtual time and without a bus."""

from __future__ import annotations

from typing import Self

import numpy as np

from sim.bus import Frame
from sim.drives.drive import Drive

MILLISECOND = 1_000_000


def frame(text: str) -> Frame:
    """A frame as written in the facts: `027# 08 00` (standard, three digits), `0300AA01# 00`, or `049# remote`."""
    ident, _, data = text.partition("#")
    remote = data.strip() == "remote"
    return Frame(int(ident, 16), b"" if remote else bytes.fromhex(data), len(ident) > 3, remote)


def text(said: Frame) -> str:
    """The same the other way round."""
    ident = f"{said.can_id:08X}" if said.extended else f"{said.can_id:03X}"
    return f"{ident}# " + ("remote" if said.remote else said.data.hex(" ").upper())


class DriveBench:
    """A drive on a table, whose frames come and go at once."""

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        self.now_ns = 0

    def tell(self, *texts: str | Frame) -> Self:
        """Send frames."""
        for item in texts:
            self.drive.receive(self.now_ns, frame(item) if isinstance(item, str) else item)
        return self

    def heard(self) -> list[str]:
        """What it has said since."""
        texts = [text(said) for _, said in self.drive.outbox]
        self.drive.outbox.clear()
        return texts

    def ask(self, item: str | Frame) -> list[str]:
        """Send a frame and return what the drive says to it."""
        self.heard()
        self.tell(item)
        return self.heard()

    def wait(self, milliseconds: float) -> list[str]:
        """Let time pass, waking the drive when it wants to be; what it has said until its end."""
        end_ns = self.now_ns + round(milliseconds * MILLISECOND)
        texts = []
        while self.drive.wake_ns <= end_ns:
            self.now_ns = max(self.now_ns, self.drive.wake_ns)
            self.drive.wake(self.now_ns)
            texts += self.heard()
        self.now_ns = end_ns
        self.drive.advance(end_ns)
        return texts + self.heard()

    def after(self, milliseconds: float) -> Self:
        """The same a while later."""
        self.wait(milliseconds)
        return self

    def restart(self, off_ms: float = 0.0) -> Self:
        """Take its power, and give it again."""
        self.drive.power_off(self.now_ns)
        self.wait(off_ms)
        self.drive.power_on(self.now_ns)
        return self

    @property
    def turns(self) -> float:
        """Where its shaft truly is [rev]."""
        return self.drive.shaft.past(self.now_ns)[0]

    @property
    def turns_s(self) -> float:
        """How fast it truly is [rev/s]."""
        return self.drive.shaft.past(self.now_ns)[1] / 60.0

    def motion(self, since_ns: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Its true positions [rev] and speeds [rev/s] since a time, every quarter of a millisecond.

        Raises:
            AssertionError: a position is no number, or not the one that the speeds lead to.
        """
        changes_ns = np.unique(np.append(self.drive.shaft.changes_ns(), self.now_ns))
        positions, rpm = self.drive.shaft.history(changes_ns)
        assert np.isfinite(positions).all()
        way = rpm[:-1] / 60.0 * np.diff(changes_ns) * 1e-9
        assert np.allclose(np.diff(positions), way, atol=1e-9 * max(1.0, np.abs(positions).max()))
        turns, rpm = self.drive.shaft.history(np.arange(since_ns, self.now_ns + 1, MILLISECOND // 4))
        return turns, rpm / 60.0
