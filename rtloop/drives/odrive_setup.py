"""Bring-up and disabling of an ODrive axis with CANSimple; `rtloop.drives.odrive` describes its frames.

Bring-up reads (nothing moves): the position, the firmware's version, then the heartbeat with the error and whether the
loop is closed. An idle axis gets its position as its input position before its loop is closed. An axis that reports no
position yet, as 0.5.6 before its first closed loop, gets no input position: firmware 0.5 begins a closed loop where it
stands. An axis whose loop is closed gets an input position too, because its old one cannot be read, and the modes are
set after that. If it stood still it keeps standing, off its new input position by as much as it was off its old one.
"""

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from config.drives.odrive import OdriveDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import errors
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import ErrorBit
from rtloop.drives.setup import SAME_PLACE_RAD, Found, Host, require_may_enable
from rtloop.drives.steps import answered, let_go, unanswered, without_error
from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import REMOTE, STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part, answer_patience_s
from rtloop.service.port import Frame
from shm.words import Unreferenced

COMMANDS = 32
"""Number of commands of a node; the command is the lowest bits of an identifier."""
VERSION, HEARTBEAT, AXIS_STATE, ESTIMATES, MODES, INPUT_POSITION = 0x00, 0x01, 0x07, 0x09, 0x0B, 0x0C
CURRENT, BUS, CLEAR_ERRORS = 0x14, 0x17, 0x18
ANSWER_BYTES = 8
"""Length of every answer, which the remote frame states too."""

IDLE, CLOSED_LOOP = 1, 8
POSITION_CONTROL, PASSTHROUGH = 3, 1

