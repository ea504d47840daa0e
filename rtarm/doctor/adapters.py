"""Checks of what carries the bus: serial adapters and their USB side, CAN interfaces."""

from __future__ import annotations

import contextlib
import grp
import os
import re
import stat
from functools import partial
from pathlib import Path
from typing import Any

from config.bus import BusConfig
from config.python_can import SERIAL_INTERFACES
from config.schema import ArmConfig
from rtarm.doctor.finding import Found, Write, bad, note, ok, together, warn
from rtarm.doctor.machine import Machine, Unknown, settled
from rtarm.doctor.permissions import REAL_TIME_POLICIES
from shm import files

SERIAL_PREFIXES = ("ttyUSB", "ttyACM")
ARPHRD_CAN = 280
INTERFACE_UP = 1
LEAST_QUEUE = 64
QUEUE = 128
"""Frames a CAN interface should be able to hold back; six joints send twelve a cycle, Linux allows ten."""
BUS_TROUBLE = ("ERROR-WARNING", "ERROR-PASSIVE")
GRABBERS = {
    "ModemManager": "sudo systemctl disable --now ModemManager",
    "brltty": "sudo systemctl mask --now brltty.service brltty-udev.service",
}
"""Services that open serial adapters of others, and how they are turned off."""
WORKERS = "kworker/u"
"""Begins the names of the kernel's threads that do what is bound to no processor."""
HURRY = (
    f"for worker in $(pgrep '^{WORKERS}'); do sudo chrt --fifo --pid 1 \"$worker\"; done"
    "   # lasts until the kernel makes new ones"
)


def buses(arm: ArmConfig | None) -> dict[str, BusConfig]:
    """The buses of the arm by the devices that they are reached through; none with mock drives."""
    return {} if arm is None or arm.bus.interface == "mock" else {bus.resolved_channel: bus for bus in arm.buses}


def serial_adapters(machine: Machine, arm: ArmConfig | None) -> list[str]:
    """Names of the serial adapters meant: that of the arm, or all there are (ttyUSB0)."""
    if arm is None:
        folder = "/sys/class/tty"
        return [name for name in machine.names(folder) if name.startswith(SERIAL_PREFIXES)]
    interfaces = can_interfaces(machine)
    serial = [
        device
        for device, bus in buses(arm).items()
        if bus.interface != "socketcan" and not _by_library(bus) and device not in interfaces
    ]
    for device in serial:
        if not machine.exists(device):
            raise Unknown(f"{device} is not there")
    return [_kernel_name(machine, device) for device in serial]


def _by_library(bus: BusConfig) -> bool:
    """Whether python-can reaches the adapter by other means than a serial port."""
    through = bus.python_can
    return through is not None and through.interface not in SERIAL_INTERFACES


def _kernel_name(machine: Machine, device: str) -> str:
    """What the kernel calls a device, whatever name or link leads to it."""
    found = os.stat(machine.path(device))
    if not stat.S_ISCHR(found.st_mode):
        raise Unknown(f"{device} is no device")
    return machine.real(f"/sys/dev/char/{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}").name


def can_interfaces(machine: Machine) -> list[str]:
    """Names of all CAN interfaces."""
    folder = "/sys/class/net"
    found = []
    for name in machine.names(folder):
        with contextlib.suppress(Unknown):  # bonding_masters is a file
            if machine.number(f"{folder}/{name}/type") == ARPHRD_CAN:
                found.append(name)
    return found


def _devices(machine: Machine, arm: ArmConfig | None) -> dict[str, Path]:
    """Folder in /sys/devices of each adapter: serial ones and CAN interfaces."""
    names = [(name, f"/sys/class/tty/{name}/device") for name in serial_adapters(machine, arm)]
    names += [
        (name, f"/sys/class/net/{name}/device") for name in can_interfaces(machine) if arm is None or name in buses(arm)
    ]
    return {name: machine.real(device) for name, device in names if machine.exists(device)}


def _above(machine: Machine, device: Path, mark: str) -> Path | None:
    """The nearest folder on the way up that holds `mark`."""
    for folder in (device, *device.parents):
        if not folder.is_relative_to(machine.root) or folder == machine.root:
            return None
        if os.path.exists(folder / mark):
            return folder
    return None


