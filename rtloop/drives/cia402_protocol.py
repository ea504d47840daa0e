"""CiA 402 over CANopen: states, objects, numbers of process data and errors, as cycle and dialogues use them.

Protocol facts (CiA 301 and 402): standard identifiers, a base plus the node's number; little-endian. RPDO1 (200) holds
controlword and target position, and takes effect with the next SYNC (080). At each SYNC every drive also sends its
statusword and position (and torque) as TPDO1 (180). The drive moves in a straight line from target to target and
reaches each one an interpolation time (60C2, the cycle's period) after its SYNC, which is when the next SYNC comes.
Emergencies (080) hold an error code, heartbeats (700) the node's state.
"""

from rtloop.drives.errors import ErrorCode
from rtloop.drives.numbers import Number
from rtloop.drives.sdo import Object
from rtloop.memory import status as status_bits

START_NODE, ENTER_PRE_OPERATIONAL = 0x01, 0x80
"""Commands to a node (NMT)."""
BOOT_UP, OPERATIONAL = 0x00, 0x05
"""States of a node in its heartbeat."""

SHUT_DOWN, SWITCH_ON, ENABLE_OPERATION = 0x06, 0x07, 0x0F
NO_VOLTAGE, FAULT_RESET, HALT = 0x00, 0x80, 0x010F
"""Controlwords (6040); the rising edge of bit 7 resets a fault; HALT keeps an enabled drive enabled."""

STATE_MASK, FAULT_MASK = 0x6F, 0x4F
NOT_READY, SWITCH_ON_DISABLED, READY, SWITCHED_ON = 0x00, 0x40, 0x21, 0x23
OPERATION_ENABLED, QUICK_STOP, FAULT_REACTION, FAULT = 0x27, 0x07, 0x0F, 0x08
STATES = (
    (FAULT_MASK, NOT_READY, "not ready to switch on"),
    (FAULT_MASK, SWITCH_ON_DISABLED, "switch-on disabled"),
    (STATE_MASK, READY, "ready to switch on"),
    (STATE_MASK, SWITCHED_ON, "switched on"),
    (STATE_MASK, OPERATION_ENABLED, "operation enabled"),
    (STATE_MASK, QUICK_STOP, "quick stop active"),
    (FAULT_MASK, FAULT_REACTION, "fault reaction active"),
    (FAULT_MASK, FAULT, "fault"),
)
"""States of the drive in its statusword (6041): mask, value, name."""
HOLDING = (OPERATION_ENABLED, QUICK_STOP)

CSP = 8
CSP_SUPPORTED = 1 << 7
PROFILE = 402

DEVICE_TYPE = Object(0x1000, 0, 4, "device type")
SYNC_IDENTIFIER = Object(0x1005, 0, 4, "SYNC identifier")
MONITORED_NODES = Object(0x1016, 0, 1, "number of monitored heartbeats")
HEARTBEAT_MS = Object(0x1017, 0, 2, "heartbeat time")
ERROR_CODE = Object(0x603F, 0, 2, "error code")
CONNECTION_LOST = Object(0x6007, 0, 2, "what a lost connection does", signed=True)
CONTROLWORD = Object(0x6040, 0, 2, "controlword")
STATUSWORD = Object(0x6041, 0, 2, "statusword")
MODE = Object(0x6060, 0, 1, "mode of operation", signed=True)
MODE_SHOWN = Object(0x6061, 0, 1, "mode of operation shown", signed=True)
POSITION = Object(0x6064, 0, 4, "position", signed=True)
TARGET = Object(0x607A, 0, 4, "target position", signed=True)
INTERPOLATION_TIME = Object(0x60C2, 1, 1, "interpolation time")
INTERPOLATION_POWER = Object(0x60C2, 2, 1, "interpolation time's power of ten", signed=True)
MODES = Object(0x6502, 0, 4, "supported modes")

RPDO1_OBJECTS = (0x6040_0010, 0x607A_0020)
TPDO1_OBJECTS = (0x6041_0010, 0x6064_0020)
TORQUE_OBJECT = 0x6077_0010
"""Mapped objects: index, sub-index and size in bits."""

ERRORS = (
    ErrorCode(0xF000, 0x1000, "a general error"),
    ErrorCode(0xF000, 0x2000, "current", status_bits.OVER_CURRENT),
    ErrorCode(0xF0F0, 0x3010, "over-voltage", status_bits.OVER_VOLTAGE),
    ErrorCode(0xF0F0, 0x3020, "under-voltage", status_bits.UNDER_VOLTAGE),
    ErrorCode(0xF000, 0x3000, "voltage"),
    ErrorCode(0xF0F0, 0x4020, "too cold"),
    ErrorCode(0xF000, 0x4000, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorCode(0xFFF0, 0x5110, "the drive's electronics", status_bits.UNDER_VOLTAGE),  # their supply
    ErrorCode(0xF000, 0x5000, "the drive's electronics"),
    ErrorCode(0xF000, 0x6000, "the drive's software"),
    ErrorCode(0xFFFF, 0x7121, "motor blocked", status_bits.STALLED),
    ErrorCode(0xFF00, 0x7300, "sensor", status_bits.ENCODER),
    ErrorCode(0xFF00, 0x7500, "communication", status_bits.COMMUNICATION),
    ErrorCode(0xF000, 0x7000, "a module beside the drive"),
    ErrorCode(0xFF00, 0x8000, "monitoring"),
    ErrorCode(0xFF00, 0x8100, "communication", status_bits.COMMUNICATION),
    ErrorCode(0xFF00, 0x8200, "communication", status_bits.COMMUNICATION),
    ErrorCode(0xFFFF, 0x8611, "following error", status_bits.STALLED),
    ErrorCode(0xF000, 0x8000, "control"),
    ErrorCode(0xF000, 0xF000, "an error of its own kind"),
)
"""Error codes by the first that fits (CiA 301, emergencies; CiA 402, object 603F)."""

# of RPDO1
WANTED_CONTROLWORD, WANTED_COUNTS = Number(0, 2), Number(2, 4, signed=True)
# of TPDO1; without torque it is two bytes shorter
TOLD_STATUSWORD, TOLD_COUNTS, TOLD_TORQUE = Number(0, 2), Number(2, 4, signed=True), Number(6, 2, signed=True)
# of an emergency
TOLD_ERROR_CODE = Number(0, 2)
# of a heartbeat
TOLD_NODE_STATE = Number(0, 1)
