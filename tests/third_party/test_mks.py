"""mksact 0.2.0, somebody else's library for MKS drives, and our simulated ones: do they mean the same?

Its author wrote it from the maker's manual V1.0.9 and ran it on a SERVO42D. It listens in a thread of its own and
sleeps between commands, so it meets the drives in real time. Where it and we do not agree is said at the end.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import can
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from mksact import Actuator, ActuatorError
from third_party.conftest import on_python_can

from rtloop.drives import mks

COUNTS = 16_384
JOINT = 1
CAN_ID = JOINT + 1
ARM = on_python_can("mks6")
NEAR_STOP_DEG = -88.0
"""Of joint2, whose stop is at -90."""


def counted(joint_deg: float) -> int:
    """What the drive of joint2 counts there."""
    joint = ARM.joints[JOINT]
    return math.floor(joint.direction * (joint_deg + joint.zero_deg) / 360.0 * joint.ratio * COUNTS)


@pytest.fixture
def reach(live) -> Iterator[Callable[..., Actuator]]:
    """Makes the library's actuators, each for a drive of an arm that stands near its stops."""
    with ExitStack() as closing:

        def make(can_id: int = CAN_ID, **options: object) -> Actuator:
            start_rad = [math.radians(joint.lower_deg + 2.0) for joint in ARM.joints]
            bus = live(ARM, joint_position_rad=start_rad, **options)
            actuator = Actuator(channel=bus.channel_id, can_id=can_id, interface="virtual", verbose=False, accel=250)
            closing.callback(actuator.close)
            return actuator

        yield make


@pytest.fixture
def actuator(reach) -> Actuator:
    """One that is connected."""
    return reach().connect()


def test_it_reads_where_the_motor_is_and_that_it_stands(actuator):
    assert abs(actuator.position() - counted(NEAR_STOP_DEG)) <= 1
    assert (actuator.status(), actuator.is_moving()) == ("stopped", False)
    assert not actuator.switch_pressed()


def test_it_moves_a_motor_and_hears_that_it_has_arrived(actuator):
    actuator.set_zero()
    assert actuator.position() == 0
    assert actuator.move_abs(6000, wait=True, timeout=5.0)
    assert actuator.position() == 6000
    assert actuator.move_rel(-1500, wait=True, timeout=5.0)
    assert actuator.position() == 4500
    assert actuator.move_turns(0.5, wait=True, timeout=5.0)
    assert actuator.position() == 4500 + COUNTS // 2


def test_a_new_target_counts_in_mid_move(actuator):
    actuator.set_zero()
    actuator.move_abs(40 * COUNTS, speed=300)
    assert actuator.is_moving()
    assert actuator.move_abs(2000, wait=True, timeout=5.0)
    assert actuator.position() == 2000


def test_it_turns_a_motor_and_stops_it(actuator):
    actuator.run("ccw", speed=120)
    for _ in range(200):
        if actuator.status() == "full speed":
            break
    assert actuator.status() == "full speed"
    actuator.stop(accel=255)
    for _ in range(200):
        if not actuator.is_moving():
            break
    stood = actuator.position()
    assert stood > counted(NEAR_STOP_DEG) and actuator.position() == stood


def test_its_emergency_stop_ends_a_move(actuator):
    actuator.set_zero()
    actuator.move_abs(40 * COUNTS, speed=300)
    while not actuator.position():
        assert actuator.is_moving()
    actuator.emergency_stop()
    assert actuator.status() == "stopped"
    stood = actuator.position()
    assert 0 < stood < 40 * COUNTS and actuator.position() == stood


def test_it_homes_to_the_switch_and_backs_off(actuator):
    """The switch closes 1/50 turn before the joint's stop; its count begins there, and grows away from it."""
    at_switch = counted(ARM.joints[JOINT].lower_deg) + COUNTS // 50
    before = actuator.position() - at_switch
    assert actuator.home(direction="cw", timeout=10.0) > 0
    assert not actuator.switch_pressed()
    home = actuator.position()
    assert actuator.move_abs(before, wait=True, timeout=10.0)
    assert home < actuator.position() == before


def test_it_lets_a_motor_go_and_a_loose_one_moves_no_more(actuator):
    assert actuator.disable()
    actuator.homed = True  # whatever it thinks of that
    before = actuator.position()
    actuator.move_abs(before + 5000)
    assert not actuator.wait_done(1.0)
    assert actuator.position() == before
    assert actuator.enable()


def test_a_motor_that_is_not_there_is_noticed(reach):
    with pytest.raises(ActuatorError, match="no reply from motor 0x63"):
        reach(can_id=0x63).connect()


# --- the same bytes -------------------------------------------------------------------------------------


class Recorder:
    """What the library needs to send on: keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        self.sent.append(message)


@settings(deadline=None, max_examples=examples(100))
@given(st.integers(1, 2047), st.integers(-(2**23) + 1, 2**23 - 1), st.integers(0, 3000), st.integers(0, 255))
def test_our_targets_are_theirs(can_id, counts, rpm, acc):
    theirs = Actuator(can_id=can_id, verbose=False)
    theirs.bus = bus = Recorder()
    theirs._raw_goto(counts, rpm, acc)
    (message,) = bus.sent
    assert (message.arbitration_id, message.is_extended_id) == (can_id, False)
    assert int(mks.pack_target(can_id, rpm, acc, counts)) % 2**64 == int.from_bytes(message.data, "little")


# --- where we do not agree ------------------------------------------------------------------------------


def test_clockwise_is_towards_lower_counts(actuator):
    """It takes clockwise for positive (manual V1.0.9, 5.1.2); to V1.0.6 and the facts (32: CCW +) it is negative.

    The manuals contradict themselves: 30 grows anti-clockwise in both. An arm file's `direction` says what is so.
    """
    actuator.set_zero()
    actuator.run("cw", speed=60)
    while not (count := actuator.position()):
        assert actuator.is_moving()
    assert count < 0
