"""Why a goal is refused: one exception per reason, with the values it is about as attributes and one sentence.

The error codes are those of control_msgs/action/FollowJointTrajectory (facts: control_msgs 5.x, Result).
"""

import math
from collections.abc import Sequence

from config.errors import legible

LONGEST_NAME = 60
"""A sentence repeats this many characters of a sender's name at most."""
SUCCESSFUL = 0
INVALID_GOAL = -1
INVALID_JOINTS = -2
OLD_HEADER_TIMESTAMP = -3
PATH_TOLERANCE_VIOLATED = -4
GOAL_TOLERANCE_VIOLATED = -5


def angle(value_rad: float) -> str:
    """An angle as people read it: radians, then degrees."""
    return f"{value_rad:.4f} rad ({math.degrees(value_rad):.2f}°)"


class GoalRefused(Exception):
    """Root: a goal that cannot be executed; `sentence` says why, `code` is the action's error code.

    `joint`, `point` (index), `value` and `limit` say what it is about, None where they do not apply.
    """

    code = INVALID_GOAL

    def __init__(
        self,
        sentence: str,
        *,
        joint: str | None = None,
        point: int | None = None,
        value: float | None = None,
        limit: float | None = None,
    ) -> None:
        sentence = legible(sentence)
        super().__init__(sentence)
        self.sentence = sentence
        self.joint = joint
        self.point = point
        self.value = value
        self.limit = limit


class NotServing(GoalRefused):
    """The arm cannot take goals at present: no control process, a fault, a joint without reference."""


class Overtaken(GoalRefused):
    """A newer command was begun while this one was still being judged."""

    def __init__(self) -> None:
        super().__init__(
            "Replaced by a newer goal, or by a trajectory on ~/joint_trajectory, before it could begin; it did not "
            "move the arm: send one after the other if each is to be completed."
        )


class Unreadable(GoalRefused):
    """Bytes that are no message of the type they came as."""

    def __init__(self, size: int, kind: str = "trajectory_msgs/msg/JointTrajectory") -> None:
        super().__init__(
            f"Its {size} bytes are no {kind}; look for a sender of another version or a faulty one.", value=size
        )


class BadJoints(GoalRefused):
    """The joint names do not fit the arm."""

    code = INVALID_JOINTS


class NoJoints(BadJoints):
    def __init__(self, known: Sequence[str]) -> None:
        super().__init__(f"The goal names no joint; name one or more of {', '.join(known)}.")


class UnknownJoint(BadJoints):
    def __init__(self, joint: str, known: Sequence[str], where: str = "joint_names") -> None:
        super().__init__(
            f"'{legible(joint, LONGEST_NAME)}' in {where} is no joint of this arm, which has {', '.join(known)}; "
            "correct the name.",
            joint=joint,
        )


class PartialGoal(BadJoints):
    def __init__(self, missing: Sequence[str]) -> None:
        super().__init__(
            f"The goal leaves out {', '.join(missing)}; name every joint, or set the parameter "
            "allow_partial_joints_goal.",
            joint=missing[0],
        )


class DuplicateJoint(BadJoints):
    def __init__(self, joint: str, where: str = "joint_names") -> None:
        super().__init__(f"'{joint}' stands in {where} more than once; name each joint once.", joint=joint)


class BadShape(GoalRefused):
    """The message's arrays do not fit together."""


class EmptyTrajectory(BadShape):
    def __init__(self) -> None:
        super().__init__("The trajectory has no points; send at least one.")


class TooManyPoints(BadShape):
    def __init__(self, count: int, allowed: int) -> None:
        super().__init__(
            f"The trajectory has {count} points and at most {allowed} are allowed; send it in parts, or "
            "raise trajectory.max_points in the arm file.",
            value=count,
            limit=allowed,
        )


class TooMuchBeside(BadShape):
    def __init__(self, allowed: int) -> None:
        super().__init__(
            f"Beside its points the message has more than the {allowed} bytes that are allowed for names and "
            "tolerances; name only this arm's joints.",
            limit=allowed,
        )


class WrongSize(BadShape):
    def __init__(self, point: int, field: str, size: int, expected: int) -> None:
        allowed = f"{expected}" if field == "positions" else f"{expected} or none"
        super().__init__(
            f"Point {point} has {size} {field} for {expected} joint name{'s' if expected != 1 else ''}; give "
            f"{allowed}, in the order of joint_names.",
            point=point,
            value=size,
            limit=expected,
        )


class AccelerationsAlone(BadShape):
    def __init__(self, point: int) -> None:
        super().__init__(
            f"Point {point} has accelerations but no velocities, which leaves the motion undefined; add the "
            "velocities or leave the accelerations out.",
            point=point,
        )


class NotSupported(GoalRefused):
    """The goal asks for something this arm cannot do, and ignoring it silently would mislead."""


