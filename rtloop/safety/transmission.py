"""Which frames may leave in a cycle: targets, questions, and what probes a silent bus."""

from compilation.jit import jit
from config.frames import ADAPTER_FRAMES
from rtloop.memory.buses import bus_of
from rtloop.memory.link import PROBING, SILENT, SPEAKING, Bus
from rtloop.memory.state import Loop
from rtloop.memory.updates import owe_stop
from rtloop.safety.monitor import silent_ns
from rtloop.trajectory.limits import at_rest
from rtloop.wire import received
from shm.words import Mode

PROBES = 10
"""Drives are asked so often, each time one of them, between the last frame that came and the latched fault."""


@jit
def may_be_led(loop: Loop, joint: int) -> bool:
    """Whether a drive gets motion frames: not while its answer to them is uncertain, nor as long as it is out of reach.

    One that does not answer may have been switched off and on, and then counts from somewhere else; what is sent into
    a blocked wire besides arrives when the arm has long been stopped. Without frames a drive brakes by itself.
    """
    axis, bus = loop.axes[joint], bus_of(loop, joint)
    if bus.speech != SPEAKING or bus.transmit_inhibited == 1:
        return False
    if axis.reference.referenced == 0 or axis.checks.bad_statuses > 0 or axis.checks.suspect == 1:
        return False
    if loop.params.fast_targets == 1 and axis.sent.fast_ready == 0:
        return False
    return bool(silent_ns(loop, joint) <= loop.params.stale_brake_ns)


@jit
def report_is_asked_for(loop: Loop, joint: int) -> bool:
    """Whether a drive that should report, and does not, is asked in this cycle.

    One that has lost power reports nothing any more and would wait for the age ladder with a target that means another
    place; its answer tells at once. Every other cycle, so that asking takes less of the bus than the reports it stands
    in for. What it answers does not make it younger: a drive that has ceased to report ends as a silent one.
    """
    axis = loop.axes[joint]
    overdue = (
        axis.reply.unanswered_since_ns != 0
        and loop.timing.now_ns - axis.reply.unanswered_since_ns >= loop.params.report_overdue_ns
    )
    return bool(overdue and (loop.timing.cycle + joint) & 1 == 0)


@jit
def speech(bus: Bus) -> int:
    """What may leave in this cycle: all, if a frame of a drive has just come, or there is room for it.

    While no drive acknowledges, an adapter or the system keeps what it is given, and sends it when the drives have
    power again: they boot enabled, count from zero, and would go to targets that mean something else. So what is
    kept is bounded by what leaves room for each drive's stop command: the last word is a stop.
    """
    if received.closed(bus) != 0:
        return SILENT
    cycle_frames = 3 * bus.joint_count + 1
    if bus.unheard_frames == 0 or bus.unheard_frames + cycle_frames + PROBES + bus.joint_count <= ADAPTER_FRAMES:
        return SPEAKING
    return PROBING


@jit
def may_probe(loop: Loop, bus: Bus) -> bool:
    """Whether it is time to ask a silent bus again, and no stop command could lose its room by that."""
    params = loop.params
    if loop.timing.now_ns - bus.probed_ns < params.stale_fault_ns // PROBES:
        return False
    stops_to_come = 0
    for joint in range(params.joint_count):
        if loop.joints[joint].bus == bus.number:
            stops_to_come += loop.axes[joint].reference.referenced
    return bool(stops_to_come == 0 or bus.unheard_frames + stops_to_come < ADAPTER_FRAMES)


@jit
def drives_are_led(loop: Loop) -> bool:
    """Whether motion frames leave in this cycle.

    In a latched fault only until the arm stands: what moved it away afterwards must not be followed up, and the
    drives hold their last target by themselves.
    """
    if loop.motion.started == 0 or loop.motion.resync_ns != 0:
        return False
    if loop.mode == Mode.FAULT:
        return not at_rest(loop)
    standing = loop.mode == Mode.HOLDING or loop.mode == Mode.REFERENCING
    return standing or loop.mode == Mode.EXECUTING or loop.mode == Mode.STOPPING


@jit
def stop_displaced_drives(loop: Loop) -> None:
    """Once the arm stands in a latched fault nothing is made up for: a drive that is not where it was led stops there.

    It would go on towards its last target, or push against what holds it. Drives that were out of reach have come to
    rest elsewhere.
    """
    motion = loop.motion
    if loop.mode != Mode.FAULT or motion.rested == 1 or not at_rest(loop):
        return
    motion.rested = 1
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        if (
            motion.started == 1
            and bus_of(loop, joint).transmit_inhibited == 0
            and abs(axis.commanded.position_rad - axis.measured.position_rad) > 2.0 * loop.joints[joint].slack_rad
        ):
            owe_stop(axis)
