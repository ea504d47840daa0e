"""MKS drives in arm files: what they cost the bus, what their ramp makes of silence, what they refuse."""

import pytest

from config.budget import budget
from config.derived import derived_table
from config.errors import ConfigError
from config.loader import load_arm


def arm(**overrides):
    return load_arm("mks6", overrides=overrides)


@pytest.mark.parametrize(("acknowledge", "bits"), [(False, 2070), (True, 2580)])
def test_bits_a_cycle_are_those_of_the_facts_and_a_status_in_turn(acknowledge, bits):
    """other-drives.md: 345 bits an axis, and 85 more for an acknowledgement; a status is 75 + 85."""
    assert budget(arm(bus={"acknowledge": acknowledge})).bits_per_cycle == bits + 160


@pytest.mark.parametrize(("bitrate", "fits_hz"), [(250_000, 95), (500_000, 190), (1_000_000, 381)])
def test_highest_rates(bitrate, fits_hz):
    found = budget(arm(bus={"bitrate": bitrate}, control={"rate_hz": 50}))
    assert int(found.highest_rate_hz) == fits_hz


def test_silence_is_that_of_zdt_drives_in_the_same_joints():
    """The ramp is the same byte, so the same braking follows."""
    mks, zdt = derived_table(arm()), derived_table(load_arm("episode1"))
    for ours, theirs in zip(mks, zdt, strict=True):
        assert ours.silence is not None and theirs.silence is not None
        assert (ours.silence.acc_byte, ours.silence.factor) == (theirs.silence.acc_byte, theirs.silence.factor)
        assert 1.5 <= ours.silence.factor <= 2.0
        # the drive goes on for two periods, which are shorter here
        assert ours.silence.stop_time_s == pytest.approx(theirs.silence.stop_time_s + 2 / 150 - 2 / 120)


def joint_with(**changes):
    """The arm's joints as in its file, with the first one's fields changed."""
    joints = [joint.model_dump(mode="json") for joint in arm().joints]
    joints[0] |= changes
    return joints


@pytest.mark.parametrize("can_id", [0, 2048, -1, 1.5, "1", True])
def test_identifiers_that_are_none(can_id):
    with pytest.raises(ConfigError, match="can_id"):
        arm(joints=joint_with(drive={"family": "mks", "can_id": can_id}))


def test_one_identifier_for_two_drives():
    with pytest.raises(ConfigError, match="can_id 2 is used by joint1 and joint2"):
        arm(joints=joint_with(drive={"family": "mks", "can_id": 2}))


def test_targets_reach_as_far_as_an_int24():
    wide = {"ratio": 250, "max_acceleration_rad_s2": 2.2, "lower_deg": -20, "zero_deg": 180}
    assert arm(joints=joint_with(**wide, upper_deg=557)).joints[0].drive.highest_turns == pytest.approx(512, abs=1e-3)
    with pytest.raises(ConfigError, match=r"upper_deg of joint1 is 560, 513\.9 motor turns .* within 512"):
        arm(joints=joint_with(**wide, upper_deg=560))


@pytest.mark.parametrize("field", [{"positions": "reported"}, {"position_command": "FC"}])
def test_what_zdt_drives_alone_can_do_is_refused(field):
    with pytest.raises(ConfigError, match="ZDT drives alone"):
        arm(bus=field)
