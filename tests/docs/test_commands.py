"""The commands that the documentation shows are there, take what is shown, and do what is promised.

`stages.py` says where each is run, or why it cannot be.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from arm_files import known_arm
from at_terminal import CTRL_C, Terminal
from pages import ROOT
from shown import Shown, named_commands, shown_commands, shown_file
from stack import PATIENT
from stages import ADAPTER, ARM, FILES, NOT_RUN, RUN, Run

from rtarm.cli.application import app
from rtarm.cli.frame import UsageError
from shm.files import DIRECTORY

SHOWN = shown_commands()
PATIENCE_S = 300.0
RTARM = [sys.executable, "-m", "rtarm"]
READ_RECORDINGS = {"explain", "plot", "replay"}


def reasons(text: str) -> list[str]:
    """The patterns of what is not run that mean a command."""
    return [pattern for pattern in NOT_RUN if text == pattern or fnmatchcase(text, pattern)]


# --- the tables ---


@pytest.mark.parametrize("shown", SHOWN.values(), ids=lambda shown: shown.text)
def test_a_shown_command_is_run_or_it_is_said_why_not(shown: Shown) -> None:
    assert shown.text in RUN or reasons(shown.text), (
        f"{shown.place} shows {shown.text!r}: add it to RUN in tests/docs/stages.py, or to NOT_RUN with the reason"
    )


def test_the_tables_name_nothing_that_is_not_shown() -> None:
    assert RUN.keys() <= SHOWN.keys(), f"nowhere shown any more: {sorted(RUN.keys() - SHOWN.keys())}"
    used = {pattern for text in SHOWN if text not in RUN for pattern in reasons(text)}
    assert used == NOT_RUN.keys(), f"mean nothing that is shown any more: {sorted(NOT_RUN.keys() - used)}"


# --- what is typed exists ---


def command_of(words: list[str]) -> tuple[Any, list[str]]:
    """The command of `rtarm` that words call, and what follows its name."""
    command: Any = typer.main.get_command(app)
    rest = words[1:]
    while hasattr(command, "commands") and rest and not rest[0].startswith("-"):
        assert rest[0] in command.commands, f"there is no command {' '.join(words)}"
        command = command.commands[rest.pop(0)]
    return command, rest


def options_of(command: Any) -> set[str]:
    return {"--help"} | {name for param in command.params for name in (*param.opts, *param.secondary_opts)}


@pytest.mark.parametrize(
    "shown", [shown for shown in SHOWN.values() if shown.words[:1] == ["rtarm"]], ids=lambda shown: shown.text
)
def test_the_command_line_takes_what_is_shown(shown: Shown) -> None:
    command, rest = command_of(shown.words)
    if hasattr(command, "commands"):  # options of rtarm itself, which act as soon as they are read
        assert set(rest) <= options_of(command), f"{shown.place} shows {shown.text!r}"
        return
    try:
        command.make_context(shown.words[-1], list(rest))
    except UsageError as error:
        pytest.fail(f"{shown.place} shows {shown.text!r}: {error}")


@pytest.mark.parametrize("named", named_commands().values(), ids=lambda named: named.text)
def test_a_command_in_a_sentence_exists_with_its_options(named: Shown) -> None:
    words = named.text.replace("…", " ").replace("'", " ").split()
    command, rest = command_of(words)
    given = {word.partition("=")[0].strip("[]") for word in rest if word.strip("[").startswith("-")}
    given = {option for option in given if not option[1:2].isdigit()}
    assert given <= options_of(command), f"{named.place} names {named.text!r}"


def check_make(words: list[str]) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for word in words[2:] if words[0] == "-C" else words:
        name, is_setting, _ = word.partition("=")
        assert f"\n{name} ?=" in makefile if is_setting else f"\n{name}:" in makefile, f"make knows no {name}"


def check_pip(words: list[str]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for word in words:
        if word.startswith("rtarm["):
            extras = set(word.removeprefix("rtarm[").rstrip("]").split(","))
            assert extras <= project["optional-dependencies"].keys()


def check_cp(words: list[str]) -> None:
    assert (ROOT / next(word for word in words if not word.startswith("-"))).exists()


def check_sed(words: list[str]) -> None:
    """What it does to the file, it does."""
    script, file, *_ = words
    result = subprocess.run(["sed", script, file], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout != (ROOT / file).read_text(encoding="utf-8")


def check_ros2(words: list[str]) -> None:
    if words[0] == "launch":  # the packages that `rtarm moveit-config` makes, and the tutorial's, have Episode1's files
        package = re.sub(r"\w+_moveit(_config)?$", "episode1_moveit_config", words[1])
        assert (ROOT / "ros" / package / "launch" / words[2]).is_file()
    if words[0] == "run":
        assert words[2] in (ROOT / "ros" / words[1] / "CMakeLists.txt").read_text(encoding="utf-8")


def check_python(words: list[str]) -> None:
    """Options of a module of ours stand in its source."""
    if words[0] != "-m":
        return
    name = words[1]
    if name == "pytest":
        chosen = {after for word, after in pairwise(words) if word == "-k"}
        assert all((ROOT / word).exists() for word in words[2:] if not word.startswith("-") and word not in chosen)
        return
    places = [folder / Path(*name.split(".")) for folder in (ROOT, ROOT / "tests")]
    files = [path for place in places for path in (place / "__main__.py", place.with_suffix(".py")) if path.exists()]
    assert files, f"there is no module {name}"
    source = files[0].read_text(encoding="utf-8")
    missing = [word for word in words[2:] if word.startswith("--") and f'"{word.partition("=")[0]}"' not in source]
    assert not missing, f"{name} has no {missing}"


CHECKS: dict[str, Callable[[list[str]], None]] = {
    "make": check_make,
    "pip": check_pip,
    "cp": check_cp,
    "sed": check_sed,
    "ros2": check_ros2,
    "python": check_python,
}


@pytest.mark.parametrize(
    "shown", [shown for shown in SHOWN.values() if shown.words[0] in CHECKS], ids=lambda shown: shown.text
)
def test_targets_extras_files_and_options_exist(shown: Shown) -> None:
    program, *words = shown.words
    CHECKS[program](words)


# --- the stages ---


class Stage:
    """A folder with the files that the documentation names, and what runs beside it."""

    def __init__(self, name: str, folder: Path) -> None:
        self.arm = name
        self.folder = folder
        self.tty = folder / "tty"
        self.instead: dict[str, str] = {"~/ros2_ws/src": "./ros2_ws/src", "FILE.mcap": "strange_noise.mcap"}
        (folder / "ros2_ws" / "src").mkdir(parents=True)
        self.write_arm("my_arm.yaml", "episode1", name)
        self.write_arm("as_built.yaml", "episode1", name)
        self.write_arm("mock.yaml", "mock", f"{name}_mock")
        for file, (page, word) in FILES.items():
            (folder / file).write_text(shown_file(page, word), encoding="utf-8")
        self.environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "XDG_STATE_HOME": str(folder / "state"),
            "XDG_DATA_HOME": str(folder / "data"),
        }

    def write_arm(self, file: str, arm: str, name: str, keys: dict[str, dict[str, Any]] | None = None) -> None:
        """A known arm under a name that nobody else uses, at the simulated adapter."""
        values = known_arm(arm) | {"name": name}
        if values["bus"].pop("usb_index", None) is not None:
            values["bus"]["channel"] = str(self.tty)
        for section, more in (keys or {}).items():
            values.setdefault(section, {}).update(more)
        (self.folder / file).write_text(yaml.safe_dump(values), encoding="utf-8")

    def start(self, words: list[str]) -> Terminal:
        """Type a command: `rtarm` and `python` are those of this environment."""
        program, *rest = words
        known = {"rtarm": RTARM, "python": [sys.executable]}
        return Terminal([*known[program], *rest], self.folder, self.environment)

    def typed(self, text: str) -> list[str]:
        """A command with this stage's names; one that may leave the arm out names it, as others run beside it."""
        words = [self.instead.get(word, word) for word in shlex.split(text)]
        if words[0] != "rtarm" or "running arm" not in self.instead:
            return words
        command, rest = command_of(words)
        with command.make_context(words[-1], list(rest), resilient_parsing=True) as context:
            moves_one_at_will = "on_arm" in context.params  # `rtarm replay`, whose --arm belongs to --on-arm
            if moves_one_at_will or "arm" not in context.params or context.params["arm"] is not None:
                return words
        named = ["--arm", self.arm] if "--arm" in options_of(command) else [self.arm]
        return [*words, *named]

    def run(self, text: str, how: Run) -> None:
        """Type a command, talk with it, and see that it ends as is promised."""
        if how.arm:
            self.write_arm("my_arm.yaml", "episode1", self.arm, how.arm)
        with contextlib.closing(self.start(self.typed(text))) as terminal:
            for awaited, keys in how.talk:
                terminal.read_until(awaited, PATIENCE_S)
                terminal.press(keys)
            code = terminal.code(PATIENCE_S)
        if how.arm:
            self.write_arm("my_arm.yaml", "episode1", self.arm)
        assert code in how.codes, terminal.said
        assert how.says in terminal.said
        if text.endswith("--json"):
            json.loads(terminal.said)

    def sweep(self) -> None:
        """Remove what an arm leaves for its user."""
        for left in DIRECTORY.glob(f"rtarm.{self.arm}*"):
            left.unlink()


