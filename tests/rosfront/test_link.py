"""Which pair of memory files the front takes for one control process."""

import fcntl
import os

import pytest
from fake_loop import FakeLoop

from config.loader import load_arm
from rosfront.link import attach
from shm import files
from shm.errors import NotRunning


@pytest.fixture
def arm(arm_name):
    return load_arm("mock", overrides={"name": arm_name})


@pytest.fixture
def between_two_files(arm):
    """A control process that has placed its state file and not yet its command file: there lies a dead one's."""
    path = files.command_path(arm.name)
    dead = FakeLoop(arm)
    kept = path.with_name(f"{path.name}.dead")
    os.link(path, kept)
    dead.die()
    loop = FakeLoop(arm)
    to_come = path.with_name(f"{path.name}.to_come")
    os.rename(path, to_come)
    os.rename(kept, path)
    yield dead.command["header"], lambda: os.rename(to_come, path)
    to_come.unlink(missing_ok=True)
    dead.sweep()
    loop.stop()
    loop.sweep()


@pytest.mark.parametrize("differing", [None, "pid", "arm_hash", "layout_hash"])
def test_the_command_file_of_a_dead_loop_is_not_there_yet(arm, between_two_files, differing):
    """Whatever it says, it is no reason to give up: a moment later the right one is in its place."""
    header, place = between_two_files
    if differing is not None:
        header[differing] -= 1
    with pytest.raises(NotRunning, match="just starting"):
        attach(arm)
    place()
    link = attach(arm)
    assert link.loop_pid == os.getpid() and not link.loop_is_gone()
    link.close()


def test_the_front_of_a_dead_loop_is_not_in_the_way(arm, between_two_files):
    with files.command_path(arm.name).open() as other_front:
        fcntl.flock(other_front, fcntl.LOCK_EX)
        with pytest.raises(NotRunning, match="just starting"):
            attach(arm)


def test_a_dead_loops_command_file_is_left_as_it_is(arm, between_two_files):
    before = files.command_path(arm.name).read_bytes()
    with pytest.raises(NotRunning):
        attach(arm)
    assert files.command_path(arm.name).read_bytes() == before
