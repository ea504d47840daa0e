"""Recordings that go on: nothing is missed, what is written can be read whatever comes, and the end is in order."""

from __future__ import annotations

import contextlib
import fcntl
import json
import mmap
import os
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from typer.testing import Result
from virtual import VirtualArm
from waiting import until

from rtarm.console.errors import Refusal
from rtarm.recording import folder, mcap_reader, shown
from rtarm.recording.follow import Follower, Progress, follow
from rtarm.recording.mcap_writer import NotWritten
from shm import files, layout
from shm.recording import Position, kept_from, now_at, read_on, read_recording

Rtarm = Callable[..., Result]
PATIENCE_S = 120.0


@pytest.fixture
def arm() -> Iterator[VirtualArm]:
    """An arm amid a goal."""
    made = VirtualArm.at_start_of("large")
    made.play("large")
    yield made
    made.close()


# --- pieces -------------------------------------------------------------------------------------------------


def test_pieces_together_are_the_whole(arm: VirtualArm) -> None:
    since = now_at(arm.state, arm.command)
    numbers: list[int] = []
    frames = 0
    for cycles in (1, 50, 7, 0, 133):
        arm.cycles(cycles)
        while True:
            piece, after = read_on(arm.state, since, arm.command, 20)
            assert after.records - since.records == len(piece.records) <= 20
            numbers += piece.records["number"].tolist()
            frames += len(piece.frames)
            done, since = after == since, after
            if done:
                break
    whole = read_recording(arm.state).records["number"]
    assert numbers == whole[whole >= numbers[0]].tolist()
    assert len(numbers) == 191
    assert frames == int(arm.state.record["frames_written"][0]) - (since.frames - frames)


def test_what_was_overwritten_shows_in_the_position(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layout, "RECORDED_NS", 40 * 8_333_333)
    small = VirtualArm("episode1")
    assert small.bring_up().failure is None
    since = now_at(small.state)
    small.cycles(100)
    piece, after = read_on(small.state, since)
    assert after.records - since.records == 100
    assert len(piece.records) == int(small.state.record["recorder"]["record_slots"]) - 1
    assert kept_from(small.state).records == after.records - len(piece.records)
    small.close()


