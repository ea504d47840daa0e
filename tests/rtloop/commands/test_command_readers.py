"""What the loop does with a command file that is wrong, hostile or half written: a name, never motion.

The arm is the mock one in virtual time; what the front would write is written here by hand, with a right or
a wrong CRC. After every cycle the setpoint itself is judged, by differencing.
"""

import struct
import zlib

import numpy as np
import pytest
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.commands.setpoint_reader import CYCLES_TO_BECOME_VISIBLE, records_a_cycle
from shm import layout
from shm.errors import RingFull
from shm.record import offset_of
from shm.words import Answer, Fault, Mode, Outcome, Request, Setpoint

BODY_AT = offset_of(layout.CommandFile, "front_pid")
GOAL_S = 4.0

trials = settings(
    max_examples=examples(25),
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example],
)
words = st.one_of(
    st.integers(-(2**63), 2**63 - 1),
    st.sampled_from([-(2**63), -1, 0, 1, 2, 3, 5, 64, 65, 4095, 4096, 4097, 2**31, 2**32, 2**62, 2**63 - 1]),
)
numbers = st.one_of(
    st.floats(),
    st.sampled_from([float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 1e-308, -0.0, 1e12, 0.3, -0.3]),
)


class Judged(VirtualArm):
    """A mock arm whose every setpoint is checked against its limits as it is made."""

    def __init__(self):
        super().__init__("mock")
        self.limits = [
            (joint.lower_rad, joint.upper_rad, joint.max_velocity_rad_s, joint.max_acceleration_rad_s2)
            for joint in self.arm.joints
        ]
        assert self.bring_up().failure is None
        self.positions = [self.commanded()] * 2

    def commanded(self):
        return self.loop[0]["axes"]["commanded"]["next_position_rad"][: len(self.arm.joints)].copy()

    def cycle(self, periods=1):
        super().cycle(periods)
        if not hasattr(self, "positions"):
            return
        self.positions = [*self.positions[-2:], self.commanded()]
        period_s = self.period_ns * 1e-9
        lower, upper, velocity, acceleration = np.array(self.limits).T
        newest = self.positions[-1]
        assert np.isfinite(newest).all()
        assert (newest >= lower - 1e-3).all() and (newest <= upper + 1e-3).all()
        v = np.diff(self.positions, axis=0) / period_s
        assert (np.abs(v[-1]) <= 1.0501 * velocity).all()
        assert (np.abs(v[-1] - v[-2]) / period_s <= 2.0001 * acceleration + 1e-9).all()
        mode, fault = int(self.memory["mode"]), int(self.memory["fault"]["code"])
        assert mode in list(Mode) and fault in list(Fault)
        assert (mode == Mode.FAULT) == (fault != Fault.NONE)

    @property
    def fault(self):
        return Fault(int(self.memory["fault"]["code"]))

    @property
    def mode(self):
        return Mode(int(self.memory["mode"]))

    def wave(self, points=81, **options):
        """A goal of some seconds, gently there and back; its id."""
        times = np.linspace(0, GOAL_S, points)
        w = 2 * np.pi / GOAL_S
        shape = np.stack([1 - np.cos(w * times), w * np.sin(w * times), w * w * np.cos(w * times)], axis=-1)
        joints = 0.05 * shape[:, None, :] * np.ones((1, len(self.limits), 1))
        joints[:, :, 0] += self.commanded()
        return self.send_goal((times * 1e9).astype(int), joints, **options)

    def executing(self):
        goal = self.wave()
        self.until(lambda: self.mode == Mode.EXECUTING)
        self.cycles(40)
        assert np.abs(self.positions[-1] - self.positions[-2]).max() > 0
        return goal

    def put(self, kind, *, goal_id, words=(0, 0, 0, 0, 0), numbers=None, sequence=None, crc=None):
        """A record at the head of the setpoint ring, right in all that is not named."""
        count = len(self.limits)
        written = self.writer.setpoints_written
        values = np.zeros(3 * count) if numbers is None else np.asarray(numbers, float)
        body = struct.pack("<qqq", written if sequence is None else sequence, goal_id, kind)
        body += (
            b"".join(struct.pack("<d" if isinstance(word, float) else "<q", word) for word in words)
            + values.astype("<f8").tobytes()
        )
        at = (
            offset_of(layout.CommandFile, "setpoints")
            + (written % layout.SETPOINT_SLOTS) * layout.Setpoint.dtype.itemsize
        )
        whole = struct.pack("<q", zlib.crc32(body) if crc is None else crc) + body
        self.command.map[at : at + len(whole)] = whole
        self.set_word("setpoints_written", written + 1)

    def set_word(self, name, value):
        self.command.record[name][0] = value

    def begin(self, goal_id, *, start_ns=0, mask=0b111111, goal_time_s=0.4, entry=0, tolerances=None):
        self.set_word("announced_goal", goal_id)
        rows = np.tile((0.1, 0.0, 0.0), len(self.limits)) if tolerances is None else tolerances
        self.put(
            Setpoint.BEGIN,
            goal_id=goal_id,
            words=(start_ns, mask, float(goal_time_s), entry, int(self.memory["goals"]["epoch"])),
            numbers=rows,
        )

    def waypoint(self, goal_id, time_ns, position, order=5, velocity=0.0, acceleration=0.0):
        rows = np.stack(np.broadcast_arrays(position, velocity, acceleration, np.zeros(len(self.limits)))[:3], -1)
        self.put(Setpoint.WAYPOINT, goal_id=goal_id, words=(time_ns, order, 0, 0, 0), numbers=rows.ravel())

    def end(self, goal_id):
        self.put(Setpoint.END, goal_id=goal_id)


