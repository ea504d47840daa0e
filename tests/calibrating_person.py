"""A person who calibrates a joint: they see what truly happens, and answer what they are asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from rtarm.calibrate.guide import Guide
from rtarm.console.person import Quit


class Scene(Protocol):
    """What they have before them."""

    guide: Guide

    @property
    def here_deg(self) -> float:
        """Where the joint truly is."""

    @property
    def true_ratio(self) -> float:
        """Of the joint."""

    def by_hand(self, to_deg: float) -> None:
        """Turn the limp joint."""


class CalibratingPerson:
    """Such a person; `by` is how they put the joint on marks: "d" by its drive, "h" by hand."""

    def __init__(self, scene: Scene, by: str) -> None:
        self._scene = scene
        self.by = by
        self.told: list[str] = []
        self.asked: list[str] = []
        self.ends_at: int | None = None
        self.seen_deg = self.mark_deg = 0.0
        self.misreads_deg = 0.0
        self.between_deg = 90.0
        """From the first mark to the second, by hand."""

    def tell(self, text: str) -> None:
        self.told.append(text)

    def answer(self, question: str) -> str:
        self.asked.append(question)
        if self.ends_at is not None and len(self.asked) > self.ends_at:
            raise Quit("you ended it")
        answers: dict[str, Callable[[], str]] = {
            "Degrees to turn": self._jogs,
            "Turn it? [y/N; o": self._lets_it_turn,
            "Which way did": self._says_which_way,
            "How shall": lambda: self.by,
            "on the first mark": lambda: self._turns_by_hand_to(self._scene.here_deg, "first"),
            "to the second mark": lambda: self._turns_by_hand_to(self.mark_deg + self.between_deg, "second"),
            "on its mark": lambda: self._turns_by_hand_to(0.0, "zero"),
            "By how many degrees did": lambda: f"{abs(self._scene.here_deg - self.mark_deg) + self.misreads_deg:.3f}",
            "Is that so, at this very stop": lambda: "n",
            "At how many degrees does": lambda: f"{self._scene.here_deg:.3f}",
        }
        for part, give in answers.items():
            if part in question:
                return give()
        return "y"

    def _lets_it_turn(self) -> str:
        self.seen_deg = self._scene.here_deg
        return "y"

    def _says_which_way(self) -> str:
        moved = self._scene.here_deg - self.seen_deg
        return "u" if abs(moved) < 0.5 else "p" if moved > 0 else "n"

    def _turns_by_hand_to(self, to_deg: float, mark: str) -> str:
        self._scene.by_hand(to_deg)
        if mark == "first":
            self.mark_deg = to_deg
        return ""

    def _jogs(self) -> str:
        """Towards 45° beyond the first mark, or towards zero; the joint turns as far as it does."""
        question = self.asked[-1]
        if "the first mark" in question:
            self.mark_deg = self._scene.here_deg
            return "y"
        goal = self.mark_deg + 45 if "second" in question else 0.0
        left = goal - self._scene.here_deg
        if abs(left) < 1.0:
            return "y"
        most = float(question.partition("±")[2].split()[0])
        believed = self._scene.guide.values.ratio
        return f"{max(-most, min(most, left * self._scene.true_ratio / believed)):.4f}"
