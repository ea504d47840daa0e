"""Goals from the command file, waypoint by waypoint, and the heartbeat of the ROS process.

Nothing there is trusted: each word is read once, into memory of the loop's own, and judged there. Positions in the ring
are bounded, each record is checked by sequence number and CRC, and every number must be finite and inside the limits.
The last bytes of a record whose CRC is wrong may not be visible yet, so it is looked at again for a few cycles before
it counts as corrupt.
"""

import math

from compilation.jit import jit
from motion import limits
from rtloop.commands.operator import GOALS_AHEAD, is_canceled
from rtloop.memory.events import record_event, set_result
from rtloop.memory.motion import WINDOW_WAYPOINTS
from rtloop.memory.state import Loop
from rtloop.safety.faults import latch_fault
from rtloop.trajectory.entry import forget_search
from rtloop.trajectory.limits import band, first_broken
from rtloop.trajectory.path import leaves_a_joint_moving, slot
from rtloop.trajectory.phases import (
    change_phase,
    end_waiting,
    incoming,
    running_goal,
    runs,
    stop_running,
    waits,
)
from shm import layout
from shm.atomics import load_acquire, store_release
from shm.layout import StateFile
from shm.record import offset_of
from shm.seqlock import copy_words, crc32_at
from shm.words import Entry, Event, Fault, Mode, Outcome, Phase, Setpoint

ROWS_A_CYCLE = 1440
"""Rows of joints in the records that are taken in one cycle: 160 records of six joints, 41 of 32."""
HEAD_ROWS = 3
"""What the head of a record costs, in rows of joints."""
MOST_RECORDS_A_CYCLE = 256
PAYING_NS = 8_000_000
"""A longer period pays for more: for as many such batches as it is times this long."""
CYCLES_TO_BECOME_VISIBLE = 5
NEVER_CLOSE_NS = 1 << 62
FARTHEST_NS = 1 << 62
"""146 years: times farther away than any message of ROS can say, so that no difference of two of them overflows."""

_APPROACH, _STREAM = int(Entry.APPROACH), int(Entry.STREAM)
_ANNOUNCED = offset_of(layout.CommandFile, "announced_goal")
_SETPOINTS_WRITTEN = offset_of(layout.CommandFile, "setpoints_written")
_SETPOINTS = offset_of(layout.CommandFile, "setpoints")
_SETPOINT_BYTES = layout.Setpoint.dtype.itemsize
_HEARTBEAT = offset_of(layout.CommandFile, "heartbeat_ns")
_CONSUMED_SETPOINTS = offset_of(layout.StateFile, "consumed", "setpoints")
_WAYPOINTS = offset_of(Loop, "waypoints")
_SCRATCH = offset_of(Loop, "scratch")
_SCRATCH_BEGIN = offset_of(Loop, "scratch_begin")
_SETPOINT_HEAD_WORDS = offset_of(layout.Setpoint, "joints") // 8
_SETPOINT_JOINT_WORDS = layout.SetpointJoint.dtype.itemsize // 8


@jit
def read_heartbeat(loop: Loop) -> None:
    """Take the age of the front's last sign of life, once a cycle, which may be a little later than the planned now.

    A heartbeat from the far future is no sign of life: nothing read in the command file is believed.
    """
    if loop.params.command_address != 0:
        # pairs with `CommandWriter.beat`; nothing else is read on its strength
        heartbeat_ns = max(load_acquire(loop.params.command_address + _HEARTBEAT), 0)  # so that nothing overflows
        loop.front.age_ns = abs(loop.timing.now_ns - heartbeat_ns)


@jit
def leave_corrupt_records(loop: Loop) -> None:
    """After a corrupt setpoint ring was cleared: begin again with what the front writes from now on."""
    command = loop.params.command_address
    # pairs with `CommandWriter._append`; records up to here are not read
    loop.front.setpoints_taken = load_acquire(command + _SETPOINTS_WRITTEN)
    loop.front.announced_goal = loop.front.newest_goal
    loop.front.setpoint_waits = 0


