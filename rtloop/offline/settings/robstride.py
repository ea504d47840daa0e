"""Settings of a RobStride motor or CyberGear: parameters that type 17 reads (the maker's manuals of 2026, 4.1.14, in
RobStride/Product_Information, and the CyberGear's; a CyberGear has none above 7020).

Type 18 writes to volatile memory. Type 22 lets a RobStride store what it has (4.1.9), but sets the bit rate of a
CyberGear, so it is sent to motors of mode csp alone, which CyberGears do not have.

Two questions are not asked. The version's (4.1.4) is a stop, type 4, to firmware that does not know it, and the joint
would fall. And the faults come with feedback only, which answers commands; bring-up reads it.
"""

import math
from collections.abc import Callable

from config.drives.robstride import TYPE_BIT, RobstrideDrive
from rtloop.drives import robstride_protocol as protocol
from rtloop.drives import robstride_setup as setup
from rtloop.drives.asking import AskFrames
from rtloop.drives.numbers import unpacked
from rtloop.offline.settings.compare import Value
from rtloop.offline.settings.table import Reading, Row, State, Table, Whose, named, rounded, sent_once, told, word
from rtloop.service.conversation import Part
from rtloop.service.port import Frame

SAVE, SAVE_DATA = 22, bytes(range(1, 9))
COUNTS = {0: "0 to 2π", 1: "-π to π"}
"""What zero_sta says of the count after power came."""


def _drive(whose: Whose) -> RobstrideDrive:
    assert isinstance(whose.drive, RobstrideDrive)
    return whose.drive


def parameter(whose: Whose, index: int) -> Part[bytes]:
    """The data of the answer about a parameter."""
    return setup.read_parameter(whose.joint, whose.config, index, f"parameter {index:X}")


def single(index: int) -> Callable[[Whose], Part[Value]]:
    """Reads a parameter that is a fraction."""

    def read(whose: Whose) -> Part[Value]:
        return rounded(unpacked((yield from parameter(whose, index)), protocol.VALUE))

    return read


def read_mode(whose: Whose) -> Part[Value]:
    """The run mode's name."""
    code = unpacked((yield from parameter(whose, protocol.RUN_MODE)), protocol.BYTE)
    return word(code, {code: name for name, code in protocol.RUN_MODES.items()} | {2: "velocity", 3: "current"})


def read_timeout(whose: Whose) -> Part[Value]:
    """After how much silence the motor lets go (ms)."""
    return rounded(
        unpacked((yield from parameter(whose, protocol.TIMEOUT)), protocol.WHOLE) * protocol.TIMEOUT_UNIT_S * 1e3
    )


def read_count(whose: Whose) -> Part[Value]:
    """What it counts after power came."""
    return word(unpacked((yield from parameter(whose, protocol.ZERO_STA)), protocol.BYTE), COUNTS)


def wanted_count(whose: Whose) -> Value:
    """What an absolute encoder must count from power on, so that it counts the joint's range; None if any will do."""
    config, drive = whose.config, _drive(whose)
    if drive.encoder != "absolute" or drive.mode != "csp":
        return None
    ends = [config.direction * (rad + config.zero_rad) * config.ratio for rad in (config.lower_rad, config.upper_rad)]
    return COUNTS[1] if min(ends) < 0.0 else COUNTS[0] if max(ends) > math.pi else None


def state(whose: Whose) -> Part[State | None]:
    """Where it stands and how fast it turns."""
    rad = yield from told(single(protocol.POSITION)(whose))
    if not isinstance(rad, float):
        return None
    rad_s = yield from told(single(protocol.VELOCITY)(whose))
    volts = yield from told(single(protocol.VOLTAGE)(whose))
    return State(
        moves=abs(rad_s) > setup.STANDING_RAD_S if isinstance(rad_s, float) else None,
        turns=rad / (2.0 * math.pi),
        supply_v=volts if isinstance(volts, float) else None,
    )


def write_gain(whose: Whose, gain_1_s: float) -> Part[object]:
    """Set the gain of the position loop."""
    return setup.write_parameter(whose.joint, whose.config, protocol.POSITION_GAIN, gain_1_s)


def store(whose: Whose) -> Part[str | None]:
    """Let a RobStride store its parameters."""
    drive = _drive(whose)
    frame = Frame(SAVE << TYPE_BIT | drive.host_id << 8 | drive.motor_id, SAVE_DATA)
    answer = yield from sent_once(AskFrames((frame,), setup.is_feedback))
    return None if answer is not None else "does not say that it has stored what it was told"


def remarks(whose: Whose, found: Reading) -> list[str]:
    """A timeout that would let the joint fall."""
    timeout_ms = found.values["can_timeout_ms"]
    if not timeout_ms:
        return []
    return [
        f"{whose.config.name}: its drive lets go when it hears nothing for {timeout_ms:g} ms (parameter 7028), also "
        "when rtarm ends in order: set that to 0 with the maker's program."
    ]


TABLE = Table(
    rows=(
        Row("mode", "parameter 7005, run_mode", read_mode),
        Row(
            "position_gain_1_s",
            "parameter 701E, loc_kp",
            single(protocol.POSITION_GAIN),
            named("position_gain_1_s"),
            write_gain,
            may_write=lambda whose: _drive(whose).mode == "csp",
        ),
        Row("counts_from_power", "parameter 7029, zero_sta, 0 or 1, at first 0", read_count, wanted_count),
        Row("zero_offset_rad", "parameter 702B, add_offset, at first 0", single(protocol.ZERO_OFFSET)),
        Row("torque_limit_nm", "parameter 700B, limit_torque", single(protocol.TORQUE_LIMIT)),
        Row("current_limit_a", "parameter 7018, limit_cur", single(protocol.CURRENT_LIMIT)),
        Row("speed_limit_rad_s", "parameter 7017, limit_spd", single(protocol.SPEED_LIMIT)),
        Row("can_timeout_ms", "parameter 7028, canTimeout, in 50 µs, at first 0 for none", read_timeout),
    ),
    state=state,
    store=store,
    remarks=remarks,
)
new_reading, read, report_of, write = TABLE.new_reading, TABLE.read, TABLE.report_of, TABLE.write
