"""What happens in the transcripts: each scenario plays one arm in virtual time, by what anybody may do and see.

They assert nothing but that they get where they want to be; what the control cycle says meanwhile is the transcript.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from bus_faults import FAULTS, GOES_ON, BusFault
from bus_trials import run_trial
from can_records import error_record
from fuzz import memory, wire
from fuzz.arena import OPENINGS, MemoryArena, WireArena
from fuzz.truth import Truth
from mixed_arm import mixed
from servo import Servo, SinglePoints, Way, waves
from two_buses import divided
from virtual import GOALS, VirtualArm, recorded_goal

from config.loader import known_arms, load_arm
from rtloop.process.run import take_over_wire
from rtloop.wire import can_words, received
from shm.snapshot import Snapshot
from shm.words import Mode, Outcome, Request
from sim.faults import PowerLoss, Protection, Silent, Stall, Thing

SPARSE = 24
"""Cycles from one set of fast words to the next, in scenarios of which there are many or which last long."""
JOINT2 = 0b000010


@dataclass(frozen=True)
class Scenario:
    """What is played, and in every which cycle its fast words are kept."""

    play: Callable[[], None]
    every: int = 1


SCENARIOS: dict[str, Scenario] = {}


def scenario(name: str, *, every: int = 1) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """Enter a function under its name."""

    def enter(play: Callable[[], None]) -> Callable[[], None]:
        SCENARIOS[name] = Scenario(play, every)
        return play

    return enter


@contextmanager
def standing(
    arm: Any = "episode1", *, goal: str = "small", overrides: Mapping[str, Any] | None = None, **options: Any
) -> Iterator[VirtualArm]:
    """An arm that holds at the beginning of a recorded goal, all its joints referenced."""
    config = load_arm(arm, overrides=dict(overrides or {})) if isinstance(arm, str) else arm
    if config.bus.interface != "mock":
        options.setdefault("start_rad", recorded_goal(goal)["joints"][0, :, 0])
    found = VirtualArm(config, **options)
    try:
        assert found.bring_up().failure is None
        unknown = [joint for joint, known in enumerate(shown(found)["joints"]["referenced"]) if not known]
        if mask := sum(1 << joint for joint in unknown if joint < len(config.joints)):
            found.ask(Request.REFERENCE, joint_mask=mask, value=math.nan)
            found.reference()
        yield found
    finally:
        found.close()


def shown(arm: VirtualArm) -> Snapshot:
    return arm.reader.snapshot()


def towards(arm: VirtualArm, by_rad: float = 0.1, seconds: float = 1.0, **options: Any) -> int:
    """A goal that moves every joint from where it is commanded; its number. An approach is a goal of its end alone."""
    joints = np.zeros((2, len(arm.arm.joints), 3))
    joints[:, :, 0] = shown(arm)["joints"]["commanded_position_rad"][: len(arm.arm.joints)]
    joints[1, :, 0] += by_rad
    first = 1 if options.get("approach") else 0
    return arm.send_goal(np.array([0, round(seconds * 1e9)])[first:], joints[first:], **options)


def finish(arm: VirtualArm, goal: int) -> None:
    """Cycle until a goal has its result and the arm stands, and a few cycles more."""
    arm.until(lambda: arm.outcome(goal) != Outcome.NONE and shown(arm)["goal_id"] != goal)
    arm.until(lambda: not shown(arm)["joints"]["commanded_velocity_rad_s"].any())
    arm.cycles(4)


def faulted(arm: VirtualArm) -> None:
    """Cycle until a fault is latched and the arm stands."""
    arm.until(lambda: shown(arm)["mode"] == Mode.FAULT)
    arm.until(lambda: not shown(arm)["joints"]["commanded_velocity_rad_s"].any() and shown(arm)["goal_id"] == 0)
    arm.cycles(30)


def play(name: str, arm: Any = "episode1", overrides: Mapping[str, Any] | None = None, **options: Any) -> None:
    """Play a recorded goal to its end."""
    with standing(arm, goal=name, overrides=overrides, **options) as here:
        finish(here, here.play(name))


# --- goals, drive families, wires ------------------------------------------------------------------------------

LONG = ("around_box", "joint2_end", "near_limits_high", "near_limits_low", "scale_0_1")

for _path in sorted(GOALS.glob("*.json")):
    SCENARIOS[f"goal-{_path.stem}"] = Scenario(partial(play, _path.stem), SPARSE if _path.stem in LONG else 1)


def family(arm: Any) -> None:
    """What every drive can do: a goal that another one replaces, a cancel, limp and enabled again, silent and back."""
    with standing(arm) as here:
        here.play("small")
        here.cycles(20)
        second = towards(here, 0.05, approach=True)
        here.cycles(20)
        here.cancel(second)
        finish(here, second)
        here.ask(Request.DISABLE)
        here.release()
        here.cycles(10)
        here.ask(Request.ENABLE)
        here.until(lambda: bool(here.memory["dialogue"]["bring_up_asked"]))
        here.memory["dialogue"]["bring_up_asked"] = 0
        here.bring_up(clears_protection=True)
        if here.sim is not None:
            towards(here, 0.05)
            here.sim.inject(Silent("joint2", at_s=0.1, until_s=0.6), since_ns=here.now_ns)
            faulted(here)
            here.cycles(50)
            here.clear_fault()


for _arm in known_arms():
    SCENARIOS[f"family-{_arm}"] = Scenario(partial(play, "small", _arm))
    SCENARIOS[f"family-{_arm}-life"] = Scenario(partial(family, _arm), SPARSE)
SCENARIOS["family-mixed"] = Scenario(partial(play, "small", mixed()), SPARSE)

OPTIONS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "socketcan": ({"bus": {"interface": "socketcan"}}, {}),
    "seeedstudio": (
        {"bus": {"interface": "seeedstudio", "bitrate": 500_000}},
        {"opening": OPENINGS["seeedstudio"]},
    ),
    "ch340-at": ({"bus": {"interface": "ch340-at", "bitrate": 1_000_000}}, {"opening": OPENINGS["ch340-at"]}),
    "slcan-canable": ({}, {"dialect": "canable"}),
    "acknowledged": ({"bus": {"acknowledge": True}, "control": {"rate_hz": 100.0}}, {}),
    "reported": ({"bus": {"positions": "reported"}}, {}),
    "fast-targets": ({"bus": {"position_command": "FC"}}, {}),
    "old-firmware": ({}, {"firmware": "old"}),
}
for _name, (_overrides, _options) in OPTIONS.items():
    SCENARIOS[f"wire-{_name}"] = Scenario(partial(play, "small", overrides=_overrides, **_options), SPARSE)


# --- what people and clients do --------------------------------------------------------------------------------


@scenario("pause")
def pause() -> None:
    with standing() as arm:
        goal = towards(arm)
        arm.cycles(40)
        arm.hold()
        arm.cycles(90)
        arm.resume()
        finish(arm, goal)
        arm.resume()
        arm.hold()


@scenario("speed-scale")
def speed_scale() -> None:
    with standing() as arm:
        goal = towards(arm)
        for factor in (0.3, -0.1, math.nan, 0.0, 1.0):
            arm.cycles(25)
            arm.scale(factor)
        finish(arm, goal)


@scenario("cancel")
def cancel() -> None:
    with standing() as arm:
        arm.cancel_all()
        goal = towards(arm)
        arm.cycles(50)
        arm.cancel(goal)
        finish(arm, goal)
        waiting = towards(arm, start_ns=arm.now_ns + 10**9)
        arm.cycles(10)
        arm.cancel(waiting)
        arm.writer.cancel(waiting + 1)
        finish(arm, towards(arm))


@scenario("replacement")
def replacement() -> None:
    with standing() as arm:
        towards(arm)
        arm.cycles(50)
        towards(arm, -0.1, approach=True)
        arm.cycles(30)
        finish(arm, towards(arm, 0.05, approach=True, joint_mask=0b000101))


@scenario("replacement-refused")
def replacement_refused() -> None:
    with standing() as arm:
        first = towards(arm)
        arm.cycles(30)
        far = np.zeros((2, 6, 3))
        far[:, 3, 0] = 1.5
        finish(arm, arm.send_goal(np.array([0, 10**9]), far))
        finish(arm, first)


@scenario("stopped-by-a-person")
def stopped_by_a_person() -> None:
    with standing() as arm:
        arrived = int(shown(arm)["epoch"])
        goal = towards(arm)
        arm.cycles(50)
        arm.stop()
        finish(arm, goal)
        finish(arm, towards(arm))
        arm.ask(Request.HOME, joint_mask=JOINT2)
        arm.resume()
        finish(arm, towards(arm, epoch=arrived))
        arm.ask(Request.HOME, joint_mask=JOINT2, epoch=arrived)
        goal = towards(arm)
        arm.cycles(30)
        arm.hold()
        arm.cycles(60)
        arm.stop()
        finish(arm, goal)


@scenario("start-times")
def start_times() -> None:
    with standing() as arm:
        finish(arm, towards(arm, start_ns=arm.now_ns + 200_000_000))
        finish(arm, towards(arm, -0.1, start_ns=arm.now_ns - 200_000_000))


@scenario("refused-goals")
def refused_goals() -> None:
    with standing() as arm:
        here = shown(arm)["joints"]["commanded_position_rad"][:6]
        for joint, column, value in ((3, 0, 0.2), (2, 0, math.nan), (1, 1, 50.0), (0, 0, 40.0)):
            joints = np.zeros((3, 6, 3))
            joints[:, :, 0] = here
            joints[0 if value == 0.2 else 1, joint, column] += value
            finish(arm, arm.send_goal(np.array([0, 10**9, 2 * 10**9]), joints))
        backwards = np.zeros((3, 6, 3))
        backwards[:, :, 0] = here
        finish(arm, arm.send_goal(np.array([0, 2 * 10**9, 10**9]), backwards))
        arm.ask(Request.DISABLE)
        arm.release()
        finish(arm, towards(arm))
        arm.ask(Request.GRIP, value=0.1)


@scenario("unreferenced")
def unreferenced() -> None:
    arm = VirtualArm(homed=False)
    arm.bring_up()
    finish(arm, towards(arm))
    arm.close()


@scenario("tolerances")
def tolerances() -> None:
    with standing() as arm:
        finish(arm, towards(arm, tolerances=(0.0, 0.05, 0.0)))
        finish(arm, towards(arm, tolerances=(0.0, 0.0, 0.2)))
        assert arm.sim is not None
        arm.sim.inject(Stall("joint3", at_s=0.2), since_ns=arm.now_ns)
        finish(arm, towards(arm, tolerances=(0.01, 0.0, 0.0)))
        finish(arm, towards(arm, 0.02, goal_time_s=0.3))


@scenario("starved")
def starved() -> None:
    with standing() as arm:
        rows = np.zeros((30, 6, 3))
        phase = np.linspace(0.0, 1.0, 30)
        rows[:, :, 0] = shown(arm)["joints"]["commanded_position_rad"][:6] + (0.2 * phase**2)[:, None]
        rows[:, :, 1] = (0.4 * phase / 2.9)[:, None]
        goal = arm.send_goal(np.arange(30) * 100_000_000, rows, order=3)
        del arm.pending[14:]
        finish(arm, goal)


@scenario("front-lost")
def front_lost() -> None:
    with standing() as arm:
        goal = towards(arm, 0.2, 2.0)
        arm.cycles(50)
        arm.front_alive = False
        finish(arm, goal)
        arm.front_alive = True
        finish(arm, towards(arm))


@scenario("shutdown")
def shutdown() -> None:
    with standing() as arm:
        goal = towards(arm)
        arm.cycles(50)
        arm.memory["motion"]["closing"] = 1
        finish(arm, goal)


@scenario("clock-gaps")
def clock_gaps() -> None:
    with standing() as arm:
        goal = towards(arm)
        arm.cycles(30)
        arm.cycle(periods=3)
        arm.cycles(20)
        arm.cycle(periods=40)
        finish(arm, goal)
        goal = towards(arm)
        arm.cycles(30)
        arm.suspend(2.0)
        finish(arm, goal)


@scenario("too-fast-and-too-hard")
def too_fast_and_too_hard() -> None:
    with standing() as arm:
        for by_rad, seconds in ((0.2, 1.0), (0.02, 0.2)):
            finish(arm, towards(arm, by_rad, seconds))
            if shown(arm)["mode"] == Mode.FAULT:
                arm.clear_fault()


@scenario("out-of-its-limits")
def out_of_its_limits() -> None:
    """The curve leads out between points that lie inside."""
    lower_rad = load_arm("episode1").joints[2].lower_rad
    with standing(start_rad=[0.0, 0.0, lower_rad + 0.01, 0.0, 0.0, 0.0]) as arm:
        curve = np.zeros((2, 6, 3))
        curve[:, :, 0] = shown(arm)["joints"]["commanded_position_rad"][:6]
        curve[1, 2, 1] = 0.2
        finish(arm, arm.send_goal(np.array([0, 10**9]), curve, order=3))
        arm.cycles(30)


@scenario("long-trajectory", every=SPARSE)
def long_trajectory() -> None:
    with standing("mock") as arm:
        way = np.linspace(0.0, 1.0, 5000)
        rows = np.zeros((5000, 6, 3))
        rows[:, :, 0] = (0.2 * way * way * (3.0 - 2.0 * way))[:, None]
        rows[:, :, 1] = (1.2 * way * (1.0 - way) / 4.999)[:, None]
        finish(arm, arm.send_goal(np.arange(5000) * 1_000_000, rows, order=3))


# --- as fast as may be -----------------------------------------------------------------------------------------

SWING_S = 0.8
HARDEST = 1.6
"""Of the joints' acceleration limits: between that of a stop and that of the last line of defence."""
AT_SPEED = (0.595, 0.68, 0.77)
"""Shares of a swing after which a ramp of the clock has to fit beside what the plan asks for."""


