"""Proof of power (`rtloop.drives.power`) for drives that only a command arms: they do not arm when power comes.

The mark of such a drive says that rtarm found it disarmed and has armed it, so that it does not arm by itself. The mark
is removed before the drive is armed anew. So a drive that has the mark and is armed has had power ever since.
"""

from __future__ import annotations

from collections.abc import Callable

from rtloop.drives.asking import surely
from rtloop.drives.setup import Host, PowerHost, require_may_enable, settle_mark
from rtloop.service.conversation import Part

ARMED = "armed by rtarm"
Look = Callable[[], Part[bool | None]]
"""Asks a drive whether it is armed; None if it does not answer that."""


def stayed_armed(host: PowerHost, joint: int, look: Look) -> Part[bool]:
    """Whether a drive has been armed ever since rtarm armed it, and so has not been without power."""
    return host.marks[joint] is not None and (yield from surely(look)) is True


class Arming:
    """Keeps track, during the bring-up of a drive, of whether it is armed and who armed it."""

    def __init__(self, host: Host, joint: int, look: Look) -> None:
        self._host, self._joint, self._look = host, joint, look
        self._anew = False

    def found(self, armed: bool) -> Part[bool]:
        """Whether the drive is armed.

        That is `armed`, as it was just read; if it may become a proof of power, it is what two readings agree on.
        """
        if not self._host.was_silent[self._joint] or self._host.marks.borne(self._joint) is None:
            return armed
        agreed = yield from surely(self._look)
        return armed if agreed is None else agreed

    def begins(self) -> None:
        """Remove the drive's mark, as it is about to be armed; raises DialogueFailed if it may not be enabled.

        However this bring-up ends, an armed drive then proves nothing about the time before.
        """
        require_may_enable(self._host, self._joint)
        self._anew = True
        self._host.marks[self._joint] = None

    def kept_power(self) -> Part[bool]:
        """Whether the drive proves that it had power during its silence; records its mark.

        To be the last question of a bring-up, so that the proof covers everything that was read before.
        """
        host, joint = self._host, self._joint
        if self._anew:
            return settle_mark(host, joint, False, ARMED)
        if not host.was_silent[joint]:
            return False
        proof = yield from stayed_armed(host, joint, self._look)
        return settle_mark(host, joint, proof, host.marks.borne(joint))
