"""Functions of the compiled cycle by the addresses of their records.

To hand a record of so many fields over costs Python 33 to 65 µs, ten cycles' worth; an address costs nothing.
"""

import numpy as np

from compilation.jit import jit
from rtloop import cycle
from rtloop.bus.measured import take_what_the_bus_brought
from rtloop.process.entries import LOOP, STATE_FILE, record_at
from rtloop.wire import outgoing, received


@jit
def step(loop_address: int, state_address: int, now_ns: int) -> None:
    """`cycle.step`."""
    cycle.step(record_at(loop_address, LOOP), record_at(state_address, STATE_FILE), now_ns)


@jit
def push(loop_address: int, time_ns: int, source: np.ndarray, count: int, bus: int = 0) -> None:
    """`received.push`, of one bus."""
    received.push(record_at(loop_address, LOOP).buses[bus], time_ns, source, count)


@jit
def take(loop_address: int, state_address: int) -> None:
    """`measured.take_what_the_bus_brought`."""
    take_what_the_bus_brought(record_at(loop_address, LOOP), record_at(state_address, STATE_FILE))


@jit
def begin(loop_address: int, state_address: int) -> None:
    """`outgoing.begin`."""
    loop = record_at(loop_address, LOOP)
    outgoing.begin(loop, record_at(state_address, STATE_FILE), loop.buses[0])


@jit
def put(loop_address: int, frame_id: int, kind: int, length: int, data: int, joined: int) -> bool:
    """`outgoing.put`."""
    return outgoing.put(record_at(loop_address, LOOP).buses[0], 0, frame_id, kind, length, data, joined)


@jit
def took(loop_address: int, state_address: int, count: int, bus: int = 0) -> None:
    """`outgoing.took`, of one bus."""
    loop = record_at(loop_address, LOOP)
    outgoing.took(loop, record_at(state_address, STATE_FILE), loop.buses[bus], count)
