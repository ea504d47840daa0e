"""The one way a function of ours is compiled: nopython, no GIL, cached, with explicit checks for NaN kept.

`fastmath` stays off, since it would let the compiler drop the finite checks that guard the drives, and the
error model is numpy's, so that a division by zero yields an infinity that those checks catch instead of an
exception that would need the interpreter.
"""

from collections.abc import Callable
from typing import Any, Literal, TypeVar, cast

import numba

from compilation import cache

F = TypeVar("F", bound=Callable[..., Any])

ERROR_MODEL: Literal["numpy"] = "numpy"

OPTIONS: dict[str, Any] = {"nogil": True, "cache": True, "error_model": ERROR_MODEL}
"""What numba is told about each function."""

# numba's own cache looks only at the file of the function itself: an edit in an imported helper would leave a stale
# caller behind.
setattr(numba.config, "CACHE_DIR", str(cache.folder()))  # noqa: B010 - read from the environment, unknown to mypy


def jit(function: F) -> F:
    """Compile a function for the cycle."""
    compiled: Any = numba.njit(**OPTIONS)(function)
    return cast(F, compiled)
