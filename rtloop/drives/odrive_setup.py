"""Bring-up and disabling of an ODrive axis with CANSimple.

Bring-up reads (nothing moves): the position, the firmware's version, then the heartbeat with the error and whether the
loop is closed. An idle axis gets its position as its input position before its loop is closed. An axis that reports no
position yet, as 0.5.6 before its first closed loop, gets no input position: firmware 0.5 begins a closed loop where it
stands. An axis whose loop is closed gets an input position too, because its old one cannot be read, and the modes are
set after that. If it stood still it keeps standing, off its new input position by as much as it was off its old one.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from config.drives.odrive import COMMAND_MASK, NODE_BIT, OdriveDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import errors
from rtloop.drives import odrive_protocol as protocol
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.numbers import NO_VALUES, Values, packed, unpacked
from rtloop.drives.setup import CLEAR_OR_START, SAME_PLACE_RAD, Found, Host, require_may_enable
from rtloop.drives.steps import answered, let_go, unanswered, without_error
from rtloop.memory.frame_words import REMOTE, STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part, answer_patience_s
from rtloop.service.port import Frame
from shm.words import Unreferenced

FOLLOWS_POSITIONS: Values = {
    protocol.CONTROL_MODE: protocol.POSITION_CONTROL,
    protocol.INPUT_MODE: protocol.PASSTHROUGH,
}
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
        return self.major << 8 | self.minor >= protocol.FIRMWARE_0_6

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
    if (yield asked(node, protocol.ESTIMATES)) is None:
        rate = f"{host.arm.bus_of(config).bitrate} bit/s; axis.config.can.node_id and can.config.baud_rate"
        raise unanswered(joint, config, f"node {node}", f"its node and the bit rate ({rate})")
    firmware = yield from _firmware(node)
    beat = yield from _without_errors(host, joint, firmware)
    for _ in range(TRIES):
        standing = yield from confirmed(lambda: _turns(joint, config), SAME_PLACE_RAD * config.ratio / (2.0 * math.pi))
        here = _frame(node, protocol.INPUT_POSITION, {protocol.INPUT_TURNS: standing})
        modes = _frame(node, protocol.MODES, FOLLOWS_POSITIONS)
        if standing != 0.0 or beat.state == protocol.CLOSED_LOOP or firmware.is_0_6:
            yield say(here)  # sent twice: if it were lost, the modes would send the axis to its old input position
            yield say(here, modes)
        else:
            yield say(modes)
        if beat.state == protocol.CLOSED_LOOP:
            break
        require_may_enable(host, joint)
        yield say(_frame(node, protocol.AXIS_STATE, {protocol.WANTED_STATE: protocol.CLOSED_LOOP}))
        beat = yield from heartbeat(host.arm, joint, lambda beat: beat.state == protocol.CLOSED_LOOP)
        if beat.state == protocol.CLOSED_LOOP:
            break
    else:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} ({firmware}) does not close its loop ({_why_open(beat, firmware)}): calibrate "
            f"its motor and encoder with odrivetool and save that in the drive, {CLEAR_OR_START}.",
        )
    turns = yield from confirmed(lambda: _turns(joint, config), SAME_PLACE_RAD * config.ratio / (2.0 * math.pi))
    return Found(turns, turns, Unreferenced.REFERENCED if _drive(config).knows_its_angle else Unreferenced.INCREMENTAL)


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Set the axis to idle, and check that its loop is open; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        yield say(_frame(_drive(config).node_id, protocol.AXIS_STATE, {protocol.WANTED_STATE: protocol.IDLE}))
        beat = yield from heartbeat(arm, joint, lambda beat: beat.state != protocol.CLOSED_LOOP)
        return "keeps its loop closed" if beat.state == protocol.CLOSED_LOOP else ""

    yield from let_go(joint, config, told, "look at the axis in odrivetool")


def error_words(error: int, firmware: Firmware) -> str:
    """The heartbeat's error word in words."""
    return errors.error_words(error, protocol.ERRORS_0_6 if firmware.is_0_6 else protocol.ERRORS_0_5)