FIRMWARE_0_6 = 6
"""Major version << 8 | minor version since which the error's bits are those of `ERRORS_0_6`."""
ERRORS_0_5 = (
    ErrorBit(1 << 0, "invalid state"),
    ErrorBit(1 << 6, "motor"),
    ErrorBit(1 << 7, "sensorless estimator", status_bits.ENCODER),
    ErrorBit(1 << 8, "encoder", status_bits.ENCODER),
    ErrorBit(1 << 9, "controller"),
    ErrorBit(1 << 11, "watchdog expired", status_bits.COMMUNICATION),
    ErrorBit(1 << 12, "minimum end stop"),
    ErrorBit(1 << 13, "maximum end stop"),
    ErrorBit(1 << 14, "emergency stop asked over CAN"),
    ErrorBit(1 << 17, "homing without an end stop"),
    ErrorBit(1 << 18, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorBit(1 << 19, "position unknown", status_bits.ENCODER),
)
"""Bits of the heartbeat's error word (firmware 0.5.6)."""
ERRORS_0_6 = (
    ErrorBit(1 << 0, "initializing"),
    ErrorBit(1 << 1, "fault of the board"),
    ErrorBit(1 << 2, "timing"),
    ErrorBit(1 << 3, "no estimate of position or velocity", status_bits.ENCODER),
    ErrorBit(1 << 4, "bad configuration"),
    ErrorBit(1 << 5, "gate driver"),
    ErrorBit(1 << 6, "missing input"),
    ErrorBit(1 << 8, "over-voltage of the supply", status_bits.OVER_VOLTAGE),
    ErrorBit(1 << 9, "under-voltage of the supply", status_bits.UNDER_VOLTAGE),
    ErrorBit(1 << 10, "over-current from the supply", status_bits.OVER_CURRENT),
    ErrorBit(1 << 11, "over-current back into the supply", status_bits.OVER_CURRENT),
    ErrorBit(1 << 12, "over-current in the motor", status_bits.OVER_CURRENT),
    ErrorBit(1 << 13, "over-temperature of the motor", status_bits.OVER_TEMPERATURE),
    ErrorBit(1 << 14, "over-temperature of the board", status_bits.OVER_TEMPERATURE),
    ErrorBit(1 << 15, "velocity limit"),
    ErrorBit(1 << 16, "position limit"),
    ErrorBit(1 << 24, "watchdog expired", status_bits.COMMUNICATION),
    ErrorBit(1 << 25, "emergency stop asked for"),
    ErrorBit(1 << 26, "spinout", status_bits.ENCODER),  # an encoder that slips or is offset
    ErrorBit(1 << 27, "brake resistor disarmed"),
    ErrorBit(1 << 28, "thermistor disconnected"),
    ErrorBit(1 << 30, "calibration"),
)
"""The same of firmware 0.6 (odrive_enums.h in odriverobotics/ros_odrive)."""
INITIALIZING = 1
"""Error word of a board with firmware 0.6 that has just got power."""
RESULTS = (
    "success",
    "busy",
    "cancelled",
    "disarmed",
    "no response",
    "pole pairs and encoder counts that do not fit",
    "phase resistance out of range",
    "phase inductance out of range",
    "unbalanced phases",
    "invalid motor type",
    "illegal Hall state",
    "timeout",
    "homing without an end stop",
    "invalid state",
    "not calibrated",
    "not converging",
)
"""Result, in the heartbeat of firmware 0.6, of the last request for a state (the same file)."""

MISSED_HEARTBEATS = 3
BUSY_S = 2.0
"""An axis closes its loop in less time than this, unless it must be calibrated first."""


class Firmware(NamedTuple):
    """Version of a drive's firmware; 0.5 does not report it."""

    major: int = 0
    minor: int = 5
    revision: int | None = None

    @property
    def is_0_6(self) -> bool:
        """Whether its protocol is that of 0.6."""
        return self.major << 8 | self.minor >= FIRMWARE_0_6

    def __str__(self) -> str:
        return "firmware " + ".".join(str(number) for number in self if number is not None)


class Beat(NamedTuple):
    """Contents of a heartbeat; `result` counts with firmware 0.6 only."""

    error: int
    state: int
    result: int


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of an ODrive axis for the cycle; see `rtloop.drives.setup.Setup`."""
    drive = _drive(joint)
    row["command_per_rad"] = row["reading_per_rad"] = joint.direction * joint.ratio / (2.0 * math.pi)
    row["status_timeout_ns"] = MISSED_HEARTBEATS * drive.heartbeat_ms * 1_000_000
    if drive.nm_per_ampere is not None:
        row["effort_per_unit"] = joint.direction * joint.ratio * drive.nm_per_ampere


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    node = _drive(config).node_id
    if (yield _asked(node, ESTIMATES)) is None:
        rate = f"{host.arm.bus.bitrate} bit/s; axis.config.can.node_id and can.config.baud_rate"
        raise unanswered(joint, config, f"node {node}", f"its node and the bit rate ({rate})")
    firmware = yield from _firmware(node)
    beat = yield from _without_errors(host, joint, firmware)
    for _ in range(TRIES):
        standing = yield from confirmed(lambda: _turns(joint, config), SAME_PLACE_RAD * config.ratio / (2.0 * math.pi))
        here = _frame(node, INPUT_POSITION, struct.pack("<fhh", standing, 0, 0))
        modes = _frame(node, MODES, struct.pack("<II", POSITION_CONTROL, PASSTHROUGH))
        if standing != 0.0 or beat.state == CLOSED_LOOP or firmware.is_0_6:
            yield say(here)  # sent twice: if it were lost, the modes would send the axis to its old input position
            yield say(here, modes)
        else:
            yield say(modes)
        if beat.state == CLOSED_LOOP:
            break
        require_may_enable(host, joint)
        yield say(_frame(node, AXIS_STATE, struct.pack("<II", CLOSED_LOOP, 0)))
        beat = yield from _heartbeat(host.arm, joint, lambda beat: beat.state == CLOSED_LOOP)
        if beat.state == CLOSED_LOOP:
            break
    else:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} ({firmware}) does not close its loop ({_why_open(beat, firmware)}): calibrate "
            "its motor and encoder with odrivetool and save that in the drive, then `rtarm clear-fault`, or `rtarm up` "
            "where it has ended.",
        )
    turns = yield from confirmed(lambda: _turns(joint, config), SAME_PLACE_RAD * config.ratio / (2.0 * math.pi))
    return Found(turns, turns, Unreferenced.REFERENCED if _drive(config).knows_its_angle else Unreferenced.INCREMENTAL)


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Set the axis to idle, and check that its loop is open; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        yield say(_frame(_drive(config).node_id, AXIS_STATE, struct.pack("<II", IDLE, 0)))
        beat = yield from _heartbeat(arm, joint, lambda beat: beat.state != CLOSED_LOOP)
        return "keeps its loop closed" if beat.state == CLOSED_LOOP else ""

    yield from let_go(joint, config, told, "look at the axis in odrivetool")


def error_words(error: int, firmware: Firmware) -> str:
    """The heartbeat's error word in words."""
    return errors.error_words(error, ERRORS_0_6 if firmware.is_0_6 else ERRORS_0_5)


def _why_open(beat: Beat, firmware: Firmware) -> str:
    """Why a loop is not closed, according to a heartbeat."""
    if beat.error:
        return f"its error is {error_words(beat.error, firmware)}"
    if firmware.is_0_6 and 0 < beat.result < len(RESULTS):
        return f"its procedure result is {RESULTS[beat.result]}"
    return f"its state is {beat.state}"


def _firmware(node: int) -> Part[Firmware]:
    """The firmware's version; 0.5 if the node does not answer the request for it."""
    answer = yield _asked(node, VERSION)
    return Firmware() if answer is None else Firmware(*answer.data[4:7])


def _without_errors(host: Host, joint: int, firmware: Firmware) -> Part[Beat]:
    """Check that the axis has no error, and clear one if the operator asked for that; raises DialogueFailed."""
    config = host.arm.joints[joint]
    beat = yield from _heartbeat(host.arm, joint, lambda beat: not (firmware.is_0_6 and beat.error == INITIALIZING))

    def cleared() -> Part[Beat]:
        yield say(_frame(_drive(config).node_id, CLEAR_ERRORS))
        return (yield from _heartbeat(host.arm, joint, lambda beat: beat.error == 0))

    return (
        yield from without_error(
            host,
            joint,
            beat,
            lambda beat: error_words(beat.error, firmware) if beat.error else "",
            cleared,
            version=f" ({firmware})",
            find="find it with `dump_errors` in odrivetool",
            tries=1,
        )
    )


def _drive(config: JointConfig) -> OdriveDrive:
    assert isinstance(config.drive, OdriveDrive)
    return config.drive


def _frame(node: int, command: int, data: bytes = b"") -> Frame:
    return Frame(node << 5 | command, data.ljust(ANSWER_BYTES, b"\0"), kind=STANDARD)


def _asked(node: int, command: int) -> AskFrames:
    """A request (remote frame) for one of the node's values."""
    request = Frame(node << 5 | command, bytes(ANSWER_BYTES), kind=STANDARD | REMOTE)
    return AskFrames((request,), lambda frame: frame.id & (COMMANDS - 1) == command and len(frame.data) == ANSWER_BYTES)


def _turns(joint: int, config: JointConfig) -> Part[float]:
    """The motor's position (turns); raises DialogueFailed."""
    for _ in range(TRIES):
        answer = yield from answered(joint, config, _asked(_drive(config).node_id, ESTIMATES), "position")
        turns = float(struct.unpack("<f", answer.data[:4])[0])
        if math.isfinite(turns):
            return turns
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} says that its position is no number: calibrate its encoder with odrivetool, then "
        "`rtarm clear-fault`, or `rtarm up` where it has ended.",
    )


