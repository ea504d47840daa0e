"""Arms whose drives are of several families."""

from collections.abc import Sequence
from typing import Any

from config.schema import ArmConfig

ZDT = {"family": "zdt", "microsteps": 16}
ODRIVE = {"family": "odrive", "encoder": "absolute", "estimates_ms": 0}
OWN_GEAR = ("robstride", "myactuator")


def arm_of(drives: Sequence[dict[str, Any]], *, rate_hz: float, interface: str = "slcan") -> ArmConfig:
    """An arm whose joints differ only in their drives and move alike; motors with a gear of their own have no other."""
    joint = {"lower_deg": -90, "upper_deg": 90, "max_acceleration_rad_s2": 2.0}
    geared = {"ratio": 25, "motor_rpm": 100}
    direct = {"ratio": 1, "motor_rpm": 4}
    return ArmConfig.model_validate(
        {
            "name": "mixed",
            "control": {"rate_hz": rate_hz},
            "bus": {"interface": interface, "channel": "can0", "bitrate": 1_000_000},
            "joints": [
                {
                    "name": f"joint{number}",
                    "drive": drive,
                    **joint,
                    **(direct if drive["family"] in OWN_GEAR else geared),
                }
                for number, drive in enumerate(drives, 1)
            ],
        }
    )


def mixed() -> ArmConfig:
    """ZDT and ODrive in turn."""
    drives = [{**ZDT, "address": n} if n % 2 else {**ODRIVE, "node_id": n} for n in range(1, 7)]
    return arm_of(drives, rate_hz=150)
