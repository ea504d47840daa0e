"""What a VESC tells of itself in single frames: fault, what has let its motor go, position, supply, temperatures.

All settings come and go in one packet of some hundred bytes, whose layout belongs to each build of the firmware
(confgenerator.c in vedderb/bldc), so VESC Tool reads and writes them, and rtarm does not.
"""

from collections.abc import Callable

from config.drives.vesc import STEPS_PER_TURN, VescDrive
from rtloop.drives import vesc_protocol as protocol
from rtloop.drives import vesc_setup as setup
from rtloop.drives.numbers import Number, unpacked
from rtloop.offline.settings.compare import Value
from rtloop.offline.settings.table import Reading, Row, State, Table, Whose, told
from rtloop.service.conversation import Part

STANDING_STEPS = 2
"""A drive that tells two positions no farther apart stands."""
REMARK = "rtarm neither reads nor writes the settings of a VESC: use VESC Tool (docs/hardware/drive-families.md)."


def _drive(whose: Whose) -> VescDrive:
    assert isinstance(whose.drive, VescDrive)
    return whose.drive


def status(whose: Whose, packet: int, number: Number) -> Part[int | None]:
    """A number of a status that comes by itself; None where it does not."""
    frame = yield setup.heard(_drive(whose).controller_id, packet)
    return None if frame is None else unpacked(frame.data, number)


def state(whose: Whose) -> Part[State | None]:
    """Its fault first, then what it sends by itself."""
    number = _drive(whose).controller_id
    answer = yield setup.asked(number, protocol.FAULT)
    if answer is None:
        return None
    before = yield from told(status(whose, protocol.STATUS_4, protocol.TOLD_POSITION))
    released = yield setup.asked(number, protocol.RELEASED)
    volts = yield from told(status(whose, protocol.STATUS_5, protocol.VOLTAGE_V))
    here = yield from told(status(whose, protocol.STATUS_4, protocol.TOLD_POSITION))
    fault = setup.fault_words(setup.value_in(answer))
    known: dict[str, Value] = {
        "fault": fault or "none",
        "let_go_by": None if released is None else setup.released_words(setup.value_in(released)) or "nothing",
    }
    return State(
        trouble=fault,
        moves=None if here is None or before is None else apart(here, before) > STANDING_STEPS,
        turns=None if here is None else setup.steps_in(whose.config, here) / STEPS_PER_TURN,
        supply_v=None if volts is None else round(volts * protocol.VOLTAGE_V.step, 1),
        known=known,
    )


def apart(steps: int, others: int) -> int:
    """How far two positions are from each other, the shorter way round."""
    way = (steps - others) % STEPS_PER_TURN
    return min(way, STEPS_PER_TURN - way)


def celsius(number: Number) -> Callable[[Whose], Part[Value]]:
    """Reads a temperature of status 4."""

    def read(whose: Whose) -> Part[Value]:
        found = yield from status(whose, protocol.STATUS_4, number)
        return None if found is None else round(found * number.step, 1)

    return read


def remarks(whose: Whose, found: Reading) -> list[str]:
    """What is not read, and a position that does not come."""
    sentences = [REMARK]
    if found.state is not None and found.state.turns is None:
        sentences.append(
            f"{whose.config.name}: its drive sends no status 4, so where it stands is not known; switch it on in VESC "
            "Tool (App Settings, General, CAN Messages Rate 1)."
        )
    return sentences


POWER_STAGE_C, MOTOR_C = protocol.HOTTEST_C
TABLE = Table(
    rows=(
        Row("fault", "command 50, bit 15"),
        Row("let_go_by", "command 50, bit 21: its time-out or its kill switch"),
        Row("power_stage_c", "status 4", celsius(POWER_STAGE_C)),
        Row("motor_c", "status 4", celsius(MOTOR_C)),
    ),
    state=state,
    remarks=remarks,
)
new_reading, read, report_of, write = TABLE.new_reading, TABLE.read, TABLE.report_of, TABLE.write
