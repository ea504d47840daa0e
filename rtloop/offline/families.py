"""How an offline program finds its code for a family of drives: a file of the family's name in the program's folder."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from config.drives.drive import Drive


def knows(folder: str, drive: Drive) -> bool:
    """Whether the program in `folder` supports the drive's family."""
    return find_spec(_name(folder, drive)) is not None


def file_of(folder: str, drive: Drive) -> Any:
    """The module of a supported family in `folder`, which defines what is in it."""
    return import_module(_name(folder, drive))


def _name(folder: str, drive: Drive) -> str:
    return f"rtloop.offline.{folder}.{drive.family}"