@pytest.fixture
def arm():
    made = Judged()
    yield made
    made.close()


def comes_to_rest(arm):
    arm.until(lambda: arm.mode not in (Mode.EXECUTING, Mode.STOPPING) and not arm.running_goal, at_most_s=20)
    arm.cycles(3)
    assert np.ptp(arm.positions, axis=0).max() == 0


# --- the ring itself ------------------------------------------------------------------------------------


def test_a_cycle_takes_a_bounded_batch(arm):
    goal = arm.wave(points=1000)
    arm.cycle()
    most = records_a_cycle(6, arm.period_ns)
    assert arm.reader.setpoints_consumed() == most
    arm.until(lambda: arm.running_goal == goal)
    arm.cycles(1002 // most + 1)
    assert arm.reader.setpoints_consumed() == 1002


@pytest.mark.parametrize(
    ("joints", "rate_hz", "most"), [(1, 120, 256), (6, 120, 160), (6, 2000, 160), (32, 125, 41), (32, 20, 246)]
)
def test_a_longer_period_pays_for_a_larger_batch(joints, rate_hz, most):
    assert records_a_cycle(joints, round(1e9 / rate_hz)) == most


def test_a_goal_of_many_joints_does_not_starve_beside_a_full_ring_in_slow_cycles():
    """32 joints at 20 Hz with a point a millisecond: 50 records a cycle are used up."""
    mock = load_arm("mock", overrides={"control": {"rate_hz": 20}}).model_dump()
    mock["joints"] = [{**mock["joints"][0], "name": f"joint{number}"} for number in range(32)]
    arm = VirtualArm.brought_up(ArmConfig.model_validate(mock))
    times = np.arange(6001) * 1e-3
    w = 2 * np.pi / 6.0
    shape = np.stack([1 - np.cos(w * times), w * np.sin(w * times), w * w * np.cos(w * times)], axis=-1)
    joints = 0.05 * np.repeat(shape[:, None, :], 32, axis=1)
    joints[:, :, 0] += arm.loop[0]["axes"]["commanded"]["next_position_rad"][:32]
    goal = arm.send_goal(np.arange(6001) * 1_000_000, joints)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    arm.close()


@pytest.mark.parametrize("moving", [False, True], ids=["holding", "executing"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda arm: arm.put(Setpoint.END, goal_id=9, crc=123),
        lambda arm: arm.put(Setpoint.END, goal_id=9, sequence=arm.writer.setpoints_written + 1),
        lambda arm: arm.put(Setpoint.END, goal_id=9, sequence=-1),
        lambda arm: arm.set_word("setpoints_written", arm.writer.setpoints_written + 1),
        lambda arm: arm.set_word("setpoints_written", arm.writer.setpoints_written + 4097),
        lambda arm: arm.set_word("setpoints_written", arm.writer.setpoints_written - 1),
        lambda arm: arm.set_word("setpoints_written", 2**63 - 1),
        lambda arm: arm.set_word("setpoints_written", -(2**63)),
        lambda arm: arm.set_word("requests_written", 1),
        lambda arm: arm.set_word("requests_written", 65),
        lambda arm: arm.set_word("requests_written", -1),
        lambda arm: arm.set_word("requests_written", 2**62),
    ],
    ids=[
        "wrong crc",
        "a sequence too far",
        "a negative sequence",
        "announced but not written",
        "head too far",
        "head back",
        "head at the end of numbers",
        "head before all numbers",
        "request not written",
        "request head too far",
        "request head negative",
        "request head huge",
    ],
)
def test_a_corrupt_ring_is_a_latched_fault_with_a_name(arm, damage, moving):
    if moving:
        goal = arm.executing()
    damage(arm)
    arm.until(lambda: arm.fault != Fault.NONE, at_most_s=0.2)
    assert arm.fault == Fault.COMMAND_RING and arm.mode == Mode.FAULT
    comes_to_rest(arm)
    if moving:
        assert arm.outcome(goal) == Outcome.FAULT
    assert arm.mode == Mode.FAULT  # latched


@pytest.mark.parametrize("late", [1, CYCLES_TO_BECOME_VISIBLE])
def test_a_record_that_becomes_visible_late_is_taken(arm, late):
    """A head may be seen before the last bytes of its record; that is no corruption yet."""
    sequence = arm.writer.setpoints_written
    arm.writer.begin(
        1,
        start_ns=0,
        joint_mask=1,
        goal_time_s=0.4,
        entry=0,
        epoch=0,
        tolerances=np.zeros((6, 3)),
        consumed=arm.reader.setpoints_consumed(),
    )
    record = arm.command.record["setpoints"][sequence]
    crc = int(record["crc"])
    record["crc"] = 0
    arm.cycles(late)
    assert arm.reader.setpoints_consumed() == sequence
    record["crc"] = crc
    arm.cycle()
    assert arm.reader.setpoints_consumed() == sequence + 1
    assert arm.fault == Fault.NONE


def test_clearing_the_fault_of_a_mended_ring_brings_the_arm_back(arm):
    arm.put(Setpoint.END, goal_id=9, crc=123)
    arm.until(lambda: arm.fault != Fault.NONE)
    assert arm.clear_fault().failure is None
    goal = arm.wave()
    arm.end_of(goal)
    assert (arm.outcome(goal), arm.fault) == (Outcome.SUCCEEDED, Fault.NONE)


# --- waypoints that are whole but wrong ----------------------------------------------------------------------

WRONG_WAYPOINTS = {
    "nan position": {"position": float("nan")},
    "infinite velocity": {"velocity": float("inf")},
    "nan acceleration": {"acceleration": float("nan")},
    "out of limits": {"position": 40.0},
    "velocity over its limit": {"velocity": 50.0},
    "acceleration over its limit": {"acceleration": 1e6},
    "acceleration beyond all measure": {"acceleration": -1e300},
    "order 2": {"order": 2},
    "order huge": {"order": 2**62},
    "time not rising": {"time_ns": 0},
    "time negative": {"time_ns": -5},
    "time beyond all measure": {"time_ns": 2**63 - 1},
}


@pytest.mark.parametrize("wrong", WRONG_WAYPOINTS.values(), ids=WRONG_WAYPOINTS)
def test_a_wrong_waypoint_of_a_new_goal_refuses_it_and_disturbs_nothing(arm, wrong):
    running = arm.executing()
    arm.pending.clear()
    here = arm.commanded()
    goal = running + 1
    arm.begin(goal)
    arm.waypoint(goal, 0, here)
    arm.waypoint(goal, **{"time_ns": 500_000_000, "position": here, **wrong})
    arm.end(goal)
    assert arm.end_of(goal) == Outcome.REFUSED_CORRUPT
    arm.end_of(running)
    assert (arm.outcome(running), arm.fault) == (Outcome.SUCCEEDED, Fault.NONE)


@pytest.mark.parametrize("wrong", WRONG_WAYPOINTS.values(), ids=WRONG_WAYPOINTS)
def test_a_wrong_waypoint_of_the_running_goal_ends_it_on_its_path(arm, wrong):
    goal = arm.wave(end=False)
    arm.until(lambda: arm.mode == Mode.EXECUTING)
    arm.cycles(60)
    arm.waypoint(goal, **{"time_ns": int(5e9), "position": arm.commanded(), **wrong})
    arm.end_of(goal)
    assert (arm.outcome(goal), arm.fault) == (Outcome.REFUSED_CORRUPT, Fault.NONE)
    comes_to_rest(arm)


def test_a_result_names_joint_value_and_limit(arm):
    here = arm.commanded()
    arm.begin(1)
    here[2] = 2.0
    arm.waypoint(1, 0, here)
    arm.cycles(2)
    result = arm.result(1)
    assert (result["outcome"], result["joint"], result["value"]) == (Outcome.REFUSED_CORRUPT, 2, 2.0)
    assert result["limit"] == pytest.approx(arm.arm.joints[2].upper_rad)


def test_waypoints_of_no_goal_are_not_taken_for_the_running_ones(arm):
    goal = arm.executing()
    for number in range(3):
        arm.waypoint(0, int(20e9) + number, arm.commanded() + 0.1)
    arm.end_of(goal)
    assert (arm.outcome(goal), arm.fault) == (Outcome.SUCCEEDED, Fault.NONE)
    assert arm.loop[0]["paths"]["taken"].max() == 81


def test_a_waypoint_behind_the_end_ends_its_goal(arm):
    """What was found out about the end, that it is at rest and how to arrive there, must stay true."""
    goal = arm.executing()
    arm.waypoint(goal, int(GOAL_S * 1e9) + 10_000_000, arm.commanded(), velocity=0.4)
    arm.end_of(goal)
    assert (arm.outcome(goal), arm.fault) == (Outcome.REFUSED_CORRUPT, Fault.NONE)
    comes_to_rest(arm)


# --- the last line of defence ------------------------------------------------------------------------------


@pytest.mark.parametrize("upper", [False, True], ids=["lower", "upper"])
@pytest.mark.parametrize("joint", [1, 4, 5])
def test_a_way_that_leads_through_a_limit_is_left_while_there_is_room_to_stop(arm, joint, upper):
    """Every waypoint is inside the limits, what lies between two of them is not: the front would have refused it."""
    config, side = arm.arm.joints[joint], 1.0 if upper else -1.0
    limit, speed = (config.upper_rad if upper else config.lower_rad), side * config.max_velocity_rad_s
    here = arm.commanded()
    rise_s = abs(speed) / config.max_acceleration_rad_s2
    here[joint] = limit - 0.6 * speed * rise_s
    commanded = arm.loop[0]["axes"]["commanded"][: len(here)]
    commanded["position_rad"] = commanded["next_position_rad"] = here
    arm.positions = [here] * 3
    at_limit, velocity = here.copy(), np.zeros(len(here))
    at_limit[joint], velocity[joint] = limit - 1e-3 * side, speed
    arm.begin(1, tolerances=np.zeros(18))
    arm.waypoint(1, 0, here)
    arm.waypoint(1, round(rise_s * 1e9), at_limit, velocity=velocity)
    arm.waypoint(1, round(3e9 * rise_s), here)
    arm.end(1)
    arm.end_of(1)
    assert (arm.outcome(1), arm.fault) == (Outcome.FAULT, Fault.POSITION_LIMIT)
    comes_to_rest(arm)
    assert side * (limit - arm.commanded()[joint]) < 0.1 * abs(speed) * rise_s  # not much earlier than needed


def test_a_brake_begins_with_the_velocity_there_is_and_not_with_one_that_was_claimed(arm):
    goal = arm.executing()
    arm.loop[0]["axes"]["commanded"]["next_velocity_rad_s"][:6] = [joint.max_velocity_rad_s for joint in arm.arm.joints]
    arm.memory["motion"]["per_joint_stop"] = 1
    arm.memory["fault"]["code"], arm.memory["mode"] = Fault.FOLLOWING_ERROR, Mode.FAULT
    comes_to_rest(arm)
    assert arm.outcome(goal) == Outcome.NONE  # finished by hand: only its motion is judged, cycle by cycle


# --- goals ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        {"goal_time_s": float("nan")},
        {"goal_time_s": float("inf")},
        {"entry": 4},
        {"entry": -1},
        {"start_ns": -(2**63)},
        {"start_ns": 2**63 - 1},
        {"tolerances": np.full(18, np.nan)},
        {"tolerances": np.full(18, np.inf)},
    ],
    ids=str,
)
def test_an_opening_that_makes_no_sense_is_refused(arm, wrong):
    arm.begin(1, **wrong)
    arm.cycles(2)
    assert arm.outcome(1) == Outcome.REFUSED_CORRUPT


