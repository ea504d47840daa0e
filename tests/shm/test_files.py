"""The two memory files: built, found, owned, refused, and gone with their owner."""

import contextlib
import errno
import fcntl
import os
import pwd
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from waiting import ready_process

from shm import files, layout
from shm.errors import AlreadyHeld, NotPermitted, NotRunning, WrongArm, WrongLayout
from shm.files import Bus, Identity

ROOT = Path(__file__).resolve().parents[2]
ARM_HASH = 0x1234_5678_9ABC
PERIOD_NS, BITRATE = 8_333_333, 500_000
RINGS = layout.rings(2, PERIOD_NS, BITRATE)
FIXED = layout.StateFile.dtype.itemsize


def identity(arm):
    return Identity(arm, ("shoulder", "ellbögen"), ARM_HASH, PERIOD_NS, (Bus("", BITRATE),))


@pytest.fixture
def created(arm_name):
    """The arm's files, held by this process, and nothing left of them afterwards."""
    pair = files.create(identity(arm_name))
    yield pair
    pair.remove()


@pytest.fixture
def swept(arm_name):
    """An arm name whose files, however they came about, are removed afterwards."""
    yield arm_name
    for path in left_of(arm_name):
        path.rmdir() if path.is_dir() else path.unlink()


def left_of(arm):
    return sorted(files.DIRECTORY.glob(f"rtarm.{arm}.*"))


def run_python(program, *arguments):
    """A Python process of its own that prints a line when it is where the test wants it."""
    child = subprocess.Popen(
        [sys.executable, "-c", program, *arguments],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    return child


def reap(child):
    child.stdin.close()
    child.stdout.close()
    child.wait()


HOLD = """
import sys
from shm import files
pair = files.create(files.Identity(sys.argv[1], ("a", "b"), int(sys.argv[2]), 10_000_000))
print("ready", flush=True)
sys.stdin.readline()
pair.remove()
"""

HOLD_AS_FRONT = """
import sys
from shm import files
memory = files.own_command(sys.argv[1], int(sys.argv[2]))
print("ready", flush=True)
sys.stdin.readline()
"""


@pytest.fixture
def loop_process(swept):
    """A process that holds the arm's files as a control process does."""
    with ready_process("-c", HOLD, swept, str(ARM_HASH)) as child:
        yield child


# --- what is created ----------------------------------------------------------------------------------


def test_files_are_private_complete_and_described(created, arm_name):
    for memory, size in ((created.state, RINGS.file_bytes), (created.command, layout.CommandFile.dtype.itemsize)):
        status = os.stat(memory.path, follow_symlinks=False)
        assert stat.S_ISREG(status.st_mode) and stat.S_IMODE(status.st_mode) == 0o600
        assert status.st_size == len(memory.map) == size
        assert status.st_blocks * 512 >= size  # every page is there
        header = memory.record["header"]
        assert header["magic"] == layout.MAGIC and header["layout_hash"] == layout.layout_hash()
        assert header["arm_hash"] == ARM_HASH and header["pid"] == os.getpid()
        assert header["period_ns"] == 8_333_333 and header["bitrates"].tolist() == [500_000, 0, 0, 0]
        assert files.arm_name(header) == arm_name
        assert files.joint_names(header) == ("shoulder", "ellbögen")
    assert len(left_of(arm_name)) == 2
    recorder = created.state.record["recorder"]
    assert [int(recorder[name]) for name in RINGS._fields] == list(RINGS)
    start, size = created.state.rings
    assert (start, size) == (created.state.address + FIXED, RINGS.file_bytes - FIXED)


def test_an_orderly_end_leaves_nothing(arm_name):
    files.create(identity(arm_name)).remove()
    assert left_of(arm_name) == []


def test_a_reader_sees_what_the_loop_writes_and_cannot_write(created, arm_name):
    memory = files.open_state(arm_name, ARM_HASH)
    created.state.record["counters"]["cycles"] = 7
    assert memory.record["counters"]["cycles"] == 7
    with pytest.raises(ValueError, match="read-only"):
        memory.record["counters"]["cycles"] = 8
    memory.close()


def test_an_end_does_not_take_a_successors_files_away(arm_name, swept):
    first = files.create(identity(arm_name))
    os.unlink(files.state_path(arm_name))  # as if somebody had cleaned up by hand
    second = files.create(identity(arm_name))
    first.remove()
    assert files.running_arms().count(arm_name) == 1
    second.remove()


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EFBIG], ids=["full", "limited"])
def test_no_room_is_one_sentence_and_leaves_nothing(arm_name, monkeypatch, number):
    def full(fd, start, size):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(NotPermitted, match=f"no room for the {RINGS.file_bytes} bytes"):
        files.create(identity(arm_name))
    assert left_of(arm_name) == []


