"""`rtarm teach`: the arm is let go, led by hand, held again, and what it was led along is kept as a motion."""

from __future__ import annotations

import math
import select
import shutil
import sys
import termios
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rtarm.client.moves import refuse_unsound
from rtarm.console.errors import Refusal
from rtarm.console.interrupt import Interrupted, signals_raise, undisturbed
from rtarm.console.person import Person, Quit, agrees
from rtarm.running.limits import Limits, limits_of
from rtarm.running.requests import connect, enable, let_go, stands
from rtarm.teach.file import motion_path, require_free, save
from rtarm.teach.making import Taught, make
from rtarm.teach.recording import FreeMotion
from shm import files
from shm.client import StateReader
from shm.errors import SharedMemoryError
from shm.files import MemoryFile
from shm.words import Mode, Request

LOOK_S = 0.05
DRAW_EVERY_S, LINE_EVERY_S = 0.2, 1.0
"""How often progress is shown on a terminal, and where there is none."""
LEAST_TOLERANCE_DEG, MOST_TOLERANCE_DEG = 0.05, 5.0

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Wish:
    """What a person asked for: a motion's name or path, and how it is taught.

    Attributes:
        seconds: how long is recorded; None: until somebody ends it.
        yes: nobody is asked.
        force: a motion of that name is replaced.
    """

    name: str
    tolerance_deg: float
    seconds: float | None
    yes: bool
    force: bool


def teach(arm: str, wish: Wish, person: Person) -> None:
    """Record a motion of a running arm and keep it.

    The drives are enabled again however the recording ends, but for the death of this process or the control process.

    Raises:
        Refusal: it was not begun, nothing came of it, or the arm does not hold afterwards; then what was recorded is
            kept all the same.
        SharedMemoryError: the arm is not running.
    """
    path = motion_path(wish.name)
    if not LEAST_TOLERANCE_DEG <= wish.tolerance_deg <= MOST_TOLERANCE_DEG:
        raise Refusal(
            f"--tolerance is {wish.tolerance_deg:g}°, but must be {LEAST_TOLERANCE_DEG:g}° to {MOST_TOLERANCE_DEG:g}°: "
            "give how far the motion may be beside what you led."
        )
    if wish.seconds is not None and not 0.0 < wish.seconds < math.inf:
        raise Refusal(f"--seconds is {wish.seconds:g}, but must be above 0: give how long you lead the arm.")
    require_free(path, force=wish.force)

    def tell(text: str) -> None:
        with suppress(OSError):  # a terminal that is gone takes no motion with it
            person.tell(text)

    reader = StateReader(files.open_state(arm))
    limits = limits_of(files.joint_names(reader.memory.record["header"]), np.array(reader.memory.record["limits"]))
    problem = ""
    try:
        with undisturbed():  # while the arm is limp, a signal ends the recording and nothing else
            with signals_raise():
                is_free = _is_free_or_agreed(arm, wish, person)
            if not is_free:
                let_go(arm, Request.FREE)
            try:
                taught = datetime.now(UTC).isoformat(timespec="seconds")
                recorded = FreeMotion(reader.memory)
                with suppress(Interrupted), signals_raise():
                    _record(reader.memory, recorded, limits, wish.seconds, tell)
            finally:
                problem = _hold(arm, tell)
        with signals_raise():
            tell("Smoothing and timing it …")
            made = _made(arm, limits, taught, recorded, wish, problem)
            save(made.motion, path, force=wish.force)
    except Interrupted as signalled:
        raise Refusal(f"Ended by {signalled}; nothing was saved. {problem or f'Arm {arm} holds.'}") from None
    finally:
        reader.close()
    for line in summary(wish.name, path, made, recorded.lost):
        tell(line)
    if problem:
        raise Refusal(f"{problem} What was recorded until then is kept.")


def _is_free_or_agreed(arm: str, wish: Wish, person: Person) -> bool:
    """Whether the arm is limp already; if not, somebody has agreed that he holds it. Raises Refusal otherwise."""
    with connect(arm) as connection:
        refuse_unsound(connection)
        snapshot = connection.snapshot()
    if snapshot["mode"] == Mode.FREE:
        return True
    if not stands(snapshot):
        raise Refusal(f"Arm {arm} moves, or its goal is paused: end that with `rtarm stop`, then try again.")
    question = f"The drives of {arm} go limp now and the arm falls where gravity pulls it: hold it. Let it go?"
    try:
        if not wish.yes and not agrees(person, question):
            raise Refusal("Nothing was done; the arm is as it was.")
    except Quit as ended:
        raise Refusal(f"Nothing was done ({ended}): hold the arm and say y, or give --yes in a script.") from None
    except Interrupted as signalled:
        raise Refusal(f"Nothing was done ({signalled}); the arm is as it was.") from None
    return False


