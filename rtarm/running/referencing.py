"""A person's word for where joints stand, one by one or all at once; nothing moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from rtarm.console.errors import Refusal
from rtarm.console.language import said
from rtarm.running.requests import Connection, connect, see_to_the_end, stands_at
from sentences.meaning import Language
from sentences.told import answer_sentence, unreferenced_cause, unreferenced_sentence
from shm.errors import SharedMemoryError
from shm.words import Answer, Mode, Request, Unreferenced

MAY_STAND_WHERE_READ = frozenset(
    {Unreferenced.SILENT, Unreferenced.TARGET_FAR, Unreferenced.MOVED, Unreferenced.INCREMENTAL}
)
"""The count may mean what it says, which a look at the joint tells; after anything else it does not."""
AS_SHOWN_DEG = 0.5
"""A joint that reads something else by more than this is not where the person saw it."""


class Reading(NamedTuple):
    """A joint without a reference."""

    joint: str
    stands_deg: float | None
    """Where it stands if its count is to be believed, None where it is not."""
    cause: str
    """Why it has none: half a sentence."""
    homes: bool
    """Whether its drive finds a stop."""


def angles_said(words: Sequence[str]) -> dict[str, float | None]:
    """Joint → angle (degrees), None where none is said, of words such as `joint2` and `joint3=-12.5`."""
    said: dict[str, float | None] = {}
    for word in words:
        joint, equals, angle = word.partition("=")
        if joint in said:
            raise Refusal(f"{joint} is named twice: give it one angle.", joint=joint)
        try:
            said[joint] = float(angle) if equals else None
        except ValueError:
            said[joint] = math.nan
        if not math.isfinite(said[joint] or 0.0):
            raise Refusal(
                f"The angle of {joint} is {angle!r}, which is no number: write degrees without a unit, such as "
                f"{joint}=-12.5."
            )
    return said


def reference(arm: str, said_deg: Mapping[str, float | None]) -> str:
    """Take a person's word for where joints stand (degrees), or that they stand where they read (None)."""
    with connect(arm) as connection:
        for joint, angle_deg in said_deg.items():
            _refuse_angle(connection, joint, angle_deg)
        _refuse_amid_a_fault(connection)
        taken: list[str] = []
        for joint, angle_deg in said_deg.items():
            try:
                taken.append(_take(connection, joint, angle_deg))
            except Refusal as refused:
                before = f" Before that was taken: {', '.join(taken)}." if taken else ""
                raise Refusal(f"{refused}{before}") from None
        why_lost = connection.why_lost(connection.snapshot())
    return " ".join([f"Taken: {', '.join(taken)}.", *why_lost])


def readings(arm: str, language: Language = "en") -> list[Reading]:
    """What the joints without a reference read, in the arm's order.

    Raises:
        Refusal: they cannot be given one just now.
        SharedMemoryError: the arm is not running.
    """
    with connect(arm, language) as connection:
        _refuse_amid_a_fault(connection)
        found = _readings(connection)
        if found and connection.snapshot()["mode"] != Mode.HOLDING:
            raise Refusal(answer_sentence(Answer.REFUSED_MODE, language))
    return found


def take(arm: str, shown: Sequence[Reading], language: Language = "en") -> str:
    """Take joints to stand where a person who was shown these readings has seen them.

    Raises:
        Refusal: not all of them have a reference then; a line for what was taken and for each that was not.
        SharedMemoryError: the arm is not running.
    """
    all_have_one = said(language, "All joints of arm {arm} are referenced.", arm=arm)
    if not shown:
        return all_have_one
    offered = [reading for reading in shown if reading.stands_deg is not None]
    taken: list[str] = []
    refused: list[str] = []
    with connect(arm, language) as connection:
        for number, reading in enumerate(offered, start=1):
            try:
                if _lacks_a_reference_as_shown(connection, reading):
                    taken.append(_take(connection, reading.joint, None))
            except Refusal as refusal:
                refused.append(
                    said(language, "{joint} was not taken: {why}", joint=reading.joint, why=refusal.sentence)
                )
                if connection.fault(connection.snapshot()):
                    refused += [
                        said(language, "{joint} was not tried after that.", joint=after.joint)
                        for after in offered[number:]
                    ]
                    break
    lines = [said(language, "Taken: {joints}.", joints=", ".join(taken))] if taken else []
    if left := [reading for reading in shown if reading.stands_deg is None]:
        refused.append(no_angle_words(left, language))
    if refused:
        raise Refusal("\n".join([*lines, *refused]))
    return " ".join(lines) or all_have_one


def no_angle_words(left: Sequence[Reading], language: Language = "en") -> str:
    """That what these joints count is not to be believed, and what else gives them a reference."""
    return said(
        language,
        "The count of {joints} is no angle: {ways}.",
        joints=_names(left),
        ways=next_commands(left, language),
    )


