"""An arm file for the drives that were found; what no scan can know is left out, and the loader asks for it."""

from __future__ import annotations

from typing import Any

EPISODE1 = list(range(1, 7))

UNKNOWN = {
    "ratio": "motor turns for one turn of the joint",
    "direction": "1, or -1 when a positive motor angle turns the joint the negative way",
    "zero_deg": "joint = direction * m - zero_deg, m counted from the homing stop",
    "lower_deg": "the range the joint may move in",
    "upper_deg": "",
    "motor_rpm": "highest speed of the motor",
    "max_acceleration_rad_s2": "of the joint",
}
"""What a drive does not know, with what it means."""


UNHEARD_OF = {
    "odrive": "Whether an ODrive's encoder is absolute is not overheard: docs/hardware/drive-families.md says what to "
    "fill in.",
    "cia402": "A CANopen node need not be a drive. counts_per_revolution is not told: docs/hardware/drive-families.md.",
    "robstride": "Which RobStride it is, and in which mode it runs, is not told: docs/hardware/drive-families.md.",
    "myactuator": "Whether a MyActuator motor's encoder is absolute is not told: docs/hardware/drive-families.md.",
    "damiao": "Which Damiao motor it is, and in which mode it runs, is not asked: docs/hardware/drive-families.md.",
    "vesc": "Whether a VESC's encoder is absolute, and at which rates it sends what, is not told: "
    "docs/hardware/drive-families.md.",
    "mks": "An MKS drive forgets its angle without power: docs/hardware/drive-families.md.",
}
"""What a family's arm file needs beside what is heard of a drive."""


def _zdt(drive: dict[str, Any]) -> str:
    microsteps = drive["microsteps"]
    return f"family: zdt, address: {drive['address']}" + ("" if microsteps is None else f", microsteps: {microsteps}")


def _heard(drive: dict[str, Any]) -> str:
    return ", ".join(f"{name}: {value}" for name, value in {"family": drive["family"], **drive["settings"]}.items())


def proposal(entry: dict[str, Any]) -> str:
    """YAML for the adapter and drives of one entry of the report."""
    outcome = entry["outcome"]
    drives, heard = outcome["drives"], outcome["answered"] + outcome["overheard"]
    lines = [
        "# Proposed by `rtarm scan`. Gears, directions and limits are not written in drives: fill in what is empty,",
        "# then `rtarm config check` this file. Until then it is refused, and nothing moves.",
    ]
    if [drive["address"] for drive in drives] == EPISODE1:
        lines += [
            "# If this is an Episode1 arm, copy config/arms/episode1.yaml instead, and take the section bus from here.",
        ]
    lines += [f"# {sentence}" for sentence in sorted({UNHEARD_OF[one["family"]] for one in heard})]
    lines += ["schema_version: 1", "name: my_arm", "control:", "  rate_hz: 100", "bus:"]
    lines += [f"  interface: {entry['interface']}", f"  channel: {entry['channel']}"]
    if outcome["bitrate"] is not None:
        lines.append(f"  bitrate: {outcome['bitrate']}")
    if entry["serial_baud"] not in (None, "cdc"):
        lines.append(f"  serial_baud: {entry['serial_baud']}")
    lines.append("joints:")
    for number, drive in enumerate([*map(_zdt, drives), *map(_heard, heard)], 1):
        lines += [f"  - name: joint{number}", f"    drive: {{{drive}}}"]
        lines += [
            f"    {name}:{f'   # {meaning}' if number == 1 and meaning else ''}" for name, meaning in UNKNOWN.items()
        ]
    return "\n".join(lines) + "\n"
