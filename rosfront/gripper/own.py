"""Which hook an arm file means, a class of somebody's own among them."""

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
"""What a hook of one's own must have; `home` it may have."""


def hook_of(arm: ArmConfig, gripper: GripperConfig, serving: Serving) -> Callable[[], Gripper]:
    """What makes the gripper's hook; raises CannotServe when it names a class that cannot be had."""
    if gripper.hook == SERVO:
        return lambda: ServoGripper(serving)
    if gripper.hook == SIMULATED:
        return lambda: SimulatedGripper(gripper)
    found = OWN_HOOK.fullmatch(gripper.hook)
    assert found is not None  # the schema has seen to it
    kind = load_class(beside(arm, found["file"]), found["name"])
    return lambda: kind(gripper)


def beside(arm: ArmConfig, file: str) -> Path:
    """A path of the arm file: relative to its folder; on the command line, and for rtarm's own arms, to this one."""
    source = arm.source
    if source is None or source.built_in or "gripper.hook" in source.overridden:
        return Path(file)
    return Path(source.file).parent / file


def load_class(path: Path, name: str) -> Callable[[GripperConfig], Any]:
    """A class of a Python file, without side effects on what can be imported; raises CannotServe."""
    if not path.is_file():
        raise CannotServe(f"gripper.hook names {path}, which is no file: correct it, or put the file there.")
    spec = importlib.util.spec_from_file_location(f"rtarm_gripper_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there
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
