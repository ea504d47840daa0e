"""`python -m rtloop.offline.commissioning ARM`: a control process that brings nothing up and checks a drive at a time.

It prints `ready {drives}` and then obeys lines on its standard input until the input ends: `checks J` (answered by
`checks […]`), `check J SIGN NAME` (by `found {…}`) and `hold J` (by `state {…}`), with joint numbers from 0. `told …`
lines come in between. At the end, a drive whose checks were requested must report that it stands, and that it holds its
joint if it ever did. Refusals and the end are as in `python -m rtloop.offline.calibration`.
"""

from __future__ import annotations

from rtloop.offline import program

# isort: split
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from config.schema import ArmConfig
from rtloop.kept import commissioned, reference_store
from rtloop.offline.calibration.session import NotDone
from rtloop.offline.commissioning.session import Bench
from rtloop.offline.program import heard_more, next_line, say
from rtloop.process.control_process import BUSY_POLL_S, Ended
from rtloop.service.port import ServicePort
from shm import files
from shm.recording import now_at, read_on


def main(arguments: list[str] | None = None) -> int:
    return program.run(
        arguments,
        "python -m rtloop.offline.commissioning",
        "Checks one drive at a time.",
        serve,
        alone="Drives are checked",
        refuses=NotDone,
    )


def serve(arm: ArmConfig, port: ServicePort, pause: Callable[[], None]) -> None:
    """Read what the drives are, print it, and obey orders."""

    def pause_unless_interrupted() -> None:
        pause()
        if heard_more():
            raise Ended(0)

    memory = files.open_state(arm.name)
    since = now_at(memory)

    def recorded() -> np.ndarray:
        nonlocal since
        recording, since = read_on(memory, since)
        return recording.frames

    bench = Bench(
        arm,
        port,
        clock_ns=time.monotonic_ns,
        pause=pause_unless_interrupted,
        rest=lambda: time.sleep(BUSY_POLL_S),
        tell=lambda line: say("told", line),
        keep_lost=lambda joint, reason: reference_store.keep_lost_reference(arm, joint, reason),
        marks=commissioned.marks(arm, lambda line: say("told", line)),
        lost_before=reference_store.lost_references(arm),
        recorded=recorded,
    )
    bench.read()
    say("ready", json.dumps({"drives": {joint: asdict(found) for joint, found in bench.found.items()}}))
    try:
        while line := next_line(pause):
            word, answer = obey(bench, line.split(maxsplit=3))
            say(word, json.dumps(answer))
        bench.see_it_stand()
    except Ended as ended:
        if ended.code == 0:
            bench.see_it_stand()
        raise
    finally:
        memory.close()


def obey(bench: Bench, words: list[str]) -> tuple[str, Any]:
    """Carry out an order; the word and the content of its answer. Raises NotDone for an unknown order."""
    match words:
        case ["checks", joint]:
            checks = bench.checks(int(joint))
            return "checks", [[check.name, check.explains, check.question, check.moves] for check in checks]
        case ["hold", joint]:
            return "state", asdict(bench.hold(int(joint)))
        case ["check", joint, sign, name]:
            found = bench.check(name, int(joint), int(sign))
            return "found", {"findings": [asdict(one) for one in found], "record": asdict(bench.record(int(joint)))}
    raise NotDone(f"{' '.join(words)!r} is no order of a bench test.")


if __name__ == "__main__":
    sys.exit(main())
