"""`rtarm why-late`: watch a running arm for a while, and tell why its cycles were late."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rtarm.console.errors import Refusal
from rtarm.console.interrupt import signals_noted
from rtarm.console.language import said
from rtarm.console.niceness import done_by, nice_thread
from rtarm.running.status import open_running, resolve_arm
from rtarm.why_late import plot
from rtarm.why_late.hints import Hints
from rtarm.why_late.report import report_of
from rtarm.why_late.tracefs import NotTraced, traced
from rtarm.why_late.watch import KEPT_NS, LOOK_S, ArmCycles, Source, Traced, Watcher, cpu_of, cycle_thread
from sentences.meaning import Language
from shm import files
from shm.files import MemoryFile

SHORTEST_S, LONGEST_S = 0.5, 86_400.0
READING_NICE = -10
LEAST_US, MOST_US = 10.0, 1_000_000.0


def why_late(
    arm: str | None, seconds: float, bound_us: float, plot_file: Path | None, language: Language = "en"
) -> dict[str, Any]:
    """Watch for so many seconds, or until a signal; what was found, with notes in a language.

    Raises:
        Refusal, SharedMemoryError: there is no such arm, or what was asked for makes no sense.
    """
    for name, value, unit, least, most in (
        ("--seconds", seconds, "s", SHORTEST_S, LONGEST_S),
        ("--bound-us", bound_us, "µs", LEAST_US, MOST_US),
    ):
        if not least <= value <= most:
            raise Refusal(
                said(
                    language,
                    "`{name}` is {value:g}, allowed are {least:g} to {most:g} {unit}: give another one.",
                    **{"name": name, "value": value, "least": least, "most": most, "unit": unit},
                )
            )
    if plot_file is not None:
        plot.check(plot_file)
    memory = open_running(resolve_arm(arm, language))
    try:
        report = _watched(memory, seconds, bound_us, language)
    finally:
        memory.close()
    if plot_file is not None:
        plot.draw(report, plot_file)
    return report


def _watched(memory: MemoryFile, seconds: float, bound_us: float, language: Language) -> dict[str, Any]:
    name, pid = files.arm_name(memory.record["header"]), int(memory.record["header"]["pid"])
    notes: list[str] = []
    try:
        tid = cycle_thread(memory)
    except OSError as error:
        raise Refusal(
            said(
                language,
                "The control process of {arm} (pid {pid}) cannot be looked at ({why}): run this as the same user, on "
                "the same machine and in the same container.",
                **{"arm": name, "pid": pid, "why": error.strerror},
            )
        ) from None
    with signals_noted() as wait, looker(tid) as thread, contextlib.ExitStack() as stack:
        hints: Hints | None = None
        trace: Traced = str  # nothing, so that nothing is known but that a cycle was late
        try:
            trace = stack.enter_context(traced(tid)).read
        except NotTraced as reason:
            told = reason.told(language)
            notes.append(said(language, "{reason} Without them no causes are known.", reason=told))
            hints = Hints(tid)
        watcher = Watcher(ArmCycles(memory), tid, trace, round(bound_us * 1000))
        began_s, ended = time.monotonic(), False
        while not ended:
            rest_s = began_s + seconds - time.monotonic()
            ended = bool(wait(min(LOOK_S, rest_s))) or rest_s <= LOOK_S
            late = watcher.count
            done_by(thread, watcher.look)
            if hints is not None:
                hints.look(late=watcher.count > late)
            if not ended and not files.is_held(memory.fd):
                notes.append(said(language, "The control process has ended meanwhile."))
                ended = True
        report = report_of(name, time.monotonic() - began_s, bound_us, watcher, notes)
        return {**report, "traced": hints is None, "hints": [] if hints is None else hints.told()}


@contextlib.contextmanager
def beside(memory: MemoryFile, bound_ns: int) -> Iterator[Watcher]:
    """A watcher of an arm that looks by itself meanwhile; its findings are complete at the end.

    Raises:
        NotTraced: trace events cannot be read here.
        OSError: the control process is gone.
    """
    with watching(ArmCycles(memory), cycle_thread(memory), bound_ns) as watcher:
        yield watcher


@contextlib.contextmanager
def watching(source: Source, tid: int, bound_ns: int, kept_ns: int = KEPT_NS) -> Iterator[Watcher]:
    """The same of any thread whose cycles a source knows, `kept_ns` after they ended at the latest.

    Raises:
        NotTraced: trace events cannot be read here.
    """
    ended = threading.Event()
    with traced(tid) as trace, looker(tid) as thread:
        watcher = Watcher(source, tid, trace.read, bound_ns, kept_ns)

        def look_on() -> None:
            while not ended.wait(LOOK_S):
                watcher.look()
            watcher.look(settle_ns=0)

        looking = thread.submit(look_on)
        try:
            yield watcher
        finally:
            ended.set()
            looking.result()


def looker(tid: int) -> ThreadPoolExecutor:
    """A thread that reads the trace and uses other processors than the cycle's, where there are others.

    Beside a cycle of real-time priority it goes before other ordinary ones, else it would not keep up with the events
    of a busy machine; beside any other it is of the lowest priority.
    """
    cpu = cpu_of(tid)
    with contextlib.suppress(ProcessLookupError):  # who watches notices that it is gone
        if os.sched_getparam(tid).sched_priority > 0:
            return ThreadPoolExecutor(max_workers=1, initializer=_keep_up, initargs=(cpu,))
    thread = nice_thread()
    thread.submit(_keep_off, cpu).result()
    return thread


def _keep_up(cpu: int) -> None:
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), READING_NICE)
    _keep_off(cpu)


def _keep_off(cpu: int) -> None:
    """This thread uses other processors than the cycle's, where there are others."""
    others = os.sched_getaffinity(0) - {cpu}
    if others:
        os.sched_setaffinity(threading.get_native_id(), others)
