"""Commands that work at the lowest priority leave that of the process alone which runs them: it may be anybody's."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import Result
from written_arm import WrittenArm

from config.loader import load_arm
from rtarm.console.interrupt import signals_to
from rtarm.recording.follow import Follower
from rtarm.top.terminal import run
from rtarm.top.watch import Watch

LOWEST = 19
PATIENCE_S = 30.0


def own_niceness() -> set[int]:
    """Of all threads of this process."""
    found = set()
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(ProcessLookupError):  # it has ended just now
            found.add(os.getpriority(os.PRIO_PROCESS, int(thread)))
    return found


def test_a_thread_that_has_just_ended_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = subprocess.Popen(["true"])  # gone when it was waited for; a thread may stay for a moment
    ended.wait()
    threads = [str(ended.pid), str(threading.get_native_id())]
    monkeypatch.setattr(os, "listdir", lambda _: threads)
    assert len(own_niceness()) == 1


@pytest.fixture(autouse=True)
def niceness_stays() -> Iterator[None]:
    if os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) == LOWEST:
        pytest.skip("the tests run at the lowest priority themselves, where nobody can tell what a command changes")
    before = own_niceness()
    assert LOWEST not in before
    yield
    deadline = time.monotonic() + PATIENCE_S
    while own_niceness() != before and time.monotonic() < deadline:
        time.sleep(0.01)  # the kernel shows a thread for a moment longer than Python does
    assert own_niceness() == before


@pytest.fixture
def worked_at(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[int]]:
    """`worked_at(Kind, "method", then)`: the niceness with which a method is called; `then` follows each call."""

    def watch(kind: type, name: str, then: Callable[..., object] = lambda *_: None) -> list[int]:
        levels: list[int] = []
        work = getattr(kind, name)

        def watched(*arguments: Any) -> Any:
            levels.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
            result = work(*arguments)
            then()
            return result

        monkeypatch.setattr(kind, name, watched)
        return levels

    return watch


def to_this_thread(number: int) -> None:
    """A signal to the process, which the kernel gives to whom it wants: it does not wake the main thread."""
    signal.pthread_kill(threading.get_ident(), number)


@pytest.mark.parametrize("options", [["-f"], ["--for", "0.1"]], ids=["until Ctrl-C", "for a time"])
def test_a_recording_that_goes_on(
    arm: WrittenArm,
    rtarm: Callable[..., Result],
    worked_at: Callable[..., list[int]],
    tmp_path: Path,
    options: list[str],
) -> None:
    levels = worked_at(Follower, "take", lambda: to_this_thread(signal.SIGINT))
    result = rtarm("record", arm.name, *options, "-o", str(tmp_path / "on.mcap"))
    assert "has not run a cycle meanwhile" in result.stderr  # nobody runs this arm
    assert levels and set(levels) == {LOWEST}


@contextlib.contextmanager
def at_terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Standard input and output are a terminal; what is written to this descriptor are keys."""
    master, slave = os.openpty()

    def drain() -> None:
        with contextlib.suppress(OSError):  # nobody has the other end open any more
            while os.read(master, 65536):
                pass

    drained = threading.Thread(target=drain)
    drained.start()
    with monkeypatch.context() as patch, os.fdopen(slave, "r") as keyboard, os.fdopen(os.dup(slave), "w") as screen:
        patch.setenv("TERM", "xterm-256color")
        patch.setattr(sys, "stdin", keyboard)
        patch.setattr(sys, "stdout", screen)
        yield master
    drained.join()
    os.close(master)


def test_an_arm_watched_in_the_terminal(
    arm: WrittenArm, worked_at: Callable[..., list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    with at_terminal(monkeypatch) as terminal:
        levels = worked_at(Watch, "look", lambda: os.write(terminal, b"q"))
        run(arm.name)
    assert levels and set(levels) == {LOWEST}


def test_a_page_in_the_browser(worked_at: Callable[..., list[int]]) -> None:
    pytest.importorskip("viser")
    from viser.infra import WebsockServer

    from rtarm.view.gate import open_server
    from rtarm.view.page import Page
    from rtarm.view.run import serve
    from rtarm.view.words import ENGLISH

    arm = load_arm("mock")
    threads_of_server = worked_at(WebsockServer, "_background_worker")
    levels = worked_at(Page, "__init__", lambda: to_this_thread(signal.SIGTERM))
    source = SimpleNamespace(joints=tuple(joint.name for joint in arm.joints), close=lambda: None)
    with signals_to(signal.SIG_DFL):  # a page that has been ended lets nobody end its process once more
        serve(open_server().server, arm, source, None, ENGLISH)
    assert threads_of_server == levels == [LOWEST]
