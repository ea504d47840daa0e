"""Serial adapters of every kind are opened in whatever state a predecessor has left them, over a pseudo-terminal.

The adapters are simulated at byte level (`sim`); the bus behind them has real drives' answers and 1 Mbit/s.
"""

import contextlib
import os
import select
import termios
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from served_arm import serving
from waiting import until
from wires import WIRES, Wire

from config.loader import load_arm
from rtloop.process.opening import close_wire, open_wire
from rtloop.wire import tty
from rtloop.wire.refusal import WireRefused
from sim.arm import SimulatedArm
from sim.bus import Frame
from sim.pty import PtyServer

pytestmark = pytest.mark.process  # adapters behind pseudo-terminals answer in real time

PATIENCE_S = 10.0
SERIAL = [wire for wire in WIRES if wire.unit == 1]
QUESTION = Frame(0x100, b"\x36\x6b")
KILLED_AT = (1, 2, 5, 12)
"""Bytes of a frame that a predecessor had written when it was killed."""


class Served:
    """A simulated arm at a pseudo-terminal, in a thread of its own."""

    def __init__(self, wire: Wire, **bus: Any) -> None:
        self.arm = load_arm(
            "episode1", overrides={"bus": {**wire.bus, "bitrate": 1_000_000, "channel": "simulated", **bus}}
        )
        self.sim = SimulatedArm(self.arm, start_ns=time.monotonic_ns(), **wire.options)
        self._ends = contextlib.ExitStack()
        self._server = self._ends.enter_context(serving(PtyServer(self.sim)))
        self.arm = self.arm.on_every_bus(channel=self._server.tty_path)

    def left_behind(self, data: bytes) -> None:
        """A predecessor writes and is killed."""
        fd = os.open(self._server.tty_path, os.O_RDWR | os.O_NOCTTY)
        os.write(fd, data)
        until(lambda: self.sim.adapter._received_ns > 0)
        os.close(fd)

    def close(self) -> None:
        self._ends.close()


@pytest.fixture
def served(wire: Wire) -> Iterator[Served]:
    found = Served(wire)
    yield found
    found.close()


def answer(served: Served, fd: int, wire: Wire) -> bytes:
    """What comes within some time of a question to drive 1, up to its answer."""
    os.write(fd, wire.spell(QUESTION))
    counts = 180 * 25 * 65536 // 360  # zero_deg, ratio, counts a turn
    wanted = wire.spell(Frame(0x100, b"\x36\x00" + counts.to_bytes(4, "big") + b"\x6b")).rstrip(b"\r")
    said = b""
    deadline = time.monotonic() + PATIENCE_S
    while wanted not in said:
        assert time.monotonic() < deadline, said
        if select.select([fd], [], [], 0.1)[0]:
            said += os.read(fd, 4096)
    return said


def opens_and_works(served: Served, wire: Wire) -> None:
    opened = open_wire(served.arm)
    assert opened is not None and opened.complaints == []
    assert served.sim.adapter.is_open and served.sim.adapter.listening
    answer(served, opened.fd, wire)
    close_wire(served.arm, opened)


@pytest.mark.parametrize("wire", SERIAL, ids=str)
def test_an_adapter_is_opened_closed_and_opened_again(served: Served, wire: Wire) -> None:
    for _ in range(2):
        opens_and_works(served, wire)
        if wire.name != "ch340-at":  # nothing is known that would close it
            until(lambda: not served.sim.adapter.is_open)


@pytest.mark.parametrize(("name", "speed"), [("seeedstudio", termios.B2000000), ("ch340-at", termios.B921600)])
def test_a_binary_adapter_that_is_taken_for_a_usb_device_gets_its_speed(name: str, speed: int) -> None:
    wire = next(wire for wire in SERIAL if wire.name == name)
    with contextlib.closing(Served(wire, serial_baud="cdc")) as served:
        opened = open_wire(served.arm)
        assert opened is not None
        assert termios.tcgetattr(opened.fd)[4:6] == [speed, speed]
        close_wire(served.arm, opened)


@pytest.mark.parametrize("wire", SERIAL, ids=str)
@pytest.mark.parametrize("killed_at", KILLED_AT)
def test_a_channel_that_is_open_and_half_a_frame_are_left_behind(served: Served, wire: Wire, killed_at: int) -> None:
    served.left_behind(wire.left_open + wire.spell(Frame(0x200, b"\xfd\x01\x02\x03\x04\x05\x06\x07"))[:killed_at])
    opens_and_works(served, wire)
    assert served.sim.bus.frames == 2  # the question and its answer: what was half said went nowhere


@pytest.mark.parametrize("wire", [wire for wire in SERIAL if wire.name == "seeedstudio"], ids=str)
def test_a_usb_can_a_gets_as_long_after_its_set_up_as_others_give_it(served: Served) -> None:
    began_s = time.monotonic()
    opened = open_wire(served.arm)
    assert opened is not None and time.monotonic() - began_s >= 0.1
    close_wire(served.arm, opened)


