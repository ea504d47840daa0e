"""Claims on a bus: two processes never lead the same drives, and drives of their own they may."""

import contextlib
import os
import secrets
import signal
import socket
from contextlib import closing

import pytest
from arm_files import edited, write_arm
from hypothesis import given
from hypothesis import strategies as st
from stack import Process
from waiting import ready_process, until

from config.frames import STANDARD_MASK, Identifiers, extended, standard
from config.loader import load_arm
from rtarm.doctor.machine import Machine
from rtarm.scan import run as scan_run
from rtarm.scan.adapters import Adapter
from rtloop.wire import claim as claims
from rtloop.wire.claim import claim, claim_for_arm, claim_for_scan
from rtloop.wire.refusal import WireRefused


@pytest.fixture
def bus():
    """A CAN interface that is not there, by a name that no other test has."""
    return f"c{secrets.token_hex(6)}"


@contextlib.contextmanager
def claimed(bus, arm, *used):
    with closing(claim(bus, arm, dict.fromkeys(used, "joint1"))):
        yield


def on_can(bus, name, folder, addresses=range(1, 7), arm="episode1"):
    """The file of an arm on a CAN interface, with drives of these addresses."""
    file = write_arm(arm, name, folder)
    with edited(file) as values:
        values["bus"] = {"interface": "socketcan", "channel": bus, "bitrate": 500_000}
        field = {"episode1": "address", "cia402_6": "node_id"}[arm]
        for joint, address in zip(values["joints"], addresses, strict=True):
            joint["drive"][field] = address
    return file


def process_that_claims(file, program="held = claim_for_arm(load_arm(sys.argv[1]))"):
    """Another process that does so and then waits."""
    imports = "import sys; from config.loader import load_arm; from rtloop.wire.claim import *"
    wait = "print('ready', flush=True); sys.stdin.read()"
    return ready_process("-c", f"{imports}\n{program}\n{wait}", str(file))


# --- which identifiers ----------------------------------------------------------------------------------

patterns = st.builds(
    lambda match, mask: standard(match & mask, mask=mask, from_drive=True),
    st.integers(0, STANDARD_MASK),
    st.integers(0, STANDARD_MASK) | st.sampled_from((STANDARD_MASK, 0x7E0, 0x700)),
)


def everything_of(used):
    """All standard identifiers with these bits, one by one."""
    return {number for number in range(STANDARD_MASK + 1) if number & used.mask == used.match}


@given(st.lists(patterns, min_size=1, max_size=4), st.lists(patterns, min_size=1, max_size=4))
def test_a_claim_is_refused_where_an_identifier_is_taken_and_nowhere_else(first, second):
    bus = f"c{secrets.token_hex(6)}"
    taken = set().union(*map(everything_of, first))
    wanted = set().union(*map(everything_of, second))
    with claimed(bus, "left", *first):
        if taken & wanted:
            with pytest.raises(WireRefused, match=f"^{bus} is in use by arm 'left' .pid {os.getpid()}.*two masters"):
                claim(bus, "right", dict.fromkeys(second, "joint1"))
        else:
            claim(bus, "right", dict.fromkeys(second, "joint1")).close()
    claim(bus, "right", dict.fromkeys(second, "joint1")).close()


@given(st.sets(st.integers(1, 255), min_size=1, max_size=6), st.sets(st.integers(1, 255), min_size=1, max_size=6))
def test_addresses_of_their_own_are_allowed_on_one_bus(left, right):
    """Of ZDT drives, whose identifiers are their address and eight bits."""
    bus = f"c{secrets.token_hex(6)}"
    zdt = [extended(address << 8, mask=0x1FFFFF00, from_drive=True) for address in sorted(left)]
    with claimed(bus, "left", *zdt):
        overlap = contextlib.nullcontext() if left.isdisjoint(right) else pytest.raises(WireRefused)
        with overlap:
            users = {extended(each << 8, mask=0x1FFFFF00, from_drive=True): f"joint{each}" for each in sorted(right)}
            claim(bus, "right", users).close()


