"""The order of the conversations with which a person finds out how joints are built; one drive moves at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, TypeVar, cast

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
"""No motor is turned faster."""
MOST_TURNS = 2
"""No single move of a motor is longer."""

Result = TypeVar("Result")


class NotDone(Exception):
    """Something was asked for that is not done here, and nothing moved; the text is the sentence people read."""


@dataclass(frozen=True)
class DriveState:
    """How one drive stands."""

    counts: int
    """Where its motor stands, by its own encoder."""
    enabled: bool
    doubt: str | None
    """Why its count is not known to be one from its homing stop, after the joint's name; None if it is."""


class Session:
    """All conversations of one calibration.

    `pause` lets time pass between two looks at a conversation and may raise to end it; a drive that moves then is
    stopped first, while `rest` lets time pass, which does not raise. `tell` gets sentences of a homing run, and
    `keep_lost` remembers why a joint's angle is not known, or that it is; `lost_before` is what was known of that.
    `marks` are those that the drives have (`rtloop.drives.power`): a homing run gives another one.
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
        """Ask every drive what it is; what that is stands in `found`, by joint."""
        talk = ReadSettings(self.arm, self.port, now_ns=self._clock_ns())
        self._hold(talk)
        for joint, report in reports_of(self.arm, talk.found).items():
            if not families.knows("calibration", self.arm.joints[joint].drive):
                continue
            motors, reading = motors_of(self.arm.joints[joint].drive), talk.found[joint]
            self.found[joint] = motors.found_of(self.arm, joint, reading, report)
            self._tells_power_loss[joint] = motors.tells_power_loss(reading)

    def look(self, joint: int) -> DriveState:
        """How the drive stands."""
        return self._state(joint, self.have(joint, lambda motor: motor.counts()))

    def turn(self, joint: int, by_counts: int, rpm: int) -> DriveState:
        """Turn its motor, slowly and not far; returns once it stands there.

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
        """No joint gets farther from where a person last put it than the arm file's range, by the file's ratio."""
        config = self.arm.joints[joint]
        here = self.have(joint, lambda motor: motor.counts())
        centre = self._centre.setdefault(joint, here)
        most = config.range_turns * config.drive.reading_steps_per_revolution
        if abs(here + by_counts - centre) > most:
            raise NotDone(
                f"{config.name} would get farther from where it began than its range in the arm file, "
                f"{config.upper_deg - config.lower_deg:g}° with a ratio of {config.ratio:g}: turn it by hand, or mend "
                "the ratio in the file first."
            )

    def let_go(self, joint: int) -> DriveState:
        """Make the joint limp; whoever asks has a person hold it."""
        self._limp.add(joint)
        return self._state(joint, self.have(joint, lambda motor: motor.let_go()))

    def hold(self, joint: int) -> DriveState:
        """Hold it where it stands."""
        counts = self.have(joint, lambda motor: motor.hold(), moves=True)
        self._limp.discard(joint)
        self._centre[joint] = counts
        return self._state(joint, counts)

    def home(self, joint: int) -> DriveState:
        """Let the drive run to its stop, from which it then counts."""
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
        """Hold again what this session has let go."""
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
        """What a dialogue ends in; raises DialogueFailed. A drive that moves is stopped by what ends it early."""
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
        """A drive that moves meanwhile is stopped by whatever ends this early."""
        try:
            yield
        except BaseException as ended:
            self._stop(joint, ended)
            raise

    def _stop(self, joint: int, ended: BaseException) -> None:
        """Make a drive stand whose conversation was ended amid a move; raises DialogueFailed where that is not seen."""
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
