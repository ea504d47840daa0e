"""The parameter files of MoveIt and of ros2_control's demo, each a function of the arm.

What ROS declares a double is a double here: an integer in its place would be a parameter of the wrong type. Names and
meanings are those of MoveIt 2.12 (trajectory_execution_manager, moveit_simple_controller_manager, ompl_interface,
pilz_industrial_motion_planner, kinematics_plugin_loader) and of ros2_control for Jazzy.
"""

from __future__ import annotations

from typing import Any

from config.geometry import KinematicsConfig
from config.gripper import GROUP
from config.schema import ArmConfig
from rtarm.moveit.collisions import home_positions_rad
from rtarm.moveit.text import floored, yaml_text

ACTION = "follow_joint_trajectory"
GRIPPER_ACTION = "gripper_cmd"
"""As ros2_control's gripper controllers call it too."""

MOVEIT_START_TOLERANCE_RAD = 0.01
"""MoveIt's own default for the distance between a plan's first point and where the arm is (rad)."""

LONGEST_HOLD_S = 3600.0
"""How much longer than planned a goal may take: for so long a person may hold the arm."""

JOINTS_OF_A_FULL_POSE = 6
"""With fewer, an arm cannot take every orientation at a place."""

DEMO_RATE_HZ = 100

CONTROLLERS_COMMENT = """
MoveIt is the client of rtarm's action server, {controller}/{action}.

MoveIt cancels a goal that takes longer than allowed_execution_duration_scaling times its duration and
allowed_goal_duration_margin (s). But ~/hold, a speed scale below 1 and a drive that answers late make a goal take
longer with nothing being wrong, and rtarm judges every goal itself: path tolerance on the way, goal tolerance at most
{goal_time} s after the path's end, heartbeats of both processes; it answers with a sentence. So the margin is
{margin} s: for so long a goal may be held. Monitoring stays on because of the one case in which nobody answers, a ROS
process that is killed outright: without it MoveIt would wait for ever, and not even its Stop ends that.

allowed_start_tolerance lies below the {start_tolerance} rad that rtarm accepts, so that MoveIt says that the arm is
elsewhere before rtarm has to. It is also what MoveIt takes for standing still after a motion.
"""


GRIPPER_COMMENT = """
The gripper's action takes the last point of a plan, in radians of its joint. A gripper that holds something succeeds
with `stalled`, so picking up needs no allow_failure. No max_effort: it pushes as hard as its drive is set to.
"""


def moveit_controllers(arm: ArmConfig) -> str:
    """How MoveIt executes what it planned: by rtarm's action."""
    start_tolerance_rad = min(MOVEIT_START_TOLERANCE_RAD, arm.limits.start_tolerance_rad / 2.0)
    margin_s = LONGEST_HOLD_S + arm.trajectory.goal_time_s
    controller = arm.front.controller_name
    controllers: dict[str, dict[str, Any]] = {
        controller: {
            "type": "FollowJointTrajectory",
            "action_ns": ACTION,
            "default": True,
            "joints": _names(arm),
        },
    }
    if arm.gripper is not None:
        controllers[arm.gripper.controller_name] = {
            "type": "GripperCommand",
            "action_ns": GRIPPER_ACTION,
            "default": True,
            "joints": [arm.gripper.joint],
        }
    content = {
        "moveit_controller_manager": "moveit_simple_controller_manager/MoveItSimpleControllerManager",
        "moveit_simple_controller_manager": {"controller_names": list(controllers), **controllers},
        "trajectory_execution": {
            "execution_duration_monitoring": True,
            "allowed_execution_duration_scaling": 1.1,
            "allowed_goal_duration_margin": margin_s,
            "allowed_start_tolerance": start_tolerance_rad,
        },
    }
    comment = CONTROLLERS_COMMENT.format(
        controller=controller,
        action=ACTION,
        goal_time=f"{arm.trajectory.goal_time_s:g}",
        margin=f"{margin_s:g}",
        start_tolerance=f"{arm.limits.start_tolerance_rad:g}",
    )
    if arm.gripper is not None:
        comment += GRIPPER_COMMENT
    return yaml_text(arm, content, comment)


def ros2_controllers(arm: ArmConfig) -> str:
    """The controllers of the demo, under the names that rtarm has on the real arm."""
    controller = arm.front.controller_name
    gripper, kinds, parameters = arm.gripper, {}, {}
    if gripper is not None:
        kinds[gripper.controller_name] = {"type": "position_controllers/GripperActionController"}
        parameters[gripper.controller_name] = {"ros__parameters": {"joint": gripper.joint, "allow_stalling": True}}
    content = {
        "controller_manager": {
            "ros__parameters": {
                "update_rate": DEMO_RATE_HZ,
                controller: {"type": "joint_trajectory_controller/JointTrajectoryController"},
                **kinds,
                "joint_state_broadcaster": {"type": "joint_state_broadcaster/JointStateBroadcaster"},
            }
        },
        controller: {
            "ros__parameters": {
                "joints": _names(arm),
                "command_interfaces": ["position"],
                "state_interfaces": ["position", "velocity"],
                "allow_nonzero_velocity_at_trajectory_end": True,
            }
        },
        **parameters,
    }
    return yaml_text(arm, content, "For demo.launch.py only: with rtarm there is no ros2_control.")


