"""The trajectory printer: what it prints, line by line, and the real process under a client like MoveIt."""

import itertools
import math
import re
import signal
import time
from contextlib import closing

import numpy as np
import plain_messages
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from ros_client import ABORTED, CANCELED, SUCCEEDED, Client, Operator, recorded
from sensor_msgs.msg import JointState
from stack import Process
from trajectory_msgs.msg import JointTrajectoryPoint
from waiting import until

from rosfront.points import Columns, read_points
from rosfront.trajectory_printer import LANGUAGES, ending, greeting, report

JOINTS = [f"joint{n}" for n in range(1, 7)]
ZH = LANGUAGES["zh"]
MODULE = "rosfront.trajectory_printer"
LOG_LINE = re.compile(r"\[(INFO|WARN)\] \[[\d.]+\] \[(.*?)\]: ")


def message(times_s, positions, velocities=None):
    """A trajectory as it comes in a goal."""
    velocities = [()] * len(times_s) if velocities is None else velocities
    points = [plain_messages.point(*row) for row in zip(times_s, positions, velocities, strict=True)]
    return plain_messages.trajectory(points, JOINTS)


def printed(trajectory, words=ZH):
    return [
        *report(trajectory.joint_names, read_points(Columns.of(trajectory.points), trajectory.joint_names), words),
        *ending(words),
    ]


def contract(trajectory):
    """What the tutorial's node says of a goal, written down once more from the facts' table."""

    def row(values, form):
        return ", ".join(format(value, form) for value in values)

    bar, count = "=" * 80, len(trajectory.points)
    lines = [bar, "收到 MoveIt 轨迹!", bar, f"轨迹包含 {count} 个点", f"关节顺序: {list(trajectory.joint_names)}"]
    time_s = 0.0
    for number, point in enumerate(trajectory.points, start=1):
        time_s = point.time_from_start.sec + point.time_from_start.nanosec * 1e-9
        velocities = point.velocities if len(point.velocities) else [0.0] * len(point.positions)
        lines += [
            f"\n点 {number}/{count}:",
            f"  时间: {time_s:.3f} 秒",
            f"  位置(弧度): [{row(point.positions, '.4f')}]",
            f"  位置(度): [{row(np.degrees(point.positions), '7.2f')}]°",
            f"  速度(度/s): [{row(np.degrees(velocities), '7.2f')}]°/s",
        ]
    return [
        *lines,
        f"\n轨迹总时长: {time_s:.3f} 秒",
        "已更新关节位置到目标点",
        "轨迹接收并打印完成",
        bar + "\n",
    ]


# --- what is printed ---


def test_the_tutorials_sample_is_printed_as_there():
    """105 points at 0.1 s, whose second one the tutorial shows (facts: episode1-arm, section 4)."""
    second = [0.0010, 0.0005, 0.0005, 0.0025, 0.0007, 0.0013]
    positions = [[0.0] * 6, second, *([0.1] * 6 for _ in range(103))]
    lines = printed(message([0.1 * index for index in range(105)], positions))
    assert greeting(ZH) == ["轨迹打印节点已启动", "等待 MoveIt 发送轨迹..."]
    assert lines[:5] == [
        "=" * 80,
        "收到 MoveIt 轨迹!",
        "=" * 80,
        "轨迹包含 105 个点",
        "关节顺序: ['joint1', 'joint2', 'joint3', 'joint4', 'joint5', 'joint6']",
    ]
    assert lines[10:15] == [
        "\n点 2/105:",
        "  时间: 0.100 秒",
        "  位置(弧度): [0.0010, 0.0005, 0.0005, 0.0025, 0.0007, 0.0013]",
        "  位置(度): [   0.06,    0.03,    0.03,    0.14,    0.04,    0.07]°",
        "  速度(度/s): [   0.00,    0.00,    0.00,    0.00,    0.00,    0.00]°/s",
    ]
    assert lines[-4:] == ["\n轨迹总时长: 10.400 秒", "已更新关节位置到目标点", "轨迹接收并打印完成", "=" * 80 + "\n"]
    assert len(lines) == 5 + 105 * 5 + 4


angles = st.lists(st.floats(-400.0, 400.0), min_size=6, max_size=6)


