# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The gripper's ROS interfaces: two actions, its services, its joint in /joint_states.

Names are those that MoveIt's controllers and the full node's clients expect. Callbacks run in the executor's thread
and never wait; the gripper's own thread fulfils the futures that goals and services await.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from control_msgs.action import GripperCommand, ParallelGripperCommand
from rclpy.action.server import GoalResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from config.gripper import OWN_HOOK, GripperConfig
from config.schema import ArmConfig
from rosfront.action import GoalServer
from rosfront.diagnostics import Counts
from rosfront.gripper.hook import Reading
from rosfront.gripper.own import hook_of
from rosfront.gripper.worker import End, Ended, GripperWorker, Motion
from rosfront.refusals import GoalRefused
from rosfront.serving import Serving
from rosfront.verdict import Status, Verdict, aborted, refused
from sentences.told import outcome_sentence
from shm.words import Outcome

SERVO_LOWEST_DEG, SERVO_HIGHEST_DEG = 0, 110
"""The range to which `servo_gripper` clamps its angle, as in the full node."""
WITHOUT_SERVICES = "robot_arm_interfaces is not installed, so gripper_control and servo_gripper are not offered."
HANG_EVERY_S = 1.0
_STATUS = {Ended.REACHED: Status.SUCCEEDED, Ended.STALLED: Status.SUCCEEDED, Ended.CANCELED: Status.CANCELED}


