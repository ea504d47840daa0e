"""What `rtarm status`, `rtarm top` and the page say of an arm of several buses."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from two_buses import NAMES, divided
from virtual import VirtualArm

from rtarm.console.chinese import BUS_STATES
from rtarm.running import status
from rtarm.running.status_tables import buses_words
from rtarm.running.tracking import Window
from rtarm.top.events import happening
from rtarm.top.watch import Look
from rtarm.view.panels import machine_html
from rtarm.view.words import ENGLISH
from shm import files, layout
from shm.words import BusState, Event, Fault

SECOND_NS = 1_000_000_000


@pytest.fixture
def arm() -> Iterator[VirtualArm]:
    arm = VirtualArm.brought_up(divided("episode1"))
    yield arm
    arm.close()


def counters_of(arm: VirtualArm) -> dict[str, Any]:
    record = arm.state.record
    return status.counters(record["counters"], status.counted_buses(record), SECOND_NS)


def report_of(arm: VirtualArm) -> dict[str, Any]:
    joints, buses = ([one.name for one in of] for of in (arm.arm.joints, arm.arm.buses))
    return {
        **status.of_cycle(arm.reader.snapshot(), joints, arm.now_ns, buses=[str(bus) for bus in buses]),
        **counters_of(arm),
        "cycle_age_ms": 1.0,
        "front": {"pid": 1, "heartbeat_age_ms": 1.0},
    }


def test_each_bus_has_its_row_and_all_together_the_load_of_the_busiest(arm: VirtualArm) -> None:
    rows = arm.state.record["buses"]
    rows["bits_on_bus"][:2] = 100_000, 250_000
    found = counters_of(arm)
    assert [(bus["name"], bus["load"], bus["state"]) for bus in found["buses"]] == [
        (NAMES[0], 0.2, "active"),
        (NAMES[1], 0.5, "active"),
    ]
    assert found["bus"]["load"] == 0.5
    for theirs, counted in (("frames_tx", "frames_sent"), ("frames_rx", "frames_received")):
        assert [bus[theirs] for bus in found["buses"]] == rows[counted][:2].tolist()
        assert found["bus"][theirs] == sum(bus[theirs] for bus in found["buses"])
    assert set(found["bus"]) - set(found["buses"][0]) == {"receive_overflows", "stale_reads", "drive_errors"}


def test_an_arm_of_one_bus_has_no_rows() -> None:
    arm = VirtualArm.brought_up("episode1")
    assert "buses" not in counters_of(arm)
    arm.close()


@pytest.mark.parametrize(("state", "begins"), [(BusState.PASSIVE, "The CAN"), (BusState.BUS_OFF, "The CAN")])
def test_a_doubtful_bus_is_named(arm: VirtualArm, state: BusState, begins: str) -> None:
    record = arm.state.record
    record["buses"]["bus_state"][1] = record["counters"]["bus_state"] = state
    (sentence,) = status.problems(report_of(arm))
    assert sentence.startswith(f"Bus {NAMES[1]}: {begins}")
    (sentence,) = status.problems(report_of(arm), "zh")
    assert sentence.startswith(f"总线 {NAMES[1]}：")
    record["buses"]["bus_state"][0] = BusState.PASSIVE
    assert len(status.problems(report_of(arm))) == 2


def test_load_and_state_of_each_are_told_in_words(arm: VirtualArm) -> None:
    rows = arm.state.record["buses"]
    rows["bits_on_bus"][:2], rows["bus_state"][1] = (100_000, 250_000), BusState.WARNING
    buses = counters_of(arm)["buses"]
    assert buses_words(buses) == f"{NAMES[0]} active, load 20.0%; {NAMES[1]} warning, load 50.0%"
    assert buses_words(buses, "zh") == (
        f"{NAMES[0]} {BUS_STATES['active']}，负载 20.0%；{NAMES[1]} {BUS_STATES['warning']}，负载 50.0%"
    )


def test_a_stretch_has_what_rose_in_it_and_the_state_of_its_end(arm: VirtualArm) -> None:
    window = Window(arm.reader)
    before = arm.state.record["buses"]["frames_sent"].copy()
    arm.state.record["buses"]["bus_state"][0] = BusState.WARNING
    arm.cycles(10)
    _, buses, _ = window.counters()
    assert [bus.name for bus in buses] == list(NAMES)
    for number, bus in enumerate(buses):
        assert bus.counted["frames_sent"] == arm.state.record["buses"]["frames_sent"][number] - before[number] > 0
    assert buses[0].counted["bus_state"] == BusState.WARNING
    assert files.buses(arm.state.record["header"])[0].bitrate == buses[0].bitrate


def test_the_page_has_a_row_for_them(arm: VirtualArm) -> None:
    recent = counters_of(arm)
    report = {**report_of(arm), "rate_hz": 120.0, "uptime_s": 1.0, "loop": {"pid": 1}}
    report["scheduling"] = status.scheduling(arm.state.record["scheduling"])
    shown = machine_html(Look("arm", report, recent, 1.0), ENGLISH)
    assert f"{NAMES[0]} active, load" in shown and f"{NAMES[1]} active, load" in shown


def event(**words: float) -> Any:
    made = np.zeros(1, layout.Event.dtype)[0]
    for name, value in words.items():
        made[name] = value
    return made


@pytest.mark.parametrize("number", [0, 1])
def test_events_of_a_wire_name_its_bus_where_there_are_several(number: int) -> None:
    gone = event(kind=Event.FAULT, code=Fault.WIRE, joint=-1, value=5.0, limit=number)
    back = event(kind=Event.WIRE, code=number, joint=-1)
    for of in (gone, back):
        assert happening(of, [], buses=NAMES).sentence.startswith(f"Bus {NAMES[number]}: The ")
        assert happening(of, []).sentence.startswith("The ")
