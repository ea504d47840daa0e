"""What a check may look at: files below a root, the environment, and a trial of what the control process asks for.

Everything is injectable, so that a test is a folder with a few files. What cannot be read raises `Unknown`, which
becomes a note: never a crash, and never silently good.
"""

from __future__ import annotations

import functools
import gzip
import json
import os
import re
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rtarm.doctor import trial as trial_program
from rtarm.doctor.finding import Found, note

READ_LIMIT = 1 << 20
"""No file that a check reads is longer (bytes)."""
LONGEST_NUMBER = 20
HIGHEST_CPU = 4095
LOCKED_BYTES = 32 << 20
"""Memory that the control process locks (15 MB), with room."""
COMMAND_S = 10.0
KERNEL_THREAD = 0x0020_0000
"""Bit of a thread's flags in /proc/PID/stat (PF_KTHREAD)."""


class Unknown(Exception):
    """What a check wanted to know cannot be found out here; the text says why."""


def settled(look: Callable[[], Found]) -> Found:
    """What a look found; what cannot be found out is a note that says so."""
    try:
        return look()
    except (Unknown, OSError) as problem:
        return note(f"unknown: {problem}")


@dataclass(frozen=True)
class Granted:
    """What the system gave a trial process; refusals are its words, None where it agreed."""

    fifo: bool
    priority: int
    scheduling_refusal: str | None
    locked: bool
    lock_refusal: str | None
    latency_refusal: str | None
    cpu_refusal: str | None


@dataclass(frozen=True)
class Thread:
    """A thread as /proc tells it; policy 0 is ordinary, 1 FIFO, 2 RR, 6 deadline."""

    pid: int
    tid: int
    name: str
    of_kernel: bool
    policy: int
    priority: int


def try_permissions(priority: int, cpu: int | None) -> Granted:
    """Ask for what the control process will ask for in a child process, and read back what was granted."""
    wanted = [priority, LOCKED_BYTES] if cpu is None else [priority, LOCKED_BYTES, cpu]
    command = [sys.executable, "-I", "-S", trial_program.__file__, *map(str, wanted)]
    try:
        return Granted(**json.loads(_output(command)))
    except (ValueError, TypeError) as problem:
        raise Unknown(f"the trial in a child process gave no answer ({problem})") from None


def can_links() -> Any:
    """The CAN interfaces as `ip` tells them."""
    try:
        return json.loads(_output(["ip", "-json", "-details", "link", "show", "type", "can"]) or "[]")
    except ValueError:
        raise Unknown("`ip` gave no JSON, it is too old") from None


def compiled_folder() -> Path:
    """Where the compiled cycle of these very sources lies, or will lie."""
    try:
        from compilation import cache
    except ImportError as problem:
        raise Unknown(f"the compiler cannot be loaded ({problem})") from None
    return cache.folder()


