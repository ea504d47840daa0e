"""Drives that send their positions unrequested (reports): turned on, and checked to come at the rate that was set.

A drive loses this setting with its power, like everything in its volatile memory.
"""

from config.schema import ArmConfig
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_ask import ZdtDialogue
from rtloop.drives.zdt_protocol import Version
from rtloop.drives.zdt_talk import Answered
from rtloop.service.conversation import DialogueFailed
from rtloop.service.port import ServicePort

REPORTS_TO_BELIEVE = 3
REPORTS_TO_JUDGE = 8
REPORT_LOOKS = 20
"""Status requests, each a cycle or two apart, within which enough reports must have come."""
TRIES = 3
"""Measurements of the spacing of reports: some reports may be lost, or still come at an earlier rate."""
SPACING = (0.75, 1.35)
"""Allowed ratio of the mean spacing of reports to the one that was set. Faster reports need more of the bus than is
budgeted (`config.budget`), and slower ones are missing too often (`rtloop.safety.monitor`)."""


def begin(arm: ArmConfig, port: ServicePort, joint: int, version: Version) -> ZdtDialogue:
    """Turn a drive's reports on, and check that they come; raises DialogueFailed.

    It is not documented whether a drive acknowledges `11` when its acknowledgements are off, so silence is no refusal.
    """
    name, period_ms = arm.joints[joint].name, arm.control.report_period_ms
    if not (yield from zdt_talk.set_reports(period_ms)):
        raise DialogueFailed(
            joint,
            f"The drive of {name} (firmware {version}) does not send its position by itself, which "
            "bus.positions: reported asks for and only drives of the X42S and Y42 generation can: set "
            "bus.positions to polled.",
        )
    spacing_ms: float | None = None
    for _ in range(TRIES):
        spacing_ms = yield from _spacing_ms(arm, port, joint)
        if spacing_ms is not None and SPACING[0] <= spacing_ms / period_ms <= SPACING[1]:
            return
    found = (
        f"was told to send its position every {period_ms} ms, but none comes"
        if spacing_ms is None
        else f"sends its position every {spacing_ms:.1f} ms, although it was told to every {period_ms} ms"
    )
    raise DialogueFailed(joint, f"The drive of {name} (firmware {version}) {found}: set bus.positions to polled.")


def _spacing_ms(arm: ArmConfig, port: ServicePort, joint: int) -> Answered[float | None]:
    """Mean time (ms) between reports that come while the drive is asked for its status; None if there are too few."""
    before = port.unasked(joint)
    reports: list[tuple[int, int]] = []
    for _ in range(REPORT_LOOKS):
        yield from zdt_talk.status_of(joint, arm.joints[joint])
        count = port.unasked(joint) - before
        if count > 0:  # the reading before that was perhaps no report
            reports.append((count, port.measured_ns(joint)))
            if count - reports[0][0] >= REPORTS_TO_JUDGE:
                break
    if not reports or reports[-1][0] - reports[0][0] < REPORTS_TO_BELIEVE - 1:
        return None
    (first, first_ns), (last, last_ns) = reports[0], reports[-1]
    return (last_ns - first_ns) * 1e-6 / (last - first)
