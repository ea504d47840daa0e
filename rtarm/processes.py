"""A child process as the launcher sees it: lines, readiness, end, and a death it shares with its parent."""

from __future__ import annotations

import asyncio
import ctypes
import importlib.util
import json
import os
import signal
import sys
import sysconfig
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
"""The folder that holds our packages, wherever rtarm is installed."""

READY = "ready"
"""First word of the line with which a child says that it is."""

WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Set: the ROS wheels' start-up file does not start Python again with their library path."""

PR_SET_PDEATHSIG = 1

LineHandler = Callable[[str], None]


def plain_environment() -> dict[str, str]:
    """Environment of a child that needs no ROS: Python starts once, and finds our packages."""
    return {**_common_environment(), WHEELS_GUARD: "1"}


def ros_environment() -> dict[str, str]:
    """Environment of a child that uses ROS.

    Where the wheels have already given this process their library path, the child takes it over and starts
    once; where that path is missing, the guard is removed so that the wheels' start-up file adds it. An installation
    that is sourced goes before wheels that are there as well: the child sees no library of theirs.
    """
    environment = _common_environment()
    of_wheels = _libraries_of_wheels()
    inherited = [part for part in environment.get("LD_LIBRARY_PATH", "").split(os.pathsep) if part]
    if _ros_is_sourced():
        environment[WHEELS_GUARD] = "1"
        environment["LD_LIBRARY_PATH"] = os.pathsep.join(part for part in inherited if part not in of_wheels)
    elif of_wheels[0] not in inherited:
        environment.pop(WHEELS_GUARD, None)
    return _with_generated(environment)


def _libraries_of_wheels() -> list[str]:
    """The folders that the ROS wheels' start-up file adds to the path of libraries."""
    site_packages = Path(sysconfig.get_path("purelib"))
    return [str(Path(sysconfig.get_path("data")) / "lib"), *map(str, site_packages.glob("ros_*.libs"))]


def _ros_is_sourced() -> bool:
    """Whether rclpy comes from somewhere else than this environment."""
    rclpy = importlib.util.find_spec("rclpy")
    origin = Path(rclpy.origin) if rclpy is not None and rclpy.origin is not None else None
    return origin is not None and not origin.resolve().is_relative_to(Path(sysconfig.get_path("purelib")).resolve())


def _with_generated(environment: dict[str, str]) -> dict[str, str]:
    """Let a child find the message types that were generated at first use, if they were."""
    try:
        from rtarm_interfaces import build
    except ImportError:  # a ROS workspace builds them itself, and its copy of rtarm is without their definitions
        return environment
    if not build.lacking() or not build.cache().prefix.is_dir():
        return environment
    return build.search_paths(build.cache(), environment)


