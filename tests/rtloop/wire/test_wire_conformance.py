"""What every wire must do, asked of each in turn: frames both ways, hostile bytes, an arm in virtual time.

A wire is an entry of `wires.WIRES`; what it says and hears is spelt there by its protocol's documents.
"""

import functools
import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import by_address
import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from observer import WireFrame, command_violations, motion_after, motion_frames, motion_violations, truth_of
from virtual import START_NS, VirtualArm
from wires import ANSWER_OF_DRIVE_1, WIRES, Wire

from config.budget import budget
from config.loader import load_arm
from config.schema import ArmConfig
from config.serial_adapters import SERIAL_ADAPTERS
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.memory.link import RX_BYTES, TX_FRAMES
from rtloop.process.initial_state import new_loop
from rtloop.process.run import take_over_wire
from rtloop.wire import outgoing, received
from rtloop.wire.binary_adapters import EXTENDED_ONLY, NORMAL, set_up_frame
from shm import layout
from shm.words import Answer, Fault, Mode, Outcome, Request
from sim.bus import Frame
from sim.faults import LostReplies, Silent

relaxed = settings(deadline=None, max_examples=examples(60))
every_wire = pytest.mark.parametrize("wire", WIRES, ids=str)
every_divisible_wire = pytest.mark.parametrize("wire", [wire for wire in WIRES if wire.unit == 1], ids=str)

READING = Frame(0x100, ANSWER_OF_DRIVE_1)
"""Its bytes begin no frame of any wire."""
MOST_SWALLOWED_BYTES = 64
"""A false beginning takes no more with it than the longest thing that can be collected."""
CYCLE = [(0x300, 1), (0x301, 0), (0x400, 1), (0x401, 0), (0x100, 0), (0x200, 0)]
"""Identifiers of a cycle's frames, and whether the next one belongs to the same command."""


def arm_on(wire: Wire, **bus: Any) -> ArmConfig:
    return load_arm("episode1", overrides={"bus": {**wire.bus, "bitrate": 1_000_000, **bus}})


@functools.cache
def arm_of(name: str) -> ArmConfig:
    return arm_on(next(wire for wire in WIRES if wire.name == name))


