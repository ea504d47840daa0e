"""What the cycle remembers of each bus: bytes that came and wait, bytes that go, and who was asked and has answered.

And the frames to and from conversations.
"""

from typing import Annotated

from rtloop.memory.owned_record import OwnedRecord
from shm.layout import MAX_JOINTS
from shm.record import Bytes, Ints, Rows, SmallInts

TX_BYTES = 8192
RX_BYTES = 1 << 16
RX_CHUNKS = 1024
LINE_BYTES = 64
READ_BYTES = 4096
CAN_FRAME_BYTES = 16
"""`struct can_frame`; the receive ring holds a whole number of them."""
TX_FRAMES = TX_BYTES // CAN_FRAME_BYTES
RX_FRAMES = READ_BYTES // CAN_FRAME_BYTES
SERVICE_SLOTS = 256
LISTENERS = 8 * MAX_JOINTS
NOBODY, GRIPPER = -1, -2
"""Whose frame it is, where it is no joint's; those of a gripper's drive belong to its conversation."""
SLCAN_LONGEST_LINE = 27

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


class Message(OwnedRecord, writers=()):
    """`struct mmsghdr` of Linux where pointers have 64 bits: a msghdr and what it came to."""

    name: int
    name_length: int
    parts: int  # address of its iovec
    part_count: int
    control: int
    control_length: int
    flags: int
    length: int


class Part(OwnedRecord, writers=()):
    """`struct iovec`."""

    address: int
    length: int


class Arrived(OwnedRecord, writers=()):
    """What the reader's thread writes of the receive ring, on lines of its own (`LINE_BYTES` of shm.layout)."""

    bytes: int
    chunks: int
    lost: int
    closed: int  # errno + 1 once the wire is gone
    dropped: int  # bytes that the system had no room for, as ordinary Python found out
    unsent: int  # bytes that the wire had taken and did not send after all, as ordinary Python found out
    clock: Annotated[Ints, 2]
    woke_ns: int  # when the reader last went to look for bytes, 0 = never
    padding: Annotated[Ints, 7]


class Taken(OwnedRecord, writers=()):
    """What the cycle writes of the receive ring, likewise."""

    bytes: int
    chunks: int
    padding: Annotated[Ints, 14]


class Chunk(OwnedRecord, writers=("wire.received",)):
    """Bytes that one read brought."""

    time_ns: int
    end: int


class Received(OwnedRecord, writers=("wire.received",)):
    """The receive ring."""

    arrived: Arrived
    taken: Taken
    chunks: Annotated[Rows[Chunk], RX_CHUNKS]
    bytes: Annotated[Bytes, RX_BYTES]


class Wire(OwnedRecord, writers=()):
    """The open wire; each word on a line of its own."""

    fd: int  # what ordinary Python has opened, -1 none; on a line of its own
    fd_padding: Annotated[Ints, 15]
    fd_in_use: int  # what the cycle's thread writes to
    fd_in_use_padding: Annotated[Ints, 15]


class Reader(OwnedRecord, writers=()):
    """Of the reader's thread alone."""

    poll: int  # struct pollfd
    padding: Annotated[Ints, 15]
    bytes: Annotated[Bytes, READ_BYTES]
    messages: Annotated[Rows[Message], RX_FRAMES]
    parts: Annotated[Rows[Part], RX_FRAMES]


class Parser(OwnedRecord, writers=("bus.measured", "wire.can_frame", "wire.framed", "wire.slcan", "wire.wires")):
    """How far the receive ring is read, and the beginning of what is not yet a whole line or record."""

    bytes_taken: int
    chunks_taken: int
    line: Annotated[Bytes, LINE_BYTES]
    line_length: int
    line_spoilt: int
    line_needed: int  # bytes that must be collected before the next look at them


