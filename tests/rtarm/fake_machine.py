"""A machine that is a folder of files: by default one on which nothing makes cycles late."""

from __future__ import annotations

import gzip
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rtarm.doctor.machine import Granted, Machine

GRANTED = Granted(
    fifo=True,
    priority=80,
    scheduling_refusal=None,
    locked=True,
    lock_refusal=None,
    latency_refusal=None,
    cpu_refusal=None,
)
USB = "/sys/devices/pci0000:00/0000:00:14.0/usb1/1-2"
"""The adapter of the fake machine, below its USB controller."""
GRUB = "/usr/sbin/update-grub"
CPU = "/sys/devices/system/cpu"

Content = str | bytes | Path | None
"""Text or bytes of a file, the target of a link, or None for no file at all."""


def stat(name: str = "rtloop", *, flags: int = 0, policy: int = 0, priority: int = 0) -> str:
    """A line of /proc/PID/stat, with the fields that are looked at."""
    fields = ["0"] * 52
    fields[2], fields[9 - 1], fields[40 - 1], fields[41 - 1] = "S", str(flags), str(priority), str(policy)
    return " ".join(["7", f"({name})", *fields[2:]])


def good_machine() -> dict[str, Content]:
    """Every file that a check looks at: eight processors, PREEMPT_RT, an FTDI adapter, a CAN interface."""
    files: dict[str, Content] = {
        "/proc/version": "Linux version 6.12.1-rt (gcc) #1 SMP PREEMPT_RT",
        "/proc/cmdline": "quiet",
        "/proc/config.gz": gzip.compress(b"CONFIG_HZ=250\nCONFIG_PREEMPT=y\n"),
        "/proc/cpuinfo": "flags : fpu tsc",
        "/proc/stat": "cpu 100 0 100 800 0 0 0 0 0 0\ncpu0 1 1",
        "/proc/loadavg": "0.50 0.40 0.30 1/100 4242",
        "/proc/swaps": "Filename Type Size Used Priority",
        "/proc/mounts": "tmpfs /dev/shm tmpfs rw 0 0\ntracefs /sys/kernel/tracing tracefs rw 0 0",
        "/proc/1/stat": stat("init"),
        "/proc/1/comm": "init",
        "/proc/1/cgroup": "0::/init.scope",
        "/proc/9/comm": "migration/0",
        "/proc/9/task/9/stat": stat("migration/0", flags=0x0020_0000, policy=1, priority=99),
        "/proc/10/comm": "kworker/u8:0-flush-254:0",
        "/proc/10/task/10/stat": stat("kworker/u8:0-flush-254:0", flags=0x0020_0000, policy=1, priority=1),
        "/proc/self/cgroup": "0::/user.slice/arm.scope",
        "/proc/self/limits": "Max locked memory         8388608              8388608              bytes",
        "/proc/self/status": "Uid:\t1000\t1000\t1000\t1000\nSeccomp:\t0\nCpus_allowed_list:\t0-7",
        "/proc/sys/kernel/sched_rt_runtime_us": "950000",
        "/proc/sys/kernel/sched_rt_period_us": "1000000",
        "/proc/sys/kernel/osrelease": "6.12.1-rt",
        "/proc/sys/kernel/numa_balancing": "0",
        "/proc/sys/vm/compact_unevictable_allowed": "0",
        "/proc/sys/vm/swappiness": "60",
        "/proc/irq/30/effective_affinity_list": "0",
        "/proc/irq/31/effective_affinity_list": "1",
        "/sys/fs/cgroup/user.slice/cpu.max": "max 100000",
        "/sys/fs/cgroup/user.slice/arm.scope/cpu.max": "max 100000",
        f"{CPU}/online": "0-7",
        f"{CPU}/isolated": "7",
        f"{CPU}/cpu0/cpufreq/scaling_governor": "performance",
        f"{CPU}/cpu0/cpuidle/state0/latency": "2",
        f"{CPU}/cpu0/cpuidle/state0/name": "C1",
        f"{CPU}/cpu0/cpuidle/state0/disable": "0",
        f"{CPU}/cpu0/thermal_throttle/core_throttle_count": "0",
        "/sys/devices/system/node/node0/cpulist": "0-7",
        "/sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc",
        "/sys/devices/system/clocksource/clocksource0/available_clocksource": "tsc hpet acpi_pm",
        "/sys/class/thermal/thermal_zone0/type": "x86_pkg_temp",
        "/sys/class/thermal/thermal_zone0/temp": "48000",
        "/sys/class/thermal/thermal_zone0/trip_point_0_type": "passive",
        "/sys/class/thermal/thermal_zone0/trip_point_0_temp": "95000",
        "/sys/class/tty/ttyUSB1/device": Path("../../../devices/pci0000:00/0000:00:14.0/usb1/1-2/1-2:1.0/ttyUSB1"),
        f"{USB}/1-2:1.0/ttyUSB1/uevent": "",
        f"{USB}/idVendor": "0403",
        f"{USB}/power/control": "on",
        "/sys/devices/pci0000:00/0000:00:14.0/msi_irqs/31": "msi",
        "/sys/bus/usb-serial/devices/ttyUSB1/latency_timer": "1",
        "/sys/class/net/lo/type": "772",
        "/sys/class/net/lo/flags": "0x1009",
        "/sys/class/net/eth0/type": "1",
        "/sys/class/net/eth0/flags": "0x1003",
        "/sys/class/net/can0/type": "280",
        "/sys/class/net/can0/flags": "0x40081",
        "/sys/class/net/can0/tx_queue_len": "128",
        "/dev/ttyUSB1": Path("/dev/null"),  # a character device that everybody has: 1:3
        "/sys/dev/char/1:3": Path("../../class/tty/ttyUSB1"),
        "/dev/shm/.keep": "",
        "/cache/rtarm/compiled-1/cycle.o": "",
        GRUB: "",
    }
    return files


def can_link(**changes: Any) -> list[dict[str, Any]]:
    """`ip -json -details link` of can0; the changes are of its state and settings."""
    data = {"state": "ERROR-ACTIVE", "restart_ms": 100, "bittiming": {"bitrate": 500_000}, **changes}
    return [{"ifname": "can0", "linkinfo": {"info_kind": "can", "info_data": data}}]


def build(root: Path, changes: Mapping[str, Content] | None = None, **parts: Any) -> Machine:
    """The good machine with other files, in a folder, and with other parts of `Machine`."""
    for name, content in {**good_machine(), **(changes or {})}.items():
        if content is not None:
            place(root / name.lstrip("/"), content)
    usual: dict[str, Any] = {
        "environment": {"XDG_CACHE_HOME": "/cache"},
        "trial": lambda _priority, _cpu: GRANTED,
        "can_links": can_link,
        "compiled_folder": lambda: root / "cache/rtarm/compiled-1",
        "clock_resolution_s": 1e-9,
        "space": lambda _path: room(1 << 30),
    }
    return Machine(root, **{**usual, **parts})


def place(path: Path, content: str | bytes | Path) -> None:
    """A file, or a link, with all folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, Path):
        path.symlink_to(content)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def room(free: int) -> os.statvfs_result:
    """A file system with so many bytes free, of 4 GiB."""
    return os.statvfs_result((4096, 4096, 1 << 20, free // 4096, free // 4096, 0, 0, 0, 0, 255))


def refused(**changes: Any) -> Any:
    """A trial whose outcome differs."""
    return lambda _priority, _cpu: replace(GRANTED, **changes)