def swings(arm: VirtualArm, count: int) -> int:
    """A goal to and fro whose every swing brings each joint to its highest velocity, or close to what is let pass."""
    joints = np.zeros((count + 1, len(arm.arm.joints), 3))
    for joint, row in enumerate(arm.arm.joints):
        here = float(shown(arm)["joints"]["commanded_position_rad"][joint])
        side = 1.0 if here < (row.lower_rad + row.upper_rad) / 2 else -1.0
        room = row.upper_rad - here if side > 0.0 else here - row.lower_rad
        # a quintic from rest to rest has 15/8 of the mean velocity at most, and 10/√3 of way / time²
        fastest, hardest = row.max_velocity_rad_s, HARDEST * row.max_acceleration_rad_s2
        way = min(fastest * SWING_S / 1.875, hardest * SWING_S**2 / 5.7736, 0.95 * room)
        joints[:, joint, 0] = here
        joints[1::2, joint, 0] += side * way
    return arm.send_goal(np.arange(count + 1) * round(SWING_S * 1e9), joints)


def until_swing(arm: VirtualArm, goal: int, swing: float) -> None:
    """Cycle until so many swings of a goal have passed."""
    until_clock(arm, goal, swing * SWING_S)


def until_clock(arm: VirtualArm, goal: int, seconds: float) -> None:
    """Cycle until so much of a goal's path time has passed."""
    arm.until(lambda: shown(arm)["goal_id"] == goal and shown(arm)["trajectory_clock_ns"] >= round(seconds * 1e9))