@given(st.lists(st.tuples(angles, angles), min_size=1, max_size=5), st.booleans())
def test_every_number_can_be_read_back(rows, with_velocities):
    positions, velocities = [row[0] for row in rows], [row[1] for row in rows]
    trajectory = message(range(len(rows)), positions, velocities if with_velocities else None)
    lines = printed(trajectory)
    assert lines == contract(trajectory)
    for index, position in enumerate(positions):
        shown = [[float(number) for number in re.findall(r"-?\d+\.\d+", line)] for line in lines[6 + 5 * index :][:4]]
        assert shown[0] == [index]
        assert shown[1] == pytest.approx(position, abs=0.5001e-4)
        assert [math.radians(degrees) for degrees in shown[2]] == pytest.approx(position, abs=math.radians(0.5001e-2))
        expected = velocities[index] if with_velocities else [0.0] * 6
        assert [math.radians(degrees) for degrees in shown[3]] == pytest.approx(expected, abs=math.radians(0.5001e-2))


def test_both_languages_say_the_same():
    trajectory = message([0.0, 1.5], [[0.1] * 6, [0.2] * 6])
    chinese, english = printed(trajectory), printed(trajectory, LANGUAGES["en"])
    assert len(chinese) == len(english)
    for one, other in zip(chinese, english, strict=True):
        assert re.findall(r"[\d.]+\d", one) == re.findall(r"[\d.]+\d", other)
        assert one.startswith("\n") == other.startswith("\n") and one.startswith("  ") == other.startswith("  ")
        assert other.isascii() or set(filter(lambda letter: not letter.isascii(), other)) == {"°"}
    assert english[1] == "Received a MoveIt trajectory!"


# --- the real process ---


@pytest.fixture
def start():
    started = []

    def run(*arguments):
        started.append(Process(MODULE, *arguments, needs_ros=True))
        return started[-1]

    yield run
    for process in started:
        process.close()


@pytest.fixture
def client():
    clients = []

    def make(controller="episode_arm_controller"):
        clients.append(Client(controller))
        return clients[-1]

    yield make
    for one in clients:
        one.close()


def messages(process):
    """Level and text of what was logged, by message."""
    found = [(match.group(1), match.end(), match.start()) for match in LOG_LINE.finditer(process.text)]
    ends = [*(start for _, _, start in found[1:]), len(process.text) + 1]
    return [(level, process.text[start : end - 1]) for (level, start, _), end in zip(found, ends, strict=True)]


