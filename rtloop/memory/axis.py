"""What the cycle remembers of each joint: parameters, setpoints, measurements and the state of its drive."""

from rtloop.memory.owned_record import OwnedRecord

NOT_LED = -1
"""A drive whose setpoint was synced to where it stands, and that was commanded nothing since."""
QUESTIONS = 2
"""Questions for one drive's position that are taken to be open at most: an answer may come a cycle late, or never."""
FRESH_READINGS = 3
"""A reading that is as old as so many that should have come since is no position of the joint."""
STOP_FRAMES = 3
"""A stop command is sent so many times: a frame may be lost."""
FAMILY_MOCK = 0
"""A joint's family is its place among `config.joint.FAMILIES`, whose first is no drive at all."""


class JointParams(OwnedRecord, writers=("commands.orders",)):
    """A joint as its arm file has it, in the units of its drive."""

    family: int
    bus: int  # that its drive is on
    address: int
    command_per_rad: float  # units of a command (a stepper: pulses) for a radian; the joint's direction is in it
    reading_per_rad: float  # units of a reading (a stepper: encoder counts), likewise
    reading_step_rad: float  # the least that two readings can differ
    zero_rad: float
    knows_its_angle: int  # 1: its reading means an angle as soon as it has power
    lower_rad: float
    upper_rad: float
    slack_rad: float  # what rounding to pulses and counts may put a joint at its limit beyond it
    max_velocity_rad_s: float
    max_acceleration_rad_s2: float
    silence_deceleration_rad_s2: float
    acc_byte: int
    status_timeout_ns: int  # within which a drive sends its status by itself, 0 where it is asked
    effort_per_unit: float  # torque at the joint (Nm) for one unit that the drive reports, 0 = it reports none
    # what the fields of a drive's frames reach either way, at its own shaft; 0 where that is fixed
    range_rad: float
    range_rad_s: float
    range_nm: float
    stiffness_nm_rad: float  # with which it follows set-points, at its own shaft; 0 where that is its own
    damping_nm_s_rad: float
    plans_its_motion: int  # 1: it goes to targets with a ramp of its own
    position_bytes: int  # length of the frame that holds its position, where that is a setting
    gains_word: int  # stiffness and damping as the frames hold them, where they come with each set-point
    position_gain_1_s: float  # of its own position loop, 0 where that is not needed
    host_id: int  # what it answers to, where that stands in its identifiers
    rpm_per_rad_s: float
    command_delay_s: float  # from the start of the cycle until its target has reached the drive
    reply_delay_ns: int  # from the drive's reading of its encoder until the reply has arrived
    report_delay_ns: int  # the same of a report, which is sent unasked


class Commanded(OwnedRecord, writers=("cycle", "setpoints")):
    """What is commanded at this cycle, and at the next, which the frames of this cycle carry."""

    position_rad: float
    velocity_rad_s: float
    acceleration_rad_s2: float
    next_position_rad: float
    next_velocity_rad_s: float
    next_acceleration_rad_s2: float
    difference_velocity_rad_s: float  # of the last two commanded positions, for the last line of defence


class Ahead(OwnedRecord, writers=("trajectory.ahead",)):
    """A setpoint that is only looked at."""

    position_rad: float
    velocity_rad_s: float  # its `Commanded.difference_velocity_rad_s`


class Measured(OwnedRecord, writers=("bus",)):
    """The last plausible reading."""

    position_rad: float
    velocity_rad_s: float  # mean between the last two readings
    time_ns: int  # at which the drive read its encoder
    readings: int  # since it was brought up


class Tracking(OwnedRecord, writers=("bus", "cycle", "setpoints")):
    """The last reading beside what was commanded at its instant."""

    reference_rad: float
    reference_velocity_rad_s: float  # mean between the last two readings, as the measured one is
    error_acceleration_rad_s2: float  # smoothed change of the error in velocity
    error_before_rad: float  # of the reading before this one, as the next two
    velocity_error_before_rad_s: float
    error_acceleration_before_rad_s2: float
    lag_ns: int  # how much older than its stamp the reading may be, because its question waited so long
    lag_rad: float  # what was commanded meanwhile
    slip_rad: float  # how far the drive may have run ahead while the loop was away


class Reply(OwnedRecord, writers=("bus", "cycle", "drives.receiving")):
    """Positions as they come from the drive, and questions for them."""

    is_new: int  # 1: a position came since the last cycle
    has_report: int  # 1: an unasked one was among what came
    position_rad: float  # the last one that did
    time_ns: int
    questions: int  # that may still be answered, QUESTIONS at most
    reports: int  # positions that came although no question was left
    # the oldest question without a plausible answer, or since when a report is waited for; 0 none
    unanswered_since_ns: int


class Checks(OwnedRecord, writers=("safety.monitor",)):
    """What has been implausible or refused, and how often in a row."""

    suspect: int  # 1: the last reading was implausible and waits for the next one to agree
    suspect_rad: float
    bad_statuses: int  # statuses in a row with which the drive does not hold its position
    refusals: int  # of motion commands since the last sound status


class DriveState(OwnedRecord, writers=("bus.frames", "commands.orders", "drives", "safety.monitor")):
    """What the drive reports of itself beside its position."""

    velocity_rad_s: float  # as the drive measures it; NaN where it does not, as the next three
    effort_nm: float
    temperature_c: float
    voltage_v: float
    status: int
    status_ns: int  # when a drive that sends its status by itself has done so last
    status_readings: int
    error_code: int  # that its drive reported last, 0 none
    firmware: int  # major version << 8 | minor version, 0 where it is not known
    brake_released: int  # 1: it has said that its brake is released
    holds_stalled: int  # 1: it goes on holding where it stalls, and reports just that
    is_disabled: int  # 1: it was disabled, and has confirmed that


class Reference(OwnedRecord, writers=("safety.references",)):
    """Whether what the drive counts means an angle."""

    referenced: int
    unreferenced_reason: int
    power_loss_known: int  # 1: the drive's flag for lost power stays, and where it counts from is known
    lost_at_rad: float  # its last reading when its reference was lost


class Sent(OwnedRecord, writers=("commands.orders", "drives", "safety.references")):
    """What the drive's commands so far leave to the next ones."""

    stop_frames_due: int  # how many times it is still to be told to stop
    rpm_remainder: float
    fast_ready: int  # 1: its speed and ramp for FC are set, and it takes FC as absolute
    fast_offset_rad: float  # by which its targets lie further ahead than they should, so that it is on time
    behind_rad: float  # by which its targets still lie behind the setpoint, because it was not led for a while
    behind_rad_s: float  # how fast that grows
    led_cycle: int  # the last one in which it was led, where that is told apart; NOT_LED since its setpoint was synced
    asked_cycle: int  # the last one in which a command has asked it for its position as well


class Axis(OwnedRecord, writers=("commands.request_reader",)):
    """A joint in motion."""

    commanded: Commanded
    ahead: Ahead
    measured: Measured
    tracking: Tracking
    reply: Reply
    checks: Checks
    drive: DriveState
    reference: Reference
    sent: Sent
    asked_rad: float  # the angle that was requested for it, NaN = as its drive counts
