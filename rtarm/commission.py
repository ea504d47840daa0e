"""`rtarm commission`: the process that checks one drive, the person beside it, and the report of what was found.

A control process of its own speaks with the drive (`python -m rtloop.commissioning`), as for `rtarm calibrate`. The
report is a folder: `report.txt` for people, `report.json` for programs, `recording.mcap` with every frame.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.calibrate.person import Person, Quit, agrees
from rtarm.drives import OfflineProcess, offline_process
from rtarm.errors import ExitCode, Refusal
from rtarm.interrupt import Interrupted, signals_raise
from rtarm.niceness import nice_thread
from rtarm.recording.follow import LOOK_S, Follower
from rtloop import commissioned
from rtloop.commissioned import Commissioned, NotReadable, PowerProof
from rtloop.saved import PSEUDO_TERMINALS, NotSaved, is_simulated
from shm import files

INTRODUCTION = (
    "One drive is checked, and only after your y; each move is told before it is made. The joint must be free to turn "
    "by 15° either way, with nothing else in reach, a clamp and the switch in its power line at hand. Ctrl-C or q "
    "stops what moves and ends this at any time; what was found until then is in the report."
)
RECORDING = "recording.mcap"
RELIES: Mapping[str, str] = {
    "proof of power": "a silent drive keeps its reference",
    "fast targets": "bus.position_command: FC",
    "reports": "bus.positions: reported",
    "healing": "the arm clears by itself the fault of a short silence of all drives",
}


def commission(argument: str, name: str, output: Path | None, overrides: Mapping[str, Any], person: Person) -> bool:
    """Check one drive with a person, write the report, and keep what was found; whether all that was tried is good.

    Raises:
        Refusal: it cannot begin, or ended early, after a report of what was found until then.
    """
    arm = load_arm(argument, overrides=overrides)
    names = [joint.name for joint in arm.joints]
    if name not in names:
        raise Refusal(f"Arm {arm.name} has no joint {name!r}; it has {', '.join(names)}.")
    if arm.bus.interface == "mock":
        raise Refusal(f"Arm {arm.name} has mock drives and no bus, so there is nothing to check.")
    joint, made, code = names.index(name), False, ExitCode.REFUSED
    try:
        before = commissioned.load(arm).get(joint)
    except NotReadable as damaged:
        raise Refusal(str(damaged)) from None
    stamp = time.strftime("%Y%m%dT%H%M%S")
    folder = output or Path(f"commission-{arm.name}-{name.replace('/', '_')}-{stamp}")
    report = Report(arm, joint, folder)
    try:
        with signals_raise(), offline_process("rtloop.commissioning", argument, overrides) as process:
            found = process.answer("ready")["drives"].get(str(joint))
            _make(folder)
            made = True
            with _recorded(arm.name, folder / RECORDING):
                _hold(process, found, name, person, joint)
                _all_checks(process, joint, person, report)
    except (Quit, Interrupted) as ended:
        report.ended, code = f"Ended early ({ended}); the drive stands.", ExitCode.REFUSED
    except Refusal as refused:
        report.ended, code = refused.sentence, refused.code
    if not report.findings:
        if made:  # never what was there before
            (folder / RECORDING).unlink(missing_ok=True)
            folder.rmdir()
        raise Refusal(f"{report.ended} Nothing was checked.".strip(), code)
    report.keep(before)
    report.write()
    person.tell(report.text())
    if report.ended:
        raise Refusal(report.ended, code)
    return report.agrees


class Report:
    """What was found of one drive so far."""

    def __init__(self, arm: ArmConfig, joint: int, folder: Path) -> None:
        self.arm, self.joint, self.folder = arm, joint, folder
        self.findings: list[dict[str, Any]] = []
        self.ended = ""
        self._record: Commissioned | None = None

    def add(self, answer: Mapping[str, Any]) -> None:
        """The findings of one check, and the record that they make with those before."""
        self.findings += answer["findings"]
        proof = answer["record"]["power_proof"]
        self._record = Commissioned(**{**answer["record"], "power_proof": proof and PowerProof(proof)})

    @property
    def agrees(self) -> bool:
        """Whether nothing that was tried differs from the manual."""
        return all(finding["verdict"] != "differs" for finding in self.findings)

    @property
    def _simulated(self) -> bool:
        """Whether this is no report of hardware; a link may lead to a pseudo-terminal."""
        return is_simulated(self.arm) or os.path.realpath(self.arm.bus.resolved_channel).startswith(PSEUDO_TERMINALS)

    def keep(self, before: Commissioned | None) -> None:
        """Put what was found into the arm's local state; raises Refusal."""
        assert self._record is not None
        self._record = self._record.after(before)
        try:
            commissioned.save(self.arm, self.joint, self._record)
        except (NotSaved, NotReadable) as problem:
            self.ended = f"{self.ended} {problem}".strip()

    def unlocked(self) -> dict[str, bool | None]:
        """What the control process may rely on; None for what was not tried."""
        record = self._record
        assert record is not None
        proof = None if record.power_proof is None else record.power_proof != PowerProof.NONE
        heals = None if None in (proof, record.brakes_in_silence) else record.heals
        return {
            "proof of power": proof,
            "fast targets": record.fast_targets,
            "reports": record.reports,
            "healing": heals,
        }

    def write(self) -> None:
        """Both files of the report."""
        record = self._record
        assert record is not None
        whole = {
            "rtarm": version("rtarm"),
            "arm": self.arm.name,
            "joint": self.arm.joints[self.joint].name,
            "ended": self.ended,
            "simulated": self._simulated,
            "record": vars(record),
            "unlocked": self.unlocked(),
            "findings": self.findings,
        }
        try:
            (self.folder / "report.json").write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
            (self.folder / "report.txt").write_text(self.text() + "\n", encoding="utf-8")
        except OSError as problem:
            raise Refusal(f"The report {self.folder} cannot be written ({problem.strerror}).") from None

    def text(self) -> str:
        """For people; its last lines are those of docs/hardware-status.md."""
        record, config = self._record, self.arm.joints[self.joint]
        assert record is not None
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
        words = {True: "unlocked", False: "withheld", None: "not tried, as before"}
        lines += ["", *(f"{what} ({RELIES[what]}): {words[yes]}" for what, yes in self.unlocked().items())]
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


