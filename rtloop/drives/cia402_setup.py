"""Bring-up and disabling of a CiA 402 drive over CANopen; `rtloop.drives.cia402` describes the frames of the cycle.

Bring-up uses service data (SDO) and two commands to the node (NMT), and changes volatile memory only: nothing is stored
in the drive. A value that is as it should be is not written.

A drive that holds its joint keeps its torque. So its node stays operational, because the drive may switch its torque
off when the node leaves that state (6007). Its PDOs are remapped while it is operational; if the drive refuses that, a
sentence tells the operator what to do. If it moves in another mode, it is halted first. A drive that holds nothing is
taken out of operation if it must be remapped, and then enabled state by state with its target at its measured position.

When the host falls silent, the drive shall hold. So two settings that would make it fail then are turned off:
monitoring of the host's heartbeat (1016), and the reaction to a lost connection (6007).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from config.budget import UART_BITS_PER_CHARACTER, budget
from config.drives.cia402 import (
    NMT,
    RPDO1,
    SYNC,
    TPDO1,
    Cia402Drive,
)
from config.frames import CycleFrames
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import cia402_protocol as protocol
from rtloop.drives import pdo
from rtloop.drives.arming import Arming, stayed_armed
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import code_words
from rtloop.drives.sdo import ABORT, Aborted, Node, Object, abort_words, reading, value_in
from rtloop.drives.setup import CLEAR_OR_START, SAME_PLACE_RAD, Found, Host, PowerHost
from rtloop.drives.steps import unanswered, without_error
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import Dialogue, DialogueFailed, Part
from rtloop.service.port import Frame
from shm.words import Unreferenced

BUSY_S = 2.0
"""Time within which a drive changes its state, opening of a brake included."""
STANDING_COUNTS = 2
"""Two readings of a drive at rest differ by no more than this."""
FINEST_POWER, COARSEST_POWER, MOST_UNITS = -6, -2, 255
"""Limits of an interpolation time, which is one byte of units between microseconds and hundredths of a second."""


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of a CiA 402 drive for the cycle; see `rtloop.drives.setup.Setup`."""
    drive = _drive(joint)
    row["position_bytes"] = drive.tpdo1_bytes
    row["command_delay_s"] = _sync_delay_s(arm, drive)
    row["reply_delay_ns"] = round((_answer_delay_s(arm, drive) + drive.processing_s) * 1e9)
    if drive.rated_torque_nm is not None:
        row["effort_per_unit"] = joint.direction * joint.ratio * drive.rated_torque_nm * 1e-3


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    node = Node(joint, config)
    yield from _is_a_drive(host, node)
    state = yield from _sound_state(host, node)
    arming = Arming(host, joint, lambda: _is_enabled(node))
    enabled = state == protocol.OPERATION_ENABLED
    if (yield from arming.found(enabled)) != enabled:  # which was garbled
        state = yield from _sound_state(host, node)
    holds = state in protocol.HOLDING
    if holds and (yield from node.read(protocol.MODE_SHOWN)) != protocol.CSP:
        yield from _halt(host.arm, node)
    yield from _map(node, _drive(config), holds)
    yield from _set_up(host, node)
    yield from _start(host.arm, node)
    if not holds or (yield from node.read(protocol.MODE_SHOWN)) != protocol.CSP:
        yield from _target_here(node)
        yield from node.write(protocol.MODE, protocol.CSP)
        yield from _until_csp(host.arm, node)
    if state != protocol.OPERATION_ENABLED:
        arming.begins()
        yield from _enable(host.arm, node, state)
    elif (yield from node.read(protocol.CONTROLWORD)) != protocol.ENABLE_OPERATION:
        yield from node.write(protocol.CONTROLWORD, protocol.ENABLE_OPERATION)
    found = yield from _standing(host, node)
    if found.reason == Unreferenced.REFERENCED:
        return found
    return found._replace(kept_power=(yield from arming.kept_power()))


def kept_power(host: PowerHost, joint: int) -> Part[bool]:
    """See `rtloop.drives.setup.PowerProof.kept_power`."""
    node = Node(joint, host.arm.joints[joint])
    return (yield from stayed_armed(host, joint, lambda: _is_enabled(node)))


