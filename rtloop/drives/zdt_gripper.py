"""A ZDT drive that opens and closes a gripper (`rtloop.drives.gripper.GripperDrive`).

The drive plans its own ramp, so one command is a whole motion, and nothing here has to be on time.
"""

from __future__ import annotations

import math

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION, FULL_STEPS_PER_REVOLUTION
from config.gripper import HIGHEST_UNLIMITED_MA, GripperConfig, GripperServo
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives import zdt_talk
from rtloop.drives.gripper import GripperHost, Trouble
from rtloop.drives.zdt_ask import Ask, ZdtDialogue, addressed
from rtloop.drives.zdt_talk import AGREEING, Answered
from rtloop.service.conversation import TRIES, Dialogue
from shm.words import GripTrouble

HELD_RAD = 0.02
"""Largest distance between the target and the position of a drive that holds."""
HOMING_MS = 60_000
"""Timeout of a homing run (ms), which is written to the drive too."""
HOMING_LATE_NS = 1_000_000_000
LEAST_MA = 100
_BAD = protocol.PROTECTED | protocol.POWER_LOST


class Gripper:
    """The gripper's drive; see `rtloop.drives.gripper.GripperDrive`."""

    def __init__(self, servo: GripperServo, gripper: GripperConfig, host: GripperHost) -> None:
        self._servo, self._gripper, self._host = servo, gripper, host
        self._held_counts = HELD_RAD * abs(servo.counts_per_rad)
        self._full_ma = HIGHEST_UNLIMITED_MA
        self._limit_ma = 0

    def addressed(self, turn: ZdtDialogue) -> Dialogue:
        return addressed(self._servo.address, turn)

    def get_to_know(self) -> ZdtDialogue:
        """Check what would make the drive's motion wrong; it may be another drive than before."""
        version = protocol.version_of((yield Ask(protocol.ASK_FIRMWARE, (4, 6))))
        if version is None:
            raise self._silent()
        block = yield from zdt_talk.surely(zdt_talk.read_block)  # its current is restored when the limit ends
        if block is None or not version.known:
            raise Trouble(GripTrouble.FIRMWARE, version.firmware)
        if block.checksum != 0:
            raise Trouble(GripTrouble.CHECKSUM, block.checksum)
        if block.microsteps != self._servo.microsteps:
            raise Trouble(GripTrouble.MICROSTEPS, block.microsteps)
        if self._limit_ma == 0:
            self._full_ma = block.current_ma
        self._limit_ma = block.current_ma
        target = yield from self._counts(protocol.ASK_TARGET)
        measured = yield from self._counts(protocol.ASK_POSITION)
        if abs(target - measured) > self._held_counts:
            yield from self.hold()  # its target is not from this process

    def make_able(self) -> ZdtDialogue:
        """Clear the drive's protection and enable it, where that is needed; a lost count stays lost."""
        flags = yield from self._flags()
        if flags & protocol.POWER_LOST:
            raise Trouble(GripTrouble.POWER_LOST)
        for _ in range(TRIES):
            if not flags & protocol.PROTECTED:
                break
            yield Ask(protocol.CLEAR_PROTECTION, (3,))
            flags = yield from self._flags()
        else:
            raise Trouble(GripTrouble.PROTECTED)
        for _ in range(TRIES):
            if flags & protocol.ENABLED:
                return
            # the drive may pull its shaft to its target from before it was disabled
            yield from self._counts(protocol.ASK_TARGET, before=(protocol.ENABLE, protocol.STOP))
            flags = yield from self._flags()
        raise Trouble(GripTrouble.DISABLED)

    def limit_effort(self, effort: float) -> ZdtDialogue:
        """Limit the motor's current in volatile memory; does nothing if the torque per ampere is not known."""
        if self._servo.nm_per_ampere is None:
            return
        wanted_ma = self._full_ma
        if effort > 0.0:
            wished_ma = effort / self._servo.nm_per_ampere * 1e3  # overflows to infinity for the highest floats
            wanted_ma = round(min(max(wished_ma, LEAST_MA), self._full_ma))
        for _ in range(TRIES):
            if wanted_ma == self._limit_ma:
                return
            yield Ask(protocol.limit_current(wanted_ma), (3,))
            block = yield from zdt_talk.read_block()
            self._limit_ma = self._limit_ma if block is None else block.current_ma
        if wanted_ma != self._limit_ma:
            raise Trouble(GripTrouble.CURRENT, wanted_ma)

    def go_to(self, angle_rad: float) -> ZdtDialogue:
        """Repeat the command until the drive reports this target: a frame may be lost."""
        pulses = round((angle_rad + self._servo.zero_rad) * self._servo.pulses_per_rad)
        counts_per_pulse = ENCODER_COUNTS_PER_REVOLUTION / (self._servo.microsteps * FULL_STEPS_PER_REVOLUTION)
        command = protocol.go_to(pulses, rpm=self._gripper.motor_rpm, acc=self._gripper.acc_byte)
        for _ in range(TRIES):
            target = yield from self._counts(protocol.ASK_TARGET, before=(command,))
            if abs(target - pulses * counts_per_pulse) <= counts_per_pulse + 1.0:
                return
        raise Trouble(GripTrouble.REFUSED, angle_rad)

    def hold(self) -> ZdtDialogue:
        """Repeat the stop until the drive's target is its position."""
        for _ in range(TRIES):
            target = yield from self._counts(protocol.ASK_TARGET, before=(protocol.STOP,))
            measured = yield from self._counts(protocol.ASK_POSITION)
            if abs(target - measured) <= self._held_counts:
                return
        raise Trouble(GripTrouble.REFUSED, self._angle_rad(measured))

    def home(self) -> ZdtDialogue:
        """Run the drive to its stop, which becomes its count 0."""
        mark_ms = zdt_talk.homing_mark_ms(HOMING_MS, self._host.now_ns)
        if not (yield from zdt_talk.set_homing_timeout(mark_ms)):
            raise Trouble(GripTrouble.NOT_HOMED, (yield from self._counts(protocol.ASK_POSITION)))
        ended = (yield from zdt_talk.begin_homing()) and (yield from self._see_homing_end())
        if not ended:
            yield from zdt_talk.read_flags(protocol.ASK_STATUS, before=(protocol.END_HOMING, protocol.STOP))
        counts = yield from self._counts(protocol.ASK_POSITION)
        parameters = yield from zdt_talk.read_homing()
        marked = parameters is not None and parameters.timeout_ms == mark_ms
        if not (ended and marked and abs(counts) <= self._held_counts):
            raise Trouble(GripTrouble.NOT_HOMED, counts)
        for _ in range(TRIES):
            yield Ask(protocol.CLEAR_POWER_LOST, (3,))
            if not (yield from self._flags()) & protocol.POWER_LOST:
                break

    def _see_homing_end(self) -> Answered[bool]:
        """Wait for the end of the run; whether it ended at the stop, in time and before another order came."""
        host = self._host
        until_ns = host.now_ns + HOMING_MS * 1_000_000 + HOMING_LATE_NS
        ended = 0
        while host.now_ns < until_ns and not host.waits:
            flags = yield from zdt_talk.read_flags(protocol.ASK_HOMING_STATUS)
            if flags is None:
                raise self._silent()
            ended = 0 if flags & protocol.HOMING else ended + 1
            if ended >= AGREEING:
                return not flags & protocol.HOMING_FAILED
            host.show()
        return False

    # --- how it is

    def position_rad(self) -> Answered[float]:
        """The gripper's angle, from the drive's count."""
        return self._angle_rad((yield from self._counts(protocol.ASK_POSITION)))

    def look(self, moves: bool) -> Answered[GripTrouble]:
        """Read the drive's flags; hold a drive that is stalled although no motion is commanded."""
        flags = yield from self._flags()
        if flags & protocol.POWER_LOST:
            raise Trouble(GripTrouble.POWER_LOST)
        if flags & protocol.PROTECTED:
            return GripTrouble.PROTECTED
        if not flags & protocol.ENABLED:
            return GripTrouble.DISABLED
        if flags & protocol.STALLED and not moves:
            yield from self.hold()  # it pushes against something just before its target
        return GripTrouble.NONE

    def measure_effort(self, nm_per_ampere: float) -> Answered[float]:
        """The drive's torque (N·m), from its current."""
        current_ma = protocol.number_of((yield Ask(protocol.ASK_CURRENT, (4,))), protocol.ASK_CURRENT, 2)
        return math.nan if current_ma is None else current_ma * 1e-3 * nm_per_ampere

    def _flags(self) -> Answered[int]:
        """The drive's flags; a flag that means trouble counts only if two answers have it."""
        flags = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
        if flags is not None and (flags & _BAD or not flags & protocol.ENABLED):
            again = yield from zdt_talk.read_flags(protocol.ASK_STATUS)
            flags = again if again is None else (flags & again & _BAD) | (flags | again) & protocol.ENABLED
        if flags is None:
            raise self._silent()
        return flags

    def _counts(self, question: bytes, before: tuple[bytes, ...] = ()) -> Answered[int]:
        counts = protocol.signed_of((yield Ask(question, (7,), before=before)), question, 4)
        if counts is None:
            raise self._silent()
        return counts

    def _angle_rad(self, counts: int) -> float:
        return counts / self._servo.counts_per_rad - self._servo.zero_rad

    def _silent(self) -> Trouble:
        return Trouble(GripTrouble.SILENT, self._servo.address)
