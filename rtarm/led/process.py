"""The control process of one joint alone, and the way to lead it.

It runs with an arm file of that joint and a state folder of its own, so that nothing which is known of the whole arm
(references, counts, marks) is changed by what happens here; the mark of its drive alone is forgotten.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import yaml

from config.loader import load_arm
from config.schema import ArmConfig
from rosfront.link import Link, attach
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import undisturbed
from rtarm.led.joint import Led
from rtarm.processes import READY, describe_end, plain_environment, shared_death
from rtloop.kept import reference_store
from shm import files
from shm.errors import NotRunning, led_already

POLL_S = 0.002
STOPPED_PATIENCE_S = 1.0
BRING_UP = (
    "{name} is brought up alone: its drive is asked what rtarm asks of it, set up as the arm file wants, and holds the "
    "joint where it stands. Bring it up?"
)
NOT_SEEN = "The drive was not seen to stand: use the switch in the power line."
TELLS = "rtloop: "
"""What its lines for people begin with."""


class LedProcess:
    """Such a process; `told` are its sentences so far."""

    def __init__(self, values: Mapping[str, Any], folder: Path) -> None:
        file = folder / f"{values['name']}.yaml"
        file.write_text(yaml.safe_dump(values), encoding="utf-8")
        self.arm = load_arm(file)
        self.told: list[str] = []
        self.refused = ""
        """Why its drive was not seen to stand when it was closed, a sentence."""
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

    def attach(self) -> Link:
        """Its memory files, once its bus is open and its bring-up begins; raises Refusal where neither comes."""
        while True:
            try:
                link = attach(self.arm)
            except NotRunning:
                link = None
            if link is not None:
                if link.loop_pid == self._process.pid and link.loop_has_run():
                    return link
                link.close()
            if self._process.poll() is not None:
                self._listener.join()
                raise Refusal("\n".join(self.told) or "The control process did not start.", ExitCode.LOOP_REFUSED)
            time.sleep(POLL_S)

    def brought_up(self) -> bool:
        """Wait for the end of its bring-up; whether its drive holds the joint then."""
        assert self._process.stdout is not None
        ready = self._process.stdout.readline().strip() == READY
        if not ready:
            self._listener.join()
        return ready

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
            raise NotRunning(self._how_it_ended())

    def _how_it_ended(self) -> str:
        code = self._process.returncode
        how = f"The control process of {self.arm.name} ended {describe_end(code)}."
        return " ".join([how, *(self.told[-1:] if code > 0 else [])])

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
        """End it in order: what moves stops, and the drive holds; `refused` says where that is not so."""
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
        if self._process.returncode != 0:
            self.refused = self._how_it_ended()


def _state_of(pid: int) -> str:
    """The letter of the kernel for what a process does."""
    return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]


@contextmanager
def led_alone(arm: ArmConfig, joint: int, values: Mapping[str, Any]) -> Iterator[tuple[Led, LedProcess]]:
    """A joint of an arm that is being brought up alone, with an arm file of these `values`; raises Refusal."""
    require_at_rest(arm, "Joints are led")  # another may have begun while this one's person was asked
    left_behind = f"rtarm-led-{arm.name}-"  # of one that was killed: no other runs beside the arm's memory files
    for folder in Path(tempfile.gettempdir()).glob(f"{left_behind}*"):
        shutil.rmtree(folder, ignore_errors=True)
    with (
        tempfile.TemporaryDirectory(prefix=left_behind) as made,
        closing(LedProcess(values, Path(made))) as process,
        closing(process.attach()) as link,
    ):
        _forget_mark(arm, joint)

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
        finally:
            process.close()
            process.refused = process.refused or led.not_seen_to_stand()


def _forget_mark(arm: ArmConfig, joint: int) -> None:
    """What its drive had as a proof of its power proves nothing once it was led by another process; raises Refusal."""
    marks = reference_store.power_marks(arm)
    if marks.pop(joint, None) is not None:
        try:
            reference_store.keep_power_marks(arm, marks)
        except reference_store.NotSaved as problem:
            raise Refusal(str(problem)) from None


def require_at_rest(arm: ArmConfig, alone: str) -> None:
    """Raise Refusal where the arm runs; `alone` begins the sentence, as of `shm.errors.led_already`."""
    try:
        files.open_state(arm.name).close()
    except NotRunning:
        return
    raise Refusal(led_already(alone), ExitCode.LOOP_REFUSED)


def with_unseen(ended: str, unseen: str) -> str:
    """How it ended, and why its drive was not seen to stand, where that is not the same."""
    return " ".join(sentence for sentence in (ended, "" if unseen in ended else unseen, NOT_SEEN) if sentence)
