"""What one control cycle puts on the bus and on the serial line to the adapter, and whether it fits.

Everything is worst case: bit stuffing at its most, every frame of the cycle sent. Frame lengths follow
from the CAN 2.0 frame format, the three bits between frames included (`config.frames`); the frames of a cycle from
what the drives' families say; bytes on a serial line from `config.serial_adapters`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from config.bus import HIGHEST_CAN_BITRATE, SERIAL_BAUDS, BusConfig
from config.drives.drive import Drive
from config.errors import ConfigError
from config.frames import ADAPTER_FRAMES, CycleFrames, PeriodicFrames
from config.gripper import MOVING_POLL_HZ
from config.schema import ArmConfig
from config.sections import ControlConfig
from config.serial_adapters import SERIAL_ADAPTERS, SerialAdapter

UART_BITS_PER_CHARACTER = 10
"""Start bit, eight data bits, stop bit."""

UART_LOAD_LIMIT = 0.95
"""Share of a UART's speed that the cycle may plan with."""

HIGHEST_BITRATE = HIGHEST_CAN_BITRATE
"""The fastest bus there is (bit/s); an SLCAN adapter offers it too."""

LOWEST_RATE_HZ = float(
    next(bound.ge for bound in ControlConfig.model_fields["rate_hz"].metadata if hasattr(bound, "ge"))
)
"""The lowest control rate the schema allows (Hz)."""


def cycle_of(drives: Sequence[Drive], bus: BusConfig) -> tuple[CycleFrames, ...]:
    """The frames of one control cycle with these drives, alike ones counted together.

    Each drive's own, one drive's in turn (the most that any of them needs), and those a family has in common.
    """
    found = [frames for drive in drives for frames in (*drive.commands(bus), *drive.readings(bus))]
    turns = [drive.in_turn(bus) for drive in drives]
    found += max(turns, key=lambda turn: sum(frames.bits for frames in turn), default=())
    families = {drive.family: drive for drive in drives}
    found += [frames for drive in families.values() for frames in drive.for_all(bus)]
    counts: dict[CycleFrames, int] = {}
    for frames in found:
        alike = replace(frames, count=1)
        counts[alike] = counts.get(alike, 0) + frames.count
    return tuple(replace(frames, count=count) for frames, count in counts.items())


def cycle_frames(arm: ArmConfig) -> tuple[CycleFrames, ...]:
    """The frames of one control cycle of an arm with one bus; none with mock drives."""
    return cycle_of([joint.drive for joint in arm.joints], arm.bus)


def frames_beside(arm: ArmConfig) -> tuple[PeriodicFrames, ...]:
    """What is on the bus beside the cycle, at rates of its own: what drives send by themselves, and a gripper's."""
    drives = tuple(frames for joint in arm.joints for frames in joint.drive.by_itself())
    return (*drives, *(PeriodicFrames(frames, MOVING_POLL_HZ, "the gripper") for frames in gripper_frames(arm)))


def gripper_frames(arm: ArmConfig) -> tuple[CycleFrames, ...]:
    """What is asked of a gripper's servo `MOVING_POLL_HZ` times a second; none without one.

    Position and status as in a cycle; where its current is measured too (27, answered with 4 bytes), that and the
    status take turns, and the longer of the two is counted. A motion's own command is sent once and not counted.
    """
    if arm.gripper is None or arm.gripper.servo is None:
        return ()
    turn_bytes = 3 if arm.gripper.servo.nm_per_ampere is None else 4
    return (
        CycleFrames("gripper's position request", 1, 2, from_host=True),
        CycleFrames("gripper's position reply", 1, 7, from_host=False),
        CycleFrames("gripper's status or current request", 1, 2, from_host=True),
        CycleFrames("gripper's status or current reply", 1, turn_bytes, from_host=False),
    )


