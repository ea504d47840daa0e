"""Every word of the two memory files of an arm, in one table.

`/dev/shm/rtarm.<arm>.state` is written by the control process alone, `/dev/shm/rtarm.<arm>.command` by the
front (and, for requests, by anyone holding the producers' lock). The records below *are* the layout: Python
views, jitted accessors and the reference page all come from them, and their hash stands in both headers, so
that two processes built from different tables refuse each other instead of misreading.

Rules of the table
- every field is a multiple of 8 bytes wide and 8-byte aligned, so that words can be copied atomically;
- words that two processes poll stand on cache lines of their own (`LINE_BYTES`);
- a record that crosses the border starts with its CRC-32 (zlib polynomial) over the bytes that follow it, up
  to and including the last joint in use: joints stand last in each record, so a record of a six-joint arm
  costs six joints although there is room for `MAX_JOINTS`;
- what seldom changes in such a record stands first, so that its part of the CRC can be kept.
"""

import hashlib
from typing import Annotated, NamedTuple

import numpy as np

from shm.record import Bytes, Floats, Ints, Record, Rows, offset_of

MAX_JOINTS = 32
MAX_BUSES = 4
NAME_BYTES = 64
PATH_BYTES = 4096
LINE_BYTES = 128
# Counted up where words keep their names and mean something else.
MAGIC = int.from_bytes(b"rtarm\x00\x00\x02", "little")

SETPOINT_SLOTS = 4096
REQUEST_SLOTS = 64
CANCELED_SLOTS = 64
EVENT_SLOTS = 1024
RESULT_SLOTS = 16
ANSWER_SLOTS = 16
IDENTIFIER_SLOTS = 8 * MAX_JOINTS
RECORDED_NS = 33_000_000_000
"""What the flight recorder keeps: 30 s, the moment after a fault until it is read, and the reading itself."""
HISTOGRAM_SUB_BITS = 6
HISTOGRAM_BUCKETS = 2048

