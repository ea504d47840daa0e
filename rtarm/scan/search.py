"""Looking for drives on a bus: listening first, then asking, bit rate by bit rate, and no longer than is said.

ZDT drives are asked, and so is everybody else who can be asked without harm to others (`rtarm.scan.questions`); drives
that speak by themselves are overheard (`rtarm.scan.overheard`), and nobody is asked then.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from config.drives.vesc import PACKET_BIT
from rtarm.scan.heard import Heard, by_number
from rtarm.scan.overheard import drive_of, of_a_vesc, overheard
from rtarm.scan.questions import BY_NAME, EVERYBODY, Question
from rtarm.scan.wires import Frame, SlcanWire, Wire
from rtloop.drives import vesc_protocol as vesc
from rtloop.drives import zdt_protocol as zdt
from rtloop.drives.zdt_ask import NOT_UNDERSTOOD, split_packets

BITRATES = (500_000, 1_000_000, 250_000, 125_000, 100_000, 50_000, 20_000, 10_000)
"""In the order in which they are tried: drives leave the factory with the first."""
NEVER_TRIED = (
    "Not tried: 800000 bit/s, since adapters disagree on which rate S7 is, and 83333 bit/s, which few adapters have; "
    "set the drives to 500000."
)
UNHEARD = (
    "The adapter cannot merely listen, so drives were asked without knowing whether somebody else used the bus: scan "
    "only while nothing else does."
)
LISTEN_S = 0.12
OVERHEARD_S = 1.1
"""So long is listened where drives speak by themselves: heartbeats a second apart are heard too."""
BUSY_FRAMES = 2
"""Frames heard before anybody was asked that make a bus somebody else's."""
VESC = (
    "A VESC of number 0 answers, to which questions to ZDT drives are commands, so nobody else was asked: give it "
    "another number with VESC Tool, or connect the drives alone, and scan again."
)
FIRST_ADDRESSES = range(1, 17)
OTHER_ADDRESSES = range(17, 256)
SURELY_HEARD = 16
"""Questions after which somebody must have acknowledged."""
LONGEST_S = 45.0
"""For one adapter; at 10 kbit/s all addresses alone take eight seconds."""
ROUND_BITS = 300
"""A question and its answer, worst case."""
REPLY_S = 0.05
TRIES = 3
STORM = 20
"""Answers `00 EE` from one address that no single drive would give."""


@dataclass
class FoundDrive:
    """A drive that has answered."""

    address: int
    firmware: str | None = None
    known: bool = False
    microsteps: int | None = None
    response: str | None = None
    current_ma: int | None = None
    protected: bool | None = None
    power_lost: bool | None = None
    notes: list[str] = field(default_factory=list)


@dataclass
class Outcome:
    """What came of looking at one bus.

    Attributes:
        bitrate: at which somebody answers or speaks, where it is known.
        drives: ZDT drives that have answered.
        answered: drives of other families that have.
        overheard: drives that have spoken by themselves.
        listened: bit rates at which the bus was listened on.
        asked: those at which drives were asked.
        notes: what else is to be said, sentences.
        asked_family: whose drives alone were to be asked; None for all who can be asked without harm to others.
    """

    bitrate: int | None = None
    drives: list[FoundDrive] = field(default_factory=list)
    answered: list[Heard] = field(default_factory=list)
    overheard: list[Heard] = field(default_factory=list)
    listened: list[int] = field(default_factory=list)
    asked: list[int] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    asked_family: str | None = None


