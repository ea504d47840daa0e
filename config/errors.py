"""The one exception of this package: something in an arm's configuration is not usable."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def legible(text: str, most: int | None = None) -> str:
    """A text from outside as one line that can neither end it nor speak to the terminal, of at most so many characters.

    Whatever is not printable is shown as Python writes it: a newline as \\n, a byte that begins a colour as \\x1b.
    """
    if most is not None and len(text) > most:
        text = text[: most - 1] + "…"
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """What follows a name that is none of the known ones: ` (did you mean joint2?)`, "" where none is like it."""
    called = {name.lower(): name for name in known}
    likely = difflib.get_close_matches(given.lower(), called, n=1)
    return f" (did you mean {called[likely[0]]}?)" if likely else ""


class ConfigError(Exception):
    """An arm file, or what was overridden in it, cannot be used.

    Attributes:
        problem: one sentence: what is wrong, with the value; what is allowed; what to do.
        file: the YAML file as it was named, or None when no file is involved.
        line: the line in that file, counted from 1, or None when the place is not in the file.
        location: the field, such as `joints[2].lower_deg`, or None for the file as a whole.
        overridden: the offending value came from an override (a command-line option), not from the file.
        errors: this error followed by all others found in the same pass, each an error of its own.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | None = None,
        line: int | None = None,
        location: str | None = None,
        overridden: bool = False,
        others: Sequence[ConfigError] = (),
    ) -> None:
        problem = legible(problem)
        super().__init__(problem)
        self.problem = problem
        self.file = file
        self.line = line
        self.location = None if location is None else legible(location)
        self.overridden = overridden
        self.errors: tuple[ConfigError, ...] = (self, *others)

    @classmethod
    def of(cls, problems: Sequence[ConfigError]) -> ConfigError:
        """One error for all problems of a pass: the first speaks, `errors` holds them all."""
        first = problems[0]
        return cls(
            first.problem,
            file=first.file,
            line=first.line,
            location=first.location,
            overridden=first.overridden,
            others=problems[1:],
        )

    def __str__(self) -> str:
        """The sentence, led by its place: `my_arm.yaml:14: control.rate_hz: …`.

        One about a joint names it, and lists of joints are not counted for people, who may count from 1.
        """
        parts: list[str] = []
        if self.file is not None:
            parts.append(self.file if self.line is None else f"{self.file}:{self.line}")
        named = self.line is not None and self.location is not None and self.location.startswith("joints[")
        if self.location is not None and not named:
            parts.append(f"{self.location} (overridden)" if self.overridden else self.location)
        return ": ".join([*parts, self.problem])
