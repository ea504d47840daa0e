"""Latching a fault: the first one stands until it is cleared, and the arm brakes."""

from typing import Any

from rtloop.memory.events import record_event
from rtloop.memory.modes import change_mode
from rtloop.trajectory.phases import end_waiting, runs, stop_running, tell_why_it_stops
from shm.jit import jit
from shm.words import Event, Fault, Mode, Outcome

Loop = Any
Shared = Any


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
    loop: Loop, shared: Shared, fault: int, joint: int, value: float, limit: float, silent: int = 0, evidence: int = 0
) -> None:
    """Latch a fault, end every goal with it and let the arm brake.

    `silent` (bit n: joint n) and `evidence` (bits of shm.words.Evidence) are for its sentence, where drives are silent.
    """
    core = loop.core
    if core.fault != Fault.NONE:
        return
    core.fault = fault
    core.fault_joint = joint
    core.fault_value = value
    core.fault_limit = limit
    core.fault_ns = core.now_ns
    core.fault_silent = silent
    core.fault_evidence = evidence
    core.referencing_ends = 1
    record_event(loop, shared, Event.FAULT, joint, fault, value, limit, silent, evidence)
    change_mode(loop, shared, Mode.FAULT)
    if not path_is_trusted(fault):
        core.own_brake = 1
    core.epoch += 1
    end_waiting(loop, shared, Outcome.FAULT, joint, value, limit)
    stop_running(loop, Outcome.FAULT, joint, value, limit)
    if runs(loop):
        tell_why_it_stops(loop, shared)
