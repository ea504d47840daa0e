"""What wire and machine did while no frame of a drive came on a bus: the facts behind the sentence of a silence.

They are for people. Nothing in the cycle is decided by them.
"""

from compilation.jit import jit
from rtloop.memory.link import Bus
from rtloop.memory.state import Loop
from rtloop.wire import received
from shm.layout import StateFile
from shm.words import BusState, Evidence

# numba adds up no members of an enumeration, so they are plain integers here.
_HEARD, _ADAPTER_ANSWERS, _ADAPTER_MUTE = int(Evidence.HEARD), int(Evidence.ADAPTER_ANSWERS), int(Evidence.ADAPTER_MUTE)
_NOT_TAKEN, _UNACKNOWLEDGED = int(Evidence.NOT_TAKEN), int(Evidence.UNACKNOWLEDGED)
_BUS_ERRORS, _BABBLE = int(Evidence.BUS_ERRORS), int(Evidence.BABBLE)
_CYCLE_LATE, _READER_LATE = int(Evidence.CYCLE_LATE), int(Evidence.READER_LATE)
_SIMULATED = int(Evidence.SIMULATED)


@jit
def follow(loop: Loop, shared: StateFile, bus: Bus) -> None:
    """Once a cycle, behind all that the bus brought: note each sign, and count anew from the last frame of a drive."""
    quiet, counted = bus.quiet, shared.buses[bus.number]
    if quiet.adapter_words != quiet.adapter_words_before:
        quiet.adapter_words_before = quiet.adapter_words
        quiet.adapter_ns = loop.timing.now_ns
    if quiet.heard_ns != quiet.heard_before_ns:
        quiet.heard_before_ns = quiet.heard_ns
        quiet.away_ns = 0
        quiet.bytes_unsent, quiet.frames_received = counted.bytes_unsent, counted.frames_received
        quiet.unacknowledged, quiet.error_frames = counted.unacknowledged, counted.error_frames


@jit
def evidence(loop: Loop, shared: StateFile, bus: Bus) -> int:
    """Bits of shm.words.Evidence since the last frame of a drive on this bus."""
    timing, params, quiet, counted = loop.timing, loop.params, bus.quiet, shared.buses[bus.number]
    found = 0
    if timing.now_ns - quiet.heard_ns <= params.stale_brake_ns:
        found |= _HEARD
    if quiet.adapter_ns != 0 and timing.now_ns - quiet.adapter_ns <= params.stale_brake_ns:
        found |= _ADAPTER_ANSWERS
    elif is_mute(loop, bus):
        found |= _ADAPTER_MUTE
    if counted.bytes_unsent > quiet.bytes_unsent:
        found |= _NOT_TAKEN
    if counted.unacknowledged > quiet.unacknowledged:
        found |= _UNACKNOWLEDGED
    elif counted.error_frames > quiet.error_frames or counted.bus_state != BusState.ACTIVE:
        found |= _BUS_ERRORS
    if (counted.frames_received - quiet.frames_received) * params.period_ns >= bus.joint_count * params.stale_fault_ns:
        found |= _BABBLE
    if quiet.away_ns >= params.stale_brake_ns:
        found |= _CYCLE_LATE
    if received.woke_ns(bus) != 0 and timing.now_ns - received.woke_ns(bus) > params.stale_fault_ns // 2:
        found |= _READER_LATE
    if bus.simulated == 1:
        found |= _SIMULATED
    return found


@jit
def is_mute(loop: Loop, bus: Bus) -> bool:
    """Whether an adapter that answered until the drives fell silent was asked since, and has not answered."""
    quiet, patience_ns = bus.quiet, loop.params.stale_brake_ns
    answered_till_then = quiet.adapter_ns != 0 and quiet.adapter_ns >= quiet.heard_ns - patience_ns
    return bool(answered_till_then and quiet.spoke_ns - quiet.adapter_ns > patience_ns)
