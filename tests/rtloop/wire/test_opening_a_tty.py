"""Opening a serial adapter whose plug is pulled meanwhile: one kind of exception, and no descriptor left open."""

import os
from pathlib import Path
from typing import Any

import pytest

from rtloop.wire import tty
from rtloop.wire.refusal import WireRefused


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize(
    ("owner", "step"),
    [(tty.fcntl, "flock"), (tty, "_make_raw"), (tty, "_ask_for_low_latency"), (tty, "_say")],
    ids=["flock", "raw", "latency", "say"],
)
def test_an_adapter_that_goes_while_it_is_opened_is_refused_in_a_sentence(
    owner: Any, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`termios.error` is no OSError; either would end the control process when it opens its wire again."""
    master, slave = os.openpty()
    channel = os.ttyname(slave)
    os.close(slave)
    before = descriptors()
    carry_out = getattr(owner, step)
    pulled: list[str] = []

    def pull(*arguments: Any) -> Any:
        if not pulled:
            os.close(master)
            pulled.append(step)
        return carry_out(*arguments)

    monkeypatch.setattr(owner, step, pull)
    with pytest.raises(WireRefused, match=r"check its plug|does not run at"):
        tty.open_slcan(channel, "cdc", 500_000)
    assert pulled
    assert descriptors() == before - 1  # the master's


def test_closing_says_nothing_more_of_what_the_system_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drives that get their power back later must not hear targets of today; a pseudo-terminal itself keeps nothing."""
    master, slave = os.openpty()
    tty.std_tty.setraw(slave)
    os.write(slave, b"T000001008FD0001000000000000\r")
    dropped = []

    def drop(fd: int, queue: int) -> None:
        dropped.append((fd, queue, os.read(master, 100)))

    monkeypatch.setattr(tty.termios, "tcflush", drop)
    tty.close_slcan(slave)
    assert dropped == [(slave, tty.termios.TCOFLUSH, b"T000001008FD0001000000000000\r")]
    assert os.read(master, 100) == tty.CLOSING
    os.close(master)
