"""A joint that its control process leads alone, in virtual time, supervised as `rtarm.led.process` finds it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from virtual import VirtualArm

from config.schema import ArmConfig
from rtarm.led.joint import Led
from rtloop.dialogues.referencing import Referencing, referencing_asked_for
from rtloop.dialogues.release import Release
from rtloop.service.conversation import Conversation
from sim.arm import SimulatedArm


class LedArm(VirtualArm):
    """Such a process, which has brought its joint up, and `led`, by which it is asked for something."""

    def __init__(
        self,
        arm: ArmConfig,
        start_rad: Sequence[float],
        really: ArmConfig | None = None,
        homed: bool = False,
    ) -> None:
        """`really` is what the drive is, where the arm file says something else."""
        super().__init__(really or arm, start_rad=list(start_rad), homed=homed)
        there = self.sim
        if really is not None:
            self.close()
            super().__init__(arm)
            self.sim = there
        self._talk: Conversation | None = None
        self._stands_still = False
        assert self.sim is not None
        self.drive: Any = self.sim.drives[0]

    def supervise(self) -> None:
        """Bring the joint up, and do what it is asked for from then on."""
        self.cycles(round(0.6e9 / self.period_ns))
        assert self.bring_up().failure is None, self.told
        self.led = Led(
            self.arm,
            self.reader,
            self.writer,
            pass_time=self.pass_time,
            now_ns=lambda: self.now_ns,
            standing_still=self.standing_still,
        )

    def pass_time(self) -> None:
        if self._stands_still:
            self.now_ns += self.period_ns
            self.listen(self.now_ns)
            return
        self.cycle()
        dialogue = self.memory["dialogue"]
        if self._talk is not None:
            if dialogue["referencing_ends"] and isinstance(self._talk, Referencing):
                self._talk.end()
            self._talk = None if self._talk.poll(self.now_ns) else self._talk
        elif dialogue["bring_up_asked"]:
            dialogue["bring_up_asked"] = 0
            self._talk = self._begin_bring_up(clears_protection=True)
        elif dialogue["release_asked"]:
            dialogue["release_asked"] = 0
            self.held_rad.clear()
            self._talk = Release(self.arm, self.port, now_ns=self.now_ns)
        elif dialogue["home_asked"] or dialogue["reference_asked"]:
            self._talk = referencing_asked_for(
                self.arm, self.loop, self.port, self.now_ns, self.told.append, self.lost.__setitem__, self.marks
            )

    @contextmanager
    def standing_still(self) -> Iterator[None]:
        self._stands_still = True
        yield
        self._stands_still = False

    def true_deg(self) -> float:
        """Where the joint truly is."""
        there: SimulatedArm | None = self.sim
        assert there is not None
        there.run_until(max(self.now_ns, there.now_ns))
        return math.degrees(there.true_position_rad(0, self.now_ns))
