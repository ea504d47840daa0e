"""What the cycle remembers of goals and motion: two paths, the clock that runs along one, who asked for what."""

from typing import Annotated

from rtloop.memory.owned_record import OwnedRecord
from shm import layout
from shm.layout import MAX_JOINTS
from shm.record import Rows

WINDOW_WAYPOINTS = 4096
"""Waypoints the loop keeps of a trajectory: at least its stopping distance at any sensible spacing."""
BLEND_SAMPLES = 32


class Operator(OwnedRecord, writers=("commands.operator",)):
    """What people ask for at any moment; the newest of each counts."""

    speed_scale: float  # what people asked for
    held: int  # 1: a person has stopped or holds the arm, so nothing begins before a resume
    stop_ns: int  # the newest stop that was obeyed, as the command file has it
    hold_ns: int
    resume_ns: int
    stops: int  # how often a person has stopped the arm


class Front(OwnedRecord, writers=("commands.request_reader", "commands.setpoint_reader")):
    """How far the ROS process' rings are read, and how long ago it last wrote a sign of life."""

    newest_goal: int  # highest id ever begun
    announced_goal: int
    age_ns: int  # time between now and its last sign of life
    incoming_record_ns: int  # when the last record of the goal that waits came
    setpoints_taken: int
    setpoint_waits: int  # cycles the next record has not passed its CRC
    requests_taken: int
    request_waits: int


class Goals(OwnedRecord, writers=("trajectory",)):
    """Which of the two paths runs, and what slows it down."""

    active: int  # which of the two paths runs
    entry_rate: float  # for which the running path's blend was made
    slowed: int  # bits of shm.words.Slowed: what slows the clock down beside what people ask for
    underrun_ns: int
    arriving: int  # the last ramp ends where the path does
    epoch: int  # goals that arrived in an earlier one never begin


class Search(OwnedRecord, writers=("trajectory.ahead", "trajectory.entry", "trajectory.goals")):
    """The way onto a newer goal that is being looked for, over several cycles where it takes long."""

    ways_tried: int  # onto it, of those that are tried from this state of the arm
    checks_left: int  # spans and setpoints that may still be looked at ahead in this cycle, -1: too few
    judged: int  # setpoints of the next way that cycles before have judged
    span_s: float  # path time at which they went on
    rate: float  # rate at which they would be entered


class Clock(OwnedRecord, writers=("trajectory.arrival", "trajectory.clock", "trajectory.entry")):
    """The trajectory clock: the time along the running path and its rate, which a cubic ramp changes."""

    time_s: float
    rate: float
    slope: float
    rate_target: float
    rate_start: float
    slope_start: float
    ramp_s: float  # duration of the running ramp, 0 = steady
    ramp_elapsed_s: float
    ramp_factor: float  # share of the acceleration limits that it may use
    ramp_judged: int  # its next setpoints that are known to keep the limits


class Motion(
    OwnedRecord,
    writers=(
        "commands.request_reader",
        "cycle",
        "safety.faults",
        "safety.transmission",
        "setpoints",
        "trajectory.goals",
    ),
):
    """How far the arm as a whole may be moved."""

    per_joint_stop: int  # each joint brakes by itself: the path cannot be trusted
    resync_ns: int  # since when the measured positions wait to be commanded, 0 = they do not
    started: int
    rested: int  # 1: the arm has come to rest in a latched fault
    closing: int  # a shutdown is stopping the arm


class Blend(OwnedRecord, writers=("trajectory.entry",)):
    """What is left of the difference between the arm and the plan when a path is entered, of one joint."""

    held_rad: float  # where a joint outside the goal comes to rest
    c0: float
    c1: float
    c2: float
    c3: float
    c4: float
    c5: float
    faded: float  # difference in acceleration, which fades first


class Path(
    OwnedRecord,
    writers=("commands.setpoint_reader", "setpoints", "trajectory.entry", "trajectory.goals", "trajectory.phases"),
):
    """A goal: what is known of its points, which phase it is in, and how it was entered."""

    goal_id: int
    phase: int  # shm.words.Phase of its goal, changed by rtloop.trajectory.phases alone
    reason: int  # while it stops: the outcome its goal gets when the arm stands
    reason_joint: int
    reason_value: float
    reason_limit: float
    decided: int  # 1: its goal is decided, also where the arm still stops
    settle_start_ns: int  # when its last point is the commanded one, 0 = not yet
    taken: int  # waypoints taken; the newest is at (taken - 1) % WINDOW_WAYPOINTS
    segment: int  # waypoint at the start of the running segment
    closest_ns: int  # least time between two of its waypoints, other than the beginning of an approach segment
    ended: int
    ends_moving: int  # 1: the last point, which is known, leaves a joint in motion
    truncated: int  # waypoints are missing after the newest one
    start_ns: int
    met: int  # 1: the arm was where its goal, which has no start time, begins
    joint_mask: int
    goal_time_s: float
    approach: int
    stream: int
    tolerances: Annotated[Rows[layout.SetpointJoint], MAX_JOINTS]  # on the way
    goal_tolerances: Annotated[Rows[layout.SetpointJoint], MAX_JOINTS]  # at the end
    entry_s: float  # path time at which it was entered, where the blend begins
    blend_s: float  # path time the blend lasts
    from_rest: int  # 1: it was entered by an arm at rest
    fade_s: float  # path time in which its difference in acceleration fades
    blends: Annotated[Rows[Blend], MAX_JOINTS]
