"""What the page's buttons do: requests to the control process, and goals to the arm's ordinary action.

Each function waits until it is done and says so in a sentence, or raises Refusal or SharedMemoryError with one.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from config.schema import ArmConfig
from rtarm import requests
from rtarm.errors import Refusal
from rtarm.view.words import Words

if TYPE_CHECKING:
    from rtarm.sending import Outcome, Sender

T = TypeVar("T")

GENTLY = 0.3
"""The share of a joint's velocity and acceleration limits that the page's motions use."""
SHORTEST_S = 0.5
"""So that a small step is no jerk."""
PATIENCE_S = 3600.0
"""A goal may be held in between for as long."""
ACCEPTANCE_PATIENCE_S = 10.0
"""For a goal that was sent to begin."""
SLOWEST = 0.01
"""A speed at which a duration can still be told; at 0 there is none."""

PEAK_VELOCITY = 15.0 / 8.0
PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
"""Of the quintic from rest to rest over distance 1 in time 1: its velocity is greatest half way, its acceleration at
(3 ± √3) / 6 of the time."""


def duration_s(arm: ArmConfig, from_rad: np.ndarray, to_rad: np.ndarray) -> float:
    """How long a gentle motion from rest to rest takes at full speed scale (s)."""
    needed = [SHORTEST_S]
    for joint, distance in zip(arm.joints, np.abs(to_rad - from_rad).tolist(), strict=True):
        needed.append(PEAK_VELOCITY * distance / (GENTLY * joint.max_velocity_rad_s))
        needed.append(math.sqrt(PEAK_ACCELERATION * distance / (GENTLY * joint.max_acceleration_rad_s2)))
    return max(needed)


class Orders:
    """What can be asked of a running arm."""

    def __init__(self, arm: ArmConfig, words: Words) -> None:
        self._arm = arm
        self._words = words
        self._one_at_a_time = threading.Lock()
        self._open = ExitStack()
        self._sender: Sender | None = None

    def hold(self) -> str:
        """Pause the running goal."""
        return requests.hold(self._arm.name)

    def resume(self) -> str:
        """Let a paused goal go on."""
        return requests.resume(self._arm.name)

    def stop(self) -> str:
        """Stop on the path and end the goal."""
        return requests.stop(self._arm.name)

    def clear_fault(self) -> str:
        """Clear the latched fault and bring the drives up again."""
        return requests.clear_fault(self._arm.name)

    def enable(self) -> str:
        """Let the drives take hold of a limp arm."""
        return requests.enable(self._arm.name)

    def speed(self, scale: float) -> str:
        """Set the speed scale, 0 to 1."""
        return requests.speed(self._arm.name, scale)

    def go(self, to_rad: np.ndarray, on_the_way: Callable[[str], None]) -> str:
        """Send one goal to these joint angles and wait for its end; never replaces a running goal.

        `on_the_way` is called with a sentence once the arm has begun.
        """
        takes_s, number, ended = self._begin(to_rad)
        if ended is None:
            on_the_way(self._words.on_the_way.format(duration=takes_s))
            ended = self._heard(lambda sender: sender.wait(number, PATIENCE_S))
        if not ended.succeeded:
            raise Refusal(ended.sentence)
        return ended.sentence

    def _begin(self, to_rad: np.ndarray) -> tuple[float, int, Outcome | None]:
        """Send it and wait until it runs or has ended already: how long it takes (s), its number, how it ended."""
        from rtarm.sending import goal_document

        with self._one_at_a_time, requests.connect(self._arm.name) as connection:
            before = connection.snapshot()
            if running := int(before["goal_id"]):
                raise Refusal(self._words.goal_runs.format(id=running))
            stands_rad = before["joints"]["commanded_position_rad"][: len(to_rad)]
            takes_s = duration_s(self._arm, stands_rad, to_rad)
            still = np.zeros((1, len(to_rad)))
            names = [joint.name for joint in self._arm.joints]
            document = goal_document(names, np.array([takes_s]), to_rad[None], still, still)
            number = self._heard(lambda sender: sender.send(document))
            ended: list[Outcome] = []

            def begun(now: np.ndarray) -> bool:
                ended.extend(filter(None, [self._heard(lambda sender: sender.ended(number))]))
                return bool(ended) or int(now["goal_id"]) != 0

            connection.wait(begun, ACCEPTANCE_PATIENCE_S, self._words.no_answer.format(seconds=ACCEPTANCE_PATIENCE_S))
        asked = max(float(before["speed_scale_asked"]), SLOWEST)
        return takes_s / asked, number, ended[0] if ended else None

    def _heard(self, what: Callable[[Sender], T]) -> T:
        """Do something with the process that sends goals, which starts with the first one, and anew if it has died."""
        from rtarm.sending import sending

        if self._sender is None:
            self._sender = self._open.enter_context(sending(self._arm))
        try:
            return what(self._sender)
        except Refusal:
            self.close()
            raise

    def close(self) -> None:
        """End what was started; a goal that was sent and still runs is cancelled."""
        self._sender = None
        self._open.close()
