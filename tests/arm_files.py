"""Arm files of a test's own."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from config.loader import ARMS_FOLDER


def known_arm(arm: str) -> dict[str, Any]:
    """What stands in the file of an arm that comes with rtarm."""
    values: dict[str, Any] = yaml.safe_load((ARMS_FOLDER / f"{arm}.yaml").read_text(encoding="utf-8"))
    return values


@contextmanager
def edited(file: Path) -> Iterator[dict[str, Any]]:
    """What stands in an arm file; it is written back as it is in the end."""
    values = yaml.safe_load(file.read_text(encoding="utf-8"))
    yield values
    file.write_text(yaml.safe_dump(values), encoding="utf-8")


def write_arm(arm: str, name: str, folder: Path) -> Path:
    """The file of a known arm under another name, with a controller that is named after it."""
    values = known_arm(arm) | {"name": name}
    values.setdefault("front", {})["controller_name"] = f"controller_{name}"
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump(values), encoding="utf-8")
    return file
