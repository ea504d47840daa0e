"""`PYTHONPATH=tests python -m process_trials --trials 200 --seed 1`: process faults at random moments of running goals.

Besides, a person stops the arm at a random moment, whatever others go on sending (`--only person`).
Prints a line for each trial and a table at the end; exits with 1 when anything happened that must not. As root it has
/dev/shm and a home of its own, both small, so that they can be full; otherwise those trials are left out.
"""

from __future__ import annotations

import argparse
import copy
import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import guardian
import numpy as np
from machine_witness import Witness
from verdicts import MARKER

from rosfront.transport import FAST_DDS, choose_udp
from rtarm.launch.own_domain import own_domain

OWN = "RTARM_TRIALS_OWN_MOUNTS"
SHM_SIZE, HOME_SIZE = "256m", "8m"
SERVER_GONE_S = 40.0


def own_ros_domain() -> None:
    """Before rclpy is imported: this run's ROS traffic stays on this machine and apart from others'."""
    os.environ.setdefault("ROS_DOMAIN_ID", own_domain()["ROS_DOMAIN_ID"])
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    choose_udp(os.environ, os.environ.get("RMW_IMPLEMENTATION") or FAST_DDS)


def begin_again(module: str, arguments: Sequence[str]) -> None:
    """Begin again below a guardian, with /dev/shm of one's own where root allows; returns where that is so already."""
    if guardian.is_guarded():
        return
    command = [sys.executable, "-m", module, *arguments]
    mount = f"mount -t tmpfs -o size={SHM_SIZE},mode=1777 trials /dev/shm"
    if os.geteuid() == 0:
        tried = subprocess.run(["unshare", "--mount", "sh", "-c", mount], capture_output=True, check=False)
        if tried.returncode == 0:
            os.environ[OWN] = "1"
            command = ["unshare", "--mount", "sh", "-c", f'{mount} && exec "$@"', "sh", *command]
    sys.exit(guardian.guard(command, guardian.LIMIT_S))


@contextmanager
def small_home(folder: Path) -> Iterator[None]:
    """A home for logs and recordings, on a small file system of its own where that is possible."""
    from fault_rig import environment_of

    home = folder / "home"
    home.mkdir()
    if os.environ.get(OWN):
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={HOME_SIZE}", "trials", str(home)], check=True)
    os.environ.update(environment_of(home))
    try:
        yield
    finally:
        if os.environ.get(OWN):
            subprocess.run(["umount", "-l", str(home)], check=False)


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", default=[], help="part of `up|bare target: fault` (may be repeated)")
    parser.add_argument("--report", type=Path, help="file for the table (markdown)")
    options = parser.parse_args(arguments)
    begin_again("process_trials", arguments)
    own_ros_domain()
    os.environ.setdefault(MARKER, secrets.token_hex(8))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    from fault_rig import Hang, Rig
    from process_faults import all_kinds, run
    from process_stops import stop_kinds

    chosen = random.Random(options.seed)
    kinds = [
        kind
        for kind in (*all_kinds(shared=bool(os.environ.get(OWN))), *stop_kinds())
        if not options.only or any(part in f"{kind.how} {kind.target}: {kind.fault}" for part in options.only)
    ]
    if not kinds:
        only = " or ".join(map(repr, options.only))
        print(f"No trial is called {only} here: see tests/process_faults.py.", file=sys.stderr)
        return 2
    trials, left = [], []
    while len(trials) < options.trials:
        chosen.shuffle(kinds)
        trials += copy.deepcopy(kinds)
    trials = sorted(trials[: options.trials], key=lambda trial: trial.launched)
    prefix = "rtarm-trials-"
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name, small_home(Path(name)):
        folder = Path(name)
        witness = Witness(f"{MARKER}={os.environ[MARKER]}")
        rig = Rig(f"t{secrets.token_hex(4)}", folder, np.random.default_rng(options.seed))
        try:
            rig.start_arm()
            for number, trial in enumerate(trials, 1):
                trial.number = number
                guardian.doing(f"trial {number} ({trial.how} {trial.target}: {trial.fault})")
                began_ns = time.monotonic_ns()
                run(rig, trial)
                trial.stalls = witness.since(began_ns)
                print(line(trial, (time.monotonic_ns() - began_ns) / 1e9), flush=True)
            guardian.doing("the end of the trials")
            rig.make_ready()
            left = rig.stop_control() + rig.servers_still_seen(SERVER_GONE_S)
        except (Hang, AssertionError) as problem:
            left = [f"hang: {problem}"]
        finally:
            witness.close()
            left += rig.end()
    report = table(trials, options.seed, list(rig.gone_ms.values()), left)
    print(report)
    if options.report is not None:
        options.report.write_text(report, encoding="utf-8")
    return int(bool(left or any(trial.violations for trial in trials)))


