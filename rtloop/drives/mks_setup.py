"""Bring-up, homing and disabling of an MKS SERVO42D/57D.

Bring-up reads (nothing moves): position, whether the drive moves, work mode, microsteps and acknowledgements, whether
it has stalled and whether a stall switches its torque off, whether it is enabled, and how far it is from its own
target. A moving drive is stopped first. Two settings are written where they differ: the work mode SR_vFOC (`82`),
without which the drive ignores motion commands, and whether it acknowledges (`8C`); the drive keeps both without power.
Firmware before V1.0.6 cannot be asked for settings (`00`), so they are written each time.

The drive's count begins where it was switched on, and nothing reports that it was.
"""

from collections.abc import Callable

import numpy as np

from config.budget import budget
from config.derived import braking_deceleration_rad_s2, silence_acc_byte
from config.drives.mks import COUNTS_PER_REVOLUTION, MksDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import mks_protocol as protocol
from rtloop.drives.asking import AskFrames
from rtloop.drives.numbers import packed, unpacked
from rtloop.drives.setup import CLEAR_OR_START, ERROR_AT_START, Found, Host, ReferencingHost
from rtloop.drives.steps import answered, let_go, unanswered
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part
from rtloop.service.port import HOLDS_STALLED, Frame
from sentences.told import unreferenced_sentence
from shm.words import Unreferenced

STOP_AT_ONCE = packed({protocol.CODE: protocol.MOVE}, protocol.TARGET_BYTES)
"""Speed 0 without a ramp: stop in position mode, as the manual has it (V1.0.6, 6.8)."""
AGREEING = 2
"""Answers in a row that must agree: a single one may hold for a moment only."""
SYNC_WITHIN_RAD = 0.02
"""Largest distance between a drive's target and its position for which the target is accepted."""
HALT_PATIENCE_S = 4.0
"""Least timeout of a halt, from 3000 rpm to rest with a ramp of 750 rpm/s; then the drive is stopped at once."""
SETTLE_PATIENCE_NS = 3_000_000_000
BEGIN_NS = 1_000_000_000
"""Time within which a homing run must begin."""
LATE_S = 1.0
BOOT_NS = 100_000_000
"""A drive that is switched off and on does not answer for longer than this (unproven)."""
BOOT_PERIODS = 4
"""Cycles that an answer may take at low rates anyway."""


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of an MKS drive for the cycle; see `rtloop.drives.setup.Setup`."""
    row["acc_byte"] = silence_acc_byte(joint, arm.limits)
    row["silence_deceleration_rad_s2"] = braking_deceleration_rad_s2(joint, int(row["acc_byte"]))


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    can_id = _can_id(config)
    if (yield ask(can_id, 8, protocol.READ_POSITION)) is None:
        menu = f"CanID and CanRate ({host.arm.bus_of(config).bitrate} bit/s) in its menu"
        raise unanswered(joint, config, f"CanID {can_id}", menu)
    was_homing = yield from _stand(host, joint)
    reason = Unreferenced.INCREMENTAL
    if was_homing:
        reason = Unreferenced.NOT_HOMED
        host.tell(unreferenced_sentence(reason, config.name))
    yield from _settle_mode(host, joint)
    yield from _settle_answers(host, joint)
    enabled = yield from _read(joint, config, protocol.READ_ENABLED, "status")
    if not (yield from lets_go_stalled(config)):
        host.post(HOLDS_STALLED, joint=joint)
    yield from _clear_protection(host, joint)
    if not enabled or not (yield from _read(joint, config, protocol.READ_ENABLED, "status")):
        yield from _enable(host.arm, joint)
    return (yield from _standing(host, joint, reason))


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Disable the drive, and check that it is disabled; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        enabled = yield ask(_can_id(config), 3, protocol.READ_ENABLED, before=(bytes((protocol.ENABLE, 0)),))
        return "" if enabled is not None and unpacked(enabled.data, protocol.VALUE) == 0 else "stays enabled"

    yield from let_go(joint, config, told)


# --- its homing run


def home(host: ReferencingHost, joint: int) -> Part[float]:
    """See `rtloop.drives.setup.Homes.home`; the drive's homing parameters (menu Hm_…) determine the run."""
    config = host.arm.joints[joint]
    can_id = _can_id(config)
    host.run_begins(joint)
    began = yield from _position(joint, config)
    yield from _begin_run(host, joint, config)
    stopped = yield from _see_it_end(host, joint, config, began)
    measured = yield from _unbroken(host, joint, _position(joint, config))
    result = yield ask(can_id, (3, 4), protocol.READ_HOMED)
    tripped = yield from _tripped(joint, config)
    failed = result is not None and result.data[-2] == protocol.HOMING_FAILED
    if failed or tripped or abs(measured) > SYNC_WITHIN_RAD * config.encoder_counts_per_rad:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} counts {measured} after its homing run, not 0, or says that the run failed or "
            "that its protection has tripped, so it has not found its stop: see that it can reach it and that Hm_Mode, "
            f"Hm_Dir, Hm_Speed and Hm_Ma in its menu fit, then {host.again}.",
        )
    if not (yield from _read(joint, config, protocol.READ_ENABLED, "status")):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has let the joint go at the end of its homing run: set EndLimit in its menu "
            f"to Disable, then {host.again}.",
        )
    target = yield from _target(joint, config)
    host.require_place(joint, stopped)
    return target


