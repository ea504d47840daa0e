"""Setpoints of one joint of Episode1, as the control cycle makes them: between points, at both ends, in stops."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import rtarm.demo.goals
from handbook.pictures.charts import Axis, Case, Curve, panels
from handbook.pictures.virtual_arm import VirtualArm

Order = Callable[[VirtualArm], None]
Row = Sequence[float]

JOINTS = 6
TIME = "time from the start of the goal (s)"
SETPOINTS = "setpoints of the control cycle"


def point(time_s: float, joint: int, *rows: float) -> SimpleNamespace:
    """A point of a goal that moves one joint: its position, velocity and acceleration as far as they are given."""
    fields = [[value if number == joint else 0.0 for number in range(JOINTS)] for value in rows]
    positions, velocities, accelerations = [*fields, [], []][:3]
    whole = int(time_s)
    return SimpleNamespace(
        time_from_start=SimpleNamespace(sec=whole, nanosec=round((time_s - whole) * 1e9)),
        positions=positions,
        velocities=velocities,
        accelerations=accelerations,
        effort=[],
    )


def curves(arm: VirtualArm, joint: int, setpoints: np.ndarray) -> list[Curve]:
    """Position, velocity and acceleration of a joint over time, of every other cycle."""
    times_s = np.arange(len(setpoints)) * arm.arm.control.period_ns * 1e-9
    return [Curve(times_s[::2], setpoints[::2, joint, quantity]) for quantity in range(3)]


def given(points: Sequence[SimpleNamespace], joint: int) -> list[Curve]:
    """What the points have of each quantity of a joint."""
    found = []
    for field in ("positions", "velocities", "accelerations"):
        having = [one for one in points if getattr(one, field)]
        times_s = [one.time_from_start.sec + one.time_from_start.nanosec * 1e-9 for one in having]
        found.append(Curve(np.array(times_s), np.array([getattr(one, field)[joint] for one in having])))
    return found


def played(
    title: Sequence[str], points: Sequence[SimpleNamespace], joint: int, shown_s: float, **trajectory: str | bool
) -> Case:
    """A goal for an arm that stands at zero, under an arm file with these values of its section trajectory."""
    arm = VirtualArm((0.0,) * JOINTS, {"trajectory": trajectory})
    arm.send(points)
    return Case(title, curves(arm, joint, arm.follow(shown_s)), points=given(points, joint))


# --- between points

TIMES_S = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
POSITIONS = (0.0, 0.05, 0.08, 0.03, 0.03, 0.0)
VELOCITIES = (0.0, 0.05, 0.0, -0.05, 0.01, 0.0)
ACCELERATIONS = (0.0, 0.0, -0.1, 0.0, 0.05, 0.0)
JOINT5 = 4


def interpolation() -> str:
    """What the arm does between points with positions alone, with velocities too, with accelerations too."""

    def between(title: Sequence[str], *rows: Row, **trajectory: str) -> Case:
        points = [point(time_s, JOINT5, *row) for time_s, *row in zip(TIMES_S, *rows, strict=True)]
        return played(title, points, JOINT5, TIMES_S[-1], **trajectory)

    cases = [
        between(["positions alone"], POSITIONS),
        between(["positions alone,", "interpolation: linear"], POSITIONS, interpolation="linear"),
        between(["positions and velocities"], POSITIONS, VELOCITIES),
        between(["positions, velocities", "and accelerations"], POSITIONS, VELOCITIES, ACCELERATIONS),
    ]
    rows = [
        Axis("position (rad)", -0.01, 0.1, 0.05),
        Axis("velocity (rad/s)", -0.1, 0.1, 0.05),
        Axis("acceleration (rad/s²)", -0.8, 0.8, 0.4),
    ]
    return panels(
        cases,
        rows,
        Axis(TIME, 0.0, TIMES_S[-1], 1.0),
        [("curve", SETPOINTS), ("point", "points of the goal")],
        "Position, velocity and acceleration between six points: a monotone cubic for positions alone, straight lines "
        "where the arm file wants them, a cubic through velocities, a quintic through accelerations",
    )


# --- at both ends

JOINT1 = 0
AHEAD = ((0.8, 0.1, 0.25), (1.6, 0.25, 0.0))
MIXED = ((0.0, 0.0), (0.5, 0.06), (1.0, 0.15, 0.2), (1.5, 0.23, 0.1, -0.4), (2.0, 0.25, 0.0, 0.0))
MOVING = ((0.0, 0.0, 0.0), (0.7, 0.08, 0.2), (1.2, 0.2, 0.28))
ENDS_SHOWN_S = 2.4


def ends() -> str:
    """How a goal begins ahead of its first point, joins points of several kinds, and ends where its last one moves."""

    def goal(title: Sequence[str], points: Sequence[Row], **trajectory: bool) -> Case:
        made = [point(time_s, JOINT1, *row) for time_s, *row in points]
        return played(title, made, JOINT1, ENDS_SHOWN_S, **trajectory)

    stream = VirtualArm((0.0,) * JOINTS, {})
    made = [point(time_s, JOINT1, *row) for time_s, *row in MOVING]
    stream.send(made, stream=True)
    streamed = curves(stream, JOINT1, stream.follow(ENDS_SHOWN_S))
    cases = [
        goal(["first point ahead"], AHEAD),
        goal(["points with", "different quantities"], MIXED),
        goal(["last point in motion,", "where that is allowed"], MOVING, allow_nonzero_end_velocity=True),
        Case(["the same as a message", "of a stream"], streamed, points=given(made, JOINT1)),
    ]
    rows = [
        Axis("position (rad)", -0.02, 0.32, 0.1),
        Axis("velocity (rad/s)", -0.1, 0.4, 0.1),
        Axis("acceleration (rad/s²)", -2.0, 2.0, 1.0),
    ]
    return panels(
        cases,
        rows,
        Axis(TIME, 0.0, ENDS_SHOWN_S, 0.5),
        [("curve", SETPOINTS), ("point", "points")],
        "Position, velocity and acceleration of a goal whose first point is ahead, of one whose points have different "
        "quantities, of one whose last point moves, and of a stream that runs on straight past its last point",
    )


# --- stops

JOINT2 = 1
ORDER_S, RESUME_S, STOPS_SHOWN_S = 1.0, 2.2, 3.4
SLOWER = 0.4


def stops() -> str:
    """What the joint that takes longest to brake does when its arm is stopped or slowed down."""
    undisturbed = stopped(["undisturbed"], {})
    cases = [
        stopped(["cancel"], {ORDER_S: ("cancel", lambda arm: arm.cancel())}),
        stopped(["a person's stop"], {ORDER_S: ("stop", lambda arm: arm.writer.stop())}),
        stopped(
            ["hold, then resume"],
            {
                ORDER_S: ("hold", lambda arm: arm.writer.hold()),
                RESUME_S: ("resume", lambda arm: arm.writer.resume()),
            },
        ),
        stopped(
            ["speed scale"],
            {
                ORDER_S: (f"{SLOWER:.0%}", lambda arm: arm.writer.scale(SLOWER)),
                RESUME_S: ("100%", lambda arm: arm.writer.scale(1.0)),
            },
        ),
    ]
    for case in cases:
        case.beside = undisturbed.curves
    rows = [
        Axis("position (rad)", -1.0, 0.0, 0.2),
        Axis("velocity (rad/s)", -0.1, 0.3, 0.1),
        Axis("acceleration (rad/s²)", -1.6, 1.6, 0.5),
    ]
    return panels(
        cases,
        rows,
        Axis(TIME, 0.0, STOPS_SHOWN_S, 1.0),
        [
            ("curve", SETPOINTS),
            ("beside", "the goal undisturbed"),
            ("limit", "limits of acceleration"),
        ],
        "Position, velocity and acceleration of joint2 in a MoveIt goal that is canceled, stopped by a person, held "
        "and resumed, slowed down and sped up again",
    )


def stopped(title: Sequence[str], orders: Mapping[float, tuple[str, Order]]) -> Case:
    """A goal that MoveIt has planned, and what is asked for on its way."""
    points = moveit_points("large_back")
    arm = VirtualArm(points[0].positions, {"control": {"rate_hz": 120}})
    arm.send(points)
    calls = {time_s: (lambda does=does: does(arm)) for time_s, (_, does) in orders.items()}
    setpoints = arm.follow(STOPS_SHOWN_S, calls)
    most = arm.arm.joints[JOINT2].max_acceleration_rad_s2
    hardest = most * arm.arm.limits.braking_factor
    limits = ((), (), (most, -most, hardest, -hardest))
    moments = {time_s: text for time_s, (text, _) in orders.items()}
    return Case(title, curves(arm, JOINT2, setpoints), limits=limits, moments=moments)


def moveit_points(name: str) -> list[SimpleNamespace]:
    """The points of a goal that was recorded from MoveIt, as the demo plays it."""
    text = Path(rtarm.demo.goals.__file__).with_name(f"{name}.json").read_text(encoding="utf-8")
    message = json.loads(text, object_hook=lambda fields: SimpleNamespace(**fields))
    points: list[SimpleNamespace] = message.trajectory.points
    return points
