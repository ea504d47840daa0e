"""What people ask of a running arm: requests that reach the control process without any ROS process."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np

from config.errors import did_you_mean
from config.stopping import Patience
from rtarm.console.errors import Refusal
from rtarm.console.interrupt import signals_to
from rtarm.console.language import said
from rtarm.running.status import MOVING_MODES, STOPPED_BY_A_PERSON, open_running
from sentences.meaning import Language
from sentences.told import answer_sentence, latched_sentence, reasons_unreferenced, unreferenced_sentences
from shm import files
from shm.client import CommandWriter, StateReader
from shm.errors import EndedMeanwhile, NotRunning, TornRead
from shm.snapshot import Snapshot
from shm.words import Answer, DriveStatus, Fault, Mode, Phase, Request

ANSWER_PATIENCE_S = 2.0
RELEASE_PATIENCE_S = 5.0
HOMING_PATIENCE_S = 3700.0
"""Beyond the longest that an arm file may allow a joint."""
BEGUN_PATIENCE_S = 0.1
POLL_S = 0.005
HEARD_CYCLES = 100
"""Within so many, every request of a full ring is answered."""

_DIED = (
    "The control process of arm '{arm}' has died; the drives stop by themselves, but a homing run goes on: look at the "
    "arm, then start it again with {again}{options}."
)
_ENDED = (
    "The control process of arm '{arm}' has ended in order, so the arm stands: start it again with {again}{options}."
)

TOO_EARLY_TO_CLEAR = {
    Answer.REFUSED_MOVING: "The arm is still braking after the fault, which takes {seconds:.1f} s at most: wait until "
    "it stands, then `rtarm clear-fault` again.",
    Answer.REFUSED_MODE: "The fault is being cleared already: wait until `rtarm status` says holding, or fault again.",
}

Condition = Callable[[Snapshot], bool]


class Connection:
    """Both memory files of a running arm, for as long as a request takes, and the language of what is said of it."""

    def __init__(self, arm: str, reader: StateReader, writer: CommandWriter, language: Language = "en") -> None:
        self.arm = arm
        self.language = language
        self.joints = files.joint_names(reader.memory.record["header"])
        self.buses = files.bus_names(reader.memory.record["header"])
        self._reader = reader
        self._writer = writer

    def snapshot(self) -> Snapshot:
        """The newest snapshot.

        Raises:
            NotRunning: the control process ended amid writing one.
            TornRead: it has hung amid writing one.
        """
        deadline = time.monotonic() + ANSWER_PATIENCE_S
        while True:
            try:
                return self._reader.snapshot()
            except TornRead:
                self.check_running()
                if time.monotonic() > deadline:
                    raise
                time.sleep(POLL_S)

    @property
    def writer(self) -> CommandWriter:
        """For what needs no answer: stop, hold, resume, the speed scale."""
        return self._writer

    def ask(self, kind: Request, *, joint_mask: int = 0, value: float = 0.0) -> Answer:
        """Make a request and wait for its answer.

        Raises:
            RingFull: too many requests wait already.
        """
        taken = self._reader.requests_consumed()
        epoch = self.snapshot()["epoch"]
        sequence = self._writer.request(kind, consumed=taken, epoch=epoch, joint_mask=joint_mask, value=value)
        snapshot = self.wait_heard(lambda now: now.find("answers", "sequence", sequence) is not None)
        answer = snapshot.find("answers", "sequence", sequence)
        assert answer is not None
        return Answer(int(answer["answer"]))

    def wait_heard(self, condition: Condition) -> Snapshot:
        """The first snapshot that shows that the control process has heard of something.

        Raises:
            Refusal: it runs no cycle, or does so without that: somebody else has asked for something else.
        """
        asked = self.snapshot()["cycle"]
        now = self.wait(
            lambda now: condition(now) or now["cycle"] > asked + HEARD_CYCLES,
            ANSWER_PATIENCE_S,
            said(
                self.language,
                "The control process of {arm} has not answered for {seconds:g} s, so it hangs: end it, then start it "
                "again; the drives stop by themselves when it is gone, but a homing run goes on.",
                arm=self.arm,
                seconds=ANSWER_PATIENCE_S,
            ),
        )
        if not condition(now):
            else_asked = "Somebody has asked something else of arm {arm} meanwhile: see `rtarm status`."
            raise Refusal(said(self.language, else_asked, arm=self.arm))
        return now

    def order(self, kind: Request, *, joint_mask: int = 0, value: float = 0.0) -> None:
        """Make a request; raises Refusal with the sentence where it is refused."""
        answer = self.ask(kind, joint_mask=joint_mask, value=value)
        if answer != Answer.DONE:
            raise Refusal(self._why_refused(kind, answer))

    def _why_refused(self, kind: Request, answer: Answer) -> str:
        if kind == Request.CLEAR_FAULT and answer in TOO_EARLY_TO_CLEAR:
            return said(self.language, TOO_EARLY_TO_CLEAR[answer], seconds=self.patience.longest_stop_s)
        return answer_sentence(answer, self.language)

    @property
    def patience(self) -> Patience:
        """How long to wait for the arm to stop."""
        return Patience(float(self._reader.memory.record["limits"]["longest_stop_s"]))

    def index(self, joint: str) -> int:
        """Number of a joint; raises Refusal where the arm has none of that name."""
        if joint not in self.joints:
            raise Refusal(
                f"Arm {self.arm} has no joint {joint!r}{did_you_mean(joint, self.joints)}; its joints are "
                f"{', '.join(self.joints)}.",
                joint=joint,
            )
        return self.joints.index(joint)

    def homes(self, joint: str) -> bool:
        """Whether the joint's drive finds a stop when it is homed; any other passes at once."""
        return bool(self._reader.memory.record["limits"]["joints"]["homes"][self.index(joint)])

    @property
    def period_s(self) -> float:
        """Of the control cycle."""
        return int(self._reader.memory.record["header"]["period_ns"]) * 1e-9

    def limits(self) -> np.ndarray:
        """What the control process allows (layout.Limits), no dimensions."""
        return np.array(self._reader.memory.record["limits"])

    def arm_hash(self) -> int:
        """Of the configuration that the control process runs with."""
        return int(self._reader.memory.record["header"]["arm_hash"])

    def limits_deg(self, index: int) -> tuple[float, float]:
        """Lowest and highest angle of a joint (degrees)."""
        row = self._reader.memory.record["limits"]["joints"][index]
        return math.degrees(row["lower_rad"]), math.degrees(row["upper_rad"])

    def fault(self, snapshot: Snapshot) -> str:
        """The latched fault in a sentence, "" where there is none."""
        if snapshot["fault"] == Fault.NONE:
            return ""
        return latched_sentence(snapshot, self.joints, self.language, self.buses)

    def lost(self, snapshot: Snapshot) -> dict[str, int]:
        """The joints that have no reference, and why (shm.words.Unreferenced)."""
        return reasons_unreferenced(snapshot, self.joints)

    def why_lost(self, snapshot: Snapshot) -> list[str]:
        """The same in sentences, one for each reason."""
        return unreferenced_sentences(self.lost(snapshot), self.language)

    def wait(self, condition: Condition, patience_s: float, too_long: str) -> Snapshot:
        """The first snapshot that fulfils a condition.

        Raises:
            Refusal: it takes longer than `patience_s` (with the sentence `too_long`).
            NotRunning: the control process ended meanwhile.
        """
        deadline = time.monotonic() + patience_s
        while not condition(snapshot := self.snapshot()):
            self.check_running()
            if time.monotonic() > deadline:
                raise Refusal(too_long)
            time.sleep(POLL_S)
        return snapshot

    def check_running(self) -> None:
        """Raise EndedMeanwhile where the control process has died, NotRunning where it has ended in order."""
        memory = self._reader.memory
        if files.is_held(memory.fd):
            return
        words = {"arm": self.arm, **files.again(memory.record["header"])}
        if files.was_removed(memory.fd):
            raise NotRunning(_ENDED, **words)
        raise EndedMeanwhile(_DIED, **words)


