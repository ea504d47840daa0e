"""The numbers that travel in shared memory, by name.

Integers in the files, enumerations in Python; jitted code compares the members as plain integers.
What a person reads about a fault, an outcome or an answer comes from `sentences`, never from here.
"""

from enum import IntEnum, IntFlag


class Mode(IntEnum):
    """What the control process is doing; allowed changes stand in `rtloop.memory.modes`."""

    OFFLINE = 0
    BRINGING_UP = 1
    HOLDING = 2
    EXECUTING = 3
    STOPPING = 4
    FAULT = 5
    DISABLED = 6  # the drives are limp, the arm is out of service
    FREE = 7  # the drives are limp, so that a person can lead the arm by hand
    REFERENCING = 8  # joints find their homing stops, or a person says where they stand


class Phase(IntEnum):
    """Where a goal stands; allowed changes stand in `rtloop.trajectory.phases`."""

    NONE = 0
    WAITING = 1  # its points come, its start lies ahead, or the arm stops to make way for it
    RUNNING = 2  # it moves the arm
    SETTLING = 3  # the last point is commanded, the measured joints are on their way
    STOPPING = 4  # it has been ended, and the arm comes to rest on its path
    PAUSED = 5  # a person holds the arm


class Setpoint(IntEnum):
    """Kind of a record in the setpoint ring."""

    BEGIN = 1
    WAYPOINT = 2
    END = 3


class Request(IntEnum):
    """What is asked for: HOLD to SPEED_SCALE and STOP by a store of their own, the others in the request ring."""

    HOLD = 1  # stop on the path, keep the goal: pause; begin nothing before a resume
    RESUME = 2  # let a paused goal go on, and an arm that a person has stopped or holds take goals again
    CANCEL = 3  # stop on the path, end the goal as canceled
    SPEED_SCALE = 4
    CLEAR_FAULT = 5
    STOP = 6  # by a person: stop on the path, end every goal, begin nothing before a resume
    ENABLE = 7  # bring limp drives up again; the arm holds where it stands
    DISABLE = 8  # let the drives of a standing arm go limp
    FREE = 9  # the same, to lead it by hand
    HOME = 10  # let joints find their homing stops, one after the other
    REFERENCE = 11  # a person knows where joints stand
    GRIP = 12  # let the gripper on the bus go to an angle
    GRIP_STOP = 13  # let it stop and hold where it is
    GRIP_HOME = 14  # let it find its stop
    HOME_STOP = 15  # let the homing run under way end


class Entry(IntFlag):
    """How a goal begins and ends, in its BEGIN record."""

    APPROACH = 1  # the first waypoint lies ahead and the way to it starts where the arm is commanded
    STREAM = 2  # newer points are expected: past the last one the arm runs on straight while it stops


class Answer(IntEnum):
    """How a request was answered."""

    NONE = 0
    DONE = 1
    REFUSED_MODE = 2
    REFUSED_NO_GOAL = 3  # in recordings of before
    REFUSED_VALUE = 4
    REFUSED_UNKNOWN = 5
    REFUSED_MOVING = 6
    REFUSED_WIRE = 7  # the adapter is not there
    REFUSED_HELD = 8  # a person has stopped or holds the arm
    REFUSED_OUTDATED = 9  # it was made before a stop, a hold, a resume, a fault …


class Outcome(IntEnum):
    """How a goal ended."""

    NONE = 0
    SUCCEEDED = 1
    CANCELED = 2
    REPLACED = 3
    STOPPED = 4  # by `rtarm stop`
    PATH_TOLERANCE = 5
    GOAL_TOLERANCE = 6
    FAULT = 7  # the latched fault says why
    STARVED = 8  # the front stopped sending waypoints
    FRONT_LOST = 9
    SHUTDOWN = 10
    REFUSED_MODE = 11  # value: the mode
    REFUSED_UNREFERENCED = 12
    REFUSED_START = 13  # first point too far: value, limit
    REFUSED_LIMITS = 14  # no way onto the trajectory inside the limits
    REFUSED_CORRUPT = 15  # a waypoint that is not finite, out of order or out of limits
    CLOCK_GAP = 16  # the cycle was away for longer than the drives' look-ahead
    RAN_DRY = 17  # a stream of points ended or was late in motion: stopped in a straight line
    PATH_VELOCITY = 18
    PATH_ACCELERATION = 19
    GOAL_VELOCITY = 20
    GOAL_ACCELERATION = 21
    REFUSED_HELD = 22  # a person has stopped or holds the arm
    REFUSED_OUTDATED = 23  # it arrived before a stop, a hold, a homing run, a fault, or the drives were let go
    REFUSED_STREAM = 24  # the arm went on after a stall by itself, and streams wait for a person's resume


