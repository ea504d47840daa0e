"""Every word of the two memory files of an arm, in one table.

`/dev/shm/rtarm.<arm>.state` is written by the control process alone, `/dev/shm/rtarm.<arm>.command` by the
front (and, for requests, by anyone holding the producers' lock). The dtypes below *are* the layout: Python
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
from typing import NamedTuple

import numpy as np

MAX_JOINTS = 32
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


class Word(NamedTuple):
    """One field: its name, numpy type, unit ("" where it has none) and what it says."""

    name: str
    type: object
    unit: str
    meaning: str


TABLES: dict[str, list[Word]] = {}


def _record(table: str, words: list[Word]) -> np.dtype:
    """Build the dtype of a record and keep its words for the reference page."""
    TABLES[table] = words
    return np.dtype([(w.name, *w.type) if isinstance(w.type, tuple) else (w.name, w.type) for w in words])


def _padding(used_bytes: int) -> Word:
    return Word("padding", ("i8", ((-used_bytes % LINE_BYTES) // 8,)), "", "keeps writers on lines of their own")


HEADER = _record(
    "header",
    [
        Word("magic", "i8", "", "'rtarm', version 1"),
        Word("layout_hash", "i8", "", "hash of this table"),
        Word("arm_hash", "i8", "", "hash of the arm's configuration"),
        Word("pid", "i8", "", "process that built the file (for people; liveness is the flock)"),
        Word("start_monotonic_ns", "i8", "ns", "CLOCK_MONOTONIC at creation"),
        Word("start_epoch_ns", "i8", "ns", "CLOCK_REALTIME at creation"),
        Word("period_ns", "i8", "ns", "control period"),
        Word("joint_count", "i8", "", "joints in use"),
        Word("arm_name", ("u1", (NAME_BYTES,)), "", "name of the arm, UTF-8"),
        Word(
            "joint_names",
            ("u1", (MAX_JOINTS * NAME_BYTES,)),
            "",
            "names of the joints in configuration order",
        ),
        Word("bitrate", "i8", "bit/s", "bit rate of the bus, 0 where there is none"),
        Word("arm_file_hash", "i8", "", "hash of what the arm file says, without options"),
        Word("options", "i8", "", "1 where options change what the arm file says"),
        Word("padding", ("i8", (13,)), "", ""),
        Word(
            "arm_file",
            ("u1", (PATH_BYTES,)),
            "",
            "name of an arm that comes with rtarm, or absolute path of the arm file, UTF-8; empty where it has none",
        ),
    ],
)

SCHEDULING = _record(
    "scheduling",
    [
        Word("policy", "i8", "", "scheduling policy read back from the kernel (0 other, 1 FIFO, 2 RR)"),
        Word("priority", "i8", "", "real-time priority read back"),
        Word("memory_locked", "i8", "", "1 when what the cycle uses is locked"),
        Word("cpu", "i8", "", "CPU the cycle is pinned to, -1 when free"),
        Word("dma_latency_held", "i8", "", "1 while /dev/cpu_dma_latency is held at 0"),
        Word("padding", ("i8", (11,)), "", ""),
    ],
)

JOINT = _record(
    "joint",
    [
        Word("commanded_position_rad", "f8", "rad", "setpoint of this cycle"),
        Word("commanded_velocity_rad_s", "f8", "rad/s", "its velocity"),
        Word("commanded_acceleration_rad_s2", "f8", "rad/s²", "its acceleration"),
        Word("measured_position_rad", "f8", "rad", "what the encoder said last"),
        Word("measured_velocity_rad_s", "f8", "rad/s", "as the drive measures it, else between the last two readings"),
        Word("measured_effort", "f8", "Nm", "NaN where the drive measures none"),
        Word("measured_ns", "i8", "ns", "CLOCK_MONOTONIC at which the encoder was read; 0 = never"),
        Word("reference_position_rad", "f8", "rad", "commanded position at measured_ns"),
        Word("reference_velocity_rad_s", "f8", "rad/s", "commanded velocity at measured_ns"),
        Word("drive_temperature_c", "f8", "°C", "the highest that the drive tells; NaN where it tells none"),
        Word("drive_voltage_v", "f8", "V", "its supply; NaN where it tells none"),
        Word("drive_status", "i8", "", "drive status bits, common to all families (shm.words.DriveStatus)"),
        Word("referenced", "i8", "", "1 when the drive's count is known to mean a joint angle"),
        Word("unreferenced_reason", "i8", "", "shm.words.Unreferenced"),
    ],
)

RESULT = _record(
    "result",
    [
        Word("goal_id", "i8", "", "goal this result belongs to; each decision takes the next row, round and round"),
        Word("outcome", "i8", "", "shm.words.Outcome; 0: nothing was decided here yet"),
        Word("joint", "i8", "", "joint it is about, -1 for none"),
        Word("value", "f8", "", "the value that decided"),
        Word("limit", "f8", "", "what was allowed"),
        Word("monotonic_ns", "i8", "ns", "when it was decided"),
    ],
)

ANSWER = _record(
    "answer",
    [
        Word("sequence", "i8", "", "request answered; slot = sequence % ANSWER_SLOTS"),
        Word("answer", "i8", "", "shm.words.Answer"),
    ],
)

CHANGING = [
    Word("cycle", "i8", "", "number of this cycle"),
    Word("monotonic_ns", "i8", "ns", "planned time of this cycle, CLOCK_MONOTONIC"),
    Word("epoch_ns", "i8", "ns", "the same instant on CLOCK_REALTIME (ROS time)"),
    Word("mode", "i8", "", "shm.words.Mode"),
    Word("fault", "i8", "", "latched fault, shm.words.Fault; 0 none"),
    Word("fault_joint", "i8", "", "joint it names, -1 for none; STALE_READING: -1 for all"),
    Word("fault_value", "f8", "", "value that broke the limit"),
    Word("fault_limit", "f8", "", "the limit"),
    Word("fault_ns", "i8", "ns", "CLOCK_MONOTONIC when it was latched"),
    Word("fault_silent", "i8", "", "STALE_READING: bit n = the drive of joint n was silent then; else 0"),
    Word("fault_evidence", "i8", "", "STALE_READING: shm.words.Evidence, bits; else 0"),
    Word("goal_id", "i8", "", "goal being executed or stopped, 0 none"),
    Word("goal_phase", "i8", "", "shm.words.Phase"),
    Word("trajectory_clock_ns", "f8", "ns", "time along the trajectory"),
    Word("trajectory_end_ns", "i8", "ns", "its duration once END is known, else -1"),
    Word("speed_scale", "f8", "", "present rate of the trajectory clock"),
    Word("speed_scale_target", "f8", "", "where the speed scale is going"),
    Word("speed_scale_asked", "f8", "", "what people asked for, 0…1; the scale goes there unless something stops"),
    Word("motion_started", "i8", "", "1 once the first motion frame was sent since bring-up"),
    Word("referencing_joint", "i8", "", "joint that is being homed or referenced, -1 for none"),
    Word("pose_due", "i8", "", "1: just homed at the start, and nobody has asked for anything since"),
    Word("held", "i8", "", "1: a person has stopped or holds the arm; nothing that moves it begins before a resume"),
    Word("stops", "i8", "", "how often a person has stopped the arm"),
    Word(
        "epoch",
        "i8",
        "",
        "from the loop's start (ns), rises with every stop, hold, resume, fault, letting go, bring-up and homing run "
        "(begin and end): what arrived in an earlier one never begins",
    ),
    Word("joints", (JOINT, (MAX_JOINTS,)), "", "one record a joint"),
]
"""The words of a snapshot that change in every cycle."""

SNAPSHOT = _record(
    "snapshot",
    [
        Word("crc", "i8", "", "CRC-32 of the bytes that follow, joints in use included"),
        Word("results", (RESULT, (RESULT_SLOTS,)), "", "the newest results"),
        Word("answers", (ANSWER, (ANSWER_SLOTS,)), "", "answers to the newest requests"),
        *CHANGING,
    ],
)

COUNTED = [
    Word("overruns", "i8", "", "cycles missed because one began or ended late; never made up"),
    Word("frames_sent", "i8", "", "CAN frames written"),
    Word("frames_received", "i8", "", "CAN frames decoded"),
    Word("bits_on_bus", "i8", "bit", "worst-case stuffed bits of both"),
    Word("bytes_sent", "i8", "", "bytes written to the wire"),
    Word("bytes_received", "i8", "", "bytes read from the wire"),
    Word("wire_errors", "i8", "", "BEL and garbled lines"),
    Word("bytes_unsent", "i8", "", "bytes the wire did not take in their cycle"),
    Word("receive_overflows", "i8", "", "bytes lost because the cycle did not take them in time"),
    Word(
        "stale_reads",
        "i8",
        "",
        "cycles in which a drive's reading was older than the age ladder's first rung",
    ),
    Word("drive_errors", "i8", "", "commands a drive refused or did not understand"),
    Word("knots_taken", "i8", "", "waypoints taken from the setpoint ring"),
    Word("error_frames", "i8", "", "errors that the CAN controller has told of (SocketCAN)"),
    Word("unacknowledged", "i8", "", "those of them in which no drive acknowledged a frame"),
    Word("bus_state", "i8", "", "shm.words.BusState: what the CAN controller thinks of its bus (SocketCAN)"),
]
"""The counters that the flight recorder keeps with every cycle."""

COUNTERS = _record(
    "counters",
    [
        Word("cycles", "i8", "", "cycles run"),
        *COUNTED,
        _padding(8 * (1 + len(COUNTED))),
    ],
)

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

HISTOGRAM = _record(
    "histogram",
    [
        Word("max_ns", "i8", "ns", "largest value recorded"),
        Word("count", "i8", "", "values recorded"),
        Word("sum_ns", "i8", "ns", "their sum"),
        Word("buckets", ("i8", (HISTOGRAM_BUCKETS,)), "", "counts, logarithmic buckets (shm.histogram)"),
        Word("padding", ("i8", (13,)), "", ""),
    ],
)

EVENT = _record(
    "event",
    [
        Word("monotonic_ns", "i8", "ns", "CLOCK_MONOTONIC"),
        Word("kind", "i8", "", "shm.words.Event"),
        Word("joint", "i8", "", "joint it is about, -1 for none"),
        Word("code", "i8", "", "mode, fault, outcome … according to the kind"),
        Word("value", "f8", "", ""),
        Word("limit", "f8", "", ""),
        Word("silent", "i8", "", "FAULT: as the snapshot's fault_silent"),
        Word("evidence", "i8", "", "FAULT: as the snapshot's fault_evidence"),
    ],
)

CONSUMED = _record(
    "consumed",
    [
        Word("setpoints", "i8", "", "records taken from the setpoint ring"),
        Word("requests", "i8", "", "requests taken from the request ring"),
        Word("padding", ("i8", (14,)), "", ""),
    ],
)

LINE_WORD = ("i8", (LINE_BYTES // 8,))

LIMITS_JOINT = _record(
    "limits of a joint",
    [
        Word("lower_rad", "f8", "rad", "lower position limit"),
        Word("upper_rad", "f8", "rad", "upper position limit"),
        Word("max_velocity_rad_s", "f8", "rad/s", "velocity limit"),
        Word("max_acceleration_rad_s2", "f8", "rad/s²", "acceleration limit"),
        Word("homes", "i8", "", "1 where its drive can find a stop by itself, so that homing is a run"),
        Word("reserved", ("i8", (3,)), "", ""),
    ],
)

LIMITS = _record(
    "limits",
    [
        Word("velocity_margin", "f8", "", "the last line of defence allows this factor of a velocity limit"),
        Word("acceleration_margin", "f8", "", "the same of an acceleration limit"),
        Word("braking_factor", "f8", "", "braking may use this factor of an acceleration limit"),
        Word("following_error_rad", "f8", "rad", "largest |commanded - measured|"),
        Word("position_jump_rad", "f8", "rad", "largest jump of a reading that is believed"),
        Word("stale_brake_ns", "i8", "ns", "age of a reading at which the arm brakes"),
        Word("stale_fault_ns", "i8", "ns", "age of a reading at which a fault is latched"),
        Word("front_timeout_ns", "i8", "ns", "silence of the front after which the arm stops"),
        Word("longest_stop_s", "f8", "s", "every stop on the path ends within this"),
        Word("padding", ("i8", (7,)), "", ""),
        Word("joints", (LIMITS_JOINT, (MAX_JOINTS,)), "", "one record a joint"),
    ],
)

IDENTIFIERS = _record(
    "identifiers of a drive",
    [
        Word("match", "i8", "", "they have its bits where `mask` has ones"),
        Word("mask", "i8", "", "0 = there are no more rows"),
        Word("extended", "i8", "", "1 where they have 29 bits"),
        Word("joint", "i8", "", "the joint whose drive hears or says them"),
    ],
)

RECORDER = _record(
    "flight recorder",
    [
        Word("record_bytes", "i8", "", "size of a cycle's record, the arm's joints included"),
        Word("record_slots", "i8", "", "records that the ring of cycles has room for; it begins behind this table"),
        Word("frame_slots", "i8", "", "frames that the ring of frames has room for; it follows the ring of cycles"),
        Word("padding", ("i8", (13,)), "", ""),
    ],
)

RECORD = _record(
    "flight recorder's record of a cycle",
    [
        Word(
            "crc",
            "i8",
            "",
            "CRC-32 of results and answers (`decisions_crc`), then of all from `cycle` on, then of what lies between",
        ),
        Word("decisions_crc", "i8", "", "CRC-32 of the snapshot's results and answers"),
        Word("number", "i8", "", "number of this record, from 0; slot = number % record_slots"),
        Word("lateness_ns", "i8", "ns", "wake-up lateness of this cycle"),
        Word("cycle_time_ns", "i8", "ns", "computing time of the cycle before"),
        Word("heartbeat_ns", "i8", "ns", "the front's last sign of life (CLOCK_MONOTONIC)"),
        Word("slowed", "i8", "", "why the arm is slowed down or stopped, shm.words.Slowed"),
        Word("ending", "i8", "", "shm.words.Outcome that the goal gets once the arm stands; 0 = it goes on"),
        *COUNTED,
        *CHANGING,
    ],
)

BUS_FRAME = _record(
    "flight recorder's record of a CAN frame",
    [
        Word("check", "i8", "", "mixed of number and the words that follow (shm.recording.frame_check)"),
        Word("monotonic_ns", "i8", "ns", "arrival of its bytes, or the cycle that sent it (CLOCK_MONOTONIC)"),
        Word("head", "i8", "", "identifier, length << 32, 1 << 40 if extended, 1 << 41 if it was sent"),
        Word("data", "i8", "", "eight bytes, the first lowest"),
    ],
)

GRIPPER = _record(
    "gripper on the bus",
    [
        Word("crc", "i8", "", "CRC-32 of the bytes that follow"),
        Word("written", "i8", "", "how often this record has been written; 0 = there is no gripper on the bus"),
        Word("monotonic_ns", "i8", "ns", "CLOCK_MONOTONIC at which it was written"),
        Word("order", "i8", "", "sequence of the newest request that has been obeyed, 0 = none"),
        Word("grip", "i8", "", "what it is doing: motion.gripping.Grip"),
        Word("trouble", "i8", "", "shm.words.GripTrouble"),
        Word("trouble_value", "f8", "", "the value it is about"),
        Word("measured_ns", "i8", "ns", "CLOCK_MONOTONIC at which its position was heard; 0 = never"),
        Word("position_rad", "f8", "rad", "what its encoder said last"),
        Word("velocity_rad_s", "f8", "rad/s", "difference of the last two readings"),
        Word("measured_effort", "f8", "Nm", "NaN where it is not measured"),
        Word("target_rad", "f8", "rad", "where it was last told to go, NaN = nowhere"),
        Word("padding", ("i8", (4,)), "", ""),
    ],
)
"""Written by the control process' ordinary Python, a few times a second; the cycle does not touch it."""

