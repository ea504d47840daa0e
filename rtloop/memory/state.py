"""Everything the cycle remembers, as one structured record: `step(loop, shared, now_ns)` is a function of it.

`LOOP` is private to the control process; what others may see is copied into the state file's snapshot at the
end of a cycle. One record instead of objects keeps the compiled cycle free of allocation and makes a state
something that can be copied, compared and replayed.
"""

import numpy as np

from shm import layout
from shm.layout import MAX_JOINTS

WINDOW_KNOTS = 4096
"""Knots the loop keeps of a trajectory: at least its stopping distance at any sensible spacing."""
HISTORY_SLOTS = 256
"""Cycles of commanded positions kept, to compare a measurement with the command of its own instant: the age at which a
drive counts as silent (0.1 s), at the highest rate (2000 Hz)."""
SERVICE_SLOTS = 256
TX_BYTES = 8192
RX_BYTES = 1 << 16
RX_CHUNKS = 1024
LINE_BYTES = 64
READ_BYTES = 4096
CAN_FRAME_BYTES = 16
"""`struct can_frame`; the receive ring holds a whole number of them."""
TX_FRAMES = TX_BYTES // CAN_FRAME_BYTES
RX_FRAMES = READ_BYTES // CAN_FRAME_BYTES
LISTENERS = 8 * MAX_JOINTS
FRESH_READINGS = 3
"""A reading that is as old as so many that should have come since tells nothing of where the joint is."""
NOT_LED = -1
"""A drive that was adopted where it stands, and has been told nothing since."""
NOBODY, GRIPPER = -1, -2
"""Whose frame it is, where it is no joint's; those of a gripper's drive belong to its conversation."""
BLEND_SAMPLES = 32

WIRE_MOCK = 0
WIRE_SLCAN = 1
WIRE_SOCKETCAN = 2
WIRE_SEEED = 3
WIRE_AT = 4
WIRE_PYTHON_CAN = 5
WIRES = {
    "mock": WIRE_MOCK,
    "slcan": WIRE_SLCAN,
    "socketcan": WIRE_SOCKETCAN,
    "seeedstudio": WIRE_SEEED,
    "ch340-at": WIRE_AT,
    "python-can": WIRE_PYTHON_CAN,
}

FAMILY_MOCK = 0
"""A joint's family is its place among `config.joint.FAMILIES`, whose first is no drive at all."""

SLCAN_LONGEST_LINE = 27
QUESTIONS = 2
"""Questions for one drive's position that are taken to be open at most: an answer may come a cycle late, or never."""

PARAMS = np.dtype(
    [
        ("joint_count", "i8"),
        ("listener_count", "i8"),
        ("homing_mask", "i8"),  # joints of the arm's homing run
        ("period_ns", "i8"),
        ("wire", "i8"),
        ("address", "i8"),  # of this record itself
        ("state_address", "i8"),  # of the mapped state file
        ("command_address", "i8"),  # of the mapped command file
        ("start_tolerance_rad", "f8"),
        ("velocity_margin", "f8"),
        ("acceleration_margin", "f8"),
        ("braking_factor", "f8"),
        ("following_error_rad", "f8"),
        ("position_jump_rad", "f8"),
        ("stale_brake_ns", "i8"),
        ("stale_fault_ns", "i8"),
        ("front_timeout_ns", "i8"),
        ("longest_stop_s", "f8"),
        ("drives_patience_ns", "i8"),  # for drives that brake by themselves
        ("has_gripper", "i8"),  # 1: a drive on the bus moves a gripper
        ("gripper_lower_rad", "f8"),
        ("gripper_upper_rad", "f8"),
        ("service_bits", "i8"),  # bits of bus time a cycle may use in all, service frames included
        ("reported", "i8"),  # 1: drives send their positions by themselves
        ("reading_ns", "i8"),  # between two positions of a drive
        ("fast_targets", "i8"),  # 1: targets are sent with FC, to drives that are known to take it as absolute
        ("report_overdue_ns", "i8"),  # age above which a report that is missing is asked for
        ("simulated", "i8"),  # 1: the wire is a pseudo-terminal, behind which a program is the drives
    ]
)

