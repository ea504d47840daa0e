"""The last conversation of an orderly end: drives that send their positions by themselves are told to cease.

They would go on for as long as they have power, and load the bus of whoever uses it next.
"""

from config.schema import ArmConfig
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_ask import ZdtDialogue, addressed, zdt_addresses
from rtloop.service.conversation import Conversation
from rtloop.service.port import ServicePort
from shm.words import Fault


class Farewell(Conversation):
    """One farewell to a whole arm; a drive that does not answer is left as it is, since the arm stands and holds."""

    def __init__(self, arm: ArmConfig, port: ServicePort, *, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.NONE)
        reporting = zdt_addresses(arm) if arm.bus.reported else {}
        self.begin({joint: addressed(address, self._end_reports()) for joint, address in reporting.items()})

    def _end_reports(self) -> ZdtDialogue:
        yield from zdt_talk.set_reports(0)
