"""`python -m rtloop.offline.calibration ARM`: a control process that brings nothing up and turns one drive at a time.

It prints `ready {drives}` and then obeys lines on its standard input until the input ends: `look J`,
`turn J COUNTS RPM`, `release J`, `hold J`, `home J` with joint numbers from 0. Each is answered by `state {…}`; if
nothing was done, that holds `not_done` with the reason. `told …` lines come in between. A failure is printed as
`refused …` and ends the program. A line, or the end of the input, in the middle of a move stops the move and ends the
program. At the end, joints that were released hold again. Exit codes as of `python -m rtloop`.
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
from rtloop.kept import commissioned, reference_store
from rtloop.offline.calibration.session import DriveState, NotDone, Session
from rtloop.offline.program import heard_more, next_line, say
from rtloop.process.control_process import BUSY_POLL_S, Ended
from rtloop.service.port import ServicePort


def main(arguments: list[str] | None = None) -> int:
    return program.run(
        arguments,
        "python -m rtloop.offline.calibration",
        "Turns one drive at a time.",
        serve,
        alone="Joints are calibrated",
        refuses=NotDone,
    )


def serve(arm: ArmConfig, port: ServicePort, pause: Callable[[], None]) -> None:
    """Read what the drives are, print it, and obey orders."""

    def pause_unless_interrupted() -> None:
        pause()
        if heard_more():
            raise Ended(0)

    session = Session(
        arm,
        port,
        clock_ns=time.monotonic_ns,
        pause=pause_unless_interrupted,
        rest=lambda: time.sleep(BUSY_POLL_S),
        tell=lambda line: say("told", line),
        keep_lost=lambda joint, reason: reference_store.keep_lost_reference(arm, joint, reason),
        marks=commissioned.marks(arm, lambda line: say("told", line)),
        lost_before=reference_store.lost_references(arm),
    )
    session.read()
    say("ready", json.dumps({"drives": {joint: asdict(found) for joint, found in session.found.items()}}))
    try:
        while line := next_line(pause):
            try:
                say("state", json.dumps(asdict(obey(session, line.split()))))
            except NotDone as refused:
                say("state", json.dumps({"not_done": str(refused)}))
    finally:
        session.close()


def obey(session: Session, words: list[str]) -> DriveState:
    """Carry out an order; the drive's state after it. Raises NotDone for an unknown order."""
    match words:
        case ["look", joint]:
            return session.look(int(joint))
        case ["turn", joint, counts, rpm]:
            return session.turn(int(joint), int(counts), int(rpm))
        case ["release", joint]:
            return session.let_go(int(joint))
        case ["hold", joint]:
            return session.hold(int(joint))
        case ["home", joint]:
            return session.home(int(joint))
    raise NotDone(f"{' '.join(words)!r} is no order of a calibration.")


if __name__ == "__main__":
    sys.exit(main())
