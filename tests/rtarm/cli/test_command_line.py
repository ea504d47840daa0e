"""Help, usage and the sentences with which commands refuse."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from two_buses import write_divided
from typer.testing import Result
from written_arm import JOINTS, WrittenArm

from config.loader import ARMS_FOLDER
from rtarm.cli.application import app
from rtarm.console.errors import MEANINGS, ExitCode
from rtarm.launch import plan


def commands(group: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every command there is, as its words."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*above, name))
        else:
            yield (*above, name)


COMMANDS = sorted(commands(typer.main.get_command(app)))
SAY_JSON = [
    *(("status",), ("doctor",), ("drives",), ("scan",), ("explain",), ("config", "check")),
    *(("stop",), ("hold",), ("resume",), ("enable",), ("disable",), ("free",), ("home",), ("reference",)),
    ("clear-fault",),
]
"""Commands whose answer a script would want to read."""

NOT_OF_ONE_ARM = [
    *(("up",), ("doctor",), ("bench",), ("moveit-config",), ("config", "check"), ("explain",), ("plot",), ("drives",)),
    *(("scan",), ("calibrate",), ("commission",), ("motions",)),
]
"""Commands about files and machines, or that start an arm."""

Rtarm = Callable[..., Result]
WIDTH = 200
"""Of the terminal that the fixture pretends."""


@pytest.mark.parametrize("command", [(), *COMMANDS], ids=" ".join)
def test_help_says_what_it_does_with_an_example(command: tuple[str, ...], rtarm: Rtarm) -> None:
    result = rtarm(*command, "--help")
    assert result.exit_code == 0
    assert f"Example: rtarm {' '.join(command) or 'demo'}" in " ".join(result.stdout.split())


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_is_wrapped_where_the_terminal_ends_alone(command: tuple[str, ...], rtarm: Rtarm) -> None:
    """A line that could have taken the first word of the next one is ragged."""
    about = rtarm(*command, "--help").stdout.partition("Example:")[0].partition("Usage:")[2].splitlines()[2:]
    for line, following in pairwise(line.strip() for line in about):
        if line and following:
            assert len(line) + 1 + len(following.split()[0]) > WIDTH - 2, f"{line!r} ends early"


def test_the_exit_codes_are_in_the_help(rtarm: Rtarm) -> None:
    text = " ".join(rtarm("--help").stdout.split())
    for code in ExitCode:
        assert f"{code.value} {MEANINGS[code]}" in text


@pytest.mark.parametrize("command", SAY_JSON, ids=" ".join)
def test_an_answer_in_json_stays_json_when_it_is_a_refusal(command: tuple[str, ...], rtarm: Rtarm) -> None:
    missing = {"scan": ["--port", "/dev/nowhere"], "explain": ["nowhere.mcap"], "home": ["--arm", "t_nobody"]}
    missing["reference"] = ["joint1", "--arm", "t_nobody"]
    result = rtarm(*command, *missing.get(command[0], ["t_nobody"]), "--json")
    assert (result.exit_code, result.stderr) == (1, "")
    (problem,) = json.loads(result.stdout)["problems"]
    assert problem.endswith(".") and ("nobody" in problem or "nowhere" in problem)


def test_config_check_in_json_has_the_figures(rtarm: Rtarm) -> None:
    result = rtarm("config", "check", "episode1", "--json")
    figures = json.loads(result.stdout)
    assert (result.exit_code, figures["arm"], figures["fits"]) == (0, "episode1", True)
    assert [joint["name"] for joint in figures["joints"]] == [f"joint{number}" for number in range(1, 7)]
    assert round(figures["highest_rate_hz"], 1) == 123.2
    assert json.loads(rtarm("config", "check", "mock", "--json").stdout)["highest_rate_hz"] is None


@pytest.mark.parametrize("command", [("up",), ("drives",), ("calibrate",), ("commission",)], ids=" ".join)
def test_one_channel_is_none_for_an_arm_of_several_buses(
    command: tuple[str, ...], rtarm: Rtarm, tmp_path: Path
) -> None:
    file = str(write_divided("episode1", tmp_path / "arm.yaml"))
    joint = ["joint1"] if command == ("commission",) else []
    result = rtarm(*command, file, *joint, "--channel", "/dev/x")
    assert (result.exit_code, result.stderr) == (
        1,
        "bus.channel=/dev/x is for every bus, but each of the arm's buses (shoulder, wrist) has an adapter of its own; "
        "write it in the arm file, or name the bus where --set is an option, as in `--set "
        "bus.shoulder.channel=/dev/x`.\n",
    )


def test_config_check_in_json_has_the_figures_of_each_bus(rtarm: Rtarm, tmp_path: Path) -> None:
    result = rtarm("config", "check", str(write_divided("episode1", tmp_path / "arm.yaml")), "--json")
    figures = json.loads(result.stdout)
    assert (result.exit_code, figures["fits"]) == (0, True)
    assert [bus["name"] for bus in figures["buses"]] == ["shoulder", "wrist"]


def test_what_is_no_terminal_gets_no_colours() -> None:
    for arguments in (("--help",), ("config", "check", "episode1"), ("status", "t_nobody")):
        result = subprocess.run([sys.executable, "-m", "rtarm", *arguments], capture_output=True, check=False)
        assert b"\x1b" not in result.stdout + result.stderr


def offered(line: str) -> list[str]:
    """What the shell gets for a line that is not finished."""
    words = line.split(" ")
    asked = {"_RTARM_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    program = "from rtarm.cli.application import app; app(prog_name='rtarm')"
    result = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, **asked}, capture_output=True, text=True, check=True
    )
    return result.stdout.split()


def test_the_shell_completes_commands_options_and_arms(arm: WrittenArm) -> None:
    assert offered("rtarm clear") == ["clear-fault"]
    assert "--json" in offered("rtarm status --")
    assert offered("rtarm up odr") == ["odrive6"]
    assert arm.name in offered("rtarm status ")
    assert arm.name in offered("rtarm home --arm ")
    assert set(JOINTS) <= set(offered("rtarm home "))


def test_the_shell_completes_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = tmp_path / "rtarm" / "recordings"
    folder.mkdir(parents=True)
    recording = folder / "episode1-20261121T231323Z-stale_reading.mcap"
    recording.touch()
    (folder / "notes.mcap").touch()
    assert offered("rtarm explain ") == [str(recording)]


def test_help_loads_nothing_heavy() -> None:
    program = (
        "import sys; from rtarm.cli.application import app; app(['up', '--help'], standalone_mode=False); "
        "print(sorted({'numpy', 'yaml', 'asyncio', 'rclpy', 'numba', 'config.schema'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.rstrip().endswith("[]")


def test_ctrl_c_before_the_command_line_is_there_just_ends_it() -> None:
    program = """
