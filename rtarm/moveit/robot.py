"""The robot model (URDF, as xacro) and what MoveIt has to know about it beyond that (SRDF)."""

from __future__ import annotations

from itertools import cycle, pairwise

from config.geometry import DhRow, KinematicsConfig
from config.gripper import GROUP, LINK, GripperConfig
from config.joint import JointConfig
from config.kinematics import Origin, flange_origin, joint_origins, tip_link
from config.schema import ArmConfig
from rtarm.moveit.collisions import home_positions_rad, home_rad, unchecked_pairs
from rtarm.moveit.shapes import Bone, Link, Xyz, gripper_shape, link_shapes
from rtarm.moveit.text import angles, floored, number, numbers, xml_text

EFFORT_NM = 10.0
"""A nominal effort limit (N·m). A robot model must state one; rtarm and MoveIt's planners use none."""

MATERIALS = {"light": (0.85, 0.86, 0.88, 1.0), "dark": (0.25, 0.27, 0.30, 1.0), "mark": (0.95, 0.45, 0.10, 1.0)}
"""Colours as red, green, blue and opacity: light and dark in turn, so that links can be told apart."""

PARTS_COMMENT = """The links and joints of the arm: kinematics true to its Denavit-Hartenberg table, shapes simple.
     No link has an inertia: the arm moves by position, and neither MoveIt nor the mock hardware asks for one; a dynamic
     simulation would. The effort limit is nominal."""


def model(arm: ArmConfig) -> str:
    """The file to load: the arm, and for the demo the mock hardware of ros2_control. Needs no ament index."""
    return xml_text(
        arm,
        f"""
<robot name="{arm.name}" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="initial_positions_file" default="initial_positions.yaml"/>
  <xacro:include filename="{arm.name}_arm.urdf.xacro"/>
  <xacro:include filename="{arm.name}.ros2_control.xacro"/>
  <xacro:{arm.name}_ros2_control name="MockHardware" initial_positions_file="$(arg initial_positions_file)"/>
</robot>""",
    )


def model_parts(arm: ArmConfig, kinematics: KinematicsConfig) -> str:
    """Links and joints, a robot model in itself."""
    shapes = link_shapes(kinematics)
    materials = [
        f'  <material name="{name}"><color rgba="{numbers(colour)}"/></material>' for name, colour in MATERIALS.items()
    ]
    links = [
        _link(link, material, marked=link is shapes[-1])
        for link, material in zip(shapes, cycle(("dark", "light")), strict=False)
    ]
    joints = [
        _joint(joint, row, (parent.name, child.name), origin)
        for joint, row, (parent, child), origin in zip(
            arm.joints, kinematics.dh, pairwise(shapes), joint_origins(kinematics), strict=True
        )
    ]
    flange = flange_origin(kinematics)
    if flange is not None:
        links.append('  <link name="flange"/>')
        joints.append(_fixed_flange(shapes[-1].name, flange))
    if arm.gripper is not None:
        links.append(_link(gripper_shape(arm.gripper), "dark", marked=True))
        joints.append(_gripper_joint(arm.gripper, tip_link(kinematics)))
    body = "\n\n".join(["\n".join(materials), *links, *joints])
    return xml_text(arm, f'<robot name="{arm.name}">\n{body}\n</robot>', PARTS_COMMENT)


def mock_hardware(arm: ArmConfig) -> str:
    """The ros2_control part: what is commanded is at once the state. Only demo.launch.py uses it."""
    joints = "\n".join(
        f"""      <joint name="{name}">
        <command_interface name="position"/>
        <state_interface name="position">
          <param name="initial_value">${{initial_positions['{name}']}}</param>
        </state_interface>
        <state_interface name="velocity"/>
      </joint>"""
        for name in home_positions_rad(arm)
    )
    return xml_text(
        arm,
        f"""
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="{arm.name}_ros2_control" params="name initial_positions_file">
    <xacro:property name="initial_positions"
                    value="${{xacro.load_yaml(initial_positions_file)['initial_positions']}}"/>
    <ros2_control name="${{name}}" type="system">
      <hardware>
        <plugin>mock_components/GenericSystem</plugin>
      </hardware>
{joints}
    </ros2_control>
  </xacro:macro>
</robot>""",
        "For demo.launch.py only. With rtarm there is no ros2_control: rtarm is the hardware and the controller.",
    )


