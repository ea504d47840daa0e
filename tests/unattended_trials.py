"""`PYTHONPATH=tests python -m unattended_trials`: goals on a simulated arm whose page is open; does it need a person?

`--beside "stress-ng --cpu 4"` is what the machine does besides once the page is open. A trial needs a person when the
arm stands in a fault for longer than it may take to go on by itself. What the observer finds in true motion is a
violation.
"""

from __future__ import annotations

import argparse
import re
import secrets
import shlex
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import guardian
import numpy as np
from process_trials import begin_again, own_ros_domain, small_home

from rtloop.dialogues.healing import DECIDED_WITHIN_NS
from sentences.told import latched_sentence
from shm.words import Mode

GOES_ON_WITHIN_S = DECIDED_WITHIN_NS * 1e-9 + 2.0
RESULT_WITHIN_S = 20.0
POLL_S = 0.02


def run(rig: Any, minutes: float) -> tuple[Counter[str], str]:
    """Goals one after the other; how they ended, and what a person was needed for, empty for nothing."""
    from fault_rig import Hang

    ended: Counter[str] = Counter()
    until_s = time.monotonic() + 60.0 * minutes
    while time.monotonic() < until_s:
        guardian.doing(f"goal {ended.total() + 1}")
        sent = rig.send(rig.goal())
        if not sent.ended.wait(sent.duration_s + RESULT_WITHIN_S):
            raise Hang("a goal has no result")
        ended["succeeded" if sent.succeeded else sent.words] += 1
        if not sent.succeeded and not _goes_on(rig):
            snapshot = rig.snapshot()
            names = [joint.name for joint in rig.arm.joints]
            return ended, "no control process" if snapshot is None else latched_sentence(snapshot, names)
    return ended, ""


def _goes_on(rig: Any) -> bool:
    until_s = time.monotonic() + GOES_ON_WITHIN_S
    while rig.mode() != Mode.HOLDING:
        if time.monotonic() > until_s:
            return False
        time.sleep(POLL_S)
    return True


@contextmanager
def _beside(command: str) -> Iterator[None]:
    """Run a command meanwhile; none where it is empty."""
    if not command:
        yield
        return
    with subprocess.Popen(shlex.split(command), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as load:
        try:
            yield
            if load.poll() is not None:
                raise AssertionError(f"{command} ended meanwhile with {load.returncode}")
        finally:
            load.terminate()


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="unattended_trials", description=__doc__)
    parser.add_argument("--trials", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--beside", default="", metavar="COMMAND")
    options = parser.parse_args(arguments)
    begin_again("unattended_trials", arguments)
    own_ros_domain()
    from browser import Browser
    from fault_rig import Hang, Rig

    needed, wrong = 0, []
    for number in range(options.trials):
        prefix = "rtarm-unattended-"
        with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name, small_home(Path(name)):
            rig = Rig(f"t{secrets.token_hex(4)}", Path(name), np.random.default_rng(options.seed + number))
            browser = Browser()
            try:
                rig.start_arm()
                rig.make_ready()
                view = rig.start("rtarm", "view", str(rig.arm_file), "--port", "0", needs_ros=True)
                found = re.search(r"http://\S+", view.line_with("http://"))
                assert found is not None
                browser.open(found.group())
                with _beside(options.beside):
                    ended, person = run(rig, options.minutes)
                needed += bool(person)
                told = ", ".join(f"{count} × {how}" for how, count in ended.most_common())
                print(f"{number + 1}: {told}. Needed a person: {person or 'no'}", flush=True)
                rig.make_ready()
                wrong += rig.stop_control()
            except (Hang, AssertionError) as problem:
                wrong.append(f"trial {number + 1}: {problem}")
            finally:
                browser.close()
                wrong += rig.end()
    said = f"{options.trials} × {options.minutes:g} min, a person was needed in {needed}; violations: {len(wrong)}"
    print(said, *wrong, sep="\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
