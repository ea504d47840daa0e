"""What stands in space: the arm where it is measured, a ghost where it is commanded, a wish, and the goal's path.

Links and joints are those of the robot model that `rtarm.moveit.robot` writes (its URDF), made from the same
functions: each joint is a node at its origin that turns about its own z, so a moved arm is one message a joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from config.geometry import KinematicsConfig
from config.kinematics import Origin, flange_origin, flange_pose, joint_origins, matrix
from config.schema import ArmConfig
from rtarm.moveit.robot import MATERIALS
from rtarm.moveit.shapes import Link, gripper_shape, link_shapes

if TYPE_CHECKING:
    import trimesh
    import viser

Colour = tuple[int, int, int]
Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""


def _colour(material: str) -> Colour:
    red, green, blue, _ = (round(255 * part) for part in MATERIALS[material])
    return red, green, blue


LIGHT, DARK, MARK = _colour("light"), _colour("dark"), _colour("mark")
NEAR, BROKEN = (230, 160, 0), (215, 40, 40)
"""A link whose joint is near a limit, and one that the fault names."""
GHOST, WISH, PATH = (40, 120, 220), (20, 160, 90), (40, 120, 220)
GHOST_OPACITY = 0.3
SLIMMER_M = 0.0004
"""Every other link is so much thinner: two surfaces in one place would flicker."""
SWOLLEN_M = 0.004
"""A ghost is so much thicker than the arm, and so is seen around it while both are in one place."""
SHOWN_APART_RAD = 0.002
"""Nearer to the arm a ghost says nothing, unless a goal runs."""
MOVED_RAD = 1e-5
"""Smaller changes are not worth a message."""


def quaternion(origin: Origin, angle_rad: float = 0.0) -> Quaternion:
    """The turn of an origin, and then about its z."""
    roll, pitch, yaw = (angle / 2.0 for angle in origin.rpy_rad)
    turns = [(np.cos(half), *(np.sin(half) * np.eye(3)[axis])) for half, axis in ((yaw, 2), (pitch, 1), (roll, 0))]
    turns.append((np.cos(angle_rad / 2.0), 0.0, 0.0, np.sin(angle_rad / 2.0)))
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    for a, b, c, d in turns:
        w, x, y, z = (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )
    return float(w), float(x), float(y), float(z)


def body(link: Link, swollen_m: float = 0.0) -> trimesh.Trimesh:
    """The shapes of a link in its frame (m), as its robot model has them: cylinders, and balls at their ends."""
    import trimesh

    radius_m = link.radius_m + swollen_m
    parts = []
    for bone in link.bones:
        if bone.length_m > 0.0:
            cylinder: trimesh.Trimesh = trimesh.creation.cylinder(radius=radius_m, height=bone.length_m, sections=48)
            cylinder.apply_transform(matrix(Origin(bone.middle_m, bone.rpy_rad)))
            parts.append(cylinder)
    for end_m in link.ends_m:
        ball: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_m)
        ball.apply_translation(end_m)
        parts.append(ball)
    whole = trimesh.util.concatenate(parts)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def nose(link: Link) -> trimesh.Trimesh:
    """The mark towards x that lets the last link's turn be seen."""
    import trimesh

    box: trimesh.Trimesh = trimesh.creation.box((link.radius_m, link.radius_m / 4.0, link.radius_m / 4.0))
    x, y, z = link.bones[-1].end_m
    box.apply_translation((x + link.radius_m, y, z))
    return box


def reach_m(kinematics: KinematicsConfig) -> float:
    """How far the arm can get at the most (m)."""
    return sum(abs(row.a_m) + abs(row.d_m) for row in kinematics.dh)


@dataclass(frozen=True)
class _Look:
    """How an arm is drawn: one colour and an opacity, or (None) as it is."""

    colour: Colour | None = None
    opacity: float | None = None


SOLID, SHADE, WISHED = _Look(), _Look(GHOST, GHOST_OPACITY), _Look(WISH, GHOST_OPACITY)