class NotFinite(GoalRefused):
    def __init__(self, point: int, joint: str, field: str, value: float) -> None:
        super().__init__(
            f"Point {point} has {value:g} as {field} of {joint}; all numbers must be finite: correct the sender.",
            joint=joint,
            point=point,
            value=value,
        )


class BadTimes(GoalRefused):
    """The points' times cannot be followed."""


class NegativeTime(BadTimes):
    def __init__(self, time_s: float) -> None:
        super().__init__(
            f"Point 0 has time_from_start {time_s:.6f} s; times start at 0 or later: shift them.",
            point=0,
            value=time_s,
            limit=0.0,
        )


class TimesNotRising(BadTimes):
    def __init__(self, point: int, before_s: float, time_s: float) -> None:
        super().__init__(
            f"Point {point} has time_from_start {time_s:.6f} s after {before_s:.6f} s at point {point - 1}; "
            "times must rise strictly: remove the point or correct its time.",
            point=point,
            value=time_s,
            limit=before_s,
        )


class TooDense(BadTimes):
    def __init__(self, point: int, count: int, span_s: float, allowed_s: float) -> None:
        super().__init__(
            f"The {count} points from point {point} on last only {span_s:.4f} s, and the control process must know at "
            f"least {allowed_s:.4g} s ahead to be able to stop on the path: thin the trajectory out.",
            point=point,
            value=span_s,
            limit=allowed_s,
        )


class Unparameterised(BadTimes):
    def __init__(self, count: int) -> None:
        super().__init__(
            f"All {count} points have time_from_start 0, so the trajectory has a path but no timing; run "
            "time parameterisation (in MoveIt AddTimeOptimalParameterization) before sending it."
        )


class EndsInThePast(BadTimes):
    code = OLD_HEADER_TIMESTAMP

    def __init__(self, late_s: float) -> None:
        super().__init__(
            f"The trajectory, counted from its header stamp, ended {late_s:.3f} s ago; send a stamp of zero "
            "to start at once, or check that both machines' clocks agree.",
            value=late_s,
            limit=0.0,
        )


class EndsMoving(GoalRefused):
    def __init__(self, joint: str, velocity_rad_s: float, allowed_rad_s: float) -> None:
        super().__init__(
            f"The last point leaves {joint} moving at {velocity_rad_s:.4f} rad/s; at most {allowed_rad_s:g} "
            "rad/s is taken for rest: end the trajectory at rest, or set the parameter "
            "allow_nonzero_velocity_at_trajectory_end.",
            joint=joint,
            value=velocity_rad_s,
            limit=allowed_rad_s,
        )


class NoRoomToStop(GoalRefused):
    """A stream whose last point leaves no room to stop in a straight line."""

    def __init__(self, joint: str, velocity_rad_s: float, stop_rad: float, limit_rad: float) -> None:
        super().__init__(
            f"The last point leaves {joint} moving at {velocity_rad_s:.4f} rad/s, and stopping from there ends at "
            f"{angle(stop_rad)}, beyond its limit {angle(limit_rad)}: slow down before the limit.",
            joint=joint,
            value=stop_rad,
            limit=limit_rad,
        )


class BadTolerance(GoalRefused):
    def __init__(self, joint: str | None, field: str, value: float) -> None:
        super().__init__(
            f"{field}{f' of {joint}' if joint else ''} is {value:g}; allowed are a positive limit, 0 for the "
            "default and -1 for none: correct it.",
            joint=joint,
            value=value,
        )


class TooFar(GoalRefused):
    """The trajectory is too far from where the arm is commanded; `place` says which part of it."""

    def __init__(self, place: str, joint: str, distance_rad: float, limit_rad: float, planned_rad: float) -> None:
        super().__init__(
            f"{place} has {joint} at {angle(planned_rad)}, {angle(distance_rad)} from where it is commanded; allowed "
            f"are {angle(limit_rad)}: plan from the present state, or give the first point a time_from_start above 0.",
            joint=joint,
            value=distance_rad,
            limit=limit_rad,
        )


class BeyondLimits(GoalRefused):
    """The motion breaks a limit of a joint."""


class PositionBeyondLimit(BeyondLimits):
    def __init__(self, place: str, joint: str, value_rad: float, lower_rad: float, upper_rad: float) -> None:
        limit = upper_rad if value_rad > upper_rad else lower_rad
        super().__init__(
            f"{joint} would be at {angle(value_rad)} {place}; allowed are {angle(lower_rad)} to "
            f"{angle(upper_rad)}: keep the trajectory inside, between its points too.",
            joint=joint,
            value=value_rad,
            limit=limit,
        )


class VelocityBeyondLimit(BeyondLimits):
    def __init__(self, place: str, joint: str, value_rad_s: float, limit_rad_s: float) -> None:
        super().__init__(
            f"{joint} would move at {value_rad_s:.4f} rad/s {place}; allowed are {limit_rad_s:.4f} rad/s: "
            "give the trajectory more time.",
            joint=joint,
            value=value_rad_s,
            limit=limit_rad_s,
        )


