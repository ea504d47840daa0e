"""The processes of an arm, started and ended in the right order: simulated arm, control process, ROS process.

The order of the end is the reverse: first the ROS process (no new goals), then the control process (it stops
the arm on its path), then the simulated arm. A dead ROS process is started again; a dead control process
never is, because nobody but a person knows whether the arm may move again.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rtarm.console.errors import AlreadySaid, ExitCode, Refusal
from rtarm.console.reporter import Reporter
from rtarm.launch.page import PageBeside
from rtarm.launch.plan import Plan, namespace_arguments, override_arguments, parameter_arguments
from rtarm.processes import (
    Child,
    describe_end,
    plain_environment,
    ros_environment,
)
from rtarm.recording.after_fault import FaultRecorder
from rtarm.running.arm_file import EachBus, with_buses
from shm import files
from shm.errors import AlreadyHeld

if TYPE_CHECKING:
    from config.schema import ArmConfig
    from rtloop.wire.claim import Claim

SIM_PATIENCE_S = 30.0
LOOP_PATIENCE_S = 900.0
"""A first start compiles the control cycle, which takes minutes on a busy or small machine."""
FRONT_PATIENCE_S = 60.0

LOOP_STOP_EARLY_S = 3.0
"""Before it was ready nothing moves, and it may be compiling, which does not listen."""
SIM_STOP_S = 5.0

HINT_AFTER_S = 5.0

RESTART_FIRST_S = 0.2
RESTART_LONGEST_S = 10.0
STEADY_AFTER_S = 10.0
"""A ROS process that lived this long is started again at once."""


class Launcher:
    """Starts, watches and stops the processes of one arm; `stop` belongs in a `finally`."""

    def __init__(self, plan: Plan, reporter: Reporter) -> None:
        self.plan = plan
        self.front_restarts = 0
        self._reporter = reporter
        self._arguments: list[str] = []
        self._sims: dict[str, Child] = {}
        """Each simulates a bus of the arm, by its name."""
        self._loop: Child | None = None
        self._front: Child | None = None
        self._action: Claim | None = None
        self._recorder = FaultRecorder(plan.arm.name, reporter.say)
        self.page = PageBeside(reporter) if plan.view else None

    async def start(self) -> None:
        """Start everything and return when it is ready.

        Raises:
            Refusal: the arm or its action has a server already, a process ended instead, or was not ready in time.
        """
        plan = self.plan
        try:
            files.require_not_running(plan.arm.name)
        except AlreadyHeld as held:
            raise Refusal(str(held), ExitCode.LOOP_REFUSED) from None
        self._action = self._claim_action()
        overrides = plan.overrides
        if plan.simulated:
            overrides = with_buses(overrides, await self._start_sims())
        self._arguments = [plan.arm_argument, *override_arguments(overrides)]
        started = time.monotonic()
        loop_arguments = [*self._arguments, *(["--clear-fault"] if plan.clear_fault else [])]
        self._loop = await self._spawn("loop", "rtloop", loop_arguments, plain_environment())
        # Both start at once: the ROS process takes its second to load while the drives are brought up.
        self._front = await self._start_front()
        await self._wait_ready(self._loop, LOOP_PATIENCE_S, "control process starting")
        self._say(self._loop, f"ready, {describe_bus(plan.arm)} ({time.monotonic() - started:.1f} s)")
        action = await self._wait_ready(self._front, FRONT_PATIENCE_S, "ROS process starting")
        self._say(self._front, f"ready, action {action} ({time.monotonic() - started:.1f} s)")

    async def watch(self) -> None:
        """Keep the ROS process alive; returns never, and raises when the rest cannot go on.

        Raises:
            Refusal: the control process or the simulated arm ended.
        """
        assert self._loop is not None
        others = [asyncio.create_task(self._watch_loop()), asyncio.create_task(self._keep_front())]
        others += [asyncio.create_task(self._watch_sim(sim)) for sim in self._sims.values()]
        beside = [asyncio.create_task(self._recorder.watch())]  # whatever becomes of these ends nothing
        if self.page is not None:
            environment = {**plain_environment(), **self.plan.front_environment}
            arguments = [*self._arguments, *(["--namespace", self.plan.namespace] if self.plan.namespace else [])]
            beside.append(asyncio.create_task(self.page.watch(arguments, environment)))
        try:
            done, _ = await asyncio.wait(others, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in (*others, *beside):
                task.cancel()
            await asyncio.gather(*others, *beside, return_exceptions=True)

    async def stop(self) -> None:
        """End what runs, in order, each within its patience."""
        loop_moves = self._loop is not None and self._loop.was_ready
        patience, parking = self.plan.arm.patience, self.plan.arm.parking
        for child, patience_s in (
            (self._front, patience.ros_process_s + (parking.timeout_s if parking else 0.0)),
            (self._loop, patience.control_process_s if loop_moves else LOOP_STOP_EARLY_S),
            *((sim, SIM_STOP_S) for sim in self._sims.values()),
        ):
            if child is None or child.has_ended:
                continue
            if not await child.stop(patience_s):
                self._say(child, f"did not end within {patience_s:g} s and was killed", style="bold red")
        if self._action is not None:
            self._action.close()
        if self.page is not None:
            await self.page.stop()  # last: it shows the end, and the arm waits for no page
        await self._recorder.close(died=self._loop is not None and bool(self._loop.code))

    def say_stopping(self, why: str) -> None:
        """The line between a signal and the end."""
        parks = ", once it is parked if it stands" if self.plan.arm.parking else ""
        self._reporter.say(f"{why}: stopping the arm on its path and ending its processes{parks}")

    def stop_at_once(self) -> None:
        """Whoever asks for the end again wants no parking."""
        if self.plan.arm.parking and self._front is not None and not self._front.has_ended:
            self._front.ask_to_end()

    def check_orderly_end(self) -> None:
        """After `stop`: refuse when a control process that was ready did not end in order."""
        loop = self._loop
        if loop is None or not loop.was_ready or not loop.code:
            return
        end = describe_end(loop.code)
        raise Refusal(
            f"The control process ended {end} instead of in order; the drives stop by themselves, but a homing run "
            f"goes on: look at the arm and at the lines above before you start again with `{self.plan.again}`.",
            ExitCode.LOOP_DIED,
        )

    # --- starting ---------------------------------------------------------------------------------------

    def _claim_action(self) -> Claim:
        """Make sure, before anything moves, that no other arm of this machine takes the same goals; raises Refusal."""
        from rtarm.launch.served_action import claim_action, namespace_of

        plan = self.plan
        domain = {**os.environ, **plan.front_environment}.get("ROS_DOMAIN_ID", "")
        return claim_action(action_name(plan.arm, namespace_of(self._ros_arguments)), domain, plan.arm.name)

    @property
    def _ros_arguments(self) -> list[str]:
        return [*namespace_arguments(self.plan.namespace), *self.plan.front_arguments]

    async def _start_sims(self) -> EachBus:
        """Start the simulated arm, a process a bus; returns how each is reached, at the terminal where it listens."""
        adapters = self.plan.simulated_adapters
        arguments = ["--arm", self.plan.arm_argument, *override_arguments(with_buses(self.plan.overrides, adapters))]
        if self.plan.start_deg is not None:
            arguments += ["--start-deg=" + ",".join(f"{angle:.9g}" for angle in self.plan.start_deg)]
        if self.plan.hand is not None:
            arguments += ["--hand", self.plan.hand]
        for bus in adapters:
            of_bus = ["--bus", bus] if bus else []
            self._sims[bus] = await self._spawn("sim", "sim", [*arguments, *of_bus], plain_environment(), bus)
        reached = {}
        for (bus, sim), part in zip(self._sims.items(), self.plan.arm.parts, strict=True):
            terminal = await self._wait_ready(sim, SIM_PATIENCE_S, f"{self._called(sim)} starting")
            self._say(sim, f"ready, {len(part.joints)} simulated drives behind {terminal}")
            reached[bus] = {**adapters[bus], "channel": terminal}
        return reached

    async def _start_front(self) -> Child:
        environment = {
            LOG_FORMAT: PLAIN_LOG,
            **ros_environment(),
            **self.plan.front_environment,
        }
        arguments = [*self._arguments, *self._ros_arguments]
        if self.plan.simulated:
            arguments += parameter_arguments({"sim": True})
        return await self._spawn("front", "rosfront", arguments, environment)

    async def _spawn(
        self, name: str, module: str, arguments: Sequence[str], environment: Mapping[str, str], bus: str = ""
    ) -> Child:
        def show(line: str) -> None:
            self._reporter.say(_of_bus(bus, _without_name(line)), name)

        return await Child.start(name, module, arguments, environment, show)

    async def _wait_ready(self, child: Child, patience_s: float, what: str) -> str:
        """What followed "ready"; the control process' end is noticed whoever is waited for."""
        if child.was_ready and self._loop is not None and not self._loop.has_ended:
            return await child.ready() or ""
        waited = asyncio.create_task(child.ready())
        ends = [asyncio.create_task(self._loop.ended())] if self._loop not in (None, child) else []
        try:
            with self._reporter.waiting(what, child.name):
                if not await _any_done((waited, *ends), HINT_AFTER_S):
                    self._say(child, HINTS[child.name])
                    await _any_done((waited, *ends), patience_s - HINT_AFTER_S)
            if self._loop is not None and self._loop.has_ended:
                raise await self._loop_refusal(self._loop)
            if not waited.done():
                raise Refusal(
                    f"The {self._called(child)} was not ready within {patience_s:g} s: see its lines above, "
                    "and relieve the machine if it is busy."
                )
            ready = waited.result()
        finally:
            for task in (waited, *ends):
                task.cancel()
        if ready is None:
            raise await self._start_refusal(child)
        return ready

    async def _start_refusal(self, child: Child) -> Refusal:
        code = await child.ended()
        if child.last_line and code > 0:
            return AlreadySaid(_sentence(child))
        return Refusal(
            f"The {self._called(child)} ended {describe_end(code)} before it was ready: see its lines above."
        )

    async def _loop_refusal(self, child: Child) -> Refusal:
        """Why the control process ended while everything was starting."""
        code = await child.ended()
        if child.was_ready:
            return self._loop_died(code)
        if code not in (1, 2):
            return Refusal(
                f"The control process ended {describe_end(code)} before it was ready, so no motion had begun: see the "
                f"lines above, then start again with `{self.plan.again}`.",
                ExitCode.LOOP_DIED,
            )
        if child.last_line:
            return AlreadySaid(_sentence(child), ExitCode.LOOP_REFUSED)
        return Refusal(
            f"The control process refused to start ({describe_end(code)}) and did not say why: run `python "
            f"-m rtloop {self.plan.arm_argument}` to see more.",
            ExitCode.LOOP_REFUSED,
        )

    # --- watching ---------------------------------------------------------------------------------------

    async def _watch_loop(self) -> None:
        assert self._loop is not None
        raise self._loop_died(await self._loop.ended())

    def _loop_died(self, code: int) -> Refusal:
        if code == 0:
            how = "has ended in order, although nobody asked `rtarm up` for it; the arm stands"
        else:
            how = f"ended {describe_end(code)}; the drives stop by themselves, but a homing run goes on"
        return Refusal(
            f"The control process {how}: look at the arm, then start again with `{self.plan.again}`.",
            ExitCode.LOOP_DIED,
        )

    async def _watch_sim(self, sim: Child) -> None:
        code = await sim.ended()
        raise Refusal(
            f"The {self._called(sim)} ended {describe_end(code)}, so there is nothing left to control: start "
            f"again with `{self.plan.again}`."
        )

    async def _keep_front(self) -> None:
        """Start the ROS process again whenever it ends, more patiently when it does so at once."""
        pause_s = RESTART_FIRST_S
        started = time.monotonic()
        while True:
            assert self._front is not None
            code = await self._front.ended()
            if time.monotonic() - started > STEADY_AFTER_S:
                pause_s = RESTART_FIRST_S
            self._say(
                self._front,
                f"the ROS process ended {describe_end(code)}; starting it again in {pause_s:g} s",
                style="yellow",
            )
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, RESTART_LONGEST_S)
            started = time.monotonic()
            self._front = await self._start_front()
            self.front_restarts += 1
            if await self._front.ready() is not None:
                self._say(self._front, f"ready again ({time.monotonic() - started:.1f} s)")

    def _say(self, child: Child, text: str, style: str = "") -> None:
        self._reporter.say(_of_bus(self._bus(child), text), child.name, style)

    def _called(self, child: Child) -> str:
        """What a process is called in sentences."""
        bus = self._bus(child)
        return f"simulated bus {bus}" if bus else NAMES[child.name]

    def _bus(self, child: Child) -> str:
        """The bus that a process simulates, "" where that is all the arm."""
        return next((bus for bus, sim in self._sims.items() if sim is child), "")


