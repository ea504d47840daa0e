"""Bring-up, homing and release of an MKS SERVO42D/57D; what its frames are is said in `rtloop.drives.mks`.

What it is asked (nothing moves): its position, whether it moves, its work mode, microsteps and acknowledgements,
whether it has stalled and whether that lets go of its shaft, whether it is enabled, and how far it stands from its own
target. A drive that is on its way somewhere is stopped first. What must be different is told to it: the work mode
SR_vFOC (`82`), without which it heeds no motion commands, and whether it acknowledges (`8C`); a drive keeps both.
Firmware before V1.0.6 cannot be asked for settings (`00`), so they are told to it each time.

Its count begins where it was switched on, and nothing tells that it was.
"""

from collections.abc import Callable

import numpy as np

from config.budget import budget
from config.derived import braking_deceleration_rad_s2, silence_acc_byte
from config.drives.mks import COUNTS_PER_REVOLUTION, MksDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives.asking import AskFrames
from rtloop.drives.setup import ERROR_AT_START, Found, Host, ReferencingHost
from rtloop.drives.steps import answered, let_go, unanswered
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part
from rtloop.service.port import HOLDS_STALLED, Frame
from sentences.told import unreferenced_sentence
from shm.words import Unreferenced

READ_PARAMETER = 0x00
READ_POSITION, READ_ERROR = 0x31, 0x39
READ_ENABLED, READ_HOMED, CLEAR_PROTECTION, READ_STALLED = 0x3A, 0x3B, 0x3D, 0x3E
WORK_MODE, MICROSTEPS, PROTECT, ANSWERS, HOME, ERROR_GUARD = 0x82, 0x84, 0x88, 0x8C, 0x91, 0x9D
READ_STATE, ENABLE, MOVE, EMERGENCY_STOP = 0xF1, 0xF3, 0xF5, 0xF7

STOP_AT_ONCE = bytes((MOVE, 0, 0, 0, 0, 0, 0))
"""No speed, and no ramp to it: stand still in position mode, as the manual says it (V1.0.6, 6.8)."""

REFUSED, BEGUN, STOPPED_AT_LIMIT = 0, 1, 3
"""Results of a command."""
STANDS, HOMING, CALIBRATING = 1, 5, 6
"""Answers to READ_STATE; those between tell that it moves."""
HOMING_FAILED = 2
SR_VFOC = 5
UNKNOWN = b"\xff\xff"
"""What a drive says of a setting that it does not have."""
HIGHEST_RPM = 3000
"""In SR_vFOC."""
TRUE_SPEED_MICROSTEPS = (16, 32, 64)
"""With which the speed of a command is in rpm; others make it another one (manual V1.0.6, 6.1)."""
ERROR_STEPS_PER_REVOLUTION = 51_200

AGREEING = 2
"""Answers in a row that say the same: one alone may be a moment's."""
SYNC_WITHIN_RAD = 0.02
"""A drive whose target lies this near to its position is taken at its word."""
HALT_PATIENCE_S = 4.0
"""At least, from 3000 rpm to rest with a ramp of 750 rpm/s; then it is stopped at once."""
SETTLE_PATIENCE_NS = 3_000_000_000
BEGIN_NS = 1_000_000_000
"""Within which a homing run has begun."""
LATE_S = 1.0
BOOT_NS = 100_000_000
"""A drive that is switched off and on is silent for longer (unproven)."""
BOOT_PERIODS = 4
"""At low rates an answer takes that long anyhow."""


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """What the cycle needs of an MKS drive; see `rtloop.drives.setup.Setup`."""
    row["acc_byte"] = silence_acc_byte(joint, arm.limits)
    row["silence_deceleration_rad_s2"] = braking_deceleration_rad_s2(joint, int(row["acc_byte"]))