def _output(command: list[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as problem:
        raise Unknown(f"`{Path(command[0]).name}` cannot be run ({problem})") from None
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise Unknown(f"`{Path(command[0]).name}` failed ({reason})")
    return done.stdout


@dataclass(frozen=True)
class Machine:
    """A machine to look at; with no arguments, this one."""

    root: Path = Path("/")
    environment: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    trial: Callable[[int, int | None], Granted] = field(default_factory=lambda: functools.cache(try_permissions))
    can_links: Callable[[], Any] = can_links
    compiled_folder: Callable[[], Path] = compiled_folder
    may_access: Callable[[Path, int], bool] = os.access
    space: Callable[[Path], os.statvfs_result] = os.statvfs
    clock_resolution_s: float = field(default_factory=lambda: time.clock_getres(time.CLOCK_MONOTONIC))

    def path(self, name: str) -> Path:
        """Where the file with this absolute name lies."""
        return self.root / name.lstrip("/")

    def name_of(self, path: Path) -> str:
        """The absolute name of a file below the root."""
        return "/" + str(path.relative_to(self.root))

    def real(self, name: str) -> Path:
        """The file behind all links; the root itself must be free of them."""
        try:
            return self.path(name).resolve()
        except (OSError, ValueError, RuntimeError) as problem:
            raise Unknown(f"{name} leads nowhere ({problem})") from None

    def exists(self, name: str) -> bool:
        return os.path.exists(self.path(name))

    def text(self, name: str) -> str:
        """A file without its outer white space.

        Raises:
            Unknown: it is missing or cannot be read.
        """
        return self._bytes(name).decode("utf-8", errors="replace").strip()

    def _bytes(self, name: str) -> bytes:
        try:
            with open(self.path(name), "rb") as file:
                return file.read(READ_LIMIT)
        except OSError as problem:
            raise Unknown(f"{name} cannot be read ({problem.strerror})") from None
        except ValueError:
            raise Unknown(f"{name!r} is no name of a file") from None

    def number(self, name: str, base: int = 10) -> int:
        """A file that holds one whole number."""
        text = self.text(name)
        try:
            return int(text if len(text) <= LONGEST_NUMBER else "", base)
        except ValueError:
            raise Unknown(f"{name} says {text[:40]!r}, which is no number") from None

    def cpus(self, name: str) -> frozenset[int]:
        """A file that lists processors, such as 0-3,6."""
        return cpu_list(self.text(name), name)

    def names(self, name: str) -> list[str]:
        """What a folder holds, sorted; numbers in the names count as numbers."""
        try:
            return sorted(os.listdir(self.path(name)), key=_natural)
        except OSError as problem:
            raise Unknown(f"{name} cannot be listed ({problem.strerror})") from None

    def own(self, key: str) -> str:
        """A line of this process' status, such as Cpus_allowed_list."""
        found = re.search(rf"^{key}:\s*(.*)$", self.text("/proc/self/status"), re.MULTILINE)
        if found is None:
            raise Unknown(f"/proc/self/status has no {key}")
        return found.group(1).strip()

    @property
    def is_root(self) -> bool:
        try:
            return self.own("Uid").split()[1] == "0"
        except (Unknown, IndexError):
            return False

    def kernel_option(self, option: str) -> str | None:
        """How the kernel was built: `y`, a number, or None for an option that is not set."""
        found = re.search(rf"^{option}=(.*)$", self._kernel_options(), re.MULTILINE)
        return None if found is None else found.group(1)

    def _kernel_options(self) -> str:
        if self.exists("/proc/config.gz"):
            try:
                with gzip.open(self.path("/proc/config.gz")) as file:
                    return file.read(READ_LIMIT).decode("utf-8", errors="replace")
            except (OSError, EOFError, zlib.error):
                raise Unknown("/proc/config.gz cannot be unpacked") from None
        return self.text(f"/boot/config-{self.text('/proc/sys/kernel/osrelease')}")

    def threads(self) -> Iterator[Thread]:
        """All threads there are.

        Raises:
            Unknown: those of others are hidden.
        """
        self.text("/proc/1/stat")
        for pid in self._numbers("/proc"):
            for tid in self._numbers(f"/proc/{pid}/task"):
                try:
                    yield _thread(pid, tid, self.text(f"/proc/{pid}/task/{tid}/stat"))
                except Unknown:  # it has ended meanwhile
                    continue

    def process_names(self) -> dict[int, str]:
        """Name of every process, by its pid; raises Unknown as `threads` does."""
        self.text("/proc/1/comm")
        found = {}
        for pid in self._numbers("/proc"):
            try:
                found[pid] = self.text(f"/proc/{pid}/comm")
            except Unknown:
                continue
        return found

    def holders(self, device: Path) -> list[int]:
        """Pids of the processes that have a file open, as far as this user may see them."""
        return [pid for pid in self._numbers("/proc") if self._holds(pid, device)]

    def _holds(self, pid: int, device: Path) -> bool:
        try:
            with os.scandir(self.path(f"/proc/{pid}/fd")) as descriptors:
                return any(os.path.realpath(descriptor.path) == str(device) for descriptor in descriptors)
        except OSError:  # it has ended, or is somebody else's
            return False

    def _numbers(self, folder: str) -> list[int]:
        try:
            return sorted(int(name) for name in os.listdir(self.path(folder)) if re.fullmatch("[0-9]{1,10}", name))
        except OSError:
            return []


def cpu_list(text: str, source: str) -> frozenset[int]:
    """The processors of a list such as 0-3,6; empty text is none of them."""
    found: set[int] = set()
    for part in filter(None, text.split(",")):
        span = re.fullmatch(r"([0-9]{1,4})(?:-([0-9]{1,4}))?", part)
        if span is None:
            raise Unknown(f"{source} says {text[:40]!r}, which is no list of processors")
        first = int(span.group(1))
        found.update(range(first, min(int(span.group(2) or first), HIGHEST_CPU) + 1))
    return frozenset(found)


def _thread(pid: int, tid: int, stat: str) -> Thread:
    name, _, rest = stat.partition("(")[2].rpartition(")")
    try:
        fields = [int(word) for word in rest.split()[1:]]  # proc(5) counts from 1, and the first left is number 4
        return Thread(pid, tid, name, bool(fields[9 - 4] & KERNEL_THREAD), fields[41 - 4], fields[40 - 4])
    except (ValueError, IndexError):
        raise Unknown(f"/proc/{pid}/task/{tid}/stat cannot be understood") from None


def _natural(name: str) -> list[tuple[str, int]]:
    return [(word, int(digits or 0)) for word, digits in re.findall(r"([^0-9]*)([0-9]{0,9})", name)]