def _common_environment() -> dict[str, str]:
    # In site-packages ours are found anyhow, and in front they would take their neighbours before a sourced ROS.
    ours = [] if Path(sysconfig.get_path("purelib")) == ROOT else [str(ROOT)]
    search = [*ours, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONPATH": os.pathsep.join(search)}


def report(event: str, **fields: Any) -> None:
    """One line of JSON for the process that started this one; in one piece, whichever thread says it."""
    sys.stdout.write(json.dumps({"event": event, **fields}) + "\n")
    sys.stdout.flush()


def has_module(name: str) -> bool:
    """Whether a module can be imported, without importing it."""
    return importlib.util.find_spec(name) is not None


def shared_death() -> Callable[[], None]:
    """For `preexec_fn`: when this process dies, even by kill -9, the kernel sends the child SIGTERM."""
    parent = os.getpid()
    prctl = ctypes.CDLL(None, use_errno=True).prctl

    def share() -> None:
        prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
        if os.getppid() != parent:  # it died before the request was made
            os._exit(1)

    return share


class Child:
    """A running Python module of ours.

    Its lines go to `on_line`, the ready line excepted. When this process dies, even by kill -9, the kernel
    sends the child SIGTERM; a terminal's Ctrl-C does not reach it, so that the launcher decides the order.

    Attributes:
        name: what it is called in front of its lines.
        was_ready: its ready line has been seen.
        last_line: the last line it wrote to standard error, "" if none.
    """

    def __init__(self, name: str, process: asyncio.subprocess.Process, on_line: LineHandler) -> None:
        self.name = name
        self.was_ready = False
        self.last_line = ""
        self._process = process
        self._on_line = on_line
        self._ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._end = asyncio.create_task(self._live())

    @classmethod
    async def start(
        cls,
        name: str,
        module: str,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        on_line: LineHandler,
        *,
        told: bool = False,
    ) -> Child:
        """Start `python -m module arguments`; call it in the main thread, whose end is the child's end.

        With `told` the child reads, on its standard input, what `tell` says.
        """
        process = await asyncio.create_subprocess_exec(
            # -P: a folder called config where the user happens to stand is not our package.
            *(sys.executable, "-P", "-m", module, *arguments),
            stdin=asyncio.subprocess.PIPE if told else asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env=dict(environment),
            process_group=0,
            preexec_fn=shared_death(),
        )
        return cls(name, process, on_line)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def tell(self, line: str) -> None:
        """Write a line to its standard input; what has ended hears nothing."""
        if self._process.stdin is not None:
            self._process.stdin.write(f"{line}\n".encode())

    def hang_up(self) -> None:
        """Close its standard input: who obeys what is told ends in order then."""
        if self._process.stdin is not None:
            self._process.stdin.close()

    async def ready(self) -> str | None:
        """What followed "ready" on its ready line; None when the child ends without one."""
        await asyncio.wait((self._ready, self._end), return_when=asyncio.FIRST_COMPLETED)
        return self._ready.result() if self._ready.done() else None

    async def ended(self) -> int:
        """Its exit code (negative: the signal), once it has ended and all its lines are said."""
        return await asyncio.shield(self._end)

    @property
    def has_ended(self) -> bool:
        """Whether it has."""
        return self._end.done()

    @property
    def code(self) -> int | None:
        """Its exit code once it has ended."""
        return self._end.result() if self._end.done() else None

    def ask_to_end(self) -> None:
        """SIGTERM; asked again, it does nothing more before its end."""
        self._send(signal.SIGTERM)

    async def stop(self, patience_s: float) -> bool:
        """SIGTERM, and SIGKILL when that has no effect; says whether SIGTERM was enough."""
        if self._end.done():
            return True
        self.ask_to_end()
        done, _ = await asyncio.wait((self._end,), timeout=patience_s)
        if done:
            return True
        self._send(signal.SIGKILL)
        await asyncio.wait((self._end,))
        return False

    def _send(self, number: int) -> None:
        if self._process.returncode is None:
            self._process.send_signal(number)

    async def _live(self) -> int:
        out, err = self._process.stdout, self._process.stderr
        assert out is not None and err is not None
        readers = [
            asyncio.create_task(_read_lines(out, self._take_output)),
            asyncio.create_task(_read_lines(err, self._take_error)),
        ]
        code = await self._process.wait()
        # A grandchild may keep the pipes open; what the child itself wrote is there at once.
        await asyncio.wait(readers, timeout=0.5)
        for reader in readers:
            reader.cancel()
        return code

    def _take_output(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        if word == READY and not self._ready.done():
            self.was_ready = True
            self._ready.set_result(rest.strip())
        else:
            self._on_line(line)

    def _take_error(self, line: str) -> None:
        self.last_line = line
        self._on_line(line)


async def _read_lines(stream: asyncio.StreamReader, take: LineHandler) -> None:
    rest = b""
    while chunk := await stream.read(65536):
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            if line.strip():
                take(line.decode(errors="replace").rstrip())
    if rest.strip():
        take(rest.decode(errors="replace").rstrip())


def describe_end(code: int) -> str:
    """How a process ended, for a sentence: `with exit code 3`, `by SIGKILL`."""
    if code >= 0:
        return f"with exit code {code}"
    try:
        return f"by {signal.Signals(-code).name}"
    except ValueError:
        return f"by signal {-code}"
