"""On what a benchmark ran, so that its figures can be judged."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = {
    "rtarm": ("rtarm",),
    "numba": ("numba",),
    "llvmlite": ("llvmlite",),
    "numpy": ("numpy",),
    "rclpy": ("ros-jazzy-rclpy", "rclpy"),
    "python-can": ("python-can",),
    "loop-rate-limiters": ("loop-rate-limiters",),
}
"""Packages and the names under which they may be installed."""
PROGRAMS = {"cyclictest": "--help", "stress-ng": "--version"}
_VERSION = re.compile(r"\bV(?:ersion)?\s*(\d[\w.]*)", re.IGNORECASE)
PROGRAM_S = 10.0


def machine() -> dict[str, Any]:
    """Processor, memory, kernel and how busy all of it is; what cannot be read is None."""
    cpu = _text("/proc/cpuinfo")
    model = re.search(r"^(?:model name|Model)\s*:\s*(.+)$", cpu, re.MULTILINE)
    memory = re.search(r"^MemTotal:\s+(\d+) kB", _text("/proc/meminfo"), re.MULTILINE)
    return {
        "architecture": platform.machine(),
        "processor": model[1] if model else None,
        "processors": os.cpu_count(),
        "virtual": bool(re.search(r"^flags\s*:.*\bhypervisor\b", cpu, re.MULTILINE)),
        "memory_mb": int(memory[1]) // 1024 if memory else None,
        "kernel": os.uname().release,
        "kernel_build": os.uname().version,
        "clock_source": _text("/sys/devices/system/clocksource/clocksource0/current_clocksource").strip() or None,
        "governor": _text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").strip() or None,
        "load_average": list(os.getloadavg()),
    }


def versions() -> dict[str, str | None]:
    """Versions of what takes part; None for what is not installed."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    found |= {name: _installed(names) for name, names in PACKAGES.items()}
    return found | {name: _program(name, option) for name, option in PROGRAMS.items()}


def _installed(names: tuple[str, ...]) -> str | None:
    for name in names:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return None


def _program(name: str, option: str) -> str | None:
    if shutil.which(name) is None:
        return None
    try:
        told = subprocess.run([name, option], capture_output=True, text=True, check=False, timeout=PROGRAM_S)
    except (OSError, subprocess.TimeoutExpired):
        return None
    found = _VERSION.search(told.stdout + told.stderr)
    return found[1] if found else "unknown"


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
