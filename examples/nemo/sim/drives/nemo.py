"""A Nemo N23 on CAN, from its frames to its shaft, by chapter 4 of its manual.

Not modelled: its switches, its lamps. [inf] marks what the manual does not say: how stiff its loops are.
"""

from __future__ import annotations

import struct

from config.drives.nemo import NemoDrive as NemoConfig
from sim.bus import Frame
from sim.drives.conversation import ServoDrive
from sim.drives.drive import Cause, Mounting
from sim.drives.servo import TURN_RAD, Cascade, Limp, Load

STEPS = 65_536.0
POSITION_GAIN_S, VELOCITY_BANDWIDTH_S = 20.0, 150.0
"""Of its loops [1/s] [inf]."""
TOP = 50.0
"""Its highest speed [rev/s]."""
ERRORS: dict[Cause, int] = {"temperature": 2, "current": 4, "stall": 4}


class NemoDrive(ServoDrive):
    """One motor: a node of the bus with a shaft; `address` is what its switches say."""

    def __init__(
        self,
        address: int = 1,
        *,
        start_ns: int = 0,
        turns: float = 0.0,
        counted: float | None = None,
        load: Load | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(start_ns=start_ns, turns=turns, counted=counted, load=load, seed=seed)
        self.switches = address
        self.errors = 0
        self.boot()

    @classmethod
    def mounted(cls, mounting: Mounting) -> NemoDrive:
        """The motor of a joint."""
        config = mounting.joint.drive
        assert isinstance(config, NemoConfig)
        turns = mounting.turns(mounting.position_rad)
        return cls(
            config.address,
            start_ns=mounting.start_ns,
            turns=turns,
            counted=turns,
            load=mounting.load,
            seed=mounting.seed,
        )

    def owns(self, frame: Frame) -> bool:
        """Whether it is for this drive or from it."""
        return not frame.extended and frame.can_id in (0x100 + self.switches, 0x180 + self.switches)

    def concerns(self, frame: Frame) -> bool:
        """Whether it is a request."""
        return self.owns(frame) and frame.can_id < 0x180 and not frame.remote and len(frame.data) == 8

    def take(self, frame: Frame) -> None:
        """Obey a request, and answer with the state."""
        function = frame.data[0]
        if function == 2 and self.enabled:
            speed, counts = struct.unpack_from("<hi", frame.data, 2)
            self._hold(counts / STEPS, speed / 100.0)
        elif function == 3 and not self.errors:
            self._hold(self.counted, 0.0)
        elif function == 4:
            self.release()
        elif function == 5 and not self.enabled and not self.cause_lasts:
            self.errors = 0
        if 1 <= function <= 5:
            self.reply(self._state(function))

    def boot(self) -> None:
        """Hold nothing; the encoder goes on counting without power."""
        self.errors = self.errors if self.cause_lasts else 0
        self.release()

    def release(self) -> None:
        """Let the shaft go."""
        self.enabled = False
        self.shaft.obey(Limp())

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Let the shaft go because of an error."""
        self.advance(now_ns)
        self.errors |= ERRORS[cause]
        self.release()

    def state_frame(self, now_ns: int) -> Frame:
        """The state it would tell at `now_ns`."""
        self.advance(now_ns)
        return self._state(1)

    def twin(self, now_ns: int, seed: int) -> NemoDrive:
        """Another motor with its address."""
        return NemoDrive(self.switches, start_ns=now_ns, seed=seed)

    def _hold(self, counted: float, speed: float) -> None:
        law = self.shaft.law
        if not isinstance(law, Cascade):
            stiffness = VELOCITY_BANDWIDTH_S * self.shaft.load.inertia_kg_m2 * TURN_RAD
            law = Cascade(0.0, POSITION_GAIN_S, stiffness, TOP)
        law.target, law.speed_ahead = self.origin + counted, speed
        self.enabled = True
        self.shaft.obey(law)

    def _state(self, function: int) -> Frame:
        flags, quarters = self.errors | self.enabled, round(self.supply_v * 4.0)
        counts = round(self.counted * STEPS)
        data = struct.pack("<BBbBi", function, flags, round(self.celsius), quarters, counts)
        return Frame(0x180 + self.switches, data, extended=False)
