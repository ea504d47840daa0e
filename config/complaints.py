"""What the schema found wrong, as sentences for people: what, its value, what is allowed, what to do."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import yaml
from pydantic import BaseModel
from pydantic_core import ErrorDetails

from config.errors import ConfigError, did_you_mean
from config.joint import JointConfig
from config.schema import ArmConfig
from config.section import fields_of, ordinal
from config.yaml_text import Location, find_line, parts_of, text_of

_DERIVED_FIELDS = {
    "max_velocity_rad_s": "the joint's velocity limit is derived: set motor_rpm and ratio instead",
    "lower_rad": "limits are given in degrees: use lower_deg",
    "upper_rad": "limits are given in degrees: use upper_deg",
    "zero_rad": "the offset is given in degrees: use zero_deg",
}


def complaint(
    details: ErrorDetails, values: Mapping[str, Any], root: yaml.Node, file: str, overridden: set[str]
) -> ConfigError:
    """One problem that pydantic found in `values`, which `root` says and `overridden` replaces in places."""
    location, model = _place(details["loc"])
    if location[:2] == ("bus", 0) and not isinstance(values.get("bus"), list):
        location = ("bus", *location[2:])  # the only one, whose list nobody wrote
    context = details.get("ctx", {})
    if details["type"] == "arm_config":
        of_section = bool(location)  # which knows of no joint, as the whole arm does
        location = (*location, *parts_of(str(context["field"])))
        problem = _with_its_joint(str(context["sentence"]), location, values, of_section=of_section)
    else:
        problem = _sentence(details, location, model, subject(location, values))
    text = text_of(location)
    from_override = text in overridden
    return ConfigError(
        problem,
        file=file,
        line=None if from_override else find_line(root, location),
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
        field = fields_of(model).get(part)
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


def _with_its_joint(sentence: str, location: Location, values: Mapping[str, Any], *, of_section: bool) -> str:
    """A sentence that begins with its field, with the joint whose field it is where it does not name it."""
    joint = _joint_of(location, values)
    begins = f"{location[-1]} is " if location else ""
    if joint is None or not sentence.startswith(begins):
        return sentence
    if not of_section and re.search(rf"\b{re.escape(joint)}\b", sentence):
        return sentence
    return f"{subject(location, values)} is {sentence.removeprefix(begins)}"


def _joint_of(location: Location, values: Mapping[str, Any]) -> str | None:
    """The joint that a location is about, by its name if it has one; None where it is about none."""
    match location:
        case ("joints", int(index), *_) | ("kinematics", "dh", int(index), *_) | (*_, "joints_deg", int(index)):
            joints = values.get("joints")
            joint = joints[index] if isinstance(joints, list) and index < len(joints) else None
            name = joint.get("name") if isinstance(joint, dict) else None
            is_named = isinstance(name, str) and name and location != ("joints", index, "name")
            return str(name) if is_named else f"the {ordinal(index)} joint"
    return None


def subject(location: Location, values: Mapping[str, Any]) -> str:
    """How the sentence names the field: `ratio of joint3`, `rate_hz`, `the file`."""
    joint = _joint_of(location, values)
    match location:
        case ():
            return "the file"
        case ("joints", int()):
            return str(joint)
        case ("bus", int(index)):
            return f"the {ordinal(index)} bus"
        case ("bus", int(index), *_, str(inside)):
            return f"{inside} of the {ordinal(index)} bus"
        case (*_, str(inside), int(index)):
            return f"the {ordinal(index)} entry of {inside}{f' ({joint})' if joint else ''}"
    return f"{location[-1]} of {joint}" if joint else str(location[-1])


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
        return _unknown_field(location, model, subject)
    if kind == "missing":
        return f"{subject} is missing; add it: {_meaning(location, model)}"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return f"{subject} is {value}, but must be {_bounds(location, model)}; correct it."
    if kind == "literal_error":
        hint = did_you_mean(str(details["input"]), re.findall("'([^']+)'", context["expected"]))
        return f"{subject} is {value}{hint}, but must be {context['expected']}; choose one."
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        known = [_family(found) for found in _models_in(JointConfig.model_fields["drive"].annotation)]
        families = ", ".join(known)
        if kind == "union_tag_not_found":
            return f"{subject} does not say its family; add family, one of {families}."
        hint = did_you_mean(str(context["tag"]), known)
        return f"family in {subject} is {context['tag']!r}{hint}, but the known families are {families}; choose one."
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
    field = fields_of(model).get(str(location[-1])) if location else None
    description = "correct it." if field is None or field.description is None else field.description
    return description[0].lower() + description[1:]


def _bounds(location: Location, model: type[BaseModel]) -> str:
    field = fields_of(model)[str(location[-1])]
    words: list[str] = []
    for attribute, word in (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most")):
        for bound in field.metadata:
            if getattr(bound, attribute, None) is not None:
                words.append(f"{word} {getattr(bound, attribute):.12g}")
    return " and ".join(words)


def _unknown_field(location: Location, model: type[BaseModel], subject: str) -> str:
    name = str(location[-1])
    if model is JointConfig and name in _DERIVED_FIELDS:
        return f"{subject} is not a field; {_DERIVED_FIELDS[name]}."
    section = f" of {location[-2]}" if len(location) > 1 and isinstance(location[-2], str) else ""
    known = list(fields_of(model))
    return (
        f"{subject} is not a field{section}{did_you_mean(name, known)}; known here are {', '.join(known)}; correct or "
        "remove it."
    )
