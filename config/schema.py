"""The schema of an arm file: one frozen model a section, every field with its unit and its bounds.

The reference documentation is generated from the descriptions here, and the loader builds its sentences
from the bounds, so a field is declared once. Degrees and rpm occur because people think in them; every
model offers what the program uses (radians, rad/s, pulses per radian) as properties.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    field_serializer,
    model_validator,
)

from config.bus import BusConfig
from config.buses import MOST_BUSES, as_list, bus_number, check_buses, check_places
from config.drives.together import check_adapter, check_drives
from config.errors import did_you_mean
from config.geometry import KinematicsConfig
from config.gripper import GROUP, LINK, GripperConfig, GripperServo
from config.homing import HomingConfig, ParkingConfig
from config.joint import JointConfig
from config.section import NoBool, Section, ordinal, refuse
from config.sections import (
    LOWEST_JOINT_STATES_HZ,
    ControlConfig,
    FrontConfig,
    LimitsConfig,
    RealtimeConfig,
    TrajectoryConfig,
)
from config.stopping import LONGEST_ALLOWED_S, Patience, longest_stop_s

FIXED_JOINTS = ("virtual_joint", "flange_joint")
"""Joints that the generated robot model has besides the arm's own."""


@dataclass(frozen=True)
class Source:
    """Where an arm was read from, so that later checks can still name the line."""

    file: str
    lines: Mapping[str, int]
    """Line of every field that stands in the file, by its location (`joints[2].ratio`)."""
    overridden: frozenset[str]
    """Locations whose value came from an override."""
    built_in: bool = False
    """Whether the file is one of those that come with rtarm."""
    argument: str = ""
    """What a person names this file by: the name of an arm that comes with rtarm, else its absolute path."""
    file_hash: int = 0
    """Of the file's text."""