def question(shown: Sequence[Reading]) -> str:
    """What a person is asked who has been shown these readings; "" where there is nothing to agree to."""
    offered = [reading for reading in shown if reading.stands_deg is not None]
    return f"Look at the arm: do they stand there ({_names(offered)})?" if offered else ""


def lacking(arm: str) -> list[Reading]:
    """The joints without a reference of an arm that may be ending; none where it has ended."""
    with suppress(SharedMemoryError), connect(arm) as connection:
        return _readings(connection)
    return []


def lacking_words(found: Sequence[Reading]) -> str:
    """That these joints have no reference."""
    return f"{_names(found)} {'has' if len(found) == 1 else 'have'} no reference"


def next_commands(found: Sequence[Reading], language: Language = "en") -> str:
    """The commands that give these joints a reference, in the order in which to think of them."""
    homed = [reading.joint for reading in found if reading.homes]
    to_tell = [f"{reading.joint}=DEGREES" for reading in found if reading.stands_deg is None]
    ways: list[str] = []
    if len(to_tell) < len(found):
        ways.append(said(language, "`rtarm reference --all` if the arm stands where `rtarm status` says"))
    if homed:
        ways.append(f"`rtarm home {' '.join(homed)}`")
    if to_tell:
        ways.append(said(language, "`rtarm reference {joints}` if you can tell the angle", joints=" ".join(to_tell)))
    return said(language, ", or ").join(ways)


def _names(found: Sequence[Reading]) -> str:
    return ", ".join(reading.joint for reading in found)


def _readings(connection: Connection) -> list[Reading]:
    found: list[Reading] = []
    for joint, row in zip(connection.joints, connection.snapshot()["joints"], strict=False):
        if row["referenced"]:
            continue
        reason = int(row["unreferenced_reason"]) or Unreferenced.NOT_BROUGHT_UP
        plausible = reason in MAY_STAND_WHERE_READ and int(row["measured_ns"]) != 0
        stands_deg = math.degrees(row["measured_position_rad"]) if plausible else None
        cause = unreferenced_cause(reason, joint, connection.language)
        found.append(Reading(joint, stands_deg, cause, connection.homes(joint)))
    return found


def _lacks_a_reference_as_shown(connection: Connection, shown: Reading) -> bool:
    """Whether a joint still has none; raises Refusal where it does not read any more what the person has seen."""
    now = next((reading for reading in _readings(connection) if reading.joint == shown.joint), None)
    if now is None:
        return False
    if now.stands_deg is None:
        raise Refusal(said(connection.language, "{cause}.", cause=now.cause))
    assert shown.stands_deg is not None
    if abs(now.stands_deg - shown.stands_deg) > AS_SHOWN_DEG:
        raise Refusal(
            said(
                connection.language,
                "it reads {now:.2f}°, and read {then:.2f}° when you were asked: try again.",
                now=now.stands_deg,
                then=shown.stands_deg,
            )
        )
    return True


def _take(connection: Connection, joint: str, angle_deg: float | None) -> str:
    """Let a joint stand at an angle, or where it reads (None): where it stands then.

    Raises:
        Refusal: the control process does not take that.
    """
    index = connection.index(joint)
    value = math.nan if angle_deg is None else math.radians(angle_deg)
    connection.order(Request.REFERENCE, joint_mask=1 << index, value=value)
    after = see_to_the_end(connection, lambda _: None)
    if sentence := connection.fault(after):
        raise Refusal(sentence)
    if joint in (lost := connection.lost(after)):
        raise Refusal(unreferenced_sentence(lost[joint], joint, connection.language))
    return stands_at(after, index, joint)


def _refuse_amid_a_fault(connection: Connection) -> None:
    if sentence := connection.fault(connection.snapshot()):
        raise Refusal(said(connection.language, "A fault is latched, clear it first: {fault}", fault=sentence))


def _refuse_angle(connection: Connection, joint: str, angle_deg: float | None) -> None:
    """Raise Refusal where nobody can say this of a joint."""
    index = connection.index(joint)
    if angle_deg is None:
        reason = connection.snapshot()["joints"][index]["unreferenced_reason"]
        if reason in (Unreferenced.POWER_LOST, Unreferenced.NOT_HOMED):
            raise Refusal(
                f"The drive of {joint} counts from where nobody knows, so what it reads is no angle: say where it "
                f"stands, `rtarm reference {joint}=DEGREES`, or home it."
            )
        return
    lower_deg, upper_deg = connection.limits_deg(index)
    if not lower_deg <= angle_deg <= upper_deg:
        raise Refusal(
            f"The angle of {joint} is {angle_deg:g}°, outside its limits {lower_deg:g}° to {upper_deg:g}°: look again, "
            "or mend zero_deg or direction in the arm file."
        )
