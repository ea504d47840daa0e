"""Everything the cycle remembers, as one structured record: `step(loop, shared, now_ns)` is a function of it.

It is private to the control process; what others may see is copied into the state file's snapshot at the end of a
cycle. One record instead of objects keeps the compiled cycle free of allocation and makes a state something that can be
copied, compared and replayed. Its parts are declared by subject: `axis`, `motion`, `link`, and here what is left.
"""

from typing import Annotated

from rtloop.memory.axis import Axis, JointParams
from rtloop.memory.link import LISTENERS, Bus, Listener, ServiceRing
from rtloop.memory.motion import WINDOW_WAYPOINTS, Clock, Front, Goals, Motion, Operator, Path, Search
from rtloop.memory.owned_record import OwnedRecord
from shm import layout
from shm.layout import MAX_BUSES, MAX_JOINTS
from shm.record import Floats, Ints, Rows

HISTORY_SLOTS = 256
"""Cycles of commanded positions kept, to compare a measurement with the command of its own instant: the age at which a
drive counts as silent (0.1 s), at the highest rate (2000 Hz)."""


class Params(OwnedRecord, writers=()):
    """The arm as its file has it, and where its memory stands."""

    joint_count: int
    bus_count: int
    listener_count: int
    homing_mask: int  # joints of the arm's homing run
    period_ns: int
    address: int  # of this record itself
    state_address: int  # of the mapped state file
    command_address: int  # of the mapped command file
    start_tolerance_rad: float
    velocity_margin: float
    acceleration_margin: float
    braking_factor: float
    following_error_rad: float
    position_jump_rad: float
    stale_brake_ns: int
    stale_fault_ns: int
    front_timeout_ns: int
    longest_stop_s: float
    drives_patience_ns: int  # for drives that brake by themselves
    has_gripper: int  # 1: a drive on a bus moves a gripper
    gripper_bus: int
    gripper_lower_rad: float
    gripper_upper_rad: float
    reported: int  # 1: drives send their positions by themselves
    reading_ns: int  # between two positions of a drive
    fast_targets: int  # 1: targets are sent with FC, to drives that are known to take it as absolute
    report_overdue_ns: int  # age above which a report that is missing is asked for


class Timing(OwnedRecord, writers=("cycle", "process.run")):
    """When this cycle is."""

    cycle: int
    now_ns: int  # CLOCK_MONOTONIC, at which it was planned
    epoch_offset_ns: int  # CLOCK_REALTIME less CLOCK_MONOTONIC
    suspended_ns: int  # for how long the machine was suspended since the last cycle; now_ns stood still
    lateness_ns: int  # of this cycle's wake-up
    cycle_time_ns: int  # of the cycle before


class LatchedFault(OwnedRecord, writers=("safety.faults",)):
    """The fault that stands until it is cleared."""

    code: int  # shm.words.Fault
    joint: int  # -1: of no single one
    value: float
    limit: float
    latched_ns: int
    silent: int  # joint mask; as the next, only for the sentence of STALE_READING
    evidence: int  # bits of shm.words.Evidence


class Dialogue(
    OwnedRecord,
    writers=("commands", "memory.modes", "safety.faults"),
):
    """What the main thread is asked to do, and how far it is."""

    bring_up_asked: int
    release_asked: int
    home_asked: int  # joint mask
    reference_asked: int  # joint mask; `asked_rad` of each is its angle
    referencing_ends: int  # 1: a person, a fault or a shutdown ends what HOME or REFERENCE began
    referencing_joint: int
    pose_due_ns: int  # being homed at the start: 1; homed, and nothing was requested since: until when
    healed_ns: int  # when the arm went on after a stall by itself last, since a person brought it up; 0 never


class Gripper(OwnedRecord, writers=("commands.operator", "commands.request_reader")):
    """What the gripper was asked for last; the other thread looks for a new sequence."""

    kind: int  # shm.words.Request
    position_rad: float
    effort: float
    sequence: int  # of the request, written last
    halted: int  # of the newest one that a person's stop or hold has ended


class History(OwnedRecord, writers=("cycle",)):
    """Commanded positions of the last cycles."""

    next: int
    time_ns: Annotated[Ints, HISTORY_SLOTS]
    position_rad: Annotated[Floats, HISTORY_SLOTS * MAX_JOINTS]


class Published(OwnedRecord, writers=("memory.events", "publish")):
    """What of the snapshot stands in the state file as it is, and need not be written again."""

    cycle: int
    results_decided: int
    decisions_shown: int  # 1: results and answers stand there
    decisions_crc: int  # of them


class Loop(OwnedRecord, writers=("memory.modes",)):
    """All of it."""

    params: Params
    stop: int  # both threads look at it, so it stands with what nobody writes
    joints: Annotated[Rows[JointParams], MAX_JOINTS]
    listeners: Annotated[Rows[Listener], LISTENERS]
    timing: Timing
    mode: int  # shm.words.Mode
    fault: LatchedFault
    motion: Motion
    operator: Operator
    front: Front
    goals: Goals
    search: Search
    clock: Clock
    dialogue: Dialogue
    gripper: Gripper
    published: Published
    axes: Annotated[Rows[Axis], MAX_JOINTS]
    paths: Annotated[Rows[Path], 2]
    waypoints: Annotated[Rows[layout.Setpoint], 2 * WINDOW_WAYPOINTS]
    history: History
    snapshot: layout.Snapshot
    record: layout.CycleRecord  # what the flight recorder adds to the snapshot; the rest of it is not used
    scratch: layout.Setpoint
    scratch_begin: layout.Begin
    scratch_request: layout.Request
    scratch_scale: float
    wake_up: Annotated[Ints, 2]  # timespecs
    clock_read: Annotated[Ints, 2]
    buses: Annotated[Rows[Bus], MAX_BUSES]
    service_in: ServiceRing  # conversation → cycle
    service_out: ServiceRing  # cycle → conversation
