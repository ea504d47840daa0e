"""What a service manager is told: systemd's notification protocol, a datagram to the socket that it names.

Not by the package sdnotify (0.3.2): it swallows every exception, so a signal that asks for the end too, and
leaves its socket open.
"""

import contextlib
import os
import socket

VARIABLE = "NOTIFY_SOCKET"
READY = "READY=1\nSTATUS=running"
STOPPING = "STOPPING=1\nSTATUS=stopping the arm on its path"


def tell(state: str) -> None:
    """Tell it, where somebody listens; an arm is not ended because nobody does (sd_notify(3))."""
    address = os.environ.get(VARIABLE)
    if not address:
        return
    if address.startswith("@"):  # an abstract socket has a null byte there
        address = f"\0{address[1:]}"
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(state.encode(), address)
