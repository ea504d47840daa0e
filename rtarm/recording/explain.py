"""`rtarm explain`: a recording's story as people read it in a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console, ConsoleOptions, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from rtarm.console.language import said
from rtarm.console.wrapping import Sentence
from rtarm.recording.chart import joint_charts
from rtarm.recording.folding import folded
from rtarm.recording.mcap_format import Loaded, Step
from rtarm.recording.mcap_reader import read
from rtarm.recording.story import Line, guilty_joint, since, tell
from rtarm.running.status import key
from sentences.meaning import Language
from sentences.told import joint_name
from shm.words import Fault

WIDEST_CHART = 110


class Explanation:
    """What rich prints of a recording."""

    def __init__(self, loaded: Loaded, language: Language = "en") -> None:
        self.loaded = loaded
        self.story = tell(loaded.recording, loaded.reason, language)
        self._language = language

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        story, recording = self.story, self.loaded.recording
        yield Text(story.heading, style="bold")
        if self.loaded.damage:
            damaged = said(
                self._language,
                "The file is damaged ({damage}); what follows is what could be read.",
                damage=self.loaded.damage,
            )
            yield Sentence(Text(damaged, style="red"))
        for sentence in story.verdict:
            yield Sentence(Text(sentence))
        if story.first is not None:
            came = self._since(story.first.monotonic_ns)
            first = said(self._language, "First of all: ")
            yield Sentence(Text.assemble((first, "bold"), f"{story.first.sentence} ({came})"))
        yield Text()
        yield self._table()
        drawn = joint_charts(
            recording,
            guilty_joint(recording, story),
            story.zero_ns,
            min(options.max_width, WIDEST_CHART),
            self._language,
        )
        if drawn:
            yield Padding(Text("\n".join(drawn), no_wrap=True, overflow="crop"), (1, 0, 0, 0))

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        table.add_column(justify="right", no_wrap=True, style="dim")
        table.add_column()
        for line in self._folded():
            style = "bold " + line.style if line is self.story.first else line.style
            table.add_row(self._since(line.monotonic_ns), Sentence(Text(line.sentence, style=style)))
        return table

    def _folded(self) -> list[Line]:
        """The story's lines, repeats in one; what came first and the fault stand by themselves."""
        story = self.story
        apart = [story.zero_ns] if story.first is None else [story.zero_ns, story.first.monotonic_ns]
        return folded(story.lines, apart, self._since, self._language)

    def _since(self, line_ns: int) -> str:
        return since(line_ns, self.story.zero_ns).strip()


def plain(told: Explanation) -> dict[str, Any]:
    """The story as plain values; times in seconds from the fault, or from the last cycle where there is none."""
    story, recording = told.story, told.loaded.recording

    def line(of: Line) -> dict[str, Any]:
        joint = joint_name(of.joint, recording.joints) if of.joint >= 0 else None
        return {
            "time_s": (of.monotonic_ns - story.zero_ns) * 1e-9,
            "sentence": of.sentence,
            "sign": of.sign,
            "joint": joint,
        }

    return {
        "arm": recording.arm,
        "reason": told.loaded.reason.word,
        "damage": told.loaded.damage or None,
        "fault": key(Fault, story.fault),
        "joint": joint_name(story.joint, recording.joints) if story.joint >= 0 else None,
        "verdict": list(story.verdict),
        "first": line(story.first) if story.first is not None else None,
        "lines": [line(each) for each in story.lines],
    }


def explanation(path: Path, step: Step = lambda _: None, language: Language = "en") -> Explanation:
    """The story of a file in a language.

    Raises:
        Refusal: it is no recording that can be read.
    """
    return Explanation(read(path, step), language)
