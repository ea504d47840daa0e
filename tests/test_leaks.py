"""What a file of tests leaves behind is told, whatever it is."""

import contextlib
import os
import resource
import signal
import subprocess
from collections.abc import Callable, Iterator

import leaks
import pytest


def no_processes() -> list[str]:
    return []


def fewer_processors() -> Iterator[None]:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    yield
    os.sched_setaffinity(0, before)


def fewer_files() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft - 1, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def a_variable() -> Iterator[None]:
    os.environ["RTARM_LEFT"] = "1"
    yield
    del os.environ["RTARM_LEFT"]


def elsewhere() -> Iterator[None]:
    before = os.getcwd()
    os.chdir("/")
    yield
    os.chdir(before)


def another_mask() -> Iterator[None]:
    before = os.umask(0o077)
    yield
    os.umask(before)


def an_ignored_signal() -> Iterator[None]:
    before = signal.signal(signal.SIGUSR2, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGUSR2, before)


def a_blocked_signal() -> Iterator[None]:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR2})
    yield
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGUSR2})


def a_timer() -> Iterator[None]:
    signal.setitimer(signal.ITIMER_VIRTUAL, 1e6)
    yield
    signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


def an_open_pipe() -> Iterator[None]:
    ends = os.pipe()
    yield
    for end in ends:
        os.close(end)


@pytest.mark.parametrize(
    ("leak", "told"),
    [
        (fewer_processors, "scheduling: processors was"),
        (fewer_files, "limits: RLIMIT_NOFILE was"),
        (a_variable, "environment: RTARM_LEFT was not there, is '1'"),
        (elsewhere, "directory: directory was"),
        (another_mask, "directory: umask was"),
        (an_ignored_signal, "signals: SIGUSR2 was"),
        (a_blocked_signal, "signals: blocked was set(), is {<Signals.SIGUSR2"),
        (a_timer, "signals: ITIMER_VIRTUAL was 'off', is 'armed'"),
        (an_open_pipe, "is 'pipe:["),
    ],
)
def test_a_leak_is_told_and_its_end_as_well(leak: Callable[[], Iterator[None]], told: str) -> None:
    before = leaks.surroundings(no_processes)
    with contextlib.contextmanager(leak)():
        found = leaks.changes(before, leaks.surroundings(no_processes))
        assert any(told in sentence for sentence in found), found
    assert leaks.changes(before, leaks.surroundings(no_processes)) == []


def test_a_process_left_is_told_and_one_that_is_just_ending_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leaks, "LEAVE_TAKING_S", 0.0)
    before = leaks.surroundings(no_processes)
    assert leaks.left_by(before, lambda: ["4711 sim"]) == ["remains: 4711 sim was not there, is 'there'"]
    monkeypatch.undo()
    with subprocess.Popen(["sleep", "0.2"]) as ending:
        assert leaks.left_by(before, lambda: [] if ending.poll() is not None else ["sleep"]) == []