class GripperServer:
    """The gripper of one node; `worker` is its thread."""

    def __init__(
        self, node: Node, executor: SingleThreadedExecutor, arm: ArmConfig, serving: Serving, counts: Counts
    ) -> None:
        """Raises rosfront.program.CannotServe when the hook named by the arm file cannot be loaded."""
        assert arm.gripper is not None
        self._config = arm.gripper
        self._executor = executor
        self._log = node.get_logger()
        self._strict = arm.trajectory.strict_reject
        self._frame_id = arm.front.frame_id
        self._clock = node.get_clock()
        self._motions: dict[bytes, Motion] = {}
        self._ends: dict[bytes, End | None] = {}
        self._told_of_effort = self._told_of_velocity = False
        self._waiting: set[Future] = set()
        self._serving = serving
        self.worker = GripperWorker(arm.gripper, hook_of(arm, arm.gripper, serving), self._log.warning, self._log.info)

        def server(kind: type, name: str, asked: Callable[[Any], tuple[float, float]]) -> GoalServer:
            return GoalServer(
                node,
                executor,
                f"{arm.gripper.controller_name}/{name}" if arm.gripper else name,
                kind=kind,
                run=lambda handle: self._run(handle, asked),
                cancel=self._cancel,
                consider=lambda goal: self._consider(goal, asked),
                result=lambda handle, _: self._result(kind, self._ends.pop(bytes(handle.goal_id.uuid))),
                counts=counts,
            )

        self._servers = (
            server(GripperCommand, "gripper_cmd", self._asked),
            server(ParallelGripperCommand, "parallel_gripper_cmd", self._asked_of_joints),
        )
        group = ReentrantCallbackGroup()
        node.create_service(Trigger, f"{self._config.controller_name}/home", self._home, callback_group=group)
        try:
            from robot_arm_interfaces.srv import GripperControl, ServoGripper
        except ModuleNotFoundError as problem:
            if (problem.name or "").partition(".")[0] != "robot_arm_interfaces":
                raise
            self._log.warning(WITHOUT_SERVICES)
        else:
            node.create_service(GripperControl, "gripper_control", self._control, callback_group=group)
            node.create_service(ServoGripper, "servo_gripper", self._servo, callback_group=group)
        node.create_timer(HANG_EVERY_S, self._end_what_hangs, callback_group=group)
        self.worker.start()

    @property
    def quiet(self) -> bool:
        """Whether every client has its result or its answer."""
        return not self._waiting and all(server.quiet for server in self._servers)

    def close(self, patience_s: float) -> None:
        """Stop a running motion, send its client the result, and end."""
        self.worker.close(patience_s)
        self._give_up("The ROS process was stopped.")  # motions of a hanging hook, or begun after the worker's end

    def _end_what_hangs(self) -> None:
        """End the motions of a hook that does not return; otherwise their clients would get no answer."""
        sentence = self.worker.hang()
        if sentence:
            self._give_up(sentence)

    def _give_up(self, sentence: str) -> None:
        for motion in list(self._motions.values()):
            motion.end(End(Ended.TROUBLE, None, sentence))

    # --- what is asked for: the target (rad) and the effort (N·m); raises GoalRefused

    def _asked(self, goal: GripperCommand.Goal) -> tuple[float, float]:
        return self._checked(goal.command.position, goal.command.max_effort)

    def _asked_of_joints(self, goal: ParallelGripperCommand.Goal) -> tuple[float, float]:
        command, joint = goal.command, self._config.joint
        if len(command.position) != 1 or list(command.name) not in ([], [joint]):
            raise GoalRefused(
                f"The command has {len(command.position)} positions and the names {list(command.name)}; the gripper "
                f"has one joint, {joint}: give one position, and no other name."
            )
        if len(command.effort) > 1 or len(command.velocity) > 1:
            raise GoalRefused("The command has more efforts or velocities than positions: give one of each at most.")
        if len(command.velocity) and not self._told_of_velocity:
            self._told_of_velocity = True
            self._log.info("A gripper's goal names a velocity, which is not obeyed: gripper.speed_deg_s is its speed.")
        return self._checked(command.position[0], command.effort[0] if len(command.effort) else 0.0)

    def _checked(self, position_rad: float, max_effort: float) -> tuple[float, float]:
        config = self._config
        if not config.lower_rad <= position_rad <= config.upper_rad:
            raise GoalRefused(
                f"The gripper is to go to {position_rad:.4f} rad ({math.degrees(position_rad):.1f}°), and allowed are "
                f"{config.lower_rad:.4f} rad ({config.lower_deg:g}°) to {config.upper_rad:.4f} rad "
                f"({config.upper_deg:g}°): choose an angle in between."
            )
        if not (math.isfinite(max_effort) and max_effort >= 0.0):
            raise GoalRefused(
                f"The gripper's effort is {max_effort:g}; allowed are 0 (as much as it has) and more (N·m): correct it."
            )
        if max_effort > 0.0 and not _obeys_effort(config) and not self._told_of_effort:
            self._told_of_effort = True
            self._log.info(
                "A gripper's goal names an effort, which is not obeyed: "
                "only a servo with gripper.servo.nm_per_ampere knows what current that is."
            )
        return position_rad, max_effort

    # --- the actions

    def _consider(self, goal: Any, asked: Callable[[Any], tuple[float, float]]) -> GoalResponse:
        """As for the arm: a bad goal is accepted and aborted, the reason logged, or rejected with `strict_reject`."""
        if self._strict:
            try:
                asked(goal)
            except GoalRefused as reason:
                self._log.warning(f"Goal rejected: {reason.sentence}")
                return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _run(self, handle: ServerGoalHandle, asked: Callable[[Any], tuple[float, float]]) -> Verdict:
        key = bytes(handle.goal_id.uuid)
        self._ends[key] = None
        try:
            target_rad, max_effort = asked(handle.request)
        except GoalRefused as reason:
            return refused(reason)
        if handle.is_cancel_requested:  # the cancel was taken together with its goal, before there was a motion to stop
            return Verdict(Status.CANCELED, 0, "Canceled before the gripper had begun to move.")

        def feedback(reading: Reading) -> None:
            if handle.is_active:
                handle.publish_feedback(self._feedback(handle.request, reading))

        end = await self._carry_out(target_rad, max_effort, feedback, key)
        self._ends[key] = end
        status = _STATUS.get(end.how, Status.ABORTED)
        return aborted(end.sentence) if status is Status.ABORTED else Verdict(status, 0, end.sentence)

    async def _carry_out(
        self,
        target_rad: float | None,
        max_effort: float = 0.0,
        on_reading: Callable[[Reading], None] = lambda _: None,
        key: bytes = b"",
    ) -> End:
        """Begin a motion and wait for its end."""
        newest = self._serving.newest()
        if newest is not None and newest["held"]:
            return End(Ended.TROUBLE, self.worker.shown.reading, outcome_sentence(Outcome.REFUSED_HELD))
        ended: Future = Future()

        def on_end(end: End) -> None:
            ended.set_result(end)
            self._executor.wake()

        motion = Motion(target_rad, max_effort, on_end, on_reading)
        key = key or id(motion).to_bytes(8, "little")
        self._motions[key] = motion
        self._waiting.add(ended)
        try:
            self.worker.begin(motion)
            if not self.worker.is_alive():
                motion.end(End(Ended.TROUBLE, None, "The ROS process is being stopped."))
            end: End = await ended
        finally:
            self._waiting.discard(ended)
            del self._motions[key]
        return end

    def _cancel(self, handle: ServerGoalHandle) -> None:
        motion = self._motions.get(bytes(handle.goal_id.uuid))
        if motion is not None:
            self.worker.cancel(motion)

    def _feedback(self, goal: Any, reading: Reading) -> Any:
        if isinstance(goal, ParallelGripperCommand.Goal):
            return ParallelGripperCommand.Feedback(state=self._state(reading))
        return GripperCommand.Feedback(position=reading.position_rad, effort=reading.effort)

    def _result(self, kind: Any, end: End | None) -> Any:
        reading = end.reading if end is not None else self.worker.shown.reading
        ends = {
            "stalled": end is not None and end.how is Ended.STALLED,
            "reached_goal": end is not None and end.how is Ended.REACHED,
        }
        if kind is ParallelGripperCommand:
            return ParallelGripperCommand.Result(state=self._state(reading), **ends)
        known = reading or Reading(math.nan)
        return GripperCommand.Result(position=known.position_rad, effort=known.effort, **ends)

    def _state(self, reading: Reading | None) -> JointState:
        state = JointState()
        state.header.stamp = self._clock.now().to_msg()
        state.header.frame_id = self._frame_id
        if reading is not None:
            state.name, state.position = [self._config.joint], [reading.position_rad]
            state.velocity, state.effort = [reading.velocity_rad_s], [reading.effort]
        return state

    # --- the services

    async def _control(self, request: Any, response: Any) -> Any:
        """Close the gripper if `enable` is set, else open it."""
        end = await self._carry_out(self._config.closed_rad if request.enable else self._config.open_rad)
        response.success, response.message = end.succeeded, end.sentence
        return response

    async def _servo(self, request: Any, response: Any) -> Any:
        """Move to an angle, which is clamped; the answer contains the angle that was reached."""
        config = self._config
        angle_deg = min(max(request.angle, SERVO_LOWEST_DEG), SERVO_HIGHEST_DEG)
        angle_rad = min(max(math.radians(angle_deg), config.lower_rad), config.upper_rad)
        end = await self._carry_out(angle_rad)
        response.success, response.message = end.succeeded, end.sentence
        if end.reading is not None:
            response.actual_angle = round(math.degrees(end.reading.position_rad))
        if math.radians(request.angle) != angle_rad:
            response.message += (
                f" (The angle was {request.angle}°; it goes from {max(SERVO_LOWEST_DEG, config.lower_deg):g}° to "
                f"{min(SERVO_HIGHEST_DEG, config.upper_deg):g}°.)"
            )
        return response

    async def _home(self, _: Any, response: Any) -> Any:
        """Home the gripper."""
        end = await self._carry_out(None)
        response.success, response.message = end.succeeded, end.sentence
        return response


def _obeys_effort(config: GripperConfig) -> bool:
    """Whether the hook obeys an effort; a user's own hook may do so."""
    if OWN_HOOK.fullmatch(config.hook):
        return True
    return config.servo is not None and config.servo.nm_per_ampere is not None
