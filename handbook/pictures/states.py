"""The modes of the arm and the phases of a goal, drawn from the tables by which the cycle changes them.

Places and words stand here, arrows come from the tables: an arrow without words, or words without an arrow, end the
program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from handbook.pictures.svg import BLUE, FAINT, RED, Drawing, Point
from rtloop.memory.modes import ALLOWED as MODES
from rtloop.trajectory.phases import ALLOWED as PHASES
from shm.words import Mode, Outcome, Phase

Change = tuple[IntEnum, IntEnum]

BOX = (124.0, 40.0)
DOT = (16.0, 16.0)
LABEL_PX, NAME_PX, OUTCOME_PX = 14.0, 16.0, 12.5
APART = 9.0
"""Two arrows between the same boxes are so far from the line between them."""


class Words(NamedTuple):
    """What stands at an arrow, and where: how far along it, and how far beside."""

    lines: Sequence[str]
    beside: Point = (0.0, 0.0)
    anchor: str = "middle"
    along: float = 0.5


@dataclass(frozen=True)
class Diagram:
    """Boxes and arrows."""

    places: Mapping[IntEnum, Point]
    """The middle of each box."""
    words: Mapping[Change, Words]
    sizes: Mapping[IntEnum, Point] = field(default_factory=dict)
    """Of the boxes that have one of their own."""
    upright: Mapping[Change, float] = field(default_factory=dict)
    """Arrows that go straight up or down, and where."""

    def draw_arrows(self, drawing: Drawing, changes: Sequence[Change]) -> None:
        """Draw an arrow with its words for each change."""
        assert set(changes) == set(self.words), set(changes) ^ set(self.words)
        for change in changes:
            begin, end = self._line(change, apart=APART if change[::-1] in changes else 0.0)
            drawing.arrow([begin, end], color=FAINT)
            said = self.words[change]
            x, y = (begin[axis] + said.along * (end[axis] - begin[axis]) + said.beside[axis] for axis in (0, 1))
            drawing.lines((x, y), said.lines, anchor=said.anchor, size=LABEL_PX)

    def draw_box(self, drawing: Drawing, state: IntEnum, color: str) -> None:
        """Draw a state with its name."""
        (x, y), (width, height) = self.places[state], self.size(state)
        drawing.box((x - width / 2, y - height / 2), (width, height), fill="#eef2f7", color=color, round_px=8)
        drawing.text((x, y + 5), state.name.lower(), size=NAME_PX)

    def size(self, state: IntEnum) -> Point:
        """Width and height of a state's box."""
        return self.sizes.get(state, BOX)

    def _line(self, change: Change, apart: float) -> tuple[Point, Point]:
        """From box to box, as far as that to the left of the line between their middles."""
        begin, end = self.places[change[0]], self.places[change[1]]
        if change in self.upright:
            x = self.upright[change]
            begin, end = (x, begin[1]), (x, end[1])
        length = ((end[0] - begin[0]) ** 2 + (end[1] - begin[1]) ** 2) ** 0.5
        x, y = apart * (end[1] - begin[1]) / length, apart * (begin[0] - end[0]) / length
        begin, end = (begin[0] + x, begin[1] + y), (end[0] + x, end[1] + y)
        return self._leaving(change[0], begin, end), self._leaving(change[1], end, begin)

    def _leaving(self, state: IntEnum, inside: Point, outside: Point) -> Point:
        """Where the way from a point inside a state's box to one outside of it leaves the box."""
        way = outside[0] - inside[0], outside[1] - inside[1]
        middle, size = self.places[state], self.size(state)
        edges = [middle[axis] + (size[axis] / 2 if way[axis] > 0 else -size[axis] / 2) for axis in (0, 1)]
        share = min((edges[axis] - inside[axis]) / way[axis] for axis in (0, 1) if way[axis])
        return inside[0] + share * way[0], inside[1] + share * way[1]


# --- the modes of the arm