@dataclass(frozen=True)
class Budget:
    """The load of one arm's control cycle on its bus and on its serial line, a gripper's beside it included."""

    frames: tuple[CycleFrames, ...]
    rate_hz: float
    bitrate: int
    load_limit: float
    serial_baud: int | None
    """Speed of the UART to the adapter; None where no UART limits (USB device, mock)."""
    beside: tuple[PeriodicFrames, ...] = ()
    """Frames at rates of their own."""
    adapter: SerialAdapter = SERIAL_ADAPTERS["slcan"]
    """The adapter of the serial line, where there is one."""

    @property
    def beside_words(self) -> str:
        """What the frames beside the cycle are for, in sentences."""
        return " and ".join(dict.fromkeys(beside.whose for beside in self.beside))

    @property
    def bits_beside_s(self) -> float:
        """Worst-case bits a second on the bus beside the cycle."""
        return sum(beside.rate_hz * beside.frames.bits for beside in self.beside)

    @property
    def frames_per_cycle(self) -> int:
        """Frames on the bus in one cycle."""
        return sum(frames.count for frames in self.frames)

    @property
    def bits_per_cycle(self) -> int:
        """Worst-case bits on the bus in one cycle."""
        return sum(frames.bits for frames in self.frames)

    @property
    def bus_load(self) -> float:
        """Share of the bit rate that the cycle uses at the control rate."""
        return (self.bits_per_cycle * self.rate_hz + self.bits_beside_s) / self.bitrate

    @property
    def bus_highest_rate_hz(self) -> float:
        """Highest control rate within the load limit (Hz); infinite without frames."""
        if self.bits_per_cycle == 0:
            return math.inf
        return (self.bitrate * self.load_limit - self.bits_beside_s) / self.bits_per_cycle

    @property
    def chars_out_per_cycle(self) -> int:
        """Bytes from the host to a serial adapter in one cycle."""
        return _chars_out(self.frames, self.adapter)

    @property
    def chars_in_per_cycle(self) -> int:
        """Bytes from a serial adapter to the host in one cycle, replies to transmitted frames included."""
        return _chars_in(self.frames, self.adapter)

    @property
    def serial_bits_beside_s(self) -> float:
        """Bits a second beside the cycle in their busier direction, which is taken to be the cycle's too."""
        out = sum(beside.rate_hz * _chars_out((beside.frames,), self.adapter) for beside in self.beside)
        back = sum(beside.rate_hz * _chars_in((beside.frames,), self.adapter) for beside in self.beside)
        return UART_BITS_PER_CHARACTER * max(out, back)

    @property
    def serial_bits_per_cycle(self) -> int:
        """Bits of the busier direction in one cycle; a UART carries both directions at once."""
        return UART_BITS_PER_CHARACTER * max(self.chars_out_per_cycle, self.chars_in_per_cycle)

    @property
    def serial_baud_needed(self) -> float:
        """Slowest UART that carries the cycle within its limit (baud)."""
        return (self.serial_bits_per_cycle * self.rate_hz + self.serial_bits_beside_s) / UART_LOAD_LIMIT

    @property
    def serial_load(self) -> float | None:
        """Share of the UART that the busier direction uses; None where no UART limits."""
        if self.serial_baud is None:
            return None
        return (self.serial_bits_per_cycle * self.rate_hz + self.serial_bits_beside_s) / self.serial_baud

    @property
    def serial_highest_rate_hz(self) -> float:
        """Highest control rate that the UART carries (Hz); infinite where no UART limits."""
        if self.serial_baud is None or self.serial_bits_per_cycle == 0:
            return math.inf
        return (self.serial_baud * UART_LOAD_LIMIT - self.serial_bits_beside_s) / self.serial_bits_per_cycle

    @property
    def highest_rate_hz(self) -> float:
        """Highest control rate that fits bus and serial line (Hz); infinite without a bus."""
        return min(self.bus_highest_rate_hz, self.serial_highest_rate_hz)

    @property
    def fits(self) -> bool:
        """The control rate is one that bus and serial line carry."""
        return self.rate_hz <= self.highest_rate_hz


def _chars_out(frames: tuple[CycleFrames, ...], adapter: SerialAdapter) -> int:
    return sum(adapter.bytes_of(kind) for kind in frames if kind.from_host)


def _chars_in(frames: tuple[CycleFrames, ...], adapter: SerialAdapter) -> int:
    received = sum(adapter.bytes_of(kind) for kind in frames if not kind.from_host)
    return received + adapter.reply_bytes * sum(kind.count for kind in frames if kind.from_host)


def budget(arm: ArmConfig) -> Budget:
    """The load of the arm's control cycle at its control rate; of several buses', that of the tightest one."""
    return min(budgets(arm), key=lambda found: found.highest_rate_hz)


def budgets(arm: ArmConfig) -> list[Budget]:
    """The load of the arm's control cycle on each of its buses."""
    return [_of_one_bus(part) for part in arm.parts]


def _of_one_bus(arm: ArmConfig) -> Budget:
    baud = arm.bus.serial_baud
    adapter = SERIAL_ADAPTERS.get(arm.bus.interface)
    return Budget(
        frames=cycle_frames(arm),
        rate_hz=arm.control.rate_hz,
        bitrate=arm.bus.bitrate,
        load_limit=arm.bus.load_limit,
        serial_baud=None if baud == "cdc" or adapter is None else baud,
        beside=frames_beside(arm),
        adapter=adapter or SERIAL_ADAPTERS["slcan"],
    )