LineWord = Annotated[Ints, LINE_BYTES // 8]
"""A word, on a line of its own."""
TABLES: list[type[Record]] = []
"""All tables, in the order of the reference page."""


class Table(Record):
    """A record of the two files; the first line of its docstring is its name on the reference page."""

    def __init_subclass__(cls, *, line_bytes: int = 0) -> None:
        super().__init_subclass__(line_bytes=line_bytes)
        TABLES.append(cls)


class Header(Table):
    """Header."""

    magic: Annotated[int, "'rtarm', version 1"]
    layout_hash: Annotated[int, "hash of this table"]
    arm_hash: Annotated[int, "hash of the arm's configuration"]
    pid: Annotated[int, "process that built the file (for people; liveness is the flock)"]
    start_monotonic_ns: Annotated[int, "ns", "CLOCK_MONOTONIC at creation"]
    start_epoch_ns: Annotated[int, "ns", "CLOCK_REALTIME at creation"]
    period_ns: Annotated[int, "ns", "control period"]
    joint_count: Annotated[int, "joints in use"]
    arm_name: Annotated[Bytes, NAME_BYTES, "name of the arm, UTF-8"]
    joint_names: Annotated[Bytes, MAX_JOINTS * NAME_BYTES, "names of the joints in configuration order"]
    bitrates: Annotated[Ints, MAX_BUSES, "bit/s", "bit rate of each bus, 0 where there is none"]
    bus_names: Annotated[Bytes, MAX_BUSES * NAME_BYTES, "names of the buses, empty where they have none"]
    arm_file_hash: Annotated[int, "hash of what the arm file says, without options"]
    options: Annotated[int, "1 where options change what the arm file says"]
    padding: Annotated[Ints, 10]
    arm_file: Annotated[
        Bytes,
        PATH_BYTES,
        "name of an arm that comes with rtarm, or absolute path of the arm file, UTF-8; empty where it has none",
    ]


class Scheduling(Table, line_bytes=LINE_BYTES):
    """Scheduling."""

    policy: Annotated[int, "scheduling policy read back from the kernel (0 other, 1 FIFO, 2 RR)"]
    priority: Annotated[int, "real-time priority read back"]
    memory_locked: Annotated[int, "1 when what the cycle uses is locked"]
    cpu: Annotated[int, "CPU the cycle is pinned to, -1 when free"]
    dma_latency_held: Annotated[int, "1 while /dev/cpu_dma_latency is held at 0"]
    thread_id: Annotated[int, "the kernel's id of the thread that runs the cycle"]


class Joint(Table):
    """Joint."""

    commanded_position_rad: Annotated[float, "rad", "setpoint of this cycle"]
    commanded_velocity_rad_s: Annotated[float, "rad/s", "its velocity"]
    commanded_acceleration_rad_s2: Annotated[float, "rad/s²", "its acceleration"]
    measured_position_rad: Annotated[float, "rad", "what the encoder said last"]
    measured_velocity_rad_s: Annotated[float, "rad/s", "as the drive measures it, else between the last two readings"]
    measured_effort: Annotated[float, "Nm", "NaN where the drive measures none"]
    measured_ns: Annotated[int, "ns", "CLOCK_MONOTONIC at which the encoder was read; 0 = never"]
    reference_position_rad: Annotated[float, "rad", "commanded position at measured_ns"]
    reference_velocity_rad_s: Annotated[float, "rad/s", "commanded velocity at measured_ns"]
    drive_temperature_c: Annotated[float, "°C", "the highest that the drive tells; NaN where it tells none"]
    drive_voltage_v: Annotated[float, "V", "its supply; NaN where it tells none"]
    drive_status: Annotated[int, "drive status bits, common to all families (shm.words.DriveStatus)"]
    referenced: Annotated[int, "1 when the drive's count is known to mean a joint angle"]
    unreferenced_reason: Annotated[int, "shm.words.Unreferenced"]


class Result(Table):
    """Result."""

    goal_id: Annotated[int, "goal this result belongs to; each decision takes the next row, round and round"]
    outcome: Annotated[int, "shm.words.Outcome; 0: nothing was decided here yet"]
    joint: Annotated[int, "joint it is about, -1 for none"]
    value: Annotated[float, "the value that decided"]
    limit: Annotated[float, "what was allowed"]
    monotonic_ns: Annotated[int, "ns", "when it was decided"]


class Answer(Table):
    """Answer."""

    sequence: Annotated[int, "request answered; slot = sequence % ANSWER_SLOTS"]
    answer: Annotated[int, "shm.words.Answer"]


class Changing(Record):
    """The words of a snapshot that change in every cycle."""

    cycle: Annotated[int, "number of this cycle"]
    monotonic_ns: Annotated[int, "ns", "planned time of this cycle, CLOCK_MONOTONIC"]
    epoch_ns: Annotated[int, "ns", "the same instant on CLOCK_REALTIME (ROS time)"]
    mode: Annotated[int, "shm.words.Mode"]
    fault: Annotated[int, "latched fault, shm.words.Fault; 0 none"]
    fault_joint: Annotated[int, "joint it names, -1 for none; STALE_READING: -1 for all"]
    fault_value: Annotated[float, "value that broke the limit"]
    fault_limit: Annotated[float, "the limit; WIRE, LINK_DOWN, BUS_OFF: number of the bus, from 0"]
    fault_ns: Annotated[int, "ns", "CLOCK_MONOTONIC when it was latched"]
    fault_silent: Annotated[int, "STALE_READING: bit n = the drive of joint n was silent then; else 0"]
    fault_evidence: Annotated[int, "STALE_READING: shm.words.Evidence, bits; else 0"]
    goal_id: Annotated[int, "goal being executed or stopped, 0 none"]
    goal_phase: Annotated[int, "shm.words.Phase"]
    trajectory_clock_ns: Annotated[float, "ns", "time along the trajectory"]
    trajectory_end_ns: Annotated[int, "ns", "its duration once END is known, else -1"]
    speed_scale: Annotated[float, "present rate of the trajectory clock"]
    speed_scale_target: Annotated[float, "where the speed scale is going"]
    speed_scale_asked: Annotated[float, "what people asked for, 0…1; the scale goes there unless something stops"]
    motion_started: Annotated[int, "1 once the first motion frame was sent since bring-up"]
    referencing_joint: Annotated[int, "joint that is being homed or referenced, -1 for none"]
    pose_due: Annotated[int, "1: just homed at the start, and nobody has asked for anything since"]
    held: Annotated[int, "1: a person has stopped or holds the arm; nothing that moves it begins before a resume"]
    stops: Annotated[int, "how often a person has stopped the arm"]
    epoch: Annotated[
        int,
        "from the loop's start (ns), rises with every stop, hold, resume, fault, letting go, bring-up and homing run "
        "(begin and end): what arrived in an earlier one never begins",
    ]
    joints: Annotated[Rows[Joint], MAX_JOINTS, "one record a joint"]


class Snapshot(Changing, Table):
    """Snapshot."""

    crc: Annotated[int, "CRC-32 of the bytes that follow, joints in use included"]
    results: Annotated[Rows[Result], RESULT_SLOTS, "the newest results"]
    answers: Annotated[Rows[Answer], ANSWER_SLOTS, "answers to the newest requests"]


class Counted(Record):
    """The counters that the flight recorder keeps with every cycle, over all buses of the arm."""

    overruns: Annotated[int, "cycles missed because one began or ended late; never made up"]
    frames_sent: Annotated[int, "CAN frames written"]
    frames_received: Annotated[int, "CAN frames decoded"]
    bits_on_bus: Annotated[int, "bit", "worst-case stuffed bits of both"]
    bytes_sent: Annotated[int, "bytes written to the wire"]
    bytes_received: Annotated[int, "bytes read from the wire"]
    wire_errors: Annotated[int, "BEL and garbled lines"]
    bytes_unsent: Annotated[int, "bytes the wire did not take in their cycle"]
    receive_overflows: Annotated[int, "bytes lost because the cycle did not take them in time"]
    stale_reads: Annotated[int, "cycles in which a drive's reading was older than the age ladder's first rung"]
    drive_errors: Annotated[int, "commands a drive refused or did not understand"]
    knots_taken: Annotated[int, "waypoints taken from the setpoint ring"]
    error_frames: Annotated[int, "errors that the CAN controller has told of (SocketCAN)"]
    unacknowledged: Annotated[int, "those of them in which no drive acknowledged a frame"]
    bus_state: Annotated[
        int, "shm.words.BusState: what the CAN controller thinks of its bus (SocketCAN); of several, the worst"
    ]


class Counters(Counted, Table, line_bytes=LINE_BYTES):
    """Counters."""

    cycles: Annotated[int, "cycles run"]


class BusCounters(Table, line_bytes=LINE_BYTES):
    """Counters of a bus."""

    frames_sent: Annotated[int, "CAN frames written to its wire"]
    frames_received: Annotated[int, "CAN frames decoded that came on it"]
    bits_on_bus: Annotated[int, "bit", "worst-case stuffed bits of both"]
    wire_errors: Annotated[int, "BEL and garbled lines of its adapter"]
    bytes_unsent: Annotated[int, "bytes its wire did not take in their cycle"]
    error_frames: Annotated[int, "errors that its CAN controller has told of (SocketCAN)"]
    unacknowledged: Annotated[int, "those of them in which no drive acknowledged a frame"]
    bus_state: Annotated[int, "shm.words.BusState: what its CAN controller thinks of it (SocketCAN)"]


BUS_TROUBLE = (
    "wire_errors",
    "bytes_unsent",
    "receive_overflows",
    "stale_reads",
    "drive_errors",
    "error_frames",
    "unacknowledged",
)
"""The counters that stand still while all is well with wire and bus."""


class Histogram(Table, line_bytes=LINE_BYTES):
    """Histogram."""

    max_ns: Annotated[int, "ns", "largest value recorded"]
    count: Annotated[int, "values recorded"]
    sum_ns: Annotated[int, "ns", "their sum"]
    buckets: Annotated[Ints, HISTOGRAM_BUCKETS, "counts, logarithmic buckets (shm.histogram)"]


class Event(Table):
    """Event."""

    monotonic_ns: Annotated[int, "ns", "CLOCK_MONOTONIC"]
    kind: Annotated[int, "shm.words.Event"]
    joint: Annotated[int, "joint it is about, -1 for none"]
    code: Annotated[int, "mode, fault, outcome, bus … according to the kind"]
    value: float
    limit: float
    silent: Annotated[int, "FAULT: as the snapshot's fault_silent"]
    evidence: Annotated[int, "FAULT: as the snapshot's fault_evidence"]


class Consumed(Table, line_bytes=LINE_BYTES):
    """Consumed."""

    setpoints: Annotated[int, "records taken from the setpoint ring"]
    requests: Annotated[int, "requests taken from the request ring"]


class JointLimits(Table):
    """Limits of a joint."""

    lower_rad: Annotated[float, "rad", "lower position limit"]
    upper_rad: Annotated[float, "rad", "upper position limit"]
    max_velocity_rad_s: Annotated[float, "rad/s", "velocity limit"]
    max_acceleration_rad_s2: Annotated[float, "rad/s²", "acceleration limit"]
    homes: Annotated[int, "1 where its drive can find a stop by itself, so that homing is a run"]
    reserved: Annotated[Ints, 3]


class Limits(Table):
    """Limits."""

    velocity_margin: Annotated[float, "the last line of defence allows this factor of a velocity limit"]
    acceleration_margin: Annotated[float, "the same of an acceleration limit"]
    braking_factor: Annotated[float, "braking may use this factor of an acceleration limit"]
    following_error_rad: Annotated[float, "rad", "largest |commanded - measured|"]
    position_jump_rad: Annotated[float, "rad", "largest jump of a reading that is believed"]
    stale_brake_ns: Annotated[int, "ns", "age of a reading at which the arm brakes"]
    stale_fault_ns: Annotated[int, "ns", "age of a reading at which a fault is latched"]
    front_timeout_ns: Annotated[int, "ns", "silence of the front after which the arm stops"]
    longest_stop_s: Annotated[float, "s", "every stop on the path ends within this"]
    padding: Annotated[Ints, 7]
    joints: Annotated[Rows[JointLimits], MAX_JOINTS, "one record a joint"]


class Identifiers(Table):
    """Identifiers of a drive."""

    match: Annotated[int, "they have its bits where `mask` has ones"]
    mask: Annotated[int, "0 = there are no more rows"]
    extended: Annotated[int, "1 where they have 29 bits"]
    joint: Annotated[int, "the joint whose drive hears or says them"]
    bus: Annotated[int, "the bus that it is on, from 0"]


class Recorder(Table, line_bytes=LINE_BYTES):
    """Flight recorder."""

    record_bytes: Annotated[int, "size of a cycle's record, the arm's joints included"]
    record_slots: Annotated[int, "records that the ring of cycles has room for; it begins behind this table"]
    frame_slots: Annotated[int, "frames that the ring of frames has room for; it follows the ring of cycles"]


class CycleRecord(Counted, Changing, Table):
    """Flight recorder's record of a cycle."""

    crc: Annotated[
        int,
        "CRC-32 of results and answers (`decisions_crc`), then of all from `cycle` on, then of what lies between",
    ]
    decisions_crc: Annotated[int, "CRC-32 of the snapshot's results and answers"]
    number: Annotated[int, "number of this record, from 0; slot = number % record_slots"]
    lateness_ns: Annotated[int, "ns", "wake-up lateness of this cycle"]
    cycle_time_ns: Annotated[int, "ns", "computing time of the cycle before"]
    heartbeat_ns: Annotated[int, "ns", "the front's last sign of life (CLOCK_MONOTONIC)"]
    slowed: Annotated[int, "why the arm is slowed down or stopped, shm.words.Slowed"]
    ending: Annotated[int, "shm.words.Outcome that the goal gets once the arm stands; 0 = it goes on"]


class BusFrame(Table):
    """Flight recorder's record of a CAN frame."""

    check: Annotated[int, "mixed of number and the words that follow (shm.recording.frame_check)"]
    monotonic_ns: Annotated[int, "ns", "arrival of its bytes, or the cycle that sent it (CLOCK_MONOTONIC)"]
    head: Annotated[int, "identifier, length << 32, 1 << 40 if extended, 1 << 41 if sent, 1 << 42 if remote, bus << 43"]
    data: Annotated[int, "eight bytes, the first lowest"]


class Gripper(Table, line_bytes=LINE_BYTES):
    """Gripper on the bus.

    Written by the control process' ordinary Python, a few times a second; the cycle does not touch it.
    """

    crc: Annotated[int, "CRC-32 of the bytes that follow"]
    written: Annotated[int, "how often this record has been written; 0 = there is no gripper on the bus"]
    monotonic_ns: Annotated[int, "ns", "CLOCK_MONOTONIC at which it was written"]
    order: Annotated[int, "sequence of the newest request that has been obeyed, 0 = none"]
    grip: Annotated[int, "what it is doing: motion.gripping.Grip"]
    trouble: Annotated[int, "shm.words.GripTrouble"]
    trouble_value: Annotated[float, "the value it is about"]
    measured_ns: Annotated[int, "ns", "CLOCK_MONOTONIC at which its position was heard; 0 = never"]
    position_rad: Annotated[float, "rad", "what its encoder said last"]
    velocity_rad_s: Annotated[float, "rad/s", "difference of the last two readings"]
    measured_effort: Annotated[float, "Nm", "NaN where it is not measured"]
    target_rad: Annotated[float, "rad", "where it was last told to go, NaN = nowhere"]


class StateFile(Table):
    """State file (written by the control process).

    The fixed part of it: the flight recorder's two rings follow, in sizes that fit the arm.
    """

    header: Header
    scheduling: Annotated[Scheduling, "what real-time set-up was really obtained"]
    consumed: Annotated[Consumed, "how far the loop has read the command file"]
    snapshot_sequence: Annotated[LineWord, "seqlock of the snapshot in its first word: odd while it is written"]
    snapshot: Snapshot
    padding: Annotated[Ints, -Snapshot.dtype.itemsize % LINE_BYTES // 8]
    counters: Counters
    buses: Annotated[Rows[BusCounters], MAX_BUSES, "what is counted of each bus as well"]
    lateness: Annotated[Histogram, "wake-up lateness against the planned deadline"]
    cycle_time: Annotated[Histogram, "from wake-up to the end of the write"]
    events_written: Annotated[LineWord, "events ever written in its first word; slot = number % EVENT_SLOTS"]
    events: Annotated[Rows[Event], EVENT_SLOTS, "history, overwritten from the oldest"]
    limits: Annotated[Limits, "what the arm's configuration allows"]
    identifiers: Annotated[Rows[Identifiers], IDENTIFIER_SLOTS, "whose frames are whose; those of several left out"]
    gripper: Annotated[Gripper, "the gripper, where it is a drive on the arm's bus"]
    recorder: Recorder
    records_written: Annotated[LineWord, "records of cycles ever written, in its first word"]
    frames_written: Annotated[LineWord, "records of frames ever written, in its first word"]


class SetpointJoint(Table):
    """Setpoint joint."""

    position_rad: Annotated[float, "rad", ""]
    velocity_rad_s: Annotated[float, "rad/s", ""]
    acceleration_rad_s2: Annotated[float, "rad/s²", ""]


class Setpoint(Table):
    """Setpoint (WAYPOINT and END)."""

    crc: Annotated[int, "CRC-32 of the bytes that follow, joints in use included"]
    sequence: Annotated[int, "number of this record in the ring, from 0"]
    goal_id: Annotated[int, "goal it belongs to"]
    kind: Annotated[int, "shm.words.Setpoint: BEGIN, WAYPOINT or END"]
    time_ns: Annotated[int, "ns", "WAYPOINT: time from the start of the trajectory, strictly rising"]
    order: Annotated[int, "WAYPOINT: order of the segment that ends here: 1 linear, 3 cubic, 5 quintic"]
    reserved: Annotated[Ints, 3]
    joints: Annotated[
        Rows[SetpointJoint],
        MAX_JOINTS,
        "WAYPOINT: complete, derived fields filled in by the front; END: the tolerances at the end, as in BEGIN",
    ]


class Begin(Table):
    """Setpoint (BEGIN: the same record, seen as a goal's opening)."""

    crc: Annotated[int, "as above"]
    sequence: Annotated[int, "as above"]
    goal_id: Annotated[int, "1, 2, 3 …; never reused while the loop lives"]
    kind: Annotated[int, "shm.words.Setpoint.BEGIN"]
    start_ns: Annotated[
        int,
        "ns",
        "CLOCK_MONOTONIC at which the trajectory's time is (or was) 0: it is entered where it is due by then; 0 "
        "= at once, at its beginning",
    ]
    joint_mask: Annotated[int, "bit i: joint i is part of the goal; the others come to rest and hold"]
    goal_time_s: Annotated[float, "s", "patience after the last point; 0 = without limit"]
    entry: Annotated[int, "shm.words.Entry: how it begins and ends"]
    epoch: Annotated[int, "the snapshot's `epoch` when the goal arrived; in a later one it is refused"]
    joints: Annotated[
        Rows[SetpointJoint],
        MAX_JOINTS,
        "tolerances on the way: largest |commanded - measured|, accelerations smoothed; 0 = off",
    ]


class Request(Table):
    """Request."""

    crc: Annotated[int, "CRC-32 of the bytes that follow"]
    sequence: Annotated[int, "number of this request, from 1"]
    kind: Annotated[int, "shm.words.Request"]
    value: Annotated[float, "REFERENCE: the joint's angle (rad), NaN = as it counts; GRIP: angle (rad)"]
    monotonic_ns: Annotated[int, "ns", "when it was made"]
    joint_mask: Annotated[int, "HOME, REFERENCE: bit n = joint n; HOME: 0 = the arm file's homing.order"]
    epoch: Annotated[int, "the snapshot's when it was made: in a later one nothing that moves is begun for it"]
    most_effort: Annotated[float, "GRIP: most torque at its joint (Nm), 0 = as much as it has"]


class CommandFile(Table):
    """Command file (written by the front)."""

    header: Header
    front_pid: Annotated[LineWord, "pid of the front that last took the file, in its first word"]
    heartbeat_ns: Annotated[LineWord, "ns", "CLOCK_MONOTONIC of the front's last sign of life, in its first word"]
    announced_goal: Annotated[LineWord, "newest goal whose records are (being) written, in its first word"]
    setpoints_written: Annotated[LineWord, "records ever written to the ring, in its first word"]
    stop_ns: Annotated[
        LineWord,
        "ns",
        "CLOCK_MONOTONIC of a person's newest stop, in its first word; who asked (pid) in its second",
    ]
    hold_ns: Annotated[LineWord, "ns", "the same of the newest hold"]
    resume_ns: Annotated[LineWord, "ns", "the same of the newest resume, which ends the stops and holds before it"]
    speed_scale: Annotated[
        Floats,
        LINE_BYTES // 8,
        "newest speed scale 0…1 (0 = nobody has asked, -0 = stands still), who asked (pid)",
    ]
    canceled_through: Annotated[LineWord, "all goals up to this one are canceled, in its first word"]
    canceled_goals: Annotated[Ints, CANCELED_SLOTS, "canceled goals, slot = goal_id % CANCELED_SLOTS"]
    requests_written: Annotated[LineWord, "requests ever written, in its first word"]
    requests: Annotated[Rows[Request], REQUEST_SLOTS, "slot = (sequence - 1) % REQUEST_SLOTS"]
    setpoints: Annotated[Rows[Setpoint], SETPOINT_SLOTS, "slot = sequence % SETPOINT_SLOTS"]


assert Begin.dtype.itemsize == Setpoint.dtype.itemsize  # one record, two readings


def used_bytes(record: type[Record], joint_count: int) -> int:
    """Bytes of a joints-last record that an arm of `joint_count` joints uses."""
    return offset_of(record, "joints") + joint_count * record.dtype["joints"].base.itemsize


class Rings(NamedTuple):
    """Sizes of the flight recorder's rings, which stand behind the fixed part of the state file."""

    record_bytes: int
    record_slots: int
    frame_slots: int

    @property
    def frames_at(self) -> int:
        """Offset of the ring of frames in the state file."""
        return StateFile.dtype.itemsize + self.record_bytes * self.record_slots

    @property
    def file_bytes(self) -> int:
        """Size of the whole state file."""
        return self.frames_at + BusFrame.dtype.itemsize * self.frame_slots

    def described(self) -> np.ndarray:
        """What the state file's `recorder` says of them."""
        said = np.zeros((), Recorder.dtype)
        for name, value in self._asdict().items():
            said[name] = value
        return said


def rings(joint_count: int, period_ns: int, *bitrates: int) -> Rings:
    """The rings that keep `RECORDED_NS` of an arm's cycles, and of the frames that they send and get answered.

    A cycle sends three frames to each joint and on each bus asks one of them for its status; what others say besides
    shortens the time that the ring of frames goes back. `bitrates` are those of the buses, 0 where there is none.
    """
    slots = -(-RECORDED_NS // period_ns)
    buses = sum(bitrate > 0 for bitrate in bitrates)
    frames = slots * (4 * joint_count + 2 * buses) if buses > 0 else 0
    return Rings(used_bytes(CycleRecord, joint_count), slots, frames)


def layout_hash() -> int:
    """63-bit hash of the two file layouts: names, types, offsets of every word."""

    def describe(dtype: np.dtype) -> object:
        base = dtype.base
        if base.fields is None:
            return (base.str, dtype.shape)
        return ([(n, base.fields[n][1], describe(base.fields[n][0])) for n in base.fields], dtype.shape)

    described = [describe(record.dtype) for record in (StateFile, CycleRecord, BusFrame, CommandFile)]
    text = repr((MAX_JOINTS, RECORDED_NS, *described))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1
