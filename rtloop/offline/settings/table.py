"""The settings of a family as a table: how each is read, what the arm file wants of it, how it is written.

A family's file in this folder has one `Table`, whose methods are the functions of `talk.SettingsFile`. The rest of it
is what differs between families: how a drive says that it is there and stands, and how it stores what it was told.
Writing goes through the functions that bring-up writes with, and is judged by reading back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

from config.drives.drive import Drive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives.asking import AskFrames
from rtloop.drives.setup import ERROR_AT_START
from rtloop.offline.settings.compare import DriveReport, Setting, Value, Verdict, compared
from rtloop.service.conversation import Dialogue, DialogueFailed, Part, Question
from rtloop.service.port import Frame

Result = TypeVar("Result")

STANDS_WITHIN_TURNS = 0.003
"""About a degree of what the drive counts: a closed loop that holds dithers by less."""
DIGITS = 6
"""Those of a single that are right."""
STORE_WAITS = 10
"""A drive that writes its flash may answer late: each of these waits is as long as all tries of a question, 0.3 s."""


class Whose(NamedTuple):
    """The drive that a function of a table is about."""

    arm: ArmConfig
    joint: int

    @property
    def config(self) -> JointConfig:
        """Its joint."""
        return self.arm.joints[self.joint]

    @property
    def drive(self) -> Drive:
        """Its section of the arm file."""
        return self.config.drive

    @property
    def called(self) -> str:
        """The beginning of sentences about it."""
        return f"The drive of {self.config.name} ({self.drive.number_field} {self.drive.number})"


class State(NamedTuple):
    """How a drive is, as its first answers tell it."""

    trouble: str = ""
    """Its error in words."""
    moves: bool | None = None
    """None where it does not tell."""
    turns: float | None = None
    """Its position, in turns of what it counts."""
    supply_v: float | None = None
    holds: bool = False
    """Whether it is enabled, where that decides what may be written."""
    known: Mapping[str, Value] = {}
    """Settings that were told together with its state, by their names."""


def not_named(whose: Whose) -> Value:
    """What the arm file wants of a setting that it does not name."""
    return None


def number(whose: Whose) -> Value:
    """The drive's number, which the arm file always names."""
    return whose.drive.number


def bitrate(whose: Whose) -> Value:
    """The bit rate of its bus."""
    return whose.arm.bus_of(whose.config).bitrate


def named(key: str) -> Callable[[Whose], Value]:
    """A key of the drive's section, wanted where the file names it."""
    return lambda whose: getattr(whose.drive, key) if key in whose.drive.model_fields_set else None


def always(whose: Whose) -> bool:
    """A setting that is written to any drive of the family."""
    return True


@dataclass(frozen=True)
class Row:
    """One setting."""

    name: str
    """As in the arm file where it names it, else in its style: with the unit."""
    where: str
    """Where the maker has it, for people: register, parameter, object or command, its range, what it is at first."""
    read: Callable[[Whose], Part[Value]] | None = None
    """None where `State.known` has it, or nothing where no frame reads it."""
    wanted: Callable[[Whose], Value] = not_named
    write: Callable[[Whose, Any], Part[object]] | None = None
    may_write: Callable[[Whose], bool] = always
    kept: bool = False
    """Whether a drive keeps it without power however it is written."""

    def compared(self, whose: Whose, found: Value) -> Setting:
        """The setting beside what the arm file wants; a drive need not report one that is not written anyway."""
        writable = self.write is not None and self.may_write(whose)
        wanted = None if found is None and not writable else self.wanted(whose)
        return compared(self.name, wanted, found, writable=writable, kept=self.kept)


@dataclass
class Reading:
    """What a drive has told about itself; values are None where it did not tell them."""

    state: State | None = None
    values: dict[str, Value] = field(default_factory=dict)
    first: Question | None = field(default=None, repr=False)
    """The first question; a table asks it once only, so its answers can be counted."""
    asked: int = field(default=0, repr=False)
    answers: int = field(default=0, repr=False)

    @property
    def shared_address(self) -> bool:
        """Whether the first question has had more answers than it was sent."""
        return self.answers > self.asked

    def note_question(self, question: Question) -> None:
        """Count how often the first question is sent."""
        self.first = self.first or question
        self.asked += question is self.first

    def note_frame(self, frame: Frame) -> None:
        """Count the answers to the first question."""
        self.answers += isinstance(self.first, AskFrames) and self.first.is_answer(frame)

    def may_move_since(self, before: Reading) -> bool:
        """See `talk.Reading`."""
        if self.state is None:
            return False
        were = None if before.state is None else before.state.turns
        here = self.state.turns
        return self.state.moves is not False or were is None or here is None or abs(here - were) > STANDS_WITHIN_TURNS

    def is_written_alike(self, before: Reading) -> bool:
        """A drive that stores stores all that it has, so all that was read must be the same."""
        return self.values == before.values