@jit
def records_a_cycle(joint_count: int, period_ns: int) -> int:
    """How many records of the setpoint ring one cycle takes at most: a goal must not starve beside a full ring."""
    return min(ROWS_A_CYCLE // (joint_count + HEAD_ROWS), MOST_RECORDS_A_CYCLE) * max(1, period_ns // PAYING_NS)


@jit
def take_setpoints(loop: Loop, shared: StateFile) -> None:
    """Take a bounded batch of records from the setpoint ring."""
    front = loop.front
    command = loop.params.command_address
    if command == 0 or loop.fault.code == Fault.COMMAND_RING:
        return
    # pairs with `CommandWriter._append`, plain stores: number and CRC tell whether the record is there
    written = load_acquire(command + _SETPOINTS_WRITTEN)
    waiting = written - front.setpoints_taken
    if waiting < 0 or waiting > layout.SETPOINT_SLOTS:
        latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(waiting), float(layout.SETPOINT_SLOTS))
        return
    # pairs with `CommandWriter.announce`; a bound alone
    announced = load_acquire(command + _ANNOUNCED)
    if announced > max(front.announced_goal, front.newest_goal) + GOALS_AHEAD:
        latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(announced), float(front.newest_goal + GOALS_AHEAD))
        return
    front.announced_goal = max(front.announced_goal, announced)
    words = _SETPOINT_HEAD_WORDS + loop.params.joint_count * _SETPOINT_JOINT_WORDS
    for _ in range(min(waiting, records_a_cycle(loop.params.joint_count, loop.params.period_ns))):
        source = command + _SETPOINTS + (front.setpoints_taken & (layout.SETPOINT_SLOTS - 1)) * _SETPOINT_BYTES
        scratch = loop.params.address + _SCRATCH
        copy_words(scratch, source, words)
        record = loop.scratch
        if record.crc != crc32_at(scratch + 8, words - 1) or record.sequence != front.setpoints_taken:
            front.setpoint_waits += 1
            if front.setpoint_waits > CYCLES_TO_BECOME_VISIBLE:
                latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(front.setpoints_taken), 0.0)
            break
        front.setpoint_waits = 0
        if not _take_record(loop, shared, words):
            break
        front.setpoints_taken += 1
    # pairs with `StateReader.setpoints_consumed`, a plain load: what is overwritten too early fails its CRC
    store_release(loop.params.state_address + _CONSUMED_SETPOINTS, front.setpoints_taken)


@jit
def _take_record(loop: Loop, shared: StateFile, words: int) -> bool:
    """Use the record in the scratch; False leaves it in the ring because its window is full."""
    params = loop.params
    record = loop.scratch
    if record.kind == Setpoint.BEGIN:
        copy_words(params.address + _SCRATCH_BEGIN, params.address + _SCRATCH, words)
        _begin_goal(loop, shared)
        return True
    # Waypoints of the running goal are taken until a newer one has really entered: it may yet be refused.
    if waits(loop) and record.goal_id == loop.paths[incoming(loop)].goal_id:
        path_index = incoming(loop)
    elif runs(loop) and record.goal_id == running_goal(loop):
        path_index = loop.goals.active
    else:
        return True  # of a goal that has ended
    path = loop.paths[path_index]
    if path.truncated == 1:
        return True
    if path.ended == 1:  # what was judged for its end must not change any more
        _refuse_waypoint(loop, shared, -1, float(record.kind), 0.0)
        return True
    if record.kind == Setpoint.END:
        _end_goal(loop, shared, path_index)
        return True
    if path.taken - path.segment >= WINDOW_WAYPOINTS - 1:
        if record.goal_id == loop.front.announced_goal:
            return False
        # A newer goal must not wait behind old waypoints. The running one has a whole window left, and it matters
        # only if the newer one is refused: then it ends at the tear by lack of path.
        path.truncated = 1
        return True
    joint, value, limit = wrong_waypoint(loop, path_index)
    if joint == SOUND:
        waypoint = params.address + _WAYPOINTS + slot(path_index, path.taken) * _SETPOINT_BYTES
        copy_words(waypoint, params.address + _SCRATCH, words)
        if path.taken > path.approach:
            gap_ns = record.time_ns - loop.waypoints[slot(path_index, path.taken - 1)].time_ns
            path.closest_ns = min(path.closest_ns, gap_ns)
        path.taken += 1
        if path_index != loop.goals.active:
            loop.front.incoming_record_ns = loop.timing.now_ns
        shared.counters.knots_taken += 1
        return True
    _refuse_waypoint(loop, shared, joint, value, limit)
    return True