@contextmanager
def connect(arm: str, language: Language = "en") -> Iterator[Connection]:
    """Open the memory files of a running arm; what is said of it is in a language.

    Raises:
        SharedMemoryError: it is not running, or its files are not what they should be.
    """
    reader = StateReader(open_running(arm))
    try:
        writer = CommandWriter(files.open_command(arm))
        try:
            yield Connection(arm, reader, writer, language)
        finally:
            writer.close()
    finally:
        reader.close()


def stop(arm: str, language: Language = "en") -> str:
    """Stop the arm on its path, wait until it stands, and say so; it takes no goals before a resume."""
    with connect(arm, language) as connection:
        before = connection.snapshot()
        had_goal = before["goal_id"] != 0 or before["goal_phase"] == Phase.WAITING
        connection.writer.stop()
        connection.wait_heard(lambda now: now["stops"] > before["stops"])
        after = connection.wait(
            stands,
            connection.patience.person_s,
            said(
                language,
                "Arm {arm} still moves {seconds:.1f} s after the stop was accepted: use the emergency stop, then look "
                "at `rtarm status`.",
                arm=arm,
                seconds=connection.patience.person_s,
            ),
        )
        if after["fault"] == Fault.HOMING:
            raise Refusal(connection.fault(after))
    if had_goal:
        return said(
            language,
            "Arm {arm} stopped on its path and stands; its goal has ended. It takes no goals before `rtarm resume`.",
            arm=arm,
        )
    return said(language, "Arm {arm} stands; no goal was running. It takes no goals before `rtarm resume`.", arm=arm)


