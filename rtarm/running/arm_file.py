"""The file of an arm of which only the name is known: shared memory knows from where a running one was started."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from config.errors import ConfigError
from config.loader import bus_names, known_arms, load_arm
from config.schema import ArmConfig
from rtarm.console.errors import Refusal
from rtarm.running.status import is_path
from shm import files
from shm.errors import SharedMemoryError

SIMULATED_CHANNEL = "simulated"
"""Stands for a pseudo-terminal that does not exist yet, so that an arm file without adapter loads."""

EachBus = Mapping[str, Mapping[str, Any]]
"""What is changed in the buses of an arm, by their names; "" is the name of the bus where the arm has one."""


def with_buses(overrides: Mapping[str, Any], changed: EachBus) -> dict[str, Any]:
    """Overrides of an arm file in which each bus is changed besides."""
    bus = dict(overrides.get("bus", {}))
    for name, settings in changed.items():
        if name:
            bus[name] = {**bus.get(name, {}), **settings}
        else:
            bus |= settings
    return {**overrides, "bus": bus}


def simulated_channels(argument: str) -> EachBus:
    """What stands for the adapter of each bus of an arm file; raises ConfigError where it cannot be read."""
    names = bus_names(argument)
    if not names:
        return {"": {"channel": SIMULATED_CHANNEL}}
    return {name: {"channel": f"{SIMULATED_CHANNEL}{number}"} for number, name in enumerate(names)}


def arm_file(argument: str | None, arm: str, given_as: str = "--arm") -> ArmConfig:
    """The configuration of an arm: from the file that was named, else from the one that the running arm was started
    with, else that of an arm that comes with rtarm.

    Args:
        argument: the arm as a person gave it: a name, the path of a file, or None.
        arm: its name.
        given_as: what a path stands behind on the command line, for the sentence.

    Raises:
        Refusal: it is none of these.
        ConfigError: it cannot be read.
    """
    given = argument if argument is not None and is_path(argument) else started_with(arm) or arm
    if given == arm and arm not in known_arms():
        raise Refusal(
            f"Arm {arm} does not run, and is none of those that come with rtarm, so that its arm file is needed here: "
            f"give its path, `{given_as} ./{arm}.yaml`."
        )
    try:
        return load_arm(given)
    except ConfigError:  # such as an adapter that is only given with `rtarm up`
        return load_arm(given, overrides=with_buses({"bus": {"interface": "slcan"}}, simulated_channels(given)))


def started_with(arm: str) -> str:
    """Name or path of the file that a running arm was started with; "" for an arm that does not run."""
    with suppress(SharedMemoryError):
        state = files.open_state(arm)
        try:
            return files.arm_file(state.record["header"])
        finally:
            state.close()
    return ""
