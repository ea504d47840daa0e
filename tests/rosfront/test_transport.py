"""Our ROS processes use UDP alone, as the kernel sees it, unless the user chose otherwise."""

import os
import re
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from waiting import ready_process

from rosfront.transport import LOCALHOST_PROFILE, choose_udp, may_share_memory

ROOT = Path(__file__).resolve().parents[2]
FAST_DDS = "rmw_fastrtps_cpp"
OURS = str(LOCALHOST_PROFILE)
DOMAIN = 91
SO_TIMESTAMPNS = 35  # of Linux; module socket does not name it
MULTICAST_PORT = 7400 + 250 * DOMAIN
"""Where a participant that other machines may find listens for them (DDSI-RTPS 9.6.1)."""

PROGRAM = """
import os, re
from rosfront.program import start_ros
start_ros([])
import rclpy
node = rclpy.create_node("looked_at")
print(*[os.readlink(entry.path) for entry in os.scandir("/proc/self/fd") if os.path.islink(entry.path)])
print(open("/proc/net/udp").read())
node.destroy_node()
rclpy.shutdown()
"""


@pytest.mark.parametrize(
    ("given", "added"),
    [
        ({}, {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
            {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"},
        ),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
            {
                "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
                "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
                "FASTRTPS_DEFAULT_PROFILES_FILE": OURS,
                "SKIP_DEFAULT_XML_FILE": "1",
            },
        ),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"},
            {
                "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
                "FASTRTPS_DEFAULT_PROFILES_FILE": OURS,
                "SKIP_DEFAULT_XML_FILE": "1",
            },
        ),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}, {}),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTRTPS_DEFAULT_PROFILES_FILE": "my.xml"}, {}),
    ],
)
def test_what_the_user_chose_stays(given: dict[str, str], added: dict[str, str]) -> None:
    environment = dict(given)
    choose_udp(environment, FAST_DDS)
    assert environment == {**given, **added}
    again = dict(environment)
    choose_udp(again, FAST_DDS)  # in a child
    assert again == environment
    assert may_share_memory(environment, FAST_DDS) == (not added)


def test_what_is_set_to_nothing_is_no_choice() -> None:
    environment = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "FASTDDS_BUILTIN_TRANSPORTS": "",
        "FASTRTPS_DEFAULT_PROFILES_FILE": "",
    }
    choose_udp(environment, FAST_DDS)
    assert not may_share_memory(environment, FAST_DDS)


def test_peers_that_are_named_need_the_range_of_ros_itself() -> None:
    given = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.7"}
    environment = dict(given)
    choose_udp(environment, FAST_DDS)
    assert environment == {**given, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    assert may_share_memory(environment, FAST_DDS)


def test_the_older_name_of_the_range_is_known() -> None:
    environment = {"ROS_LOCALHOST_ONLY": "1"}
    choose_udp(environment, FAST_DDS)
    assert environment == {
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "FASTRTPS_DEFAULT_PROFILES_FILE": OURS,
        "SKIP_DEFAULT_XML_FILE": "1",
    }


def test_another_middleware_keeps_its_own_localhost() -> None:
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    choose_udp(environment, "rmw_cyclonedds_cpp")
    assert environment == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    assert not may_share_memory(environment, "rmw_cyclonedds_cpp")


def opened(discovery: str, folder: Path = ROOT, **chosen: str) -> tuple[set[str], set[int]]:
    """Files of Fast DDS below /dev/shm that a node of ours has open, and the UDP ports that it is bound to."""
    pytest.importorskip("rclpy")
    unset = ("FASTDDS_BUILTIN_TRANSPORTS", "FASTRTPS_DEFAULT_PROFILES_FILE", "SKIP_DEFAULT_XML_FILE")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": discovery, "ROS_DOMAIN_ID": str(DOMAIN), **chosen}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [environment.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    links, _, table = done.stdout.partition("\n")
    sockets = set(re.findall(r"socket:\[(\d+)\]", links))
    rows = [line.split() for line in table.splitlines()[1:] if line]
    ports = {int(row[1].partition(":")[2], 16) for row in rows if row[9] in sockets}
    return {link for link in links.split() if link.startswith("/dev/shm/fastrtps")}, ports


ANNOUNCING = """
import sys
from rosfront.program import start_ros
start_ros([])
import rclpy
node = rclpy.create_node("announced")
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.mark.process
def test_a_node_of_ours_announces_itself_more_often_than_by_default() -> None:
    """To the port of a participant that might come: five times in its first half second, then every 0.2 s, not 3 s."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
        last.bind(("127.0.0.1", 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"]) + 10 + 2 * 31))
        last.settimeout(10.0)
        last.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)  # when it arrived, not when this process got its turn
        with ready_process("-c", ANNOUNCING):
            at_s: dict[tuple[str, int], list[float]] = {}  # others of the domain announce themselves too
            deadline_s = time.monotonic() + 30.0
            while max(map(len, at_s.values()), default=0) < 20:
                assert time.monotonic() < deadline_s, "nobody announces itself so often"
                _, ancillary, _, sender = last.recvmsg(65536, 64)
                seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
                at_s.setdefault(sender, []).append(seconds + 1e-9 * nanoseconds)
    most_often = max(at_s.values(), key=len)
    assert np.median(np.diff(most_often[6:])) == pytest.approx(0.2, abs=0.1)


@pytest.mark.process
@pytest.mark.parametrize(("discovery", "by_multicast"), [("LOCALHOST", False), ("SUBNET", True)])
def test_a_node_of_ours_opens_no_shared_memory(discovery: str, by_multicast: bool) -> None:
    files, ports = opened(discovery)
    assert files == set()
    assert ports
    assert (MULTICAST_PORT in ports) == by_multicast


@pytest.mark.process
def test_a_user_may_choose_shared_memory() -> None:
    files, _ = opened("LOCALHOST", FASTDDS_BUILTIN_TRANSPORTS="DEFAULT")
    assert files


@pytest.mark.process
def test_a_profile_in_the_folder_where_it_starts_lets_nobody_else_find_it(tmp_path: Path) -> None:
    profile = """<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
      <participant profile_name="other" is_default_profile="true"><rtps><name>other</name></rtps></participant>
    </profiles>"""
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(profile, encoding="utf-8")
    files, ports = opened("LOCALHOST", tmp_path)
    assert files == set() and ports and MULTICAST_PORT not in ports