# --- who is refused -----------------------------------------------------------------------------------


def test_a_second_loop_is_refused_and_told_who_runs(created, arm_name):
    before = [path.stat().st_ino for path in left_of(arm_name)]
    with pytest.raises(AlreadyHeld, match=rf"already running \(pid {os.getpid()}, .*stop that one first"):
        files.create(identity(arm_name))
    assert [path.stat().st_ino for path in left_of(arm_name)] == before


def test_of_many_loops_that_start_at_once_one_wins(swept):
    program = f"""
import sys
from shm import errors, files
sys.stdin.readline()
try:
    files.create(files.Identity(sys.argv[1], ("a",), {ARM_HASH}, 10_000_000))
    print("won", flush=True)
    sys.stdin.readline()
except errors.AlreadyHeld:
    print("refused", flush=True)
"""
    stale = files.create(identity(swept))  # a dead loop's file is in the way
    stale.state.close()
    stale.command.close()
    children = [run_python(program, swept) for _ in range(4)]
    for child in children:
        child.stdin.write("go\n")
        child.stdin.flush()
    answers = [child.stdout.readline().strip() for child in children]
    for child in children:
        child.kill()
        reap(child)
    assert sorted(answers) == ["refused"] * 3 + ["won"]
    assert [path.name.rsplit(".", 1)[-1] for path in left_of(swept)] == ["command", "state", "prev"]


def test_no_loop_is_said_so(arm_name):
    for attach in (files.open_state, files.left_behind):
        with pytest.raises(NotRunning, match=rf"No control process is running for arm '{arm_name}' .*rtarm up"):
            attach(arm_name)
    assert files.front_of(arm_name) is None


def test_another_layout_is_refused_naming_both(created, arm_name, monkeypatch):
    theirs = layout.layout_hash()
    monkeypatch.setattr(layout, "layout_hash", lambda: 0xABC)
    with pytest.raises(WrongLayout, match=f"layout {theirs:016x}, this rtarm has {0xABC:016x}"):
        files.open_state(arm_name)


@pytest.mark.parametrize("content", [b"", b"short", bytes(FIXED)], ids=["empty", "short", "zeros"])
def test_a_file_that_is_not_ours_is_refused(swept, content):
    path = files.state_path(swept)
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(WrongLayout):
        files.open_state(swept)


@pytest.mark.parametrize("size", [RINGS.file_bytes + 8, RINGS.file_bytes - 8, FIXED])
def test_a_file_of_another_size_is_refused(created, arm_name, size):
    os.truncate(created.state.path, size)
    with pytest.raises(WrongLayout):
        files.open_state(arm_name)


@pytest.mark.parametrize(("word", "value"), [("joint_count", 3), ("joint_count", 0), ("joint_count", 33)])
@pytest.mark.parametrize("file", ["state", "command"])
def test_a_header_that_does_not_fit_its_file_is_refused(created, arm_name, file, word, value):
    getattr(created, file).record["header"][word] = value
    attach = files.open_state if file == "state" else files.open_command
    if file == "command" and value == 3:  # its size is the same for all arms
        attach(arm_name).close()
        return
    with pytest.raises(WrongLayout):
        attach(arm_name)


@pytest.mark.parametrize("period_ns", [0, -1, 1, 2**62])
def test_a_period_that_does_not_fit_its_file_is_refused(created, arm_name, period_ns):
    created.state.record["header"]["period_ns"] = period_ns
    with pytest.raises(WrongLayout):
        files.open_state(arm_name)


