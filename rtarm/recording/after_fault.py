"""The launcher's part in recordings: it sees that a fault was latched or the control process died, and has it recorded.

It holds the state file open, so that nothing of it is lost whatever becomes of its name or its writer. Whatever fails
here costs a sentence: a recording is no reason to end an arm.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
from collections.abc import Callable
from typing import IO

from rtarm.processes import plain_environment
from rtarm.recording.make import DEATH, FAULT, patience_s
from shm import files
from shm.errors import SharedMemoryError
from shm.files import MemoryFile
from shm.words import Fault

POLL_S = 0.2
AFTERMATH_S = 2.0
"""So long after a fault its recording is made: every stop ends within this, and shows in it."""
END_PATIENCE_S = 5.0
"""So long the launcher's end waits for a recording, which is finished without it if it takes longer."""


class FaultRecorder:
    """Has a recording made of each latched fault, and of a control process' death."""

    def __init__(self, arm: str, say: Callable[[str], None]) -> None:
        """`say` gets the sentences for people."""
        self._arm = arm
        self._say = say
        self._memory: MemoryFile | None = None
        self._recorded_ns = 0
        self._writing: asyncio.Task[None] | None = None

    async def watch(self) -> None:
        """Look for faults until canceled; never fails."""
        try:
            self._memory = files.open_state(self._arm)
            while True:
                await asyncio.sleep(POLL_S)
                if self._unrecorded_ns():
                    await asyncio.sleep(AFTERMATH_S)
                    await asyncio.shield(self._start(FAULT))
        except Exception as problem:
            self._complain("faults will not be recorded", problem)
            await asyncio.Event().wait()

    async def close(self, *, died: bool) -> None:
        """Make what is still to be made, of a fault just now or the death of the control process; never fails."""
        if self._memory is None:
            return
        try:
            writing = [] if self._writing is None or self._writing.done() else [self._writing]
            if died:
                writing.append(self._start(DEATH))
            elif self._unrecorded_ns():
                writing.append(self._start(FAULT))
            if writing:
                await self._finish(writing)
        except Exception as problem:
            self._complain("not recorded", problem)
        finally:
            memory, self._memory = self._memory, None
            with contextlib.suppress(Exception):
                memory.close()

    async def _finish(self, writing: list[asyncio.Task[None]]) -> None:
        self._say("writing the recording …")
        _, left = await asyncio.wait(writing, timeout=END_PATIENCE_S)
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)
        if left:
            self._say(
                f"the recording is not written after {END_PATIENCE_S:g} s and goes on being written without rtarm; "
                "`rtarm explain` tells it once it is there"
            )

    def _unrecorded_ns(self) -> int:
        """When a fault was latched (CLOCK_MONOTONIC) that is not recorded yet; 0 when there is none."""
        assert self._memory is not None
        snapshot = self._memory.record["snapshot"]
        latched_ns = int(snapshot["fault_ns"])
        return latched_ns if int(snapshot["fault"]) != Fault.NONE and latched_ns != self._recorded_ns else 0

    def _start(self, word: str) -> asyncio.Task[None]:
        self._recorded_ns = self._unrecorded_ns() or self._recorded_ns
        self._writing = asyncio.create_task(self._run(word))
        return self._writing

    async def _run(self, word: str) -> None:
        """Have it written, and say what came of it; canceled, the process goes on by itself."""
        try:
            assert self._memory is not None
            await self._write(self._memory.fd, word)
        except Exception as problem:  # no memory, no processes left: the arm goes on all the same
            self._complain("not recorded: no process could be started for it", problem)

    async def _write(self, fd: int, word: str) -> None:
        # Into memory rather than pipes, which would break when the launcher ends first.
        with os.fdopen(os.memfd_create("out"), "w+b") as out, os.fdopen(os.memfd_create("err"), "w+b") as err:
            child = subprocess.Popen(
                [sys.executable, "-P", "-m", "rtarm.recording", str(fd), self._arm, word],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env=plain_environment(),
                pass_fds=(fd,),
                start_new_session=True,  # a Ctrl-C ends the arm, and what was recorded of it until then is kept
            )
            allowed_s = patience_s(fd)
            try:
                async with asyncio.timeout(allowed_s + POLL_S):  # it ends itself, but not out of a dead network disk
                    while child.poll() is None:
                        await asyncio.sleep(POLL_S)
            except TimeoutError:
                self._say(f"the recording was not written within {allowed_s:.0f} s and was given up")
                return
            if child.returncode == 0:
                self._say(f"recorded: {_text(out)}; `rtarm explain` tells it")
            else:
                lines = _text(err).splitlines()
                why = lines[-1] if lines else f"the recording process ended with code {child.returncode}"
                self._say(f"not recorded: {why}")

    def _complain(self, what: str, problem: Exception) -> None:
        """One sentence, if there is memory for it."""
        with contextlib.suppress(Exception):
            if isinstance(problem, SharedMemoryError):
                why = str(problem)
            else:
                why = getattr(problem, "strerror", None) or str(problem) or type(problem).__name__
            self._say(f"{what}: {why}" if isinstance(problem, SharedMemoryError) else f"{what} ({why})")


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace").strip()
