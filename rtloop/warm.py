"""`python -m rtloop.warm`: compile the cycle ahead, so that no start has to wait for it.

The result is one object file in the cache folder of exactly these sources; older folders are removed. The control
process loads the object file, and never the compiler.
"""

import contextlib
import os
import shutil
import sys
import time
from collections.abc import Callable

import llvmlite.binding as llvm

from compilation import cache
from rtloop.process import compiled

KEPT_S = 24 * 3600.0
"""Compiled code of other sources is removed when it is older than this."""
CODE_OPTIMISATION = 3


def compile_object() -> bytes:
    """Compile `process.entries` and all it calls into one object file.

    Raises NotLoadable if the code calls more than `process.compiled` allows. Works only in a process that has not
    imported `process.entries`: see `rtloop.process.lowered`.
    """
    from numba.core.registry import cpu_target

    from rtloop.process.lowered import lower

    module = lower()
    triple, processor, features = cpu_target.target_context.codegen().magic_tuple()
    # The settings that numba uses for code that it loads at once: they assume nothing about how far other code lies.
    machine = llvm.Target.from_triple(triple).create_target_machine(
        cpu=processor,
        features=features,
        opt=CODE_OPTIMISATION,
        codemodel="jitdefault",
        jit=True,
        reloc="static" if triple.startswith("x86") else "default",
    )
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=CODE_OPTIMISATION))
    passes = builder.getModulePassManager()
    passes.add_refprune_pass()
    # This pass finds out which functions cannot raise; their code that would report it to the interpreter falls away.
    passes.add_ipsccp_pass()
    passes.add_simplify_cfg_pass()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)
    code: bytes = machine.emit_object(module)
    compiled.CompiledCycle(code)
    return code


def main(tell: Callable[[str], None] = print) -> int:
    """Compile, unless that was done for exactly these sources; `tell` gets the lines for people.

    Returns the exit code: 1 if the cache folder cannot be written.
    """
    with contextlib.suppress(FileNotFoundError, compiled.NotLoadable):
        compiled.load()
        return 0
    tell("compiling the control cycle, once for this version …")
    started = time.monotonic()
    try:
        compiled.check_place()
        compiled.store(compile_object())
    except OSError as problem:
        tell(
            f"{cache.folder()} cannot be written ({problem.strerror}): free some space there, or see who may write it."
        )
        return 1
    for old in cache.folder().parent.glob("compiled-*"):
        with contextlib.suppress(FileNotFoundError):  # another process tidies up too
            if old != cache.folder() and time.time() - old.stat().st_mtime > KEPT_S:
                shutil.rmtree(old, ignore_errors=True)
    tell(f"compiled in {time.monotonic() - started:.0f} s")
    return 0


if __name__ == "__main__":
    # numba is not imported yet: what is compiled must not depend on settings that the cache's key does not know.
    for setting in [name for name in os.environ if name.startswith("NUMBA_")]:
        del os.environ[setting]
    sys.exit(main())
