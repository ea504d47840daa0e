"""Everything of the node but its action, as clients meet it: topics, services, parameters."""

import threading
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from builtin_interfaces.msg import Duration, Time
from control_msgs.msg import DynamicJointState, JointTrajectoryControllerState, SpeedScalingFactor
from control_msgs.srv import QueryTrajectoryState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from front_stage import SlowJudge, Stage, goal, serving_alone
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.serialization import serialize_message
from ros_client import ABORTED, CANCELED, SUCCEEDED, Operator
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from waiting import until

from rosfront import serving
from rosfront.settings import Settings
from rosfront.state_topics import INTERFACES
from shm.words import DriveStatus, Entry, Fault, Mode, Outcome, Request

pytestmark = pytest.mark.process  # a real client, real threads, real time

NAMES = [f"joint{i}" for i in range(1, 7)]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope="module")
def whole_stage(new_arm_name):
    stage = Stage(new_arm_name())
    stage.operator = Operator()
    yield stage
    stage.operator.close()
    stage.close()


@pytest.fixture
def stage(whole_stage):
    """The one stage, with a sound loop, the arm at zero and settings as at the start."""
    whole_stage.reset()
    whole_stage.front.serving.settings = Settings.of(whole_stage.arm)
    return whole_stage


@pytest.fixture
def operator(stage):
    yield stage.operator
    stage.operator.forget()


@pytest.fixture
def moving(stage):
    """The handle of a long goal that is being executed, and canceled afterwards."""
    handle = stage.client.send(goal(seconds=20, to_rad=0.2))
    until(lambda: stage.loop.active, "motion")
    yield handle
    if stage.loop.active:
        handle.cancel_goal_async()
        until(lambda: not stage.loop.active, "rest")


def nanoseconds(time):
    return time.sec * 10**9 + time.nanosec


def trigger(operator, name):
    response = operator.call(Trigger, f"~/{name}")
    assert response.message.endswith("."), "not a sentence"
    return response.success, response.message


# --- state topics ---


def test_controller_state(stage, operator, moving):
    heard = operator.listen(JointTrajectoryControllerState, "~/controller_state")
    until(lambda: len(heard) > 50, "50 controller states")
    stamps = [nanoseconds(message.header.stamp) for message in heard]
    assert np.median(np.diff(stamps)) == pytest.approx(10_000_000, rel=0.01)
    for message in heard:
        assert list(message.joint_names) == NAMES and message.header.frame_id == "base_link"
        reference, feedback, error = message.reference, message.feedback, message.error
        for values in (reference.positions, reference.velocities, reference.accelerations, message.output.positions):
            assert len(values) == 6
        assert len(feedback.positions) == len(feedback.velocities) == len(error.velocities) == 6
        assert not feedback.accelerations and not error.accelerations and not message.output.velocities
        assert list(error.positions) == [a - b for a, b in zip(reference.positions, feedback.positions, strict=True)]
        assert message.speed_scaling_factor == 1.0
    along = [nanoseconds(message.reference.time_from_start) for message in heard]
    assert (np.diff(along) > 0).all()
    beside = np.abs(np.array([nanoseconds(message.feedback.time_from_start) for message in heard]) - along)
    assert beside.max() < 30_000_000


def test_a_scaled_goal_has_two_clocks(stage, operator, moving):
    heard = operator.listen(JointTrajectoryControllerState, "~/controller_state")
    stage.loop.command["speed_scale"] = 0.25
    until(lambda: heard and heard[-1].speed_scaling_factor == 0.25, "the factor")
    begin = len(heard)
    until(lambda: len(heard) > begin + 40, "40 controller states")

    def went(point):
        ends = [nanoseconds(getattr(heard[at], point).time_from_start) for at in (begin, -1)]
        return ends[1] - ends[0]

    assert went("reference") == pytest.approx(0.25 * went("feedback"), rel=1e-3)


def test_dynamic_joint_states(stage, operator):
    heard = operator.listen(DynamicJointState, "/dynamic_joint_states", qos_profile_sensor_data)
    stage.loop.unreference(3)
    until(lambda: heard and not heard[-1].interface_values[3].values[INTERFACES.index("referenced")], "the news")
    message = heard[-1]
    assert list(message.joint_names) == NAMES
    for joint, values in enumerate(message.interface_values):
        assert tuple(values.interface_names) == INTERFACES
        found = dict(zip(INTERFACES, values.values, strict=True))
        assert found["drive_status"] == DriveStatus.ENABLED | DriveStatus.ANSWERED
        assert found["referenced"] == (joint != 3)
        assert found["position"] == found["commanded_position"] == 0.0
        assert np.isnan(found["effort"]) and found["reading_age"] == 0.0
        assert np.isnan(found["drive_temperature"]) and np.isnan(found["drive_voltage"])