def test_a_record_that_is_not_whole_yet_is_left_for_the_next_time(arm: VirtualArm) -> None:
    arm.cycles(10)
    since = now_at(arm.state)
    arm.cycles(3)
    size, slots = (int(arm.state.record["recorder"][name]) for name in ("record_bytes", "record_slots"))
    at = layout.StateFile.dtype.itemsize + (since.records + 2) % slots * size + 64
    words = np.frombuffer(arm.state.map, np.int64)
    words[at // 8] ^= 1
    piece, after = read_on(arm.state, since)
    assert (len(piece.records), after.records) == (2, since.records + 2)
    words[at // 8] ^= 1
    del words
    piece, after = read_on(arm.state, after)
    assert (len(piece.records), after.records) == (1, since.records + 3)


def test_a_position_of_the_future_reads_nothing(arm: VirtualArm) -> None:
    arm.cycles(5)
    far = Position(*(1 << 40 for _ in range(5)))
    piece, after = read_on(arm.state, far, arm.command)
    assert (len(piece.records), len(piece.frames), len(piece.events), after) == (0, 0, 0, far)


@pytest.mark.parametrize("past", [False, True], ids=["from now on", "with what is kept"])
def test_a_file_of_pieces_is_read_as_one(arm: VirtualArm, tmp_path: Path, past: bool) -> None:
    path = tmp_path / "on.mcap"
    arm.cycles(30)
    began = int(arm.state.record["records_written"][0])
    follower = Follower(arm.state, path, past=past)
    seen: list[Progress] = []
    for _ in range(5):
        arm.cycles(40)
        follower.take(seen.append)
    follower.finish()
    loaded = mcap_reader.read(path)
    whole = read_recording(arm.state)
    kept = whole.records["number"] >= (0 if past else began)
    assert loaded.damage == ""
    for name in ("number", "monotonic_ns", "mode", "lateness_ns"):
        assert loaded.recording.records[name].tolist() == whole.records[name][kept].tolist(), name
    joints = whole.records["joints"][kept]
    assert loaded.recording.records["joints"]["commanded_position_rad"].tolist() == (
        joints["commanded_position_rad"].tolist()
    )
    assert seen[-1].cycles_missing == seen[-1].frames_missing == 0
    assert [one.size for one in seen] == sorted(one.size for one in seen)
    assert follower.progress.size == path.stat().st_size


def test_the_file_is_readable_after_each_look(arm: VirtualArm, tmp_path: Path) -> None:
    path = tmp_path / "on.mcap"
    follower = Follower(arm.state, path, past=False)
    for looks in range(1, 4):
        arm.cycles(25)
        follower.take()
        loaded = mcap_reader.read(path)
        assert len(loaded.recording.records) == 25 * looks
        assert loaded.damage == "it ends too early, as if it had been cut off or were still being written"
    follower.finish()
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.channel_message_counts[1] == 75


def test_nothing_but_a_recording_is_replaced_by_one_that_goes_on(arm: VirtualArm, tmp_path: Path) -> None:
    path = tmp_path / "thesis"
    path.write_text("mine")
    with pytest.raises(NotWritten, match="is there and no recording of rtarm's"):
        Follower(arm.state, path, past=False)
    assert path.read_text() == "mine"


def test_progress_is_told_in_words() -> None:
    assert Progress(12.04, 1_234_567).told() == "12.0 s, 1.2 MB, nothing missing"
    assert Progress(1.0, 0, 1, 2).told() == "1.0 s, 0.0 MB, 1 cycle and 2 frames missing"


@pytest.mark.parametrize("encoding", ["utf-8", "gbk", "latin-1"])
@pytest.mark.parametrize("span_s", [None, 10.0])
def test_a_terminal_shows_how_far_it_has_come(
    monkeypatch: pytest.MonkeyPatch, span_s: float | None, encoding: str
) -> None:
    master, slave = os.openpty()
    terminal = os.fdopen(slave, "w", encoding=encoding, errors="backslashreplace")  # as Python opens standard error
    with terminal, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        patch.setenv("TERM", "xterm")
        with shown.growing(span_s) as told:
            told(Progress(2.0, 6_000_000))
        print("the end", file=terminal, flush=True)  # what was written comes in pieces, by a worker of the kernel
        seen = b""
        while b"the end" not in seen:
            seen += os.read(master, 65536)
    os.close(master)
    assert b"2.0 s, 6.0 MB, nothing missing" in seen
    assert seen.split(b"the end")[0].endswith(b"\x1b[2K")  # the line is gone again


def test_long_recordings_are_never_removed_to_make_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(folder, "KEPT", 1)
    monkeypatch.setattr(folder, "KEPT_BYTES", 10)
    folder.folder().mkdir(parents=True)
    names = ["arm-20260101T000000Z-wire.mcap", "arm-20260102T000000Z-long.mcap", "arm-20260103T000000Z-wire.mcap"]
    for age, name in enumerate(names):
        path = folder.folder() / name
        path.write_bytes(bytes(100))
        os.utime(path, (1000 + age, 1000 + age))
    folder.remove_old("arm")
    assert [path.name for path in folder.recordings("arm")] == [names[2], names[1]]


# --- the command --------------------------------------------------------------------------------------------


class Live:
    """A state file that is owned, as by a control process, and goes on when the test says so."""

    def __init__(self, name: str) -> None:
        self.path = files.state_path(name)
        self._arm = VirtualArm("mock")
        assert self._arm.bring_up().failure is None
        self._arm.cycles(50)
        header = self._arm.state.record["header"]
        header["magic"], header["layout_hash"], header["pid"] = layout.MAGIC, layout.layout_hash(), os.getpid()
        header["arm_name"] = files.name_bytes((name,), 1)
        self._fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        os.ftruncate(self._fd, len(self._arm.state.map))
        fcntl.flock(self._fd, fcntl.LOCK_EX)
        self._map = mmap.mmap(self._fd, 0)
        self.go(0)

    def go(self, cycles: int) -> None:
        """Run some cycles more."""
        self._arm.cycles(cycles)
        self._map[:] = self._arm.state.map[:]

    def end(self) -> None:
        """As a control process ends: its lock falls."""
        if self._fd >= 0:
            fcntl.flock(self._fd, fcntl.LOCK_UN)
            os.close(self._fd)
            self._fd = -1

    def close(self) -> None:
        self.end()
        self.path.unlink()
        self._map.close()
        self._arm.close()


@pytest.fixture
def live(arm_name: str) -> Iterator[Live]:
    made = Live(arm_name)
    yield made
    made.close()


def recording(
    name: str, path: Path, *more: str, limit: int = resource.RLIM_INFINITY, stderr: int = subprocess.PIPE
) -> subprocess.Popen[str]:
    """`rtarm record` of an arm; no file of it may have more than `limit` bytes."""
    command = [sys.executable, "-m", "rtarm", "record", name, "-o", str(path), *more]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (limit, limit))
    return child


def cycles_in(path: Path) -> int:
    try:
        return len(mcap_reader.read(path).recording.records)
    except Refusal:
        return 0


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_in_order(live: Live, arm_name: str, tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "on.mcap"
    child = recording(arm_name, path, "--follow")
    until(lambda: cycles_in(path) > 0, patience_s=PATIENCE_S, of=child)
    before = cycles_in(path)
    live.go(30)
    child.send_signal(number)
    out, err = child.communicate(timeout=PATIENCE_S)
    assert (child.returncode, out.strip()) == (0, str(path))
    assert err.startswith("recorded: ") and "nothing missing" in err and len(err.splitlines()) == 1
    loaded = mcap_reader.read(path)
    assert (loaded.damage, len(loaded.recording.records)) == ("", before + 30)
    assert np.all(np.diff(loaded.recording.records["number"]) == 1)


def fill(master: int, slave: int) -> None:
    """As behind a connection that is stuck: with all that a terminal takes while nobody reads it."""
    full = os.open(os.ttyname(slave), os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    while select.select((), (full,), (), 0.2)[1]:  # the kernel moves some of it on for a moment
        with contextlib.suppress(BlockingIOError):
            os.write(full, b"\n")
    os.close(full)


def press_ctrl_s(master: int, slave: int) -> None:
    os.write(master, b"\x13")
    while select.select((), (slave,), (), 0)[1]:
        time.sleep(0.01)


@pytest.mark.process
@pytest.mark.parametrize("hold_up", [fill, press_ctrl_s])
def test_a_terminal_that_takes_nothing_does_not_hold_it_up(
    live: Live, arm_name: str, tmp_path: Path, hold_up: Callable[[int, int], None]
) -> None:
    path = tmp_path / "on.mcap"
    master, slave = os.openpty()
    hold_up(master, slave)
    child = recording(arm_name, path, "--follow", stderr=slave)
    try:
        until(lambda: cycles_in(path) > 0, patience_s=PATIENCE_S, of=child)
        before = cycles_in(path)
        live.go(30)
        until(lambda: cycles_in(path) == before + 30, patience_s=PATIENCE_S, of=child)
        child.send_signal(signal.SIGTERM)
        out, _ = child.communicate(timeout=PATIENCE_S)
    finally:
        child.kill()
        child.communicate()
    assert (child.returncode, out.strip()) == (0, str(path))
    assert mcap_reader.read(path).damage == ""
    os.write(slave, b"the end")  # what was written comes in pieces, by a worker of the kernel
    seen = b""
    while b"the end" not in seen:
        seen += os.read(master, 65536)
    assert b"recorded: " in seen and b"nothing missing" in seen
    os.close(master)
    os.close(slave)


@pytest.mark.process
def test_a_killed_recording_has_what_was_written(live: Live, arm_name: str, tmp_path: Path) -> None:
    path = tmp_path / "on.mcap"
    child = recording(arm_name, path, "-f")
    until(lambda: cycles_in(path) > 0, patience_s=PATIENCE_S, of=child)
    before = cycles_in(path)
    live.go(30)
    until(lambda: cycles_in(path) == before + 30, patience_s=PATIENCE_S, of=child)
    child.kill()
    child.communicate(timeout=PATIENCE_S)
    loaded = mcap_reader.read(path)
    assert "ends too early" in loaded.damage
    assert len(loaded.recording.records) == before + 30
    assert [one.name for one in tmp_path.iterdir()] == ["on.mcap"]


@pytest.mark.process
@pytest.mark.parametrize(("more", "code"), [(("-f",), 0), (("--for", "600"), 1)])
def test_it_ends_with_the_control_process(
    live: Live, arm_name: str, tmp_path: Path, more: tuple[str, ...], code: int
) -> None:
    path = tmp_path / "on.mcap"
    child = recording(arm_name, path, *more)

    def goes() -> bool:
        live.go(1)
        return cycles_in(path) > 0

    until(goes, patience_s=PATIENCE_S, of=child)
    live.end()
    _, err = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == code
    assert f"the control process of {arm_name}".lower() in err.lower() and len(err.splitlines()) == 1
    assert mcap_reader.read(path).damage == ""


@pytest.mark.process
def test_without_room_it_ends_with_what_is_written(live: Live, arm_name: str, tmp_path: Path) -> None:
    path = tmp_path / "on.mcap"
    child = recording(arm_name, path, "--for", "600", limit=100_000)
    while child.poll() is None:
        live.go(20)
        time.sleep(0.05)
    out, err = child.communicate(timeout=PATIENCE_S)
    assert (child.returncode, out) == (1, "")
    assert f"The recording {path} cannot be continued (File too large)" in err and len(err.splitlines()) == 1
    assert cycles_in(path) > 20
    with path.open("rb") as file:  # it ends with a whole record
        assert file.seek(0, os.SEEK_END) <= 100_000
    assert "spoilt" not in mcap_reader.read(path).damage


@pytest.mark.process
def test_for_a_time_it_ends_by_itself(live: Live, arm_name: str, tmp_path: Path) -> None:
    path = tmp_path / "on.mcap"
    child = recording(arm_name, path, "--for", "1")
    while child.poll() is None:
        live.go(5)
        time.sleep(0.05)
    out, err = child.communicate(timeout=PATIENCE_S)
    assert (child.returncode, out.strip()) == (0, str(path)), err
    assert json.loads(json.dumps(err)).startswith("recorded: ")


def test_whatever_ends_the_wait_the_file_is_cut_when_nobody_writes_it_any_more(
    live: Live, arm_name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "on.mcap"
    told: list[Progress] = []
    working: list[str] = []
    cut = Follower.cut

    def fail(number: int, _: object) -> None:
        raise RuntimeError("no stop signal")

    def step(progress: Progress) -> None:
        told.append(progress)
        os.kill(os.getpid(), signal.SIGUSR1 if len(told) == 1 else signal.SIGTERM)  # the second ends what goes on

    def watched(follower: Follower) -> None:
        working.extend(thread.name for thread in threading.enumerate() if thread.name.startswith("nice"))
        cut(follower)

    monkeypatch.setattr(Follower, "cut", watched)
    before = signal.signal(signal.SIGUSR1, fail)
    try:
        with pytest.raises(RuntimeError, match="no stop signal"):
            follow(files.open_state(arm_name), path, past=True, span_s=None, step=step)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert working == []
    assert cycles_in(path) > 0 and path.stat().st_size == told[-1].size


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf", "1e12"])
def test_a_time_that_is_none_is_refused(rtarm: Rtarm, live: Live, arm_name: str, seconds: str) -> None:
    result = rtarm("record", arm_name, f"--for={seconds}")
    assert result.exit_code == 1
    assert "--for is " in result.stderr and len(result.stderr.splitlines()) == 1


def test_an_arm_that_does_not_run_cannot_be_followed(rtarm: Rtarm, arm_name: str) -> None:
    result = rtarm("record", arm_name, "-f")
    assert result.exit_code == 1
    assert f"No control process is running for arm '{arm_name}'" in result.stderr
