"""`rtarm replay --on-arm`: the running arm moves as a recorded one was moved, through its ordinary action.

What is replayed is the path that was *commanded*: it was made inside the limits, it is as smooth as the arm was asked
to be, and it has no gaps where a drive did not answer. The measured one lags behind it and carries the encoders' noise,
and an arm that follows it would lag behind that once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rtarm.client import moves
from rtarm.client.sender import goal_document, sending
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted, signals_raise
from rtarm.console.person import Person, require_yes
from rtarm.running.arm_file import arm_file
from rtarm.running.requests import Connection, connect
from rtarm.running.status import resolve_arm
from shm.recording import Recording
from shm.words import Fault, Mode, Slowed

LED = (Mode.HOLDING, Mode.EXECUTING, Mode.STOPPING)
"""Modes in which the arm is where it is commanded."""
SLOWEST = 0.01
BESIDE = 1e-6
"""What a value may be beside its limit (rad and the like): rounding."""


class Path(NamedTuple):
    """A commanded motion from rest to rest.

    Attributes:
        times_s: (n,), from 0.
        positions_rad, velocities_rad_s, accelerations_rad_s2: (n, joints).
        begins_s, ends_s: where in the recording it lies.
        ended_by: what the rest of the recording is left out for, "" if nothing moved there.
    """

    times_s: np.ndarray
    positions_rad: np.ndarray
    velocities_rad_s: np.ndarray
    accelerations_rad_s2: np.ndarray
    begins_s: float
    ends_s: float
    ended_by: str


def path_of(recording: Recording) -> Path:
    """The first motion in a recording from rest to rest, all goals of it, up to whatever interrupts it.

    It is interrupted by a fault, by cycles that are missing, and by the drives being let go or referenced: what was
    commanded then is no motion that anybody asked for. It ends where the arm last stood before that.

    Raises:
        Refusal: there is no such motion.
    """
    records = recording.records
    led = np.isin(records["mode"], LED) & (records["fault"] == Fault.NONE) & (records["slowed"] & Slowed.OWN_BRAKE == 0)
    for word in ("commanded_position_rad", "commanded_velocity_rad_s", "commanded_acceleration_rad_s2"):
        led &= np.isfinite(records["joints"][word]).all(axis=1)
    moving = np.any(records["joints"]["commanded_velocity_rad_s"] != 0.0, axis=1)
    breaks = np.flatnonzero((np.diff(records["number"]) != 1) | (led[1:] != led[:-1])) + 1
    for start, end in zip((0, *breaks), (*breaks, len(records)), strict=True):
        at = np.arange(start, end)
        rests = at[~moving[start:end]]
        if not led[start] or len(rests) < 2:
            continue
        goes = np.flatnonzero(moving[rests[0] : rests[-1]]) + rests[0]
        if len(goes):
            return _cut(recording, goes[0] - 1, goes[-1] + 1, _why_cut(records, end, bool(moving[end - 1])))
    raise Refusal(
        "In this recording the arm never moves from rest to rest while it was led by goals, so there is no motion to "
        "replay: record one with `rtarm record --for SECONDS` while it moves."
    )


def _why_cut(records: np.ndarray, end: int, amid: bool) -> str:
    if end == len(records):
        return "the recording ends in motion" if amid else ""
    if records["fault"][end] != Fault.NONE:
        return "a fault was latched"
    if records["number"][end] - records["number"][end - 1] != 1:
        return "cycles are missing in the recording"
    return "the drives were let go, referenced or brought up"


def _cut(recording: Recording, first: int, last: int, why: str) -> Path:
    rows = recording.records[first : last + 1]
    start_ns = int(recording.records["monotonic_ns"][0])
    times_s = (rows["monotonic_ns"] - rows["monotonic_ns"][0]) * 1e-9
    joints = rows["joints"]
    return Path(
        times_s,
        joints["commanded_position_rad"],
        joints["commanded_velocity_rad_s"],
        joints["commanded_acceleration_rad_s2"],
        float(rows["monotonic_ns"][0] - start_ns) * 1e-9,
        float(rows["monotonic_ns"][-1] - start_ns) * 1e-9,
        why,
    )


def check(recording: Recording, path: Path, joints: Sequence[str], limits: np.ndarray, speed: float) -> None:
    """Refuse a path that is not for an arm with these joints and limits (layout.Limits), at so much of its speed.

    Raises:
        Refusal: with the first thing that does not fit.
    """
    if tuple(joints) != recording.joints:
        raise Refusal(
            f"The recording is of an arm with the joints {', '.join(recording.joints)}, and this one has "
            f"{', '.join(joints)}: replay it on the arm that it was made of."
        )
    for index, name in enumerate(joints):
        row = limits["joints"][index]
        fastest = float(row["max_velocity_rad_s"] * limits["velocity_margin"])
        hardest = float(row["max_acceleration_rad_s2"] * limits["acceleration_margin"])
        lower = "replay it on an arm with the limits that it was recorded with"
        slower = "give a lower --speed"
        for does, values, (least, most), unit, remedy in (
            ("goes to", path.positions_rad, (float(row["lower_rad"]), float(row["upper_rad"])), "rad", lower),
            ("moves at", path.velocities_rad_s * speed, (-fastest, fastest), "rad/s", slower),
            ("accelerates by", path.accelerations_rad_s2 * speed**2, (-hardest, hardest), "rad/s²", slower),
        ):
            beyond = np.maximum(values[:, index] - most, least - values[:, index])
            if beyond.max() > BESIDE:
                raise Refusal(
                    f"{name} {does} {values[beyond.argmax(), index]:.4f} {unit} there, and this arm allows {least:.4f} "
                    f"to {most:.4f} {unit}: {remedy}."
                )


def goal_of(recording: Recording, path: Path, speed: float) -> dict[str, Any]:
    """The path as a goal, as it was or slower, between whose points the arm follows the cubics it followed then."""
    return goal_document(
        recording.joints, path.times_s / speed, path.positions_rad, velocities_rad_s=path.velocities_rad_s * speed
    )


def replay_on_arm(recording: Recording, argument: str | None, *, speed: float, yes: bool, person: Person) -> None:
    """Move a running arm along the commanded path of a recording.

    Args:
        argument: name or file of the running arm; None for the one that was recorded.
        speed: 1 is as it was, less is slower.
        yes: nobody is asked before the arm moves.

    Raises:
        Refusal: it does not fit, nobody agreed, or a goal did not succeed.
        SharedMemoryError, ConfigError: the arm is not running, or its file cannot be read.
    """
    if not SLOWEST <= speed <= 1.0:
        raise Refusal(f"--speed is {speed:g}, but an arm replays at {SLOWEST:g} to 1 times the speed of then.")
    path = path_of(recording)
    arm = resolve_arm(argument or recording.arm)
    with connect(arm) as connection:
        moves.refuse_unless_holding(connection)
        check(recording, path, connection.joints, connection.limits(), speed)
        config = arm_file(argument, arm)
        same = connection.arm_hash() == recording.arm_hash
        person.tell(_announcement(recording, path, speed, same=same))
        try:
            with signals_raise():
                if not yes:
                    require_yes(person, _question(connection, path))
                with sending(config) as sender:
                    moves.go_slowly(connection, sender, path.positions_rad[0], person)
                    person.tell("Replaying.")
                    person.tell(moves.run(connection, sender, goal_of(recording, path, speed)))
        except Interrupted as signalled:
            raise Refusal(f"Ended by {signalled}; arm {arm} stands.", ExitCode.GOAL_FAILED) from None


def _announcement(recording: Recording, path: Path, speed: float, *, same: bool) -> str:
    said = [
        f"What was commanded {path.begins_s:.1f} s to {path.ends_s:.1f} s into the recording is replayed, which takes "
        f"{path.times_s[-1] / speed:.1f} s"
    ]
    if path.ended_by:
        said.append(f"; nothing after that, since {path.ended_by}")
    said.append(".")
    if not same:
        said.append(
            f" The arm file is not the one that {recording.arm} was recorded with: if zero_deg, direction or ratio of "
            "a joint is another now, the same angles are other places."
        )
    return "".join(said)


def _question(connection: Connection, path: Path) -> str:
    """What a person is asked, who sees what stands in the arm's way; nothing here does."""
    begin_rad = path.positions_rad[0]
    way = moves.way_words(connection, begin_rad)
    first = "" if moves.is_near(connection, begin_rad) else f"first slowly to where that begins ({way}), then "
    return f"The arm moves, {first}along the path of then. Is the way clear?"
