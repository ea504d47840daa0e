"""/joint_states: one snapshot becomes one message, just after the control cycle it belongs to.

A thread of its own publishes, without an executor. It wakes after every n-th cycle, patches the numbers of one fresh
snapshot into a message that was serialised once, and publishes the bytes. When a cycle is late, the thread waits for it
until the next message is due. When the thread itself was late, it publishes the newest snapshot at once and goes on
from there.

The thread finds the processor's caches cold at every wake-up. So what stands between its wake-up and the message is
little and always the same: numbers are Python's, numpy is not touched, and all else comes behind the message. That is
stamped with the time of its newest measurement, so the others in it are at most one round of readings older. Nothing is
published when nothing was measured since the last message, nor before every joint has been measured once: a position in
/joint_states is never invented. Effort is NaN where a drive measures none.
"""

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from config.schema import ArmConfig
from rosfront.link import Link, attach
from rosfront.message_bytes import MessageBytes, finite
from rosfront.plan import NS
from rosfront.serving import STALLED_NS, Serving, gone, hung, starting
from shm.errors import NotRunning, SharedMemoryError, TornRead
from shm.snapshot import Snapshot

SETTLE_NS = 60_000
"""Time from a cycle's planned time to the first read of its snapshot; if it is not there yet, the thread polls.

On an idle machine most are there by then (`bench/bench_chain.py`, "due → snapshot published": p50 36 to 49 µs).
"""
LOOK_AGAIN_S = 0.0001
"""The first pause between two polls for a late snapshot; each later one is twice as long, up to a limit."""
ATTACH_EVERY_S = 0.1
FIRST_CYCLE_EVERY_S = 0.02
QUIET_START_S = 5.0
"""Time without a message that the control process is missing: usually both start at once, and it is the slower."""
ASIDE_EVERY_NS = NS


@dataclass(frozen=True)
class Beside:
    """A joint after the arm's own, such as the gripper's, that is not measured by the control cycle."""

    message: MessageBytes
    """A JointState with one stamp and three rows; this joint is the last in each row."""
    measured: Callable[[int], tuple[float, float, float] | None]
    """Position, velocity and effort as known at a time (ns, CLOCK_MONOTONIC); None while they are unknown."""


class Publisher(Protocol):
    """What is needed of a rclpy publisher."""

    def publish(self, msg: bytes) -> None:
        """Send a serialised message."""


