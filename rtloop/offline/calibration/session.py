"""The order of the conversations with which a person finds out how joints are built; one drive moves at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import TypeVar, cast

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION
from config.schema import ArmConfig
from rtloop.dialogues.referencing import KeepLost, Referencing
from rtloop.drives import zdt_registers as registers
from rtloop.drives.power import Marks
from rtloop.drives.zdt_ask import addressed, zdt_addresses
from rtloop.drives.zdt_talk import Answered
from rtloop.offline.calibration.talk import Drive, OneDrive
from rtloop.offline.settings.compare import DriveReport, report_of
from rtloop.offline.settings.talk import ReadSettings
from rtloop.service.conversation import Conversation, TalkFailed
from rtloop.service.port import ServicePort
from rtloop.wire.refusal import WireRefused
from shm.words import Unreferenced

MOST_RPM = 10
"""No motor is turned faster."""
MOST_COUNTS = 2 * ENCODER_COUNTS_PER_REVOLUTION
"""No single move is longer."""

Result = TypeVar("Result")


class NotDone(Exception):
    """Something was asked for that is not done here, and nothing moved; the text is the sentence people read."""


@dataclass(frozen=True)
class DriveState:
    """How one drive stands."""

    counts: int
    """Where its motor stands (65536 a turn)."""
    enabled: bool
    doubt: str | None
    """Why its count is not known to be one from its homing stop, after the joint's name; None if it is."""


@dataclass(frozen=True)
class Found:
    """What a drive is before anything moves."""

    joint: str
    address: int
    firmware: str
    """As it tells it, such as 2.0.0; empty where it does not."""
    enabled: bool
    homing_rpm: int | None
    problems: list[str]
    """Why it is not moved, a sentence each."""


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
        shared = next((joint for joint, found in talk.found.items() if found.shared_address), None)
        for joint, reading in talk.found.items():
            report = report_of(self.arm, joint, reading, shared)
            self.found[joint] = Found(
                joint=report.joint,
                address=report.address,
                firmware="" if reading.version is None else str(reading.version),
                enabled=bool((reading.flags or 0) & registers.ENABLED),
                homing_rpm=None if reading.homing is None else reading.homing.rpm,
                problems=report.left_alone or self._not_countable(report, reading.block),
            )
            self._tells_power_loss[joint] = reading.version is not None and reading.version.newer

    def _not_countable(self, report: DriveReport, block: registers.Block | None) -> list[str]:
        """Why a pulse of this drive would not be what the arm file takes it for."""
        assert block is not None  # else it is left alone
        drive = self.arm.joints[[joint.name for joint in self.arm.joints].index(report.joint)].drive
        expected = drive.command_steps_per_revolution
        if block.full_steps is not None and block.full_steps * block.microsteps == expected:
            return []
        return [
            f"The drive of {report.joint} has {block.microsteps} microsteps and motor type {block.motor_type:02X}, "
            f"which is not the {expected} pulses a turn of the arm file, so it would turn by another angle than told: "
            "mend microsteps in the arm file, or the drive's menu."
        ]

    def look(self, joint: int) -> DriveState:
        """How the drive stands."""
        return self._state(joint, self.have(joint, Drive.counts))

    def turn(self, joint: int, by_counts: int, rpm: int) -> DriveState:
        """Turn its motor, slowly and not far; returns once it stands there.

        Raises TalkFailed once it stands elsewhere, and NotDone for a move that is too far or too fast.
        """
        if not 1 <= rpm <= MOST_RPM or abs(by_counts) > MOST_COUNTS:
            raise NotDone(
                f"A move of {by_counts} counts at {rpm} rpm is too far or too fast here: at most {MOST_COUNTS} at "
                f"{MOST_RPM} rpm."
            )
        self._require_range(joint, by_counts)
        return self._state(joint, self.have(joint, lambda drive: drive.turn(by_counts, rpm), moves=True))

    def _require_range(self, joint: int, by_counts: int) -> None:
        """No joint gets farther from where a person last put it than the arm file's range, by the file's ratio."""
        config = self.arm.joints[joint]
        here = self.have(joint, Drive.counts)
        centre = self._centre.setdefault(joint, here)
        most = config.range_turns * ENCODER_COUNTS_PER_REVOLUTION
        if abs(here + by_counts - centre) > most:
            raise NotDone(
                f"{config.name} would get farther from where it began than its range in the arm file, "
                f"{config.upper_deg - config.lower_deg:g}° with a ratio of {config.ratio:g}: turn it by hand, or mend "
                "the ratio in the file first."
            )

    def let_go(self, joint: int) -> DriveState:
        """Make the joint limp; whoever asks has a person hold it."""
        self._limp.add(joint)
        return self._state(joint, self.have(joint, Drive.let_go))

    def hold(self, joint: int) -> DriveState:
        """Hold it where it stands."""
        counts = self.have(joint, Drive.hold, moves=True)
        self._limp.discard(joint)
        self._centre[joint] = counts
        return self._state(joint, counts)

    def home(self, joint: int) -> DriveState:
        """Let the drive run to its stop, from which it then counts."""
        self.have(joint, Drive.require_held)
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
        flags = self.have(joint, Drive.flags)
        doubt = None
        if flags & registers.POWER_LOST:
            doubt = "has lost power since it was homed, so what its drive counts is no angle"
        elif joint in self._lost:
            doubt = "has lost its reference and was not homed since"
        elif not self._tells_power_loss.get(joint, False):
            doubt = "has a drive whose firmware cannot say whether it has lost power since it was homed"
        return DriveState(counts, bool(flags & registers.ENABLED), doubt)

    # --- holding conversations

    def have(self, joint: int, dialogue: Callable[[Drive], Answered[Result]], *, moves: bool = False) -> Result:
        """What a dialogue ends in; raises TalkFailed. A drive that moves is stopped by what ends it early."""
        talk = self._talk(joint, dialogue)
        with self._stopping(joint) if moves else nullcontext():
            self._hold(talk)
        if talk.problem is not None:
            raise talk.problem
        return cast(Result, talk.result)

    def _talk(self, joint: int, dialogue: Callable[[Drive], Answered[Result]]) -> OneDrive[Result]:
        address = zdt_addresses(self.arm)[joint]
        return OneDrive(
            self.arm,
            self.port,
            now_ns=self._clock_ns(),
            joint=joint,
            dialogue=lambda clock: addressed(address, dialogue(Drive(self.arm, joint, clock))),
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
        """Make a drive stand whose conversation was ended amid a move; raises TalkFailed where that is not seen."""
        talk = self._talk(joint, Drive.stand)
        while not talk.poll(self._clock_ns()):
            self._rest()
        if talk.problem is not None:
            why = f" {ended}" if isinstance(ended, WireRefused) else ""
            raise TalkFailed(joint, f"{talk.problem}{why}") from ended

    def _hold(self, talk: Conversation) -> None:
        while not talk.poll(self._clock_ns()):
            self._pause()
        if talk.failure is not None:
            raise talk.failure
