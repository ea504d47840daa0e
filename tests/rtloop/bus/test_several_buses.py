"""Arms of several buses in virtual time: one cycle, a wire, a budget and an account of silence for each."""

from typing import Any

import numpy as np
import pytest
from can_records import error_record, frames_in, unpacked
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from observer import command_violations, frames_sent, motion_after, motion_frames, motion_violations, truth_of
from two_buses import divided, divided_values
from virtual import START_NS, VirtualArm, recorded_goal

from config.frames import ADAPTER_FRAMES
from config.loader import known_arms, load_arm
from config.schema import ArmConfig
from rtloop.bus.measured import ENETDOWN
from rtloop.process.run import take_over_wire
from rtloop.wire import can_words, received
from shm.words import Answer, BusState, Evidence, Fault, Mode, Outcome, Request, Unreferenced
from sim.faults import Silent

SHOULDER, WRIST = 0, 1
GOAL = "large"
ARMS = [name for name in known_arms() if name != "mock"]
ON_SOCKETCAN = {"interface": "socketcan", "serial_baud": "cdc"}


def moving(config: ArmConfig, cycles: int = 60) -> VirtualArm:
    """An arm amid a goal that moves all its joints."""
    arm = VirtualArm.at_start_of(GOAL, config)
    arm.goal = arm.play(GOAL)
    arm.cycles(cycles)
    assert arm.memory["mode"] == Mode.EXECUTING
    return arm


def violations(arm: VirtualArm) -> list[str]:
    """What the observer finds, bus by bus, in the bytes and in the drives' true motion."""
    found: list[str] = []
    for part, sim, sent in zip(arm.arm.parts, arm.sims, arm.sent_on, strict=True):
        frames = frames_in(sent) if part.bus.interface == "socketcan" else frames_sent(sent)
        found += command_violations(part, frames)
        found += motion_violations(part, truth_of(sim), START_NS, sim.now_ns)
    return found


def close_wire(arm: VirtualArm, bus: int, error: int = 5) -> None:
    received.close(arm.loop[0]["buses"][bus], error)


def open_wire(arm: VirtualArm, bus: int) -> None:
    """Give the bus its wire back, as the control process does."""
    row = arm.loop[0]["buses"][bus]
    row["received"]["arrived"]["closed"] = 0
    row["wire"]["fd"] = 7
    assert take_over_wire(arm.loop[0], arm.state.array[0], row) == 7


# --- all well -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_a_goal_moves_the_joints_of_both_buses_though_their_identifiers_are_the_same(name: str) -> None:
    arm = VirtualArm(divided(name), start_rad=recorded_goal(GOAL)["joints"][0, :, 0])
    assert arm.bring_up().failure is None, arm.told
    arm.reference_all()
    assert arm.end_of(arm.play(GOAL)) == Outcome.SUCCEEDED
    last_rad = recorded_goal(GOAL)["joints"][-1, :, 0]
    for number, sim in enumerate(arm.sims):
        true_rad = [sim.true_position_rad(place, sim.now_ns) for place in range(3)]
        assert np.allclose(true_rad, last_rad[arm.joints_on(number)], atol=0.02)
    arm.close()


def commanded_rad(config: ArmConfig) -> np.ndarray:
    """Commanded positions of a goal's cycles, (cycles, joints)."""
    arm = moving(config, cycles=1)
    found = []
    while arm.memory["mode"] == Mode.EXECUTING:
        arm.cycle()
        found.append(arm.loop[0]["axes"]["commanded"]["position_rad"][:6].copy())
    assert arm.outcome(arm.goal) == Outcome.SUCCEEDED
    arm.close()
    return np.array(found)


def test_the_way_of_a_goal_is_the_same_on_two_buses_as_on_one() -> None:
    """To the last bit; what drives are told differs by what they answer earlier, as there is less before them."""
    one, two = (
        commanded_rad(load_arm("episode1", overrides={"bus": ON_SOCKETCAN})),
        commanded_rad(divided("episode1", ON_SOCKETCAN)),
    )
    cycles = min(len(one), len(two))
    assert cycles > 100 and abs(len(one) - len(two)) <= 3
    assert np.array_equal(one[:cycles], two[:cycles])


