"""What the loop takes from the command file: goals knot by knot, and requests.

Nothing read there is believed: each word of it is read once, into memory of the loop's own, and judged there; positions
in the rings are bounded, each record is checked by sequence number and CRC, every number must be finite and inside the
limits. A record whose CRC is
wrong may be one whose last bytes have not become visible yet, so it is looked at again for a few cycles
before it counts as corrupt.
"""

import math
from typing import Any

from compilation.jit import jit
from motion import limits
from rtloop.commands.people import GOALS_AHEAD, is_canceled
from rtloop.memory.events import answer_request, record_event, set_result
from rtloop.memory.modes import change_mode, is_limp
from rtloop.memory.motion import WINDOW_KNOTS
from rtloop.memory.record import offset_of
from rtloop.memory.state import LOOP, Loop, Shared
from rtloop.safety.faults import latch_fault
from rtloop.trajectory.entry import forget_search
from rtloop.trajectory.limits import at_rest, band, first_broken
from rtloop.trajectory.path import leaves_a_joint_moving, slot
from rtloop.trajectory.phases import (
    change_phase,
    end_waiting,
    incoming,
    raise_epoch,
    running_goal,
    runs,
    stop_running,
    waits,
)
from rtloop.wire import received
from shm import layout
from shm.atomics import load_acquire, store_release
from shm.seqlock import copy_words, crc32_at
from shm.words import Answer, Entry, Event, Fault, Mode, Outcome, Phase, Request, Setpoint, Unreferenced

ROWS_A_CYCLE = 1440
"""Rows of joints in the records that are taken in one cycle: 160 records of six joints, 41 of 32."""
HEAD_ROWS = 3
"""What the head of a record costs, in rows of joints."""
MOST_RECORDS_A_CYCLE = 256
PAYING_NS = 8_000_000
"""A longer period pays for more: for as many such batches as it is times this long."""
REQUESTS_A_CYCLE = 4
CYCLES_TO_BECOME_VISIBLE = 5
NEVER_CLOSE_NS = 1 << 62
FARTHEST_NS = 1 << 62
"""146 years: times farther away than any message of ROS can say, so that no difference of two of them overflows."""

_BRIDGE, _STREAM = int(Entry.BRIDGE), int(Entry.STREAM)
_ANNOUNCED = offset_of(layout.COMMAND, "announced_goal")
_SETPOINTS_WRITTEN = offset_of(layout.COMMAND, "setpoints_written")
_SETPOINTS = offset_of(layout.COMMAND, "setpoints")
_SETPOINT_BYTES = layout.SETPOINT.itemsize
_REQUESTS_WRITTEN = offset_of(layout.COMMAND, "requests_written")
_REQUESTS = offset_of(layout.COMMAND, "requests")
_REQUEST_BYTES = layout.REQUEST.itemsize
_HEARTBEAT = offset_of(layout.COMMAND, "heartbeat_ns")
_CONSUMED_SETPOINTS = offset_of(layout.STATE, "consumed", "setpoints")
_CONSUMED_REQUESTS = offset_of(layout.STATE, "consumed", "requests")
_KNOTS = offset_of(LOOP, "knots")
_SCRATCH = offset_of(LOOP, "scratch")
_SCRATCH_BEGIN = offset_of(LOOP, "scratch_begin")
_SCRATCH_REQUEST = offset_of(LOOP, "scratch_request")
_SETPOINT_HEAD_WORDS = offset_of(layout.SETPOINT, "joints") // 8
_SETPOINT_JOINT_WORDS = layout.SETPOINT_JOINT.itemsize // 8


@jit
def hear_the_front(loop: Loop) -> None:
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
    # pairs with `CommandWriter._append`: records up to here are not read, so none is read too early
    loop.front.setpoints_taken = load_acquire(command + _SETPOINTS_WRITTEN)
    loop.front.announced_goal = loop.front.newest_goal
    loop.front.setpoint_waits = 0


