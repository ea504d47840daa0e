"""`PYTHONPATH=tests python -m guardian COMMAND …`: run a command, of which no process is left, however it ends.

A guardian uses no ROS, so that it can end what hangs in code of the middleware, where no signal reaches Python. What it
guards may say what it is doing (`doing`); what then lasts longer than `LIMIT_S` is told with the stacks of all its
threads, and killed with all that it has started.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

LIMIT_S = 240.0
"""For one trial: some seconds as a rule; every wait within one is bounded, the longest by two minutes."""
END_S = 40.0
"""For an orderly end after SIGTERM."""
HUNG = 3
"""Exit code of what was ended by its guardian."""
POLL_S = 0.5
WORDS = "RTARM_GUARDIAN"
"""Process id of the guardian, and the descriptor on which it is told what begins."""
PR_SET_CHILD_SUBREAPER = 36


def is_guarded() -> bool:
    """Whether this process itself is what a guardian has started."""
    return os.environ.get(WORDS, "").partition(" ")[0] == str(os.getppid())


def doing(what: str) -> None:
    """Tell the guardian what begins now; its time begins with it."""
    if is_guarded():
        os.write(int(os.environ[WORDS].partition(" ")[2]), f"{what}\n".encode())


def guard(command: Sequence[str], limit_s: float | None = None) -> int:
    """Run a command; its exit code, or HUNG where it began nothing for `limit_s` (None: it may take for ever)."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # orphans become children of this process
    words, told = os.pipe()
    environment = {
        **os.environ,
        WORDS: f"{os.getpid()} {told}",
        "PYTHONFAULTHANDLER": "1",  # SIGABRT prints all stacks
    }
    guarded = subprocess.Popen(command, env=environment, pass_fds=(told,))
    os.close(told)

    def end(number: int, frame: FrameType | None) -> None:
        guarded.terminate()
        signal.setitimer(signal.ITIMER_REAL, END_S)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is for what is guarded
    signal.signal(signal.SIGALRM, lambda *_: guarded.kill())
    signal.signal(signal.SIGCHLD, lambda *_: _reap(guarded.pid))
    code = _watch(guarded, words, math.inf if limit_s is None else limit_s)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    for pid, what in end_descendants().items():
        print(f"left running, and killed: {what} (pid {pid})", file=sys.stderr)
    return code


def _watch(guarded: subprocess.Popen[bytes], words: int, limit_s: float) -> int:
    now, began_s = "its start", time.monotonic()
    while guarded.poll() is None:
        if select.select([words], [], [], POLL_S)[0]:
            said = os.read(words, 65536)
            if not said:
                return guarded.wait()
            now, began_s = said.decode(errors="replace").splitlines()[-1], time.monotonic()
        elif time.monotonic() - began_s > limit_s:
            print(f"VIOLATION hang: {now} lasts longer than {limit_s:g} s", file=sys.stderr, flush=True)
            guarded.send_signal(signal.SIGABRT)
            signal.setitimer(signal.ITIMER_REAL, END_S)
            guarded.wait()
            return HUNG
    return guarded.returncode


def _children() -> list[int]:
    return [int(word) for word in Path("/proc/self/task", str(os.getpid()), "children").read_text().split()]


def _reap(but: int) -> None:
    """Let orphans that have ended go, as init does."""
    for pid in _children():
        if pid != but:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)


def _command_of(pid: int) -> str:
    """Command line of a child of this process, as `ps` shows it, "" once it has ended."""
    process = Path(f"/proc/{pid}")
    line = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    has_ended = (process / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    return line or ("" if has_ended else f"[{(process / 'comm').read_text().strip()}]")  # none yet, amid its `exec`


def end_descendants() -> dict[int, str]:
    """Kill every process that this one, a subreaper, has below it; their commands by process id."""
    found: dict[int, str] = {}
    while True:
        for pid in _children():
            if command := _command_of(pid):  # what has ended and is not waited for has none
                found.setdefault(pid, command)
            os.kill(pid, signal.SIGKILL)
        try:
            os.waitpid(-1, 0)
        except ChildProcessError:
            return found


if __name__ == "__main__":
    sys.exit(guard(sys.argv[1:]))
