"""How many examples each property tries: all in `make test-all`, a third in the `make test` of a working day."""

from __future__ import annotations

import os

ALL = os.environ.get("RTARM_EXAMPLES") == "all"


def examples(count: int) -> int:
    """So many of that count are tried in this run."""
    return count if ALL else -(-count // 3)
