"""`rtarm commission`: the process that checks one drive, the person beside it, and the report of what was found.

A ZDT drive is asked by a control process that brings nothing up (`python -m rtloop.offline.commissioning`), as for
`rtarm calibrate`. A drive of another family is brought up alone and led by the control process of every day.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from config.loader import load_arm
from rtarm.commissioning.led_checks import LedBench, checks_of, judge_answers
from rtarm.commissioning.report import Report
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted, signals_raise
from rtarm.console.niceness import nice_thread
from rtarm.console.person import Person, Quit, agrees
from rtarm.drives.settings import OfflineProcess, offline_process
from rtarm.led.joint import alone
from rtarm.led.process import BRING_UP, LedProcess, led_alone, require_at_rest, with_unseen
from rtarm.recording.follow import LOOK_S, Follower
from rtloop.kept import commissioned
from rtloop.kept.commissioned import Commissioned, NotReadable, PowerProof
from rtloop.offline import families
from rtloop.offline.commissioning.finding import Finding, Verdict
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
    opened: list[OfflineProcess | LedProcess] = []
    try:
        with signals_raise():
            require_at_rest(arm, "Drives are checked")
            report.make()
            if families.knows("commissioning", arm.joints[joint].drive):
                _by_itself(argument, overrides, person, report, opened)
            else:
                _led(person, report, opened)
    except (Quit, Interrupted) as early:
        stands = "; the drive stands" if opened and not opened[0].refused else ""
        report.ended = f"Ended early ({early}){stands}."
    except Refusal as refused:
        report.ended, code = refused.sentence, refused.code
    except SharedMemoryError as problem:
        report.ended = str(problem)
        code = ExitCode.LOOP_DIED if isinstance(problem, NotRunning) else ExitCode.REFUSED
    if opened and (unseen := opened[0].refused):  # however it ended
        report.ended = with_unseen(report.ended, unseen)
        code = code if code is ExitCode.LOOP_DIED else ExitCode.LOOP_REFUSED
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


def _by_itself(
    argument: str,
    overrides: Mapping[str, Any],
    person: Person,
    report: Report,
    opened: list[OfflineProcess | LedProcess],
) -> None:
    arm, joint = report.arm, report.joint
    with offline_process("rtloop.offline.commissioning", argument, overrides) as process:
        found = process.answer("ready", person.tell)["drives"][str(joint)]
        with _recorded(arm.name, report.folder / RECORDING):
            if found["problems"]:
                _found(person, report, [asdict(_not_taken(found))], replace(report.record, firmware=found["firmware"]))
                return
            process.order(f"checks {joint}")
            checks: Sequence[Sequence[Any]] = process.answer("checks")  # type: ignore[assignment]
            opened.append(process)
            _hold(process, found, arm.joints[joint].name, person, joint)
            person.tell(INTRODUCTION)

            def do(name: str, sign: int) -> None:
                process.order(f"check {joint} {sign} {name}")
                answer = process.answer("found", person.tell)
                proof = answer["record"]["power_proof"]
                record = Commissioned(**{**answer["record"], "power_proof": proof and PowerProof(proof)})
                _found(person, report, answer["findings"], record)

            _ask_each(person, checks, do)


def _not_taken(found: Mapping[str, Any]) -> Finding:
    """Of a drive that is not what every check takes it for."""
    return Finding(
        "answers",
        "what it is: firmware, configuration, status",
        "a drive of its family, as the arm file has it",
        " ".join(found["problems"]),
        Verdict.DIFFERS,
    )


def _hold(process: OfflineProcess, found: Mapping[str, Any], name: str, person: Person, joint: int) -> None:
    """Let the drive hold its joint if the person agrees; raises Refusal."""
    if not found["enabled"] and agrees(person, f"{name} is limp, and most checks need its drive to hold it. Let it?"):
        process.order(f"hold {joint}")
        process.answer("state")


# --- one of another family, led as every day


def _led(person: Person, report: Report, opened: list[OfflineProcess | LedProcess]) -> None:
    arm, joint = report.arm, report.joint
    name = arm.joints[joint].name
    person.tell(INTRODUCTION)
    if not agrees(person, BRING_UP.format(name=name)):
        raise Quit("you did not want it")
    with led_alone(arm, joint, alone(arm, joint)) as (led, process):
        opened.append(process)
        with _recorded(arm.name, report.folder / RECORDING), led.stopped_by_any_end():
            refused = "" if process.brought_up() else "\n".join(process.told)
            if refused:
                opened.clear()  # nothing was led, and why stands in the finding
            if refused and not led.drive_refused():
                raise Refusal(refused, ExitCode.LOOP_REFUSED)
            _found(person, report, [asdict(judge_answers(process.told, refused))], report.record)
            if refused:
                return
            bench = LedBench(led, person.tell, lambda question: agrees(person, question))
            checks = {check.name: check for check in checks_of(led.config)}

            def do(name: str, sign: int) -> None:
                found = [asdict(one) for one in bench.check(checks[name], sign)]
                _found(person, report, found, _record(report.record, bench))

            _ask_each(person, [(one.name, one.explains, one.question, one.moves) for one in checks.values()], do)


def _record(before: Commissioned, bench: LedBench) -> Commissioned:
    """What the checks so far say that the control process may rely on."""
    return replace(
        before,
        when=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        power_proof=bench.power_proof,
        power=bench.power,
        retargets=bench.found["retarget"].good if "retarget" in bench.found else None,
        brakes_in_silence=bench.brakes_in_silence,
    )


# --- what both share


def _ask_each(person: Person, checks: Sequence[Sequence[Any]], do: Callable[[str, int], None]) -> None:
    """Explain each check and ask for it; `do` gets the name of one that is wanted, and the way."""
    for number, (name, explains, question, moves) in enumerate(checks, 1):
        if sign := _asked(person, f"{number}/{len(checks)}. {explains}", question, moves, name):
            do(name, sign)


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
