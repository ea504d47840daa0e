"""`rtarm jog`: a key is one step of one joint, which ends by itself, through the arm's ordinary action.

Keys that come while a step goes on are forgotten, so that a key that is held down leads to no motion when it is let go.
"""

from __future__ import annotations

import math
import os
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from rtarm.arm import Arm, connect, refuse_speed
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted, signals_raise

STEPS_DEG = (0.1, 0.5, 1.0, 2.0, 5.0)
UP, DOWN = (b"\x1b[C", b"\x1b[A", b"+", b"="), (b"\x1b[D", b"\x1b[B", b"-")
"""Right, up; left, down."""
LARGER, SMALLER, NEXT, END = b".", b",", b"\t", (b"q", b"Q", b"\x04", b"")


class Jog:
    """Which joint a key moves, and how far."""

    def __init__(self, arm: Arm, speed: float, tell: Callable[[str], None]) -> None:
        self._arm = arm
        self._speed = speed
        self._tell = tell
        self._joint = 0
        self._step = STEPS_DEG.index(1.0)

    def obey(self, key: bytes) -> None:
        """Do what a key means; one that means nothing does nothing. What was typed meanwhile is forgotten."""
        if key in UP:
            self._go(STEPS_DEG[self._step])
        elif key in DOWN:
            self._go(-STEPS_DEG[self._step])
        elif key in (LARGER, SMALLER):
            self._step = min(max(self._step + (1 if key == LARGER else -1), 0), len(STEPS_DEG) - 1)
        elif key == NEXT:
            self._joint = (self._joint + 1) % len(self._arm.joints)
        elif key.isdigit() and 1 <= int(key) <= len(self._arm.joints):
            self._joint = int(key) - 1
        self.show()

    def show(self) -> None:
        """Say which joint the keys move, where it is told to be, and the step; keys that were typed before are none."""
        _forget_typed()
        angle_deg = round(math.degrees(self._arm.state().commanded_rad[self._joint]), 2) + 0.0  # never -0
        self._tell(f"{self._arm.joints[self._joint]}  {angle_deg:8.2f}°   step {STEPS_DEG[self._step]:g}°")

    def _go(self, step_deg: float) -> None:
        try:
            self._arm.move({self._arm.joints[self._joint]: math.radians(step_deg)}, speed=self._speed, relative=True)
        except Refusal as refused:
            self._tell(refused.sentence)


def _forget_typed() -> None:
    termios.tcflush(sys.stdin, termios.TCIFLUSH)


def jog(arm: str | None, speed: float, tell: Callable[[str], None]) -> None:
    """Let a person at a terminal move joints, until q.

    Raises:
        Refusal: there is no terminal, the arm is not meant to be moved, or a signal came.
        NotRunning: the control process does not run, or has ended.
    """
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise Refusal(
            "`rtarm jog` takes keys from a terminal, and this is not one: use `rtarm move JOINT=DEGREES --relative`."
        )
    refuse_speed(speed)
    with connect(arm) as connected:
        keys = ", ".join(f"{number} {joint}" for number, joint in enumerate(connected.joints[:9], 1))
        tell(
            f"{keys}; Tab the next; arrows or + and - make a step, . and , make it larger and smaller, q ends; Ctrl-C "
            "stops a step."
        )
        jogged = Jog(connected, speed, tell)
        try:
            with signals_raise(), keys_at_once() as next_key:
                jogged.show()
                while (key := next_key()) not in END:
                    jogged.obey(key)
        except Interrupted as signalled:
            raise Refusal(f"Ended by {signalled}; arm {connected.name} stands.", ExitCode.GOAL_FAILED) from None


@contextmanager
def keys_at_once() -> Iterator[Callable[[], bytes]]:
    """The terminal's keys as they come and unseen: what is yielded waits for the next one, b"" at its end."""
    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)

    def next_key() -> bytes:
        try:
            typed = os.read(keyboard, 32)
        except OSError:  # the terminal was closed
            return b""
        return typed[:3] if typed.startswith(b"\x1b[") else typed[:1]

    try:
        tty.setcbreak(keyboard, termios.TCSANOW)
        yield next_key
    finally:
        with suppress(termios.error):  # the terminal was closed
            termios.tcsetattr(keyboard, termios.TCSANOW, before)
