"""Drives that make themselves known without being asked, by what a scan overhears of them.

An ODrive axis (CANSimple, firmware 0.5.6: its CAN guide and DBC file; 0.6: ODrive's CAN protocol page) says a heartbeat
on the standard identifier node << 5 | 1: eight bytes, the error word (u32, little-endian) first and the axis state
behind it, every 100 ms unless set otherwise. What the error's bits mean depends on the firmware, which a scan does not
ask for. A CANopen node (CiA 301, heartbeat protocol) says one on 700 + node: one byte, its state; how often, or whether
at all, is set in it. Where their identifiers meet, their lengths tell them apart.

A VESC (`rtloop.drives.vesc_protocol`) sends status packets where they are switched on: status 4, on the extended
identifier 1000 + number, has eight bytes with temperature and position. Second packets of a ZDT drive of address 16
have such identifiers too, but begin with a function, which would be 150 °C and more.
"""

from __future__ import annotations

from collections.abc import Iterable

from config.drives.odrive import COMMAND_MASK, NODE_BIT
from config.drives.vesc import PACKET_BIT, STEPS_PER_TURN
from rtarm.scan.heard import Heard, by_number
from rtarm.scan.wires import Frame
from rtloop.drives import odrive_protocol as odrive
from rtloop.drives import vesc_protocol as vesc
from rtloop.drives.numbers import unpacked

ODRIVE_STATES = range(15)
"""Axis states: 0 undefined to 13 encoder Hall phase calibration with firmware 0.5.6, 14 anticogging with 0.6."""
ODRIVE_USUAL = {odrive.IDLE: "idle", odrive.CLOSED_LOOP: "closed loop"}
CANOPEN_HEARTBEAT, CANOPEN_NODES = 0x700, range(1, 128)
CANOPEN_STATES = {0x00: "boot-up", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}

VESC_NUMBERS = range(1, 0xFD)
"""FD and FE are RobStride's host and anybody, to whom motors say their id on identifiers of the same kind."""
VESC_C = range(-40, 150)


def drive_of(frame: Frame) -> Heard | None:
    """Whose heartbeat or status a frame looks like; None for any other frame."""
    return _vesc(frame) if frame.extended else _with_heartbeat(frame)


def _vesc(frame: Frame) -> Heard | None:
    packet, number = divmod(frame.id, 1 << PACKET_BIT)
    if packet != vesc.STATUS_4 or number not in VESC_NUMBERS or len(frame.data) != vesc.STATUS_BYTES:
        return None
    power_stage_c = unpacked(frame.data, vesc.HOTTEST_C[0]) // 10
    if power_stage_c not in VESC_C or not 0 <= unpacked(frame.data, vesc.TOLD_POSITION) <= STEPS_PER_TURN:
        return None
    return Heard("vesc", "VESC", number, f"power stage at {power_stage_c} °C", {"controller_id": number})


def of_a_vesc(frame: Frame, vescs: Iterable[int]) -> bool:
    """Whether a frame is said by one of these VESCs, whatever it says."""
    return frame.extended and frame.id & ((1 << PACKET_BIT) - 1) in vescs


def _with_heartbeat(frame: Frame) -> Heard | None:
    node, command = frame.id >> NODE_BIT, frame.id & COMMAND_MASK
    is_heartbeat = command == odrive.HEARTBEAT and len(frame.data) == odrive.ANSWER_BYTES
    if is_heartbeat and (state := unpacked(frame.data, odrive.STATE)) in ODRIVE_STATES:
        error = unpacked(frame.data, odrive.ERROR)
        words = f"error {error:#x}" if error else ODRIVE_USUAL.get(state, f"axis state {state}")
        return Heard("odrive", "ODrive axis", node, words, {"node_id": node})
    node = frame.id - CANOPEN_HEARTBEAT
    if node in CANOPEN_NODES and len(frame.data) == 1 and frame.data[0] in CANOPEN_STATES:
        return Heard("cia402", "CANopen node", node, CANOPEN_STATES[frame.data[0]], {"node_id": node})
    return None


def overheard(frames: Iterable[Frame]) -> list[Heard]:
    """Who has spoken, each as last heard, by family and number."""
    return by_number(map(drive_of, frames))
