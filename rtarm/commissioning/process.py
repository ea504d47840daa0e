"""The control process of one joint alone, and the way to lead it: for bench tests of what it leads every day.

It runs with an arm file of that joint and a state folder of its own, so that nothing which is known of the whole arm
(references, counts, marks) is changed by what happens at the bench.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import yaml

from config.loader import load_arm
from config.schema import ArmConfig
from rosfront.link import attach
from rtarm.commissioning.led import Led, alone
from rtarm.errors import ExitCode, Refusal
from rtarm.interrupt import undisturbed
from rtarm.processes import READY, plain_environment, shared_death
from shm.errors import NotRunning

POLL_S = 0.002
STOPPED_PATIENCE_S = 1.0
TELLS = "rtloop: "
"""What its lines for people begin with."""


class LedProcess:
    """Such a process, which has brought its drive up; `told` are its sentences so far.

    Raises:
        Refusal: it cannot begin, with its own sentence.
    """

    def __init__(self, arm: ArmConfig, joint: int, folder: Path) -> None:
        file = folder / f"{arm.name}.yaml"
        file.write_text(yaml.safe_dump(alone(arm, joint)), encoding="utf-8")
        self.arm = load_arm(file)
        self.told: list[str] = []
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "rtloop", str(file)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**plain_environment(), "XDG_STATE_HOME": str(folder)},
            process_group=0,
            preexec_fn=shared_death(),  # noqa: PLW1509 (no thread is there yet)
        )
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        try:
            self._await_ready()
        except BaseException:
            self.close()
            raise

    def _await_ready(self) -> None:
        assert self._process.stdout is not None
        if self._process.stdout.readline().strip() != READY:
            self._listener.join()
            raise Refusal("\n".join(self.told) or "The control process did not start.", ExitCode.LOOP_REFUSED)

    def _listen(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.startswith(TELLS):
                self.told.append(line.removeprefix(TELLS).rstrip("\n"))
            else:  # that the cycle is being compiled
                print(line, end="", file=sys.stderr, flush=True)

    def pass_time(self) -> None:
        """Let it go on; raises NotRunning where it has ended."""
        time.sleep(POLL_S)
        if self._process.poll() is not None:
            self._listener.join()
            raise NotRunning(f"The control process ended meanwhile: {' '.join(self.told[-1:])}")

    @contextmanager
    def standing_still(self) -> Iterator[None]:
        """Nothing of it runs meanwhile."""
        self._process.send_signal(signal.SIGSTOP)
        try:
            ends_s = time.monotonic() + STOPPED_PATIENCE_S
            while _state_of(self._process.pid) != "T" and time.monotonic() < ends_s:
                time.sleep(POLL_S)
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)  # says nothing to one that has ended

    def close(self) -> None:
        """End it in order: what moves stops, and the drive holds."""
        assert self._process.stdout is not None
        with undisturbed():
            self._process.terminate()
            self._process.send_signal(signal.SIGCONT)  # it may stand still
            try:
                self._process.wait(self.arm.patience.control_process_s)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._listener.join()
            self._process.stdout.close()


def _state_of(pid: int) -> str:
    """The letter of the kernel for what a process does."""
    return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]


@contextmanager
def led_alone(arm: ArmConfig, joint: int) -> Iterator[tuple[Led, LedProcess]]:
    """A joint of an arm, brought up alone, for as long as it is tested; raises Refusal."""
    with ExitStack() as kept:
        folder = Path(kept.enter_context(tempfile.TemporaryDirectory(prefix="rtarm-commission-")))
        process = LedProcess(arm, joint, folder)
        kept.callback(process.close)
        link = attach(process.arm)
        kept.callback(link.close)

        def pass_time() -> None:
            link.writer.beat()
            process.pass_time()

        led = Led(
            process.arm,
            link.reader,
            link.writer,
            pass_time=pass_time,
            now_ns=time.monotonic_ns,
            standing_still=process.standing_still,
        )
        try:
            yield led, process
        except BaseException:
            link.writer.stop()  # at once, whatever has to be put in order first
            raise
