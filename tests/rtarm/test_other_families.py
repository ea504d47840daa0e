"""Tools on arms whose drives are not ZDT's, or not all of them: each works on what it knows and says what it leaves."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mixed_arm import mixed
from rich.console import Console
from typer.testing import Result
from virtual import VirtualArm

from config.check import render_check
from config.derived import derived_table
from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.calibrate.run import chosen_joints
from rtarm.drives.settings import render
from rtarm.recording.mcap_format import Reason
from rtarm.recording.story import tell
from rtarm.running.status import of_cycle
from rtloop.drives.power import Marks
from rtloop.offline import families
from rtloop.offline.calibration.session import Session as Calibration
from rtloop.offline.settings.compare import as_json
from rtloop.offline.settings.session import Session
from rtloop.process.initial_state import show_drives
from shm import layout
from shm.recording import read_recording
from shm.words import Fault
from sim.faults import Protection

Rtarm = Callable[..., Result]


def shown(what: Any) -> str:
    """What rich prints of it, lines joined."""
    out = io.StringIO()
    Console(file=out, width=200).print(what)
    return out.getvalue()


def resting() -> VirtualArm:
    """ZDT drives (joints 1, 3, 5) and ODrives on one bus, that nobody has brought up."""
    arm = VirtualArm(mixed())
    arm.front_alive = False
    arm.cycles(3)
    return arm


def test_settings_of_a_mixed_arm_are_a_table_for_each_family() -> None:
    arm = resting()
    session = Session(arm.arm, arm.port, lambda: arm.now_ns, arm.cycle)
    session.read()
    assert all(report.answers and report.agrees for report in session.reports.values())
    text = shown(render(arm.arm, {"drives": [as_json(report) for report in session.reports.values()]}))
    assert "mixed: 6 drives" in text
    headings = [re.findall(r"joint\d", line) for line in text.splitlines() if line.lstrip().startswith("joint")]
    assert headings == [["joint1", "joint3", "joint5"], ["joint2", "joint4", "joint6"]]
    assert text.count("The settings of an ODrive can be read over CAN only with") == 1
    assert "- ? stands for what a drive does not report." in text  # hardware of firmware 0.5
    assert text.count("axis_state") == 1 and text.count("current mA") == 1
    assert "Every drive is as the arm file wants it" in text
    arm.close()


def test_drives_of_a_family_without_a_table_are_said_to_be_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = resting()
    monkeypatch.setattr(families, "knows", lambda folder, drive: drive.family == "zdt")
    session = Session(arm.arm, arm.port, lambda: arm.now_ns, arm.cycle)
    session.read()
    text = shown(render(arm.arm, {"drives": [as_json(report) for report in session.reports.values()]}))
    assert "mixed: 3 drives" in text
    assert "- The settings of joint2, joint4, joint6 are neither read nor written: rtarm has no table of them" in text
    arm.close()


def test_an_arm_without_a_family_that_has_a_table_is_refused(rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(families, "knows", lambda folder, drive: False)
    result = rtarm("drives", "odrive6")
    assert result.exit_code == 1 and "odrive6 has no drive whose settings can be read" in result.output


def test_dialogues_of_a_calibration_are_with_the_families_that_have_them() -> None:
    arm = mixed()
    assert chosen_joints(arm, []) == [0, 1, 2, 3, 4, 5] and chosen_joints(arm, ["joint3", "joint2"]) == [1, 2]
    virtual = resting()
    session = Calibration(
        virtual.arm,
        virtual.port,
        clock_ns=lambda: virtual.now_ns,
        pause=virtual.cycle,
        rest=virtual.cycle,
        tell=lambda _: None,
        keep_lost=lambda joint, reason: None,
        marks=Marks(),
    )
    session.read()
    assert {joint: found.problems for joint, found in session.found.items()} == {0: [], 2: [], 4: []}
    virtual.close()


def test_why_a_drive_has_an_error_reaches_people() -> None:
    """An ODrive (joint2) that is too hot: in the fault, in the report of its joint, and in the recording's story."""
    virtual = VirtualArm.brought_up(mixed())
    assert virtual.sim is not None
    virtual.sim.inject(Protection("joint2", 0.0, cause="temperature"), since_ns=virtual.now_ns)
    virtual.until(lambda: virtual.memory["fault"]["code"] != Fault.NONE)
    virtual.cycles(5)
    found = of_cycle(virtual.reader.snapshot(), [joint.name for joint in virtual.arm.joints], virtual.now_ns)
    assert found["fault"]["name"] == "drive_fault"
    assert found["fault"]["sentence"].startswith(
        "The drive of joint2 reports a fault of its own (protected, over-temperature, not enabled): remove the cause"
    )
    assert found["joints"][1]["drive_trouble"] == ["protected", "over-temperature"]
    assert found["joints"][1]["voltage_v"] == pytest.approx(24.0, abs=1.0)
    assert found["joints"][0]["voltage_v"] is None and found["joints"][0]["drive_trouble"] == []
    told = tell(read_recording(virtual.state), Reason("fault", ""))
    assert any(
        line.sentence.startswith("The drive of joint2 reports that it is too hot (24.0 V") for line in told.lines
    )
    virtual.close()


def test_which_joints_home_by_a_run_stands_in_the_state_file() -> None:
    def shown_of(arm: ArmConfig) -> list[int]:
        state = np.zeros((), layout.StateFile.dtype)
        show_drives(state[()], arm)
        homes: list[int] = state["limits"]["joints"]["homes"][:6].tolist()
        return homes

    assert shown_of(mixed()) == [1, 0, 1, 0, 1, 0]
    assert [shown_of(load_arm(name)) for name in ("mks6", "odrive6", "mock")] == [[1] * 6, [0] * 6, [0] * 6]


def test_what_drives_do_in_silence_is_shown_of_steppers_and_followers() -> None:
    arm = mixed()
    stepper, follower, *_ = derived_table(arm)
    assert stepper.silence is not None and stepper.silence.acc_byte is not None
    assert follower.silence is None
    assert "In silence joint2, joint4, joint6: at the last set-point heard" in shown(render_check(arm))


def test_a_ramp_that_is_no_byte_of_a_command_is_shown_too() -> None:
    arm = load_arm("damiao6_pv")
    for joint in derived_table(arm):
        assert joint.acc_byte is None and joint.silence is not None and joint.silence.acc_byte is None
        assert joint.silence.factor == pytest.approx(arm.limits.silence_brake_factor)
        assert joint.silence.deceleration_rad_s2 == joint.silence.factor * joint.max_acceleration_rad_s2
        assert joint.silence.coast_deg > 0.0
    text = shown(render_check(arm))
    assert re.search(r"joint1 +- +- +3\.500 +1\.75", text) and "In silence joint" not in text


@pytest.mark.parametrize("name", ["odrive6", "damiao6", "damiao6_pv", "mks6", "cia402_6", "mock"])
def test_every_arm_is_checked(name: str, rtarm: Rtarm) -> None:
    result = rtarm("config", "check", name)
    assert result.exit_code == 0, result.output
    assert ("In silence" in result.output) == (name not in ("mock", "damiao6_pv", "mks6"))  # ramps of their own
    assert load_arm(name).joints[0].name in result.output
