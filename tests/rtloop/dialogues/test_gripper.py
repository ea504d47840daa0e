"""The gripper on the bus in virtual time: its drive's bytes, true stalls, and everything that goes wrong with it."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.budget import budget
from config.loader import load_arm
from motion.gripping import Grip, GripJudge, stall_ns
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives import zdt_talk
from rtloop.drives.zdt_ask import split_packets
from rtloop.service.conversation import Conversation
from rtloop.service.port import SEND, Frame
from shm.gripper import read_gripper
from shm.words import Answer, Fault, GripTrouble, Mode, Outcome, Request
from sim import faults

OPEN_RAD = math.radians(110.0)
TOLERANCE_RAD = math.radians(1.0)
ADDRESS = 7


def arm_with(servo: dict[str, Any] | None = None, **gripper: Any) -> Any:
    section = {"hook": "servo", "servo": {"address": ADDRESS, **(servo or {})}, **gripper}
    return load_arm("episode1", overrides={"gripper": section})


class Stage:
    """An arm that holds, its gripper known, with what people would ask of it."""

    def __init__(self, servo: dict[str, Any] | None = None, *, gripper: dict[str, Any] | None = None, **options: Any):
        self.arm = VirtualArm(arm_with(servo, **(gripper or {})), **options)
        assert self.arm.bring_up().failure is None
        self.arm.begin_with_gripper()

    @property
    def shown(self) -> np.ndarray:
        found = read_gripper(self.arm.state)
        assert found is not None
        return found

    @property
    def grip(self) -> Grip:
        return Grip(int(self.shown["grip"]))

    @property
    def trouble(self) -> GripTrouble:
        return GripTrouble(int(self.shown["trouble"]))

    @property
    def true_rad(self) -> float:
        return float(self.arm.sim.gripper_rad(self.arm.sim.now_ns))

    def known(self) -> None:
        self.arm.until(lambda: read_gripper(self.arm.state) is not None and self.grip != Grip.UNKNOWN)

    def ask(self, kind: Request, **values: Any) -> int:
        """The sequence of a request that was taken."""
        assert self.arm.ask(kind, **values) == Answer.DONE
        return int(self.arm.memory["gripper"]["sequence"])

    def over(self, sequence: int, *, at_most_s: float = 10.0) -> Grip:
        """What an order has come to."""
        self.arm.until(lambda: int(self.shown["order"]) >= sequence and self.grip != Grip.MOVING, at_most_s=at_most_s)
        return self.grip

    def go(self, angle_rad: float, effort: float = 0.0) -> Grip:
        return self.over(self.ask(Request.GRIP, value=angle_rad, effort=effort))

    def run(self, seconds: float) -> None:
        self.arm.cycles(round(seconds * 1e9 / self.arm.period_ns))

    def inject(self, *wrong: Any) -> None:
        for fault in wrong:
            self.arm.sim.inject(fault, self.arm.now_ns)


@pytest.fixture
def stage() -> Iterator[Stage]:
    stage = Stage()
    stage.known()
    yield stage
    assert stage.arm.memory["mode"] == Mode.HOLDING, "the gripper's trouble is none of the arm's"
    stage.arm.close()


# --- bytes ----------------------------------------------------------------------------------------------


def test_the_command_is_that_of_the_facts() -> None:
    """CCW 4000 rpm, acc 0, 0x0001FA00 pulses (zdt-emm-v5.md section 3), with mode 01 instead of 00."""
    command = protocol.go_to(-0x0001FA00, rpm=4000, acc=0)
    assert command == bytes.fromhex("FD 01 0F A0 00 00 01 FA 00 01 00 6B".replace(" ", ""))
    assert protocol.go_to(3200, rpm=1, acc=1)[1] == 0


def test_the_current_limit_is_that_of_the_facts() -> None:
    assert protocol.limit_current(3000) == bytes.fromhex("4566000BB86B")


def test_one_command_moves_it_and_nothing_else_is_sent_for_it(stage: Stage) -> None:
    first = len(stage.arm.sent)
    assert stage.go(0.5) == Grip.REACHED
    lines = b"".join(data for _, data in stage.arm.sent[first:]).split(b"\r")
    ours = [line for line in lines if line[1:7] == b"%06X" % ADDRESS]
    commands = [line for line in ours if line[10:12] not in (b"33", b"36", b"3A")]
    assert [line[7:12] for line in commands] == [b"008FD", b"015FD"]  # two packets of one command


# --- motions --------------------------------------------------------------------------------------------


@settings(max_examples=8, deadline=None)
@given(
    angle_deg=st.floats(0.0, 110.0),
    ratio=st.sampled_from([1.0, 4.0, 10.5]),
    direction=st.sampled_from([1, -1]),
    zero_deg=st.sampled_from([0.0, 20.0, -15.0]),
    microsteps=st.sampled_from([16, 32]),
)
def test_it_truly_goes_where_it_is_told(
    angle_deg: float, ratio: float, direction: int, zero_deg: float, microsteps: int
) -> None:
    stage = Stage({"ratio": ratio, "direction": direction, "zero_deg": zero_deg, "microsteps": microsteps})
    stage.known()
    assert stage.go(math.radians(angle_deg)) == Grip.REACHED
    stage.run(0.5)
    pulse_rad = abs(1.0 / stage.arm.arm.gripper.servo.pulses_per_rad)
    assert stage.true_rad == pytest.approx(math.radians(angle_deg), abs=pulse_rad)
    assert stage.shown["position_rad"] == pytest.approx(stage.true_rad, abs=2.0 * pulse_rad)
    stage.arm.close()


def test_it_is_measured_at_rest_and_more_often_in_motion(stage: Stage) -> None:
    def ages() -> list[float]:
        found = []
        for _ in range(240):
            stage.arm.cycle()
            found.append((stage.arm.now_ns - int(stage.shown["measured_ns"])) * 1e-9)
        return found

    assert max(ages()) < 0.3
    stage.ask(Request.GRIP, value=0.0)
    stage.run(0.1)
    in_motion = ages()[:60]
    assert max(in_motion) < 0.12
    assert float(stage.shown["velocity_rad_s"]) == pytest.approx(0.0, abs=1e-9)


def test_a_thing_between_the_fingers_is_gripped_and_held_without_tripping_the_protection(stage: Stage) -> None:
    stage.inject(faults.Thing(0.0, 40.0))
    assert stage.go(0.0) == Grip.STALLED
    assert stage.true_rad == pytest.approx(math.radians(40.0), abs=0.002)
    stage.run(10.0)
    drive = stage.arm.sim.gripper
    assert (drive.protected, drive.enabled, drive.stalled) == (False, True, False)
    assert stage.grip == Grip.STALLED
    assert stage.true_rad == pytest.approx(math.radians(40.0), abs=0.002)
    assert stage.go(OPEN_RAD) == Grip.REACHED


def test_without_the_hold_the_drive_would_let_go(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the test above rests on: a drive that goes on pushing trips its protection."""
    monkeypatch.setattr(stage.arm.gripper._drive, "hold", lambda: iter(()))
    stage.inject(faults.Thing(0.0, 40.0))
    assert stage.go(0.0) == Grip.STALLED
    stage.run(6.0)
    assert stage.arm.sim.gripper.protected
    assert stage.trouble == GripTrouble.PROTECTED


