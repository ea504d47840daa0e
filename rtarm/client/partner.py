"""A child process that is told lines and answers in lines of JSON."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from rtarm.console.errors import Refusal
from rtarm.processes import Child, describe_end

START_PATIENCE_S = 60.0
WORD_PATIENCE_S = 60.0
STOP_S = 3.0


class Silent(Refusal):
    """The child has not said in time what it was to say."""


class Partner:
    """A child that is told lines and answers in lines of JSON; `close` belongs in a `finally`."""

    def __init__(self, name: str, tell: Callable[[str], object] = lambda _: None) -> None:
        """`tell` is told its lines that are no JSON."""
        self._name = name
        self._tell = tell
        self._events: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self._child: Child | None = None
        self._words: list[str] = []

    async def start(self, module: str, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        """Start it."""
        self._child = await Child.start(self._name, module, arguments, environment, self._take, told=True)

    async def ready(self) -> str:
        """Wait until it is ready; what it said behind that word.

        Raises:
            Silent: it was not ready in time.
            Refusal: it ended.
        """
        assert self._child is not None
        try:
            async with asyncio.timeout(START_PATIENCE_S):
                said = await self._child.ready()
        except TimeoutError:
            raise Silent(f"{self._name} was not ready within {START_PATIENCE_S:g} s: relieve the machine.") from None
        if said is None:
            raise await self.refusal()
        return said

    @property
    def pid(self) -> int:
        """Process id."""
        assert self._child is not None
        return self._child.pid

    def say(self, line: str) -> None:
        """Tell it a line."""
        assert self._child is not None
        self._child.tell(line)

    async def event(self, patience_s: float = WORD_PATIENCE_S) -> dict[str, Any]:
        """What it reports next.

        Raises:
            Silent: it reports nothing in time.
            Refusal: it ended.
        """
        assert self._child is not None
        heard = asyncio.create_task(self._events.get())
        ended = asyncio.create_task(self._child.ended())
        try:
            await asyncio.wait((heard, ended), timeout=patience_s, return_when=asyncio.FIRST_COMPLETED)
            if heard.done():
                return heard.result()
            if ended.done():
                raise await self.refusal()
            raise Silent(f"{self._name} said nothing for {patience_s:g} s: relieve the machine.")
        finally:
            heard.cancel()
            ended.cancel()

    async def hang_up(self) -> None:
        """Let it end in order, at the end of what it is told: a ROS process leaves files in /dev/shm otherwise."""
        if self._child is not None:
            self._child.hang_up()
            with suppress(TimeoutError):
                async with asyncio.timeout(STOP_S):
                    await self._child.ended()

    async def close(self) -> None:
        """End it."""
        if self._child is not None:
            await self._child.stop(STOP_S)

    async def refusal(self) -> Refusal:
        """How it ended, once it has."""
        assert self._child is not None
        end = describe_end(await self._child.ended())
        words = " / ".join(self._words[-3:]).rstrip(".")
        return Refusal(f"{self._name} ended {end}; its last words: {words or 'none'}.")

    def _take(self, line: str) -> None:
        try:
            event = json.loads(line) if line.startswith("{") else None
        except ValueError:
            event = None
        if event is not None:
            self._events.put_nowait(event)
        else:
            self._words.append(line)
            self._tell(line)
