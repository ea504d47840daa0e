"""What each command prints with `--json`, of arms that nobody leads; full, so that no key of it is missing."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
from hand_readings import limits
from recorded import TWO_BUSES, a_recording
from two_buses import write_divided
from typer.testing import CliRunner
from written_arm import WrittenArm

from config.loader import load_arm
from motion.gripping import Grip
from rtarm.cli.application import app
from rtarm.doctor.checks import Check
from rtarm.doctor.finding import ok
from rtarm.doctor.repair import Change, Repairs
from rtarm.scan.adapters import Adapter
from rtarm.scan.heard import Heard
from rtarm.scan.search import FoundDrive
from rtarm.scan.search import Outcome as Searched
from rtarm.teach.file import motion_path, require_free, save
from rtarm.teach.motion import Motion
from rtarm.why_late.causes import Cause
from rtarm.why_late.divide import Segment
from rtarm.why_late.report import report_of as report_of_why_late
from rtarm.why_late.watch import Late
from rtloop.drives.zdt_protocol import Block, HomingParameters, Trip, Version
from rtloop.offline.settings.compare import as_json
from rtloop.offline.settings.session import Written
from rtloop.offline.settings.zdt import report_of
from rtloop.offline.settings.zdt_talk import Reading
from shm import layout
from shm.gripper import show_gripper
from shm.words import Fault, Outcome, Phase

Reports = list[Any]

NOWHERE = "none_of_this_name"
ORDERS = {
    "rtarm stop": "rtarm.running.requests.stop",
    "rtarm clear-fault": "rtarm.running.requests.clear_fault",
    "rtarm hold": "rtarm.running.requests.hold",
    "rtarm resume": "rtarm.running.requests.resume",
    "rtarm enable": "rtarm.running.requests.enable",
    "rtarm disable": "rtarm.running.requests.let_go",
    "rtarm free": "rtarm.running.requests.let_go",
    "rtarm home": "rtarm.running.requests.home",
    "rtarm reference": "rtarm.running.referencing.reference",
}
"""Commands that ask a running arm for something, and what does it."""


def keys_of(value: Any, place: str = "") -> Iterator[str]:
    """The places of all keys of nested values, such as `joints[].name`."""
    if isinstance(value, dict):
        for key, inner in value.items():
            here = f"{place}.{key}" if place else key
            yield here
            yield from keys_of(inner, here)
    elif isinstance(value, list):
        for inner in value:
            yield from keys_of(inner, f"{place}[]")


def printed(*arguments: str) -> Any:
    """What a command prints with `--json`, without a process."""
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return json.loads(result.stdout)


def of_status() -> Reports:
    """Of an arm with two buses, a goal, a result, a latched fault and a gripper; and of none."""
    arm = WrittenArm(f"names_{os.getpid()}", TWO_BUSES)
    try:
        now_ns = time.monotonic_ns()
        arm.snapshot["goal_id"], arm.snapshot["goal_phase"] = 2, Phase.RUNNING
        arm.snapshot["fault"], arm.snapshot["fault_ns"] = Fault.FOLLOWING_ERROR, now_ns
        result = arm.snapshot["results"][0]
        result["goal_id"], result["outcome"], result["monotonic_ns"] = 1, Outcome.SUCCEEDED, now_ns
        gripper = np.zeros((), layout.Gripper.dtype)
        gripper["written"], gripper["grip"] = 1, Grip.STALLED
        show_gripper(arm.files.state.array, gripper)
        arm.publish()
        return [printed("status", arm.name), printed("status", NOWHERE)]
    finally:
        arm.files.remove()


def of_doctor() -> Reports:
    """Of one check, and of one value that was changed; nothing here is looked at, nor changed."""
    repaired = Repairs([Change("/sys/nothing", "0", "1")], ["It may not be written."])
    with (
        patch("rtarm.doctor.report.CHECKS", (Check("a check", "It matters.", lambda *_: ok("fine")),)),
        patch("rtarm.doctor.report.repair", lambda *_: repaired),
    ):
        return [printed("doctor", "--fix"), printed("doctor", NOWHERE)]


def of_config_check() -> Reports:
    """Of an arm with one bus, of one with several, and of none."""
    with tempfile.TemporaryDirectory() as folder:
        several = str(write_divided("episode1", Path(folder) / "arm.yaml"))
        return [printed("config", "check", arm) for arm in ("episode1", several, NOWHERE)]


def of_explain() -> Reports:
    """Of a recording that ends in a fault, and of a file that is none."""
    with a_recording() as path:
        return [printed("explain", str(path)), printed("explain", NOWHERE)]


def of_order(command: str) -> Reports:
    """Of what is done, and of an arm that does not run."""
    words = command.split()[1:]
    words += ["joint1", "--arm", NOWHERE] if command == "rtarm reference" else [NOWHERE]
    with (
        patch("rtarm.running.status.resolve_arm", lambda _: "an_arm"),
        patch(ORDERS[command], lambda *_: "It is done."),
    ):
        done = printed(*words)
    return [done, printed(*words)]


def of_drives() -> Reports:
    """Of a drive that has told everything, after a write; and of none."""
    arm = load_arm("episode1")
    reading = Reading(
        version=Version(200, 1, newer=True),
        block=Block(*(0 for _ in fields(Block))),
        homing=HomingParameters(*(0 for _ in fields(HomingParameters))),
        trip=Trip(90, 3000, 1000),
        supply_mv=24_000,
    )
    report = {
        "drives": [as_json(report_of(arm, 0, reading))],
        **asdict(Written(["joint1"], "It ended.")),
    }

    def run(*_: object, show: Callable[[Any], None], **__: object) -> Any:
        show(report)
        return report

    with patch("rtarm.drives.settings.run", run):
        return [printed("drives", "episode1"), printed("drives", NOWHERE)]


def of_scan() -> Reports:
    """Of an adapter behind which drives have answered and one was overheard, with all that they say; and of none."""
    settings = ({"motor_id": 1, "master_id": 0x11}, {"can_id": 1}, {"node_id": 1})
    asked = [Heard("damiao", "Damiao motor", 1, "answers on 0x11", given) for given in settings]
    outcome = Searched(500_000, [FoundDrive(1)], asked, [Heard("odrive", "ODrive axis", 2, "idle", {"node_id": 2})])
    adapter = Adapter("/dev/nowhere", "slcan", "an adapter")
    with (
        patch("rtarm.scan.run._named", lambda *_: adapter),
        patch("rtarm.scan.run._try_serial", lambda *_: (outcome, 1_000_000)),
    ):
        found = printed("scan", "--port", "/dev/nowhere")
    return [found, printed("scan", "--port", "/dev/none/of/this/name")]


def of_move() -> Reports:
    """Of a motion that came to its end, and of an arm that does not run."""

    class Connected(SimpleNamespace):
        def __enter__(self) -> Any:
            return self

        def __exit__(self, *_: object) -> None:
            """Nothing is open."""

    with patch("rtarm.arm.connect", lambda _: Connected(name="an_arm", move=lambda *_, **__: "It is there.")):
        done = printed("move", "joint1=1")
    return [done, printed("move", "joint1=1", "--arm", NOWHERE)]


def of_motions() -> Reports:
    """Of one that can be played, and of one that cannot."""
    times_s, positions_rad = np.array([0.0, 1.0]), np.zeros((2, 6))
    with tempfile.TemporaryDirectory() as home, patch.dict(os.environ, {"XDG_DATA_HOME": home}):
        require_free(motion_path("wave"), force=False)
        save(Motion("episode1", limits(), "today", 0.01, 0.0, times_s, positions_rad), motion_path("wave"), force=False)
        Path(motion_path("broken")).write_text("format: 0\n", encoding="utf-8")
        return [printed("motions")]


def of_why_late() -> Reports:
    """Of a late cycle with its cause, without permission, and of an arm that does not run."""
    late = Late.of(7, True, (Segment(0, 2_000_000, Cause.TASK, "hog 20"), Segment(2_000_000, 2_010_000, Cause.OWN)))
    watcher = SimpleNamespace(late=[late], cycles=10, count=1, undivided=0)
    hint = {"what": "page faults", "a_look_with_late_cycles": 1.0, "a_look_without": 0.0}
    found = report_of_why_late("an_arm", 1.0, 100.0, watcher, ["It ended."])  # type: ignore[arg-type]
    report = {**found, "traced": True, "hints": [hint]}
    with patch("rtarm.why_late.run.why_late", lambda *_: report):
        told = printed("why-late", "an_arm")
    return [told, printed("why-late", "nobody_at_all")]


REPORTS: dict[str, Callable[[], Reports]] = {
    "rtarm status": of_status,
    "rtarm doctor": of_doctor,
    "rtarm config check": of_config_check,
    "rtarm explain": of_explain,
    **{command: lambda command=command: of_order(command) for command in ORDERS},  # type: ignore[misc]
    "rtarm drives": of_drives,
    "rtarm scan": of_scan,
    "rtarm move": of_move,
    "rtarm motions": of_motions,
    "rtarm why-late": of_why_late,
}
"""Every command that has `--json`, as a choice between text and one JSON object."""
