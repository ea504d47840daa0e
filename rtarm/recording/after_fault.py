"""The launcher's part in recordings: it sees that a fault was latched or the control process died, and has it recorded.

It holds the state file open, so that nothing of it is lost whatever becomes of its name or its writer.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable

from rtarm.processes import plain_environment
from rtarm.recording.make import DEATH, FAULT
from shm import files
from shm.errors import SharedMemoryError
from shm.files import MemoryFile
from shm.words import Fault

POLL_S = 0.2
AFTERMATH_S = 2.0
"""So long after a fault its recording is made: every stop ends within this, and shows in it."""
PATIENCE_S = 60.0
KILLED_S = 1.0


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
        except SharedMemoryError as problem:
            self._say(f"faults will not be recorded: {problem}")
            await asyncio.Event().wait()
        while True:
            await asyncio.sleep(POLL_S)
            if self._unrecorded_ns():
                await asyncio.sleep(AFTERMATH_S)
                await self._write(FAULT)

    async def close(self, *, died: bool) -> None:
        """Make what is still to be made, of a fault just now or the death of the control process."""
        if self._memory is None:
            return
        try:
            if self._writing is not None:
                await self._writing
            if died:
                await self._write(DEATH)
            elif self._unrecorded_ns():
                await self._write(FAULT)
        finally:
            self._memory.close()
            self._memory = None

    def _unrecorded_ns(self) -> int:
        """When a fault was latched (CLOCK_MONOTONIC) that is not recorded yet; 0 when there is none."""
        assert self._memory is not None
        snapshot = self._memory.record["snapshot"]
        latched_ns = int(snapshot["fault_ns"])
        return latched_ns if int(snapshot["fault"]) != Fault.NONE and latched_ns != self._recorded_ns else 0

    async def _write(self, word: str) -> None:
        self._recorded_ns = self._unrecorded_ns() or self._recorded_ns
        self._writing = asyncio.create_task(self._run(word))
        await asyncio.shield(self._writing)
        self._writing = None

    async def _run(self, word: str) -> None:
        assert self._memory is not None
        fd = self._memory.fd
        try:
            child = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", "-m", "rtarm.recording", str(fd), self._arm, word),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                env=plain_environment(),
                pass_fds=(fd,),
                start_new_session=True,  # a Ctrl-C ends the arm, and what was recorded of it until then is kept
            )
        except OSError as problem:  # no memory, no processes left: the arm goes on all the same
            self._say(f"not recorded: no process could be started for it ({problem.strerror})")
            return
        try:
            async with asyncio.timeout(PATIENCE_S):
                out, err = await child.communicate()
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError, TimeoutError):
                child.kill()
                async with asyncio.timeout(KILLED_S):  # what hangs in a dead network disk does not even die
                    await child.wait()
            self._say(f"the recording was not written within {PATIENCE_S:g} s and was given up")
            return
        if child.returncode == 0:
            self._say(f"recorded: {out.decode().strip()}; `rtarm explain` tells it")
        else:
            lines = err.decode(errors="replace").strip().splitlines()
            self._say(f"not recorded: {lines[-1] if lines else 'the recording process failed and did not say why'}")
