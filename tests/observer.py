"""The judge: what the drives truly did and what was on the wire, held against the arm file and nothing of ours.

It knows the limits of the arm's file, the true motion of the simulated drives and the bytes that reached their
adapter; it decodes those bytes by itself. Every finding is a sentence; an empty list is what a trial must end with.

A drive changes its speed in whole rpm, so its velocity is a staircase: an acceleration only has meaning over a
window (see `motion_figures`), and every limit leaves room for one step of it.
"""

import math
import re
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from motion_figures import STEP_NS, WINDOW_S, accelerations

from config.drives.zdt import ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from sim.arm import SimulatedArm
from sim.truth import JointTruth

VELOCITY_SHARE = 1.10
"""5 % that plans may exceed a limit by, 5 % for catching up."""
ACCELERATION_SHARE = 2.3
"""A drive that hears nothing more brakes with about 2 times its joint's limit, by its own ramp."""
PULSES_OUTSIDE = 2
STANDS_RAD_S = 1e-9
STOP = b"\xfe\x98"
MOVES = (b"\xfd", b"\xfc")

_FRAME = re.compile(rb"T([0-9A-F]{8})([0-8])((?:[0-9A-F]{2})*)")


class Violation(AssertionError):
    """Something happened that must not, whatever the machine did: such a test is never tried again (verdicts.py)."""


def judge(found: Collection[str]) -> None:
    """End a test that found something; raises Violation with all of it."""
    if found:
        raise Violation("\n".join(found))


def truth_of(sim: SimulatedArm) -> dict[str, JointTruth]:
    """The whole motion so far of an arm in virtual time, as `python -m sim --truth` writes it of a live one."""
    found = {}
    for index, joint in enumerate(sim.config.joints):
        times_ns = sim.truth_changes(index)
        found[joint.name] = JointTruth(times_ns, *sim.truth(index, times_ns))
    return found


def motion_violations(
    arm: ArmConfig,
    truth: Mapping[str, JointTruth],
    start_ns: int,
    end_ns: int,
    *,
    thrown: Collection[str] = (),
) -> list[str]:
    """Where a joint truly left its limits between two instants.

    `thrown` are joints whose own drive was made to fail at once (power cut, shaft held, stop command): nothing on the
    bus can brake those gently, so their acceleration is not judged; position and velocity are.
    """
    found = []
    for joint in arm.joints:
        times_ns = np.arange(start_ns, end_ns, STEP_NS)
        position_rad = truth[joint.name].position_at(times_ns)
        velocity_rad_s = truth[joint.name].velocity_at(times_ns)
        found += [f"{joint.name}: {sentence}" for sentence in _beyond(joint, position_rad, velocity_rad_s)]
        if joint.name in thrown or len(times_ns) < 2 * WINDOW_S * 1e9 / STEP_NS + 2:
            continue
        highest = float(np.abs(accelerations(position_rad)).max())
        limit = ACCELERATION_SHARE * joint.max_acceleration_rad_s2 + _rad_s_per_rpm(joint) / WINDOW_S
        if highest > limit:
            found.append(f"{joint.name}: {highest:.3f} rad/s² over {WINDOW_S * 1e3:g} ms, allowed {limit:.3f}")
    return found


def life_violations(arm: ArmConfig, truth: Mapping[str, JointTruth]) -> list[str]:
    """Where a joint truly left its limits of position or velocity, in all the motion there is.

    Accelerations are not judged: a drive that was stopped at once has none that are bounded, and which drives those
    were and when is known to a test alone.
    """
    return [
        f"{joint.name}: {sentence}"
        for joint in arm.joints
        for sentence in _beyond(joint, truth[joint.name].position_rad, truth[joint.name].velocity_rad_s)
    ]


def motion_after(truth: Mapping[str, JointTruth], since_ns: int, until_ns: int, *, except_for: str = "") -> list[str]:
    """Which joints moved although nobody asked for it between two instants."""
    found = []
    for name, joint in truth.items():
        times_ns = np.arange(since_ns, until_ns, STEP_NS)
        moved_rad = float(np.ptp(joint.position_at(times_ns))) if len(times_ns) else 0.0
        if name != except_for and moved_rad > 0.0:
            found.append(f"{name} moved {math.degrees(moved_rad):.4f}° after it should have stood")
    return found


def stands_since_ns(truth: Mapping[str, JointTruth], until_ns: int) -> int:
    """The instant since which no joint has moved, up to until_ns."""
    last_ns = 0
    for joint in truth.values():
        moving = joint.times_ns[:-1][np.abs(joint.velocity_rad_s[:-1]) > STANDS_RAD_S]
        if len(moving):
            after = np.searchsorted(joint.times_ns, moving[-1], side="right")
            last_ns = max(last_ns, int(joint.times_ns[min(after, len(joint.times_ns) - 1)]))
    return min(last_ns, until_ns)


# --- the wire --------------------------------------------------------------------------------------------------


class WireFrame(NamedTuple):
    """An extended frame as it stood in the bytes for the adapter."""

    time_ns: int
    can_id: int
    data: bytes

    @property
    def drive(self) -> int:
        return self.can_id >> 8


def frames_sent(chunks: Collection[tuple[int, bytes]]) -> list[WireFrame]:
    """Every frame in what was written to the adapter, decoded from its characters; raises ValueError on a bad line."""
    frames = []
    rest = b""
    for time_ns, data in chunks:
        *lines, rest = (rest + data).split(b"\r")
        for line in lines:
            if not line.startswith(b"T"):
                continue
            match = _FRAME.fullmatch(line)
            if match is None or len(match[3]) != 2 * int(match[2]):
                raise ValueError(f"{line!r} is no SLCAN line")
            frames.append(WireFrame(time_ns, int(match[1], 16), bytes.fromhex(match[3].decode())))
    return frames


