"""Parameters as ROS reads them: by name, for all nodes, from files, and what people may mean the arm's node by."""

import math

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from two_buses import divided

from config.loader import load_arm
from rosfront.program import CannotServe, split_arguments
from rosfront.start_parameters import NODE_NAMES, START, BadParameter, facts, read_given, require_kind

FILE = """
/**:
  ros__parameters: {usb_index: 1, channel: to_all}
robot_interface_node:
  ros__parameters: {usb_index: 2, constraints: {goal_time: 3.0}}
/left/episode_arm_controller:
  ros__parameters: {init_mode: 0}
somebody_else:
  ros__parameters: {usb_index: 9, surprise: true}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "parameters.yaml"
    path.write_text(FILE)
    return str(path)


def test_what_is_meant_for_ros_stands_apart():
    assert split_arguments(["a", "--ros-args", "-p", "x:=1"]) == (["a"], ["--ros-args", "-p", "x:=1"])
    assert split_arguments(["--ros-args", "-r", "a:=b", "--", "c", "--ros-args", "-p", "x:=1"]) == (
        ["c"],
        ["--ros-args", "-r", "a:=b", "--", "--ros-args", "-p", "x:=1"],
    )
    assert split_arguments(["a", "--", "b"]) == (["a", "b"], [])


@pytest.mark.parametrize("node", ["", *(f"{name}:" for name in NODE_NAMES), "episode_arm_controller:"])
def test_a_parameter_may_be_meant_for_any_name_of_the_node(node):
    assert read_given(["--ros-args", "-p", f"{node}usb_index:=1"]) == {"usb_index": 1}


def test_one_meant_for_somebody_else_is_not_for_us():
    assert read_given(["--ros-args", "-p", "somebody_else:usb_index:=1"]) == {}


def test_the_controllers_name_is_that_of_the_arm_that_is_given(tmp_path):
    text = "".join(
        f"  - {{name: j{n}, drive: {{family: mock}}, ratio: 1, lower_deg: -1, upper_deg: 1, motor_rpm: 1, "
        f"max_acceleration_rad_s2: 1}}\n"
        for n in (1, 2)
    )
    path = tmp_path / "own.yaml"
    path.write_text(
        f"name: own\ncontrol: {{rate_hz: 100}}\nbus: {{interface: mock}}\njoints:\n{text}"
        "front: {controller_name: own_controller}\n"
    )
    given = read_given(["--ros-args", "-p", f"arm:={path}", "-p", "own_controller:init_mode:=0"])
    assert given == {"arm": str(path), "init_mode": 0}


def test_a_file_counts_by_node_and_namespace(file):
    assert read_given(["--ros-args", "--params-file", file]) == {
        "usb_index": 2,
        "channel": "to_all",
        "constraints.goal_time": 3.0,
    }
    assert read_given(["--ros-args", "--params-file", file, "-r", "__ns:=/left"])["init_mode"] == 0
    assert read_given(["--ros-args", "--params-file", file, "-r", "__node:=somebody_else"]) == {
        "usb_index": 9,
        "channel": "to_all",
        "surprise": True,
    }


@pytest.mark.parametrize(
    "arguments",
    [["-p", "usb_index"], ["-p", "usb_index:=[1, a]"], ["--params-file", "no_such_file.yaml"], ["--bogus"]],
    ids=["no value", "mixed list", "no file", "unknown flag"],
)
def test_what_ros_does_not_understand_is_a_sentence(arguments):
    with pytest.raises(CannotServe, match=r"^ROS does not understand what follows --ros-args \(.*\): correct it\.$"):
        read_given(["--ros-args", *arguments])


@pytest.mark.parametrize("domain", ["233", "-1", "abc", "1.0", "²"])
def test_a_domain_without_ports_is_a_sentence(domain, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(CannotServe, match=f"^ROS_DOMAIN_ID is '{domain}', and allowed are whole numbers from 0 to 232"):
        read_given(["--ros-args"])


def test_the_facts_are_those_of_the_arm_as_loaded():
    assert facts(load_arm("episode1")) == {
        "arm": "episode1",
        "sim": False,
        "usb_index": 1,
        "channel": "/dev/ttyUSB1",
        "init_mode": 1,
        "interpolation_factor": 15,
        "publish_mode": "joint_states",
    }
    other = facts(load_arm("episode1", overrides={"bus": {"channel": "/dev/x"}, "control": {"init_mode": 0}}))
    assert (other["usb_index"], other["channel"], other["init_mode"]) == (-1, "/dev/x", 0)
    of_two = facts(divided("episode1"))
    assert (of_two["usb_index"], of_two["channel"]) == (-1, "/dev/ttyshoulder, /dev/ttywrist")
    assert {name: type(value) for name, value in other.items()} == {name: kind for name, (kind, _) in START.items()}


@pytest.mark.parametrize("name", START)
def test_another_kind_is_refused(name):
    kind, _ = START[name]
    for value in (1, 1.5, math.nan, True, "text", [], None):
        if type(value) is kind:
            require_kind(name, value, kind)
        else:
            with pytest.raises(
                BadParameter, match=rf"^Parameter {name} is .*, and it must be .*: give such a value\.$"
            ):
                require_kind(name, value, kind)