def test_a_thing_just_before_the_target_is_not_pushed_for_long() -> None:
    """Reached, as tolerances go, but the drive would push: with a gear, a degree of the joint is many of the motor."""
    stage = Stage({"ratio": 10.0})
    stage.known()
    stage.inject(faults.Thing(0.0, 0.7))
    assert stage.go(0.0) == Grip.REACHED
    stage.run(8.0)
    assert not stage.arm.sim.gripper.protected
    assert stage.grip == Grip.REACHED
    stage.arm.close()


def test_a_stop_truly_stops_it(stage: Stage) -> None:
    stage.ask(Request.GRIP, value=0.0)
    stage.run(0.4)
    before = stage.true_rad
    assert stage.over(stage.ask(Request.GRIP_STOP)) == Grip.HELD
    stopped = stage.true_rad
    assert 0.2 < stopped < before
    stage.run(1.0)
    assert stage.true_rad == stopped


def test_a_newer_order_replaces_the_one_that_runs(stage: Stage) -> None:
    first = stage.ask(Request.GRIP, value=0.0)
    stage.run(0.3)
    assert stage.grip == Grip.MOVING and int(stage.shown["order"]) == first
    assert stage.go(1.5) == Grip.REACHED
    assert stage.true_rad == pytest.approx(1.5, abs=0.002)