STATE = _record(
    "state file (written by the control process)",
    [
        Word("header", HEADER, "", ""),
        Word("scheduling", SCHEDULING, "", "what real-time set-up was really obtained"),
        Word("consumed", CONSUMED, "", "how far the loop has read the command file"),
        Word(
            "snapshot_sequence",
            LINE_WORD,
            "",
            "seqlock of the snapshot in its first word: odd while it is written",
        ),
        Word("snapshot", SNAPSHOT, "", ""),
        _padding(SNAPSHOT.itemsize),
        Word("counters", COUNTERS, "", ""),
        Word("lateness", HISTOGRAM, "", "wake-up lateness against the planned deadline"),
        Word("cycle_time", HISTOGRAM, "", "from wake-up to the end of the write"),
        Word(
            "events_written",
            LINE_WORD,
            "",
            "events ever written in its first word; slot = number % EVENT_SLOTS",
        ),
        Word("events", (EVENT, (EVENT_SLOTS,)), "", "history, overwritten from the oldest"),
        Word("limits", LIMITS, "", "what the arm's configuration allows"),
        Word(
            "identifiers", (IDENTIFIERS, (IDENTIFIER_SLOTS,)), "", "whose frames are whose; those of several left out"
        ),
        Word("gripper", GRIPPER, "", "the gripper, where it is a drive on the arm's bus"),
        Word("recorder", RECORDER, "", ""),
        Word("records_written", LINE_WORD, "", "records of cycles ever written, in its first word"),
        Word("frames_written", LINE_WORD, "", "records of frames ever written, in its first word"),
    ],
)
"""The fixed part of the state file; the flight recorder's two rings follow, in sizes that fit the arm."""

