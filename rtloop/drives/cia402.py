"""CiA 402 in the cycle, in cyclic synchronous position mode: a target to each drive, one SYNC, an answer from each.

`rtloop.drives.cia402_protocol` says what stands in the frames.
"""

from compilation.jit import jit
from config.drives.cia402 import EMERGENCY, HEARTBEAT, HIGHEST_COUNT, RPDO1, RPDO1_BYTES, SYNC, TPDO1
from rtloop.drives import cia402_protocol as protocol
from rtloop.drives import following, receiving, words
from rtloop.drives.errors import code_meanings
from rtloop.memory import status as status_bits
from rtloop.memory.buses import bus_of
from rtloop.memory.frame_words import STANDARD
from rtloop.memory.state import Loop
from rtloop.safety import monitor, setpoint_check
from rtloop.trajectory.limits import clamped_rad
from rtloop.wire import outgoing
from shm.layout import StateFile
from shm.words import Unreferenced

ERROR_MEANINGS = code_meanings(protocol.ERRORS)


@jit
def target_data(counts: int) -> int:
    """Data of RPDO1: the controlword of an enabled drive, and a target in counts."""
    controlword = words.placed(protocol.WANTED_CONTROLWORD, protocol.ENABLE_OPERATION)
    return int(controlword | words.placed(protocol.WANTED_COUNTS, counts))


@jit
def setpoint_rad(loop: Loop, joint: int) -> float:
    """Where the joint should be when the drive reaches this cycle's target, a period after this cycle's SYNC (rad).

    The next setpoint is due a period after the start of the cycle; the SYNC arrives `command_delay_s` after that start.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    behind_s = row.command_delay_s
    position = axis.commanded.next_position_rad
    position += behind_s * (
        axis.commanded.next_velocity_rad_s + 0.5 * behind_s * axis.commanded.next_acceleration_rad_s2
    )
    return clamped_rad(row, position)


@jit
def send_target(loop: Loop, joint: int, shared: StateFile, position_rad: float, stops: int) -> bool:
    """Send a target of the joint as RPDO1; `stops` as in `outgoing.put`. False if the transmit buffer has no room."""
    row = loop.joints[joint]
    counts = words.bounded((position_rad + row.zero_rad) * row.command_per_rad, HIGHEST_COUNT)
    frame_id = RPDO1 + row.address
    return bool(outgoing.send(loop, shared, joint, frame_id, STANDARD, RPDO1_BYTES, target_data(counts), 0, stops))


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send the target of this cycle; a drive that got no targets for a while catches up gradually."""
    target_rad = setpoint_rad(loop, joint)
    target_rad -= following.still_behind_rad(loop, joint, target_rad)
    if setpoint_check.may_be_sent(loop, shared, joint, target_rad):
        send_target(loop, joint, shared, target_rad, -1)


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the drive to hold its measured position; a quick stop may switch its torque off (option code 605A).

    Without new targets the drive stands at its last one. So nothing is sent if the last reading is old or in doubt,
    because the drive would jump there, nor to a drive that has reported that it is disabled, because a target enables.
    """
    axis = loop.axes[joint]
    limp = axis.drive.status & status_bits.ANSWERED != 0 and axis.drive.status & status_bits.ENABLED == 0
    doubtful = axis.reference.referenced == 0 and axis.reference.unreferenced_reason == Unreferenced.POSITION_JUMP
    if limp or doubtful or not monitor.knows_where_it_stands(loop, joint):
        return True
    return send_target(loop, joint, shared, axis.measured.position_rad, joint)


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send a SYNC, once a cycle on each bus: all drives there answer with their position, with a new target or not."""
    bus = bus_of(loop, joint)
    if bus.sync_cycle != loop.timing.cycle:
        if not outgoing.send(loop, shared, joint, SYNC, STANDARD, 0, 0):
            return
        bus.sync_cycle = loop.timing.cycle
    receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send nothing: the status comes with every position."""


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Service dialogues stop the drive by other means."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Do nothing: service dialogues transfer objects, whose answers hold no position for the cycle."""


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store position, status and torque of TPDO1, the error code of an emergency, or a heartbeat out of operation."""
    row, axis = loop.joints[joint], loop.axes[joint]
    base = frame_id - row.address
    if base == TPDO1 and length == row.position_bytes:
        position_rad = words.whole(data, protocol.TOLD_COUNTS) / row.reading_per_rad - row.zero_rad
        statusword = words.whole(data, protocol.TOLD_STATUSWORD)
        receiving.receive_position(loop, joint, position_rad, time_ns)
        receiving.receive_status(loop, joint, common_status(statusword, axis.drive.error_code))
        if row.effort_per_unit != 0.0:
            receiving.receive_effort(loop, joint, words.whole(data, protocol.TOLD_TORQUE) * row.effort_per_unit)
    elif base == EMERGENCY and length == 8:
        axis.drive.error_code = words.whole(data, protocol.TOLD_ERROR_CODE)
    elif base == HEARTBEAT and length == 1 and words.whole(data, protocol.TOLD_NODE_STATE) != protocol.OPERATIONAL:
        booted = words.whole(data, protocol.TOLD_NODE_STATE) == protocol.BOOT_UP
        lost = status_bits.POWER_LOST if booted else axis.drive.status & status_bits.POWER_LOST
        receiving.receive_status(loop, joint, status_bits.COMMUNICATION | lost)


@jit
def common_status(statusword: int, error_code: int) -> int:
    """Statusword and the error code of the last emergency, in common bits (`memory.status`)."""
    if statusword & protocol.FAULT_MASK in (protocol.FAULT, protocol.FAULT_REACTION):
        return status_bits.PROTECTED | words.meaning_of_code(error_code, ERROR_MEANINGS)
    return status_bits.ENABLED if statusword & protocol.STATE_MASK == protocol.OPERATION_ENABLED else 0