def test_a_shutdown_stops_it(stage: Stage) -> None:
    stage.ask(Request.GRIP, value=0.0)
    stage.run(0.4)
    assert stage.arm.gripper.moves
    stage.arm.gripper.stop()
    stage.arm.until(lambda: not stage.arm.gripper.moves and not stage.arm.gripper.busy)
    stopped = stage.true_rad
    stage.run(1.0)
    assert stage.true_rad == stopped > 0.2


@pytest.mark.parametrize("angle", [math.nan, math.inf, -0.01, OPEN_RAD + 0.01])
def test_the_control_process_refuses_what_is_out_of_range(stage: Stage, angle: float) -> None:
    assert stage.arm.ask(Request.GRIP, value=angle) == Answer.REFUSED_VALUE
    stage.run(0.5)
    assert stage.true_rad == pytest.approx(OPEN_RAD, abs=0.002)


@pytest.mark.parametrize("effort", [math.nan, math.inf, -1.0])
def test_it_refuses_an_effort_that_is_none(stage: Stage, effort: float) -> None:
    assert stage.arm.ask(Request.GRIP, value=0.5, effort=effort) == Answer.REFUSED_VALUE


def test_an_arm_without_a_gripper_knows_no_such_request() -> None:
    arm = VirtualArm.brought_up("mock")
    assert arm.ask(Request.GRIP, value=0.5) == Answer.REFUSED_UNKNOWN
    assert read_gripper(arm.state) is None
    arm.close()


# --- effort ---------------------------------------------------------------------------------------------


def test_an_effort_limits_the_current_and_is_measured() -> None:
    stage = Stage({"nm_per_ampere": 0.5})
    stage.known()
    drive = stage.arm.sim.gripper
    full_ma = drive.settings.closed_loop_ma
    stage.inject(faults.Thing(0.0, 40.0))
    sequence = stage.ask(Request.GRIP, value=0.0, effort=0.25)
    stage.run(0.5)
    assert drive.settings.closed_loop_ma == 500
    assert drive._flash.closed_loop_ma == full_ma
    assert stage.over(sequence) == Grip.STALLED
    stage.run(0.5)
    assert float(stage.shown["measured_effort"]) == pytest.approx(0.627 * 0.5)
    assert stage.go(1.0) == Grip.REACHED
    assert drive.settings.closed_loop_ma == full_ma, "no effort named is all there is"
    stage.arm.close()


def test_the_highest_effort_there_is_is_all_it_has() -> None:
    """Who wants all of it may say so with the highest float there is, which no current is."""
    stage = Stage({"nm_per_ampere": 0.5})
    stage.known()
    full_ma = stage.arm.sim.gripper.settings.closed_loop_ma
    assert stage.go(1.0, effort=0.25) == Grip.REACHED
    assert stage.go(0.5, effort=sys.float_info.max) == Grip.REACHED
    assert stage.arm.sim.gripper.settings.closed_loop_ma == full_ma
    stage.arm.close()


def test_a_spoilt_answer_is_not_what_the_limit_is_set_back_to(monkeypatch: pytest.MonkeyPatch) -> None:
    read_block, tries = zdt_talk.read_block, []

    def spoilt_at_first() -> Any:
        block = yield from read_block()
        tries.append(block)
        return replace(block, current_ma=block.current_ma ^ 0x1000) if len(tries) == 1 else block

    stage = Stage({"nm_per_ampere": 0.5})
    monkeypatch.setattr(zdt_talk, "read_block", spoilt_at_first)
    stage.known()
    assert stage.go(1.0, effort=0.25) == stage.go(0.5) == Grip.REACHED
    assert len(tries) > 2 and stage.arm.sim.gripper.settings.closed_loop_ma == tries[-1].current_ma == 3000
    stage.arm.close()


def test_a_drive_that_keeps_its_current_is_not_moved() -> None:
    stage = Stage({"nm_per_ampere": 0.5})
    stage.known()
    stage.inject(faults.KeepsSettings("gripper_joint"))
    assert stage.go(0.5, effort=0.25) == Grip.TROUBLE
    assert stage.trouble == GripTrouble.CURRENT
    assert stage.true_rad == pytest.approx(OPEN_RAD, abs=0.002)
    assert stage.go(0.5) == Grip.REACHED
    stage.arm.close()


