"""Opening and closing the serial adapters with binary frames: USB-CAN-A (facts/can-adapters.md, section 2), AT (3).

Neither adapter reports whether it has accepted its bit rate, so only a port that cannot be opened is refused. A process
that was killed may have left half a frame in the adapter; zeros complete it to one with a wrong trailer, which is
dropped.
"""

import os

from config.serial_adapters import SEEED_BITRATES, SERIAL_ADAPTERS
from rtloop.wire.tty import drain, setting_up

STANDARD_ONLY, EXTENDED_ONLY = 1, 2
"""Kind of frames that a USB-CAN-A is set to; one setting may not deliver both."""
NORMAL, APART = 0, 3
"""Modes of a USB-CAN-A; APART (loop-back and silent) neither receives from the bus nor sends."""
_REPEATED = 0x00
"""Byte behind the mode: a frame that lost arbitration is sent again (Waveshare's Can_config.pdf). With 01 it is sent
only once (Seeed's manual), so that a command of two packets could lose one of them."""
SET_UP_S = 0.1
"""Wait after the set-up of a USB-CAN-A, to which other programs give 80 to 100 ms."""
LONGEST_FRAME = 20
FILLER = bytes(LONGEST_FRAME)

AT_HANDSHAKE = b"AT+AT\r\n"
AT_AGREES = b"OK\r\n"
AT_CLOSING = FILLER


def set_up_frame(bitrate: int, frames: int, mode: int) -> bytes:
    """The 20 bytes that set a USB-CAN-A up for its variable-length framing without a filter; `bitrate` in bit/s."""
    content = bytes((0x12, SEEED_BITRATES[bitrate], frames, *bytes(8), mode, _REPEATED, *bytes(4)))
    return b"\xaa\x55" + content + bytes((sum(content) & 0xFF,))


def line_speed(interface: str, serial_baud: int | str) -> int | str:
    """The speed (baud) for the port of a binary adapter; if the arm file says cdc, the default of this kind of adapter.

    A true USB device ignores the speed, but a CH340 that is taken for one would stay at its last speed.
    """
    return SERIAL_ADAPTERS[interface].serial_baud if serial_baud == "cdc" else serial_baud


def open_seeed(channel: str, serial_baud: int | str, bitrate: int, frames: int) -> int:
    """Open a USB-CAN-A for frames of one kind, and return its descriptor, non-blocking. Raises WireRefused."""
    with setting_up(channel, line_speed("seeedstudio", serial_baud)) as fd:
        os.write(fd, FILLER + set_up_frame(bitrate, frames, NORMAL))
        drain(fd, SET_UP_S)
    return fd


def seeed_closing(bitrate: int, frames: int) -> bytes:
    """The bytes that take a USB-CAN-A off the bus, so that it drops the frames that it has buffered."""
    return FILLER + set_up_frame(bitrate, frames, APART)


def open_at(channel: str, serial_baud: int | str) -> tuple[int, list[str]]:
    """Open an AT adapter; returns its descriptor, non-blocking, and complaints to the operator. Raises WireRefused."""
    with setting_up(channel, line_speed("ch340-at", serial_baud)) as fd:
        os.write(fd, FILLER + AT_HANDSHAKE)
        answered = AT_AGREES in drain(fd)
    complaints = []
    if not answered:
        complaints.append(
            f"The adapter at {channel} has not answered its handshake (AT+AT): if no drive is heard either, check "
            "that it is an AT adapter and that bus.serial_baud is its speed."
        )
    return fd, complaints
