"""The action client of demo and benchmark: goals one after the other, and how joint_states arrive meanwhile."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from rtarm.client.partner import WORD_PATIENCE_S, Partner
from rtarm.processes import ros_environment

SERVER_PATIENCE_S = 50.0
"""For the action's server; the process then still says in time that there is none."""


class Player:
    """A process like any MoveIt (`rtarm.client.program`), which plays goals at action servers."""

    def __init__(self, name: str, tell: Callable[[str], object] = lambda _: None) -> None:
        """`name` stands in sentences; `tell` is told what it says besides."""
        self._partner = Partner(name, tell)
        self._number = 0

    async def start(self, environment: Mapping[str, str], namespace: str, action: str = "") -> None:
        """Start it, in the ROS domain of `environment` and the namespace whose joint_states it hears."""
        arguments = ["--listens", f"--namespace={namespace}", f"--server-s={SERVER_PATIENCE_S:g}"]
        if action:
            arguments.append(f"--action={action}")
        await self._partner.start("rtarm.client.program", arguments, {**ros_environment(), **environment})

    async def wait_ready(self) -> None:
        """Wait until the action has a server, where one was named; raises Refusal where it has none."""
        await self._partner.ready()

    async def play(self, goal: dict[str, Any], action: str = "", *, patience_s: float) -> dict[str, Any]:
        """Send a goal; what is reported of it first: `accepted` with `sent_ns` (CLOCK_MONOTONIC), or its `result`.

        Raises:
            Silent: nothing is, in time.
            Refusal: the process has ended.
        """
        self._number += 1
        named = {"action": action} if action else {}
        self._partner.say(json.dumps({"number": self._number, "goal": goal, **named}))
        return await self._of_the_goal(patience_s)

    async def result(self, patience_s: float) -> dict[str, Any]:
        """How the goal that was accepted has ended; raises what `play` does."""
        return await self._of_the_goal(patience_s)

    def cancel(self) -> None:
        """Cancel the goal, whatever was reported of it."""
        self._partner.say("{}")

    async def states(self, first_ns: int, last_ns: int) -> dict[str, Any]:
        """How joint_states arrived between two instants (CLOCK_MONOTONIC); raises what `play` does."""
        self._partner.say(json.dumps({"states": (first_ns, last_ns)}))
        event = await self._next(lambda event: event["event"] == "states", WORD_PATIENCE_S)
        return {name: event[name] for name in ("count", "rate_hz", "interval_ms", "age_ms")}

    async def _of_the_goal(self, patience_s: float) -> dict[str, Any]:
        return await self._next(lambda event: event.get("number") == self._number, patience_s)

    async def _next(self, wanted: Callable[[dict[str, Any]], bool], patience_s: float) -> dict[str, Any]:
        """The next report that is wanted: of a goal that was given up, some may still come."""
        while not wanted(event := await self._partner.event(patience_s)):
            pass
        return event

    async def close(self) -> None:
        """End it, in order if it can."""
        await self._partner.hang_up()
        await self._partner.close()