@contextlib.contextmanager
def beside(stage: Stage, words: list[str], ready: str) -> Iterator[None]:
    """Let a command run until the end, which is Ctrl-C."""
    with contextlib.closing(stage.start(words)) as terminal:
        terminal.read_until(ready, PATIENCE_S)
        yield
        terminal.press(CTRL_C)
        terminal.code(PATIENCE_S)


@pytest.fixture
def stage(
    request: pytest.FixtureRequest, new_arm_name: Callable[[], str], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Stage]:
    """The stage named by the test's parameter, made anew for each command, which nothing of before then disturbs."""
    folder = tmp_path_factory.mktemp("stage")
    made = Stage(new_arm_name(), folder)
    with contextlib.ExitStack() as ends:
        ends.callback(shutil.rmtree, folder, ignore_errors=True)
        ends.callback(made.sweep)
        if request.param == ADAPTER:
            made.instead |= {"episode1": "./my_arm.yaml", "/dev/ttyUSB0": str(made.tty), "/dev/ttyUSB1": str(made.tty)}
            command = ["python", "-m", "sim", "--arm", "./as_built.yaml", "--link", "./tty"]
            ends.enter_context(beside(made, [*command, "--start-deg=0,0,0,0,-20,0"], "ready"))
        elif request.param == ARM:
            made.instead |= {"episode1": made.arm, "running arm": made.arm}
            made.write_arm("my_arm.yaml", "episode1", made.arm, {"limits": PATIENT})
            ends.enter_context(beside(made, ["rtarm", "up", "./my_arm.yaml", "--sim"], "running; Ctrl-C"))
            if request.node.callspec.params["text"].split()[1] in READ_RECORDINGS:
                for file in ("", " -o strange_noise.mcap", " -o test_run.mcap"):
                    made.run(f"rtarm record{file}", Run(ARM))
        else:
            made.instead |= {"mock": "./mock.yaml"}
        yield made


@pytest.mark.process
@pytest.mark.parametrize(("stage", "text"), [(how.stage, text) for text, how in RUN.items()], indirect=["stage"])
def test_a_command_ends_as_is_promised(stage: Stage, text: str) -> None:
    stage.run(text, RUN[text])