def interrupt_numbers(machine: Machine, arm: ArmConfig | None) -> list[str]:
    """Interrupts of the controllers that the adapters hang on."""
    found: set[str] = set()
    for device in _devices(machine, arm).values():
        vectors = _above(machine, device, "msi_irqs")
        single = _above(machine, device, "irq")
        if vectors is not None:
            found.update(machine.names(machine.name_of(vectors / "msi_irqs")))
        elif single is not None:
            found.add(machine.text(machine.name_of(single / "irq")))
    return sorted((irq for irq in found if re.fullmatch("[1-9][0-9]{0,5}", irq)), key=int)


def port(machine: Machine, arm: ArmConfig | None) -> Found:
    """The serial port itself; it is not opened, since that resets some adapters."""
    if arm is None:
        names = serial_adapters(machine, None) + can_interfaces(machine)
        return ok(f"no arm was named; adapters here: {', '.join(names) or 'none'}")
    parts = [settled(partial(_port, machine, arm, device)) for device in buses(arm)]
    return together(parts) if parts else ok(f"{arm.name} has no bus (interface {arm.bus.interface})")


def _port(machine: Machine, arm: ArmConfig, device: str) -> Found:
    bus = buses(arm)[device]
    if device in can_interfaces(machine):
        return ok(f"{device}, a CAN interface")
    if _by_library(bus):
        return ok(f"{device}, which python-can alone can look for")
    name_it = "# then name it as bus.channel" if len(arm.buses) == 1 else f"# then name it as channel of bus {bus.name}"
    is_there = bus.interface != "socketcan" and machine.exists(device)
    if not is_there and arm.name in files.running_arms():
        return ok(f"{device} is not there, but {arm.name} runs: it is simulated, or reached through another adapter")
    if bus.interface == "socketcan":
        there = ", ".join(can_interfaces(machine)) or "none"
        return bad(
            f"there is no CAN interface {device} (found: {there})",
            f"ip -brief link show   {name_it}",
        )
    if not is_there:
        return bad(
            f"{device} is not there, which a simulated arm (`rtarm up --sim`) can do without",
            f"ls /dev/serial/by-id/ /dev/ttyUSB* /dev/ttyACM*   {name_it}",
        )
    target = machine.real(device)
    found = target.stat()
    if not stat.S_ISCHR(found.st_mode):
        return bad(f"{device} is no device", f"ls /dev/serial/by-id/   {name_it}")
    if not machine.may_access(target, os.R_OK | os.W_OK):
        group = _group(found.st_gid)
        said = f"{device} belongs to group {group}, and you may not open it"
        return bad(said, f'sudo usermod -aG {group} "$USER"   # then log in again')
    holders = " ".join(map(str, machine.holders(target)))
    if holders:
        return note(f"{device} is open in process {holders}", f"ps -o pid,args {holders}   # says which")
    return ok(f"{device} may be opened; rtarm makes it raw and asks for low latency when it does")


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def latency_timer(machine: Machine, arm: ArmConfig | None) -> Found:
    folder = "/sys/bus/usb-serial/devices"
    names = serial_adapters(machine, arm)
    files = {name: f"{folder}/{name}/latency_timer" for name in names}
    parts = [_latency(name, file, machine.number(file)) for name, file in files.items() if machine.exists(file)]
    if parts:
        return together(parts)
    return ok(f"{', '.join(names)}: no FTDI chip, no such timer" if names else "no serial adapter")


def _latency(name: str, file: str, found_ms: int) -> Found:
    said = f"{name} {found_ms} ms"
    return ok(said) if found_ms <= 1 else warn(said, fix=(Write(file, "1"),))


def serial_workers(machine: Machine, arm: ArmConfig | None) -> Found:
    """Whose turn received bytes wait for; no file sets the priority, so only a command is shown."""
    names = ", ".join(serial_adapters(machine, arm))
    if not names:
        return ok("no serial adapter")
    workers = [thread for thread in machine.threads() if thread.of_kernel and thread.name.startswith(WORKERS)]
    if not workers:
        raise Unknown("the kernel's threads are hidden here")
    if all(worker.policy in REAL_TIME_POLICIES for worker in workers):
        return ok(f"{names}: {WORKERS}… have real-time priority")
    return note(f"{names}: {WORKERS}… have ordinary priority; a CAN interface needs none of them", HURRY)