class Fault(IntEnum):
    """Latched faults; sentence, reason and remedy of each in `sentences.english`."""

    NONE = 0
    NOT_FINITE = 1
    POSITION_LIMIT = 2
    VELOCITY_LIMIT = 3
    ACCELERATION_LIMIT = 4
    FOLLOWING_ERROR = 5
    STALE_READING = 6
    DRIVE_FAULT = 7  # the drive has an error, is limp, refuses motion or says no status; value: its status
    REFERENCE_LOST = 8
    COMMAND_RING = 9  # corrupt record or index in the command file
    WIRE = 10  # the adapter refuses or is gone
    BRING_UP = 11
    RELEASE = 12  # a drive that was to go limp stays enabled
    LINK_DOWN = 13  # the CAN interface was taken down
    BUS_OFF = 14  # the CAN controller has left the bus after too many errors
    HOMING = 15  # a joint did not find its homing stop, or its drive could not be referenced


class Unreferenced(IntEnum):
    """Why a joint's count does not mean an angle."""

    REFERENCED = 0
    NOT_BROUGHT_UP = 1
    POWER_LOST = 2
    POSITION_JUMP = 3
    SILENT = 4
    TARGET_FAR = 5  # measured position and the drive's own target disagree
    OUTSIDE_LIMITS = 6
    NOT_HOMED = 7  # its homing run has not ended, or not where it should
    MOVED = 8  # it does not stand where it stood when rtarm was ended
    INCREMENTAL = 9  # its drive cannot tell where it was switched on, and nobody has said


class DriveStatus(IntFlag):
    """Status bits common to all drive families."""

    ENABLED = 1
    REACHED = 2
    STALLED = 4
    PROTECTED = 8
    POWER_LOST = 16
    ANSWERED = 32  # at least one reading since bring-up
    # why the drive has an error, where it tells
    OVER_CURRENT = 64
    OVER_VOLTAGE = 128
    UNDER_VOLTAGE = 256
    OVER_TEMPERATURE = 512
    ENCODER = 1024
    COMMUNICATION = 2048


class Evidence(IntFlag):
    """What was known of wire and machine when a silence became a fault: facts for the sentence, nothing else."""

    HEARD = 1  # frames of some drive still came
    ADAPTER_ANSWERS = 2  # the adapter still answered what was sent
    ADAPTER_MUTE = 4  # it did so until the drives fell silent, and then no more
    NOT_TAKEN = 8  # the wire did not take all that was written
    UNACKNOWLEDGED = 16  # the CAN controller told that no drive acknowledges
    BUS_ERRORS = 32  # it told of other errors, or counts many
    BABBLE = 64  # frames of no drive of the arm came at least as often as all drives answer otherwise
    CYCLE_LATE = 128  # the cycle was away meanwhile for as long as the age ladder's first rung
    READER_LATE = 256  # the thread that reads the wire did not run
    SIMULATED = 512  # the wire is a pseudo-terminal: a program on this machine is the drives


class Event(IntEnum):
    """Kind of a record in the event ring."""

    MODE = 1
    FAULT = 2
    GOAL = 3
    RESULT = 4
    REQUEST = 5
    OVERRUN = 6
    REFERENCE = 7
    WIRE = 8  # the adapter is back
    COMMAND = 9  # stop, hold, resume or speed scale, newer than the last
    HEALED = 10  # all drives were silent for a moment, and the arm goes on by itself


class Slowed(IntFlag):
    """Why the control process slows the arm down, holds or stops it; several may be true at once."""

    HELD = 1  # a person paused the goal
    LATE_DRIVE = 2  # a reading is older than the age ladder's first rung
    STARVING = 4  # the rest of the trajectory has not come
    MAKING_WAY = 8  # for a newer goal that no way leads to from here
    CLOSING = 16  # an orderly end
    OWN_BRAKE = 32  # each joint brakes by itself: the path cannot be trusted


class BusState(IntEnum):
    """What the CAN controller thinks of its bus, where the wire tells (SocketCAN)."""

    ACTIVE = 0
    WARNING = 1  # 96 errors counted
    PASSIVE = 2  # 128: it disturbs nobody any more, but is not heard either
    BUS_OFF = 3  # 256: it takes no part until it is restarted


class GripTrouble(IntEnum):
    """Why the gripper on the bus cannot do what it is told; sentences in `sentences.english`."""

    NONE = 0
    SILENT = 1
    FIRMWARE = 2  # its configuration block is none that is known here
    MICROSTEPS = 3
    CHECKSUM = 4
    PROTECTED = 5  # its stall protection has let go
    DISABLED = 6
    POWER_LOST = 7  # its count means no angle any more
    REFUSED = 8  # it does not take its command
    NOT_HOMED = 9  # its homing run has not found the stop
    OUTSIDE = 10  # it reads an angle far outside its range
    CURRENT = 11  # it does not take a current limit
