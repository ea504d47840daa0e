"""What a number in shared memory means, told in the language that was asked for.

English is what is told wherever no `language` is asked for: logs, recordings, JSON and ROS messages stay the same for
programs. The tables of both languages (`english`, `chinese`) have the same keys and placeholders.
"""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any

from sentences import chinese, drive_words, english
from sentences.meaning import Language, Meaning, Phrases, Silence
from shm.words import Answer, BusState, Evidence, Fault, GripTrouble, Mode, Outcome, Request, Unreferenced

PHRASES: dict[Language, Phrases] = {"en": english.PHRASES, "zh": chinese.PHRASES}
TABLES: dict[Language, dict[type[IntEnum], Mapping[Any, Meaning]]] = {
    "en": {
        Outcome: english.OUTCOMES,
        Fault: english.FAULTS,
        Silence: english.SILENCES,
        BusState: english.BUS_STATES,
        Unreferenced: english.UNREFERENCED,
        Answer: english.ANSWERS,
        GripTrouble: english.GRIP_TROUBLES,
    },
    "zh": {
        Outcome: chinese.OUTCOMES,
        Fault: chinese.FAULTS,
        Silence: chinese.SILENCES,
        BusState: chinese.BUS_STATES,
        Unreferenced: chinese.UNREFERENCED,
        Answer: chinese.ANSWERS,
        GripTrouble: chinese.GRIP_TROUBLES,
    },
}


class _Value(float):
    """A number that can be written as the name of a mode, or as what is wrong with a drive."""

    language: Language

    def __new__(cls, value: float, language: Language) -> "_Value":
        made = super().__new__(cls, value)
        made.language = language
        return made

    def __format__(self, spec: str) -> str:
        whole = self.is_integer()
        phrases = PHRASES[self.language]
        if spec == "mode":
            return mode_name(int(self), self.language) if whole else phrases.unknown_mode.format(mode=float(self))
        if spec == "drive":
            if whole:
                return drive_words.fault_words(int(self), self.language)
            return phrases.unknown_status.format(status=float(self))
        return super().__format__(spec)


def mode_name(mode: int, language: Language = "en") -> str:
    """A mode as people read it."""
    phrases = PHRASES[language]
    try:
        return phrases.modes[Mode(mode)]
    except ValueError:
        return phrases.unknown_mode.format(mode=mode)


def joint_name(joint: int, joints: Sequence[str], language: Language = "en") -> str:
    """The name of the joint a record is about, "no joint" where it is about none."""
    return joints[joint] if 0 <= joint < len(joints) else PHRASES[language].no_joint


def joint_names(joints: Sequence[str], language: Language = "en") -> str:
    """The names of joints as a sentence lists them."""
    phrases = PHRASES[language]
    return phrases.before_last.join(filter(None, (phrases.between.join(joints[:-1]), *joints[-1:])))


def meaning(member: IntEnum, language: Language = "en") -> Meaning:
    """The row of an outcome, a fault, a silence, a bus state, a reason, an answer or a gripper's trouble."""
    return TABLES[language][type(member)][member]


def _say(
    kind: type[IntEnum], number: int, language: Language, joint: str = "", value: float = 0.0, limit: float = 0.0
) -> str:
    try:
        member = kind(number)
    except ValueError:
        return PHRASES[language].unknown.format(kind=kind.__name__.lower(), number=number)
    return _filled(meaning(member, language), language, joint, value, limit)


def _filled(row: Meaning, language: Language, joint: str, value: float, limit: float) -> str:
    return row.sentence.format(joint=joint, value=_Value(value, language), limit=_Value(limit, language))


def outcome_sentence(
    outcome: int, joint: str = "", value: float = 0.0, limit: float = 0.0, language: Language = "en"
) -> str:
    """How a goal ended."""
    return _say(Outcome, outcome, language, joint, value, limit)


def fault_sentence(
    fault: int, joint: str = "", value: float = 0.0, limit: float = 0.0, language: Language = "en"
) -> str:
    """What a latched fault says."""
    return _say(Fault, fault, language, joint, value, limit)


def whose_silence(joint: int, silent: int, evidence: int) -> Silence | None:
    """Whose silence a STALE_READING is, by what was known when it was latched; None for that of one drive.

    Supply or switch come first wherever nothing speaks for something else: drives that have lost their power count from
    another place. What speaks for something else is told in the order in which it leaves the least doubt.

    Args:
        joint: the joint that the fault names, -1 where all drives are silent.
        silent: bit n: the drive of joint n is silent.
        evidence: bits of shm.words.Evidence.
    """
    if joint >= 0:
        return Silence.SEVERAL_DRIVES if silent.bit_count() > 1 else None
    for bits, whose in _SPEAKS_FOR:
        if evidence & bits:
            return whose
    return Silence.SUPPLY


