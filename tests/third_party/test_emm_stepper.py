"""emm-stepper 1.1.0, somebody else's library for ZDT drives, and our simulated ones: do they mean the same?

The library speaks through a serial port, whose messages are those of CAN with the address in front (zdt-emm-v5.md,
sections 1 and 5), so it gets a port that puts them on a python-can bus and takes answers from it: the packets of CAN
are made and joined here, everything else is the library's. Its author ran it on firmware V1.0.7 and V2.0.0.

Where it and we do not agree is said at the end of this file, each with a test that holds what was found.
"""

import logging
import math
import time

import can
import pytest
from depth import examples
from emm_stepper import EmmDevice
from emm_stepper.configs import Code, Direction, HomingDirection, HomingMode, MotionMode, ResponseMode
from emm_stepper.parameters import FastPositionParams, HomingParams, PIDParams, PositionParams
from hypothesis import given, settings
from hypothesis import strategies as st
from third_party.simulated_bus import LockstepBus

from rtloop.drives import zdt, zdt_protocol
from sim.faults import PowerLoss

START_RAD = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
COUNTS = 65536
PACKET = 8


class SerialPort:
    """What the library needs of pyserial's Serial, with a bus of python-can behind it; `timeout` in seconds."""

    def __init__(self, bus: can.BusABC, timeout: float = 0.05) -> None:
        self._bus = bus
        self._timeout = timeout
        self._came = bytearray()

    @property
    def in_waiting(self) -> int:
        self._take(0.0)
        return len(self._came)

    def write(self, message: bytes) -> int:
        address, body = message[0], message[1:]
        parts = [body[:PACKET], *(body[:1] + body[at : at + 7] for at in range(PACKET, len(body), 7))]
        for number, part in enumerate(parts):
            self._bus.send(can.Message(arbitration_id=address << 8 | number, data=part))
        return len(message)

    def read(self, count: int = 1) -> bytes:
        while len(self._came) < count and self._take(self._timeout):
            pass
        found = bytes(self._came[:count])
        del self._came[:count]
        return found

    def flush(self) -> None:
        """What is written is on the bus already."""

    def reset_input_buffer(self) -> None:
        self._take(0.0)
        self._came.clear()

    def reset_output_buffer(self) -> None:
        """Nothing waits here."""

    def _take(self, timeout: float) -> bool:
        """Wait for one packet, and take what came with it; False when none came."""
        message = self._bus.recv(timeout)
        if message is None:
            return False
        packet = message.arbitration_id & 0xFF
        self._came += bytes((message.arbitration_id >> 8,)) + message.data if packet == 0 else message.data[1:]
        return self._take(0.0) or True


@pytest.fixture
def bus(simulated) -> LockstepBus:
    return simulated(joint_position_rad=START_RAD)


@pytest.fixture
def motors(bus) -> list[EmmDevice]:
    """The library's six motors, each found and asked for its version."""
    port = SerialPort(bus)
    return [EmmDevice(port, address=joint.drive.address) for joint in bus.arm.config.joints]


@pytest.fixture
def motor(motors) -> EmmDevice:
    return motors[1]


@pytest.fixture
def drive(bus):
    """What `motor` talks to."""
    return bus.arm.drives[1]


def true_deg(bus, joint):
    """Where a motor's shaft truly is, as the drive should count it."""
    return bus.arm.drives[joint].shaft.past(bus.now_ns)[0] * 360.0


def settle(bus, motor, at_most_s=30.0):
    """Poll until the motor says that it has arrived; virtual seconds."""
    until_ns = bus.now_ns + round(at_most_s * 1e9)
    while not motor.is_position_reached():
        assert bus.now_ns < until_ns, "it never arrived"
        bus.wait(0.05)


# --- reading --------------------------------------------------------------------------------------------------


def test_it_reads_where_each_motor_truly_is(bus, motors):
    for joint, motor in enumerate(motors):
        assert motor.get_realtime_position() == pytest.approx(true_deg(bus, joint), abs=360.0 / COUNTS)
        assert motor.get_target_position() == pytest.approx(true_deg(bus, joint), abs=360.0 / COUNTS)
        assert motor.get_pulse_count() == round(true_deg(bus, joint) / 360.0 * 3200)
        assert motor.get_encoder_degrees() == pytest.approx(true_deg(bus, joint) % 360.0, abs=360.0 / COUNTS)
        assert abs(motor.get_position_error()) < 0.2