MODE_DIAGRAM = Diagram(
    places={
        Mode.OFFLINE: (86, 190),
        Mode.BRINGING_UP: (258, 190),
        Mode.HOLDING: (618, 190),
        Mode.EXECUTING: (862, 190),
        Mode.STOPPING: (862, 345),
        Mode.REFERENCING: (618, 70),
        Mode.DISABLED: (438, 280),
        Mode.FREE: (438, 405),
        Mode.FAULT: (490, 505),
    },
    words={
        (Mode.OFFLINE, Mode.BRINGING_UP): Words(["start"], (0, -11)),
        (Mode.BRINGING_UP, Mode.HOLDING): Words(["every drive is known"], (0, -11)),
        (Mode.HOLDING, Mode.EXECUTING): Words(["a goal begins"], (0, -11)),
        (Mode.EXECUTING, Mode.HOLDING): Words(["the goal is over"], (0, 13)),
        (Mode.EXECUTING, Mode.STOPPING): Words(["cancel, stop,", "what cannot", "go on"], (8, 0), "start"),
        (Mode.STOPPING, Mode.EXECUTING): Words(["a newer", "goal begins"], (-8, -18), "end"),
        (Mode.STOPPING, Mode.HOLDING): Words(["the arm stands"], (-4, 16), "end"),
        (Mode.HOLDING, Mode.REFERENCING): Words(["home, reference"], (-8, 0), "end"),
        (Mode.REFERENCING, Mode.HOLDING): Words(["all joints are done"], (8, 0), "start"),
        (Mode.HOLDING, Mode.DISABLED): Words(["disable"], (-6, -10), "end"),
        (Mode.HOLDING, Mode.FREE): Words(["free"], (10, 8), "start"),
        (Mode.DISABLED, Mode.FREE): Words(["free"], (8, 0), "start", along=0.2),
        (Mode.FREE, Mode.DISABLED): Words(["disable"], (-8, 0), "end", along=0.8),
        (Mode.DISABLED, Mode.BRINGING_UP): Words(["enable"], (6, -10), "start"),
        (Mode.FREE, Mode.BRINGING_UP): Words(["enable"], (-10, 8), "end"),
        (Mode.FAULT, Mode.BRINGING_UP): Words(["clear fault"], (-8, 0), "end", along=0.3),
    },
    sizes={Mode.FAULT: (640.0, BOX[1])},
    upright={(Mode.FAULT, Mode.BRINGING_UP): 215.0},
)
FRAME = ((16.0, 24.0), (964.0, 422.0))
"""Around all modes in which a fault may be latched: as in UML, an arrow from a frame is one from each mode inside."""


def arm_modes() -> str:
    """The state machine of the arm."""
    drawing = Drawing(996, 545, "The modes of the arm and the changes between them, as rtloop/memory/modes.py has them")
    assert all(Mode.FAULT in goes_to for mode, goes_to in MODES.items() if mode != Mode.FAULT)
    corner, size = FRAME
    drawing.box(corner, size, color=RED, round_px=12, dash="6 4")
    changes = [(mode, to) for mode, goes_to in MODES.items() for to in goes_to if to != Mode.FAULT]
    MODE_DIAGRAM.draw_arrows(drawing, changes)
    x, y = MODE_DIAGRAM.places[Mode.FAULT]
    bottom = corner[1] + size[1]
    drawing.arrow([(x + 190, bottom), (x + 190, y - BOX[1] / 2)], color=RED)
    drawing.text((x + 198, bottom + 24), "a fault is latched, in any mode", anchor="start", size=LABEL_PX)
    for mode in MODES:
        MODE_DIAGRAM.draw_box(drawing, mode, RED if mode == Mode.FAULT else BLUE)
    return drawing.svg()


# --- the phases of a goal

