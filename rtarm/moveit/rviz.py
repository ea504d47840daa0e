"""The layout of RViz: the arm, MoveIt's panel, and sliders that start slow."""

from __future__ import annotations

from config.geometry import KinematicsConfig
from config.schema import ArmConfig
from rtarm.moveit.text import yaml_text

FIRST_SCALING = 0.1
"""Share of velocity and acceleration limits at which the sliders of MoveIt's panel start."""


def layout(arm: ArmConfig, kinematics: KinematicsConfig) -> str:
    """`config/moveit.rviz`; names of classes and properties as in rviz 14 and moveit_ros_visualization 2.12."""
    base = kinematics.base_link
    motion_planning = {
        "Class": "moveit_rviz_plugin/MotionPlanning",
        "Name": "MotionPlanning",
        "Enabled": True,
        "Value": True,
        "Robot Description": "robot_description",
        "Planning Scene Topic": "monitored_planning_scene",
        "Planning Request": {
            "Planning Group": kinematics.group,
            "Query Goal State": True,
            "Query Start State": False,
            "Interactive Marker Size": 0.15,
        },
        "Planned Path": {
            "Trajectory Topic": "display_planned_path",
            "Loop Animation": False,
            "State Display Time": "0.05 s",
        },
        "Scene Robot": {"Robot Alpha": 1.0, "Show Robot Visual": True},
        "Velocity_Scaling_Factor": FIRST_SCALING,
        "Acceleration_Scaling_Factor": FIRST_SCALING,
    }
    content = {
        "Panels": [
            {"Class": "rviz_common/Displays", "Name": "Displays"},
            {"Class": "rviz_common/Views", "Name": "Views"},
        ],
        "Visualization Manager": {
            "Displays": [
                {
                    "Class": "rviz_default_plugins/Grid",
                    "Name": "Grid",
                    "Enabled": True,
                    "Value": True,
                    "Cell Size": 0.1,
                },
                {"Class": "rviz_default_plugins/TF", "Name": "TF", "Enabled": False, "Value": False},
                motion_planning,
            ],
            "Global Options": {"Fixed Frame": base, "Frame Rate": 30},
            "Tools": [
                {"Class": "rviz_default_plugins/Interact"},
                {"Class": "rviz_default_plugins/MoveCamera"},
                {"Class": "rviz_default_plugins/Select"},
            ],
            "Views": {
                "Current": {
                    "Class": "rviz_default_plugins/Orbit",
                    "Name": "Current View",
                    "Target Frame": base,
                    "Distance": 1.5,
                    "Focal Point": {"X": 0.0, "Y": 0.0, "Z": 0.25},
                    "Pitch": 0.4,
                    "Yaw": 0.8,
                }
            },
        },
        "Window Geometry": {"Width": 1400, "Height": 900},
    }
    comment = f"The scaling sliders start at {FIRST_SCALING:g}: a first motion should be slow, whatever was planned."
    return yaml_text(arm, content, comment)
