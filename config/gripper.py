"""The gripper's section of an arm file: one joint that opens and closes, and the hook that moves it."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from config import ramp
from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION, FULL_STEPS_PER_REVOLUTION, zdt_identifiers
from config.frames import Identifiers
from config.section import KEYS_BESIDE_CONTROLLERS, NoBool, Section, refuse, refuse_name

SIMULATED, SERVO = "simulated", "servo"
"""Hooks that come with rtarm; any other is a class in a Python file."""
OWN_HOOK = re.compile(r"(?P<file>.+\.py):(?P<name>[A-Za-z_][A-Za-z0-9_]*)")

GROUP = "gripper"
"""MoveIt's planning group of the gripper's joint, and the name of its end effector."""
LINK = "gripper_link"
"""The link that stands for the gripper in the robot model."""

FULL_SPEED_AFTER_S = 0.25
"""A servo's ramp is the gentlest that reaches its speed within this time, where its drive has one."""
MOST_MOTOR_RPM = 3000
HIGHEST_UNLIMITED_MA = 6000

MOVING_POLL_HZ = 20.0
RESTING_POLL_HZ = 5.0
"""How often a servo on the bus is asked where it is."""


class GripperServo(Section):
    """A ZDT closed-loop stepper with Emm_V5 firmware on the arm's own bus, which opens and closes a gripper."""

    family: ClassVar[str] = "zdt"
    address: int = Field(ge=1, le=255, description="Address set in the drive's menu (1 to 255), none of the joints'.")
    microsteps: int = Field(
        default=16, ge=1, le=256, description="Microsteps a full step as set in the drive (200 full steps a turn)."
    )
    ratio: float = Field(
        default=1.0, ge=1e-3, le=1e6, description="Gear ratio: motor turns for one turn of the gripper's joint."
    )
    direction: Annotated[Literal[1, -1], NoBool] = Field(
        default=1, description="1 when a positive motor angle opens the gripper, else -1."
    )
    zero_deg: float = Field(
        default=0.0,
        ge=-36_000,
        le=36_000,
        description="Offset of the joint zero (degrees): joint = direction * m - zero_deg, where m is the motor's "
        "turns * 360 / ratio, counted from its homing stop.",
    )
    nm_per_ampere: float | None = Field(
        default=None,
        gt=0,
        le=1e3,
        description="Torque at the gripper's joint for one ampere of motor current (N·m/A); with it a goal's effort "
        "limits the current and effort is measured. Left out, a goal's effort is not obeyed and measured effort is "
        "NaN.",
    )

    bus: str | None = Field(
        default=None, description="Name of the bus that it is on; needed where the arm has several."
    )

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """What it hears and says on the bus."""
        return zdt_identifiers(self.address)

    @property
    def pulses_per_rad(self) -> float:
        """Pulses of a position command for one radian of the joint, signed."""
        return self.direction * self.microsteps * FULL_STEPS_PER_REVOLUTION * self.ratio / (2.0 * math.pi)

    @property
    def counts_per_rad(self) -> float:
        """Counts of a reported position for one radian of the joint, signed."""
        return self.direction * ENCODER_COUNTS_PER_REVOLUTION * self.ratio / (2.0 * math.pi)

    @property
    def zero_rad(self) -> float:
        """Offset of the joint zero (rad); see `zero_deg`."""
        return math.radians(self.zero_deg)


