"""Letting the drives go: the conversation after which a standing arm is limp.

The cycle has stopped leading the drives before this begins, and follows where they are from then on.
"""

from config.schema import ArmConfig
from rtloop.conversation import TRIES, Ask, Conversation, Dialogue, TalkFailed, drive_addresses
from rtloop.port import ServicePort
from shm.words import Fault

_DISABLE = b"\xf3\xab\x00\x00\x6b"
_READ_STATUS = b"\x3a\x6b"
_ENABLED = 0x01


class Release(Conversation):
    """One release of a whole arm; a drive that stays enabled is a latched fault."""

    def __init__(self, arm: ArmConfig, port: ServicePort, *, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.RELEASE)
        self.begin({joint: self._let_go(joint) for joint in drive_addresses(arm)})

    def _let_go(self, joint: int) -> Dialogue:
        name = self.arm.joints[joint].name
        for _ in range(TRIES):
            yield Ask(_DISABLE, (3,), answered=self.arm.bus.acknowledge)
            status = yield Ask(_READ_STATUS, (3,))
            if status is not None and status[0] == _READ_STATUS[0] and not status[1] & _ENABLED:
                return
        raise TalkFailed(
            joint,
            f"The drive of {name} stays enabled after being told to let go: keep clear of the arm, look at the drive's "
            "display, then `rtarm clear-fault`, which brings all drives up again.",
        )