@scenario("pause-at-speed", every=SPARSE)
def pause_at_speed() -> None:
    with standing() as arm:
        goal = swings(arm, 2 * len(AT_SPEED))
        for number, share in enumerate(AT_SPEED):
            until_swing(arm, goal, 2 * number + share)
            arm.hold()
            arm.until(lambda: shown(arm)["speed_scale"] == 0.0)
            arm.resume()
        finish(arm, goal)


@scenario("speed-scale-at-speed", every=SPARSE)
def speed_scale_at_speed() -> None:
    with standing() as arm:
        goal = swings(arm, 2 * len(AT_SPEED))
        for number, share in enumerate(AT_SPEED):
            until_swing(arm, goal, 2 * number + share)
            arm.scale(0.4)
            until_swing(arm, goal, 2 * number + 1 + share)
            arm.scale(1.0)
        finish(arm, goal)


@scenario("cancel-at-speed", every=SPARSE)
def cancel_at_speed() -> None:
    with standing() as arm:
        for share in AT_SPEED:
            goal = swings(arm, 2)
            until_swing(arm, goal, share)
            arm.cancel(goal)
            finish(arm, goal)


@scenario("replacement-at-speed", every=SPARSE)
def replacement_at_speed() -> None:
    with standing() as arm:
        until_swing(arm, swings(arm, 2), 0.5)
        until_clock(arm, towards(arm, 0.05, approach=True), 0.4)
        arm.scale(0.1)
        arm.until(lambda: shown(arm)["speed_scale"] == 0.1)
        second = towards(arm, -0.05, approach=True)
        arm.cycles(20)
        arm.scale(1.0)
        finish(arm, second)
        finish(arm, towards(arm, 0.1724, approach=True))  # joint2 at 98 % of what is let pass