def end_homing(host: ReferencingHost, joint: int) -> Dialogue:
    """See `rtloop.drives.setup.Homes.end_homing`."""
    config = host.arm.joints[joint]
    seen = 0
    for _ in range(TRIES + AGREEING):
        state = yield ask(_can_id(config), 3, protocol.READ_STATE, before=(bytes((protocol.EMERGENCY_STOP,)),))
        seen = seen + 1 if state is not None and unpacked(state.data, protocol.VALUE) == protocol.STANDS else 0
        if seen >= AGREEING:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} does not say that it has ended its homing run: it may still move, use the switch "
        "in the power line if it does.",
    )


def _begin_run(host: ReferencingHost, joint: int, config: JointConfig) -> Part[None]:
    can_id, since_ns = _can_id(config), host.now_ns
    answer = yield ask(can_id, 3, protocol.HOME, answered=False)  # its state shows whether the run has begun
    refused = answer is not None and unpacked(answer.data, protocol.VALUE) == protocol.REFUSED
    seen = 0
    while not refused and host.now_ns - since_ns < BEGIN_NS:
        state = yield from _unbroken(host, joint, _read(joint, config, protocol.READ_STATE, "state"))
        seen = seen + 1 if state == protocol.HOMING else 0
        if seen >= AGREEING:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} does not begin its homing run: look at its display for a fault, and at Hm_Mode, "
        f"Hm_Dir and Hm_Speed in its menu, then {host.again}.",
    )


def _see_it_end(host: ReferencingHost, joint: int, config: JointConfig, last: int) -> Part[int]:
    """Wait for the end of the run; the last position read before it ended, in the drive's count from before the run."""
    began_ns, newest, ended = host.now_ns, last, 0
    while ended < AGREEING:
        state = yield from _unbroken(host, joint, _read(joint, config, protocol.READ_STATE, "homing state"))
        ended = ended + 1 if state != protocol.HOMING else 0
        if not ended:
            last = newest  # the drive was still homing after this reading, so it had not reset its count yet
            newest = yield from _unbroken(host, joint, _position(joint, config))
        if host.now_ns - began_ns > (host.arm.homing.timeout_s + LATE_S) * 1e9:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} has not found its homing stop within {host.arm.homing.timeout_s:g} s: see "
                "that it can reach the stop and that Hm_Mode, Hm_Dir, Hm_Speed and Hm_Ma in its menu fit, then "
                f"{host.again}.",
            )
    return last


def _unbroken(host: ReferencingHost, joint: int, part: Part[int]) -> Part[int]:
    """Ask during a homing run, and raise DialogueFailed if the answer took as long as switching the drive off and on.

    A drive that was switched off and on counts from 0 where it stands, just as one that has found its stop.
    """
    asked_ns = host.now_ns
    value = yield from part
    if host.now_ns - asked_ns > max(BOOT_NS, BOOT_PERIODS * host.arm.control.period_ns):
        raise DialogueFailed(
            joint,
            f"The drive of {host.arm.joints[joint].name} fell silent during its homing run, so what it counts may be "
            f"no angle: see to its supply and the CAN wires, then {host.again}.",
        )
    return value


# --- bring-up


def _stand(host: Host, joint: int) -> Part[bool]:
    """Check that the drive stands, and stop it if not; whether it was in a homing run."""
    config = host.arm.joints[joint]
    can_id, began_ns = _can_id(config), host.now_ns
    acc_byte = silence_acc_byte(config, host.arm.limits)
    halt = packed({protocol.CODE: protocol.MOVE, protocol.TARGET_ACC: acc_byte}, protocol.TARGET_BYTES)
    halt_patience_ns = round(1e9 * max(HALT_PATIENCE_S, host.arm.patience.drives_s))
    before: tuple[bytes, ...] = ()
    standing, was_homing = 0, False
    while standing < AGREEING:
        answer = yield from answered(joint, config, ask(can_id, 3, protocol.READ_STATE, before=before), "state")
        state = unpacked(answer.data, protocol.VALUE)
        if state == protocol.CALIBRATING:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} is calibrating its encoder: wait until it has ended, {CLEAR_OR_START}.",
            )
        was_homing |= state == protocol.HOMING
        waited_ns = host.now_ns - began_ns
        if state in (protocol.STANDS, 0):  # 0: a work mode in which the drive reports no state and ignores commands
            standing, before = standing + 1, ()
        elif waited_ns > halt_patience_ns + SETTLE_PATIENCE_NS:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} moves and does not stop when it is told to: use the switch in the power "
                "line, then `rtarm clear-fault`.",
            )
        else:
            standing = 0
            at_once = state == protocol.HOMING or waited_ns > halt_patience_ns
            before = (bytes((protocol.EMERGENCY_STOP,)) if at_once else halt,)
    return was_homing


