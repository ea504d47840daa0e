"""Targets sent with FC (`bus.position_command: FC`): found out to be absolute, led by the drives' own ramps."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from motion_figures import rms, sampled_truth
from true_motion import commanded_until_end, largest_acceleration_ratio, moving, path_error_deg, velocity_ripple
from virtual import VirtualArm, recorded_goal

from config.loader import load_arm
from rtloop.drives import zdt_fast_targets, zdt_protocol
from shm.words import Fault, Mode, Outcome
from sim.bus import Frame
from sim.faults import PowerLoss

FC = {"bus": {"position_command": "FC"}}
FAST = load_arm("episode1", overrides=FC)
BOTH = {"bus": {"position_command": "FC", "positions": "reported"}, "control": {"rate_hz": 200.0}}
INTERRUPTED = ("large", "scale_1_0", "near_limits_high", "around_box", "small")

trials = settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
moments = st.tuples(st.sampled_from(INTERRUPTED), st.floats(0.05, 0.95))


def fast_arm(overrides: dict[str, Any] = FC, *, up: bool = True, **options: Any) -> VirtualArm:
    arm = VirtualArm(load_arm("episode1", overrides=overrides), **options)
    if up:
        assert arm.bring_up().failure is None
    return arm


def said(arm: VirtualArm) -> set[bytes]:
    """Length and function of every frame that was sent, as they stand behind its identifier."""
    return {line[9:12] for _, data in arm.sent for line in data.split(b"\r")}


def fast_frames(arm: VirtualArm, address: int, since: int) -> int:
    mark = f"T{address << 8:08X}6FC".encode()
    return sum(data.count(mark) for _, data in arm.sent[since:])


def turned_pulses(arm: VirtualArm, joint: int, since_ns: int) -> float:
    """How far a motor has been from where it stood, in command pulses."""
    _, position_rad, _ = sampled_truth(arm.sim, joint, since_ns, arm.sim.now_ns)
    return float(np.abs(position_rad - position_rad[0]).max()) / arm.arm.joints[joint].command_pulse_rad


# --- finding out what FC means


@pytest.mark.parametrize("stands", ["zero", "anywhere", "counts from here"])
@pytest.mark.parametrize("acknowledge", [False, True])
def test_a_drive_that_takes_fc_as_absolute_is_set_up(stands: str, acknowledge: bool) -> None:
    """Its motor stirs by a tenth of a pulse; speed, ramp and mode are set, as absolute."""
    config = load_arm("episode1", overrides={"bus": FC["bus"] | {"acknowledge": acknowledge}})
    zero = [-joint.zero_rad for joint in config.joints]
    start = {"zero": zero, "anywhere": [0.3, -0.2, 0.5, 0.1, -1.0, 2.0], "counts from here": None}[stands]
    arm = VirtualArm(config, start_rad=start, homed=stands != "counts from here")
    began_ns = arm.now_ns
    assert arm.bring_up().failure is None
    assert arm.loop[0]["axes"]["sent"]["fast_ready"][:6].all()
    for joint, drive in enumerate(arm.sim.drives):
        row = arm.loop[0]["joints"][joint]
        assert drive._fast == (math.ceil(1.05 * config.joints[joint].motor_rpm), int(row["acc_byte"]), 1)
        assert turned_pulses(arm, joint, began_ns) < 0.1
        assert abs(arm.sim.truth(joint, np.array([began_ns, arm.sim.now_ns - 1]))[0] @ [-1, 1]) < 1e-9
    arm.close()


@pytest.mark.parametrize("start", [[0.0] * 6, None, [0.3, -0.2, 0.5, 0.1, -1.0, 2.0]])
def test_a_drive_that_takes_fc_for_amounts_is_refused_and_does_not_move(start: list[float] | None) -> None:
    """All its pulses are added up, twice; it is stopped a millisecond later, at 1 rpm."""
    zero = [-joint.zero_rad for joint in load_arm("episode1").joints]
    arm = fast_arm(up=False, start_rad=zero if start is None else start)
    for drive in arm.sim.drives:
        drive.fast_is_relative = True
    began_ns = arm.now_ns
    failure = arm.bring_up().failure
    assert failure is not None
    assert "takes the targets of FC for amounts to go" in str(failure)
    assert "set bus.position_command to FD" in str(failure)
    arm.cycles(200)
    for joint in range(6):
        assert turned_pulses(arm, joint, began_ns) < 0.5
    assert not arm.loop[0]["axes"]["sent"]["fast_ready"][:6].any()
    arm.close()


def test_a_drive_that_says_absolute_and_goes_elsewhere_is_stopped() -> None:
    """Its register for the target tells what it was told, not where it goes."""
    arm = fast_arm(up=False, start_rad=[0.5] * 6)
    drive = arm.sim.drives[1]
    drive.fast_is_relative = True
    before = drive._reads[0x33]

    def what_it_was_told() -> bytes:
        if drive._fast is None or not arm.sent:
            return before()
        pulses = zdt_fast_targets.beside(round((0.5 + drive_zero) * per_rad))
        return drive._signed(0x33, round(pulses * 20.48), 4)

    config = arm.arm.joints[1]
    drive_zero, per_rad = config.zero_rad, config.command_pulses_per_rad
    drive._reads[0x33] = what_it_was_told
    began_ns = arm.now_ns
    failure = arm.bring_up().failure
    assert failure is not None
    assert failure.joint == 1
    assert "does not go where FC tells it" in str(failure)
    arm.cycles(100)
    stood_ns = arm.sim.now_ns
    arm.cycles(100)
    assert turned_pulses(arm, 1, stood_ns - 10**8) == 0.0
    assert turned_pulses(arm, 1, began_ns) * 1.8 / 16 < 6.0  # degrees of the motor: a second at 1 rpm
    arm.close()


def test_firmware_without_fc_is_refused() -> None:
    arm = fast_arm(up=False, firmware="old")
    failure = arm.bring_up().failure
    assert failure is not None
    assert "has firmware 1.2.5, but bus.position_command: FC needs 2.0.0 or newer" in str(failure)
    assert b"6FC" not in said(arm)
    arm.close()


def test_one_drive_that_does_not_know_fc_is_named() -> None:
    arm = fast_arm(up=False)
    del arm.sim.drives[4]._commands[0xF1], arm.sim.drives[4]._commands[0xFC]
    failure = arm.bring_up().failure
    assert failure is not None
    assert failure.joint == 4
    assert "The drive of joint5 (firmware 2.0.0) does not go where FC tells it" in str(failure)
    arm.close()


def test_nobody_who_did_not_ask_for_it_gets_fc() -> None:
    arm = VirtualArm.brought_up()
    goal = arm.play("small")
    arm.end_of(goal)
    assert said(arm) & {b"6FC", b"7F1"} == set()
    assert b"8FD" in said(arm)
    arm.close()


# --- motion


@pytest.mark.parametrize(("name", "overrides"), [("large", FC), ("near_limits_high", FC), ("scale_1_0", BOTH)])
def test_recorded_goals_run_true(name: str, overrides: dict[str, Any]) -> None:
    """Path error as with FD; a joint may use its drive's ramp, 1.75 times its limit, where it all but stands."""
    goal = recorded_goal(name)
    arm = fast_arm(overrides, start_rad=goal["joints"][0, :, 0])
    started_ns = arm.now_ns
    since = len(arm.sent)
    goal_id = arm.play(name)
    commanded = commanded_until_end(arm, goal_id)
    assert arm.outcome(goal_id) == Outcome.SUCCEEDED
    assert (arm.now_ns - started_ns) * 1e-9 < goal["times_ns"][-1] * 1e-9 + 0.1
    arm.cycles(40)
    assert fast_frames(arm, 1, since) > 100
    assert b"8FD" not in said(arm)
    assert largest_acceleration_ratio(arm, started_ns) <= 1.8
    for joint, config in enumerate(arm.arm.joints):
        _, _, velocity_rad_s = sampled_truth(arm.sim, joint, started_ns, commanded[0][-1])
        one_rpm = 2 * math.pi / 60 / config.ratio
        assert np.abs(velocity_rad_s).max() <= 1.06 * config.max_velocity_rad_s + one_rpm
        if joint < 3:
            assert path_error_deg(arm, joint, *commanded) <= 0.02
        end_rad = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
        assert abs(end_rad - goal["joints"][-1, joint, 0]) <= config.slack_rad
    arm.close()


