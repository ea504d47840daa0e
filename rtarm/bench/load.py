"""What keeps the machine busy in loaded slices: stress-ng, or hogs of our own where it is not installed."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from rtarm.bench.program import Program
from rtarm.console.errors import Refusal
from rtarm.processes import Child, describe_end, plain_environment

SETTLE_S = 0.3
"""Until all of it runs."""
STOP_S = 2.0


def command(folder: Path) -> list[str]:
    """stress-ng with computing, memory and disk, without end."""
    return [
        *("stress-ng", "--quiet", "--timeout", "0", "--temp-path", str(folder)),
        *("--cpu", str(os.cpu_count() or 1), "--vm", "1", "--vm-bytes", "128M", "--hdd", "1", "--hdd-bytes", "64M"),
    ]


def described() -> str:
    """The load in words."""
    if shutil.which("stress-ng"):
        return " ".join(argument for argument in command(Path("DIR")))
    return f"own hogs, stress-ng not installed: {os.cpu_count() or 1} × cpu, 1 × memory, 1 × disk"


@asynccontextmanager
async def loaded(folder: Path, *, wanted: bool) -> AsyncIterator[None]:
    """Keep the machine busy within, if that is wanted; files go to `folder`.

    Raises:
        Refusal: the load does not start.
    """
    async with AsyncExitStack() as stack:
        if wanted and shutil.which("stress-ng"):
            program = Program()
            stack.push_async_callback(program.stop)
            await program.start(*command(folder))
            await asyncio.sleep(SETTLE_S)
            if program.has_ended:
                code, output = await program.ended(STOP_S)
                raise Refusal(f"stress-ng ended {describe_end(code)}: {output.strip()[-200:] or 'it said nothing'}")
        elif wanted:
            for kind in ["cpu"] * (os.cpu_count() or 1) + ["memory", "disk"]:
                hog = await Child.start(
                    "hog", "rtarm.bench.hogs", [kind, str(folder)], plain_environment(), lambda _: None
                )
                stack.push_async_callback(hog.stop, STOP_S)
                if await hog.ready() is None:
                    raise Refusal(f"The {kind} load ended {describe_end(await hog.ended())} instead of starting.")
            await asyncio.sleep(SETTLE_S)
        yield