def test_joints_outside_the_goal_may_hold_anything(arm):
    """The front leaves them empty; they are neither read nor judged."""
    here = arm.commanded()
    there = here.copy()
    there[0] += 0.1
    there[1:] = np.nan
    arm.begin(1, mask=0b000001)
    arm.waypoint(1, 0, np.where(np.isnan(there), there, here))
    arm.waypoint(1, 2_000_000_000, there)
    arm.end(1)
    assert arm.end_of(1) == Outcome.SUCCEEDED
    assert arm.commanded() == pytest.approx([here[0] + 0.1, *here[1:]], abs=1e-12)


@pytest.mark.parametrize("mask", [-1, 0, 1 << 6, 0b1000001])
def test_a_goal_without_joints_or_for_joints_that_do_not_exist_is_refused(arm, mask):
    arm.begin(1, mask=mask)
    arm.waypoint(1, 0, arm.commanded())
    arm.waypoint(1, 1_000_000_000, arm.commanded())
    arm.end(1)
    assert arm.end_of(1) == Outcome.REFUSED_CORRUPT


def test_records_of_goals_that_are_over_are_passed_over(arm):
    goal = arm.wave(points=3)
    arm.end_of(goal)
    arm.waypoint(goal, int(9e9), arm.commanded() + 0.1)
    arm.end(goal)
    arm.waypoint(77, int(9e9), arm.commanded() + 0.1)
    arm.cycles(3)
    assert (arm.mode, arm.running_goal, arm.fault) == (Mode.HOLDING, 0, Fault.NONE)
    assert arm.reader.setpoints_consumed() == arm.writer.setpoints_written


