"""The names that users build on, as the code has them now; `make names` adds new ones to the committed lists.

A list (`handbook/stable_names/<kind>.txt`) has a name a line. One that is deprecated stays in the code and has a remark
there, `NAME  # deprecated since 0.2.0: use OTHER`, which `make reference` shows on docs/reference/stability.md.
"""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from enum import IntEnum, IntFlag
from typing import Any, get_args

from json_reports import REPORTS, keys_of
from mcap.reader import make_reader
from recorded import TWO_BUSES, a_recording

import rosfront.gripper.hook
import rtarm
from config.joint import Drives
from config.schema import ArmConfig
from handbook import commands, configuration, stability
from motion.gripping import Grip
from rtarm.console.errors import ExitCode
from shm import words

PUBLIC_NUMBERS = (
    words.Mode,
    words.Phase,
    words.Fault,
    words.Outcome,
    words.Unreferenced,
    words.BusState,
    words.Slowed,
    words.DriveStatus,
    words.Event,
    words.Request,
    words.Answer,
    Grip,
)
"""Enumerations that stand in JSON and in recordings, by name or by number."""
PUBLIC_MODULES = (rtarm, rosfront.gripper.hook)
"""Modules whose `__all__` is for users: the arm from Python, and what a gripper of one's own is made with."""
PUBLIC = {getattr(module, name) for module in PUBLIC_MODULES for name in module.__all__}


def of_configuration() -> Iterator[str]:
    """Keys of the arm file."""
    places = dict(configuration.sections_below("", ArmConfig))
    for kind in get_args(Drives):
        family = get_args(kind.model_fields["family"].annotation)[0]
        places |= dict(configuration.sections_below(f"joints[].drive({family}).", kind))
    for place, section in places.items():
        for key in configuration.keys(section):
            yield f"{place}.{key.name}".lstrip(".")


def of_commands() -> Iterator[str]:
    """Commands, their arguments and options."""
    for command in commands.commands():
        yield command.name
        for given in command.command.params:
            spellings = given.opts if given.param_type_name == "option" else [given.metavar or given.name]
            for spelling in (*spellings, *given.secondary_opts):
                yield f"{command.name} {spelling}"


def of_json() -> Iterator[str]:
    """Keys of what `--json` prints."""
    for command, reports in REPORTS.items():
        yield from (f"{command}: {key}" for report in reports() for key in keys_of(report))


def of_recordings() -> Iterator[str]:
    """Channels of a recording of an arm with two buses, with the fields of their messages, and the metadata."""
    with a_recording(TWO_BUSES) as path, path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            topic = re.sub("^/rtarm/joints/.*", "/rtarm/joints/JOINT", channel.topic)
            yield f"{topic}: schema {schema.name}"
            for field, described in json.loads(schema.data)["properties"].items():
                kinds = described["type"] if isinstance(described["type"], list) else [described["type"]]
                yield f"{topic}: {field} ({' or '.join(kinds)})"
        for metadata in reader.iter_metadata():
            yield from (f"metadata {metadata.name}: {key}" for key in metadata.metadata)


def of_numbers() -> Iterator[str]:
    """Modes, faults, outcomes and the like, with their numbers."""
    for kind in PUBLIC_NUMBERS:
        assert issubclass(kind, IntEnum | IntFlag)
        yield from (f"{kind.__name__} {name.lower()} {member.value}" for name, member in kind.__members__.items())


def of_exit_codes() -> Iterator[str]:
    yield from (f"{code.value} {code.name.lower()}" for code in ExitCode)


def of_python() -> Iterator[str]:
    """What modules export: bases, attributes, methods and parameters; a default belongs to its parameter."""
    for module in PUBLIC_MODULES:
        for name in module.__all__:
            thing = getattr(module, name)
            of_thing = of_class(thing) if inspect.isclass(thing) else signature("", thing)
            yield from (f"{module.__name__}.{name}: {what}" for what in of_thing)


def of_class(kind: type) -> Iterator[str]:
    """What a class is and has; the attributes and methods that it got from a base of ours are told there too."""
    yield from (f"is {base.__name__}" for base in kind.__mro__[1:] if base is Exception or base in PUBLIC)
    if hasattr(kind, "__enter__"):
        yield "is a context manager"
    if issubclass(kind, tuple):
        yield from signature("", kind)
    yield from attributes(kind)
    for method, function in inspect.getmembers(kind, inspect.isfunction):
        if not method.startswith("_"):
            yield from signature(method, function)


def attributes(kind: type) -> set[str]:
    """The attributes that a class' docstring tells of, and what is made of a dataclass or an enumeration."""
    _, _, told = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")
    heads = (line.partition(":")[0] for line in told.splitlines() if re.match(r"    \w[\w, ]*:", line))
    told_of = {name.strip() for head in heads for name in head.split(",")}
    return told_of.union(getattr(kind, "__dataclass_fields__", ()), getattr(kind, "__members__", ()))


def signature(name: str, function: Callable[..., Any]) -> Iterator[str]:
    """A function and each of its parameters, so that another one beside them changes none."""
    found = inspect.signature(function)
    result = "" if inspect.isclass(function) else f" -> {found.return_annotation}"
    yield f"{name}(){result}"
    for given in found.parameters.values():
        if given.name != "self":
            named = "*, " if given.kind is given.KEYWORD_ONLY else ""
            default = "" if given.default is given.empty else f"={given.default!r}"
            yield f"{name}({named}{given.name}{default})"


def of_ros() -> Iterator[str]:
    """Names and types of what the node offers, its parameters, and the fields of our own types; from a real node."""
    program = "import json; from handbook.ros import stable; print(json.dumps(stable()))"
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    told = subprocess.run(
        [sys.executable, "-c", program], cwd=stability.ROOT, env=environment, capture_output=True, text=True, check=True
    )
    yield from json.loads(told.stdout)


KINDS: dict[str, Callable[[], Iterator[str]]] = {
    "configuration": of_configuration,
    "commands": of_commands,
    "exit-codes": of_exit_codes,
    "json": of_json,
    "numbers": of_numbers,
    "python": of_python,
    "recordings": of_recordings,
    "ros": of_ros,
}
"""The name of each list, and what makes it."""


def now(kind: str) -> set[str]:
    """The names of a kind that the code has."""
    return set(KINDS[kind]())


def add_new_names() -> None:
    """Add to each list what the code has and the list has not; what the code has no more stays, for a person to see."""
    for kind in KINDS:
        listed = stability.listed(kind)
        text = {name: f"{name}  # {remark}" if remark else name for name, remark in listed.items()}
        for name in now(kind) - listed.keys():
            print(f"{kind}: {name}")
            text[name] = name
        stability.path_of(kind).write_text("".join(f"{text[name]}\n" for name in sorted(text)), encoding="utf-8")


if __name__ == "__main__":
    add_new_names()
