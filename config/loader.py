"""From the name or the path of an arm to a validated `ArmConfig`, or to errors that name their line.

The YAML is composed to a node tree first, because only nodes know their lines; then PyYAML's safe
constructor makes plain values of it, overrides are merged in, and the schema judges the result.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from config.complaints import complaint, subject
from config.errors import ConfigError, did_you_mean
from config.schema import ArmConfig, Source
from config.serial_adapters import SERIAL_ADAPTERS
from config.yaml_text import UNREADABLE, Location, lines, parse, text_of, value_of

ARMS_FOLDER = Path(__file__).parent / "arms"
"""Where the arm files that come with rtarm live."""

LONGEST_FILE_BYTES = 1_000_000

ABSENT = object()
"""In overrides: what the file says there is taken away."""


def known_arms() -> list[str]:
    """Names of the arms that come with rtarm, sorted."""
    return sorted(path.stem for path in ARMS_FOLDER.glob("*.yaml"))


def load_arm(name_or_path: str | Path, *, overrides: Mapping[str, Any] | None = None) -> ArmConfig:
    """Read, check and freeze an arm.

    Args:
        name_or_path: a name of `known_arms()`, or the path of a YAML file: a `Path`, or text that contains
            a slash or ends in .yaml or .yml.
        overrides: nested values that replace those of the file before it is checked, such as
            `{"control": {"rate_hz": 200.0}}`; naming the bus by channel replaces usb_index and vice versa.

    Raises:
        ConfigError: with every problem found in `errors`. The bus budget is not part of this: call
            `config.budget.check_budget` before anything is opened.
    """
    path = arm_path(name_or_path)
    file = _display_name(path)
    text = _read(path, file)
    root, values = parse(text, file)
    overridden: set[str] = set()
    if overrides:
        values = _merge(values, _exclusive(overrides, values), (), overridden)
    try:
        arm = ArmConfig.model_validate(values)
    except ValidationError as error:
        problems = [complaint(details, values, root, file, overridden) for details in error.errors()]
        raise ConfigError.of(problems) from None
    built_in = path.resolve().parent == ARMS_FOLDER.resolve()
    arm._source = Source(
        file=file,
        lines=dict(lines(root, ())),
        overridden=frozenset(overridden),
        built_in=built_in,
        argument=path.stem if built_in else str(path.resolve()),
        file_hash=_hash_of(text),
    )
    return arm


def differences(one: str | Path, other: str | Path) -> list[tuple[str, Any, Any]]:
    """What two arm files say differently: place, value of the one, value of the other (ABSENT: it says nothing).

    Raises:
        ConfigError: one of them cannot be read.
    """
    values = []
    for name_or_path in (one, other):
        path = arm_path(name_or_path)
        file = _display_name(path)
        values.append(parse(_read(path, file), file)[1])
    first, second = (dict(_leaves(what, ())) for what in values)
    pairs = ((where, first.get(where, ABSENT), second.get(where, ABSENT)) for where in {**first, **second})
    return [
        (subject(where, values[1]) if where[0] == "joints" else text_of(where), ours, theirs)
        for where, ours, theirs in pairs
        if ours != theirs
    ]


def arm_hash(arm: ArmConfig) -> int:
    """A 63-bit number of the whole configuration, defaults included; equal arms have equal numbers."""
    return _hash_of(json.dumps(arm.model_dump(mode="json"), sort_keys=True, separators=(",", ":")))


def _hash_of(text: str) -> int:
    """A 63-bit number of a text."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1


def _leaves(value: Any, above: Location) -> Iterator[tuple[Location, Any]]:
    """Every value that is no list and no mapping, with its location."""
    inside = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else None
    if inside is None:
        yield above, value
        return
    for key, part in inside:
        yield from _leaves(part, (*above, key))


# --- the file -------------------------------------------------------------------------------------------