class Bench:
    """A cycle's record with this wire, whose bytes are made and eaten by hand."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.shared = np.zeros(1, layout.StateFile.dtype)
        self.shared_address: int = self.shared.ctypes.data
        self.loop = new_loop(arm_of(wire.name), self.shared_address, 0)
        self.loop_address: int = self.loop.ctypes.data

    def put(self, frame: Frame, joined: int = 0) -> bool:
        kind = (EXTENDED if frame.extended else STANDARD) | (REMOTE if frame.remote else 0)
        data = int.from_bytes(frame.data.ljust(8, b"\0"), "little", signed=True)
        return bool(by_address.put(self.loop_address, frame.can_id, kind, len(frame.data), data, joined))

    @property
    def buffer(self) -> bytes:
        outgoing = self.loop[0]["buses"][0]["outgoing"]
        made: bytes = outgoing["bytes"][: int(outgoing["length"])].tobytes()
        return made

    def take(self, count: int) -> bytes:
        data = self.buffer[:count]
        by_address.took(self.loop_address, self.shared_address, count)
        return data

    def hear(self, *pieces: bytes) -> tuple[int, int]:
        """Bring pieces one after the other; frames that came, and errors that were counted."""
        counters = self.shared[0]["counters"]
        before = counters.copy()
        for piece in pieces:
            for at in range(0, len(piece), RX_BYTES // 2):
                part = np.frombuffer(piece[at : at + RX_BYTES // 2], np.uint8)
                by_address.push(self.loop_address, 1_000, part, len(part))
                by_address.take(self.loop_address, self.shared_address)
        frames, errors = (int(counters[name] - before[name]) for name in ("frames_received", "wire_errors"))
        return frames, errors


@pytest.fixture
def bench(wire: Wire) -> Bench:
    return Bench(wire)


def frames_of(wire: Wire) -> st.SearchStrategy[Frame]:
    def of(kind: tuple[bool, bool]) -> st.SearchStrategy[Frame]:
        extended, remote = kind
        data = st.integers(0, 8).map(bytes) if remote else st.binary(max_size=8)
        return st.builds(
            Frame, st.integers(0, 0x1FFFFFFF if extended else 0x7FF), data, st.just(extended), st.just(remote)
        )

    return st.sampled_from(wire.kinds).flatmap(of)


# --- one frame ----------------------------------------------------------------------------------------------


@every_wire
def test_golden_bytes_are_what_is_sent(bench: Bench, wire: Wire) -> None:
    for spelt, frame in wire.golden:
        assert bench.put(frame)
        assert bench.take(len(spelt) + 1) == spelt
        assert wire.spell(frame) == spelt


@every_wire
def test_golden_bytes_are_heard(bench: Bench, wire: Wire) -> None:
    for spelt, frame in wire.golden:
        assert bench.hear(spelt) == (0 if frame.remote else 1, 0)


@every_wire
@relaxed
@given(data=st.data())
def test_every_frame_comes_back(wire: Wire, data: st.DataObject) -> None:
    frame = data.draw(frames_of(wire))
    bench = Bench(wire)
    assert bench.put(frame)
    sent = bench.take(len(bench.buffer))
    assert wire.read(sent) == [frame]
    assert bench.hear(sent) == (0 if frame.remote else 1, 0)


@every_wire
def test_what_is_heard_is_what_was_said(wire: Wire) -> None:
    """Positions of drive 1 tell: every byte of identifier and data stands where it should."""
    for counts in (1, -1, 0x12345678, -0x55AA0D0A, 0x0D0A5441):
        bench = Bench(wire)
        data = bytes([0x36, counts < 0]) + abs(counts).to_bytes(4, "big") + b"\x6b"
        assert bench.hear(wire.spell(Frame(0x100, data))) == (1, 0)
        joint, axis = arm_of(wire.name).joints[0], bench.loop[0]["axes"][0]
        wanted_rad = joint.direction * counts / joint.encoder_counts_per_rad - joint.zero_rad
        assert axis["measured"]["position_rad"] == pytest.approx(wanted_rad, rel=1e-12)
        for other in (Frame(0x000, data), Frame(0x700, data)):
            assert bench.hear(wire.spell(other)) == (1, 0)
        assert axis["measured"]["readings"] == 1


@every_wire
def test_kinds_that_it_does_not_carry_are_not_sent(bench: Bench, wire: Wire) -> None:
    for extended in (False, True):
        for remote in (False, True):
            assert bench.put(Frame(0x100, b"\0\0", extended, remote)) == ((extended, remote) in wire.kinds)


# --- a stream of bytes --------------------------------------------------------------------------------------


@every_wire
@relaxed
@given(data=st.data())
def test_every_frame_of_a_stream_is_counted_however_it_is_divided(wire: Wire, data: st.DataObject) -> None:
    stream = data.draw(st.lists(frames_of(wire), max_size=30))
    spelt = b"".join(map(wire.spell, stream))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(spelt) // wire.unit), max_size=20)))
    edges = [0, *(cut * wire.unit for cut in cuts), len(spelt)]
    pieces = [spelt[a:b] for a, b in itertools.pairwise(edges)]
    assert Bench(wire).hear(*pieces) == (sum(not frame.remote for frame in stream), 0)


@every_wire
def test_noise_is_counted_and_the_next_frame_is_heard(wire: Wire) -> None:
    for noise, errors in wire.noise:
        bench = Bench(wire)
        assert bench.hear(noise + wire.spell(READING)) == (1, errors), noise
        assert bench.hear(wire.spell(READING)) == (1, 0), noise


@every_wire
@relaxed
@given(noise=st.binary(max_size=400), end=st.integers(0, 40))
def test_no_bytes_whatever_hinder_those_that_follow(wire: Wire, noise: bytes, end: int) -> None:
    bench = Bench(wire)
    beginning = (wire.golden[0][0] * 4)[:end]
    noise = (noise + beginning)[: (len(noise) + len(beginning)) // wire.unit * wire.unit]
    spelt = wire.spell(READING)
    bench.hear(noise)
    bench.hear(spelt * (MOST_SWALLOWED_BYTES // len(spelt) + 1))
    for _ in range(3):
        assert bench.hear(spelt) == (1, 0)


@every_divisible_wire
def test_a_frame_that_was_cut_costs_itself(wire: Wire) -> None:
    for cut_frame in (READING, Frame(0x200, bytes(8)), Frame(0x300, b"")):
        whole = wire.spell(cut_frame)
        for length in range(1, len(whole)):
            bench = Bench(wire)
            heard, errors = bench.hear(whole[:length], wire.spell(READING) * 3)
            if wire.cut_costs == 0:
                assert (heard, errors) == (3, 1), whole[:length]
            else:  # a line without its end may be whole, with what follows for a stamp
                assert (heard, errors) in ((3 - wire.cut_costs, 1), (3, 0)), whole[:length]


@every_divisible_wire
def test_a_byte_too_many_or_a_wrong_one_costs_one_frame(wire: Wire) -> None:
    spelt = wire.spell(READING)
    for at in range(len(spelt)):
        doubled = spelt[:at] + spelt[at : at + 1] + spelt[at:]
        wrong = spelt[:at] + bytes([spelt[at] ^ 0x80]) + spelt[at + 1 :]
        for spoilt in (doubled, wrong):
            bench = Bench(wire)
            heard, errors = bench.hear(spelt + spoilt + spelt * 3)
            assert heard >= 4 - wire.cut_costs and errors <= 1
            assert bench.hear(spelt) == (1, 0)


@every_wire
def test_a_ring_that_overflows_loses_what_it_has_no_room_for(bench: Bench, wire: Wire) -> None:
    spelt = wire.spell(READING)
    flood = np.frombuffer(spelt * (RX_BYTES // len(spelt) + 10), np.uint8)
    by_address.push(bench.loop_address, 1, flood, len(flood))
    by_address.take(bench.loop_address, bench.shared_address)
    counters = bench.shared[0]["counters"]
    assert counters["receive_overflows"] == len(flood) - RX_BYTES
    assert counters["frames_received"] == RX_BYTES // len(spelt)
    bench.hear(spelt * 2)
    assert bench.hear(spelt) == (1, 0)


@every_wire
def test_nothing_of_another_wire_is_half_a_frame_of_this_one(bench: Bench, wire: Wire) -> None:
    bench.hear(wire.spell(READING)[: max(len(wire.spell(READING)) // 2 // wire.unit * wire.unit, 0)])
    bench.loop[0]["buses"][0]["wire"]["fd"] = 7
    take_over_wire(bench.loop[0], bench.shared[0], bench.loop[0]["buses"][0])
    assert bench.hear(wire.spell(READING)) == (1, 0)


# --- what is sent -------------------------------------------------------------------------------------------


@every_wire
@relaxed
@given(data=st.data())
def test_whatever_it_takes_no_frame_is_cut_and_no_command_torn(wire: Wire, data: st.DataObject) -> None:
    """Cycle after cycle with any part taken: what is half on its way goes first, and the rest is not sent late."""
    bench, arrived = Bench(wire), b""
    for number in range(data.draw(st.integers(1, 6)) + 1):
        by_address.begin(bench.loop_address, bench.shared_address)
        for can_id, joined in CYCLE:
            assert bench.put(Frame(can_id, bytes([number])), joined)
        whole = len(bench.buffer)
        arrived += bench.take(data.draw(st.integers(0, whole // wire.unit)) * wire.unit)
    arrived += bench.take(len(bench.buffer))
    frames = [(frame.can_id, frame.data[0]) for frame in wire.read(arrived)]
    for (can_id, number), after in itertools.pairwise([*frames, (0, -1)]):
        assert can_id not in (0x300, 0x400) or after == (can_id + 1, number)
    assert [number for _, number in frames] == sorted(number for _, number in frames)


@every_wire
def test_a_full_buffer_takes_no_more_and_what_it_took_is_whole(bench: Bench, wire: Wire) -> None:
    frame = Frame(0x1FFFFFFF, b"\xff" * 8)
    count = 0
    while bench.put(frame):
        count += 1
    assert 0 < count == int(bench.loop[0]["buses"][0]["outgoing"]["frames"]) <= TX_FRAMES
    assert not outgoing.has_room(bench.loop[0]["buses"][0], 1)
    assert wire.read(bench.buffer) == [frame] * count


# --- an arm -------------------------------------------------------------------------------------------------


class Rig:
    """An arm of this wire in virtual time, brought up where a recorded goal begins."""

    def __init__(self, wire: Wire, goal: str = "large", **bus: Any) -> None:
        self.wire = wire
        self.arm = VirtualArm.at_start_of(goal, arm_on(wire, **bus), opening=wire.opening, **wire.options)
        self._goal = goal

    def play(self) -> int:
        return self.arm.play(self._goal)

    @property
    def told(self) -> list[WireFrame]:
        return [
            WireFrame(time_ns, frame.can_id, frame.data)
            for time_ns, data in self.arm.sent
            for frame in self.wire.read(data)
        ]

    def judged(self) -> list[str]:
        motion = motion_violations(self.arm.arm, truth_of(self.arm.sim), START_NS, self.arm.sim.now_ns)
        return [*command_violations(self.arm.arm, self.told), *motion]


@pytest.fixture
def rig(wire: Wire) -> Iterator[Rig]:
    found = Rig(wire)
    yield found
    found.arm.close()


@pytest.fixture(scope="module")
def by_others() -> dict[str, Any]:
    """What the arm of the wire that was asked first has told and done."""
    return {}


@every_wire
def test_a_goal_moves_the_drives_alike_on_every_wire(wire: Wire, by_others: dict[str, Any]) -> None:
    rig = Rig(wire, serial_baud="cdc")  # whose line takes no time, as a socket takes none
    counters = rig.arm.state.record["counters"]
    at_first = int(counters["wire_errors"])  # what an adapter says while it is opened, which is read here too
    assert rig.arm.end_of(rig.play()) == Outcome.SUCCEEDED
    assert rig.judged() == []
    assert (counters["wire_errors"], counters["receive_overflows"], counters["bytes_unsent"]) == (at_first, 0, 0)
    found = {"told": rig.told, "truth": truth_of(rig.arm.sim)}
    first = by_others.setdefault("first", found)
    assert found["told"] == first["told"]
    for name, joint in found["truth"].items():
        assert np.array_equal(joint.times_ns, first["truth"][name].times_ns)
        assert np.array_equal(joint.position_rad, first["truth"][name].position_rad)
    rig.arm.close()


@pytest.mark.parametrize("wire", [wire for wire in WIRES if (False, True) in wire.kinds], ids=str)
def test_drives_with_standard_identifiers_that_are_asked_by_remote_frames(wire: Wire) -> None:
    """ODrives on every wire that carries both."""
    arm = VirtualArm.at_start_of(
        "small",
        load_arm("odrive6", overrides={"bus": {**wire.bus, "bitrate": 1_000_000}}),
        opening=wire.opening if wire.opening_standard is None else wire.opening_standard,
        **wire.options,
    )
    assert arm.end_of(arm.play("small")) == Outcome.SUCCEEDED
    remote = [frame for _, data in arm.sent for frame in wire.read(data) if frame.remote]
    assert remote and not any(frame.extended for frame in remote)
    arm.close()


def test_an_arm_comes_up_and_moves_although_frames_lose_the_bus_to_answers() -> None:
    """A USB-CAN-A, set up as rtarm does it, on a bus where drives answer while the next question is on its way."""
    wire = next(wire for wire in WIRES if wire.name == "seeedstudio")
    config = arm_on(wire)
    rig = Rig(replace(wire, opening=set_up_frame(config.bus.bitrate, EXTENDED_ONLY, NORMAL)))
    assert rig.arm.end_of(rig.play()) == Outcome.SUCCEEDED
    assert rig.judged() == []
    assert rig.arm.sim.adapter.lost_arbitrations > 100
    rig.arm.close()


@every_wire
def test_bytes_and_bits_are_those_of_the_budget(rig: Rig, wire: Wire) -> None:
    """A hundred cycles in motion, at the speed that the adapter's serial line has."""
    expected = budget(rig.arm.arm)
    rig.play()
    rig.arm.cycles(60)
    assert rig.arm.memory["mode"] == Mode.EXECUTING
    counters = rig.arm.state.record["counters"]
    before, first = counters.copy(), len(rig.arm.sent)
    rig.arm.cycles(100)
    grown = {
        name: int(counters[name] - before[name])
        for name in ("frames_sent", "frames_received", "bits_on_bus", "bytes_received")
    }
    sent = sum(frames.count for frames in expected.frames if frames.from_host)
    answers = expected.frames_per_cycle - sent
    assert grown["frames_sent"] == 100 * sent
    assert abs(grown["frames_received"] - 100 * answers) <= answers
    assert abs(grown["bits_on_bus"] - 100 * expected.bits_per_cycle) <= expected.bits_per_cycle
    sizes = {len(data) for _, data in rig.arm.sent[first:]}
    if wire.unit > 1:
        assert sizes == {sent * wire.unit}
        assert grown["bytes_received"] == grown["frames_received"] * wire.unit
        return
    assert sizes == {expected.chars_out_per_cycle}
    adapter = SERIAL_ADAPTERS[wire.bus["interface"]]
    beyond = (wire.answered - adapter.reply_bytes) * sent + wire.stamp * answers
    brought = expected.chars_in_per_cycle + beyond
    assert abs(grown["bytes_received"] - 100 * brought) <= brought


