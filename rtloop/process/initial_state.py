"""The state of a control process that has not run a cycle yet, made from the arm's configuration."""

import math
import os
import time

import numpy as np

from config.budget import UART_BITS_PER_CHARACTER
from config.bus import BusConfig
from config.frames import Identifiers
from config.joint import FAMILIES, JointConfig
from config.schema import ArmConfig
from config.serial_adapters import SERIAL_ADAPTERS
from rtloop.drives.setup import homes_by_a_run, setup_of
from rtloop.kept.reference_store import PSEUDO_TERMINALS
from rtloop.memory.frame_words import EXTENDED, STANDARD
from rtloop.memory.link import CAN_FRAME_BYTES, GRIPPER, LISTENERS, WIRES, Part
from rtloop.memory.state import Loop, Params
from shm import layout
from shm.files import Bus
from shm.words import Mode, Unreferenced

SERVICE_SHARE = 0.95
"""Share of a cycle's bus time that frames may take, those of service dialogues included."""


def new_loop(arm: ArmConfig, state_address: int, command_address: int) -> np.ndarray:
    """The state of a control process that has not run a cycle yet, shape (1,), dtype `Loop.dtype`.

    The addresses are those of the mapped state and command files (layout.StateFile and layout.CommandFile). The
    mappings must outlive the returned array.
    """
    loop = np.zeros(1, Loop.dtype)
    memory, params = loop[0], loop[0]["params"]
    params["address"] = loop.ctypes.data
    params["state_address"] = state_address
    params["command_address"] = command_address
    _fill_params(params, arm)
    _fill_buses(loop, arm)
    if arm.gripper is not None and arm.gripper.servo is not None:
        params["has_gripper"], params["gripper_bus"] = 1, arm.bus_number(arm.gripper.servo)
        params["gripper_lower_rad"], params["gripper_upper_rad"] = arm.gripper.lower_rad, arm.gripper.upper_rad
    heard = listeners(arm)
    assert len(heard) <= LISTENERS  # a test adds up the identifiers of each family
    params["listener_count"] = len(heard)
    for row, (identifiers, whose) in zip(loop[0]["listeners"], heard, strict=False):
        row["match"], row["mask"], row["joint"] = identifiers.match, identifiers.mask, whose
        row["bus"] = params["gripper_bus"] if whose == GRIPPER else arm.bus_number(arm.joints[whose])
        row["kind"] = EXTENDED if identifiers.extended else STANDARD
    for index, joint in enumerate(arm.joints):
        _fill_joint(loop[0]["joints"][index], joint, arm, index)
        axis = loop[0]["axes"][index]
        axis["reference"]["unreferenced_reason"] = Unreferenced.NOT_BROUGHT_UP
        axis["measured"]["position_rad"] = math.nan
        axis["tracking"]["reference_rad"] = math.nan
        for measured in ("velocity_rad_s", "effort_nm", "temperature_c", "voltage_v"):
            axis["drive"][measured] = math.nan
    memory["mode"] = Mode.OFFLINE
    memory["goals"]["epoch"] = time.monotonic_ns()  # no other control process begins with the same epoch
    memory["fault"]["joint"] = memory["dialogue"]["referencing_joint"] = -1
    memory["clock"]["rate"] = memory["clock"]["rate_target"] = memory["goals"]["entry_rate"] = 1.0
    memory["operator"]["speed_scale"] = 1.0
    return loop


def buses_of(arm: ArmConfig) -> tuple[Bus, ...]:
    """What the headers of the memory files say of the arm's buses; nothing with mock drives."""
    return () if arm.bus.interface == "mock" else tuple(Bus(bus.name or "", bus.bitrate) for bus in arm.buses)


def show_limits(limits: np.void, loop: np.ndarray) -> None:
    """Write the arm's limits into the state file's record for them (layout.Limits)."""
    params, joints = loop[0]["params"], loop[0]["joints"]
    for name in layout.Limits.words.keys() & Params.words:
        limits[name] = params[name]
    for name in ("lower_rad", "upper_rad", "max_velocity_rad_s", "max_acceleration_rad_s2"):
        limits["joints"][name] = joints[name]


def show_drives(state: np.void, arm: ArmConfig) -> None:
    """Write into the state file (layout.StateFile) which identifiers are which joint's, and which joints can home."""
    for joint, config in enumerate(arm.joints):
        state["limits"]["joints"]["homes"][joint] = homes_by_a_run(config.drive)
    used = [(one, joint, config) for joint, config in enumerate(arm.joints) for one in config.drive.identifiers]
    rows = [
        (one.match, one.mask, one.extended, joint, arm.bus_number(config))
        for one, joint, config in used
        if not one.shared
    ]
    table = state["identifiers"]
    table[: len(rows)] = rows[: len(table)]


def lay_out_messages(messages: np.ndarray, parts: np.ndarray, data: np.ndarray) -> None:
    """Fill in, once, a batch of messages for the system: the only part of each is its CAN frame in `data`."""
    parts["address"] = data.ctypes.data + CAN_FRAME_BYTES * np.arange(len(parts))
    parts["length"] = CAN_FRAME_BYTES
    messages["parts"] = parts.ctypes.data + Part.dtype.itemsize * np.arange(len(parts))
    messages["part_count"] = 1