def bring_up(host: Host, joint: int) -> Part[Found]:
    """What `rtloop.drives.setup.Setup` says; see the head of this file."""
    config = host.arm.joints[joint]
    can_id = _can_id(config)
    if (yield _ask(can_id, 8, READ_POSITION)) is None:
        menu = f"CanID and CanRate ({host.arm.bus.bitrate} bit/s) in its menu"
        raise unanswered(joint, config, f"CanID {can_id}", menu)
    was_homing = yield from _stand(host, joint)
    reason = Unreferenced.INCREMENTAL
    if was_homing:
        reason = Unreferenced.NOT_HOMED
        host.tell(unreferenced_sentence(reason, config.name))
    yield from _settle_mode(host, joint)
    yield from _settle_answers(host, joint)
    enabled = yield from _read(joint, config, READ_ENABLED, "status")
    if not (yield from _lets_go_stalled(config)):
        host.post(HOLDS_STALLED, joint=joint)
    yield from _clear_protection(host, joint)
    if not enabled or not (yield from _read(joint, config, READ_ENABLED, "status")):
        yield from _enable(host.arm, joint)
    return (yield from _standing(host, joint, reason))


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Let the drive go limp, and see that it has; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        enabled = yield _ask(_can_id(config), 3, READ_ENABLED, before=(bytes((ENABLE, 0)),))
        return "" if enabled is not None and enabled.data[1] == 0 else "stays enabled"

    yield from let_go(joint, config, told)


# --- its homing run


def home(host: ReferencingHost, joint: int) -> Part[float]:
    """What `rtloop.drives.setup.Homes` says: the drive runs as its homing parameters (menu Hm_…) say."""
    config = host.arm.joints[joint]
    can_id = _can_id(config)
    host.run_begins(joint)
    began = yield from _position(joint, config)
    yield from _begin_run(host, joint, config)
    stopped = yield from _see_it_end(host, joint, config, began)
    measured = yield from _unbroken(host, joint, _position(joint, config))
    result = yield _ask(can_id, (3, 4), READ_HOMED)
    tripped = yield from _tripped(joint, config)
    failed = result is not None and result.data[-2] == HOMING_FAILED
    if failed or tripped or abs(measured) > SYNC_WITHIN_RAD * config.encoder_counts_per_rad:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} counts {measured} after its homing run, not 0, or says that the run failed or "
            "that its protection has tripped, so it has not found its stop: see that it can reach it and that Hm_Mode, "
            f"Hm_Dir, Hm_Speed and Hm_Ma in its menu fit, then {host.again}.",
        )
    if not (yield from _read(joint, config, READ_ENABLED, "status")):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has let the joint go at the end of its homing run: set EndLimit in its menu "
            f"to Disable, then {host.again}.",
        )
    target = yield from _target(joint, config)
    host.require_place(joint, stopped)
    return target


def end_homing(host: ReferencingHost, joint: int) -> Dialogue:
    """What `rtloop.drives.setup.Homes` says."""
    config = host.arm.joints[joint]
    seen = 0
    for _ in range(TRIES + AGREEING):
        state = yield _ask(_can_id(config), 3, READ_STATE, before=(bytes((EMERGENCY_STOP,)),))
        seen = seen + 1 if state is not None and state.data[1] == STANDS else 0
        if seen >= AGREEING:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} does not say that it has ended its homing run: it may still move, use the switch "
        "in the power line if it does.",
    )


def _begin_run(host: ReferencingHost, joint: int, config: JointConfig) -> Part[None]:
    can_id, since_ns = _can_id(config), host.now_ns
    answer = yield _ask(can_id, 3, HOME, answered=False)  # whether it has begun is told by its state
    refused = answer is not None and answer.data[1] == REFUSED
    seen = 0
    while not refused and host.now_ns - since_ns < BEGIN_NS:
        state = yield from _unbroken(host, joint, _read(joint, config, READ_STATE, "state"))
        seen = seen + 1 if state == HOMING else 0
        if seen >= AGREEING:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} does not begin its homing run: look at its display for a fault, and at Hm_Mode, "
        f"Hm_Dir and Hm_Speed in its menu, then {host.again}.",
    )