PHASE_DIAGRAM = Diagram(
    places={
        Phase.NONE: (40, 130),
        Phase.WAITING: (215, 130),
        Phase.RUNNING: (440, 130),
        Phase.SETTLING: (770, 130),
        Phase.PAUSED: (605, 240),
        Phase.STOPPING: (605, 350),
    },
    words={
        (Phase.NONE, Phase.WAITING): Words(["BEGIN"], (0, -11)),
        (Phase.WAITING, Phase.RUNNING): Words(["it is due, a", "way is found"], (0, -22)),
        (Phase.RUNNING, Phase.SETTLING): Words(["its last point is commanded"], (0, -11)),
        (Phase.RUNNING, Phase.PAUSED): Words(["hold"], (8, -6), "start"),
        (Phase.PAUSED, Phase.RUNNING): Words(["resume"], (-8, 8), "end"),
        (Phase.SETTLING, Phase.PAUSED): Words(["hold"], (10, 10), "start"),
        (Phase.PAUSED, Phase.SETTLING): Words(["resume"], (-8, -6), "end"),
        (Phase.RUNNING, Phase.STOPPING): Words(
            ["cancel, stop,", "tolerance, fault,", "what cannot go on"], (-8, 0), "end"
        ),
        (Phase.SETTLING, Phase.STOPPING): Words(["cancel, stop,", "fault"], (8, 0), "start"),
        (Phase.PAUSED, Phase.STOPPING): Words(["cancel, stop, fault"], (8, 0), "start"),
    },
    sizes={Phase.NONE: DOT, Phase.STOPPING: (454.0, BOX[1])},
    upright={(Phase.RUNNING, Phase.STOPPING): 415.0, (Phase.SETTLING, Phase.STOPPING): 795.0},
)
ENDS: Mapping[Phase, Sequence[Outcome]] = {
    Phase.NONE: (
        *(Outcome.REFUSED_MODE, Outcome.REFUSED_UNREFERENCED, Outcome.REFUSED_CORRUPT, Outcome.REFUSED_HELD),
        *(Outcome.REFUSED_OUTDATED, Outcome.REFUSED_STREAM, Outcome.CANCELED, Outcome.SHUTDOWN),
    ),
    Phase.WAITING: (
        *(Outcome.REFUSED_START, Outcome.REFUSED_LIMITS, Outcome.REFUSED_CORRUPT, Outcome.REFUSED_HELD),
        *(Outcome.REFUSED_OUTDATED, Outcome.CANCELED, Outcome.REPLACED, Outcome.STARVED, Outcome.FRONT_LOST),
        *(Outcome.SHUTDOWN, Outcome.FAULT),
    ),
    Phase.RUNNING: (Outcome.REPLACED, Outcome.CLOCK_GAP),
    Phase.SETTLING: (
        *(Outcome.SUCCEEDED, Outcome.GOAL_TOLERANCE, Outcome.GOAL_VELOCITY, Outcome.GOAL_ACCELERATION),
        *(Outcome.REPLACED, Outcome.CLOCK_GAP),
    ),
    Phase.PAUSED: (Outcome.CLOCK_GAP,),
    Phase.STOPPING: (
        *(Outcome.CANCELED, Outcome.STOPPED, Outcome.PATH_TOLERANCE, Outcome.PATH_VELOCITY, Outcome.PATH_ACCELERATION),
        *(Outcome.FAULT, Outcome.STARVED, Outcome.FRONT_LOST, Outcome.SHUTDOWN, Outcome.RAN_DRY),
        *(Outcome.REFUSED_CORRUPT, Outcome.REPLACED, Outcome.CLOCK_GAP),
    ),
}
"""The outcomes with which a goal ends in each phase; NONE: its BEGIN is refused."""
TOLD: Mapping[Phase, tuple[Point, Point, Sequence[int], str]] = {
    Phase.NONE: ((40, 138), (40, 205), [1] * 8, "start"),
    Phase.WAITING: ((215, 150), (215, 205), [1] * 11, "middle"),
    Phase.RUNNING: ((440, 110), (440, 62), [2], "middle"),
    Phase.SETTLING: ((832, 130), (866, 130), [1] * 6, "start"),
    Phase.PAUSED: ((667, 240), (700, 240), [1], "start"),
    Phase.STOPPING: ((605, 370), (605, 404), [5, 5, 3], "middle"),
}
"""Where the arrow to a phase's outcomes begins and ends, how many of them stand in each line, and how."""


def goal_phases() -> str:
    """The life of a goal, and how it may end in each phase."""
    drawing = Drawing(990, 500, "The phases of a goal, the changes between them, and the outcomes with which it ends")
    changes = [(phase, to) for phase, goes_to in PHASES.items() for to in goes_to if to != Phase.NONE]
    PHASE_DIAGRAM.draw_arrows(drawing, changes)
    for phase in PHASES:
        if phase == Phase.NONE:
            drawing.dot(PHASE_DIAGRAM.places[phase], DOT[0] / 2)
        else:
            PHASE_DIAGRAM.draw_box(drawing, phase, BLUE)
        _draw_ends(drawing, phase)
    return drawing.svg()


def _draw_ends(drawing: Drawing, phase: Phase) -> None:
    """Draw with which outcomes a goal ends in a phase."""
    assert phase == Phase.NONE or Phase.NONE in PHASES[phase]
    begin, end, counts, anchor = TOLD[phase]
    drawing.arrow([begin, end], color=RED)
    names = iter(outcome.name.lower() for outcome in ENDS[phase])
    lines = [", ".join(next(names) for _ in range(count)) for count in counts]
    assert not list(names)
    x, y = end
    if anchor == "start" and begin[1] == end[1]:
        drawing.lines((x + 5, y), lines, anchor=anchor, size=OUTCOME_PX)
        return
    below = 1 if end[1] > begin[1] else -1
    first = y + 14 if below > 0 else y - 6
    for row, line in enumerate(lines):
        drawing.text((x if anchor == "middle" else 8, first + row * 17), line, anchor=anchor, size=OUTCOME_PX)
