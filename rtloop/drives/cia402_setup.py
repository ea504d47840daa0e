"""Bring-up and release of a CiA 402 drive over CANopen; what the cycle's frames are is said in `rtloop.drives.cia402`.

All of it is service data (SDO) and two orders to the node (NMT), and all of it is volatile: nothing is stored in the
drive. What is as it should be is not written.

A drive that holds its joint is never let go: its node is not taken out of operation, since the drive may then let go
(6007); what must be mapped otherwise is mapped in operation, and where the drive refuses that, a sentence says what a
person can do. One that is on its way in another mode is halted first. One that holds nothing is taken out of operation,
told what its process data are, and enabled state by state with its target where it stands.

Silence of the host is to end in a drive that holds. So whatever would make it fail in silence is taken back: monitoring
of the host's heartbeat (1016), and what it does when its connection is lost (6007).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from config.budget import UART_BITS_PER_CHARACTER, budget
from config.drives.cia402 import (
    EMERGENCY,
    HEARTBEAT,
    HIGHEST_COUNT,
    NMT,
    RPDO1,
    RPDO1_BYTES,
    SYNC,
    TPDO1,
    Cia402Drive,
)
from config.frames import CycleFrames
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import pdo
from rtloop.drives.arming import Arming, stayed_armed
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import ErrorCode, code_words
from rtloop.drives.sdo import ABORT, Aborted, Node, Object, abort_words, reading, value_in
from rtloop.drives.setup import SAME_PLACE_RAD, Found, Host, PowerHost
from rtloop.drives.steps import unanswered, without_error
from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import Dialogue, DialogueFailed, Part
from rtloop.service.port import Frame
from shm.words import Unreferenced

__all__ = ["EMERGENCY", "HEARTBEAT", "HIGHEST_COUNT", "RPDO1", "RPDO1_BYTES", "SYNC", "TPDO1"]

START_NODE, ENTER_PRE_OPERATIONAL = 0x01, 0x80
"""Orders to a node (NMT)."""
BOOT_UP, OPERATIONAL = 0x00, 0x05
"""States of a node, as its heartbeat tells them."""

SHUT_DOWN, SWITCH_ON, ENABLE_OPERATION = 0x06, 0x07, 0x0F
NO_VOLTAGE, FAULT_RESET, HALT = 0x00, 0x80, 0x010F
"""Controlwords (6040); a fault is reset by the rising edge of bit 7, HALT is an enabled drive's."""

STATE_MASK, FAULT_MASK = 0x6F, 0x4F
NOT_READY, SWITCH_ON_DISABLED, READY, SWITCHED_ON = 0x00, 0x40, 0x21, 0x23
OPERATION_ENABLED, QUICK_STOP, FAULT_REACTION, FAULT = 0x27, 0x07, 0x0F, 0x08
STATES = (
    (FAULT_MASK, NOT_READY, "not ready to switch on"),
    (FAULT_MASK, SWITCH_ON_DISABLED, "switch-on disabled"),
    (STATE_MASK, READY, "ready to switch on"),
    (STATE_MASK, SWITCHED_ON, "switched on"),
    (STATE_MASK, OPERATION_ENABLED, "operation enabled"),
    (STATE_MASK, QUICK_STOP, "quick stop active"),
    (FAULT_MASK, FAULT_REACTION, "fault reaction active"),
    (FAULT_MASK, FAULT, "fault"),
)
"""States of the drive in its statusword (6041): mask, value, name."""
HOLDING = (OPERATION_ENABLED, QUICK_STOP)

CSP = 8
CSP_SUPPORTED = 1 << 7
PROFILE = 402

DEVICE_TYPE = Object(0x1000, 0, 4, "device type")
SYNC_IDENTIFIER = Object(0x1005, 0, 4, "SYNC identifier")
MONITORED_NODES = Object(0x1016, 0, 1, "number of monitored heartbeats")
HEARTBEAT_MS = Object(0x1017, 0, 2, "heartbeat time")
ERROR_CODE = Object(0x603F, 0, 2, "error code")
CONNECTION_LOST = Object(0x6007, 0, 2, "what a lost connection does", signed=True)
CONTROLWORD = Object(0x6040, 0, 2, "controlword")
STATUSWORD = Object(0x6041, 0, 2, "statusword")
MODE = Object(0x6060, 0, 1, "mode of operation", signed=True)
MODE_SHOWN = Object(0x6061, 0, 1, "mode of operation shown", signed=True)
POSITION = Object(0x6064, 0, 4, "position", signed=True)
TARGET = Object(0x607A, 0, 4, "target position", signed=True)
INTERPOLATION_TIME = Object(0x60C2, 1, 1, "interpolation time")
INTERPOLATION_POWER = Object(0x60C2, 2, 1, "interpolation time's power of ten", signed=True)
MODES = Object(0x6502, 0, 4, "supported modes")