def test_it_reads_what_each_drive_is(motor):
    version = motor.get_version()
    assert (version.firmware_version_str, version.is_v2, motor.supports_fast_position) == ("V2.0.0", True, True)
    assert (motor.get_motor_rh().phase_resistance, motor.get_motor_rh().phase_inductance) == (1146, 3368)
    assert motor.get_pid() == PIDParams(18000, 10, 18000)
    assert motor.get_bus_voltage() == 12_000
    assert motor.get_bus_current() > 0
    assert 0 < motor.get_temperature() < 100
    assert motor.get_heartbeat_time() == 0
    threshold = motor.get_protection_threshold()
    assert (threshold.over_temp_threshold, threshold.over_current_threshold, threshold.detection_time) == (
        100,
        6600,
        1000,
    )


def test_it_reads_the_same_settings_as_we_do(bus, motor, drive):
    """Five packets: its view of them and ours, field by field."""
    theirs = motor.get_config()
    ours = zdt_protocol.block_of(b"\x42\x21\x15" + drive.settings.pack() + b"\x6b")
    assert ours is not None
    assert (theirs.motor_id, theirs.can_rate, theirs.microstep) == (2, ours.can_code, ours.microstep_code)
    assert (theirs.response_mode, theirs.checksum_mode) == (ours.response, ours.checksum)
    assert theirs.response_mode == ResponseMode.RECEIVE
    assert (theirs.open_loop_current, theirs.closed_loop_current) == (ours.open_loop_ma, ours.current_ma)
    assert (theirs.stall_protect, theirs.stall_speed) == (ours.stall_mode, ours.stall_rpm)
    assert (theirs.stall_current, theirs.stall_time) == (ours.stall_current_ma, ours.stall_time_ms)
    assert (theirs.position_window, theirs.motor_type) == (ours.reach_window, ours.motor_type)
    # what it would write back is what we would: identifier and screen byte as 0
    assert b"\x48\xd1\x00" + theirs.bytes + b"\x6b" == zdt_protocol.write_block(ours, store=False)


def test_it_reads_everything_at_once(bus, motor):
    everything = motor.get_system_status()
    assert everything.realtime_position_deg == pytest.approx(true_deg(bus, 1), abs=360.0 / COUNTS)
    assert everything.bus_voltage == motor.get_bus_voltage()
    assert everything.realtime_speed_rpm == 0
    assert (everything.motor_status.enabled, everything.motor_status.position_reached) == (True, True)
    both = motor.get_home_motor_status()
    assert (both.homing, both.motor) == (everything.homing_status, everything.motor_status)


def test_angles_of_both_are_those_of_the_shaft(bus, motor):
    """It takes 65536 counts a turn, as we do; degrees are of the motor, not of the joint behind its gear."""
    joint = bus.arm.config.joints[1]
    motor_deg = math.degrees(joint.direction * (START_RAD[1] + joint.zero_rad)) * joint.ratio
    assert motor.get_realtime_position() == pytest.approx(motor_deg, abs=0.12)


# --- moving ---------------------------------------------------------------------------------------------------


def test_it_lets_a_motor_go_and_holds_it_again(motor, drive):
    assert motor.is_enabled()
    assert motor.disable() and not drive.enabled and not motor.is_enabled()
    assert motor.enable() and drive.enabled and motor.is_enabled()


@pytest.mark.parametrize("pulses", [3200, 6401, 1])
def test_it_moves_a_motor_to_a_place(bus, motor, pulses):
    assert motor.move_pulses(pulses, speed=600, acceleration=200, motion_mode=MotionMode.ABSOLUTE)
    settle(bus, motor)
    assert motor.get_pulse_count() == pulses
    assert true_deg(bus, 1) == pytest.approx(pulses / 3200 * 360.0, abs=0.02)
    assert motor.get_realtime_speed() == 0


def test_it_moves_a_motor_by_an_amount(bus, motor):
    before = motor.get_pulse_count()
    for _ in range(2):
        assert motor.move_revolutions(0.5, speed=300, acceleration=200)
        settle(bus, motor)
    assert motor.get_pulse_count() == before + 3200
    assert motor.move_pulses(-800, speed=300, acceleration=200, motion_mode=MotionMode.RELATIVE_CURRENT)
    settle(bus, motor)
    assert motor.get_pulse_count() == pytest.approx(before + 2400, abs=1)  # from where it was measured


def test_it_turns_a_motor_steadily_and_stops_it(bus, motor):
    assert motor.jog(speed=120, direction=Direction.CCW, acceleration=240)
    bus.wait(1.0)
    assert motor.get_realtime_speed() == -120
    assert motor.stop()
    before = true_deg(bus, 1)
    bus.wait(1.0)
    assert (motor.get_realtime_speed(), true_deg(bus, 1)) == (0, before)