import os, signal, sys
class Slow:
    def find_spec(self, name, path=None, target=None):
        if name == "rtarm.cli.application":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Slow())
from rtarm.__main__ import main
main()
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (-signal.SIGINT, "", "")


def test_version(rtarm: Rtarm) -> None:
    result = rtarm("--version")
    assert (result.exit_code, result.stdout.split()[0]) == (0, "rtarm")


@pytest.mark.parametrize(
    "arguments",
    [("nonsense",), ("up",), ("up", "mock", "--rate", "fast"), ("status", "--speed"), ("config", "chek")],
    ids=" ".join,
)
def test_wrong_usage_has_exit_code_1(arguments: tuple[str, ...], rtarm: Rtarm) -> None:
    result = rtarm(*arguments)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "Usage:" in result.stderr


REFUSED = [
    (("doctor", "nobody"), "no arm is called 'nobody'"),
    (("up", "episode2"), "no arm is called 'episode2' (did you mean episode1?)"),
    (("up", "./nowhere.yaml"), "nowhere.yaml: there is no such file"),
    (("up", "episode1", "--rate", "500"), "the highest rate that fits is 123.1 Hz"),
    (("up", "episode1", "--rate", "5"), "rate_hz is 5, but must be at least 10"),
    (
        ("up", "episode1", "--interface", "vcan"),
        "interface is vcan, but CAN interfaces of the system are reached by socketcan: set interface to socketcan, and "
        "channel to its name",
    ),
    (("up", "episode1", "--init-mode", "2"), "init_mode is 2, but must be 0 or 1"),
    (("up", "mock", "--channel", "can0"), "channel is 'can0', but interface mock opens no device"),
    (("up", "mock", "--sim"), "Arm mock has mock drives and no bus, so there is nothing to simulate"),
    (("up", "episode1", "--sim", "--channel", "/dev/ttyACM0"), "--sim brings its own adapter"),
    (("config", "check", "epi"), "no arm is called 'epi'"),
    (("demo", "--arm", "nobody"), "no arm is called 'nobody'"),
    (("demo", "nobody"), "no arm is called 'nobody'"),
    (("demo", "--goal", "nowhere.json"), "nowhere.json cannot be read (No such file or directory)"),
    (("demo", "--json", "nowhere/figures.json"), "nowhere/figures.json cannot be written"),
    (("status", "Big"), "'Big' is no name of an arm"),
    (("status", "t_nobody_runs_me"), "No control process is running for arm 't_nobody_runs_me'"),
    (("stop", "t_nobody_runs_me"), "with `rtarm up` and the name or the path of its arm file"),
    (("clear-fault", "t_nobody_runs_me"), "No control process is running"),
]


@pytest.mark.parametrize(("arguments", "said"), REFUSED, ids=[" ".join(case[0]) for case in REFUSED])
def test_a_refusal_is_a_sentence_and_exit_code_1(arguments: tuple[str, ...], said: str, rtarm: Rtarm) -> None:
    result = rtarm(*arguments)
    assert (result.exit_code, result.stdout) == (1, "")
    assert said in result.stderr
    assert "Traceback" not in result.stderr


