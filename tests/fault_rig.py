"""A whole arm as real processes, with somebody who uses it and an observer outside, for trials of faults and soaks.

The simulated arm stands for the hardware and runs apart; control process and front run under `rtarm up`, or bare.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from observer import STANDS_RAD_S, Violation
from random_ways import random_way
from ros_client import Spinner
from stack import Process, Stack
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from config.loader import load_arm
from config.schema import ArmConfig
from rosfront.action_client import ActionClient
from shm import files
from shm.client import StateReader
from shm.errors import SharedMemoryError, TornRead
from shm.snapshot import Snapshot
from shm.words import Mode
from sim.truth import JointTruth

START_DEG = (17.0, 12.0, -6.0, 57.0, 29.0, 115.0)
WINDOW_S = 120.0
"""Of true motion that the simulated arm remembers: longer than any trial, on a busy machine too."""
READY_S = 30.0
BACK_S = 120.0
"""A busy machine may fault an arm that has just come back, by drives that answer late, more than once."""
END_S = 20.0
ANSWER_S = 10.0
POLL_S = 0.002
WAYPOINTS = 20
SHORTEST_S = 1.2
MOTION_S = 5.0
RESULT_WITHIN_S = 6.0
"""After the planned end of a goal its result is there."""
ATTEMPTS = 4
ASK_AGAIN_S = 0.25
"""A request that a server just discovered does not hear is sent again after this time."""


class Hang(Exception):
    """Something that must end within a bound did not; the text says what."""


def wait(condition: Callable[[], bool], what: str, patience_s: float) -> None:
    """Wait for something that can be observed; raises Hang."""
    deadline_s = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise Hang(f"{what} did not happen within {patience_s:g} s")
        time.sleep(POLL_S)


@dataclass
class Sent:
    """A goal on its way, as its sender sees it."""

    duration_s: float
    sent_ns: int
    accepted: threading.Event = field(default_factory=threading.Event)
    ended: threading.Event = field(default_factory=threading.Event)
    ended_ns: int = 0
    succeeded: bool = False
    words: str = ""
    handle: Any = None


class User(Spinner):
    """An action client that knows which servers it sees, and a person who clears faults."""

    def __init__(self, controller: str) -> None:
        super().__init__("user")
        self.controller = controller
        self.action = ActionClient(self.node, FollowJointTrajectory, f"/{controller}/follow_joint_trajectory")
        self._orders: dict[str, Any] = {}

    def servers(self) -> set[bytes]:
        """One identity for each action server that is seen."""
        topic = f"/{self.controller}/follow_joint_trajectory/_action/status"
        return {bytes(found.endpoint_gid) for found in self.node.get_publishers_info_by_topic(topic)}

    def send(self, goal: Any) -> Sent:
        """Send a goal; what becomes of it is told by what is returned."""
        last = goal.trajectory.points[-1].time_from_start
        sent = Sent(last.sec + last.nanosec * 1e-9, time.monotonic_ns())

        def ended(future: Any) -> None:
            sent.ended_ns = time.monotonic_ns()
            sent.succeeded = future.result().status == GoalStatus.STATUS_SUCCEEDED
            sent.words = future.result().result.error_string
            sent.ended.set()

        def accepted(future: Any) -> None:
            sent.handle = future.result()
            if not sent.handle.accepted:
                sent.ended_ns, sent.words = time.monotonic_ns(), "rejected"
                sent.ended.set()
            else:
                sent.handle.get_result_async().add_done_callback(ended)
            sent.accepted.set()

        self.action.send_goal_async(goal).add_done_callback(accepted)
        return sent

    def order(self, name: str, patience_s: float = ANSWER_S) -> str:
        """Call one of the front's Trigger services; "" when it was done, else why not."""
        if name not in self._orders:
            self._orders[name] = self.node.create_client(Trigger, f"/{self.controller}/{name}")
        client = self._orders[name]
        if not client.wait_for_service(patience_s):
            return f"nobody offers ~/{name}"
        future = client.call_async(Trigger.Request())
        deadline_s = time.monotonic() + patience_s
        while not future.done():
            if time.monotonic() > deadline_s:
                client.remove_pending_request(future)
                return f"~/{name} was not answered within {patience_s:g} s"
            time.sleep(POLL_S)
        return "" if future.result().success else str(future.result().message)


