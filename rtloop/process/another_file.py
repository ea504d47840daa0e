"""The check of the arm file at a start after a crash: the arm must not get another arm's values."""

from config.errors import ConfigError
from config.loader import ABSENT, differences
from config.schema import ArmConfig
from rtloop.process.control_process import CannotStart
from shm import files

MOST_TOLD = 3
"""The most differences that the message names."""


def refuse_another_file(arm: ArmConfig) -> None:
    """Refuse an arm file if the last control process of that arm name died while it ran another file with other values.

    A restart after a crash must not use the calibration of another arm.

    Raises:
        CannotStart: with what differs.
    """
    now, died = arm.file_argument, files.died_with(arm.name)
    if arm.source is None or not now or died is None:
        return
    before = died.arm_file
    if before in ("", now) or died.arm_file_hash == arm.source.file_hash:
        return
    remedy = f"start that one with {died.start_again}, or, if "
    try:
        differing = differences(before, now)
    except ConfigError:
        what, remedy = "which cannot be read any more, so what differs is not known", "if "
    else:
        if not differing:
            return
        differing.sort(key=lambda one: not one[0].startswith("joints"))  # what moves an arm wrongly comes first
        told = [f"{where} ({_shown(old)} there, {_shown(new)} here)" for where, old, new in differing]
        more = f" and {len(told) - MOST_TOLD} more" if len(told) > MOST_TOLD else ""
        what = f"which differs in {', '.join(told[:MOST_TOLD])}{more}"
    raise CannotStart(
        f"The control process of arm '{arm.name}' has died, and it ran another arm file than {now}: {before}, {what}: "
        f"{remedy}this one is right for the arm, look at its values once more and forget the other with "
        f"`rm {files.state_path(arm.name)}`."
    )


def _shown(value: object) -> str:
    return "nothing" if value is ABSENT else str(value)
