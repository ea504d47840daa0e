"""Bring-up and disabling of a VESC.

Bring-up asks for its fault, listens for its position, which comes by itself, and asks whether its time-out or its kill
switch has let the motor go; nothing moves. A time-out lets the joint fall when the control process has ended, or before
the first goal, so the drive must have none: one that has it says so, as nothing was commanded for longer than that.
Then the drive gets its own position as its target, which enables it.

Faults end by themselves, some time after their cause (0.5 s unless set otherwise in the drive). So they are waited for,
if the operator has asked to clear them.
"""

import numpy as np

from config.drives.vesc import HOST_BIT, PACKET_BIT, STEPS_PER_TURN, VescDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import vesc_protocol as protocol
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import code_words
from rtloop.drives.numbers import Values, packed, unpacked
from rtloop.drives.setup import CLEAR_OR_START, SAME_PLACE_RAD, Found, Host, require_may_enable
from rtloop.drives.steps import answered, let_go, unanswered, without_error
from rtloop.memory.frame_words import EXTENDED
from rtloop.service.conversation import Dialogue, DialogueFailed, Part
from rtloop.service.port import Frame
from shm.words import Unreferenced

ENABLED_BY_A_TARGET = True
DEAF_NS, DEAF_ROUNDS = 500_000_000, 5
"""A drive that answers no question for its state for so long, and so many, does not hear what it is told."""
WAIT = AskFrames((), lambda frame: False)
"""Asks nothing, and waits as long as for an answer that does not come (0.3 s)."""


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of a VESC for the cycle; see `rtloop.drives.setup.Setup`."""
    row["status_timeout_ns"] = max(DEAF_NS, DEAF_ROUNDS * len(arm.joints) * arm.control.period_ns)


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    number = drive_of(config).controller_id
    answer = yield asked(number, protocol.FAULT)
    if answer is None:
        rate = f"the bit rate ({host.arm.bus_of(config).bitrate} bit/s) and CAN Mode VESC in VESC Tool"
        raise unanswered(joint, config, f"controller_id {number}", f"its VESC ID, {rate}")

    def fault() -> Part[int]:
        yield WAIT
        return value_in((yield from answered(joint, config, asked(number, protocol.FAULT), "fault")))

    yield from without_error(host, joint, value_in(answer), fault_words, fault, called="fault")
    yield from _place(joint, config)
    yield from _held_by_nothing_else(joint, config)
    require_may_enable(host, joint)
    within = SAME_PLACE_RAD * config.encoder_counts_per_rad
    target = yield from confirmed(lambda: _place(joint, config), within)
    yield say(set_position(number, target))
    yield say(set_position(number, target))  # one may be lost
    reading = yield from confirmed(lambda: _place(joint, config), within)
    return Found(reading, target, Unreferenced.REFERENCED if config.knows_its_angle else Unreferenced.INCREMENTAL)


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Let the motor coast, which no frame confirms; raises DialogueFailed where the drive does not answer."""
    config = arm.joints[joint]
    number = drive_of(config).controller_id

    def told() -> Part[str]:
        yield say(_to(number, protocol.SET_CURRENT, packed({protocol.CURRENT: 0}, protocol.COMMAND_BYTES)))
        heard = yield asked(number, protocol.FAULT)
        return "" if heard is not None else "does not answer"

    yield from let_go(joint, config, told, "switch its supply off")


def drive_of(config: JointConfig) -> VescDrive:
    """The drive's section of the arm file."""
    assert isinstance(config.drive, VescDrive)
    return config.drive


def fault_words(fault: int) -> str:
    """A fault in words, "" for none."""
    return (code_words(fault, protocol.FAULTS) or f"fault {fault}") if fault else ""