class AccelerationBeyondLimit(BeyondLimits):
    """`gap_s` is how far the points are apart there, `cycle_s` the control cycle."""

    def __init__(
        self, place: str, joint: str, value_rad_s2: float, limit_rad_s2: float, gap_s: float, cycle_s: float
    ) -> None:
        cure = "smooth it there"
        if gap_s < cycle_s:
            cure = (
                f"where points only {gap_s * 1e3:.3g} ms apart are noisy or rounded, thin them to "
                f"{2e3 * cycle_s:.3g} ms or smooth them"
            )
        super().__init__(
            f"{joint} would accelerate with {value_rad_s2:.3f} rad/s² {place}; allowed are "
            f"{limit_rad_s2:.3f} rad/s²: give the trajectory more time or {cure}.",
            joint=joint,
            value=value_rad_s2,
            limit=limit_rad_s2,
        )


class Unreachable(GoalRefused):
    """No joint angles that the arm may take bring its flange into the pose."""


class OffTheStraight(GoalRefused):
    """A straight line whose end is in reach, but which the arm cannot follow all along; `place` says up to where."""

    def __init__(self, place: str, why: str, joint: str | None = None) -> None:
        super().__init__(
            f"The straight line cannot be followed to its end: {place} {why}. Go there with a move of the joints "
            "(move_xyz_rotation), or lead the line another way.",
            joint=joint,
        )


class Singular(OffTheStraight):
    """The line passes a place where joints would have to turn much farther than the flange moves."""


class OffTheLine(OffTheStraight):
    """The line leaves the arm's reach in between."""

    def __init__(self, place: str) -> None:
        super().__init__(place, "it leaves the arm's reach")


class OutOfLimits(OffTheStraight):
    """The line leads a joint out of its limits, though the arm can reach its end in another configuration."""

    def __init__(self, place: str, joint: str, value_rad: float, lower_rad: float, upper_rad: float) -> None:
        super().__init__(
            place,
            f"{joint} comes to {angle(value_rad)}, and allowed are {angle(lower_rad)} to {angle(upper_rad)}",
            joint,
        )


class BadRequest(GoalRefused):
    """A field of a request of the full node has a value that is not allowed."""


class NotANumber(BadRequest):
    def __init__(self, field: str, value: float) -> None:
        super().__init__(f"{field} is {value:g}, and all numbers must be finite: correct the sender.", value=value)


class BadSpeedRatio(BadRequest):
    def __init__(self, value: float, slowest: float) -> None:
        super().__init__(
            f"speed_ratio is {value:g}; allowed is a share of the speed limits, {slowest:g} and more, where 1 is full "
            "speed: send one.",
            value=value,
        )


class UnknownOrder(BadRequest):
    def __init__(self, field: str, value: str, allowed: Sequence[str]) -> None:
        super().__init__(
            f"{field} is '{legible(value, LONGEST_NAME)}'; allowed are {' and '.join(allowed)}: send one of them."
        )


class TooFineSteps(BadRequest):
    def __init__(self, step_mm: float, finest_mm: float, default_mm: float) -> None:
        super().__init__(
            f"step_size is {step_mm:g} mm; allowed are {finest_mm:g} mm and more, or 0 for {default_mm:g} mm: send a "
            "larger one.",
            value=step_mm,
            limit=finest_mm,
        )


class MotorAngleBeyondLimit(BadRequest):
    """An angle on the motor's side, which begins at the homing stop, is outside the joint's limits."""

    def __init__(self, index: int, joint: str, value_deg: float, lower_deg: float, upper_deg: float) -> None:
        super().__init__(
            f"angles[{index}] is {value_deg:g}°; {joint} goes from {lower_deg:g}° to {upper_deg:g}°, counted from its "
            "homing stop: correct it.",
            joint=joint,
            value=value_deg,
            limit=upper_deg if value_deg > upper_deg else lower_deg,
        )


class ParkingTooLong(GoalRefused):
    """The move to the parking pose would take longer than parking may."""

    def __init__(self, takes_s: float, limit_s: float, speed_scale: float) -> None:
        if speed_scale < 1.0:
            slowed = f" at the speed scaling factor of {speed_scale:g}"
            ways = "the factor, parking.timeout_s or parking.speed_ratio"
        else:
            slowed, ways = "", "parking.timeout_s or parking.speed_ratio in the arm file"
        takes = f"take {takes_s:.1f} s" if math.isfinite(takes_s) else "never end"
        super().__init__(f"It would {takes}{slowed} and parking.timeout_s is {limit_s:g}: raise {ways}.")


class InMotion(GoalRefused):
    """A move that begins at rest was asked for while the arm moves, or will move for another goal."""

    def __init__(self) -> None:
        super().__init__(
            "The arm is executing another goal or stopping, or one is held or yet to begin, and this move begins at "
            "rest: wait for its end, or cancel it first."
        )