def _is_enabled(node: Node) -> Part[bool | None]:
    """Whether the drive's operation is enabled; None if it does not answer that."""
    reply = yield reading(node.number, protocol.STATUSWORD)
    if reply is None or reply.data[0] == ABORT:
        return None
    return state_of(value_in(reply, protocol.STATUSWORD)) == protocol.OPERATION_ENABLED


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Shut the drive down, and then disable it so far that no target enables it; raises DialogueFailed."""
    node = Node(joint, arm.joints[joint])
    for word in (protocol.SHUT_DOWN, protocol.NO_VOLTAGE):
        yield from node.write(protocol.CONTROLWORD, word)
        state = yield from _until(arm, node, lambda state: state not in protocol.HOLDING)
        if state in protocol.HOLDING:
            raise DialogueFailed(
                joint,
                f"The drive of {node.config.name} stays in the state {state_words(state)} after being told to let go: "
                "keep clear of the arm, look at the drive with its maker's program, then `rtarm clear-fault`, which "
                "brings all drives up again.",
            )


def state_of(statusword: int) -> int:
    """The state in a statusword; NOT_READY if it holds none of the known states."""
    return next((value for mask, value, _ in protocol.STATES if statusword & mask == value), protocol.NOT_READY)


def state_words(state: int) -> str:
    """A state in words."""
    return next(words for _, value, words in protocol.STATES if value == state)


def error_words(code: int) -> str:
    """An error code (603F) in words."""
    return f"{code_words(code, protocol.ERRORS) or 'none that is known'}, error code {code:04X}"


def interpolation_time(period_s: float) -> tuple[int, int]:
    """Values of objects 60C2:01 and 60C2:02 for a time: units and their power of ten; nearest first, then coarsest."""
    found = (MOST_UNITS, COARSEST_POWER)
    closest = math.inf
    for power in range(COARSEST_POWER, FINEST_POWER - 1, -1):
        units = min(max(round(period_s / 10.0**power), 1), MOST_UNITS)
        away = abs(units * 10.0**power - period_s)
        if away < 0.99 * closest:
            found, closest = (units, power), away
    return found


def _drive(config: JointConfig) -> Cia402Drive:
    assert isinstance(config.drive, Cia402Drive)
    return config.drive


def _sync_delay_s(arm: ArmConfig, drive: Cia402Drive) -> float:
    """Time (s) from the start of a cycle until its SYNC has ended; all targets of the arm are sent before the SYNC."""
    targets = [frames for joint in arm.joints for frames in joint.drive.commands(arm.bus) if frames.from_host]
    return _through_s(arm, [*targets, *drive.for_all(arm.bus)])


def _answer_delay_s(arm: ArmConfig, drive: Cia402Drive) -> float:
    """Time (s) from a drive's sampling at the SYNC until its answer has arrived, without the drive's processing time.

    All drives answer at once, and the lowest node number wins the bus.
    """
    drives = [joint.drive for joint in arm.joints if isinstance(joint.drive, Cia402Drive)]
    before = sorted((other for other in drives if other.node_id <= drive.node_id), key=lambda other: other.node_id)
    return _through_s(arm, [frames for other in before for frames in other.readings(arm.bus)])


def _through_s(arm: ArmConfig, frames: Sequence[CycleFrames]) -> float:
    """Time (s) that frames take, one after the other, over the bus and, at the same time, over the serial line."""
    found = budget(arm)
    byte_s = 0.0 if found.serial_baud is None else UART_BITS_PER_CHARACTER / found.serial_baud
    on_bus_s = [part.bits / arm.bus.bitrate for part in frames]
    on_line_s = [found.adapter.bytes_of(part) * byte_s for part in frames]
    return max(sum(on_bus_s) + on_line_s[0], sum(on_line_s) + on_bus_s[-1])


def _order(node: Node, order: int) -> Frame:
    """A command to the node (NMT), which the node does not answer."""
    return Frame(NMT, bytes((order, node.number)), kind=STANDARD)


def _is_a_drive(host: Host, node: Node) -> Part[None]:
    """Check that the node answers and is a CiA 402 drive with CSP; a stopped node answers only once it is started."""
    name = node.config.name
    answer = yield reading(node.number, protocol.DEVICE_TYPE)
    if answer is None:
        yield say(_order(node, protocol.START_NODE))
        answer = yield reading(node.number, protocol.DEVICE_TYPE)
    if answer is None:
        rate = f"its node number and bit rate ({host.arm.bus_of(node.config).bitrate} bit/s)"
        raise unanswered(node.joint, node.config, f"node {node.number}", rate)
    device = value_in(answer, protocol.DEVICE_TYPE)
    if device & 0xFFFF != protocol.PROFILE:
        raise DialogueFailed(
            node.joint,
            f"Node {node.number}, where the drive of {name} should be, has the device type {device:#010x}, whose "
            f"lower half must be {protocol.PROFILE:#06x} (profile CiA 402): see what stands at that number, or correct "
            "node_id.",
        )
    modes = yield from node.read_if_there(protocol.MODES)
    if modes is not None and not modes & protocol.CSP_SUPPORTED:
        raise DialogueFailed(
            node.joint,
            f"The drive of {name} cannot do cyclic synchronous position, which is bit 7 of its supported modes (object "
            f"6502 is {modes:#x}): see whether other firmware can, or use another drive.",
        )


def _sound_state(host: Host, node: Node) -> Part[int]:
    """The drive's state, which is no fault: a fault is cleared if the operator asked for that, else it raises."""
    state = yield from _until(host.arm, node, lambda state: state not in (protocol.NOT_READY, protocol.FAULT_REACTION))
    if state not in (protocol.FAULT, protocol.FAULT_REACTION):
        return state
    why = error_words((yield from node.read_if_there(protocol.ERROR_CODE)) or 0)

    def cleared() -> Part[int]:
        yield from node.write(protocol.CONTROLWORD, protocol.NO_VOLTAGE)
        yield from node.write(protocol.CONTROLWORD, protocol.FAULT_RESET)
        return (
            yield from _until(
                host.arm, node, lambda state: state not in (protocol.NOT_READY, protocol.FAULT, protocol.FAULT_REACTION)
            )
        )

    return (
        yield from without_error(
            host,
            node.joint,
            state,
            lambda state: why if state in (protocol.FAULT, protocol.FAULT_REACTION) else "",
            cleared,
            find="find it with the drive's own program",
            tries=1,
        )
    )


