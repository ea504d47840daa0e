"""A command at a terminal of its own, and a person who reads and types."""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import re
import select
import subprocess
import sys
import termios
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from stack import ROOT

PATIENCE_S = 30.0
CTRL_C = "\x03"
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()][A-Z0-9]|\r")
SIZE = (50, 240)
"""Rows and columns."""


class Terminal:
    """One command in a terminal, from its start to its end."""

    def __init__(self, arguments: Sequence[str], folder: Path, environment: Mapping[str, str]) -> None:
        self._raw = b""
        self._read_to = 0
        self._master, slave = pty.openpty()
        termios.tcsetwinsize(slave, SIZE)
        self.process = subprocess.Popen(
            arguments,
            cwd=folder,
            env={**environment, "TERM": "xterm"},
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 (it only takes the terminal)
        )
        os.close(slave)

    @property
    def said(self) -> str:
        """What it has said so far, without what only moves the cursor."""
        return ESCAPES.sub("", self._raw.decode(errors="replace"))

    def read_until(self, text: str, patience_s: float = PATIENCE_S) -> None:
        """Read on until a text comes, wherever its lines break; what comes before it is not looked at again."""
        deadline = time.monotonic() + patience_s
        pattern = re.compile(r"\s+".join(re.escape(word) for word in text.split()))
        while (found := pattern.search(self.said, self._read_to)) is None:
            assert time.monotonic() < deadline and self._hear(), f"{text!r} never came:\n{self.said}"
        self._read_to = found.end()

    def press(self, keys: str) -> None:
        """Press keys, `CTRL_C` among them."""
        os.write(self._master, keys.encode())

    def type(self, line: str) -> None:
        """Type a line and end it."""
        self.press(f"{line}\n")

    def reply(self, question: str, line: str) -> None:
        """Read on until a question comes, and type a line."""
        self.read_until(question)
        self.type(line)

    def code(self, patience_s: float = PATIENCE_S) -> int:
        """Read to the end; the exit code."""
        deadline = time.monotonic() + patience_s
        while self._hear():
            assert time.monotonic() < deadline, f"it does not end:\n{self.said}"
        return self.process.wait(max(1.0, deadline - time.monotonic()))

    def hang_up(self) -> None:
        """The terminal goes away."""
        os.close(self._master)
        self._master = -1

    def close(self) -> None:
        """Leave nothing behind."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(20.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self._master >= 0:
            self.hang_up()

    def _hear(self) -> bool:
        """Whether there may be more to come."""
        if not select.select([self._master], (), (), 1.0)[0]:
            return self.process.poll() is None
        try:
            data = os.read(self._master, 65_536)
        except OSError as error:
            if error.errno != errno.EIO:  # nobody has it open any more
                raise
            return False
        self._raw += data
        return bool(data)


def rtarm_at_terminal(*arguments: str) -> Terminal:
    """`rtarm` itself."""
    environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "COLUMNS": "400"}
    return Terminal([sys.executable, "-m", "rtarm", *arguments], ROOT, environment)
