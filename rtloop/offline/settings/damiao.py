"""Settings of a Damiao motor: its registers (table of damiao-motor 1.0.6, damiao_motor/core/motor.py).

Registers are asked for and written over 7FF as at bring-up. AA stores all of them, of a limp motor only (the library's
`store_parameters`; the maker's manual). The feedback is asked for (CC), which moves nothing and feeds no alarm.
"""

import math
from collections.abc import Callable

from config.drives.damiao import DamiaoDrive
from rtloop.drives import damiao_protocol as protocol
from rtloop.drives import damiao_setup as setup
from rtloop.drives.asking import AskFrames
from rtloop.drives.damiao_protocol import Register
from rtloop.offline.settings.compare import Value, Verdict
from rtloop.offline.settings.table import (
    Reading,
    Row,
    State,
    Table,
    Whose,
    bitrate,
    named,
    not_named,
    number,
    rounded,
    sent_once,
    told,
    word,
)
from rtloop.service.conversation import Part

STORES_ALL = 1
"""The third byte behind AA."""

Write = Callable[[Whose, float], Part[object]]


def _drive(whose: Whose) -> DamiaoDrive:
    assert isinstance(whose.drive, DamiaoDrive)
    return whose.drive


def reads(register: Register) -> Callable[[Whose], Part[Value]]:
    """Reads a register."""

    def read(whose: Whose) -> Part[Value]:
        value = yield from setup.read_register(whose.joint, whose.config, register)
        return value if isinstance(value, int) else rounded(value)

    return read


def writes(register: Register) -> Write:
    """Writes a register."""
    return lambda whose, value: setup.write_register(whose.joint, whose.config, register, value)


def row(name: str, register: Register, called: str, wanted: Callable[[Whose], Value] = not_named) -> Row:
    """A register that is shown."""
    return Row(name, f"{register}, {called}", reads(register), wanted)


def reach(key: str, register: Register, name: str, at: int) -> Row:
    """What a field of the motor's frames reaches: the model says so, and is only written where the file names it."""
    return Row(
        key,
        f"{register}, {name}, above 0",
        reads(register),
        lambda whose: float(_drive(whose).ranges[at]),
        writes(register),
        may_write=lambda whose: named(key)(whose) is not None,
    )


def read_mode(whose: Whose) -> Part[Value]:
    """The mode's name."""
    code = yield from setup.read_register(whose.joint, whose.config, protocol.CONTROL_MODE)
    return word(int(code), {code: name for name, code in protocol.MODES.items()} | {3: "velocity", 4: "force_position"})


def write_mode(whose: Whose, mode: str) -> Part[object]:
    """Set the mode."""
    return setup.write_register(whose.joint, whose.config, protocol.CONTROL_MODE, protocol.MODES[mode])


def read_bitrate(whose: Whose) -> Part[Value]:
    """The bit rate."""
    code = yield from setup.read_register(whose.joint, whose.config, protocol.BIT_RATE)
    return protocol.BIT_RATES.get(int(code), f"code {code}")


def read_alarm(whose: Whose) -> Part[Value]:
    """After how much silence the motor lets go (ms)."""
    steps = yield from setup.read_register(whose.joint, whose.config, protocol.TIMEOUT)
    return rounded(steps * protocol.TIMEOUT_UNIT_S * 1e3)


def state(whose: Whose) -> Part[State | None]:
    """Its ID, which answers questions alone, then its feedback and its supply."""
    drive = _drive(whose)
    motor_id = yield from told(reads(protocol.ESC_ID)(whose))
    answer = None if motor_id is None else (yield setup.asked_feedback(whose.config))
    if answer is None:
        return None
    found = setup.feedback_of(answer.data, drive.ranges)
    standing_rad_s = setup.STANDING_STEPS * 2.0 * drive.ranges.rad_s / 0xFFF
    supply = yield from told(reads(protocol.SUPPLY_V)(whose))
    return State(
        trouble="" if found.code in (protocol.LIMP, protocol.ENABLED) else setup.status_words(found.code),
        moves=abs(found.rad_s) > standing_rad_s,
        turns=found.rad / (2.0 * math.pi),
        supply_v=supply if isinstance(supply, float) else None,
        holds=found.code == protocol.ENABLED,
        known={"motor_id": motor_id},
    )


