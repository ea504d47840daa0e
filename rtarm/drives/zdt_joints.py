"""Which joints the tools can speak to that know the settings and the slow moves of ZDT drives alone."""

from __future__ import annotations

from collections.abc import Sequence

from config.drives.zdt import ZdtDrive
from config.schema import ArmConfig


def zdt_joints(arm: ArmConfig) -> list[int]:
    """Numbers of the joints that have a ZDT drive."""
    return [number for number, joint in enumerate(arm.joints) if isinstance(joint.drive, ZdtDrive)]


def other_drives(arm: ArmConfig, joints: Sequence[int]) -> str:
    """Whose drives are of which other family, such as `joint1 and joint2 (an ODrive axis)`; empty for none."""
    ours = zdt_joints(arm)
    kinds: dict[str, list[str]] = {}
    for number in joints:
        if number not in ours:
            kinds.setdefault(arm.joints[number].drive.called, []).append(arm.joints[number].name)
    return "; ".join(f"{_listed(names)} ({called})" for called, names in kinds.items())


def _listed(names: Sequence[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last
