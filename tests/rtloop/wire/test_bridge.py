"""The bridge to python-can: what passes it in either direction, what is old or no frame, and how it ends.

Real threads and real sockets; the buses are python-can's virtual ones, or one that does what a bad adapter would.
"""

import errno
import os
import queue
import sys
import threading
import time
from types import SimpleNamespace

import can
import can.interfaces.pcan
import can.interfaces.slcan
import numpy as np
import pytest
from can_records import EXTENDED, REMOTE, error_record, record, unpacked
from waiting import until

from config.loader import load_arm
from rtloop.bus.measured import take_what_the_bus_brought
from rtloop.memory.frame_words import EXTENDED as EXTENDED_KIND
from rtloop.memory.link import CAN_FRAME_BYTES
from rtloop.process.initial_state import new_loop
from rtloop.wire import bridge as bridge_module
from rtloop.wire import can_words, outgoing, received
from rtloop.wire.bridge import (
    FAILING_S,
    HELD_BACK_S,
    UNREADABLE,
    Bridge,
    Traffic,
    held_back_bytes,
    is_gone,
    record_of,
)
from rtloop.wire.python_can import all_options, known_options, open_python_can
from rtloop.wire.refusal import WireRefused
from shm import layout

PATIENCE_S = 10.0
TRAFFIC = Traffic(1 / 120, 19)
ANSWER = bytes((0x36, 0, 0, 0, 0x40, 0, 0x6B))
STOP = bytes((0xFE, 0x98, 0x00, 0x6B))


class Clock:
    """The bridge's time, in which a frame grows old only where a test says so, however late the machine is."""

    def __init__(self):
        self._now_ns = time.monotonic_ns()
        self.monotonic, self.sleep = time.monotonic, time.sleep

    def monotonic_ns(self):
        return self._now_ns

    def pass_s(self, seconds):
        self._now_ns += round(seconds * 1e9)


CLOCK = Clock()


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    monkeypatch.setattr("rtloop.wire.bridge.time", CLOCK)


class StrangeBus(can.BusABC):
    """A bus of which a test says what it does: `on_send` gets each message, `coming` is received or raised."""

    def __init__(self, on_send=lambda message: None):
        self.channel_info = "strange"
        self.sent = []
        self.coming = queue.SimpleQueue()
        self.ended = 0
        self.on_send = on_send
        super().__init__("strange")

    def send(self, msg, timeout=None):
        self.on_send(msg)
        self.sent.append(msg)

    def _recv_internal(self, timeout):
        try:
            came = self.coming.get(timeout=timeout)
        except queue.Empty:
            return None, True
        if isinstance(came, Exception):
            raise came
        return came, True

    def shutdown(self):
        super().shutdown()
        self.ended += 1


@pytest.fixture
def make_bridge():
    """Bridges whose cycle's end a test has; all are closed, and leave no thread."""
    before = set(threading.enumerate())
    bridges = []

    def make(bus, traffic=TRAFFIC, *, tells_classes=True):
        bridges.append(Bridge(bus, traffic, tells_classes=tells_classes, prepare=lambda: None))
        return bridges[-1]

    yield make
    for bridge in bridges:
        bridge.close()
        os.close(bridge.fd)
    assert set(threading.enumerate()) <= before


@pytest.fixture
def virtual():
    """Both ends of a virtual bus."""
    channel = f"test-{time.monotonic_ns()}"
    ends = [can.Bus(channel, "virtual", ignore_config=True) for _ in range(2)]
    yield ends
    for end in ends:
        end.shutdown()


def fresh(can_id, data, *, flags=EXTENDED, marks=0, age_s=0.0):
    """A record as a cycle writes it now, or `age_s` ago."""
    made_ms = CLOCK.monotonic_ns() // 1_000_000 - round(age_s * 1e3)
    plain = record(can_id, data, flags=flags)
    return plain[:5] + bytes((marks,)) + (made_ms & 0xFFFF).to_bytes(2, "little") + plain[8:]


