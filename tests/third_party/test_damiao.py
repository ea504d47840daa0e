"""damiao-motor 1.0.6, somebody else's library for Damiao motors, and our simulated ones: do they mean the same?

The library owns a bus of python-can and listens in a thread of its own, so all of this is in real time, and waits for
what the motor says. Where it and we do not agree is said at the end of this file.
"""

import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import numpy as np
import pytest
from damiao_motor import DaMiaoController, DaMiaoMotor
from damiao_motor.core.motor import MOTOR_TYPE_PRESETS, REGISTER_TABLE
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from config.drives.damiao import MODELS
from config.loader import load_arm
from rtloop.drives import damiao, damiao_setup, fields
from rtloop.process.initial_state import new_loop
from sim.drives import damiao as simulated_damiao

START_RAD = [0.1, -0.2, 0.3, 0.4, 0.5, 0.6]
STEP_RAD = 25.0 / 65535
PATIENCE_S = 10.0

pytestmark = pytest.mark.filterwarnings("ignore:The 'bustype' argument")  # the library's


@pytest.fixture
def controller(live) -> Iterator[DaMiaoController]:
    """The library on a bus with the six motors of damiao6."""
    bus = live("damiao6", joint_position_rad=START_RAD)
    found = DaMiaoController(channel=bus.channel_id, bustype="virtual")
    yield found
    found.shutdown()


@pytest.fixture
def motor(controller) -> DaMiaoMotor:
    """Its second motor, a DM4340 that is limp at first."""
    return controller.add_motor(2, 0x12, "4340")


