"""Referencing: joints find their homing stops one after the other, or are where a person says.

Nothing here moves a joint by motion frames: a homing run is the drive's own, at its own speed, until it meets the stop
or its time-out. While one runs, the arm's other joints hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.conversation import TRIES, Ask, Conversation, Dialogue, TalkFailed, drive_addresses, silent_amid
from rtloop.drives import zdt_talk
from rtloop.port import ADOPT, COUNT_FROM, REFERENCING, REFERENCING_DONE, ServicePort
from shm.words import Fault, Unreferenced

AT_STOP_RAD = 0.02
"""A drive whose run has ended counts from where it stands: its shaft may settle this far from there."""


def begin_referencing(
    arm: ArmConfig, loop: np.ndarray, port: ServicePort, now_ns: int, tell: Callable[[str], None]
) -> Referencing:
    """Take up what the cycle was asked for (HOME or REFERENCE), joints to be homed in the arm file's order."""
    core, axes = loop[0]["core"], loop[0]["axes"]
    homed, placed = int(core["home_asked"]), int(core["reference_asked"])
    core["home_asked"] = core["reference_asked"] = 0
    order = list(dict.fromkeys([*arm.homing_order, *range(len(arm.joints))]))
    return Referencing(
        arm,
        port,
        now_ns=now_ns,
        homed=[joint for joint in order if homed >> joint & 1],
        placed={joint: float(axes[joint]["asked_rad"]) for joint in order if placed >> joint & 1},
        tell=tell,
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
    ) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.HOMING, last_order=REFERENCING_DONE)
        self._tell = tell
        self._ending = False
        with_drive = drive_addresses(arm)
        for joint in sorted({*homed, *placed} - set(with_drive)):  # what is commanded is where it is
            self._count_from(joint, arm.joints[joint].zero_rad, self._port.commanded_rad(joint))
        self._later: list[tuple[int, Callable[[int], Dialogue]]]
        self._later = [(joint, self._home) for joint in homed if joint in with_drive]
        self._later += [(joint, self._place_at(angle)) for joint, angle in placed.items() if joint in with_drive]

    def end(self) -> None:
        """Stop what is under way; its joint stays without a reference, and all is over once the drive stands."""
        if self._ending:
            return
        self._ending = True
        self._later.clear()
        for joint in list(self._dialogues):
            self._exchanges.pop(joint, None)
            self._dialogues.pop(joint).close()
            self.begin({joint: self._stand(joint)})

    def _goes_on(self) -> bool:
        if not self._later:
            return False
        joint, dialogue = self._later.pop(0)
        self.post(REFERENCING, joint=joint)
        self.begin({joint: dialogue(joint)})
        return True

    # --- what is said to a drive

    def _home(self, joint: int) -> Dialogue:
        config, limit_s = self.arm.joints[joint], self.arm.homing.timeout_s
        self._tell(f"{config.name}: homing; the drive runs to its stop by itself, for {limit_s:g} s at most.")
        flags = yield from self._sound(joint, config)
        if not (yield from zdt_talk.raise_homing_timeout(round(limit_s * 1e3))):
            raise TalkFailed(
                joint,
                f"The drive of {config.name} does not take a homing time-out of {limit_s:g} s: set it in its menu, or "
                "lower homing.timeout_s.",
            )
        answer = yield Ask(zdt_talk.HOME_BY_COLLISION, (3,), answered=self.arm.bus.acknowledge)
        if answer is not None and answer[1] == zdt_talk.REFUSED:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} refuses to home: look at its display for a fault and at its homing "
                "parameters.",
            )
        yield from self._run_out(joint, config)
        measured = yield from self._counts(joint, config, 0x36)
        if abs(measured) > AT_STOP_RAD * config.encoder_counts_per_rad:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} counts {measured} after its homing run, not 0, so it has not found its "
                "stop: see that it can reach it and that its homing parameters fit, then `rtarm clear-fault` and "
                "`rtarm home` again.",
            )
        if flags & zdt_talk.POWER_LOST:
            yield from self._clear_power_lost(joint, config)
        target = yield from self._counts(joint, config, 0x33)
        zero_rad = config.zero_rad
        self._count_from(joint, zero_rad, config.direction * target / config.encoder_counts_per_rad - zero_rad)
        self._tell(f"{config.name}: homed.")

    def _place_at(self, angle_rad: float) -> Callable[[int], Dialogue]:
        def place(joint: int) -> Dialogue:
            config = self.arm.joints[joint]
            flags = yield from self._sound(joint, config)
            measured = yield from self._counts(joint, config, 0x36)
            target = yield from self._counts(joint, config, 0x33)
            zero_rad = self._port.zero_rad(joint)
            if not math.isnan(angle_rad):
                zero_rad = config.direction * measured / config.encoder_counts_per_rad - angle_rad
            position_rad = config.direction * target / config.encoder_counts_per_rad - zero_rad
            self._count_from(joint, zero_rad, position_rad, flag_stays=bool(flags & zdt_talk.POWER_LOST))

        return place

    def _stand(self, joint: int) -> Dialogue:
        config = self.arm.joints[joint]
        for _ in range(TRIES):
            yield Ask(zdt_talk.END_HOMING, (3,), answered=self.arm.bus.acknowledge)  # refused where none runs
            yield Ask(zdt_talk.STOP, (3,), answered=self.arm.bus.acknowledge)
            flags = yield from zdt_talk.read_flags(0x3B)
            if flags is not None and not flags & zdt_talk.HOMING:
                return
        raise TalkFailed(
            joint,
            f"The drive of {config.name} does not say that it has ended its homing run: use the switch in the power "
            "line if it still moves.",
        )

    def _sound(self, joint: int, config: JointConfig) -> zdt_talk.Answered[int]:
        """Stop a drive that may be on its way somewhere, and see that it holds; its flags."""
        yield Ask(zdt_talk.STOP, (3,), answered=self.arm.bus.acknowledge)
        flags = yield from zdt_talk.read_flags(0x3A)
        if flags is None:
            raise TalkFailed(joint, silent_amid(config, "status"))
        if flags & zdt_talk.PROTECTED or not flags & zdt_talk.ENABLED:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} is in protection or not enabled, so it cannot be referenced: remove the "
                "cause, then `rtarm clear-fault`, which enables it.",
            )
        return flags

    def _run_out(self, joint: int, config: JointConfig) -> Dialogue:
        """Wait for the end of a homing run."""
        began_ns = self.now_ns
        limit_s = self.arm.homing.timeout_s
        while True:
            flags = yield from zdt_talk.read_flags(0x3B)
            if flags is None:
                raise TalkFailed(joint, silent_amid(config, "homing state"))
            if not flags & zdt_talk.HOMING:
                break
            if self.now_ns - began_ns > limit_s * 1e9:
                yield from self._stand(joint)
                flags = zdt_talk.HOMING_FAILED
                break
        if flags & zdt_talk.HOMING_FAILED:
            raise TalkFailed(
                joint,
                f"The drive of {config.name} has not found its homing stop within {limit_s:g} s, or was stopped: see "
                "that it can reach the stop and that direction, speed and collision current in its menu fit, then "
                "`rtarm clear-fault` and `rtarm home` again.",
            )

    def _clear_power_lost(self, joint: int, config: JointConfig) -> Dialogue:
        """The count means an angle again; only then may the flag go that said it does not."""
        for _ in range(TRIES):
            yield Ask(zdt_talk.CLEAR_POWER_LOST, (3,))
            flags = yield from zdt_talk.read_flags(0x3A)
            if flags is not None and not flags & zdt_talk.POWER_LOST:
                return
        raise TalkFailed(
            joint,
            f"The drive of {config.name} keeps its flag for lost power although it was told to clear it: switch it off "
            "and on, then home it again.",
        )

    def _counts(self, joint: int, config: JointConfig, function: int) -> zdt_talk.Answered[int]:
        counts = yield from zdt_talk.read_counts(function)
        if counts is None:
            raise TalkFailed(joint, silent_amid(config, "position"))
        return counts

    def _count_from(self, joint: int, zero_rad: float, position_rad: float, *, flag_stays: bool = False) -> None:
        """Tell the cycle what the joint's count means, and that it stands there, where its limits allow that."""
        config = self.arm.joints[joint]
        reason = Unreferenced.REFERENCED
        if not config.lower_rad - AT_STOP_RAD <= position_rad <= config.upper_rad + AT_STOP_RAD:
            reason = Unreferenced.OUTSIDE_LIMITS
        self.post(COUNT_FROM, joint=joint, value=zero_rad, code=int(flag_stays))
        self.post(ADOPT, joint=joint, value=position_rad, code=reason)
