"""A sample of the transcripts, what they hold, and proof that the tool finds the smallest difference and names it."""

import copy
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from shm import layout
from shm.record import Record
from shm.words import Answer, Fault, Mode, Outcome, Phase
from transcripts import run, store, words
from transcripts.__main__ import main
from transcripts.compare import Finding, Verdict, compare, this_place
from transcripts.run import compared
from transcripts.scenarios import SCENARIOS, Scenario
from transcripts.tape import Transcript

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = (
    "goal-small",
    "cancel",
    "family-mock",
    "family-damiao6",
    "bus-a-drive-falls-silent-0",
    "hostile-seeedstudio-1",
)
MOST_BYTES = 2_000_000
NEVER_SEEN = {
    *("Fault.NOT_FINITE", "Fault.POSITION_LIMIT", "Fault.ACCELERATION_LIMIT", "Fault.RELEASE"),
    *("Outcome.GOAL_VELOCITY", "Outcome.GOAL_ACCELERATION", "Answer.REFUSED_NO_GOAL"),
    "Mode.OFFLINE",
}
"""What no scenario comes to; tests of tests/rtloop do."""
CYCLE = 60
NAME = "joint2.commanded_position_rad"


@pytest.fixture
def was() -> Transcript:
    """A recording that has every word of every cycle, as if it had been made here."""
    found = store.read(store.FOLDER / f"goal-small{store.SUFFIX}")
    found.place = this_place()
    return found


@pytest.fixture
def now(was: Transcript) -> Transcript:
    """The same once more, to be changed."""
    return copy.deepcopy(was)


def difference(was: Transcript, now: Transcript) -> str:
    finding = compare("goal-small", was, now)
    assert finding.verdict == Verdict.DIFFERS
    return finding.sentence


def nudge(transcript: Transcript, name: str, cycle: int, ulps: int = 1) -> None:
    """Change a word by its last bits."""
    transcript.words[name] = transcript.words[name].copy()
    transcript.words[name].view(np.int64)[cycle] += ulps


@pytest.mark.parametrize("name", SAMPLE)
def test_a_sample_is_as_it_was_recorded(name: str) -> None:
    finding = compared(store.FOLDER, name)
    assert finding.verdict != Verdict.DIFFERS, finding.sentence


# --- what is kept ----------------------------------------------------------------------------------------------


def test_recordings_are_those_of_the_scenarios_and_small() -> None:
    recordings = {path.stem: path.stat().st_size for path in store.FOLDER.iterdir()}
    assert recordings.keys() == SCENARIOS.keys()
    assert sum(recordings.values()) <= MOST_BYTES


def test_recordings_show_nearly_all_that_can_happen() -> None:
    missing = {f"{kind.__name__}.{word.name}" for kind in (Mode, Phase, Fault, Outcome, Answer) for word in kind}
    for name in SCENARIOS:
        transcript = store.read(store.FOLDER / f"{name}{store.SUFFIX}")
        for word, kind in (("mode", Mode), ("goal_phase", Phase), ("fault", Fault)):
            missing -= {f"{kind.__name__}.{kind(number).name}" for number in np.unique(transcript.words[word]).tolist()}
        missing -= {f"Outcome.{Outcome(row['outcome']).name}" for _, table, row in transcript.told if table == "result"}
        missing -= {f"Answer.{Answer(row['answer']).name}" for _, table, row in transcript.told if table == "answer"}
    assert missing == NEVER_SEEN


@pytest.mark.parametrize(
    ("published", "transcribed"),
    [
        (layout.Changing, words.CYCLE),
        (layout.Joint, words.JOINT),
        (layout.Counted, words.COUNTERS),
        (layout.Gripper, words.GRIPPER),
        (layout.Result, words.RESULT),
        (layout.Answer, words.ANSWER),
        (layout.Event, words.EVENT),
    ],
)
def test_every_published_word_is_transcribed(published: type[Record], transcribed: tuple[str, ...]) -> None:
    names = published.words.keys() - {"crc", "joints", "padding"}
    assert names == {words.RENAMED.get(name, name) for name in transcribed}


def test_a_word_that_was_renamed_is_found_under_its_new_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(words, "RENAMED", {"outcome": "fate"})
    row = np.array([(7, 3)], [("goal_id", "i8"), ("fate", "i8")])[0]
    assert words._row(row, ("goal_id", "outcome")) == {"goal_id": 7, "outcome": 3}


