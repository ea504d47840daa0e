"""The launcher in ROS clothing: what its parameters mean, and the real processes behind it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from ros_client import SUCCEEDED, Client, Operator, recorded
from sensor_msgs.msg import JointState
from stack import Process
from two_buses import write_divided
from waiting import until

from config.errors import ConfigError
from config.loader import load_arm
from rosfront.start_parameters import START, BadParameter, read_given
from rtarm.launch.plan import load_plan, parameter_arguments
from rtarm.launch.robot_interface import PARAMETER_FLAGS, Start, front_arguments, remarks

# ROS takes names of letters, digits and single _, and reads texts that look like something else only in quotes.
_WORD = "[a-z][a-z0-9]{0,3}(_[a-z0-9]{1,3})?"
names = st.from_regex(rf"{_WORD}(\.{_WORD})?", fullmatch=True)
integers = st.integers(-(2**63), 2**63 - 1)
floats = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)  # ROS reads those as texts
texts = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cc", "Cs", "Zl", "Zp")), max_size=8
) | st.sampled_from(["1", "true", "1.5", "~", "[a]", "a: b", "'", '"', "#", " "])
values = st.booleans() | integers | floats | texts


# --- what the parameters mean ---


def test_without_parameters_it_is_the_real_arm() -> None:
    assert Start.of({}) == Start("episode1", False, {})
    assert Start.of({"constraints.goal_time": 1.0, "publish_mode": "joint_states"}) == Start("episode1", False, {})


def test_parameters_change_the_arm_as_the_options_of_up_do() -> None:
    start = Start.of({"arm": "./a.yaml", "usb_index": 2, "init_mode": 1, "interpolation_factor": 5, "sim": False})
    assert start == Start(
        "./a.yaml",
        False,
        {"bus": {"usb_index": 2}, "control": {"init_mode": 1}, "trajectory": {"interpolation_factor": 5}},
    )
    assert Start.of({"channel": "/dev/x"}).overrides == {"bus": {"channel": "/dev/x"}}
    assert Start.of({"sim": True, "publish_mode": "motor_angles"}) == Start("episode1", True, {})


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"usb_index": "one"}, "Parameter usb_index is 'one', and it must be a whole number: give such a value."),
        ({"usb_index": True}, "Parameter usb_index is True, and it must be a whole number: give such a value."),
        ({"sim": 1}, "Parameter sim is 1, and it must be true or false: give such a value."),
        ({"arm": 5}, "Parameter arm is 5, and it must be a text: give such a value."),
        ({"publish_mode": "both"}, "Parameter publish_mode is 'both', and allowed are joint_states and motor_angles"),
        ({"sim": True, "usb_index": 1}, "sim brings its own adapter, so usb_index cannot be given with it"),
        ({"sim": True, "channel": "a", "usb_index": 1}, "so usb_index and channel cannot be given with it"),
    ],
)
def test_what_cannot_be_meant_is_a_sentence(parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BadParameter) as refusal:
        Start.of(parameters)
    assert sentence in str(refusal.value)
    assert str(refusal.value).endswith(".")


@pytest.mark.parametrize("adapter", [{"usb_index": 1}, {"channel": "/dev/x"}])
def test_one_adapter_is_none_for_an_arm_of_several_buses(adapter: dict[str, Any], tmp_path: Path) -> None:
    start = Start.of({"arm": str(write_divided("episode1", tmp_path / "arm.yaml")), **adapter})
    with pytest.raises(ConfigError, match=r"each of the arm's buses \(shoulder, wrist\) has an adapter of its own"):
        load_plan(start.arm, start.overrides, simulated=start.simulated)


def test_what_the_tutorials_program_would_do_otherwise_is_said() -> None:
    arm = load_arm("mock")
    linear = load_arm("mock", overrides={"trajectory": {"interpolation": "linear"}})
    assert not list(remarks({"publish_mode": "joint_states", "init_mode": 1}, arm, None))
    assert not list(remarks({"interpolation_factor": 5}, linear, None))
    said = list(remarks({"interpolation_factor": 5, "publish_mode": "motor_angles"}, arm, "robot"))
    assert [sentence.split()[0] for sentence in said] == ["publish_mode", "interpolation_factor", "The"]
    assert "joint states are always published" in said[0]
    assert "interpolation_factor 5 has no effect" in said[1]
    assert "called episode_arm_controller instead of robot" in said[2]
    assert all(sentence.endswith(".") and sentence.count(". ") == 0 for sentence in said)


# --- what the arm's node is told ---


@settings(deadline=None, max_examples=examples(25))  # each joins the ROS network and leaves it
@given(st.dictionaries(names, values | st.lists(integers, min_size=1) | st.lists(floats, min_size=1), max_size=20))
def test_parameters_reach_the_node_as_they_were(parameters: dict[str, Any]) -> None:
    reached = read_given(parameter_arguments(parameters))
    assert {
        name: list(v) if isinstance(v, (list, tuple)) or hasattr(v, "typecode") else v for name, v in reached.items()
    } == (parameters)


def test_the_node_is_told_everything_but_its_name_and_its_start() -> None:
    arguments = [
        "--ros-args",
        "-p",
        "usb_index:=1",
        "-r",
        "__ns:=/left",
        "--remap",
        "__node:=robot",
        "--params-file",
        "f",
    ]
    arguments += ["-r", "a:=b", "--log-level", "debug", "--param", "x:=1", "-r", "robot_interface:__name:=other"]
    parameters = {"usb_index": 1, "x": 1, "constraints.joint1.goal": 0.5}
    told, node_name = front_arguments(arguments, parameters)
    assert node_name == "other"
    assert told == [
        *("--ros-args", "-r", "__ns:=/left", "-r", "a:=b", "--log-level", "debug"),
        *("--ros-args", "-p", "x:=1", "-p", "constraints.joint1.goal:=0.5"),
    ]
    assert not set(front_arguments(arguments, dict.fromkeys(START, 1))[0]) & {*PARAMETER_FLAGS, "f"}
    assert front_arguments([], {}) == ([], None)


# --- the real processes ---


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    started: list[Process] = []

    def run(*arguments: str) -> Process:
        started.append(Process("rtarm.launch.robot_interface", *arguments, needs_ros=True))
        return started[-1]

    yield run
    for process in started:
        process.close()


@pytest.mark.process
def test_a_parameter_file_starts_an_arm_that_plays_a_goal_and_ends_in_order(
    start: Callable[..., Process], mock_file: Path, arm_name: str, tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        f"robot_interface_node:\n  ros__parameters: {{arm: {mock_file}, init_mode: 1, constraints: {{goal_time: 3}}}}\n"
        "/**:\n  ros__parameters: {publish_mode: motor_angles, interpolation_factor: 10, elbow: 1}\n"
    )
    robot = start("--ros-args", "--params-file", str(file), "-p", "robot_interface:allow_partial_joints_goal:=false")
    robot.line_with("rtarm  running")
    assert "publish_mode motor_angles has no effect" in robot.text
    assert "interpolation_factor 10 has no effect" in robot.text
    assert "front  ready, action /episode_arm_controller/follow_joint_trajectory" in robot.text
    operator, client = Operator(), Client()
    try:
        started = ("arm", "sim", "usb_index", "channel", "init_mode", "interpolation_factor", "publish_mode")
        assert operator.get_parameters(*started) == [arm_name, False, -1, "mock", 1, 10, "joint_states"]
        others = ("constraints.goal_time", "allow_partial_joints_goal")
        assert operator.get_parameters(*others) == [3.0, False]
        status, code, _ = client.run(recorded("small"))
        assert (status, code) == (SUCCEEDED, 0)
    finally:
        operator.close()
        client.close()
    while robot.process.poll() is None:  # ros2 launch passes on what the terminal has sent as well, and people insist
        os.kill(robot.process.pid, signal.SIGINT)
        time.sleep(0.02)
    assert robot.code() == 0
    assert robot.lines[-1] == "rtarm  ended in order"
    unknown = [line for line in robot.lines if "is not known here" in line]
    assert len(unknown) == 1 and "Parameter elbow is" in unknown[0]


@pytest.mark.process
def test_a_namespace_and_remaps_reach_the_node_and_a_name_does_not(
    start: Callable[..., Process], mock_file: Path
) -> None:
    robot = start(
        *("--ros-args", "-p", f"arm:={mock_file}", "-r", "__ns:=/left", "-r", "__node:=robot"),
        *("-r", "joint_states:=states", "--log-level", "warn"),
    )
    robot.line_with("rtarm  running")
    assert "The node is called episode_arm_controller instead of robot" in robot.text
    assert "front  ready, action /left/episode_arm_controller/follow_joint_trajectory" in robot.text
    with closing(Operator("left/episode_arm_controller")) as operator:
        operator.listen(JointState, "/left/states")
        name = ("episode_arm_controller", "/left")
        until(lambda: name in operator.node.get_node_names_and_namespaces(), "the node's name")
    robot.process.terminate()
    assert robot.code() == 0


@pytest.mark.process
def test_a_simulated_arm_says_so(start: Callable[..., Process], arm_file: Path) -> None:
    robot = start("--ros-args", "-p", f"arm:={arm_file}", "-p", "sim:=true")
    robot.line_with("rtarm  running")
    with closing(Operator()) as operator:
        simulated, usb_index, channel = operator.get_parameters("sim", "usb_index", "channel")
        assert (simulated, usb_index) == (True, -1)
        assert channel.startswith("/dev/pts/")
    robot.process.send_signal(signal.SIGINT)
    assert robot.code() == 0


@pytest.mark.process
@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("-p", "usb_index:=one"), 1, "Parameter usb_index is 'one', and it must be a whole number"),
        (("-p", "usb_index"), 1, "ROS does not understand what follows --ros-args"),
        (("-p", "init_mode:=2"), 1, "init_mode is 2, but must be 0 or 1"),
        (("-p", "arm:=nobody"), 1, "no arm is called 'nobody'"),
        (("-p", "interpolation_factor:=0"), 1, "interpolation_factor is 0, but must be at least 1"),
        (("-p", "arm:=mock", "-p", "sim:=true"), 1, "so there is nothing to simulate: leave sim out."),
        (("-p", "arm:={arm}", "-p", "channel:=no_such_adapter"), 2, "no_such_adapter"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_what_cannot_be_started_is_a_sentence_and_a_code(
    arguments: tuple[str, ...], code: int, sentence: str, start: Callable[..., Process], arm_file: Path
) -> None:
    robot = start("--ros-args", *(argument.format(arm=arm_file) for argument in arguments))
    assert robot.code() == code
    # the front, where it is there already, may say behind it that the control process has ended
    assert sentence in [line for line in robot.lines if not line.startswith("front ")][-1]
    assert "Traceback" not in robot.text


@pytest.mark.process
def test_options_are_refused_with_what_to_write_instead(start: Callable[..., Process]) -> None:
    robot = start("episode1", "--sim")
    assert robot.code() == 1
    assert "write them as `--ros-args -p usb_index:=1`" in robot.text
