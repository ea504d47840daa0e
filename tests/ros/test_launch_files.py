"""What each launch file starts, in the three modes of the tutorial."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
from launched import Started, everything_started

from config.homing import ParkingConfig
from config.stopping import LONGEST_ALLOWED_S, Patience
from rtarm.launch.launcher import SIM_STOP_S

pytest.importorskip("xacro")

MOVEIT_PACKAGE = "episode1_moveit_config"
AROUND = [
    "robot_state_publisher/robot_state_publisher",
    "tf2_ros/static_transform_publisher",
    "moveit_ros_move_group/move_group",
]
RVIZ = "rviz2/rviz2"
MOCK_HARDWARE = "controller_manager/ros2_control_node"
SPAWNER = "controller_manager/spawner"


def programs(started: list[Started]) -> list[str]:
    return sorted(f"{node.package}/{node.executable}" for node in started)


def only(started: list[Started], program: str) -> Started:
    (found,) = (node for node in started if f"{node.package}/{node.executable}" == program)
    return found


def value_of(node: Started, name: str) -> object:
    """A parameter by its full name, whether its groups are nested or joined by dots."""
    if name in node.parameters:
        return node.parameters[name]
    value: Any = node.parameters
    for part in name.split("."):
        value = value[part]
    return value


def moveit_launch(packages: Path, name: str) -> Path:
    return packages / MOVEIT_PACKAGE / "launch" / f"{name}.launch.py"


def test_demo_is_moveits_own_with_mock_hardware(ros_packages: Path) -> None:
    started = everything_started(moveit_launch(ros_packages, "demo"))
    assert programs(started) == sorted([*AROUND, RVIZ, MOCK_HARDWARE, SPAWNER, SPAWNER])
    (controllers,) = only(started, MOCK_HARDWARE).parameters["files"]
    assert controllers.endswith("config/ros2_controllers.yaml") and Path(controllers).exists()


def test_demo_without_a_screen(ros_packages: Path) -> None:
    started = everything_started(moveit_launch(ros_packages, "demo"), use_rviz="false")
    assert RVIZ not in programs(started)


@pytest.mark.parametrize(
    ("name", "program"),
    [
        ("rsp", "robot_state_publisher/robot_state_publisher"),
        ("static_virtual_joint_tfs", "tf2_ros/static_transform_publisher"),
        ("move_group", "moveit_ros_move_group/move_group"),
        ("moveit_rviz", RVIZ),
    ],
)
def test_one_part_by_itself(ros_packages: Path, name: str, program: str) -> None:
    assert programs(everything_started(moveit_launch(ros_packages, name))) == [program]


def test_the_base_stands_in_the_world(ros_packages: Path) -> None:
    (transform,) = everything_started(moveit_launch(ros_packages, "static_virtual_joint_tfs"))
    assert transform.arguments == ["--frame-id", "world", "--child-frame-id", "base_link"]


def test_move_group_plans_with_what_is_configured(ros_packages: Path) -> None:
    (move_group,) = everything_started(moveit_launch(ros_packages, "move_group"))
    assert move_group.parameters["planning_pipelines"] == ["ompl", "pilz_industrial_motion_planner"]


def test_sliders_start_slow(ros_packages: Path) -> None:
    (rviz,) = everything_started(moveit_launch(ros_packages, "moveit_rviz"))
    for kind in ("velocity", "acceleration"):
        assert value_of(rviz, f"robot_description_planning.default_{kind}_scaling_factor") == 0.1


def test_controllers_of_the_demo(ros_packages: Path) -> None:
    spawned = everything_started(moveit_launch(ros_packages, "spawn_controllers"))
    assert programs(spawned) == [SPAWNER, SPAWNER]
    assert [node.arguments for node in spawned] == [["episode_arm_controller"], ["joint_state_broadcaster"]]


def test_the_real_arm_needs_one_launch_file(ros_packages: Path) -> None:
    started = everything_started(moveit_launch(ros_packages, "real_arm"))
    assert programs(started) == sorted([*AROUND, RVIZ, "rtarm/robot_interface"])
    server = only(started, "rtarm/robot_interface")
    assert server.parameters == {"arm": "episode1", "sim": False}
    assert server.ends_all


@pytest.mark.parametrize("name", ["real_arm", "printer"])
@pytest.mark.parametrize(("chosen", "used"), [(None, "UDPv4"), ("DEFAULT", "DEFAULT")])
def test_what_is_started_uses_udp_unless_the_user_chose_otherwise(
    ros_packages: Path, monkeypatch: pytest.MonkeyPatch, name: str, chosen: str | None, used: str
) -> None:
    if chosen is None:
        monkeypatch.delenv("FASTDDS_BUILTIN_TRANSPORTS", raising=False)
    else:
        monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", chosen)
    assert {one.transports for one in everything_started(moveit_launch(ros_packages, name))} == {used}


def test_the_real_arm_and_its_arguments(ros_packages: Path) -> None:
    started = everything_started(
        moveit_launch(ros_packages, "real_arm"), usb_index="1", init_mode="1", use_rviz="false"
    )
    assert programs(started) == sorted([*AROUND, "rtarm/robot_interface"])
    assert only(started, "rtarm/robot_interface").parameters == {
        "arm": "episode1", "sim": False, "usb_index": 1, "init_mode": 1
    }  # fmt: skip


def test_the_simulated_arm_is_the_same_file(ros_packages: Path) -> None:
    started = everything_started(moveit_launch(ros_packages, "real_arm"), sim="true")
    assert only(started, "rtarm/robot_interface").parameters == {"arm": "episode1", "sim": True}


@pytest.mark.parametrize("name", ["real_arm", "printer"])
def test_no_controllers_of_others_beside_ours(ros_packages: Path, name: str) -> None:
    assert not {SPAWNER, MOCK_HARDWARE} & set(programs(everything_started(moveit_launch(ros_packages, name))))


def test_the_printer_and_its_language(ros_packages: Path) -> None:
    started = everything_started(moveit_launch(ros_packages, "printer"), language="en")
    assert programs(started) == sorted([*AROUND, RVIZ, "rtarm/trajectory_printer"])
    assert only(started, "rtarm/trajectory_printer").arguments == ["--language", "en"]


def test_rtarm_without_moveit(ros_packages: Path) -> None:
    launch = ros_packages / "rtarm" / "launch"
    (server,) = everything_started(launch / "robot_interface.launch.py", channel="/dev/ttyACM0", arm="./mine.yaml")
    assert server.parameters == {"arm": "./mine.yaml", "sim": False, "channel": "/dev/ttyACM0"}
    (printer,) = everything_started(launch / "trajectory_printer.launch.py")
    assert printer.arguments == ["--language", "zh"]


def test_nobody_is_asked_to_end_a_second_time_before_the_longest_parking_is_over(ros_packages: Path) -> None:
    """Which would stop the arm on its way."""
    source = (ros_packages / "rtarm" / "launch" / "robot_interface.launch.py").read_text(encoding="utf-8")
    keywords = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.keyword))
    (patience,) = (keyword.value for keyword in keywords if keyword.arg == "sigterm_timeout")
    limits = ParkingConfig.model_fields["timeout_s"].metadata
    (longest_s,) = (limit.le for limit in limits if hasattr(limit, "le"))
    assert isinstance(patience, ast.Constant)
    slowest = Patience(LONGEST_ALLOWED_S)
    assert float(patience.value) > longest_s + slowest.ros_process_s + slowest.control_process_s + SIM_STOP_S


@pytest.mark.parametrize(
    ("given", "taken"),
    [("1", 1), ("-1", -1), ("010", "010"), ("[1", "[1"), ("1: 2", "1: 2"), ("null", "null"), ("", None)],
)
def test_what_is_no_number_arrives_as_it_was_written(ros_packages: Path, given: str, taken: object) -> None:
    """robot_interface says in a sentence what is wrong with it; the launch system would not."""
    launch = ros_packages / "rtarm" / "launch" / "robot_interface.launch.py"
    (server,) = everything_started(launch, usb_index=given)
    assert server.parameters.get("usb_index") == taken


def test_every_launch_file_says_what_it_starts(ros_packages: Path) -> None:
    files = sorted(ros_packages.glob("*/launch/*.launch.py"))
    assert len(files) >= 11
    for file in files:
        assert ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))), file
