"""Automatic recovery after a stall: under narrow conditions, and never on a guess.

A silence of all drives is a fault, whatever its cause: goals and streams are over, the arm has been braked and stands
in Mode.FAULT. If only the machine, the adapter or the bus had stalled, an operator who clears that fault would find
nothing wrong. So the fault is cleared here, without clearing any error of a drive, when every one of these holds:

- all drives of a bus with more than one were silent, no other reason than silence cost a joint its reference, and
  readings come again within `ENDED_WITHIN_NS`;
- each drive reports that it holds, without an error, and has answered for so long that no answer can be an old one
  (`lag_ns`): whatever waited in a queue has been received;
- each joint has stood still for `REST_NS`: one that lost its reference between its position when the drive fell silent
  and its commanded position, any other within the following error limit of its commanded position;
- each drive proves that it had power (`rtloop.drives.power`), or needs no proof: it has an absolute encoder, and is not
  of a family whose drives a target enables;
- the arm is simulated, or a bench test of each drive has found that it brakes in silence and proves its power
  (`rtloop.kept.commissioned`);
- the fault did not end anything else that was requested, such as a homing run or the release of the drives;
- the wire stayed open all the time, and the controller stayed on the bus;
- targets are not sent with FC, and no shutdown has begun;
- all of that is decided within `DECIDED_WITHIN_NS`; it is tried once for a fault, and this is not the third in a
  minute.

The reasons against recovery are checked again once the drives have proven their power.

The cause of the silence plays no part in this decision: it is only reported to the operator.
docs/explanation/safety.md describes the hazards of automatic recovery.
"""

from collections import deque

import numpy as np

from config.schema import ArmConfig
from rtloop.drives.power import Marks
from rtloop.drives.setup import joints_on_the_bus, must_prove_power, power_proof_of
from rtloop.memory.axis import FRESH_READINGS
from rtloop.service.conversation import Conversation, Dialogue
from rtloop.service.port import ServicePort
from shm.words import Fault, Mode, Unreferenced

ENDED_WITHIN_NS = 1_000_000_000
"""A longer stall is not recovered from: people who see the arm stand in a fault may have begun to handle it."""
DECIDED_WITHIN_NS = 4_000_000_000
"""Time after the fault within which recovery must be decided, or it is given up."""
REST_NS = 100_000_000
MOST_HEALED = 2
WITHIN_NS = 60_000_000_000
"""A third such fault within this time stays latched, so that an operator looks for its cause."""


class PowerCheck(Conversation):
    """Asks every drive for the proof that it had power; decides and changes nothing.

    Attributes:
        proven: joints whose drive has proven that it had power during the silence, or needs no proof.
    """

    def __init__(self, arm: ArmConfig, port: ServicePort, marks: Marks, now_ns: int) -> None:
        super().__init__(arm, port, now_ns, fault=Fault.STALE_READING)
        self.marks = marks
        self.proven: set[int] = set()
        self.begin({joint: self._ask(joint) for joint in joints_on_the_bus(arm)})

    def _ask(self, joint: int) -> Dialogue:
        drive = self.arm.joints[joint].drive
        proof = power_proof_of(drive)
        if not must_prove_power(drive) or (proof is not None and (yield from proof.kept_power(self, joint))):
            self.proven.add(joint)


