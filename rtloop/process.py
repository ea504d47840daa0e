"""The control process around the cycle: memory files, wire, threads, bring-up, orderly end."""

import signal
import threading
import time
from collections.abc import Callable, Iterable

import numpy as np

from config.budget import check_budget
from config.loader import arm_hash
from config.schema import ArmConfig
from rtloop import realtime
from rtloop.bringup import BringUp
from rtloop.compiled import CompiledCycle
from rtloop.conversation import Conversation
from rtloop.port import ServicePort
from rtloop.release import Release
from rtloop.state import READ_BYTES, new_loop, offset_of, show_limits
from rtloop.wire.tty import close_slcan, open_slcan
from shm import files
from shm.words import Mode

BUSY_POLL_S = 0.004
IDLE_POLL_S = 0.05
FIRST_CYCLE_POLL_S = 0.001
EPOCH_TRIES = 3


class CannotStart(Exception):
    """The control process refuses to start; the text is the sentence people read."""


class StopAsked:
    """Whether a signal has asked for the end; the signals are taken over from now on."""

    def __init__(self, signals: Iterable[signal.Signals]) -> None:
        self.yes = False  # an Event has a lock, on which a second signal would wait for the first
        for number in signals:
            signal.signal(number, self._take)

    def _take(self, *_: object) -> None:
        self.yes = True


