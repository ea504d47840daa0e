"""Referencing: joints find their homing stops one after the other, or take the angle that an operator states.

No motion frame moves a joint here: the drive executes its homing run itself, at its own speed, until it meets the stop
or its time-out. While one joint homes, the arm's other joints hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from config.schema import ArmConfig
from rtloop.dialogues.bringup import SLACK_RAD
from rtloop.drives.power import Marks
from rtloop.drives.setup import homing_of, joints_on_the_bus, placing_of
from rtloop.kept.reference_store import NotSaved
from rtloop.service.conversation import Conversation, Dialogue, DialogueFailed, silent_amid
from rtloop.service.port import COUNT_FROM, REFERENCING, REFERENCING_DONE, SYNC_SETPOINT, ServicePort
from shm.words import Fault, Unreferenced

ELSEWHERE_RAD = 0.1
"""A joint whose angle was known before must stop within this of its stop; otherwise it has met an obstacle."""
FRESH_NS = 100_000_000
"""The last reading of a drive that answers is not older than this."""


KeepLost = Callable[[int, Unreferenced | None], None]
"""Stores for later processes why a joint's angle is not known, or (None) that it is; may raise NotSaved."""


def referencing_asked_for(
    arm: ArmConfig,
    loop: np.ndarray,
    port: ServicePort,
    now_ns: int,
    tell: Callable[[str], None],
    keep_lost: KeepLost,
    marks: Marks,
) -> Referencing:
    """Begin what was requested of the cycle (HOME or REFERENCE); joints are homed in the arm file's order."""
    dialogue, axes = loop[0]["dialogue"], loop[0]["axes"]
    homed, placed = int(dialogue["home_asked"]), int(dialogue["reference_asked"])
    dialogue["home_asked"] = dialogue["reference_asked"] = 0
    order = list(dict.fromkeys([*arm.homing_order, *range(len(arm.joints))]))
    return Referencing(
        arm,
        port,
        now_ns=now_ns,
        homed=[joint for joint in order if homed >> joint & 1],
        placed={joint: float(axes[joint]["asked_rad"]) for joint in order if placed >> joint & 1},
        tell=tell,
        keep_lost=keep_lost,
        marks=marks,
    )