def _settle_mode(host: Host, joint: int) -> Part[None]:
    """Check that the drive takes commands from the bus, and their speed as rpm; set its work mode if need be."""
    config = host.arm.joints[joint]
    microsteps = yield from parameter(config, protocol.MICROSTEPS, 3)
    if microsteps is not None and (microsteps[1] or 256) not in protocol.TRUE_SPEED_MICROSTEPS:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} is set to {microsteps[1] or 256} microsteps, with which its speed is not the "
            "one it is told: set MStep in its menu to 16, 32 or 64.",
        )
    mode = yield from parameter(config, protocol.WORK_MODE, 3)
    if mode is not None and mode[1] == protocol.SR_VFOC:
        return
    if not (yield from write_setting(config, protocol.WORK_MODE, protocol.SR_VFOC)):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not take the work mode SR_vFOC, in which alone it heeds commands from "
            "the bus: set Mode in its menu.",
        )
    if mode is not None:
        host.tell(f"{config.name}: its drive was set to the work mode SR_vFOC, which it keeps.")


def _settle_answers(host: Host, joint: int) -> Part[None]:
    """Turn acknowledgements on or off as the arm file says; reports of ended motions are turned off in any case."""
    config = host.arm.joints[joint]
    wanted = int(host.arm.bus.acknowledge)
    found = yield from parameter(config, protocol.ANSWERS, 4)
    if found is not None and found[1:3] == bytes((wanted, 0)):
        return
    if (yield from write_setting(config, protocol.ANSWERS, wanted, 0)):
        if found is not None:
            name = "on" if wanted else "off"
            host.tell(f"{config.name}: acknowledgements turned {name} in its drive, which keeps that.")
        return
    part, _ = host.arm.on_every_bus(acknowledge=True).part_of(joint)
    fits = budget(part)
    if not fits.fits:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} keeps acknowledging commands, and with acknowledgements the bus carries "
            f"{fits.highest_rate_hz:.0f} Hz, not {host.arm.control.rate_hz:g} Hz: lower control.rate_hz, or set CanRSP "
            "in its menu to Disable.",
        )
    host.tell(f"{config.name}: its drive keeps its acknowledgements on although told otherwise.")


def _clear_protection(host: Host, joint: int) -> Part[None]:
    config = host.arm.joints[joint]
    if not (yield from _tripped(joint, config)):
        return
    if not host.clears_protection:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has tripped its protection (stall) and holds nothing: free what blocks the "
            f"joint, {ERROR_AT_START}.",
        )
    yield ask(_can_id(config), 3, protocol.CLEAR_PROTECTION)
    if (yield from _tripped(joint, config)):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} stays in protection after it was cleared, so what tripped it (a blocked "
            "joint, current) is still there: find it on the drive's display, then `rtarm clear-fault`.",
        )


def _tripped(joint: int, config: JointConfig) -> Part[bool]:
    """Whether the drive's protection has tripped; the flag of a stall that left the torque on is cleared (3D)."""
    if not (yield from _read(joint, config, protocol.READ_STALLED, "protection")):
        return False
    if (yield from lets_go_stalled(config)):
        return True
    yield ask(_can_id(config), 3, protocol.CLEAR_PROTECTION)
    return False


def lets_go_stalled(config: JointConfig) -> Part[bool]:
    """Whether a stall switches the torque off: `Protect` (88) is on, or the guard of the position error (9D) is.

    A setting that cannot be read is taken to be on.
    """
    can_id = _can_id(config)
    for code, length in ((protocol.PROTECT, 3), (protocol.ERROR_GUARD, 7)):
        answer = yield _parameter_question(can_id, code, (4, length))
        if answer is None or (answer.data[1:3] != protocol.UNKNOWN and answer.data[1]):
            return True
    return False


