"""The serial CAN adapters: how each puts frames into bytes, the bit rates it offers, the speed of its serial line.

Bytes are those of facts/can-adapters.md: section 1 (SLCAN), section 2 (Seeed and Waveshare USB-CAN-A, variable length)
and section 3 (the `AT` framing of RobStride and CyberGear adapters).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from config.frames import CycleFrames, check_data_bytes, slcan_chars

SLCAN_BITRATES: dict[int, str] = {
    10_000: "S0",
    20_000: "S1",
    50_000: "S2",
    100_000: "S3",
    125_000: "S4",
    250_000: "S5",
    500_000: "S6",
    1_000_000: "S8",
}
"""CAN bit rates that every SLCAN adapter understands alike, with the command that sets them."""

SEEED_BITRATES: dict[int, int] = {
    5_000: 0x0C,
    10_000: 0x0B,
    20_000: 0x0A,
    50_000: 0x09,
    100_000: 0x08,
    125_000: 0x07,
    200_000: 0x06,
    250_000: 0x05,
    400_000: 0x04,
    500_000: 0x03,
    800_000: 0x02,
    1_000_000: 0x01,
}
"""CAN bit rates of a USB-CAN-A, with the byte that sets them."""

AT_BITRATES = (1_000_000,)
"""The bit rate of the drives that the `AT` adapter is sold with; nothing in its handshake changes it."""


def seeed_bytes(extended: bool, data_bytes: int) -> int:
    """Bytes of a USB-CAN-A data frame: AA, kind and length, identifier, data, 55."""
    check_data_bytes(data_bytes)
    return 2 + (4 if extended else 2) + data_bytes + 1


def at_bytes(extended: bool, data_bytes: int) -> int:
    """Bytes of an `AT` data frame: 41 54, identifier, length, data, 0D 0A; a standard identifier is as long."""
    check_data_bytes(data_bytes)
    return 2 + 4 + 1 + data_bytes + 2


@dataclass(frozen=True)
class SerialAdapter:
    """A kind of serial CAN adapter."""

    name: str
    """What it is called in sentences, with its article."""
    bitrates: tuple[int, ...]
    serial_baud: int | Literal["cdc"]
    """Speed of its serial line where the arm file names none."""
    frame_bytes: Callable[[bool, int], int]
    """Bytes of a data frame on the serial line, by whether its identifier is extended and how many data bytes it has;
    raises ValueError for more than 8."""
    unit: str
    """What these bytes are called in sentences."""
    reply_bytes: int
    """What the adapter says to each frame that is handed to it."""
    device: str
    """What its port may be called."""
    standard: bool = True
    """Whether it carries standard identifiers (11 bits) beside extended ones."""
    both_at_once: bool = True
    """Whether one setting of it delivers both."""
    remote: bool = True
    """Whether it carries remote frames."""

    def bytes_of(self, frames: CycleFrames) -> int:
        """Bytes of frames on the serial line, without the adapter's replies."""
        return frames.count * self.frame_bytes(frames.extended, frames.data_bytes)


SERIAL_ADAPTERS: dict[str, SerialAdapter] = {
    "slcan": SerialAdapter(
        name="an SLCAN adapter",
        bitrates=tuple(SLCAN_BITRATES),
        serial_baud="cdc",
        frame_bytes=slcan_chars,
        unit="characters",
        reply_bytes=len("Z\r"),
        device="/dev/ttyACM0",
    ),
    "seeedstudio": SerialAdapter(
        name="a USB-CAN-A adapter",
        bitrates=tuple(SEEED_BITRATES),
        serial_baud=2_000_000,
        frame_bytes=seeed_bytes,
        unit="bytes",
        reply_bytes=0,
        device="/dev/ttyUSB0",
        both_at_once=False,
    ),
    "ch340-at": SerialAdapter(
        name="an AT adapter",
        bitrates=AT_BITRATES,
        serial_baud=921_600,
        frame_bytes=at_bytes,
        unit="bytes",
        reply_bytes=0,
        device="/dev/ttyUSB0",
        standard=False,
        remote=False,
    ),
}
"""By the name of the interface in an arm file."""
