"""Bring-up: the conversation with the drives that ends in an arm that holds, or in a sentence saying why not.

It works the same at start, after a fault was cleared, and when limp drives are enabled again.

What a ZDT drive is asked (init_mode 1, nothing moves): firmware, status, configuration block (response
mode turned off in volatile memory when it differs and the firmware is one whose block we know), position
and target until the two agree. Where the arm file says so, drives are told to send their positions by themselves, and
must; and what a drive makes of FC is found out (`rtloop.fast_targets`). A drive that is on its way somewhere, or has
lost power, is stopped first.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from config.budget import budget
from config.drives.zdt import ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop import fast_targets, reports
from rtloop.conversation import TRIES, Ask, Conversation, Dialogue, TalkFailed
from rtloop.drives import zdt_registers as registers
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_registers import Version
from rtloop.drives.zdt_talk import Answered
from rtloop.port import ADOPT, BRING_UP_BEGINS, BRING_UP_DONE, FAST_READY, ServicePort
from shm.sentences import unreferenced_sentence
from shm.words import Fault, Unreferenced

SETTLE_PATIENCE_NS = 3_000_000_000
HOMING_TRIES = 10
ADOPT_WITHIN_RAD = 0.02
"""A drive whose target lies this near to its position is taken at its word."""


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
        mock_positions_rad: list[float] | None = None,
        counts_before: Mapping[int, int] | None = None,
        lost_before: Mapping[int, Unreferenced] | None = None,
    ) -> None:
        """`counts_before`: where drives counted when rtarm was ended, by the joints' numbers.

        `lost_before`: joints whose angle was not known in an earlier process, and why.
        """
        super().__init__(arm, port, now_ns, fault=Fault.BRING_UP, last_order=BRING_UP_DONE)
        self._tell = tell
        self._clears_protection = clears_protection
        self._counts_before = counts_before or {}
        self._lost_before = lost_before or {}
        # where a flag for lost power tells nothing new, only the joint's place can
        self._stood_rad = {n: port.measured_rad(n) for n in range(len(arm.joints)) if port.power_loss_known(n)}
        self._unasked = [port.unasked(n) for n in range(len(arm.joints))]
        self.post(BRING_UP_BEGINS)
        dialogues = {}
        for joint, config in enumerate(arm.joints):
            if isinstance(config.drive, ZdtDrive):
                dialogues[joint] = self._bring_up_zdt(joint, config, config.drive)
            else:
                start = mock_positions_rad[joint] if mock_positions_rad else 0.0
                self._adopt(joint, min(max(start, config.lower_rad), config.upper_rad), Unreferenced.REFERENCED)
        self.begin(dialogues)

    def _adopt(self, joint: int, position_rad: float, reason: Unreferenced) -> None:
        self.post(ADOPT, joint=joint, value=position_rad, code=reason)

    # --- what is said to a ZDT drive

    def _bring_up_zdt(self, joint: int, config: JointConfig, drive: ZdtDrive) -> Dialogue:
        answer = yield Ask(registers.ASK_FIRMWARE, (4, 6))
        if answer is None:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} (address {drive.address}) does not answer: check its power, its address "
                f"and the bit rate ({self.arm.bus.bitrate} bit/s) in its menu, and the CAN wires with 120 Ω at both "
                "ends.",
            )
        version = registers.version_of(answer)
        if version is None:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} (address {drive.address}) answers the question for its firmware with "
                f"{answer.hex(' ')}, which no ZDT drive with Emm firmware does: see what stands at that address.",
            )
        if not version.newer:
            self._tell(
                f"{config.name}: firmware {version} cannot say whether the drive has lost power; see that the joint "
                "stands where `rtarm status` says before it moves."
            )
        reason = Unreferenced.REFERENCED
        flags = yield from zdt_talk.status_of(joint, config)
        if flags & registers.PROTECTED:
            if not self._clears_protection:
                raise TalkFailed(
                    joint,
                    f"The drive of {config.name} has tripped its stall protection and holds nothing: free what blocks "
                    "the joint, then `rtarm clear-fault`.",
                )
            yield Ask(registers.CLEAR_PROTECTION, (3,))
            flags = yield from zdt_talk.status_of(joint, config)
            if flags & registers.PROTECTED:
                raise TalkFailed(
                    joint,
                    f"The drive of {config.name} stays in protection after it was cleared, so what tripped it (a "
                    "blocked joint, heat, current) is still there: find it on the drive's display, let the drive cool, "
                    "then `rtarm clear-fault`.",
                )
        if flags & registers.POWER_LOST and not self._port.power_loss_known(joint):
            yield self._stop()  # since it has power it may have heard targets of before
            reason = Unreferenced.POWER_LOST
            self._tell(
                f"{config.name} is not referenced: its drive has lost power since its position was set, so its count "
                "does not mean an angle: home it with `rtarm home`, or say where it stands with `rtarm reference`; "
                "until then goals are refused."
            )
        homing = yield from self._end_homing(joint, config)
        if reason == Unreferenced.REFERENCED:
            reason = Unreferenced.NOT_HOMED if homing else self._lost_before.get(joint, reason)
            if reason != Unreferenced.REFERENCED:
                self._tell(unreferenced_sentence(reason, config.name))
        yield from self._settle_configuration(joint, config, drive, version)
        yield from self._settle_reports(joint, config, version)
        if not flags & registers.ENABLED:
            for _ in range(TRIES):
                # it may pull its shaft to the target of before it was let go
                yield Ask(registers.STOP, (3,), answered=self.arm.bus.acknowledge, before=(registers.ENABLE,))
                flags = yield from zdt_talk.status_of(joint, config)
                if flags & registers.ENABLED:
                    break
            else:
                raise TalkFailed(
                    joint,
                    f"The drive of {config.name} stays disabled after being enabled: look at its display for a fault "
                    "and at the En setting in its menu.",
                )
        if self.arm.bus.fast_targets:
            yield from fast_targets.prepare(self.arm, joint, drive, version)
            self.post(FAST_READY, joint=joint)
        yield from self._adopt_position(joint, config, reason)

    def _end_homing(self, joint: int, config: JointConfig) -> Answered[bool]:
        """End a homing run that a control process has left behind; whether there was one."""
        end: tuple[bytes, ...] = ()
        for looks in range(HOMING_TRIES):
            flags = yield from zdt_talk.read_flags(registers.ASK_HOMING_STATUS, before=end)
            if flags is None or not flags & registers.HOMING:
                return looks > 0
            if looks > 0:  # one answer alone may be garbled
                end = (registers.END_HOMING, registers.STOP)
        raise TalkFailed(
            joint,
            f"The drive of {config.name} is amid a homing run and does not end it: use the switch in the power line, "
            "then `rtarm clear-fault`.",
        )

    def _stop(self) -> Ask:
        return Ask(registers.STOP, (3,), answered=self.arm.bus.acknowledge)

    def _settle_configuration(self, joint: int, config: JointConfig, drive: ZdtDrive, version: Version) -> Dialogue:
        """Check what would make motion wrong; set the response mode in volatile memory."""
        wanted = registers.RESPONSE_RECEIVE if self.arm.bus.acknowledge else registers.RESPONSE_NONE
        block = yield from zdt_talk.read_block()
        if block is None or not version.known:
            if not self.arm.bus.acknowledge:
                self._require_budget_with_acknowledgements(joint, config, version)
            return
        if block.checksum != 0:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} uses checksum mode {block.checksum}, only 0 (the constant 6B) is spoken "
                "here: set Checksum to 0x6B in its menu.",
            )
        if block.microsteps != drive.microsteps:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} is set to {block.microsteps} microsteps, the arm file says "
                f"{drive.microsteps}: positions would be wrong by that factor; change one of the two.",
            )
        if block.response == wanted:
            return
        block = yield from zdt_talk.read_block_surely()
        if block is None:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} tells its configuration in another way whenever it is asked, so its "
                "acknowledgements are not set, for which all of it is written back: check the adapter, its cable and "
                "the CAN wires, then `rtarm clear-fault`, or `rtarm up` where it has ended.",
            )
        yield Ask(registers.write_block(replace(block, response=wanted), store=False), (3,))
        for _ in range(TRIES):  # an answer from before the change may still be on its way
            after = yield from zdt_talk.read_block()
            if after is not None and after.response == wanted:
                break
        else:
            self._require_budget_with_acknowledgements(joint, config, version)
            self._tell(f"{config.name}: its drive keeps its acknowledgements on although told otherwise.")
            return
        name = "on" if wanted else "off"
        self._tell(f"{config.name}: acknowledgements turned {name} in the drive's volatile memory.")

    def _settle_reports(self, joint: int, config: JointConfig, version: Version) -> Dialogue:
        """Have the position sent as the arm file says, in volatile memory: by the drive itself, or when it is asked.

        A control process that was killed leaves its drives reporting; they are told to cease only where they do.
        """
        if not self.arm.bus.reported:
            by_itself = self._port.unasked(joint) - self._unasked[joint] >= reports.REPORTS_TO_BELIEVE
            if by_itself and (yield from zdt_talk.set_reports(0)):
                self._tell(f"{config.name}: its drive sent its position by itself, which was ended.")
            return
        yield from reports.begin(self.arm, self._port, joint, version)

    def _require_budget_with_acknowledgements(self, joint: int, config: JointConfig, version: Version) -> None:
        loud = self.arm.model_copy(update={"bus": self.arm.bus.model_copy(update={"acknowledge": True})})
        found = budget(loud)
        if not found.fits:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} (firmware {version}) keeps acknowledging commands, and with "
                f"acknowledgements the bus carries {found.highest_rate_hz:.0f} Hz, not "
                f"{self.arm.control.rate_hz:g} Hz: lower control.rate_hz, or turn its Response off in its menu.",
            )

    def _adopt_position(self, joint: int, config: JointConfig, reason: Unreferenced) -> Dialogue:
        """Take the drive's own target as the commanded position, once the joint stands near it."""
        started_ns = self.now_ns
        stopped = False
        counts_per_rad = config.direction * config.encoder_counts_per_rad
        zero_rad = self._port.zero_rad(joint)
        while True:
            measured = yield from zdt_talk.counts_of(joint, config, registers.ASK_POSITION)
            target = yield from zdt_talk.counts_of(joint, config, registers.ASK_TARGET)
            measured_rad = measured / counts_per_rad - zero_rad
            target_rad = target / counts_per_rad - zero_rad
            if abs(target_rad - measured_rad) <= ADOPT_WITHIN_RAD:
                break
            if not stopped:  # whatever it is on its way to, nobody here has told it
                stopped = True
                yield self._stop()
                continue
            if self.now_ns - started_ns > SETTLE_PATIENCE_NS:
                if reason == Unreferenced.REFERENCED:
                    reason = Unreferenced.TARGET_FAR
                    self._tell(
                        f"{config.name} is not referenced: its drive stands {measured_rad - target_rad:+.3f} rad from "
                        "its own target and does not go there: find what holds it, then `rtarm reference` it if it "
                        "stands where `rtarm status` says, or home it."
                    )
                target_rad = measured_rad
                break
        moved_rad = (measured - self._counts_before.get(joint, measured)) / counts_per_rad
        elsewhere_rad = abs(measured_rad - self._stood_rad.get(joint, measured_rad))
        if elsewhere_rad > self.arm.limits.position_jump_rad:
            reason = Unreferenced.POWER_LOST
            self._tell(unreferenced_sentence(reason, config.name))
        if reason == Unreferenced.REFERENCED and abs(moved_rad) > self.arm.limits.position_jump_rad:
            reason = Unreferenced.MOVED
            self._tell(
                f"{config.name} is not referenced: it stands {math.degrees(moved_rad):+.2f}° from where it stood when "
                "rtarm was ended, so it was moved by hand or its drive has lost its count: see that it stands where "
                "`rtarm status` says, then take that with `rtarm reference`, or home it."
            )
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