def test_nothing_is_filled_for_nobody(arm_name):
    with serving_alone(arm_name) as (_, front, _, _):
        filled = []
        topics = front._state_topics
        topics._topics = [(publisher, lambda *given: filled.append(given) or b"") for publisher, _ in topics._topics]
        published = front.pulse.published
        until(lambda: front.pulse.published > published + 50, "50 joint states")
        assert not filled


# --- diagnostics ---


def latest(heard, arm):
    """The newest report's statuses of an arm by what they are about."""

    def of_arm():
        return [message for message in heard if message.status[0].hardware_id == arm]

    until(of_arm, "a report")
    return {status.name.split(": ", 1)[1]: status for status in of_arm()[-1].status}


def report_after(stage, operator):
    return latest(operator.listen(DiagnosticArray, "/diagnostics"), stage.arm.name)


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_diagnostics_of_a_sound_arm(stage, operator):
    report = report_after(stage, operator)
    assert list(report) == ["arm", "bus", "cycle", *NAMES, "front"]
    assert {status.level for status in report.values()} == {DiagnosticStatus.OK}
    assert all(status.name.startswith("episode_arm_controller: ") for status in report.values())
    assert values(report["arm"])["mode"] == report["arm"].message == "holding"
    assert values(report["joint2"])["drive"] == "enabled, answered"
    assert {"lateness p50", "lateness p99.9", "lateness max", "cycle time p99", "overruns", "scheduling"} <= set(
        values(report["cycle"])
    )
    assert {"frames sent", "wire errors", "stale reads"} <= set(values(report["bus"]))
    assert {"goals taken", "messages refused", "snapshot age"} <= set(values(report["front"]))


def test_diagnostics_name_what_is_wrong(stage, operator):
    stage.loop.unreference(1)
    stage.loop.rows["drive_status"][4] |= DriveStatus.STALLED
    stage.loop.state["counters"]["wire_errors"] += 3
    stage.loop.state["counters"]["overruns"] += 2
    report = report_after(stage, operator)
    stage.loop.rows["drive_status"][4] &= ~int(DriveStatus.STALLED)
    assert report["joint2"].level == DiagnosticStatus.ERROR and "lost power" in report["joint2"].message
    assert report["joint5"].level == DiagnosticStatus.ERROR and "stalled" in report["joint5"].message
    assert report["joint1"].level == report["arm"].level == DiagnosticStatus.OK
    assert report["bus"].level == DiagnosticStatus.WARN and "3 wire errors" in report["bus"].message
    assert report["cycle"].level == DiagnosticStatus.WARN and "2 cycles missed" in report["cycle"].message


def test_diagnostics_show_what_drives_measure_and_warn_of(stage, operator):
    rows = stage.loop.rows
    assert not {"temperature", "supply", "effort"} & values(report_after(stage, operator)["joint3"]).keys()
    rows["drive_temperature_c"][2], rows["drive_voltage_v"][2], rows["measured_effort"][2] = 51.5, 23.75, -1.25
    rows["drive_status"][2] |= int(DriveStatus.OVER_TEMPERATURE)
    rows["drive_status"][3] |= int(DriveStatus.PROTECTED | DriveStatus.OVER_CURRENT)
    report = report_after(stage, operator)
    shown = values(report["joint3"])
    assert (shown["temperature"], shown["supply"], shown["effort"]) == ("51.500 °C", "23.750 V", "-1.250 Nm")
    assert (report["joint3"].level, report["joint3"].message) == (
        DiagnosticStatus.WARN,
        "The drive of joint3 warns: over-temperature.",
    )
    assert (report["joint4"].level, report["joint4"].message) == (
        DiagnosticStatus.ERROR,
        "The drive of joint4 says: protected, over-current; remove the cause.",
    )
    for word in ("measured_effort", "drive_temperature_c", "drive_voltage_v"):
        rows[word] = np.nan
    rows["drive_status"] = DriveStatus.ENABLED | DriveStatus.ANSWERED


