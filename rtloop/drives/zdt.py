"""ZDT (Emm_V5) closed-loop stepper: numbers to CAN frames and back, in the cycle.

Protocol facts (what stands in the frames: `rtloop.drives.zdt_protocol`):
- `FD dir rpm16 acc pulses32 mode=01 sync=00 6B`, two packets: go to an absolute target with at most that
  speed and a ramp of 1 rpm every (256 - acc) · 50 µs;
- `36 6B` → `36 sign counts32 6B`, 65536 counts a turn; `3A 6B` → `3A flags 6B`; `FE 98 00 6B` stops at once;
- `3B 6B` → `3B flags 6B` tells whether heat (bit 4) or current (5) has tripped the protection; a stall is in `3A`.
  Only a drive in protection is asked for it, right before its status;
- acknowledgements are `func 02 6B`, refusals `func E2 6B`, misunderstandings `00 EE 6B` or `func EE 6B`.
Requests and replies share their ids. For every function used here they differ in length, which tells a reply from an
echo of the request.

Streaming: a target ahead, and a speed that sets the pace (`rtloop.drives.leading`).

`FC int32` sends a target alone, in one packet; `F1` has set speed, ramp and mode before
(`rtloop.drives.zdt_fast_targets`). With FC the pace is set by how far ahead the targets lie (`fast_target`).
"""

import math

from compilation.jit import jit
from rtloop.drives import leading, receiving, words
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.numbers import Number, word
from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import EXTENDED
from rtloop.memory.state import Loop
from rtloop.safety import setpoint_check
from rtloop.safety.outlier_filter import steady_error_rad
from rtloop.trajectory.correction import ERROR_SHARE_1_S
from rtloop.trajectory.limits import clamped_rad
from rtloop.wire import outgoing
from shm.layout import StateFile
from shm.words import Unreferenced

FAST_OFFSET_SHARE = 0.25
"""With FC the error shifts the target, by no more than this share of the target's distance from the setpoint."""

OTHER, POSITION, STATUS, REFUSED, ACCEPTED, CAUSE = range(6)
"""What a frame is, as `decode` says."""

NOWHERE = protocol.go_to(0, rpm=0, acc=0)
FIRST_PACKET, LAST_PACKET = word(NOWHERE[:8]), word(NOWHERE[:1] + NOWHERE[8:])
PULSES_FIRST, PULSES_LAST = protocol.MOVE_PULSES._replace(size=3), Number(1, 1)
"""`FD` in its two packets, which part the target."""
FAST_PACKET = word(protocol.fast_target(0))
READ_POSITION, READ_STATUS = word(protocol.ASK_POSITION), word(protocol.ASK_STATUS)
READ_CAUSE = word(protocol.ASK_HOMING_STATUS)
STOP, END_HOMING = word(protocol.STOP), word(protocol.END_HOMING)


@jit
def pack_target(rpm: int, acc_byte: int, pulses: int) -> tuple[int, int]:
    """Data words of the two packets of `FD` with an absolute target; first byte lowest."""
    magnitude = min(abs(pulses), 0xFFFFFFFF)
    first = FIRST_PACKET | words.placed(protocol.MOVE_SIGN, 1 if pulses < 0 else 0)
    first |= words.placed(protocol.MOVE_RPM, rpm) | words.placed(protocol.MOVE_ACC, acc_byte)
    first |= words.placed(PULSES_FIRST, magnitude >> 8)
    return int(first), int(LAST_PACKET | words.placed(PULSES_LAST, magnitude))


@jit
def pack_fast_target(pulses: int) -> int:
    """Data word of `FC`; unlike that of `FD`, its target is a signed number. First byte lowest."""
    bounded = min(max(pulses, -0x80000000), 0x7FFFFFFF)
    return int(FAST_PACKET | words.placed(protocol.FAST_PULSES, bounded))


@jit
def to_pulses(loop: Loop, joint: int, position_rad: float) -> int:
    """A position of the joint in the drive's command pulses."""
    row = loop.joints[joint]
    return round((position_rad + row.zero_rad) * row.command_per_rad)


@jit
def to_radians(loop: Loop, joint: int, counts: int) -> float:
    """A position in the drive's encoder counts as the joint's angle (rad)."""
    row = loop.joints[joint]
    return counts / row.reading_per_rad - row.zero_rad


