"""Checks of the kernel: how it is preempted, its timers and clock, pages that it moves, its trace."""

from __future__ import annotations

import contextlib
import re

from config.schema import ArmConfig
from rtarm.doctor.finding import Found, Write, bad, note, ok, warn
from rtarm.doctor.machine import Machine, Unknown
from rtarm.doctor.permissions import in_container

BRISK_RATE_HZ = 250.0
"""Above this rate a stall of a few milliseconds, which a kernel that is not fully preemptible has, costs cycles."""
GOOD_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page", "riscv_clocksource")
SLOW_CLOCKS = ("hpet", "acpi_pm", "pit", "jiffies", "refined-jiffies")
TRACEFS = "/sys/kernel/tracing"
PREEMPT_SWITCH = "/sys/kernel/debug/sched/preempt"


def boot_with(machine: Machine, parameters: str) -> str:
    """The command that adds kernel parameters."""
    if in_container(machine):
        return f"# on the host: boot the kernel with {parameters}"
    if machine.exists("/usr/sbin/grubby"):  # Fedora and its kin
        return f"sudo grubby --update-kernel=ALL --args='{parameters}'   # then reboot"
    if machine.exists("/usr/sbin/update-grub"):
        return (
            rf"""sudo sed -i 's/^GRUB_CMDLINE_LINUX="/&{parameters} /' /etc/default/grub && sudo update-grub"""
            "   # then reboot"
        )
    if machine.exists("/boot/firmware/cmdline.txt"):  # Raspberry Pi
        return f"sudo sed -i '1s/$/ {parameters}/' /boot/firmware/cmdline.txt   # then reboot"
    return f"# boot the kernel with {parameters}"


def preemption(machine: Machine, arm: ArmConfig | None) -> Found:
    version = machine.text("/proc/version")
    release = version.split()[2] if len(version.split()) > 2 else "unknown"
    if "PREEMPT_RT" in version or _says_real_time(machine):
        return ok(f"Linux {release}, PREEMPT_RT")
    model = _model(machine)
    said = f"Linux {release}, preemption {model}, not PREEMPT_RT"
    mend = _real_time_kernel(machine)
    if model != "full" and arm is not None and arm.control.rate_hz > BRISK_RATE_HZ:
        return warn(f"{said}, and the arm runs at {arm.control.rate_hz:g} Hz", mend)
    return note(said, mend)


def _says_real_time(machine: Machine) -> bool:
    with contextlib.suppress(Unknown):
        return machine.number("/sys/kernel/realtime") == 1
    return False


def _model(machine: Machine) -> str:
    """How the kernel is preempted: the switch of the running one, its command line, or how it was built."""
    with contextlib.suppress(Unknown):
        chosen = re.search(r"\((none|voluntary|full|lazy)\)", machine.text(PREEMPT_SWITCH))
        if chosen is not None:
            return chosen.group(1)
    with contextlib.suppress(Unknown):
        given = re.findall(r"(?:^|\s)preempt=(none|voluntary|full|lazy)(?=\s|$)", machine.text("/proc/cmdline"))
        if given:
            return str(given[-1])
    with contextlib.suppress(Unknown):
        for option, model in (("_NONE", "none"), ("_VOLUNTARY", "voluntary"), ("_LAZY", "lazy"), ("", "full")):
            if machine.kernel_option(f"CONFIG_PREEMPT{option}") == "y":
                return model
    return "unknown"


def _real_time_kernel(machine: Machine) -> str:
    if in_container(machine):
        return "# on the host: install its distribution's real-time kernel"
    system = ""
    with contextlib.suppress(Unknown):
        system = machine.text("/etc/os-release")
    if re.search(r"^ID=[\"']?ubuntu\b", system, re.MULTILINE):
        return "sudo pro enable realtime-kernel   # then reboot"
    if re.search(r"^ID=[\"']?debian\b", system, re.MULTILINE):
        return 'sudo apt install "linux-image-rt-$(dpkg --print-architecture)"   # then reboot'
    return "# install your distribution's real-time kernel, or " + boot_with(machine, "preempt=full").removeprefix("# ")


def timers(machine: Machine, _arm: ArmConfig | None) -> Found:
    resolution_ns = machine.clock_resolution_s * 1e9
    ticks = "ticks a second unknown"
    with contextlib.suppress(Unknown):
        ticks = f"{machine.kernel_option('CONFIG_HZ') or 'unknown'} ticks a second"
    said = f"resolution {resolution_ns:g} ns, {ticks}"
    if resolution_ns > 1000:
        return bad(said, "# boot the kernel without highres=off, or use one with CONFIG_HIGH_RES_TIMERS")
    return ok(said)


def clock_source(machine: Machine, _arm: ArmConfig | None) -> Found:
    folder = "/sys/devices/system/clocksource/clocksource0"
    current = machine.text(f"{folder}/current_clocksource")
    if current in GOOD_CLOCKS:
        return ok(current)
    if current not in SLOW_CLOCKS:
        return note(f"{current[:40]!r}, which rtarm does not know")
    available = machine.text(f"{folder}/available_clocksource").split()
    if "tsc" in available:
        return warn(f"{current}, though tsc is there", f"echo tsc | sudo tee {folder}/current_clocksource")
    why = "sudo dmesg | grep -iE 'tsc|clocksource'   # why the kernel took no quicker one"
    return warn(f"{current}, nothing quicker is offered", why)


def moved_pages(machine: Machine, _arm: ArmConfig | None) -> Found:
    balancing, compaction = "/proc/sys/kernel/numa_balancing", "/proc/sys/vm/compact_unevictable_allowed"
    nodes = [name for name in machine.names("/sys/devices/system/node") if re.fullmatch(r"node[0-9]+", name)]
    if len(nodes) > 1 and machine.exists(balancing) and machine.number(balancing) & 1:
        return warn(f"the kernel moves pages between {len(nodes)} memory nodes", fix=(Write(balancing, "0"),))
    if machine.exists(compaction) and machine.number(compaction) != 0:
        return note("compaction may move locked pages", fix=(Write(compaction, "0"),))
    return ok("locked pages stay where they are")


def trace_events(machine: Machine, _arm: ArmConfig | None) -> Found:
    mounts = [line.split() for line in machine.text("/proc/mounts").splitlines()]
    places = [fields[1] for fields in mounts if len(fields) > 2 and fields[2] == "tracefs"]
    if places:
        return ok(f"to be read by root, at {places[0]}")
    if not machine.exists(TRACEFS):
        return note("this kernel has none, so `rtarm why-late` gives hints alone")
    return note("tracefs is not mounted", f"sudo mount -t tracefs nodev {TRACEFS}")