def long_goal(count):
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = JOINTS
    for index in range(count):
        at = Duration(sec=index // 100, nanosec=index % 100 * 10_000_000)
        goal.trajectory.points.append(JointTrajectoryPoint(positions=[index * 1e-4] * 6, time_from_start=at))
    return goal


@pytest.mark.process
def test_goals_are_printed_and_shown_and_bad_ones_do_no_harm(start, client):
    printer = start()
    moveit = client()
    until(lambda: moveit.states, "a joint state")
    state = moveit.states[0][1]
    assert (state.header.frame_id, list(state.name)) == ("", JOINTS)
    assert (list(state.position), list(state.velocity), list(state.effort)) == ([0.0] * 6, [], [])
    until(lambda: moveit.sensor_data, "a joint state by the quality of service of sensors")

    goal = recorded("large")
    assert moveit.run(goal) == (SUCCEEDED, 0, "")
    moveit.states.clear()
    until(lambda: moveit.states, "the first joint state after a goal")
    assert list(moveit.states[0][1].position) == list(goal.trajectory.points[-1].positions)

    status, code, words = moveit.run(FollowJointTrajectory.Goal())
    assert (status, code) == (ABORTED, -2) and words.startswith("The goal names no joint")
    empty = FollowJointTrajectory.Goal()
    empty.trajectory.joint_names = JOINTS
    assert moveit.run(empty) == (ABORTED, -1, "The trajectory has no points; send at least one.")
    for spoil, code in (
        (lambda points: points[1].positions.pop(), -1),
        (lambda points: points[1].positions.__setitem__(0, math.nan), -1),
        (lambda points: setattr(points[1], "time_from_start", Duration()), -1),
    ):
        bad = recorded("small")
        spoil(bad.trajectory.points)
        status, answer, words = moveit.run(bad)
        assert (status, answer) == (ABORTED, code) and words.startswith("Point 1 has ")
    unknown = recorded("small")
    unknown.trajectory.joint_names[2] = "elbow"
    status, code, words = moveit.run(unknown)
    assert (status, code) == (ABORTED, -2) and words.startswith("'elbow' in joint_names is no joint of this arm")

    turned = FollowJointTrajectory.Goal()
    turned.trajectory.joint_names = ["joint5", "joint2"]
    turned.trajectory.points = [JointTrajectoryPoint(positions=[0.5, 0.2])]
    assert moveit.run(turned)[0] == SUCCEEDED
    moveit.states.clear()
    until(lambda: moveit.states, "a joint state")
    expected = list(goal.trajectory.points[-1].positions)
    expected[4], expected[1] = 0.5, 0.2
    assert list(moveit.states[0][1].position) == expected

    printer.process.send_signal(signal.SIGINT)
    assert printer.code() == 0
    said = messages(printer)
    assert {match.group(2) for match in LOG_LINE.finditer(printer.text)} == {"trajectory_printer"}
    assert [text for level, text in said if level == "INFO"] == [
        *("轨迹打印节点已启动", "等待 MoveIt 发送轨迹..."),
        *contract(goal.trajectory),
        *contract(turned.trajectory),
    ]
    warnings = [text for level, text in said if level == "WARN"]
    assert len(warnings) == 6 and all(text.startswith("Goal aborted: ") for text in warnings)


@pytest.mark.process
def test_joint_states_come_at_an_even_rate_while_a_long_goal_is_printed(start, client):
    printer = start("--language", "en")
    moveit = client()
    handle = moveit.send(long_goal(10_000))
    moveit.states.clear()
    until(lambda: len(moveit.states) > 240, "two seconds of joint states")
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for _, m in moveit.states]
    assert all(after > before for before, after in itertools.pairwise(stamps))
    # The median, since a shared machine may suspend the whole process for a while.
    assert np.median(np.diff(stamps)) == pytest.approx(1 / 120, rel=0.05)
    asked_s = time.monotonic()
    cancel = handle.cancel_goal_async()
    until(cancel.done, "the answer to a cancel")
    assert time.monotonic() - asked_s < 2.0
    status, _, words = moveit.result(handle)
    assert (status, words.startswith("Canceled before everything was printed")) == (CANCELED, True)
    assert list(moveit.states[-1][1].position) == [0.0] * 6

    handle = moveit.send(long_goal(10_000))
    printer.line_with("Canceled before everything was printed")
    printer.line_with("Received a MoveIt trajectory!")
    printer.process.send_signal(signal.SIGINT)
    status, code, words = moveit.result(handle)
    assert (status, code, words) == (ABORTED, -1, "The printer was stopped before everything was printed.")
    assert printer.code() == 0
    assert "Traceback" not in printer.text


@pytest.mark.process
def test_names_are_relative_and_arms_of_ones_own_are_shown(start, client, mock_controller):
    path, controller = mock_controller
    start("--arm", str(path), "--ros-args", "-r", "__ns:=/left")
    moveit = client(f"left/{controller}")
    assert moveit.run(recorded("small"))[0] == SUCCEEDED
    with closing(Operator()) as operator:
        heard = operator.listen(JointState, "/left/joint_states")
        until(lambda: heard, "a joint state in the namespace")
        name = ("trajectory_printer", "/left")
        until(lambda: name in operator.node.get_node_names_and_namespaces(), "the node's name")


@pytest.fixture
def mock_controller(arm_name, tmp_path):
    """An arm file of one's own, and the name of its controller."""
    from config.loader import ARMS_FOLDER

    text = (ARMS_FOLDER / "mock.yaml").read_text(encoding="utf-8")
    controller = f"controller_{arm_name}"
    path = tmp_path / "own.yaml"
    path.write_text(text.replace("episode_arm_controller", controller), encoding="utf-8")
    return path, controller


@pytest.mark.process
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--arm", "nobody"), 1, "no arm is called 'nobody'"),
        (("--language", "de"), 2, "invalid choice: 'de'"),
        (("--ros-args", "-r", "__ns:=bad-name!"), 1, "ROS does not understand what follows --ros-args"),
    ],
    ids=["arm", "language", "ROS arguments"],
)
def test_what_cannot_be_started_is_a_sentence(start, arguments, code, words):
    printer = start(*arguments)
    assert printer.code() == code
    assert words in printer.lines[-1]
