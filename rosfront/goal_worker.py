# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""Action goals on their way in: judged in a thread of their own, in the order in which they came.

Judging 100,000 points takes a second or more. Meanwhile the executor answers everybody else, and whoever cancels a goal
that is still being judged is told its end at once; what the judgement then says is of no interest.
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
    """Does one thing after another; a daemon, as at the end of the program it may be busy with what nobody awaits."""

    def __init__(self) -> None:
        super().__init__(name="goals", daemon=True)
        self._works: SimpleQueue[Callable[[], None] | None] = SimpleQueue()

    def put(self, work: Callable[[], None]) -> None:
        """Do it when everything before is done; it must not raise."""
        self._works.put(work)

    def stop(self) -> None:
        """Return from `run` when everything before is done."""
        self._works.put(None)

    def run(self) -> None:
        while (work := self._works.get()) is not None:
            work()


class Pending(Generic[End]):
    """What is awaited by the executor and ends with the first that any thread has to say."""

    def __init__(self, wake: Callable[[], None]) -> None:
        """`wake` makes the executor look at what has changed."""
        self.ended: Future = Future()
        """Its End."""
        self._wake = wake
        self._lock = threading.Lock()

    def end(self, end: End) -> None:
        with self._lock:
            if not self.ended.done():
                self.ended.set_result(end)
        self._wake()

    def fail(self, problem: BaseException) -> None:
        """A defect of ours, raised to whoever awaits the end."""
        with self._lock:
            if not self.ended.done():
                self.ended.set_exception(problem)
        self._wake()


class ConsideredGoal(Pending[GoalRefused | None]):
    """An action goal that may still be rejected; ends with the reason, or with None."""


class PendingGoal(Pending[Verdict]):
    """An action goal from its acceptance to its end."""

    def __init__(self, wake: Callable[[], None], arrival: Arrival) -> None:
        super().__init__(wake)
        self.arrival = arrival
        self._execution: Execution | None = None

    def begin(self, start: Callable[[], Execution]) -> None:
        """Hand it to the control process, unless it has ended meanwhile."""
        with self._lock:
            if not self.ended.done():
                self._execution = start()

    def execution_or_end(self, verdict: Verdict) -> Execution | None:
        """What moves the arm for it; where nothing does yet, nothing ever will, and it ends with the `verdict`."""
        with self._lock:
            if self._execution is None and not self.ended.done():
                self.ended.set_result(verdict)
            execution = self._execution
        self._wake()
        return execution
