"""Referencing: joints find their homing stops one after the other, or are where a person says.

Nothing here moves a joint by motion frames: a homing run is the drive's own, at its own speed, until it meets the stop
or its time-out. While one runs, the arm's other joints hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from config.drives.zdt import ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import zdt_fast_targets, zdt_reports, zdt_talk
from rtloop.drives import zdt_registers as registers
from rtloop.drives.power import Marks
from rtloop.drives.setup import Homes, homing_of, joints_on_the_bus, mark_renewal_of
from rtloop.drives.zdt_ask import Ask, ZdtDialogue, addressed
from rtloop.drives.zdt_talk import AGREEING
from rtloop.kept.saved import NotSaved
from rtloop.service.conversation import TRIES, Conversation, Dialogue, TalkFailed, silent_amid
from rtloop.service.port import ADOPT, COUNT_FROM, FAST_READY, REFERENCING, REFERENCING_DONE, ServicePort
from shm.words import Fault, Unreferenced

AT_STOP_RAD = 0.02
"""A drive whose run has ended counts from where it stands: its shaft may settle this far from there."""
ELSEWHERE_RAD = 0.1
"""A joint whose angle was known before stops within this of its stop, or something was in its way."""
STANDS_TRIES = 8
FRESH_NS = 100_000_000
"""A reading is not older than that where a drive answers."""
LATE_S = 1.0


KeepLost = Callable[[int, Unreferenced | None], None]
"""Remembers beyond this process why a joint's angle is not known, or (None) that it is; may raise NotSaved."""


def referencing_asked_for(
    arm: ArmConfig,
    loop: np.ndarray,
    port: ServicePort,
    now_ns: int,
    tell: Callable[[str], None],
    keep_lost: KeepLost,
    marks: Marks,
) -> Referencing:
    """Take up what the cycle was asked for (HOME or REFERENCE), joints to be homed in the arm file's order."""
    dialogue, axes = loop[0]["dialogue"], loop[0]["axes"]
    homed, placed = int(dialogue["home_asked"]), int(dialogue["reference_asked"])
    dialogue["home_asked"] = dialogue["reference_asked"] = 0
    order = list(dict.fromkeys([*arm.homing_order, *range(len(arm.joints))]))
    return Referencing(
        arm,
        port,
        now_ns=now_ns,
        homed=[joint for joint in order if homed >> joint & 1],
        placed={joint: float(axes[joint]["reference"]["asked_rad"]) for joint in order if placed >> joint & 1},
        tell=tell,
        keep_lost=keep_lost,
        marks=marks,
    )