@scenario("starved-at-speed", every=SPARSE)
def starved_at_speed() -> None:
    with standing() as arm:
        goal = swings(arm, 4)
        del arm.pending[5:]
        finish(arm, goal)


@scenario("end-in-motion", every=SPARSE)
def end_in_motion() -> None:
    """At a last point that moves: at its pace, and after a pause shortly before it."""
    with standing() as arm:
        for stream in (False, True):
            for paused in (False, True):
                ends = np.zeros((2, 6, 3))
                ends[:, :, 0] = shown(arm)["joints"]["commanded_position_rad"][:6]
                ends[1] += (0.1, 0.2, 0.0)
                goal = arm.send_goal(np.array([0, 10**9]), ends, stream=stream)
                if paused:
                    until_clock(arm, goal, 0.8)
                    arm.hold()
                    arm.until(lambda: shown(arm)["speed_scale"] == 0.0)
                    arm.resume()
                finish(arm, goal)


# --- streams ---------------------------------------------------------------------------------------------------


def rounded(way: Way) -> Way:
    """The same on every processor, whose sines and cosines differ in their last bits."""

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        position, velocity = way(t)
        return np.round(position, 9), np.round(velocity, 9)

    return at


@scenario("stream-of-windows")
def stream_of_windows() -> None:
    with standing() as arm:
        Servo(arm, rounded(waves(arm, 0.5, 1)), 50.0).run(1.2)
        arm.until(lambda: shown(arm)["mode"] == Mode.HOLDING)