_SPEAKS_FOR = (
    (Evidence.HEARD, Silence.NOT_BELIEVED),
    (Evidence.UNACKNOWLEDGED, Silence.NOT_ACKNOWLEDGED),
    (Evidence.BABBLE, Silence.BABBLE),
    (Evidence.BUS_ERRORS, Silence.BUS),
    (Evidence.CYCLE_LATE | Evidence.READER_LATE, Silence.MACHINE),
    (Evidence.SIMULATED, Silence.SIMULATED_ARM),
    (Evidence.NOT_TAKEN, Silence.NOT_TAKEN),
    (Evidence.ADAPTER_MUTE, Silence.ADAPTER),
    (Evidence.ADAPTER_ANSWERS, Silence.SUPPLY_OR_CABLE),
)


def latched_sentence(cycle: Any, joints: Sequence[str], language: Language = "en", buses: Sequence[str] = ()) -> str:
    """What the latched fault says of a snapshot, or of the flight recorder's record of a cycle.

    `buses` are the names of the arm's buses, where it has several.
    """
    number, joint = int(cycle["fault"]), int(cycle["fault_joint"])
    value, limit = float(cycle["fault_value"]), float(cycle["fault_limit"])
    silent, evidence = int(cycle["fault_silent"]), int(cycle["fault_evidence"])
    return fault_told(number, joint, value, limit, silent, evidence, joints, language, buses)


def fault_told(
    fault: int,
    joint: int,
    value: float,
    limit: float,
    silent: int,
    evidence: int,
    joints: Sequence[str],
    language: Language = "en",
    buses: Sequence[str] = (),
) -> str:
    """What a fault says by all that is known of it, whoever tells it.

    `buses` are the names of the arm's buses, where it has several: one of a wire then names its bus.
    """
    whose = whose_silence(joint, silent, evidence) if fault == Fault.STALE_READING else None
    if whose is None:
        sentence = fault_sentence(fault, joint_name(joint, joints, language), value, limit, language)
        return of_bus(sentence, buses[int(limit)], language) if is_of_wire(fault, limit, buses) else sentence
    named = joint_names([name for number, name in enumerate(joints) if silent >> number & 1], language)
    return _filled(meaning(whose, language), language, named, value, limit)


def is_of_wire(fault: int, limit: float, buses: Sequence[str]) -> bool:
    """Whether a fault is one of a wire, and its limit the number of a bus that has a name."""
    return fault in (Fault.WIRE, Fault.LINK_DOWN, Fault.BUS_OFF) and 0 <= limit < len(buses)


def of_bus(sentence: str, bus: str, language: Language = "en") -> str:
    """A sentence about one of several buses, by its name; "" for the only one."""
    return PHRASES[language].of_bus.format(bus=bus, sentence=sentence) if bus else sentence


def bus_state_sentence(state: int, language: Language = "en", bus: str = "") -> str:
    """What the CAN controller thinks of its bus, which is named where the arm has several."""
    return of_bus(_say(BusState, state, language), bus, language)


def unreferenced_sentence(reason: int, joint: str, language: Language = "en") -> str:
    """Why a joint's count does not mean an angle."""
    return _say(Unreferenced, reason, language, joint)


def unreferenced_cause(reason: int, joint: str, language: Language = "en") -> str:
    """What has happened to a joint's count: the same without what follows from it, and without a full stop."""
    return unreferenced_sentence(reason, joint, language).partition(PHRASES[language].so)[0]


def reasons_unreferenced(cycle: Any, joints: Sequence[str]) -> dict[str, int]:
    """The joints without a reference, and why (shm.words.Unreferenced), of a snapshot or a record of a cycle."""
    rows = cycle["joints"]
    return {
        name: int(rows[index]["unreferenced_reason"])
        for index, name in enumerate(joints)
        if not rows[index]["referenced"]
    }


def unreferenced_sentences(reasons: Mapping[str, int], language: Language = "en") -> list[str]:
    """Why counts do not mean angles, once for all joints with the same reason: by the joints' names, in their order."""
    joints: dict[int, list[str]] = {}
    for name, reason in reasons.items():
        joints.setdefault(reason, []).append(name)
    return [_of_each(reason, names, language) for reason, names in joints.items()]


def _of_each(reason: int, joints: Sequence[str], language: Language) -> str:
    if len(joints) == 1:
        return unreferenced_sentence(reason, joints[0], language)
    each = PHRASES[language].each_of.format(joints=joint_names(joints, language))
    sentence = unreferenced_sentence(reason, each, language)
    return sentence if sentence.startswith(joints[0]) else sentence[:1].upper() + sentence[1:]  # a name stays as it is


def grip_trouble_sentence(trouble: int, value: float, language: Language = "en") -> str:
    """Why the gripper on the bus cannot do what it is told."""
    return _say(GripTrouble, trouble, language, value=value)


def command_sentence(kind: int, value: float, language: Language = "en") -> str:
    """What was asked by a store: of a speed scale the scale, of all others by which process."""
    phrases = PHRASES[language]
    if kind == Request.SPEED_SCALE:
        return phrases.speed_asked.format(scale=value)
    known = kind in set(phrases.asked)
    what = phrases.asked[Request(kind)] if known else phrases.unknown_command.format(kind=kind)
    return phrases.asked_by.format(what=what, process=value)


def answer_sentence(answer: int, language: Language = "en") -> str:
    """How a request was answered."""
    return _say(Answer, answer, language)
