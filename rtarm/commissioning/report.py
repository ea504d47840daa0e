"""What was found of one drive: a folder to send back, and what the control process may rely on from then on.

`report.txt` is for people, `report.json` for programs, `recording.mcap` has every frame.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from config.schema import ArmConfig
from rtarm.console.errors import Refusal
from rtloop.kept import commissioned
from rtloop.kept.commissioned import Commissioned, NotReadable, PowerProof
from rtloop.kept.reference_store import PSEUDO_TERMINALS, NotSaved, channel_of, is_simulated

RELIES: Mapping[str, str] = {
    "proof of power": "a silent drive keeps its reference",
    "fast targets": "bus.position_command: FC",
    "reports": "bus.positions: reported",
    "healing": "the arm clears by itself the fault of a short silence of all drives",
}


class Report:
    """What was found of one drive so far; `before` is what an earlier test has found of it."""

    def __init__(self, arm: ArmConfig, joint: int, folder: Path, before: Commissioned | None) -> None:
        self._before = before
        self.arm, self.joint, self.folder = arm, joint, folder
        self.findings: list[dict[str, Any]] = []
        self.ended = ""
        self.not_kept = ""
        """Why what was found is not kept."""
        self.withdrawn = ""
        """What the earlier test had unlocked and this one withdraws, a sentence."""
        self.made = False
        """Whether the folder is this report's."""
        drive = arm.joints[joint].drive
        self.record = Commissioned(
            channel=channel_of(arm),
            family=drive.family,
            number=drive.number,
            firmware="",
            when=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        )

    def make(self) -> None:
        """Make the folder; raises Refusal."""
        try:
            os.mkdir(self.folder)
        except OSError as problem:
            raise Refusal(
                f"The folder {self.folder} for the report cannot be made ({problem.strerror}): give another with -o."
            ) from None
        self.made = True

    def add(self, findings: Sequence[dict[str, Any]], record: Commissioned) -> None:
        """Take the findings of one check (fields of `Finding`), and keep the record that they make with those before.

        What differs is known to the control process from then on, and stands in the report, however this ends.
        """
        self.findings += findings
        self.record = record
        # what tells neither its firmware nor what is relied on says nothing of the drive of before
        if record.firmware or record.tells:
            self._keep(record.after(self._before))
        self.write()

    def _keep(self, record: Commissioned) -> None:
        self.record = record
        try:
            commissioned.save(self.arm, self.joint, record)
            self.not_kept = ""
        except (NotSaved, NotReadable) as problem:
            self.not_kept = str(problem)
        self.withdrawn = "" if self._before is None else _withdrawn(self._before, record)

    @property
    def agrees(self) -> bool:
        """Whether nothing that was tried differs from the manual."""
        return all(finding["verdict"] != "differs" for finding in self.findings)

    @property
    def _simulated(self) -> bool:
        """Whether this is no report of hardware; a link may lead to a pseudo-terminal."""
        bus = self.arm.bus_of(self.arm.joints[self.joint])
        return is_simulated(self.arm) or os.path.realpath(bus.resolved_channel).startswith(PSEUDO_TERMINALS)

    def unlocked(self) -> dict[str, bool | None]:
        """What the control process may rely on; None for what was not tried. Two are of ZDT drives alone."""
        return _unlocked(self.record)

    def write(self) -> None:
        """Both files of the report."""
        whole = {
            "rtarm": version("rtarm"),
            "arm": self.arm.name,
            "joint": self.arm.joints[self.joint].name,
            "ended": self.ended,
            "simulated": self._simulated,
            "record": vars(self.record),
            "withdrawn": self.withdrawn,
            "unlocked": self.unlocked(),
            "findings": self.findings,
        }
        try:
            (self.folder / "report.json").write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
            (self.folder / "report.txt").write_text(self.text() + "\n", encoding="utf-8")
        except OSError as problem:
            raise Refusal(f"The report {self.folder} cannot be written ({problem.strerror}).") from None

    def text(self) -> str:
        """For people; its last lines are those of docs/hardware/hardware-status.md."""
        record, config = self.record, self.arm.joints[self.joint]
        lines = [
            f"{self.arm.name}, {config.name}: {config.drive.called}, number {record.number}, firmware "
            f"{record.firmware or 'unknown'}, {record.channel}, {record.when}, rtarm {version('rtarm')}"
        ]
        for finding in self.findings:
            lines += [
                "",
                f"{finding['check']}: {finding['verdict']}",
                f"  asked: {finding['asked']}",
                f"  manual: {finding['documented']}",
                f"  came: {finding['came']}",
            ]
        words = {True: "unlocked", False: "withheld", None: "not tried"}
        lines += ["", *(f"{what} ({RELIES[what]}): {words[yes]}" for what, yes in self.unlocked().items())]
        lines += [self.withdrawn] if self.withdrawn else []
        if self._simulated:
            lines.append("This was a simulated drive: it says nothing of real ones.")
        lines += [*([self.ended] if self.ended else []), "", f"To send back: the folder {self.folder}, or this line:"]
        differs = [finding["check"] for finding in self.findings if finding["verdict"] == "differs"]
        tried = sum(finding["verdict"] != "not tried" for finding in self.findings)
        lines.append(
            f"| {config.drive.family} {record.firmware} | {self.arm.bus.interface} | {tried} | "
            f"{', '.join(differs) or 'none'} | {record.power_proof or 'not tried'} | {record.when[:10]} |"
        )
        return "\n".join(lines)


def _unlocked(record: Commissioned) -> dict[str, bool | None]:
    proof = None if record.power_proof is None else record.power_proof != PowerProof.NONE
    needs = (proof, record.brakes_in_silence)
    heals = None if None in needs and False not in needs else record.heals
    of_zdt = {"fast targets": record.fast_targets, "reports": record.reports} if record.family == "zdt" else {}
    return {"proof of power": proof, **of_zdt, "healing": heals}


def _withdrawn(before: Commissioned, record: Commissioned) -> str:
    """What an earlier test had unlocked and this one has not tried, a sentence; "" where that is nothing."""
    now = _unlocked(record)
    gone = [what for what, yes in _unlocked(before).items() if yes and now.get(what) is None]
    if not gone:
        return ""
    why = "its firmware is another one" if record.firmware else "it tells no firmware, so it may be another drive"
    return (
        f"Withdrawn is what the bench test of {before.when[:10]} had unlocked and this one has not tried "
        f"({', '.join(gone)}): {why}. All checks in one session unlock it again."
    )
