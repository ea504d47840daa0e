"""An arm of Damiao motors in virtual time: what the suite of all families (test_drive_conformance) does not ask of it.

Everything is judged by what the simulated shafts truly did and by what was on the simulated bus.
"""

import math
import struct

import numpy as np
import pytest
from motion_figures import accelerations, rms, sampled_truth
from true_motion import commanded_until_end
from virtual import VirtualArm, recorded_goal

from config.loader import load_arm
from shm.words import DriveStatus, Fault, Mode, Outcome
from sim.bus import Frame
from sim.drives.damiao import CTRL_MODE, GR, TIMEOUT, VMAX
from sim.faults import Disabled

MIT, PLANNING = "damiao6", "damiao6_pv"
MODES = pytest.mark.parametrize("name", [MIT, PLANNING])
START_RAD = recorded_goal("large")["joints"][0, :, 0]
EVERYBODY = 0x7FF


def switched_on(name: str) -> VirtualArm:
    """An arm whose motors have just got their power."""
    return VirtualArm(name, start_rad=START_RAD)


def holding(name: str) -> VirtualArm:
    arm = switched_on(name)
    assert arm.bring_up().failure is None, arm.told
    return arm


def stands(arm: VirtualArm, since_ns: int) -> bool:
    """Whether no shaft has moved by more than two steps of its encoder."""
    return all(
        np.ptp(sampled_truth(arm.sim, joint, since_ns, arm.sim.now_ns)[1]) <= 2.0 * config.encoder_count_rad
        for joint, config in enumerate(arm.arm.joints)
    )


def said_to_motors(arm: VirtualArm, since: int = 0) -> list[int]:
    """Identifiers of what has left since then."""
    lines = b"".join(data for _, data in arm.sent[since:]).split(b"\r")
    return [int(line[1:4], 16) for line in lines if line.startswith(b"t")]


@MODES
def test_enabling_leaves_a_motor_where_it_stands_whatever_it_was_told_before(name: str) -> None:
    """Motors that keep what they were told while limp: to go elsewhere, as fast as they can."""
    arm = switched_on(name)
    for joint, drive in enumerate(arm.sim.drives):
        drive.keeps_targets = True
        if name == MIT:
            drive.take(Frame(joint + 1, bytes.fromhex("FFFF7FF3333337FF"), extended=False))
        else:
            drive.registers[CTRL_MODE] = 2
            drive.take(Frame(joint + 0x101, struct.pack("<ff", 12.0, 10.0), extended=False))
    began_ns = arm.sim.now_ns
    assert arm.bring_up().failure is None, arm.told
    arm.cycles(40)
    assert stands(arm, began_ns)
    assert all(drive.enabled for drive in arm.sim.drives)
    arm.close()


@MODES
def test_an_arm_that_holds_is_taken_over_as_it_is(name: str) -> None:
    """Another start while the motors are enabled: nothing is enabled again, moves, or is said to people."""
    arm = holding(name)
    arm.cycles(20)
    began_ns, sent, told = arm.sim.now_ns, len(arm.sent), list(arm.told)
    assert arm.bring_up().failure is None
    assert stands(arm, began_ns)
    assert b"FFFFFFFFFFFFFF" not in b"".join(data for _, data in arm.sent[sent:])
    assert arm.told == told
    arm.close()


@MODES
@pytest.mark.parametrize("away_rad", [-20.0, 20.0])
def test_a_motor_beyond_what_its_frames_reach_is_left_alone(name: str, away_rad: float) -> None:
    """It says the end of its field, and would go there if it were told to stay at what it says."""
    arm = VirtualArm(name, start_rad=START_RAD, faults=[Disabled("joint3", 0.0)])
    arm.sim.drives[2].origin -= away_rad / (2.0 * math.pi)
    began_ns = arm.sim.now_ns
    failure = arm.bring_up().failure
    assert failure is not None and "joint3 stands at or beyond an end" in str(failure)
    arm.cycles(20)
    assert stands(arm, began_ns) and not arm.sim.drives[2].enabled
    arm.close()


@MODES
def test_an_alarm_time_is_taken_away_and_said_before_it_can_let_go(name: str) -> None:
    """Half a second without commands: the arm holds all the same, for as long as nobody moves it."""
    arm = switched_on(name)
    for drive in arm.sim.drives:
        drive.registers[TIMEOUT] = 10_000
    assert arm.bring_up().failure is None, arm.told
    assert sum("alarm time from 500 ms to none" in sentence for sentence in arm.told) == 6
    arm.cycles(int(2e9 / arm.period_ns))
    assert arm.memory["mode"] == Mode.HOLDING
    assert set(said_to_motors(arm, len(arm.sent) - 100)) == {EVERYBODY}  # nothing that the alarm would count
    assert all(drive.enabled for drive in arm.sim.drives)
    arm.close()


