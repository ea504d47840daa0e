"""Constants of Linux's CAN: flags of an identifier (linux/can.h), classes of an error frame (linux/can/error.h)."""

EXTENDED_FLAG = 0x80000000
REMOTE_FLAG = 0x40000000
ERROR_FLAG = 0x20000000
EXTENDED_MASK = 0x1FFFFFFF
STANDARD_MASK = 0x7FF

TRANSMIT_TIMEOUT = 0x001
LOST_ARBITRATION = 0x002
CONTROLLER = 0x004
PROTOCOL = 0x008
TRANSCEIVER = 0x010
NO_ACKNOWLEDGE = 0x020
BUS_OFF = 0x040
BUS_ERROR = 0x080
RESTARTED = 0x100

WATCHED = TRANSMIT_TIMEOUT | CONTROLLER | PROTOCOL | TRANSCEIVER | NO_ACKNOWLEDGE | BUS_OFF | BUS_ERROR | RESTARTED
"""The error classes that a socket subscribes to; a lost arbitration is normal on a bus, and no error."""

STOP = 1
JOINED = 2
"""rtarm's own marks on a frame for the bridge: it is a stop command; the next frame belongs to the same command."""
