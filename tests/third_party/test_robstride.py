"""robstride 0.1.0 (sirwart), somebody else's library for RobStride motors, and our simulated ones: do they agree?

It has one client, which sends and waits. Of feedback it knows two models by what their fields reach: RobStride 01
(44 rad/s, 17 N·m) and one of 15 rad/s and 120 N·m; the arm's motors are set up as the first.

Where it and we do not agree is said at the end of this file, with a test that holds what was found.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robstride import Client, RunMode
from third_party.conftest import on_python_can
from third_party.simulated_bus import LockstepBus

from config.schema import ArmConfig
from rtloop.drives.robstride import parameter
from rtloop.drives.robstride_protocol import BYTE, INDEX, RUN_MODES
from rtloop.drives.robstride_setup import _frame, _write
from sim.drives.robstride import RESET, RUN

START_RAD = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
HOST = 0xAA


def arm_of(mode: str = "position") -> ArmConfig:
    """Six motors of RobStride 01's fields, and the library's own host id."""
    arm = on_python_can("robstride6_position")
    usual = {"family": "robstride", "mode": mode, "host_id": HOST, "encoder": "absolute"}
    ranges = {"velocity_range_rad_s": 44.0, "torque_range_nm": 17.0}
    document = arm.model_dump(exclude_unset=True)
    for number, joint in enumerate(document["joints"], 1):
        joint["drive"] = {**usual, **ranges, "motor_id": number}
    return ArmConfig.model_validate(document)


@pytest.fixture
def bus(simulated) -> LockstepBus:
    return simulated(arm_of(), joint_position_rad=START_RAD)


@pytest.fixture
def client(bus) -> Client:
    return Client(bus, recv_timeout=0.1, host_can_id=HOST)


@pytest.fixture
def drive(bus):
    """The motor of joint 2."""
    return bus.arm.drives[1]


def angle(bus, joint: int = 1) -> float:
    """Where the motor truly is, as it counts."""
    drive = bus.arm.drives[joint]
    drive.advance(bus.now_ns)
    return drive.shaft.past(bus.now_ns)[0] * 2 * np.pi


def test_it_enables_a_motor_and_reads_its_feedback(bus, client, drive):
    feedback = client.enable(2)
    assert drive.state == RUN and drive.enabled
    assert (feedback.servo_id, feedback.errors) == (2, [])
    assert feedback.angle == pytest.approx(angle(bus), abs=8 * np.pi / 65535)
    assert feedback.velocity == pytest.approx(0.0, abs=88 / 65535)
    assert feedback.torque == pytest.approx(0.0, abs=34 / 65535)
    assert feedback.temp == pytest.approx(30.0)
    client.disable(2)
    assert drive.state == RESET


def test_it_reads_parameters(bus, client, drive):
    assert client.read_param(2, "mechpos") == pytest.approx(angle(bus), abs=1e-6)
    assert client.read_param(2, "mechvel") == 0.0
    assert client.read_param(2, "vbus") == pytest.approx(24.0)
    assert client.read_param(2, "loc_kp") == pytest.approx(30.0)
    assert client.read_param(2, "run_mode") == RunMode.Operation


def test_it_moves_a_motor_with_its_position_loop(bus, client, drive):
    client.write_param(2, "run_mode", RunMode.Position)
    assert client.read_param(2, "run_mode") == RunMode.Position
    client.write_param(2, "loc_ref", client.read_param(2, "mechpos"))
    client.enable(2)
    client.write_param(2, "limit_spd", 0.5)
    began_rad = angle(bus)
    client.write_param(2, "loc_ref", began_rad + 1.0)
    bus.wait(1.0)
    assert angle(bus) - began_rad == pytest.approx(0.5, abs=0.02)
    assert client.read_param(2, "mechvel") == pytest.approx(0.5, rel=1e-3)
    bus.wait(3.0)
    assert client.read_param(2, "mechpos") == pytest.approx(began_rad + 1.0, abs=1e-5)


def test_it_turns_a_motor_at_a_speed(bus, client, drive):
    client.write_param(2, "run_mode", RunMode.Speed)
    client.enable(2)
    client.write_param(2, "spd_ref", -2.0)
    bus.wait(0.5)
    assert client.write_param(2, "spd_ref", -2.0).velocity == pytest.approx(-2.0, rel=0.01)
    client.write_param(2, "spd_ref", 0.0)
    bus.wait(0.5)
    assert client.read_param(2, "mechvel") == pytest.approx(0.0, abs=1e-3)


def test_it_gives_a_motor_another_id(bus, client, drive):
    client.update_id(2, 9)
    assert drive.settings.motor_id == 9
    assert client.read_param(9, "mechpos") == pytest.approx(angle(bus), abs=1e-6)


@pytest.mark.parametrize(("cause", "name"), [("temperature", "Overtemp"), ("current", "Overcurrent")])
def test_it_knows_our_faults(bus, client, drive, cause, name):
    client.enable(2)
    drive.protect(bus.now_ns, cause)
    bus.wait(0.01)
    while bus.recv(0.0) is not None:  # the fault that it says by itself, which the library does not expect
        pass
    feedback = client.enable(2)
    assert [error.name for error in feedback.errors] == [name]


def test_a_motor_that_is_not_there_is_noticed(client):
    with pytest.raises(Exception, match="No response"):
        client.enable(77)


# --- the same bytes -------------------------------------------------------------------------------------------


class Log:
    """A bus that keeps what is sent, and answers nothing."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, bytes]] = []

    def send(self, message) -> None:
        self.sent.append((message.arbitration_id, bytes(message.data)))

    def recv(self, timeout) -> None:
        return None


def said(call) -> tuple[int, bytes]:
    """What the library says in a call."""
    log = Log()
    with pytest.raises(Exception, match="No response"):
        call(Client(log, host_can_id=HOST))
    return log.sent[0]


JOINT = arm_of().joints[2]


def ours(frame) -> tuple[int, bytes]:
    return frame.id, frame.data


def test_our_commands_are_theirs():
    drive = JOINT.drive
    assert ours(_frame(drive, 3)) == said(lambda client: client.enable(3))
    assert ours(_frame(drive, 4)) == said(lambda client: client.disable(3))
    for name, mode in (("control", RunMode.Operation), ("position", RunMode.Position)):
        frame = _frame(drive, 18, {INDEX: 0x7005, BYTE: RUN_MODES[name]})
        assert ours(frame) == said(lambda client, mode=mode: client.write_param(3, "run_mode", mode))


@settings(deadline=None)
@given(st.floats(-100, 100, width=32), st.sampled_from(["loc_ref", "limit_spd", "spd_ref", "loc_kp"]))
def test_our_parameters_are_theirs(value, name):
    index = {"loc_ref": 0x7016, "limit_spd": 0x7017, "spd_ref": 0x700A, "loc_kp": 0x701E}[name]
    theirs = said(lambda client: client.write_param(3, name, value))
    assert ours(_write(JOINT.drive, index, value)) == theirs
    assert (int(parameter(index, value)) % 2**64).to_bytes(8, "little") == theirs[1]


# --- where we do not agree ------------------------------------------------------------------------------------


def test_it_takes_a_motor_that_runs_for_one_that_is_stopped(bus, client, drive):
    """It looks at bit 22 of the feedback alone: of reset 0, calibration 1 and run 2 (facts) it misses the last."""
    feedback = client.enable(2)
    assert drive.state == RUN and feedback.mode.name == "Reset"
