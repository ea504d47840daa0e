"""The page of an arm file's keys, from the schema that reads it."""

from __future__ import annotations

from collections.abc import Iterator
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from config.joint import Drives
from config.schema import ArmConfig
from config.section import fields_of
from handbook.markdown import code, page, table

UNITS = {
    "_rad_s2": "rad/s²",
    "_rad_s": "rad/s",
    "_deg_s": "°/s",
    "_rad": "rad",
    "_deg": "°",
    "_rpm": "rpm",
    "_hz": "Hz",
    "_ms": "ms",
    "_s": "s",
    "_nm": "N·m",
    "_nm_per_ampere": "N·m/A",
    "_mm": "mm",
    "_m": "m",
    "_ma": "mA",
    "_kg": "kg",
    "bitrate": "bit/s",
    "serial_baud": "baud",
}
"""Unit of a key by its end, the longest that fits."""
KINDS = {bool: "true or false", int: "whole number", float: "number", str: "text"}
INTRODUCTION = """\
Every key of an arm file, as [`rtarm config check`](commands.md#rtarm-config-check) reads it. A key that is not named
here is refused, and so is a value of another type. What the numbers mean together (bus load, highest rate,
resolution) is what `rtarm config check FILE` prints."""


class Key(NamedTuple):
    """One row of a table."""

    name: str
    type: str
    unit: str
    default: str
    allowed: str
    meaning: str


def build() -> str:
    """The page."""
    sections = list(sections_below("", ArmConfig))
    drives = [part for kind in get_args(Drives) for part in drive_part(kind)]
    return page(
        "Configuration", INTRODUCTION, *(line for path, model in sections for line in part(path, model)), *drives
    )


def part(path: str, model: type[BaseModel]) -> list[str]:
    """Heading, sentence and table of a section."""
    heading = f"## `{path}`" if path else "## The arm"
    return [heading, summary(model), table(HEADS, map(row, keys(model)))]


def drive_part(model: type[BaseModel]) -> list[str]:
    """Heading, sentence and tables of a family of drives, and of what it consists of."""
    family = get_args(model.model_fields["family"].annotation)[0]
    parts = [f"## `joints[].drive` with `family: {family}`", summary(model), table(HEADS, map(row, keys(model)))]
    for path, below in sections_below("joints[].drive.", model):
        if below is not model:
            parts += part(path, below)
    return parts


HEADS = ("key", "type", "unit", "default", "allowed", "meaning")


def row(key: Key) -> tuple[str, ...]:
    return (code(key.name), key.type, key.unit, key.default, key.allowed, key.meaning)


def summary(model: type[BaseModel]) -> str:
    """The first paragraph of a model's docstring."""
    return " ".join((model.__doc__ or "").strip().split("\n\n")[0].split())


def sections_below(path: str, model: type[BaseModel]) -> Iterator[tuple[str, type[BaseModel]]]:
    """A section and those inside it, each with its path; drives have parts of their own."""
    yield path.rstrip("."), model
    for name, field in fields_of(model).items():
        is_plural = is_list(field.annotation) and not may_be_one(field)
        for below in models_of(field.annotation):
            if below not in get_args(Drives):
                yield from sections_below(f"{path}{name}{'[]' if is_plural else ''}.", below)


def may_be_one(field: FieldInfo) -> bool:
    """Whether a list of one may be written without its list, as the only bus of an arm."""
    return field.alias is not None and is_list(field.annotation)


def is_list(annotation: Any) -> bool:
    """Whether an annotation is that of a list, optional or not."""
    return list in {get_origin(annotation), *(get_origin(inner) for inner in get_args(annotation))}


def models_of(annotation: Any) -> list[type[BaseModel]]:
    """The models an annotation is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in models_of(inner)]


def keys(model: type[BaseModel]) -> list[Key]:
    """The keys of a section."""
    return [key(name, field) for name, field in fields_of(model).items()]


def key(name: str, field: FieldInfo) -> Key:
    """One key."""
    return Key(
        name,
        f"section, or {type_of(field.annotation)}" if may_be_one(field) else type_of(field.annotation),
        unit_of(name),
        default_of(field),
        allowed_of(field),
        field.description or "",
    )


def type_of(annotation: Any) -> str:
    """What a person writes for a value."""
    if models_of(annotation) and not is_list(annotation):
        return "section"
    if annotation in KINDS:
        return KINDS[annotation]
    if get_origin(annotation) is list:
        return f"list of {'sections' if models_of(annotation) else type_of(get_args(annotation)[0]) + 's'}"
    if get_origin(annotation) is tuple:
        inner = [kind for kind in get_args(annotation) if kind is not Ellipsis]
        return f"list of {len(inner)} {type_of(inner[0])}s"
    if get_origin(annotation) is dict:
        return "keys and values"
    if get_origin(annotation) is Literal:
        return " or ".join(dict.fromkeys(KINDS[type(value)] for value in get_args(annotation)))
    if get_origin(annotation) is Annotated:
        return type_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return " or ".join(dict.fromkeys(type_of(kind) for kind in get_args(annotation) if kind is not type(None)))
    raise AssertionError(f"{annotation} has no words here yet: add them to KINDS")


def unit_of(name: str) -> str:
    """The unit that a key's name ends in."""
    ends = [end for end in UNITS if name.endswith(end) or name == end.lstrip("_")]
    return UNITS[max(ends, key=len)] if ends else ""


def default_of(field: FieldInfo) -> str:
    """What a key that is left out counts for."""
    if field.is_required():
        return "required"
    if field.default_factory is not None:
        return "as below"
    if field.default is None:
        return "left out"
    return code(str(field.default).lower() if isinstance(field.default, bool) else str(field.default))


def allowed_of(field: FieldInfo) -> str:
    """The values that are taken."""
    named = [value for choice in literals(field.annotation) for value in get_args(choice)]
    if named:
        return ", ".join(code(str(value)) for value in named)
    found = {
        kind: value for inner in field.metadata for kind in BOUNDS if (value := getattr(inner, kind, None)) is not None
    }
    return ", ".join(BOUNDS[kind].format(number(value)) for kind, value in found.items())


BOUNDS = {
    "gt": "> {}",
    "ge": "≥ {}",
    "lt": "< {}",
    "le": "≤ {}",
    "min_length": "length ≥ {}",
    "max_length": "length ≤ {}",
    "pattern": "as `{}`",
}


def number(value: object) -> str:
    """A bound as people write it."""
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def literals(annotation: Any) -> list[Any]:
    """The lists of allowed words an annotation has; none where anything else is taken beside them."""
    if get_origin(annotation) is Literal:
        return [annotation]
    inner = [kind for kind in get_args(annotation) if kind is not type(None)]
    found = [literal for kind in inner for literal in literals(kind)]
    return found if len(found) == len(inner) else []
