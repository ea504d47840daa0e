"""The folders are the architecture: who may import whom, and what no file may say."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from config.joint import FAMILIES

ROOT = Path(__file__).resolve().parents[1]

ALLOWED_IMPORTS = {
    "compilation": set(),
    "config": set(),
    "motion": set(),
    "rtarm_interfaces": set(),
    "shm": {"compilation"},
    "sentences": {"shm"},
    "rtloop": {"compilation", "config", "motion", "shm", "sentences"},
    "rosfront": {"config", "motion", "shm", "sentences"},
    "sim": {"config"},
    "rtarm": {"compilation", "config", "motion", "rtarm_interfaces", "shm", "sentences", "rtloop", "rosfront", "sim"},
    "handbook": {"config", "shm", "sentences", "rtloop", "rosfront", "rtarm"},
}
ROOMS_OF_RTLOOP = (
    ("memory", "system"),
    ("wire", "trajectory"),
    ("safety", "service"),
    ("drives",),
    ("bus", "commands", "kept"),
    ("cycle", "dialogues", "publish", "setpoints"),
    ("process",),
    ("__main__", "offline", "warm"),
)
"""From the ground up: a room imports from those on the floors below it alone; the files of the cycle stand together."""
ROOMS_OF_RTARM = (
    ("console", "doctor", "moveit", "processes"),
    ("running", "scan"),
    ("top",),
    ("recording",),
    ("launch", "why_late"),
    ("client", "drives", "led"),
    ("arm", "calibrate", "demo", "teach", "view"),
    ("bench", "commissioning", "jog", "replay"),
    ("cli",),
    ("__main__",),
)
"""As those of rtloop; files at the top of the package are rooms of their own."""
FAMILY_NAMES = re.compile(rf"(?<![a-z])(?i:{'|'.join(FAMILIES[1:])})(?![a-z])")
"""Names of families of drives, alone or within others; the first is that of no drive at all."""
NAMES_A_FAMILY = {
    "rtloop/drives/power.py": "its table says of each family what proves the power of its drives",
    "rtloop/drives/sdo.py": "CANopen's identifiers are constants of the family that has them",
    "rtloop/memory/link.py": "a part of the cycle's memory names the modules that store into it",
}
OF_NO_SINGLE_ROOM = {
    "rtloop": {"test_no_interpreter.py"},
    "rtarm": {
        "test_arm_from_python.py",
        "test_child_process.py",
        "test_jog.py",
        "test_other_families.py",
        "test_planted_files.py",
        "test_stable_names.py",
    },
}
"""Tests of several rooms, or of a file at the top of the package."""
FORBIDDEN_IMPORTS = {
    "rtloop": {"rclpy", "control_msgs", "sensor_msgs", "trajectory_msgs", "std_msgs", "std_srvs"},
    "rosfront": {"numba", "llvmlite", "can"},
}
GENERATED_FOLDERS = {"build", "dist", "__pycache__"}

MACHINE_PATHS = re.compile(r"(?<![\w.~])/(?:root|work|opt/python|opt/pypi|opt/wheels|tmp/\w)[\w/.-]*")
REGISTRIES = re.compile(r"pypi\.org|pythonhosted|npmjs|deb\.debian|index-url|find-links", re.IGNORECASE)


def imported_modules(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of everything that a file imports, wherever in the file it does so."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            yield node.lineno, ".".join([*base, *(node.module or "").split(".")]).strip(".")


def imported_names(path: Path, line: int) -> list[str]:
    """What the import in a line takes out of its module."""
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return [
        name.name for node in tree if isinstance(node, ast.ImportFrom) and node.lineno == line for name in node.names
    ]


def module_names(folder: str) -> list[str]:
    """Every module of a package that can be imported without running a program."""
    names = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if all(part.isidentifier() for part in parts) and parts[-1] != "__main__":
            names.append(".".join(parts).removesuffix(".__init__"))
    return names


def text_files() -> Iterator[tuple[str, str]]:
    """Path and text of every file of the project but this one."""
    for directory, folders, files in os.walk(ROOT):
        folders[:] = [
            name
            for name in folders
            if name not in GENERATED_FOLDERS
            and not name.endswith(".egg-info")
            and not (name.startswith(".") and name != ".ci")
        ]
        for name in files:
            path = Path(directory, name)
            if path == Path(__file__).resolve():
                continue
            try:
                yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue


@pytest.mark.parametrize("folder", ALLOWED_IMPORTS)
def test_packages_import_only_what_the_layout_allows(folder: str) -> None:
    refused = (set(ALLOWED_IMPORTS) | {"tests", "bench"}) - ALLOWED_IMPORTS[folder] - {folder}
    refused |= FORBIDDEN_IMPORTS.get(folder, set())
    offences = [
        f"{path.relative_to(ROOT)}:{line} imports {module}"
        for path in (ROOT / folder).rglob("*.py")
        for line, module in imported_modules(path)
        if module.split(".")[0] in refused
    ]
    assert offences == []


def test_nothing_that_is_compiled_is_made_of_sentences() -> None:
    """The key of compiled code does not know them (`compilation.cache.COMPILED_SOURCES`)."""
    offences = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in (ROOT / "rtloop").rglob("*.py")
        if "@jit" in path.read_text(encoding="utf-8")
        for line, module in imported_modules(path)
        if module.split(".")[0] == "sentences"
    ]
    assert offences == []


@pytest.mark.parametrize(("folder", "floors"), [("rtloop", ROOMS_OF_RTLOOP), ("rtarm", ROOMS_OF_RTARM)])
def test_no_room_imports_from_its_own_floor_or_above(folder: str, floors: tuple[tuple[str, ...], ...]) -> None:
    floor = {room: number for number, rooms in enumerate(floors) for room in rooms}
    offences = []
    for path in (ROOT / folder).rglob("*.py"):
        here = path.relative_to(ROOT / folder).with_suffix("").parts[0]
        if here == "__init__":
            continue
        for line, module in imported_modules(path):
            package, *parts = module.split(".")
            if package != folder:
                continue
            for room in parts[:1] or imported_names(path, line):
                together = here == room or {here, room} <= {"cycle", "setpoints", "publish"}
                if not together and floor[room] >= floor[here]:
                    offences.append(f"{path.relative_to(ROOT)}:{line} imports from {room}")
    assert offences == []


@pytest.mark.parametrize(("folder", "floors"), [("rtloop", ROOMS_OF_RTLOOP), ("rtarm", ROOMS_OF_RTARM)])
def test_tests_stand_in_the_room_of_what_they_test(folder: str, floors: tuple[tuple[str, ...], ...]) -> None:
    rooms = {room for floor in floors for room in floor}
    tests = ROOT / "tests" / folder
    assert {path.parent.name for path in tests.glob("*/*.py")} <= rooms
    assert {path.name for path in tests.glob("test_*.py")} == OF_NO_SINGLE_ROOM[folder]


def test_in_rtloop_a_family_of_drives_is_named_by_its_own_files_alone() -> None:
    """A family's files begin with its name and are found by it; no other file may know what a family does."""
    own = re.compile(rf"(?:{'|'.join(FAMILIES)})(?:_\w+)?")
    named = {
        str(path.relative_to(ROOT)): [
            found.group() for found in FAMILY_NAMES.finditer(path.read_text(encoding="utf-8"))
        ]
        for path in (ROOT / "rtloop").rglob("*.py")
        if not own.fullmatch(path.stem)
    }
    assert {path: names for path, names in named.items() if names and path not in NAMES_A_FAMILY} == {}
    assert [path for path in NAMES_A_FAMILY if not named[path]] == []


