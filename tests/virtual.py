"""The control cycle and the simulated arm in virtual time: one object, advanced cycle by cycle.

Real bytes in both directions, the real cycle function, the real bring-up conversation; only time is ours.
"""

import json
import math
import mmap
import os
from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Self

import by_address
import numpy as np

from config.loader import load_arm
from config.schema import ArmConfig
from config.serial_adapters import SLCAN_BITRATES
from rtloop.dialogues.bringup import BringUp
from rtloop.dialogues.gripper import GripperDialogue
from rtloop.dialogues.healing import Healing
from rtloop.dialogues.referencing import Referencing, referencing_asked_for
from rtloop.dialogues.release import Release
from rtloop.drives.power import Marks
from rtloop.process import entries
from rtloop.process.initial_state import buses_of, new_loop, show_drives, show_limits
from rtloop.service.conversation import Conversation
from rtloop.service.port import ServicePort
from shm import layout
from shm.client import CommandWriter, StateReader
from shm.errors import RingFull
from shm.files import MemoryFile, name_bytes, write_buses
from shm.record import Record
from shm.recording import Recording, read_recording
from shm.words import Answer, Entry, Mode, Outcome, Phase, Request, Slowed, Unreferenced
from sim.arm import SimulatedArm

GOALS = Path(__file__).parent / "data" / "moveit"
START_NS = 1_000_000_000
STORES = (Request.STOP, Request.HOLD, Request.RESUME, Request.CANCEL, Request.SPEED_SCALE)


def private_file(record: type[Record], arm: ArmConfig) -> MemoryFile:
    """A memory file nobody else can find, with a valid header."""
    fd = os.memfd_create("rtarm-test")
    buses = buses_of(arm)
    rings = layout.rings(len(arm.joints), arm.control.period_ns, *(bus.bitrate for bus in buses))
    size = rings.file_bytes if record is layout.StateFile else record.dtype.itemsize
    os.truncate(fd, size)
    mapped = mmap.mmap(fd, size)
    memory = MemoryFile(Path("memfd"), fd, mapped, np.frombuffer(mapped, record.dtype, 1))
    header = memory.record["header"]
    header["joint_count"] = len(arm.joints)
    header["period_ns"] = arm.control.period_ns
    write_buses(header, buses)
    header["arm_name"] = name_bytes((arm.name,), 1)
    header["joint_names"] = name_bytes([joint.name for joint in arm.joints], layout.MAX_JOINTS)
    if record is layout.StateFile:
        memory.record["recorder"] = rings.described()
    return memory


def recorded_goal(name: str) -> dict[str, np.ndarray]:
    """times_ns (n,), joints (n, 6, 3) of a recorded MoveIt goal."""
    points = json.loads((GOALS / f"{name}.json").read_text())["trajectory"]["points"]
    times = [p["time_from_start"]["sec"] * 10**9 + p["time_from_start"]["nanosec"] for p in points]
    joints = [[p["positions"], p["velocities"], p["accelerations"]] for p in points]
    return {"times_ns": np.array(times), "joints": np.array(joints).transpose(0, 2, 1).copy()}


