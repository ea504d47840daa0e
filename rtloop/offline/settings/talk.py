"""Reading the settings of all drives: a conversation beside a cycle that stays offline.

Nothing is brought up, nothing is enabled, no motion frame leaves. What a drive is asked is said in its family's file of
this folder; drives of a family without one are left alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, cast

from config.drives.drive import Drive
from config.schema import ArmConfig
from rtloop.offline import families
from rtloop.offline.settings.compare import DriveReport, Setting
from rtloop.service.conversation import Conversation, Dialogue, Part, Question
from rtloop.service.port import Frame, ServicePort
from shm.words import Fault


class Reading(Protocol):
    """What a drive has said of itself."""

    @property
    def shared_address(self) -> bool:
        """Whether more drives than one have answered at this address."""

    def note_question(self, question: Question) -> None:
        """This is asked."""

    def note_frame(self, frame: Frame) -> None:
        """This has come from the drive, whether it was asked for or not."""

    def may_move_since(self, before: Any) -> bool:
        """Whether a drive that answers moves, has moved since another reading, or does not say that it stands."""

    def is_written_alike(self, before: Any) -> bool:
        """Whether all that is written back with a setting is as in another reading."""


class SettingsFile(Protocol):
    """The functions of a family's file."""

    def new_reading(self) -> Reading:
        """The reading of a drive that has said nothing yet."""

    def read(self, arm: ArmConfig, joint: int, found: Any) -> Dialogue:
        """Ask a drive for its settings; one that is silent is asked no more."""

    def report_of(self, arm: ArmConfig, joint: int, found: Any, shared: int | None = None) -> DriveReport:
        """Compare a drive with the arm file; `shared` is a joint whose address has more drives than one."""

    def write(self, arm: ArmConfig, joint: int, found: Any, settings: list[Setting], store: bool) -> Part[str | None]:
        """Write settings, each once, then ask the drive what it has: why it cannot be said that it has them.

        The text follows the drive's name. `store`: in flash, not in volatile memory alone.
        """


def settings_of(drive: Drive) -> SettingsFile:
    """The file of a family that has settings."""
    return cast(SettingsFile, families.file_of("settings", drive))


class ReadSettings(Conversation):
    """Every drive of a family with settings is asked for them; what it said stands in `found`, by joint."""

    def __init__(self, arm: ArmConfig, port: ServicePort, *, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.BRING_UP)
        files = {
            joint: settings_of(config.drive)
            for joint, config in enumerate(arm.joints)
            if families.knows("settings", config.drive)
        }
        self.found: dict[int, Reading] = {joint: file.new_reading() for joint, file in files.items()}
        self.begin({joint: file.read(arm, joint, self.found[joint]) for joint, file in files.items()})

    def _say(self, joint: int, question: Question) -> None:
        self.found[joint].note_question(question)
        super()._say(joint, question)

    def _hear(self, frame: Frame) -> None:
        """Besides what is asked for: signs of a drive that speaks another language, or of two at one address."""
        if frame.joint in self.found:
            self.found[frame.joint].note_frame(frame)
        super()._hear(frame)


def reports_of(arm: ArmConfig, found: Mapping[int, Reading]) -> dict[int, DriveReport]:
    """Compare each drive with the arm file, by joint."""
    shared = next((joint for joint, reading in found.items() if reading.shared_address), None)
    return {
        joint: settings_of(arm.joints[joint].drive).report_of(arm, joint, reading, shared)
        for joint, reading in found.items()
    }
