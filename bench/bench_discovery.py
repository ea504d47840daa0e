"""How soon a new process is known, with ROS' own settings in the range LOCALHOST and with rtarm's profile, in turns.

Beside busy processors as well: there Fast DDS loses more of the answers to a newcomer's first words.
"""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rosfront import transport
from rtarm.launch.own_domain import own_domain

ROOT = Path(__file__).parents[1]
TURNS, NEWCOMERS = 4, 10


def surroundings(settings: str) -> dict[str, str]:
    """The environment of older node and newcomers."""
    unset = (transport.PROFILES, transport.NO_OTHER_PROFILE, transport.TRANSPORTS)
    environment = {name: value for name, value in os.environ.items() if name not in unset} | own_domain()
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *sys.path])
    if settings == "rtarm's":
        transport.choose_udp(environment, transport.FAST_DDS)
    else:
        environment[transport.TRANSPORTS] = transport.UDP
    return environment


@contextlib.contextmanager
def busy(programs: int) -> Iterator[None]:
    """Programs that want a processor each."""
    with contextlib.ExitStack() as ends:
        for _ in range(programs):
            program = subprocess.Popen(["nice", sys.executable, "-c", "while True: pass"])
            ends.callback(program.wait)
            ends.callback(program.kill)
        yield


def slice_of(settings: str) -> list[float]:
    """How long each newcomer was unknown, in ms."""
    command = [sys.executable, "-m", "bench.newcomers", str(NEWCOMERS)]
    done = subprocess.run(command, cwd=ROOT, env=surroundings(settings), stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("programs", [0, os.cpu_count()], ids=["idle", "busy"])
def test_how_soon_a_new_process_is_known(benchmark, report, programs):
    def measure():
        with busy(programs):
            return [{settings: slice_of(settings) for settings in ("ROS'", "rtarm's")} for _ in range(TURNS)]

    turns = benchmark.pedantic(measure, rounds=1)
    benchmark.extra_info["turns"] = turns
    beside = f"beside {programs} busy programs" if programs else "on idle processors"
    report("a new process is known", f"{beside}: p50, p90, longest (ms); later than 0.5 s")
    for settings in turns[0]:
        late_ms = np.concatenate([turn[settings] for turn in turns])
        p50, p90, longest = np.percentile(late_ms, (50, 90, 100))
        late = np.count_nonzero(late_ms > 500.0)
        report(f"  {settings} settings", f"{p50:.0f}, {p90:.0f}, {longest:.0f}; {late} of {len(late_ms)}")