def stop_again(arm: str) -> None:
    """Ask for a stop while somebody waits for an earlier one, who tells how that ends.

    Raises:
        SharedMemoryError: the arm is not running.
    """
    with connect(arm) as connection:
        connection.writer.stop()


def hold_again(arm: str) -> None:
    """The same of a hold.

    Raises:
        SharedMemoryError: the arm is not running.
    """
    with connect(arm) as connection:
        connection.writer.hold()


def stands(snapshot: Snapshot) -> bool:
    """Whether no motion is commanded and none going on."""
    return (
        snapshot["mode"] not in (*MOVING_MODES, Mode.REFERENCING)
        and not np.any(snapshot["joints"]["commanded_velocity_rad_s"])
        and snapshot["goal_id"] == 0
    )


def clear_fault(arm: str, language: Language = "en") -> str:
    """Clear the latched fault, wait until the drives are brought up again, and say how it went."""
    with connect(arm, language) as connection:
        after = cleared(connection)
        if after is None:
            return said(language, "Arm {arm} has no latched fault, so there is nothing to clear.", arm=arm)
        why_lost = connection.why_lost(after)
    done = said(language, "The fault is cleared; arm {arm} holds where it stands.", arm=arm)
    return " ".join([done, *_held_words(after, language), *why_lost])


def cleared(connection: Connection) -> Snapshot | None:
    """Clear the latched fault and wait until the drives are brought up again: the snapshot then, None without a fault.

    Raises:
        Refusal: it is not cleared, or came back.
    """
    arm, before = connection.arm, connection.snapshot()
    if before["fault"] == Fault.NONE:
        return None
    connection.order(Request.CLEAR_FAULT)
    latched_ns = before["fault_ns"]

    def decided(now: Snapshot) -> bool:
        again = now["fault"] != Fault.NONE and now["fault_ns"] != latched_ns
        return again or now["mode"] in (Mode.HOLDING, Mode.EXECUTING)

    after = connection.wait(
        decided,
        connection.patience.bring_up_s,
        said(
            connection.language,
            "The drives of {arm} are not brought up {seconds:.1f} s after the fault was cleared: look at the lines of "
            "the control process and at `rtarm status`.",
            arm=arm,
            seconds=connection.patience.bring_up_s,
        ),
    )
    if sentence := connection.fault(after):
        raise Refusal(said(connection.language, "The fault was cleared and came back. {fault}", fault=sentence))
    return after