def read(bridge):
    """The next message for the reader's thread."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        try:
            return os.read(bridge.fd, 4096)
        except BlockingIOError:
            time.sleep(0.001)
    raise AssertionError("nothing came")


def message(can_id=0x100, data=ANSWER, **options):
    return can.Message(arbitration_id=can_id, data=data, **options)


# --- out --------------------------------------------------------------------------------------------------------------


def test_a_cycle_is_sent_frame_for_frame_in_its_order(make_bridge, virtual):
    bridge = make_bridge(virtual[0])
    frames = [(0x100 + n, bytes(range(n))) for n in range(9)]
    os.write(bridge.fd, b"".join(fresh(can_id, data) for can_id, data in frames))
    os.write(bridge.fd, fresh(0x1FFFFFFF, b"") + fresh(0x7FF, b"\1", flags=0) + fresh(5, bytes(8), flags=REMOTE))
    told = [virtual[1].recv(PATIENCE_S) for _ in range(12)]
    assert [(m.arbitration_id, bytes(m.data)) for m in told[:9]] == frames
    assert all(m.is_extended_id and not m.is_remote_frame for m in told[:10])
    assert (told[9].arbitration_id, told[9].dlc) == (0x1FFFFFFF, 0)
    assert (told[10].arbitration_id, told[10].is_extended_id, bytes(told[10].data)) == (0x7FF, False, b"\1")
    assert (told[11].arbitration_id, told[11].is_extended_id, told[11].is_remote_frame, told[11].dlc) == (
        5,
        False,
        True,
        8,
    )
    assert bridge.unsent_bytes == 0


def test_what_the_bus_does_not_take_in_time_is_refused_to_the_cycle_and_what_waited_too_long_is_dropped(make_bridge):
    """But for a stop command: a drive that must stop is told late rather than never."""
    sends, goes_on = threading.Event(), threading.Event()

    def on_send(message):
        sends.set()
        goes_on.wait(PATIENCE_S)

    bus = StrangeBus(on_send)
    bridge = make_bridge(bus)
    taken = 0
    cycle = b"".join(fresh(n << 8, ANSWER) for n in range(1, 20))
    with pytest.raises(BlockingIOError):
        while True:
            os.write(
                bridge.fd, cycle if taken != 1 else cycle[:-CAN_FRAME_BYTES] + fresh(0x100, STOP, marks=can_words.STOP)
            )
            taken += 1
    assert 3 <= taken <= 8  # of which one is being sent, and 25 ms at 120 Hz are three
    assert sends.wait(PATIENCE_S)
    CLOCK.pass_s(2 * HELD_BACK_S)
    goes_on.set()
    until(lambda: bridge.unsent_bytes // CAN_FRAME_BYTES + len(bus.sent) == 19 * taken)
    assert [bytes(m.data) for m in bus.sent] == [ANSWER, STOP]
    os.write(bridge.fd, fresh(0x200, ANSWER))
    until(lambda: len(bus.sent) == 3)


def test_age_is_counted_across_the_end_of_its_sixteen_bits(make_bridge):
    bus = StrangeBus()
    bridge = make_bridge(bus)
    for age_s in (0.0, HELD_BACK_S - 0.001, HELD_BACK_S + 0.001, 30.0, 65.0):
        os.write(bridge.fd, fresh(0x100 + round(age_s), b"", age_s=age_s))
    until(lambda: len(bus.sent) + bridge.unsent_bytes // CAN_FRAME_BYTES == 5)
    assert [m.arbitration_id for m in bus.sent] == [0x100, 0x100]


def test_frames_that_the_bus_refuses_are_counted_and_those_after_them_are_sent(make_bridge):
    refuses = [can.CanOperationError("the transmit buffer is full"), can.CanTimeoutError("no room"), ValueError("odd")]

    def on_send(message):
        if message.arbitration_id < len(refuses):
            raise refuses[message.arbitration_id]

    bus = StrangeBus(on_send)
    bridge = make_bridge(bus)
    os.write(bridge.fd, b"".join(fresh(n, b"") for n in range(6)))
    until(lambda: len(bus.sent) == 3)
    assert bridge.unsent_bytes == 3 * CAN_FRAME_BYTES
    assert (bridge.trouble, bus.ended) == ("", 0)


def test_no_drive_gets_half_a_command(make_bridge):
    """Neither because the second packet is old by then, nor because the first one was refused."""

    def on_send(message):
        if message.arbitration_id == 0x100:
            CLOCK.pass_s(1.5 * HELD_BACK_S)
        if message.arbitration_id == 0x300:
            raise can.CanOperationError("the transmit buffer is full")

    bus = StrangeBus(on_send)
    bridge = make_bridge(bus)
    pairs = [(fresh(n << 8, bytes(8), marks=can_words.JOINED), fresh(n << 8 | 1, b"")) for n in (1, 2)]
    os.write(bridge.fd, b"".join(first + second for first, second in pairs))
    until(lambda: len(bus.sent) + bridge.unsent_bytes // CAN_FRAME_BYTES == 4)
    assert [m.arbitration_id for m in bus.sent] == [0x100, 0x101]
    os.write(bridge.fd, fresh(0x300, bytes(8), marks=can_words.JOINED) + fresh(0x301, b"") + fresh(0x400, b""))
    until(lambda: len(bus.sent) + bridge.unsent_bytes // CAN_FRAME_BYTES == 7)
    assert [m.arbitration_id for m in bus.sent[2:]] == [0x400]


def test_a_slow_arm_with_many_joints_has_room_too():
    for traffic in (Traffic(1 / 120, 19), Traffic(1 / 43, 97), Traffic(1 / 1000, 4)):
        one = traffic.frames_per_cycle * CAN_FRAME_BYTES
        held_back_s = held_back_bytes(traffic) / (one + 768) * traffic.period_s
        assert held_back_s <= max(HELD_BACK_S, 2 * traffic.period_s)


# --- in ---------------------------------------------------------------------------------------------------------------


def test_what_others_send_comes_as_the_cycle_reads_it(make_bridge, virtual):
    bridge = make_bridge(virtual[0])
    told = [
        (message(0x100), (0x100 | EXTENDED, ANSWER)),
        (message(0x1FFFFFFF, b""), (0x1FFFFFFF | EXTENDED, b"")),
        (message(0x7FF, bytes(8), is_extended_id=False), (0x7FF, bytes(8))),
        (message(0x049, None, is_extended_id=False, is_remote_frame=True, dlc=8), (0x049 | REMOTE, bytes(8))),
    ]
    for sent, _ in told:
        virtual[1].send(sent)
    for _, expected in told:
        assert unpacked(read(bridge)) == [expected]


def test_error_frames_keep_their_class_where_the_interface_tells_linux_classes():
    said = message(can_words.CONTROLLER, b"\0\x20", is_error_frame=True)
    assert record_of(said, True) == error_record(can_words.CONTROLLER, b"\0\x20")
    assert record_of(said, False) == error_record(can_words.BUS_ERROR)


@pytest.mark.parametrize(
    "hostile",
    [
        message(0x20000000),
        message(0x800, is_extended_id=False),
        message(-1),
        message(0x100, dlc=9),
        message(0x100, bytes(8), dlc=7),
        message(0x100, bytes(20), dlc=20),
        message(0x100, None, is_remote_frame=True, dlc=200),
    ],
    ids=[
        "30 bits",
        "12 bits",
        "negative",
        "longer than it is",
        "shorter than it is",
        "20 bytes",
        "200 bytes asked for",
    ],
)
def test_what_is_no_classic_frame_is_told_to_the_cycle_as_unreadable(hostile):
    assert record_of(hostile, True) == UNREADABLE


def test_what_is_nothing_to_the_cycle_is_not_told():
    assert record_of(message(0x100, bytes(64), is_fd=True), True) is None
    assert record_of(message(0x100, is_rx=False), True) is None  # gs_usb reports what has left


def test_an_unreadable_line_is_counted_and_the_next_one_heard(make_bridge):
    bus = StrangeBus()
    bridge = make_bridge(bus)
    bus.coming.put(ValueError("invalid literal for int() with base 16: '0000Z100'"))
    bus.coming.put(message())
    assert [read(bridge), unpacked(read(bridge))] == [UNREADABLE, [(0x100 | EXTENDED, ANSWER)]]
    assert bridge.trouble == ""


def test_errors_with_sound_frames_between_them_are_no_reason_to_close(make_bridge):
    """For longer than a bus may fail without one."""
    bus = StrangeBus()
    bridge = make_bridge(bus)
    until_s = time.monotonic() + 3 * FAILING_S
    while time.monotonic() < until_s:
        bus.coming.put(can.CanOperationError("garbled"))
        bus.coming.put(message())
        assert [read(bridge), read(bridge)[:1]] == [UNREADABLE, b"\0"]
    bus.coming.put(can.CanOperationError("garbled"))
    assert read(bridge) == UNREADABLE
    assert bridge.trouble == ""


def test_more_than_the_reader_takes_is_dropped_and_counted(make_bridge):
    """The system keeps some hundred frames for it."""
    bus = StrangeBus()
    bridge = make_bridge(bus)
    sent = 2000
    for _ in range(sent):
        bus.coming.put(message())
    until(lambda: bus.coming.empty() and bridge.dropped_bytes > 0)
    bus.coming.put(can.CanOperationError("no frame"))  # what came before it was handed over or dropped
    until(bus.coming.empty)
    assert 100 * CAN_FRAME_BYTES < bridge.dropped_bytes < sent * CAN_FRAME_BYTES


# --- the end ----------------------------------------------------------------------------------------------------------


def ends(bridge):
    """Whether the cycle's end finds that the wire is gone, in both directions."""
    until(lambda: bridge.trouble != "")
    try:
        while os.read(bridge.fd, 4096):
            pass
    except ConnectionResetError:
        pass
    with pytest.raises(BrokenPipeError):
        os.write(bridge.fd, fresh(0x100, ANSWER))
    return True


