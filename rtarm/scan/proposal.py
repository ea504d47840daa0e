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


def proposal(entry: dict[str, Any]) -> str:
    """YAML for the adapter and drives of one entry of the report."""
    outcome = entry["outcome"]
    drives = outcome["drives"]
    lines = [
        "# Proposed by `rtarm scan`. Gears, directions and limits are not written in drives: fill in what is empty,",
        "# then `rtarm config check` this file. Until then it is refused, and nothing moves.",
    ]
    if [drive["address"] for drive in drives] == EPISODE1:
        lines += [
            "# If this is an Episode1 arm, copy config/arms/episode1.yaml instead, and take the section bus from here.",
        ]
    lines += ["schema_version: 1", "name: my_arm", "control:", "  rate_hz: 100", "bus:"]
    lines += [f"  interface: {entry['interface']}", f"  channel: {entry['channel']}"]
    if outcome["bitrate"] is not None:
        lines.append(f"  bitrate: {outcome['bitrate']}")
    if entry["serial_baud"] not in (None, "cdc"):
        lines.append(f"  serial_baud: {entry['serial_baud']}")
    lines.append("joints:")
    for number, drive in enumerate(drives, 1):
        microsteps = drive["microsteps"]
        lines += [
            f"  - name: joint{number}",
            f"    drive: {{family: zdt, address: {drive['address']}"
            + (f", microsteps: {microsteps}}}" if microsteps is not None else "}"),
        ]
        lines += [
            f"    {name}:{f'   # {meaning}' if number == 1 and meaning else ''}" for name, meaning in UNKNOWN.items()
        ]
    return "\n".join(lines) + "\n"
