"""What the shell offers when somebody presses the tabulator key: words that start as what is there already."""

from __future__ import annotations

from collections.abc import Iterable


def known_arms(incomplete: str) -> list[str]:
    """Arms that come with rtarm; a path is left to the shell."""
    from config.loader import known_arms

    return _starting(known_arms(), incomplete)


def running_arms(incomplete: str) -> list[str]:
    """Arms that run here."""
    from shm.files import running_arms

    return _starting(running_arms(), incomplete)


def joints(incomplete: str) -> list[str]:
    """Joints of the arms that run here."""
    from shm import files
    from shm.client import StateReader
    from shm.errors import SharedMemoryError

    found: dict[str, None] = {}
    for arm in files.running_arms():
        try:
            reader = StateReader(files.open_state(arm))
        except SharedMemoryError:
            continue  # it has ended just now
        found.update(dict.fromkeys(files.joint_names(reader.memory.record["header"])))
        reader.close()
    return _starting(found, incomplete)


def recordings(incomplete: str) -> list[str]:
    """Recordings in their folder, the newest first; other files are left to the shell."""
    from rtarm.recording.folder import recordings

    return _starting(map(str, recordings()), incomplete)


def motions(incomplete: str) -> list[str]:
    """Motions that are kept under a name; other files are left to the shell."""
    import importlib.util

    if importlib.util.find_spec("scipy") is None:
        return []
    from rtarm.teach.file import kept

    return _starting((path.stem for path in kept()), incomplete)


def _starting(words: Iterable[str], incomplete: str) -> list[str]:
    return [word for word in words if word.startswith(incomplete)]
