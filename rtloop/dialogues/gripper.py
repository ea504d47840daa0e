"""The gripper on the arm's bus: a conversation with its drive, for as long as the control process lives.

A ZDT drive plans its own ramp, so one command is a whole motion, and nothing here has to be on time. What is asked of
it beside that goes in the bus time that the cycle leaves, next to any conversation with the joints' drives.

Gripping something is a stall: the drive stands although it has not reached its target. It is then told to hold where
it is, so that it does not push until its own protection lets go of what it holds. Whatever is wrong with the gripper
is shown and said, and is never a fault of the arm: an arm that stops because of its gripper would help nobody.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION, FULL_STEPS_PER_REVOLUTION
from config.gripper import HIGHEST_UNLIMITED_MA, MOVING_POLL_HZ, RESTING_POLL_HZ
from config.schema import ArmConfig
from motion.gripping import Grip, GripJudge, stall_ns
from rtloop.drives import zdt_registers as registers
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_ask import Ask, ZdtDialogue, addressed
from rtloop.drives.zdt_talk import AGREEING, Answered
from rtloop.memory.link import GRIPPER
from rtloop.service.conversation import TRIES, Conversation
from rtloop.service.port import Frame, ServicePort
from sentences.told import grip_trouble_sentence
from shm import layout
from shm.gripper import show_gripper
from shm.words import Fault, GripTrouble, Request

ONLY = GRIPPER
"""The conversation's only drive."""
AFTER_TROUBLE_NS = 1_000_000_000
HELD_RAD = 0.02
"""A drive that holds has its target this near to where it is."""
OUTSIDE_RAD = math.radians(20.0)
"""A reading this far beyond the range is no angle of the gripper's."""
HOMING_MS = 60_000
"""For a homing run; the drive is told so too."""
HOMING_LATE_NS = 1_000_000_000
LEAST_MA = 100
_BAD = registers.PROTECTED | registers.POWER_LOST


class Order(NamedTuple):
    """What the gripper was asked for."""

    sequence: int
    kind: int
    angle_rad: float
    effort: float


class _Trouble(Exception):
    """What was asked cannot be done, or nothing can."""

    def __init__(self, kind: GripTrouble, value: float = math.nan) -> None:
        super().__init__(kind)
        self.kind, self.value = kind, value


