"""The one way a function of ours is compiled: nopython, no GIL, cached, with explicit checks for NaN kept.

`fastmath` stays off, since it would let the compiler drop the finite checks that guard the drives, and the
error model is numpy's, so that a division by zero yields an infinity that those checks catch instead of an
exception that would need the interpreter.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite
import numba
import numpy

F = TypeVar("F", bound=Callable[..., Any])

JITTED_PACKAGES = ("shm", "motion", "rtloop")


def sources_key() -> str:
    """Hash of every source that jitted code may be made of, and of the compilers' versions.

    numba's own cache looks only at the file of the function itself: an edit in an imported helper would
    leave a stale caller behind.
    """
    digest = hashlib.sha256(
        repr((sys.version_info[:3], numba.__version__, llvmlite.__version__, numpy.__version__)).encode()
    )
    root = Path(__file__).resolve().parent.parent
    for package in JITTED_PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:20]


def use_cache() -> Path:
    """Point numba's disk cache at the directory of this very set of sources."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    directory = base / "rtarm" / f"compiled-{sources_key()}"
    setattr(numba.config, "CACHE_DIR", str(directory))  # noqa: B010 - read from the environment, unknown to mypy
    return directory


use_cache()


def jit(function: F) -> F:
    """Compile a function for the cycle."""
    compiled: Any = numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    return cast(F, compiled)
