"""What SocketCAN's error frames report about the controller and its bus (linux/can/error.h).

The identifier of an error frame is its class; its data hold details. Drivers differ in what they send: some report a
missing acknowledgement by its class, others as a bus error at the acknowledge slot.
"""

from compilation.jit import jit
from rtloop.wire.can_words import BUS_OFF, CONTROLLER, NO_ACKNOWLEDGE, PROTOCOL, RESTARTED
from shm.words import BusState

_WARNING_BITS = 0x0C  # of receiving, of transmitting
_PASSIVE_BITS = 0x30
_ACTIVE_AGAIN_BIT = 0x40
_ACKNOWLEDGE_SLOT = 0x19


@jit
def unacknowledged(error_class: int, data: int) -> bool:
    """Whether a frame that this machine sent was not acknowledged by any node."""
    if error_class & NO_ACKNOWLEDGE:
        return True
    return error_class & PROTOCOL != 0 and (data >> 24) & 255 == _ACKNOWLEDGE_SLOT


@jit
def state_after(state: int, error_class: int, data: int) -> int:
    """The controller's state (shm.words.BusState) after this error frame."""
    if error_class & BUS_OFF:
        return BusState.BUS_OFF
    if error_class & RESTARTED:
        return BusState.ACTIVE
    if error_class & CONTROLLER:
        detail = (data >> 8) & 255
        if detail & _PASSIVE_BITS:
            return BusState.PASSIVE
        if detail & _WARNING_BITS:
            return BusState.WARNING
        if detail & _ACTIVE_AGAIN_BIT:
            return BusState.ACTIVE
    return state
