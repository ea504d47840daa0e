"""`rtarm commission`: the process that checks one drive, the person beside it, and the report of what was found.

A ZDT drive is asked by a control process that brings nothing up (`python -m rtloop.commissioning`), as for `rtarm
calibrate`. A drive of another family is brought up alone and led by the control process of every day.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.calibrate.person import Person, Quit, agrees
from rtarm.commissioning.led_checks import LedBench, checks_of
from rtarm.commissioning.process import led_alone
from rtarm.commissioning.report import Report
from rtarm.drives import OfflineProcess, offline_process
from rtarm.errors import ExitCode, Refusal
from rtarm.interrupt import Interrupted, signals_raise
from rtarm.niceness import nice_thread
from rtarm.recording.follow import LOOK_S, Follower
from rtloop import commissioned, saved
from rtloop.commissioned import Commissioned, NotReadable, PowerProof
from rtloop.commissioning.finding import Finding, Verdict
from rtloop.commissioning.session import FAMILIES
from shm import files
from shm.errors import NotRunning, SharedMemoryError

INTRODUCTION = (
    "One drive is checked, and only after your y; each move is told before it is made. The joint must be free to turn "
    "by 15° either way, with nothing else in reach, a clamp and the switch in its power line at hand. Ctrl-C or q "
    "stops what moves and ends this at any time; what was found until then is in the report."
)
RECORDING = "recording.mcap"


def commission(argument: str, name: str, output: Path | None, overrides: Mapping[str, Any], person: Person) -> bool:
    """Check one drive with a person, write the report, and keep what was found; whether all that was tried is good.

    Raises:
        Refusal: it cannot begin, or ended early, after a report of what was found until then.
    """
    arm = load_arm(argument, overrides=overrides)
    names = [joint.name for joint in arm.joints]
    if name not in names:
        raise Refusal(f"Arm {arm.name} has no joint {name!r}; it has {', '.join(names)}.")
    joint = names.index(name)
    if not arm.joints[joint].drive.identifiers or arm.bus.interface == "mock":
        raise Refusal(f"Arm {arm.name} has mock drives and no bus, so there is nothing to check.")
    try:
        before = commissioned.load(arm).get(joint)
    except NotReadable as damaged:
        raise Refusal(str(damaged)) from None
    stamp = time.strftime("%Y%m%dT%H%M%S")
    folder = output or Path(f"commission-{arm.name}-{name.replace('/', '_')}-{stamp}")
    report, code = Report(arm, joint, folder, before), ExitCode.REFUSED
    try:
        with signals_raise():
            if arm.joints[joint].drive.family in FAMILIES:
                _by_itself(argument, overrides, person, report)
            else:
                _led(person, report)
    except (Quit, Interrupted) as ended:
        report.ended = f"Ended early ({ended}); the drive stands."
    except Refusal as refused:
        report.ended, code = refused.sentence, refused.code
    except SharedMemoryError as problem:
        report.ended = str(problem)
        code = ExitCode.LOOP_DIED if isinstance(problem, NotRunning) else ExitCode.REFUSED
    if not report.findings:
        if report.made:  # never what was there before
            (folder / RECORDING).unlink(missing_ok=True)
            folder.rmdir()
        raise Refusal(f"{report.ended} Nothing was checked.".strip(), code)
    report.ended = f"{report.ended} {report.not_kept}".strip()
    report.write()
    person.tell(report.text())
    if report.ended:
        raise Refusal(report.ended, code)
    return report.agrees


# --- a ZDT drive, by dialogues of its own


def _by_itself(argument: str, overrides: Mapping[str, Any], person: Person, report: Report) -> None:
    arm, joint = report.arm, report.joint
    with offline_process("rtloop.commissioning", argument, overrides) as process:
        found = process.answer("ready")["drives"].get(str(joint))
        report.make()
        with _recorded(arm.name, report.folder / RECORDING):
            _hold(process, found, arm.joints[joint].name, person, joint)
            process.order(f"checks {joint}")
            checks: Sequence[Sequence[Any]] = process.answer("checks")  # type: ignore[assignment]
            person.tell(INTRODUCTION)
            for number, (name, explains, question, moves) in enumerate(checks, 1):
                sign = _asked(person, f"{number}/{len(checks)}. {explains}", question, moves, name)
                if sign:
                    process.order(f"check {joint} {sign} {name}")
                    answer = process.answer("found", person.tell)
                    proof = answer["record"]["power_proof"]
                    record = Commissioned(**{**answer["record"], "power_proof": proof and PowerProof(proof)})
                    _found(person, report, answer["findings"], record)


def _hold(process: OfflineProcess, found: Mapping[str, Any] | None, name: str, person: Person, joint: int) -> None:
    """See that the drive may be checked, and let it hold its joint if the person agrees; raises Refusal."""
    assert found is not None  # it is one of those that this process reads
    if found["problems"]:
        raise Refusal("\n".join(found["problems"]), ExitCode.LOOP_REFUSED)
    if not found["enabled"] and agrees(person, f"{name} is limp, and most checks need its drive to hold it. Let it?"):
        process.order(f"hold {joint}")
        process.answer("state")


# --- one of another family, led as every day


def _led(person: Person, report: Report) -> None:
    arm, joint = report.arm, report.joint
    name = arm.joints[joint].name
    person.tell(INTRODUCTION)
    if not agrees(
        person,
        f"{name} is brought up alone: its drive is asked what rtarm asks of it, set up as the arm file wants, and "
        "holds the joint where it stands. Bring it up?",
    ):
        raise Quit("you did not want it")
    _forget_mark(arm, joint)
    with led_alone(arm, joint) as (led, process):
        report.make()
        with _recorded(arm.name, report.folder / RECORDING):
            bench = LedBench(led, person.tell, lambda question: agrees(person, question))
            _found(person, report, [asdict(_answers(process.told))], _record(arm, joint, bench))
            checks = checks_of(led.config)
            for number, check in enumerate(checks, 1):
                explains = f"{number}/{len(checks)}. {check.explains}"
                sign = _asked(person, explains, check.question, check.moves, check.name)
                if sign:
                    found = [asdict(one) for one in bench.check(check, sign)]
                    _found(person, report, found, _record(arm, joint, bench))


def _answers(told: Sequence[str]) -> Finding:
    return Finding(
        "answers",
        "all that a bring-up asks and sets",
        "an answer to each, settings that are taken, a drive that holds",
        " ".join(told) or "it answered, nothing had to be set, and it holds",
        Verdict.AS_DOCUMENTED,
    )


def _record(arm: ArmConfig, joint: int, bench: LedBench) -> Commissioned:
    """What the checks so far say that the control process may rely on."""
    drive = arm.joints[joint].drive
    good = {name: finding.good for name, finding in bench.found.items()}
    return Commissioned(
        channel=saved.channel_of(arm),
        family=drive.family,
        number=drive.number,
        firmware="",
        when=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        power_proof=bench.power_proof,
        power=bench.power,
        retargets=good.get("retarget"),
        brakes_in_silence=good.get("silence"),
    )


def _forget_mark(arm: ArmConfig, joint: int) -> None:
    """What its drive had as a proof of its power proves nothing after a bench; raises Refusal."""
    marks = saved.power_marks(arm)
    if marks.pop(joint, None) is not None:
        try:
            saved.keep_power_marks(arm, marks)
        except saved.NotSaved as problem:
            raise Refusal(str(problem)) from None


# --- what both share


def _asked(person: Person, explains: str, question: str, moves: bool, name: str) -> int:
    """Explain a check and ask for it: 1 for y, -1 for the other way, 0 for no."""
    person.tell(explains)
    if not moves:
        sign = int(agrees(person, question))
    else:
        answer = person.answer(f"{question} [y/N; o: the other way; q ends]").lower()
        sign = {"y": 1, "yes": 1, "o": -1}.get(answer, 0)
    if not sign:
        person.tell(f"{name} is left out.")
    return sign


def _found(person: Person, report: Report, findings: Sequence[dict[str, Any]], record: Commissioned) -> None:
    report.add(findings, record)
    for finding in findings:
        person.tell(f"{finding['check']}: {finding['verdict']}. {finding['came']}.")


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