@MODES
def test_a_motor_that_is_led_is_not_asked_besides(name: str) -> None:
    arm = holding(name)
    arm.play("large")
    arm.cycles(100)
    sent = len(arm.sent)
    arm.cycles(100)
    offset = 0 if name == MIT else 0x100
    assert said_to_motors(arm, sent) == [number + offset for number in range(1, 7)] * 100
    arm.close()


@pytest.mark.parametrize(
    ("register", "value", "enabled", "sentence"),
    [
        (VMAX, 45.0, False, "velocity range is ±45 rad/s"),
        (CTRL_MODE, 2, True, "is enabled in mode 2"),
    ],
)
def test_a_motor_that_is_not_what_the_file_says_is_left_alone(
    register: int, value: float, enabled: bool, sentence: str
) -> None:
    arm = switched_on(MIT)
    drive = arm.sim.drives[2]
    drive.registers[register] = value
    if enabled:
        drive.take(Frame(0x003, b"\xff" * 7 + b"\xfc", extended=False))
    began_ns = arm.sim.now_ns
    failure = arm.bring_up().failure
    assert failure is not None and sentence in str(failure) and "joint3" in str(failure)
    assert arm.memory["fault"]["code"] == Fault.BRING_UP
    assert (drive.enabled, drive.registers[register]) == (enabled, value)
    assert stands(arm, began_ns)
    arm.close()


@MODES
@pytest.mark.parametrize("motor_id", [0x10, 0x11])
def test_an_id_that_spoils_the_status_brings_up_nothing(name: str, motor_id: int) -> None:
    """An arm file with it is refused; below that a limp motor says 1x, which would be "enabled"."""
    config = load_arm(name)
    joint = config.joints[0]
    joint = joint.model_copy(update={"drive": joint.drive.model_copy(update={"motor_id": motor_id, "master_id": 0x21})})
    arm = VirtualArm(config.model_copy(update={"joints": [joint, *config.joints[1:]]}), start_rad=START_RAD)
    failure = arm.bring_up().failure
    assert failure is not None and f"joint1 (motor_id {motor_id:#x}) does not answer" in str(failure)
    assert arm.memory["fault"]["code"] == Fault.BRING_UP
    assert not arm.sim.drives[0].enabled
    arm.close()


@MODES
def test_a_motor_that_somebody_lets_go_is_a_fault(name: str) -> None:
    arm = holding(name)
    arm.cycles(20)
    arm.sim.inject(Disabled("joint4", 0.0), since_ns=arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.1)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.DRIVE_FAULT, 3)
    assert not arm.loop[0]["axes"][3]["drive"]["status"] & DriveStatus.ENABLED
    assert all(drive.enabled for number, drive in enumerate(arm.sim.drives) if number != 3)
    arm.close()


def test_silence_of_the_host_ends_a_little_behind_the_last_set_point() -> None:
    """Mode mit: the velocity that was told last stays in force, against the stiffness: kd / kp of it further on."""
    arm = holding(MIT)
    arm.play_part("large", 0.4)
    died_ns = arm.sim.now_ns
    speeds = np.abs(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][:6])
    assert speeds.max() > 0.4
    arm.sim.run_until(died_ns + 1_000_000_000)
    for joint, speed in enumerate(speeds):
        times_ns, position_rad, velocity_rad_s = sampled_truth(arm.sim, joint, died_ns, arm.sim.now_ns)
        drive = arm.arm.joints[joint].drive
        coast_rad = speed * (drive.kd / drive.kp + 2.0 * arm.period_ns * 1e-9) + 2e-3
        assert np.abs(position_rad - position_rad[0]).max() <= coast_rad
        assert np.all(np.abs(velocity_rad_s[times_ns > died_ns + 150_000_000]) < 2e-3)
    arm.close()


def with_a_gain(gear: float | None) -> VirtualArm:
    """An arm at the beginning of a goal; its motors have that firmware's law, and a gear or that of their model."""
    arm = VirtualArm.at_start_of("large", PLANNING, planning="gain")
    for drive in arm.sim.drives:
        drive.registers[GR] = gear or drive.registers[GR]
    return arm


