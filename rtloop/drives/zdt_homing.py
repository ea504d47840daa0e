"""A ZDT drive's homing run, and the referencing of its joint at an angle that a person gives.

The drive controls the run itself, until it meets its stop, where it counts 0. Before the run it gets a mark (an odd
homing time-out, `rtloop.drives.power`), because a drive that is switched off and on meanwhile counts 0 too, anywhere.
"""

from __future__ import annotations

import math

from config.drives.zdt import ZdtDrive
from config.joint import JointConfig
from rtloop.drives import zdt_fast_targets, zdt_reports, zdt_talk
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.setup import ReferencingHost
from rtloop.drives.zdt_ask import Ask, ZdtDialogue, addressed
from rtloop.drives.zdt_talk import AGREEING, Answered
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part, silent_amid
from rtloop.service.port import FAST_READY, REFERENCING, SYNC_SETPOINT
from shm.words import Unreferenced

AT_STOP_RAD = 0.02
"""How far the shaft may settle from where the run ended, which is where the drive counts from."""
STANDS_TRIES = 8
LATE_S = 1.0


def home(host: ReferencingHost, joint: int) -> Part[float]:
    """See `rtloop.drives.setup.Homes.home` and the head of this file."""
    config = host.arm.joints[joint]
    return addressed(config.drive.number, _home(host, joint, config))


def end_homing(host: ReferencingHost, joint: int) -> Dialogue:
    """See `rtloop.drives.setup.Homes.end_homing`; the drive is set up for motion if the angle is still known."""
    config = host.arm.joints[joint]
    return addressed(config.drive.number, _end_homing(host, joint, config))


def place(host: ReferencingHost, joint: int, angle_rad: float) -> Dialogue:
    """See `rtloop.drives.setup.Places.place`; the drive is set up and marked anew, and its position read from it."""
    config = host.arm.joints[joint]
    return addressed(config.drive.number, _place(host, joint, config, angle_rad))


# --- a homing run


def _home(host: ReferencingHost, joint: int, config: JointConfig) -> Answered[float]:
    limit_s = host.arm.homing.timeout_s
    flags = yield from _sound(host, joint, config)
    yield from _lost_its_mark(host, joint)
    mark_ms = zdt_talk.homing_mark_ms(round(limit_s * 1e3), host.now_ns)
    host.marks[joint] = None  # the mark is overwritten next; if it stayed stored, it would seem lost with the power
    if not (yield from zdt_talk.set_homing_timeout(mark_ms)):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not take a homing time-out of {limit_s:g} s: set it in its menu, or "
            "lower homing.timeout_s.",
        )
    host.marks[joint] = str(mark_ms)
    began = yield from zdt_talk.counts_of(joint, config, protocol.ASK_POSITION)
    host.run_begins(joint)
    if not (yield from zdt_talk.begin_homing()):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not begin its homing run: look at its display for a fault and at its "
            "homing parameters.",
        )
    stopped = yield from _see_it_end(host, joint, config, began)
    yield from _require_zero(host, joint, config)
    host.require_place(joint, stopped)
    yield from _require_mark(host, joint, config, str(mark_ms))
    yield from _set_up(host, joint, config)
    if flags & protocol.POWER_LOST:
        yield from _clear_power_lost(joint, config)
    target = yield from _standing(host, joint, config)
    yield from _require_mark(host, joint, config, str(mark_ms))
    return target


def _see_it_end(host: ReferencingHost, joint: int, config: JointConfig, last: int) -> Answered[int]:
    """Wait for the end of the run; the last position read before it ended, in the drive's count from before the run."""
    began_ns, newest, limit_s = host.now_ns, last, host.arm.homing.timeout_s
    ended = failed = silent = 0
    while True:
        flags = yield from zdt_talk.read_flags(protocol.ASK_HOMING_STATUS)
        silent = 0 if flags is not None else silent + 1
        if silent >= AGREEING:  # each of them was asked several times
            raise DialogueFailed(joint, silent_amid(config, "homing state"))
        if flags is None:
            continue
        ended = 0 if flags & protocol.HOMING else ended + 1
        failed = failed + 1 if ended and flags & protocol.HOMING_FAILED else 0
        if failed >= AGREEING or host.now_ns - began_ns > (limit_s + LATE_S) * 1e9:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} has not found its homing stop within {limit_s:g} s, or was stopped: see "
                "that it can reach the stop and that direction, speed and collision current in its menu fit, then "
                f"{host.again}.",
            )
        if ended >= AGREEING and not failed:
            return last
        if not ended:
            last = newest  # the drive was still homing after this reading, so it had not reset its count yet
            newest = yield from zdt_talk.counts_of(joint, config, protocol.ASK_POSITION)


def _require_zero(host: ReferencingHost, joint: int, config: JointConfig) -> ZdtDialogue:
    """Raise DialogueFailed if the drive does not count 0 after its run, has tripped its protection or let go."""
    flags = yield from zdt_talk.status_of(joint, config)
    measured = yield from zdt_talk.counts_of(joint, config, protocol.ASK_POSITION)
    if flags & protocol.PROTECTED or abs(measured) > AT_STOP_RAD * config.encoder_counts_per_rad:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} counts {measured} after its homing run, not 0, or has tripped its "
            "protection, so it has not found its stop: see that it can reach it and that its homing parameters "
            f"fit, then {host.again}.",
        )
    if not flags & protocol.ENABLED:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} is not enabled after its homing run, so it holds nothing: see to its supply "
            f"and its enable input, then {host.again}.",
        )


