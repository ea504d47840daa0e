"""Bring-up: the conversation with the drives after which the arm holds, or which fails with a message saying why.

It works the same at start, after a fault was cleared, and when disabled drives are enabled again. The drive's family
makes the frames (`rtloop.drives.setup`); this module judges what the answers mean for the joint.
"""

import math
from collections.abc import Callable, Mapping

from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives.power import Marks
from rtloop.drives.setup import Found, setup_of
from rtloop.safety.absolute_encoder import absolute_makes_good
from rtloop.service.conversation import Conversation, Dialogue
from rtloop.service.port import BRING_UP_BEGINS, BRING_UP_DONE, POWER_KEPT, SYNC_SETPOINT, ServicePort
from sentences.told import joint_names, unreferenced_sentences
from shm.words import Fault, Unreferenced

SLACK_RAD = 0.02
"""A joint that reads at most this far beyond a limit counts as standing at the limit."""


class BringUp(Conversation):
    """One bring-up of a whole arm."""

    def __init__(
        self,
        arm: ArmConfig,
        port: ServicePort,
        *,
        now_ns: int,
        clears_protection: bool,
        tell: Callable[[str], None],
        marks: Marks,
        held_rad: dict[int, float],
        mock_positions_rad: list[float] | None = None,
        counts_before: Mapping[int, int] | None = None,
        lost_before: Mapping[int, Unreferenced] | None = None,
        heals: bool = False,
        forgive_silence: Callable[[int], None] = lambda joint: None,
    ) -> None:
        """Begin the bring-up: order the cycle to enter it, and start a dialogue with each drive.

        `held_rad`: joint number → position at which its drive held it before a bring-up that failed; updated here.

        `counts_before`: joint number → its drive's count when rtarm was last ended.

        `lost_before`: joint number → why its angle was not known in an earlier process. `forgive_silence` stores for
        later processes that a joint's angle is known although its drive was silent. `heals`: this is an automatic
        recovery after a stall (`rtloop.dialogues.healing`), which no operator has requested.
        """
        super().__init__(arm, port, now_ns, fault=Fault.BRING_UP, last_order=BRING_UP_DONE)
        self.tell = tell
        self.marks = marks
        self.heals = heals
        self._forgive_silence = forgive_silence
        self.clears_protection = clears_protection
        self._counts_before = counts_before or {}
        self.lost_before = lost_before or {}
        self._held_rad = held_rad
        self._note_who_is_held()
        # where a lost-power flag is already known to be set and no mark proves power, only a changed position can show
        # another loss of power
        self._flagged_rad = {n: port.measured_rad(n) for n in range(len(arm.joints)) if port.power_loss_known(n)}
        self.unasked_before = [port.unasked(n) for n in range(len(arm.joints))]
        silent_before = [self.lost_before.get(n) == Unreferenced.SILENT for n in range(len(arm.joints))]
        self.was_silent = [
            port.unreferenced_reason(n) == Unreferenced.SILENT or (silent_before[n] and config.drive.counts_on)
            for n, config in enumerate(arm.joints)
        ]
        self._unknown: dict[int, Unreferenced] = {}
        self._kept_power: list[int] = []
        self._referenced_before = [port.referenced(n) for n in range(len(arm.joints))]
        self.post(BRING_UP_BEGINS, code=int(heals))
        dialogues = {}
        for joint, config in enumerate(arm.joints):
            if config.drive.identifiers:
                dialogues[joint] = self._bring_up(joint)
            else:
                start = mock_positions_rad[joint] if mock_positions_rad else 0.0
                self._sync_setpoint(joint, min(max(start, config.lower_rad), config.upper_rad), Unreferenced.REFERENCED)
        self.begin(dialogues)

    def _goes_on(self) -> bool:
        """Report findings that several joints may share, once all joints have been judged."""
        names = [joint.name for joint in self.arm.joints]
        for sentence in unreferenced_sentences({names[joint]: why for joint, why in sorted(self._unknown.items())}):
            self.tell(sentence)
        if kept := [names[joint] for joint in sorted(self._kept_power)]:
            who = joint_names(kept)
            self.tell(f"{who}: power was there all through the silence, as the drive proves, so the angle is known.")
        return False

    def _note_who_is_held(self) -> None:
        """Note the position of each joint that its drive holds, so that `_judge` can detect a count that has restarted.

        Bring-up does not move such a joint, so its reading must be the same afterwards. A joint that is limp or tripped
        may move meanwhile: what was noted of it is forgotten. Nothing new is noted of one that is held away from its
        commanded position, has no reference, or whose drive knows its angle.
        """
        near_rad = self.arm.limits.position_jump_rad / 2.0
        for joint, config in enumerate(self.arm.joints):
            measured_rad = self.port.measured_rad(joint)
            knows_its_angle = config.drive.knows_its_angle
            is_near = abs(self.port.commanded_rad(joint) - measured_rad) < near_rad
            if self.port.is_loose(joint):
                self._held_rad.pop(joint, None)
            elif self.port.holds(joint) and self.port.referenced(joint) and is_near and not knows_its_angle:
                self._held_rad[joint] = measured_rad

    def _sync_setpoint(self, joint: int, position_rad: float, reason: Unreferenced) -> None:
        self.post(SYNC_SETPOINT, joint=joint, value=position_rad, code=reason)

    def _bring_up(self, joint: int) -> Dialogue:
        found = yield from setup_of(self.arm.joints[joint].drive).bring_up(self, joint)
        self._judge(joint, found)

    def _judge(self, joint: int, found: Found) -> None:
        """Sync the setpoint to the drive's own target; the joint is referenced unless there is a reason against it."""
        config, reason = self.arm.joints[joint], found.reason
        per_rad, zero_rad = self.port.reading_per_rad(joint), self.port.zero_rad(joint)
        measured_rad = found.reading / per_rad - zero_rad
        target_rad = found.target / per_rad - zero_rad
        kept = found.kept_power and self.was_silent[joint]
        if reason == Unreferenced.POWER_LOST:
            self._unknown[joint] = reason
        if reason == Unreferenced.INCREMENTAL and (self._referenced_before[joint] or kept):
            reason = Unreferenced.REFERENCED
        elif reason == Unreferenced.INCREMENTAL:
            self._unknown[joint] = reason
        lost = self.lost_before.get(joint, Unreferenced.REFERENCED)
        made_good = config.drive.knows_its_angle and absolute_makes_good(lost)
        made_good |= kept and lost == Unreferenced.SILENT
        if reason == Unreferenced.REFERENCED and lost != Unreferenced.REFERENCED and not made_good:
            reason = self._unknown[joint] = lost
        step = math.copysign(self.port.reading_step_rad(joint), per_rad)
        moved_rad = measured_rad + zero_rad - self._counts_before[joint] * step if joint in self._counts_before else 0.0
        stood_rad = measured_rad if found.kept_power else self._flagged_rad.get(joint, measured_rad)
        stood_rad = self._held_rad.pop(joint, stood_rad)  # before the mark, which the drive may store
        if abs(measured_rad - stood_rad) > self.arm.limits.position_jump_rad:
            reason = self._unknown[joint] = Unreferenced.POWER_LOST
        if reason == Unreferenced.REFERENCED and abs(moved_rad) > self.arm.limits.position_jump_rad:
            reason = Unreferenced.MOVED
            self.tell(
                f"{config.name} is not referenced: it stands {math.degrees(moved_rad):+.2f}° from where it stood when "
                "rtarm was ended, so it was moved by hand or its drive has lost its count: see that it stands where "
                "`rtarm status` says, then take that with `rtarm reference`, or home it."
            )
        if reason == Unreferenced.REFERENCED and not (
            config.lower_rad - SLACK_RAD <= measured_rad <= config.upper_rad + SLACK_RAD
        ):
            reason = Unreferenced.OUTSIDE_LIMITS
            self.tell(
                f"{config.name} is not referenced: it reads {measured_rad:+.3f} rad, outside its limits "
                f"{config.lower_rad:+.3f} to {config.upper_rad:+.3f} rad; {_remedy(config, measured_rad)}."
            )
        if kept and reason == Unreferenced.REFERENCED:
            self.post(POWER_KEPT, joint=joint)
            self._forgive_silence(joint)
            self._kept_power.append(joint)
        self._sync_setpoint(joint, target_rad, reason)


def _remedy(config: JointConfig, measured_rad: float) -> str:
    """The part of a message that says what to do about a joint that reads outside its limits."""
    turn_rad = 2.0 * math.pi / config.ratio
    a_turn_off = any(config.lower_rad <= measured_rad + way <= config.upper_rad for way in (turn_rad, -turn_rad))
    within = config.drive.within_a_turn
    if within is not None and a_turn_off:
        return f"it may be a motor turn off: {within}"
    return "home it, or mend zero_deg or direction"
