"""Settings of a MyActuator RMD motor (Motor Motion Protocol V4.2 and V4.3; 2b-t/myactuator_rmd and its tests).

B2 is answered with the date of the firmware, B5 with seven characters of the model. 43 writes a ramp to ROM, so a ramp
is written with `--store` alone. The time-out of communication (B3) and the filter of identifiers (20, index 2) can only
be written: no frame reads them, and nothing of them is written here.
"""

from collections.abc import Callable

from config.drives.myactuator import STEPS_PER_REVOLUTION, MyactuatorDrive
from rtloop.drives import myactuator_protocol as protocol
from rtloop.drives import myactuator_setup as setup
from rtloop.drives.errors import error_words
from rtloop.drives.numbers import NO_VALUES, Number, Values, unpacked
from rtloop.offline.settings.compare import Value
from rtloop.offline.settings.table import Reading, Row, State, Table, Whose
from rtloop.service.conversation import Part

BUILT, MODEL = 0xB2, 0xB5
BUILT_DATE = Number(4, 4)
"""Of B2: year, month and day as one decimal number."""
SPEED_RAMPS = ((2, "speed_acceleration_dps_s"), (3, "speed_deceleration_dps_s"))


def _drive(whose: Whose) -> MyactuatorDrive:
    assert isinstance(whose.drive, MyactuatorDrive)
    return whose.drive


def data(whose: Whose, command: int, values: Values = NO_VALUES) -> Part[bytes | None]:
    """The data of the answer to a command."""
    answer = yield setup.asked(_drive(whose), command, values)
    return None if answer is None else bytes(answer.data)


def ramp(index: int) -> Callable[[Whose], Part[Value]]:
    """Reads a ramp (degrees/s²)."""

    def read(whose: Whose) -> Part[Value]:
        answer = yield from data(whose, protocol.READ_RAMP, {protocol.RAMP_INDEX: index})
        return None if answer is None else unpacked(answer, protocol.RAMP_DPS_S)

    return read


def position_ramp(index: int, name: str) -> Row:
    """A ramp of position planning, which follows from the joint's limit of acceleration and which bring-up sets."""
    return Row(
        f"{name}_dps_s",
        f"commands 42 and 43, index {index}, 100 to 60000",
        ramp(index),
        lambda whose: setup.ramp_dps_s(whose.config, whose.arm),
        lambda whose, wanted: setup.with_ramp(whose.joint, whose.config, index, name, wanted),
        kept=True,
    )


def read_built(whose: Whose) -> Part[Value]:
    """The date of the firmware."""
    answer = yield from data(whose, BUILT)
    return None if answer is None else str(unpacked(answer, BUILT_DATE))


def read_model(whose: Whose) -> Part[Value]:
    """The model."""
    answer = yield from data(whose, MODEL)
    return None if answer is None else answer[1:].decode("ascii", "replace").strip("\0 ")


def state(whose: Whose) -> Part[State | None]:
    """Its error, brake and supply, its speed, and its angle."""
    status = yield from data(whose, protocol.STATUS)
    if status is None:
        return None
    feedback = yield from data(whose, protocol.FEEDBACK)
    angle = yield from data(whose, protocol.ANGLE)
    error = unpacked(status, protocol.ERROR)
    return State(
        trouble=error_words(error, protocol.ERRORS) if error else "",
        moves=None if feedback is None else unpacked(feedback, protocol.SPEED) != 0,
        turns=None if angle is None else unpacked(angle, protocol.READ_ANGLE) / STEPS_PER_REVOLUTION,
        supply_v=round(unpacked(status, protocol.VOLTAGE_V) * protocol.VOLTAGE_V.step, 1),
        known={"brake": "released" if unpacked(status, protocol.BRAKE_RELEASED) else "locked"},
    )


def remarks(whose: Whose, found: Reading) -> list[str]:
    """What cannot be read."""
    return [
        "A MyActuator drive does not report its communication time-out (B3): it must be 0, or the joint falls when "
        "rtarm ends; set it with the maker's program if it was ever changed."
    ]


TABLE = Table(
    rows=(
        Row("model", "command B5", read_model),
        Row("firmware", "command B2, the date of its build", read_built),
        *(position_ramp(index, name) for index, name in protocol.RAMPS),
        *(Row(name, f"command 42, index {index}, 100 to 60000", ramp(index)) for index, name in SPEED_RAMPS),
        Row("brake", "command 9A"),
    ),
    state=state,
    remarks=remarks,
)
new_reading, read, report_of, write = TABLE.new_reading, TABLE.read, TABLE.report_of, TABLE.write
