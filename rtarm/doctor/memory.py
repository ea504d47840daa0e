"""Checks of memory and disk: swap, the memory files' folder, room for compiled code."""

from __future__ import annotations

import os
from pathlib import Path
from shlex import quote

from config.schema import ArmConfig
from rtarm.doctor.finding import Found, bad, note, ok, warn
from rtarm.doctor.machine import Machine, Unknown
from rtarm.doctor.permissions import granted, in_container
from shm import layout

SHARED_MEMORY = "/dev/shm"
SPARE_SHARED_BYTES = 16 << 20
"""What ROS' middleware wants there besides the arm's files."""
LEAST_DISK_BYTES = 200 << 20
USED_FIELD = 3


def swap(machine: Machine, arm: ArmConfig | None) -> Found:
    rows = [line.split() for line in machine.text("/proc/swaps").splitlines()[1:]]
    if not rows:
        return ok("none")
    try:
        used_mib = sum(int(row[USED_FIELD]) for row in rows) / 1024
    except (ValueError, IndexError):
        raise Unknown("/proc/swaps cannot be understood") from None
    swappiness = machine.number("/proc/sys/vm/swappiness")
    said = f"{used_mib:.0f} MiB in use, vm.swappiness {swappiness}"
    if not granted(machine, arm).locked:
        return warn(f"{said}, and the control process cannot lock its memory", "sudo swapoff -a")
    said += "; the control process locks its memory, so only the ROS process can be paged out"
    return note(said, "sudo swapoff -a && sudo swapon -a") if used_mib >= 1 else ok(said)


def shared_memory(machine: Machine, arm: ArmConfig | None) -> Found:
    path = machine.path(SHARED_MEMORY)
    if not path.is_dir():
        return bad(f"{SHARED_MEMORY} is not there", f"sudo mount -t tmpfs -o mode=1777 tmpfs {SHARED_MEMORY}")
    if not machine.may_access(path, os.R_OK | os.W_OK | os.X_OK):
        return bad(f"{SHARED_MEMORY} may not be written", f"sudo chmod 1777 {SHARED_MEMORY}")
    free, total = _room(machine, path)
    if total == 0:  # tmpfs with size=0, or ramfs
        return ok("no limit")
    said = f"{free / 2**20:.0f} of {total / 2**20:.0f} MiB free"
    state_bytes = layout.StateFile.dtype.itemsize if arm is None else _rings(arm).file_bytes
    arm_bytes = 2 * state_bytes + layout.CommandFile.dtype.itemsize  # a dead control process' state is kept
    larger = f"sudo mount -o remount,size=512M {SHARED_MEMORY}"
    if in_container(machine):
        larger = "# start the container with: docker run --shm-size=512m …"
    if free < arm_bytes:
        return bad(f"{said}, an arm needs {arm_bytes / 2**20:.1f}", larger)
    if free < arm_bytes + SPARE_SHARED_BYTES:
        return warn(f"{said}, too little for ROS' middleware besides an arm", larger)
    if not _is_tmpfs(machine):
        return warn(f"{said}, but not in memory (no tmpfs)", f"sudo mount -t tmpfs -o mode=1777 tmpfs {SHARED_MEMORY}")
    return ok(said)


def _rings(arm: ArmConfig) -> layout.Rings:
    bitrates = [] if arm.bus.interface == "mock" else [bus.bitrate for bus in arm.buses]
    return layout.rings(len(arm.joints), arm.control.period_ns, *bitrates)


def _is_tmpfs(machine: Machine) -> bool:
    mounts = [line.split() for line in machine.text("/proc/mounts").splitlines()]
    return any(mount[1:3] == [SHARED_MEMORY, "tmpfs"] for mount in mounts)


def disk(machine: Machine, _arm: ArmConfig | None) -> Found:
    folder = cache_folder(machine)
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    free, _ = _room(machine, folder)
    said = f"{free / 2**30:.1f} GiB free where compiled code is kept"
    return warn(said, f"df -h {quote(str(folder))}   # make room there") if free < LEAST_DISK_BYTES else ok(said)


def cache_folder(machine: Machine) -> Path:
    """Where compiled code of all versions is kept."""
    base = machine.environment.get("XDG_CACHE_HOME")
    home = machine.environment.get("HOME", "/")
    return machine.path(base or f"{home}/.cache") / "rtarm"


def _room(machine: Machine, path: Path) -> tuple[int, int]:
    """Free and whole size of the file system (bytes)."""
    found = machine.space(path)
    return found.f_bavail * found.f_frsize, found.f_blocks * found.f_frsize