RPDO1_OBJECTS = (0x6040_0010, 0x607A_0020)
TPDO1_OBJECTS = (0x6041_0010, 0x6064_0020)
TORQUE_OBJECT = 0x6077_0010
"""What is mapped: index, sub-index and bits."""

BUSY_S = 2.0
"""Within which a drive goes from state to state, a brake that opens included."""
STANDING_COUNTS = 2
"""Two readings of one that stands differ by no more."""
FINEST_POWER, COARSEST_POWER, MOST_UNITS = -6, -2, 255
"""Of an interpolation time: one byte of microseconds to one of hundredths of a second."""

ERRORS = (
    ErrorCode(0xF000, 0x1000, "a general error"),
    ErrorCode(0xF000, 0x2000, "current", status_bits.OVER_CURRENT),
    ErrorCode(0xF0F0, 0x3010, "over-voltage", status_bits.OVER_VOLTAGE),
    ErrorCode(0xF0F0, 0x3020, "under-voltage", status_bits.UNDER_VOLTAGE),
    ErrorCode(0xF000, 0x3000, "voltage"),
    ErrorCode(0xF0F0, 0x4020, "too cold"),
    ErrorCode(0xF000, 0x4000, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorCode(0xFFF0, 0x5110, "the drive's electronics", status_bits.UNDER_VOLTAGE),  # their supply
    ErrorCode(0xF000, 0x5000, "the drive's electronics"),
    ErrorCode(0xF000, 0x6000, "the drive's software"),
    ErrorCode(0xFFFF, 0x7121, "motor blocked", status_bits.STALLED),
    ErrorCode(0xFF00, 0x7300, "sensor", status_bits.ENCODER),
    ErrorCode(0xFF00, 0x7500, "communication", status_bits.COMMUNICATION),
    ErrorCode(0xF000, 0x7000, "a module beside the drive"),
    ErrorCode(0xFF00, 0x8000, "monitoring"),
    ErrorCode(0xFF00, 0x8100, "communication", status_bits.COMMUNICATION),
    ErrorCode(0xFF00, 0x8200, "communication", status_bits.COMMUNICATION),
    ErrorCode(0xFFFF, 0x8611, "following error", status_bits.STALLED),
    ErrorCode(0xF000, 0x8000, "control"),
    ErrorCode(0xF000, 0xF000, "an error of its own kind"),
)
"""Error codes by the first that fits (CiA 301, emergencies; CiA 402, object 603F)."""


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """What the cycle needs of a CiA 402 drive; see `rtloop.drives.setup.Setup`."""
    drive = _drive(joint)
    row["position_bytes"] = drive.tpdo1_bytes
    row["command_delay_s"] = _sync_delay_s(arm, drive)
    row["reply_delay_ns"] = round((_answer_delay_s(arm, drive) + drive.processing_s) * 1e9)
    if drive.rated_torque_nm is not None:
        row["effort_per_unit"] = joint.direction * joint.ratio * drive.rated_torque_nm * 1e-3


def bring_up(host: Host, joint: int) -> Part[Found]:
    """What `rtloop.drives.setup.Setup` says; see the head of this file."""
    config = host.arm.joints[joint]
    node = Node(joint, config)
    yield from _is_a_drive(host, node)
    state = yield from _sound_state(host, node)
    arming = Arming(host, joint, lambda: _is_enabled(node))
    enabled = state == OPERATION_ENABLED
    if (yield from arming.found(enabled)) != enabled:  # which was garbled
        state = yield from _sound_state(host, node)
    holds = state in HOLDING
    if holds and (yield from node.read(MODE_SHOWN)) != CSP:
        yield from _halt(host.arm, node)
    yield from _map(node, _drive(config), holds)
    yield from _set_up(host, node)
    yield from _start(host.arm, node)
    if not holds or (yield from node.read(MODE_SHOWN)) != CSP:
        yield from _target_here(node)
        yield from node.write(MODE, CSP)
        yield from _until_csp(host.arm, node)
    if state != OPERATION_ENABLED:
        arming.begins()
        yield from _enable(host.arm, node, state)
    elif (yield from node.read(CONTROLWORD)) != ENABLE_OPERATION:
        yield from node.write(CONTROLWORD, ENABLE_OPERATION)
    found = yield from _standing(host, node)
    if found.reason == Unreferenced.REFERENCED:
        return found
    return found._replace(kept_power=(yield from arming.kept_power()))


def kept_power(host: PowerHost, joint: int) -> Part[bool]:
    """What `rtloop.drives.setup.PowerProof` says."""
    node = Node(joint, host.arm.joints[joint])
    return (yield from stayed_armed(host, joint, lambda: _is_enabled(node)))


def _is_enabled(node: Node) -> Part[bool | None]:
    """Whether its operation is enabled; None where it does not say."""
    reply = yield reading(node.number, STATUSWORD)
    if reply is None or reply.data[0] == ABORT:
        return None
    return state_of(value_in(reply, STATUSWORD)) == OPERATION_ENABLED


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Shut the drive down, and then so far that no target enables it; raises DialogueFailed."""
    node = Node(joint, arm.joints[joint])
    for word in (SHUT_DOWN, NO_VOLTAGE):
        yield from node.write(CONTROLWORD, word)
        state = yield from _until(arm, node, lambda state: state not in HOLDING)
        if state in HOLDING:
            raise DialogueFailed(
                joint,
                f"The drive of {node.config.name} stays in the state {state_words(state)} after being told to let go: "
                "keep clear of the arm, look at the drive with its maker's program, then `rtarm clear-fault`, which "
                "brings all drives up again.",
            )


def state_of(statusword: int) -> int:
    """The state that a statusword tells; one that is none is NOT_READY."""
    return next((value for mask, value, _ in STATES if statusword & mask == value), NOT_READY)


def state_words(state: int) -> str:
    """A state for people."""
    return next(words for _, value, words in STATES if value == state)


def error_words(code: int) -> str:
    """An error code (603F) for people."""
    return f"{code_words(code, ERRORS) or 'none that is known'}, error code {code:04X}"


def interpolation_time(period_s: float) -> tuple[int, int]:
    """Objects 60C2:01 and 60C2:02 for a time: units and their power of ten, as coarse as they are exact."""
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
    """Time from the start of a cycle until its SYNC has ended, which all targets of the arm go before."""
    targets = [frames for joint in arm.joints for frames in joint.drive.commands(arm.bus) if frames.from_host]
    return _through_s(arm, [*targets, *drive.for_all(arm.bus)])


def _answer_delay_s(arm: ArmConfig, drive: Cia402Drive) -> float:
    """Time from a drive's sampling at the SYNC until its answer has arrived, beside its own for processing.

    All answer at once, and the lowest node goes first.
    """
    drives = [joint.drive for joint in arm.joints if isinstance(joint.drive, Cia402Drive)]
    before = sorted((other for other in drives if other.node_id <= drive.node_id), key=lambda other: other.node_id)
    return _through_s(arm, [frames for other in before for frames in other.readings(arm.bus)])


def _through_s(arm: ArmConfig, frames: Sequence[CycleFrames]) -> float:
    """Time that frames take one after the other, over the bus and, at the same time, over the serial line (s)."""
    found = budget(arm)
    byte_s = 0.0 if found.serial_baud is None else UART_BITS_PER_CHARACTER / found.serial_baud
    on_bus_s = [part.bits / arm.bus.bitrate for part in frames]
    on_line_s = [found.adapter.bytes_of(part) * byte_s for part in frames]
    return max(sum(on_bus_s) + on_line_s[0], sum(on_line_s) + on_bus_s[-1])


def _order(node: Node, order: int) -> Frame:
    """An order to the node (NMT), which nothing answers."""
    return Frame(NMT, bytes((order, node.number)), kind=STANDARD)


def _is_a_drive(host: Host, node: Node) -> Part[None]:
    """See that it answers and what it is. A node that was stopped does so only after it was started."""
    name = node.config.name
    answer = yield reading(node.number, DEVICE_TYPE)
    if answer is None:
        yield say(_order(node, START_NODE))
        answer = yield reading(node.number, DEVICE_TYPE)
    if answer is None:
        rate = f"its node number and bit rate ({host.arm.bus.bitrate} bit/s)"
        raise unanswered(node.joint, node.config, f"node {node.number}", rate)
    device = value_in(answer, DEVICE_TYPE)
    if device & 0xFFFF != PROFILE:
        raise DialogueFailed(
            node.joint,
            f"Node {node.number}, where the drive of {name} should be, has the device type {device:#010x}, whose lower "
            f"half must be {PROFILE:#06x} (profile CiA 402): see what stands at that number, or correct node_id.",
        )
    modes = yield from node.read_if_there(MODES)
    if modes is not None and not modes & CSP_SUPPORTED:
        raise DialogueFailed(
            node.joint,
            f"The drive of {name} cannot do cyclic synchronous position, which is bit 7 of its supported modes (object "
            f"6502 is {modes:#x}): see whether other firmware can, or use another drive.",
        )


def _sound_state(host: Host, node: Node) -> Part[int]:
    """The drive's state, which is no fault; one is cleared only where a person has asked for that."""
    state = yield from _until(host.arm, node, lambda state: state not in (NOT_READY, FAULT_REACTION))
    if state not in (FAULT, FAULT_REACTION):
        return state
    why = error_words((yield from node.read_if_there(ERROR_CODE)) or 0)

    def cleared() -> Part[int]:
        yield from node.write(CONTROLWORD, NO_VOLTAGE)
        yield from node.write(CONTROLWORD, FAULT_RESET)
        return (yield from _until(host.arm, node, lambda state: state not in (NOT_READY, FAULT, FAULT_REACTION)))

    return (
        yield from without_error(
            host,
            node.joint,
            state,
            lambda state: why if state in (FAULT, FAULT_REACTION) else "",
            cleared,
            find="find it with the drive's own program",
            tries=1,
        )
    )


def _looks(arm: ArmConfig, duration_s: float) -> int:
    """Questions that take so long (s) or longer: each waits for a cycle at least."""
    return math.ceil(duration_s * 1e9 / arm.control.period_ns)


def _until(arm: ArmConfig, node: Node, wanted: Callable[[int], bool]) -> Part[int]:
    """The drive's state once it is as wanted, or the last within a while."""
    state = state_of((yield from node.read(STATUSWORD)))
    for _ in range(_looks(arm, BUSY_S)):
        if wanted(state):
            break
        state = state_of((yield from node.read(STATUSWORD)))
    return state


def _halt(arm: ArmConfig, node: Node) -> Part[None]:
    """Let a drive that is led in another mode come to rest and hold."""
    yield from node.write(CONTROLWORD, HALT)
    before = yield from node.read(POSITION)
    for _ in range(_looks(arm, arm.patience.drives_s)):
        here = yield from node.read(POSITION)
        if abs(here - before) <= STANDING_COUNTS:
            return
        before = here
    raise DialogueFailed(
        node.joint,
        f"The drive of {node.config.name} is moving and does not halt (bit 8 of its controlword): use the switch in "
        "the power line, then `rtarm clear-fault`.",
    )


def _map(node: Node, drive: Cia402Drive, holds: bool) -> Part[None]:
    """Let the drive hear and tell what the cycle says and wants, and no process data besides."""
    told = TPDO1_OBJECTS if drive.rated_torque_nm is None else (*TPDO1_OBJECTS, TORQUE_OBJECT)
    wanted = ((pdo.RECEIVED, RPDO1 + node.number, RPDO1_OBJECTS), (pdo.TOLD, TPDO1 + node.number, told))
    try:
        fitting = True
        for first, identifier, objects in wanted:
            fitting = fitting and (yield from pdo.fits(node, first, identifier, objects))
        if not fitting:
            if not holds:
                yield say(_order(node, ENTER_PRE_OPERATIONAL))
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
            f"({abort_words(aborted.code)}): support the arm, switch the drive off and on, then `rtarm clear-fault`, "
            "or `rtarm up` where it has ended.",
        ) from aborted


