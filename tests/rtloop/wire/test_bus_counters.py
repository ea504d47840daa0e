"""What the cycle counts of each bus, and what it says of one of several."""

from collections.abc import Iterator

import numpy as np
import pytest
from can_records import error_record
from hypothesis import given
from hypothesis import strategies as st
from two_buses import NAMES, divided, divided_values
from virtual import VirtualArm, recording_of

from config.schema import ArmConfig
from rtloop.memory import frame_words
from rtloop.memory.recorder import marks_of
from rtloop.process.run import take_over_wire
from rtloop.wire import can_words, received
from rtloop.wire.slcan import BEL
from sentences.told import latched_sentence
from shm import files, layout
from shm.recording import BUS_MASK, BUS_SHIFT, EXTENDED, IDENTIFIER_MASK, LENGTH_MASK, LENGTH_SHIFT, SENT
from shm.words import BusState, Event, Fault, Mode

ENETDOWN = 100
SUMMED = [name for name in layout.BusCounters.words if name not in ("bus_state", "padding")]
FAMILIES = ("episode1", "odrive6", "mks6", "damiao6", "myactuator6", "cia402_6")


def on_socketcan(name: str = "episode1") -> ArmConfig:
    """An arm on two CAN interfaces."""
    values = divided_values(name)
    for number, bus in enumerate(values["bus"]):
        bus.pop("serial_baud", None)
        bus |= {"interface": "socketcan", "channel": f"can{number}"}
    return ArmConfig.model_validate(values)


def counted(arm: VirtualArm) -> np.ndarray:
    rows: np.ndarray = arm.state.record["buses"]
    return rows


def hear(arm: VirtualArm, bus: int, error_class: int, detail: bytes = b"") -> None:
    """What a bus' controller says comes with the next cycle."""
    arm.receive(arm.now_ns, error_record(error_class, detail), bus)
    arm.cycle()


def told(arm: VirtualArm, language: str = "en") -> str:
    """The sentence of the latched fault."""
    header = arm.state.record["header"]
    snapshot = arm.reader.snapshot()
    return latched_sentence(snapshot, files.joint_names(header), language, files.bus_names(header))


@pytest.fixture(params=FAMILIES)
def arm(request: pytest.FixtureRequest) -> Iterator[VirtualArm]:
    arm = VirtualArm.brought_up(divided(request.param))
    yield arm
    arm.close()


def test_the_totals_are_the_sums_of_the_buses(arm: VirtualArm) -> None:
    errors = counted(arm)["wire_errors"].copy()  # of opening the adapters
    arm.receive(arm.now_ns, bytes([BEL]), 1)
    arm.cycles(50)
    record = arm.state.record
    for name in SUMMED:
        assert record["counters"][name] == counted(arm)[name].sum(), name
    assert (counted(arm)["wire_errors"] - errors).tolist() == [0, 1, 0, 0]
    assert np.all(counted(arm)["frames_sent"][:2] > 50) and np.all(counted(arm)["frames_received"][:2] > 50)
    assert not any(row[name] for row in counted(arm)[2:] for name in SUMMED)


def test_what_a_bus_counts_is_what_went_over_it(arm: VirtualArm) -> None:
    """Compared with the simulated buses, which count for themselves."""
    before = counted(arm).copy(), [sim.bus.frames for sim in arm.sims]
    arm.cycles(40)
    for number, sim in enumerate(arm.sims):
        now, then = counted(arm)[number], before[0][number]
        ours = sum(int(now[name] - then[name]) for name in ("frames_sent", "frames_received"))
        assert ours == pytest.approx(sim.bus.frames - before[1][number], abs=8)  # on their way at either end


def test_each_recorded_frame_says_its_bus(arm: VirtualArm) -> None:
    arm.cycles(20)
    sent = counted(arm)["frames_sent"][:2].tolist()
    buses = arm.state.record["buses"].copy()
    waiting = [int(bus["outgoing"]["frames"]) for bus in arm.memory["buses"][:2]]
    heads = recording_of(arm).frames["head"]
    bus = heads >> BUS_SHIFT & BUS_MASK
    assert set(bus.tolist()) == {0, 1}
    for number in range(2):
        its = heads[bus == number]
        assert np.count_nonzero(its & SENT) == sent[number] - waiting[number]
        assert np.count_nonzero(its & SENT == 0) == buses["frames_received"][number]


def test_the_header_says_what_buses_there_are() -> None:
    arm = VirtualArm(divided("episode1"))
    header = arm.state.record["header"]
    assert files.buses(header) == tuple(files.Bus(name, 500_000) for name in NAMES)
    assert files.bus_names(header) == NAMES
    rings = layout.rings(6, arm.period_ns, 500_000, 500_000)
    assert files.rings(header) == rings and arm.state.record["recorder"]["frame_slots"] == rings.frame_slots
    arm.close()