def search_slcan(wire: SlcanWire, family: str | None = None) -> Outcome:
    """Find the bit rate of the bus behind a serial adapter, and its drives; `family`: whose drives alone are asked."""
    outcome = Outcome(asked_family=family)
    rates = [rate for rate in BITRATES if may_have(family, rate)]
    ends_s = wire.now_s() + LONGEST_S
    for bitrate in BITRATES:
        if not wire.open(bitrate, listen_only=True):
            continue  # the adapter has not got this rate, or cannot merely listen
        frames = _listen(wire, LISTEN_S)
        wire.close()
        outcome.listened.append(bitrate)
        if _others_speak(wire, frames):
            return in_use(outcome, bitrate, wire, frames)
    for bitrate in rates:
        if wire.now_s() > ends_s:
            left = ", ".join(str(rate) for rate in rates if rate not in outcome.asked)
            outcome.notes.append(f"Not asked at {left} bit/s: {LONGEST_S:g} s were over.")
            break
        if not wire.open(bitrate, listen_only=False):
            outcome.notes.append(
                f"Not asked at {bitrate} bit/s: the adapter refuses that rate, or to open its channel."
            )
            continue
        outcome.asked.append(bitrate)
        if not outcome.listened and UNHEARD not in outcome.notes:
            outcome.notes.append(UNHEARD)
        try:
            ask(wire, outcome, bitrate, ends_s)
        finally:
            wire.close()
        if outcome.bitrate:
            return outcome
    outcome.notes.append(NEVER_TRIED)
    return outcome


def search_link(wire: Wire, bitrate: int | None, family: str | None = None) -> Outcome:
    """Look for drives on a CAN interface, at the one bit rate the system has given it (bit/s; None for none)."""
    outcome = Outcome(listened=[bitrate] if bitrate else [], asked_family=family)
    frames = _listen(wire, OVERHEARD_S)
    if _others_speak(wire, frames):
        return in_use(outcome, bitrate, wire, frames)
    outcome.asked = outcome.listened
    ask(wire, outcome, bitrate or BITRATES[0], wire.now_s() + LONGEST_S)
    outcome.bitrate = bitrate if outcome.bitrate else None
    return outcome


def may_have(family: str | None, bitrate: int) -> bool:
    """Whether drives that are to be asked can be set to a bit rate (bit/s); ZDT drives, and all families, to each."""
    return family not in BY_NAME or bitrate in BY_NAME[family].bitrates


def _listen(wire: Wire, patience_s: float) -> list[Frame]:
    """What ZDT drives say within that time; drives that speak by themselves are given more of it."""
    frames = wire.receive(patience_s)
    if patience_s < OVERHEARD_S and any(map(drive_of, (*wire.standard, *frames))):
        frames += wire.receive(OVERHEARD_S - patience_s)
    return frames


def _others_speak(wire: Wire, frames: list[Frame]) -> bool:
    """Whether the bus is somebody's already; one frame may be a garbled one, but a heartbeat is a drive's."""
    return len(frames) + wire.foreign >= BUSY_FRAMES or any(map(drive_of, wire.standard))


def in_use(outcome: Outcome, bitrate: int | None, wire: Wire, frames: list[Frame]) -> Outcome:
    """Somebody speaks already: that is told, and nobody is asked."""
    outcome.overheard = overheard((*wire.standard, *frames))
    vescs = {drive.number for drive in outcome.overheard if drive.family == "vesc"}
    frames = [frame for frame in frames if not of_a_vesc(frame, vescs)]
    addresses = sorted({frame.id >> 8 for frame in frames if frame.id < 0x10000})
    whose = f" (addresses {', '.join(map(str, addresses))})" if addresses else ""
    outcome.bitrate = bitrate
    if outcome.overheard and not frames:
        outcome.notes.append(
            "Nobody was asked, since these drives were overheard: others that speak only when they are spoken to are "
            "not shown. To look for those too, connect them alone and scan again."
        )
    elif frames:
        outcome.notes.append(
            f"Frames were heard before anybody was asked{whose}: another program drives these drives, or they report "
            "by themselves, so nobody was asked; end that program or, where none runs, switch the drives off and on, "
            "and scan again."
        )
    else:
        outcome.notes.append(
            "Frames were heard before anybody was asked, of a kind that these drives do not send: the bus belongs to "
            "something else, which questions might disturb, so nobody was asked; connect the drives alone and scan "
            "again."
        )
    return outcome