JOINT_PARAMS = np.dtype(
    [
        ("family", "i8"),
        ("address", "i8"),
        ("command_per_rad", "f8"),  # what the drive is told (ZDT: pulses) for a radian; the joint's direction is in it
        ("reading_per_rad", "f8"),  # what it tells (ZDT: encoder counts), likewise
        ("reading_step_rad", "f8"),  # the least that two readings can differ
        ("zero_rad", "f8"),
        ("knows_its_angle", "i8"),  # 1: what it tells means an angle as soon as it has power
        ("lower_rad", "f8"),
        ("upper_rad", "f8"),
        ("slack_rad", "f8"),  # what rounding to pulses and counts may put a joint at its limit beyond it
        ("max_velocity_rad_s", "f8"),
        ("max_acceleration_rad_s2", "f8"),
        ("silence_deceleration_rad_s2", "f8"),
        ("acc_byte", "i8"),
        ("status_timeout_ns", "i8"),  # within which a drive says its status by itself, 0 where it is asked
        ("effort_per_unit", "f8"),  # torque at the joint (Nm) for one of what the drive tells, 0 = it tells none
        # what the fields of a drive's frames reach either way, at its own shaft; 0 where that is fixed
        ("range_rad", "f8"),
        ("range_rad_s", "f8"),
        ("range_nm", "f8"),
        ("stiffness_nm_rad", "f8"),  # with which it follows set-points, at its own shaft; 0 where that is its own
        ("damping_nm_s_rad", "f8"),
        ("plans_its_motion", "i8"),  # 1: it goes to targets with a ramp of its own
        ("position_bytes", "i8"),  # length of the frame that tells its position, where that is a setting
        ("gains_word", "i8"),  # stiffness and damping as the frames hold them, where they come with each set-point
        ("position_gain_1_s", "f8"),  # of its own position loop, 0 where that is not needed
        ("host_id", "i8"),  # what it answers to, where that stands in its identifiers
        ("rpm_per_rad_s", "f8"),
        ("command_delay_s", "f8"),  # from the start of the cycle until its target has reached the drive
        ("reply_delay_ns", "i8"),  # from the drive's reading of its encoder until the reply has arrived
        ("report_delay_ns", "i8"),  # the same of a report, which nobody asked for
    ]
)

