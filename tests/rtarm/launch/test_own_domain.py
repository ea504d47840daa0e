"""The ROS domain of demo, benchmark and tests: with ports that nobody else has."""

from __future__ import annotations

import contextlib
import socket

import pytest

from rtarm.launch import own_domain
from rtarm.launch.own_domain import DOMAINS, ports_of

HANDED_OUT = range(32768, 61000)
"""By Linux, to whichever program asks for any port."""
LAST_PORT = 65535
AS_PEOPLE_COUNT = range(102)


@pytest.mark.parametrize("domain", DOMAINS)
def test_its_ports_are_there_and_for_ros_alone(domain: int) -> None:
    ports = ports_of(domain)
    assert len(ports) == 250 and ports[-1] <= LAST_PORT
    assert not set(ports) & set(HANDED_OUT)
    assert domain not in AS_PEOPLE_COUNT


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_a_bound_port_is_seen(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    port = ports_of(DOMAINS[0])[-2]
    with socket.socket(family, socket.SOCK_DGRAM) as found:
        with contextlib.suppress(OSError):  # somebody else has it
            found.bind((host, port))
        assert port in own_domain._bound_ports()


def test_one_is_chosen_that_nothing_on_this_machine_uses(monkeypatch: pytest.MonkeyPatch) -> None:
    used, free = DOMAINS[0], DOMAINS[1]
    monkeypatch.setattr(own_domain, "DOMAINS", (used, free))
    for port in (ports_of(used)[0], ports_of(used)[-1]):
        monkeypatch.setattr(own_domain, "_bound_ports", lambda port=port: {port})
        assert {own_domain.own_domain()["ROS_DOMAIN_ID"] for _ in range(20)} == {str(free)}


def test_where_all_are_used_it_is_one_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_domain, "DOMAINS", DOMAINS[:1])
    monkeypatch.setattr(own_domain, "_bound_ports", lambda: set(ports_of(DOMAINS[0])))
    assert own_domain.own_domain() == {
        "ROS_DOMAIN_ID": str(DOMAINS[0]),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
