"""What the arm file wants of a drive's settings, beside what the drive says.

A setting is wanted only if the arm file (or an override) names it: defaults of the schema are shown, and a drive that
differs from one is told, but nothing is written that nobody has named.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

from config.drives.zdt import FULL_STEPS_PER_REVOLUTION, ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import zdt_registers as registers
from rtloop.drives.zdt_registers import Block
from rtloop.offline.settings.talk import Reading

STANDS_WITHIN_COUNTS = 200
"""About a degree of the motor: a closed loop that holds dithers by less."""
PROTECTED, POWER_LOST = 0x08, 0x80
"""Bits of `3A`."""

Value = int | str | bool | None


class Verdict(StrEnum):
    """How a setting of a drive stands to the arm file."""

    SAME = "same"
    DIFFERS = "differs"
    NOT_NAMED = "not named"  # by the arm file
    UNKNOWN = "unknown"  # the drive does not say it


@dataclass(frozen=True)
class Setting:
    """A setting of a drive: what the arm file wants and what the drive has."""

    name: str
    wanted: Value
    found: Value
    verdict: Verdict
    writable: bool
    """Whether `rtarm drives --write` may write it; id, bit rate and checksum are changed in the drive's own menu."""


@dataclass(frozen=True)
class DriveReport:
    """Everything known of one drive."""

    joint: str
    address: int
    answers: bool
    firmware: str | None
    hardware: int | None
    supply_v: float | None
    homing: dict[str, Any] | None
    trip: dict[str, Any] | None
    settings: list[Setting]
    left_alone: list[str]
    """Why nothing is written to this drive, a sentence each."""
    notes: list[str]
    """What is worth knowing besides, a sentence each."""

    @property
    def agrees(self) -> bool:
        """Whether the drive is as the arm file wants it."""
        fine = (Verdict.SAME, Verdict.NOT_NAMED)
        return self.answers and not self.left_alone and all(setting.verdict in fine for setting in self.settings)

    @property
    def to_write(self) -> list[Setting]:
        """The settings that differ and may be written."""
        if self.left_alone:
            return []
        return [s for s in self.settings if s.writable and s.verdict is Verdict.DIFFERS]


def as_json(report: DriveReport) -> dict[str, Any]:
    """A report as plain values."""
    return {**asdict(report), "agrees": report.agrees, "to_write": [setting.name for setting in report.to_write]}


def report_of(arm: ArmConfig, joint: int, found: Reading, shared: int | None = None) -> DriveReport:
    """Compare one drive with the arm file; `shared` is a joint whose address has more drives than one."""
    config = arm.joints[joint]
    drive = config.drive
    assert isinstance(drive, ZdtDrive)
    version, block = found.version, found.block
    return DriveReport(
        joint=config.name,
        address=drive.address,
        answers=version is not None,
        firmware=None if version is None else str(version),
        hardware=None if version is None else version.hardware,
        supply_v=None if found.supply_mv is None else found.supply_mv / 1000.0,
        homing=None
        if found.homing is None
        else {**asdict(found.homing), "mode": _named(registers.HOMING_MODES, found.homing.mode)},
        trip=None if found.trip is None else asdict(found.trip),
        settings=[] if version is None else _settings(arm, drive, found),
        left_alone=_left_alone(arm, config, drive, found, shared),
        notes=[] if block is None else _notes(config, found),
    )


def _settings(arm: ArmConfig, drive: ZdtDrive, found: Reading) -> list[Setting]:
    version, block = found.version, found.block
    assert version is not None
    settings = [_setting("firmware", drive.firmware if drive.firmware != "auto" else None, str(version))]
    if block is None:
        return settings
    named, bus = drive.model_fields_set, arm.bus
    response = ("receive" if bus.acknowledge else "none") if "acknowledge" in bus.model_fields_set else None
    settings += [
        _setting("address", drive.address, block.address),
        _setting("bitrate", bus.bitrate, block.bitrate),
        _setting("checksum", registers.CHECKSUMS[0], _named(registers.CHECKSUMS, block.checksum)),
        _setting("response", response, _named(registers.RESPONSES, block.response), writable=True),
        _setting("microsteps", drive.microsteps if "microsteps" in named else None, block.microsteps, writable=True),
        _setting("current_ma", drive.current_ma, block.current_ma, writable=True),
        _setting(
            "stall_protection",
            None if drive.stall_protection is None else registers.STALL_MODES[drive.stall_protection],
            _named(registers.STALL_MODES, block.stall_mode),
            writable=True,
        ),
        _setting("stall_rpm", drive.stall_rpm, block.stall_rpm, writable=True),
        _setting("stall_current_ma", drive.stall_current_ma, block.stall_current_ma, writable=True),
        _setting("stall_time_ms", drive.stall_time_ms, block.stall_time_ms, writable=True),
    ]
    if version.newer or drive.watchdog_ms is not None:
        writable = found.watchdog_ms is not None
        settings.append(_setting("watchdog_ms", drive.watchdog_ms, found.watchdog_ms, writable=writable))
    return settings


