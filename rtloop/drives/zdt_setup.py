"""Bring-up and disabling of a ZDT drive.

Bring-up reads (init_mode 1, nothing moves): firmware, status, configuration block (the response mode is set in volatile
memory if it differs and the firmware's block is a supported one), position and target until the two agree. If the arm
file says so, the drive must send its position by itself, and its interpretation of FC is tested
(`rtloop.drives.zdt_fast_targets`). A drive that is moving, or has lost power, is stopped.
"""

from dataclasses import replace

import numpy as np

from config.budget import budget
from config.derived import braking_deceleration_rad_s2, silence_acc_byte
from config.drives.zdt import ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import zdt_fast_targets, zdt_homing, zdt_reports, zdt_talk
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.setup import CLEAR_OR_START, ERROR_AT_START, Found, Host, PowerHost, require_may_enable
from rtloop.drives.steps import let_go, unanswered
from rtloop.drives.zdt_ask import Ask, ZdtDialogue, addressed
from rtloop.drives.zdt_protocol import Version
from rtloop.drives.zdt_talk import Answered
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part
from rtloop.service.port import FAST_READY
from sentences.told import unreferenced_sentence
from shm.words import Unreferenced

SETTLE_PATIENCE_NS = 3_000_000_000
HOMING_TRIES = 10
SYNC_WITHIN_RAD = 0.02
"""Largest distance between a drive's target and its position for which the target is accepted."""

