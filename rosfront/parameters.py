# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The node's parameters: upstream's names where they mean the same, and every refusal a sentence.

The arm file sets the defaults, `--ros-args -p name:=value` changes them for one start, and `ros2 param set` while the
node runs. The tolerances of a goal are fixed when it is checked. Therefore tolerances cannot be changed while a goal
runs, which would suggest otherwise. rclpy's own refusals name neither the value nor a remedy, so this node checks
first.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from config.schema import ArmConfig
from rosfront.serving import Serving
from rosfront.settings import Settings
from rosfront.start_parameters import START, BadParameter, facts, require_kind

LARGEST_TOLERANCE = 100.0
LONGEST_GOAL_TIME_S = 86_400.0
INITIAL_SCALE = "speed_scaling.initial_scaling_factor"


class Change(Enum):
    """When a parameter may be given another value."""

    NEVER = "The arm file says it; it is here to be read."
    STARTED = "It was said when the arm was started; it is here to be read."
    AT_START = "Can be given at the start, not changed while the node runs."
    STANDING = "Can be changed while no goal runs; the next goal is judged by it."
    ALWAYS = "Can be changed at any time; the next goal is judged by it."


@dataclass(frozen=True)
class Rule:
    """One parameter: what it means, which values it may have and, by `adopt`, which setting it changes."""

    name: str
    default: Any
    description: str
    change: Change
    lowest: float = 0.0
    highest: float = 0.0
    """Range of a number; unused for other kinds."""
    adopt: Callable[[Settings, Any], Settings] = lambda settings, _: settings

    def checked(self, value: Any) -> Any:
        """The value, converted to the parameter's type; raises BadParameter when it is not allowed."""
        if type(self.default) is float and type(value) is int:
            value = float(value)  # people and YAML write 1 for 1.0
        require_kind(self.name, value, type(self.default))
        if type(value) is float and not self.lowest <= value <= self.highest:
            raise BadParameter(
                f"Parameter {self.name} is {value:g}, and allowed are {self.lowest:g} to {self.highest:g}: "
                "give a value between them."
            )
        if self.change in (Change.NEVER, Change.STARTED) and value != self.default:
            raise BadParameter(
                f"Parameter {self.name} is {value!r}, and this arm has {self.default!r}: leave the parameter out, "
                "or change the arm file."
            )
        return value

    def descriptor(self) -> ParameterDescriptor:
        """What `ros2 param describe` shows."""
        ranges = []
        if type(self.default) is float:
            ranges = [FloatingPointRange(from_value=self.lowest, to_value=self.highest, step=0.0)]
        return ParameterDescriptor(
            description=f"{self.description} {self.change.value}",
            read_only=self.change in (Change.NEVER, Change.STARTED, Change.AT_START),
            floating_point_range=ranges,
        )


def rules(arm: ArmConfig) -> list[Rule]:
    """All parameters of an arm's node."""
    defaults = Settings.of(arm)
    names = [joint.name for joint in arm.joints]
    spline = arm.trajectory.interpolation == "spline"
    fixed = [
        Rule("joints", names, "Joints, in the order of every message.", Change.NEVER),
        Rule("command_interfaces", ["position"], "What the drives are told.", Change.NEVER),
        Rule("state_interfaces", ["position", "velocity"], "What is measured.", Change.NEVER),
        Rule("interpolation_method", "splines" if spline else "linear", "Motion between two points.", Change.NEVER),
        Rule(
            "interpolate_from_desired_state",
            True,
            "A new trajectory starts from the commanded state, without a jump.",
            Change.NEVER,
        ),
        Rule(
            "action_monitor_rate",
            defaults.feedback_hz,
            "Rate of the action's feedback (Hz), never above that of /joint_states; results never wait for it.",
            Change.AT_START,
            0.1,
            200.0,
            lambda settings, hz: replace(settings, feedback_hz=hz),
        ),
        Rule(
            INITIAL_SCALE,
            1.0,
            "Speed scaling factor asked of a control process that still has its own, which is 1.",
            Change.AT_START,
            0.0,
            1.0,
        ),
    ]
    live = [
        Rule(
            "constraints.goal_time",
            defaults.goal_time_s,
            "Time after the last point within which the arm must have arrived (s); 0 waits for ever.",
            Change.STANDING,
            0.0,
            LONGEST_GOAL_TIME_S,
            lambda settings, seconds: replace(settings, goal_time_s=seconds),
        ),
        Rule(
            "constraints.stopped_velocity_tolerance",
            defaults.stopped_velocity_rad_s,
            "Velocity below which a joint counts as standing at the end of a goal (rad/s); 0 does not look.",
            Change.STANDING,
            0.0,
            LARGEST_TOLERANCE,
            lambda settings, limit: replace(settings, stopped_velocity_rad_s=limit),
        ),
        Rule(
            "allow_nonzero_velocity_at_trajectory_end",
            defaults.allow_nonzero_end_velocity,
            "true takes goals whose last point still moves and brings them to rest there; false refuses them.",
            Change.ALWAYS,
            adopt=lambda settings, allowed: replace(settings, allow_nonzero_end_velocity=allowed),
        ),
        Rule(
            "allow_partial_joints_goal",
            defaults.allow_partial_joints_goal,
            "true takes goals for some of the joints, and the others hold; false refuses them.",
            Change.ALWAYS,
            adopt=lambda settings, allowed: replace(settings, allow_partial_joints_goal=allowed),
        ),
    ]
    return (
        fixed
        + _of_the_start(arm)
        + live
        + [rule for index, name in enumerate(names) for rule in _of_joint(defaults, index, name)]
    )


