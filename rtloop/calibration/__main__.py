"""`python -m rtloop.calibration ARM`: a control process that brings nothing up and turns one drive at a time.

Prints `ready {drives}`, then obeys lines on its standard input until that ends: `look J`, `turn J COUNTS RPM`,
`release J`, `hold J`, `home J` with joint numbers from 0. Each is answered by `state {…}`, which says `not_done` where
nothing was done and why; `told …` lines come meanwhile. Whatever fails is printed as `refused …` and ends it. A line,
or the end of the input, in the middle of a move stops that move and ends it. Joints that were let go hold again
at the end. Exit codes as of `python -m rtloop`.
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
from rtloop import saved
from rtloop.__main__ import STOP_SIGNALS, arm_of, compiled_cycle, tell
from rtloop.calibration.session import DriveState, NotDone, Session
from rtloop.conversation import TalkFailed
from rtloop.port import ServicePort
from rtloop.process import BUSY_POLL_S, CannotStart, ControlProcess, Ended, StopAsked
from rtloop.settings.__main__ import next_line, say
from rtloop.wire.refusal import WireRefused
from shm.errors import AlreadyHeld, SharedMemoryError


def main(arguments: list[str] | None = None) -> int:
    try:
        arm = arm_of(arguments, "python -m rtloop.calibration", "Turns one drive at a time.")
        stop_asked = StopAsked(STOP_SIGNALS)
        process = ControlProcess(arm, compiled_cycle(stop_asked), tell, stop_asked)
        return process.serve_offline(lambda port, pause: serve(arm, port, pause))
    except AlreadyHeld as error:
        say(
            "refused",
            "Joints are calibrated by a control process of their own, and this arm has one already: end that first "
            f"(Ctrl-C in its `rtarm up`), then run this again. ({error})",
        )
        return 2
    except (ConfigError, SharedMemoryError, CannotStart, WireRefused, TalkFailed) as error:
        say("refused", str(error))
        return 2


def serve(arm: ArmConfig, port: ServicePort, pause: Callable[[], None]) -> None:
    """Read, say what was read, and obey."""

    def pause_unless_interrupted() -> None:
        pause()
        if select.select([sys.stdin], (), (), 0)[0]:
            raise Ended(0)

    session = Session(
        arm,
        port,
        clock_ns=time.monotonic_ns,
        pause=pause_unless_interrupted,
        rest=lambda: time.sleep(BUSY_POLL_S),
        tell=lambda line: say("told", line),
        keep_lost=lambda joint, reason: saved.keep_lost_reference(arm, joint, reason),
        lost_before=saved.lost_references(arm),
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
    """What stands after an order."""
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