def test_what_happened_once_is_told_once(stage, operator):
    heard = operator.listen(DiagnosticArray, "/diagnostics")
    until(lambda: heard, "a report")
    stage.loop.state["counters"]["overruns"] += 1
    levels = []
    until(lambda: len(heard) > 3, "three more reports")
    for message in heard[1:]:
        levels += [s.level for s in message.status if s.name.endswith(": cycle")]
    assert levels.count(DiagnosticStatus.WARN) == 1


def test_bus_load_is_that_since_the_last_report(stage, operator):
    def half_a_bus(loop):
        loop.state["counters"]["bits_on_bus"] += 500_000 * loop.period_ns // 2 // 10**9

    stage.loop.cycle_hook = half_a_bus
    stage.loop.state["header"]["bitrates"][0] = 500_000
    heard = operator.listen(DiagnosticArray, "/diagnostics")
    until(lambda: len(heard) > 2, "three reports")
    stage.loop.state["header"]["bitrates"][0] = 0
    bus = latest(heard, stage.arm.name)["bus"]
    assert bus.level == DiagnosticStatus.OK and bus.message == f"load {values(bus)['load']}"
    assert float(values(bus)["load"].removesuffix("%")) == pytest.approx(50.0, rel=0.1)


def test_diagnostics_tell_a_fault_and_that_nobody_controls(stage, operator):
    heard = operator.listen(DiagnosticArray, "/diagnostics")
    stage.loop.fault(Fault.FOLLOWING_ERROR, 3, 0.12, 0.1)
    until(lambda: latest(heard, stage.arm.name)["arm"].level == DiagnosticStatus.ERROR, "the fault")
    assert latest(heard, stage.arm.name)["arm"].message.startswith("joint4 was 0.1200 rad from where")
    stage.loop.die()
    until(lambda: "has ended" in latest(heard, stage.arm.name)["arm"].message, "the end")
    assert list(latest(heard, stage.arm.name)) == ["arm", "front"]


def test_diagnostics_tell_that_drives_are_limp(stage, operator):
    assert trigger(operator, "disable")[0]
    report = report_after(stage, operator)
    assert report["arm"].level == DiagnosticStatus.WARN and "~/enable" in report["arm"].message


# --- services ---


def test_hold_and_resume(stage, operator, moving):
    def still_slowing(loop):
        loop.rows["commanded_velocity_rad_s"] = 0.0 if slowed.is_set() else 0.1

    slowed = threading.Event()
    stage.loop.cycle_hook = still_slowing
    until(stage.loop.rows["commanded_velocity_rad_s"].any, "motion")
    holding = operator.ask(Trigger, "~/hold")
    until(lambda: stage.loop.paused, "a hold")
    cycle = stage.loop.snapshot["cycle"]
    until(lambda: stage.loop.snapshot["cycle"] > cycle + 10, "some cycles")
    assert not holding.done()
    slowed.set()
    until(holding.done, "the answer")
    assert holding.result().success and "~/resume" in holding.result().message
    assert trigger(operator, "resume") == (True, "The goal goes on.")
    assert not stage.loop.paused and stage.loop.active


def test_a_hold_that_waits_holds_up_nobody(stage, operator, moving):
    stage.loop.cycle_hook = lambda loop: loop.rows["commanded_velocity_rad_s"].fill(0.1)
    holding = operator.ask(Trigger, "~/hold")
    until(lambda: stage.loop.paused, "a hold")
    assert operator.get_parameters("constraints.goal_time") == [0.4]
    assert not trigger(operator, "free")[0]
    moving.cancel_goal_async()
    assert stage.client.result(moving)[0] == CANCELED
    assert not holding.done()
    stage.loop.cycle_hook = lambda loop: None
    stage.loop.rows["commanded_velocity_rad_s"] = 0.0
    until(holding.done, "the answer")
    assert holding.result().message == "The arm stands and takes no goals before ~/resume."
    assert trigger(operator, "resume") == (True, "The arm takes goals again.")


def test_without_a_goal_the_arm_is_held_too(stage, operator):
    assert trigger(operator, "hold") == (True, "The arm stands and takes no goals before ~/resume.")
    assert stage.client.run(goal())[0] == ABORTED
    assert trigger(operator, "resume") == (True, "The arm takes goals again.")
    assert trigger(operator, "resume") == (True, "The arm is not held.")