def usb_power(machine: Machine, arm: ArmConfig | None) -> Found:
    parts = []
    for name, device in _devices(machine, arm).items():
        usb = _above(machine, device, "idVendor")
        if usb is not None:
            parts.append(_power(machine, name, machine.name_of(usb / "power/control")))
    return together(parts) if parts else ok("no USB adapter")


def _power(machine: Machine, name: str, file: str) -> Found:
    control = machine.text(file)
    if control == "on":
        return ok(f"{name} stays awake")
    if control == "auto":
        return warn(f"{name} may be suspended", fix=(Write(file, "on"),))
    raise Unknown(f"{file} says {control[:40]!r}")


def grabbers(machine: Machine, arm: ArmConfig | None) -> Found:
    running = sorted(set(machine.process_names().values()) & set(GRABBERS))
    if not running:
        return ok(f"neither {' nor '.join(GRABBERS)} runs")
    said = f"{' and '.join(running)} runs and may open a serial adapter when it is plugged in"
    mend = "\n".join(GRABBERS[name] for name in running)
    concerned = serial_adapters(machine, None) if arm is None else buses(arm)
    return warn(said, mend) if concerned else note(said, mend)


def can_bus(machine: Machine, arm: ArmConfig | None) -> Found:
    names = can_interfaces(machine)
    if not names:
        return ok("no CAN interface")
    parts = [settled(partial(_queue, machine, name)) for name in names]
    try:
        told = _told(machine.can_links())
    except Unknown as problem:
        return together([*parts, note(f"state and bit rate unknown: {problem}")])
    return together([*parts, *(part for name in names for part in _bus(machine, arm, name, told.get(name, {})))])


def _queue(machine: Machine, name: str) -> Found:
    file = f"/sys/class/net/{name}/tx_queue_len"
    frames = machine.number(file)
    said = f"{name} holds back {frames} frames"
    return warn(said, fix=(Write(file, str(QUEUE)),)) if frames < LEAST_QUEUE else ok(said)


def _told(links: Any) -> dict[str, dict[str, Any]]:
    """What `ip` says of each interface's kind."""
    entries = links if isinstance(links, list) else []
    return {str(link["ifname"]): _part(link, "linkinfo") for link in entries if _part(link).get("ifname")}


def _part(whole: Any, name: str | None = None) -> dict[str, Any]:
    """An object of a JSON answer, empty where there is none."""
    found = whole if name is None else _part(whole).get(name)
    return found if isinstance(found, dict) else {}


def _bus(machine: Machine, arm: ArmConfig | None, name: str, told: dict[str, Any]) -> list[Found]:
    """State and bit rate of a CAN interface; only the arm's own has to be up."""
    if told.get("info_kind") == "vcan":
        return [ok(f"{name} is virtual")]
    own = buses(arm).get(name)
    bitrate = _part(_part(told, "info_data"), "bittiming").get("bitrate")
    wanted_bitrate = own.bitrate if own else bitrate or 500_000
    up = f"sudo ip link set {name} up type can bitrate {wanted_bitrate} restart-ms 100"
    if not machine.number(f"/sys/class/net/{name}/flags", 16) & INTERFACE_UP:
        return [bad(f"{name} is down", up) if own else note(f"{name} is down", up)]
    data = _part(told, "info_data")
    if "state" not in data:
        return [note(f"unknown: `ip` does not tell the state of {name}")]
    again = f"sudo ip link set {name} down && {up}"
    parts = [_state(name, data["state"], bitrate)]
    if own and bitrate is not None and bitrate != wanted_bitrate:
        parts.append(bad(f"but the arm's bus runs at {wanted_bitrate} bit/s", again))
    if not data.get("restart_ms"):
        parts.append(note(f"{name} stays off the bus after too many errors (restart-ms 0)", again))
    return parts


def _state(name: str, state: object, bitrate: object) -> Found:
    said = f"{name} {state}, {bitrate or 'unknown'} bit/s"
    if state == "BUS-OFF":
        return bad(said, f"sudo ip link set {name} type can restart")
    if state in BUS_TROUBLE:
        return warn(said, f"ip -details -statistics link show {name}   # counts the errors")
    return ok(said)
