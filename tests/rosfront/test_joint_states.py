"""When a message may be published, and what the publisher's thread does beside it."""

import contextlib
import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from fake_loop import FakeLoop
from waiting import until

from config.loader import load_arm
from rosfront import joint_states
from rosfront.joint_states import Pulse
from rosfront.link import attach
from rosfront.message_bytes import MessageBytes
from rosfront.refusals import NotServing
from rosfront.serving import Serving


def template(times, rows):
    return b"head" + struct.pack("<iI", *times[0]) + b"names" + b"".join(struct.pack("<I6d", 6, *row) for row in rows)


def joint_state():
    return MessageBytes(template, 1, [6, 6, 6])


def decode(message):
    stamp = struct.unpack_from("<iI", message, 4)
    return stamp, [struct.unpack_from("<6d", message, 17 + 4 + 52 * kind) for kind in range(3)]


@pytest.fixture
def stage(arm_name):
    arm = load_arm("mock", overrides={"name": arm_name})
    loop = FakeLoop(arm)
    link = attach(arm)
    sent, seen = [], []

    class Publisher:
        publish = staticmethod(sent.append)

    def look(snapshot, stamp_ns, fresh):
        seen.append((stamp_ns, fresh))

    pulse = Pulse(arm, Serving(arm), joint_state(), Publisher(), look, lambda link: None, print, None)

    def cycle(now_ns):
        loop.cycle(now_ns)
        pulse._publish(link.reader.snapshot())
        return len(sent)

    yield loop, cycle, sent, seen
    link.close()
    loop.files.remove()


def test_the_stamp_is_the_time_of_the_newest_measurement(stage):
    loop, cycle, sent, seen = stage
    loop.measuring = False
    loop.rows["measured_ns"] = [990, 995, 900, 800, 700, 600]
    loop.rows["measured_position_rad"] = [1, 2, 3, 4, 5, 6]
    cycle(1000)
    epoch = int(loop.snapshot["epoch_ns"])
    stamp, rows = decode(sent[0])
    assert stamp == divmod(epoch - 5, 10**9)
    assert seen == [(epoch - 5, True)]
    assert rows[0] == (1, 2, 3, 4, 5, 6)
    assert np.isnan(rows[2]).all()


def test_nothing_is_published_before_every_joint_was_measured(stage):
    loop, cycle, _, seen = stage
    loop.measuring = False
    loop.rows["measured_ns"] = [5, 5, 5, 5, 5, 0]
    assert cycle(10) == 0
    loop.rows["measured_ns"] = 15
    loop.rows["measured_position_rad"][2] = np.nan
    assert cycle(20) == 0
    loop.rows["measured_position_rad"][2] = 0.0
    assert cycle(30) == 1
    assert [fresh for _, fresh in seen] == [False, False, True]


def test_nothing_is_published_twice(stage):
    loop, cycle, _, _ = stage
    assert cycle(1000) == 1
    loop.measuring = False
    assert cycle(2000) == 1
    loop.rows["measured_ns"][3] = 2500
    assert cycle(3000) == 2


def test_a_velocity_is_never_nan(stage):
    loop, cycle, sent, _ = stage
    loop.measuring = False
    loop.rows["measured_ns"] = 5
    loop.rows["measured_velocity_rad_s"] = [np.nan, 0.5, np.inf, 0, 0, 0]
    cycle(10)
    assert decode(sent[0])[1][1] == (0, 0.5, 0, 0, 0, 0)


# --- the thread ---


class Thread:
    """The publisher's thread, with what it publishes, shows and says."""

    def __init__(self, arm):
        self.cycles, self.said, self.asides = [], [], []
        self.serving = Serving(arm)
        self.busy = lambda: None
        self.pulse = Pulse(
            arm, self.serving, joint_state(), self, self.look, self.asides.append, self.said.append, None
        )

    def publish(self, message):
        self.busy()

    def look(self, snapshot, stamp_ns, fresh):
        self.cycles.append(int(snapshot["cycle"]))


@pytest.fixture
def arm(arm_name):
    return load_arm("mock", overrides={"name": arm_name})


@pytest.fixture
def thread(arm):
    thread = Thread(arm)
    yield thread
    thread.pulse.stop()


@pytest.fixture
def loop(arm):
    loop = FakeLoop(arm)
    yield loop
    loop.stop()


@pytest.mark.parametrize("spoilt", [-1, 0, 2**62])
def test_a_spoilt_number_of_a_cycle_counts_for_nothing(arm, loop, thread, spoilt):
    """It is looked at before the snapshot is checked."""
    with contextlib.closing(attach(arm)) as link:
        for now_ns in (1000, 2000):
            loop.cycle(now_ns)
            found = thread.pulse._fresh(link, time.monotonic_ns())
            assert found["monotonic_ns"] == now_ns
            thread.pulse._cycle = found["cycle"]
            loop.state["snapshot"]["cycle"] = spoilt
            assert thread.pulse._fresh(link, time.monotonic_ns()) is None