def test_without_a_mapping_no_effort_is_obeyed_or_invented(stage: Stage) -> None:
    assert stage.go(0.5, effort=0.25) == Grip.REACHED
    assert stage.arm.sim.gripper.settings.closed_loop_ma == 3000
    assert math.isnan(float(stage.shown["measured_effort"]))


# --- what goes wrong ------------------------------------------------------------------------------------


def test_a_drive_that_is_not_there_is_said_once_and_taken_up_when_it_is() -> None:
    stage = Stage(faults=[faults.Silent("gripper_joint", 0.0, 8.0)])
    stage.known()
    assert (stage.grip, stage.trouble) == (Grip.TROUBLE, GripTrouble.SILENT)
    assert stage.go(0.5) == Grip.TROUBLE
    stage.run(3.0)
    assert len([line for line in stage.arm.told if "address 7" in line]) == 1
    stage.arm.until(lambda: stage.trouble == GripTrouble.NONE)
    assert stage.go(0.5) == Grip.REACHED
    assert stage.arm.memory["mode"] == Mode.HOLDING
    stage.arm.close()


def test_a_drive_that_goes_silent_in_motion_ends_the_motion(stage: Stage) -> None:
    sequence = stage.ask(Request.GRIP, value=0.0)
    stage.run(0.3)
    stage.inject(faults.Silent("gripper_joint", 0.0, 3.0))
    assert stage.over(sequence) == Grip.TROUBLE
    assert (stage.trouble, int(stage.shown["measured_ns"])) == (GripTrouble.SILENT, 0)
    stage.arm.until(lambda: stage.trouble == GripTrouble.NONE)
    assert stage.grip == Grip.HELD


def test_a_drive_that_lost_power_is_not_moved_before_it_is_homed(stage: Stage) -> None:
    assert stage.go(1.0) == Grip.REACHED
    stage.inject(faults.PowerLoss("gripper_joint", 0.0, 1.0))
    stage.arm.until(lambda: stage.trouble == GripTrouble.POWER_LOST)
    assert int(stage.shown["measured_ns"]) == 0, "a count from nowhere is no angle"
    before = stage.true_rad
    assert stage.go(0.2) == Grip.TROUBLE
    assert stage.true_rad == before
    assert stage.over(stage.ask(Request.GRIP_HOME), at_most_s=30.0) == Grip.REACHED
    assert stage.true_rad == pytest.approx(0.0, abs=0.01)
    assert stage.go(0.7) == Grip.REACHED
    assert stage.true_rad == pytest.approx(0.7, abs=0.002)


def test_a_homing_run_is_the_same_each_time_in_virtual_time() -> None:
    def sent() -> list[Any]:
        stage = Stage()
        stage.known()
        assert stage.over(stage.ask(Request.GRIP_HOME), at_most_s=30.0) == Grip.REACHED
        stage.arm.close()
        return list(stage.arm.sent)

    assert sent() == sent()


@pytest.mark.parametrize("cycles", [0, 12, 24, 27, 33])
def test_an_order_that_comes_amid_a_look_at_a_troubled_drive_is_not_lost(stage: Stage, cycles: int) -> None:
    stage.inject(faults.PowerLoss("gripper_joint", 0.0, 0.1))
    stage.arm.until(lambda: stage.trouble == GripTrouble.POWER_LOST)
    stage.arm.cycles(cycles)
    assert stage.over(stage.ask(Request.GRIP_HOME), at_most_s=30.0) == Grip.REACHED


def test_power_lost_amid_the_homing_run_is_no_reference(stage: Stage) -> None:
    stage.inject(faults.PowerLoss("gripper_joint", 0.0, 0.5))
    stage.arm.until(lambda: stage.trouble == GripTrouble.POWER_LOST)
    sequence = stage.ask(Request.GRIP_HOME)
    stage.run(0.3)
    stage.inject(faults.PowerLoss("gripper_joint", 0.0, 0.02))
    assert stage.over(sequence, at_most_s=70.0) == Grip.TROUBLE
    assert stage.trouble == GripTrouble.NOT_HOMED
    stage.run(2.0)
    assert stage.trouble == GripTrouble.POWER_LOST