class Rig(Stack):
    """The arm, its processes and its user; each process may be hurt, and `make_ready` finds the way back."""

    def __init__(self, name: str, folder: Path, random: np.random.Generator) -> None:
        super().__init__(name, folder, start_deg=START_DEG)
        self.arm = load_arm(self.arm_file)
        self.random = random
        self.launched = True
        self.launcher: Process | None = None
        self.user = User(f"controller_{name}")
        self.dead_servers: dict[bytes, int] = {}
        self.gone_ms: dict[bytes, float] = {}
        self._watching = threading.Event()
        self._watcher = threading.Thread(target=self._watch_servers, daemon=True)
        self._watcher.start()
        self.last_pose_deg = list(START_DEG)
        self._reader: StateReader | None = None

    # --- processes

    def start_arm(self, *options: str) -> None:
        """Start the simulated arm where it stood last."""
        self._start_deg = self.last_pose_deg
        self.start_sim("--truth-window-s", str(WINDOW_S), *options)

    def start_control(self) -> None:
        """Start control process and front, under the launcher or bare."""
        if self.launched:
            self.launcher = self._keep(Process("rtarm", "up", str(self.arm_file), needs_ros=True))
            self.launcher.line_with("running; Ctrl-C")
        else:
            self.start_loop()
            self.start_front()

    def start(self, module: str, *arguments: str, needs_ros: bool = False) -> Process:
        """Start a process of the arm's user, which ends with the rig at the latest."""
        return self._keep(Process(module, *arguments, needs_ros=needs_ros))

    def stop_control(self) -> list[str]:
        """End control process and front in order; what was wrong with that."""
        found = []
        if self.launcher is not None:
            found += _ended(self.launcher, "rtarm up", {0})
            self.launcher = None
        else:
            for process, what in ((self.front, "the front"), (self.loop, "the control process")):
                found += _ended(process, what, {0})
        return found

    def pid(self, target: str) -> int:
        """Process id of `loop`, `front`, `launcher` or `sim`; 0 where it does not run."""
        if target == "sim":
            return self.sim.process.pid if self.sim.process.poll() is None else 0
        if target == "launcher":
            return self.launcher.process.pid if self.launcher and self.launcher.process.poll() is None else 0
        if target == "front":
            with contextlib.suppress(SharedMemoryError):
                front = files.front_of(self.name)
                return front[0] if front else 0
            return 0
        reader = self.reader()
        return int(reader.memory.record["header"]["pid"]) if reader else 0

    # --- what the arm does

    def reader(self) -> StateReader | None:
        """The living control process' state; None where there is none."""
        if self._reader is not None and not files.is_held(self._reader.memory.fd):
            self._reader.close()
            self._reader = None
        if self._reader is None:
            with contextlib.suppress(SharedMemoryError):
                self._reader = StateReader(files.open_state(self.name))
        return self._reader

    def snapshot(self) -> Snapshot | None:
        """The newest snapshot of a living control process, if it has run a cycle."""
        reader = self.reader()
        if reader is None or int(reader.memory.record["snapshot_sequence"][0]) == 0:
            return None
        with contextlib.suppress(TornRead):
            return reader.snapshot()
        return None

    def mode(self) -> int:
        """Mode of the living control process; OFFLINE where there is none."""
        snapshot = self.snapshot()
        return Mode.OFFLINE if snapshot is None else int(snapshot["mode"])

    def standing(self, patience_s: float) -> dict[str, JointTruth]:
        """The true motion, once all joints stand; raises Hang."""
        deadline_s = time.monotonic() + patience_s
        while True:
            truth = self.truth()
            moving = [name for name, joint in truth.items() if abs(joint.velocity_rad_s[-1]) > STANDS_RAD_S]
            if not moving:
                self.last_pose_deg = [math.degrees(truth[j.name].position_rad[-1]) for j in self.arm.joints]
                return truth
            if time.monotonic() > deadline_s:
                raise Hang(f"{', '.join(moving)} still moved after {patience_s:g} s")
            time.sleep(0.05)

    # --- the way back

    def make_ready(self) -> list[str]:
        """Bring the arm back into service as a person would; how that went, one word a step. Raises Hang."""
        steps = []
        if self.pid("sim") == 0:
            self._end_control_by_force()
            self.start_arm()
            steps.append("arm plugged in again")
        if self.launcher is not None and self.launcher.process.poll() is not None:
            self.launcher = None
        if self.launched and self.launcher is None:
            self._end_control_by_force()
            self.start_control()
            steps.append("started")
        elif not self.launched:
            steps += self._start_what_is_missing()
        steps += self._await_service()
        return steps

    def _start_what_is_missing(self) -> list[str]:
        steps = []
        if not hasattr(self, "loop") or self.loop.process.poll() is not None:
            self.start_loop()
            steps.append("loop started")
        if not hasattr(self, "front") or self.front.process.poll() is not None:
            self.start_front()
            steps.append("front started")
        return steps

    def _await_service(self) -> list[str]:
        steps: list[str] = []
        refused = ""
        wait(lambda: self.pid("front") != 0 and self.snapshot() is not None, "front and control process", READY_S)
        wait(self._is_served, "a living action server", READY_S)
        deadline_s = time.monotonic() + BACK_S
        while time.monotonic() < deadline_s:
            wait(lambda: self.mode() not in (Mode.BRINGING_UP, Mode.STOPPING, Mode.EXECUTING), "rest", READY_S)
            if self.mode() == Mode.FAULT:
                refused = self.user.order("clear_fault")
                if refused:  # while it moves
                    wait(lambda: self.mode() != Mode.FAULT or self._stands(), "an arm that stands", READY_S)
                steps += ["fault cleared"] if not refused else []
                continue
            snapshot = self.snapshot()
            if snapshot is not None and self.mode() == Mode.HOLDING:
                if all(snapshot["joints"]["referenced"][: len(self.arm.joints)]):
                    return steps
                steps.append(f"referenced: {self._reference(snapshot)}")
        raise Hang(f"the arm did not come back into service: {steps}, last refused with {refused!r}")

    def _stands(self) -> bool:
        """Whether nothing is commanded to move."""
        snapshot = self.snapshot()
        return snapshot is not None and not np.any(snapshot["joints"]["commanded_velocity_rad_s"])

    def _is_served(self) -> bool:
        return bool(self.user.servers() - set(self.dead_servers))

    def _reference(self, snapshot: Snapshot) -> str:
        """Say where the joints without a reference stand, as a person who looks at them; how it went."""
        truth = self.standing(READY_S)
        lost = [j.name for j, word in zip(self.arm.joints, snapshot["joints"], strict=False) if not word["referenced"]]
        angles = [f"{name}={math.degrees(truth[name].position_rad[-1]):.4f}" for name in lost]
        process = self.start("rtarm", "reference", *angles, "--arm", self.name)
        return "taken" if process.code() == 0 else process.text

    def _end_control_by_force(self) -> None:
        """What runs without its arm, or without its launcher, ends; a frozen one as well."""
        for process in self._processes:
            if process is not self.sim and process.process.poll() is None:
                process.close()
        self.launcher = None
        for target in ("front", "loop"):
            pid = self.pid(target)
            if pid:
                os.kill(pid, signal.SIGTERM)
                wait(lambda p=pid: not alive(p), f"the end of the {target}", END_S)

    # --- goals

    def note_dead_servers(self) -> None:
        """All servers seen by now are of a front that is gone; `servers_still_seen` tells how that is noticed."""
        for server in self.user.servers():
            self.dead_servers.setdefault(server, time.monotonic_ns())

    def _watch_servers(self) -> None:
        while not self._watching.wait(0.05):
            seen = self.user.servers()
            for server, died_ns in list(self.dead_servers.items()):
                if server not in seen and server not in self.gone_ms:
                    self.gone_ms[server] = (time.monotonic_ns() - died_ns) / 1e6

    def servers_still_seen(self, patience_s: float) -> list[str]:
        """Dead servers that the user has not seen go within that time."""
        deadline_s = time.monotonic() + patience_s
        while left := set(self.dead_servers) - set(self.gone_ms):
            if time.monotonic() > deadline_s:
                return [f"{len(left)} dead action servers are still seen after {patience_s:g} s"]
            time.sleep(0.05)
        return []

    def goal(self, *, shortest_s: float = SHORTEST_S, longest_s: float = 3.0, waypoints: int = WAYPOINTS) -> Any:
        """A random goal from where the arm is commanded to be, inside its limits: a quintic through waypoints."""
        return random_goal(
            self.arm, self.commanded_rad(), self.random.uniform(shortest_s, longest_s), self.random, waypoints
        )

    def commanded_rad(self) -> np.ndarray:
        """Where the arm is commanded to be, (joints,); raises Hang where nobody commands it."""
        snapshot = self.snapshot()
        if snapshot is None:
            raise Hang("there is no control process")
        commanded: np.ndarray = snapshot["joints"]["commanded_position_rad"][: len(self.arm.joints)].copy()
        return commanded

    def send(self, goal: Any) -> Sent:
        """Send a goal to the server that lives, and wait until it is accepted; raises Hang."""
        for _ in range(3):  # a request that a server just discovered does not hear is a matter of the middleware
            sent = self.user.send(goal)
            if sent.accepted.wait(ANSWER_S / 2):
                return sent
        raise Hang("a goal was not answered")

    def accepted_again(self) -> Sent:
        """A short goal that a client which asks again and again has had accepted; raises Hang."""
        deadline_s = time.monotonic() + READY_S
        while time.monotonic() < deadline_s:
            if self._is_served() and self.pid("front"):
                sent = self.user.send(self.goal(shortest_s=0.6, longest_s=0.9))
                if sent.accepted.wait(ASK_AGAIN_S) and sent.handle.accepted:
                    return sent
            time.sleep(POLL_S)
        raise Hang("no goal was accepted")

    def moving_goal(
        self, latest_share: float, notes: list[str], steps: list[str], *, shortest_s: float = SHORTEST_S
    ) -> tuple[Sent, int]:
        """A goal at a random moment of its motion, before that share of it has passed, and when it was sent.

        Where a stall of the machine ends it before, that is noted and another one sent; raises Hang.
        """
        for _ in range(ATTEMPTS):
            began_ns = time.monotonic_ns()
            sent = self.send(self.goal(shortest_s=shortest_s))
            wait(lambda s=sent: self.mode() == Mode.EXECUTING or s.ended.is_set(), "motion", MOTION_S)
            if not sent.ended.wait(self.random.uniform(0.1, latest_share) * sent.duration_s):
                return sent, began_ns
            notes.append(f"before the fault: {sent.words[:160]}")
            steps += self.make_ready()
        raise Hang("no goal ran until its random moment")

    def goal_succeeds(self, notes: list[str], steps: list[str]) -> list[str]:
        """Whether a short goal succeeds after the way back: the violation if none does; raises Hang.

        What a stall of the machine ends is noted and tried again.
        """
        for _ in range(ATTEMPTS):
            steps += self.make_ready()
            sent = self.send(self.goal(shortest_s=0.6, longest_s=0.9))
            if not sent.ended.wait(sent.duration_s + RESULT_WITHIN_S):
                raise Hang("the goal after the way back had no result")
            if sent.succeeded:
                return []
            notes.append(f"the goal after it: {sent.words[:120]}")
        return ["no goal succeeds after the way back"]

    def close(self) -> None:
        with contextlib.ExitStack() as ends:  # whatever one of them has to say
            ends.callback(super().close)
            ends.callback(self.user.close)
            self._watching.set()
            self._watcher.join()
            with contextlib.suppress(Hang):
                self._end_control_by_force()
            if self._reader is not None:
                self._reader.close()

    def end(self) -> list[str]:
        """Close it; what the observer found in the true motion of its simulated arms is told and returned."""
        try:
            self.close()
        except Violation as violation:
            found = str(violation).splitlines()
            print(*(f"    VIOLATION {sentence}" for sentence in found), sep="\n", flush=True)
            return found
        return []