class Referencing(Conversation):
    """Homes joints in the order given, then sets the angles of joints for which an operator stated one.

    `placed`: joint number → stated angle (rad), NaN to accept the angle that the drive's count gives.
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
        """`keep_lost` stores for later processes why a joint's angle is not known, or that it is.

        `again`: what an operator does to try once more, as messages name it.
        """
        super().__init__(arm, port, now_ns, fault=Fault.HOMING, last_order=REFERENCING_DONE)
        self.tell = tell
        self._keep_lost_beyond = keep_lost
        self.marks = marks
        self.again = again
        self._ending = False
        self._runs = False
        """Whether the homing run of the joint under way has begun."""
        self._expected_rad: float | None = None
        """The angle of that joint's stop, if it is known."""
        with_drive = joints_on_the_bus(arm)
        for joint in sorted({*homed, *placed} - set(with_drive)):  # they stand where they are commanded
            self.count_from(joint, arm.joints[joint].zero_rad, self.port.commanded_rad(joint))
        self._later = [(joint, partial(self._home, joint)) for joint in homed if joint in with_drive]
        self._later += [
            (joint, partial(self._place, joint, angle)) for joint, angle in placed.items() if joint in with_drive
        ]

    def end(self) -> None:
        """End a run that is under way, and skip the joints that remain.

        A joint whose run is interrupted stays unreferenced. The conversation is over once its drive stands.
        """
        if self._ending:
            return
        self._ending = True
        self._later.clear()
        for joint in list(self._dialogues):
            self._exchanges.pop(joint, None)
            self._dialogues.pop(joint).close()
            if (homes := homing_of(self.arm.joints[joint].drive)) is not None:
                self.begin({joint: homes.end_homing(self, joint)})

    def _goes_on(self) -> bool:
        if not self._later:
            return False
        joint, dialogue = self._later.pop(0)
        self.begin({joint: dialogue()})
        return True

    # --- a homing run

    def _home(self, joint: int) -> Dialogue:
        """Let the drive find its stop; for a drive without a homing run the joint's reference stays as it is."""
        config = self.arm.joints[joint]
        homes = homing_of(config.drive)
        if homes is None:
            if config.knows_its_angle:
                self.tell(f"{config.name}: its drive knows its angle, so there is nothing to home.")
            else:
                self.tell(f"{config.name}: its drive has no homing run, so `rtarm reference` says where it stands.")
            return
        self.tell(
            f"{config.name}: homing; the drive runs to its stop by itself, for {self.arm.homing.timeout_s:g} s at most."
        )
        self._runs = False
        try:
            target = yield from homes.home(self, joint)
        except DialogueFailed:
            if self._runs:
                yield from homes.end_homing(self, joint)
            raise
        assert self._runs, f"the run of {config.drive.family} does not say when it begins (ReferencingHost.run_begins)"
        self.keep_lost(joint, None)
        self.count_from(joint, config.zero_rad, target / self.port.reading_per_rad(joint) - config.zero_rad)
        self.tell(f"{config.name}: homed.")

    def run_begins(self, joint: int) -> None:
        """See `ReferencingHost.run_begins`."""
        self._expected_rad = -self.arm.joints[joint].zero_rad if self.port.referenced(joint) else None
        self.keep_lost(joint, Unreferenced.NOT_HOMED)
        self.post(REFERENCING, joint=joint, code=1)
        self._runs = True

    def require_place(self, joint: int, stopped: float) -> None:
        """See `ReferencingHost.require_place`."""
        config, expected_rad = self.arm.joints[joint], self._expected_rad
        stopped_rad = stopped / self.port.reading_per_rad(joint) - self.port.zero_rad(joint)
        if expected_rad is None or abs(stopped_rad - expected_rad) <= ELSEWHERE_RAD:
            return
        raise DialogueFailed(
            joint,
            f"{config.name} met something at {math.degrees(stopped_rad):.1f}°, although its stop is at "
            f"{math.degrees(expected_rad):.1f}°: remove what is in its way, then {self.again}, "
            "which then takes whatever stops it for its stop.",
        )

    # --- an angle that an operator states

    def _place(self, joint: int, angle_rad: float) -> Dialogue:
        """Take the operator's angle for the joint, or, with NaN, the angle that it reads."""
        places = placing_of(self.arm.joints[joint].drive)
        if places is None:
            self.count_as_read(joint, angle_rad)
        else:
            yield from places.place(self, joint, angle_rad)

    def count_as_read(self, joint: int, angle_rad: float) -> None:
        """See `ReferencingHost.count_as_read`."""
        config = self.arm.joints[joint]
        if self.now_ns - self.port.measured_ns(joint) > FRESH_NS:
            raise DialogueFailed(joint, silent_amid(config, "position"))
        self.post(REFERENCING, joint=joint)
        zero_rad, measured_rad = self.port.zero_rad(joint), self.port.measured_rad(joint)
        # the drive's target, which a load keeps the joint from reaching, stays the commanded position
        bent_rad = self.port.commanded_rad(joint) - measured_rad
        if abs(bent_rad) > self.arm.limits.following_error_rad:
            bent_rad = 0.0
        if not math.isnan(angle_rad):
            self.keep_lost(joint, Unreferenced.NOT_HOMED if config.drive.knows_its_angle else None)
            zero_rad += measured_rad - angle_rad
            measured_rad = angle_rad
        elif zero_rad == config.zero_rad:
            self.keep_lost(joint, None)
        self.count_from(joint, zero_rad, measured_rad + bent_rad)

    # --- both

    def keep_lost(self, joint: int, reason: Unreferenced | None) -> None:
        """See `ReferencingHost.keep_lost`."""
        try:
            self._keep_lost_beyond(joint, reason)
        except NotSaved as problem:
            raise DialogueFailed(joint, str(problem)) from None

    def count_from(
        self,
        joint: int,
        zero_rad: float,
        position_rad: float,
        reason: Unreferenced = Unreferenced.REFERENCED,
        *,
        flag_stays: bool = False,
    ) -> None:
        """See `ReferencingHost.count_from`."""
        config = self.arm.joints[joint]
        inside = config.lower_rad - SLACK_RAD <= position_rad <= config.upper_rad + SLACK_RAD
        if reason == Unreferenced.REFERENCED and not inside:
            reason = Unreferenced.OUTSIDE_LIMITS
        known = flag_stays and reason == Unreferenced.REFERENCED
        self.marks.referenced(joint)
        self.post(COUNT_FROM, joint=joint, value=zero_rad, code=int(known))
        self.post(SYNC_SETPOINT, joint=joint, value=position_rad, code=reason)