def test_another_configuration_is_refused_naming_both(created, arm_name):
    with pytest.raises(WrongArm, match=f"{ARM_HASH:016x}, this process has {ARM_HASH + 1:016x}"):
        files.open_state(arm_name, ARM_HASH + 1)
    with pytest.raises(WrongArm):
        files.own_command(arm_name, ARM_HASH + 1)


def test_a_file_others_may_read_is_refused(created, arm_name):
    created.state.path.chmod(0o644)
    with pytest.raises(NotPermitted, match="mode 644"):
        files.open_state(arm_name)


def test_somebody_elses_file_is_refused(created, arm_name, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 4321)
    with pytest.raises(
        NotPermitted, match=r"file of user \w+ with mode 600, but must be a file of uid 4321 with mode 600"
    ):
        files.open_state(arm_name)


def test_links_are_never_followed(swept, tmp_path):
    target = tmp_path / "target"
    target.write_bytes(b"precious")
    files.state_path(swept).symlink_to(target)
    for attempt in (lambda: files.open_state(swept), lambda: files.create(identity(swept))):
        with pytest.raises(NotPermitted, match=r"is a link of user .*: remove it \(`rm -r "):
            attempt()
    assert target.read_bytes() == b"precious"
    assert left_of(swept) == [files.state_path(swept)]


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_file_is_refused_without_waiting(swept, make):
    make(files.state_path(swept), 0o600)
    with pytest.raises(NotPermitted):
        files.open_state(swept)


# --- who owns what, and what a death leaves ------------------------------------------------------------


def test_a_killed_loop_lets_go_and_its_state_is_kept(loop_process, swept):
    assert files.running_arms().count(swept) == 1
    reader = files.open_state(swept)
    loop_process.kill()
    loop_process.wait()
    assert not files.is_held(reader.fd)
    reader.close()
    with pytest.raises(NotRunning, match=rf"\(pid {loop_process.pid}\) is gone without an orderly end"):
        files.open_state(swept)
    with pytest.raises(NotRunning):  # its successor may have another configuration: a front waits for that
        files.open_state(swept, ARM_HASH + 1)
    assert swept not in files.running_arms()
    successor = files.create(identity(swept))
    kept = files.state_path(swept).with_name(f"rtarm.{swept}.state.prev")
    header = np.fromfile(kept, layout.Header.dtype, count=1)[0]
    assert header["pid"] == loop_process.pid
    assert successor.state.record["header"]["pid"] == os.getpid()
    with contextlib.closing(files.left_behind(swept)) as living:
        assert living.record["header"]["pid"] == os.getpid()
    successor.remove()
    assert left_of(swept) == [kept]
    with contextlib.closing(files.left_behind(swept)) as dead:
        assert (dead.record["header"]["pid"], files.is_held(dead.fd)) == (loop_process.pid, False)
    assert swept in files.arms_left_behind() and swept not in files.running_arms()


def test_a_reader_of_a_dead_loop_keeps_its_pages(loop_process, swept):
    reader = files.open_state(swept)
    loop_process.kill()
    loop_process.wait()
    successor = files.create(identity(swept))
    assert reader.record["header"]["pid"] == loop_process.pid
    reader.close()
    successor.remove()


def test_one_front_at_a_time(created, arm_name):
    front = files.own_command(arm_name, ARM_HASH)
    front.record["heartbeat_ns"][0] = 42
    assert files.front_of(arm_name) == (os.getpid(), 42)
    with pytest.raises(AlreadyHeld, match=f"Another front already serves arm '{arm_name}'"):
        files.own_command(arm_name, ARM_HASH)
    files.open_command(arm_name).close()  # requests need no ownership
    front.close()
    assert files.front_of(arm_name) is None
    files.own_command(arm_name, ARM_HASH).close()


def test_a_killed_front_lets_go(created, arm_name):
    with ready_process("-c", HOLD_AS_FRONT, arm_name, str(ARM_HASH)) as child:
        assert files.front_of(arm_name) == (child.pid, 0)
    assert files.front_of(arm_name) is None
    files.own_command(arm_name, ARM_HASH).close()


def test_closing_lets_go_even_while_a_view_lives(created, arm_name):
    front = files.own_command(arm_name, ARM_HASH)
    view = front.record["header"]
    front.close()
    assert files.front_of(arm_name) is None
    assert view["arm_hash"] == ARM_HASH


