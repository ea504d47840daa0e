"""A reference that is lost stays lost whatever becomes of the control process, until it is given back on purpose."""

from contextlib import closing

import pytest
from fault_rig import wait
from stack import PATIENCE_S, Process, Stack

from config.loader import load_arm
from rtloop.kept.reference_store import counts_before, path_of
from shm.client import StateReader
from shm.files import open_state
from shm.words import Fault, Unreferenced

pytestmark = pytest.mark.process


@pytest.fixture
def stack(arm_name, tmp_path):
    found = Stack(arm_name, tmp_path, start_deg=[0.0] * 6)
    found.start_sim()
    yield found
    found.close()


def reasons(stack):
    """Why each joint has no reference, by the joints' numbers."""
    with closing(StateReader(open_state(stack.name))) as reader:
        joints = reader.snapshot()["joints"][:6]
        return {n: Unreferenced(j["unreferenced_reason"]) for n, j in enumerate(joints) if not j["referenced"]}


def fault_of(stack):
    with closing(StateReader(open_state(stack.name))) as reader:
        return Fault(reader.snapshot()["fault"])


def start_and_lose_joint3(stack):
    stack.start_loop()
    stack.sim.say("silent:joint=joint3,at_s=0,until_s=0.5")
    wait(lambda: fault_of(stack) == Fault.STALE_READING, "the fault of the silent drive", PATIENCE_S)
    assert reasons(stack) == {2: Unreferenced.SILENT}


def forget_marks(stack):
    """From here on no drive can prove that it had power."""
    path_of(stack.name).with_suffix(".power").unlink()


@pytest.mark.parametrize("end", ["terminate", "kill"])
def test_a_drive_that_proves_that_it_had_power_is_known_after_a_restart(stack, end):
    start_and_lose_joint3(stack)
    wait(path_of(stack.name).with_suffix(".unreferenced").exists, "what the next process reads", PATIENCE_S)
    getattr(stack.loop.process, end)()
    stack.loop.code()
    stack.start_loop()
    assert reasons(stack) == {}
    assert "joint3: power was there all through the silence" in stack.loop.said()
    assert not path_of(stack.name).with_suffix(".unreferenced").exists()


@pytest.mark.parametrize("end", ["terminate", "kill"])
def test_no_restart_gives_a_reference_back(stack, end):
    start_and_lose_joint3(stack)
    wait(path_of(stack.name).with_suffix(".unreferenced").exists, "what the next process reads", PATIENCE_S)
    getattr(stack.loop.process, end)()
    stack.loop.code()
    forget_marks(stack)
    stack.start_loop()
    assert reasons(stack) == {2: Unreferenced.SILENT}
    assert "The drive of joint3 was silent for too long" in stack.loop.said()
    reference = stack._keep(Process("rtarm", "reference", "joint3", "--arm", stack.name))
    assert reference.code() == 0, reference.text
    getattr(stack.loop.process, end)()
    stack.loop.code()
    stack.start_loop()
    assert reasons(stack) == {}


def test_what_could_not_be_kept_is_kept_as_soon_as_it_can(stack):
    stack.start_loop()
    file = path_of(stack.name).with_suffix(".unreferenced")
    file.mkdir(parents=True)
    stack.sim.say("silent:joint=joint3,at_s=0,until_s=0.5")
    stack.loop.line_with("What is known of the reference of joint3 could not be kept in")
    file.rmdir()
    wait(file.exists, "another try", PATIENCE_S)
    stack.loop.process.kill()
    stack.loop.code()
    assert "could not be kept" not in stack.loop.said().partition("see that the file can be written.")[2]
    forget_marks(stack)
    stack.start_loop()
    assert reasons(stack) == {2: Unreferenced.SILENT}


def test_a_start_that_fails_does_not_forget_where_the_joints_stood(stack):
    stack.start_loop()
    stack.loop.process.terminate()
    assert stack.loop.code() == 0
    stood = counts_before(load_arm(stack.arm_file))
    assert len(stood) == 6
    stack.befall("count-slip:joint=joint1,at_s=0,deg=10")
    stack.befall("silent:joint=joint6,at_s=0")
    stack.start_loop(ready=False)
    assert stack.loop.code() == 2
    assert counts_before(load_arm(stack.arm_file)) == stood
    stack.befall("silent:joint=joint6,at_s=0,until_s=0")
    stack.start_loop()
    assert reasons(stack) == {0: Unreferenced.MOVED}
    assert counts_before(load_arm(stack.arm_file)) == {}
