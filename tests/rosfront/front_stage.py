"""A front in this process, between a stand-in for the control process and a real client."""

import contextlib
import threading

import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from fake_loop import LIMP, FakeLoop
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from ros_client import Client
from trajectory_msgs.msg import JointTrajectoryPoint
from waiting import until

from config.loader import load_arm
from rosfront import node
from rosfront.link import attach
from rosfront.node import FrontNode


class Stage:
    def __init__(self, name):
        self.arm = load_arm("mock", overrides={"name": name})
        self.loop = FakeLoop(self.arm)
        self.loop.start()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.executor = SingleThreadedExecutor()
        self.front = FrontNode(self.arm, self.executor, attach(self.arm))
        self.thread = threading.Thread(target=self.front.spin, daemon=True)
        self.thread.start()
        self.client = Client()
        until(self.serves, "serving")

    def new_loop(self):
        position = self.loop.rows["commanded_position_rad"].copy()
        before = self.loop
        if before.is_alive():
            before.stop()
        self.loop = FakeLoop(self.arm, position)
        self.loop.start()
        for memory in (before.files.state, before.files.command):
            memory.close()
        until(self.serves, "serving again")

    def reset(self):
        """A sound loop, and the arm at zero."""
        loop = self.loop
        loop.cycle_hook = lambda loop: None
        limp = loop.snapshot["mode"] in LIMP
        if not loop.is_alive() or loop.snapshot["fault"] or not loop.rows["referenced"].all() or limp:
            self.new_loop()
        loop = self.loop
        loop.paused = False
        self.front._inputs.factor = 1.0
        self.front._inputs.ask_factor()  # what the last test asked for would else come back
        until(lambda: loop.snapshot["speed_scale_asked"] == 1.0, "full speed")
        until(lambda: loop.active == 0 and loop.incoming == 0, "an idle arm")
        loop.asked.clear()
        loop.rows["commanded_position_rad"] = 0.0
        self.client.feedback.clear()

    def serves(self):
        try:
            self.front.serving.present()
        except Exception:
            return False
        return True

    def close(self):
        self.client.close()
        self.front.close(1.0)
        self.thread.join(5.0)
        self.executor.shutdown()
        self.front.node.destroy_node()
        rclpy.try_shutdown()
        self.loop.stop()
        self.loop.sweep()


class SlowJudge:
    """Goals are judged when they are let pass; `judging` is set while one is not."""

    def __init__(self, monkeypatch, module=node, name="plan_goal"):
        self.judging, self.pass_on = threading.Event(), threading.Event()
        self._judge = getattr(module, name)
        monkeypatch.setattr(module, name, self)

    def __call__(self, *arguments):
        self.judging.set()
        assert self.pass_on.wait(20.0)
        return self._judge(*arguments)


def goal(seconds=0.3, to_rad=0.01, names=None):
    message = FollowJointTrajectory.Goal()
    message.trajectory.joint_names = names or [f"joint{i}" for i in range(1, 7)]
    width = len(message.trajectory.joint_names)
    for share in (0.0, 0.5, 1.0):
        nanoseconds = round(share * seconds * 1e9)
        message.trajectory.points.append(
            JointTrajectoryPoint(
                positions=[share * to_rad] * width,
                time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9),
            )
        )
    return message


@contextlib.contextmanager
def served(arm):
    """A front of its own, beside a stand-in for the control process: loop, front, and the thread in which it spins."""
    with contextlib.ExitStack() as ends:
        loop = FakeLoop(arm)
        ends.callback(loop.stop)
        loop.start()
        if not rclpy.ok():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            ends.callback(rclpy.shutdown)
        executor = SingleThreadedExecutor()
        front = FrontNode(arm, executor, attach(arm))
        ends.callback(front.node.destroy_node)
        ends.callback(executor.shutdown)
        thread = threading.Thread(target=front.spin, daemon=True)
        thread.start()
        ends.callback(thread.join, 5.0)
        ends.callback(front.close, 2.0)
        yield loop, front, thread


@contextlib.contextmanager
def serving_alone(name, **trajectory):
    """A front and a client of their own: loop, front, client, and the thread in which the front spins."""
    controller = f"alone_{name}"
    arm = load_arm("mock", overrides={"name": name, "trajectory": trajectory, "front": {"controller_name": controller}})
    with served(arm) as (loop, front, thread), contextlib.closing(Client(controller)) as client:
        until(front.serving.ever_attached.is_set, "a front that serves")
        yield loop, front, client, thread


def pile_up(goals, monkeypatch):
    """From then on a GoalServer's action server takes goals and cancels in pairs; returns what it has taken."""
    server, taken = goals._server, []
    is_ready, take_data = server.is_ready, server.take_data

    def both_are_ready(wait_set):
        ready = is_ready(wait_set)
        if server._is_goal_request_ready != server._is_cancel_request_ready:
            server._is_goal_request_ready = server._is_cancel_request_ready = False
        return ready

    def take():
        data = take_data()
        taken.append(set(data))
        return data

    monkeypatch.setattr(server, "is_ready", both_are_ready)
    monkeypatch.setattr(server, "take_data", take)
    return taken
