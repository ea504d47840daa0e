"""The page of the states of arm and goal, from the two tables by which the cycle changes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from typing import Any

from handbook.markdown import code, page, table
from handbook.memory import members
from rtloop.memory import modes
from rtloop.trajectory import phases

INTRODUCTION = """\
The arm is in one mode, and each of its two goals, the one that runs and the one that waits to take over, in one phase.
Both change in one place each, by the tables below, and every other change is refused. Each change of a phase is a test
(`tests/rtloop/trajectory/test_phases.py`)."""
MODES = "[What each is](../explanation/architecture.md#modes). The file is `rtloop/memory/modes.py`."
MODES_PICTURE = "![The modes of the arm and the changes between them](../pictures/arm_modes.svg)"
PHASES = """\
The file is `rtloop/trajectory/phases.py`. A goal that stops has a reason, which becomes its outcome when the arm
stands: the first one stands, but a fault comes before all, and everything before lack of a stream's next message.
Pauses are a person's hold; what slows the arm down beside that (a drive that is late, points that have not come,
the way to a newer goal) changes no phase."""
PHASES_PICTURE = "![The phases of a goal, the changes between them, and its outcomes](../pictures/goal_phases.svg)"


def build() -> str:
    """The page."""
    parts = [INTRODUCTION, "## Modes of the arm", MODES, MODES_PICTURE, drawn(modes.ALLOWED)]
    parts += ["## Phases of a goal", PHASES, PHASES_PICTURE, drawn(phases.ALLOWED)]
    return page("Modes and phases", *parts)


def drawn(allowed: Mapping[Any, Sequence[Any]]) -> str:
    """A table of changes: from the state of the row to that of the column."""
    kind: type[IntEnum] = type(next(iter(allowed)))
    return table(("from", *(f"→ {state.name.lower()}" for state in kind), "it"), changes(kind, allowed))


def changes(kind: type[IntEnum], allowed: Mapping[Any, Sequence[Any]]) -> Iterator[tuple[str, ...]]:
    """A row a state."""
    for state, (_, _, meaning) in zip(kind, members(kind), strict=True):
        yield code(state.name.lower()), *("●" if to in allowed[state] else "" for to in kind), meaning
