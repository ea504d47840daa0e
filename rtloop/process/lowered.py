"""All of `rtloop.process.entries` as one LLVM module, each function in it once and none optimised.

By default numba optimises each function together with all that it calls, and again in each of its callers. It also
makes machine code of it, wraps that for the interpreter, and keeps everything: twice the time, for results that are not
needed here. So this module uses private parts of numba (pyproject.toml bounds its version), and a process that imports
it cannot call what it compiles.
"""

import sys
from typing import Any

import llvmlite.binding as llvm
from numba import cfunc, types
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

from compilation import jit


class _Unoptimised(JITCodeLibrary):
    """The code that numba made of one function, left unoptimised."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


def lower() -> Any:
    """Make the LLVM module, in which the entries have their own names and all else is internal.

    Works once in a process: raises RuntimeError where `rtloop.process.entries` was imported before.
    """
    if "rtloop.process.entries" in sys.modules:
        raise RuntimeError("what was imported before is compiled the ordinary way: lower in a process of its own")
    codegen = cpu_target.target_context.codegen()
    codegen._library_class = _Unoptimised
    codegen.set_env = lambda *_: None
    record: Any = types.Record
    record.__repr__ = lambda of: of.name  # numba calls it often, and its own lists each field
    jit.OPTIONS |= {"cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    from rtloop.process.entries import ENTRIES

    entries = {}
    libraries: dict[Any, None] = {}
    for function, signature in ENTRIES:
        made: Any = cfunc(signature, error_model=jit.ERROR_MODEL)(function.py_func)
        entries[made.native_name] = function.__name__
        _collect(made._library, libraries)
    module = llvm.parse_assembly(str(codegen._create_empty_module("cycle")))
    for library in libraries:
        module.link_in(library._final_module)
    for native, name in entries.items():
        module.get_function(native).name = name
    for value in (*module.functions, *module.global_variables):
        if not value.is_declaration and value.name not in entries.values():
            value.linkage = "internal"
    module.verify()
    return module


def _collect(library: Any, found: dict[Any, None]) -> None:
    """Add a library and all it calls, the callees first."""
    if library not in found:
        for called in library._linking_libraries:
            _collect(called, found)
        found[library] = None
