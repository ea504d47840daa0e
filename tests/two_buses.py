"""Arms that come with rtarm, divided among two buses on which the same identifiers mean other joints."""

from pathlib import Path
from typing import Any

import yaml

from config.loader import load_arm
from config.schema import ArmConfig

NAMES = ("shoulder", "wrist")


def divided_values(name: str, bus: dict[str, Any] | None = None) -> dict[str, Any]:
    """What the arm's file says, its last three joints on a bus of their own with the first three's identifiers."""
    arm = load_arm(name)
    values = arm.model_dump(mode="json", exclude_unset=True)
    shared = {key: value for key, value in values["bus"].items() if key not in ("channel", "usb_index")} | (bus or {})
    values["bus"] = [
        {**shared, "name": of, "channel": f"can_{of}" if shared["interface"] == "socketcan" else f"/dev/tty{of}"}
        for of in NAMES
    ]
    joints = values["joints"]
    for joint in joints[:3]:
        joint["bus"] = NAMES[0]
    for joint, twin in zip(joints[3:], arm.joints[:3], strict=True):
        joint["bus"] = NAMES[1]
        given = twin.drive.model_dump(mode="json", exclude_unset=True)
        identifiers = {twin.drive.number_field, *(used.field for used in twin.drive.identifiers if used.field)}
        joint["drive"] |= {field: given[field] for field in identifiers if field in given}
    return values


def divided(name: str, bus: dict[str, Any] | None = None) -> ArmConfig:
    """The arm, checked."""
    return ArmConfig.model_validate(divided_values(name, bus))


def write_divided(name: str, file: Path, bus: dict[str, Any] | None = None, /, **changes: Any) -> Path:
    """The arm's file; `changes`: sections and fields that take the place of the arm's own."""
    file.write_text(yaml.safe_dump(divided_values(name, bus) | changes, sort_keys=False), encoding="utf-8")
    return file
