"""Creating, finding and locking the two memory files of an arm.

Liveness is an `flock` on the file, held by its owner: it falls with the process, even by kill -9, so there
is no stale pid to clean up. A file that somebody may have mapped is never truncated or rewritten: a new
control process builds its files aside and puts them in place by name; the state file of a dead one is kept
as `.state.prev`.
"""

import contextlib
import errno
import fcntl
import mmap
import os
import pwd
import shlex
import stat
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shm import layout
from shm.errors import AlreadyHeld, NotPermitted, NotRunning, RingFull, SharedMemoryError, WrongArm, WrongLayout
from shm.record import Record

DIRECTORY = Path("/dev/shm")
PRODUCERS_PATIENCE_S = 0.05
_KINDS = (
    (stat.S_ISREG, "file"),
    (stat.S_ISLNK, "link"),
    (stat.S_ISDIR, "directory"),
    (stat.S_ISFIFO, "pipe"),
    (stat.S_ISSOCK, "socket"),
)
_FLOCK = struct.Struct("hhqqi4x")
"""struct flock of 64-bit Linux: type, whence, start, length, pid."""


def state_path(arm: str) -> Path:
    return DIRECTORY / f"rtarm.{arm}.state"


def previous_path(arm: str) -> Path:
    """Where a new control process leaves the state file of one that ended without order."""
    return DIRECTORY / f"rtarm.{arm}.state.prev"


def command_path(arm: str) -> Path:
    return DIRECTORY / f"rtarm.{arm}.command"


class Bus(NamedTuple):
    """What people call a bus, and its bit rate (bit/s)."""

    name: str
    bitrate: int


@dataclass(frozen=True)
class Identity:
    """What the headers say about an arm and its configuration."""

    arm: str
    joints: tuple[str, ...]
    arm_hash: int
    period_ns: int
    buses: tuple[Bus, ...] = ()
    arm_file: str = ""
    """What a person starts it with: the name of an arm that comes with rtarm, or the absolute path of its file."""
    arm_file_hash: int = 0
    """Of what that file says."""
    options: bool = False
    """Whether options change what the file says."""


@dataclass
class MemoryFile:
    """An open, mapped memory file; `record` is its fixed part as one numpy record of its dtype."""

    path: Path
    fd: int
    map: mmap.mmap
    array: np.ndarray = field(repr=False)

    @cached_property
    def address(self) -> int:
        return int(self.array.ctypes.data)

    @property
    def rings(self) -> tuple[int, int]:
        """Address and size (bytes) of what follows the record: in a state file, the flight recorder's rings."""
        return self.address + self.array.nbytes, len(self.map) - self.array.nbytes

    @property
    def record(self) -> np.void:
        record: np.void = self.array[0]
        return record

    def close(self) -> None:
        """Release the lock and the mapping (the pages live on while views of them do)."""
        self.array = np.empty(0)
        with contextlib.suppress(BufferError):
            self.map.close()
        if self.fd >= 0:
            fcntl.flock(self.fd, fcntl.LOCK_UN)  # the mapping has a descriptor of its own that keeps the lock
            os.close(self.fd)
            self.fd = -1


@dataclass
class LoopFiles:
    """The control process' pair: `state` locked and writable, `command` mapped for reading."""

    state: MemoryFile
    command: MemoryFile

    keeps_previous: bool = False
    """Whether the state file of a control process that had died made room for this one."""

    def remove(self, *, as_before: bool = False) -> None:
        """Orderly end: the names go first, then the locks.

        With `as_before` a dead control process' state file gets its name back: what was never in service leaves
        behind what it found.
        """
        for memory in (self.command, self.state):
            with contextlib.suppress(FileNotFoundError):
                if os.stat(memory.path).st_ino == os.fstat(memory.fd).st_ino:
                    os.unlink(memory.path)
                    if as_before and self.keeps_previous and memory is self.state:
                        with contextlib.suppress(OSError):  # somebody has taken it away, or has begun meanwhile
                            _rename_to_free(memory.path.with_name(f"{memory.path.name}.prev"), memory.path)
            memory.close()


