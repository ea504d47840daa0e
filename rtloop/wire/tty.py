"""Opening a serial CAN adapter: the tty raw and exclusive, the SLCAN channel at the right bit rate.

This is ordinary Python and runs before the first cycle. Adapters differ in what they answer (LAWICEL: CR or
BEL, the original canable: nothing), so an answer is looked for during a short while and only a refusal
counts.
"""

import array
import contextlib
import errno
import fcntl
import os
import select
import termios
import time
import tty as std_tty

from config.bus import SLCAN_BITRATES
from rtloop.wire.refusal import WireRefused

ANSWER_PATIENCE_S = 0.15
_ASYNC_LOW_LATENCY = 0x2000
_TIOCGSERIAL = 0x541E
_TIOCSSERIAL = 0x541F
_SERIAL_STRUCT_INTS = 18
_FLAGS_INT = 4
BEL = b"\x07"
CLOSING = b"\rC\r"
"""Ends a line that may be half said, then the channel."""


def open_port(channel: str, serial_baud: int | str) -> int:
    """Open a serial port for ourselves alone, raw; its descriptor, non-blocking. Raises WireRefused."""
    fd = _open_tty(channel)
    try:
        _make_raw(fd, channel, serial_baud)
        _ask_for_low_latency(fd)
        termios.tcflush(fd, termios.TCIOFLUSH)
    except (OSError, termios.error) as problem:  # the latter is none of the former
        os.close(fd)
        raise _gone(channel, problem) from problem
    except BaseException:
        os.close(fd)
        raise
    return fd


def open_slcan(channel: str, serial_baud: int | str, bitrate: int) -> int:
    """Open an SLCAN adapter and return its descriptor, non-blocking; raises WireRefused."""
    fd = open_port(channel, serial_baud)
    try:
        _say(fd, b"C\r")  # an adapter that is closed already may refuse this, which is as good
        rate = SLCAN_BITRATES[bitrate]
        if BEL in _say(fd, f"{rate}\r".encode()):
            raise WireRefused(
                f"The adapter at {channel} refuses {bitrate} bit/s ({rate} was answered with BEL): choose one it "
                "offers, or another adapter."
            )
        if BEL in _say(fd, b"O\r"):
            raise WireRefused(
                f"The adapter at {channel} refuses to open its CAN channel (O was answered with BEL): unplug it and "
                "plug it in again, and check that the CAN side has power and termination."
            )
    except OSError as problem:
        os.close(fd)
        raise _gone(channel, problem) from problem
    except BaseException:
        os.close(fd)
        raise
    return fd


def close_slcan(fd: int) -> None:
    """Close the channel and the tty; an adapter that is gone already is no error.

    What the system still keeps is dropped first, and the adapter drops what it keeps when its channel is closed: drives
    that get their power back later must not hear targets of today.
    """
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(fd, termios.TCOFLUSH)
    with contextlib.suppress(OSError):
        os.write(fd, CLOSING)
    os.close(fd)


def _open_tty(channel: str) -> int:
    try:
        fd = os.open(channel, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise WireRefused(
            f"There is no serial port {channel}: plug the adapter in, or name its port as the channel "
            "(`ls /dev/ttyUSB* /dev/ttyACM*` shows what is there)."
        ) from None
    except PermissionError:
        raise WireRefused(
            f"You may not open {channel}: join the group that owns it (usually `sudo usermod -aG dialout $USER`, then "
            "log in again)."
        ) from None
    except OSError as problem:
        if problem.errno == errno.EBUSY:
            raise WireRefused(_busy(channel)) from None
        raise WireRefused(
            f"{channel} cannot be opened ({problem.strerror}): name the adapter's port as the channel."
        ) from None
    if not os.isatty(fd):
        os.close(fd)
        raise WireRefused(f"{channel} is not a serial port: name the adapter's port as the channel.")
    try:
        # TIOCEXCL does not keep root out, so both kinds of exclusion are used
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fcntl.ioctl(fd, termios.TIOCEXCL)
    except OSError as problem:
        os.close(fd)
        if isinstance(problem, BlockingIOError):
            raise WireRefused(_busy(channel)) from None
        raise _gone(channel, problem) from problem
    return fd


def _gone(channel: str, problem: Exception) -> WireRefused:
    return WireRefused(
        f"The adapter at {channel} stopped answering while it was set up ({os.strerror(problem.args[0])}): check its "
        "plug, then start again."
    )


def _busy(channel: str) -> str:
    return f"{channel} is in use by another program: end that one first (`fuser {channel}` names it)."


def _make_raw(fd: int, channel: str, serial_baud: int | str) -> None:
    std_tty.setraw(fd, termios.TCSANOW)
    attributes = termios.tcgetattr(fd)
    attributes[2] |= termios.CLOCAL | termios.CREAD
    attributes[2] &= ~termios.CRTSCTS
    if serial_baud != "cdc":
        speed = getattr(termios, f"B{serial_baud}")
        attributes[4] = attributes[5] = speed
    attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 0, 0
    try:
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
    except (termios.error, OSError) as problem:
        raise WireRefused(
            f"{channel} does not run at {serial_baud} baud ({problem}): set bus.serial_baud to what the adapter uses, "
            "or to cdc for a USB device."
        ) from None


def _ask_for_low_latency(fd: int) -> None:
    """What `setserial low_latency` does; ports without the flag (ttyACM, pseudo-terminals) say no."""
    settings = array.array("i", [0] * _SERIAL_STRUCT_INTS)
    with contextlib.suppress(OSError):
        fcntl.ioctl(fd, _TIOCGSERIAL, settings)
        settings[_FLAGS_INT] |= _ASYNC_LOW_LATENCY
        fcntl.ioctl(fd, _TIOCSSERIAL, settings)


def _say(fd: int, command: bytes) -> bytes:
    """Send a command and return what comes back within a short while, up to the first CR or BEL."""
    os.write(fd, command)
    answer = b""
    deadline = time.monotonic() + ANSWER_PATIENCE_S
    while (left := deadline - time.monotonic()) > 0:
        ready, _, _ = select.select([fd], [], [], left)
        if not ready:
            break
        answer += os.read(fd, 256)
        if answer.endswith((b"\r", BEL)):
            break
    return answer