class Outgoing(OwnedRecord, writers=("wire",)):
    """What this cycle sends: the bytes for the wire, and the frames in them."""

    length: int  # of the bytes
    frames: int
    owed: int  # frames at the front that go first, whatever was decided meanwhile
    bits: int
    unsent_taken_back: int  # bytes of `received.arrived.unsent` that the counters know of
    bytes: Annotated[Bytes, TX_BYTES]
    # of each frame
    ends: Annotated[Ints, TX_FRAMES]  # byte behind it
    joined: Annotated[Bytes, TX_FRAMES]  # 1: the next frame belongs to the same command
    ids: Annotated[Ints, TX_FRAMES]
    kinds: Annotated[Bytes, TX_FRAMES]  # bits of rtloop.memory.frame_words
    stops: Annotated[SmallInts, TX_FRAMES]  # joint whose stop command it is, -1 for none
    sizes: Annotated[Ints, TX_FRAMES]  # data bytes
    payloads: Annotated[Ints, TX_FRAMES]  # data, the first byte lowest
    messages: Annotated[Rows[Message], TX_FRAMES]
    parts: Annotated[Rows[Part], TX_FRAMES]


class Quiet(OwnedRecord, writers=("bus", "cycle", "safety.silence", "wire")):
    """What happens while no frame of a drive comes, for `rtloop.safety.silence` alone."""

    heard_ns: int  # arrival of the last frame of any drive
    heard_before_ns: int  # the same in the cycle before
    adapter_words: int  # answers of the adapter itself, where its wire tells them apart
    adapter_words_before: int  # in the cycle before
    adapter_ns: int  # cycle in which the last of them was taken
    spoke_ns: int  # cycle that last had anything to send
    # since the last frame of a drive
    away_ns: int  # for how long the cycle was away
    # the bus' counters as they were at the last frame of a drive
    bytes_unsent: int
    unacknowledged: int
    error_frames: int
    frames_received: int


SILENT = 0
PROBING = 1
SPEAKING = 2
"""What may leave in a cycle: nothing, as the wire is gone; questions whether anybody is there again; all."""


class Bus(
    OwnedRecord,
    writers=(
        "bus.frames",
        "bus.measured",
        "commands.orders",
        "cycle",
        "drives.cia402",
        "drives.receiving",
        "wire.outgoing",
    ),
):
    """A bus of the arm: its wire, whose turn it is to be asked, and for how long nothing has answered."""

    address: int  # of this record itself
    number: int  # its place among the arm's buses
    interface: int  # WIRE_…
    simulated: int  # 1: the wire is a pseudo-terminal, behind which a program is the drives
    service_bits: int  # bits of bus time a cycle may use in all, service frames included
    joint_count: int  # joints whose drives are on it
    speech: int  # what may leave in this cycle: SILENT, PROBING or SPEAKING
    transmit_inhibited: int  # 1: the drives were out of reach and get no motion frame until they are brought up again
    unheard_frames: int  # given to the wire since the last frame of a drive
    probe_turn: int
    probed_ns: int
    service_credit_bits: int
    status_turn: int
    sync_cycle: int  # in which the last SYNC left
    unacknowledged_since_ns: int  # the oldest question for a status since which none has come, 0 none
    quiet: Quiet
    wire: Wire
    parser: Parser
    outgoing: Outgoing
    received: Received
    reader: Reader


class Listener(OwnedRecord, writers=()):
    """Who receives frames whose identifier has the bits of `match` where `mask` has ones."""

    match: int
    mask: int
    kind: int  # of the frame, bits of rtloop.memory.frame_words
    joint: int  # or GRIPPER
    bus: int


class ServiceFrame(OwnedRecord, writers=("service.rings",)):
    """A frame or an order, from or for a conversation in ordinary Python."""

    kind: int
    id: int
    frame_kind: int  # bits of rtloop.memory.frame_words
    length: int
    joined: int  # 1: the next record must leave in the same cycle (packets of one command)
    payload: int  # eight bytes, the first lowest
    time_ns: int
    joint: int
    value: float
    code: int


class ServiceRing(OwnedRecord, writers=()):
    """A ring of them; each position on a line of its own."""

    written: Annotated[Ints, 16]
    taken: Annotated[Ints, 16]
    records: Annotated[Rows[ServiceFrame], SERVICE_SLOTS]
