"""What a drive's status bits are to people."""

import pytest

from sentences import drive_words, told
from shm.words import DriveStatus, Fault

UP = int(DriveStatus.ENABLED | DriveStatus.ANSWERED)


def test_every_bit_has_words_of_its_own():
    assert set(drive_words.WORDS) == set(DriveStatus)
    assert len(set(drive_words.WORDS.values())) == len(DriveStatus)


def test_bits_are_told_in_their_order_and_unknown_ones_are_let_be():
    assert drive_words.words_of(UP | 1 << 40) == ["enabled", "answered"]
    assert drive_words.words_of(0) == []
    assert drive_words.troubles_of(UP | DriveStatus.ENCODER | DriveStatus.PROTECTED) == ["protected", "encoder error"]


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (UP | DriveStatus.PROTECTED | DriveStatus.OVER_CURRENT, "protected, over-current"),
        (UP | DriveStatus.COMMUNICATION, "communication lost"),
        (DriveStatus.ANSWERED, "not enabled"),
        (DriveStatus.ANSWERED | DriveStatus.PROTECTED | DriveStatus.STALLED, "stalled, protected, not enabled"),
        (UP, "it refuses motion"),
    ],
)
def test_a_fault_of_a_drive_says_which(status, words):
    text = told.fault_sentence(Fault.DRIVE_FAULT, "joint2", float(status))
    assert text.startswith(f"The drive of joint2 reports a fault of its own ({words}): remove the cause")


@pytest.mark.parametrize("value", [float("nan"), float("-inf"), 0.5, -1.0, 1e300])
def test_whatever_stands_in_the_file_there_are_words(value):
    assert "The drive of joint2" in told.fault_sentence(Fault.DRIVE_FAULT, "joint2", value)
