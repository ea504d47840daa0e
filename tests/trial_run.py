"""Trials with real processes, as the tests run a sample of them."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
END_S = 60.0
"""For the trials to end their processes and to remove their folder."""


def run_trials(module: str, *arguments: str) -> tuple[int, str]:
    """Exit code and everything said; the trials end in order also when this test ends before them."""
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
    with subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as trials:
        try:
            said, _ = trials.communicate()
        finally:
            if trials.poll() is None:
                trials.terminate()
                try:
                    trials.communicate(timeout=END_S)
                except subprocess.TimeoutExpired:
                    trials.kill()
    return trials.returncode, said