class GripperTalk(Conversation):
    """One drive, turn by turn: get to know it, obey the newest order, look where it is, show that."""

    def __init__(
        self,
        arm: ArmConfig,
        loop: np.ndarray,
        port: ServicePort,
        state: np.ndarray,
        *,
        now_ns: int,
        tell: Callable[[str], None],
    ) -> None:
        """`state` is the mapped state file, shape (1,), in which the gripper is shown."""
        assert arm.gripper is not None and arm.gripper.servo is not None
        self._gripper, self._servo = arm.gripper, arm.gripper.servo
        super().__init__(arm, port, now_ns, fault=Fault.NONE)
        self._asked, self._people = loop[0]["gripper"], loop[0]["people"]
        self._state = state
        self._tell = tell
        self._shown = np.zeros((), layout.GRIPPER)
        self._shown["position_rad"] = self._shown["velocity_rad_s"] = math.nan
        self._shown["measured_effort"] = self._shown["target_rad"] = math.nan
        self._known = False
        self._taken = int(self._asked["sequence"])
        self._halts = self._counted_halts()
        self._obeying = self._halting = False
        self._judge: GripJudge | None = None
        self._full_ma = HIGHEST_UNLIMITED_MA
        self._limit_ma = 0
        self._turns = 0
        self._next_ns = now_ns

    @property
    def busy(self) -> bool:
        """Whether something is asked or to be asked, so that it is worth looking often."""
        return bool(self._dialogues) or self._waits

    @property
    def moves(self) -> bool:
        """Whether a motion is under way."""
        return int(self._shown["grip"]) == Grip.MOVING

    def _received(self) -> list[Frame]:
        return self.port.received(of_gripper=True)

    def poll(self, now_ns: int) -> bool:
        """A step; when a person stops or holds the arm, what moves stops too, and what is gripped stays gripped."""
        halts_before, self._halts = self._halts, self._counted_halts()
        if self._halts != halts_before and (self.moves or self._waits or self._obeying):
            self.stop()
        return super().poll(now_ns)

    def _goes_on(self) -> bool:
        """Always: a turn follows a turn."""
        if self.now_ns >= self._next_ns or self._waits:
            self.begin({ONLY: addressed(self._servo.address, self._turn())})
        return True

    def _counted_halts(self) -> tuple[int, int]:
        """Changes with every stop and hold."""
        return int(self._people["stop_ns"]), int(self._people["hold_ns"])

    # --- orders

    @property
    def _waits(self) -> bool:
        return self._halting or int(self._asked["sequence"]) != self._taken

    def stop(self) -> None:
        """Let it stop, as by an order: a person has stopped the arm, or the control process is about to end."""
        self._halting = True

    def _take(self) -> Order | None:
        """The newest order that has not been taken yet.

        The cycle may write one while this one is read. What is mixed of two then is followed by the newer one at once,
        and an angle that belongs to none of them is out of range or as good as any.
        """
        if not self._waits:
            return None
        asked = self._asked
        if self._halting:  # in the place of what was asked for before, and before what was asked for since
            self._halting = False
            self._taken = max(self._taken, int(asked["halted"]))
            return Order(self._taken, Request.GRIP_STOP, 0.0, 0.0)
        order = Order(int(asked["sequence"]), int(asked["kind"]), float(asked["position_rad"]), float(asked["effort"]))
        self._taken = order.sequence
        if order.kind == Request.GRIP and not self._gripper.lower_rad <= order.angle_rad <= self._gripper.upper_rad:
            return None
        return order

    # --- a turn

    def _turn(self) -> ZdtDialogue:
        order = None
        try:
            if not self._known:
                yield from self._get_to_know()
            order = self._take()
            if order is not None:
                self._obeying = True
                yield from self._obey(order)
            self._obeying = False
            yield from self._look()
        except _Trouble as trouble:
            self._obeying = False
            self._suffer(trouble)
            if order is None and not self._known:
                order = self._take()  # there is nobody to obey it; any other is told it in the next turn
        if order is not None:
            self._shown["order"] = order.sequence
        rate_hz = MOVING_POLL_HZ if self.moves else RESTING_POLL_HZ
        self._next_ns = self.now_ns + (round(1e9 / rate_hz) if self._known else AFTER_TROUBLE_NS)
        self._show()

    def _suffer(self, trouble: _Trouble) -> None:
        """Show a trouble, and say it once; what was under way is over."""
        if int(self._shown["trouble"]) != trouble.kind:
            self._tell(grip_trouble_sentence(trouble.kind, trouble.value))
        self._shown["trouble"], self._shown["trouble_value"] = trouble.kind, trouble.value
        self._shown["grip"] = Grip.TROUBLE
        self._judge = None
        if trouble.kind in (GripTrouble.SILENT, GripTrouble.POWER_LOST):
            self._shown["measured_ns"] = 0
        if trouble.kind == GripTrouble.SILENT:
            self._known = False

    def _recover(self, grip: Grip) -> None:
        self._shown["trouble"], self._shown["trouble_value"] = GripTrouble.NONE, 0.0
        self._shown["grip"] = grip

    def _show(self) -> None:
        self._shown["written"] += 1
        self._shown["monotonic_ns"] = self.now_ns
        show_gripper(self._state, self._shown)

    def _get_to_know(self) -> ZdtDialogue:
        """What would make its motion wrong; it may be another drive than before."""
        version = registers.version_of((yield Ask(registers.ASK_FIRMWARE, (4, 6))))
        if version is None:
            raise _Trouble(GripTrouble.SILENT, self._servo.address)
        block = yield from zdt_talk.surely(zdt_talk.read_block)  # its current is what the limit is set back to
        if block is None or not version.known:
            raise _Trouble(GripTrouble.FIRMWARE, version.firmware)
        if block.checksum != 0:
            raise _Trouble(GripTrouble.CHECKSUM, block.checksum)
        if block.microsteps != self._servo.microsteps:
            raise _Trouble(GripTrouble.MICROSTEPS, block.microsteps)
        if self._limit_ma == 0:
            self._full_ma = block.current_ma
        self._limit_ma = block.current_ma
        target = yield from self._counts(registers.ASK_TARGET)
        measured = yield from self._counts(registers.ASK_POSITION)
        if abs(target - measured) > HELD_RAD * abs(self._servo.counts_per_rad):
            yield from self._hold()  # whatever it is on its way to, nobody here has told it
        self._known = True
        self._recover(Grip.HELD)

    # --- what it is asked

    def _obey(self, order: Order) -> ZdtDialogue:
        self._judge = None
        if order.kind == Request.GRIP_HOME:
            yield from self._home(order)
        elif order.kind == Request.GRIP_STOP:
            yield from self._hold()
            self._recover(Grip.HELD)
        elif order.kind == Request.GRIP:
            yield from self._make_able()
            yield from self._limit_current(order.effort)
            yield from self._set_off(order.angle_rad)

    def _make_able(self) -> ZdtDialogue:
        """Let a drive that has let go hold again: who commands a motion wants that. A lost count stays lost."""
        flags = yield from self._flags()
        if flags & registers.POWER_LOST:
            raise _Trouble(GripTrouble.POWER_LOST)
        for _ in range(TRIES):
            if not flags & registers.PROTECTED:
                break
            yield Ask(registers.CLEAR_PROTECTION, (3,))
            flags = yield from self._flags()
        else:
            raise _Trouble(GripTrouble.PROTECTED)
        for _ in range(TRIES):
            if flags & registers.ENABLED:
                return
            # it may pull its shaft to the target of before it was let go
            yield from self._counts(registers.ASK_TARGET, before=(registers.ENABLE, registers.STOP))
            flags = yield from self._flags()
        raise _Trouble(GripTrouble.DISABLED)

    def _limit_current(self, effort: float) -> ZdtDialogue:
        """Push no harder than is wished; without a wish, as hard as the drive was found to."""
        if self._servo.nm_per_ampere is None:
            return
        wanted_ma = self._full_ma
        if effort > 0.0:
            wished_ma = effort / self._servo.nm_per_ampere * 1e3  # infinite for the highest numbers there are
            wanted_ma = round(min(max(wished_ma, LEAST_MA), self._full_ma))
        for _ in range(TRIES):
            if wanted_ma == self._limit_ma:
                return
            yield Ask(registers.limit_current(wanted_ma), (3,))
            block = yield from zdt_talk.read_block()
            self._limit_ma = self._limit_ma if block is None else block.current_ma
        if wanted_ma != self._limit_ma:
            raise _Trouble(GripTrouble.CURRENT, wanted_ma)

    def _set_off(self, angle_rad: float) -> ZdtDialogue:
        """Command the motion until the drive says that its target is this one: a frame may be lost."""
        position_rad = yield from self._position_rad()
        self._require_inside(position_rad)
        pulses = round((angle_rad + self._servo.zero_rad) * self._servo.pulses_per_rad)
        counts_per_pulse = ENCODER_COUNTS_PER_REVOLUTION / (self._servo.microsteps * FULL_STEPS_PER_REVOLUTION)
        if self._waits:
            return  # a newer order, which may be a stop, goes before what has not set off
        command = registers.go_to(pulses, rpm=self._gripper.motor_rpm, acc=self._gripper.acc_byte)
        for _ in range(TRIES):
            target = yield from self._counts(registers.ASK_TARGET, before=(command,))
            if abs(target - pulses * counts_per_pulse) <= counts_per_pulse + 1.0:
                break
        else:
            raise _Trouble(GripTrouble.REFUSED, angle_rad)
        gripper = self._gripper
        self._judge = GripJudge(
            angle_rad,
            gripper.tolerance_rad,
            stall_ns(gripper.stall_time_s, gripper.tolerance_rad, gripper.speed_rad_s),
            position_rad,
            self.now_ns,
        )
        self._shown["target_rad"] = angle_rad
        self._recover(Grip.MOVING)

    def _hold(self) -> ZdtDialogue:
        """Let it stand where it is, so that it neither moves nor pushes."""
        for _ in range(TRIES):
            target = yield from self._counts(registers.ASK_TARGET, before=(registers.STOP,))
            measured = yield from self._counts(registers.ASK_POSITION)
            if abs(target - measured) <= HELD_RAD * abs(self._servo.counts_per_rad):
                return
        raise _Trouble(GripTrouble.REFUSED, self._angle_rad(measured))

    # --- its homing run

    def _home(self, order: Order) -> ZdtDialogue:
        """Let the drive find its stop, which is its count 0; an order that comes meanwhile ends that."""
        self._recover(Grip.MOVING)
        self._shown["order"], self._shown["measured_ns"] = order.sequence, 0
        self._shown["target_rad"] = math.nan
        self._show()
        mark_ms = zdt_talk.homing_mark_ms(HOMING_MS, self.now_ns)
        if not (yield from zdt_talk.set_homing_timeout(mark_ms)):
            raise _Trouble(GripTrouble.NOT_HOMED, (yield from self._counts(registers.ASK_POSITION)))
        ended = (yield from zdt_talk.begin_homing()) and (yield from self._see_homing_end())
        if not ended:
            yield from zdt_talk.read_flags(registers.ASK_STATUS, before=(registers.END_HOMING, registers.STOP))
        counts = yield from self._counts(registers.ASK_POSITION)
        parameters = yield from zdt_talk.read_homing()
        marked = parameters is not None and parameters.timeout_ms == mark_ms
        if not (ended and marked and abs(counts) <= HELD_RAD * abs(self._servo.counts_per_rad)):
            raise _Trouble(GripTrouble.NOT_HOMED, counts)
        for _ in range(TRIES):
            yield Ask(registers.CLEAR_POWER_LOST, (3,))
            if not (yield from self._flags()) & registers.POWER_LOST:
                break
        self._recover(Grip.REACHED)

    def _see_homing_end(self) -> Answered[bool]:
        """Whether the run has ended at its stop, within its time and with no other order before."""
        until_ns = self.now_ns + HOMING_MS * 1_000_000 + HOMING_LATE_NS
        ended = 0
        while self.now_ns < until_ns and not self._waits:
            flags = yield from zdt_talk.read_flags(registers.ASK_HOMING_STATUS)
            if flags is None:
                raise _Trouble(GripTrouble.SILENT, self._servo.address)
            ended = 0 if flags & registers.HOMING else ended + 1
            if ended >= AGREEING:
                return not flags & registers.HOMING_FAILED
            self._show()
        return False

    # --- where it is

    def _look(self) -> ZdtDialogue:
        position_rad = yield from self._position_rad()
        heard_ns, trouble = self.now_ns, GripTrouble.NONE
        self._turns += 1
        if self._servo.nm_per_ampere is not None and self._turns % 2 == 0:
            yield from self._measure_effort(self._servo.nm_per_ampere)
        else:
            trouble = yield from self._check_flags()
        self._require_inside(position_rad)
        since_s = (heard_ns - int(self._shown["measured_ns"])) * 1e-9
        known = int(self._shown["measured_ns"]) > 0
        self._shown["velocity_rad_s"] = (position_rad - self._shown["position_rad"]) / since_s if known else 0.0
        self._shown["position_rad"], self._shown["measured_ns"] = position_rad, heard_ns
        if trouble != GripTrouble.NONE:
            raise _Trouble(trouble)  # its count still means an angle
        if self._judge is not None:
            grip = self._judge.judge(heard_ns, position_rad)
            if grip == Grip.STALLED:
                yield from self._hold()
            if grip != Grip.MOVING:
                self._judge = None
            self._shown["grip"] = grip
        elif int(self._shown["trouble"]) in _GOES_BY_ITSELF:
            self._recover(Grip.HELD)

    def _check_flags(self) -> Answered[GripTrouble]:
        flags = yield from self._flags()
        if flags & registers.POWER_LOST:
            raise _Trouble(GripTrouble.POWER_LOST)
        if flags & registers.PROTECTED:
            return GripTrouble.PROTECTED
        if not flags & registers.ENABLED:
            return GripTrouble.DISABLED
        if flags & registers.STALLED and self._judge is None:
            yield from self._hold()  # it has arrived, and pushes against something just before its target
        return GripTrouble.NONE

    def _measure_effort(self, nm_per_ampere: float) -> ZdtDialogue:
        current_ma = registers.number_of((yield Ask(registers.ASK_CURRENT, (4,))), registers.ASK_CURRENT, 2)
        self._shown["measured_effort"] = math.nan if current_ma is None else current_ma * 1e-3 * nm_per_ampere

    def _flags(self) -> Answered[int]:
        """Its flags; those that would mean trouble, only if two answers say so."""
        flags = yield from zdt_talk.read_flags(registers.ASK_STATUS)
        if flags is not None and (flags & _BAD or not flags & registers.ENABLED):
            again = yield from zdt_talk.read_flags(registers.ASK_STATUS)
            flags = again if again is None else (flags & again & _BAD) | (flags | again) & registers.ENABLED
        if flags is None:
            raise _Trouble(GripTrouble.SILENT, self._servo.address)
        return flags

    def _counts(self, question: bytes, before: tuple[bytes, ...] = ()) -> Answered[int]:
        counts = registers.signed_of((yield Ask(question, (7,), before=before)), question, 4)
        if counts is None:
            raise _Trouble(GripTrouble.SILENT, self._servo.address)
        return counts

    def _position_rad(self) -> Answered[float]:
        """Its angle; one that cannot be, only if two answers say so."""
        position_rad = self._angle_rad((yield from self._counts(registers.ASK_POSITION)))
        if not self._is_inside(position_rad):
            position_rad = self._angle_rad((yield from self._counts(registers.ASK_POSITION)))
        return position_rad

    def _angle_rad(self, counts: int) -> float:
        return counts / self._servo.counts_per_rad - self._servo.zero_rad

    def _is_inside(self, position_rad: float) -> bool:
        return self._gripper.lower_rad - OUTSIDE_RAD <= position_rad <= self._gripper.upper_rad + OUTSIDE_RAD

    def _require_inside(self, position_rad: float) -> None:
        if not self._is_inside(position_rad):
            raise _Trouble(GripTrouble.OUTSIDE, position_rad)


_GOES_BY_ITSELF = (
    GripTrouble.SILENT,
    GripTrouble.PROTECTED,
    GripTrouble.DISABLED,
    GripTrouble.POWER_LOST,
    GripTrouble.OUTSIDE,
)
"""Troubles that are over as soon as a look finds nothing of them; the others stand until the next order."""
