"""Running tests against a mutant, in a copy of the tree in which only what depends on the edited file is compiled."""

import ast
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mutants.making import Mutant

TESTS = Path(__file__).parents[1]
COPIED = (
    "compilation",
    "config",
    "motion",
    "shm",
    "sentences",
    "rtloop",
    "rosfront",
    "sim",
    "rtarm",
    "tests",
    "pyproject.toml",
)
HANG_S, HANG_TIMES = 30.0, 3.0
"""What needs so much longer than so many times what the unchanged tree needs hangs."""
KILLED, SURVIVED, HANGS, CRASHES, IS_NONE = "killed", "SURVIVED", "killed: hangs", "killed: crashes", "does not compile"
NOT_COMPILED = ("numba.core.errors.", "SyntaxError", "NameError", "UnboundLocalError")


class NotGreen(Exception):
    """The unchanged tree fails its tests, so they can judge nothing."""


@dataclass(frozen=True)
class Verdict:
    mutant: Mutant
    word: str
    by: str = ""
    """The test that failed, and how."""
    tests: tuple[str, ...] = ()
    seconds: float = 0.0


class Tree:
    """A copy of the tree with a cache of its own, in a folder that whoever makes it removes."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root, self.home = folder / "tree", folder
        for name in COPIED:
            if (root / name).is_dir():
                shutil.copytree(root / name, self.root / name, ignore=shutil.ignore_patterns("__pycache__"))
            elif (root / name).exists():
                shutil.copy2(root / name, self.root / name)
        self.seconds: dict[tuple[str, ...], float] = {}
        self.importers = importers(self.root)
        (folder / "tmp").mkdir()

    def prove_green(self, tests: tuple[str, ...]) -> None:
        """Run tests on the unchanged tree, which also fills the cache; raises NotGreen."""
        begun = time.monotonic()
        code, said = self._pytest(tests, "cache", None)
        self.seconds[tests] = time.monotonic() - begun
        if code != 0:
            raise NotGreen(f"The unchanged tree fails {' '.join(tests)}, so it can judge no mutant:\n{said[-2000:]}")

    def judge(self, mutant: Mutant, tests: tuple[str, ...]) -> Verdict:
        """What the tests say of the tree with this one edit."""
        scratch = self.home / "scratch"
        shutil.rmtree(scratch, ignore_errors=True)
        # numba replaces the files of its cache and never writes into one, so links are as good as copies
        shutil.copytree(self.home / "cache", scratch, copy_function=os.link)
        begun = time.monotonic()
        with self._edited(mutant):
            code, said = self._pytest(tests, "scratch", HANG_S + HANG_TIMES * self.seconds[tests])
        failed = re.search(r"^(?:FAILED|ERROR) (.*)$", said, re.MULTILINE)
        by = failed[1] if failed else ""
        if code is None:
            word = HANGS
        elif code < 0:
            word, by = CRASHES, signal.Signals(-code).name
        elif code == 0:
            word = SURVIVED
        elif any(name in said for name in NOT_COMPILED):
            word = IS_NONE
        elif code in (pytest_failed, pytest_interrupted):
            word = KILLED
        else:
            raise RuntimeError(f"pytest ended with {code}:\n{said[-2000:]}")
        return Verdict(mutant, word, by, tests, time.monotonic() - begun)

    @contextlib.contextmanager
    def _edited(self, mutant: Mutant) -> Iterator[None]:
        """The edit, and a blank line more in every file that imports this one, since numba's cache looks at files."""
        path = self.root / mutant.file
        sources = {each: each.read_bytes() for each in {path, *self.importers.get(path, ())}}
        for each, source in sources.items():
            each.write_bytes(mutant.applied(source) if each == path else source + b"\n")
        try:
            yield
        finally:
            for each, source in sources.items():
                each.write_bytes(source)

    def _pytest(self, tests: Sequence[str], cache: str, limit_s: float | None) -> tuple[int | None, str]:
        """Exit code (None: it hung and was killed) and everything said; nothing of it is left."""
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, (self.root, self.root / "tests", TESTS))),
            "PYTHONDONTWRITEBYTECODE": "1",  # an edit within the same second would not be seen
            "XDG_CACHE_HOME": str(self.home / cache),
            "TMPDIR": str(self.home / "tmp"),
            "COLUMNS": "250",
        }
        options = ("-x", "-q", "-m", "not process", "-p", "mutants.quick", "-p", "no:cacheprovider", "--tb=short")
        with subprocess.Popen(
            [sys.executable, "-m", "pytest", *options, *tests],
            cwd=self.root,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                said, _ = process.communicate(timeout=limit_s)
                return process.returncode, said
            except subprocess.TimeoutExpired:
                return None, ""
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)


pytest_failed, pytest_interrupted = 1, 2


def importers(root: Path) -> dict[Path, set[Path]]:
    """For each Python file those that import it, also by way of others."""
    modules = {}
    for path in root.rglob("*.py"):
        name = path.relative_to(root).with_suffix("").as_posix().removesuffix("/__init__")
        modules[name.replace("/", ".").removeprefix("tests.")] = path
    direct: dict[Path, set[Path]] = {path: set() for path in modules.values()}
    for path in modules.values():
        for node in ast.walk(ast.parse(path.read_bytes())):
            match node:
                case ast.Import(names=names):
                    named = [alias.name for alias in names]
                case ast.ImportFrom(module=str() as module, names=names):
                    named = [module, *(f"{module}.{alias.name}" for alias in names)]
                case ast.Call(func=ast.Attribute(attr="import_module")):  # by a name that is found out: any beside it
                    named = [name for name, beside in modules.items() if beside.parent == path.parent]
                case _:
                    continue
            for name in named:
                if name in modules:
                    direct[modules[name]].add(path)
    found = {}
    for path in direct:
        known: set[Path] = set()
        waiting = [path]
        while waiting:
            fresh = direct[waiting.pop()] - known
            known |= fresh
            waiting += fresh
        found[path] = known
    return found
