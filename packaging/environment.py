"""`make env` and the like: the environment in .venv, made of steps that are done once for what they are made of.

`python3 packaging/environment.py PURPOSE` with `demo` (what `make demo` needs), `tools` (all packages and ROS
messages), `control` (what needs no ROS: the control process and its tests) or `all`. A stamp for each step stands for
everything that decides its result, so that a second call has nothing to do, one that was interrupted goes on, and what
changed is made anew. Only Python's own library.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from rtarm.launch.steps import CYCLE_S, MESSAGES_S, Step, StepFailed, run  # noqa: E402 - found by the line above

LOCK = ROOT / "constraints.txt"
ROS_SETUP = Path("/opt/ros/jazzy/setup.bash")
PURPOSES = {
    "demo": ("messages", "cycle", "rtarm"),
    "tools": ("messages", "rtarm", "tools"),
    "control": ("cycle", "rtarm", "tools", "functions"),
    "all": ("messages", "cycle", "rtarm", "tools", "functions"),
}
"""The steps that each purpose needs, beside those that these need."""
COMPILED = ("compilation/*.py", "config/*.py", "config/drives/*.py", "motion/**/*.py", "shm/**/*.py", "rtloop/**/*.py")
INTERFACES = ("rtarm_interfaces/**/*",)
WHEELS_OF_ROS = "x86_64"
"""The processor that ROS 2 has wheels for."""
LACKING = {"aarch64": ("toppra",)}
"""Of which tools a processor has no wheels; `rtarm teach` and its tests need toppra."""

# pip does not look for what is missing: the lock is complete. Byte code is made of what is used, when it is used.
INSTALL = ("install", "--quiet", "--no-deps", "--no-compile", "--no-build-isolation", "--disable-pip-version-check")


def locked(*sections: str) -> list[str]:
    """The pins of some sections of the lock."""
    found = dict(re.findall(r"^# --- (\w+):.*\n((?:[^#\n].*\n)*)", LOCK.read_text(encoding="utf-8"), re.MULTILINE))
    return [line for section in sections for line in found[section].splitlines()]


def tools() -> list[str]:
    """The pins of the tools that this processor has wheels of."""
    lacking = LACKING.get(platform.machine(), ())
    return [pin for pin in locked("tools") if pin.partition("==")[0] not in lacking]


def ros_is_sourced() -> bool:
    """Whether rclpy comes from an installation; wheels and that do not mix."""
    if not os.environ.get("ROS_DISTRO"):
        return False
    return subprocess.run([sys.executable, "-c", "import rclpy"], capture_output=True, check=False).returncode == 0


def steps_of(venv: Path, sourced: bool) -> list[Step]:
    """All steps, each after those that it needs."""
    python = str(venv / "bin" / "python")
    pip = [str(venv / "bin" / "pip"), *INSTALL]
    ros = [] if sourced or platform.machine() != WHEELS_OF_ROS else ["ros"]
    # Set by the ROS wheels inside a Python of theirs: an inherited one would make ours skip its library path.
    environment = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}

    def step(name: str, words: str, about_s: float, *commands: Sequence[str], needs: Sequence[str] = ()) -> Step:
        return Step(name, words, about_s, commands, needs, environment)

    return [
        step(
            "python",
            f"a Python environment in {venv}",
            3,
            [os.path.realpath(sys.executable), "-m", "venv", "--clear", str(venv)],
        ),
        step("compiler", "packages of the compiler", 7, [*pip, *locked("cycle")], needs=["python"]),
        step(
            *("packages", f"other packages{', ROS 2 from wheels' if ros else ''}", 15),
            # Those that come as source are built with setuptools.
            [*pip, *locked("rtarm", *ros)],
            needs=["python", "compiler"],
        ),
        step("cycle", "the control cycle", CYCLE_S, [python, "-m", "rtloop.warm"], needs=["compiler"]),
        step("rtarm", "rtarm itself", 3, [*pip, "--editable", str(ROOT)], needs=["packages"]),
        step("messages", "ROS messages", MESSAGES_S, [python, "-m", "rtarm_interfaces.build"], needs=["packages"]),
        step("tools", "packages of tests and documentation", 30, [*pip, *tools()], needs=["rtarm"]),
        step(
            *("functions", "the cycle's functions one by one, for tests", 70),
            [python, "tests/compiling.py"],
            needs=["cycle", "rtarm"],
        ),
    ]


def made_of(step: Step) -> Iterable[bytes]:
    """What decides the result of a step, beside the steps that it needs."""
    patterns = {"cycle": COMPILED, "functions": (*COMPILED, "tests/compiling.py"), "messages": INTERFACES}
    yield repr(step.commands).encode()
    for pattern in (*patterns.get(step.name, ()), *(["pyproject.toml"] if step.name == "rtarm" else [])):
        for path in sorted(ROOT.glob(pattern)):
            if path.is_file() and path.suffix != ".pyc":
                yield path.relative_to(ROOT).as_posix().encode()
                yield path.read_bytes()


def stamps_of(steps: Sequence[Step], origin: str) -> dict[str, str]:
    """What the stamp of each step says once it is done."""
    stamps: dict[str, str] = {}
    for step in steps:
        digest = hashlib.sha256("\0".join([origin, *(stamps[need] for need in step.needs)]).encode())
        for part in made_of(step):
            digest.update(hashlib.sha256(part).digest())
        stamps[step.name] = digest.hexdigest()
    return stamps


def with_needs(wanted: Iterable[str], steps: Sequence[Step]) -> set[str]:
    """Some steps and all that they need."""
    found = set(wanted)
    for step in reversed(steps):
        if step.name in found:
            found |= set(step.needs)
    return found


def forget_half_installed(venv: Path) -> None:
    """Have pip install anew what it was killed amid: it takes a package for there once its METADATA is.

    INSTALLER comes after all of a package's files.
    """
    for found in venv.glob("lib/python*/site-packages/*.dist-info"):
        if not (found / "INSTALLER").exists():
            shutil.rmtree(found)


def refusal() -> str | None:
    """Why this Python makes no environment, and what to do."""
    if not (3, 11) <= sys.version_info[:2] <= (3, 13):
        return (
            f"{sys.executable} is Python {platform.python_version()}, rtarm needs Python 3.11 to 3.13: install one and "
            "name it, as in 'make env PYTHON=python3.12'."
        )
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError:
        return (
            f"{sys.executable} cannot make virtual environments: install its venv module with "
            "'apt-get install python3-venv' and run make again."
        )
    return None


def lacks_ros(purpose: str, sourced: bool) -> str | None:
    """Why the message types of a purpose cannot be made here, and what to do."""
    if sourced or platform.machine() == WHEELS_OF_ROS or "messages" not in PURPOSES[purpose]:
        return None
    return (
        f"ROS 2 has no wheels for {platform.machine()}, and `{purpose}` needs ROS: source a ROS 2 Jazzy installation "
        "and run make again, or run 'python3 packaging/environment.py control' for what needs no ROS."
    )


def say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description="Make the environment.")
    parser.add_argument("purpose", choices=PURPOSES)
    parser.add_argument("--venv", default=".venv")
    options = parser.parse_args()
    venv = Path(options.venv)
    if why := refusal():
        say(why)
        return 1
    for number in (signal.SIGTERM, signal.SIGHUP):  # the commands that run then end too
        signal.signal(number, lambda caught, _: sys.exit(128 + caught))
    fcntl.flock(os.open(ROOT, os.O_RDONLY), fcntl.LOCK_EX)  # one at a time; it falls with this process
    sourced = ros_is_sourced()
    if why := lacks_ros(options.purpose, sourced):
        say(why)
        return 1
    steps = steps_of(venv, sourced)
    stamps = stamps_of(steps, f"{sys.version} {sourced}")
    folder = venv / "stamps"

    def is_done(step: Step) -> bool:
        stamp = folder / step.name
        return stamp.exists() and stamp.read_text(encoding="ascii") == stamps[step.name]

    def mark(step: Step, printed: str) -> None:
        folder.mkdir(exist_ok=True)
        (folder / step.name).write_text(stamps[step.name], encoding="ascii")
        if step.name == "messages" and sourced and printed:
            say(printed)

    wanted = with_needs(PURPOSES[options.purpose], steps)
    missing = [step for step in steps if step.name in wanted and not is_done(step)]
    if not missing:
        return 0
    if not sourced and ROS_SETUP.exists():
        say(f"ROS 2 comes from wheels; to use the installation, source {ROS_SETUP} and run make again")
    if venv.is_symlink() and missing[0].name == "python":
        venv.unlink()  # rather than clear what somebody else has there
    forget_half_installed(venv)
    started = time.monotonic()
    try:
        run(missing, say, mark)
    except StepFailed as failed:
        say(str(failed))
        return 1
    except KeyboardInterrupt:
        say("Interrupted: what was done is kept, and the same command goes on from here.")
        return 130
    say(f"{venv} is ready after {time.monotonic() - started:.0f} s")
    return 0


if __name__ == "__main__":
    os.chdir(ROOT)
    sys.exit(main())
