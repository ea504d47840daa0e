"""Those who are measured: each gets ready, is measured for a slice while a goal plays, and rests until the next one.

While one is measured the others use no processor time: cyclictest and our processes are started for their slice, the
baselines' processes wait for a word.
"""

from __future__ import annotations

import asyncio
import io
import json
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from rich.console import Console

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.bench import usage
from rtarm.bench.lateness import from_cyclictest, from_pairs
from rtarm.bench.motion import there_and_back
from rtarm.bench.one_node import action_of
from rtarm.bench.program import Program
from rtarm.bench.results import Slice
from rtarm.client.partner import STOP_S, WORD_PATIENCE_S, Partner, Silent
from rtarm.client.player import Player
from rtarm.console.errors import Refusal
from rtarm.console.reporter import Reporter
from rtarm.launch.launcher import Launcher, action_name
from rtarm.launch.plan import load_plan, override_arguments
from rtarm.processes import describe_end, plain_environment, ros_environment
from rtarm.running.arm_file import SIMULATED_CHANNEL
from rtarm.running.tracking import Window
from rtarm.why_late.run import beside
from shm import files
from shm.client import StateReader
from shm.words import Mode

STATES_HZ = 100.0
"""/joint_states of both who publish them."""
FASTEST_BUS = 1_000_000
"""bit/s; episode1's cycle then fits at 200 Hz."""

SETTLE_S = 0.4
"""From the acceptance of the goal to the beginning of the slice."""
ANSWER_PATIENCE_S = 25.0
"""For a server that may just have come up (`rtarm.client.program`), and its answer."""
RESULT_PATIENCE_S = 30.0
WHY_BOUND_NS = 100_000
"""Cycles that are later have causes worth a name."""
TAIL_S = 1.0
"""The goal goes on at least so long after the slice."""


@dataclass(frozen=True)
class Bench:
    """What is the same for everybody."""

    rate_hz: int
    simulated: bool
    """Whether an arm is simulated behind a pseudo-terminal; else there is no bus."""
    priority: int
    cpu: int
    environment: dict[str, str]
    """A ROS domain of this run's own."""
    namespace: str
    """Of all that is in it: no goal of ours is for an arm of somebody's, should one be there."""
    why: bool = False
    """Whether rtarm's late cycles are traced, and their causes named."""

    @property
    def arm_argument(self) -> str:
        """The arm that everybody drives."""
        return "episode1" if self.simulated else "mock"

    @property
    def overrides(self) -> dict[str, Any]:
        """What is changed in its file."""
        bus = {"bus": {"bitrate": FASTEST_BUS, "serial_baud": "cdc"}} if self.simulated else {}
        return {"control": {"rate_hz": self.rate_hz}, "front": {"joint_states_hz": STATES_HZ}, **bus}

    def arm(self) -> ArmConfig:
        """The arm's configuration, as far as it is the same for everybody."""
        overrides = self.overrides
        if self.simulated:
            overrides = {**overrides, "bus": {**overrides["bus"], "channel": SIMULATED_CHANNEL}}
        return load_arm(self.arm_argument, overrides=overrides)


class Competitor(Protocol):
    """One of those who are compared; `close` belongs in a `finally`."""

    who: str

    async def start(self) -> None:
        """Start what waits between slices."""

    async def prepare(self, seconds: float) -> None:
        """Get to where cycles run and a goal plays that lasts longer than a slice of `seconds`."""

    async def measure(self, seconds: float) -> Slice:
        """One slice."""

    async def rest(self) -> None:
        """Use no processor time until the next `prepare`."""

    async def close(self) -> None:
        """End what was started."""