def arm_path(name_or_path: str | Path) -> Path:
    """The file that `load_arm` reads; raises ConfigError where no arm is called so."""
    if isinstance(name_or_path, Path):
        return name_or_path
    if "/" in name_or_path or name_or_path.endswith((".yaml", ".yml")):
        return Path(name_or_path)
    known = known_arms()
    if name_or_path in known:
        return ARMS_FOLDER / f"{name_or_path}.yaml"
    raise ConfigError(
        f"no arm is called {name_or_path!r}{did_you_mean(name_or_path, known)}; the known arms are "
        f"{', '.join(known)}; use one of them, or the path of your own arm file (such as ./my_arm.yaml)."
    )


def _display_name(path: Path) -> str:
    return path.name if path.parent == ARMS_FOLDER else str(path)


def _read(path: Path, file: str) -> str:
    try:
        with path.open("rb") as stream:
            data = stream.read(LONGEST_FILE_BYTES + 1)
        if len(data) <= LONGEST_FILE_BYTES:
            return data.decode("utf-8")
        problem = f"the file has more than {LONGEST_FILE_BYTES} bytes, which no arm needs; give an arm file."
    except FileNotFoundError:
        problem = (
            "there is no such file; give the path of an existing arm file, or the name of a known arm "
            f"({', '.join(known_arms())})."
        )
    except UnicodeDecodeError as error:
        problem = f"byte {error.start} is not UTF-8 text; an arm file is YAML text: save it as UTF-8."
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        problem = f"the file cannot be read ({reason}); give a readable arm file."
    raise ConfigError(problem, file=file)


# --- overrides ------------------------------------------------------------------------------------------

_OVERRIDE_EXAMPLE = "write it as section.key=value, such as control.rate_hz=100"


def parse_overrides(assignments: Sequence[str]) -> dict[str, Any]:
    """Command-line overrides, such as `["bus.channel=/dev/ttyACM0"]`, as the mapping `load_arm` takes.

    Values are typed as YAML types them; a key given twice takes its last value.

    Raises:
        ConfigError: an assignment that has not the form `section.key=value`.
    """
    nested: dict[str, Any] = {}
    for assignment in assignments:
        location, equals, text = assignment.partition("=")
        keys = location.strip().split(".")
        if not equals or not all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", key) for key in keys):
            raise ConfigError(f"the override {assignment!r} names no field of a section; {_OVERRIDE_EXAMPLE}.")
        try:
            value = value_of(text)
        except (*UNREADABLE, RecursionError):
            raise ConfigError(
                f"the override {assignment!r} has a value that is not valid YAML; {_OVERRIDE_EXAMPLE}, and "
                "put text with special characters in double quotes."
            ) from None
        group = nested
        for key in keys[:-1]:
            group = group.setdefault(key, {})
            if not isinstance(group, dict):
                raise ConfigError(
                    f"the override {assignment!r} names a field inside {key}, which another override gives a "
                    "value of its own; give only one of them."
                )
        group[keys[-1]] = value
    return nested


def _exclusive(overrides: Mapping[str, Any], values: Mapping[str, Any]) -> Mapping[str, Any]:
    """An override that names the adapter by channel or usb_index replaces whatever the file names it by.

    Overriding the interface with mock, which has no adapter, removes it; another interface runs at its own speed.
    Overriding it with any but python-can removes what is python-can's, and naming another of python-can's interfaces
    removes the options of the file's.
    """
    bus, file_bus = overrides.get("bus"), values.get("bus")
    if not isinstance(bus, Mapping) or not isinstance(file_bus, Mapping):
        return overrides
    return {**overrides, "bus": _of_one_bus(bus, file_bus)}