def test_standard_and_extended_identifiers_and_other_buses_are_apart(bus):
    with claimed(bus, "left", standard(0, mask=0, from_drive=True)):
        for other_bus, used in ((bus, extended(0, mask=0, from_drive=True)), (f"{bus}x", standard(1, from_drive=True))):
            claim(other_bus, "right", {used: "joint1"}).close()


@pytest.mark.parametrize("arm", ["episode1", "cia402_6"])
def test_an_arm_claims_its_drives_and_a_scan_everything(arm, bus, tmp_path):
    left = load_arm(on_can(bus, "left", tmp_path, arm=arm))
    right = load_arm(on_can(bus, "right", tmp_path, range(6, 12), arm=arm))
    with closing(claim_for_arm(left)):
        with pytest.raises(WireRefused, match=r"arm 'left' .* joint\d of arm 'right' would use the same") as refused:
            claim_for_arm(right)
        assert "addresses of their own" in str(refused.value)
        with pytest.raises(WireRefused, match=r"arm 'left' .* and a scan, which asks every address, would"):
            claim_for_scan(bus)
    scanning = rf"^{bus} is in use by `rtarm scan` .pid {os.getpid()}.*joint1 of arm 'left'"
    with closing(claim_for_scan(bus)), pytest.raises(WireRefused, match=scanning):
        claim_for_arm(left)
    claim_for_arm(right).close()


def test_what_all_drives_of_a_family_hear_has_one_master(bus, tmp_path):
    """Two senders of SYNC would have every CiA 402 drive on the bus take its target twice a cycle."""
    left = load_arm(on_can(bus, "left", tmp_path, arm="cia402_6"))
    right = load_arm(on_can(bus, "right", tmp_path, range(11, 17), arm="cia402_6"))
    refused = pytest.raises(WireRefused, match="would use the same CAN identifiers, 0x0 among them")
    with closing(claim_for_arm(left)), refused:
        claim_for_arm(right)


def test_two_arms_with_drives_of_their_own_share_a_bus(bus, tmp_path):
    with closing(claim_for_arm(load_arm(on_can(bus, "left", tmp_path)))):
        claim_for_arm(load_arm(on_can(bus, "right", tmp_path, range(11, 17)))).close()


def on_python_can(interface, channel):
    return load_arm(
        "episode1",
        overrides={"bus": {"interface": "python-can", "channel": channel, "python_can": {"interface": interface}}},
    )


def test_the_same_interface_by_other_means_is_the_same_bus(bus, tmp_path):
    left = load_arm(on_can(bus, "left", tmp_path))
    with closing(claim_for_arm(left)), pytest.raises(WireRefused, match="arm 'left'"):
        claim_for_arm(on_python_can("socketcan", bus))


def test_a_path_is_the_device_that_it_leads_to_however_long_it_is(tmp_path):
    device = tmp_path / "device"
    link = tmp_path / ("by-id" * 20)
    device.touch()
    link.symlink_to(device)
    by_device, by_link = (on_python_can("slcan", str(path)) for path in (device, link))
    with closing(claim_for_arm(by_device)), pytest.raises(WireRefused, match="arm 'episode1'"):
        claim_for_arm(by_link)


@pytest.mark.parametrize("arm", ["mock", "episode1"])
def test_a_wire_that_is_for_one_process_alone_needs_no_claim(arm):
    """A serial port is opened exclusively."""
    claim_for_arm(load_arm(arm))
    claim_for_arm(load_arm(arm)).close()
    claim_for_arm(on_python_can("virtual", "one"))
    claim_for_arm(on_python_can("virtual", "one")).close()


def test_names_of_others_are_no_claims(bus):
    with contextlib.ExitStack() as opened:
        for behind in ("", "x", "arm/1", "arm/1/y1.2", "arm/one/x1.2", "arm/1/x1", "arm/1/x1.2/3", "arm/1/xg.2"):
            other = opened.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            other.bind(f"\0rtarm.bus/{bus}/{behind}")
        with claimed(bus, "left", Identifiers(0, 0, extended=True, from_drive=True)):
            pass


