"""The conversations with which a person finds out how joints are built; one drive moves at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.dialogues.referencing import KeepLost, Referencing
from rtloop.drives.power import Marks
from rtloop.offline import families
from rtloop.offline.calibration.talk import Found, motors_of
from rtloop.offline.one_drive import OneDrive
from rtloop.offline.settings.talk import ReadSettings, reports_of
from rtloop.service.conversation import Conversation, DialogueFailed, Part, Unaddressed
from rtloop.service.port import ServicePort
from rtloop.wire.refusal import WireRefused
from shm.words import Unreferenced

MOST_RPM = 10
"""Highest speed of a motor."""
MOST_TURNS = 2
"""Longest single move of a motor (revolutions)."""

Result = TypeVar("Result")


class NotDone(Exception):
    """A request is not carried out, and nothing has moved; the text is the sentence for the operator."""


def beyond_range(config: JointConfig) -> str:
    """Why a joint is not moved farther from where a person last put it."""
    return (
        f"{config.name} would get farther from where it began than its range in the arm file, "
        f"{config.upper_deg - config.lower_deg:g}° with a ratio of {config.ratio:g}: turn it by hand, or mend the "
        "ratio in the file first."
    )


@dataclass(frozen=True)
class DriveState:
    """State of one drive."""

    counts: int
    """Position of its motor, by its own encoder."""
    enabled: bool
    doubt: str | None
    """Why its count may not be one from its homing stop, to follow the joint's name; None if it is."""


