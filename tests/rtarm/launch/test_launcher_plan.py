"""What the launcher decides before it starts anything."""

from __future__ import annotations

import asyncio
import io
import os
from pathlib import Path
from typing import Any

import pytest
from arm_files import edited
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from two_buses import write_divided

from config.loader import load_arm, parse_overrides
from rtarm import processes
from rtarm.console.errors import ExitCode
from rtarm.console.reporter import Reporter
from rtarm.launch.launcher import Launcher, action_name, describe_bus
from rtarm.launch.plan import load_plan, override_arguments
from rtarm.processes import WHEELS_GUARD, describe_end, plain_environment, ros_environment
from rtarm.running.arm_file import arm_file, with_buses

keys = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()


@given(st.dictionaries(keys, scalars | st.dictionaries(keys, scalars, min_size=1)))
def test_overrides_arrive_in_the_processes_as_they_were(overrides: dict[str, Any]) -> None:
    arguments = override_arguments(overrides)
    assert arguments[::2] == ["--set"] * (len(arguments) // 2)
    assert parse_overrides(arguments[1::2]) == overrides


def test_a_simulated_arm_needs_no_adapter_in_its_file(arm_file: Path) -> None:
    text = arm_file.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if "usb_index:" not in line]
    arm_file.write_text("\n".join(lines), encoding="utf-8")
    plan = load_plan(str(arm_file), {}, simulated=True)
    assert plan.arm.bus.interface == "slcan"
    assert plan.overrides == {}  # the real channel is made when the simulator starts


@pytest.mark.parametrize(
    ("python_can", "options"),
    [
        ("{interface: pcan, device_id: 7}", {"sleep_after_open": 0.0}),
        ("{interface: slcan, rtscts: true}", {"rtscts": True}),
    ],
)
def test_python_can_speaks_to_the_simulated_adapter_where_it_does_to_the_real_one(
    arm_file: Path, python_can: str, options: dict[str, object]
) -> None:
    text = arm_file.read_text(encoding="utf-8")
    text = text.replace("interface: slcan", f"interface: python-can\n  python_can: {python_can}")
    kept = [line for line in text.splitlines() if "usb_index:" not in line and "serial_baud:" not in line]
    arm_file.write_text("\n".join(kept), encoding="utf-8")
    bus = load_plan(str(arm_file), {}, simulated=True).arm.bus
    assert bus.interface == "python-can" and bus.python_can is not None
    assert (bus.python_can.interface, dict(bus.python_can.options)) == ("slcan", options)


@pytest.mark.parametrize("interface", ["slcan", "socketcan"])
def test_each_bus_of_several_is_simulated_behind_an_adapter_of_its_own(tmp_path: Path, interface: str) -> None:
    file = write_divided("episode1", tmp_path / "arm.yaml")
    with edited(file) as values:
        for bus in values["bus"]:
            bus["interface"] = interface
            bus.pop("channel")
            bus.pop("serial_baud")
    plan = load_plan(str(file), {"bus": {"bitrate": 1_000_000}}, simulated=True)
    assert plan.simulated_adapters == {
        "shoulder": {"interface": "slcan", "channel": "simulated0"},
        "wrist": {"interface": "slcan", "channel": "simulated1"},
    }
    arguments = override_arguments(with_buses(plan.overrides, plan.simulated_adapters))
    assert load_arm(file, overrides=parse_overrides(arguments[1::2])).buses == plan.arm.buses
    assert describe_bus(plan.arm) == "episode1 at 120 Hz on slcan, 1000 kbit/s (shoulder), 1000 kbit/s (wrist)"


def test_python_can_speaks_to_each_bus_in_the_language_of_its_adapter(tmp_path: Path) -> None:
    file = write_divided("episode1", tmp_path / "arm.yaml")
    with edited(file) as values:
        for bus, interface in zip(values["bus"], ("pcan", "slcan"), strict=True):
            bus.pop("serial_baud")
            bus |= {"interface": "python-can", "python_can": {"interface": interface}}
    first, second = load_plan(str(file), {}, simulated=True).arm.buses
    assert first.python_can is not None and second.python_can is not None
    assert (first.python_can.interface, dict(first.python_can.options)) == ("slcan", {"sleep_after_open": 0.0})
    assert (second.python_can.interface, dict(second.python_can.options)) == ("slcan", {})


