"""`rtarm stop` and `rtarm clear-fault`: requests that reach the control process without any ROS process."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from rtarm.errors import Refusal
from rtarm.status import MOVING_MODES
from shm import files
from shm.client import CommandWriter, StateReader, find
from shm.errors import NotRunning
from shm.sentences import answer_sentence, fault_sentence, joint_name, unreferenced_sentence
from shm.words import Answer, Fault, Mode, Request

ANSWER_PATIENCE_S = 2.0
STOP_PATIENCE_S = 10.0
BRING_UP_PATIENCE_S = 30.0
POLL_S = 0.005

Condition = Callable[[np.ndarray], bool]


class Connection:
    """Both memory files of a running arm, for as long as a request takes."""

    def __init__(self, arm: str, reader: StateReader, writer: CommandWriter) -> None:
        self.arm = arm
        self.joints = files.joint_names(reader.memory.record["header"])
        self._reader = reader
        self._writer = writer

    def snapshot(self) -> np.ndarray:
        """The newest snapshot."""
        return self._reader.snapshot()

    def ask(self, kind: Request) -> Answer:
        """Make a request and wait for its answer."""
        sequence = self._writer.request(kind)
        snapshot = self.wait(
            lambda now: find(now["answers"], "sequence", sequence) is not None,
            ANSWER_PATIENCE_S,
            f"The control process of {self.arm} has not answered for {ANSWER_PATIENCE_S:g} s, so it hangs: "
            "end it, then start it again; the drives brake by themselves when it is gone.",
        )
        answer = find(snapshot["answers"], "sequence", sequence)
        assert answer is not None
        return Answer(int(answer["answer"]))

    def wait(self, condition: Condition, patience_s: float, too_long: str) -> np.ndarray:
        """The first snapshot that fulfils a condition.

        Raises:
            Refusal: it takes longer than `patience_s` (with the sentence `too_long`).
            NotRunning: the control process ended meanwhile.
        """
        deadline = time.monotonic() + patience_s
        while not condition(snapshot := self.snapshot()):
            if not files.is_held(self._reader.memory.fd):
                raise NotRunning(
                    f"The control process of arm '{self.arm}' ended meanwhile; the drives have braked by "
                    f"themselves: start it again with `rtarm up {self.arm}`."
                )
            if time.monotonic() > deadline:
                raise Refusal(too_long)
            time.sleep(POLL_S)
        return snapshot


@contextmanager
def connect(arm: str) -> Iterator[Connection]:
    """Open the memory files of a running arm.

    Raises:
        SharedMemoryError: it is not running, or its files are not what they should be.
    """
    reader = StateReader(files.open_state(arm))
    try:
        writer = CommandWriter(files.open_command(arm))
        try:
            yield Connection(arm, reader, writer)
        finally:
            writer.close()
    finally:
        reader.close()


def stop(arm: str) -> str:
    """Stop the arm on its path, wait until it stands, and say so."""
    with connect(arm) as connection:
        answer = connection.ask(Request.STOP)
        if answer not in (Answer.DONE, Answer.REFUSED_NO_GOAL):
            raise Refusal(answer_sentence(answer))
        connection.wait(
            stands,
            STOP_PATIENCE_S,
            f"Arm {arm} still moves {STOP_PATIENCE_S:g} s after the stop was accepted: use the emergency "
            "stop, then look at `rtarm status`.",
        )
    if answer == Answer.REFUSED_NO_GOAL:
        return f"Arm {arm} stands; no goal was running."
    return f"Arm {arm} stopped on its path and stands; its goal has ended."


def stands(snapshot: np.ndarray) -> bool:
    """Whether no motion is commanded and none going on."""
    return (
        int(snapshot["mode"]) not in MOVING_MODES
        and not np.any(snapshot["joints"]["commanded_velocity_rad_s"])
        and int(snapshot["goal_id"]) == 0
    )


def clear_fault(arm: str) -> str:
    """Clear the latched fault, wait until the drives are brought up again, and say how it went."""
    with connect(arm) as connection:
        before = connection.snapshot()
        if int(before["fault"]) == Fault.NONE:
            return f"Arm {arm} has no latched fault, so there is nothing to clear."
        answer = connection.ask(Request.CLEAR_FAULT)
        if answer != Answer.DONE:
            raise Refusal(answer_sentence(answer))
        latched_ns = int(before["fault_ns"])

        def decided(now: np.ndarray) -> bool:
            again = int(now["fault"]) != Fault.NONE and int(now["fault_ns"]) != latched_ns
            return again or int(now["mode"]) in (Mode.HOLDING, Mode.EXECUTING)

        after = connection.wait(
            decided,
            BRING_UP_PATIENCE_S,
            f"The drives of {arm} are not brought up {BRING_UP_PATIENCE_S:g} s after the fault was cleared: "
            "look at the lines of the control process and at `rtarm status`.",
        )
        if int(after["fault"]) != Fault.NONE:
            joint = joint_name(int(after["fault_joint"]), connection.joints)
            sentence = fault_sentence(
                int(after["fault"]), joint, float(after["fault_value"]), float(after["fault_limit"])
            )
            raise Refusal(f"The fault was cleared and came back. {sentence}")
        lost = [
            unreferenced_sentence(int(after["joints"][index]["unreferenced_reason"]), name)
            for index, name in enumerate(connection.joints)
            if not after["joints"][index]["referenced"]
        ]
    return " ".join([f"The fault is cleared; arm {arm} holds where it stands.", *lost])