def test_partners_of_ordered_accesses_are_there() -> None:
    """Each name in backticks of such a comment is that of a function, a class or a file of the two packages."""
    sources = {
        path: path.read_text(encoding="utf-8") for name in ("shm", "rtloop") for path in (ROOT / name).rglob("*.py")
    }
    there = {path.stem for path in sources} | {"params.reported"}
    for text in sources.values():
        there |= set(re.findall(r"^(?:\s*(?:def|class) )?(\w+)", text, re.MULTILINE))
    named = {
        (str(path.relative_to(ROOT)), name)
        for path, text in sources.items()
        for comment in re.findall(r"# pairs with (.*)", text)
        for name in re.findall(r"`([^`]+)`", comment)
    }
    assert [(place, name) for place, name in sorted(named) if not {name, name.split(".")[-1]} & there] == []


def test_each_ordered_access_names_its_partner() -> None:
    """Above an acquire, a release or a fence a comment says which access on the other side it pairs with."""
    ordered = re.compile(r"\b(load_acquire|store_release|fence_acquire|fence_release)\(")
    offences = []
    for folder in ("shm", "rtloop"):
        for path in (ROOT / folder).rglob("*.py"):
            lines = path.read_text(encoding="utf-8").split("\n")
            named = False
            for number, line in enumerate(lines, 1):
                if line.lstrip().startswith("# pairs with "):
                    named = True
                elif ordered.search(line):
                    if not named:
                        offences.append(f"{path.relative_to(ROOT)}:{number}")
                elif line.strip() and not line.lstrip().startswith("#"):
                    named = False
    assert offences == []


def test_motion_depends_on_nothing_but_numpy() -> None:
    offences = [
        f"{path.relative_to(ROOT)}:{line} imports {module}"
        for path in (ROOT / "motion").rglob("*.py")
        for line, module in imported_modules(path)
        if module.split(".")[0] not in {"motion", "numpy", *sys.stdlib_module_names}
    ]
    assert offences == []


@pytest.mark.parametrize(
    ("modules", "forbidden"),
    [
        pytest.param(module_names("rosfront"), {"numba", "llvmlite", "can"}, id="rosfront"),
        pytest.param(module_names("rtloop"), {"rclpy"}, id="rtloop"),
        pytest.param(
            ["rtloop.process.control_process", "rtloop.process.compiled"],
            {"numba", "rclpy", "can"},
            id="control process",
        ),
        pytest.param(module_names("rtarm"), {"numba", "rclpy", "can"}, id="rtarm"),
    ],
)
def test_importing_modules_loads_nothing_they_must_live_without(modules: list[str], forbidden: set[str]) -> None:
    """The same rules for what arrives indirectly, through our own packages or anybody else's."""
    program = f"import sys, {', '.join(modules)}; print(*sorted({forbidden!r} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout.strip(), result.stderr) == (0, "", "")


@pytest.mark.parametrize("folder", ALLOWED_IMPORTS)
def test_packages_are_typed_and_say_what_they_are(folder: str) -> None:
    assert (ROOT / folder / "py.typed").exists()
    assert ast.get_docstring(ast.parse((ROOT / folder / "__init__.py").read_text(encoding="utf-8")))


@pytest.mark.parametrize("pattern", [MACHINE_PATHS, REGISTRIES], ids=["machine path", "registry"])
def test_no_file_names_a_machine_or_a_registry(pattern: re.Pattern[str]) -> None:
    offences = [
        f"{name}: {match.group()}" for name, text in text_files() if (match := pattern.search(text)) is not None
    ]
    assert offences == []
