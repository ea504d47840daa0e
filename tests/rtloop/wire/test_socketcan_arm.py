"""An arm on SocketCAN in virtual time: the cycle, the drives and bring-up are the same, only the wire is another."""

import numpy as np
import pytest
from can_records import error_record, frames_in, unpacked
from observer import command_violations, frames_sent, motion_after, motion_frames, motion_violations, truth_of
from virtual import START_NS, VirtualArm, recorded_goal

from config.loader import load_arm
from rtloop.process.run import take_over_wire
from rtloop.service.port import SEND, Frame
from rtloop.wire import can_words, outgoing, received
from shm.words import Answer, BusState, Event, Fault, Mode, Outcome, Request
from sim.faults import LostReplies, PowerLoss, Silent

ENETDOWN = 100
ON_SOCKETCAN = load_arm("episode1", overrides={"bus": {"interface": "socketcan"}})


def judged(arm, *, thrown=()):
    """What the observer finds in the bytes and in the drives' true motion."""
    truth = truth_of(arm.sim)
    return [
        *command_violations(arm.arm, frames_in(arm.sent)),
        *motion_violations(arm.arm, truth, START_NS, arm.sim.now_ns, thrown=thrown),
    ]


def request(arm, kind):
    """Make a request and return its answer."""
    sequence = arm.request(kind)
    arm.cycles(3)
    answers = arm.loop[0]["snapshot"]["answers"]
    (answer,) = answers["answer"][answers["sequence"] == sequence]
    return Answer(int(answer))


def events(arm, kind):
    record = arm.state.record
    return [event for event in record["events"][: int(record["events_written"][0])] if event["kind"] == kind]


@pytest.mark.parametrize("name", ["small", "large", "scale_0_1"])
def test_goals_succeed_as_they_do_behind_a_serial_adapter(name):
    """Same drives, same instants: what the drives are told does not depend on the wire, frame for frame."""
    told = []
    for config in (ON_SOCKETCAN, load_arm("episode1", overrides={"bus": {"serial_baud": "cdc"}})):
        arm = VirtualArm.at_start_of(name, config)
        assert arm.end_of(arm.play(name)) == Outcome.SUCCEEDED
        if arm.arm.bus.interface == "socketcan":
            assert judged(arm) == []
            told.append([(frame.can_id, frame.data) for frame in frames_in(arm.sent)])
        else:
            told.append([(frame.can_id, frame.data) for frame in frames_sent(arm.sent)])
        arm.close()
    assert told[0] == told[1]


def test_lost_replies_do_not_stop_the_arm():
    arm = VirtualArm.amid("large", arm=ON_SOCKETCAN)
    arm.sim.inject(LostReplies(0.1), since_ns=arm.now_ns)
    assert arm.end_of(arm.goal) == Outcome.SUCCEEDED
    assert judged(arm) == []
    arm.close()


