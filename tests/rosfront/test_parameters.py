"""The node's parameters: their rules, and what is given at the start."""

import math

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

import rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from config.loader import load_arm
from rosfront.parameters import BadParameter, Change, CheckedNode, rules
from rosfront.serving import Serving
from rosfront.settings import Settings

ARM = load_arm("mock")
RULES = {rule.name: rule for rule in rules(ARM)}
NUMBERS = [rule for rule in RULES.values() if type(rule.default) is float]


def test_the_arm_files_values_are_the_defaults():
    settings = Settings.of(ARM)
    for rule in RULES.values():
        assert rule.checked(rule.default) == rule.default
        settings = rule.adopt(settings, rule.default)
    assert settings == Settings.of(ARM)


@pytest.mark.parametrize("rule", NUMBERS, ids=lambda rule: rule.name)
def test_numbers_have_a_range_that_tools_can_show(rule):
    shown = rule.descriptor().floating_point_range[0]
    assert (shown.from_value, shown.to_value) == (rule.lowest, rule.highest)
    assert rule.checked(rule.lowest) == rule.lowest and rule.checked(rule.highest) == rule.highest
    for beyond in (math.nan, math.inf, -math.inf, -1.0, rule.highest * 1.001):
        with pytest.raises(BadParameter, match=rf"^Parameter {rule.name} is .*allowed are"):
            rule.checked(beyond)


@pytest.mark.parametrize("rule", RULES.values(), ids=lambda rule: rule.name)
def test_every_parameter_says_what_it_is_and_refuses_other_kinds(rule):
    assert rule.descriptor().description.count(".") >= 2
    assert rule.descriptor().read_only == (rule.change in (Change.NEVER, Change.STARTED, Change.AT_START))
    for other in (None, {}, b"x", object()):
        with pytest.raises(BadParameter, match="must be"):
            rule.checked(other)


def test_a_whole_number_is_a_number_and_a_truth_is_not():
    rule = RULES["constraints.goal_time"]
    assert rule.checked(2) == 2.0 and type(rule.checked(2)) is float
    with pytest.raises(BadParameter, match="is True, and it must be a number"):
        rule.checked(True)


@pytest.mark.parametrize(
    ("name", "value", "changed"),
    [
        ("constraints.goal_time", 3.0, {"goal_time_s": 3.0}),
        ("constraints.stopped_velocity_tolerance", 0.0, {"stopped_velocity_rad_s": 0.0}),
        ("constraints.joint2.goal", 0.2, {"goal_tolerance_rad": (0.01, 0.2, 0.01, 0.01, 0.01, 0.01)}),
        ("constraints.joint6.trajectory", 0.0, {"path_tolerance_rad": (0.1, 0.1, 0.1, 0.1, 0.1, 0.0)}),
        ("allow_nonzero_velocity_at_trajectory_end", True, {"allow_nonzero_end_velocity": True}),
        ("allow_partial_joints_goal", False, {"allow_partial_joints_goal": False}),
        ("action_monitor_rate", 5.0, {"feedback_hz": 5.0}),
    ],
)
def test_a_parameter_changes_one_setting(name, value, changed):
    before = Settings.of(ARM)
    after = RULES[name].adopt(before, RULES[name].checked(value))
    assert vars(after) == vars(before) | changed


# --- a node ---


@pytest.fixture
def node_with():
    """Makes a node that was started with parameters."""
    nodes = []

    def make(**given):
        arguments = ["--ros-args"]
        for name, value in given.items():
            arguments += ["-p", f"{name.replace('__', '.')}:={value}"]
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        serving = Serving(ARM)
        nodes.append(CheckedNode(ARM, serving))
        return nodes[-1], serving

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


def test_what_is_given_at_the_start_counts(node_with):
    node, serving = node_with(
        constraints__goal_time=2,
        constraints__joint3__goal=0.5,
        action_monitor_rate=7.5,
        allow_nonzero_velocity_at_trajectory_end="true",
        joints="[joint1, joint2, joint3, joint4, joint5, joint6]",
        speed_scaling__initial_scaling_factor=0.5,
    )
    assert serving.settings.goal_time_s == 2.0
    assert serving.settings.goal_tolerance_rad[2] == 0.5
    assert serving.settings.feedback_hz == 7.5
    assert serving.settings.allow_nonzero_end_velocity
    assert node.get_parameter("constraints.goal_time").value == 2.0
    assert node.get_parameter("speed_scaling.initial_scaling_factor").value == 0.5


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"constraints__goal_time": -1.0}, "Parameter constraints.goal_time is -1, and allowed are 0 to 86400"),
        ({"constraints__goal_time": "soon"}, "Parameter constraints.goal_time is 'soon', and it must be a number"),
        ({"constraints__joint1__goal": ".nan"}, "Parameter constraints.joint1.goal is nan"),
        ({"speed_scaling__initial_scaling_factor": 1.5}, "is 1.5, and allowed are 0 to 1"),
        ({"joints": "[joint2, joint1]"}, "this arm has ['joint1', 'joint2'"),
        ({"command_interfaces": "[velocity]"}, "this arm has ['position']"),
        ({"allow_partial_joints_goal": 1}, "is 1, and it must be true or false"),
    ],
)
def test_a_bad_one_ends_the_start_with_a_sentence(node_with, given, sentence):
    with pytest.raises(BadParameter) as problem:
        node_with(**given)
    assert sentence in str(problem.value) and str(problem.value).endswith(".")


