"""Drives that are enabled again after a person led the arm by hand: nothing may pull it back."""

import math

import numpy as np
import pytest
from observer import truth_of
from virtual import VirtualArm

from config.loader import load_arm
from shm.words import Answer, Mode, Outcome, Request

LED_RAD = 0.3
STIRS_TURNS = 0.005
"""Of the motor: the stop command follows the enabling on the bus by less than a millisecond, at 300 rpm."""


def lead_by_hand(arm, joint, angle_rad):
    """Turn the loose shaft of a drive."""
    drive = arm.sim.drives[joint]
    config = arm.arm.joints[joint]
    drive.advance(arm.sim.now_ns)
    turned = round(config.direction * angle_rad * config.command_pulses_per_rad)
    drive._ramp.place(drive._ramp.position + drive._grains(turned))


@pytest.mark.parametrize("acknowledge", [False, True])
@pytest.mark.parametrize("enabling", ["hold", "pull"])
@pytest.mark.parametrize("kind", [Request.FREE, Request.DISABLE])
def test_an_arm_that_was_led_by_hand_is_held_where_it_is(enabling, kind, acknowledge):
    overrides = {"bus": {"acknowledge": acknowledge}, "control": {"rate_hz": 100.0}}
    arm = VirtualArm.brought_up(load_arm("episode1", overrides=overrides), enabling=enabling)
    assert arm.end_of(arm.send_shift(0.1)) == Outcome.SUCCEEDED
    assert arm.ask(kind) == Answer.DONE
    assert arm.release().failure is None
    for _ in range(60):
        for joint in range(6):
            lead_by_hand(arm, joint, LED_RAD / 60 * (-1) ** joint)
        arm.cycle()
    arm.cycles(10)
    led_rad = np.array([arm.sim.true_position_rad(joint, arm.sim.now_ns) for joint in range(6)])
    assert np.all(np.abs(led_rad - 0.1) > 0.2)
    began_ns = arm.now_ns
    assert arm.ask(Request.ENABLE) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up(clears_protection=True).failure is None
    arm.cycles(60)
    assert arm.memory["mode"] == Mode.HOLDING
    for config, truth in zip(arm.arm.joints, truth_of(arm.sim).values(), strict=True):
        times_ns = np.arange(began_ns, arm.now_ns, 100_000)
        assert np.ptp(truth.position_at(times_ns)) * config.ratio / (2 * math.pi) < STIRS_TURNS
    assert arm.loop[0]["axes"]["reference"]["referenced"][:6].all()
    wanted_rad = arm.loop[0]["axes"]["commanded"]["position_rad"][:6] + 0.02
    assert arm.end_of(arm.send_shift(0.02, 1.0)) == Outcome.SUCCEEDED
    there_rad = [arm.sim.true_position_rad(joint, arm.sim.now_ns) for joint in range(6)]
    assert np.allclose(there_rad, wanted_rad, atol=math.radians(0.2))
    arm.close()


@pytest.mark.parametrize("answer", [b"\x1f\xee", b"\x1f\xe2", b"\x00\xee"], ids=["ee", "e2", "not-understood"])
def test_what_answers_without_a_version_is_not_brought_up(answer):
    arm = VirtualArm()
    arm.sim.drives[2]._reads[0x1F] = lambda: answer
    failure = arm.bring_up().failure
    assert failure.joint == 2
    assert f"answers the question for its firmware with {answer.hex(' ')} 6b, which no ZDT drive" in str(failure)
    assert arm.memory["mode"] == Mode.FAULT
    arm.close()