def asked(number: int, mask: int) -> AskFrames:
    """The question for one byte of a drive's values."""
    command: Values = {protocol.COMMAND: protocol.GET_VALUES_SELECTIVE, protocol.MASK: mask}
    request: Values = {protocol.SENDER: number | HOST_BIT, protocol.HOW: protocol.TO_BE_ANSWERED}
    expected: Values = {protocol.SENDER: number, protocol.HOW: protocol.IS_ANSWER, **command}
    begin = packed(expected)[: protocol.QUESTION_BYTES]

    def is_answer(frame: Frame) -> bool:
        return _is(frame, number | HOST_BIT, protocol.SHORT_BUFFER) and bytes(frame.data).startswith(begin)

    data = packed({**request, **command}, protocol.QUESTION_BYTES)
    return AskFrames((_to(number, protocol.SHORT_BUFFER, data),), is_answer)


def value_in(answer: Frame) -> int:
    """The byte that such a question is answered with."""
    return unpacked(answer.data, protocol.VALUE)


def heard(number: int, packet: int) -> AskFrames:
    """Listens for a status that a drive sends by itself."""
    return AskFrames((), lambda frame: _is(frame, number, packet) and _tells_a_place(frame, packet))


def set_position(number: int, steps: float) -> Frame:
    """The position command for a place in steps of a reading, in any turn."""
    position = round(protocol.within_a_turn(steps / STEPS_PER_TURN) * protocol.POSITION_PER_TURN)
    return _to(number, protocol.SET_POSITION, packed({protocol.POSITION: position}, protocol.COMMAND_BYTES))


def released_words(value: int) -> str:
    """What has let a motor go, "" for nothing."""
    if value & protocol.KILLED:
        return "its kill switch"
    return "its time-out" if value & protocol.TIMED_OUT else ""


def steps_in(config: JointConfig, told: int) -> float:
    """The place in steps of a reading, in the turn in which the joint is within its range."""
    middle_rad = 0.5 * (config.lower_rad + config.upper_rad) + config.zero_rad
    middle = config.direction * middle_rad * config.encoder_counts_per_rad / STEPS_PER_TURN
    return round(protocol.nearest(told / STEPS_PER_TURN, middle) * STEPS_PER_TURN)


def _is(frame: Frame, number: int, packet: int) -> bool:
    return frame.id == packet << PACKET_BIT | number and len(frame.data) == protocol.STATUS_BYTES


def _tells_a_place(frame: Frame, packet: int) -> bool:
    """Whether a position is within a turn, where there is one."""
    return packet != protocol.STATUS_4 or 0 <= unpacked(frame.data, protocol.TOLD_POSITION) <= STEPS_PER_TURN


def _to(number: int, packet: int, data: bytes) -> Frame:
    return Frame(packet << PACKET_BIT | number, data, kind=EXTENDED)


def _place(joint: int, config: JointConfig) -> Part[float]:
    """Where the motor stands (steps of a reading); raises DialogueFailed."""
    drive = drive_of(config)
    frame = yield heard(drive.controller_id, protocol.STATUS_4)
    if frame is None:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not send its position: switch Status 4 on among its CAN Messages Rate 1 "
            f"in VESC Tool (App Settings, General), set that rate to {drive.position_hz} Hz and write the "
            f"configuration, {CLEAR_OR_START}.",
        )
    return steps_in(config, unpacked(frame.data, protocol.TOLD_POSITION))


def _held_by_nothing_else(joint: int, config: JointConfig) -> Part[None]:
    """Check that neither a time-out nor a kill switch lets the motor go; raises DialogueFailed."""
    number = drive_of(config).controller_id
    answer = yield asked(number, protocol.RELEASED)
    if answer is None:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not say whether its time-out has let the motor go, as firmware from "
            f"before 2021 does: bring its firmware up to date with VESC Tool, {CLEAR_OR_START}.",
        )
    cause = released_words(value_in(answer))
    if cause:
        remedy = {
            "its time-out": "set Timeout to 0 in VESC Tool (App Settings, General) and write the configuration, since "
            "it would let the joint fall whenever nothing is commanded",
            "its kill switch": "release it",
        }[cause]
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} holds nothing because of {cause}: {remedy}, {CLEAR_OR_START}.",
        )
