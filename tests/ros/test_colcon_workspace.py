"""The repository in a colcon workspace, built by the real colcon, and its programs run as `ros2 run` runs them."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import pytest
from arm_files import write_arm

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from ros_client import SUCCEEDED, Client, recorded
from waiting import until

ROOT = Path(__file__).resolve().parents[2]
BUILT_FOLDERS = ("config", "motion", "rosfront", "rtarm", "rtloop", "shm", "sim")
LONG_S = 60.0
SEARCH = f"{sys.prefix}/bin{os.pathsep}{os.environ['PATH']}"
"""Where programs are looked for: cmake may come from the environment's wheels."""


def colcon() -> str | None:
    """The one of `make test`, else that of the machine."""
    ours = Path(sys.prefix) / "colcon" / "bin" / "colcon"
    return str(ours) if ours.exists() else shutil.which("colcon")


pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(colcon() is None, reason="colcon is not installed: `make test` does that"),
    pytest.mark.skipif(shutil.which("cmake", path=SEARCH) is None, reason="cmake is not installed"),
]


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace whose only source is this repository, built."""
    return built_in(tmp_path_factory.mktemp("a workspace"))


def built_in(folder: Path, *options: str) -> Path:
    (folder / "src").mkdir()
    (folder / "src" / "rtarm").symlink_to(ROOT)
    build(folder, *options)
    return folder


def build(workspace: Path, *options: str) -> str:
    environment = dict(os.environ)
    if not environment.get("ROS_DISTRO"):  # wheels: what sourcing an installation would set
        environment |= {"CMAKE_PREFIX_PATH": sys.prefix, "AMENT_PREFIX_PATH": sys.prefix}
        environment["PATH"] = SEARCH
    done = subprocess.run(
        [str(colcon()), "build", *options],
        cwd=workspace,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


class Program:
    """A program of the workspace, started by its path as `ros2 run` does."""

    def __init__(self, workspace: Path, name: str, arguments: Sequence[str]) -> None:
        self.output = workspace / f"{name}.log"
        with self.output.open("w") as output:
            self.process = subprocess.Popen(
                [workspace / "install" / "rtarm" / "lib" / "rtarm" / name, *arguments],
                cwd="/",
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
            )

    def says(self, text: str) -> bool:
        written = self.output.read_text(encoding="utf-8")
        assert text in written or self.process.poll() is None, written
        return text in written

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(LONG_S)


@pytest.fixture
def run(workspace: Path) -> Iterator[object]:
    programs: list[Program] = []

    def start(name: str, *arguments: str) -> Program:
        programs.append(Program(workspace, name, arguments))
        return programs[-1]

    yield start
    for program in programs:
        if program.process.poll() is None:
            program.end()


def test_packages_and_what_is_installed(workspace: Path) -> None:
    listed = subprocess.run(
        [str(colcon()), "list", "--names-only"], cwd=workspace, capture_output=True, text=True, check=True
    )
    assert listed.stdout.split() == ["episode1_moveit_config", "rtarm"]
    rtarm = workspace / "install" / "rtarm"
    assert {path.name for path in (rtarm / "lib" / "rtarm").iterdir()} == {
        "robot_interface", "robot_interface_full", "trajectory_printer", "rtarm", "python"
    }  # fmt: skip
    assert {path.name for path in (rtarm / "lib" / "rtarm" / "python").iterdir()} == set(BUILT_FOLDERS)
    for name in BUILT_FOLDERS:
        built = {path.relative_to(rtarm) for path in (rtarm / "lib" / "rtarm" / "python" / name).rglob("*.py")}
        source = {path.relative_to(ROOT) for path in (ROOT / name).rglob("*.py") if "interfaces" not in path.parts}
        assert {Path(*path.parts[3:]) for path in built} == source
    moveit = workspace / "install" / "episode1_moveit_config" / "share" / "episode1_moveit_config"
    for name in ("config", "launch", ".setup_assistant", "package.xml"):
        assert (moveit / name).exists(), name


def test_a_sourced_workspace_offers_no_short_names_to_other_nodes(workspace: Path) -> None:
    sourced = subprocess.run(
        ["bash", "-c", "source install/setup.bash && printenv AMENT_PREFIX_PATH && printenv PYTHONPATH"],
        cwd=workspace,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
    )
    prefixes, *python_path = sourced.stdout.splitlines()
    assert {str(workspace / "install" / name) for name in ("rtarm", "episode1_moveit_config")} <= set(
        prefixes.split(":")
    )
    assert not any("rtarm" in part for part in python_path)


def test_robot_interface_takes_a_goal(workspace: Path, run, arm_name: str, tmp_path: Path) -> None:
    file = write_arm("mock", arm_name, tmp_path)
    program = run("robot_interface", "--ros-args", "-p", f"arm:={file}", "-p", "init_mode:=1")
    until(lambda: program.says("rtarm  running"), "the arm running", LONG_S)
    with closing(Client(f"controller_{arm_name}")) as client:
        state, _, sentence = client.run(recorded("small"))
        assert state == SUCCEEDED, sentence
    assert program.end() == 0, program.output.read_text()


def test_the_printer_runs(run) -> None:
    program = run("trajectory_printer")
    until(lambda: program.says("轨迹打印节点已启动"), "the printer's first line", LONG_S)
    assert program.end() == 0


def test_the_command_line_is_there_too(workspace: Path) -> None:
    check_an_arm_file(workspace)


def test_files_may_be_linked_instead_of_copied(tmp_path: Path) -> None:
    workspace = built_in(tmp_path, "--symlink-install")
    assert (workspace / "install" / "rtarm" / "lib" / "rtarm" / "python" / "rtarm" / "cli.py").is_symlink()
    check_an_arm_file(workspace)


def check_an_arm_file(workspace: Path) -> None:
    program = workspace / "install" / "rtarm" / "lib" / "rtarm" / "rtarm"
    checked = subprocess.run([program, "config", "check", "episode1"], capture_output=True, text=True, check=False)
    assert checked.returncode == 0 and "joint6" in checked.stdout, checked.stderr


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    package = ET.parse(ROOT / "ros" / "rtarm" / "package.xml")
    assert package.findtext("version") == project["version"]
    assert package.findtext("description") == project["description"]
