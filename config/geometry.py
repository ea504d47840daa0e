"""The kinematics section of an arm file: its geometry as a table; `config.kinematics` computes with it."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from config.section import KEYS_BESIDE_GROUPS, NoBool, Section, refuse, refuse_name


class DhRow(Section):
    """One joint of the arm's geometry: a row of its standard Denavit–Hartenberg table."""

    d_mm: float = Field(default=0.0, ge=-10_000, le=10_000, description="Way along the joint's own axis (mm).")
    a_mm: float = Field(
        default=0.0, ge=-10_000, le=10_000, description="Way across, from the joint's axis to the next one (mm)."
    )
    alpha_deg: float = Field(
        default=0.0, ge=-360, le=360, description="Twist from the joint's axis to the next one (degrees)."
    )
    sign: Annotated[Literal[1, -1], NoBool] = Field(
        default=1, description="1 when a positive joint angle turns positively about the axis of the table, else -1."
    )
    offset_deg: float = Field(
        default=0.0,
        ge=-360,
        le=360,
        description="Angle of the table at joint angle 0 (degrees): table = sign * joint + offset_deg.",
    )
    radius_mm: float = Field(
        default=30.0,
        gt=0,
        le=1_000,
        description="Radius of the simple shapes that stand for the link behind this joint (mm); the first row's is "
        "also that of the base.",
    )

    @property
    def d_m(self) -> float:
        """Way along the joint's own axis (m)."""
        return self.d_mm / 1000.0

    @property
    def a_m(self) -> float:
        """Way across to the next axis (m)."""
        return self.a_mm / 1000.0

    @property
    def alpha_rad(self) -> float:
        """Twist to the next axis (rad)."""
        return math.radians(self.alpha_deg)

    @property
    def offset_rad(self) -> float:
        """Angle of the table at joint angle 0 (rad)."""
        return math.radians(self.offset_deg)

    @property
    def radius_m(self) -> float:
        """Radius of the link's simple shapes (m)."""
        return self.radius_mm / 1000.0


class KinematicsConfig(Section):
    """The arm's geometry, from which its MoveIt configuration is generated."""

    base_link: str = Field(
        default="base_link",
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,62}$",
        description="Root link of the robot model: a letter, then letters, digits and _.",
    )
    group: str = Field(
        default="arm",
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,62}$",
        description="MoveIt's planning group: a letter, then letters, digits and _.",
    )
    dh: list[DhRow] = Field(
        min_length=1, max_length=32, description="The standard Denavit–Hartenberg table, one row a joint."
    )

    @model_validator(mode="after")
    def _names_are_names(self) -> KinematicsConfig:
        refuse_name("base_link", self.base_link)
        refuse_name("group", self.group, KEYS_BESIDE_GROUPS)
        return self

    @model_validator(mode="after")
    def _base_has_a_name_of_its_own(self) -> KinematicsConfig:
        if self.base_link in {"world", "flange", *self.link_names}:
            raise refuse(
                "base_link",
                f"base_link is {self.base_link}, but world, flange and link1 to link{len(self.dh)} are names of other "
                "frames; choose another, such as base_link.",
            )
        return self

    @property
    def link_names(self) -> list[str]:
        """The moving links, in the order of the joints."""
        return [f"link{number}" for number in range(1, len(self.dh) + 1)]
