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

from stack import ROOT

PATIENCE_S = 30.0


class Terminal:
    """A terminal with a command running in it, and a person who reads and types."""

    def __init__(self, *arguments: str) -> None:
        self.said = ""
        self._read_to = 0
        self.master, slave = pty.openpty()
        environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "COLUMNS": "400"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rtarm", *arguments],
            cwd=ROOT,
            env=environment,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 (it only takes the terminal)
        )
        os.close(slave)

    def read_until(self, text: str) -> None:
        """Read on until a text comes, wherever its lines break; what comes before it is not looked at again."""
        deadline = time.monotonic() + PATIENCE_S
        pattern = re.compile(r"\s+".join(re.escape(word) for word in text.split()))
        while (found := pattern.search(self.said, self._read_to)) is None:
            assert time.monotonic() < deadline and self._hear(), f"{text!r} never came:\n{self.said}"
        self._read_to = found.end()

    def type(self, line: str) -> None:
        os.write(self.master, f"{line}\n".encode())

    def _hear(self) -> bool:
        """Whether there may be more to come."""
        if not select.select([self.master], (), (), 1.0)[0]:
            return True
        try:
            data = os.read(self.master, 65_536)
        except OSError as error:
            if error.errno != errno.EIO:  # nobody has it open any more
                raise
            return False
        self.said += data.decode(errors="replace").replace("\r\n", "\n")
        return bool(data)

    def code(self) -> int:
        while self._hear():
            pass
        return self.process.wait(PATIENCE_S)

    def hang_up(self) -> None:
        os.close(self.master)
        self.master = -1

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        if self.master >= 0:
            self.hang_up()