def test_a_file_holds_every_bit(was: Transcript, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    cycles = len(was.sent)
    for name, values in was.words.items():
        if values.dtype.kind == "f" and random.random() < 0.5:
            was.words[name] = random.integers(-(2**63), 2**63, cycles).view(np.float64)
    was.words[NAME][:6] = (np.nan, np.inf, -np.inf, -0.0, 5e-324, -1.7e308)
    was.words["mode"] = random.integers(-(2**63), 2**63, cycles)
    was.sent[3:6] = b"", b"\x00\r", bytes(range(256))
    was.told[0] = (0, "event", {"kind": 2, "value": float("nan"), "limit": -0.0})
    store.write(tmp_path / "any", was)
    found = store.read(tmp_path / "any")
    assert (found.sent, found.joints, found.place) == (was.sent, was.joints, was.place)
    assert repr(found.told) == repr(was.told)
    assert found.kept.tolist() == was.kept.tolist()
    assert list(found.words) == list(was.words)
    for name, values in was.words.items():
        assert found.words[name].dtype == values.dtype
        assert found.words[name].view(np.int64).tolist() == values.view(np.int64).tolist(), name


def test_a_transcript_depends_on_neither_process_nor_order_nor_hashes(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    names = ["cancel", "hostile-memory-1"]
    assert main(["--record", *names, "--data", str(here)]) == 0
    program = (
        "import sys; from transcripts.__main__ import main\n"
        f"for name in {names[::-1]}: assert main(['--record', name, '--data', sys.argv[1]]) == 0"
    )
    path = f"{ROOT}{os.pathsep}{ROOT / 'tests'}"
    environment = {**os.environ, "PYTHONHASHSEED": "1234", "PYTHONPATH": path}
    subprocess.run([sys.executable, "-c", program, str(there)], cwd=ROOT, env=environment, check=True)
    for name in names:
        assert (here / f"{name}{store.SUFFIX}").read_bytes() == (there / f"{name}{store.SUFFIX}").read_bytes()


# --- differences in words --------------------------------------------------------------------------------------


def test_what_is_the_same_is_the_same(was: Transcript, now: Transcript) -> None:
    assert compare("goal-small", was, now) == Finding("goal-small", Verdict.SAME)


def test_one_bit_of_a_float_is_found_and_named(was: Transcript, now: Transcript) -> None:
    nudge(now, NAME, CYCLE)
    old, new = was.words[NAME][CYCLE], now.words[NAME][CYCLE]
    assert difference(was, now) == (
        f"goal-small, cycle {CYCLE} (0.500 s): joint2's commanded_position_rad was {float(old)!r}, is {float(new)!r}"
    )


def test_a_whole_number_is_named_by_its_meaning(was: Transcript, now: Transcript) -> None:
    cycle = int(np.flatnonzero(was.words["mode"] == Mode.EXECUTING)[0])
    now.words["mode"][cycle:] = Mode.STOPPING
    nudge(now, NAME, cycle + 3)
    assert f"cycle {cycle} " in (sentence := difference(was, now))
    assert "mode was EXECUTING (3), is STOPPING (4)" in sentence


def test_one_byte_is_found_in_its_frame(was: Transcript, now: Transcript) -> None:
    now.sent[CYCLE] = was.sent[CYCLE].replace(b"T0000020021", b"T0000020022").replace(b"T0000020023", b"T000002002A", 1)
    assert now.sent[CYCLE] != was.sent[CYCLE]
    assert "to 0x200, was 36 6b, is a6 6b" in difference(was, now)


@pytest.mark.parametrize("at", [0, 100, -1])
def test_no_byte_is_overlooked(was: Transcript, now: Transcript, at: int) -> None:
    changed = bytearray(was.sent[-1])
    changed[at] ^= 1
    now.sent[-1] = bytes(changed)
    assert f"cycle {len(was.sent) - 1} " in difference(was, now)


def test_frames_in_another_order_and_frames_that_are_gone_are_told(was: Transcript, now: Transcript) -> None:
    *lines, rest = was.sent[CYCLE].split(b"\r")
    now.sent[CYCLE] = b"\r".join([lines[1], lines[0], *lines[2:], rest])
    assert "the frames are sent in another order" in difference(was, now)
    now.sent[CYCLE] = b"\r".join([*lines[:-1], rest])
    assert f"frame {len(lines)}, 0x" in (sentence := difference(was, now)) and sentence.endswith("is missing")


def test_bytes_that_no_wire_carries_are_shown_as_such(was: Transcript, now: Transcript) -> None:
    now.sent[CYCLE] = was.sent[CYCLE][:3] + b"\xee" + was.sent[CYCLE][4:]
    assert "the bytes sent from byte 3 on were 30 " in difference(was, now)


def test_an_event_that_is_another_one_is_new_or_is_gone(was: Transcript, now: Transcript) -> None:
    cycle, table, row = was.told[1]
    now.told[1] = (cycle, table, {**row, "code": Mode.FREE})
    assert "of the event {" in (sentence := difference(was, now))
    assert "code was HOLDING (2), is FREE (7)" in sentence
    now.told = [*was.told[:1], *was.told[2:]]
    assert f"cycle {cycle} " in (sentence := difference(was, now)) and "is missing" in sentence
    now.told = [*was.told[:2], was.told[1], *was.told[2:]]
    assert "is new" in difference(was, now)


def test_a_scenario_that_is_shorter_or_breaks_off_says_so(was: Transcript, now: Transcript) -> None:
    del now.sent[CYCLE:]
    now.words = {name: values[:CYCLE] for name, values in was.words.items()}
    now.told = [entry for entry in was.told if entry[0] < CYCLE]
    assert f"took {len(was.sent)} cycles, takes {CYCLE}" in difference(was, now)
    now.broke_off = "AssertionError: not within 30.0 virtual seconds"
    assert f"cycle {CYCLE} " in (sentence := difference(was, now)) and "broke off: AssertionError" in sentence


def test_a_word_that_is_no_more_is_told(was: Transcript, now: Transcript) -> None:
    del now.words[NAME]
    assert "there is no joint2's commanded_position_rad any more" in difference(was, now)


def test_fast_words_are_kept_where_anything_is_told_or_another_word_changes(was: Transcript) -> None:
    was.told.append((CYCLE, "event", {"kind": 5}))
    thin = was.thinned(24)
    assert CYCLE in thin.kept and CYCLE - 1 not in thin.kept
    assert len(thin.kept) < len(was.sent) / 2
    settles = np.flatnonzero(np.diff(was.words["goal_phase"]) != 0) + 1
    assert {0, 24, *settles.tolist(), *(cycle for cycle, *_ in was.told)} <= set(thin.kept.tolist())
    assert len(thin.words[NAME]) == len(thin.kept) and len(thin.words["mode"]) == len(was.sent)


def test_a_difference_between_kept_cycles_shows_in_the_next_one(was: Transcript, now: Transcript) -> None:
    thin = was.thinned(24)
    cycle = next(int(b) for a, b in zip(thin.kept, thin.kept[1:], strict=False) if b - a > 2)
    for late in range(cycle - 1, len(was.sent)):
        nudge(now, NAME, late)
    assert f"cycle {cycle} " in (sentence := difference(thin, now)) and "and the same there)" in sentence


# --- elsewhere -------------------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(now: Transcript) -> Transcript:
    """The same on another processor."""
    now.place = {**now.place, "processor": "another"}
    return now


def test_elsewhere_floats_may_be_rounded_differently(was: Transcript, elsewhere: Transcript) -> None:
    nudge(elsewhere, NAME, CYCLE, ulps=3)
    assert compare("goal-small", was, elsewhere).verdict == Verdict.SAME
    elsewhere.words[NAME][CYCLE] += 1e-6
    assert "joint2's commanded_position_rad" in difference(was, elsewhere)


def test_elsewhere_what_may_follow_from_rounding_is_unsure_and_what_comes_before_it_is_not(
    was: Transcript, elsewhere: Transcript
) -> None:
    nudge(elsewhere, NAME, CYCLE)
    elsewhere.sent[CYCLE + 2] = b""
    finding = compare("goal-small", was, elsewhere)
    assert finding.verdict == Verdict.UNSURE
    assert "it may come of rounding" in finding.sentence and "here another" in finding.sentence
    elsewhere.sent[CYCLE - 2] = b""
    assert f"cycle {CYCLE - 2} " in difference(was, elsewhere)


def test_elsewhere_no_float_may_differ_where_that_is_asked_for(was: Transcript, elsewhere: Transcript) -> None:
    assert compare("goal-small", was, elsewhere, exact=True).verdict == Verdict.SAME
    nudge(elsewhere, NAME, CYCLE)
    assert compare("goal-small", was, elsewhere, exact=True).verdict == Verdict.DIFFERS


# --- the command -----------------------------------------------------------------------------------------------


def test_scenarios_without_recording_and_recordings_without_scenario_fail(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["family-mock", "--data", str(tmp_path)]) == 1
    assert "family-mock has no recording: record it with --record family-mock" in capsys.readouterr().out
    (tmp_path / f"forgotten{store.SUFFIX}").write_bytes(b"")
    assert main(["forgotten", "--data", str(tmp_path)]) == 1
    assert "belongs to no scenario: remove it" in capsys.readouterr().out
    assert main(["nonsense"]) == 2


def test_it_records_and_compares(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--record", "family-mock", "--data", str(tmp_path)]) == 0
    assert main(["family-m*k", "--data", str(tmp_path)]) == 0
    assert "1 scenarios in" in (said := capsys.readouterr().out) and "1 the same, 0 differ, 0 unsure" in said


def test_a_scenario_that_breaks_off_is_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails() -> None:
        SCENARIOS["family-mock"].play()
        raise AssertionError("it does not work")

    monkeypatch.setitem(run.SCENARIOS, "broken", Scenario(fails))
    assert main(["--record", "broken", "--data", str(tmp_path)]) == 1
    assert "broke off after" in (said := capsys.readouterr().out) and "it does not work" in said
    assert not list(tmp_path.iterdir())
