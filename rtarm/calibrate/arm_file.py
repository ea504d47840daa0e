"""Changing single values of a joint in an arm file: everything else in it stays as it is, to the byte."""

from __future__ import annotations

import difflib
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import yaml

from config.errors import ConfigError
from config.loader import arm_path, load_arm
from config.schema import ArmConfig
from config.yaml_text import value_of
from rtarm.console.errors import Refusal

Changes = Mapping[str, float]
"""New values of a joint by their fields: direction, ratio, zero_deg, lower_deg, upper_deg."""
UNLIKELY = 12_345.625
"""A value that stands in no arm file."""


class ArmFile:
    """An arm file that single values are written into, or a copy of one that is yet to be made.

    Raises Refusal before anything is written, with the sentence people read.
    """

    def __init__(self, name_or_path: str, output: Path | None) -> None:
        arm = load_arm(name_or_path)
        source = arm_path(name_or_path)
        if output is None and arm.source is not None and arm.source.built_in:
            raise Refusal(
                f"{arm.name} comes with rtarm and is not written to: give the file that shall get the values, such as "
                f"-o ./my_{arm.name}.yaml."
            )
        if output is not None and output.exists():
            raise Refusal(f"{output} is there already: calibrate that file itself, or choose another name for -o.")
        self._source = Path(os.path.realpath(source))
        self.path = Path(os.path.realpath(output or source))  # a link stays one
        folder = self.path.parent
        if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            raise Refusal(f"Nothing can be written to the folder {folder}: make it writable, or choose another.")
        if output is None and not os.access(self.path, os.W_OK):
            raise Refusal(f"{self.path} is not writable: make it so, or give another file with -o.")
        self._text = self._read(self._source)
        self._arm = arm

    @staticmethod
    def _read(path: Path) -> str:
        try:
            return path.read_bytes().decode("utf-8")  # with the line ends it has
        except (OSError, UnicodeDecodeError) as problem:
            raise Refusal(f"{path} cannot be read any more ({problem}).") from None

    def require_own_values(self, joint: int, fields: Iterable[str]) -> None:
        """Raise Refusal where a field of a joint cannot be written without changing another place of the file."""
        for field in fields:
            wanted = json.loads(json.dumps(value_of(self._text)))  # nothing is shared in it
            wanted["joints"][joint][field] = UNLIKELY
            try:
                found = value_of(with_value(self._text, joint, field, written(UNLIKELY)))
            except yaml.YAMLError:  # an alias has lost its anchor
                found = None
            if found != wanted:
                raise Refusal(
                    f"{field} of {self._arm.joints[joint].name} in {self._source} is shared with other places of the "
                    "file (an anchor), so it cannot be written for this joint alone: write the value itself there, "
                    "then run this again."
                )

    def require_valid(self, joint: int, changes: Changes) -> None:
        """Raise Refusal where the file could not have these values; nothing is written."""
        with tempfile.TemporaryDirectory() as folder:
            aside = Path(folder) / self.path.name
            aside.write_bytes(self._edited(joint, changes).encode("utf-8"))
            self._checked(aside, joint, changes)

    def difference(self, joint: int, changes: Changes) -> str:
        """What `write` would change, as a unified diff; raises Refusal where it cannot be done."""
        new = self._edited(joint, changes)
        lines = difflib.unified_diff(
            self._text.splitlines(), new.splitlines(), str(self._source), str(self.path), lineterm="", n=1
        )
        return "\n".join(lines)

    def write(self, joint: int, changes: Changes) -> None:
        """Put the file with these changes in place of the old one, once it loads and says just what it should."""
        new = self._edited(joint, changes)
        if self._read(self._source) != self._text or (self._source != self.path and self.path.exists()):
            raise Refusal(
                f"{self.path} was changed by somebody else meanwhile, so it was left as it is. Not written for "
                f"{self._arm.joints[joint].name}: {in_words(changes)}."
            )
        try:
            self._arm = self._replaced(new, joint, changes)
        except OSError as problem:
            raise Refusal(
                f"{self.path} could not be written ({problem.strerror}), so it is as it was. Not written for "
                f"{self._arm.joints[joint].name}: {in_words(changes)}."
            ) from problem
        self._source, self._text = self.path, new

    def _replaced(self, new: str, joint: int, changes: Changes) -> ArmConfig:
        """Write beside the file, check what was written, and only then put it in its place."""
        descriptor, name = tempfile.mkstemp(dir=self.path.parent, prefix=".", suffix=".yaml")
        beside = Path(name)
        try:
            with open(descriptor, "wb") as file:
                file.write(new.encode("utf-8"))
                file.flush()
                os.fsync(file.fileno())
            arm = self._checked(beside, joint, changes)
            self._take_after(beside)
            os.replace(beside, self.path)
        except BaseException:
            with suppress(FileNotFoundError):
                beside.unlink()
            raise
        return arm

    def _take_after(self, new: Path) -> None:
        """Give the new file the rights and, where that may be done, the owner of the old one."""
        if self._source != self.path:
            new.chmod(0o644)
            return
        shutil.copymode(self.path, new)
        owner = self.path.stat()
        with suppress(PermissionError):
            os.chown(new, owner.st_uid, owner.st_gid)

    def _checked(self, path: Path, joint: int, changes: Changes) -> ArmConfig:
        """The arm of the new file, which must be the old one with these changes and no other."""
        name = self._arm.joints[joint].name
        try:
            found = load_arm(path)
        except ConfigError as error:
            problem = error.errors[0].problem.rstrip(".")
            raise Refusal(
                f"The arm file would not be valid with {in_words(changes)} for {name} ({problem}), so it was left as "
                "it is: mend that in it by hand."
            ) from None
        wanted = self._arm.model_dump()
        wanted["joints"][joint].update(changes)
        if found.model_dump() != wanted:
            raise Refusal(
                f"The values of {name} in {self._source} are shared with other places of the file (an anchor), so it "
                f"was left as it is: write by hand {in_words(changes)}."
            )
        return found

    def _edited(self, joint: int, changes: Changes) -> str:
        text = self._text
        for field, value in changes.items():
            text = with_value(text, joint, field, written(value))
        return text


def written(value: float) -> str:
    """A value as it stands in a file."""
    return f"{value:.10g}"


def in_words(changes: Changes) -> str:
    """Values as a sentence says them."""
    return ", ".join(f"{field}: {written(value)}" for field, value in changes.items())


def with_value(text: str, joint: int, field: str, value: str) -> str:
    """The text of a valid arm file with one field of a joint set; a field that is missing is put behind its ratio."""
    root = yaml.compose(text, yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    joints = next(node for key, node in root.value if key.value == "joints")
    fields = {key.value: (key, node) for key, node in joints.value[joint].value}
    if field in fields:
        node = fields[field][1]
        return text[: node.start_mark.index] + value + text[node.end_mark.index :]
    if "ratio" not in fields:
        raise Refusal(
            f"The values of joint number {joint + 1} do not stand in its own entry of the file (but in an anchor): "
            f"write {field}: {value} there by hand."
        )
    key, ratio = fields["ratio"]
    end = ratio.end_mark.index
    if joints.value[joint].flow_style:
        return f"{text[:end]}, {field}: {value}{text[end:]}"
    line_end = text.find("\n", end)
    line_end = len(text) if line_end < 0 else line_end
    new_line = "\r\n" if text[line_end - 1 : line_end] == "\r" else "\n"
    line_end -= len(new_line) - 1
    return f"{text[:line_end]}{new_line}{' ' * key.start_mark.column}{field}: {value}{text[line_end:]}"