def epoch_offset_ns() -> int:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC (ns), from the closest of a few pairs of looks at them.

    Between the two looks of a pair the process may lose the processor, for milliseconds on a busy machine.
    """
    closest_ns, offset_ns = 1 << 62, 0
    for _ in range(EPOCH_TRIES):
        before_ns, epoch_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after_ns - before_ns < closest_ns:
            closest_ns, offset_ns = after_ns - before_ns, epoch_ns - (before_ns + after_ns) // 2
    return offset_ns


class ControlProcess:
    """One arm's control process, from opening the wire to closing it.

    `tell` gets every sentence for people. Raises CannotStart, WireRefused, SharedMemoryError or ConfigError
    before anything has moved.
    """

    def __init__(
        self, arm: ArmConfig, compiled: CompiledCycle, tell: Callable[[str], None], stop_asked: StopAsked
    ) -> None:
        check_budget(arm)
        if arm.control.init_mode == 0 and arm.bus.interface != "mock":
            raise CannotStart(
                "init_mode is 0, but homing is not part of this version: move the arm to a pose whose position the "
                "drives know and start with init_mode 1."
            )
        self._arm = arm
        self._compiled = compiled
        self._tell = tell
        self._stop_asked = stop_asked
        identity = files.Identity(
            arm.name,
            tuple(joint.name for joint in arm.joints),
            arm_hash(arm),
            arm.control.period_ns,
            arm.bus.bitrate if arm.bus.interface != "mock" else 0,
        )
        self._files = files.create(identity)
        self._fd = -1
        try:
            if arm.bus.interface == "slcan":
                self._fd = open_slcan(arm.bus.resolved_channel, arm.bus.serial_baud, arm.bus.bitrate)
            self._loop = new_loop(arm, self._files.state.address, self._files.command.address)
            self._port = ServicePort(self._loop, compiled)
            self._received = np.zeros(READ_BYTES, np.uint8)
            self._poll_request = np.zeros(1, np.int64)
            show_limits(self._files.state.record["limits"], self._loop)
            arrays = (
                self._loop,
                self._received,
                self._poll_request,
                self._files.state.array,
                self._files.command.array,
            )
            used = [(array.ctypes.data, array.nbytes) for array in arrays]
            self._obtained = realtime.prepare_process([*used, *compiled.memory])
            self._threads: list[threading.Thread] = []
        except BaseException:
            self._release()
            raise

    def serve(self, ready: Callable[[], None]) -> int:
        """Run until asked to stop; the exit code: 0 orderly, 2 bring-up failed, 3 the cycle ended by itself."""
        try:
            self._start_threads()
            code = self._supervise(ready)
        finally:
            self._end_threads()
            self._release()
        return code

    # --- threads

    def _start_threads(self) -> None:
        prepared = threading.Event()
        self._threads = [threading.Thread(target=self._run_cycle, args=(prepared,), name="cycle", daemon=True)]
        if self._fd >= 0:
            self._threads.append(
                threading.Thread(target=self._run_reader, args=(prepared,), name="reader", daemon=True)
            )
        self._follow_the_clock()
        threading.stack_size(realtime.THREAD_STACK_BYTES)
        for thread in reversed(self._threads):  # the cycle's last: it publishes what both were given
            prepared.clear()
            thread.start()
            while not prepared.wait(FIRST_CYCLE_POLL_S) and thread.is_alive():
                pass
        while int(self._core["cycle"]) == 0 and self._threads[0].is_alive():
            time.sleep(FIRST_CYCLE_POLL_S)  # compiled code is being loaded; no conversation may count that time
        for complaint in self._obtained.complaints:
            self._tell(complaint)
        if self._arm.realtime.require and self._obtained.priority == 0:
            raise CannotStart(
                "realtime.require is true and no real-time priority was given: give the permission named above, or set "
                "realtime.require to false."
            )

    def _run_cycle(self, prepared: threading.Event) -> None:
        realtime.prepare_thread(self._arm.realtime, self._obtained)
        realtime.lock_recorder(self._files.state.rings, self._obtained)  # last, after what no cycle can do without
        words = self._files.state.record["scheduling"]
        words["policy"], words["priority"] = self._obtained.policy, self._obtained.priority
        words["memory_locked"], words["cpu"] = self._obtained.memory_locked, self._obtained.cpu
        words["dma_latency_held"] = self._obtained.dma_latency_fd >= 0
        prepared.set()
        kept = self._loop, self._files.state.array, self._files.command.array  # mapped for as long as this runs
        if self._compiled.run(kept[0].ctypes.data, kept[1].ctypes.data, self._fd) != 0:
            self._tell("The control cycle ended by an exception, which is a defect of rtarm: please report it.")

    def _run_reader(self, prepared: threading.Event) -> None:
        realtime.prepare_thread(self._arm.realtime, self._obtained, below=10)
        prepared.set()
        buffer, request = self._received.ctypes.data, self._poll_request.ctypes.data
        self._compiled.read_wire(self._loop.ctypes.data, self._fd, buffer, request)

    def _end_threads(self) -> None:
        self._compiled.store_word(self._loop.ctypes.data + offset_of(self._loop.dtype, "stop"), 1)
        for thread in self._threads:
            thread.join(5.0)

    def _release(self) -> None:
        if self._fd >= 0:
            close_slcan(self._fd)
            self._fd = -1
        self._files.remove()

    # --- supervision

    @property
    def _core(self) -> np.void:
        core: np.void = self._loop[0]["core"]
        return core

    def _follow_the_clock(self) -> None:
        """Stamps follow the system's clock, which may be set at any time; motion is timed by the monotonic one."""
        self._core["epoch_offset_ns"] = epoch_offset_ns()

    def _bring_up(self, *, clears_protection: bool) -> BringUp:
        measured = self._loop[0]["axes"]["measured_rad"][: len(self._arm.joints)]
        known = [0.0 if np.isnan(position) else float(position) for position in measured]
        return BringUp(
            self._arm,
            self._port,
            now_ns=time.monotonic_ns(),
            clears_protection=clears_protection,
            tell=self._tell,
            mock_positions_rad=known,
        )

    def _supervise(self, ready: Callable[[], None]) -> int:
        # fresh rings have room for its beginning
        talk: Conversation | None = self._bring_up(clears_protection=False)
        first = True
        closing_until_s = 0.0
        while True:
            time.sleep(BUSY_POLL_S if talk or first or closing_until_s else IDLE_POLL_S)
            now_s = time.monotonic()
            self._follow_the_clock()
            if talk is not None and talk.poll(time.monotonic_ns()):
                if talk.failure is not None:
                    self._tell(str(talk.failure))
                    if first:
                        return 2
                talk = None
            if first and int(self._core["mode"]) not in (Mode.OFFLINE, Mode.BRINGING_UP):
                ready()
                first = False
            if talk is None and int(self._core["bring_up_asked"]) == 1:
                self._core["bring_up_asked"] = 0
                talk = self._bring_up(clears_protection=True)
            elif talk is None and int(self._core["release_asked"]) == 1:
                self._core["release_asked"] = 0  # taken back by the cycle when the drives are enabled meanwhile
                talk = Release(self._arm, self._port, now_ns=time.monotonic_ns())
            if not self._threads[0].is_alive():
                return 3
            if self._stop_asked.yes:
                if closing_until_s == 0.0:
                    self._core["closing"] = 1
                    closing_until_s = now_s + float(self._loop[0]["params"]["longest_stop_s"]) + 1.0
                if self._stands() or now_s > closing_until_s:
                    return 0
                time.sleep(BUSY_POLL_S)

    def _stands(self) -> bool:
        """Whether nothing is commanded to move any more."""
        axes = self._loop[0]["axes"][: len(self._arm.joints)]
        moving = bool(np.any(axes["velocity_rad_s"] != 0.0))
        return not moving and int(self._core["goal_id"]) == 0