def store(whose: Whose) -> Part[str | None]:
    """Store all registers."""
    frame = setup.registers(_drive(whose), protocol.STORE, {protocol.REGISTER: STORES_ALL})
    answer = yield from sent_once(AskFrames((frame,), lambda heard: heard.data[:3] == frame.data[:3]))
    return None if answer is not None else "does not say that it has stored what it was told"


def remarks(whose: Whose, found: Reading) -> list[str]:
    """What bring-up changes about its alarm, and what it would refuse of its ranges."""
    name, drive, sentences = whose.config.name, _drive(whose), []
    if found.values["alarm_ms"]:
        sentences.append(
            f"{name}: its drive lets go when it hears nothing for {found.values['alarm_ms']:g} ms; `rtarm up` sets "
            "that to none at each start, until its power is lost."
        )
    for row in RANGES:
        has = found.values[row.name]
        if not row.may_write(whose) and row.compared(whose, has).verdict is Verdict.DIFFERS:
            sentences.append(
                f"{name}: its drive has {has:g} for {row.name} ({row.where}), and a {drive.model} usually has "
                f"{row.wanted(whose):g}: name {row.name} in the arm file, as the drive has it or as it shall be."
            )
    return sentences


def hinders(whose: Whose, state: State) -> str:
    """An enabled motor neither stores nor changes what its frames mean."""
    if not state.holds:
        return ""
    return (
        "is enabled, and is only written to while it is limp: support the arm, let it go (`rtarm up`, then `rtarm "
        "disable`, or its power off and on), then run this again"
    )


RANGES = (
    reach("position_range_rad", protocol.PMAX, "PMAX", 0),
    reach("velocity_range_rad_s", protocol.VMAX, "VMAX", 1),
    reach("torque_range_nm", protocol.TMAX, "TMAX", 2),
)

TABLE = Table(
    rows=(
        row("firmware", protocol.VERSION, "sw_ver"),
        row("sub_version", protocol.SUB_VERSION, "sub_ver"),
        Row("motor_id", f"{protocol.ESC_ID}, ESC_ID", wanted=number),
        row("master_id", protocol.MASTER_ID, "MST_ID", lambda whose: _drive(whose).master_id),
        Row("bitrate", f"{protocol.BIT_RATE}, can_br", read_bitrate, bitrate),
        Row("mode", f"{protocol.CONTROL_MODE}, CTRL_MODE", read_mode, lambda w: _drive(w).mode, write_mode),
        *RANGES,
        Row("alarm_ms", f"{protocol.TIMEOUT}, TIMEOUT, in 50 µs, 0 for none", read_alarm),
        row("acceleration_rad_s2", protocol.ACC, "ACC, above 0"),
        row("deceleration_rad_s2", protocol.DEC, "DEC, below 0"),
        row("max_speed_rad_s", protocol.MOST_SPEED, "MAX_SPD, above 0"),
        row("position_gain", protocol.POSITION_GAIN, "KP_APR"),
        row("gear", protocol.GEAR, "Gr"),
        row("torque_constant", protocol.TORQUE_CONSTANT, "KT_Value"),
        row("under_voltage_v", protocol.UNDER_VOLTAGE_V, "UV_Value, above 10"),
        row("over_voltage_v", protocol.OVER_VOLTAGE_V, "OV_Value"),
        row("over_temperature_c", protocol.OVER_TEMPERATURE_C, "OT_Value, 80 to 200"),
        row("over_current_share", protocol.OVER_CURRENT_SHARE, "OC_Value, 0 to 1"),
    ),
    state=state,
    store=store,
    remarks=remarks,
    hinders=hinders,
)
new_reading, read, report_of, write = TABLE.new_reading, TABLE.read, TABLE.report_of, TABLE.write
