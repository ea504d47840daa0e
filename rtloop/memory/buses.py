"""Which bus a drive is on."""

from compilation.jit import jit
from rtloop.memory.link import GRIPPER, Bus
from rtloop.memory.state import Loop


@jit
def bus_of(loop: Loop, joint: int) -> Bus:
    """The bus that the drive of a joint, or of GRIPPER, is on."""
    return loop.buses[loop.params.gripper_bus if joint == GRIPPER else loop.joints[joint].bus]


@jit
def round_of(loop: Loop, joint: int) -> int:
    """How often every drive on the joint's bus has had its turn, of which each cycle gives one."""
    return int(loop.timing.cycle // bus_of(loop, joint).joint_count)
