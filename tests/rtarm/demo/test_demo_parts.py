"""The demo's parts without its processes: goals, client figures, tracking, summary."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from written_arm import JOINTS, WrittenArm

from config.loader import load_arm
from rtarm.client.arrivals import Arrivals
from rtarm.client.ros import fill, goal_message
from rtarm.console.errors import Refusal
from rtarm.demo import run as demo
from rtarm.demo.goals import load_goal, tour
from rtarm.launch.own_domain import DOMAINS
from rtarm.running.status import counted_buses, percentiles_us
from rtarm.running.tracking import Tracker, Window
from shm import files, histogram
from shm.client import StateReader
from shm.words import Answer, Fault, Mode, Request, Unreferenced

CHECKED = (
    "control_msgs.action._follow_joint_trajectory",
    "trajectory_msgs.msg._joint_trajectory",
    "trajectory_msgs.msg._joint_trajectory_point",
    "builtin_interfaces.msg._duration",
)
RECORDED = Path(__file__).resolve().parents[2] / "data" / "moveit"


def test_the_tour_is_closed_and_each_goal_starts_where_the_last_ended() -> None:
    goals = tour()
    ends = [goal.document["trajectory"]["points"][-1]["positions"] for goal in goals]
    for start, before in zip([goal.first_rad for goal in goals], [[0.0] * 6, *ends[:-1]], strict=True):
        assert start == pytest.approx(before, abs=2e-3)
    assert ends[-1] == pytest.approx([0.0] * 6, abs=2e-3)
    assert 4.0 < sum(goal.planned_s for goal in goals) < 13.0


def test_the_goals_of_the_demo_are_the_recorded_ones() -> None:
    for goal in tour():
        assert goal.document == json.loads((RECORDED / f"{goal.name}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is not JSON"),
        ("[]", "holds no goal with joint names and points"),
        ("{}", "holds no goal"),
        ('{"trajectory": {"joint_names": ["a"], "points": []}}', "holds no goal"),
        ('{"trajectory": {"joint_names": ["a"], "points": [{"positions": [1, 2]}]}}', "holds no goal"),
        ('{"trajectory": {"joint_names": 7, "points": 7}}', "holds no goal"),
    ],
)
def test_what_is_no_goal_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "goal.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(Refusal, match=said):
        load_goal(path)


def test_the_simulated_arm_starts_where_the_goal_does() -> None:
    arm, goal = load_arm("episode1"), load_goal(RECORDED / "around_box.json")
    assert demo.start_deg(arm, goal) == pytest.approx([-60, 10, 10, 0, 0, 0], abs=0.1)
    only_one = demo.Goal("one", ("joint6",), (100.0,), 1.0, {})
    assert demo.start_deg(arm, only_one) == [0, 0, 0, 0, 0, 290]  # never outside the limits


def test_the_demo_disturbs_no_running_arm() -> None:
    first, second = (demo.make_plan("episode1", tour()) for _ in range(2))
    names = {first.arm.name, second.arm.name, "episode1"}
    assert len(names) == 3
    assert (first.namespace, second.namespace) == (f"/{first.arm.name}", f"/{second.arm.name}")
    assert int(first.front_environment["ROS_DOMAIN_ID"]) in DOMAINS
    assert first.front_environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert demo.make_plan("mock", tour()).simulated is False


def test_what_a_fault_took_before_the_first_goal_is_not_given_back(arm: WrittenArm) -> None:
    """As where the simulated drives of a starved machine were silent for too long while the ROS process loaded."""
    arm.snapshot["mode"], arm.snapshot["fault"] = Mode.FAULT, Fault.STALE_READING
    arm.rows["referenced"][1] = 0
    arm.rows["unreferenced_reason"][1] = Unreferenced.SILENT
    arm.publish()
    config = load_arm("mock").model_copy(update={"name": arm.name})
    assert demo.say_where_it_stands(config) == ""


def test_joints_that_count_from_where_they_were_switched_on_are_said_to_stand_there(arm: WrittenArm) -> None:
    arm.rows["referenced"][1] = 0
    arm.rows["unreferenced_reason"][1] = Unreferenced.INCREMENTAL
    arm.rows["measured_position_rad"][1] = math.radians(20.0)
    arm.publish()

    def obey(arm: WrittenArm, kind: int) -> int:
        assert kind == Request.REFERENCE
        arm.rows["referenced"][1] = 1
        return Answer.DONE

    config = load_arm("mock").model_copy(update={"name": arm.name})
    with arm.answering(obey):
        assert demo.say_where_it_stands(config) == "Taken: elbow 20.00°."


def test_a_recorded_goal_becomes_the_message_field_for_field() -> None:
    goal = load_goal(RECORDED / "small.json")
    message = goal_message(goal.document)
    points = goal.document["trajectory"]["points"]
    assert tuple(message.trajectory.joint_names) == goal.joint_names
    assert len(message.trajectory.points) == len(points)
    assert list(message.trajectory.points[2].accelerations) == points[2]["accelerations"]
    assert message.trajectory.points[2].time_from_start.nanosec == points[2]["time_from_start"]["nanosec"]
    assert list(message.goal_tolerance) == []


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"trajectry": {}}, "has a field 'trajectry', which FollowJointTrajectory_Goal has not"),
        ({"trajectory": {"joint_names": 5}}, "field 'joint_names' is no sequence<string>"),
        ({"trajectory": {"points": [{"positions": ["far"]}]}}, "field 'positions' is no sequence<double>"),
        ({"goal_time_tolerance": {"sec": "soon"}}, "field 'sec' is no int32"),
    ],
)
def test_a_goal_that_is_no_message_is_refused(
    document: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from control_msgs.action import FollowJointTrajectory

    for module in CHECKED:  # as the client's environment has it before they are imported
        monkeypatch.setattr(f"{module}.ros_python_check_fields", "1")
    with pytest.raises(Refusal, match=said):
        fill(FollowJointTrajectory.Goal(), document)


def test_arrivals_of_joint_states(monkeypatch: pytest.MonkeyPatch) -> None:
    arrivals = Arrivals()
    stamp_ns, ages_ns = 1_700_000_000_123_456_789, (1_000_000, 2_000_000, 3_000_000)
    for number, age_ns in enumerate(ages_ns):
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        message = b"\x00\x01\x00\x00" + sec.to_bytes(4, "little") + nanosec.to_bytes(4, "little") + b"rest"
        monkeypatch.setattr("rtarm.client.arrivals.time.monotonic_ns", lambda at=number: at * 8_000_000)
        monkeypatch.setattr("rtarm.client.arrivals.time.time_ns", lambda age=age_ns: stamp_ns + age)
        arrivals.take(message)
    figures = arrivals.between(0, 10**12)
    assert figures["count"] == 3
    assert figures["rate_hz"] == pytest.approx(125.0)
    assert figures["interval_ms"]["max"] == pytest.approx(8.0)
    assert (figures["age_ms"]["p50"], figures["age_ms"]["max"]) == pytest.approx((2.0, 3.0))
    assert arrivals.between(0, 1)["rate_hz"] == 0.0


def test_tracking_counts_each_reading_once_and_only_while_a_goal_runs(arm: WrittenArm) -> None:
    reader = StateReader(files.open_state(arm.name))
    tracker = Tracker(reader)

    def cycle(goal: int, error: float) -> None:
        arm.snapshot["goal_id"] = goal
        arm.rows["reference_position_rad"] = 1.0
        arm.rows["measured_position_rad"] = (1.0 + error, 1.0)
        arm.publish()
        tracker.take(reader.snapshot())

    cycle(0, 9.0)
    cycle(1, 0.3)
    cycle(1, -0.4)
    tracker.take(tracker.latest)  # the same reading again
    cycle(0, 0.1)
    figures = tracker.figures()
    assert figures["rms"] == pytest.approx([math.sqrt((0.09 + 0.16) / 2), 0.0])
    assert figures["max"] == pytest.approx([0.4, 0.0])
    assert figures["final"] == pytest.approx([0.1, 0.0])
    assert tracker.missed == 0
    reader.close()


def test_a_window_holds_what_happened_in_it(arm: WrittenArm) -> None:
    reader = StateReader(files.open_state(arm.name))

    def late(value_ns: int) -> None:
        record = arm.state["lateness"]
        record["buckets"][histogram.bucket(value_ns)] += 1
        record["max_ns"] = max(int(record["max_ns"]), value_ns)

    late(5_000_000)
    window = Window(reader)
    for value_ns in (10_000, 20_000, 30_000):
        late(value_ns)
    arm.state["counters"]["cycles"] += 3
    arm.state["counters"]["bits_on_bus"] += 1000
    since, (bus,), elapsed_ns = window.counters()
    assert (int(since["cycles"]), int(since["bits_on_bus"]), bus.bitrate) == (3, 1000, 500_000)
    assert elapsed_ns > 0
    lateness = percentiles_us(window.histogram("lateness"))
    assert lateness["count"] == 3
    assert lateness["max"] == pytest.approx(30.0, rel=0.04)  # not the 5 ms of before
    reader.close()


def played(*results: tuple[str, bool, int, str]) -> demo.Played:
    return demo.Played(
        results=[
            {
                "goal": name,
                "succeeded": succeeded,
                "error_code": code,
                "error_string": sentence,
                "planned_s": 1.0,
                "actual_s": 1.1,
                "feedback": 20,
            }
            for name, succeeded, code, sentence in results
        ],
        joint_states={
            "count": 240,
            "rate_hz": 120.0,
            "interval_ms": {"p50": 8.3, "p99": 8.9, "max": 10.0},
            "age_ms": {"p50": 1.0, "p99": 2.0, "max": 3.0},
        },
    )


def test_the_first_failure_is_the_result() -> None:
    goals = tour()[:3]
    summary = demo.summarise(goals, played(("small", True, 0, "Reached."), ("single_joint", False, -4, "Too far.")))
    assert summary["succeeded"] is False
    assert summary["result"] == {"error_code": -4, "error_string": "Too far."}
    assert (summary["planned_s"], summary["actual_s"]) == pytest.approx((2.0, 2.2))
    two = demo.summarise(goals[:2], played(("small", True, 0, "a"), ("single_joint", True, 0, "b")))
    assert two["succeeded"] is True
    assert demo.summarise(goals, played(("small", True, 0, "a")))["succeeded"] is False


def test_the_summary_fits_80_columns_and_names_everything(arm: WrittenArm) -> None:
    timing = percentiles_us(arm.state["lateness"])
    report = {
        **demo.summarise(tour()[:1], played(("small", True, 0, "Reached."))),
        "tracking_rad": {name: [1e-3, 2e-3, None, 0.0, 0.0, 0.0] for name in ("rms", "max", "final")},
        "lateness_us": timing,
        "cycle_us": timing,
        "rate_hz": 120.0,
        **demo.counters(arm.state["counters"], counted_buses(arm.state), 1_000_000_000),
        "scheduling": demo.scheduling(arm.state["scheduling"]),
    }
    out = io.StringIO()
    Console(file=out, width=80).print(demo.render_summary(report, load_arm("episode1")))
    text = out.getvalue()
    assert "1 of 1 goals succeeded, 1.10 s (planned 1.00 s)" in text
    for word in (
        "joint6",
        "0.0573",
        "/joint_states",
        "120.00 Hz",
        "wake-up lateness",
        "cycle time",
        "overruns",
    ):
        assert word in text
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text


def test_progress_in_a_line_and_as_a_bar(arm: WrittenArm) -> None:
    arm.snapshot["goal_id"], arm.snapshot["trajectory_clock_ns"] = 1, 0.25e9
    arm.rows["measured_position_rad"] = (math.radians(10.0), 0.0)
    arm.rows["reference_position_rad"] = (math.radians(10.5), 0.0)

    def moment_after(least_s: float) -> demo.Moment:
        return demo.Moment.of(tour(), demo.Played(playing="small"), arm.snapshot, JOINTS, least_s)

    moment = moment_after(0.0)
    assert moment.elapsed_s == 0.25 and moment_after(1.5).elapsed_s == 1.5
    assert moment.line() == "small: 0.2 of 8.9 s, joints at 10.0 0.0 °, largest error 0.500°"
    out = io.StringIO()
    Console(file=out, width=80).print(moment.drawn())
    assert "small" in out.getvalue()
    assert "-0.5000" in out.getvalue()
    assert np.isfinite(moment.total_s)
