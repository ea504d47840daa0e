"""Why the cycles of an arm are late, for a picture that is drawn again and again; through restarts of the arm."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from rtarm.console.errors import Refusal
from rtarm.console.language import said
from rtarm.running.status import open_running
from rtarm.top.watch import Because, Why
from rtarm.why_late.report import Tally, cause_word, names_told
from rtarm.why_late.run import beside
from rtarm.why_late.tracefs import NotTraced
from rtarm.why_late.watch import Watcher
from sentences.meaning import Language
from shm import files
from shm.errors import SharedMemoryError

BOUND_NS = 100_000
AGAIN_S = 0.5
"""After so long it is seen that the control process has ended, and tried to find another one."""
MOST_CAUSES = 4


class _Causes:
    """What has been found so far, for whoever draws."""

    def __init__(self, language: Language) -> None:
        self._language = language
        self._tally = Tally()
        self._hint = ""
        self._watcher: Watcher | None = None

    def follow(self, watcher: Watcher) -> None:
        """From now on what this one finds comes in too."""
        self._take()
        self._watcher = watcher

    def refused(self, reason: NotTraced) -> None:
        """There will be none."""
        self._hint = reason.told(self._language)

    def told(self) -> Why:
        """Everything until now."""
        self._take()
        found = self._tally.causes()[:MOST_CAUSES]
        if self._hint or not found:
            bound_us = BOUND_NS / 1000
            none = said(self._language, "Since this began no cycle was later than {bound:g} µs.", bound=bound_us)
            return Why((), self._hint or none)
        return Why(
            tuple(
                Because(
                    cause_word(one["cause"], self._language),
                    names_told(one["mostly"][0]["who"], self._language) if one["mostly"] else "",
                    one["share"],
                    one["cycles"],
                    one["worst"]["us"] if one["worst"] else None,
                )
                for one in found
            )
        )

    def _take(self) -> None:
        """Take the late cycles from the watcher, which goes on adding some behind them."""
        if self._watcher is not None:
            taken = self._watcher.late[:]
            del self._watcher.late[: len(taken)]
            for late in taken:
                self._tally.add(late)


@contextlib.contextmanager
def live(arm: str, language: Language = "en") -> Iterator[Callable[[], Why]]:
    """What there is to be told of an arm now; it is found by threads of its own meanwhile."""
    causes, ended = _Causes(language), threading.Event()
    thread = threading.Thread(target=_follow, args=(arm, causes, ended))
    thread.start()
    try:
        yield causes.told
    finally:
        ended.set()
        thread.join()


def _follow(arm: str, causes: _Causes, ended: threading.Event) -> None:
    while not ended.is_set():
        try:
            with contextlib.closing(open_running(arm)) as memory, beside(memory, BOUND_NS) as watcher:
                causes.follow(watcher)
                while files.is_held(memory.fd) and not ended.wait(AGAIN_S):
                    pass
        except NotTraced as reason:
            causes.refused(reason)
            return
        except (Refusal, SharedMemoryError, OSError):  # there is no control process just now
            ended.wait(AGAIN_S)
