# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The ROS node: the action, the other interfaces, and the publisher's thread.

One single-threaded executor runs the callbacks of the actions and services. They never wait, and goals are checked in
another thread. A goal awaits a future, which the publisher's thread fulfils when the control process has decided the
goal. So an idle or executing arm costs the executor nothing, because nothing wakes it (a timer at the rate of
/joint_states would cost several per cent of a processor, facts: ros-from-wheels).
"""

import threading
from functools import partial
from typing import TYPE_CHECKING, Any

from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from config.schema import ArmConfig
from rosfront.action import GoalServer
from rosfront.action_goals import ActionGoals
from rosfront.diagnostics import Diagnostics
from rosfront.goal import most_points, plan_goal
from rosfront.goal_bytes import read_goal
from rosfront.goal_requests import GoalRequest
from rosfront.gripper.server import GripperServer
from rosfront.inputs import Inputs
from rosfront.joint_states import Beside, Pulse
from rosfront.link import Link
from rosfront.other_servers import OtherServers, Server
from rosfront.own_moves import OwnMoves
from rosfront.parameters import INITIAL_SCALE, CheckedNode
from rosfront.plan import NS, GoalPlan
from rosfront.program import EndSignal
from rosfront.refusals import INVALID_GOAL
from rosfront.services import Services
from rosfront.serving import Serving
from rosfront.state_topics import STATE_QOS, Feedback, Progress, StateTopics, joint_state_bytes
from shm.snapshot import Snapshot

if TYPE_CHECKING:
    from rosfront.full_node.node import FullNode

ACTION = "~/follow_joint_trajectory"
GRIPPER_STOP_S = 1.0
"""Time at shutdown for the gripper's hook to stop and close."""
SIX = 6
"""Number of joints in the full node's messages."""
WITHOUT_FULL_NODE = (
    "robot_arm_interfaces is not installed, so angle_mode, move_xyz_rotation, linear_move, read_motor_angles, "
    "set_free_mode and motor_angles are not offered: generate it with `python -m rtarm_interfaces.build`, or build "
    "it in your ROS workspace, then start again."
)


