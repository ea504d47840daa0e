"""What `rtarm view` costs the control process: a page that loads, and a page that is looked at, at 1 kHz.

The arm is a mock arm with episode1's shape, moving all the time, so that the page has something to draw and nothing but
the cycle is measured. Slices without and with a page alternate and are compared as `slices` says; "without" is without
the page's process too. Three kinds of slices, in one run:

- viewed from elsewhere: the page's process with a plain client that takes everything and draws nothing, as a browser on
  another machine would seem from here;
- page loads here: a Chromium on this machine loads the page again and again, each time until it shows the arm;
- viewed here: that Chromium looks at the page. It has no graphics card and draws by processor, the worst there is.

What the page's process and Chromium use themselves is read from the kernel: shares of one core.

    python -m pytest bench/bench_view.py            # a minute of each kind and priority, about twenty minutes
    python -m pytest bench/bench_view.py --quick    # about two
"""

import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")
pytest.importorskip("viser")
pytest.importorskip("selenium")

from browser import CHROMIUM, DRIVER, OPTIONS
from control_msgs.action import FollowJointTrajectory
from live import NAMES, TICKS_A_SECOND, LiveStack, Usage, commanded_rad, goal_to, live, point
from plain_viewer import PlainViewer
from ros_client import until
from selenium import webdriver
from selenium.webdriver.support.ui import WebDriverWait
from slices import SLICE_S, Before, Slice, compare, slice_of, spread, without_priority
from stack import Process

from config.loader import ARMS_FOLDER
from rtarm.running.requests import clear_fault
from shm.words import Mode

pytestmark = pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="no chromium and chromedriver here")

RATE_HZ = 1000.0
ROUNDS, QUICK_ROUNDS = 12, 2
PATIENCE_S = 120.0
SWING_RAD = 0.1
SWING_S = 8.0
GOAL_S = 3600
"""Whole swings, so that it ends at rest."""
SHOWN = (
    "return Boolean(document.querySelector('#rt-mode')?.textContent && document.querySelector('canvas[data-engine]'))"
)

ELSEWHERE, LOADS, HERE = "viewed from elsewhere", "page loads here", "viewed here"


@dataclass
class Found:
    """All slices, and beside each with a page what else was seen meanwhile."""

    alone: list[Slice] = field(default_factory=list)
    watched: dict[str, list[Before]] = field(default_factory=lambda: {ELSEWHERE: [], LOADS: [], HERE: []})
    page_core: dict[str, list[float]] = field(default_factory=lambda: {ELSEWHERE: [], LOADS: [], HERE: []})
    browser_core: dict[str, list[float]] = field(default_factory=lambda: {LOADS: [], HERE: []})
    received: list[tuple[float, float]] = field(default_factory=list)
    """Messages and bytes a second that the client elsewhere got."""
    load_s: list[float] = field(default_factory=list)


class Swinging:
    """Keeps an arm in motion from slice to slice; a machine that is much too busy may end a goal."""

    def __init__(self, stack: LiveStack) -> None:
        self.ended: list[str] = []
        """With which sentences goals have ended too early."""
        self._stack, self._home = stack, commanded_rad(stack)
        self._begin()

    def go_on(self) -> None:
        """The arm moves, if need be again."""
        if self._stack.reader.snapshot()["goal_id"]:
            return
        self.ended.append(self._stack.client.result(self._handle)[2])
        if self._stack.reader.snapshot()["mode"] == Mode.FAULT:
            clear_fault(self._stack.name)
        self._stack.client.run(goal_to(self._home, SWING_S))
        self._begin()

    def end(self) -> None:
        self._handle.cancel_goal_async()

    def _begin(self) -> None:
        self._handle = self._stack.client.send(swings(self._home))
        until(lambda: self._stack.reader.snapshot()["goal_id"], "the beginning of the motion")