def home(arm: str, joints: Sequence[str], tell: Callable[[str], None]) -> str:
    """Let joints find their homing stops, all of the arm file's order where none is named, and say how it went.

    Ctrl-C ends the run, and so does the end of the terminal: the drive under way stops.
    """
    with connect(arm) as connection, signals_to(_interrupt):
        mask = sum(1 << connection.index(joint) for joint in dict.fromkeys(joints))
        before = connection.snapshot()
        if sentence := connection.fault(before):
            raise Refusal(f"A fault is latched, clear it first: {sentence}")
        if unable := [joint for joint in joints if joint in connection.lost(before) and not connection.homes(joint)]:
            raise Refusal(
                f"The drive of {unable[0]} has no homing run: say where the joint stands with `rtarm reference "
                f"{unable[0]}=DEGREES`."
            )
        begun: list[str] = []

        def on_joint(joint: str) -> None:
            if connection.homes(joint):
                begun.append(joint)
                tell(f"{joint}: on its way to its stop; Ctrl-C ends it.")

        try:
            connection.order(Request.HOME, joint_mask=mask)
            after = see_to_the_end(connection, on_joint)
        except KeyboardInterrupt:
            if _homes_soon(connection):
                connection.ask(Request.HOME_STOP)
            still_homes = f"Arm {arm} still homes: use the switch in the power line."
            after = connection.wait(_is_over, connection.patience.person_s, still_homes)
            ended = "Ended: the joint that was on its way stands, without a reference."
            raise Refusal(connection.fault(after) or ended) from None
        lost, why_lost = connection.lost(after), connection.why_lost(after)
        if sentence := connection.fault(after):
            raise Refusal(sentence)
        if not_homed := [
            joint for joint in joints or begun if joint in lost or (joint not in begun and connection.homes(joint))
        ]:
            ended = f"The homing run was ended before it had come to the end with {', '.join(not_homed)}."
            raise Refusal(" ".join([ended, *why_lost]))
        stands = ", ".join(stands_at(after, connection.index(joint), joint) for joint in begun)
        runs = any(map(connection.homes, joints or connection.joints))
    if not runs:
        return " ".join([f"Arm {arm} holds where it stands; no drive of these joints finds a stop.", *why_lost])
    return " ".join([f"Homed; arm {arm} holds where it stands: {stands or 'nothing was homed'}.", *why_lost])


def _interrupt(*_: object) -> None:
    """Any stop signal ends what runs as Ctrl-C does."""
    raise KeyboardInterrupt


def _homes_soon(connection: Connection) -> bool:
    """Whether joints are being homed, or are as soon as the control process has heard of it."""
    with suppress(Refusal):
        connection.wait(lambda now: now["mode"] == Mode.REFERENCING, BEGUN_PATIENCE_S, "")
        return True
    return False


def _is_over(snapshot: Snapshot) -> bool:
    return bool(snapshot["mode"] != Mode.REFERENCING)


def see_to_the_end(connection: Connection, on_joint: Callable[[str], None]) -> Snapshot:
    """Wait until joints are referenced, telling of each as its turn comes; the last snapshot."""
    joint = -1

    def news(now: Snapshot) -> bool:
        return _is_over(now) or now["referencing_joint"] not in (joint, -1)

    while True:
        now = connection.wait(
            news,
            HOMING_PATIENCE_S,
            said(connection.language, "A joint has been on its way to its stop for an hour: end it with `rtarm stop`."),
        )
        if _is_over(now):
            return now
        joint = now["referencing_joint"]
        on_joint(connection.joints[joint])


def stands_at(snapshot: Snapshot, index: int, joint: str) -> str:
    """A joint and where it is measured to stand."""
    return f"{joint} {math.degrees(snapshot['joints'][index]['measured_position_rad']):.2f}°"


def enable(arm: str, language: Language = "en") -> str:
    """Enable limp drives, wait until the arm holds, and say so."""
    with connect(arm, language) as connection:
        after = enabled(connection)
        why_lost = connection.why_lost(after)
    done = said(language, "The drives of {arm} are enabled; the arm holds where it stands.", arm=arm)
    return " ".join([done, *_held_words(after, language), *why_lost])


def enabled(connection: Connection) -> Snapshot:
    """Enable limp drives and wait until the arm holds: the snapshot then; raises Refusal where it does not."""
    arm, language = connection.arm, connection.language
    if sentence := connection.fault(connection.snapshot()):
        latched = "A fault is latched; `rtarm clear-fault` clears it and enables the drives. {fault}"
        raise Refusal(said(language, latched, fault=sentence))
    connection.order(Request.ENABLE)
    after = connection.wait(
        lambda now: now["mode"] in (Mode.HOLDING, Mode.EXECUTING, Mode.FAULT),
        connection.patience.bring_up_s,
        said(
            language,
            "The drives of {arm} are not enabled after {seconds:.1f} s: see `rtarm status`.",
            arm=arm,
            seconds=connection.patience.bring_up_s,
        ),
    )
    if sentence := connection.fault(after):
        raise Refusal(sentence)
    return after


