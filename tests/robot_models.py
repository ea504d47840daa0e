"""Arms of any geometry, and what other people's programs make of the robot model that is generated for them."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import xacro
import yaml
from hypothesis import strategies as st
from numpy.typing import NDArray

from config.geometry import KinematicsConfig
from config.schema import ArmConfig
from rtarm.moveit import package_files

Positions = NDArray[np.float64]


def geometry(arm: ArmConfig) -> KinematicsConfig:
    """Of an arm that has one."""
    assert arm.kinematics is not None
    return arm.kinematics


def files_of(arm: ArmConfig) -> dict[str, str]:
    """Every file of the arm's package."""
    return package_files(arm, geometry(arm))


def content(files: dict[str, str], name: str) -> Any:
    """A parameter file of the package as MoveIt's builder loads it."""
    return yaml.load(files[f"config/{name}.yaml"], Loader=yaml.FullLoader)


def robot_model(arm: ArmConfig, arguments: dict[str, str] | None = None) -> str:
    """The robot model as the real xacro makes it of the package's files alone, somewhere on the disk."""
    with tempfile.TemporaryDirectory() as folder:
        for path, text in files_of(arm).items():
            file = Path(folder, path)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        model = Path(folder, "config", f"{arm.name}.urdf.xacro")
        return str(xacro.process_file(str(model), mappings=arguments or {}).toxml())


class Pinocchio:
    """The generated robot model in pinocchio: an independent reader of robot models with kinematics of its own."""

    def __init__(self, arm: ArmConfig) -> None:
        urdf = robot_model(arm)
        self.model = pinocchio.buildModelFromXML(urdf)
        self.data = self.model.createData()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "model.urdf")
            file.write_text(urdf, encoding="utf-8")
            self.shapes = pinocchio.buildGeomFromUrdf(self.model, str(file), pinocchio.GeometryType.COLLISION)
        self.places = [self.model.idx_qs[self.model.getJointId(joint.name)] for joint in arm.joints]

    def configuration(self, positions_rad: Positions) -> Positions:
        """Joint angles in the arm's order as pinocchio wants them."""
        configuration = np.zeros(self.model.nq)
        configuration[self.places] = positions_rad
        return configuration

    def pose(self, link: str, positions_rad: Positions) -> Positions:
        """Pose (4, 4) of a link in the root link."""
        pinocchio.framesForwardKinematics(self.model, self.data, self.configuration(positions_rad))
        pose: Positions = self.data.oMf[self.model.getFrameId(link)].homogeneous
        return pose

    def jacobian(self, link: str, positions_rad: Positions) -> Positions:
        """(6, joints) of a link's origin: velocity, then turning, in the axes of the root link."""
        frame, axes = self.model.getFrameId(link), pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        configuration = self.configuration(positions_rad)
        jacobian: Positions = pinocchio.computeFrameJacobian(self.model, self.data, configuration, frame, axes)
        return jacobian[:, self.places]

    def colliding(self, positions_rad: Positions) -> set[frozenset[str]]:
        """The pairs of links whose shapes touch in a pose, as coal says."""
        if len(self.shapes.collisionPairs) == 0:
            self.shapes.addAllCollisionPairs()
        found = self.shapes.createData()
        configuration = self.configuration(positions_rad)
        pinocchio.computeCollisions(self.model, self.data, self.shapes, found, configuration, False)
        return {
            frozenset(self._link_of(number) for number in (pair.first, pair.second))
            for pair, result in zip(self.shapes.collisionPairs, found.collisionResults, strict=True)
            if result.isCollision()
        }

    def _link_of(self, shape: int) -> str:
        return str(self.model.frames[self.shapes.geometryObjects[shape].parentFrame].name)


def arm_of(rows: list[dict[str, Any]], joints: list[dict[str, Any]] | None = None, **kinematics: Any) -> ArmConfig:
    """A mock arm of this geometry; joints move 180° either way unless they say something else."""
    common = {"drive": {"family": "mock"}, "ratio": 10.0, "lower_deg": -180.0, "upper_deg": 180.0}
    common |= {"motor_rpm": 100.0, "max_acceleration_rad_s2": 2.0}
    own = joints or [{}] * len(rows)
    return ArmConfig.model_validate(
        {
            "name": "any_arm",
            "control": {"rate_hz": 100.0},
            "bus": {"interface": "mock"},
            "joints": [common | {"name": f"j{number}"} | joint for number, joint in enumerate(own)],
            "kinematics": {"dh": rows, **kinematics},
        }
    )


ways_mm = st.one_of(st.just(0.0), st.floats(-400.0, 400.0).map(lambda way: round(way, 1)))
turns_deg = st.one_of(st.sampled_from([0.0, 90.0, -90.0, 180.0]), st.floats(-180.0, 180.0))


@st.composite
def arms(draw: st.DrawFn, most_joints: int = 7) -> ArmConfig:
    """Arms with any table and any limits."""
    count = draw(st.integers(1, most_joints))
    rows = [
        {
            "d_mm": draw(ways_mm),
            "a_mm": draw(ways_mm),
            "alpha_deg": draw(turns_deg),
            "sign": draw(st.sampled_from([1, -1])),
            "offset_deg": draw(turns_deg),
            "radius_mm": draw(st.floats(5.0, 60.0)),
        }
        for _ in range(count)
    ]
    joints = []
    for _ in range(count):
        lower = draw(st.floats(-200.0, 150.0))
        ratio, motor_rpm = draw(st.floats(0.5, 200.0)), draw(st.floats(1.0, 3000.0))
        velocity_rad_s = motor_rpm / ratio * math.pi / 30.0
        joints.append(
            {
                "lower_deg": lower,
                "upper_deg": lower + draw(st.floats(1.0, 300.0)),
                "ratio": ratio,
                "motor_rpm": motor_rpm,
                "max_acceleration_rad_s2": max(velocity_rad_s / draw(st.floats(0.01, 10.0)), 1e-4),
            }
        )
    return arm_of(rows, joints)