@pytest.mark.parametrize("wire", [wire for wire in SERIAL if wire.name == "slcan-canable"], ids=str)
def test_a_canable_that_was_left_silent_speaks_again(served: Served, wire: Wire) -> None:
    served.left_behind(b"C\rS8\rM1\rO\r")
    opens_and_works(served, wire)


@pytest.mark.parametrize("wire", [wire for wire in SERIAL if wire.name == "ch340-at"], ids=str)
def test_a_handshake_without_an_answer_is_a_complaint(served: Served) -> None:
    served.sim.adapter.refuses_open = True
    opened = open_wire(served.arm)
    assert opened is not None
    (complaint,) = opened.complaints
    assert "has not answered its handshake" in complaint
    close_wire(served.arm, opened)


# --- adapters that are not what they should be -------------------------------------------------------------


class Scripted:
    """A terminal whose other end answers what it is asked by a table."""

    def __init__(self, answers: dict[bytes, bytes], always: bytes = b"") -> None:
        self.heard = b""
        self._master, self._slave = os.openpty()
        tty.std_tty.setraw(self._slave)
        self.channel = os.ttyname(self._slave)
        self._answers, self._always = answers, always
        self._going = True
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        rest = b""
        while self._going:
            if self._always:
                os.write(self._master, self._always)
            if not select.select([self._master], [], [], 0.01)[0]:
                continue
            data = os.read(self._master, 4096)
            self.heard += data
            *lines, rest = (rest + data).split(b"\r")
            for line in lines:
                os.write(self._master, self._answers.get(line, b""))

    def close(self) -> None:
        self._going = False
        self._thread.join()
        os.close(self._slave)
        os.close(self._master)


@pytest.fixture
def scripted() -> Iterator[Callable[..., Scripted]]:
    made: list[Scripted] = []

    def make(*arguments: Any, **options: Any) -> Scripted:
        made.append(Scripted(*arguments, **options))
        return made[-1]

    yield make
    for adapter in made:
        adapter.close()


BANNER = b"CANable-b158aa7 github.com/normaldotcom/canable-fw.git\r"


@pytest.mark.parametrize(
    ("answers", "sentence"),
    [
        ({b"S6": BANNER + b"\x07"}, "refuses 500000 bit/s"),
        ({b"S6": b"V1013\rNA123\r\r", b"O": BANNER + b"T00000100236\x07"}, "refuses to open its CAN channel"),
    ],
)
def test_what_an_adapter_says_of_itself_hides_no_refusal(
    scripted: Callable[..., Scripted], answers: dict[bytes, bytes], sentence: str
) -> None:
    with pytest.raises(WireRefused, match=sentence):
        tty.open_slcan(scripted(answers).channel, "cdc", 500_000)


@pytest.mark.parametrize("late", [b"C", b"M0", b""])
def test_what_it_says_to_what_was_asked_before_is_no_refusal(scripted: Callable[..., Scripted], late: bytes) -> None:
    """An adapter that is closed already refuses C, many refuse M0, some an empty line."""
    adapter = scripted({late: b"\x07", b"S6": b"\r", b"O": b"\r"})
    os.close(tty.open_slcan(adapter.channel, "cdc", 500_000))
    assert adapter.heard == b"\r\r\rC\rM0\rS6\rO\r"


def test_an_adapter_that_never_ceases_is_opened_all_the_same(scripted: Callable[..., Scripted]) -> None:
    adapter = scripted({b"S6": b"\r", b"O": b"\r"}, always=b"T0000010023A6B\rVERSION text\r")
    began_s = time.monotonic()
    os.close(tty.open_slcan(adapter.channel, "cdc", 500_000))
    assert time.monotonic() - began_s < PATIENCE_S
    assert adapter.heard.endswith(b"S6\rO\r")


def test_a_port_that_the_kernels_slcan_driver_has_is_left_to_it(
    scripted: Callable[..., Scripted], monkeypatch: pytest.MonkeyPatch
) -> None:
    adapter = scripted({})
    monkeypatch.setattr(tty, "_line_discipline", lambda _: tty.N_SLCAN)
    with pytest.raises(WireRefused, match=r"end slcand, or reach the arm through the CAN interface"):
        tty.open_slcan(adapter.channel, "cdc", 500_000)
    assert adapter.heard == b""


def test_an_ordinary_terminal_has_the_ordinary_line_discipline(scripted: Callable[..., Scripted]) -> None:
    fd = os.open(scripted({}).channel, os.O_RDWR | os.O_NOCTTY)
    assert tty._line_discipline(fd) == 0  # N_TTY
    os.close(fd)
