"""`rtarm up` and `rtarm demo` with the real processes."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from stack import PATIENT, run_rtarm
from two_buses import write_divided
from waiting import until

from config.loader import known_arms
from rtarm.recording import folder, mcap_reader, story
from shm import files
from shm.words import Fault

pytestmark = pytest.mark.process

LONG_S = 60.0
RECORDED = Path(__file__).resolve().parents[2] / "data" / "moveit"


class Command:
    """A running `rtarm`, whose output is waited for line by line."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rtarm", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
        )
        assert self.process.stdout is not None
        self.output = ""
        self.errors = ""
        self._seen = 0
        os.set_blocking(self.process.stdout.fileno(), False)

    def until(self, text: str) -> None:
        """Wait for a text that has not been waited for yet."""
        deadline = time.monotonic() + LONG_S
        while (at := self.output.find(text, self._seen)) < 0:
            assert self._read(deadline), f"{text!r} never came:\n{self.output}\n{self._rest_of_errors()}"
        self._seen = at + len(text)

    def end(self, number: int | None = None) -> int:
        """Send a signal, if one is given, and wait for the end; its exit code."""
        if number is not None:
            self.process.send_signal(number)
        deadline = time.monotonic() + LONG_S
        while self._read(deadline):
            pass
        code = self.process.wait(LONG_S)
        self.errors += self._rest_of_errors()
        return code

    def _read(self, deadline: float) -> bool:
        stream = self.process.stdout
        assert stream is not None
        select.select([stream], [], [], max(0.0, deadline - time.monotonic()))
        data = stream.read()
        self.output += (data or b"").decode()
        return bool(data)

    def _rest_of_errors(self) -> str:
        assert self.process.stderr is not None
        return "" if self.process.poll() is None else self.process.stderr.read().decode()

    def close(self) -> None:
        """Leave nothing behind, whatever the test did."""
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(LONG_S)
        for stream in (self.process.stdout, self.process.stderr):
            assert stream is not None
            stream.close()


@pytest.fixture
def start() -> Iterator[Callable[..., Command]]:
    started: list[Command] = []

    def run(*arguments: str) -> Command:
        started.append(Command(*arguments))
        return started[-1]

    yield run
    for command in started:
        command.close()


@pytest.fixture
def clean(arm_name: str) -> Iterator[None]:
    """What a killed control process leaves is evidence for its user, and litter for a test."""
    yield
    for path in files.DIRECTORY.glob(f"rtarm.{arm_name}.*"):
        path.unlink()


def status(arm: str) -> dict[str, Any]:
    result = run_rtarm("status", arm, "--json")
    report: dict[str, Any] = json.loads(result.stdout)
    assert (result.returncode == 0) == report["healthy"]
    return report


def ended(pids: list[int]) -> bool:
    return not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_up_says_what_stands_in_the_place_of_the_arm_s_memory(
    start: Callable[..., Command], arm_file: Path, arm_name: str
) -> None:
    path = files.state_path(arm_name)
    path.mkdir()
    try:
        up = start("up", str(arm_file), "--sim")
        assert up.end() == 2
        assert up.errors.startswith(f"{path} is a directory of user ") and "Traceback" not in up.errors
    finally:
        path.rmdir()


def test_up_serves_restarts_the_front_and_ends_in_order(
    start: Callable[..., Command], arm_file: Path, arm_name: str
) -> None:
    up = start("up", str(arm_file), "--sim")
    up.until("rtarm  running")
    report = status(arm_name)
    assert (report["mode"], report["healthy"], report["problems"]) == ("holding", True, [])
    assert [joint["referenced"] for joint in report["joints"]] == [True] * 6
    assert report["bus"]["frames_tx"] > 0

    second = start("up", str(arm_file), "--sim")
    assert second.end() == 2
    assert second.errors.startswith("A control process for this arm is already running (pid")
    assert (second.output, second.errors.count("\n")) == ("", 1)  # said once, and nothing was started for it

    os.kill(report["front"]["pid"], signal.SIGKILL)
    up.until("the ROS process ended by SIGKILL; starting it again")
    up.until("ready again")
    until(lambda: bool(status(arm_name)["healthy"]), patience_s=LONG_S)
    again = status(arm_name)
    assert again["front"]["pid"] != report["front"]["pid"]
    assert again["loop"]["pid"] == report["loop"]["pid"]

    stopped = start("stop", arm_name)
    assert stopped.end() == 0
    assert "stands; no goal was running" in stopped.output

    assert up.end(signal.SIGINT) == 0
    assert "rtarm  SIGINT: stopping the arm on its path" in up.output
    assert up.output.endswith("rtarm  ended in order\n")
    assert up.errors == ""
    assert ended([again["loop"]["pid"], again["front"]["pid"]])
    assert not list(files.DIRECTORY.glob(f"rtarm.{arm_name}.*"))


