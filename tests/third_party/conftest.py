"""What libraries of others need to meet simulated drives: an arm on python-can, and its bus."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import can
import pytest
from third_party.simulated_bus import LockstepBus, live_bus, lockstep_bus

from config.loader import load_arm
from config.schema import ArmConfig


def on_python_can(arm: str = "episode1", **sections: Any) -> ArmConfig:
    """An arm (name or file) whose drives are reached through python-can; `sections` override more of it."""
    bus = {"interface": "python-can", "channel": "simulated", "python_can": {"interface": "virtual"}}
    return load_arm(arm, overrides={**sections, "bus": {**bus, **sections.get("bus", {})}})


@pytest.fixture
def simulated() -> Iterator[Callable[..., LockstepBus]]:
    """Makes buses in virtual time: an arm or its name, options of `sim.arm.SimulatedArm`."""
    with ExitStack() as open_buses:

        def make(arm: ArmConfig | str = "episode1", **options: Any) -> LockstepBus:
            config = on_python_can(arm) if isinstance(arm, str) else arm
            return open_buses.enter_context(lockstep_bus(config, **options))

        yield make


@pytest.fixture
def live() -> Iterator[Callable[..., can.BusABC]]:
    """Makes buses in real time, likewise."""
    with ExitStack() as open_buses:

        def make(arm: ArmConfig | str = "episode1", **options: Any) -> can.BusABC:
            config = on_python_can(arm) if isinstance(arm, str) else arm
            return open_buses.enter_context(live_bus(config, **options))

        yield make
