"""The repository's ROS packages as an installed workspace has them."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("ament_index_python")

import launch_stand_in

SOURCES = Path(__file__).resolve().parents[2] / "ros"
PROGRAMS = {
    "rtarm": ["robot_interface", "trajectory_printer"],
    "robot_state_publisher": ["robot_state_publisher"],
    "tf2_ros": ["static_transform_publisher"],
    "moveit_ros_move_group": ["move_group"],
    "rviz2": ["rviz2"],
    "controller_manager": ["ros2_control_node", "spawner"],
    "warehouse_ros_mongo": ["mongo_wrapper_ros.py"],
    "moveit_ros_warehouse": ["moveit_init_demo_warehouse"],
}
"""What is launched, by package: the launch system looks whether it is there, whoever would start it."""


@pytest.fixture
def ros_packages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The folder of our ROS packages; they are where ament finds them, and launch files can be imported."""
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    for description in SOURCES.glob("*/package.xml"):
        package = description.parent
        (index / package.name).touch()
        (tmp_path / "share" / package.name).symlink_to(package)
    for name, programs in PROGRAMS.items():
        (index / name).touch()
        folder = tmp_path / "lib" / name
        folder.mkdir(parents=True)
        for program in programs:
            (folder / program).touch(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path), prepend=":")
    if launch_stand_in.IS_NEEDED:
        for name, module in launch_stand_in.modules().items():
            monkeypatch.setitem(sys.modules, name, module)
    return SOURCES