SETPOINT_JOINT = _record(
    "setpoint joint",
    [
        Word("position_rad", "f8", "rad", ""),
        Word("velocity_rad_s", "f8", "rad/s", ""),
        Word("acceleration_rad_s2", "f8", "rad/s²", ""),
    ],
)

SETPOINT = _record(
    "setpoint (WAYPOINT and END)",
    [
        Word("crc", "i8", "", "CRC-32 of the bytes that follow, joints in use included"),
        Word("sequence", "i8", "", "number of this record in the ring, from 0"),
        Word("goal_id", "i8", "", "goal it belongs to"),
        Word("kind", "i8", "", "shm.words.Setpoint: BEGIN, WAYPOINT or END"),
        Word("time_ns", "i8", "ns", "WAYPOINT: time from the start of the trajectory, strictly rising"),
        Word("order", "i8", "", "WAYPOINT: order of the segment that ends here: 1 linear, 3 cubic, 5 quintic"),
        Word("reserved", ("i8", (3,)), "", ""),
        Word(
            "joints",
            (SETPOINT_JOINT, (MAX_JOINTS,)),
            "",
            "WAYPOINT: complete, derived fields filled in by the front; END: the tolerances at the end, as in BEGIN",
        ),
    ],
)

BEGIN = _record(
    "setpoint (BEGIN: the same record, seen as a goal's opening)",
    [
        Word("crc", "i8", "", "as above"),
        Word("sequence", "i8", "", "as above"),
        Word("goal_id", "i8", "", "1, 2, 3 …; never reused while the loop lives"),
        Word("kind", "i8", "", "shm.words.Setpoint.BEGIN"),
        Word(
            "start_ns",
            "i8",
            "ns",
            "CLOCK_MONOTONIC at which the trajectory's time is (or was) 0: it is entered where it is due by then; "
            "0 = at once, at its beginning",
        ),
        Word("joint_mask", "i8", "", "bit i: joint i is part of the goal; the others come to rest and hold"),
        Word("goal_time_s", "f8", "s", "patience after the last point; 0 = without limit"),
        Word(
            "entry",
            "i8",
            "",
            "shm.words.Entry: how it begins and ends",
        ),
        Word("epoch", "i8", "", "the snapshot's `epoch` when the goal arrived; in a later one it is refused"),
        Word(
            "joints",
            (SETPOINT_JOINT, (MAX_JOINTS,)),
            "",
            "tolerances on the way: largest |commanded - measured|, accelerations smoothed; 0 = off",
        ),
    ],
)

