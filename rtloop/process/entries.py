"""The functions of the compiled code that ordinary Python calls; they take and return addresses and numbers alone.

`rtloop.warm` compiles them into one object, which `rtloop.process.compiled` loads without the compiler.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

from numba import types
from numba.extending import intrinsic

from compilation.jit import jit
from rtloop.memory.state import Loop
from rtloop.process import run as threads
from shm.atomics import load_acquire, store_release
from shm.layout import StateFile

# compiled functions can look up no attribute of a class
LOOP, STATE_FILE = Loop.dtype, StateFile.dtype


@intrinsic
def _record_at(typing_context: Any, address: Any, dtype: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(dtype.dtype))

    return dtype.dtype(types.int64, dtype), generate


record_at: Callable[[int, Any], Any] = cast(Any, _record_at)


@jit
def run(loop_address: int, state_address: int) -> int:
    """The cycle's thread, see `rtloop.process.run.run`; returns 1 if it ended by an exception, else 0."""
    try:
        threads.run(record_at(loop_address, LOOP), record_at(state_address, STATE_FILE))
    except Exception:
        return 1
    return 0


@jit
def read_wire(loop_address: int, number: int) -> None:
    """The thread of a bus' reader, see `rtloop.process.run.read_wire`."""
    loop = record_at(loop_address, LOOP)
    threads.read_wire(loop, loop.buses[number])


@jit
def load_word(address: int) -> int:
    """A 64-bit word that another thread publishes."""
    # pairs with the threads' `store_release` of the same word (`rings.pass_on`, `received.close`, `run.take_over_wire`)
    return load_acquire(address)


@jit
def store_word(address: int, value: int) -> None:
    """Publish a 64-bit word to another thread."""
    # pairs with the threads' `load_acquire` of the word (`rings`, `received`, `run`); `params.reported` is read plainly
    store_release(address, value)


class Entry(NamedTuple):
    """A function and the types it is compiled for."""

    function: Any
    signature: Any


ENTRIES = (
    Entry(run, types.int64(types.int64, types.int64)),
    Entry(read_wire, types.void(types.int64, types.int64)),
    Entry(load_word, types.int64(types.int64)),
    Entry(store_word, types.void(types.int64, types.int64)),
)
