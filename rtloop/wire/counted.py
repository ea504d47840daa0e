"""What is counted of a bus: among its own counters, and among those of all buses of the arm."""

from compilation.jit import jit
from rtloop.memory.link import Bus
from shm.layout import StateFile


@jit
def count_wire_error(shared: StateFile, bus: Bus) -> None:
    """Count a refusal, or bytes that are no frame."""
    shared.counters.wire_errors += 1
    shared.buses[bus.number].wire_errors += 1


@jit
def count_sent(shared: StateFile, bus: Bus, frames: int, bits: int) -> None:
    """Count frames that are sent and their bits; negative numbers take back frames that are not sent after all."""
    shared.counters.frames_sent += frames
    shared.counters.bits_on_bus += bits
    counted = shared.buses[bus.number]
    counted.frames_sent += frames
    counted.bits_on_bus += bits


@jit
def count_received(shared: StateFile, bus: Bus, bits: int) -> None:
    """Count a frame that has come, and its bits."""
    shared.counters.frames_received += 1
    shared.counters.bits_on_bus += bits
    counted = shared.buses[bus.number]
    counted.frames_received += 1
    counted.bits_on_bus += bits


@jit
def count_unsent(shared: StateFile, bus: Bus, unsent: int) -> None:
    """Count bytes that the wire did not take."""
    shared.counters.bytes_unsent += unsent
    shared.buses[bus.number].bytes_unsent += unsent


@jit
def count_error_frame(shared: StateFile, bus: Bus, unacknowledged: bool) -> None:
    """Count an error that the controller has told of; `unacknowledged`: no drive acknowledged a frame."""
    counters, counted = shared.counters, shared.buses[bus.number]
    counters.error_frames += 1
    counted.error_frames += 1
    if unacknowledged:
        counters.unacknowledged += 1
        counted.unacknowledged += 1