def _fill_params(params: np.void, arm: ArmConfig) -> None:
    limits = arm.limits
    period_ns = arm.control.period_ns
    params["joint_count"] = len(arm.joints)
    params["period_ns"] = period_ns
    params["homing_mask"] = sum(1 << joint for joint in arm.homing_order)
    for name in ("start_tolerance_rad", "velocity_margin", "acceleration_margin", "braking_factor"):
        params[name] = getattr(limits, name)
    params["following_error_rad"] = limits.following_error_rad
    params["position_jump_rad"] = limits.position_jump_rad
    reported = arm.bus.reported
    reading_ns = arm.control.report_period_ms * 1_000_000 if reported else period_ns
    params["stale_brake_ns"] = max(round(limits.stale_brake_s * 1e9), 3 * reading_ns)
    params["stale_fault_ns"] = max(round(limits.stale_fault_s * 1e9), 4 * reading_ns)
    params["reported"] = reported
    params["fast_targets"] = arm.bus.fast_targets
    params["reading_ns"] = reading_ns
    params["report_overdue_ns"] = max(2 * period_ns, reading_ns + period_ns // 2)
    params["front_timeout_ns"] = round(limits.front_timeout_s * 1e9)
    params["longest_stop_s"] = arm.longest_stop_s
    params["drives_patience_ns"] = round(arm.patience.drives_s * 1e9)


def _fill_buses(loop: np.ndarray, arm: ArmConfig) -> None:
    buses = loop[0]["buses"]
    loop[0]["params"]["bus_count"] = len(arm.buses)
    for number, part in enumerate(arm.parts):
        bus, config = buses[number], part.bus
        bus["address"] = buses.ctypes.data + number * buses.dtype.itemsize
        bus["number"] = number
        bus["interface"] = WIRES[config.interface]
        bus["simulated"] = os.path.realpath(config.resolved_channel).startswith(PSEUDO_TERMINALS)
        bus["service_bits"] = round(config.bitrate * arm.control.period_ns * 1e-9 * SERVICE_SHARE)
        bus["joint_count"] = len(part.joints)
        bus["wire"]["fd"] = bus["wire"]["fd_in_use"] = -1
        for batch in (bus["outgoing"], bus["reader"]):
            lay_out_messages(batch["messages"], batch["parts"], batch["bytes"])


def _fill_joint(row: np.void, joint: JointConfig, arm: ArmConfig, index: int) -> None:
    """Fill in what every family needs; a family's own file then adds, or replaces, what its codec needs."""
    drive = joint.drive
    row["family"] = FAMILIES.index(drive.family)
    row["bus"] = arm.bus_number(joint)
    row["address"] = drive.number
    row["knows_its_angle"] = drive.knows_its_angle
    row["zero_rad"] = joint.zero_rad
    row["lower_rad"], row["upper_rad"] = joint.lower_rad, joint.upper_rad
    row["slack_rad"] = joint.slack_rad
    row["max_velocity_rad_s"] = joint.max_velocity_rad_s
    row["max_acceleration_rad_s2"] = joint.max_acceleration_rad_s2
    row["silence_deceleration_rad_s2"] = joint.max_acceleration_rad_s2 * arm.limits.silence_brake_factor
    row["rpm_per_rad_s"] = joint.ratio * 60.0 / (2.0 * math.pi)
    row["command_per_rad"] = joint.direction * joint.command_pulses_per_rad
    row["reading_per_rad"] = joint.direction * joint.encoder_counts_per_rad
    row["reading_step_rad"] = joint.encoder_count_rad
    part, place = arm.part_of(index)
    adapter = SERIAL_ADAPTERS.get(part.bus.interface, SERIAL_ADAPTERS["slcan"])
    character_s = byte_s(part.bus)
    bit_s = 1.0 / part.bus.bitrate
    command_bits = sum(_bits_from_host(before, part.bus) for before in part.joints[: place + 1])
    row["command_delay_s"] = command_bits * bit_s + character_s * adapter.frame_bytes(True, 8)
    replies = [frames for frames in drive.readings(part.bus) if not frames.from_host]
    for reply in replies[-1:]:
        reply_s = reply.bits * bit_s + character_s * adapter.bytes_of(reply)
        row["report_delay_ns"] = round(reply_s * 1e9)
        row["reply_delay_ns"] = round((reply_s + drive.processing_s) * 1e9)
    setup_of(drive).fill(row, joint, part)


def _bits_from_host(joint: JointConfig, bus: BusConfig) -> int:
    return sum(frames.bits for frames in joint.drive.commands(bus) if frames.from_host)


def listeners(arm: ArmConfig) -> list[tuple[Identifiers, int]]:
    """The identifiers of frames that the cycle receives, each with its sender: a joint's number, or GRIPPER."""
    found = [(used, number) for number, joint in enumerate(arm.joints) for used in joint.drive.identifiers]
    if arm.gripper is not None and arm.gripper.servo is not None:
        found += [(used, GRIPPER) for used in arm.gripper.servo.identifiers]
    return [(used, whose) for used, whose in found if used.from_drive]


def byte_s(bus: BusConfig) -> float:
    """Time of one byte on the serial line; 0 for a USB device, where it is negligible, and without a serial line."""
    baud = bus.serial_baud
    return 0.0 if baud == "cdc" else UART_BITS_PER_CHARACTER / float(baud)