AXIS = np.dtype(
    [
        # what is commanded: at this cycle, and at the next (which the frames of this cycle carry)
        ("position_rad", "f8"),
        ("velocity_rad_s", "f8"),
        ("acceleration_rad_s2", "f8"),
        ("next_position_rad", "f8"),
        ("next_velocity_rad_s", "f8"),
        ("next_acceleration_rad_s2", "f8"),
        ("difference_velocity_rad_s", "f8"),  # of the last two commanded positions, for the last defence
        ("ahead_rad", "f8"),  # of a setpoint that is only looked at
        ("ahead_rad_s", "f8"),  # difference_velocity_rad_s of it
        # what is measured
        ("measured_rad", "f8"),
        ("measured_velocity_rad_s", "f8"),
        ("measured_ns", "i8"),
        ("reference_rad", "f8"),
        ("reference_velocity_rad_s", "f8"),  # mean between the last two readings, as measured_velocity_rad_s is
        ("error_acceleration_rad_s2", "f8"),  # smoothed change of the error in velocity
        ("error_before_rad", "f8"),  # of the reading before this one, as the next two
        ("velocity_error_before_rad_s", "f8"),
        ("error_acceleration_before_rad_s2", "f8"),
        ("lag_ns", "i8"),  # how much older than its stamp the reading may be, because its question waited so long
        ("lag_rad", "f8"),  # what was commanded meanwhile
        ("readings", "i8"),
        ("asked_cycle", "i8"),  # the last one in which a command has asked it for its position as well
        ("led_cycle", "i8"),  # the last one in which it was led, where that is told apart; NOT_LED since it was adopted
        ("let_go", "i8"),  # 1: it was told to let go, and has said so
        ("brake_released", "i8"),  # 1: it has said that its brake is released
        ("holds_stalled", "i8"),  # 1: it goes on holding where it stalls, and says no more than that it does
        ("questions", "i8"),  # for its position that may still be answered, QUESTIONS at most
        ("unasked", "i8"),  # positions that came although no question was left: reports
        ("heard", "i8"),  # 1: a position came since the last cycle
        ("heard_unasked", "i8"),  # 1: a report was among what came
        ("heard_rad", "f8"),  # the last one that did
        ("heard_ns", "i8"),
        ("doubted", "i8"),  # 1: the last reading was implausible and waits for the next one to agree
        ("doubted_rad", "f8"),
        ("bad_statuses", "i8"),  # statuses in a row that say the drive does not hold its position
        ("refusals", "i8"),  # of motion commands since the last sound status
        # the oldest question for a position without a believable answer, or since when a report is waited for; 0 none
        ("unanswered_since_ns", "i8"),
        ("told_velocity_rad_s", "f8"),  # as the drive measures it; NaN where it does not, as the next three
        ("effort_nm", "f8"),
        ("temperature_c", "f8"),
        ("voltage_v", "f8"),
        ("lost_at_rad", "f8"),  # its last reading when its reference was lost
        ("status", "i8"),
        ("status_ns", "i8"),  # when a drive that says its status by itself has done so last
        ("error_code", "i8"),  # that its drive told last, 0 none
        ("firmware", "i8"),  # of its drive, major version << 8 | minor version, 0 where it has not told
        ("status_readings", "i8"),
        ("referenced", "i8"),
        ("unreferenced_reason", "i8"),
        ("asked_rad", "f8"),  # where a person says that the joint stands, NaN = as its drive counts
        ("power_loss_known", "i8"),  # 1: the drive's flag for lost power stays, and where it counts from is known
        ("stop_frames_due", "i8"),
        ("rpm_remainder", "f8"),
        ("fast_ready", "i8"),  # 1: its speed and ramp for FC are set, and it takes FC as absolute
        ("fast_offset_rad", "f8"),  # by which its targets lie further ahead than they should, so that it is on time
        ("behind_rad", "f8"),  # by which its targets still lie behind the setpoint, because it was not led for a while
        ("behind_rad_s", "f8"),  # how fast that grows
        ("slip_rad", "f8"),  # how far the drive may have run ahead while the loop was away
    ]
)

BLEND = np.dtype(
    [
        ("held_rad", "f8"),  # where a joint outside the goal comes to rest
        ("c0", "f8"),
        ("c1", "f8"),
        ("c2", "f8"),
        ("c3", "f8"),
        ("c4", "f8"),
        ("c5", "f8"),
        ("faded", "f8"),  # difference in acceleration, which fades first
    ]
)

PATH = np.dtype(
    [
        ("goal_id", "i8"),
        ("phase", "i8"),  # shm.words.Phase of its goal, changed by rtloop.trajectory.phases alone
        ("reason", "i8"),  # while it stops: the outcome its goal gets when the arm stands
        ("reason_joint", "i8"),
        ("reason_value", "f8"),
        ("reason_limit", "f8"),
        ("told", "i8"),  # 1: its goal is decided, also where the arm still stops
        ("settle_ns", "i8"),  # when its last point is the commanded one, 0 = not yet
        ("taken", "i8"),  # knots taken; the newest is at (taken - 1) % WINDOW_KNOTS
        ("segment", "i8"),  # knot at the start of the running segment
        ("closest_ns", "i8"),  # least time between two of its knots, other than the beginning of a bridge
        ("ended", "i8"),
        ("ends_moving", "i8"),  # 1: the last point, which is known, leaves a joint in motion
        ("torn", "i8"),  # knots are missing after the newest one
        ("start_ns", "i8"),
        ("met", "i8"),  # 1: the arm was where its goal, which has no start time, begins
        ("joint_mask", "i8"),
        ("goal_time_s", "f8"),
        ("bridge", "i8"),
        ("stream", "i8"),
        ("tolerances", layout.SETPOINT_JOINT, (MAX_JOINTS,)),  # on the way
        ("goal_tolerances", layout.SETPOINT_JOINT, (MAX_JOINTS,)),  # at the end
        ("entry_s", "f8"),  # path time at which it was entered, where the blend begins
        ("blend_s", "f8"),  # path time the blend lasts
        ("from_rest", "i8"),  # 1: it was entered by an arm at rest
        ("fade_s", "f8"),  # path time in which its difference in acceleration fades
        ("blends", BLEND, (MAX_JOINTS,)),
    ]
)

