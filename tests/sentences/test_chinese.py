"""Every sentence has its Chinese one, which says the same of the same joint, values and commands."""

from __future__ import annotations

import re
import string
from enum import IntEnum

import pytest

from sentences import drive_words, told
from sentences.meaning import Meaning
from shm.words import Answer, DriveStatus, Evidence, Fault, Mode, Outcome, Request, Unreferenced

NAMES = {
    *(
        "CAN",
        "ROS",
        "USB",
        "Checksum",
        "En",
        "Emm",
        "Emm_V5",
        "rtarm",
        "bus-off",
        "error-passive",
        "restart-ms",
        "home",
    ),
    *("path_tolerance", "goal_tolerance", "goal_time_tolerance", "time_from_start", "~/resume", "~/joint_trajectory"),
    *("zero_deg", "direction", "ratio", "nm_per_ampere"),
}
"""What is called so in menus, messages and files whatever language one speaks."""
UNITS = {"rad", "rad/s", "rad/s²", "s", "mA", "Ω", "0x6B", "6B"}
KEYS_OF_FILES = re.compile(r"(?:trajectory|gripper)\.[a-z_.]+")

MEMBERS = [(kind, member) for kind, table in told.TABLES["en"].items() for member in table]


def placeholders(text: str) -> list[tuple[str, str | None]]:
    return sorted((name, spec or "") for _, name, spec, _ in string.Formatter().parse(text) if name)


def commands(text: str) -> list[str]:
    return sorted(re.findall(r"`([^`]+)`", text))


def english_in(text: str) -> set[str]:
    """Words in Latin letters that are no names, commands, figures or units."""
    plain = re.sub(r"`[^`]*`|\{[^}]*\}", " ", text)
    found = re.findall(r"[A-Za-z0-9~][A-Za-z0-9_./~²-]*", plain)
    return {
        word
        for word in found
        if re.search("[A-Za-z]", word)
        if word not in NAMES | UNITS and KEYS_OF_FILES.fullmatch(word) is None
    }


@pytest.mark.parametrize("kind", told.TABLES["en"], ids=lambda kind: kind.__name__)
def test_both_tables_have_the_same_keys(kind: type[IntEnum]) -> None:
    assert list(told.TABLES["en"][kind]) == list(told.TABLES["zh"][kind])
    assert set(told.TABLES["zh"][kind]) == set(kind)


@pytest.mark.parametrize("member", [member for _, member in MEMBERS], ids=lambda m: f"{type(m).__name__}.{m.name}")
def test_a_row_says_the_same_in_chinese(member: IntEnum) -> None:
    english, chinese = told.meaning(member), told.meaning(member, "zh")
    for field, one, other in zip(Meaning._fields, english, chinese, strict=True):
        assert bool(one) == bool(other), field
        assert placeholders(one) == placeholders(other), field
        assert commands(one) == commands(other), field
        assert english_in(other) == set(), field
        assert not other or other.endswith("。"), field
    assert "。" not in chinese.sentence[:-1], "one sentence"


@pytest.mark.parametrize("member", [member for _, member in MEMBERS], ids=lambda m: f"{type(m).__name__}.{m.name}")
def test_joint_and_values_stand_in_it(member: IntEnum) -> None:
    text = told._say(type(member), int(member), "zh", "joint2", 3.0, 0.1)
    assert "{" not in text
    named = {name for name, _ in placeholders(told.meaning(member).sentence)}
    assert ("joint2" in text) == ("joint" in named)
    if "limit" in named:
        assert re.search(r"(?<!\d)0\.10*(?!\d)", text), text


@pytest.mark.parametrize(
    "reason", [one for one in Unreferenced if one != Unreferenced.REFERENCED], ids=lambda reason: reason.name
)
def test_a_cause_is_the_sentence_without_what_follows_from_it(reason: Unreferenced) -> None:
    cause = told.unreferenced_cause(reason, "joint2", "zh")
    assert told.unreferenced_sentence(reason, "joint2", "zh").startswith(f"{cause}，因此")
    assert "joint2" in cause and "：" not in cause and len(cause) < 31, "beside joint and angle in 80 columns"


def test_joints_with_one_reason_are_told_in_one_sentence() -> None:
    lost = {"joint1": Unreferenced.SILENT, "joint2": Unreferenced.SILENT, "joint3": Unreferenced.POWER_LOST}
    silent, dark = told.unreferenced_sentences(lost, "zh")
    assert silent.startswith("joint1、joint2 的驱动器沉默太久")
    assert dark.startswith("joint3 的驱动器可能断过电")


def test_the_silence_of_several_drives_names_them() -> None:
    text = told.fault_told(Fault.STALE_READING, 0, 0.12, 0.1, 0b101, 0, ["a", "b", "c"], "zh")
    assert text.startswith("a、c 已有 0.120 s 没有给出可信的应答，允许 0.100 s，而其他驱动器在应答")
    text = told.fault_told(Fault.STALE_READING, -1, 0.12, 0.1, 0b111, Evidence.SIMULATED, ["a", "b", "c"], "zh")
    assert text.startswith("仿真机械臂没有一个驱动器应答已有 0.120 s")


def test_modes_and_drives_have_words() -> None:
    assert "正在启动" in told.outcome_sentence(Outcome.REFUSED_MODE, value=float(Mode.BRINGING_UP), language="zh")
    assert "未知状态 99" in told.outcome_sentence(Outcome.REFUSED_MODE, value=99.0, language="zh")
    assert "未知状态 nan" in told.outcome_sentence(Outcome.REFUSED_MODE, value=float("nan"), language="zh")
    hot = float(DriveStatus.PROTECTED | DriveStatus.OVER_TEMPERATURE)
    assert "（保护、过温、未使能）" in told.fault_sentence(Fault.DRIVE_FAULT, "joint2", hot, language="zh")
    assert "（未知状态字 2.5）" in told.fault_sentence(Fault.DRIVE_FAULT, "joint2", 2.5, language="zh")
    assert set(drive_words.CHINESE) == set(drive_words.WORDS)
    assert len(set(drive_words.CHINESE.values())) == len(drive_words.CHINESE)


def test_phrases_have_the_same_braces_and_no_english() -> None:
    english, chinese = told.PHRASES["en"], told.PHRASES["zh"]
    for field, one, other in zip(english._fields, english, chinese, strict=True):
        if isinstance(one, str):
            assert placeholders(one) == placeholders(other) and commands(one) == commands(other), field
        else:
            assert set(one) == set(other), field
        for words in [other] if isinstance(other, str) else other.values():
            assert english_in(words) == set(), field


def test_what_is_no_row_is_said_too() -> None:
    assert "99" in told.outcome_sentence(99, language="zh")
    assert told.command_sentence(Request.SPEED_SCALE, 0.5, "zh") == "请求速度比例 50%。"
    assert told.command_sentence(Request.STOP, 4711, "zh") == "进程 4711 请求停止。"
    assert told.command_sentence(99, 4711, "zh") == "进程 4711 请求未知的命令 99。"
    assert told.joint_name(-1, ["a"], "zh") == "（没有关节）"
    assert told.answer_sentence(Answer.DONE, "zh") == "完成。"
