"""The judge itself: it finds nothing in a clean run, and each kind of violation when there is one."""

import numpy as np
import pytest
from observer import command_violations, frames_sent, motion_after, motion_violations, stands_since_ns, truth_of
from virtual import VirtualArm

from config.loader import load_arm
from sim.truth import JointTruth

ARM = load_arm("episode1")
SECOND_NS = 10**9


def straight(*corners: tuple[float, float]) -> dict[str, JointTruth]:
    """Joint2 through corners (s, rad), the others at rest."""
    times_ns = np.array([round(at_s * 1e9) for at_s, _ in corners])
    position_rad = np.array([rad for _, rad in corners])
    velocity_rad_s = np.append(np.diff(position_rad) / np.diff(times_ns * 1e-9), 0.0)
    still = JointTruth(times_ns[[0, -1]], np.zeros(2), np.zeros(2))
    moving = JointTruth(times_ns, position_rad, velocity_rad_s)
    return {joint.name: moving if joint.name == "joint2" else still for joint in ARM.joints}


def test_a_goal_that_ran_well_has_no_finding() -> None:
    arm = VirtualArm.at_start_of("small")
    began_ns = arm.now_ns
    goal = arm.play("small")
    arm.end_of(goal)
    arm.cycles(50)
    truth = truth_of(arm.sim)
    assert motion_violations(ARM, truth, began_ns, arm.now_ns) == []
    frames = frames_sent(arm.sent)
    assert sum(frame.data[0] == 0xFD for frame in frames) > 100
    assert command_violations(ARM, frames) == []
    stood_ns = stands_since_ns(truth, arm.now_ns)
    assert began_ns < stood_ns < arm.now_ns
    assert motion_after(truth, stood_ns, arm.now_ns) == []
    assert motion_after(truth, stood_ns - 200_000_000, arm.now_ns) != []
    arm.close()


@pytest.mark.parametrize(
    ("corners", "word"),
    [
        (((0.0, 0.0), (60.0, ARM.joints[1].upper_rad + 0.01)), "outside"),
        (((0.0, 0.0), (60.0, ARM.joints[1].lower_rad - 0.01)), "outside"),
        (((0.0, 0.0), (1.0, 0.0), (1.5, 1.0), (2.0, 1.0)), "rad/s, allowed"),
        (((0.0, 0.0), (1.0, 0.0), (2.0, 0.3), (3.0, 0.3)), "rad/s² over"),
    ],
)
def test_true_motion_beyond_a_limit_is_found(corners: tuple[tuple[float, float], ...], word: str) -> None:
    truth = straight(*corners)
    found = motion_violations(ARM, truth, 0, round(corners[-1][0] * 1e9))
    assert found
    assert all(sentence.startswith("joint2") for sentence in found)
    assert any(word in sentence for sentence in found)


def test_motion_that_nobody_asked_for_is_found() -> None:
    truth = straight((0.0, 0.0), (1.0, 0.1), (2.0, 0.1), (2.1, 0.1001), (3.0, 0.1001))
    assert motion_after(truth, SECOND_NS, 2 * SECOND_NS) == []
    assert motion_after(truth, SECOND_NS, 3 * SECOND_NS)[0].startswith("joint2 moved")
    assert stands_since_ns(truth, 3 * SECOND_NS) == 2_100_000_000


@pytest.mark.parametrize(
    ("lines", "word"),
    [
        (b"T000002008FD00000AFF000100\rT0000020026C6B\r", "half a position command"),
        (b"T000002015FD0001006B\r", "without its first"),
        (b"T000002008FD00000AFF7FFFFF\rT000002015FDFF01006B\r", "outside its limits"),
        (b"T000002008FD000BB8FF000000\rT000002015FD1001006B\r", "speed"),
        (b"T000002008FD00000AFF000000\rT000002015FD1000006B\r", "no absolute"),
        (b"T00000900236" + b"6B\r", "does not have"),
    ],
)
def test_commands_beyond_a_limit_are_found(lines: bytes, word: str) -> None:
    (found,) = command_violations(ARM, frames_sent([(0, lines)]))
    assert word in found


def test_a_garbled_line_is_no_frame() -> None:
    with pytest.raises(ValueError, match="no SLCAN line"):
        frames_sent([(0, b"T00000200836\r")])
