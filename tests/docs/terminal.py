"""A terminal, in which a command runs and a person reads and types."""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import re
import select
import subprocess
import termios
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

CTRL_C = "\x03"
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()][A-Z0-9]|\r")


class Terminal:
    """One command, from its start to its end."""

    def __init__(self, arguments: Sequence[str], folder: Path, environment: Mapping[str, str]) -> None:
        self._raw = b""
        self._read_to = 0
        self._master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (50, 240))
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

    def read_until(self, text: str, patience_s: float) -> None:
        """Read on until a text comes that has not been waited for yet."""
        deadline = time.monotonic() + patience_s
        while (at := self.said.find(text, self._read_to)) < 0:
            assert time.monotonic() < deadline and self._hear(), f"{text!r} never came:\n{self.said}"
        self._read_to = at + len(text)

    def type(self, keys: str) -> None:
        """Press keys; a line needs its end."""
        os.write(self._master, keys.encode())

    def code(self, patience_s: float) -> int:
        """Read to the end; the exit code."""
        deadline = time.monotonic() + patience_s
        while self._hear():
            assert time.monotonic() < deadline, f"it does not end:\n{self.said}"
        return self.process.wait(max(1.0, deadline - time.monotonic()))

    def close(self) -> None:
        """Leave nothing behind."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(20.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        os.close(self._master)

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
