"""What the atomics become on the processors of a Raspberry Pi or a Jetson, by the same compiler, made for them."""

import re
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
import numba
import pytest
from numba import int64

from compilation.jit import ERROR_MODEL
from shm import atomics, seqlock

TRIPLE, PROCESSOR = "aarch64-unknown-linux-gnu", "cortex-a72"
_ORDERED = re.compile(r"^\t(ldar|ldapr|stlr|dmb)\t(.*)$")
_PLAIN = re.compile(r"^\t(ldr|str|ldp|stp|ldur|stur)\t(x\d+.*)$")


def assembly(function: Callable[..., Any], arguments: int) -> list[str]:
    """The function's instructions for AArch64 that reach memory, fences included, in their order."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(TRIPLE).create_target_machine(cpu=PROCESSOR, opt=2)
    compiled = numba.njit(nogil=True, error_model=ERROR_MODEL)(getattr(function, "py_func", function))
    compiled.compile((int64,) * arguments)
    code = compiled.inspect_llvm(compiled.signatures[0])
    code = re.sub(r'target triple = ".*"', f'target triple = "{TRIPLE}"', code)
    code = re.sub(r'target datalayout = ".*"', f'target datalayout = "{machine.target_data}"', code)
    code = re.sub(r'"target-(cpu|features)"="[^"]*"', "", code)
    module = llvm.parse_assembly(code)
    module.verify()
    lines = machine.emit_assembly(module).splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("_ZN") and ":" in line)
    end = next(i for i in range(start, len(lines)) if lines[i].startswith(".Lfunc_end"))
    found = []
    for line in lines[start:end]:
        match = _ORDERED.match(line) or _PLAIN.match(line)
        if match and "[sp" not in line:
            found.append(f"dmb {match[2]}" if match[1] == "dmb" else match[1])
    return found


def load_acquire(address: int) -> int:
    return int(atomics.load_acquire(address))


def load_relaxed(address: int) -> int:
    return int(atomics.load_relaxed(address))


def store_release(address: int, value: int) -> None:
    atomics.store_release(address, value)


def store_relaxed(address: int, value: int) -> None:
    atomics.store_relaxed(address, value)


def fence_acquire(_: int) -> None:
    atomics.fence_acquire()


def fence_release(_: int) -> None:
    atomics.fence_release()


@pytest.mark.parametrize(
    ("function", "arguments", "instruction"),
    [
        (load_acquire, 1, "ldar"),
        (store_release, 2, "stlr"),
        (fence_acquire, 1, "dmb ishld"),
        (fence_release, 1, "dmb ish"),
        (load_relaxed, 1, "ldr"),
        (store_relaxed, 2, "str"),
    ],
)
def test_each_order_becomes_the_instruction_that_keeps_it(function: Any, arguments: int, instruction: str) -> None:
    found = assembly(function, arguments)
    assert found.count(instruction) >= 1
    if instruction in ("ldr", "str"):
        assert not any(name.startswith(("ld", "st", "dmb")) and name not in ("ldr", "str") for name in found)


def test_publishing_fences_the_data_in_on_both_sides() -> None:
    found = assembly(seqlock.publish, 5)
    first, last = (index for index, name in enumerate(found) if name == "dmb ish")
    assert "str" in found[:first] and "str" in found[first:last] and "str" in found[last:]
    assert found[last + 1 :].count("str") == 1  # the even count


def test_reading_fences_the_data_in_on_both_sides() -> None:
    found = assembly(seqlock.read, 4)
    fences = [index for index, name in enumerate(found) if name == "dmb ishld"]
    assert len(fences) >= 2
    assert "ldr" in found[: fences[0]] and "ldr" in found[fences[0] : fences[-1]] and "ldr" in found[fences[-1] :]
    assert "dmb ish" not in found
