"""The last conversation of an orderly shutdown: it turns off the reports of drives that send positions unasked.

The drives would go on reporting for as long as they have power, and load the bus for its next user.
"""

from config.schema import ArmConfig
from rtloop.drives.setup import joints_on_the_bus, reporting_of
from rtloop.service.conversation import Conversation
from rtloop.service.port import ServicePort
from shm.words import Fault


class ShutdownDialogue(Conversation):
    """One shutdown of a whole arm; a drive that does not answer is left as it is, since the arm stands and holds."""

    def __init__(self, arm: ArmConfig, port: ServicePort, *, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.NONE)
        reporting = joints_on_the_bus(arm) if arm.bus.reported else []
        found = {joint: reporting_of(arm.joints[joint].drive) for joint in reporting}
        self.begin({joint: reports.end_reports(arm, joint) for joint, reports in found.items() if reports is not None})