class GoalClient:
    """Plays goals at action servers; a process like any MoveIt."""

    def __init__(self) -> None:
        self._player = Player("The goal client")

    async def start(self, environment: dict[str, str], namespace: str) -> None:
        """Start it, in the ROS domain of `environment`."""
        await self._player.start(environment, namespace)
        await self._player.wait_ready()

    async def play(self, action: str, goal: dict[str, Any]) -> int:
        """Send a goal and wait until it is accepted; when it was sent (CLOCK_MONOTONIC, ns).

        Raises:
            Refusal: it is not.
        """
        try:
            event = await self._player.play(goal, action, patience_s=ANSWER_PATIENCE_S)
        except Silent:
            self._player.cancel()
            raise Refusal(f"{action} did not accept the goal within {ANSWER_PATIENCE_S:g} s.") from None
        if event["event"] != "accepted":
            raise Refusal(f"The goal of the benchmark failed: {event['sentence']}")
        return int(event["sent_ns"])

    async def states(self, first_ns: int, last_ns: int) -> dict[str, Any]:
        """How /joint_states arrived between two instants (CLOCK_MONOTONIC), once the goal has ended."""
        return await self._player.states(first_ns, last_ns)

    async def result(self) -> str:
        """Why the goal did not succeed, "" if it did."""
        try:
            event = await self._player.result(RESULT_PATIENCE_S)
        except Silent:
            return f"no result came within {RESULT_PATIENCE_S:g} s"
        return "" if event["succeeded"] else event["sentence"] or "no reason was given"

    async def close(self) -> None:
        """End it."""
        await self._player.close()


