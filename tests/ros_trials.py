"""`make ros-trials TRIALS=200 SEED=1`: ROS processes killed at random moments, beside an arm that must go on.

A crowd of ordinary ROS nodes listens to an arm under `rtarm up`, calls a service of it and sends it goals. In each
trial one of them, or the arm's own ROS process, is killed with SIGKILL: while it runs, or while it starts. As root
some trials meet a full /dev/shm. All other ROS processes must go on, and every new one come up. With
`FASTDDS_BUILTIN_TRANSPORTS=DEFAULT` in the environment all of them use the shared memory of Fast DDS instead of UDP.
Exits with 1 when anything stood still.
"""

from __future__ import annotations

import argparse
import os
import secrets
import signal
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import guardian
import numpy as np
from process_trials import OWN, begin_again, own_ros_domain, small_home, spread

CROWD = ("listener", "listener", "caller", "sender")
RUNS, STARTS, FRONT = "a node that runs", "a node that starts", "the front"
VICTIMS = {RUNS: 0.4, STARTS: 0.4, FRONT: 0.2}
FULL_SHARE = 0.2
LATEST_S = 0.3
START_TAKES_S = 1.0
"""To the first answer, when nothing else runs."""
ANSWER_S = 20.0
GOAL_EVERY = 10
TIMES = ("states_ms", "service_ms", "others_ms", "new_ms")


@dataclass
class Seen:
    """What a trial showed; times from the kill to the proof that this goes on."""

    what: str
    states_ms: float | None = None
    service_ms: float | None = None
    others_ms: float | None = None
    new_ms: float | None = None
    violations: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class Trials:
    """An arm in service and a crowd around it."""

    def __init__(self, rig: Any) -> None:
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import JointState

        self.rig, self.random = rig, rig.random
        self.crowd: list[Any] = [None] * len(CROWD)
        self._heard = 0
        rig.user.node.create_subscription(JointState, "joint_states", self._hear, QoSProfile(depth=10), raw=True)

    def _hear(self, _: bytes) -> None:
        self._heard += 1

    def begin(self) -> None:
        """Everything runs; raises Hang or AssertionError."""
        self.rig.make_ready()
        for place in range(len(CROWD)):
            self._start(place)
        for member in self.crowd:
            member.line_with("ready")

    def close(self) -> None:
        """End the crowd."""
        for place, member in enumerate(self.crowd):
            if member is not None:
                self._kill(place)

    def run(self, what: str, full_memory: bool) -> Seen:
        """One kill, and what the others make of it."""
        from fault_rig import Hang, full

        from shm.files import DIRECTORY

        seen = Seen(f"{what}{', /dev/shm full' if full_memory else ''}")
        place = None if what == FRONT else int(self.random.integers(len(CROWD)))
        try:
            with full(DIRECTORY) if full_memory else nullcontext():
                killed_s = self._hurt(what, place)
                if place is not None:
                    self._judge(seen, place, killed_s)
            if place is None:  # the next front writes a memory file of its own
                self.rig.make_ready()
                seen.new_ms = since_ms(killed_s)
                self._judge(seen, None, killed_s)
        except Hang as problem:
            seen.violations.append(str(problem))
        return seen

    def _hurt(self, what: str, place: int | None) -> float:
        """Kill somebody at a random moment; when that was."""
        time.sleep(self.random.uniform(0.0, LATEST_S))
        if place is None:
            self.rig.note_dead_servers()
            os.kill(self.rig.pid("front"), signal.SIGKILL)
            return time.monotonic()
        self._kill(place)
        if what == STARTS:
            self._start(place)
            time.sleep(self.random.uniform(0.0, START_TAKES_S))
            self._kill(place)
        killed_s = time.monotonic()
        self._start(place)
        return killed_s

    def _judge(self, seen: Seen, place: int | None, killed_s: float) -> None:
        """The front publishes and answers, each of the crowd has an answer that is newer than this, the new one too."""
        from fault_rig import Hang, wait

        before = self._heard
        try:
            wait(lambda: self._heard > before, "a new message on /joint_states", ANSWER_S)
            seen.states_ms = since_ms(killed_s)
        except Hang as problem:
            seen.violations.append(str(problem))
        said = self.rig.user.order("clear_fault", ANSWER_S)
        if "~/clear_fault" in said:  # a sentence of the test's; the front's own do not name their service
            seen.violations.append(said)
        else:
            seen.service_ms = since_ms(killed_s)
        others = [other for other in range(len(CROWD)) if other != place]
        for other in others:
            self.crowd[other].say("?")
        self._await(seen, others, "answered")
        seen.others_ms = since_ms(killed_s)
        if place is not None:
            self._await(seen, [place], "ready")
            seen.new_ms = since_ms(killed_s)

    def _await(self, seen: Seen, places: Sequence[int], word: str) -> None:
        """Members that do not say a word in time are a violation each, and are replaced for the trials that follow."""
        for place in places:
            try:
                self.crowd[place].line_with(word)
            except AssertionError:
                member = self.crowd[place]
                state = "stands still" if member.process.poll() is None else f"ended with {member.code()}"
                seen.violations.append(f"a {CROWD[place]} {state}, not {word}: {member.text[-300:]}")
                self._kill(place)
                self._start(place)
                self.crowd[place].line_with("ready")

    def _start(self, place: int) -> None:
        from stack import Process

        self.crowd[place] = Process("ros_crowd", CROWD[place], self.rig.user.controller, needs_ros=True)

    def _kill(self, place: int) -> None:
        self.crowd[place].process.kill()
        self.crowd[place].close()


