"""The files beside the wheel: systemd's unit, udev's rules, the container. What they name is there and is ours."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from config.homing import ParkingConfig
from config.stopping import LONGEST_ALLOWED_S, Patience
from rtarm.cli.application import app
from rtarm.doctor.adapters import QUEUE
from rtarm.doctor.processors import LATENCY_RULE
from rtarm.launch.launcher import FRONT_PATIENCE_S, LOOP_PATIENCE_S, SIM_PATIENCE_S, SIM_STOP_S
from rtarm.scan.adapters import KERNEL_ADAPTERS, SLCAN_ADAPTERS

ROOT = Path(__file__).resolve().parents[2]
PACKAGING = ROOT / "packaging"
UNIT = PACKAGING / "systemd" / "rtarm@.service"
RULES = PACKAGING / "udev" / "70-rtarm.rules"
INSTALL = (ROOT / "docs" / "start" / "install.md").read_text(encoding="utf-8")
LONGEST_PARKING_S = next(m.le for m in ParkingConfig.model_fields["timeout_s"].metadata if hasattr(m, "le"))
UNITS_S = {"": 1, "min": 60}


def settings() -> dict[str, list[str]]:
    """Every setting of the unit with its values, in order."""
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text(encoding="utf-8").splitlines():
        if line and line[0] not in "#[":
            name, _, value = line.partition("=")
            found.setdefault(name, []).append(value)
    return found


def seconds(text: str) -> float:
    number, unit = re.fullmatch(r"(\d+)(\w*)", text).groups()
    return int(number) * UNITS_S[unit]


def test_the_unit_starts_what_the_wheel_installs() -> None:
    program, command, *arguments = settings()["ExecStart"][0].split()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    environment, _, name = program.rpartition("/bin/")
    assert name in project["scripts"]
    assert f"python3 -m venv {environment}\n" in INSTALL
    assert CliRunner().invoke(app, [command, "--help"]).exit_code == 0
    assert arguments == ["$RTARM_ARM", "$RTARM_OPTIONS"]


def test_the_units_patience_is_that_of_the_launcher() -> None:
    unit, slowest = settings(), Patience(LONGEST_ALLOWED_S)
    ending_s = LONGEST_PARKING_S + slowest.ros_process_s + slowest.control_process_s + SIM_STOP_S
    assert seconds(unit["TimeoutStopSec"][0]) > ending_s
    assert seconds(unit["TimeoutStartSec"][0]) > SIM_PATIENCE_S + LOOP_PATIENCE_S + FRONT_PATIENCE_S
    assert (unit["Restart"], unit["KillMode"], unit["Type"]) == (["no"], ["mixed"], ["notify"])


def test_the_unit_lets_an_arm_be_punctual() -> None:
    unit = settings()
    assert (unit["LimitRTPRIO"], unit["LimitMEMLOCK"]) == (["99"], ["infinity"])
    # Each of these would stop the arm, or let somebody else remove its memory.
    harmful = {
        "RestrictRealtime",
        "MemoryDenyWriteExecute",
        "PrivateDevices",
        "ProtectClock",
        "PrivateIPC",
        "RemoveIPC",
    }
    assert not harmful & set(unit)
    assert "AF_CAN" in unit["RestrictAddressFamilies"][0].split()


def test_the_units_user_is_the_one_that_is_made() -> None:
    unit = settings()
    made = (PACKAGING / "systemd" / "rtarm.sysusers").read_text(encoding="utf-8").splitlines()
    (user,) = unit["User"]
    home = unit["Environment"][1].removeprefix("HOME=")
    assert any(line.split()[:2] == ["u", user] and line.endswith(home) for line in made)
    assert home == f"/var/lib/{unit['StateDirectory'][0]}"
    (group,) = unit["SupplementaryGroups"]
    assert f"m {user} {group}" in made
    assert set(re.findall(r'GROUP="(\w+)"', RULES.read_text(encoding="utf-8"))) == {group}


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_understands_the_unit(tmp_path: Path) -> None:
    """With a program in the place of ours, which is not installed here."""
    (tmp_path / UNIT.name).write_text(
        UNIT.read_text(encoding="utf-8").replace("/opt/rtarm/bin/rtarm", "/bin/true"), encoding="utf-8"
    )
    done = subprocess.run(
        ["systemd-analyze", "verify", "--recursive-errors=no", tmp_path / UNIT.name],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# --- udev -----------------------------------------------------------------------------------------------

Rule = list[tuple[str, str, str]]
TOKEN = re.compile(r'([A-Z]+(?:\{[\w/]+\})?)(==|!=|\+=|=)"([^"]*)"')


def rules() -> list[Rule]:
    """Key, operator and value of each part of each rule; fails on what is no rule."""
    found = []
    for line in RULES.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            parts = line.split(", ")
            matches = [TOKEN.fullmatch(part) for part in parts]
            assert all(matches), line
            found.append([match.groups() for match in matches if match])
    return found


def ids(kind: str, mark: str) -> set[str]:
    """USB ids of the rules that set a mark."""
    return {
        f"{values[f'{kind}{{idVendor}}']}:{values[f'{kind}{{idProduct}}']}"
        for values in ({key: value for key, _, value in rule} for rule in rules())
        if mark in values and f"{kind}{{idVendor}}" in values
    }


def test_adapters_with_names_are_those_that_surely_speak_slcan() -> None:
    assert ids("ATTRS", "ENV{RTARM_ADAPTER}") == set(SLCAN_ADAPTERS)


def test_adapters_that_stay_awake_are_those_that_rtarm_knows() -> None:
    assert ids("ATTR", "ENV{RTARM_USB}") == set(SLCAN_ADAPTERS) | set(KERNEL_ADAPTERS)


def test_the_rules_do_what_doctor_asks_for() -> None:
    text = RULES.read_text(encoding="utf-8")
    (latency,) = re.findall(r"echo '([^']+)'", LATENCY_RULE)
    assert latency in text
    assert f'ATTR{{tx_queue_len}}="{QUEUE}"' in text
    for page in ("hardware/adapters.md", "hardware/socketcan.md"):
        for shown in re.findall(r"^SUBSYSTEM.*$", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.MULTILINE):
            assert shown in text.splitlines(), page


def test_the_network_file_is_the_one_that_the_page_shows() -> None:
    shown = (PACKAGING / "systemd" / "80-can.network").read_text(encoding="utf-8")
    assert f"```\n{shown}```" in (ROOT / "docs" / "hardware" / "socketcan.md").read_text(encoding="utf-8")


def test_rules_stand_between_what_they_need_and_what_needs_them() -> None:
    """Serial numbers are found in 60-serial.rules; uaccess is granted in 73-seat-late.rules."""
    assert "60-serial.rules" < RULES.name < "73-seat-late.rules"


# --- what is said of it ---------------------------------------------------------------------------------


def test_the_page_installs_every_file() -> None:
    for path in (*(PACKAGING / "systemd").iterdir(), RULES):
        assert f"{path.parent.name}/{path.name}" in INSTALL
    assert "packaging/docker/Dockerfile" in INSTALL


def test_the_way_without_ros_wheels_names_all_other_dependencies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.split(r"[<>=\[]", line)[0] for line in project["dependencies"] if not line.startswith("rtarm")]
    assert f"pip install --constraint dist/constraints.txt {' '.join(names)}\n" in INSTALL


def test_the_container_takes_what_make_dist_leaves() -> None:
    text = (PACKAGING / "docker" / "Dockerfile").read_text(encoding="utf-8")
    assert "COPY dist /dist" in text
    assert "cp constraints.txt dist/" in (ROOT / "Makefile").read_text(encoding="utf-8")
