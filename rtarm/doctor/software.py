"""Checks of the software around the arm: Python and its compiler, the compiled cycle, ROS' surroundings."""

from __future__ import annotations

import shlex
import sys
from importlib.metadata import PackageNotFoundError, version

from config.schema import ArmConfig
from rtarm.doctor.finding import Found, bad, note, ok, together, warn
from rtarm.doctor.machine import Machine, Unknown, settled

PYTHONS = ((3, 11), (3, 13))
PACKAGES = ("numba", "llvmlite", "numpy")
HIGHEST_DOMAIN = 232
SAFE_DOMAINS = 101
"""Domains above it use ports that Linux hands out to anybody, up to 215."""
SAFE_AGAIN = 215
RANGES = ("OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT")
MULTICAST, UP, LOOPBACK = 0x1000, 0x1, 0x8


def python(machine: Machine, _arm: ArmConfig | None) -> Found:
    parts = [_interpreter(sys.version_info[:2]), *map(_package, PACKAGES)]
    if machine.environment.get("NUMBA_DISABLE_JIT", "0") not in {"", "0"}:
        parts.append(bad("NUMBA_DISABLE_JIT is set, so nothing is compiled", "unset NUMBA_DISABLE_JIT"))
    if machine.environment.get("NUMBA_BOUNDSCHECK", "0") not in {"", "0"}:
        parts.append(warn("NUMBA_BOUNDSCHECK is set, so compiled code is slow", "unset NUMBA_BOUNDSCHECK"))
    return together(parts)


def _interpreter(found: tuple[int, int]) -> Found:
    said = f"Python {found[0]}.{found[1]}"
    if PYTHONS[0] <= found <= PYTHONS[1]:
        return ok(said)
    return bad(f"{said}, rtarm needs 3.11 to 3.13", "make clean env PYTHON=python3.12")


def _package(name: str) -> Found:
    try:
        return ok(f"{name} {version(name)}")
    except PackageNotFoundError:
        return bad(f"no {name}", f"{shlex.quote(sys.executable)} -m pip install {name}")


def compiled_cycle(machine: Machine, _arm: ArmConfig | None) -> Found:
    folder = machine.compiled_folder()
    if (folder / "cycle.o").exists():
        return ok("in the cache")
    return note(
        "not in the cache, so the first start of an arm waits for the compiler",
        f"{shlex.quote(sys.executable)} -m rtloop.warm",
    )


def ros(machine: Machine, arm: ArmConfig | None) -> Found:
    return together([_domain(machine), settled(lambda: _discovery(machine, arm))])


def _domain(machine: Machine) -> Found:
    text = machine.environment.get("ROS_DOMAIN_ID", "")
    try:
        number = int(text or "0")
    except ValueError:
        number = -1
    if not 0 <= number <= HIGHEST_DOMAIN:
        said = f"ROS_DOMAIN_ID is {text[:40]!r}, but must be 0 to {SAFE_DOMAINS}"
        return bad(said, "export ROS_DOMAIN_ID=0")
    if SAFE_DOMAINS < number < SAFE_AGAIN:
        return warn(f"domain {number}, whose ports Linux may give to other programs", "export ROS_DOMAIN_ID=0")
    return ok(f"domain {number}")


def _discovery(machine: Machine, arm: ArmConfig | None) -> Found:
    """How far ROS looks for others, and whether the network carries it; a firewall is not looked for."""
    localhost_only = machine.environment.get("ROS_LOCALHOST_ONLY", "0") == "1"
    chosen = machine.environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    reach = "LOCALHOST" if localhost_only else chosen or ("localhost" if arm is None else arm.front.discovery).upper()
    if reach not in RANGES:
        said = f"ROS_AUTOMATIC_DISCOVERY_RANGE is {reach[:40]!r}, but must be one of {', '.join(RANGES)}"
        return bad(said, "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST")
    said = f"discovery {reach}{' (ROS_LOCALHOST_ONLY)' if localhost_only else ''}"
    if reach == "OFF":
        return warn(f"{said}: MoveIt will not find the arm", "unset ROS_AUTOMATIC_DISCOVERY_RANGE")
    flags = {name: machine.number(f"/sys/class/net/{name}/flags", 16) for name in _interfaces(machine)}
    if reach == "LOCALHOST":
        return _loopback(said, flags)
    if any(flag & UP and flag & MULTICAST and not flag & LOOPBACK for flag in flags.values()):
        return ok(f"{said}, a network with multicast")
    return warn(
        f"{said}, but no network interface that is up has multicast", "ip link   # then: sudo ip link set NAME up"
    )


def _interfaces(machine: Machine) -> list[str]:
    return [name for name in machine.names("/sys/class/net") if machine.exists(f"/sys/class/net/{name}/flags")]


def _loopback(said: str, flags: dict[str, int]) -> Found:
    if "lo" not in flags:
        raise Unknown("there is no loopback interface lo")
    if not flags["lo"] & UP:
        return bad(f"{said}, but lo is down", "sudo ip link set lo up")
    if not flags["lo"] & MULTICAST:
        lacking = f"{said}, lo without multicast (Fast DDS does without it, other middleware may not)"
        return note(lacking, "sudo ip link set lo multicast on")
    return ok(f"{said}, lo with multicast")
