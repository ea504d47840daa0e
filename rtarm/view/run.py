"""Serving the page until a signal, at the lowest priority there is."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING

from config.schema import ArmConfig
from rtarm.console.interrupt import signals_to
from rtarm.console.niceness import done_by, nice_thread
from rtarm.view.orders import Orders
from rtarm.view.page import Page
from rtarm.view.source import Source
from rtarm.view.words import Words

if TYPE_CHECKING:
    import viser


def serve(server: viser.ViserServer, arm: ArmConfig, source: Source, orders: Orders | None, words: Words) -> None:
    """Keep the page up to the source until SIGINT, SIGTERM or SIGHUP; then close everything.

    A goal that was sent from the page and still runs is cancelled: the arm stops on its path.
    """
    ended = threading.Event()
    with signals_to(lambda *_: ended.set()):
        try:
            with nice_thread() as thread:  # signals come to this one, which only waits
                done_by(thread, lambda: Page(server, arm, source, orders, words).serve(ended))
        finally:
            if orders is not None:
                orders.close()
            source.close()
            with suppress(RuntimeError):  # its loop is closed already
                server.stop()