def unplugged(number=errno.EIO):
    """What python-can's serial interfaces raise then: their own error, of one of the system."""
    try:
        try:
            raise OSError(number, os.strerror(number))
        except OSError as cause:
            raise can.CanOperationError("Could not write to serial device") from cause
    except can.CanOperationError as problem:
        return problem


def test_an_adapter_that_is_unplugged_ends_the_wire_at_once(make_bridge):
    bus = StrangeBus()
    bridge = make_bridge(bus)
    bus.coming.put(unplugged())
    assert ends(bridge)
    assert "has lost the adapter (CanOperationError: Could not write to serial device)" in bridge.close()[0]
    assert bus.ended == 1


def test_an_adapter_that_is_gone_when_a_frame_is_sent_ends_the_wire(make_bridge):
    def on_send(message):
        raise unplugged(errno.ENODEV)

    bridge = make_bridge(StrangeBus(on_send))
    os.write(bridge.fd, fresh(0x100, ANSWER))
    assert ends(bridge)
    assert bridge.unsent_bytes == CAN_FRAME_BYTES


def test_a_bus_that_only_fails_any_more_is_gone_after_a_while(make_bridge, monkeypatch):
    bus = StrangeBus()
    bridge = make_bridge(bus)
    began_s = time.monotonic()
    for _ in range(2000):
        bus.coming.put(can.CanOperationError("read failed"))
    assert ends(bridge)
    assert time.monotonic() - began_s >= FAILING_S


