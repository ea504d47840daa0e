"""Settings of a CiA 402 drive: objects of CiA 301 (1008 to 1018) and of CiA 402 (IEC 61800-7-201).

Most of them a drive need not have; what it has is shown. 1010:01 lets it store what it has, where bit 0 of it says that
it does so when told (CiA 301). A node that was stopped (NMT) answers nothing until bring-up starts it.
"""

from collections.abc import Callable

from config.drives.cia402 import Cia402Drive
from rtloop.drives import cia402_protocol as protocol
from rtloop.drives import cia402_setup as setup
from rtloop.drives.sdo import Aborted, Node, Object, abort_words, writing
from rtloop.offline.settings.compare import Value
from rtloop.offline.settings.table import Reading, Row, State, Table, Whose, named, rounded, sent_once, told
from rtloop.service.conversation import DialogueFailed, Part

NAME, HARDWARE, FIRMWARE = (
    Object(0x1008, 0, 4, "name"),
    Object(0x1009, 0, 4, "hardware version"),
    Object(0x100A, 0, 4, "software version"),
)
STORE = Object(0x1010, 1, 4, "store all parameters")
SAVE, STORES_WHEN_TOLD = int.from_bytes(b"save", "little"), 1
RATED_TORQUE = Object(0x6076, 0, 4, "rated torque")
SUPPLY = Object(0x6079, 0, 4, "DC link voltage")
FEED = (Object(0x6092, 1, 4, "feed"), Object(0x6092, 2, 4, "feed's shaft revolutions"))
GEAR = (Object(0x6091, 1, 4, "gear's motor revolutions"), Object(0x6091, 2, 4, "gear's shaft revolutions"))
STANDING_TURNS = 1e-4
"""Two readings in a row of a drive that stands differ by no more than this, or by two counts."""


def _drive(whose: Whose) -> Cia402Drive:
    assert isinstance(whose.drive, Cia402Drive)
    return whose.drive


def _node(whose: Whose) -> Node:
    return Node(whose.joint, whose.config)


def value(entry: Object) -> Callable[[Whose], Part[Value]]:
    """Reads a number; None where the drive has none."""
    return lambda whose: _node(whose).read_if_there(entry)


def text(entry: Object) -> Callable[[Whose], Part[Value]]:
    """Reads a text."""
    return lambda whose: _node(whose).read_text(entry)


def row(name: str, index: int, sub: int, size: int, *, signed: bool = False) -> Row:
    """A number that is only shown."""
    entry = Object(index, sub, size, name, signed)
    return Row(name, f"object {index:04X}" + (f":{sub:02X}" if sub else ""), value(entry))


def identity(name: str, sub: int) -> Row:
    """A number of the identity object, in hexadecimal."""

    def read(whose: Whose) -> Part[Value]:
        return f"{(yield from _node(whose).read(Object(0x1018, sub, 4, name))):#x}"

    return Row(name, f"object 1018:{sub:02X}", read)


def read_csp(whose: Whose) -> Part[Value]:
    """Whether it can do cyclic synchronous position."""
    modes = yield from _node(whose).read_if_there(protocol.MODES)
    return None if modes is None else bool(modes & protocol.CSP_SUPPORTED)


def read_rated_torque(whose: Whose) -> Part[Value]:
    """The motor's rated torque (N·m)."""
    return rounded((yield from _node(whose).read(RATED_TORQUE)) * 1e-3)


def read_counts(whose: Whose) -> Part[Value]:
    """Counts of its position for one turn of the motor, as feed constant and gear scale it."""
    node, parts = _node(whose), []
    for entry in (*FEED, *GEAR):
        parts.append((yield from node.read(entry)))
    counts, shaft_turns, motor_turns, gear_turns = parts
    return None if 0 in parts else rounded(counts / shaft_turns * gear_turns / motor_turns)