# --- processes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_claim_falls_with_its_process(number, bus, tmp_path):
    file = on_can(bus, "left", tmp_path)
    with process_that_claims(file) as other:
        with pytest.raises(WireRefused, match=rf"arm 'left' .pid {other.pid}."):
            claim_for_arm(load_arm(file))
        other.send_signal(number)
        other.wait()
        claim_for_arm(load_arm(file)).close()


def test_a_process_that_is_suspended_keeps_its_claim(bus, tmp_path):
    file = on_can(bus, "left", tmp_path)
    with process_that_claims(file) as other:
        other.send_signal(signal.SIGSTOP)
        with pytest.raises(WireRefused, match="arm 'left'"):
            claim_for_arm(load_arm(file))


AMID_CLAIMING = """
from rtloop.wire import claim
held = claim._no_other_claims(load_arm(sys.argv[1]).bus.channel)
held.__enter__()
"""
BEHIND_A_LINE = """
print("ready", flush=True)
sys.stdin.readline()
try:
    held = claim_for_arm(load_arm(sys.argv[1]))
    print("has it", flush=True)
except WireRefused:
    print("refused", flush=True)
"""


def test_one_that_stands_still_amid_claiming_is_said(bus, tmp_path, monkeypatch):
    monkeypatch.setattr(claims, "PATIENCE_S", 0.05)
    file = on_can(bus, "left", tmp_path)
    stands_still = pytest.raises(WireRefused, match=f"starts to use {bus} stands still: end it, then start again")
    with process_that_claims(file, AMID_CLAIMING), stands_still:
        claim_for_arm(load_arm(file))
    claim_for_arm(load_arm(file)).close()


def test_of_many_that_start_together_one_gets_the_bus(bus, tmp_path):
    file = on_can(bus, "left", tmp_path)
    with contextlib.ExitStack() as started:
        others = [started.enter_context(process_that_claims(file, BEHIND_A_LINE)) for _ in range(6)]
        for other in others:
            other.stdin.write("\n")
            other.stdin.flush()
        said = sorted(other.stdout.readline() for other in others)
        assert said == ["has it\n"] + ["refused\n"] * 5


def test_a_scan_leaves_a_claimed_interface_alone(bus, tmp_path, monkeypatch):
    """Without the claim it would say that there is no such interface."""
    there = [Adapter(bus, "socketcan", "a CAN interface")]
    monkeypatch.setattr(scan_run.detection, "adapters", lambda machine: there)

    def why_not():
        (entry,) = scan_run.scan(Machine(), (), detect=lambda: ([], ""))["adapters"]
        assert entry["outcome"] is None
        return entry["not_tried"]

    with closing(claim_for_arm(load_arm(on_can(bus, "left", tmp_path)))):
        assert f"{bus} is in use by arm 'left'" in why_not()
    assert "in use" not in why_not()
    claim_for_scan(bus).close()


@pytest.mark.process
@pytest.mark.parametrize("module", ["rtloop", "rtloop.offline.settings"])
def test_what_leads_drives_of_another_is_refused_before_it_opens_anything(module, bus, arm_name, tmp_path):
    """The interface is not there: what comes so far as to open it says so."""
    with process_that_claims(on_can(bus, "left", tmp_path)) as other:
        process = Process(module, str(file := on_can(bus, arm_name, tmp_path)))
        code = process.code()
        process.close()
        assert code == 2
        (said,) = [line for line in process.text.splitlines() if "compil" not in line]  # the cycle may be
        assert f"{bus} is in use by arm 'left' (pid {other.pid}), and joint1 of arm '{arm_name}' would" in said
    process = Process(module, str(file))
    assert process.code() == 2 and f"There is no CAN interface {bus}" in process.text
    process.close()
    until(lambda: not claim_for_arm(load_arm(file)).close(), "a bus that is free again")
