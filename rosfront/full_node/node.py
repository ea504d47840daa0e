# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""The interfaces of the arm's full node (robot_arm_interfaces): moves by angles, by pose and on a line; motor angles.

They are other interfaces to what the node does anyway: a move becomes waypoints that are checked, streamed, monitored,
canceled and decided like those of any goal, and set_free_mode does what ~/free and ~/enable do.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from robot_arm_interfaces.action import AngleMode, LinearMove, MoveXyzRotation
from robot_arm_interfaces.msg import MotorAngles
from robot_arm_interfaces.srv import ReadMotorAngles, SetFreeMode

from rosfront.action import GoalServer
from rosfront.action_goals import ActionGoals
from rosfront.diagnostics import Counts
from rosfront.full_node.asked import Move, Moves, position_and_rotation, step_of
from rosfront.plan import NS, GoalPlan
from rosfront.services import Services
from rosfront.serving import Execution, Serving
from rosfront.state_topics import STATE_QOS, along_ns
from rosfront.verdict import Status, Verdict
from sentences.told import unreferenced_sentence
from shm.snapshot import Snapshot
from shm.words import Phase

MOTOR_ANGLES_NS = NS // 30
FEEDBACK_NS = NS // 10
SILENT_S = 0.5
"""After this long without snapshots, motor_angles says why."""
NEVER_READ = "No angles have been read yet: wait for the drives to be brought up."
_DOING = {
    Phase.WAITING: "waiting to begin",
    Phase.RUNNING: "moving",
    Phase.SETTLING: "arriving",
    Phase.STOPPING: "stopping on the path",
    Phase.PAUSED: "held; ~/resume lets it go on",
}


class _Asked:
    """A goal of one of the actions, from its acceptance to its end."""

    def __init__(self, handle: ServerGoalHandle) -> None:
        self.handle = handle
        self.accepted_s = time.monotonic()
        self.move: Move | None = None
        self.told_ns = 0

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self.accepted_s


@dataclass(frozen=True)
class _Reading:
    """The angles at one moment; whether they can be trusted is determined only for a request or a subscriber."""

    stamp_ns: int
    snapshot: Snapshot
    positions_rad: tuple[float, ...] | None
    """Of each joint, the last ones that were all finite; None before there were any."""


