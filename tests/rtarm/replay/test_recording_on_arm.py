"""Which motion of a recording is replayed on an arm, and what is refused before anything moves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result
from virtual import VirtualArm, recording_of

from rtarm.console.errors import Refusal
from rtarm.recording import mcap_writer
from rtarm.recording.mcap_format import Reason
from rtarm.replay import on_arm
from shm.recording import Recording
from shm.words import Fault, Mode, Outcome
from sim.faults import PowerLoss

Rtarm = Callable[..., Result]
NOW = Reason("asked", "Asked for by a person.")


@pytest.fixture(scope="module")
def done() -> Recording:
    """A goal from its beginning to its end."""
    arm = VirtualArm.amid("large")
    assert arm.end_of(1) == Outcome.SUCCEEDED
    arm.cycles(30)
    return recording_of(arm)


@pytest.fixture(scope="module")
def paused() -> Recording:
    """One that a person paused and let go on, and that a fault ended in motion."""
    arm = VirtualArm.amid("large", 90)
    arm.writer.hold()
    arm.cycles(120)
    arm.writer.resume()
    arm.cycles(90)
    arm.sim.inject(PowerLoss("joint2", at_s=0.0, off_s=60.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["fault"]["code"] != Fault.NONE)
    arm.cycles(120)
    return recording_of(arm)


def test_a_goal_is_replayed_from_rest_to_rest_as_it_was_commanded(done: Recording) -> None:
    path = on_arm.path_of(done)
    joints = done.records["joints"][done.records["mode"] == Mode.EXECUTING]
    assert path.ended_by == ""
    assert path.times_s[0] == 0.0 and np.all(np.diff(path.times_s) > 0.0)
    assert not np.any(path.velocities_rad_s[[0, -1]])
    assert np.array_equal(path.positions_rad[0], joints["commanded_position_rad"][0])
    assert np.array_equal(path.positions_rad[-1], joints["commanded_position_rad"][-1])
    assert path.ends_s - path.begins_s == pytest.approx(path.times_s[-1])
    on_arm.check(done, path, done.joints, done.limits, 1.0)


def test_a_fault_and_what_follows_it_is_never_replayed(paused: Recording) -> None:
    path = on_arm.path_of(paused)
    records = paused.records
    assert path.ended_by == "a fault was latched"
    latched_s = float(records["monotonic_ns"][np.argmax(records["fault"] != 0)] - records["monotonic_ns"][0]) * 1e-9
    assert path.ends_s < latched_s
    held = records[records["goal_phase"] == 5]  # paused
    assert np.array_equal(path.positions_rad[-1], held["joints"]["commanded_position_rad"][-1])


def test_a_fault_before_any_rest_leaves_nothing(paused: Recording) -> None:
    first_moved = np.argmax(np.any(paused.records["joints"]["commanded_velocity_rad_s"] != 0, axis=1))
    records = paused.records[: first_moved + 40].copy()
    records["mode"][-10:], records["fault"][-10:] = Mode.FAULT, Fault.WIRE
    with pytest.raises(Refusal, match="never moves from rest to rest"):
        on_arm.path_of(Recording(**{**vars(paused), "records": records}))


def test_a_gap_is_not_jumped_over(done: Recording) -> None:
    moving = np.flatnonzero(np.any(done.records["joints"]["commanded_velocity_rad_s"] != 0, axis=1))
    amid = moving[len(moving) // 2]
    records = np.delete(done.records, slice(amid, amid + 5))
    with pytest.raises(Refusal, match="never moves from rest to rest"):
        on_arm.path_of(Recording(**{**vars(done), "records": records}))


@pytest.mark.parametrize(
    "word", ["commanded_position_rad", "commanded_velocity_rad_s", "commanded_acceleration_rad_s2"]
)
def test_numbers_that_are_none_are_no_motion(done: Recording, word: str) -> None:
    records = done.records.copy()
    moving = np.flatnonzero(np.any(records["joints"]["commanded_velocity_rad_s"] != 0, axis=1))
    records["joints"][word][moving[len(moving) // 2], 1] = np.nan
    with pytest.raises(Refusal, match="never moves from rest to rest"):
        on_arm.path_of(Recording(**{**vars(done), "records": records}))


def test_limp_joints_were_not_led(done: Recording) -> None:
    records = done.records.copy()
    records["mode"] = Mode.FREE
    with pytest.raises(Refusal, match="never moves from rest to rest"):
        on_arm.path_of(Recording(**{**vars(done), "records": records}))


@pytest.mark.parametrize(
    ("word", "value", "said"),
    [
        ("upper_rad", -3.0, r"goes to .* with the limits that it was recorded with\.$"),
        ("max_velocity_rad_s", 0.05, r"moves at .*: give a lower --speed\.$"),
        ("max_acceleration_rad_s2", 0.05, r"accelerates by .*: give a lower --speed\.$"),
    ],
)
def test_other_limits_are_refused(done: Recording, word: str, value: float, said: str) -> None:
    limits = done.limits.copy()
    limits["joints"][word][1] = value
    with pytest.raises(Refusal, match=rf"^joint2 {said}"):
        on_arm.check(done, on_arm.path_of(done), done.joints, limits, 1.0)


def test_slower_it_may_fit(done: Recording) -> None:
    limits = done.limits.copy()
    limits["joints"]["max_velocity_rad_s"] *= 0.5
    limits["joints"]["max_acceleration_rad_s2"] *= 0.25
    path = on_arm.path_of(done)
    on_arm.check(done, path, done.joints, limits, 0.5)
    with pytest.raises(Refusal, match="give a lower --speed"):
        on_arm.check(done, path, done.joints, limits, 0.6)


def test_other_joints_are_refused(done: Recording) -> None:
    with pytest.raises(Refusal, match="replay it on the arm that it was made of"):
        on_arm.check(done, on_arm.path_of(done), done.joints[:5], done.limits, 1.0)


@pytest.mark.parametrize("speed", [1.0, 0.25])
def test_slower_is_the_same_path_in_more_time(done: Recording, speed: float) -> None:
    path = on_arm.path_of(done)
    points = on_arm.goal_of(done, path, speed)["trajectory"]["points"]
    assert [point["positions"] for point in points] == path.positions_rad.tolist()
    last = points[-1]["time_from_start"]
    assert last["sec"] + last["nanosec"] * 1e-9 == pytest.approx(path.times_s[-1] / speed)
    fastest = np.abs([point["velocities"] for point in points]).max()
    assert fastest == pytest.approx(speed * np.abs(path.velocities_rad_s).max())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--on-arm", "--speed", "2"), "--speed is 2, but an arm replays at 0.01 to 1 times"),
        (("--on-arm", "--view"), "give one of them"),
        (("--arm", "mock"), "give --on-arm or --view too"),
        (("--yes",), "give --on-arm too"),
        (("--on-arm",), "No control process is running for arm 'nobody'"),
        (("--view",), "Arm nobody does not run, and is none of those that come with rtarm"),
        (("--view", "--speed", "0"), "a recording plays forward only"),
    ],
)
def test_what_does_not_fit_is_refused(
    rtarm: Rtarm, done: Recording, tmp_path: Path, options: tuple[str, ...], said: str
) -> None:
    path = tmp_path / "done.mcap"
    mcap_writer.write(Recording(**{**vars(done), "arm": "nobody"}), NOW, path)
    result = rtarm("replay", str(path), *options)
    assert (result.exit_code, result.stdout) == (1, "")
    assert said in result.stderr and len(result.stderr.splitlines()) == 1
