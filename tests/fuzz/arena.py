"""The arms that compiled targets attack, and what becomes of a case that is guilty."""

import numpy as np
from virtual import VirtualArm, recorded_goal

from config.loader import load_arm
from fuzz import memory, wire

OPENINGS = {
    "seeedstudio": bytes.fromhex("AA 55 12 03 02 00000000 00000000 00 00 00000000 17"),
    "ch340-at": b"AT+AT\r\n",
}
"""What puts a simulated adapter on the arm's bus (facts/can-adapters.md)."""


class MemoryArena:
    """The mock arm, whose command file anybody may write to."""

    GUILT = memory.GUILT

    def __init__(self) -> None:
        self.arm = VirtualArm("mock")
        self._begin()

    def _begin(self) -> None:
        assert self.arm.bring_up().failure is None
        self.arm.memory["buses"][0]["outgoing"]["length"] = 0
        self._fresh = self.arm.loop.copy()
        self.seen = np.zeros((4, 64), np.int64)
        """Modes, faults, outcomes and answers that came up."""
        self.verdict = np.zeros(8)
        self.faults = np.zeros(64, np.int64)
        """Cases by the fault they ended with."""

    def many(self, seed: int, first: int, count: int) -> int:
        """Run cases up to the first guilty one; how many were judged."""
        loop, shared = self.arm.loop[0], self.arm.state.array[0]
        fresh = self._fresh.ctypes.data
        return memory.run_cases(loop, shared, fresh, seed, first, count, self.seen, self.verdict, self.faults)

    def one(self, seed: int, case: int) -> int:
        """Run one case; what it is guilty of."""
        loop, shared = self.arm.loop[0], self.arm.state.array[0]
        return memory.run_case(loop, shared, self._fresh.ctypes.data, seed, case, self.seen, self.verdict)

    def run(self, seed: int, first: int, count: int) -> tuple[int, str]:
        """Cases judged up to the first guilty one, and what that is guilty of; "" when none is."""
        self.verdict[:] = -1.0
        done = self.many(seed, first, count)
        if (self.verdict == -1.0).all():
            return done, ""
        guilt = self.one(seed, first + done - 1)
        joint, p, v, a, cycle, how, fault = self.verdict[:7]
        row = self.arm.loop[0]["joints"][max(int(joint), 0)]
        return done, (
            f"{self.GUILT[guilt]}: joint {int(joint)} at {p:.6g} rad ({row['lower_rad']:.6g} to "
            f"{row['upper_rad']:.6g}), {v:.6g} of {row['max_velocity_rad_s']:.6g} rad/s, {a:.6g} of "
            f"{row['max_acceleration_rad_s2']:.6g} rad/s², in cycle {int(cycle)}, writer {int(how)}, fault {int(fault)}"
        )

    def close(self) -> None:
        self.arm.close()


class WireArena(MemoryArena):
    """The arm of six drives on a serial adapter, whose bytes anybody may send."""

    GUILT = wire.GUILT

    def __init__(self, rate_hz: float = 120.0, interface: str = "slcan") -> None:
        bitrate = 1_000_000 if interface == "ch340-at" else 500_000
        bus = {"interface": interface, "bitrate": bitrate}
        arm = load_arm("episode1", overrides={"control": {"rate_hz": rate_hz}, "bus": bus})
        start_rad = recorded_goal("small")["joints"][0, :, 0]
        self.arm = VirtualArm(arm, start_rad=start_rad, opening=OPENINGS.get(interface))
        self._out = np.zeros(wire.MOST_BYTES, np.uint8)
        self._begin()

    def many(self, seed: int, first: int, count: int) -> int:
        """Run cases up to the first guilty one; how many were judged."""
        loop, shared, fresh = self.arm.loop[0], self.arm.state.array[0], self._fresh.ctypes.data
        return wire.run_cases(loop, shared, fresh, seed, first, count, self.seen, self.verdict, self.faults, self._out)

    def one(self, seed: int, case: int) -> int:
        """Run one case; what it is guilty of."""
        loop, shared, fresh = self.arm.loop[0], self.arm.state.array[0], self._fresh.ctypes.data
        return wire.run_case(loop, shared, fresh, seed, case, self.seen, self.verdict, self._out)
