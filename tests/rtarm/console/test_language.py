"""What rtarm says itself: all of it has its Chinese, which says the same, and nothing else is translated."""

from __future__ import annotations

import ast
import io
import json
import re
import string
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from in_chinese import english_in
from rich.cells import cell_len
from rich.console import Console, RenderableType
from typer.testing import Result
from written_arm import JOINTS, WrittenArm

import rtarm
from config.loader import load_arm
from motion.gripping import Grip
from rtarm.console import chinese
from rtarm.console.errors import Refusal
from rtarm.console.language import language_of, named, said, told
from rtarm.console.wrapping import wrapped
from rtarm.recording.story import COUNTED, SLOWED, STATUS
from rtarm.running import requests
from rtarm.running.decisions import end_told
from rtarm.running.requests import TOO_EARLY_TO_CLEAR
from rtarm.running.status import STOPPED_BY_A_PERSON, key, read_status
from rtarm.running.status_tables import render_status
from rtarm.top.picture import Picture
from rtarm.top.watch import Watch
from rtarm.view.panels import events_html, joints_html, machine_html, problems_html, state_html
from rtarm.view.words import CHINESE
from rtarm.why_late.causes import Cause
from rtarm.why_late.tracefs import REASONS
from sentences.told import outcome_sentence
from shm import layout
from shm.errors import NotRunning, WrongArm
from shm.gripper import show_gripper
from shm.layout import BUS_TROUBLE
from shm.words import BusState, DriveStatus, Fault, Mode, Outcome, Phase, Request, Unreferenced

ROOT = Path(rtarm.__file__).parent
FROM_TABLES = {*COUNTED.values(), *STATUS.values(), *(sentence for sentence, _ in SLOWED.values()), STOPPED_BY_A_PERSON}
FROM_TABLES |= {*TOO_EARLY_TO_CLEAR.values(), *REASONS}
FROM_MEMORY = {
    "The control process of arm '{arm}' has died",
    "The control process of arm '{arm}' has ended in order",
    "No control process is running",
    "The control process of arm '{arm}' (pid",
    " (with the options it had)",
    "No consistent snapshot",
    "{waiting} requests wait",
    "Another process that asks",
}
"""What errors about memory files begin with: told under their own words."""
PLURALS = {"lines", "bytes", "commands", "errors"}
# What stays as it is: units, names, and two modes as plain `rtarm status` says them.
NAMES = re.compile(r"CAN|ROS|CPU|Hz|MCAP|rad|ms|µs|s|pid|q|~/\w+|--speed|SCHED_\w+|holding|fault")


def templates() -> Iterator[tuple[str, str]]:
    """Every sentence that `said` is called with, and where."""
    for path in sorted(ROOT.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants = {
            target.id: node.value.value
            for node in ast.walk(tree)
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "said":
                what = node.args[1]
                if isinstance(what, ast.Constant):
                    yield what.value, f"{path.name}:{node.lineno}"
                elif isinstance(what, ast.Name) and what.id in constants:
                    yield constants[what.id], f"{path.name}:{node.lineno}"


def placeholders(text: str) -> set[tuple[str, str]]:
    found = {(name, spec or "") for _, name, spec, _ in string.Formatter().parse(text) if name}
    return {one for one in found if one[0] not in PLURALS}


@pytest.mark.parametrize(("sentence", "where"), sorted(set(templates())), ids=lambda text: text[:40])
def test_what_is_said_has_its_chinese(sentence: str, where: str) -> None:
    assert sentence in chinese.SENTENCES, where


def test_what_tables_say_has_its_chinese() -> None:
    assert set(chinese.SENTENCES) >= FROM_TABLES


def test_nothing_is_translated_that_nobody_says() -> None:
    spoken = {sentence for sentence, _ in templates()} | FROM_TABLES
    unspoken = {
        sentence
        for sentence in set(chinese.SENTENCES) - spoken
        if not any(sentence.startswith(begin) for begin in FROM_MEMORY)
    }
    assert unspoken == set()


@pytest.mark.parametrize(("english", "other"), chinese.SENTENCES.items(), ids=lambda text: text[:40])
def test_a_sentence_says_the_same_in_chinese(english: str, other: str) -> None:
    assert placeholders(english) == placeholders(other)
    assert sorted(re.findall("`[^`]+`", english)) == sorted(re.findall("`[^`]+`", other))
    plain = re.sub(r"`[^`]*`|\{[^}]*\}", " ", other)
    words = re.findall(r"[A-Za-z~-][\w/~-]*", plain, re.ASCII)
    assert [word for word in words if NAMES.fullmatch(word) is None] == []


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        (chinese.MODES, {key(Mode, mode) for mode in Mode}),
        (chinese.PHASES, {key(Phase, phase) for phase in Phase}),
        (chinese.GRIPS, {key(Grip, grip) for grip in Grip}),
        (chinese.REQUESTS, {key(Request, request) for request in Request}),
        (chinese.BUS_STATES, {key(BusState, state) for state in BusState}),
        (chinese.BUS_TROUBLES, set(BUS_TROUBLE)),
        (chinese.CAUSES, {cause.value for cause in Cause}),
        (chinese.CAUSE_MEANINGS, {cause.value for cause in Cause}),
    ],
    ids=["modes", "phases", "grips", "requests", "bus states", "bus troubles", "causes", "their meanings"],
)
def test_what_json_has_by_a_key_has_a_word(table: dict[str, str], keys: set[str]) -> None:
    assert set(table) == keys
    assert not any(re.search("[A-Za-z]", word) for word in table.values())


