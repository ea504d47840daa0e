"""Dialogues that turn one ZDT drive's motor slowly by a little, watch it all the way, and stop it at any doubt.

Everything is in counts of the motor (65536 a turn), because neither ratio nor direction of its joint is known yet. A
move is one absolute `FD` with the drive's own ramp. So a frame that is lost or received twice moves nothing farther,
and a drive that receives nothing more goes no farther than the end of that one move.
"""

from __future__ import annotations

from collections.abc import Callable

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_ask import Ask, addressed
from rtloop.drives.zdt_talk import Answered
from rtloop.offline.calibration.talk import Found, State
from rtloop.offline.settings.compare import DriveReport
from rtloop.offline.settings.zdt_talk import Reading
from rtloop.service.conversation import TRIES, DialogueFailed, Part, Value, silent_amid

AWAY_COUNTS = ENCODER_COUNTS_PER_REVOLUTION // 36
"""10° of the motor: a motor that is farther than this from where it should be is stopped."""
ARRIVED_COUNTS = 200
"""About a degree of the motor: a closed loop that holds dithers by less."""
STILL_COUNTS, STILL_NS = 60, 150_000_000
"""A motor stands if it moves by no more than this within that time; at 1 rpm, the slowest move, it would be 164."""
LATE_NS = 300_000_000
"""Longest time from queuing a command to the drive's first step, at low control rates."""
STAND_TRIES = 5
AGREEING = 2
"""Missing answers in a row that count as silence."""
SETTLED_NS = 250_000_000
"""Time for which the motor must be at its goal before it is stopped; at 1 rpm it makes the last degree in that time."""


