"""`make env` where a ROS installation is sourced: nothing of the wheels is installed, everything else is."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = ("bench", "dev", "docs", "plot", "teach", "view")

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def commands(tmp_path: Path, **environment: str) -> list[list[str]]:
    """What `make` would run to install the packages, into an environment that is not there."""
    ours = {name: value for name, value in os.environ.items() if name not in ("ROS_DISTRO", "PYTHONPATH", "MAKEFLAGS")}
    done = subprocess.run(
        ["make", "--dry-run", f"PYTHON={sys.executable}", f"VENV={tmp_path}/env", f"{tmp_path}/env/stamps/packages"],
        cwd=ROOT,
        env={**ours, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return [shlex.split(line) for line in done.stdout.replace("\\\n", " ").splitlines() if "/bin/" in line]


def test_with_wheels_all_extras_are_installed(tmp_path: Path) -> None:
    (editable,) = (command for command in commands(tmp_path) if "--editable" in command)
    assert editable[-1] == f".[{','.join(EXTRAS)}]"
    assert "--no-deps" not in editable


def test_beside_a_sourced_ros_the_wheels_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").touch()
    # rclpy of the environment that runs this test may be another one: the first on the path is meant.
    ran = commands(tmp_path, ROS_DISTRO="jazzy", PYTHONPATH=str(tmp_path))
    (editable,) = (command for command in ran if "--editable" in command)
    assert editable[-1] == "." and "--no-deps" in editable
    (listing,) = (command for command in ran if "tomllib" in " ".join(command))
    listed = subprocess.run(
        [sys.executable, "-c", listing[listing.index("-c") + 1]], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    wanted = [*PROJECT["dependencies"], *(line for extra in EXTRAS for line in PROJECT["optional-dependencies"][extra])]
    assert listed == [line for line in wanted if not line.startswith("rtarm[ros]")]
    assert not any(line.startswith("ros-") for line in listed)
