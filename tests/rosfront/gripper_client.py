"""A client of a gripper's two actions."""

from control_msgs.action import GripperCommand, ParallelGripperCommand
from ros_client import Operator
from waiting import until

from rosfront.action_client import ActionClient


class Client(Operator):
    """What MoveIt and the full node's clients are to a gripper."""

    def __init__(self, gripper, controller):
        super().__init__(controller)
        self.actions = {
            kind: ActionClient(self.node, kind, f"/{gripper}/{name}")
            for kind, name in ((GripperCommand, "gripper_cmd"), (ParallelGripperCommand, "parallel_gripper_cmd"))
        }
        for action in self.actions.values():
            assert action.wait_for_server(20.0)

    def send(self, goal):
        self.feedback.clear()
        kind = GripperCommand if isinstance(goal, GripperCommand.Goal) else ParallelGripperCommand
        return self.sent(self.actions[kind], goal)

    def go(self, position, max_effort=0.0):
        return self.ended(self.send(command(position, max_effort)))

    def cancel(self, handle):
        future = handle.cancel_goal_async()
        until(future.done, "the answer to a cancel")
        assert len(future.result().goals_canceling) == 1


def command(position, max_effort=0.0):
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = position, max_effort
    return goal
