"""Drives that send their positions by themselves (`bus.positions: reported`), in virtual time."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from observer import frames_sent, motion_frames, truth_of
from virtual import VirtualArm, recorded_goal

from config.budget import budget
from config.loader import load_arm
from rtloop.dialogues.shutdown import ShutdownDialogue
from rtloop.drives import zdt_protocol
from rtloop.drives.zdt_ask import addressed
from rtloop.offline.calibration.zdt import Drive
from rtloop.offline.one_drive import OneDrive
from rtloop.offline.settings.session import Session
from shm.words import Answer, Fault, Mode, Outcome, Request, Slowed
from sim.bus import Frame
from sim.faults import DuplicateReplies, LateReplies, LostReplies, PowerLoss, SerialBlocked, Silent

REPORTED = {"bus": {"positions": "reported"}}
ASKS_POSITION = b"236 6B".replace(b" ", b"")
NO_MORE_REPORTS = zdt_protocol.report_position(0)


def reporting(goal: str = "large", *, rate_hz: float = 120.0, up: bool = True, **options: object) -> VirtualArm:
    overrides = REPORTED | {"control": {"rate_hz": rate_hz}}
    start_rad = recorded_goal(goal)["joints"][0, :, 0]
    arm = VirtualArm(load_arm("episode1", overrides=overrides), start_rad=start_rad, **options)
    if up:
        assert arm.bring_up().failure is None
    return arm


@pytest.fixture
def moving() -> Iterator[VirtualArm]:
    """An arm a second into a recorded goal."""
    arm = reporting()
    arm.goal = arm.play("large")
    arm.cycles(120)
    assert arm.memory["mode"] == Mode.EXECUTING
    yield arm
    arm.close()


def reports(arm: VirtualArm, cycles: int = 60) -> list[int]:
    """Positions that each drive sends unasked meanwhile."""
    before = [arm.port.unasked(joint) for joint in range(6)]
    arm.cycles(cycles)
    return [arm.port.unasked(joint) - was for joint, was in enumerate(before)]


def end_reports(arm: VirtualArm, joint: int) -> None:
    """Somebody else on the bus tells the drive to cease."""
    arm.sim.drives[joint].receive(arm.sim.now_ns, Frame((joint + 1) << 8, NO_MORE_REPORTS))


# --- as it should be


@pytest.mark.parametrize(("name", "clock"), [("large", 0.995), ("scale_1_0", 1.0), ("near_limits_high", 1.005)])
def test_goals_run_on_reports_alone(name: str, clock: float) -> None:
    """No position is asked for once reports come, whatever the drives' clocks say (CAN lets them differ by 0.5 %)."""
    arm = reporting(name, up=False)
    for number, drive in enumerate(arm.sim.drives):
        drive.report_clock = clock + 1e-4 * number
    assert arm.bring_up().failure is None
    arm.cycles(5)
    since = len(arm.sent)
    busy_ns, began_ns = arm.sim.bus.busy_ns, arm.sim.now_ns
    assert arm.end_of(arm.play(name)) == Outcome.SUCCEEDED
    assert not any(ASKS_POSITION in data for _, data in arm.sent[since:])
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.state.record["counters"]["stale_reads"] == 0
    load = (arm.sim.bus.busy_ns - busy_ns) / (arm.sim.now_ns - began_ns)
    assert 0.5 * budget(arm.arm).bus_load < load <= budget(arm.arm).bus_load
    arm.close()


def test_positions_are_stamped_when_the_encoder_was_read() -> None:
    """A report waits for the bus at most as long as the frames of a cycle take: those of joint6, last in priority."""
    arm = reporting("near_limits_high")
    goal = arm.play("near_limits_high")
    late_s = [0.0] * 6
    while arm.outcome(goal) == Outcome.NONE:
        arm.cycle()
        for joint in range(6):
            axis = arm.loop[0]["axes"][joint]
            assert arm.now_ns - int(axis["measured"]["time_ns"]) < 2 * arm.period_ns
            position_rad, velocity_rad_s = arm.sim.truth(joint, np.array([int(axis["measured"]["time_ns"])]))
            if abs(velocity_rad_s[0]) > 0.1:
                late = abs((float(axis["measured"]["position_rad"]) - position_rad[0]) / velocity_rad_s[0])
                late_s[joint] = max(late_s[joint], late)
    assert max(late_s) < budget(arm.arm).bits_per_cycle / arm.arm.bus.bitrate
    assert late_s[0] < 0.001
    arm.close()


