"""The gripper on the arm's bus: a conversation with its drive, for as long as the control process lives.

The drive's family makes the frames (`rtloop.drives.gripper`). One command is a whole motion, so nothing here has a
deadline. The frames use the bus time that the cycle leaves over, beside any conversation with the joints' drives.

A grip is a stall: the gripper stands although it has not reached its target. Its drive is then commanded to hold where
it is; otherwise it would push until its own protection trips and releases the object. A trouble of the gripper is
published and reported, but is never a fault of the arm: stopping the arm because of its gripper would help nobody.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from config.gripper import MOVING_POLL_HZ, RESTING_POLL_HZ
from config.schema import ArmConfig
from motion.gripping import Grip, GripJudge, stall_ns
from rtloop.drives.gripper import Trouble, gripper_drive_of
from rtloop.memory.link import GRIPPER
from rtloop.service.conversation import Conversation, Unaddressed
from rtloop.service.port import Frame, ServicePort
from sentences.told import grip_trouble_sentence
from shm import layout
from shm.gripper import show_gripper
from shm.words import Fault, GripTrouble, Request

ONLY = GRIPPER
"""Key of the conversation's only dialogue, that with the gripper's drive."""
AFTER_TROUBLE_NS = 1_000_000_000
"""Time until the next turn while the drive is not known."""
OUTSIDE_RAD = math.radians(20.0)
"""A reading further than this beyond the gripper's range is not a valid angle."""


class Order(NamedTuple):
    """An order to the gripper; `kind` is one of shm.words.Request."""

    sequence: int
    kind: int
    angle_rad: float
    effort: float


