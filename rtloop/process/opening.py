"""Opening and closing the wire of an arm, of whatever kind."""

import os
import time
from itertools import chain
from typing import NamedTuple

from config.budget import cycle_frames
from config.schema import ArmConfig
from rtloop.drives.setup import joints_on_the_bus
from rtloop.memory.link import CAN_FRAME_BYTES
from rtloop.process.initial_state import listeners
from rtloop.wire.binary_adapters import (
    AT_CLOSING,
    EXTENDED_ONLY,
    STANDARD_ONLY,
    open_at,
    open_seeed,
    seeed_closing,
)
from rtloop.wire.bridge import Bridge
from rtloop.wire.can_socket import dropped_frames, holds_back, open_socketcan
from rtloop.wire.python_can import open_python_can
from rtloop.wire.tty import close_port, close_slcan, open_slcan

LAST_FRAMES_S = 0.05
"""Time for which the last cycle's frames may still be on their way to the bus."""


class OpenWire(NamedTuple):
    """A wire that is open."""

    fd: int
    complaints: list[str]
    """One message for each thing that is not as it should be."""
    bridge: Bridge | None = None
    """What connects the descriptor to a bus of python-can; None for other wires."""


def open_wire(arm: ArmConfig) -> OpenWire | None:
    """Open the arm's wire; None where it has none. Raises WireRefused."""
    bus = arm.bus
    if bus.interface == "slcan":
        return OpenWire(open_slcan(bus.resolved_channel, bus.serial_baud, bus.bitrate), [])
    if bus.interface == "seeedstudio":
        return OpenWire(open_seeed(bus.resolved_channel, bus.serial_baud, bus.bitrate, seeed_frames(arm)), [])
    if bus.interface == "ch340-at":
        return OpenWire(*open_at(bus.resolved_channel, bus.serial_baud))
    if bus.interface == "socketcan":
        sent = sum(frames.count for frames in cycle_frames(arm) if frames.from_host)
        heard, drives = [used for used, _ in listeners(arm)], len(joints_on_the_bus(arm))
        return OpenWire(*open_socketcan(bus.resolved_channel, bus.bitrate, heard, sent, drives))
    if bus.interface == "python-can":
        bridge = open_python_can(arm)
        return OpenWire(bridge.fd, [], bridge)
    return None


def close_wire(arm: ArmConfig, wire: OpenWire) -> list[str]:
    """Close what `open_wire` has opened; an adapter that is gone already is no error. Returns messages to report."""
    complaints = [] if wire.bridge is None else wire.bridge.close()
    if arm.bus.interface == "slcan":
        close_slcan(wire.fd)
    elif arm.bus.interface == "seeedstudio":
        close_port(wire.fd, seeed_closing(arm.bus.bitrate, seeed_frames(arm)))
    elif arm.bus.interface == "ch340-at":
        close_port(wire.fd, AT_CLOSING)
    else:
        os.close(wire.fd)
    return complaints


def seeed_frames(arm: ArmConfig) -> int:
    """The kind of frames to which a USB-CAN-A must be set: the arm's drives use one kind (config.drives.together)."""
    servo = None if arm.gripper is None else arm.gripper.servo
    used = [*(joint.drive.identifiers for joint in arm.joints), servo.identifiers if servo else ()]
    return EXTENDED_ONLY if any(of.extended for of in chain.from_iterable(used)) else STANDARD_ONLY


def keeps_frames(arm: ArmConfig, wire: OpenWire) -> bool:
    """Whether the system still keeps unsent frames when the wire is about to be closed, because the bus takes none.

    Waits up to LAST_FRAMES_S for them to leave.
    """
    if arm.bus.interface != "socketcan":
        return False
    until_s = time.monotonic() + LAST_FRAMES_S
    while (held_back := holds_back(wire.fd)) and time.monotonic() < until_s:
        time.sleep(LAST_FRAMES_S / 10.0)
    return held_back


def lost_bytes(arm: ArmConfig, wire: OpenWire) -> int:
    """Received bytes dropped for lack of room since the wire was opened; 0 if the wire does not count them."""
    if wire.bridge is not None:
        return wire.bridge.dropped_bytes
    return dropped_frames(wire.fd) * CAN_FRAME_BYTES if arm.bus.interface == "socketcan" else 0


def unsent_bytes(wire: OpenWire) -> int:
    """Bytes that the wire accepted since it was opened, and then did not send."""
    return 0 if wire.bridge is None else wire.bridge.unsent_bytes