SOUND = -2


@jit
def _finite(row: layout.SetpointJoint) -> bool:
    """Whether all three numbers of a record's joint are numbers."""
    return (
        math.isfinite(row.position_rad) and math.isfinite(row.velocity_rad_s) and math.isfinite(row.acceleration_rad_s2)
    )


@jit
def _end_goal(loop: Loop, shared: StateFile, path_index: int) -> None:
    """No waypoint follows; the record in the scratch holds the tolerances of the end."""
    path = loop.paths[path_index]
    for joint in range(loop.params.joint_count):
        row = loop.scratch.joints[joint]
        if not _finite(row):
            _refuse_waypoint(loop, shared, joint, row.position_rad, 0.0)
            return
        path.goal_tolerances[joint] = row
    path.ended = 1
    path.ends_moving = 1 if leaves_a_joint_moving(loop, path_index) else 0


@jit
def wrong_waypoint(loop: Loop, path_index: int) -> tuple[int, float, float]:
    """(SOUND, …) for a waypoint that may be used, else the joint (-1: the record), the value and its limit."""
    record = loop.scratch
    path = loop.paths[path_index]
    if record.kind != Setpoint.WAYPOINT:
        return -1, float(record.kind), 2.0
    if record.order != 1 and record.order != 3 and record.order != 5:
        return -1, float(record.order), 5.0
    previous_ns = -1 if path.taken == 0 else loop.waypoints[slot(path_index, path.taken - 1)].time_ns
    if record.time_ns <= previous_ns or record.time_ns > FARTHEST_NS:
        return -1, float(record.time_ns), float(previous_ns)
    for joint in range(loop.params.joint_count):
        if (path.joint_mask >> joint) & 1 == 0:
            continue
        row, waypoint = loop.joints[joint], record.joints[joint]
        p, v, a = waypoint.position_rad, waypoint.velocity_rad_s, waypoint.acceleration_rad_s2
        lowest_rad, highest_rad = band(row.lower_rad, row.upper_rad, row.slack_rad)
        max_velocity_rad_s = loop.params.velocity_margin * row.max_velocity_rad_s
        max_acceleration_rad_s2 = loop.params.acceleration_margin * row.max_acceleration_rad_s2
        broken = first_broken(p, v, a, lowest_rad, highest_rad, max_velocity_rad_s, max_acceleration_rad_s2)
        if broken == limits.POSITION:
            return joint, p, row.lower_rad if p < lowest_rad else row.upper_rad
        if broken == limits.VELOCITY:
            return joint, v, max_velocity_rad_s
        if broken == limits.ACCELERATION:
            return joint, a, max_acceleration_rad_s2
    return SOUND, 0.0, 0.0


@jit
def _refuse_waypoint(loop: Loop, shared: StateFile, joint: int, value: float, limit: float) -> None:
    """A waypoint that cannot be used ends its goal; what came before it is still a path to stop on."""
    if waits(loop) and loop.scratch.goal_id == loop.paths[incoming(loop)].goal_id:
        end_waiting(loop, shared, Outcome.REFUSED_CORRUPT, joint, value, limit)
    elif loop.paths[loop.goals.active].phase != Phase.STOPPING:
        stop_running(loop, Outcome.REFUSED_CORRUPT, joint, value, limit)


