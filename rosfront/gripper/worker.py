"""The gripper's thread: it alone calls the hook, and it ends every motion once, unless the hook hangs.

A hook may take its time, or hang; that delays nothing but the gripper. Motions come from any thread, and a newer one
replaces an older one. A motion ends as reached, stalled, canceled, replaced, in trouble, or too late. A hook that does
not return keeps this thread from ending motions. Then the server gives them up (`hang`), and they are not begun when
the hook does return.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from queue import Empty, SimpleQueue
from typing import Any

from config.gripper import GripperConfig
from motion.gripping import STILL_SHARE, Grip, GripJudge, stall_ns
from rosfront.gripper.hook import Gripper, GripperTrouble, NotThereYet, Reading
from rosfront.plan import NS

MOVING_PERIOD_S = 0.05
RESTING_PERIOD_S = 0.1
TROUBLE_PERIOD_S = 1.0
STALE_S = 1.0
"""A reading older than this no longer counts as the gripper's position."""
STAND_WITHIN_S = 2.0
"""Time for a gripper to come to rest after a stop."""
LATE_S = 10.0
"""A motion may take this, plus three times what the whole range takes at the gripper's speed."""
HOMED_WITHIN_S = 120.0
HANGS_AFTER_S = 10.0
"""A hook that has not returned for so long counts as hanging."""
CLOSING = "The ROS process was stopped before the gripper had come to its end; it was told to hold."
NEVER_READ = "The gripper has not been read yet."


class Ended(Enum):
    """The ends of a motion."""

    REACHED = "reached"
    STALLED = "stalled"
    CANCELED = "canceled"
    REPLACED = "replaced"
    TROUBLE = "trouble"


@dataclass(frozen=True)
class End:
    """How a motion ended."""

    how: Ended
    reading: Reading | None
    """The newest reading at that time; None where nothing could be read."""
    sentence: str

    @property
    def succeeded(self) -> bool:
        """Whether the motion did what was asked: the gripper is at its target, or holds an object in between."""
        return self.how in (Ended.REACHED, Ended.STALLED)


@dataclass(eq=False)
class Motion:
    """A requested motion; `on_reading` is called with readings, in the gripper's thread, `on_end` once with its end."""

    target_rad: float | None
    """None: home."""
    max_effort: float
    on_end: Callable[[End], None]
    on_reading: Callable[[Reading], None] = lambda _: None
    judge: GripJudge | None = None
    begun_s: float = field(default_factory=time.monotonic)
    until_s: float = math.inf
    canceled_s: float = 0.0
    _told: threading.Lock = field(default_factory=threading.Lock)

    def has_ended(self) -> bool:
        """Whether its end was told: by the gripper's thread, or by another one because the hook hangs."""
        return self._told.locked()

    def end(self, end: End) -> None:
        """Tell its end, from any thread; only the end that is told first counts."""
        if self._told.acquire(blocking=False):
            self.on_end(end)


@dataclass(frozen=True)
class Shown:
    """The newest state, for other threads to read."""

    reading: Reading | None
    grip: Grip
    trouble: str


