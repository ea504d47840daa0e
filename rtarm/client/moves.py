"""Motions of a running arm through its ordinary action: slowly to where one begins, then along it.

Nothing here sees what is in the arm's way, so a person is asked before. Ctrl-C cancels the goal, and the arm stands
before the command ends.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np

from rosfront.full_node.moves import Profile
from rtarm.client.sender import Sender, follow, goal_document
from rtarm.console.errors import GoalFailed, Refusal
from rtarm.console.interrupt import Interrupted, undisturbed
from rtarm.console.person import Person
from rtarm.running.decisions import decision
from rtarm.running.requests import Connection, stands
from rtarm.running.status import STOPPED_BY_A_PERSON
from shm.errors import EndedMeanwhile, NotRunning
from shm.words import Mode

SLOW = 0.25
"""Share of the limits that the way to the beginning uses."""
THERE_RAD = math.radians(0.5)
"""No joint farther than this from the beginning: nobody needs to be asked for the way, nor told of it."""
ROUNDING_RAD = 1e-6
"""Not even the action sees a way as short as this."""
WAYPOINT_SHARE = 0.02
"""Of the way between two points of the way to the beginning."""
SILENT = (
    "The arm has run no goal for {seconds:g} s, and the ROS process has not said what became of this one; it is "
    "cancelled, and ends at once should it begin later: look at `rtarm status`."
)


def refuse_unsound(connection: Connection) -> None:
    """Raise Refusal where a fault is latched or a joint's angle is not known."""
    snapshot = connection.snapshot()
    if sentence := connection.fault(snapshot):
        raise Refusal(f"A fault is latched, clear it first: {sentence}")
    if why_lost := connection.why_lost(snapshot):
        raise Refusal(" ".join(why_lost))


def refuse_unless_holding(connection: Connection) -> None:
    """The same, and where the arm does not just stand and hold."""
    refuse_unsound(connection)
    snapshot = connection.snapshot()
    if snapshot["held"]:
        raise Refusal(STOPPED_BY_A_PERSON)
    if snapshot["mode"] != Mode.HOLDING:
        raise Refusal(
            f"Arm {connection.arm} does not stand still and hold at the moment: see `rtarm status`, then try again."
        )


def is_near(connection: Connection, target_rad: np.ndarray) -> bool:
    """Whether no joint is commanded to stand farther than `THERE_RAD` from a target (joints,)."""
    return bool((np.abs(target_rad - _stands_at_rad(connection)) <= THERE_RAD).all())


def way_words(connection: Connection, target_rad: np.ndarray) -> str:
    """From where to where each joint goes that goes anywhere."""
    return ", ".join(
        f"{joint} {math.degrees(start):.1f}° → {math.degrees(target):.1f}°"
        for joint, start, target in zip(connection.joints, _stands_at_rad(connection), target_rad, strict=True)
        if abs(target - start) > THERE_RAD / 10.0
    )


def go_slowly(connection: Connection, sender: Sender, target_rad: np.ndarray, person: Person) -> None:
    """Go where a motion begins (joints,), in a straight line of the joints, and tell the person where that is.

    Raises:
        Refusal: the arm did not get there.
        Interrupted: a signal came; the arm stands.
    """
    start_rad = _stands_at_rad(connection)
    if not np.any(np.abs(target_rad - start_rad) > ROUNDING_RAD):
        return
    rows = connection.limits()["joints"][: len(connection.joints)]
    times_s, *way = slow_move(start_rad, target_rad, rows["max_velocity_rad_s"], rows["max_acceleration_rad_s2"])
    if not is_near(connection, target_rad):
        person.tell(f"To where it begins, {times_s[-1]:.1f} s: {way_words(connection, target_rad)}.")
    run(connection, sender, goal_document(connection.joints, times_s, *way))


def slow_move(
    start_rad: np.ndarray,
    target_rad: np.ndarray,
    velocity_rad_s: np.ndarray,
    acceleration_rad_s2: np.ndarray,
    speed: float = SLOW,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """All joints together from rest to rest with a share of these limits, (joints,) each.

    Returns times (n,), positions, velocities and accelerations (n, joints).
    """
    way_rad = target_rad - start_rad
    length_rad = np.maximum(np.abs(way_rad), ROUNDING_RAD)
    profile = Profile.fastest(
        float((speed * velocity_rad_s / length_rad).min()), float((speed * acceleration_rad_s2 / length_rad).min())
    )
    times_s = profile.times_s(WAYPOINT_SHARE)
    share, rate, bend = (values[:, np.newaxis] for values in profile.at(times_s))
    return times_s, start_rad + share * way_rad, rate * way_rad, bend * way_rad


def run(connection: Connection, sender: Sender, goal: dict[str, Any]) -> str:
    """Send a goal and wait for its end: the sentence of its success.

    Raises:
        GoalFailed: it did not succeed, or nobody will say how it ended and it was cancelled.
        EndedMeanwhile: the control process has died, which is why it did not, whoever says so first.
        Interrupted, KeyboardInterrupt: a signal came; the goal was cancelled and the arm stands.
        Refusal: it could not be sent; or the arm still moves after it was cancelled, which the sentence says.
    """
    try:
        return _run(connection, sender, goal)
    except EndedMeanwhile:
        raise
    except NotRunning as ended:  # in order, which is no death
        raise GoalFailed(str(ended)) from None


def _run(connection: Connection, sender: Sender, goal: dict[str, Any]) -> str:
    number = None
    try:
        number = sender.send(goal)
        outcome = follow(connection, sender, number, SILENT)
        assert outcome is not None
    except (Interrupted, KeyboardInterrupt):
        with undisturbed():
            _cancel(connection, sender)
        raise
    except Refusal as unknown:
        if number is None:
            raise
        with undisturbed():
            _cancel(connection, sender)
        connection.check_running()
        raise GoalFailed(unknown.sentence) from None
    if outcome.succeeded:
        return outcome.sentence
    decided = decision(connection, outcome.sentence)
    if decided is None:  # what the control process decided is how it ended, also where it has ended in order since
        connection.check_running()
    raise GoalFailed(outcome.sentence, **({} if decided is None else decided.details()))


def _cancel(connection: Connection, sender: Sender) -> None:
    """Cancel what was sent, and wait until the arm stands.

    Where the process that sent it is gone or hangs, every goal of the arm is ended through shared memory.
    """
    sender.cancel()
    patience_s = connection.patience.person_s
    if sender.alive:
        with suppress(Refusal):
            connection.wait(stands, patience_s, "")
            return
    connection.writer.cancel_all()
    connection.wait(
        stands,
        patience_s,
        f"Arm {connection.arm} still moves {patience_s:.1f} s after its goal was cancelled: use the emergency stop, "
        "then look at `rtarm status`.",
    )


def _stands_at_rad(connection: Connection) -> np.ndarray:
    """Where the joints are commanded to stand (joints,)."""
    return np.array(connection.snapshot()["joints"][: len(connection.joints)]["commanded_position_rad"])
