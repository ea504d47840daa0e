"""The switch in the power line: all drives lose power at once and boot later, whatever the loop does meanwhile.

Drives boot enabled and count from zero. What an adapter or the system has kept of absolute targets while nobody
acknowledged it reaches them then, and must not make them go anywhere.
"""

from contextlib import closing

import numpy as np
import pytest
from bus_trials import sweep
from virtual import START_NS, VirtualArm

from config.budget import cycle_frames
from config.loader import load_arm
from rtloop.wire.can_socket import frames_held_back
from rtloop.wire.tty import CLOSING
from shm.words import Fault, Mode, Outcome
from sim.bus import Frame
from sim.faults import PowerLoss

TWITCH_RAD = 0.02
OFF_S = 1.5
STAGGER_S = 0.03
LATER_S = 1.5
"""A drive that goes to an absolute target is still on its way after this time."""
INTERFACES = ("slcan", "socketcan")
MEANWHILE = ("nothing", "a clear", "a clear just before", "an orderly end", "a kill")


def powered_arm(interface: str, motion: str, seed: int) -> VirtualArm:
    """An arm that holds after a short goal, or is in the middle of a fast one."""
    config = load_arm("episode1", overrides={"bus": {"interface": "socketcan"}} if interface == "socketcan" else {})
    times_ns, joints = sweep(config, np.random.default_rng(seed))
    if motion == "holding":
        joints[1, :, 0] = joints[0, :, 0] + 0.01 * np.sign(joints[1, :, 0] - joints[0, :, 0])
    arm = VirtualArm(config, start_rad=joints[0, :, 0], seed=seed)
    assert arm.sim is not None
    if interface == "socketcan":
        sent = sum(frames.count for frames in cycle_frames(config) if frames.from_host)
        arm.sim.adapter.queue = frames_held_back(sent, len(config.joints))
    assert arm.bring_up().failure is None
    goal = arm.send_goal(times_ns, joints)
    if motion == "holding":
        arm.until(lambda: arm.outcome(goal) == Outcome.SUCCEEDED)
        arm.cycles(5)
    else:
        arm.cycles(round(0.5 * times_ns[-1] / arm.period_ns))
        assert arm.memory["mode"] == Mode.EXECUTING
    return arm


def cut_and_return(arm: VirtualArm, meanwhile: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Cut the power of all drives for OFF_S.

    Returns:
        How far each joint was from its place, at most, since power came back [rad]; and how fast it is at last [rad/s].
    """
    assert arm.sim is not None
    random = np.random.default_rng(seed)
    cut_ns = arm.now_ns + int(random.integers(0, arm.period_ns))
    stagger_s = random.permutation(6) * STAGGER_S / 5.0
    for joint, late_s in zip(arm.arm.joints, stagger_s, strict=True):
        arm.sim.inject(PowerLoss(joint.name, 0.0, off_s=OFF_S + late_s), since_ns=cut_ns)
    back_ns = cut_ns + round(OFF_S * 1e9)
    end_ns = back_ns + round(LATER_S * 1e9)

    def cycles_until(time_ns: int) -> None:
        while arm.now_ns < time_ns:
            arm.cycle()

    cycles_until(cut_ns + 300_000_000)
    assert arm.memory["fault"]["code"] == Fault.STALE_READING
    if meanwhile == "nothing":
        cycles_until(end_ns)
    elif meanwhile == "a clear":
        cycles_until(cut_ns + 800_000_000)
        assert arm.clear_fault().failure is not None
        cycles_until(end_ns)
    elif meanwhile == "a clear just before":
        cycles_until(back_ns - 100_000_000)
        assert arm.clear_fault().failure is None
        assert not np.any(arm.loop[0]["axes"]["reference"]["referenced"][:6])
        cycles_until(end_ns)
    elif meanwhile == "an orderly end" and arm.arm.bus.interface == "slcan":
        arm.sim.feed(arm.sim.now_ns, CLOSING)
    arm.sim.run_until(max(end_ns, arm.sim.now_ns))
    moved = []
    for index in range(6):
        times_ns = arm.sim.truth_changes(index)
        times_ns = np.concatenate(([back_ns], times_ns[times_ns > back_ns]))
        position_rad = arm.sim.truth(index, times_ns)[0]
        moved.append(np.abs(position_rad - position_rad[0]).max())
    return np.array(moved), np.array([arm.sim.true_velocity_rad_s(index, arm.sim.now_ns) for index in range(6)])


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("motion", ["holding", "moving"])
@pytest.mark.parametrize("meanwhile", MEANWHILE)
def test_no_joint_goes_anywhere_when_the_power_of_all_drives_returns(
    interface: str, motion: str, meanwhile: str
) -> None:
    seed = MEANWHILE.index(meanwhile)
    with closing(powered_arm(interface, motion, seed)) as arm:
        moved_rad, at_last_rad_s = cut_and_return(arm, meanwhile, seed)
    print(f"{meanwhile}, {motion}, {interface}: {moved_rad.max():.4f} rad")
    assert moved_rad.max() <= TWITCH_RAD, f"moved by {np.round(moved_rad, 3)} rad"
    assert not np.any(at_last_rad_s), f"goes on at {at_last_rad_s} rad/s"


def test_bring_up_stops_a_drive_that_is_on_its_way_instead_of_waiting_for_it() -> None:
    arm = VirtualArm("episode1")
    assert arm.sim is not None
    try:
        drive = arm.sim.drives[2]
        far = b"\xfd\x00\x00\x64\x00\x00\x01\x00\x00\x01\x00\x6b"  # 100 rpm, to 65536 pulses
        for number, part in enumerate((far[:8], far[:1] + far[8:])):
            drive.receive(arm.sim.now_ns, Frame(0x300 | number, part))
        assert drive.moving
        assert arm.bring_up().failure is None
        assert not drive.moving
        assert arm.now_ns - START_NS < 1_000_000_000
    finally:
        arm.close()
