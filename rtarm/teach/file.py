"""Motions as files: YAML that a person can read and change, checked in full before anything believes it."""

from __future__ import annotations

import io
import math
import os
import re
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from config.yaml_text import LIBYAML, is_flat
from rtarm.console.errors import Refusal
from rtarm.running.limits import Limits
from rtarm.running.status import is_path
from rtarm.teach.motion import Motion

FORMAT = 1
LONGEST_FILE_BYTES = 50_000_000
MOST_POINTS = 200_000
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
SUFFIX = ".yaml"
DEEPEST = 5
LOADER = LIBYAML or yaml.SafeLoader

LEAST_STEP_S = 1e-4
"""Between two points."""

Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False, strict=True)]


LEGIBLE = r"^[^\x00-\x1f\x7f-\x9f]+$"
"""A text without what a terminal would obey."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Joint(_Strict):
    name: Annotated[str, Field(max_length=63, pattern=LEGIBLE)]
    lower_deg: Number
    upper_deg: Number
    velocity_deg_s: Positive
    acceleration_deg_s2: Positive


class _Document(_Strict):
    format: Annotated[int, Field(ge=FORMAT, le=FORMAT, strict=True)]
    arm: Annotated[str, Field(max_length=64, pattern=LEGIBLE)]
    taught: Annotated[str, Field(max_length=64, pattern=LEGIBLE)]
    tolerance_deg: Positive
    deviation_deg: Annotated[Number, Field(ge=0.0)]
    joints: Annotated[list[_Joint], Field(min_length=1, max_length=64)]
    points: Annotated[list[list[Number]], Field(min_length=2, max_length=MOST_POINTS)]


def folder() -> Path:
    """Where motions are kept that have a name alone."""
    home = os.environ.get("XDG_DATA_HOME", "")
    return (Path(home) if home.startswith("/") else Path.home() / ".local" / "share") / "rtarm" / "motions"


def motion_path(name_or_path: str) -> Path:
    """The file meant: a name among the kept ones, or a path, which has a slash or ends in .yaml.

    Raises:
        Refusal: it is neither.
    """
    if is_path(name_or_path):
        return Path(name_or_path)
    if NAME.fullmatch(name_or_path) is None:
        raise Refusal(
            f"{name_or_path!r} is no name of a motion, which has letters, digits, - and _ (at most 64): give such a "
            "name, or the path of a file (./wave.yaml)."
        )
    return folder() / f"{name_or_path}{SUFFIX}"


def kept() -> list[Path]:
    """The files of all motions that are kept under a name, in the order of their names."""
    return sorted(path for path in folder().glob(f"*{SUFFIX}") if NAME.fullmatch(path.stem))


def require_free(path: Path, *, force: bool) -> None:
    """Make the folder of the kept motions if need be; raises Refusal where a motion could not be saved."""
    try:
        if path.parent == folder():
            path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise Refusal(f"{path} is a folder: name a file.")
        if path.exists() and not force:
            raise Refusal(f"{path} exists already: choose another name, or replace it with --force.")
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise Refusal(
            f"{path} cannot be written ({error.strerror}): name a file in a folder that exists and is yours."
        ) from None


def save(motion: Motion, path: Path, *, force: bool) -> None:
    """Write a motion; the file appears whole or not at all, and replaces another only with `force`.

    Raises:
        Refusal: it cannot be written.
    """
    try:
        with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            try:
                file.write(as_text(motion))
                file.flush()
                os.fsync(file.fileno())
                os.chmod(file.fileno(), 0o644)
                if force:
                    os.replace(file.name, path)
                else:
                    os.link(file.name, path)
            finally:
                Path(file.name).unlink(missing_ok=True)
    except OSError as error:
        raise Refusal(f"{path} cannot be written ({error.strerror}), so the motion is lost: mend that first.") from None


def as_text(motion: Motion) -> str:
    """The file's text."""
    limits = motion.limits
    text = io.StringIO()
    text.write(
        "# A motion taught by hand, for `rtarm play`. Between the points runs a cubic spline, at rest at both ends.\n"
    )
    text.write(f"format: {FORMAT}\narm: {_word(motion.arm)}\ntaught: {_word(motion.taught)}\n")
    text.write(f"tolerance_deg: {_number(math.degrees(motion.tolerance_rad))}\n")
    text.write(f"deviation_deg: {_number(math.degrees(motion.deviation_rad))}\njoints:\n")
    columns = (limits.lower_rad, limits.upper_rad, limits.velocity_rad_s, limits.acceleration_rad_s2)
    for joint, *values in zip(limits.joints, *(np.degrees(column) for column in columns), strict=True):
        lower, upper, velocity, acceleration = (_number(value) for value in values)
        text.write(f"- {{name: {_word(joint)}, lower_deg: {lower}, upper_deg: {upper}, ")
        text.write(f"velocity_deg_s: {velocity}, acceleration_deg_s2: {acceleration}}}\n")
    text.write(f"# time_s, then degrees: {', '.join(limits.joints)}\npoints:\n")
    for time_s, row in zip(motion.times_s, np.degrees(motion.positions_rad), strict=True):
        text.write(f"- [{_number(time_s)}, {', '.join(_number(value) for value in row)}]\n")
    return text.getvalue()


