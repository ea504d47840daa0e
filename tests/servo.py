"""What senders of a stream do: MoveIt Servo's sliding window, and points sent one by one."""

import numpy as np
from random_ways import Way, waves_from
from virtual import VirtualArm

LATENCY_NS = 100_000_000
"""Servo's `max_expected_latency`: every entry is for this much later than it was made; older ones are dropped."""


def waves(arm: VirtualArm, share: float, seed: int) -> Way:
    """`waves_from` where an arm is commanded to be."""
    here = arm.loop[0]["axes"]["commanded"]["position_rad"][: len(arm.arm.joints)].copy()
    return waves_from(arm.arm.joints, here, share, seed)


class Servo:
    """MoveIt Servo: windows of the last entries, stamped with the oldest, the newest one withheld."""

    def __init__(self, arm: VirtualArm, way: Way, rate_hz: float) -> None:
        self.arm, self.way = arm, way
        self.period_ns = round(1e9 / rate_hz)
        self.begun_ns = self.due_ns = arm.now_ns
        self.entries: list[tuple[int, np.ndarray]] = []
        self.sent = 0

    def run(self, seconds: float) -> None:
        """Send at the rate while the arm runs its cycles."""
        until_ns = self.arm.now_ns + round(seconds * 1e9)
        while self.arm.now_ns < until_ns:
            self.turn()
            self.arm.cycle()

    def turn(self) -> None:
        """Send what is due before the arm's next cycle."""
        while self.due_ns <= self.arm.now_ns:
            self.make(self.due_ns)
            self.due_ns += self.period_ns

    def make(self, now_ns: int) -> None:
        """One turn of Servo's loop."""
        position, velocity = self.way((now_ns - self.begun_ns) * 1e-9)
        rows = np.stack([position, velocity, np.zeros_like(position)], axis=1)
        self.entries.append((now_ns + LATENCY_NS, rows))
        self.entries = [entry for entry in self.entries if entry[0] >= now_ns - LATENCY_NS]
        if len(self.entries) > 2:
            self.send([entry[0] for entry in self.entries[:-1]], [entry[1] for entry in self.entries[:-1]])

    def send(self, stamps_ns: list[int], rows: list[np.ndarray]) -> None:
        stamps = np.array(stamps_ns)
        first = max(int(np.searchsorted(stamps, self.arm.now_ns, side="right")) - 1, 0)  # the front leaves out the past
        self.sent += 1
        self.hand_on(stamps[first:] - stamps[0], np.array(rows[first:]), int(stamps[0]))

    def hand_on(self, times_ns: np.ndarray, rows: np.ndarray, start_ns: int) -> None:
        """Give the control process a message as it is; `start_ns` is 0 where it has no stamp."""
        self.arm.send_goal(times_ns, rows, order=3, stream=True, approach=start_ns == 0, start_ns=start_ns)


class SinglePoints(Servo):
    """A sender that knows no time: one point, to be reached a period from now."""

    def __init__(self, arm: VirtualArm, way: Way, rate_hz: float, *, velocities: bool) -> None:
        super().__init__(arm, way, rate_hz)
        self.velocities = velocities

    def make(self, now_ns: int) -> None:
        """One turn of the sender's loop."""
        position, velocity = self.way((now_ns - self.begun_ns + self.period_ns) * 1e-9)
        rows = np.stack([position, velocity * self.velocities, np.zeros_like(position)], axis=1)
        self.sent += 1
        self.hand_on(np.array([self.period_ns]), rows[None], 0)
