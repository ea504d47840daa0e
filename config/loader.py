"""From the name or the path of an arm to a validated `ArmConfig`, or to errors that name their line.

The YAML is composed to a node tree first, because only nodes know their lines; then PyYAML's safe
constructor makes plain values of it, overrides are merged in, and the schema judges the result.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from config.errors import ConfigError
from config.joint import JointConfig
from config.schema import ArmConfig, Source

ARMS_FOLDER = Path(__file__).parent / "arms"
"""Where the arm files that come with rtarm live."""

_DERIVED_FIELDS = {
    "max_velocity_rad_s": "the joint's velocity limit is derived: set motor_rpm and ratio instead",
    "lower_rad": "limits are given in degrees: use lower_deg",
    "upper_rad": "limits are given in degrees: use upper_deg",
    "zero_rad": "the offset is given in degrees: use zero_deg",
}

Location = tuple[str | int, ...]

LONGEST_FILE_BYTES = 1_000_000
MOST_ENTRIES = 10_000
_UNREADABLE = (yaml.YAMLError, ValueError, IndexError, KeyError, AttributeError, TypeError)
"""What PyYAML raises at a scalar that is none of the kind its tag says, besides what it should."""


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
    root, values = _parse(_read(path, file), file)
    overridden: set[str] = set()
    if overrides:
        values = _merge(values, _exclusive(overrides, values), (), overridden)
    try:
        arm = ArmConfig.model_validate(values)
    except ValidationError as error:
        problems = [_translate(details, values, root, file, overridden) for details in error.errors()]
        raise ConfigError.of(problems) from None
    arm._source = Source(
        file=file,
        lines=dict(_lines(root, ())),
        overridden=frozenset(overridden),
        built_in=path.resolve().parent == ARMS_FOLDER.resolve(),
    )
    return arm


def arm_hash(arm: ArmConfig) -> int:
    """A 63-bit number of the whole configuration, defaults included; equal arms have equal numbers."""
    canonical = json.dumps(arm.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return int.from_bytes(hashlib.sha256(canonical.encode()).digest()[:8], "big") >> 1


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
    guess = difflib.get_close_matches(name_or_path, known, n=1)
    hint = f" (did you mean {guess[0]}?)" if guess else ""
    raise ConfigError(
        f"no arm is called {name_or_path!r}{hint}; the known arms are {', '.join(known)}; use one of them, "
        "or the path of your own arm file (such as ./my_arm.yaml)."
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


def _parse(text: str, file: str) -> tuple[yaml.Node, dict[str, Any]]:
    try:
        loader = yaml.SafeLoader(text)
        try:
            root = loader.get_single_node()
            if root is None:
                raise ConfigError(
                    "the file is empty; an arm file needs name, control, bus and joints: start from a copy "
                    "of episode1.yaml.",
                    file=file,
                )
            _refuse_duplicates(root, file, set())
            _refuse_floods(root, file)
            values = loader.construct_document(root)
            if not isinstance(values, dict):
                raise ConfigError(
                    "the file is not a list of fields; an arm file begins with lines such as `name: my_arm`: "
                    "start from a copy of episode1.yaml.",
                    file=file,
                    line=_line(root),
                )
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise ConfigError(
            f"this is not valid YAML ({_yaml_reason(error)}); correct this line or the "
            "one before it, and indent with spaces only.",
            file=file,
            line=None if mark is None else mark.line + 1,
        ) from None
    except _UNREADABLE as error:
        # A forbidden character, or a scalar that looks like a date and is none.
        raise ConfigError(f"this is not valid YAML ({_one_line(str(error))}); correct the file.", file=file) from None
    except RecursionError:
        raise ConfigError(
            "the file is nested too deeply; an arm file has four levels at most: correct its brackets.",
            file=file,
        ) from None
    return root, values


def _yaml_reason(error: yaml.MarkedYAMLError) -> str:
    """PyYAML's own words in one line, with the line of an opening that was never closed."""
    reason = error.problem or "unreadable"
    if error.context:
        begun = f" begun on line {error.context_mark.line + 1}" if error.context_mark else ""
        reason = f"{error.context}{begun}: {reason}"
    return _one_line(reason)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _refuse_duplicates(node: yaml.Node, file: str, seen: set[int]) -> None:
    """YAML lets a later key silently replace an earlier one; an arm file must not."""
    if id(node) in seen:  # an alias: the same node again, or a loop
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_duplicates(item, file, seen)
    elif isinstance(node, yaml.MappingNode):
        first: dict[str, int] = {}
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                if key.value in first:
                    raise ConfigError(
                        f"{key.value} is given twice, here and on line {first[key.value]}; each field may be "
                        "given once: remove one.",
                        file=file,
                        line=_line(key),
                    )
                first[key.value] = _line(key)
            _refuse_duplicates(value, file, seen)