@pytest.mark.usefixtures("clean")
def test_a_dead_control_process_ends_everything_with_code_3(
    start: Callable[..., Command], arm_file: Path, arm_name: str
) -> None:
    up = start("up", str(arm_file), "--sim")
    up.until("rtarm  running")
    report = status(arm_name)
    os.kill(report["loop"]["pid"], signal.SIGKILL)
    assert up.end() == 3
    assert up.errors == (
        "The control process ended by SIGKILL; the drives stop by themselves, but a homing run goes on: look at the "
        f"arm, then start again with `rtarm up {arm_file} --sim`.\n"
    )
    assert ended([report["front"]["pid"]])
    gone = status(arm_name)
    assert (gone["running"], "is gone without an orderly end" in gone["problems"][0]) == (False, True)
    assert "rtarm  writing the recording …" in up.output
    recording = written(arm_name)
    told = f"rtarm  recorded: {recording}; `rtarm explain` tells it"
    assert told in up.output or "goes on being written without rtarm" in up.output
    explained = start("explain", str(recording))
    assert explained.end() == 0, explained.errors
    assert "The last cycle of the control process." in explained.output
    again = start("record", arm_name)
    assert again.end() == 0, again.errors
    assert len(folder.recordings(arm_name)) == 2


@pytest.mark.usefixtures("clean")
def test_each_bus_has_a_simulated_arm_and_the_end_of_one_ends_everything(
    start: Callable[..., Command], arm_name: str, tmp_path: Path, clean: None
) -> None:
    file = write_divided("episode1", tmp_path / "arm.yaml", name=arm_name, limits=PATIENT)
    up = start("up", str(file), "--sim")
    up.until("sim    bus shoulder: ready, 3 simulated drives behind ")
    up.until("sim    bus wrist: ready, 3 simulated drives behind ")
    up.until(f"loop   ready, {arm_name} at 120 Hz on slcan, 500 kbit/s (shoulder), 500 kbit/s (wrist) (")
    up.until("rtarm  running")
    assert [joint["referenced"] for joint in status(arm_name)["joints"]] == [True] * 6

    children = [int(pid) for pid in children_of(up)]
    (wrist,) = [pid for pid in children if Path(f"/proc/{pid}/cmdline").read_bytes().endswith(b"--bus\0wrist\0")]
    os.kill(wrist, signal.SIGKILL)
    assert up.end() == 1
    assert up.errors == (
        "The simulated bus wrist ended by SIGKILL, so there is nothing left to control: start again with "
        f"`rtarm up {file} --sim`.\n"
    )
    until(lambda: ended(children), patience_s=LONG_S)


