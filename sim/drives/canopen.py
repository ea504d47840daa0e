"""A CANopen node (CiA 301) with a servo's shaft: object dictionary, SDO server, PDOs, NMT, heartbeat, emergencies.

A profile derives from `CanopenNode`, adds its objects, and says what a lost connection does (`disconnect`).

Modelled: expedited and segmented transfers; four PDOs each way, mapped while they are off; synchronous and event-driven
PDOs; the node's states; heartbeats, its own and the host's; storing (1010) what a profile keeps and the heartbeat's
time, [inf] not while it is in use (`in_use`). Not modelled: block transfers, guarding, inhibit and event
timers, a SYNC of its own, the sync window, restoring of defaults (1011).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from sim.bus import Frame
from sim.drives.conversation import ServoDrive
from sim.drives.servo import Load

MILLISECOND = 1_000_000
BOOT_NS = 150 * MILLISECOND
"""From power to the boot-up message [inf]."""

NMT, SYNC, EMERGENCY, SDO_REPLY, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x600, 0x700
TPDO, RPDO = (0x180, 0x280, 0x380, 0x480), (0x200, 0x300, 0x400, 0x500)
"""Identifiers, of PDOs the predefined ones; a node's number is added to all but NMT and SYNC."""
NODES = 0x7F

INITIALISING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
START, STOP, ENTER_PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
ORDERED = {START: OPERATIONAL, STOP: STOPPED, ENTER_PRE_OPERATIONAL: PRE_OPERATIONAL}
"""States of a node, and the orders (NMT) that lead there."""

RECEIVE_PDO, RECEIVE_MAP, TRANSMIT_PDO, TRANSMIT_MAP = 0x1400, 0x1600, 0x1800, 0x1A00
NOT_VALID = 1 << 31
IDENTIFIER = 0x7FF
MAPPED_AT_MOST, PDO_BITS = 8, 64
HIGHEST_SYNCHRONOUS, EVENT_DRIVEN = 240, 254

UNKNOWN_COMMAND, WRONG_TOGGLE = 0x0504_0001, 0x0503_0000
WRITE_ONLY, READ_ONLY, NO_OBJECT, NO_SUBINDEX = 0x0601_0001, 0x0601_0002, 0x0602_0000, 0x0609_0011
NOT_MAPPABLE, PDO_TOO_LONG, WRONG_VALUE = 0x0604_0041, 0x0604_0042, 0x0609_0030
TOO_LONG, TOO_SHORT, NOT_IN_THIS_STATE = 0x0607_0012, 0x0607_0013, 0x0800_0022
NOT_STORED = 0x0800_0020
SAVE, STORES_WHEN_TOLD = 0x6576_6173, 1
"""What 1010:01 wants to be written ("save"), and says of itself."""

HEARTBEAT_LOST, PDO_TOO_SHORT, NO_ERROR = 0x8130, 0x8210, 0x0000
COMMUNICATION_ERROR, GENERIC_ERROR = 0x10, 0x01
"""Bits of the error register."""

SEGMENT = 7


@dataclass
class Entry:
    """One object.

    Attributes:
        value: number or text.
        size: bytes of a number; 0 for text.
        signed, writable, readable, mappable: as they say.
        read: makes the value when it is asked for.
        write: judges and obeys a new value, before it is kept: an abort code, or 0.
    """

    value: int | bytes = 0
    size: int = 4
    signed: bool = False
    writable: bool = False
    readable: bool = True
    mappable: bool = False
    read: Callable[[], int] | None = None
    write: Callable[[int], int] | None = None

    def data(self) -> bytes:
        """Its bytes on the bus."""
        if isinstance(self.value, bytes):
            return self.value
        value = self.read() if self.read is not None else self.value
        return (value % (1 << 8 * self.size)).to_bytes(self.size, "little")


@dataclass
class _Transfer:
    """A segmented transfer under way."""

    index: int
    sub: int
    data: bytearray
    upload: bool
    toggle: int = 0


