"""What `rtarm config check ARM` prints: the derived figures of an arm that loads, as rich renderables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from config.budget import UART_LOAD_LIMIT, Budget, budget, budgets, shown_rate
from config.bus import BusConfig
from config.buses import places
from config.derived import DerivedJoint, derived_table
from config.errors import ConfigError
from config.joint import JointConfig
from config.schema import ArmConfig
from config.sections import LOWEST_JOINT_STATES_HZ
from config.serial_adapters import SERIAL_ADAPTERS


def render_check(arm: ArmConfig) -> RenderableType:
    """The derived tables of an arm and its bus budget, whether it fits or not; 80 columns are enough."""
    joints = derived_table(arm)
    heading = f"{arm.name}: {len(joints)} joints, {places(arm.buses)}"
    parts: list[RenderableType] = [
        Text(heading, style="bold"),
        limits_table(joints),
        resolution_table(joints),
    ]
    if any(joint.silence is not None for joint in joints):
        parts.append(silence_table(joints))
    followers = [joint.name for joint in arm.joints if joint.drive.identifiers and not joint.drive.plans_its_motion]
    if followers:
        parts.append(
            Text(f"In silence {', '.join(followers)}: at the last set-point heard, as hard as the drive can.\n")
        )
    if any(drive_settings(joint) for joint in arm.joints):
        parts.append(settings_table(arm.joints))
    parts.append(Text(f"Every stop on the path ends within {arm.longest_stop_s:.1f} s.\n"))
    parts += [budget_table(part, found) for part, found in zip(arm.parts, budgets(arm), strict=True)]
    parts += [Text(note, style="yellow") for note in notes(arm)]
    return Group(*parts)


def notes(arm: ArmConfig) -> list[str]:
    """What is allowed and yet may surprise, a sentence each."""
    found = [
        f"{joint.name}'s range is {joint.upper_deg - joint.lower_deg:.3g}°: limits are in degrees; did you give "
        "radians?"
        for joint in arm.joints
        if max(-joint.lower_deg, joint.upper_deg) <= 2.0 * math.pi
    ]
    if counting_anew := [_counting_anew(joint) for joint in arm.joints if counts_anew(joint)]:
        found.append(
            "After each start a reference is needed (`rtarm reference`, or `rtarm home` where the drive finds a stop) "
            f"by {', '.join(counting_anew)}."
        )
    return found


def counts_anew(joint: JointConfig) -> bool:
    """Whether nothing tells, when rtarm starts, that what the drive counts means an angle."""
    return not joint.drive.counts_on and not joint.knows_its_angle


def _counting_anew(joint: JointConfig) -> str:
    if joint.drive.knows_its_angle:
        return f"{joint.name} (its range is {joint.range_turns:.2f} motor turns, of which its encoder sees one)"
    return f"{joint.name} (no absolute encoder)"


def figures(arm: ArmConfig) -> dict[str, Any]:
    """The same as plain values; a rate that nothing limits is None.

    Of an arm with several buses, its bus and its rates are those of the tightest one, and `buses` has all of them.
    """
    found = budgets(arm)
    tightest = found.index(budget(arm))
    buses = [{"name": bus.name, **_of_a_bus(bus, load)} for bus, load in zip(arm.buses, found, strict=True)]
    return {
        "arm": arm.name,
        **_of_a_bus(arm.buses[tightest], found[tightest]),
        "longest_stop_s": arm.longest_stop_s,
        "notes": notes(arm),
        "joints": [asdict(joint) for joint in derived_table(arm)],
        **({"buses": buses} if len(buses) > 1 else {}),
    }


def _of_a_bus(bus: BusConfig, found: Budget) -> dict[str, Any]:
    highest_hz = found.highest_rate_hz
    return {
        "interface": bus.interface,
        "channel": bus.resolved_channel,
        "rate_hz": found.rate_hz,
        "highest_rate_hz": highest_hz if math.isfinite(highest_hz) else None,
        "bus_load": found.bus_load,
        "serial_load": found.serial_load,
        "frames_per_cycle": found.frames_per_cycle,
    }


def render_errors(error: ConfigError) -> RenderableType:
    """Every problem of a configuration, one a line, each with its place."""
    return Text("\n".join(str(problem) for problem in error.errors))


def limits_table(joints: Iterable[DerivedJoint]) -> Table:
    """Position, velocity and acceleration limits of each joint."""
    table = _table("Limits", "lower °", "upper °", "lower rad", "upper rad", "°/s", "rad/s", "rad/s²")
    for joint in joints:
        table.add_row(
            escape(joint.name),
            f"{joint.lower_deg:g}",
            f"{joint.upper_deg:g}",
            f"{joint.lower_rad:.4f}",
            f"{joint.upper_rad:.4f}",
            f"{joint.max_velocity_deg_s:.2f}",
            f"{joint.max_velocity_rad_s:.4f}",
            f"{joint.max_acceleration_rad_s2:g}",
        )
    return table


def resolution_table(joints: Iterable[DerivedJoint]) -> Table:
    """Pulses and counts a radian, and what one of each is as a joint angle."""
    table = _table("Resolution", "pulses/rad", "counts/rad", "pulse °", "count °")
    for joint in joints:
        table.add_row(
            escape(joint.name),
            f"{joint.command_pulses_per_rad:.2f}",
            f"{joint.encoder_counts_per_rad:.2f}",
            f"{joint.command_pulse_deg:.6f}",
            f"{joint.encoder_count_deg:.6f}",
        )
    return table


def silence_table(joints: Iterable[DerivedJoint]) -> Table:
    """What each drive does by itself, from full speed, when it hears nothing more.

    `acc byte` is what motion frames carry; `at limit` the gentlest byte that reaches the acceleration limit.
    """
    table = _table("Silence", "acc byte", "at limit", "rad/s²", "× limit", "coast °", "stop s")
    for joint in joints:
        stop = joint.silence
        if stop is None:
            table.add_row(escape(joint.name), "-", "-", "-", "-", "-", "-")
            continue
        table.add_row(
            escape(joint.name),
            "-" if stop.acc_byte is None else str(stop.acc_byte),
            "-" if joint.acc_byte is None else str(joint.acc_byte),
            f"{stop.deceleration_rad_s2:.3f}",
            f"{stop.factor:.2f}",
            f"{stop.coast_deg:.2f}",
            f"{stop.stop_time_s:.3f}",
        )
    return table


SETTINGS = ("current_ma", "stall_protection", "stall_rpm", "stall_current_ma", "stall_time_ms", "watchdog_ms")


def drive_settings(joint: JointConfig) -> dict[str, str]:
    """What the arm file wants of a drive's settings beyond those that motion rests on."""
    wanted = {name: getattr(joint.drive, name, None) for name in SETTINGS}
    words = {True: "on", False: "off"}
    return {
        name: words[value] if isinstance(value, bool) else str(value)
        for name, value in wanted.items()
        if value is not None
    }


