"""An arm on vcan0 that an emulated processor can carry: the simulated drives are Python."""

from collections.abc import Callable
from typing import Any

from arm_files import edited
from memory_front import MemoryFront
from stack import Stack

from config.loader import load_arm
from config.schema import ArmConfig
from shm.words import Answer, Mode, Request

RATE_HZ = 20
JOINTS = 3


PATIENCE_S = 120.0


class RunningArm(MemoryFront):
    """A running arm whose front is this process; `start` starts its simulated drives."""

    def __init__(self, stack: Stack, start: Callable[[Stack], object]) -> None:
        self.stack = stack
        try:
            start(stack)
            self.loop = stack.start_loop()
        except BaseException:
            stack.close()
            raise
        super().__init__(stack.arm_file, PATIENCE_S)

    def close(self) -> None:
        super().close()
        self.stack.close()

    def under_way(self, goal: int) -> None:
        """Wait until a goal has run for a second."""
        self.until(lambda now: bool(now["goal_id"] == goal and now["trajectory_clock_ns"] > 1e9))

    def clear(self) -> None:
        assert self.answer(Request.CLEAR_FAULT) == Answer.DONE
        self.until(lambda now: bool(now["mode"] == Mode.HOLDING))


def slowed(values: dict[str, Any], joints: int) -> None:
    """Rewrite an arm file for fewer joints and cycles, and for drives that answer late."""
    values["control"]["rate_hz"] = RATE_HZ
    values["joints"] = values["joints"][:joints]
    for of_six_joints in ("kinematics", "homing"):
        values.pop(of_six_joints, None)
    values.setdefault("limits", {}).update(stale_brake_s=0.4, stale_fault_s=2.0, front_timeout_s=10.0)


def start_on_vcan(stack: Stack) -> ArmConfig:
    """Rewrite a stack's arm file for vcan0 and start its simulated drives there; the arm's configuration."""
    with edited(stack.arm_file) as values:
        values["bus"] = {"interface": "socketcan", "channel": "vcan0", "bitrate": 500_000}
        slowed(values, JOINTS)
    stack.place = ("--can", "vcan0")
    stack.start_sim()
    return load_arm(stack.arm_file)