def _clear_power_lost(joint: int, config: JointConfig) -> ZdtDialogue:
    """Clear the drive's flag for lost power, once its count means an angle again; raises DialogueFailed."""
    for _ in range(TRIES):
        yield Ask(protocol.CLEAR_POWER_LOST, (3,))
        if not (yield from zdt_talk.status_of(joint, config)) & protocol.POWER_LOST:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} keeps its flag for lost power although it was told to clear it: switch it off "
        "and on, then home it again.",
    )


def _end_homing(host: ReferencingHost, joint: int, config: JointConfig) -> ZdtDialogue:
    seen = 0
    for _ in range(STANDS_TRIES):
        flags = yield from zdt_talk.read_flags(protocol.ASK_HOMING_STATUS, before=(protocol.END_HOMING, protocol.STOP))
        seen = seen + 1 if flags is not None and not flags & protocol.HOMING else 0
        if seen >= AGREEING:
            break
    else:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not say that it has ended its homing run: it may still move, use the "
            "switch in the power line if it does.",
        )
    if host.port.referenced(joint):
        yield from _set_up(host, joint, config)


# --- a person's word


def _place(host: ReferencingHost, joint: int, config: JointConfig, angle_rad: float) -> ZdtDialogue:
    host.post(REFERENCING, joint=joint)
    flags = yield from _sound(host, joint, config)
    yield from _set_up(host, joint, config)
    unmarked = yield from _lost_its_mark(host, joint)
    host.marks[joint] = None
    mark = (yield from zdt_talk.mark(host.now_ns)) if host.marks.takes(joint) else None
    host.marks[joint] = mark  # given before the count that it protects is read
    target = yield from _standing(host, joint, config)
    zero_rad = host.port.zero_rad(joint)
    flagged = flags & protocol.POWER_LOST and not host.port.power_loss_known(joint)
    counts_nowhere = flagged or unmarked
    if math.isnan(angle_rad) and counts_nowhere:
        host.tell(f"{config.name}: its drive has lost power, so what it counts is no angle: say where it stands.")
        host.count_from(joint, zero_rad, host.port.commanded_rad(joint), Unreferenced.POWER_LOST)
        return
    if math.isnan(angle_rad):
        if zero_rad == config.zero_rad:
            host.keep_lost(joint, None)  # the next process counts from the same zero
    else:
        host.keep_lost(joint, Unreferenced.NOT_HOMED)  # only this process knows the given angle
        measured = yield from zdt_talk.counts_of(joint, config, protocol.ASK_POSITION)
        zero_rad = config.direction * measured / config.encoder_counts_per_rad - angle_rad
    if mark is not None:
        yield from _require_mark(host, joint, config, mark)
    position_rad = config.direction * target / config.encoder_counts_per_rad - zero_rad
    host.count_from(joint, zero_rad, position_rad, flag_stays=bool(flags & protocol.POWER_LOST))


# --- both


def _sound(host: ReferencingHost, joint: int, config: JointConfig) -> Answered[int]:
    """Stop the drive, which may be moving, and check that it holds; its flags. Raises DialogueFailed."""
    yield Ask(protocol.STOP, (3,), answered=host.arm.bus.acknowledge)
    flags = yield from zdt_talk.status_of(joint, config)
    if flags & protocol.PROTECTED or not flags & protocol.ENABLED:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} is in protection or not enabled, so it cannot be referenced: remove the "
            "cause, then `rtarm clear-fault`, which enables it.",
        )
    return flags


def _lost_its_mark(host: ReferencingHost, joint: int) -> Answered[bool]:
    """Whether the drive's mark is gone; if so, the joint's angle is declared lost before another mark replaces it."""
    if (yield from zdt_talk.has_mark(host.marks.known(joint))) is not False:
        return False
    host.keep_lost(joint, Unreferenced.POWER_LOST)
    host.post(SYNC_SETPOINT, joint=joint, value=host.port.commanded_rad(joint), code=Unreferenced.POWER_LOST)
    return True


def _require_mark(host: ReferencingHost, joint: int, config: JointConfig, mark: str) -> ZdtDialogue:
    marked = yield from zdt_talk.has_mark(mark)
    if marked is None:
        raise DialogueFailed(joint, silent_amid(config, "homing parameters"))
    if not marked:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has lost power while it was referenced, so what it counts is no angle: "
            f"see to its supply, then {host.again}.",
        )


def _set_up(host: ReferencingHost, joint: int, config: JointConfig) -> ZdtDialogue:
    """Set up reports and `FC` in the drive again, and check them: they are lost with its power.

    While a drive's count means no angle, nothing notices that it is switched off and on.
    """
    bus, drive = host.arm.bus, config.drive
    if not (bus.reported or bus.fast_targets):
        return
    assert isinstance(drive, ZdtDrive)
    version = protocol.version_of((yield Ask(protocol.ASK_FIRMWARE, (4, 6))))
    if version is None:
        raise DialogueFailed(joint, silent_amid(config, "firmware"))
    if bus.reported:
        yield from zdt_reports.begin(host.arm, host.port, joint, version)
    if bus.fast_targets:
        yield from zdt_fast_targets.prepare(host.arm, joint, drive, version)
        host.post(FAST_READY, joint=joint)


def _standing(host: ReferencingHost, joint: int, config: JointConfig) -> Answered[int]:
    """The drive's own target (counts) once its position agrees, so that commanding the target is no motion."""
    for _ in range(TRIES):
        measured = yield from zdt_talk.counts_of(joint, config, protocol.ASK_POSITION)
        target = yield from zdt_talk.counts_of(joint, config, protocol.ASK_TARGET)
        if abs(measured - target) <= AT_STOP_RAD * config.encoder_counts_per_rad:
            return target
        yield Ask(protocol.STOP, (3,), answered=host.arm.bus.acknowledge)
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} stands {measured - target} counts from its own target and does not take where "
        f"it is for it: switch it off and on, then {host.again}.",
    )
