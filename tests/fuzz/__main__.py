"""The long run: every target a share of the cases, counted one by one, and what failed kept to be made again.

PYTHONPATH=tests python -m fuzz --cases 1000000 --seed 1 --jobs 2
PYTHONPATH=tests python -m fuzz --again memory-1-4711
"""

import argparse
import multiprocessing
import re
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from fuzz.run import CASES_A_MILLION, CHUNK, TARGETS, run_chunk

SAY_EVERY_S = 60.0


def again(case_id: str) -> int:
    """Make one case once more; 1 when it still fails, 2 when there is no such case."""
    name, _, numbers = case_id.partition("-")
    if name not in TARGETS or not re.fullmatch(r"\d+-\d+", numbers):
        print(f"{case_id} is no case: it is one of {', '.join(TARGETS)}, then -SEED-NUMBER.", file=sys.stderr)
        return 2
    seed, case = map(int, numbers.split("-"))
    _, _, failed = run_chunk(name, seed, case, 1)
    print(failed[0][1] if failed else f"{case_id} is sound")
    return int(bool(failed))


def chunks(names: list[str], cases: int) -> list[tuple[str, int, int]]:
    """(target, first, count), the targets taking turns; in all at least `cases`, shared as in CASES_A_MILLION."""
    whole = sum(CASES_A_MILLION[name] for name in names)
    found = []
    for name in names:
        left, first = -(-cases * CASES_A_MILLION[name] // whole), 0
        while left > 0:
            count = min(left, CHUNK.get(name, 2_000))
            found.append((first / max(left + first, 1), name, first, count))
            left, first = left - count, first + count
    return [(name, first, count) for _, name, first, count in sorted(found)]


def main() -> int:
    """Run what the command line asks for; 1 when a case failed."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--target", choices=TARGETS, action="append", help="only this one; may be given again")
    parser.add_argument("--corpus", type=Path, default=Path("fuzz-corpus"), help="where failing cases are kept")
    parser.add_argument("--again", metavar="TARGET-SEED-NUMBER", help="make one case once more")
    given = parser.parse_args()
    if given.again:
        return again(given.again)
    judged = dict.fromkeys(given.target or TARGETS, 0)
    failures = dict.fromkeys(judged, 0)
    begun = said = time.monotonic()
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.jobs, mp_context=spawn) as pool:
        work = chunks(list(judged), given.cases)
        waiting = [pool.submit(run_chunk, name, given.seed, first, count) for name, first, count in work]
        for done in as_completed(waiting):
            name, count, failed = done.result()
            judged[name] += count
            failures[name] += len(failed)
            if time.monotonic() - said > SAY_EVERY_S:
                said = time.monotonic()
                print(f"{sum(judged.values()):,} cases, {sum(failures.values())} failed", flush=True)
            for case, account in failed:
                given.corpus.mkdir(exist_ok=True)
                case_id = f"{name}-{given.seed}-{case}"
                (given.corpus / f"{case_id}.txt").write_text(account, encoding="utf-8")
                print(f"{case_id}: {account.strip().splitlines()[-1][:200]}", flush=True)
    for name, count in judged.items():
        print(f"{name:12} {count:10,} cases {failures[name]:6,} failed")
    spent_s = time.monotonic() - begun
    print(f"{'in all':12} {sum(judged.values()):10,} cases {sum(failures.values()):6,} failed in {spent_s:.0f} s")
    return int(any(failures.values()))


if __name__ == "__main__":
    sys.exit(main())
