"""A host of the simulated arm, as a program at its serial port would be, in virtual time."""

from __future__ import annotations

from sim.arm import SimulatedArm

MILLISECOND = 1_000_000
START_NS = 1_700_000_000_000_000_000


def line(address: int, data: bytes, packet: int = 0) -> bytes:
    return b"T%08X%d%s\r" % (address << 8 | packet, len(data), data.hex().upper().encode())


def read(address: int, function: int = 0x36) -> bytes:
    return line(address, bytes((function, 0x6B)))


def move(address: int, pulses: int, rpm: int, acc: int = 0) -> bytes:
    message = b"\xfd" + bytes((pulses < 0,)) + rpm.to_bytes(2, "big") + bytes((acc,))
    message += abs(pulses).to_bytes(4, "big") + b"\x01\x00\x6b"
    return line(address, message[:8]) + line(address, message[:1] + message[8:], 1)


class Host:
    """Talks to an arm as a program would."""

    def __init__(self, arm: SimulatedArm) -> None:
        self.arm = arm
        self.now_ns = arm.start_ns

    def say(self, data: bytes) -> None:
        self.arm.feed(self.now_ns, data)

    def wait(self, milliseconds: float) -> list[str]:
        self.now_ns += round(milliseconds * MILLISECOND)
        return self.arm.collect(self.now_ns).decode("latin-1").split("\r")[:-1]

    def frames(self, milliseconds: float) -> list[str]:
        """The frames received meanwhile; `Z` and empty answers left out."""
        return [text for text in self.wait(milliseconds) if text.startswith("T")]

    def position(self, address: int) -> int | None:
        """The count a drive reports, None if it does not answer."""
        self.say(read(address))
        for text in self.frames(2):
            if text.startswith(f"T{address << 8:08X}736"):
                return int(text[14:22], 16) * (-1 if text[12:14] == "01" else 1)
        return None


def connect(arm: SimulatedArm) -> Host:
    host = Host(arm)
    host.say(b"C\rS6\rO\r")
    host.wait(1)
    return host