def ask(wire: Wire, outcome: Outcome, bitrate: int, ends_s: float) -> None:
    """Ask who can be asked, or one family alone; where somebody answers, the outcome has its bit rate."""
    family = outcome.asked_family
    if family in (None, "zdt"):
        if a_vesc_answers(wire, bitrate):
            outcome.bitrate = bitrate
            outcome.notes.append(VESC)
            return
        outcome.drives = ask_zdt(wire, bitrate, ends_s)
    others = EVERYBODY if family is None else [BY_NAME[family]] if family in BY_NAME else []
    for question in others:
        if bitrate in question.bitrates and wire.now_s() < ends_s:
            heard = ask_family(wire, question, bitrate, acknowledged=bool(outcome.drives))
            outcome.answered += by_number(heard)
            outcome.notes += _sharing_a_number(heard)
    if outcome.drives or outcome.answered:
        outcome.bitrate = bitrate


def a_vesc_answers(wire: Wire, bitrate: int) -> bool:
    """Whether a VESC of number 0 is there: a ZDT question to address 17 is its ping, and the answer names who asked."""
    pong = vesc.PONG << PACKET_BIT | zdt.ASK_FIRMWARE[0]
    return any(frame.id == pong for frame in _ask_for_firmware(wire, (vesc.PING,), ROUND_BITS / bitrate + 0.001))


def ask_family(wire: Wire, question: Question, bitrate: int, *, acknowledged: bool) -> list[Heard]:
    """Ask each number of a family who is there: all answers; `acknowledged`: whether somebody has answered before."""
    pace_s = ROUND_BITS / bitrate + 0.001
    wire.standard.clear()
    heard: list[Frame] = []
    for number, frame in enumerate(question.frames, 1):
        wire.send(frame)
        heard += wire.receive(pace_s)
        if number == SURELY_HEARD and not acknowledged:
            heard += wire.receive(REPLY_S)
            if not heard and not wire.standard and wire.troubled():
                return []  # nobody acknowledges, so nobody is at this rate
    heard += wire.receive(REPLY_S + pace_s)
    said = [frame for frame in (*heard, *wire.standard) if frame not in question.frames]  # some adapters echo
    return [drive for drive in map(question.drive_of, said) if drive is not None]


def _sharing_a_number(heard: list[Heard]) -> list[str]:
    """A sentence for each number at which more than one drive has answered; each was asked once."""
    times = Counter((drive.called, drive.number) for drive in heard)
    return [
        f"More than one {called} answers at number {number}: unplug all but one, give each a number of its own with "
        "its maker's program or in its menu, switch off and on, and scan again."
        for (called, number), count in times.items()
        if count > 1
    ]


def ask_zdt(wire: Wire, bitrate: int, ends_s: float) -> list[FoundDrive]:
    """Ask every address for its firmware, then every drive that answered for its settings."""
    pace_s = ROUND_BITS / bitrate + 0.001
    heard = _ask_for_firmware(wire, FIRST_ADDRESSES, pace_s)
    if not heard and wire.troubled():
        return []  # nobody acknowledges, so nobody is at this rate
    for _ in range(TRIES - 1 if heard else 0):  # an answer may be lost
        answered = {frame.id >> 8 for frame in heard}
        heard += _ask_for_firmware(wire, [a for a in FIRST_ADDRESSES if a not in answered], pace_s)
    heard += _ask_for_firmware(wire, OTHER_ADDRESSES, pace_s)
    found = []
    for address in sorted({frame.id >> 8 for frame in heard if 0 < frame.id >> 8 < 256}):
        of_it = [frame.data for frame in heard if frame.id >> 8 == address and frame.id & 0xFF == 0]
        drive = _introduce(address, of_it)
        if drive is None:
            continue
        if not drive.notes and wire.now_s() < ends_s:
            _ask_for_settings(wire, drive, pace_s)
        found.append(drive)
    return found


