"""Faults in virtual time: what is latched, what the other joints do, and the way back."""

import numpy as np
import pytest
from observer import frames_sent, motion_frames
from virtual import VirtualArm, recorded_goal

from config.frames import frame_bits
from rtloop.cycle import step
from rtloop.drives.zdt_ask import split_packets
from rtloop.service.port import SEND
from rtloop.wire import outgoing, received
from shm.recording import SENT, read_recording
from shm.words import Answer, DriveStatus, Fault, Mode, Outcome, Request, Slowed, Unreferenced
from sim.faults import CorruptBytes, CountSlip, LostReplies, PowerLoss, Protection, Silent, Stall


def test_a_silent_drive_is_braked_then_latched() -> None:
    """The age ladder: brake on the path, then a fault that names the joint; the others come to rest."""
    arm = VirtualArm.amid("large")
    arm.sim.inject(Silent("joint2", at_s=0.0), since_ns=arm.now_ns)
    began_ns = arm.now_ns
    arm.until(lambda: arm.is_slowed(Slowed.LATE_DRIVE))
    assert arm.now_ns - began_ns <= 6 * arm.period_ns
    assert arm.memory["mode"] == Mode.EXECUTING
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert arm.now_ns - began_ns <= 150_000_000
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.STALE_READING, 1)
    assert arm.outcome(arm.goal) == Outcome.FAULT
    assert arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.SILENT
    since = len(arm.sent)
    arm.cycles(200)
    assert motion_frames(frames_sent(arm.sent[since:]), 2, 0) == 0
    assert not np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"])
    arm.close()


@pytest.mark.parametrize(
    ("cause", "named"),
    [
        ("stall", DriveStatus.STALLED),
        ("temperature", DriveStatus.OVER_TEMPERATURE),
        ("current", DriveStatus.OVER_CURRENT),
    ],
)
def test_the_fault_of_a_drive_that_trips_names_the_cause(cause: str, named: DriveStatus) -> None:
    """A ZDT drive is asked for it (3B) from the moment on at which it is seen to have tripped, and never before."""
    arm = VirtualArm.amid("large")
    question = b"T0000040023B6B\r"
    assert not any(question in data for _, data in arm.sent[-40:])
    arm.sim.inject(Protection("joint4", 0.0, cause=cause), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.DRIVE_FAULT, 3)
    reasons = DriveStatus.STALLED | DriveStatus.OVER_TEMPERATURE | DriveStatus.OVER_CURRENT
    assert (
        DriveStatus(int(arm.memory["fault"]["value"])) & (reasons | DriveStatus.PROTECTED)
        == named | DriveStatus.PROTECTED
    )
    assert sum(question in data for _, data in arm.sent) > 0
    arm.close()


def test_a_sound_drive_is_never_asked_why_it_has_tripped() -> None:
    """It would cost the bus 200 bits in each cycle."""
    arm = VirtualArm.at_start_of("large")
    brought_up = len(arm.sent)
    assert arm.end_of(arm.play("large")) == Outcome.SUCCEEDED
    assert not any(b"0023B6B\r" in data for _, data in arm.sent[brought_up:])
    arm.close()


def test_a_short_silence_only_slows_the_arm() -> None:
    arm = VirtualArm.amid("large")
    arm.sim.inject(Silent("joint2", at_s=0.0, until_s=0.05), since_ns=arm.now_ns)
    assert arm.end_of(arm.goal) == Outcome.SUCCEEDED
    assert arm.state.record["counters"]["stale_reads"] > 0
    arm.close()


def test_lost_replies_do_not_stop_the_arm() -> None:
    arm = VirtualArm.amid("large")
    arm.sim.inject(LostReplies(0.1), since_ns=arm.now_ns)
    assert arm.end_of(arm.goal) == Outcome.SUCCEEDED
    arm.close()