@scenario("stream-of-points")
def stream_of_points() -> None:
    with standing() as arm:
        sender = SinglePoints(arm, rounded(waves(arm, 0.4, 2)), 100.0, velocities=True)
        sender.run(1.0)
        arm.stop()
        sender.run(0.3)
        arm.until(lambda: shown(arm)["mode"] == Mode.HOLDING)
        arm.resume()
        SinglePoints(arm, rounded(waves(arm, 0.05, 3)), 50.0, velocities=False).run(0.6)
        arm.until(lambda: shown(arm)["mode"] == Mode.HOLDING)


# --- homing, referencing, gripper, limp drives -----------------------------------------------------------------

NEAR_STOPS_RAD = np.round(np.radians((-176.0, -86.0, -79.0, -25.0, -105.0, -20.0)), 9)


@scenario("homing", every=SPARSE)
def homing() -> None:
    with standing(start_rad=NEAR_STOPS_RAD) as arm:
        arm.ask(Request.HOME)
        arm.reference()
        finish(arm, towards(arm, 0.05))


@scenario("homing-ended", every=SPARSE)
def homing_ended() -> None:
    for_ns = []

    def stop() -> None:
        for_ns.append(arm.now_ns)
        if len(for_ns) == 40:
            arm.writer.stop()

    with standing() as arm:
        arm.ask(Request.HOME, joint_mask=JOINT2)
        arm.ask(Request.FREE)
        arm.reference(each_cycle=stop)
        arm.cycles(60)
        arm.resume()
        finish(arm, towards(arm))
        arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.nan)
        arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=40.0)
        arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=0.1)
        arm.reference()
        finish(arm, towards(arm, 0.02))


@scenario("homing-not-found", every=SPARSE)
def homing_not_found() -> None:
    with standing(overrides={"homing": {"timeout_s": 2.0}}, start_rad=[0.0] * 6) as arm:
        arm.ask(Request.HOME, joint_mask=JOINT2)
        arm.reference()
        arm.clear_fault()


@scenario("limp", every=4)
def limp() -> None:
    with standing() as arm:
        towards(arm, 0.05)
        arm.cycles(10)
        arm.ask(Request.FREE)
        arm.until(lambda: shown(arm)["mode"] == Mode.HOLDING)
        for kind in (Request.FREE, Request.DISABLE):
            arm.ask(kind)
            arm.release()
            arm.cycles(20)
            finish(arm, towards(arm, 0.05))
            arm.ask(Request.ENABLE)
            arm.until(lambda: bool(arm.memory["dialogue"]["bring_up_asked"]))
            arm.memory["dialogue"]["bring_up_asked"] = 0
            arm.bring_up(clears_protection=True)
        finish(arm, towards(arm, 0.05))


