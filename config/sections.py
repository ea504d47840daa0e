"""The sections of an arm file that stand by themselves: cycle, margins, trajectories, ROS process, scheduling."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from config.section import KEYS_BESIDE_CONTROLLERS, NoBool, Section, refuse, refuse_name

LOWEST_JOINT_STATES_HZ = 50.0
"""MoveIt asks for joint states at 50 Hz or more."""


class ControlConfig(Section):
    """The control cycle."""

    rate_hz: float = Field(
        ge=10, le=2000, description="Control cycles a second (Hz); the bus must be able to carry them."
    )
    init_mode: Annotated[Literal[0, 1], NoBool] = Field(
        default=1,
        description="What bring-up does: 1 adopts the pose the arm stands in, moving nothing; 0 runs homing.",
    )

    @property
    def period_ns(self) -> int:
        """Length of a control cycle in whole nanoseconds."""
        return round(1e9 / self.rate_hz)

    @property
    def report_period_ms(self) -> int:
        """Time between two position reports of a drive (ms): the first whole number longer than a cycle.

        Reports leave at the drive's own clock, so a cycle may have none of a drive, and none has two.
        """
        return self.period_ns // 1_000_000 + 1


class LimitsConfig(Section):
    """Margins and watchdogs of the control process."""

    velocity_margin: float = Field(
        default=1.05, ge=1, le=2, description="Accepted velocity as a multiple of the joint's limit."
    )
    acceleration_margin: float = Field(
        default=2.0,
        ge=1,
        le=5,
        description="Accepted acceleration, as setpoints a control cycle apart have it at any phase of the cycle and "
        "at any speed scale, as a multiple of the joint's limit.",
    )
    braking_factor: float = Field(
        default=1.5,
        ge=1,
        le=5,
        description="Acceleration that a person's stop, a fault or a lost process may use on the path, as a multiple "
        "of the joint's limit; cancels, holds and newer goals stay within the limit.",
    )
    silence_brake_factor: float = Field(
        default=1.75,
        ge=1.5,
        le=2.0,
        description="Braking of a drive that hears nothing more, as a multiple of the joint's acceleration "
        "limit; rounded to the nearest ramp the drive knows between 1.5 and 2.",
    )
    following_error_rad: float = Field(
        default=0.1,
        gt=0,
        le=1.0,
        description="Largest distance between commanded and measured position (rad); 1 rad is more than the softest "
        "joint sags under its load, and what holds a joint pushes with it until the fault.",
    )
    start_tolerance_rad: float = Field(
        default=0.05,
        gt=0,
        le=0.5,
        description="Largest distance between a goal's first point and the commanded position (rad), when it comes in "
        "or, with a start time, is due; the way onto the path was not planned, so no obstacle is known to it, and a "
        "goal that begins more than 0.5 rad away is not this arm's.",
    )
    stale_brake_s: float = Field(
        default=0.020,
        gt=0,
        le=1.0,
        description="Age of a measured position above which the arm brakes on its path (s); at least three "
        "reply periods are always allowed. For so long it moves without being seen: at most 1 s.",
    )
    stale_fault_s: float = Field(
        default=0.100,
        gt=0,
        le=5.0,
        description="Age of a measured position above which a fault is latched (s); at least four reply periods are "
        "always allowed. A drive that loses its power and gets it back takes a second or more: above 5 s that would "
        "go unnoticed.",
    )
    front_timeout_s: float = Field(
        default=0.5,
        gt=0,
        le=10.0,
        description="Silence of the ROS process, during a goal, after which the arm stops on its path (s); it "
        "stands still for 0.33 s at times, on a very busy machine for seconds. For so long no cancel reaches the arm.",
    )
    position_jump_rad: float = Field(
        default=0.05,
        gt=0,
        le=1.0,
        description="Jump of a measured position that means the drive lost its reference (rad); more than 1 rad "
        "would hide even what a motor without a gear loses.",
    )

    @model_validator(mode="after")
    def _ordered(self) -> LimitsConfig:
        if self.stale_fault_s <= self.stale_brake_s:
            raise refuse(
                "stale_fault_s",
                f"stale_fault_s is {self.stale_fault_s:g}, not above stale_brake_s {self.stale_brake_s:g}; a "
                "silent drive must be braked before it becomes a fault: raise stale_fault_s.",
            )
        if self.braking_factor > self.acceleration_margin:
            raise refuse(
                "braking_factor",
                f"braking_factor is {self.braking_factor:g}, above acceleration_margin "
                f"{self.acceleration_margin:g}, so the arm's own stop would be refused as too hard; lower "
                "braking_factor or raise acceleration_margin.",
            )
        return self


class TrajectoryConfig(Section):
    """How goals are interpolated and judged."""

    interpolation: Literal["spline", "linear"] = Field(
        default="spline",
        description="spline uses the points' velocities and accelerations; linear is the tutorial's way.",
    )
    interpolation_factor: int = Field(
        default=15, ge=1, le=1000, description="Points put between each two given ones (linear only)."
    )
    max_points: int = Field(default=200_000, ge=2, le=10_000_000, description="Most points a goal may have.")
    goal_tolerance_rad: float = Field(
        default=0.01, gt=0, le=1.0, description="Distance from the last point at which a goal has succeeded (rad)."
    )
    path_tolerance_rad: float = Field(
        default=0.1,
        gt=0,
        le=1.0,
        description="Distance from the path at which a goal is aborted (rad); limits.following_error_rad latches a "
        "fault besides.",
    )
    goal_time_s: float = Field(
        default=0.4,
        gt=0,
        le=60.0,
        description="Time after the last point within which the arm must have arrived (s).",
    )
    stopped_velocity_rad_s: float = Field(
        default=0.05, gt=0, le=1.0, description="Velocity below which a joint counts as standing (rad/s)."
    )
    allow_nonzero_end_velocity: bool = Field(
        default=False,
        description="true takes goals whose last point still moves, and brings them to rest at that point by slowing "
        "down on the path; false refuses them.",
    )
    strict_reject: bool = Field(
        default=False,
        description="true rejects a bad goal, which ROS can only do without a reason; false accepts it and "
        "aborts it at once with a sentence.",
    )


class FrontConfig(Section):
    """The ROS process."""

    controller_name: str = Field(
        default="episode_arm_controller",
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,62}$",
        description="Name of the ROS node, as in MoveIt's moveit_controllers.yaml: a letter, then letters, digits "
        "and _, at most 63.",
    )
    joint_states_hz: float | None = Field(
        default=None,
        ge=LOWEST_JOINT_STATES_HZ,
        le=2000,
        description="Rate of /joint_states (Hz): the control rate divided by a whole number, 50 or more; "
        "left out, it is the control rate.",
    )
    feedback_hz: float = Field(
        default=20.0, ge=0.1, le=200, description="Rate of the action's feedback (Hz); never above /joint_states."
    )
    frame_id: str = Field(default="base_link", description="Frame in the header of /joint_states.")
    discovery: Literal["localhost", "subnet"] = Field(
        default="localhost", description="How far ROS 2 discovery reaches: this machine, or its network."
    )

    @model_validator(mode="after")
    def _controller_name_is_a_name(self) -> FrontConfig:
        refuse_name("controller_name", self.controller_name, KEYS_BESIDE_CONTROLLERS)
        return self


class RealtimeConfig(Section):
    """Scheduling of the control process."""

    priority: int = Field(default=80, ge=1, le=90, description="SCHED_FIFO priority (1 to 90).")
    cpu: int | None = Field(
        default=None,
        ge=0,
        le=4095,
        description="CPU of the control cycle; other threads of both processes keep off it; left out, any.",
    )
    require: bool = Field(
        default=False,
        description="true refuses to run without real-time scheduling; false says so and goes on.",
    )