@pytest.mark.parametrize(("rate_hz", "period_ms"), [(120.0, 9), (100.0, 11), (50.0, 21)])
def test_drives_are_told_the_first_whole_millisecond_longer_than_a_cycle(rate_hz: float, period_ms: int) -> None:
    arm = reporting(rate_hz=rate_hz)
    told = f"T0000010061118360{period_ms:03X}6B\r".encode()
    assert any(told in data for _, data in arm.sent)
    heard = reports(arm, 100)
    assert all(abs(count - 100 * arm.period_ns / (period_ms * 1e6)) <= 1 for count in heard)
    arm.close()


def test_an_acknowledgement_without_a_code_is_one() -> None:
    arm = reporting(up=False)
    for drive in arm.sim.drives:
        drive.bare_report_ack = True
    assert arm.bring_up().failure is None
    assert min(reports(arm)) > 50
    arm.close()


def test_positions_are_told_while_the_arm_is_led_by_hand() -> None:
    arm = reporting()
    assert arm.ask(Request.FREE) == Answer.DONE
    assert arm.release().failure is None
    assert min(reports(arm)) > 50
    assert arm.ask(Request.ENABLE) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up(clears_protection=True).failure is None
    assert arm.end_of(arm.play("large")) == Outcome.SUCCEEDED
    arm.close()


# --- who cannot, who has not, who still does


def test_firmware_that_cannot_report_is_refused() -> None:
    arm = reporting(up=False, firmware="old")
    failure = arm.bring_up().failure
    assert failure is not None
    assert "does not send its position by itself" in str(failure)
    assert "set bus.positions to polled" in str(failure)
    arm.close()


def test_one_drive_that_cannot_report_is_named() -> None:
    arm = reporting(up=False)
    del arm.sim.drives[3]._commands[0x11]
    failure = arm.bring_up().failure
    assert failure is not None
    assert failure.joint == 3
    assert "The drive of joint4 (firmware 2.0.0) does not send its position by itself" in str(failure)
    arm.close()


def test_a_drive_that_agrees_and_does_not_report_is_named() -> None:
    arm = reporting(up=False)
    arm.sim.drives[1].report_clock = 1e6
    failure = arm.bring_up().failure
    assert failure is not None
    assert "(firmware 2.0.0) was told to send its position every 9 ms, but none comes" in str(failure)
    assert failure.joint == 1
    arm.close()


@pytest.mark.parametrize(("clock", "spacing_ms"), [(5.0, "45.0"), (2.0, "18.0"), (0.5, "4.5"), (0.2, "1.8")])
def test_a_drive_that_reports_at_another_rate_is_named(clock: float, spacing_ms: str) -> None:
    """Slower, and goals brake for want of readings; faster, and the bus carries more than was reckoned with."""
    arm = reporting(up=False)
    arm.sim.drives[1].report_clock = clock
    failure = arm.bring_up().failure
    assert failure is not None
    assert failure.joint == 1
    assert f"The drive of joint2 (firmware 2.0.0) sends its position every {spacing_ms} ms, although" in str(failure)
    assert "it was told to every 9 ms: set bus.positions to polled" in str(failure)
    arm.close()


@pytest.mark.parametrize("fault", [LostReplies(0.1), DuplicateReplies(0.1, 0.002), LateReplies(0.1, 0.005)])
@pytest.mark.parametrize("seed", range(2))
def test_a_line_that_loses_doubles_or_delays_is_no_other_rate(fault: object, seed: int) -> None:
    arm = reporting(up=False, faults=[fault], seed=seed)
    assert arm.bring_up().failure is None
    arm.close()


