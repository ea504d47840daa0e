"""Atomic loads and stores on 64-bit words at an address, for jitted code only.

Pairing: a `store_release` publishes everything written before it to the `load_acquire` that sees its value
(ring heads and tails, the service rings). The seqlock uses `load_relaxed`/`store_relaxed` for its data and
explicit fences: release after the odd count, so that no data word is written before it; acquire before the
second look, so that no data word is read after it (Boehm, "Can seqlocks get along with programming language
memory models?", MSPC 2012). LLVM calls the relaxed order "monotonic".
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _loader(order: str) -> Any:
    @intrinsic
    def load(typing_context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
            return builder.load_atomic(pointer, order, 8)

        return types.int64(types.int64), generate

    return load


def _storer(order: str) -> Any:
    @intrinsic
    def store(typing_context: Any, address: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
            builder.store_atomic(arguments[1], pointer, order, 8)
            return context.get_dummy_value()

        return types.void(types.int64, types.int64), generate

    return store


def _fencer(order: str) -> Any:
    @intrinsic
    def fence(typing_context: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            builder.fence(order)
            return context.get_dummy_value()

        return types.void(), generate

    return fence


load_acquire: Callable[[int], int] = _loader("acquire")
load_relaxed: Callable[[int], int] = _loader("monotonic")
store_release: Callable[[int, int], None] = _storer("release")
store_relaxed: Callable[[int, int], None] = _storer("monotonic")
fence_acquire: Callable[[], None] = _fencer("acquire")
fence_release: Callable[[], None] = _fencer("release")
