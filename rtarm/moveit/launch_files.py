"""The launch files of a MoveIt configuration package, as text.

MoveIt's own generators (`moveit_configs_utils.launches`) say what each of them starts, so that these files behave as
everybody's and follow MoveIt's next versions. Ours are only the two that put rtarm in the place of ros2_control.
"""

from __future__ import annotations

from config.schema import ArmConfig
from rtarm.moveit.text import origin_sentence

GENERATED = {
    "rsp": "robot_state_publisher: the robot description and, from /joint_states, TF.",
    "static_virtual_joint_tfs": "the fixed transform from world to the arm's base.",
    "move_group": "MoveIt's planning node.",
    "moveit_rviz": "RViz with MoveIt's panel.",
    "spawn_controllers": "the controllers of ros2_control's mock hardware: for demo.launch.py, never beside rtarm.",
    "warehouse_db": "the database that demo.launch.py starts with db:=true.",
    "demo": "MoveIt's own demo, without rtarm: ros2_control's mock hardware plays the arm.",
}
"""The launch files that are a call of MoveIt's generator of the same name, and what they start."""

PLANNING_PIPELINES = ("ompl", "pilz_industrial_motion_planner")
"""Those the package configures and depends on. Left out, MoveIt would load every pipeline that it has defaults for."""

AROUND_THE_SERVER = ("static_virtual_joint_tfs", "rsp", "move_group")
"""What runs beside the action server, whichever it is, and with a screen also `moveit_rviz`."""


def launch_files(arm: ArmConfig) -> dict[str, str]:
    """Every launch file of the arm's package: path in the package → text."""
    texts = {name: _generated(arm, name, starts) for name, starts in GENERATED.items()}
    texts["real_arm"] = _real_arm(arm)
    texts["printer"] = _printer(arm)
    return {f"launch/{name}.launch.py": text for name, text in texts.items()}


def _head(arm: ArmConfig, starts: str) -> str:
    return f'''# {origin_sentence(arm)}
"""Starts {starts}"""

'''


def _generated(arm: ArmConfig, name: str, starts: str) -> str:
    pipelines = ", ".join(f'"{pipeline}"' for pipeline in PLANNING_PIPELINES)
    return f"""{_head(arm, starts)}from moveit_configs_utils import MoveItConfigsBuilder
from moveit_configs_utils.launches import generate_{name}_launch


def generate_launch_description():
    builder = MoveItConfigsBuilder("{arm.name}", package_name="{arm.name}_moveit_config")
    builder.planning_pipelines(pipelines=[{pipelines}])
    configs = builder.to_moveit_configs()
{_SLOW_SLIDERS if name == "moveit_rviz" else ""}    return generate_{name}_launch(configs)
"""


_SLOW_SLIDERS = """\
    # RViz' sliders start at these: a first trial is slow, whatever programs get from joint_limits.yaml.
    limits = configs.joint_limits["robot_description_planning"]
    limits["default_velocity_scaling_factor"] = limits["default_acceleration_scaling_factor"] = 0.1
"""


def _real_arm(arm: ArmConfig) -> str:
    built_in = arm.source is not None and arm.source.built_in
    default = f'default_value="{arm.name}", ' if built_in else ""
    whose = "name or arm file of the arm" if default else "path of the arm file this package was generated from"
    starts = """MoveIt and rtarm: the one launch file for the real arm, and with sim:=true for the simulated one.

spawn_controllers.launch.py must not run beside it: rtarm itself is the controller."""
    return f"""{_head(arm, starts)}from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = (
    DeclareLaunchArgument("arm", {default}description="{whose}"),
    DeclareLaunchArgument("sim", default_value="false", description="true simulates the drives, without hardware"),
    DeclareLaunchArgument("usb_index", default_value="", description="n means /dev/ttyUSBn; empty: as in the arm file"),
    DeclareLaunchArgument("channel", default_value="", description="the adapter's device; empty: as in the arm file"),
    DeclareLaunchArgument(
        "init_mode", default_value="", description="1 takes over the present pose, 0 homes; empty: as in the arm file"
    ),
    DeclareLaunchArgument("use_rviz", default_value="true", description="false starts no RViz"),
)
FOR_THE_ARM = ("arm", "sim", "usb_index", "channel", "init_mode")
{_BY_UDP}

{_PART}

def generate_launch_description():
    given = {{name: LaunchConfiguration(name) for name in FOR_THE_ARM}}
    return LaunchDescription(
        [
            *ARGUMENTS,
            BY_UDP,
            part("rtarm", "robot_interface", launch_arguments=given.items()),
            {_around(arm)}
        ]
    )
"""


def _printer(arm: ArmConfig) -> str:
    starts = "MoveIt and a node that prints what MoveIt plans and then pretends that the arm is there."
    return f"""{_head(arm, starts)}from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = (
    DeclareLaunchArgument("language", default_value="zh", choices=["zh", "en"], description="language of the print"),
    DeclareLaunchArgument("use_rviz", default_value="true", description="false starts no RViz"),
)
{_BY_UDP}

{_PART}

def generate_launch_description():
    given = {{"language": LaunchConfiguration("language")}}
    return LaunchDescription(
        [
            *ARGUMENTS,
            BY_UDP,
            part("rtarm", "trajectory_printer", launch_arguments=given.items()),
            {_around(arm)}
        ]
    )
"""


_BY_UDP = """\
# A process that is killed in the shared memory of Fast DDS makes the others wait for ever; what you have set stays.
BY_UDP = SetEnvironmentVariable(
    "FASTDDS_BUILTIN_TRANSPORTS", EnvironmentVariable("FASTDDS_BUILTIN_TRANSPORTS", default_value="UDPv4")
)
"""


_PART = '''def part(package, name, **options):
    """Another launch file, of this package or of rtarm."""
    file = PathJoinSubstitution([FindPackageShare(package), "launch", f"{name}.launch.py"])
    return IncludeLaunchDescription(file, **options)
'''


def _around(arm: ArmConfig) -> str:
    package = f"{arm.name}_moveit_config"
    parts = [f'part("{package}", "{name}"),' for name in AROUND_THE_SERVER]
    parts.append(f'part("{package}", "moveit_rviz", condition=IfCondition(LaunchConfiguration("use_rviz"))),')
    return ("\n" + " " * 12).join(parts)