def _looks(arm: ArmConfig, duration_s: float) -> int:
    """Number of questions that take at least `duration_s`: each of them takes a cycle or more."""
    return math.ceil(duration_s * 1e9 / arm.control.period_ns)


def _until(arm: ArmConfig, node: Node, wanted: Callable[[int], bool]) -> Part[int]:
    """Read the drive's state until it is as wanted, or for about BUSY_S; the last state."""
    state = state_of((yield from node.read(protocol.STATUSWORD)))
    for _ in range(_looks(arm, BUSY_S)):
        if wanted(state):
            break
        state = state_of((yield from node.read(protocol.STATUSWORD)))
    return state


def _halt(arm: ArmConfig, node: Node) -> Part[None]:
    """Halt a drive that is enabled in another mode, so that it comes to rest and holds."""
    yield from node.write(protocol.CONTROLWORD, protocol.HALT)
    before = yield from node.read(protocol.POSITION)
    for _ in range(_looks(arm, arm.patience.drives_s)):
        here = yield from node.read(protocol.POSITION)
        if abs(here - before) <= STANDING_COUNTS:
            return
        before = here
    raise DialogueFailed(
        node.joint,
        f"The drive of {node.config.name} is moving and does not halt (bit 8 of its controlword): use the switch in "
        "the power line, then `rtarm clear-fault`.",
    )


def _map(node: Node, drive: Cia402Drive, holds: bool) -> Part[None]:
    """Map what the cycle sends into RPDO1 and what it reads into TPDO1, and turn the other predefined PDOs off."""
    told = (
        protocol.TPDO1_OBJECTS if drive.rated_torque_nm is None else (*protocol.TPDO1_OBJECTS, protocol.TORQUE_OBJECT)
    )
    wanted = ((pdo.RECEIVED, RPDO1 + node.number, protocol.RPDO1_OBJECTS), (pdo.TOLD, TPDO1 + node.number, told))
    try:
        fitting = True
        for first, identifier, objects in wanted:
            fitting = fitting and (yield from pdo.fits(node, first, identifier, objects))
        if not fitting:
            if not holds:
                yield say(_order(node, protocol.ENTER_PRE_OPERATIONAL))
            for first, identifier, objects in wanted:
                yield from pdo.map_anew(node, first, identifier, objects)
        for first in (pdo.RECEIVED, pdo.TOLD):
            for number in range(1, pdo.PREDEFINED):
                yield from pdo.turn_off(node, first + number)
    except Aborted as aborted:
        if not holds:
            raise
        raise DialogueFailed(
            node.joint,
            f"The drive of {node.config.name} holds its joint and does not let its process data be changed meanwhile "
            f"({abort_words(aborted.code)}): support the arm, switch the drive off and on, {CLEAR_OR_START}.",
        ) from aborted


def _set_up(host: Host, node: Node) -> Part[None]:
    """Set the SYNC identifier, heartbeat and interpolation time, and make the drive hold when the host is silent."""
    yield from node.ensure(protocol.SYNC_IDENTIFIER, SYNC)
    yield from node.ensure(protocol.HEARTBEAT_MS, _drive(node.config).heartbeat_ms)
    for number in range(1, ((yield from node.read_if_there(protocol.MONITORED_NODES)) or 0) + 1):
        yield from node.ensure(Object(protocol.MONITORED_NODES.index, number, 4, "monitored heartbeat"), 0)
    try:
        yield from node.ensure(protocol.CONNECTION_LOST, 0)
    except Aborted as aborted:
        host.tell(
            f"{node.config.name}: its drive keeps what it does when its connection is lost (object 6007, "
            f"{abort_words(aborted.code)}); see in its manual whether it then lets the joint go."
        )
    yield from _set_interpolation_time(host, node)