def state(whose: Whose) -> Part[State | None]:
    """Whether it answers, in which state it is, and where it stands."""
    node = _node(whose)
    device = yield from told(node.read(protocol.DEVICE_TYPE))
    if device is None:
        return None
    word = yield from told(node.read(protocol.STATUSWORD))
    before = yield from told(node.read(protocol.POSITION))
    here = yield from told(node.read(protocol.POSITION))
    supply_mv = yield from told(node.read_if_there(SUPPLY))
    power = None if word is None else setup.state_of(word)
    trouble = ""
    if power in (protocol.FAULT, protocol.FAULT_REACTION):
        trouble = setup.error_words((yield from told(node.read_if_there(protocol.ERROR_CODE))) or 0)
    per_turn = _drive(whose).counts_per_revolution
    still = max(setup.STANDING_COUNTS, STANDING_TURNS * per_turn)
    return State(
        trouble=trouble,
        moves=None if before is None or here is None else abs(here - before) > still,
        turns=None if here is None else here / per_turn,
        supply_v=None if supply_mv is None else rounded(supply_mv * 1e-3),
        known={"profile": device & 0xFFFF, "state": None if power is None else setup.state_words(power)},
    )


def store(whose: Whose) -> Part[str | None]:
    """Let the drive store all its parameters."""
    node = _node(whose)
    try:
        if not (yield from node.read(STORE)) & STORES_WHEN_TOLD:
            return "stores nothing when it is told to (object 1010:01)"
        node.require_written(STORE, SAVE, (yield from sent_once(writing(node.number, STORE, SAVE))))
    except Aborted as aborted:
        return f"does not store what it was told (object 1010:01): {abort_words(aborted.code)}"
    except DialogueFailed:
        return "does not say that it has stored what it was told"
    return None


def remarks(whose: Whose, found: Reading) -> list[str]:
    """A scale that is not the arm file's."""
    counts, wanted = found.values["counts_per_revolution"], _drive(whose).counts_per_revolution
    if not isinstance(counts, float) or _alike(counts, wanted):
        return []
    return [
        f"{whose.config.name}: feed constant and gear of its drive (objects 6092 and 6091) make {counts:g} counts of a "
        f"turn of the motor, the arm file {wanted}: one of the two is wrong, unless the maker scales by other objects."
    ]


def _alike(counts: float, wanted: int) -> bool:
    """Whether a scale is the wanted one, rounded."""
    return abs(counts - wanted) <= 1e-4 * wanted


TABLE = Table(
    rows=(
        Row("name", "object 1008", text(NAME)),
        Row("hardware", "object 1009", text(HARDWARE)),
        Row("firmware", "object 100A", text(FIRMWARE)),
        *(identity(name, sub) for sub, name in enumerate(("vendor", "product", "revision", "serial_number"), 1)),
        Row("profile", "object 1000, lower half", wanted=lambda whose: protocol.PROFILE),
        Row("state", "object 6041"),
        Row("csp", "object 6502, bit 7", read_csp, lambda whose: True),
        Row(
            "heartbeat_ms",
            "object 1017, at first mostly 0",
            value(protocol.HEARTBEAT_MS),
            named("heartbeat_ms"),
            lambda whose, wanted: _node(whose).write(protocol.HEARTBEAT_MS, wanted),
        ),
        Row("counts_per_revolution", "objects 6092 and 6091", read_counts),
        Row("rated_torque_nm", "object 6076", read_rated_torque, named("rated_torque_nm")),
        row("following_error_window", 0x6065, 0, 4),
        row("lower_limit", 0x607D, 1, 4, signed=True),
        row("upper_limit", 0x607D, 2, 4, signed=True),
        row("max_profile_velocity", 0x607F, 0, 4),
        row("max_motor_rpm", 0x6080, 0, 4),
        row("connection_lost", 0x6007, 0, 2, signed=True),
        row("quick_stop", 0x605A, 0, 2, signed=True),
    ),
    state=state,
    store=store,
    remarks=remarks,
)
new_reading, read, report_of, write = TABLE.new_reading, TABLE.read, TABLE.report_of, TABLE.write
