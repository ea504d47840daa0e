"""Dialogues of a bench test with one ZDT (Emm_V5) drive; after each of them but `send` the drive stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from config.derived import silence_acc_byte
from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION as TURN
from config.ramp import RAMP_RPM_S, ramp_rpm_s
from config.schema import ArmConfig
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_ask import Ask
from rtloop.drives.zdt_protocol import Block, Version
from rtloop.drives.zdt_talk import Answered
from rtloop.offline.calibration.zdt import AGREEING, AWAY_COUNTS, LATE_NS, Drive
from rtloop.service.conversation import silent_amid

MOST_RPM = 60
MOST_TURNS = 2.0
MOST_JOINT_DEG = 15.0
"""Longest single move of the joint, by the arm file's ratio."""
BRAKES_S = 0.3
"""Braking time that gives enough readings to measure the ramp; shorter if the move is too short for it."""
RAMPS_SHARE = 0.6
"""Largest share of the ramps in a move; the rest is at full speed."""
FLAGS_EACH = 5
"""Positions that are read for each status."""
PRESS_COUNTS = TURN // 12
"""30° of the motor, by which it is told to turn against its clamp."""
PRESS_RPM = 5
SWITCH_PATIENCE_NS = 180_000_000_000
POSITIONS = 30


@dataclass(frozen=True)
class Trial:
    """The move with which a motor is tested."""

    counts: int
    rpm: int
    acc_byte: int

    @property
    def ramp_rpm_s(self) -> float:
        """The ramp (rpm/s) of the ramp byte, according to the manual."""
        return ramp_rpm_s(self.acc_byte)

    @property
    def turns(self) -> float:
        """The length of the move (motor revolutions)."""
        return self.counts / TURN

    @property
    def lasts_ns(self) -> int:
        """Time from the command to standstill, according to the manual, plus the time of one ramp as a reserve."""
        return round((60.0 * self.turns / self.rpm + 2.0 * self.rpm / self.ramp_rpm_s) * 1e9)


def trial_of(arm: ArmConfig, joint: int) -> Trial:
    """A move that allows to measure the motor's ramp, by at most a quarter of the joint's range."""
    config = arm.joints[joint]
    turns = min(
        MOST_TURNS,
        config.ratio * min(MOST_JOINT_DEG, (config.upper_deg - config.lower_deg) / 4.0) / 360.0,
    )
    way = RAMPS_SHARE * 60.0 * turns
    speed = max(way / BRAKES_S, (way * ramp_rpm_s(protocol.GENTLEST_RAMP)) ** 0.5)
    rpm = max(1, int(min(MOST_RPM, config.motor_rpm, speed)))
    byte = round(256 - RAMP_RPM_S * BRAKES_S / rpm)
    acc_byte = max(protocol.GENTLEST_RAMP, min(byte, silence_acc_byte(config, arm.limits)))
    return Trial(round(turns * TURN), rpm, acc_byte)


def ask_all(questions: Mapping[str, Ask]) -> Answered[dict[str, bytes | None]]:
    """Ask a drive each question; its answers, packets joined."""
    answers = {}
    for name, ask in questions.items():
        answers[name] = yield ask
    return answers


def ask_positions() -> Answered[int]:
    """Read the drive's position POSITIONS times; how often it answered."""
    answered = 0
    for _ in range(POSITIONS):
        answered += (yield from zdt_talk.read_counts(protocol.ASK_POSITION)) is not None
    return answered


@dataclass(frozen=True)
class Ran:
    """Result of a move (positions in counts)."""

    start: int
    stands: int
    problem: str | None
    """Why the move was stopped early, to follow the drive's name."""


def run(drive: Drive, trial: Trial, legs: Sequence[tuple[int, int]]) -> Answered[Ran]:
    """Send a motor to targets, one after the other.

    Each leg is the distance after which its target is sent, and the target; both in counts from where the motor stands
    at first. The motor is watched all the way, stopped at any doubt, and checked to stand.
    """
    yield from drive.require_held()
    start = yield from drive.standing_on_target()
    ends_ns = drive.now_ns() + trial.lasts_ns + LATE_NS
    sign = 1 if legs[0][1] >= 0 else -1
    most = max(abs(goal) for _, goal in legs)
    left = list(legs)
    done = looks = silent = 0
    problem = None
    while problem is None and drive.now_ns() < ends_ns:
        due: tuple[bytes, ...] = ()
        if left and abs(done) >= abs(left[0][0]):
            due = (drive.move_to(start + left.pop(0)[1], trial.rpm, trial.acc_byte)[0],)
        answer = yield Ask(protocol.ASK_POSITION, (7,), before=due)
        counts = protocol.signed_of(answer, protocol.ASK_POSITION, 4)
        looks += 1
        silent, done = (silent + 1, done) if counts is None else (0, counts - start)
        if silent >= AGREEING:
            problem = "fell silent while it moved"
        elif not -AWAY_COUNTS <= sign * done <= most + AWAY_COUNTS:
            problem = "turned farther than it was told"
        elif looks % FLAGS_EACH == 0:
            problem = yield from _held_up()
    return Ran(start, (yield from drive.stand()), problem)