def _of_one_bus(bus: Mapping[str, Any], file_bus: Mapping[str, Any]) -> Mapping[str, Any]:
    """The overrides of a bus, completed."""
    bus = _of_one_interface(bus, file_bus)
    if bus.get("interface") == "mock":
        absent = {key: None for key in ("channel", "usb_index") if file_bus.get(key) is not None}
        return {**absent, **bus}
    interface = bus.get("interface")
    if "serial_baud" in file_bus and interface is not None and interface != file_bus.get("interface"):
        adapter = SERIAL_ADAPTERS.get(str(interface))
        bus = {"serial_baud": "cdc" if adapter is None else adapter.serial_baud, **bus}
    for given, other in (("channel", "usb_index"), ("usb_index", "channel")):
        if bus.get(given) is not None and other not in bus and file_bus.get(other) is not None:
            return {**bus, other: None}
    return bus


def _of_one_interface(bus: Mapping[str, Any], file_bus: Mapping[str, Any]) -> Mapping[str, Any]:
    """The overrides of section `bus`, with the file's own words for python-can taken away where they mean another."""
    in_file = file_bus.get("python_can")
    if not isinstance(in_file, Mapping):
        return bus
    if bus.get("interface", "python-can") != "python-can":
        return {"python_can": None, **bus}
    given = bus.get("python_can")
    if isinstance(given, Mapping) and given.get("interface", in_file.get("interface")) != in_file.get("interface"):
        return {**bus, "python_can": {**dict.fromkeys(in_file, ABSENT), **given}}
    return bus


def _merge(
    below: Mapping[str, Any], above: Mapping[str, Any], location: Location, overridden: set[str]
) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        here = (*location, key)
        if value is ABSENT:
            del merged[key]
        elif isinstance(value, Mapping):
            base = merged.get(key)
            if here == ("bus",) and isinstance(base, list):
                merged[key] = _merge_buses(base, value, overridden)
                continue
            merged[key] = _merge(base if isinstance(base, Mapping) else {}, value, here, overridden)
        else:
            merged[key] = value
            overridden.add(text_of(here))
    return merged


def _merge_buses(below: Sequence[Any], above: Mapping[str, Any], overridden: set[str]) -> list[Any]:
    """The buses of a file with overrides: those under the name of a bus are for that one, all others for each."""
    names = _names(below)
    for_each = {key: value for key, value in above.items() if key not in names}
    _refuse_one_adapter_for_all(for_each, names)
    for key, value in for_each.items():
        if isinstance(value, Mapping) and key != "python_can":
            raise ConfigError(
                f"the override bus.{key} names no bus of the arm{did_you_mean(key, names)}; its buses are "
                f"{', '.join(names)}."
            )
    merged = []
    for index, bus in enumerate(below):
        if not isinstance(bus, Mapping):
            merged.append(bus)
            continue
        own = above.get(str(bus.get("name")))
        if own is not None and not isinstance(own, Mapping):
            raise ConfigError(
                f"the override bus.{bus.get('name')}={own} gives a bus a value; name a field of it, such as "
                f"bus.{bus.get('name')}.channel=can0."
            )
        merged.append(_merge(bus, _of_one_bus({**for_each, **(own or {})}, bus), ("bus", index), overridden))
    return merged


def _names(buses: Sequence[Any]) -> list[str]:
    return [str(bus["name"]) for bus in buses if isinstance(bus, Mapping) and "name" in bus]


def _refuse_one_adapter_for_all(for_each: Mapping[str, Any], names: Sequence[str]) -> None:
    given = [f"{key}={for_each[key]}" for key in ("channel", "usb_index") if for_each.get(key) is not None]
    if given and len(names) > 1:
        raise ConfigError(
            f"bus.{given[0]} is for every bus, but each of the arm's buses ({', '.join(names)}) has an adapter of its "
            f"own; write it in the arm file, or name the bus where --set is an option, as in `--set "
            f"bus.{names[0]}.{given[0]}`."
        )


def bus_names(name_or_path: str | Path) -> list[str]:
    """Names of the buses of an arm file that has several; none where it has one.

    Raises:
        ConfigError: the file cannot be read.
    """
    path = arm_path(name_or_path)
    file = _display_name(path)
    buses = parse(_read(path, file), file)[1].get("bus")
    return _names(buses) if isinstance(buses, list) and len(buses) > 1 else []