def test_motors_that_wait_start_together(bus, motors):
    before = [motor.get_pulse_count() for motor in motors[:2]]
    for motor in motors[:2]:
        assert motor.move_pulses(1600, speed=300, acceleration=200, sync=True)
    bus.wait(0.5)
    assert [motor.get_pulse_count() for motor in motors[:2]] == before
    assert EmmDevice.sync_move(motors[0].device_params)
    for motor, was in zip(motors[:2], before, strict=True):
        settle(bus, motor)
        assert motor.get_pulse_count() == was + 1600


def test_fast_targets_are_absolute_when_they_were_set_up_so(bus, motor):
    """Whether a real drive takes them so is unproven (facts, section 3), and the library does not say."""
    assert motor.configure_fast_position(speed=600, acceleration=200, motion_mode=MotionMode.ABSOLUTE)
    for _ in range(2):
        assert motor.move_fast_pulses(3200)
        settle(bus, motor)
        assert motor.get_pulse_count() == 3200


# --- homing ---------------------------------------------------------------------------------------------------


HOMING = HomingParams(
    homing_mode=HomingMode.COLLISION,
    homing_direction=HomingDirection.CCW,
    homing_speed=60,
    homing_timeout=120_000,
    collision_speed=250,
    collision_current=900,
    collision_time=80,
)


def test_it_sets_up_homing_as_we_do(bus, motor, drive):
    before = motor.get_homing_params()
    assert motor.set_homing_params(HOMING, store=False)
    assert motor.get_homing_params() == HOMING != before
    ours = zdt_protocol.homing_of(b"\x22" + drive.homing.pack() + b"\x6b")
    assert ours is not None
    assert (ours.mode, ours.direction, ours.rpm, ours.timeout_ms) == (2, 1, 60, 120_000)
    assert b"\x4c\xae\x00" + HOMING.bytes + b"\x6b" == zdt_protocol.write_homing(ours)


def test_it_homes_a_motor_to_its_stop(bus, motor, drive):
    assert motor.home(HomingMode.COLLISION)
    bus.wait(0.1)
    assert motor.get_homing_status().is_homing
    assert not motor.move_pulses(100), "a motor that homes takes no motion command"
    for _ in range(2000):
        if not motor.get_homing_status().is_homing:
            break
        bus.wait(0.1)
    status = motor.get_homing_status()
    assert (status.is_homing, status.homing_failed) == (False, False)
    assert motor.get_realtime_position() == pytest.approx(0.0, abs=0.01)


def test_it_ends_a_homing_run(bus, motor):
    assert not motor.stop_home(), "none runs"
    assert motor.home(HomingMode.COLLISION)
    bus.wait(0.2)
    assert motor.stop_home()
    assert not motor.get_homing_status().is_homing


# --- errors ---------------------------------------------------------------------------------------------------


def test_what_a_drive_refuses_is_a_failure_to_it(bus, motor, drive):
    assert motor.disable()
    assert not motor.move_pulses(3200)
    assert motor.enable()
    assert motor.move_pulses(3200, speed=300, acceleration=200)
    settle(bus, motor)
    assert not motor.calibrate_encoder(), "not modelled: 00 EE 6B"


def test_a_drive_that_protects_itself_moves_no_more_until_it_is_cleared(bus, motor, drive):
    drive.protect(bus.now_ns, "stall")
    assert motor.is_stalled()
    assert not motor.move_pulses(3200)
    assert motor.clear_protection()
    assert not motor.is_stalled()
    drive.protect(bus.now_ns, "temperature")
    assert motor.get_homing_status().over_temp


def test_a_motor_that_is_not_there_is_noticed(bus):
    with pytest.raises(ConnectionError):
        EmmDevice(SerialPort(bus), address=99)


def test_a_watchdog_that_it_sets_stops_a_motor_that_hears_nothing(bus, motor):
    assert motor.set_heartbeat_time(500, store=False)
    assert motor.get_heartbeat_time() == 500
    assert motor.jog(speed=120, acceleration=0)
    bus.wait(0.4)
    assert motor.get_realtime_speed() == 120
    bus.wait(0.6)
    assert motor.get_realtime_speed() == 0


def test_it_speaks_with_drives_in_real_time_too(live):
    """On python-can's own virtual bus, with the simulated arm as another node of it."""
    motor = EmmDevice(SerialPort(live(joint_position_rad=START_RAD), timeout=1.0), address=3)
    before = motor.get_pulse_count()
    assert motor.move_pulses(10, speed=600, acceleration=255)
    deadline = time.monotonic() + 10.0
    while motor.get_pulse_count() != before + 10 or not motor.is_position_reached():
        assert time.monotonic() < deadline


