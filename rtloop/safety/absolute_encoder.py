"""What a lost reference means to a drive whose encoder is absolute; ordinary Python, compiled by `references`."""

from shm.words import Unreferenced


def absolute_makes_good(reason: int) -> bool:
    """Whether a reason means nothing for a drive whose encoder is absolute: its reading is an angle whatever happened.

    That is not so where its readings themselves were in doubt.
    """
    return reason == Unreferenced.MOVED or reason == Unreferenced.POWER_LOST or reason == Unreferenced.SILENT