class Session:
    """All conversations of one calibration.

    `pause` lets time pass between two polls of a conversation, and may raise to end the session. A drive that moves
    then is stopped first; meanwhile `rest`, which does not raise, lets time pass. `tell` gets the sentences of a homing
    run. `keep_lost` stores why a joint's angle is not known, or that it is; `lost_before` is what was stored before.
    `marks` are the drives' marks (`rtloop.drives.power`); a homing run gives the drive another one.
    """

    def __init__(
        self,
        arm: ArmConfig,
        port: ServicePort,
        *,
        clock_ns: Callable[[], int],
        pause: Callable[[], None],
        rest: Callable[[], None],
        tell: Callable[[str], None],
        keep_lost: KeepLost,
        marks: Marks,
        lost_before: Mapping[int, Unreferenced] | None = None,
    ) -> None:
        self.arm = arm
        self.port = port
        self._clock_ns = clock_ns
        self._pause = pause
        self._rest = rest
        self.tell = tell
        self._keep_lost = keep_lost
        self._marks = marks
        self._lost = dict(lost_before or {})
        self._tells_power_loss: dict[int, bool] = {}
        self._limp: set[int] = set()
        self._centre: dict[int, int] = {}
        self.found: dict[int, Found] = {}

    def read(self) -> None:
        """Read what every drive is into `found`, by joint."""
        talk = ReadSettings(self.arm, self.port, now_ns=self._clock_ns())
        self._hold(talk)
        for joint, report in reports_of(self.arm, talk.found).items():
            if not families.knows("calibration", self.arm.joints[joint].drive):
                continue
            motors, reading = motors_of(self.arm.joints[joint].drive), talk.found[joint]
            self.found[joint] = motors.found_of(self.arm, joint, reading, report)
            self._tells_power_loss[joint] = motors.tells_power_loss(reading)

    def look(self, joint: int) -> DriveState:
        """The drive's state."""
        return self._state(joint, self.have(joint, lambda motor: motor.counts()))

    def turn(self, joint: int, by_counts: int, rpm: int) -> DriveState:
        """Turn the drive's motor, slowly and not far; returns once it stands at its target.

        Raises DialogueFailed once it stands elsewhere, and NotDone for a move that is too far or too fast.
        """
        most_counts = MOST_TURNS * self.arm.joints[joint].drive.reading_steps_per_revolution
        if not 1 <= rpm <= MOST_RPM or abs(by_counts) > most_counts:
            raise NotDone(
                f"A move of {by_counts} counts at {rpm} rpm is too far or too fast here: at most {most_counts} at "
                f"{MOST_RPM} rpm."
            )
        self._require_range(joint, by_counts)
        return self._state(joint, self.have(joint, lambda motor: motor.turn(by_counts, rpm), moves=True))

    def _require_range(self, joint: int, by_counts: int) -> None:
        """Raise NotDone if the joint would move farther than its range in the arm file from where a person last put it.

        The range is converted to turns of the motor by the arm file's ratio.
        """
        config = self.arm.joints[joint]
        here = self.have(joint, lambda motor: motor.counts())
        centre = self._centre.setdefault(joint, here)
        most = config.range_turns * config.drive.reading_steps_per_revolution
        if abs(here + by_counts - centre) > most:
            raise NotDone(beyond_range(config))

    def let_go(self, joint: int) -> DriveState:
        """Switch the joint's torque off; the caller makes sure that a person holds the joint."""
        self._limp.add(joint)
        return self._state(joint, self.have(joint, lambda motor: motor.let_go()))

    def hold(self, joint: int) -> DriveState:
        """Enable the drive, so that it holds the joint where it stands."""
        counts = self.have(joint, lambda motor: motor.hold(), moves=True)
        self._limp.discard(joint)
        self._centre[joint] = counts
        return self._state(joint, counts)

    def home(self, joint: int) -> DriveState:
        """Run the drive to its stop, from which it then counts."""
        self.have(joint, lambda motor: motor.require_held())
        talk = Referencing(
            self.arm,
            self.port,
            now_ns=self._clock_ns(),
            homed=[joint],
            placed={},
            tell=self.tell,
            keep_lost=self._remember,
            marks=self._marks,
            again="run this again",
        )
        try:
            self._hold(talk)
        except BaseException:
            talk.end()
            while not talk.poll(self._clock_ns()):
                self._rest()
            raise
        self._centre[joint] = 0
        return self.look(joint)

    def close(self) -> None:
        """Enable the drives again whose torque this session has switched off."""
        self._pause = self._rest
        for joint in sorted(self._limp):
            self.hold(joint)

    def _remember(self, joint: int, reason: Unreferenced | None) -> None:
        self._keep_lost(joint, reason)
        self._lost.pop(joint, None)
        if reason is not None:
            self._lost[joint] = reason

    def _state(self, joint: int, counts: int) -> DriveState:
        state = self.have(joint, lambda motor: motor.state())
        doubt = None
        if state.power_lost:
            doubt = "has lost power since it was homed, so what its drive counts is no angle"
        elif joint in self._lost:
            doubt = "has lost its reference and was not homed since"
        elif not self._tells_power_loss.get(joint, False):
            doubt = "has a drive whose firmware cannot say whether it has lost power since it was homed"
        return DriveState(counts, state.enabled, doubt)

    # --- holding conversations

    def have(self, joint: int, dialogue: Callable[[Any], Unaddressed[Result]], *, moves: bool = False) -> Result:
        """Run a dialogue and return its result; raises DialogueFailed.

        `moves`: the drive moves, so it is stopped if the dialogue ends early.
        """
        talk = self._talk(joint, dialogue)
        with self._stopping(joint) if moves else nullcontext():
            self._hold(talk)
        if talk.problem is not None:
            raise talk.problem
        return cast(Result, talk.result)

    def _talk(self, joint: int, dialogue: Callable[[Any], Unaddressed[Result]]) -> OneDrive[Result]:
        motors = motors_of(self.arm.joints[joint].drive)

        def said(clock_ns: Callable[[], int]) -> Part[Result]:
            motor = motors.motor_of(self.arm, joint, clock_ns)
            return motor.addressed(dialogue(motor))

        return OneDrive(
            self.arm,
            self.port,
            now_ns=self._clock_ns(),
            joint=joint,
            dialogue=said,
        )

    @contextmanager
    def _stopping(self, joint: int) -> Iterator[None]:
        """Stop the drive if an exception ends the context early."""
        try:
            yield
        except BaseException as ended:
            self._stop(joint, ended)
            raise

    def _stop(self, joint: int, ended: BaseException) -> None:
        """Stop a drive whose dialogue ended during a move; raises DialogueFailed if it is not seen to stand."""
        talk = self._talk(joint, lambda motor: motor.stand())
        while not talk.poll(self._clock_ns()):
            self._rest()
        if talk.problem is not None:
            why = f" {ended}" if isinstance(ended, WireRefused) else ""
            raise DialogueFailed(joint, f"{talk.problem}{why}") from ended

    def _hold(self, talk: Conversation) -> None:
        while not talk.poll(self._clock_ns()):
            self._pause()
        if talk.failure is not None:
            raise talk.failure
