"""`make test-dist`: the wheel in an environment that has nothing, for a user who has nothing, in an empty folder.

`python tests/packages/from_nothing.py WHEEL` installs it with everything it requires (several hundred megabytes, hence
no test of `make test`), plays the demo twice, the first time with an empty cache, and says what took how long. The
exit code is that of the first command that failed. A demo whose goal failed gets three more tries, as every test with
real processes does (tests/conftest.py): a stall of a shared machine ends a goal, and rightly so.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rtarm.console.errors import ExitCode

TRIES = 4


def timed(what: str, *command: str | Path, cwd: Path, environment: dict[str, str]) -> int:
    """Run a command and say how long it took; returns its exit code."""
    print(f"--- {what}", flush=True)
    started = time.monotonic()
    code = subprocess.run(command, cwd=cwd, env=environment, check=False).returncode
    print(f"--- {what}: {time.monotonic() - started:.0f} s, exit code {code}", flush=True)
    return code


def done(what: str, *command: str | Path, cwd: Path, environment: dict[str, str]) -> None:
    """Run a command; ends the program with its exit code when that is not 0."""
    if code := timed(what, *command, cwd=cwd, environment=environment):
        sys.exit(code)


def played(what: str, rtarm: Path, *, cwd: Path, environment: dict[str, str]) -> None:
    """Play the demo, again where a goal of it failed; ends the program with the exit code when that is not 0."""
    for _ in range(TRIES):
        code = timed(what, rtarm, "demo", cwd=cwd, environment=environment)
        if code != ExitCode.GOAL_FAILED:
            break
    if code:
        sys.exit(code)


def megabytes(folder: Path) -> float:
    return sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()) / 1e6


def main() -> None:
    wheel = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory(prefix="rtarm-from-nothing-") as name:
        environment, home, empty = (Path(name) / part for part in ("environment", "home", "empty"))
        for folder in (home, empty):
            folder.mkdir()
        # How pip reaches its index is the machine's affair; everything else is that of a user who was just made.
        kept = {key: value for key, value in os.environ.items() if key.startswith(("PIP_", "SSL_")) or key == "PATH"}
        pip = {**kept, "HOME": str(Path.home())}
        user = {"HOME": str(home), "PATH": "/usr/bin:/bin", "COLUMNS": "120"}
        done("environment", sys.executable, "-m", "venv", environment, cwd=empty, environment=pip)
        done("pip install", environment / "bin" / "pip", "install", "--quiet", wheel, cwd=empty, environment=pip)
        rtarm = environment / "bin" / "rtarm"
        played("first demo", rtarm, cwd=empty, environment=user)
        played("second demo", rtarm, cwd=empty, environment=user)
        assert not any(empty.iterdir())
        print(f"environment {megabytes(environment):.0f} MB, cache {megabytes(home / '.cache'):.0f} MB")


if __name__ == "__main__":
    main()
