"""Drives that are told to stay where they stand: what is known of where that is, of what they hold, and what is not."""

import math
import struct
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from motion_figures import sampled_truth
from virtual import VirtualArm

from config.loader import load_arm
from rtloop.drives import families
from rtloop.process.initial_state import new_loop
from shm import layout
from shm.words import Answer, Mode, Request
from sim.bus import Frame
from sim.faults import Disabled

TOLD_A_PLACE = pytest.mark.parametrize(
    "name", ["odrive6", "damiao6", "damiao6_pv", "robstride6", "robstride6_position", "vesc6"]
)
SWINGS_RAD = {"vesc6": 0.015}
"""How far one swings beyond its last set-point, which it follows without lag, where that ends at once."""


def referenced(name: str) -> VirtualArm:
    """An arm that holds at the beginning of a recorded goal; a person has said of joints that they stand there."""
    arm = VirtualArm.at_start_of("large", name)
    if not np.all(arm.loop[0]["axes"]["reference"]["referenced"][:6]):
        assert arm.ask(Request.REFERENCE, joint_mask=0b111111, value=math.nan) == Answer.DONE
        assert arm.reference().failure is None
    return arm


@TOLD_A_PLACE
def test_a_drive_that_is_not_heard_any_more_is_not_taken_back(name: str) -> None:
    """It hears and obeys, but its answers are lost: where it was heard last lies behind where it has been led since."""
    arm = referenced(name)
    arm.play_part("large", 0.4)
    speeds = arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][:6].copy()
    joint = int(np.argmax(np.abs(speeds)))
    assert abs(speeds[joint]) > 0.5
    lost_ns = arm.sim.now_ns
    arm.sim.drives[joint].say = lambda *answer, **options: None
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    arm.cycles(int(0.5e9 / arm.period_ns))
    _, position_rad, _ = sampled_truth(arm.sim, joint, lost_ns, arm.sim.now_ns)
    ahead_rad = np.sign(speeds[joint]) * (position_rad - position_rad[0])
    assert ahead_rad.max() - ahead_rad[-1] <= SWINGS_RAD.get(name, 0.002)
    arm.close()


@TOLD_A_PLACE
@pytest.mark.parametrize(
    "unknown", [("measured", "readings", 0), ("checks", "suspect", 1), ("measured", "time_ns", -100_000_000), None]
)
def test_nothing_is_told_where_nobody_knows_the_place(name: str, unknown: tuple[str, str, int] | None) -> None:
    """Nothing read since the zero was set anew, an implausible reading, an old one; else it is told to stay."""
    cycle = SimpleNamespace(loop=new_loop(load_arm(name), 0, 0), shared=np.zeros(1, layout.StateFile.dtype))
    axis = cycle.loop[0]["axes"][1]
    axis["reply"]["position_rad"] = axis["measured"]["position_rad"] = 0.5
    axis["measured"]["readings"] = 3
    if unknown is not None:
        part, word, value = unknown
        axis[part][word] = value
    assert families.stop(cycle.loop[0], 1, cycle.shared[0])
    assert (cycle.loop[0]["buses"][0]["outgoing"]["frames"] == 0) == (unknown is not None)


@pytest.mark.parametrize("name", ["odrive6", "mks6", "damiao6", "cia402_6", "myactuator6", "robstride6", "vesc6"])
@pytest.mark.parametrize(("bent_rad", "kept_rad"), [(0.015, 0.015), (-0.015, -0.015), (1.0, 0.0)])
def test_a_joint_that_is_referenced_is_still_told_what_it_holds(name: str, bent_rad: float, kept_rad: float) -> None:
    """A load keeps a drive from its target: to command where it stands would let it sink by as much again."""
    arm = referenced(name)
    axis = arm.loop[0]["axes"][1]
    axis["commanded"]["position_rad"] = axis["commanded"]["next_position_rad"] = (
        axis["measured"]["position_rad"] + bent_rad
    )
    said_rad = float(axis["measured"]["position_rad"]) + 0.1
    assert arm.ask(Request.REFERENCE, joint_mask=0b10, value=said_rad) == Answer.DONE
    assert arm.reference().failure is None
    assert axis["commanded"]["position_rad"] - said_rad == pytest.approx(kept_rad, abs=0.001)
    arm.close()


@pytest.mark.parametrize(("name", "from_parameter", "most"), [("odrive6", False, 80), ("robstride6", True, 8)])
def test_a_garbled_place_is_not_where_a_drive_is_enabled(name: str, from_parameter: bool, most: int) -> None:
    """One answer of joint 2 says another place while it is brought up: whichever it is, nothing moves."""
    for garbled in range(1, most):
        arm = VirtualArm(name, faults=[Disabled("joint2", 0.0)])
        if name == "odrive6":  # one that is idle begins where it stands, whatever it was told
            assert arm.bring_up().failure is None
        began_ns = arm.sim.now_ns
        drive = arm.sim.drives[1]
        said, reply = [0], drive.reply

        def once(
            frame: Frame, said: list[int] = said, reply: Callable[[Frame], None] = reply, at: int = garbled
        ) -> None:
            place = frame.can_id >> 24 == 17 and frame.data[:2] == b"\x19\x70" if from_parameter else True
            said[0] += place
            if place and said[0] == at:
                head, tail = (4, 8) if from_parameter else (0, 4)
                value = struct.unpack("<f", frame.data[head:tail])[0] + 2.0
                frame = Frame(
                    frame.can_id, frame.data[:head] + struct.pack("<f", value) + frame.data[tail:], frame.extended
                )
            reply(frame)

        drive.reply = once
        arm.bring_up()
        arm.cycles(40)
        _, position_rad, _ = sampled_truth(arm.sim, 1, began_ns, arm.sim.now_ns)
        assert np.ptp(position_rad) <= 0.002, garbled
        arm.close()
