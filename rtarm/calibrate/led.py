"""A drive of any family, turned by the control process of every day, which leads its joint alone.

Direction, zero and limits of the arm file are what is in doubt, so the joint is brought up without them: its angles are
those of its motor, divided by the file's ratio, and it stands at 0 wherever a person last put it. How far a move may
stray from its path is told in angles of the motor, too, because the ratio is in doubt as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from types import TracebackType
from typing import Any, Self

from config.schema import ArmConfig
from rtarm.calibrate.drives import State
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import undisturbed
from rtarm.led.joint import AT_EASE_RAD, FASTEST, FRESH_S, Cause, Led, alone, seconds_for, silent_for_s
from rtloop.offline.calibration.session import NotDone, beyond_range
from shm.errors import SharedMemoryError

AWAY_MOTOR_DEG = 10.0
"""A motor that is farther than this from where it should be is stopped, …"""
AWAY_SHARE, AWAY_LEAST_MOTOR_DEG = 0.5, 2.0
"""… in a short move sooner: by such a share of it, though a motor that holds dithers."""
LIMIT_SHARE = 0.6
"""A joint whose limits are slower than what was asked for uses so much of them at most."""
SETTLES_S = 0.3
WIDEST_DEG = 36_000.0
"""Limits in an arm file are no wider."""


def by_its_motor(arm: ArmConfig, joint: int) -> dict[str, Any]:
    """The arm file of a joint alone as a calibration brings it up, see the head of this file.

    It may go as far either way as its range in the file is wide, and as its drive counts. An absolute encoder is passed
    over, since what it tells would be held against limits.
    """
    values, config = alone(arm, joint), arm.joints[joint]
    most_turns = config.drive.highest_turns
    reach_deg = min(config.upper_deg - config.lower_deg, WIDEST_DEG)
    if most_turns is not None:
        reach_deg = min(reach_deg, most_turns * 360.0 / config.ratio)
    if config.drive.most_of_a_turn is not None:
        reach_deg = min(reach_deg, config.drive.most_of_a_turn * 180.0 / config.ratio)
    values["joints"][0] |= {"direction": 1, "zero_deg": 0.0, "lower_deg": -reach_deg, "upper_deg": reach_deg}
    if hasattr(config.drive, "encoder"):
        values["joints"][0]["drive"]["encoder"] = "incremental"
    return values


class LedDrive:
    """Such a drive, for as long as the context lasts; see `rtarm.calibrate.drives.Drive`.

    `bring_up` is a context in which the joint of `by_its_motor` is led. At the end a joint that is limp is held again.
    """

    homing_rpm: int | None = None

    def __init__(self, arm: ArmConfig, joint: int, bring_up: Callable[[], AbstractContextManager[Led]]) -> None:
        self._config = arm.joints[joint]
        self._bring_up = bring_up
        self._brought_up = ExitStack()
        self._origin_rad = 0.0
        """What its drive counts where the joint is said to stand at 0, as an angle of the joint."""
        self._limp = self._homed = False

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            self._led = opened.enter_context(self._bring_up())
            self._stands_at_0()
            self._brought_up = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, ended: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._limp:
            with undisturbed(), suppress(Refusal, SharedMemoryError):  # that it is limp is told when its process ends
                self._led.hold()
        self._brought_up.__exit__(kind, ended, trace)

    def look(self) -> State:
        """See `Drive`; raises Refusal where that is not known."""
        now = self._led.snapshot()
        if fault := self._led.fault(now):
            raise Refusal(fault, ExitCode.LOOP_REFUSED)
        if silent_for_s(now) > FRESH_S:
            raise Refusal(f"The drive of {self._config.name} does not answer any more.", ExitCode.LOOP_REFUSED)
        known = self._homed or self._config.knows_its_angle
        doubt = None if known else "has a drive that cannot tell where it was switched on"
        return State(self._turns(self._measured_rad()), not self._led.is_disabled(), doubt)

    def turn(self, by_turns: float, rpm: int) -> State:
        """See `Drive`; raises Refusal where the motor does not do just that, once it was stopped."""
        began, led = self.look(), self._led
        arm, joint = led.config, led.config.joints[0]
        way_rad = self._rad(by_turns)
        here_rad = float(led.joint()["commanded_position_rad"])
        if not joint.lower_rad <= here_rad + way_rad <= joint.upper_rad:
            raise NotDone(beyond_range(self._config))
        most_turns = joint.drive.highest_turns
        if most_turns is not None and abs(began.turns + by_turns) > most_turns:
            raise NotDone(
                f"The drive of {joint.name} would count {began.turns + by_turns:.2f} turns there, and can be commanded "
                f"within {most_turns:.4g}: turn the joint the other way, or move the drive's own zero first."
            )
        bent_rad = abs(here_rad - self._measured_rad())
        away_deg = min(AWAY_MOTOR_DEG, max(AWAY_SHARE * abs(by_turns) * 360.0, AWAY_LEAST_MOTOR_DEG))
        seconds = max(FASTEST * abs(by_turns) * 60.0 / rpm, seconds_for(arm, abs(way_rad), LIMIT_SHARE))
        with led.stopped_by_any_end():
            goal = led.go(here_rad + way_rad, seconds, self._rad(away_deg / 360.0) + bent_rad)
            end = led.end_of(goal, seconds + arm.patience.person_s)
            led.let_pass(SETTLES_S)
            if end.cause is Cause.ARRIVED:
                return self.look()
            went_deg = (self._turns(self._measured_rad()) - began.turns) * 360.0
            self._ease()
        if end.cause is Cause.ELSEWHERE:
            raise Refusal(end.sentence, ExitCode.LOOP_REFUSED)
        why = (
            f"The drive of {joint.name} does not turn as it was told: it was stopped, after {went_deg:+.1f}° of "
            f"{by_turns * 360.0:+.1f}° of the motor. See what holds the joint (its stop, a cable, its own weight), "
            "free it, and run this again."
        )
        raise Refusal(f"{led.fault(led.snapshot())} {why}".lstrip(), ExitCode.LOOP_REFUSED)

    def let_go(self) -> State:
        """See `Drive`."""
        self.look()
        self._limp = True
        self._led.let_go()
        return self.look()

    def hold(self) -> State:
        """See `Drive`."""
        self._led.hold()
        self._limp = False
        self._stands_at_0()
        return self.look()

    def home(self) -> State:
        """See `Drive`; it is brought up anew, because a joint whose angle is known expects its stop at that."""
        self._brought_up.close()
        self._led = self._brought_up.enter_context(self._bring_up())
        with self._led.stopped_by_any_end():
            self._led.home()
        self._origin_rad, self._homed = 0.0, True
        return self.look()

    def _stands_at_0(self) -> None:
        """Take the place where it stands for the middle of its range."""
        if why := self._led.hindrance():
            raise Refusal(why, ExitCode.LOOP_REFUSED)
        self._origin_rad += self._measured_rad()
        self._led.reference(0.0)

    def _ease(self) -> None:
        """Take its target back to where it stands, so that it presses against nothing."""
        if self._led.hindrance():
            return  # a fault has done that already
        here_rad = self._measured_rad()
        self._led.end_of(self._led.go(here_rad, 1.0, AT_EASE_RAD), self._led.config.patience.person_s)

    def _measured_rad(self) -> float:
        return float(self._led.joint()["measured_position_rad"])

    def _turns(self, measured_rad: float) -> float:
        return (self._origin_rad + measured_rad) * self._config.ratio / math.tau

    def _rad(self, turns: float) -> float:
        return turns * math.tau / self._config.ratio