def test_files_aside_of_killed_builders_are_removed_and_of_living_ones_kept(swept):
    path = files.state_path(swept)
    abandoned, living = (path.with_name(f"{path.name}.{n}.new") for n in (1, 2))
    abandoned.touch(0o600)
    with living.open("w") as builder:
        fcntl.flock(builder, fcntl.LOCK_EX)
        pair = files.create(identity(swept))
        assert not abandoned.exists() and living.exists()
        pair.remove()


def test_asking_who_lives_never_makes_a_starting_loop_fail(swept, monkeypatch):
    """`is_held` takes the lock for a moment; a loop that starts in it waits instead of giving up."""
    dead = files.create(identity(swept))
    dead.state.close()
    dead.command.close()
    with files.state_path(swept).open() as curious:
        fcntl.flock(curious, fcntl.LOCK_SH)
        monkeypatch.setattr(files.time, "sleep", lambda seconds: fcntl.flock(curious, fcntl.LOCK_UN))
        files.create(identity(swept)).remove()


# --- other users of the machine -----------------------------------------------------------------------------------

NOBODY = 65534
NAME_OF_NOBODY = pwd.getpwuid(NOBODY).pw_name
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")


def as_nobody(*command):
    """The exit code of a program of another user of this machine."""
    return subprocess.run(
        command, user=NOBODY, group=NOBODY, extra_groups=[], capture_output=True, stdin=subprocess.DEVNULL, check=False
    ).returncode


@as_root
def test_another_user_can_neither_read_nor_write_nor_remove(created, arm_name):
    assert as_nobody("cat", "/proc/self/status") == 0  # it can read what it may
    for path in left_of(arm_name):
        before = path.read_bytes()
        assert as_nobody("cat", path) != 0
        assert as_nobody("dd", "if=/dev/zero", f"of={path}", "bs=8", "count=1", "conv=notrunc") != 0
        assert as_nobody("truncate", "-s", "0", path) != 0
        assert as_nobody("rm", "-f", path) != 0
        assert as_nobody("chmod", "666", path) != 0
        assert path.read_bytes() == before
    assert len(left_of(arm_name)) == 2


def test_a_generous_umask_changes_nothing(arm_name):
    before = os.umask(0)
    try:
        pair = files.create(identity(arm_name))
        assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in left_of(arm_name))
        pair.remove()
    finally:
        os.umask(before)


@as_root
@pytest.mark.parametrize("name", ["state", "command"])
def test_what_another_user_has_planted_is_neither_read_nor_written(swept, name):
    """Whole in form, open to everybody: it is refused by whom it belongs to."""
    pair = files.create(identity(swept))
    content = (pair.state if name == "state" else pair.command).path.read_bytes()
    pair.remove()
    path = files.state_path(swept) if name == "state" else files.command_path(swept)
    path.write_bytes(content)
    os.chown(path, NOBODY, NOBODY)
    path.chmod(0o600)
    with pytest.raises(NotPermitted, match=f"is a file of user {NAME_OF_NOBODY} with mode 600"):
        files.open_state(swept) if name == "state" else files.open_command(swept)
    assert path.read_bytes() == content


STRANGER = 1
"""Whose files are in the way of nobody."""
PLANTED = {
    "private file": lambda path: (path.touch(0o600), path.chmod(0o600)),
    "open file": lambda path: (path.touch(), path.chmod(0o666)),
    "link": lambda path: path.symlink_to("/etc/passwd"),
    "directory": lambda path: path.mkdir(0o777),
    "pipe": lambda path: (os.mkfifo(path), path.chmod(0o666)),
    "socket": lambda path: (os.mknod(path, stat.S_IFSOCK | 0o666), path.chmod(0o666)),
}


@pytest.fixture
def ordinary():
    """An ordinary user of this machine, without root's rights, for as long as a test needs one."""

    @contextlib.contextmanager
    def acting():
        os.seteuid(NOBODY)
        try:
            yield
        finally:
            os.seteuid(0)

    return acting


def plant(kind, path):
    PLANTED[kind](path)
    os.chown(path, STRANGER, STRANGER, follow_symlinks=False)


