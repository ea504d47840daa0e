"""MKS SERVO42D/57D steppers in the cycle.

`rtloop.drives.mks_protocol` says what stands in their frames.

Streaming: a target ahead, and a speed that sets the pace (`rtloop.drives.leading`), as with ZDT drives.
"""

from compilation.jit import jit
from config.drives.mks import FARTHEST_COUNTS
from rtloop.drives import leading, receiving, words
from rtloop.drives import mks_protocol as protocol
from rtloop.memory import status as status_bits
from rtloop.memory.buses import round_of
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.memory.state import Loop
from rtloop.safety import setpoint_check
from rtloop.wire import outgoing
from shm.layout import StateFile
from shm.words import Unreferenced


@jit
def checksum(frame_id: int, data: int, length: int) -> int:
    """The checksum of a frame's identifier and the first `length` bytes of its data."""
    total = frame_id
    for at in range(length):
        total += (data >> (8 * at)) & 255
    return total & 255


@jit
def closed(frame_id: int, data: int, length: int) -> int:
    """Data of a frame with its checksum behind the first `length` bytes."""
    return data | checksum(frame_id, data, length) << (8 * length)


@jit
def pack_target(can_id: int, rpm: int, acc_byte: int, counts: int) -> int:
    """Data of `F5`: rpm 0 to 3000, acc 0 to 255, target in counts, clamped to the range of an int24."""
    target = words.placed(protocol.TARGET_COUNTS, min(max(counts, -FARTHEST_COUNTS), FARTHEST_COUNTS))
    data = protocol.MOVE | words.placed(protocol.TARGET_RPM, rpm) | words.placed(protocol.TARGET_ACC, acc_byte) | target
    return closed(can_id, data, protocol.TARGET_BYTES)


@jit
def is_sound(frame_id: int, data: int, length: int) -> bool:
    """Whether the last byte is the right checksum."""
    if length < 2:
        return False
    return bool((data >> (8 * (length - 1))) & 255 == checksum(frame_id, data, length - 1))


@jit
def send(loop: Loop, shared: StateFile, joint: int, data: int, length: int, stops: int = -1) -> bool:
    """Send `length` bytes and their checksum; False if the transmit buffer has no room."""
    can_id = loop.joints[joint].address
    packed = closed(can_id, data, length)
    return bool(outgoing.send(loop, shared, joint, can_id, STANDARD, length + 1, packed, 0, stops))


@jit
def halt(loop: Loop, joint: int) -> int:
    """Data of `F5` with speed 0, without its checksum: stop along the ramp of every motion, wherever that ends."""
    return int(protocol.MOVE | words.placed(protocol.TARGET_ACC, loop.joints[joint].acc_byte))


# --- what the cycle asks of a family of drives


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send target and speed; the remainder of the speed's rounding is carried over to the next period."""
    row = loop.joints[joint]
    # whole rpm keep the mean by being up to half an rpm off for a period
    target_rad, speed_rad_s = leading.target_ahead(loop, joint, 0.5 / row.rpm_per_rad_s)
    if not setpoint_check.may_be_sent(loop, shared, joint, target_rad, speed_rad_s):
        return
    rpm = leading.whole_rpm(loop, joint, speed_rad_s, protocol.HIGHEST_RPM)
    counts = words.bounded((target_rad + row.zero_rad) * row.command_per_rad, FARTHEST_COUNTS)
    outgoing.send(loop, shared, joint, row.address, STANDARD, 8, pack_target(row.address, rpm, row.acc_byte, counts))


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command a halt along the ramp, after which the drive holds.

    `F7` is sent first if a homing run may be under way: it alone ends one, but is not recommended above 1000 rpm.
    """
    if loop.axes[joint].reference.unreferenced_reason == Unreferenced.NOT_HOMED:
        send(loop, shared, joint, protocol.EMERGENCY_STOP, 1)
    return send(loop, shared, joint, halt(loop, joint), protocol.TARGET_BYTES, joint)


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if send(loop, shared, joint, protocol.READ_POSITION, 1):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask in turn whether the drive is enabled and whether it has stalled; after a bad answer, ask the same again."""
    axis = loop.axes[joint]
    asked = protocol.READ_STALLED if round_of(loop, joint) & 1 else protocol.READ_ENABLED
    if axis.checks.bad_statuses > 0:
        asked = protocol.READ_STALLED if axis.drive.status & status_bits.PROTECTED else protocol.READ_ENABLED
    send(loop, shared, joint, asked, 1)


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Whether a frame is the halt."""
    return bool(data == closed(frame_id, halt(loop, joint), protocol.TARGET_BYTES))


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Count a service dialogue's question for the position, which will be answered too."""
    if data == closed(frame_id, protocol.READ_POSITION, 1):
        receiving.note_question(loop, joint)


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store a position, a status or a refused motion command; other frames are ignored."""
    if kind & (EXTENDED | REMOTE) != 0 or not is_sound(frame_id, data, length):
        return
    row, axis = loop.joints[joint], loop.axes[joint]
    code, value = words.whole(data, protocol.CODE), words.whole(data, protocol.VALUE)
    if length == 8 and code == protocol.READ_POSITION:
        angle_rad = words.whole(data, protocol.COUNTS) / row.reading_per_rad - row.zero_rad
        receiving.receive_position(loop, joint, angle_rad, time_ns)
    elif length == 3 and code == protocol.READ_ENABLED and value <= 1:
        receiving.receive_status(loop, joint, axis.drive.status & PROTECTION | value * status_bits.ENABLED)
    elif length == 3 and code == protocol.READ_STALLED and value <= 1 and axis.drive.status & status_bits.ANSWERED != 0:
        stalled = status_bits.STALLED if axis.drive.holds_stalled == 1 else PROTECTION
        receiving.receive_status(loop, joint, axis.drive.status & status_bits.ENABLED | value * stalled)
    elif length == 3 and code == protocol.MOVE and value in (protocol.REFUSED, protocol.STOPPED_AT_LIMIT):
        receiving.receive_refusal(loop, shared, joint, True)


PROTECTION = status_bits.PROTECTED | status_bits.STALLED
"""Status bits of a tripped protection: the motor was stalled, and its shaft has no torque."""
