"""Finds the hook that an arm file names, which may be a class of the user's own."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from config.gripper import OWN_HOOK, SERVO, SIMULATED, GripperConfig
from config.schema import ArmConfig
from rosfront.gripper.hook import Gripper
from rosfront.gripper.servo import ServoGripper
from rosfront.gripper.simulated import SimulatedGripper
from rosfront.program import CannotServe
from rosfront.serving import Serving

METHODS = ("move", "stop", "read", "close")
"""The methods that a user's own hook must have; `home` is optional."""


def hook_of(arm: ArmConfig, gripper: GripperConfig, serving: Serving) -> Callable[[], Gripper]:
    """A function that makes the gripper's hook; raises CannotServe when its class cannot be loaded."""
    if gripper.hook == SERVO:
        return lambda: ServoGripper(serving)
    if gripper.hook == SIMULATED:
        return lambda: SimulatedGripper(gripper)
    found = OWN_HOOK.fullmatch(gripper.hook)
    assert found is not None  # the schema has checked this
    kind = load_class(beside(arm, found["file"]), found["name"])
    return lambda: kind(gripper)


def beside(arm: ArmConfig, file: str) -> Path:
    """A path of an arm file, relative to its folder; on the command line and for built-in arms, to the current one."""
    source = arm.source
    if source is None or source.built_in or "gripper.hook" in source.overridden:
        return Path(file)
    return Path(source.file).parent / file


def load_class(path: Path, name: str) -> Callable[[GripperConfig], Any]:
    """Load a class from a Python file without changing the import path; raises CannotServe."""
    if not path.is_file():
        raise CannotServe(f"gripper.hook names {path}, which is no file: correct it, or put the file there.")
    spec = importlib.util.spec_from_file_location(f"rtarm_gripper_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module there
    try:
        spec.loader.exec_module(module)
    except Exception as problem:
        raise CannotServe(
            f"gripper.hook names {path}, which cannot be loaded ({type(problem).__name__}: {problem}): mend it."
        ) from problem
    kind = getattr(module, name, None)
    if not isinstance(kind, type):
        raise CannotServe(f"gripper.hook names the class {name}, which {path} does not have: correct one of the two.")
    missing = [method for method in METHODS if not callable(getattr(kind, method, None))]
    if missing:
        raise CannotServe(
            f"The gripper's class {name} in {path} has no {' and no '.join(missing)}: add it "
            "(docs/hardware/gripper.md)."
        )
    return kind
