"""Bring-up: the conversation with the drives that ends in an arm that holds, or in a sentence saying why not.

Ordinary Python, run beside the cycle and speaking through its service rings, so it works the same at start
and after a fault was cleared. Every drive has a dialogue of its own, a generator that yields what it wants
to ask and gets the answer; all dialogues advance together. `poll(now_ns)` is called from time to time and
never waits, so tests drive it in virtual time.

What a ZDT drive is asked (init_mode 1, nothing moves): firmware, status, configuration block (response
mode turned off in volatile memory when it differs and the firmware is one whose block we know), position
and target until the two agree.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field

from config.budget import budget
from config.schema import ArmConfig, JointConfig, ZdtDrive
from rtloop.service import ADOPT, BRING_UP_BEGINS, BRING_UP_DONE, BRING_UP_FAILED, SEND, Frame, ServicePort
from shm.words import Fault, Unreferenced

ANSWER_PATIENCE_NS = 60_000_000
TRIES = 5
SETTLE_PATIENCE_NS = 3_000_000_000
ADOPT_WITHIN_RAD = 0.02
"""A drive whose target lies this near to its position is taken at its word."""

RESPONSE_NONE = 0
RESPONSE_RECEIVE = 1
KNOWN_FIRMWARE = range(100, 300)
"""Emm_V5 versions 1.0 to 2.9 share the configuration block (facts: V1.0.7 and V2.0.0 were tried)."""
_BLOCK_BYTES = 28
_BLOCK_HEAD = bytes((33, 21))  # byte count and field count of that block
_SCREEN, _ID, _CHECKSUM, _RESPONSE, _MICROSTEPS = 7, 16, 17, 18, 5


class BringUpFailed(Exception):
    """Bring-up cannot go on; the text is the sentence people read."""

    def __init__(self, joint: int, sentence: str) -> None:
        super().__init__(sentence)
        self.joint = joint


@dataclass(frozen=True)
class Ask:
    """A command and how to know its answer: function byte and number of packets, or one short reply."""

    payload: bytes
    reply_lengths: tuple[int, ...]
    packets: int = 1
    answered: bool = True


Dialogue = Generator[Ask, bytes | None, None]


@dataclass
class _Exchange:
    """A running question to one drive."""

    ask: Ask
    sent_ns: int
    tries: int
    packets: dict[int, bytes] = field(default_factory=dict)


def split_packets(address: int, payload: bytes) -> list[Frame]:
    """CAN frames of a ZDT command: ≤ 8 bytes in one; longer ones repeat the function byte in every packet."""
    if len(payload) <= 8:
        return [Frame(address << 8, payload)]
    function, rest = payload[:1], payload[1:]
    pieces = [rest[at : at + 7] for at in range(0, len(rest), 7)]
    return [Frame((address << 8) | number, function + piece) for number, piece in enumerate(pieces)]


class BringUp:
    """One bring-up of a whole arm."""

    def __init__(
        self,
        arm: ArmConfig,
        port: ServicePort,
        *,
        now_ns: int,
        clears_protection: bool,
        tell: Callable[[str], None],
        mock_positions_rad: list[float] | None = None,
    ) -> None:
        self._arm = arm
        self._port = port
        self._tell = tell
        self._clears_protection = clears_protection
        self._now_ns = now_ns
        self._dialogues: dict[int, Dialogue] = {}
        self._exchanges: dict[int, _Exchange] = {}
        self._outbox: list[tuple[Frame, bool]] = []
        self.done = False
        self.failure: BringUpFailed | None = None
        port.received()  # what was said before this conversation does not belong to it
        self._post(BRING_UP_BEGINS)
        for joint, config in enumerate(arm.joints):
            if isinstance(config.drive, ZdtDrive):
                self._dialogues[joint] = self._bring_up_zdt(joint, config, config.drive)
            else:
                start = mock_positions_rad[joint] if mock_positions_rad else 0.0
                self._adopt(joint, min(max(start, config.lower_rad), config.upper_rad), Unreferenced.REFERENCED)
        for joint in list(self._dialogues):
            self._advance(joint, None)

    def poll(self, now_ns: int) -> bool:
        """Take answers, ask on; True once the conversation is over (see `failure`)."""
        self._now_ns = now_ns
        if self.done:
            return True
        try:
            for frame in self._port.received():
                self._hear(frame)
            for joint in list(self._exchanges):
                self._repeat_or_give_up(joint)
        except BringUpFailed as failure:
            self.failure = failure
            self.done = True
            self._post(BRING_UP_FAILED, joint=failure.joint, code=Fault.BRING_UP)
            return True
        self._flush()
        if not self._dialogues and not self._outbox:
            self._post(BRING_UP_DONE)
            self.done = True
        return self.done

    # --- the machinery

    def _post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        if not self._port.post(kind, joint=joint, value=value, code=code):
            raise BringUpFailed(joint, "The control cycle takes no orders: it has stopped; start rtarm again.")

    def _adopt(self, joint: int, position_rad: float, reason: Unreferenced) -> None:
        self._post(ADOPT, joint=joint, value=position_rad, code=reason)

    def _flush(self) -> None:
        while self._outbox:
            frame, joined = self._outbox[0]
            if not self._port.post(SEND, frame=frame, joined=joined):
                return
            self._outbox.pop(0)

    def _advance(self, joint: int, answer: bytes | None) -> None:
        self._exchanges.pop(joint, None)
        try:
            ask = self._dialogues[joint].send(answer)
        except StopIteration:
            del self._dialogues[joint]
            return
        self._exchanges[joint] = _Exchange(ask, self._now_ns, 1)
        self._say(joint, ask)

    def _say(self, joint: int, ask: Ask) -> None:
        drive = self._arm.joints[joint].drive
        assert isinstance(drive, ZdtDrive)
        frames = split_packets(drive.address, ask.payload)
        self._outbox += [(frame, number < len(frames) - 1) for number, frame in enumerate(frames)]
        self._flush()

    def _hear(self, frame: Frame) -> None:
        for joint, exchange in list(self._exchanges.items()):
            drive = self._arm.joints[joint].drive
            assert isinstance(drive, ZdtDrive)
            if frame.id >> 8 != drive.address or not frame.data:
                continue
            if frame.time_ns < exchange.sent_ns:
                continue  # the late answer to an earlier question
            packet, ask = frame.id & 255, exchange.ask
            if packet == 0 and (_is_refusal(frame.data, ask.payload[0])):
                self._advance(joint, frame.data)
            elif frame.data[0] == ask.payload[0] and packet < ask.packets:
                if ask.packets == 1 and len(frame.data) not in ask.reply_lengths:
                    continue  # an echo of the question, or an answer to somebody else's
                exchange.packets[packet] = frame.data
                if len(exchange.packets) == ask.packets:
                    joined = exchange.packets[0][:1]
                    for number in range(ask.packets):
                        joined += exchange.packets[number][1:]
                    if joined[-1] == 0x6B:
                        self._advance(joint, joined)
                    else:
                        exchange.packets.clear()

    def _repeat_or_give_up(self, joint: int) -> None:
        exchange = self._exchanges[joint]
        if self._now_ns - exchange.sent_ns < ANSWER_PATIENCE_NS:
            return
        if not exchange.ask.answered or exchange.tries >= TRIES:
            self._advance(joint, None)
            return
        exchange.tries += 1
        exchange.sent_ns = self._now_ns
        exchange.packets.clear()
        self._say(joint, exchange.ask)

    # --- what is said to a ZDT drive

    def _bring_up_zdt(self, joint: int, config: JointConfig, drive: ZdtDrive) -> Dialogue:
        firmware = yield Ask(b"\x1f\x6b", (4, 6))
        if firmware is None:
            raise BringUpFailed(
                joint,
                f"The drive of {config.name} (address {drive.address}) does not answer: check its power, its address "
                f"and the bit rate ({self._arm.bus.bitrate} bit/s) in its menu, and the CAN wires with 120 Ω at both "
                "ends.",
            )
        version = _version(firmware)
        if len(firmware) == 4:
            self._tell(
                f"{config.name}: firmware {version} cannot say whether the drive has lost power; see that the joint "
                "stands where `rtarm status` says before it moves."
            )
        reason = Unreferenced.REFERENCED
        flags = yield from self._status(joint, config)
        if flags & 0x08:
            if not self._clears_protection:
                raise BringUpFailed(
                    joint,
                    f"The drive of {config.name} has tripped its stall protection and holds nothing: free what blocks "
                    "the joint, then `rtarm clear-fault`.",
                )
            yield Ask(b"\x0e\x52\x6b", (3,))
            flags = yield from self._status(joint, config)
        if flags & 0x80:
            reason = Unreferenced.POWER_LOST
            self._tell(
                f"{config.name} is not referenced: its drive has lost power since its position was set, so its count "
                "does not mean an angle; home it with the drive's own means and clear its flag; goals are refused "
                "until then."
            )
        yield from self._settle_configuration(joint, config, drive, version)
        if not flags & 0x01:
            yield Ask(b"\xf3\xab\x01\x00\x6b", (3,), answered=self._arm.bus.acknowledge)
            flags = yield from self._status(joint, config)
            if not flags & 0x01:
                raise BringUpFailed(
                    joint,
                    f"The drive of {config.name} stays disabled after being enabled: look at its display for a fault "
                    "and at the En setting in its menu.",
                )
        yield from self._adopt_position(joint, config, reason)

    def _status(self, joint: int, config: JointConfig) -> Generator[Ask, bytes | None, int]:
        answer = yield Ask(b"\x3a\x6b", (3,))
        if answer is None or answer[0] != 0x3A:
            raise BringUpFailed(joint, _silent_amid(config, "status"))
        return answer[1]

    def _settle_configuration(self, joint: int, config: JointConfig, drive: ZdtDrive, version: int) -> Dialogue:
        """Check what would make motion wrong; set the response mode in volatile memory."""
        wanted = RESPONSE_RECEIVE if self._arm.bus.acknowledge else RESPONSE_NONE
        block = yield from self._read_block()
        if block is None or version not in KNOWN_FIRMWARE:
            if not self._arm.bus.acknowledge:
                self._require_budget_with_acknowledgements(joint, config, version)
            return
        if block[_CHECKSUM] != 0:
            raise BringUpFailed(
                joint,
                f"The drive of {config.name} uses checksum mode {block[_CHECKSUM]}, only 0 (the constant 6B) is spoken "
                "here: set Checksum to 0x6B in its menu.",
            )
        microsteps = block[_MICROSTEPS] or 256
        if microsteps != drive.microsteps:
            raise BringUpFailed(
                joint,
                f"The drive of {config.name} is set to {microsteps} microsteps, the arm file says {drive.microsteps}: "
                "positions would be wrong by that factor; change one of the two.",
            )
        if block[_RESPONSE] == wanted:
            return
        changed = bytearray(block)
        changed[_RESPONSE] = wanted
        changed[_ID] = changed[_SCREEN] = 0  # sent as 0 by everybody who writes this block: left as they are
        yield Ask(b"\x48\xd1\x00" + bytes(changed) + b"\x6b", (3,))
        for _ in range(TRIES):  # an answer from before the change may still be on its way
            after = yield from self._read_block()
            if after is not None and after[_RESPONSE] == wanted:
                break
        else:
            self._require_budget_with_acknowledgements(joint, config, version)
            self._tell(f"{config.name}: its drive keeps its acknowledgements on although told otherwise.")
            return
        name = "on" if wanted else "off"
        self._tell(f"{config.name}: acknowledgements turned {name} in the drive's volatile memory.")

    def _read_block(self) -> Generator[Ask, bytes | None, bytes | None]:
        answer = yield Ask(b"\x42\x6c\x6b", (8,), packets=5)
        if answer is None or answer[1:3] != _BLOCK_HEAD or len(answer) != _BLOCK_BYTES + 4:
            return None
        return answer[3 : 3 + _BLOCK_BYTES]

    def _require_budget_with_acknowledgements(self, joint: int, config: JointConfig, version: int) -> None:
        loud = self._arm.model_copy(update={"bus": self._arm.bus.model_copy(update={"acknowledge": True})})
        found = budget(loud)
        if not found.fits:
            raise BringUpFailed(
                joint,
                f"The drive of {config.name} (firmware {version}) keeps acknowledging commands, and with "
                f"acknowledgements the bus carries {found.highest_rate_hz:.0f} Hz, not "
                f"{self._arm.control.rate_hz:g} Hz: lower control.rate_hz, or turn its Response off in its menu.",
            )

    def _adopt_position(self, joint: int, config: JointConfig, reason: Unreferenced) -> Dialogue:
        """Take the drive's own target as the commanded position, once the joint stands near it."""
        started_ns = self._now_ns
        counts_per_rad = config.direction * config.encoder_counts_per_rad
        while True:
            answer = yield Ask(b"\x36\x6b", (7,))
            measured = _signed_counts(answer, 0x36)
            answer = yield Ask(b"\x33\x6b", (7,))
            target = _signed_counts(answer, 0x33)
            if measured is None or target is None:
                raise BringUpFailed(joint, _silent_amid(config, "position"))
            measured_rad = measured / counts_per_rad - config.zero_rad
            target_rad = target / counts_per_rad - config.zero_rad
            if abs(target_rad - measured_rad) <= ADOPT_WITHIN_RAD:
                break
            if self._now_ns - started_ns > SETTLE_PATIENCE_NS:
                if reason == Unreferenced.REFERENCED:
                    reason = Unreferenced.TARGET_FAR
                    self._tell(
                        f"{config.name} is not referenced: its drive stands {measured_rad - target_rad:+.3f} rad from "
                        "its own target and does not go there; find what holds it, then start again."
                    )
                target_rad = measured_rad
                break
        slack = ADOPT_WITHIN_RAD
        if reason == Unreferenced.REFERENCED and not (
            config.lower_rad - slack <= measured_rad <= config.upper_rad + slack
        ):
            reason = Unreferenced.OUTSIDE_LIMITS
            self._tell(
                f"{config.name} is not referenced: it reads {measured_rad:+.3f} rad, outside its limits "
                f"{config.lower_rad:+.3f} to {config.upper_rad:+.3f} rad; home it, or mend zero_deg or direction."
            )
        self._adopt(joint, target_rad, reason)


def _is_refusal(data: bytes, function: int) -> bool:
    """`func E2 6B`, `func EE 6B` or `00 EE 6B`."""
    if len(data) != 3 or data[2] != 0x6B:
        return False
    return (data[0] == function and data[1] in (0xE2, 0xEE) and function != 0x3A) or data[:2] == b"\x00\xee"


def _version(answer: bytes) -> int:
    """Firmware version: one byte on old drives (`1F fw hw 6B`), two on new ones (`1F fw16 hw16 6B`)."""
    if answer[0] != 0x1F:
        return 0
    return answer[1] if len(answer) == 4 else int.from_bytes(answer[1:3], "big")


def _signed_counts(answer: bytes | None, function: int) -> int | None:
    if answer is None or len(answer) != 7 or answer[0] != function:
        return None
    magnitude = int.from_bytes(answer[2:6], "big")
    return -magnitude if answer[1] else magnitude


def _silent_amid(config: JointConfig, what: str) -> str:
    return (
        f"The drive of {config.name} stopped answering while its {what} was read: check its power and the CAN wires, "
        "then start again."
    )