def send(drive: Drive, trial: Trial, by_counts: int) -> Answered[int]:
    """Command a move and do not watch it; the position (counts) where it began."""
    yield from drive.require_held()
    start = yield from drive.standing_on_target()
    yield Ask(drive.move_to(start + by_counts, trial.rpm, trial.acc_byte)[0], (3,), answered=False)
    return start


def _held_up() -> Answered[str | None]:
    flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
    if flags is None:
        return None  # the next positions will show
    if flags & (protocol.PROTECTED | protocol.STALLED):
        return "was held up (it says that it stalls)"
    return None if flags & protocol.ENABLED else "was let go or lost its power while it moved"


@dataclass(frozen=True)
class Pressed:
    """Result of pushing against a clamp."""

    moved: int
    """Largest distance from where the motor stood (counts)."""
    seconds: float
    """Time until the drive reported the wanted flags, or was stopped."""
    flags: int
    """The last flags of `3A` while it pushed."""
    cleared: bool
    """Whether a protection that tripped was cleared."""
    problem: str | None


def press(drive: Drive, sign: int, patience_ns: int, wanted: int) -> Answered[Pressed]:
    """Push until all flags of `wanted` are set, the shaft moves, or `patience_ns` is over; then stop.

    A protection that tripped is cleared, and the drive enabled again.
    """
    yield from drive.require_held()
    start = yield from drive.standing_on_target()
    command, _ = drive.move_to(start + sign * PRESS_COUNTS, PRESS_RPM, protocol.GENTLEST_RAMP)
    began_ns = drive.now_ns()
    yield Ask(command, (3,), answered=False)
    moved = flags = silent = 0
    while flags & wanted != wanted and moved <= AWAY_COUNTS and drive.now_ns() - began_ns < patience_ns:
        counts = yield from zdt_talk.read_counts(protocol.ASK_POSITION)
        now = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
        if counts is None or now is None:
            silent += 1
            if silent >= AGREEING:
                break
            continue
        silent, flags, moved = 0, now, max(moved, abs(counts - start))
    seconds = (drive.now_ns() - began_ns) * 1e-9
    cleared = False
    if flags & protocol.PROTECTED:
        yield Ask(protocol.CLEAR_PROTECTION, (3,), answered=False)
        cleared = not (yield from drive.flags()) & protocol.PROTECTED
    if cleared:
        yield from drive.hold()
    elif not flags & protocol.PROTECTED:
        yield from drive.stand()
    return Pressed(moved, seconds, flags, cleared, "fell silent" if silent >= AGREEING else None)


@dataclass(frozen=True)
class PowerCycle:
    """What a drive reported before and after its power was switched off and on; None for what it did not report."""

    firmware: Version
    flag_before: bool | None
    """The flag for lost power after it was cleared."""
    flag_after: bool | None
    flag_cleared: bool | None
    silent_s: float
    counts_before: int
    counts_after: int
    homing_forgotten: bool | None
    """Whether a homing time-out written to volatile memory is gone; None if it could not be written or read."""
    block_forgotten: bool | None
    """The same for the configuration block."""


@dataclass
class Changed:
    """Changes in volatile memory that a power cycle should undo, noted before they are made: old and new values."""

    homing_ms: tuple[int, int] | None = None
    block: tuple[Block, Block] | None = None


def put_back(drive: Drive, changed: Changed) -> Answered[None]:
    """Restore the old values in a drive that has kept the changes; raises DialogueFailed if that cannot be verified."""
    # a drive that has lost them keeps its stored values: the old ones may be a mark that proves its power
    if changed.homing_ms is not None:
        before_ms, now_ms = changed.homing_ms
        homing = yield from zdt_talk.surely(zdt_talk.read_homing)
        if homing is None or (homing.timeout_ms == now_ms and not (yield from zdt_talk.set_homing_timeout(before_ms))):
            raise drive.fails(_not_put_back(drive))
    if changed.block is not None:
        before, now = changed.block
        block = yield from zdt_talk.surely(zdt_talk.read_block)
        if block == now:
            yield Ask(protocol.write_block(before, store=False), (3,), answered=False)
            block = yield from zdt_talk.surely(zdt_talk.read_block)
        if block is None or block == now:
            raise drive.fails(_not_put_back(drive))