@pytest.mark.parametrize(("name", "mode"), [("disable", Mode.DISABLED), ("free", Mode.FREE)])
def test_limp_and_back(stage, operator, name, mode):
    done, words = trigger(operator, name)
    assert done and "limp" in words and stage.loop.snapshot["mode"] == mode
    status, code, words = stage.client.run(goal())
    assert (status, code) == (ABORTED, -1) and "enable the drives" in words
    done, words = trigger(operator, "enable")
    assert done and words == "The drives are enabled; the arm holds where it stands."
    assert stage.loop.snapshot["mode"] == Mode.HOLDING
    assert stage.client.run(goal())[0] == SUCCEEDED


def test_a_moving_arm_is_not_let_go(stage, operator, moving):
    for name in ("disable", "free"):
        done, words = trigger(operator, name)
        assert not done and words.startswith("The arm is moving")
    assert stage.loop.active


def test_drives_that_cannot_be_enabled_are_named_at_once(stage, operator):
    assert trigger(operator, "disable")[0]
    stage.loop.bring_up_fails = True
    begun = time.monotonic()
    done, words = trigger(operator, "enable")
    assert not done and words.startswith("Bringing up the drives failed")
    assert time.monotonic() - begun < 5.0


def test_enable_says_what_else_is_missing(stage, operator):
    assert trigger(operator, "disable")[0]
    stage.loop.unreference(2)
    done, words = trigger(operator, "enable")
    assert done and words.startswith("The drives are enabled; ") and "The drive of joint3 may have lost power" in words


def test_a_fault_is_cleared(stage, operator):
    done, words = trigger(operator, "clear_fault")
    assert done and "nothing to clear" in words
    stage.loop.fault(Fault.FOLLOWING_ERROR, 3, 0.12, 0.1)
    until(lambda: not stage.serves(), "the fault")
    done, words = trigger(operator, "enable")
    assert not done and words.startswith("A fault is latched; clear it first") and "joint4" in words
    assert trigger(operator, "clear_fault") == (True, "The fault is cleared; the arm holds where it stands.")
    assert stage.client.run(goal())[0] == SUCCEEDED


def test_a_fault_that_comes_back(stage, operator):
    stage.loop.fault(Fault.DRIVE_FAULT, 3, 0.0, 0.0)
    until(lambda: not stage.serves(), "the fault")
    stage.loop.bring_up_fails = True
    done, words = trigger(operator, "clear_fault")
    assert not done and words.startswith("The fault was cleared and came back. Bringing up the drives failed")


def test_nobody_to_ask(stage, operator):
    stage.loop.die()
    until(lambda: not stage.serves(), "the end")
    for name in ("enable", "disable", "free", "hold", "resume"):
        done, words = trigger(operator, name)
        assert not done and "has ended" in words


def test_whoever_waits_at_the_end_is_answered(operator, arm_name):
    with serving_alone(arm_name) as (loop, front, client, thread):
        client.send(goal(seconds=20))
        until(lambda: loop.active, "motion")
        loop.cycle_hook = lambda loop: loop.rows["commanded_velocity_rad_s"].fill(0.1)
        holding = operator.ask(Trigger, f"/alone_{arm_name}/hold")
        until(lambda: loop.paused, "a hold")
        closer = threading.Thread(target=front.close, args=(2.0,))
        closer.start()
        until(holding.done, "the answer")
        assert not holding.result().success and "was stopped before" in holding.result().message
        closer.join(10.0)
        assert not thread.is_alive()


