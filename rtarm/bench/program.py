"""Somebody else's program as a child: its output, its end, and a death it shares with this process."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal

from rtarm.processes import shared_death

STOP_S = 5.0


class Program:
    """One program at a time; what it prints is kept together."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._output: asyncio.Task[bytes] | None = None

    async def start(self, *command: str) -> None:
        """Start it in a process group of its own, so that a terminal's Ctrl-C does not reach it."""
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            process_group=0,
            preexec_fn=shared_death(),
        )
        assert process.stdout is not None
        self._process, self._output = process, asyncio.create_task(process.stdout.read())

    @property
    def pid(self) -> int:
        """Process id."""
        assert self._process is not None
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether it has, or was never started."""
        return self._process is None or self._process.returncode is not None

    async def ended(self, patience_s: float) -> tuple[int, str]:
        """Its exit code (negative: the signal) and all that it printed, once it has ended; raises TimeoutError."""
        assert self._process is not None and self._output is not None
        async with asyncio.timeout(patience_s):
            output = await asyncio.shield(self._output)
            return await self._process.wait(), output.decode(errors="replace")

    async def stop(self) -> None:
        """SIGTERM, and SIGKILL to its whole group when that has no effect."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(STOP_S):
                await process.wait()
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()