def _held_words(snapshot: Snapshot, language: Language) -> list[str]:
    """What else keeps the arm from taking goals: that a person has stopped it."""
    return [said(language, STOPPED_BY_A_PERSON)] if snapshot["held"] else []


def let_go(arm: str, kind: Request) -> str:
    """Let the drives of a standing arm go limp (DISABLE, or FREE to lead it by hand), and say so."""
    with connect(arm) as connection:
        limp(connection, kind)
    if kind == Request.FREE:
        return f"The drives of {arm} are limp: lead it by hand; `rtarm enable` takes hold of it where it stands."
    return f"The drives of {arm} are limp and it is out of service until `rtarm enable`."


def limp(connection: Connection, kind: Request) -> None:
    """The same, until the drives are limp; raises Refusal where they are not."""
    mode = Mode.DISABLED if kind == Request.DISABLE else Mode.FREE
    connection.order(kind)
    after = connection.wait(
        lambda now: now["mode"] == Mode.FAULT or (now["mode"] == mode and _is_disabled(now)),
        RELEASE_PATIENCE_S,
        f"The drives of {connection.arm} are not limp after {RELEASE_PATIENCE_S:g} s: keep clear and see `rtarm "
        "status`.",
    )
    if sentence := connection.fault(after):
        raise Refusal(sentence)


def _is_disabled(snapshot: Snapshot) -> bool:
    return not np.any(snapshot["joints"]["drive_status"] & DriveStatus.ENABLED)


def hold(arm: str, language: Language = "en") -> str:
    """Stop on the path, wait until the arm stands, and say so; the goal is kept, and none begins before a resume."""
    with connect(arm, language) as connection:
        connection.writer.hold()
        connection.wait_heard(lambda now: bool(now["held"]))
        after = connection.wait(
            lambda now: not now["held"] or (_is_over(now) and not np.any(now["joints"]["commanded_velocity_rad_s"])),
            connection.patience.person_s,
            said(
                language,
                "Arm {arm} still moves {seconds:.1f} s after the hold was accepted: use the emergency stop, then look "
                "at `rtarm status`.",
                arm=arm,
                seconds=connection.patience.person_s,
            ),
        )
        if after["fault"] == Fault.HOMING:
            raise Refusal(connection.fault(after))
    if not after["held"]:
        raise Refusal(said(language, "Arm {arm} was resumed before it stood.", arm=arm))
    if after["goal_phase"] != Phase.PAUSED:
        return said(language, "Arm {arm} stands and takes no goals before `rtarm resume`.", arm=arm)
    on_its_path = "Arm {arm} stands on its path; its goal goes on with `rtarm resume` or ends with `rtarm stop`."
    return said(language, on_its_path, arm=arm)


def resume(arm: str, language: Language = "en") -> str:
    """Let a paused goal go on, and a held or stopped arm take goals again; say so."""
    with connect(arm, language) as connection:
        before = connection.snapshot()
        connection.writer.resume()
        after = connection.wait_heard(lambda now: not now["held"])
    if not before["held"]:
        return said(language, "Arm {arm} is not held: goals and streams may begin.", arm=arm)
    goes_on = before["goal_phase"] == Phase.PAUSED and after["goal_id"] == before["goal_id"]
    if goes_on:
        return said(language, "The goal of {arm} goes on.", arm=arm)
    return said(language, "Arm {arm} takes goals again.", arm=arm)


def speed(arm: str, scale: float, language: Language = "en") -> str:
    """Set the speed scale, 0 (stands still) to 1, at which every goal runs on its path; say so."""
    if not 0.0 <= scale <= 1.0:
        outside = "The speed scale is {scale:g}, but goals run at 0 to 1 of their own speed: choose one of these."
        raise Refusal(said(language, outside, scale=scale))
    with connect(arm, language) as connection:
        connection.writer.scale(scale)
        connection.wait_heard(lambda now: now["speed_scale_asked"] == scale)
    return said(language, "Goals of {arm} run at {scale:.0%} of their speed.", arm=arm, scale=scale)