def _set_up(host: Host, node: Node) -> Part[None]:
    """The beat of its targets, its heartbeat, and that silence lets nothing go."""
    yield from node.ensure(SYNC_IDENTIFIER, SYNC)
    yield from node.ensure(HEARTBEAT_MS, _drive(node.config).heartbeat_ms)
    for number in range(1, ((yield from node.read_if_there(MONITORED_NODES)) or 0) + 1):
        yield from node.ensure(Object(MONITORED_NODES.index, number, 4, "monitored heartbeat"), 0)
    try:
        yield from node.ensure(CONNECTION_LOST, 0)
    except Aborted as aborted:
        host.tell(
            f"{node.config.name}: its drive keeps what it does when its connection is lost (object 6007, "
            f"{abort_words(aborted.code)}); see in its manual whether it then lets the joint go."
        )
    yield from _set_interpolation_time(host, node)


def _set_interpolation_time(host: Host, node: Node) -> Part[None]:
    units, power = interpolation_time(host.arm.control.period_ns * 1e-9)
    shown = f"{units * 10.0 ** (power + 3):g} ms"
    found = yield from node.read_if_there(INTERPOLATION_TIME)
    if found is None:
        host.tell(
            f"{node.config.name}: its drive has no interpolation time (object 60C2); see in its manual how it is told "
            f"that targets come every {shown}."
        )
        return
    found_power = yield from node.read(INTERPOLATION_POWER)
    if math.isclose(found * 10.0**found_power, units * 10.0**power):
        return
    try:
        yield from node.write(INTERPOLATION_TIME, units)
        yield from node.write(INTERPOLATION_POWER, power)
    except Aborted as aborted:
        raise DialogueFailed(
            node.joint,
            f"The drive of {node.config.name} does not take {shown} from target to target (object 60C2, "
            f"{abort_words(aborted.code)}): choose a control.rate_hz whose period it takes, such as 250, 200, 125 or "
            "100.",
        ) from aborted