def settings_table(joints: Iterable[JointConfig]) -> Table:
    """What `rtarm drives` compares and may write, as far as the file names it."""
    table = _table("Drives", "mA", "stall", "stall rpm", "stall mA", "stall ms", "watchdog ms")
    for joint in joints:
        wanted = drive_settings(joint)
        table.add_row(escape(joint.name), *(wanted.get(name, "-") for name in SETTINGS))
    return table


def budget_table(arm: ArmConfig, found: Budget) -> Table:
    """Load of the bus and of the serial line at the control rate, and the highest rate that fits."""
    title = "Budget" if arm.bus.name is None else f"Budget of bus {arm.bus.name}"
    table = Table(title, "value", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_row("control rate", f"{found.rate_hz:g} Hz, a cycle every {arm.control.period_ns / 1e6:.3f} ms")
    if not found.frames:
        table.add_row("bus", "none: mock drives, no limit on the rate")
    else:
        table.add_row("frames a cycle", f"{found.frames_per_cycle}, {found.bits_per_cycle} bits at worst")
        if arm.bus.reported:
            table.add_row(
                "positions", f"reported every {arm.control.report_period_ms} ms: at most one of each drive a cycle"
            )
        if found.beside:
            table.add_row("beside it", f"{found.bits_beside_s:.0f} bit/s for {found.beside_words}")
        table.add_row(
            "bus load",
            f"{found.bus_load:.1%} of {found.bitrate} bit/s, limit {found.load_limit:.0%}"
            + _verdict(found.rate_hz <= found.bus_highest_rate_hz),
        )
        if arm.bus.interface in SERIAL_ADAPTERS:
            table.add_row("serial a cycle", f"{found.chars_out_per_cycle} out, {found.chars_in_per_cycle} in")
            table.add_row("serial load", _serial_words(found))
        table.add_row("highest rate", _highest_words(found))
    if found.rate_hz < LOWEST_JOINT_STATES_HZ:
        table.add_row(
            "note",
            f"/joint_states at {found.rate_hz:g} Hz, MoveIt asks for {LOWEST_JOINT_STATES_HZ:g} or more",
        )
    return table


def _serial_words(found: Budget) -> str:
    if found.serial_load is None:
        return "no limit: cdc, the adapter is a USB device"
    return f"{found.serial_load:.1%} of {found.serial_baud} baud, limit {UART_LOAD_LIMIT:.0%}" + _verdict(
        found.rate_hz <= found.serial_highest_rate_hz
    )


def _highest_words(found: Budget) -> str:
    words = f"{shown_rate(found.highest_rate_hz)} Hz (bus {shown_rate(found.bus_highest_rate_hz)} Hz"
    if math.isfinite(found.serial_highest_rate_hz):
        words += f", serial {shown_rate(found.serial_highest_rate_hz)} Hz"
    return words + ")"


def _verdict(fits: bool) -> str:
    return "" if fits else ": TOO MUCH"


def _table(first: str, *columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(first, overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table
