"""`rtarm demo`: recorded goals through the real processes on a simulated arm, watched and summed up."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.client.partner import Silent
from rtarm.client.player import Player
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted
from rtarm.console.reporter import Reporter
from rtarm.demo.goals import Goal, load_goal
from rtarm.demo.goals.made import goals_for
from rtarm.launch.launcher import Launcher, action_name
from rtarm.launch.own_domain import own_domain
from rtarm.launch.page import PageBeside
from rtarm.launch.plan import Plan, load_plan
from rtarm.launch.up import run_launched
from rtarm.running.referencing import reference
from rtarm.running.requests import connect
from rtarm.running.status import counters, describe_scheduling, percentiles_us, scheduling
from rtarm.running.status_tables import timing_table
from rtarm.running.tracking import Tracker, Window, errors_rad, plain
from shm import files
from shm.client import StateReader
from shm.snapshot import Snapshot
from shm.words import Unreferenced

ANSWER_PATIENCE_S = 5.0
RESULT_PATIENCE_S = 10.0
"""Beyond one and a half times the planned duration."""
NO_RESULT = -1000
"""Ours: the server gave no result in time. ROS knows no such code."""
BROWSER_PATIENCE_S = 30.0
DRAW_EVERY_S = 0.1
LINE_EVERY_S = 1.0
"""Between two lines of progress where there is no terminal."""
SETTLE_S = 0.3
"""Longest wait, after the last goal, for the encoders to come to rest."""
LONGEST_NAME = 21
"""Of the arm, so that the demo's own name for it is one the schema allows."""


@dataclass
class Played:
    """What the client reported."""

    results: list[dict[str, Any]] = field(default_factory=list)
    joint_states: dict[str, Any] | None = None
    playing: str = ""


def run_demo(
    arm_argument: str, goal_file: Path | None, json_file: Path | None, reporter: Reporter, *, view: bool = False
) -> ExitCode:
    """Play the goals and print the summary; writes the figures to `json_file` if there is one.

    With `view` the arm has its page, and stays after the goals until a signal.

    Raises:
        Refusal, ConfigError: it cannot be done, or an arm's process ended by itself.
    """
    if json_file is not None and not (json_file.absolute().parent.is_dir() and not json_file.is_dir()):
        raise Refusal(f"{json_file} cannot be written: name a file in a folder that exists.")
    goals = goals_for(load_arm(arm_argument)) if goal_file is None else [load_goal(goal_file)]
    return _run(make_plan(arm_argument, goals, view=view), goals, json_file, reporter)


def _run(plan: Plan, goals: Sequence[Goal], json_file: Path | None, reporter: Reporter) -> ExitCode:
    report: dict[str, Any] = {}

    def conclude(found: dict[str, Any]) -> None:
        report.update(found)
        reporter.console.print(render_summary(report, plan.arm))
        if json_file is not None:
            _write(report, json_file)

    try:
        asyncio.run(_play(plan, goals, conclude, reporter))
    except Interrupted as signalled:
        if not report:
            raise Refusal(f"The demo was ended by {signalled} before its goals were.", ExitCode.GOAL_FAILED) from None
    finally:
        for path in files.DIRECTORY.glob(f"rtarm.{plan.arm.name}.*"):
            path.unlink(missing_ok=True)  # nobody will start an arm of this name again
    return ExitCode.DONE if report["succeeded"] else ExitCode.GOAL_FAILED


def _write(report: Mapping[str, Any], json_file: Path) -> None:
    try:
        json_file.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise Refusal(f"{json_file} cannot be written ({error.strerror}): name another file.") from None


def make_plan(arm_argument: str, goals: Sequence[Goal], *, view: bool = False) -> Plan:
    """An arm under a name of its own, standing where the first goal begins, which disturbs no running arm.

    All that ROS sees of it has that name in front: in the domain of a real arm of the same file too, no goal of the
    demo's is for that arm, and nobody who asks for that arm finds the demo's or reads where it is.
    """
    arm = load_arm(arm_argument)
    name = f"{arm.name[:LONGEST_NAME]}_demo_{secrets.token_hex(2)}"
    return load_plan(
        arm_argument,
        {"name": name},
        simulated=arm.bus.interface != "mock",
        start_deg=start_deg(arm, goals[0]),
        again="rtarm demo --view" if view else "rtarm demo",
        front_environment=own_domain(),
        front_arguments=("--ros-args", "--log-level", "warn"),  # the client tells how the goals end
        namespace=f"/{name}",
        view=view,
    )


