"""Whose silence it was: each cause on the simulated arm, in virtual time, with the sentence that it alone gets."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from virtual import VirtualArm, recording_of

from rtarm.recording.mcap_format import Reason
from rtarm.recording.story import tell
from rtarm.top.events import happenings
from rtloop.wire import received
from sentences.english import SILENCES
from sentences.told import Silence, latched_sentence, reasons_unreferenced, unreferenced_sentences, whose_silence
from shm.words import Event, Evidence, Fault, Unreferenced
from sim.faults import Babble, PowerLoss, Silent, WrongChecksums

ALL = 0b111111


class Blocked(VirtualArm):
    """An arm whose wire takes nothing any more once `blocked` is set."""

    blocked = False

    def write(self, data: bytes) -> None:
        if self.blocked:
            self.taken(0)
        else:
            super().write(data)


class Frozen(VirtualArm):
    """An arm whose adapter neither takes nor gives anything once `frozen` is set, though the port takes its bytes."""

    frozen = False

    def listen(self, until_ns: int) -> None:
        if not self.frozen:
            super().listen(until_ns)

    def write(self, data: bytes) -> None:
        if self.frozen:
            self.taken(len(data))
        else:
            super().write(data)


def whose(arm: VirtualArm) -> Silence | None:
    memory = arm.memory
    return whose_silence(
        int(memory["fault"]["joint"]), int(memory["fault"]["silent"]), int(memory["fault"]["evidence"])
    )


def latched(arm: VirtualArm, periods: int = 1) -> VirtualArm:
    """The arm after its fault, which must be that of a silence, a cycle each so many periods until then."""
    for _ in range(100):
        if arm.memory["fault"]["code"] != Fault.NONE:
            break
        arm.cycle(periods)
    assert arm.memory["fault"]["code"] == Fault.STALE_READING
    arm.cycles(12)
    return arm


def unplug_all(arm: VirtualArm) -> None:
    for joint in arm.arm.joints:
        arm.sim.inject(Silent(joint.name, at_s=0.0), since_ns=arm.now_ns)


def one_drive() -> VirtualArm:
    arm = VirtualArm.amid("large")
    arm.sim.inject(Silent("joint2", at_s=0.0), since_ns=arm.now_ns)
    return latched(arm)


def several_drives() -> VirtualArm:
    arm = VirtualArm.amid("large")
    for name in ("joint4", "joint5", "joint6"):
        arm.sim.inject(Silent(name, at_s=0.0), since_ns=arm.now_ns)
    return latched(arm)


def power_lost(**options: object) -> VirtualArm:
    arm = VirtualArm.amid("large", **options)
    for joint in arm.arm.joints:
        arm.sim.inject(PowerLoss(joint.name, at_s=0.0, off_s=60.0), since_ns=arm.now_ns)
    return latched(arm)


def power_lost_behind_an_adapter_that_never_answers() -> VirtualArm:
    return power_lost(dialect="canable")


def adapter_frozen() -> VirtualArm:
    arm = Frozen.amid("large")
    arm.frozen = True
    return latched(arm)


def adapter_frozen_that_never_answers() -> VirtualArm:
    arm = Frozen.amid("large", dialect="canable")
    arm.frozen = True
    return latched(arm)


def wire_blocked() -> VirtualArm:
    arm = Blocked.amid("large")
    arm.blocked = True
    return latched(arm)


def cycle_late() -> VirtualArm:
    """Each third cycle is missed, and no answer comes."""
    arm = VirtualArm.amid("large")
    unplug_all(arm)
    return latched(arm, periods=3)


def reader_late() -> VirtualArm:
    arm = Frozen.amid("large")
    received.awake(arm.loop[0]["buses"][0], arm.now_ns)
    arm.frozen = True
    return latched(arm)


def simulated() -> VirtualArm:
    arm = Frozen.amid("large")
    arm.loop[0]["buses"][0]["simulated"] = 1
    arm.frozen = True
    return latched(arm)


def bus_babbled() -> VirtualArm:
    arm = VirtualArm.amid("large")
    arm.sim.inject(Babble(at_s=0.0), since_ns=arm.now_ns)
    return latched(arm)


def no_answer_believed() -> VirtualArm:
    arm = VirtualArm.amid("large")
    arm.sim.inject(WrongChecksums(1.0, at_s=0.0), since_ns=arm.now_ns)
    return latched(arm)


CAUSES: dict[Callable[[], VirtualArm], tuple[Silence | None, int]] = {
    one_drive: (None, 0b10),
    several_drives: (Silence.SEVERAL_DRIVES, 0b111000),
    power_lost: (Silence.SUPPLY_OR_CABLE, ALL),
    power_lost_behind_an_adapter_that_never_answers: (Silence.SUPPLY, ALL),
    adapter_frozen: (Silence.ADAPTER, ALL),
    adapter_frozen_that_never_answers: (Silence.SUPPLY, ALL),
    wire_blocked: (Silence.NOT_TAKEN, ALL),
    cycle_late: (Silence.MACHINE, ALL),
    reader_late: (Silence.MACHINE, ALL),
    simulated: (Silence.SIMULATED_ARM, ALL),
    bus_babbled: (Silence.BABBLE, ALL),
    no_answer_believed: (Silence.NOT_BELIEVED, ALL),
}


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.__name__)
def test_a_silence_is_told_once_by_its_cause_and_the_same_everywhere(cause: Callable[[], VirtualArm]) -> None:
    arm = cause()
    wanted, silent = CAUSES[cause]
    names = tuple(joint.name for joint in arm.arm.joints)
    assert (whose(arm), int(arm.memory["fault"]["silent"])) == (wanted, silent)
    assert (int(arm.memory["fault"]["joint"]) == -1) == (silent == ALL)

    snapshot = arm.reader.snapshot()
    sentence = latched_sentence(snapshot, names)
    recording = recording_of(arm)
    told = [(one.sentence, int(event["kind"])) for one, event in happenings(recording.events, names)]
    assert [said for said, kind in told if kind == Event.FAULT] == [sentence]
    story = tell(recording, Reason("fault", sentence))
    assert story.verdict[0] == sentence
    assert [line.sentence for line in story.lines].count(sentence) == 1

    lost = reasons_unreferenced(snapshot, names)
    assert set(lost.values()) == {Unreferenced.SILENT}
    assert [name for number, name in enumerate(names) if silent >> number & 1] == list(lost)
    assert [said for said, kind in told if kind == Event.REFERENCE] == unreferenced_sentences(lost)
    assert len(unreferenced_sentences(lost)) == 1


@pytest.mark.parametrize("cause", [power_lost, adapter_frozen, wire_blocked, bus_babbled])
def test_a_silence_of_all_drives_is_in_the_story_once(cause: Callable[[], VirtualArm]) -> None:
    arm = cause()
    sentences = [line.sentence for line in tell(recording_of(arm), Reason("fault", "")).lines]
    assert sentences.count("No drive gives readings from here on.") == 1
    assert not any(name in said for name in ("joint1", "joint6") for said in sentences if "reading" in said)


def test_only_what_came_since_a_drive_was_heard_speaks_for_a_cause() -> None:
    """Cycles that were missed, and bytes that were not taken, long before are no evidence."""
    arm = Blocked.amid("large")
    arm.blocked = True
    arm.cycles(1)
    arm.blocked = False
    arm.cycle(4)
    arm.cycles(30)
    assert arm.state.record["counters"]["bytes_unsent"] > 0
    for joint in arm.arm.joints:
        arm.sim.inject(PowerLoss(joint.name, at_s=0.0, off_s=60.0), since_ns=arm.now_ns)
    assert whose(latched(arm)) == Silence.SUPPLY_OR_CABLE
    arm.close()


def test_the_machine_and_the_adapter_are_never_told_as_a_cable_of_a_drive() -> None:
    for silence in (Silence.MACHINE, Silence.SIMULATED_ARM):
        assert "cable" not in SILENCES[silence].sentence
    for silence in (Silence.SUPPLY, Silence.SUPPLY_OR_CABLE, Silence.NOT_ACKNOWLEDGED):
        assert "look first at the drives' supply and its switch" in SILENCES[silence].sentence


def test_the_evidence_moves_nothing() -> None:
    """Two arms, of which one is told that its drives are simulated and its reader is late, do the same to the bit."""
    sent = []
    for evidence in (False, True):
        arm = Frozen.amid("large")
        if evidence:
            arm.loop[0]["buses"][0]["simulated"] = 1
            received.awake(arm.loop[0]["buses"][0], arm.now_ns)
        arm.frozen = True
        latched(arm)
        assert bool(int(arm.memory["fault"]["evidence"]) & Evidence.SIMULATED) == evidence
        sent.append([data for _, data in arm.sent])
        arm.close()
    assert sent[0] == sent[1]