@jit
def fast_target(loop: Loop, joint: int) -> float:
    """The joint's target (rad) for the `FC` of the coming period.

    `F1` allows more speed than is planned, so the target sets the pace: a drive at a distance d from its target moves
    at no more than sqrt(2 a d), where a is its ramp. In each period the drive speeds up, meets that curve and brakes
    along it. At the end of the period, when the next target comes, it should be where the plan is. With a planned
    acceleration p the drive speeds up for the share (1 + p / a) / 2 of the period T; its speed swings by
    (1 - (p / a)²) a T / 2 about the planned speed and ends half of that below it. So the target lies ahead of the plan
    by the braking distance from this final speed.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    commanded, sent = axis.commanded, axis.sent
    period_s = loop.params.period_ns * 1e-9
    ramp = row.silence_deceleration_rad_s2
    acceleration = commanded.next_acceleration_rad_s2
    # the frame arrives command_delay_s into the cycle and is in force for one period from there
    velocity = commanded.next_velocity_rad_s + acceleration * row.command_delay_s
    target = commanded.next_position_rad
    if commanded.velocity_rad_s != 0.0 or commanded.next_velocity_rad_s != 0.0:
        share = min(abs(acceleration) / ramp, 1.0)
        speed = max(abs(velocity) - (1.0 - share * share) * ramp * period_s / 4.0, 0.0)
        brake = speed * speed / (2.0 * ramp)
        most = FAST_OFFSET_SHARE * (brake + abs(velocity) * period_s)
        sent.fast_offset_rad += ERROR_SHARE_1_S * period_s * steady_error_rad(axis, 2.0 * row.slack_rad)
        sent.fast_offset_rad = min(max(sent.fast_offset_rad, -most), most)
        target += velocity * row.command_delay_s + math.copysign(brake, velocity) + sent.fast_offset_rad
        target = clamped_rad(row, target)
    else:
        sent.fast_offset_rad = 0.0
    return float(target)


@jit
def decode(packet: int, length: int, data: int) -> tuple[int, int]:
    """(kind, value) of a frame from a drive.

    The value is counts for POSITION, common bits (`memory.status`) for STATUS and CAUSE, the function byte for REFUSED
    and ACCEPTED, and 0 for OTHER.
    """
    if packet != 0:
        return OTHER, 0
    function, code = words.whole(data, protocol.FUNCTION), words.whole(data, protocol.CODE)
    if length == 7 and function == READ_POSITION & 255:
        sign, counts = words.whole(data, protocol.COUNTS_SIGN), words.whole(data, protocol.COUNTS)
        if sign <= 1 and words.whole(data, protocol.COUNTS_END) == protocol.CHECKSUM:
            return POSITION, -counts if sign else counts
    elif length == 3 and words.whole(data, protocol.CODE_END) == protocol.CHECKSUM:
        if function == READ_STATUS & 255:
            return STATUS, words.meaning(code, protocol.STATUS_MEANINGS)
        if code in protocol.REFUSALS:
            return REFUSED, function
        if function == READ_CAUSE & 255:
            return CAUSE, words.meaning(code, protocol.CAUSE_MEANINGS)
        if code == protocol.ACCEPTED:
            return ACCEPTED, function
    return OTHER, 0


# --- what the cycle asks of a family of drives


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send `FC` or `FD`; the remainder of the rounding of the speed in `FD` is carried over to the next period."""
    row = loop.joints[joint]
    frame_id = row.address << 8
    if loop.params.fast_targets == 1:
        target = fast_target(loop, joint)
        if setpoint_check.may_be_sent(loop, shared, joint, target):
            outgoing.send(loop, shared, joint, frame_id, EXTENDED, 6, pack_fast_target(to_pulses(loop, joint, target)))
        return
    # whole rpm keep the mean by being up to half an rpm off for a period
    target, speed = leading.target_ahead(loop, joint, 0.5 / row.rpm_per_rad_s)
    if not setpoint_check.may_be_sent(loop, shared, joint, target, speed):
        return
    rpm = leading.whole_rpm(loop, joint, speed, protocol.HIGHEST_RPM)
    first, second = pack_target(rpm, int(row.acc_byte), to_pulses(loop, joint, target))
    outgoing.send(loop, shared, joint, frame_id, EXTENDED, 8, first, 1)
    outgoing.send(loop, shared, joint, frame_id | 1, EXTENDED, 5, second)


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the drive to stop where it is; False if the transmit buffer has no room."""
    frame_id = loop.joints[joint].address << 8
    if loop.axes[joint].reference.unreferenced_reason == Unreferenced.NOT_HOMED:
        # the drive may be in a homing run, which a stop need not end
        outgoing.send(loop, shared, joint, frame_id, EXTENDED, 3, END_HOMING)
    return bool(outgoing.send(loop, shared, joint, frame_id, EXTENDED, 4, STOP, 0, joint))


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if outgoing.send(loop, shared, joint, loop.joints[joint].address << 8, EXTENDED, 2, READ_POSITION):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask for the status; of a drive in protection, ask for the cause first, so that it is known before the status."""
    if loop.axes[joint].drive.status & status_bits.PROTECTED:
        outgoing.send(loop, shared, joint, loop.joints[joint].address << 8, EXTENDED, 2, READ_CAUSE)
    outgoing.send(loop, shared, joint, loop.joints[joint].address << 8, EXTENDED, 2, READ_STATUS)


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Whether a frame is the stop command."""
    return bool(data == STOP)


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Count a service dialogue's question for the position, which will be answered too."""
    if data == READ_POSITION:
        receiving.note_question(loop, joint)


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Decode and store a frame of the drive; `error_code` of the joint holds the cause of a tripped protection."""
    kind, value = decode(frame_id & 255, length, data)
    if kind == POSITION:
        receiving.receive_position(loop, joint, to_radians(loop, joint, value), time_ns)
    elif kind == STATUS:
        axis = loop.axes[joint]
        if value & status_bits.PROTECTED == 0:
            axis.drive.error_code = 0
        receiving.receive_status(loop, joint, value | axis.drive.error_code)
    elif kind == CAUSE:
        loop.axes[joint].drive.error_code = value
    elif kind == REFUSED:
        receiving.receive_refusal(loop, shared, joint, value in (protocol.MOVE, protocol.FAST_MOVE))
