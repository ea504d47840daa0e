"""The hostile writer again, with the simulated drives behind the cycle: true motion and true bytes are judged."""

from contextlib import closing

import numpy as np
from observer import command_violations, frames_sent, motion_violations, truth_of
from virtual import VirtualArm

from fuzz import memory

CYCLES = 150
AFTERWARDS = 60
"""Cycles in which nothing is written any more, so that what moves comes to rest."""


class Truth:
    """One target: a case is an arm brought up, attacked for more than a second of its time, and looked at."""

    def __init__(self) -> None:
        self.accepted = self.executed = 0

    def case(self, random: np.random.Generator) -> None:
        """Attack the command file of a simulated arm; raises when a drive or a byte left the limits."""
        with closing(VirtualArm.at_start_of("large", seed=int(random.integers(2**31)))) as arm:
            begun_ns, box, goal = arm.now_ns, np.zeros(1), 1
            how = int(random.integers(3))
            memory.reseed(int(random.integers(2**31)))
            arm.play("large", tolerances=(0.0, 0.0, 0.0))
            for cycle in range(CYCLES):
                if cycle > 20:
                    goal = memory.write_hostile(arm.loop[0], arm.command.address, how, goal, box)
                arm.cycle()
                if arm.memory["dialogue"]["bring_up_asked"]:
                    arm.memory["dialogue"]["bring_up_asked"] = 0
                    arm.bring_up(clears_protection=True)
            arm.writer.stop()
            arm.cycles(AFTERWARDS)
            found = motion_violations(arm.arm, truth_of(arm.sim), begun_ns, arm.now_ns)
            found += command_violations(arm.arm, frames_sent(arm.sent))
            assert not found, found
            self.executed += 1

    def close(self) -> None:
        """Nothing is open."""
