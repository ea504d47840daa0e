"""The page of the names that stay, with those of the committed lists that no other page has."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from handbook.markdown import code, page, table

ROOT = Path(__file__).parents[1]
REMARK = "  # "
"""Between a name and what a list says of it, such as `deprecated since 0.2.0: use OTHER`."""


def path_of(kind: str) -> Path:
    """The committed list of a kind of names."""
    return Path(__file__).parent / "stable_names" / f"{kind}.txt"


def listed(kind: str) -> dict[str, str]:
    """The names of a committed list, each with the remark it has there, "" if none."""
    path = path_of(kind)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {name: remark for name, _, remark in (line.partition(REMARK) for line in lines)}


INTRODUCTION = """\
What programs, arm files and scripts may build on. A name of the kinds below stays, with its meaning, its unit and its
type, until it has been [deprecated](#deprecation) for long enough; this holds before version 1.0 too. A test compares
each name with a committed list, so that none goes or changes unnoticed."""
KINDS = """\
- **Arm files**: every key of [the configuration](configuration.md), as `schema_version: 1` has them.
- **Commands**: [names, arguments and options](commands.md), and [exit codes](commands.md#exit-codes).
- **JSON**: the keys that `--json` prints, [below](#json-of-commands).
- **ROS**: [topics, services, actions and parameters](ros.md), and the fields of `robot_arm_interfaces`.
- **Recordings**: channels, fields and metadata of the MCAP files, [below](#recordings).
- **Words and numbers** of modes, faults, outcomes and the like in both: [numbers by name](memory.md#numbers-by-name).
- **Python**: what `import rtarm` gives, and what [a gripper of your own](../hardware/gripper.md) is made with,
  [below](#python)."""
GROWTH = """\
Every version may bring new names: keys, fields, options and parameters with a default, words such as a new fault or
mode. A program ignores what it does not know, and takes `null` for a value that is not known just then. The default of
a key or an option may change; the [changelog](../../CHANGELOG.md) says so."""
DEPRECATION = """\
A name that is to go, or to be called otherwise, becomes deprecated first. It then does what it did, beside the one that
takes its place, for **at least two minor versions and six months**; only after that it may go. It is told

- in the [changelog](../../CHANGELOG.md): under "Deprecated", with the name that takes its place, and under "Removed";
- in [the list below](#deprecated-now);
- where it is used: by a sentence on standard error for commands, options and keys of the arm file, by a
  `DeprecationWarning` in Python, by a line in the node's log for ROS. What only reads (JSON, recordings, topics) cannot
  be told there, and has the changelog and the list.

A name that turns out to be dangerous may go at once. The changelog then says why."""
KEPT = """\
Files of an earlier version go on working: arm files, taught motions, recordings, and what is kept of an arm between two
runs (lost references, counts, marks of power, findings of `rtarm commission`). Some of each version
[are kept as test data](../../tests/kept/README.md), and every later version must read them."""
NOT_STABLE = """\
- The wording of sentences, tables, help and logs, in any language. A program reads exit codes, names and numbers.
- [Words in shared memory](memory.md) and their places: processes of two versions refuse each other. Read
  `rtarm status --json`, or use `rtarm.connect`.
- Modules, functions and classes that are not [listed below](#python), and every name that begins with `_`.
- The order of keys in JSON, the figures that `rtarm demo --json FILE` and `rtarm bench --json FILE` write, and the
  report of `rtarm commission`.
- Keys and texts in `/diagnostics`, which are for people, and texts in results of ROS.
- The page of `rtarm view`, its addresses and what it exchanges with the browser; pictures of `rtarm plot`.
- Files that `rtarm moveit-config` makes. Names of ROS in them are stable as above.
- CAN frames and their timing."""


def build() -> str:
    """The page."""
    return page(
        "Stable names",
        INTRODUCTION,
        "## What stays",
        KINDS,
        GROWTH,
        "## Deprecation",
        DEPRECATION,
        "### Deprecated now",
        table(("name", "remark"), deprecated()) or "None.",
        "## Files of earlier versions",
        KEPT,
        "## What may change at any time",
        NOT_STABLE,
        "## JSON of commands",
        "`[]` stands for each element of a list. A refusal has its sentences in `problems`.",
        table(("command", "keys"), together("json")),
        "## Recordings",
        "`JOINT` stands for each joint's name. The schemas in a file say what each field means, with its unit.",
        table(("channel", "fields"), together("recordings")),
        "## Python",
        "[How they are used](../guides/python.md). A parameter behind `*` is given by its name alone.",
        table(("name", "with"), together("python")),
    )


def deprecated() -> Iterator[tuple[str, str]]:
    """The names that have a remark in a list."""
    for path in sorted(path_of("").parent.glob("*.txt")):
        yield from ((code(name), remark) for name, remark in listed(path.stem).items() if remark)


def together(kind: str) -> Iterator[tuple[str, str]]:
    """A row for each place that a list names before a colon, and one for places that have the same in them."""
    inside: dict[str, list[str]] = {}
    for line in listed(kind):
        place, _, name = line.partition(": ")
        inside.setdefault(place, []).append(code(name))
    places: dict[str, list[str]] = {}
    for place, names in inside.items():
        places.setdefault(", ".join(names), []).append(code(place))
    yield from ((", ".join(same), names) for names, same in places.items())
