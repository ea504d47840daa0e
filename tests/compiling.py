"""`python tests/compiling.py`: compile the cycle's functions for tests, which call them one by one (`make env`).

They are kept in numba's cache. The control process has no use for that: it loads one object of them all.
"""

import os
import subprocess
import sys
from pathlib import Path

from numba import cfunc

from compilation.jit import ERROR_MODEL
from rtloop.process.entries import ENTRIES

ROOT = Path(__file__).resolve().parents[1]


def compile_functions() -> None:
    """Compile every function that the cycle calls, or take it from the cache."""
    for function, signature in ENTRIES:
        cfunc(signature, error_model=ERROR_MODEL)(function.py_func)


def make_object() -> None:
    """Make the object that the control process loads, unless it is there; in a process of its own (`lowered`)."""
    subprocess.run([sys.executable, "-m", "rtloop.warm"], cwd=ROOT, check=True)


PROVES_CHECKS = """
import numba
import numpy as np

@numba.njit
def beyond(values, index):
    return values[index]

try:
    beyond(np.zeros(3), 3)
except IndexError:
    print("checks bounds")
"""


def bounds_checked(program: str, caches: Path) -> subprocess.CompletedProcess[str]:
    """Run a program with numba's bounds checks compiled in; it says so first. What is compiled is kept in `caches`."""
    environment = {
        **os.environ,
        "NUMBA_BOUNDSCHECK": "1",
        "XDG_CACHE_HOME": str(caches),
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
    }
    command = [sys.executable, "-c", PROVES_CHECKS + program]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


if __name__ == "__main__":
    compile_functions()
