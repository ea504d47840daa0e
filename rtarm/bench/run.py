"""`rtarm bench`: slices of all competitors in turn, at each rate, idle and loaded, again and again."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path

from config.budget import budget
from config.loader import load_arm
from config.sections import RealtimeConfig
from rtarm.bench import plot
from rtarm.bench.competitors import FASTEST_BUS, Bench, Competitor, GoalClient, cyclictest, everybody
from rtarm.bench.load import described, loaded
from rtarm.bench.machine import machine, versions
from rtarm.bench.report import render
from rtarm.bench.results import LOADS, WHO, Measurements, Slice, document
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted, interruptible
from rtarm.console.reporter import Reporter
from rtarm.launch.own_domain import own_domain
from rtarm.launch.plan import check_ros
from rtarm.processes import describe_end, has_module, plain_environment
from rtarm.running.arm_file import SIMULATED_CHANNEL
from rtarm.why_late.tracefs import place


@dataclass(frozen=True)
class Extent:
    """How much is measured.

    Attributes:
        rates_hz: control rates.
        repeats: how often everybody has a slice at each rate, idle and loaded.
        slice_s: how long it is.
        longest_s: no repeat begins that would probably end later.
        who: who takes part, as far as installed.
    """

    rates_hz: Sequence[int]
    repeats: int
    slice_s: float
    longest_s: float
    who: tuple[str, ...] = WHO


FULL = Extent((200, 500, 1000), repeats=5, slice_s=5.0, longest_s=1170.0)
QUICK = Extent((1000,), repeats=2, slice_s=1.0, longest_s=55.0, who=WHO[:4])

ATTEMPTS = 2

NEEDS = {
    "one_node": {"can": "python-can", "serial": "pyserial"},
    "one_node_fifo": {"can": "python-can", "serial": "pyserial"},
    "plain_loop": {"can": "python-can", "serial": "pyserial", "loop_rate_limiters": "loop-rate-limiters"},
}
"""Modules of the baselines, and the packages that bring them."""

WIRES = {True: "arm simulated behind a terminal, CAN at 1 Mbit/s", False: "no bus (mock drives, virtual CAN)"}
REMARKS = (
    "rtarm and cyclictest have the same priority, interval, processor and locked memory; one_node and plain_loop have "
    "what any program gets; one_node_fifo is one_node whose threads were given that priority from outside.",
    "Where no arm is simulated, one_node and plain_loop still make their CAN messages, for python-can's virtual bus, "
    "and rtarm makes none: compare processor time where one is.",
    "rtarm's processor time is that of its control process and its ROS process.",
)
TRACED = "rtarm's slices were traced (--why), which its figures include."


def run_bench(
    extent: Extent, json_file: Path | None, plot_file: Path | None, reporter: Reporter, *, why: bool = False
) -> ExitCode:
    """Measure, print the tables, and write the files that were asked for; a signal ends the measuring early.

    With `why`, the kernel's trace tells what kept rtarm's late cycles waiting.

    Raises:
        Refusal, ConfigError: it cannot be done.
    """
    for file in (json_file, plot_file):
        if file is not None and (file.is_dir() or not file.absolute().parent.is_dir()):
            raise Refusal(f"{file} cannot be written: name a file in a folder that exists.")
    if plot_file is not None:
        plot.check(plot_file)
    if why:
        place()
    check_ros()
    missing = {who: sentence for who, sentence in absent().items() if who in extent.who}
    for sentence in missing.values():
        reporter.say(sentence)
    before = machine()
    highest_hz = _highest_simulated_hz()
    simulated = {rate: rate <= highest_hz for rate in extent.rates_hz}
    measured = Measurements()
    who = set(extent.who) - set(missing)
    # Where the cycle is not compiled yet, that is no part of any slice.
    subprocess.run([sys.executable, "-P", "-m", "rtloop.warm"], env=plain_environment(), check=False)
    cut_short, code = "", ExitCode.DONE
    try:
        cut_short = asyncio.run(interruptible(_measure(extent, simulated, who, measured, reporter, why=why)))
    except Interrupted as signalled:
        cut_short, code = f"The benchmark was ended by {signalled} before it was complete.", ExitCode.REFUSED
    except Refusal as refusal:
        cut_short, code = f"The benchmark ended before it was complete. {refusal.sentence}", ExitCode.REFUSED
    if not measured.slices:
        raise Refusal(f"{cut_short} Nothing was measured.")
    report = {
        **document(measured),
        "machine": before,
        "versions": versions(),
        "load": described(),
        "wires": {str(rate): WIRES[simulates] for rate, simulates in simulated.items()},
        "extent": {"repeats": extent.repeats, "slice_s": extent.slice_s},
        "notes": [*missing.values(), *filter(None, [cut_short, TRACED if why else ""]), *REMARKS],
    }
    reporter.console.print(render(report))
    try:
        if json_file is not None:
            json_file.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        if plot_file is not None:
            plot.draw(report, plot_file)
    except OSError as error:
        raise Refusal(f"{error.filename} cannot be written ({error.strerror}): name another file.") from None
    return code


def absent() -> dict[str, str]:
    """Who cannot take part here, with a sentence why."""
    found = {}
    if shutil.which("cyclictest") is None:
        found["cyclictest"] = "cyclictest is not installed and left out: `apt-get install rt-tests` brings it."
    else:
        tried = subprocess.run(cyclictest(RealtimeConfig().priority, 1), capture_output=True, text=True, check=False)
        if tried.returncode != 0:
            reason = (tried.stderr.splitlines() or [describe_end(tried.returncode)])[0]
            found["cyclictest"] = (
                f"cyclictest is left out, since it may not run here ({reason}): run as root, or see "
                "with `rtarm doctor` which permission is missing."
            )
    for who, modules in NEEDS.items():
        missing = [package for module, package in modules.items() if not has_module(module)]
        if missing:
            found[who] = f"{who} is left out for want of {' and '.join(missing)}: `pip install {' '.join(missing)}`."
    return found


async def _measure(
    extent: Extent, simulated: dict[int, bool], who: set[str], measured: Measurements, reporter: Reporter, *, why: bool
) -> str:
    """Add all slices to `measured`, whole rounds only; why there are fewer than planned, "" if there are not."""
    environment, namespace = own_domain(), f"/bench_{secrets.token_hex(4)}"
    cpu = max(os.sched_getaffinity(0))
    began_s, longest_repeat_s = time.monotonic(), 0.0
    async with AsyncExitStack() as stack:
        folder = Path(
            stack.enter_context(tempfile.TemporaryDirectory(prefix="rtarm_bench_", ignore_cleanup_errors=True))
        )
        client = GoalClient()
        stack.push_async_callback(client.close)
        await client.start(environment, namespace)
        for repeat in range(extent.repeats):
            repeat_began_s = time.monotonic()
            if repeat and repeat_began_s - began_s + longest_repeat_s > extent.longest_s:
                return (
                    f"Only {repeat} of {extent.repeats} repeats were measured, for this machine is slow: more would "
                    f"have taken longer than {extent.longest_s:g} s."
                )
            for rate in extent.rates_hz:
                bench = Bench(rate, simulated[rate], RealtimeConfig().priority, cpu, environment, namespace, why)
                reporter.say(f"repeat {repeat + 1} of {extent.repeats}, {rate} Hz, {WIRES[simulated[rate]]}")
                competitors = [competitor for competitor in everybody(bench, client) if competitor.who in who]
                first = repeat % len(competitors)
                for found in await _round(competitors[first:] + competitors[:first], extent.slice_s, folder):
                    measured.add(rate, *found)
            longest_repeat_s = max(longest_repeat_s, time.monotonic() - repeat_began_s)
    return ""


def _highest_simulated_hz() -> float:
    """The highest rate whose cycle the fastest bus carries."""
    bus = {"bitrate": FASTEST_BUS, "serial_baud": "cdc", "channel": SIMULATED_CHANNEL}
    return budget(load_arm("episode1", overrides={"bus": bus})).highest_rate_hz


async def _round(competitors: Sequence[Competitor], slice_s: float, folder: Path) -> list[tuple[str, str, Slice]]:
    """One slice of everybody, idle and then loaded: who, load, slice."""
    found = []
    async with AsyncExitStack() as stack:
        for competitor in competitors:
            stack.push_async_callback(competitor.close)
            await competitor.start()
        for load in LOADS:
            for competitor in competitors:
                found.append((competitor.who, load, await _slice(competitor, slice_s, folder, load)))
    return found


async def _slice(competitor: Competitor, slice_s: float, folder: Path, load: str) -> Slice:
    """One slice of one of them; tried again once, since one message lost is no reason to lose all that was measured.

    Raises:
        Refusal: it failed twice.
    """
    for attempt in range(ATTEMPTS):
        try:
            await competitor.prepare(slice_s)
            async with loaded(folder, wanted=load == "loaded"):
                return await competitor.measure(slice_s)
        except (Refusal, OSError, ValueError) as problem:  # OSError: a process that was looked at is gone
            if attempt == ATTEMPTS - 1:
                raise Refusal(f"{competitor.who} could not be measured ({load}): {problem}") from problem
        finally:
            await competitor.rest()
    raise AssertionError("unreachable")