def name_bytes(names: Sequence[str], slots: int) -> np.ndarray:
    text = b"".join(name.encode().ljust(layout.NAME_BYTES, b"\0") for name in names)
    return np.frombuffer(text.ljust(slots * layout.NAME_BYTES, b"\0"), np.uint8)


def _path_bytes(path: str) -> np.ndarray:
    text = os.fsencode(path)
    return np.frombuffer((text if len(text) <= layout.PATH_BYTES else b"").ljust(layout.PATH_BYTES, b"\0"), np.uint8)


def arm_file(header: np.void) -> str:
    """What the arm of a header was started with: a name, or the path of its file; "" where that is not known."""
    return os.fsdecode(bytes(header["arm_file"]).rstrip(b"\0"))


WITH_OPTIONS = " (with the options it had)"
"""What a sentence says behind the command that starts an arm which had options."""


def start_command(arm: str, arm_file: str, options: bool) -> str:
    """The command that starts an arm, for a sentence: by its file, which may not be that of a known arm of its name."""
    return f"`rtarm up {shlex.quote(arm_file or arm)}`{WITH_OPTIONS if options else ''}"


def start_again(header: np.void) -> str:
    """The command that starts the arm of a header again, for a sentence."""
    return start_command(arm_name(header), arm_file(header), bool(header["options"]))


def again(header: np.void) -> dict[str, object]:
    """The same as values of an error: {again}{options}."""
    command = start_command(arm_name(header), arm_file(header), False)
    return {"again": command, "options": WITH_OPTIONS if header["options"] else ""}


def arm_name(header: np.void) -> str:
    """The arm's name from a header."""
    return bytes(header["arm_name"]).rstrip(b"\0").decode()


def joint_names(header: np.void) -> tuple[str, ...]:
    """The joints' names from a header, in configuration order."""
    slots = bytes(header["joint_names"])
    starts = range(0, int(header["joint_count"]) * layout.NAME_BYTES, layout.NAME_BYTES)
    return tuple(slots[at : at + layout.NAME_BYTES].rstrip(b"\0").decode() for at in starts)


def write_buses(header: np.void, buses: Sequence[Bus]) -> None:
    """Write into a header what buses the arm has."""
    header["bitrates"][: len(buses)] = [bus.bitrate for bus in buses]
    header["bus_names"] = name_bytes([bus.name for bus in buses], layout.MAX_BUSES)


def buses(header: np.void) -> tuple[Bus, ...]:
    """The arm's buses from a header, in configuration order; none where there is no bus."""
    slots = bytes(header["bus_names"])
    names = (
        slots[at : at + layout.NAME_BYTES].rstrip(b"\0").decode() for at in range(0, len(slots), layout.NAME_BYTES)
    )
    return tuple(
        Bus(name, bitrate) for name, bitrate in zip(names, header["bitrates"].tolist(), strict=True) if bitrate
    )


def several_names(buses: Sequence[Bus]) -> tuple[str, ...]:
    """The buses' names for sentences, which name none where there is only one."""
    return tuple(bus.name for bus in buses) if len(buses) > 1 else ()


def bus_names(header: np.void) -> tuple[str, ...]:
    """The same, of the buses of a header."""
    return several_names(buses(header))


def rings(header: np.void) -> layout.Rings:
    """The flight recorder's rings in a state file with this header."""
    joints, period_ns = int(header["joint_count"]), int(header["period_ns"])
    return layout.rings(joints, period_ns, *header["bitrates"].tolist())


def _map(path: Path, fd: int, record: type[Record], size: int, *, writable: bool) -> MemoryFile:
    protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
    mapped = mmap.mmap(fd, size, mmap.MAP_SHARED, protection)
    return MemoryFile(path, fd, mapped, np.frombuffer(mapped, record.dtype, count=1))


