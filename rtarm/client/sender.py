"""Sends goals to a running arm through its ordinary action, so that every check of a MoveIt goal applies.

ROS lives in a process of its own (`rtarm.client.program`), which starts in about a second; who sends needs no ROS.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np

from config.schema import ArmConfig
from rtarm.console.errors import Refusal
from rtarm.launch.launcher import action_name
from rtarm.launch.plan import check_ros
from rtarm.processes import READY, ros_environment
from shm import files

if TYPE_CHECKING:
    from rtarm.running.requests import Connection

START_PATIENCE_S = 60.0
END_S = 5.0
"""For the process that speaks ROS to end, once its last goal has."""
LAST_LINES = 20
SILENCE_S = 10.0
"""So long may the arm run no goal before one that was sent begins, and after it ran until there is its result."""
LOOK_S = 0.1


class Outcome(NamedTuple):
    """How a goal ended: its FollowJointTrajectory error code and the arm's own sentence."""

    succeeded: bool
    code: int
    sentence: str


class Sender:
    """Sends goals and hears how they end; all methods may be called from any thread.

    What is said to the other process is written by a thread of its own: should that one hang, nobody here does.
    """

    def __init__(self, process: subprocess.Popen[str], canceled_s: float) -> None:
        """`canceled_s`: how long that process waits for the end of what it has canceled."""
        self._process = process
        self._end_patience_s = canceled_s + END_S
        self._state = threading.Condition()
        self._outcomes: dict[int, Outcome] = {}
        self._errors: deque[str] = deque(maxlen=LAST_LINES)
        self._last = 0
        self._to_say: deque[dict[str, Any]] = deque()
        self._ready = False
        self._ended = False
        self._closes = False
        self._abandoned = False
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        self._listeners = (
            threading.Thread(target=self._hear, args=(process.stdout,), name="goal results", daemon=True),
            threading.Thread(target=self._errors.extend, args=(process.stderr,), name="goal sender", daemon=True),
        )
        self._speaker = threading.Thread(target=self._speak, args=(process.stdin,), name="goals", daemon=True)
        for thread in (*self._listeners, self._speaker):
            thread.start()

    @property
    def pid(self) -> int:
        """Process id of the one that speaks ROS."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether that process still listens."""
        with self._state:
            return not self._ended

    def wait_ready(self, patience_s: float) -> None:
        """Wait until the arm's action is found.

        Raises:
            Refusal: it is not.
        """
        with self._state:
            found = self._state.wait_for(lambda: self._ready or self._ended, patience_s)
        if not found:
            raise Refusal(f"The process that sends goals has not started within {patience_s:g} s: try again.")
        if not self._ready:
            raise self._gone()

    def send(self, document: dict[str, Any]) -> int:
        """Send a FollowJointTrajectory goal (as `rtarm.demo.goals`, field for field) and return its number at once.

        A goal that runs already is replaced, as the action has it.

        Raises:
            Refusal: the process that sends is gone.
        """
        with self._state:
            self._last += 1
            number = self._last
            self._say({"number": number, "goal": document})
        return number

    def stream(self, document: dict[str, Any]) -> None:
        """Publish the trajectory of a goal to the arm, which answers nothing; one that still waits is never sent.

        Raises:
            Refusal: the process that sends is gone.
        """
        with self._state:
            for late in [said for said in self._to_say if "stream" in said]:
                self._to_say.remove(late)
            self._say({"stream": document})

    def cancel(self) -> None:
        """Cancel what was sent and still runs: the arm stops on its path. What is gone needs no cancelling."""
        with suppress(Refusal), self._state:
            self._say({})

    def ended(self, number: int, patience_s: float = 0.0) -> Outcome | None:
        """How a goal ended, each once; None if it has not within `patience_s`.

        Raises:
            Refusal: the process that sends is gone.
        """
        with self._state:
            self._state.wait_for(lambda: number in self._outcomes or self._ended, patience_s)
            if number in self._outcomes:
                return self._outcomes.pop(number)
        if self._ended:
            raise self._gone()
        return None

    def abandon(self) -> None:
        """Who was sent to is gone: `close` waits for no end of a goal."""
        self._abandoned = True
        self._process.kill()

    def close(self) -> None:
        """End; what still runs is cancelled."""
        with self._state:
            self._closes = True
            self._state.notify_all()
        try:
            self._process.wait(self._end_patience_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in (*self._listeners, self._speaker):
            thread.join()
        for stream in (self._process.stdout, self._process.stderr):
            assert stream is not None
            stream.close()

    def _say(self, what: dict[str, Any]) -> None:
        if self._ended:
            raise self._gone()
        self._to_say.append(what)
        self._state.notify_all()

    def _speak(self, pipe: IO[str]) -> None:
        """Write what there is to say, to the end of this or of the other process."""
        with suppress(OSError), pipe:
            while True:
                with self._state:
                    self._state.wait_for(lambda: self._to_say or self._closes or self._ended)
                    if self._ended or not self._to_say:
                        return
                    what = self._to_say.popleft()
                pipe.write(json.dumps(what) + "\n")
                pipe.flush()

    def _hear(self, lines: IO[str]) -> None:
        for line in lines:
            with self._state:
                if line.startswith(READY):
                    self._ready = True
                elif line.startswith("{"):
                    heard = json.loads(line)
                    if heard["event"] == "result":
                        outcome = Outcome(heard["succeeded"], heard["code"], heard["sentence"])
                        self._outcomes[heard["number"]] = outcome
                self._state.notify_all()
        with self._state:
            self._ended = True
            self._state.notify_all()

    def _gone(self) -> Refusal:
        if self._abandoned:
            return Refusal("The ROS process has ended and has not said how this goal did: see `rtarm status`.")
        self._listeners[1].join(1.0)  # its last words
        said = self._errors[-1].strip() if self._errors else ""
        if not self._ready and said:
            return Refusal(said)
        return Refusal(f"The process that sends goals has ended{f' ({said})' if said else ''}: try again.")


def follow(connection: Connection, sender: Sender, number: int, silent: str, *, begun: bool = False) -> Outcome | None:
    """How a goal of an arm ended; with `begun` None as soon as the arm runs it.

    A ROS process that dies or hangs says nothing of its goals. When the arm has run none for `SILENCE_S`, the goal is
    cancelled, so that it moves nothing should it come to run later.

    Raises:
        Refusal: that, with the sentence `silent`, in which {seconds} stands for `SILENCE_S`; or the sender is gone.
        NotRunning: the control process ended meanwhile.
    """
    quiet_since_s = time.monotonic()
    while (ended := sender.ended(number, LOOK_S)) is None:
        now = connection.snapshot()
        connection.check_running()
        if now["goal_id"]:
            if begun:
                return None
            quiet_since_s = time.monotonic()
        elif time.monotonic() - quiet_since_s > SILENCE_S:
            sender.cancel()
            raise Refusal(silent.format(seconds=SILENCE_S))
    return ended


@contextmanager
def sending(arm: ArmConfig, namespace: str = "") -> Iterator[Sender]:
    """A sender to the action of an arm whose ROS process is in this namespace, in the ROS domain of the environment.

    At its end, a goal that still runs is cancelled.

    Raises:
        Refusal: there is no ROS here, or no ROS process serves the arm.
    """
    check_ros()
    canceled_s = arm.patience.canceled_s
    environment = ros_environment()
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", arm.front.discovery.upper())
    process = subprocess.Popen(
        # -P: a folder called config where the user happens to stand is not our package.
        [
            *(sys.executable, "-P", "-m", "rtarm.client.program"),
            *(f"--action={action_name(arm, namespace)}", "--streams", f"--canceled-s={canceled_s}"),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        process_group=0,  # a terminal's Ctrl-C is for who sends, who then cancels
    )
    sender = Sender(process, canceled_s)
    try:
        sender.wait_ready(START_PATIENCE_S)
        yield sender
    finally:
        sender.close()


class LastingSender:
    """The process that sends to an arm: it starts when it is first needed, and anew where it or the front has died.

    ROS takes a server that was killed for alive for seconds, in which a goal to the next one is lost.
    """

    def __init__(self, arm: str, config: Callable[[], ArmConfig], namespace: str = "") -> None:
        """`config` of the arm of this name is asked for when a sender starts, so that nothing else needs it."""
        self._arm = arm
        self._config = config
        self._namespace = namespace
        self._open = ExitStack()
        self._sender: Sender | None = None
        self._sends_to = 0

    def ready(self) -> Sender:
        """The sender, which may take a second or more to start; raises what `sending` does."""
        front = files.front_of(self._arm)
        restarted = front is None or front[0] != self._sends_to
        if self._sender is not None and (restarted or not self._sender.alive):
            self._sender.abandon()
            self.close()
        if self._sender is None:
            self._sender = self._open.enter_context(sending(self._config(), self._namespace))
            self._sends_to = front[0] if front is not None else 0
        return self._sender

    @property
    def present(self) -> Sender | None:
        """The sender that was started last; None where there is none."""
        return self._sender

    def close(self) -> None:
        """End what was started; a goal that was sent and still runs is cancelled."""
        self._sender = None
        self._open.close()


def goal_document(
    joint_names: Sequence[str],
    times_s: np.ndarray,
    positions_rad: np.ndarray,
    velocities_rad_s: np.ndarray | None = None,
    accelerations_rad_s2: np.ndarray | None = None,
) -> dict[str, Any]:
    """A FollowJointTrajectory goal as `Sender.send` and `Sender.stream` take it.

    Args:
        joint_names: N names.
        times_s: M times from the start.
        positions_rad, velocities_rad_s, accelerations_rad_s2: M × N.
    """
    named = {"positions": positions_rad, "velocities": velocities_rad_s, "accelerations": accelerations_rad_s2}
    points = []
    for at, time_s in enumerate(times_s):
        whole_s = math.floor(time_s)
        nanosec = round((time_s - whole_s) * 1e9)
        carried_s, nanosec = divmod(nanosec, 1_000_000_000)  # 0.9999999999 rounds up to a second
        point: dict[str, Any] = {name: values[at].tolist() for name, values in named.items() if values is not None}
        points.append({**point, "time_from_start": {"sec": whole_s + carried_s, "nanosec": nanosec}})
    return {"trajectory": {"joint_names": list(joint_names), "points": points}}