@settings(deadline=None, max_examples=examples(15))
@given(st.lists(st.integers(0, 3), min_size=6, max_size=6))
def test_however_joints_are_divided_each_bus_carries_its_own(choice: list[int]) -> None:
    used = sorted(set(choice))
    values: dict[str, Any] = load_arm("damiao6").model_dump(mode="json", exclude_unset=True)
    shared = {key: value for key, value in values["bus"].items() if key != "usb_index"} | ON_SOCKETCAN
    values["bus"] = [{**shared, "name": f"bus{number}", "channel": f"can{number}"} for number in used]
    for joint, number in zip(values["joints"], choice, strict=True):
        joint["bus"] = f"bus{number}"
    arm = VirtualArm.at_start_of(GOAL, ArmConfig.model_validate(values))
    arm.reference_all()
    assert arm.end_of(arm.play(GOAL)) == Outcome.SUCCEEDED
    for number, part in enumerate(arm.arm.parts):
        own = [used for joint in part.joints for used in joint.drive.identifiers]
        sent = {word & 0x1FFFFFFF for _, data in arm.sent_on[number] for word, _ in unpacked(data)}
        assert sent and all(any((can_id ^ used.match) & used.mask == 0 for used in own) for can_id in sent)
    arm.close()


def test_each_bus_asks_a_drive_of_its_own_for_its_status_in_every_cycle() -> None:
    arm = moving(divided("episode1", ON_SOCKETCAN))
    since = [len(sent) for sent in arm.sent_on]
    arm.cycles(30)
    for bus in (SHOULDER, WRIST):
        asked = [frame.drive for frame in frames_in(arm.sent_on[bus][since[bus] :]) if frame.data == b"\x3a\x6b"]
        assert len(asked) == 30 and set(asked) == {1, 2, 3}
    arm.close()


# --- one bus in trouble ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("bus", [SHOULDER, WRIST])
def test_when_a_wire_is_gone_the_drives_of_the_other_bus_are_led_to_rest(bus: int) -> None:
    """No motion frame is made for the bus without wire; its drives brake by themselves. A clear is refused."""
    arm = moving(divided("episode1", ON_SOCKETCAN))
    other, gone_ns, since = 1 - bus, arm.now_ns, len(arm.sent_on[bus])
    close_wire(arm, bus)
    arm.cycles(3)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["value"]) == (Fault.WIRE, 5.0)
    assert arm.outcome(arm.goal) == Outcome.FAULT
    assert any(motion_frames(frames_in(arm.sent_on[other]), drive, gone_ns) for drive in (1, 2, 3))
    assert arm.ask(Request.CLEAR_FAULT) in (Answer.REFUSED_WIRE, Answer.REFUSED_MOVING)
    arm.until(lambda: arm.running_goal == 0)
    assert arm.ask(Request.CLEAR_FAULT) == Answer.REFUSED_WIRE
    arm.cycles(100)
    assert arm.sent_on[bus][since:] == []
    for sim in arm.sims:
        assert motion_after(truth_of(sim), gone_ns + 600_000_000, sim.now_ns) == []
    assert violations(arm) == []

    open_wire(arm, bus)
    arm.cycles(50)
    assert arm.clear_fault().failure is None, arm.told
    assert arm.memory["mode"] == Mode.HOLDING
    axes = arm.loop[0]["axes"][:6]
    assert np.all(axes["reference"]["referenced"] == 1), [
        Unreferenced(int(r)) for r in axes["reference"]["unreferenced_reason"]
    ]
    arm.close()


def test_silence_on_one_bus_names_its_drives_and_what_happened_there() -> None:
    """Strange frames on the other bus are no evidence, and its drives stay referenced."""
    arm = moving(divided("episode1", ON_SOCKETCAN))
    for joint in ("joint4", "joint5", "joint6"):
        arm.sims[WRIST].inject(Silent(joint, at_s=0.0), since_ns=arm.now_ns)
    heard_ns = arm.now_ns
    while arm.memory["mode"] != Mode.FAULT:
        arm.receive(arm.now_ns, error_record(can_words.PROTOCOL), SHOULDER)
        arm.cycle()
    fault = arm.memory["fault"]
    assert (fault["code"], fault["joint"], fault["silent"]) == (Fault.STALE_READING, 3, 0b111000)
    assert not int(fault["evidence"]) & (Evidence.BUS_ERRORS | Evidence.UNACKNOWLEDGED | Evidence.HEARD)
    arm.until(lambda: arm.running_goal == 0)
    arm.cycles(200)
    referenced = arm.loop[0]["axes"]["reference"]["referenced"][:6]
    assert list(referenced) == [1, 1, 1, 0, 0, 0]
    for sim in arm.sims:
        assert motion_after(truth_of(sim), heard_ns + 1_000_000_000, sim.now_ns) == []
    assert violations(arm) == []
    arm.close()


