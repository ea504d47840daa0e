"""The page beside the arm that `rtarm up --view` and `rtarm demo --view` start: whatever becomes of it ends nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

from rtarm.console.reporter import Reporter
from rtarm.processes import Child, describe_end

NAME = "view"
OPENED = "opened"
"""The line with which the page's process says that a browser shows it."""
STOP_S = 3.0


class PageBeside:
    """The page's process: started, told about, and ended with the arm.

    Attributes:
        url: where it opens, once that is known.
        settled: a browser shows the page, or none ever will.
    """

    def __init__(self, reporter: Reporter) -> None:
        self.url = ""
        self.settled = asyncio.Event()
        self._reporter = reporter
        self._child: Child | None = None

    async def watch(self, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        """Start it, say its address, and say so when it has ended; never fails.

        Args:
            arguments: the arm as every process of it gets it.
            environment: holds the ROS domain in which the page's goals are sent.
        """
        try:
            child = self._child = await Child.start(NAME, "rtarm.view", arguments, environment, self._hear)
            self.url = await child.ready() or ""
            if self.url:
                self._say(f"ready, open {self.url}", "bold")
            code = await child.ended()
            self._say(
                f"the page ended {describe_end(code)}; the arm goes on, and `rtarm view` opens a new page", "yellow"
            )
        except OSError as problem:  # no memory, no processes left
            self._say(f"no page: {problem.strerror}; the arm goes on", "yellow")
        finally:
            self.settled.set()

    async def stop(self) -> None:
        """End it."""
        if self._child is not None and not await self._child.stop(STOP_S):
            self._say(f"did not end within {STOP_S:g} s and was killed", "bold red")

    def _hear(self, line: str) -> None:
        if line == OPENED:
            self.settled.set()
        else:
            self._say(line)

    def _say(self, text: str, style: str = "") -> None:
        self._reporter.say(text, NAME, style)
