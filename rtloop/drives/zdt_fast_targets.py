"""Test of how a ZDT drive interprets `FC`, and its set-up: part of bring-up and of referencing if the arm file asks
for FC.

`F1` sets speed, ramp and mode once; `FC` then sends targets alone. Every known user of FC sends relative amounts, even
one that set the mode of absolute targets. So it is not taken for granted that a drive obeys `F1` with mode 01, but
tested. A drive that took absolute targets for relative ones would add its whole count in every cycle.

The test is harmless with either interpretation. The drive stands at target p, and q lies two pulses beside it, away
from zero. At 1 rpm the drive is told to go to q, twice, asked for its target, and stopped, all in one cycle. So it can
move for about a millisecond, a hundredth of a degree of the motor, even if a process dies meanwhile. If targets are
absolute, its target is now q; if they are relative, it is p + 2q, which differs from q by two pulses or more wherever
the drive stands. A drive that reports q is then told to go to p, still at 1 rpm, and must not move. If the register
only repeated the command and not its effect, the motor would turn by a degree in the fifth of a second for which it is
watched, and the drive would be stopped.
"""

import math

from config.derived import silence_acc_byte
from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION, ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_ask import Ask, ZdtDialogue
from rtloop.drives.zdt_protocol import Version
from rtloop.drives.zdt_talk import Answered
from rtloop.service.conversation import TRIES, DialogueFailed

PULSES_BESIDE = 2
SLOWEST_RPM = 1
ALMOST_PULSES = 1.0
"""Targets or positions that differ by less than this are the same."""
WATCHED_S = 0.2
"""Least time for which positions are read before the last one counts: at 1 rpm a pulse takes 19 ms."""


def highest_rpm(arm: ArmConfig, joint: JointConfig) -> int:
    """Speed limit for `F1` (motor rpm): the highest speed that may be commanded of the joint, rounded up."""
    return min(math.ceil(arm.limits.velocity_margin * joint.motor_rpm), protocol.HIGHEST_RPM)


def beside(pulses: int) -> int:
    """The target q of the test for a drive that stands at `pulses`: further from zero."""
    return pulses + (PULSES_BESIDE if pulses >= 0 else -PULSES_BESIDE)


def prepare(arm: ArmConfig, joint: int, drive: ZdtDrive, version: Version) -> ZdtDialogue:
    """Check that the drive takes `FC` for an absolute target, then set its speed and ramp; raises DialogueFailed."""
    config = arm.joints[joint]
    if version.firmware < protocol.FAST_FIRMWARE:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has firmware {version}, but bus.position_command: FC needs 2.0.0 or newer: "
            "set bus.position_command to FD.",
        )
    acc_byte = silence_acc_byte(config, arm.limits)
    counts_per_pulse = ENCODER_COUNTS_PER_REVOLUTION / drive.command_steps_per_revolution
    slowly = protocol.fast_setup(SLOWEST_RPM, acc_byte)
    for _ in range(TRIES):
        yield Ask(protocol.STOP, (3,), answered=arm.bus.acknowledge)  # it may be moving
        target = yield from zdt_talk.counts_of(joint, config, protocol.ASK_TARGET)
        pulses = round(target / counts_per_pulse)
        there = protocol.fast_target(beside(pulses))
        answer = yield Ask(protocol.ASK_TARGET, (7,), before=(slowly, there, there), after=(protocol.STOP,))
        told = protocol.signed_of(answer, protocol.ASK_TARGET, 4)
        if told is not None and abs(told / counts_per_pulse - beside(pulses)) < ALMOST_PULSES:
            break
        if told is not None and abs(told / counts_per_pulse - pulses - 2 * beside(pulses)) < ALMOST_PULSES:
            yield Ask(protocol.STOP, (3,), answered=arm.bus.acknowledge)  # in case the first stop was lost
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} (firmware {version}) takes the targets of FC for amounts to go, although "
                "it was told that they are absolute: set bus.position_command to FD.",
            )
    else:
        yield Ask(protocol.STOP, (3,), answered=arm.bus.acknowledge)  # in case the last stop was lost
        raise _unclear(joint, config, version)
    stood = yield from zdt_talk.counts_of(joint, config, protocol.ASK_POSITION)
    looks = math.ceil(WATCHED_S * arm.control.rate_hz)  # each takes a cycle at least
    if not (yield from _stays(pulses, stood, ALMOST_PULSES * counts_per_pulse, looks)):
        yield Ask(protocol.STOP, (3,), answered=arm.bus.acknowledge)
        raise _unclear(joint, config, version)
    setup = protocol.fast_setup(highest_rpm(arm, config), acc_byte)
    yield Ask(setup, (3,), answered=arm.bus.acknowledge, before=(setup,))


def _stays(pulses: int, stood: int, within: float, looks: int) -> Answered[bool]:
    """Tell a drive to go to the target at which it stands (pulses); whether it stays there.

    `stood` is its position before, and `within` the largest distance from it (counts).
    """
    told: tuple[bytes, ...] = (protocol.fast_target(pulses),)
    position: int | None = None
    for _ in range(looks):
        answer = yield Ask(protocol.ASK_POSITION, (7,), before=told)
        position, told = protocol.signed_of(answer, protocol.ASK_POSITION, 4), ()
    return position is not None and abs(position - stood) < within


def _unclear(joint: int, config: JointConfig, version: Version) -> DialogueFailed:
    return DialogueFailed(
        joint,
        f"The drive of {config.name} (firmware {version}) does not go where FC tells it, so it cannot be led with it: "
        "set bus.position_command to FD.",
    )
