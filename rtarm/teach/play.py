"""`rtarm play`: a taught motion through the arm's ordinary action, so that every check of a goal applies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from config.errors import ConfigError
from config.loader import known_arms, load_arm
from config.schema import ArmConfig
from rosfront.moves import Profile
from rtarm.calibrate.person import Person, Quit, agrees
from rtarm.errors import ExitCode, Refusal
from rtarm.interrupt import Interrupted, signals_raise, undisturbed
from rtarm.launcher import SIMULATED_CHANNEL
from rtarm.requests import STOP_PATIENCE_S, Connection, connect, stands
from rtarm.sending import Sender, goal_document, sending
from rtarm.teach.file import load, motion_path
from rtarm.teach.motion import Limits, Motion, Reals
from rtarm.teach.recording import limits_of
from rtarm.teach.teach import sound
from shm import files
from shm.client import StateReader

SLOW = 0.25
"""Share of the limits that the move to the beginning uses."""
THERE_RAD = math.radians(0.5)
"""No joint farther than this from the beginning: the motion can begin."""
KNOT_SHARE = 0.02
"""Of the way between two points of that move."""
ROUNDED = 1e-5
"""What a factor may be above the largest allowed, which is calculated from rounded angles."""
PATIENCE_S = 86_400.0
"""A person may pause a goal, and slow it down, for as long as he likes."""


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
        reader = StateReader(files.open_state(arm))
        try:
            check(path, motion, arm, limits_of(reader.memory), speed)
        finally:
            reader.close()
        sound(connection)
        config = running_config(argument, arm)
        goal = motion_goal(motion, speed)
        rounds = 0
        try:
            with signals_raise():
                _agree(connection, motion, yes, person)
                with sending(config) as sender:
                    while True:
                        _go_to_start(connection, sender, motion, person)
                        repeats = f", round {rounds + 1}; Ctrl-C ends it" if loop else ""
                        person.tell(f"Playing {path.stem}, {motion.duration_s / speed:.1f} s{repeats}.")
                        person.tell(_run(connection, sender, goal))
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


def running_config(argument: str | None, arm: str) -> ArmConfig:
    """The file of a running arm, which tells where its action is.

    Raises:
        Refusal: nobody knows which file that is.
        ConfigError: it cannot be read.
    """
    given = argument if argument is not None and ("/" in argument or argument.endswith((".yaml", ".yml"))) else arm
    if given == arm and arm not in known_arms():
        raise Refusal(f"{arm} is no arm that comes with rtarm: say which file it runs with, `--arm ./{arm}.yaml`.")
    try:
        return load_arm(given)
    except ConfigError:  # a simulated arm's file may name no adapter
        return load_arm(given, overrides={"bus": {"interface": "slcan", "channel": SIMULATED_CHANNEL}})


def motion_goal(motion: Motion, speed: float) -> dict[str, Any]:
    """The motion as a goal: positions and velocities, between which the arm follows the same cubic spline."""
    return goal_document(
        motion.limits.joints,
        motion.times_s / speed,
        motion.positions_rad,
        motion.curve(motion.times_s, 1) * speed,
    )


def slow_move(start_rad: Reals, target_rad: Reals, limits: Limits) -> tuple[Reals, Reals, Reals, Reals]:
    """All together from rest to rest with `SLOW` of the limits: times, positions, velocities, accelerations."""
    way = target_rad - start_rad
    length = np.maximum(np.abs(way), 1e-9)
    profile = Profile.fastest(
        float((SLOW * limits.velocity_rad_s / length).min()), float((SLOW * limits.acceleration_rad_s2 / length).min())
    )
    times_s = profile.times_s(KNOT_SHARE)
    share, rate, bend = (values[:, np.newaxis] for values in profile.at(times_s))
    return times_s, start_rad + share * way, rate * way, bend * way


def _stands_at(connection: Connection) -> Reals:
    joints = connection.snapshot()["joints"][: len(connection.joints)]
    return np.array(joints["commanded_position_rad"])


def _is_there(connection: Connection, motion: Motion) -> bool:
    return bool((np.abs(_stands_at(connection) - motion.positions_rad[0]) <= THERE_RAD).all())


def way_words(joints: Sequence[str], start_rad: Reals, target_rad: Reals) -> str:
    """From where to where each joint goes that goes anywhere."""
    return ", ".join(
        f"{joint} {math.degrees(start):.1f}° → {math.degrees(target):.1f}°"
        for joint, start, target in zip(joints, start_rad, target_rad, strict=True)
        if abs(target - start) > THERE_RAD / 10.0
    )


def _agree(connection: Connection, motion: Motion, yes: bool, person: Person) -> None:
    """Let a person agree to the way to the beginning, which nothing has checked for what stands in it."""
    if yes or _is_there(connection, motion):
        return
    way = way_words(motion.limits.joints, _stands_at(connection), motion.positions_rad[0])
    try:
        agreed = agrees(person, f"The arm moves slowly and straight to where it begins: {way}. Is the way clear?")
    except Quit as ended:
        raise Refusal(f"Nothing was done ({ended}): say y, or give --yes in a script.") from None
    if not agreed:
        raise Refusal("Nothing was done; the arm stands where it stood.")


def _go_to_start(connection: Connection, sender: Sender, motion: Motion, person: Person) -> None:
    if _is_there(connection, motion):
        return
    start_rad, target_rad = _stands_at(connection), motion.positions_rad[0]
    times_s, positions, velocities, accelerations = slow_move(start_rad, target_rad, motion.limits)
    way = way_words(motion.limits.joints, start_rad, target_rad)
    person.tell(f"To where it begins, {times_s[-1]:.1f} s: {way}.")
    _run(connection, sender, goal_document(motion.limits.joints, times_s, positions, velocities, accelerations))


def _run(connection: Connection, sender: Sender, goal: dict[str, Any]) -> str:
    """Send a goal and wait for its end: the sentence of its success. A signal cancels it, and the arm stands then.

    Raises:
        Refusal: it did not succeed.
        Interrupted: a signal came.
    """
    try:
        outcome = sender.wait(sender.send(goal), PATIENCE_S)
    except Interrupted:
        with undisturbed():
            sender.cancel()
            connection.wait(
                stands,
                STOP_PATIENCE_S,
                f"Arm {connection.arm} still moves {STOP_PATIENCE_S:g} s after its goal was cancelled: use the "
                "emergency stop, then look at `rtarm status`.",
            )
        raise
    if not outcome.succeeded:
        raise Refusal(outcome.sentence, ExitCode.GOAL_FAILED)
    return outcome.sentence