def _enable(arm: ArmConfig, joint: int) -> Part[None]:
    """Enable the drive where it stands; a stop follows immediately, in case the drive would go to an old target."""
    config = arm.joints[joint]
    before = (bytes((protocol.ENABLE, 1)), STOP_AT_ONCE)
    for _ in range(TRIES):
        enabled = yield ask(_can_id(config), 3, protocol.READ_ENABLED, before=before)
        if enabled is not None and unpacked(enabled.data, protocol.VALUE) == 1:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} stays disabled after being enabled: look at its display for a fault.",
    )


def _standing(host: Host, joint: int, reason: Unreferenced) -> Part[Found]:
    """The drive's position and its own target once they agree; after a timeout, the position serves as target too."""
    config, started_ns, stopped = host.arm.joints[joint], host.now_ns, False
    within = SYNC_WITHIN_RAD * config.encoder_counts_per_rad
    while True:
        measured = yield from _position(joint, config)
        target = yield from _target(joint, config)
        if abs(target - measured) <= within:
            return Found(measured, target, reason)
        if not stopped:  # the target is not from this process
            stopped = True
            yield ask(_can_id(config), 3, protocol.READ_STATE, before=(STOP_AT_ONCE,))
        elif host.now_ns - started_ns > SETTLE_PATIENCE_NS:
            return Found(measured, measured, reason)


# --- requests


def _can_id(config: JointConfig) -> int:
    assert isinstance(config.drive, MksDrive)
    return config.drive.can_id


def _frame(can_id: int, data: bytes) -> Frame:
    return Frame(can_id, protocol.sealed(can_id, data), kind=STANDARD)


def _is_answer(can_id: int, lengths: tuple[int, ...], code: int) -> Callable[[Frame], bool]:
    def is_answer(frame: Frame) -> bool:
        data = frame.data
        sound = len(data) in lengths and data == protocol.sealed(can_id, data[:-1])
        return sound and frame.kind == STANDARD and data[0] == code

    return is_answer


def ask(
    can_id: int, length: int | tuple[int, ...], *data: int, before: tuple[bytes, ...] = (), answered: bool = True
) -> AskFrames:
    """A command whose answer has `length` bytes; the commands `before` are sent right before it, at every try.

    The answers to `before` are not waited for. An adapter may echo the command, which has the length of its answer in
    one case (82), but never the same bytes.
    """
    lengths = (length,) if isinstance(length, int) else length
    frames = tuple(_frame(can_id, told) for told in (*before, bytes(data)))
    is_answer = _is_answer(can_id, lengths, data[0])
    return AskFrames(frames, lambda frame: is_answer(frame) and frame.data != frames[-1].data, answered)


def write_setting(config: JointConfig, *data: int) -> Part[bool]:
    """Write a setting; whether the drive accepts it."""
    can_id = _can_id(config)
    for _ in range(TRIES):
        answer = yield ask(can_id, 3, *data)
        if answer is None:
            return False
        if unpacked(answer.data, protocol.VALUE) == protocol.BEGUN:
            return True
    return False


def parameter(config: JointConfig, code: int, length: int) -> Part[bytes | None]:
    """Read a setting: the answer, of `length` bytes; None if the drive does not offer the setting for reading."""
    answer = yield _parameter_question(_can_id(config), code, (3, 4))
    if answer is None or len(answer.data) != length or answer.data[1:3] == protocol.UNKNOWN:
        return None
    return bytes(answer.data)


def _parameter_question(can_id: int, code: int, lengths: tuple[int, ...]) -> AskFrames:
    """The request for a setting; the answer of a drive that does not have it is four bytes, two of them UNKNOWN."""
    return AskFrames((_frame(can_id, bytes((protocol.READ_PARAMETER, code))),), _is_answer(can_id, lengths, code))


def _read(joint: int, config: JointConfig, code: int, what: str) -> Part[int]:
    """The byte in the answer to a request of one byte; raises DialogueFailed."""
    answer = yield from answered(joint, config, ask(_can_id(config), 3, code), what)
    return unpacked(answer.data, protocol.VALUE)


def _position(joint: int, config: JointConfig) -> Part[int]:
    """The motor's position (counts); raises DialogueFailed."""
    answer = yield from answered(joint, config, ask(_can_id(config), 8, protocol.READ_POSITION), "position")
    return unpacked(answer.data, protocol.COUNTS)


def _target(joint: int, config: JointConfig) -> Part[int]:
    """The drive's target (counts): its position plus the error that it reports; raises DialogueFailed."""
    answer = yield from answered(joint, config, ask(_can_id(config), 6, protocol.READ_ERROR), "angle error")
    error = unpacked(answer.data, protocol.ERROR_STEPS)
    measured = yield from _position(joint, config)
    return measured + round(error * COUNTS_PER_REVOLUTION / protocol.ERROR_STEPS_PER_REVOLUTION)
