"""A sample of what `python -m fuzz` runs by the million, and proof that its judges can find somebody guilty."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compiling import bounds_checked
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plain_messages import point, present, trajectory

from compilation import cache
from fuzz import memory
from fuzz.arena import MemoryArena, WireArena
from fuzz.messages import Messages
from fuzz.stress import SCENARIOS
from fuzz.texts import Texts
from fuzz.truth import Truth
from rosfront.goal import plan_stream
from rtloop.wire import received
from shm.words import Answer, Fault, Outcome

ROOT = Path(__file__).resolve().parents[2]
SEED = 20_261_121

sample = settings(max_examples=examples(60), deadline=None, suppress_health_check=list(HealthCheck), database=None)


@pytest.fixture(scope="module")
def hostile_memory() -> Any:
    arena = MemoryArena()
    yield arena
    arena.close()


@pytest.fixture(scope="module")
def hostile_wire() -> Any:
    arena = WireArena()
    yield arena
    arena.close()


def test_a_hostile_writer_moves_nothing_beyond_its_limits(hostile_memory: MemoryArena) -> None:
    assert hostile_memory.run(SEED, 0, 6_000) == (6_000, "")
    ended = hostile_memory.faults
    assert ended[Fault.NONE] > 1_000 and ended[Fault.COMMAND_RING] > 100  # neither all refused nor all believed
    outcomes, answers = hostile_memory.seen[2], hostile_memory.seen[3]
    wanted = (Outcome.SUCCEEDED, Outcome.REPLACED, Outcome.CANCELED, Outcome.REFUSED_CORRUPT, Outcome.REFUSED_START)
    assert all(outcomes[outcome] for outcome in wanted)
    # a mock arm has no wire, and no goal is missing any more
    of_the_file = set(Answer) - {Answer.NONE, Answer.REFUSED_WIRE, Answer.REFUSED_NO_GOAL}
    assert all(answers[answer] for answer in of_the_file)


def test_hostile_bytes_move_nothing_beyond_its_limits(hostile_wire: WireArena) -> None:
    assert hostile_wire.run(SEED, 0, 1_500) == (1_500, "")
    assert hostile_wire.faults[Fault.NONE] > 300
    assert hostile_wire.faults[Fault.REFERENCE_LOST] > 50 and hostile_wire.faults[Fault.DRIVE_FAULT] > 50


@pytest.mark.parametrize("interface", ["seeedstudio", "ch340-at"])
def test_hostile_bytes_of_binary_frames_move_nothing_beyond_its_limits(interface: str) -> None:
    arena = WireArena(interface=interface)
    assert arena.run(SEED, 0, 1_000) == (1_000, "")
    assert arena.faults[Fault.NONE] > 200
    assert arena.faults[Fault.REFERENCE_LOST] > 30 and arena.faults[Fault.DRIVE_FAULT] > 30
    arena.close()


def test_the_judge_of_motion_finds_what_is_there(hostile_memory: MemoryArena) -> None:
    """The same writer, and limits that are a little tighter than those the loop goes by."""
    loop = hostile_memory.arm.loop
    before = memory.standing(loop[0])
    axis, row = loop[0]["axes"][0], loop[0]["joints"][0]
    place = float(axis["commanded"]["position_rad"])
    for position, guilt in (
        (np.nan, memory.NOT_FINITE),
        (row["upper_rad"] + 0.01, memory.OUTSIDE),
        (place + 0.011 * row["max_velocity_rad_s"], memory.TOO_FAST),
        (place + 2.1e-4 * row["max_acceleration_rad_s2"], memory.TOO_HARD),
        (place + 1.9e-4 * row["max_acceleration_rad_s2"], memory.SOUND),
    ):
        axis["commanded"]["position_rad"] = position
        assert memory.judge(loop[0], before.copy(), hostile_memory.verdict) == guilt
    axis["commanded"]["position_rad"] = place


def try_cases(target: Messages | Texts) -> None:
    """Cases of a target whose seeds hypothesis chooses, and makes smaller where one fails."""

    @sample
    @given(st.integers(0, 2**32))
    def one(seed: int) -> None:
        target.case(np.random.default_rng(seed))

    one()
    target.close()


@pytest.mark.parametrize("kind", ["goals", "streams", "bytes"])
def test_hostile_messages_are_refused_in_a_sentence_or_executed_within_limits(kind: str) -> None:
    try_cases(Messages(kind))


def test_a_lone_point_of_a_stream_that_is_far_ahead_and_accelerated_swings_nobody_out() -> None:
    """Found by the long run: the way to it was a quintic that ended with its acceleration, metres off on the way."""
    target = Messages("streams")
    far = point(11.0, [0.0] * 6, [0.0] * 6, [-0.2, -0.1, -0.2, 0.5, -1.0, 2.0])
    message = trajectory([far], [joint.name for joint in target.arm.joints])
    there = present(monotonic_ns=target.arena.arm.now_ns, epoch_ns=0)
    target.execute(plan_stream(message, target.arm, there, target.settings), np.zeros(6))
    target.close()


@pytest.mark.parametrize("kind", ["yaml", "overrides"])
def test_hostile_texts_make_a_sound_arm_or_a_sentence(kind: str) -> None:
    try_cases(Texts(kind))


@pytest.mark.parametrize("kind", ["yaml", "overrides"])
def test_some_hostile_texts_are_arms(kind: str) -> None:
    """Else nothing behind the first check is tried."""
    target = Texts(kind)
    for case in range(1_000):
        target.case(np.random.default_rng([SEED, case]))
        if target.accepted:
            break
    target.close()
    assert target.accepted


def test_hostile_values_of_parameters_are_refused_in_a_sentence() -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("control_msgs")
    from fuzz.texts import Parameters

    target = Parameters()
    for case in range(1_000):
        target.case(np.random.default_rng([SEED, case]))
    assert target.accepted > 50


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_simulated_drives_stay_within_their_limits_under_a_hostile_writer(seed: int) -> None:
    target = Truth()
    target.case(np.random.default_rng([SEED, seed]))
    assert target.executed == 1


@pytest.mark.parametrize("name", SCENARIOS)
def test_two_threads_at_once_misread_nothing(name: str) -> None:
    scenario, _ = SCENARIOS[name]
    counted = scenario(2_000)
    assert counted.wrong == 0 and counted.written > 0


def test_the_stress_of_the_receive_ring_finds_a_byte_that_is_wrong(hostile_wire: WireArena) -> None:
    """Its count of mistakes is not always zero."""
    from config.loader import load_arm
    from fuzz.stress import take_bytes
    from rtloop.process.initial_state import new_loop

    loop = new_loop(load_arm("mock"), 0, 0)
    received.push(loop[0]["buses"][0], 0, np.array([0, 7, 15], np.uint8), 3)
    table = np.zeros(64, np.int64)
    assert take_bytes(table.ctypes.data, loop[0], 1) == 1


CHECKED = """
from fuzz.arena import MemoryArena, WireArena

for arena in (MemoryArena(), WireArena()):
    print(arena.run(1, 0, 3000))
    arena.close()
"""


@pytest.mark.process
@pytest.mark.skipif("RTARM_LONG" not in os.environ, reason="compiles all of it once more; RTARM_LONG=1 runs it")
def test_no_hostile_index_ever_leaves_its_array(tmp_path: Path) -> None:
    """The compiled targets with numba's bounds checks compiled in, in a cache of their own."""
    result = bounds_checked(CHECKED, tmp_path)
    assert result.stdout.split("\n") == ["checks bounds", "(3000, '')", "(3000, '')", ""], result.stderr
    assert (tmp_path / "rtarm" / cache.folder().name).is_dir()
