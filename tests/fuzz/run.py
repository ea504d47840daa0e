"""The targets by name, and how a run of cases of one is judged and counted."""

import signal
import traceback
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzz.arena import MemoryArena, WireArena
from fuzz.messages import Messages
from fuzz.texts import Parameters, Texts
from fuzz.truth import Truth

HANG_S = 120
COMPILED = ("memory", "wire", "seeed", "at")
TARGETS: dict[str, Callable[[], Any]] = {
    "memory": MemoryArena,
    "wire": WireArena,
    "seeed": lambda: WireArena(interface="seeedstudio"),
    "at": lambda: WireArena(interface="ch340-at"),
    "truth": Truth,
    "goals": lambda: Messages("goals"),
    "streams": lambda: Messages("streams"),
    "bytes": lambda: Messages("bytes"),
    "yaml": lambda: Texts("yaml"),
    "overrides": lambda: Texts("overrides"),
    "parameters": Parameters,
}
CASES_A_MILLION = {
    **{
        "memory": 600_000,
        "wire": 150_000,
        "seeed": 100_000,
        "at": 50_000,
        "truth": 200,
        "goals": 15_000,
        "streams": 15_000,
        "bytes": 20_000,
    },
    **{"yaml": 4_800, "overrides": 5_000, "parameters": 40_000},
}
CHUNK = {"memory": 10_000, "wire": 5_000, "seeed": 5_000, "at": 5_000, "truth": 10, "yaml": 200, "overrides": 250}

_open: dict[str, Any] = {}


class Hang(Exception):
    """A case that did not come to its end."""


def _on_alarm(*_: object) -> None:
    raise Hang(f"no end within {HANG_S} s")


def target(name: str) -> Any:
    """The target of this process."""
    if name not in _open:
        _open[name] = TARGETS[name]()
    return _open[name]


def run_chunk(name: str, seed: int, first: int, count: int) -> tuple[str, int, list[tuple[int, str]]]:
    """Judge cases first … first + count - 1; how many were judged, and number and account of each that failed."""
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", ResourceWarning)
    signal.signal(signal.SIGALRM, _on_alarm)
    here, failed, judged = target(name), [], 0
    if name in COMPILED:
        while judged < count:
            done, account = here.run(seed, first + judged, count - judged)
            judged += done
            if account:
                failed.append((first + judged - 1, account))
        return name, judged, failed
    for case in range(first, first + count):
        signal.alarm(HANG_S)
        try:
            here.case(np.random.default_rng([seed, case]))
        except Exception:
            failed.append((case, traceback.format_exc()))
        judged += 1
    signal.alarm(0)
    return name, judged, failed
