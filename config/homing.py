"""The sections `homing` and `parking` of an arm file: how joints find their stops, and moves of the arm's own."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from config.section import NoBool, Section


class PoseMove(Section):
    """A move of all joints to a pose of the arm's own, from wherever it stands."""

    joints_deg: list[Annotated[float, NoBool]] = Field(
        min_length=1, description="Where each joint goes (degrees), in the order of joints."
    )
    speed_ratio: float = Field(default=0.25, gt=0, le=1, description="Share of the joints' velocity limits.")

    @property
    def target_rad(self) -> list[float]:
        """Where each joint goes."""
        return [math.radians(angle_deg) for angle_deg in self.joints_deg]


class ParkingConfig(PoseMove):
    """The move that an orderly end begins with, if the arm stands."""

    timeout_s: float = Field(default=60.0, ge=1, le=300, description="Longest that parking may take (s).")


class HomingConfig(Section):
    """The homing run: joints find their stops one after the other, by collision (sensorless)."""

    order: list[str] | None = Field(
        default=None,
        min_length=1,
        description="Joints in the order in which they are homed; left out, all in the order of joints. A joint that "
        "is not in it is only homed when it is named.",
    )
    timeout_s: float = Field(
        default=120.0, ge=1, le=3600, description="Longest homing run of one joint (s); drives are told so too."
    )
    then: PoseMove | None = Field(
        default=None,
        description="Where the arm goes once init_mode 0 has homed it, as soon as the ROS process is there; left out, "
        "it stays at its stops.",
    )