def _of_the_start(arm: ArmConfig) -> list[Rule]:
    """The start parameters of `robot_interface` as they took effect; only the launcher knows `sim`."""
    return [
        Rule(name, value, START[name][1], Change.AT_START if name == "sim" else Change.STARTED)
        for name, value in facts(arm).items()
    ]


def _of_joint(defaults: Settings, index: int, name: str) -> list[Rule]:
    def path(settings: Settings, limit: float) -> Settings:
        return replace(settings, path_tolerance_rad=_with(settings.path_tolerance_rad, index, limit))

    def goal(settings: Settings, limit: float) -> Settings:
        return replace(settings, goal_tolerance_rad=_with(settings.goal_tolerance_rad, index, limit))

    return [
        Rule(
            f"constraints.{name}.trajectory",
            defaults.path_tolerance_rad[index],
            f"Distance of {name} from its setpoint at which a goal is aborted (rad); 0 does not look.",
            Change.STANDING,
            0.0,
            LARGEST_TOLERANCE,
            path,
        ),
        Rule(
            f"constraints.{name}.goal",
            defaults.goal_tolerance_rad[index],
            f"Distance of {name} from the last point at which it has arrived (rad); 0 does not look.",
            Change.STANDING,
            0.0,
            LARGEST_TOLERANCE,
            goal,
        ),
    ]


def _with(values: tuple[float, ...], index: int, value: float) -> tuple[float, ...]:
    return (*values[:index], value, *values[index + 1 :])


def _as_typed(value: Any) -> str:
    return f"{value:g}" if type(value) is float else str(value).lower()


class CheckedNode(Node):
    """The arm's node: an rclpy node whose parameters are checked by `rules` and set the goals' settings."""

    def __init__(self, arm: ArmConfig, serving: Serving) -> None:
        """Raises BadParameter when a parameter given at the start cannot be taken."""
        self._serving = serving
        self._rules: dict[str, Rule] = {}
        super().__init__(arm.front.controller_name)
        self._rules = {rule.name: rule for rule in rules(arm)}
        given = {name: parameter.value for name, parameter in self._parameter_overrides.items()}
        try:
            for name, rule in self._rules.items():
                value = rule.checked(given.get(name, rule.default))
                self.declare_parameter(name, value, rule.descriptor(), ignore_override=True)
                serving.settings = rule.adopt(serving.settings, value)
        except BadParameter:
            self.destroy_node()
            raise
        for name in given:
            if not self.has_parameter(name) and not name.startswith("qos_overrides."):
                self.get_logger().warning(
                    f"Parameter {name} is not known here and has no effect: correct its name or leave it out "
                    "(docs/guides/ros-interfaces.md names those there are)."
                )

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Change all of the parameters, or none of them; the result then gives the reason."""
        try:
            admitted = [self._admitted(parameter) for parameter in parameter_list]
        except BadParameter as problem:
            return SetParametersResult(successful=False, reason=str(problem))
        result = super().set_parameters_atomically(admitted)
        if result.successful:
            settings = self._serving.settings
            for parameter in admitted:
                if parameter.name in self._rules:
                    settings = self._rules[parameter.name].adopt(settings, parameter.value)
            self._serving.settings = settings  # once: a goal that is checked meanwhile sees all of it or none
        return result

    def _admitted(self, parameter: Parameter) -> Parameter:
        """The parameter with its value converted; raises BadParameter when it cannot be set now."""
        rule = self._rules.get(parameter.name)
        if rule is None:
            if self.has_parameter(parameter.name):
                return parameter  # one of rclpy's own
            raise BadParameter(
                f"There is no parameter {parameter.name!r} here: `ros2 param list {self.get_fully_qualified_name()}` "
                "names those there are."
            )
        if rule.change is Change.NEVER:
            raise BadParameter(f"Parameter {rule.name} is fixed by the arm file: change it there and start again.")
        if rule.change is Change.STARTED:
            raise BadParameter(f"Parameter {rule.name} is fixed while the arm runs: start the arm again with another.")
        value = rule.checked(parameter.value)
        if rule.change is Change.AT_START:
            raise BadParameter(
                f"Parameter {rule.name} cannot be changed while the node runs: start it with "
                f"`--ros-args -p {rule.name}:={_as_typed(value)}`."
            )
        if rule.change is Change.STANDING and not self._serving.idle and value != self.get_parameter(rule.name).value:
            raise BadParameter(
                f"Parameter {rule.name} cannot be changed while a goal runs, which is judged by what it was "
                "begun with: set it when the goal has ended."
            )
        return Parameter(rule.name, value=value)
