"""Scanning and settings on a real CAN interface: raw frames, who listens, and a control process that only asks."""

import json
from contextlib import closing

import pytest
from stack import Stack, run_rtarm
from vcan_arm import JOINTS, start_on_vcan

from rtarm.doctor.machine import Machine
from rtarm.scan import adapters
from rtarm.scan.search import search_link
from rtarm.scan.wires import CanWire


@pytest.fixture
def drives_on_vcan(arm_name, tmp_path):
    stack = Stack(arm_name, tmp_path)
    start_on_vcan(stack)
    yield stack
    stack.close()


def test_drives_on_an_interface_are_found(drives_on_vcan):
    with closing(CanWire("vcan0")) as wire:
        outcome = search_link(wire, None)
    assert [drive.address for drive in outcome.drives] == list(range(1, JOINTS + 1))
    assert {drive.firmware for drive in outcome.drives} == {"2.0.0"}


def test_an_interface_on_which_a_program_listens_is_left_alone(drives_on_vcan):
    """What Linux says of its listeners is read as it really is; the listener here is the simulated arm itself."""
    assert "Another program listens" in str(adapters.link(Machine(), "vcan0").not_tried)
    drives_on_vcan.sim.close()
    assert adapters.link(Machine(), "vcan0").not_tried is None


def test_settings_are_read_over_an_interface(drives_on_vcan):
    done = run_rtarm("drives", str(drives_on_vcan.arm_file), "--json")
    report = json.loads(done.stdout)
    assert [drive["firmware"] for drive in report["drives"]] == ["2.0.0"] * JOINTS, done.stdout