def test_a_drive_that_lost_power_gets_its_stop_and_no_motion_frame() -> None:
    """It boots enabled and counts from zero: the next absolute target would be many turns away."""
    arm = VirtualArm.amid("large")
    arm.sim.inject(PowerLoss("joint2", at_s=0.0, off_s=0.03), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    since = len(arm.sent)
    assert arm.memory["fault"]["joint"] == 1
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0
    arm.cycles(300)
    assert motion_frames(frames_sent(arm.sent[since:]), 2, 0) == 0
    assert any(b"T000002004FE98006B" in data for _, data in arm.sent)
    moved = [arm.sim.true_position_rad(1, arm.now_ns - 1)]
    arm.cycles(100)
    assert arm.sim.true_position_rad(1, arm.now_ns - 1) == moved[0]

    # clearing the fault brings the arm up again, but never references
    assert arm.clear_fault().failure is None
    assert any("The drive of joint2 may have lost power" in sentence for sentence in arm.told)
    assert arm.memory["mode"] == Mode.HOLDING
    goal = arm.play("large")
    assert arm.end_of(goal) == Outcome.REFUSED_UNREFERENCED
    assert arm.result(goal)["joint"] == 1
    arm.close()


@pytest.mark.parametrize("flags", [0x09, 0x00], ids=["protection tripped", "disabled"])
def test_a_drive_that_reports_a_fault_of_its_own_is_named_and_not_led(flags: int) -> None:
    """Twice in a row, since one garbled digit is no report."""
    arm = VirtualArm.amid("large")
    while arm.memory["buses"][0]["status_turn"] != 5:  # joint3's own answer is not due then
        arm.cycle()
    since = len(arm.sent)
    line = f"T0000030033A{flags:02X}6B\r".encode()
    received.push(arm.loop[0]["buses"][0], arm.now_ns, np.frombuffer(line * 2, np.uint8), 2 * len(line))
    arm.cycle()
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.DRIVE_FAULT, 2)
    assert arm.outcome(arm.goal) == Outcome.FAULT
    assert motion_frames(frames_sent(arm.sent[since:]), 3, 0) == 0
    arm.close()


def test_a_held_shaft_is_a_following_error() -> None:
    arm = VirtualArm.amid("large")
    arm.sim.inject(Stall("joint1", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.FOLLOWING_ERROR, 0)
    assert abs(arm.memory["fault"]["value"]) > arm.memory["fault"]["limit"]
    arm.close()


def test_a_vanished_wire_is_a_fault() -> None:
    arm = VirtualArm.amid("large")
    received.close(arm.loop[0]["buses"][0], 5)
    arm.cycle()
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["value"]) == (Fault.WIRE, 5.0)
    assert arm.outcome(arm.goal) == Outcome.FAULT
    arm.close()


def test_an_arm_that_lost_power_before_the_start_is_unreferenced() -> None:
    arm = VirtualArm.brought_up(homed=False)
    assert (
        sum("joint1, joint2, joint3, joint4, joint5 and joint6 may have lost power" in told for told in arm.told) == 1
    )
    goal = arm.play("small")
    assert arm.end_of(goal) == Outcome.REFUSED_UNREFERENCED
    arm.cycles(50)
    assert not any(b"FD" in data for _, data in arm.sent)
    arm.close()


def test_a_drive_that_does_not_answer_is_named() -> None:
    arm = VirtualArm(faults=[Silent("joint4", at_s=0.0)])
    failure = arm.bring_up().failure
    assert failure is not None
    assert failure.joint == 3
    assert "joint4 (address 4) does not answer" in str(failure)
    assert arm.memory["fault"]["code"] == Fault.BRING_UP
    arm.close()


def test_old_firmware_is_told_apart() -> None:
    carries_out_a_goal(VirtualArm(firmware="old"))


def carries_out_a_goal(arm: VirtualArm) -> None:
    """Bring it up, play a small goal, close it."""
    assert arm.bring_up().failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    goal = arm.play("small")
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    arm.close()