def command_violations(arm: ArmConfig, frames: Collection[WireFrame]) -> list[str]:
    """Position commands that are not whole, name no drive of the arm, or lead beyond a limit of it."""
    found = []
    joints = {joint.drive.address: joint for joint in arm.joints if isinstance(joint.drive, ZdtDrive)}
    halves: dict[int, bytes] = {}
    for frame in frames:
        joint = joints.get(frame.drive)
        if joint is None:
            found.append(f"a frame for drive {frame.drive}, which the arm does not have")
            continue
        if frame.drive in halves and (frame.can_id & 255 != 1 or frame.data[:1] != b"\xfd"):
            found.append(f"{joint.name}: half a position command, then {frame.data.hex(' ')}")
            del halves[frame.drive]
        if frame.data[:1] == b"\xfc":
            found += [f"{joint.name}: {text}" for text in _wrong_fast_target(joint, frame.data)]
        if frame.data[:1] != b"\xfd":
            continue
        if frame.can_id & 255 == 0:
            halves[frame.drive] = frame.data
        elif frame.drive not in halves:
            found.append(f"{joint.name}: the second half of a position command without its first")
        else:
            found += [f"{joint.name}: {text}" for text in _wrong_target(joint, halves.pop(frame.drive) + frame.data)]
    return found


def motion_frames(frames: Collection[WireFrame], drive: int, since_ns: int) -> int:
    """Position commands for a drive after an instant."""
    return sum(f.drive == drive and f.data[:1] in MOVES and f.time_ns > since_ns for f in frames)


def stopped_joints(arm: ArmConfig, frames: Collection[WireFrame]) -> set[str]:
    """Joints whose drive was told to stop at once, as one that was silent is."""
    stopped = {frame.drive for frame in frames if frame.data[:2] == STOP}
    return {joint.name for joint in arm.joints if isinstance(joint.drive, ZdtDrive) and joint.drive.address in stopped}


def led_after_its_stop(arm: ArmConfig, frames: Collection[WireFrame]) -> list[str]:
    """Motion frames to a drive after its stop command: there are none before it is referenced again."""
    found = []
    for joint in arm.joints:
        if not isinstance(joint.drive, ZdtDrive):
            continue
        heard = [frame.data for frame in frames if frame.drive == joint.drive.address]
        stop = next((n for n, data in enumerate(heard) if data[:2] == STOP), len(heard))
        if any(data[:1] in MOVES for data in heard[stop:]):  # by their order: what waited together arrives at one time
            found.append(f"{joint.name} was led after its stop command")
    return found


def _wrong_target(joint: JointConfig, command: bytes) -> list[str]:
    # FD dir rpm16 acc pulses(3 of 4) | FD pulses(last) mode sync 6B
    if len(command) != 13 or command[-1] != 0x6B or command[10] != 1:
        return [f"{command.hex(' ')} is no absolute position command"]
    found = _outside(joint, int.from_bytes(command[5:8] + command[9:10], "big") * (-1 if command[1] else 1))
    velocity_rad_s = int.from_bytes(command[2:4], "big") * _rad_s_per_rpm(joint)
    if velocity_rad_s > VELOCITY_SHARE * joint.max_velocity_rad_s + _rad_s_per_rpm(joint):
        found.append(f"speed {velocity_rad_s:.3f} rad/s, allowed {joint.max_velocity_rad_s:.3f}")
    return found


def _wrong_fast_target(joint: JointConfig, command: bytes) -> list[str]:
    if len(command) != 6 or command[-1] != 0x6B:
        return [f"a position command that is not whole: {command.hex(' ')}"]
    return _outside(joint, int.from_bytes(command[1:5], "big", signed=True))


def _outside(joint: JointConfig, pulses: int) -> list[str]:
    target_rad = joint.direction * pulses / joint.command_pulses_per_rad - joint.zero_rad
    slack_rad = (PULSES_OUTSIDE + 1) * joint.command_pulse_rad
    inside = joint.lower_rad - slack_rad <= target_rad <= joint.upper_rad + slack_rad
    return [] if inside else [f"target {math.degrees(target_rad):.3f}° lies outside its limits"]


def _beyond(joint: JointConfig, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> list[str]:
    found = []
    slack_rad = PULSES_OUTSIDE * joint.command_pulse_rad
    lowest, highest = position_rad.min(initial=joint.upper_rad), position_rad.max(initial=joint.lower_rad)
    for reached_rad in (min(lowest, joint.lower_rad - slack_rad), max(highest, joint.upper_rad + slack_rad)):
        if not joint.lower_rad - slack_rad <= reached_rad <= joint.upper_rad + slack_rad:
            found.append(f"{math.degrees(reached_rad):.3f}° is outside {joint.lower_deg:g}° to {joint.upper_deg:g}°")
    fastest = float(np.abs(velocity_rad_s).max(initial=0.0))
    limit = VELOCITY_SHARE * joint.max_velocity_rad_s + _rad_s_per_rpm(joint)
    if fastest > limit:
        found.append(f"{fastest:.3f} rad/s, allowed {limit:.3f}")
    return found


def _rad_s_per_rpm(joint: JointConfig) -> float:
    return 2.0 * math.pi / 60.0 / joint.ratio
