"""`shm.words.DriveStatus` as plain integers: jitted code combines bits, which it cannot do with enum members."""

from shm.words import DriveStatus

ENABLED = int(DriveStatus.ENABLED)
REACHED = int(DriveStatus.REACHED)
STALLED = int(DriveStatus.STALLED)
PROTECTED = int(DriveStatus.PROTECTED)
POWER_LOST = int(DriveStatus.POWER_LOST)
ANSWERED = int(DriveStatus.ANSWERED)
OVER_CURRENT = int(DriveStatus.OVER_CURRENT)
OVER_VOLTAGE = int(DriveStatus.OVER_VOLTAGE)
UNDER_VOLTAGE = int(DriveStatus.UNDER_VOLTAGE)
OVER_TEMPERATURE = int(DriveStatus.OVER_TEMPERATURE)
ENCODER = int(DriveStatus.ENCODER)
COMMUNICATION = int(DriveStatus.COMMUNICATION)