def start_deg(arm: ArmConfig, goal: Goal) -> list[float]:
    """Where the simulated arm stands at first: at the goal's first point, other joints near 0."""
    first = dict(zip(goal.joint_names, goal.first_rad, strict=True))
    return [
        min(max(math.degrees(first.get(joint.name, 0.0)), joint.lower_deg), joint.upper_deg) for joint in arm.joints
    ]


async def _play(
    plan: Plan, goals: Sequence[Goal], conclude: Callable[[dict[str, Any]], None], reporter: Reporter
) -> None:
    launcher = Launcher(plan, reporter)

    async def work() -> None:
        played = Played()
        client = Player("The action client", lambda line: reporter.say(line, "client"))
        try:
            await client.start(plan.front_environment, plan.namespace, action_name(plan.arm, plan.namespace))
            await launcher.start()
            if said := await asyncio.to_thread(say_where_it_stands, plan.arm):
                reporter.say(said)
            with reporter.waiting("action client starting", "client"):
                await client.wait_ready()

            async def perform() -> None:
                if launcher.page is not None:
                    await _wait_for_browser(launcher.page, reporter)
                conclude(await _perform(plan, goals, client, played, reporter))
                if launcher.page is not None:
                    reporter.say(
                        f"the arm stays, to be moved from its page {launcher.page.url}; Ctrl-C ends all", style="bold"
                    )
                    await asyncio.Event().wait()

            watch, performing = asyncio.create_task(launcher.watch()), asyncio.create_task(perform())
            try:
                await asyncio.wait((watch, performing), return_when=asyncio.FIRST_COMPLETED)
                if not performing.done():
                    watch.result()  # raises why the rest is pointless
                performing.result()
            finally:
                for task in (watch, performing):
                    task.cancel()
                await asyncio.gather(watch, performing, return_exceptions=True)
        finally:
            await client.close()

    await run_launched(launcher, work)


async def _wait_for_browser(page: PageBeside, reporter: Reporter) -> None:
    with (
        reporter.waiting(f"the goals begin when a browser shows the page, or in {BROWSER_PATIENCE_S:g} s"),
        contextlib.suppress(TimeoutError),
    ):
        async with asyncio.timeout(BROWSER_PATIENCE_S):
            await page.settled.wait()


def say_where_it_stands(arm: ArmConfig) -> str:
    """What a person does whose drives count from where they were switched on; nothing to say where none do.

    The simulated joints stand where their drives count. A homing run finds that out by itself.
    """
    if arm.control.init_mode == 0:
        return ""
    with connect(arm.name) as connection:
        now = connection.snapshot()
        counting = [
            name
            for name in connection.lost(now)
            # What a fault has taken from a joint nobody gives back in passing: it is told as the goal's end.
            if int(now["joints"][connection.index(name)]["unreferenced_reason"]) == Unreferenced.INCREMENTAL
        ]
    return reference(arm.name, dict.fromkeys(counting)) if counting else ""


async def _play_goals(goals: Sequence[Goal], client: Player, played: Played, reporter: Reporter) -> None:
    """One after the other, until one fails; and how joint_states arrived meanwhile."""
    first_ns = time.monotonic_ns()
    for goal in goals:
        found = await _outcome(goal, client, played)
        result = {
            "goal": goal.name,
            "succeeded": found["succeeded"],
            "error_code": found["code"],
            "error_string": found["sentence"],
            "planned_s": goal.planned_s,
            "actual_s": found["actual_s"],
            "feedback": found["feedback"],
        }
        played.results.append(result)
        played.playing = ""
        reporter.say(_result_line(result), "client", "green" if result["succeeded"] else "bold red")
        if not result["succeeded"]:
            break
    played.joint_states = await client.states(first_ns, time.monotonic_ns())


async def _outcome(goal: Goal, client: Player, played: Played) -> dict[str, Any]:
    """What the client reports of a goal's end, or that it reports none; the goal is cancelled then."""
    nothing = {"succeeded": False, "code": NO_RESULT, "actual_s": 0.0, "feedback": 0}
    patience_s = 1.5 * goal.planned_s + RESULT_PATIENCE_S
    sentence = f"The server did not answer the goal within {ANSWER_PATIENCE_S:g} s."
    try:
        answer = await client.play(goal.document, patience_s=ANSWER_PATIENCE_S)
        if answer["event"] == "result":
            return answer
        played.playing = goal.name
        sentence = f"The server gave no result within {patience_s:.1f} s."
        return await client.result(patience_s)
    except Silent:
        client.cancel()
        return {**nothing, "sentence": sentence}


