"""A sample of the bus trials with real processes; `make bus-trials-live` runs each of them."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from bus_faults import FAULTS, spelled
from observer import judge
from trial_run import run_trials

from sim.faults import Silent, parse_fault

SAMPLE = (
    "a drive falls silent",
    "0.1 % of the characters garbled",
    "a node babbles with the highest priority",
    "all drives lose power",
    "a count jumps",
)


@pytest.mark.process
def test_whatever_happens_on_the_bus_the_arm_stops_and_comes_back() -> None:
    code, said = run_trials("live_bus_trials", *(word for name in SAMPLE for word in ("--only", name)))
    print(said)
    judge([line.strip() for line in said.splitlines() if line.strip().startswith("VIOLATION ")])
    assert code == 0, said
    assert "Violations: 0" in said
    assert sum(fault.name in said for fault in FAULTS) == len(SAMPLE)


@pytest.mark.process
def test_a_fault_that_does_not_exist_is_a_sentence() -> None:
    assert run_trials("live_bus_trials", "--only", "full moon") == (
        2,
        "No fault's name contains 'full moon': see FAULTS in tests/bus_faults.py.\n",
    )


def test_faults_are_spelled_as_the_simulated_arm_reads_them() -> None:
    fault = Silent("joint2", 0.5, until_s=1e6)
    assert parse_fault(spelled(fault)) == fault
