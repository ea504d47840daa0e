"""The cycle as ordinary Python, where `NUMBA_DISABLE_JIT=1` is set: `make test-uncompiled`, a debugger, coverage.

What compiled code does by an address alone (atomic words, records) is done by ctypes then, and the data of frames is
wrapped to 64 bits as it is there. Of what threads share this proves nothing: tests of the cycle have one. Imported
before all of ours.
"""

import ctypes
import os
from typing import Any

import numpy as np

IS_ON = os.environ.get("NUMBA_DISABLE_JIT") == "1"


def signed(word: int) -> int:
    """A word as 64 bits hold it: above 2⁶³ it is a negative number."""
    return (int(word) + (1 << 63)) % (1 << 64) - (1 << 63)


def _load(address: int) -> int:
    return ctypes.c_int64.from_address(int(address)).value


def _store(address: int, value: int) -> None:
    ctypes.c_int64.from_address(int(address)).value = int(value)


def _fence() -> None:
    pass


def _record_at(address: int, dtype: np.dtype[Any]) -> Any:
    memory = (ctypes.c_char * dtype.itemsize).from_address(int(address))
    return np.frombuffer(memory, np.dtype((np.record, dtype)))[0]


def _run_as_python() -> None:
    np.seterr(invalid="ignore", over="ignore")  # as compiled code does
    from shm import atomics, layout, recording

    for name in ("load_acquire", "load_relaxed"):
        setattr(atomics, name, _load)
    for name in ("store_release", "store_relaxed"):
        setattr(atomics, name, _store)
    for name in ("fence_acquire", "fence_release"):
        setattr(atomics, name, _fence)
    for of in (layout.StateFile, layout.CommandFile, layout.Snapshot, layout.Setpoint, layout.Begin, layout.Request):
        of.dtype = np.dtype((np.record, of.dtype))
    check: Any = recording.frame_check
    setattr(recording, "frame_check", lambda *words: check(*map(int, words)))  # noqa: B010

    from rtloop.process import entries
    from rtloop.service import rings
    from rtloop.wire import outgoing

    setattr(entries, "record_at", _record_at)  # noqa: B010
    put, hand_out = outgoing.put, rings.hand_out

    def put_signed(
        bus: Any, made_ms: int, frame_id: int, kind: int, length: int, data: int, joined: int, stops: int = -1
    ) -> bool:
        return put(bus, made_ms, frame_id, kind, length, signed(data), joined, stops)

    def hand_out_signed(loop: Any, joint: int, frame_id: int, kind: int, length: int, data: int, time_ns: int) -> None:
        hand_out(loop, joint, frame_id, kind, length, signed(data), time_ns)

    setattr(outgoing, "put", put_signed)  # noqa: B010
    setattr(rings, "hand_out", hand_out_signed)  # noqa: B010


if IS_ON:
    _run_as_python()