async def _perform(
    plan: Plan, goals: Sequence[Goal], client: Player, played: Played, reporter: Reporter
) -> dict[str, Any]:
    """Let the client play, follow the arm meanwhile, and sum it up."""
    reader = StateReader(files.open_state(plan.arm.name))
    tracker = Tracker(reader)
    window = Window(reader)
    tracker.start()
    playing = asyncio.create_task(_play_goals(goals, client, played, reporter))
    try:
        await _show_progress(plan.arm, goals, playing, played, tracker, reporter)
        since, buses, elapsed_ns = window.counters()
        lateness, cycle_time = window.histogram("lateness"), window.histogram("cycle_time")
        try:
            await playing
        except Refusal as refusal:
            raise Refusal(refusal.sentence, ExitCode.GOAL_FAILED) from None
        await _settle(tracker)
    finally:
        playing.cancel()
        tracker.stop()
    report = {
        **summarise(goals, played),
        "arm": {"name": plan.arm.name, "joints": [joint.name for joint in plan.arm.joints]},
        "rate_hz": plan.arm.control.rate_hz,
        "tracking_rad": plain(tracker.figures()),
        "tracking_missed_cycles": tracker.missed,
        "lateness_us": percentiles_us(lateness),
        "cycle_us": percentiles_us(cycle_time),
        **counters(since, buses, elapsed_ns),
        "scheduling": scheduling(reader.memory.record["scheduling"]),
    }
    reader.close()
    return report


def summarise(goals: Sequence[Goal], played: Played) -> dict[str, Any]:
    """What the client reported of all goals together: the first failure decides, else the last goal."""
    results = played.results
    deciding = next((result for result in results if not result["succeeded"]), results[-1])
    return {
        "succeeded": len(results) == len(goals) and all(result["succeeded"] for result in results),
        "result": {"error_code": deciding["error_code"], "error_string": deciding["error_string"]},
        "planned_s": sum(result["planned_s"] for result in results),
        "actual_s": sum(result["actual_s"] for result in results),
        "goals": results,
        "joint_states": played.joint_states,
    }


async def _settle(tracker: Tracker) -> None:
    """Wait until two readings of every encoder agree, so that `final` is where the arm came to stand."""
    loop = asyncio.get_running_loop()
    until = loop.time() + SETTLE_S
    before = tracker.latest
    while loop.time() < until:
        await asyncio.sleep(0.05)
        now = tracker.latest
        if np.all(now["joints"]["measured_ns"] >= before["joints"]["measured_ns"]) and np.array_equal(
            now["joints"]["measured_position_rad"], before["joints"]["measured_position_rad"], equal_nan=True
        ):
            return
        before = now


# --- progress -------------------------------------------------------------------------------------------


async def _show_progress(
    arm: ArmConfig,
    goals: Sequence[Goal],
    playing: asyncio.Task[None],
    played: Played,
    tracker: Tracker,
    reporter: Reporter,
) -> None:
    """Draw until the goals have been played: a bar and the joints on a terminal, a line a second elsewhere."""
    names = [joint.name for joint in arm.joints]

    shown_s = 0.0

    def moment() -> Moment:
        nonlocal shown_s
        now = Moment.of(goals, played, tracker.latest, names, shown_s)
        shown_s = now.elapsed_s
        return now

    if reporter.console.is_terminal:
        with Live(moment().drawn(), console=reporter.console, auto_refresh=False, transient=True) as live:
            while not playing.done():
                live.update(moment().drawn(), refresh=True)
                await _end_within(playing, DRAW_EVERY_S)
    else:
        while not playing.done():
            if played.playing:
                reporter.say(moment().line(), "arm")
            await _end_within(playing, LINE_EVERY_S if played.playing else DRAW_EVERY_S)


async def _end_within(playing: asyncio.Task[None], seconds: float) -> None:
    await asyncio.wait((playing,), timeout=seconds)


def _result_line(result: Mapping[str, Any]) -> str:
    code = "succeeded" if result["succeeded"] else f"failed with {result['error_code']}"
    return (
        f"{result['goal']} {code} after {result['actual_s']:.2f} s (planned {result['planned_s']:.2f} s). "
        f"{result['error_string']}"
    ).strip()


