"""What hangs is told with its stacks and killed, and whatever a command ends by, nothing of it is left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PATIENCE_S = 30.0

GUARD = "import sys, guardian; sys.exit(guardian.guard(sys.argv[2:], float(sys.argv[1])))"
"""The command follows the limit in seconds."""

ORPHAN = (
    "import subprocess, sys, waiting; orphan = subprocess.Popen(['sleep', '1000'], start_new_session=True).pid;"
    "waiting.until(lambda: open(f'/proc/{orphan}/cmdline').read(), 'a command line'); print(orphan, flush=True);"
)
"""Begins a program that leaves a process in a session of its own, and prints its process id."""

STUCK = (
    "import ctypes, guardian, threading; lock = threading.Lock(); lock.acquire();"
    "guardian.doing('trial 7'); ctypes.PyDLL(None).pause()"  # with the interpreter's lock held: no Python runs any more
)


def guarded(limit_s: float, program: str, stdin: int | None = None) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", GUARD, str(limit_s), sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT / "tests")},
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def is_gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


@pytest.mark.process
def test_what_hangs_in_c_code_is_told_with_its_stacks_and_killed_with_what_it_started() -> None:
    with guarded(1.0, ORPHAN + STUCK) as process:
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 3
    assert "VIOLATION hang: trial 7 lasts longer than 1 s" in err
    assert 'File "<string>", line 1 in <module>' in err
    assert "left running, and killed: sleep 1000" in err
    assert is_gone(int(out))


@pytest.mark.process
def test_orphans_end_with_what_is_guarded_and_its_exit_code_stays() -> None:
    with guarded(PATIENCE_S, f"{ORPHAN} sys.exit(5)") as process:
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 5
    assert "left running, and killed: sleep 1000" in err
    assert is_gone(int(out))


@pytest.mark.process
def test_a_limit_begins_anew_with_each_thing_that_is_done() -> None:
    program = "import guardian, time\nfor turn in range(4):\n    guardian.doing(f'{turn}')\n    time.sleep(0.5)"
    with guarded(1.2, program) as process:
        _, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")


@pytest.mark.process
def test_the_end_that_a_guardian_is_asked_for_is_that_of_what_it_guards() -> None:
    program = "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit(4)); print('now', flush=True);"
    with guarded(PATIENCE_S, f"{program} signal.pause()") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "now\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 4


@pytest.mark.process
def test_an_orphan_that_ends_earlier_is_no_zombie() -> None:
    program = (
        "import subprocess, sys, os;"
        "pid = int(subprocess.run(['sh', '-c', 'sleep 0.1 >&- & echo $!'], stdout=subprocess.PIPE).stdout);"
        "print(pid, flush=True); sys.stdin.read()"
    )
    with guarded(PATIENCE_S, program, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        deadline_s = time.monotonic() + PATIENCE_S
        while not is_gone(pid):
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        process.stdin.close()
        assert process.wait(PATIENCE_S) == 0
