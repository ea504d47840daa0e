"""The few functions of the C library that the loop's threads call without the interpreter.

Addresses are passed as integers. Results follow the C library: `clock_nanosleep` returns the error itself; the
others return -1 and leave the error in errno, which is thread-local and must be read straight after the call.
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

CLOCK_REALTIME = 0
CLOCK_MONOTONIC = 1
CLOCK_BOOTTIME = 7
TIMER_ABSTIME = 1
POLLIN = 1
EINTR = 4
EAGAIN = 11
ENOBUFS = 105
MSG_DONTWAIT = 0x40


def _external(name: str, signature: Any) -> Any:
    """A C function by name; numba looks it up when it links."""
    return types.ExternalFunction(name, signature)


clock_nanosleep: Callable[[int, int, int, int], int] = _external(
    "clock_nanosleep", types.int32(types.int32, types.int32, types.int64, types.int64)
)
clock_gettime: Callable[[int, int], int] = _external("clock_gettime", types.int32(types.int32, types.int64))
read: Callable[[int, int, int], int] = _external("read", types.int64(types.int32, types.int64, types.int64))
write: Callable[[int, int, int], int] = _external("write", types.int64(types.int32, types.int64, types.int64))
poll: Callable[[int, int, int], int] = _external("poll", types.int32(types.int64, types.int64, types.int32))
sendmmsg: Callable[[int, int, int, int], int] = _external(
    "sendmmsg", types.int32(types.int32, types.int64, types.uint32, types.int32)
)
recvmmsg: Callable[[int, int, int, int, int], int] = _external(
    "recvmmsg", types.int32(types.int32, types.int64, types.uint32, types.int32, types.int64)
)
errno_location: Callable[[], int] = _external("__errno_location", types.int64())


@intrinsic
def _load_int32(typing_context: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = builder.inttoptr(arguments[0], ir.IntType(32).as_pointer())
        return builder.load(pointer)

    return types.int32(types.int64), generate


load_int32: Callable[[int], int] = cast(Any, _load_int32)