def _record(memory: MemoryFile, recorded: FreeMotion, limits: Limits, seconds: float | None, tell: Tell) -> None:
    """Read and show what the encoders say until the time is over, Enter, a signal, or the arm is free no more."""
    is_terminal = sys.stdin is not None and sys.stdin.isatty()
    if is_terminal:
        with suppress(OSError, termios.error):
            termios.tcflush(sys.stdin, termios.TCIFLUSH)  # an Enter of before ends nothing
    until = "Enter ends it" if is_terminal else "SIGINT ends it"
    tell(f"The drives are limp: lead the arm; {until if seconds is None else f'{seconds:g} s are recorded'}.")
    begun = time.monotonic()
    watched = [sys.stdin] if is_terminal else []
    with _Line() as line:
        while not recorded.ended and files.is_held(memory.fd):
            recorded.take()
            elapsed_s = time.monotonic() - begun
            if recorded.last is not None:
                line.show(elapsed_s, progress(elapsed_s, recorded.last, limits))
            if seconds is not None and elapsed_s >= seconds:
                return
            if select.select(watched, (), (), LOOK_S)[0]:
                if not sys.stdin.readline():
                    watched = []  # the terminal is gone, and a signal says so
                else:
                    return


def progress(elapsed_s: float, record: np.void, limits: Limits) -> str:
    """What is shown while the arm is led: for how long, and where its joints are, an exclamation mark beyond limits."""
    places = record["joints"]["measured_position_rad"]
    beyond = (places < limits.lower_rad) | (places > limits.upper_rad)
    joints = (
        f"{joint} {math.degrees(place):.1f}°{'!' if is_beyond else ''}"
        for joint, place, is_beyond in zip(limits.joints, places, beyond, strict=True)
    )
    return f"{elapsed_s:6.1f} s  {'  '.join(joints)}"


class _Line:
    """One line that is written anew on a terminal; elsewhere a line now and then."""

    def __init__(self) -> None:
        self._is_terminal = sys.stdout.isatty()
        self._next_s = 0.0

    def __enter__(self) -> _Line:
        return self

    def show(self, elapsed_s: float, text: str) -> None:
        with suppress(OSError):  # of a terminal that is gone
            if elapsed_s < self._next_s:
                return
            self._next_s = elapsed_s + (DRAW_EVERY_S if self._is_terminal else LINE_EVERY_S)
            if self._is_terminal:
                width = shutil.get_terminal_size().columns - 1
                print(f"\r{text[:width]:<{width}}", end="", flush=True)
            else:
                print(text, flush=True)

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            if self._is_terminal:
                print(flush=True)


def _hold(arm: str, tell: Tell) -> str:
    """Let the drives take hold where the arm stands; what speaks against it, "" if they do."""
    try:
        with connect(arm) as connection:
            snapshot = connection.snapshot()
            if sentence := connection.fault(snapshot):
                return f"Hold the arm, nothing else does: {sentence}"
            if snapshot["mode"] != Mode.FREE:
                with suppress(OSError):
                    tell(f"Arm {arm} was taken over while it was led.")
                return ""
        said = enable(arm)
    except (Refusal, SharedMemoryError) as refused:
        return f"Hold the arm, its drives do not: {refused}"
    with suppress(OSError):
        tell(said)
    return ""


def _made(arm: str, limits: Limits, taught: str, recorded: FreeMotion, wish: Wish, problem: str) -> Taught:
    recorded.take()
    try:
        return make(arm, limits, taught, recorded.readings(), math.radians(wish.tolerance_deg))
    except Refusal as refused:
        raise Refusal(f"{problem} {refused}".strip()) from None


def summary(name: str, path: Path, made: Taught, lost: int) -> list[str]:
    """What a person is told of a motion that was kept."""
    motion = made.motion
    if made.slowed:
        pace = f"your hand took {made.hand_s:.1f} s, which is too fast for {', '.join(made.slowed)}"
    else:
        pace = f"as fast as your hand, which took {made.hand_s:.1f} s"
    lines = [
        f"Kept in {path}: {motion.duration_s:.1f} s ({pace}), {len(motion.times_s)} points, at most "
        f"{math.degrees(motion.deviation_rad):.2f}° beside what you led. Play it with `rtarm play {name}`."
    ]
    for joint, beyond_rad in made.beyond_rad.items():
        lines.append(
            f"{joint} was led {math.degrees(beyond_rad):.2f}° beyond its limit; the motion stays "
            f"{math.degrees(motion.tolerance_rad):g}° inside it there."
        )
    if lost:
        lines.append(f"{lost} cycles could not be read in time; the motion runs smoothly over them.")
    return lines