@pytest.mark.parametrize(
    ("joint", "motor_rpm", "bound"), [(0, 100.0, 0.02), (1, 60.0, 0.02), (0, 10.0, 0.13), (2, 10.0, 0.13)]
)
def test_velocity_ripple_at_constant_speed(joint: int, motor_rpm: float, bound: float) -> None:
    """The drive speeds up and brakes in every cycle, by its ramp: ±1.7 rpm about the planned speed of joint1."""
    arm = fast_arm()
    speed_rad_s = motor_rpm * 2 * math.pi / 60 / arm.arm.joints[joint].ratio
    assert velocity_ripple(arm, joint, -speed_rad_s, 2.0, 0.6) <= bound
    arm.close()


def test_a_shaft_behind_its_ramp_is_led_further_ahead() -> None:
    """The measured error moves the targets, slowly, until the shaft and not the ramp is where it should be."""
    goal = recorded_goal("large")
    arm = fast_arm(start_rad=goal["joints"][0, :, 0], lag_s=0.01)
    arm.play("large")
    behind_rad = []
    for _ in range(300):
        arm.cycle()
        behind_rad.append(
            float(
                arm.loop[0]["axes"]["tracking"]["reference_rad"][0] - arm.loop[0]["axes"]["measured"]["position_rad"][0]
            )
        )
    lag_rad = 0.01 * arm.arm.joints[0].max_velocity_rad_s
    assert rms(np.array(behind_rad[120:240])) < 0.6 * lag_rad
    arm.close()


