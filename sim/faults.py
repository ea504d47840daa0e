"""What can be made to go wrong with a simulated arm; each fault is a plain description.

Times are seconds after the arm's start, or after whatever moment `SimulatedArm.inject` is told. On the
command line a fault is written as its name and its fields: `silent:joint=joint2,at_s=3`,
`power-loss:joint=joint1,at_s=2,off_s=0.5`, `protection:joint=joint4,at_s=1,cause=temperature`, `open-refused`.

What is *not* here: bus-off and error-passive, which an SLCAN adapter tells only when asked (`F`), and an adapter
that is pulled out, which is the terminal's end and not the arm's.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from typing import Literal


@dataclass(frozen=True)
class Silent:
    """The CAN plug of a drive comes loose: it neither hears nor answers, and carries on."""

    joint: str
    at_s: float
    until_s: float | None = None


@dataclass(frozen=True)
class PowerLoss:
    """A drive loses its supply for a while, then counts from zero where it is (zdt-emm-v5.md 9.8)."""

    joint: str
    at_s: float
    off_s: float = 0.5


@dataclass(frozen=True)
class Stall:
    """Something holds a shaft still from then on."""

    joint: str
    at_s: float


@dataclass(frozen=True)
class Thing:
    """Something stands between the gripper's fingers: closing, they stop at `deg`. Until `until_s`, then it is gone."""

    at_s: float
    deg: float
    until_s: float | None = None


@dataclass(frozen=True)
class OpenRefused:
    """The adapter answers BEL when the channel is opened."""


@dataclass(frozen=True)
class SlowReplies:
    """Answers come later by `extra_s` plus up to `jitter_s`; of one drive, or of all."""

    extra_s: float
    jitter_s: float = 0.0
    at_s: float = 0.0
    joint: str | None = None


@dataclass(frozen=True)
class LostReplies:
    """A share of the answers (0 to 1) never leaves its drive; of one drive, or of all."""

    share: float
    at_s: float = 0.0
    joint: str | None = None


@dataclass(frozen=True)
class CorruptBytes:
    """In a share of the bytes (0 to 1) from the adapter to the host one bit is flipped."""

    share: float
    at_s: float = 0.0


@dataclass(frozen=True)
class DuplicateReplies:
    """A share of the frames (0 to 1) reaches the host twice, the second time `gap_s` later."""

    share: float
    gap_s: float = 0.0
    at_s: float = 0.0
    joint: str | None = None


@dataclass(frozen=True)
class LateReplies:
    """A share of the frames (0 to 1) reaches the host `late_s` late, behind younger ones: out of order."""

    share: float
    late_s: float
    at_s: float = 0.0
    joint: str | None = None


@dataclass(frozen=True)
class CutLines:
    """A share of the lines to the host breaks off in the middle; the rest comes `rest_s` later, or never."""

    share: float
    rest_s: float | None = None
    at_s: float = 0.0
    joint: str | None = None


@dataclass(frozen=True)
class WrongChecksums:
    """A share of the answers (0 to 1) ends in another byte than 6B; of one drive, or of all."""

    share: float
    at_s: float = 0.0
    joint: str | None = None


@dataclass(frozen=True)
class WrongValues:
    """A share of the position answers (0 to 1) is whole but wrong, by up to `most_deg` of the joint."""

    share: float
    most_deg: float
    at_s: float = 0.0
    joint: str | None = None


@dataclass(frozen=True)
class Babble:
    """A node sends without a pause: with the highest priority there is, or with the answers of a drive's id.

    With a joint it repeats the position that drive would have answered when it began.
    """

    at_s: float
    until_s: float | None = None
    joint: str | None = None


@dataclass(frozen=True)
class ReceiveStall:
    """The adapter passes nothing on for a while: it keeps `depth` frames and loses the rest, then says what it kept."""

    at_s: float
    stall_s: float
    depth: float = 64


@dataclass(frozen=True)
class TransmitOverflow:
    """The adapter's transmit buffer holds only `depth` frames: what does not fit is lost and answered BEL."""

    depth: float
    at_s: float
    until_s: float | None = None


@dataclass(frozen=True)
class Bels:
    """A share of the frames the host hands over (0 to 1) is answered BEL and not sent."""

    share: float
    at_s: float = 0.0


@dataclass(frozen=True)
class SerialBlocked:
    """The adapter takes no more characters from the host: what is written waits, then does not fit."""

    at_s: float
    until_s: float | None = None