class FullNode:
    """Three actions, two services and a topic, in addition to the node's other interfaces."""

    def __init__(
        self,
        node: Node,
        executor: SingleThreadedExecutor,
        serving: Serving,
        goals: ActionGoals,
        services: Services,
        counts: Counts,
    ) -> None:
        self._serving, self._goals, self._services = serving, goals, services
        self._joints = serving.joints
        self._moves = Moves(serving.arm)
        self._half_cycle_ns = serving.arm.control.period_ns // 2
        self._stale_ns = round(serving.arm.limits.stale_fault_s * NS)
        self._asked: dict[bytes, _Asked] = {}
        self._due_ns = 0
        self._looked_s = 0.0
        self._last: _Reading | None = None

        def server(
            kind: type, name: str, ask: Callable[[Any], Move], result: Callable[[_Asked, Verdict], Any]
        ) -> GoalServer:
            def plan_of(goal: Any, asked: _Asked | None = None) -> GoalPlan:
                move = ask(goal)
                if asked is not None:
                    asked.move = move
                return move.plan

            def accepted(handle: ServerGoalHandle) -> None:
                asked = self._asked[bytes(handle.goal_id.uuid)] = _Asked(handle)
                goals.accepted(handle, lambda: plan_of(handle.request, asked))

            return GoalServer(
                node,
                executor,
                name,
                kind=kind,
                run=goals.run,
                accepted=accepted,
                cancel=goals.cancel,
                consider=lambda goal: goals.consider(goal, lambda: plan_of(goal)),
                result=lambda handle, verdict: result(self._asked.pop(bytes(handle.goal_id.uuid)), verdict),
                counts=counts,
            )

        self._servers = (
            server(AngleMode, "angle_mode", self._angle_mode, self._angle_result),
            server(MoveXyzRotation, "move_xyz_rotation", self._move_xyz_rotation, self._pose_result),
            server(LinearMove, "linear_move", self._linear_move, self._line_result),
        )
        group = ReentrantCallbackGroup()
        node.create_service(ReadMotorAngles, "read_motor_angles", self._read, callback_group=group)
        node.create_service(SetFreeMode, "set_free_mode", self._set_free_mode, callback_group=group)
        self._publisher = node.create_publisher(MotorAngles, "motor_angles", STATE_QOS)

    @property
    def quiet(self) -> bool:
        """Whether every client of these actions has its result."""
        return all(server.quiet for server in self._servers)

    # --- what is asked for, in the worker's thread ---

    def _angle_mode(self, goal: Any) -> Move:
        return self._moves.to_angles(goal.angles, goal.speed_ratio, self._serving.present(), self._serving.settings)

    def _move_xyz_rotation(self, goal: Any) -> Move:
        return self._moves.to_pose(
            goal.position,
            goal.rotation,
            goal.ik_mode,
            goal.speed_ratio,
            self._serving.present(),
            self._serving.settings,
        )

    def _linear_move(self, goal: Any) -> Move:
        return self._moves.straight_to(
            goal.position,
            goal.rotation,
            goal.rotation_mode,
            goal.step_size,
            self._serving.present(),
            self._serving.settings,
        )

    # --- results, in the executor's thread ---

    def _angle_result(self, asked: _Asked, verdict: Verdict) -> Any:
        return AngleMode.Result(**_common(asked, verdict), final_angles=self._measured_deg())

    def _pose_result(self, asked: _Asked, verdict: Verdict) -> Any:
        result = MoveXyzRotation.Result(**_common(asked, verdict))
        if asked.move is not None:
            result.solution_angles = self._moves.motor_deg(asked.move.target_rad)
        measured = self._measured_rad()
        flange = None if measured is None else self._moves.flange(measured)
        if flange is not None:
            result.final_position, result.final_rotation = position_and_rotation(flange, asked.handle.request.ik_mode)
        return result

    def _line_result(self, asked: _Asked, verdict: Verdict) -> Any:
        return LinearMove.Result(**_common(asked, verdict), total_steps=_total_steps(asked))

    def _measured_rad(self) -> np.ndarray | None:
        snapshot = self._serving.newest()
        if snapshot is None:
            return None
        measured: np.ndarray = snapshot["joints"]["measured_position_rad"][: len(self._joints)]
        return measured

    def _measured_deg(self) -> list[float]:
        measured = self._measured_rad()
        return self._angles_deg(self._last) if measured is None else self._moves.motor_deg(measured)

    # --- services, in the executor's thread ---

    def _read(self, _: Any, response: Any) -> Any:
        last = self._last
        trouble = self._why_silent() if time.monotonic() - self._looked_s > SILENT_S else self._trouble(last)
        response.angles, response.success, response.message = self._angles_deg(last), not trouble, trouble
        return response

    async def _set_free_mode(self, request: Any, response: Any) -> Any:
        response.success, response.message = await self._services.ask("free" if request.enable else "enable")
        return response

    # --- every snapshot, in the publisher's thread ---

    def look(self, snapshot: Snapshot, stamp_ns: int) -> None:
        """Thirty times a second: keep the motor angles for requests, and publish them if there is a subscriber."""
        now_ns = snapshot["monotonic_ns"]
        if now_ns < self._due_ns - self._half_cycle_ns:
            return
        self._due_ns = max(self._due_ns + MOTOR_ANGLES_NS, now_ns)
        self._looked_s = time.monotonic()
        measured = snapshot.column("joints", "measured_position_rad")
        before = None if self._last is None else self._last.positions_rad
        self._last = _Reading(stamp_ns, snapshot, measured if all(map(math.isfinite, measured)) else before)
        if self._publisher.get_subscription_count():
            self._tell_angles(self._trouble(self._last))

    def _tell_angles(self, trouble: str) -> None:
        stamp_ns = 0 if self._last is None else self._last.stamp_ns
        self._publisher.publish(
            MotorAngles(
                timestamp=Time(sec=stamp_ns // NS, nanosec=stamp_ns % NS),
                angles=self._angles_deg(self._last),
                success=not trouble,
                message=trouble,
            )
        )

    def _angles_deg(self, reading: _Reading | None) -> list[float]:
        """Motor-side angles; zeros where none were ever known."""
        if reading is None or reading.positions_rad is None:
            return [0.0] * len(self._joints)
        return self._moves.motor_deg(np.array(reading.positions_rad))

    def _trouble(self, reading: _Reading | None) -> str:
        """Why the angles cannot be trusted; empty when they can."""
        if reading is None:
            return NEVER_READ
        now_ns = reading.snapshot["monotonic_ns"]
        for name, row in zip(self._joints, reading.snapshot["joints"][: len(self._joints)], strict=True):
            measured_ns = int(row["measured_ns"])
            if measured_ns == 0:
                return f"{name} has not been read yet: wait for the drives to be brought up."
            if now_ns - measured_ns > self._stale_ns:
                return (
                    f"{name} was read {(now_ns - measured_ns) / NS:.2f} s ago, and {self._stale_ns / NS:g} s are "
                    "allowed: look at its cable and its supply."
                )
            if not row["referenced"]:
                return unreferenced_sentence(int(row["unreferenced_reason"]), name)
        return ""

    def aside(self) -> None:
        """Once a second: if there are no snapshots, publish the last angles known and the reason."""
        if time.monotonic() - self._looked_s > SILENT_S:
            self._tell_angles(self._why_silent())

    def _why_silent(self) -> str:
        return f"These are the last angles known. {self._serving.absence}"

    def tell(self, execution: Execution, snapshot: Snapshot) -> bool:
        """Publish feedback on the goal that moves the arm; returns False where it is none of these actions'."""
        asked = self._asked.get(execution.action_goal)
        if asked is None or asked.move is None:
            return False
        now_ns = snapshot["monotonic_ns"]
        if now_ns - asked.told_ns < FEEDBACK_NS - self._half_cycle_ns:
            return True
        asked.told_ns = now_ns
        measured_rad = snapshot["joints"]["measured_position_rad"][: len(self._joints)]
        line, duration_ns = asked.move.line, int(asked.move.plan.times_ns[-1])
        progress = min(1.0, along_ns(snapshot) / duration_ns) if duration_ns else 1.0
        common = {
            "elapsed_time": asked.elapsed_s,
            "current_angles": self._moves.motor_deg(measured_rad),
            "status_message": _DOING.get(Phase(snapshot["goal_phase"]), ""),
        }
        if line is None:
            feedback = (
                AngleMode.Feedback if isinstance(asked.handle.request, AngleMode.Goal) else MoveXyzRotation.Feedback
            )
            asked.handle.publish_feedback(feedback(progress=progress, **common))
            return True
        flange = self._moves.flange(measured_rad)
        assert flange is not None  # without it there is no line
        progress, steps = line.share_at(flange, progress), _total_steps(asked)
        asked.handle.publish_feedback(
            LinearMove.Feedback(progress=progress, current_step=int(progress * steps), total_steps=steps, **common)
        )
        return True


def _common(asked: _Asked, verdict: Verdict) -> dict[str, Any]:
    """The fields that all results have."""
    note = asked.move.note if asked.move is not None else ""
    return {
        "success": verdict.status is Status.SUCCEEDED,
        "message": f"{verdict.sentence} {note}".strip(),
        "execution_time": asked.elapsed_s,
    }


def _total_steps(asked: _Asked) -> int:
    """How many steps of the requested size a line's length takes, at least one; 0 where there is no line."""
    if asked.move is None or asked.move.line is None:
        return 0
    return max(1, math.ceil(asked.move.line.length_m * 1e3 / step_of(asked.handle.request.step_size)))
