"""What a drive says of itself, in words for people: the status bits that all families share."""

from shm.words import DriveStatus

WORDS: dict[DriveStatus, str] = {
    DriveStatus.ENABLED: "enabled",
    DriveStatus.REACHED: "reached",
    DriveStatus.STALLED: "stalled",
    DriveStatus.PROTECTED: "protected",
    DriveStatus.POWER_LOST: "power lost",
    DriveStatus.ANSWERED: "answered",
    DriveStatus.OVER_CURRENT: "over-current",
    DriveStatus.OVER_VOLTAGE: "over-voltage",
    DriveStatus.UNDER_VOLTAGE: "under-voltage",
    DriveStatus.OVER_TEMPERATURE: "over-temperature",
    DriveStatus.ENCODER: "encoder error",
    DriveStatus.COMMUNICATION: "communication lost",
}
CLASSES = (
    DriveStatus.OVER_CURRENT
    | DriveStatus.OVER_VOLTAGE
    | DriveStatus.UNDER_VOLTAGE
    | DriveStatus.OVER_TEMPERATURE
    | DriveStatus.ENCODER
    | DriveStatus.COMMUNICATION
)
"""Why a drive has an error, or warns of one, where it tells."""
TROUBLE = DriveStatus.STALLED | DriveStatus.PROTECTED | DriveStatus.POWER_LOST | CLASSES
"""All that should not be."""
HELPLESS = DriveStatus.STALLED | DriveStatus.PROTECTED | DriveStatus.POWER_LOST | DriveStatus.COMMUNICATION
"""That of it with which a drive does not do what it is told; with the rest alone it only warns."""
_REFUSES = "it refuses motion"


def words_of(status: int) -> list[str]:
    """Each bit in words, known ones only."""
    return [words for bit, words in WORDS.items() if status & bit]


def troubles_of(status: int) -> list[str]:
    """Those of them that should not be."""
    return words_of(status & TROUBLE)


def fault_words(status: int) -> str:
    """Why a drive's status is a fault."""
    found = troubles_of(status)
    if not status & DriveStatus.ENABLED:
        found.append("not enabled")
    return ", ".join(found) or _REFUSES
