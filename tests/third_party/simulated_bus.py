"""Buses of python-can with simulated drives on them, for libraries that other people wrote for the real ones.

`LockstepBus` has virtual time: it passes only while somebody waits in `recv`, and then at once. A library whose every
call sends and waits (as most do) is therefore exact, quick and the same each time, whatever the machine does. What
waits by other means (a thread that listens, `time.sleep`) needs `live_bus`: real time, on python-can's `virtual`.
"""

import contextlib
import time
from collections.abc import Iterator
from itertools import count

import can
from served_arm import serving

from config.schema import ArmConfig
from sim.arm import SimulatedArm
from sim.can_interface import RECORD, packed, unpacked
from sim.python_can_host import PythonCanServer, frame_of, message_of

START_NS = 1_000_000_000
LONGEST_WAIT_S = 60.0
"""Of virtual time, where a caller would wait for ever."""

_channels = count()


class LockstepBus(can.BusABC):
    """A bus on which only the caller and an arm's simulated drives are; each received message carries virtual time.

    Args:
        arm: of interface python-can and with `start_ns=START_NS`.

    Attributes:
        arm: the simulated arm.
        now_ns: virtual time.
        log: every frame that was on the bus, as ("out" or "in", message).
    """

    def __init__(self, arm: SimulatedArm) -> None:
        self.arm = arm
        self.now_ns = arm.now_ns
        self.log: list[tuple[str, can.Message]] = []
        self.channel_info = f"simulated drives of {arm.config.name}"
        self._waiting: list[can.Message] = []
        super().__init__(channel=arm.config.name)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        frame = frame_of(msg)
        assert frame is not None, f"{msg} is no classic frame"
        self.log.append(("out", msg))
        self.arm.feed(self.now_ns, packed(frame))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        until_ns = self.now_ns + round((LONGEST_WAIT_S if timeout is None else timeout) * 1e9)
        while not self._waiting and self.now_ns < until_ns:
            due_ns = self.arm.next_due_ns()
            self.now_ns = until_ns if due_ns is None else min(max(due_ns, self.now_ns), until_ns)
            self._hear()
        if not self._waiting:
            if timeout is None:
                raise can.CanTimeoutError(f"nothing came within {LONGEST_WAIT_S} virtual seconds")
            return None, False
        return self._waiting.pop(0), False

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """As any bus; python-can's own `recv` would count the timeout on the machine's clock."""
        message, _ = self._recv_internal(timeout)
        return message

    def wait(self, duration_s: float) -> None:
        """Let virtual time pass; what comes meanwhile can be received afterwards."""
        self.now_ns += round(duration_s * 1e9)
        self._hear()

    def _hear(self) -> None:
        data = self.arm.collect(self.now_ns)
        for at in range(0, len(data), RECORD.size):
            message = message_of(unpacked(data[at : at + RECORD.size]))
            message.timestamp = self.now_ns * 1e-9
            self.log.append(("in", message))
            self._waiting.append(message)


@contextlib.contextmanager
def lockstep_bus(config: ArmConfig, **options: object) -> Iterator[LockstepBus]:
    """A bus in virtual time with an arm's simulated drives; `options` are those of `sim.arm.SimulatedArm`."""
    bus = LockstepBus(SimulatedArm(config, start_ns=START_NS, **options))
    yield bus
    bus.shutdown()


@contextlib.contextmanager
def live_bus(config: ArmConfig, **options: object) -> Iterator[can.BusABC]:
    """A bus in real time with an arm's simulated drives; its `channel_id` opens further nodes (interface virtual)."""
    channel = f"simulated drives {next(_channels)}"
    with (
        can.Bus(channel, "virtual", ignore_config=True) as ours,
        can.Bus(channel, "virtual", ignore_config=True) as theirs,
        serving(PythonCanServer(SimulatedArm(config, start_ns=time.monotonic_ns(), **options), theirs)),
    ):
        yield ours
