"""Release: the conversation that disables the drives of a standing arm, which is then limp.

The cycle has stopped commanding the drives before this begins, and from then on follows the measured positions.
"""

from config.schema import ArmConfig
from rtloop.drives.setup import joints_on_the_bus, setup_of
from rtloop.service.conversation import Conversation
from rtloop.service.port import ServicePort
from shm.words import Fault


class Release(Conversation):
    """One release of a whole arm; a drive that stays enabled latches a fault."""

    def __init__(self, arm: ArmConfig, port: ServicePort, *, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.RELEASE)
        self.begin({joint: setup_of(arm.joints[joint].drive).disable(arm, joint) for joint in joints_on_the_bus(arm)})