def line(trial: object, seconds: float) -> str:
    figures = [
        f"{name} {value:.0f}"
        for name in ("stands", "shortest", "told", "accepted", "back")
        if (value := getattr(trial, f"{name}_ms")) is not None
    ]
    parts = [f"{trial.number:3d} {trial.how:4s} {trial.target}: {trial.fault} ({trial.what})", trial.outcome, *figures]
    parts += [*trial.steps, *trial.notes]
    parts += [f"the machine {trial.stalls}"] if trial.stalls else []
    parts.append(f"{seconds:.1f} s")
    return " | ".join(parts) + "".join(f"\n    VIOLATION {sentence}" for sentence in trial.violations)


def spread(values: Sequence[float]) -> str:
    if not values:
        return "–"
    return " / ".join(f"{value:.0f}" for value in (*np.percentile(values, (50, 99)), max(values)))


def spread_of(trials: Sequence[object], figure: str) -> str:
    return spread([value for trial in trials if (value := getattr(trial, f"{figure}_ms")) is not None])


def waits(trials: Sequence[object]) -> list[str]:
    """How long people wait for rest and clients for a server, with and without stalls of the machine."""
    calm = [trial for trial in trials if not trial.stalls]
    return [
        f"{what}: {spread_of(trials, figure)} ms; where the machine never stood still ({len(calm)} of {len(trials)} "
        f"trials) {spread_of(calm, figure)} ms."
        for what, figure in (
            ("From the press to commanded rest", "stands"),
            ("v / a, the slowest joint alone at its limit from what was commanded at the press", "shortest"),
            ("From the kill of the front to the next accepted goal", "accepted"),
        )
        if any(getattr(trial, f"{figure}_ms") is not None for trial in trials)
    ]


def table(trials: Sequence[object], seed: int, gone_ms: Sequence[float], left: Sequence[str]) -> str:
    groups = defaultdict(list)
    for trial in trials:
        groups[trial.target, trial.fault].append(trial)
    rows = [
        f"{len(trials)} trials, seed {seed}. Milliseconds from the fault: p50 / p99 / max.",
        "",
        "| target | fault | goal ended as | arm stands | v / a | client told | goal accepted | back | trials | bad |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (target, fault), group in sorted(groups.items()):
        outcomes = defaultdict(int)
        for trial in group:
            outcomes[trial.outcome or "?"] += 1
        ends = "; ".join(f"{outcome} ({count})" for outcome, count in sorted(outcomes.items(), key=lambda o: -o[1]))
        times = [spread_of(group, name) for name in ("stands", "shortest", "told", "accepted", "back")]
        bad = sum(bool(trial.violations) for trial in group)
        rows.append(f"| {target} | {fault} | {ends} | {' | '.join(times)} | {len(group)} | {bad} |")
    bad = [f"- {trial.target}: {trial.fault} ({trial.what}): {v}" for trial in trials for v in trial.violations]
    people = [trial for trial in trials if trial.target == "person" or trial.accepted_ms is not None]
    rows += ["", *waits(people)]
    rows += ["", f"A client saw the server of a dead front gone after {spread(gone_ms)} ms ({len(gone_ms)} deaths)."]
    rows += ["", f"Violations: {len(bad) + len(left)}", *bad, *(f"- at the end: {sentence}" for sentence in left)]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
