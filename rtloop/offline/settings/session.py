"""Reading, and on request writing, the settings of all drives of an arm: the sequence of the conversations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from config.schema import ArmConfig
from rtloop.offline.one_drive import OneDrive
from rtloop.offline.settings.compare import DriveReport, Setting
from rtloop.offline.settings.talk import Reading, ReadSettings, reports_of, settings_of
from rtloop.service.conversation import Conversation
from rtloop.service.port import ServicePort


class NotWritten(Exception):
    """Nothing was written; the text is the sentence for the operator."""


@dataclass
class Written:
    """Result of an order to write."""

    joints: list[str]
    """Joints whose drives were read back and have the wanted settings."""
    failure: str | None
    """Why the writing ended early, a sentence; later drives were not written to."""


class Session:
    """All conversations about settings; `pause` is called between two polls of a conversation.

    `pause` lets time pass, and may raise to end the session.
    """

    def __init__(
        self, arm: ArmConfig, port: ServicePort, clock_ns: Callable[[], int], pause: Callable[[], None]
    ) -> None:
        self._arm = arm
        self._port = port
        self._clock_ns = clock_ns
        self._pause = pause
        self._readings: dict[int, Reading] = {}
        self.reports: dict[int, DriveReport] = {}

    def read(self) -> None:
        """Read the settings of every drive; `reports` then holds each comparison with the arm file, by joint."""
        talk = ReadSettings(self._arm, self._port, now_ns=self._clock_ns())
        self._hold(talk)
        self._readings = talk.found
        self.reports = reports_of(self._arm, talk.found)

    def write(
        self,
        *,
        store: bool,
        told: Callable[[str], None] = lambda _: None,
        ends: Callable[[], bool] = lambda: False,
    ) -> Written:
        """Write the settings that differ, drive by drive, then read everything again.

        No other drive is begun once `ends()` is true. Raises NotWritten if the arm moves, or if what was read from the
        drives before has changed meanwhile. `told` gets a sentence for each drive that was written.
        """
        before, shown = self._readings, self.reports
        self.read()
        self._require_standing(before)
        # All fields are written back, and a serial line may garble any of them unnoticed: whole blocks must agree.
        if any(
            shown[joint].to_write != report.to_write
            or (report.to_write and not self._readings[joint].is_written_alike(before[joint]))
            for joint, report in self.reports.items()
        ):
            raise NotWritten(
                "The drives differ from what was shown a moment ago, so nothing was written: run it again, look anew."
            )
        written = Written([], None)
        for joint, report in self.reports.items():
            if not _due(report, store):
                continue
            if ends():
                left = [r.joint for r in self.reports.values() if _due(r, store) and r.joint not in written.joints]
                written.failure = f"Ended as asked: nothing was written to the drives of {', '.join(left)}."
                break
            problem = self._write_one(joint, report, store)
            if problem is not None:
                drive = self._arm.joints[joint].drive
                written.failure = (
                    f"The drive of {report.joint} ({drive.number_field} {drive.number}) {problem}; the drives after it "
                    "were not written to. See what it has with `rtarm drives`, and check its cable and its supply."
                )
                break
            written.joints.append(report.joint)
            told(f"{report.joint}: written and read back")
        self.read()
        return written

    def _write_one(self, joint: int, report: DriveReport, store: bool) -> str | None:
        file, reading = settings_of(self._arm.joints[joint].drive), self._readings[joint]
        talk = OneDrive(
            self._arm,
            self._port,
            now_ns=self._clock_ns(),
            joint=joint,
            dialogue=lambda _: file.write(self._arm, joint, reading, _due(report, store), store),
        )
        self._hold(talk)
        if talk.problem is not None:
            raise talk.problem
        return talk.result

    def _require_standing(self, before: dict[int, Reading]) -> None:
        for joint, found in self._readings.items():
            if found.shared_address:
                raise NotWritten(f"{self.reports[joint].left_alone[0]} Until then nothing is written to any drive.")
            if found.may_move_since(before[joint]):  # a silent drive receives no command that could move it
                raise NotWritten(
                    f"{self._arm.joints[joint].name} moves, or does not say that it stands, so nothing was written: "
                    "settings are only written while the whole arm stands."
                )

    def _hold(self, talk: Conversation) -> None:
        while not talk.poll(self._clock_ns()):
            self._pause()
        if talk.failure is not None:
            raise talk.failure


def _due(report: DriveReport, store: bool) -> list[Setting]:
    """The settings of a drive that an order writes."""
    return [setting for setting in report.to_write if store or not setting.kept]
