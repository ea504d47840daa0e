"""MKS SERVO42D/57D steppers in the cycle: numbers to CAN frames and back.

Protocol facts (manual V1.0.6; mks-servo-can): standard identifiers, the drive's CanID in both directions; big-endian;
the last byte is the sum of the identifier and all bytes before it. 16384 counts a motor turn.
- `F5 rpm16 acc counts24`: go to an absolute target with at most that speed and a ramp of 1 rpm every (256 - acc) · 50
  µs, also in mid-move; with rpm 0 it is a halt along that ramp, after which the drive holds;
- `31` → `31 counts48`; `3A` → `3A enabled`; `3E` → `3E stalled`, which is a tripped protection only if one is turned on
  (V1.0.9); `F7` stops at once, homing runs too;
- results are `F5 code`: 0 refused, 1 begun, 2 done, 3 stopped at a limit, 5 waits for others.
For every function that is decoded here, request and answer differ in length, which tells an answer from an echo.

Streaming: a target ahead, and a speed that sets the pace (`rtloop.drives.leading`), as with ZDT drives.
"""

from compilation.jit import jit
from config.drives.mks import FARTHEST_COUNTS
from rtloop.drives import leading, receiving, words
from rtloop.drives.mks_setup import (
    EMERGENCY_STOP,
    HIGHEST_RPM,
    MOVE,
    READ_ENABLED,
    READ_POSITION,
    READ_STALLED,
    REFUSED,
    STOPPED_AT_LIMIT,
)
from rtloop.memory import status as status_bits
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
    target = min(max(counts, -FARTHEST_COUNTS), FARTHEST_COUNTS) & 0xFFFFFF
    return closed(can_id, MOVE | words.swapped(rpm, 2) << 8 | acc_byte << 24 | words.swapped(target, 3) << 32, 7)


@jit
def is_sound(frame_id: int, data: int, length: int) -> bool:
    """Whether the last byte is the right checksum."""
    if length < 2:
        return False
    return bool((data >> (8 * (length - 1))) & 255 == checksum(frame_id, data, length - 1))


@jit
def counts_of(data: int) -> int:
    """The position in an answer to `31` (an int48, in counts)."""
    value = words.swapped((data >> 8) & 0xFFFFFFFFFFFF, 6)
    return value - (1 << 48) if value >= 1 << 47 else value


@jit
def send(loop: Loop, shared: StateFile, joint: int, data: int, length: int, stops: int = -1) -> bool:
    """Send `length` bytes and their checksum; False if the transmit buffer has no room."""
    can_id = loop.joints[joint].address
    packed = closed(can_id, data, length)
    return bool(outgoing.send(loop, shared, can_id, STANDARD, length + 1, packed, 0, stops))


@jit
def halt(loop: Loop, joint: int) -> int:
    """Data of `F5` with speed 0, without its checksum: stop along the ramp of every motion, wherever that ends."""
    return int(MOVE | loop.joints[joint].acc_byte << 24)


# --- what the cycle asks of a family of drives


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send target and speed; the remainder of the speed's rounding is carried over to the next period."""
    row = loop.joints[joint]
    # whole rpm keep the mean by being up to half an rpm off for a period
    target_rad, speed_rad_s = leading.target_ahead(loop, joint, 0.5 / row.rpm_per_rad_s)
    if not setpoint_check.may_be_sent(loop, shared, joint, target_rad, speed_rad_s):
        return
    rpm = leading.whole_rpm(loop, joint, speed_rad_s, HIGHEST_RPM)
    counts = words.bounded((target_rad + row.zero_rad) * row.command_per_rad, FARTHEST_COUNTS)
    outgoing.send(loop, shared, row.address, STANDARD, 8, pack_target(row.address, rpm, row.acc_byte, counts))


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command a halt along the ramp, after which the drive holds.

    `F7` is sent first if a homing run may be under way: it alone ends one, but is not recommended above 1000 rpm.
    """
    if loop.axes[joint].reference.unreferenced_reason == Unreferenced.NOT_HOMED:
        send(loop, shared, joint, EMERGENCY_STOP, 1)
    return send(loop, shared, joint, halt(loop, joint), 7, joint)


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if send(loop, shared, joint, READ_POSITION, 1):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask in turn whether the drive is enabled and whether it has stalled; after a bad answer, ask the same again."""
    axis = loop.axes[joint]
    asked = READ_STALLED if (loop.timing.cycle // loop.params.joint_count) & 1 else READ_ENABLED
    if axis.checks.bad_statuses > 0:
        asked = READ_STALLED if axis.drive.status & status_bits.PROTECTED else READ_ENABLED
    send(loop, shared, joint, asked, 1)


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Whether a frame is the halt."""
    return bool(data == closed(frame_id, halt(loop, joint), 7))


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Count a service dialogue's question for the position, which will be answered too."""
    if data == closed(frame_id, READ_POSITION, 1):
        receiving.note_question(loop, joint)


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store a position, a status or a refused motion command; other frames are ignored."""
    if kind & (EXTENDED | REMOTE) != 0 or not is_sound(frame_id, data, length):
        return
    row, axis = loop.joints[joint], loop.axes[joint]
    code, value = data & 255, (data >> 8) & 255
    if length == 8 and code == READ_POSITION:
        receiving.receive_position(loop, joint, counts_of(data) / row.reading_per_rad - row.zero_rad, time_ns)
    elif length == 3 and code == READ_ENABLED and value <= 1:
        receiving.receive_status(loop, joint, axis.drive.status & PROTECTION | value * status_bits.ENABLED)
    elif length == 3 and code == READ_STALLED and value <= 1 and axis.drive.status & status_bits.ANSWERED != 0:
        stalled = status_bits.STALLED if axis.drive.holds_stalled == 1 else PROTECTION
        receiving.receive_status(loop, joint, axis.drive.status & status_bits.ENABLED | value * stalled)
    elif length == 3 and code == MOVE and value in (REFUSED, STOPPED_AT_LIMIT):
        receiving.receive_refusal(loop, shared, joint, True)


PROTECTION = status_bits.PROTECTED | status_bits.STALLED
"""Status bits of a tripped protection: the motor was stalled, and its shaft has no torque."""
