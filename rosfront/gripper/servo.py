"""The servo on the arm's bus, which the control process drives: requests go there, its published record comes back."""

from __future__ import annotations

import math
import time

import numpy as np

from motion.gripping import Grip
from rosfront.gripper.hook import GripperTrouble, NotThereYet, Reading
from rosfront.plan import NS
from rosfront.refusals import NotServing
from rosfront.serving import Serving
from sentences.told import grip_trouble_sentence
from shm.words import GripTrouble, Request

TAKEN_WITHIN_S = 3.0
"""Time for a command to reach the drive; the control process asks a silent drive for a second or two."""
SHOWN_WITHIN_S = 3.0
NOT_YET = "The gripper has not been looked at yet: wait for the drives to be brought up."


class ServoGripper:
    """The gripper's drive, through the control process, which judges stalls and stops the push even without us."""

    def __init__(self, serving: Serving) -> None:
        self._serving = serving
        self._order = 0
        self._asked_s = 0.0
        self._refusal = ""

    def move(self, position_rad: float, max_effort: float) -> None:
        """One command; the drive plans its own ramp."""
        self._ask(Request.GRIP, position_rad, max_effort)

    def stop(self) -> None:
        """Stop; the gripper then holds where it is."""
        self._ask(Request.GRIP_STOP)

    def home(self) -> None:
        """Begin the drive's own homing run to its stop."""
        self._ask(Request.GRIP_HOME)

    def read(self) -> Reading:
        """What the control process publishes about the gripper."""
        refusal, self._refusal = self._refusal, ""
        if refusal:
            self._order = 0
            raise GripperTrouble(refusal)
        try:
            shown = self._serving.gripper()
        except NotServing as reason:
            self._order = 0  # a new control process counts anew
            raise NotThereYet(reason.sentence) from reason
        if shown is None:
            raise NotThereYet(NOT_YET)
        age_s = (time.monotonic_ns() - int(shown["monotonic_ns"])) / NS
        if age_s > SHOWN_WITHIN_S:
            raise GripperTrouble(
                f"The control process has shown nothing of the gripper for {age_s:.1f} s: see `rtarm status`."
            )
        return self._reading(shown)

    def close(self) -> None:
        """Nothing to do: the control process goes on holding the gripper."""

    def _ask(self, kind: Request, value: float = 0.0, effort: float = 0.0) -> None:
        self._refusal = ""
        self._asked_s = time.monotonic()
        self._order = self._serving.request(kind, self._answered, value=value, effort=effort)

    def _answered(self, done: bool, sentence: str) -> None:
        """Called by `Serving.request`, usually in another thread."""
        if not done:
            self._refusal = sentence

    def _reading(self, shown: np.ndarray) -> Reading:
        trouble = ""
        grip = Grip(int(shown["grip"]))
        if int(shown["order"]) < self._order:
            if time.monotonic() - self._asked_s > TAKEN_WITHIN_S:
                self._order = 0
                raise GripperTrouble("The control process has not passed the command on to the gripper: try again.")
            grip = Grip.MOVING
        elif int(shown["trouble"]) != GripTrouble.NONE:
            grip = Grip.TROUBLE
            trouble = grip_trouble_sentence(int(shown["trouble"]), float(shown["trouble_value"]))
        measured_ns = int(shown["measured_ns"])
        if measured_ns == 0:
            if grip != Grip.MOVING:
                raise GripperTrouble(trouble or NOT_YET)
            return Reading(math.nan, grip=grip)
        return Reading(
            float(shown["position_rad"]),
            float(shown["velocity_rad_s"]),
            float(shown["measured_effort"]),
            grip,
            trouble,
            measured_ns,
        )