@pytest.mark.parametrize("kind", [Request.GRIP, Request.GRIP_HOME])
def test_a_person_who_stops_the_arm_stops_its_gripper_too(stage: Stage, kind: Request) -> None:
    stage.ask(kind, value=0.0)
    stage.run(0.4)
    stage.arm.stop()
    stage.arm.until(lambda: stage.grip == Grip.HELD)
    stopped = stage.true_rad
    for refused in (Request.GRIP, Request.GRIP_HOME):
        assert stage.arm.ask(refused, value=0.5) == Answer.REFUSED_HELD
    stage.run(2.0)
    assert stage.true_rad == stopped > 0.1
    assert stage.arm.ask(Request.GRIP_STOP) == Answer.DONE
    stage.arm.resume()
    assert stage.go(1.0) == Grip.REACHED


@pytest.mark.parametrize("cycles", range(1, 24))
def test_a_person_stops_a_gripper_that_is_just_about_to_set_off(stage: Stage, cycles: int) -> None:
    """Its drive is asked this and that before it moves, and meanwhile nothing is shown to move."""
    stage.ask(Request.GRIP, value=0.0)
    stage.arm.cycles(cycles)
    stage.arm.stop()
    stage.run(1.0)
    stopped = stage.true_rad
    stage.run(1.0)
    assert stage.true_rad == stopped > 0.8
    stage.arm.resume()


@pytest.mark.parametrize("cycles", range(1, 24))
def test_a_stop_also_ends_an_order_that_came_just_before_it_and_is_not_taken_yet(stage: Stage, cycles: int) -> None:
    """While the drive is still asked about the one before."""
    stage.ask(Request.GRIP, value=0.8)
    stage.arm.cycles(cycles)
    stage.ask(Request.GRIP, value=0.0)
    stage.arm.stop()
    stage.run(1.0)
    stopped = stage.true_rad
    stage.arm.resume()
    stage.run(1.0)
    assert stage.true_rad == stopped > 0.7


@pytest.mark.parametrize("stops", [1, 3])
def test_the_first_command_after_a_stop_and_a_resume_is_obeyed(stage: Stage, stops: int) -> None:
    """Its number used to be that of the stop, so it was told as obeyed and forgotten."""
    gripper = stage.arm.arm.gripper
    stage.ask(Request.GRIP, value=gripper.upper_rad)
    stage.run(0.15)
    for _ in range(stops):
        stage.arm.stop()
        stage.run(0.05)
    stage.arm.resume()
    target_rad = gripper.lower_rad + 0.1 * (gripper.upper_rad - gripper.lower_rad)
    stage.ask(Request.GRIP, value=target_rad)
    stage.run(5.0)
    assert stage.true_rad == pytest.approx(target_rad, abs=0.05)


def test_what_is_gripped_stays_gripped_when_a_person_stops_the_arm(stage: Stage) -> None:
    stage.inject(faults.Thing(0.0, 40.0))
    assert stage.go(0.0) == Grip.STALLED
    order, held_rad = int(stage.shown["order"]), stage.true_rad
    stage.arm.stop()
    stage.run(2.0)
    assert (int(stage.shown["order"]), stage.grip, stage.true_rad) == (order, Grip.STALLED, held_rad)
    stage.arm.resume()


def test_a_homing_run_ends_with_a_stop(stage: Stage) -> None:
    home = stage.ask(Request.GRIP_HOME)
    stage.run(0.4)
    assert stage.arm.sim.gripper.homing_now
    assert stage.over(stage.ask(Request.GRIP_STOP)) == Grip.HELD
    assert home < int(stage.shown["order"])
    assert not stage.arm.sim.gripper.homing_now
    stopped = stage.true_rad
    stage.run(1.0)
    assert stage.true_rad == stopped > 0.1


def test_a_protected_drive_is_cleared_by_the_next_command_alone(stage: Stage) -> None:
    stage.inject(faults.Protection("gripper_joint", 0.0))
    stage.arm.until(lambda: stage.trouble == GripTrouble.PROTECTED)
    stage.run(3.0)
    assert stage.arm.sim.gripper.protected
    assert stage.arm.now_ns - int(stage.shown["measured_ns"]) < 300_000_000, "its count still means an angle"
    assert stage.go(0.5) == Grip.REACHED
    assert not stage.arm.sim.gripper.protected


def test_a_protection_that_cannot_be_cleared_says_so(stage: Stage) -> None:
    stage.inject(faults.Protection("gripper_joint", 0.0, 60.0, "temperature"))
    assert stage.go(0.5) == Grip.TROUBLE
    assert stage.trouble == GripTrouble.PROTECTED