@dataclass(frozen=True)
class Protection:
    """A drive's protection trips and lets the shaft go; before `until_s` it cannot be cleared (zdt-emm-v5.md 4)."""

    joint: str
    at_s: float
    until_s: float | None = None
    cause: Literal["stall", "temperature", "current"] = "stall"


@dataclass(frozen=True)
class Disabled:
    """Somebody lets a drive go, at its menu or its En input."""

    joint: str
    at_s: float


@dataclass(frozen=True)
class Refusing:
    """A drive refuses every motion command (E2) although its flags say nothing; what it was told before it finishes."""

    joint: str
    at_s: float
    until_s: float | None = None


@dataclass(frozen=True)
class CountSlip:
    """A drive's count jumps by `deg` of the joint although the shaft does not."""

    joint: str
    at_s: float
    deg: float


@dataclass(frozen=True)
class CountWrap:
    """A drive's count passes the end of its 32 bits: from then it reads 2^32 less."""

    joint: str
    at_s: float


@dataclass(frozen=True)
class SameAddress:
    """A second drive with a joint's address appears on the bus; its shaft is no joint of the arm."""

    joint: str
    at_s: float


@dataclass(frozen=True)
class KeepsSettings:
    """A drive says that it took new settings, and keeps its own."""

    joint: str
    at_s: float = 0.0


@dataclass(frozen=True)
class ForeignFirmware:
    """A drive tells a longer configuration block, as one with X firmware may (zdt-emm-v5.md 7)."""

    joint: str
    at_s: float = 0.0


Fault = (
    Silent
    | PowerLoss
    | Stall
    | Thing
    | OpenRefused
    | SlowReplies
    | LostReplies
    | CorruptBytes
    | DuplicateReplies
    | LateReplies
    | CutLines
    | WrongChecksums
    | WrongValues
    | Babble
    | ReceiveStall
    | TransmitOverflow
    | Bels
    | SerialBlocked
    | Protection
    | Disabled
    | Refusing
    | CountSlip
    | CountWrap
    | SameAddress
    | KeepsSettings
    | ForeignFirmware
)

FAULTS: dict[str, type[Fault]] = {
    "silent": Silent,
    "power-loss": PowerLoss,
    "stall": Stall,
    "thing": Thing,
    "open-refused": OpenRefused,
    "slow-replies": SlowReplies,
    "lost-replies": LostReplies,
    "corrupt-bytes": CorruptBytes,
    "duplicate-replies": DuplicateReplies,
    "late-replies": LateReplies,
    "cut-lines": CutLines,
    "wrong-checksums": WrongChecksums,
    "wrong-values": WrongValues,
    "babble": Babble,
    "receive-stall": ReceiveStall,
    "transmit-overflow": TransmitOverflow,
    "bels": Bels,
    "serial-blocked": SerialBlocked,
    "protection": Protection,
    "disabled": Disabled,
    "refusing": Refusing,
    "count-slip": CountSlip,
    "count-wrap": CountWrap,
    "same-address": SameAddress,
    "keeps-settings": KeepsSettings,
    "foreign-firmware": ForeignFirmware,
}

WORDS: dict[str, tuple[str, ...] | None] = {"joint": None, "cause": ("stall", "temperature", "current")}
"""Fields that are no numbers, and what they may be."""


def parse_fault(text: str) -> Fault:
    """Read a fault written as on the command line.

    Raises:
        ValueError: with a sentence saying what is allowed.
    """
    name, _, rest = text.partition(":")
    kind = FAULTS.get(name)
    if kind is None:
        raise ValueError(f"there is no fault {name!r}; choose one of {', '.join(FAULTS)}.")
    known = [field.name for field in fields(kind)]
    values: dict[str, str | float] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in known:
            allowed = ", ".join(known) or "nothing"
            raise ValueError(f"fault {name} knows no field {key!r}; it takes {allowed}.")
        if key in WORDS:
            choice = WORDS[key]
            if choice is not None and value not in choice:
                raise ValueError(f"{key} of fault {name} is {value!r}, but must be one of {', '.join(choice)}.")
            values[key] = value
            continue
        try:
            values[key] = float(value)
        except ValueError:
            raise ValueError(f"{key} of fault {name} is {value!r}, but must be a number.") from None
    missing = [field.name for field in fields(kind) if field.default is MISSING and field.name not in values]
    if missing:
        raise ValueError(f"fault {name} needs {' and '.join(missing)}; write {missing[0]}=VALUE.")
    return kind(**values)  # type: ignore[arg-type]
