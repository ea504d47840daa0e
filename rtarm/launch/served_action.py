"""Which `rtarm up` serves an action in a ROS domain: a claim on its name, which one launcher of a machine holds.

A goal reaches every server of its action's name, so two arms of one name must not be served in one domain. ROS'
discovery is no witness for a start: it takes up to seconds, and shows a server that was killed for another 20 s. A
claim is there at once and falls with its process: two abstract Unix sockets, of which one is the name and the other
says whose it is. Like ROS on one machine they are of a network namespace, and seen by every user. The launcher holds
them and not the ROS process, which is started again whenever it ends.
"""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from rtarm.console.errors import Refusal
from rtloop.wire.claim import Claim

_SOCKETS = Path("/proc/net/unix")
_NAMESPACE_RULE = "__ns"


def claim_action(action: str, domain: str, arm: str) -> Claim:
    """Claim an action, by its full name, in a ROS domain (empty: 0) for an arm.

    Raises:
        Refusal: another launcher of this machine serves it there.
    """
    domain = domain.lstrip("0") or "0"
    digest = hashlib.blake2b(f"{domain} {action}".encode(), digest_size=16).hexdigest()
    name = f"rtarm.action/{digest}"  # of at most 107 bytes, owner included
    claim = Claim()
    try:
        claim.add(name)
        claim.add(f"{name}/{os.getpid()}/{arm}")
    except OSError as problem:
        claim.close()
        if problem.errno != errno.EADDRINUSE:
            raise Refusal(
                f"The action {action} cannot be claimed here ({problem.strerror}): allow Unix sockets."
            ) from None
        raise Refusal(
            f"{_owner(name)} serves {action} in ROS domain {domain} already, and every goal would move both arms, so "
            "nothing was started: end that one (Ctrl-C in its terminal), or start this one with another "
            "front.controller_name, in another namespace or with another ROS_DOMAIN_ID."
        ) from None
    return claim


def namespace_of(ros_arguments: Sequence[str]) -> str:
    """The namespace that ROS arguments give to a node, "" for the root; ROS takes the first that it finds."""
    for word in ros_arguments:
        rule, _, namespace = word.partition(":=")
        if rule.rpartition(":")[2] == _NAMESPACE_RULE:
            return namespace.rstrip("/")
    return ""


def _owner(name: str) -> str:
    """Who has claimed a name, as the beginning of a sentence."""
    for line in _SOCKETS.read_text(errors="replace").splitlines():
        _, found, owner = line.partition(f"@{name}/")
        if found:
            pid, _, arm = owner.partition("/")
            return f"Arm '{arm}' (`rtarm up`, pid {pid})"
    return "Another `rtarm up`"  # which is about to say whose it is, or has just ended