class GripperDialogue(Conversation):
    """One drive, turn by turn: identify it, carry out the newest order, read its position, publish the state."""

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
        """`state` is the mapped state file, shape (1,), into which the gripper's record is written."""
        assert arm.gripper is not None and arm.gripper.servo is not None
        self._gripper, self._nm_per_ampere = arm.gripper, arm.gripper.servo.nm_per_ampere
        super().__init__(arm, port, now_ns, fault=Fault.NONE)
        self._drive = gripper_drive_of(arm.gripper.servo, arm.gripper, self)
        self._asked, self._operator = loop[0]["gripper"], loop[0]["operator"]
        self._state = state
        self._tell = tell
        self._shown = np.zeros((), layout.Gripper.dtype)
        self._shown["position_rad"] = self._shown["velocity_rad_s"] = math.nan
        self._shown["measured_effort"] = self._shown["target_rad"] = math.nan
        self._known = False
        self._taken = int(self._asked["sequence"])
        self._halts = self._counted_halts()
        self._obeying = self._halting = False
        self._judge: GripJudge | None = None
        self._turns = 0
        self._next_ns = now_ns

    @property
    def busy(self) -> bool:
        """Whether a dialogue is open or an order waits, so that frequent polling is worthwhile."""
        return bool(self._dialogues) or self.waits

    @property
    def moves(self) -> bool:
        """Whether a motion is under way."""
        return int(self._shown["grip"]) == Grip.MOVING

    def _received(self) -> list[Frame]:
        return self.port.received(of_gripper=True)

    def poll(self, now_ns: int) -> bool:
        """One step; a stop or hold of the arm also stops a moving gripper, and what is gripped stays gripped."""
        halts_before, self._halts = self._halts, self._counted_halts()
        if self._halts != halts_before and (self.moves or self.waits or self._obeying):
            self.stop()
        return super().poll(now_ns)

    def _goes_on(self) -> bool:
        """Begin the next turn once it is due or an order waits; always True."""
        if self.now_ns >= self._next_ns or self.waits:
            self.begin({ONLY: self._drive.addressed(self._turn())})
        return True

    def _counted_halts(self) -> tuple[int, int]:
        """The words of the operator's newest stop and hold, which change with each."""
        return int(self._operator["stop_ns"]), int(self._operator["hold_ns"])

    # --- orders

    @property
    def waits(self) -> bool:
        """Whether there is an order that has not been taken yet."""
        return self._halting or int(self._asked["sequence"]) != self._taken

    def stop(self) -> None:
        """Stop the gripper as an order would: an operator has stopped the arm, or the control process is ending."""
        self._halting = True

    def _take(self) -> Order | None:
        """Take the newest order that has not been taken yet; None if there is none, or its angle is out of range.

        The cycle may write an order while one is read here. An order mixed of two is followed by the newer one at once.
        An angle that belongs to neither is out of range, or as harmless as any other.
        """
        if not self.waits:
            return None
        asked = self._asked
        if self._halting:  # the stop replaces earlier orders, and goes before later ones
            self._halting = False
            self._taken = max(self._taken, int(asked["halted"]))
            return Order(self._taken, Request.GRIP_STOP, 0.0, 0.0)
        order = Order(int(asked["sequence"]), int(asked["kind"]), float(asked["position_rad"]), float(asked["effort"]))
        self._taken = order.sequence
        if order.kind == Request.GRIP and not self._gripper.lower_rad <= order.angle_rad <= self._gripper.upper_rad:
            return None
        return order

    # --- a turn

    def _turn(self) -> Unaddressed[None]:
        order = None
        try:
            if not self._known:
                yield from self._drive.get_to_know()
                self._known = True
                self._recover(Grip.HELD)
            order = self._take()
            if order is not None:
                self._obeying = True
                yield from self._obey(order)
            self._obeying = False
            yield from self._look()
        except Trouble as trouble:
            self._obeying = False
            self._suffer(trouble)
            if order is None and not self._known:
                order = self._take()  # no drive can carry it out; a known drive gets it in the next turn
        if order is not None:
            self._shown["order"] = order.sequence
        rate_hz = MOVING_POLL_HZ if self.moves else RESTING_POLL_HZ
        self._next_ns = self.now_ns + (round(1e9 / rate_hz) if self._known else AFTER_TROUBLE_NS)
        self.show()

    def _suffer(self, trouble: Trouble) -> None:
        """Publish a trouble, and report it once; a motion under way is over."""
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

    def show(self) -> None:
        self._shown["written"] += 1
        self._shown["monotonic_ns"] = self.now_ns
        show_gripper(self._state, self._shown)

    # --- carrying out orders

    def _obey(self, order: Order) -> Unaddressed[None]:
        self._judge = None
        if order.kind == Request.GRIP_HOME:
            yield from self._home(order)
        elif order.kind == Request.GRIP_STOP:
            yield from self._drive.hold()
            self._recover(Grip.HELD)
        elif order.kind == Request.GRIP:
            yield from self._drive.make_able()  # implied by a motion command
            yield from self._drive.limit_effort(order.effort)
            yield from self._set_off(order.angle_rad)

    def _set_off(self, angle_rad: float) -> Unaddressed[None]:
        position_rad = yield from self._position_rad()
        self._require_inside(position_rad)
        if self.waits:
            return  # a newer order, which may be a stop, replaces a motion that has not begun
        yield from self._drive.go_to(angle_rad)
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

    def _home(self, order: Order) -> Unaddressed[None]:
        """Let the drive find its stop; a newer order ends the run."""
        self._recover(Grip.MOVING)
        self._shown["order"], self._shown["measured_ns"] = order.sequence, 0
        self._shown["target_rad"] = math.nan
        self.show()
        yield from self._drive.home()
        self._recover(Grip.REACHED)

    # --- reading the drive

    def _look(self) -> Unaddressed[None]:
        position_rad = yield from self._position_rad()
        heard_ns, trouble = self.now_ns, GripTrouble.NONE
        self._turns += 1
        if self._nm_per_ampere is not None and self._turns % 2 == 0:
            self._shown["measured_effort"] = yield from self._drive.measure_effort(self._nm_per_ampere)
        else:
            trouble = yield from self._drive.look(moves=self._judge is not None)
        self._require_inside(position_rad)
        since_s = (heard_ns - int(self._shown["measured_ns"])) * 1e-9
        known = int(self._shown["measured_ns"]) > 0
        self._shown["velocity_rad_s"] = (position_rad - self._shown["position_rad"]) / since_s if known else 0.0
        self._shown["position_rad"], self._shown["measured_ns"] = position_rad, heard_ns
        if trouble != GripTrouble.NONE:
            raise Trouble(trouble)  # its count is still an angle, so the position above is published
        if self._judge is not None:
            grip = self._judge.judge(heard_ns, position_rad)
            if grip == Grip.STALLED:
                yield from self._drive.hold()
            if grip != Grip.MOVING:
                self._judge = None
            self._shown["grip"] = grip
        elif int(self._shown["trouble"]) in _GOES_BY_ITSELF:
            self._recover(Grip.HELD)

    def _position_rad(self) -> Unaddressed[float]:
        """Read the gripper's angle; if it is not valid, read once more and return that."""
        position_rad = yield from self._drive.position_rad()
        if not self._is_inside(position_rad):
            position_rad = yield from self._drive.position_rad()
        return position_rad

    def _is_inside(self, position_rad: float) -> bool:
        return self._gripper.lower_rad - OUTSIDE_RAD <= position_rad <= self._gripper.upper_rad + OUTSIDE_RAD

    def _require_inside(self, position_rad: float) -> None:
        if not self._is_inside(position_rad):
            raise Trouble(GripTrouble.OUTSIDE, position_rad)


_GOES_BY_ITSELF = (
    GripTrouble.SILENT,
    GripTrouble.PROTECTED,
    GripTrouble.DISABLED,
    GripTrouble.POWER_LOST,
    GripTrouble.OUTSIDE,
)
"""Troubles that are over as soon as a turn finds nothing of them; the others remain until the next order."""
