"""What the process that runs the tests is to the system: what one file of tests changes, all that follow would have."""

from __future__ import annotations

import contextlib
import gc
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

LEAVE_TAKING_S = 10.0
"""For what is just ending, on a busy machine; nobody waits where nothing is left."""
_LIMITS = {name: getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")}
_TIMERS = {name: getattr(signal, name) for name in ("ITIMER_VIRTUAL", "ITIMER_PROF")}
_OF_PYTEST = ("PYTEST_CURRENT_TEST",)
_OF_PYTEST_TIMEOUT = (signal.SIGALRM,)


class Left(AssertionError):
    """A file of tests has left something behind. Its end was waited for: the machine's speed has no part in it."""


class Surroundings(NamedTuple):
    """Everything that a process hands on to those it starts, or that they would meet."""

    scheduling: dict[str, object]
    limits: dict[str, object]
    environment: dict[str, object]
    directory: dict[str, object]
    signals: dict[str, object]
    descriptors: dict[str, object]
    remains: dict[str, object]


def surroundings(remains: Callable[[], list[str]]) -> Surroundings:
    """Of this process, now; `remains` lists what it has started that still runs, and files that it has made."""
    return Surroundings(
        scheduling={
            "priority": os.getpriority(os.PRIO_PROCESS, 0),
            "policy": os.sched_getscheduler(0),
            "real-time priority": os.sched_getparam(0).sched_priority,
            "processors": os.sched_getaffinity(0),
            "locked memory": _locked_memory(),
        },
        limits={name: resource.getrlimit(number) for name, number in _LIMITS.items()},
        environment={name: text for name, text in os.environ.items() if name not in _OF_PYTEST},
        directory={"directory": os.getcwd(), "umask": _umask()},
        signals={
            **{number.name: signal.getsignal(number) for number in signal.Signals if number not in _OF_PYTEST_TIMEOUT},
            **{name: "armed" if signal.getitimer(number)[0] else "off" for name, number in _TIMERS.items()},
            "blocked": signal.pthread_sigmask(signal.SIG_BLOCK, ()),
        },
        descriptors=_descriptors(),
        remains=dict.fromkeys(remains(), "there"),
    )


def left_by(before: Surroundings, remains: Callable[[], list[str]]) -> list[str]:
    """What is not as it was, a sentence each."""
    deadline = time.monotonic() + LEAVE_TAKING_S
    while (found := changes(before, surroundings(remains))) and time.monotonic() < deadline:
        gc.collect()  # what nobody holds any more is closed
        time.sleep(0.01)
    return found


def changes(before: Surroundings, after: Surroundings) -> list[str]:
    """What differs between two looks, a sentence each; garbage that has been collected is no difference."""
    return [
        f"{kind}: {name} was {_told(was, name)}, is {_told(now, name)}"
        for kind, was, now in zip(Surroundings._fields, before, after, strict=True)
        for name in sorted(was.keys() | now.keys())
        if was.get(name) != now.get(name) and (kind != "descriptors" or name in now)
    ]


def _told(values: Mapping[str, object], name: str) -> str:
    return repr(values[name]) if name in values else "not there"


def _descriptors() -> dict[str, object]:
    """What each of them leads to."""
    found: dict[str, object] = {}
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the listing's own
            target = os.readlink(link)
            if not target.startswith(sys.prefix):  # libraries keep files of theirs: matplotlib its fonts
                found[link.name] = target
    return found


def _locked_memory() -> bool:
    """Whether mlockall holds this process in memory."""
    status = Path("/proc/self/status").read_text()
    return "VmLck:\t       0 kB" not in status


def _umask() -> str:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("Umask:"))
    return line.split()[1]
