"""What an arm's processes are started with: checked, before anything is started.

And the forms in which every process of an arm takes what it is told: arguments, overrides, ROS parameters.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Any

from rtarm.console.errors import Refusal, needs
from rtarm.console.interrupt import Interrupted, signals_raise
from rtarm.launch.first_use import cycle_compiled_beside
from rtarm.processes import has_module
from rtarm.running.arm_file import EachBus, simulated_channels, with_buses

if TYPE_CHECKING:
    from config.bus import BusConfig
    from config.schema import ArmConfig


@dataclass(frozen=True)
class Plan:
    """What to start."""

    arm: ArmConfig
    arm_argument: str
    """The name or path a person gave; every process loads the arm from it."""
    overrides: Mapping[str, Any]
    """What the options change in the arm file, in nested form."""
    simulated: bool
    start_deg: Sequence[float] | None = None
    """Joint angles at which the simulated arm starts; None for its default."""
    again: str = ""
    """The command that starts all this again, for people."""
    front_environment: Mapping[str, str] = field(default_factory=dict)
    front_arguments: Sequence[str] = ()
    """What the ROS process is given besides, such as `--ros-args`."""
    namespace: str = ""
    """What stands before the name of its node and of all its topics, services and actions; "" for nothing."""
    simulated_adapters: EachBus = field(default_factory=dict)
    """What the simulated arm's adapters change in its buses; where their terminals will be known, these stand there."""
    hand: str | None = None
    """The motion along which a hand leads the simulated arm whenever it is limp, as `sim.hand` knows it."""
    view: bool = False
    """Whether its page is served beside it."""
    clear_fault: bool = False
    """Whether an error that a drive has at the start is cleared."""


def parameter_arguments(parameters: Mapping[str, Any]) -> list[str]:
    """Values of ROS parameters as the arguments with which a node is started."""
    if not parameters:
        return []
    return [
        "--ros-args",
        *chain.from_iterable(("-p", f"{name}:={_as_yaml(value)}") for name, value in parameters.items()),
    ]


def namespace_arguments(namespace: str) -> list[str]:
    """The arguments with which a node and all that it offers is in a namespace, /diagnostics too; none without one."""
    if not namespace:
        return []
    return ["--ros-args", "-r", f"__ns:={namespace}", "-r", f"/diagnostics:={namespace}/diagnostics"]


def override_arguments(overrides: Mapping[str, Any], above: str = "") -> list[str]:
    """Nested overrides as the `--set section.key=value` arguments that every process of an arm takes."""
    arguments: list[str] = []
    for key, value in overrides.items():
        if isinstance(value, Mapping):
            arguments += override_arguments(value, f"{above}{key}.")
        else:
            arguments += ["--set", f"{above}{key}={_as_yaml(value)}"]
    return arguments


