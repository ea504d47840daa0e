"""Claims on CAN identifiers, so that on a bus that several processes can open each drive has one master.

The system lets any number of processes open a CAN interface, and so does python-can with some of its interfaces; a
drive with two masters follows both. A serial adapter needs no claim: only one process can open its port.

A claim is one abstract Unix socket for each set of identifiers. It has no file, belongs to the same network namespace
as the CAN interfaces, is visible to every user and vanishes with its process. Its name holds everything: bus, owner,
pid, identifiers. Nothing connects to it. While a process compares and claims, another socket serves as a lock.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from config.frames import Identifiers, extended, standard
from config.schema import ArmConfig
from rtloop.wire.refusal import WireRefused

EVERYTHING = (standard(0, mask=0, from_drive=True), extended(0, mask=0, from_drive=True))
"""Every identifier of a bus."""
PATIENCE_S = 2.0
"""Timeout of waiting for another process that compares and claims, which takes a millisecond."""
_POLL_S = 0.002
_PREFIX = "rtarm.bus"
_SOCKETS = Path("/proc/net/unix")
_PATH_COLUMN = 7
_PLAIN = re.compile(r"[\w.:+-]{1,40}")


@dataclass(frozen=True)
class Owner:
    """The process that holds a claim."""

    arm: str
    """Name of its arm; empty for `rtarm scan`."""
    pid: int

    def __str__(self) -> str:
        return f"arm '{self.arm}' (pid {self.pid})" if self.arm else f"`rtarm scan` (pid {self.pid})"


class Claim:
    """The claims of a process, held until `close` or the end of the process."""

    def __init__(self) -> None:
        self._sockets: list[socket.socket] = []

    def add(self, name: str) -> None:
        """Bind one more name; raises OSError if another process has it."""
        bound = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            bound.bind(f"\0{name}")
        except OSError:
            bound.close()
            raise
        self._sockets.append(bound)

    def take_over(self, other: Claim) -> None:
        """Hold the claims of another, too."""
        self._sockets += other._sockets
        other._sockets = []

    def close(self) -> None:
        for bound in self._sockets:
            bound.close()
        self._sockets.clear()


def claim_for_arm(arm: ArmConfig) -> Claim:
    """Claim the identifiers of an arm's drives and gripper, on each bus whose wire several processes can open.

    Raises WireRefused.
    """
    claimed = Claim()
    try:
        for part in arm.parts:
            bus = _bus_of(part)
            if bus is not None:
                claimed.take_over(_claim_for_part(part, bus))
    except BaseException:
        claimed.close()
        raise
    return claimed


def _claim_for_part(arm: ArmConfig, bus: str) -> Claim:
    users = {used: joint.name for joint in arm.joints for used in joint.drive.identifiers}
    if arm.gripper is not None and arm.gripper.servo is not None:
        users |= dict.fromkeys(arm.gripper.servo.identifiers, "the gripper")
    return claim(bus, arm.name, {used: f"{whose} of arm '{arm.name}'" for used, whose in users.items()})


def claim_for_scan(channel: str) -> Claim:
    """Claim every identifier of a CAN interface, because a scan asks every address. Raises WireRefused."""
    return claim(channel, "", dict.fromkeys(EVERYTHING, "a scan, which asks every address,"))


def claim(bus: str, arm: str, users: Mapping[Identifiers, str]) -> Claim:
    """Claim identifiers on a bus for an arm (empty: for a scan); `users` names the drive of each.

    Raises WireRefused if another process has claimed one of them.
    """
    try:
        return _claimed(bus, arm, users)
    except OSError as problem:
        raise WireRefused(
            f"Whether another program leads drives on {bus} cannot be found out ({problem}): let this one read "
            f"{_SOCKETS} and open Unix sockets."
        ) from problem


def _claimed(bus: str, arm: str, users: Mapping[Identifiers, str]) -> Claim:
    claimed = Claim()
    with _no_other_claims(bus):
        held = list(_claims(bus))
        for mine, user in users.items():
            for theirs, owner in held:
                if mine.meets(theirs):
                    common = mine.match & mine.mask | theirs.match & theirs.mask
                    raise WireRefused(
                        f"{bus} is in use by {owner}, and {user} would use the same CAN identifiers, {common:#x} among "
                        "them, so drives would have two masters: end that program first (Ctrl-C in its terminal), or "
                        "give the drives addresses of their own."
                    )
        try:
            for used in users:
                claimed.add(f"{_prefix(bus)}{arm}/{os.getpid()}/{_written(used)}")
        except BaseException:
            claimed.close()
            raise
    return claimed


def _bus_of(arm: ArmConfig) -> str | None:
    """Name of the arm's bus, the same in all processes; None if only one process can open it."""
    bus, by_python_can = arm.bus, arm.bus.python_can
    if bus.interface == "socketcan" or (by_python_can is not None and by_python_can.interface == "socketcan"):
        return bus.resolved_channel
    if by_python_can is None or by_python_can.interface == "virtual":  # the latter is a bus inside one process
        return None
    channel = bus.resolved_channel
    return f"{by_python_can.interface}:{os.path.realpath(channel) if channel.startswith('/') else channel}"


def _prefix(bus: str) -> str:
    """Beginning of the names of a bus's sockets; a name has at most 107 bytes in all."""
    plain = bus if _PLAIN.fullmatch(bus) else hashlib.blake2b(bus.encode(), digest_size=16).hexdigest()
    return f"{_PREFIX}/{plain}/"


def _written(used: Identifiers) -> str:
    return f"{'x' if used.extended else 's'}{used.match:x}.{used.mask:x}"


def _read(name: str) -> tuple[Identifiers, Owner]:
    """Identifiers and owner in a name without its prefix; raises ValueError if it is not the name of a claim."""
    arm, pid, text = name.split("/")
    match, mask = (int(number, 16) for number in text[1:].split("."))
    make = {"x": extended, "s": standard}.get(text[:1])
    if make is None:
        raise ValueError(name)
    return make(match, mask=mask, from_drive=True), Owner(arm, int(pid))


def _claims(bus: str) -> Iterator[tuple[Identifiers, Owner]]:
    """The present claims on a bus."""
    prefix = f"@{_prefix(bus)}"
    for line in _SOCKETS.read_text(errors="replace").splitlines():
        columns = line.split(maxsplit=_PATH_COLUMN)
        if len(columns) > _PATH_COLUMN and columns[_PATH_COLUMN].startswith(prefix):
            with contextlib.suppress(ValueError):
                yield _read(columns[_PATH_COLUMN].removeprefix(prefix))


@contextlib.contextmanager
def _no_other_claims(bus: str) -> Iterator[None]:
    """Lock for comparing and claiming; raises WireRefused if another process keeps it for PATIENCE_S."""
    comparing = Claim()
    until_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            comparing.add(f"{_prefix(bus)}comparing")
            break
        except OSError as problem:
            if problem.errno != errno.EADDRINUSE:
                raise
            if time.monotonic() > until_s:
                raise WireRefused(
                    f"Another program of rtarm that starts to use {bus} stands still: end it, then start again."
                ) from None
        time.sleep(_POLL_S)
    try:
        yield
    finally:
        comparing.close()
