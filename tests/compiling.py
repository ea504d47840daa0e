"""`python tests/compiling.py`: compile the cycle's functions for tests, which call them one by one (`make env`).

They are kept in numba's cache. The control process has no use for that: it loads one object of them all.
"""

import subprocess
import sys
from pathlib import Path

from numba import cfunc

from rtloop.entries import ENTRIES
from shm.jit import ERROR_MODEL

ROOT = Path(__file__).resolve().parents[1]


def compile_functions() -> None:
    """Compile every function that the cycle calls, or take it from the cache."""
    for function, signature in ENTRIES:
        cfunc(signature, error_model=ERROR_MODEL)(function.py_func)


def make_object() -> None:
    """Make the object that the control process loads, unless it is there; in a process of its own (rtloop.lowered)."""
    subprocess.run([sys.executable, "-m", "rtloop.warm"], cwd=ROOT, check=True)


if __name__ == "__main__":
    compile_functions()