def test_silence_about_reports_is_no_refusal() -> None:
    """Acknowledgements are off, and nobody knows whether this command has one then."""
    arm = reporting(up=False)
    for drive in arm.sim.drives:
        drive._commands[0x11] = replace(drive._commands[0x11], motion=True)
    assert arm.bring_up().failure is None
    assert min(reports(arm)) > 50
    arm.close()


@pytest.mark.parametrize("positions", ["polled", "reported"])
@pytest.mark.parametrize("period_ms", [4, 9, 21])
def test_drives_that_a_killed_predecessor_left_reporting(positions: str, period_ms: int) -> None:
    """With the option they are told anew, without it they are told to cease."""
    arm = VirtualArm(load_arm("episode1", overrides={"bus": {"positions": positions}}))
    for number, drive in enumerate(arm.sim.drives):
        drive.receive(arm.sim.now_ns, Frame((number + 1) << 8, zdt_protocol.report_position(period_ms)))
        drive.outbox.clear()
    assert arm.bring_up().failure is None
    assert reports(arm, 120) == [0] * 6 if positions == "polled" else min(reports(arm, 120)) > 100
    said = sum("sent its position by itself, which was ended" in sentence for sentence in arm.told)
    assert said == (6 if positions == "polled" else 0)
    assert arm.end_of(arm.play("small")) == Outcome.SUCCEEDED
    arm.close()


@pytest.mark.parametrize("period_ms", [4, 9])
def test_drives_that_report_are_understood_by_those_who_ask_and_move_them(period_ms: int) -> None:
    """`rtarm drives` and `rtarm calibrate` with drives that a killed predecessor left reporting."""
    arm = VirtualArm(load_arm("episode1"))
    for number, drive in enumerate(arm.sim.drives):
        drive.receive(arm.sim.now_ns, Frame((number + 1) << 8, zdt_protocol.report_position(period_ms)))
    session = Session(arm.arm, arm.port, lambda: arm.now_ns, arm.cycle)
    session.read()
    assert [(report.answers, report.left_alone) for report in session.reports.values()] == [(True, [])] * 6
    stood_rad = arm.sim.true_position_rad(1, arm.sim.now_ns - 1)
    talk = OneDrive(
        arm.arm,
        arm.port,
        now_ns=arm.now_ns,
        joint=1,
        dialogue=lambda clock: addressed(2, Drive(arm.arm, 1, clock).turn(6000, 20)),
    )
    arm.until(lambda: talk.poll(arm.now_ns))
    assert talk.problem is None
    turned_rad = arm.sim.true_position_rad(1, arm.sim.now_ns - 1) - stood_rad
    assert abs(turned_rad * arm.arm.joints[1].encoder_counts_per_rad) == pytest.approx(6000, abs=30)
    arm.close()


def test_who_never_reported_is_not_told_to_cease() -> None:
    arm = VirtualArm()
    arm.sim.inject(LostReplies(0.1))
    assert arm.bring_up().failure is None
    assert not any(b"1118" in data for _, data in arm.sent)
    arm.close()


def test_an_orderly_end_leaves_the_bus_quiet() -> None:
    arm = reporting()
    arm.loop[0]["params"]["reported"] = 0
    talk = ShutdownDialogue(arm.arm, arm.port, now_ns=arm.now_ns)
    arm.until(lambda: talk.poll(arm.now_ns), at_most_s=1.0)
    assert talk.failure is None
    assert arm.memory["fault"]["code"] == Fault.NONE
    frames = arm.sim.bus.frames
    arm.sim.run_until(arm.now_ns + 20_000_000)  # what was on its way
    frames = arm.sim.bus.frames
    arm.sim.run_until(arm.now_ns + 1_000_000_000)
    assert arm.sim.bus.frames == frames
    arm.close()


# --- what goes wrong


def test_lost_reports_do_not_stop_the_arm(moving: VirtualArm) -> None:
    moving.sim.inject(LostReplies(0.1), since_ns=moving.now_ns)
    assert moving.end_of(moving.goal) == Outcome.SUCCEEDED


