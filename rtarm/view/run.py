"""Serving the page until a signal, at the lowest priority there is."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from typing import TYPE_CHECKING

from config.schema import ArmConfig
from rtarm.interrupt import STOP_SIGNALS
from rtarm.view.orders import Orders
from rtarm.view.page import Page
from rtarm.view.source import Source
from rtarm.view.words import Words

if TYPE_CHECKING:
    import viser

MOST_NICE = 19


def give_way() -> None:
    """Let a control process that was given no real-time priority go before all threads there are, and those to come."""
    for thread in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):  # it has ended just now
            os.setpriority(os.PRIO_PROCESS, int(thread), MOST_NICE)


def serve(server: viser.ViserServer, arm: ArmConfig, source: Source, orders: Orders | None, words: Words) -> None:
    """Keep the page up to the source until SIGINT, SIGTERM or SIGHUP; then close everything.

    A goal that was sent from the page and still runs is cancelled: the arm stops on its path.
    """
    give_way()
    ended = threading.Event()
    before = {number: signal.signal(number, lambda *_: ended.set()) for number in STOP_SIGNALS}
    try:
        Page(server, arm, source, orders, words).serve(ended)
    finally:
        if orders is not None:
            orders.close()
        source.close()
        with suppress(RuntimeError):  # its loop is closed already
            server.stop()
        for number, handler in before.items():
            signal.signal(number, handler)
