"""Several CAN buses of one arm: what they have in common, and whose drive is on which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from config.bus import BusConfig
from config.errors import did_you_mean
from config.gripper import GripperServo
from config.joint import JointConfig
from config.section import ordinal, refuse

MOST_BUSES = 4
ALIKE = ("interface", "positions", "position_command", "acknowledge")
"""What the buses of an arm agree on: how they are reached, and how all its drives are spoken to."""


def as_list(value: Any) -> Any:
    """One bus without its list."""
    return value if isinstance(value, list) else [value]


def check_buses(buses: Sequence[BusConfig]) -> None:
    """Refuse buses that do not go together."""
    if not 1 <= len(buses) <= MOST_BUSES:
        raise refuse("bus", f"bus has {len(buses)} entries, but an arm has 1 to {MOST_BUSES} buses; correct the list.")
    if len(buses) == 1:
        return
    for index, bus in enumerate(buses):
        if bus.name is None:
            raise refuse(
                f"bus[{index}]",
                f"the {ordinal(index)} bus has no name, by which joints could say that their drive is on it; add name.",
            )
        if bus.name in BusConfig.model_fields:
            raise refuse(
                f"bus[{index}].name",
                f"name {bus.name} is that of a field of a bus, so that options could mean either; choose another name.",
            )
        if bus.interface == "mock":
            raise refuse(
                f"bus[{index}].interface", "interface is mock, which is no bus at all; leave one bus, without a list."
            )
        for before in buses[:index]:
            _differ(index, bus, before)


def _differ(index: int, bus: BusConfig, before: BusConfig) -> None:
    """Refuse what two buses must not share, and in what they must not differ."""
    if bus.name == before.name:
        raise refuse(
            f"bus[{index}].name",
            f"name {bus.name} is given to two buses; each needs a name of its own: rename one.",
        )
    for field in ALIKE:
        mine, theirs = getattr(bus, field), getattr(before, field)
        if mine != theirs:
            raise refuse(
                f"bus[{index}].{field}",
                f"{field} is {_shown(mine)}, but bus {before.name} has {_shown(theirs)}, and all buses of an arm must "
                "agree on it; make them alike.",
            )
    if bus.resolved_channel == before.resolved_channel:
        raise refuse(
            f"bus[{index}].{'channel' if bus.channel is not None else 'usb_index'}",
            f"{bus.resolved_channel} is the adapter of bus {before.name} and of bus {bus.name}; each bus needs an "
            "adapter of its own: correct one.",
        )


def _shown(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def check_places(buses: Sequence[BusConfig], joints: Sequence[JointConfig], servo: GripperServo | None) -> None:
    """Refuse a drive, of a joint or the gripper's `servo`, that is on no bus of the arm, and a bus without a joint's.

    The cycle asks a joint's drive on each bus for its status in turn.
    """
    for index, joint in enumerate(joints):
        _is_on_one(f"joints[{index}].bus", f"the drive of {joint.name}", joint.bus, buses)
    if servo is not None:
        _is_on_one("gripper.servo.bus", "the gripper's drive", servo.bus, buses)
    used = {bus_number(buses, joint.bus) for joint in joints}
    for index, bus in enumerate(buses):
        if index not in used:
            raise refuse(
                f"bus[{index}]", f"no joint is on bus {bus.name}; remove it, or let joints name it as their bus."
            )


def _is_on_one(field: str, whose: str, name: str | None, buses: Sequence[BusConfig]) -> None:
    known = [bus.name for bus in buses if bus.name is not None]
    if name is None and len(buses) == 1:
        return
    if name is None:
        raise refuse(
            field,
            f"the arm has {len(buses)} buses, and nothing says on which {whose} is; add bus, one of "
            f"{', '.join(known)}.",
        )
    if name not in known:
        allowed = (
            f"its buses are {', '.join(known)}; name one of them." if known else "its bus has no name; remove bus."
        )
        raise refuse(field, f"bus is {name}, which is no bus of the arm{did_you_mean(name, known)}; {allowed}")


def bus_number(buses: Sequence[BusConfig], name: str | None) -> int:
    """The place in the list of the bus of this name; without a name it is the only one."""
    return 0 if name is None else next(number for number, bus in enumerate(buses) if bus.name == name)


def places(buses: Sequence[BusConfig]) -> str:
    """Where the bus of an arm is reached, for people; with several, where each of them is."""
    channels = [bus.resolved_channel if bus.name is None else f"{bus.resolved_channel} ({bus.name})" for bus in buses]
    return f"{buses[0].interface} on {', '.join(channels)}"
