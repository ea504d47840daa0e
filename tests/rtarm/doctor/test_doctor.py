"""`rtarm doctor` on machines that are folders, and once on this one."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fake_machine
import pytest
from depth import examples
from fake_machine import CPU, USB, Content, build, can_link, good_machine, place, refused, room, stat
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from two_buses import divided_values, write_divided

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.doctor import trial
from rtarm.doctor.checks import CHECKS
from rtarm.doctor.finding import LEVEL_MEANINGS, Found, Level, Write, tee
from rtarm.doctor.machine import Machine, Unknown, can_links, cpu_list, try_permissions
from rtarm.doctor.repair import repair
from rtarm.doctor.report import Report, examine, show

ROOT = Path(__file__).resolve().parents[3]
RUNTIME = "/proc/sys/kernel/sched_rt_runtime_us"


def run(name: str, machine: Machine, arm: ArmConfig | None = None) -> Found:
    return next(check for check in CHECKS if check.name == name).run(machine, arm)


def episode1(**realtime: Any) -> ArmConfig:
    return load_arm("episode1", overrides={"realtime": realtime} if realtime else None)


def can_arm(channel: str = "can0") -> ArmConfig:
    return load_arm("episode1", overrides={"bus": {"interface": "socketcan", "channel": channel}})


def shown(report: Report) -> str:
    out = io.StringIO()
    show(report, Console(file=out, width=80, highlight=False, emoji=False))
    return out.getvalue()


# --- a machine on which nothing is wrong --------------------------------------------------------------------


def test_a_good_machine_has_nothing_to_mend(tmp_path: Path) -> None:
    machine = build(tmp_path)
    findings = {check.name: check.run(machine, episode1(cpu=7)) for check in CHECKS}
    assert {name: found for name, found in findings.items() if found.level} == {}
    assert examine(machine, episode1(cpu=7))["healthy"]


# --- each check, with what makes it speak --------------------------------------------------------------------

CGROUP_V1 = {"/proc/self/cgroup": "2:cpuset:/\n1:cpu:/docker/x", "/sys/fs/cgroup/cpu/docker/x/cpu.shares": "1024"}
DOCKER = {"/.dockerenv": ""}
NO_FIFO = {"trial": refused(fifo=False, priority=0, scheduling_refusal="Operation not permitted")}
NO_LOCK = {"trial": refused(locked=False, lock_refusal="Cannot allocate memory")}
NO_LATENCY = {"trial": refused(latency_refusal="Permission denied")}
DEEP = {f"{CPU}/cpu0/cpuidle/state0/latency": "133", f"{CPU}/cpu0/cpuidle/state0/name": "C6"}
NO_RT = {"/proc/version": "Linux version 6.1.0-18-amd64 (gcc) #1 SMP PREEMPT_DYNAMIC"}
GENERIC = {**NO_RT, "/proc/config.gz": None}
CLOCK = "/sys/devices/system/clocksource/clocksource0"
SWAP = {"/proc/swaps": "Filename Type Size Used Priority\n/dev/sda2 partition 8388604 524288 -2"}

Case = tuple[str, dict[str, Content], dict[str, Any], Level, str, str | None]
"""Check, other files, other parts of the machine, level, what is said, and what the command holds (None: none)."""

CASES: list[Case] = [
    ("real-time priority", {}, NO_FIFO, Level.BAD, "SCHED_FIFO 80 refused (Operation not permitted)", "limits.d"),
    ("real-time priority", DOCKER, NO_FIFO, Level.BAD, "refused", "docker run --cap-add=SYS_NICE"),
    (
        "real-time priority",
        {**CGROUP_V1, "/sys/fs/cgroup/cpu/docker/x/cpu.rt_runtime_us": "0"},
        NO_FIFO,
        Level.BAD,
        "refused",
        "echo 950000 | sudo tee /sys/fs/cgroup/cpu/docker/x/cpu.rt_runtime_us",
    ),
    ("real-time priority", {}, {"trial": refused(fifo=False)}, Level.BAD, "is not kept", "limits.d"),
    ("real-time priority", {}, {"trial": refused(priority=1)}, Level.BAD, "is not kept", "limits.d"),
    ("real-time priority", {"/proc/self/status": "Uid:\t0\t0\t0\t0"}, {}, Level.OK, "to root: ask again as", None),
    ("locked memory", {}, NO_LOCK, Level.WARN, "(Cannot allocate memory); the limit is 8 MiB", "memlock unlimited"),
    ("locked memory", DOCKER, NO_LOCK, Level.WARN, "32 MiB cannot be locked", "--ulimit memlock=-1"),
    ("locked memory", {"/proc/self/limits": ""}, NO_LOCK, Level.WARN, "the limit is unknown", "memlock"),
    ("locked memory", {}, {"trial": refused(locked=False)}, Level.WARN, "agreed to, but not done", "memlock"),
    ("real-time throttling", {RUNTIME: "-1"}, {}, Level.NOTE, "off: a real-time thread that runs wild", None),
    ("real-time throttling", {RUNTIME: "0"}, {}, Level.BAD, "0 of every 1000 ms", f"echo 950000 | sudo tee {RUNTIME}"),
    ("real-time throttling", {RUNTIME: "100000"}, {}, Level.WARN, "100 of every 1000 ms", "echo 950000"),
    ("real-time throttling", {RUNTIME: "soon"}, {}, Level.NOTE, "unknown: ", None),
    (
        "threads above",
        {"/proc/44/task/45/stat": stat("jackd (x) y", policy=1, priority=85)},
        {},
        Level.NOTE,
        "above 80: jackd (x) y (45) 85",
        "chrt --fifo --pid 70 45",
    ),
    ("threads above", {"/proc/4/task/4/stat": stat("d", policy=6)}, {}, Level.NOTE, "above 80: d (4) 0", "chrt"),
    ("threads above", {"/proc/4/task/4/stat": stat("q", policy=1, priority=80)}, {}, Level.OK, "no program's", None),
    ("threads above", {"/proc/1/stat": None}, {}, Level.NOTE, "unknown: /proc/1/stat cannot be read", None),
    ("preemption", NO_RT, {}, Level.NOTE, "Linux 6.1.0-18-amd64, preemption full, not PREEMPT_RT", "preempt=full"),
    ("preemption", {**NO_RT, "/sys/kernel/realtime": "1"}, {}, Level.OK, "PREEMPT_RT", None),
    ("preemption", {**NO_RT, "/proc/cmdline": "a preempt=none"}, {}, Level.NOTE, "preemption none", None),
    ("preemption", {**NO_RT, "/sys/kernel/debug/sched/preempt": "none (voluntary) full"}, {}, Level.NOTE, "volu", None),
    ("preemption", {**GENERIC, "/etc/os-release": "ID=debian"}, {}, Level.NOTE, "preemption unknown", "linux-image-rt"),
    ("preemption", {**GENERIC, "/etc/os-release": 'ID="ubuntu"'}, {}, Level.NOTE, "preemption unknown", "sudo pro"),
    ("preemption", {**GENERIC, fake_machine.GRUB: None}, {}, Level.NOTE, "", "boot the kernel with preempt=full"),
    ("preemption", {**NO_RT, **DOCKER}, {}, Level.NOTE, "", "# on the host: install"),
    (
        "own processor",
        {f"{CPU}/isolated": "", **DOCKER},
        {},
        Level.NOTE,
        "",
        "# on the host: boot the kernel with isol",
    ),
    ("container", {"/sys/fs/cgroup/user.slice/cpu.max": ""}, {}, Level.NOTE, "unknown: the limit", None),
    ("preemption", {**GENERIC, "/usr/sbin/grubby": ""}, {}, Level.NOTE, "", "grubby --update-kernel=ALL"),
    (
        "preemption",
        {**GENERIC, fake_machine.GRUB: None, "/boot/firmware/cmdline.txt": ""},
        {},
        Level.NOTE,
        "",
        "/boot/firmware/cmdline.txt",
    ),
    ("timers", {}, {"clock_resolution_s": 4e-3}, Level.BAD, "resolution 4e+06 ns, 250 ticks", "highres=off"),
    ("timers", {"/proc/config.gz": b"\x1f\x8bno"}, {}, Level.OK, "ticks a second unknown", None),
    (
        "timers",
        {"/proc/config.gz": None, "/boot/config-6.12.1-rt": "CONFIG_HZ=1000"},
        {},
        Level.OK,
        "1000 ticks a second",
        None,
    ),
    ("clock source", {f"{CLOCK}/current_clocksource": "hpet"}, {}, Level.WARN, "hpet, though tsc", "echo tsc | sudo"),
    (
        "clock source",
        {f"{CLOCK}/current_clocksource": "acpi_pm", f"{CLOCK}/available_clocksource": "hpet acpi_pm"},
        {},
        Level.WARN,
        "nothing quicker is offered",
        "dmesg",
    ),
    ("clock source", {f"{CLOCK}/current_clocksource": "sundial"}, {}, Level.NOTE, "'sundial'", None),
    ("trace events", {}, {}, Level.OK, "by root, at /sys/kernel/tracing", None),
    ("trace events", {"/proc/mounts": "none / ext4"}, {}, Level.NOTE, "has none", None),
    (
        "trace events",
        {"/proc/mounts": "none / ext4", "/sys/kernel/tracing/README": ""},
        {},
        Level.NOTE,
        "is not mounted",
        "sudo mount -t tracefs nodev /sys/kernel/tracing",
    ),
    ("moved pages", {"/proc/sys/vm/compact_unevictable_allowed": "1"}, {}, Level.NOTE, "compaction", "echo 0"),
    ("moved pages", {"/proc/sys/vm/compact_unevictable_allowed": None}, {}, Level.OK, "stay", None),
    (
        "moved pages",
        {"/proc/sys/kernel/numa_balancing": "1", "/sys/devices/system/node/node1/cpulist": "8-15"},
        {},
        Level.WARN,
        "between 2 memory nodes",
        "echo 0 | sudo tee /proc/sys/kernel/numa_balancing",
    ),
    (
        "clock governor",
        {f"{CPU}/cpu0/cpufreq/scaling_governor": "powersave"},
        {},
        Level.WARN,
        "powersave",
        "echo perfo",
    ),
    ("clock governor", {f"{CPU}/cpu0/cpufreq/scaling_governor": "schedutil"}, {}, Level.NOTE, "raises", "echo perform"),
    ("clock governor", {f"{CPU}/cpu0/cpufreq/scaling_governor": None}, {}, Level.NOTE, "unknown: ", None),
    ("sleep states", DEEP, NO_LATENCY, Level.WARN, "deepest sleep C6, 133 µs", "udev"),
    ("sleep states", {**DEEP, **DOCKER}, NO_LATENCY, Level.WARN, "Permission denied", "--device=/dev/cpu_dma_latency"),
    ("sleep states", {**DEEP, f"{CPU}/cpu0/cpuidle/state0/disable": "1"}, NO_LATENCY, Level.OK, "no sleep", None),
    ("sleep states", {}, NO_LATENCY, Level.OK, "C1, 2 µs", None),
    ("sleep states", DEEP, {}, Level.OK, "the control process may forbid it", None),
    ("own processor", {}, {}, Level.NOTE, "CPU 7 isolated, but the arm file leaves", "realtime: {cpu: 7}"),
    ("own processor", {f"{CPU}/isolated": ""}, {}, Level.NOTE, "none is isolated", "isolcpus=managed_irq,domain,7"),
    ("own processor", {f"{CPU}/isolated": None, f"{CPU}/online": "0-1"}, {}, Level.OK, "too few to give", None),
    ("own processor", {f"{CPU}/online": "0-7;rm"}, {}, Level.NOTE, "unknown: ", None),
    ("interrupts", {"/proc/5/comm": "irqbalance"}, {}, Level.OK, "interrupt 31 on CPU 1, irqbalance moves", None),
    ("interrupts", {"/proc/1/comm": None}, {}, Level.NOTE, "unknown: ", None),
    ("load", {f"{CPU}/online": "0"}, {}, Level.WARN, "1 processor, load 0.50", "two processors"),
    ("load", {"/proc/loadavg": "9.01 1 1"}, {}, Level.NOTE, "8 processors, load 9.01", "top"),
    ("load", {"/proc/loadavg": "idle"}, {}, Level.NOTE, "unknown: /proc/loadavg", None),
    ("heat", {f"{CPU}/cpu0/thermal_throttle/core_throttle_count": "3"}, {}, Level.WARN, "throttled 3 times", "fans"),
    ("heat", {"/sys/class/thermal/thermal_zone0/temp": "97000"}, {}, Level.WARN, "97 °C, slowed down from 95", "fans"),
    ("heat", {f"{CPU}/cpu0/thermal_throttle/core_throttle_count": None}, {}, Level.OK, "cooler than", None),
    (
        "virtual machine",
        {"/proc/cpuinfo": "flags\t: fpu hypervisor tsc"},
        {},
        Level.NOTE,
        "virtual machine, 0.00%",
        "#",
    ),
    ("virtual machine", {"/proc/version": "Linux version 5-microsoft-WSL2"}, {}, Level.NOTE, "WSL", "#"),
    ("virtual machine", {"/sys/hypervisor/type": "xen"}, {}, Level.NOTE, "xen", "#"),
    ("virtual machine", {"/proc/device-tree/hypervisor": ""}, {}, Level.NOTE, "virtual machine", "#"),
    ("virtual machine", {"/proc/stat": "cpu 1 0 1 90 0 0 0 8 0 0"}, {}, Level.WARN, "unnamed hypervisor, 8.00%", "#"),
    ("virtual machine", {"/proc/stat": "cpu 1"}, {}, Level.NOTE, "unknown: /proc/stat", None),
    ("container", DOCKER, {}, Level.NOTE, "Docker container, no limit", None),
    ("container", {"/run/.containerenv": ""}, {}, Level.NOTE, "Podman container", None),
    ("container", {}, {"environment": {"container": "lxc"}}, Level.NOTE, "lxc container", None),
    ("container", {"/proc/1/cgroup": "1:cpu:/kubepods/x"}, {}, Level.NOTE, "kubepods container", None),
    (
        "container",
        {"/proc/self/status": "Seccomp:\t2\nCpus_allowed_list:\t0-3"},
        {},
        Level.NOTE,
        "none, system calls filtered (seccomp), CPUs 0-3 of 0-7, no limit",
        None,
    ),
    ("container", {"/proc/self/status": "Cpus_allowed_list:\t0-6"}, {}, Level.OK, "none, no limit", None),
    (
        "container",
        {"/sys/fs/cgroup/user.slice/cpu.max": "150000 100000"},
        {},
        Level.WARN,
        "at most 1.5 processors' time",
        "echo max | sudo tee /sys/fs/cgroup/user.slice/cpu.max",
    ),
    (
        "container",
        {
            **DOCKER,
            **CGROUP_V1,
            "/sys/fs/cgroup/cpu/docker/x/cpu.cfs_quota_us": "50000",
            "/sys/fs/cgroup/cpu/docker/x/cpu.cfs_period_us": "100000",
        },
        {},
        Level.WARN,
        "at most 0.5 processors' time",
        "without --cpus",
    ),
    (
        "container",
        {
            **CGROUP_V1,
            "/sys/fs/cgroup/cpu/docker/x/cpu.cfs_quota_us": "-1",
            "/sys/fs/cgroup/cpu/docker/x/cpu.cfs_period_us": "100000",
        },
        {},
        Level.OK,
        "none, no limit",
        None,
    ),
    ("container", {"/sys/fs/cgroup/user.slice/arm.scope/cpu.max": "1 0"}, {}, Level.NOTE, "unknown: the limit", None),
    ("container", {"/proc/self/cgroup": "0::/../.."}, {}, Level.OK, "no limit", None),
    ("container", {"/proc/self/cgroup": ""}, {}, Level.NOTE, "unknown: no control group", None),
    ("swap", SWAP, {}, Level.NOTE, "512 MiB in use, vm.swappiness 60; the control process locks", "swapoff -a"),
    ("swap", SWAP, NO_LOCK, Level.WARN, "cannot lock its memory", "sudo swapoff -a"),
    ("swap", {"/proc/swaps": "x\n/dev/sda2 partition many"}, {}, Level.NOTE, "unknown: /proc/swaps", None),
    ("shared memory", {"/dev/shm/.keep": None}, {}, Level.BAD, "/dev/shm is not there", "mount -t tmpfs"),
    ("shared memory", {}, {"may_access": lambda _path, _mode: False}, Level.BAD, "not be written", "chmod 1777"),
    ("shared memory", {}, {"space": lambda _: room(0)}, Level.BAD, "0 of 4096 MiB free, an arm needs", "remount,size"),
    ("shared memory", {}, {"space": lambda _: room(8 << 20)}, Level.WARN, "8 of 4096 MiB free", "remount,size=512M"),
    ("shared memory", DOCKER, {"space": lambda _: room(8 << 20)}, Level.WARN, "", "--shm-size=512m"),
    ("shared memory", {"/proc/mounts": "/dev/sda1 / ext4 rw 0 0"}, {}, Level.WARN, "no tmpfs", "mount -t tmpfs"),
    ("disk", {}, {"space": lambda _: room(1 << 20)}, Level.WARN, "0.0 GiB free", "df -h"),
    (
        "latency timer",
        {"/sys/bus/usb-serial/devices/ttyUSB1/latency_timer": "16"},
        {},
        Level.WARN,
        "ttyUSB1 16 ms",
        "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB1/latency_timer",
    ),
    ("latency timer", {"/sys/bus/usb-serial/devices/ttyUSB1/latency_timer": None}, {}, Level.OK, "no FTDI", None),
    (
        "serial workers",
        {"/proc/4/task/4/stat": stat("kworker/u8:3", flags=0x0020_0000)},
        {},
        Level.NOTE,
        "ttyUSB1: kworker/u… have ordinary priority; a CAN interface needs none",
        "pgrep '^kworker/u'); do sudo chrt --fifo --pid 1",
    ),
    ("serial workers", {"/proc/4/task/4/stat": stat("kworker/u8:3")}, {}, Level.OK, "have real-time priority", None),
    (
        "serial workers",
        {"/proc/10/task/10/stat": None},
        {},
        Level.NOTE,
        "unknown: the kernel's threads are hidden",
        None,
    ),
    (
        "serial workers",
        {"/sys/class/tty/ttyUSB1/device": None, "/sys/class/tty/tty0/x": ""},
        {},
        Level.OK,
        "no serial",
        None,
    ),
    (
        "USB power",
        {f"{USB}/power/control": "auto"},
        {},
        Level.WARN,
        "ttyUSB1 may be suspended",
        f"echo on | sudo tee {USB}/power/control",
    ),
    ("USB power", {f"{USB}/power/control": "maybe"}, {}, Level.NOTE, "unknown: ", None),
    ("USB power", {f"{USB}/idVendor": None}, {}, Level.OK, "no USB adapter", None),
    ("port grabbers", {"/proc/5/comm": "ModemManager"}, {}, Level.WARN, "ModemManager runs", "disable --now Modem"),
    (
        "port grabbers",
        {"/proc/5/comm": "brltty", "/sys/class/tty/ttyUSB1/device": None, "/sys/class/tty/tty0/x": ""},
        {},
        Level.NOTE,
        "brltty runs",
        "mask --now brltty",
    ),
    ("adapter's port", {}, {}, Level.OK, "adapters here: ttyUSB1, can0", None),
    (
        "CAN interface",
        {"/sys/class/net/can0/tx_queue_len": "10"},
        {},
        Level.WARN,
        "can0 holds back 10 frames",
        "echo 128 | sudo tee /sys/class/net/can0/tx_queue_len",
    ),
    ("CAN interface", {"/sys/class/net/can0/flags": "0x40080"}, {}, Level.NOTE, "can0 is down", "set can0 up type can"),
    ("CAN interface", {}, {"can_links": lambda: can_link(state="BUS-OFF")}, Level.BAD, "BUS-OFF", "type can restart"),
    ("CAN interface", {}, {"can_links": lambda: can_link(state="ERROR-PASSIVE")}, Level.WARN, "ERROR-PASSIVE", "-stat"),
    ("CAN interface", {}, {"can_links": lambda: can_link(restart_ms=0)}, Level.NOTE, "stays off the bus", "restart-ms"),
    ("CAN interface", {}, {"can_links": lambda: []}, Level.NOTE, "`ip` does not tell the state of can0", None),
    ("CAN interface", {"/sys/class/net/can0/type": "1"}, {}, Level.OK, "no CAN interface", None),
    (
        "CAN interface",
        {},
        {"can_links": lambda: [{"ifname": "can0", "linkinfo": {"info_kind": "vcan"}}]},
        Level.OK,
        "can0 is virtual",
        None,
    ),
    ("ROS network", {}, {"environment": {"ROS_DOMAIN_ID": "233"}}, Level.BAD, "'233', but must be 0 to 101", "export"),
    ("ROS network", {}, {"environment": {"ROS_DOMAIN_ID": "one"}}, Level.BAD, "'one', but must be", "export"),
    ("ROS network", {}, {"environment": {"ROS_DOMAIN_ID": "150"}}, Level.WARN, "domain 150, whose ports", "export"),
    ("ROS network", {}, {"environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "ALL"}}, Level.BAD, "'ALL'", "LOCALHOST"),
    (
        "ROS network",
        {},
        {"environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}},
        Level.WARN,
        "will not find",
        "unset",
    ),
    ("ROS network", {}, {"environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}}, Level.OK, "with multicast", None),
    (
        "ROS network",
        {"/sys/class/net/eth0/flags": "0x1002"},
        {"environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}},
        Level.WARN,
        "no network interface that is up has multicast",
        "ip link",
    ),
    ("ROS network", {"/sys/class/net/lo/flags": "0x9"}, {}, Level.NOTE, "lo without multicast", "lo multicast on"),
    ("ROS network", {"/sys/class/net/lo/flags": "0x8"}, {}, Level.BAD, "lo is down", "ip link set lo up"),
    ("ROS network", {"/sys/class/net/lo/flags": None}, {}, Level.NOTE, "unknown: there is no loopback", None),
    (
        "Python",
        {},
        {"environment": {"NUMBA_DISABLE_JIT": "1"}},
        Level.BAD,
        "nothing is compiled",
        "unset NUMBA_DISABLE",
    ),
    ("Python", {}, {"environment": {"NUMBA_BOUNDSCHECK": "1"}}, Level.WARN, "compiled code is slow", "unset NUMBA_BO"),
    (
        "compiled cycle",
        {"/cache/rtarm/compiled-1/cycle.o": None},
        {},
        Level.NOTE,
        "waits for the compiler",
        "-m rtloop.warm",
    ),
]


@pytest.mark.parametrize("case", CASES, ids=[f"{case[0]}: {case[4] or case[5]}" for case in CASES])
def test_a_check_says_what_is_and_what_mends_it(case: Case, tmp_path: Path) -> None:
    name, files, parts, level, said, command = case
    found = run(name, build(tmp_path, files, **parts))
    assert (found.level, said in found.found) == (level, True), found
    if command is not None:
        assert command in (found.command or ""), found
    if level in {Level.OK}:
        assert found.command is None
    if level >= Level.WARN:
        assert found.command, "what is wrong can be mended"


def test_every_check_was_made_to_speak() -> None:
    assert {case[0] for case in CASES if case[3]} == {check.name for check in CHECKS} - {"adapter's port"}


# --- with an arm ---------------------------------------------------------------------------------------------


def test_the_arms_own_processor(tmp_path: Path) -> None:
    machine = build(tmp_path)
    assert run("own processor", machine, episode1(cpu=7)) == Found(Level.OK, "7, isolated")
    shared = run("own processor", machine, episode1(cpu=3))
    assert (shared.level, "isolcpus=managed_irq,domain,3 nohz_full=3" in str(shared.mend)) == (Level.NOTE, True)
    assert "irqaffinity" not in str(run("own processor", machine, episode1(cpu=0)).mend)
    absent = run("own processor", machine, episode1(cpu=8))
    assert (absent.level, "realtime.cpu is 8, which is not there" in absent.found) == (Level.BAD, True)


def test_a_processor_that_may_not_be_used(tmp_path: Path) -> None:
    machine = build(tmp_path, trial=refused(cpu_refusal="Invalid argument"))
    found = run("own processor", machine, episode1(cpu=6))
    assert (found.level, found.found) == (Level.BAD, "realtime.cpu is 6, which may not be used (Invalid argument)")


def test_interrupts_on_the_arms_processor(tmp_path: Path) -> None:
    found = run("interrupts", build(tmp_path), episode1(cpu=0))
    assert (found.level, found.found) == (
        Level.NOTE,
        "adapter's interrupt 31 on CPU 1, no irqbalance, interrupts 30 arrive on CPU 0",
    )
    assert found.mend == "echo 1,2,3,4,5,6,7 | sudo tee /proc/irq/30/smp_affinity_list"
    assert run("interrupts", build(tmp_path / "b"), episode1(cpu=1)).level == Level.OK  # only the adapter's own
    balanced = run("interrupts", build(tmp_path / "c", {"/proc/5/comm": "irqbalance"}), episode1(cpu=7))
    assert (balanced.level, "IRQBALANCE_BANNED_CPULIST=7" in str(balanced.mend)) == (Level.WARN, True)


def test_a_brisk_arm_wants_more_of_the_kernel(tmp_path: Path) -> None:
    machine = build(tmp_path, {**NO_RT, "/proc/cmdline": "preempt=voluntary"})
    brisk = load_arm("mock", overrides={"control": {"rate_hz": 1000.0}})
    assert run("preemption", machine, load_arm("mock")).level == Level.NOTE
    assert run("preemption", machine, brisk).level == Level.WARN


@pytest.mark.parametrize("bus", [{}, {"interface": "socketcan", "usb_index": 7}], ids=["serial", "CAN"])
def test_a_simulated_arm_that_runs_lacks_no_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bus: dict[str, Any]
) -> None:
    monkeypatch.setattr("shm.files.running_arms", lambda: ["episode1"])
    machine = build(tmp_path, {"/dev/ttyUSB1": None})
    found = run("adapter's port", machine, load_arm("episode1", overrides={"bus": bus}))
    assert found.level == Level.OK and "is not there, but episode1 runs: it is simulated" in found.found


def test_the_port_of_the_arm(tmp_path: Path) -> None:
    port, arm = "adapter's port", episode1()
    assert "/dev/ttyUSB1 may be opened" in run(port, build(tmp_path / "there"), arm).found
    assert run(port, build(tmp_path / "there2"), load_arm("mock")) == Found(
        Level.OK, "mock has no bus (interface mock)"
    )
    assert run(port, build(tmp_path / "can"), can_arm()) == Found(Level.OK, "can0, a CAN interface")
    by_library = {"interface": "python-can", "usb_index": 1, "python_can": {"interface": "pcan"}}
    assert run(port, build(tmp_path / "lib"), load_arm("episode1", overrides={"bus": by_library})) == Found(
        Level.OK, "PCAN_USBBUS1, which python-can alone can look for"
    )
    gone = run(port, build(tmp_path / "no can"), can_arm("can1"))
    assert (gone.level, gone.found) == (Level.BAD, "there is no CAN interface can1 (found: can0)")

    gone = run(port, build(tmp_path / "gone", {"/dev/ttyUSB1": None}), arm)
    assert gone.level == Level.BAD and gone.found.startswith("/dev/ttyUSB1 is not there, which a simulated arm (")
    for name in ("latency timer", "USB power"):
        said = run(name, build(tmp_path / name, {"/dev/ttyUSB1": None}), arm)
        assert said == Found(Level.NOTE, "unknown: /dev/ttyUSB1 is not there")
    file = run(port, build(tmp_path / "file", {"/dev/ttyUSB1": "text"}), arm)
    assert (file.level, file.found) == (Level.BAD, "/dev/ttyUSB1 is no device")
    forbidden = run(port, build(tmp_path / "no", may_access=lambda _path, _mode: False), arm)
    assert forbidden.level == Level.BAD
    assert "and you may not open it" in forbidden.found
    assert "sudo usermod -aG " in str(forbidden.mend)


def test_the_ports_of_an_arm_of_several_buses(tmp_path: Path) -> None:
    serial = load_arm(write_divided("episode1", tmp_path / "arm.yaml"), overrides={"bus": {"wrist": {"usb_index": 1}}})
    found = run("adapter's port", build(tmp_path / "one"), serial)
    assert found.level == Level.BAD
    assert "/dev/ttyshoulder is not there" in found.found and "/dev/ttyUSB1 may be opened" in found.found
    assert found.command is not None and found.command.endswith("# then name it as channel of bus shoulder")
    assert "unknown: /dev/ttyshoulder is not there" in run("latency timer", build(tmp_path / "two"), serial).found

    values = divided_values("episode1", {"interface": "socketcan", "serial_baud": "cdc"})
    for bus, channel, bitrate in zip(values["bus"], ("can1", "can0"), (500_000, 250_000), strict=True):
        bus |= {"channel": channel, "bitrate": bitrate}
    found = run("CAN interface", build(tmp_path / "can"), ArmConfig.model_validate(values))
    assert "but the arm's bus runs at 250000 bit/s" in found.found


def test_a_port_that_is_open_elsewhere_is_said(tmp_path: Path) -> None:
    held = run("adapter's port", build(tmp_path, {"/proc/77/fd/3": Path("/dev/null")}), episode1())
    assert (held.level, held.found) == (Level.NOTE, "/dev/ttyUSB1 is open in process 77")


def test_the_can_interface_of_the_arm(tmp_path: Path) -> None:
    name = "CAN interface"
    slow = build(tmp_path / "slow", can_links=lambda: can_link(bittiming={"bitrate": 250_000}))
    found = run(name, slow, can_arm())
    assert (found.level, "the arm's bus runs at 500000 bit/s" in found.found) == (Level.BAD, True)
    assert "sudo ip link set can0 down && sudo ip link set can0 up type can bitrate 500000" in str(found.command)
    down = build(tmp_path / "down", {"/sys/class/net/can0/flags": "0x80"})
    assert run(name, down, can_arm()).level == Level.BAD

    def no_ip() -> Any:
        raise Unknown("`ip` cannot be run")

    lacking = build(tmp_path / "no", {"/sys/class/net/can0/tx_queue_len": "10"}, can_links=no_ip)
    found = run(name, lacking, can_arm())
    assert (found.level, found.found) == (
        Level.WARN,
        "can0 holds back 10 frames; state and bit rate unknown: `ip` cannot be run",
    )


def test_discovery_follows_the_arm_file_and_the_environment_overrules_it(tmp_path: Path) -> None:
    open_arm = load_arm("episode1", overrides={"front": {"discovery": "subnet"}})
    assert "discovery SUBNET" in run("ROS network", build(tmp_path), open_arm).found
    local = build(tmp_path / "local", environment={"ROS_LOCALHOST_ONLY": "1"})
    assert "discovery LOCALHOST (ROS_LOCALHOST_ONLY)" in run("ROS network", local, open_arm).found


# --- what cannot be read -------------------------------------------------------------------------------------


def test_what_is_unknown_does_not_hide_what_is_bad(tmp_path: Path) -> None:
    files: dict[str, Content] = {"/proc/self/cgroup": None, "/proc/1/cgroup": None, "/proc/self/limits": None}
    machine = build(
        tmp_path,
        {**files, "/sys/class/net/lo/flags": None},
        trial=refused(scheduling_refusal="no", locked=False, latency_refusal="no"),
        environment={"ROS_DOMAIN_ID": "1000"},
    )
    for name, level in (
        ("real-time priority", Level.BAD),
        ("locked memory", Level.WARN),
        ("ROS network", Level.BAD),
    ):
        assert run(name, machine).level == level


NEEDS_NO_FILES = {"real-time priority", "locked memory", "timers", "disk", "Python"}


def test_what_is_missing_is_unknown_and_never_good(tmp_path: Path) -> None:
    nothing = build(tmp_path / "x")
    empty = Machine(tmp_path / "empty", **{key: getattr(nothing, key) for key in ("environment", "trial", "space")})
    (tmp_path / "empty").mkdir()
    for check in CHECKS:
        found = check.run(empty, None)
        assert found.level or check.name in {*NEEDS_NO_FILES, "compiled cycle"}, (check.name, found)


@pytest.mark.parametrize("name", sorted(good_machine()))
def test_what_cannot_be_opened_is_no_crash(name: str, tmp_path: Path) -> None:
    """A folder in the place of the file stands for one that may not be read, which root always may."""
    machine = build(tmp_path, {name: None})
    (tmp_path / name.lstrip("/")).mkdir(parents=True)
    report = examine(machine, episode1(cpu=7))
    assert all(finding["found"] for finding in report["findings"])


GARBAGE = st.one_of(
    st.binary(max_size=200),
    st.sampled_from([b"", b"-1", b"0", b"9" * 19, b"1" * 5000, b"0-4095", b"0-99999999", b"0::/\0", b"nan", b"-0"]),
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["ifname", "linkinfo", "info_data", "info_kind", "state", "bittiming", "bitrate"]),
            inner | st.just("can0"),
        )
    ),
)


@settings(max_examples=examples(60), deadline=None)
@given(garbage=st.dictionaries(st.sampled_from(sorted(good_machine())), GARBAGE, min_size=1, max_size=4), links=JSON)
def test_garbage_in_any_file_is_no_crash(garbage: dict[str, bytes], links: Any) -> None:
    files: dict[str, Content] = {
        name: text for name, text in garbage.items() if not isinstance(good_machine()[name], Path)
    }
    with TemporaryDirectory() as folder:
        for arm in (None, episode1(cpu=7)):
            machine = build(Path(folder) / str(arm is None), files, can_links=lambda: links)
            report = examine(machine, arm)
            assert json.loads(json.dumps(report)) == report
            assert shown(report)


@given(st.frozensets(st.integers(0, 4095), max_size=40))
def test_lists_of_processors_are_read_back(cpus: frozenset[int]) -> None:
    assert cpu_list(",".join(map(str, cpus)), "x") == cpus


def test_spans_of_processors() -> None:
    assert cpu_list("0-2,5,7-8", "x") == {0, 1, 2, 5, 7, 8}
    assert cpu_list("", "x") == set()
    with pytest.raises(Unknown, match="no list of processors"):
        cpu_list("0-", "x")


# --- repair --------------------------------------------------------------------------------------------------

WRONG: dict[str, Content] = {
    "/sys/bus/usb-serial/devices/ttyUSB1/latency_timer": "16",
    f"{USB}/power/control": "auto",
    f"{CPU}/cpu0/cpufreq/scaling_governor": "powersave",
    f"{CPU}/cpu1/cpufreq/scaling_governor": "schedutil",
    "/sys/class/net/can0/tx_queue_len": "10",
    "/proc/sys/kernel/sched_rt_runtime_us": "0",
    "/proc/sys/vm/compact_unevictable_allowed": "1",
}


def contents(root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file() and path.exists()
    }


def test_nothing_is_written_unless_asked(tmp_path: Path) -> None:
    machine = build(tmp_path, WRONG)
    before = contents(tmp_path)
    report = examine(machine, episode1(cpu=7))
    assert (contents(tmp_path), report["changes"], report["healthy"]) == (before, [], False)


def test_fix_mends_and_says_how_to_undo_it(tmp_path: Path) -> None:
    machine = build(tmp_path, WRONG)
    before = contents(tmp_path)
    report = examine(machine, episode1(cpu=7), fix=True)
    assert (report["healthy"], report["refused"]) == (True, [])
    assert {change["path"]: change["before"] for change in report["changes"]} == WRONG
    assert machine.text("/sys/bus/usb-serial/devices/ttyUSB1/latency_timer") == "1"
    text = shown(report)
    for change in report["changes"]:
        assert f"echo {change['before']} | sudo tee {change['path']}" in text

    # The undo commands themselves, but for root and sudo.
    for change in report["changes"]:
        here = change["undo"].replace("sudo tee ", f"tee {tmp_path}")
        subprocess.run(["sh", "-c", here], check=True, stdout=subprocess.DEVNULL)
    undone = {name: content.strip() for name, content in contents(tmp_path).items()}
    assert undone == {name: content.strip() for name, content in before.items()}


def test_a_value_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    place(tmp_path / "sys/fixed", "1")
    machine = build(tmp_path)
    gone = repair(machine, [Write("/sys/nothing", "1")])
    assert gone.changes == []
    assert gone.refusals[0].startswith("/sys/nothing was not set to 1 (/sys/nothing cannot be read (No such file")
    assert not (tmp_path / "sys/nothing").exists()


def test_without_root_the_remedy_is_sudo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_arguments: object) -> int:
        raise PermissionError(13, "Permission denied")

    machine = build(tmp_path, WRONG)
    monkeypatch.setattr(os, "open", refuse)
    report = repair(machine, [Write("/sys/class/net/can0/tx_queue_len", "128")])
    assert report.refusals == [
        "/sys/class/net/can0/tx_queue_len was not set to 128 (Permission denied); "
        'run `sudo "$(command -v rtarm)" doctor --fix`.'
    ]


def test_a_value_that_the_kernel_changes_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = build(tmp_path, WRONG)
    real_write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, _value: real_write(descriptor, b"2"))
    done = repair(machine, [Write("/sys/bus/usb-serial/devices/ttyUSB1/latency_timer", "1")])
    assert [(change.before, change.after) for change in done.changes] == [("16", "2")]
    assert "was given 1, but says 2." in done.refusals[0]


def test_commands_group_the_files_of_one_value_and_quote() -> None:
    assert tee([Write("/a", "1"), Write("/b", "2"), Write("/c", "1")]) == (
        "echo 1 | sudo tee /a /c\necho 2 | sudo tee /b"
    )
    assert tee([Write("/a b", "x; rm")]) == "echo 'x; rm' | sudo tee '/a b'"


# --- what is shown -------------------------------------------------------------------------------------------


def test_the_report_begins_with_the_worst_and_never_breaks_a_command(tmp_path: Path) -> None:
    machine = build(tmp_path, {**WRONG, "/proc/loadavg": "9 9 9"}, **NO_FIFO)
    lines = shown(examine(machine, episode1(cpu=7))).splitlines()
    assert lines[0].startswith("this machine, for arm episode1: ")
    assert lines[0].endswith("6 to mend")
    levels = [
        line.split()[0] for line in lines if line.split()[:1] and line.split()[0] in {"bad", "warn", "note", "ok"}
    ]
    order = ["bad", "warn", "note", "ok"]
    assert levels == sorted(levels, key=order.index)
    assert f"      echo on | sudo tee {USB}/power/control" in lines
    assert "doctor --fix` sets real-time throttling" in " ".join(lines[-4:])


def test_json_has_all_that_is_shown(tmp_path: Path) -> None:
    report = json.loads(json.dumps(examine(build(tmp_path, WRONG), None)))
    assert (report["arm"], report["healthy"], report["level"]) == (None, False, "bad")
    assert [finding["name"] for finding in report["findings"]] == [check.name for check in CHECKS]
    timer = next(finding for finding in report["findings"] if finding["name"] == "latency timer")
    assert timer == {
        "name": "latency timer",
        "level": "warn",
        "found": "ttyUSB1 16 ms",
        "why": next(check.why for check in CHECKS if check.name == "latency timer"),
        "mend": "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB1/latency_timer",
        "fixable": True,
    }


def test_the_page_has_every_check_and_every_level() -> None:
    page = (ROOT / "docs" / "guides" / "doctor.md").read_text(encoding="utf-8")
    for check in CHECKS:
        assert f"| {check.name} | {check.why} |" in page
    for level, meaning in LEVEL_MEANINGS.items():
        assert f"| `{level.name.lower()}` | {meaning} |" in page


# --- this machine --------------------------------------------------------------------------------------------


def test_this_machine_as_it_is() -> None:
    report = examine(Machine(), load_arm("mock"))
    assert [finding["name"] for finding in report["findings"]] == [check.name for check in CHECKS]
    assert report["healthy"] == all(finding["level"] in {"ok", "note"} for finding in report["findings"])
    assert json.loads(json.dumps(report)) == report
    assert shown(report).startswith("this machine, for arm mock: ")


def test_the_trial_asks_in_a_process_of_its_own_and_leaves_nothing() -> None:
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    granted = try_permissions(1, min(before[1]))
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before
    assert granted.cpu_refusal is None
    assert granted.fifo == (granted.scheduling_refusal is None)
    assert try_permissions(1, 4095).cpu_refusal is not None


def test_more_than_there_can_be_is_not_locked() -> None:
    command = [sys.executable, "-I", "-S", trial.__file__, "1", str(1 << 50)]
    answer = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert (answer["locked"], type(answer["lock_refusal"])) == (False, str)


def test_ip_of_this_machine_is_understood() -> None:
    try:
        links = can_links()
    except Unknown as problem:
        assert "`ip`" in str(problem)
    else:
        assert isinstance(links, list)
