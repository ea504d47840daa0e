"""What our launch files use of ROS' launch system and of MoveIt's launch generators, where neither is installed.

Neither is on the package index. The names and arguments are those of ROS 2 Jazzy (launch 3.4, launch_ros 0.26,
moveit_configs_utils 2.12), and unknown ones fail; where the real ones can be imported, the same tests run on those.
What MoveIt's generators start is what their sources say.
"""

from __future__ import annotations

import importlib.util
import os
import re
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_share_directory


class LaunchContext:
    def __init__(self) -> None:
        self.launch_configurations: dict[str, str] = {}
        self.environment = dict(os.environ)

    def perform(self, value: Any) -> str:
        """A text, a substitution, or a list of both."""
        if isinstance(value, (list, tuple)):
            return "".join(self.perform(part) for part in value)
        return value.perform(self) if hasattr(value, "perform") else str(value)


class LaunchConfiguration:
    def __init__(self, variable_name: str) -> None:
        self.name = variable_name

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]


class EnvironmentVariable:
    def __init__(self, name: str, *, default_value: str) -> None:
        self.name, self.default_value = name, default_value

    def perform(self, context: LaunchContext) -> str:
        return context.environment.get(self.name, self.default_value)


class PathJoinSubstitution:
    def __init__(self, substitutions: Iterable[Any]) -> None:
        self.parts = list(substitutions)

    def perform(self, context: LaunchContext) -> str:
        return os.path.join(*(context.perform(part) for part in self.parts))


class FindPackageShare:
    def __init__(self, package: str) -> None:
        self.package = package

    def perform(self, context: LaunchContext) -> str:
        return get_package_share_directory(self.package)


class IfCondition:
    def __init__(self, predicate_expression: Any) -> None:
        self.expression = predicate_expression

    def evaluate(self, context: LaunchContext) -> bool:
        return {"true": True, "1": True, "false": False, "0": False}[context.perform(self.expression).lower()]


class Action:
    def __init__(self, *, condition: IfCondition | None = None) -> None:
        self.condition = condition

    def visit(self, context: LaunchContext) -> Sequence[Any] | None:
        if self.condition is None or self.condition.evaluate(context):
            return self.execute(context)
        return None

    def execute(self, context: LaunchContext) -> Sequence[Any] | None:
        raise NotImplementedError


class LaunchDescription:
    def __init__(self, initial_entities: Iterable[Any] = ()) -> None:
        self.entities = list(initial_entities)

    def visit(self, context: LaunchContext) -> Sequence[Any]:
        return self.entities


class DeclareLaunchArgument(Action):
    def __init__(
        self,
        name: str,
        *,
        default_value: Any = None,
        description: str | None = None,
        choices: Sequence[str] | None = None,
    ) -> None:
        super().__init__()
        self.name, self.default_value, self.description, self.choices = name, default_value, description, choices

    def execute(self, context: LaunchContext) -> None:
        if self.name not in context.launch_configurations:
            if self.default_value is None:
                raise RuntimeError(f"launch argument {self.name} was not provided")
            context.launch_configurations[self.name] = context.perform(self.default_value)
        value = context.launch_configurations[self.name]
        if self.choices is not None and value not in self.choices:
            raise RuntimeError(f"{self.name} is {value}, not one of {self.choices}")


class SetLaunchConfiguration(Action):
    def __init__(self, name: str, value: Any) -> None:
        super().__init__()
        self.name, self.value = name, value

    def execute(self, context: LaunchContext) -> None:
        context.launch_configurations[self.name] = context.perform(self.value)


class SetEnvironmentVariable(Action):
    def __init__(self, name: str, value: Any) -> None:
        super().__init__()
        self.name, self.value = name, value

    def execute(self, context: LaunchContext) -> None:
        context.environment[self.name] = context.perform(self.value)


