"""A simulated arm that is served beside a test, in a thread of its own."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from sim.pty import PtyServer
from sim.python_can_host import PythonCanServer


@contextmanager
def serving(server: PtyServer | PythonCanServer) -> Iterator[PtyServer | PythonCanServer]:
    """With a server that serves; it is closed in the end."""
    ends = threading.Event()
    thread = threading.Thread(target=server.serve, args=(lambda: not ends.is_set(),))
    thread.start()
    with server:
        try:
            yield server
        finally:
            ends.set()
            os.write(server.wake_descriptor, b"\0")
            thread.join()
