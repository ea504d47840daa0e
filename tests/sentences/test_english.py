"""Every number has its sentence, and every sentence says what, with which value, and what to do."""

import pytest

from sentences import english, told
from sentences.meaning import Silence
from shm.words import Answer, Fault, Mode, Outcome, Unreferenced

TABLES = {
    Outcome: english.OUTCOMES,
    Fault: english.FAULTS,
    Silence: english.SILENCES,
    Unreferenced: english.UNREFERENCED,
    Answer: english.ANSWERS,
}


@pytest.mark.parametrize("kind", TABLES)
def test_every_member_has_a_row(kind):
    assert set(TABLES[kind]) == set(kind)


@pytest.mark.parametrize("member", [m for kind in TABLES for m in kind], ids=lambda m: f"{type(m).__name__}.{m.name}")
def test_each_sentence_is_one_and_fills_in(member):
    text = told._say(type(member), int(member), "en", "joint2", 0.1312, 0.1)
    assert text.endswith(".") and ". " not in text and "{" not in text
    bad_news = member not in (Outcome.NONE, Fault.NONE, Answer.NONE, Answer.DONE, Unreferenced.REFERENCED)
    if bad_news:
        row = TABLES[type(member)][member]
        assert row.reason.endswith(".") and row.remedy.endswith(".")


@pytest.mark.parametrize(
    "reason", [one for one in Unreferenced if one != Unreferenced.REFERENCED], ids=lambda r: r.name
)
def test_a_cause_is_the_sentence_without_what_follows_from_it(reason):
    cause = told.unreferenced_cause(reason, "joint2")
    assert told.unreferenced_sentence(reason, "joint2").startswith(f"{cause}, so ")
    assert "joint2" in cause and ":" not in cause and len(cause) < 62  # beside joint and angle in 80 columns


def test_the_values_are_in_the_sentence():
    text = told.outcome_sentence(Outcome.PATH_TOLERANCE, "joint2", 0.1312, 0.1)
    assert "joint2 was 0.1312 rad from its setpoint and 0.1000 rad are allowed" in text


def test_a_mode_is_written_by_name():
    text = told.outcome_sentence(Outcome.REFUSED_MODE, "", float(Mode.BRINGING_UP))
    assert "while it is bringing up" in text


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e308, 2.5, 99.0], ids=str)
def test_a_number_that_is_no_mode_is_said_and_raises_nothing(value):
    text = told.outcome_sentence(Outcome.REFUSED_MODE, "", value)
    assert "while it is in unknown mode " in text


def test_an_unknown_number_is_said_and_not_hidden():
    assert "Unknown outcome 99" in told.outcome_sentence(99)


def test_joint_names():
    assert told.joint_name(1, ["a", "b"]) == "b"
    assert told.joint_name(-1, ["a", "b"]) == "no joint"