def random_goal(
    arm: ArmConfig, here: np.ndarray, seconds: float, random: np.random.Generator, waypoints: int = WAYPOINTS
) -> Any:
    """A goal from rest at `here` to rest at a random place that can be reached within the limits."""
    way = random_way(arm.joints, here, seconds, random)
    return quintic_goal([joint.name for joint in arm.joints], here, way, seconds, waypoints)


def quintic_goal(
    names: list[str], here: np.ndarray, way: np.ndarray, seconds: float, waypoints: int = WAYPOINTS
) -> Any:
    """A goal of waypoints with velocities and accelerations along a rest-to-rest quintic."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = names
    for s in np.linspace(0.0, 1.0, waypoints):
        sec, nanosec = divmod(round(s * seconds * 1e9), 10**9)
        goal.trajectory.points.append(
            JointTrajectoryPoint(
                positions=(here + way * (10 * s**3 - 15 * s**4 + 6 * s**5)).tolist(),
                velocities=(way * (30 * s**2 - 60 * s**3 + 30 * s**4) / seconds).tolist(),
                accelerations=(way * (60 * s - 180 * s**2 + 120 * s**3) / seconds**2).tolist(),
                time_from_start=Duration(sec=sec, nanosec=nanosec),
            )
        )
    return goal


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and is not waited for yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def age_s(pid: int) -> float:
    """For how long a process has lived, 0 where there is none."""
    try:
        started_ticks = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19])
    except OSError:
        return 0.0
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_ticks / os.sysconf("SC_CLK_TCK")


def processor_s(pid: int) -> float:
    """Processor time that a process has used so far."""
    spent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, spent)) / os.sysconf("SC_CLK_TCK")


def _ended(process: Process, what: str, codes: set[int]) -> list[str]:
    if process.process.poll() is None:
        process.process.terminate()
    try:
        code = process.process.wait(END_S)
    except subprocess.TimeoutExpired:
        process.process.kill()
        return [f"{what} did not end within {END_S:g} s of SIGTERM"]
    return [] if code in codes else [f"{what} ended with {code} after SIGTERM"]


@contextlib.contextmanager
def full(folder: Path) -> Iterator[None]:
    """Fill the file system of a folder, which must be small and the test's own, to the last block."""
    filler = folder / "filler"
    with filler.open("wb") as file:
        size, at = 1 << 26, 0
        while size >= 512:
            try:
                os.posix_fallocate(file.fileno(), at, size)
                at += size
            except OSError:
                size //= 2
    try:
        yield
    finally:
        filler.unlink()


def environment_of(folder: Path) -> Mapping[str, str]:
    """Where processes of a trial write what is no memory file: logs, recordings; not the compiled cycle.

    Everything is named: what is left to a default would go where the user's own environment says.
    """
    cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    return {
        "HOME": str(folder),
        "ROS_LOG_DIR": str(folder / "log"),
        "XDG_STATE_HOME": str(folder / "state"),
        "XDG_CACHE_HOME": cache,
    }
