"""MyActuator RMD motors in the cycle: targets ahead (`rtloop.drives.leading`) for a drive that plans its own ramp.

`rtloop.drives.myactuator_protocol` says what stands in their frames.

No answer says whether the motor holds its shaft. It is taken to hold if it has answered a motion command since it was
shut down (80), and unless it reports a locked brake after having reported a released one (motors without a brake may
report either).
"""

from compilation.jit import jit
from config.drives.myactuator import REQUEST
from rtloop.drives import leading, receiving, words
from rtloop.drives import myactuator_protocol as protocol
from rtloop.drives.errors import meanings
from rtloop.memory import status as status_bits
from rtloop.memory.axis import Axis
from rtloop.memory.buses import round_of
from rtloop.memory.frame_words import STANDARD
from rtloop.memory.state import Loop
from rtloop.safety import setpoint_check
from rtloop.wire import outgoing
from shm.layout import StateFile

HIGHEST_SPEED_DPS = 0xFFFF
HIGHEST_ANGLE = 0x7FFFFFFF
DPS_PER_RPM = 6.0

ERROR_MEANINGS = meanings(protocol.ERRORS, every=0xFFFF)


@jit
def identifier(loop: Loop, joint: int) -> int:
    """The CAN identifier of requests to the joint's motor."""
    return int(REQUEST + loop.joints[joint].address)


@jit
def target_with_speed(angle: int, speed_dps: int) -> int:
    """Data of A4: angle (0.01°) and speed limit (°/s) of the output shaft."""
    return int(
        protocol.TARGET
        | words.placed(protocol.TARGET_SPEED_DPS, speed_dps)
        | words.placed(protocol.TARGET_ANGLE, angle)
    )


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send target and speed; the remainder of the speed's rounding is carried over to the next period."""
    row, axis = loop.joints[joint], loop.axes[joint]
    dps_per_rad_s = abs(row.command_per_rad) / protocol.STEPS_PER_DEGREE
    target, speed = leading.target_ahead(loop, joint, 0.5 / dps_per_rad_s)
    if not setpoint_check.may_be_sent(loop, shared, joint, target, speed):
        return
    wanted_dps = abs(speed) * dps_per_rad_s + axis.sent.rpm_remainder * DPS_PER_RPM
    speed_dps = round(wanted_dps)
    axis.sent.rpm_remainder = min(max(wanted_dps - speed_dps, -1.0), 1.0) / DPS_PER_RPM
    angle = words.bounded((target + row.zero_rad) * row.command_per_rad, HIGHEST_ANGLE)
    data = target_with_speed(angle, min(max(speed_dps, 1), HIGHEST_SPEED_DPS))
    if outgoing.send(loop, shared, joint, identifier(loop, joint), STANDARD, 8, data):
        axis.sent.led_cycle = loop.timing.cycle


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command a stop with the loop closed (81); False if the transmit buffer has no room."""
    return bool(outgoing.send(loop, shared, joint, identifier(loop, joint), STANDARD, 8, protocol.STOP, 0, joint))


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if outgoing.send(loop, shared, joint, identifier(loop, joint), STANDARD, 8, protocol.ANGLE):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask for the status; every other time for speed and current, where no motion command of this cycle does so.

    After a bad status the status alone is asked for, so that the next one tells at once whether to believe it.
    """
    axis = loop.axes[joint]
    turn = round_of(loop, joint)
    silent = axis.sent.led_cycle != loop.timing.cycle and axis.checks.bad_statuses == 0
    what = protocol.FEEDBACK if silent and turn & 1 else protocol.STATUS
    outgoing.send(loop, shared, joint, identifier(loop, joint), STANDARD, 8, what)


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    return bool(data == protocol.STOP)


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    if data == protocol.ANGLE:
        receiving.note_question(loop, joint)


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store what an answer holds: the position (92), speed and torque (A4, 9C), the status (9A), or a shutdown (80)."""
    row, axis = loop.joints[joint], loop.axes[joint]
    said = words.whole(data, protocol.COMMAND)
    if length != 8:
        return
    if said == protocol.ANGLE:
        angle_rad = words.whole(data, protocol.READ_ANGLE) / row.reading_per_rad - row.zero_rad
        receiving.receive_position(loop, joint, angle_rad, time_ns)
    elif said in (protocol.TARGET, protocol.FEEDBACK):
        receiving.receive_temperature(loop, joint, words.quantity(data, protocol.TEMPERATURE_C))
        if row.effort_per_unit != 0.0:
            receiving.receive_effort(loop, joint, words.whole(data, protocol.CURRENT) * row.effort_per_unit)
        receiving.receive_velocity(loop, joint, words.quantity(data, protocol.SPEED) / row.reading_per_rad)
        if said == protocol.TARGET:
            axis.drive.is_disabled = 0
    elif said == protocol.STATUS:
        receiving.receive_temperature(loop, joint, words.quantity(data, protocol.TEMPERATURE_C))
        receiving.receive_voltage(loop, joint, words.quantity(data, protocol.VOLTAGE_V))
        enabled = holds(axis, words.whole(data, protocol.BRAKE_RELEASED))
        receiving.receive_status(loop, joint, common_status(enabled, words.whole(data, protocol.ERROR)))
    elif said == protocol.SHUTDOWN:
        axis.drive.is_disabled = 1


@jit
def holds(axis: Axis, brake: int) -> bool:
    """Whether a motor that reports `brake` (0: locked) holds its shaft; see the head of this file."""
    if brake != 0:
        axis.drive.brake_released = 1
    return bool(axis.drive.is_disabled == 0 and (brake != 0 or axis.drive.brake_released == 0))


@jit
def common_status(enabled: bool, error: int) -> int:
    """Whether the motor holds, and its error word, in common bits (`memory.status`)."""
    return words.meaning(error, ERROR_MEANINGS) | (status_bits.ENABLED if enabled else 0)