class IncludeLaunchDescription(Action):
    def __init__(
        self,
        launch_description_source: Any,
        *,
        launch_arguments: Iterable[tuple[str, Any]] | None = None,
        condition: IfCondition | None = None,
    ) -> None:
        super().__init__(condition=condition)
        self.source, self.arguments = launch_description_source, list(launch_arguments or ())

    def execute(self, context: LaunchContext) -> Sequence[Any]:
        given = [SetLaunchConfiguration(name, value) for name, value in self.arguments]
        return [*given, load(Path(context.perform(self.source)))]


class OpaqueFunction(Action):
    def __init__(self, *, function: Callable[[LaunchContext], Sequence[Any] | None]) -> None:
        super().__init__()
        self.function = function

    def execute(self, context: LaunchContext) -> Sequence[Any] | None:
        return self.function(context)


class Shutdown(Action):
    def __init__(self, *, reason: str = "reason not given") -> None:
        super().__init__()
        self.reason = reason


class Node(Action):
    def __init__(
        self,
        *,
        package: str,
        executable: str,
        name: str | None = None,
        output: str = "log",
        parameters: Sequence[Mapping[str, Any] | str] = (),
        remappings: Sequence[tuple[str, str]] = (),
        arguments: Sequence[Any] = (),
        respawn: bool = False,
        sigterm_timeout: str = "5",
        sigkill_timeout: str = "5",
        on_exit: Action | None = None,
        condition: IfCondition | None = None,
    ) -> None:
        super().__init__(condition=condition)
        float(sigterm_timeout), float(sigkill_timeout)
        self.node_package, self.node_executable = package, executable
        self.parameters, self.arguments, self.on_exit = list(parameters), list(arguments), on_exit
        self.name, self.output, self.remappings, self.respawn = name, output, list(remappings), respawn


class MoveItConfigs:
    def __init__(self, robot: str, package_path: Path, pipelines: Sequence[str]) -> None:
        self.robot, self.package_path, self.pipelines = robot, package_path, pipelines
        limits = yaml.safe_load((package_path / "config" / "joint_limits.yaml").read_text(encoding="utf-8"))
        self.joint_limits = {"robot_description_planning": limits}


class MoveItConfigsBuilder:
    def __init__(
        self, robot_name: str, robot_description: str = "robot_description", *, package_name: str | None = None
    ) -> None:
        self.robot = robot_name
        self.package_path = Path(get_package_share_directory(package_name or f"{robot_name}_moveit_config"))
        self.pipelines: Sequence[str] = ("chomp", "ompl", "pilz_industrial_motion_planner", "stomp")

    def planning_pipelines(
        self,
        default_planning_pipeline: str | None = None,
        pipelines: Sequence[str] | None = None,
        load_all: bool = True,
    ) -> MoveItConfigsBuilder:
        self.pipelines = pipelines or self.pipelines
        return self

    def to_moveit_configs(self) -> MoveItConfigs:
        return MoveItConfigs(self.robot, self.package_path, self.pipelines)


def generate_rsp_launch(moveit_config: MoveItConfigs) -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("publish_frequency", default_value="15.0"),
            Node(package="robot_state_publisher", executable="robot_state_publisher", respawn=True),
        ]
    )


def generate_static_virtual_joint_tfs_launch(moveit_config: MoveItConfigs) -> LaunchDescription:
    semantic = (moveit_config.package_path / "config" / f"{moveit_config.robot}.srdf").read_text(encoding="utf-8")
    parents = re.findall(r'<virtual_joint [^>]*parent_frame="([^"]+)"', semantic)
    children = re.findall(r'<virtual_joint [^>]*child_link="([^"]+)"', semantic)
    return LaunchDescription(
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            name=f"static_transform_publisher{index}",
            arguments=["--frame-id", parent, "--child-frame-id", child],
        )
        for index, (parent, child) in enumerate(zip(parents, children, strict=True))
    )


