"""What ends a test with real processes: its own fault at once, the machine's after two more tries."""

from collections.abc import Callable
from pathlib import Path

import pytest
from machine_witness import Stalls

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.process

QUIET, STALLED = Stalls(0.0, 0.0), Stalls(0.12, 0.0)


BESIDE = """
import verdicts
from machine_witness import Stalls

class Said:
    def __init__(self, marker):
        pass

    def since(self, start_ns):
        return {stalls!r}

    def close(self):
        pass

verdicts.Witness = Said

def pytest_configure(config):
    config.pluginmanager.register(verdicts)
"""
"""A witness of whom is known what it says."""


@pytest.fixture
def ran(pytester: pytest.Pytester) -> Callable[[str, Stalls], pytest.RunResult]:
    """Runs a file of tests beside such a witness."""

    def run(text: str, stalls: Stalls) -> pytest.RunResult:
        pytester.makeini(f"[pytest]\nmarkers = process\npythonpath = {Path(__file__).parent}")
        pytester.makeconftest(BESIDE.format(stalls=stalls))
        pytester.makepyfile(f"import pytest\n\nTRIES = []\npytestmark = pytest.mark.process\n{text}")
        return pytester.runpytest_subprocess()

    return run


FAILS_TWICE = """
@pytest.fixture(scope="module")
def shared():
    TRIES.append("made")
    yield
    TRIES.append("ended")

def test_it(shared):
    TRIES.append("tried")
    assert TRIES.count("tried") == 3, "not yet"

def test_next(shared):
    assert TRIES == ["made", "tried", "ended"] * 2 + ["made", "tried"]
"""
NEVER = """
def test_it():
    TRIES.append(1)
    assert len(TRIES) == 0
"""
VIOLATION = """
class Violation(AssertionError):
    pass

def test_it():
    TRIES.append(1)
    if len(TRIES) == 1:
        raise Violation("joint1 was faster than its limit")
"""


def test_a_failure_during_a_stall_is_tried_again_from_fresh_fixtures_and_counted(
    ran: Callable[[str, Stalls], pytest.RunResult],
) -> None:
    result = ran(FAILS_TWICE, STALLED)
    assert result.parseoutcomes() == {"passed": 2, "inconclusive": 2}
    result.stdout.fnmatch_lines(["*2 inconclusive: the machine stood still*", "*test_it (call): woke up 120 ms late*"])


def test_a_failure_without_a_stall_is_final_and_leaves_no_fixture_to_the_next(
    ran: Callable[[str, Stalls], pytest.RunResult],
) -> None:
    result = ran(FAILS_TWICE.replace('* 2 + ["made", "tried"]', '+ ["made"]'), QUIET)
    assert result.parseoutcomes() == {"passed": 1, "failed": 1}


def test_what_always_fails_fails_after_the_third_time(ran: Callable[[str, Stalls], pytest.RunResult]) -> None:
    result = ran(NEVER, STALLED)
    assert result.parseoutcomes() == {"inconclusive": 2, "failed": 1}
    result.stdout.fnmatch_lines(["*the machine meanwhile*", "woke up 120 ms late*"])


def test_what_the_observer_finds_is_final(ran: Callable[[str, Stalls], pytest.RunResult]) -> None:
    assert ran(VIOLATION, STALLED).parseoutcomes() == {"failed": 1}


def test_virtual_time_is_never_tried_again(ran: Callable[[str, Stalls], pytest.RunResult]) -> None:
    assert ran(NEVER.replace("def test_it", "pytestmark = []\n\ndef test_it"), STALLED).parseoutcomes() == {"failed": 1}


VIOLATION_AND_MORE = """
class Violation(AssertionError):
    pass

@pytest.fixture
def ends_badly():
    yield
    assert TRIES == [], "left behind"

def test_it(ends_badly):
    TRIES.append(1)
    try:
        raise Violation("joint1 was faster than its limit")
    finally:
        assert len(TRIES) > 1, "and could not be closed"
"""
VIOLATION_AT_ITS_END = """
class Violation(AssertionError):
    pass

@pytest.fixture(SCOPE)
def arm():
    TRIES.append("made")
    yield
    if TRIES == ["made"]:
        raise Violation("joint1 was outside its limits")

@pytest.fixture
def ends_badly(arm):
    yield
    assert TRIES != ["made"], "left behind"

def test_it(arm, ends_badly):
    assert len(TRIES) > 1, "the goal was ended by silence"

def test_next():
    pass
"""
FAILS_AT_ITS_END = """
@pytest.fixture(scope="module")
def shared():
    TRIES.append("made")

@pytest.fixture
def ends_badly(shared):
    yield
    assert TRIES.count("made") == 3, "not yet"

def test_it(ends_badly):
    pass
"""


def test_what_the_observer_finds_is_final_whatever_fails_beside_it(
    ran: Callable[[str, Stalls], pytest.RunResult],
) -> None:
    assert ran(VIOLATION_AND_MORE, STALLED).parseoutcomes() == {"failed": 1, "errors": 1}


@pytest.mark.parametrize("scope", ["function", "module"])
def test_what_the_observer_finds_as_an_arm_ends_is_final_though_a_stall_had_failed_the_test(
    ran: Callable[[str, Stalls], pytest.RunResult], scope: str
) -> None:
    result = ran(VIOLATION_AT_ITS_END.replace("SCOPE", f"scope={scope!r}"), STALLED)
    assert result.parseoutcomes() == {"failed": 1, "errors": 1, "passed": 1}


def test_what_fails_at_its_end_gets_fresh_fixtures_too(ran: Callable[[str, Stalls], pytest.RunResult]) -> None:
    assert ran(FAILS_AT_ITS_END, STALLED).parseoutcomes() == {"passed": 1, "inconclusive": 2}


def test_what_is_left_behind_and_what_hangs_is_final(ran: Callable[[str, Stalls], pytest.RunResult]) -> None:
    left = """
class Left(AssertionError):
    pass

def test_it():
    TRIES.append(1)
    if len(TRIES) == 1:
        raise Left("a process")
"""
    assert ran(left, STALLED).parseoutcomes() == {"failed": 1}
    hangs = """
import time

@pytest.mark.timeout(1)
def test_it():
    TRIES.append(1)
    while len(TRIES) == 1:
        time.sleep(0.01)
"""
    assert ran(hangs, STALLED).parseoutcomes() == {"failed": 1}
