"""What a simulated arm needs of a drive, whatever its family: the page to read before adding one.

A family is one file beside this one, with a class of drives, and one line in `sim.drives.families`. Families whose
drives are no stepper ramps build on `sim.drives.conversation.ServoDrive`, which does all of this but the protocol.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol

from config.joint import JointConfig
from sim.bus import Frame, Node
from sim.drives.servo import Load
from sim.drives.shaft import Reals, Times

LINK_KG_M2, LINK_FRICTION_NM = 0.02, 0.02
ROTOR_KG_M2, ROTOR_FRICTION_NM = 2e-5, 0.005
"""Inertia and friction of a joint, and of a motor [inf]."""
STRENGTH = 4.0
"""Torque of a motor beside what its joint's acceleration limit needs [inf]."""

Cause = Literal["stall", "temperature", "current"]
"""Why a protection trips."""


class TrueMotion(Protocol):
    """Where a shaft truly is and was; turns are revolutions of what the drive counts, before the joint's gear."""

    def past(self, time_ns: int) -> tuple[float, float]:
        """Position [revolutions] and speed [rpm] at any time of the history."""

    def history(self, times_ns: Times) -> tuple[Reals, Reals]:
        """Positions [revolutions] and speeds [rpm] at many times of the history."""

    def changes_ns(self) -> Times:
        """The times at which the speed changed, oldest first; the position is linear in between."""

    def forget_before(self, time_ns: int) -> None:
        """Let the history begin with the stretch of motion that a time lies in."""


class Drive(Node, Protocol):
    """A node of the bus with a shaft.

    Attributes:
        reply_delay_ns: least and greatest time from a request to its answer.
        reply_loss: share of what it says that never leaves it.
        cause_lasts: whether the cause of a tripped protection is still there, so that it cannot be cleared.
        powered: whether it has its supply.
        connected: whether its CAN plug is in.
        enabled: whether it holds its shaft, as far as it was told.
    """

    reply_delay_ns: tuple[int, int]
    reply_loss: float
    cause_lasts: bool
    powered: bool
    connected: bool
    enabled: bool

    @property
    def shaft(self) -> TrueMotion:
        """Its true motion, as far as it has been advanced."""

    @property
    def limp(self) -> bool:
        """Whether nothing but friction holds its shaft."""

    def advance(self, now_ns: int) -> None:
        """Live up to `now_ns`; a time already lived changes nothing."""

    def power_off(self, now_ns: int) -> None:
        """Lose the supply: silence, a loose shaft, and everything volatile forgotten."""

    def power_on(self, now_ns: int) -> None:
        """Boot."""

    def unplug(self, now_ns: int) -> None:
        """Lose the CAN cable: it hears nothing, says nothing, and goes on with what it was told."""

    def plug_in(self, now_ns: int) -> None:
        """Get the CAN cable back."""

    def block_shaft(self, now_ns: int) -> None:
        """Hold the shaft where it is from `now_ns` on."""

    def lead(self, now_ns: int, turns_s: float) -> None:
        """Have its limp shaft turned by a hand with this speed [rev/s], until told otherwise or enabled."""

    def disable(self, now_ns: int) -> None:
        """Be let go by somebody, not over the bus."""

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Trip the protection, which lets the shaft go."""

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is of its conversation with the host."""

    def state_frame(self, now_ns: int) -> Frame:
        """A frame with its position, as it would say it at `now_ns`."""

    def twin(self, now_ns: int, seed: int) -> Drive:
        """Another drive with the same place on the bus, from `now_ns` on."""


@dataclass(frozen=True)
class Mounting:
    """What a simulated drive is mounted to, and how it begins.

    Attributes:
        joint: the joint it moves, with its settings.
        bitrate: of the bus.
        start_ns: when it begins to exist.
        position_rad: where the joint stands then.
        homed: whether what it counts means the joint's angle; otherwise it was just switched on where it stands.
        seed: of its random delays.
        firmware, retarget, enabling, lag_s: of ZDT drives, see `sim.drives.zdt`.
        odrive_firmware: of an ODrive, see `sim.drives.odrive`.
        planning: of Damiao motors, see `sim.drives.damiao`.
    """

    joint: JointConfig
    bitrate: int
    start_ns: int
    position_rad: float
    homed: bool
    seed: int
    firmware: Literal["new", "old"] = "new"
    retarget: Literal["accept", "reject"] = "accept"
    enabling: Literal["hold", "pull"] = "hold"
    lag_s: float = 0.0
    odrive_firmware: Literal["0.5.6", "0.6"] = "0.5.6"
    planning: Literal["ramp", "gain"] = "ramp"

    def turns(self, position_rad: float) -> float:
        """Revolutions its shaft has made from where it counts 0 when the joint stands at an angle."""
        joint = self.joint
        return joint.direction * (position_rad + joint.zero_rad) * joint.ratio / (2.0 * math.pi)

    @property
    def load(self) -> Load:
        """A link of a small arm, as the drive feels it through its gear, and a motor strong enough for its limits."""
        joint = self.joint
        inertia_kg_m2 = ROTOR_KG_M2 + LINK_KG_M2 / joint.ratio**2
        friction_nm = ROTOR_FRICTION_NM + LINK_FRICTION_NM / joint.ratio
        needed_nm = inertia_kg_m2 * joint.max_acceleration_rad_s2 * joint.ratio + friction_nm
        return Load(inertia_kg_m2, friction_nm, STRENGTH * needed_nm)
