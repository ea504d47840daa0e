"""Homing and referencing with real processes: what a person types, what a ROS client calls, what Ctrl-C does."""

import math
import signal
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from observer import judge, motion_after
from ros_client import Operator
from stack import Process
from std_srvs.srv import Trigger

from shm.client import StateReader
from shm.files import open_state
from shm.words import Mode

pytestmark = pytest.mark.process

NEAR_STOPS_DEG = (-178.0, -88.0, -81.0, -27.0, -107.0, -24.0)
POSE_DEG = [-170.0, -80.0, -73.0, -20.0, -100.0, -20.0]
WITHIN_DEG = 0.2


@pytest.fixture
def stack(stack_at):
    """An arm whose drives have just been switched on."""
    return stack_at(NEAR_STOPS_DEG, "--unhomed")


@pytest.fixture
def held(stack_at):
    """An arm that stands at zero and holds, all of it referenced."""
    stack = stack_at([0.0] * 6)
    stack.start_loop()
    return stack


def rtarm(stack, *words):
    process = stack._keep(Process("rtarm", *words, "--arm", stack.name))
    code = process.code()
    return code, process.text


def true_deg(stack):
    return [math.degrees(joint.position_rad[-1]) for joint in stack.truth().values()]


def referenced(stack):
    with closing(StateReader(open_state(stack.name))) as reader:
        return reader.snapshot()["joints"]["referenced"][:6].tolist()


def test_a_person_homes_some_joints_and_says_where_the_others_stand(stack):
    stack.start_loop()
    assert referenced(stack) == [0] * 6
    code, said = rtarm(stack, "home", "joint2", "joint5")
    assert code == 0, said
    assert "joint2: on its way to its stop; Ctrl-C ends it." in said
    assert f"Homed; arm {stack.name} holds where it stands: joint2 -90.0" in said
    assert "The drive of each of joint1, joint3, joint4 and joint6 may have lost power" in said
    assert referenced(stack) == [0, 1, 0, 0, 1, 0]
    assert abs(true_deg(stack)[1] + 90) < WITHIN_DEG
    code, said = rtarm(stack, "reference", "joint1")
    assert code == 1
    assert "counts from where nobody knows" in said
    words = ("joint1=-178", "joint3=-81", "joint4=-27", "joint6=-24")
    code, said = rtarm(stack, "reference", *words)
    assert (code, referenced(stack)) == (0, [1] * 6), said
    assert "Taken: joint1 -178.00°, joint3 -81.00°" in said
    assert rtarm(stack, "home", "joint7")[0] == 1


def test_ctrl_c_ends_a_homing_run(held):
    home = held._keep(Process("rtarm", "home", "joint1", "--arm", held.name))
    home.line_with("joint1: on its way")
    before = true_deg(held)[0]
    while true_deg(held)[0] == before:
        pass
    home.process.send_signal(signal.SIGINT)
    assert home.code() == 1
    assert "Ended: the joint that was on its way stands, without a reference." in home.text
    truth = held.truth()
    since_ns = min(joint.times_ns[-1] for joint in truth.values())
    assert referenced(held) == [0, 1, 1, 1, 1, 1]
    assert rtarm(held, "reference", "joint1")[0] == 1  # nobody knows whether its count has changed
    judge(motion_after(held.truth(), since_ns, min(j.times_ns[-1] for j in held.truth().values())))


def test_the_end_of_the_control_process_ends_a_homing_run_first(held):
    home = held._keep(Process("rtarm", "home", "joint1", "--arm", held.name))
    home.line_with("joint1: on its way")
    held.loop.process.terminate()
    assert held.loop.code() == 0
    truth = held.truth()
    assert abs(truth["joint1"].velocity_rad_s[-1]) == 0.0
    assert home.code() != 0


def test_init_mode_0_homes_the_arm_at_the_start_and_a_service_whenever_it_is_asked(stack):
    stack.change(control={"init_mode": 0}, homing={"then": {"joints_deg": POSE_DEG, "speed_ratio": 1.0}})
    stack.start_loop()
    stack.loop.line_with("joint6: homed.")
    assert np.abs(np.array(true_deg(stack)) - (-180, -90, -83, -30, -110, -30)).max() < WITHIN_DEG
    stack.start_front()
    stack.front.line_with("goes to the pose that its file names")
    stack.front.line_with("The pose after homing is reached.")
    assert np.abs(np.array(true_deg(stack)) - POSE_DEG).max() < WITHIN_DEG
    stack.front.process.kill()  # a new one moves nothing: it was moved already
    stack.front.code()
    stack.start_front()
    with closing(Operator(f"controller_{stack.name}")) as operator:
        response = operator.call(Trigger, "~/home")
        assert (response.success, response.message) == (True, "Homed; the arm holds where it stands.")
        assert referenced(stack) == [1] * 6
    reader = StateReader(open_state(stack.name))
    assert int(reader.snapshot()["mode"]) == Mode.HOLDING
    reader.close()


def test_a_ros_process_that_begins_amid_homing_waits_for_its_end_and_goes_to_the_pose(stack_at):
    """Joint1 is 25 s on its way, in which a ROS process begins on a busy machine too."""
    stack = stack_at((0.0, *NEAR_STOPS_DEG[1:]), "--unhomed")
    stack.change(control={"init_mode": 0}, homing={"then": {"joints_deg": POSE_DEG, "speed_ratio": 1.0}})
    stack.start_loop()
    stack.loop.line_with("joint1: homing")
    stack.start_front()
    assert "joint6: homed." not in stack.loop.said()
    stack.front.line_with("The pose after homing is reached.")
    assert np.abs(np.array(true_deg(stack)) - POSE_DEG).max() < WITHIN_DEG


def test_an_arm_that_was_moved_while_rtarm_was_not_running_is_not_believed(held):
    held.loop.process.terminate()
    assert held.loop.code() == 0
    held.befall("count-slip:joint=joint3,at_s=0,deg=5")
    held.change(limits={"position_jump_rad": 0.05})
    held.start_loop()
    assert referenced(held) == [1, 1, 0, 1, 1, 1]
    assert "joint3 is not referenced: it stands +5.00° from where it stood when rtarm was ended" in held.loop.said()
    assert rtarm(held, "reference", "joint3")[0] == 0
    held.loop.process.kill()  # nobody knows what happens from here on
    held.loop.code()
    held.befall("count-slip:joint=joint3,at_s=0,deg=-5")
    held.start_loop()
    assert referenced(held) == [1] * 6


def test_a_run_that_was_interrupted_by_a_kill_is_not_believed_by_the_next_process(stack_at):
    """Its drive counts 0 at whatever it has met, and says nothing of it."""
    stack = stack_at([0.0, -86.0, 0.0, 0.0, 0.0, 0.0])
    stack.start_loop()
    home = stack._keep(Process("rtarm", "home", "joint2", "--arm", stack.name))
    home.line_with("joint2: on its way")
    stack.loop.process.kill()
    stack.loop.code()
    while abs(stack.truth()["joint2"].velocity_rad_s[-1]) > 0:
        pass
    stack.start_loop()
    assert referenced(stack) == [1, 0, 1, 1, 1, 1]
    assert rtarm(stack, "reference", "joint2=-90")[0] == 0
    stack.loop.process.terminate()
    assert stack.loop.code() == 0
    stack.start_loop()
    assert referenced(stack) == [1, 0, 1, 1, 1, 1]  # that word is gone with the process
    assert rtarm(stack, "home", "joint2")[0] == 0
    stack.loop.process.terminate()
    assert stack.loop.code() == 0
    stack.start_loop()
    assert referenced(stack) == [1] * 6
