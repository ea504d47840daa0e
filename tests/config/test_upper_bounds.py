"""Every number of an arm file has an upper bound; those of the safety checks are tried on either side."""

import types
from collections.abc import Iterator
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from config.errors import ConfigError
from config.loader import load_arm
from config.schema import ArmConfig
from config.sections import LimitsConfig, TrajectoryConfig
from rtloop.process.initial_state import new_loop

BOUND_BY_OTHERS = {
    "buses[].bitrate": "the rates that the adapter, or classic CAN, has",
    "buses[].serial_baud": "the speeds that serial lines have",
    "homing.then.joints_deg[]": "the joint's own range",
    "parking.joints_deg[]": "the joint's own range",
    "gripper.closed_deg": "the gripper's own range",
    "gripper.open_deg": "the gripper's own range",
}
"""Numbers that a check of their own bounds, and by what."""


def bounds_of(metadata: Any) -> dict[str, float]:
    found = {}
    for entry in metadata:
        for bound in getattr(entry, "metadata", [entry]):
            found |= {
                kind: value for kind in ("gt", "ge", "lt", "le") if (value := getattr(bound, kind, None)) is not None
            }
    return found


def numbers_in(kind: Any, metadata: tuple[Any, ...], place: str) -> Iterator[tuple[str, dict[str, float]]]:
    """Place and bounds of each number that a field of this type can hold."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        yield from numbers_in(arguments[0], (*arguments[1:], *metadata), place)
    elif origin in (Union, types.UnionType):
        for argument in arguments:
            yield from numbers_in(argument, metadata, place)
    elif origin is list:
        yield from numbers_in(arguments[0], (), f"{place}[]")
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        for name, field in kind.model_fields.items():
            yield from numbers_in(field.annotation, tuple(field.metadata), f"{place}.{name}".lstrip("."))
    elif kind in (int, float):
        yield place, bounds_of(metadata)


def test_every_number_of_an_arm_file_has_an_upper_bound() -> None:
    found = list(numbers_in(ArmConfig, (), ""))
    assert len(found) > 80
    assert {place for place, bounds in found if not bounds.keys() & {"le", "lt"}} == set(BOUND_BY_OTHERS)


SAFETY = [
    (section, name, field)
    for section, model in (("limits", LimitsConfig), ("trajectory", TrajectoryConfig))
    for name, field in model.model_fields.items()
    if field.annotation in (int, float)
]
every_safety_number = pytest.mark.parametrize(
    ("section", "name", "field"), SAFETY, ids=[f"{section}.{name}" for section, name, _ in SAFETY]
)


def highest(field: FieldInfo) -> float:
    return bounds_of(field.metadata)["le"]


@every_safety_number
def test_just_beyond_its_upper_bound_a_number_is_refused_with_what_is_allowed(
    section: str, name: str, field: FieldInfo
) -> None:
    most = highest(field)
    beyond = float(np.nextafter(most, np.inf)) if field.annotation is float else int(most) + 1
    with pytest.raises(ConfigError, match=rf"{section}\.{name}.*{name} is .*, but must be .* and at most {most:.12g}"):
        load_arm("mock", overrides={section: {name: beyond}})


def test_at_their_upper_bounds_all_numbers_are_taken_and_the_cycle_can_count_with_them() -> None:
    values: dict[str, dict[str, float]] = {"limits": {}, "trajectory": {}}
    for section, name, field in SAFETY:
        values[section][name] = field.annotation(highest(field))
    arm = load_arm("mock", overrides=values)
    params = new_loop(arm, 0, 0)[0]["params"]
    assert (params["stale_brake_ns"], params["stale_fault_ns"]) == (10**9, 5 * 10**9)
    assert params["front_timeout_ns"] == 10**10