class Healing:
    """Decides on recovery from the faults of one arm.

    `unlocked`: its drives are known to brake in silence and to prove their power.
    """

    def __init__(self, arm: ArmConfig, loop: np.ndarray, port: ServicePort, marks: Marks, *, unlocked: bool) -> None:
        self._arm, self._loop, self._port, self._marks = arm, loop, port, marks
        self._joints = joints_on_the_bus(arm)
        # a single drive that is silent may be the cause itself; a bring-up for FC sends targets to try them
        self._unlocked = unlocked and len(self._joints) > 1 and not arm.bus.fast_targets
        self._watched_ns = self._given_up_ns = self._rest_since_ns = 0
        self._stood_rad: list[float] = []
        self._healed_ns: deque[int] = deque(maxlen=MOST_HEALED)
        self._check: PowerCheck | None = None

    def begin(self, now_ns: int) -> PowerCheck | None:
        """Called periodically: begin the power check once all other conditions hold, else return None."""
        memory = self._loop[0]
        fault_ns = int(memory["fault"]["latched_ns"])
        if not self._unlocked or int(memory["mode"]) != Mode.FAULT or fault_ns == self._given_up_ns:
            return None
        if fault_ns != self._watched_ns:
            self._watched_ns, self._stood_rad = fault_ns, []  # positions in an earlier fault do not count for this one
        if not self._may_heal(now_ns, fault_ns):
            self._given_up_ns = fault_ns
            return None
        if not self._stands(now_ns):
            return None
        self._given_up_ns = fault_ns  # one attempt a fault
        self._check = PowerCheck(self._arm, self._port, self._marks, now_ns)
        return self._check

    def succeeded(self, talk: Conversation, now_ns: int) -> bool:
        """Whether `talk`, which has ended, was the power check, and the arm may be brought up again now.

        There is no recovery from a fault in which any other conversation ends: an operator requested it and is to see
        its result, or it was the bring-up of a recovery or of the start.
        """
        memory = self._loop[0]
        if talk is not self._check or self._check is None:
            if int(memory["mode"]) == Mode.FAULT:
                self._given_up_ns = int(memory["fault"]["latched_ns"])
            return False
        asked = int(memory["dialogue"]["bring_up_asked"]) == 1  # an operator's clear goes first
        if (
            asked
            or self._check.proven != set(self._joints)
            or not self._may_heal(now_ns, int(memory["fault"]["latched_ns"]))
        ):
            return False
        if not self._is_still() or not self._hold():
            return False
        self._healed_ns.append(now_ns)
        return True

    def _may_heal(self, now_ns: int, fault_ns: int) -> bool:
        memory, fault, axes = self._loop[0], self._loop[0]["fault"], self._loop[0]["axes"]
        if (
            int(fault["code"]) != Fault.STALE_READING
            or int(fault["joint"]) != -1
            or int(memory["motion"]["closing"]) == 1
        ):
            return False
        if np.any(memory["buses"]["transmit_inhibited"][: len(self._arm.buses)]):
            return False  # a wire was lost, or the controller left the bus, during this fault
        if len(self._healed_ns) == MOST_HEALED and now_ns - self._healed_ns[0] < WITHIN_NS:
            return False
        lost = {Unreferenced(axes[joint]["reference"]["unreferenced_reason"]) for joint in range(len(self._arm.joints))}
        if not lost <= {Unreferenced.REFERENCED, Unreferenced.SILENT}:
            return False
        heard_ns = min(int(axes[joint]["measured"]["time_ns"]) for joint in self._joints)
        if heard_ns < fault_ns and now_ns - fault_ns > ENDED_WITHIN_NS:
            return False
        return now_ns - fault_ns <= DECIDED_WITHIN_NS

    def _stands(self, now_ns: int) -> bool:
        """Whether every joint has stood for `REST_NS` where it may stand, and its drive holds it."""
        axes = self._loop[0]["axes"]
        led = np.any(axes[: len(self._arm.joints)]["commanded"]["velocity_rad_s"] != 0.0)
        if led or not self._is_still() or not all(self._is_fresh(joint, now_ns) for joint in self._joints):
            self._stood_rad, self._rest_since_ns = self._stand_rad(), now_ns
            return False
        rested = now_ns - self._rest_since_ns >= REST_NS and self._hold()
        return rested and all(self._is_on_its_way(joint) for joint in self._joints)

    def _stand_rad(self) -> list[float]:
        return [float(self._loop[0]["axes"][joint]["measured"]["position_rad"]) for joint in self._joints]

    def _is_still(self) -> bool:
        """Whether every joint stands where it stood when the rest began."""
        return len(self._stood_rad) == len(self._joints) and all(
            abs(now - before) <= self._slack_rad(joint)
            for joint, now, before in zip(self._joints, self._stand_rad(), self._stood_rad, strict=True)
        )

    def _slack_rad(self, joint: int) -> float:
        return 2.0 * float(self._loop[0]["joints"][joint]["slack_rad"])

    def _hold(self) -> bool:
        """Whether each drive has reported since the rest began that it holds, without an error."""
        axes = self._loop[0]["axes"]
        return all(
            self._port.holds(joint) and int(axes[joint]["drive"]["status_ns"]) > self._rest_since_ns
            for joint in self._joints
        )

    def _is_fresh(self, joint: int, now_ns: int) -> bool:
        """Whether the last reading is new, and is at most one reading period older than its stamp (`lag_ns`)."""
        axis, reading_ns = self._loop[0]["axes"][joint], int(self._loop[0]["params"]["reading_ns"])
        age_ns = now_ns - int(axis["measured"]["time_ns"])
        return age_ns <= FRESH_READINGS * reading_ns and int(axis["tracking"]["lag_ns"]) <= reading_ns

    def _is_on_its_way(self, joint: int) -> bool:
        """Whether a joint stands between its last reading before the silence and its commanded position.

        A joint that is still referenced must be within the following error limit of its commanded position.
        """
        axis = self._loop[0]["axes"][joint]
        if int(axis["reference"]["referenced"]) == 1:  # beside a latched fault, no following error is latched
            away_rad = abs(float(axis["commanded"]["position_rad"]) - float(axis["measured"]["position_rad"]))
            return away_rad <= self._arm.limits.following_error_rad
        ends = float(axis["reference"]["lost_at_rad"]), float(axis["commanded"]["position_rad"])
        beside_rad = self._arm.limits.position_jump_rad
        return min(ends) - beside_rad <= float(axis["measured"]["position_rad"]) <= max(ends) + beside_rad
