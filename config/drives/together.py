"""Whether the drives of an arm go together: with each other, with the bus and with what their joints ask of them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress, product
from typing import Protocol

from config import ramp
from config.bus import BusConfig
from config.drives.drive import Drive
from config.frames import CycleFrames, Identifiers
from config.joint import JointConfig
from config.section import refuse
from config.serial_adapters import SERIAL_ADAPTERS

LEAST_SILENCE_FACTOR, MOST_SILENCE_FACTOR = 1.5, 2.0
"""With what share of its joint's acceleration limit a drive brakes that hears nothing more."""


class Limits(Protocol):
    """What is asked of the section `limits`."""

    @property
    def silence_brake_factor(self) -> float:
        """Braking of a drive that hears nothing more, as a multiple of the joint's acceleration limit."""


def check_drives(
    joints: Sequence[JointConfig], numbers: Sequence[int], bus: BusConfig, limits: Limits, rate_hz: float
) -> None:
    """Refuse the first thing that is wrong with an arm's drives (pydantic's custom errors, `config.section.refuse`).

    `numbers` are those of the buses that the joints' drives are on; `bus` is any of them.
    """
    _are_told_apart(joints, numbers)
    _are_not_too_fast(joints)
    _reach_the_whole_range(joints)
    _know_their_angle(joints)
    _stay_within_a_turn(joints)
    _tell_their_positions_in_every_cycle(joints, rate_hz)
    _do_what_the_bus_asks(joints, bus)
    _suit_the_bus(joints, bus)
    _brake_in_silence(joints, limits)


def common_identifiers(one: Drive, other: Drive) -> tuple[Identifiers, Identifiers] | None:
    """Identifiers of each of which one is the same, beside those that a family's drives have in common; or None."""
    alike = one.family == other.family
    for mine, theirs in product(one.identifiers, other.identifiers):
        if mine.meets(theirs) and not (alike and mine.shared and theirs.shared):
            return mine, theirs
    return None


def _whose(used: Identifiers, joint: JointConfig) -> str:
    """What gives a drive these identifiers, which joint's and what it is."""
    drive = joint.drive
    given = f"{drive.number_field} {drive.number}" if used.field is None else f"{used.field} {used.match:#x}"
    return f"{given} of {joint.name} ({drive.called})"


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _are_told_apart(joints: Sequence[JointConfig], numbers: Sequence[int]) -> None:
    for index, joint in enumerate(joints):
        for other in compress(joints, (number == numbers[index] for number in numbers[:index])):
            common = common_identifiers(joint.drive, other.drive)
            if common is None:
                continue
            mine, theirs = common
            field = joint.drive.number_field
            number = joint.drive.number
            if other.drive.family == joint.drive.family and other.drive.number == number:
                raise refuse(
                    f"joints[{index}].drive.{field}",
                    f"{field} {number} is used by {other.name} and {joint.name}; every drive on the bus needs "
                    f"{_article(field)} of its own: change one, in its menu and here.",
                )
            raise refuse(
                f"joints[{index}].drive.{mine.field or field}",
                f"{_whose(mine, joint)} uses CAN identifiers that {_whose(theirs, other)} uses too, "
                f"{mine.match & mine.mask | theirs.match & theirs.mask:#x} among them, so neither could be told from "
                "the other: change one of the two, in the drive and here.",
            )


def _are_not_too_fast(joints: Sequence[JointConfig]) -> None:
    for index, joint in enumerate(joints):
        if joint.motor_rpm > joint.drive.highest_motor_rpm:
            raise refuse(
                f"joints[{index}].motor_rpm",
                f"motor_rpm is {joint.motor_rpm:g}, but must be at least 0.01 and at most "
                f"{joint.drive.highest_motor_rpm:g} with {joint.drive.called}.",
            )


def _reach_the_whole_range(joints: Sequence[JointConfig]) -> None:
    for index, joint in enumerate(joints):
        most = joint.drive.highest_turns
        if most is None:
            continue
        for field in ("lower_deg", "upper_deg"):
            turns = (getattr(joint, field) + joint.zero_deg) * joint.ratio / 360.0
            if abs(turns) > most:
                raise refuse(
                    f"joints[{index}].{field}",
                    f"{field} of {joint.name} is {getattr(joint, field):g}, {abs(turns):.1f} motor turns from its "
                    f"drive's zero, but {joint.drive.called} is commanded within {most:.4g}; narrow the "
                    "range, or move the drive's zero and zero_deg.",
                )


def _know_their_angle(joints: Sequence[JointConfig]) -> None:
    for index, joint in enumerate(joints):
        if joint.drive.within_a_turn is not None and joint.range_turns >= 1.0:
            raise refuse(
                f"joints[{index}].drive.encoder",
                f"encoder of {joint.name} is absolute, but its range is {joint.range_turns:.2f} motor turns and "
                f"{joint.drive.called} knows its angle within one turn only: remove encoder (a person then says where "
                "the joint stands), or narrow the range to less than a turn.",
            )


def _stay_within_a_turn(joints: Sequence[JointConfig]) -> None:
    for index, joint in enumerate(joints):
        most = joint.drive.most_of_a_turn
        if most is not None and joint.range_turns > most:
            raise refuse(
                f"joints[{index}].ratio",
                f"the range of {joint.name} is {joint.range_turns:.2f} motor turns with ratio {joint.ratio:g}, but "
                f"{joint.drive.called} counts within one turn, of which it may use {most:g}: narrow the range, or "
                "make a turn of its position more turns of the encoder, in the drive and in ratio.",
            )