def test_an_identifier_says_its_bus() -> None:
    arm = VirtualArm(divided("episode1"))
    rows = arm.state.record["identifiers"]
    rows = rows[rows["mask"] != 0]
    assert {(int(row["joint"]) // 3, int(row["bus"])) for row in rows} == {(0, 0), (1, 1)}
    arm.close()


@given(
    bus=st.integers(0, layout.MAX_BUSES - 1),
    identifier=st.integers(0, IDENTIFIER_MASK),
    length=st.integers(0, 8),
    kind=st.sampled_from([frame_words.STANDARD, frame_words.EXTENDED]),
    sent=st.sampled_from([0, SENT]),
)
def test_the_bus_of_a_frame_touches_nothing_else_that_is_said_of_it(
    bus: int, identifier: int, length: int, kind: int, sent: int
) -> None:
    head = identifier | length << LENGTH_SHIFT | int(marks_of(kind)) | sent | bus << BUS_SHIFT
    assert 0 <= head < 2**63
    assert (head >> BUS_SHIFT & BUS_MASK, head & IDENTIFIER_MASK) == (bus, identifier)
    assert head >> LENGTH_SHIFT & LENGTH_MASK == length
    assert (head & SENT, bool(head & EXTENDED)) == (sent, kind == frame_words.EXTENDED)


# --- faults and states of one bus -----------------------------------------------------------------------------


@pytest.mark.parametrize("bus", [0, 1])
@pytest.mark.parametrize(("error", "fault"), [(5, Fault.WIRE), (ENETDOWN, Fault.LINK_DOWN)])
def test_a_fault_of_a_wire_names_its_bus(bus: int, error: int, fault: Fault) -> None:
    arm = VirtualArm.brought_up(divided("episode1"))
    received.close(arm.loop[0]["buses"][bus], error)
    arm.cycle()
    latched = arm.memory["fault"]
    assert (latched["code"], latched["value"], latched["limit"]) == (fault, error, bus)
    assert told(arm).startswith(f"Bus {NAMES[bus]}: The CAN ")
    assert told(arm, "zh").startswith(f"总线 {NAMES[bus]}：CAN ")
    arm.close()


def test_a_fault_of_the_only_wire_names_no_bus() -> None:
    arm = VirtualArm.brought_up("episode1")
    received.close(arm.loop[0]["buses"][0], 5)
    arm.cycle()
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["limit"]) == (Fault.WIRE, 0.0)
    assert told(arm).startswith("The CAN adapter is gone")
    arm.close()


@pytest.mark.parametrize("bus", [0, 1])
def test_bus_off_is_a_fault_of_its_bus(bus: int) -> None:
    arm = VirtualArm.brought_up(on_socketcan())
    hear(arm, bus, can_words.BUS_OFF)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["limit"]) == (Fault.BUS_OFF, bus)
    assert counted(arm)["bus_state"][:2].tolist() == [BusState.BUS_OFF * (number == bus) for number in range(2)]
    assert arm.memory["buses"]["transmit_inhibited"][bus] == 1
    assert arm.memory["mode"] == Mode.FAULT and arm.memory["buses"]["transmit_inhibited"][1 - bus] == 0
    assert told(arm).startswith(f"Bus {NAMES[bus]}: The CAN controller has left the bus")
    arm.close()


def test_the_state_of_all_is_that_of_the_worst() -> None:
    arm = VirtualArm.brought_up(on_socketcan())
    hear(arm, 1, can_words.CONTROLLER | can_words.NO_ACKNOWLEDGE, b"\0\x20")
    hear(arm, 0, can_words.CONTROLLER, b"\0\x08")
    totals = arm.state.record["counters"]
    assert counted(arm)["bus_state"][:2].tolist() == [BusState.WARNING, BusState.PASSIVE]
    assert totals["bus_state"] == BusState.PASSIVE
    assert counted(arm)["error_frames"][:2].tolist() == [1, 1]
    assert counted(arm)["unacknowledged"][:2].tolist() == [0, 1]
    hear(arm, 1, can_words.CONTROLLER, b"\0\x40")
    assert totals["bus_state"] == BusState.WARNING
    arm.close()


def test_the_event_that_a_wire_is_back_says_which() -> None:
    arm = VirtualArm.brought_up(divided("episode1"))
    received.close(arm.loop[0]["buses"][1], 5)
    arm.cycles(3)
    bus = arm.loop[0]["buses"][1]
    bus["received"]["arrived"]["closed"], bus["wire"]["fd"] = 0, 7
    assert take_over_wire(arm.loop[0], arm.state.array[0], bus) == 7
    record = arm.state.record
    events = record["events"][: int(record["events_written"][0])]
    assert events["code"][events["kind"] == Event.WIRE].tolist() == [1]
    arm.close()