@pytest.mark.parametrize("goal_id", [0, -1, -(2**63)])
def test_a_goal_without_a_proper_number_never_begins(arm, goal_id):
    arm.begin(goal_id)
    arm.waypoint(goal_id, 0, arm.commanded())
    arm.waypoint(goal_id, 10**9, arm.commanded() + 0.05)
    arm.end(goal_id)
    arm.cycles(150)
    assert (arm.mode, arm.fault) == (Mode.HOLDING, Fault.NONE)


def test_a_newer_goal_drops_the_older_ones_records(arm):
    first = arm.executing()
    second = arm.wave(points=3)
    arm.end_of(second)
    assert (arm.outcome(first), arm.outcome(second)) == (Outcome.REPLACED, Outcome.SUCCEEDED)


def test_a_goal_whose_records_stop_coming_starves(arm):
    arm.begin(1)
    arm.waypoint(1, 0, arm.commanded())
    assert arm.end_of(1) == Outcome.STARVED


@pytest.mark.parametrize("heartbeat", [0, -(2**63), -1], ids=str)
def test_a_heartbeat_that_never_was_stops_the_goal(arm, heartbeat):
    goal = arm.executing()
    arm.front_alive = False
    arm.set_word("heartbeat_ns", heartbeat)
    assert arm.end_of(goal) == Outcome.FRONT_LOST
    comes_to_rest(arm)


