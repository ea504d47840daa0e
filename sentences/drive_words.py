"""What a drive says of itself, in words for people: the status bits that all families share."""

from collections.abc import Iterable

from sentences.meaning import Language
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
CHINESE: dict[DriveStatus, str] = {
    DriveStatus.ENABLED: "已使能",
    DriveStatus.REACHED: "已到位",
    DriveStatus.STALLED: "堵转",
    DriveStatus.PROTECTED: "保护",
    DriveStatus.POWER_LOST: "断过电",
    DriveStatus.ANSWERED: "有应答",
    DriveStatus.OVER_CURRENT: "过流",
    DriveStatus.OVER_VOLTAGE: "过压",
    DriveStatus.UNDER_VOLTAGE: "欠压",
    DriveStatus.OVER_TEMPERATURE: "过温",
    DriveStatus.ENCODER: "编码器错误",
    DriveStatus.COMMUNICATION: "通信丢失",
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
_BITS: dict[Language, dict[DriveStatus, str]] = {"en": WORDS, "zh": CHINESE}
_NOT_ENABLED: dict[Language, str] = {"en": "not enabled", "zh": "未使能"}
_REFUSES: dict[Language, str] = {"en": "it refuses motion", "zh": "它拒绝运动"}
_BETWEEN: dict[Language, str] = {"en": ", ", "zh": "、"}


def words_of(status: int, language: Language = "en") -> list[str]:
    """Each bit in words, known ones only."""
    return [words for bit, words in _BITS[language].items() if status & bit]


def troubles_of(status: int, language: Language = "en") -> list[str]:
    """Those of them that should not be."""
    return words_of(status & TROUBLE, language)


def fault_words(status: int, language: Language = "en") -> str:
    """Why a drive's status is a fault."""
    found = troubles_of(status, language)
    if not status & DriveStatus.ENABLED:
        found.append(_NOT_ENABLED[language])
    return listed(found, language) or _REFUSES[language]


def listed(words: Iterable[str], language: Language = "en") -> str:
    """Words of the drives as a sentence lists them."""
    return _BETWEEN[language].join(words)
