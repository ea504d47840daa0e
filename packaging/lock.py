"""`make lock`: write constraints.txt anew, the exact version of everything that an environment of rtarm holds.

What is pinned stays as it is where pyproject.toml still allows it; for the newest versions delete the file before.
The parts are those that packaging/environment.py installs, one after the other or at the same time. Whatever any of
the supported versions of Python needs is in it, since what another one needs too does no harm.
"""

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

from pip._vendor.packaging.requirements import Requirement
from pip._vendor.packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "constraints.txt"
PYTHONS = ("3.11", "3.12", "3.13")
COMPILES = ("numba", "numpy", "pydantic", "pyyaml")
WORDS = {
    "cycle": "what compiles the control cycle",
    "rtarm": "what else rtarm needs, and what both of the following do",
    "ros": "ROS 2 from wheels",
    "tools": "all other extras: tests, checks, documentation, pictures",
}
"""The sections, in their order."""
HEAD = "# The exact versions that rtarm is tested with, the same for Python 3.11, 3.12 and 3.13; made by `make lock`.\n"


def sections() -> dict[str, set[str]]:
    """Requirements of each part, which leads to more than its section holds."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    required = {line for line in project["project"]["dependencies"] if not line.startswith("rtarm[")}
    extras = project["project"]["optional-dependencies"]
    cycle = {line for line in required if name_of(line) in COMPILES} | set(project["build-system"]["requires"])
    return {
        "cycle": cycle,
        "rtarm": cycle | required,
        "ros": cycle | required | set(extras.pop("ros")),
        "tools": cycle | required | {line for extra in extras.values() for line in extra},
    }


def resolved(requirements: list[str]) -> dict[str, str]:
    """Name and version of everything that these requirements lead to, on any supported Python."""
    wanted = list(requirements)
    while True:
        items = report(wanted)
        found = {canonicalize_name(item["metadata"]["name"]): item["metadata"]["version"] for item in items}
        lacking = {line for item in items for line in needed_elsewhere(item) if name_of(line) not in found}
        if not lacking:
            return found
        wanted += sorted(lacking)


def report(requirements: list[str]) -> list[dict[str, Any]]:
    """What pip would install into an empty environment."""
    pins = ["--constraint", str(LOCK)] if LOCK.exists() else []
    with tempfile.NamedTemporaryFile(suffix=".json") as file:
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet"]
        subprocess.run([*command, "--report", file.name, *pins, *requirements], check=True)
        items: list[dict[str, Any]] = json.load(file)["install"]
    return items


def needed_elsewhere(item: dict[str, Any]) -> list[str]:
    """Requirements of a package that hold on some supported Python, without the condition."""
    lines = []
    for line in item["metadata"].get("requires_dist", ()):
        requirement = Requirement(line)
        extras = ("", *item.get("requested_extras", ()))
        holds = requirement.marker is None or any(
            requirement.marker.evaluate(
                {"python_version": python, "python_full_version": f"{python}.0", "extra": extra}
            )
            for python in PYTHONS
            for extra in extras
        )
        if holds:
            requirement.marker = None
            lines.append(str(requirement))
    return lines


def name_of(line: str) -> str:
    return canonicalize_name(Requirement(line).name)


def main() -> None:
    leads_to = {name: resolved(sorted(requirements)) for name, requirements in sections().items()}
    pins: dict[str, str] = {}
    for of in leads_to.values():
        pins |= {name: version for name, version in of.items() if name not in pins}
    # Either of the last two is left out somewhere, so what both need belongs to neither.
    names = {name: set(of) for name, of in leads_to.items()}
    names["rtarm"] |= names["ros"] & names["tools"]
    lines, seen = [HEAD], set[str]()
    for part, words in WORDS.items():
        lines += [f"\n# --- {part}: {words}\n", *(f"{name}=={pins[name]}\n" for name in sorted(names[part] - seen))]
        seen |= names[part]
    LOCK.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
