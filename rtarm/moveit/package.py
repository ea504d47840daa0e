"""All files of the MoveIt configuration package of an arm, as text."""

from __future__ import annotations

from config.geometry import KinematicsConfig
from config.schema import ArmConfig
from rtarm.moveit import parameters, robot, rviz
from rtarm.moveit.launch_files import launch_files
from rtarm.moveit.text import origin_sentence, xml_text, yaml_text

RUN_WITH = (
    "controller_manager",
    "hardware_interface",
    "joint_state_broadcaster",
    "joint_trajectory_controller",
    "launch",
    "launch_ros",
    "moveit_configs_utils",
    "moveit_kinematics",
    "moveit_planners",
    "moveit_ros_move_group",
    "moveit_ros_visualization",
    "moveit_simple_controller_manager",
    "pilz_industrial_motion_planner",
    "robot_state_publisher",
    "rtarm",
    "rviz2",
    "rviz_common",
    "rviz_default_plugins",
    "tf2_ros",
    "xacro",
)
"""What the launch files and the parameters name."""


def package_name(arm: ArmConfig) -> str:
    """The package's name, under which MoveItConfigsBuilder looks for a robot of this name."""
    return f"{arm.name}_moveit_config"


def package_files(arm: ArmConfig, kinematics: KinematicsConfig) -> dict[str, str]:
    """Every file of the package: path in the package → text. The same arm gives the same texts."""
    name = arm.name
    return {
        ".setup_assistant": _setup_assistant(arm),
        "CMakeLists.txt": _cmake(arm),
        "package.xml": _manifest(arm),
        f"config/{name}.urdf.xacro": robot.model(arm),
        f"config/{name}_arm.urdf.xacro": robot.model_parts(arm, kinematics),
        f"config/{name}.ros2_control.xacro": robot.mock_hardware(arm),
        f"config/{name}.srdf": robot.semantics(arm, kinematics),
        "config/initial_positions.yaml": parameters.initial_positions(arm),
        "config/joint_limits.yaml": parameters.joint_limits(arm),
        "config/kinematics.yaml": parameters.kinematics(arm, kinematics),
        "config/moveit.rviz": rviz.layout(arm, kinematics),
        "config/moveit_controllers.yaml": parameters.moveit_controllers(arm),
        "config/ompl_planning.yaml": parameters.ompl_planning(arm, kinematics),
        "config/pilz_cartesian_limits.yaml": parameters.pilz_cartesian_limits(arm),
        "config/ros2_controllers.yaml": parameters.ros2_controllers(arm),
        **launch_files(arm),
    }


def _setup_assistant(arm: ArmConfig) -> str:
    """Where MoveIt's builder and its Setup Assistant find model and semantics."""
    content = {
        "moveit_setup_assistant_config": {
            "urdf": {"package": package_name(arm), "relative_path": f"config/{arm.name}_arm.urdf.xacro"},
            "srdf": {"relative_path": f"config/{arm.name}.srdf"},
            "package_settings": {
                "author_name": "rtarm contributors",
                "author_email": "maintainers@rtarm.invalid",
                "generated_timestamp": 0,
            },
            "control_xacro": {"command": ["position"], "state": ["position", "velocity"]},
            "modified_urdf": {"xacros": ["control_xacro"]},
        }
    }
    return yaml_text(arm, content)


def _cmake(arm: ArmConfig) -> str:
    return f"""# {origin_sentence(arm)}
cmake_minimum_required(VERSION 3.22)
project({package_name(arm)} NONE)

find_package(ament_cmake REQUIRED)

install(DIRECTORY config launch DESTINATION share/${{PROJECT_NAME}} PATTERN __pycache__ EXCLUDE)
install(FILES .setup_assistant DESTINATION share/${{PROJECT_NAME}})

ament_package()
"""


def _manifest(arm: ArmConfig) -> str:
    packages = RUN_WITH if arm.gripper is None else sorted((*RUN_WITH, "gripper_controllers"))
    run_with = "\n".join(f"  <exec_depend>{package}</exec_depend>" for package in packages)
    return xml_text(
        arm,
        f"""
<package format="3">
  <name>{package_name(arm)}</name>
  <version>0.1.0</version>
  <description>MoveIt configuration of the arm {arm.name}, driven by rtarm.</description>
  <maintainer email="maintainers@rtarm.invalid">rtarm contributors</maintainer>
  <license>Apache-2.0</license>

  <buildtool_depend>ament_cmake</buildtool_depend>

{run_with}

  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>""",
    )
