"""Checks of what the control process is allowed: real-time priority, locked memory, the machine to itself."""

from __future__ import annotations

import contextlib
import re
from pathlib import PurePosixPath

from config.schema import ArmConfig
from config.sections import RealtimeConfig
from rtarm.doctor.finding import Found, Level, Write, bad, note, ok, warn
from rtarm.doctor.machine import Granted, Machine, Unknown, cpu_list

USUAL_RT_RUNTIME_US = 950_000
LIMITS = (
    r"""printf "$USER - %s\n" 'rtprio 90' 'memlock unlimited' | sudo tee /etc/security/limits.d/90-rtarm.conf"""
    "   # then log in again"
)
CONTAINER_MARKS = re.compile(r"docker|containerd|kubepods|libpod|lxc|nspawn|garden")
DEADLINE_POLICY = 6
REAL_TIME_POLICIES = (1, 2, DEADLINE_POLICY)


def wanted(arm: ArmConfig | None) -> RealtimeConfig:
    """The scheduling the arm's file asks for, or what one without that section would."""
    return RealtimeConfig() if arm is None else arm.realtime


def granted(machine: Machine, arm: ArmConfig | None) -> Granted:
    """What the system gives a trial process of what the arm asks for."""
    return machine.trial(wanted(arm).priority, wanted(arm).cpu)


def container_kind(machine: Machine) -> str | None:
    """What container this is; None outside of one."""
    for mark, kind in (("/.dockerenv", "Docker"), ("/run/.containerenv", "Podman")):
        if machine.exists(mark):
            return kind
    if "container" in machine.environment:  # systemd and Podman say it so
        return machine.environment["container"] or "unnamed"
    found = CONTAINER_MARKS.search(machine.text("/proc/1/cgroup"))
    return None if found is None else found.group()


def in_container(machine: Machine) -> bool:
    with contextlib.suppress(Unknown):
        return container_kind(machine) is not None
    return False


def real_time_priority(machine: Machine, arm: ArmConfig | None) -> Found:
    priority = wanted(arm).priority
    got = granted(machine, arm)
    if got.scheduling_refusal is not None:
        return bad(f"SCHED_FIFO {priority} refused ({got.scheduling_refusal})", _scheduling_mend(machine))
    if not got.fifo or got.priority != priority:
        return bad(f"SCHED_FIFO {priority} was granted, but is not kept", _scheduling_mend(machine))
    return ok(f"SCHED_FIFO {priority} granted{_as_root(machine)}")


def _as_root(machine: Machine) -> str:
    return " (to root: ask again as the user who runs the arm, if that is another)" if machine.is_root else ""


def _scheduling_mend(machine: Machine) -> str:
    with contextlib.suppress(Unknown):
        for file in (f"{folder}/cpu.rt_runtime_us" for folder in cgroup_folders(machine, "cpu")):
            if machine.exists(file) and machine.number(file) == 0:
                return f"echo {USUAL_RT_RUNTIME_US} | sudo tee {file}"
    if in_container(machine):
        return "# start the container with: docker run --cap-add=SYS_NICE --ulimit rtprio=90 …"
    return LIMITS


def locked_memory(machine: Machine, arm: ArmConfig | None) -> Found:
    got = granted(machine, arm)
    if got.locked:
        return ok(f"32 MiB can be locked{_as_root(machine)}")
    mend = "# start the container with: docker run --cap-add=IPC_LOCK --ulimit memlock=-1 …"
    reason = got.lock_refusal or "agreed to, but not done"
    return warn(
        f"32 MiB cannot be locked ({reason}); the limit is {_memlock_limit(machine)}",
        mend if in_container(machine) else LIMITS,
    )


def _memlock_limit(machine: Machine) -> str:
    with contextlib.suppress(Unknown):
        found = re.search(r"^Max locked memory +([0-9]{1,18}|unlimited)", machine.text("/proc/self/limits"), re.M)
        if found is not None:
            return found.group(1) if found.group(1) == "unlimited" else f"{int(found.group(1)) / 2**20:.3g} MiB"
    return "unknown"


def real_time_throttling(machine: Machine, _arm: ArmConfig | None) -> Found:
    path = "/proc/sys/kernel/sched_rt_runtime_us"
    runtime_us = machine.number(path)
    period_us = machine.number("/proc/sys/kernel/sched_rt_period_us")
    if runtime_us < 0:
        return note("off: a real-time thread that runs wild takes its processor for good")
    if period_us <= 0:
        raise Unknown(f"sched_rt_period_us is {period_us}")
    share = f"{runtime_us / 1000:g} of every {period_us / 1000:g} ms for real-time threads"
    fix = (Write(path, str(min(USUAL_RT_RUNTIME_US, round(0.95 * period_us)))),)
    if runtime_us == 0:
        return bad(share, fix=fix)
    return warn(share, fix=fix) if runtime_us < period_us / 2 else ok(share)