CORE = np.dtype(
    [
        ("cycle", "i8"),
        ("now_ns", "i8"),
        ("epoch_offset_ns", "i8"),
        ("suspended_ns", "i8"),  # for how long the machine was suspended since the last cycle; now_ns stood still
        ("lateness_ns", "i8"),  # of this cycle's wake-up
        ("cycle_time_ns", "i8"),  # of the cycle before
        ("mode", "i8"),
        ("fault", "i8"),
        ("fault_joint", "i8"),
        ("fault_value", "f8"),
        ("fault_limit", "f8"),
        ("fault_ns", "i8"),
        ("fault_silent", "i8"),  # joint mask; as the next, only for the sentence of STALE_READING
        ("fault_evidence", "i8"),  # bits of shm.words.Evidence
        ("healed_ns", "i8"),  # when the arm went on after a stall by itself last, since a person brought it up; 0 never
        ("own_brake", "i8"),  # each joint brakes by itself: the path cannot be trusted
        ("motion_started", "i8"),
        ("rebase_ns", "i8"),  # since when the measured positions wait to be commanded, 0 = they do not
        ("shown_cycle", "i8"),
        ("results_decided", "i8"),
        ("decisions_shown", "i8"),  # 1: results and answers stand in the state file as they are
        ("decisions_crc", "i8"),  # of them
        ("bring_up_asked", "i8"),
        ("release_asked", "i8"),
        ("home_asked", "i8"),  # joint mask
        ("reference_asked", "i8"),  # joint mask; `asked_rad` of each says where it stands
        ("referencing_ends", "i8"),  # 1: a person, a fault or a shutdown ends what HOME or REFERENCE began
        ("referencing_joint", "i8"),
        ("pose_due_ns", "i8"),  # being homed at the start: 1; homed, and nobody has asked for anything: until when
        # what the gripper was asked for last; the other thread looks for a new sequence
        ("grip_kind", "i8"),  # shm.words.Request
        ("grip_rad", "f8"),
        ("grip_effort", "f8"),
        ("grip_sequence", "i8"),  # of the request, written last
        ("grip_halted", "i8"),  # of the newest one that a person's stop or hold has ended
        ("closing", "i8"),  # a shutdown is stopping the arm
        # the goal
        ("active", "i8"),  # which of the two paths runs
        ("clock_s", "f8"),
        # the clock's rate
        ("rate", "f8"),
        ("slope", "f8"),
        ("rate_target", "f8"),
        ("rate_start", "f8"),
        ("slope_start", "f8"),
        ("ramp_s", "f8"),  # duration of the running ramp, 0 = steady
        ("ramp_elapsed_s", "f8"),
        ("ramp_factor", "f8"),  # share of the acceleration limits that it may use
        ("speed_scale", "f8"),  # what people asked for
        ("entry_rate", "f8"),  # for which the running path's blend was made
        ("held", "i8"),  # 1: a person has stopped or holds the arm, so nothing begins before a resume
        ("stop_ns", "i8"),  # the newest stop that was obeyed, as the command file has it
        ("hold_ns", "i8"),
        ("resume_ns", "i8"),
        ("stops", "i8"),  # how often a person has stopped the arm
        ("epoch", "i8"),  # goals that arrived in an earlier one never begin
        ("slowed", "i8"),  # bits of shm.words.Slowed: what slows the clock down beside what people ask for
        ("starving_ns", "i8"),
        ("arriving", "i8"),  # the last ramp ends where the path does
        # the newer goal
        ("incoming_ns", "i8"),  # when its last record came
        ("ways_tried", "i8"),  # onto it, of those that are tried from this state of the arm
        ("looks_left", "i8"),  # spans and setpoints that may still be looked at ahead in this cycle, -1: too few
        ("judged_ahead", "i8"),  # setpoints of the next way that cycles before have judged
        ("span_ahead_s", "f8"),  # path time at which they went on
        ("rate_ahead", "f8"),  # rate at which they would be entered
        ("newest_goal", "i8"),  # highest id ever begun
        ("announced_goal", "i8"),
        ("front_age_ns", "i8"),  # time between now and its last sign of life
        ("setpoints_taken", "i8"),
        ("setpoint_waits", "i8"),  # cycles the next record has not passed its CRC
        ("requests_taken", "i8"),
        ("request_waits", "i8"),
        # the wire
        ("silenced", "i8"),  # 1: the drives were out of reach and get no motion frame until they are brought up again
        ("rested", "i8"),  # 1: the arm has come to rest in a latched fault
        ("tx_length", "i8"),
        ("tx_frames", "i8"),
        ("tx_owed", "i8"),  # frames at the front that go first, whatever was decided meanwhile
        ("tx_bits", "i8"),
        ("unheard_frames", "i8"),  # given to the wire since a drive was last heard
        ("unsent_taken_back", "i8"),  # bytes of `received.arrived.unsent` that the counters know of
        ("probe_turn", "i8"),
        ("probed_ns", "i8"),
        ("service_credit_bits", "i8"),
        ("line_length", "i8"),
        ("line_spoilt", "i8"),
        ("line_needed", "i8"),  # bytes that must be collected before the next look at them
        ("status_turn", "i8"),
        ("sync_cycle", "i8"),  # in which the last SYNC left
        ("unheeded_since_ns", "i8"),  # the oldest question for a status since which no drive has told any, 0 none
        ("rx_taken", "i8"),  # bytes taken from the receive ring
        ("rx_chunks_taken", "i8"),
        ("history_next", "i8"),
    ]
)