def _setting(name: str, wanted: Value, found: Value, *, writable: bool = False) -> Setting:
    if found is None:
        verdict = Verdict.NOT_NAMED if wanted is None else Verdict.UNKNOWN
    elif wanted is None:
        verdict = Verdict.NOT_NAMED
    else:
        verdict = Verdict.SAME if wanted == found else Verdict.DIFFERS
    return Setting(name, wanted, found, verdict, writable)


def _named(names: tuple[str, ...], code: int) -> str:
    return names[code] if code < len(names) else f"code {code}"


def _left_alone(arm: ArmConfig, config: JointConfig, drive: ZdtDrive, found: Reading, shared: int | None) -> list[str]:
    """Why a drive is not written to: what cannot be understood is not changed."""
    who = f"The drive of {config.name} (address {drive.address})"
    version, block = found.version, found.block
    if shared is not None and not found.shared_address:
        return [f"{who} was not heard clearly over the drives of {arm.joints[shared].name}, which share an address."]
    if found.other_checksum:
        return [
            f"{who} answers with another checksum than 6B, only that is spoken here: set Checksum to 0x6B in its menu."
        ]
    if found.shared_address:
        return [
            f"More than one drive answers at address {drive.address} of {config.name}: unplug all but one and give "
            "each an address of its own in its menu."
        ]
    if version is None:
        return [
            f"{who} does not answer: check its power, its address and the bit rate ({arm.bus.bitrate} bit/s) in its "
            "menu, and the CAN wires with 120 Ω at both ends; `rtarm scan` looks for it elsewhere."
        ]
    if found.other_block is not None:
        return [
            f"{who} has a configuration block of {found.other_block[0]} bytes and {found.other_block[1]} fields, and "
            "only Emm_V5's 33 and 21 are known here: it may run X firmware, which measures in tenths of a degree; "
            "switch it to Emm firmware in its menu before anything moves it."
        ]
    if block is None:
        return [f"{who} (firmware {version}) does not tell its configuration, so nothing of it is changed."]
    if not version.known:
        return [f"{who} has firmware {version}, and only 1.0.0 to 2.9.9 are known here, so nothing of it is changed."]
    reasons = []
    if block.checksum != 0:
        reasons.append(f"{who} is set to another checksum than 6B: set Checksum to 0x6B in its menu.")
    if found.flags is None or found.flags & PROTECTED:
        reasons.append(_in_protection(who, found))
    if found.rpm is None or found.position_counts is None:
        reasons.append(
            f"{who} does not say whether it stands, as two drives of one address or bad CAN wires would have it: "
            "look at both."
        )
    elif found.rpm != 0:
        reasons.append(f"{who} turns at {found.rpm} rpm: settings are only written while the arm stands.")
    return reasons


def _in_protection(who: str, found: Reading) -> str:
    if found.flags is None:
        return f"{who} does not tell its status, so nothing of it is changed."
    cause, remedy = registers.trip_cause(found.homing_flags or 0)
    return (
        f"{who} is in protection ({cause}) and holds nothing: {remedy}, bring the arm up and clear it with `rtarm "
        "clear-fault` first."
    )


def _notes(config: JointConfig, found: Reading) -> list[str]:
    block, notes = found.block, []
    assert block is not None
    drive = config.drive
    assert isinstance(drive, ZdtDrive)
    if block.full_steps != FULL_STEPS_PER_REVOLUTION:
        notes.append(
            f"{config.name}: its drive is set to another motor than one of 1.8° (code {block.motor_type:02X}): "
            "positions are reckoned for 200 full steps a turn, so set Motor type in its menu."
        )
    if "microsteps" not in drive.model_fields_set and block.microsteps != drive.microsteps:
        notes.append(
            f"{config.name}: its drive has {block.microsteps} microsteps, the arm file names none and counts on "
            f"{drive.microsteps}: name microsteps in the arm file."
        )
    if found.homing is not None and found.homing.at_power_up:
        notes.append(
            f"{config.name}: its drive homes by itself when it gets power, without anybody asking: turn that off in "
            "its menu."
        )
    if found.flags is not None and found.flags & POWER_LOST:
        notes.append(f"{config.name}: its drive has lost power since its position was set; it is not referenced.")
    if drive.watchdog_ms and found.watchdog_ms is None:
        notes.append(f"{config.name}: its firmware has no watchdog, or does not tell it; watchdog_ms has no effect.")
    return notes


def wanted_block(block: Block, settings: list[Setting]) -> Block:
    """The block with the wanted values in the place of those that differ."""
    changes: dict[str, int] = {}
    for setting in settings:
        wanted = setting.wanted
        if setting.name == "response":
            changes["response"] = registers.RESPONSES.index(str(wanted))
        elif setting.name == "stall_protection":
            changes["stall_mode"] = registers.STALL_MODES.index(str(wanted))
        elif setting.name == "microsteps":
            changes["microstep_code"] = int(wanted or 0) % 256
        elif setting.name != "watchdog_ms":
            changes[setting.name] = int(wanted or 0)
    return replace(block, **changes)


def has_moved(before: Reading, after: Reading) -> bool:
    """Whether a drive's position has changed between two readings, or cannot be told."""
    if before.position_counts is None or after.position_counts is None:
        return True
    return abs(after.position_counts - before.position_counts) > STANDS_WITHIN_COUNTS
