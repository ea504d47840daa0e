"""The wheel and the source distribution: what is in them, and that the wheel runs where no source tree is in sight."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rtarm.processes import WHEELS_GUARD

pytest.importorskip("control_msgs")

pytestmark = pytest.mark.process

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = (
    "compilation",
    "config",
    "motion",
    "rosfront",
    "rtarm",
    "rtarm_interfaces",
    "rtloop",
    "sentences",
    "shm",
    "sim",
)
SHARED = (
    "constraints.txt",
    *(f"{kind}/{path.name}" for kind in ("systemd", "udev") for path in (ROOT / "packaging" / kind).iterdir()),
)
NOT_SOURCE = shutil.ignore_patterns(
    *(".git", ".venv", "build", "dist", "fuzz-corpus", "*.egg-info"),
    *("__pycache__", ".*_cache", ".hypothesis", ".benchmarks"),
)
OF_SETUPTOOLS = re.compile(r"PKG-INFO|setup\.cfg|rtarm\.egg-info/.*")
BUILD_SDIST = "import sys; from setuptools import build_meta; print(build_meta.build_sdist(sys.argv[1]))"
DEMO_S = 600.0
"""A machine whose cache is empty compiles the cycle first."""

Rtarm = Callable[..., subprocess.CompletedProcess[str]]


def run(*command: str | Path, cwd: Path) -> None:
    done = subprocess.run(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, done.stdout


def wheel_of(source: Path, folder: Path) -> Path:
    """The wheel that pip makes of a source tree or a source distribution, with what is installed here."""
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder)
    run(sys.executable, "-m", "pip", "wheel", *options, source, cwd=folder.parent)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the source tree, which setuptools may write into."""
    copy = tmp_path_factory.mktemp("source") / "tree"
    shutil.copytree(ROOT, copy, ignore=NOT_SOURCE)
    return copy


@pytest.fixture(scope="module")
def sdist(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sdist")
    run(sys.executable, "-c", BUILD_SDIST, folder, cwd=tree)
    (archive,) = folder.iterdir()
    return archive


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return wheel_of(sdist, tmp_path_factory.mktemp("wheel") / "dist")


def content(wheel: Path) -> dict[str, int]:
    """CRC-32 of each file."""
    with zipfile.ZipFile(wheel) as archive:
        return {info.filename: info.CRC for info in archive.infolist() if not info.is_dir()}


def test_the_wheel_holds_what_the_packages_hold(wheel: Path) -> None:
    held = content(wheel)
    source = {
        path.relative_to(ROOT).as_posix()
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.name != "COLCON_IGNORE"
    }
    described = {name for name in held if ".dist-info/" in name}
    data = {name for name in held if ".data/" in name}
    assert set(held) - described - data == source
    assert {name.partition(".data/data/share/rtarm/")[2] for name in data} == set(SHARED)
    assert any(name.endswith("licenses/LICENSE") for name in described)
    assert {name for name in source if name.endswith("py.typed")} == {f"{folder}/py.typed" for folder in FOLDERS}


def test_a_wheel_of_the_source_tree_is_the_same(wheel: Path, tree: Path, tmp_path: Path) -> None:
    assert content(wheel_of(tree, tmp_path / "dist")) == content(wheel)


def test_the_source_distribution_is_the_repository(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        held = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    for kept in (
        "tests/packages/test_distributions.py",
        "docs/start/install.md",
        "bench/conftest.py",
        ".ci/run",
        "Makefile",
    ):
        assert kept in held
    if not (ROOT / ".git").exists():
        return
    tracked = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert {name for name in held if not OF_SETUPTOOLS.fullmatch(name)} == {
        name for name in tracked.split("\0") if name and (ROOT / name).exists()
    }


@pytest.fixture(scope="module")
def rtarm(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Rtarm:
    """The program of the installed wheel, run in an empty folder; the packages of this environment are lent to it."""
    folder = tmp_path_factory.mktemp("installed")
    environment, empty = folder / "environment", folder / "empty"
    empty.mkdir()
    run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=folder)
    python = environment / "bin" / "python"
    install = ("install", "--quiet", "--no-deps", "--no-index", wheel)
    run(sys.executable, "-m", "pip", "--python", python, *install, cwd=folder)
    (site_packages,) = environment.glob("lib/python3*/site-packages")
    # The folder alone: what its own .pth files add, such as an editable source tree, stays out of sight.
    (site_packages / "lent.pth").write_text(f"{sysconfig.get_path('purelib')}\n", encoding="utf-8")
    libraries = [Path(sys.prefix) / "lib", *Path(sysconfig.get_path("purelib")).glob("ros_*.libs")]
    inherited = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    path = [*map(str, libraries), *filter(None, [os.environ.get("LD_LIBRARY_PATH")])]
    lent = {
        WHEELS_GUARD: "1",
        "LD_LIBRARY_PATH": os.pathsep.join(path),
        "COLUMNS": "120",
        "XDG_STATE_HOME": str(folder / "state"),
    }

    def call(*arguments: str, program: str = "rtarm") -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [environment / "bin" / program, *arguments],
            cwd=empty,
            env={**inherited, **lent},
            capture_output=True,
            text=True,
            timeout=DEMO_S,
            check=False,
        )
        assert list(empty.iterdir()) == []
        return done

    return call


def test_the_installed_packages_are_the_wheels(rtarm: Rtarm) -> None:
    program = f"import sys, {', '.join(FOLDERS)}; print(*(m.__path__[0] for m in ({', '.join(FOLDERS)})), sep='\\n')"
    found = rtarm("-P", "-c", program, program="python").stdout.splitlines()
    assert [Path(path).name for path in found] == list(FOLDERS)
    assert not any(Path(path).is_relative_to(ROOT) for path in found)
    assert len({Path(path).parent for path in found}) == 1


def test_the_installed_program_knows_its_version(rtarm: Rtarm) -> None:
    assert rtarm("--version").stdout == f"rtarm {PROJECT['project']['version']}\n"


def test_the_installed_program_has_its_arms(rtarm: Rtarm) -> None:
    done = rtarm("config", "check", "episode1")
    assert (done.returncode, done.stderr) == (0, "")
    assert "highest rate     123.1 Hz" in done.stdout


@pytest.mark.timeout(2 * DEMO_S)
def test_the_installed_program_plays_its_demo(rtarm: Rtarm) -> None:
    done = rtarm("demo")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 of 4 goals succeeded" in done.stdout