def _as_yaml(value: Any) -> str:
    import yaml

    style = '"' if isinstance(value, str) else None  # so that "5" stays a text
    text: str = yaml.safe_dump(value, default_style=style, default_flow_style=True, width=math.inf, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")


def load_plan(
    arm_argument: str,
    overrides: Mapping[str, Any],
    *,
    simulated: bool,
    start_deg: Sequence[float] | None = None,
    again: str = "",
    front_environment: Mapping[str, str] | None = None,
    front_arguments: Sequence[str] = (),
    namespace: str = "",
    hand: str | None = None,
    view: bool = False,
    clear_fault: bool = False,
) -> Plan:
    """Check the configuration, the budget and what is installed before anything is started.

    Raises:
        ConfigError: the arm, an option or the budget is not right.
        Refusal: there is nothing to simulate, or the ROS process or the page cannot run here.
    """
    from config.budget import check_budget
    from config.loader import load_arm

    loaded_with: Mapping[str, Any] = overrides
    adapters: EachBus = {}
    if simulated:
        if _needs_no_bus(arm_argument):
            raise Refusal(
                f"Arm {arm_argument} has mock drives and no bus, so there is nothing to simulate: leave sim out."
            )
        adapters = _simulated_adapters(arm_argument, overrides)
        loaded_with = with_buses(overrides, adapters)
    arm = load_arm(arm_argument, overrides=loaded_with)
    check_budget(arm)
    check_ros()
    if view:
        needs("viser")
    return Plan(
        arm=arm,
        arm_argument=arm_argument,
        overrides=overrides,
        simulated=simulated,
        start_deg=start_deg,
        again=again,
        front_environment=front_environment or {},
        front_arguments=front_arguments,
        namespace=namespace,
        simulated_adapters=adapters,
        hand=hand,
        view=view,
        clear_fault=clear_fault,
    )


def _needs_no_bus(arm_argument: str) -> bool:
    from config.errors import ConfigError
    from config.loader import load_arm

    try:
        return load_arm(arm_argument).bus.interface == "mock"
    except ConfigError:
        return False  # with the overrides it may load, and if not, that error is the one to show


def check_ros() -> None:
    """Refuse, with what to install, where the ROS process could not start; at first use, make what can be made."""
    if not has_module("rclpy"):
        raise Refusal(f"rclpy is not installed, and the ROS process needs it: {_rclpy_remedy()}, then start again.")
    if not generated_types() and not has_module("control_msgs"):
        raise Refusal(
            "control_msgs is not installed, and the ROS process needs it: generate it with `python -m "
            "rtarm_interfaces.build`, or install it with your ROS 2, then start again."
        )


def _rclpy_remedy() -> str:
    if platform.machine() != "x86_64":
        return f"source a ROS 2 Jazzy installation, since ROS has no wheels for {platform.machine()}"
    return "run `make env` in a clone, install the wheel with its extra `ros`, or source a ROS 2 installation"


def generated_types() -> bool:
    """Make sure of the message types that ROS from wheels lacks; says whether rtarm keeps a copy of its own.

    Raises:
        Refusal: they cannot be made here, or a signal came meanwhile.
    """
    try:
        from rtarm_interfaces import build
    except ImportError:  # a ROS workspace builds them itself, and its copy of rtarm is without their definitions
        return False
    try:
        with signals_raise(), cycle_compiled_beside() if build.to_be_made() else nullcontext():
            return build.ensure()
    except build.CommandFailed as failed:
        raise Refusal(f"{failed.log}\n{failed}") from None
    except build.BuildError as refused:
        raise Refusal(str(refused)) from None
    except Interrupted as signalled:
        raise Refusal(f"{signalled} came while message types were generated: start again for the rest.") from None


def _simulated_adapters(arm_argument: str, overrides: Mapping[str, Any]) -> EachBus:
    """What each bus of a simulated arm is reached through, a stand-in for its terminal included."""
    from config.errors import ConfigError
    from config.loader import load_arm

    channels = simulated_channels(arm_argument)
    try:
        buses = load_arm(arm_argument, overrides=with_buses(overrides, channels)).buses
    except ConfigError:  # with SLCAN it may load, and if not, that error is the one to show
        return {name: {"interface": "slcan", **channel} for name, channel in channels.items()}
    return {
        name: {**_simulated_adapter(bus), **channel}
        for (name, channel), bus in zip(channels.items(), buses, strict=True)
    }


def _simulated_adapter(bus: BusConfig) -> dict[str, Any]:
    """A simulated bus stands behind a serial adapter: its own kind, or SLCAN where the real one has none.

    Where python-can speaks to the real one, it does so to the simulated one too.
    """
    from config.serial_adapters import SERIAL_ADAPTERS

    if bus.python_can is not None:
        other = {"python_can": {"interface": "slcan", "sleep_after_open": 0.0}}
        return {} if bus.spoken in SERIAL_ADAPTERS else other
    return {"interface": bus.spoken if bus.spoken in SERIAL_ADAPTERS else "slcan"}
