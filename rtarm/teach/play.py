"""`rtarm play`: a taught motion through the arm's ordinary action, so that every check of a goal applies."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from rtarm.client import moves
from rtarm.client.sender import goal_document, sending
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted, signals_raise
from rtarm.console.person import Person, require_yes
from rtarm.running.arm_file import arm_file
from rtarm.running.limits import Limits, limits_of
from rtarm.running.requests import Connection, connect
from rtarm.teach.file import load, motion_path
from rtarm.teach.motion import Motion, Reals

ROUNDED = 1e-5
"""What a factor may be above the largest allowed, which is calculated from rounded angles."""


def play(argument: str | None, arm: str, name: str, *, speed: float, loop: bool, yes: bool, person: Person) -> None:
    """Play a motion on a running arm.

    Args:
        argument: the arm as it was given, whose file tells its action; None for the only one that runs.
        arm: its name.
        name: of the motion, or its path.
        speed: times as fast as it was taught.
        loop: again and again, until a signal comes.
        yes: nobody is asked before the arm moves to where it begins.

    Raises:
        Refusal: it cannot be played so, or a goal did not succeed.
        SharedMemoryError, ConfigError: the arm is not running, or its file cannot be read.
    """
    path = motion_path(name)
    motion = load(path)
    with connect(arm) as connection:
        check(path, motion, arm, limits_of(connection.joints, connection.limits()), speed)
        moves.refuse_unless_holding(connection)
        config = arm_file(argument, arm)
        goal, begin_rad = motion_goal(motion, speed), motion.positions_rad[0]
        rounds = 0
        try:
            with signals_raise():
                if not yes and not moves.is_near(connection, begin_rad):
                    require_yes(person, _question(connection, begin_rad))
                with sending(config) as sender:
                    while True:
                        moves.go_slowly(connection, sender, begin_rad, person)
                        repeats = f", round {rounds + 1}; Ctrl-C ends it" if loop else ""
                        person.tell(f"Playing {path.stem}, {motion.duration_s / speed:.1f} s{repeats}.")
                        person.tell(moves.run(connection, sender, goal))
                        rounds += 1
                        if not loop:
                            return
        except Interrupted as signalled:
            ended = f"Ended by {signalled} after {rounds} {'round' if rounds == 1 else 'rounds'}; arm {arm} stands."
            if not loop:
                raise Refusal(f"Ended by {signalled}; arm {arm} stands.", ExitCode.GOAL_FAILED) from None
            person.tell(ended)


def check(path: Path, motion: Motion, arm: str, limits: Limits, speed: float) -> None:
    """Raise Refusal where a motion is another arm's, or cannot be played so fast."""
    if difference := motion.limits.difference(limits):
        raise Refusal(
            f"{path} was taught to another arm ({motion.arm}) than {arm} as it runs: {difference}. Teach it to this "
            "one."
        )
    if outside := motion.outside():
        raise Refusal(f"{path} cannot be played: {outside}. Mend the file, or teach it again.")
    if not 0.0 < speed < math.inf:
        raise Refusal(f"--speed is {speed:g}, but must be above 0: 1 is as it was taught, 0.5 half as fast.")
    fastest = motion.fastest()
    if speed > fastest * (1.0 + ROUNDED):
        shown = math.floor(fastest * 100.0) / 100.0
        raise Refusal(f"--speed is {speed:g}, but the arm's limits allow at most {shown:g} for this motion: give that.")


def motion_goal(motion: Motion, speed: float) -> dict[str, Any]:
    """The motion as a goal: positions and velocities, between which the arm follows the same cubic spline."""
    return goal_document(
        motion.limits.joints,
        motion.times_s / speed,
        motion.positions_rad,
        motion.curve(motion.times_s, 1) * speed,
    )


def _question(connection: Connection, begin_rad: Reals) -> str:
    """What a person is asked before the way to the beginning, which nothing has checked for what stands in it."""
    way = moves.way_words(connection, begin_rad)
    return f"The arm moves slowly and straight to where it begins: {way}. Is the way clear?"