def test_a_disabled_drive_is_enabled_by_the_next_command(stage: Stage) -> None:
    stage.inject(faults.Disabled("gripper_joint", 0.0))
    stage.arm.until(lambda: stage.trouble == GripTrouble.DISABLED)
    assert stage.go(0.5) == Grip.REACHED


def test_a_drive_that_refuses_says_so(stage: Stage) -> None:
    stage.inject(faults.Refusing("gripper_joint", 0.0))
    assert stage.go(0.5) == Grip.TROUBLE
    assert stage.trouble == GripTrouble.REFUSED
    stage.run(1.0)
    assert stage.trouble == GripTrouble.REFUSED, "until the next command"


@pytest.mark.parametrize(
    ("wrong", "trouble"),
    [
        (lambda drive: setattr(drive, "foreign", True), GripTrouble.FIRMWARE),
        (lambda drive: drive._store(0, _with(drive, microstep=32)), GripTrouble.MICROSTEPS),
        (lambda drive: setattr(drive, "settings", _with(drive, checksum_mode=1)), GripTrouble.CHECKSUM),
        (lambda drive: drive.slip(drive._now_ns, 40_000), GripTrouble.OUTSIDE),
    ],
)
def test_a_drive_that_would_go_elsewhere_is_not_moved(wrong: Callable[[Any], Any], trouble: GripTrouble) -> None:
    stage = Stage()
    wrong(stage.arm.sim.gripper)
    stage.known()
    assert stage.trouble == trouble
    assert stage.go(0.5) == Grip.TROUBLE
    stage.run(1.0)
    assert stage.true_rad == pytest.approx(OPEN_RAD, abs=0.002)
    assert stage.arm.memory["mode"] == Mode.HOLDING
    stage.arm.close()


def _with(drive: Any, **changes: Any) -> Any:
    return replace(drive.settings, **changes)


@pytest.mark.parametrize("seed", range(3))
def test_lost_and_spoilt_answers_delay_it_and_no_more(seed: int) -> None:
    stage = Stage(seed=seed, faults=[faults.LostReplies(0.08, 0.0, "gripper_joint")])
    stage.inject(faults.WrongChecksums(0.05, 0.0, "gripper_joint"), faults.Bels(0.02))
    stage.known()
    for angle in (0.3, 1.7, 0.9):
        assert stage.go(angle) == Grip.REACHED
        assert stage.true_rad == pytest.approx(angle, abs=TOLERANCE_RAD)
    stage.arm.close()


# --- beside the arm -------------------------------------------------------------------------------------


def test_it_moves_while_the_arm_does(stage: Stage) -> None:
    goal = stage.arm.play("scale_1_0")
    sequence = stage.ask(Request.GRIP, value=0.0)
    assert stage.over(sequence) == Grip.REACHED
    assert stage.arm.end_of(goal) == Outcome.SUCCEEDED


def test_it_goes_on_during_a_bring_up_and_in_a_fault(stage: Stage) -> None:
    stage.inject(faults.Disabled("joint3", 0.0))
    stage.arm.until(lambda: stage.arm.memory["mode"] == Mode.FAULT)
    assert stage.go(0.4) == Grip.REACHED
    sequence = stage.ask(Request.GRIP, value=1.6)
    assert stage.arm.bring_up(clears_protection=True).failure is None
    assert stage.over(sequence) == Grip.REACHED
    assert stage.true_rad == pytest.approx(1.6, abs=0.002)


def test_its_frames_keep_within_what_the_budget_says(stage: Stage) -> None:
    counters = stage.arm.state.record["counters"]
    stage.ask(Request.GRIP, value=0.0)
    stage.run(0.2)
    before, frames_before = int(counters["bits_on_bus"]), stage.arm.now_ns
    stage.run(0.8)
    load = (int(counters["bits_on_bus"]) - before) / ((stage.arm.now_ns - frames_before) * 1e-9) / 500_000
    found = budget(stage.arm.arm)
    assert found.fits and load <= found.bus_load