@jit
def _begin_goal(loop: Loop, shared: StateFile) -> None:
    front = loop.front
    begin = loop.scratch_begin
    goal_id = begin.goal_id
    if goal_id <= front.newest_goal:
        return  # taken before: a goal is never run twice
    farthest = max(front.announced_goal, front.newest_goal) + GOALS_AHEAD
    if goal_id > farthest:  # taken, it would make the loop deaf for every goal of a front
        latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(goal_id), float(farthest))
        return
    front.newest_goal = goal_id
    end_waiting(loop, shared, Outcome.REPLACED, -1, 0.0, 0.0)
    forget_search(loop)
    record_event(loop, shared, Event.GOAL, -1, goal_id, 0.0, 0.0)
    if is_canceled(loop, goal_id):
        set_result(loop, shared, goal_id, Outcome.CANCELED, -1, 0.0, 0.0)
        return
    outcome, joint = _wrong_begin(loop)
    if outcome != Outcome.NONE:
        set_result(loop, shared, goal_id, outcome, joint, float(loop.mode), 0.0)
        return
    front.incoming_record_ns = loop.timing.now_ns
    path = loop.paths[incoming(loop)]
    change_phase(loop, incoming(loop), Phase.WAITING)
    path.goal_id = goal_id
    path.decided = 0
    path.settle_start_ns = 0
    path.reason, path.reason_joint = Outcome.NONE, -1
    path.reason_value = path.reason_limit = 0.0
    path.segment = 0
    path.ended = path.ends_moving = 0
    path.start_ns = begin.start_ns
    path.joint_mask = begin.joint_mask
    path.goal_time_s = begin.goal_time_s
    path.approach = 1 if begin.entry & _APPROACH else 0
    path.stream = 1 if begin.entry & _STREAM else 0
    path.entry_s = path.blend_s = 0.0
    path.truncated = path.met = 0
    path.taken = 0
    path.closest_ns = NEVER_CLOSE_NS
    for joint in range(loop.params.joint_count):
        path.tolerances[joint] = begin.joints[joint]
    if path.approach == 1:
        first = loop.waypoints[slot(incoming(loop), 0)]  # filled in where the arm is when it enters
        first.time_ns = 0
        first.order = 5
        path.taken = 1


@jit
def _wrong_begin(loop: Loop) -> tuple[int, int]:
    """Why a goal cannot be begun now: outcome (NONE when it can) and joint."""
    operator, begin = loop.operator, loop.scratch_begin
    if loop.mode != Mode.HOLDING and loop.mode != Mode.EXECUTING and loop.mode != Mode.STOPPING:
        return Outcome.REFUSED_MODE, -1
    if loop.motion.closing == 1:
        return Outcome.SHUTDOWN, -1
    if operator.held == 1:
        return Outcome.REFUSED_HELD, -1
    if begin.epoch != loop.goals.epoch:
        return Outcome.REFUSED_OUTDATED, -1
    if begin.entry & _STREAM and loop.dialogue.healed_ns > operator.resume_ns:
        return Outcome.REFUSED_STREAM, -1
    for joint in range(loop.params.joint_count):
        if loop.axes[joint].reference.referenced == 0:
            return Outcome.REFUSED_UNREFERENCED, joint
        row = begin.joints[joint]
        if not _finite(row):
            return Outcome.REFUSED_CORRUPT, joint
    if begin.joint_mask <= 0 or begin.joint_mask >> loop.params.joint_count != 0:
        return Outcome.REFUSED_CORRUPT, -1
    if begin.start_ns > FARTHEST_NS or begin.start_ns < -FARTHEST_NS:
        return Outcome.REFUSED_CORRUPT, -1
    if not math.isfinite(begin.goal_time_s) or begin.entry & ~(_APPROACH | _STREAM) != 0:
        return Outcome.REFUSED_CORRUPT, -1
    return Outcome.NONE, -1
