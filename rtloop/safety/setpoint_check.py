"""The last line of defence: what is about to be commanded, against the limits.

A next setpoint that breaks a limit is never sent: the fault is latched first and the arm brakes from the last good one.
"""

import math

from compilation.jit import jit
from motion import limits
from rtloop.memory.axis import Commanded
from rtloop.memory.state import Loop
from rtloop.memory.updates import owe_stop
from rtloop.safety.faults import latch_fault, stop_each_joint
from rtloop.trajectory.limits import BESIDE_RAD, band, first_broken, hardest_rad_s2, highest_rad_s, stop_rad
from shm.layout import StateFile
from shm.words import Fault


@jit
def check_next_setpoint(loop: Loop, shared: StateFile) -> bool:
    """Whether every joint's next setpoint is finite and inside its limits; latches the first that is not.

    Velocity and acceleration are differences of the positions themselves, not of what the sampler claims. A setpoint
    from which the joint could not be stopped inside its position limits any more, with all the acceleration that may
    be commanded, breaks them too: whatever followed would.
    """
    params = loop.params
    period_s = params.period_ns * 1e-9
    for joint in range(params.joint_count):
        row, axis = loop.joints[joint], loop.axes[joint]
        commanded = axis.commanded
        p = commanded.next_position_rad
        if not math.isfinite(setpoint_sum(commanded)):
            latch_fault(loop, shared, Fault.NOT_FINITE, joint, setpoint_sum(commanded), 0.0)
            return False
        velocity = (p - commanded.position_rad) / period_s
        acceleration = (velocity - commanded.difference_velocity_rad_s) / period_s
        max_velocity, max_acceleration = highest_rad_s(loop, joint), hardest_rad_s2(loop, joint)
        low, high = band(row.lower_rad, row.upper_rad, row.slack_rad)
        broken = first_broken(
            p,
            velocity,
            acceleration,
            min(low, commanded.position_rad),  # a joint that was found outside may move in
            max(high, commanded.position_rad),
            max_velocity,
            # one step of a position in double precision, differenced twice, is not an acceleration
            max_acceleration + 1e-15 / (period_s * period_s),
        )
        if broken == limits.POSITION:
            latch_fault(loop, shared, Fault.POSITION_LIMIT, joint, p, low if p < low else high)
            return False
        stop = stop_rad(loop, joint, p, velocity)
        if (velocity > 0.0 and stop > high + BESIDE_RAD) or (velocity < 0.0 and stop < low - BESIDE_RAD):
            latch_fault(loop, shared, Fault.POSITION_LIMIT, joint, stop, low if velocity < 0.0 else high)
            return False
        if broken == limits.VELOCITY:
            latch_fault(loop, shared, Fault.VELOCITY_LIMIT, joint, velocity, max_velocity)
            return False
        if broken == limits.ACCELERATION:
            latch_fault(loop, shared, Fault.ACCELERATION_LIMIT, joint, acceleration, max_acceleration)
            return False
    return True


@jit
def setpoint_sum(commanded: Commanded) -> float:
    """Finite only where all of the next setpoint is, since no sum with what is not finite is."""
    return float(commanded.next_position_rad + commanded.next_velocity_rad_s + commanded.next_acceleration_rad_s2)


@jit
def may_be_sent(loop: Loop, shared: StateFile, joint: int, position: float, velocity: float = 0.0) -> bool:
    """The last check before a family makes a frame of what leads its drive, in whatever unit.

    What makes that of a setpoint (errors, ramps, bounds) comes after `check_next_setpoint`, and most frames hold whole
    numbers, none of which means "no number". An infinite setpoint that a bound has made finite is refused too. The
    joint is commanded to stop then, whatever fault is latched already, and the others brake by themselves.
    """
    axis = loop.axes[joint]
    total = setpoint_sum(axis.commanded) + position + velocity
    if math.isfinite(total):
        return True
    latch_fault(loop, shared, Fault.NOT_FINITE, joint, total, 0.0)
    stop_each_joint(loop)
    owe_stop(axis)
    return False
