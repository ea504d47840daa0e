"""Steps that the dialogues of most families take, each with its sentence: it answers, is without error, lets go."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from config.joint import JointConfig
from rtloop.drives.asking import AskFrames
from rtloop.drives.setup import ERROR_AT_START, Host
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part, silent_amid
from rtloop.service.port import Frame

State = TypeVar("State")
Setting = TypeVar("Setting")


def unanswered(joint: int, config: JointConfig, number: str, check: str, where: str = "") -> DialogueFailed:
    """The first question of a bring-up has no answer.

    In the sentence `number` says which drive it is, `check` what may be wrong with it beside power and wires, and
    `where` on what it should have answered.
    """
    return DialogueFailed(
        joint,
        f"The drive of {config.name} ({number}) does not answer{where}: check its power, {check}, and the CAN wires "
        "with 120 Ω at both ends.",
    )


def answered(joint: int, config: JointConfig, question: AskFrames, what: str) -> Part[Frame]:
    """The answer of a drive that has answered before; raises DialogueFailed where none comes."""
    answer: Frame | None = yield question
    if answer is None:
        raise DialogueFailed(joint, silent_amid(config, what))
    return answer


def without_error(
    host: Host,
    joint: int,
    found: State,
    error: Callable[[State], str],
    cleared: Callable[[], Part[State]],
    *,
    called: str = "error",
    version: str = "",
    find: str = "remove it",
    tries: int = TRIES,
) -> Part[State]:
    """The drive's state without an error, which is cleared only where a person has asked for that.

    Args:
        host: the bring-up.
        joint: the drive's joint.
        found: the state that the drive was found in.
        error: a state's error in words, "" where it has none.
        cleared: tells the drive to forget its error, and asks for its state.
        called: what the maker calls an error.
        version: of its firmware, with a blank before it, behind the joint's name in the sentences.
        find: what a person does about one that stays.
        tries: how often it is cleared.

    Raises:
        DialogueFailed: the drive has an error that may not be cleared, or keeps one.
    """
    name = f"{host.arm.joints[joint].name}{version}"
    if error(found) and not host.clears_protection:
        article = "an" if called[0] in "aeiou" else "a"
        raise DialogueFailed(
            joint,
            f"The drive of {name} has {article} {called} ({error(found)}) and holds nothing: remove the cause, "
            f"{ERROR_AT_START}.",
        )
    for _ in range(tries):
        if not error(found):
            break
        found = yield from cleared()
    if error(found):
        raise DialogueFailed(
            joint,
            f"The drive of {name} keeps its {called} ({error(found)}) after it was cleared, so what caused it is still "
            f"there: {find}, then `rtarm clear-fault`.",
        )
    return found


def written(
    write: Callable[[], Part[object]], read: Callable[[], Part[Setting]], wanted: Callable[[Setting], bool]
) -> Part[Setting]:
    """What a drive says of a setting after it was written, some times if need be until it is as wanted."""
    for _ in range(TRIES):
        yield from write()
        found = yield from read()
        if wanted(found):
            break
    return found


def let_go(
    joint: int, config: JointConfig, told: Callable[[], Part[str]], remedy: str = "look at the drive's display"
) -> Dialogue:
    """Tell a drive to hold nothing any more until it does not.

    `told` tells it and says what it is still doing, "" where it has let go; `remedy` is what a person does then.

    Raises:
        DialogueFailed: it goes on holding.
    """
    for _ in range(TRIES):
        still = yield from told()
        if not still:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} {still} after being told to let go: keep clear of the arm, {remedy}, then `rtarm "
        "clear-fault`, which brings all drives up again.",
    )