def test_a_heartbeat_from_the_future_is_no_sign_of_life(arm):
    goal = arm.executing()
    arm.front_alive = False
    arm.set_word("heartbeat_ns", 2**62)
    assert arm.end_of(goal) == Outcome.FRONT_LOST


# --- requests -------------------------------------------------------------------------------------------


def answer(arm, sequence):
    row = arm.loop[0]["snapshot"]["answers"][sequence % layout.ANSWER_SLOTS]
    return Answer(int(row["answer"])) if row["sequence"] == sequence else Answer.NONE


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        (Request.CLEAR_FAULT, 0.0, Answer.REFUSED_MODE),
        (99, 0.0, Answer.REFUSED_UNKNOWN),
        (-(2**40), 0.0, Answer.REFUSED_UNKNOWN),
    ],
)
def test_every_request_is_answered(arm, kind, value, expected):
    sequence = arm.request(kind, value=value)
    arm.cycle()
    assert answer(arm, sequence) == expected


def test_after_a_corrupt_request_later_ones_are_obeyed(arm):
    arm.request(Request.ENABLE)
    arm.command.record["requests"][0]["value"] = 0.7
    arm.until(lambda: arm.fault == Fault.COMMAND_RING)
    sequence = arm.request(Request.CLEAR_FAULT)
    arm.until(lambda: answer(arm, sequence) != Answer.NONE)
    assert answer(arm, sequence) == Answer.DONE


# --- anything at all ------------------------------------------------------------------------------------