QUIET = np.dtype(
    [
        # what happens while no drive is heard, for `rtloop.safety.silence` alone
        ("heard_ns", "i8"),  # arrival of the last frame of any drive
        ("heard_before_ns", "i8"),  # the same in the cycle before
        ("adapter_words", "i8"),  # answers of the adapter itself, where its wire tells them apart
        ("adapter_words_before", "i8"),  # in the cycle before
        ("adapter_ns", "i8"),  # cycle in which the last of them was taken
        ("spoke_ns", "i8"),  # cycle that last had anything to send
        # since a drive was heard
        ("away_ns", "i8"),  # for how long the cycle was away
        ("bytes_unsent", "i8"),  # these are the counters of then
        ("unacknowledged", "i8"),
        ("error_frames", "i8"),
        ("frames_received", "i8"),
    ]
)

FRAME = np.dtype(
    [
        ("kind", "i8"),
        ("id", "i8"),
        ("frame_kind", "i8"),  # bits of rtloop.memory.frame_words
        ("length", "i8"),
        ("joined", "i8"),  # 1: the next record must leave in the same cycle (packets of one command)
        ("data", "i8"),  # eight bytes, the first lowest
        ("time_ns", "i8"),
        ("joint", "i8"),
        ("value", "f8"),
        ("code", "i8"),
    ]
)

RING = np.dtype([("written", "i8", (16,)), ("taken", "i8", (16,)), ("records", FRAME, (SERVICE_SLOTS,))])

ARRIVED = np.dtype(
    [
        # what the reader thread says of the ring, on lines of its own (`LINE_BYTES` of shm.layout)
        ("bytes", "i8"),
        ("chunks", "i8"),
        ("lost", "i8"),
        ("closed", "i8"),  # errno + 1 once the wire is gone
        ("dropped", "i8"),  # bytes that the system had no room for, as ordinary Python found out
        ("unsent", "i8"),  # bytes that the wire had taken and did not send after all, as ordinary Python found out
        ("clock", "i8", (2,)),
        ("woke_ns", "i8"),  # when the reader last went to look for bytes, 0 = never
        ("padding", "i8", (7,)),
    ]
)

TAKEN = np.dtype([("bytes", "i8"), ("chunks", "i8"), ("padding", "i8", (14,))])  # what the cycle says of it

CHUNK = np.dtype([("time_ns", "i8"), ("end", "i8")])