def until(motor: DaMiaoMotor, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Ask for feedback until it is as wanted."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        motor.state = {}
        motor.request_motor_feedback()
        asked = time.monotonic()
        while not motor.state and time.monotonic() < asked + 1.0:
            time.sleep(0.001)
        state = motor.get_states()
        if state and holds(state):
            return state
    raise AssertionError(f"the motor never was as wanted; last {motor.get_states()}")


def drive_rad(joint: int) -> float:
    """Where a motor of damiao6 stands at the start, as it counts."""
    return START_RAD[joint] + load_arm("damiao6").joints[joint].zero_rad


# --- speaking ---------------------------------------------------------------------------------------------------


def test_it_reads_where_each_motor_is_and_how(controller):
    for number, kind in enumerate(["4340"] * 3 + ["4310"] * 3, start=1):
        state = until(controller.add_motor(number, 0x10 + number, kind), lambda state: True)
        assert state["pos"] == pytest.approx(drive_rad(number - 1), abs=STEP_RAD)
        assert (state["status"], state["can_id"], state["arbitration_id"]) == ("DISABLED", number, 0x10 + number)
        assert (state["t_mos"], state["t_rotor"]) == (25.0, 30.0)
        assert abs(state["vel"]) < 0.02 and abs(state["torq"]) < 0.02


def test_it_enables_a_motor_and_lets_it_go(motor):
    motor.enable()
    until(motor, lambda state: state["status"] == "ENABLED")
    motor.disable()
    until(motor, lambda state: state["status"] == "DISABLED")


def test_it_moves_a_motor_with_stiffness(motor):
    motor.enable()
    until(motor, lambda state: state["status"] == "ENABLED")
    motor.send_cmd_mit(target_position=0.2, stiffness=20.0, damping=1.0)
    state = until(motor, lambda state: abs(state["pos"] - 0.2) < 0.03 / 20.0 + 2 * STEP_RAD)
    assert state["status"] == "ENABLED"


def test_it_moves_a_motor_by_its_own_ramp(motor):
    motor.set_control_mode(2)
    assert motor.get_register(10) == 2
    motor.enable()
    until(motor, lambda state: state["status"] == "ENABLED")
    motor.send_cmd_pos_vel(target_position=0.3, velocity_limit=4.0)
    until(motor, lambda state: abs(state["pos"] - 0.3) <= 2 * STEP_RAD and abs(state["vel"]) < 0.01)


def test_it_sets_zero(motor):
    motor.set_zero_position()
    assert until(motor, lambda state: True)["pos"] == pytest.approx(0.0, abs=STEP_RAD)


def test_a_timeout_that_it_sets_lets_go_of_a_motor_and_it_clears_that(motor):
    motor.set_can_timeout(50)
    assert motor.get_register(9) == 1000
    motor.enable()
    until(motor, lambda state: state["status"] == "LOST_COMM")
    motor.clear_error()
    until(motor, lambda state: state["status"] == "DISABLED")


def test_it_reads_every_register(motor):
    found = motor.read_all_registers(timeout=PATIENCE_S)
    assert set(found) == set(REGISTER_TABLE)
    wrong = {number: value for number, value in found.items() if not isinstance(value, int | float)}
    assert wrong == {}
    assert (found[7], found[8], found[10]) == (0x12, 2, 1)
    assert (found[21], found[22], found[23]) == (12.5, 10.0, 28.0)
    assert found[60] == 24.0


def test_registers_are_what_it_says_they_are():
    for number, info in REGISTER_TABLE.items():
        known = simulated_damiao.FLOATS if info.data_type == "float" else simulated_damiao.WHOLE
        assert number in known, info
        assert (number in simulated_damiao.READ_ONLY) == (info.access == "RO"), info


# --- the same bytes ---------------------------------------------------------------------------------------------


class Recorder:
    """A bus that keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        self.sent.append(message)


THEIRS = DaMiaoMotor(1, 0x11, Recorder(), motor_type="4340")
ROW = new_loop(load_arm("damiao6"), 0, 0)[0]["joints"][0]
relaxed = settings(deadline=None, max_examples=examples(100))


@relaxed
@given(
    rad=st.floats(-13.0, 13.0),
    rad_s=st.floats(-11.0, 11.0),
    nm=st.floats(-30.0, 30.0),
    kp=st.floats(0.0, 500.0),
    kd=st.floats(0.0, 5.0),
)
def test_our_set_points_are_theirs(rad: float, rad_s: float, nm: float, kp: float, kd: float) -> None:
    """To the step: a number that is a step but for its last bits may be taken for it or for the one below."""
    ROW["stiffness_nm_rad"], ROW["damping_nm_s_rad"] = kp, kd
    ours = unpacked(struct.pack("<q", damiao.setpoint_data(ROW, rad, rad_s, nm)))
    theirs = unpacked(THEIRS.encode_cmd_msg(rad, rad_s, nm, kp, kd))
    steps = np.array([(rad + 12.5) / 25 * 65535, (rad_s + 10) / 20 * 4095, kp / 500 * 4095, kd / 5 * 4095])
    steps = np.append(steps, (nm + 28) / 56 * 4095)
    whole = np.abs(steps - np.round(steps)) < 1e-5
    assert np.all((np.array(ours) == theirs) | (whole & (np.array(ours) - theirs == 1)))


def unpacked(data: bytes) -> list[int]:
    packed = int.from_bytes(data, "big")
    return [packed >> 48, packed >> 36 & 0xFFF, packed >> 24 & 0xFFF, packed >> 12 & 0xFFF, packed & 0xFFF]


@relaxed
@given(data=st.binary(min_size=8, max_size=8))
def test_we_read_feedback_as_they_do(data: bytes) -> None:
    theirs = THEIRS.decode_sensor_feedback(data)
    ours = damiao_setup.feedback_of(data, MODELS["DM4340"])
    assert ours.code == theirs["status_code"]
    assert (ours.rad, ours.rad_s, ours.nm) == pytest.approx((theirs["pos"], theirs["vel"], theirs["torq"]), abs=1e-9)


@relaxed
@given(rad=st.floats(-12.5, 12.5), rad_s=st.floats(0.0, 10.0))
def test_our_targets_are_theirs(rad: float, rad_s: float) -> None:
    bus = Recorder()
    DaMiaoMotor(1, 0x11, bus, motor_type="4340").send_cmd_pos_vel(rad, rad_s)
    (message,) = bus.sent
    assert message.arbitration_id == 0x101
    assert struct.pack("<q", damiao.target_data(rad, rad_s)) == message.data


def test_models_reach_what_they_say() -> None:
    for name, ranges in MODELS.items():
        theirs = MOTOR_TYPE_PRESETS[name.removeprefix("DM")]
        assert (theirs["p_max"], theirs["v_max"], theirs["t_max"]) == tuple(ranges)


# --- where we do not agree --------------------------------------------------------------------------------------


def test_a_mode_that_it_sets_is_set_although_it_does_not_see_that(motor):
    """`ensure_control_mode` reads, writes and reads again, but the second reading is what it remembers of the first.

    It forgets that only if a write is answered as a reading is (33), which neither the firmware (as people found) nor
    ours do (55). Our bring-up waits, reads again, and needs no answer to the write.
    """
    with pytest.raises(RuntimeError, match="expected 2, got 1"):
        motor.ensure_control_mode("POS_VEL")
    motor.registers.clear()
    assert motor.get_register(10) == 2


def test_an_answer_to_a_write_is_feedback_to_it(motor):
    """And nothing to us: it would be a motor at the lower end of its range."""
    until(motor, lambda state: True)
    motor.set_acceleration(5.0)
    deadline = time.monotonic() + PATIENCE_S
    while motor.get_states()["pos"] > -12.0:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    answer = bytes.fromhex("02005504") + struct.pack("<f", 5.0)
    drive = load_arm("damiao6").joints[1].drive
    assert not damiao_setup.is_feedback(drive, answer)
    assert motor.get_states()["pos"] == pytest.approx(fields.of_field(0x0055, 12.5, 16))
