"""The front's mapping of an arm's two memory files."""

from collections.abc import Callable
from dataclasses import dataclass

from config.loader import arm_hash
from config.schema import ArmConfig
from shm.client import CommandWriter, StateReader
from shm.errors import NotRunning, WrongLayout
from shm.files import MemoryFile, is_held, open_command, open_state, own_command


@dataclass
class Link:
    """Both files of one control process, mapped; lives as long as that process."""

    arm: str
    reader: StateReader
    writer: CommandWriter

    @property
    def loop_pid(self) -> int:
        return int(self.reader.memory.record["header"]["pid"])

    def loop_has_run(self) -> bool:
        """Whether the control process has run a cycle; until then there is no snapshot to read."""
        return int(self.reader.memory.record["snapshot_sequence"][0]) > 0

    def loop_is_gone(self) -> bool:
        """Whether the control process these files belong to has ended, however it ended."""
        return not is_held(self.reader.memory.fd)

    def close(self) -> None:
        """Close both files; from then on another front may own the arm."""
        self.writer.close()
        self.reader.close()


def attach(arm: ArmConfig) -> Link:
    """Take ownership of the arm's command file, map its state file, and cancel all earlier goals.

    A starting control process puts its state file in place first. Until its command file follows, the file of
    that name may still be that of a dead control process; then NotRunning is raised.

    Raises shm.errors.NotRunning while there is no control process, AlreadyHeld when another front serves
    the arm, WrongLayout, WrongArm or NotPermitted when the files do not fit or may not be opened.
    """
    identity = arm_hash(arm)
    undo: list[Callable[[], None]] = []
    try:
        state = open_state(arm.name, identity)
        undo.append(state.close)
        _await_command_of(state, arm.name)
        command = own_command(arm.name, identity)
        undo.append(command.close)
        if not _of_one_loop(state, command):  # the command file was replaced after the check
            raise _just_starting(arm.name)
        link = Link(arm.name, StateReader(state), CommandWriter(command))
        link.writer.cancel_all()  # goals of a dead front, perhaps waiting for their start, have no owner
        return link
    except BaseException:
        for close in undo:
            close()
        raise


def _await_command_of(state: MemoryFile, arm: str) -> None:
    """Raise NotRunning unless the command file belongs to the control process that made this state file."""
    try:
        command = open_command(arm)
    except WrongLayout as problem:  # the state file's layout is right, so the command file is older
        raise _just_starting(arm) from problem
    try:
        if not _of_one_loop(state, command):
            raise _just_starting(arm)
    finally:
        command.close()


def _of_one_loop(state: MemoryFile, command: MemoryFile) -> bool:
    """Whether one control process made both: same pid, and (pids are reused) the command file is not the older one."""
    ours, other = state.record["header"], command.record["header"]
    return bool(other["pid"] == ours["pid"] and other["start_monotonic_ns"] >= ours["start_monotonic_ns"])


def _just_starting(arm: str) -> NotRunning:
    return NotRunning(
        f"The control process of arm '{arm}' is just starting (its command file is still the one of its "
        "predecessor): try again in a moment."
    )