@dataclass
class _Pdo:
    """A process data object: identifier, transmission type, and what is mapped."""

    identifier: int
    kind: int
    mapped: list[int] = field(default_factory=list)
    count: int = 0
    waiting: bytes | None = None
    syncs: int = 0

    @property
    def valid(self) -> bool:
        """Whether it is on."""
        return not self.identifier & NOT_VALID

    @property
    def entries(self) -> list[tuple[int, int, int]]:
        """What is mapped: index, sub-index, bytes."""
        return [(one >> 16, one >> 8 & 0xFF, (one & 0xFF) // 8) for one in self.mapped[: self.count]]


class CanopenNode(ServoDrive):
    """A node of the bus with a shaft.

    Args:
        node: its number, 1 to 127.
        start_ns, turns, counted, load, seed: see `ServoDrive`.

    Attributes:
        node: its number.
        state: of the node, as its heartbeat tells it.
        objects: its dictionary, by index and sub-index.
        flash: values that it was told to store, likewise.
        remaps_in_operation: whether PDOs may be mapped while the node is operational.
    """

    def __init__(
        self,
        node: int,
        *,
        start_ns: int = 0,
        turns: float = 0.0,
        counted: float | None = None,
        load: Load | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(start_ns=start_ns, turns=turns, counted=counted, load=load, seed=seed)
        self.node = node
        self.state = PRE_OPERATIONAL
        self.remaps_in_operation = True
        self.objects: dict[tuple[int, int], Entry] = {}
        self.flash: dict[tuple[int, int], int] = {}
        self._transfer: _Transfer | None = None
        self._receive: list[_Pdo] = []
        self._transmit: list[_Pdo] = []

    # -- what a profile says of itself ---------------------------------------------------------------

    @abstractmethod
    def disconnect(self) -> None:
        """The node has left its operation, or hears its host no more, while somebody relies on it."""

    @property
    @abstractmethod
    def in_use(self) -> bool:
        """Whether it does what it is for, and stores nothing meanwhile."""

    @abstractmethod
    def default_pdos(self) -> tuple[Iterable[tuple[int, ...]], Iterable[tuple[int, ...]]]:
        """What its PDOs hold after power comes, received and transmitted ones: index, sub-index and bits of each."""

    @abstractmethod
    def reset(self) -> None:
        """Begin anew as after power comes, in a node that boots."""

    # -- dictionary ----------------------------------------------------------------------------------

    def add_communication_objects(self, name: bytes) -> None:
        """The objects that every node has, as they are after power comes."""
        self.objects |= {
            (0x1000, 0): Entry(0x0002_0192),
            (0x1001, 0): Entry(0, 1, mappable=True),
            (0x1005, 0): Entry(SYNC, writable=True),
            (0x1008, 0): Entry(name, 0),
            (0x1009, 0): Entry(b"sim", 0),
            (0x100A, 0): Entry(b"1.2.3 of the simulation", 0),
            (0x1010, 0): Entry(1, 1),
            (0x1010, 1): Entry(writable=True, read=lambda: STORES_WHEN_TOLD, write=self._store),
            (0x1014, 0): Entry(EMERGENCY + self.node),
            (0x1016, 0): Entry(1, 1),
            (0x1016, 1): Entry(0, writable=True, write=self._monitor),
            (0x1017, 0): Entry(0, 2, writable=True, write=self._beat_every),
            (0x1018, 0): Entry(4, 1),
            **{(0x1018, sub): Entry(0) for sub in range(1, 5)},
        }
        received, transmitted = self.default_pdos()
        self._receive = [self._pdo(RPDO[n], objects) for n, objects in enumerate(received)]
        self._transmit = [self._pdo(TPDO[n], objects) for n, objects in enumerate(transmitted)]
        for pdos, at, mapped_at in (
            (self._receive, RECEIVE_PDO, RECEIVE_MAP),
            (self._transmit, TRANSMIT_PDO, TRANSMIT_MAP),
        ):
            for number, pdo in enumerate(pdos):
                self._add_pdo(pdo, at + number, mapped_at + number)
        for key, value in self.flash.items():
            self.objects[key].value = value
        self._beat_every(self.number(0x1017))

    def _store(self, value: int) -> int:
        if value != SAVE:
            return NOT_STORED
        if self.in_use:
            return NOT_IN_THIS_STATE
        self.flash = {key: self.number(*key) for key in ((0x1017, 0), *self.stored())}
        return 0

    def stored(self) -> Iterable[tuple[int, int]]:
        """Objects of its profile that it stores."""
        return ()

    def _pdo(self, identifier: int, objects: tuple[int, ...]) -> _Pdo:
        mapped = [*objects, *[0] * (MAPPED_AT_MOST - len(objects))]
        return _Pdo(identifier + self.node, 255, mapped, len(objects))

    def _add_pdo(self, pdo: _Pdo, index: int, map_index: int) -> None:
        def identify(value: int) -> int:
            if pdo.valid and not value & NOT_VALID and (value ^ pdo.identifier) & IDENTIFIER:
                return WRONG_VALUE
            pdo.identifier, pdo.waiting, pdo.syncs = value, None, 0
            return 0

        def choose(value: int) -> int:
            if HIGHEST_SYNCHRONOUS < value < EVENT_DRIVEN:
                return WRONG_VALUE
            pdo.kind = value
            return 0

        def count(value: int) -> int:
            if pdo.valid or not self._may_map():
                return NOT_IN_THIS_STATE
            wanted = pdo.mapped[:value]
            if value > MAPPED_AT_MOST or sum(one & 0xFF for one in wanted) > PDO_BITS:
                return PDO_TOO_LONG
            if 0 in wanted:
                return NOT_MAPPABLE
            pdo.count = value
            return 0

        self.objects |= {
            (index, 0): Entry(2, 1),
            (index, 1): Entry(size=4, writable=True, read=lambda: pdo.identifier, write=identify),
            (index, 2): Entry(size=1, writable=True, read=lambda: pdo.kind, write=choose),
            (map_index, 0): Entry(size=1, writable=True, read=lambda: pdo.count, write=count),
        }
        for place in range(MAPPED_AT_MOST):
            self._add_mapping(pdo, (map_index, place + 1), place)

    def _add_mapping(self, pdo: _Pdo, key: tuple[int, int], place: int) -> None:
        def put(value: int) -> int:
            if pdo.valid or pdo.count or not self._may_map():
                return NOT_IN_THIS_STATE
            entry = self.objects.get((value >> 16, value >> 8 & 0xFF))
            if entry is None:
                return NO_OBJECT
            if not entry.mappable or value & 0xFF != 8 * entry.size:
                return NOT_MAPPABLE
            pdo.mapped[place] = value
            return 0

        self.objects[key] = Entry(size=4, writable=True, read=lambda: pdo.mapped[place], write=put)

    def _may_map(self) -> bool:
        return self.remaps_in_operation or self.state != OPERATIONAL

    def number(self, index: int, sub: int = 0) -> int:
        """The value of an object that is a number."""
        value = self.objects[index, sub].value
        assert isinstance(value, int)
        return value

    def put(self, index: int, sub: int, data: bytes) -> int:
        """Take an object's new bytes, from a transfer or a PDO: an abort code, or 0."""
        entry = self.objects.get((index, sub))
        if entry is None:
            return NO_SUBINDEX if (index, 0) in self.objects else NO_OBJECT
        if not entry.writable:
            return READ_ONLY
        if len(data) != entry.size:
            return TOO_LONG if len(data) > entry.size else TOO_SHORT
        value = int.from_bytes(data, "little", signed=entry.signed)
        refused = entry.write(value) if entry.write is not None else 0
        if not refused:
            entry.value = value
        return refused

    # -- frames --------------------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is of its conversation with the host."""
        bases = (EMERGENCY, *TPDO, *RPDO, SDO_REPLY, SDO_REQUEST, HEARTBEAT)
        return not frame.extended and frame.can_id & NODES == self.node and frame.can_id & ~NODES in bases

    def concerns(self, frame: Frame) -> bool:
        """Whether it may be: what its PDOs and its consumer of heartbeats listen for can be set to any identifier."""
        return not frame.extended and not frame.remote and self.state != INITIALISING

    def take(self, frame: Frame) -> None:
        """Obey a frame for this node or for all."""
        identifier = frame.can_id
        if identifier == NMT:
            self._order(frame.data)
        elif identifier == self.number(0x1005) & IDENTIFIER:
            self._sync()
        elif identifier == SDO_REQUEST + self.node:
            if self.state != STOPPED and len(frame.data) == 8:
                self._serve(frame.data)
        elif identifier == HEARTBEAT + (self.number(0x1016, 1) >> 16 & NODES):
            self._heard_host()
        elif self.state == OPERATIONAL:
            for pdo in self._receive:
                if pdo.valid and identifier == pdo.identifier & IDENTIFIER:
                    self._take_pdo(pdo, frame.data)

    def _frame(self, base: int, data: bytes) -> Frame:
        return Frame(base + self.node, data, extended=False)

    # -- the node's states ---------------------------------------------------------------------------

    def _order(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node):
            return
        order = data[0]
        if order == RESET_NODE:
            self.reset()
        elif order == RESET_COMMUNICATION:
            self._enter(PRE_OPERATIONAL)
            self.boot_up()
        elif order in ORDERED:
            self._enter(ORDERED[order])

    def _enter(self, state: int) -> None:
        left = self.state == OPERATIONAL and state != OPERATIONAL
        self.state = state
        for pdo in self._receive:
            pdo.waiting = None
        if left:
            self.disconnect()

    def begin_booting(self) -> None:
        """Be silent for a while, then say that it is there."""
        self.state = INITIALISING
        self._transfer = None
        self.outbox.clear()
        self.after("boot", BOOT_NS, self.boot_up)

    def boot_up(self) -> None:
        """Be pre-operational, and say so by the boot-up message."""
        self.state = PRE_OPERATIONAL
        self.say(self._frame(HEARTBEAT, bytes((INITIALISING,))))

    def _beat_every(self, period_ms: int) -> int:
        self.every("heartbeat", period_ms * MILLISECOND, self._beat)
        return 0

    def _beat(self) -> None:
        if self.state != INITIALISING:
            self.say(self._frame(HEARTBEAT, bytes((self.state,))))

    def _monitor(self, value: int) -> int:
        self.cancel("host")
        return 0

    def _heard_host(self) -> None:
        """The monitored node lives: wait for its next heartbeat (its first one begins that)."""
        period_ms = self.number(0x1016, 1) & 0xFFFF
        if period_ms:
            self.after("host", period_ms * MILLISECOND, self._lost_host)

    def _lost_host(self) -> None:
        self.emergency(HEARTBEAT_LOST, COMMUNICATION_ERROR)
        self._enter(PRE_OPERATIONAL)

    def emergency(self, code: int, register: int) -> None:
        """Tell an error, or with NO_ERROR that there is none any more."""
        self.objects[0x1001, 0].value = register
        data = code.to_bytes(2, "little") + bytes((register,)) + bytes(5)
        self.say(self._frame(EMERGENCY, data))

    # -- process data --------------------------------------------------------------------------------

    def _take_pdo(self, pdo: _Pdo, data: bytes) -> None:
        if len(data) < sum(size for _, _, size in pdo.entries):
            self.emergency(PDO_TOO_SHORT, COMMUNICATION_ERROR)
        elif pdo.kind <= HIGHEST_SYNCHRONOUS:
            pdo.waiting = data
        else:
            self._apply(pdo, data)

    def _apply(self, pdo: _Pdo, data: bytes) -> None:
        at = 0
        for index, sub, size in pdo.entries:
            self.put(index, sub, data[at : at + size])
            at += size

    def _sync(self) -> None:
        """Let what came since the last SYNC take effect, and tell how it is now."""
        if self.state != OPERATIONAL:
            return
        for pdo in self._receive:
            if pdo.waiting is not None:
                data, pdo.waiting = pdo.waiting, None
                self._apply(pdo, data)
        for pdo in self._transmit:
            pdo.syncs += 1
            if pdo.valid and 0 < pdo.kind <= HIGHEST_SYNCHRONOUS and pdo.syncs % pdo.kind == 0:
                self.reply(self._told(pdo))

    def tell_change(self) -> None:
        """Something has happened that event-driven PDOs tell."""
        for pdo in self._transmit:
            if self.state == OPERATIONAL and pdo.valid and pdo.kind >= EVENT_DRIVEN and pdo.count:
                self.say(self._told(pdo))

    def _told(self, pdo: _Pdo) -> Frame:
        data = b"".join(self.objects[index, sub].data() for index, sub, _ in pdo.entries)
        return Frame(pdo.identifier & IDENTIFIER, data, extended=False)

    # -- service data --------------------------------------------------------------------------------

    def _serve(self, data: bytes) -> None:
        command = data[0]
        index, sub = data[1] | data[2] << 8, data[3]
        match command >> 5:
            case 1:
                self._begin_download(command, index, sub, data)
            case 0:
                self._take_segment(command, data)
            case 2:
                self._begin_upload(index, sub)
            case 3:
                self._tell_segment(command)
            case 4:
                self._transfer = None
            case _:
                self._abort(index, sub, UNKNOWN_COMMAND)

    def _answer(self, command: int, index: int, sub: int, data: bytes = b"") -> None:
        place = bytes((index & 0xFF, index >> 8, sub))
        self.reply(self._frame(SDO_REPLY, bytes((command,)) + place + data.ljust(4, b"\0")))

    def _abort(self, index: int, sub: int, code: int) -> None:
        self._transfer = None
        self._answer(0x80, index, sub, code.to_bytes(4, "little"))

    def _begin_download(self, command: int, index: int, sub: int, data: bytes) -> None:
        if not command & 0x02:
            self._transfer = _Transfer(index, sub, bytearray(), upload=False)
            self._answer(0x60, index, sub)
            return
        entry = self.objects.get((index, sub))
        size = 4 - (command >> 2 & 3) if command & 0x01 else (entry.size if entry is not None else 4)
        self._finish_download(index, sub, data[4 : 4 + size])

    def _finish_download(self, index: int, sub: int, data: bytes) -> bool:
        refused = self.put(index, sub, data)
        if refused:
            self._abort(index, sub, refused)
        elif self._transfer is None:
            self._answer(0x60, index, sub)
        return not refused

    def _take_segment(self, command: int, data: bytes) -> None:
        transfer = self._transfer
        if transfer is None or transfer.upload:
            self._abort(0, 0, UNKNOWN_COMMAND)
        elif command >> 4 & 1 != transfer.toggle:
            self._abort(transfer.index, transfer.sub, WRONG_TOGGLE)
        else:
            transfer.data += data[1 : 8 - (command >> 1 & 7)]
            done = command & 1
            if not done or self._finish_download(transfer.index, transfer.sub, bytes(transfer.data)):
                self.reply(self._frame(SDO_REPLY, bytes((0x20 | transfer.toggle << 4,)).ljust(8, b"\0")))
            transfer.toggle ^= 1
            if done:
                self._transfer = None

    def _begin_upload(self, index: int, sub: int) -> None:
        entry = self.objects.get((index, sub))
        if entry is None:
            self._abort(index, sub, NO_SUBINDEX if (index, 0) in self.objects else NO_OBJECT)
        elif not entry.readable:
            self._abort(index, sub, WRITE_ONLY)
        else:
            data = entry.data()
            if 0 < len(data) <= 4:
                self._answer(0x43 | (4 - len(data)) << 2, index, sub, data)
            else:
                self._transfer = _Transfer(index, sub, bytearray(data), upload=True)
                self._answer(0x41, index, sub, len(data).to_bytes(4, "little"))

    def _tell_segment(self, command: int) -> None:
        transfer = self._transfer
        if transfer is None or not transfer.upload:
            self._abort(0, 0, UNKNOWN_COMMAND)
        elif command >> 4 & 1 != transfer.toggle:
            self._abort(transfer.index, transfer.sub, WRONG_TOGGLE)
        else:
            part = bytes(transfer.data[:SEGMENT])
            del transfer.data[:SEGMENT]
            last = not transfer.data
            head = transfer.toggle << 4 | (SEGMENT - len(part)) << 1 | last
            transfer.toggle ^= 1
            self.reply(self._frame(SDO_REPLY, bytes((head,)) + part.ljust(SEGMENT, b"\0")))
            if last:
                self._transfer = None
