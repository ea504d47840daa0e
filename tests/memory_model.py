"""A small explorer of memory orders: every outcome that a weak machine may give two straight-line threads.

The machine is weaker than any processor that rtarm runs on, and as weak as the language of LLVM's atomics without
values out of thin air:

- a thread may carry out its operations in any order that its fences, its acquire loads and release stores, its
  dependencies and one location at a time leave it; a load may go before the branch that decides whether it is wanted,
  a store may not;
- a store is a message that stays: a load may take any message of its location that is not older than what the thread
  is known to have seen, so stores reach different threads at different times. A release store or a release fence puts
  into a message what its thread has seen; an acquire load or an acquire fence takes that over.

One writer a location, as in everything that rtarm shares. Threads are tuples of operations; a guard that fails ends its
thread. All interleavings are looked at, equal states once.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

RELAXED, ACQUIRE, RELEASE = "relaxed", "acquire", "release"


@dataclass(frozen=True)
class Load:
    """Read a location into a register; unless `guard` holds for its value, the thread ends here."""

    location: str
    register: str
    order: str = RELAXED
    guard: Callable[[int], bool] | None = None


@dataclass(frozen=True)
class Store:
    """Write a value to a location."""

    location: str
    value: int
    order: str = RELAXED


@dataclass(frozen=True)
class Fence:
    order: str


Operation = Load | Store | Fence
Registers = dict[str, int]
Judge = Callable[[tuple[Registers, ...]], bool]
"""Whether what the threads have read is allowed; asked whenever all of them have ended."""


def may_pass(later: Operation, earlier: Operation) -> bool:
    """Whether an operation may be carried out while an earlier one of its thread is not yet."""
    if isinstance(earlier, Fence):
        if earlier.order == ACQUIRE:
            return False
        return isinstance(later, Load) or (isinstance(later, Fence) and later.order == ACQUIRE)
    if isinstance(later, Fence):
        return later.order == ACQUIRE and isinstance(earlier, Store)
    if later.location == earlier.location:
        return False
    if isinstance(earlier, Load) and (earlier.order == ACQUIRE or (earlier.guard and isinstance(later, Store))):
        return False
    return not (isinstance(later, Store) and later.order == RELEASE)


View = tuple[int, ...]


def _joined(one: View, other: View) -> View:
    return tuple(max(pair) for pair in zip(one, other, strict=True))


@dataclass(frozen=True)
class _Thread:
    done: int
    """Bit i: operation i is carried out."""
    ended: int
    """Operations from this one on are never carried out."""
    registers: tuple[tuple[str, int], ...]
    seen: View
    to_acquire: View
    """What an acquire fence would add."""
    released: View
    """What a relaxed store passes on: all that was seen at the last release fence."""


_Memory = tuple[tuple[tuple[int, View], ...], ...]
"""For each location its messages, oldest first: value, and what whoever acquires it has then seen."""


class Explorer:
    """All outcomes of some threads on one memory, which is all zeros at first."""

    def __init__(self, *threads: tuple[Operation, ...]) -> None:
        self.threads = threads
        names = sorted({op.location for thread in threads for op in thread if not isinstance(op, Fence)})
        self._at = {name: index for index, name in enumerate(names)}
        self.states = 0

    def violation(self, allowed: Judge) -> tuple[Registers, ...] | None:
        """Registers of some outcome that is not allowed, or None when there is none."""
        nothing = (0,) * len(self._at)
        start = (
            tuple(_Thread(0, len(thread), (), nothing, nothing, nothing) for thread in self.threads),
            (((0, nothing),),) * len(self._at),
        )
        known, waiting = {start}, [start]
        while waiting:
            threads, memory = waiting.pop()
            self.states += 1
            stuck = True
            for after in self._steps(threads, memory):
                stuck = False
                if after not in known:
                    known.add(after)
                    waiting.append(after)
            if stuck:
                outcome = tuple(dict(thread.registers) for thread in threads)
                if not allowed(outcome):
                    return outcome
        return None

    def _steps(self, threads: tuple[_Thread, ...], memory: _Memory) -> Iterator[tuple[Any, _Memory]]:
        for number, thread in enumerate(threads):
            program = self.threads[number]
            pending = [i for i in range(thread.ended) if not thread.done >> i & 1]
            for place, index in enumerate(pending):
                if all(may_pass(program[index], program[before]) for before in pending[:place]):
                    for after, changed in self._carried_out(thread, index, program, memory):
                        yield (*threads[:number], after, *threads[number + 1 :]), changed

    def _carried_out(
        self, thread: _Thread, index: int, program: tuple[Operation, ...], memory: _Memory
    ) -> Iterator[tuple[_Thread, _Memory]]:
        operation = program[index]
        done = thread.done | 1 << index
        seen, to_acquire, released = thread.seen, thread.to_acquire, thread.released
        if isinstance(operation, Fence):
            if operation.order == ACQUIRE:
                seen = _joined(seen, to_acquire)
            else:
                released = seen
            yield _Thread(done, thread.ended, thread.registers, seen, to_acquire, released), memory
            return
        at = self._at[operation.location]
        if isinstance(operation, Store):
            seen = _with(seen, at, len(memory[at]))
            passed_on = seen if operation.order == RELEASE else _with(released, at, len(memory[at]))
            messages = (*memory[at], (operation.value, passed_on))
            changed = (*memory[:at], messages, *memory[at + 1 :])
            yield _Thread(done, thread.ended, thread.registers, seen, _joined(to_acquire, seen), released), changed
            return
        for stamp in range(thread.seen[at], len(memory[at])):
            value, brings = memory[at][stamp]
            here = _with(seen, at, stamp)
            later = _joined(_joined(to_acquire, here), brings)
            if operation.order == ACQUIRE:
                here = _joined(here, brings)
            ended, registers = thread.ended, dict(thread.registers)
            registers[operation.register] = value
            if operation.guard is not None and not operation.guard(value):
                ended = min(ended, index + 1)
                wanted = {op.register for op in program[: index + 1] if isinstance(op, Load)}
                registers = {name: read for name, read in registers.items() if name in wanted}
            yield _Thread(done, ended, tuple(sorted(registers.items())), here, later, released), memory


def _with(view: View, at: int, stamp: int) -> View:
    return (*view[:at], max(view[at], stamp), *view[at + 1 :])