WIRE = np.dtype(
    [
        ("fd", "i8"),  # what ordinary Python has opened, -1 none; on a line of its own
        ("fd_padding", "i8", (15,)),
        ("fd_in_use", "i8"),  # what the cycle's thread writes to
        ("fd_in_use_padding", "i8", (15,)),
    ]
)

MESSAGE = np.dtype(
    [
        # struct mmsghdr of Linux where pointers have 64 bits: a msghdr and what it came to
        ("name", "i8"),
        ("name_length", "i8"),
        ("parts", "i8"),  # address of its iovec
        ("part_count", "i8"),
        ("control", "i8"),
        ("control_length", "i8"),
        ("flags", "i8"),
        ("length", "i8"),
    ]
)

PART = np.dtype([("address", "i8"), ("length", "i8")])  # struct iovec

READER = np.dtype(
    [
        # of the reader's thread alone
        ("poll", "i8"),  # struct pollfd
        ("padding", "i8", (15,)),
        ("bytes", "u1", (READ_BYTES,)),
        ("messages", MESSAGE, (RX_FRAMES,)),
        ("parts", PART, (RX_FRAMES,)),
    ]
)

RECEIVED = np.dtype(
    [
        ("arrived", ARRIVED),
        ("taken", TAKEN),
        ("chunks", CHUNK, (RX_CHUNKS,)),
        ("bytes", "u1", (RX_BYTES,)),
    ]
)

LISTENER = np.dtype(
    [
        # frames whose identifier has the bits of `match` where `mask` has ones
        ("match", "i8"),
        ("mask", "i8"),
        ("kind", "i8"),  # of the frame, bits of rtloop.memory.frame_words
        ("joint", "i8"),  # or GRIPPER
    ]
)

LOOP = np.dtype(
    [
        ("params", PARAMS),
        ("stop", "i8"),  # both threads look at it, so it stands with what nobody writes
        ("joints", JOINT_PARAMS, (MAX_JOINTS,)),
        ("listeners", LISTENER, (LISTENERS,)),  # who hears which frames
        ("core", CORE),
        ("quiet", QUIET),
        ("axes", AXIS, (MAX_JOINTS,)),
        ("paths", PATH, (2,)),
        ("knots", layout.SETPOINT, (2 * WINDOW_KNOTS,)),
        ("history_ns", "i8", (HISTORY_SLOTS,)),
        ("history_rad", "f8", (HISTORY_SLOTS * MAX_JOINTS,)),
        ("snapshot", layout.SNAPSHOT),
        ("record", layout.RECORD),  # what the flight recorder adds to the snapshot; the rest of it is not used
        ("scratch", layout.SETPOINT),
        ("scratch_begin", layout.BEGIN),
        ("scratch_request", layout.REQUEST),
        ("scratch_scale", "f8"),
        ("wake_up", "i8", (2,)),  # timespecs
        ("clock", "i8", (2,)),
        ("line", "u1", (LINE_BYTES,)),
        ("tx", "u1", (TX_BYTES,)),
        ("tx_ends", "i8", (TX_FRAMES,)),  # byte behind each frame
        ("tx_joined", "u1", (TX_FRAMES,)),  # 1: the next frame belongs to the same command
        ("tx_ids", "i8", (TX_FRAMES,)),
        ("tx_kinds", "u1", (TX_FRAMES,)),  # bits of rtloop.memory.frame_words
        ("tx_stops", "i1", (TX_FRAMES,)),  # joint whose stop command it is, -1 for none
        ("tx_sizes", "i8", (TX_FRAMES,)),  # data bytes of each frame
        ("tx_data", "i8", (TX_FRAMES,)),  # the first byte lowest
        ("tx_messages", MESSAGE, (TX_FRAMES,)),
        ("tx_parts", PART, (TX_FRAMES,)),
        ("wire", WIRE),
        ("received", RECEIVED),
        ("reader", READER),
        ("service_in", RING),  # bring-up → cycle
        ("service_out", RING),  # cycle → bring-up
    ]
)


def offset_of(dtype: np.dtype, *path: str) -> int:
    """Byte offset of a nested field."""
    at = 0
    for name in path:
        assert dtype.fields is not None
        dtype, here = dtype.fields[name][:2]
        at += here
    return at