@dataclass(frozen=True)
class Table:
    """What `rtarm drives` knows of a family."""

    rows: tuple[Row, ...]
    state: Callable[[Whose], Part[State | None]]
    """Ask whether the drive is there, and how it is; None if it does not answer. Its first question is asked once."""
    trouble: Callable[[Whose], Part[str]] | None = None
    """Its error in words, where that takes questions which two drives of one address must not be asked."""
    store: Callable[[Whose], Part[str | None]] | None = None
    """Let the drive store what it has; why it may not have, to follow its name. It raises nothing."""
    remarks: Callable[[Whose, Reading], list[str]] = lambda whose, found: []
    """Sentences about a drive that answers."""
    hinders: Callable[[Whose, State], str] = lambda whose, state: ""
    """Why a drive in this state is not written to, to follow its name; "" where nothing does."""

    def new_reading(self) -> Reading:
        """See `talk.SettingsFile`."""
        return Reading()

    def read(self, arm: ArmConfig, joint: int, found: Reading) -> Dialogue:
        """See `talk.SettingsFile`."""
        whose = Whose(arm, joint)
        found.state = yield from told(self.state(whose))
        if found.state is None or found.shared_address:  # of drives that share an address nothing more is asked
            return
        if self.trouble is not None:
            found.state = found.state._replace(trouble=(yield from told(self.trouble(whose))) or "")
        for row in self.rows:
            value = found.state.known.get(row.name)
            found.values[row.name] = value if row.read is None else (yield from told(row.read(whose)))

    def report_of(self, arm: ArmConfig, joint: int, found: Reading, shared: int | None = None) -> DriveReport:
        """See `talk.SettingsFile`; drives of other addresses are heard beside those that share one."""
        whose, state = Whose(arm, joint), found.state
        settings = [row.compared(whose, found.values[row.name]) for row in self.rows if found.values]
        firmware, hardware = found.values.get("firmware"), found.values.get("hardware")
        return DriveReport(
            joint=whose.config.name,
            address=whose.drive.number,
            answers=state is not None,
            firmware=None if firmware is None else str(firmware),
            hardware=hardware if isinstance(hardware, (int, str)) else None,
            supply_v=None if state is None else state.supply_v,
            homing=None,
            trip=None,
            settings=settings,
            left_alone=self._left_alone(whose, found, settings),
            notes=self.remarks(whose, found) if found.values else [],
        )

    def write(
        self, arm: ArmConfig, joint: int, found: Reading, settings: list[Setting], store: bool
    ) -> Part[str | None]:
        """See `talk.SettingsFile`."""
        whose = Whose(arm, joint)
        rows = {row.name: row for row in self.rows}
        for setting in settings:
            row = rows[setting.name]
            assert row.write is not None and row.read is not None
            yield from told(row.write(whose, setting.wanted))
            after = yield from told(row.read(whose))
            if after is None:
                return f"stopped answering when it was told its {row.name}, so what it has now is not known"
            if row.compared(whose, after).verdict is not Verdict.SAME:
                return f"keeps another {row.name} ({row.where}) than it was told"
        if store and self.store is not None and not all(setting.kept for setting in settings):
            return (yield from self.store(whose))
        return None

    def _left_alone(self, whose: Whose, found: Reading, settings: list[Setting]) -> list[str]:
        drive, state = whose.drive, found.state
        bus = whose.arm.bus_of(whose.config)
        if found.shared_address:
            return [
                f"More than one drive answers at {drive.number_field} {drive.number} of {whose.config.name}: unplug "
                "all but one and give each a number of its own."
            ]
        if state is None:
            return [
                f"{whose.called} does not answer: check its power, its {drive.number_field} and its bit rate "
                f"({bus.bitrate} bit/s), and the CAN wires with 120 Ω at both ends; `rtarm scan` looks for "
                "it elsewhere."
            ]
        reasons = []
        if state.trouble:
            reasons.append(f"{whose.called} has an error ({state.trouble}): remove the cause, {ERROR_AT_START}.")
        if state.moves is not False:
            does = "moves" if state.moves else "does not say whether it stands"
            reasons.append(f"{whose.called} {does}: settings are only written while the arm stands.")
        differ = any(setting.writable and setting.verdict is Verdict.DIFFERS for setting in settings)
        hindered = self.hinders(whose, state) if differ else ""
        if hindered:
            reasons.append(f"{whose.called} {hindered}.")
        return reasons


def told(part: Part[Result]) -> Part[Result | None]:
    """What a part of a dialogue finds out; None where the drive does not answer it, or not so."""
    try:
        return (yield from part)
    except DialogueFailed:
        return None


def sent_once(question: AskFrames) -> Part[Frame | None]:
    """The answer to a command to store, which is not sent again while it takes its time: flash wears out."""
    answer: Frame | None = yield replace(question, answered=False)
    for _ in range(STORE_WAITS):
        if answer is not None:
            break
        answer = yield replace(question, frames=())
    return answer


def rounded(value: float) -> float | None:
    """A single as people write it; None for no number."""
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None


def word(code: int | None, words: Mapping[int, str]) -> str | None:
    """A code as a word, by itself where it has none."""
    return None if code is None else words.get(code, f"code {code}")