def test_reasons_that_pass_are_no_reasons_to_close():
    assert is_gone(unplugged(errno.ENODEV))
    for number in (errno.ENOBUFS, errno.EAGAIN, errno.ETIMEDOUT):
        assert not is_gone(unplugged(number))
    assert not is_gone(can.CanOperationError("the transmit buffer is full"))
    endless = ValueError("of itself")
    endless.__context__ = endless
    assert not is_gone(endless)


def test_closing_amid_everything_ends_all_threads_and_the_bus(make_bridge):
    for _ in range(20):
        bus = StrangeBus()
        bridge = make_bridge(bus)
        for number in range(3):
            os.write(bridge.fd, fresh(number, ANSWER))
            bus.coming.put(message())
        assert bridge.close() == []
        assert bus.ended == 1


def test_a_bus_that_does_not_let_go_is_said_and_not_waited_for(make_bridge, monkeypatch):
    monkeypatch.setattr("rtloop.wire.bridge.END_PATIENCE_S", 0.05)
    lets_go = threading.Event()
    bus = StrangeBus(on_send=lambda message: lets_go.wait(PATIENCE_S))
    bridge = make_bridge(bus)
    os.write(bridge.fd, fresh(0x100, ANSWER))
    time.sleep(0.01)
    (sentence,) = bridge.close()
    assert "did not let go of the adapter" in sentence
    lets_go.set()
    until(lambda: bus.ended == 1)


# --- opening ----------------------------------------------------------------------------------------------------------


def arm_on(interface, channel="here", **options):
    bus = {"interface": "python-can", "channel": channel, "python_can": {"interface": interface, **options}}
    return load_arm("episode1", overrides={"bus": bus})


def refusal(arm):
    with pytest.raises(WireRefused) as refused:
        open_python_can(arm)
    return str(refused.value)


def test_an_arm_finds_the_bus_that_its_file_names(virtual):
    bridge = open_python_can(arm_on("virtual", virtual[0].channel_id, rx_queue_size=100))
    try:
        os.write(bridge.fd, fresh(0x100, ANSWER))
        assert [bytes(end.recv(PATIENCE_S).data) for end in virtual] == [ANSWER, ANSWER]
    finally:
        bridge.close()
        os.close(bridge.fd)


def test_names_that_python_can_does_not_know_are_refused_with_those_it_knows():
    assert "does not know (did you mean virtual?): it knows" in refusal(arm_on("virtuel"))
    sentence = refusal(arm_on("virtual", rx_queue=3))
    assert sentence.startswith("bus.python_can.rx_queue is no option of python-can's virtual: it takes ")
    assert "rx_queue_size" in sentence


def test_options_that_a_class_looks_for_without_naming_them_are_known():
    assert {"auto_reset", "device_id", "bitrate", "state"} <= known_options(can.interfaces.pcan.PcanBus)
    assert "PCANBasic" in refusal(arm_on("pcan", "PCAN_USBBUS1", auto_reset=True))
    assert {"btr", "tty_baudrate"} <= known_options(can.interfaces.slcan.slcanBus)


