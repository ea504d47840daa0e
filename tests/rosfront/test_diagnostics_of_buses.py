"""What /diagnostics and the front's sentences say of an arm of several buses, read from memory in virtual time."""

from types import SimpleNamespace
from typing import Any, cast

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from two_buses import NAMES, divided
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rosfront.diagnostics import Counts, Diagnostics
from rosfront.link import Link
from rosfront.serving import Serving
from rosfront.verdict import fault_of
from rtloop.wire import received
from shm.words import BusState


def statuses(arm: VirtualArm, diagnostics: Diagnostics) -> dict[str, Any]:
    link = cast(Link, SimpleNamespace(reader=arm.reader))
    return {status.name.partition(": ")[2]: status for status in diagnostics.statuses(link)}


def of(config: ArmConfig) -> tuple[VirtualArm, Diagnostics]:
    return VirtualArm.brought_up(config), Diagnostics(config, Serving(config), Counts(), cast(Any, None))


def value(status: Any, key: str) -> str:
    return str(next(pair.value for pair in status.values if pair.key == key))


def is_blamed(found: dict[str, Any], doubtful: int, level: bytes, why: str = "") -> None:
    """Both what is said of all buses and of one is that one's doubt; the other is in order."""
    for part in ("bus", f"bus {NAMES[doubtful]}"):
        assert found[part].level == level
        assert found[part].message.startswith(f"Bus {NAMES[doubtful]}: {why}")
    assert found[f"bus {NAMES[1 - doubtful]}"].level == DiagnosticStatus.OK


def test_each_of_several_buses_has_a_status_of_its_own() -> None:
    arm, diagnostics = of(divided("episode1"))
    found = statuses(arm, diagnostics)
    assert [part for part in found if part.startswith("bus")] == ["bus", *(f"bus {name}" for name in NAMES)]
    sent = [int(value(found[f"bus {name}"], "frames sent")) for name in NAMES]
    assert sent == arm.state.record["buses"]["frames_sent"][:2].tolist()
    assert int(value(found["bus"], "frames sent")) == sum(sent)
    loads = [value(found[part], "load") for part in ("bus", *(f"bus {name}" for name in NAMES))]
    assert loads[0] == max(loads[1:], key=lambda load: float(load.removesuffix("%")))
    arm.close()


def test_the_only_bus_has_none_beside_it() -> None:
    arm, diagnostics = of(load_arm("episode1"))
    assert [part for part in statuses(arm, diagnostics) if part.startswith("bus")] == ["bus"]
    arm.close()


@pytest.mark.parametrize("doubtful", [0, 1])
def test_a_doubtful_bus_is_named_and_the_other_is_in_order(doubtful: int) -> None:
    arm, diagnostics = of(divided("episode1"))
    statuses(arm, diagnostics)
    record = arm.state.record
    record["buses"]["bus_state"][doubtful] = record["counters"]["bus_state"] = BusState.PASSIVE
    is_blamed(statuses(arm, diagnostics), doubtful, DiagnosticStatus.ERROR, "The CAN controller is error-passive")
    arm.close()


def test_a_bus_on_which_nobody_acknowledges_is_named() -> None:
    arm, diagnostics = of(divided("episode1"))
    statuses(arm, diagnostics)
    record = arm.state.record
    record["buses"]["bus_state"][0] = record["counters"]["bus_state"] = BusState.WARNING
    record["buses"]["unacknowledged"][1] += 2
    record["counters"]["unacknowledged"] += 2
    is_blamed(statuses(arm, diagnostics), 1, DiagnosticStatus.WARN)
    arm.close()


def test_what_went_wrong_on_one_bus_since_the_last_report_is_told_of_it() -> None:
    arm, diagnostics = of(divided("episode1"))
    statuses(arm, diagnostics)
    record = arm.state.record
    record["buses"]["wire_errors"][1] += 3
    record["counters"]["wire_errors"] += 3
    found = statuses(arm, diagnostics)
    assert "3 wire errors" in found[f"bus {NAMES[1]}"].message and "3 wire errors" in found["bus"].message
    assert found[f"bus {NAMES[0]}"].level == DiagnosticStatus.OK
    assert statuses(arm, diagnostics)[f"bus {NAMES[1]}"].level == DiagnosticStatus.OK
    arm.close()


@pytest.mark.parametrize("bus", [0, 1])
def test_a_goal_that_a_wire_ends_is_told_which(bus: int) -> None:
    config = divided("episode1")
    arm = VirtualArm.brought_up(config)
    received.close(arm.loop[0]["buses"][bus], 5)
    arm.cycle()
    sentence = fault_of(arm.reader.snapshot(), Serving(config).names)
    assert sentence.startswith(f"Bus {NAMES[bus]}: The CAN adapter is gone")
    arm.close()
