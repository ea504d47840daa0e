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
BUILT_FOLDERS = ("compilation", "config", "motion", "rosfront", "rtarm", "rtloop", "sentences", "shm", "sim")
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

    def __init__(self, workspace: Path, name: str, arguments: Sequence[str], package: str) -> None:
        self.output = workspace / f"{package}.{name}.log"
        with self.output.open("w") as output:
            self.process = subprocess.Popen(
                [found(workspace, package) / "lib" / package / name, *arguments],
                cwd="/",
                env=sourced(workspace),
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


def sourced(workspace: Path, *packages: str) -> dict[str, str]:
    """The environment, with what sourcing the workspace adds to the places where packages are looked for."""
    prefixes = [str(workspace / "install" / name) for name in packages or ("rtarm", "py_episode")]
    before = os.environ.get("AMENT_PREFIX_PATH")
    return {**os.environ, "AMENT_PREFIX_PATH": os.pathsep.join([*prefixes, *([before] if before else [])])}


def found(workspace: Path, package: str) -> Path:
    """Where `ros2 run` looks for a package's programs, by the resource index."""
    prefix = workspace / "install" / package
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / package).exists()
    return prefix


@pytest.fixture
def run(workspace: Path) -> Iterator[object]:
    programs: list[Program] = []

    def start(name: str, *arguments: str, package: str = "rtarm") -> Program:
        programs.append(Program(workspace, name, arguments, package))
        return programs[-1]

    yield start
    for program in programs:
        if program.process.poll() is None:
            program.end()


def test_packages_and_what_is_installed(workspace: Path) -> None:
    listed = subprocess.run(
        [str(colcon()), "list", "--names-only"], cwd=workspace, capture_output=True, text=True, check=True
    )
    assert listed.stdout.split() == ["episode1_moveit_config", "py_episode", "rtarm"]
    assert "Traceback" not in listed.stderr
    rtarm = workspace / "install" / "rtarm"
    assert {path.name for path in (rtarm / "lib" / "rtarm").iterdir()} == {
        "robot_interface", "robot_interface_full", "trajectory_printer", "rtarm", "python"
    }  # fmt: skip
    assert {path.name for path in (rtarm / "lib" / "rtarm" / "python").iterdir()} == set(BUILT_FOLDERS)
    for name in BUILT_FOLDERS:
        built = {path.relative_to(rtarm) for path in (rtarm / "lib" / "rtarm" / "python" / name).rglob("*.py")}
        source = {path.relative_to(ROOT) for path in (ROOT / name).rglob("*.py")}
        assert {Path(*path.parts[3:]) for path in built} == source
    alias = workspace / "install" / "py_episode"
    assert {path.name for path in (alias / "lib" / "py_episode").iterdir()} == {
        "robot_interface_full", "trajectory_printer"
    }  # fmt: skip
    assert not list(alias.rglob("*.py")), "it copies nothing, and no module stands in the way of another py_episode"
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


@pytest.mark.parametrize(
    ("package", "name"), [("rtarm", "robot_interface"), ("py_episode", "robot_interface_full")], ids=["ours", "chapter"]
)
def test_robot_interface_takes_a_goal(run, arm_name: str, tmp_path: Path, package: str, name: str) -> None:
    file = write_arm("mock", arm_name, tmp_path)
    program = run(name, "--ros-args", "-p", f"arm:={file}", "-p", "init_mode:=1", package=package)
    until(lambda: program.says("rtarm  running"), "the arm running", LONG_S)
    with closing(Client(f"controller_{arm_name}")) as client:
        state, _, sentence = client.run(recorded("small"))
        assert state == SUCCEEDED, sentence
    assert program.end() == 0, program.output.read_text()


@pytest.mark.parametrize("package", ["rtarm", "py_episode"])
def test_the_printer_runs(run, package: str) -> None:
    program = run("trajectory_printer", package=package)
    until(lambda: program.says("轨迹打印节点已启动"), "the printer's first line", LONG_S)
    assert program.end() == 0


def test_the_chapters_build_of_one_package(workspace: Path) -> None:
    assert "1 package finished" in build(workspace, "--packages-select", "py_episode")


@pytest.mark.parametrize("name", ["robot_interface_full", "trajectory_printer"])
def test_the_chapters_names_say_where_rtarm_is_missing(workspace: Path, name: str) -> None:
    program = found(workspace, "py_episode") / "lib" / "py_episode" / name
    environment = sourced(workspace, "py_episode")
    missing = subprocess.run([program], env=environment, capture_output=True, text=True, check=False)
    assert missing.returncode == 1
    assert missing.stderr.startswith(f"Package rtarm, whose {name} this runs, is in no sourced workspace: build it")
    assert missing.stderr.count("\n") == 1


def test_ones_own_packages_of_the_chapter_stay(tmp_path: Path) -> None:
    """Two packages of one name colcon refuses, saying where they are; the one that is marked is left out."""
    sources = tmp_path / "src"
    sources.mkdir()
    (sources / "rtarm").symlink_to(ROOT)
    own = sources / "py_episode"
    shutil.copytree(ROOT / "ros" / "py_episode", own)
    student = sources / "episode1_urdf_student_moveit"
    shutil.copytree(ROOT / "ros" / "episode1_moveit_config", student)
    description = (student / "package.xml").read_text(encoding="utf-8")
    (student / "package.xml").write_text(description.replace("episode1_moveit_config", student.name), encoding="utf-8")

    refused = subprocess.run([str(colcon()), "build"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert refused.returncode != 0 and "src/rtarm/ros/py_episode" in refused.stderr
    (own / "COLCON_IGNORE").touch()
    listed = subprocess.run(
        [str(colcon()), "list", "--names-only"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert listed.stdout.split() == ["episode1_moveit_config", student.name, "py_episode", "rtarm"]


def test_the_command_line_is_there_too(workspace: Path) -> None:
    check_an_arm_file(workspace)


def test_files_may_be_linked_instead_of_copied(tmp_path: Path) -> None:
    workspace = built_in(tmp_path, "--symlink-install")
    (linked,) = (workspace / "install" / "rtarm" / "lib" / "rtarm" / "python" / "rtarm").glob("__main__.py")
    assert linked.is_symlink()
    check_an_arm_file(workspace)


def check_an_arm_file(workspace: Path) -> None:
    program = workspace / "install" / "rtarm" / "lib" / "rtarm" / "rtarm"
    checked = subprocess.run([program, "config", "check", "episode1"], capture_output=True, text=True, check=False)
    assert checked.returncode == 0 and "joint6" in checked.stdout, checked.stderr


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    package = ET.parse(ROOT / "ros" / "rtarm" / "package.xml")
    alias = ET.parse(ROOT / "ros" / "py_episode" / "package.xml")
    assert package.findtext("version") == alias.findtext("version") == project["version"]
    assert package.findtext("description") == project["description"]
