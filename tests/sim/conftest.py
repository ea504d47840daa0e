"""What the tests of the simulator share: a bench with one drive on it, and no bus."""

from __future__ import annotations

from typing import Any

import pytest

from sim.bus import Frame
from sim.drives.zdt import ZdtDrive

MILLISECOND = 1_000_000


class Bench:
    """Hands frames to one drive and takes its answers, in virtual time."""

    def __init__(self, **options: Any) -> None:
        self.drive = ZdtDrive(**options)
        self.now_ns = 0

    def send(self, message: str | bytes, address: int = 1) -> None:
        """Send one message, split into packets as the protocol asks."""
        data = bytes.fromhex(message) if isinstance(message, str) else message
        self.packets([data[:8], *(data[:1] + data[start : start + 7] for start in range(8, len(data), 7))], address)

    def packets(self, packets: list[bytes], address: int = 1) -> None:
        """Send packets numbered from 0."""
        for number, packet in enumerate(packets):
            self.frame(Frame(address << 8 | number, packet))

    def frame(self, frame: Frame) -> None:
        """Send one frame."""
        self.drive.receive(self.now_ns, frame)

    def heard(self) -> list[str]:
        """The frames the drive has sent since, as hex; packets after the first with their number."""
        texts = []
        while self.drive.outbox:
            _, frame = self.drive.outbox.popleft()
            assert frame.extended
            number = frame.can_id & 0xFF
            texts.append((f"{number}: " if number else "") + frame.data.hex(" ").upper())
        return texts

    def ask(self, message: str | bytes) -> list[str]:
        """Send a message and return what the drive says to it."""
        self.send(message)
        return self.heard()

    def body(self, message: str) -> bytes:
        """Send a message and return the answer put together, without function byte and checksum."""
        self.send(message)
        frames = [frame.data for _, frame in self.drive.outbox]
        self.drive.outbox.clear()
        whole = b"".join(data[1:] for data in frames)
        assert whole[-1] == 0x6B
        return whole[:-1]

    def wait(self, milliseconds: float) -> None:
        """Let time pass, waking the drive when it wants to be."""
        end_ns = self.now_ns + round(milliseconds * MILLISECOND)
        while self.drive.wake_ns <= end_ns:
            self.now_ns = max(self.now_ns, self.drive.wake_ns)
            self.drive.wake(self.now_ns)
        self.now_ns = end_ns
        self.drive.advance(end_ns)


@pytest.fixture
def bench() -> Bench:
    """One new-firmware drive with factory settings, homed, at zero."""
    return Bench()


@pytest.fixture
def make_bench() -> type[Bench]:
    """For a drive with other options."""
    return Bench
