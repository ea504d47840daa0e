"""What other nodes are to the arm, each in a thread of its own: MoveIt, and a person at a terminal."""

import contextlib
import json
import time
from pathlib import Path

import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint
from waiting import PATIENCE_S, until

from rosfront.action_client import ActionClient
from rtarm.client.ros import in_executor, spinning

GOALS = Path(__file__).parent / "data" / "moveit"
UNKNOWN, SUCCEEDED, CANCELED, ABORTED = (
    GoalStatus.STATUS_UNKNOWN,
    GoalStatus.STATUS_SUCCEEDED,
    GoalStatus.STATUS_CANCELED,
    GoalStatus.STATUS_ABORTED,
)
LONGEST_GOAL_S = 30.0


class Spinner:
    """A node in a context of its own, with an executor in a thread of its own."""

    def __init__(self, name):
        self.context = rclpy.Context()
        self._ends = contextlib.ExitStack()
        self._ends.callback(self.context.try_shutdown)
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name, context=self.context)
        self.feedback = []
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._ends.enter_context(spinning(self._executor))

    def asked(self, ask, what, patience_s=PATIENCE_S):
        """What is answered to `ask()`, which gives a future."""
        future = ask()
        until(future.done, what, patience_s)
        return future.result()

    def sent(self, action, goal):
        """The handle of a goal that has been answered; its feedback is kept."""
        return self.asked(
            lambda: action.send_goal_async(goal, feedback_callback=lambda m: self.feedback.append(m.feedback)),
            "the answer to a goal",
        )

    def ended(self, handle):
        """Status and result of a goal that has ended."""
        answer = self.asked(handle.get_result_async, "a result", LONGEST_GOAL_S)
        return answer.status, answer.result

    def stop_listening(self):
        """To any topic."""
        for subscription in list(self.node.subscriptions):
            in_executor(self.node, lambda subscription=subscription: self.node.destroy_subscription(subscription))

    def close(self):
        self._ends.close()


class Client(Spinner):
    """What MoveIt is to the arm: an action client and a listener to /joint_states."""

    def __init__(self, controller="episode_arm_controller"):
        super().__init__("client")
        self.action = ActionClient(self.node, FollowJointTrajectory, f"/{controller}/follow_joint_trajectory")
        self.states = []
        for qos in (10, qos_profile_sensor_data):
            self.node.create_subscription(JointState, "joint_states", self._heard(qos), qos)
        self.sensor_data = 0
        assert self.action.wait_for_server(PATIENCE_S)

    def _heard(self, qos):
        def heard(message):
            if qos == 10:
                self.states.append((time.monotonic(), message))
            else:
                self.sensor_data += 1

        return heard

    def send(self, goal):
        return self.sent(self.action, goal)

    def result(self, handle):
        status, result = self.ended(handle)
        return status, result.error_code, result.error_string

    def run(self, goal):
        return self.result(self.send(goal))


class Operator(Spinner):
    """A person at a terminal: listens, publishes, calls services, sets parameters."""

    def __init__(self, controller="episode_arm_controller"):
        super().__init__("operator")
        self.controller = controller
        self._clients, self.publishers = {}, []

    def name(self, topic):
        """A name with ~ as the arm's node means it."""
        return topic.replace("~", f"/{self.controller}")

    def listen(self, kind, topic, qos=10):
        """The list of messages that grows from now on, once the arm's publisher is found."""
        heard = []
        subscription = self.node.create_subscription(kind, self.name(topic), heard.append, qos)
        until(subscription.get_publisher_count, f"a publisher of {topic}")
        return heard

    def publisher(self, kind, topic, qos=10, *, awaited=True):
        """A publisher, whom the arm has found if that is awaited."""
        publisher = self.node.create_publisher(kind, self.name(topic), qos)
        self.publishers.append(publisher)
        if awaited:
            until(publisher.get_subscription_count, f"a subscriber of {topic}")
        return publisher

    def forget(self):
        """Listen to nothing and publish nothing any more."""
        self.stop_listening()
        for publisher in self.publishers:
            in_executor(self.node, lambda publisher=publisher: self.node.destroy_publisher(publisher))
        self.publishers.clear()

    def ask(self, kind, service, request=None):
        """The future of a service's response."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, self.name(service))
        client = self._clients[service]
        assert client.wait_for_service(PATIENCE_S)
        return client.call_async(request or kind.Request())

    def call(self, kind, service, request=None):
        """A service's response."""
        future = self.ask(kind, service, request)
        until(future.done, f"the answer of {service}", LONGEST_GOAL_S)
        return future.result()

    def set_parameter(self, name, value):
        """Whether a parameter was set, and the reason why not."""
        parameter = Parameter(name, value=value).to_parameter_msg()
        response = self.call(SetParameters, "~/set_parameters", SetParameters.Request(parameters=[parameter]))
        return response.results[0].successful, response.results[0].reason

    def get_parameters(self, *names):
        """The values of parameters."""
        response = self.call(GetParameters, "~/get_parameters", GetParameters.Request(names=names))
        return [parameter_value_to_python(value) for value in response.values]


def names_seen(node):
    """Full names of all nodes, topics and services in a node's domain, as far as it has found them."""
    found = node.get_node_names_and_namespaces()
    # One whose name has not arrived yet has a namespace that is none.
    nodes = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found if namespace.startswith("/")}
    return nodes | {name for name, _ in (*node.get_topic_names_and_types(), *node.get_service_names_and_types())}


def recorded(name):
    """A goal of tests/data/moveit as a message."""
    values = json.loads((GOALS / f"{name}.json").read_text())["trajectory"]
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = values["joint_names"]
    for point in values["points"]:
        goal.trajectory.points.append(
            JointTrajectoryPoint(
                positions=point["positions"],
                velocities=point["velocities"],
                accelerations=point["accelerations"],
                time_from_start=Duration(**point["time_from_start"]),
            )
        )
    return goal
