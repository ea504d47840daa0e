"""The compiled cycle as the control process uses it: one object file, loaded without the compiler.

`rtloop.warm` makes the object. The only outside functions that it may call are the few of the C library named here, so
it can neither enter the interpreter nor allocate. An object that needs any other function does not load.
"""

import ctypes
import hashlib
import os
import struct
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from compilation import cache

CALLED = (
    "__errno_location",
    "clock_gettime",
    "clock_nanosleep",
    "memcpy",
    "memmove",
    "memset",
    "poll",
    "read",
    "recvmmsg",
    "sendmmsg",
    "write",
)
"""Functions of the C library that compiled code may call; LLVM turns loops into calls of the mem*."""
ROUNDING = ("ceil", "floor", "rint")
"""Functions of libm that LLVM calls where the processor has no instruction for them (x86-64 without SSE4.1)."""
_SECTION, _SHT_SYMTAB = struct.Struct("<IIQQQQIIQQ"), 2
_SYMBOL, _SHN_UNDEF = struct.Struct("<IBBHQQ"), 0
DIGEST_BYTES = hashlib.sha256().digest_size

Prototype = tuple[Any, ...]

PROTOTYPES: dict[str, Prototype] = {
    "run": (ctypes.c_int64, ctypes.c_int64, ctypes.c_int64),
    "read_wire": (None, ctypes.c_int64, ctypes.c_int64),
    "load_word": (ctypes.c_int64, ctypes.c_int64),
    "store_word": (None, ctypes.c_int64, ctypes.c_int64),
}
"""Result and arguments of the functions of `rtloop.process.entries`."""


class NotLoadable(Exception):
    """The object cannot be loaded and linked: damaged, or calling what it may not call."""


class CompiledCycle:
    """The functions of `rtloop.process.entries`, callable from ordinary Python; none holds the GIL."""

    def __init__(self, code: bytes) -> None:
        """Raises NotLoadable."""
        beyond = sorted(undefined_symbols(code) - {*CALLED, *ROUNDING})
        if beyond:
            raise NotLoadable(f"it calls {', '.join(beyond)}")
        builder = llvm.JITLibraryBuilder().add_object_img(code)
        for library, names in ((ctypes.CDLL(None), CALLED), (ctypes.CDLL("libm.so.6"), ROUNDING)):
            for name in names:
                builder.import_symbol(name, _address(getattr(library, name)))
        for name in PROTOTYPES:
            builder.export_symbol(name)
        llvm.initialize_native_target()
        before = _anonymous()
        try:
            self._jit = llvm.create_lljit_compiler(suppress_errors=True)
            self._linked = builder.link(self._jit, "cycle")
        except RuntimeError as problem:
            raise NotLoadable(str(problem)) from problem
        self.memory = sorted(_anonymous() - before)
        """Address and size (bytes) of each memory area that holds the code and its constants."""
        functions = {name: ctypes.CFUNCTYPE(*prototype)(self._linked[name]) for name, prototype in PROTOTYPES.items()}
        self.run, self.read_wire = functions["run"], functions["read_wire"]
        self.load_word, self.store_word = functions["load_word"], functions["store_word"]


def path() -> Path:
    """Path in the cache of the object that is compiled from exactly these sources, whether or not it exists yet."""
    return cache.folder() / "cycle.o"


def load() -> CompiledCycle:
    """Load the compiled cycle from the cache; raises FileNotFoundError if it is not compiled yet, and NotLoadable."""
    content = path().read_bytes()
    code = content[DIGEST_BYTES:]
    if hashlib.sha256(code).digest() != content[:DIGEST_BYTES]:
        raise NotLoadable(f"{path()} is damaged")
    return CompiledCycle(code)


def check_place() -> None:
    """Raise OSError if `store` would raise it, before a minute is spent on compiling what it is to store."""
    aside = _aside()
    try:
        aside.write_bytes(b"\0")
    finally:
        aside.unlink(missing_ok=True)


def store(code: bytes) -> None:
    """Put an object into the cache, whole or not at all."""
    aside = _aside()
    aside.write_bytes(hashlib.sha256(code).digest() + code)
    aside.replace(path())


def _aside() -> Path:
    """Path to which this process writes an object before it is whole; makes the folder if it is missing."""
    path().parent.mkdir(parents=True, exist_ok=True)
    return path().with_name(f"{path().name}.{os.getpid()}.new")


def undefined_symbols(code: bytes) -> set[str]:
    """The undefined symbols of an object file (64-bit ELF, little-endian); raises NotLoadable if it is none."""
    found = set()
    try:
        (sections_at,) = struct.unpack_from("<Q", code, 0x28)
        size, count = struct.unpack_from("<HH", code, 0x3A)
        sections = [_SECTION.unpack_from(code, sections_at + size * number) for number in range(count)]
        for _, kind, _, _, at, length, link, _, _, entry in sections:
            if kind != _SHT_SYMTAB:
                continue
            names_at = sections[link][4]
            for symbol_at in range(at, at + length, entry):
                name, _, _, section, _, _ = _SYMBOL.unpack_from(code, symbol_at)
                if section == _SHN_UNDEF and name != 0:
                    found.add(code[names_at + name : code.index(b"\0", names_at + name)].decode())
    except (struct.error, IndexError, ValueError) as problem:
        raise NotLoadable(f"it is no object file ({problem})") from problem
    return found


def _address(function: Any) -> int:
    return int(ctypes.cast(function, ctypes.c_void_p).value or 0)


def _anonymous() -> set[tuple[int, int]]:
    """Address and size (bytes) of all memory areas of this process that cannot be written and belong to no file."""
    found = set()
    for line in Path("/proc/self/maps").read_text(encoding="ascii", errors="replace").splitlines():
        area, permissions, _offset, _device, inode, *name = line.split(maxsplit=5)
        if permissions[1] == "-" and permissions != "---p" and inode == "0" and not name:
            start, end = (int(part, 16) for part in area.split("-"))
            found.add((start, end - start))
    return found