def _try_lock(fd: int, patience_s: float) -> bool:
    """Take the owner's lock; readers asking who is alive hold it for microseconds, hence the patience."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.002)
        else:
            return True


def is_held(fd: int) -> bool:
    """Whether some process owns the file behind `fd` (which must not be the owner's own descriptor)."""
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(fd, fcntl.LOCK_UN)
    return False


def _remove_abandoned(path: Path) -> None:
    """Remove files aside whose builder was killed before it could put them in place."""
    for aside in path.parent.glob(f"{path.name}.*.new"):
        with contextlib.suppress(OSError):
            fd = os.open(aside, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # held until it is gone, so that nobody takes it up
                os.unlink(aside)
            finally:
                os.close(fd)


def _create_locked(path: Path) -> int:
    """A new file of this name with its lock held.

    Between its creation and its lock another starting process may take it for abandoned and remove it.
    """
    while True:
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except FileExistsError as problem:
            raise _not_ours(path, problem) from problem
        if _try_lock(fd, 0.0) and os.fstat(fd).st_nlink > 0:
            return fd
        os.close(fd)
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)


def _build_aside(path: Path, record: type[Record], size: int, identity: Identity) -> MemoryFile:
    """A complete, locked file under a temporary name, every page allocated."""
    _remove_abandoned(path)
    aside = path.with_name(f"{path.name}.{os.getpid()}.new")
    fd = _create_locked(aside)
    try:
        os.posix_fallocate(fd, 0, size)
        memory = _map(aside, fd, record, size, writable=True)
    except OSError as problem:
        os.close(fd)
        os.unlink(aside)
        if problem.errno in (errno.ENOSPC, errno.EFBIG):
            raise NotPermitted(
                f"{DIRECTORY} has no room for the {size} bytes of {path.name} ({problem.strerror}): free some space "
                "there, or raise the limit (`ulimit -f`), then start again."
            ) from problem
        raise
    np.frombuffer(memory.map, np.uint8)[:: mmap.PAGESIZE] = 0  # touch every page now, not in the first cycle
    header = memory.record["header"]
    header["layout_hash"] = layout.layout_hash()
    header["arm_hash"] = identity.arm_hash
    header["pid"] = os.getpid()
    header["start_monotonic_ns"] = time.monotonic_ns()
    header["start_epoch_ns"] = time.time_ns()
    header["period_ns"] = identity.period_ns
    write_buses(header, identity.buses)
    header["arm_file_hash"] = identity.arm_file_hash
    header["options"] = identity.options
    header["arm_file"] = _path_bytes(identity.arm_file)
    header["joint_count"] = len(identity.joints)
    header["arm_name"] = name_bytes((identity.arm,), 1)
    header["joint_names"] = name_bytes(identity.joints, layout.MAX_JOINTS)
    header["magic"] = layout.MAGIC
    return memory


def _put_in_place(memory: MemoryFile, path: Path) -> bool:
    """Give a state file built aside its name, unless a living owner has it; whether it took the place of a dead one's.

    Raises AlreadyHeld.
    """
    kept = False
    while True:
        try:
            old = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except FileNotFoundError:
            old = -1
        except OSError as problem:
            raise _not_ours(path, problem) from problem
        try:
            if old >= 0:
                if not _try_lock(old, 0.2):
                    if not _is_private(status := os.fstat(old)):
                        raise _not_private(path, status)
                    raise _already_running(int(np.frombuffer(os.pread(old, 32, 0), "i8")[3]), path)
                with contextlib.suppress(FileNotFoundError):
                    if os.stat(path, follow_symlinks=False).st_ino == os.fstat(old).st_ino:
                        _rename(path, path.with_name(f"{path.name}.prev"))
                        kept = True
            try:
                os.link(memory.path, path)
            except FileExistsError:
                continue  # somebody was quicker: look again who it is
            os.unlink(memory.path)
            memory.path = path
            return kept
        finally:
            if old >= 0:
                os.close(old)


def _rename_to_free(path: Path, target: Path) -> None:
    """Give a file a name that nothing has; raises OSError."""
    os.link(path, target, follow_symlinks=False)
    os.unlink(path)


def _rename(path: Path, target: Path) -> None:
    """Give a file another name, in the place of what has it; raises NotPermitted."""
    try:
        os.replace(path, target)
    except FileNotFoundError:
        raise
    except OSError as problem:  # what may not be removed: the old name's file, or the one that has the new name
        raise _not_ours(target if _is_private(os.lstat(path)) else path, problem) from problem


def _user(uid: int) -> str:
    """What people call a user."""
    try:
        return f"user {pwd.getpwuid(uid).pw_name}"
    except KeyError:
        return f"uid {uid}"


def _is_private(status: os.stat_result) -> bool:
    """Whether this is what a memory file must be: a file of this user's own that no other user may open."""
    mode = status.st_mode
    return stat.S_ISREG(mode) and status.st_uid == os.geteuid() and not mode & (stat.S_IRWXG | stat.S_IRWXO)


def _not_private(path: Path, status: os.stat_result) -> NotPermitted:
    """The sentence on what stands in the place of a memory file. /dev/shm is sticky: only its owner may remove it."""
    kind = next((word for is_one, word in _KINDS if is_one(status.st_mode)), "device")
    owner, me = _user(status.st_uid), _user(os.geteuid())
    remedy = f"remove it (`rm -r {path}`)."
    if status.st_uid != os.geteuid():
        remedy = (
            f"if {owner} runs this arm, do this as {owner} too; otherwise ask {owner} or an administrator to remove it "
            f"(`sudo rm -r {path}`), or give your arm another name."
        )
    return NotPermitted(
        f"{path} is a {kind} of {owner} with mode {stat.S_IMODE(status.st_mode):o}, but must be a file of {me} with "
        f"mode 600: {remedy}"
    )


def _not_ours(path: Path, problem: OSError) -> NotPermitted:
    """The sentence on a path that the system would not open, or let go of."""
    with contextlib.suppress(OSError):
        status = os.lstat(path)
        if not _is_private(status):
            return _not_private(path, status)
    return NotPermitted(f"{path} cannot be used ({problem.strerror}): see what it is (`ls -l {path}`), or remove it.")


def create(identity: Identity) -> LoopFiles:
    """Build both files for a starting control process.

    Raises AlreadyHeld when another control process drives this arm.
    """
    rings = layout.rings(len(identity.joints), identity.period_ns, *(bus.bitrate for bus in identity.buses))
    state = _build_aside(state_path(identity.arm), layout.StateFile, rings.file_bytes, identity)
    command = None
    try:
        state.record["recorder"] = rings.described()
        path = command_path(identity.arm)
        command = _build_aside(path, layout.CommandFile, layout.CommandFile.dtype.itemsize, identity)
        kept = _put_in_place(state, state_path(identity.arm))
        _rename(command.path, path)  # the state file's lock already settled who owns the arm
        command.path = path
        fcntl.flock(command.fd, fcntl.LOCK_UN)  # held so far, or it would be removed as abandoned
    except BaseException:
        for memory in (state, command):
            if memory is not None:
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(memory.path)
                memory.close()
        raise
    return LoopFiles(state, command, keeps_previous=kept)


def _open(path: Path, record: type[Record], arm: str, arm_hash: int | None, *, writable: bool) -> MemoryFile:
    # O_NONBLOCK: opening a pipe that somebody put there would wait for its other end
    flags = (os.O_RDWR if writable else os.O_RDONLY) | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        fd = os.open(path, flags)
    except FileNotFoundError as problem:
        raise NotRunning(
            "No control process is running for arm '{arm}' ({path} is not there): start it with `rtarm up` and the "
            "name or the path of its arm file.",
            arm=arm,
            path=path,
        ) from problem
    except OSError as problem:
        raise _not_ours(path, problem) from problem
    return _attach(path, fd, record, arm, arm_hash, writable=writable)


def _attach(path: Path, fd: int, record: type[Record], arm: str, arm_hash: int | None, *, writable: bool) -> MemoryFile:
    """Map an open file, once it has been found to be what it should be; what is refused is closed."""
    try:
        status = os.fstat(fd)
        if not _is_private(status):
            raise _not_private(path, status)
        header = layout.Header.dtype
        found = np.frombuffer(os.pread(fd, header.itemsize, 0).ljust(header.itemsize), header)
        ours = layout.layout_hash()
        size = _size_said(found[0], record)
        if found["magic"][0] != layout.MAGIC or found["layout_hash"][0] != ours or status.st_size != size:
            raise WrongLayout(
                f"{path} has layout {int(found['layout_hash'][0]):016x}, this rtarm has {ours:016x}: the two "
                "processes come from different versions; stop both and start them from one installation."
            )
        _require_hash(arm, int(found["arm_hash"][0]), arm_hash)
        return _map(path, fd, record, size, writable=writable)
    except BaseException:
        os.close(fd)
        raise


def _require_hash(arm: str, found: int, wanted: int | None) -> None:
    if wanted is not None and found != wanted:
        raise WrongArm(
            f"The control process for '{arm}' runs configuration {found:016x}, this process has {wanted:016x}: start "
            "both from the same arm file."
        )


def _size_said(header: np.void, record: type[Record]) -> int:
    """How large a file with this header must be; -1 when the header cannot be right."""
    if not 0 < int(header["joint_count"]) <= layout.MAX_JOINTS or int(header["period_ns"]) <= 0:
        return -1
    if record is layout.StateFile:
        return rings(header).file_bytes
    return record.dtype.itemsize


def require_not_running(arm: str) -> None:
    """Raise AlreadyHeld where a control process drives an arm already; another may begin to in the next moment.

    What else is wrong with its memory files, the control process says that is started next.
    """
    try:
        state = open_state(arm)
    except SharedMemoryError:
        return
    pid = int(state.record["header"]["pid"])
    state.close()
    raise _already_running(pid, state.path)


def _already_running(pid: int, path: Path) -> AlreadyHeld:
    return AlreadyHeld(
        f"A control process for this arm is already running (pid {pid}, {path}): only one may drive an arm; stop that "
        "one first."
    )


def open_state(arm: str, arm_hash: int | None = None) -> MemoryFile:
    """Map the state file read-only; raises NotRunning when no control process holds it."""
    memory = _open(state_path(arm), layout.StateFile, arm, None, writable=False)
    if not is_held(memory.fd):  # before its configuration: whoever starts the arm again may have changed the file
        header = memory.record["header"]
        gone = NotRunning(
            "The control process of arm '{arm}' (pid {pid}) is gone without an orderly end: start it again with "
            "{again}{options}.",
            arm=arm,
            pid=int(header["pid"]),
            **again(header),
        )
        memory.close()
        raise gone
    try:
        _require_hash(arm, int(memory.record["header"]["arm_hash"]), arm_hash)
    except WrongArm:
        memory.close()
        raise
    return memory


def left_behind(arm: str) -> MemoryFile:
    """Map the newest state file of an arm read-only, whether or not its control process lives.

    Raises NotRunning when none was left behind, and whatever else `open_state` does.
    """
    path = state_path(arm)
    try:
        return _open(path, layout.StateFile, arm, None, writable=False)
    except NotRunning:
        return _open(previous_path(arm), layout.StateFile, arm, None, writable=False)


class Died(NamedTuple):
    """What a control process ran that has died: as `arm_file` tells it, its hash, and the command that starts it."""

    arm_file: str
    arm_file_hash: int
    start_again: str


def died_with(arm: str) -> Died | None:
    """What the arm's last control process ran, if it has died.

    One that ended in order, or was refused before it was in service, is none.
    """
    try:
        memory = _open(state_path(arm), layout.StateFile, arm, None, writable=False)
    except SharedMemoryError:
        return None
    try:
        header = memory.record["header"]
        if is_held(memory.fd):
            return None
        return Died(arm_file(header), int(header["arm_file_hash"]), start_again(header))
    finally:
        memory.close()


def inherited_state(fd: int, arm: str) -> MemoryFile:
    """Map, read-only, a state file that another process has opened; it may have no name any more."""
    return _attach(state_path(arm), fd, layout.StateFile, arm, None, writable=False)


def was_removed(fd: int) -> bool:
    """Whether the file of a control process that has ended lost its name before: its end was in order."""
    return os.fstat(fd).st_nlink == 0


def arms_left_behind() -> list[str]:
    """Names of this user's arms of whose control process there is a state file, whether or not it lives, sorted."""
    arms = set()
    for path in (*DIRECTORY.glob("rtarm.*.state"), *DIRECTORY.glob("rtarm.*.state.prev")):
        arm = path.name.removeprefix("rtarm.").removesuffix(".prev").removesuffix(".state")
        with contextlib.suppress(SharedMemoryError):
            left_behind(arm).close()
            arms.add(arm)
    return sorted(arms)


def open_command(arm: str, arm_hash: int | None = None) -> MemoryFile:
    """Map the command file for writing requests; take no ownership."""
    return _open(command_path(arm), layout.CommandFile, arm, arm_hash, writable=True)


def watch_command(arm: str, pid: int) -> MemoryFile | None:
    """Map the command file read-only; None where there is none of the control process with this pid."""
    try:
        memory = _open(command_path(arm), layout.CommandFile, arm, None, writable=False)
    except SharedMemoryError:
        return None
    if int(memory.record["header"]["pid"]) == pid:
        return memory
    memory.close()
    return None


def own_command(arm: str, arm_hash: int) -> MemoryFile:
    """Map the command file as the front; raises AlreadyHeld when another front owns it."""
    memory = open_command(arm, arm_hash)
    if not _try_lock(memory.fd, 0.2):
        memory.close()
        raise AlreadyHeld(
            f"Another front already serves arm '{arm}' ({memory.path}): only one may send goals; stop that one first."
        )
    memory.record["front_pid"][0] = os.getpid()
    return memory


def front_of(arm: str) -> tuple[int, int] | None:
    """Pid and last sign of life (CLOCK_MONOTONIC, ns) of the living front of an arm; None when there is none."""
    try:
        memory = _open(command_path(arm), layout.CommandFile, arm, None, writable=False)
    except NotRunning:
        return None
    try:
        if not is_held(memory.fd):
            return None
        return int(memory.record["front_pid"][0]), int(memory.record["heartbeat_ns"][0])
    finally:
        memory.close()


def running_arms() -> list[str]:
    """Names of this user's arms whose control process lives, sorted."""
    arms = []
    for path in DIRECTORY.glob("rtarm.*.state"):
        arm = path.name.removeprefix("rtarm.").removesuffix(".state")
        with contextlib.suppress(SharedMemoryError):
            open_state(arm).close()
            arms.append(arm)
    return sorted(arms)


@contextlib.contextmanager
def producers_lock(fd: int) -> Iterator[None]:
    """The lock that processes producing requests take among themselves; the loop never does.

    An open-file-description lock, independent of the owner's flock; it falls with its holder, and with no other
    descriptor of the same file. Raises RingFull where a holder keeps it: it was suspended, and nobody waits for that.
    """
    deadline_s = time.monotonic() + PRODUCERS_PATIENCE_S
    while True:
        try:
            fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 1, 0))
            break
        except (BlockingIOError, PermissionError):
            if time.monotonic() > deadline_s:
                raise RingFull(
                    "Another process that asks something of this arm stands still in the middle of it: end that one."
                ) from None
        time.sleep(0.0005)
    try:
        yield
    finally:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_UNLCK, os.SEEK_SET, 0, 1, 0))
