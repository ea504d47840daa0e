"""The last conversation of an orderly end: drives that send their positions by themselves are told to cease.

They would go on for as long as they have power, and load the bus of whoever uses it next.
"""

from config.schema import ArmConfig
from rtloop.drives.setup import joints_on_the_bus, reporting_of
from rtloop.service.conversation import Conversation
from rtloop.service.port import ServicePort
from shm.words import Fault


class ShutdownDialogue(Conversation):
    """One with a whole arm; a drive that does not answer is left as it is, since the arm stands and holds."""

    def __init__(self, arm: ArmConfig, port: ServicePort, *, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.NONE)
        reporting = joints_on_the_bus(arm) if arm.bus.reported else []
        found = {joint: reporting_of(arm.joints[joint].drive) for joint in reporting}
        self.begin({joint: reports.end_reports(arm, joint) for joint, reports in found.items() if reports is not None})
