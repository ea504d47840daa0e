"""`python -m rtarm.launch.robot_interface [--ros-args …]`: `rtarm up` in ROS clothing for `ros2 run`, `ros2 launch`.

What `rtarm up` is told by options, this is told by ROS parameters; everything else that ROS is told (namespace,
remaps, log level, the other parameters) goes on to the arm's node. The names are those of the arm's tutorial, where
the program is called `robot_interface_full`. Exit codes: those of `rtarm up`.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from rosfront.program import split_arguments
from rosfront.start_parameters import (
    DEFAULT_ARM,
    JOINT_STATES,
    MOTOR_ANGLES,
    PUBLISH_MODES,
    START,
    BadParameter,
    require_kind,
)
from rtarm.console.errors import ExitCode, Refusal, foreseen
from rtarm.console.reporter import LastingConsole, Reporter
from rtarm.launch.plan import check_ros, load_plan, parameter_arguments
from rtarm.launch.up import up
from rtarm.processes import ros_environment

if TYPE_CHECKING:
    from config.schema import ArmConfig

PARAMETERS_PATIENCE_S = 60.0
PARAMETER_FLAGS = ("-p", "--param", "--params-file")
REMAP_FLAGS = ("-r", "--remap")
NODE_NAME_RULES = ("__node", "__name")


@dataclass(frozen=True)
class Start:
    """What the parameters say about the start."""

    arm: str
    """Name or path, as it was given."""
    simulated: bool
    overrides: Mapping[str, Any]
    """What they change in the arm file, in nested form."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Start:
        """Check the start parameters among the given ones; raises BadParameter."""
        for name, (kind, _) in START.items():
            if name in given:
                require_kind(name, given[name], kind)
        mode = given.get("publish_mode", JOINT_STATES)
        if mode not in PUBLISH_MODES:
            raise BadParameter(
                f"Parameter publish_mode is {mode!r}, and allowed are {' and '.join(PUBLISH_MODES)}: leave it out for "
                f"{JOINT_STATES}."
            )
        simulated = given.get("sim", False)
        adapter = [name for name in ("usb_index", "channel") if name in given]
        if simulated and adapter:
            raise BadParameter(
                f"sim brings its own adapter, so {' and '.join(adapter)} cannot be given with it: leave out either sim "
                "or the adapter."
            )
        sections: dict[str, tuple[str, ...]] = {
            "bus": ("usb_index", "channel"),
            "control": ("init_mode",),
            "trajectory": ("interpolation_factor",),
        }
        overrides = {section: {n: given[n] for n in names if n in given} for section, names in sections.items()}
        return cls(
            given.get("arm", DEFAULT_ARM), simulated, {key: values for key, values in overrides.items() if values}
        )


def remarks(given: Mapping[str, Any], arm: ArmConfig, node_name: str | None) -> Iterator[str]:
    """A sentence about each thing that was given and does not do what the tutorial's program does with it."""
    if given.get("publish_mode") == MOTOR_ANGLES:
        yield (
            "publish_mode motor_angles has no effect, because joint states are always published and motor_angles "
            "beside them: leave publish_mode out."
        )
    if "interpolation_factor" in given and arm.trajectory.interpolation != "linear":
        yield (
            f"interpolation_factor {given['interpolation_factor']} has no effect, because trajectories are followed as "
            "splines at every control cycle: set trajectory.interpolation to linear in the arm file if you want the "
            "tutorial's straight lines."
        )
    if node_name is not None:
        yield (
            f"The node is called {arm.front.controller_name} instead of {node_name}, because MoveIt's action has its "
            "name: to change both, set front.controller_name in the arm file and the same in moveit_controllers.yaml."
        )


def front_arguments(ros_arguments: Sequence[str], given: Mapping[str, Any]) -> tuple[list[str], str | None]:
    """What the arm's node is told, and the name it was to have had instead of its own, None if none.

    The parameters are replaced by those that were meant for it, under whatever name; those of the start are left out,
    because the node shows how the arm was really started.
    """
    kept: list[str] = []
    node_name = None
    words = iter(ros_arguments)
    for word in words:
        if word in PARAMETER_FLAGS:
            next(words, None)
        elif word in REMAP_FLAGS:
            rule = next(words, "")
            before, _, after = rule.partition(":=")
            if before.rpartition(":")[2] in NODE_NAME_RULES:
                node_name = after
            else:
                kept += [word, rule]
        else:
            kept.append(word)
    others = {name: value for name, value in given.items() if name not in START}
    return kept + parameter_arguments(others), node_name


def read_parameters(ros_arguments: Sequence[str]) -> dict[str, Any]:
    """The parameters that are given to the arm's node, read by ROS itself in a process of its own.

    Raises:
        Refusal: ROS does not understand its arguments.
    """
    if not ros_arguments:
        return {}
    command = [sys.executable, "-P", "-m", "rosfront.start_parameters", *ros_arguments]
    try:
        result = subprocess.run(
            command, env=ros_environment(), capture_output=True, text=True, check=False, timeout=PARAMETERS_PATIENCE_S
        )
    except subprocess.TimeoutExpired:
        raise Refusal(
            f"ROS did not read its arguments within {PARAMETERS_PATIENCE_S:g} s: relieve the machine if it is busy."
        ) from None
    if result.returncode != 0:
        said = result.stderr.strip().splitlines()
        raise Refusal(
            said[-1] if said else f"ROS could not read its arguments: run `{shlex.join(command)}` to see why."
        )
    given: dict[str, Any] = json.loads(result.stdout)
    return given


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise Refusal(
            f"{message[:1].upper()}{message[1:]}; this program is told what to do by ROS parameters: write them as "
            "`--ros-args -p usb_index:=1`."
        )


def _parser() -> argparse.ArgumentParser:
    parameters = ", ".join(START)
    return _Parser(
        prog="robot_interface",
        description="Start an arm: control process, ROS process and, with sim:=true, simulated drives.",
        epilog=f"Parameters: {parameters}. Example: --ros-args -p usb_index:=1 -p init_mode:=1",
    )


def run(arguments: Sequence[str]) -> ExitCode:
    """Start the arm and hold it until a signal asks for the end.

    Raises:
        Refusal, ConfigError, CannotServe: it cannot be started, or its control process ended by itself.
    """
    own, ros_arguments = split_arguments(arguments)
    _parser().parse_args(own)
    check_ros()
    given = read_parameters(ros_arguments)
    start = Start.of(given)
    for_front, node_name = front_arguments(ros_arguments, given)
    program = ["ros2", "run", "rtarm", "robot_interface"] if shutil.which("ros2") else ["python", "-m", __spec__.name]
    plan = load_plan(
        start.arm,
        start.overrides,
        simulated=start.simulated,
        again=shlex.join([*program, *arguments]),
        front_arguments=for_front,
    )
    reporter = Reporter(LastingConsole(highlight=False, emoji=False))
    for remark in remarks(given, plan.arm, node_name):
        reporter.say(remark, style="yellow")
    return up(plan, reporter)


def main() -> int:
    """Run with the command line's arguments; returns the exit code. A foreseeable error is its sentence."""
    try:
        return int(run(sys.argv[1:]))
    except KeyboardInterrupt:  # before anything was started
        return int(ExitCode.DONE)
    except Exception as error:
        told = foreseen(error)
        if told is None:
            raise
        sentence, code = told
        if sentence:
            print(sentence, file=sys.stderr)
        return int(code)


if __name__ == "__main__":
    sys.exit(main())
