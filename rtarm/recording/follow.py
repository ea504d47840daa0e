"""`rtarm record --follow`: a recording that goes on until somebody ends it, or for a time.

The rings of the state file are read again and again, read-only, and what is new is appended, once a second at least, so
that a file whose writer was killed holds all but the last second. What was overwritten before it was read is counted.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, NamedTuple

from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import signals_noted
from rtarm.console.niceness import done_by, nice_thread
from rtarm.recording import folder
from rtarm.recording.make import ASKED
from rtarm.recording.mcap_format import BATCH, Reason
from rtarm.recording.mcap_writer import Growing, NotWritten, check_target, is_full, new_aside
from shm import files
from shm.files import MemoryFile
from shm.recording import Position, Recording, kept_from, now_at, read_on

NS = 1_000_000_000
LOOK_S = 0.5
"""So often the rings are read; they hold half a minute, so that a machine that is busy for long costs nothing."""
SPARED = 11
"""The oldest of so many parts of the rings, which hold 33 s, is let be."""
SHORTEST_S, LONGEST_S = 0.1, 366 * 86400.0


class Progress(NamedTuple):
    """How far a recording has come: seconds of the arm's life, bytes, and what is missing amid it."""

    seconds: float = 0.0
    size: int = 0
    cycles_missing: int = 0
    frames_missing: int = 0

    def told(self) -> str:
        """In words, such as `12.0 s, 0.7 MB, nothing missing`."""
        missing = [
            f"{count} {what}{'' if count == 1 else 's'}"
            for count, what in ((self.cycles_missing, "cycle"), (self.frames_missing, "frame"))
            if count
        ]
        return f"{self.seconds:.1f} s, {self.size / 1e6:.1f} MB, {' and '.join(missing) or 'nothing'} missing"


class _File:
    """The file, which is there from the first cycle on."""

    def __init__(self, path: Path, reason: Reason) -> None:
        check_target(path)
        self._path, self._reason = path, reason
        self._file: IO[bytes] | None = None
        self._growing: Growing | None = None
        self.whole = 0

    def add(self, piece: Recording) -> None:
        if self._growing is None:
            fd, aside = new_aside(self._path)
            self._file = open(fd, "wb")  # noqa: SIM115
            try:
                self._growing = Growing(self._file, piece, self._reason)
                self._growing.flush()
                os.replace(aside, self._path)
            finally:
                Path(aside).unlink(missing_ok=True)
        assert self._file is not None
        self._growing.add(piece)
        self._growing.flush()
        self.whole = self._file.tell()

    def finish(self) -> None:
        if self._growing is not None and self._file is not None:
            self._growing.finish()
            self.whole = self._file.tell()
            self._file.close()

    def cut(self) -> None:
        """Leave what was written whole, and nothing of what was being written."""
        if self._file is None:
            return
        with contextlib.suppress(OSError):
            self._file.close()
        if self.whole:
            os.truncate(self._path, self.whole)
        else:
            self._path.unlink(missing_ok=True)


def _half_a_minute_ago(memory: MemoryFile, command: MemoryFile | None) -> Position:
    """Where half a minute begins: what is older may be overwritten before it is read, and would be a gap."""
    kept, now = kept_from(memory, command), now_at(memory, command)
    return kept._replace(
        records=kept.records and kept.records + (now.records - kept.records) // SPARED,
        frames=kept.frames and kept.frames + (now.frames - kept.frames) // SPARED,
    )