def _not_put_back(drive: Drive) -> str:
    return (
        f"Whether the drive of {drive.config.name} has its homing time-out and its stall time of before is not known: "
        "switch its power off and on, which brings back what it has stored."
    )


def power_cycle(
    drive: Drive, changed: Changed, tell: Callable[[str], None], lost: Callable[[], None]
) -> Answered[PowerCycle | None]:
    """Watch the drive while a person switches its power off and on; None if it was never silent.

    `changed` receives what must be put back. `lost` stores that the drive's count means nothing; it is called as soon
    as that is so, and before the flag that shows it is cleared.
    """
    version = protocol.version_of((yield Ask(protocol.ASK_FIRMWARE, (4, 6))))
    if version is None:
        raise drive.fails(silent_amid(drive.config, "firmware"))
    if (yield from drive.flags()) & protocol.POWER_LOST:
        lost()
    flag_before = yield from _clear_power_lost()
    before = yield from drive.counts()
    homing = yield from zdt_talk.surely(zdt_talk.read_homing)
    mark_ms = 0 if homing is None else zdt_talk.homing_mark_ms(homing.timeout_ms, drive.now_ns())
    changed.homing_ms = None if homing is None else (homing.timeout_ms, mark_ms)
    marked = homing is not None and (yield from zdt_talk.set_homing_timeout(mark_ms))
    block = (yield from zdt_talk.surely(zdt_talk.read_block)) if version.known else None
    taken = False
    if block is not None:
        other = replace(block, stall_time_ms=block.stall_time_ms ^ 1)
        changed.block = block, other
        yield Ask(protocol.write_block(other, store=False), (3,), answered=False)
        taken = (yield from zdt_talk.surely(zdt_talk.read_block)) == other
    tell(f"Switch the power of {drive.config.name}'s drive off now; it is watched until it falls silent.")
    silent_ns = answers_ns = yield from _wait_for(drive, answers=False)
    if silent_ns is not None:
        lost()
        tell("It is silent. Wait until its display is dark, then switch it on again.")
        answers_ns = yield from _wait_for(drive, answers=True)
        if answers_ns is None:
            raise drive.fails(silent_amid(drive.config, "status"))
    flags = yield from drive.flags()
    if flags & protocol.POWER_LOST:
        lost()  # even if no silence was noticed
    after = yield from drive.counts()
    homing_after = yield from zdt_talk.surely(zdt_talk.read_homing)
    block_after = (yield from zdt_talk.surely(zdt_talk.read_block)) if taken else None
    flag_cleared = yield from _clear_power_lost()
    if silent_ns is None or answers_ns is None:
        return None
    return PowerCycle(
        firmware=version,
        flag_before=flag_before,
        flag_after=bool(flags & protocol.POWER_LOST),
        flag_cleared=flag_cleared,
        silent_s=(answers_ns - silent_ns) * 1e-9,
        counts_before=before,
        counts_after=after,
        homing_forgotten=None if not marked or homing_after is None else homing_after.timeout_ms != mark_ms,
        block_forgotten=None if block_after is None else block_after == block,
    )


def _clear_power_lost() -> Answered[bool | None]:
    """Clear the flag for lost power; the flag after that, None without an answer."""
    flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS, before=(protocol.CLEAR_POWER_LOST,))
    return None if flags is None else bool(flags & protocol.POWER_LOST)


def _wait_for(drive: Drive, *, answers: bool) -> Answered[int | None]:
    """Wait until the drive answers (or, with `answers` False, does not answer) AGREEING times in a row.

    Returns the time (ns) of the first of these requests; None after `SWITCH_PATIENCE_NS`.
    """
    began_ns = drive.now_ns()
    since_ns, agreeing = began_ns, 0
    while agreeing < AGREEING:
        if drive.now_ns() - began_ns > SWITCH_PATIENCE_NS:
            return None
        now_ns = drive.now_ns()
        flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
        if (flags is not None) != answers:
            agreeing = 0
            continue
        since_ns = since_ns if agreeing else now_ns
        agreeing += 1
    return since_ns
