"""The families of drives that can be simulated, one line each."""

from __future__ import annotations

from collections.abc import Callable

from sim.drives.cia402 import Cia402Drive
from sim.drives.damiao import DamiaoDrive
from sim.drives.drive import Drive, Mounting
from sim.drives.mks import MksDrive
from sim.drives.myactuator import MyactuatorDrive
from sim.drives.odrive import OdriveDrive
from sim.drives.robstride import RobstrideDrive
from sim.drives.vesc import VescDrive
from sim.drives.zdt import ZdtDrive

FAMILIES: dict[str, Callable[[Mounting], Drive]] = {
    "zdt": ZdtDrive.mounted,
    "odrive": OdriveDrive.mounted,
    "mks": MksDrive.mounted,
    "damiao": DamiaoDrive.mounted,
    "cia402": Cia402Drive.mounted,
    "myactuator": MyactuatorDrive.mounted,
    "robstride": RobstrideDrive.mounted,
    "vesc": VescDrive.mounted,
}
"""Makes the drive of a joint, by the family its configuration names."""