def test_each_latched_fault_is_recorded_once_with_what_followed(
    start: Callable[..., Command], arm_file: Path, arm_name: str
) -> None:
    up = start("up", str(arm_file), "--sim")
    up.until("rtarm  running")
    drives = [int(pid) for pid in children_of(up) if b"sim\0" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(drives[0], signal.SIGSTOP)  # no drive answers any more
    try:
        up.until("recorded: ")
    finally:
        os.kill(drives[0], signal.SIGCONT)
    up.until("\n")
    assert up.end(signal.SIGINT) == 0
    (recording,) = folder.recordings(arm_name)
    assert recording.name.endswith("-stale_reading.mcap")
    found = mcap_reader.read(recording)
    assert (found.damage, found.reason.word) == ("", "fault")
    latched_ns = int(found.recording.records["fault_ns"][-1])
    assert int(found.recording.records["monotonic_ns"][-1]) - latched_ns > 1_000_000_000
    told = story.tell(found.recording, found.reason)
    assert told.fault == Fault.STALE_READING and told.first is not None


def written(arm: str) -> Path:
    """The recording of an arm, whose writing may outlive `rtarm up` on a busy machine."""
    until(lambda: folder.recordings(arm), "a recording", LONG_S)
    (recording,) = folder.recordings(arm)
    return recording


def children_of(command: Command) -> list[str]:
    """Pids of the processes that a command has started."""
    arguments = ["ps", "-o", "pid=", "--ppid", str(command.process.pid)]
    return subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.smoke
@pytest.mark.usefixtures("clean")
def test_kill_9_of_the_launcher_leaves_no_process(start: Callable[..., Command], arm_file: Path, arm_name: str) -> None:
    up = start("up", str(arm_file), "--sim")
    up.until("rtarm  running")
    report = status(arm_name)
    children = children_of(up)
    assert {str(report["loop"]["pid"]), str(report["front"]["pid"])} < set(children)
    assert len(children) == 3
    up.process.kill()
    until(lambda: ended([int(pid) for pid in children]), patience_s=LONG_S)


@pytest.mark.parametrize(
    ("options", "said"),
    [(("--channel", "/dev/no_such_adapter"), "/dev/no_such_adapter")],
    ids=["missing port"],
)
def test_a_control_process_that_refuses_is_exit_code_2(
    options: tuple[str, ...], said: str, start: Callable[..., Command], arm_file: Path
) -> None:
    up = start("up", str(arm_file), *options)
    assert up.end() == 2
    assert said in up.errors
    assert len(up.errors.splitlines()) == 1
    assert "Traceback" not in up.output + up.errors


def test_a_signal_while_starting_ends_in_order(start: Callable[..., Command], arm_file: Path, arm_name: str) -> None:
    up = start("up", str(arm_file), "--sim")
    up.until("sim    ready")
    assert up.end(signal.SIGTERM) == 0
    assert up.output.endswith("rtarm  ended in order\n")
    assert not list(files.DIRECTORY.glob(f"rtarm.{arm_name}.*"))


def test_a_reader_that_goes_away_does_not_end_the_arm(
    start: Callable[..., Command], mock_file: Path, arm_name: str
) -> None:
    up = start("up", str(mock_file))
    up.until("control process starting")
    assert up.process.stdout is not None
    up.process.stdout.close()
    until(lambda: bool(status(arm_name)["healthy"]), patience_s=LONG_S)
    front = status(arm_name)["front"]["pid"]
    os.kill(front, signal.SIGKILL)  # which the launcher has to say, to nobody
    until(lambda: status(arm_name)["front"]["pid"] not in (None, front), patience_s=LONG_S)
    up.process.send_signal(signal.SIGTERM)
    assert up.process.wait(LONG_S) == 0
    assert up.process.stderr is not None
    assert up.process.stderr.read() == b""


@pytest.mark.smoke
def test_the_demo_plays_a_goal_and_writes_its_figures(
    start: Callable[..., Command], arm_file: Path, tmp_path: Path
) -> None:
    figures = tmp_path / "figures.json"
    goal = RECORDED / "small.json"
    command = start("demo", "--arm", str(arm_file), "--goal", str(goal), "--json", str(figures))
    assert command.end() == 0, command.output + command.errors
    assert "1 of 1 goals succeeded" in command.output
    report = json.loads(figures.read_text(encoding="utf-8"))
    assert report["result"]["error_code"] == 0
    assert "Goal reached" in report["result"]["error_string"]
    assert report["planned_s"] == pytest.approx(0.457, abs=1e-3)
    assert report["actual_s"] > report["planned_s"]
    for name in ("rms", "max", "final"):
        assert len(report["tracking_rad"][name]) == 6
    assert max(report["tracking_rad"]["final"]) < 0.01
    assert report["joint_states"]["rate_hz"] > 0
    assert set(report["joint_states"]["interval_ms"]) == {"p50", "p99", "max"}
    for name in ("lateness_us", "cycle_us"):
        assert set(report[name]) == {"p50", "p99", "p99_9", "max", "count"}
    assert report["cycles"] > 40
    assert report["overruns"] >= 0
    assert report["bus"]["frames_tx"] > 0
    assert report["bus"]["frames_rx"] > 0
    assert 0.3 < report["bus"]["load"] < 1.0
    assert set(report["scheduling"]) == {"policy", "priority", "memory_locked", "cpu", "dma_latency_held"}


@pytest.mark.parametrize("arm", [name for name in known_arms() if name not in ("mock", "episode1")])
def test_the_demo_of_each_family_plays_a_goal(start: Callable[..., Command], arm: str) -> None:
    command = start("demo", "--arm", arm, "--goal", str(RECORDED / "small.json"))
    assert command.end() == 0, command.output + command.errors
    assert "1 of 1 goals succeeded" in command.output


def test_a_demo_whose_goal_is_refused_fails_with_its_sentence(
    start: Callable[..., Command], arm_file: Path, tmp_path: Path
) -> None:
    document = json.loads((RECORDED / "small.json").read_text(encoding="utf-8"))
    document["trajectory"]["points"][2]["positions"][1] = 3.0
    goal = tmp_path / "beyond.json"
    goal.write_text(json.dumps(document), encoding="utf-8")
    command = start("demo", "--arm", str(arm_file), "--goal", str(goal))
    assert command.end() == 4
    assert "0 of 1 goals succeeded" in command.output
    assert "joint2" in command.output


def test_rtarm_stop_stops_a_moving_demo(start: Callable[..., Command], arm_file: Path, arm_name: str) -> None:
    command = start("demo", "--arm", str(arm_file), "--goal", str(RECORDED / "near_limits_high.json"))
    command.until("arm    near_limits_high: ")
    (running,) = [arm for arm in files.running_arms() if arm.startswith(f"{arm_name}_demo_")]
    stopped = start("stop", running)
    assert stopped.end() == 0, stopped.errors
    assert "stopped on its path and stands; its goal has ended" in stopped.output
    assert command.end() == 4
    assert "stopped by a person" in command.output
