"""What drives are asked that speak only when they are spoken to, and what every other family makes of those bytes.

A scan does not know who listens. So what is asked of everybody must move nothing and change no setting of any drive
that rtarm knows, whatever its number: `EVERYBODY`, beside the firmware question of ZDT drives (`rtarm.scan.search`).
Some families have no such question; they are asked only where a person says that the bus has no others (`NAMED`).

What the others make of a question to everybody (their protocols as in docs/hardware/drive-families.md):

| question | MKS, Damiao, MyActuator, CiA 402 | ODrive | RobStride | ZDT | VESC |
|---|---|---|---|---|---|
| ZDT: address << 8 (extended), 1F 6B | - | - | motor 0 says its id | its firmware | number 0: see below |
| RobStride: type 0 from FD (extended) | - | - | its id | address 253: no function | packet 253: none |

"-": not its kind of identifier. A DM4310 takes no extended frame (umeow0716/damiao_firmware, the filters in
board_mcan_config.c), nor does ODrive 0.5.6 (odriverobotics/ODrive, odrive_can.cpp) unless `is_extended` is set, which
rtarm does not lead: then an axis of number 2024 to 2031 (its number << 5 is FD00 to FDE0) would hear RobStride's
question as commands, were its heartbeats not heard before. A moteus reads nothing but writes of no register from it
(mjbots/mjlib, micro_server.cc). What a RobStride motor is asked, and says, is as in the maker's SampleProgram
(Robstride01.cpp) and the CyberGear's manual (belovictor/cybergear-docs, 4.1.1).

A VESC hears an extended identifier as packet << 8 | number (`rtloop.drives.vesc_protocol`) and looks at no length: with
number 0, which rtarm does not lead, each address of a ZDT question is a command to it, 1 a current. So 17 comes first,
which is its ping (since 2019): `rtarm.scan.search.a_vesc_answers`.

Why others are asked by name only:

- MKS, 1 to 7FF: that is every command of every ODrive, set-points to Damiao motors (whatever the length), SYNC and
  controlwords to CANopen drives.
- Damiao, 7FF: command 1F of node 63, which enters the bootloader of an ODrive 0.6 (odriverobotics/ros_odrive,
  can_simple_messages.hpp); all of them hear 63, the broadcast (odriverobotics/ODriveResources, can_enumerate.py).
- CANopen nodes, SDO, 600 + node: commands to ODrives 48 to 51.
- MyActuator, 140 + motor: commands to ODrives 10 and 11. 280 would ask all motors at once, but in the broadcast mode of
  LK's protocol V2.35 (MF and MG, sold as RMD too) it is four torques (Jason0-0/logging_car_pro_plus, RMD_protocol.h),
  and 9A 00 turns motor 1; nor do motors hear it that filter identifiers (the maker's Motion Protocol V4.2, 20 with
  index 02).

- VESC, a ping to each number: packets of a ZDT drive of address 17, which it does not understand, and RobStride's
  question for the id (type 0); commands to ODrives with extended numbers 136 to 139.

Those ODrives would be overheard, but for one whose heartbeat is turned off.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from config.drives.cia402 import SDO_REPLY
from config.drives.damiao import HIGHEST_ID, REGISTERS_ID
from config.drives.myactuator import HIGHEST_ID as HIGHEST_MYACTUATOR
from config.drives.myactuator import REPLY, REQUEST
from config.drives.vesc import HIGHEST_NUMBER, HOST_BIT, PACKET_BIT
from rtarm.scan.heard import Heard
from rtarm.scan.wires import Frame
from rtloop.drives import damiao_protocol as damiao
from rtloop.drives import mks_protocol as mks
from rtloop.drives import myactuator_protocol as myactuator
from rtloop.drives import sdo
from rtloop.drives import vesc_protocol as vesc
from rtloop.drives.cia402_protocol import DEVICE_TYPE, PROFILE
from rtloop.drives.errors import error_words
from rtloop.drives.numbers import Values, packed, unpacked
from rtloop.memory.frame_words import STANDARD
from rtloop.service import port

HOST, ANYBODY = 0xFD, 0xFE
"""Of RobStride: who asks, as the maker's program does; for whom motors say their id."""
MKS_STATES = ("it reports no state", "stands", "speeds up", "slows down", "moves", "homes", "calibrates")


class Question(NamedTuple):
    """What a family is asked, and how its answers are read.

    Attributes:
        family: as arm files name it.
        bitrates: which its drives can be set to (bit/s); they are asked at no other.
        frames: the question, to each number.
        drive_of: the drive that an answer is of, None where a frame is none.
    """

    family: str
    bitrates: frozenset[int]
    frames: tuple[Frame, ...]
    drive_of: Callable[[Frame], Heard | None]


def _robstride(frame: Frame) -> Heard | None:
    number = frame.id >> 8 & 0xFF
    if not frame.extended or len(frame.data) != 8 or frame.id != number << 8 | ANYBODY:
        return None
    return Heard("robstride", "RobStride motor", number, f"unique number {frame.data.hex()}", {"motor_id": number})


