"""Reading the settings of all drives: a conversation while the cycle stays offline.

No drive is brought up or enabled, and no motion frame is sent. The requests are in the file of each family in this
folder, in most of them as a `table.Table`; drives of a family without such a file (mock) are left alone.
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
    """What a drive has reported about itself."""

    @property
    def shared_address(self) -> bool:
        """Whether more drives than one have answered at this address."""

    def note_question(self, question: Question) -> None:
        """Take note of a request that is sent."""

    def note_frame(self, frame: Frame) -> None:
        """Take note of a frame from the drive, whether or not it was requested."""

    def may_move_since(self, before: Any) -> bool:
        """Whether a drive that answers is moving, has moved since `before`, or does not report that it stands."""

    def is_written_alike(self, before: Any) -> bool:
        """Whether everything that is written back together with a setting is the same as in `before`."""


class SettingsFile(Protocol):
    """The functions of a family's file in this folder."""

    def new_reading(self) -> Reading:
        """An empty reading."""

    def read(self, arm: ArmConfig, joint: int, found: Any) -> Dialogue:
        """Read a drive's settings into `found`; a drive that does not answer is not asked further."""

    def report_of(self, arm: ArmConfig, joint: int, found: Any, shared: int | None = None) -> DriveReport:
        """Compare a drive with the arm file; `shared` is a joint of its family whose address has several drives."""

    def write(self, arm: ArmConfig, joint: int, found: Any, settings: list[Setting], store: bool) -> Part[str | None]:
        """Write settings, each once, and read them back; why they are not known to be in effect, None if they are.

        The text follows the drive's name. `store`: to flash, not to volatile memory only.
        """


def settings_of(drive: Drive) -> SettingsFile:
    """The file of a family that has settings."""
    return cast(SettingsFile, families.file_of("settings", drive))


class ReadSettings(Conversation):
    """Reads the settings of every drive whose family has a file in this folder, into `found`, by joint."""

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
        """Also look for signs of a drive with another protocol, or of two drives at one address."""
        if frame.joint in self.found:
            self.found[frame.joint].note_frame(frame)
        super()._hear(frame)


def reports_of(arm: ArmConfig, found: Mapping[int, Reading]) -> dict[int, DriveReport]:
    """Compare each drive with the arm file, by joint."""
    drives = [config.drive for config in arm.joints]
    hearing = [(arm.bus_number(config), config.drive.family) for config in arm.joints]
    shared: dict[tuple[int, str], int] = {}
    for joint, reading in found.items():
        if reading.shared_address:
            shared.setdefault(hearing[joint], joint)
    return {
        joint: settings_of(drives[joint]).report_of(arm, joint, reading, shared.get(hearing[joint]))
        for joint, reading in found.items()
    }