@scenario("silent-while-free", every=SPARSE)
def silent_while_free() -> None:
    with standing() as arm:
        assert arm.sim is not None
        arm.ask(Request.FREE)
        arm.sim.inject(Silent("joint3", at_s=0.0, until_s=3.0), since_ns=arm.now_ns)
        arm.release()
        arm.cycles(30)


@scenario("goes-on-after-a-stall", every=SPARSE)
def goes_on_after_a_stall() -> None:
    with standing() as arm:
        assert arm.sim is not None
        arm.heal_by_itself()
        arm.send_shift()
        arm.cycles(60)
        for joint in arm.arm.joints:
            arm.sim.inject(Silent(joint.name, at_s=0.0, until_s=0.2), since_ns=arm.now_ns)
        arm.until(lambda: bool(arm.memory["dialogue"]["healed_ns"]) and arm.memory["mode"] == Mode.HOLDING)
        arm.end_of(arm.send_shift(stream=True))
        arm.resume()
        arm.end_of(arm.send_shift(stream=True))


@scenario("gripper", every=SPARSE)
def gripper() -> None:
    with standing(overrides={"gripper": {"hook": "servo", "servo": {"address": 7, "nm_per_ampere": 0.5}}}) as arm:
        assert arm.sim is not None
        arm.begin_with_gripper()
        arm.cycles(60)
        arm.ask(Request.GRIP, value=1.2)
        goal = towards(arm)
        arm.cycles(80)
        arm.ask(Request.GRIP_STOP)
        arm.cycles(40)
        arm.ask(Request.GRIP, value=9.0)
        arm.sim.inject(Thing(0.0, 40.0), arm.now_ns)
        arm.ask(Request.GRIP, value=0.0, effort=0.25)
        arm.cycles(240)
        arm.ask(Request.GRIP_HOME)
        arm.cycles(120)
        finish(arm, goal)


# --- faults ----------------------------------------------------------------------------------------------------


@scenario("bring-up-fails")
def bring_up_fails() -> None:
    arm = VirtualArm(faults=[Silent("joint4", at_s=0.0)])
    arm.bring_up()
    finish(arm, towards(arm))
    arm.close()


@scenario("power-lost")
def power_lost() -> None:
    with standing(goal="large") as arm:
        assert arm.sim is not None
        arm.play("large")
        arm.cycles(60)
        arm.sim.inject(PowerLoss("joint2", 0.0, off_s=0.03), since_ns=arm.now_ns)
        faulted(arm)
        arm.clear_fault()
        finish(arm, towards(arm, 0.02))
        arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=0.1)
        arm.reference()
        finish(arm, towards(arm, 0.02))


@scenario("protection-trips")
def protection_trips() -> None:
    with standing() as arm:
        assert arm.sim is not None
        towards(arm)
        arm.sim.inject(Protection("joint4", 0.3), since_ns=arm.now_ns)
        faulted(arm)
        arm.clear_fault()
        finish(arm, towards(arm, 0.02))


@scenario("command-ring-corrupt")
def command_ring_corrupt() -> None:
    with standing() as arm:
        goal = towards(arm)
        arm.cycles(40)
        arm.writer.announce(2**60)
        arm.cycles(3)
        arm.ask(Request.CLEAR_FAULT)
        arm.writer.announce(goal)
        faulted(arm)
        arm.clear_fault()
        finish(arm, towards(arm, 0.02))


def gone_and_back(arm: Any, error: int, bus: int = 0) -> None:
    with standing(arm) as here:
        towards(here)
        here.cycles(40)
        row = here.loop[0]["buses"][bus]
        received.close(row, error)
        here.cycles(5)
        here.ask(Request.CLEAR_FAULT)
        row["received"]["arrived"]["closed"] = 0
        row["wire"]["fd"] = 7
        take_over_wire(here.loop[0], here.state.array[0], row)
        faulted(here)
        here.clear_fault()
        finish(here, towards(here, 0.02))


SCENARIOS["wire-gone-and-back"] = Scenario(partial(gone_and_back, "episode1", 5))
ON_SOCKETCAN = load_arm("episode1", overrides={"bus": {"interface": "socketcan"}})
SCENARIOS["link-down-and-up"] = Scenario(partial(gone_and_back, ON_SOCKETCAN, 100), SPARSE)

# --- two buses -------------------------------------------------------------------------------------------------

for _arm in ("episode1", "damiao6", "cia402_6"):
    SCENARIOS[f"two-buses-{_arm}"] = Scenario(partial(family, divided(_arm)), SPARSE)