class VirtualArm:
    """An arm in virtual time; `cycle()` is one control period."""

    def __init__(
        self,
        arm: ArmConfig | str = "episode1",
        *,
        start_rad: Sequence[float] | None = None,
        faults: Sequence[Any] = (),
        seed: int = 0,
        jitter_ns: int = 100_000,
        opening: bytes | None = None,
        **sim_options: Any,
    ) -> None:
        self.arm = load_arm(arm) if isinstance(arm, str) else arm
        self.state = private_file(layout.StateFile, self.arm)
        self.command = private_file(layout.CommandFile, self.arm)
        self.loop = new_loop(self.arm, self.state.address, self.command.address)
        self.loop_address = self.loop.ctypes.data
        show_limits(self.state.record["limits"], self.loop)
        show_drives(self.state.record, self.arm)
        self.reader = StateReader(self.state)
        self.writer = CommandWriter(self.command)
        self.port = ServicePort(self.loop, entries)
        self.gripper: GripperDialogue | None = None
        self.healing: Healing | None = None
        self._healing_talk: Conversation | None = None
        self.now_ns = START_NS
        self.memory["goals"]["epoch"] = START_NS  # which is the real time of its start otherwise
        self.suspended_ns = 0
        self.random = np.random.default_rng(seed)
        self.jitter_ns = jitter_ns
        self.sent: list[tuple[int, bytes]] = []
        """What the wires took, and when; `sent_on` bus by bus."""
        self.sent_on: list[list[tuple[int, bytes]]] = [[] for _ in self.arm.buses]
        self.told: list[str] = []
        self.lost: dict[int, Unreferenced | None] = {}
        self.marks = Marks()
        self.held_rad: dict[int, float] = {}
        self.front_alive = True
        self.goal = 0
        self.pending: list[Callable[[], None]] = []
        self.sims: list[SimulatedArm] = []
        """What is on each bus; none with mock drives."""
        for number, part in enumerate(self.arm.parts if self.arm.bus.interface != "mock" else ()):
            sim = SimulatedArm(
                part,
                start_ns=START_NS,
                joint_position_rad=None
                if start_rad is None
                else [start_rad[joint] for joint in self.joints_on(number)],
                seed=seed + number,
                faults=faults if number == 0 else (),
                **sim_options,
            )
            given = opening
            if given is None and part.bus.interface == "slcan":
                given = f"C\r{SLCAN_BITRATES[part.bus.bitrate]}\rO\r".encode()
            if given:
                sim.feed(START_NS, given)
            self.sims.append(sim)
        self.sim = self.sims[0] if self.sims else None

    def joints_on(self, number: int) -> list[int]:
        """Numbers of the joints whose drives are on a bus."""
        return [joint for joint, config in enumerate(self.arm.joints) if self.arm.bus_number(config) == number]

    @classmethod
    def brought_up(cls, *arguments: Any, **options: Any) -> Self:
        """An arm that has been brought up."""
        made = cls(*arguments, **options)
        assert made.bring_up().failure is None, made.told
        return made

    @classmethod
    def at_start_of(cls, name: str, arm: ArmConfig | str = "episode1", **options: Any) -> Self:
        """An arm that has been brought up where a recorded goal begins."""
        return cls.brought_up(arm, start_rad=recorded_goal(name)["joints"][0, :, 0], **options)

    @classmethod
    def amid(cls, name: str, cycles: int = 120, **options: Any) -> Self:
        """An arm that has carried out a recorded goal for so many cycles; the goal's number is `goal`."""
        made = cls.at_start_of(name, **options)
        made.goal = made.play(name)
        made.cycles(cycles)
        assert made.memory["mode"] == Mode.EXECUTING
        return made

    @property
    def memory(self) -> np.void:
        """What the cycle remembers, `rtloop.memory.state.Loop`."""
        return self.loop[0]

    @property
    def period_ns(self) -> int:
        return self.arm.control.period_ns

    def listen(self, until_ns: int) -> None:
        """Push what the adapters send up to a time into the receive rings, each chunk with its time."""
        for number, sim in enumerate(self._listened_to()):
            from_ns = sim.now_ns
            arrivals = sim.arrivals(until_ns + self.suspended_ns)
            for sim_ns, together in groupby(arrivals, lambda arrival: max(arrival[0], from_ns)):  # noqa: B023
                self.receive(sim_ns - self.suspended_ns, b"".join(part for _, part in together), number)

    def _listened_to(self) -> list[SimulatedArm]:
        assert self.sim is not None
        return [self.sim, *self.sims[1:]]  # a test may have put another one in the place of the first

    def receive(self, time_ns: int, data: bytes, bus: int = 0) -> None:
        """Push bytes that came at a time into a bus' receive ring."""
        by_address.push(self.loop_address, time_ns, np.frombuffer(data, np.uint8), len(data), bus)

    def suspend(self, duration_s: float) -> None:
        """The machine sleeps between two cycles: the drives live on, the loop's clock stands still."""
        self.suspended_ns += round(duration_s * 1e9)
        self.memory["timing"]["suspended_ns"] = round(duration_s * 1e9)

    def cycle(self, periods: int = 1) -> None:
        """Let `periods` periods pass and run one cycle at the end of them."""
        self.now_ns += periods * self.period_ns
        if self.sim is not None:
            self.listen(self.now_ns)
        if self.front_alive:
            self.writer.beat(self.now_ns)
            self._feed_ring()
        if self.gripper is not None:
            self.gripper.poll(self.now_ns)
        if self.healing is not None:
            self._attend_healing(self.healing)
        if data := self.step(self.now_ns):
            self.write(data)
        for number in range(1, len(self.sims)):
            if data := self.for_the_wire(number):
                self.write(data, number)

    def step(self, now_ns: int) -> bytes:
        """Run the cycle that is planned for a time: the bytes that it leaves for the first wire."""
        by_address.step(self.loop_address, self.state.address, now_ns)
        return self.for_the_wire(0)

    def for_the_wire(self, number: int) -> bytes:
        """The bytes that wait for a bus' wire."""
        outgoing = self.loop[0]["buses"][number]["outgoing"]
        waits: bytes = outgoing["bytes"][: int(outgoing["length"])].tobytes()
        return waits

    def write(self, data: bytes, bus: int = 0) -> None:
        """Hand the cycle's bytes to the wire, as `rtloop.process.run` does with one write."""
        self.taken(len(data), bus)
        self.sent.append((self.now_ns, data))
        self.sent_on[bus].append((self.now_ns, data))
        if self.sim is not None:
            at = self.now_ns + int(self.random.integers(0, self.jitter_ns + 1))
            self._listened_to()[bus].feed(at + self.suspended_ns, data)

    def taken(self, count: int, bus: int = 0) -> None:
        """The wire has taken so many bytes of the cycle's."""
        by_address.took(self.loop_address, self.state.address, count, bus)

    @property
    def running(self) -> np.void:
        """The path that is active, with its goal's phase."""
        found: np.void = self.loop[0]["paths"][int(self.memory["goals"]["active"])]
        return found

    @property
    def running_goal(self) -> int:
        """Id of the goal that runs, 0 none."""
        return int(self.running["goal_id"]) if self.running["phase"] != Phase.NONE else 0

    @property
    def waiting_goal(self) -> int:
        """Id of the goal that waits to take over, 0 none."""
        newer = self.loop[0]["paths"][1 - int(self.memory["goals"]["active"])]
        return int(newer["goal_id"]) if newer["phase"] == Phase.WAITING else 0

    def is_slowed(self, why: Slowed) -> bool:
        """Whether this is among the reasons for which the clock is slowed down."""
        return bool(int(self.memory["goals"]["slowed"]) & why)

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.cycle()

    def until(self, condition: Callable[[], bool], *, at_most_s: float = 30.0) -> None:
        """Cycle until a condition holds; fails when it does not within virtual seconds."""
        for _ in range(math.ceil(at_most_s * 1e9 / self.period_ns)):
            if condition():
                return
            self.cycle()
        raise AssertionError(f"not within {at_most_s} virtual seconds; mode {Mode(int(self.memory['mode'])).name}")

    def bring_up(self, *, clears_protection: bool = False, at_most_s: float = 10.0, **known: Any) -> BringUp:
        """Run the conversation that brings the drives up; `known`: what the control process knows beforehand."""
        talk = self._begin_bring_up(clears_protection=clears_protection, **known)
        self.until(lambda: talk.poll(self.now_ns), at_most_s=at_most_s)
        self.cycles(2)
        self.until(lambda: self.memory["mode"] != Mode.BRINGING_UP, at_most_s=1.0)
        return talk

    def _begin_bring_up(self, **known: Any) -> BringUp:
        return BringUp(
            self.arm,
            self.port,
            now_ns=self.now_ns,
            tell=self.told.append,
            marks=self.marks,
            held_rad=self.held_rad,
            **known,
        )

    def clear_fault(self) -> BringUp:
        """Ask for a clear, which must be granted, and bring the drives up as the control process does then."""
        assert self.ask(Request.CLEAR_FAULT) == Answer.DONE
        self.until(lambda: bool(self.memory["dialogue"]["bring_up_asked"]), at_most_s=1.0)
        self.memory["dialogue"]["bring_up_asked"] = 0
        return self.bring_up(clears_protection=True)

    def heal_by_itself(self, *, unlocked: bool = True) -> None:
        """Go on after a stall by itself from now on, as the control process lets an arm do."""
        self.healing = Healing(self.arm, self.loop, self.port, self.marks, unlocked=unlocked)

    def _attend_healing(self, healing: Healing) -> None:
        if self._healing_talk is None:
            self._healing_talk = healing.begin(self.now_ns)
        elif self._healing_talk.poll(self.now_ns):
            healed = healing.succeeded(self._healing_talk, self.now_ns)
            self._healing_talk = self._begin_bring_up(clears_protection=False, heals=True) if healed else None

    def begin_with_gripper(self) -> None:
        """Let the conversation with the gripper's drive go on beside everything else."""
        self.gripper = GripperDialogue(
            self.arm, self.loop, self.port, self.state.array, now_ns=self.now_ns, tell=self.told.append
        )

    def next_process(self) -> Self:
        """Another control process at the same drives, which it has not brought up yet."""
        after = type(self)(self.arm)
        after.sim, after.marks = self.sim, self.marks
        after.now_ns = self.now_ns + 10_000_000
        assert after.sim is not None
        after.sim.feed(after.now_ns, f"C\r{SLCAN_BITRATES[after.arm.bus.bitrate]}\rO\r".encode())
        return after

    def release(self, *, at_most_s: float = 10.0) -> Release:
        """Run the conversation that lets the drives go; the request was made before."""
        self.until(lambda: bool(self.memory["dialogue"]["release_asked"]), at_most_s=1.0)
        self.memory["dialogue"]["release_asked"] = 0
        self.held_rad.clear()
        talk = Release(self.arm, self.port, now_ns=self.now_ns)
        self.until(lambda: talk.poll(self.now_ns), at_most_s=at_most_s)
        return talk

    def stop(self) -> None:
        """A person's stop, which the next cycle obeys."""
        self.writer.stop()
        self.cycle()

    def hold(self) -> None:
        self.writer.hold()
        self.cycle()

    def resume(self) -> None:
        self.writer.resume()
        self.cycle()

    def scale(self, speed_scale: float) -> None:
        self.writer.scale(speed_scale)
        self.cycle()

    def cancel(self, goal: int) -> None:
        self.writer.cancel(goal)
        self.cycle()

    def cancel_all(self) -> None:
        self.writer.cancel_all()
        self.cycle()

    def request(self, kind: Request, **options: Any) -> int:
        """Make a request; its number."""
        assert kind not in STORES, "which are the writer's methods"
        options = {"consumed": self.reader.requests_consumed(), "epoch": int(self.memory["goals"]["epoch"]), **options}
        return self.writer.request(kind, **options)

    def ask(self, kind: Request, **options: Any) -> Answer:
        """Make a request and run the cycles until it is answered."""
        sequence = self.request(kind, **options)
        self.cycle()
        answer = self.reader.snapshot()["answers"][sequence % layout.ANSWER_SLOTS]
        assert answer["sequence"] == sequence
        return Answer(int(answer["answer"]))

    def reference(self, *, at_most_s: float = 400.0, each_cycle: Callable[[], None] = lambda: None) -> Referencing:
        """Run the conversation that HOME or REFERENCE has asked for, as the control process does."""
        talk = referencing_asked_for(
            self.arm, self.loop, self.port, self.now_ns, self.told.append, self.lost.__setitem__, self.marks
        )

        def over() -> bool:
            each_cycle()
            if self.memory["dialogue"]["referencing_ends"] == 1:
                talk.end()
            return talk.poll(self.now_ns)

        self.until(over, at_most_s=at_most_s)
        self.cycles(2)
        return talk

    def reference_all(self) -> None:
        """Tell the joints that do not know their angle that it is where they stand, as a person would."""
        axes = self.loop[0]["axes"][: len(self.arm.joints)]
        unknown = sum(1 << number for number, axis in enumerate(axes) if not axis["reference"]["referenced"])
        if unknown:
            assert self.ask(Request.REFERENCE, joint_mask=unknown, value=math.nan) == Answer.DONE
            self.reference()

    # --- goals

    def _feed_ring(self) -> None:
        while self.pending:
            try:
                self.pending[0]()
            except RingFull:
                return
            self.pending.pop(0)

    def send_goal(
        self,
        times_ns: np.ndarray,
        joints: np.ndarray,
        *,
        order: int | np.ndarray = 5,
        end: bool = True,
        approach: bool = False,
        start_ns: int = 0,
        goal_id: int | None = None,
        joint_mask: int | None = None,
        stream: bool = False,
        tolerances: np.ndarray | Sequence[float] = (0.1, 0.0, 0.0),
        goal_tolerances: np.ndarray | Sequence[float] = (0.01, 0.05, 0.0),
        goal_time_s: float = 0.4,
        epoch: int | None = None,
    ) -> int:
        """Announce a goal and queue its records; they enter the ring as room allows."""
        count = len(self.arm.joints)
        goal = goal_id if goal_id is not None else self.writer.announced_goal + 1
        way, arrival = np.broadcast_to(tolerances, (count, 3)), np.broadcast_to(goal_tolerances, (count, 3))
        entry = (Entry.APPROACH if approach else 0) | (Entry.STREAM if stream else 0)
        mask = (1 << count) - 1 if joint_mask is None else joint_mask

        arrived = int(self.memory["goals"]["epoch"])

        def consumed() -> int:
            return self.reader.setpoints_consumed()

        self.pending = [lambda: self.writer.announce(goal)]
        self.pending.append(
            lambda: self.writer.begin(
                goal,
                start_ns=start_ns,
                joint_mask=mask,
                goal_time_s=goal_time_s,
                entry=entry,
                epoch=arrived if epoch is None else epoch,
                tolerances=way,
                consumed=consumed(),
            )
        )
        orders = np.broadcast_to(order, len(times_ns))
        for at, kind, waypoint in zip(times_ns, orders, joints, strict=True):
            self.pending.append(
                lambda at=at, kind=kind, waypoint=waypoint: self.writer.waypoint(
                    goal, int(at), int(kind), waypoint, consumed()
                )
            )
        if end:
            self.pending.append(lambda: self.writer.end(goal, arrival, consumed()))
        return goal

    def send_shift(self, by_rad: float = 0.05, duration_s: float = 2.0, **options: Any) -> int:
        """A goal that moves every joint by so much from where it is commanded to be, from rest to rest."""
        here = self.loop[0]["axes"]["commanded"]["position_rad"][: len(self.arm.joints)]
        joints = np.zeros((2, len(here), 3))
        joints[:, :, 0] = here, here + by_rad
        return self.send_goal(np.array([0, round(duration_s * 1e9)]), joints, **options)

    def play(self, name: str, **options: Any) -> int:
        goal = recorded_goal(name)
        return self.send_goal(goal["times_ns"], goal["joints"], **options)

    def play_part(self, name: str, share: float, **options: Any) -> int:
        """Send a recorded goal and let such a share of its time pass; its number."""
        goal = self.play(name, **options)
        self.cycles(max(2, int(share * recorded_goal(name)["times_ns"][-1] / self.period_ns)))
        return goal

    def result(self, goal: int) -> np.void:
        """What a goal that has ended was told."""
        found = self.reader.snapshot().find("results", "goal_id", goal)
        assert found is not None, f"goal {goal} is undecided, or so many later decisions cover it"
        return found

    def outcome(self, goal: int) -> int:
        found = self.reader.snapshot().find("results", "goal_id", goal)
        return Outcome.NONE if found is None else int(found["outcome"])

    def end_of(self, goal: int, *, at_most_s: float = 30.0) -> Outcome:
        """Cycle until a goal has ended; how it did."""
        self.until(lambda: self.outcome(goal) != Outcome.NONE, at_most_s=at_most_s)
        return Outcome(self.outcome(goal))

    def __del__(self) -> None:
        self.close()  # what a test that failed, or hypothesis, has left

    def close(self) -> None:
        self.reader.close()
        self.writer.close()


def recording_of(arm: VirtualArm) -> Recording:
    """What an arm's flight recorder has kept; the arm ends."""
    found = read_recording(arm.state)
    arm.close()
    return found