def test_what_an_interface_needs_besides_is_named(monkeypatch):
    sentence = refusal(arm_on("pcan", "PCAN_USBBUS1"))
    assert "PCANBasic" in sentence and "socketcan" in sentence
    for module in ("gs_usb", "usb"):
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, "can.interfaces.gs_usb", raising=False)
    assert "pip install gs_usb" in refusal(arm_on("gs_usb", "0"))
    monkeypatch.setitem(sys.modules, "can", None)
    assert "pip install python-can" in refusal(arm_on("virtual"))


def test_an_adapter_that_is_not_there_is_said_in_one_sentence(tmp_path):
    sentence = refusal(arm_on("slcan", str(tmp_path / "nothing"), sleep_after_open=0.0))
    assert sentence.startswith(f"python-can's slcan cannot open {tmp_path / 'nothing'} (")
    assert "No such file" in sentence and "\n" not in sentence


def test_a_user_s_own_settings_of_python_can_change_nothing(virtual, monkeypatch):
    """They may name another channel, or what python-can cannot even read: the arm's file says it all."""
    monkeypatch.setenv("CAN_CONFIG", '{"port": "nonsense"}')
    monkeypatch.setenv("CAN_CHANNEL", "elsewhere")
    test_an_arm_finds_the_bus_that_its_file_names(virtual)


def test_options_are_what_the_file_and_the_drives_say():
    assert all_options(arm_on("robotell", "/dev/ttyUSB3")) == {"channel": "/dev/ttyUSB3", "bitrate": 500_000}
    assert all_options(arm_on("gs_usb", "2"))["index"] == 2
    assert all_options(arm_on("slcan", tty_baudrate=1_000_000))["tty_baudrate"] == 1_000_000


# --- in the cycle -----------------------------------------------------------------------------------------------------


@pytest.fixture
def cycle():
    """The loop's record and counters of an arm on python-can that has not run yet."""
    shared = np.zeros(1, layout.StateFile.dtype)
    return SimpleNamespace(loop=new_loop(arm_on("virtual"), shared.ctypes.data, 0), shared=shared)


def test_the_cycle_says_of_each_frame_when_it_was_made_and_what_it_is(cycle):
    """Bytes that a raw CAN socket does not use, in the form in which the bridge reads them."""
    loop, joint = cycle.loop[0], 3
    loop["timing"]["now_ns"] = 123_456_789_012_999_999
    outgoing.send(loop, cycle.shared[0], joint, 0x100, EXTENDED_KIND, 8, 0x0807060504030201, 1)
    outgoing.send(loop, cycle.shared[0], joint, 0x101, EXTENDED_KIND, 1, 0x09, 0)
    outgoing.send(loop, cycle.shared[0], joint, 0x200, EXTENDED_KIND, 2, 0x0201, 0, joint)
    made = 123_456_789_012 & 0xFFFF
    sent = loop["buses"][0]["outgoing"]["bytes"][: 3 * CAN_FRAME_BYTES].tobytes()
    assert list(bridge_module.RECORD.iter_unpack(sent)) == [
        (0x100 | EXTENDED, 8, can_words.JOINED, made, bytes(range(1, 9))),
        (0x101 | EXTENDED, 1, 0, made, b"\x09" + bytes(7)),
        (0x200 | EXTENDED, 2, can_words.STOP, made, b"\x01\x02" + bytes(6)),
    ]


def test_what_was_taken_and_not_sent_is_taken_back_once(cycle):
    counters = cycle.shared[0]["counters"]
    counters["frames_sent"], counters["bytes_sent"] = 10, 10 * CAN_FRAME_BYTES
    unsent = cycle.loop[0]["buses"][0]["received"]["arrived"]
    for in_all in (3, 3, 4):
        unsent["unsent"] = in_all * CAN_FRAME_BYTES
        take_what_the_bus_brought(cycle.loop[0], cycle.shared[0])
        assert counters["frames_sent"] == 10 - in_all
        assert counters["bytes_unsent"] == in_all * CAN_FRAME_BYTES
        assert counters["bytes_sent"] + counters["bytes_unsent"] == 10 * CAN_FRAME_BYTES


def test_what_is_unreadable_is_a_wire_error(cycle):
    data = np.frombuffer(UNREADABLE + record(0x100, ANSWER), np.uint8)
    received.push(cycle.loop[0]["buses"][0], 1_000, data, len(data))
    take_what_the_bus_brought(cycle.loop[0], cycle.shared[0])
    counters = cycle.shared[0]["counters"]
    assert (counters["wire_errors"], counters["frames_received"]) == (1, 1)