def _heartbeat(arm: ArmConfig, joint: int, until: Callable[[Beat], bool]) -> Part[Beat]:
    """Wait for a heartbeat that is as wanted; after a timeout, the last one.

    Raises DialogueFailed if none came.
    """
    config = arm.joints[joint]
    heartbeat_s = _drive(config).heartbeat_ms * 1e-3
    found: Beat | None = None
    listened = AskFrames((), lambda frame: frame.id & (COMMANDS - 1) == HEARTBEAT and len(frame.data) == ANSWER_BYTES)
    waited_s = silent_s = 0.0
    while waited_s < MISSED_HEARTBEATS * heartbeat_s + BUSY_S and silent_s < MISSED_HEARTBEATS * heartbeat_s:
        frame = yield listened
        if frame is None:  # that wait may have been shorter than the time between heartbeats
            waited_s += TRIES * answer_patience_s(arm)
            silent_s += TRIES * answer_patience_s(arm)
            continue
        waited_s += heartbeat_s
        silent_s = 0.0
        found = Beat(*struct.unpack("<IBB", frame.data[:6]))
        if until(found):
            return found
    if found is None:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} sends no heartbeat: set axis.config.can.heartbeat_rate_ms "
            f"(heartbeat_msg_rate_ms with firmware 0.6) to {_drive(config).heartbeat_ms}, or heartbeat_ms in the arm "
            "file to what it is.",
        )
    return found
