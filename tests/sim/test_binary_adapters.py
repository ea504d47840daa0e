"""The simulated USB-CAN-A and AT adapters, against the documents' bytes and python-can's own driver of the first."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import can
import pytest
from can.interfaces.seeedstudio.seeedstudio import SeeedBus
from served_arm import serving
from wires import WIRES

from config.loader import load_arm
from rtloop.wire.binary_adapters import EXTENDED_ONLY, NORMAL, STANDARD_ONLY, set_up_frame
from sim.arm import SimulatedArm
from sim.at_adapter import AtAdapter
from sim.bus import Bus, Frame, joined
from sim.drives.ramp import NEVER
from sim.pty import PtyServer
from sim.seeed_adapter import SeeedAdapter

SEEED = next(wire for wire in WIRES if wire.name == "seeedstudio")
AT = next(wire for wire in WIRES if wire.name == "ch340-at")
STATUS_ASKED = bytes.fromhex("AA 55 04 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 04")
FOR_STANDARD = bytes.fromhex("AA 55 12 01 01 00000000 00000000 00 00 00000000 14")
PATIENCE_S = 10.0


def opened(**options: Any) -> SeeedAdapter:
    adapter = SeeedAdapter(1_000_000, **options)
    adapter.feed(0, SEEED.opening)
    return adapter


@pytest.mark.parametrize(("make", "wire"), [(SeeedAdapter, SEEED), (AtAdapter, AT)])
def test_golden_bytes_both_ways(make: Any, wire: Any) -> None:
    for spelt, frame in wire.golden:
        adapter = make(1_000_000)
        adapter.feed(0, spelt)
        assert not adapter.outbox  # not on the bus yet
        adapter.feed(0, wire.opening if frame.extended else FOR_STANDARD)
        adapter.arrivals(0)
        for piece in (spelt, *(spelt[at : at + 1] for at in range(len(spelt)))):
            adapter.feed(0, piece)
        assert [sent for _, sent in adapter.outbox] == [frame] * 2
        adapter.receive(5, frame)
        assert joined(adapter.arrivals(5)) == spelt


def test_a_usb_can_a_delivers_what_it_is_set_to() -> None:
    adapter = opened()
    adapter.receive(0, Frame(0x123, b"\1", extended=False))
    assert joined(adapter.arrivals(0)) == b""
    assert adapter.next_due_ns() == NEVER
    adapter.feed(0, FOR_STANDARD)
    adapter.receive(0, Frame(0x123, b"\1", extended=False))
    adapter.receive(0, Frame(0x123, b"\1"))
    assert joined(adapter.arrivals(0)) == bytes.fromhex("AA C1 23 01 01 55")


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_another_mode_takes_it_off_the_bus_and_drops_what_it_keeps(mode: int) -> None:
    adapter = opened()
    adapter.feed(0, SEEED.spell(Frame(0x100, b"\x36\x6b")))
    assert adapter.outbox and adapter.listening
    adapter.feed(0, set_up_frame(1_000_000, EXTENDED_ONLY, mode))
    assert not adapter.outbox and not adapter.listening and not adapter.is_open


def test_a_set_up_with_a_wrong_sum_is_none() -> None:
    adapter = SeeedAdapter(1_000_000)
    adapter.feed(0, SEEED.opening[:-1] + b"\0")
    assert not adapter.is_open
    adapter.feed(0, SEEED.opening)
    assert adapter.is_open


def test_at_another_rate_nothing_gets_through_and_the_status_says_so() -> None:
    adapter = SeeedAdapter(500_000, depth=2)
    adapter.feed(0, SEEED.opening + SEEED.spell(Frame(0x100, b"")) * 3 + STATUS_ASKED)
    assert not adapter.outbox and not adapter.listening and adapter.lost_frames == 1
    assert joined(adapter.arrivals(0))[:5] == b"\xaa\x55\x04\x00\x02"
    at = AtAdapter(500_000)
    at.feed(0, AT.opening + AT.spell(Frame(0x100, b"")))
    assert at.is_open and not at.listening and not at.outbox


@pytest.mark.parametrize(("byte_14", "sent"), [(0, [0x100, 0x200, 0x300, 0x400]), (1, [0x100, 0x300, 0x400])])
def test_what_loses_the_bus_to_another_is_sent_again_or_lost(byte_14: int, sent: list[int]) -> None:
    """The adapter's 200 and a drive's 100 are ready at once; 300 is ready behind 200, and 400 while the bus is busy."""
    bus, adapter, drive, ear = Bus(1_000_000, 0), SeeedAdapter(1_000_000), opened(), opened()
    bus.nodes += [adapter, drive, ear]
    content = bytes((0x12, 1, 2, *bytes(9), byte_14, *bytes(4)))
    adapter.feed(0, b"\xaa\x55" + content + bytes((sum(content),)))
    adapter.feed(0, SEEED.spell(Frame(0x200, b"\1")) + SEEED.spell(Frame(0x300, b"\1")))
    drive.feed(0, SEEED.spell(Frame(0x100, b"\1")))
    bus.run_until(10_000)
    adapter.feed(10_000, SEEED.spell(Frame(0x400, b"\1")))
    bus.run_until(10**6)
    assert [frame.can_id for frame in SEEED.read(joined(ear.arrivals(10**6)))] == sent
    assert (adapter.lost_arbitrations, drive.lost_arbitrations) == (1, 0)


def test_bytes_take_their_time() -> None:
    byte_ns = 5_000  # 2 Mbaud
    adapter = SeeedAdapter(1_000_000, baud=2_000_000)
    adapter.feed(0, SEEED.opening)
    assert adapter.wake_ns == 20 * byte_ns and not adapter.is_open
    adapter.wake(20 * byte_ns)
    assert adapter.is_open
    adapter.receive(10**6, Frame(0x100, b"\x36\x6b"))
    assert adapter.next_due_ns() == 10**6 + 9 * byte_ns
    assert joined(adapter.arrivals(10**6 + 8 * byte_ns)) == bytes.fromhex("AA E2 00 01 00 00 36 6B")


# --- python-can -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frame_type", "frames"), [("STD", STANDARD_ONLY), ("EXT", EXTENDED_ONLY)])
@pytest.mark.parametrize("bitrate", [1_000_000, 500_000, 250_000, 5_000])
def test_python_can_sets_up_with_the_same_bytes_but_has_frames_sent_once(
    frame_type: str, frames: int, bitrate: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Byte 14 is 01 there, which the last byte, the sum, counts too."""
    written: list[bytes] = []

    class Port:
        def __init__(self, *_: object, **__: object) -> None:
            self.write = lambda data: written.append(bytes(data))
            self.close = lambda: None

    monkeypatch.setattr("can.interfaces.seeedstudio.seeedstudio.serial.Serial", Port)
    SeeedBus("memory", bitrate=bitrate, frame_type=frame_type).shutdown()
    ours = bytearray(set_up_frame(bitrate, frames, NORMAL))
    ours[14] += 1
    ours[19] += 1
    assert written == [bytes(ours)]


@pytest.fixture
def terminal() -> Iterator[str]:
    bus = {"interface": "seeedstudio", "channel": "simulated", "bitrate": 1_000_000}
    arm = SimulatedArm(load_arm("episode1", overrides={"bus": bus}), start_ns=time.monotonic_ns())
    with serving(PtyServer(arm)) as server:
        yield server.tty_path


def test_python_can_reads_a_position(terminal: str) -> None:
    """Its driver knows nothing of ours."""
    with can.Bus(interface="seeedstudio", channel=terminal, bitrate=1_000_000, frame_type="EXT") as bus:
        bus.send(can.Message(arbitration_id=0x100, data=bytes.fromhex("36 6B"), is_extended_id=True))
        deadline = time.monotonic() + PATIENCE_S
        while (answer := bus.recv(1.0)) is None:
            assert time.monotonic() < deadline
    assert (answer.arbitration_id, answer.is_extended_id) == (0x100, True)
    assert bytes(answer.data) == bytes.fromhex("36 00 00 0C 80 00 6B")
