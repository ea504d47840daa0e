"""What an ODrive tells of itself with CANSimple: version (firmware 0.6), error, state, supply.

Its settings can be read over CAN too (04 and 05), but by the numbers of a list of endpoints that belongs to each build
of the firmware and is published beside it (flat_endpoints.json; ODrive's CAN protocol page). rtarm has no such list.
"""

from rtloop.drives import odrive_protocol as protocol
from rtloop.drives import odrive_setup as setup
from rtloop.drives.numbers import Number, unpacked
from rtloop.offline.settings.compare import Value
from rtloop.offline.settings.table import Reading, Row, State, Table, Whose, rounded, told
from rtloop.service.conversation import Part

HARDWARE = (Number(1, 1), Number(2, 1), Number(3, 1))
"""Of 00: product line, version and variant of the board."""
STANDING_TURNS_S = 0.05
"""An axis that is not faster than this stands; its estimate is never quite 0."""
STATES = {protocol.IDLE: "idle", protocol.CLOSED_LOOP: "closed loop"}


def state(whose: Whose) -> Part[State | None]:
    """Its version first, which 0.5 does not tell and which is never sent unasked; then how it is."""
    node = whose.drive.number
    version = yield setup.asked(node, protocol.VERSION)
    estimates = yield setup.asked(node, protocol.ESTIMATES)
    if version is None and estimates is None:
        return None
    beat = yield from told(setup.heartbeat(whose.arm, whose.joint, lambda beat: True))
    bus = yield setup.asked(node, protocol.BUS)
    firmware = setup.Firmware() if version is None else setup.firmware_in(version.data)
    known: dict[str, Value] = {
        "firmware": str(firmware).removeprefix("firmware "),
        "hardware": None if version is None else ".".join(str(unpacked(version.data, part)) for part in HARDWARE),
        "axis_state": None if beat is None else STATES.get(beat.state, f"state {beat.state}"),
    }
    return State(
        trouble=setup.error_words(beat.error, firmware) if beat is not None and beat.error else "",
        moves=None if estimates is None else abs(unpacked(estimates.data, protocol.TURNS_S)) > STANDING_TURNS_S,
        turns=None if estimates is None else rounded(unpacked(estimates.data, protocol.TURNS)),
        supply_v=None if bus is None else rounded(unpacked(bus.data, protocol.BUS_V)),
        known=known,
    )


def remarks(whose: Whose, found: Reading) -> list[str]:
    """What cannot be read, and a heartbeat that does not come."""
    sentences = [
        "The settings of an ODrive can be read over CAN only with the list of endpoints of its very firmware, so they "
        "are neither read nor written here: use odrivetool (docs/hardware/drive-families.md names them)."
    ]
    if found.values["axis_state"] is None:
        sentences.append(
            f"{whose.config.name}: its drive sends no heartbeat within three times heartbeat_ms, so whether it has an "
            "error is not known."
        )
    return sentences


TABLE = Table(
    rows=(
        Row("firmware", "message 00, 0.5 where there is no answer"),
        Row("hardware", "message 00"),
        Row("axis_state", "message 01"),
    ),
    state=state,
    remarks=remarks,
)
new_reading, read, report_of, write = TABLE.new_reading, TABLE.read, TABLE.report_of, TABLE.write
