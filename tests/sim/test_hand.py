"""A hand leads the limp joints of a simulated arm: the shafts move, the drives' encoders count it, held ones stay."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from sim_host import MILLISECOND, connect

from config.drives.zdt import ZdtDrive
from config.loader import ARMS_FOLDER, load_arm
from sim.arm import SimulatedArm
from sim.faults import Disabled
from sim.hand import TAKES_HOLD_NS, Guided, load_guided

SLCAN = {"bus": {"interface": "slcan", "channel": "unused"}}
LED_DEG = (20.0, -15.0)
SECONDS = 2.0
START_NS = 1_000_000_000


def there_and_on(*joints: str) -> Guided:
    """A smooth way of some joints, at rest at both ends."""
    times_s = np.linspace(0.0, SECONDS, 201)
    share = 0.5 - 0.5 * np.cos(np.pi * times_s / SECONDS)
    return Guided(joints, times_s, np.radians(np.outer(share, LED_DEG[: len(joints)])))


def limp_arm(name: str, guided: Guided, start_rad: list[float] | None = None) -> SimulatedArm:
    arm = load_arm(name, overrides=SLCAN)
    return SimulatedArm(
        arm,
        start_ns=START_NS,
        joint_position_rad=start_rad,
        faults=[Disabled(joint.name, 0.0) for joint in arm.joints],
        hand=guided,
    )


@pytest.mark.parametrize("name", sorted(path.stem for path in ARMS_FOLDER.glob("*.yaml") if path.stem != "mock"))
def test_limp_joints_of_every_family_are_led_along_the_motion(name: str) -> None:
    first, second = (joint.name for joint in load_arm(name, overrides=SLCAN).joints[:2])
    guided = there_and_on(first, second)
    arm = limp_arm(name, guided)
    arm.run_until(START_NS + TAKES_HOLD_NS + round((SECONDS + 1.0) * 1e9))
    times_ns = START_NS + TAKES_HOLD_NS + np.arange(0, round(SECONDS * 1e9), 7_000_000)
    for joint in (0, 1):
        wanted_rad = np.interp((times_ns - times_ns[0]) * 1e-9, guided.times_s, guided.angles_rad[:, joint])
        assert np.abs(arm.truth(joint, times_ns)[0] - wanted_rad).max() < math.radians(0.2)
        assert arm.true_position_rad(joint, arm.now_ns) == pytest.approx(math.radians(LED_DEG[joint]), abs=2e-4)
        assert arm.true_velocity_rad_s(joint, arm.now_ns) == 0.0
    assert arm.true_position_rad(2, arm.now_ns) == pytest.approx(0.0, abs=1e-3)  # to the nearest pulse


def test_of_a_motion_each_bus_has_what_is_of_its_joints() -> None:
    whole = there_and_on("joint2", "joint5")
    part = whole.of(["joint5", "joint6"])
    assert part.joints == ("joint5",)
    assert part.angles_rad.tolist() == whole.angles_rad[:, 1:].tolist()
    assert whole.of(["joint1"]).joints == ()
    limp_arm("episode1", whole.of(["joint1"])).run_until(3_000_000_000)  # nobody is led


def test_the_encoder_tells_over_the_bus_where_the_hand_led_it() -> None:
    arm = limp_arm("episode1", there_and_on("joint1"))
    host = connect(arm)
    before = host.position(1)
    host.wait((TAKES_HOLD_NS / MILLISECOND) + SECONDS * 1000.0 + 100.0)
    after = host.position(1)
    assert before is not None and after is not None
    joint = arm.config.joints[0]
    assert isinstance(joint.drive, ZdtDrive)
    assert (after - before) / joint.encoder_counts_per_rad == pytest.approx(math.radians(20.0), abs=2e-4)


def test_held_drives_are_not_led_and_one_that_holds_ends_the_leading() -> None:
    arm = load_arm("episode1", overrides=SLCAN)
    simulated = SimulatedArm(arm, start_ns=START_NS, hand=there_and_on("joint1"))
    simulated.run_until(START_NS + 5_000_000_000)
    assert simulated.true_position_rad(0, simulated.now_ns) == pytest.approx(0.0, abs=1e-6)

    led = limp_arm("episode1", there_and_on("joint1"))
    host = connect(led)
    host.wait(TAKES_HOLD_NS / MILLISECOND + 1000.0)
    halfway_rad = led.true_position_rad(0, led.now_ns)
    assert 0.1 < halfway_rad < math.radians(19.0)
    host.say(b"T000001005F3AB01006B\r")  # enable joint 1's drive (zdt-emm-v5.md, F3)
    host.wait(50.0)
    held_rad = led.true_position_rad(0, led.now_ns)
    host.wait(3000.0)
    assert led.true_position_rad(0, led.now_ns) == held_rad


def test_a_stop_stands_in_the_hands_way_and_it_comes_back_from_there() -> None:
    lower_rad = load_arm("episode1", overrides=SLCAN).joints[0].lower_rad
    times_s = np.linspace(0.0, 4.0, 401)
    down_and_up = np.radians(-10.0 * np.sin(np.pi * times_s / 4.0))[:, np.newaxis]
    start_rad = [lower_rad + math.radians(4.0), 0.0, 0.0, 0.0, 0.0, 0.0]
    arm = limp_arm("episode1", Guided(("joint1",), times_s, down_and_up), start_rad)
    end_ns = START_NS + TAKES_HOLD_NS + 4_100_000_000
    arm.run_until(end_ns)
    path_rad = arm.truth(0, np.arange(START_NS, end_ns, 5_000_000))[0]
    assert path_rad.min() == pytest.approx(lower_rad, abs=1e-3)
    assert path_rad[-1] == pytest.approx(start_rad[0], abs=1e-3)


def test_the_motion_that_comes_with_rtarm_fits_the_arm_that_does() -> None:
    guided = load_guided("wave", [joint.name for joint in load_arm("episode1", overrides=SLCAN).joints])
    assert guided.times_s[-1] == 12.0
    assert np.degrees(np.abs(guided.angles_rad)).max() < 60.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no table"),
        ("time_s,joint1\n", "no table"),
        ("time_s,joint9\n0,0\n1,1\n", "joint9"),
        ("time_s,joint1,joint1\n0,0,0\n1,1,1\n", "must name"),
        ("t,joint1\n0,0\n1,1\n", "must name"),
        ("time_s,joint1\n0,0\n1\n", "no table"),
        ("time_s,joint1\n0,0\n1,nan\n", "finite"),
        ("time_s,joint1\n0,0\n0,1\n", "rise"),
        ("time_s,joint1\n0,zero\n1,1\n", "no table"),
        ("time_s,joint1\n0,0\n1,\xff\n", "no table"),
    ],
)
def test_a_motion_that_is_none_is_refused_in_a_sentence(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "motion.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=said):
        load_guided(str(path), ["joint1", "joint2"])


def test_a_file_that_is_not_there_is_refused_with_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="one of wave"):
        load_guided(str(tmp_path / "none.csv"), ["joint1"])
