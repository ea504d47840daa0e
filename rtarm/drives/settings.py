"""`rtarm drives`: the settings of an arm's drives beside those the arm file names, and writing them when told.

A control process of its own reads them (`python -m rtloop.offline.settings`): nothing else opens the bus.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from config.buses import places
from config.schema import ArmConfig
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import undisturbed
from rtarm.processes import describe_end, plain_environment, shared_death
from rtloop.offline import families

PATIENCE_S = 10.0
HEADINGS = {
    "bitrate": "bit rate",
    "current_ma": "current mA",
    "stall_protection": "stall prot.",
    "stall_rpm": "stall rpm",
    "stall_current_ma": "stall mA",
    "stall_time_ms": "stall ms",
    "watchdog_ms": "watchdog ms",
}
"""Settings whose name in the arm file is too long for the table."""

NOTHING_TO_STORE = (
    "Nothing was written. What a drive's flash holds cannot be read: if its settings were only written to volatile "
    "memory, switch its power off and on, then run this again."
)

KEPT = "What a drive keeps without power however it is written is written with --write --store alone."

UNREAD = "rtarm has no table of them; see them in the maker's tool."

Report = dict[str, Any]


class OfflineProcess:
    """A process that talks with the drives of an arm nobody has brought up, told by lines what to do."""

    def __init__(self, module: str, arguments: list[str]) -> None:
        self.refused: str | None = None
        """Why it did not end as it should when it was closed, a sentence."""
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=plain_environment(),
            process_group=0,
            preexec_fn=shared_death(),  # noqa: PLW1509 (nothing here has threads)
        )

    def order(self, word: str) -> None:
        """Tell it what to do; one that has ended meanwhile says why when it is asked for its answer."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(f"{word}\n")
            self._process.stdin.flush()

    def answer(self, word: str, told: Callable[[str], None] = lambda _: None) -> Report:
        """What follows the word on its line; `told` gets what is said on the way there.

        Raises:
            Refusal: it refuses, or ended without an answer.
        """
        assert self._process.stdout is not None
        for line in self._process.stdout:
            first, _, rest = line.rstrip("\n").partition(" ")
            if first == word:
                found: Report = json.loads(rest)
                return found
            if first == "refused":
                self.refused = rest
                raise Refusal(rest, ExitCode.LOOP_REFUSED)
            if first == "told":
                told(rest)
        code = self._process.wait()
        raise Refusal(
            f"The control process that talks with the drives ended with code {code} before it had answered: see its "
            "lines above.",
            ExitCode.LOOP_REFUSED,
        )

    def no_more(self) -> None:
        """It is to end: amid a write with the drive it has begun, whose answer still comes."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()

    def close(self) -> None:
        """End it; it closes the bus in order, or says why it could not (`refused`)."""
        assert self._process.stdout is not None
        self.no_more()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.terminate()
            self._process.wait()
        with self._process.stdout as unread:
            refused = [line.rstrip("\n").partition(" ")[2] for line in unread if line.startswith("refused ")]
        code = self._process.returncode
        if refused or (code and self.refused is None):
            self.refused = refused[0] if refused else f"The control process ended {describe_end(code)}."


@contextmanager
def offline_process(module: str, arm: str, overrides: Mapping[str, Any]) -> Iterator[OfflineProcess]:
    """The process for an arm, ended whatever happens."""
    from rtarm.launch.plan import override_arguments

    # nothing is brought up and nothing is punctual here, so what the file wants of both must not keep it from starting
    at_ease = {"control": {"init_mode": 1}, "realtime": {"require": False}}
    process = OfflineProcess(module, [arm, *override_arguments({**overrides, **at_ease})])
    try:
        yield process
    finally:
        with undisturbed():
            process.close()


def plan(report: Report, *, store: bool = True) -> list[str]:
    """What a write would change, a line a drive; without `store` only what a drive does not keep."""
    lines = []
    for drive in report["drives"]:
        changes = ", ".join(
            f"{setting['name']} {shown(setting['found'])} → {shown(setting['wanted'])}"
            for setting in drive["settings"]
            if setting["name"] in drive["to_write"] and (store or not setting["kept"])
        )
        if changes:
            lines.append(f"{drive['joint']} (address {drive['address']}): {changes}")
    return lines


def question(report: Report) -> list[str]:
    """What a person has to agree to before flash is written."""
    volatile_first = [
        "A drive may store all else that it is set to now together with these.",
        "Flash wears out with every write, and a wrong value stays: try it in volatile memory first.",
    ]
    return [
        "To be written to flash, where it outlives the power:",
        *(f"  {line}" for line in plan(report)),
        *(volatile_first if plan(report, store=False) else ["A wrong value stays."]),
        "Write flash?",
    ]


def agrees(report: Report) -> bool:
    """Whether every drive is as the arm file wants it."""
    return all(drive["agrees"] for drive in report["drives"])


def run(
    arm: ArmConfig,
    argument: str,
    overrides: Mapping[str, Any],
    *,
    write: bool,
    store: bool,
    show: Callable[[Report], None],
    told: Callable[[str], None],
    confirm: Callable[[str], bool],
) -> Report:
    """Read the drives, and write them if told; `show` gets what was read, and what stands after a write.

    Args:
        argument: the name or path a person gave, from which the process loads the arm.
        told: gets a line for each drive that was written.
        confirm: asks a person before flash is written.

    Raises:
        Refusal: there are no drives, the process refuses, or nobody agreed to write flash.
    """
    if arm.bus.interface == "mock":
        raise Refusal(f"Arm {arm.name} has mock drives and no bus, so there are no settings to read.")
    if not any(families.knows("settings", joint.drive) for joint in arm.joints):
        raise Refusal(f"Arm {arm.name} has no drive whose settings can be read: {UNREAD}")
    with offline_process("rtloop.offline.settings", argument, overrides) as process:
        report = process.answer("ready")
        if write and not store and plan(report) != plan(report, store=False):
            told(KEPT)
        if not write or not plan(report, store=store):
            show(report)
            if store and any(setting["writable"] for drive in report["drives"] for setting in drive["settings"]):
                told(NOTHING_TO_STORE)
            return report
        if store and not confirm("\n".join(question(report))):
            raise Refusal("Nothing was written.")
        process.order("store" if store else "write")
        try:
            report = process.answer("written", told)
        except KeyboardInterrupt:
            told("Ending: the drive that is being written is finished, and no other is begun.")
            process.no_more()
            report = process.answer("written", told)
        show(report)
        return report


def unread(arm: ArmConfig) -> list[str]:
    """Names of the joints on the bus whose family of drives has no table of settings."""
    joints = [joint for joint in arm.joints if joint.drive.identifiers]
    return [joint.name for joint in joints if not families.knows("settings", joint.drive)]


def render(arm: ArmConfig, report: Report) -> RenderableType:
    """Drives side by side, then every sentence."""
    drives = report["drives"]
    parts: list[RenderableType] = [Text(f"{arm.name}: {len(drives)} drives, {places(arm.buses)}", style="bold")]
    family_of = {joint.name: joint.drive.family for joint in arm.joints}
    for family in dict.fromkeys(family_of[drive["joint"]] for drive in drives):
        parts.append(_table([drive for drive in drives if family_of[drive["joint"]] == family]))
    sentences = dict.fromkeys(sentence for drive in drives for sentence in (*drive["left_alone"], *drive["notes"]))
    parts += [Text(f"- {sentence}") for sentence in sentences]
    if names := unread(arm):
        parts.append(Text(f"- The settings of {', '.join(names)} are neither read nor written: {UNREAD}"))
    if any(setting["found"] is None for drive in drives for setting in drive["settings"]):
        parts.append(Text("- ? stands for what a drive does not report."))
    parts.append(Text(summary(report), style="bold"))
    return Group(*parts)


def summary(report: Report) -> str:
    """The last line: whether all is well, and what to do where it is not."""
    drives = report["drives"]
    if agrees(report) and report.get("failure"):
        return "Every drive is as the arm file wants it now, but not all have stored that."
    if agrees(report) and all(s["wanted"] is None for drive in drives for s in drive["settings"]):
        return "Every drive answers; the arm file names nothing of what they tell."
    if agrees(report):
        return "Every drive is as the arm file wants it; what the file does not name is shown in brackets."
    changes = sum(len(drive["to_write"]) for drive in drives)
    kept = sum(s.get("kept", False) for drive in drives for s in drive["settings"] if s["name"] in drive["to_write"])
    if "failure" in report and changes:
        return f"{_count(changes, 'setting')} still to be written."
    if changes and changes == kept:
        return (
            f"{_count(changes, 'setting')} to be written: --write --store writes flash, where alone drives have them."
        )
    if changes:
        return (
            f"{_count(changes, 'setting')} to be written: --write writes volatile memory, which the next power cycle "
            "undoes; --write --store writes flash too."
        )
    return "Nothing can be written here; the lines above say what is not as it should be, and what to do."


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _table(drives: list[Report]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    for drive in drives:
        table.add_column(escape(drive["joint"]), justify="right", overflow="fold")
    names = list(dict.fromkeys(setting["name"] for drive in drives for setting in drive["settings"]))
    for name in names:
        table.add_row(HEADINGS.get(name, name), *(_cell(drive, name) for drive in drives))
    told_of_all = {
        "supply V": [drive["supply_v"] for drive in drives],
        "trips at °C": [(drive["trip"] or {}).get("temperature_c") for drive in drives],
        "homing": [(drive["homing"] or {}).get("mode") for drive in drives],
    }
    for name, values in told_of_all.items():
        if any(value is not None for value in values):
            table.add_row(name, *map(_plain, values))
    return table


def _cell(drive: Report, name: str) -> Text:
    setting = next((setting for setting in drive["settings"] if setting["name"] == name), None)
    if setting is None:
        return Text("–", style="dim")
    found = shown(setting["found"])
    match setting["verdict"]:
        case "same":
            return Text(found)
        case "not named":
            return Text(f"({found})", style="dim")
        case _:
            return Text(f"{found} → {shown(setting['wanted'])}", style="bold yellow")


def _plain(value: Any) -> Text:
    return Text("–" if value is None else shown(value), style="dim")


def shown(value: Any) -> str:
    """A value as people read it; ? for what a drive does not say."""
    match value:
        case None:
            return "?"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:g}"
        case _:
            return str(value)
