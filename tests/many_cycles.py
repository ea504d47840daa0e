"""Many cycles in one compiled call, for tests and benchmarks that want the interpreter out of the way.

The planned time advances by one period a cycle, the front's heartbeat with it, and the bytes of a cycle are
dropped as if the wire had taken them.
"""

from typing import Any

import numpy as np
from virtual import VirtualArm

from rtloop.cycle import step
from rtloop.state import offset_of
from shm import layout
from shm.atomics import store_relaxed
from shm.jit import jit

HEARTBEAT = offset_of(layout.COMMAND, "heartbeat_ns")


@jit
def run_cycles(loop: Any, shared: Any, start_ns: int, count: int, heartbeat: int) -> int:
    """Run `count` cycles after start_ns; the planned time of the last one."""
    now_ns = start_ns
    for _ in range(count):
        now_ns += loop.params.period_ns
        store_relaxed(heartbeat, now_ns)
        step(loop, shared, now_ns)
        loop.core.tx_length = 0
    return now_ns


def advance(arm: VirtualArm, count: int) -> None:
    """Let an arm in virtual time run `count` cycles without the interpreter in between."""
    arm.now_ns = run_cycles(arm.loop[0], arm.state.array[0], arm.now_ns, count, arm.command.address + HEARTBEAT)


def swing(arm: VirtualArm, duration_s: float, spacing_s: float = 0.1) -> int:
    """Start a long, gentle to and fro of all joints; its goal, running with all its knots taken."""
    times = np.arange(0.0, duration_s + spacing_s, spacing_s)
    w = 2 * np.pi / 4.0
    shape = np.stack([1 - np.cos(w * times), w * np.sin(w * times), w * w * np.cos(w * times)], axis=-1)
    joints = 0.05 * shape[:, None, :] * np.ones((1, len(arm.arm.joints), 1))
    joints[:, :, 0] += arm.loop[0]["axes"]["next_position_rad"][: len(arm.arm.joints)]
    goal = arm.send_goal((times * 1e9).astype(int), joints, tolerances=(0.0, 0.0, 0.0))
    arm.until(lambda: not arm.pending and arm.core["goal_id"] == goal)
    arm.until(lambda: arm.loop[0]["paths"][int(arm.core["active"])]["taken"] == len(times))
    return goal
