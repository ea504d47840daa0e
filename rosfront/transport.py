"""Our ROS messages go by UDP: a process that dies in the shared memory of Fast DDS makes the others wait for ever.

Fast DDS 2.14, before it sends into a shared-memory port, waits without timeout for the process that began to make the
port, and holds its own lock meanwhile. If that process was killed or found /dev/shm full, every publisher, request and
heartbeat of the waiting process stands still.
"""

from collections.abc import Mapping, MutableMapping
from pathlib import Path

FAST_DDS = "rmw_fastrtps"
"""ROS' default middleware, in all its variants."""
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
UDP = "UDPv4"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
NO_OTHER_PROFILE = "SKIP_DEFAULT_XML_FILE"
"""Unless this is set, a DEFAULT_FASTRTPS_PROFILES.xml in the process' start folder takes the place of the profile."""
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
STATIC_PEERS = "ROS_STATIC_PEERS"
LOCALHOST = "LOCALHOST"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
"""The older variable for the range LOCALHOST; it takes precedence over `RANGE`."""
LOCALHOST_PROFILE = Path(__file__).with_name("localhost.xml")


def choose_udp(environment: MutableMapping[str, str], middleware: str) -> None:
    """Make Fast DDS use UDP only, by variables of `environment`; call before a process' first node.

    A user's choice stays: other transports, or a profile file of Fast DDS, which may hold anything. For the range
    LOCALHOST, ROS adds shared memory whatever else is set, so our own profile provides that range instead. It does not
    where static peers are named, because ROS adds peers to its own ranges only.
    """
    if not middleware.startswith(FAST_DDS) or environment.get(PROFILES) not in (None, "", str(LOCALHOST_PROFILE)):
        return
    environment[TRANSPORTS] = environment.get(TRANSPORTS) or UDP
    ours = LOCALHOST_PROFILE.is_file() and not environment.get(STATIC_PEERS)
    if environment[TRANSPORTS] == UDP and _is_localhost(environment) and ours:
        environment.pop(LOCALHOST_ONLY, None)
        environment[RANGE] = "SYSTEM_DEFAULT"  # ROS leaves what the profile says
        environment[PROFILES] = str(LOCALHOST_PROFILE)
        environment[NO_OTHER_PROFILE] = "1"


def may_share_memory(environment: Mapping[str, str], middleware: str) -> bool:
    """Whether a process with this environment may use the shared memory of Fast DDS."""
    return middleware.startswith(FAST_DDS) and (environment.get(TRANSPORTS) != UDP or _is_localhost(environment))


def _is_localhost(environment: Mapping[str, str]) -> bool:
    """Whether ROS would look for other processes on this machine alone."""
    return environment.get(LOCALHOST_ONLY) == "1" or environment.get(RANGE) == LOCALHOST