def _start(arm: ArmConfig, node: Node) -> Part[None]:
    """Let its process data begin, and see that they do: the cycle asks for them all the while."""
    length = _drive(node.config).tpdo1_bytes
    started = AskFrames(
        (_order(node, START_NODE),), lambda frame: frame.id == TPDO1 + node.number and len(frame.data) == length
    )
    if (yield started) is None:
        raise DialogueFailed(
            node.joint,
            f"The drive of {node.config.name} tells no position with each SYNC (TPDO1, {length} bytes on identifier "
            f"{TPDO1 + node.number:03X}) although it is mapped so: see in its manual what its PDOs need.",
        )


def _target_here(node: Node) -> Part[None]:
    """Put its target where it stands."""
    yield from node.write(TARGET, (yield from _place(node)))


def _place(node: Node) -> Part[int]:
    """Where it stands (counts)."""
    return (yield from confirmed(lambda: node.read(POSITION), SAME_PLACE_RAD * node.config.encoder_counts_per_rad))


def _until_csp(arm: ArmConfig, node: Node) -> Part[None]:
    shown = CSP
    for _ in range(_looks(arm, arm.patience.drives_s)):
        shown = yield from node.read(MODE_SHOWN)
        if shown == CSP:
            return
    raise DialogueFailed(
        node.joint,
        f"The drive of {node.config.name} stays in mode {shown} (object 6061) after it was told mode {CSP}, cyclic "
        "synchronous position: see in its manual what hinders that.",
    )


