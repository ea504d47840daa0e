"""What the sections of an arm file have in common, and how their checks refuse."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationInfo
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError


def refuse(field: str, sentence: str) -> PydanticCustomError:
    """A refusal whose place is `field`, relative to the model that is being validated."""
    return PydanticCustomError("arm_config", "{sentence}", {"field": field, "sentence": sentence})


_ENDINGS = {1: "st", 2: "nd", 3: "rd"}


def ordinal(index: int) -> str:
    """An index, counted from 0, as people count: 0 is "1st"."""
    number, last_two = index + 1, (index + 1) % 100
    return f"{number}{_ENDINGS.get(last_two if last_two < 20 else last_two % 10, 'th')}"


YAML_WORDS = frozenset(("y", "n", "yes", "no", "on", "off", "true", "false", "null", "nan", "inf"))
"""Names that some reader of YAML takes for a truth value, for nothing or for a number; ROS has one of its own."""
KEYS_BESIDE_GROUPS = frozenset(("planner_configs", "planning_plugins", "request_adapters", "response_adapters"))
KEYS_BESIDE_CONTROLLERS = frozenset(("controller_names", "controller_manager", "joint_state_broadcaster"))
"""Keys of MoveIt's and ros2_control's files beside which the names of groups and controllers stand."""


def refuse_name(field: str, name: str, taken: frozenset[str] = frozenset()) -> None:
    """Refuse a name that ROS' parameter files would not keep as a name; `taken` are keys beside which it stands."""
    if name.lower() in YAML_WORDS:
        raise refuse(
            field, f"{field} is {name}, which YAML readers take for a value instead of a name; choose another name."
        )
    if name in taken:
        raise refuse(
            field, f"{field} is {name}, which has a meaning of its own in MoveIt's configuration; choose another name."
        )


def _no_bool(value: Any, info: ValidationInfo) -> Any:
    if isinstance(value, bool):  # Python takes true for 1, a reader of the file does not
        sentence = f"{info.field_name} is {str(value).lower()}, but must be a number; write the number."
        raise refuse("", sentence)
    return value


NoBool = BeforeValidator(_no_bool)
"""For numbers: YAML's true is none."""


class Section(BaseModel):
    """A section of an arm file; nothing in it is guessed, nothing changes afterwards."""

    # Strict, so that `ratio: "25"` or `rate_hz: yes` is refused instead of being guessed at.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, serialize_by_alias=True)


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a section by the names that they have in an arm file."""
    return {field.alias or name: field for name, field in model.model_fields.items()}
