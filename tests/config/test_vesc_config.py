"""VESCs in an arm file: what is refused, with which sentence, and what follows from the rest."""

import pytest

from config.budget import budget
from config.errors import ConfigError
from config.loader import load_arm
from config.schema import ArmConfig


def vesc6(**of_joint: object) -> ArmConfig:
    """The arm with another first joint, and what is given of its drive."""
    joints = [joint.model_dump(exclude_unset=True) for joint in load_arm("vesc6").joints]
    joints[0]["drive"].update(of_joint.pop("drive", {}))
    joints[0].update(of_joint)
    return load_arm("vesc6", overrides={"joints": joints})


@pytest.mark.parametrize(("ratio", "fits"), [(1.0, True), (1.06, True), (1.07, False), (25.0, False)])
def test_a_joint_has_less_than_the_turn_after_which_its_positions_come_round(ratio: float, fits: bool) -> None:
    """Of 320 degrees."""
    if fits:
        assert vesc6(ratio=ratio).joints[0].ratio == ratio
        return
    with pytest.raises(ConfigError) as refused:
        vesc6(ratio=ratio)
    turns = f"{ratio * 320 / 360:.2f} motor turns with ratio {ratio:g}"
    assert f"the range of joint1 is {turns}, but a VESC counts within one turn" in str(refused.value)


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        ({"controller_id": 0}, "controller_id of joint1 is 0"),
        ({"controller_id": 127}, "controller_id of joint1 is 127"),
        ({"controller_id": 2}, "controller_id 2 is used by joint1 and joint2"),
        ({"position_hz": 40}, "position_hz of joint1 is 40"),
        ({"position_hz": 199}, "position_hz of joint1 is 199, below the control rate of 200 Hz"),
    ],
)
def test_what_no_vesc_can_be_is_refused(drive: dict[str, int], words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        vesc6(drive=drive)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("other", "meets"),
    [
        ({"family": "zdt", "address": 4}, True),  # its second packet is a position to VESC 1
        ({"family": "zdt", "address": 128}, False),
        ({"family": "robstride", "motor_id": 9, "mode": "position", "host_id": 0x82}, True),
        ({"family": "robstride", "motor_id": 9, "mode": "position"}, False),
        ({"family": "odrive", "node_id": 9}, False),
    ],
)
def test_beside_other_families(other: dict[str, object], meets: bool) -> None:
    if not meets:
        assert with_another(other).joints[0].drive.family == other["family"]
        return
    with pytest.raises(ConfigError, match="uses CAN identifiers that"):
        with_another(other)


def with_another(drive: dict[str, object]) -> ArmConfig:
    """The arm with a drive of another family in its first joint."""
    joints = [joint.model_dump(exclude_unset=True) for joint in load_arm("vesc6").joints]
    joints[0] |= {"drive": drive, "max_acceleration_rad_s2": 5.0, "motor_rpm": 60}
    return load_arm("vesc6", overrides={"joints": joints})


def test_what_comes_by_itself_is_in_the_budget() -> None:
    """Status 4 and 5, 160 bits at most each, 200 and 5 times a second, of six drives."""
    assert budget(load_arm("vesc6")).bits_beside_s == 6 * (200 + 5) * 160
