"""What is done with one scenario, in whatever process."""

from pathlib import Path

from transcripts import store
from transcripts.compare import Finding, Verdict, compare, this_place
from transcripts.scenarios import SCENARIOS
from transcripts.tape import Transcript, listen


def heard(name: str) -> Transcript:
    """Play a scenario; every word of every cycle."""
    transcript = listen(SCENARIOS[name].play)
    transcript.place = this_place()
    return transcript


def compared(folder: Path, name: str, *, exact: bool = False) -> Finding:
    """Play a scenario and hold it against its recording."""
    path = folder / f"{name}{store.SUFFIX}"
    if not path.exists():
        return Finding(name, Verdict.DIFFERS, f"{name} has no recording: record it with --record {name}")
    if name not in SCENARIOS:
        return Finding(name, Verdict.DIFFERS, f"{path} belongs to no scenario: remove it")
    try:
        recorded = store.read(path)
    except ValueError as problem:
        return Finding(name, Verdict.DIFFERS, f"{name}: {problem}")
    return compare(name, recorded, heard(name), exact=exact)


def recorded(folder: Path, name: str) -> Finding:
    """Play a scenario and keep it."""
    try:
        store.write(folder / f"{name}{store.SUFFIX}", heard(name).thinned(SCENARIOS[name].every))
    except ValueError as problem:
        return Finding(name, Verdict.DIFFERS, str(problem))
    return Finding(name, Verdict.SAME)
