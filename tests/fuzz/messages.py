"""Hostile goals, streams and their bytes, against the front's checks; what these accept is executed and judged."""

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np

from fuzz import memory
from fuzz.arena import MemoryArena
from rosfront.goal import most_points, plan_goal, plan_stream
from rosfront.plan import GoalPlan, Present
from rosfront.refusals import GoalRefused
from rosfront.settings import Settings
from rosfront.trajectory_bytes import parse
from shm.words import Fault, Mode, Outcome

NS = 1_000_000_000
EPOCH_NS = 1_700_000_000 * NS
LONGEST_S = 20.0
"""An accepted plan that lasts longer is not executed."""
NUMBERS = (0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e-320, 5e-324, 1e308, -1e308, 1e18, 1e-9, 1.2e-7, -1.0, 0.1)
NAMES = ("", "joint", "joint7", "Joint1", "joint1 ", "gelenk_ä", "\0", "joint1\n", "x" * 5000, "🤖", "joint1/joint2")
SECONDS = (0, 0, 0, 1, -1, 2**31 - 1, -(2**31), 10)
NANOSECONDS = (0, 1, 999_999_999, 10**9, 2**32 - 1)


def check_sentence(text: str) -> None:
    """A refusal is one sentence of readable length that ends as one."""
    assert text.strip() and text.rstrip().endswith((".", ").")), text
    assert len(text) < 20_000 and "Traceback" not in text, text[:200]
    assert "\n" not in text.strip(), text