def _myactuator(frame: Frame) -> Heard | None:
    number = frame.id - REPLY
    if frame.extended or not 1 <= number <= HIGHEST_MYACTUATOR or len(frame.data) != 8:
        return None
    if unpacked(frame.data, myactuator.COMMAND) != myactuator.STATUS:
        return None
    error = unpacked(frame.data, myactuator.ERROR)
    state = error_words(error, myactuator.ERRORS) if error else "no error"
    return Heard("myactuator", "MyActuator motor", number, state, {"motor_id": number})


def _damiao(frame: Frame) -> Heard | None:
    if frame.extended or len(frame.data) != 8:
        return None
    number = unpacked(frame.data, damiao.OWNER)
    if not 1 <= number <= HIGHEST_ID or frame.data[:4] != _damiao_question(number).data[:4]:
        return None
    master_id = unpacked(frame.data, damiao.WHOLE)
    settings = {"motor_id": number, "master_id": master_id}
    return Heard("damiao", "Damiao motor", number, f"answers on {master_id:#x}", settings)


def _mks(frame: Frame) -> Heard | None:
    data = frame.data
    if frame.extended or len(data) != 3 or data != mks.sealed(frame.id, data[:2]) or data[0] != mks.READ_STATE:
        return None
    state = MKS_STATES[data[1]] if data[1] < len(MKS_STATES) else f"state {data[1]}"
    return Heard("mks", "MKS drive", frame.id, state, {"can_id": frame.id})


def _cia402(frame: Frame) -> Heard | None:
    node, reply = frame.id - SDO_REPLY, port.Frame(frame.id, frame.data, kind=STANDARD)
    if frame.extended or not 1 <= node <= 127 or not sdo.reading(node, DEVICE_TYPE).is_answer(reply):
        return None
    if reply.data[0] == sdo.ABORT:
        return None
    profile = sdo.value_in(reply, DEVICE_TYPE) & 0xFFFF
    called = "CANopen drive" if profile == PROFILE else "CANopen node"
    return Heard("cia402", called, node, f"profile {profile}", {"node_id": node})


def _vesc(frame: Frame) -> Heard | None:
    packet, host = divmod(frame.id, 1 << PACKET_BIT)
    if not frame.extended or packet != vesc.PONG or len(frame.data) != vesc.PONG_BYTES:
        return None
    number = unpacked(frame.data, vesc.SENDER)
    if host != number | HOST_BIT or not 1 <= number <= HIGHEST_NUMBER:
        return None
    return Heard("vesc", "VESC", number, "is there", {"controller_id": number})


def _vesc_question(number: int) -> Frame:
    return Frame(vesc.PING << PACKET_BIT | number, packed({vesc.SENDER: number | HOST_BIT}, vesc.PING_BYTES))


def _mks_question(can_id: int) -> Frame:
    return Frame(can_id, mks.sealed(can_id, bytes((mks.READ_STATE,))), extended=False)


def _damiao_question(motor_id: int) -> Frame:
    asked: Values = {damiao.OWNER: motor_id, damiao.OPERATION: damiao.READ, damiao.REGISTER: damiao.MASTER_ID.number}
    return Frame(REGISTERS_ID, packed(asked), extended=False)


def _cia402_question(node: int) -> Frame:
    (request,) = sdo.reading(node, DEVICE_TYPE).frames
    return Frame(request.id, request.data, extended=False)


EVERYBODY = (
    Question(
        "robstride",
        frozenset((1_000_000, 500_000, 250_000, 125_000)),
        tuple(Frame(HOST << 8 | number, bytes(8)) for number in range(1, 0xFF)),
        _robstride,
    ),
)
NAMED = (
    Question(
        "myactuator",
        frozenset((1_000_000, 500_000)),
        tuple(
            Frame(REQUEST + number, packed({myactuator.COMMAND: myactuator.STATUS}), extended=False)
            for number in range(1, HIGHEST_MYACTUATOR + 1)
        ),
        _myactuator,
    ),
    Question(
        "mks",
        frozenset((500_000, 1_000_000, 250_000, 125_000)),
        tuple(map(_mks_question, range(1, 0x800))),
        _mks,
    ),
    Question(
        "damiao",
        frozenset((1_000_000, 500_000, 250_000, 125_000)),
        tuple(map(_damiao_question, range(1, HIGHEST_ID + 1))),
        _damiao,
    ),
    Question(
        "cia402",
        frozenset((1_000_000, 500_000, 250_000, 125_000, 100_000, 50_000, 20_000, 10_000)),
        tuple(map(_cia402_question, range(1, 128))),
        _cia402,
    ),
    Question(
        "vesc",
        frozenset((500_000, 1_000_000, 250_000, 125_000)),
        tuple(map(_vesc_question, range(1, HIGHEST_NUMBER + 1))),
        _vesc,
    ),
)
BY_NAME = {question.family: question for question in (*EVERYBODY, *NAMED)}
"""The question of each family that is asked one, but for ZDT drives, of which a scan asks more."""
