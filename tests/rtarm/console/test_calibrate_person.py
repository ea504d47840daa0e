"""What `rtarm calibrate` takes for an answer at a terminal."""

from __future__ import annotations

import io
import os
import pty
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest

from rtarm.console.person import Quit, Terminal, agrees, as_number

FLUSH = termios.tcflush


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The other end of the terminal that standard input is, in a locale that takes UTF-8 and nothing else."""
    master, slave = pty.openpty()
    with open(slave, encoding="utf-8", errors="strict") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield master
    with suppress(OSError):
        os.close(master)


def types(keyboard: int, data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Type it once what was typed before has been thrown away."""

    def flushed(terminal: int, queue: int) -> None:
        FLUSH(terminal, queue)
        threading.Timer(0.0, os.write, (keyboard, data)).start()

    monkeypatch.setattr("rtarm.console.person.termios.tcflush", flushed)


@pytest.mark.parametrize("typed", [b"\x04", b"y\x04\x04", b"yes\x04\x04"])
def test_an_input_that_ends_is_no_answer(keyboard: int, monkeypatch: pytest.MonkeyPatch, typed: bytes) -> None:
    types(keyboard, typed, monkeypatch)
    with pytest.raises(Quit, match="the input ended"):
        agrees(Terminal(), "Turn it?")


@pytest.mark.parametrize("typed", [b"\xff\xfe\n", b"\xe9y\n", b"y\x1b[A\n", b"\n"])
def test_what_is_no_text_is_no_yes(keyboard: int, monkeypatch: pytest.MonkeyPatch, typed: bytes) -> None:
    types(keyboard, typed, monkeypatch)
    assert not agrees(Terminal(), "Turn it?")
    types(keyboard, b"y\n", monkeypatch)
    assert agrees(Terminal(), "Turn it?")


def test_a_terminal_that_is_gone_ends_it(keyboard: int) -> None:
    os.close(keyboard)
    with pytest.raises(Quit):
        Terminal().answer("Turn it?")


@pytest.mark.parametrize("stdin", [None, io.StringIO("y\n")])
def test_nothing_but_a_terminal_is_asked(monkeypatch: pytest.MonkeyPatch, stdin: io.StringIO | None) -> None:
    monkeypatch.setattr(sys, "stdin", stdin)
    with pytest.raises(Quit, match="from a terminal alone"):
        Terminal().answer("Turn it?")


@pytest.mark.parametrize(
    ("typed", "value"), [("90,5°", 90.5), ("-15", -15), ("1_5", None), ("1.000,5", None), ("9 0", None), ("", None)]
)
def test_numbers_as_people_type_them(typed: str, value: float | None) -> None:
    assert as_number(typed) == value if value is not None else as_number(typed) != as_number(typed)