class Follower:
    """Appends what an arm does to a file."""

    def __init__(self, memory: MemoryFile, path: Path, *, past: bool) -> None:
        """`memory` is a state file, which stays open; `past`: begin with what is kept of the time before.

        Raises:
            NotWritten: the file cannot be made.
            OSError: the same.
        """
        header = memory.record["header"]
        arm = files.arm_name(header)
        self._memory = memory
        self._command = files.watch_command(arm, int(header["pid"]))
        self._since = (_half_a_minute_ago if past else now_at)(memory, self._command)
        self._most = min(BATCH, max(1, NS // int(header["period_ns"])))  # a second's at once, so that little is lost
        self._first_ns = 0
        self.progress = Progress()
        try:
            self._file = _File(path, Reason(ASKED, "Asked for by a person, to go on until told to end."))
        except BaseException:
            self._close_command()
            raise

    def take(self, step: Callable[[Progress], None] = lambda _: None) -> None:
        """Append everything that is new; at its end all of it is in the file."""
        while self._take_some():
            step(self.progress)
        step(self.progress)

    def _take_some(self) -> bool:
        """Append some of what is new; False when that was all. Events and frames wait for a cycle to be timed by."""
        before = self._since
        piece, after = read_on(self._memory, before, self._command, self._most)
        if len(piece.records) == 0:
            return False
        self._file.add(piece)
        self._since = after
        last_ns = int(piece.records["monotonic_ns"][-1])
        self._first_ns = self._first_ns or int(piece.records["monotonic_ns"][0])
        self.progress = self.progress._replace(
            seconds=(last_ns - self._first_ns) * 1e-9,
            size=self._file.whole,
            cycles_missing=self.progress.cycles_missing + after.records - before.records - len(piece.records),
            frames_missing=self.progress.frames_missing + after.frames - before.frames - len(piece.frames),
        )
        return after.records - before.records >= self._most

    def finish(self) -> None:
        """End the file in order."""
        self._file.finish()
        self._close_command()
        self.progress = self.progress._replace(size=self._file.whole)

    def cut(self) -> None:
        """End the file where it was last whole."""
        self._close_command()
        self._file.cut()

    def _close_command(self) -> None:
        if self._command is not None:
            self._command.close()


def follow(
    memory: MemoryFile,
    output: Path | None,
    *,
    past: bool,
    span_s: float | None,
    step: Callable[[Progress], None] = lambda _: None,
) -> tuple[Path, str]:
    """Record a running arm until SIGINT, SIGTERM or SIGHUP, for `span_s`, or until its control process ends.

    Returns the file, and in words how long it is and why it ended. The state file is closed then.

    Raises:
        Refusal: nothing could be recorded, or not as long as it was asked for.
    """
    arm = files.arm_name(memory.record["header"])
    if span_s is not None and not SHORTEST_S <= span_s <= LONGEST_S:
        memory.close()
        raise Refusal(f"--for is {span_s:g}, but a recording lasts {SHORTEST_S:g} to {LONGEST_S:.0f} seconds.")
    path = output if output is not None else folder.new_path(arm, folder.LONG)
    until_s = None if span_s is None else time.monotonic() + span_s
    left = 0
    try:
        with signals_noted() as wait, nice_thread() as thread:
            follower = Follower(memory, path, past=past)
            try:
                # Signals come to this thread, which only waits.
                why = done_by(thread, lambda: _until_the_end(memory, follower, wait, until_s, step))
                follower.finish()
            except BaseException:
                signal.raise_signal(signal.SIGTERM)  # is noted, and ends the thread if it still works
                thread.shutdown()
                left = follower.progress.size
                follower.cut()
                raise
    except OSError as problem:
        raise _not_written(path, problem, left) from problem
    finally:
        memory.close()
    progress = follower.progress
    if progress.size == 0:
        raise Refusal(f"The control process of {arm} has not run a cycle meanwhile, so nothing was recorded.")
    if why == ENDED and until_s is not None:
        raise Refusal(
            f"The control process of {arm} ended before the {span_s:g} s were over; {path} has what it did until then "
            f"({progress.told()}).",
            ExitCode.REFUSED,
        )
    return path, f"{progress.told()}{'' if why != ENDED else f'; the control process of {arm} has ended'}"


ENDED = "ended"


def _until_the_end(
    memory: MemoryFile,
    follower: Follower,
    wait: Callable[[float], str],
    until_s: float | None,
    step: Callable[[Progress], None],
) -> str:
    """Append until there is a reason to end, and return it: a signal's name, ENDED, or "" when the time is over."""
    while True:
        left_s = LOOK_S if until_s is None else min(LOOK_S, until_s - time.monotonic())
        heard = wait(left_s)
        over = until_s is not None and time.monotonic() >= until_s
        lives = files.is_held(memory.fd)  # asked before the last look, so that nothing is missed
        follower.take(step)
        if heard or not lives or over:
            return heard or ("" if lives else ENDED)


def _not_written(path: Path, problem: OSError, left: int) -> NotWritten:
    """Why it could not go on; the file holds the bytes that were written whole until then."""
    if left == 0:
        remedy = "free some space there" if is_full(problem) else "give a file in a folder that you may write to"
        return NotWritten(f"The recording {path} cannot be written ({problem.strerror}): {remedy}.")
    return NotWritten(
        f"The recording {path} cannot be continued ({problem.strerror}) and ends after {left / 1e6:.1f} MB, which "
        "`rtarm explain` and `rtarm plot` can read: free some space, or give a file on another disk with -o."
    )
