"""What the page's buttons do: requests to the control process, and goals to the arm's ordinary action.

Each function waits until it is done and says so in a sentence, or raises Refusal or SharedMemoryError with one.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from config.schema import ArmConfig
from rtarm.client.sender import LastingSender, Sender, follow, goal_document
from rtarm.console.errors import Refusal
from rtarm.running import referencing, requests
from rtarm.running.decisions import end_told
from rtarm.view.words import Words
from sentences.told import outcome_sentence
from shm.errors import SharedMemoryError
from shm.words import Outcome

GENTLY = 0.3
"""The share of a joint's velocity and acceleration limits that the page's motions use."""
SHORTEST_S = 0.5
"""So that a small step is no jerk."""
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
    """What can be asked of a running arm, whose action is in a ROS namespace or in none."""

    def __init__(self, arm: ArmConfig, words: Words, namespace: str = "") -> None:
        self._arm = arm
        self._words = words
        self._senders = LastingSender(arm.name, lambda: arm, namespace)
        self._one_at_a_time = threading.Lock()
        self._stops = 0

    def hold(self) -> str:
        """Pause the running goal."""
        return requests.hold(self._arm.name, self._words.language)

    def hold_again(self) -> None:
        """Hold while an earlier hold waits for the arm to stand: that one tells how it ends, and if the arm is gone."""
        with suppress(SharedMemoryError):
            requests.hold_again(self._arm.name)

    def resume(self) -> str:
        """Let a held goal go on, and a held or stopped arm take goals again."""
        return requests.resume(self._arm.name, self._words.language)

    def stop(self) -> str:
        """Stop on the path, end the goal, also one from here that has not begun yet, and take none before a resume."""
        self._stops += 1
        try:
            return requests.stop(self._arm.name, self._words.language)
        finally:
            self._cancel()

    def stop_again(self) -> None:
        """Stop while an earlier stop waits for the arm to stand: that one tells how it ends, and if the arm is gone."""
        self._stops += 1
        with suppress(SharedMemoryError):
            requests.stop_again(self._arm.name)
        self._cancel()

    def _cancel(self) -> None:
        if (sender := self._senders.present) is not None:
            sender.cancel()

    def clear_fault(self) -> str:
        """Clear the latched fault and bring the drives up again."""
        return requests.clear_fault(self._arm.name, self._words.language)

    def enable(self) -> str:
        """Let the drives take hold of a limp arm."""
        return requests.enable(self._arm.name, self._words.language)

    def readings(self) -> list[referencing.Reading]:
        """What the joints without a reference read."""
        return referencing.readings(self._arm.name, self._words.language)

    def reference(self, shown: Sequence[referencing.Reading]) -> str:
        """Take joints to stand where a person was shown them and has seen them."""
        return referencing.take(self._arm.name, shown, self._words.language)

    def speed(self, scale: float) -> str:
        """Set the speed scale, 0 to 1."""
        return requests.speed(self._arm.name, scale, self._words.language)

    def go(self, to_rad: np.ndarray, on_the_way: Callable[[str], None]) -> str:
        """Send one goal to these joint angles and wait for its end; never replaces a running goal.

        `on_the_way` is called with a sentence once the arm has begun.
        """
        with requests.connect(self._arm.name, self._words.language) as connection:
            with self._one_at_a_time:
                takes_s, sender, number = self._send(connection, to_rad)
                ended = follow(connection, sender, number, self._words.no_answer, begun=True)
            if ended is None:
                on_the_way(self._words.on_the_way.format(duration=takes_s))
                ended = follow(connection, sender, number, self._words.no_result)
            assert ended is not None
            sentence = end_told(connection, ended.sentence)
        if not ended.succeeded:
            raise Refusal(sentence)
        return sentence

    def _send(self, connection: requests.Connection, to_rad: np.ndarray) -> tuple[float, Sender, int]:
        """Send it: how long it takes (s), who sent it, its number there."""
        stops = self._stops
        sender = self._senders.ready()  # which may take seconds
        before = connection.snapshot()
        if self._stops != stops:
            raise Refusal(outcome_sentence(Outcome.REFUSED_HELD, language=self._words.language))
        if running := before["goal_id"]:
            raise Refusal(self._words.goal_runs.format(id=running))
        stands_rad = before["joints"]["commanded_position_rad"][: len(to_rad)]
        takes_s = duration_s(self._arm, stands_rad, to_rad)
        still = np.zeros((1, len(to_rad)))
        names = [joint.name for joint in self._arm.joints]
        number = sender.send(goal_document(names, np.array([takes_s]), to_rad[None], still, still))
        return takes_s / max(before["speed_scale_asked"], SLOWEST), sender, number

    def close(self) -> None:
        """End what was started; a goal that was sent and still runs is cancelled."""
        self._senders.close()