def followed(thread, slow):
    """How many of the slow cycles were followed by the very next one."""
    cycles = np.array(thread.cycles)
    steps = dict(zip(cycles[:-1].tolist(), np.diff(cycles).tolist(), strict=True))
    return sum(steps.get(cycle) == 1 for cycle in slow)


def test_its_wake_ups_are_not_put_off_by_the_kernel(thread):
    thread.pulse.start()
    slack = Path(f"/proc/{thread.pulse.native_id}/timerslack_ns")
    until(lambda: slack.read_text() == "1\n")
    assert Path(f"/proc/{os.getpid()}/timerslack_ns").read_text() != "1\n", "that of other threads stays as it is"


@pytest.mark.process
def test_after_a_slow_publication_the_next_cycle_is_published_at_once(arm, loop, thread):
    slow = []

    def busy():
        if thread.pulse._cycle % 5 == 0:
            slow.append(thread.pulse._cycle)
            time.sleep(1.2e-9 * arm.control.period_ns)

    thread.busy = busy
    loop.start()
    thread.pulse.start()
    until(lambda: len(slow) > 20)
    assert followed(thread, slow[:20]) >= 15  # a busy machine may take the rest


@pytest.mark.process
def test_a_late_cycle_is_waited_for(arm, loop, thread):
    late = []

    def hook(loop):
        if loop.snapshot["cycle"] % 5 == 0:
            late.append(int(loop.snapshot["cycle"]))
            time.sleep(0.7e-9 * arm.control.period_ns)

    loop.cycle_hook = hook
    loop.start()
    thread.pulse.start()
    until(lambda: len(late) > 23)
    assert followed(thread, [cycle - 1 for cycle in late[2:22]]) >= 15


def test_a_start_in_any_order_says_nothing_of_it(loop, thread, monkeypatch):
    """Not that there is no loop yet, nor that the one there has run no cycle for longer than a hung one may."""
    monkeypatch.setattr(joint_states, "STALLED_NS", 1)
    thread.pulse.start()
    beats = set()
    until(lambda: beats.add(int(loop.command["heartbeat_ns"][0])) or len(beats) > 5)
    assert len(thread.said) == 1 and thread.said[0].startswith("Attached to the control process")
    assert not thread.serving.ever_attached.is_set()
    with pytest.raises(NotServing, match="has not run its first cycle yet"):
        thread.serving.present()
    monkeypatch.undo()
    loop.start()
    until(thread.serving.ever_attached.is_set)
    until(lambda: thread.cycles)
    assert len(thread.said) == 1


def test_a_loop_that_does_not_come_is_missed_once(thread, monkeypatch):
    monkeypatch.setattr(joint_states, "QUIET_START_S", 0.0)
    tried = []
    monkeypatch.setattr(joint_states, "attach", lambda arm: tried.append(arm) or attach(arm))
    monkeypatch.setattr(joint_states, "ATTACH_EVERY_S", 0.001)
    thread.pulse.start()
    until(lambda: len(tried) > 10)
    assert len(thread.said) == 1
    assert thread.said[0].startswith("No control process is running") and thread.said[0].endswith("Waiting for it.")


def test_a_loop_that_does_not_begin_is_mentioned_once(loop, thread, monkeypatch):
    monkeypatch.setattr(joint_states, "QUIET_START_S", 0.0)
    thread.pulse.start()
    until(lambda: len(thread.said) > 1)
    beats = set()
    until(lambda: beats.add(int(loop.command["heartbeat_ns"][0])) or len(beats) > 3)
    assert len(thread.said) == 2 and "has not run its first cycle yet" in thread.said[1]


def test_a_loop_that_goes_before_its_first_cycle_is_missed_at_once(loop, thread):
    thread.pulse.start()
    until(lambda: thread.said)
    loop.die()
    until(lambda: len(thread.said) > 1)
    assert "has ended" in thread.said[1]


def test_it_turns_aside_once_a_second_with_a_loop_and_without(arm, loop, thread, monkeypatch):
    monkeypatch.setattr(joint_states, "ASIDE_EVERY_NS", 20_000_000)
    loop.start()
    thread.pulse.start()
    until(lambda: len(thread.asides) > 5 and thread.asides[-1] is not None)
    loop.die()
    until(lambda: thread.asides[-1] is None)
    aside = len(thread.asides)
    until(lambda: len(thread.asides) > aside + 2)
    assert thread.asides[-1] is None
    assert thread.pulse.published > 0


def test_a_loop_that_hangs_is_still_looked_at(arm, loop, thread, monkeypatch):
    monkeypatch.setattr(joint_states, "ASIDE_EVERY_NS", 20_000_000)
    loop.start()
    thread.pulse.start()
    until(lambda: thread.cycles)
    loop.pause.set()
    until(lambda: thread.said and "has run no cycle for" in thread.said[-1])
    aside = len(thread.asides)
    until(lambda: len(thread.asides) > aside + 2)
    assert thread.asides[-1] is not None
    loop.pause.clear()