def _number(value: float) -> str:
    short = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if short == "-0" else short


def _word(text: str) -> str:
    """A text as YAML that means nothing but itself."""
    quoted: str = yaml.safe_dump(text, default_style='"', width=math.inf, allow_unicode=True)
    return quoted.strip()


def load(path: Path) -> Motion:
    """Read and check a motion.

    Raises:
        Refusal: with one sentence; there is no such file, or no motion of this format in it.
    """
    document = _document(path, _values(path))
    points = np.array(document.points) if len({len(row) for row in document.points}) == 1 else np.empty((0, 0))
    names = tuple(joint.name for joint in document.joints)
    if points.shape != (len(document.points), len(names) + 1):
        raise _no_motion(path, f"not every row of points has a time and {len(names)} angles")
    if len(set(names)) != len(names):
        raise _no_motion(path, "two joints have the same name")
    if points[0, 0] != 0.0 or not (np.diff(points[:, 0]) >= LEAST_STEP_S).all():
        raise _no_motion(path, f"the times of its points do not begin with 0 and rise by {LEAST_STEP_S:g} s or more")

    def column(name: str) -> np.ndarray:
        return np.radians([getattr(joint, name) for joint in document.joints])

    limits = Limits(
        names, column("lower_deg"), column("upper_deg"), column("velocity_deg_s"), column("acceleration_deg_s2")
    )
    return Motion(
        document.arm,
        limits,
        document.taught,
        math.radians(document.tolerance_deg),
        math.radians(document.deviation_deg),
        points[:, 0],
        np.radians(points[:, 1:]),
    )


def _values(path: Path) -> Any:
    """What YAML makes of the file."""
    try:
        with path.open("rb") as file:
            data = file.read(LONGEST_FILE_BYTES + 1)
    except OSError as error:
        names = ", ".join(kept_path.stem for kept_path in kept()) or "none"
        raise Refusal(f"{path} cannot be read ({error.strerror}): name a motion; those kept are: {names}.") from None
    if len(data) > LONGEST_FILE_BYTES:
        raise _no_motion(path, f"it has more than {LONGEST_FILE_BYTES} bytes")
    try:
        text = data.decode()
        if not is_flat(text, LOADER, DEEPEST, aliases=False):
            raise _no_motion(path, "it is nested too deep, or refers to itself")
        return yaml.load(text, Loader=LOADER)
    except UnicodeDecodeError:
        raise _no_motion(path, "it is no UTF-8 text") from None
    except yaml.MarkedYAMLError as error:
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise _no_motion(path, f"it is no YAML{line}, or it was cut off") from None
    except (yaml.YAMLError, ValueError):
        raise _no_motion(path, "it is no YAML") from None


def _document(path: Path, values: Any) -> _Document:
    if not isinstance(values, dict):
        raise _no_motion(path, "it is no table of a motion's fields")
    found = values.get("format")
    if isinstance(found, int) and not isinstance(found, bool) and found > FORMAT:
        raise Refusal(f"{path} has format {found}, and this rtarm reads format {FORMAT}: install a newer rtarm.")
    try:
        return _Document.model_validate(values)
    except ValidationError as error:
        raise _no_motion(path, _first(error)) from None


def _first(error: ValidationError) -> str:
    problem = error.errors(include_url=False, include_input=False)[0]
    place = ".".join(part if isinstance(part, str) and part.isidentifier() else repr(part) for part in problem["loc"])
    return f"{place}: {problem['msg'][:1].lower()}{problem['msg'][1:]}"


def _no_motion(path: Path, why: str) -> Refusal:
    return Refusal(f"{path} is no motion that rtarm can play ({why}): teach it again, or mend the file.")
