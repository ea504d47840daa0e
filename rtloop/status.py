"""`shm.words.DriveStatus` as plain integers: jitted code combines bits, which it cannot do with enum members."""

from shm.words import DriveStatus

ENABLED = int(DriveStatus.ENABLED)
REACHED = int(DriveStatus.REACHED)
STALLED = int(DriveStatus.STALLED)
PROTECTED = int(DriveStatus.PROTECTED)
POWER_LOST = int(DriveStatus.POWER_LOST)
ANSWERED = int(DriveStatus.ANSWERED)
