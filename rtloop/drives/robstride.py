"""RobStride motors and the Xiaomi CyberGear in the cycle.

`rtloop.drives.robstride_protocol` says what stands in their frames.

Mode control: the motor follows set-points. It answers each of them with all it measures, so nothing else is asked.

Modes position and csp: the motor's own position loop, a gain on the distance to the target within a speed limit,
without a known ramp (run mode 1 of RobStrides has one and ignores this speed limit; 5 is like the CyberGear's 1). A
target at the set-point would be followed 1/gain late and in steps. So the motor is commanded like drives with a ramp:
the speed limit sets the pace, and the target lies so far ahead that the limit counts until the next frame: by the
motion of a period, of the frame's delay, and by the distance at which the loop begins to slow down (speed / gain). When
it receives nothing more, it therefore goes on for that long and stops on the target, braking with no more than
speed × gain.
"""

import math

from compilation.jit import jit
from config.drives.robstride import CONTROL, READ, TYPE_BIT, WRITE
from rtloop.drives import following, leading, receiving, words
from rtloop.drives import robstride_protocol as protocol
from rtloop.drives.errors import meanings
from rtloop.memory import status as status_bits
from rtloop.memory.buses import bus_of, round_of
from rtloop.memory.frame_words import EXTENDED
from rtloop.memory.state import Loop
from rtloop.safety import monitor, setpoint_check
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from rtloop.trajectory.limits import clamped_rad
from rtloop.wire import outgoing
from shm.layout import StateFile

FIELD_SHARE = 0.75

FLAG_MEANINGS = meanings(protocol.FAULTS, every=0x3F)


@jit
def identifier(loop: Loop, joint: int, kind: int, data16: int) -> int:
    """The CAN identifier of a frame of type `kind` to the joint's motor."""
    return int(kind << TYPE_BIT | data16 << 8 | loop.joints[joint].address)


@jit
def set_point(loop: Loop, joint: int, position: float, velocity: float) -> int:
    """Data of type 1; position and velocity are those of the output shaft (rad, rad/s)."""
    row = loop.joints[joint]
    place = words.placed_field(protocol.PLACE, position, row.range_rad)
    speed = words.placed_field(protocol.SPEED, velocity, row.range_rad_s)
    return int(place | speed | row.gains_word)


@jit
def parameter(index: int, value: float) -> int:
    """Data of type 18, and with value 0 of type 17."""
    return int(words.placed(protocol.INDEX, index) | words.placed_single(protocol.VALUE, value))


@jit
def send_set_point(loop: Loop, joint: int, shared: StateFile, position: float, velocity: float, stops: int) -> bool:
    """Send a set-point of type 1 (rad and rad/s of the output shaft); False if the transmit buffer has no room."""
    frame_id, data = identifier(loop, joint, CONTROL, protocol.NO_TORQUE), set_point(loop, joint, position, velocity)
    sent = outgoing.send(loop, shared, joint, frame_id, EXTENDED, 8, data, 0, stops)
    return told(loop, joint, sent)


@jit
def send_target(loop: Loop, joint: int, shared: StateFile, speed: float, target: float, stops: int) -> bool:
    """Send speed limit and target of the motor's own position loop (rad/s and rad of its output shaft)."""
    frame_id = identifier(loop, joint, WRITE, loop.joints[joint].host_id)
    if not outgoing.has_room(bus_of(loop, joint), 2):
        return False
    outgoing.send(loop, shared, joint, frame_id, EXTENDED, 8, parameter(protocol.SPEED_LIMIT, speed), 1)
    receiving.note_question(loop, joint)
    sent = outgoing.send(
        loop, shared, joint, frame_id, EXTENDED, 8, parameter(protocol.POSITION_TARGET, target), 0, stops
    )
    return told(loop, joint, sent)


@jit
def told(loop: Loop, joint: int, sent: bool) -> bool:
    """Take note that a frame, if it was sent, will be answered with the position; `sent`."""
    if sent:
        loop.axes[joint].sent.asked_cycle = loop.timing.cycle
        receiving.note_question(loop, joint)
    return sent


