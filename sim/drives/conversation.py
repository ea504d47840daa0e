"""What all drives have in common on the bus, so that a family's file is its protocol and little else.

A family derives from `ServoDrive` and writes: `concerns` (whether a frame is for it), `take` (such a frame that ended),
`boot` (what it is like after power comes), `release` (let the shaft go), `owns`, `state_frame`, `twin` and `protect`.
It sends with `reply` (an answer, after its reply delay) and `say` (now), and does things later or again and again with
`after` and `every`. A family whose shaft is another one derives from `BusDrive`.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable

from sim.bus import Frame, Outbox
from sim.drives.drive import Cause, Drive
from sim.drives.ramp import NEVER
from sim.drives.servo import Led, Limp, Load, Servo

REPLY_DELAY_NS = (100_000, 300_000)
"""Least and greatest time from a request to its answer [inf]; drives answer from an interrupt or a loop of a kilohertz
or more."""
MAILBOXES = 16
"""Frames that wait for the bus at most; what a drive wants to say then is lost [inf]."""


class BusDrive(ABC):
    """A node of the bus; what its shaft is, a class that derives from it says.

    Args:
        start_ns: when it begins to exist; the first time it may be told.
        seed: of the jitter of its answers.

    Attributes:
        outbox, listening, address, wake_ns: what the bus asks; see `sim.bus.Node`.
        reply_delay_ns, reply_loss, cause_lasts, powered, connected, enabled: see `sim.drives.drive.Drive`.
    """

    def __init__(self, *, start_ns: int, seed: int = 0) -> None:
        self.outbox: Outbox = deque()
        self.wake_ns = NEVER
        self.listening = True
        self.address: int | None = None
        self.reply_delay_ns = REPLY_DELAY_NS
        self.reply_loss = 0.0
        self.cause_lasts = False
        self.powered = self.connected = True
        self.enabled = False
        self._now_ns = start_ns
        self._replied_ns = start_ns
        self._random = random.Random(seed)
        self._timers: dict[str, tuple[int, Callable[[], None]]] = {}

    # -- what a family says of itself ----------------------------------------------------------------

    @abstractmethod
    def concerns(self, frame: Frame) -> bool:
        """Whether a frame may be for this drive; it lives on unmoved by all others that come by."""

    @abstractmethod
    def take(self, frame: Frame) -> None:
        """Obey a frame that concerns it."""

    @abstractmethod
    def boot(self) -> None:
        """Forget what is volatile and begin, with a shaft that nobody holds, as after power comes."""

    @abstractmethod
    def advance(self, now_ns: int) -> None:
        """Live up to `now_ns`; a time already lived changes nothing."""

    @abstractmethod
    def loosen(self) -> None:
        """Hold the shaft no more: there is no power."""

    @abstractmethod
    def release(self) -> None:
        """Let the shaft go because somebody other than the host wants that."""

    @abstractmethod
    def owns(self, frame: Frame) -> bool:
        """Whether the frame is of its conversation with the host."""

    @abstractmethod
    def state_frame(self, now_ns: int) -> Frame:
        """A frame with its position, as it would say it at `now_ns`."""

    @abstractmethod
    def twin(self, now_ns: int, seed: int) -> Drive:
        """Another drive with the same place on the bus, from `now_ns` on, which counts from zero."""

    @abstractmethod
    def protect(self, now_ns: int, cause: Cause) -> None:
        """Trip the protection, which lets the shaft go."""

    # -- what a family uses --------------------------------------------------------------------------

    def reply(self, frame: Frame) -> None:
        """Send an answer after the reply delay; answers keep their order."""
        least, greatest = self.reply_delay_ns
        self.say(frame, self._now_ns + least + int((greatest - least) * self._random.random()))

    def say(self, frame: Frame, ready_ns: int | None = None) -> None:
        """Send a frame at a time, by default now, behind those that wait already."""
        if not self.connected or (self.reply_loss and self._random.random() < self.reply_loss):
            return
        if len(self.outbox) >= MAILBOXES:
            return
        self._replied_ns = max(self._now_ns if ready_ns is None else ready_ns, self._replied_ns)
        self.outbox.append((self._replied_ns, frame))

    def after(self, name: str, delay_ns: int, action: Callable[[], None]) -> None:
        """Do something once; what was to be done under that name is forgotten."""
        self._timers[name] = (self._now_ns + delay_ns, action)
        self._schedule()

    def every(self, name: str, period_ns: int, action: Callable[[], None]) -> None:
        """Do something again and again, beginning at a random moment of the first period; a period of 0 ends that."""
        self.cancel(name)
        if period_ns <= 0:
            return
        due_ns = self._now_ns + int(period_ns * self._random.random())

        def again() -> None:
            nonlocal due_ns
            due_ns += period_ns
            self._timers[name] = (due_ns, again)
            action()

        self._timers[name] = (due_ns, again)
        self._schedule()

    def cancel(self, name: str) -> None:
        """Do not do what was to be done under that name."""
        self._timers.pop(name, None)
        self._schedule()

    # -- the bus's side ------------------------------------------------------------------------------

    def receive(self, now_ns: int, frame: Frame) -> None:
        """Take a frame that ended at `now_ns` from the bus."""
        if self.concerns(frame):
            self.advance(now_ns)
            self.take(frame)

    def sent(self, now_ns: int, frame: Frame) -> None:  # noqa: B027 (nothing that a family must say more about)
        """Nothing to do: what left is forgotten."""

    def wake(self, now_ns: int) -> None:
        """Do what is due at `now_ns`."""
        self.advance(now_ns)
        for name, (due_ns, action) in list(self._timers.items()):
            if due_ns <= now_ns and self._timers.get(name) == (due_ns, action):
                del self._timers[name]
                action()
        self._schedule()

    def _schedule(self) -> None:
        self.wake_ns = min((due_ns for due_ns, _ in self._timers.values()), default=NEVER)

    # -- what goes wrong -----------------------------------------------------------------------------

    def power_off(self, now_ns: int) -> None:
        """Lose the supply: silence, and a loose shaft."""
        self.advance(now_ns)
        self.powered = self.listening = self.enabled = False
        self.outbox.clear()
        self._timers.clear()
        self.loosen()
        self._schedule()

    def power_on(self, now_ns: int) -> None:
        """Boot."""
        self.advance(now_ns)
        self.powered = True
        self.listening = self.connected
        self.boot()

    def unplug(self, now_ns: int) -> None:
        """Lose the CAN cable: it hears nothing, says nothing, and goes on with what it was told."""
        self.advance(now_ns)
        self.connected = self.listening = False
        self.outbox.clear()

    def plug_in(self, now_ns: int) -> None:
        """Get the CAN cable back."""
        self.advance(now_ns)
        self.connected = True
        self.listening = self.powered

    def disable(self, now_ns: int) -> None:
        """Be let go by somebody, not over the bus."""
        self.advance(now_ns)
        self.release()


class ServoDrive(BusDrive):
    """A node of the bus with a servo's shaft.

    Args:
        start_ns, seed: see `BusDrive`.
        turns: where its shaft stands [rev], as the arm sees it.
        counted: what it counts there [rev]; None: what the arm sees.
        load: what it moves.

    Attributes:
        shaft: its true motion [rev].
        origin: where the shaft stands when it counts 0 [rev].
        celsius: temperature of its motor; settable.
        supply_v: voltage of its supply; settable.
        arms_itself: whether it holds its shaft as soon as it has power, in families whose drives want a command for it.
        the others: see `BusDrive`.
    """

    def __init__(
        self, *, start_ns: int, turns: float, counted: float | None = None, load: Load | None = None, seed: int = 0
    ) -> None:
        super().__init__(start_ns=start_ns, seed=seed)
        self.celsius = 30.0
        self.supply_v = 24.0
        self.arms_itself = False
        self.shaft = Servo(start_ns, turns, load)
        self.origin = 0.0 if counted is None else turns - counted

    @property
    def counted(self) -> float:
        """What it counts now [rev]."""
        return self.shaft.position_at(self._now_ns) - self.origin

    def advance(self, now_ns: int) -> None:
        """Live up to `now_ns`; a time already lived changes nothing."""
        if now_ns > self._now_ns:
            self._now_ns = now_ns
            self.shaft.advance(now_ns)

    def loosen(self) -> None:
        """Coast."""
        self.shaft.obey(Limp())

    @property
    def limp(self) -> bool:
        """Whether nothing but friction holds its shaft."""
        return isinstance(self.shaft.law, Limp)

    def lead(self, now_ns: int, turns_s: float) -> None:
        """Have its limp shaft turned by a hand [rev/s]."""
        self.advance(now_ns)
        self.shaft.obey(Led(turns_s))

    def block_shaft(self, now_ns: int) -> None:
        """Hold the shaft where it is from `now_ns` on."""
        self.advance(now_ns)
        self.shaft.block(now_ns)
