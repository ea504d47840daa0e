"""The ROS domain of what is ours alone, such as demo and benchmark: one where no arm of anybody's is."""

from __future__ import annotations

import random
from pathlib import Path

DOMAINS = range(215, 232)
"""Few people count so far, and nothing else uses their ports.

A domain has the 250 UDP ports from 7400 + 250 · domain on, two of them for each participant after the first ten. Linux
hands out ports 32768 to 60999 to programs that ask for any. That leaves domains 0 to 101, which people use, and 215
(from port 61150) to 232. Domain 232 ends with the last port there is, 65535, and has room for 63 participants on a
machine; the others have room for 120.
"""

_FIRST_PORT, _PORTS_A_DOMAIN = 7400, 250
_BOUND = (Path("/proc/net/udp"), Path("/proc/net/udp6"))


def own_domain() -> dict[str, str]:
    """Environment of ROS processes in a domain of their own, which no other machine hears.

    One that nothing on this machine uses now, as far as there is one. A name of its own is what keeps an arm apart;
    this keeps others from hearing of it at all.
    """
    used = {(port - _FIRST_PORT) // _PORTS_A_DOMAIN for port in _bound_ports()}
    domain = random.SystemRandom().choice([free for free in DOMAINS if free not in used] or DOMAINS)
    return {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def ports_of(domain: int) -> range:
    """Its UDP ports; participants take them in rising order."""
    first = _FIRST_PORT + _PORTS_A_DOMAIN * domain
    return range(first, first + _PORTS_A_DOMAIN)


def _bound_ports() -> set[int]:
    """UDP ports in use on this machine."""
    lines = [line for table in _BOUND if table.exists() for line in table.read_text().splitlines()[1:]]
    return {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
