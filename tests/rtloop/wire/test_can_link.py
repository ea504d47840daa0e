"""What netlink says of a CAN interface, from bytes as the kernel makes them; the real kernel is asked in `tests/vm`."""

import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.drives.zdt import zdt_identifiers
from config.frames import standard
from rtloop.wire import can_link
from rtloop.wire.can_link import bitrate_in, link_of, question
from rtloop.wire.can_socket import filters, open_socketcan
from rtloop.wire.can_words import WATCHED
from rtloop.wire.refusal import WireRefused

HEARD = zdt_identifiers(1)


def attribute(kind, content):
    return struct.pack("=HH", 4 + len(content), kind) + content.ljust(-(-len(content) // 4) * 4, b"\0")


def answer(bitrate, *, kind=b"can\0", nested=0x8000):
    """RTM_NEWLINK of an interface with a name, link info and the timing of its bits."""
    timing = struct.pack("=8I", bitrate, 875, 125, 6, 7, 2, 1, 5)
    info = attribute(1, kind) + attribute(2 | nested, attribute(2, b"\0" * 48) + attribute(1, timing))
    body = struct.pack("=BxHiII", socket.AF_UNSPEC, 280, 3, 0x41, 0) + attribute(3, b"can0\0") + attribute(18, info)
    return struct.pack("=LHHLL", 16 + len(body), 16, 0, 1, 0) + body


@pytest.mark.parametrize("nested", [0, 0x8000])
@pytest.mark.parametrize("bitrate", [125_000, 500_000, 1_000_000])
def test_the_bit_rate_is_found_where_the_kernel_puts_it(bitrate, nested):
    assert bitrate_in(answer(bitrate, nested=nested)) == bitrate


def test_no_bit_rate_is_none():
    assert bitrate_in(answer(0)) is None
    assert bitrate_in(struct.pack("=LHHLL", 36, 2, 0, 1, 0) + bytes(20)) is None  # NLMSG_ERROR


@given(st.binary(max_size=200))
def test_any_bytes_are_an_answer_or_none(content):
    found = bitrate_in(answer(500_000)[:32] + content)
    assert found is None or found > 0


@pytest.mark.parametrize("cut", range(0, len(answer(500_000)), 3))
def test_a_cut_answer_is_no_error(cut):
    assert bitrate_in(answer(500_000)[:cut]) in (None, 500_000)


def test_this_kernel_answers_the_question():
    index = socket.if_nametoindex("lo")
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as asked:
        asked.settimeout(5.0)
        asked.send(question(index))
        told = asked.recv(1 << 16)
    assert struct.unpack_from("=BxHi", told, 16)[2] == index
    assert bitrate_in(told) is None


# --- what is refused before a socket is opened ----------------------------------------------------------


@pytest.fixture
def network(tmp_path, monkeypatch):
    """A /sys/class/net of this test's own: `network(name, flags=…)` puts an interface there."""
    monkeypatch.setattr(can_link, "NETWORK", tmp_path)
    monkeypatch.setattr(can_link, "_told_bitrate", lambda index: 250_000 if index == 7 else None)

    def add(name, *, kind=280, flags="0x40041", queue=128, index=3):
        folder = tmp_path / name
        folder.mkdir()
        for file, text in {"type": kind, "flags": flags, "tx_queue_len": queue, "ifindex": index}.items():
            (folder / file).write_text(f"{text}\n")

    return add


def test_what_the_system_says_is_read(network):
    network("can0", queue=10, index=7)
    network("eth0", kind=1)
    assert link_of("can0") == (True, 10, 250_000)
    assert link_of("eth0") is None
    assert can_link.can_interfaces() == ["can0"]


def test_sentences_say_what_to_do(network):
    network("can0", flags="0x40080")
    network("can1", index=7)
    network("eth0", kind=1)
    with pytest.raises(WireRefused, match=r"no CAN interface eth0.*found: can0, can1"):
        open_socketcan("eth0", 500_000, HEARD, 19, 1)
    up = r"txqueuelen 128`, then `sudo ip link set can0 up type can bitrate 500000 restart-ms 100`"
    with pytest.raises(WireRefused, match=rf"can0 is down: set it up with `sudo ip link set can0 {up}"):
        open_socketcan("can0", 500_000, HEARD, 19, 1)
    with pytest.raises(
        WireRefused, match=r"can1 runs at 250000 bit/s, and the arm's bus.bitrate is 500000: take it down"
    ):
        open_socketcan("can1", 500_000, HEARD, 19, 1)


def test_the_filter_is_each_drives_identifiers_extended_and_with_data():
    heard = [*zdt_identifiers(1), *zdt_identifiers(0x1F), standard(0x40, mask=0x7E0, from_drive=True)]
    passing = (0x80000100, 0xDFFFFF00, 0x80001F00, 0xDFFFFF00, 0x040, 0xC00007E0)
    options = filters(heard)
    assert options[socket.CAN_RAW_FILTER] == struct.pack("=6I", *passing)
    assert options[2] == struct.pack("=I", WATCHED)