class Figure:
    """One arm in the scene, which takes joint angles."""

    def __init__(self, server: viser.ViserServer, arm: ArmConfig, kinematics: KinematicsConfig, name: str, look: _Look):
        self._origins = joint_origins(kinematics)
        self._signs = [row.sign for row in kinematics.dh]
        self._root = server.scene.add_frame(f"/{name}", show_axes=False, visible=look is SOLID)
        self._shown = look is SOLID
        self._joints: list[viser.FrameHandle] = []
        self._bodies: list[viser.MeshHandle] = []
        self._colours: list[Colour] = []
        self._at = np.full(len(self._origins), np.nan)
        self._gripper: viser.FrameHandle | None = None
        links = link_shapes(kinematics)
        path = f"/{name}"
        for number, link in enumerate(links):
            if number:
                origin = self._origins[number - 1]
                path += f"/joint{number}"
                node = server.scene.add_frame(path, show_axes=False, position=origin.xyz_m, wxyz=quaternion(origin))
                self._joints.append(node)
            self._add(server, path, link, look, DARK if number % 2 == 0 else LIGHT, marked=link is links[-1])
        if arm.gripper is not None:
            flange = flange_origin(kinematics) or Origin()
            server.scene.add_frame(f"{path}/flange", show_axes=False, position=flange.xyz_m, wxyz=quaternion(flange))
            self._gripper = server.scene.add_frame(f"{path}/flange/gripper", show_axes=False)
            self._add(server, f"{path}/flange/gripper", gripper_shape(arm.gripper), look, DARK, marked=True)

    def _add(
        self, server: viser.ViserServer, path: str, link: Link, look: _Look, colour: Colour, *, marked: bool
    ) -> None:
        slimmer_m = SLIMMER_M * (len(self._bodies) % 2)
        mesh = body(link, -slimmer_m if look is SOLID else SWOLLEN_M - slimmer_m)
        self._colours.append(look.colour or colour)
        self._bodies.append(
            server.scene.add_mesh_simple(
                f"{path}/body",
                mesh.vertices,
                mesh.faces,
                color=self._colours[-1],
                opacity=look.opacity,
                cast_shadow=look is SOLID,
                receive_shadow=False,
            )
        )
        if marked and look is SOLID:
            mark = nose(link)
            server.scene.add_mesh_simple(f"{path}/mark", mark.vertices, mark.faces, color=MARK, flat_shading=True)

    def move(self, positions_rad: np.ndarray) -> None:
        """Stand at these joint angles; one that is not known stays where it was last, 0 at first."""
        moved = np.isfinite(positions_rad) & ~(np.abs(positions_rad - self._at) < MOVED_RAD)
        for index in np.flatnonzero(moved):
            self._joints[index].wxyz = quaternion(
                self._origins[index], self._signs[index] * float(positions_rad[index])
            )
            self._at[index] = positions_rad[index]

    def grip(self, angle_rad: float) -> None:
        """Turn the gripper's joint, as its robot model has it."""
        if self._gripper is not None:
            self._gripper.wxyz = quaternion(Origin(), angle_rad)

    def show(self, shown: bool) -> None:
        """Be seen, or not."""
        if shown != self._shown:
            self._root.visible = self._shown = shown

    def paint(self, marks: Sequence[Colour | None]) -> None:
        """Give the link behind each joint a colour, None for its own."""
        for index, mark in enumerate(marks, start=1):
            colour = mark or self._colours[index]
            if tuple(self._bodies[index].color) != colour:
                self._bodies[index].color = colour


class Scene:
    """The arm, its ghost, the wish, the path and the ground, for an arm whose geometry is known."""

    def __init__(self, server: viser.ViserServer, arm: ArmConfig, kinematics: KinematicsConfig) -> None:
        self._server = server
        self._kinematics = kinematics
        self._path: viser.LineSegmentsHandle | None = None
        self._drawn = np.zeros((0, len(arm.joints)))
        reach = reach_m(kinematics)
        cell = 0.1 if reach < 2.0 else 0.5
        server.scene.add_grid(
            "/ground",
            infinite_grid=True,
            cell_size=cell,
            section_size=5 * cell,
            cell_color=(226, 230, 235),
            section_color=(196, 203, 212),
            fade_distance=10.0 * reach,
            shadow_opacity=0.15,
        )
        server.scene.add_frame("/base", axes_length=0.25 * reach, axes_radius=0.005 * reach)
        server.initial_camera.look_at = (0.15 * reach, 0.0, 0.33 * reach)
        server.initial_camera.position = (0.75 * reach, -1.05 * reach, 0.75 * reach)
        self.measured = Figure(server, arm, kinematics, "measured", SOLID)
        self.commanded = Figure(server, arm, kinematics, "commanded", SHADE)
        self.wished = Figure(server, arm, kinematics, "wished", WISHED)

    def show_path(self, positions_rad: np.ndarray) -> None:
        """Draw the flange's way along joint angles (n, joints); none where there are fewer than two."""
        if positions_rad is self._drawn or np.array_equal(positions_rad, self._drawn):
            return
        self._drawn = positions_rad
        if self._path is not None:
            self._path.remove()
            self._path = None
        if len(positions_rad) >= 2:
            points = flange_pose(self._kinematics, positions_rad)[:, :3, 3]
            segments = np.stack([points[:-1], points[1:]], axis=1)
            self._path = self._server.scene.add_line_segments(
                "/path", segments, PATH, thickness=3.0, thickness_units="screen"
            )
