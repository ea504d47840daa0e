"""What is English in a text that is to be Chinese."""

from __future__ import annotations

import re

NAMES = re.compile(
    r"rtarm|ROS|CAN|CPU|SCHED_\w+|pid|Hz|rad|Nm|C|V|q|min|ms|µs|s|h|p50|p99|max|1ms|10ms|t[0-9a-f]+_\d+|episode1|"
    r"shoulder|elbow|(?:joint\d)+"
)
"""Names and units, which are the same in every language; arms of tests, and their joints."""
COMMANDS = re.compile(r"`[^`]*`|<code>[^<]*</code>|~/\w+|rtarm [a-z-]+(?: \S*/\S+)?")


def english_in(shown: str) -> set[str]:
    """Words that are no names, units or commands, of lines or of HTML."""
    plain = re.sub(r"<[^>]*>|&[a-z#0-9]+;", " ", COMMANDS.sub(" ", " ".join(shown.split())))
    return {word for word in re.findall(r"[A-Za-z]\w*", plain, re.ASCII) if NAMES.fullmatch(word) is None}