REQUEST = _record(
    "request",
    [
        Word("crc", "i8", "", "CRC-32 of the bytes that follow"),
        Word("sequence", "i8", "", "number of this request, from 1"),
        Word("kind", "i8", "", "shm.words.Request"),
        Word("value", "f8", "", "REFERENCE: the joint's angle (rad), NaN = as it counts; GRIP: angle (rad)"),
        Word("monotonic_ns", "i8", "ns", "when it was made"),
        Word("joint_mask", "i8", "", "HOME, REFERENCE: bit n = joint n; HOME: 0 = the arm file's homing.order"),
        Word("epoch", "i8", "", "the snapshot's when it was made: in a later one nothing that moves is begun for it"),
        Word("most_effort", "f8", "", "GRIP: most torque at its joint (Nm), 0 = as much as it has"),
    ],
)

COMMAND = _record(
    "command file (written by the front)",
    [
        Word("header", HEADER, "", ""),
        Word("front_pid", LINE_WORD, "", "pid of the front that last took the file, in its first word"),
        Word(
            "heartbeat_ns",
            LINE_WORD,
            "ns",
            "CLOCK_MONOTONIC of the front's last sign of life, in its first word",
        ),
        Word(
            "announced_goal",
            LINE_WORD,
            "",
            "newest goal whose records are (being) written, in its first word",
        ),
        Word("setpoints_written", LINE_WORD, "", "records ever written to the ring, in its first word"),
        Word(
            "stop_ns",
            LINE_WORD,
            "ns",
            "CLOCK_MONOTONIC of a person's newest stop, in its first word; who asked (pid) in its second",
        ),
        Word("hold_ns", LINE_WORD, "ns", "the same of the newest hold"),
        Word("resume_ns", LINE_WORD, "ns", "the same of the newest resume, which ends the stops and holds before it"),
        Word(
            "speed_scale",
            ("f8", (LINE_BYTES // 8,)),
            "",
            "newest speed scale 0…1 (0 = nobody has asked, -0 = stands still), who asked (pid)",
        ),
        Word("canceled_through", LINE_WORD, "", "all goals up to this one are canceled, in its first word"),
        Word("canceled_goals", ("i8", (CANCELED_SLOTS,)), "", "canceled goals, slot = goal_id % CANCELED_SLOTS"),
        Word("requests_written", LINE_WORD, "", "requests ever written, in its first word"),
        Word("requests", (REQUEST, (REQUEST_SLOTS,)), "", "slot = (sequence - 1) % REQUEST_SLOTS"),
        Word("setpoints", (SETPOINT, (SETPOINT_SLOTS,)), "", "slot = sequence % SETPOINT_SLOTS"),
    ],
)

assert BEGIN.itemsize == SETPOINT.itemsize  # one record, two readings


def used_bytes(record: np.dtype, joint_count: int) -> int:
    """Bytes of a joints-last record that an arm of `joint_count` joints uses."""
    joints = record.fields["joints"]  # type: ignore[index]
    return int(joints[1]) + joint_count * joints[0].base.itemsize


class Rings(NamedTuple):
    """Sizes of the flight recorder's rings, which stand behind the fixed part of the state file."""

    record_bytes: int
    record_slots: int
    frame_slots: int

    @property
    def frames_at(self) -> int:
        """Offset of the ring of frames in the state file."""
        return STATE.itemsize + self.record_bytes * self.record_slots

    @property
    def file_bytes(self) -> int:
        """Size of the whole state file."""
        return self.frames_at + BUS_FRAME.itemsize * self.frame_slots

    def described(self) -> np.ndarray:
        """What the state file's `recorder` says of them."""
        said = np.zeros((), RECORDER)
        for name, value in self._asdict().items():
            said[name] = value
        return said


def rings(joint_count: int, period_ns: int, bitrate: int) -> Rings:
    """The rings that keep `RECORDED_NS` of an arm's cycles, and of the frames that they send and get answered.

    A cycle sends three frames to each joint and asks one of them for its status; what others say besides shortens the
    time that the ring of frames goes back.
    """
    slots = -(-RECORDED_NS // period_ns)
    frames = slots * (4 * joint_count + 2) if bitrate > 0 else 0
    return Rings(used_bytes(RECORD, joint_count), slots, frames)


def layout_hash() -> int:
    """63-bit hash of the two file layouts: names, types, offsets of every word."""

    def describe(dtype: np.dtype) -> object:
        base = dtype.base
        if base.fields is None:
            return (base.str, dtype.shape)
        return ([(n, base.fields[n][1], describe(base.fields[n][0])) for n in base.fields], dtype.shape)

    text = repr((MAX_JOINTS, RECORDED_NS, *(describe(record) for record in (STATE, RECORD, BUS_FRAME, COMMAND))))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1