class Pulse(threading.Thread):
    """The publisher's thread: /joint_states, the front's heartbeat, and a callback for every snapshot.

    It alone unmaps the control process' files. `Serving` reads them in other threads too, from `attached` to `lost`,
    and `lost` comes before they are unmapped.
    """

    def __init__(
        self,
        arm: ArmConfig,
        serving: Serving,
        message: MessageBytes,
        publisher: Publisher,
        look: Callable[[Snapshot, int, bool], None],
        aside: Callable[[Link | None], None],
        say: Callable[[str], None],
        link: Link | None,
        beside: Beside | None = None,
    ) -> None:
        """`message` is a JointState with one stamp and three rows; `beside.message` replaces it while that is known.

        `look` is called with every new snapshot, the epoch stamp (ns) of its newest measurement, and whether a message
        was published for it. `aside` is called once a second, between two messages, with the control process' files or
        None. `say` is called with a sentence when that process goes or comes.
        """
        super().__init__(name="joint-states", daemon=True)
        self._arm = arm
        self._every = arm.joint_states_every_cycles
        self._period_ns = arm.control.period_ns
        self._interval_ns = self._every * self._period_ns
        self._settle_ns = min(SETTLE_NS, self._period_ns // 4)
        self._serving = serving
        self._message = message
        self._publisher = publisher
        self._look = look
        self._aside = aside
        self._say = say
        self._link = link
        self._beside = beside
        self._leave = threading.Event()
        self._cycle = 0
        self._measured_ns = 0
        self._advanced_ns = time.monotonic_ns()
        self._hung = False
        self._obstacle = ""
        self._absence_is_news = True
        self._aside_at_ns = 0
        if link is not None and link.loop_has_run():
            serving.attached(link)  # already here: a goal may come before the thread runs
        self.published = 0

    def stop(self) -> None:
        """End the thread and close the control process' files."""
        self._leave.set()
        if self.is_alive():
            self.join()
        self._serving.lost("The ROS process was stopped.")
        if self._link is not None:
            self._link.close()
            self._link = None

    def run(self) -> None:
        """Until `stop`: attach, follow the cycles, notice that the control process is gone, attach again."""
        _wake_up_exactly()
        quiet_until_s = time.monotonic() + QUIET_START_S
        while not self._leave.is_set():
            if self._link is None:
                self._try_to_attach(quiet_until_s)
            if self._link is None:
                self._turn_aside(None, time.monotonic_ns())
                self._leave.wait(ATTACH_EVERY_S)
                continue
            self._absence_is_news = False  # `_lose` says when it goes
            self._say(f"Attached to the control process of arm '{self._arm.name}' (pid {self._link.loop_pid}).")
            if self._await_first_cycle(self._link):
                self._serving.attached(self._link)
                self._follow(self._link)

    def _try_to_attach(self, quiet_until_s: float) -> None:
        try:
            self._link = attach(self._arm)
        except NotRunning as reason:
            if self._absence_is_news and time.monotonic() > quiet_until_s:
                self._absence_is_news = False
                self._say(f"{reason} Waiting for it.")
        except SharedMemoryError as problem:
            if str(problem) != self._obstacle:
                self._obstacle = str(problem)
                self._tell_lost(self._obstacle)
        else:
            self._obstacle = ""

    def _await_first_cycle(self, link: Link) -> bool:
        """Wait for the first snapshot; False when the control process ends, or this thread is to, before that."""
        if link.loop_has_run():
            return True
        reason = starting(self._arm.name, link.loop_pid)
        self._serving.lost(reason)
        said_at_s = time.monotonic() + QUIET_START_S
        while not link.loop_has_run():
            if link.loop_is_gone():
                self._lose(link)
                return False
            if time.monotonic() > said_at_s:
                self._say(reason)
                said_at_s = math.inf
            link.writer.beat()
            self._turn_aside(None, time.monotonic_ns())
            if self._leave.wait(FIRST_CYCLE_EVERY_S):
                return False
        return True

    def _follow(self, link: Link) -> None:
        """Serve one control process until it is gone, or until `stop`."""
        self._cycle = 0
        self._advanced_ns = due_ns = time.monotonic_ns()
        while not self._leave.is_set():
            time.sleep(max(0.0, (due_ns - time.monotonic_ns()) * 1e-9))
            snapshot = self._fresh(link, due_ns + self._interval_ns)
            now_ns = time.monotonic_ns()
            if snapshot is not None:
                self._advanced_ns = now_ns
                self._cycle = snapshot["cycle"]
                if self._hung:
                    self._hung = False
                    self._serving.attached(link)
                self._publish(snapshot)
                due_ns = snapshot["monotonic_ns"] + self._settle_ns  # may be past: then the next one is there already
                due_ns += (self._every - self._cycle % self._every) * self._period_ns
            elif link.loop_is_gone():
                self._lose(link)
                return
            else:
                if now_ns - self._advanced_ns > STALLED_NS and not self._hung:
                    self._hung = True
                    self._tell_lost(hung(self._arm.name, now_ns - self._advanced_ns))
                if due_ns <= now_ns:
                    due_ns += ((now_ns - due_ns) // self._interval_ns + 1) * self._interval_ns
            link.writer.beat()
            self._turn_aside(link, now_ns)

    def _fresh(self, link: Link, until_ns: int) -> Snapshot | None:
        """A snapshot newer than the last one seen; None when there is none by `until_ns` (CLOCK_MONOTONIC)."""
        pause_s, longest_s = LOOK_AGAIN_S, self._period_ns / NS / 4
        while True:
            if link.reader.newest_cycle() > self._cycle:
                try:
                    return link.reader.snapshot()
                except TornRead:
                    return None
            left_s = (until_ns - time.monotonic_ns()) / NS
            if self._hung or left_s <= 0.0:
                return None
            time.sleep(min(pause_s, left_s))
            pause_s = min(2.0 * pause_s, longest_s)

    def _publish(self, snapshot: Snapshot) -> None:
        measured_ns = snapshot.column("joints", "measured_ns")
        newest_ns = max(measured_ns)
        stamp_ns = snapshot["epoch_ns"] + newest_ns - snapshot["monotonic_ns"]
        position = snapshot.column("joints", "measured_position_rad")
        fresh = newest_ns > self._measured_ns and all(measured_ns) and all(map(math.isfinite, position))
        if fresh:
            velocity = finite(snapshot.column("joints", "measured_velocity_rad_s"))
            effort = snapshot.column("joints", "measured_effort")
            message = self._message
            rows: Sequence[Sequence[float]] = (position, velocity, effort)
            more = None if self._beside is None else self._beside.measured(newest_ns)
            if self._beside is not None and more is not None:
                message = self._beside.message
                rows = [[*row, value] for row, value in zip(rows, more, strict=True)]
            self._publisher.publish(message.fill((stamp_ns,), rows))
            self._measured_ns = newest_ns
            self.published += 1
        self._look(snapshot, stamp_ns, fresh)

    def _turn_aside(self, link: Link | None, now_ns: int) -> None:
        if now_ns >= self._aside_at_ns:
            self._aside_at_ns = now_ns + ASIDE_EVERY_NS
            self._aside(link)

    def _lose(self, link: Link) -> None:
        reason = gone(self._arm, link.loop_pid)
        self._link = None
        self._hung = False
        self._tell_lost(reason)
        link.close()

    def _tell_lost(self, reason: str) -> None:
        self._serving.lost(reason)
        self._say(reason)


def _wake_up_exactly() -> None:
    """Take this thread's timer slack, by which the kernel may delay its wake-ups: 50 µs of each message's age."""
    with contextlib.suppress(OSError):  # only as old as before
        Path(f"/proc/{threading.get_native_id()}/timerslack_ns").write_text("1")
