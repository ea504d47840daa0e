"""The control process around the cycle: memory files, wire, threads, bring-up, orderly shutdown."""

import math
import signal
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress

import numpy as np

from config.budget import check_budget
from config.loader import arm_hash
from config.processors import leave_to_cycle
from config.schema import ArmConfig
from rtloop.dialogues.bringup import BringUp
from rtloop.dialogues.gripper import GripperDialogue
from rtloop.dialogues.healing import Healing
from rtloop.dialogues.referencing import Referencing, referencing_asked_for
from rtloop.dialogues.release import Release
from rtloop.dialogues.shutdown import ShutdownDialogue
from rtloop.drives.setup import ERROR_AT_START
from rtloop.kept import commissioned, reference_store
from rtloop.memory.state import Loop
from rtloop.process.attended_wire import AttendedWire
from rtloop.process.compiled import CompiledCycle
from rtloop.process.initial_state import buses_of, new_loop, show_drives, show_limits
from rtloop.service.conversation import Conversation, DialogueFailed
from rtloop.service.port import HOME_ALL, ServicePort
from rtloop.system import realtime
from rtloop.wire.claim import Claim, claim_for_arm
from sentences.english import HEALED
from sentences.told import fault_told
from shm import files
from shm.record import offset_of
from shm.words import Mode, Phase, Unreferenced

BUSY_POLL_S = 0.004
IDLE_POLL_S = 0.05
FIRST_CYCLE_POLL_S = 0.001
KEEP_AGAIN_S = 1.0
THREAD_PATIENCE_S = 5.0
STAND_PATIENCE_S = 5.0
"""Extra time at shutdown for a drive amid its homing run to report that it has ended it."""


class CannotStart(Exception):
    """The control process refuses to start; the text is the message for the operator."""


class Ended(Exception):
    """Work beside an offline cycle cannot go on: a signal asked for shutdown, or the cycle has ended.

    `code` is the exit code.
    """

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class StopAsked:
    """Whether one of the signals has asked for shutdown; handles these signals from its creation on."""

    def __init__(self, signals: Iterable[signal.Signals]) -> None:
        self.yes = False  # not an Event, on whose lock a second signal would wait for the first
        for number in signals:
            signal.signal(number, self._take)

    def _take(self, *_: object) -> None:
        self.yes = True