def _set_interpolation_time(host: Host, node: Node) -> Part[None]:
    units, power = interpolation_time(host.arm.control.period_ns * 1e-9)
    shown = f"{units * 10.0 ** (power + 3):g} ms"
    found = yield from node.read_if_there(protocol.INTERPOLATION_TIME)
    if found is None:
        host.tell(
            f"{node.config.name}: its drive has no interpolation time (object 60C2); see in its manual how it is told "
            f"that targets come every {shown}."
        )
        return
    found_power = yield from node.read(protocol.INTERPOLATION_POWER)
    if math.isclose(found * 10.0**found_power, units * 10.0**power):
        return
    try:
        yield from node.write(protocol.INTERPOLATION_TIME, units)
        yield from node.write(protocol.INTERPOLATION_POWER, power)
    except Aborted as aborted:
        raise DialogueFailed(
            node.joint,
            f"The drive of {node.config.name} does not take {shown} from target to target (object 60C2, "
            f"{abort_words(aborted.code)}): choose a control.rate_hz whose period it takes, such as 250, 200, 125 or "
            "100.",
        ) from aborted


def _start(arm: ArmConfig, node: Node) -> Part[None]:
    """Start the node, and check that its TPDO1 comes: the cycle sends SYNCs all the while."""
    length = _drive(node.config).tpdo1_bytes
    started = AskFrames(
        (_order(node, protocol.START_NODE),),
        lambda frame: frame.id == TPDO1 + node.number and len(frame.data) == length,
    )
    if (yield started) is None:
        raise DialogueFailed(
            node.joint,
            f"The drive of {node.config.name} tells no position with each SYNC (TPDO1, {length} bytes on identifier "
            f"{TPDO1 + node.number:03X}) although it is mapped so: see in its manual what its PDOs need.",
        )


def _target_here(node: Node) -> Part[None]:
    """Set the drive's target to its measured position."""
    yield from node.write(protocol.TARGET, (yield from _place(node)))


def _place(node: Node) -> Part[int]:
    """The drive's measured position (counts), read until two readings agree."""
    return (
        yield from confirmed(lambda: node.read(protocol.POSITION), SAME_PLACE_RAD * node.config.encoder_counts_per_rad)
    )


def _until_csp(arm: ArmConfig, node: Node) -> Part[None]:
    shown = protocol.CSP
    for _ in range(_looks(arm, arm.patience.drives_s)):
        shown = yield from node.read(protocol.MODE_SHOWN)
        if shown == protocol.CSP:
            return
    raise DialogueFailed(
        node.joint,
        f"The drive of {node.config.name} stays in mode {shown} (object 6061) after it was told mode {protocol.CSP}, "
        "cyclic synchronous position: see in its manual what hinders that.",
    )


def _enable(arm: ArmConfig, node: Node, state: int) -> Part[None]:
    """Enable the drive state by state; its target is set to its measured position right before the last step."""
    steps = (
        (protocol.SHUT_DOWN, protocol.READY),
        (protocol.SWITCH_ON, protocol.SWITCHED_ON),
        (protocol.ENABLE_OPERATION, protocol.OPERATION_ENABLED),
    )
    for word, wanted in steps[2:] if state == protocol.QUICK_STOP else steps:
        if word == protocol.ENABLE_OPERATION:
            yield from _target_here(node)
        yield from node.write(protocol.CONTROLWORD, word)
        state = yield from _until(arm, node, (wanted, protocol.FAULT).__contains__)
        if state == wanted:
            continue
        why = ""
        if state == protocol.FAULT:
            why = f" ({error_words((yield from node.read_if_there(protocol.ERROR_CODE)) or 0)})"
        raise DialogueFailed(
            node.joint,
            f"The drive of {node.config.name} is in the state {state_words(state)}{why} after being told to go to "
            f"{state_words(wanted)}: check the motor's supply, the enabling input and safe torque off (STO), "
            f"{CLEAR_OR_START}.",
        )


def _standing(host: Host, node: Node) -> Part[Found]:
    """The drive's position and target; a target too far from the position is set to it, which ends pushing."""
    drive = _drive(node.config)
    most = host.arm.limits.following_error_rad * node.config.encoder_counts_per_rad
    here = yield from _place(node)
    target = yield from node.read(protocol.TARGET)
    if abs(target - here) > most:
        yield from node.write(protocol.TARGET, here)
        target = here
    return Found(here, target, Unreferenced.REFERENCED if drive.knows_its_angle else Unreferenced.INCREMENTAL)
