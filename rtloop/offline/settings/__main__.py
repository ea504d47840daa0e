"""`python -m rtloop.offline.settings ARM`: a control process that brings nothing up and only reads and writes settings.

It prints `ready {reports}` and then obeys one line on its standard input: `write` (volatile memory) or `store` (flash
too). It answers with `told …` for each drive and `written {result}`. It ends when its input ends; during a write it
first completes the drive that it has begun. A refusal is printed as `refused …`. Exit codes as of `python -m rtloop`.
"""

from __future__ import annotations

from rtloop.offline import program

# isort: split
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict

from config.schema import ArmConfig
from rtloop.offline.program import heard_more, next_line, say
from rtloop.offline.settings.compare import as_json
from rtloop.offline.settings.session import NotWritten, Session
from rtloop.service.port import ServicePort

ORDERS = ("write", "store")


def main(arguments: list[str] | None = None) -> int:
    return program.run(
        arguments,
        "python -m rtloop.offline.settings",
        "Settings of an arm's drives.",
        serve,
        alone="Settings are read",
        refuses=NotWritten,
    )


def serve(arm: ArmConfig, port: ServicePort, pause: Callable[[], None]) -> None:
    """Read the settings, print the reports, and obey one order."""
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


if __name__ == "__main__":
    sys.exit(main())
