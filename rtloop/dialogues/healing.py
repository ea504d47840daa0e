"""Going on after a stall by itself: narrowly, and never on a guess.

A silence of all drives is a fault however it came about: goals and streams are over, the arm has been braked and stands
in Mode.FAULT. Where nobody but the machine, the adapter or the bus stood still, a person who clears that fault has
nothing to find. So it is cleared here, without clearing any error of a drive, when every one of these holds:

- all drives were silent, and are heard again within `ENDED_WITHIN_NS`;
- each drive says that it holds, without an error, and each has been heard for so long that no answer can be an old one
  (`lag_ns`): what waited in any queue has been said;
- each joint has stood still for `REST_NS`, between where it was when it fell silent and where it was led;
- each drive proves that it had power (`rtloop.drives.power`), or has an encoder that needs none;
- the arm is simulated, or a bench test of each drive has found that it brakes in silence and proves its power
  (`rtloop.kept.commissioned`);
- nobody had asked for anything else that ended in this fault, such as a homing run or to let the drives go;
- the wire was there all the time, and the controller on the bus;
- it is not the third time in a minute.

What speaks against going on is looked for again once the drives have proven their power.

Why it was silent is never asked: that is told to people alone. The hazards of this stand in docs/explanation/safety.md.
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
"""A stall is over by then; whoever looks at an arm that stands in a fault for longer may have begun to handle it."""
DECIDED_WITHIN_NS = 4_000_000_000
REST_NS = 100_000_000
MOST_HEALED = 2
WITHIN_NS = 60_000_000_000
"""A fault that comes back for the third time within this stays, so that somebody looks for its cause."""


class PowerCheck(Conversation):
    """Asks every drive whether it had power; nothing is decided or changed by it.

    Attributes:
        proven: joints whose drive has had power in the silence, or need not have had it.
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
    """Watches the faults of one arm; `unlocked`: its drives are known to brake in silence and to prove their power."""

    def __init__(self, arm: ArmConfig, loop: np.ndarray, port: ServicePort, marks: Marks, *, unlocked: bool) -> None:
        self._arm, self._loop, self._port, self._marks = arm, loop, port, marks
        self._joints = joints_on_the_bus(arm)
        # a single silent drive may be the cause itself, and a bring-up for FC tries targets
        self._unlocked = unlocked and len(self._joints) > 1 and not arm.bus.fast_targets
        self._watched_ns = self._given_up_ns = self._rest_since_ns = 0
        self._stood_rad: list[float] = []
        self._healed_ns: deque[int] = deque(maxlen=MOST_HEALED)
        self._check: PowerCheck | None = None

    def begin(self, now_ns: int) -> PowerCheck | None:
        """Called from time to time: the questions for power, once nothing else speaks against going on."""
        memory = self._loop[0]
        fault_ns = int(memory["fault"]["latched_ns"])
        if not self._unlocked or int(memory["mode"]) != Mode.FAULT or fault_ns == self._given_up_ns:
            return None
        if fault_ns != self._watched_ns:
            self._watched_ns, self._stood_rad = fault_ns, []  # where it stood in another fault says nothing of this one
        if not self._may_heal(now_ns, fault_ns):
            self._given_up_ns = fault_ns
            return None
        if not self._stands(now_ns):
            return None
        self._given_up_ns = fault_ns  # it is tried once
        self._check = PowerCheck(self._arm, self._port, self._marks, now_ns)
        return self._check

    def succeeded(self, talk: Conversation, now_ns: int) -> bool:
        """Whether this conversation was the last question, and the arm may be brought up again now.

        Any other that ends in a fault was asked for by a person, who is to see what became of it.
        """
        memory = self._loop[0]
        if talk is not self._check or self._check is None:
            if int(memory["mode"]) == Mode.FAULT:
                self._given_up_ns = int(memory["fault"]["latched_ns"])
            return False
        asked = int(memory["dialogue"]["bring_up_asked"]) == 1  # a person's clear is a person's
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
        if int(memory["bus"]["transmit_inhibited"]) == 1:
            return False  # the wire went, or the controller left the bus, under this fault
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
        """Whether every joint has stood for long enough where it may, and its drive holds it."""
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
        """Whether every joint stands where it stood when its rest began."""
        return len(self._stood_rad) == len(self._joints) and all(
            abs(now - before) <= self._slack_rad(joint)
            for joint, now, before in zip(self._joints, self._stand_rad(), self._stood_rad, strict=True)
        )

    def _slack_rad(self, joint: int) -> float:
        return 2.0 * float(self._loop[0]["joints"][joint]["slack_rad"])

    def _hold(self) -> bool:
        """Whether each drive has said since the rest began that it holds, and of no error."""
        axes = self._loop[0]["axes"]
        return all(
            self._port.holds(joint) and int(axes[joint]["drive"]["status_ns"]) > self._rest_since_ns
            for joint in self._joints
        )

    def _is_fresh(self, joint: int, now_ns: int) -> bool:
        """Whether the last reading is new, and no answer can be older than the question before its own."""
        axis, reading_ns = self._loop[0]["axes"][joint], int(self._loop[0]["params"]["reading_ns"])
        age_ns = now_ns - int(axis["measured"]["time_ns"])
        return age_ns <= FRESH_READINGS * reading_ns and int(axis["tracking"]["lag_ns"]) <= reading_ns

    def _is_on_its_way(self, joint: int) -> bool:
        """Whether a joint stands between its last reading before the silence and where it was led."""
        axis = self._loop[0]["axes"][joint]
        if int(axis["reference"]["referenced"]) == 1:  # no following error is latched beside another fault
            away_rad = abs(float(axis["commanded"]["position_rad"]) - float(axis["measured"]["position_rad"]))
            return away_rad <= self._arm.limits.following_error_rad
        ends = float(axis["reference"]["lost_at_rad"]), float(axis["commanded"]["position_rad"])
        beside_rad = self._arm.limits.position_jump_rad
        return min(ends) - beside_rad <= float(axis["measured"]["position_rad"]) <= max(ends) + beside_rad