def test_a_drive_that_ceases_to_report_is_a_silent_one(moving: VirtualArm) -> None:
    """Although it still answers; clearing the fault brings its reports back."""
    end_reports(moving, 1)
    began_ns = moving.now_ns
    moving.until(lambda: moving.is_slowed(Slowed.LATE_DRIVE))
    assert moving.now_ns - began_ns <= 6 * moving.period_ns
    moving.until(lambda: moving.memory["mode"] == Mode.FAULT)
    assert moving.now_ns - began_ns <= 150_000_000
    assert (moving.memory["fault"]["code"], moving.memory["fault"]["joint"]) == (Fault.STALE_READING, 1)
    since = len(moving.sent)
    moving.cycles(100)
    stopped = len(moving.sent)
    moving.cycles(50)
    assert motion_frames(frames_sent(moving.sent[since:]), 2, 0) == 0
    # it is heard all the time, so it is not stopped again and again
    assert not any(b"T000002004FE98006B" in data for _, data in moving.sent[stopped:])
    assert moving.outcome(moving.goal) == Outcome.FAULT
    assert moving.clear_fault().failure is None
    assert min(reports(moving)) > 50
    assert moving.loop[0]["axes"][1]["reference"]["referenced"] == 1  # it proves that it had power


def test_a_drive_that_falls_silent_is_braked_then_latched(moving: VirtualArm) -> None:
    moving.sim.inject(Silent("joint2", at_s=0.0), since_ns=moving.now_ns)
    began_ns = moving.now_ns
    moving.until(lambda: moving.memory["mode"] == Mode.FAULT)
    assert moving.now_ns - began_ns <= 150_000_000
    assert (moving.memory["fault"]["code"], moving.memory["fault"]["joint"]) == (Fault.STALE_READING, 1)


@pytest.mark.parametrize(("joint", "off_s"), [(0, 0.03), (1, 0.01), (2, 0.08), (5, 0.01)])
def test_a_drive_that_lost_power_is_asked_and_stopped(off_s: float, joint: int) -> None:
    """It boots enabled, counts from zero and reports nothing: its answers tell, sooner than its age would."""
    arm = reporting("scale_1_0")
    arm.play("scale_1_0")
    arm.cycles(60)
    name = arm.arm.joints[joint].name
    arm.sim.inject(PowerLoss(name, at_s=0.0, off_s=off_s), since_ns=arm.now_ns)
    began_ns = arm.now_ns
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert arm.now_ns - began_ns <= 120_000_000
    assert arm.memory["fault"]["joint"] == joint
    assert arm.memory["fault"]["code"] in (Fault.REFERENCE_LOST, Fault.STALE_READING)
    assert arm.loop[0]["axes"][joint]["reference"]["referenced"] == 0
    since = len(arm.sent)
    arm.cycles(240)
    assert motion_frames(frames_sent(arm.sent[since:]), joint + 1, 0) == 0
    truth = truth_of(arm.sim)[name]
    assert np.ptp(truth.position_at(np.arange(arm.now_ns - 10**9, arm.now_ns - 10**6, 10**7))) == 0.0
    assert arm.clear_fault().failure is None
    assert any(f"The drive of {name} may have lost power" in sentence for sentence in arm.told)
    assert min(reports(arm)) > 50
    arm.close()


def test_reports_do_not_hide_that_nothing_is_heard_of_us(moving: VirtualArm) -> None:
    """The serial port takes nothing any more, and positions go on coming."""
    moving.sim.inject(SerialBlocked(at_s=0.0), since_ns=moving.now_ns)
    began_ns = moving.now_ns

    def blocked_write(data: bytes) -> None:
        moving.sent.append((moving.now_ns, data))
        moving.taken(len(data))

    moving.write = blocked_write
    moving.until(lambda: moving.is_slowed(Slowed.LATE_DRIVE))
    assert moving.now_ns - began_ns <= 6 * moving.period_ns
    since = len(moving.sent)
    moving.until(lambda: moving.memory["mode"] == Mode.FAULT)
    assert moving.now_ns - began_ns <= 150_000_000
    assert moving.memory["fault"]["code"] in (Fault.STALE_READING, Fault.FOLLOWING_ERROR)
    moving.cycles(100)
    assert sum(motion_frames(frames_sent(moving.sent[since:]), joint + 1, 0) for joint in range(6)) == 0