def test_a_bus_that_goes_off_stops_the_arm_and_the_other_bus_is_led_to_rest() -> None:
    arm = moving(divided("episode1", ON_SOCKETCAN))
    arm.receive(arm.now_ns, error_record(can_words.BUS_OFF), WRIST)
    arm.cycle()
    off_ns = arm.now_ns
    assert (arm.memory["fault"]["code"], arm.state.record["counters"]["bus_state"]) == (Fault.BUS_OFF, BusState.BUS_OFF)
    assert [int(bus["transmit_inhibited"]) for bus in arm.loop[0]["buses"][:2]] == [0, 1]
    arm.cycles(10)
    assert any(motion_frames(frames_in(arm.sent_on[SHOULDER]), drive, off_ns) for drive in (1, 2, 3))
    assert not any(motion_frames(frames_in(arm.sent_on[WRIST]), drive, off_ns) for drive in (1, 2, 3))
    arm.receive(arm.now_ns, error_record(can_words.RESTARTED), WRIST)
    arm.until(lambda: arm.running_goal == 0)
    assert arm.state.record["counters"]["bus_state"] == BusState.ACTIVE
    arm.cycles(100)
    assert not any(motion_frames(frames_in(arm.sent_on[WRIST]), drive, off_ns) for drive in (1, 2, 3))
    assert violations(arm) == []
    assert arm.clear_fault().failure is None
    arm.close()


def test_frames_that_a_dead_bus_takes_no_more_leave_room_on_the_other() -> None:
    """Nobody acknowledges on one bus: what its adapter is given is bounded, and the other bus is not held back."""
    arm = moving(divided("episode1", ON_SOCKETCAN))
    for joint in ("joint4", "joint5", "joint6"):
        arm.sims[WRIST].inject(Silent(joint, at_s=0.0), since_ns=arm.now_ns)
    since = [len(frames_in(sent)) for sent in arm.sent_on]
    before = arm.memory["timing"]["cycle"]
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    cycles = int(arm.memory["timing"]["cycle"] - before)
    given = [len(frames_in(sent)) - count for sent, count in zip(arm.sent_on, since, strict=True)]
    assert given[WRIST] <= ADAPTER_FRAMES < 10 * cycles == given[SHOULDER]  # two of each target, questions, a status
    arm.close()


troubles = st.lists(
    st.tuples(st.sampled_from(("wire", "link", "off", "silent", "back")), st.integers(0, 1), st.integers(1, 60)),
    min_size=1,
    max_size=4,
)
"""What befalls which bus, and for how many cycles it lasts until the next."""


@settings(deadline=None, max_examples=examples(25))
@given(st.integers(20, 150), troubles)
def test_whatever_befalls_either_bus_the_arm_comes_to_rest(cycles: int, befalls: list[tuple[str, int, int]]) -> None:
    """Nothing leaves on a wire that is gone, every goal ends, and nothing moves afterwards."""
    arm = moving(divided("episode1", ON_SOCKETCAN), cycles)
    gone: dict[int, int] = {}  # and how many times its wire had taken something
    for what, bus, lasts in befalls:
        if what in ("wire", "link") and bus not in gone:
            close_wire(arm, bus, 5 if what == "wire" else ENETDOWN)
            gone[bus] = len(arm.sent_on[bus])
        elif what == "back" and bus in gone:
            open_wire(arm, bus)
            del gone[bus]
        elif what == "off":
            arm.receive(arm.now_ns, error_record(can_words.BUS_OFF), bus)
        elif what == "silent":
            arm.sims[bus].inject(Silent(arm.arm.parts[bus].joints[0].name, at_s=0.0), since_ns=arm.now_ns)
        arm.cycles(lasts)
        assert {bus: len(arm.sent_on[bus]) for bus in gone} == gone
    arm.until(lambda: arm.running_goal == 0)
    arm.cycles(150)
    since_ns = arm.now_ns
    arm.cycles(50)
    for sim in arm.sims:
        assert motion_after(truth_of(sim), since_ns, sim.now_ns) == []
    assert violations(arm) == []
    arm.close()


