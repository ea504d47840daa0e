"""Which adapters this machine has, as its files say; nothing is opened here."""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rtarm.doctor.adapters import can_interfaces
from rtarm.doctor.machine import Machine, Unknown

SERIAL = re.compile(r"tty(USB|ACM)[0-9]+")
BY_ID = "/dev/serial/by-id"
INTERFACE_UP = 1

SLCAN_ADAPTERS = {
    "ad50:60c4": "CANable with SLCAN firmware",
    "16d0:117e": "CANable 2 with SLCAN firmware",
    "0403:ffa8": "LAWICEL CANUSB",
}
"""USB ids of adapters that surely speak SLCAN."""

CONVERTERS = {
    "04d8:000a": "Microchip serial device (USBtin, and others)",
    "0403:6001": "FTDI converter",
    "0403:6015": "FTDI converter",
    "067b:2303": "Prolific converter",
    "10c4:ea60": "CP210x converter",
    "1a86:7523": "CH340 converter",
    "1a86:55d3": "CH343 converter",
    "1a86:55d4": "CH9102 converter",
}
"""USB ids of serial converters, behind which a CAN adapter may be, or a printer."""

KERNEL_ADAPTERS = {
    "1d50:606f": ("candleLight adapter", "gs_usb"),
    "1209:2323": ("candleLight adapter", "gs_usb"),
    "0c72:000c": ("PEAK PCAN-USB", "peak_usb"),
    "0c72:0012": ("PEAK PCAN-USB FD", "peak_usb"),
}
"""USB ids of adapters that become a CAN interface of the system, with the kernel's driver."""

RECEIVER_LISTS = ("all", "fil", "inv", "sff", "eff", "err")
"""Where Linux lists who listens on its CAN interfaces (net/can/proc.c)."""
DETECTION_S = 10.0
DETECT = "import can, json; print(json.dumps(can.detect_available_configs(), default=str))"


@dataclass
class Adapter:
    """An adapter, or what may be one."""

    channel: str
    """How the arm file names it: the lasting name of a port where it has one."""
    interface: str | None
    """How rtarm reaches it; None where it does not."""
    what: str
    usb: str | None = None
    not_tried: str | None = None
    """Why it is left alone, a sentence; None if it may be tried."""
    bitrate: int | None = None
    """Bit rate that the system has given a CAN interface (bit/s)."""
    is_uart: bool = False
    """Whether the speed of its serial line matters."""


def adapters(machine: Machine) -> list[Adapter]:
    """Everything that is found without opening anything."""
    return [*serial_ports(machine), *links(machine), *without_interface(machine)]


def serial_ports(machine: Machine) -> list[Adapter]:
    """The serial ports of USB devices, each by its lasting name."""
    return [
        serial_port(machine, f"/dev/{name}") for name in _names(machine, "/sys/class/tty") if SERIAL.fullmatch(name)
    ]


def serial_port(machine: Machine, device: str, *, named: bool = False) -> Adapter:
    """One serial port; `named` by a person, who then knows that there is a CAN adapter behind it."""
    real = machine.real(device)
    usb = usb_id(machine, f"/sys/class/tty/{real.name}/device")
    channel = device if named else _lasting_name(machine, device)
    adapter = Adapter(channel, "slcan", _what(usb), usb, is_uart=real.name.startswith("ttyUSB"))
    holders = machine.holders(real) if SERIAL.fullmatch(real.name) else []  # a pseudo-terminal is held at its other end
    if holders:
        adapter.not_tried = f"It is open in process {', '.join(map(str, holders))}: end that first."
    elif machine.exists(device) and not machine.may_access(real, os.R_OK | os.W_OK):
        adapter.not_tried = (
            "You may not open it: join the group that owns it (usually `sudo usermod -aG dialout $USER`, then log in "
            "again)."
        )
    elif not named and usb not in SLCAN_ADAPTERS:
        adapter.not_tried = (
            "It may be anything, and what is said to it might do something there: if a CAN adapter is behind it, "
            f"`rtarm scan --port {channel}`."
        )
    return adapter


def _what(usb: str | None) -> str:
    if usb is None:
        return "serial port"
    return SLCAN_ADAPTERS.get(usb) or CONVERTERS.get(usb) or "serial device"


def _lasting_name(machine: Machine, device: str) -> str:
    for name in _names(machine, BY_ID):
        with contextlib.suppress(Unknown):
            if machine.real(f"{BY_ID}/{name}").name == device.rpartition("/")[2]:
                return f"{BY_ID}/{name}"
    return device