class ArmConfig(Section):
    """An arm: everything rtarm knows about it."""

    schema_version: Annotated[Literal[1], NoBool] = Field(default=1, description="Version of this file's format.")
    name: str = Field(
        pattern=r"^[a-z][a-z0-9_]{0,31}$",
        description="Name of the arm: small letters, digits and _, at most 32; also names its shared memory.",
    )
    description: str = Field(default="", description="One line for people.")
    control: ControlConfig = Field(description="The control cycle.")
    buses: Annotated[list[BusConfig], BeforeValidator(as_list)] = Field(
        alias="bus",
        description=f"The CAN bus and its adapter; with several, a list of up to {MOST_BUSES}, and each joint names "
        "its own.",
    )
    joints: list[JointConfig] = Field(
        min_length=1, max_length=32, description="The joints, in the order of /joint_states."
    )
    limits: LimitsConfig = Field(
        default_factory=LimitsConfig, description="Margins and watchdogs of the control process."
    )
    homing: HomingConfig = Field(default_factory=HomingConfig, description="The homing run.")
    parking: ParkingConfig | None = Field(
        default=None, description="Where the arm goes before an orderly end; left out, it holds where it stands."
    )
    trajectory: TrajectoryConfig = Field(
        default_factory=TrajectoryConfig, description="How goals are interpolated and judged."
    )
    front: FrontConfig = Field(default_factory=FrontConfig, description="The ROS process.")
    realtime: RealtimeConfig = Field(default_factory=RealtimeConfig, description="Scheduling of the control process.")
    kinematics: KinematicsConfig | None = Field(
        default=None, description="The arm's geometry; only `rtarm moveit-config` needs it."
    )
    gripper: GripperConfig | None = Field(default=None, description="The gripper; left out, there is none.")

    _source: Source | None = PrivateAttr(default=None)

    @field_serializer("buses", mode="wrap")
    def _as_in_a_file(self, buses: list[BusConfig], write: SerializerFunctionWrapHandler) -> Any:
        written = write(buses)
        return written[0] if len(written) == 1 else written

    @property
    def source(self) -> Source | None:
        """Where the arm was read from; None for an arm built in memory."""
        return self._source

    @property
    def file_argument(self) -> str:
        """What a person names the arm's file by; "" where it has none, or where an option gave the arm its name."""
        return "" if self._source is None or "name" in self._source.overridden else self._source.argument

    @property
    def has_options(self) -> bool:
        """Whether options changed what its file says."""
        return self._source is not None and bool(self._source.overridden)

    @property
    def bus(self) -> BusConfig:
        """The bus; of several the first, for what they agree on (`config.buses.ALIKE`)."""
        return self.buses[0]

    def bus_number(self, drive: JointConfig | GripperServo) -> int:
        """The number of the bus that a joint's drive, or the gripper's, is on."""
        return bus_number(self.buses, drive.bus)

    def bus_of(self, drive: JointConfig | GripperServo) -> BusConfig:
        """The bus that a joint's drive, or the gripper's, is on."""
        return self.buses[self.bus_number(drive)]

    @property
    def bus_names(self) -> tuple[str, ...]:
        """Names of the buses for sentences, which name none where there is only one."""
        return tuple(bus.name or "" for bus in self.buses) if len(self.buses) > 1 else ()

    @property
    def parts(self) -> list[ArmConfig]:
        """The arm bus by bus: each as an arm of that bus alone, with the drives that are on it."""
        return [self] if len(self.buses) == 1 else [self._part(number) for number in range(len(self.buses))]

    def _part(self, number: int) -> ArmConfig:
        gripper = self.gripper
        if gripper is not None and (gripper.servo is None or self.bus_number(gripper.servo) != number):
            gripper = None
        joints = [joint for joint in self.joints if self.bus_number(joint) == number]
        return self.model_copy(update={"buses": [self.buses[number]], "joints": joints, "gripper": gripper})

    def part_of(self, joint: int) -> tuple[ArmConfig, int]:
        """The part (`parts`) with a joint's bus, and the joint's number there."""
        number = self.bus_number(self.joints[joint])
        before = [number == self.bus_number(other) for other in self.joints[:joint]]
        return self if len(self.buses) == 1 else self._part(number), sum(before)

    def on_every_bus(self, **settings: object) -> ArmConfig:
        """The same arm with settings of its buses changed; they are not checked."""
        return self.model_copy(update={"buses": [bus.model_copy(update=settings) for bus in self.buses]})

    @property
    def joint_states_every_cycles(self) -> int:
        """Joint states are published after every n-th control cycle; this is n."""
        wanted_hz = self.front.joint_states_hz
        return 1 if wanted_hz is None else max(1, round(self.control.rate_hz / wanted_hz))

    @property
    def longest_stop_s(self) -> float:
        """Duration within which every stop ends, whatever the arm is doing (s)."""
        slowest_s = max(joint.slowness_s for joint in self.joints)
        return longest_stop_s(slowest_s)

    @property
    def patience(self) -> Patience:
        """How long to wait for the arm to stop."""
        return Patience(self.longest_stop_s)

    @model_validator(mode="after")
    def _joints_are_distinct(self) -> ArmConfig:
        first_with_name: dict[str, int] = {}
        for index, joint in enumerate(self.joints):
            if joint.name in first_with_name:
                raise refuse(
                    f"joints[{index}].name",
                    f"name {joint.name} is used by the {ordinal(first_with_name[joint.name])} and the {ordinal(index)} "
                    "joint; every joint needs a name of its own: rename one.",
                )
            first_with_name[joint.name] = index
        return self

    @model_validator(mode="after")
    def _buses_go_together(self) -> ArmConfig:
        check_buses(self.buses)
        servo = None if self.gripper is None else self.gripper.servo
        check_places(self.buses, self.joints, servo)
        return self

    @model_validator(mode="after")
    def _drives_go_together(self) -> ArmConfig:
        numbers = [self.bus_number(joint) for joint in self.joints]
        check_drives(self.joints, numbers, self.bus, self.limits, self.control.rate_hz)
        return self

    @model_validator(mode="after")
    def _gripper_is_beside_the_joints(self) -> ArmConfig:
        gripper = self.gripper
        if gripper is None:
            return self
        if gripper.joint in {*FIXED_JOINTS, *(joint.name for joint in self.joints)}:
            raise refuse(
                "gripper.joint",
                f"joint is {gripper.joint}, which is a joint of the arm already; give the gripper's another name.",
            )
        if gripper.controller_name == self.front.controller_name:
            raise refuse(
                "gripper.controller_name",
                f"controller_name is {gripper.controller_name}, which is that of the arm's own controller; give the "
                "gripper's another name.",
            )
        if self.kinematics is not None and self.kinematics.group == GROUP:
            raise refuse("kinematics.group", f"group is {GROUP}, which is that of the gripper; choose another name.")
        if self.kinematics is not None and self.kinematics.base_link == LINK:
            raise refuse("kinematics.base_link", f"base_link is {LINK}, which is the gripper's; choose another name.")
        if gripper.servo is None:
            return self
        if self.bus.interface == "mock":
            raise refuse(
                "gripper.hook",
                "hook is servo, but interface mock reaches no drive; set hook to simulated, or bus.interface to slcan "
                "or socketcan.",
            )
        for joint in self.joints:
            if self.bus_number(joint) == self.bus_number(gripper.servo) and any(
                mine.meets(theirs) for mine in gripper.servo.identifiers for theirs in joint.drive.identifiers
            ):
                raise refuse(
                    "gripper.servo.address",
                    f"address {gripper.servo.address} is used by {joint.name} and the gripper; every drive on the bus "
                    "needs an address of its own: change one, in its menu and here.",
                )
        return self

    @model_validator(mode="after")
    def _adapter_carries_what_drives_say(self) -> ArmConfig:
        for part in self.parts:
            servo = None if part.gripper is None else part.gripper.servo
            check_adapter(part.joints, part.bus, () if servo is None else servo.identifiers)
        return self

    @model_validator(mode="after")
    def _homing_order_names_joints(self) -> ArmConfig:
        names = [joint.name for joint in self.joints]
        for index, name in enumerate(self.homing.order or ()):
            if name not in names:
                raise refuse(
                    f"homing.order[{index}]",
                    f"order names {name}, which is no joint of the arm{did_you_mean(name, names)}; its joints are "
                    f"{', '.join(names)}.",
                )
            if name in (self.homing.order or ())[:index]:
                raise refuse(f"homing.order[{index}]", f"order names {name} twice; a joint is homed once: remove one.")
        return self

    @model_validator(mode="after")
    def _poses_are_of_this_arm(self) -> ArmConfig:
        for field, move in (("homing.then", self.homing.then), ("parking", self.parking)):
            if move is None:
                continue
            if len(move.joints_deg) != len(self.joints):
                raise refuse(
                    f"{field}.joints_deg",
                    f"joints_deg has {len(move.joints_deg)} angles, but the arm has {len(self.joints)} joints; give "
                    "one a joint, in the same order.",
                )
            for index, (joint, angle_deg) in enumerate(zip(self.joints, move.joints_deg, strict=True)):
                if not joint.lower_deg <= angle_deg <= joint.upper_deg:
                    raise refuse(
                        f"{field}.joints_deg[{index}]",
                        f"joints_deg[{index}] is {angle_deg:g}, but {joint.name} goes from {joint.lower_deg:g} to "
                        f"{joint.upper_deg:g} degrees; give an angle in between.",
                    )
        return self

    @property
    def homing_order(self) -> list[int]:
        """Indexes of the joints that a homing run of the arm homes, in its order."""
        names = [joint.name for joint in self.joints]
        return list(range(len(names))) if self.homing.order is None else [names.index(n) for n in self.homing.order]

    @model_validator(mode="after")
    def _kinematics_fit_the_joints(self) -> ArmConfig:
        if self.kinematics is None:
            return self
        if len(self.kinematics.dh) != len(self.joints):
            raise refuse(
                "kinematics.dh",
                f"dh has {len(self.kinematics.dh)} rows, but the arm has {len(self.joints)} joints; give one row a "
                "joint, in the same order.",
            )
        for index, joint in enumerate(self.joints):
            if joint.name in FIXED_JOINTS:
                raise refuse(
                    f"joints[{index}].name",
                    f"name of the {ordinal(index)} joint is {joint.name}, which the robot model calls a fixed joint of "
                    "its own; choose another, or remove the section kinematics.",
                )
        return self

    @model_validator(mode="after")
    def _joint_states_follow_the_cycle(self) -> ArmConfig:
        wanted_hz = self.front.joint_states_hz
        if wanted_hz is None:
            return self
        rate_hz = self.control.rate_hz
        if rate_hz < LOWEST_JOINT_STATES_HZ:
            sentence = (
                f"joint_states_hz is {wanted_hz:g}, above control.rate_hz {rate_hz:g}; states are measured "
                "once a cycle: remove joint_states_hz or raise control.rate_hz."
            )
            raise refuse("front.joint_states_hz", sentence)
        if not math.isclose(rate_hz, self.joint_states_every_cycles * wanted_hz, rel_tol=1e-6):
            choices = sorted(
                {
                    rate_hz / every
                    for every in (math.floor(rate_hz / wanted_hz), math.ceil(rate_hz / wanted_hz))
                    if every >= 1 and rate_hz / every >= LOWEST_JOINT_STATES_HZ
                }
            )
            raise refuse(
                "front.joint_states_hz",
                f"joint_states_hz is {wanted_hz:g}, but states are published after every n-th of "
                f"{rate_hz:g} control cycles a second, so the nearest possible is "
                f"{' or '.join(f'{choice:.9g}' for choice in choices)}: choose one, or "
                "remove joint_states_hz.",
            )
        return self

    @model_validator(mode="after")
    def _stops_soon_enough(self) -> ArmConfig:
        for index, joint in enumerate(self.joints):
            takes_s = longest_stop_s(joint.slowness_s)
            if takes_s > LONGEST_ALLOWED_S:
                least = joint.max_acceleration_rad_s2 * takes_s / LONGEST_ALLOWED_S
                raise refuse(
                    f"joints[{index}].max_acceleration_rad_s2",
                    f"max_acceleration_rad_s2 of {joint.name} is {joint.max_acceleration_rad_s2:g}, so that a stop "
                    f"from its {joint.max_velocity_rad_s:.4g} rad/s on a bent path may take {takes_s:.1f} s, and at "
                    f"most {LONGEST_ALLOWED_S:g} s are allowed; raise it above {least:.4g} if the joint can brake so "
                    "hard, or lower its motor_rpm.",
                )
        return self