def test_query_state(stage, operator, moving):
    snapshot = stage.loop.snapshot
    now_ns, clock_ns = int(snapshot["epoch_ns"]), float(snapshot["trajectory_clock_ns"])
    asked = now_ns + 10 * 10**9 - round(clock_ns)
    request = QueryTrajectoryState.Request(time=Time(sec=asked // 10**9, nanosec=asked % 10**9))
    response = operator.call(QueryTrajectoryState, "~/query_state", request)
    assert response.success and not response.message and list(response.name) == NAMES
    assert list(response.position) == pytest.approx([0.1] * 6, abs=1e-3)  # half way, after 10 of 20 s
    assert len(response.velocity) == len(response.acceleration) == 6 and response.velocity[0] > 0


def test_query_state_says_why_not(stage, operator):
    response = operator.call(QueryTrajectoryState, "~/query_state")
    assert not response.success and response.message.startswith("No trajectory is being executed")
    assert not response.position


# --- inputs ---


@pytest.mark.parametrize("qos", [QoSProfile(depth=10), LATCHED], ids=["volatile", "transient local"])
def test_speed_scaling_from_either_kind_of_publisher(stage, operator, qos):
    publisher = operator.publisher(SpeedScalingFactor, "~/speed_scaling_input", qos)
    wanted_readers = 2 if qos is LATCHED else 1
    until(lambda: publisher.get_subscription_count() == wanted_readers, "every reader")
    for factor in (0.5, 0.0, 1.0, 0.25):
        publisher.publish(SpeedScalingFactor(factor=factor))
        until(lambda factor=factor: stage.loop.snapshot["speed_scale_asked"] == factor, f"factor {factor}")
    for bad in (-0.1, 1.1, float("nan"), float("inf")):
        publisher.publish(SpeedScalingFactor(factor=bad))
    publisher.publish(SpeedScalingFactor(factor=0.75))
    until(lambda: stage.loop.snapshot["speed_scale_asked"] == 0.75, "the factor after bad ones")
    asked = [value for kind, value in stage.loop.asked if kind == Request.SPEED_SCALE]
    assert asked == [0.5, 0.0, 1.0, 0.25, 0.75]  # each once, though a latched one comes twice


def test_a_factor_said_before_the_node_was_there_counts(operator, arm_name):
    topic = f"/alone_{arm_name}/speed_scaling_input"
    operator.publisher(SpeedScalingFactor, topic, LATCHED, awaited=False).publish(SpeedScalingFactor(factor=0.5))
    with serving_alone(arm_name) as (loop, _, _, _):
        until(lambda: loop.snapshot["speed_scale_asked"] == 0.5, "the factor")


def test_a_factor_outlives_the_control_process(stage, operator):
    operator.publisher(SpeedScalingFactor, "~/speed_scaling_input").publish(SpeedScalingFactor(factor=0.5))
    until(lambda: stage.loop.snapshot["speed_scale_asked"] == 0.5, "the factor")
    stage.loop.die()
    stage.new_loop()
    until(lambda: stage.loop.snapshot["speed_scale_asked"] == 0.5, "the factor again")
    operator.publisher(SpeedScalingFactor, "~/speed_scaling_input").publish(SpeedScalingFactor(factor=1.0))
    until(lambda: stage.loop.snapshot["speed_scale_asked"] == 1.0, "full speed")


def streamed(*points, names=NAMES):
    """A message of (time s, position rad, velocity rad/s) for all joints alike."""
    return JointTrajectory(
        joint_names=names,
        points=[
            JointTrajectoryPoint(
                positions=[position] * 6,
                velocities=[velocity] * 6,
                time_from_start=Duration(sec=int(at), nanosec=round(at % 1 * 1e9)),
            )
            for at, position, velocity in points
        ],
    )


def test_a_trajectory_on_the_topic_moves_the_arm(stage, operator):
    publisher = operator.publisher(JointTrajectory, "~/joint_trajectory")
    publisher.publish(streamed((0.4, 0.02, 0.05)))
    until(lambda: stage.loop.rows["commanded_position_rad"][0] == pytest.approx(0.02), "the motion")
    begins = [goal["begin"] for goal in stage.loop.goals.values()]
    assert int(begins[-1]["entry"]) & Entry.STREAM


def test_a_trajectory_on_the_topic_replaces_a_goal(stage, operator, moving):
    publisher = operator.publisher(JointTrajectory, "~/joint_trajectory")
    publisher.publish(streamed((0.3, 0.0, 0.0)))
    status, code, words = stage.client.result(moving)
    assert (status, code) == (ABORTED, -1) and "~/joint_trajectory" in words


def test_a_bad_trajectory_on_the_topic_moves_nothing(stage, operator, capfd):
    heard = operator.listen(DiagnosticArray, "/diagnostics")
    refused = int(values(latest(heard, stage.arm.name)["front"])["messages refused"])
    records = len(stage.loop.records)
    publisher = operator.publisher(JointTrajectory, "~/joint_trajectory")
    publisher.publish(JointTrajectory())
    publisher.publish(streamed((0.3, 0.0, 0.0), names=["elbow"] * 6))
    publisher.publish(streamed((0.3, float("nan"), 0.0)))
    until(
        lambda: int(values(latest(heard, stage.arm.name)["front"])["messages refused"]) == refused + 3,
        "three refusals in the diagnostics",
    )
    assert len(stage.loop.records) == records
    told = [s.message for m in heard for s in m.status if s.level == DiagnosticStatus.WARN and "refused" in s.message]
    assert sum(int(message.split()[0]) for message in told) == 3
    said = [line for line in capfd.readouterr().err.splitlines() if "Trajectory message dropped" in line]
    assert len(said) == 1  # of three within a second


def test_bytes_on_the_topic_that_are_no_message_are_dropped(stage, operator, capfd):
    counts = stage.front._goals.counts
    refused = counts.messages_refused
    publisher = operator.publisher(JointTrajectory, "~/joint_trajectory")
    sound = bytes(serialize_message(streamed((0.2, 0.02, 0.0))))
    said: list[str] = []

    def told() -> bool:  # once a second, and other tests have been told of theirs
        publisher.publish(sound[:60])
        said.append(capfd.readouterr().err)
        return "Trajectory message dropped: Its 60 bytes are no trajectory_msgs/msg/JointTrajectory" in "".join(said)

    until(told, "the sentence")
    assert counts.messages_refused > refused
    publisher.publish(sound)
    until(lambda: stage.loop.rows["commanded_position_rad"][0] == pytest.approx(0.02), "the motion")


def test_the_end_does_not_wait_for_a_message_being_judged(operator, arm_name, monkeypatch):
    with serving_alone(arm_name) as (_, front, _, thread):
        judge = SlowJudge(monkeypatch, serving, "plan_stream")
        publisher = operator.publisher(JointTrajectory, f"/alone_{arm_name}/joint_trajectory")
        publisher.publish(streamed((0.2, 0.02, 0.0)))
        until(judge.judging.is_set, "a message being judged")
        closer = threading.Thread(target=front.close, args=(2.0,))
        closer.start()
        closer.join(5.0)
        assert not closer.is_alive() and not thread.is_alive()
        judge.pass_on.set()


def test_a_goal_does_not_replace_a_message_that_came_while_it_was_judged(operator, arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, _, client, _):
        judge = SlowJudge(monkeypatch)
        handle = client.send(goal(seconds=5))
        until(judge.judging.is_set, "a goal being judged")
        publisher = operator.publisher(JointTrajectory, f"/alone_{arm_name}/joint_trajectory")
        publisher.publish(streamed((20.0, 0.02, 0.0)))
        until(lambda: loop.active, "streamed motion")
        streamed_goal = loop.active
        judge.pass_on.set()
        status, code, words = client.result(handle)
        assert (status, code) == (ABORTED, -1) and words.startswith("Replaced by a newer goal, or by a trajectory on")
        assert loop.active == streamed_goal


# --- parameters ---


def test_parameters_over_the_wire(stage, operator):
    names = ("joints", "command_interfaces", "state_interfaces", "interpolation_method", "constraints.joint3.goal")
    assert operator.get_parameters(*names) == [NAMES, ["position"], ["position", "velocity"], "splines", 0.01]
    done, reason = operator.set_parameter("constraints.joint3.goal", 0.2)
    assert done, reason
    assert stage.front.serving.settings.goal_tolerance_rad[2] == 0.2
    stage.client.run(goal())
    ended = max(stage.loop.goals)
    assert stage.loop.goals[ended]["goal_tolerances"]["position_rad"][2] == 0.2
    assert operator.set_parameter("constraints.joint3.goal", 0.01)[0]
    done, reason = operator.set_parameter("joints", ["joint1"])
    assert not done and reason.endswith(".")


def test_tolerances_are_not_changed_while_a_goal_runs(stage, operator, moving):
    done, reason = operator.set_parameter("constraints.goal_time", 5.0)
    assert not done and "while a goal runs" in reason
    assert operator.get_parameters("constraints.goal_time") == [0.4]
    assert stage.front.serving.settings.goal_time_s == 0.4
    stage.loop.cycle_hook = lambda loop: loop.active and loop.finish(Outcome.STOPPED)
    assert stage.client.result(moving)[0] == ABORTED
    assert operator.set_parameter("constraints.goal_time", 5.0)[0]
    assert operator.set_parameter("constraints.goal_time", 0.4)[0]