SCENARIOS["two-buses-one-gone-and-back"] = Scenario(partial(gone_and_back, divided("episode1"), 5, 1), SPARSE)


@scenario("controller-errors")
def controller_errors() -> None:
    with standing(overrides={"bus": {"interface": "socketcan"}}) as arm:
        towards(arm)
        for kind, detail in (
            (can_words.CONTROLLER | can_words.NO_ACKNOWLEDGE, b"\0\x20"),
            (can_words.BUS_OFF, b""),
            (can_words.RESTARTED, b""),
        ):
            arm.cycles(30)
            arm.receive(arm.now_ns, error_record(kind, detail))
        faulted(arm)
        arm.clear_fault()


def trial(fault: BusFault, seed: int) -> None:
    """A fault of the bus, as `bus_trials` judges it."""
    run_trial(fault, seed)


for _fault in FAULTS:
    for _seed in range(1 if GOES_ON in _fault.latched else 2):  # what latches nothing differs less
        _name = "".join(letter if letter.isalnum() else " " for letter in _fault.name.lower()).split()
        SCENARIOS[f"bus-{'-'.join(_name)}-{_seed}"] = Scenario(partial(trial, _fault, _seed), SPARSE)


# --- hostile writers and drives --------------------------------------------------------------------------------


def truth(seed: int) -> None:
    """The hostile writer, with simulated drives behind the cycle."""
    Truth().case(np.random.default_rng(seed))


def hostile_memory(seed: int) -> None:
    """As `fuzz.memory.run_case`, cycle by cycle: cases of every kind of writer against the mock arm."""
    arena = MemoryArena()
    loop, shared, fresh = arena.arm.loop[0], arena.arm.state.array[0], arena.arm.loop.copy()
    command, box = arena.arm.command.address, np.zeros(1)
    memory.reseed(seed)
    for case in range(9):
        memory.refresh(loop, fresh.ctypes.data, case)
        memory.place(loop)
        now_ns, goal = int(loop["timing"]["now_ns"]), 0
        for cycle in range(memory.CYCLES):
            now_ns += arena.arm.period_ns
            arena.arm.writer.beat(now_ns)
            goal = memory.write_hostile(loop, command, case % 3, goal, box)
            arena.arm.step(now_ns)
            if loop["dialogue"]["bring_up_asked"] == 1:
                memory.bring_up(loop, shared)
            if loop["fault"]["code"] != 0 and cycle % 5 == 0:
                memory.put_request(loop, command, 0.0, box)
                memory.clear_fault(command)
    arena.close()


def hostile_wire(interface: str, seed: int) -> None:
    """As `fuzz.wire.run_case`, cycle by cycle: bytes of every kind from the adapter."""
    arena = WireArena(interface=interface)
    loop, fresh = arena.arm.loop[0], arena.arm.loop.copy()
    out, box = np.zeros(wire.MOST_BYTES, np.uint8), np.zeros(1)
    memory.reseed(seed)
    for case in range(5):
        memory.refresh(loop, fresh.ctypes.data, case)
        now_ns = int(arena.arm.memory["timing"]["now_ns"])
        for cycle in range(wire.CYCLES):
            now_ns += arena.arm.period_ns
            arena.arm.writer.beat(now_ns)
            if cycle % 12 == 1:
                memory.put_goal(loop, arena.arm.command.address, 1 + cycle, 0.0, box)
            at = wire.put_answers(loop, out, 0, 0.2 * (case % 2))
            for number in range((cycle + case) % 4):
                put = wire.put_noise if number == 2 else wire.put_hostile_frame
                at = put(loop, out, at)
            if cycle % 3 == 0:
                at = wire.spoil(out, at)
            wire.bring(loop, out, at, now_ns)
            arena.arm.step(now_ns)
            arena.arm.memory["buses"][0]["outgoing"]["length"] = 0
    arena.close()


for _seed in (1, 2, 3):
    SCENARIOS[f"hostile-writer-{_seed}"] = Scenario(partial(truth, _seed), SPARSE)
    SCENARIOS[f"hostile-memory-{_seed}"] = Scenario(partial(hostile_memory, _seed), SPARSE)
    for _interface in ("slcan", *OPENINGS):
        SCENARIOS[f"hostile-{_interface}-{_seed}"] = Scenario(partial(hostile_wire, _interface, _seed), SPARSE)
