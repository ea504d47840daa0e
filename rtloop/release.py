"""Letting the drives go: the conversation after which a standing arm is limp.

The cycle has stopped leading the drives before this begins, and follows where they are from then on.
"""

from config.schema import ArmConfig
from rtloop.conversation import TRIES, Ask, Conversation, Dialogue, TalkFailed, drive_addresses
from rtloop.drives import zdt_registers, zdt_talk
from rtloop.port import ServicePort
from shm.words import Fault


class Release(Conversation):
    """One release of a whole arm; a drive that stays enabled is a latched fault."""

    def __init__(self, arm: ArmConfig, port: ServicePort, *, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.RELEASE)
        self.begin({joint: self._let_go(joint) for joint in drive_addresses(arm)})

    def _let_go(self, joint: int) -> Dialogue:
        name = self.arm.joints[joint].name
        for _ in range(TRIES):
            yield Ask(zdt_registers.RELEASE, (3,), answered=self.arm.bus.acknowledge)
            flags = yield from zdt_talk.read_flags(zdt_registers.ASK_STATUS)
            if flags is not None and not flags & zdt_registers.ENABLED:
                return
        raise TalkFailed(
            joint,
            f"The drive of {name} stays enabled after being told to let go: keep clear of the arm, look at the drive's "
            "display, then `rtarm clear-fault`, which brings all drives up again.",
        )