class ControlProcess:
    """One arm's control process, from opening the wire to closing it.

    `tell` gets every message for the operator. Raises CannotStart, WireRefused, SharedMemoryError or ConfigError
    before anything has moved.
    """

    def __init__(
        self, arm: ArmConfig, compiled: CompiledCycle, tell: Callable[[str], None], stop_asked: StopAsked
    ) -> None:
        check_budget(arm)
        self._arm = arm
        self._compiled = compiled
        self._tell = tell
        self._stop_asked = stop_asked
        identity = files.Identity(
            arm.name,
            tuple(joint.name for joint in arm.joints),
            arm_hash(arm),
            arm.control.period_ns,
            buses_of(arm),
            arm_file=arm.file_argument,
            arm_file_hash=arm.source.file_hash if arm.source else 0,
            options=arm.has_options,
        )
        self._files = files.create(identity)
        self._wires: list[AttendedWire] = []
        self._claim = Claim()
        self._lost_references: dict[int, Unreferenced] = {}
        self._marks = commissioned.marks(arm, tell)
        self._held_rad: dict[int, float] = {}
        self._brought_up = False
        self._next_keep_s = 0.0
        self._told_of_lost = ""
        try:
            self._claim = claim_for_arm(arm)
            self._loop = new_loop(arm, self._files.state.address, self._files.command.address)
            leave_to_cycle(arm.realtime.cpu)  # before the wires, which may have threads
            for number, part in enumerate(arm.parts):
                name = arm.bus_names[number] if arm.bus_names else ""
                wire = AttendedWire(part, number, name, self._loop, compiled, start=self._start_reader, tell=tell)
                self._wires.append(wire)
                wire.open()
            self._port = ServicePort(self._loop, compiled)
            self._gripper: GripperDialogue | None = None
            show_limits(self._files.state.record["limits"], self._loop)
            show_drives(self._files.state.record, arm)
            arrays = (self._loop, self._files.state.array, self._files.command.array)
            used = [(array.ctypes.data, array.nbytes) for array in arrays]
            self._obtained = realtime.prepare_process([*used, *compiled.memory])
            self._cycle = threading.Thread(target=self._run_cycle, name="cycle", daemon=True)
            self._prepared = threading.Event()
        except BaseException:
            self._release()
            raise

    def serve(self, ready: Callable[[], None], *, clears_protection: bool = False) -> int:
        """Run until a signal asks for shutdown.

        `ready` is called once, after the first bring-up. `clears_protection`: an operator has requested that an error
        which a drive has at the start be cleared.

        Returns the exit code: 0 orderly, 2 the arm did not come up, or a conversation failed during shutdown, 3 the
        cycle ended by itself.
        """
        try:
            self._start_threads()
            for wire in self._wires:
                wire.attend(self._cycle.is_alive)
            code = self._supervise(ready, clears_protection)
            self._run_shutdown_dialogue()
        except DialogueFailed as failure:  # the cycle takes no orders any more
            self._tell(str(failure))
            return 3
        finally:
            self._end_threads()
            self._next_keep_s = 0.0
            self._keep_newly_lost()  # references lost since the last call
            self._release()
        if code == 0 and self._brought_up:  # else the stored ones stay: they were not compared yet
            self._save_positions()
        return code

    def _save_positions(self) -> None:
        """Store the counts of referenced joints after an orderly end.

        The drives then hold the arm, or it is limp and may be moved.
        """
        axes = self._loop[0]["axes"]
        counts = {
            joint: self._steps(joint)
            for joint in range(len(self._arm.joints))
            if axes[joint]["reference"]["referenced"] == 1 and axes[joint]["measured"]["readings"] > 0
        }
        try:
            reference_store.save(self._arm, counts)
        except reference_store.NotSaved as problem:
            self._tell(str(problem))

    def _steps(self, joint: int) -> int:
        """The joint's position, from its drive's own zero, in the smallest steps of the drive's readings."""
        row, axis = self._loop[0]["joints"][joint], self._loop[0]["axes"][joint]
        step_rad = math.copysign(row["reading_step_rad"], row["reading_per_rad"])
        return round(float((axis["measured"]["position_rad"] + row["zero_rad"]) / step_rad))

    def serve_offline(self, work: Callable[[ServicePort, Callable[[], None]], None]) -> int:
        """Do `work` beside a cycle that stays offline: nothing is brought up, and the cycle itself moves nothing.

        `work` gets the port for its conversations, and a function that it calls to let time pass and that raises when
        `work` must end. Returns exit code 0, or 3 when the cycle ended by itself; raises WireRefused when the adapter
        is gone.
        """
        try:
            self._start_threads()
            work(self._port, self._pause_offline)
        except Ended as ended:
            return ended.code
        finally:
            self._end_threads()
            self._release()
        return 0

    def _pause_offline(self) -> None:
        time.sleep(BUSY_POLL_S)
        if self._stop_asked.yes:
            raise Ended(0)
        if not self._cycle.is_alive():
            raise Ended(3)
        for wire in self._wires:
            wire.require()

    # --- threads

    def _start_threads(self) -> None:
        threading.stack_size(realtime.THREAD_STACK_BYTES)
        for wire in self._wires:
            wire.start_reader()
        self._start(self._cycle, self._prepared)  # the last: it publishes the scheduling that all threads were given
        while int(self._memory["timing"]["cycle"]) == 0 and self._cycle.is_alive():
            time.sleep(FIRST_CYCLE_POLL_S)  # compiled code is being loaded; no conversation's timeout may run meanwhile
        for complaint in self._obtained.complaints:
            self._tell(complaint)
        if self._arm.realtime.require and self._obtained.priority == 0:
            raise CannotStart(
                "realtime.require is true and no real-time priority was given: give the permission named above, or set "
                "realtime.require to false."
            )

    def _start_reader(self, read: Callable[[], None]) -> threading.Thread:
        """Start the thread of a wire's reader."""
        prepared = threading.Event()

        def run() -> None:
            realtime.prepare_thread(self._arm.realtime, self._obtained, below=10)
            prepared.set()
            read()

        reader = threading.Thread(target=run, name="reader", daemon=True)
        self._start(reader, prepared)
        return reader

    @staticmethod
    def _start(thread: threading.Thread, prepared: threading.Event) -> None:
        """Start it, and wait until it has been prepared."""
        thread.start()
        while not prepared.wait(FIRST_CYCLE_POLL_S) and thread.is_alive():
            pass

    def _run_cycle(self) -> None:
        realtime.prepare_thread(self._arm.realtime, self._obtained)
        realtime.lock_recorder(self._files.state.rings, self._obtained)  # last: what no cycle can do without goes first
        words = self._files.state.record["scheduling"]
        words["policy"], words["priority"] = self._obtained.policy, self._obtained.priority
        words["memory_locked"], words["cpu"] = self._obtained.memory_locked, self._obtained.cpu
        words["dma_latency_held"] = self._obtained.dma_latency_fd >= 0
        words["thread_id"] = threading.get_native_id()
        self._prepared.set()
        kept = self._loop, self._files.state.array, self._files.command.array  # keeps them mapped while this runs
        if self._compiled.run(kept[0].ctypes.data, kept[1].ctypes.data) != 0:
            self._tell("The control cycle ended by an exception, which is a defect of rtarm: please report it.")

    def _end_threads(self) -> None:
        for wire in self._wires:
            wire.leave()
        self._store(1, "stop")
        until_s = time.monotonic() + THREAD_PATIENCE_S
        if self._cycle.ident is not None:
            self._cycle.join(THREAD_PATIENCE_S)
        for wire in self._wires:
            wire.join(until_s)

    def _release(self) -> None:
        for wire in self._wires:
            wire.release()
        self._claim.close()  # the last frames have left
        self._files.remove(as_before=not self._brought_up)

    def _store(self, value: int, *word: str) -> None:
        """Publish a word of the loop's record to the threads."""
        self._compiled.store_word(self._loop.ctypes.data + offset_of(Loop, *word), value)

    # --- supervision

    @property
    def _memory(self) -> np.void:
        memory: np.void = self._loop[0]
        return memory

    def _bring_up(
        self,
        *,
        clears_protection: bool,
        counts_before: Mapping[int, int] | None = None,
        lost_before: Mapping[int, Unreferenced] | None = None,
        heals: bool = False,
    ) -> BringUp:
        measured = self._loop[0]["axes"]["measured"]["position_rad"][: len(self._arm.joints)]
        known = [0.0 if np.isnan(position) else float(position) for position in measured]
        return BringUp(
            self._arm,
            self._port,
            now_ns=time.monotonic_ns(),
            clears_protection=clears_protection,
            tell=self._tell,
            marks=self._marks,
            mock_positions_rad=known,
            counts_before=counts_before,
            lost_before=lost_before,
            held_rad=self._held_rad,
            heals=heals,
            forgive_silence=self._forgive_silence,
        )

    def _forgive_silence(self, joint: int) -> None:
        """Store for the next process that the silence cost no angle; if that fails, the next process asks the drive."""
        with suppress(reference_store.NotSaved):
            reference_store.forgive_silence(self._arm, joint)

    def _keep_lost(self, joint: int, reason: Unreferenced | None) -> None:
        """Store a reference that `Referencing` has changed, for the next process.

        The reason that the cycle still has for the joint is noted as stored: until the cycle gets its order that reason
        is out of date, and `_keep_newly_lost` must not store it.
        """
        reference_store.keep_lost_reference(self._arm, joint, reason)
        self._lost_references[joint] = Unreferenced(self._loop[0]["axes"][joint]["reference"]["unreferenced_reason"])

    def _keep_newly_lost(self) -> None:
        """Store each newly lost reference, so that the next process knows of it however this one ends."""
        axes = self._loop[0]["axes"][: len(self._arm.joints)]
        words = enumerate(zip(axes["reference"]["referenced"], axes["reference"]["unreferenced_reason"], strict=True))
        lost = {
            joint: Unreferenced(reason)
            for joint, (referenced, reason) in words
            if not referenced and reason in reference_store.OUTLIVES_THE_PROCESS
        }
        kept = {joint: reason for joint, reason in self._lost_references.items() if lost.get(joint) == reason}
        self._lost_references = kept  # each is stored once: the file may hold something newer since
        news = {joint: reason for joint, reason in lost.items() if joint not in kept}
        if not news or time.monotonic() < self._next_keep_s:
            return
        try:
            reference_store.keep_lost_references(self._arm, news)
            kept.update(news)
        except reference_store.NotSaved as problem:
            self._next_keep_s = time.monotonic() + KEEP_AGAIN_S
            if str(problem) != self._told_of_lost:
                self._told_of_lost = str(problem)
                self._tell(str(problem))

    def _asked_for(self) -> Conversation | None:
        """Begin the conversation that the cycle requests next, and return it; None if it requests none."""
        dialogue, now_ns = self._memory["dialogue"], time.monotonic_ns()
        if int(dialogue["bring_up_asked"]) == 1:
            dialogue["bring_up_asked"] = 0
            return self._bring_up(clears_protection=True)
        if int(dialogue["release_asked"]) == 1:
            dialogue["release_asked"] = 0  # the cycle withdraws it when the drives are enabled meanwhile
            self._held_rad.clear()
            return Release(self._arm, self._port, now_ns=now_ns)
        if not self._stop_asked.yes and (dialogue["home_asked"] or dialogue["reference_asked"]):
            return referencing_asked_for(
                self._arm, self._loop, self._port, now_ns, self._tell, self._keep_lost, self._marks
            )
        return None

    def _supervise(self, ready: Callable[[], None], clears_protection: bool) -> int:
        # the rings are still empty, so its first orders and frames have room
        talk: Conversation | None = self._bring_up(
            clears_protection=clears_protection,
            counts_before=reference_store.counts_before(self._arm),
            lost_before=reference_store.lost_references(self._arm, self._tell),
        )
        simulated = self._loop[0]["buses"]["simulated"][: len(self._arm.buses)]
        unlocked = bool(np.all(simulated)) or commissioned.heals(self._arm)
        healing = Healing(self._arm, self._loop, self._port, self._marks, unlocked=unlocked)
        first = True
        closing_until_s = 0.0
        while True:
            time.sleep(BUSY_POLL_S if talk or first or closing_until_s or self._gripper_is_busy() else IDLE_POLL_S)
            now_s = time.monotonic()
            self._keep_newly_lost()
            if self._gripper is not None:
                self._gripper.poll(time.monotonic_ns())
            if talk is not None and talk.poll(time.monotonic_ns()):
                if talk.failure is not None:
                    self._tell(str(talk.failure))
                    if first or self._stop_asked.yes:
                        return 2
                elif first and self._arm.control.init_mode == 0:
                    self._port.post(HOME_ALL)
                elif isinstance(talk, BringUp) and talk.heals:
                    self._tell(HEALED)
                healed = healing.succeeded(talk, time.monotonic_ns())
                talk = self._bring_up(clears_protection=False, heals=True) if healed else None
            mode = int(self._memory["mode"])
            if first and talk is None and mode == Mode.FAULT:  # such as a drive's that was up before the others
                ends = f"Not all drives were up yet, so rtarm ends: see to the cause, {ERROR_AT_START}."
                self._tell(f"{self._fault_sentence()} {ends}")
                return 2
            if first and talk is None and mode not in (Mode.OFFLINE, Mode.BRINGING_UP):
                self._keep_newly_lost()  # before the counts that a lost reference was found by are removed
                reference_store.forget_counts(self._arm)
                self._brought_up = True
                ready()
                first = False
                self._begin_with_gripper()
            if talk is None:
                talk = self._asked_for()
            if talk is None and not first and not self._stop_asked.yes:
                talk = healing.begin(time.monotonic_ns())
            if isinstance(talk, Referencing) and (
                self._stop_asked.yes or int(self._memory["dialogue"]["referencing_ends"]) == 1
            ):
                talk.end()
            if not self._cycle.is_alive():
                return 3
            if self._stop_asked.yes:
                if closing_until_s == 0.0:
                    self._memory["motion"]["closing"] = 1
                    if self._gripper is not None and self._gripper.moves:
                        self._gripper.stop()
                    closing_until_s = now_s + self._arm.patience.shutdown_s
                    if isinstance(talk, Referencing):
                        closing_until_s += STAND_PATIENCE_S
                stands = self._stands() and not isinstance(talk, Referencing) and not self._gripper_is_busy()
                if stands or now_s > closing_until_s:
                    return 0
                time.sleep(BUSY_POLL_S)

    def _fault_sentence(self) -> str:
        fault = self._memory["fault"]
        told = (fault[name].item() for name in ("code", "joint", "value", "limit", "silent", "evidence"))
        code, joint, value, limit, silent, evidence = told
        names = [joint.name for joint in self._arm.joints]
        return fault_told(code, joint, value, limit, silent, evidence, names, buses=self._arm.bus_names)

    def _run_shutdown_dialogue(self) -> None:
        """Turn off the reports of drives that send positions unasked; until the end the cycle polls them instead."""
        if not self._arm.bus.reported:
            return
        self._store(0, "params", "reported")
        talk = ShutdownDialogue(self._arm, self._port, now_ns=time.monotonic_ns())
        while self._cycle.is_alive() and not talk.poll(time.monotonic_ns()):
            time.sleep(BUSY_POLL_S)

    def _begin_with_gripper(self) -> None:
        """Begin the conversation with the gripper, if it is on the arm's bus.

        It begins after the first bring-up of the joints, which it must not delay, and runs beside their conversations.
        """
        if self._arm.gripper is not None and self._arm.gripper.servo is not None:
            self._gripper = GripperDialogue(
                self._arm,
                self._loop,
                self._port,
                self._files.state.array,
                now_ns=time.monotonic_ns(),
                tell=self._tell,
            )

    def _gripper_is_busy(self) -> bool:
        return self._gripper is not None and (self._gripper.busy or self._gripper.moves)

    def _stands(self) -> bool:
        """Whether no joint is commanded to move any more, and no goal is active."""
        axes = self._loop[0]["axes"][: len(self._arm.joints)]
        moving = bool(np.any(axes["commanded"]["velocity_rad_s"] != 0.0))
        return not moving and int(self._memory["paths"][int(self._memory["goals"]["active"])]["phase"]) == Phase.NONE
