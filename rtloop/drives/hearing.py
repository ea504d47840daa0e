"""What a drive has said, kept for its joint: families of drives decode their bytes and call these."""

from typing import Any

from rtloop.memory.state import QUESTIONS
from rtloop.safety import guard
from shm.jit import jit

Loop = Any  # record of dtype rtloop.memory.state.LOOP
Shared = Any  # record of dtype shm.layout.STATE


@jit
def hear_position(loop: Loop, joint: int, position_rad: float, time_ns: int) -> None:
    """Keep a position until everything has been heard: answers that come twice, late or in a burst count once.

    Answers and reports are the same bytes; what comes while no question is open is a report.
    """
    axis, row = loop.axes[joint], loop.joints[joint]
    delay_ns = row.reply_delay_ns
    if axis.questions > 0:
        axis.questions -= 1
    else:
        axis.unasked += 1
        axis.heard_unasked = 1
        if loop.params.reported == 1:
            delay_ns = row.report_delay_ns
    axis.heard = 1
    axis.heard_rad = position_rad
    axis.heard_ns = time_ns - delay_ns


@jit
def note_question(loop: Loop, joint: int) -> None:
    """A drive was asked for its position: an answer to come is no report."""
    loop.axes[joint].questions = min(loop.axes[joint].questions + 1, QUESTIONS)


@jit
def hear_velocity(loop: Loop, joint: int, velocity_rad_s: float) -> None:
    """Keep the joint's velocity as its drive measures it."""
    loop.axes[joint].told_velocity_rad_s = velocity_rad_s


@jit
def hear_effort(loop: Loop, joint: int, effort_nm: float) -> None:
    """Keep the torque at the joint."""
    loop.axes[joint].effort_nm = effort_nm


@jit
def hear_temperature(loop: Loop, joint: int, temperature_c: float) -> None:
    """Keep the highest temperature that the drive tells of itself."""
    loop.axes[joint].temperature_c = temperature_c


@jit
def hear_voltage(loop: Loop, joint: int, voltage_v: float) -> None:
    """Keep the drive's supply."""
    loop.axes[joint].voltage_v = voltage_v


@jit
def hear_status(loop: Loop, joint: int, status: int) -> None:
    """Take status bits (`rtloop.memory.status`); a drive that may be in trouble is asked again at once."""
    core = loop.core
    core.unheeded_since_ns = 0
    guard.take_status(loop, joint, status)
    if loop.axes[joint].bad_statuses == 1:
        core.status_turn = joint - 1


@jit
def hear_refusal(loop: Loop, shared: Shared, joint: int, of_motion: bool) -> None:
    """A drive does not do what it was told."""
    shared.counters.drive_errors += 1
    if of_motion:
        loop.axes[joint].refusals += 1