def test_a_command_goes_into_the_ring_as_a_whole_or_not_at_all() -> None:
    """Another conversation may speak next, and a drive takes no other frame between the packets of a command."""
    arm = VirtualArm(arm_with())
    talk = Conversation(arm.arm, arm.port, arm.now_ns, fault=Fault.NONE)
    first, second = split_packets(ADDRESS, protocol.go_to(3200, rpm=10, acc=1))
    talk._outbox = [(first, True), (second, False)]
    while arm.port.room() > 1:
        arm.port.post(SEND, frame=Frame(0x100, protocol.ASK_STATUS))
    talk._flush()
    assert (arm.port.room(), len(talk._outbox)) == (1, 2)
    arm.cycle()
    room = arm.port.room()
    talk._flush()
    assert (arm.port.room(), len(talk._outbox)) == (room - 2, 0)
    arm.close()


def test_each_conversation_hears_its_own_drives(stage: Stage) -> None:
    stage.arm.gripper = None
    stage.arm.port.received(of_gripper=True), stage.arm.port.received()
    for address in (ADDRESS, 3):
        stage.arm.port.post(SEND, frame=Frame(address << 8, protocol.ASK_FIRMWARE))
    stage.run(0.1)
    assert {frame.id for frame in stage.arm.port.received(of_gripper=True)} == {ADDRESS << 8}
    others = {frame.id >> 8 for frame in stage.arm.port.received()}
    assert ADDRESS not in others and 3 in others
    assert stage.arm.port.received(of_gripper=True) == stage.arm.port.received() == []


# --- the judge ------------------------------------------------------------------------------------------


@given(
    target=st.floats(-2.0, 2.0),
    speed=st.floats(0.01, 10.0),
    stall_s=st.floats(0.1, 2.0),
    start=st.floats(-2.0, 2.0),
    step_s=st.floats(0.005, 0.1),
)
def test_a_steady_motion_reaches_its_target_and_never_stalls(
    target: float, speed: float, stall_s: float, start: float, step_s: float
) -> None:
    judge = GripJudge(target, 0.02, stall_ns(stall_s, 0.02, speed), start, 0)
    position, now_s = start, 0.0
    for _ in range(100_000):
        grip = judge.judge(round(now_s * 1e9), position)
        if grip != Grip.MOVING:
            break
        now_s += step_s
        way = target - position
        position += math.copysign(min(abs(way), speed * step_s), way)
    assert grip == Grip.REACHED
    assert abs(position - target) <= 0.02


@given(held=st.floats(0.03, 1.0), wiggle=st.floats(0.0, 0.0049), stall_s=st.floats(0.1, 2.0))
def test_standing_elsewhere_is_a_stall_after_the_time_and_not_before(
    held: float, wiggle: float, stall_s: float
) -> None:
    judge = GripJudge(0.0, 0.02, round(stall_s * 1e9), held, 0)
    now_ns, number = 0, 0
    while judge.judge(now_ns, held + wiggle * (number % 2)) == Grip.MOVING:
        now_ns += 10_000_000
        number += 1
    assert round(stall_s * 1e9) <= now_ns <= round(stall_s * 1e9) + 10_000_000


def test_a_gripper_is_there_when_two_readings_in_a_row_lie_within_the_tolerance() -> None:
    judge = GripJudge(1.0, 0.25, 10**9, 0.0, 0)
    assert judge.judge(1, 0.75) == Grip.MOVING
    assert judge.judge(2, 0.7499) == Grip.MOVING
    assert judge.judge(3, 1.25) == Grip.MOVING
    assert judge.judge(4, 1.25) == Grip.REACHED


def test_moving_by_more_than_a_quarter_of_the_tolerance_is_no_standing() -> None:
    judge = GripJudge(1.0, 0.25, 1_000, 0.0, 0)
    assert judge.judge(999, 0.0625) == Grip.MOVING
    assert judge.judge(1_000, 0.0625) == Grip.STALLED
    judge = GripJudge(1.0, 0.25, 1_000, 0.0, 0)
    assert judge.judge(999, -0.0626) == Grip.MOVING
    assert judge.judge(1_998, -0.0626) == Grip.MOVING
    assert judge.judge(1_999, -0.0626) == Grip.STALLED


@pytest.mark.parametrize(("speed", "expected_s"), [(1.0, 0.5), (0.02, 0.5), (0.01, 1.0)])
def test_at_a_crawl_it_takes_its_time_to_be_seen_moving(speed: float, expected_s: float) -> None:
    """A quarter of the tolerance of 0.02 rad, twice."""
    assert stall_ns(0.5, 0.02, speed) == round(expected_s * 1e9)