def test_english_is_what_stands_in_the_code() -> None:
    assert said("en", "Goal {id} was announced.", id=7) == "Goal 7 was announced."
    assert said("zh", "Goal {id} was announced.", id=7) == "目标 7 已宣布。"
    assert named("en", chinese.MODES, "bringing_up") == "bringing up"
    assert named("zh", chinese.MODES, "bringing_up") == "正在启动"
    assert named("zh", chinese.MODES, "unknown_99") == "unknown_99"


def test_there_are_two_languages() -> None:
    assert (language_of("en"), language_of("zh")) == ("en", "zh")
    with pytest.raises(Refusal, match="--language is 'fr', but rtarm speaks en and zh only: choose one"):
        language_of("fr")


def test_an_error_about_memory_files_is_told_in_both() -> None:
    options = " (with the options it had)"
    gone = NotRunning(
        "The control process of arm '{arm}' (pid {pid}) is gone without an orderly end: start it again with "
        "{again}{options}.",
        **{"arm": "a", "pid": 7, "again": "`rtarm up a`", "options": options},
    )
    assert told(gone, "en") == str(gone)
    assert str(gone).endswith("start it again with `rtarm up a` (with the options it had).")
    assert (
        told(gone, "zh")
        == "机械臂 a 的控制进程（pid 7）没有正常结束就不在了：用 `rtarm up a`（带上它原来的选项） 重新启动它。"
    )
    assert told(WrongArm("Braces {stay}."), "zh") == "Braces {stay}."


def test_that_no_arm_runs_is_said_in_the_language_asked_for(rtarm: Callable[..., Result]) -> None:
    result = rtarm("status", "not_there", "--language", "zh")
    assert result.exit_code == 1 and "机械臂 not_there 没有控制进程在运行" in result.stderr
    assert "No control process is running for arm 'not_there'" in rtarm("status", "not_there").stderr


def test_json_is_english(rtarm: Callable[..., Result]) -> None:
    result = rtarm("status", "not_there", "--json", "--language", "zh")
    assert "No control process is running" in result.stdout and result.stdout.isascii()


def test_an_unknown_language_is_refused(rtarm: Callable[..., Result]) -> None:
    for words in (("status",), ("top",), ("explain",), ("replay",), ("view",), ("why-late",)):
        result = rtarm(*words, "--language", "fr")
        assert result.exit_code == 1
        assert result.stderr == "--language is 'fr', but rtarm speaks en and zh only: choose one.\n"


# --- what a person sees -----------------------------------------------------------------------------------


@pytest.fixture
def broken(arm: WrittenArm) -> WrittenArm:
    """A gripper that holds something, a latched fault, a joint without a reference, a drive with an error."""
    gripper = np.zeros((), layout.Gripper.dtype)
    gripper["written"], gripper["grip"], gripper["measured_ns"] = 1, Grip.STALLED, time.monotonic_ns()
    show_gripper(arm.files.state.array, gripper)
    arm.snapshot["mode"], arm.snapshot["fault"], arm.snapshot["held"] = Mode.FAULT, Fault.FOLLOWING_ERROR, 1
    arm.snapshot["fault_joint"], arm.snapshot["fault_value"], arm.snapshot["fault_limit"] = 1, 0.15, 0.1
    arm.rows["referenced"][0], arm.rows["unreferenced_reason"][0] = 0, Unreferenced.SILENT
    arm.rows["drive_status"][0] = DriveStatus.ANSWERED | DriveStatus.PROTECTED | DriveStatus.OVER_TEMPERATURE
    arm.state["counters"]["wire_errors"] = 3
    arm.publish()
    return arm