def joint_limits(arm: ArmConfig) -> str:
    """Velocity and acceleration limits for planning, never above the arm's own; positions are the robot model's."""
    limits = {joint.name: (joint.max_velocity_rad_s, joint.max_acceleration_rad_s2) for joint in arm.joints}
    if arm.gripper is not None:
        limits[arm.gripper.joint] = (arm.gripper.speed_rad_s, arm.gripper.acceleration_rad_s2)
    content = {
        "default_velocity_scaling_factor": 1.0,
        "default_acceleration_scaling_factor": 1.0,
        "joint_limits": {
            name: {
                "has_velocity_limits": True,
                "max_velocity": floored(velocity_rad_s),
                "has_acceleration_limits": True,
                "max_acceleration": floored(acceleration_rad_s2),
                "has_jerk_limits": False,
            }
            for name, (velocity_rad_s, acceleration_rad_s2) in limits.items()
        },
    }
    comment = """
rad/s and rad/s^2. max_velocity is motor_rpm / ratio * 2 pi / 60 of the joint, rounded down.

The scaling factors are what a program gets that asks for none: full speed. RViz' sliders start at 0.1,
and so should you: 0.1 to 0.3 to try things, 0.5 to 0.8 for work."""
    return yaml_text(arm, content, comment)


def kinematics(arm: ArmConfig, geometry: KinematicsConfig) -> str:
    """The solver that finds joint angles for a pose of the tip."""
    solver: dict[str, Any] = {
        "kinematics_solver": "kdl_kinematics_plugin/KDLKinematicsPlugin",
        "kinematics_solver_search_resolution": 0.005,
        "kinematics_solver_timeout": 0.05,
    }
    comment = ""
    if len(arm.joints) < JOINTS_OF_A_FULL_POSE:
        solver["position_only_ik"] = True
        comment = f"position_only_ik: {len(arm.joints)} joints cannot reach a place in every orientation."
    return yaml_text(arm, {geometry.group: solver}, comment)


def ompl_planning(arm: ArmConfig, geometry: KinematicsConfig) -> str:
    """The sampling planners, and what is done to a request before and to a path after them."""
    planners: dict[str, dict[str, Any]] = {
        "RRTConnect": {"type": "geometric::RRTConnect", "range": 0.0},
        "BiTRRT": {"type": "geometric::BiTRRT", "range": 0.0},
        "RRTstar": {"type": "geometric::RRTstar", "range": 0.0, "goal_bias": 0.05},
        "PRM": {"type": "geometric::PRM", "max_nearest_neighbors": 10},
    }
    content: dict[str, Any] = {
        "planning_plugins": ["ompl_interface/OMPLPlanner"],
        "request_adapters": [
            f"default_planning_request_adapters/{name}"
            for name in (
                "ResolveConstraintFrames",
                "ValidateWorkspaceBounds",
                "CheckStartStateBounds",
                "CheckStartStateCollision",
            )
        ],
        "response_adapters": [
            f"default_planning_response_adapters/{name}"
            for name in ("AddTimeOptimalParameterization", "ValidateSolution", "DisplayMotionPath")
        ],
        "planner_configs": planners,
        geometry.group: {
            "default_planner_config": "RRTConnect",
            "planner_configs": list(planners),
            "projection_evaluator": f"joints({','.join(_names(arm)[:2])})",
            "longest_valid_segment_fraction": 0.005,
        },
    }
    if arm.gripper is not None:
        content[GROUP] = {"default_planner_config": "RRTConnect", "planner_configs": list(planners)}
    comment = """
AddTimeOptimalParameterization gives every point time, velocity and acceleration, of which rtarm makes quintics; it
must stay. A range of 0.0 lets the planner choose."""
    return yaml_text(arm, content, comment)


def pilz_cartesian_limits(arm: ArmConfig) -> str:
    """Limits of the tip for Pilz' straight lines and circles; the joints' own limits hold besides."""
    content = {
        "cartesian_limits": {
            "max_trans_vel": 1.0,
            "max_trans_acc": 2.25,
            "max_trans_dec": -5.0,
            "max_rot_vel": 1.57,
        }
    }
    return yaml_text(arm, content, "m/s, m/s^2, m/s^2 and rad/s of the tip, for Pilz' planner (LIN, CIRC) only.")


def initial_positions(arm: ArmConfig) -> str:
    """Where the demo's mock hardware starts."""
    return yaml_text(
        arm, {"initial_positions": home_positions_rad(arm)}, "Radians, for demo.launch.py only: the pose `home`."
    )


def _names(arm: ArmConfig) -> list[str]:
    return [joint.name for joint in arm.joints]