def test_old_firmware_that_lost_power_stays_unreferenced_when_the_fault_is_cleared() -> None:
    """It has no flag for lost power: what the loop noticed itself must not be forgotten by a clear."""
    arm = VirtualArm.amid("large", firmware="old")
    arm.sim.inject(PowerLoss("joint2", at_s=0.0, off_s=0.03), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.until(lambda: arm.running_goal == 0)
    arm.cycles(60)
    assert arm.clear_fault().failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0
    newer = arm.play("large")
    assert arm.end_of(newer) == Outcome.REFUSED_UNREFERENCED
    arm.close()


@pytest.mark.parametrize("after", [1, 8, 20])
def test_a_fault_is_not_cleared_while_the_arm_still_moves(after: int) -> None:
    arm = VirtualArm.amid("large")
    arm.writer.announce(2**60)  # a corrupt word: latched, the arm stops on its path
    arm.cycles(after)
    assert arm.memory["fault"]["code"] == Fault.COMMAND_RING
    arm.writer.announce(arm.goal)
    sequence = arm.request(Request.CLEAR_FAULT)
    arm.cycle()
    moving = bool(np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"]))
    answer = arm.reader.snapshot()["answers"][sequence % 16]["answer"]
    assert answer == (Answer.REFUSED_MOVING if moving else Answer.DONE)
    arm.until(lambda: not np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"]) and arm.running_goal == 0)
    assert arm.clear_fault().failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    assert arm.memory["fault"]["code"] == Fault.NONE
    arm.close()


def test_a_held_joint_is_not_rushed_at_when_it_comes_free() -> None:
    """The error's part of the speed is limited, and a faulted arm at rest is not led at all."""
    arm = VirtualArm.amid("large")
    arm.sim.inject(Stall("joint1", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.until(lambda: not np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"]))
    limit = arm.arm.joints[0].motor_rpm
    speeds = [
        int(frame[14:18], 16)
        for _, data in arm.sent
        for frame in data.split(b"\r")
        if frame.startswith(b"T000001008FD")
    ]
    assert max(speeds) <= 1.06 * limit
    arm.cycles(2)
    since = len(arm.sent)
    arm.cycles(60)
    assert all(motion_frames(frames_sent(arm.sent[since:]), address, 0) == 0 for address in range(1, 7))
    arm.close()


def test_one_garbled_digit_neither_faults_nor_is_published() -> None:
    arm = VirtualArm.amid("large")
    for line in (b"T00000100736002FFFFFFF6B\r", b"T000001003" + b"3A" + b"08" + b"6B\r"):
        before = arm.loop[0]["axes"][0]["measured"]["position_rad"]
        data = np.frombuffer(line, np.uint8)
        received.push(arm.loop[0]["buses"][0], arm.now_ns, data, len(data))
        arm.cycle()
        assert arm.memory["fault"]["code"] == Fault.NONE
        assert abs(arm.loop[0]["axes"][0]["measured"]["position_rad"] - before) < 0.05
    assert arm.end_of(arm.goal) == Outcome.SUCCEEDED
    arm.close()


def test_corrupted_bytes_do_not_stop_the_arm() -> None:
    arm = VirtualArm.amid("large")
    arm.sim.inject(CorruptBytes(0.001), since_ns=arm.now_ns)
    assert arm.end_of(arm.goal) == Outcome.SUCCEEDED
    assert arm.state.record["counters"]["wire_errors"] > 0
    arm.close()


def test_a_count_that_truly_jumps_loses_the_reference() -> None:
    arm = VirtualArm.amid("large")
    arm.sim.inject(CountSlip("joint1", 0.0, deg=40.0), since_ns=arm.now_ns)
    arm.cycles(3)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.REFERENCE_LOST, 0)
    assert arm.loop[0]["axes"][0]["reference"]["unreferenced_reason"] == Unreferenced.POSITION_JUMP
    arm.close()


def test_frames_the_wire_did_not_take_are_not_sent_late() -> None:
    """What is left over is at most the command that is half sent; newer frames say it better."""
    arm = VirtualArm.amid("large")
    arm.now_ns += arm.period_ns
    arm.listen(arm.now_ns)
    arm.writer.beat(arm.now_ns)
    step(arm.loop[0], arm.state.array[0], arm.now_ns)  # a cycle of whose first line five characters are taken
    stuck = int(arm.memory["buses"][0]["outgoing"]["length"])
    outgoing.took(arm.loop[0], arm.state.array[0], arm.loop[0]["buses"][0], 5)
    arm.now_ns += arm.period_ns
    arm.listen(arm.now_ns)
    arm.writer.beat(arm.now_ns)
    step(arm.loop[0], arm.state.array[0], arm.now_ns)
    count = int(arm.loop[0]["buses"][0]["outgoing"]["length"])
    lines = arm.loop[0]["buses"][0]["outgoing"]["bytes"][:count].tobytes().split(b"\r")
    firsts = [line for line in lines if line.startswith(b"T000002008FD")]
    assert len(firsts) == 1
    assert 0 < arm.state.record["counters"]["bytes_unsent"] < stuck
    arm.memory["buses"][0]["outgoing"]["length"] = 0
    arm.close()


class Deaf(VirtualArm):
    """An arm whose wire takes nothing (EAGAIN, ENOBUFS) for some cycles."""

    deaf_cycles = 0

    def write(self, data: bytes) -> None:
        if self.deaf_cycles > 0:
            self.deaf_cycles -= 1
            self.taken(0)
        else:
            super().write(data)


@pytest.mark.parametrize("cycles", [0, 1, 3, 8])
def test_a_stop_command_the_wire_does_not_take_is_given_again(cycles: int) -> None:
    arm = Deaf.amid("large", 60)
    arm.sim.inject(CountSlip("joint3", 0.0, deg=20.0), since_ns=arm.now_ns)
    arm.until(lambda: bool(arm.loop[0]["axes"][2]["checks"]["suspect"]), at_most_s=0.1)
    since = len(arm.sent)
    arm.deaf_cycles = cycles
    arm.cycles(30)
    assert arm.memory["fault"]["code"] == Fault.REFERENCE_LOST
    stops = [frame for frame in frames_sent(arm.sent[since:]) if frame.data[:2] == b"\xfe\x98"]
    assert [frame.drive for frame in stops[:3]] == [3, 3, 3]  # more follow once the arm stands
    arm.close()


def test_only_what_the_wire_took_is_recorded_as_sent() -> None:
    arm = Deaf.brought_up("episode1")
    counters = arm.state.record["counters"]

    def recorded() -> int:
        frames = read_recording(arm.state).frames
        return int(np.count_nonzero(frames["head"] & SENT))

    before = recorded()
    arm.cycle()
    assert recorded() == before + 7
    before, bits, heard = recorded(), int(counters["bits_on_bus"]), int(counters["frames_received"])
    arm.deaf_cycles = 2
    arm.cycles(2)
    assert recorded() == before
    answers = int(counters["frames_received"]) - heard
    assert int(counters["bits_on_bus"]) - bits <= answers * frame_bits(True, 7)
    arm.close()


def test_the_slip_allowance_after_a_long_gap_is_bounded_and_forgotten() -> None:
    arm = VirtualArm.amid("large")
    arm.cycle(1200)
    assert arm.loop[0]["axes"]["tracking"]["slip_rad"][:6].max() <= 0.1 * 10.5
    arm.until(lambda: arm.memory["motion"]["resync_ns"] == 0)
    assert not np.any(arm.loop[0]["axes"]["tracking"]["slip_rad"][:6])
    arm.close()


def test_acknowledgements_are_turned_off_in_volatile_memory_only() -> None:
    arm = VirtualArm.brought_up()
    writes = [data for _, data in arm.sent if b"848D1" in data]
    assert writes
    assert all(b"848D100" in data for data in writes)
    before = len(arm.sent)
    arm.memory["mode"] = Mode.FAULT
    arm.bring_up()  # nothing differs any more, so nothing is written
    assert not any(b"848D1" in data for _, data in arm.sent[before:])
    arm.close()


def test_an_echoing_adapter_changes_nothing() -> None:
    """Own frames that come back share their ids with replies."""
    goal = recorded_goal("small")
    arm = VirtualArm(start_rad=goal["joints"][0, :, 0], echo=True)
    carries_out_a_goal(arm)


def test_a_silent_adapter_is_enough() -> None:
    """The original canable firmware answers nothing at all."""
    goal = recorded_goal("small")
    arm = VirtualArm(start_rad=goal["joints"][0, :, 0], dialect="canable")
    carries_out_a_goal(arm)


@pytest.mark.parametrize("request_kind", [Request.CLEAR_FAULT])
def test_there_is_nothing_to_clear_without_a_fault(virtual_arm, request_kind: Request) -> None:
    arm = virtual_arm("mock")
    sequence = arm.request(request_kind)
    arm.cycle()
    assert arm.reader.snapshot()["answers"][sequence % 16]["answer"] == Answer.REFUSED_MODE


def test_the_drives_wait_for_a_coasting_arm_to_stand() -> None:
    """A loop killed in mid-motion and started at once adopts the drives' own targets, without a jump."""
    arm = VirtualArm.amid("large")
    arm.now_ns += 20_000_000  # the drives brake by their own ramp
    again = arm.next_process()
    assert again.bring_up().failure is None
    again.cycles(60)
    for joint, config in enumerate(arm.arm.joints):
        commanded = again.loop[0]["axes"][joint]["commanded"]["position_rad"]
        assert commanded == pytest.approx(again.sim.true_position_rad(joint, again.sim.now_ns - 1), abs=1e-3)
        assert again.loop[0]["axes"][joint]["reference"]["referenced"] == 1
        assert config.lower_rad <= commanded <= config.upper_rad
    arm.close()


def test_packets_of_a_command_leave_together_however_slowly_they_were_put_in(virtual_arm) -> None:
    """A drive refuses a command whose packets have another frame between them (found on a busy machine)."""
    arm = virtual_arm()
    packets = split_packets(1, b"\x48\xd1\x00" + bytes(28) + b"\x6b")
    for number, frame in enumerate(packets):
        before = len(arm.sent)
        arm.port.post(SEND, frame=frame, joined=number < len(packets) - 1)
        arm.cycle()
        written = b"".join(data for _, data in arm.sent[before:])
        last = number == len(packets) - 1
        assert [f"T{p.id:08X}{len(p.data)}{p.data.hex().upper()}".encode() in written for p in packets] == [last] * 5
