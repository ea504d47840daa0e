# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""Checks incoming action goals in a thread of its own, in the order of arrival.

Checking 100,000 points takes a second or more. Meanwhile the executor serves other clients. A client that cancels a
goal still being checked gets its result at once; the outcome of the check is then ignored.
"""

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Generic, TypeVar

from rclpy.task import Future

from rosfront.refusals import GoalRefused
from rosfront.serving import Arrival, Execution
from rosfront.verdict import Verdict

End = TypeVar("End")


class GoalWorker(threading.Thread):
    """Runs one function after another; a daemon, as at shutdown it may be busy with a result no longer awaited."""

    def __init__(self) -> None:
        super().__init__(name="goals", daemon=True)
        self._works: SimpleQueue[Callable[[], None] | None] = SimpleQueue()

    def put(self, work: Callable[[], None]) -> None:
        """Run `work` when everything put before is done; it must not raise."""
        self._works.put(work)

    def stop(self) -> None:
        """Return from `run` when everything put before is done."""
        self._works.put(None)

    def run(self) -> None:
        while (work := self._works.get()) is not None:
            work()


class Pending(Generic[End]):
    """Something that the executor awaits; the first thread to call `end` or `fail` decides how it ends."""

    def __init__(self, wake: Callable[[], None]) -> None:
        """`wake` wakes the executor, so that it sees the change."""
        self.ended: Future = Future()
        """Its End."""
        self._wake = wake
        self._lock = threading.Lock()

    def end(self, end: End) -> None:
        """Set its End, unless it has ended."""
        with self._lock:
            if not self.ended.done():
                self.ended.set_result(end)
        self._wake()

    def fail(self, problem: BaseException) -> None:
        """End it by a defect of ours, which is raised where the end is awaited."""
        with self._lock:
            if not self.ended.done():
                self.ended.set_exception(problem)
        self._wake()


class ConsideredGoal(Pending[GoalRefused | None]):
    """An action goal that may still be rejected; ends with the reason, or with None if it is accepted."""


class PendingGoal(Pending[Verdict]):
    """An action goal from its acceptance to its end."""

    def __init__(self, wake: Callable[[], None], arrival: Arrival) -> None:
        super().__init__(wake)
        self.arrival = arrival
        self._execution: Execution | None = None

    def begin(self, start: Callable[[], Execution]) -> None:
        """Hand the goal to the control process by `start`, unless it has ended meanwhile."""
        with self._lock:
            if not self.ended.done():
                self._execution = start()

    def execution_or_end(self, verdict: Verdict) -> Execution | None:
        """The goal's execution. If there is none yet, there never will be: the goal ends with the `verdict`."""
        with self._lock:
            if self._execution is None and not self.ended.done():
                self.ended.set_result(verdict)
            execution = self._execution
        self._wake()
        return execution