def test_motors_whose_speed_is_a_gain_lag_and_arrive() -> None:
    """The figures of docs/hardware/drive-families.md; with the law of the manuals it is 0.03 degrees."""
    arm = with_a_gain(10.0)
    goal = arm.play("large")
    times_ns, commanded_rad = commanded_until_end(arm, goal)
    assert arm.outcome(goal) == Outcome.SUCCEEDED
    for joint in range(6):
        true_ns, position_rad, _ = sampled_truth(arm.sim, joint, times_ns[0], times_ns[-1])
        lag_deg = np.degrees(np.abs(position_rad - np.interp(true_ns, times_ns, commanded_rad[:, joint])).max())
        assert 0.5 < lag_deg < 3.5
    arm.close()


def test_motors_whose_speed_is_a_gain_end_gently_in_silence() -> None:
    """On the last target, which is no further away than their gain makes of their speed."""
    arm = with_a_gain(10.0)
    arm.play_part("large", 0.4)
    died_ns = arm.sim.now_ns
    speeds = np.abs(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][:6])
    arm.sim.run_until(died_ns + 3_000_000_000)
    for joint, config in enumerate(arm.arm.joints):
        times_ns, position_rad, velocity_rad_s = sampled_truth(arm.sim, joint, died_ns, arm.sim.now_ns)
        assert np.abs(position_rad - position_rad[0]).max() <= 1.1 * speeds[joint] * 10.0 / 54.0
        assert np.abs(accelerations(position_rad)).max() <= 2.0 * config.max_acceleration_rad_s2
        assert np.all(np.abs(velocity_rad_s[times_ns > died_ns + 1_500_000_000]) < 2e-3)
    arm.close()


def test_motors_too_slow_for_a_goal_are_stopped_by_the_following_error() -> None:
    """With the gear of a DM4340 the gain is 1.35/s: the arm stops, and stands."""
    arm = with_a_gain(None)
    goal = arm.play("large")
    assert arm.end_of(goal) == Outcome.FAULT
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.FOLLOWING_ERROR, 0)
    arm.cycles(1000)
    assert stands(arm, arm.sim.now_ns - 500_000_000)
    arm.close()


@pytest.mark.parametrize(("name", "ripple"), [(MIT, 0.02), (PLANNING, 0.02)])
def test_slow_motion_is_even_although_positions_are_coarse(name: str, ripple: float) -> None:
    """4.5°/s of joint 2 are one step of the position field a cycle: what it cuts off must not be felt."""
    arm = holding(name)
    joint, speed, lasts_s = 1, 0.0785, 2.0
    sign = -1.0 if START_RAD[joint] > 0.0 else 1.0
    times_s = np.array([0.0, 0.2, 0.2 + lasts_s, 0.4 + lasts_s])
    joints = np.zeros((4, 6, 3))
    joints[:, :, 0] = arm.loop[0]["axes"]["commanded"]["position_rad"][:6]
    joints[:, joint, 0] += sign * speed * np.array([0.0, 0.1, 0.1 + lasts_s, 0.2 + lasts_s])
    joints[1:3, joint, 1] = sign * speed
    began_ns = arm.now_ns
    goal = arm.send_goal((times_s * 1e9).astype(np.int64), joints, order=3)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    steady_ns = began_ns + 700_000_000
    _, _, velocity_rad_s = sampled_truth(arm.sim, joint, steady_ns, steady_ns + 1_400_000_000)
    assert rms(velocity_rad_s - sign * speed) / speed <= ripple
    arm.close()


@MODES
def test_what_is_measured_is_the_joints(name: str) -> None:
    """Velocity and torque of joints in motion, as published, beside those of the simulated shafts."""
    arm = holding(name)
    arm.play_part("large", 0.4)
    joints = arm.reader.snapshot()["joints"][:6]
    for joint, drive in enumerate(arm.sim.drives):
        _, _, true_rad_s = sampled_truth(arm.sim, joint, arm.sim.now_ns - 3 * arm.period_ns, arm.sim.now_ns)
        step_rad_s = 2.0 * drive.ranges.rad_s / 4095
        told_rad_s = joints["measured_velocity_rad_s"][joint]
        assert true_rad_s.min() - 2.0 * step_rad_s <= told_rad_s <= true_rad_s.max() + step_rad_s
        assert joints["measured_effort"][joint] == pytest.approx(drive.shaft.torque_nm, abs=1.0)
    assert np.all(joints["drive_temperature_c"] == 30.0)
    assert math.isnan(joints["drive_voltage_v"][0])
    arm.close()
