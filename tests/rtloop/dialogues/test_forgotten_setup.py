"""What a drive has forgotten with its power while its joint meant no angle: reports, and what FC means."""

import math
from typing import Any

import pytest
from test_referencing import JOINT2, after_power_loss, new_arm, true_rad
from virtual import VirtualArm

from shm.words import Answer, Mode, Outcome, Request
from sim.faults import PowerLoss

FC = {"bus": {"position_command": "FC"}}
REPORTED = {"bus": {"positions": "reported"}}
BOTH = {"bus": {"position_command": "FC", "positions": "reported"}}


def switched_off_again(overrides: dict[str, Any]) -> VirtualArm:
    """Joint 2 has no reference, and its drive has been off once more since; nobody can have noticed."""
    arm = new_arm(overrides=overrides)
    after_power_loss(arm)
    arm.sim.inject(PowerLoss("joint2", 0.0, off_s=1.0), since_ns=arm.now_ns)
    arm.cycles(240)
    assert arm.memory["mode"] == Mode.HOLDING
    assert arm.sim.drives[1]._fast is None
    return arm


@pytest.mark.parametrize("overrides", [FC, REPORTED, BOTH])
@pytest.mark.parametrize("way", [Request.HOME, Request.REFERENCE])
def test_a_drive_is_set_up_anew_before_it_is_led(overrides: dict[str, Any], way: Request) -> None:
    arm = switched_off_again(overrides)
    value = math.nan if way == Request.HOME else true_rad(arm, 1)
    assert arm.ask(way, joint_mask=JOINT2, value=value) == Answer.DONE
    assert arm.reference().failure is None
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 1
    if overrides is not REPORTED:
        assert arm.sim.drives[1]._fast is not None
        assert arm.sim.drives[1]._fast[2] == 1
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    arm.close()


def test_a_drive_that_has_become_another_is_not_led() -> None:
    """It was exchanged, say: after F1 with the mode of absolute targets it takes amounts."""
    arm = switched_off_again(FC)
    arm.sim.drives[1].fast_is_relative = True
    since = len(arm.sent)
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=true_rad(arm, 1) + 0.5) == Answer.DONE
    stood_rad = true_rad(arm, 1)
    failure = arm.reference().failure
    assert failure is not None
    assert failure.joint == 1
    assert "set bus.position_command to FD" in str(failure)
    assert arm.loop[0]["axes"][1]["sent"]["fast_ready"] == 0
    told = sum(data.count(b"T000002006FC") for _, data in arm.sent[since:])
    arm.cycles(100)
    assert sum(data.count(b"T000002006FC") for _, data in arm.sent[since:]) == told <= 3
    assert abs(true_rad(arm, 1) - stood_rad) < arm.arm.joints[1].command_pulse_rad
    arm.close()


@pytest.mark.parametrize("overrides", [FC, BOTH])
@pytest.mark.parametrize("after_cycles", [2, 8, 20, 40, 60])
def test_a_joint_whose_turn_is_ended_is_led_on(overrides: dict[str, Any], after_cycles: int) -> None:
    arm = new_arm(overrides=overrides)
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.nan) == Answer.DONE
    cycles = []

    def stop() -> None:
        cycles.append(arm.now_ns)
        if len(cycles) == after_cycles:
            arm.writer.stop()

    assert arm.reference(each_cycle=stop, at_most_s=5.0).failure is None
    arm.resume()
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    arm.close()
