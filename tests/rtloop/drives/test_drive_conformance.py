"""What every family of drives must do, by one suite: the real cycle and the real bytes, in virtual time.

A family is one entry in FAMILIES. Everything is judged by what the simulated shafts truly did and by what was on the
simulated bus, never by a variable of the loop.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from motion_figures import accelerations, sampled_truth
from true_motion import commanded_until_end, path_error_deg, velocity_ripple
from virtual import VirtualArm, recorded_goal

from config.budget import budget
from config.loader import load_arm
from rtloop.memory import status as status_bits
from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced
from sim.faults import Disabled, PowerLoss, Protection, Silent

ALL = 0b111111


@dataclass(frozen=True)
class Family:
    """An arm of one family, and how well its drives are led.

    Attributes:
        arm: name of the arm file; its joints are those of episode1, so that the recorded goals fit.
        path_error_deg: of joints 1 to 3, rms, while a recorded goal runs.
        ripple: of the true velocity at the highest speed (rms, a share of it), beside what whole motor rpm make.
        braking: highest true deceleration in silence, as a multiple of the joint's limit; infinite for a follower of
            set-points, which stops where it was told last, as hard as it can.
        measures: what it publishes beside its position.
    """

    arm: str
    path_error_deg: float
    ripple: float
    braking: float
    measures: tuple[str, ...] = ()


EVERYTHING = ("measured_effort", "drive_temperature_c", "drive_voltage_v")

FAMILIES = (
    Family("episode1", path_error_deg=0.02, ripple=0.001, braking=2.2),
    Family(
        "odrive6", path_error_deg=0.02, ripple=0.01, braking=math.inf, measures=("measured_effort", "drive_voltage_v")
    ),
    Family("mks6", path_error_deg=0.02, ripple=0.001, braking=2.2),
    Family(
        "damiao6",
        path_error_deg=0.02,
        ripple=0.01,
        braking=math.inf,
        measures=("measured_effort", "drive_temperature_c"),
    ),
    Family(
        "damiao6_pv",
        path_error_deg=0.02,
        ripple=0.01,
        braking=2.2,
        measures=("measured_effort", "drive_temperature_c"),
    ),
    Family("cia402_6", path_error_deg=0.02, ripple=0.01, braking=math.inf, measures=("measured_effort",)),
    Family("myactuator6", path_error_deg=0.02, ripple=0.025, braking=2.2, measures=EVERYTHING),
    Family("robstride6", path_error_deg=0.03, ripple=0.015, braking=math.inf, measures=EVERYTHING),
    Family("robstride6_position", path_error_deg=0.03, ripple=0.003, braking=math.inf, measures=EVERYTHING),
    Family(
        "vesc6",
        path_error_deg=0.03,
        ripple=0.05,
        braking=math.inf,
        measures=("drive_temperature_c", "drive_voltage_v"),
    ),
)


@pytest.fixture(params=FAMILIES, ids=lambda family: family.arm)
def family(request: pytest.FixtureRequest) -> Family:
    """Each family in turn."""
    return request.param


def stands_since(arm: VirtualArm, start_ns: int) -> bool:
    """Whether no shaft has moved by more than a step of its encoder since then."""
    for joint, config in enumerate(arm.arm.joints):
        _, position_rad, _ = sampled_truth(arm.sim, joint, start_ns, arm.sim.now_ns)
        if np.ptp(position_rad) > config.encoder_count_rad + config.command_pulse_rad:
            return False
    return True


def brought_up(family: Family, *, name: str = "large", **options: object) -> VirtualArm:
    """An arm that holds at the beginning of a recorded goal, all its joints referenced."""
    arm = VirtualArm.at_start_of(name, family.arm, **options)
    reference_what_is_not(arm)
    return arm


def reference_what_is_not(arm: VirtualArm) -> None:
    """A person sees that the joints stand where they read, where a drive does not know it."""
    axes = arm.loop[0]["axes"][: len(arm.arm.joints)]
    unknown = sum(1 << joint for joint, known in enumerate(axes["reference"]["referenced"]) if not known)
    if unknown:
        assert arm.ask(Request.REFERENCE, joint_mask=unknown, value=math.nan) == Answer.DONE
        assert arm.reference().failure is None
    assert np.all(axes["reference"]["referenced"] == 1)


def amid_goal(family: Family, share: float = 0.4, **options: object) -> VirtualArm:
    """An arm somewhere in a recorded goal."""
    arm = brought_up(family, **options)
    arm.play_part("large", share)
    assert np.abs(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][:6]).max() > 0.0
    return arm


def test_bring_up_moves_nothing_and_tells_the_angles(family: Family) -> None:
    start_rad = recorded_goal("large")["joints"][0, :, 0]
    arm = VirtualArm.brought_up(family.arm, start_rad=start_rad)
    assert arm.memory["mode"] == Mode.HOLDING
    arm.cycles(20)
    assert stands_since(arm, arm.sim.start_ns)
    for joint, config in enumerate(arm.arm.joints):
        axis = arm.loop[0]["axes"][joint]
        assert (
            abs(axis["measured"]["position_rad"] - arm.sim.true_position_rad(joint, arm.sim.now_ns))
            < 2 * config.encoder_count_rad
        )
        assert axis["drive"]["status"] & status_bits.ENABLED
    arm.close()


def test_drives_that_are_limp_are_enabled_where_they_stand(family: Family) -> None:
    arm = VirtualArm(family.arm, faults=[Disabled(joint.name, 0.0) for joint in load_arm(family.arm).joints])
    arm.cycles(5)
    began_ns = arm.sim.now_ns
    assert arm.bring_up().failure is None, arm.told
    arm.cycles(20)
    assert stands_since(arm, began_ns)
    assert all(axis["drive"]["status"] & status_bits.ENABLED for axis in arm.loop[0]["axes"][:6])
    arm.close()


@pytest.mark.parametrize("name", ["large", "near_limits_high"])
def test_a_recorded_goal_runs_true(family: Family, name: str) -> None:
    arm = brought_up(family, name=name)
    started_ns = arm.now_ns
    goal = arm.play(name)
    commanded = commanded_until_end(arm, goal)
    assert arm.outcome(goal) == Outcome.SUCCEEDED
    arm.cycles(40)
    for joint, config in enumerate(arm.arm.joints):
        _, position_rad, velocity_rad_s = sampled_truth(arm.sim, joint, started_ns, commanded[0][-1])
        assert np.abs(accelerations(position_rad)).max() <= 1.6 * config.max_acceleration_rad_s2
        assert np.abs(velocity_rad_s).max() <= 1.15 * config.max_velocity_rad_s + 2 * math.pi / 60 / config.ratio
        if joint < 3:
            assert path_error_deg(arm, joint, *commanded) <= family.path_error_deg
        end_rad = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
        goal_rad = recorded_goal(name)["joints"][-1, joint, 0]
        assert abs(end_rad - goal_rad) <= 2 * config.slack_rad
    arm.close()


@pytest.mark.parametrize("joint", [0, 2])
def test_constant_speed_is_even(family: Family, joint: int) -> None:
    """Ripple of the true velocity at the joint's highest speed: half a motor rpm (rms) is what whole rpm allow.

    A follower's set-point stands still for a cycle, and its position loop sees the difference.
    """
    arm = brought_up(family)
    config = arm.arm.joints[joint]
    above_middle = arm.loop[0]["axes"]["commanded"]["position_rad"][joint] > (config.lower_rad + config.upper_rad) / 2
    speed_rad_s = math.copysign(config.max_velocity_rad_s, -1.0 if above_middle else 1.0)
    whole_rpm = 0.5 / config.motor_rpm if config.drive.stepper_ramp else 0.0
    assert velocity_ripple(arm, joint, speed_rad_s, 1.0, 0.4) <= whole_rpm + family.ripple
    arm.close()


def test_silence_of_the_host_ends_in_rest(family: Family) -> None:
    """The control process dies: every joint comes to rest by itself, inside its limits."""
    arm = amid_goal(family)
    died_ns = arm.sim.now_ns
    arm.sim.run_until(died_ns + 3_000_000_000)
    for joint, config in enumerate(arm.arm.joints):
        _, position_rad, velocity_rad_s = sampled_truth(arm.sim, joint, died_ns, arm.sim.now_ns)
        assert abs(velocity_rad_s[-1]) == pytest.approx(0.0, abs=1e-3)
        assert config.lower_rad - 0.02 <= position_rad.min() and position_rad.max() <= config.upper_rad + 0.02
        assert np.abs(accelerations(position_rad)).max() <= family.braking * config.max_acceleration_rad_s2
    arm.close()


def test_a_drive_that_falls_silent_stops_the_arm(family: Family) -> None:
    arm = amid_goal(family)
    arm.sim.inject(Silent("joint2", 0.0, 1.0), since_ns=arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.STALE_READING, 1)
    assert arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.SILENT
    arm.cycles(int(2e9 / arm.period_ns))
    stood_ns = arm.sim.now_ns
    arm.cycles(50)
    assert stands_since(arm, stood_ns)
    assert arm.clear_fault().failure is None, arm.told
    proves_power = arm.marks[1] is not None
    assert bool(arm.loop[0]["axes"][1]["reference"]["referenced"]) == (
        arm.arm.joints[1].drive.knows_its_angle or proves_power
    )
    reference_what_is_not(arm)
    assert stands_since(arm, stood_ns)
    arm.close()


def test_an_error_of_a_drive_is_a_latched_fault_and_only_a_person_clears_it(family: Family) -> None:
    arm = amid_goal(family)
    arm.sim.inject(Protection("joint3", 0.0, 2.0), since_ns=arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    assert arm.memory["fault"]["joint"] == 2
    arm.cycles(int(0.5e9 / arm.period_ns))
    failed = arm.clear_fault().failure
    assert failed is not None and "joint3" in str(failed)  # what tripped it is still there
    arm.cycles(int(2e9 / arm.period_ns))
    assert arm.clear_fault().failure is None, arm.told
    assert arm.memory["mode"] == Mode.HOLDING
    assert all(axis["drive"]["status"] & status_bits.ENABLED for axis in arm.loop[0]["axes"][:6])
    arm.close()


def test_a_drive_that_lost_its_power_is_believed_only_where_its_encoder_is_absolute(family: Family) -> None:
    arm = amid_goal(family)
    arm.sim.inject(PowerLoss("joint1", 0.0, 0.5), since_ns=arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=1.0)
    assert arm.memory["fault"]["joint"] == 0
    arm.cycles(int(2e9 / arm.period_ns))
    assert arm.clear_fault().failure is None, arm.told
    assert bool(arm.loop[0]["axes"][0]["reference"]["referenced"]) == arm.arm.joints[0].drive.knows_its_angle
    stood_ns = arm.sim.now_ns
    arm.cycles(20)
    assert stands_since(arm, stood_ns)
    if arm.arm.joints[0].drive.knows_its_angle:
        true_rad = arm.sim.true_position_rad(0, arm.sim.now_ns)
        assert (
            abs(arm.loop[0]["axes"][0]["measured"]["position_rad"] - true_rad) < 2 * arm.arm.joints[0].encoder_count_rad
        )
    arm.close()


def test_drives_are_let_go_and_enabled_again(family: Family) -> None:
    arm = brought_up(family)
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release().failure is None, arm.told
    arm.cycles(40)
    assert not any(axis["drive"]["status"] & status_bits.ENABLED for axis in arm.loop[0]["axes"][:6])
    assert arm.ask(Request.ENABLE) == Answer.DONE
    arm.until(lambda: bool(arm.memory["dialogue"]["bring_up_asked"]), at_most_s=1.0)
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up(clears_protection=True).failure is None, arm.told
    assert arm.memory["mode"] == Mode.HOLDING
    arm.close()


def test_a_person_says_where_a_joint_stands(family: Family) -> None:
    arm = brought_up(family)
    stands_ns = arm.sim.now_ns
    said_rad = float(arm.loop[0]["axes"][1]["measured"]["position_rad"]) + 0.1
    assert arm.ask(Request.REFERENCE, joint_mask=0b10, value=said_rad) == Answer.DONE
    assert arm.reference().failure is None
    arm.cycles(5)
    assert abs(arm.loop[0]["axes"][1]["measured"]["position_rad"] - said_rad) < 3 * arm.arm.joints[1].encoder_count_rad
    assert stands_since(arm, stands_ns)
    arm.close()


def test_the_bus_carries_what_the_budget_says(family: Family) -> None:
    """Frames and bits on the simulated bus while all joints move, against the arithmetic: equal within the stuffing."""
    arm = amid_goal(family, share=0.3)
    found = budget(arm.arm)
    frames_before, busy_before, cycles = arm.sim.bus.frames, arm.sim.bus.busy_ns, 60
    arm.cycles(cycles)
    frames = (arm.sim.bus.frames - frames_before) / cycles
    bits = (arm.sim.bus.busy_ns - busy_before) * 1e-9 * arm.arm.bus.bitrate / cycles
    beside = sum(part.rate_hz * part.frames.count for part in found.beside) * arm.period_ns * 1e-9
    bits_beside = found.bits_beside_s * arm.period_ns * 1e-9
    assert frames == pytest.approx(found.frames_per_cycle + beside, abs=0.5)
    assert bits <= found.bits_per_cycle + bits_beside
    assert bits >= 0.80 * (found.bits_per_cycle + bits_beside)  # stuffing takes up to a fifth of a frame
    arm.close()


def test_what_a_drive_measures_is_published(family: Family) -> None:
    arm = amid_goal(family)
    arm.cycles(20)
    joints = arm.reader.snapshot()["joints"][:6]
    for name in ("measured_effort", "drive_temperature_c", "drive_voltage_v"):
        assert bool(np.all(np.isfinite(joints[name]))) == (name in family.measures), name
    arm.close()
