"""Mutants of leaf functions, judged by the tests of these functions: what survives lacks a test.

PYTHONPATH=tests python -m mutants --count 80 --seed 1
PYTHONPATH=tests python -m mutants --only slcan
"""

import argparse
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from mutants.judging import CRASHES, HANGS, IS_NONE, KILLED, SURVIVED, NotGreen, Tree, Verdict
from mutants.making import Mutant, in_turn, mutants
from mutants.table import EQUIVALENT, LEAVES, Leaf

ROOT = Path(__file__).parents[2]


def candidates(
    root: Path, leaves: Sequence[Leaf], equivalent: dict[str, str], only: str
) -> list[tuple[Mutant, tuple[str, ...]]]:
    """Every mutant that counts, with the tests that judge it."""
    found = [
        (mutant, leaf.tests)
        for leaf in leaves
        for mutant in mutants(leaf.file, (root / leaf.file).read_bytes(), leaf.functions)
    ]
    unknown = set(equivalent) - {mutant.key for mutant, _ in found}
    assert not unknown, f"there is no such mutant any more: {'; '.join(sorted(unknown))}"
    return [each for each in found if each[0].key not in equivalent and only in each[0].key]


def run(
    root: Path,
    leaves: Sequence[Leaf],
    equivalent: dict[str, str],
    *,
    seed: int,
    count: int,
    jobs: int = 1,
    only: str = "",
    say: Callable[[Verdict], None] = lambda verdict: None,
) -> list[Verdict]:
    """Judge so many mutants that compile; raises NotGreen where the unchanged tree fails its tests."""
    known = candidates(root, leaves, equivalent, only)
    tests = dict(known)
    waiting = iter(in_turn(list(tests), seed))
    verdicts: list[Verdict] = []
    failures: list[BaseException] = []
    left, lock = count, threading.Lock()

    def work() -> None:
        nonlocal left
        try:
            with tempfile.TemporaryDirectory(prefix="rtarm-mutants-") as folder:
                tree = Tree(root, Path(folder))
                while not failures:
                    with lock:
                        mutant = next(waiting, None) if left > 0 else None
                        left -= 1
                    if mutant is None:
                        return
                    if tests[mutant] not in tree.seconds:
                        tree.prove_green(tests[mutant])
                    verdict = tree.judge(mutant, tests[mutant])
                    with lock:
                        if verdict.word == IS_NONE:
                            left += 1
                        else:
                            verdicts.append(verdict)
                            say(verdict)
        except BaseException as failure:
            failures.append(failure)

    threads = [threading.Thread(target=work) for _ in range(jobs)]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    except BaseException as ended:  # each ends after the mutant that it is at, and removes its folder
        failures.append(ended)
        for thread in threads:
            thread.join()
    if failures:
        raise failures[0]
    return verdicts


def told(verdict: Verdict) -> str:
    mutant = verdict.mutant
    line = f"{verdict.word:15} {mutant.file}:{mutant.line} {mutant.function}: {mutant.was} → {mutant.now}"
    if verdict.word == SURVIVED:
        return f"{line}\n{'':15} judged by {' '.join(verdict.tests)}; its key is\n{'':15} {mutant.key}"
    return f"{line}  [{verdict.seconds:.0f} s] {verdict.by[:160]}"


def main() -> int:
    """Run what the command line asks for; 1 when a mutant survived, 2 when the tests fail anyway, 130 when ended."""
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=80, help="how many mutants")
    parser.add_argument("--seed", type=int, default=1, help="chooses them")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="only mutants whose key (file, function, edit) has this in it")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    begun = time.monotonic()
    try:
        verdicts = run(
            ROOT,
            LEAVES,
            EQUIVALENT,
            seed=given.seed,
            count=given.count,
            jobs=given.jobs,
            only=given.only,
            say=lambda verdict: print(told(verdict), flush=True),
        )
    except NotGreen as failure:
        print(failure, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    words = Counter(verdict.word for verdict in verdicts)
    files = Counter(verdict.mutant.file for verdict in verdicts)
    lived = Counter(verdict.mutant.file for verdict in verdicts if verdict.word == SURVIVED)
    print(f"\n{'file':32} {'mutants':>7} {'survived':>8}")
    for file in sorted(files):
        print(f"{file:32} {files[file]:7} {lived[file]:8}")
    print(
        f"{len(verdicts)} mutants in {time.monotonic() - begun:.0f} s (seed {given.seed}): {words[KILLED]} killed, "
        f"{words[HANGS]} hung, {words[CRASHES]} crashed, {words[SURVIVED]} survived "
        f"({len(EQUIVALENT)} others are known as equivalent)"
    )
    return int(words[SURVIVED] > 0)


if __name__ == "__main__":
    sys.exit(main())
