"""Comparison of a ZDT (Emm_V5) drive's settings with the arm file; the functions of `talk.SettingsFile`."""

from __future__ import annotations

from dataclasses import asdict, replace

from config.bus import BusConfig
from config.drives.zdt import FULL_STEPS_PER_REVOLUTION, ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.zdt_ask import addressed
from rtloop.drives.zdt_protocol import Block
from rtloop.offline.settings import zdt_talk
from rtloop.offline.settings.compare import DriveReport, Setting, compared
from rtloop.offline.settings.zdt_talk import Reading
from rtloop.service.conversation import Dialogue, Part

new_reading = Reading


def read(arm: ArmConfig, joint: int, found: Reading) -> Dialogue:
    """Read a drive's settings; see `talk.SettingsFile`."""
    return addressed(arm.joints[joint].drive.number, zdt_talk.read(found))


def write(arm: ArmConfig, joint: int, found: Reading, settings: list[Setting], store: bool) -> Part[str | None]:
    """Write settings; see `talk.SettingsFile`."""
    assert found.block is not None  # a drive without one is left alone
    wanted = {setting.name: setting for setting in settings}
    watchdog = wanted.pop("watchdog_ms", None)
    block = wanted_block(found.block, list(wanted.values())) if wanted else None
    watchdog_ms = None if watchdog is None else int(watchdog.wanted or 0)
    return addressed(arm.joints[joint].drive.number, zdt_talk.write(block, watchdog_ms, store))


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
        else {**asdict(found.homing), "mode": _named(protocol.HOMING_MODES, found.homing.mode)},
        trip=None if found.trip is None else asdict(found.trip),
        settings=[] if version is None else _settings(arm.bus_of(config), drive, found),
        left_alone=_left_alone(arm, config, drive, found, shared),
        notes=[] if block is None else _notes(config, found),
    )


def _settings(bus: BusConfig, drive: ZdtDrive, found: Reading) -> list[Setting]:
    version, block = found.version, found.block
    assert version is not None
    settings = [compared("firmware", drive.firmware if drive.firmware != "auto" else None, str(version))]
    if block is None:
        return settings
    named = drive.model_fields_set
    response = ("receive" if bus.acknowledge else "none") if "acknowledge" in bus.model_fields_set else None
    settings += [
        compared("address", drive.address, block.address),
        compared("bitrate", bus.bitrate, block.bitrate),
        compared("checksum", protocol.CHECKSUMS[0], _named(protocol.CHECKSUMS, block.checksum)),
        compared("response", response, _named(protocol.RESPONSES, block.response), writable=True),
        compared("microsteps", drive.microsteps if "microsteps" in named else None, block.microsteps, writable=True),
        compared("current_ma", drive.current_ma, block.current_ma, writable=True),
        compared(
            "stall_protection",
            None if drive.stall_protection is None else protocol.STALL_MODES[drive.stall_protection],
            _named(protocol.STALL_MODES, block.stall_mode),
            writable=True,
        ),
        compared("stall_rpm", drive.stall_rpm, block.stall_rpm, writable=True),
        compared("stall_current_ma", drive.stall_current_ma, block.stall_current_ma, writable=True),
        compared("stall_time_ms", drive.stall_time_ms, block.stall_time_ms, writable=True),
    ]
    if version.newer or drive.watchdog_ms is not None:
        writable = found.watchdog_ms is not None
        settings.append(compared("watchdog_ms", drive.watchdog_ms, found.watchdog_ms, writable=writable))
    return settings


def _named(names: tuple[str, ...], code: int) -> str:
    return names[code] if code < len(names) else f"code {code}"


def _left_alone(arm: ArmConfig, config: JointConfig, drive: ZdtDrive, found: Reading, shared: int | None) -> list[str]:
    """Reasons why a drive is not written to: what is not understood is not changed."""
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
            f"{who} does not answer: check its power, its address and the bit rate ({arm.bus_of(config).bitrate} "
            "bit/s) in its menu, and the CAN wires with 120 Ω at both ends; `rtarm scan` looks for it elsewhere."
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
    if found.flags is None or found.flags & protocol.PROTECTED:
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
    cause, remedy = protocol.trip_cause(found.homing_flags or 0)
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
    if found.flags is not None and found.flags & protocol.POWER_LOST:
        notes.append(f"{config.name}: its drive has lost power since its position was set; it is not referenced.")
    if drive.watchdog_ms and found.watchdog_ms is None:
        notes.append(f"{config.name}: its firmware has no watchdog, or does not tell it; watchdog_ms has no effect.")
    return notes


def wanted_block(block: Block, settings: list[Setting]) -> Block:
    """The block with the wanted values of `settings` put in."""
    changes: dict[str, int] = {}
    for setting in settings:
        wanted = setting.wanted
        if setting.name == "response":
            changes["response"] = protocol.RESPONSES.index(str(wanted))
        elif setting.name == "stall_protection":
            changes["stall_mode"] = protocol.STALL_MODES.index(str(wanted))
        elif setting.name == "microsteps":
            changes["microstep_code"] = int(wanted or 0) % 256
        elif setting.name != "watchdog_ms":
            changes[setting.name] = int(wanted or 0)
    return replace(block, **changes)
