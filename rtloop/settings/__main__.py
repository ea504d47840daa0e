"""`python -m rtloop.settings ARM`: a control process that brings nothing up and only talks with drives about settings.

Prints `ready {reports}`, then obeys a line on its standard input, `write` (volatile memory) or `store` (flash too),
with `told …` for each drive and `written {result}`; it ends when that input does, amid a write with the drive it has
begun. What it refuses it prints as
`refused …`. Exit codes as of `python -m rtloop`.
"""

from __future__ import annotations

import json
import select
import sys
import time
from collections.abc import Callable
from dataclasses import asdict

from config.errors import ConfigError
from config.schema import ArmConfig
from rtloop.__main__ import STOP_SIGNALS, arm_of, compiled_cycle, tell
from rtloop.conversation import TalkFailed
from rtloop.port import ServicePort
from rtloop.process import CannotStart, ControlProcess, StopAsked
from rtloop.settings.compare import as_json
from rtloop.settings.session import NotWritten, Session
from rtloop.wire.refusal import WireRefused
from shm.errors import AlreadyHeld, SharedMemoryError

ORDERS = ("write", "store")


def main(arguments: list[str] | None = None) -> int:
    try:
        arm = arm_of(arguments, "python -m rtloop.settings", "Settings of an arm's drives.")
        stop_asked = StopAsked(STOP_SIGNALS)
        process = ControlProcess(arm, compiled_cycle(stop_asked), tell, stop_asked)
        return process.serve_offline(lambda port, pause: serve(arm, port, pause))
    except AlreadyHeld as error:
        say(
            "refused",
            "Settings are read by a control process of their own, and this arm has one already: end that first (Ctrl-C "
            f"in its `rtarm up`), then run this again. ({error})",
        )
        return 2
    except (ConfigError, SharedMemoryError, CannotStart, WireRefused, TalkFailed, NotWritten) as error:
        say("refused", str(error))
        return 2


def serve(arm: ArmConfig, port: ServicePort, pause: Callable[[], None]) -> None:
    """Read, say what was read, and obey one order."""
    session = Session(arm, port, time.monotonic_ns, pause)
    session.read()
    say("ready", reported(session))
    order = next_line(pause)
    if order in ORDERS:
        written = session.write(store=order == "store", told=lambda line: say("told", line), ends=heard_more)
        say("written", json.dumps({**json.loads(reported(session)), **asdict(written)}))


def reported(session: Session) -> str:
    """The reports of a session as JSON, in one line."""
    return json.dumps({"drives": [as_json(report) for report in session.reports.values()]})


def next_line(pause: Callable[[], None]) -> str:
    """The next line of the standard input, empty at its end."""
    while not heard_more():
        pause()
    return sys.stdin.readline().strip()


def heard_more() -> bool:
    """Whether the standard input has a line, or has ended."""
    return bool(select.select([sys.stdin], (), (), 0)[0])


def say(word: str, text: str) -> None:
    print(word, text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