def test_an_arm_file_without_adapters_is_found_all_the_same(tmp_path: Path) -> None:
    file = write_divided("episode1", tmp_path / "arm.yaml")
    with edited(file) as values:
        for bus in values["bus"]:
            bus.pop("channel")
    assert [bus.name for bus in arm_file(str(file), "episode1").buses] == ["shoulder", "wrist"]


def test_options_are_part_of_what_is_checked() -> None:
    plan = load_plan("episode1", {"control": {"rate_hz": 100.0}, "bus": {"channel": "/dev/x"}}, simulated=False)
    assert (plan.arm.control.rate_hz, plan.arm.bus.resolved_channel) == (100.0, "/dev/x")


def test_what_a_person_reads_about_an_arm() -> None:
    assert describe_bus(load_arm("episode1")) == "episode1 at 120 Hz on slcan, 500 kbit/s"
    assert describe_bus(load_arm("mock")) == "mock at 100 Hz without a bus (mock drives)"
    assert action_name(load_arm("mock")) == "/episode_arm_controller/follow_joint_trajectory"
    assert action_name(load_arm("mock"), "/left") == "/left/episode_arm_controller/follow_joint_trajectory"


@pytest.mark.parametrize(
    ("code", "words"),
    [(0, "with exit code 0"), (3, "with exit code 3"), (-9, "by SIGKILL"), (-200, "by signal 200")],
)
def test_how_a_process_ended(code: int, words: str) -> None:
    assert describe_end(code) == words


def test_children_find_our_packages_and_start_python_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "elsewhere")
    environment = plain_environment()
    assert environment[WHEELS_GUARD] == "1"
    assert environment["PYTHONPATH"] == f"{processes.ROOT}{os.pathsep}elsewhere"


@pytest.mark.parametrize("prepared", [True, False])
def test_a_ros_child_gets_the_wheels_library_path(prepared: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Taken over where this process has it, else left to the wheels' own start-up file."""
    library = Path(processes.sysconfig.get_path("data")) / "lib"
    monkeypatch.setenv("LD_LIBRARY_PATH", f"elsewhere{os.pathsep}{library}" if prepared else "elsewhere")
    monkeypatch.setenv(WHEELS_GUARD, "1")
    assert (WHEELS_GUARD in ros_environment()) == prepared


class Braking:
    """In place of a process that ends when its arm stands, if it may."""

    name, was_ready, has_ended, code = "braking", True, False, 0

    async def stop(self, patience_s: float) -> bool:
        self.patience_s = patience_s
        return True


@pytest.mark.parametrize("braking_factor", [1.0, 1.2, 1.5])
def test_no_process_is_killed_while_its_arm_brakes_as_it_should(braking_factor: float) -> None:
    """The control process had 10 s, whatever the arm."""
    plan = load_plan("mock", {"limits": {"braking_factor": braking_factor}}, simulated=False)
    launcher = Launcher(plan, Reporter(Console(file=io.StringIO())))
    front, loop = Braking(), Braking()
    launcher._front, launcher._loop = front, loop  # type: ignore[assignment]
    asyncio.run(launcher.stop())
    arm = plan.arm.patience
    assert front.patience_s > arm.goals_s > arm.longest_stop_s
    assert loop.patience_s > arm.shutdown_s > arm.longest_stop_s


class Ended:
    """In place of a control process that ended."""

    last_line = ""

    def __init__(self, *, was_ready: bool) -> None:
        self.was_ready = was_ready

    async def ended(self) -> int:
        return -9


@pytest.mark.parametrize("was_ready", [False, True])
def test_drives_have_braked_only_where_an_arm_had_begun(was_ready: bool) -> None:
    launcher = Launcher(load_plan("mock", {}, simulated=False), Reporter(Console(file=io.StringIO())))
    refusal = asyncio.run(launcher._loop_refusal(Ended(was_ready=was_ready)))  # type: ignore[arg-type]
    assert refusal.code == ExitCode.LOOP_DIED and "ended by SIGKILL" in refusal.sentence
    assert ("the drives stop by themselves, but a homing run goes on" in refusal.sentence) == was_ready
    assert ("no motion had begun" in refusal.sentence) != was_ready