def check_budget(arm: ArmConfig) -> Budget:
    """The budget (`budget`) of an arm whose rate fits.

    Raises:
        ConfigError: a bus, its serial line or both cannot carry the control rate; the sentences hold
            the arithmetic and the highest rate that fits.
    """
    sentences = [sentence for part in arm.parts for sentence in _problems(part, several=len(arm.buses) > 1)]
    if sentences:
        raise ConfigError.of([_at_rate(arm, sentence) for sentence in sentences])
    return budget(arm)


def _problems(arm: ArmConfig, *, several: bool) -> list[str]:
    """What a bus, that of `arm`, or its serial line does not carry: a sentence each, which names it among several."""
    found = _of_one_bus(arm)
    key, more = (f"bus.{arm.bus.name}", "buses") if several else ("bus", "arms")
    sentences: list[str] = []
    if found.rate_hz > found.bus_highest_rate_hz:
        sentences.append(_bus_sentence(found, arm, key))
    if found.rate_hz > found.serial_highest_rate_hz:
        sentences.append(_serial_sentence(found, key))
    at_once = sum(frames.count for frames in found.frames if frames.from_host)
    if arm.bus.spoken == "slcan" and at_once > ADAPTER_FRAMES:
        sentences.append(
            f"a cycle sends {at_once} frames at once, but a serial adapter holds back {ADAPTER_FRAMES} and loses the "
            f"rest; set {key}.interface to socketcan, or divide the joints among more {more}."
        )
    return [f"on bus {arm.bus.name}, {sentence}" for sentence in sentences] if several else sentences


def shown_rate(rate_hz: float) -> str:
    """A highest rate for people: rounded down to a tenth, so that the number shown does fit."""
    return f"{math.floor(rate_hz * 10.0) / 10.0:g}"


def _bus_sentence(found: Budget, arm: ArmConfig, key: str) -> str:
    ways = [f"use a faster bus ({key}.bitrate, up to {HIGHEST_BITRATE})"] if found.bitrate < HIGHEST_BITRATE else []
    if arm.bus.acknowledge:
        ways.append("turn bus.acknowledge off")
    beside = f" + {found.bits_beside_s:.0f} bit/s for {found.beside_words}" if found.beside else ""
    return (
        f"rate_hz is {found.rate_hz:g}, but {found.bits_per_cycle} bits a cycle × {found.rate_hz:g} Hz{beside} = "
        f"{found.bits_per_cycle * found.rate_hz + found.bits_beside_s:.0f} bit/s is {found.bus_load:.1%} of the "
        f"{found.bitrate} "
        f"bit/s bus, above its load_limit of {found.load_limit:.0%}; {_remedy(found, ways)}"
    )


def _serial_sentence(found: Budget, key: str) -> str:
    chars = max(found.chars_out_per_cycle, found.chars_in_per_cycle)
    load = found.serial_load or 0.0
    beside = f" + {found.serial_bits_beside_s:.0f} bit/s beside it" if found.beside else ""
    faster = [baud for baud in SERIAL_BAUDS if baud >= found.serial_baud_needed]
    ways = [f"set adapter and {key}.serial_baud to {faster[0]}"] if faster else ["use an adapter without UART (cdc)"]
    return (
        f"rate_hz is {found.rate_hz:g}, but {chars} {found.adapter.unit} a cycle × {UART_BITS_PER_CHARACTER} bits × "
        f"{found.rate_hz:g} Hz{beside} = "
        f"{found.serial_bits_per_cycle * found.rate_hz + found.serial_bits_beside_s:.0f} bit/s is {load:.1%} of "
        f"the {found.serial_baud} baud serial line, above its limit of {UART_LOAD_LIMIT:.0%}; "
        f"{_remedy(found, ways)}"
    )


def _remedy(found: Budget, other_ways: list[str]) -> str:
    highest = found.highest_rate_hz
    fits = f"the highest rate that fits is {shown_rate(highest)} Hz"
    if highest < LOWEST_RATE_HZ:
        fits += f", below the lowest allowed {LOWEST_RATE_HZ:g} Hz"
        ways = other_ways or ["put fewer drives on the bus"]
    else:
        ways = [f"lower rate_hz to {shown_rate(highest)}", *other_ways]
    return f"{fits}: {', or '.join(ways)}."


def _at_rate(arm: ArmConfig, sentence: str) -> ConfigError:
    location = "control.rate_hz"
    source = arm.source
    if source is None:
        return ConfigError(sentence, location=location)
    overridden = location in source.overridden
    return ConfigError(
        sentence,
        file=source.file,
        line=None if overridden else source.lines.get(location),
        location=location,
        overridden=overridden,
    )