class FrontNode:
    """The node, its action server and the publisher's thread; `spin` serves until `close`."""

    def __init__(self, arm: ArmConfig, executor: SingleThreadedExecutor, link: Link | None = None) -> None:
        """Raises rosfront.parameters.BadParameter when a parameter given at the start cannot be taken, and
        rosfront.program.CannotServe when the gripper's hook cannot be loaded.
        """
        self.arm = arm
        self.serving = Serving(arm)
        self.node = CheckedNode(arm, self.serving)
        self._feedback_ns = 0
        self._last_cycle = 0
        self._progress = Progress()
        me = Server.this(arm.name, self.node.get_fully_qualified_name())
        self._other_servers = OtherServers(self.node, ACTION, me, self._tell_of_other_servers)
        goals = self._action_goals = ActionGoals(executor, self.serving, self.node.get_logger().warning)
        self._services = Services(self.node, executor, self.serving)
        self._goals = GoalServer(
            self.node,
            executor,
            ACTION,
            run=goals.run,
            accepted=lambda handle: goals.accepted(handle, partial(self._plan, handle.request)),
            cancel=goals.cancel,
            consider=lambda goal: goals.consider(goal, lambda: self._plan(goal)),
            idle=self._idle,
            of_unknown=FollowJointTrajectory.Result(error_code=INVALID_GOAL, error_string=me.written()),
            arrival=self.serving.arrival,
        )
        self._own_moves = OwnMoves(arm, self.serving, goals.put, self.node.get_logger().info)
        self._full_node = self._make_full_node(executor)
        self._gripper: GripperServer | None = None
        beside: Beside | None = None
        if arm.gripper is not None:
            self._gripper = GripperServer(self.node, executor, arm, self.serving, self._goals.counts)
            beside = Beside(joint_state_bytes(arm, arm.gripper.joint), self._gripper.worker.measured)
        initial_factor = float(self.node.get_parameter(INITIAL_SCALE).value)
        self._inputs = Inputs(self.node, executor, self.serving, self._goals.counts, initial_factor)
        self._feedback = Feedback(self.node, ACTION, arm, self._progress)
        self._state_topics = StateTopics(self.node, arm, self._progress)
        self._diagnostics = Diagnostics(
            arm,
            self.serving,
            self._goals.counts,
            self.node.create_publisher(DiagnosticArray, "/diagnostics", STATE_QOS),
            gripper=None if self._gripper is None else self._gripper.worker,
        )
        self.pulse = Pulse(
            arm,
            self.serving,
            joint_state_bytes(arm),
            self.node.create_publisher(JointState, "joint_states", STATE_QOS),
            self._look,
            self._aside,
            self.node.get_logger().info,
            link,
            beside,
        )
        executor.add_node(self.node)
        self._action_goals.start()
        self._inputs.start()
        self._other_servers.start()
        self.pulse.start()

    def _make_full_node(self, executor: SingleThreadedExecutor) -> "FullNode | None":
        """The full node's interfaces; None where the arm has not six joints or their types are not installed."""
        joints = len(self.arm.joints)
        if joints != SIX:
            self.node.get_logger().debug(
                f"The full node's interfaces are for six joints; not offered, as there are {joints}."
            )
            return None
        try:
            from rosfront.full_node.node import FullNode
        except ModuleNotFoundError as problem:
            if (problem.name or "").partition(".")[0] != "robot_arm_interfaces":
                raise
            self.node.get_logger().warning(WITHOUT_FULL_NODE)
            return None
        return FullNode(self.node, executor, self.serving, self._action_goals, self._services, self._goals.counts)

    def _idle(self) -> bool:
        """Whether no client waits for anything but goals of the arm's own action."""
        return (
            self._services.idle
            and (self._full_node is None or self._full_node.quiet)
            and (self._gripper is None or self._gripper.quiet)
        )

    # --- goals, in the executor's thread ---

    def spin(self) -> None:
        """Serve; returns after `close`, when every client has its result or its answer."""
        self._goals.spin()

    def announce(self) -> None:
        """Print `ready` once the control process is attached; returns at once."""

        def say() -> None:
            self.serving.ever_attached.wait()
            print(f"ready {self.node.get_fully_qualified_name()}/follow_joint_trajectory", flush=True)

        threading.Thread(target=say, name="announcer", daemon=True).start()

    def _plan(self, goal: Any) -> GoalPlan:
        """Check a goal and plan its waypoints; raises GoalRefused."""
        if isinstance(goal, GoalRequest):
            goal = read_goal(goal.data, most_points(self.arm))
        self._other_servers.look()
        return plan_goal(goal, self.arm, self.serving.present(), self.serving.settings)

    def _tell_of_other_servers(self, sentence: str) -> None:
        self.serving.other_server = sentence
        if sentence:
            self.node.get_logger().error(sentence)
        else:
            self.node.get_logger().info("The action has no other server any more: goals are taken again.")

    # --- every snapshot, in the publisher's thread ---

    def _look(self, snapshot: Snapshot, stamp_ns: int, fresh: bool) -> None:
        """Handle a new snapshot; `fresh`: /joint_states was published for it, so the state topics are, too."""
        if self._inputs.factor != 1.0:
            self._tell_factor(snapshot)
        self._last_cycle = snapshot["cycle"]
        execution = self.serving.look(snapshot)
        self._own_moves.look(snapshot)
        if execution is not None:
            self._progress.look(snapshot)
        if fresh:
            self._state_topics.publish(snapshot, stamp_ns)
        if self._full_node is not None:
            self._full_node.look(snapshot, stamp_ns)
        if execution is None or (self._full_node is not None and self._full_node.tell(execution, snapshot)):
            return
        now_ns = snapshot["monotonic_ns"]
        every_ns = NS / self.serving.settings.feedback_hz
        if execution.action_goal and now_ns - self._feedback_ns >= every_ns - self.arm.control.period_ns // 2:
            self._feedback_ns = now_ns
            self._feedback.publish(execution.action_goal, snapshot, stamp_ns)

    def _aside(self, link: Link | None) -> None:
        self._diagnostics.report(link)
        if self._full_node is not None:
            self._full_node.aside()

    def _tell_factor(self, snapshot: Snapshot) -> None:
        """Send the speed scaling factor to a control process that is new to this node, unless its factor was set."""
        is_new = self._last_cycle == 0 or snapshot["cycle"] < self._last_cycle
        if is_new and snapshot["speed_scale_asked"] == 1.0:
            self._inputs.ask_factor()

    # --- the end ---

    def finish(self, end: EndSignal) -> None:
        """Park, if the arm file says so and the arm is at rest; another end signal stops the arm instead."""
        self._action_goals.close()
        parking = self.arm.parking
        if parking is not None and self._own_moves.park(parking, on_end=end.give):
            end.wait(parking.timeout_s)

    def close(self, patience_s: float) -> None:
        """Stop a running goal on its path, send its client the result, and end.

        Call from neither the executor's nor the publisher's thread. Returns when the thread in `spin` has left it,
        after `patience_s` and `RESULT_GRACE_S` at the latest.
        """
        self._goals.closing = True
        self._action_goals.close()
        self._other_servers.stop()
        self.serving.close()
        self._services.close()
        if self._gripper is not None:
            self._gripper.close(GRIPPER_STOP_S)
        self._goals.leave(
            patience_s, lambda: self.serving.lost("The ROS process was stopped before the arm had come to rest.")
        )
        self._inputs.stop()
        self._action_goals.stop()
        self.pulse.stop()
