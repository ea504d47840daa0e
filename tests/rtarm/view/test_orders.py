"""What the page's sliders send, beside real processes: what becomes of it where the ROS process fails."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest
from stack import Stack
from waiting import until

from config.loader import load_arm
from rtarm.client import sender as sending_module
from rtarm.console.errors import Refusal
from rtarm.running.status import read_status
from rtarm.view.orders import Orders
from rtarm.view.words import ENGLISH

pytestmark = pytest.mark.process

PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def stack(new_arm_name: Callable[[], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """An arm whose drives do as they are told, with its control process; each test has a ROS process of its own."""
    with closing(Stack(new_arm_name(), tmp_path_factory.mktemp("orders"), "mock")) as stack:
        stack.start_loop()
        yield stack


@pytest.fixture
def orders(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> Iterator[Orders]:
    front = stack.start_front()
    given = Orders(load_arm(str(stack.arm_file)), ENGLISH)
    given.go(pose(0.1), nothing)  # from here on the process that sends knows the arm
    monkeypatch.setattr(sending_module, "SILENCE_S", 5.0)
    try:
        yield given
    finally:
        given.close()
        front.close()


def pose(joint1_rad: float) -> np.ndarray:
    return np.array([joint1_rad, 0.0, 0.0, 0.0, 0.0, 0.0])


def nothing(_: str) -> None:
    pass


def test_a_ros_process_that_dies_amid_a_goal_is_told_and_the_next_goal_goes(stack: Stack, orders: Orders) -> None:
    begun = threading.Event()

    def kill(_: str) -> None:
        begun.set()
        stack.front.process.kill()

    with pytest.raises(Refusal, match="has not said how: see Machine"):
        orders.go(pose(1.0), kill)
    assert begun.is_set() and read_status(stack.name)["goal"] is None
    assert orders._senders.present is not None
    sent_to_the_dead_one = orders._senders.present.pid
    with closing(stack.start_front()):
        assert "Goal reached" in orders.go(pose(0.2), nothing)
        assert orders._senders.present.pid != sent_to_the_dead_one


def test_a_goal_while_the_ros_process_is_away_goes_to_the_next_one(stack: Stack, orders: Orders) -> None:
    stack.front.process.kill()
    stack.front.process.wait()
    said: list[str] = []
    going = threading.Thread(target=lambda: said.append(orders.go(pose(0.3), nothing)))
    before = orders._senders.present
    going.start()
    until(lambda: orders._senders.present is not before, "a new sender on its way", PATIENCE_S)
    with closing(stack.start_front()):
        going.join(PATIENCE_S)
        assert said and "Goal reached" in said[0]


def test_a_goal_that_a_hanging_ros_process_gets_too_late_moves_nothing(stack: Stack, orders: Orders) -> None:
    before = read_status(stack.name)
    stack.front.process.send_signal(signal.SIGSTOP)
    with pytest.raises(Refusal, match="It is cancelled"):
        orders.go(pose(1.2), nothing)
    stack.front.process.send_signal(signal.SIGCONT)
    sender = orders._senders.present
    assert sender is not None
    ended = sender.ended(sender._last, PATIENCE_S)  # before the control process has heard of it, or after
    assert ended is not None and ended.sentence.startswith("Canceled")
    after = stack.until(lambda now: now["goal"] is None)
    assert after["joints"][0]["position_rad"] == pytest.approx(before["joints"][0]["position_rad"], abs=0.02)


def test_stop_ends_a_goal_that_the_ros_process_has_not_begun(
    stack: Stack, orders: Orders, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sending_module, "SILENCE_S", PATIENCE_S)
    before = read_status(stack.name)
    stack.front.process.send_signal(signal.SIGSTOP)
    said: list[str] = []

    def go() -> None:
        try:
            said.append(orders.go(pose(1.2), nothing))
        except Refusal as refused:
            said.append(str(refused))

    going = threading.Thread(target=go)
    going.start()
    sender = orders._senders.present
    assert sender is not None
    while sender._last < 2:  # the second goal has been sent
        time.sleep(0.01)
    assert "no goal was running" in orders.stop()
    stack.front.process.send_signal(signal.SIGCONT)
    going.join(PATIENCE_S)
    assert said and "Goal reached" not in said[0]
    after = read_status(stack.name)
    assert after["joints"][0]["position_rad"] == pytest.approx(before["joints"][0]["position_rad"], abs=0.02)
    assert "takes goals again" in orders.resume()


def test_a_sender_that_was_killed_is_told_once_and_started_anew(stack: Stack, orders: Orders) -> None:
    def kill(_: str) -> None:
        assert orders._senders.present is not None
        orders._senders.present._process.kill()

    with pytest.raises(Refusal, match="process that sends goals has ended"):
        orders.go(pose(1.0), kill)
    stack.until(lambda now: now["goal"] is None)
    assert "Goal reached" in orders.go(pose(0.1), nothing)