@pytest.mark.parametrize("moving", [False, True], ids=["holding", "executing"])
@trials
@given(seed=st.integers(0, 2**32 - 1), heads=st.lists(words, min_size=5, max_size=5))
def test_arbitrary_bytes_in_the_whole_file(moving, seed, heads):
    arm = Judged()
    if moving:
        arm.executing()
    body = np.frombuffer(arm.command.map, np.uint8, offset=BODY_AT)
    body[:] = np.random.default_rng(seed).integers(0, 256, len(body), np.uint8)
    names = ("front_pid", "heartbeat_ns", "announced_goal", "setpoints_written", "requests_written")
    for name, value in zip(names, heads, strict=True):
        arm.set_word(name, value)
    arm.front_alive = False
    arm.cycles(60)
    if moving:
        arm.until(lambda: arm.running_goal == 0, at_most_s=20)
    arm.cycles(3)
    assert np.ptp(arm.positions, axis=0).max() == 0
    body = None
    arm.close()


records = st.fixed_dictionaries(
    {
        "kind": st.one_of(st.sampled_from([1, 2, 3]), words),
        "goal_id": st.one_of(st.integers(0, 4), words),
        "words": st.one_of(
            st.tuples(words, words, numbers, words),
            st.tuples(st.integers(0, 3 * 10**9), st.sampled_from([1, 3, 5]), st.just(0), st.just(0)),
            st.tuples(st.just(0), st.just(63), st.just(0.4), st.sampled_from([0, 1])),
        ),
        "numbers": st.one_of(
            st.lists(numbers, min_size=18, max_size=18),
            st.lists(st.floats(-0.5, 0.5), min_size=18, max_size=18),
        ),
    }
)


@pytest.mark.parametrize("moving", [False, True], ids=["holding", "executing"])
@settings(trials, max_examples=examples(60))
@given(stream=st.lists(records, max_size=12), announced=st.one_of(st.integers(0, 4), words))
def test_whole_records_that_say_anything(moving, stream, announced):
    arm = Judged()
    if moving:
        arm.executing()
        arm.pending.clear()
    arm.set_word("announced_goal", announced)
    for record in stream:
        arm.put(record["kind"], **{name: record[name] for name in ("goal_id", "words", "numbers")})
    arm.cycles(100)
    arm.front_alive = False
    arm.until(lambda: arm.running_goal == 0, at_most_s=30)
    arm.close()


@trials
@given(st.lists(st.tuples(words, words, numbers), max_size=30))
def test_requests_that_say_anything(stream):
    arm = Judged()
    arm.executing()
    for kind, mask, value in stream:
        packed = struct.pack("<qqdqqqq", int(arm.command.record["requests_written"][0]) + 1, kind, value, 0, mask, 0, 0)
        slot = int(arm.command.record["requests_written"][0]) % layout.REQUEST_SLOTS
        at = offset_of(layout.CommandFile, "requests") + slot * layout.Request.dtype.itemsize
        arm.command.map[at : at + layout.Request.dtype.itemsize] = struct.pack("<q", zlib.crc32(packed)) + packed
        arm.set_word("requests_written", arm.command.record["requests_written"][0] + 1)
        arm.cycle()
    arm.cycles(50)
    assert arm.fault == Fault.NONE
    arm.close()


def test_an_announcement_out_of_all_measure_is_a_fault_and_not_a_deaf_loop(arm):
    arm.writer.announce(2**60)
    arm.cycle()
    assert arm.fault == Fault.COMMAND_RING


@pytest.mark.parametrize("goal_id", [2**62, 2**63 - 1])
def test_an_opening_out_of_all_measure_does_not_make_the_loop_deaf(arm, goal_id):
    arm.put(Setpoint.BEGIN, goal_id=goal_id, words=(0, 1, 0.4, 0, 0))
    arm.cycle()
    assert arm.fault == Fault.COMMAND_RING
    assert arm.clear_fault().failure is None
    goal = arm.wave()
    arm.end_of(goal)
    assert (arm.outcome(goal), arm.fault) == (Outcome.SUCCEEDED, Fault.NONE)


def test_a_loop_that_was_frozen_takes_the_requests_that_found_room(arm):
    with pytest.raises(RingFull):
        for _ in range(200):
            arm.request(Request.CLEAR_FAULT)
    arm.cycles(20)
    assert arm.fault == Fault.NONE
    assert arm.memory["front"]["requests_taken"] == layout.REQUEST_SLOTS - 1


def test_a_start_far_ahead_leaves_the_running_goal_alone(arm):
    running = arm.executing()
    here = arm.commanded()
    arm.pending.clear()
    later = arm.send_goal(
        np.array([10**9]),
        np.stack([here * 0, here * 0, here * 0], axis=-1)[None],
        approach=True,
        start_ns=arm.now_ns + 3600 * 10**9,
    )
    assert arm.end_of(running) == Outcome.SUCCEEDED
    assert arm.outcome(later) == Outcome.NONE