class Referencing(Conversation):
    """Joints that are homed in the order given, then joints that stand where a person says.

    `placed` has their angles (rad), NaN for one whose count is to be believed.
    """

    def __init__(
        self,
        arm: ArmConfig,
        port: ServicePort,
        *,
        now_ns: int,
        homed: Sequence[int],
        placed: Mapping[int, float],
        tell: Callable[[str], None],
        keep_lost: KeepLost,
        marks: Marks,
        again: str = "`rtarm clear-fault` and `rtarm home` again",
    ) -> None:
        """`keep_lost` remembers beyond this process why a joint's angle is not known, or that it is.

        `again` is how a person tries once more, in sentences.
        """
        super().__init__(arm, port, now_ns, fault=Fault.HOMING, last_order=REFERENCING_DONE)
        self._tell = tell
        self._keep_lost_beyond = keep_lost
        self.marks = marks
        self.again = again
        self._ending = False
        with_drive = joints_on_the_bus(arm)
        for joint in sorted({*homed, *placed} - set(with_drive)):  # what is commanded is where it is
            self._count_from(joint, arm.joints[joint].zero_rad, self.port.commanded_rad(joint))
        self._later = [(joint, partial(self._home, joint)) for joint in homed if joint in with_drive]
        self._later += [
            (joint, partial(self._place, joint, angle)) for joint, angle in placed.items() if joint in with_drive
        ]

    def end(self) -> None:
        """Stop what is under way; a joint amid its run stays without a reference. All is over once its drive stands."""
        if self._ending:
            return
        self._ending = True
        self._later.clear()
        for joint in list(self._dialogues):
            self._exchanges.pop(joint, None)
            self._dialogues.pop(joint).close()
            drive = self.arm.joints[joint].drive
            homes = homing_of(drive)
            if isinstance(drive, ZdtDrive):
                self.begin({joint: addressed(drive.address, self._give_up(joint))})
            elif homes is not None:
                self.begin({joint: homes.end_homing(self.arm, joint)})

    def _goes_on(self) -> bool:
        if not self._later:
            return False
        joint, dialogue = self._later.pop(0)
        self.begin({joint: dialogue()})
        return True

    def _home(self, joint: int) -> Dialogue:
        """Let the drive find its stop; one that has no run for that keeps the reference that it has or lacks."""
        config = self.arm.joints[joint]
        if isinstance(config.drive, ZdtDrive):
            return (yield from addressed(config.drive.address, self._home_zdt(joint)))
        homes = homing_of(config.drive)
        if homes is not None:
            return (yield from self._home_by(homes, joint))
        if config.knows_its_angle:
            self._tell(f"{config.name}: its drive knows its angle, so there is nothing to home.")
        else:
            self._tell(f"{config.name}: its drive has no homing run, so `rtarm reference` says where it stands.")

    def _place(self, joint: int, angle_rad: float) -> Dialogue:
        """Take a person's word for where the joint stands, or NaN for what it reads."""
        drive = self.arm.joints[joint].drive
        if isinstance(drive, ZdtDrive):
            return (yield from addressed(drive.address, self._place_zdt(joint, angle_rad)))
        if not drive.knows_its_angle and (renewal := mark_renewal_of(drive)) is not None:
            yield from renewal.renew_mark(self, joint)
        if self.now_ns - self.port.measured_ns(joint) > FRESH_NS:
            raise TalkFailed(joint, silent_amid(self.arm.joints[joint], "position"))
        self.post(REFERENCING, joint=joint)
        zero_rad, measured_rad = self.port.zero_rad(joint), self.port.measured_rad(joint)
        # what the drive holds, which a load keeps it from, goes on being commanded
        bent_rad = self.port.commanded_rad(joint) - measured_rad
        if abs(bent_rad) > self.arm.limits.following_error_rad:
            bent_rad = 0.0
        if not math.isnan(angle_rad):
            self._keep_lost(joint, Unreferenced.NOT_HOMED if drive.knows_its_angle else None)
            zero_rad += measured_rad - angle_rad
            measured_rad = angle_rad
        elif zero_rad == self.arm.joints[joint].zero_rad:
            self._keep_lost(joint, None)
        self._count_from(joint, zero_rad, measured_rad + bent_rad)

    # --- a homing run

    def _home_by(self, homes: Homes, joint: int) -> Dialogue:
        """A run as the family's own file lets it happen."""
        config, port = self.arm.joints[joint], self.port
        self._tell_of_run(config)
        expected_rad = -config.zero_rad if port.referenced(joint) else None
        before_rad = port.zero_rad(joint)
        self._keep_lost(joint, Unreferenced.NOT_HOMED)
        self.post(REFERENCING, joint=joint, code=1)
        try:
            stopped, target = yield from homes.home(self, joint)
            self._require_place(joint, stopped / port.reading_per_rad(joint) - before_rad, expected_rad)
        except TalkFailed:
            yield from homes.end_homing(self.arm, joint)
            raise
        self._keep_lost(joint, None)
        self._count_from(joint, config.zero_rad, target / port.reading_per_rad(joint) - config.zero_rad)
        self._tell(f"{config.name}: homed.")

    def _tell_of_run(self, config: JointConfig) -> None:
        self._tell(
            f"{config.name}: homing; the drive runs to its stop by itself, for {self.arm.homing.timeout_s:g} s at most."
        )

    def _require_place(self, joint: int, stopped_rad: float, expected_rad: float | None) -> None:
        """Whether it stopped about where its stop is known to be."""
        if expected_rad is None or abs(stopped_rad - expected_rad) <= ELSEWHERE_RAD:
            return
        config = self.arm.joints[joint]
        raise TalkFailed(
            joint,
            f"{config.name} met something at {math.degrees(stopped_rad):.1f}°, although its stop is at "
            f"{math.degrees(expected_rad):.1f}°: remove what is in its way, then {self.again}, "
            "which then takes whatever stops it for its stop.",
        )

    def _home_zdt(self, joint: int) -> ZdtDialogue:
        config, limit_s = self.arm.joints[joint], self.arm.homing.timeout_s
        self._tell_of_run(config)
        flags = yield from self._sound(joint, config)
        unmarked = yield from self._lost_its_mark(joint)
        expected_rad = -config.zero_rad if self.port.referenced(joint) and not unmarked else None
        mark_ms = zdt_talk.homing_mark_ms(round(limit_s * 1e3), self.now_ns)
        self.marks[joint] = None  # a mark that is still known and gone speaks of a loss of power
        if not (yield from zdt_talk.set_homing_timeout(mark_ms)):
            raise TalkFailed(
                joint,
                f"The drive of {config.name} does not take a homing time-out of {limit_s:g} s: set it in its menu, or "
                "lower homing.timeout_s.",
            )
        self.marks[joint] = str(mark_ms)
        began = yield from zdt_talk.counts_of(joint, config, registers.ASK_POSITION)
        self._keep_lost(joint, Unreferenced.NOT_HOMED)
        self.post(REFERENCING, joint=joint, code=1)
        try:
            yield from self._begin_run(joint, config)
            stopped = yield from self._see_it_end(joint, config, began)
            yield from self._judge(joint, config, stopped, expected_rad)
            yield from self._require_mark(joint, config, str(mark_ms))
            yield from self._set_up(joint, config)
            if flags & registers.POWER_LOST:
                yield from self._clear_power_lost(joint, config)
            target = yield from self._standing(joint, config)
            yield from self._require_mark(joint, config, str(mark_ms))
        except TalkFailed:
            yield from self._stand(joint)
            raise
        self._keep_lost(joint, None)
        zero_rad = config.zero_rad
        self._count_from(joint, zero_rad, config.direction * target / config.encoder_counts_per_rad - zero_rad)
        self._tell(f"{config.name}: homed.")

    def _begin_run(self, joint: int, config: JointConfig) -> ZdtDialogue:
        if (yield from zdt_talk.begin_homing()):
            return
        raise TalkFailed(
            joint,
            f"The drive of {config.name} does not begin its homing run: look at its display for a fault and at its "
            "homing parameters.",
        )

    def _see_it_end(self, joint: int, config: JointConfig, last: int) -> zdt_talk.Answered[int]:
        """Wait for the end of the run; the last count of before it, as the drive counted then."""
        began_ns = self.now_ns
        newest = last
        ended = failed = silent = 0
        while True:
            flags = yield from zdt_talk.read_flags(registers.ASK_HOMING_STATUS)
            silent = 0 if flags is not None else silent + 1
            if silent >= AGREEING:  # each of them asked several times over
                raise TalkFailed(joint, silent_amid(config, "homing state"))
            if flags is None:
                continue
            ended = 0 if flags & registers.HOMING else ended + 1
            failed = failed + 1 if ended and flags & registers.HOMING_FAILED else 0
            if failed >= AGREEING or self.now_ns - began_ns > (self.arm.homing.timeout_s + LATE_S) * 1e9:
                raise TalkFailed(
                    joint,
                    f"The drive of {config.name} has not found its homing stop within {self.arm.homing.timeout_s:g} s, "
                    "or was stopped: see that it can reach the stop and that direction, speed and collision current in "
                    f"its menu fit, then {self.again}.",
                )
            if ended >= AGREEING and not failed:
                return last
            if not ended:
                last = newest  # the drive has still been homing after it was read, so it had not set its count anew
                newest = yield from zdt_talk.counts_of(joint, config, registers.ASK_POSITION)

    def _judge(self, joint: int, config: JointConfig, stopped: int, expected_rad: float | None) -> ZdtDialogue:
        """Whether the drive counts 0, and stopped about where its stop is known to be."""
        flags = yield from zdt_talk.status_of(joint, config)
        measured = yield from zdt_talk.counts_of(joint, config, registers.ASK_POSITION)
        if flags & registers.PROTECTED or abs(measured) > AT_STOP_RAD * config.encoder_counts_per_rad:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} counts {measured} after its homing run, not 0, or has tripped its "
                "protection, so it has not found its stop: see that it can reach it and that its homing parameters "
                f"fit, then {self.again}.",
            )
        stopped_rad = config.direction * stopped / config.encoder_counts_per_rad - self.port.zero_rad(joint)
        self._require_place(joint, stopped_rad, expected_rad)

    def _lost_its_mark(self, joint: int) -> zdt_talk.Answered[bool]:
        """Whether the drive's mark is gone; its angle is then lost before another one takes that mark's place."""
        if (yield from zdt_talk.has_mark(self.marks.known(joint))) is not False:
            return False
        self._keep_lost(joint, Unreferenced.POWER_LOST)
        self.post(ADOPT, joint=joint, value=self.port.commanded_rad(joint), code=Unreferenced.POWER_LOST)
        return True

    def _require_mark(self, joint: int, config: JointConfig, mark: str) -> ZdtDialogue:
        marked = yield from zdt_talk.has_mark(mark)
        if marked is None:
            raise TalkFailed(joint, silent_amid(config, "homing parameters"))
        if not marked:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} has lost power while it was referenced, so what it counts is no angle: "
                f"see to its supply, then {self.again}.",
            )

    def _stand(self, joint: int) -> ZdtDialogue:
        """End whatever run there is, and see that it has ended."""
        config = self.arm.joints[joint]
        seen = 0
        for _ in range(STANDS_TRIES):
            flags = yield from zdt_talk.read_flags(
                registers.ASK_HOMING_STATUS, before=(registers.END_HOMING, registers.STOP)
            )
            seen = seen + 1 if flags is not None and not flags & registers.HOMING else 0
            if seen >= AGREEING:
                return
        raise TalkFailed(
            joint,
            f"The drive of {config.name} does not say that it has ended its homing run: it may still move, use the "
            "switch in the power line if it does.",
        )

    def _clear_power_lost(self, joint: int, config: JointConfig) -> ZdtDialogue:
        """The count means an angle again; only then may the flag go that said it does not."""
        for _ in range(TRIES):
            yield Ask(registers.CLEAR_POWER_LOST, (3,))
            if not (yield from zdt_talk.status_of(joint, config)) & registers.POWER_LOST:
                return
        raise TalkFailed(
            joint,
            f"The drive of {config.name} keeps its flag for lost power although it was told to clear it: switch it off "
            "and on, then home it again.",
        )

    # --- a person's word

    def _place_zdt(self, joint: int, angle_rad: float) -> ZdtDialogue:
        self.post(REFERENCING, joint=joint)
        config = self.arm.joints[joint]
        flags = yield from self._sound(joint, config)
        yield from self._set_up(joint, config)
        unmarked = yield from self._lost_its_mark(joint)
        self.marks[joint] = None
        mark = (yield from zdt_talk.mark(self.now_ns)) if self.marks.takes(joint) else None
        self.marks[joint] = mark  # before the count for which it speaks
        target = yield from self._standing(joint, config)
        zero_rad = self.port.zero_rad(joint)
        flagged = flags & registers.POWER_LOST and not self.port.power_loss_known(joint)
        counts_nowhere = flagged or unmarked
        if math.isnan(angle_rad) and counts_nowhere:
            self._tell(f"{config.name}: its drive has lost power, so what it counts is no angle: say where it stands.")
            self._count_from(joint, zero_rad, self.port.commanded_rad(joint), Unreferenced.POWER_LOST)
            return
        if math.isnan(angle_rad):
            if zero_rad == config.zero_rad:
                self._keep_lost(joint, None)  # the next process counts from there too
        else:
            self._keep_lost(joint, Unreferenced.NOT_HOMED)  # what is said is known to this process alone
            measured = yield from zdt_talk.counts_of(joint, config, registers.ASK_POSITION)
            zero_rad = config.direction * measured / config.encoder_counts_per_rad - angle_rad
        if mark is not None:
            yield from self._require_mark(joint, config, mark)
        position_rad = config.direction * target / config.encoder_counts_per_rad - zero_rad
        self._count_from(joint, zero_rad, position_rad, flag_stays=bool(flags & registers.POWER_LOST))

    # --- both

    def _keep_lost(self, joint: int, reason: Unreferenced | None) -> None:
        try:
            self._keep_lost_beyond(joint, reason)
        except NotSaved as problem:
            raise TalkFailed(joint, str(problem)) from None

    def _give_up(self, joint: int) -> ZdtDialogue:
        """What `end` does to a joint's turn; one whose angle is still known is led on."""
        yield from self._stand(joint)
        if self.port.referenced(joint):
            yield from self._set_up(joint, self.arm.joints[joint])

    def _set_up(self, joint: int, config: JointConfig) -> ZdtDialogue:
        """Tell a drive anew what leading it rests on, and see it: gone with its power.

        Nobody notices that a drive is switched off and on while its count means no angle.
        """
        if not (self.arm.bus.reported or self.arm.bus.fast_targets):
            return
        drive = config.drive
        assert isinstance(drive, ZdtDrive)  # no others are spoken to
        version = registers.version_of((yield Ask(registers.ASK_FIRMWARE, (4, 6))))
        if version is None:
            raise TalkFailed(joint, silent_amid(config, "firmware"))
        if self.arm.bus.reported:
            yield from zdt_reports.begin(self.arm, self.port, joint, version)
        if self.arm.bus.fast_targets:
            yield from zdt_fast_targets.prepare(self.arm, joint, drive, version)
            self.post(FAST_READY, joint=joint)

    def _sound(self, joint: int, config: JointConfig) -> zdt_talk.Answered[int]:
        """Stop a drive that may be on its way somewhere, and see that it holds; its flags."""
        yield Ask(registers.STOP, (3,), answered=self.arm.bus.acknowledge)
        flags = yield from zdt_talk.status_of(joint, config)
        if flags & registers.PROTECTED or not flags & registers.ENABLED:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} is in protection or not enabled, so it cannot be referenced: remove the "
                "cause, then `rtarm clear-fault`, which enables it.",
            )
        return flags

    def _standing(self, joint: int, config: JointConfig) -> zdt_talk.Answered[int]:
        """The drive's own target, once it stands on it: what it is commanded to be is then no motion."""
        for _ in range(TRIES):
            measured = yield from zdt_talk.counts_of(joint, config, registers.ASK_POSITION)
            target = yield from zdt_talk.counts_of(joint, config, registers.ASK_TARGET)
            if abs(measured - target) <= AT_STOP_RAD * config.encoder_counts_per_rad:
                return target
            yield Ask(registers.STOP, (3,), answered=self.arm.bus.acknowledge)
        raise TalkFailed(
            joint,
            f"The drive of {config.name} stands {measured - target} counts from its own target and does not take where "
            f"it is for it: switch it off and on, then {self.again}.",
        )

    def _count_from(
        self,
        joint: int,
        zero_rad: float,
        position_rad: float,
        reason: Unreferenced = Unreferenced.REFERENCED,
        *,
        flag_stays: bool = False,
    ) -> None:
        """Tell the cycle what the joint's count means, and that it stands there, where its limits allow that."""
        config = self.arm.joints[joint]
        inside = config.lower_rad - AT_STOP_RAD <= position_rad <= config.upper_rad + AT_STOP_RAD
        if reason == Unreferenced.REFERENCED and not inside:
            reason = Unreferenced.OUTSIDE_LIMITS
        known = flag_stays and reason == Unreferenced.REFERENCED
        self.marks.referenced(joint)
        self.post(COUNT_FROM, joint=joint, value=zero_rad, code=int(known))
        self.post(ADOPT, joint=joint, value=position_rad, code=reason)