def _refuse_floods(root: yaml.Node, file: str | None) -> None:
    """A few lines of aliases and merged keys can stand for more than a memory holds, once somebody writes them out."""
    counted: dict[int, int] = {}

    def entries(node: yaml.Node) -> int:
        """Fields, items and values inside, those that an alias repeats counted each time."""
        if id(node) in counted:
            if not counted[id(node)]:
                raise ConfigError("an alias contains itself; write out what is meant.", file=file, line=_line(node))
            return counted[id(node)]
        counted[id(node)] = 0
        inside: list[yaml.Node] = []
        if isinstance(node, yaml.SequenceNode):
            inside = node.value
        elif isinstance(node, yaml.MappingNode):
            inside = [part for pair in node.value for part in pair]
        count = 1
        for part in inside:
            count += entries(part)
            if count > MOST_ENTRIES:
                raise ConfigError(
                    f"written out, with its aliases and merged keys, this has more than {MOST_ENTRIES} entries, "
                    "which no arm needs; shorten it.",
                    file=file,
                    line=_line(node),
                )
        counted[id(node)] = count
        return count

    entries(root)


def _line(node: yaml.Node) -> int:
    mark = node.start_mark
    return int(mark.line) + 1


def _children(node: yaml.Node | None) -> Iterator[tuple[str | int, int, yaml.Node]]:
    """Name or index, line and node of what is directly inside; merged keys come first and may be hidden."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield key.value, _line(key), value
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield index, _line(item), item


def _lines(node: yaml.Node, above: Location) -> Iterator[tuple[str, int]]:
    """Every location and its line; only for a file the schema accepted, whose nesting is therefore small."""
    for name, line, child in _children(node):
        here = (*above, name)
        yield _text(here), line
        yield from _lines(child, here)


def _find_line(root: yaml.Node, location: Location) -> int:
    """The line of a location, or of the innermost enclosing one that stands in the file."""
    node: yaml.Node | None = root
    line = _line(root)
    for part in location:
        found = [(at, child) for name, at, child in _children(node) if name == part]
        if not found:
            break
        line, node = found[-1]
    return line


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
            value = _value(text)
        except (*_UNREADABLE, RecursionError):
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


def _value(text: str) -> Any:
    """What a YAML text says, other than a flood; raises what PyYAML does, or ConfigError."""
    loader = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _refuse_floods(node, None)
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _exclusive(overrides: Mapping[str, Any], values: Mapping[str, Any]) -> Mapping[str, Any]:
    """An override that names the adapter by channel or usb_index replaces whatever the file names it by.

    Overriding the interface with mock, which has no adapter, removes it; with socketcan, the serial line's speed.
    """
    bus, file_bus = overrides.get("bus"), values.get("bus")
    if not isinstance(bus, Mapping) or not isinstance(file_bus, Mapping):
        return overrides
    if bus.get("interface") == "mock":
        absent = {key: None for key in ("channel", "usb_index") if file_bus.get(key) is not None}
        return {**overrides, "bus": {**absent, **bus}}
    if bus.get("interface") == "socketcan" and "serial_baud" in file_bus:
        bus = {"serial_baud": "cdc", **bus}
        overrides = {**overrides, "bus": bus}
    for given, other in (("channel", "usb_index"), ("usb_index", "channel")):
        if bus.get(given) is not None and other not in bus and file_bus.get(other) is not None:
            return {**overrides, "bus": {**bus, other: None}}
    return overrides


def _merge(
    below: Mapping[str, Any], above: Mapping[str, Any], location: Location, overridden: set[str]
) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        here = (*location, key)
        if isinstance(value, Mapping):
            base = merged.get(key)
            merged[key] = _merge(base if isinstance(base, Mapping) else {}, value, here, overridden)
        else:
            merged[key] = value
            overridden.add(_text(here))
    return merged


# --- sentences ------------------------------------------------------------------------------------------


def _text(location: Location) -> str:
    """`("joints", 2, "ratio")` as `joints[2].ratio`."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _parts(text: str) -> Location:
    """`joints[2].ratio` as `("joints", 2, "ratio")`."""
    return tuple(
        int(index) if index else name for name, index in re.findall(r"([^.\[\]]+)(?![^\[]*\])|\[(\d+)\]", text)
    )


def _translate(
    details: ErrorDetails, values: Mapping[str, Any], root: yaml.Node, file: str, overridden: set[str]
) -> ConfigError:
    location, model = _place(details["loc"])
    context = details.get("ctx", {})
    if details["type"] == "arm_config":
        location = (*location, *_parts(str(context["field"])))
        problem = str(context["sentence"])
    else:
        problem = _sentence(details, location, model, _subject(location, values))
    text = _text(location)
    from_override = text in overridden
    return ConfigError(
        problem,
        file=file,
        line=None if from_override else _find_line(root, location),
        location=text or None,
        overridden=from_override,
    )


