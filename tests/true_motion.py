"""What the joints of an arm in virtual time truly do, judged by the simulated drives' own motion."""

import math

import numpy as np
from motion_figures import WINDOW_S, accelerations, rms, sampled_truth
from virtual import VirtualArm

from config.schema import ArmConfig
from shm.words import Outcome


def moving(name: str, share: float, arm: ArmConfig | str = "episode1") -> tuple[VirtualArm, int, int]:
    """An arm somewhere in a recorded goal: arm, goal, time at which the goal was sent."""
    made = VirtualArm.at_start_of(name, arm)
    started_ns = made.now_ns
    return made, made.play_part(name, share), started_ns


def largest_acceleration_ratio(arm: VirtualArm, start_ns: int, window_s: float = WINDOW_S) -> float:
    """Largest true acceleration since start_ns as a multiple of its joint's limit, over windows of so many seconds."""
    worst = 0.0
    for joint, config in enumerate(arm.arm.joints):
        _, position_rad, _ = sampled_truth(arm.sim, joint, start_ns, arm.sim.now_ns)
        worst = max(worst, float(np.abs(accelerations(position_rad, window_s)).max()) / config.max_acceleration_rad_s2)
    return worst


def commanded_until_end(arm: VirtualArm, goal: int) -> tuple[np.ndarray, np.ndarray]:
    """times_ns (n,) of the cycles until a goal has ended, and what joints were commanded in them (n, joints)."""
    times_ns, position_rad = [], []

    def over() -> bool:
        times_ns.append(arm.now_ns)
        position_rad.append(arm.loop[0]["axes"]["commanded"]["position_rad"][: len(arm.arm.joints)].copy())
        return arm.outcome(goal) != Outcome.NONE

    arm.until(over)
    return np.array(times_ns[1:]), np.array(position_rad[1:])


def path_error_deg(arm: VirtualArm, joint: int, times_ns: np.ndarray, commanded_rad: np.ndarray) -> float:
    """Rms of a joint's true distance from what it was commanded in the cycles at these times (n,), (n, joints)."""
    true_ns, position_rad, _ = sampled_truth(arm.sim, joint, times_ns[0] - arm.period_ns, times_ns[-1])
    return math.degrees(rms(position_rad - np.interp(true_ns, times_ns, commanded_rad[:, joint])))


def velocity_ripple(arm: VirtualArm, joint: int, speed_rad_s: float, cruise_s: float, settles_s: float) -> float:
    """Send a joint on its way at a steady speed: rms of its true velocity minus the planned one, over the planned one.

    From `settles_s` after it has got up speed until 0.1 s before it brakes.
    """
    speed_up_s = abs(speed_rad_s) / arm.arm.joints[joint].max_acceleration_rad_s2
    way_rad, cruise_rad = speed_rad_s * speed_up_s / 2, speed_rad_s * cruise_s
    times_s = np.array([0.0, speed_up_s, speed_up_s + cruise_s, 2 * speed_up_s + cruise_s])
    joints = np.zeros((4, len(arm.arm.joints), 3))
    joints[:, :, 0] = arm.loop[0]["axes"]["commanded"]["position_rad"][: len(arm.arm.joints)]
    joints[:, joint, 0] += [0.0, way_rad, way_rad + cruise_rad, 2 * way_rad + cruise_rad]
    joints[1:3, joint, 1] = speed_rad_s
    steady_ns = arm.now_ns + round((speed_up_s + settles_s) * 1e9)
    assert arm.end_of(arm.send_goal((times_s * 1e9).astype(np.int64), joints, order=3)) == Outcome.SUCCEEDED
    until_ns = steady_ns + round((cruise_s - settles_s - 0.1) * 1e9)
    _, _, velocity_rad_s = sampled_truth(arm.sim, joint, steady_ns, until_ns)
    return rms(velocity_rad_s - speed_rad_s) / abs(speed_rad_s)