def _why_open(beat: Beat, firmware: Firmware) -> str:
    """Why a loop is not closed, according to a heartbeat."""
    if beat.error:
        return f"its error is {error_words(beat.error, firmware)}"
    if firmware.is_0_6 and 0 < beat.result < len(protocol.RESULTS):
        return f"its procedure result is {protocol.RESULTS[beat.result]}"
    return f"its state is {beat.state}"


def _firmware(node: int) -> Part[Firmware]:
    """The firmware's version; 0.5 if the node does not answer the request for it."""
    answer = yield asked(node, protocol.VERSION)
    return Firmware() if answer is None else firmware_in(answer.data)


def firmware_in(data: bytes) -> Firmware:
    """The version in the answer to the request for it."""
    return Firmware(*(unpacked(data, part) for part in (protocol.MAJOR, protocol.MINOR, protocol.REVISION)))


def _without_errors(host: Host, joint: int, firmware: Firmware) -> Part[Beat]:
    """Check that the axis has no error, and clear one if the operator asked for that; raises DialogueFailed."""
    config = host.arm.joints[joint]
    initializing = protocol.INITIALIZING if firmware.is_0_6 else None
    beat = yield from heartbeat(host.arm, joint, lambda beat: beat.error != initializing)

    def cleared() -> Part[Beat]:
        yield say(_frame(_drive(config).node_id, protocol.CLEAR_ERRORS))
        return (yield from heartbeat(host.arm, joint, lambda beat: beat.error == 0))

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


def _frame(node: int, command: int, values: Values = NO_VALUES) -> Frame:
    return Frame(node << NODE_BIT | command, packed(values), kind=STANDARD)


def asked(node: int, command: int) -> AskFrames:
    """A request (remote frame) for one of the node's values."""
    request = _frame(node, command)._replace(kind=STANDARD | REMOTE)
    return AskFrames((request,), lambda frame: _says(frame, command))


def _says(frame: Frame, command: int) -> bool:
    """Whether a frame of the node holds that value."""
    return frame.id & COMMAND_MASK == command and len(frame.data) == protocol.ANSWER_BYTES


def _turns(joint: int, config: JointConfig) -> Part[float]:
    """The motor's position (turns); raises DialogueFailed."""
    for _ in range(TRIES):
        answer = yield from answered(joint, config, asked(_drive(config).node_id, protocol.ESTIMATES), "position")
        turns = unpacked(answer.data, protocol.TURNS)
        if math.isfinite(turns):
            return turns
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} says that its position is no number: calibrate its encoder with odrivetool, "
        f"{CLEAR_OR_START}.",
    )


def heartbeat(arm: ArmConfig, joint: int, until: Callable[[Beat], bool]) -> Part[Beat]:
    """Wait for a heartbeat that is as wanted; after a timeout, the last one.

    Raises DialogueFailed if none came.
    """
    config = arm.joints[joint]
    heartbeat_s = _drive(config).heartbeat_ms * 1e-3
    found: Beat | None = None
    listened = AskFrames((), lambda frame: _says(frame, protocol.HEARTBEAT))
    waited_s = silent_s = 0.0
    while waited_s < MISSED_HEARTBEATS * heartbeat_s + BUSY_S and silent_s < MISSED_HEARTBEATS * heartbeat_s:
        frame = yield listened
        if frame is None:  # that wait may have been shorter than the time between heartbeats
            waited_s += TRIES * answer_patience_s(arm)
            silent_s += TRIES * answer_patience_s(arm)
            continue
        waited_s += heartbeat_s
        silent_s = 0.0
        found = Beat(*(unpacked(frame.data, part) for part in (protocol.ERROR, protocol.STATE, protocol.RESULT)))
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