class OurCycle:
    """rtarm: the control process, the ROS process and, where there is one, the simulated arm."""

    who = "rtarm"

    def __init__(self, bench: Bench, client: GoalClient) -> None:
        self._bench = bench
        self._client = client
        self._launcher: Launcher | None = None
        self._reader: StateReader | None = None
        self._watch: asyncio.Task[None] | None = None
        self._name = ""
        self._sent_ns = 0

    async def start(self) -> None:
        """Nothing: it starts for each slice."""

    async def prepare(self, seconds: float) -> None:
        bench = self._bench
        self._name = f"bench_{secrets.token_hex(4)}"
        realtime = {"priority": bench.priority, "cpu": bench.cpu}
        plan = load_plan(
            bench.arm_argument,
            {**bench.overrides, "name": self._name, "realtime": realtime},
            simulated=bench.simulated,
            start_deg=[0.0] * len(bench.arm().joints) if bench.simulated else None,
            again="rtarm bench",
            front_environment=bench.environment,
            front_arguments=("--ros-args", "--log-level", "error"),
            namespace=bench.namespace,
        )
        self._launcher = Launcher(plan, Reporter(Console(file=io.StringIO())))
        await self._launcher.start()
        self._reader = StateReader(files.open_state(self._name))
        self._watch = asyncio.create_task(self._launcher.watch())
        start_rad = self._reader.snapshot()["joints"]["commanded_position_rad"][: len(plan.arm.joints)].tolist()
        goal = there_and_back([joint.name for joint in plan.arm.joints], start_rad, seconds + SETTLE_S + TAIL_S)
        self._sent_ns = await self._client.play(action_name(plan.arm, plan.namespace), goal)
        await asyncio.sleep(SETTLE_S)

    async def measure(self, seconds: float) -> Slice:
        assert self._watch is not None and self._reader is not None
        try:
            if not self._bench.why:
                return await self._measure(seconds)
            with beside(self._reader.memory, WHY_BOUND_NS) as watcher:
                found = await self._measure(seconds)
            return replace(found, late=tuple(watcher.late))
        except OSError:  # a process that was looked at is gone: the launcher knows why
            await asyncio.wait((self._watch,), timeout=STOP_S)
            if self._watch.done():
                self._watch.result()
            raise

    async def _measure(self, seconds: float) -> Slice:
        assert self._reader is not None and self._watch is not None
        loop = int(self._reader.memory.record["header"]["pid"])
        front = files.front_of(self._name)
        pids = {"loop": loop, **({"front": front[0]} if front else {})}
        before = {name: usage.processor_ns([pid]) for name, pid in pids.items()}
        middle = self._reader.snapshot()
        window, first_ns = Window(self._reader), time.monotonic_ns()
        await asyncio.sleep(seconds)
        _, _, elapsed_ns = window.counters()
        lateness, cycle_time = window.histogram("lateness"), window.histogram("cycle_time")
        moving = self._reader.snapshot()["mode"] == Mode.EXECUTING
        after = {name: usage.processor_ns([pid]) for name, pid in pids.items()}
        scheduling = usage.obtained(loop)
        if self._watch.done():
            self._watch.result()
        trouble = await self._client.result() or ("" if moving else "It ended before the slice did.")
        used = {name: after[name] - before[name] for name in pids}
        begun_ns = middle["monotonic_ns"] - float(middle["trajectory_clock_ns"]) + 1e9 / self._bench.rate_hz
        return Slice(
            lateness,
            elapsed_ns * 1e-9,
            used,
            scheduling,
            trouble,
            cycle_time=cycle_time,
            joint_states=await self._client.states(first_ns, first_ns + elapsed_ns),
            goal_ms=(begun_ns - self._sent_ns) * 1e-6 if middle["goal_id"] else None,
        )

    async def rest(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            await asyncio.gather(self._watch, return_exceptions=True)
            self._watch = None
        if self._launcher is not None:
            await self._launcher.stop()
            self._launcher = None
        if self._reader is not None:
            self._reader.close()
            self._reader = None
        for path in files.DIRECTORY.glob(f"rtarm.{self._name}.*"):
            path.unlink(missing_ok=True)  # nobody will start an arm of this name again

    async def close(self) -> None:
        await self.rest()


class Baseline:
    """A process in plain Python, with a simulated arm of its own where there is one.

    Its scheduling is what any program gets that asks for nothing, as these are used today, unless it is given ours.
    """

    def __init__(self, who: str, module: str, bench: Bench) -> None:
        self.who = who
        self._module = module
        self._bench = bench
        self._partner = Partner(who)
        self._sim = Partner("simulated arm")

    async def _start(self, arguments: Sequence[str], environment: dict[str, str]) -> None:
        """Start what waits between slices."""
        bench = self._bench
        changes = override_arguments(bench.overrides)
        channel = []
        if bench.simulated:
            changes += override_arguments({"bus": {"channel": SIMULATED_CHANNEL}})
            start = "--start-deg=" + ",".join("0" for _ in bench.arm().joints)
            await self._sim.start("sim", ["--arm", bench.arm_argument, *changes, start], plain_environment())
            channel = [await self._sim.ready()]
        await self._partner.start(self._module, [bench.arm_argument, *arguments, *channel, *changes], environment)
        await self._partner.ready()

    def _goal(self, seconds: float) -> dict[str, Any]:
        names = [joint.name for joint in self._bench.arm().joints]
        return there_and_back(names, [0.0] * len(names), seconds + SETTLE_S + TAIL_S)

    async def measure(self, seconds: float) -> Slice:
        try:
            return await self._measure(seconds)
        except OSError:  # the process that was looked at is gone
            raise await self._partner.refusal() from None

    async def _measure(self, seconds: float) -> Slice:
        pid = self._partner.pid
        before_ns, first_ns = usage.processor_ns([pid]), time.monotonic_ns()
        self._partner.say("begin")
        await asyncio.sleep(seconds)
        scheduling = usage.obtained(pid)
        last_ns, used_ns = time.monotonic_ns(), usage.processor_ns([pid]) - before_ns
        self._partner.say("end")
        event = await self._partner.event()
        found = Slice(from_pairs(event["pairs"]), (last_ns - first_ns) * 1e-9, {self.who: used_ns}, scheduling)
        return await self._completed(found, first_ns, last_ns)

    async def _completed(self, found: Slice, _first_ns: int, _last_ns: int) -> Slice:
        """The slice with what others than the process itself know."""
        return found

    async def rest(self) -> None:
        self._partner.say("rest")

    async def close(self) -> None:
        await self._partner.close()
        await self._sim.close()


class OneNode(Baseline):
    """The tutorial's way, moved by the same action client as ours.

    With `urgent` all its threads get our priority from outside, as by `chrt --all-tasks`: what such a program can be
    brought to without being rewritten.
    """

    def __init__(self, bench: Bench, client: GoalClient, *, urgent: bool = False) -> None:
        super().__init__("one_node_fifo" if urgent else "one_node", "rtarm.bench.one_node", bench)
        self._client = client
        self._urgent = urgent
        self._node = f"{bench.namespace}/{self.who}"

    async def start(self) -> None:
        """Start what waits between slices."""
        environment = {**ros_environment(), **self._bench.environment}
        await self._start([f"{self._bench.rate_hz:g}", f"{STATES_HZ:g}", self._node], environment)

    async def prepare(self, seconds: float) -> None:
        self._partner.say("run")
        await self._client.play(action_of(self._node), self._goal(seconds))
        if self._urgent:  # all its threads are there now
            usage.give_priority(self._partner.pid, self._bench.priority)
        await asyncio.sleep(SETTLE_S)

    async def _completed(self, found: Slice, first_ns: int, last_ns: int) -> Slice:
        trouble = await self._client.result()
        return replace(found, trouble=trouble, joint_states=await self._client.states(first_ns, last_ns))


class PlainLoop(Baseline):
    """A loop without ROS."""

    def __init__(self, bench: Bench) -> None:
        super().__init__("plain_loop", "rtarm.bench.plain_loop", bench)

    async def start(self) -> None:
        """Start what waits between slices."""
        await self._start([f"{self._bench.rate_hz:g}"], plain_environment())

    async def prepare(self, seconds: float) -> None:
        self._partner.say(f"run {json.dumps(self._goal(seconds))}")
        await asyncio.sleep(SETTLE_S)


def cyclictest(priority: int, cycles: int) -> list[str]:
    """The command for so many wake-ups with everything that our control process asks for."""
    urgent = (f"--priority={priority}", "--policy=fifo", "--mlockall")
    return ["cyclictest", *urgent, "--quiet", "--threads=1", f"--loops={cycles}"]


class Cyclictest:
    """The machine's limit: a C loop that does nothing but wake up, with our priority, interval, processor, locking."""

    who = "cyclictest"
    longest_us = 50_000
    """Lines of its histogram; what is later counts as its maximum."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._program = Program()

    async def start(self) -> None:
        """Nothing: it starts within the slice."""

    async def prepare(self, seconds: float) -> None:
        """Nothing: it starts within the slice."""

    async def measure(self, seconds: float) -> Slice:
        """One slice.

        Raises:
            Refusal: it did not run.
        """
        bench, cycles = self._bench, round(seconds * self._bench.rate_hz)
        await self._program.start(
            *cyclictest(bench.priority, cycles),
            *(f"--affinity={bench.cpu}", f"--interval={round(1e6 / bench.rate_hz)}", f"--histogram={self.longest_us}"),
        )
        # Its start and its end, when it prints, are no cycles: what it uses in the middle is taken for the whole.
        await asyncio.sleep(seconds / 4)
        before_ns = self._used_ns()
        await asyncio.sleep(seconds / 2)
        used_ns = 2 * (self._used_ns() - before_ns)
        scheduling = {} if self._program.has_ended else usage.obtained(self._program.pid)
        code, output = await self._program.ended(seconds + WORD_PATIENCE_S)
        if code != 0 or not scheduling:
            raise Refusal(f"cyclictest ended {describe_end(code)}: {output.strip()[-200:]}")
        return Slice(from_cyclictest(output), None, {self.who: used_ns}, scheduling)

    def _used_ns(self) -> int:
        return 0 if self._program.has_ended else usage.processor_ns([self._program.pid])

    async def rest(self) -> None:
        """It has ended."""

    async def close(self) -> None:
        await self._program.stop()


def everybody(bench: Bench, client: GoalClient) -> list[Competitor]:
    """All who can be compared."""
    return [
        Cyclictest(bench),
        OurCycle(bench, client),
        OneNode(bench, client),
        PlainLoop(bench),
        OneNode(bench, client, urgent=True),
    ]
