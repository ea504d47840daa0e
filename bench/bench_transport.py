"""What UDP costs instead of the shared memory of Fast DDS: the same arm with either in turn, in processes of their own.

A mock arm at 120 Hz, its front, and a client in a third process. A noisy neighbour hits both: each slice by UDP is
compared with the one by shared memory that follows it.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from slices import spread

ROOT = Path(__file__).parents[1]
TURNS = 6
TRANSPORTS = {"UDP": "UDPv4", "shared memory": "DEFAULT"}


def slice_of(folder: Path, transport: str) -> dict[str, float]:
    """The figures of `transport_slice`, by name."""
    folder.mkdir()
    unset = ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment["FASTDDS_BUILTIN_TRANSPORTS"] = TRANSPORTS[transport]
    environment["PYTHONPATH"] = os.pathsep.join(map(str, (ROOT, ROOT / "bench", ROOT / "tests")))
    done = subprocess.run(
        [sys.executable, "-m", "bench.transport_slice", str(folder)],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(1200)
def test_udp_instead_of_shared_memory(benchmark, report, tmp_path):
    def measure():
        return [{name: slice_of(tmp_path / f"{turn}-{name}", name) for name in TRANSPORTS} for turn in range(TURNS)]

    turns = benchmark.pedantic(measure, rounds=1)
    benchmark.extra_info["turns"] = turns
    report("UDP / shared memory in turns, median (lowest to highest)", f"{TURNS} turns; UDP and shared memory alone")
    for figure in turns[0]["UDP"]:
        by_udp, shared = ([turn[name][figure] for turn in turns] for name in TRANSPORTS)
        ratios = [a / b for a, b in zip(by_udp, shared, strict=True)]
        report(f"  {figure}", f"{spread(ratios)}; {spread(by_udp)} and {spread(shared)}")