def test_a_start_fails_when_a_bus_is_dead_and_names_its_first_drive() -> None:
    faults = [Silent(joint, at_s=0.0) for joint in ("joint4", "joint5", "joint6")]
    arm = VirtualArm(divided("episode1"))
    for fault in faults:
        arm.sims[WRIST].inject(fault, since_ns=arm.now_ns)
    failure = arm.bring_up().failure
    assert failure is not None and failure.joint in (3, 4, 5) and "does not answer" in str(failure)
    arm.close()


def test_a_wire_lost_before_the_first_cycle_lets_nothing_leave_on_it() -> None:
    """Frames of conversations to it are dropped, and those to the other bus go on."""
    arm = VirtualArm(divided("episode1", ON_SOCKETCAN))
    close_wire(arm, SHOULDER)
    assert arm.bring_up().failure is not None
    assert arm.sent_on[SHOULDER] == [] and arm.sent_on[WRIST] != []
    arm.close()


def test_a_gripper_on_a_bus_of_its_own_hears_nothing_of_the_other() -> None:
    """It goes on while the other bus has no wire, and is refused without its own."""
    values = divided_values("episode1", ON_SOCKETCAN) | {
        "gripper": {"hook": "servo", "servo": {"address": 9, "bus": "wrist"}}
    }
    arm = VirtualArm.brought_up(ArmConfig.model_validate(values))
    arm.begin_with_gripper()
    arm.cycles(100)

    def told(bus: int) -> int:
        frames = (word for _, data in arm.sent_on[bus] for word, _ in unpacked(data))
        return sum((word & 0x1FFFFFFF) >> 8 == 9 for word in frames)

    assert told(SHOULDER) == 0 < told(WRIST)
    assert arm.arm.gripper is not None
    close_wire(arm, SHOULDER)
    arm.cycles(3)
    before = told(WRIST)
    assert arm.ask(Request.GRIP, value=arm.arm.gripper.lower_rad) == Answer.DONE
    arm.cycles(50)
    assert told(WRIST) > before
    close_wire(arm, WRIST)
    arm.cycle()
    since = len(arm.sent_on[WRIST])
    assert arm.ask(Request.GRIP, value=arm.arm.gripper.upper_rad) == Answer.REFUSED_WIRE
    arm.cycles(50)
    assert len(arm.sent_on[WRIST]) == since
    arm.close()


def test_silence_of_all_drives_tells_what_speaks_for_it_on_whichever_bus() -> None:
    arm = moving(divided("episode1", ON_SOCKETCAN))
    for joint, bus in zip(
        ("joint1", "joint2", "joint3", "joint4", "joint5", "joint6"), (0, 0, 0, 1, 1, 1), strict=True
    ):
        arm.sims[bus].inject(Silent(joint, at_s=0.0), since_ns=arm.now_ns)
    arm.cycles(3)
    arm.receive(arm.now_ns, error_record(can_words.CONTROLLER | can_words.NO_ACKNOWLEDGE, b"\0\x20"), WRIST)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    fault = arm.memory["fault"]
    assert (fault["code"], fault["joint"]) == (Fault.STALE_READING, -1)
    assert int(fault["evidence"]) & Evidence.UNACKNOWLEDGED
    arm.close()


@pytest.mark.parametrize("listed", [True, False])
def test_a_drive_that_names_the_only_bus_is_on_the_same_as_one_that_does_not(listed: bool) -> None:
    values = load_arm("episode1").model_dump(mode="json", exclude_unset=True)
    bus = {**values["bus"], "name": "only"}
    values["bus"] = [bus] if listed else bus
    values["joints"][3] |= {"bus": "only", "drive": values["joints"][0]["drive"]}
    with pytest.raises(ValueError, match="address 1 is used by joint1 and joint4"):
        ArmConfig.model_validate(values)


def test_numbers_may_repeat_on_two_buses_and_not_on_one() -> None:
    values = divided_values("episode1")
    for joint in values["joints"]:
        joint["bus"] = "shoulder"
    values["bus"] = values["bus"][:1]
    with pytest.raises(ValueError, match="address 1 is used by joint1 and joint4"):
        ArmConfig.model_validate(values)