def usb_id(machine: Machine, device: str) -> str | None:
    """Vendor and product of the USB device that something in /sys belongs to; None for no USB device."""
    with contextlib.suppress(Unknown):
        folder = machine.real(device)
        for above in (folder, *folder.parents):
            if not above.is_relative_to(machine.root) or above == machine.root:
                return None
            if (above / "idVendor").exists():
                name = machine.name_of(above)
                return f"{machine.text(f'{name}/idVendor')}:{machine.text(f'{name}/idProduct')}"
    return None


def links(machine: Machine) -> list[Adapter]:
    """The CAN interfaces of the system."""
    with contextlib.suppress(Unknown):
        return [link(machine, name) for name in can_interfaces(machine)]
    return []


def link(machine: Machine, name: str) -> Adapter:
    """One CAN interface; its bit rate is the system's to set."""
    bitrate, virtual = _bitrate(machine, name)
    what = "virtual CAN interface" if virtual else "CAN interface"
    adapter = Adapter(name, "socketcan", what, usb_id(machine, f"/sys/class/net/{name}/device"), bitrate=bitrate)
    is_up = False
    with contextlib.suppress(Unknown):
        is_up = bool(machine.number(f"/sys/class/net/{name}/flags", 16) & INTERFACE_UP)
    if not is_up:
        adapter.not_tried = (
            f"It is down, and its bit rate is the system's to set: `sudo ip link set {name} up type can bitrate 500000 "
            "restart-ms 100`, with the rate of the drives' menu, then scan again."
        )
    elif _has_listeners(machine, name):
        adapter.not_tried = "Another program listens on it, and may drive an arm there: end that first."
    return adapter


def _bitrate(machine: Machine, name: str) -> tuple[int | None, bool]:
    """Bit rate of an interface (None where it is not told), and whether it is a virtual one."""
    with contextlib.suppress(Unknown):
        for told in machine.can_links():
            if isinstance(told, dict) and told.get("ifname") == name:
                info = told.get("linkinfo") or {}
                bitrate = ((info.get("info_data") or {}).get("bittiming") or {}).get("bitrate")
                return bitrate if isinstance(bitrate, int) else None, info.get("info_kind") == "vcan"
    return None, False


def _has_listeners(machine: Machine, name: str) -> bool:
    for kind in RECEIVER_LISTS:
        with contextlib.suppress(Unknown):
            lines = machine.text(f"/proc/net/can/rcvlist_{kind}").splitlines()
            if any(line.split()[:1] == [name] and line.rstrip().endswith("raw") for line in lines):
                return True
    return False


def without_interface(machine: Machine) -> list[Adapter]:
    """USB adapters that should have become CAN interfaces and have not."""
    devices = "/sys/bus/usb/devices"
    have = {usb_id(machine, f"/sys/class/net/{adapter.channel}/device") for adapter in links(machine)}
    found = []
    for name in _names(machine, devices):
        usb = usb_id(machine, f"{devices}/{name}") if ":" not in name else None
        if usb in KERNEL_ADAPTERS and usb not in have:
            what, driver = KERNEL_ADAPTERS[usb]
            reason = f"It has no CAN interface: `sudo modprobe {driver}`, then `ip -brief link show`."
            found.append(Adapter(f"USB {name}", None, what, usb, reason))
    return found


def _names(machine: Machine, folder: str) -> list[str]:
    with contextlib.suppress(Unknown):
        return machine.names(folder)
    return []


def seen_by_python_can() -> tuple[list[dict[str, Any]], str | None]:
    """What python-can detects, in a process of its own, or why it was not asked."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", DETECT], capture_output=True, text=True, timeout=DETECTION_S, check=False
        )
        found = json.loads(done.stdout.strip().splitlines()[-1])
    except subprocess.TimeoutExpired:
        return [], f"python-can's own detection was given up after {DETECTION_S:g} s."
    except (OSError, ValueError, IndexError):
        return [], "python-can is not installed or cannot detect, so adapters that only it knows are not listed."
    return [entry for entry in found if isinstance(entry, dict)], None


Detection = Callable[[], tuple[list[dict[str, Any]], str | None]]


def beyond_reach(found: list[dict[str, Any]], known: list[Adapter]) -> list[Adapter]:
    """What python-can detects besides, by interfaces that rtarm does not speak."""
    ours = {adapter.channel for adapter in known}
    return [
        Adapter(
            str(entry.get("channel")),
            None,
            f"seen by python-can as {entry.get('interface')}",
            not_tried="A scan tries serial adapters and CAN interfaces: use the kernel's driver for it, or let the "
            f"arm's file say bus.interface python-can and bus.python_can.interface {entry.get('interface')}.",
        )
        for entry in found
        if entry.get("interface") not in ("virtual", "socketcan", "slcan", "serial", "udp_multicast")
        and str(entry.get("channel")) not in ours
    ]