class Senders:
    """Makes messages that are nearly right, or not right at all, in the words of the arm."""

    def __init__(self, arm: Any) -> None:
        self.arm = arm
        self.names = [joint.name for joint in arm.joints]

    def number(self, random: np.random.Generator, scale: float = 1.0) -> float:
        if random.random() < 0.3:
            return float(NUMBERS[random.integers(len(NUMBERS))])
        return float(random.normal(0.0, scale) * 10.0 ** random.integers(-6, 4))

    def joints(self, random: np.random.Generator, wild: float) -> list[str]:
        chosen = [self.names[i] for i in random.permutation(len(self.names))]
        if random.random() < 0.5:
            chosen = chosen[: random.integers(1, len(chosen) + 1)]
        if random.random() < wild:
            kind = random.integers(4)
            if kind == 0:
                chosen = []
            elif kind == 1:
                chosen.append(chosen[0])
            elif kind == 2:
                chosen.insert(int(random.integers(len(chosen) + 1)), NAMES[random.integers(len(NAMES))])
            else:
                chosen = chosen * int(random.integers(2, 40))
        return chosen

    def stamp(self, random: np.random.Generator, wild: float) -> SimpleNamespace:
        if random.random() < wild:
            return SimpleNamespace(
                sec=int(SECONDS[random.integers(len(SECONDS))]),
                nanosec=int(NANOSECONDS[random.integers(len(NANOSECONDS))]),
            )
        if random.random() < 0.6:
            return SimpleNamespace(sec=0, nanosec=0)
        at = EPOCH_NS + int(random.normal(0.0, 0.5) * NS)
        return SimpleNamespace(sec=at // NS, nanosec=at % NS)

    def trajectory(self, random: np.random.Generator, here: np.ndarray, wild: float) -> SimpleNamespace:
        """Points on a way from `here` (joints,) that uses a share of the limits; each field may be spoilt."""
        names = self.joints(random, wild)
        count = int(random.integers(0, 12)) if random.random() < 0.9 else int(random.integers(12, 300))
        gap_ns = int(random.choice([1, 10_000, 500_000, 5_000_000, 10_000_000, 100_000_000, 500_000_000]))
        times = np.cumsum(random.integers(1, 2 * gap_ns + 1, count)) - (gap_ns if random.random() < 0.5 else 0)
        if count and random.random() < 0.6:
            times -= times[0]
        share = float(random.choice([0.1, 0.5, 0.9, 0.99, 1.0, 1.04, 1.5]))
        with_velocity, with_acceleration = random.random() < 0.8, random.random() < 0.5
        phase = random.uniform(0.0, 6.0, len(names))
        toward_limit = random.random() < 0.3
        points = []
        for index in range(count):
            t = float(times[index]) / NS
            rows: dict[str, list[float]] = {"positions": [], "velocities": [], "accelerations": [], "effort": []}
            for column, name in enumerate(names):
                joint = self.arm.joints[self.names.index(name)] if name in self.names else self.arm.joints[0]
                p0 = here[self.names.index(name)] if name in self.names else 0.0
                fastest, hardest = joint.max_velocity_rad_s, joint.max_acceleration_rad_s2
                w = hardest / fastest
                size = share * fastest / w
                rows["positions"].append(p0 + size * (1 - np.cos(w * t)) * np.sign(np.sin(phase[column]) + 1e-9))
                rows["velocities"].append(size * w * np.sin(w * t) * np.sign(np.sin(phase[column]) + 1e-9))
                rows["accelerations"].append(size * w * w * np.cos(w * t) * np.sign(np.sin(phase[column]) + 1e-9))
                if toward_limit and index:
                    limit = joint.upper_rad if phase[column] > 3 else joint.lower_rad
                    rows["positions"][-1] = limit + random.choice([0.0, 1e-6, -1e-6, 1e-3, -1e-3])
            if index == count - 1 and random.random() < 0.7:
                rows["velocities"] = [0.0] * len(names)
            if not with_velocity:
                rows["velocities"] = []
            if not with_acceleration:
                rows["accelerations"] = []
            self._spoil(random, rows, wild)
            at_ns = int(times[index])
            time = SimpleNamespace(sec=at_ns // NS, nanosec=at_ns % NS)
            if random.random() < 0.3 * wild:
                time = self.stamp(random, 1.0)
            points.append(SimpleNamespace(time_from_start=time, **rows))
        if count > 1 and random.random() < 0.3 * wild:
            points[int(random.integers(count))] = points[int(random.integers(count))]
        return SimpleNamespace(header=SimpleNamespace(stamp=self.stamp(random, wild)), joint_names=names, points=points)

    def _spoil(self, random: np.random.Generator, rows: dict[str, list[float]], wild: float) -> None:
        for field, values in rows.items():
            if random.random() < 0.3 * wild:
                kind = random.integers(4)
                if kind == 0 and values:
                    values[int(random.integers(len(values)))] = self.number(random)
                elif kind == 1:
                    values.append(self.number(random))
                elif kind == 2 and values:
                    values.pop()
                elif kind == 3 and field != "positions":
                    values[:] = [self.number(random) for _ in range(int(random.integers(0, 8)))]

    def tolerances(self, random: np.random.Generator, wild: float) -> list[SimpleNamespace]:
        return [
            SimpleNamespace(
                name=name,
                **{key: self.number(random, 0.1) for key in ("position", "velocity", "acceleration")},
            )
            for name in self.joints(random, wild)[: int(random.integers(0, 4))]
        ]

    def goal(self, random: np.random.Generator, here: np.ndarray, wild: float) -> SimpleNamespace:
        some = [SimpleNamespace()] if random.random() < 0.05 * wild else []
        return SimpleNamespace(
            trajectory=self.trajectory(random, here, wild),
            multi_dof_trajectory=SimpleNamespace(
                joint_names=["base"] if random.random() < 0.05 * wild else [], points=some
            ),
            path_tolerance=self.tolerances(random, wild) if random.random() < wild else [],
            goal_tolerance=self.tolerances(random, wild) if random.random() < wild else [],
            component_path_tolerance=some,
            component_goal_tolerance=[],
            goal_time_tolerance=self.stamp(random, 1.0)
            if random.random() < wild
            else SimpleNamespace(sec=0, nanosec=0),
        )


class Messages:
    """One target: messages of a kind, judged and, where accepted, executed."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.arena = MemoryArena()
        self.arm = self.arena.arm.arm
        self.senders = Senders(self.arm)
        self.settings = Settings.of(self.arm)
        self.accepted = self.executed = 0
        self._begun = self.arena.arm.loop.copy()

    def case(self, random: np.random.Generator) -> None:
        """Make one message, judge it, execute it; raises when anything is wrong with what came of it."""
        wild = float(random.choice([0.0, 0.1, 0.5]))
        here = np.zeros(len(self.arm.joints)) if random.random() < 0.5 else self._anywhere(random)
        commanded = np.zeros((len(here), 3))
        commanded[:, 0] = here
        standing = self.kind == "goals" or random.random() < 0.5
        if not standing:
            commanded[:, 1] = [random.uniform(-1, 1) * joint.max_velocity_rad_s for joint in self.arm.joints]
        present = Present(commanded, standing, self.arena.arm.now_ns, EPOCH_NS)
        try:
            plan = self._plan(random, here, wild, present)
        except GoalRefused as refusal:
            check_sentence(refusal.sentence)
            return
        if plan is None:
            return
        self.accepted += 1
        self._check(plan)
        soon = plan.start_ns - present.monotonic_ns < LONGEST_S * NS
        if standing and soon and plan.duration_s < LONGEST_S and len(plan.times_ns) < 400:
            self.executed += 1
            self.execute(plan, here)

    def _anywhere(self, random: np.random.Generator) -> np.ndarray:
        return np.array([random.uniform(joint.lower_rad, joint.upper_rad) for joint in self.arm.joints])

    def _plan(self, random: np.random.Generator, here: np.ndarray, wild: float, present: Present) -> GoalPlan | None:
        if self.kind == "goals":
            return plan_goal(self.senders.goal(random, here, wild), self.arm, present, self.settings)
        message = self.senders.trajectory(random, here, wild)
        if self.kind == "streams":
            return plan_stream(message, self.arm, present, self.settings)
        data = damaged(random, serialised(message))
        parsed = parse(data, most_points(self.arm))
        return None if parsed is None else plan_stream(parsed, self.arm, present, self.settings)

    def _check(self, plan: GoalPlan) -> None:
        """What the ring and the control process take for granted."""
        assert plan.joints.shape == (len(plan.times_ns), len(self.arm.joints), 3)
        assert len(plan.orders) == len(plan.times_ns) > 0
        assert plan.times_ns[0] >= 0 and (np.diff(plan.times_ns) > 0).all()
        assert set(np.unique(plan.orders)) <= {1, 3, 5}
        assert np.isfinite(plan.joints).all()
        assert 0 < plan.joint_mask < 1 << len(self.arm.joints)
        assert -(2**63) <= plan.start_ns < 2**63
        for tolerances in (plan.terms.path_tolerances, plan.terms.goal_tolerances):
            assert (tolerances >= 0.0).all() and np.isfinite(tolerances).all()
        assert 0.0 <= plan.terms.goal_time_s < np.inf

    def execute(self, plan: GoalPlan, here: np.ndarray) -> None:
        """Play it on the mock arm, compiled; no setpoint may break a limit, and no last line of defence be needed."""
        arm = self.arena.arm
        arm.loop[:] = self._begun
        axes = arm.loop[0]["axes"][: len(here)]
        axes["commanded"]["position_rad"] = axes["commanded"]["next_position_rad"] = here
        axes["measured"]["position_rad"] = axes["tracking"]["reference_rad"] = here
        for word in ("setpoints_written", "requests_written", "announced_goal"):
            arm.command.record[word][0] = 0
        start_ns = int(arm.memory["timing"]["now_ns"])
        self._write(plan)
        verdict = self.arena.verdict
        cycles = round((plan.duration_s + 65.0) / (arm.period_ns * 1e-9))
        guilt = memory.follow(arm.loop[0], arm.state.array[0], start_ns, cycles, verdict)
        assert arm.memory["fault"]["code"] == Fault.NONE, (
            f"the last line of defence: {Fault(int(arm.memory['fault']['code'])).name}"
        )
        assert guilt == memory.SOUND, f"{memory.GUILT[guilt]}: {verdict[:5]}"
        assert arm.memory["mode"] == Mode.HOLDING
        assert arm.outcome(1) in (
            *(Outcome.SUCCEEDED, Outcome.RAN_DRY, Outcome.REFUSED_START, Outcome.REFUSED_LIMITS),
            *(Outcome.GOAL_TOLERANCE, Outcome.PATH_TOLERANCE, Outcome.PATH_VELOCITY, Outcome.PATH_ACCELERATION),
            *(Outcome.GOAL_VELOCITY, Outcome.GOAL_ACCELERATION),
        ), Outcome(arm.outcome(1)).name

    def _write(self, plan: GoalPlan) -> None:
        writer = self.arena.arm.writer
        writer.announce(1)
        writer.begin(
            1,
            start_ns=plan.start_ns,
            joint_mask=plan.joint_mask,
            goal_time_s=plan.terms.goal_time_s,
            entry=int(plan.entry),
            tolerances=plan.terms.path_tolerances,
            consumed=0,
            epoch=int(self.arena.arm.memory["goals"]["epoch"]),
        )
        for time_ns, order, joints in zip(plan.times_ns, plan.orders, plan.joints, strict=True):
            writer.waypoint(1, int(time_ns), int(order), joints, 0)
        writer.end(1, plan.terms.goal_tolerances, 0)

    def close(self) -> None:
        self.arena.close()


# --- as bytes ------------------------------------------------------------------------------------------------


def serialised(message: Any) -> bytes:
    """Little-endian CDR of a trajectory message."""
    body = bytearray(struct.pack("<iI", message.header.stamp.sec, message.header.stamp.nanosec))

    def align(to: int) -> None:
        body.extend(bytes(-len(body) % to))

    def text(value: str) -> None:
        align(4)
        data = value.encode() + b"\0"
        body.extend(struct.pack("<I", len(data)) + data)

    text("")
    align(4)
    body.extend(struct.pack("<I", len(message.joint_names)))
    for name in message.joint_names:
        text(name)
    align(4)
    body.extend(struct.pack("<I", len(message.points)))
    for point in message.points:
        for field in ("positions", "velocities", "accelerations", "effort"):
            values = getattr(point, field)
            align(4)
            body.extend(struct.pack("<I", len(values)))
            if values:
                align(8)
                body.extend(struct.pack(f"<{len(values)}d", *values))
        align(4)
        time = point.time_from_start
        body.extend(struct.pack("<iI", time.sec, time.nanosec))
    return b"\0\1\0\0" + bytes(body)


def damaged(random: np.random.Generator, data: bytes) -> bytes:
    """Bits flipped, counts replaced, ends cut off or lengthened; or as it was."""
    spoilt = bytearray(data)
    for _ in range(int(random.choice([0, 1, 1, 2, 8]))):
        at = int(random.integers(len(spoilt)))
        kind = random.integers(4)
        if kind == 0:
            spoilt[at] ^= 1 << int(random.integers(8))
        elif kind == 1:
            at = at // 4 * 4
            word = int(random.choice([0, 1, 6, 7, 255, 2**16, 2**31 - 1, 2**31, 2**32 - 1]))
            spoilt[at : at + 4] = struct.pack("<I", word)
        elif kind == 2:
            del spoilt[max(at, 1) :]
        else:
            spoilt[at:at] = random.bytes(int(random.integers(1, 20)))
    return bytes(spoilt)
