"""What a launch file would start, found out without starting it, by the real launch system or by its stand-in."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import launch_stand_in
import yaml


@dataclass(frozen=True)
class Started:
    """A node that a launch file would start."""

    package: str
    executable: str
    arguments: list[str]
    parameters: dict[str, Any]
    """Those given as values; files are listed under "files"."""
    ends_all: bool
    """Whether its end is the end of everything."""
    transports: str
    """Of Fast DDS, as its environment names them; "" for none."""


def everything_started(file: Path, **arguments: str) -> list[Started]:
    """Every node that `ros2 launch FILE name:=value …` would start, in order."""
    from launch import LaunchContext

    context = LaunchContext()
    context.launch_configurations.update(arguments)
    return list(_nodes_of(_description(file), context))


def _description(file: Path) -> Any:
    if launch_stand_in.IS_NEEDED:
        return launch_stand_in.load(file)
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    return get_launch_description_from_python_launch_file(str(file))


def _nodes_of(entity: Any, context: Any) -> Iterator[Started]:
    from launch_ros.actions import Node

    if isinstance(entity, Node):
        if entity.condition is None or entity.condition.evaluate(context):
            yield _started(entity, context)
        return
    for inner in entity.visit(context) or ():
        yield from _nodes_of(inner, context)


def _started(node: Any, context: Any) -> Started:
    if launch_stand_in.IS_NEEDED:
        files = [given for given in node.parameters if isinstance(given, str)]
        values = {name: value for given in node.parameters if given not in files for name, value in given.items()}
        arguments = [context.perform(argument) for argument in node.arguments]
        ends_all = node.on_exit is not None
    else:
        values, files, arguments, ends_all = _of_real(node, context)
    return Started(
        node.node_package,
        node.node_executable,
        arguments,
        {**values, **({"files": files} if files else {})},
        ends_all,
        context.environment.get("FASTDDS_BUILTIN_TRANSPORTS", ""),
    )


def _of_real(node: Any, context: Any) -> tuple[dict[str, Any], list[str], list[str], bool]:
    """The same from the command line that the real launch system has made."""
    from launch.utilities import perform_substitutions

    node._perform_substitutions(context)
    context.extend_locals({"ros_specific_arguments": {"name": "__node:=name", "ns": "__ns:=/"}})  # as execution would
    words = [perform_substitutions(context, word) for word in node.cmd]
    given, _, for_ros = (list(part) for part in _split(words[1:], "--ros-args"))
    values: dict[str, Any] = {}
    files = []
    for flag, value in itertools.pairwise(for_ros):
        if flag == "--params-file":
            if Path(value).name.startswith("launch_params_"):
                content = yaml.load(Path(value).read_text(encoding="utf-8"), Loader=yaml.UnsafeLoader)  # it has tuples
                given_values = content["/**"]["ros__parameters"]
                values |= {name: list(v) if isinstance(v, tuple) else v for name, v in given_values.items()}
            else:
                files.append(value)
    on_exit = node._ExecuteLocal__on_exit
    return values, files, given, bool(on_exit)


def _split(words: list[str], mark: str) -> tuple[list[str], list[str], list[str]]:
    at = words.index(mark) if mark in words else len(words)
    return words[:at], words[at : at + 1], words[at + 1 :]
