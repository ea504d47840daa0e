"""What can be made to go wrong with a simulated arm; each fault is a plain description.

Times are seconds after the arm's start, or after whatever moment `SimulatedArm.inject` is told. On the
command line a fault is written as its name and its fields: `silent:joint=joint2,at_s=3`,
`power-loss:joint=joint1,at_s=2,off_s=0.5`, `open-refused`.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields


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


Fault = Silent | PowerLoss | Stall | OpenRefused | SlowReplies | LostReplies | CorruptBytes

FAULTS: dict[str, type[Fault]] = {
    "silent": Silent,
    "power-loss": PowerLoss,
    "stall": Stall,
    "open-refused": OpenRefused,
    "slow-replies": SlowReplies,
    "lost-replies": LostReplies,
    "corrupt-bytes": CorruptBytes,
}


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
        if key == "joint":
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
