"""Settings of an MKS SERVO42D/57D (the maker's CAN manuals V1.0.6, 5.9, and V1.0.9, 5.1.10 and 5.1.11).

`00 code` reads what the command `code` sets, in the bytes of that command, or FF FF where there is nothing to read;
firmware before V1.0.6 does not know it. `40` tells calibration, hardware and firmware of V1.0.9; the manual has the
firmware's version as three bytes, and a frame with room for two, so an answer of another length has no version here.
What is set is kept without power, so it is written with `--store` alone.

Requests and answers share an identifier, and the answer to `00 82` is the command that sets what it tells: two drives
of one CanID would set each other, on and on. So what a drive is set to is asked for once a single one has answered.
"""

from collections.abc import Callable

from config.drives.mks import COUNTS_PER_REVOLUTION
from rtloop.drives import mks_protocol as protocol
from rtloop.drives import mks_setup as setup
from rtloop.drives.numbers import unpacked
from rtloop.offline.settings.compare import Value
from rtloop.offline.settings.table import Reading, Row, State, Table, Whose, bitrate, number
from rtloop.service.conversation import Part

VERSION, CURRENT, BIT_RATE, CAN_ID, HOLD_CURRENT = 0x40, 0x83, 0x8A, 0x8B, 0x9B
VERSION_LENGTHS = (5, 6)
VERSION_BYTES = 3
MODES = ("CR_OPEN", "CR_CLOSE", "CR_vFOC", "SR_OPEN", "SR_CLOSE", "SR_vFOC")
BOARDS = ("S42D_485", "S42D_CAN", "S57D_485", "S57D_CAN", "S28D_RS485", "S28D_CAN", "S35D_RS485", "S35D_CAN")
"""Hardware versions from 1 on."""
BIT_RATES = (125_000, 250_000, 500_000, 1_000_000)
ANSWERS = ("off", "on")


def parameter(code: int, size: int, value: Callable[[int], Value]) -> Callable[[Whose], Part[Value]]:
    """Reads a setting whose number has `size` bytes."""

    def read(whose: Whose) -> Part[Value]:
        answer = yield from setup.parameter(whose.config, code, size + 2)
        return None if answer is None else value(int.from_bytes(answer[1 : 1 + size], "big"))

    return read


def one_of(values: tuple[Value, ...]) -> Callable[[int], Value]:
    """A code's meaning, by itself where it has none."""
    return lambda code: values[code] if code < len(values) else f"code {code}"


def wanted_answers(whose: Whose) -> Value:
    """Whether commands are acknowledged, where the arm file names that."""
    bus = whose.arm.bus_of(whose.config)
    return ANSWERS[bus.acknowledge] if "acknowledge" in bus.model_fields_set else None


def write_answers(whose: Whose, wanted: str) -> Part[object]:
    """Turn acknowledgements on or off, as bring-up does, and reports of ended motions off."""
    return setup.write_setting(whose.config, protocol.ANSWERS, ANSWERS.index(wanted), 0)


def state(whose: Whose) -> Part[State | None]:
    """Whether it moves, where it is, and what it is."""
    can_id = whose.drive.number
    answer = yield setup.ask(can_id, 3, protocol.READ_STATE)
    if answer is None:
        return None
    moves = unpacked(answer.data, protocol.VALUE) not in (protocol.STANDS, protocol.REFUSED)
    place = yield setup.ask(can_id, 8, protocol.READ_POSITION)
    version = yield setup.ask(can_id, VERSION_LENGTHS, VERSION)
    return State(
        moves=moves,
        turns=None if place is None else unpacked(place.data, protocol.COUNTS) / COUNTS_PER_REVOLUTION,
        known={} if version is None else what_it_is(version.data),
    )


def trouble(whose: Whose) -> Part[str]:
    """Whether it has tripped; what a stall does is a setting, which two drives of one CanID are not asked for."""
    stalled = yield setup.ask(whose.drive.number, 3, protocol.READ_STALLED)
    tripped = stalled is not None and unpacked(stalled.data, protocol.VALUE) == 1
    return "stall" if tripped and (yield from setup.lets_go_stalled(whose.config)) else ""


def what_it_is(data: bytes) -> dict[str, Value]:
    """What the answer to 40 says."""
    board, firmware = data[1] & 0xF, data[2:-1]
    return {
        "calibrated": bool(data[1] >> 4),
        "hardware": BOARDS[board - 1] if 0 < board <= len(BOARDS) else f"code {board}",
        "firmware": ".".join(map(str, firmware)) if len(firmware) == VERSION_BYTES else None,
    }


def remarks(whose: Whose, found: Reading) -> list[str]:
    """What firmware that cannot be asked leaves open, and what bring-up would refuse."""
    name, microsteps = whose.config.name, found.values["microsteps"]
    if found.values["mode"] is None:
        return [
            f"{name}: its drive does not report its settings, which firmware V1.0.6 and newer does: see its menu, or "
            "update it."
        ]
    if microsteps in protocol.TRUE_SPEED_MICROSTEPS:
        return []
    return [
        f"{name}: its drive has {microsteps} microsteps, with which its speed is not the one it is told: set MStep in "
        "its menu to 16, 32 or 64."
    ]


TABLE = Table(
    rows=(
        Row("firmware", "command 40, from V1.0.9 on"),
        Row("hardware", "command 40"),
        Row("calibrated", "command 40", wanted=lambda whose: True),  # which it must be, once
        Row("can_id", "command 8B, 1 to 2047, at first 1", parameter(CAN_ID, 2, int), number),
        Row("bitrate", "command 8A, at first 500000", parameter(BIT_RATE, 1, one_of(BIT_RATES)), bitrate),
        Row("mode", "command 82, at first CR_vFOC", parameter(protocol.WORK_MODE, 1, one_of(MODES))),
        Row("microsteps", "command 84, at first 16", parameter(protocol.MICROSTEPS, 1, lambda code: code or 256)),
        Row(
            "response",
            "command 8C, at first on",
            parameter(protocol.ANSWERS, 2, lambda both: one_of(ANSWERS)(both >> 8)),
            wanted_answers,
            write_answers,
            kept=True,
        ),
        Row("current_ma", "command 83, to 3000 (42D) or 5200 (57D)", parameter(CURRENT, 2, int)),
        Row("hold_current_percent", "command 9B", parameter(HOLD_CURRENT, 1, lambda code: 10 * (code + 1))),
        Row("stall_protection", "command 88, at first off", parameter(protocol.PROTECT, 1, one_of(("off", "on")))),
    ),
    state=state,
    trouble=trouble,
    remarks=remarks,
)
new_reading, read, report_of, write = TABLE.new_reading, TABLE.read, TABLE.report_of, TABLE.write
