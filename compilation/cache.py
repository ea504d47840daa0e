"""Where compiled code is kept: a folder for these very sources, compilers and processor. Loads no compiler."""

import functools
import hashlib
import os
import sys
from importlib.metadata import version
from pathlib import Path

import llvmlite.binding as llvm

ROOT = Path(__file__).resolve().parent.parent
COMPILED_SOURCES = (
    "compilation/*.py",
    "config/*.py",
    "config/drives/*.py",
    "motion/**/*.py",
    "shm/**/*.py",
    "rtloop/**/*.py",
)
"""What compiled code may be made of: functions of its own, and the constants and leaf functions it takes over."""
COMPILERS = ("numba", "llvmlite", "numpy")


@functools.cache
def key() -> str:
    """Hash of everything that compiled code depends on; the same for every copy of the same sources."""
    versions = (sys.version_info[:3], [version(name) for name in COMPILERS])
    processor = (llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())
    digest = hashlib.sha256(repr((versions, processor)).encode())
    for pattern in COMPILED_SOURCES:
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:20]


def folder() -> Path:
    """The folder of these very sources; it may not be there yet."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "rtarm" / f"compiled-{key()}"