def sentence_about(path, kind):
    """What an ordinary user is told of it: what it is, whose, what is allowed, who can help."""
    owner, word = f"user {pwd.getpwuid(STRANGER).pw_name}", kind.split()[-1]
    return (
        rf"^{path} is a {word} of {owner} with mode \d+, but must be a file of user {NAME_OF_NOBODY} with mode 600: if "
        rf"{owner} runs this arm, do this as {owner} too; otherwise ask {owner} or an administrator to remove it "
        rf"\(`sudo rm -r {path}`\), or give your arm another name\.$"
    )


@as_root
@pytest.mark.parametrize("kind", PLANTED)
def test_an_ordinary_user_is_told_whose_state_file_is_in_the_way(swept, ordinary, kind):
    path = files.state_path(swept)
    plant(kind, path)
    with ordinary():
        for attempt in (
            lambda: files.open_state(swept),
            lambda: files.left_behind(swept),
            lambda: files.create(identity(swept)),
        ):
            with pytest.raises(NotPermitted, match=sentence_about(path, kind)):
                attempt()
        assert swept not in files.running_arms() + files.arms_left_behind()
    assert left_of(swept) == [path]


@as_root
@pytest.mark.parametrize("kind", PLANTED)
def test_an_ordinary_user_is_told_whose_command_file_is_in_the_way(swept, ordinary, kind):
    path = files.command_path(swept)
    plant(kind, path)
    with ordinary():
        for attempt in (
            lambda: files.open_command(swept),
            lambda: files.own_command(swept, ARM_HASH),
            lambda: files.front_of(swept),
            lambda: files.create(identity(swept)),
        ):
            with pytest.raises(NotPermitted, match=sentence_about(path, kind)):
                attempt()
        assert files.watch_command(swept, 1) is None
    assert left_of(swept) == [path]


@as_root
@pytest.mark.parametrize("kind", PLANTED)
def test_an_ordinary_user_is_told_whose_file_keeps_the_state_of_a_dead_loop_from_being_kept(swept, ordinary, kind):
    path = files.previous_path(swept)
    with ordinary():
        dead = files.create(identity(swept))
        dead.state.close()
        dead.command.close()
    plant(kind, path)
    before = left_of(swept)
    with ordinary(), pytest.raises(NotPermitted, match=sentence_about(path, kind)):
        files.create(identity(swept))
    assert left_of(swept) == before
    files.state_path(swept).unlink()
    with ordinary():
        with pytest.raises(NotPermitted, match=sentence_about(path, kind)):
            files.left_behind(swept)
        assert swept not in files.arms_left_behind()


@as_root
@pytest.mark.parametrize("kind", PLANTED)
@pytest.mark.parametrize("name", ["state", "command"])
def test_an_ordinary_user_is_told_whose_file_stands_where_one_is_built(swept, ordinary, name, kind):
    path = files.DIRECTORY / f"rtarm.{swept}.{name}.{os.getpid()}.new"
    plant(kind, path)
    with ordinary(), pytest.raises(NotPermitted, match=sentence_about(path, kind)):
        files.create(identity(swept))
    assert left_of(swept) == [path]


@as_root
def test_a_file_that_a_stranger_holds_is_no_running_loop(swept, ordinary):
    """Open to everybody, locked and empty: there is no pid in it that could be told."""
    path = files.state_path(swept)
    plant("open file", path)
    with path.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with ordinary(), pytest.raises(NotPermitted, match=sentence_about(path, "open file")):
            files.create(identity(swept))


@as_root
def test_a_user_without_a_name_is_told_by_number(swept):
    path = files.state_path(swept)
    path.touch(0o600)
    os.chown(path, 4_000_000, 4_000_000)
    with pytest.raises(NotPermitted, match=r"is a file of uid 4000000 with mode 600.* ask uid 4000000 or an admin"):
        files.open_state(swept)


@as_root
def test_a_loop_that_starts_puts_its_own_files_in_the_place_of_planted_ones(swept):
    for path in (files.state_path(swept), files.command_path(swept)):
        path.touch(0o666)
        os.chown(path, NOBODY, NOBODY)
    pair = files.create(identity(swept))
    for path in (files.state_path(swept), files.command_path(swept)):
        assert path.stat().st_uid == os.geteuid() and stat.S_IMODE(path.stat().st_mode) == 0o600
    pair.remove()
