"""Latching a fault: the first one stands until it is cleared, and the arm brakes."""

from compilation.jit import jit
from rtloop.memory.events import record_event
from rtloop.memory.modes import change_mode
from rtloop.memory.state import Loop
from rtloop.trajectory.phases import raise_epoch, runs, stop_running, tell_why_it_stops
from shm.layout import StateFile
from shm.words import Event, Fault, Mode, Outcome


@jit
def _is_of_a_talk(fault: int) -> bool:
    return fault == Fault.BRING_UP or fault == Fault.RELEASE or fault == Fault.HOMING


@jit
def path_is_trusted(fault: int) -> bool:
    """Whether the arm may brake along its path after this fault; else each joint brakes by itself."""
    out_of_reach = fault == Fault.WIRE or fault == Fault.LINK_DOWN or fault == Fault.BUS_OFF
    return out_of_reach or fault == Fault.COMMAND_RING or _is_of_a_talk(fault)


@jit
def latch_fault(
    loop: Loop,
    shared: StateFile,
    fault: int,
    joint: int,
    value: float,
    limit: float,
    silent: int = 0,
    evidence: int = 0,
) -> None:
    """Latch a fault, end every goal with it and let the arm brake.

    `silent` (bit n: joint n) and `evidence` (bits of shm.words.Evidence) are for its sentence, where drives are silent.
    """
    if loop.fault.code != Fault.NONE:
        return
    loop.fault.code = fault
    loop.fault.joint = joint
    loop.fault.value = value
    loop.fault.limit = limit
    loop.fault.latched_ns = loop.timing.now_ns
    loop.fault.silent = silent
    loop.fault.evidence = evidence
    loop.dialogue.referencing_ends = 1
    record_event(loop, shared, Event.FAULT, joint, fault, value, limit, silent, evidence)
    change_mode(loop, shared, Mode.FAULT)
    if not path_is_trusted(fault):
        stop_each_joint(loop)
    raise_epoch(loop, shared, Outcome.FAULT, joint, value, limit)
    stop_running(loop, Outcome.FAULT, joint, value, limit)
    if runs(loop):
        tell_why_it_stops(loop, shared)


@jit
def stop_each_joint(loop: Loop) -> None:
    """Each joint brakes by itself from here on: the path cannot be trusted."""
    loop.motion.per_joint_stop = 1


@jit
def forget_fault(loop: Loop) -> None:
    """It is cleared."""
    fault = loop.fault
    fault.code = Fault.NONE
    fault.joint = -1
    fault.value = fault.limit = 0.0
    fault.silent = fault.evidence = 0