@dataclass(frozen=True)
class Moment:
    """What the progress shows at one instant."""

    goal: str
    elapsed_s: float
    total_s: float
    names: Sequence[str]
    position_rad: np.ndarray
    velocity_rad_s: np.ndarray
    error_rad: np.ndarray

    @classmethod
    def of(
        cls, goals: Sequence[Goal], played: Played, snapshot: Snapshot, names: Sequence[str], least_s: float
    ) -> Moment:
        """From the client's report so far and the newest snapshot.

        `least_s` of the way has been shown already: for a moment the clock may still be that of the goal before.
        """
        done_s = sum(result["planned_s"] for result in played.results)
        now = next((goal for goal in goals if goal.name == played.playing), None)
        clock_s = snapshot["trajectory_clock_ns"] * 1e-9 if now and snapshot["goal_id"] else 0.0
        joints = snapshot["joints"][: len(names)]
        on_the_way_s = min(max(clock_s, 0.0), now.planned_s) if now else 0.0
        return cls(
            goal=played.playing or ("done" if len(played.results) == len(goals) else "waiting"),
            elapsed_s=max(least_s, done_s + on_the_way_s),
            total_s=sum(goal.planned_s for goal in goals),
            names=names,
            position_rad=joints["measured_position_rad"],
            velocity_rad_s=joints["measured_velocity_rad_s"],
            error_rad=errors_rad(snapshot, len(names)),
        )

    def line(self) -> str:
        """One line, for logs and pipes."""
        angles = " ".join(f"{math.degrees(angle):.1f}" for angle in self.position_rad)
        return (
            f"{self.goal}: {self.elapsed_s:.1f} of {self.total_s:.1f} s, joints at {angles} °, largest error "
            f"{math.degrees(float(np.max(np.abs(self.error_rad)))):.3f}°"
        )

    def drawn(self) -> RenderableType:
        """The bar with the joints below it."""
        head = Table.grid(padding=(0, 1))
        head.add_row(
            Text(f"{self.goal:<14}", style="bold"),
            ProgressBar(total=max(self.total_s, 1e-3), completed=self.elapsed_s, width=36),
            Text(f"{self.elapsed_s:5.1f} of {self.total_s:.1f} s"),
        )
        joints = Table(box=None, pad_edge=False, padding=(0, 2))
        joints.add_column("joint", no_wrap=True)
        for column in ("position °", "velocity °/s", "error °"):
            joints.add_column(column, justify="right", min_width=12, no_wrap=True)
        for name, position, velocity, error in zip(
            self.names, self.position_rad, self.velocity_rad_s, self.error_rad, strict=True
        ):
            joints.add_row(
                name,
                f"{math.degrees(position):.2f}",
                f"{math.degrees(velocity):.1f}",
                f"{math.degrees(error):+.4f}",
            )
        return Group(head, joints)


# --- summary --------------------------------------------------------------------------------------------


def render_summary(report: Mapping[str, Any], arm: ArmConfig) -> RenderableType:
    """All figures of a demo, in tables that fit 80 columns."""
    results = report["goals"]
    reached = sum(result["succeeded"] for result in results)
    verdict = Text.assemble(
        (f"{reached} of {len(results)} goals succeeded", "bold green" if report["succeeded"] else "bold red"),
        f", {report['actual_s']:.2f} s (planned {report['planned_s']:.2f} s)",
    )
    parts: list[RenderableType] = [Text(), verdict]
    if not report["succeeded"]:
        parts.append(Text(f"error {report['result']['error_code']}: {report['result']['error_string']}"))
    return Group(*parts, _tracking_table(report["tracking_rad"], arm), _timing_table(report), _facts(report))


def _tracking_table(tracking: Mapping[str, Sequence[float | None]], arm: ArmConfig) -> Table:
    table = Table("tracking error", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("rms °", "max °", "final °", "rms rad", "max rad", "final rad"):
        table.add_column(column, justify="right", no_wrap=True)
    figures = [tracking[name] for name in ("rms", "max", "final")]
    for index, joint in enumerate(arm.joints):
        values = [figure[index] for figure in figures]
        table.add_row(
            joint.name,
            *("-" if value is None else f"{math.degrees(value):.4f}" for value in values),
            *("-" if value is None else f"{value:.6f}" for value in values),
        )
    return table


def _timing_table(report: Mapping[str, Any]) -> Table:
    table = timing_table(report)
    interval = report["joint_states"]["interval_ms"]
    if interval is not None:
        shown = (interval["p50"], interval["p99"], None, interval["max"])
        table.add_row("/joint_states interval ms", *("" if value is None else f"{value:.2f}" for value in shown))
    return table


def _facts(report: Mapping[str, Any]) -> Table:
    bus = report["bus"]
    load = "no bus" if bus["load"] is None else f"load {bus['load']:.1%}"
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    table.add_row("/joint_states", f"{report['joint_states']['rate_hz']:.2f} Hz")
    table.add_row("cycles", f"{report['cycles']} at {report['rate_hz']:g} Hz, {report['overruns']} overruns")
    table.add_row("bus", f"{bus['frames_tx']} frames sent, {bus['frames_rx']} received, {load}")
    table.add_row("scheduling", describe_scheduling(report["scheduling"]))
    return table