def test_an_arm_that_does_not_run_is_told_with_those_that_do(arm: WrittenArm, rtarm: Rtarm) -> None:
    for command in (("status", "t_nobody"), ("stop", "t_nobody"), ("move", "elbow=1", "--arm", "t_nobody")):
        result = rtarm(*command)
        assert result.exit_code == 1
        said = re.fullmatch(r"No control process .* 't_nobody', but for (.*): name that arm, .*\.\n", result.stderr)
        assert said and arm.name in said[1].split(", ")


def of_a_running_arm() -> Iterator[tuple[str, ...]]:
    """Commands whose only argument is an arm that may be left out."""
    for command in COMMANDS:
        found: Any = typer.main.get_command(app)
        for word in command:
            found = found.commands[word]
        arguments = [(one.name, one.required) for one in found.params if one.param_type_name == "argument"]
        if arguments == [("arm", False)]:
            yield command


@pytest.mark.parametrize("command", sorted(set(of_a_running_arm()) - {("doctor",)}), ids=" ".join)
def test_an_arm_is_named_as_the_argument_or_by_its_option(command: tuple[str, ...], rtarm: Rtarm) -> None:
    for words in (["Big"], ["--arm", "Big"], ["-a", "Big"], ["Big", "--arm", "Big"]):
        result = rtarm(*command, *words)
        assert result.exit_code == 1 and "'Big'" in result.stderr, words
    two = rtarm(*command, "left", "--arm", "right")
    assert two.exit_code == 1 and "it is left, but --arm is right: give one of the two." in " ".join(two.stderr.split())


@pytest.mark.parametrize("command", [command for command in COMMANDS if command not in NOT_OF_ONE_ARM], ids=" ".join)
def test_every_command_to_a_running_arm_takes_its_option(command: tuple[str, ...], rtarm: Rtarm) -> None:
    assert re.search(r"--arm +-a +ARM", rtarm(*command, "--help").stdout)


def test_what_a_process_has_said_is_said_once_where_both_outputs_are_one() -> None:
    program = "from rtarm.console.errors import *; print(*foreseen(AlreadySaid('no')))"
    for together, said in ((subprocess.STDOUT, " 1"), (subprocess.PIPE, "no 1")):
        ended = subprocess.run(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=together, text=True, check=True
        )
        assert ended.stdout.rstrip("\n") == said


def test_status_in_json_stays_json_when_nothing_runs(rtarm: Rtarm) -> None:
    result = rtarm("status", "t_nobody_runs_me", "--json")
    report = json.loads(result.stdout)
    assert (result.exit_code, report["running"], report["healthy"]) == (1, False, False)
    assert "No control process is running" in report["problems"][0]


def test_config_check_prints_what_follows_from_an_arm(rtarm: Rtarm) -> None:
    result = rtarm("config", "check", "episode1")
    assert result.exit_code == 0
    assert "highest rate     123.1 Hz" in result.stdout


def test_an_arm_without_a_serial_line_is_told_none_of_its_figures(tmp_path: Path, rtarm: Rtarm) -> None:
    assert "serial load" in rtarm("config", "check", "episode1").stdout
    values = yaml.safe_load((ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8"))
    values["bus"] = {"interface": "socketcan", "channel": "can0", "bitrate": 500_000, "acknowledge": False}
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(values), encoding="utf-8")
    said = rtarm("config", "check", str(file))
    assert said.exit_code == 0 and "bus load" in said.stdout and "serial" not in said.stdout


def test_config_check_prints_every_error_with_its_line(arm_file: Path, rtarm: Rtarm) -> None:
    text = arm_file.read_text(encoding="utf-8").replace("ratio: 25", "ratio: -25")
    arm_file.write_text(text, encoding="utf-8")
    result = rtarm("config", "check", str(arm_file))
    assert (result.exit_code, result.stdout) == (1, "")
    lines = result.stderr.splitlines()
    assert len(lines) == 2
    for line, joint in zip(lines, ("joint1", "joint3"), strict=True):
        assert re.match(rf"{re.escape(str(arm_file))}:\d+: ratio of {joint} is -25, ", line)


def test_config_check_shows_the_budget_of_a_rate_that_does_not_fit(arm_file: Path, rtarm: Rtarm) -> None:
    text = arm_file.read_text(encoding="utf-8").replace("rate_hz: 120", "rate_hz: 130")
    arm_file.write_text(text, encoding="utf-8")
    result = rtarm("config", "check", str(arm_file))
    assert result.exit_code == 1
    assert "TOO MUCH" in result.stdout
    assert "the highest rate that fits is 123.1 Hz" in result.stderr


@pytest.mark.parametrize(("missing", "remedy"), [("rclpy", "make env"), ("control_msgs", "rtarm_interfaces.build")])
def test_missing_ros_is_said_before_anything_starts(
    missing: str, remedy: str, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "has_module", lambda name: name != missing)
    monkeypatch.setattr(plan, "generated_types", lambda: False)
    result = rtarm("up", "mock")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.startswith(f"{missing} is not installed")
    assert remedy in result.stderr