class GripperConfig(Section):
    """A gripper: one joint from closed to open, moved through a hook."""

    hook: str = Field(
        pattern=r"^(simulated|servo|.+\.py:[A-Za-z_][A-Za-z0-9_]*)$",
        description="What moves the gripper: simulated is none at all, servo a ZDT drive on the arm's bus, and "
        "my_gripper.py:MyGripper a class of your own (docs/hardware/gripper.md), its file beside the arm file.",
    )
    joint: str = Field(
        default="gripper_joint",
        pattern=r"^[A-Za-z_][A-Za-z0-9_./-]{0,62}$",
        description="Name of its joint, exactly as in the URDF: a letter or _, then letters, digits, _, ., / and -, at "
        "most 63.",
    )
    controller_name: str = Field(
        default="gripper_controller",
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,62}$",
        description="First part of its actions' names, as in MoveIt's moveit_controllers.yaml: a letter, then letters, "
        "digits and _, at most 63.",
    )
    lower_deg: float = Field(default=0.0, ge=-360, le=360, description="Lowest angle (degrees).")
    upper_deg: float = Field(default=110.0, ge=-360, le=360, description="Highest angle (degrees).")
    closed_deg: float | None = Field(
        default=None, description="Angle to which `on` closes it (degrees); left out, lower_deg."
    )
    open_deg: float | None = Field(
        default=None, description="Angle to which `off` opens it (degrees); left out, upper_deg."
    )
    speed_deg_s: float = Field(default=110.0, ge=0.1, le=10_000, description="Speed of its motions (degrees/s).")
    tolerance_deg: float = Field(
        default=1.0, gt=0, le=90, description="Distance from its target at which a motion has reached it (degrees)."
    )
    stall_time_s: float = Field(
        default=0.5,
        ge=0.1,
        le=10,
        description="Standing still for so long before its target means that it has gripped something (s).",
    )
    length_mm: float = Field(
        default=80.0,
        gt=0,
        le=1_000,
        description="How far it stands out from the flange (mm), for MoveIt's collision checks.",
    )
    radius_mm: float = Field(
        default=30.0,
        gt=0,
        le=1_000,
        description="Radius of the cylinder in which it stays however it opens (mm), for MoveIt's collision checks.",
    )
    servo: GripperServo | None = Field(default=None, description="The drive on the bus, with hook servo only.")
    options: dict[str, Any] = Field(
        default_factory=dict,
        description="What a hook of your own wants to know; of the simulated one, object_deg: a thing between the "
        "fingers stops them there when they close.",
    )

    @model_validator(mode="after")
    def _names_are_names(self) -> GripperConfig:
        refuse_name("joint", self.joint)
        refuse_name("controller_name", self.controller_name, KEYS_BESIDE_CONTROLLERS)
        return self

    @model_validator(mode="after")
    def _angles_make_a_range(self) -> GripperConfig:
        if self.lower_deg >= self.upper_deg:
            raise refuse(
                "lower_deg",
                f"lower_deg is {self.lower_deg:g}, not below upper_deg {self.upper_deg:g}, which leaves the gripper no "
                "room to move; enter the range it really has.",
            )
        for field, angle in (("closed_deg", self.closed_deg), ("open_deg", self.open_deg)):
            if angle is not None and not self.lower_deg <= angle <= self.upper_deg:
                raise refuse(
                    field,
                    f"{field} is {angle:g}, but the gripper goes from {self.lower_deg:g} to {self.upper_deg:g} "
                    "degrees; choose an angle in between, or widen lower_deg and upper_deg.",
                )
        if self.closed_rad == self.open_rad:
            raise refuse(
                "closed_deg",
                f"closed_deg and open_deg are both {math.degrees(self.closed_rad):g}; closed and open must differ: "
                "correct one.",
            )
        return self

    @model_validator(mode="after")
    def _servo_is_there_when_it_is_named(self) -> GripperConfig:
        if self.hook == SERVO and self.servo is None:
            raise refuse(
                "hook",
                "hook is servo, but nothing says which drive that is; add servo with at least its address, such as "
                "servo: {address: 7}.",
            )
        if self.servo is not None and self.hook != SERVO:
            raise refuse(
                "servo",
                f"servo describes a drive, but hook is {self.hook}, which needs none; remove servo, or set hook to "
                "servo.",
            )
        if self.servo is not None and self.motor_rpm > MOST_MOTOR_RPM:
            raise refuse(
                "speed_deg_s",
                f"speed_deg_s is {self.speed_deg_s:g}, for which the motor would have to turn at {self.motor_rpm} rpm, "
                f"and {MOST_MOTOR_RPM} are allowed; lower speed_deg_s.",
            )
        return self

    @property
    def lower_rad(self) -> float:
        """Lowest angle (rad)."""
        return math.radians(self.lower_deg)

    @property
    def upper_rad(self) -> float:
        """Highest angle (rad)."""
        return math.radians(self.upper_deg)

    @property
    def closed_rad(self) -> float:
        """Where `on` closes it (rad)."""
        return math.radians(self.lower_deg if self.closed_deg is None else self.closed_deg)

    @property
    def open_rad(self) -> float:
        """Where `off` opens it (rad)."""
        return math.radians(self.upper_deg if self.open_deg is None else self.open_deg)

    @property
    def speed_rad_s(self) -> float:
        """Speed of its motions (rad/s)."""
        return math.radians(self.speed_deg_s)

    @property
    def acceleration_rad_s2(self) -> float:
        """Acceleration with which that speed is reached (rad/s²)."""
        return self.speed_rad_s / FULL_SPEED_AFTER_S

    @property
    def tolerance_rad(self) -> float:
        """Distance from its target at which a motion has reached it (rad)."""
        return math.radians(self.tolerance_deg)

    @property
    def motor_rpm(self) -> int:
        """Speed field of the servo's position command (rpm): the nearest whole number, 1 at the least."""
        assert self.servo is not None
        return max(1, round(self.speed_deg_s / 6.0 * self.servo.ratio))

    @property
    def acc_byte(self) -> int:
        """Ramp of the servo's position command; the hardest where none reaches the speed in time."""
        assert self.servo is not None
        return ramp.smallest_acc_byte(self.servo.ratio, self.acceleration_rad_s2) or max(ramp.ACC_BYTES)
