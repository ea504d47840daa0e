"""A verdict that does not depend on how fast the machine is (a pytest plugin, for tests marked `process`).

A failure while the machine stood still (`machine_witness`) says nothing about rtarm: it is inconclusive, and the test
is tried again, twice at most, from fresh processes. A failure without a stall is final the first time, and so is what
no stall explains: what the observer of true motion finds (`observer.Violation`), what is left behind (`leaks.Left`),
and a test that hangs. After a failure every fixture is made anew, so that none that tests share carries a fault into
the next.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any

import pytest
from _pytest.runner import call_and_report
from machine_witness import Stalls, Witness

INCONCLUSIVE = "inconclusive"
MEANWHILE = "the machine meanwhile"
REPEATS = 2
MARKER = "RTARM_TEST_SESSION"
"""Set for everything that a session of tests starts."""
FINAL = {"Violation", "Left"}
HANGS = "from pytest-timeout"
FAILED = pytest.StashKey[bool]()
"""Whether something of the test that is tried just now has failed."""
_WITNESS = pytest.StashKey[Witness]()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Have the witness watch before the first test with processes begins."""
    if any(_is_judged(item) for item in session.items):
        session.config.stash[_WITNESS] = Witness(f"{MARKER}={os.environ[MARKER]}")


def pytest_unconfigure(config: pytest.Config) -> None:
    if _WITNESS in config.stash:
        config.stash[_WITNESS].close()


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run one test with real processes, if need be three times; every other is left to pytest."""
    if not _is_judged(item):
        return None
    witness = item.config.stash[_WITNESS]
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for repeats_left in reversed(range(REPEATS + 1)):
        start_ns = time.monotonic_ns()
        reports = list(_run(item, nextitem))
        stalls = witness.since(start_ns)
        failures = [report for report in reports if report.failed]
        if repeats_left == 0 or not failures or not all(is_inconclusive(report, stalls) for report in failures):
            break
        for report in failures:
            report.outcome = INCONCLUSIVE  # type: ignore[assignment]
            report.sections.append((MEANWHILE, str(stalls)))
            item.ihook.pytest_runtest_logreport(report=report)
    for report in reports:
        if report.failed:
            report.sections.append((MEANWHILE, str(stalls)))
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def is_inconclusive(report: pytest.TestReport, stalls: Stalls) -> bool:
    """Whether a failure may be the machine's."""
    is_final = bool(FINAL.intersection(report.raised.split())) or HANGS in str(report.longrepr)
    return report.failed and bool(stalls) and not is_final


def _kinds(problem: BaseException | None) -> set[str]:
    """Names of what was raised, and of all that it was raised together with or in the place of."""
    if problem is None:
        return set()
    beside = (*getattr(problem, "exceptions", ()), problem.__cause__, problem.__context__)
    return {kind.__name__ for kind in type(problem).__mro__}.union(*map(_kinds, beside))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    report = yield
    report.raised = " ".join(sorted(_kinds(call.excinfo and call.excinfo.value)))
    item.stash[FAILED] = report.failed or (call.when != "setup" and item.stash.get(FAILED, False))
    return report


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    return (INCONCLUSIVE, "I", "INCONCLUSIVE") if report.outcome == INCONCLUSIVE else None


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """What was inconclusive, and why: counted, never hidden."""
    found = terminalreporter.getreports(INCONCLUSIVE)
    if found:
        terminalreporter.section(f"{len(found)} inconclusive: the machine stood still, tried again")
    for report in found:
        crash = getattr(report.longrepr, "reprcrash", None)
        why = str(crash.message if crash else report.longrepr).splitlines()
        terminalreporter.write_line(f"{report.nodeid} ({report.when}): {dict(report.sections)[MEANWHILE]}")
        terminalreporter.write_line(f"    {why[0] if why else ''}")


def _is_judged(item: pytest.Item) -> bool:
    return item.get_closest_marker("process") is not None


def _run(item: Any, nextitem: pytest.Item | None) -> Iterator[pytest.TestReport]:
    """Set up, call, tear down, as pytest does, but for what follows a failure: nothing is kept for the next test."""
    if not item._request:
        item._initrequest()
    setup = call_and_report(item, "setup", log=False)
    yield setup
    failed = setup.failed
    if setup.passed:
        call = call_and_report(item, "call", log=False)
        yield call
        failed = call.failed
    teardown = call_and_report(item, "teardown", log=False, nextitem=None if failed else nextitem)
    yield teardown
    if teardown.failed and not failed:  # what the file shares has been kept for the next test
        rest = pytest.CallInfo.from_call(
            lambda: item.session._setupstate.teardown_exact(None),
            "teardown",
            reraise=(pytest.exit.Exception, KeyboardInterrupt),
        )
        if rest.excinfo is not None:
            yield item.ihook.pytest_runtest_makereport(item=item, call=rest)
    item._request = False
    item.funcargs = None
