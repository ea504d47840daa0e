"""Bad input to the control process: one sentence, exit code 2, nothing moved, nothing left behind."""

import os
import pty
import struct

import pytest
from stack import Process, Stack

from shm import layout
from shm.files import state_path

pytestmark = pytest.mark.process


@pytest.fixture
def stack(arm_name, tmp_path):
    stack = Stack(arm_name, tmp_path)
    yield stack
    stack.close()


def refused(process: Process) -> str:
    """The one sentence of a process that refused to start."""
    code = process.code()
    process.close()
    assert code == 2, process.text
    sentences = [line for line in process.lines if line.startswith("rtloop: ")]
    assert "Traceback" not in process.text
    return sentences[-1].removeprefix("rtloop: ")


def test_unknown_arm():
    sentence = refused(Process("rtloop", "no_such_arm"))
    assert "no_such_arm" in sentence
    assert "episode1" in sentence


def test_a_rate_beyond_the_bus(stack):
    sentence = refused(Process("rtloop", str(stack.arm_file), "--set", "control.rate_hz=200"))
    assert "200" in sentence
    assert "3450 bits" in sentence
    assert "123" in sentence


def test_a_rate_beyond_the_serial_link(stack):
    sentence = refused(Process("rtloop", str(stack.arm_file), "--set", "bus.serial_baud=115200"))
    assert "115200" in sentence


def test_a_missing_port(stack):
    sentence = refused(stack.start_loop("--set", "bus.channel=/dev/ttyUSB99", ready=False))
    assert sentence.startswith("There is no serial port /dev/ttyUSB99: plug the adapter in")


def test_something_that_is_no_port(stack, tmp_path):
    file = tmp_path / "file"
    file.touch()
    sentence = refused(stack.start_loop("--set", f"bus.channel={file}", ready=False))
    assert "is not a serial port" in sentence


def test_a_busy_port(stack, arm_name):
    stack.start_sim()
    stack.start_loop()
    other = Process("rtloop", str(stack.arm_file), "--set", f"name={arm_name}b")
    assert "is in use by another program" in refused(other)


def test_a_second_loop(stack):
    stack.start_sim()
    loop = stack.start_loop()
    sentence = refused(Process("rtloop", str(stack.arm_file)))
    assert f"already running (pid {loop.process.pid}" in sentence


def test_an_adapter_that_answers_bel(stack):
    stack.start_sim("--fault", "open-refused")
    sentence = refused(stack.start_loop(ready=False))
    assert "refuses to open its CAN channel (O was answered with BEL)" in sentence


def test_an_adapter_that_is_not_there_any_more(stack):
    """A terminal whose other end says nothing at all: no drive answers."""
    master, slave = pty.openpty()
    sentence = refused(stack.start_loop("--set", f"bus.channel={os.ttyname(slave)}", ready=False))
    assert "does not answer" in sentence
    os.close(master)
    os.close(slave)


def test_a_drive_that_does_not_answer(stack):
    stack.start_sim("--fault", "silent:joint=joint4,at_s=0")
    sentence = refused(stack.start_loop(ready=False))
    assert sentence.startswith("The drive of joint4 (address 4) does not answer: check its power")


def test_a_memory_file_of_another_layout(stack, arm_name):
    """A file that another version of rtarm left and nobody holds is put aside, one that is held is respected."""
    path = state_path(arm_name)
    path.write_bytes(struct.pack("<4q", layout.MAGIC, 1, 2, 3).ljust(4096, b"\0"))
    path.chmod(0o600)
    stack.start_sim()
    stack.start_loop()
    assert path.with_name(path.name + ".prev").stat().st_size == 4096
    stack.loop.close()
    path.write_bytes(struct.pack("<4q", layout.MAGIC, 1, 2, 3).ljust(4096, b"\0"))
    path.chmod(0o600)
    front = Process("rosfront", str(stack.arm_file), needs_ros=True)
    front.line_with("layout")
    front.close()
    assert "two processes come from different versions" in front.text


def test_drives_that_lost_power_are_said_to_be_unreferenced(stack):
    stack.start_sim("--unhomed")
    loop = stack.start_loop()
    loop.close()
    loop.code()
    assert "The drive of each of joint1, joint2, joint3, joint4, joint5 and joint6 may have lost power" in loop.text