def test_a_silent_drive_is_latched():
    arm = VirtualArm.amid("large", arm=ON_SOCKETCAN)
    arm.sim.inject(Silent("joint2", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.STALE_READING, 1)
    arm.cycles(200)
    assert judged(arm) == []
    arm.close()


def test_a_drive_that_lost_power_gets_its_stop_and_no_motion_frame():
    arm = VirtualArm.amid("large", arm=ON_SOCKETCAN)
    arm.sim.inject(PowerLoss("joint2", at_s=0.0, off_s=0.03), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    since_ns = arm.now_ns
    arm.cycles(300)
    assert motion_frames(frames_in(arm.sent), 2, since_ns) == 0
    assert any(frame.data == b"\xfe\x98\x00\x6b" for frame in frames_in(arm.sent) if frame.drive == 2)
    assert judged(arm, thrown=["joint2"]) == []
    arm.close()


# --- errors -------------------------------------------------------------------------------------------------


def hear(arm, error_class, detail=b""):
    arm.receive(arm.now_ns, error_record(error_class, detail))
    arm.cycle()


def test_a_bus_that_goes_off_again_after_a_clear_is_latched_again():
    """The controller need not have said that it was back in between."""
    arm = VirtualArm.amid("large", arm=ON_SOCKETCAN)
    hear(arm, can_words.BUS_OFF)
    arm.until(lambda: arm.running_goal == 0)
    assert request(arm, Request.CLEAR_FAULT) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up(clears_protection=True).failure is None
    assert (arm.memory["mode"], arm.state.record["counters"]["bus_state"]) == (Mode.HOLDING, BusState.ACTIVE)
    hear(arm, can_words.BUS_OFF)
    assert (arm.memory["fault"]["code"], arm.memory["buses"][0]["transmit_inhibited"]) == (Fault.BUS_OFF, 1)
    arm.close()


def test_bus_off_stops_the_arm_and_nothing_of_before_moves_it_afterwards():
    """The controller restarts and the drives hear again: not one motion frame until a person clears the fault."""
    arm = VirtualArm.amid("large", arm=ON_SOCKETCAN)
    hear(arm, can_words.BUS_OFF)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["value"]) == (Fault.BUS_OFF, float(can_words.BUS_OFF))
    assert arm.outcome(arm.goal) == Outcome.FAULT
    since_ns = arm.now_ns - 1
    arm.cycles(12)
    hear(arm, can_words.RESTARTED)
    assert arm.state.record["counters"]["bus_state"] == BusState.ACTIVE
    arm.until(lambda: arm.running_goal == 0)
    arm.cycles(200)
    sent = frames_in(arm.sent)
    assert not any(motion_frames(sent, drive, since_ns) for drive in range(1, 7))
    assert judged(arm) == []
    assert motion_after(truth_of(arm.sim), since_ns + 500_000_000, arm.sim.now_ns) == []

    # the drives have answered all the time, so they are referenced and a clear brings the arm back
    assert request(arm, Request.CLEAR_FAULT) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up(clears_protection=True).failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    assert np.all(arm.loop[0]["axes"]["reference"]["referenced"][:6] == 1)
    arm.close()


def test_an_error_passive_controller_is_told_of_and_the_age_ladder_brakes():
    """No motor powered: the controller counts, nobody answers, and after 0.1 s that is the fault."""
    arm = VirtualArm.amid("large", arm=ON_SOCKETCAN)
    for joint in range(1, 7):
        arm.sim.inject(Silent(f"joint{joint}", at_s=0.0), since_ns=arm.now_ns)
    hear(arm, can_words.CONTROLLER | can_words.NO_ACKNOWLEDGE, b"\0\x20")
    assert arm.memory["mode"] == Mode.EXECUTING
    counters = arm.state.record["counters"]
    assert (counters["bus_state"], counters["unacknowledged"], counters["error_frames"]) == (BusState.PASSIVE, 1, 1)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert arm.memory["fault"]["code"] == Fault.STALE_READING
    arm.cycles(100)
    assert judged(arm) == []
    arm.close()


# --- gone, and back -----------------------------------------------------------------------------------------


class Replugged:
    """The wire taken away from an arm in virtual time and given back, as the control process does it."""

    def __init__(self, arm, error):
        self.arm = arm
        self.gone_ns = arm.now_ns
        self.since = len(arm.sent)
        received.close(arm.loop[0]["buses"][0], error)

    def away(self, cycles):
        self.arm.cycles(cycles)
        assert self.arm.sent[self.since :] == []

    def back(self):
        arm = self.arm
        arm.loop[0]["buses"][0]["received"]["arrived"]["closed"] = 0
        arm.loop[0]["buses"][0]["wire"]["fd"] = 7
        assert take_over_wire(arm.loop[0], arm.state.array[0], arm.loop[0]["buses"][0]) == 7


@pytest.mark.parametrize("interface", ["slcan", "socketcan"])
@pytest.mark.parametrize("cycles_away", [3, 60])
def test_a_wire_that_is_back_moves_nothing_until_the_fault_is_cleared(interface, cycles_away):
    """For 25 ms, in which the joints keep their reference, and for half a second, after which the drives prove it."""
    start_rad = recorded_goal("large")["joints"][0, :, 0]
    arm = VirtualArm(load_arm("episode1", overrides={"bus": {"interface": interface}}), start_rad=start_rad)
    decode = frames_in if interface == "socketcan" else frames_sent
    assert arm.bring_up().failure is None
    goal = arm.play("large")
    arm.cycles(120)
    outgoing.took(arm.loop[0], arm.state.array[0], arm.loop[0]["buses"][0], 0)
    link = Replugged(arm, ENETDOWN if interface == "socketcan" else 5)
    link.away(cycles_away)
    assert arm.memory["fault"]["code"] == (Fault.LINK_DOWN if interface == "socketcan" else Fault.WIRE)
    assert arm.outcome(goal) == Outcome.FAULT
    assert request(arm, Request.CLEAR_FAULT) == Answer.REFUSED_WIRE
    link.back()
    assert len(events(arm, Event.WIRE)) == 1
    arm.cycles(300)
    sent = decode(arm.sent)
    assert not any(motion_frames(sent, drive, link.gone_ns) for drive in range(1, 7))
    assert sent[-1].time_ns == arm.now_ns  # readings flow again
    assert arm.now_ns - arm.loop[0]["axes"]["measured"]["time_ns"][:6].min() < 3 * arm.period_ns
    truth = truth_of(arm.sim)
    assert motion_after(truth, link.gone_ns + 500_000_000, arm.sim.now_ns) == []
    assert motion_violations(arm.arm, truth, START_NS, arm.sim.now_ns) == []
    assert command_violations(arm.arm, sent) == []

    assert request(arm, Request.CLEAR_FAULT) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up(clears_protection=True).failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    axes = arm.loop[0]["axes"][:6]
    again = arm.play("large")
    arm.end_of(again)
    assert list(axes["reference"]["referenced"]) == [1] * 6
    assert arm.outcome(again) in (Outcome.SUCCEEDED, Outcome.REFUSED_START)
    arm.cycles(50)
    assert command_violations(arm.arm, decode(arm.sent)) == []
    arm.close()


def test_what_a_conversation_wanted_to_say_is_not_said_when_the_wire_is_back():
    """Bring-up is cut off in the midst of a command; its other packets must not lead the next conversation's."""
    arm = VirtualArm(ON_SOCKETCAN)
    arm.memory["mode"] = Mode.HOLDING
    for number in range(5):
        arm.port.post(SEND, frame=Frame(0x100 | number, b"\x48" + bytes(7)), joined=number < 4)
    link = Replugged(arm, ENETDOWN)
    link.away(3)
    link.back()
    arm.cycles(3)
    assert not any(content[:1] == b"\x48" for _, data in arm.sent for _, content in unpacked(data))
    arm.close()