def generate_move_group_launch(moveit_config: MoveItConfigs) -> LaunchDescription:
    parameters = [{"planning_pipelines": list(moveit_config.pipelines)}]
    return LaunchDescription(
        [
            DeclareLaunchArgument("allow_trajectory_execution", default_value="true"),
            Node(package="moveit_ros_move_group", executable="move_group", parameters=parameters),
        ]
    )


def generate_moveit_rviz_launch(moveit_config: MoveItConfigs) -> LaunchDescription:
    layout = str(moveit_config.package_path / "config" / "moveit.rviz")
    return LaunchDescription(
        [
            DeclareLaunchArgument("rviz_config", default_value=layout),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", LaunchConfiguration("rviz_config")],
                parameters=[moveit_config.joint_limits],
            ),
        ]
    )


def generate_spawn_controllers_launch(moveit_config: MoveItConfigs) -> LaunchDescription:
    file = moveit_config.package_path / "config" / "moveit_controllers.yaml"
    manager = yaml.safe_load(file.read_text(encoding="utf-8"))["moveit_simple_controller_manager"]
    names = [*manager["controller_names"], "joint_state_broadcaster"]
    return LaunchDescription(
        Node(package="controller_manager", executable="spawner", arguments=[name]) for name in names
    )


def generate_warehouse_db_launch(moveit_config: MoveItConfigs) -> LaunchDescription:
    return LaunchDescription([Node(package="warehouse_ros_mongo", executable="mongo_wrapper_ros.py")])


def generate_demo_launch(moveit_config: MoveItConfigs) -> LaunchDescription:
    def include(name: str, condition: IfCondition | None = None) -> IncludeLaunchDescription:
        file = str(moveit_config.package_path / "launch" / f"{name}.launch.py")
        return IncludeLaunchDescription(file, condition=condition)

    return LaunchDescription(
        [
            DeclareLaunchArgument("db", default_value="false"),
            DeclareLaunchArgument("use_rviz", default_value="true"),
            include("static_virtual_joint_tfs"),
            include("rsp"),
            include("move_group"),
            include("moveit_rviz", IfCondition(LaunchConfiguration("use_rviz"))),
            include("warehouse_db", IfCondition(LaunchConfiguration("db"))),
            Node(
                package="controller_manager",
                executable="ros2_control_node",
                parameters=[str(moveit_config.package_path / "config" / "ros2_controllers.yaml")],
                remappings=[("/controller_manager/robot_description", "/robot_description")],
            ),
            include("spawn_controllers"),
        ]
    )


MODULES: dict[str, list[Any]] = {
    "launch": [LaunchContext, LaunchDescription],
    "launch.actions": [
        DeclareLaunchArgument,
        IncludeLaunchDescription,
        OpaqueFunction,
        SetEnvironmentVariable,
        Shutdown,
    ],
    "launch.conditions": [IfCondition],
    "launch.substitutions": [EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution],
    "launch_ros": [],
    "launch_ros.actions": [Node],
    "launch_ros.substitutions": [FindPackageShare],
    "moveit_configs_utils": [MoveItConfigsBuilder],
    "moveit_configs_utils.launches": [
        generate_rsp_launch,
        generate_static_virtual_joint_tfs_launch,
        generate_move_group_launch,
        generate_moveit_rviz_launch,
        generate_spawn_controllers_launch,
        generate_warehouse_db_launch,
        generate_demo_launch,
    ],
}


IS_NEEDED = any(importlib.util.find_spec(name) is None for name in ("launch", "launch_ros", "moveit_configs_utils"))
"""Whether the real ones are missing."""


def modules() -> dict[str, types.ModuleType]:
    """The stand-ins, to be put into `sys.modules`."""
    made = {}
    for name, contents in MODULES.items():
        made[name] = types.ModuleType(name)
        for content in contents:
            setattr(made[name], content.__name__, content)
    return made


def load(file: Path) -> LaunchDescription:
    """A launch file's description."""
    spec = importlib.util.spec_from_file_location(f"launch_file_{file.name.removesuffix('.launch.py')}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = bytecode
    description: LaunchDescription = module.generate_launch_description()
    return description