@every_wire
def test_lost_answers_do_not_stop_the_arm(rig: Rig) -> None:
    goal = rig.play()
    rig.arm.cycles(30)
    rig.arm.sim.inject(LostReplies(0.1), since_ns=rig.arm.now_ns)
    assert rig.arm.end_of(goal) == Outcome.SUCCEEDED
    assert rig.judged() == []


@every_wire
def test_a_silent_drive_is_latched(rig: Rig) -> None:
    rig.play()
    rig.arm.cycles(60)
    rig.arm.sim.inject(Silent("joint2", at_s=0.0), since_ns=rig.arm.now_ns)
    rig.arm.until(lambda: rig.arm.memory["mode"] == Mode.FAULT)
    assert (rig.arm.memory["fault"]["code"], rig.arm.memory["fault"]["joint"]) == (Fault.STALE_READING, 1)
    rig.arm.cycles(200)
    assert rig.judged() == []


@every_wire
def test_a_wire_that_is_back_moves_nothing_until_the_fault_is_cleared(rig: Rig) -> None:
    arm = rig.arm
    goal = rig.play()
    arm.cycles(60)
    gone_ns, since = arm.now_ns, len(arm.sent)
    received.close(arm.loop[0]["buses"][0], 5)
    arm.cycles(3)
    assert arm.sent[since:] == [] and arm.memory["fault"]["code"] == Fault.WIRE and arm.outcome(goal) == Outcome.FAULT
    assert arm.ask(Request.CLEAR_FAULT) == Answer.REFUSED_WIRE
    arm.loop[0]["buses"][0]["received"]["arrived"]["closed"] = 0
    arm.loop[0]["buses"][0]["wire"]["fd"] = 7
    assert take_over_wire(arm.loop[0], arm.state.array[0], arm.loop[0]["buses"][0]) == 7
    arm.cycles(200)
    assert not any(motion_frames(rig.told, drive, gone_ns) for drive in range(1, 7))
    assert motion_after(truth_of(arm.sim), gone_ns + 500_000_000, arm.sim.now_ns) == []
    assert arm.now_ns - arm.loop[0]["axes"]["measured"]["time_ns"][:6].min() < 3 * arm.period_ns
    assert arm.clear_fault().failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    assert rig.judged() == []