def _all_checks(process: OfflineProcess, joint: int, person: Person, report: Report) -> None:
    process.order(f"checks {joint}")
    checks: Sequence[Sequence[Any]] = process.answer("checks")  # type: ignore[assignment]
    person.tell(INTRODUCTION)
    for number, (name, explains, question, moves) in enumerate(checks, 1):
        person.tell(f"{number}/{len(checks)}. {explains}")
        sign = _asked(person, question, moves)
        if sign == 0:
            person.tell(f"{name} is left out.")
            continue
        process.order(f"check {joint} {sign} {name}")
        answer = process.answer("found", person.tell)
        report.add(answer)
        for finding in answer["findings"]:
            person.tell(f"{finding['check']}: {finding['verdict']}. {finding['came']}.")


def _asked(person: Person, question: str, moves: bool) -> int:
    """1 for y, -1 for the other way, 0 for no."""
    if not moves:
        return int(agrees(person, question))
    answer = person.answer(f"{question} [y/N; o: the other way; q ends]").lower()
    return {"y": 1, "yes": 1, "o": -1}.get(answer, 0)


def _hold(process: OfflineProcess, found: Mapping[str, Any] | None, name: str, person: Person, joint: int) -> None:
    """See that the drive may be checked, and let it hold its joint if the person agrees; raises Refusal."""
    if found is None:
        return  # of another family
    if found["problems"]:
        raise Refusal("\n".join(found["problems"]), ExitCode.LOOP_REFUSED)
    if not found["enabled"] and agrees(person, f"{name} is limp, and most checks need its drive to hold it. Let it?"):
        process.order(f"hold {joint}")
        process.answer("state")


@contextmanager
def _recorded(arm: str, path: Path) -> Iterator[None]:
    """Record what the control process does meanwhile."""
    memory = files.open_state(arm)
    over = threading.Event()
    try:
        follower = Follower(memory, path, past=True)

        def follow() -> None:
            while not over.wait(LOOK_S):
                follower.take()

        with nice_thread() as thread:
            working = thread.submit(follow)
            try:
                yield
            finally:
                over.set()
                try:
                    working.result()
                    follower.take()
                    follower.finish()
                except OSError as problem:
                    follower.cut()
                    raise Refusal(f"The recording {path} cannot be written ({problem.strerror}).") from None
    finally:
        memory.close()


def _make(folder: Path) -> None:
    try:
        os.mkdir(folder)
    except OSError as problem:
        raise Refusal(
            f"The folder {folder} for the report cannot be made ({problem.strerror}): give another with -o."
        ) from None