class Drive:
    """The dialogues of `talk.Motor` with one drive; `now_ns` is the clock."""

    def __init__(self, arm: ArmConfig, joint: int, now_ns: Callable[[], int]) -> None:
        self.joint = joint
        self.config: JointConfig = arm.joints[joint]
        self._pulses_per_turn = self.config.drive.command_steps_per_revolution
        self.now_ns = now_ns

    def addressed(self, dialogue: Answered[Value]) -> Part[Value]:
        """Address a dialogue to this drive."""
        return addressed(self.config.drive.number, dialogue)

    # --- reading

    def counts(self) -> Answered[int]:
        """The motor's position."""
        found = yield from zdt_talk.read_counts(protocol.ASK_POSITION)
        if found is None:
            raise self.fails(silent_amid(self.config, "position"))
        return found

    def flags(self) -> Answered[int]:
        """The flags of `3A`."""
        found = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
        if found is None:
            raise self.fails(silent_amid(self.config, "status"))
        return found

    def state(self) -> Answered[State]:
        """The drive's state."""
        flags = yield from self.flags()
        return State(bool(flags & protocol.ENABLED), bool(flags & protocol.POWER_LOST))

    def require_held(self) -> Answered[int]:
        """Check that the drive holds the joint and may move it; its flags."""
        flags = yield from self._require_sound()
        if not flags & protocol.ENABLED:
            raise self.fails(f"The drive of {self.config.name} is limp, so it cannot turn: let it hold first.")
        return flags

    # --- holding and letting go

    def stand(self) -> Answered[int]:
        """Stop the drive, and check that it stands; its position."""
        for _ in range(STAND_TRIES):
            began_ns = self.now_ns()
            answer = yield Ask(protocol.ASK_POSITION, (7,), before=(protocol.STOP,))
            least = most = protocol.signed_of(answer, protocol.ASK_POSITION, 4)
            while least is not None and most is not None and self.now_ns() - began_ns < STILL_NS:
                now = yield from zdt_talk.read_counts(protocol.ASK_POSITION)
                least, most = (None, None) if now is None else (min(least, now), max(most, now))
            if least is not None and most is not None and most - least <= STILL_COUNTS:
                return most
        raise self.fails(
            f"The drive of {self.config.name} does not say that it stands: it ends its small move by itself; use the "
            "switch in the power line if it does not."
        )

    def stand_held(self) -> Answered[int]:
        """The same for a drive that must hold its joint."""
        yield from self.require_held()
        return (yield from self.stand())

    def hold(self) -> Answered[int]:
        """Enable the drive, and check that it holds and stands; its position."""
        yield from self._require_sound()
        for _ in range(TRIES):
            # it may pull its shaft to its target from before it was disabled, so the stop follows in the same cycle
            flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS, before=(protocol.ENABLE, protocol.STOP))
            if flags is not None and flags & protocol.ENABLED:
                return (yield from self.stand())
        raise self.fails(
            f"The drive of {self.config.name} stays disabled after being enabled: hold the joint, and look at the "
            "drive's display for a fault and at the En setting in its menu."
        )

    def let_go(self) -> Answered[int]:
        """Switch the drive's torque off, so that its shaft turns freely; its position then."""
        for _ in range(TRIES):
            flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS, before=(protocol.RELEASE,))
            if flags is not None and not flags & protocol.ENABLED:
                return (yield from self.counts())
        raise self.fails(f"The drive of {self.config.name} does not let its shaft go: turn the joint by the drive.")

    # --- moving

    def turn(self, by_counts: int, rpm: int) -> Answered[int]:
        """Turn the motor by `by_counts`, and check that it does just that; its position then.

        If it does not, raises DialogueFailed once the motor was stopped, or could not be.
        """
        flags = yield from self.require_held()
        start = yield from self.standing_on_target()
        command, goal = self.move_to(start + by_counts, rpm, protocol.GENTLEST_RAMP)
        sent_ns = self.now_ns()
        answer = yield Ask(command, (3,), answered=False)
        if answer is not None and answer[1] in protocol.REFUSALS:
            raise self.fails(
                f"The drive of {self.config.name} refuses to move, and stands: look at its display for a fault."
            )
        problem = yield from self._watch(start, goal, rpm, sent_ns, flags)
        stands = yield from self.stand()
        if problem is None and abs(stands - goal) <= ARRIVED_COUNTS:
            return stands
        problem = problem or "did not stay where it was sent"
        raise self.fails(
            f"The drive of {self.config.name} {problem}: it was stopped, after {_degrees(stands - start)} of "
            f"{_degrees(goal - start)} of the motor. See what holds the joint (its stop, a cable, its own weight), "
            "free it, and run this again."
        )

    def move_to(self, counts: int, rpm: int, ramp: int) -> tuple[bytes, int]:
        """The command to go to a position (counts), and that position rounded to whole pulses (counts)."""
        pulses = round(counts * self._pulses_per_turn / ENCODER_COUNTS_PER_REVOLUTION)
        goal = round(pulses * ENCODER_COUNTS_PER_REVOLUTION / self._pulses_per_turn)
        return protocol.move_to(pulses, rpm, ramp), goal

    def _watch(self, start: int, goal: int, rpm: int, sent_ns: int, flags: int) -> Answered[str | None]:
        """Watch the motor until it has arrived; else what went wrong, to follow the drive's name."""
        sign = 1 if goal >= start else -1
        total = abs(goal - start)
        counts_per_ns = rpm / 60e9 * ENCODER_COUNTS_PER_REVOLUTION
        silent = 0
        there_ns: int | None = None
        while there_ns is None or self.now_ns() - there_ns < SETTLED_NS:
            asked_ns = self.now_ns()  # when the drive answers, it has moved for at least this long
            counts = yield from zdt_talk.read_counts(protocol.ASK_POSITION)
            now = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
            if counts is None or now is None:
                silent += 1
                if silent >= AGREEING:  # each of them was asked several times
                    return "fell silent while it moved"
                continue
            silent = 0
            if now & (protocol.PROTECTED | protocol.STALLED):
                return "was held up (it says that it stalls)"
            if not now & protocol.ENABLED or now & protocol.POWER_LOST & ~flags:
                return "lost its power or was let go while it moved"
            done = sign * (counts - start)
            if done < min(total, (asked_ns - sent_ns - LATE_NS) * counts_per_ns) - AWAY_COUNTS:
                return "does not turn as it should"
            if done > min(total, (self.now_ns() - sent_ns) * counts_per_ns) + AWAY_COUNTS:
                return "turns farther or faster than it was told"
            if abs(done - total) > ARRIVED_COUNTS:
                there_ns = None
            elif there_ns is None:
                there_ns = asked_ns
            if there_ns is None and asked_ns - sent_ns > total / counts_per_ns + 4 * LATE_NS:
                return "does not arrive"
        return None

    def _require_sound(self) -> Answered[int]:
        flags = yield from self.flags()
        if flags & protocol.PROTECTED:
            raise self.fails(
                f"The drive of {self.config.name} is in protection and holds nothing: remove the cause, switch the "
                "drive off and on, then run this again."
            )
        return flags

    def standing_on_target(self) -> Answered[int]:
        """The motor's position once it is the drive's own target too, so that nothing is left of earlier moves."""
        for _ in range(TRIES):
            measured = yield from self.counts()
            target = yield from zdt_talk.read_counts(protocol.ASK_TARGET)
            if target is not None and abs(measured - target) <= ARRIVED_COUNTS:
                return measured
            yield from self.stand()
        raise self.fails(
            f"The drive of {self.config.name} does not take where it stands for its target: switch it off and on, "
            "then run this again."
        )

    def fails(self, sentence: str) -> DialogueFailed:
        return DialogueFailed(self.joint, sentence)


def _degrees(counts: int) -> str:
    return f"{counts * 360 / ENCODER_COUNTS_PER_REVOLUTION:+.1f}°"


motor_of = Drive


def found_of(arm: ArmConfig, joint: int, reading: Reading, report: DriveReport) -> Found:
    """What a drive is before anything moves; see `talk.MotorFile`."""
    return Found(
        joint=report.joint,
        address=report.address,
        firmware="" if reading.version is None else str(reading.version),
        enabled=bool((reading.flags or 0) & protocol.ENABLED),
        homing_rpm=None if reading.homing is None else reading.homing.rpm,
        problems=report.left_alone or _not_countable(arm.joints[joint], reading),
    )


def tells_power_loss(reading: Reading) -> bool:
    """Whether its firmware has a flag for lost power; see `talk.MotorFile`."""
    return reading.version is not None and reading.version.newer


def _not_countable(config: JointConfig, reading: Reading) -> list[str]:
    """Why a pulse of this drive would not turn its motor by the angle that the arm file assumes; else empty."""
    block = reading.block
    assert block is not None  # else it is left alone
    expected = config.drive.command_steps_per_revolution
    if block.full_steps is not None and block.full_steps * block.microsteps == expected:
        return []
    return [
        f"The drive of {config.name} has {block.microsteps} microsteps and motor type {block.motor_type:02X}, "
        f"which is not the {expected} pulses a turn of the arm file, so it would turn by another angle than told: "
        "mend microsteps in the arm file, or the drive's menu."
    ]
