"""`rtarm status` on memory files that a test has written."""

from __future__ import annotations

import fcntl
import json
import math
import re
import time
from collections.abc import Callable

import numpy as np
import pytest
from typer.testing import Result
from written_arm import WrittenArm

from motion.gripping import Grip
from rtarm.console.errors import Refusal
from rtarm.running import status
from shm import files, histogram, layout
from shm.gripper import show_gripper
from shm.words import DriveStatus, Fault, GripTrouble, Mode, Outcome, Phase, Unreferenced

Rtarm = Callable[..., Result]


def test_a_healthy_arm(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.rows["measured_position_rad"] = (0.5, -1.0)
    arm.rows["commanded_position_rad"] = (0.501, -1.0)
    arm.rows["measured_velocity_rad_s"] = (0.1, 0.0)
    arm.publish()
    with arm.served():
        result = rtarm("status", arm.name, "--json")
    report = json.loads(result.stdout)
    assert (result.exit_code, report["healthy"], report["problems"]) == (0, True, [])
    assert (report["mode"], report["fault"], report["goal"]) == ("holding", None, None)
    assert (report["cycles"], report["overruns"], report["rate_hz"]) == (1234, 0, 100.0)
    assert report["loop"]["pid"] == report["front"]["pid"] == int(arm.state["header"]["pid"])
    shoulder = report["joints"][0]
    assert (shoulder["name"], shoulder["position_rad"], shoulder["commanded_rad"]) == ("shoulder", 0.5, 0.501)
    assert (shoulder["velocity_rad_s"], shoulder["referenced"]) == (0.1, True)
    assert shoulder["age_ms"] >= 1.0


def test_the_tables_say_the_same(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.rows["measured_position_rad"] = (math.radians(30.0), 0.0)
    arm.publish()
    with arm.served():
        result = rtarm("status", arm.name)
    assert result.exit_code == 0
    assert f"{arm.name}: holding, healthy" in result.stdout
    assert "30.000   0.52360" in result.stdout
    assert "no real-time priority, memory not locked, any CPU, CPU latency not held" in result.stdout


def test_what_drives_measure_is_told(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.rows["drive_status"] = DriveStatus.ENABLED | DriveStatus.ANSWERED
    arm.publish()
    with arm.served():
        assert "drive of" not in rtarm("status", arm.name).stdout  # none of it is measured
        arm.rows["measured_effort"] = (-2.25, math.nan)
        arm.rows["drive_temperature_c"] = (41.0, math.nan)
        arm.rows["drive_voltage_v"] = (math.nan, 23.9)
        arm.publish()
        shoulder, elbow = json.loads(rtarm("status", arm.name, "--json").stdout)["joints"]
        table = rtarm("status", arm.name).stdout
    assert (shoulder["effort_nm"], shoulder["temperature_c"], shoulder["voltage_v"]) == (-2.25, 41.0, None)
    assert (elbow["effort_nm"], elbow["temperature_c"], elbow["voltage_v"]) == (None, None, 23.9)
    assert shoulder["drive"] == ["enabled", "answered"] and shoulder["drive_trouble"] == []
    assert re.search(r"drive of +Nm +°C +V +says", table)
    assert re.search(r"shoulder +-2\.25 +41 +- +enabled, answered", table)
    assert re.search(r"elbow +- +- +23\.9 +enabled, answered", table)


def test_an_error_of_a_drive_that_no_fault_speaks_of_is_a_problem(arm: WrittenArm, rtarm: Rtarm) -> None:
    said = DriveStatus.ANSWERED | DriveStatus.PROTECTED | DriveStatus.OVER_TEMPERATURE
    arm.rows["drive_status"][1] = said
    arm.publish()
    with arm.served():
        report = json.loads(rtarm("status", arm.name, "--json").stdout)
        assert re.search(r"elbow +protected, answered, over-temperature", rtarm("status", arm.name).stdout)
        assert report["problems"] == [
            "The drive of elbow has an error (protected, over-temperature) and may hold nothing: remove the cause, "
            "then `rtarm clear-fault`."
        ]
        arm.snapshot["mode"], arm.snapshot["fault"], arm.snapshot["fault_joint"] = Mode.FAULT, Fault.DRIVE_FAULT, 1
        arm.snapshot["fault_value"] = float(said)
        arm.publish()
        report = json.loads(rtarm("status", arm.name, "--json").stdout)
    assert report["problems"] == [
        "The drive of elbow reports a fault of its own (protected, over-temperature, not enabled): remove the cause, "
        "then `rtarm clear-fault`."
    ]


def test_a_gripper_on_the_bus_is_told_of(arm: WrittenArm, rtarm: Rtarm) -> None:
    assert status.read_status(arm.name)["gripper"] is None
    shown = np.zeros((), layout.Gripper.dtype)
    shown["written"], shown["grip"], shown["measured_ns"] = 1, Grip.STALLED, time.monotonic_ns()
    shown["position_rad"], shown["target_rad"], shown["measured_effort"] = math.radians(40.0), 0.0, math.nan
    show_gripper(arm.files.state.array, shown)
    gripper = status.read_status(arm.name)["gripper"]
    assert (gripper["grip"], gripper["position_rad"], gripper["target_rad"]) == ("stalled", math.radians(40.0), 0.0)
    assert (gripper["effort_nm"], gripper["trouble"]) == (None, None) and gripper["age_ms"] >= 0.0
    assert "stalled at 40.0°" in rtarm("status", arm.name).stdout
    shown["trouble"], shown["trouble_value"], shown["measured_ns"] = GripTrouble.SILENT, 7.0, 0
    show_gripper(arm.files.state.array, shown)
    report = status.read_status(arm.name)
    assert report["gripper"]["position_rad"] is None
    assert not any("gripper" in problem for problem in report["problems"]), "it does not keep the arm from moving"
    assert "The gripper's drive (address 7) does not answer" in rtarm("status", arm.name).stdout


def test_no_front_is_a_problem(arm: WrittenArm, rtarm: Rtarm) -> None:
    result = rtarm("status", arm.name)
    assert result.exit_code == 5
    assert "No ROS process serves the arm" in result.stdout


def test_a_front_that_hangs_is_a_problem(arm: WrittenArm) -> None:
    with arm.served():
        arm.command["heartbeat_ns"][0] = time.monotonic_ns() - 3_000_000_000
        report = status.read_status(arm.name)
    assert "gives no sign of life" in report["problems"][0]


def test_a_latched_fault_is_said_with_joint_value_and_limit(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.snapshot["mode"], arm.snapshot["fault"] = Mode.FAULT, Fault.FOLLOWING_ERROR
    arm.snapshot["fault_joint"], arm.snapshot["fault_value"], arm.snapshot["fault_limit"] = 1, 0.15, 0.1
    arm.publish()
    with arm.served():
        result = rtarm("status", arm.name, "--json")
    report = json.loads(result.stdout)
    assert (result.exit_code, report["mode"]) == (5, "fault")
    fault = report["fault"]
    assert (fault["name"], fault["joint"], fault["value"], fault["limit"]) == (
        "following_error",
        "elbow",
        0.15,
        0.1,
    )
    assert fault["sentence"] == report["problems"][0]
    assert "elbow was 0.1500 rad" in fault["sentence"]


def test_an_unreferenced_joint_is_a_problem_with_its_reason(arm: WrittenArm) -> None:
    arm.rows["referenced"][0] = 0
    arm.rows["unreferenced_reason"][0] = Unreferenced.POWER_LOST
    arm.publish()
    with arm.served():
        report = status.read_status(arm.name)
    assert report["problems"] == [report["joints"][0]["unreferenced"]]
    assert report["problems"][0].startswith("The drive of shoulder may have lost power")


def test_a_joint_that_was_never_read_is_null_and_json_stays_valid(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.rows["measured_position_rad"] = np.nan
    arm.publish(read=False)
    with arm.served():
        report = json.loads(rtarm("status", arm.name, "--json").stdout)
        assert re.search(r"shoulder +- +- +- ", rtarm("status", arm.name).stdout)
    for joint in report["joints"]:
        assert (joint["position_rad"], joint["velocity_rad_s"], joint["age_ms"]) == (None, None, None)


@pytest.mark.parametrize("mode", [Mode.OFFLINE, Mode.BRINGING_UP])
def test_an_arm_that_is_not_up_yet_is_not_healthy(mode: Mode, arm: WrittenArm) -> None:
    arm.snapshot["mode"] = mode
    arm.publish()
    with arm.served():
        report = status.read_status(arm.name)
    assert report["problems"] == [
        f"The control process is {mode.name.lower().replace('_', ' ')}: wait until it is holding."
    ]


def test_a_control_process_that_hangs_is_a_problem(arm: WrittenArm, monkeypatch: pytest.MonkeyPatch) -> None:
    later_ns = time.monotonic_ns() + 3_000_000_000
    monkeypatch.setattr(status.time, "monotonic_ns", lambda: later_ns)
    report = status.read_status(arm.name)
    assert any("so the control process hangs" in problem for problem in report["problems"])


def test_the_running_goal_and_the_last_result(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.snapshot["mode"], arm.snapshot["goal_id"] = Mode.EXECUTING, 9
    arm.snapshot["goal_phase"], arm.snapshot["trajectory_clock_ns"] = Phase.RUNNING, 1.5e9
    arm.snapshot["trajectory_end_ns"] = 4_000_000_000
    slot = arm.snapshot["results"][0]
    slot["goal_id"], slot["outcome"], slot["monotonic_ns"], slot["joint"] = 8, Outcome.CANCELED, 5, -1
    arm.publish()
    with arm.served():
        report = status.read_status(arm.name)
        shown = rtarm("status", arm.name).stdout
    assert report["goal"] == {"id": 9, "phase": "running", "clock_s": 1.5, "duration_s": 4.0}
    assert (report["last_result"]["goal_id"], report["last_result"]["outcome"]) == (8, "canceled")
    assert report["healthy"]
    assert "9 running, 1.50 of 4.00 s" in shown


@pytest.mark.parametrize("first_row", [0, 3, 15])
def test_of_several_results_of_one_cycle_the_last_row_is_the_last(arm: WrittenArm, first_row: int) -> None:
    for number in range(16):
        row = arm.snapshot["results"][(first_row + number) % 16]
        row["goal_id"], row["outcome"], row["monotonic_ns"] = 100 - number, Outcome.REPLACED, min(number, 14)
    arm.publish()
    with arm.served():
        assert status.read_status(arm.name)["last_result"]["goal_id"] == 85


def test_percentiles_counters_and_scheduling(arm: WrittenArm) -> None:
    record = arm.state["lateness"]
    for value_ns in range(1000, 101_000, 1000):
        record["buckets"][histogram.bucket(value_ns)] += 1
    record["max_ns"], record["count"] = 100_000, 100
    found = status.percentiles_us(record)
    assert found["p50"] == pytest.approx(50.0, rel=0.04)
    assert found["p99"] == pytest.approx(99.0, rel=0.04)
    assert (found["max"], found["count"]) == (100.0, 100)

    arm.state["buses"]["bits_on_bus"][0] = 400_000
    buses = status.counted_buses(arm.state)
    found = status.counters(arm.state["counters"], buses, 1_000_000_000)
    assert found["bus"]["load"] == pytest.approx(0.8) and "buses" not in found
    assert status.counters(arm.state["counters"], [], 1_000_000_000)["bus"]["load"] is None

    real_time = arm.state["scheduling"]
    real_time["policy"], real_time["priority"], real_time["memory_locked"], real_time["cpu"] = 1, 80, 1, 3
    assert status.describe_scheduling(status.scheduling(real_time)) == (
        "SCHED_FIFO 80, memory locked, CPU 3, CPU latency not held"
    )


def test_without_a_name_the_only_running_arm_is_meant(arm: WrittenArm, monkeypatch: pytest.MonkeyPatch) -> None:
    assert arm.name in files.running_arms()
    monkeypatch.setattr(status.files, "running_arms", lambda: [arm.name])
    assert status.resolve_arm(None) == arm.name
    monkeypatch.setattr(status.files, "running_arms", lambda: [])
    monkeypatch.setattr(status.files, "arms_left_behind", lambda: [arm.name])  # it lives, so it has not died
    with pytest.raises(Refusal, match="No arm is running here: start one"):
        status.resolve_arm(None)
    monkeypatch.setattr(status.files, "running_arms", lambda: ["left", "right"])
    with pytest.raises(Refusal, match=r"\(left, right\): name the one you mean, such as `--arm left`\."):
        status.resolve_arm(None)


def test_without_a_name_an_arm_that_has_died_is_told_of(
    arm: WrittenArm, rtarm: Rtarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status.files, "running_arms", lambda: [])
    monkeypatch.setattr(status.files, "arms_left_behind", lambda: [arm.name])
    monkeypatch.setattr(status.files, "is_held", lambda _: False)
    result = rtarm("status")
    assert result.exit_code == 1
    assert f"The control process of arm '{arm.name}'" in result.stderr and "is gone without an orderly" in result.stderr


def test_an_arm_file_names_its_arm(arm_file: object, arm_name: str) -> None:
    assert status.resolve_arm(str(arm_file)) == arm_name


def test_a_file_of_another_layout_is_refused_with_both(arm: WrittenArm, rtarm: Rtarm) -> None:
    arm.state["header"]["layout_hash"] = 0x1234
    result = rtarm("status", arm.name)
    assert result.exit_code == 1
    assert "has layout 0000000000001234, this rtarm has" in result.stderr


def test_who_the_front_is_and_which_arms_run(arm: WrittenArm) -> None:
    assert files.front_of(arm.name) is None
    with arm.served():
        pid, heartbeat_ns = files.front_of(arm.name) or (0, 0)
        assert pid == int(arm.state["header"]["pid"])
        assert heartbeat_ns > 0
    assert files.front_of(arm.name) is None
    fcntl.flock(arm.files.state.fd, fcntl.LOCK_UN)
    assert arm.name not in files.running_arms()