def _ask_for_firmware(wire: Wire, addresses: Iterable[int], pace_s: float) -> list[Frame]:
    heard = []
    for address in addresses:
        wire.send(Frame(address << 8, zdt.ASK_FIRMWARE))
        heard += wire.receive(pace_s)
    return heard + wire.receive(REPLY_S + pace_s)


def _introduce(address: int, said: list[bytes]) -> FoundDrive | None:
    """What the answers of one address to one question make of it; None if no drive said any of them."""
    answers = [data for data in said if data[:1] == zdt.ASK_FIRMWARE[:1] and len(data) in (4, 6)]
    spoilt = [data for data in said if data[:2] == NOT_UNDERSTOOD[:2] and len(data) == 3]
    if not answers and not spoilt:
        return None
    drive = FoundDrive(address)
    if len(answers) > 1 or len(spoilt) > STORM:
        drive.notes.append(
            f"More than one drive answers at address {address}: unplug all but one, give each an address of its own in "
            "its menu, switch off and on, and scan again."
        )
    elif not any(data[-1] == zdt.CHECKSUM for data in (*answers, *spoilt)):
        drive.notes.append(f"The drive at address {address} uses another checksum: set Checksum to 0x6B in its menu.")
    version = zdt.version_of(answers[0]) if answers and answers[0][-1] == zdt.CHECKSUM else None
    if version is not None:
        drive.firmware, drive.known = str(version), version.known
    return drive


def _ask_for_settings(wire: Wire, drive: FoundDrive, pace_s: float) -> None:
    heads: set[bytes] = set()
    answer = _ask(wire, drive.address, zdt.ASK_BLOCK, zdt.BLOCK_PACKETS, pace_s, heads)
    block = zdt.block_of(answer)
    if block is None and (not heads or zdt.BLOCK_HEAD in heads):
        drive.notes.append(
            f"The drive at address {drive.address} answers, but its configuration did not come through in {TRIES} "
            "tries: check the adapter's cable, the two CAN wires and 120 Ω at both ends, then scan again."
        )
    elif block is None:
        drive.notes.append(
            f"The drive at address {drive.address} has another configuration than Emm_V5 firmware: it may run X "
            "firmware; switch it to Emm in its menu before anything moves it."
        )
    else:
        drive.microsteps, drive.current_ma = block.microsteps, block.current_ma
        if block.response < len(zdt.RESPONSES):
            drive.response = zdt.RESPONSES[block.response]
    answer = _ask(wire, drive.address, zdt.ASK_STATUS, 1, pace_s)
    flags = zdt.number_of(answer, zdt.ASK_STATUS, 1)
    if flags is not None:
        drive.protected, drive.power_lost = bool(flags & zdt.PROTECTED), bool(flags & zdt.POWER_LOST)


def _ask(
    wire: Wire, address: int, question: bytes, packets: int, pace_s: float, heads: set[bytes] | None = None
) -> bytes | None:
    """The whole answer to a question, packets joined behind one function byte.

    `heads` gets what every try's first packet begins with behind that byte (two bytes), also where others are missing.
    """
    for _ in range(TRIES):
        for frame in split_packets(address, question):
            wire.send(Frame(frame.id, frame.data))
        parts: dict[int, bytes] = {}
        for frame_id, data, _ in wire.receive(REPLY_S + packets * pace_s):
            answers = data[:1] == question[:1] and data != question
            if frame_id >> 8 == address and frame_id & 0xFF < packets and answers:
                parts[frame_id & 0xFF] = data[1:]
        if heads is not None and 0 in parts:
            heads.add(parts[0][:2])
        if len(parts) == packets:
            whole = question[:1] + b"".join(parts[number] for number in range(packets))
            if whole[-1] == zdt.CHECKSUM:
                return whole
    return None
