"""`make lock`: write constraints.txt anew, the exact version of everything that an environment of rtarm holds.

uv finds one version of each package that does for all supported versions of Python. What is pinned stays as it is where
pyproject.toml still allows it; for the newest versions delete the file before. The parts are those that
packaging/environment.py installs, one after the other or at the same time. Whatever any of the supported versions of
Python needs is in it, since what another one needs too does no harm.
"""

import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "constraints.txt"
OLDEST_PYTHON = "3.11.2"
"""That of Debian 12, and of the Raspberry Pi OS made of it."""
COMPILES = {"numba", "numpy", "pydantic", "pyyaml"}
WORDS = {
    "cycle": "what compiles the control cycle",
    "rtarm": "what else rtarm needs, and what both of the following do",
    "ros": "ROS 2 from wheels",
    "tools": "all other extras: tests, checks, documentation, pictures",
}
"""The sections, in their order."""
_PIN = re.compile(r"^(\S+)==(\S+)(?: ; .*?(platform_machine [!=]= '\w+'))?", re.MULTILINE)
HEAD = "# The exact versions that rtarm is tested with, the same for Python 3.11, 3.12 and 3.13; made by `make lock`.\n"


def sections() -> dict[str, set[str]]:
    """Requirements of each part, which leads to more than its section holds."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    required = {line for line in project["project"]["dependencies"] if not line.startswith("rtarm[")}
    extras = project["project"]["optional-dependencies"]
    cycle = {line for line in required if re.split(r"\W", line.lower())[0] in COMPILES}
    cycle |= set(project["build-system"]["requires"])
    return {
        "cycle": cycle,
        "rtarm": cycle | required,
        "ros": cycle | required | set(extras.pop("ros")),
        "tools": cycle | required | {line for extra in extras.values() for line in extra},
    }


def resolved(requirements: Iterable[str], pinned: str) -> dict[str, str]:
    """Name and version of everything that these requirements lead to, on any supported Python.

    What only some processors need has the marker that says so behind its version: others have no wheel of it.
    """
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder, "found.txt")
        found.write_text(pinned, encoding="utf-8")  # which uv keeps to where it can
        command = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--universal", "--fork-strategy", "fewest"]
        command += ["--python-version", OLDEST_PYTHON, "--no-annotate", "--no-header", "--output-file", str(found), "-"]
        wanted = "\n".join(sorted(requirements))
        subprocess.run(command, cwd=ROOT, input=wanted, text=True, check=True)
        pins = _PIN.findall(found.read_text(encoding="utf-8"))
        assert len({name for name, _, _ in pins}) == len(pins), "one package has two versions: constraints.txt has one"
        return {name: version + (f"; {marker}" if marker else "") for name, version, marker in pins}


def main() -> None:
    wanted = sections()
    pins = resolved(set().union(*wanted.values()), LOCK.read_text(encoding="utf-8") if LOCK.exists() else "")
    pinned = "".join(f"{name}=={version}\n" for name, version in pins.items())
    names = {part: set(resolved(requirements, pinned)) for part, requirements in wanted.items()}
    # Either of the last two is left out somewhere, so what both need belongs to neither.
    names["rtarm"] |= names["ros"] & names["tools"]
    lines, seen = [HEAD], set[str]()
    for part, words in WORDS.items():
        lines += [f"\n# --- {part}: {words}\n", *(f"{name}=={pins[name]}\n" for name in sorted(names[part] - seen))]
        seen |= names[part]
    LOCK.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