def semantics(arm: ArmConfig, kinematics: KinematicsConfig) -> str:
    """The SRDF: the planning group, the pose `home`, the base's place in the world, and the unchecked pairs.

    A gripper is a group of its own with the poses `open` and `closed`, and the end effector of the arm's group.
    """
    gripper = "" if arm.gripper is None else _gripper_semantics(arm.gripper, kinematics)
    home = "\n".join(
        f'    <joint name="{joint.name}" value="{number(position_rad)}"/>'
        for joint, position_rad in zip(arm.joints, home_rad(arm), strict=True)
    )
    pairs = "\n".join(
        f'  <disable_collisions link1="{pair.one}" link2="{pair.other}" reason="{pair.reason}"/>'
        for pair in unchecked_pairs(arm, kinematics)
    )
    return xml_text(
        arm,
        f"""
<robot name="{arm.name}">
  <group name="{kinematics.group}">
    <chain base_link="{kinematics.base_link}" tip_link="{tip_link(kinematics)}"/>
  </group>
  <group_state name="home" group="{kinematics.group}">
{home}
  </group_state>{gripper}
  <virtual_joint name="virtual_joint" type="fixed" parent_frame="world" child_link="{kinematics.base_link}"/>

  <!-- Computed from shapes and joint limits, not set by hand: pairs that never touch, and pairs whose shapes overlap
       always (Adjacent, Always) or at home (Default), of which MoveIt can therefore see no collision. -->
{pairs}
</robot>""",
    )


def _link(link: Link, material: str, *, marked: bool) -> str:
    shapes = [_cylinder(bone, link.radius_m) for bone in link.bones if bone.length_m > 0.0]
    shapes += [_ball(end_m, link.radius_m) for end_m in link.ends_m]
    lines = [f'  <link name="{link.name}">']
    for shape in shapes:
        lines.append(f'    <visual>{shape}<material name="{material}"/></visual>')
    if marked:
        lines.append(f'    <visual>{_mark(link)}<material name="mark"/></visual>')
    for shape in shapes:
        lines.append(f"    <collision>{shape}</collision>")
    return "\n".join([*lines, "  </link>"])


def _cylinder(bone: Bone, radius_m: float) -> str:
    size = f'radius="{number(radius_m)}" length="{number(round(bone.length_m, 9))}"'
    return f"{_origin(bone.middle_m, bone.rpy_rad)}<geometry><cylinder {size}/></geometry>"


def _ball(centre_m: Xyz, radius_m: float) -> str:
    return f'{_origin(centre_m)}<geometry><sphere radius="{number(radius_m)}"/></geometry>'


def _mark(link: Link) -> str:
    """A nose towards x, only to be seen: without it nobody would see the last joint turn."""
    x, y, z = link.bones[-1].end_m
    size = numbers((link.radius_m, link.radius_m / 4.0, link.radius_m / 4.0))
    return f'{_origin((x + link.radius_m, y, z))}<geometry><box size="{size}"/></geometry>'


def _joint(joint: JointConfig, row: DhRow, links: tuple[str, str], origin: Origin) -> str:
    parent, child = links
    limits = {
        "lower": joint.lower_rad,
        "upper": joint.upper_rad,
        "effort": EFFORT_NM,
        "velocity": floored(joint.max_velocity_rad_s),
    }
    return f"""  <joint name="{joint.name}" type="revolute">
    <parent link="{parent}"/>
    <child link="{child}"/>
    {_origin(origin.xyz_m, origin.rpy_rad)}
    <axis xyz="0 0 {row.sign}"/>
    <limit {" ".join(f'{name}="{number(limit)}"' for name, limit in limits.items())}/>
  </joint>"""


def _gripper_joint(gripper: GripperConfig, parent: str) -> str:
    """It turns about the flange's axis, so that the gripper's shape stays where it is; its angle is all that counts."""
    return f"""  <joint name="{gripper.joint}" type="revolute">
    <parent link="{parent}"/>
    <child link="{LINK}"/>
    {_origin((0.0, 0.0, 0.0))}
    <axis xyz="0 0 1"/>
    <limit lower="{number(gripper.lower_rad)}" upper="{number(gripper.upper_rad)}" effort="{number(EFFORT_NM)}" \
velocity="{number(floored(gripper.speed_rad_s))}"/>
  </joint>"""


def _gripper_semantics(gripper: GripperConfig, kinematics: KinematicsConfig) -> str:
    states = "".join(
        f"""
  <group_state name="{name}" group="{GROUP}">
    <joint name="{gripper.joint}" value="{number(angle_rad)}"/>
  </group_state>"""
        for name, angle_rad in (("open", gripper.open_rad), ("closed", gripper.closed_rad))
    )
    return f"""
  <group name="{GROUP}">
    <joint name="{gripper.joint}"/>
  </group>{states}
  <end_effector name="{GROUP}" parent_link="{tip_link(kinematics)}" group="{GROUP}" parent_group="{kinematics.group}"/>\
"""


def _fixed_flange(parent: str, origin: Origin) -> str:
    return f"""  <joint name="flange_joint" type="fixed">
    <parent link="{parent}"/>
    <child link="flange"/>
    {_origin(origin.xyz_m, origin.rpy_rad)}
  </joint>"""


def _origin(xyz_m: Xyz, rpy_rad: Xyz = (0.0, 0.0, 0.0)) -> str:
    return f'<origin xyz="{numbers(xyz_m)}" rpy="{angles(rpy_rad)}"/>'