@jit
def target_ahead(loop: Loop, joint: int) -> tuple[float, float]:
    """Target (rad) and speed limit (rad/s) of the joint for the motor's position loop; see the head of this file."""
    row, axis = loop.joints[joint], loop.axes[joint]
    target, speed = leading.target_ahead(loop, joint, 0.0)
    if axis.commanded.velocity_rad_s == 0.0 and axis.commanded.next_velocity_rad_s == 0.0:
        return target, ERROR_SPEED_SHARE * row.max_velocity_rad_s
    target += speed / row.position_gain_1_s
    return clamped_rad(row, target), abs(speed)


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send a set-point in mode control, else a target and a speed limit."""
    row = loop.joints[joint]
    if row.position_gain_1_s == 0.0:
        position, velocity = following.setpoint(loop, joint)
        velocity *= row.command_per_rad
        if setpoint_check.may_be_sent(loop, shared, joint, position, velocity):
            send_set_point(loop, joint, shared, (position + row.zero_rad) * row.command_per_rad, velocity, -1)
    else:
        target, speed = target_ahead(loop, joint)
        speed *= abs(row.command_per_rad)
        if setpoint_check.may_be_sent(loop, shared, joint, target, speed):
            send_target(loop, joint, shared, speed, (target + row.zero_rad) * row.command_per_rad, -1)


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the motor to hold its measured position; its stop (type 4) would let the joint fall.

    Without new commands the motor stands at its last target, so nothing is sent if its position is not known.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    if not monitor.knows_where_it_stands(loop, joint):
        return True
    here = (axis.measured.position_rad + row.zero_rad) * row.command_per_rad
    if row.position_gain_1_s == 0.0:
        return send_set_point(loop, joint, shared, here, 0.0, joint)
    speed = ERROR_SPEED_SHARE * row.max_velocity_rad_s * abs(row.command_per_rad)
    return send_target(loop, joint, shared, speed, here, joint)


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if loop.axes[joint].sent.asked_cycle == loop.timing.cycle:
        return
    frame_id = identifier(loop, joint, READ, loop.joints[joint].host_id)
    if outgoing.send(loop, shared, joint, frame_id, EXTENDED, 8, protocol.POSITION):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask for the voltage, or every other time for a feedback if no motion command of this cycle is answered with one.

    The request for a feedback sets the target of the motor's speed mode to 0, which moves nothing in any mode.
    """
    host_id = loop.joints[joint].host_id
    turn = round_of(loop, joint)
    if loop.axes[joint].sent.asked_cycle == loop.timing.cycle or turn & 1:
        outgoing.send(loop, shared, joint, identifier(loop, joint, READ, host_id), EXTENDED, 8, protocol.VOLTAGE)
    elif outgoing.send(
        loop, shared, joint, identifier(loop, joint, WRITE, host_id), EXTENDED, 8, parameter(protocol.SPEED_TARGET, 0.0)
    ):
        receiving.note_question(loop, joint)


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Service dialogues stop the motor by other means."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Every frame is answered with a position, except a request to read another parameter."""
    if frame_id >> TYPE_BIT != READ or words.whole(data, protocol.INDEX) == protocol.POSITION:
        receiving.note_question(loop, joint)


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store a feedback (type 2), a parameter that was read (17) or a fault (21)."""
    said = frame_id >> TYPE_BIT
    if length != 8:
        return
    if said == protocol.FEEDBACK:
        receive_feedback(loop, joint, frame_id, data, time_ns)
    elif said == READ and (frame_id >> protocol.FAULT_BIT) & 0xFF == 0:
        receive_parameter(loop, joint, words.whole(data, protocol.INDEX), words.single(data, protocol.VALUE), time_ns)
    elif said == protocol.FAULT and words.whole(data, protocol.FAULT_WORD) != 0:
        receiving.receive_status(loop, joint, fault_status(words.whole(data, protocol.FAULT_WORD)))


@jit
def receive_feedback(loop: Loop, joint: int, frame_id: int, data: int, time_ns: int) -> None:
    """Store position, velocity, torque, temperature and status of a feedback."""
    row = loop.joints[joint]
    position = words.field_at(data, protocol.PLACE, row.range_rad)
    velocity = words.field_at(data, protocol.SPEED, row.range_rad_s)
    torque = words.field_at(data, protocol.TORQUE, row.range_nm)
    angle = position / row.reading_per_rad - row.zero_rad
    receiving.receive_position(loop, joint, beyond_its_field(loop, joint, angle), time_ns)
    receiving.receive_velocity(loop, joint, velocity / row.reading_per_rad)
    receiving.receive_effort(loop, joint, torque * row.effort_per_unit)
    receiving.receive_temperature(loop, joint, words.quantity(data, protocol.TEMPERATURE_C))
    mode, faults = (frame_id >> protocol.MODE_BIT) & 3, (frame_id >> protocol.FAULT_BIT) & 0x3F
    receiving.receive_status(loop, joint, common_status(mode, faults))


@jit
def beyond_its_field(loop: Loop, joint: int, angle_rad: float) -> float:
    """The joint's angle (rad) by the position field, which may have gone on at its other end.

    That is taken to be so if the angle is more than three quarters of the field's range from the last measured one. A
    motor that lost its power counts within a turn, which is never that far from a position within the field.
    """
    axis, row = loop.axes[joint], loop.joints[joint]
    field_rad = 2.0 * row.range_rad / abs(row.reading_per_rad)
    jump_rad = angle_rad - axis.measured.position_rad
    if axis.measured.readings == 0 or abs(jump_rad) <= FIELD_SHARE * field_rad:
        return angle_rad
    return angle_rad - math.copysign(field_rad, jump_rad)


@jit
def receive_parameter(loop: Loop, joint: int, index: int, value: float, time_ns: int) -> None:
    """Store a position, velocity or supply voltage that was read as a parameter."""
    row = loop.joints[joint]
    if not math.isfinite(value):
        return
    if index == protocol.POSITION:
        receiving.receive_position(loop, joint, value / row.reading_per_rad - row.zero_rad, time_ns)
    elif index == protocol.VELOCITY:
        receiving.receive_velocity(loop, joint, value / row.reading_per_rad)
    elif index == protocol.VOLTAGE:
        receiving.receive_voltage(loop, joint, value)


@jit
def common_status(mode: int, faults: int) -> int:
    """State and faults of a feedback in common bits (`memory.status`)."""
    return words.meaning(faults, FLAG_MEANINGS) | (status_bits.ENABLED if mode == protocol.RUN else 0)


@jit
def fault_status(fault: int) -> int:
    """The word of type 21 in common bits; its other bits are overload and the driver chip."""
    return words.meaning(fault, protocol.FAULT_MEANINGS) | status_bits.PROTECTED
