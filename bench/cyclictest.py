"""cyclictest of Debian's rt-tests: what the machine does to a program in C that only sleeps."""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np

ABSENT = "cyclictest is not installed (Debian: apt-get install rt-tests), so the machine's own lateness is not shown"
HISTOGRAM_US = 100_000
_ROW = re.compile(r"^(\d{6}) (\d+)$", re.MULTILINE)
_MOST = re.compile(r"^# Max Latencies: (\d+)$", re.MULTILINE)
_BEYOND = re.compile(r"^# Histogram Overflows: (\d+)$", re.MULTILINE)
_SPIKE = re.compile(r"^T: +0 Spike: +(\d+): TS: +(\d+)$", re.MULTILINE)


class Cyclictest:
    """One thread that sleeps, until its duration is over.

    Attributes, after `end`:
        late_us: lateness in whole microseconds, and how often it occurred, (n, 2).
        max_us: the largest.
        spikes_ns: from when until when it overslept by more than `spike_us`, CLOCK_MONOTONIC, (n, 2).
    """

    def __init__(
        self, *, priority: int, period_us: int, seconds: int, cpu: int | None = None, spike_us: int | None = None
    ) -> None:
        """Begin. `seconds` are whole ones."""
        command = ["cyclictest", "-q", "-m", "-t", "1", "-h", str(HISTOGRAM_US)]
        command += ["-p", str(priority), "-i", str(period_us), "-D", str(seconds)]
        command += [] if cpu is None else ["-a", str(cpu)]
        command += [] if spike_us is None else [f"--spike={spike_us}", "--spike-nodes=100000"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)

    @property
    def pid(self) -> int:
        return self._process.pid

    def end(self) -> None:
        """Wait for its end, and read what it says."""
        text = self._process.communicate()[0]
        assert self._process.returncode == 0, text
        beyond, self.max_us = (int(pattern.search(text)[1]) for pattern in (_BEYOND, _MOST))
        rows = [(int(late), int(count)) for late, count in _ROW.findall(text) if int(count)]
        self.late_us = np.array([*rows, *([(self.max_us, beyond)] if beyond else [])], np.int64).reshape(-1, 2)
        spikes = np.array([(int(late), int(at)) for late, at in _SPIKE.findall(text)], np.int64).reshape(-1, 2)
        self.spikes_ns = np.stack([spikes[:, 1] - spikes[:, 0], spikes[:, 1]], axis=1) * 1000

    def close(self) -> None:
        """End it now, if it has not ended."""
        if self._process.returncode is None:
            self._process.kill()
            self._process.communicate()


def installed() -> bool:
    return shutil.which("cyclictest") is not None


def percentiles_us(late_us: np.ndarray, *wanted: float) -> dict[str, float]:
    """Percentiles by name, and the largest value, of values and their counts, (n, 2)."""
    late_us = late_us[late_us[:, 0].argsort()]
    counts = np.cumsum(late_us[:, 1])
    ranks = np.ceil(np.array(wanted) / 100 * counts[-1]).clip(1)
    found = late_us[np.searchsorted(counts, ranks), 0]
    named = {f"p{p:g}": float(value) for p, value in zip(wanted, found, strict=True)}
    return {**named, "max": float(late_us[-1, 0])}
