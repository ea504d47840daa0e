"""Proof of power (`rtloop.drives.power`) for drives that a command arms, and power does not.

The mark of such a drive says that rtarm has armed it, having found it otherwise: it does not do so by itself. It is
taken away before a drive is armed anew, so one that has it and is armed has not been without power since.
"""

from __future__ import annotations

from collections.abc import Callable

from rtloop.drives.asking import surely
from rtloop.drives.setup import Host, PowerHost, require_may_enable, settle_mark
from rtloop.service.conversation import Part

ARMED = "armed by rtarm"
Look = Callable[[], Part[bool | None]]
"""Asks a drive whether it is armed; None where it does not say."""


def stayed_armed(host: PowerHost, joint: int, look: Look) -> Part[bool]:
    """Whether a drive has been armed ever since rtarm armed it, and so has not been without power."""
    return host.marks[joint] is not None and (yield from surely(look)) is True


class Arming:
    """What the bring-up of a drive sees, and does, of its being armed."""

    def __init__(self, host: Host, joint: int, look: Look) -> None:
        self._host, self._joint, self._look = host, joint, look
        self._anew = False

    def found(self, armed: bool) -> Part[bool]:
        """Whether the drive is armed, as it was just seen; of one that may prove by it, as two looks agree."""
        if not self._host.was_silent[self._joint] or self._host.marks.borne(self._joint) is None:
            return armed
        agreed = yield from surely(self._look)
        return armed if agreed is None else agreed

    def begins(self) -> None:
        """The drive is armed next: however this bring-up ends, that it is so will prove nothing of the time before."""
        require_may_enable(self._host, self._joint)
        self._anew = True
        self._host.marks[self._joint] = None

    def kept_power(self) -> Part[bool]:
        """Whether the drive proves that it had power in its silence; its mark is settled.

        The last question of a bring-up, so that it speaks for all that was read before.
        """
        host, joint = self._host, self._joint
        if self._anew:
            return settle_mark(host, joint, False, ARMED)
        if not host.was_silent[joint]:
            return False
        proof = yield from stayed_armed(host, joint, self._look)
        return settle_mark(host, joint, proof, host.marks.borne(joint))