@trials
@given(moments)
def test_silence_is_a_controlled_stop(moment: tuple[str, float]) -> None:
    arm, _, started_ns = moving(*moment, FAST)
    arm.sim.run_until(arm.now_ns + 2_000_000_000)
    assert largest_acceleration_ratio(arm, started_ns) <= 2.2
    for joint in range(6):
        assert arm.sim.true_velocity_rad_s(joint, arm.sim.now_ns - 1) == 0.0
    arm.close()


@trials
@given(moments, st.integers(3, 120))
def test_pause_resume_and_cancel_never_step(moment: tuple[str, float], pause: int) -> None:
    arm, goal_id, started_ns = moving(*moment, FAST)
    arm.writer.hold()
    arm.cycles(pause)
    arm.writer.resume()
    arm.cycles(pause)
    arm.writer.cancel(goal_id)
    arm.end_of(goal_id)
    arm.cycles(40)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert largest_acceleration_ratio(arm, started_ns) <= 2.0
    arm.close()


@trials
@given(moments, st.integers(13, 400))
def test_a_long_gap_ends_the_goal_where_the_drives_stopped(moment: tuple[str, float], periods: int) -> None:
    arm, _, started_ns = moving(*moment, FAST)
    arm.cycle(periods)
    arm.cycles(123)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert largest_acceleration_ratio(arm, started_ns) <= 2.2
    arm.close()


# --- a drive that has forgotten what F1 said


@pytest.mark.parametrize("overrides", [FC, BOTH])
def test_a_drive_that_lost_power_gets_no_fc_before_it_is_set_up_again(overrides: dict[str, Any]) -> None:
    goal = recorded_goal("large")
    arm = fast_arm(overrides, start_rad=goal["joints"][0, :, 0])
    arm.play("large")
    arm.cycles(120)
    arm.sim.inject(PowerLoss("joint2", at_s=0.0, off_s=0.02), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert arm.memory["fault"]["joint"] == 1
    assert arm.loop[0]["axes"][1]["sent"]["fast_ready"] == 0
    since = len(arm.sent)
    arm.cycles(200)
    assert fast_frames(arm, 2, since) == 0
    assert arm.clear_fault().failure is None
    assert arm.loop[0]["axes"][1]["sent"]["fast_ready"] == 1
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0
    arm.close()


def test_a_drive_that_is_on_its_way_is_stopped_before_it_is_asked() -> None:
    """A predecessor was killed in mid-motion."""
    arm = fast_arm(up=False, start_rad=[0.2] * 6)
    for number, drive in enumerate(arm.sim.drives):
        for message in (zdt_protocol.fast_setup(30, 200), zdt_protocol.fast_target(drive._pulses() + 3000)):
            drive.receive(arm.sim.now_ns, Frame((number + 1) << 8, message))
    assert arm.bring_up().failure is None
    assert arm.end_of(arm.send_shift(0.0, 1.0)) == Outcome.SUCCEEDED
    arm.close()
