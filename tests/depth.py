"""How many examples each property tries: all in `make test-all`, a third in the `make test` of a working day.

`make test-arm64`, under whose emulation everything is ten times as slow, asks for few.
"""

from __future__ import annotations

import os

ONE_IN = {"all": 1, "few": 20}.get(os.environ.get("RTARM_EXAMPLES", ""), 3)


def examples(count: int) -> int:
    """So many of that count are tried in this run."""
    return -(-count // ONE_IN)