def _place(loc: tuple[int | str, ...]) -> tuple[Location, type[BaseModel]]:
    """Pydantic's location without the tags of unions, and the model the last part is a field of."""
    model: type[BaseModel] = ArmConfig
    owner: type[BaseModel] = ArmConfig
    location: list[str | int] = []
    choices: dict[str, type[BaseModel]] = {}
    for part in loc:
        if isinstance(part, str) and part in choices:
            model, choices = choices[part], {}
            continue
        location.append(part)
        if isinstance(part, int):
            continue
        owner = model
        field = model.model_fields.get(part)
        models = [] if field is None else _models_in(field.annotation)
        choices = {_family(found): found for found in models} if len(models) > 1 else {}
        if len(models) == 1:
            model = models[0]
    return tuple(location), owner


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


def _family(model: type[BaseModel]) -> str:
    return str(get_args(model.model_fields["family"].annotation)[0])


def _subject(location: Location, values: Mapping[str, Any]) -> str:
    """How the sentence names the field: `ratio of joint3`, `rate_hz`, `the file`."""
    if not location:
        return "the file"
    last = location[-1]
    name = f"entry {last}" if isinstance(last, int) else str(last)
    if len(location) < 2 or location[0] != "joints" or not isinstance(location[1], int):
        return name
    joints = values.get("joints")
    joint = joints[location[1]] if isinstance(joints, list) and location[1] < len(joints) else None
    joint_name = joint.get("name") if isinstance(joint, dict) else None
    whose = joint_name if isinstance(joint_name, str) and last != "name" else f"joints[{location[1]}]"
    return whose if len(location) == 2 else f"{name} of {whose}"


_WANTED = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "list_type": "a list",
    "model_type": "a group of fields",
    "model_attributes_type": "a group of fields",
    "dict_type": "a group of fields",
}


def _sentence(details: ErrorDetails, location: Location, model: type[BaseModel], subject: str) -> str:
    kind, context = details["type"], details.get("ctx", {})
    value = _shown(details["input"])
    if kind == "extra_forbidden":
        return _unknown_field(str(location[-1]), model, subject)
    if kind == "missing":
        return f"{subject} is missing; add it: {_meaning(location, model)}"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return f"{subject} is {value}, but must be {_bounds(location, model)}; correct it."
    if kind == "literal_error":
        return f"{subject} is {value}, but must be {context['expected']}; choose one."
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        families = ", ".join(_family(found) for found in _models_in(JointConfig.model_fields["drive"].annotation))
        if kind == "union_tag_not_found":
            return f"{subject} does not say its family; add family, one of {families}."
        return f"family in {subject} is {context['tag']!r}, but the known families are {families}; choose one."
    if kind == "string_pattern_mismatch":
        return f"{subject} is {value}, which is not allowed; {_meaning(location, model)}"
    if kind == "string_too_short":
        return f"{subject} is empty; write its value, or remove the field."
    if kind in ("too_short", "too_long"):
        return f"{subject} has {context['actual_length']} entries, but an arm has 1 to 32; correct the list."
    if kind in _WANTED:
        return f"{subject} is {value}, but must be {_WANTED[kind]}; {_type_advice(details['input'], kind)}"
    reason = details["msg"][0].lower() + details["msg"][1:]
    return f"{subject} is {value}, which is not allowed ({reason}); correct it."


def _shown(value: object) -> str:
    if value is None:
        return "left empty"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {value if len(value) <= 40 else value[:37] + '…'!r}"
    if isinstance(value, (int, float)):
        return format(value, "g") if isinstance(value, float) else _short_int(value)
    if isinstance(value, Mapping):
        return "a group of fields"
    return "a list" if isinstance(value, Sequence) else f"a {type(value).__name__}"


def _short_int(value: int) -> str:
    return str(value) if value.bit_length() <= 64 else "a number of more than 64 bits"


def _type_advice(value: object, kind: str) -> str:
    if isinstance(value, str) and kind in ("float_type", "int_type"):
        try:
            number = float(value)
        except ValueError:
            return "write the number alone, in the unit the field's name says."
        return f"write it as {number:.12g}, with plain digits and without quotes."
    if isinstance(value, bool) and kind == "string_type":
        return "YAML reads yes, no, on and off as true and false: put the text in quotes."
    return "correct it."


def _meaning(location: Location, model: type[BaseModel]) -> str:
    field = model.model_fields.get(str(location[-1])) if location else None
    description = "correct it." if field is None or field.description is None else field.description
    return description[0].lower() + description[1:]


def _bounds(location: Location, model: type[BaseModel]) -> str:
    field = model.model_fields[str(location[-1])]
    words: list[str] = []
    for attribute, word in (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most")):
        for bound in field.metadata:
            if getattr(bound, attribute, None) is not None:
                words.append(f"{word} {getattr(bound, attribute):,g}".replace(",", ""))
    return " and ".join(words)


def _unknown_field(name: str, model: type[BaseModel], subject: str) -> str:
    if model is JointConfig and name in _DERIVED_FIELDS:
        return f"{subject} is not a field; {_DERIVED_FIELDS[name]}."
    known = list(model.model_fields)
    guess = difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {guess[0]}?)" if guess else ""
    return f"{subject} is not a field{hint}; known here are {', '.join(known)}; correct or remove it."
