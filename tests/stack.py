"""The whole arm as real processes: simulated drives behind a pseudo-terminal, control process, ROS front.

However a test ends, its arm ends with the judge's word on all of its true motion (`Stack.close`).
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import Empty, Queue
from typing import Any

from arm_files import edited, write_arm
from observer import judge, life_violations

from config.loader import load_arm
from rtarm.running.status import Report, read_status
from shm.files import DIRECTORY
from sim.truth import Heard, JointTruth, load_truth, load_wire

ROOT = Path(__file__).parents[1]
PATIENCE_S = 60.0
PATIENT = {"stale_brake_s": 1.0, "stale_fault_s": 3.0, "position_jump_rad": 1.0, "front_timeout_s": 3.0}
"""Limits of an arm whose tests are not about silence.

A busy machine keeps the bytes of a pseudo-terminal, which a kernel worker of ordinary priority carries, for more than a
tenth of a second, and lets a ROS process stand still.
"""
COMPILING = "compiling the control cycle"
COMPILING_S = 300.0
"""It takes 45 s of one processor, after a change; killed in the middle, the next one begins again."""


class Process:
    """A module of ours, whose lines are read as they come."""

    def __init__(self, module: str, *arguments: str, needs_ros: bool = False) -> None:
        environment = dict(os.environ)
        if not needs_ros:
            environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        self.lines: list[str] = []
        self._queue: Queue[str | None] = Queue()
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self._queue.put(line.rstrip("\n"))
        self._queue.put(None)

    def line_with(self, text: str) -> str:
        """The next line that contains a text; fails when the process ends before it says so."""
        while True:
            compiles = bool(self.lines) and COMPILING in self.lines[-1]
            try:
                line = self._queue.get(timeout=COMPILING_S if compiles else PATIENCE_S)
            except Empty:
                raise AssertionError(f"{text!r} never came: {self.lines}") from None
            assert line is not None, f"{text!r} never came: {self.lines}"
            self.lines.append(line)
            if text in line:
                return line

    def code(self) -> int:
        """Exit code, once it has ended; all lines are read then."""
        code = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        self.said()
        return code

    def said(self) -> str:
        """All it has said so far."""
        while not self._queue.empty():
            line = self._queue.get()
            if line is not None:
                self.lines.append(line)
        return self.text

    @property
    def text(self) -> str:
        return "\n".join(self.lines)

    def say(self, line: str) -> None:
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(20.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._reader.join(PATIENCE_S)
        self.process.stdin.close()
        self.process.stdout.close()


def run_rtarm(*arguments: str, typed: str = "") -> subprocess.CompletedProcess[str]:
    """`rtarm` without a terminal, to its end."""
    environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "COLUMNS": "200"}
    command = [sys.executable, "-m", "rtarm", *arguments]
    return subprocess.run(
        command,
        cwd=ROOT,
        env=environment,
        input=typed,
        capture_output=True,
        text=True,
        timeout=COMPILING_S,
        check=False,
    )


class Stack:
    """Simulated arm, control process and front of one arm; each may be started, killed, started again."""

    def __init__(
        self, name: str, folder: Path, arm: str = "episode1", *, start_deg: Sequence[float] | None = None
    ) -> None:
        self.name = name
        self.folder = folder
        self.link = folder / "tty"
        self.place = ("--link", str(self.link))
        self.truth_file = folder / "truth.npz"
        self.arm_file = write_arm(arm, name, folder)
        with edited(self.arm_file) as values:
            if values["bus"].pop("usb_index", None) is not None:
                values["bus"]["channel"] = str(self.link)
        self._start_deg = start_deg
        self._processes: list[Process] = []
        self._found: list[str] = []

    def change(self, **sections: dict[str, Any]) -> None:
        """Set keys of the arm file, by section; what is started from now on reads them."""
        with edited(self.arm_file) as values:
            for section, keys in sections.items():
                values.setdefault(section, {}).update(keys)

    def start_sim(self, *options: str) -> Process:
        self._look()  # at what the one before has left
        arguments = ["--arm", str(self.arm_file), *self.place, "--truth", str(self.truth_file)]
        if self._start_deg is not None:
            arguments.append("--start-deg=" + ",".join(str(angle) for angle in self._start_deg))
        self.sim = self._keep(Process("sim", *arguments, "--faults-from-stdin", *options))
        self.simulated = load_arm(self.arm_file)  # a test may change the file later
        self.sim.line_with("ready")
        return self.sim

    def befall(self, fault: str) -> None:
        """Let something go wrong, as on the simulator's command line, its times counted from now."""
        self.sim.say(fault)
        self.sim.line_with(f"fault {fault}")

    def unplug(self) -> None:
        """Take the adapter away at once, its name first.

        The next terminal that anybody opens gets its number: a control process that looks for its adapter by a name
        that is left would find the arm of another test.
        """
        self.link.unlink()
        self.sim.process.kill()

    def start_loop(self, *options: str, ready: bool = True) -> Process:
        self.loop = self._keep(Process("rtloop", str(self.arm_file), *options))
        if ready:
            self.loop.line_with("ready")
        return self.loop

    def start_front(self) -> Process:
        self.front = self._keep(Process("rosfront", str(self.arm_file), needs_ros=True))
        self.front.line_with("ready")
        return self.front

    def _keep(self, process: Process) -> Process:
        self._processes.append(process)
        return process

    def until(self, condition: Callable[[Report], Any]) -> Report:
        """The first report of `rtarm status` that fulfils a condition."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition(report := read_status(self.name)):
            assert time.monotonic() < deadline, report
            time.sleep(0.02)
        return report

    def truth(self) -> dict[str, JointTruth]:
        """The drives' true motion so far, written by the simulated arm when asked."""
        self.sim.process.send_signal(signal.SIGUSR1)
        self.sim.line_with("truth")
        return load_truth(self.truth_file)

    def wire(self) -> Heard:
        """What the host had written to the adapter when `truth` was asked for last."""
        return load_wire(self.truth_file)

    def close(self) -> None:
        """End and sweep everything; raises Violation where the true motion of a simulated arm left its limits.

        It writes its whole motion at an orderly end. Of one that was killed, what was asked of it before is judged.
        """
        with contextlib.ExitStack() as ends:  # all of them, whatever one of them has to say
            ends.callback(self._judge)
            ends.callback(self._sweep)
            for process in self._processes:
                ends.callback(process.close)

    def _judge(self) -> None:
        self._look()
        judge(self._found)

    def _look(self) -> None:
        """Note what the observer finds in the true motion that a simulated arm has left."""
        if self.truth_file.exists():
            self._found += life_violations(self.simulated, load_truth(self.truth_file))
            self.truth_file.unlink()

    def _sweep(self) -> None:
        for left in DIRECTORY.glob(f"rtarm.{self.name}.*"):  # of a killed control process
            left.unlink()