class Measuring:
    """Takes one slice after the other of one arm."""

    def __init__(self, stack: LiveStack) -> None:
        self._stack = stack
        self.motion = Swinging(stack)
        self.found = Found()

    def alone(self) -> None:
        self.motion.go_on()
        self.found.alone.append(slice_of(self._stack))

    def from_elsewhere(self) -> None:
        with page(self._stack) as (process, url), PlainViewer(url) as viewer:
            viewer.wait_for_page()
            begun, messages, received = time.monotonic(), viewer.messages, viewer.received_bytes
            self._slice(ELSEWHERE, process)
            seconds = time.monotonic() - begun
        self.found.received.append(
            ((viewer.messages - messages) / seconds, (viewer.received_bytes - received) / seconds)
        )

    def from_here(self) -> None:
        with page(self._stack) as (process, url), chromium() as driver:

            def load() -> None:
                enough_s = time.monotonic() + SLICE_S
                while (begun := time.monotonic()) < enough_s:
                    driver.get(url)
                    WebDriverWait(driver, PATIENCE_S, 0.1).until(lambda seen: seen.execute_script(SHOWN))
                    self.found.load_s.append(time.monotonic() - begun)

            self._slice(LOADS, process, driver, load)
            self._slice(HERE, process, driver)

    def _slice(self, kind: str, process: Process, driver: webdriver.Chrome | None = None, during=None) -> None:
        """A slice with a page; `during` is what happens meanwhile, nothing by default."""
        self.motion.go_on()
        pid = None if driver is None else driver.service.process.pid
        begun, page_s, browser_s = time.monotonic(), Usage(process).processor_s, 0.0 if pid is None else tree_s(pid)
        found = slice_of(self._stack) if during is None else slice_of(self._stack, during)
        seconds = time.monotonic() - begun
        self.found.watched[kind].append((len(self.found.alone) - 1, found))
        self.found.page_core[kind].append((Usage(process).processor_s - page_s) / seconds)
        if pid is not None:
            self.found.browser_core[kind].append((tree_s(pid) - browser_s) / seconds)


@contextmanager
def page(stack: LiveStack) -> Iterator[tuple[Process, str]]:
    """The page's process, as `rtarm up --view` starts it, and its address."""
    process = Process("rtarm.view", str(stack.arm_file))
    try:
        yield process, process.line_with("ready ").removeprefix("ready ")
    finally:
        process.close()


@contextmanager
def chromium() -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for option in OPTIONS:
        options.add_argument(option)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    driver.set_script_timeout(PATIENCE_S)
    try:
        yield driver
    finally:
        driver.quit()


def tree_s(root: int) -> float:
    """Processor time that a process and all below it have used (s), what they have waited for included."""
    parents, used = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                words = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it has ended
                continue
            parents[int(entry.name)] = int(words[1])
            used[int(entry.name)] = sum(map(int, words[11:15])) / TICKS_A_SECOND
    tree = {root}
    while below := {pid for pid, parent in parents.items() if parent in tree} - tree:
        tree |= below
    return sum(used.get(pid, 0.0) for pid in tree)


def shape() -> dict[str, object]:
    """Section `kinematics` of episode1, whose joints the mock arm has."""
    return yaml.safe_load((ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8"))["kinematics"]


def swings(home: np.ndarray):
    """A goal that swings all joints to and fro for longer than the benchmark lasts."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = NAMES
    turn = 2.0 * np.pi / SWING_S
    goal.trajectory.points = [
        point(
            time_s,
            home + SWING_RAD * (1.0 - np.cos(turn * time_s)),
            np.full(len(home), SWING_RAD * turn * np.sin(turn * time_s)),
        )
        for time_s in range(1, GOAL_S + 1)
    ]
    return goal


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("priority", ["real-time", "ordinary"])
def test_view(benchmark, report, quick, tmp_path, priority):
    rounds = QUICK_ROUNDS if quick else ROUNDS
    if quick and priority == "ordinary":
        pytest.skip("the short form has the real-time priority alone")

    def measure() -> tuple[Found, list[str]]:
        with live(tmp_path, mock_hz=RATE_HZ, settings={"kinematics": shape()}) as stack:
            if priority == "ordinary":
                without_priority(stack)
            measuring = Measuring(stack)
            measuring.alone()
            for _ in range(rounds):
                measuring.from_elsewhere()
                measuring.alone()
                measuring.from_here()
                measuring.alone()
            measuring.motion.end()
            return measuring.found, measuring.motion.ended

    found, ended = benchmark.pedantic(measure, rounds=1)
    report(f"1 kHz mock arm in motion, {priority} priority: with / without a page", f"slices of {SLICE_S:g} s")
    for kind, watched in found.watched.items():
        report(f" {kind}", f"{len(watched)} slices")
        benchmark.extra_info[kind] = compare(report, found.alone, watched)
        cores = f"the page's process {in_percent(found.page_core[kind])} of a core"
        if kind in found.browser_core:
            cores += f", Chromium {in_percent(found.browser_core[kind])}"
        report("  processor", cores)
    if ended:
        report("  the motion ended too early, and was begun again", f"{len(ended)} times: {'; '.join(set(ended))}")
    messages, received = (statistics.median(one) for one in zip(*found.received, strict=True))
    report("  sent to one viewer", f"{messages:.0f} messages/s, {received / 1e3:.0f} kB/s")
    report("  a page load, from the address to the arm", f"{spread(found.load_s)} s, {len(found.load_s)} of them")
    benchmark.extra_info.update(
        page_core=found.page_core,
        browser_core=found.browser_core,
        received=found.received,
        load_s=found.load_s,
        ended=ended,
    )


def in_percent(shares: list[float]) -> str:
    return f"{100 * statistics.median(shares):.0f} % ({100 * min(shares):.0f} to {100 * max(shares):.0f})"