# --- settings -------------------------------------------------------------------------------------------------


def test_settings_that_it_writes_are_those_that_it_reads(motor, drive):
    config = motor.get_config()
    config.closed_loop_current, config.response_mode = 2000, ResponseMode.NONE
    assert motor.set_config(config, store=False)
    assert (drive.settings.response, motor.get_config().closed_loop_current) == (0, 2000)
    assert motor.get_config() == config
    assert motor.set_microstep(32, store=False)
    assert motor.get_config().microstep == 32
    assert motor.set_closed_loop_current(1500, store=False)
    assert motor.get_config().closed_loop_current == 1500


def test_it_gives_a_motor_another_address(bus, motor, drive):
    assert motor.set_id(9)
    assert (motor.address, drive.settings.address) == (9, 9)
    assert motor.get_realtime_position() == pytest.approx(true_deg(bus, 1), abs=360.0 / COUNTS)


# --- the same bytes -------------------------------------------------------------------------------------------


relaxed = settings(deadline=None, max_examples=examples(100))


@relaxed
@given(st.integers(-(2**32) + 1, 2**32 - 1), st.integers(1, 3000), st.integers(1, 255))
def test_our_targets_are_theirs(pulses, rpm, acc):
    theirs = PositionParams(
        direction=Direction.CCW if pulses < 0 else Direction.CW,
        speed=rpm,
        acceleration=acc,
        pulse_count=abs(pulses),
        motion_mode=MotionMode.ABSOLUTE,
    )
    expected = b"\xfd" + theirs.bytes + b"\x6b"
    assert zdt_protocol.go_to(pulses, rpm=rpm, acc=acc) == expected
    first, second = (word.to_bytes(8, "little") for word in map(int, unsigned(zdt.pack_target(rpm, acc, pulses))))
    assert first + second[1:5] == expected


@relaxed
@given(st.integers(-(2**31), 2**31 - 1), st.integers(1, 3000), st.integers(0, 255))
def test_our_fast_targets_are_theirs(pulses, rpm, acc):
    theirs = FastPositionParams(speed=rpm, acceleration=acc, motion_mode=MotionMode.ABSOLUTE)
    assert zdt_protocol.fast_setup(rpm, acc) == b"\xf1" + theirs.bytes + b"\x6b"
    fast = b"\xfc" + pulses.to_bytes(4, "big", signed=True) + b"\x6b"
    assert zdt_protocol.fast_target(pulses) == fast
    assert int(zdt.pack_fast_target(pulses)).to_bytes(8, "little")[:6] == fast


def unsigned(words):
    """Words of the compiled codec, whose top bit may be set."""
    return [int(word) % 2**64 for word in words]


# --- where we do not agree ------------------------------------------------------------------------------------


def test_a_mark_for_lost_power_that_it_writes_as_one_is_refused(bus, motor, drive, caplog):
    """It knows two generations: V1 boots with the mark 1 and clears it with 0, V2 may boot with 0 and be marked with 1.

    Ours boots with 1, whatever its firmware, and takes 0 alone (facts, section 6). What a V2 drive does is unproven, so
    a bit that is 0 after bring-up must not be all that tells of a drive that was away: see docs/explanation/safety.md.
    """
    bus.arm.inject(PowerLoss("joint2", at_s=0.0, off_s=0.2), since_ns=bus.now_ns)
    bus.wait(1.0)
    assert motor.get_motor_status().power_off_flag
    assert motor.set_power_off_flag(False)
    assert not motor.get_motor_status().power_off_flag
    with caplog.at_level(logging.WARNING):
        assert not motor.set_power_off_flag(True)


def test_reports_that_it_asks_for_come_although_it_takes_their_acknowledgement_for_none(bus, motor):
    """It awaits the first report at once; ours acknowledges `11 02 6B` before (facts, section 6), as it does their end.

    Bring-up takes either for yes, and silence too: what counts is that positions come (`rtloop.drives.zdt_talk`).
    """
    assert not motor.timed_return(Code.GET_REALTIME_POSITION, 20)
    assert [bytes(m.data) for way, m in bus.log if way == "in" and m.data[0] == 0x11] == [b"\x11\x02\x6b"] * 3
    bus.log.clear()
    bus.wait(1.0)
    reports = [m for way, m in bus.log if way == "in" and m.data[0] == Code.GET_REALTIME_POSITION]
    assert 48 <= len(reports) <= 51
    assert motor.timed_return(Code.GET_REALTIME_POSITION, 0)
    bus.log.clear()
    bus.wait(1.0)
    assert bus.log == []