def test_status_in_chinese_has_no_english(broken: WrittenArm, rtarm: Callable[..., Result]) -> None:
    shown = rtarm("status", broken.name, "--language", "zh").stdout
    assert english_in(shown) == set()
    told_at_once = "".join(shown.split())
    for part in (
        "elbow离指令位置0.1500rad，允许0.1000rad：查找障碍物、负载或无力的驱动器，然后`rtarmclear-fault`。",
        "shoulder的驱动器沉默太久，因此角度未知",
        "shoulder的驱动器有错误（保护、过温），可能什么都保持不住",
        "有人停下或暂停了机械臂",
        "没有ROS进程为机械臂服务",
        "夹住了东西，在0.0°",
        "3次线路错误",
    ):
        assert part in told_at_once, part


@pytest.mark.parametrize("width", [40, 61, 100])
def test_status_in_chinese_fits_its_terminal_and_loses_nothing(broken: WrittenArm, width: int) -> None:
    report = read_status(broken.name, "zh")
    lines = printed(render_status(report, "zh"), width)
    assert max(map(cell_len, lines)) <= width
    everything = "".join("".join(lines).split())
    for problem in report["problems"]:
        assert "".join(problem.split()) in everything


def printed(what: RenderableType, width: int, height: int = 100) -> list[str]:
    """Lines of a terminal, without colours."""
    file = io.StringIO()
    console = Console(file=file, width=width, height=height, color_system=None, legacy_windows=False)
    console.print(what, end="")
    return file.getvalue().splitlines()


@pytest.mark.parametrize(("width", "height"), [(30, 30), (60, 30), (100, 40), (160, 40)])
def test_top_in_chinese_fits_its_terminal(broken: WrittenArm, width: int, height: int) -> None:
    with closing(Watch(broken.name, "zh")) as watch:
        look = watch.look()
    lines = printed(Picture(look), width, height)
    assert max(map(cell_len, lines)) <= width
    assert english_in(" ".join(lines)) == set()
    assert "故障，不能运动" in lines[0]


def test_json_of_an_arm_with_a_fault_is_the_same_in_both(broken: WrittenArm, rtarm: Callable[..., Result]) -> None:
    one, other = (
        json.loads(rtarm("status", broken.name, "--json", "--language", language).stdout) for language in ("en", "zh")
    )
    assert one["problems"] == other["problems"] and one["joints"][0]["drive"] == other["joints"][0]["drive"]


def test_the_page_in_chinese_has_no_english(broken: WrittenArm) -> None:
    with closing(Watch(broken.name, "zh")) as watch:
        look = watch.look()
    arm = load_arm("episode1", overrides={"bus": {"channel": "simulated"}})
    two = arm.model_copy(
        update={
            "kinematics": None,
            "joints": [
                joint.model_copy(update={"name": name}) for joint, name in zip(arm.joints, JOINTS, strict=False)
            ],
        }
    )
    pages = [
        state_html(look, CHINESE),
        problems_html(look, two, CHINESE).replace("kinematics", ""),  # a key of the arm file
        joints_html(look, two, CHINESE),
        events_html(look, CHINESE),
        machine_html(look, CHINESE),
    ]
    assert english_in(" ".join(pages)) == set()


def test_how_a_goal_ended_is_told_in_the_language_of_who_asks(arm: WrittenArm) -> None:
    result = arm.snapshot["results"][0]
    result["outcome"], result["joint"], result["value"], result["limit"] = Outcome.PATH_TOLERANCE, 1, 0.15, 0.1
    arm.publish()
    english = outcome_sentence(Outcome.PATH_TOLERANCE, "elbow", 0.15, 0.1)
    far = english.removesuffix(".") + "; shoulder is 0.4954 rad from its target."
    with requests.connect(arm.name, "zh") as connection:
        assert end_told(connection, english).startswith("elbow 离设定点 0.1500 rad，允许 0.1000 rad")
        assert end_told(connection, far).endswith("或者放宽 path_tolerance；shoulder 离目标位置 0.4954 rad。")
        assert end_told(connection, "The goal leaves out elbow.") == "The goal leaves out elbow."
    with requests.connect(arm.name) as connection:
        assert end_told(connection, far) == far


def test_chinese_breaks_between_characters_and_not_before_punctuation() -> None:
    words = "驱动器沉默太久，因此角度未知：用 `rtarm home` 回零，或者（再）等。"
    for width in range(8, 70):
        lines = wrapped(words, width)
        assert max(map(cell_len, lines)) <= max(width, 8)
        assert "".join("".join(lines).split()) == "".join(words.split())
        assert not any(line[0] in "，。：）" for line in lines)
    assert wrapped("plain English words", 9) == ["plain", "English", "words"]