home, end_homing, place = zdt_homing.home, zdt_homing.end_homing, zdt_homing.place


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of a ZDT drive for the cycle; see `rtloop.drives.setup.Setup`."""
    row["acc_byte"] = silence_acc_byte(joint, arm.limits)
    row["silence_deceleration_rad_s2"] = braking_deceleration_rad_s2(joint, int(row["acc_byte"]))


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    drive = host.arm.joints[joint].drive
    assert isinstance(drive, ZdtDrive)
    return addressed(drive.address, _bring_up(host, joint, host.arm.joints[joint], drive))


def _bring_up(host: Host, joint: int, config: JointConfig, drive: ZdtDrive) -> Answered[Found]:
    answer = yield Ask(protocol.ASK_FIRMWARE, (4, 6))
    if answer is None:
        menu = f"its address and the bit rate ({host.arm.bus_of(config).bitrate} bit/s) in its menu"
        raise unanswered(joint, config, f"address {drive.address}", menu)
    version = protocol.version_of(answer)
    if version is None:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} (address {drive.address}) answers the question for its firmware with "
            f"{answer.hex(' ')}, which no ZDT drive with Emm firmware does: see what stands at that address.",
        )
    if not version.newer:
        host.tell(
            f"{config.name}: firmware {version} cannot say whether the drive has lost power; see that the joint "
            "stands where `rtarm status` says before it moves."
        )
    reason = Unreferenced.REFERENCED
    flags = yield from zdt_talk.status_of(joint, config)
    if flags & protocol.PROTECTED:
        flags = yield from _clear_protection(host, joint, config)
    if flags & protocol.POWER_LOST and not host.port.power_loss_known(joint):
        yield _stop(host)  # it may have received old targets since its power came back
        reason = Unreferenced.POWER_LOST
    homing = yield from _end_homing(host, joint, config)
    if reason == Unreferenced.REFERENCED and homing:
        reason = Unreferenced.NOT_HOMED
        host.tell(unreferenced_sentence(reason, config.name))
    yield from _settle_configuration(host, joint, config, drive, version)
    yield from _settle_reports(host, joint, config, version)
    if not flags & protocol.ENABLED:
        require_may_enable(host, joint)
        for _ in range(TRIES):
            # the drive may pull its shaft to its target from before it was disabled
            yield Ask(protocol.STOP, (3,), answered=host.arm.bus.acknowledge, before=(protocol.ENABLE,))
            flags = yield from zdt_talk.status_of(joint, config)
            if flags & protocol.ENABLED:
                break
        else:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} stays disabled after being enabled: look at its display for a fault "
                "and at the En setting in its menu.",
            )
    if host.arm.bus.fast_targets:
        yield from zdt_fast_targets.prepare(host.arm, joint, drive, version)
        host.post(FAST_READY, joint=joint)
    was_marked = host.marks[joint] is not None
    if not was_marked and not host.was_silent[joint] and host.marks.takes(joint):
        host.marks[joint] = yield from zdt_talk.mark(host.now_ns)
    found = yield from _standing(host, joint, config, reason)
    # The last question, so that it covers everything that was read before.
    had_power = yield from _decided_power(host, joint, config)
    if had_power is False:
        return found._replace(reason=Unreferenced.POWER_LOST)
    return found._replace(kept_power=was_marked and had_power is True)  # a new mark covers the time since it was given


def _decided_power(host: Host, joint: int, config: JointConfig) -> Answered[bool | None]:
    """Whether the drive has had power since it got its mark; None if it has no mark to show that.

    As `_had_power`, for a drive that answers: if it has a mark that cannot be read, it counts as having lost power. The
    operator is told if the mark decides against the drive.
    """
    flagged, marked = yield from _power_evidence(host, joint)
    mark = host.marks.known(joint)
    if mark is not None and not flagged and marked is None:
        yield from zdt_talk.status_of(joint, config)  # raises if the drive has no power now
        flagged, marked = yield from _power_evidence(host, joint)  # it was silent for a moment only
    if flagged:
        return False
    if mark is not None and marked is None:
        host.tell(
            f"{config.name}: its drive, which had a mark, does not tell its homing parameters (22), or tells others "
            "whenever it is asked, so nothing proves that it had power: it was exchanged, got other firmware, or the "
            "line garbles what it says."
        )
        return False
    if marked is False:
        host.tell(
            f"{config.name}: the mark of its drive, a homing time-out of {mark} ms, is gone: it lost power, or "
            "something else has set it, such as another user, computer, container or program."
        )
    return marked


def kept_power(host: PowerHost, joint: int) -> Part[bool]:
    """See `rtloop.drives.setup.PowerProof.kept_power`."""
    return addressed(host.arm.joints[joint].drive.number, _kept_power(host, joint))


def _kept_power(host: PowerHost, joint: int) -> Answered[bool]:
    return host.marks[joint] is not None and (yield from _had_power(host, joint)) is True


def _had_power(host: PowerHost, joint: int) -> Answered[bool | None]:
    """Whether the drive has had power since it got its mark; None if that cannot be found out."""
    flagged, marked = yield from _power_evidence(host, joint)
    return False if flagged else marked


def _power_evidence(host: PowerHost, joint: int) -> Answered[tuple[bool | None, bool | None]]:
    """Whether the drive's flag reports a loss of power (if the flag means something), and whether its mark is there.

    None where the drive does not answer; the mark of a drive whose flag reports a loss is not read.
    """
    if not host.port.power_loss_known(joint):
        for _ in range(zdt_talk.AGREEING):
            flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
            if flags is None:
                return None, None
            if not flags & protocol.POWER_LOST:
                break
        else:
            return True, None
    return False, (yield from zdt_talk.has_mark(host.marks.known(joint)))


def _clear_protection(host: Host, joint: int, config: JointConfig) -> Answered[int]:
    """Clear a tripped protection if the operator asked for that; the flags of ASK_STATUS after that.

    Raises DialogueFailed.
    """
    cause, remedy = protocol.trip_cause((yield from zdt_talk.read_flags(protocol.ASK_HOMING_STATUS)) or 0)
    if not host.clears_protection:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has tripped its protection ({cause}) and holds nothing: {remedy}, "
            f"{ERROR_AT_START}.",
        )
    yield Ask(protocol.CLEAR_PROTECTION, (3,))
    flags = yield from zdt_talk.status_of(joint, config)
    if flags & protocol.PROTECTED:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} stays in protection after it was cleared, because what tripped it "
            f"({cause}) is still there: {remedy}, then `rtarm clear-fault`.",
        )
    return flags


def _end_homing(host: Host, joint: int, config: JointConfig) -> Answered[bool]:
    """End a homing run that an earlier control process has left behind; whether there was one."""
    end: tuple[bytes, ...] = ()
    for looks in range(HOMING_TRIES):
        flags = yield from zdt_talk.read_flags(protocol.ASK_HOMING_STATUS, before=end)
        if flags is None or not flags & protocol.HOMING:
            return looks > 0
        if looks > 0:  # one answer alone may be garbled
            end = (protocol.END_HOMING, protocol.STOP)
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} is amid a homing run and does not end it: use the switch in the power line, "
        "then `rtarm clear-fault`.",
    )


def _stop(host: Host) -> Ask:
    return Ask(protocol.STOP, (3,), answered=host.arm.bus.acknowledge)


def _settle_configuration(
    host: Host, joint: int, config: JointConfig, drive: ZdtDrive, version: Version
) -> ZdtDialogue:
    """Check the settings that would make motion wrong, and set the response mode in volatile memory."""
    wanted = protocol.RESPONSE_RECEIVE if host.arm.bus.acknowledge else protocol.RESPONSE_NONE
    block = yield from zdt_talk.read_block()
    if block is None or not version.known:
        if not host.arm.bus.acknowledge:
            _require_budget_with_acknowledgements(host, joint, config, version)
        return
    if block.checksum != 0:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} uses checksum mode {block.checksum}, only 0 (the constant 6B) is spoken "
            "here: set Checksum to 0x6B in its menu.",
        )
    if block.microsteps != drive.microsteps:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} is set to {block.microsteps} microsteps, the arm file says "
            f"{drive.microsteps}: positions would be wrong by that factor; change one of the two.",
        )
    if block.response == wanted:
        return
    block = yield from zdt_talk.surely(zdt_talk.read_block)
    if block is None:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} tells its configuration in another way whenever it is asked, so its "
            "acknowledgements are not set, for which all of it is written back: check the adapter, its cable and "
            f"the CAN wires, {CLEAR_OR_START}.",
        )
    yield Ask(protocol.write_block(replace(block, response=wanted), store=False), (3,))
    for _ in range(TRIES):  # an answer from before the change may still come
        after = yield from zdt_talk.read_block()
        if after is not None and after.response == wanted:
            break
    else:
        _require_budget_with_acknowledgements(host, joint, config, version)
        host.tell(f"{config.name}: its drive keeps its acknowledgements on although told otherwise.")
        return
    name = "on" if wanted else "off"
    host.tell(f"{config.name}: acknowledgements turned {name} in the drive's volatile memory.")


def _settle_reports(host: Host, joint: int, config: JointConfig, version: Version) -> ZdtDialogue:
    """Turn reports of the position on or off in volatile memory, as the arm file says.

    A control process that was killed leaves its drives reporting; only a drive that does report is told to stop.
    """
    if not host.arm.bus.reported:
        by_itself = host.port.unasked(joint) - host.unasked_before[joint] >= zdt_reports.REPORTS_TO_BELIEVE
        if by_itself and (yield from zdt_talk.set_reports(0)):
            host.tell(f"{config.name}: its drive sent its position by itself, which was ended.")
        return
    yield from zdt_reports.begin(host.arm, host.port, joint, version)


def _require_budget_with_acknowledgements(host: Host, joint: int, config: JointConfig, version: Version) -> None:
    part, _ = host.arm.on_every_bus(acknowledge=True).part_of(joint)
    found = budget(part)
    if not found.fits:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} (firmware {version}) keeps acknowledging commands, and with "
            f"acknowledgements the bus carries {found.highest_rate_hz:.0f} Hz, not "
            f"{host.arm.control.rate_hz:g} Hz: lower control.rate_hz, or turn its Response off in its menu.",
        )


def _standing(host: Host, joint: int, config: JointConfig, reason: Unreferenced) -> Answered[Found]:
    """The drive's position and its own target once they agree; after a timeout, the position serves as target too."""
    started_ns = host.now_ns
    stopped = False
    counts_per_rad = config.direction * config.encoder_counts_per_rad
    zero_rad = host.port.zero_rad(joint)
    while True:
        measured = yield from zdt_talk.counts_of(joint, config, protocol.ASK_POSITION)
        target = yield from zdt_talk.counts_of(joint, config, protocol.ASK_TARGET)
        measured_rad = measured / counts_per_rad - zero_rad
        target_rad = target / counts_per_rad - zero_rad
        if abs(target_rad - measured_rad) <= SYNC_WITHIN_RAD:
            break
        if not stopped:  # its target is not from this process
            stopped = True
            yield _stop(host)
            continue
        if host.now_ns - started_ns > SETTLE_PATIENCE_NS:
            if reason == Unreferenced.REFERENCED:
                reason = Unreferenced.TARGET_FAR
                host.tell(
                    f"{config.name} is not referenced: its drive stands {measured_rad - target_rad:+.3f} rad from "
                    "its own target and does not go there: find what holds it, then `rtarm reference` it if it "
                    "stands where `rtarm status` says, or home it."
                )
            target = measured
            break
    return Found(measured, target, reason)


def end_reports(arm: ArmConfig, joint: int) -> Dialogue:
    """See `rtloop.drives.setup.Reports.end_reports`."""
    yield from addressed(arm.joints[joint].drive.number, zdt_talk.set_reports(0))


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Disable the drive, and check that it is disabled; raises DialogueFailed."""
    config = arm.joints[joint]
    yield from let_go(joint, config, lambda: addressed(config.drive.number, _told_to_let_go(arm)))


def _told_to_let_go(arm: ArmConfig) -> Answered[str]:
    yield Ask(protocol.RELEASE, (3,), answered=arm.bus.acknowledge)
    flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
    return "" if flags is not None and not flags & protocol.ENABLED else "stays enabled"
