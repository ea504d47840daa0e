"""Making a recording of what stands in an arm's state file now."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from rtarm.console.errors import Refusal
from rtarm.recording import folder
from rtarm.recording.mcap_format import Reason, Step
from rtarm.recording.mcap_writer import write
from rtarm.running.status import key, resolve_arm
from sentences.told import latched_sentence
from shm import files
from shm.files import MemoryFile
from shm.recording import Recording, read_recording
from shm.words import Fault

ASKED, FAULT, DEATH = "asked", "fault", "death"
"""Why a recording is made."""
PATIENCE_S = 60.0
PATIENCE_S_PER_MIB = 3.0
"""Writing takes about 0.2 s a MiB of state file; at the lowest priority on a busy machine many times that."""


def patience_s(fd: int) -> float:
    """After what time the writing of a recording has failed, by the size of the state file."""
    return PATIENCE_S + PATIENCE_S_PER_MIB * os.fstat(fd).st_size / (1 << 20)


def left_by(argument: str | None) -> MemoryFile:
    """The state file of the arm meant, whether its control process lives or has died.

    Raises:
        Refusal: there is none, or there are several and none was named.
        SharedMemoryError: it cannot be used.
    """
    if argument is not None:
        return files.left_behind(resolve_arm(argument))
    arms = files.running_arms() or files.arms_left_behind()
    if not arms:
        raise Refusal(
            "No arm is running here and none has left a state file behind, so there is nothing to record: start one "
            "with `rtarm up ARM`, or see with `rtarm explain` what was last recorded."
        )
    if len(arms) > 1:
        raise Refusal(f"There are several arms ({', '.join(arms)}): name the one you mean.")
    return files.left_behind(arms[0])


def record_now(memory: MemoryFile, path: Path | None, step: Step = lambda _: None) -> Path:
    """Write a recording of a state file, which is closed then; the file that was written.

    Raises:
        Refusal: it cannot be written.
    """
    lives = files.is_held(memory.fd)
    return record(memory, ASKED if lives else DEATH, path, step)


def record(memory: MemoryFile, word: str, path: Path | None = None, step: Step = lambda _: None) -> Path:
    """The same, for a reason that is known; without a path among the recordings, of which old ones make room."""
    command = files.watch_command(files.arm_name(memory.record["header"]), int(memory.record["header"]["pid"]))
    try:
        recording = read_recording(memory, command)
    finally:
        memory.close()
        if command is not None:
            command.close()
    reason = Reason(word, _sentence(word, recording))
    if path is not None:
        write(recording, reason, path, step)
        return path
    path = folder.new_path(recording.arm, _name(word, recording))
    write(recording, reason, path, step)
    folder.remove_old(recording.arm)
    return path


def _sentence(word: str, recording: Recording) -> str:
    if word == FAULT and (latched := _latched(recording)) is not None:
        return latched_sentence(latched, recording.joints, buses=recording.bus_names)
    if word == DEATH:
        return f"The control process (pid {recording.pid}) ended without an orderly end."
    return "Asked for by a person."


def _name(word: str, recording: Recording) -> str:
    """What the file is named after: the fault, or else the reason."""
    latched = _latched(recording)
    return key(Fault, int(latched["fault"])) if word == FAULT and latched is not None else word


def _latched(recording: Recording) -> np.void | None:
    """The newest cycle in a latched fault: the arm may have gone on since."""
    faulted = np.flatnonzero(recording.records["fault"])
    return recording.records[faulted[-1]] if len(faulted) else None