def threads_above(machine: Machine, arm: ArmConfig | None) -> Found:
    priority = wanted(arm).priority
    above = [
        thread
        for thread in machine.threads()
        if not thread.of_kernel
        and thread.policy in REAL_TIME_POLICIES
        and (thread.policy == DEADLINE_POLICY or thread.priority > priority)
    ]
    if not above:
        return ok(f"no program's thread is above {priority}")
    names = ", ".join(f"{thread.name} ({thread.tid}) {thread.priority}" for thread in above[:5])
    more = f" and {len(above) - 5} more" if len(above) > 5 else ""
    lower = f"sudo chrt --fifo --pid {max(priority - 10, 1)} {above[0].tid}   # if it computes for long"
    return note(f"above {priority}: {names}{more}", lower)


def container(machine: Machine, _arm: ArmConfig | None) -> Found:
    kind = container_kind(machine)
    said = "none" if kind is None else f"{kind} container"
    with contextlib.suppress(Unknown):
        if machine.own("Seccomp") == "2":
            said += ", system calls filtered (seccomp)"
    allowed = machine.own("Cpus_allowed_list")
    level = Level.OK if kind is None else Level.NOTE
    with contextlib.suppress(Unknown):
        folder = "/sys/devices/system/cpu"
        online = machine.cpus(f"{folder}/online")
        isolated = machine.cpus(f"{folder}/isolated") if machine.exists(f"{folder}/isolated") else frozenset()
        if online - isolated - cpu_list(allowed, "Cpus_allowed_list"):
            said += f", CPUs {allowed} of {machine.text(f'{folder}/online')}"
            level = Level.NOTE
    quota = _quota(machine)
    if quota is not None:
        folder, share = quota
        return warn(f"{said}, at most {share:.3g} processors' time", _without_quota(machine, folder, kind))
    return Found(level, f"{said}, no limit of processor time")


def cgroup_folders(machine: Machine, controller: str) -> list[str]:
    """Folders of this process' control groups that a controller rules, the own one first, then its parents."""
    folders: list[str] = []
    for line in machine.text("/proc/self/cgroup").splitlines():
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers == "":
            root = PurePosixPath("/sys/fs/cgroup")
        elif controller in controllers.split(","):
            root = PurePosixPath("/sys/fs/cgroup") / controllers
        else:
            continue
        own = root / path.lstrip("/")
        if ".." in own.parts:  # outside of this name space
            own = root
        folders += [str(folder) for folder in (own, *own.parents) if folder.is_relative_to(root)]
    return folders


def _quota(machine: Machine) -> tuple[str, float] | None:
    """The tightest limit of processor time (in processors) and the folder that sets it."""
    # In a name space of its own a process does not see all the folders above.
    limits = [(_share(machine, folder), folder) for folder in cgroup_folders(machine, "cpu") if machine.exists(folder)]
    if not limits:
        raise Unknown("no control group of this process can be read")
    share, folder = min(limits)
    return None if share == float("inf") else (folder, share)


def _share(machine: Machine, folder: str) -> float:
    """Processors' worth of time a group may use; infinite without a limit."""
    if machine.exists(f"{folder}/cpu.max"):
        quota_us, _, period_us = machine.text(f"{folder}/cpu.max").partition(" ")
        if quota_us == "max":
            return float("inf")
    elif machine.exists(f"{folder}/cpu.cfs_quota_us"):
        quota_us, period_us = (machine.text(f"{folder}/cpu.cfs_{part}_us") for part in ("quota", "period"))
    else:  # the topmost group has no file, and no limit
        return float("inf")
    if re.fullmatch(r"-[0-9]+", quota_us):
        return float("inf")
    if re.fullmatch(r"[0-9]{1,15}", quota_us) is None or re.fullmatch(r"0*[1-9][0-9]{0,14}", period_us) is None:
        raise Unknown(f"the limit of processor time in {folder} cannot be understood")
    return int(quota_us) / int(period_us)


def _without_quota(machine: Machine, folder: str, kind: str | None) -> str:
    if kind is not None:
        return "# start the container without --cpus and --cpu-quota"
    if machine.exists(f"{folder}/cpu.max"):
        return f"echo max | sudo tee {folder}/cpu.max"
    return f"echo -1 | sudo tee {folder}/cpu.cfs_quota_us"