@jit
def records_a_cycle(joint_count: int, period_ns: int) -> int:
    """How many records of the setpoint ring one cycle takes at most: a goal must not starve beside a full ring."""
    return min(ROWS_A_CYCLE // (joint_count + HEAD_ROWS), MOST_RECORDS_A_CYCLE) * max(1, period_ns // PAYING_NS)


@jit
def take_setpoints(loop: Loop, shared: Shared) -> None:
    """Take a bounded batch of records from the setpoint ring."""
    front = loop.front
    command = loop.params.command_address
    if command == 0 or loop.fault.code == Fault.COMMAND_RING:
        return
    # pairs with `CommandWriter._append`: a record is read after the count that announces it
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
    # pairs with `StateReader.setpoints_consumed`: a slot is given back after its record was copied
    store_release(loop.params.state_address + _CONSUMED_SETPOINTS, front.setpoints_taken)


@jit
def _take_record(loop: Loop, shared: Shared, words: int) -> bool:
    """Use the record in the scratch; False leaves it in the ring because its window is full."""
    params = loop.params
    record = loop.scratch
    if record.kind == Setpoint.BEGIN:
        copy_words(params.address + _SCRATCH_BEGIN, params.address + _SCRATCH, words)
        _begin_goal(loop, shared)
        return True
    # Knots of the running goal are taken until a newer one has really entered: it may yet be refused.
    if waits(loop) and record.goal_id == loop.paths[incoming(loop)].goal_id:
        path_index = incoming(loop)
    elif runs(loop) and record.goal_id == running_goal(loop):
        path_index = loop.goals.active
    else:
        return True  # of a goal that has ended
    path = loop.paths[path_index]
    if path.torn == 1:
        return True
    if path.ended == 1:  # what was judged for its end must not change any more
        _refuse_knot(loop, shared, -1, float(record.kind), 0.0)
        return True
    if record.kind == Setpoint.END:
        _end_goal(loop, shared, path_index)
        return True
    if path.taken - path.segment >= WINDOW_KNOTS - 1:
        if record.goal_id == loop.front.announced_goal:
            return False
        # A newer goal must not wait behind old knots. The running one has a whole window left, and it matters
        # only if the newer one is refused: then it ends at the tear by lack of path.
        path.torn = 1
        return True
    joint, value, limit = wrong_knot(loop, path_index)
    if joint == SOUND:
        knot = params.address + _KNOTS + slot(path_index, path.taken) * _SETPOINT_BYTES
        copy_words(knot, params.address + _SCRATCH, words)
        if path.taken > path.bridge:
            gap_ns = record.time_ns - loop.knots[slot(path_index, path.taken - 1)].time_ns
            path.closest_ns = min(path.closest_ns, gap_ns)
        path.taken += 1
        if path_index != loop.goals.active:
            loop.front.incoming_record_ns = loop.timing.now_ns
        shared.counters.knots_taken += 1
        return True
    _refuse_knot(loop, shared, joint, value, limit)
    return True


SOUND = -2


@jit
def _finite(row: Any) -> bool:
    """Whether all three numbers of a record's joint are numbers."""
    return (
        math.isfinite(row.position_rad) and math.isfinite(row.velocity_rad_s) and math.isfinite(row.acceleration_rad_s2)
    )


@jit
def _end_goal(loop: Loop, shared: Shared, path_index: int) -> None:
    """No knot follows; the record in the scratch says what is allowed at the end."""
    path = loop.paths[path_index]
    for joint in range(loop.params.joint_count):
        row = loop.scratch.joints[joint]
        if not _finite(row):
            _refuse_knot(loop, shared, joint, row.position_rad, 0.0)
            return
        path.goal_tolerances[joint] = row
    path.ended = 1
    path.ends_moving = 1 if leaves_a_joint_moving(loop, path_index) else 0


@jit
def wrong_knot(loop: Loop, path_index: int) -> tuple[int, float, float]:
    """(SOUND, …) for a knot that may be used, else the joint (-1: the record), the value and its limit."""
    record = loop.scratch
    path = loop.paths[path_index]
    if record.kind != Setpoint.KNOT:
        return -1, float(record.kind), 2.0
    if record.order != 1 and record.order != 3 and record.order != 5:
        return -1, float(record.order), 5.0
    previous_ns = -1 if path.taken == 0 else loop.knots[slot(path_index, path.taken - 1)].time_ns
    if record.time_ns <= previous_ns or record.time_ns > FARTHEST_NS:
        return -1, float(record.time_ns), float(previous_ns)
    for joint in range(loop.params.joint_count):
        if (path.joint_mask >> joint) & 1 == 0:
            continue
        row, knot = loop.joints[joint], record.joints[joint]
        p, v, a = knot.position_rad, knot.velocity_rad_s, knot.acceleration_rad_s2
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
def _refuse_knot(loop: Loop, shared: Shared, joint: int, value: float, limit: float) -> None:
    """A knot that cannot be used ends its goal; what came before it is still a path to stop on."""
    if waits(loop) and loop.scratch.goal_id == loop.paths[incoming(loop)].goal_id:
        end_waiting(loop, shared, Outcome.REFUSED_CORRUPT, joint, value, limit)
    elif loop.paths[loop.goals.active].phase != Phase.STOPPING:
        stop_running(loop, Outcome.REFUSED_CORRUPT, joint, value, limit)


@jit
def _begin_goal(loop: Loop, shared: Shared) -> None:
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
    path.told = 0
    path.settle_ns = 0
    path.reason, path.reason_joint = Outcome.NONE, -1
    path.reason_value = path.reason_limit = 0.0
    path.segment = 0
    path.ended = path.ends_moving = 0
    path.start_ns = begin.start_ns
    path.joint_mask = begin.joint_mask
    path.goal_time_s = begin.goal_time_s
    path.bridge = 1 if begin.entry & _BRIDGE else 0
    path.stream = 1 if begin.entry & _STREAM else 0
    path.entry_s = path.blend_s = 0.0
    path.torn = path.met = 0
    path.taken = 0
    path.closest_ns = NEVER_CLOSE_NS
    for joint in range(loop.params.joint_count):
        path.tolerances[joint] = begin.joints[joint]
    if path.bridge == 1:
        first = loop.knots[slot(incoming(loop), 0)]  # filled in where the arm is when it enters
        first.time_ns = 0
        first.order = 5
        path.taken = 1


@jit
def _wrong_begin(loop: Loop) -> tuple[int, int]:
    """Why a goal cannot be begun now: outcome (NONE when it can) and joint."""
    people, begin = loop.people, loop.scratch_begin
    if loop.mode != Mode.HOLDING and loop.mode != Mode.EXECUTING and loop.mode != Mode.STOPPING:
        return Outcome.REFUSED_MODE, -1
    if loop.motion.closing == 1:
        return Outcome.SHUTDOWN, -1
    if people.held == 1:
        return Outcome.REFUSED_HELD, -1
    if begin.epoch != loop.goals.epoch:
        return Outcome.REFUSED_OUTDATED, -1
    if begin.entry & _STREAM and loop.dialogue.healed_ns > people.resume_ns:
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
    if not math.isfinite(begin.goal_time_s) or begin.entry & ~(_BRIDGE | _STREAM) != 0:
        return Outcome.REFUSED_CORRUPT, -1
    return Outcome.NONE, -1


# --- requests -----------------------------------------------------------------------------------------


@jit
def take_requests(loop: Loop, shared: Shared) -> None:
    """Take and answer a bounded batch of requests."""
    front = loop.front
    command = loop.params.command_address
    if command == 0:
        return
    # pairs with `CommandWriter.request`: a record is read after the count that announces it
    written = load_acquire(command + _REQUESTS_WRITTEN)
    waiting = written - front.requests_taken
    if waiting < 0 or waiting > layout.REQUEST_SLOTS:
        latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(waiting), float(layout.REQUEST_SLOTS))
        front.requests_taken = written
        waiting = 0
    scratch = loop.params.address + _SCRATCH_REQUEST
    for _ in range(min(waiting, REQUESTS_A_CYCLE)):
        source = command + _REQUESTS + (front.requests_taken & (layout.REQUEST_SLOTS - 1)) * _REQUEST_BYTES
        copy_words(scratch, source, _REQUEST_BYTES // 8)
        request = loop.scratch_request
        if request.crc != crc32_at(scratch + 8, _REQUEST_BYTES // 8 - 1) or (
            request.sequence != front.requests_taken + 1
        ):
            front.request_waits += 1
            if front.request_waits > CYCLES_TO_BECOME_VISIBLE:
                latch_fault(loop, shared, Fault.COMMAND_RING, -1, float(front.requests_taken), 0.0)
                front.requests_taken = written
                front.request_waits = 0
            break
        front.request_waits = 0
        front.requests_taken += 1
        answer_request(loop, shared, request.sequence, request.kind, _obey(loop, shared))
    # pairs with `StateReader.requests_consumed`: a slot is given back after its record was copied
    store_release(loop.params.state_address + _CONSUMED_REQUESTS, front.requests_taken)


@jit
def _obey(loop: Loop, shared: Shared) -> int:
    dialogue, request = loop.dialogue, loop.scratch_request
    kind = request.kind
    if request.epoch != loop.goals.epoch and (
        kind == Request.HOME or kind == Request.GRIP or kind == Request.GRIP_HOME
    ):
        return Answer.REFUSED_OUTDATED
    if kind == Request.GRIP or kind == Request.GRIP_STOP or kind == Request.GRIP_HOME:
        return _pass_to_gripper(loop)
    dialogue.pose_due_ns = 0
    if kind == Request.CLEAR_FAULT:
        if loop.mode != Mode.FAULT:
            return Answer.REFUSED_MODE
        if received.closed(loop) != 0:
            return Answer.REFUSED_WIRE
        if runs(loop) or not at_rest(loop):
            return Answer.REFUSED_MOVING
        dialogue.bring_up_asked = 1
        return Answer.DONE
    if kind == Request.ENABLE:
        if not is_limp(loop.mode):
            return Answer.DONE if loop.mode == Mode.HOLDING or loop.mode == Mode.EXECUTING else Answer.REFUSED_MODE
        dialogue.bring_up_asked = 1
        dialogue.release_asked = 0
        return Answer.DONE
    if kind == Request.DISABLE or kind == Request.FREE:
        return _let_go(loop, shared, Mode.DISABLED if kind == Request.DISABLE else Mode.FREE)
    if kind == Request.HOME_STOP:
        if loop.mode != Mode.REFERENCING:
            return Answer.REFUSED_MODE
        dialogue.referencing_ends = 1
        return Answer.DONE
    if kind == Request.HOME or kind == Request.REFERENCE:
        return begin_referencing(loop, shared, kind, request.joint_mask, request.value)
    return Answer.REFUSED_UNKNOWN


@jit
def _pass_to_gripper(loop: Loop) -> int:
    """Leave a request for the gripper's conversation, whatever the arm is doing: a newer one replaces an older one."""
    gripper, params, request = loop.gripper, loop.params, loop.scratch_request
    if params.has_gripper == 0:
        return Answer.REFUSED_UNKNOWN
    if loop.mode == Mode.OFFLINE:
        return Answer.REFUSED_MODE
    if received.closed(loop) != 0:
        return Answer.REFUSED_WIRE
    if loop.people.held == 1 and request.kind != Request.GRIP_STOP:
        return Answer.REFUSED_HELD
    if request.kind == Request.GRIP:
        inside = request.value >= params.gripper_lower_rad and request.value <= params.gripper_upper_rad
        if not (inside and request.most_effort >= 0.0 and math.isfinite(request.most_effort)):
            return Answer.REFUSED_VALUE
    gripper.kind = request.kind
    gripper.position_rad = request.value
    gripper.effort = request.most_effort
    gripper.sequence = request.sequence  # the last: the other thread looks for it
    return Answer.DONE


@jit
def _let_go(loop: Loop, shared: Shared, mode: int) -> int:
    """Let the drives of a standing arm go limp; nothing else ever does."""
    if loop.mode == mode:
        return Answer.DONE
    if loop.mode == Mode.EXECUTING or loop.mode == Mode.STOPPING or waits(loop) or loop.motion.resync_ns != 0:
        return Answer.REFUSED_MOVING
    if loop.dialogue.bring_up_asked == 1:
        return Answer.REFUSED_MODE
    limp_already = is_limp(loop.mode)
    if not change_mode(loop, shared, mode):
        return Answer.REFUSED_MODE
    raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
    loop.motion.started = 0
    if not limp_already:
        loop.dialogue.release_asked = 1
    return Answer.DONE


@jit
def begin_referencing(loop: Loop, shared: Shared, kind: int, joint_mask: int, angle_rad: float) -> int:
    """Let joints of a standing arm be homed, or be where a person says."""
    dialogue, count = loop.dialogue, loop.params.joint_count
    if kind == Request.HOME and loop.people.held == 1:
        return Answer.REFUSED_HELD
    if joint_mask == 0 and kind == Request.HOME:
        joint_mask = loop.params.homing_mask
    if joint_mask <= 0 or joint_mask >> count != 0 or math.isinf(angle_rad):
        return Answer.REFUSED_VALUE
    for joint in range(count):
        if (joint_mask >> joint) & 1 and kind == Request.REFERENCE and not _may_stand_at(loop, joint, angle_rad):
            return Answer.REFUSED_VALUE
    if loop.mode == Mode.EXECUTING or loop.mode == Mode.STOPPING or waits(loop) or loop.motion.resync_ns != 0:
        return Answer.REFUSED_MOVING
    if dialogue.bring_up_asked == 1 or not change_mode(loop, shared, Mode.REFERENCING):
        return Answer.REFUSED_MODE
    raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)
    dialogue.referencing_ends = 0
    for joint in range(count):
        if (joint_mask >> joint) & 1:
            loop.axes[joint].reference.asked_rad = angle_rad
    dialogue.home_asked = joint_mask if kind == Request.HOME else 0  # the last: the other thread looks for them
    dialogue.reference_asked = joint_mask if kind == Request.REFERENCE else 0
    return Answer.DONE


@jit
def _may_stand_at(loop: Loop, joint: int, angle_rad: float) -> bool:
    """Whether a person may say so: no joint is outside its limits, and some counts are from nowhere."""
    if math.isnan(angle_rad):
        reason = loop.axes[joint].reference.unreferenced_reason
        return bool(reason != Unreferenced.POWER_LOST and reason != Unreferenced.NOT_HOMED)
    row = loop.joints[joint]
    return bool(row.lower_rad <= angle_rad <= row.upper_rad)
