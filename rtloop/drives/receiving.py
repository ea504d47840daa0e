"""Store what a drive has reported in its joint's record: the drive families decode their frames and call these.

Positions, velocities and efforts are those of the joint.
"""

from compilation.jit import jit
from rtloop.memory.axis import QUESTIONS
from rtloop.memory.buses import bus_of
from rtloop.memory.state import Loop
from rtloop.safety import monitor
from shm.layout import StateFile


@jit
def receive_position(loop: Loop, joint: int, position_rad: float, time_ns: int) -> None:
    """Store a position; it counts once all bytes of the cycle are read, so that a duplicate or a burst counts once.

    An answer and a report consist of the same bytes: a position that comes while no question is open is a report.
    `time_ns` is when the frame arrived.
    """
    axis, row = loop.axes[joint], loop.joints[joint]
    reply = axis.reply
    delay_ns = row.reply_delay_ns
    if reply.questions > 0:
        reply.questions -= 1
    else:
        reply.reports += 1
        reply.has_report = 1
        if loop.params.reported == 1:
            delay_ns = row.report_delay_ns
    reply.is_new = 1
    reply.position_rad = position_rad
    reply.time_ns = time_ns - delay_ns


@jit
def note_question(loop: Loop, joint: int) -> None:
    """Count a question for a drive's position, so that its answer is not taken for a report."""
    loop.axes[joint].reply.questions = min(loop.axes[joint].reply.questions + 1, QUESTIONS)


@jit
def receive_velocity(loop: Loop, joint: int, velocity_rad_s: float) -> None:
    """Store the joint's velocity as its drive measures it."""
    loop.axes[joint].drive.velocity_rad_s = velocity_rad_s


@jit
def receive_effort(loop: Loop, joint: int, effort_nm: float) -> None:
    """Store the torque at the joint."""
    loop.axes[joint].drive.effort_nm = effort_nm


@jit
def receive_temperature(loop: Loop, joint: int, temperature_c: float) -> None:
    """Store the highest temperature that the drive reports."""
    loop.axes[joint].drive.temperature_c = temperature_c


@jit
def receive_voltage(loop: Loop, joint: int, voltage_v: float) -> None:
    """Store the drive's supply voltage."""
    loop.axes[joint].drive.voltage_v = voltage_v


@jit
def receive_status(loop: Loop, joint: int, status: int) -> None:
    """Take status bits (`rtloop.memory.status`); after a first bad one this drive is the next to be asked."""
    bus = bus_of(loop, joint)
    bus.unacknowledged_since_ns = 0
    monitor.take_status(loop, joint, status)
    if loop.axes[joint].checks.bad_statuses == 1:
        bus.status_turn = joint - 1


@jit
def receive_refusal(loop: Loop, shared: StateFile, joint: int, of_motion: bool) -> None:
    """Count a command that a drive has refused, and of a motion command also for its joint."""
    shared.counters.drive_errors += 1
    if of_motion:
        monitor.take_refusal(loop, joint)