def _tell_their_positions_in_every_cycle(joints: Sequence[JointConfig], rate_hz: float) -> None:
    for index, joint in enumerate(joints):
        told_hz = joint.drive.tells_its_position_hz
        if told_hz is not None and told_hz < rate_hz:
            raise refuse(
                f"joints[{index}].drive.position_hz",
                f"position_hz of {joint.name} is {told_hz:g}, below the control rate of {rate_hz:g} Hz, so cycles "
                f"would pass without a reading: let {joint.drive.called} send its position as often, or lower rate_hz.",
            )


def _do_what_the_bus_asks(joints: Sequence[JointConfig], bus: BusConfig) -> None:
    others = [joint for joint in joints if joint.drive.family not in ("zdt", "mock")]
    for field, default in (("positions", "polled"), ("position_command", "FD")):
        value = getattr(bus, field)
        if value != default and others:
            raise refuse(
                f"bus.{field}",
                f"{field} is {value}, which is known of ZDT drives alone, but {others[0].name} has "
                f"{others[0].drive.called}; remove {field}.",
            )


def _suit_the_bus(joints: Sequence[JointConfig], bus: BusConfig) -> None:
    mock_bus = bus.interface == "mock"
    for index, joint in enumerate(joints):
        if (joint.drive.family == "mock") == mock_bus:
            continue
        if mock_bus:
            sentence = (
                f"{joint.name} has a {joint.drive.family} drive, but interface mock reaches no drives; "
                "set bus.interface to slcan or socketcan, or use an arm file whose drives are all mock (such as "
                "mock)."
            )
        else:
            sentence = (
                f"{joint.name} has a mock drive, but interface {bus.interface} needs a real drive "
                "for every joint; give it one (such as family zdt), or set bus.interface to mock for all joints."
            )
        raise refuse(f"joints[{index}].drive.family", sentence)


def check_adapter(joints: Sequence[JointConfig], bus: BusConfig, beside: Sequence[Identifiers]) -> None:
    """Refuse drives whose frames the arm's serial adapter does not carry; `beside`: what a gripper's drive uses."""
    name = bus.spoken
    adapter = SERIAL_ADAPTERS.get(name)
    if adapter is None:
        return
    others = ", or ".join(other for other in ("slcan", "socketcan") if other != name)
    remedy = f"reach the arm through another adapter ({others})."
    standard = [joint for joint in joints if not all(used.extended for used in joint.drive.identifiers)]
    extended = [joint.name for joint in joints if any(used.extended for used in joint.drive.identifiers)]
    if any(used.extended for used in beside):
        extended.append("the gripper")
    asked = [joint for joint in joints if any(frames.remote for frames in _exchanged(joint, bus))]
    if standard and not adapter.standard:
        raise refuse(
            "bus.interface",
            f"interface {name} is not known to carry standard identifiers, which {standard[0].name} "
            f"({standard[0].drive.called}) uses; {remedy}",
        )
    if standard and extended and not adapter.both_at_once:
        raise refuse(
            "bus.interface",
            f"interface {name} delivers either standard or extended identifiers, but {standard[0].name} "
            f"({standard[0].drive.called}) uses standard ones and {extended[0]} extended ones; {remedy}",
        )
    if asked and not adapter.remote:
        raise refuse(
            "bus.interface",
            f"interface {name} is not known to carry remote frames, by which {asked[0].name} "
            f"({asked[0].drive.called}) is asked; {remedy}",
        )


def _exchanged(joint: JointConfig, bus: BusConfig) -> tuple[CycleFrames, ...]:
    drive = joint.drive
    return (*drive.commands(bus), *drive.readings(bus), *drive.in_turn(bus), *drive.for_all(bus))


def _brake_in_silence(joints: Sequence[JointConfig], limits: Limits) -> None:
    for index, joint in enumerate(joints):
        _have_a_ramp_for_silence(index, joint)
        if not joint.drive.stepper_ramp:
            continue
        limit = joint.max_acceleration_rad_s2
        if ramp.nearest_silence_byte(joint.ratio, limit, limits.silence_brake_factor) is None:
            nearest = ramp.nearest_usable_acceleration_rad_s2(joint.ratio, limit)
            raise refuse(
                f"joints[{index}].max_acceleration_rad_s2",
                f"max_acceleration_rad_s2 of {joint.name} is {limit:g}, for which {joint.drive.called} with ratio "
                f"{joint.ratio:g} has no ramp that brakes at 1.5 to 2 times that limit when it hears "
                f"nothing more; the nearest limit that has one is {nearest:.4g}.",
            )


def _have_a_ramp_for_silence(index: int, joint: JointConfig) -> None:
    range_rad_s2 = joint.drive.ramp_range_rad_s2
    if range_rad_s2 is None:
        return
    limit = joint.max_acceleration_rad_s2
    least, most = (ramp / joint.ratio for ramp in range_rad_s2)
    if not LEAST_SILENCE_FACTOR * limit <= most or not least <= MOST_SILENCE_FACTOR * limit:
        nearest = most / LEAST_SILENCE_FACTOR if LEAST_SILENCE_FACTOR * limit > most else least / MOST_SILENCE_FACTOR
        raise refuse(
            f"joints[{index}].max_acceleration_rad_s2",
            f"max_acceleration_rad_s2 of {joint.name} is {limit:g}, but {joint.drive.called} with ratio "
            f"{joint.ratio:g} has ramps from {least:.4g} to {most:.4g} rad/s², none of them 1.5 to 2 times that limit, "
            f"with which it would brake when it hears nothing more; the nearest limit that has one is {nearest:.4g}.",
        )