def _enable(arm: ArmConfig, node: Node, state: int) -> Part[None]:
    """From state to state, with the target where it stands until it holds it there."""
    steps = ((SHUT_DOWN, READY), (SWITCH_ON, SWITCHED_ON), (ENABLE_OPERATION, OPERATION_ENABLED))
    for word, wanted in steps[2:] if state == QUICK_STOP else steps:
        if word == ENABLE_OPERATION:
            yield from _target_here(node)
        yield from node.write(CONTROLWORD, word)
        state = yield from _until(arm, node, (wanted, FAULT).__contains__)
        if state == wanted:
            continue
        why = ""
        if state == FAULT:
            why = f" ({error_words((yield from node.read_if_there(ERROR_CODE)) or 0)})"
        raise DialogueFailed(
            node.joint,
            f"The drive of {node.config.name} is in the state {state_words(state)}{why} after being told to go to "
            f"{state_words(wanted)}: check the motor's supply, the enabling input and safe torque off (STO), then "
            "`rtarm clear-fault`, or `rtarm up` where it has ended.",
        )


def _standing(host: Host, node: Node) -> Part[Found]:
    """Where it stands, and its own target; one that is far from it is put there, which ends pushing."""
    drive = _drive(node.config)
    most = host.arm.limits.following_error_rad * node.config.encoder_counts_per_rad
    here = yield from _place(node)
    target = yield from node.read(TARGET)
    if abs(target - here) > most:
        yield from node.write(TARGET, here)
        target = here
    return Found(here, target, Unreferenced.REFERENCED if drive.knows_its_angle else Unreferenced.INCREMENTAL)