class GripperWorker(threading.Thread):
    """The thread around one hook."""

    def __init__(
        self,
        config: GripperConfig,
        make: Callable[[], Gripper],
        warn: Callable[[str], None],
        inform: Callable[[str], None],
    ) -> None:
        """`make` opens the hook; it is tried again after an exception. `warn` logs a trouble, `inform` its end."""
        super().__init__(name="gripper", daemon=True)
        self._config = config
        self._make = make
        self._warn, self._inform = warn, inform
        self._warned = ""
        self._hook: Gripper | None = None
        self._works: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._motion: Motion | None = None
        self._before: Reading | None = None
        self._leaving = False
        self._called_s = math.inf
        self._rest_grip = Grip.UNKNOWN
        self.shown = Shown(None, Grip.UNKNOWN, NEVER_READ)

    # --- from any thread

    def begin(self, motion: Motion) -> None:
        """Carry out a motion; it replaces the running one."""
        self._works.put(lambda: self._begin(motion))

    def cancel(self, motion: Motion) -> None:
        """Stop a motion, if it still runs."""
        self._works.put(lambda: self._cancel(motion))

    def close(self, patience_s: float) -> None:
        """Stop a running motion, close the hook and end, within `patience_s`; a hook that hangs is left behind."""
        self._works.put(self._leave)
        self.join(patience_s)

    def hang(self) -> str:
        """A sentence, which is shown too, when the hook does not return; else an empty text."""
        if time.monotonic() - self._called_s < HANGS_AFTER_S:
            return ""
        sentence = (
            f"The gripper's hook {self._config.hook} has not returned for {HANGS_AFTER_S:g} s: it hangs; look at what "
            "moves the gripper, mend the hook, or start rtarm again."
        )
        self._show(None, Grip.TROUBLE, sentence)
        return sentence

    def measured(self, now_ns: int) -> tuple[float, float, float] | None:
        """Position, velocity and effort if they are known at this moment (CLOCK_MONOTONIC), else None."""
        reading = self.shown.reading
        if reading is None or now_ns - reading.measured_ns > STALE_S * NS:
            return None
        velocity = reading.velocity_rad_s
        return reading.position_rad, velocity if math.isfinite(velocity) else 0.0, reading.effort

    # --- in the thread

    def run(self) -> None:
        """Until `close`: do what is asked, then read the gripper."""
        while not self._leaving:
            try:
                work = self._works.get(timeout=self._pause_s())
                while True:
                    self._called_s = time.monotonic()
                    work()
                    work = self._works.get_nowait()
            except Empty:
                pass
            if not self._leaving:
                self._called_s = time.monotonic()
                self._look()
            self._called_s = math.inf

    def _pause_s(self) -> float:
        if self._motion is not None:
            return MOVING_PERIOD_S
        return TROUBLE_PERIOD_S if self._hook is None else RESTING_PERIOD_S

    def _begin(self, motion: Motion) -> None:
        if motion.has_ended():
            return
        self._end(Ended.REPLACED, "A newer command for the gripper has replaced it.")
        self._motion = motion
        hook = self._opened()
        if hook is None:
            return  # `_opened` has reported it and ended the motion
        try:
            if motion.target_rad is None:
                self._home(hook, motion)
                return
            reading, config = self._read(hook), self._config
            motion.judge = GripJudge(
                motion.target_rad,
                config.tolerance_rad,
                stall_ns(config.stall_time_s, config.tolerance_rad, config.speed_rad_s),
                reading.position_rad,
                reading.measured_ns,
            )
            longest_s = (config.upper_rad - config.lower_rad) / config.speed_rad_s
            motion.until_s = motion.begun_s + LATE_S + 3.0 * longest_s
            if motion.has_ended():
                self._motion = None
                return
            hook.move(motion.target_rad, motion.max_effort)
        except Exception as problem:
            self._fail(problem)

    def _home(self, hook: Gripper, motion: Motion) -> None:
        home = getattr(hook, "home", None)
        if home is None:
            self._end(Ended.TROUBLE, f"The gripper's hook {self._config.hook} has no way to find out where it is.")
            return
        motion.until_s = motion.begun_s + HOMED_WITHIN_S
        home()

    def _cancel(self, motion: Motion) -> None:
        if motion is not self._motion or motion.canceled_s:
            return
        motion.canceled_s = time.monotonic()
        self._before = None
        hook = self._opened()
        if hook is not None:
            try:
                hook.stop()
            except Exception as problem:
                self._fail(problem)

    def _leave(self) -> None:
        self._leaving = True
        hook, moving = self._hook, self._motion is not None
        self._end(Ended.TROUBLE, CLOSING)
        if hook is None:
            return
        try:
            if moving:
                hook.stop()
            hook.close()
        except Exception as problem:
            self._warn(self._sentence(problem))

    def _opened(self) -> Gripper | None:
        if self._hook is None:
            try:
                self._hook = self._make()
            except Exception as problem:
                self._fail(problem)
        return self._hook

    def _look(self) -> None:
        hook = self._opened()
        if hook is None:
            return
        try:
            reading = self._read(hook)
            self._follow(hook, reading)
        except Exception as problem:
            self._fail(problem)

    def _read(self, hook: Gripper) -> Reading:
        reading = self._checked(hook.read())
        if not math.isfinite(reading.position_rad) and reading.grip is not Grip.MOVING:
            raise GripperTrouble(f"The gripper says that it is at {reading.position_rad} rad: look at its sensor.")
        now_ns = time.monotonic_ns()
        return reading._replace(measured_ns=min(reading.measured_ns, now_ns) if reading.measured_ns else now_ns)

    def _checked(self, found: Any) -> Reading:
        """A hook's reading, each field converted to its type: other threads, such as the publisher's, rely on that."""
        try:
            position, velocity, effort, grip, trouble, measured_ns = found
            return Reading(
                float(position),
                float(velocity),
                float(effort),
                None if grip is None else Grip(grip),
                str(trouble),
                int(measured_ns),
            )
        except (TypeError, ValueError, OverflowError) as problem:
            raise GripperTrouble(
                f"The gripper's hook {self._config.hook} returns {found!r} from `read`, which is no Reading of numbers "
                "(docs/hardware/gripper.md): mend it."
            ) from problem

    def _follow(self, hook: Gripper, reading: Reading) -> None:
        """Show a reading, and report or end the running motion by it."""
        motion, before, self._before = self._motion, self._before, reading
        grip = self._judged(motion, reading, before)
        known = math.isfinite(reading.position_rad)
        self._show(reading if known else None, grip, reading.trouble)
        if motion is None:
            return
        if motion.has_ended():
            self._motion = None
            hook.stop()
            return
        if known:
            motion.on_reading(reading)
        if motion.canceled_s:
            stands = grip != Grip.MOVING or time.monotonic() - motion.canceled_s > STAND_WITHIN_S
            if stands:
                self._rest_grip = Grip.HELD
                self._end(Ended.CANCELED, "Canceled: the gripper holds where it stopped.")
        elif grip == Grip.TROUBLE:
            self._end(Ended.TROUBLE, reading.trouble)
        elif grip == Grip.STALLED:
            if reading.grip is None:
                hook.stop()
            self._rest_grip = grip
            self._end(Ended.STALLED, f"The gripper holds something at {_words(reading.position_rad)}.")
        elif grip == Grip.REACHED or (motion.target_rad is None and grip == Grip.HELD):
            self._rest_grip = grip
            self._end(Ended.REACHED, f"The gripper is at {_words(reading.position_rad)}.")
        elif grip == Grip.HELD:
            self._rest_grip = grip
            self._end(Ended.TROUBLE, "The gripper was stopped by somebody else; it holds where it is.")
        elif time.monotonic() > motion.until_s:
            self._end(Ended.TROUBLE, "The gripper moves and does not arrive: look at it, and at its speed.")

    def _judged(self, motion: Motion | None, reading: Reading, before: Reading | None) -> Grip:
        if reading.grip is not None:
            return reading.grip
        if motion is None:
            return self._rest_grip if self._rest_grip != Grip.UNKNOWN else Grip.HELD
        if motion.canceled_s:
            still_rad = STILL_SHARE * self._config.tolerance_rad
            stands = before is not None and abs(reading.position_rad - before.position_rad) <= still_rad
            return Grip.HELD if stands else Grip.MOVING
        if motion.judge is None:
            return Grip.REACHED
        return motion.judge.judge(reading.measured_ns, reading.position_rad)

    def _fail(self, problem: Exception) -> None:
        sentence = self._sentence(problem)
        self._show(None, Grip.TROUBLE, sentence, quiet=isinstance(problem, NotThereYet))
        self._end(Ended.TROUBLE, sentence)

    def _sentence(self, problem: Exception) -> str:
        if isinstance(problem, GripperTrouble):
            return str(problem)
        return f"The gripper's hook {self._config.hook} failed ({type(problem).__name__}: {problem}): mend it."

    def _show(self, reading: Reading | None, grip: Grip, trouble: str, *, quiet: bool = False) -> None:
        if trouble and trouble != self._warned and not quiet:
            self._warn(trouble)
            self._warned = trouble
        elif not trouble and self._warned:
            self._inform("The gripper is in order again.")
            self._warned = ""
        self.shown = Shown(reading, grip, trouble)

    def _end(self, how: Ended, sentence: str) -> None:
        motion, self._motion = self._motion, None
        if motion is not None:
            motion.end(End(how, self.shown.reading, sentence))


def _words(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.1f}° ({angle_rad:.4f} rad)"