def _see_it_end(host: ReferencingHost, joint: int, config: JointConfig, last: int) -> Part[int]:
    """Wait for the end of the run; the last count of before it, as the drive counted then."""
    began_ns, newest, ended = host.now_ns, last, 0
    while ended < AGREEING:
        state = yield from _unbroken(host, joint, _read(joint, config, READ_STATE, "homing state"))
        ended = ended + 1 if state != HOMING else 0
        if not ended:
            last = newest  # the drive has still been homing after it was read, so it had not set its count anew
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
    """A question amid a run, and that its answer did not take as long as switching the drive off and on.

    Such a drive counts from 0 where it stands, as one does that has found its stop.
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
    """See that it stands, and stop it if not; whether it was amid a homing run."""
    config = host.arm.joints[joint]
    can_id, began_ns = _can_id(config), host.now_ns
    halt = bytes((MOVE, 0, 0, silence_acc_byte(config, host.arm.limits), 0, 0, 0))
    halt_patience_ns = round(1e9 * max(HALT_PATIENCE_S, host.arm.patience.drives_s))
    before: tuple[bytes, ...] = ()
    standing, was_homing = 0, False
    while standing < AGREEING:
        answer = yield _ask(can_id, 3, READ_STATE, before=before)
        state = answer.data[1] if answer is not None else 0
        if state == CALIBRATING:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} is calibrating its encoder: wait until it has ended, then `rtarm "
                "clear-fault`, or `rtarm up` where it has ended.",
            )
        was_homing |= state == HOMING
        waited_ns = host.now_ns - began_ns
        if state in (STANDS, 0):  # 0: in a work mode in which it tells no state, and obeys nobody here
            standing, before = standing + 1, ()
        elif waited_ns > halt_patience_ns + SETTLE_PATIENCE_NS:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} moves and does not stop when it is told to: use the switch in the power "
                "line, then `rtarm clear-fault`.",
            )
        else:
            standing = 0
            before = (bytes((EMERGENCY_STOP,)) if state == HOMING or waited_ns > halt_patience_ns else halt,)
    return was_homing


def _settle_mode(host: Host, joint: int) -> Part[None]:
    """See that it heeds commands from the bus, and takes their speed for what it is."""
    config = host.arm.joints[joint]
    microsteps = yield from _parameter(config, MICROSTEPS, 3)
    if microsteps is not None and (microsteps[1] or 256) not in TRUE_SPEED_MICROSTEPS:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} is set to {microsteps[1] or 256} microsteps, with which its speed is not the "
            "one it is told: set MStep in its menu to 16, 32 or 64.",
        )
    mode = yield from _parameter(config, WORK_MODE, 3)
    if mode is not None and mode[1] == SR_VFOC:
        return
    if not (yield from _told(config, WORK_MODE, SR_VFOC)):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not take the work mode SR_vFOC, in which alone it heeds commands from "
            "the bus: set Mode in its menu.",
        )
    if mode is not None:
        host.tell(f"{config.name}: its drive was set to the work mode SR_vFOC, which it keeps.")


def _settle_answers(host: Host, joint: int) -> Part[None]:
    """Have commands acknowledged or not as the arm file says; never does it tell by itself that a motion has ended."""
    config = host.arm.joints[joint]
    wanted = int(host.arm.bus.acknowledge)
    found = yield from _parameter(config, ANSWERS, 4)
    if found is not None and found[1:3] == bytes((wanted, 0)):
        return
    if (yield from _told(config, ANSWERS, wanted, 0)):
        if found is not None:
            name = "on" if wanted else "off"
            host.tell(f"{config.name}: acknowledgements turned {name} in its drive, which keeps that.")
        return
    loud = host.arm.model_copy(update={"bus": host.arm.bus.model_copy(update={"acknowledge": True})})
    fits = budget(loud)
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
    yield _ask(_can_id(config), 3, CLEAR_PROTECTION)
    if (yield from _tripped(joint, config)):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} stays in protection after it was cleared, so what tripped it (a blocked "
            "joint, current) is still there: find it on the drive's display, then `rtarm clear-fault`.",
        )


def _tripped(joint: int, config: JointConfig) -> Part[bool]:
    """Whether its protection has tripped; the mark of a stall that let go of nothing is taken away (3D)."""
    if not (yield from _read(joint, config, READ_STALLED, "protection")):
        return False
    if (yield from _lets_go_stalled(config)):
        return True
    yield _ask(_can_id(config), 3, CLEAR_PROTECTION)
    return False


def _lets_go_stalled(config: JointConfig) -> Part[bool]:
    """Whether a stall makes the drive let go: `Protect` (88) is on, or its guard of the position's error (9D).

    What cannot be asked is taken for on.
    """
    can_id = _can_id(config)
    for code, length in ((PROTECT, 3), (ERROR_GUARD, 7)):
        answer = yield _parameter_question(can_id, code, (4, length))
        if answer is None or (answer.data[1:3] != UNKNOWN and answer.data[1]):
            return True
    return False


def _enable(arm: ArmConfig, joint: int) -> Part[None]:
    """Let it hold where it stands: the stop right behind it in case it would go to a target of before."""
    config = arm.joints[joint]
    for _ in range(TRIES):
        enabled = yield _ask(_can_id(config), 3, READ_ENABLED, before=(bytes((ENABLE, 1)), STOP_AT_ONCE))
        if enabled is not None and enabled.data[1] == 1:
            return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} stays disabled after being enabled: look at its display for a fault.",
    )


def _standing(host: Host, joint: int, reason: Unreferenced) -> Part[Found]:
    """Where the drive stands, and its own target once that is near."""
    config, started_ns, stopped = host.arm.joints[joint], host.now_ns, False
    within = SYNC_WITHIN_RAD * config.encoder_counts_per_rad
    while True:
        measured = yield from _position(joint, config)
        target = yield from _target(joint, config)
        if abs(target - measured) <= within:
            return Found(measured, target, reason)
        if not stopped:  # whatever keeps it from there, nobody here has sent it
            stopped = True
            yield _ask(_can_id(config), 3, READ_STATE, before=(STOP_AT_ONCE,))
        elif host.now_ns - started_ns > SETTLE_PATIENCE_NS:
            return Found(measured, measured, reason)


# --- what it is asked


def _can_id(config: JointConfig) -> int:
    assert isinstance(config.drive, MksDrive)
    return config.drive.can_id


def _frame(can_id: int, data: bytes) -> Frame:
    return Frame(can_id, data + bytes(((can_id + sum(data)) & 0xFF,)), kind=STANDARD)


def _is_answer(can_id: int, lengths: tuple[int, ...], code: int) -> Callable[[Frame], bool]:
    def is_answer(frame: Frame) -> bool:
        data = frame.data
        sound = len(data) in lengths and data[-1] == (can_id + sum(data[:-1])) & 0xFF
        return sound and frame.kind == STANDARD and data[0] == code

    return is_answer


def _ask(
    can_id: int, length: int | tuple[int, ...], *data: int, before: tuple[bytes, ...] = (), answered: bool = True
) -> AskFrames:
    """A command, and its answer of so many bytes; what leaves right before it is said as often, and not waited for.

    An adapter may echo the command, which is as long as its answer in one case (82), but never the same.
    """
    lengths = (length,) if isinstance(length, int) else length
    frames = tuple(_frame(can_id, told) for told in (*before, bytes(data)))
    is_answer = _is_answer(can_id, lengths, data[0])
    return AskFrames(frames, lambda frame: is_answer(frame) and frame.data != frames[-1].data, answered)


def _told(config: JointConfig, *data: int) -> Part[bool]:
    """Whether the drive takes a setting."""
    can_id = _can_id(config)
    for _ in range(TRIES):
        answer = yield _ask(can_id, 3, *data)
        if answer is None:
            return False
        if answer.data[1] == BEGUN:
            return True
    return False


def _parameter(config: JointConfig, code: int, length: int) -> Part[bytes | None]:
    """The answer to the question for a setting, of so many bytes; None where the drive cannot be asked for it."""
    answer = yield _parameter_question(_can_id(config), code, (3, 4))
    if answer is None or len(answer.data) != length or answer.data[1:3] == UNKNOWN:
        return None
    return bytes(answer.data)


def _parameter_question(can_id: int, code: int, lengths: tuple[int, ...]) -> AskFrames:
    """The question for a setting, answered with so many bytes, or with four of which two say that it is UNKNOWN."""
    return AskFrames((_frame(can_id, bytes((READ_PARAMETER, code))),), _is_answer(can_id, lengths, code))


def _read(joint: int, config: JointConfig, code: int, what: str) -> Part[int]:
    """The byte a question of one byte is answered with; raises DialogueFailed."""
    answer = yield from answered(joint, config, _ask(_can_id(config), 3, code), what)
    return int(answer.data[1])


def _position(joint: int, config: JointConfig) -> Part[int]:
    """Where the motor stands (counts); raises DialogueFailed."""
    answer = yield from answered(joint, config, _ask(_can_id(config), 8, READ_POSITION), "position")
    return int.from_bytes(answer.data[1:7], "big", signed=True)


def _target(joint: int, config: JointConfig) -> Part[int]:
    """Where the drive holds (counts): from where it stands by the error it tells; raises DialogueFailed."""
    answer = yield from answered(joint, config, _ask(_can_id(config), 6, READ_ERROR), "angle error")
    error = int.from_bytes(answer.data[1:5], "big", signed=True)
    measured = yield from _position(joint, config)
    return measured + round(error * COUNTS_PER_REVOLUTION / ERROR_STEPS_PER_REVOLUTION)