def since_ms(then_s: float) -> float:
    return (time.monotonic() - then_s) * 1e3


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="ros_trials", description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    begin_again("ros_trials", arguments)
    own_ros_domain()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    from fault_rig import Hang, Rig
    from stack import PATIENT

    found: list[Seen] = []
    left: list[str] = []
    random = np.random.default_rng(options.seed)
    prefix = "rtarm-ros-"
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name, small_home(Path(name)):
        rig = Rig(f"t{secrets.token_hex(4)}", Path(name), random)
        rig.change(limits=PATIENT)
        trials = Trials(rig)
        try:
            rig.start_arm()
            trials.begin()
            for number in range(1, options.trials + 1):
                what = str(random.choice(list(VICTIMS), p=list(VICTIMS.values())))
                full_memory = bool(os.environ.get(OWN)) and random.uniform() < FULL_SHARE
                guardian.doing(f"trial {number} ({what}{', /dev/shm full' if full_memory else ''})")
                found.append(trials.run(what, full_memory))
                if number % GOAL_EVERY == 0:
                    found[-1].violations += rig.goal_succeeds(found[-1].notes, found[-1].notes)
                print(line(number, found[-1]), flush=True)
            guardian.doing("the end of the trials")
            left = rig.stop_control()
        except (Hang, AssertionError) as problem:
            left = [f"hang: {str(problem)[:500]}"]
        finally:
            try:
                trials.close()
            finally:
                left += rig.end()
    print(table(found, options.seed, left))
    return int(bool(left or any(seen.violations for seen in found)))


def line(number: int, seen: Seen) -> str:
    """What is told of a trial as it ends."""
    times = [f"{name.removesuffix('_ms')} {value:.0f}" for name in TIMES if (value := getattr(seen, name)) is not None]
    text = " | ".join([f"{number:3d} {seen.what}", *times, *seen.notes])
    return text + "".join(f"\n    VIOLATION {sentence}" for sentence in seen.violations)


def table(found: Sequence[Seen], seed: int, left: Sequence[str]) -> str:
    """All trials by what was killed, and what was wrong."""
    groups: dict[str, list[Seen]] = defaultdict(list)
    for seen in found:
        groups[seen.what].append(seen)
    rows = [
        f"{len(found)} trials, seed {seed}. Milliseconds from the kill: p50 / p99 / max.",
        "",
        "| killed | /joint_states heard | service answered | others answered | new one serves | trials | violations |",
        "|---|---|---|---|---|---|---|",
    ]
    for what, group in sorted(groups.items()):
        times = [spread([value for seen in group if (value := getattr(seen, name)) is not None]) for name in TIMES]
        rows.append(f"| {what} | {' | '.join(times)} | {len(group)} | {sum(bool(s.violations) for s in group)} |")
    bad = [f"- {seen.what}: {sentence}" for seen in found for sentence in seen.violations]
    rows += ["", f"Violations: {len(bad) + len(left)}", *bad, *(f"- at the end: {sentence}" for sentence in left)]
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
