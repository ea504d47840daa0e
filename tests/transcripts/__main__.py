"""Comparing and recording transcripts, see docs/explanation/testing.md.

PYTHONPATH=tests python -m transcripts --jobs 2
PYTHONPATH=tests python -m transcripts --record pause cancel
"""

import argparse
import fnmatch
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from transcripts import store
from transcripts.compare import Finding, Verdict
from transcripts.run import compared, recorded
from transcripts.scenarios import SCENARIOS


def chosen(patterns: Sequence[str], folder: Path) -> list[str]:
    """Names that patterns choose of scenarios and recordings, all without any; raises ValueError for an idle one."""
    names = [*SCENARIOS, *(sorted({path.stem for path in folder.glob(f"*{store.SUFFIX}")} - set(SCENARIOS)))]
    for pattern in patterns:
        if not fnmatch.filter(names, pattern):
            raise ValueError(f"No scenario is called {pattern!r}: --list names them.")
    return [name for name in names if not patterns or any(fnmatch.fnmatch(name, pattern) for pattern in patterns)]


def findings_of(work: Callable[[str], Finding], names: Sequence[str], jobs: int) -> Iterator[Finding]:
    """What comes of each scenario, in their order; each in the same way in whichever process."""
    if jobs == 1:
        yield from map(work, names)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(work, names)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for; 1 when a scenario differs, 2 when none, or all, are named by mistake."""
    parser = argparse.ArgumentParser(prog="python -m transcripts", description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="only these; * stands for anything")
    parser.add_argument("--record", action="store_true", help="record anew instead of comparing")
    parser.add_argument(
        "--exact", action="store_true", help="let no float differ, elsewhere than where it was recorded"
    )
    parser.add_argument("--list", action="store_true", help="name the scenarios")
    parser.add_argument("--jobs", type=int, default=1, help="processes at once")
    parser.add_argument("--data", type=Path, default=store.FOLDER, help="folder of the recordings")
    given = parser.parse_args(arguments)
    if given.record and not given.scenarios and given.data == store.FOLDER:
        print("Name the scenarios that are meant to change, or '*': all recordings would be replaced.", file=sys.stderr)
        return 2
    try:
        names = chosen(given.scenarios, given.data)
    except ValueError as problem:
        print(problem, file=sys.stderr)
        return 2
    if given.list:
        print(*names, sep="\n")
        return 0
    if given.record:
        given.data.mkdir(parents=True, exist_ok=True)
        names = [name for name in names if name in SCENARIOS]
    work = partial(recorded, given.data) if given.record else partial(compared, given.data, exact=given.exact)
    began = time.monotonic()
    verdicts: Counter[Verdict] = Counter()
    for finding in findings_of(work, names, given.jobs):
        verdicts[finding.verdict] += 1
        if finding.verdict != Verdict.SAME:
            print(finding.sentence, flush=True)
    done = "recorded" if given.record else "the same"
    print(
        f"{len(names)} scenarios in {time.monotonic() - began:.0f} s: {verdicts[Verdict.SAME]} {done}, "
        f"{verdicts[Verdict.DIFFERS]} differ, {verdicts[Verdict.UNSURE]} unsure"
    )
    if verdicts[Verdict.UNSURE]:
        print(
            "To be sure here, record with the code of before (--record --data FOLDER) and compare with --data FOLDER."
        )
    return int(verdicts[Verdict.DIFFERS] > 0)


if __name__ == "__main__":
    sys.exit(main())