def test_an_unknown_one_is_mentioned(node_with, capfd):
    node_with(open_loop_control="true", constraints__elbow__goal=0.1, use_sim_time="false")
    said = capfd.readouterr().err
    assert "Parameter open_loop_control is not known here" in said
    assert "Parameter constraints.elbow.goal is not known here" in said
    assert "use_sim_time" not in said


def test_how_the_arm_was_started_can_be_read(node_with, capfd):
    node, _ = node_with(sim="true", init_mode=1, arm=ARM.name)
    names = ("arm", "sim", "usb_index", "channel", "init_mode", "interpolation_factor", "publish_mode")
    values = [node.get_parameter(name).value for name in names]
    assert values == [ARM.name, True, -1, "mock", 1, 15, "joint_states"]
    assert "not known here" not in capfd.readouterr().err


def test_a_start_parameter_that_is_not_true_is_refused(node_with):
    with pytest.raises(BadParameter, match=r"^Parameter usb_index is 3, and this arm has -1: leave the parameter out"):
        node_with(usb_index=3)


def test_a_set_of_parameters_is_taken_as_a_whole_or_not_at_all(node_with):
    node, serving = node_with()
    good, bad = Parameter("constraints.goal_time", value=5), Parameter("constraints.joint1.goal", value=-5.0)
    result = node.set_parameters_atomically([good, bad])
    assert not result.successful and result.reason.startswith("Parameter constraints.joint1.goal is -5")
    assert serving.settings == Settings.of(ARM)
    assert node.set_parameters_atomically([good, Parameter("constraints.joint1.goal", value=0.5)]).successful
    assert (serving.settings.goal_time_s, serving.settings.goal_tolerance_rad[0]) == (5.0, 0.5)
    assert node.get_parameter("constraints.goal_time").value == 5.0


def test_who_checks_a_goal_meanwhile_sees_all_of_a_set_or_nothing_of_it(node_with, monkeypatch):
    node, _ = node_with()
    seen = []
    kept = property(lambda _serving: Settings.of(ARM), lambda _serving, settings: seen.append(settings))
    monkeypatch.setattr(Serving, "settings", kept, raising=False)
    tolerances = [Parameter(f"constraints.joint{joint}.goal", value=0.5) for joint in (1, 2, 3)]
    assert node.set_parameters_atomically(tolerances).successful
    assert [tuple(settings.goal_tolerance_rad[:3]) for settings in seen] == [(0.5, 0.5, 0.5)]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("joints", ["joint1"], "is fixed by the arm file"),
        ("interpolation_method", "none", "is fixed by the arm file"),
        ("usb_index", 2, "start the arm again with another"),
        ("sim", True, "start it with `--ros-args -p sim:=true`"),
        ("action_monitor_rate", 10.0, "start it with `--ros-args -p action_monitor_rate:=10`"),
        ("constraints.goal_time", "soon", "must be a number"),
        ("constraints.goal_time", None, "must be a number"),
        ("constraints.elbow.goal", 0.1, "There is no parameter 'constraints.elbow.goal' here"),
    ],
)
def test_a_refusal_is_a_sentence(node_with, name, value, reason):
    node, serving = node_with()
    result = node.set_parameters_atomically([Parameter(name, value=value)])
    assert not result.successful and reason in result.reason and result.reason.endswith(".")
    assert serving.settings == Settings.of(ARM)


def test_tolerances_wait_for_the_end_of_a_goal_and_the_rest_does_not(node_with, monkeypatch):
    node, serving = node_with()
    monkeypatch.setattr(Serving, "idle", property(lambda self: False))
    result = node.set_parameters_atomically([Parameter("constraints.joint1.trajectory", value=0.2)])
    assert not result.successful and "cannot be changed while a goal runs" in result.reason
    assert node.set_parameters_atomically(
        [Parameter("constraints.joint1.trajectory", value=0.1)]
    ).successful  # as it is
    assert node.set_parameters_atomically([Parameter("allow_partial_joints_goal", value=False)]).successful
    assert not serving.settings.allow_partial_joints_goal