def _of_bus(bus: str, text: str) -> str:
    """What is said of a bus of several."""
    return f"bus {bus}: {text}" if bus else text


def _without_name(line: str) -> str:
    """A line of one of our programs, which puts its name in front."""
    return line.removeprefix("rtloop: ").removeprefix("sim: ")


def _sentence(child: Child) -> str:
    """The last thing a child that refused has said."""
    return _without_name(child.last_line)


async def _any_done(tasks: Iterable[asyncio.Task[Any]], patience_s: float) -> bool:
    done, _ = await asyncio.wait(tasks, timeout=patience_s, return_when=asyncio.FIRST_COMPLETED)
    return bool(done)


LOG_FORMAT = "RCUTILS_CONSOLE_OUTPUT_FORMAT"
PLAIN_LOG = "{severity}: {message}"
"""How ROS writes its log lines; without one of his own, a person need not see time and node in each."""

HINTS = {
    "sim": "still starting: the machine is busy",
    "loop": "still starting: compiling the control cycle, once after a change",
    "front": "still starting: loading ROS 2",
}
"""What a wait of more than `HINT_AFTER_S` is probably for."""

NAMES = {"sim": "simulated arm", "loop": "control process", "front": "ROS process"}
"""What the processes are called in sentences."""


def describe_bus(arm: ArmConfig) -> str:
    """The rate and the bus, or the buses, in a line."""
    if arm.bus.interface == "mock":
        return f"{arm.name} at {arm.control.rate_hz:g} Hz without a bus (mock drives)"
    named = len(arm.buses) > 1
    rates = [f"{bus.bitrate // 1000} kbit/s" + (f" ({bus.name})" if named else "") for bus in arm.buses]
    return f"{arm.name} at {arm.control.rate_hz:g} Hz on {arm.bus.interface}, {', '.join(rates)}"


def action_name(arm: ArmConfig, namespace: str = "") -> str:
    """The action that MoveIt sends its goals to, of a ROS process in this namespace."""
    return f"{namespace}/{arm.front.controller_name}/follow_joint_trajectory"
