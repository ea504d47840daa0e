"""Opening a serial CAN adapter: the tty raw and exclusive, the SLCAN channel at the right bit rate.

This is ordinary Python and runs before the first cycle. Adapters differ in what they answer (LAWICEL: CR or BEL, the
original canable: nothing), so an answer is waited for with a short timeout, and only a refusal counts. An adapter may
be in any state: an earlier process may have been killed in the middle of a line and left the channel open, or may have
left an adapter with the canable firmware in its silent mode (`M1`).
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
from collections.abc import Iterator

from config.serial_adapters import SLCAN_BITRATES
from rtloop.wire.refusal import WireRefused

ANSWER_PATIENCE_S = 0.15
_ASYNC_LOW_LATENCY = 0x2000
_TIOCGSERIAL = 0x541E
_TIOCSSERIAL = 0x541F
_SERIAL_STRUCT_INTS = 18
_FLAGS_INT = 4
CR, BEL = b"\r", b"\x07"
CLOSING = b"\rC\r"
"""Ends a line that may have been sent in part, then closes the channel."""
FORGETTING = b"\r\r" + CLOSING + b"M0\r"
"""The same, and ends the silent mode of a canable; other adapters may refuse that."""
QUIET_S = 0.05
"""An adapter that has sent nothing for so long has nothing more to send; FTDI chips hold bytes back for 16 ms."""
DRAINED_WITHIN_S = 0.5
N_SLCAN = 17
"""The line discipline of the kernel's SLCAN driver (linux/tty.h), which `slcand` sets for a port."""
_TIOCGETD = 0x5424


def open_port(channel: str, serial_baud: int | str) -> int:
    """Open a serial port, exclusive and raw, and return its descriptor, non-blocking. Raises WireRefused."""
    fd = _open_tty(channel)
    try:
        _make_raw(fd, channel, serial_baud)
        _ask_for_low_latency(fd)
        termios.tcflush(fd, termios.TCIOFLUSH)
    except (OSError, termios.error) as problem:  # termios.error is no OSError
        os.close(fd)
        raise _gone(channel, problem) from problem
    except BaseException:
        os.close(fd)
        raise
    return fd


@contextlib.contextmanager
def setting_up(channel: str, serial_baud: int | str) -> Iterator[int]:
    """Open a port; if an error occurs within the context, the port is closed. Raises WireRefused."""
    fd = open_port(channel, serial_baud)
    try:
        yield fd
    except OSError as problem:
        os.close(fd)
        raise _gone(channel, problem) from problem
    except BaseException:
        os.close(fd)
        raise


def open_slcan(channel: str, serial_baud: int | str, bitrate: int) -> int:
    """Open an SLCAN adapter and return its descriptor, non-blocking; raises WireRefused."""
    with setting_up(channel, serial_baud) as fd:
        os.write(fd, FORGETTING)  # an adapter whose channel is closed may refuse this, which does no harm
        drain(fd)
        rate = SLCAN_BITRATES[bitrate]
        if _say(fd, f"{rate}\r".encode()) == BEL:
            raise WireRefused(
                f"The adapter at {channel} refuses {bitrate} bit/s ({rate} was answered with BEL): choose one it "
                "offers, or another adapter."
            )
        if _say(fd, b"O\r") == BEL:
            raise WireRefused(
                f"The adapter at {channel} refuses to open its CAN channel (O was answered with BEL): unplug it and "
                "plug it in again, and check that the CAN side has power and termination."
            )
    return fd


def close_slcan(fd: int) -> None:
    """Close the channel and the tty; an adapter that is gone already is no error.

    Bytes that the system still holds are dropped first, and the adapter drops its own when its channel is closed. So
    drives that get their power back later do not receive old targets.
    """
    close_port(fd, CLOSING)


def close_port(fd: int, farewell: bytes) -> None:
    """Drop the bytes that the system holds for the adapter, write `farewell` and close the port.

    An adapter that is gone is no error.
    """
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(fd, termios.TCOFLUSH)
    with contextlib.suppress(OSError):
        os.write(fd, farewell)
    os.close(fd)


def drain(fd: int, quiet_s: float = QUIET_S) -> bytes:
    """Read until the adapter has sent nothing for `quiet_s`, or for half a second if it goes on; what was read."""
    said = b""
    deadline = time.monotonic() + DRAINED_WITHIN_S
    while time.monotonic() < deadline and select.select([fd], [], [], quiet_s)[0]:
        said += os.read(fd, 4096)
    return said


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
    if _line_discipline(fd) == N_SLCAN:
        os.close(fd)
        raise WireRefused(
            f"{channel} is attached to the kernel's own SLCAN driver: end slcand, or reach the arm through the CAN "
            "interface it has made (interface socketcan; `ip -brief link show type can` names it)."
        )
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


def _line_discipline(fd: int) -> int:
    number = array.array("i", [0])
    with contextlib.suppress(OSError):
        fcntl.ioctl(fd, _TIOCGETD, number)
    return number[0]


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
    """Set the low-latency flag, as `setserial low_latency` does; ports without it (ttyACM, pseudo-terminals) refuse."""
    settings = array.array("i", [0] * _SERIAL_STRUCT_INTS)
    with contextlib.suppress(OSError):
        fcntl.ioctl(fd, _TIOCGSERIAL, settings)
        settings[_FLAGS_INT] |= _ASYNC_LOW_LATENCY
        fcntl.ioctl(fd, _TIOCSSERIAL, settings)


def _say(fd: int, command: bytes) -> bytes:
    """Send a command; returns the answer, CR or BEL, or nothing if none comes within ANSWER_PATIENCE_S.

    A line that is not empty is no answer to such a command: it is a frame of an open channel, or a message of the
    adapter's own.
    """
    os.write(fd, command)
    answer = b""
    deadline = time.monotonic() + ANSWER_PATIENCE_S
    while (left := deadline - time.monotonic()) > 0:
        ready, _, _ = select.select([fd], [], [], left)
        if not ready:
            break
        answer += os.read(fd, 256)
        if BEL in answer:
            return BEL
        if b"" in answer.split(CR)[:-1]:
            return CR
    return b""
