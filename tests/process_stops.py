"""Trials in which a person stops an arm at a random moment, whatever clients, streams and floods go on sending.

They send until long after the stop's bound, and the person resumes the arm when they have ended. Commanded motion is
judged by the flight recorder, cycle by cycle, true motion by the simulated drives.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial

import numpy as np
from fault_rig import BACK_S, Hang, Rig, wait
from observer import command_violations, frames_sent, motion_after, motion_violations, stopped_joints
from process_faults import LONGEST_STOP_S, NS, Trial
from random_ways import shortest_stop_s
from stop_crowd import SENDERS

from rtarm.running import requests
from shm import files
from shm.recording import read_recording

BY_COMMAND, BY_SERVICE, BESIDE_SUSPENDED = "rtarm stop", "~/stop", "rtarm stop while a process that asks is suspended"
LATEST_S = 2.0
"""Of the moment at which the stop is pressed, once the arm moves."""
MOTION_S = 20.0
STANDS_S = 1.0
"""After the stop's bound nothing moves for so long, while everybody goes on sending."""
FOLLOWS_S = 0.5
"""A drive stands on its target within this time."""


def stop_kinds() -> list[Trial]:
    """One trial of each kind."""
    return [
        Trial(f"{by}, beside {sender}", "person", True, act=partial(stop_beside, sender=sender, by=by))
        for sender in SENDERS
        for by in (BY_COMMAND, BY_SERVICE, BESIDE_SUSPENDED)
    ]


def stop_beside(rig: Rig, trial: Trial, *, sender: str, by: str) -> None:
    """A stop at a random moment, its judgement, and a goal after the resume; raises Hang."""
    seed = str(rig.random.integers(1 << 30))
    began_ns = time.monotonic_ns()
    crowd = rig.start("stop_crowd", sender, str(rig.arm_file), seed, needs_ros=True)
    try:
        crowd.line_with("ready")
        wait(lambda: _moves(rig), "motion", MOTION_S)
        moment_s = rig.random.uniform(0.0, LATEST_S)
        time.sleep(moment_s)  # the random moment itself
        trial.what = f"pressed {moment_s:.2f} s after the arm began to move, sender's seed {seed}"
        with _suspended(rig) if by == BESIDE_SUSPENDED else nullcontext():
            pressed_ns = (_by_service if by == BY_SERVICE else _by_command)(rig, trial)
            until_ns = pressed_ns + round((LONGEST_STOP_S + STANDS_S) * NS)
            wait(lambda: time.monotonic_ns() > until_ns, "the end of the time to stand", BACK_S)
            _judge(rig, trial, began_ns, pressed_ns)
        if crowd.process.poll() is not None:
            raise Hang(f"who sends ended: {crowd.said()[-500:]}")
    finally:
        crowd.close()
        _resume(rig, trial)
    trial.violations += rig.goal_succeeds(trial.notes, trial.steps)


def _moves(rig: Rig) -> bool:
    snapshot = rig.snapshot()
    return snapshot is not None and bool(np.any(snapshot["joints"]["commanded_velocity_rad_s"]))


def _by_command(rig: Rig, trial: Trial) -> int:
    """When the command pressed it: the time that it took to start is none of the arm's."""
    typed_ns = time.monotonic_ns()
    process = rig.start("rtarm", "stop", rig.name)
    if process.code() != 0:
        trial.violations.append(f"rtarm stop ended with {process.code()}: {process.text[-300:]}")
    command = files.open_command(rig.name)
    pressed_ns = int(command.record["stop_ns"][0])
    command.close()
    if pressed_ns < typed_ns:
        raise Hang(f"rtarm stop asked for no stop: {process.text[-300:]}")
    trial.notes.append(f"pressed {(pressed_ns - typed_ns) / 1e6:.0f} ms after the command was typed")
    return pressed_ns


def _by_service(rig: Rig, trial: Trial) -> int:
    """When the service was called."""
    pressed_ns = time.monotonic_ns()
    refused = rig.user.order("stop")
    if refused:
        trial.violations.append(f"~/stop was refused: {refused}")
    return pressed_ns


@contextmanager
def _suspended(rig: Rig) -> Iterator[None]:
    """A process that asks something of the arm stands still with the producers' lock in its hands."""
    process = rig.start("stop_crowd", "suspended", str(rig.arm_file), "0")
    try:
        process.line_with("ready")
        yield
    finally:
        process.close()


def _judge(rig: Rig, trial: Trial, began_ns: int, pressed_ns: int) -> None:
    reader = rig.reader()
    if reader is None:
        raise Hang("the control process ended")
    truth, now_ns = rig.truth(), time.monotonic_ns()
    records = read_recording(reader.memory).records
    times_ns, joints = records["monotonic_ns"], records["joints"]
    if times_ns[0] > pressed_ns:
        raise Hang("the flight recorder has lost the moment of the stop")
    at = int(np.searchsorted(times_ns, pressed_ns, side="right")) - 1
    velocity_rad_s = joints["commanded_velocity_rad_s"][at]
    position_rad = joints["commanded_position_rad"]
    moves = np.any(np.diff(position_rad[at:], axis=0) != 0.0, axis=1)
    rest_ns = int(times_ns[at + 1 :][moves][-1]) if moves.any() else pressed_ns
    trial.outcome = "stood already"
    if np.any(velocity_rad_s):
        trial.outcome = "stopped"
        trial.stands_ms = max(rest_ns - pressed_ns, 0) / 1e6
        trial.shortest_ms = 1e3 * shortest_stop_s(rig.arm.joints, velocity_rad_s)
    if rest_ns > pressed_ns + LONGEST_STOP_S * NS:
        trial.violations.append(f"commanded motion {(rest_ns - pressed_ns) / 1e6:.0f} ms after the stop")
    if not records["held"][-1] or records["goal_id"][-1]:
        trial.violations.append(f"held {records['held'][-1]}, goal {records['goal_id'][-1]} after the stop")
    trial.violations += motion_after(truth, max(rest_ns, pressed_ns) + round(FOLLOWS_S * NS), now_ns)
    frames = frames_sent([piece for piece in rig.wire() if piece[0] >= began_ns])
    thrown = stopped_joints(rig.arm, frames)
    trial.violations += motion_violations(rig.arm, truth, began_ns, now_ns, thrown=thrown)
    trial.violations += command_violations(rig.arm, frames)


def _resume(rig: Rig, trial: Trial) -> None:
    """By which nothing begins that was sent before; goals run at their own speed again."""
    if not rig.pid("loop"):
        return
    stood = rig.snapshot()
    with requests.connect(rig.name) as connection:
        connection.writer.scale(1.0)
    requests.resume(rig.name)
    time.sleep(FOLLOWS_S)  # in which nothing may begin to move
    if stood is None or not stood["held"]:
        trial.violations.append("it was not held any more when it was resumed")
    elif (rig.commanded_rad() != stood["joints"]["commanded_position_rad"][: len(rig.arm.joints)]).any():
        trial.violations.append("the resume moved the arm")
